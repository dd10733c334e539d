"""Data of a mirror in several segments, each of which balances separately."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np

from truenewton.arrays import rms
from truenewton.errors import CampaignMismatch, FormatError
from truenewton.records.campaign import Campaign, ordered_cycles, refuse_foreign
from truenewton.records.cycle import Cycle
from truenewton.records.parts import InParts
from truenewton.records.stiffness_matrix import StiffnessMatrix
from truenewton.rounding import counted
from truenewton.statics.layout import Layout

# Elements between segments that are more than noise: they are reciprocal, which noise is not, or
# their rms is large relative to that of a segment's own elements; or they are only rounding.
MIN_RECIPROCITY = 6.0  # standard deviations
MAX_RELATIVE_RMS, ROUNDING = 0.3, 1e-9


@dataclass(frozen=True, eq=False, repr=False)
class SegmentedData(InParts[Campaign | StiffnessMatrix]):
    """Cycles of a mirror in several segments, its stiffness matrix, or both.

    Attributes
    ----------
    cycles
        Of all segments, or each of one or some; those of the same segments are ordered by load,
        the bare one first, then by number. Empty if there is only a matrix.
    stiffness
        Of all segments; or None.

    Raises
    ------
    CampaignMismatch
        Cycles disagree on the mirror, a weight or the actuators, or are given twice.
    FormatError
        The mirror is in one piece, or nothing was given.

    Examples
    --------
    >>> tn.SegmentedData(stiffness=both).layout
    <Layout of 90 actuators of 2 segments>
    """

    instrument: str = field(init=False)
    layout: Layout = field(init=False)
    cycles: tuple[Cycle, ...] = ()
    stiffness: StiffnessMatrix | None = None

    def __post_init__(self) -> None:
        if self.cycles:
            object.__setattr__(self, "cycles", _ordered(self.cycles))
            if len(self._groups) == 1:
                refuse_foreign(self.stiffness, self.cycles[0])
            elif self.stiffness is not None:
                raise FormatError(
                    "a stiffness matrix was given with cycles of single segments",
                    remedy="calibrate it separately",
                    path=self.stiffness.source.file if self.stiffness.source else None,
                )
        elif self.stiffness is None:
            raise FormatError("there are no data", remedy="give cycles, a stiffness matrix or both")
        name = mirror_of(self.cycles[0]) if self.cycles else self._matrix.instrument
        object.__setattr__(self, "instrument", name)
        object.__setattr__(self, "layout", self._joined_layout())
        if not self.layout.segments:
            raise FormatError(
                "the mirror is in one piece", remedy="make a Campaign, or a StiffnessMatrix, of it"
            )

    def __repr__(self) -> str:
        what = counted(self.cycles, "cycle") if self.cycles else "a stiffness matrix"
        return (
            f"<SegmentedData of {self.instrument}: {counted(self.numbers, 'segment')},"
            f" {counted(self.layout.n, 'actuator')}, {what}>"
        )

    @property
    def _groups(self) -> dict[tuple[int, ...], Cycle]:
        """The first cycle of each set of segments, by their numbers."""
        return {cycle.numbers: cycle for cycle in self.cycles[::-1]}

    def _joined_layout(self) -> Layout:
        """Return all actuators; of cycles of single segments, segment after segment."""
        groups = self._groups
        if not groups:
            return self._matrix.layout
        if len(groups) == 1:
            return self.cycles[0].layout
        parts: dict[int, Layout] = {}
        for numbers in sorted(groups, key=len, reverse=True):
            whole = groups[numbers].layout
            for number in numbers:
                parts.setdefault(number, whole.part(np.asarray(whole.segment) == number))
        return _joined([parts[number] for number in sorted(parts)])

    @property
    def _matrix(self) -> StiffnessMatrix:
        assert self.stiffness is not None
        return self.stiffness

    def _part(self, number: int) -> Campaign | StiffnessMatrix:
        """Return the data of one segment as those of a mirror in one piece."""
        matrix = None if self.stiffness is None else _part_of_matrix(self.stiffness, number)
        own = tuple(_part(cycle, number) for cycle in self.cycles if number in cycle.numbers)
        if own:
            return Campaign(own, matrix)
        assert matrix is not None
        return matrix


def mirror_of(cycle: Cycle) -> str:
    """Return the name of the whole mirror: INSTRUME without the number of a single segment."""
    name, numbers = cycle.instrument, cycle.numbers
    return name.removesuffix(f" segment {numbers[0]}") if len(numbers) == 1 else name


def _part(cycle: Cycle, number: int) -> Cycle:
    """Return a cycle of one segment, with its number in INSTRUME."""
    if cycle.layout.segments:
        return cycle.of_segment(number)
    return replace(cycle, instrument=f"{mirror_of(cycle)} segment {number}")


def in_segments(cycles: Sequence[Cycle]) -> bool:
    """Return whether cycles are of more than one segment."""
    return len({number for cycle in cycles for number in cycle.numbers}) > 1


def _ordered(cycles: Sequence[Cycle]) -> tuple[Cycle, ...]:
    """Return cycles by segment, then in the order of a campaign, if they are of one mirror."""
    groups: dict[tuple[int, ...], list[Cycle]] = {}
    for cycle in cycles:
        groups.setdefault(cycle.numbers, []).append(cycle)
        if mirror_of(cycle) != mirror_of(cycles[0]):
            raise CampaignMismatch(
                f"is of {mirror_of(cycle)}, {cycles[0].name} of {mirror_of(cycles[0])}",
                remedy="calibrate files of one mirror only",
                path=cycle.name,
            )
    if () in groups and len(groups) > 1:
        raise FormatError(
            "has no segment, and other files have",
            remedy="add the column SEGMENT to ACTUATORS",
            path=groups[()][0].name,
        )
    return tuple(cycle for numbers in sorted(groups) for cycle in ordered_cycles(groups[numbers]))


def _joined(parts: Sequence[Layout]) -> Layout:
    """Return the actuators of several layouts in turn, without columns that one does not have."""
    columns: dict[str, Any] = {}
    for name in (each.name for each in fields(Layout)):
        column = [getattr(part, name) for part in parts]
        lacking = any(one is None for one in column)
        columns[name] = None if lacking else np.concatenate(column)
    return Layout(**columns)


def _part_of_matrix(matrix: StiffnessMatrix, number: int) -> StiffnessMatrix:
    """Return the stiffness of one segment of a mirror."""
    chosen = np.asarray(matrix.layout.segment) == number
    return replace(
        matrix,
        instrument=f"{matrix.instrument} segment {number}",
        layout=matrix.layout.part(chosen),
        stiffness=matrix.stiffness[np.ix_(chosen, chosen)],
        stored=None,
    )


def refuse_segments(matrix: StiffnessMatrix) -> None:
    """Raise FormatError for a stiffness matrix of several segments."""
    if pieces := matrix.layout.segments:
        raise FormatError(
            f"STIFFNESS is of {len(pieces)} segments, which balance separately",
            remedy="give SegmentedData(stiffness=...), or a segment of it",
            path=matrix.source.file if matrix.source else None,
        )


def segment_couplings(matrix: StiffnessMatrix) -> dict[int, tuple[float, float]]:
    """Return the segments that are coupled to others by more than noise.

    For each: the rms of the elements between it and others, and of its own elements [N/m]. Segments
    do not touch, so elements between them should be noise: neither reciprocal (Maxwell-Betti) nor
    as large as the segment's own.
    """
    on, segment = matrix.layout.enabled, np.asarray(matrix.layout.segment)
    couplings = {}
    for number in matrix.layout.segments:
        own, others = on & (segment == number), on & (segment != number)
        if not (own.any() and others.any()):
            continue
        usual = rms(matrix.stiffness[np.ix_(own, own)])
        there = matrix.stiffness[np.ix_(others, own)]
        back = matrix.stiffness[np.ix_(own, others)].T
        size = max(rms(there), rms(back))
        if not size > ROUNDING * usual:
            continue
        alike = float(np.mean(there * back)) / max(rms(there) * rms(back), 1e-300)
        if alike * np.sqrt(there.size) > MIN_RECIPROCITY or size > MAX_RELATIVE_RMS * usual:
            couplings[number] = size, usual
    return couplings
