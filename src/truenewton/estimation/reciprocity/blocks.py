"""The three blocks of equations that a true stiffness obeys, and the likeliest true forces.

S = Q'F                  statics: forces of a free shell balance            (3 x m)
t = W'D_alpha K_c z_R    rigid motions cost no force                        (m x 3)
A = T - T', T = W'F      reciprocity: virtual work of each state's displacement on the other's
                         force is the same                                  m (m - 1) / 2
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from truenewton.arrays import Array
from truenewton.estimation.reciprocity.states import States, Weights


@dataclass(frozen=True, eq=False)
class Residuals:
    """What the equations leave.

    Attributes
    ----------
    statics, rigid, work
        (3, m) S, (m, 3) t, (m, m) T.
    """

    statics: Array
    rigid: Array
    work: Array

    @property
    def reciprocity(self) -> Array:
        """(m, m) A."""
        return np.asarray(self.work - self.work.T)

    def chi2(self, weights: Weights) -> tuple[float, float, float]:
        """Return the weighted sums of squares of S, t and A."""
        pairs = weights.of_pairs * self.reciprocity**2
        return (
            float(np.sum(weights.statics * self.statics**2)),
            float(np.sum(weights.rigid * self.rigid**2)),
            float(0.5 * np.sum(pairs)),
        )


def residuals(states: States) -> Residuals:
    """Return what the states leave of the equations."""
    w = states.displacements
    return Residuals(states.rigid.T @ states.forces, w.T @ states.rigid_forces, w.T @ states.forces)


@dataclass(frozen=True, eq=False)
class Likeliest:
    """The likeliest true forces of the states, which obey the equations.

    Attributes
    ----------
    forces
        (n, m) F^: Q'F^ = 0, W'F^ symmetric.
    by_reading
        (n, m) true work on each state by a reading at each sensor: (D_alpha K_c^)' W.
    """

    forces: Array
    by_reading: Array


def likeliest(states: States, left: Residuals, weights: Weights) -> Likeliest:
    """Return the likeliest forces: what is wrong with the measured ones is shared by variance."""
    share = 0.5 if weights.share is None else weights.share
    forces, work = states.forces, left.work
    if weights.statics.any():  # what is not asked for corrects nothing
        forces = forces - states.balancing @ left.statics
    if weights.reciprocity.any():
        correction = -share * left.reciprocity
        forces, work = forces + states.displaced @ correction, work + correction
    return Likeliest(forces, states.dual @ work.T)
