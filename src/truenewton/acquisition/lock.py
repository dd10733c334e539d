"""A campaign's folder for one run alone, by a lock of the system."""

from __future__ import annotations

import contextlib
import os
import socket
from collections.abc import Iterator
from pathlib import Path

from truenewton.errors import OutputFailed
from truenewton.files.outputs import in_one_line

LOCK = ".lock"
BEYOND = 1 << 20  # the byte that Windows locks: what it locks nobody else can read


@contextlib.contextmanager
def locked(folder: str | os.PathLike[str]) -> Iterator[Path]:
    """Make a campaign's folder where it is not there yet, and keep it for this run alone.

    The lock is the system's: it goes with the process that holds it, however that ends.

    Raises
    ------
    OutputFailed
        It cannot be written, or another run is at it.
    """
    folder = Path(folder)
    with in_one_line(folder):
        folder.mkdir(exist_ok=True)
        handle = os.open(folder / LOCK, os.O_RDWR | os.O_CREAT, 0o666)
    try:
        try:
            _lock(handle)
        except (BlockingIOError, PermissionError):
            os.lseek(handle, 0, os.SEEK_SET)
            holder = os.read(handle, 200).decode(errors="replace").strip() or "another process"
            raise OutputFailed(
                f"another run writes here ({holder})", remedy="let it end first", path=folder
            ) from None
        with in_one_line(folder):
            os.ftruncate(handle, 0)
            os.write(handle, f"process {os.getpid()} on {socket.gethostname()}\n".encode())
        yield folder
    finally:
        os.close(handle)


def _lock(handle: int) -> None:
    """Lock an open file for this process, or raise BlockingIOError or PermissionError."""
    try:
        import fcntl
    except ModuleNotFoundError:  # Windows
        import msvcrt

        os.lseek(handle, BEYOND, os.SEEK_SET)
        msvcrt.locking(handle, msvcrt.LK_NBLCK, 1)  # type: ignore[attr-defined,unused-ignore]
        os.lseek(handle, 0, os.SEEK_SET)
    else:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
