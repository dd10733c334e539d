"""Bad rows are found, reported and rejected; sound rows are kept."""

from dataclasses import replace

import numpy as np
import pytest

from helpers.balanced import (
    LAYOUT,
    RING,
    arms_of,
    campaign_of,
    changed,
    exact_weights,
    noisy,
    p45_bench,
    rms_z,
    with_spike,
)
from truenewton.calibration.methods import calibrate
from truenewton.errors import TooManyOutliers
from truenewton.estimation import campaign_ml
from truenewton.estimation.paper.equations import squared_distances, standing_out
from truenewton.estimation.screening.screen import screen_campaign
from truenewton.statics.load import Load

SIGMA = 1e-3
EXACT = (Load("bare"), replace(RING, added_error=0.0))


def small(seed, **options):
    """Return a small campaign with 1 mN noise and exact weights, and its truth."""
    return campaign_of(seed, SIGMA, loads=EXACT, weight_error=0.0, **options)


def spiked(campaign, fraction, seed, low=20e-3, high=100e-3):
    """Return the campaign with spikes in a fraction of its rows, and {(cycle, row): ID}."""
    random, places = np.random.default_rng(seed), {}
    for k, cycle in enumerate(campaign.cycles):
        rows = random.permutation(len(cycle.time))[: round(fraction * len(cycle.time))]
        for row in rows.tolist():
            actuator = int(random.choice(np.flatnonzero(cycle.layout.enabled)))
            size = random.choice([-1, 1]) * random.uniform(low, high)
            campaign = with_spike(campaign, k, row, actuator, size)
            places[k, row] = int(cycle.layout.id[actuator])
    return campaign, places


def rows_of(found):
    return {(row.cycle, row.row) for row in found.rejected_rows}


def test_spikes_in_5_percent_of_rows_increase_errors_by_less_than_10_percent():
    """The noise is the same with and without spikes, which makes the ratio precise."""
    quiet, alpha = exact_weights(replace(p45_bench(), force_noise=0.0)), p45_bench().truth.alpha
    clean, dirty, missed, wrong, named = [], [], 0, 0, 0
    for seed in range(5):
        sound = noisy(quiet, SIGMA, [1, seed])
        bad, places = spiked(sound, 0.05, [2, seed])
        found = calibrate(bad)
        clean.append(np.mean((calibrate(sound).alpha - alpha) ** 2))
        dirty.append(np.mean((found.alpha - alpha) ** 2))
        rejected = {(row.cycle, row.row): row for row in found.rejected_rows}
        missed += len(places.keys() - rejected.keys())
        wrong += len(rejected.keys() - places.keys())
        named += sum(rejected[k].actuator == places[k] for k in places.keys() & rejected.keys())
        assert all(row.sigmas > 3 for row in found.rejected_rows)
    assert np.sqrt(np.mean(dirty) / np.mean(clean)) < 1.10
    spikes = 5 * 8 * 4  # a twentieth of 90 rows: 4 of each cycle
    assert missed == 0
    assert wrong <= 0.02 * spikes
    assert named > 0.98 * (spikes - missed)


@pytest.mark.parametrize(
    ("cycles", "campaigns"), [(1, 50), pytest.param(2, 300, marks=pytest.mark.study)]
)
def test_the_false_rejection_rate_is_as_stated(cycles, campaigns):
    """There are two tests at 1 % each; the tolerance is three sigma."""
    sound = (screen_campaign(small([3, k], cycles=cycles)[0]) for k in range(campaigns))
    lost = sum(bool(campaign_ml.fit_campaign(one, population=False).rejected_rows) for one in sound)
    assert lost <= 0.02 * campaigns + 3 * np.sqrt(0.02 * campaigns)


def test_a_rejected_row_is_reported_with_its_actuator_and_distance():
    campaign, _ = small(5, cycles=4)
    [row] = calibrate(with_spike(campaign, 6, 17, 3, 0.05)).rejected_rows
    assert (row.cycle, row.row, row.actuator, row.against) == (6, 17, 4, "repeats")
    # At most 50 mN / (1 mN root(1 + 1 / 3)); less, as the spike increases the estimated noise.
    assert 10 < row.sigmas < 60
    campaign, _ = small(6, cycles=2)  # if two rows disagree, both are rejected
    rows = calibrate(with_spike(campaign, 1, 4, 9, 0.05)).rejected_rows
    assert sorted((r.cycle, r.row, r.actuator) for r in rows) == [(0, 4, 10), (1, 4, 10)]


def test_frequent_spikes_of_an_actuator_are_not_taken_for_its_noise():
    """Equal spikes in a tenth of the rows increase the scatter to 15 times the noise."""
    campaign, truth = small(17, cycles=4)
    random, spikes = np.random.default_rng(18), set()
    for k in range(8):
        for row in random.permutation(28)[:3].tolist():
            campaign = with_spike(campaign, k, row, 5, 0.05)
            spikes.add((k, row))
    found = calibrate(campaign)
    assert rows_of(found) >= spikes
    assert found.rejected <= len(spikes) + 6  # if two of three repeats are bad, all may be rejected
    assert rms_z(found, truth[:14]) < 2.5


@pytest.mark.parametrize(
    ("declared", "low", "high"),
    [
        pytest.param(None, 0.02, 0.2, marks=pytest.mark.study),
        pytest.param(None, 0.1, 0.5, marks=pytest.mark.study),
        (SIGMA, 0.1, 0.5),
    ],
)
def test_the_start_is_robust_against_10_percent_of_bad_rows(declared, low, high):
    """Campaigns of one cycle have no repeats. Errors hardly increase."""
    clean, dirty = [], []
    for seed in range(6):
        campaign, truth = small([7, seed], cycles=1)
        campaign = changed(campaign, force_error=declared)
        bad, places = spiked(campaign, 0.10, [8, seed], low, high)
        found = calibrate(bad)
        assert rows_of(found) >= set(places)
        assert found.rejected <= len(places) + 2
        assert {row.against for row in found.rejected_rows} == {"balance"}
        assert rms_z(found, truth[:14]) < 2.5
        clean.append(np.mean((calibrate(campaign).alpha - truth[:14]) ** 2))
        dirty.append(np.mean((found.alpha - truth[:14]) ** 2))
    # Losing a tenth of 56 shapes increases the rms error by 13 % (5 % with many shapes).
    assert np.sqrt(np.mean(dirty) / np.mean(clean)) < 1.3


def test_a_row_that_is_wrong_in_all_repeats_is_found_by_the_balance():
    """The spike is the same in all repeats, so that readings agree but do not balance."""
    campaign, truth = small(9, cycles=4)
    for k in (4, 5, 6, 7):  # all under the ring
        campaign = with_spike(campaign, k, 8, 12, 0.1)
    found = calibrate(campaign)
    assert {(r.cycle, r.row, r.against) for r in found.rejected_rows} == {
        (k, 8, "balance") for k in (4, 5, 6, 7)
    }
    assert rms_z(found, truth[:14]) < 2.5


def test_too_many_bad_rows_are_refused_with_their_number():
    campaign, _ = small(12, cycles=4)
    bad, _ = spiked(campaign, 0.4, 13, low=0.05, high=0.2)
    with pytest.raises(TooManyOutliers) as refused:
        calibrate(bad)
    assert f"of {8 * 28} rows" in refused.value.fault


def test_sums_exclude_rejected_rows():
    campaign, _ = small(4, cycles=5)
    for k in range(10):  # from below the noise to larger than all forces
        campaign = with_spike(campaign, k, 3 * k, k, 10.0 ** (k - 4))
    screened, made = screen_campaign(campaign), calibrate(campaign)
    assert len(screened.rejected) == made.rejected >= 6
    for k, (one, other) in enumerate(zip(campaign.cycles, screened.sound.cycles, strict=True)):
        lost = [row.row for row in screened.rejected if row.cycle == k]
        assert np.flatnonzero(one.valid & ~other.valid).tolist() == sorted(lost)
    assert screened.moments.rows.sum() == 10 * 28 - made.rejected
    rest = calibrate(screened.sound)
    assert made.alpha == pytest.approx(rest.alpha, rel=1e-12)
    assert made.statistical_error == pytest.approx(rest.statistical_error, rel=1e-10)
    assert (rest.rejected, rest.invalid) == (0, made.rejected)


def test_distances_and_the_most_deviating_actuator():
    arms, random = arms_of(LAYOUT), np.random.default_rng(16)
    s, weight = (arms * 1e-6) @ arms.T, random.uniform(1, 4, 14)
    rho = (0.05 * np.eye(14)) @ arms.T  # a spike of each actuator in turn
    expected = [w * r @ np.linalg.solve(s, r) for w, r in zip(weight, rho, strict=True)]
    assert squared_distances(rho, weight, s) == pytest.approx(expected, rel=1e-12)
    assert standing_out(rho, arms, s).tolist() == list(range(14))
