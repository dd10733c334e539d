"""From influence to stiffness: the shell seen from its actuators alone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import qr

from truenewton.arrays import Array
from truenewton.errors import GeometryError


@dataclass(frozen=True, eq=False)
class Condensed:
    """What forces hold a free glass, the rest of it having been eliminated.

    Attributes
    ----------
    stiffness
        (n, n) K [N/m]; rigid motions cost nothing.
    reaction
        (n, 3) R; -R T_q are the forces that bear a load of resultants T_q with the actuators'
        points held still, apart from the load's own displacement.
    motion
        (3, n) rigid motion, as multiples of the tilts, that goes with displacements [1/m per m].
    """

    stiffness: Array
    reaction: Array
    motion: Array


def rigid_motions(x: Array, y: Array) -> Array:
    """Return T, (3, n): how a shallow shell moves as a whole, 1, x, y at (n,) places [-, m, m]."""
    return np.array([np.ones_like(x), x, y])


def condense(compliance: Array, tilts: Array) -> Condensed:
    """Turn influences, right for balanced forces, into the forces that hold displacements.

    Displacements z at the actuators, under a load that alone moves them by w_q and whose force and
    moments are T_q, take the forces f = K (z - w_q) - R T_q. K is symmetric to rounding where
    displacements are read just as forces act. Where sensors read it is not: a sensor sees another
    mean of the shape than the force does, z = S w, and K = K_w S^-1 with K_w, symmetric, the
    stiffness by the displacement w that the forces do work on.

    Inverts the bordered system [[G, T'], [T, 0]] (forces f and a rigid motion c such that
    G f + T' c = z and T f = 0) on the balanced forces alone.

    Parameters
    ----------
    compliance
        (n, n) G, displacement at the actuators per unit force [m/N], up to rigid motions.
    tilts
        (3, n) T, rows 1, x, y at the actuators [-, m, m]: the rigid motions, and the arms of the
        forces that the compliance is right for.

    Raises
    ------
    GeometryError
        Actuators on one line, or several at one place.
    """
    n = tilts.shape[1]
    if np.linalg.matrix_rank(tilts) < 3:
        raise GeometryError(
            f"the {n} actuators stand on one line and cannot hold a tilt",
            remedy="give at least three that do not",
        )
    basis, triangle = qr(tilts.T)
    balanced, arms = basis[:, 3:], np.linalg.solve(triangle[:3], basis[:, :3].T).T
    flexibility = balanced.T @ compliance @ balanced
    if n > 3 and np.linalg.cond(flexibility, 1) > 1e12:
        raise GeometryError(
            "two actuators stand at one place", remedy="correct the positions or drop one"
        )
    # The inverse, not a solve: balanced' tilts' = 0 then makes rigid motions free to rounding.
    stiffness: Array = balanced @ np.linalg.inv(flexibility) @ balanced.T
    motion = arms.T - (arms.T @ compliance) @ stiffness
    return Condensed(stiffness, arms - stiffness @ (compliance @ arms), motion)


def rearming(tilts: Array, arms: Array) -> Array:
    """Return the displacements of a sphere for those of a shallow shell, z = J w.

    A shallow shell is free to move as 1, x, y along the glass; a sphere is free to move as nz and
    the distances from the axis, the arms of the balance (`statics.arms`), 2.5 % from the former at
    the edge of LBT672. Only the rigid part of w is exchanged,

        J = 1 + (arms - tilts)' (T T')^-1 T

    so that J T' are the arms and what has no rigid part stays as it is. By virtual work the shell
    feels the forces J' f, balanced over the tilts just where f is over the arms. So with G of the
    shallow shell J G J' is the compliance to `condense` with the arms, and J w_q the influence of a
    load on what holds it. Without J, forces balanced over the arms leave the shell unbalanced, and
    whatever springs hold it shows in the result.

    Parameters
    ----------
    tilts, arms
        (3, n) T, rigid motions of the shallow shell, and what to put in their place.

    Returns
    -------
    numpy.ndarray
        (n, n) J.
    """
    return np.asarray(np.eye(tilts.shape[1]) + (arms - tilts).T @ np.linalg.pinv(tilts).T)
