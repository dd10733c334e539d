"""Calls in separate processes, several at once.

A process is started, not forked, and does not import the main module: scripts need no guard,
notebooks no file, and threads do not matter. It reads a pickled call from standard input and writes
the pickled result, or exception, to standard output.
"""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
import threading
import warnings
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np

from truenewton.statics.layout import Layout

LARGE = 200  # actuators of a segment: below, it is solved before a process has started
ONE_THREAD = dict.fromkeys(
    ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS"), "1"
)
Answer = TypeVar("Answer")


def processors() -> int:
    """Return the number of processors that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


@dataclass(frozen=True)
class Processes:
    """An executor with several processes, each for one call.

    It maps functions of a module, or partials of them.
    """

    number: int

    def map(self, fn: Callable[..., Answer], *iterables: Iterable[Any]) -> Iterator[Answer]:
        """Yield the results of a function in the order of the items; raise its exceptions.

        Raises `ChildProcessError` if a process ended without a result.
        """
        running: set[subprocess.Popen[bytes]] = set()
        guard, stopped = threading.Lock(), threading.Event()

        def run(*items: Any) -> Answer:
            work = pickle.dumps((fn, items), protocol=pickle.HIGHEST_PROTOCOL)
            with guard:
                if stopped.is_set():
                    raise ChildProcessError("stopped")
                process = subprocess.Popen(
                    [sys.executable, "-m", __name__],
                    stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
                    env={**os.environ, **ONE_THREAD, "PYTHONPATH": os.pathsep.join(sys.path)},
                )  # fmt: skip
                running.add(process)
            out, said = process.communicate(work)
            running.discard(process)
            if process.returncode:
                last = "".join(said.decode(errors="replace").strip().splitlines()[-1:])
                raise ChildProcessError(
                    f"a process ended with {process.returncode}: {last or 'memory may be short'}"
                )
            good, answer = pickle.loads(out)
            if not good:
                raise answer
            return answer  # type: ignore[no-any-return]

        with ThreadPoolExecutor(self.number) as threads:
            try:
                yield from threads.map(run, *iterables)
            except BaseException:
                with guard:
                    stopped.set()
                    for process in running:
                        process.kill()
                raise


def executor_for(layout: Layout, processes: int | None) -> Processes | None:
    """Return an executor for the segments of a mirror; None to work on one after the other.

    By default with one process for each processor if segments are large.
    """
    if processes is None:
        largest = int(np.unique(np.asarray(layout.segment), return_counts=True)[1].max())
        processes = processors() if largest >= LARGE and sys.executable else 1
    return Processes(min(processes, len(layout.segments))) if processes > 1 else None


def main() -> None:
    """Run one call."""
    function, items = pickle.load(sys.stdin.buffer)
    answers, sys.stdout = sys.stdout.buffer, sys.stderr  # nothing else may come between
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            answer = True, function(*items)
        except Exception as error:
            answer = False, error
    pickle.dump(answer, answers, protocol=pickle.HIGHEST_PROTOCOL)
    answers.flush()


if __name__ == "__main__":
    main()
