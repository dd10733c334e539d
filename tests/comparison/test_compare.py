"""What changed between two matrices of one mirror: simulated pairs with known changes."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import scipy.linalg
from bokeh.models import Label

import truenewton as tn
from studies.comparison import LAWS, SCATTER, pair, with_glass
from studies.matrices import measured_or_made, true_stiffness
from studies.simulated_matrices import without_modes
from truenewton.comparison.summary import lines
from truenewton.errors import CampaignMismatch, FormatError, RankDeficient
from truenewton.estimation.findings.code import Code, Level
from truenewton.linalg import symmetrised
from truenewton.records.campaign import Campaign
from truenewton.report.page.views import change_views

MATRIX = measured_or_made("p45")
EXACT = true_stiffness(MATRIX)
OLD, NEW, RATIOS, FOUR = pair(MATRIX, EXACT, 2, "equal", changed=False)


def with_elements(change):
    """Return the new matrix with its elements changed in place."""
    k = NEW.stiffness.copy()
    change(k)
    return replace(NEW, stiffness=k)


@pytest.mark.parametrize("law", LAWS)
def test_changes_are_found_with_errors_that_hold(law):
    old, new, ratios, four = pair(MATRIX, EXACT, 12, law, changed=True)
    c = tn.compare(old, new)
    assert {*np.flatnonzero(c.alpha_changed)} == {*four[:2]}
    assert {*np.flatnonzero(c.sensor_changed)} == {*four[2:]}
    for ratio, error, true, changed in (
        (c.alpha_ratio, c.alpha_ratio_error, ratios[0], c.alpha_changed),
        (c.sensor_ratio, c.sensor_ratio_error, ratios[1], c.sensor_changed),
    ):
        true = true / np.exp(np.log(np.abs(true[~changed])).mean())
        assert 0.6 < np.sqrt(np.mean((ratio - true) ** 2 / error**2)) < 1.4
        assert np.abs(ratio - true).max() < 5e-3
    assert c.verdict.level is Level.SOUND


def test_without_a_change_none_is_named():
    c = tn.compare(OLD, NEW)
    assert not c.alpha_changed.any()
    assert not c.sensor_changed.any()
    assert c.couplings == ()
    mean = np.exp(np.log(RATIOS).mean(axis=1).sum())
    assert abs(c.common - mean) < 4 * c.common_error


def test_two_changes_of_six_times_the_scatter_do_not_hide_each_other():
    def change(k):
        k[[3, 30]] *= (RATIOS[0, [3, 30]] / (1.0 - 6 * SCATTER[0]))[:, None]

    c = tn.compare(OLD, with_elements(change))
    assert [*np.flatnonzero(c.alpha_changed)] == [3, 30]


def test_other_order_and_a_missing_actuator_change_nothing():
    whole = tn.compare(OLD, NEW)
    kept = np.random.default_rng(1).permutation(45)
    kept = kept[kept != 7]
    flexibility = np.linalg.inv(NEW.stiffness)[np.ix_(kept, kept)]  # actuator 8 exerts no force
    part = replace(NEW, stiffness=np.linalg.inv(flexibility), layout=NEW.layout.part(kept))
    c = tn.compare(OLD, part)
    assert c.matching.only_old == (8,)
    assert np.flatnonzero(np.isnan(c.alpha_ratio)) == [7]
    apart = np.delete(np.log(c.alpha_ratio / whole.alpha_ratio), 7)
    assert np.abs(apart - apart.mean()).max() < 6e-4
    assert not c.alpha_changed.any()


@pytest.mark.parametrize(("axis", "name"), [(0, "exchanged_rows"), (1, "exchanged_columns")])
def test_exchanged_cables_are_recognised(axis, name):
    order = np.arange(45)
    order[[4, 9]] = 9, 4
    c = tn.compare(OLD, replace(NEW, stiffness=np.take(NEW.stiffness, order, axis=axis)))
    assert getattr(c.matching, name) == ((5, 10), (10, 5))
    assert np.allclose(c.alpha_ratio, tn.compare(OLD, NEW).alpha_ratio, rtol=1e-6)


def test_couplings_that_changed_by_themselves_are_named():
    def change(k):
        k[3, 11] *= 1.2
        k[20, 20] *= 1.05

    c = tn.compare(OLD, with_elements(change))
    assert {each[:2] for each in c.couplings} == {(4, 12), (21, 21)}
    assert np.allclose(c.alpha_ratio, tn.compare(OLD, NEW).alpha_ratio, rtol=5e-4)


def test_a_row_of_noise_is_left_out():
    def change(k):
        k[5] = 1e4 * np.random.default_rng(1).standard_normal(45)

    c = tn.compare(OLD, with_elements(change))
    assert c.matching.lost_rows == (6,)
    assert not c.alpha_changed.any()


def test_a_cleaned_matrix_is_doubtful():
    rigid = np.linalg.qr(np.stack([np.ones(45), MATRIX.layout.x, MATRIX.layout.y], axis=1))[0]
    cleaned = NEW.stiffness - rigid @ (rigid.T @ NEW.stiffness)
    c = tn.compare(OLD, replace(NEW, stiffness=cleaned))
    assert c.verdict.level is Level.DOUBTFUL
    assert c.verdict.faults[0].code is Code.PAIR_PATTERN


def test_glass_of_another_thickness_is_doubtful():
    later = with_glass(EXACT, 0.02 * MATRIX.layout.x / MATRIX.layout.x.max())
    c = tn.compare(*pair(MATRIX, EXACT, 2, "equal", changed=False, later=later)[:2])
    assert [each.code for each in c.verdict.faults] == [Code.PAIR_GLASS]


@pytest.mark.parametrize("seed", [91201, 91202, 91203])
def test_another_unit_is_doubtful_and_a_repair_of_many_actuators_is_sound(seed):
    random = np.random.default_rng(seed)
    coils = random.uniform(0.95, 1.05, (2, 45))
    repaired = np.ones(45)
    five = random.choice(45, 5, replace=False)
    repaired[five] += random.uniform(0.05, 0.2, 5) * random.choice([-1.0, 1.0], 5)
    unit, repair = (
        tn.compare(*pair(MATRIX, EXACT, seed, LAWS[seed % 5], changed=False, later=later)[:2])
        for later in (EXACT * (coils[0] / coils[1])[:, None], EXACT * repaired[:, None])
    )
    assert unit.verdict.level is Level.DOUBTFUL
    assert unit.verdict.faults[0].code is Code.PAIR_UNITS
    assert "the stated changes or their errors may be wrong" in "\n".join(lines(unit))
    assert repair.verdict.level is Level.SOUND
    assert {*np.flatnonzero(repair.alpha_changed)} == {*five}


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda k: k.T, "transposed"),
        (lambda k: -k, "opposite signs"),
        (lambda k: OLD.stiffness.astype(np.float32).astype(float), "computed from the other"),
        (lambda k: symmetrised(k.copy()), "symmetric"),
        (lambda k: k[np.random.default_rng(0).permutation(45)], "another order"),
        (lambda k: np.roll(k, (9, 9), axis=(0, 1)), "resemble none"),
        (lambda k: without_modes(k, slice(-5, None)), "new matrix lacks 5 modes"),
    ],
)
def test_matrices_that_cannot_be_compared_are_refused(change, words):
    with pytest.raises(CampaignMismatch, match=words):
        tn.compare(OLD, replace(NEW, stiffness=change(NEW.stiffness)))


@cache
def campaigns():
    """Return campaigns before and after a change of two actuators and of one sensor."""
    bench = tn.static_bench(tn.mirrors.p45(), seed=3)
    alpha, gain = bench.truth.alpha.copy(), bench.sensors.gain.copy()
    alpha[3] *= 0.85
    alpha[7] *= -1.0
    gain[20] /= 1.03
    truth = replace(bench.truth, alpha=alpha, seed=4)
    later = replace(bench, truth=truth, sensors=replace(bench.sensors, gain=gain))
    return tuple(Campaign(tuple(tn.run_cycles(each, 1))) for each in (bench, later))


@pytest.mark.parametrize("noise", [0.0, 5e-4])
def test_two_campaigns_or_a_matrix_and_a_campaign_show_what_changed(noise):
    old, new = campaigns()
    if noise:  # the matrix of the day of the old campaign
        old = tn.measured_stiffness(old).matrix
        random = np.random.default_rng(1).standard_normal(old.stiffness.shape)
        old = replace(old, stiffness=old.stiffness + noise * old.stiffness.std() * random)
    c = tn.compare(old, new)
    assert [*c.layout.id[c.alpha_changed]] == [4, 8]
    assert [*c.layout.id[c.sensor_changed]] == [21]
    for ratio, error, changed in (
        (c.alpha_ratio, c.alpha_ratio_error, c.alpha_changed),
        (c.sensor_ratio, c.sensor_ratio_error, c.sensor_changed),
    ):
        sigmas = (ratio - 1.0)[~changed] / error[~changed]
        assert 0.6 < np.std(sigmas) < 1.4
        assert np.median(error) < 4e-4
    assert c.noise_law == ("elements and shapes" if noise else "shapes")
    assert [each.code for each in c.verdict.faults] == ([Code.PAIR_ROWS] if noise else [])


def test_a_campaign_of_few_shapes_is_refused():
    old, new = campaigns()
    few = Campaign(tuple(replace(cycle, valid=cycle.shape <= 20) for cycle in new.cycles))
    with pytest.raises(RankDeficient, match="new data: 25 of 42 elastic motions are missing"):
        tn.compare(old, few)


def test_with_a_repeat_the_errors_rest_on_its_scatter():
    """A change of the glass that the noise of one pair may explain is flagged."""
    random = np.random.default_rng(5)

    def measured(k):
        noise = 5e-4 * k * random.standard_normal(k.shape)
        return replace(MATRIX, stiffness=k + noise)

    stiffer = EXACT * np.exp(1e-3 * symmetrised(random.standard_normal(EXACT.shape)))
    old, repeat, new = measured(EXACT), measured(EXACT), measured(stiffer)
    same, other = (
        tn.compare(old, measured(EXACT), repeat=repeat),
        tn.compare(old, new, repeat=repeat),
    )
    assert same.verdict.level is Level.SOUND
    assert same.excess == pytest.approx(1.0, abs=0.1)
    assert tn.compare(old, new).verdict.level is Level.SOUND
    assert Code.PAIR_EXCESS in {each.code for each in other.verdict.faults}
    assert np.median(other.alpha_ratio_error / same.alpha_ratio_error) > 1.3
    assert tn.compare(new, old, repeat=repeat).excess == pytest.approx(other.excess, rel=0.05)


def test_each_segment_is_compared_as_if_alone(tmp_path, inside):
    pairs = pair(MATRIX, EXACT, 12, "equal", changed=True), (OLD, NEW)
    layout = tn.layout(
        np.concatenate([MATRIX.layout.x, MATRIX.layout.x + 1.0]),
        np.tile(MATRIX.layout.y, 2),
        segment=np.repeat([1, 2], 45),
    )
    paths = [tmp_path / name for name in ("old.fits", "new.fits")]
    for k, path in enumerate(paths):
        both = scipy.linalg.block_diag(*(each[k].stiffness for each in pairs))
        tn.write_stiffness(replace(MATRIX, layout=layout, stiffness=both), path)
    said = inside.prints("compare", *paths, "-o", tmp_path / "change.fits")
    assert "segment 1\nP45 segment 1: 45 actuators compared" in said
    one, other = (tn.read_comparison(tmp_path / f"change-{number}.fits") for number in (1, 2))
    assert (one.changed.sum(), other.changed.sum()) == (4, 0)
    assert np.allclose(other.alpha_ratio, tn.compare(OLD, NEW).alpha_ratio)


def test_a_comparison_can_be_read_again(tmp_path):
    order = np.arange(45)
    order[[4, 9]] = 9, 4
    c = tn.compare(OLD, replace(NEW, stiffness=NEW.stiffness[order]))
    c.write(tmp_path / "change.fits")
    assert tn.read_comparison(tmp_path / "change.fits").summary() == c.summary()
    with pytest.raises(FormatError, match="what `compare` wrote"):
        tn.read(tmp_path / "change.fits")


def test_the_command_prints_and_writes(tmp_path, inside):
    old, new = tmp_path / "old.fits", tmp_path / "new.fits"
    changed = pair(MATRIX, EXACT, 12, "equal", changed=True)
    tn.write_stiffness(changed[0], old)
    tn.write_stiffness(changed[1], new)
    table = tmp_path / "changes.csv"
    assert "alpha changed" in inside.prints("compare", old, new, "-o", table)
    assert len(table.read_text(encoding="utf-8").splitlines()) == 46
    page = tmp_path / "changes.html"
    assert inside("report", old, new, "-o", page)[1].startswith("Sound. 4 of 45 actuators changed.")
    by_ring = change_views(tn.compare(*changed[:2])).views[1].plot
    [label] = by_ring.select({"type": Label})
    assert label.text == f"▼ {MATRIX.layout.id[changed[3][1]]}: -200 %"  # the reversed coil
    assert -25.0 < by_ring.y_range.start < -15.0  # below the coil that lost 15 %
    shown = page.read_text(encoding="utf-8")
    assert "change of sensor gain" in shown


def test_the_report_compares_two_folders_of_campaigns(tmp_path, inside):
    folders = [tmp_path / "old", tmp_path / "new"]
    for folder, campaign in zip(folders, campaigns(), strict=True):
        tn.write_campaign(list(campaign), folder)
    out = inside.prints("report", *folders, "-o", tmp_path / "changes.html")
    assert out.startswith("Sound. 3 of 45 actuators changed.")
    assert "Alpha changed: actuators 4 and 8." in out
    assert "Sensor gain changed: actuator 21." in out
