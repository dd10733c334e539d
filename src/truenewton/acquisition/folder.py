"""A campaign's folder: lock, plan and complete cycles.

The file of a cycle is written in one step when the cycle is complete. A stop loses at most the
cycle under way.
"""

from __future__ import annotations

import contextlib
import datetime
import difflib
import hashlib
import os
import shutil
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import numpy as np
from filelock import FileLock, Timeout

from truenewton.acquisition.plan import CampaignPlan, read_plan, shapes_and_forces
from truenewton.acquisition.taker import Row, force_noise, mean_sum
from truenewton.arrays import Array, rms
from truenewton.bench.protocol import Bench, gradients_of
from truenewton.errors import BenchFault, CampaignMismatch, OutputExists, OutputFailed
from truenewton.files.fits import SUFFIXES, read_fits, write_fits
from truenewton.files.format import FileFormat, ImageFormat
from truenewton.files.opening import read_text
from truenewton.files.outputs import file_beside, in_one_line, to_disk
from truenewton.files.toml import toml_text
from truenewton.mirrors.known import Mirror
from truenewton.records.cycle import Cycle
from truenewton.records.file import cycle_from, cycle_name
from truenewton.rounding import counted
from truenewton.statics.layout import Layout
from truenewton.statics.load import LARGEST_FORCE, LEAST_NOISE

PLAN, SHAPES, LOCK = "plan.toml", ".shapes", ".lock"
SHAPES_FORMAT = FileFormat(extensions=(ImageFormat("SHAPES", "", "m"),))  # FITS, with checksums
MAX_LINES_SHOWN = 8  # of a difference between two plans


@dataclass(frozen=True)
class Finished:
    """What a run needs to know of a complete cycle."""

    start: datetime.datetime  # of its first row, UTC
    end: datetime.datetime  # of its last row, UTC
    total: float | None  # of the forces at rest [N], see `mean_sum`


def cycle_of(rows: Sequence[Row], mirror: Mirror, layout: Layout, bench: Bench) -> Cycle:
    """Return the cycle that its rows make, taken of a mirror on a bench.

    The layout is as files name and place the actuators. A row that is not valid has the time of the
    row before, and NaN if there is no reading. No valid row is a `BenchFault`.
    """
    first, n = rows[0].shape, bench.layout.n
    valid = np.array([row.valid for row in rows])
    if not valid.any():
        raise BenchFault(f"no shape of cycle {first.cycle} under '{first.load.name}' is valid")
    sound = [row.reading for row in rows if row.reading and row.valid]
    noise = rms(np.array([force_noise(bench.layout, reading) for reading in sound]))
    last, elapsed = sound[0].time, []
    for row in rows:
        last = row.reading.time if row.reading and row.valid else last
        elapsed.append((last - sound[0].time).total_seconds())

    def readings(name: str, missing: float | Array) -> Array:
        return np.array([getattr(row.reading, name, missing) for row in rows])

    temperature = readings("temperature", np.nan)
    coil_gradient, bias_gradient = gradients_of(bench)
    return Cycle(
        instrument=mirror.name,
        date=sound[0].time,
        number=first.cycle,
        load=first.load,
        weight=mirror.weight,
        weight_error=mirror.weight_error,
        layout=layout,  # the bench's is the same but for rounding
        time=np.array(elapsed),
        shape=np.array([row.shape.number for row in rows]),
        sign=np.array([row.shape.sign for row in rows]),
        force=readings("force", np.full(n, np.nan)),
        valid=valid,
        temperature=temperature if np.isfinite(temperature[valid]).all() else None,
        position=readings("position", np.full(n, np.nan)),
        gap=bench.gap,
        force_error=noise if LEAST_NOISE <= noise <= LARGEST_FORCE else None,
        coil_gradient=coil_gradient,
        bias_gradient=bias_gradient,
    )


@contextlib.contextmanager
def locked(folder: str | os.PathLike[str]) -> Iterator[Path]:
    """Make a campaign's folder if it does not exist, and keep it for this run alone.

    The lock is the system's: it goes with the process that holds it, however that ends.
    """
    folder = Path(folder)
    lock = FileLock(folder / LOCK)
    with in_one_line(folder):
        folder.mkdir(exist_ok=True)
        try:
            lock.acquire(timeout=0)
        except Timeout:
            raise OutputFailed(
                "another run writes here",
                remedy="let it end first; the newest run-*.jsonl names its host and process",
                path=folder,
            ) from None
    try:
        yield folder
    finally:
        lock.release()


def _plan_text(plan: CampaignPlan, beside: str | os.PathLike[str]) -> str:
    """Return a plan as it is kept beside its data, with the digests of the files that it names."""
    named = [plan.mirror, plan.shapes.source]
    files = [path for name in named if (path := Path(beside) / name).is_file()]
    digests = [f"# {path.name}: {hashlib.sha256(path.read_bytes()).hexdigest()}" for path in files]
    return "\n".join([*digests, toml_text(plan)])


def begin_or_resume(
    folder: Path, plan: CampaignPlan, mirror: Mirror, beside: str | os.PathLike[str]
) -> Array:
    """Return (shapes, n) displacements [m], as kept in the folder by the first run.

    Shapes are not computed again, because modes of one stiffness may differ on another machine.
    Another plan is a `CampaignMismatch`.
    """
    half_written = tuple(f".{name}." for name in (PLAN, SHAPES, *cycle_names(plan)))
    with in_one_line(folder):  # by a run that was killed: this one has the lock of the folder
        for path in [each for each in folder.iterdir() if each.name.startswith(half_written)]:
            shutil.rmtree(path)
    if (folder / PLAN).exists():
        refuse_other_plan(folder, plan, beside)
        return read_fits(folder / SHAPES).pixels("SHAPES", "m")
    if any(path.name.endswith(SUFFIXES) for path in folder.iterdir()):
        raise OutputExists(
            f"contains FITS files but no {PLAN}", remedy="choose another name", path=folder
        )
    shapes = shapes_and_forces(plan, mirror, beside)[0]
    write_fits(folder / SHAPES, SHAPES_FORMAT, shapes, overwrite=True)
    with file_beside(folder / PLAN) as temporary:  # last: with it the campaign has begun
        temporary.write_text(_plan_text(plan, beside), encoding="utf-8")
    with in_one_line(folder):
        to_disk(folder)
    return shapes


def refuse_other_plan(
    folder: str | os.PathLike[str], plan: CampaignPlan, beside: str | os.PathLike[str]
) -> None:
    """Refuse a plan that is not the one a folder was begun with, and show the difference."""
    path = Path(folder) / PLAN
    digests = [line for line in read_text(path).splitlines()
               if line.startswith("#") and not line.startswith(f"# {SHAPES}")]  # fmt: skip
    # As this version writes it, defaults included.
    begun = [*digests, *toml_text(read_plan(path)).splitlines()]
    wanted = _plan_text(plan, beside).splitlines()
    if begun == wanted:
        return
    lines = list(difflib.unified_diff(begun, wanted, n=0, lineterm=""))
    changed = [line for line in lines[2:] if not line.startswith("@@") and line[1:].strip()]
    more = (
        f" and {counted(len(changed) - MAX_LINES_SHOWN, 'line')} more"
        if len(changed) > MAX_LINES_SHOWN
        else ""
    )
    raise CampaignMismatch(
        f"was begun with another plan: {', '.join(changed[:MAX_LINES_SHOWN])}{more}",
        remedy=f"take the plan back ({PLAN} in the folder has it), or give another folder",
        path=folder,
    )


def is_complete(folder: str | os.PathLike[str], plan: CampaignPlan) -> bool:
    """Return whether a folder that was begun with a plan holds all its cycles."""
    return all((Path(folder) / name).exists() for name in (PLAN, *cycle_names(plan)))


def invalid_rows(folder: str | os.PathLike[str], plan: CampaignPlan) -> dict[str, tuple[int, int]]:
    """Return how many rows of each complete cycle file are not valid, and how many it has."""
    valid = {name: cycle_from(read_fits(Path(folder) / name)).valid for name in cycle_names(plan)}
    return {name: (int((~each).sum()), each.size) for name, each in valid.items()}


def cycle_names(plan: CampaignPlan) -> list[str]:
    """Return the names of the cycle files of a plan, in its order."""
    return [cycle_name(load, k + 1) for load in plan.loads for k in range(plan.cycles)]


def finished_cycles(
    folder: Path, plan: CampaignPlan, mirror: Mirror, layout: Layout, rows: int
) -> dict[tuple[str, int], Finished]:
    """Return the complete cycles, by load and number; every file is read and verified.

    A file of another campaign is a `CampaignMismatch`.
    """
    complete = {}
    for load, number in product(plan.loads, range(1, plan.cycles + 1)):
        path = folder / cycle_name(load, number)
        if not path.exists():
            continue
        cycle = cycle_from(read_fits(path))
        if not (
            cycle.instrument == mirror.name
            and (cycle.weight, cycle.weight_error) == (mirror.weight, mirror.weight_error)
            and cycle.layout.same_as(layout)
            and (cycle.load, cycle.number) == (load, number)
            and len(cycle.time) == rows
        ):
            raise CampaignMismatch("is not of this plan", remedy="move it away", path=path)
        complete[load.key, number] = Finished(
            start=cycle.date,
            end=cycle.date + datetime.timedelta(seconds=float(cycle.time[-1])),
            total=mean_sum(cycle.layout, cycle.force, cycle.shape, cycle.sign, cycle.valid),
        )
    return complete
