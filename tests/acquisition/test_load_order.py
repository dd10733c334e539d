"""The order of the loads: which is mounted when, and what the bench is asked for."""

import json
from dataclasses import replace
from itertools import product

import numpy as np
import pytest

import truenewton as tn
from helpers.acquisition_plans import contents, small_plan
from helpers.stub_bench import Looker, StubBench, at
from truenewton.acquisition.load_order import cycle_time, mountings
from truenewton.acquisition.plan import CampaignPlan, template
from truenewton.errors import CampaignMismatch, FormatError
from truenewton.statics.load import Load

RING = (Load("bare"), Load("ring", -0.289, 0.005, tool="ring"))
THREE = (*RING, Load("leaning", tilt=30.0, tilt_error=0.1))
PLAN = CampaignPlan("p45", RING)


def in_words(plan):
    return ", ".join(map(str, mountings(plan)))


# The order


@pytest.mark.parametrize(
    ("cycles", "turns", "order"),
    [
        (4, 1, "bare 1-4, ring 1-4"),
        (4, 3, "bare 1, ring 1-3, bare 2-4, ring 4"),
        (8, 3, "bare 1-2, ring 1-6, bare 3-8, ring 7-8"),
    ],
)
def test_the_way_goes_there_and_back(cycles, turns, order):
    assert in_words(replace(PLAN, cycles=cycles, turns=turns)) == order


def test_every_cycle_is_taken_once_and_in_its_order():
    for loads, cycles, turns in product((RING[:1], RING, THREE), range(1, 10), (1, 2, 3)):
        if turns <= cycles:
            plan = CampaignPlan("p45", loads, cycles=cycles, turns=turns)
            taken = [(m.load.name, k) for m in mountings(plan) for k in m.cycles]
            for load in loads:
                numbers = [k for name, k in taken if name == load.name]
                assert numbers == list(range(1, cycles + 1))
            assert len(mountings(plan)) - 1 == turns * (len(loads) - 1)


def test_what_drifts_as_a_power_of_time_less_than_the_turns_falls_out():
    for turns in (1, 2, 3):
        plan = replace(PLAN, cycles=4, turns=turns, settling=0.0, samples=1)
        order = mountings(plan)
        sides = [(1 if m.load.added else -1) * len(m.cycles) for m in order]
        moments = [np.dot(sides, np.arange(len(order)) ** power) for power in range(turns + 1)]
        assert not any(moments[:turns])
        assert moments[turns]
    # One cycle of each in turn would do nothing: the change of load takes the time.
    assert np.dot([-1, 1] * 4, range(8)) / 4 == np.dot([-1, 1], range(2))


def test_times_are_those_of_readings_and_changes():
    order = mountings(replace(PLAN, turns=3), 45)
    one = cycle_time(PLAN, 45)
    assert one == pytest.approx(90 * (0.15 + 2048 / 71.6e3))
    assert [m.start for m in order] == pytest.approx(
        [0, one + 1800, 4 * one + 3600, 7 * one + 5400]
    )
    assert order[-1].end == pytest.approx(8 * one + 5400)


def test_turns_that_cannot_be_are_refused():
    for turns, said in ((4, "turns is 4; give 1 to 3"), (0, "give 1 to 3")):
        with pytest.raises(FormatError, match=said):
            replace(PLAN, turns=turns)
    with pytest.raises(FormatError, match="turns is 3; use no more turns than cycles"):
        replace(PLAN, cycles=2, turns=3)


# At the bench


IN_TURN = ["bare", "ring", "bare", "ring"]


def test_loads_are_asked_for_in_turn_and_the_files_hold_the_same(tmp_path):
    bench, looker = StubBench(), Looker()
    tn.acquire(bench, small_plan(cycles=4), tmp_path / "a", onlooker=looker)
    assert bench.asked == ["bare", "ring"]
    assert not [line for line in looker.lines if line.startswith("mounting")]
    bench = StubBench()
    files = tn.acquire(bench, small_plan(cycles=4, turns=3), tmp_path / "b", onlooker=looker)
    assert bench.asked == IN_TURN
    assert len(files) == 8
    assert contents(tmp_path / "a") == contents(tmp_path / "b")
    said = [line for line in looker.lines if line.startswith("mounting")]
    assert said == [
        "mounting 1 of 4: 'bare' for cycle 1, then 'ring'",
        "mounting 2 of 4: 'ring' for cycles 1 to 3, then 'bare'",
        "mounting 3 of 4: 'bare' for cycles 2 to 4, then 'ring'",
        "mounting 4 of 4: 'ring' for cycle 4, the last",
    ]
    dates = {(c.load.name, c.number): c.date for c in tn.read(tmp_path / "b").cycles}
    taken = [("bare", 1), ("ring", 1), ("ring", 3), ("bare", 2), ("bare", 4), ("ring", 4)]
    assert sorted(taken, key=dates.get) == taken


def stopping_at(*place):
    """Return a bench that is gone at a (load, cycle, shape, sign)."""

    def gone(reading):
        raise KeyboardInterrupt

    return StubBench(spoil=at(place, gone))


def test_a_campaign_goes_on_in_the_order_it_was_begun_with(tmp_path):
    plan = small_plan(cycles=3, count=1, turns=3)
    tn.acquire(StubBench(), plan, tmp_path / "whole")
    with pytest.raises(KeyboardInterrupt):
        tn.acquire(stopping_at("ring", 2, 1, -1), plan, tmp_path / "c")
    bench = StubBench()
    tn.acquire(bench, plan, tmp_path / "c")
    assert bench.asked == ["ring", "bare", "ring"]
    assert contents(tmp_path / "c") == contents(tmp_path / "whole")
    with pytest.raises(CampaignMismatch, match=r"-turns = 3, \+turns = 1"):
        tn.acquire(StubBench(), replace(plan, turns=1), tmp_path / "c")


# What is said


def test_the_plan_says_the_order_and_when_loads_change(inside, tmp_path):
    path = tmp_path / "plan.toml"
    path.write_text(template(), encoding="utf-8")
    assert len(inside("plan", path, "--target", "0.001")[1].splitlines()) <= 20
    out = inside.prints("plan", path, "--verbose")
    for words in (
        "order of the loads      bare 1, ring 1-3, bare 2-4, ring 4",
        "'ring' at 30 min, 'bare' at 61 min, 'ring' at 92 min",
    ):
        assert " ".join(words.split()) in " ".join(out.split())
    values = json.loads(inside("plan", path, "--json")[1])
    assert values["turns"] == 3
    assert [m["load"] for m in values["mountings"]] == IN_TURN
    assert [m["cycles"] for m in values["mountings"]] == [[1, 1], [1, 3], [2, 4], [4, 4]]
    path.write_text(template().replace("turns = 3 ", "# turns = 3 ", 1), encoding="utf-8")
    assert "bare 1-4, ring 1-4" in inside("plan", path)[1]
