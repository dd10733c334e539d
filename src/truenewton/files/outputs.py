"""Outputs that are complete or not there: written beside their target, then renamed."""

from __future__ import annotations

import contextlib
import errno
import os
import shutil
import tempfile
from collections.abc import Iterator, Sequence
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


@contextlib.contextmanager
def file_beside(path: str | os.PathLike[str], *, overwrite: bool = False) -> Iterator[Path]:
    """Give a temporary file beside the target, renamed to it when the block ends well.

    Raises
    ------
    OutputExists
        The target stands and ``overwrite`` is false.
    OutputFailed
        It cannot be written; nothing is left behind.
    """
    target = Path(path)
    refuse_existing(target, overwrite=overwrite)
    with in_one_line(target):
        handle, name = tempfile.mkstemp(
            prefix=f".{target.name}.", suffix=target.suffix, dir=target.parent
        )
        os.close(handle)
        temporary = Path(name)
        try:
            yield temporary
            temporary.chmod(0o666 & ~_umask())
            to_disk(temporary)  # or a power cut after the renaming leaves a name without bytes
            temporary.replace(target)
        finally:
            temporary.unlink(missing_ok=True)


@contextlib.contextmanager
def files_together(targets: Sequence[Path], *, overwrite: bool = False) -> Iterator[Path]:
    """Give a temporary folder for files of the targets' names, renamed to them at the end.

    All targets lie in one folder. The first takes its name last: where it stands, all do.

    Raises
    ------
    OutputExists, OutputFailed
    """
    for target in targets:
        refuse_existing(target, overwrite=overwrite)
        if target.is_dir():
            raise OutputExists("is a folder", remedy="choose another name", path=target)
    first = targets[0]
    with in_one_line(first):
        work = Path(tempfile.mkdtemp(prefix=f".{first.name}.", dir=first.parent))
        try:
            try:
                yield work
            except OutputFailed as error:  # it names a file that nobody will find
                raise error.changed(path=first) from error
            for target in reversed(targets):
                (work / target.name).replace(target)
        finally:
            shutil.rmtree(work, ignore_errors=True)


@contextlib.contextmanager
def folder_beside(
    path: str | os.PathLike[str], suffixes: tuple[str, ...], *, overwrite: bool = False
) -> Iterator[Path]:
    """Give a temporary folder beside the target, renamed to it when the block ends well.

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
        work = Path(tempfile.mkdtemp(prefix=f".{target.name}.", dir=target.parent))
        try:
            new = work / "new"
            new.mkdir()
            try:
                yield new
            except OutputFailed as error:  # it names a file that nobody will find
                raise error.changed(path=target) from error
            if target.exists():
                target.rename(work / "old")
            new.rename(target)
        finally:
            if not target.exists() and (work / "old").exists():
                (work / "old").rename(target)
            shutil.rmtree(work, ignore_errors=True)


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


def _umask() -> int:
    """Return the user's umask: temporary files are private, an output is like any other."""
    mask = os.umask(0)
    os.umask(mask)
    return mask
