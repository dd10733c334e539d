"""Kills an acquisition with SIGKILL before and after every step to the disk, and resumes it.

    python tests/helpers/kill_acquisitions.py FOLDER

Prints one JSON line. Run by test_interruption.py in a process of its own, since it forks.
"""

import json
import os
import signal
import sys
from functools import partial
from pathlib import Path

import truenewton as tn
from helpers.acquisition_plans import LOADS, contents, small_plan
from helpers.stub_bench import StubBench
from truenewton.acquisition.taker import RunLog

STEPS = ("open", "write", "fsync", "ftruncate", "replace", "unlink")


def run_in_child(folder, plan, before):
    """Start an acquisition in a child, whose bench notes every reading in a file beside."""
    child = os.fork()
    if child:
        return child
    tally = os.open(f"{folder}.reads", os.O_WRONLY | os.O_CREAT | os.O_APPEND)
    write = os.write

    def note(shape, reading):
        if shape.number:
            write(tally, b".")
        return reading

    try:
        before()
        tn.acquire(StubBench(spoil=note), plan, folder)
        os._exit(0)
    finally:
        os._exit(1)


def kill_at_step(wanted):
    """Have this process kill itself at a step to the disk: odd before it is made, even after."""
    passed = 0

    def counted(call):
        def step(*arguments, **keywords):
            nonlocal passed
            for _ in range(2):
                passed += 1
                if passed == wanted:
                    os.kill(os.getpid(), signal.SIGKILL)
                if passed % 2:
                    result = call(*arguments, **keywords)
            return result

        return step

    RunLog.note = lambda *words, **values: None  # its lines are no steps of their own
    for name in STEPS:
        setattr(os, name, counted(getattr(os, name)))


def killed(child):
    """Wait for a child: True where it was killed, False where it was done."""
    status = os.waitpid(child, 0)[1]
    if not os.WIFSIGNALED(status) and os.WEXITSTATUS(status):
        raise SystemExit("an acquisition failed")
    return os.WIFSIGNALED(status)


def read_twice(folder, plan, want):
    """Hold a finished campaign against the uninterrupted one, and count what was read twice."""
    assert contents(folder) == want, "the resumed campaign differs"
    left = [p.name for p in folder.iterdir() if p.name.startswith(".")]
    assert sorted(left) == [".lock", ".shapes"], left
    rows = 2 * plan.shapes.count * plan.cycles * len(plan.loads)
    twice = Path(f"{folder}.reads").stat().st_size - rows
    assert 0 <= twice <= 2 * plan.shapes.count, twice  # the rows of a cycle
    return twice


def at_every_step(root, plan, want):
    step, twice = 0, 0
    while True:
        step, folder = step + 1, root / f"step-{step}"
        if not killed(run_in_child(folder, plan, partial(kill_at_step, step))):
            rows = 2 * plan.shapes.count
            return {"kills": step - 1, "taken twice": twice, "rows": rows}
        killed(run_in_child(folder, plan, lambda: None))
        twice += read_twice(folder, plan, want)


if __name__ == "__main__":
    root = Path(sys.argv[1])
    plan = small_plan(cycles=2, count=1, loads=LOADS[:1])
    tn.acquire(StubBench(), plan, root / "whole")
    print(json.dumps(at_every_step(root, plan, contents(root / "whole"))))
