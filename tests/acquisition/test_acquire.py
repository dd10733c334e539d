"""A campaign taken through the bench protocol: what is asked for, what it is worth, how it ends."""

import dataclasses
import json

import numpy as np
import pytest

import truenewton as tn
from helpers.acquisition_plans import LOADS, contents, small_plan, write_shapes
from helpers.stub_bench import SMALL, GoneBench, Hands, Looker, StubBench, altered, at
from truenewton.acquisition import taker
from truenewton.acquisition.acquire import MAX_INVALID_IN_A_ROW, MAX_REQUESTS
from truenewton.acquisition.plan import CampaignPlan, PlannedShapes, read_plan
from truenewton.acquisition.taker import judge, mean_sum
from truenewton.bench.choice import BenchChoice
from truenewton.bench.protocol import Status
from truenewton.bench.simulated.static import run_cycles, static_bench
from truenewton.errors import BenchFault, CampaignMismatch, FormatError, LimitExceeded
from truenewton.files.fits import read_fits
from truenewton.files.toml import toml_text
from truenewton.records.file import fits_paths


def cycles_in(folder):
    return tn.read(folder).cycles


def events(folder, kind):
    lines = "".join(path.read_text() for path in sorted(folder.glob("run-*.jsonl"))).splitlines()
    return [event for event in map(json.loads, lines) if event["event"] == kind]


@pytest.fixture
def whole_again(tmp_path, whole):
    """Return a function that says whether the folder holds what an undisturbed run takes."""
    return lambda: contents(tmp_path / "c") == whole


# What is taken


def test_the_rows_are_those_that_the_simulated_campaign_makes_by_itself(tmp_path):
    static = static_bench(SMALL, 3)
    write_shapes(tmp_path / "shapes.fits", static.shapes)
    plan = CampaignPlan(
        "ring8",
        static.loads,
        cycles=2,
        shapes=PlannedShapes(source="shapes.fits", force=0.3),
        bench=BenchChoice(seed=3),
    )
    bench = tn.SimulatedBench(SMALL, 3)
    files = tn.acquire(bench, plan, tmp_path / "campaign", beside=tmp_path)
    assert [path.name for path in files] == [
        "bare-001.fits", "bare-002.fits", "ring-001.fits", "ring-002.fits",
    ]  # fmt: skip
    assert all("CHECKSUM" in read_fits(path).header for path in files)
    for taken, made in zip(cycles_in(tmp_path / "campaign"), run_cycles(static, 2), strict=True):
        for name in ("force", "position"):
            assert getattr(taken, name) == pytest.approx(getattr(made, name), rel=1e-9, abs=1e-15)
        for name in ("shape", "sign", "valid", "temperature"):
            assert np.array_equal(getattr(taken, name), getattr(made, name))
        for name in ("instrument", "number", "load", "weight", "weight_error", "gap"):
            assert getattr(taken, name) == getattr(made, name)
        assert taken.force_error == pytest.approx(made.force_error)
        assert np.all(np.diff(taken.time) > 0)


def test_what_is_commanded_logged_and_told(tmp_path):
    """Every shape with both signs; the mirror rests in between."""
    bench, looker = StubBench(), Looker()
    tn.acquire(bench, small_plan(cycles=1), tmp_path / "c", onlooker=looker)
    numbers = [(s.load.name, s.number, s.sign) for s in bench.commanded]
    one = [(0, 1), (1, 1), (1, -1), (2, 1), (2, -1), (3, 1), (3, -1)]
    assert numbers == [(load, *each) for load in ("bare", "ring") for each in one]
    assert not bench.commanded[0].position.any()
    assert bench.resting == 3  # before each load, and in the end
    assert bench.asked == ["bare", "ring"]
    (start,) = events(tmp_path / "c", "start")
    assert start["truenewton"] == tn.__version__
    assert (start["bench"], start["instrument"], start["actuators"]) == ("StubBench", "RING8", 8)
    commands = events(tmp_path / "c", "command")
    assert len(commands) == 2 + 12
    assert {c["stroke"] for c in commands if c["shape"] == 0} == {0.0}
    assert max(c["stroke"] for c in commands) == pytest.approx(1e-6)
    assert [e["file"] for e in events(tmp_path / "c", "cycle")][-1] == "ring-001.fits"
    assert [now.done for now in looker.told] == list(range(1, 13))
    last = looker.told[-1]
    assert (last.total, last.invalid) == (12, 0)
    largest = max(np.abs(cycle.force).max() for cycle in cycles_in(tmp_path / "c"))
    stroke = max(np.abs(cycle.position).max() for cycle in cycles_in(tmp_path / "c"))
    assert largest <= last.largest_force < largest + 5e-4  # the mirror at rest is read as well
    assert last.smallest_gap == pytest.approx(65e-6 - stroke)
    assert looker.lines[1].startswith("'ring' is on: the sum of the forces is")


# Is the load on?


@pytest.mark.parametrize(
    ("known", "total", "on"),
    [
        ({}, 1.0, None),
        ({"bare": 1.0}, 1.289, True),  # Q = -0.289 N, to be held by as much more
        ({"bare": 1.0}, 1.289 / 0.7, False),  # 2.9 times as much
        ({"bare": 1.0}, 1.0 + 0.289 / 0.7, True),  # the weakest actuators
        ({"bare": 1.0}, 1.0 + 0.289 / 1.1, True),
        ({"bare": 1.0}, 1.0, False),
        ({"bare": 1.0}, 0.711, False),  # the wrong way
        ({"bare": 1.0, "ring": 1.3}, 1.31, True),
        ({"ring": 1.3}, 1.0, False),  # it was off overnight
        ({"ring": 1.3}, 1.35, True),
        ({"tilted": -0.46}, 1.289, True),  # P cos 60 deg: 1.46 N less to hold
    ],
)
def test_the_sum_of_the_forces_says_whether_a_load_is_on(known, total, on):
    ring_on = tn.Load("ring", -0.289, 0.005)
    loads = (tn.Load("bare"), ring_on, tn.Load("tilted", tilt=60.0))
    said, why = judge(-2.92, loads, ring_on, known, total)
    assert said is on, why


def test_loads_that_noise_hides_are_taken_on_trust():
    light = tn.Load("light", -0.001, 0.0001)
    loads, known = (tn.Load("bare"), light), {"bare": 1.0}
    assert judge(-2.92, loads, light, known, 1.0, error=1e-5)[0] is False
    assert judge(-2.92, loads, light, known, 1.0, error=1e-4)[0] is None


def test_elastic_forces_cancel_in_the_sum_whichever_rows_are_valid():
    """Those of a shape whose other sign is not valid, or not yet taken, do not count."""
    sign, shape = np.tile([1, -1], 3), np.repeat([1, 2, 3], 2)
    elastic = np.random.default_rng(1).standard_normal((4, 8))
    force, rest = 0.1 + sign[:, None] * elastic[shape], 0.1 * SMALL.layout.nz.sum()
    for valid, known in (
        ([1, 1, 1, 1, 1, 1], True), ([1, 1, 1, 0, 1, 0], True), ([0, 1, 1, 0, 1, 1], True),
        ([1, 0, 1, 0, 0, 1], False), ([0] * 6, False),
    ):  # fmt: skip
        total = mean_sum(SMALL.layout, force, shape, sign, np.array(valid))
        assert total == (pytest.approx(rest, abs=1e-12) if known else None)
    assert mean_sum(SMALL.layout, force[:5], shape[:5], sign[:5], np.ones(5)) == pytest.approx(rest)


def test_a_load_that_never_comes_stops_the_run_and_the_same_call_goes_on(tmp_path):
    bench = StubBench(put=lambda load: LOADS[0])
    with pytest.raises(BenchFault, match="'ring' is not on: the sum of the forces changed by"):
        tn.acquire(bench, small_plan(), tmp_path / "c")
    assert bench.asked == ["bare"] + MAX_REQUESTS * ["ring"]
    tn.acquire(StubBench(), small_plan(), tmp_path / "c")
    assert len(fits_paths([tmp_path / "c"])) == 4


def test_a_load_that_fell_off_between_two_runs_is_missed(tmp_path):
    stop = at(("bare", 2, 2, 1), altered(temperature=80.0))
    with pytest.raises(LimitExceeded):
        tn.acquire(StubBench(spoil=stop), small_plan(), tmp_path / "c")
    wrong = StubBench(put=lambda load: LOADS[1])  # the ring, where the bare mirror was
    with pytest.raises(BenchFault, match=r"'bare' is not on: .* since 'bare' was on before"):
        tn.acquire(wrong, small_plan(), tmp_path / "c")


def test_a_sum_that_goes_the_other_way_points_at_the_sign_of_the_forces():
    """As by a bench that gives what the glass does to the actuator."""
    loads = (tn.Load("bare"), tn.Load("ring", -0.289, 0.005))
    on, why = judge(-2.92, loads, loads[1], {"bare": -1.0}, -1.289)
    assert on is False
    assert why.endswith(": the wrong way, as if Force is not positive along +z")
    assert "wrong way" not in judge(-2.92, loads, loads[1], {"bare": -1.0}, -1.0)[1]


class Forgetful(StubBench):
    """Electronics that restart at a reading: then they take no shape until told their load."""

    told = True

    def __init__(self, at, **keywords):
        super().__init__(**keywords)
        self.at, self.lost = at, False

    def put_on(self, load):
        super().put_on(load)
        self.told = True

    def command(self, shape):
        if not self.told:
            raise BenchFault("the mirror bears None, not ring", remedy="put it on first")
        super().command(shape)

    def read(self, samples):
        here = (self.shape.load.name, self.shape.cycle, self.shape.number, self.shape.sign)
        if here == self.at and not self.lost:
            self.told, self.lost = False, True
            raise BenchFault("connection lost")
        return super().read(samples)


@pytest.mark.parametrize("place", [("ring", 1, 1, 1), ("ring", 2, 3, -1)])
def test_a_bench_that_was_started_anew_is_told_its_load_and_no_row_is_lost(
    tmp_path, whole_again, place
):
    bench, looker = Forgetful(place), Looker()
    tn.acquire(bench, small_plan(), tmp_path / "c", onlooker=looker)
    assert bench.asked == ["bare", "ring", "ring"]
    assert [event["on"] for event in events(tmp_path / "c", "load")] == [None, True, True]
    assert whole_again()
    assert "the bench refuses a shape (the mirror bears None, not ring (put it on first)): it may" \
        " have lost its load; 'ring' is put on again" in looker.lines  # fmt: skip


def test_a_load_that_fell_off_while_a_server_was_gone_is_missed(tmp_path):
    tries = iter([LOADS[0], LOADS[1], *[LOADS[0]] * MAX_REQUESTS])
    bench = Forgetful(("ring", 1, 2, 1), put=lambda load: next(tries))
    with pytest.raises(BenchFault, match="'ring' is not on: the sum of the forces changed by"):
        tn.acquire(bench, small_plan(), tmp_path / "c")


@pytest.mark.parametrize(("fell", "asked"), [(False, 0), (True, 1)])
def test_a_person_is_asked_again_only_where_the_load_is_off(tmp_path, fell, asked):
    """A shape that is refused once, as by a bench that tripped; its ring hangs on or fell."""

    class Tripped(Hands):
        tripped = False

        def command(self, shape):
            if (shape.load.name, shape.cycle, shape.number) == ("ring", 2, 2) and not self.tripped:
                self.tripped = True
                self.load = LOADS[0] if fell else self.load
                raise BenchFault("a coil tripped")
            super().command(shape)

    class Person:
        def put_on(self, load):
            put_on.append(load.name)
            bench.load = load

    bench, put_on = Tripped(), []
    tn.acquire(bench, small_plan(), tmp_path / "c", operator=Person())
    assert put_on == ["bare", "ring"] + asked * ["ring"]
    assert all(cycle.valid.all() for cycle in cycles_in(tmp_path / "c"))


# Readings that are not sound

NAN = np.full(8, np.nan)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda r: dataclasses.replace(r, force=np.where(np.arange(8) == 2, np.nan, r.force)),
         "the force of actuator 3 is NaN"),
        (altered(position=NAN), "the position of actuator 1 is NaN"),
        (altered(settled=False), "the mirror did not settle"),
        (altered(counter=3), "the counter stands still at 3"),
    ],
)  # fmt: skip
def test_an_unsound_reading_is_retried_then_marked(tmp_path, whole_folder, change, said):
    bench = StubBench(spoil=at(("bare", 1, 2, 1), change))
    tn.acquire(bench, small_plan(), tmp_path / "c")
    assert bench.read_of.count(("bare", 1, 2, 1)) == taker.MAX_ATTEMPTS
    first, *others = cycles_in(tmp_path / "c")
    assert np.flatnonzero(~first.valid).tolist() == [2]
    assert all(cycle.valid.all() for cycle in others)
    assert said in events(tmp_path / "c", "not sound")[-1]["fault"]
    sound = cycles_in(whole_folder)[0]
    assert np.array_equal(first.force[first.valid], sound.force[first.valid])


def test_a_reading_that_is_sound_when_retried_counts(tmp_path, whole_again):
    spoils = iter([True, True, False])

    def sometimes(reading):
        return dataclasses.replace(reading, settled=False) if next(spoils) else reading

    tn.acquire(StubBench(spoil=at(("bare", 1, 2, 1), sometimes)), small_plan(), tmp_path / "c")
    assert whole_again()


@pytest.mark.parametrize("name", ["force", "position"])
def test_readings_that_freeze_end_the_run_and_are_taken_again(tmp_path, whole, name):
    held = {}

    def freeze(shape, reading):
        if (shape.cycle, shape.number) == (1, 3):
            held.setdefault("value", getattr(reading, name))
        return dataclasses.replace(reading, **{name: held["value"]}) if held else reading

    bench = StubBench(spoil=freeze)
    with pytest.raises(BenchFault, match=f"no {name} has changed since the last shape") as raised:
        tn.acquire(bench, small_plan(), tmp_path / "c")
    assert f"{MAX_INVALID_IN_A_ROW} shapes in a row" in raised.value.fault
    assert raised.value.path == tmp_path / "c"
    assert bench.shape is None
    tn.acquire(StubBench(), small_plan(), tmp_path / "c")
    found = contents(tmp_path / "c")
    # The first cycle was complete with its last shape not valid; all that came after was not.
    assert not cycles_in(tmp_path / "c")[0].valid[-1]
    for name in ("bare-002.fits", "ring-001.fits", "ring-002.fits"):
        assert found[name] == whole[name]


def test_a_campaign_whose_last_shapes_are_unsound_is_not_complete(tmp_path):
    """Of more than one shape: the run ends, and the same call takes them again."""
    late = lambda shape, r: (  # noqa: E731
        (shape.load.name, shape.cycle) == ("ring", 2)
        and (shape.number, shape.sign) in ((2, -1), (3, 1), (3, -1))
    )
    spoil = lambda shape, r: dataclasses.replace(r, settled=not late(shape, r))  # noqa: E731
    with pytest.raises(BenchFault, match="3 shapes in a row gave no valid reading, the last shape"):
        tn.acquire(StubBench(spoil=spoil), small_plan(), tmp_path / "c")
    assert not (tmp_path / "c" / "ring-002.fits").exists()
    tn.acquire(StubBench(), small_plan(), tmp_path / "c")
    assert all(cycle.valid.all() for cycle in cycles_in(tmp_path / "c"))


def test_rows_that_are_not_valid_are_said_with_what_takes_them_again(tmp_path, inside, monkeypatch):
    path, folder = tmp_path / "plan.toml", tmp_path / "c"
    path.write_text(toml_text(small_plan()), encoding="utf-8")
    unsettled = StubBench(spoil=at(("ring", 1, 2, -1), altered(settled=False)))
    benches = iter([unsettled, StubBench(), StubBench()])
    monkeypatch.setattr("truenewton.acquisition.acquire.chosen_bench", lambda *_: next(benches))
    said = ", but 1 of 24 rows are not valid (ring-001.fits 1); to repeat a cycle, remove its"
    for already in ("", " already"):
        out = inside.prints("acquire", path, "-o", folder)
        assert f"c: complete{already}, 2 loads x 2 cycles{said}" in out
    (folder / "ring-001.fits").unlink()
    code, out, _ = inside("acquire", path, "-o", folder)
    assert (code, out.splitlines()[-2]) == (0, f"{folder}: complete, 2 loads x 2 cycles")


def test_a_cycle_without_one_sound_reading_is_not_written(tmp_path):
    spoil = lambda shape, r: dataclasses.replace(r, settled=shape.number == 0)  # noqa: E731
    with pytest.raises(BenchFault, match="no shape of cycle 1 under 'bare' is valid"):
        tn.acquire(StubBench(spoil=spoil), small_plan(count=1), tmp_path / "c")
    tn.acquire(StubBench(), small_plan(count=1), tmp_path / "c")
    assert all(cycle.valid.all() for cycle in cycles_in(tmp_path / "c"))


# A bench that goes away


def test_a_server_that_goes_and_comes_back_costs_nothing(tmp_path, whole_again, monkeypatch):
    monkeypatch.setattr(taker, "FIRST_WAIT", 0.001)
    tn.acquire(GoneBench(looks=4), small_plan(), tmp_path / "c")
    assert whole_again()
    faults = [event["fault"] for event in events(tmp_path / "c", "gone")]
    assert faults == 4 * ["connection refused"]


def test_a_mirror_that_comes_to_rest_at_the_second_try_is_well(tmp_path):
    class Restless(StubBench):
        def rest(self):
            super().rest()
            if self.resting % 2:
                raise BenchFault("connection lost")

    tn.acquire(Restless(), small_plan(), tmp_path / "c")
    assert [event["attempt"] for event in events(tmp_path / "c", "not at rest")] == [1, 1, 1]
    assert len(cycles_in(tmp_path / "c")) == 4


def test_a_server_that_stays_away_ends_the_run_which_goes_on_later(
    tmp_path, whole_again, monkeypatch
):
    monkeypatch.setattr(taker, "FIRST_WAIT", 0.001)
    monkeypatch.setattr(taker, "MAX_ABSENCE", 0.01)
    with pytest.raises(BenchFault, match=r"did not come back within 0\.01 s .connection refused"):
        tn.acquire(GoneBench(looks=10**9), small_plan(), tmp_path / "c")
    tn.acquire(StubBench(), small_plan(), tmp_path / "c")
    assert whole_again()


def test_a_bench_that_stopped_itself_is_not_commanded_again(tmp_path):
    class Stopped(StubBench):
        def read(self, samples):
            if self.counter == 6:
                self.stopped = True
                raise BenchFault("a coil saturated")
            return super().read(samples)

        def status(self):
            return Status(not self.stopped, "coil 4 saturated", self.counter)

        stopped = False

    bench = Stopped()
    with pytest.raises(BenchFault, match="takes no commands: coil 4 saturated"):
        tn.acquire(bench, small_plan(), tmp_path / "c")
    assert len(bench.commanded) == 7


def test_errors_of_the_code_of_a_bench_are_its_faults(tmp_path, whole_again, monkeypatch):
    """As those of a socket: a shape is tried again, and a bench without a status is awaited."""
    monkeypatch.setattr(taker, "FIRST_WAIT", 0.001)
    failing = {"command": 3, "read": 5, "status": 7, "rest": 2}

    def failing_once(name):
        def method(self, *arguments):
            failing[name] -= 1
            if not failing[name]:
                raise TimeoutError("timed out")
            return getattr(StubBench, name)(self, *arguments)

        return method

    bench = type("MyBench", (StubBench,), {name: failing_once(name) for name in failing})()
    tn.acquire(bench, small_plan(), tmp_path / "c")
    assert whole_again()
    faults = [event["fault"] for kind in ("not sound", "gone", "not at rest")
              for event in events(tmp_path / "c", kind)]  # fmt: skip
    assert faults == [
        *(f"MyBench.{name} fails (TimeoutError: timed out) (check the bench)"
          for name in ("command", "read")),
        *(f"MyBench.{name} fails (TimeoutError: timed out)" for name in ("status", "rest")),
    ]  # fmt: skip


@pytest.mark.parametrize("kind", [BenchFault, ConnectionError])
def test_a_mirror_that_cannot_be_brought_to_rest_is_said_first(tmp_path, kind):
    class Dead(StubBench):
        def rest(self):
            if self.commanded:
                raise kind("connection lost")

    spoil = at(("bare", 1, 2, 1), altered(temperature=80.0))
    with pytest.raises(
        BenchFault, match=r"may not be at rest .*connection lost.*, after: .* 80 deg"
    ):
        tn.acquire(Dead(spoil=spoil), small_plan(), tmp_path / "c")


# Bench and plan


@pytest.mark.parametrize(
    ("other", "said"),
    [
        ({"layout": tn.mirrors.ring(9).layout}, "the bench has 9 actuators, the plan's RING8 8"),
        ({"instrument": "RING9"}, "the bench is RING9, the plan is for RING8"),
        (
            {"layout": dataclasses.replace(SMALL.layout, x=SMALL.layout.x + 1e-4)},
            r"other actuators than RING8: X of actuator 1 \(row 1\): \S+ and \S+ m, 100 um apart;"
            r" and 7 more \(the bench's first\)",
        ),
    ],
)
def test_a_bench_that_is_not_the_plans_is_refused_untouched(tmp_path, other, said):
    bench = StubBench()
    vars(bench).update(other)
    with pytest.raises(CampaignMismatch, match=said):
        tn.acquire(bench, small_plan(), tmp_path / "c")
    assert not bench.commanded
    assert not (tmp_path / "c").exists()


def test_places_of_four_bytes_are_those_of_the_plan(tmp_path):
    bench, places = StubBench(), {name: getattr(SMALL.layout, name) for name in ("x", "y")}
    short = {name: values.astype("f4") for name, values in places.items()}
    bench.layout = dataclasses.replace(SMALL.layout, **short)
    assert not np.array_equal(bench.layout.x, SMALL.layout.x)
    for _ in range(2):  # and again, where it is complete
        tn.acquire(bench, small_plan(), tmp_path / "c")
    assert all(cycle.layout.same_as(SMALL.layout) for cycle in cycles_in(tmp_path / "c"))


@pytest.mark.parametrize(
    ("bench", "loads", "said"),
    [
        (
            StubBench(spoil=at(("bare", 1, 0, 1), altered(force=np.zeros(7)))),
            LOADS,
            r"gives force of shape \(7,\) for 8 actuators",
        ),
        (Hands(), LOADS, "no operator puts the loads on"),
        (
            StubBench(),
            (tn.Load("ring A"), tn.Load("ring_a", -0.1, 0.01)),
            "'ring A' and 'ring_a' would share",
        ),
    ],
)
def test_a_bench_or_plan_that_cannot_be_is_refused(tmp_path, bench, loads, said):
    with pytest.raises((BenchFault, FormatError), match=said):
        tn.acquire(bench, small_plan(loads=loads), tmp_path / "c")


def test_a_plan_is_kept_as_it_is_read(tmp_path):
    plan = small_plan(
        loads=(tn.Load('b"a\\re'), tn.Load("ring", -0.1, 0.01, "tool 1", 60.0, 0.1)),
        bench=BenchChoice("python", "r\u00e9n\t\u00e9"),
    )
    (tmp_path / "plan.toml").write_text(toml_text(plan), encoding="utf-8")
    assert read_plan(tmp_path / "plan.toml") == plan
