"""Moments equal those of loops over the rows, for any order of rows."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from helpers.balanced import campaign_of, changed
from truenewton import arrays
from truenewton.estimation.readings.rows import row_weights, rows_of
from truenewton.estimation.screening.screen import campaign_moments
from truenewton.records.campaign import Campaign


@cache
def noisy():
    """Return three cycles per load with 1 mN noise, a disabled actuator and two invalid rows."""
    return campaign_of(seed=1, noise=1e-3, cycles=3, disabled=(4,), invalid=(3, 20))[0]


def with_repeats_in_a_cycle():
    """Return a campaign in which shape 2 is labelled 1: four rows of shape 1 in each cycle."""
    return changed(noisy(), shape=lambda _, c: np.where(c.shape == 2, 1, c.shape))


def with_noises(campaign, errors):
    """Return a campaign whose cycles declare these values of FORCERR in turn."""
    return changed(campaign, force_error=lambda k, _: errors[k % len(errors)])


def grouped(campaign, weights):
    """Return {(load, shape, sign): [(weight, force)]} by a loop over the rows."""
    groups = {}
    for cycle, place, w in zip(campaign.cycles, campaign.load_index, weights, strict=True):
        for row in np.flatnonzero(cycle.valid):
            label = (place, int(cycle.shape[row]), int(cycle.sign[row]))
            groups.setdefault(label, []).append((w, cycle.force[row][cycle.layout.enabled]))
    return groups


def two_passes(campaign, weights):
    """Return labels, rows, weight, mean and scatter by loops over groups."""
    groups, mean, scatter = grouped(campaign, weights), [], 0.0
    labels = sorted(groups)
    for label in labels:
        w, force = (np.array(v) for v in zip(*groups[label], strict=True))
        mean.append(w @ force / w.sum())
        scatter = scatter + w @ (force - mean[-1]) ** 2
    rows = [len(groups[k]) for k in labels]
    weight = [sum(w for w, _ in groups[k]) for k in labels]
    return labels, rows, weight, np.array(mean), scatter


def check(moments, labels, rows, weight, mean, scatter):
    assert moments.labels.tolist() == [list(k) for k in labels]
    assert moments.rows.tolist() == list(rows)
    assert moments.weight == pytest.approx(np.asarray(weight), rel=1e-13)
    assert moments.mean == pytest.approx(mean, rel=1e-12, abs=1e-14)
    assert moments.scatter == pytest.approx(scatter, rel=1e-10)


def in_any_order():
    """Return a campaign with rows in a different random order in each cycle, three omitted."""
    random, names = np.random.default_rng(2), ("shape", "sign", "force", "valid")

    def shuffled(cycle):
        order = random.permutation(len(cycle.shape))[:-3]
        rows = {name: getattr(cycle, name)[order] for name in names}
        return replace(cycle, **rows, time=cycle.time[:-3])

    return Campaign(tuple(map(shuffled, noisy().cycles)))


@pytest.mark.parametrize(
    ("made", "weights"),
    [
        (noisy, [1.0] * 6),
        (with_repeats_in_a_cycle, [1.0] * 6),
        (in_any_order, [1.0] * 6),
        (lambda: with_noises(noisy(), [1e-3, 2e-3, 5e-4]), [1.0, 0.25, 4.0] * 2),
    ],
    ids=["plain", "repeated", "in any order", "of unequal noise"],
)
def test_moments_equal_those_of_two_passes(made, weights):
    campaign = made()
    moments = campaign_moments(campaign)
    check(moments, *two_passes(campaign, weights))
    assert moments.mean.shape[1] == 13
    assert moments.rows.sum() == sum(c.valid.sum() for c in campaign.cycles)


@pytest.mark.parametrize("block", [800, 2**24])
def test_means_add_rows_in_their_order_to_the_last_bit(monkeypatch, block):
    monkeypatch.setattr(arrays, "BLOCK_BYTES", block)
    campaign = with_noises(with_repeats_in_a_cycle(), (1e-4, 3e-4))
    weights = row_weights(campaign)
    rows = rows_of(campaign)
    for label, mean in zip(rows.labels.tolist(), rows.mean, strict=True):
        parts, total, heaviest = grouped(campaign, weights)[tuple(label)], 0.0, max(weights)
        for weight, force in parts:
            total = total + (weight / heaviest) * force
        assert np.array_equal(mean, total * (heaviest / sum(weight for weight, _ in parts)))
