"""Segments calibrated side by side: one that is refused does not take the others down."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from typing import Any, TypeVar

import numpy as np

from truenewton.arrays import Array
from truenewton.calibration.result import Calibration
from truenewton.calibration.segmented import SegmentedCalibration
from truenewton.calibration.verdict import warn_of
from truenewton.calibration.workers import processors, side_by_side
from truenewton.errors import RankDeficient, TrueNewtonError, UnreadableFile
from truenewton.estimation.diagnosis import Diagnosis
from truenewton.records.campaign import Campaign
from truenewton.records.fault import Fault
from truenewton.records.segmented import SegmentedData, coupling_faults
from truenewton.records.stiffness_matrix import StiffnessMatrix

LARGE = 200  # actuators of a segment: below, it is solved before a process has started
Solve = Callable[..., Calibration]
Body = Campaign | StiffnessMatrix
Found = TypeVar("Found")


def calibrate_segments(
    data: SegmentedData, solve: Solve, motion: Array | None, processes: int | None
) -> SegmentedCalibration:
    """Calibrate each segment by itself.

    Parameters
    ----------
    data
        Of all segments.
    solve
        Calibrates a mirror in one piece, given its motion by that name: `calibrate`, or a partial.
    motion
        (n, n), as of `calibrate`, of all segments; or None.
    processes
        How many at once; None for as many as there are processors, if segments are large.

    Raises
    ------
    RankDeficient
        No segment gives alpha.

    Warns
    -----
    TrueNewtonWarning
    """
    numbers, segment = data.numbers, np.asarray(data.layout.segment)

    def solver(number: int) -> Callable[[Body], Calibration]:
        own = segment == number
        return partial(solve, motion=None if motion is None else motion[np.ix_(own, own)])

    answers = list(of_each(data, solver, processes))
    made = {
        number: replace(
            answer, layout=replace(answer.layout)
        )  # from elsewhere, it may be written to
        for number, answer in zip(numbers, answers, strict=True)
        if isinstance(answer, Calibration)
    }
    refused = {k: (a,) for k, a in zip(numbers, answers, strict=True) if isinstance(a, Fault)}
    if not made:
        number, ((fault, remedy),) = next(iter(refused.items()))
        raise RankDeficient(f"no segment gives alpha; segment {number}: {fault}", remedy=remedy)
    if data.stiffness is not None:
        for number, coupled in coupling_faults(data.stiffness).items():
            if number in made:
                made[number] = _warned(made[number], coupled)
    whole = SegmentedCalibration(data.instrument, data.layout, made, refused)
    warn_of(whole, stacklevel=4)
    return whole


def of_each(
    data: SegmentedData, solver: Callable[[int], Callable[[Body], Found]], processes: int | None
) -> Iterator[Found | Fault]:
    """Yield what is found of each segment, or why nothing is.

    Parameters
    ----------
    data
        Of all segments.
    solver
        Gives, for the number of a segment, what finds it: a function of a module, or a partial.
    processes
        As of `calibrate_segments`.
    """

    def work(number: int) -> tuple[Callable[[Any], Found | Fault], Any]:
        try:
            return partial(_attempt, solver(number)), data.segment(number)
        except UnreadableFile:
            raise
        except TrueNewtonError as error:
            return _same, Fault(error.fault, error.remedy)

    if processes is None:
        largest = int(np.unique(np.asarray(data.layout.segment), return_counts=True)[1].max())
        processes = processors() if largest >= LARGE and sys.executable else 1
    calls = [partial(work, number) for number in data.numbers]
    if processes > 1:
        yield from side_by_side(calls, min(processes, len(calls)))
        return
    for call in calls:
        attempt, given = call()
        yield attempt(given)


def _same(fault: Fault) -> Fault:
    return fault


def _attempt(solve: Callable[[Body], Found], body: Body) -> Found | Fault:
    """Return what is found of a segment, or why nothing is."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the whole is warned of
        warnings.simplefilter("error", RuntimeWarning)  # what overflows is no result
        try:
            return solve(body)
        except UnreadableFile:
            raise
        except TrueNewtonError as error:
            return Fault(error.fault, error.remedy)
        except (ArithmeticError, RuntimeWarning, np.linalg.LinAlgError) as error:
            return Fault(
                f"the calculation broke down ({error})",
                "numbers are too large, too small or too much alike; look at each file with `info`",
            )


def _warned(calibration: Calibration, fault: Fault) -> Calibration:
    diagnosis = calibration.diagnosis or Diagnosis()
    return replace(calibration, diagnosis=replace(diagnosis, warnings=(*diagnosis.warnings, fault)))
