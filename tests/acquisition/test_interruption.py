"""Whatever stops an acquisition, nothing is lost but the cycle under way, and it goes on."""

import contextlib
import dataclasses
import datetime
import errno
import io
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import pytest

import truenewton as tn
from helpers.acquisition_plans import LOADS, contents, small_plan, write_shapes
from helpers.stub_bench import MODEL, SMALL, START, Hands, StubBench, at
from truenewton.acquisition.plan import PlannedShapes
from truenewton.acquisition.taker import Interruption
from truenewton.errors import (
    BenchFault,
    CampaignMismatch,
    Interrupted,
    OutputExists,
    OutputFailed,
    UnreadableFile,
)
from truenewton.files.toml import toml_text

PLACE = ("bare", 2, 2, -1)  # where things happen, unless told


def interrupt(reading):
    """Send Ctrl-C to this process, as a spoiler of readings."""
    os.kill(os.getpid(), signal.SIGINT)
    return reading


def stopping():
    return StubBench(spoil=at(PLACE, interrupt))


def taken_again(one, other):
    """Return the loads and cycles of the shapes that both benches were read of."""
    return {place[:2] for place in other.read_of if place in one.read_of and place[2]}


# Killed


@pytest.mark.study
def test_kill_9_at_every_step_to_the_disk_costs_at_most_the_cycle_under_way(tmp_path):
    here, source = Path(__file__).parents[1], Path(tn.__file__).parents[1]
    done = subprocess.run(
        [sys.executable, here / "helpers" / "kill_acquisitions.py", tmp_path],
        capture_output=True, text=True, timeout=300, check=False,
        env={**os.environ, "OPENBLAS_NUM_THREADS": "1", "PYTHONPATH": f"{here}:{source}"},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    assert told["kills"] >= 20
    assert 0 < told["taken twice"] < told["rows"] * told["kills"]


# Interrupted


def test_ctrl_c_finishes_the_shape_under_way(tmp_path, whole):
    before = [signal.getsignal(each) for each in (signal.SIGINT, signal.SIGTERM)]
    bench = stopping()
    with pytest.raises(Interrupted) as raised:
        tn.acquire(bench, small_plan(), tmp_path / "c")
    assert str(raised.value) == (
        f"{tmp_path / 'c'}: stopped as asked, before shape 3 + of cycle 2 under 'bare'; the mirror"
        " is at rest, complete cycles are kept; the same command takes the others"
    )
    assert bench.shape is None
    assert bench.read_of[-1] == PLACE
    again = StubBench()
    tn.acquire(again, small_plan(), tmp_path / "c")  # the clock of this bench starts anew
    assert taken_again(bench, again) == {PLACE[:2]}
    assert contents(tmp_path / "c") == whole
    assert all((np.diff(cycle.time) > 0).all() for cycle in tn.read(tmp_path / "c").cycles)
    assert [signal.getsignal(each) for each in (signal.SIGINT, signal.SIGTERM)] == before


def test_ctrl_c_twice_stops_at_once(tmp_path, whole):
    bench = StubBench(spoil=at(PLACE, lambda reading: interrupt(interrupt(reading))))
    with pytest.raises(KeyboardInterrupt):
        tn.acquire(bench, small_plan(), tmp_path / "c")
    assert bench.shape is None  # at rest all the same
    again = StubBench()
    tn.acquire(again, small_plan(), tmp_path / "c")
    assert taken_again(bench, again) == {PLACE[:2]}
    assert contents(tmp_path / "c") == whole


def test_one_ctrl_c_will_do_while_somebody_is_waited_for(tmp_path):
    def ask(load):
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(1)
        return load

    with pytest.raises(Interrupted, match="stopped as asked; the mirror is at rest"):
        tn.acquire(StubBench(put=ask), small_plan(), tmp_path / "c")


def test_a_sleep_ends_when_someone_asks():
    start = time.monotonic()
    with Interruption() as interruption:
        interruption.asked = True
        with pytest.raises(Interrupted):
            interruption.sleep(60.0)
    assert time.monotonic() - start < 5.0


# The disk


@pytest.mark.parametrize(
    ("call", "after"),
    [*(("write", k) for k in (0, 1, 7, 23, 50)), *(("fsync", k) for k in (0, 1, 3, 9))],
)
def test_a_full_disk_ends_the_run_which_goes_on_when_there_is_room(
    tmp_path, whole, monkeypatch, call, after
):
    real, calls, full = getattr(os, call), 0, True

    def fails(handle, *rest):
        nonlocal calls
        calls += 1
        if full and calls > after:
            if rest:  # some of it still fits
                real(handle, rest[0][: len(rest[0]) // 2])
            raise OSError(errno.ENOSPC, "No space left on device")
        return real(handle, *rest)

    monkeypatch.setattr(os, call, fails)
    bench = StubBench()
    with pytest.raises(OutputFailed, match=r"\(No space left on device\)"):
        tn.acquire(bench, small_plan(), tmp_path / "c")
    assert bench.shape is None
    full = False
    again = StubBench()
    tn.acquire(again, small_plan(), tmp_path / "c")
    assert len(taken_again(bench, again)) <= 1  # cycle
    assert contents(tmp_path / "c") == whole


@contextlib.contextmanager
def nobody():
    """Be a user without rights, where the tests run as the superuser, who may do anything."""
    superuser = os.geteuid() == 0
    if superuser:
        os.seteuid(65534)
    try:
        yield
    finally:
        if superuser:
            os.seteuid(0)


@pytest.mark.parametrize("stage", ["parent", "new", "begun"])
def test_a_folder_that_cannot_be_written_is_refused_before_a_command(stage):
    with tempfile.TemporaryDirectory() as base:  # pytest's own is closed to other users
        folder, bench = Path(base) / "campaign", StubBench()
        Path(base).chmod(0o755)
        if stage != "parent":
            folder.mkdir()
        if stage == "begun":
            with pytest.raises(Interrupted):
                tn.acquire(stopping(), small_plan(), folder)
        closed = Path(base) if stage == "parent" else folder
        for path in (*folder.glob("*"), closed):
            path.chmod(0o555)
        with nobody(), pytest.raises(OutputFailed, match=r"Permission denied"):
            tn.acquire(bench, small_plan(), folder)
        assert not bench.commanded
        closed.chmod(0o755)


# Two runs, and what a folder holds


def test_two_runs_do_not_share_a_folder(tmp_path, whole):
    def second(reading):
        with pytest.raises(OutputFailed, match="another run writes here; let it end first"):
            tn.acquire(StubBench(), small_plan(), tmp_path / "c")
        return reading

    tn.acquire(StubBench(spoil=at(PLACE, second)), small_plan(), tmp_path / "c")
    assert contents(tmp_path / "c") == whole


def test_a_cycle_that_is_damaged_stops_the_run_before_a_command(complete):
    path = complete / "bare-002.fits"
    path.write_bytes(path.read_bytes()[:-2880])
    (complete / "ring-002.fits").unlink()
    bench = StubBench()
    with pytest.raises(UnreadableFile, match=r"bare-002\.fits: is"):
        tn.acquire(bench, small_plan(), complete)
    assert not bench.commanded


def test_a_folder_of_another_campaign_is_not_touched(complete):
    (complete / "plan.toml").unlink()
    with pytest.raises(OutputExists, match=r"contains FITS files but no plan\.toml"):
        tn.acquire(StubBench(), small_plan(), complete)


def test_a_cycle_of_another_plan_is_refused(complete, tmp_path):
    tn.acquire(StubBench(), small_plan(count=4, cycles=1), tmp_path / "b")
    (tmp_path / "b" / "bare-001.fits").replace(complete / "bare-001.fits")
    (complete / "ring-002.fits").unlink()
    with pytest.raises(CampaignMismatch, match=r"bare-001\.fits: is not of this plan"):
        tn.acquire(StubBench(), small_plan(), complete)


# The plan


def test_an_edited_plan_is_refused_with_the_difference(complete):
    heavier = (LOADS[0], dataclasses.replace(LOADS[1], added=-0.06))
    bench = StubBench()
    with pytest.raises(CampaignMismatch) as raised:
        tn.acquire(bench, small_plan(loads=heavier, cycles=3), complete)
    assert str(raised.value) == (
        f"{complete}: was begun with another plan: -cycles = 2, +cycles = 3, -added = -0.05,"
        " +added = -0.06; take the plan back (plan.toml in the folder has it), or give another"
        " folder"
    )
    assert not bench.commanded
    more = tuple(tn.Load(f"ring {k}", -0.1 * k, 0.01) for k in range(1, 9))
    with pytest.raises(CampaignMismatch, match=r"and 4[0-9] lines more; take the plan back"):
        tn.acquire(StubBench(), small_plan(loads=(LOADS[0], *more), cycles=1), complete)


def test_a_file_that_the_plan_names_may_not_change_either(tmp_path):
    plan = small_plan(shapes=PlannedShapes(source="shapes.fits"))
    for k in (1, 2):
        image = k * 1e-7 * np.eye(8)
        write_shapes(tmp_path / "shapes.fits", image)
        if k == 1:
            tn.acquire(StubBench(), plan, tmp_path / "c", beside=tmp_path)
    with pytest.raises(CampaignMismatch, match=r"-# shapes.fits: [0-9a-f]{64}, \+#"):
        tn.acquire(StubBench(), plan, tmp_path / "c", beside=tmp_path)


def test_a_finished_campaign_is_left_alone(complete, whole):
    """Also where an older version kept the plan."""
    path = complete / "plan.toml"
    text = path.read_text()
    assert "saturation = 0.8\n" in text
    path.write_text(text.replace("saturation = 0.8\n", ""))
    bench = StubBench()
    assert [each.name for each in tn.acquire(bench, small_plan(), complete)] == sorted(whole)
    assert not bench.commanded
    assert len(list(complete.glob("run-*.jsonl"))) == 1


# The clock


def test_a_clock_that_was_set_back_ends_the_run_and_one_that_stands_does_not(tmp_path, whole):
    """By an hour in a shape, for good; then by a clock that is right again."""
    back = datetime.timedelta(hours=1)

    def spoil(shape, reading):
        late = (shape.load.name, shape.cycle) == ("bare", 2) and shape.number > 1
        return dataclasses.replace(reading, time=reading.time - late * back)

    said = r"is of 2026-05-04 08:30:\d\d, before the last one of .*: the clock of the bench was set"
    with pytest.raises(BenchFault, match=said):
        tn.acquire(StubBench(spoil=spoil), small_plan(), tmp_path / "c")
    tn.acquire(StubBench(), small_plan(), tmp_path / "c")
    assert contents(tmp_path / "c") == whole
    stands = StubBench(spoil=lambda shape, reading: dataclasses.replace(reading, time=START))
    tn.acquire(stands, small_plan(), tmp_path / "d")
    assert contents(tmp_path / "d") == whole


def test_a_resumed_campaign_is_later_than_what_it_resumes(tmp_path):
    """Simulated time goes on; a real clock must not be behind the cycles of the campaign."""
    plan, folder = small_plan(turns=2, settling=0.0), tmp_path / "c"
    tn.acquire(tn.SimulatedBench(SMALL, 1), plan, folder)
    for name in ("ring-002", "bare-002"):
        (folder / f"{name}.fits").unlink()
    tn.acquire(tn.SimulatedBench(SMALL, 1), plan, folder)
    cycles = sorted(tn.read(folder).cycles, key=lambda each: each.date)
    assert [(each.load.name, each.number) for each in cycles] == [
        ("bare", 1), ("ring", 1), ("ring", 2), ("bare", 2),
    ]  # fmt: skip
    ends = [each.date + datetime.timedelta(seconds=each.time[-1]) for each in cycles]
    assert all(end < each.date for end, each in zip(ends, cycles[1:], strict=False))

    class RealTime(StubBench):
        wait = None

        def read(self, samples):
            return dataclasses.replace(super().read(samples), time=min(ends))

    (folder / "bare-002.fits").unlink()
    with pytest.raises(BenchFault, match=r"no valid reading at rest: .* was set back"):
        tn.acquire(RealTime(), plan, folder)


# The command


def plan_file(tmp_path, **changes):
    path = tmp_path / "plan.toml"
    path.write_text(toml_text(small_plan(**changes)), encoding="utf-8")
    return path


def test_the_command_takes_a_campaign_and_says_when_it_is_complete(inside, tmp_path):
    plan, output = plan_file(tmp_path), tmp_path / "c"
    out = inside.prints("acquire", plan, "-o", output)
    assert out.splitlines()[0].startswith("'bare' is on: this is assumed, because no other load")
    assert out.splitlines()[1].startswith("'ring' is on: the sum of the forces is")
    then = f"next: truenewton calibrate {output} -o alpha.fits"
    assert out.splitlines()[2:] == [f"{output}: complete, 2 loads x 2 cycles", then]
    truth = tmp_path / "c.truth.fits"
    sealed = truth.read_bytes()
    truth.unlink()  # as where it was killed just before
    assert inside("acquire", plan, "-o", output) == (
        0, f"{output}: complete already, 2 loads x 2 cycles\n{then}\n", ""
    )  # fmt: skip
    assert truth.read_bytes() == sealed
    err = inside.refuses("acquire", plan_file(tmp_path, cycles=3), "-o", output)
    assert "-cycles = 2, +cycles = 3" in err
    shutil.rmtree(output)
    err = inside.refuses("acquire", plan, "-o", output)
    assert err.endswith("exists already, without its campaign; remove it, or choose another name\n")


def test_ctrl_c_at_the_command_is_one_line_and_exit_code_130(inside, tmp_path, monkeypatch):
    monkeypatch.setattr("truenewton.acquisition.acquire.chosen_bench", lambda *_: stopping())
    code, _, err = inside("acquire", plan_file(tmp_path), "-o", tmp_path / "c")
    assert (code, err.count("\n")) == (130, 1)
    assert err.startswith(f"truenewton: {tmp_path / 'c'}: stopped as asked, before shape ")
    assert err.endswith(
        "the mirror is at rest, complete cycles are kept; the same command takes the others\n"
    )


def test_nobody_at_a_terminal_must_say_yes(inside, tmp_path, monkeypatch):
    def bench(plan, beside):
        hands = Hands()
        hands.load = LOADS[0]
        return hands

    plan = plan_file(tmp_path)
    monkeypatch.setattr("truenewton.acquisition.acquire.chosen_bench", bench)
    monkeypatch.setattr("sys.stdin", None)
    err = inside.refuses("acquire", plan, "-o", tmp_path / "c")
    assert "an operator must take every weight off the mirror ('bare')" in err
    code, out, err = inside("acquire", plan, "-o", tmp_path / "c", "--yes")
    assert code == 2  # it was left off, whatever was said
    assert "put 'ring' on the mirror (0.05 N): assumed to be done" in out
    assert "'ring' is not on: the sum of the forces changed by" in err


def test_the_person_at_the_terminal_is_asked_again(inside, tmp_path, monkeypatch, capsys):
    hands, asked, told = Hands(), [], []

    def answer():
        told.append(capsys.readouterr())
        asked.append(told[-1].err.splitlines()[-1])
        hands.load = LOADS[1] if len(asked) == 3 else LOADS[0]

    monkeypatch.setattr("truenewton.acquisition.acquire.chosen_bench", lambda plan, beside: hands)
    monkeypatch.setattr("builtins.input", answer)
    monkeypatch.setattr("sys.stdin", type("Terminal", (), {"isatty": lambda self: True})())
    code, out, _ = inside("acquire", plan_file(tmp_path), "-o", tmp_path / "c", "--json")
    assert code == 0
    assert json.loads(out)["loads"] == ["bare", "ring"]  # what people are told stands apart
    assert [each.out for each in told] == ["", "", ""]
    assert asked == [
        "Take every weight off the mirror ('bare'), then press Enter: ",
        "Put 'ring' on the mirror (0.05 N), then press Enter: ",
        "Put 'ring' on the mirror (0.05 N), then press Enter: ",
    ]
    assert "'ring' is not on: the sum of the forces changed by" in told[2].err


class TerminalStream(io.StringIO):
    def isatty(self):
        return True


def test_a_bar_is_drawn_at_a_terminal(inside, tmp_path, monkeypatch, p45_folder):
    monkeypatch.setenv("COLUMNS", "120")
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.chdir(tmp_path)
    np.save("k.npy", MODEL)
    for command, *shown in (
        (f"acquire {plan_file(tmp_path).name} -o c", "ring cycle 2/2 shape 3/3 -",
         "N, smallest gap 64.0 um", "0:00:00"),
        ("simulate p45 -o s --cycles 2 --temperature 10", "simulating"),
        ("import k.npy --mirror ring8 --unit N/m -o k.fits", "importing"),
        (f"modes {p45_folder}", "reading", "finding modes"),
        (f"report {p45_folder} -o r.html", "investigating", "writing the report"),
        (f"track {p45_folder} s", "tracking"),
    ):  # fmt: skip
        monkeypatch.setattr(sys, "stderr", screen := TerminalStream())
        assert inside(*command.split())[0] == 0, command
        assert all(each in screen.getvalue() for each in shown), command
