"""A stiffness matrix alone: states from its singular vectors, their noise from what is left.

The modes, stiffest first, stand in bins of equal number. Residuals of a pair of bins share one
variance: their mean square, over 1 less the mean leverage, since a fit takes part of them up.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from truenewton.arrays import Array
from truenewton.estimation.reciprocity.blocks import Residuals
from truenewton.estimation.reciprocity.information import Leverage
from truenewton.estimation.reciprocity.sight import Places, Sight
from truenewton.estimation.reciprocity.states import States, Weights, equal_bins
from truenewton.estimation.reciprocity.unknowns import Values

MOST_BINS = 12
FEWEST = 8  # modes in a bin
ENOUGH = 20  # modes in a bin, from which on each of three equations tells its own noise
MOST_TAKEN = 0.95  # of a block of residuals, by a fit: beyond, too little is left to tell noise
# Of the variance of the quietest pair with the same mode, what is rigid has at least so much: gains
# and offsets of a small mirror can fit rigid motions without any rest.
QUIETEST = 0.01
AT_ONCE = 8  # times; from then on variances go half the way, which ends what swings to and fro
ROUNDING = 1e-12  # of the forces: no residual is less noisy


@dataclass(eq=False)
class BinnedNoise:
    """States of a stiffness, and their noise as the last residuals have it.

    Attributes
    ----------
    stiffness
        (n, n) K_c, of the modes that are used alone [N/m].
    readings
        (n, m) V, as read; stiffest first.
    balance
        Whether statics alone counts.
    leverage
        Of the last fit; None at first.
    times, before
        How often the noise was taken; the variances of the last time.
    latest
        The last unknowns and states.
    """

    stiffness: Array
    readings: Array
    balance: bool = False
    leverage: Leverage | None = field(default=None)
    times: int = field(default=0)
    before: tuple[Array, Array, Array] | None = field(default=None)
    latest: tuple[Values, States] | None = field(default=None)

    def told(self, leverage: Leverage) -> None:
        """Take the leverages of a fit over."""
        self.leverage = leverage

    def __call__(self, places: Places, values: Values, seen: Sight) -> tuple[States, Weights]:
        """Return states and weights at some values."""
        states = self.states(places, values, seen)
        weights = self.weights(states)
        return states, weights.of_balance if self.balance else weights

    def states(self, places: Places, values: Values, seen: Sight) -> States:
        """Return the states, W'W as it comes and Q orthonormal."""
        true = values.alpha[:, None] * self.stiffness
        if self.latest is not None and values.same_sensors(self.latest[0]):
            states = self.latest[1]  # alpha alone changes, and with it the forces
            forces, rigid_forces = true @ states.readings, true @ states.rigid_readings
            return replace(states, forces=forces, rigid_forces=rigid_forces)
        rigid, triangle = np.linalg.qr(places.rigid)
        turn = np.linalg.inv(triangle)
        rigid_readings = places.rigid_readings(values) @ turn
        moved = seen.motion @ (values.gain[:, None] * self.readings)
        apart = moved - rigid @ (rigid.T @ moved)
        displaced = _dual(apart)
        basis = np.linalg.qr(rigid_readings)[0]
        dual = _dual(self.readings - basis @ (basis.T @ self.readings))
        states = States(
            readings=self.readings,
            forces=true @ self.readings,
            displacements=moved,
            rigid_readings=rigid_readings,
            rigid_forces=true @ rigid_readings,
            turn=turn,
            rigid=rigid,
            displaced=displaced,
            balancing=rigid - displaced @ (moved.T @ rigid),
            dual=dual,
        )
        self.latest = (values, states)
        return states

    def weights(self, states: States) -> Weights:
        """Return weights from what the states leave now, and from the leverages of the last fit."""
        work = states.displacements.T @ states.forces
        left = Residuals(
            states.rigid.T @ states.forces, states.displacements.T @ states.rigid_forces, work
        )
        bins = equal_bins(states.count, min(MOST_BINS, states.count // FEWEST))
        sizes = np.array([some.stop - some.start for some in bins])
        starts = [some.start for some in bins]
        pairs = np.outer(sizes, sizes) - np.diag(sizes)
        taken = self.leverage or Leverage(
            np.zeros((3, len(bins))), np.zeros((len(bins), 3)), np.zeros((len(bins),) * 2)
        )
        square = np.add.reduceat(
            np.add.reduceat(left.reciprocity**2, starts, axis=0), starts, axis=1
        )
        # of the diagonal bins half the pairs; off it the leverage of a pair of bins stands whole
        of_pair = taken.reciprocity * (1.0 + np.eye(len(bins)))
        variance = square / _left(pairs, of_pair)
        statics = np.add.reduceat(left.statics**2, starts, axis=1) / _left(sizes, taken.statics)
        rigid = np.add.reduceat(left.rigid**2, starts, axis=0) / _left(sizes[:, None], taken.rigid)
        variance = np.maximum(variance, ROUNDING**2 * np.mean(np.diagonal(work) ** 2))
        if sizes.min() < ENOUGH:
            statics = np.repeat(statics.mean(axis=0, keepdims=True), 3, axis=0)
            rigid = np.repeat(rigid.mean(axis=1, keepdims=True), 3, axis=1)
        least = QUIETEST * variance.min(axis=0)
        found = (np.maximum(statics, least), np.maximum(rigid, least[:, None]), variance)
        if self.times > AT_ONCE and self.before is not None:
            found = tuple(np.sqrt(one * old) for one, old in zip(found, self.before, strict=True))
        self.times, self.before = self.times + 1, found
        statics, rigid, variance = found
        return Weights(
            statics=np.repeat(1.0 / statics, sizes, axis=1),
            rigid=np.repeat(1.0 / rigid, sizes, axis=0),
            reciprocity=1.0 / variance,
            bins=bins,
            share=shares(variance, sizes),
        )


def shares(variance: Array, sizes: NDArray[np.int64]) -> Array:
    """Return (m, m) variances of T over those of A, by (b, b) variances of A between bins.

    The variance of T_lm is r_l c_m: so those of T_lm and T_ml have the sum that A has, and the
    product that the bins of l and m have by themselves. The force of the noisier state has more.
    """
    own = np.diag(variance)
    half = 0.5 * variance
    apart = np.sqrt(np.maximum(half**2 - 0.25 * np.outer(own, own), 0.0))
    share = (half + np.where(own > own[:, None], apart, -apart)) / variance
    return np.asarray(np.repeat(np.repeat(share, sizes, axis=0), sizes, axis=1))


def _dual(basis: Array) -> Array:
    """Return (n, m) D in the span of a basis B, D'B = 1."""
    return np.asarray(scipy.linalg.solve(basis.T @ basis, basis.T, assume_a="pos").T)


def _left(count: Array, taken: Array) -> Array:
    """Return how many residuals a fit leaves of so many."""
    return np.asarray(count * (1.0 - np.minimum(taken / count, MOST_TAKEN)))
