"""A command in a process of its own, forked from one that has all imported."""

from __future__ import annotations

import importlib
import os
import pkgutil
import resource
import select
import signal
import sys
import time
import traceback
from pathlib import Path

import truenewton
from truenewton.cli.main import main

SECONDS, WALL, MEMORY = 25, 75, 4 * 2**30
LATE = (
    "bokeh.embed", "bokeh.resources", "h5py", "matplotlib.backends.backend_agg",
    "matplotlib.backends.backend_pdf", "matplotlib.backends.backend_svg", "scipy.io",
)  # fmt: skip


def inside(words: list[str], folder: Path, out: Path, error: Path) -> int:
    """Be the command; return its exit code, 98 of one that is no number, 99 of a traceback."""
    os.chdir(folder)
    for number, path in ((0, Path(os.devnull)), (1, out), (2, error)):
        flags = os.O_WRONLY | os.O_CREAT | os.O_TRUNC if number else os.O_RDONLY
        os.dup2(os.open(path, flags), number)
    sys.stdin = os.fdopen(0, closefd=False)
    sys.stdout, sys.stderr = (os.fdopen(k, "w", closefd=False) for k in (1, 2))
    sys.argv = ["truenewton", *words]
    code = 99
    try:
        main()
    except SystemExit as left:
        code = left.code if isinstance(left.code, int) else 98
    except BaseException:
        traceback.print_exc()
    for stream in (sys.stdout, sys.stderr):
        stream.flush()
    return code


def must(line: str, folder: Path) -> None:
    """Run a command line in a folder, where it has to succeed."""
    child = os.fork()
    if not child:
        os._exit(inside(line.split(), folder, folder / ".out", folder / ".err"))
    if code := os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]):
        sys.exit(f"{line}: exit code {code}: {(folder / '.err').read_text()}")


def execute(command: str, words: list[str], folder: Path, beside: Path) -> tuple[int, float]:
    """Run a case; return its exit code, -1 of one that hangs, and its time [s]."""
    begun = time.monotonic()
    done, held = os.pipe()
    child = os.fork()
    if not child:
        os.close(done)
        os.setsid()
        resource.setrlimit(resource.RLIMIT_CPU, (SECONDS, SECONDS + 2))
        resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
        os._exit(inside([command, *words], folder, beside / "out", beside / "err"))
    os.close(held)
    if not select.select([done], [], [], WALL)[0]:
        os.kill(child, signal.SIGKILL)
    os.close(done)
    code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    return (-1 if code in (-signal.SIGKILL, -signal.SIGXCPU) else code), time.monotonic() - begun


def import_rooms() -> None:
    """Import the project and what it imports late, so that each process begins with them."""
    for module in pkgutil.walk_packages(truenewton.__path__, "truenewton."):
        if not module.name.endswith("__main__"):
            importlib.import_module(module.name)
    for name in LATE:
        importlib.import_module(name)
