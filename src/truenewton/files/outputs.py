"""Outputs that are complete or not there: written beside their target, then renamed."""

from __future__ import annotations

import contextlib
import errno
import os
import shutil
import signal
import tempfile
import threading
from collections.abc import Iterator, Sequence
from contextvars import ContextVar
from dataclasses import dataclass
from pathlib import Path

from truenewton.errors import OutputExists, OutputFailed, TrueNewtonError


def refuse_existing(*targets: str | os.PathLike[str] | None, overwrite: bool = False) -> None:
    """Raise OutputExists where a target stands and may not be overwritten; None is no target."""
    for target in targets:
        if target is not None and not overwrite and os.path.lexists(target):
            raise OutputExists(
                "exists already",
                remedy="choose another name, or overwrite it (--overwrite, overwrite=True)",
                path=target,
            )


@dataclass(frozen=True)
class _Made:
    """Outputs that lie complete in a hidden folder beside their targets, under the same names."""

    work: Path
    targets: Sequence[Path]


# What `atomic_outputs` gathers; None where each output takes its name as soon as it is complete.
_GATHERED: ContextVar[list[_Made] | None] = ContextVar("outputs", default=None)


@contextlib.contextmanager
def atomic_outputs() -> Iterator[None]:
    """Let all outputs of a block take their names at its end: all appear, or none.

    Raises
    ------
    OutputFailed
    """
    made: list[_Made] = []
    before = _GATHERED.set(made)
    try:
        yield
        _take_names(made)
    finally:
        _GATHERED.reset(before)
        with undisturbed():
            for each in made:
                shutil.rmtree(each.work, ignore_errors=True)


@contextlib.contextmanager
def file_beside(path: str | os.PathLike[str], *, overwrite: bool = False) -> Iterator[Path]:
    """Give a hidden name beside the target for a file, which takes its own when the block ends.

    Raises
    ------
    OutputExists
        The target stands and ``overwrite`` is false, or is a folder.
    OutputFailed
        It cannot be written; nothing is left behind.
    """
    target = Path(path)
    with files_together([target], overwrite=overwrite) as work:
        yield work / target.name
        # Or a power cut after the renaming leaves a name without bytes.
        to_disk(work / target.name)


@contextlib.contextmanager
def files_together(targets: Sequence[Path], *, overwrite: bool = False) -> Iterator[Path]:
    """Give a hidden folder for files of the targets' names, which take them when the block ends.

    All targets lie in one folder. The first takes its name last: where it stands, all do.

    Raises
    ------
    OutputExists, OutputFailed
    """
    for target in targets:
        refuse_existing(target, overwrite=overwrite)
        if target.is_dir():
            raise OutputExists("is a folder", remedy="choose another name", path=target)
    with _beside(targets) as work:
        yield work


@contextlib.contextmanager
def folder_beside(
    path: str | os.PathLike[str], suffixes: tuple[str, ...], *, overwrite: bool = False
) -> Iterator[Path]:
    """Give a hidden folder beside the target, which takes its name when the block ends well.

    A folder that stands is replaced only if told to, and only if every file in it ends in one of
    ``suffixes``: nothing that we did not make is lost.

    Raises
    ------
    OutputExists, OutputFailed
    """
    target = Path(path)
    refuse_existing(target, overwrite=overwrite)
    with in_one_line(target):
        strange = [
            p
            for p in (target.iterdir() if target.is_dir() else ())
            if not p.name.endswith(suffixes)
        ]
        if strange or (target.exists() and not target.is_dir()):
            raise OutputExists(
                f"holds {strange[0].name}, which is not ours" if strange else "is not a folder",
                remedy="choose another name",
                path=target,
            )
    with _beside([target]) as work:
        (work / target.name).mkdir()
        yield work / target.name


@contextlib.contextmanager
def _beside(targets: Sequence[Path]) -> Iterator[Path]:
    """Give a hidden folder beside the targets; what it holds at the end takes their names."""
    first, gathered = targets[0], _GATHERED.get()
    work: Path | None = None
    before = _GATHERED.set(None)  # what is written inside it is no output yet
    with in_one_line(first):
        try:
            with undisturbed():
                work = Path(tempfile.mkdtemp(prefix=f".{first.name}.", dir=first.parent))
            try:
                yield work
            except OutputFailed as error:  # it names a file that nobody will find
                raise error.changed(path=first) from error
            if gathered is None:
                _take_names([_Made(work, targets)])
            else:
                gathered.append(_Made(work, targets))
                work = None
        finally:
            _GATHERED.reset(before)
            if work is not None:
                with undisturbed():
                    shutil.rmtree(work, ignore_errors=True)


def _take_names(made: Sequence[_Made]) -> None:
    """Give complete outputs their names; if one cannot have it, all stand as they stood before."""
    taken: list[tuple[Path, Path, Path]] = []
    with undisturbed():
        for each in made:
            for target in reversed(each.targets):
                new, old = each.work / target.name, each.work / f"{target.name}.old"
                taken.append((target, new, old))
                try:
                    _put_aside(target, old)
                    new.replace(target)
                except OSError:
                    for back in reversed(taken):
                        with contextlib.suppress(OSError):
                            _take_back(*back)
                    with in_one_line(target):
                        raise


def _put_aside(target: Path, old: Path) -> None:
    """Keep what stands at a target; a file goes on standing there until it is replaced."""
    if target.is_dir() and not target.is_symlink():
        target.rename(old)
    elif os.path.lexists(target):
        with contextlib.suppress(OSError):  # not every file system links
            os.link(target, old, follow_symlinks=False)


def _take_back(target: Path, new: Path, old: Path) -> None:
    """Undo what gave a target its name."""
    if not os.path.lexists(new):
        target.rename(new)
    if os.path.lexists(old):
        old.replace(target)


@contextlib.contextmanager
def undisturbed() -> Iterator[None]:
    """Let Ctrl-C and SIGTERM wait until the block has ended.

    Signals reach the main thread only; elsewhere nothing has to wait.
    """
    waiting: list[int] = []
    before = {}
    if threading.current_thread() is threading.main_thread():
        for each in (signal.SIGINT, signal.SIGTERM):
            if signal.getsignal(each) is not None:  # one that is not Python's cannot come back
                before[each] = signal.signal(each, lambda number, _: waiting.append(number))
    try:
        yield
    finally:
        for each, handler in before.items():
            signal.signal(each, handler)
        for number in waiting[:1]:
            signal.raise_signal(number)


def to_disk(path: str | os.PathLike[str]) -> None:
    """Return when the bytes of a file, or the names in a folder, are on the disk."""
    if os.name == "nt" and Path(path).is_dir():  # Windows opens no folder, and keeps its names
        return
    handle = os.open(path, os.O_RDWR if os.name == "nt" else os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


@contextlib.contextmanager
def in_one_line(target: str | os.PathLike[str]) -> Iterator[None]:
    """Turn what the system says of a failed output into one line.

    Raises
    ------
    OutputFailed
    """
    try:
        yield
    except TrueNewtonError:
        raise
    except OSError as error:
        full = error.errno in (errno.ENOSPC, errno.EDQUOT)
        raise OutputFailed(
            f"cannot be written ({error.strerror or error})",
            remedy="make room" if full else "choose a folder that exists and can be written",
            path=target,
        ) from error
