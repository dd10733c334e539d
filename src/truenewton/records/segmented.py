"""What was measured of a mirror in several segments, which balance each by itself."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np

from truenewton.arrays import Array
from truenewton.errors import CampaignMismatch, FormatError
from truenewton.records.campaign import Campaign, ordered_cycles, refuse_foreign
from truenewton.records.cycle import Cycle
from truenewton.records.parts import InParts
from truenewton.records.stiffness_matrix import StiffnessMatrix
from truenewton.rounding import counted
from truenewton.statics.layout import Layout

# Of what stands between segments: standard deviations by which it is reciprocal, as noise is not;
# and its rms in terms of that of a segment's own elements, beyond which it is no mere noise either.
RECIPROCAL, LARGE, ROUNDING = 6.0, 0.3, 1e-9


@dataclass(frozen=True, eq=False, repr=False)
class SegmentedData(InParts[Campaign | StiffnessMatrix]):
    """Cycles of a mirror in several segments, its stiffness matrix, or both.

    Attributes
    ----------
    cycles
        Of all segments, or each of one or some; those of the same segments ordered by load, the
        bare one first, then by number. Empty where there is a matrix alone.
    stiffness
        Of all segments; or None.

    Raises
    ------
    CampaignMismatch
        Cycles that disagree on the mirror, a weight or the actuators, or stand twice.
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
                    "a stiffness matrix stands among cycles of single segments",
                    remedy="calibrate it by itself",
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
        """The first cycle of those that are of the same segments, by the numbers of these."""
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
        """Return what was measured of one segment: a mirror in one piece.

        Raises
        ------
        GeometryError, FormatError
            It has no actuator that is enabled, or its data hold what they may not.
        """
        matrix = None if self.stiffness is None else segment_of_matrix(self.stiffness, number)
        own = tuple(_part(cycle, number) for cycle in self.cycles if number in cycle.numbers)
        if own:
            return Campaign(own, matrix)
        assert matrix is not None
        return matrix


def mirror_of(cycle: Cycle) -> str:
    """Return the name of the whole mirror: INSTRUME, which may end in a single segment's number."""
    name, numbers = cycle.instrument, cycle.numbers
    return name.removesuffix(f" segment {numbers[0]}") if len(numbers) == 1 else name


def _part(cycle: Cycle, number: int) -> Cycle:
    """Return what concerns one segment, called by its number."""
    if cycle.layout.segments:
        return cycle.of_segment(number)
    return replace(cycle, instrument=f"{mirror_of(cycle)} segment {number}")


def in_segments(cycles: Sequence[Cycle]) -> bool:
    """Tell whether cycles are of a mirror in several segments, or of single ones that differ."""
    return len({number for cycle in cycles for number in cycle.numbers}) > 1


def _ordered(cycles: Sequence[Cycle]) -> tuple[Cycle, ...]:
    """Return cycles by the segments that they are of, then in the order of a campaign.

    Raises
    ------
    FormatError, CampaignMismatch
    """
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
            "says of no segment that it is of, where others do",
            remedy="give ACTUATORS the column SEGMENT",
            path=groups[()][0].name,
        )
    return tuple(cycle for numbers in sorted(groups) for cycle in ordered_cycles(groups[numbers]))


def _joined(parts: Sequence[Layout]) -> Layout:
    """Return the actuators of several layouts, one after the other; None where one has none.

    Raises
    ------
    GeometryError
        They do not go together.
    """
    columns: dict[str, Any] = {}
    for name in (each.name for each in fields(Layout)):
        column = [getattr(part, name) for part in parts]
        lacking = any(one is None for one in column)
        columns[name] = None if lacking else np.concatenate(column)
    return Layout(**columns)


def segment_of_matrix(matrix: StiffnessMatrix, number: int) -> StiffnessMatrix:
    """Return the stiffness of one segment of a mirror.

    Raises
    ------
    GeometryError, FormatError
    """
    chosen = np.asarray(matrix.layout.segment) == number
    return replace(
        matrix,
        instrument=f"{matrix.instrument} segment {number}",
        layout=matrix.layout.part(chosen),
        stiffness=matrix.stiffness[np.ix_(chosen, chosen)],
    )


def refuse_segments(matrix: StiffnessMatrix) -> None:
    """Refuse a stiffness matrix of several segments where one body is wanted.

    Raises
    ------
    FormatError
    """
    if pieces := matrix.layout.segments:
        raise FormatError(
            f"STIFFNESS is of {len(pieces)} segments, which balance each by itself",
            remedy="give SegmentedData(stiffness=...), or a segment of it",
            path=matrix.source.file if matrix.source else None,
        )


def segment_couplings(matrix: StiffnessMatrix) -> dict[int, tuple[float, float]]:
    """Return, of each segment that is coupled to others by more than noise, by how much.

    The rms of the elements to others, and of its own [N/m].

    Segments do not touch, so all that may stand between them is noise: a force that answers a
    displacement the other way round too (Maxwell-Betti), or one as large as those of a segment
    itself, is none.
    """
    on, segment = matrix.layout.enabled, np.asarray(matrix.layout.segment)
    couplings = {}
    for number in matrix.layout.segments:
        own, others = on & (segment == number), on & (segment != number)
        if not (own.any() and others.any()):
            continue
        usual = _rms(matrix.stiffness[np.ix_(own, own)])
        there = matrix.stiffness[np.ix_(others, own)]
        back = matrix.stiffness[np.ix_(own, others)].T
        size = max(_rms(there), _rms(back))
        if not size > ROUNDING * usual:
            continue
        alike = float(np.mean(there * back)) / max(_rms(there) * _rms(back), 1e-300)
        if alike * np.sqrt(there.size) > RECIPROCAL or size > LARGE * usual:
            couplings[number] = size, usual
    return couplings


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))
