"""What a campaign shall be: shapes, loads, cycles and limits, as a person writes them down."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from truenewton.actuators import Array
from truenewton.campaign_files import is_stiffness_file, stiffness_from
from truenewton.errors import FormatError, LimitExceeded
from truenewton.fitsfiles import read_fits
from truenewton.measurements import Load
from truenewton.mirror_files import mirror_from
from truenewton.mirrors import Mirror
from truenewton.modes import stiffness_modes
from truenewton.settings import filled, read_toml
from truenewton.shell.fourier import stiffness


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
        Largest force of an actuator that a shape may take, static forces aside [N].
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
    displacement
        Largest displacement of an actuator from rest [m].
    gap
        Smallest distance from the reference plate [m].
    temperature
        Lowest and highest [deg C].
    """

    force: float = 0.6
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
    seed, force_noise
        Of the simulated bench.
    user, password_file, certificate, private_key, server_certificate
        With which to log on to an OPC UA server.
    """

    kind: str = "simulated"
    address: str = ""
    seed: int = 1
    force_noise: float = 1e-4
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
    force_noise: float = 1e-4
    shapes: PlannedShapes = PlannedShapes()
    limits: Limits = Limits()
    bench: BenchChoice = BenchChoice()

    def __post_init__(self) -> None:
        for name, low, high in (("cycles", 1, 999), ("samples", 1, 10**9)):
            if not low <= getattr(self, name) <= high:
                raise _wrong(name, getattr(self, name), f"give {low} to {high}")
        for part, name in (
            (self, "settling"), (self, "force_noise"), (self.shapes, "stroke"),
            (self.shapes, "force"), (self.limits, "force"), (self.limits, "displacement"),
            (self.limits, "gap"),
        ):  # fmt: skip
            if not 0 <= getattr(part, name) < np.inf:
                raise _wrong(name, getattr(part, name), "give a positive number")
        if self.shapes.count < 0:
            raise _wrong("shapes.count", self.shapes.count, "give a number of shapes, 0 for all")
        if not self.limits.temperature[0] < self.limits.temperature[1]:
            raise _wrong("limits.temperature", list(self.limits.temperature), "lowest first")
        if self.bench.kind not in KINDS:
            raise _wrong("bench.kind", self.bench.kind, f"choose {', '.join(KINDS)}")
        names = [load.key for load in self.loads]
        if not names or len(set(names)) < len(names):
            raise _wrong("loads", names, "give every load once, with a name of its own")
        for what, limit, planned in (
            ("stroke", self.limits.displacement, self.shapes.stroke),
            ("force", self.limits.force, self.shapes.force),
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
    if plan.shapes.source == "modes":
        model = stiffness(mirror.shell, mirror.layout.x, mirror.layout.y)
        return scaled_shapes(stiffness_modes(model).modes.T, model, plan.shapes)
    path = Path(folder) / plan.shapes.source
    file = read_fits(path)
    if is_stiffness_file(file):
        matrix = stiffness_from(file)
        if not matrix.layout.same_as(mirror.layout):
            raise FormatError(
                f"is not of the actuators of {mirror.name}",
                remedy="plan with the measured matrix of the same mirror",
                path=path,
            )
        modes = np.linalg.svd(matrix.stiffness)[2][::-1]
        return scaled_shapes(modes, matrix.stiffness, plan.shapes)
    shapes = file.image("SHAPES").values("m")
    if shapes.ndim != 2 or shapes.shape[1] != mirror.layout.n:
        raise FormatError(
            f"SHAPES is {shapes.shape}",
            remedy=f"give shapes x {mirror.layout.n} actuators",
            path=path,
        )
    return shapes[: plan.shapes.count or None]
