"""How far a campaign is, for whoever looks on."""

from __future__ import annotations

from dataclasses import dataclass, replace
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
    largest_force, smallest_gap
        So far in this run [N], [m].
    taken, seconds
        Shapes of this run, and what they took [s]; changing loads is not counted.
    invalid, in_a_row
        Shapes of this run that are not valid, and how many of the last ones.
    """

    shape: Shape
    cycles: int
    shapes: int
    done: int
    total: int
    smallest_gap: float
    largest_force: float = 0.0
    taken: int = 0
    seconds: float = 0.0
    invalid: int = 0
    in_a_row: int = 0

    @property
    def seconds_left(self) -> float:
        """At the pace of this run [s]."""
        return self.seconds / self.taken * (self.total - self.done)

    def with_taken(self, shape: Shape, valid: bool, seconds: float) -> Progress:
        """Return how far it is with one shape more, which took so long [s]."""
        return replace(
            self,
            shape=shape,
            done=self.done + 1,
            taken=self.taken + 1,
            seconds=self.seconds + seconds,
            invalid=self.invalid + (not valid),
            in_a_row=0 if valid else self.in_a_row + 1,
        )


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
