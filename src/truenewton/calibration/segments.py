"""Segments calibrated side by side: one that is refused does not take the others down."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from functools import partial
from typing import Any, Protocol, TypeVar

import numpy as np

from truenewton.arrays import Array
from truenewton.calibration.result import Calibration
from truenewton.calibration.segmented import SegmentedCalibration
from truenewton.calibration.verdict import warn_of
from truenewton.calibration.workers import processors, side_by_side
from truenewton.errors import Fault, RankDeficient, TrueNewtonError, UnreadableFile
from truenewton.estimation.findings.code import Code
from truenewton.estimation.findings.estimate import Diagnosis
from truenewton.estimation.findings.finding import Finding
from truenewton.progress import telling_of
from truenewton.records.campaign import Campaign
from truenewton.records.segmented import SegmentedData, segment_couplings
from truenewton.records.stiffness_matrix import StiffnessMatrix
from truenewton.statics.layout import Layout

LARGE = 200  # actuators of a segment: below, it is solved before a process has started
Solve = Callable[..., Calibration]
Body = TypeVar("Body")
Found = TypeVar("Found")
BodyOf = TypeVar("BodyOf", covariant=True)
Seen = Array | Mapping[int, Array]  # by sensors: by those of all segments, or of each by its number


class InSegments(Protocol[BodyOf]):
    """What there is of each segment of a mirror."""

    @property
    def layout(self) -> Layout:
        """All actuators."""

    @property
    def numbers(self) -> tuple[int, ...]:
        """Of the segments, ascending."""

    def segment(self, number: int) -> BodyOf:
        """Return what there is of one."""


def calibrate_segments(
    data: SegmentedData, solve: Solve, motion: Seen | None, processes: int | None
) -> SegmentedCalibration:
    """Calibrate each segment by itself.

    Parameters
    ----------
    data
        Of all segments.
    solve
        Calibrates a mirror in one piece, given its motion by that name: `calibrate`, or a partial.
    motion
        (6, n, n) or (n, n), as of `calibrate`, of all segments, or of each by its number; or None.
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

    def solver(number: int) -> Callable[[Campaign | StiffnessMatrix], Calibration]:
        return partial(solve, motion=seen_of(motion, data.layout, number))

    made, refused = sorted_out(data, of_each(data, solver, processes), "alpha")
    made = {number: frozen_again(one) for number, one in made.items()}
    if data.stiffness is not None:
        for number, (size, own) in segment_couplings(data.stiffness).items():
            if number in made:
                coupled = Finding.of(Code.SEGMENTS_COUPLED, size=size, own=own)
                made[number] = _warned(made[number], coupled)
    whole = SegmentedCalibration(data.instrument, data.layout, made, refused)
    warn_of(whole, stacklevel=4)
    return whole


def seen_of(motion: Seen | None, layout: Layout, number: int) -> Array | None:
    """Return what the sensors of one segment see, (6, k, k) or (k, k) of its k actuators."""
    if motion is None or isinstance(motion, Mapping):
        return None if motion is None else motion[number]
    own = np.asarray(layout.segment) == number
    return np.asarray(motion[..., own, :][..., own])


def sorted_out(
    data: InSegments[Any], answers: Iterable[Found | Fault], what: str
) -> tuple[dict[int, Found], dict[int, tuple[Fault, ...]]]:
    """Return what was found of each segment by its number, and why nothing of the others.

    Raises
    ------
    RankDeficient
        No segment gives what is wanted.
    """
    made: dict[int, Found] = {}
    refused: dict[int, tuple[Fault, ...]] = {}
    for number, answer in zip(data.numbers, answers, strict=True):
        if isinstance(answer, Fault):
            refused[number] = (answer,)
        else:
            made[number] = answer
    if not made:
        number, ((fault, remedy),) = next(iter(refused.items()))
        raise RankDeficient(f"no segment gives {what}; segment {number}: {fault}", remedy=remedy)
    return made, refused


def frozen_again(calibration: Calibration) -> Calibration:
    """Return a calibration that came from another process, where it could be written to."""
    return replace(calibration, layout=replace(calibration.layout))


def of_each(
    data: InSegments[Body],
    solver: Callable[[int], Callable[[Body], Found]],
    processes: int | None,
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
            return _same, _fault_of(error)

    if processes is None:
        largest = int(np.unique(np.asarray(data.layout.segment), return_counts=True)[1].max())
        processes = processors() if largest >= LARGE and sys.executable else 1
    calls = [partial(work, number) for number in data.numbers]
    if processes > 1:
        answers = side_by_side(calls, min(processes, len(calls)))
    else:
        answers = (attempt(given) for attempt, given in (call() for call in calls))
    yield from telling_of(answers, len(calls), "segments")


def _same(fault: Fault) -> Fault:
    return fault


def _fault_of(error: TrueNewtonError) -> Fault:
    return Fault(f"{error.path}: {error.fault}" if error.path else error.fault, error.remedy)


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
            return _fault_of(error)
        except (ArithmeticError, RuntimeWarning, np.linalg.LinAlgError) as error:
            return Fault(
                f"the calculation broke down ({error})",
                "numbers are too large, too small or too much alike; look at each file with `info`",
            )


def _warned(calibration: Calibration, fault: Finding) -> Calibration:
    diagnosis = calibration.diagnosis or Diagnosis()
    return replace(calibration, diagnosis=replace(diagnosis, warnings=(*diagnosis.warnings, fault)))
