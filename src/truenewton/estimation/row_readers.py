"""One walk through the rows of a campaign, for all who want to see them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

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
    rows
        Which of its rows that count.
    force
        (m, n) commanded forces of the enabled actuators [N].
    """

    cycle_index: int
    cycle: Cycle
    rows: slice
    force: Array

    @cached_property
    def position(self) -> Array:
        """(m, n) readings of the sensors [m]; read for the first who asks."""
        if self.cycle.position is None:
            raise ValueError(f"{self.cycle!r} holds no POSITION")
        return self.cycle.used(self.cycle.position, self.rows)


class RowReader(Protocol):
    """Sums up what it wants of the rows, which come a cycle after the other."""

    def take(self, block: RowBlock) -> None:
        """Take the next rows in."""

    def end_cycle(self, cycle_index: int) -> None:
        """Conclude a cycle: all of its rows that count have come."""


def read_rows(campaign: Campaign, readers: Sequence[RowReader]) -> None:
    """Read the rows that count once, a block of some megabytes after the other."""
    for k, cycle in enumerate(campaign.cycles):
        for rows in cycle.used_blocks():
            block = RowBlock(k, cycle, rows, cycle.used(cycle.force, rows))
            for reader in readers:
                reader.take(block)
        for reader in readers:
            reader.end_cycle(k)
