"""Faults that only the user can correct: wrong labels, copies, cables, dead actuators."""

import itertools
from dataclasses import replace

import numpy as np
import pytest

import truenewton as tn
from helpers.changed import p45, with_forces
from helpers.small_bench import SmallBench
from truenewton.errors import TrueNewtonError
from truenewton.estimation.checks import likeliest_order
from truenewton.estimation.screening.hypotheses import clusters
from truenewton.linalg import assignment
from truenewton.records.campaign import Campaign

NOISE = (1e-3, 5e-5)


def messages(cycles):
    """Return the effects reported for cycles, or the reason of the refusal."""
    try:
        found = tn.calibrate(Campaign(tuple(cycles)))
    except TrueNewtonError as error:
        return [error.fault]
    return [f"{effect.name}: {effect.where}" for effect in found.effects]


def check(cycles, *words):
    """Assert that one message contains all words."""
    texts = messages(cycles)
    assert any(all(word in text for word in words) for text in texts), texts


@pytest.mark.parametrize("noise", NOISE)
def test_a_copy_of_half_of_the_rows_is_reported(noise):
    files = p45(noise, 4)
    force = np.array(files[1].force)
    force[: len(force) // 2] = np.asarray(files[0].force)[: len(force) // 2]
    check([files[0], replace(files[1], force=force), *files[2:]], "copy", files[1].name)
    assert not any("copy" in text for text in messages(p45(0.0, 4)))


@pytest.mark.parametrize("noise", NOISE)
@pytest.mark.parametrize("rounded", [np.float32, lambda force: np.round(force, 5)])
def test_a_copy_in_other_digits_is_reported(noise, rounded):
    """It was an unknown force, or a misfit, or nothing."""
    files = p45(noise, 3)
    copy = np.array(rounded(np.asarray(files[0].force)), dtype=float)
    check([files[0], replace(files[1], force=copy), *files[2:]], "copy", "bare 2 of bare 1")
    alike = [replace(c, force=np.asarray(c.force) * (1 + 1e-3 * k)) for k, c in enumerate(files)]
    assert not any("copy" in text for text in messages(alike))


def test_forces_that_all_lag_by_a_row_are_reported():
    """They were an unknown force, quadratic coils or wrong positions."""

    def late(_, force):
        return np.concatenate([force[:1], force[:-1]])

    check(with_forces(p45(1e-3, 2), late), "FORCE lags by a row", "45 of 45 columns")


def pushed(bench):
    """Push the mirror by another force in each shape of each sign."""
    forces = 0.02 * bench.random.standard_normal((28, 3)) * [1.0, 0.1, 0.1]
    bench.external = forces[bench.shape - 1 + 14 * (bench.sign > 0)]


def other_sizes(bench):
    """Let shapes differ under the load, each by itself, which no POSITION shows."""
    bench.has_position = False
    bench.size = 1 + (bench.load == 1) * bench.random.normal(0.0, 0.3, 14)[bench.shape - 1]


@pytest.mark.parametrize(("happens", "similar", "where"), [
    (pushed, "positions", ""),
    (other_sizes, "gain by load", "shapes balance, but do not repeat"),
])  # fmt: skip
def test_an_effect_that_does_not_explain_the_data_is_unknown(happens, similar, where):
    """It was 'positions', with the advice to measure X and Y."""
    bench = SmallBench(3, 1e-4)
    happens(bench)
    [effect] = tn.calibrate(bench.campaign()).effects
    assert (effect.code, effect.level) == (tn.Code.UNKNOWN_EFFECT, "doubtful")
    assert effect.name == f"unknown effect, most similar to {similar}"
    assert effect.where.startswith(where)
    assert "measure X and Y" not in effect.remedy
    assert "Possible causes, besides" in effect.remedy


def test_noise_in_proportion_to_the_force_is_reported_and_no_coils():
    """Noise of 1 % of the force was quadratic coils, 'have the coil drivers looked at'."""
    codes, squares = [], []
    for seed in range(6):
        bench = SmallBench([seed, 2], 1e-4)
        force = bench.readings
        bench.error = bench.error + 0.01 * force * bench.random.standard_normal(force.shape)
        found = tn.calibrate(bench.campaign())
        codes += [str(each.code) for each in found.effects]
        squares.append(np.mean((found.alpha - bench.alpha) ** 2 / found.statistical_error**2))
        assert found.verdict.level == "usable"
        [share] = [each.size for each in found.effects if each.code == "noise-by-force"]
        assert share == pytest.approx(1.0, abs=0.15)
    assert set(codes) == {"noise-by-force"}
    assert np.sqrt(np.mean(squares)) == pytest.approx(1.0, abs=0.4)
    assert not tn.calibrate(SmallBench(1, 1e-4).campaign()).effects


def test_a_drift_is_no_noise_in_proportion_to_the_force():
    bench = SmallBench(2, 1e-4)
    bench.gain = 1 + 3e-3 * bench.hours[:, None]
    found = tn.calibrate(bench.campaign()).effects
    assert [str(each.code) for each in found] == ["gain-by-hour"]


def test_an_actuator_that_reads_noise_alone_is_refused_as_dead():
    random = np.random.default_rng(1)

    def silent(_, force):
        force[:, 16] = 1e-3 * random.standard_normal(len(force))
        return force

    check(with_forces(p45(1e-3, 4), silent), "dead", "actuator 17")


def test_exchanged_cables_make_the_result_doubtful_without_position():
    order = np.arange(45)
    order[[2, 40]] = 40, 2
    files = with_forces(p45(5e-5, 4, position=None), lambda _, f: f[:, order])
    assert tn.calibrate(Campaign(tuple(files))).verdict.level <= "doubtful"


def test_the_most_likely_order_is_the_true_one_for_any_gains():
    random = np.random.default_rng(2)
    root = random.standard_normal((20, 17))
    stiffness = root @ root.T
    gains = random.uniform(0.5, 2.0, (2, 20)) * random.choice([-1.0, 1.0], (2, 20))
    order = random.permutation(20)
    assert np.array_equal(likeliest_order((gains[0, :, None] * stiffness * gains[1])[order]), order)


def test_clusters_are_found_only_if_there_are_as_many_as_loads():
    at = np.array([0.0, 0.1, 1.0, 1.05, 0.05])
    assert clusters(np.abs(at[:, None] - at), 2).tolist() == [0, 0, 1, 1, 0]
    at = np.array([0.0, 0.3, 0.6, 1.0])
    assert clusters(np.abs(at[:, None] - at), 2) is None


@pytest.mark.parametrize("n", [2, 4, 6])
def test_assignment_has_the_lowest_cost_of_all_permutations(n):
    random = np.random.default_rng(n)
    for cost in random.normal(size=(40, n, 6)):
        every = [cost[np.arange(n), order].sum() for order in itertools.permutations(range(6), n)]
        made = assignment(cost)
        assert len(set(made)) == n
        assert cost[np.arange(n), made].sum() == pytest.approx(min(every), abs=1e-12)
