"""Cycles of one mirror that are calibrated together, and the checks that they agree."""

from __future__ import annotations

import datetime
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from operator import attrgetter
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from truenewton.arrays import Array
from truenewton.errors import CampaignMismatch
from truenewton.records.cycle import Cycle
from truenewton.records.stiffness_matrix import StiffnessMatrix
from truenewton.records.tables import check_size, cycles_from_arrays, layout_of
from truenewton.rounding import counted, html_table, with_error
from truenewton.statics.arms import effective_weight
from truenewton.statics.layout import Layout
from truenewton.statics.load import Load

OF_MIRROR = {"instrument": "INSTRUME", "weight": "WEIGHT", "weight_error": "E_WEIGHT"}
OF_LOAD = {
    "load.added": "ADDED",
    "load.added_error": "E_ADDED",
    "load.tilt": "TILT",
    "load.tilt_error": "E_TILT",
    "load.coil_shift": "COILZ",
    "load.coil_shift_error": "E_COILZ",
    "load.tool": "TOOL",
}


@dataclass(frozen=True, eq=False, repr=False)
class Campaign:
    """Cycles of one mirror that are calibrated together; a sequence of them.

    Attributes
    ----------
    cycles
        Ordered by load, the bare one first, then by number.
    stiffness
        A stiffness matrix of the same mirror, which improves alpha; or None.

    Raises
    ------
    CampaignMismatch
        Cycles disagree on the mirror, a weight or the actuators, or are given twice.

    Examples
    --------
    >>> campaign
    <Campaign of P45: 45 actuators, 4 cycles under bare, ring>
    >>> [load.name for load in campaign.loads]
    ['bare', 'ring']
    """

    cycles: tuple[Cycle, ...]
    stiffness: StiffnessMatrix | None = None

    @classmethod
    def from_arrays(
        cls,
        instrument: str,
        positions: Layout | ArrayLike | tuple[ArrayLike, ArrayLike],
        weight: Any,
        weight_error: Any,
        loads: Mapping[Load, Sequence[Mapping[str, Any]]],
        *,
        units: Mapping[str, str] = MappingProxyType({}),
        enabled: ArrayLike | None = None,
        date: datetime.datetime | None = None,
        **more: Any,
    ) -> Campaign:
        """Make a campaign from the arrays of each cycle.

        Weights are forces [N], negative as z points up, or masses: these are positive, and are
        converted with standard gravity, 9.80665 m/s2. Local gravity may differ by 0.3 %, and alpha
        with it, so give a force if you know it better.

        Parameters
        ----------
        instrument
            Name of the mirror.
        positions, enabled
            A layout, a table with columns x, y and, if there are, id, nz and enabled, a pair of
            (n,) x and y, or (n, 2) positions [m]; (n,) false for actuators that give no force.
        weight, weight_error
            Weight of the mirror and its standard uncertainty.
        loads
            For each load a sequence of its cycles, each a dictionary: ``force`` (N, n) [N],
            ``shape`` (N,) from 1, ``sign`` (N,) +1 or -1. Optional are ``position`` (N, n) [m],
            ``temperature`` (N,) [deg C], ``valid`` (N,), true by default, ``time`` (N,) [s] or
            dates, by default one reading a second, ``date`` and ``number``.
        units
            Units of arrays and positions without one: ``{"force": "mN", "positions": "mm"}``.
        date
            Start of the first cycle (UTC), by default now. A cycle without a date of its own
            begins after the one before.
        more
            Other values of `Cycle`: ``gap``, ``force_error``, ``coil_gradient``, ``bias_gradient``.

        Raises
        ------
        FormatError, GeometryError, CampaignMismatch

        Examples
        --------
        >>> import astropy.units as u
        >>> bare, ring = tn.Load("bare"), tn.Load("ring", 29.5 * u.g, 0.5 * u.g)
        >>> cycles = [
        ...     {"force": c.force, "shape": c.shape, "sign": c.sign} for c in campaign.cycles
        ... ]
        >>> tn.Campaign.from_arrays(
        ...     "P45", (layout.x, layout.y), -2.92, 0.005, {bare: cycles[:2], ring: cycles[2:]}
        ... )
        <Campaign of P45: 45 actuators, 4 cycles under bare, ring>
        """
        actuators = layout_of(positions, enabled, units.get("positions", ""))
        if actuators.segments:
            raise CampaignMismatch(
                f"the layout has {len(actuators.segments)} segments, which balance separately",
                remedy="make a campaign of each",
            )
        mirror = {"instrument": instrument, "layout": actuators, **more}
        mirror |= {"weight": weight, "weight_error": weight_error}
        made = cls(tuple(cycles_from_arrays(mirror, loads, date, units)))
        check_size(actuators, made.weight)
        return made

    def __post_init__(self) -> None:
        if self.cycles and (pieces := self.layout.segments):
            raise CampaignMismatch(
                f"has {len(pieces)} segments, which balance separately",
                remedy=f"take one: of_segment({pieces[0]}) of each cycle",
                path=self.cycles[0].name,
            )
        object.__setattr__(self, "cycles", ordered_cycles(self.cycles))
        refuse_foreign(self.stiffness, self.cycles[0])

    def __repr__(self) -> str:
        loads = ", ".join(load.name for load in self.loads)
        return (
            f"<Campaign of {self.instrument}: {counted(self.layout.n, 'actuator')},"
            f" {counted(self.cycles, 'cycle')} under {loads}>"
        )

    def _repr_html_(self) -> str:
        rows = [("mirror", f"{-self.weight:.6g} ± {self.weight_error:.2g} N", "WEIGHT, downwards")]
        for load in self.loads:
            cycles = [cycle for cycle in self if cycle.load.key == load.key]
            count = counted(sum(cycle.shape.size for cycle in cycles), "row")
            added = f"{with_error(load.added, load.added_error)} N added" if load.added else ""
            rows.append((load.name, f"{counted(cycles, 'cycle')}, {count}", added))
        return html_table(repr(self)[1:-1], rows)

    def __len__(self) -> int:
        return len(self.cycles)

    def __iter__(self) -> Iterator[Cycle]:
        return iter(self.cycles)

    @cached_property
    def layout(self) -> Layout:
        """The actuators."""
        return self.cycles[0].layout

    @property
    def instrument(self) -> str:
        """The mirror's name."""
        return self.cycles[0].instrument

    @property
    def weight(self) -> float:
        """P [N]."""
        return self.cycles[0].weight

    @property
    def weight_error(self) -> float:
        """Standard uncertainty of P [N]."""
        return self.cycles[0].weight_error

    @cached_property
    def loads(self) -> tuple[Load, ...]:
        """The loads, the bare one first."""
        return tuple({cycle.load.key: cycle.load for cycle in self.cycles[::-1]}.values())[::-1]

    @cached_property
    def load_index(self) -> tuple[int, ...]:
        """For each cycle, the index of its load in ``loads``."""
        keys = [load.key for load in self.loads]
        return tuple(keys.index(cycle.load.key) for cycle in self.cycles)

    @cached_property
    def effective_weights(self) -> Array:
        """W = (P + Q) cos(tilt) of each load [N]."""
        return effective_weight(
            self.weight, [load.added for load in self.loads], [load.tilt for load in self.loads]
        )


def mean_temperature(cycles: Iterable[Cycle]) -> float:
    """Return the mean over all valid rows [deg C]; NaN if no temperature is recorded."""
    recorded = [c.temperature[c.valid] for c in cycles if c.temperature is not None]
    return float(np.concatenate(recorded).mean()) if recorded else float("nan")


def load_temperatures(campaign: Campaign) -> Array:
    """Return (L,) mean temperature under each load [deg C]; NaN if it is not recorded."""
    return np.array(
        [
            mean_temperature(c for c in campaign.cycles if c.load.key == load.key)
            for load in campaign.loads
        ]
    )


def ordered_cycles(cycles: Iterable[Cycle]) -> tuple[Cycle, ...]:
    """Return cycles by load, the bare one first, then by number, if they are of one mirror."""
    ordered = sorted(cycles, key=_campaign_order)
    if not ordered:
        raise CampaignMismatch("there are no cycle files", remedy="give at least one")
    first, first_of_load = ordered[0], dict[str, Cycle]()
    seen: dict[tuple[str, int], Cycle] = {}
    of_mirror = "calibrate files of one campaign only"
    for cycle in ordered:
        of_load = f"correct it, or LOAD, which is '{cycle.load.name}' in both"
        before = first_of_load.setdefault(cycle.load.key, cycle)
        _agree(first, cycle, {} if first.segments else OF_MIRROR, of_mirror)
        if differ := first.layout.difference(cycle.layout):
            raise _mismatch(first, cycle, f"the ACTUATORS table ({differ})", of_mirror)
        _agree_on_segments(first, cycle, "weight", of_mirror)
        _agree_on_segments(before, cycle, "added", of_load)
        _agree(first, cycle, OF_MIRROR, of_mirror)
        _agree(before, cycle, OF_LOAD, of_load)
        double = seen.setdefault((cycle.load.key, cycle.number), cycle)
        if double is not cycle:
            raise CampaignMismatch(
                f"LOAD '{cycle.load.name}' has CYCLE {cycle.number} twice",
                remedy=f"remove one, or change its number (the other is {double.name})",
                path=cycle.name,
            )
    return tuple(ordered)


def refuse_foreign(matrix: StiffnessMatrix | None, cycle: Cycle) -> None:
    """Raise CampaignMismatch if a stiffness matrix is not of a cycle's mirror."""
    if matrix is None:
        return
    other = matrix.instrument != cycle.instrument
    apart = cycle.layout.difference(matrix.layout)
    if other or apart:
        raise CampaignMismatch(
            f"disagrees with {cycle.name} on "
            + ("INSTRUME" if other else f"the ACTUATORS table ({apart})"),
            remedy="give the stiffness matrix of the same mirror",
            path=matrix.source.file if matrix.source else "stiffness matrix",
        )


def refuse_other_mirror(given: Any, mirror: Any, than: str, path: str, remedy: str) -> None:
    """Raise CampaignMismatch if the data of a path are not of a mirror; ``than`` names its data."""
    fault, apart = "", mirror.layout.other_actuators(given.layout)
    if given.instrument != mirror.instrument:
        fault = f"is of {given.instrument}, {than} of {mirror.instrument}"
    elif apart:
        fault = f"has other actuators than {than}: {apart}"
    if fault:
        raise CampaignMismatch(fault, remedy=remedy, path=path)


def _campaign_order(cycle: Cycle) -> tuple[Any, ...]:
    load = cycle.load
    return (load.added != 0.0, load.tilt != 0.0, load.key, cycle.number)


def _mismatch(one: Cycle, other: Cycle, what: str, remedy: str) -> CampaignMismatch:
    fault = f"disagrees with {one.name} on {what}"
    return CampaignMismatch(fault, remedy=remedy, path=other.name)


def _agree(one: Cycle, other: Cycle, keywords: dict[str, str], remedy: str) -> None:
    """Raise CampaignMismatch if an attribute differs; ``keywords`` names it as in the files."""
    for attribute, keyword in keywords.items():
        a, b = map(attrgetter(attribute), (one, other))
        if a != b:
            raise _mismatch(one, other, f"{keyword} ({b} and {a})", remedy)


def _agree_on_segments(one: Cycle, other: Cycle, part: str, remedy: str) -> None:
    """Raise CampaignMismatch if the weights, or added weights, of segments differ."""
    for pair in zip(one.segments, other.segments, strict=True):
        a, b = ((getattr(each, part), getattr(each, f"{part}_error")) for each in pair)
        if a != b:
            names = f"{part.upper()} or E_{part.upper()} of segment {pair[0].number}"
            values = f"{b[0]:g} +- {b[1]:g} and {a[0]:g} +- {a[1]:g}"
            raise _mismatch(one, other, f"{names} ({values})", remedy)
