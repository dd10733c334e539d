"""Noise of one reading, and whether shapes repeat over loads and signs.

Whether shapes repeat over loads and signs, judged against their repeats.

What pooled rows leave of the means of groups, c - U y (`pooling`), is noise if they do:

    chi^2 = sum r (c - U y)^2 / s^2,        n (g - R) degrees of freedom,

with s^2 from the repeats. Readings that depend on each other, as those of a mirror that moves as a
whole, have fewer: in terms of their correlation matrix C, (tr C)^2 / tr C^2 a row instead of n.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from truenewton.arrays import Array
from truenewton.chance import chi2_sf, f_sf
from truenewton.estimation.findings.estimate import NoiseSource
from truenewton.estimation.paper.identifiability import MIN_REPEATS
from truenewton.estimation.readings.moments import Moments
from truenewton.estimation.readings.rounding_steps import hidden_variance
from truenewton.estimation.readings.rows import WEIGHED_NOISE
from truenewton.records.campaign import Campaign


@dataclass(frozen=True, eq=False)
class Noise:
    """Variance of one reading of weight 1, and what it rests on.

    Attributes
    ----------
    variance
        (n,) [N^2].
    source
        Where it is from; where from the minimum, only its shape is known, and the fit gives its
        size.
    share
        How much of it reaches the balance, in terms of independent actuators: less than 1 where the
        mirror's own motion makes part of it, more where something pushes many actuators at once.
    share_freedom
        Degrees of freedom from which the share is known.
    hidden
        (n,) how much of it repeats do not show: rounding that they have in common [N^2].
    least
        Variance below which it is not worth telling from rounding [N^2].
    """

    variance: Array
    source: NoiseSource
    share: float = 1.0
    share_freedom: float = np.inf
    hidden: Array | float = 0.0
    least: float = 0.0

    @property
    def in_balance(self) -> Array:
        """(n,) variance of one reading as the balance feels it [N^2]."""
        return self.seen * self.share + self.hidden

    @property
    def seen(self) -> Array:
        """(n,) variance of one reading among its repeats [N^2]."""
        return self.variance - self.hidden


def reading_noise(campaign: Campaign, moments: Moments) -> Noise:
    """Return the noise of a reading: from repeats, else as declared, else left to the minimum."""
    n, least = moments.mean.shape[1], least_variance(moments)
    if moments.repeats:
        each = moments.scatter / moments.repeats
        if moments.repeats < MIN_REPEATS:
            each = np.full(n, each.mean())
        each = np.maximum(each, least)
        hidden = _hidden(moments, each)
        return Noise(each + hidden, NoiseSource.REPEATS, hidden=hidden, least=least)
    if all(c.force_error for c in campaign.cycles):
        # Who declares less than rounding makes has not declared it.
        declared = np.full(n, WEIGHED_NOISE**2)
        rounding = np.where(declared < moments.rounding, moments.rounding, 0.0)
        return Noise(declared + rounding, NoiseSource.DECLARED, least=least)
    return Noise(np.full(n, least), NoiseSource.MINIMUM, least=least)


def _hidden(moments: Moments, each: Array) -> Array:
    """Return (n,) the variance of rounding that all rows of a group have in common [N^2].

    As that of a row of weight 1, of which the mean of a group has as many as there are repeats.
    """
    typical = moments.typical_variance
    repeats = moments.rows.sum() / moments.groups
    hidden = hidden_variance(np.broadcast_to(moments.step, each.shape), each * typical)
    return np.asarray(hidden * repeats / typical)


def least_variance(moments: Moments) -> float:
    """Return a variance below which noise is not worth telling from rounding [N^2].

    A millionth of the forces. Against less, what the weights say would drown in rounding.
    """
    # Not from the sums, which cost a product of matrices.
    square = np.einsum("g,gi,gi->", moments.weight, moments.mean, moments.mean)
    return float(1e-12 * square / moments.mean.shape[1] / moments.weight.sum())


MIN_FIT_PROBABILITY = 1e-3  # probability below which a model does not fit


@dataclass(frozen=True)
class Structure:
    """How well shapes repeat over loads and signs.

    Attributes
    ----------
    chi2, degrees_of_freedom
        Of what pooled rows leave of the means of groups, in terms of the noise of repeats.
    probability
        Of a larger chi2 by chance.
    """

    chi2: float
    degrees_of_freedom: float
    probability: float

    @property
    def reduced(self) -> float:
        """chi2 over degrees of freedom."""
        return self.chi2 / self.degrees_of_freedom if self.degrees_of_freedom else float("nan")


def structure_of(moments: Moments, noise: Noise, samples: Sequence[Array]) -> Structure:
    """Test whether shapes repeat over loads and signs.

    Parameters
    ----------
    moments, noise
        The groups; the noise of a reading.
    samples
        Deviations of some rows from their repeats, in parts of (m, n) [N]: they tell how far
        readings depend on each other. None where nothing repeats.
    """
    pooling = (moments if moments.pooled else replace(moments, pooled=True)).pooling
    # Of what is left the squares alone: every mean less its part in the rows needs their room.
    whole = np.einsum("g,gi,gi->i", moments.weight, moments.mean, moments.mean)
    left = np.maximum(whole - np.sum(pooling.rows(moments.mean) ** 2, axis=0), 0.0)
    chi2 = float(left @ (1.0 / noise.variance))
    independent = independent_readings(samples, len(noise.variance))
    freedom = (moments.groups - pooling.count) * independent
    chi2 *= independent / len(noise.variance)
    if noise.source == NoiseSource.REPEATS:
        chi2 *= max(1.0 - 2.0 / moments.repeats, 0.0)  # 1 / s^2 of each is too large by as much
        known = moments.repeats * independent
        probability = f_sf(chi2 / max(freedom, 1.0), freedom, known)
    else:
        probability = chi2_sf(chi2, freedom)
    return Structure(chi2, freedom, float(probability) if freedom > 0 else 1.0)


def independent_readings(samples: Sequence[Array], n: int) -> float:
    """Return how many of n readings are as good as independent, by parts of (m, n) samples."""
    deviations = np.concatenate(samples) if samples else np.empty((0, n))
    m = len(deviations)
    if m < 2:
        return float(n)
    size = np.sqrt(np.mean(deviations**2, axis=0))  # 0 where rounding hides all noise
    scaled = np.divide(deviations, size, out=np.zeros_like(deviations), where=size > 0.0)
    # (tr C)^2 / tr C^2, less what chance alone makes of C between m rows.
    square = (
        float(np.sum((scaled @ scaled.T / m) ** 2))
        if m < n
        else float(np.sum((scaled.T @ scaled / m) ** 2))
    )
    return float(np.clip(n**2 / max(square - n * (n - 1) / m, 1.0), 1.0, n))


def pooled_where_it_fits(
    moments: Moments, noise: Noise, samples: Sequence[Array]
) -> tuple[Moments, Structure | None]:
    """Return the moments pooled over loads and signs where shapes repeat so, and the test.

    ``samples`` as in `structure_of`, (m, n) [N].

    None where nothing tells the noise of a reading, or there is no more than rounding, or nothing
    is to be pooled.
    """
    rounding = bool(np.any(noise.variance <= noise.least))
    if noise.source == NoiseSource.MINIMUM or rounding:
        return moments, None
    pooled = replace(moments, pooled=True)
    structure = structure_of(pooled, noise, samples)
    if structure.degrees_of_freedom <= 0:
        return moments, None
    return (pooled if structure.probability > MIN_FIT_PROBABILITY else moments), structure
