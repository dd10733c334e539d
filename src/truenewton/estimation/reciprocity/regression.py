"""The stiffness that a campaign measured, its noise, and the states of the mirror in it.

A stiffness regressed from shapes, its noise known: states whose residuals are all independent.

K_c = S_cz S_zz^-1 has noise of covariance N_c for rows, S_zz^-1 for columns. States V with
V'S_zz^-1 V = 1 and W'N W diagonal, N = D_alpha N_c D_alpha, both apart from rigid motions in these
metrics, have independent residuals; so the sums below are the likelihood itself.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy
import scipy.linalg
from numpy.typing import NDArray

from truenewton.arrays import Array
from truenewton.errors import RankDeficient
from truenewton.estimation.matrix.couplings import pair_ratios
from truenewton.estimation.matrix.misfits import condensed
from truenewton.estimation.readings.moments import Moments
from truenewton.estimation.reciprocity.information import States, Weights, equal_bins
from truenewton.estimation.reciprocity.sensor_model import Places, SensorModel, Values
from truenewton.linalg import singular_values_and_vectors

MAX_SINGLE_STATES = 100  # up to so many states have a bin each


@dataclass(frozen=True, eq=False)
class Regressed:
    """A stiffness by regression of forces on readings.

    Attributes
    ----------
    stiffness
        (n, n) K_c, commanded force per reading [N/m].
    square
        (n, n) S_zz, sum of z z' [m^2].
    noise
        (n, n) N_c, covariance of the force that a row of weight 1 leaves [N^2].
    noise_freedom
        Degrees of freedom from which the noise is known.
    bias_gradient
        Change of the bias magnets' force per displacement [N/m].
    coil_force
        (n,) COILGRAD times the mean force [N/m]: what K_c lacks at gain g is this times g - 1.
    """

    stiffness: Array
    square: Array
    noise: Array
    noise_freedom: float = np.inf
    bias_gradient: float = 0.0
    coil_force: Array | float = 0.0

    def at(self, values: Values) -> Array:
        """Return (n, n) D_alpha K_c, what magnets and coils change with the gap taken out [N/m]."""
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


# Shapes beyond the actuators, in terms of these, from which their misfit is noise.
MIN_SPARE_SHAPES = 0.25
# Amplitude of a motion in terms of the largest: below it shapes do not hold it.
MIN_AMPLITUDE = 1e-5


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
    if spare >= MIN_SPARE_SHAPES * n:
        noise = _noise(force - z @ stiffness.T, stiffness, variance, spare)
        freedom = float(spare * n)
    mean = (of_load.sum(axis=0) / of_load.sum()) @ rest
    return Regressed(stiffness, square, noise, freedom, bias_gradient, coil_gradient * mean)


def refuse_unheld(square: Array) -> None:
    """Raise RankDeficient where (n, n) S_zz lacks motions of the mirror."""
    n = len(square)
    amplitude = np.sqrt(np.maximum(np.linalg.eigvalsh(square), 0.0))
    missing = int(np.count_nonzero(amplitude <= MIN_AMPLITUDE * amplitude[-1]))
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


MAX_ROW_ASYMMETRY = 4.0  # times the median asymmetry of a row: beyond it an actuator is left free
MIN_ASYMMETRY_RATIO = 2.0  # times less asymmetry that a typical row has with one of them free
MAX_FREED_FRACTION = 0.03  # of the actuators, and two at least, may be left free


def odd_actuators(stiffness: Array, start: Array | None = None) -> NDArray[np.int64]:
    """Return which actuators of an (n, n) K_c are apart from the others; one more than may be left.

    Rows and columns are made alike, robustly, as far as one factor for each actuator can. While the
    asymmetry of a row stands out, or all have less without one of the worst, that one goes whose
    absence leaves least. ``start`` is the (n,) log alpha from symmetry, if known.
    """
    at, rest = np.arange(len(stiffness)), stiffness
    ratios = pair_ratios(stiffness)[0] if start is None else start
    found, size = list[int](), _asymmetry(stiffness, ratios)
    while len(found) <= max(2, int(MAX_FREED_FRACTION * len(stiffness))):
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
    """Return (n,) which actuators of K_c to keep; and, where too many are odd, all, with these."""
    odd = odd_actuators(stiffness, start)
    keep = np.ones(len(stiffness), dtype=bool)
    if len(odd) > max(2, int(MAX_FREED_FRACTION * len(stiffness))):
        return keep, tuple(odd.tolist())
    keep[odd] = False
    return keep, ()


def _asymmetry(stiffness: Array, ratios: Array) -> Array:
    """Return (n,) rms asymmetry of each row, made alike, in terms of a typical element."""
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
    """Return a regressed stiffness in which some of (n,) actuators are left free."""
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
    """Return the places of actuators that are kept of (n,), as (n, n) K_c lets the others move."""
    if keep.all():
        return places
    motion, changes = places.motion, places.changes
    if motion is not None:
        moved = condensed(stiffness, keep)[2]
        motion = motion[keep] @ moved
        changes = None if changes is None else changes[:, keep] @ moved
    return Places(places.x[keep], places.y[keep], places.nz[keep], motion, changes)
