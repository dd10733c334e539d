"""Faults that only the user can correct: wrong labels, copies, cables, dead actuators."""

import itertools
from dataclasses import replace

import numpy as np
import pytest

import truenewton as tn
from helpers.changed import p45, with_forces
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


@pytest.mark.parametrize(("noise", "cycles", "at"), [(1e-3, 2, 1), (5e-5, 4, -1)])
def test_a_file_with_the_wrong_load_is_reported(noise, cycles, at):
    files = p45(noise, cycles)
    files[at] = replace(files[at], load=files[-1 - at].load, number=9)
    check(files, "wrong LOAD", f"{files[at].load.name} 9")


@pytest.mark.parametrize("noise", NOISE)
def test_full_and_partial_copies_are_reported(noise):
    files = p45(noise, 4)
    whole = replace(files[1], force=files[0].force)
    check([files[0], whole, *files[2:]], "copy", files[1].name)
    force = np.array(files[1].force)
    force[: len(force) // 2] = np.asarray(files[0].force)[: len(force) // 2]
    check([files[0], replace(files[1], force=force), *files[2:]], "copy", files[1].name)
    assert not any("copy" in text for text in messages(p45(0.0, 4)))


@pytest.mark.parametrize(("noise", "cycles"), [(1e-3, 2), (5e-5, 4)])
def test_wrong_labels_of_rows_are_reported(noise, cycles):
    files = p45(noise, cycles)
    reversed_signs = replace(files[1], sign=-files[1].sign)
    check([files[0], reversed_signs, *files[2:]], "SIGN reversed", files[1].name)
    last = int(files[1].shape.max())
    counted = replace(files[1], shape=files[1].shape % last + 1)
    check([files[0], counted, *files[2:]], "SHAPE numbered from another start", files[1].name)


def test_a_dead_actuator_and_exchanged_poles_are_reported():
    random = np.random.default_rng(1)

    def silent(_, force):
        force[:, 16] = 1e-3 * random.standard_normal(len(force))
        return force

    check(with_forces(p45(1e-3, 4), silent), "dead", "actuator 17")
    poles = np.where(np.arange(45) == 20, -1.0, 1.0)
    files = with_forces(p45(1e-3, 4), lambda _, f: f * poles)
    assert "alpha is negative, the poles are exchanged: actuator 21" in messages(files)


@pytest.mark.parametrize(
    ("noise", "pair", "position"), [(1e-3, (15, 16), True), (5e-5, (2, 40), False)]
)
def test_exchanged_cables_are_reported(noise, pair, position):
    order = np.arange(45)
    order[list(pair)] = pair[::-1]
    files = p45(noise, 4) if position else p45(noise, 4, position=None)
    files = with_forces(files, lambda _, f: f[:, order])
    check(files, "exchanged columns", str(pair[0] + 1), str(pair[1] + 1))


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
