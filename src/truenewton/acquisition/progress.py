"""How far a campaign is, for whoever looks on."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from truenewton.bench.protocol import Shape


@dataclass(frozen=True)
class Progress:
    """How far a campaign is.

    Attributes
    ----------
    shape
        The one just taken.
    cycles, shapes
        Cycles under each load, and shapes of each cycle, to be taken with both signs.
    done, total
        Shapes taken and planned, of the whole campaign, each sign counted.
    invalid
        How many of this run are not valid.
    largest_force, smallest_gap
        So far in this run [N], [m].
    seconds_left
        At the pace of this run [s]; time in which loads are changed not counted.
    """

    shape: Shape
    cycles: int
    shapes: int
    done: int
    total: int
    invalid: int
    largest_force: float
    smallest_gap: float
    seconds_left: float


class Onlooker(Protocol):
    """Who is told how it goes."""

    def progress(self, now: Progress) -> None:
        """Show how far it is; called after each shape."""

    def say(self, line: str) -> None:
        """Show one line: a load that is on, a reading that was not sound, a bench that is gone."""


class Nobody:
    """An onlooker who does not care."""

    def progress(self, now: Progress) -> None:
        """Look away."""

    def say(self, line: str) -> None:
        """Turn a deaf ear."""
