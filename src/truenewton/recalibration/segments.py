"""Segments recalibrated side by side: one that is refused does not take the others down."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from truenewton.calibration.segmented import SegmentedCalibration
from truenewton.calibration.segments import frozen_again, of_each, sorted_out
from truenewton.calibration.verdict import warn_of
from truenewton.errors import CampaignMismatch, FormatError, UnknownName
from truenewton.recalibration.fit import Recalibration, recalibrate
from truenewton.recalibration.known import Known, KnownOfSegments, read_known
from truenewton.records.campaign import Campaign
from truenewton.records.segmented import SegmentedData
from truenewton.records.stiffness_matrix import StiffnessMatrix


@dataclass(frozen=True, eq=False)
class SegmentedRecalibration:
    """What a short run gives of a mirror in several segments.

    Attributes
    ----------
    calibration
        Of all segments; an ordinary calibration of such a mirror.
    segments
        What the run gave of each segment that was not refused, by its number.
    """

    calibration: SegmentedCalibration
    segments: Mapping[int, Recalibration]


def recalibrate_segments(
    data: SegmentedData,
    known: KnownOfSegments | str | os.PathLike[str],
    actuators: Sequence[int] = (),
    *,
    force: bool = False,
    processes: int | None = None,
) -> SegmentedRecalibration:
    """Calibrate replaced actuators of a mirror in several segments by a short run.

    Parameters
    ----------
    data
        The run after the replacement.
    known, actuators, force
        As of `recalibrate`, of all segments.
    processes
        As of `calibrate`.

    Raises
    ------
    RankDeficient
        No segment can be recalibrated.
    CampaignMismatch
        The run and what is known are of two mirrors.
    UnknownName
        There is no such actuator.
    UnreadableFile, FormatError

    Warns
    -----
    TrueNewtonWarning

    Examples
    --------
    >>> weights = tuple(tn.Segment(k, one.weight, one.weight_error) for k in (1, 2))
    >>> run = dataclasses.replace(
    ...     one,
    ...     instrument="PAIR",
    ...     layout=side,
    ...     force=np.tile(np.asarray(one.force), 2),
    ...     position=None,
    ...     weight=2 * one.weight,
    ...     weight_error=2**0.5 * one.weight_error,
    ...     segments=weights,
    ... )
    >>> made = tn.recalibrate_segments(tn.SegmentedData((run,)), pair(calibration), [17])
    >>> {number: part.asked for number, part in made.segments.items()}
    {1: (17,), 2: ()}
    """
    before, layout = _known_of(data, known), data.layout
    for unknown in (one for one in actuators if one not in layout.id[layout.enabled]):
        raise UnknownName(
            f"there is no actuator {unknown} that is enabled",
            remedy=f"IDs run from {layout.id.min()} to {layout.id.max()}",
            got=unknown,
        )

    def solver(number: int) -> Callable[[Campaign | StiffnessMatrix], Recalibration]:
        of_it = layout.id[np.asarray(layout.segment) == number]
        return partial(
            _recalibrated,
            known=before.segment(number),
            actuators=[one for one in actuators if one in of_it],
            force=force,
        )

    made, refused = sorted_out(data, of_each(data, solver, processes), "alpha")
    made = {k: replace(one, calibration=frozen_again(one.calibration)) for k, one in made.items()}
    calibrations = {number: one.calibration for number, one in made.items()}
    whole = SegmentedCalibration(data.instrument, layout, calibrations, refused)
    warn_of(whole)
    return SegmentedRecalibration(whole, made)


def _known_of(
    data: SegmentedData, known: KnownOfSegments | str | os.PathLike[str]
) -> KnownOfSegments:
    """Return what is known of the mirror of a run."""
    name = "the earlier calibration"
    if isinstance(known, str | os.PathLike):
        name, read = os.fspath(known), read_known(known)
        if not isinstance(read, KnownOfSegments):
            raise FormatError(
                f"is of one body, and the run has {len(data.numbers)} segments",
                remedy="choose the segment: --segment",
                path=name,
            )
        known = read
    same_instrument = known.instrument == data.instrument
    apart = data.layout.other_actuators(known.layout)
    if apart or not same_instrument:
        raise CampaignMismatch(
            f"has other actuators than the run: {apart}"
            if same_instrument
            else f"is of {known.instrument}, the run of {data.instrument}",
            remedy="give the calibration of the same mirror",
            path=name,
        )
    return known


def _recalibrated(
    run: Campaign | StiffnessMatrix,
    *,
    known: Known,
    actuators: Sequence[int],
    force: bool,
) -> Recalibration:
    if isinstance(run, StiffnessMatrix):
        raise FormatError("holds no cycles", remedy="give the run after the change")
    return recalibrate(run, known, actuators, force=force)
