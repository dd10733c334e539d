"""True stiffness: true Newtons per true displacement, consistent with statics.

Of a measured stiffness K_c, where true force = alpha x commanded and true displacement = gain x
reading,

    K = diag(alpha) K_c diag(1/gain) H^-1

with H from displacements under the sensors to those of the magnets, by a model of the glass, or by
the places of the sensors and a thin plate; 1 if neither is known. K is symmetric (Maxwell, Betti).
Forces of a free shell balance and its rigid motions do not bend it, so rigid motions R (the rows of
the arms) are not coupled to the rest Q, except by uneven bias magnets:

    K = R (R'KR) R' + Q K Q,    Q = 1 - R R'

A coupling is an error, of alpha (forces R'K do not balance) or of the gains (K R needs force), and
is removed if alpha is known. That brings the modes nearer to the truth: on simulated P45 by 2 to 10
per cent on average, and in each of 60 campaigns; on the measured LBT672, compared with an
independent shell model, by up to a third for the softest (docs/modes.md).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.linalg
from numpy.typing import NDArray
from scipy.linalg import lu_factor, lu_solve

from truenewton.arrays import Array, freeze
from truenewton.calibration.result import Calibration
from truenewton.errors import CampaignMismatch, FormatError, RankDeficient, UnknownName
from truenewton.estimation.matrix.screen import as_calibrated
from truenewton.estimation.reciprocity.sensor_model import Places, motion_from, places_of
from truenewton.linalg import ROWS_AT_ONCE, symmetrised
from truenewton.records.segmented import refuse_segments
from truenewton.records.stiffness_matrix import StiffnessMatrix
from truenewton.rounding import counted
from truenewton.statics.arms import arms, arms_in_units_of_rms, effective_weight, external_load
from truenewton.statics.layout import Layout
from truenewton.statics.modes import StiffnessModes, stiffness_modes

MIN_ACTUATORS = 4  # three would leave rigid motions only


def off_and_slaved(
    layout: Layout, off: Sequence[int], slaved: Sequence[int]
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return (n,) which actuators are off and (n,) which are slaved; refuse invalid IDs."""
    ids = layout.id.tolist()
    for name in (*off, *slaved):
        if name not in ids:
            raise UnknownName(
                f"there is no actuator {name} that is enabled",
                remedy=f"give IDs, whole numbers from {min(ids)} to {max(ids)}",
            )
    if both := sorted({*off} & {*slaved}):
        raise UnknownName(f"actuator {both[0]} is both off and slaved", remedy="name it once")
    floats, follows = np.isin(layout.id, off), np.isin(layout.id, slaved)
    commanded = int(np.count_nonzero(~(floats | follows)))
    if commanded < MIN_ACTUATORS:
        raise RankDeficient(
            f"only {counted(commanded, 'actuator')} of {layout.n} left to command",
            remedy=f"leave {MIN_ACTUATORS} at least",
        )
    return floats, follows


def _matched_alpha(layout: Layout, instrument: str, calibration: Calibration | None) -> Array:
    """Return (n,) alpha of the actuators of a mirror by their IDs; 1 without calibration."""
    if calibration is None:
        return np.ones(layout.n)
    remedy = "give the calibration of the same mirror"
    if calibration.instrument != instrument:
        raise CampaignMismatch(
            f"the stiffness is of {instrument}, the calibration of {calibration.instrument}",
            remedy=remedy,
        )
    theirs = calibration.layout
    at = indices_of(theirs, layout.id)
    unknown = (theirs.id[at] != layout.id) | ~np.isfinite(calibration.alpha[at])
    if unknown.any():
        raise CampaignMismatch(
            f"the calibration has no alpha for actuator {layout.id[unknown][0]}",
            remedy="calibrate all actuators that the stiffness has enabled",
        )
    if apart := theirs.part(at).other_actuators(layout):
        raise CampaignMismatch(f"stiffness and calibration disagree on {apart}", remedy=remedy)
    return np.asarray(calibration.alpha[at])


def indices_of(layout: Layout, names: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return (k,) indices in a layout of (k,) IDs; an arbitrary one if an ID does not exist."""
    order = np.argsort(layout.id)
    at = np.searchsorted(layout.id, names, sorter=order)
    return np.asarray(order[np.minimum(at, layout.n - 1)])


@dataclass(frozen=True, eq=False)
class TrueStiffness:
    """Stiffness of the m commanded actuators of n enabled ones.

    Attributes
    ----------
    layout
        The m commanded actuators: enabled, neither off nor slaved.
    calibrated
        Whether alpha is known.
    enabled, acts
        The n enabled actuators; (n,) false where one is off.
    followers
        (n - m, m) displacements of the others per displacement of each commanded one.
    floating
        (n - a, n) displacements of those that are off per displacement of each of a that act.
    acting_stiffness
        (n, n) true force per displacement if slaved actuators were commanded too: the feed-forward
        of all actuators that act; 0 for those that are off [N/m].
    enabled_alpha
        (n,) true Newton / commanded Newton of the enabled; 1 without calibration.
    enabled_gain
        (n,) true displacement / reading of the enabled; 1 if not known.
    enabled_offset
        (2, n) x and y of their magnets less their sensors; 0 if not known [m].
    places
        Of the enabled, with the model of the glass if there is one.
    asymmetry
        |K - K'| / |K + K'| of the whole matrix before it was made symmetric.
    actuator_asymmetry
        (n,) the same of the row and column of each enabled actuator.
    column_factor
        (n,) columns relative to what symmetry requires; NaN without calibration.
    imbalance
        Norm of the coupling of rigid motions to the rest, over that of K; removed if calibrated.
    """

    layout: Layout
    calibrated: bool
    enabled: Layout
    acts: NDArray[np.bool_]
    followers: Array
    floating: Array
    acting_stiffness: Array
    enabled_alpha: Array
    enabled_gain: Array
    enabled_offset: Array
    places: Places
    asymmetry: float
    actuator_asymmetry: Array
    column_factor: Array
    imbalance: float

    def __post_init__(self) -> None:
        freeze(self, "followers", "floating", "acting_stiffness", "enabled_alpha", "enabled_gain",
               "enabled_offset", "actuator_asymmetry", "column_factor")  # fmt: skip

    @property
    def commanded(self) -> NDArray[np.bool_]:
        """(n,) which enabled actuators are commanded."""
        return np.isin(self.enabled.id, self.layout.id)

    def displaced(self, commanded: Array) -> Array:
        """Return (n, k) displacements of all enabled from (m, k) of the commanded."""
        on = self.commanded
        if on.all():
            return commanded
        all_of_them = np.empty((on.size, commanded.shape[1]))
        all_of_them[on], all_of_them[~on] = commanded, self.followers @ commanded
        return all_of_them

    @property
    def shapes(self) -> Array:
        """(n, m) displacements of all enabled actuators per displacement of each commanded one."""
        return self.displaced(np.eye(self.layout.n))

    @property
    def forces(self) -> Array:
        """(n, m) true forces of `shapes` [N/m]; 0 for those that are off."""
        if self.commanded.all():
            return self.acting_stiffness
        return np.asarray(self.acting_stiffness @ self.shapes)

    @property
    def stiffness(self) -> Array:
        """(m, m) symmetric: z'Kz / 2 is the energy of displacements z of the commanded actuators.

        The others follow [true N / true m].
        """
        on, forces = self.commanded, self.forces
        if on.all():
            return forces
        return symmetrised(forces[on] + self.followers.T @ forces[~on])

    def read(self, moved: Array) -> Array:
        """Return the (n, k) readings of the enabled for (n, k) true displacements."""
        gain = self.enabled_gain[:, None]
        if self.places.motion is None and not self.enabled_offset.any():
            return np.asarray(moved / gain)
        factors = lu_factor(motion_from(self.places, self.enabled_offset), overwrite_a=True)
        return np.asarray(lu_solve(factors, moved) / gain)

    def per_reading(self, forces: Array) -> Array:
        """Return (k, n) forces per reading of each that acts, from those per true displacement."""
        if self.places.motion is None and not self.enabled_offset.any():
            return np.asarray(forces * self.enabled_gain)
        acts = self.acts
        moved = np.eye(self.enabled.n)[:, acts]
        moved[~acts] = self.floating[:, acts]
        found = np.zeros_like(forces)
        found[:, acts] = np.linalg.solve(self.read(moved)[acts].T, forces[:, acts].T).T
        return found

    @property
    def feed_forward_commanded(self) -> Array:
        """(n, m) commanded force of all enabled, slaved ones included, per true displacement."""
        return np.asarray(self.forces / self.enabled_alpha[:, None])

    @property
    def modes(self) -> StiffnessModes:
        """Its modes: rigid motions first if calibrated, then the softest."""
        return stiffness_modes(self.stiffness, arms(self.layout).T if self.calibrated else None)


def true_stiffness(
    matrix: StiffnessMatrix,
    calibration: Calibration | None,
    *,
    sensor_gain: Array | None = None,
    motion: Array | None = None,
    off: Sequence[int] = (),
    slaved: Sequence[int] = (),
) -> TrueStiffness:
    """Return the stiffness of the commanded actuators in true Newtons and true metres.

    Actuators that are off apply no force and float: with o for them and a for the others,
    K_aa - K_ao K_oo^-1 K_oa. Slaved ones take the positions that minimise the sum of squares of all
    forces, ``z_s = -(K_:s' K_:s)^-1 K_:s' K_:m z_m`` for commanded z_m.

    Parameters
    ----------
    matrix
        Measured. Disabled actuators are excluded; those that the calibration excludes float.
    calibration
        Of the same mirror; None assumes alpha = 1, and uses statics for symmetry only.
    sensor_gain
        (n,) true displacement / reading, in the order of ``matrix.layout``. By default gains and
        places of the sensors are those of the calibration, unless the matrix is per true
        displacement already (`StiffnessMatrix.displaced`).
    motion
        (6, n, n) or (n, n), see `calibrate`; not used if the matrix is per true displacement.
    off, slaved
        IDs.

    Raises
    ------
    CampaignMismatch, UnknownName
        Matrix and calibration of two mirrors; an invalid ID, or one both off and slaved.
    RankDeficient
        Too few actuators are left, or they do not hold those that are off.
    FormatError
        Invalid sensor gains.

    Examples
    --------
    >>> [f"{tn.true_stiffness(matrix, alpha).asymmetry:.2%}" for alpha in (None, calibration)]
    ['6.75%', '0.11%']
    """
    refuse_segments(matrix)
    if calibration is not None:
        matrix = as_calibrated(matrix, calibration.effects)
    layout = matrix.layout.part(matrix.layout.enabled)
    alpha = _matched_alpha(layout, matrix.instrument, calibration)
    gain, offset = _sensors(matrix, layout, calibration, sensor_gain)
    places = places_of(matrix.layout, None if matrix.displaced == "true" else motion)
    floats, follows = off_and_slaved(layout, off, slaved)
    k = alpha[:, None] * matrix.used_stiffness
    k /= gain
    if places.motion is not None or offset.any():
        factors = lu_factor(motion_from(places, offset).T, overwrite_a=True)
        k = np.asarray(lu_solve(factors, k.T, overwrite_b=True).T)
    skew, size = (_row_norms(k, sign) for sign in (-1.0, 1.0))
    factor = np.full(layout.n, np.nan) if calibration is None else _column_factors(k)
    symmetric = symmetrised(k)
    rigid = np.linalg.qr(arms_in_units_of_rms(layout).T)[0]
    own = rigid.T @ symmetric @ rigid
    coupling = symmetric @ rigid - rigid @ own  # Q K R
    if calibration is not None:
        symmetric -= coupling @ rigid.T
        symmetric -= rigid @ coupling.T
        symmetric = symmetrised(symmetric)  # to the last digit
    followers, floating = _following(symmetric, floats, follows)
    symmetric.setflags(write=False)  # so that the record need not copy it
    return TrueStiffness(
        layout=layout.part(~(floats | follows)), calibrated=calibration is not None,
        enabled=layout, acts=~floats, followers=followers, floating=floating,
        acting_stiffness=symmetric,
        enabled_alpha=alpha, enabled_gain=gain, enabled_offset=offset, places=places,
        asymmetry=float(np.linalg.norm(skew) / np.linalg.norm(size)),
        actuator_asymmetry=skew / size, column_factor=factor,
        imbalance=float(2 * np.sqrt(2) * np.linalg.norm(coupling) / np.linalg.norm(size)),
    )  # fmt: skip


def _sensors(
    matrix: StiffnessMatrix,
    layout: Layout,
    calibration: Calibration | None,
    sensor_gain: Array | None,
) -> tuple[Array, Array]:
    """Return (n,) gains and (2, n) offsets [m] of the sensors of the enabled actuators.

    They are those given, otherwise those of the calibration, as far as they are known.
    """
    gain, offset, on = np.ones(layout.n), np.zeros((2, layout.n)), matrix.layout.enabled
    if sensor_gain is not None:
        if np.shape(sensor_gain) != on.shape:
            raise FormatError(
                f"sensor_gain has shape {np.shape(sensor_gain)}",
                remedy=f"give one number for each of the {on.size} actuators",
            )
        gain = np.asarray(sensor_gain, dtype=float)[on]
    elif calibration is not None and matrix.displaced != "true":
        at = indices_of(calibration.layout, layout.id)
        theirs = calibration.of_sensors("gain")[at]
        gain = np.where(np.isnan(theirs), 1.0, theirs)
        offset = np.nan_to_num([calibration.of_sensors(axis)[at] for axis in "xy"])
    if not (np.isfinite(gain).all() and (gain > 0).all()):
        raise FormatError(
            "sensor_gain contains numbers that are not positive", remedy="they are about 1"
        )
    return gain, offset


def _column_factors(k: Array) -> Array:
    """Return (n,) columns of an (n, n) K relative to what symmetry requires, with median 1.

    The factors 1/h_j that make K most nearly symmetric minimise

        sum_ij (K_ij h_j - K_ji h_i)^2 / sum_ij (K_ij h_j)^2,    i /= j

    which is one eigenvector: with v_j = h_j d_j and d_j the norm of column j, that of the largest
    eigenvalue of K_ij K_ji / (d_i d_j). NaN for an actuator without couplings.
    """
    off = k - np.diag(np.diag(k))
    there = off.any(axis=0) & off.any(axis=1)
    found = np.full(len(k), np.nan)
    if np.count_nonzero(there) < 2:
        return found
    off = off[np.ix_(there, there)]
    size = np.linalg.norm(off, axis=0)
    off *= off.T.copy()
    off /= np.outer(size, size)
    last = len(off) - 1
    _, vector = scipy.linalg.eigh(off, subset_by_index=[last, last], overwrite_a=True)
    with np.errstate(divide="ignore"):
        found[there] = size / vector[:, 0]
    return np.asarray(found / np.nanmedian(found))


def _row_norms(matrix: Array, transposed_sign: float) -> Array:
    """Return the (n,) norms of the rows of K + sign K', some rows at a time, for memory."""
    norms = np.empty(len(matrix))
    for start in range(0, len(matrix), ROWS_AT_ONCE):
        some = slice(start, start + ROWS_AT_ONCE)
        rows = matrix[some] + transposed_sign * matrix[:, some].T
        norms[some] = np.sqrt(np.einsum("ij,ij->i", rows, rows))
    return norms


def _following(
    k: Array, floats: NDArray[np.bool_], follows: NDArray[np.bool_]
) -> tuple[Array, Array]:
    """Return (n - m, m) displacements of the actuators that are not commanded, and ``floating``.

    k is overwritten by the stiffness of all that act, slaved ones included.
    """
    acts, commanded = ~floats, ~(floats | follows)
    floating = np.zeros((int(floats.sum()), len(k)))
    if floats.any():
        try:
            held = scipy.linalg.cho_factor(k[np.ix_(floats, floats)])
        except np.linalg.LinAlgError:
            raise RankDeficient(
                f"{counted(int(np.count_nonzero(floats)), 'actuator')} switched off, not stabilised"
                " by the others",
                remedy="turn fewer off, or measure their stiffness better",
            ) from None
        floating[:, acts] = -scipy.linalg.cho_solve(held, k[np.ix_(floats, acts)])
        k += k[:, floats] @ floating
        k[floats] = k[:, floats] = 0.0
    followers = np.zeros((len(k), int(commanded.sum())))
    followers[floats] = floating[:, commanded]
    if follows.any():
        slaved = np.linalg.lstsq(k[:, follows], -k[:, commanded], rcond=None)[0]
        followers[follows] = slaved
        followers[floats] += floating[:, follows] @ slaved
    return followers[~commanded], floating


def static_force(
    stiffness: TrueStiffness, calibration: Calibration, at_rest: Array | None
) -> Array:
    """Return the (n,) true static forces of the enabled actuators: weight, bias, flattening [N].

    They come from the (n,) commanded forces at rest [N] (`MotionSums.force_at_rest`), otherwise
    from weight and bias of the calibration, otherwise they are 0. The load of actuators that are
    off is carried by the smallest forces of the others.
    """
    layout, on = stiffness.enabled, stiffness.acts
    A, c = arms(layout), calibration
    if at_rest is not None:
        force = stiffness.enabled_alpha * at_rest
    elif c.loads and np.isfinite(c.bias_force):
        first = c.loads[0]
        weight = effective_weight(c.weight, first.added, first.tilt)
        k = external_load(weight, c.bias_force, c.torque_y[0], c.torque_x[0])
        force = -np.linalg.pinv(A) @ k
    else:
        return np.zeros(layout.n)
    borne = np.where(on, force, 0.0)
    borne[on] += np.linalg.pinv(A[:, on]) @ (A @ (force - borne))
    return np.asarray(borne)
