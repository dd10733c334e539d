"""Mirrors in several segments: each is a body of its own, and data of one are taken at a time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from truenewton.errors import CampaignMismatch, FormatError, SeveralSegments, naming
from truenewton.records.campaign import Campaign
from truenewton.records.cycle import Cycle
from truenewton.records.stiffness_matrix import StiffnessMatrix
from truenewton.rounding import numbered
from truenewton.statics.layout import Layout, require_segment


def of_one_body(
    cycles: Sequence[Cycle], matrix: StiffnessMatrix | None, segment: int | None = None
) -> Campaign | StiffnessMatrix:
    """Return cycles, a matrix or both as the data of one segment, or of a mirror in one piece.

    Raises
    ------
    SeveralSegments
        There are several segments, and none is chosen.
    UnknownName, FormatError, CampaignMismatch
        There is no such segment, or the files are not of one mirror.
    """
    segments = _segments_of(cycles, matrix)
    file = matrix and matrix.source and matrix.source.file
    with naming(cycles[0].name if cycles else file):
        if segment is None:
            _refuse_several(segments)
        else:
            require_segment(segment, segments)
    if segment is not None:
        cycles = [c.of_segment(segment) for c in cycles if segment in np.asarray(c.layout.segment)]
        matrix = matrix and matrix.of_segment(segment)
    return matrix if matrix and not cycles else Campaign(tuple(cycles), matrix)


def refuse_segments(matrix: StiffnessMatrix) -> None:
    """Raise SeveralSegments for a stiffness matrix of several segments."""
    with naming(matrix.source and matrix.source.file):
        _refuse_several(_parts_of(matrix.layout))


def _segments_of(cycles: Sequence[Cycle], matrix: StiffnessMatrix | None) -> dict[int, Layout]:
    """Return the actuators of each segment; none of a mirror in one piece."""
    segments: dict[int, Layout] = {}
    for cycle in cycles:
        segments |= _parts_of(cycle.layout)
    for cycle in cycles if segments else ():
        if cycle.layout.segment is None:
            raise FormatError(
                "has no segment, and other files have",
                remedy="add the column SEGMENT to ACTUATORS",
                path=cycle.name,
            )
        if cycle.mirror != cycles[0].mirror:
            raise CampaignMismatch(
                f"is of {cycle.mirror}, {cycles[0].name} of {cycles[0].mirror}",
                remedy="calibrate files of one mirror only",
                path=cycle.name,
            )
    return _parts_of(matrix.layout) if matrix and not cycles else segments


def _parts_of(layout: Layout) -> dict[int, Layout]:
    """Return the actuators of each segment by its number; none without SEGMENT."""
    if layout.segment is None:
        return {}
    numbers = np.unique(layout.segment).tolist()
    return {number: layout.part(layout.in_segment(number)) for number in numbers}


def _refuse_several(segments: Mapping[int, Layout]) -> None:
    if len(segments) > 1:
        first = min(segments)
        raise SeveralSegments(
            f"contains {numbered('segment', sorted(segments))}, each of which is a body of its own",
            remedy=f"take one at a time: read the files with segment={first}, or use"
            f" of_segment({first}) of each cycle or matrix",
            segments={number: segments[number] for number in sorted(segments)},
        )
