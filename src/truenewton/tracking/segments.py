"""Segments tracked side by side: one that is refused does not take the others down."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

from truenewton.calibration.segmented import SegmentedCalibration
from truenewton.calibration.segments import of_each, sorted_out
from truenewton.errors import CampaignMismatch, FormatError, RankDeficient
from truenewton.reading import of_segment
from truenewton.records.segmented import SegmentedData
from truenewton.statics.layout import Layout
from truenewton.tracking.days import Given, Named, named
from truenewton.tracking.fit import track
from truenewton.tracking.law import Tracking
from truenewton.tracking.segmented import SegmentedTracking


@dataclass(frozen=True, eq=False)
class _Days:
    """The days of a mirror in several segments."""

    layout: Layout
    days: tuple[Named, ...]

    @property
    def numbers(self) -> tuple[int, ...]:
        return self.layout.segments

    def segment(self, number: int) -> list[Named]:
        return [Named(name, of_segment(data, number, name)) for name, data in self.days]


def track_segments(
    *given: Given, force: bool = False, processes: int | None = None
) -> SegmentedTracking:
    """Find how alpha of each segment of a mirror varies with temperature and time.

    Parameters
    ----------
    given, force
        As of `track`, of a mirror in several segments.
    processes
        As of `calibrate`.

    Raises
    ------
    RankDeficient
        No segment can be tracked; or there is nothing to track.
    UnreadableFile, FormatError, CampaignMismatch
        Files that cannot be tracked, or not together.

    Examples
    --------
    >>> law = tn.track_segments(pair(calibration), pair(warm), processes=1)
    >>> law.numbers, law.segment(2).effects
    ((1, 2), ('temperature',))
    """
    days = tuple(named(item) for item in given)
    if not days:
        raise RankDeficient("there is no calibration", remedy="give two or more", got=0, want=2)
    instrument, layout = _mirror_of(days)
    data = _Days(layout, days)

    def solver(_: int) -> Callable[[Sequence[Named]], Tracking]:
        return partial(_law, force=force)

    made, refused = sorted_out(data, of_each(data, solver, processes), "a law")
    made = {number: replace(law, layout=replace(law.layout)) for number, law in made.items()}
    return SegmentedTracking(instrument, layout, made, refused)


def _law(days: Sequence[Named], *, force: bool) -> Tracking:
    return track(*days, force=force)


def _mirror_of(days: Sequence[Named]) -> tuple[str, Layout]:
    """Return name and actuators of the mirror, enabled where they are on every day.

    Raises
    ------
    FormatError, CampaignMismatch
    """
    first, *others = days
    for name, data in days:
        if not isinstance(data, SegmentedCalibration | SegmentedData):
            raise FormatError(
                "is of one body, where others have several segments",
                remedy=f"give what holds all segments, as {first.name} does, or choose one:"
                " --segment, or track(..., segment=) in Python",
                path=name,
            )
    mirror = first.data
    assert isinstance(mirror, SegmentedCalibration | SegmentedData)
    for name, data in others:
        assert isinstance(data, SegmentedCalibration | SegmentedData)
        apart = mirror.layout.other_actuators(data.layout)
        if apart or not (data.instrument == mirror.instrument and data.numbers == mirror.numbers):
            raise CampaignMismatch(
                f"is of {data.instrument}, {first.name} of {mirror.instrument}"
                if data.instrument != mirror.instrument
                else f"has other actuators than {first.name}{f': {apart}' if apart else ''}",
                remedy="track one mirror at a time",
                path=name,
            )
    return mirror.instrument, mirror.layout
