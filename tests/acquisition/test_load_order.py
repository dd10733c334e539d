"""The order of the loads: what drift costs in it, against the estimator; who mounts what."""

import json
from dataclasses import replace
from itertools import product

import numpy as np
import pytest

import truenewton as tn
from helpers.acquisition_plans import contents, small_plan
from helpers.stub_bench import Looker, StubBench, at
from truenewton.acquisition.load_order import (
    cycle_time,
    mounting_variance,
    mountings,
    order_cost,
    scale_balance,
    turns_that_pay,
    with_turns,
)
from truenewton.acquisition.plan import AssumedDrift, CampaignPlan, read_plan, template
from truenewton.errors import CampaignMismatch, FormatError
from truenewton.estimation.findings.estimate import NoiseSource
from truenewton.estimation.problem import problem_of
from truenewton.estimation.readings.moments import Noise
from truenewton.estimation.screening.screen import campaign_moments
from truenewton.mirrors.known import p45
from truenewton.planning.forces import noiseless, prepared_bodies
from truenewton.planning.plan_prediction import third_load
from truenewton.records.campaign import Campaign
from truenewton.statics.load import Load

RING = (Load("bare"), Load("ring", -0.289, 0.005, tool="ring"))
THREE = (*RING, Load("leaning", tilt=30.0, tilt_error=0.1))
PLAN = CampaignPlan("p45", RING, drift=AssumedDrift(3e-3, 2e-5, 1e-5))


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
    for turns, said in ((4, "turns is 4; give 0 to 3"), (-1, "give 0 to 3")):
        with pytest.raises(FormatError, match=said):
            replace(PLAN, turns=turns)
    with pytest.raises(FormatError, match="turns is 3; use no more turns than cycles"):
        replace(PLAN, cycles=2, turns=3)
    with pytest.raises(FormatError, match=r"drift\.zero is -1; give zero or more"):
        replace(PLAN, drift=AssumedDrift(zero=-1))


# What drift costs


def test_two_loads_in_closed_form():
    mirror, plan = p45(), replace(PLAN, turns=1)
    balance, cost = scale_balance(plan, mirror, 45), order_cost(plan, mirror, 45)
    bare, ring = balance.held
    assert ring - bare == pytest.approx(0.289)
    assert bare == pytest.approx(2.920 - 0.097 * mirror.layout.nz.sum())
    assert balance.response == pytest.approx(np.array([1.0, -1.0]) / 0.289)
    hours = (mountings(plan, 45)[1].start) / 3600
    assert cost.gain == pytest.approx(3e-3 * 0.5 * (bare + ring) / 0.289 * hours)
    zero = mirror.layout.nz.sum() / 0.289  # alpha is 1
    alpha = np.mean(mirror.alpha_range)
    assert abs(cost.zero) == pytest.approx(alpha * 2e-5 * hours * zero)
    assert cost.remounting == pytest.approx(alpha * 1e-5 * np.sqrt(2) * zero)
    assert cost.known == pytest.approx(0.005 / 0.289, rel=1e-3)
    assert mounting_variance(replace(plan, turns=3), balance) == pytest.approx(
        (alpha * 1e-5 * zero * 0.289) ** 2 * np.array([0.625, 0.625])
    )


def drifting(plan, quiet):
    """Return the cycles of a plan, read while alpha and zeros drift as it assumes."""
    drift, order = plan.drift, mountings(plan, 45)
    by_name = {cycle.load.key: cycle for cycle in quiet.cycles}
    middle = np.mean(
        [m.start + (k + 0.5) * cycle_time(plan, 45) for m in order for k in range(len(m.cycles))]
    )
    cycles = []
    for mounting in order:
        for k, number in enumerate(mounting.cycles):
            cycle = by_name[mounting.load.key]
            rows = (np.arange(90) + 0.5) / 90
            hour = (mounting.start + (k + rows) * cycle_time(plan, 45) - middle)[:, None] / 3600
            force = np.asarray(cycle.force) / (1 + drift.alpha * hour) + drift.zero * hour
            cycles.append(replace(cycle, number=number, force=force, force_error=None))
    return Campaign(tuple(cycles))


def uncorrected(campaign):
    """Return the likeliest alpha, nothing that drifts taken out."""
    moments = campaign_moments(campaign)
    noise = Noise(np.full(45, 1e-5**2), NoiseSource.DECLARED)  # repeats differ by drift alone
    problem = problem_of(campaign, noise)
    return problem.fitted(moments).values[: problem.n]


@pytest.mark.parametrize(("loads", "cycles", "turns"), [(RING, 4, 1), (RING, 3, 3), (THREE, 4, 3)])
@pytest.mark.parametrize("drift", [AssumedDrift(3e-4, 0.0), AssumedDrift(0.0, 2e-6)])
def test_the_estimator_moves_the_scale_as_predicted(loads, cycles, turns, drift):
    plan = replace(PLAN, loads=loads, cycles=cycles, turns=turns, drift=drift, force_noise=1e-5)
    ready = prepared_bodies(plan)[0]
    still = uncorrected(drifting(replace(plan, drift=AssumedDrift(0, 0)), noiseless(ready)))
    moved = uncorrected(drifting(plan, noiseless(ready))) / still - 1
    cost, block = (order_cost(replace(plan, turns=t), p45(), 45) for t in (turns, 1))
    predicted, whole = cost.gain + cost.zero, abs(block.gain + block.zero)
    assert np.median(moved) == pytest.approx(predicted, rel=0.02, abs=0.003 * whole)


def test_loads_are_mounted_again_where_drift_costs_more_than_that():
    assert turns_that_pay(PLAN, p45(), 45) == 3
    assert turns_that_pay(replace(PLAN, cycles=2), p45(), 45) == 2
    assert turns_that_pay(replace(PLAN, cycles=1), p45(), 45) == 1
    still = replace(PLAN, drift=AssumedDrift(0.0, 0.0, 0.0))
    assert turns_that_pay(still, p45(), 45) == 1
    assert turns_that_pay(replace(PLAN, drift=AssumedDrift(1e-4, 0.0, 0.0)), p45(), 45) == 1
    # Loud readings need the time themselves.
    loud = replace(PLAN, force_noise=0.02, loads=(RING[0], replace(RING[1], added_error=0.0)))
    assert turns_that_pay(loud, replace(p45(), weight_error=0.0), 45) == 1
    assert turns_that_pay(replace(loud, pause=1.0), p45(), 45) == 1  # no time to drift
    # What is written is kept, whatever pays.
    assert with_turns(replace(still, turns=3), p45(), 45).turns == 3


# A third load


def test_a_third_load_shows_what_two_cannot():
    ready = prepared_bodies(replace(PLAN, turns=1))[0]
    third = third_load(ready)
    assert third.like == "ring"
    moved = 45 * np.mean(p45().alpha_range) * 1e-5 / 0.289  # by a mounting
    assert third.seen == pytest.approx(3 * np.sqrt(2) * np.hypot(0.005, 0.289 * moved), rel=0.01)
    assert third.relative == pytest.approx(third.seen / 0.289)
    assert third.duration == pytest.approx(1800 + 4 * cycle_time(PLAN, 45))
    assert third.mountings == 1
    assert third.error < third.error_now
    assert third_load(prepared_bodies(replace(PLAN, loads=THREE))[0]) is None
    assert third_load(prepared_bodies(replace(PLAN, loads=RING[:1]))[0]) is None
    leaning = third_load(prepared_bodies(replace(PLAN, loads=(THREE[0], THREE[2])))[0])
    assert leaning.like == "leaning"
    assert leaning.relative < 0.05


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
    open_plan, in_turn = (small_plan(cycles=3, count=1, turns=turns) for turns in (0, 3))
    tn.acquire(StubBench(), in_turn, tmp_path / "whole")
    with pytest.raises(KeyboardInterrupt):
        tn.acquire(stopping_at("ring", 2, 1, -1), open_plan, tmp_path / "c")
    assert read_plan(tmp_path / "c" / "plan.toml").turns == 3
    bench = StubBench()
    tn.acquire(bench, open_plan, tmp_path / "c")
    assert bench.asked == ["ring", "bare", "ring"]
    assert contents(tmp_path / "c") == contents(tmp_path / "whole")
    tn.acquire(StubBench(), in_turn, tmp_path / "c")  # the same plan
    with pytest.raises(CampaignMismatch, match=r"-turns = 3, \+turns = 1"):
        tn.acquire(StubBench(), replace(in_turn, turns=1), tmp_path / "c")


def test_a_folder_of_an_older_version_goes_on_load_after_load(tmp_path):
    with pytest.raises(KeyboardInterrupt):
        tn.acquire(stopping_at("bare", 3, 1, 1), small_plan(cycles=4), tmp_path / "c")
    path = tmp_path / "c" / "plan.toml"
    text = path.read_text(encoding="utf-8")
    before, drift, _ = text.partition("[drift]")
    older = before.replace("turns = 1\n", "")
    assert drift
    assert "turns" not in older
    path.write_text(older, encoding="utf-8")
    bench = StubBench()
    tn.acquire(bench, small_plan(cycles=4, turns=0), tmp_path / "c")
    assert bench.asked == ["bare", "ring"]


# What is said


def test_the_plan_says_what_each_order_costs_and_a_third_load(inside, tmp_path):
    path = tmp_path / "plan.toml"
    path.write_text(template(), encoding="utf-8")
    assert len(inside("plan", path, "--target", "0.001")[1].splitlines()) <= 20
    code, out, err = inside("plan", path, "--verbose")
    assert (code, err) == (0, "")
    for words in (
        "order of the loads      bare 1, ring 1-3, bare 2-4, ring 4",
        "'ring' at 30 min, 'bare' at 61 min, 'ring' at 92 min",
        "(drift per hour: alpha 0.30 %, zeros 10 uN; mounting: 10 uN)",
        "time 1 0.70 %",
        "92 min planned",
        "scale error, drift included: 1.7 % with turns = 3 (2 more load changes, 60 min), 1.9 %",
        "from 1.7 % to 1.2 %. An error of 21 mN in 'ring' can then be detected.",
        "91 min more 3 load changes; detects a 7.4 % scale error",
    ):
        assert " ".join(words.split()) in " ".join(out.split())
    values = json.loads(inside("plan", path, "--json")[1])
    assert values["turns"] == 3
    assert [m["load"] for m in values["mountings"]] == IN_TURN
    assert [m["cycles"] for m in values["mountings"]] == [[1, 1], [1, 3], [2, 4], [4, 4]]
    assert [cost["turns"] for cost in values["orders"]] == [1, 2, 3]
    assert values["orders"][0]["gain"] == pytest.approx(-6.97e-3, rel=1e-2)
    assert values["third_load"]["seen"] == pytest.approx(0.0213, rel=0.02)
    old = template().replace("turns = 0 ", "# turns = 0 ", 1)
    path.write_text(old, encoding="utf-8")
    out = inside("plan", path, "--verbose")[1]
    for words in ("bare 1-4, ring 1-4", "32 min  planned", "advice: Use turns = 3"):
        assert words in out
    path.write_text(old.partition('[[loads]]\nname = "ring"')[0], encoding="utf-8")
    out = inside("plan", path)[1]  # of one load
    assert "A third load" not in out
    assert "more load changes" not in out
