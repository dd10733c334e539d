"""Elimination of actuators that are off or do not fit from a stiffness matrix."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from truenewton.arrays import Array
from truenewton.errors import RankDeficient
from truenewton.estimation.findings.code import LIMITS, Code
from truenewton.estimation.findings.finding import Finding
from truenewton.estimation.matrix.couplings import (
    ELSEWHERE,
    MIN_JUDGED_ACTUATORS,
    pair_ratios,
    typical_spacing,
)
from truenewton.estimation.matrix.facts import MatrixFacts
from truenewton.estimation.matrix.misfits import (
    MIN_IMBALANCE_RATIO,
    NO_FORCE,
    NO_SENSOR,
    ROW_UNLIKE_COLUMN,
    UNKNOWN_FORCE,
    BadActuator,
    FitsNoSymmetry,
    bad_actuators,
    condensed,
    fill_by_symmetry,
    residual_force,
)
from truenewton.estimation.matrix.order import (
    balance_effects,
    order_effects,
    orientation_effects,
    refuse_compliance,
    refuse_no_stiffness,
    rest_effects,
)
from truenewton.records.segmented import refuse_segments
from truenewton.records.stiffness_matrix import StiffnessMatrix
from truenewton.rounding import named
from truenewton.statics.arms import enabled_arms
from truenewton.statics.layout import Layout


@dataclass(frozen=True, eq=False)
class ScreenedMatrix:
    """A matrix condensed to the actuators that fit."""

    matrix: StiffnessMatrix  # omitted actuators are disabled and exert no force
    facts: MatrixFacts  # of this matrix
    start: Array  # (n_enabled,) alpha from symmetry, if all sensors had the same gain
    # (n_enabled, 3, 3) covariance of the forces and torques that omitted actuators may add to each
    # column, torques in comparable units [N^2/m^2]
    disturbance: Array
    warnings: tuple[Finding, ...] = ()
    effects: tuple[Finding, ...] = ()  # omitted actuators with the reason


def screen_matrix(matrix: StiffnessMatrix) -> ScreenedMatrix:
    """Return a matrix without the actuators that are off or do not fit.

    Raises
    ------
    RankDeficient
        Rows have the wrong order or sign, several actuators exert unmeasured forces, or the matrix
        is diagonal.
    """
    refuse_segments(matrix)
    matrix = without_copies(released(matrix))
    facts = MatrixFacts.of(matrix)
    k, a = facts.stiffness, facts.arms
    refuse_no_stiffness(k)
    refuse_compliance(facts, matrix.layout)
    of_order = tuple(order_effects(facts, matrix.layout))
    named_orders = (each for each in of_order if each.detail)
    disorder = (*rest_effects(facts), *named_orders, *balance_effects(facts))
    if disorder:  # single actuators cannot be judged then
        n = len(k)
        return ScreenedMatrix(matrix, facts, np.ones(n), np.zeros((n, 3, 3)), effects=disorder)
    ids = matrix.layout.id[matrix.layout.enabled]
    k, *halves = fill_by_symmetry(k, a)
    off = np.asarray(~(k.any(axis=0) & k.any(axis=1)), dtype=np.bool_)
    half = [
        BadActuator(int(i), reason, 0.0)
        for some, reason in zip(halves, (NO_FORCE, NO_SENSOR), strict=True)
        for i in some
    ]
    found, unsure = tuple[BadActuator, ...](), tuple[Finding, ...]()
    if np.count_nonzero(~off) >= MIN_JUDGED_ACTUATORS:
        try:
            measured = facts if k is facts.stiffness and not off.any() else None
            found, k = _mended(k, a, off, [each.index for each in half], measured)
        except FitsNoSymmetry as error:
            names = ids[~off][error.indices]
            kept = Finding.of(Code.MISFITS_KEPT, count=len(names), n=len(ids), actuators=names)
            if error.certain:
                raise RankDeficient(kept.fault, remedy=kept.remedy) from None
            unsure = (kept,)
    known = {each.index for each in half}
    bad = (*(each for each in found if each.index not in known), *half)
    good, doubt = np.asarray(~off, dtype=np.bool_), np.zeros(len(k))
    good[[each.index for each in bad]] = False
    doubt[[each.index for each in bad]] = [each.doubt for each in bad]
    core = condensed(k, good)[0]
    screened = matrix
    if not good.all():
        screened = freed(matrix, good, core)
        facts = MatrixFacts.of(screened)
        of_order = tuple(order_effects(facts, screened.layout))
    start = np.exp(np.clip(facts.pair_ratios[0], -1.0, 1.0)) if len(core) else np.ones(0)
    some_off = bool(off.any() and good.any())
    pushing = some_off and not _balanced_about(core, a, good, off, start)
    if pushing:
        # The three equations of a column contain one alpha: two unknown forces use up the rest.
        if np.count_nonzero(off) > 1:
            raise RankDeficient(
                f"{named('actuator', ids[off].tolist(), 20)} have rows or columns in STIFFNESS that"
                " are empty or copies, but pushed: the columns around them do not balance",
                remedy="measure the stiffness with them switched off, or their rows and columns",
            )
        doubt[off] = UNKNOWN_FORCE
    disturbance = np.zeros((len(core), 3, 3))
    if doubt.any():
        disturbance = residual_force(k, a, good, doubt)
    return ScreenedMatrix(
        screened,
        facts,
        start,
        disturbance,
        (*unsure, *_warnings(ids, off, bad, pushing=pushing)),
        (
            *_effects(matrix.layout, a, off, bad),
            *of_order,
            *orientation_effects(facts),
        ),
    )


def without_copies(matrix: StiffnessMatrix) -> StiffnessMatrix:
    """Return a matrix with zeros in the rows that contain no forces of their own.

    These are zero off the diagonal, or equal to others. Of equal rows, that which is most like its
    column is the original. If the column is no better, it becomes zero as well.
    """
    on, k = matrix.layout.enabled, matrix.used_stiffness
    rows, columns = (
        ~(each - np.diag(np.diag(each))).any(axis=1) | _copied(each) for each in (k, k.T)
    )
    if len(k) < MIN_JUDGED_ACTUATORS or rows.all() or not k[rows].any():
        return matrix
    stiffness = np.array(matrix.stiffness)
    stiffness[np.ix_(on, on)] = np.where(rows[:, None] | (rows & columns), 0.0, k)
    return replace(matrix, stiffness=stiffness)


def _copied(k: Array) -> NDArray[np.bool_]:
    """Return which (n,) rows of a stiffness are copies of others, both if neither is original."""
    group = np.unique(k, axis=0, return_inverse=True)[1].ravel()
    others = (group[:, None] == group) & ~np.eye(len(k), dtype=bool)
    likeness = np.sum(k * k.T, axis=1) / np.maximum(np.linalg.norm(k, axis=0), 1e-300)
    least = likeness - 1e-9 * np.abs(likeness)
    return np.asarray((others & (least[:, None] <= likeness)).any(axis=1))


def released(matrix: StiffnessMatrix) -> StiffnessMatrix:
    """Return a matrix condensed to states in which disabled actuators exert no force.

    An actuator that was off has an empty row and column, and needs no condensation.
    """
    on = matrix.layout.enabled
    k = np.asarray(matrix.stiffness)
    pushed = ~on & k[:, on].any(axis=1) & k[on].any(axis=0)
    if not pushed.any():
        return matrix
    there = on | pushed
    core = condensed(k[np.ix_(there, there)], on[there])[0]
    return freed(replace(matrix, layout=replace(matrix.layout, enabled=there)), on[there], core)


def _mended(
    k: Array,
    a: Array,
    off: NDArray[np.bool_],
    filled: list[int],
    facts: MatrixFacts | None,
) -> tuple[tuple[BadActuator, ...], Array]:
    """Return the misfits, with their indices in ``k``, and the corrected (n, n) ``k``."""
    measured = np.flatnonzero(~off)
    block = np.ix_(measured, measured)
    among = np.searchsorted(measured, filled).tolist()
    facts = facts or MatrixFacts(k[block], a[:, ~off])
    found, mended = bad_actuators(facts, a[:, off], among)
    bad = tuple(replace(each, index=int(measured[each.index])) for each in found)
    raw, k = k, k.copy()
    k[block] = mended
    unlike = [each.index for each in bad if each.reason == ROW_UNLIKE_COLUMN]
    if unlike and _better_as_read(raw, k, a, ~off, bad, unlike):
        k[unlike] = raw[unlike]
    return bad, k


def freed(matrix: StiffnessMatrix, good: NDArray[np.bool_], core: Array) -> StiffnessMatrix:
    """Return the matrix with all actuators disabled that are not good.

    ``good`` marks (n_enabled,) actuators to keep. ``core`` is their condensed (n_good, n_good)
    stiffness [N/m].
    """
    on = matrix.layout.enabled
    kept = on.copy()
    kept[on] = good
    stiffness = np.zeros_like(matrix.stiffness)
    stiffness[np.ix_(kept, kept)] = core
    return replace(matrix, layout=replace(matrix.layout, enabled=kept), stiffness=stiffness)


def as_calibrated(matrix: StiffnessMatrix, effects: Sequence[Finding]) -> StiffnessMatrix:
    """Return the matrix without the actuators that are omitted according to the effects."""
    matrix = released(matrix)
    left_out = {Code.ACTUATOR_OFF, Code.ACTUATOR_MISFIT}
    out = [i for each in effects if each.code in left_out for i in each.actuators]
    good = ~np.isin(matrix.layout.id[matrix.layout.enabled], out)
    if good.all():
        return matrix
    return freed(matrix, good, condensed(matrix.used_stiffness, good)[0])


def _better_as_read(
    raw: Array,
    k: Array,
    a: Array,
    measured: NDArray[np.bool_],
    bad: Sequence[BadActuator],
    unlike: Sequence[int],
) -> bool:
    """Return whether columns balance better with measured than with corrected rows of ``unlike``.

    Row and column of these actuators differ. If the sensor is wrong, the measured row is right.
    """
    good = measured.copy()
    good[[each.index for each in bad]] = False
    sizes = []
    for rows in (raw, k):
        tried = k.copy()
        tried[unlike] = rows[unlike]
        core = condensed(tried, good)[0]
        start = np.exp(np.clip(pair_ratios(core)[0], -1.0, 1.0))
        rho = (a[:, good] * start) @ core
        sizes.append(float(np.sum(rho**2)))
    return sizes[0] < sizes[1]


def _balanced_about(
    core: Array, a: Array, good: NDArray[np.bool_], off: NDArray[np.bool_], start: Array
) -> bool:
    """Return whether columns near actuators that are off balance as well as the others."""
    arms = a[:, good]
    own = np.abs(np.diag(core))
    size = np.linalg.norm((arms * start) @ core, axis=0) / np.where(own > 0.0, own, np.inf)
    distance = np.hypot(arms[1][:, None] - a[1, off], arms[2][:, None] - a[2, off])
    near = (distance < 2.0 * typical_spacing(a)).any(axis=1)
    if not near.any() or near.all():
        return True
    return bool(np.median(size[near]) < MIN_IMBALANCE_RATIO * np.median(size[~near]))


def _warnings(
    ids: NDArray[np.int64], off: NDArray[np.bool_], bad: Sequence[BadActuator], *, pushing: bool
) -> Iterator[Finding]:
    """Yield warnings of actuators that were off but exerted force, and of many misfits."""
    if pushing:
        yield Finding.of(Code.OFF_BUT_PUSHING, actuators=ids[off])
    if len(bad) > max(3, LIMITS.misfit_fraction * len(ids)):
        names = [ids[each.index] for each in bad]
        yield Finding.of(Code.MANY_MISFITS, count=len(bad), n=len(ids), actuators=names)


def _effects(
    layout: Layout, a: Array, off: NDArray[np.bool_], bad: Sequence[BadActuator]
) -> Iterator[Finding]:
    """Yield one finding for each reason to omit actuators, with the largest size."""
    ids = layout.id[layout.enabled]
    for reason in dict.fromkeys(each.reason for each in bad):
        some = [each for each in bad if each.reason == reason]
        names = [int(ids[each.index]) for each in some]
        elsewhere = reason == ELSEWHERE
        far = max(each.size for each in some)
        if elsewhere:  # from the unit of the arms to metres
            far *= float(np.linalg.norm(enabled_arms(layout)[1:]) / np.linalg.norm(a[1:]))
        yield Finding(
            code=Code.ACTUATOR_MISFIT,
            detail=f"{reason}, up to {far:.2g} m off" if elsewhere else reason,
            where=named("actuator", layout.shown[np.isin(layout.id, names)].tolist()),
            actuators=tuple(names),
            size=far,
            corrected=True,
            remedy="correct X and Y of these rows of ACTUATORS, in m"
            if elsewhere
            else "check its coil, driver, cable, sensor and position; until it is repaired, set"
            " ENABLED to F",
        )
    if off.any():
        yield Finding(
            code=Code.ACTUATOR_OFF,
            where=named("actuator", ids[off].tolist()),
            actuators=tuple(ids[off].tolist()),
            corrected=True,
            remedy="set ENABLED to F if it was off; its alpha is not calibrated",
        )
