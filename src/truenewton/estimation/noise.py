"""The noise of one reading: from repeats, as declared, or left to the fit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from truenewton.arrays import Array
from truenewton.estimation.diagnosis import NoiseSource
from truenewton.estimation.identifiability import ENOUGH_REPEATS
from truenewton.estimation.moments import Moments
from truenewton.estimation.repeats import WEIGHED_NOISE
from truenewton.estimation.rounding_steps import hidden_variance
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
        if moments.repeats < ENOUGH_REPEATS:
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
