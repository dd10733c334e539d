"""A stiffness matrix with what does not fit left out, as campaigns are sifted of rows."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from truenewton.arrays import Array
from truenewton.errors import RankDeficient
from truenewton.estimation.bad_sensors import other_half
from truenewton.estimation.couplings import pair_ratios, typical_spacing
from truenewton.estimation.findings.catalogue import Code
from truenewton.estimation.findings.finding import Finding
from truenewton.estimation.matrix_faults import (
    NO_FORCE,
    NO_SENSOR,
    UNLIKE,
    BadActuator,
    FitsNoSymmetry,
    bad_actuators,
    condensed,
    left_over,
)
from truenewton.estimation.matrix_order import (
    FEWEST,
    balance_effects,
    order_effects,
    orientation_effects,
    refuse_compliance,
    refuse_no_stiffness,
)
from truenewton.estimation.seen_places import ELSEWHERE
from truenewton.records.fault import Fault
from truenewton.records.segmented import refuse_segments
from truenewton.records.stiffness_matrix import StiffnessMatrix
from truenewton.rounding import named
from truenewton.statics.arms import comparable_arms, enabled_arms

OFF = "row or column is zero"
UNSEEN = 0.3  # of the own stiffness, in any column: so none tells what it was
BALANCED = 5.0  # times what is typical: columns about an actuator that was off


@dataclass(frozen=True, eq=False)
class SiftedMatrix:
    """What fits of a matrix.

    Attributes
    ----------
    matrix
        Those left out are disabled; the others as they are where these push nothing.
    start
        (n_enabled,) alpha from symmetry, as if all sensors had one gain.
    disturbance
        (n_enabled, 3, 3) covariance of what those left out may add to the balance of each column,
        torques in comparable units [N^2/m^2].
    warnings, effects
        Which were left out, and why.
    unsure
        Why all actuators are kept although some do not fit, if that is so.
    pushing
        Columns around one that is zero do not balance, as if it had pushed.
    """

    matrix: StiffnessMatrix
    start: Array
    disturbance: Array
    warnings: tuple[Fault, ...] = ()
    effects: tuple[Finding, ...] = ()
    unsure: tuple[Fault, ...] = ()
    pushing: bool = False


def sift_matrix(matrix: StiffnessMatrix) -> SiftedMatrix:
    """Find the actuators that are off or do not fit, and leave them out.

    Raises
    ------
    RankDeficient
        Rows are in another order or of another sign, more than one pushes unseen, or none feels
        another.
    """
    refuse_segments(matrix)
    k, a = matrix.used_stiffness, comparable_arms(matrix.layout)
    refuse_no_stiffness(k)
    refuse_compliance(matrix)
    disorder = (*order_effects(matrix, named=True), *balance_effects(matrix))
    if disorder:  # whoever stands where is then no matter of single actuators
        n = len(k)
        return SiftedMatrix(matrix, np.ones(n), np.zeros((n, 3, 3)), effects=disorder)
    ids = matrix.layout.id[matrix.layout.enabled]
    k, *halves = other_half(k, a)
    off = np.asarray(~(k.any(axis=0) & k.any(axis=1)), dtype=np.bool_)
    half = [
        BadActuator(int(i), reason, 0.0)
        for some, reason in zip(halves, (NO_FORCE, NO_SENSOR), strict=True)
        for i in some
    ]
    bad: tuple[BadActuator, ...] = ()
    unsure: tuple[Fault, ...] = ()
    measured = np.flatnonzero(~off)
    if len(measured) >= FEWEST:
        block = np.ix_(measured, measured)
        filled = np.searchsorted(measured, [each.index for each in half]).tolist()
        try:
            found, mended = bad_actuators(k[block], a[:, ~off], a[:, off], filled)
        except FitsNoSymmetry as error:
            found, mended, unsure = (), k[block], (_as_measured(error),)
        length = float(np.linalg.norm(enabled_arms(matrix.layout)[1:]) / np.linalg.norm(a[1:]))
        bad = tuple(_of_all(each, measured, length) for each in found)
        raw, k = k, k.copy()
        k[block] = mended
        unlike = [each.index for each in bad if each.reason == UNLIKE]
        if unlike and _better_as_read(raw, k, a, ~off, bad, unlike):
            k[unlike] = raw[unlike]
    known = {each.index for each in half}
    bad = (*(each for each in bad if each.index not in known), *half)
    good, doubt = np.asarray(~off, dtype=np.bool_), np.zeros(len(k))
    good[[each.index for each in bad]] = False
    doubt[[each.index for each in bad]] = [each.doubt for each in bad]
    core = condensed(k, good)[0]
    start = np.exp(np.clip(pair_ratios(core)[0], -1.0, 1.0)) if len(core) else np.ones(0)
    some_off = bool(off.any() and good.any())
    pushing = some_off and not _balanced_about(core, a, good, off, start)
    if pushing:
        # Three equations of a column hold one alpha: two unknown forces leave nothing over.
        if np.count_nonzero(off) > 1:
            raise RankDeficient(
                f"{named('actuator', ids[off].tolist(), 20)} have rows or columns of zeros in"
                " STIFFNESS, but pushed: the columns around them do not balance",
                remedy="measure the stiffness with them switched off, or their rows and columns",
                got=int(np.count_nonzero(off)),
            )
        doubt[off] = UNSEEN
    disturbance = np.zeros((len(core), 3, 3))
    if doubt.any():
        disturbance = left_over(k, a, good, doubt)
    sifted = matrix if good.all() else freed(matrix, good, core)
    out = [BadActuator(int(i), OFF, 0.0) for i in np.flatnonzero(off)]
    return SiftedMatrix(
        sifted,
        start,
        disturbance,
        (*unsure, *_warnings(ids, out, bad, pushing=pushing)),
        (
            *(_effect(ids, each) for each in (*bad, *out)),
            *order_effects(sifted, named=False),
            *orientation_effects(sifted),
        ),
        unsure,
        pushing,
    )


def _of_all(each: BadActuator, measured: NDArray[np.int64], length: float) -> BadActuator:
    """Return a bad actuator by its index among all, with how far from its place it stands [m]."""
    how_far = f", {each.size * length:.2g} m off" if each.reason == ELSEWHERE else ""
    return BadActuator(int(measured[each.index]), each.reason + how_far, each.size)


def freed(matrix: StiffnessMatrix, good: NDArray[np.bool_], core: Array) -> StiffnessMatrix:
    """Return the matrix with enabled actuators that are not good disabled.

    Parameters
    ----------
    matrix
        Measured.
    good
        (n_enabled,) which stay.
    core
        (n_good, n_good) their stiffness in states in which the others push nothing [N/m].
    """
    on = matrix.layout.enabled
    left = on.copy()
    left[on] = good
    stiffness = np.array(matrix.stiffness)
    stiffness[np.ix_(left, left)] = core
    return replace(matrix, layout=replace(matrix.layout, enabled=left), stiffness=stiffness)


def as_calibrated(matrix: StiffnessMatrix, effects: Sequence[Finding]) -> StiffnessMatrix:
    """Return the matrix with those actuators freed that a calibration's effects say it left out."""
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
    """Tell whether the columns balance better with those freed by their rows than by their columns.

    Freed by its row, an actuator may have a sensor that reads any nonsense; by its column, a row.
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
    """Tell whether columns next to those that are off balance as well as the others do."""
    arms = a[:, good]
    own = np.abs(np.diag(core))
    size = np.linalg.norm((arms * start) @ core, axis=0) / np.where(own > 0.0, own, np.inf)
    distance = np.hypot(arms[1][:, None] - a[1, off], arms[2][:, None] - a[2, off])
    near = (distance < 2.0 * typical_spacing(a)).any(axis=1)
    if not near.any() or near.all():
        return True
    return bool(np.median(size[near]) < BALANCED * np.median(size[~near]))


def _as_measured(error: FitsNoSymmetry) -> Fault:
    """Return what is said of a matrix of which all is kept, as too much does not fit."""
    return Fault(
        f"{error.fault}; none is left out",
        f"{error.remedy}, and gains and places of the sensors; believe alpha no further than modes"
        " that the fit has not seen balance",
    )


def _warnings(
    ids: NDArray[np.int64],
    off: Sequence[BadActuator],
    bad: Sequence[BadActuator],
    *,
    pushing: bool,
) -> Iterator[Fault]:
    if off:
        yield Fault(
            f"{_named(ids, off)}, disabled? Left out: zero in row or column of STIFFNESS"
            + (", but the columns around do not balance, as if it pushed" if pushing else ""),
            "measure the stiffness with it switched off"
            if pushing
            else "set ENABLED to F if it was off; its alpha is not calibrated",
        )
    misplaced = [each for each in bad if each.reason.startswith(ELSEWHERE)]
    if misplaced:
        yield Fault(
            "left out: " + "; ".join(f"{_named(ids, [each])} {each.reason}" for each in misplaced),
            "correct X and Y in that row of ACTUATORS, in m",
        )
    bad = [each for each in bad if each not in misplaced]
    if bad:
        why = {
            reason: [each for each in bad if each.reason == reason]
            for reason in dict.fromkeys(each.reason for each in bad)
        }
        text = "; ".join(f"{_named(ids, some)}: {reason}" for reason, some in why.items())
        yield Fault(
            f"left out, as {'it does' if len(bad) == 1 else 'they do'} not fit the others: {text}",
            "look at coil, driver, cable, sensor and place of each, and measure again",
        )


def _named(ids: NDArray[np.int64], some: Sequence[BadActuator]) -> str:
    return named("actuator", [ids[each.index] for each in some], 20)


def _effect(ids: NDArray[np.int64], each: BadActuator) -> Finding:
    return Finding(
        code=Code.ACTUATOR_OFF if each.reason == OFF else Code.ACTUATOR_MISFIT,
        detail="" if each.reason == OFF else each.reason,
        where=f"actuator {ids[each.index]}",
        actuators=(int(ids[each.index]),),
        size=each.size,
        corrected=True,
        remedy="look at coil, driver, cable, sensor and place; set ENABLED to F while it is off",
    )
