"""True stiffness: true Newtons per true displacement, with what statics knows of it put to use.

Of a measured stiffness K_c, where true force = alpha x commanded and true displacement = gain x
reading,

    K = diag(alpha) K_c diag(1/gain) H^-1

with H from what the sensors see to what the magnets do, by a model of the glass, or by the places
of the sensors and a thin plate; 1 where neither is known.
Maxwell and Betti make it symmetric. Forces of a free shell balance and its rigid motions bend
nothing, so rigid motions R (the rows of the arms) and the rest Q have nothing to do with each other
but for uneven bias magnets:

    K = R (R'KR) R' + Q K Q,    Q = 1 - R R'

What couples them is error, of alpha (forces R'K do not balance) and of the gains (K R costs force),
and is dropped where alpha is known. That brings the modes nearer to the truth: on simulated P45 by
2 to 10 per cent on average, and in each of 60 campaigns; on the measured LBT672, held against a
shell model that knows nothing of it, by up to a third for the softest (docs/stiffness-modes.md).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from truenewton.arrays import Array, freeze
from truenewton.calibration.result import Calibration
from truenewton.errors import RankDeficient
from truenewton.estimation.matrix.screen import as_calibrated
from truenewton.estimation.reciprocity.sensor_model import Places, places_of, seen_from
from truenewton.linalg import ROWS_AT_ONCE, symmetrised
from truenewton.modal.actuator_roles import (
    checked_gain,
    matched_alpha,
    matched_sensors,
    off_and_slaved,
    per_true_displacement,
    readings,
)
from truenewton.records.segmented import refuse_segments
from truenewton.records.stiffness_matrix import StiffnessMatrix
from truenewton.rounding import counted
from truenewton.statics.arms import arms, arms_in_units_of_rms
from truenewton.statics.layout import Layout
from truenewton.statics.modes import StiffnessModes, stiffness_modes


@dataclass(frozen=True, eq=False)
class TrueStiffness:
    """Stiffness of the m actuators that are commanded, of n that are enabled.

    Attributes
    ----------
    layout
        The m commanded actuators: enabled, neither off nor slaved.
    calibrated
        Whether alpha is known.
    enabled, acts
        The n enabled actuators; (n,) false where one is off.
    followers
        (n - m, m) displacements of those that are not commanded per displacement of each commanded.
    acting_stiffness
        (n, n) true force per displacement, were those commanded too that are slaved: the
        feed-forward of all that act; 0 for those that are off [N/m].
    enabled_alpha
        (n,) true Newton / commanded Newton of the enabled; 1 where there is no calibration.
    enabled_gain
        (n,) true displacement / reading of the enabled; 1 where it is not known.
    enabled_offset
        (2, n) x and y of their magnets less their sensors; 0 where it is not known [m].
    places
        Of the enabled, and what a model of the glass tells there.
    asymmetry
        |K - K'| / |K + K'| of the whole matrix, before it was made symmetric.
    actuator_asymmetry
        (n,) the same of each enabled actuator's row and column.
    imbalance
        Norm of what couples rigid motions to the rest, over that of K; dropped if calibrated.
    """

    layout: Layout
    calibrated: bool
    enabled: Layout
    acts: NDArray[np.bool_]
    followers: Array
    acting_stiffness: Array
    enabled_alpha: Array
    enabled_gain: Array
    enabled_offset: Array
    places: Places
    asymmetry: float
    actuator_asymmetry: Array
    imbalance: float

    def __post_init__(self) -> None:
        freeze(self, "followers", "acting_stiffness", "enabled_alpha", "enabled_gain",
               "enabled_offset", "actuator_asymmetry")  # fmt: skip

    @property
    def commanded(self) -> NDArray[np.bool_]:
        """(n,) which enabled actuators are commanded."""
        return np.isin(self.enabled.id, self.layout.id)

    def displaced(self, commanded: Array) -> Array:
        """Return (n, k) displacements of all enabled for (m, k) of those that are commanded."""
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
        """(n, m) the true forces that these take [N/m]; 0 of those that are off."""
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

    @property
    def seen(self) -> Array:
        """(n, n) true displacements of the enabled for what their sensors read: H diag(gain)."""
        return seen_from(self.places, self.enabled_offset) * self.enabled_gain

    def read(self, moved: Array) -> Array:
        """Return (n, k) what the sensors of the enabled read of (n, k) true displacements."""
        return readings(moved, self.places, self.enabled_gain, self.enabled_offset)

    @property
    def feed_forward_commanded(self) -> Array:
        """(n, m) commanded force per true displacement, diag(1/alpha) K if all are commanded.

        Of all enabled actuators, since slaved ones are given forces too.
        """
        return np.asarray(self.forces / self.enabled_alpha[:, None])

    @property
    def modes(self) -> StiffnessModes:
        """Its modes: rigid motions first where calibrated, then the softest."""
        return stiffness_modes(self.stiffness, arms(self.layout).T if self.calibrated else None)

    @property
    def rigid_stiffness(self) -> Array:
        """(3,) v'Kv of piston and the two tilts, of unit length [N/m]: negative by bias magnets.

        Calibrated, and with all actuators commanded, these are the first three `modes`.
        """
        rigid = np.linalg.qr(arms_in_units_of_rms(self.layout).T)[0]
        return np.asarray(np.sum(rigid * (self.stiffness @ rigid), axis=0))

    def most_asymmetric(self, count: int = 5) -> tuple[tuple[int, float], ...]:
        """Return ID and asymmetry of the actuators whose rows and columns differ most."""
        worst = np.argsort(-self.actuator_asymmetry, kind="stable")[:count]
        return tuple((int(self.enabled.id[i]), float(self.actuator_asymmetry[i])) for i in worst)


def true_stiffness(
    matrix: StiffnessMatrix,
    calibration: Calibration | None,
    *,
    sensor_gain: Array | None = None,
    motion: Array | None = None,
    off: Sequence[int] = (),
    slaved: Sequence[int] = (),
) -> TrueStiffness:
    """Return the stiffness in true Newtons and true metres, of the actuators that are commanded.

    Actuators that are off apply no force and float: with o for them and a for the others,
    K_aa - K_ao K_oo^-1 K_oa. Slaved ones take the positions that make the sum of squares of all
    forces least, ``z_s = -(K_:s' K_:s)^-1 K_:s' K_:m z_m`` for commanded z_m.

    Parameters
    ----------
    matrix
        Measured; disabled actuators are left out, those that the calibration left out float.
    calibration
        Of the same mirror; None takes alpha = 1, and statics for nothing but symmetry.
    sensor_gain
        (n,) true displacement / reading, in the order of ``matrix.layout``; unless given, what the
        calibration knows of gains and places of the sensors counts, if the matrix does not hold it
        already (`StiffnessMatrix.displaced`).
    motion
        (6, n, n) or (n, n) as of `calibrate`; does not count if the matrix holds it already.
    off, slaved
        IDs.

    Raises
    ------
    CampaignMismatch, UnknownName
        Not of one mirror; an ID that no enabled actuator has, or that is both off and slaved.
    RankDeficient
        Too few actuators are left, or they do not hold those that are off.
    FormatError
        Sensor gains that cannot be.

    Examples
    --------
    >>> [f"{tn.true_stiffness(matrix, alpha).asymmetry:.2%}" for alpha in (None, calibration)]
    ['6.75%', '0.11%']
    """
    refuse_segments(matrix)
    if calibration is not None:
        matrix = as_calibrated(matrix, calibration.effects)
    layout = matrix.layout.part(matrix.layout.enabled)
    alpha = matched_alpha(layout, matrix.instrument, calibration)
    gain, offset, places = _sensors(matrix, layout, calibration, sensor_gain, motion)
    floats, follows = off_and_slaved(layout, off, slaved)
    k = alpha[:, None] * matrix.used_stiffness
    k = per_true_displacement(k, places, gain, offset)
    skew = _skew_norms(k)
    symmetric = symmetrised(k)
    size = 2.0 * _row_norms(symmetric)
    rigid = np.linalg.qr(arms_in_units_of_rms(layout).T)[0]
    own = rigid.T @ symmetric @ rigid
    coupling = symmetric @ rigid - rigid @ own  # Q K R
    if calibration is not None:
        symmetric = _uncoupled(symmetric, coupling, rigid)
    followers = _following(symmetric, floats, follows)
    symmetric.setflags(write=False)  # so that the record need not copy it
    return TrueStiffness(
        layout=layout.part(~(floats | follows)), calibrated=calibration is not None,
        enabled=layout, acts=~floats, followers=followers, acting_stiffness=symmetric,
        enabled_alpha=alpha, enabled_gain=gain, enabled_offset=offset, places=places,
        asymmetry=float(np.linalg.norm(skew) / np.linalg.norm(size)),
        actuator_asymmetry=skew / size,
        imbalance=float(2 * np.sqrt(2) * np.linalg.norm(coupling) / np.linalg.norm(size)),
    )  # fmt: skip


def _sensors(
    matrix: StiffnessMatrix,
    layout: Layout,
    calibration: Calibration | None,
    sensor_gain: Array | None,
    motion: Array | None,
) -> tuple[Array, Array, Places]:
    """Return (n,) gains and (2, n) offsets of the enabled, and what is known of their glass."""
    known = matrix.displaced == "true"
    gain, offset = matched_sensors(layout, None if known else calibration)
    if sensor_gain is not None:
        gain, offset = checked_gain(sensor_gain, matrix.layout.enabled), np.zeros_like(offset)
    return gain, offset, places_of(matrix.layout, None if known else motion)


def _row_norms(matrix: Array) -> Array:
    """Return (n,) the norm of each row, without a copy of the matrix."""
    return np.asarray(np.sqrt(np.einsum("ij,ij->i", matrix, matrix)))


def _skew_norms(matrix: Array) -> Array:
    """Return (n,) the norm of each row of an (n, n) matrix less its transpose."""
    norms = np.empty(len(matrix))
    for start in range(0, len(matrix), ROWS_AT_ONCE):
        some = slice(start, start + ROWS_AT_ONCE)
        norms[some] = _row_norms(matrix[some] - matrix[:, some].T)
    return norms


def _uncoupled(symmetric: Array, coupling: Array, rigid: Array) -> Array:
    """Return (n, n) without what couples it to (n, 3) rigid motions; it is overwritten."""
    symmetric -= coupling @ rigid.T
    symmetric -= rigid @ coupling.T
    return symmetrised(symmetric)  # to the last digit


def _following(k: Array, floats: NDArray[np.bool_], follows: NDArray[np.bool_]) -> Array:
    """Return (n - m, m) displacements of those that are not commanded; k is overwritten.

    It becomes what those that act feel, were the slaves commanded too.

    Raises
    ------
    RankDeficient
        Those that float are not held.
    """
    acts, commanded = ~floats, ~(floats | follows)
    floating = np.zeros((int(floats.sum()), len(k)))
    if floats.any():
        try:
            held = scipy.linalg.cho_factor(k[np.ix_(floats, floats)])
        except np.linalg.LinAlgError:
            raise RankDeficient(
                f"{counted(int(np.count_nonzero(floats)), 'actuator')} switched off, not held by"
                " the others",
                remedy="turn fewer off, or measure their stiffness better",
                got=int(np.count_nonzero(floats)),
            ) from None
        floating[:, acts] = -scipy.linalg.cho_solve(held, k[np.ix_(floats, acts)])
        k += k[:, floats] @ floating
        k[floats] = k[:, floats] = 0.0
    followers = np.zeros((len(k), int(commanded.sum())))
    if follows.any():
        slaved = np.linalg.lstsq(k[:, follows], -k[:, commanded], rcond=None)[0]
        followers[follows] = slaved
        floating[:, commanded] += floating[:, follows] @ slaved
    followers[floats] = floating[:, commanded]
    return followers[~commanded]
