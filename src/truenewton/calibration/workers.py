"""Calls in processes of their own, side by side.

A process starts afresh, from no fork of this one and without its main module: a script needs no
guard, a notebook no file, and threads of ours no care. It reads a call from its standard input and
writes what that returned, or raised, to its standard output, both pickled.
"""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
import threading
import warnings
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

ONE_THREAD = dict.fromkeys(
    ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS"), "1"
)
Given = TypeVar("Given")
Answer = TypeVar("Answer")


def processors() -> int:
    """Return how many processors this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def side_by_side(
    calls: Sequence[Callable[[], tuple[Callable[..., Answer], Any]]], processes: int
) -> Iterator[Answer]:
    """Yield what calls return, in their order, so many at once.

    Parameters
    ----------
    calls
        Each gives a function of a module, or a partial of one, and its only argument, when its turn
        comes: what it needs lies in memory no earlier.
    processes
        How many at once.

    Raises
    ------
    ChildProcessError
        A process ended without an answer. What a call raises is raised here.
    """
    running: set[subprocess.Popen[bytes]] = set()
    guard, stopped = threading.Lock(), threading.Event()

    def run(call: Callable[[], tuple[Callable[..., Answer], Any]]) -> Answer:
        work = pickle.dumps(call(), protocol=pickle.HIGHEST_PROTOCOL)
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

    with ThreadPoolExecutor(processes) as threads:
        try:
            yield from threads.map(run, calls)
        except BaseException:
            with guard:
                stopped.set()
                for process in running:
                    process.kill()
            raise


def main() -> None:
    """Answer one call."""
    function, argument = pickle.load(sys.stdin.buffer)
    answers, sys.stdout = sys.stdout.buffer, sys.stderr  # nothing else may come between
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            answer = True, function(argument)
        except Exception as error:
            answer = False, error
    pickle.dump(answer, answers, protocol=pickle.HIGHEST_PROTOCOL)
    answers.flush()


if __name__ == "__main__":
    main()
