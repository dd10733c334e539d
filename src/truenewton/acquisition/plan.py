"""What a campaign shall be: shapes, loads, cycles and limits, as a person writes them down."""

from __future__ import annotations

import importlib.resources
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

from truenewton.bench.protocol import BENCH_KINDS, MAX_SAMPLES, BenchChoice, foreign_keys
from truenewton.errors import FormatError, LimitExceeded
from truenewton.files.toml import filled, read_toml
from truenewton.mirrors.file import mirror_from, segment_from, whole_mirror_from
from truenewton.mirrors.known import Mirror
from truenewton.mirrors.segmented import SegmentedMirror
from truenewton.quantities import Quantity, check_quantities, convert_quantities
from truenewton.records.file import SUFFIXES, cycle_name
from truenewton.rounding import numbered
from truenewton.statics.layout import MAX_ACTUATORS, Layout
from truenewton.statics.load import Load, check_load

MAX_CYCLES, MAX_TURNS = 999, 3
MIN_POSITIVE, MAX_NUMBER = 1e-12, 1e9  # of any number of a plan: squares of both stay numbers


def _positive(unit: str) -> Quantity:
    return Quantity(unit, MIN_POSITIVE, MAX_NUMBER)


def _not_negative(unit: str) -> Quantity:
    return Quantity(unit, 0.0, MAX_NUMBER)


def _count(low: int, high: int) -> Quantity:
    return Quantity("", low, high, f"give {low} to {high}")


@dataclass(frozen=True)
class PlannedShapes:
    """Which shapes, and how large.

    Attributes
    ----------
    source
        'modes': the stiffness modes of the model; else a file: a stiffness file for its measured
        modes, or a FITS image of shapes x actuators [m], taken as it stands.
    count
        How many, softest first; 0 for all.
    stroke
        Largest displacement of an actuator in any shape [m].
    force
        Largest force of an actuator that a shape may take, static forces aside [N]: true by the
        model, commanded by a measured matrix.

    Examples
    --------
    >>> tn.PlannedShapes(count=20, stroke=0.5e-6)  # the 20 softest, at half a micrometre
    PlannedShapes(source='modes', count=20, stroke=5e-07, force=0.3)
    """

    QUANTITIES: ClassVar = {
        "count": _not_negative(""), "stroke": _positive("m"), "force": _positive("N"),
    }  # fmt: skip

    source: str = "modes"
    count: int = 0
    stroke: float = 1e-6
    force: float = 0.3

    def __post_init__(self) -> None:
        convert_quantities(self)


@dataclass(frozen=True)
class MirrorLimits:
    """Limits of the mirror; checked before each command and after each reading.

    Attributes
    ----------
    force
        Largest commanded force of an actuator [N].
    saturation
        Commanded force at which a coil saturates, which no sample may come near [N]; 0.8 N [conf].
    displacement
        Largest displacement of an actuator from rest [m].
    gap
        Smallest distance from the reference plate [m].
    temperature
        Lowest and highest [deg C].

    Examples
    --------
    >>> limits = tn.MirrorLimits(force=0.4, gap=40e-6)
    >>> limits.saturation
    0.8
    """

    QUANTITIES: ClassVar = {
        "force": _positive("N"), "saturation": _positive("N"), "displacement": _positive("m"),
        "gap": _not_negative("m"), "temperature": Quantity("deg_C", -MAX_NUMBER, MAX_NUMBER),
    }  # fmt: skip

    force: float = 0.6
    saturation: float = 0.8
    displacement: float = 5e-6
    gap: float = 30e-6
    temperature: tuple[float, float] = (-10.0, 40.0)

    def __post_init__(self) -> None:
        convert_quantities(self)


@dataclass(frozen=True)
class AssumedDrift:
    """What drifts during a campaign, as far as the prediction reckons with it [guess].

    Attributes
    ----------
    alpha
        Relative change of all alphas in an hour.
    zero
        Change of the zeros of all force readings in an hour [N].
    remounting
        Standard deviation by which the zeros of all move at each change of load [N].

    Examples
    --------
    >>> tn.AssumedDrift(alpha=0.001)  # calm weather
    AssumedDrift(alpha=0.001, zero=1e-05, remounting=1e-05)
    """

    QUANTITIES: ClassVar = {
        "alpha": _not_negative(""), "zero": _not_negative("N"), "remounting": _not_negative("N"),
    }  # fmt: skip

    alpha: float = 3e-3
    zero: float = 1e-5
    remounting: float = 1e-5

    def __post_init__(self) -> None:
        convert_quantities(self)


@dataclass(frozen=True)
class AssumedSensors:
    """What the prediction of reciprocity reckons with.

    Attributes
    ----------
    noise
        Standard deviation of one position reading [m]; 3 nm a sample, of 2048 [paper].
    gain
        Of true displacement / reading over the sensors, relative; 0 where it is known.
    offset
        Of how far the sensors sit off their magnets along an axis [m]; 0 where they do not.
    """

    QUANTITIES: ClassVar = {
        "noise": _not_negative("m"), "gain": _not_negative(""), "offset": _not_negative("m"),
    }  # fmt: skip

    noise: float = 6.6e-11
    gain: float = 4e-3
    offset: float = 5e-4

    def __post_init__(self) -> None:
        convert_quantities(self)


@dataclass(frozen=True)
class CampaignPlan:
    """A day at the bench.

    Attributes
    ----------
    mirror
        Name of a known mirror, or a TOML file of one.
    loads
        In the order in which they are put on first; two different ones at least give the scale.
    cycles
        Runs through all shapes, both signs, under each load.
    samples
        Of one reading.
    settling
        Time given to the mirror after each command [s]; by itself what the pseudo-integrator of
        P45 takes (docs/simulated-bench.md).
    pause
        Time that it takes to change the load [s]; for the prediction only.
    force_noise
        Standard deviation of one reading that the prediction reckons with [N].
    shapes, limits, bench
        As they say.
    turns
        How often the way goes through the loads, there and back (`mountings`): 1, all cycles of a
        load before the next is put on; 2, bare-ring-bare; 3, bare-ring-bare-ring; 0, what pays.
    drift
        What the choice of turns reckons with; for the prediction only.
    sensors
        What the prediction of reciprocity reckons with.
    segment
        Number of the one segment that is taken, of a mirror in several; 0 of one in one piece.

    Examples
    --------
    >>> loads = tn.Load("bare"), tn.Load("ring", -0.289, 0.005, tool="ring A")
    >>> plan = tn.CampaignPlan("p45", loads, cycles=2, turns=2)  # bare, ring, bare
    >>> plan.limits.force
    0.6
    """

    QUANTITIES: ClassVar = {
        "cycles": _count(1, MAX_CYCLES), "samples": _count(1, MAX_SAMPLES),
        "turns": _count(0, MAX_TURNS), "segment": _count(0, MAX_ACTUATORS),
        "settling": _not_negative("s"), "pause": _not_negative("s"), "force_noise": _positive("N"),
    }  # fmt: skip

    mirror: str
    loads: tuple[Load, ...]
    cycles: int = 4
    samples: int = 2048
    settling: float = 0.15
    pause: float = 1800.0
    force_noise: float = 1e-4
    shapes: PlannedShapes = PlannedShapes()
    limits: MirrorLimits = MirrorLimits()
    bench: BenchChoice = BenchChoice()
    turns: int = 1
    drift: AssumedDrift = AssumedDrift()
    sensors: AssumedSensors = AssumedSensors()
    segment: int = 0

    def __post_init__(self) -> None:
        convert_quantities(self)
        check_quantities(self)
        if self.turns > self.cycles:
            raise _wrong("turns", self.turns, "give no more turns than cycles, or 0 for what pays")
        shapes, limits, bench = self.shapes, self.limits, self.bench
        if not limits.temperature[0] < limits.temperature[1]:
            raise _wrong("limits.temperature", list(limits.temperature), "lowest first")
        if bench.kind not in BENCH_KINDS:
            raise _wrong("bench.kind", bench.kind, f"choose {', '.join(BENCH_KINDS)}")
        for name in foreign_keys(bench):
            remedy = f"take it out: a bench of kind '{bench.kind}' does not use it"
            raise _wrong(f"bench.{name}", getattr(bench, name), remedy)
        _check_loads(self.loads)
        for what, limit, planned in (
            ("stroke", limits.displacement, shapes.stroke),
            ("force", limits.force, shapes.force),
        ):
            if planned > limit:
                raise LimitExceeded(
                    f"shapes.{what} is {planned:g}, beyond its limit of {limit:g}",
                    remedy="plan smaller shapes", got=planned, want=limit,
                )  # fmt: skip


def _check_loads(loads: Sequence[Load]) -> None:
    """Refuse loads that cannot be, and those with the same name or file."""
    files: dict[str, Load] = {}
    for load in loads:
        try:
            check_load(load)
        except FormatError as error:
            raise error.changed(fault=f"load '{load.name}': {error.fault}") from None
        for name in (load.name, load.tool or ""):
            if not (name.isascii() and name.isprintable()):
                raise FormatError(
                    f"the name {name!r} of a load or tool cannot stand in a FITS header",
                    remedy="write it in plain ASCII",
                )
        other = files.setdefault(cycle_name(load, 1), load)
        if other.key != load.key:
            raise FormatError(
                f"the loads '{other.name}' and '{load.name}' would share the name of their files",
                remedy="name one of them otherwise",
            )
    if not files or len(files) < len(loads):
        names = [load.key for load in loads]
        raise _wrong("loads", names, "give every load once, with a name of its own")


def _wrong(name: str, got: Any, remedy: str) -> FormatError:
    return FormatError(f"{name} is {got!r}", remedy=remedy, got=got)


def read_plan(path: str | os.PathLike[str]) -> CampaignPlan:
    """Read a plan (TOML); files that it names stand relative to it.

    Parameters
    ----------
    path
        The plan.

    Raises
    ------
    UnreadableFile, FormatError, LimitExceeded

    Examples
    --------
    >>> plan = tn.read_plan("day.toml")
    >>> [load.name for load in plan.loads], plan.cycles
    (['bare', 'ring'], 4)
    """
    if Path(path).is_dir() or os.fspath(path).endswith(SUFFIXES):
        raise FormatError(
            "is a folder" if Path(path).is_dir() else "is named as FITS files are",
            remedy="give the plan, a TOML file; `truenewton plan --new` prints one to start from",
            path=path,
        )
    return filled(CampaignPlan, read_toml(path), path)


def template() -> str:
    """Return a commented plan (TOML), valid as it stands: P45 without and with the ring."""
    file = importlib.resources.files("truenewton.acquisition") / "plan.toml"
    return file.read_text(encoding="utf-8")


def planned_mirror(plan: CampaignPlan, folder: str | os.PathLike[str] = ".") -> Mirror:
    """Return the mirror of a plan, or its segment; a file stands relative to the plan's folder."""
    name = _mirror_of(plan, folder)
    return segment_from(name, plan.segment)[0] if plan.segment else mirror_from(name)


def recorded_layout(plan: CampaignPlan, folder: str | os.PathLike[str] = ".") -> Layout:
    """Return the actuators as in cycle files, which place those of a segment as in the whole."""
    name = _mirror_of(plan, folder)
    return segment_from(name, plan.segment)[1] if plan.segment else mirror_from(name).layout


def planned_bodies(plan: CampaignPlan, folder: str | os.PathLike[str] = ".") -> dict[str, Mirror]:
    """Return the mirror of a plan, or the segments of it that differ; by how to call each."""
    if plan.segment:
        one = planned_mirror(plan, folder)
        return {one.name: one}
    whole = whole_mirror_from(_mirror_of(plan, folder))
    if not isinstance(whole, SegmentedMirror):
        return {whole.name: whole}
    bodies = {}
    for segment, (first, *others) in whole.kinds:
        alike = f" (as {numbered('segment', others)})" if others else ""
        bodies[f"{whole.name} segment {first}{alike}"] = segment
    return bodies


def _mirror_of(plan: CampaignPlan, folder: str | os.PathLike[str]) -> Path | str:
    beside = Path(folder) / plan.mirror
    return beside if beside.is_file() else plan.mirror
