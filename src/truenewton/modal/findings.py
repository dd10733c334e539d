"""Stiffness modes of measurements, before and after calibration, and how they differ.

The first N modes are what a loop with N modes corrects, so the span of modes matters: two modes of
equal stiffness may be rotated within their span without any effect. The angles between two spans
describe their difference (Bjorck and Golub, Math. Comp. 27, 1973). With the matrix of overlaps
C = V' W, the mean cos^2 of the N angles is the sum of squares of the leading N x N block of C over
N, for all N by one cumulative sum.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.linalg import svds

from truenewton.arrays import Array
from truenewton.calibration.methods import (
    calibrate,
    calibration_of,
    estimate_alpha,
    resolve_method,
)
from truenewton.calibration.result import Calibration
from truenewton.calibration.verdict import refusal_of, refuse_unusable
from truenewton.errors import Fault, FormatError
from truenewton.estimation.findings.code import Code, Level
from truenewton.estimation.findings.finding import Finding
from truenewton.estimation.matrix.screen import as_calibrated
from truenewton.estimation.screening.screen import screen_campaign
from truenewton.modal.measured_stiffness import (
    MeasuredStiffness,
    MotionSums,
    motion_sums,
    stiffness_of,
)
from truenewton.modal.modal_base import Budget, Dissipation, ModalBase, modal_base
from truenewton.modal.plausibility import enabled_model, implausible
from truenewton.modal.true_stiffness import TrueStiffness, indices_of, static_force, true_stiffness
from truenewton.modal.turbulence import Atmosphere, pupil_of, seen_turbulence
from truenewton.quantities import taking_units
from truenewton.records.campaign import Campaign
from truenewton.records.cycle import Source
from truenewton.records.reader import Measured
from truenewton.records.result import Summarised
from truenewton.records.stiffness_matrix import StiffnessMatrix

MAX_PAIR_DIFFERENCE = 0.01  # relative, of the stiffness of two modes that are a pair
ROUNDING = 1e-9  # of rigid stiffness, relative to the largest
MAX_EXACT_ORDER = 200  # modes whose angles are found by one decomposition
MAX_ORDERS = 32  # at which the largest angle is found; each takes a decomposition
MAX_COMPARED = 1000  # actuators; the modes for a comparison double time and memory
MAX_MISFIT = 2.0  # of the variance of repeats; it is known to 10 % with some hundred readings


@dataclass(frozen=True, eq=False)
class ModesComparison:
    """The difference of two sets of k modes, order by order."""

    # (k,) mean cos^2 of the N angles between the spans of the first N modes, N = 1..k
    overlap: Array
    # (k,) the angle whose sin^2 is the mean sin^2 of these angles [rad], from the part outside the
    # span, so that small angles are exact
    rms_angle: Array
    # (q,) some N, all if k is at most `MAX_ORDERS`, and the largest angle there [rad]
    orders: NDArray[np.int64]
    largest_angle: Array
    # (k,) true if modes N and N + 1 have nearly the same stiffness, so that the span of the first N
    # is arbitrary; false without stiffness
    cuts: NDArray[np.bool_]
    # the same of all orders N < n that cut no pair [rad]: 0 for equal modes, about pi/4 for random
    # ones
    distance: float


def compare_modes(one: Array, other: Array, stiffness: Array | None = None) -> ModesComparison:
    """Compare two sets of k modes of n actuators, (n, k), orthogonalised in their order.

    The (k,) stiffness of the modes of one of them marks the orders that cut a pair.
    """
    n, k = one.shape
    v, w = (np.linalg.qr(modes)[0] for modes in (one, other))
    c = v.T @ w
    left = w @ c.T
    np.subtract(v, left, out=left)
    outside = np.einsum("ij,ij->j", left, left)  # of each v, its part outside the span of w
    # Of each v, its part along later w; without a difference, and in place since n may be large.
    beyond = np.square(c, out=left) if n == k else c**2
    backwards = beyond[:, ::-1]
    np.cumsum(backwards, axis=1, out=backwards)
    # Leak of the first N: the parts of each v along w N+1 .. k, and outside their span.
    np.cumsum(beyond, axis=0, out=beyond)
    number = np.arange(1, k + 1)
    leak = np.cumsum(outside)
    leak[:-1] += np.diagonal(beyond, 1)
    del left, beyond, backwards
    sine = np.sqrt(np.clip(leak / number, 0.0, 1.0))
    cuts = np.zeros(k, dtype=bool)
    if stiffness is not None:
        size = np.maximum(np.abs(stiffness[1:]), np.abs(stiffness[:-1]))
        tolerance = MAX_PAIR_DIFFERENCE * size + ROUNDING * np.abs(stiffness).max()
        cuts[:-1] = np.abs(np.diff(stiffness)) <= tolerance
    uncut = number[~cuts & (number < n)]
    orders = uncut
    if k > MAX_ORDERS and uncut.size:
        wanted = np.geomspace(1, uncut[-1], MAX_ORDERS)
        orders = uncut[np.unique(np.abs(uncut[:, None] - wanted).argmin(axis=0))]
    return ModesComparison(
        overlap=1.0 - sine**2,
        rms_angle=np.arcsin(sine),
        orders=orders,
        largest_angle=np.array([_largest_angle(v, w, c, int(order)) for order in orders]),
        cuts=cuts,
        distance=float(np.arcsin(np.sqrt(np.mean(sine[uncut - 1] ** 2)))) if uncut.size else np.nan,
    )


def _largest_angle(v: Array, w: Array, c: Array, order: int) -> float:
    """Return the largest angle between the spans of the first modes, from its sine."""
    left = v[:, :order] - w[:, :order] @ c[:order, :order].T
    if order <= MAX_EXACT_ORDER:
        sine = float(np.linalg.norm(left, 2))
    else:  # to 0.1 % in a few products: all singular values would take minutes
        start = np.random.default_rng(0).standard_normal(order)
        sine = float(svds(left, k=1, tol=1e-3, v0=start, return_singular_vectors=False)[0])
    return float(np.arcsin(min(sine, 1.0)))


@dataclass(frozen=True, eq=False, repr=False)
class ModalFindings(Summarised):
    """The modal basis with alpha, compared with that for alpha = 1.

    Attributes
    ----------
    measured
        The stiffness measured in cycles, and its errors; None for a stiffness file.
    calibration
        The source of alpha.
    after
        The modal basis with this alpha.
    uncalibrated
        A function that computes the modal basis with alpha = 1; see ``before``.
    asymmetry, imbalance
        Of the stiffness with alpha = 1, and with this alpha; see `TrueStiffness`.
    doubts
        What is implausible of the stiffness or its sensors (`modal.plausibility`).
    sources
        The files of the stiffness.

    Examples
    --------
    >>> found = tn.find_modes(campaign, calibration)
    >>> found
    <ModalFindings of P45: 45 modes>
    >>> found.after.modes.stiffness.shape
    (45,)
    """

    measured: MeasuredStiffness | None
    calibration: Calibration
    after: ModalBase
    uncalibrated: Callable[[], ModalBase]
    asymmetry: tuple[float, float]
    imbalance: tuple[float, float]
    doubts: tuple[Fault, ...]
    sources: tuple[Source, ...]

    def __repr__(self) -> str:
        base = self.after
        return f"<ModalFindings of {base.matrix.instrument}: {base.modes.stiffness.size} modes>"

    @cached_property
    def before(self) -> ModalBase:
        """The modal basis with alpha = 1, computed at first access."""
        return self.uncalibrated()

    @cached_property
    def comparison(self) -> ModesComparison:
        """The difference of the modes before and after, computed at first access."""
        after = self.after.modes
        return compare_modes(after.modes, self.before.modes.modes, after.stiffness)

    @property
    def compares(self) -> bool:
        """Whether texts and figures compare with alpha = 1: not for large mirrors."""
        return self.after.layout.n <= MAX_COMPARED

    @property
    def warnings(self) -> tuple[Finding | Fault, ...]:
        """Problems of the stiffness, or of alpha for it, with remedies."""
        warnings: list[Finding | Fault] = (
            list(self.measured.warnings) if self.measured is not None else []
        )
        warnings += self.doubts
        if self.measured is not None and self.measured.misfit > MAX_MISFIT:
            warnings.append(
                Fault(
                    "shapes leave forces that no stiffness explains,"
                    f" {np.sqrt(self.measured.misfit):.2g} times what repeats scatter",
                    "look for actuators that act but are disabled, or for a mirror that drifted",
                )
            )
        if _true_already(self.calibration):
            warnings.append(
                Fault(
                    "STIFFNESS is symmetric and balanced, and treated as a true one: alpha is 1",
                    "if it was made so of a measured one, give that as it was measured",
                )
            )
        elif all(before < after for before, after in (self.asymmetry, self.imbalance)):
            warnings.append(
                Fault(
                    "with alpha the stiffness is less symmetric and less balanced than without",
                    "give alpha of this very mirror, and its stiffness in commanded Newtons",
                )
            )
        return tuple(warnings)

    def modes_between(self, cost: Dissipation, limits: Budget) -> tuple[int, int]:
        """Return the number of modes within limits for alpha one E_ALPHA higher, and lower."""
        c = self.calibration
        at = indices_of(c.layout, self.after.stiffness.enabled.id)
        error: Array = c.error[at] / np.abs(c.alpha[at])
        fewest, most = (cost.modes_within(limits, alpha_error=e) for e in (error, -error))
        return fewest, most


@dataclass(frozen=True, eq=False)
class _Request:
    """The options of `find_modes`."""

    atmosphere: Atmosphere
    diameter: float | None
    radius: float | None
    efficiency: float | None
    sensor_gain: Array | None
    motion: Array | None
    model: Array | None
    off: Sequence[int]
    slaved: Sequence[int]
    accept_rejected: bool


@taking_units(diameter="m", radius="m", efficiency="N W(-1/2)", sensor_gain="")
def find_modes(
    data: Measured,
    calibration: Calibration | None = None,
    atmosphere: Atmosphere | None = None,
    *,
    diameter: float | None = None,
    radius: float | None = None,
    efficiency: float | None = None,
    sensor_gain: Array | None = None,
    motion: Array | None = None,
    model: Array | None = None,
    off: Sequence[int] = (),
    slaved: Sequence[int] = (),
    sums: MotionSums | None = None,
    accept_rejected: bool = False,
) -> ModalFindings:
    """Find the stiffness modes of a mirror, and what turbulence costs with 1, 2, ... of them.

    Parameters
    ----------
    data
        Cycles with POSITION, or a measured stiffness, which takes precedence over cycles.
    calibration
        The source of alpha; by default the data are calibrated.
    atmosphere
        The turbulence; by default with 0.8 arcsec. Left out without a diameter.
    diameter, radius
        Of the entrance pupil of the telescope, and of the mirror that fills it [m]; the radius is
        by default that of the outermost actuator plus half a spacing. A segment is seen from its
        own middle, and the diameter is that of the part of the pupil that it fills.
    efficiency
        Commanded force per root of power [N/W^1/2]; without it powers are NaN.
    sensor_gain, motion, off, slaved
        See `true_stiffness`; ``motion`` is also used to calibrate the data.
    model
        (n, n) stiffness by a model of the mirror, if it is in one piece [N/m].
    sums
        Those of force and displacement, from `motion_sums`; by default they are made.
    accept_rejected
        Accept an alpha whose verdict is 'rejected'.

    Raises
    ------
    NotToBeUsed
        The verdict on alpha; most modes are negative, sensors reversed, or the model far. Unless
        forced.
    RankDeficient, TooManyOutliers, NotConverged
        The data do not determine stiffness or alpha.
    FormatError
        Invalid seeing, diameter, efficiency or sensor gain; turbulence without a diameter.
    CampaignMismatch, UnknownName
        Data and calibration of two mirrors; an invalid ID, or one both off and slaved.

    Examples
    --------
    >>> found = tn.find_modes(campaign, calibration, tn.Atmosphere(seeing=0.8), diameter=2.1)
    >>> stiffness, zernike, karhunen_loeve = found.after.costs
    >>> stiffness.residual.shape  # for 1, 2, ... modes
    (45,)
    """
    if diameter is None and (atmosphere or radius or efficiency):
        raise FormatError(
            "seeing, radius and efficiency need the pupil", remedy="give its diameter in metres"
        )
    request = _Request(
        atmosphere or Atmosphere(), diameter, radius, efficiency, sensor_gain, motion,
        model, off, slaved, accept_rejected,
    )  # fmt: skip
    return _of_body(data, calibration, request, sums)


def _of_body(
    data: Measured,
    calibration: Calibration | None,
    request: _Request,
    sums: MotionSums | None = None,
) -> ModalFindings:
    """Find the modes, as asked for."""
    if calibration is not None:
        refuse_unusable(calibration, accept_rejected=request.accept_rejected)
    matrix, measured, calibration, sums = _with_alpha(data, calibration, sums, request.motion)
    if _true_already(calibration):
        calibration = replace(calibration, alpha=calibration.alpha / calibration.alpha)  # or NaN
    else:
        refuse_unusable(calibration, accept_rejected=request.accept_rejected)
    matrix = as_calibrated(matrix, calibration.effects)
    at_rest = None if sums is None else sums.force_at_rest
    stiffness_by = partial(
        true_stiffness, matrix, sensor_gain=request.sensor_gain, motion=request.motion,
        off=request.off, slaved=request.slaved,
    )  # fmt: skip
    before = stiffness_by(None)
    faults = before.asymmetry, before.imbalance
    del before  # to save memory for large mirrors
    modes = (stiffness := stiffness_by(calibration)).modes
    elastic = modes.stiffness[3:]
    negative = int(np.count_nonzero(elastic < 0.0))
    if 2 * negative > elastic.size and not request.accept_rejected:
        raise refusal_of(
            Level.REJECTED,
            f"{negative} of {elastic.size} elastic modes are negative",
            "reverse the sign of STIFFNESS, or of POSITION in cycles",
        )
    model = enabled_model(request.model, matrix.layout.enabled)
    doubts = tuple(implausible(stiffness, modes, model))
    for fault, useless in doubts:
        if useless and not request.accept_rejected:
            raise refusal_of(Level.REJECTED, *fault)
    seen = None
    if request.diameter is not None:
        pupil = pupil_of(matrix.layout, request.diameter, request.radius)
        seen = seen_turbulence(stiffness.enabled, stiffness.commanded, request.atmosphere, pupil)
    static = static_force(stiffness, calibration, at_rest)
    after = modal_base(matrix, stiffness, modes, seen, static, request.efficiency)
    return ModalFindings(
        measured, calibration, after,
        partial(_uncalibrated, after, calibration, at_rest, stiffness_by, request.efficiency),
        (faults[0], stiffness.asymmetry), (faults[1], stiffness.imbalance),
        tuple(fault for fault, _ in doubts), _sources(sums, matrix),
    )  # fmt: skip


def _uncalibrated(
    after: ModalBase,
    calibration: Calibration,
    at_rest: Array | None,
    stiffness_by: Callable[[None], TrueStiffness],
    efficiency: float | None,
) -> ModalBase:
    """Return the modal basis with alpha = 1."""
    stiffness = stiffness_by(None)
    static = static_force(stiffness, calibration, at_rest)
    return modal_base(after.matrix, stiffness, stiffness.modes, after.seen, static, efficiency)


def _with_alpha(
    data: Campaign | StiffnessMatrix,
    calibration: Calibration | None,
    sums: MotionSums | None,
    motion: Array | None,
) -> tuple[StiffnessMatrix, MeasuredStiffness | None, Calibration, MotionSums | None]:
    """Return the stiffness, its measurement, alpha, and the sums over its rows."""
    if isinstance(data, StiffnessMatrix):
        return data, None, calibration or calibrate(data, motion=motion), None
    if sums is None:
        screened = screen_campaign(data)
        sums = motion_sums(screened)
        if calibration is None:
            method, options = resolve_method(data, None, population=False, motion=motion)
            estimate = estimate_alpha(screened, method, options)
            calibration = calibration_of(data, estimate)
    calibration = calibration or calibrate(data, motion=motion)
    if data.stiffness is not None:
        return data.stiffness, None, calibration, sums
    measured = stiffness_of(sums)
    return measured.matrix, measured, calibration, sums


def _true_already(calibration: Calibration) -> bool:
    """Return whether the calibrated stiffness is in true Newtons, as `modes` writes it."""
    return any(effect.code == Code.TRUE_STIFFNESS for effect in calibration.effects)


def _sources(sums: MotionSums | None, matrix: StiffnessMatrix) -> tuple[Source, ...]:
    """Return the files of a stiffness: its own, or those of the cycles with POSITION."""
    if sums is None or not sums.positioned:
        source = matrix.source
        return (replace(source, rows=matrix.layout.n),) if source else ()
    lost = Counter(row.cycle for row in sums.rejected)
    return tuple(
        replace(c.source, rows=int(c.valid.sum()), rejected=lost[k])
        for k, c in enumerate(sums.positioned)
        if c.source
    )
