"""The second reading of the rows of a campaign, once for all who want to see them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

from truenewton.arrays import Array
from truenewton.records.campaign import Campaign
from truenewton.records.cycle import Cycle


@dataclass(frozen=True, eq=False)
class RowBlock:
    """Some of the rows of a cycle that count, m of them, which follow each other.

    Attributes
    ----------
    cycle_index, cycle
        The cycle in its campaign.
    rows, last
        Which of its rows that count; whether these are the last of them.
    force
        (m, n) commanded forces of the enabled actuators [N].
    """

    cycle_index: int
    cycle: Cycle
    rows: slice
    last: bool
    force: Array

    @cached_property
    def position(self) -> Array:
        """(m, n) readings of the sensors [m]; read for the first who asks."""
        if self.cycle.position is None:
            raise ValueError(f"{self.cycle!r} holds no POSITION")
        return self.cycle.used(self.cycle.position, self.rows)


RowReader = Callable[[RowBlock], None]


def read_rows(campaign: Campaign, readers: Sequence[RowReader]) -> None:
    """Read the rows that count once: cycle after cycle, some megabytes at a time."""
    for k, cycle in enumerate(campaign.cycles):
        count = int(cycle.valid.sum())
        for rows in cycle.used_blocks():
            block = RowBlock(k, cycle, rows, rows.stop == count, cycle.used(cycle.force, rows))
            for take in readers:
                take(block)
