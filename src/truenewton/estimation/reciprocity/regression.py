"""The stiffness that a campaign measured, its noise, and the states of the mirror in it.

K_c = C_cz C_zz^-1 (C_zz: `square`) has errors of covariance N_c between rows, C_zz^-1 between
columns. States V with V'C_zz^-1 V = 1 and diagonal W'N W, N = D_alpha N_c D_alpha, both orthogonal
to rigid motions in these metrics, have independent residuals, so the sums are the likelihood.

Actuators and sensors that do not obey reciprocity are left free before any fit. A stiffness in
which set B exerts no force does not depend on the alpha and the sensors of B, whatever these read:

    K <- K_GG - K_GB K_BB^-1 K_BG
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy
import scipy.linalg
from numpy.typing import NDArray

from truenewton.arrays import Array
from truenewton.errors import RankDeficient
from truenewton.estimation.findings.code import LIMITS
from truenewton.estimation.matrix.couplings import pair_ratios
from truenewton.estimation.matrix.misfits import condensed
from truenewton.estimation.readings.moments import Moments
from truenewton.estimation.reciprocity.information import States, Weights, equal_bins
from truenewton.estimation.reciprocity.sensor_model import Places, SensorModel, Values
from truenewton.linalg import singular_values_and_vectors

MAX_SINGLE_STATES = 100  # up to this number, each state has its own bin


@dataclass(frozen=True, eq=False)
class Regressed:
    """A stiffness by regression of forces on readings."""

    stiffness: Array  # (n, n) K_c, commanded force per reading [N/m]
    square: Array  # (n, n) C_zz, sum of z z' [m^2]
    noise: Array  # (n, n) N_c, residual covariance of the force of a row of weight 1 [N^2]
    noise_freedom: float = np.inf  # degrees of freedom of the noise
    bias_gradient: float = 0.0  # of the bias magnets' force [N/m]
    # (n,) COILGRAD times mean force [N/m]; K_c lacks it times g - 1
    coil_force: Array | float = 0.0

    def at(self, values: Values) -> Array:
        """Return (n, n) D_alpha K_c without the gradients of magnets and coils [N/m]."""
        gain = values.gain
        true = values.alpha[:, None] * self.stiffness
        change = values.alpha * self.coil_force * (gain - 1.0) + self.bias_gradient * gain
        true[np.diag_indices(len(gain))] += change
        return np.asarray(true)

    def states(self, places: Places, values: Values, seen: SensorModel) -> tuple[States, Weights]:
        """Return the states, stiffest first, and the weights of their residuals."""
        n, true = places.n, self.at(values)
        noise = values.alpha[:, None] * self.noise * values.alpha
        try:
            root = np.linalg.cholesky(self.square)
        except np.linalg.LinAlgError:
            raise RankDeficient(
                "the positions of too few shapes that balance differ",
                remedy="see the warnings of ml for what does not balance, or add shapes",
            ) from None
        basis, triangle = np.linalg.qr(
            scipy.linalg.solve_triangular(root, places.rigid_readings(values), lower=True),
            mode="complete",
        )
        turn = np.linalg.inv(triangle[:3])
        rigid_readings, readings = root @ basis[:, :3], root @ basis[:, 3:]
        rigid = places.rigid
        rigid = rigid @ np.linalg.inv(np.linalg.cholesky(rigid.T @ noise @ rigid)).T
        moved = seen.motion @ (values.gain[:, None] * readings)
        moved -= rigid @ (rigid.T @ (noise @ moved))
        size, turned = np.linalg.eigh(moved.T @ noise @ moved)
        readings, moved = readings @ turned, moved @ turned
        states = States(
            readings=readings,
            forces=true @ readings,
            displacements=moved,
            rigid_readings=rigid_readings,
            rigid_forces=true @ rigid_readings,
            turn=turn,
            rigid=rigid,
            displaced=noise @ moved / size,
            balancing=noise @ rigid,
            dual=scipy.linalg.cho_solve((root, True), readings),
        )
        bins = equal_bins(n - 3, n - 3 if n <= MAX_SINGLE_STATES else 12)
        of_bin = np.array([np.exp(np.mean(np.log(size[some]))) for some in bins])
        weights = Weights(
            statics=np.ones((3, n - 3)),
            rigid=np.repeat(1.0 / size[:, None], 3, axis=1),
            reciprocity=1.0 / (of_bin[:, None] + of_bin),
            bins=bins,
            share=size[:, None] / (size[:, None] + size),
            exact=1.0 / (size[:, None] + size),
        )
        return states, weights


# Shapes in excess of actuators, relative to these, if noise is to follow from their misfit.
MIN_SPARE_SHAPES = 0.25
MIN_AMPLITUDE = 1e-5  # of a motion relative to the largest; below, shapes do not contain it


def regressed(
    moments: Moments, variance: Array, *, bias_gradient: float = 0.0, coil_gradient: float = 0.0
) -> Regressed:
    """Regress force on displacement, both relative to their means under each load.

    The noise of the force of a row has two parts, of forces and of positions,

        N_c = eta_c diag(s_i^2) + eta_z K_c K_c'

    whose factors follow from the residuals of the regression along the singular vectors of K_c.
    Additional noise of the sums of forces and torques is added: a mirror that vibrates as a whole
    does so against the air film, whose force all actuators share.

    ``moments`` contain displacements; their forces are c (1 + COILGRAD z) [N]. ``variance`` is the
    (n,) s_i^2 of one force reading of weight 1 [N^2]. BIASGRAD is in [N/m], COILGRAD in [1/m].

    Raises
    ------
    RankDeficient
        No POSITION, too few shapes, or motions that no shape contains.
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
    if spare >= MIN_SPARE_SHAPES * n:
        noise = noise_of_rows(force - z @ stiffness.T, stiffness, variance, spare)
        freedom = float(spare * n)
    mean = (of_load.sum(axis=0) / of_load.sum()) @ rest
    return Regressed(stiffness, square, noise, freedom, bias_gradient, coil_gradient * mean)


def refuse_unheld(square: Array) -> None:
    """Raise RankDeficient if (n, n) C_zz lacks motions of the mirror."""
    n = len(square)
    amplitude = np.sqrt(np.maximum(np.linalg.eigvalsh(square), 0.0))
    missing = int(np.count_nonzero(amplitude <= MIN_AMPLITUDE * amplitude[-1]))
    if missing:
        raise RankDeficient(
            f"no shape contains {missing} of {n} motions of the mirror",
            remedy="take shapes that span all stiffness modes and the rigid motions",
        )


def noise_of_rows(left: Array, stiffness: Array, variance: Array, spare: float) -> Array:
    """Return (n, n) N_c from the (g, n) residuals of the regression."""
    vectors, values, _ = singular_values_and_vectors(stiffness)
    found = np.sum((left @ vectors) ** 2, axis=0) / spare
    shares = variance_shares(np.stack([variance @ vectors**2, values**2], axis=1), found)
    noise = np.diag(shares[0] * variance) + shares[1] * stiffness @ stiffness.T
    # What moves nothing balances: sums of forces and torques, which actuators may have in common.
    balance = vectors[:, -3:]
    apart = left @ balance
    beyond, axes = np.linalg.eigh(apart.T @ apart / spare - balance.T @ noise @ balance)
    axes = balance @ axes
    return np.asarray(noise + (axes * np.maximum(beyond, 0.0)) @ axes.T)


def variance_shares(terms: Array, squares: Array) -> Array:
    """Return (k,) factors of (m, k) terms whose sums are the variances of (m,) squares."""
    expected = np.full(len(squares), squares.mean())
    for _ in range(20):  # each is known in proportion to itself
        unit = terms / expected[:, None]
        size = np.linalg.norm(unit, axis=0)
        shares = scipy.optimize.nnls(unit / size, squares / expected)[0] / size
        expected = np.maximum(terms @ shares, 1e-3 * squares.mean())
    return np.asarray(shares)


MAX_ROW_ASYMMETRY = 4.0  # relative to the median row: beyond, an actuator is left free
MIN_ASYMMETRY_RATIO = 2.0  # of the median row, with and without one of them


def odd_actuators(stiffness: Array, start: Array | None = None) -> NDArray[np.int64]:
    """Return which actuators of an (n, n) K_c are unlike the others; one more than may be free.

    Rows and columns are matched robustly with one factor for each actuator. An actuator is left out
    if the asymmetry of its row stands out, or if all rows have less without it; among the worst,
    the one whose absence leaves least. ``start`` is the (n,) log alpha from symmetry, if known.
    """
    at, rest = np.arange(len(stiffness)), stiffness
    ratios = pair_ratios(stiffness)[0] if start is None else start
    found, size = list[int](), _asymmetry(stiffness, ratios)
    while len(found) <= _max_free(len(stiffness)):
        worst = np.argsort(-size)
        # Neighbours of a bad actuator stand out as well; one that yields can be free.
        tried = worst[rest.diagonal()[worst] != 0.0][:8]
        if not tried.size:
            break
        left, alike = list[Array](), list[Array]()
        for k in tried.tolist():
            alike.append(pair_ratios(_without(rest, k), np.delete(ratios, k))[0])
            left.append(_asymmetry(_without(rest, k), alike[-1]))
        best = int(np.argmin([np.sum(each**2) for each in left]))
        usual = np.median(size)
        if not (
            size.max() > MAX_ROW_ASYMMETRY * usual
            or usual > MIN_ASYMMETRY_RATIO * np.median(left[best])
        ):
            break
        found.append(int(at[tried[best]]))
        at, rest = np.delete(at, tried[best]), _without(rest, int(tried[best]))
        size, ratios = left[best], alike[best]
    return np.sort(np.array(found, dtype=np.int64))


def kept(stiffness: Array, start: Array | None = None) -> tuple[NDArray[np.bool_], tuple[int, ...]]:
    """Return which (n,) actuators of K_c to keep; all, and the odd ones, if too many are odd."""
    odd = odd_actuators(stiffness, start)
    keep = np.ones(len(stiffness), dtype=bool)
    if len(odd) > _max_free(len(stiffness)):
        return keep, tuple(odd.tolist())
    keep[odd] = False
    return keep, ()


def _max_free(n: int) -> int:
    """Return how many of n actuators may be left free."""
    return max(2, int(LIMITS.bad_fraction * n))


def _asymmetry(stiffness: Array, ratios: Array) -> Array:
    """Return (n,) rms asymmetry of each matched row, relative to a typical element."""
    alike = np.exp(ratios)[:, None] * stiffness
    own = np.median(np.abs(alike), axis=1)  # that of a bad one may be anything
    typical = np.median(own) or np.inf  # 0 where most do not feel each other
    return np.asarray(np.sqrt(np.mean((alike - alike.T) ** 2, axis=1)) / typical)


def _without(stiffness: Array, k: int) -> Array:
    """Return (n - 1, n - 1) stiffness with actuator k free."""
    keep = np.arange(len(stiffness)) != k
    taken = np.outer(stiffness[keep, k], stiffness[k, keep]) / stiffness[k, k]
    return np.asarray(stiffness[np.ix_(keep, keep)] - taken)


def condensed_regression(regressed: Regressed, keep: NDArray[np.bool_]) -> Regressed:
    """Return a regressed stiffness in which some of (n,) actuators are free."""
    if keep.all():
        return regressed
    stiffness, left, right = condensed(regressed.stiffness, keep)
    return replace(
        regressed,
        stiffness=stiffness,
        square=np.linalg.inv(right.T @ np.linalg.solve(regressed.square, right)),
        noise=left @ regressed.noise @ left.T,
        coil_force=np.broadcast_to(regressed.coil_force, keep.shape)[keep],
    )


def kept_places(places: Places, keep: NDArray[np.bool_], stiffness: Array) -> Places:
    """Return the positions of (n,) actuators kept, as (n, n) K_c lets the others move."""
    if keep.all():
        return places
    motion, changes = places.motion, places.changes
    if motion is not None:
        moved = condensed(stiffness, keep)[2]
        motion = motion[keep] @ moved
        changes = None if changes is None else changes[:, keep] @ moved
    return Places(places.x[keep], places.y[keep], places.nz[keep], motion, changes)
