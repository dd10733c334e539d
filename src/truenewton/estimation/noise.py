"""The noise of one reading: from repeats, as declared, or left to the fit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from truenewton.arrays import Array
from truenewton.estimation.diagnosis import NoiseSource
from truenewton.estimation.identifiability import ENOUGH_REPEATS
from truenewton.estimation.moments import Moments
from truenewton.estimation.repeats import WEIGHED_NOISE
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
    least
        Variance below which it is not worth telling from rounding [N^2].
    """

    variance: Array
    source: NoiseSource
    share: float = 1.0
    share_freedom: float = np.inf
    least: float = 0.0

    @property
    def in_balance(self) -> Array:
        """(n,) variance of one reading as the balance feels it [N^2]."""
        return self.variance * self.share


def reading_noise(campaign: Campaign, moments: Moments) -> Noise:
    """Return the noise of a reading: from repeats, else as declared, else left to the minimum."""
    n, least = moments.mean.shape[1], least_variance(moments)
    if moments.repeats:
        each = moments.scatter / moments.repeats
        if moments.repeats < ENOUGH_REPEATS:
            each = np.full(n, each.mean())
        return Noise(np.maximum(each, least), NoiseSource.REPEATS, least=least)
    if all(c.force_error for c in campaign.cycles):
        return Noise(np.full(n, WEIGHED_NOISE**2), NoiseSource.DECLARED, least=least)
    return Noise(np.full(n, least), NoiseSource.MINIMUM, least=least)


def least_variance(moments: Moments) -> float:
    """Return a variance below which noise is not worth telling from rounding [N^2].

    A millionth of the forces. Against less, what the weights say would drown in rounding.
    """
    # Not from the sums, which cost a product of matrices.
    square = np.einsum("g,gi,gi->", moments.weight, moments.mean, moments.mean)
    return float(1e-12 * square / moments.mean.shape[1] / moments.weight.sum())
