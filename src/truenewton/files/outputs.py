"""Outputs that are complete or not there: written beside their target, then renamed."""

from __future__ import annotations

import contextlib
import errno
import glob
import os
import shutil
import signal
import tempfile
import threading
from collections.abc import Iterator, Sequence
from contextvars import ContextVar
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from truenewton.errors import OutputExists, OutputFailed, TrueNewtonError

if TYPE_CHECKING:
    from filelock import FileLock

LOCK = ".lock"  # in a hidden folder
NOT_LOCKED = OSError, RuntimeError  # another process has the lock, or the file system has none


def refuse_existing(*targets: str | os.PathLike[str] | None, overwrite: bool = False) -> None:
    """Raise OutputExists if one of the targets exists and may not be overwritten."""
    for target in targets:
        if target is not None and not overwrite and os.path.lexists(target):
            raise OutputExists(
                "exists already",
                remedy="choose another name, or overwrite it (--overwrite, overwrite=True)",
                path=target,
            )


@dataclass(frozen=True)
class _Made:
    """Complete outputs in a hidden folder beside their targets, under the same names.

    The lock shows others that the process of the folder runs; it ends with the process.
    """

    work: Path
    targets: Sequence[Path]
    lock: FileLock

    def discard(self) -> None:
        """Remove the hidden folder, its lock last: until then it can be seen to be abandoned."""
        with undisturbed(), contextlib.suppress(OSError):
            for each in [path for path in self.work.iterdir() if path.name != LOCK]:
                if each.is_dir():
                    shutil.rmtree(each, ignore_errors=True)
                else:
                    each.unlink(missing_ok=True)
            self.lock.release()
            shutil.rmtree(self.work, ignore_errors=True)


def _lock_of(work: Path) -> FileLock:
    from filelock import FileLock  # which takes longer to import than all else that --help needs

    return FileLock(work / LOCK)


def _remove_abandoned(target: Path) -> None:
    """Remove the hidden folders of earlier outputs of this name whose process was killed."""
    for work in list(target.parent.glob(f".{glob.escape(target.name)}.*")):
        lock = _lock_of(work)
        if (work / LOCK).exists():
            with contextlib.suppress(*NOT_LOCKED):  # its process runs
                lock.acquire(timeout=0)
                _Made(work, (), lock).discard()


# What `atomic_outputs` collects; None if each output takes its name as soon as it is complete.
_COLLECTED: ContextVar[list[_Made] | None] = ContextVar("outputs", default=None)


@contextlib.contextmanager
def atomic_outputs() -> Iterator[None]:
    """Let all outputs of a block take their names at its end: all appear, or none."""
    made: list[_Made] = []
    before = _COLLECTED.set(made)
    try:
        yield
        _take_names(made)
    finally:
        _COLLECTED.reset(before)
        for each in made:
            each.discard()


@contextlib.contextmanager
def file_beside(path: str | os.PathLike[str], *, overwrite: bool = False) -> Iterator[Path]:
    """Give a hidden path for a file, which takes its name when the block ends.

    If it cannot be written (OutputFailed) or exists already (OutputExists), nothing is left behind.
    """
    target = Path(path)
    with files_together([target], overwrite=overwrite) as work:
        yield work / target.name
        # Otherwise a power cut after the renaming leaves a name without bytes.
        to_disk(work / target.name)


@contextlib.contextmanager
def files_together(targets: Sequence[Path], *, overwrite: bool = False) -> Iterator[Path]:
    """Give a hidden folder for files of one folder, which take their names when the block ends.

    The first takes its name last: if it exists, all do.
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
    """Give a hidden folder, which takes its name when the block ends without error.

    An existing folder is replaced only with ``overwrite``, and only if every file in it ends in one
    of ``suffixes``: files of others are never removed.
    """
    target = Path(path)
    refuse_existing(target, overwrite=overwrite)
    with in_one_line(target):
        inside = target.iterdir() if target.is_dir() else ()
        strange = [each for each in inside if not each.name.endswith(suffixes)]
        if strange or (target.exists() and not target.is_dir()):
            raise OutputExists(
                f"contains {strange[0].name}, which this program did not write"
                if strange
                else "is not a folder",
                remedy="choose another name",
                path=target,
            )
    with _beside([target]) as work:
        (work / target.name).mkdir()
        yield work / target.name


@contextlib.contextmanager
def _beside(targets: Sequence[Path]) -> Iterator[Path]:
    """Give a hidden folder beside the targets; what it contains at the end takes their names."""
    first, collected = targets[0], _COLLECTED.get()
    made: _Made | None = None
    before = _COLLECTED.set(None)  # what is written inside it is no output yet
    with in_one_line(first):
        try:
            _remove_abandoned(first)
            with undisturbed():
                work = Path(tempfile.mkdtemp(prefix=f".{first.name}.", dir=first.parent))
                made = _Made(work, targets, _lock_of(work))
                with contextlib.suppress(*NOT_LOCKED):
                    made.lock.acquire(timeout=0)
            try:
                yield work
            except OutputFailed as error:  # it names a file that will not exist
                raise error.changed(path=first) from error
            if collected is None:
                _take_names([made])
            else:
                collected.append(made)
                made = None
        finally:
            _COLLECTED.reset(before)
            if made is not None:
                made.discard()


def _take_names(made: Sequence[_Made]) -> None:
    """Give complete outputs their names; if one cannot have it, restore all targets."""
    with undisturbed(), contextlib.ExitStack() as undo:
        for each in made:
            for target in reversed(each.targets):
                new, old = each.work / target.name, each.work / f"{target.name}.old"
                with in_one_line(target):
                    if target.is_dir() and not target.is_symlink():
                        target.rename(old)
                    elif os.path.lexists(target):  # a file stays until it is replaced
                        with contextlib.suppress(OSError):  # not every file system links
                            os.link(target, old, follow_symlinks=False)
                    undo.callback(_restore, target, new, old)
                    new.replace(target)
        undo.pop_all()


def _restore(target: Path, new: Path, old: Path) -> None:
    """Undo what gave a target its name."""
    with contextlib.suppress(OSError):
        if not os.path.lexists(new):
            target.rename(new)
        if os.path.lexists(old):
            old.replace(target)


@contextlib.contextmanager
def undisturbed() -> Iterator[None]:
    """Delay Ctrl-C and SIGTERM to the end of the block; they reach the main thread only."""
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
    """Write the bytes of a file, or the names in a folder, to the disk."""
    if os.name == "nt" and Path(path).is_dir():  # Windows opens no folder, and keeps its names
        return
    handle = os.open(path, os.O_RDWR if os.name == "nt" else os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


@contextlib.contextmanager
def in_one_line(target: str | os.PathLike[str]) -> Iterator[None]:
    """Turn an error of the system about an output into an OutputFailed of one line."""
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
