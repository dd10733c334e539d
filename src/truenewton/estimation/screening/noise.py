"""Noise of one reading, and whether shapes repeat over loads and signs.

If they do, the residuals of the means of groups from pooled rows, c - U y (`moments.Pooling`), are
noise:

    chi^2 = sum r (c - U y)^2 / s^2,        n (g - R) degrees of freedom,

with s^2 from the repeats. Dependent readings, as those of a mirror that moves as a whole, have
fewer: with their correlation matrix C, (tr C)^2 / tr C^2 a row instead of n.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from truenewton.arrays import Array
from truenewton.chance import chi2_sf, f_sf
from truenewton.estimation.findings.code import LIMITS
from truenewton.estimation.findings.estimate import NoiseSource
from truenewton.estimation.paper.identifiability import MIN_REPEATS
from truenewton.estimation.readings.moments import Moments, hidden_variance
from truenewton.estimation.readings.rows import WEIGHED_NOISE
from truenewton.records.campaign import Campaign


@dataclass(frozen=True, eq=False)
class Noise:
    """Variance of one reading of weight 1, and its source."""

    variance: Array  # (n,) [N^2]
    source: NoiseSource  # if the minimum, only its shape is known, and the fit gives its size
    # part that reaches the balance, relative to independent actuators: less than 1 if the mirror's
    # own motion makes part of it, more if many actuators share noise
    share: float = 1.0
    share_freedom: float = np.inf  # degrees of freedom of the share
    hidden: Array | float = 0.0  # (n,) part that repeats do not show: common rounding [N^2]
    least: float = 0.0  # variance below which it is not distinguished from rounding [N^2]

    @cached_property
    def in_balance(self) -> Array:
        """(n,) variance of one reading in the balance [N^2]."""
        return self.seen * self.share + self.hidden

    @cached_property
    def seen(self) -> Array:
        """(n,) variance of one reading among its repeats [N^2]."""
        return self.variance - self.hidden


def reading_noise(campaign: Campaign, moments: Moments) -> Noise:
    """Return the noise of a reading: from repeats, as declared, or from the minimum."""
    n = moments.mean.shape[1]
    # A millionth of the forces, not from the sums, which cost a product of matrices. Less is not
    # distinguished from rounding, in which the weights would be lost.
    square = np.einsum("g,gi,gi->", moments.weight, moments.mean, moments.mean)
    least = float(1e-12 * square / n / moments.weight.sum())
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
    """Return (n,) variance of rounding that all rows of a group have in common [N^2].

    As that of a row of weight 1, of which the mean of a group has as many as there are repeats.
    """
    typical = moments.typical_variance
    repeats = moments.rows.sum() / moments.groups
    hidden = hidden_variance(np.broadcast_to(moments.step, each.shape), each * typical)
    return np.asarray(hidden * repeats / typical)


@dataclass(frozen=True)
class Structure:
    """Whether shapes repeat over loads and signs."""

    chi2: float  # of the residuals of the means of groups, in terms of the noise of repeats
    degrees_of_freedom: float
    probability: float  # of a larger chi2 by chance

    @property
    def reduced(self) -> float:
        """chi2 over degrees of freedom."""
        return self.chi2 / self.degrees_of_freedom if self.degrees_of_freedom else float("nan")


def structure_of(moments: Moments, noise: Noise, samples: Sequence[Array]) -> Structure:
    """Test whether shapes repeat over loads and signs.

    ``samples`` are deviations of some rows from their repeats, in parts of (m, n) [N], which show
    how far readings depend on each other.
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
    """Return the effective number of independent readings, by parts of (m, n) samples."""
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
    """Return the moments, pooled over loads and signs if shapes repeat so, and the test.

    ``samples`` as in `structure_of`, (m, n) [N]. The test is None if the noise of a reading is not
    known or only rounding, or if there is nothing to pool.
    """
    rounding = bool(np.any(noise.variance <= noise.least))
    if noise.source == NoiseSource.MINIMUM or rounding:
        return moments, None
    pooled = replace(moments, pooled=True)
    structure = structure_of(pooled, noise, samples)
    if structure.degrees_of_freedom <= 0:
        return moments, None
    return (pooled if structure.probability > LIMITS.fit_probability else moments), structure
