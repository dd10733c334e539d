"""A campaign's folder: for one run alone, one plan for good, and what is complete already."""

from __future__ import annotations

import contextlib
import difflib
import hashlib
import os
import shutil
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

import numpy as np
from filelock import FileLock, Timeout

from truenewton.acquisition.checks import mean_sum
from truenewton.acquisition.journal import instant_of, remove_journal
from truenewton.acquisition.load_order import with_turns
from truenewton.acquisition.plan import CampaignPlan, read_plan
from truenewton.acquisition.shapes import shapes_and_forces
from truenewton.arrays import Array
from truenewton.errors import CampaignMismatch, OutputExists, OutputFailed, UnreadableFile
from truenewton.files.fits import read_fits
from truenewton.files.opening import refuse_odd
from truenewton.files.outputs import file_beside, in_one_line, to_disk
from truenewton.files.toml import toml_text
from truenewton.mirrors.known import Mirror
from truenewton.records.file import SUFFIXES, cycle_from, cycle_name
from truenewton.rounding import counted
from truenewton.statics.layout import Layout

PLAN, SHAPES, LOCK = "plan.toml", ".shapes.npy", ".lock"
OF_SHAPES = f"# {SHAPES}: "  # before their SHA256 in the plan of a folder
SHOWN = 8  # lines of a difference


@dataclass(frozen=True)
class Finished:
    """What a run needs to know of a cycle that is complete."""

    end: int  # its last instant [us since 1970, UTC]
    total: float | None  # of the forces at rest [N], see `mean_sum`


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


def _plan_text(plan: CampaignPlan, beside: str | os.PathLike[str], shapes: str = "") -> str:
    """Return a plan as it is kept beside its data, with the digests of the files that it names.

    And of the shapes, where they are given; older folders have none.
    """
    named = [plan.mirror, plan.shapes.source]
    files = [path for name in named if (path := Path(beside) / name).is_file()]
    digests = [f"# {path.name}: {hashlib.sha256(path.read_bytes()).hexdigest()}" for path in files]
    digests += [f"{OF_SHAPES}{shapes}"] if shapes else []
    return "\n".join([*digests, toml_text(plan)])


def begin_or_resume(
    folder: Path, plan: CampaignPlan, mirror: Mirror, beside: str | os.PathLike[str]
) -> tuple[CampaignPlan, Array]:
    """Keep plan and shapes in a folder that has none; else return what it was begun with.

    Where the plan leaves its turns open, the first run chooses them for good. The shapes are
    (shapes, n) displacements [m], and never made twice: modes of one stiffness may come out turned
    on another machine. A folder that was begun with another plan is a `CampaignMismatch`.
    """
    half_written = tuple(f".{name}." for name in (PLAN, SHAPES, *cycle_names(plan)))
    with in_one_line(folder):  # by a run that was killed
        for path in [each for each in folder.iterdir() if each.name.startswith(half_written)]:
            shutil.rmtree(path)
    if (folder / PLAN).exists():
        refuse_other_plan(folder, plan, beside)
        shapes = _read_shapes(folder, mirror.layout.n)
        return _with_turns_begun(plan, read_plan(folder / PLAN)), shapes
    if any(path.name.endswith(SUFFIXES) for path in folder.iterdir()):
        raise OutputExists(
            f"holds FITS files but no {PLAN}", remedy="choose another name", path=folder
        )
    shapes = shapes_and_forces(plan, mirror, beside)[0]
    plan = with_turns(plan, mirror, len(shapes))
    with file_beside(folder / SHAPES, overwrite=True) as temporary:
        np.save(temporary, shapes)
        digest = hashlib.sha256(temporary.read_bytes()).hexdigest()
    with file_beside(folder / PLAN) as temporary:  # last: with it the campaign has begun
        temporary.write_text(_plan_text(plan, beside, digest), encoding="utf-8")
    with in_one_line(folder):
        to_disk(folder)
    return plan, shapes


def _with_turns_begun(plan: CampaignPlan, begun: CampaignPlan) -> CampaignPlan:
    """Return a plan that leaves its turns open with those of the plan of its folder."""
    return plan if plan.turns else replace(plan, turns=begun.turns)


def refuse_other_plan(
    folder: str | os.PathLike[str], plan: CampaignPlan, beside: str | os.PathLike[str]
) -> None:
    """Refuse a plan that is not the one a folder was begun with, and show the difference."""
    path = Path(folder) / PLAN
    begun_plan = read_plan(path)
    plan_begun = toml_text(begun_plan)  # as this version writes it, defaults included
    notes = [line for line in _notes(path) if not line.startswith(OF_SHAPES)]
    begun = [*notes, *plan_begun.splitlines()]
    wanted = _plan_text(_with_turns_begun(plan, begun_plan), beside).splitlines()
    if begun == wanted:
        return
    lines = list(difflib.unified_diff(begun, wanted, n=0, lineterm=""))
    changed = [line for line in lines[2:] if not line.startswith("@@") and line[1:].strip()]
    more = f" and {counted(len(changed) - SHOWN, 'line')} more" if len(changed) > SHOWN else ""
    raise CampaignMismatch(
        f"was begun with another plan: {', '.join(changed[:SHOWN])}{more}",
        remedy=f"take the plan back ({PLAN} in the folder has it), or give another folder",
        path=folder,
        got="\n".join(lines),
    )


def _notes(path: Path) -> list[str]:
    return [line for line in path.read_text(encoding="utf-8").splitlines() if line[:1] == "#"]


def _read_shapes(folder: Path, n: int) -> Array:
    """Return the (shapes, n) displacements with which a campaign was begun [m]."""
    path = folder / SHAPES
    try:
        refuse_odd(path)
        digest = hashlib.sha256(path.read_bytes()).hexdigest()
        begun = [line.removeprefix(OF_SHAPES) for line in _notes(folder / PLAN)
                 if line.startswith(OF_SHAPES)]  # fmt: skip
        if begun not in ([], [digest]):
            raise ValueError("changed")
        shapes = np.array(np.load(path, mmap_mode="r", allow_pickle=False), dtype=float)
        if shapes.shape != (len(shapes), n) or not shapes.size or not np.isfinite(shapes).all():
            raise ValueError("no shapes")
    except Exception as error:  # whatever numpy makes of bytes that are not its own
        raise UnreadableFile(
            "the shapes of the campaign cannot be read, or were changed",
            remedy="fetch the file again, or begin anew in another folder",
            path=path,
        ) from error
    return shapes


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
    """Return what is complete already, by load and cycle; every file is read and verified.

    A journal that stands beside its cycle's file is removed. A file of another campaign is a
    `CampaignMismatch`.
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
            raise CampaignMismatch(
                "is not of this plan", remedy="move it away", path=path, got=cycle
            )
        remove_journal(folder, load, number)  # of a run which was killed before it could do so
        complete[load.key, number] = Finished(
            end=instant_of(cycle.date) + round(float(cycle.time[-1]) * 1e6),
            total=mean_sum(
                cycle.layout, np.asarray(cycle.force), cycle.shape, cycle.sign, cycle.valid
            ),
        )
    return complete
