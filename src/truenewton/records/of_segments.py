"""What was found of the segments of a mirror, each by itself, and why nothing of the others."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Generic, NamedTuple, Protocol, TypeVar

import numpy as np

from truenewton.arrays import Array
from truenewton.errors import Fault, FormatError, RankDeficient
from truenewton.records.segment import require_segment
from truenewton.rounding import counted
from truenewton.statics.layout import Layout


class Body(Protocol):
    """What is known of a mirror in one piece."""

    @property
    def layout(self) -> Layout:
        """Its actuators."""

    @property
    def alpha(self) -> Array:
        """(n,) of them."""


Found = TypeVar("Found", bound=Body)
Said = TypeVar("Said", bound=Hashable)


def together(said: Iterable[tuple[int, Said]]) -> list[tuple[tuple[int, ...], Said]]:
    """Return what is said of segments once, each with the numbers of those of which it is said."""
    of: dict[Said, list[int]] = {}
    for number, what in said:
        of.setdefault(what, []).append(number)
    return [(tuple(sorted(set(numbers))), what) for what, numbers in of.items()]


class Refusal(NamedTuple):
    """Why a segment gave no alpha, and what to do about it."""

    segment: int
    fault: str
    remedy: str


@dataclass(frozen=True, eq=False, repr=False)
class OfSegments(Generic[Found]):
    """What was found of each segment by its number.

    Attributes
    ----------
    instrument
        The mirror.
    layout
        The n actuators of all segments.
    segments
        What was found of a segment, by its number.
    refused
        Why nothing of the others, each with its remedy, by number.

    Raises
    ------
    FormatError
        The two do not name each segment once, or something is of other actuators.
    """

    instrument: str
    layout: Layout
    segments: Mapping[int, Found]
    refused: Mapping[int, tuple[Fault, ...]]

    def __post_init__(self) -> None:
        numbers = sorted((*self.segments, *self.refused))
        if not self.segments or tuple(numbers) != self.layout.segments:
            raise FormatError(
                "SEGMENTS does not name each segment of the actuators once",
                remedy="make the file again",
                got=tuple(numbers),
                want=self.layout.segments,
            )
        for number, one in self.segments.items():
            if not np.array_equal(one.layout.id, self.layout.id[self.layout.segment == number]):
                raise FormatError(
                    f"the actuators of segment {number} are not those of the mirror",
                    remedy="make the file again",
                )
        for name in ("segments", "refused"):
            ordered = dict(sorted(getattr(self, name).items()))
            object.__setattr__(self, name, MappingProxyType(ordered))

    def __repr__(self) -> str:
        no = f", {len(self.refused)} refused" if self.refused else ""
        name = f"{type(self).__name__} of {self.instrument}"
        return f"<{name}: {counted(self.numbers, 'segment')}{no}>"

    @property
    def numbers(self) -> tuple[int, ...]:
        """Of the segments, ascending; also of those refused."""
        return self.layout.segments

    def segment(self, number: int) -> Found:
        """Return what was found of one segment.

        Raises
        ------
        UnknownName
            There is no such segment.
        RankDeficient
            It gave no alpha; the message says why.
        """
        if number in self.refused:
            fault, remedy = self.refused[number][0]
            raise RankDeficient(f"segment {number} gave no alpha: {fault}", remedy=remedy)
        require_segment(number, self.numbers)
        return self.segments[number]

    @property
    def refusals(self) -> tuple[Refusal, ...]:
        """The same as ``refused``, in rows."""
        return tuple(
            Refusal(number, *fault) for number, faults in self.refused.items() for fault in faults
        )

    def of_actuators(self, value: Callable[[Found], Array]) -> Array:
        """Return (n,) what each segment has of its actuators; NaN of those refused."""
        out = np.full(self.layout.n, np.nan)
        for number, one in self.segments.items():
            out[self.layout.segment == number] = value(one)
        return out

    @property
    def alpha(self) -> Array:
        """(n,) true Newton / commanded Newton."""
        return self.of_actuators(lambda one: one.alpha)
