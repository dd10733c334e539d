"""The stiffness that the groups of a campaign measured, and the noise that it leaves."""

from __future__ import annotations

import numpy as np
import scipy

from truenewton.arrays import Array
from truenewton.errors import RankDeficient
from truenewton.estimation.moments import Moments
from truenewton.estimation.reciprocity.known_noise import Regressed
from truenewton.linalg import singular_values_and_vectors

SPARE = 0.25  # shapes beyond the actuators, in terms of these, from which their misfit is noise
UNHELD = 1e-5  # amplitude of a motion in terms of the largest: below it shapes do not hold it


def regressed(
    moments: Moments, variance: Array, *, bias_gradient: float = 0.0, coil_gradient: float = 0.0
) -> Regressed:
    """Regress force on displacement, both about their means under each load.

    The noise of the force that a row leaves has two parts, of forces and of positions,

        N_c = a diag(s_i^2) + b K_c K_c'

    of which what the regression leaves tells the sizes, along the singular vectors of K_c. What it
    leaves of sums of forces and torques beyond that is added: a mirror that trembles as a whole
    does so against the air film, whose force all actuators bear together.

    Parameters
    ----------
    moments
        With displacements; forces are c (1 + COILGRAD z) [N].
    variance
        (n,) s_i^2, of one force reading of weight 1 [N^2].
    bias_gradient, coil_gradient
        BIASGRAD [N/m], COILGRAD [1/m].

    Raises
    ------
    RankDeficient
        No POSITION, too few shapes, or motions that none of them holds.
    """
    if moments.displacement is None:
        raise RankDeficient(
            "reciprocity needs POSITION in every cycle file",
            remedy="record what the sensors read",
        )
    weight, n = moments.weight, moments.mean.shape[1]
    of_load = moments.of_load * weight[:, None]
    share = of_load / of_load.sum(axis=0)
    root = np.sqrt(weight)[:, None]
    rest = share.T @ moments.mean
    force = root * (moments.mean - moments.of_load @ rest)
    z = root * (moments.displacement - moments.of_load @ (share.T @ moments.displacement))
    square = z.T @ z
    refuse_unheld(square)
    stiffness = np.linalg.solve(square, z.T @ force).T
    spare = moments.groups - len(moments.loads) - n
    noise, freedom = np.diag(variance), float(max(moments.repeats, 1) * n)
    if spare >= SPARE * n:
        noise = _noise(force - z @ stiffness.T, stiffness, variance, spare)
        freedom = float(spare * n)
    mean = (of_load.sum(axis=0) / of_load.sum()) @ rest
    return Regressed(stiffness, square, noise, freedom, bias_gradient, coil_gradient * mean)


def refuse_unheld(square: Array) -> None:
    """Raise RankDeficient where (n, n) S_zz lacks motions of the mirror."""
    n = len(square)
    amplitude = np.sqrt(np.maximum(np.linalg.eigvalsh(square), 0.0))
    missing = int(np.count_nonzero(amplitude <= UNHELD * amplitude[-1]))
    if missing:
        raise RankDeficient(
            f"no shape holds {missing} of {n} motions of the mirror",
            remedy="take shapes that span all stiffness modes and the rigid motions",
            got=n - missing,
            want=n,
        )


def _noise(left: Array, stiffness: Array, variance: Array, spare: int) -> Array:
    """Return (n, n) N_c from (g, n) what the regression leaves."""
    vectors, values, _ = singular_values_and_vectors(stiffness)
    found = np.sum((left @ vectors) ** 2, axis=0) / spare
    terms = np.stack([variance @ vectors**2, values**2], axis=1)
    expected = np.full(len(found), found.mean())
    for _ in range(20):  # each is known in proportion to itself
        unit = terms / expected[:, None]
        size = np.linalg.norm(unit, axis=0)
        shares = scipy.optimize.nnls(unit / size, found / expected)[0] / size
        expected = np.maximum(terms @ shares, 1e-3 * found.mean())
    noise = np.diag(shares[0] * variance) + shares[1] * stiffness @ stiffness.T
    # What moves nothing balances: sums of forces and torques, which actuators may have in common.
    balance = vectors[:, -3:]
    apart = left @ balance
    beyond, axes = np.linalg.eigh(apart.T @ apart / spare - balance.T @ noise @ balance)
    axes = balance @ axes
    return np.asarray(noise + (axes * np.maximum(beyond, 0.0)) @ axes.T)
