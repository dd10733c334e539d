"""What a campaign shall be: shapes, loads, cycles and limits, as a person writes them down."""

from __future__ import annotations

import importlib.resources
import os
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from truenewton.actuators import Array, Layout
from truenewton.campaign_files import is_stiffness_file, stiffness_from
from truenewton.errors import FormatError, LimitExceeded
from truenewton.fitsfiles import read_fits
from truenewton.load import Load, check_load
from truenewton.mirror_files import mirror_from
from truenewton.mirrors import Mirror
from truenewton.modes import stiffness_modes
from truenewton.settings import filled, read_toml
from truenewton.shell.held_glass import held_glass


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
    """

    source: str = "modes"
    count: int = 0
    stroke: float = 1e-6
    force: float = 0.3


@dataclass(frozen=True)
class Limits:
    """What the mirror may bear; checked before each command and after each reading.

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
    """

    force: float = 0.6
    saturation: float = 0.8
    displacement: float = 5e-6
    gap: float = 30e-6
    temperature: tuple[float, float] = (-10.0, 40.0)


@dataclass(frozen=True)
class BenchChoice:
    """Which bench takes the campaign.

    Attributes
    ----------
    kind
        'simulated', 'opcua', 'opticalib' or 'replay'.
    address
        URL of an OPC UA server, `module:object` of a mirror after opticalib, a recorded folder.
    seed, force_noise, fidelity
        Of the simulated bench.
    user, password_file, certificate, private_key, server_certificate
        With which to log on to an OPC UA server.
    """

    kind: str = "simulated"
    address: str = ""
    seed: int = 1
    force_noise: float = 1e-4
    fidelity: str = "static"
    user: str = ""
    password_file: str = ""
    certificate: str = ""
    private_key: str = ""
    server_certificate: str = ""


KINDS = ("simulated", "opcua", "opticalib", "replay")


@dataclass(frozen=True)
class CampaignPlan:
    """A day at the bench.

    Attributes
    ----------
    mirror
        Name of a known mirror, or a TOML file of one.
    loads
        In the order in which they are put on; two different ones at least give the scale.
    cycles
        Runs through all shapes, both signs, under each load.
    samples
        Of one reading.
    settling
        Time given to the mirror after each command [s].
    pause
        Time that it takes to change the load [s]; for the prediction only.
    force_noise
        Standard deviation of one reading that the prediction reckons with [N].
    shapes, limits, bench
        As they say.
    """

    mirror: str
    loads: tuple[Load, ...]
    cycles: int = 4
    samples: int = 2048
    settling: float = 0.02
    pause: float = 1800.0
    force_noise: float = 1e-4
    shapes: PlannedShapes = PlannedShapes()
    limits: Limits = Limits()
    bench: BenchChoice = BenchChoice()

    def __post_init__(self) -> None:
        for name, low, high in (("cycles", 1, 999), ("samples", 1, 10**9)):
            if not low <= getattr(self, name) <= high:
                raise _wrong(name, getattr(self, name), f"give {low} to {high}")
        shapes, limits, bench = self.shapes, self.limits, self.bench
        for name, value in (
            ("force_noise", self.force_noise), ("shapes.stroke", shapes.stroke),
            ("shapes.force", shapes.force), ("limits.force", limits.force),
            ("limits.displacement", limits.displacement), ("limits.saturation", limits.saturation),
        ):  # fmt: skip
            if not 0 < value < np.inf:
                raise _wrong(name, value, "give a positive number")
        for name, value in (
            ("settling", self.settling), ("pause", self.pause), ("limits.gap", limits.gap),
            ("shapes.count", shapes.count), ("bench.seed", bench.seed),
            ("bench.force_noise", bench.force_noise),
        ):  # fmt: skip
            if not 0 <= value < np.inf:
                raise _wrong(name, value, "give zero or more")
        if not limits.temperature[0] < limits.temperature[1]:
            raise _wrong("limits.temperature", list(limits.temperature), "lowest first")
        if bench.kind not in KINDS:
            raise _wrong("bench.kind", bench.kind, f"choose {', '.join(KINDS)}")
        for load in self.loads:
            try:
                check_load(load)
            except FormatError as error:
                raise FormatError(
                    f"load '{load.name}': {error.fault}", remedy=error.remedy, got=error.got
                ) from None
        names = [load.key for load in self.loads]
        if not names or len(set(names)) < len(names):
            raise _wrong("loads", names, "give every load once, with a name of its own")
        for what, limit, planned in (
            ("stroke", limits.displacement, shapes.stroke),
            ("force", limits.force, shapes.force),
        ):
            if planned > limit:
                raise LimitExceeded(
                    f"shapes.{what} is {planned:g}, beyond its limit of {limit:g}",
                    remedy="plan smaller shapes", got=planned, want=limit,
                )  # fmt: skip


def _wrong(name: str, got: Any, remedy: str) -> FormatError:
    return FormatError(f"{name} is {got!r}", remedy=remedy, got=got)


def read_plan(path: str | os.PathLike[str]) -> CampaignPlan:
    """Read a plan (TOML); files that it names stand relative to it.

    Raises
    ------
    UnreadableFile, FormatError, LimitExceeded
    """
    return filled(CampaignPlan, read_toml(path), path)


def template() -> str:
    """Return a commented plan (TOML), valid as it stands: P45 without and with the ring."""
    return (importlib.resources.files("truenewton") / "plan.toml").read_text(encoding="utf-8")


def planned_mirror(plan: CampaignPlan, folder: str | os.PathLike[str] = ".") -> Mirror:
    """Return the mirror of a plan; a file's name stands relative to the folder of the plan.

    Raises
    ------
    UnknownName, UnreadableFile, FormatError, GeometryError
    """
    beside = Path(folder) / plan.mirror
    return mirror_from(beside if beside.is_file() else plan.mirror)


def scaled_shapes(modes: Array, stiffness: Array, shapes: PlannedShapes) -> Array:
    """Return modes as large as stroke and force allow.

    Parameters
    ----------
    modes
        (m, n) displacements, softest first.
    stiffness
        (n, n) force per displacement [N/m].
    shapes
        The limits.

    Returns
    -------
    numpy.ndarray
        (count, n) [m].
    """
    chosen = modes[: shapes.count or None]
    force = np.abs(chosen @ stiffness.T).max(axis=1)
    stroke = np.abs(chosen).max(axis=1)
    limit = np.minimum(shapes.stroke / stroke, shapes.force / np.maximum(force, 1e-300))
    return np.asarray(chosen * limit[:, None])


def planned_shapes(
    plan: CampaignPlan, mirror: Mirror, folder: str | os.PathLike[str] = "."
) -> Array:
    """Return the (shapes, n) displacements of a plan [m], each to be taken with both signs.

    Raises
    ------
    UnreadableFile, FormatError
    """
    return shapes_and_forces(plan, mirror, folder)[0]


def expected_alpha(mirror: Mirror) -> float:
    """Return the true over commanded Newton that a plan reckons with: the middle of its range."""
    return float(np.mean(mirror.alpha_range))


def shapes_and_forces(
    plan: CampaignPlan, mirror: Mirror, folder: str | os.PathLike[str] = "."
) -> tuple[Array, Array]:
    """Return the shapes of a plan, and the forces that the electronics may be expected to command.

    Disabled actuators take no part: their displacement and force are 0.

    Returns
    -------
    shapes
        (shapes, n) displacements [m], each to be taken with both signs.
    force
        (shapes, n) commanded forces, those of the loads aside [N]: by the measured matrix where
        that gives the shapes, else by the model over `expected_alpha`.

    Raises
    ------
    UnreadableFile, FormatError
    """
    on = mirror.layout.enabled
    path = Path(folder) / plan.shapes.source
    if plan.shapes.source == "modes":
        true = model_stiffness(mirror)
        modes = stiffness_modes(true).modes.T
        scaled = scaled_shapes(modes, true, plan.shapes)
        return _spread(scaled, true / expected_alpha(mirror), on)
    file = read_fits(path)
    if is_stiffness_file(file):
        matrix = stiffness_from(file)
        if not matrix.layout.same_as(mirror.layout):
            raise FormatError(
                f"is not of the actuators of {mirror.name}",
                remedy="plan with the measured matrix of the same mirror",
                path=path,
            )
        measured = matrix.stiffness[np.ix_(on, on)]
        modes = np.linalg.svd(measured)[2][::-1]
        return _spread(scaled_shapes(modes, measured, plan.shapes), measured, on)
    shapes = file.image("SHAPES").values("m")
    if shapes.ndim != 2 or shapes.shape[1] != on.size or not len(shapes):
        raise FormatError(
            f"SHAPES is {shapes.shape}", remedy=f"give shapes x {on.size} actuators", path=path
        )
    chosen = shapes[: plan.shapes.count or None, on]
    if not np.isfinite(chosen).all():
        raise FormatError("SHAPES holds NaN or inf", remedy="correct it", path=path)
    return _spread(chosen, model_stiffness(mirror) / expected_alpha(mirror), on)


def shapes_are_given(plan: CampaignPlan, folder: str | os.PathLike[str] = ".") -> bool:
    """Tell whether a file gives the shapes as they stand, whatever stroke and force say."""
    source = plan.shapes.source
    return source != "modes" and not is_stiffness_file(read_fits(Path(folder) / source))


def model_stiffness(mirror: Mirror) -> Array:
    """Return (m, m) true force per reading of the enabled actuators, along normals [N/m]."""
    return held_glass(with_enabled_only(mirror)).stiffness


def with_enabled_only(mirror: Mirror) -> Mirror:
    """Return the mirror without its disabled actuators."""
    layout, on = mirror.layout, mirror.layout.enabled
    kept = Layout(layout.id[on], layout.x[on], layout.y[on], layout.nz[on], on[on])
    return replace(mirror, layout=kept)


def _spread(shapes: Array, stiffness: Array, on: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Return shapes of the enabled actuators and their forces in the order of all."""
    both = np.zeros((2, len(shapes), on.size))
    both[:, :, on] = shapes, shapes @ stiffness.T
    return both[0], both[1]
