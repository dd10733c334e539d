"""What a segment of a mirror weighs: each is a body of its own, with a balance of its own."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from truenewton.errors import FormatError, TrueNewtonError, UnknownName
from truenewton.rounding import counted
from truenewton.statics.layout import Layout
from truenewton.statics.load import ADDED_WEIGHT, MIRROR_WEIGHT


class Segment(NamedTuple):
    """A row of SEGMENTS: the weights of one segment under one load.

    Attributes
    ----------
    number
        As in SEGMENT of ACTUATORS.
    weight, weight_error
        P and its standard uncertainty [N].
    added, added_error
        Q and its standard uncertainty [N].

    Examples
    --------
    >>> tn.Segment(1, weight=-2.92, weight_error=0.005, added=-0.289, added_error=0.005).weight
    -2.92
    """

    number: int
    weight: float
    weight_error: float
    added: float = 0.0
    added_error: float = 0.0


def lacks_weights(layout: Layout) -> FormatError:
    """Return the refusal of a mirror in several segments where nothing says what each weighs."""
    return FormatError(
        f"ACTUATORS has {len(layout.segments)} segments, and nothing says what each weighs",
        remedy="add the table SEGMENTS: SEGMENT, WEIGHT, E_WEIGHT, ADDED, E_ADDED (docs/files.md)",
    )


def check_segments(segments: tuple[Segment, ...], layout: Layout) -> None:
    """Refuse weights of segments that cannot be, or are not those of the actuators.

    Raises
    ------
    FormatError
    """
    there = () if layout.segment is None else np.unique(layout.segment).tolist()
    named = [segment.number for segment in segments]
    for number in named:
        if named.count(number) > 1:
            raise FormatError(f"segment {number} stands twice in SEGMENTS", remedy="keep one row")
        if number not in there:
            raise FormatError(
                f"SEGMENTS has a row of segment {number}, and no actuator stands behind that",
                remedy="correct SEGMENT of ACTUATORS, or take the row out",
            )
    if lacking := [number for number in there if number not in named]:
        raise FormatError(
            f"SEGMENTS has no row of {counted(lacking, 'segment')}:"
            f" {', '.join(map(str, lacking[:9]))}",
            remedy="give WEIGHT, E_WEIGHT, ADDED and E_ADDED of each segment (docs/files.md)",
        )
    for segment in segments:
        try:
            for name, quantity in (MIRROR_WEIGHT | ADDED_WEIGHT).items():
                quantity.check(getattr(segment, name))
        except TrueNewtonError as error:
            raise error.changed(fault=f"{error.fault} of segment {segment.number}") from None


def sums_of(segments: tuple[Segment, ...]) -> dict[str, float]:
    """Return weight, its error, added weight and its error [N] of all segments together."""
    weights = np.array([segment[1:] for segment in segments])
    weight, added = weights[:, ::2].sum(axis=0).tolist()
    weight_error, added_error = np.sqrt((weights[:, 1::2] ** 2).sum(axis=0)).tolist()
    return {
        "weight": weight,
        "weight_error": weight_error,
        "added": added,
        "added_error": added_error,
    }


def require_segment(number: int, numbers: Sequence[int]) -> None:
    """Refuse the number of a segment that is not there.

    Raises
    ------
    UnknownName
    """
    if number not in numbers:
        raise UnknownName(
            f"there is no segment {number}",
            remedy=f"choose {', '.join(map(str, numbers))}",
            got=number,
            want=numbers,
        )
