"""What only the user can settle: labels, copies, cables, actuators that are not what they say."""

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


def said(cycles):
    """Return what is said of cycles; of a refusal the refusal."""
    try:
        found = tn.calibrate(Campaign(tuple(cycles)))
    except TrueNewtonError as error:
        return [error.fault]
    return [f"{effect.name}: {effect.where}" for effect in found.effects]


def named(cycles, *words):
    """Assert that words are said together."""
    texts = said(cycles)
    assert any(all(word in text for word in words) for text in texts), texts


@pytest.mark.parametrize(("noise", "cycles", "at"), [(1e-3, 2, 1), (5e-5, 4, -1)])
def test_a_file_under_another_name_is_named(noise, cycles, at):
    files = p45(noise, cycles)
    files[at] = replace(files[at], load=files[-1 - at].load, number=9)
    named(files, "wrong LOAD", f"{files[at].load.name} 9")


@pytest.mark.parametrize("noise", NOISE)
def test_a_copy_is_named_in_whole_or_in_part(noise):
    files = p45(noise, 4)
    whole = replace(files[1], force=files[0].force)
    named([files[0], whole, *files[2:]], "copy", files[1].name)
    force = np.array(files[1].force)
    force[: len(force) // 2] = np.asarray(files[0].force)[: len(force) // 2]
    named([files[0], replace(files[1], force=force), *files[2:]], "copy", files[1].name)
    assert not any("copy" in text for text in said(p45(0.0, 4)))


@pytest.mark.parametrize(("noise", "cycles"), [(1e-3, 2), (5e-5, 4)])
def test_labels_of_rows_are_named(noise, cycles):
    files = p45(noise, cycles)
    reversed_signs = replace(files[1], sign=-files[1].sign)
    named([files[0], reversed_signs, *files[2:]], "SIGN reversed", files[1].name)
    last = int(files[1].shape.max())
    counted = replace(files[1], shape=files[1].shape % last + 1)
    named([files[0], counted, *files[2:]], "SHAPE numbered from another start", files[1].name)


def test_a_dead_actuator_and_exchanged_poles_are_named():
    random = np.random.default_rng(1)

    def silent(_, force):
        force[:, 16] = 1e-3 * random.standard_normal(len(force))
        return force

    named(with_forces(p45(1e-3, 4), silent), "dead", "actuator 17")
    poles = np.where(np.arange(45) == 20, -1.0, 1.0)
    files = with_forces(p45(1e-3, 4), lambda _, f: f * poles)
    assert "alpha is negative, the poles are exchanged: actuator 21" in said(files)


@pytest.mark.parametrize(
    ("noise", "pair", "position"), [(1e-3, (15, 16), True), (5e-5, (2, 40), False)]
)
def test_exchanged_cables_are_named(noise, pair, position):
    order = np.arange(45)
    order[list(pair)] = pair[::-1]
    files = p45(noise, 4) if position else p45(noise, 4, position=None)
    files = with_forces(files, lambda _, f: f[:, order])
    named(files, "exchanged columns", str(pair[0] + 1), str(pair[1] + 1))


def test_no_order_is_likelier_than_that_of_a_stiffness_whatever_the_gains():
    random = np.random.default_rng(2)
    root = random.standard_normal((20, 17))
    stiffness = root @ root.T
    gains = random.uniform(0.5, 2.0, (2, 20)) * random.choice([-1.0, 1.0], (2, 20))
    order = random.permutation(20)
    assert np.array_equal(likeliest_order((gains[0, :, None] * stiffness * gains[1])[order]), order)


def test_clusters_are_as_many_as_loads_or_none():
    at = np.array([0.0, 0.1, 1.0, 1.05, 0.05])
    assert clusters(np.abs(at[:, None] - at), 2).tolist() == [0, 0, 1, 1, 0]
    at = np.array([0.0, 0.3, 0.6, 1.0])
    assert clusters(np.abs(at[:, None] - at), 2) is None


@pytest.mark.parametrize("n", [2, 4, 6])
def test_it_is_the_cheapest_of_all(n):
    random = np.random.default_rng(n)
    for cost in random.normal(size=(40, n, 6)):
        every = [cost[np.arange(n), order].sum() for order in itertools.permutations(range(6), n)]
        made = assignment(cost)
        assert len(set(made)) == n
        assert cost[np.arange(n), made].sum() == pytest.approx(min(every), abs=1e-12)
