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
from pathlib import Path

from truenewton.errors import OutputExists, OutputFailed, TrueNewtonError


def refuse_existing(*targets: str | os.PathLike[str] | None, overwrite: bool = False) -> None:
    """Raise OutputExists if one of the targets exists and may not be overwritten."""
    for target in targets:
        if target is not None and not overwrite and os.path.lexists(target):
            raise OutputExists(
                "exists already",
                remedy="choose another name, or overwrite it (--overwrite, overwrite=True)",
                path=target,
            )


@contextlib.contextmanager
def file_beside(path: str | os.PathLike[str], *, overwrite: bool = False) -> Iterator[Path]:
    """Give a hidden path for a file, which takes its name when the block ends without error.

    If it cannot be written (OutputFailed) or exists already (OutputExists), nothing is left behind.
    """
    target = Path(path)
    with files_together([target], overwrite=overwrite) as work:
        yield work / target.name


@contextlib.contextmanager
def files_together(targets: Sequence[Path], *, overwrite: bool = False) -> Iterator[Path]:
    """Give a hidden folder for files of one folder, which take their names when the block ends.

    The first takes its name last: if it exists, all do.
    """
    for target in targets:
        refuse_existing(target, overwrite=overwrite)
        if target.is_dir():
            raise OutputExists("is a folder", remedy="choose another name", path=target)
    with _hidden(targets[0]) as work:
        yield work
        for target in targets:  # otherwise a power cut after the renaming leaves empty files
            to_disk(work / target.name)
        with undisturbed():
            for target in reversed(targets):
                (work / target.name).replace(target)


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
    with _hidden(target) as work:
        new, old = work / target.name, work / "old"
        new.mkdir()
        yield new
        with undisturbed():
            if target.is_dir():
                target.rename(old)
            try:
                new.rename(target)
            except OSError:
                if old.exists():
                    old.rename(target)
                raise


@contextlib.contextmanager
def _hidden(target: Path) -> Iterator[Path]:
    """Give a hidden folder beside a target, which is removed at the end."""
    with in_one_line(target):
        work = Path(tempfile.mkdtemp(prefix=f".{target.name}.", dir=target.parent))
        try:
            yield work
        except OutputFailed as error:  # it names a file that will not exist
            raise error.changed(path=target) from error
        finally:
            with undisturbed():
                shutil.rmtree(work, ignore_errors=True)


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
