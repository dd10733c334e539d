"""The plan of a campaign: shapes, loads, cycles and limits, and the forces of its shapes."""

from __future__ import annotations

import importlib.resources
import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from truenewton.arrays import Array
from truenewton.bench.choice import BENCH_KINDS, BenchChoice, foreign_keys
from truenewton.bench.protocol import MAX_SAMPLES
from truenewton.errors import FormatError, LimitExceeded
from truenewton.files.fits import SUFFIXES, read_fits
from truenewton.files.toml import filled, read_toml
from truenewton.mirrors.file import mirror_from, segment_from, whole_mirror_from
from truenewton.mirrors.known import Mirror
from truenewton.mirrors.segmented import SegmentedMirror
from truenewton.mirrors.shell.shell_model import ShellModel, model_shell
from truenewton.quantities import Quantity, check_quantities, convert_quantities
from truenewton.records.cycle import LARGEST_DISPLACEMENT
from truenewton.records.file import cycle_name, stiffness_from
from truenewton.rounding import numbered
from truenewton.statics.layout import MAX_ACTUATORS, Layout
from truenewton.statics.load import Load, check_load
from truenewton.statics.modes import scaled_modes, stiffness_modes

MAX_CYCLES, MAX_TURNS = 999, 3
MIN_POSITIVE, MAX_NUMBER = 1e-12, 1e9  # of any number of a plan: squares of both stay numbers


def _positive(unit: str) -> Quantity:
    return Quantity(unit, MIN_POSITIVE, MAX_NUMBER)


def _not_negative(unit: str) -> Quantity:
    return Quantity(unit, 0.0, MAX_NUMBER)


def _count(low: int, high: int) -> Quantity:
    return Quantity("", low, high, f"give {low} to {high}")


class Table:
    """Base of the tables of a plan. Their numbers may be quantities with units."""

    def __post_init__(self) -> None:
        convert_quantities(self)


@dataclass(frozen=True)
class PlannedShapes(Table):
    """The shapes of a campaign and their size.

    Attributes
    ----------
    source
        'modes': stiffness modes of the model. Otherwise a file: a stiffness file for its measured
        modes, or a FITS image SHAPES of shapes x actuators [m], which is not scaled.
    count
        Number of shapes, softest first; 0 for all.
    stroke
        Largest displacement of an actuator in any shape [m].
    force
        Largest force of an actuator in a shape, without static forces [N]: true force by the model,
        commanded force by a measured matrix.

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


@dataclass(frozen=True)
class MirrorLimits(Table):
    """Limits of the mirror, checked before each command and after each reading.

    Attributes
    ----------
    force
        Largest commanded force of an actuator [N].
    saturation
        Commanded force at which a coil saturates [N]; 0.8 N [conf].
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


@dataclass(frozen=True)
class AssumedSensors(Table):
    """Properties of the sensors, as assumed by the prediction of reciprocity.

    Attributes
    ----------
    noise
        Standard deviation of one position reading [m]; 3 nm a sample, of 2048 [paper].
    gain
        Scatter of true displacement / reading over the sensors, relative; 0 if it is known.
    offset
        Scatter of the distance of a sensor from its magnet along an axis [m].
    """

    QUANTITIES: ClassVar = {
        "noise": _not_negative("m"), "gain": _not_negative(""), "offset": _not_negative("m"),
    }  # fmt: skip

    noise: float = 6.6e-11
    gain: float = 4e-3
    offset: float = 5e-4


@dataclass(frozen=True)
class CampaignPlan(Table):
    """A campaign: mirror, loads, cycles, shapes and limits.

    Attributes
    ----------
    mirror
        Name of a known mirror, or its TOML file.
    loads
        In the order in which they are first mounted. Two different weights determine the scale.
    cycles
        Cycles under each load. One cycle takes all shapes with both signs.
    samples
        Number of samples per reading.
    settling
        Time between command and reading [s]; by default that of P45 (docs/simulated-bench.md).
    pause
        Time to change the load [s]; for the prediction only.
    force_noise
        Standard deviation of one reading [N]; for the prediction only.
    shapes, limits, bench
        Tables of the plan.
    turns
        Order of the loads (`mountings`). 1: bare-ring. 2: bare-ring-bare. 3: bare-ring-bare-ring.
    sensors
        Assumptions of the prediction.
    segment
        Number of the segment of a segmented mirror; 0 for a mirror in one piece.

    Examples
    --------
    >>> loads = tn.Load("bare"), tn.Load("ring", -0.289, 0.005, tool="ring A")
    >>> plan = tn.CampaignPlan("p45", loads, cycles=2, turns=2)  # bare, ring, bare
    >>> plan.limits.force
    0.6
    """

    QUANTITIES: ClassVar = {
        "cycles": _count(1, MAX_CYCLES), "samples": _count(1, MAX_SAMPLES),
        "turns": _count(1, MAX_TURNS), "segment": _count(0, MAX_ACTUATORS),
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
    sensors: AssumedSensors = AssumedSensors()
    segment: int = 0

    def __post_init__(self) -> None:
        super().__post_init__()
        check_quantities(self)
        if self.turns > self.cycles:
            raise _wrong("turns", self.turns, "use no more turns than cycles")
        shapes, limits, bench = self.shapes, self.limits, self.bench
        if not limits.temperature[0] < limits.temperature[1]:
            raise _wrong("limits.temperature", list(limits.temperature), "put the lowest first")
        if bench.kind not in BENCH_KINDS:
            raise _wrong("bench.kind", bench.kind, f"choose {', '.join(BENCH_KINDS)}")
        for name in foreign_keys(bench):
            remedy = f"remove it: a bench of kind '{bench.kind}' does not use it"
            raise _wrong(f"bench.{name}", getattr(bench, name), remedy)
        _check_loads(self.loads)
        for what, limit, planned in (
            ("stroke", limits.displacement, shapes.stroke),
            ("force", limits.force, shapes.force),
        ):
            if planned > limit:
                raise LimitExceeded(
                    f"shapes.{what} is {planned:g}, beyond its limit of {limit:g}",
                    remedy="plan smaller shapes",
                )  # fmt: skip


def _check_loads(loads: Sequence[Load]) -> None:
    """Refuse loads that are not valid, and those with the same name or file."""
    files: dict[str, Load] = {}
    for load in loads:
        try:
            check_load(load)
        except FormatError as error:
            raise error.changed(fault=f"load '{load.name}': {error.fault}") from None
        for name in (load.name, load.tool or ""):
            if not (name.isascii() and name.isprintable()):
                raise FormatError(
                    f"the name {name!r} of a load or tool is not allowed in a FITS header",
                    remedy="write it in plain ASCII",
                )
        other = files.setdefault(cycle_name(load, 1), load)
        if other.key != load.key:
            raise FormatError(
                f"the loads '{other.name}' and '{load.name}' would share the name of their files",
                remedy="rename one of them",
            )
    if not files or len(files) < len(loads):
        names = [load.key for load in loads]
        raise _wrong("loads", names, "list each load once, with its own name")


def _wrong(name: str, got: Any, remedy: str) -> FormatError:
    return FormatError(f"{name} is {got!r}", remedy=remedy)


def read_plan(path: str | os.PathLike[str]) -> CampaignPlan:
    """Read a plan (TOML); files that it names are relative to it.

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
            "is a folder" if Path(path).is_dir() else "has the name of a FITS file",
            remedy="specify a plan, a TOML file; `truenewton plan --new` prints one",
            path=path,
        )
    return filled(CampaignPlan, read_toml(path), path)


def template() -> str:
    """Return a commented plan (TOML), valid as it is: P45 without and with an added weight."""
    file = importlib.resources.files("truenewton.acquisition") / "plan.toml"
    return file.read_text(encoding="utf-8")


def planned_mirror(
    plan: CampaignPlan, folder: str | os.PathLike[str] = "."
) -> tuple[Mirror, Layout]:
    """Return the mirror of a plan, or its segment, and the layout of the cycle files.

    In the files a segment is placed as in the whole mirror. A file is relative to the plan's
    folder.
    """
    name = _mirror_of(plan, folder)
    if plan.segment:
        return segment_from(name, plan.segment)
    mirror = mirror_from(name)
    return mirror, mirror.layout


def planned_bodies(plan: CampaignPlan, folder: str | os.PathLike[str] = ".") -> dict[str, Mirror]:
    """Return the mirror of a plan, or those of its segments that differ, by their names."""
    if plan.segment:
        one = planned_mirror(plan, folder)[0]
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


def expected_alpha(mirror: Mirror) -> float:
    """Return the alpha that a plan assumes: the middle of the range of the mirror model."""
    return float(np.mean(mirror.alpha_range))


def shapes_and_forces(
    plan: CampaignPlan,
    mirror: Mirror,
    folder: str | os.PathLike[str] = ".",
    glass: ShellModel | None = None,
) -> tuple[Array, Array, bool]:
    """Return the (shapes, n) displacements of a plan [m] and their commanded forces [N].

    Each shape is taken with both signs. The forces exclude those of the loads. They follow from the
    measured matrix if it is the source of the shapes, otherwise from the model / `expected_alpha`.
    Those of disabled actuators are 0. The third value is whether a file gives the shapes, which are
    then not scaled.
    """
    on, path = mirror.layout.enabled, Path(folder) / plan.shapes.source
    file = None if plan.shapes.source == "modes" else read_fits(path)
    given = file is not None and "STIFFNESS" not in file.extensions
    if file is None:
        true = (glass or model_glass(mirror)).stiffness
        stiffness = true / expected_alpha(mirror)
        chosen = _scaled(stiffness_modes(true).modes.T, true, plan)
    elif not given:
        matrix = stiffness_from(file)
        if apart := mirror.layout.difference(matrix.layout):
            raise FormatError(
                f"is not of the actuators of {mirror.name}: {apart}",
                remedy="plan with the measured matrix of the same mirror",
                path=path,
            )
        stiffness = matrix.used_stiffness
        chosen = _scaled(np.linalg.svd(stiffness)[2][::-1], stiffness, plan)
    else:
        image = file.pixels("SHAPES", "m")
        if image.ndim != 2 or image.shape[1] != on.size or not len(image):
            raise FormatError(
                f"SHAPES is {image.shape}", remedy=f"give shapes x {on.size} actuators", path=path
            )
        chosen = image[: plan.shapes.count or None, on]
        if not (np.abs(chosen) <= LARGEST_DISPLACEMENT).all():
            raise FormatError(
                f"SHAPES contains NaN, or displacements beyond {LARGEST_DISPLACEMENT:g} m",
                remedy="correct it",
                path=path,
            )
        stiffness = (glass or model_glass(mirror)).stiffness / expected_alpha(mirror)
    shapes, force = np.zeros((2, len(chosen), on.size))
    shapes[:, on], force[:, on] = chosen, chosen @ stiffness.T
    return shapes, force, given


def _scaled(modes: Array, stiffness: Array, plan: CampaignPlan) -> Array:
    """Return as many (shapes, n) modes as planned, scaled to stroke and force."""
    shapes = plan.shapes
    return scaled_modes(modes[: shapes.count or None], stiffness, shapes.stroke, shapes.force)


def model_glass(mirror: Mirror) -> ShellModel:
    """Return the shell model of a plan, supported by the enabled actuators only."""
    layout, on = mirror.layout, mirror.layout.enabled
    enabled = Layout(layout.id[on], layout.x[on], layout.y[on], layout.nz[on], on[on])
    return model_shell(replace(mirror, layout=enabled))
