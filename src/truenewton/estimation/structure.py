"""Whether shapes repeat over loads and signs, judged against their repeats.

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
from truenewton.estimation.diagnosis import NoiseSource
from truenewton.estimation.moments import Moments
from truenewton.estimation.noise import Noise

FITS = 1e-3  # probability below which a model does not fit


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
    return (pooled if structure.probability > FITS else moments), structure
