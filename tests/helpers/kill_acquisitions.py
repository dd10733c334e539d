"""Kills acquisitions with SIGKILL, at random instants and at every step to the disk, and resumes.

    python tests/helpers/kill_acquisitions.py FOLDER random|steps [kills]

Prints one JSON line. Run by test_acquisition.py in a process of its own, since it forks.
"""

import json
import os
import random
import signal
import sys
import time
from functools import partial
from pathlib import Path

import truenewton as tn
from helpers.acquisition_plans import LOADS, contents, small_plan
from helpers.stub_bench import StubBench
from truenewton.acquisition.run_log import RunLog

STEPS = ("open", "write", "fsync", "ftruncate", "replace", "unlink")


def run_in_child(folder, plan, before):
    """Start an acquisition in a child, which writes to a pipe when it reads its first shape.

    The bench notes every reading in a file beside.
    """
    under_way, tell = os.pipe()
    child = os.fork()
    if child:
        os.close(tell)
        return child, under_way
    tally = os.open(f"{folder}.reads", os.O_WRONLY | os.O_CREAT | os.O_APPEND)
    write = os.write

    def note(shape, reading):
        write(tally if shape.number else tell, b".")
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


def ended(child, under_way):
    """Wait for a child: True where it was killed, False where it was done."""
    os.close(under_way)
    status = os.waitpid(child, 0)[1]
    if not os.WIFSIGNALED(status) and os.WEXITSTATUS(status):
        raise SystemExit("an acquisition failed")
    return os.WIFSIGNALED(status)


def check(folder, plan, want, kills):
    """Hold a finished campaign against the uninterrupted one, and count what was read twice."""
    assert contents(folder) == want, "the resumed campaign differs"
    left = [p.name for p in folder.iterdir() if p.name.startswith(".")]
    assert sorted(left) == [".lock", ".shapes.npy"], left
    rows = 2 * plan.shapes.count * plan.cycles * len(plan.loads)
    twice = Path(f"{folder}.reads").stat().st_size - rows
    assert 0 <= twice <= kills, (twice, kills)
    return twice


def at_random(root, plan, want, kills):
    chance, killed, twice, campaigns = random.Random(5), 0, 0, 0
    while killed < kills:
        campaigns, here, folder = campaigns + 1, 0, root / f"random-{campaigns}"
        while True:
            child, under_way = run_in_child(folder, plan, lambda: None)
            if killed < kills:
                if chance.random() < 0.8:  # else at the start, which reads what is there
                    os.read(under_way, 1)
                time.sleep(chance.uniform(0.0, 0.08))
                os.kill(child, signal.SIGKILL)
            if not ended(child, under_way):
                break
            killed, here = killed + 1, here + 1
        twice += check(folder, plan, want, here)
    return {"kills": killed, "campaigns": campaigns, "taken twice": twice}


def at_every_step(root, plan, want):
    step, twice = 0, 0
    while True:
        step, folder = step + 1, root / f"step-{step}"
        if not ended(*run_in_child(folder, plan, partial(kill_at_step, step))):
            return {"kills": step - 1, "taken twice": twice}
        ended(*run_in_child(folder, plan, lambda: None))
        twice += check(folder, plan, want, 1)


if __name__ == "__main__":
    root, way = Path(sys.argv[1]), sys.argv[2]
    plan = small_plan() if way == "random" else small_plan(cycles=1, count=1, loads=LOADS[:1])
    whole = root / f"whole-{way}"
    tn.acquire(StubBench(), plan, whole)
    want = contents(whole)
    if way == "random":
        print(json.dumps(at_random(root, plan, want, int(sys.argv[3]))))
    else:
        print(json.dumps(at_every_step(root, plan, want)))
