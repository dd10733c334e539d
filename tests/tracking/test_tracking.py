"""How alpha varies with temperature and time: what is found, and what is refused."""

import dataclasses
import datetime
import json

import numpy as np
import pytest
import scipy.optimize
import scipy.stats

import truenewton as tn
from helpers.tracked import (
    MEAN_K,
    SPREAD_K,
    TEMPERATURES,
    days_of,
    drawn,
    pattern,
    quiet_cycles,
)
from truenewton.errors import CampaignMismatch, FormatError, RankDeficient
from truenewton.records.cycle import Source
from truenewton.statics.load import Load
from truenewton.tracking.days import DatedCalibration, covariances, weight_groups
from truenewton.tracking.figures import plot_law, plot_population, tracking_figures
from truenewton.tracking.law import validity_of
from truenewton.tracking.lines import linear_fit, relative_days
from truenewton.tracking.population import fit_population, most_outlying, populations_from
from truenewton.tracking.summary import lines

K = np.random.default_rng(11).normal(MEAN_K, SPREAD_K, 45)
T_OF_3 = scipy.stats.t.isf(0.025, 3) / scipy.stats.norm.isf(0.025)
R = np.random.default_rng(12).normal(-4e-3, 1e-3, 45)


@pytest.fixture(scope="module")
def tracking():
    return tn.track(*drawn(1, K, R, gap=90.0))


# The population


def test_even_noise_gives_the_sample_variance_less_the_noise():
    y = np.random.default_rng(2).normal(-1.0, 0.3, 20)
    found = fit_population(y, 0.04 * np.eye(20), np.zeros(20, dtype=int))
    sample = y.var(ddof=1)
    assert found.variance[0] == pytest.approx(sample - 0.04, rel=1e-6)
    assert found.mean[0] == pytest.approx(y.mean(), rel=1e-12)
    [population] = populations_from(("temperature",), found, np.array([20]))
    assert population.mean_error == pytest.approx(np.sqrt(sample / 20), rel=1e-6)
    ends = 19 * sample / scipy.stats.chi2.isf([0.025, 0.975], 19)
    assert population.spread_interval == pytest.approx(np.sqrt(ends - 0.04), rel=1e-6)
    t = scipy.stats.t.isf(0.025, 19) * population.mean_error
    assert population.mean_interval == pytest.approx((y.mean() - t, y.mean() + t), rel=1e-6)


def test_two_effects_are_where_the_restricted_likelihood_is_largest():
    random = np.random.default_rng(5)
    root = random.standard_normal((24, 24)) / 5
    covariance = root @ root.T + 0.1 * np.eye(24)
    which = np.repeat([0, 1], 12)
    spreads = np.array([1.0, 2.0])[which]
    y = random.multivariate_normal(np.zeros(24), covariance + np.diag(spreads**2))
    found = fit_population(y, covariance, which)
    contrasts = np.kron(np.eye(2), scipy.linalg.null_space(np.ones((1, 12))))

    def off(variance):  # the density of contrasts, which know no mean
        v = contrasts.T @ (covariance + np.diag(np.asarray(variance)[which])) @ contrasts
        return -scipy.stats.multivariate_normal(cov=v).logpdf(contrasts.T @ y)

    best = scipy.optimize.minimize(off, [1.0, 4.0], method="Nelder-Mead", options={"xatol": 1e-9,
                                   "fatol": 1e-12, "maxiter": 4000})  # fmt: skip
    assert found.variance == pytest.approx(best.x, rel=1e-4)


def test_no_spread_beyond_the_noise_is_none():
    y = np.linspace(-0.01, 0.01, 12)
    found = fit_population(y, np.eye(12), np.zeros(12, dtype=int))
    assert found.variance[0] == 0.0
    [population] = populations_from(("drift",), found, np.array([12]))
    assert population.spread_interval[0] == 0.0


def test_a_stranger_is_judged_by_students_t_where_there_is_no_noise():
    y = np.append(np.random.default_rng(3).normal(0, 1, 29), 4.5)
    which, covariance = np.zeros(30, dtype=int), 1e-12 * np.eye(30)
    place, sigmas, chance = most_outlying(
        y, covariance, which, fit_population(y, covariance, which)
    )
    others = y[:29]
    # Even weight of all variances: Student's t with two degrees less than the others leave.
    squares = np.sum((others - others.mean()) ** 2)
    t = (4.5 - others.mean()) / np.sqrt(squares / 26 * (1 + 1 / 29))
    assert place == 29
    assert chance == pytest.approx(2 * scipy.stats.t.sf(t, 26), rel=0.05)
    assert sigmas == pytest.approx(scipy.stats.norm.isf(chance / 2))


# The lines


def test_lines_are_generalised_least_squares_with_weights_common_to_days():
    """Against all covariances in one matrix, and normal equations."""
    days = [DatedCalibration(str(k), c) for k, c in enumerate(drawn(4, K, R, scale=0.01))]
    other = tuple(dataclasses.replace(load, tool="ring B") for load in pattern().loads)
    days[4:] = [
        DatedCalibration(d.name, dataclasses.replace(d.calibration, loads=other)) for d in days[4:]
    ]
    assert weight_groups(days) == [[0, 1, 2, 3], [4, 5]]
    on = np.ones(45, dtype=bool)
    settings = np.column_stack([np.array(TEMPERATURES) - 18.0, 0.1 * np.arange(6) - 0.25])
    found = linear_fit(relative_days(days, on, settings), np.zeros(45))

    y = np.concatenate([d.calibration.alpha for d in days])
    x = np.kron(np.column_stack([np.ones(6), settings]), np.eye(45))
    whole = scipy.linalg.block_diag(*(covariances(d.calibration, on)[0] for d in days))
    law = x @ np.linalg.lstsq(x, y, rcond=None)[0]
    scale = np.sqrt(pattern().systematic_covariance[0, 0]) / pattern().alpha[0]
    for group in (slice(0, 4 * 45), slice(4 * 45, None)):
        change = np.zeros_like(y)
        change[group] = scale * law[group]
        whole += np.outer(change, change)
    weighed = np.linalg.solve(whole, x)
    inverse = np.linalg.inv(x.T @ weighed)
    a, b, c = (inverse @ weighed.T @ y).reshape(3, 45)
    assert found.alpha == pytest.approx(a, rel=1e-7)
    assert found.effects == pytest.approx(np.array([b, c]) / a, rel=1e-5)
    j = np.eye(135)
    at = np.arange(45)
    for k, values in ((1, b), (2, c)):
        j[45 * k + at, at], j[45 * k + at, 45 * k + at] = -values / a**2, 1 / a
    assert found.root @ found.root.T == pytest.approx(j @ inverse @ j.T, rel=1e-5, abs=1e-12)
    residual = y - x @ (inverse @ weighed.T @ y)
    assert found.chi2 == pytest.approx(residual @ np.linalg.solve(whole, residual), rel=1e-5)


def test_the_error_of_the_ring_cancels_from_the_coefficients_but_not_from_alpha():
    one, other = (tn.track(*drawn(6, K, R, scale=s)) for s in (0.0, 0.02))
    # Noise that stays as it is weighs 2 % less against a larger alpha.
    assert np.abs(other.coefficient - one.coefficient).max() < 0.1 * one.errors[1].min()
    assert other.alpha / one.alpha == pytest.approx(1.02, rel=1e-3)
    relative = pattern().systematic_error / pattern().alpha
    stated = np.sqrt(np.diag(one.systematic_covariance)[:45]) / one.alpha
    assert stated == pytest.approx(relative, rel=1e-3)
    assert (
        np.abs(np.diag(one.systematic_covariance)[45:90]).max()
        < 1e-6 * np.diag(one.covariance)[45:90].min()
    )


# The law, from campaigns through the estimator


def test_coefficients_of_simulated_campaigns_come_out_within_their_covariance():
    found = tn.track(*days_of(1, K, R, gap=90.0))
    n = 45
    for place, truth, told in ((1, K, found.coefficient), (2, R, found.drift / found.alpha)):
        part = slice(place * n, (place + 1) * n)
        whole = found.covariance[part, part]
        if place == 2:
            whole = whole / np.outer(found.alpha, found.alpha)
        distance = (told - truth) @ np.linalg.solve(whole, told - truth)
        assert n - 5 * np.sqrt(2 * n) < distance < n + 5 * np.sqrt(2 * n)
    assert found.effects == ("temperature", "drift")
    assert found.outliers == ()
    assert found.probability > 1e-4
    # Every day's truth is predicted, the ring's true weight apart.
    truth = quiet_cycles()[1]
    for t in (10.0, 25.0):
        predicted = found.alpha_at(t, found.days[0].date)
        off = predicted.alpha - truth * (1 + K * (t - 18.0))
        assert np.mean(np.abs(off) < 1.96 * predicted.error) > 0.8


def test_the_family_pulls_what_the_days_hardly_hold(tracking):
    days = [DatedCalibration("", c) for c in drawn(1, K, R, gap=90.0)]
    settings = np.column_stack([np.array(TEMPERATURES) - 18.0, 90 * np.arange(6) / 365.25])
    relative = relative_days(days, np.ones(45, dtype=bool), settings)
    alone = linear_fit(relative, np.zeros(45)).effects[0]
    pooled = tracking.coefficient
    assert np.mean((pooled - K) ** 2) < np.mean((alone - K) ** 2)
    population = tracking.populations[0]
    assert population.mean_interval[0] < MEAN_K < population.mean_interval[1]
    assert population.spread_interval[0] < SPREAD_K < population.spread_interval[1]


# Who leaves the family


def test_who_leaves_by_temperature_by_drift_or_by_a_jump_is_named_and_drawn():
    k, r = K.copy(), R.copy()
    k[[4, 5]] += 3e-3  # two at once, so that one could hide behind the other
    r[20] += 0.03
    days = drawn(7, k, r, gap=90.0)
    jump = np.where(np.arange(45) == 40, 1.03, 1.0)
    days[2] = dataclasses.replace(days[2], alpha=days[2].alpha * jump)
    found = tn.track(*days)
    named = {(one.actuator, one.effect) for one in found.outliers}
    assert named == {(5, "temperature"), (6, "temperature"), (21, "drift"), (41, "line")}
    assert all(one.probability < 0.01 for one in found.outliers)
    assert found.populations[0].members == 42
    assert np.abs(found.coefficient - k)[[4, 5]].max() < 5 * found.errors[1].max()
    assert found.errors[0][40] > 3 * np.median(found.errors[1])  # its own scatter is allowed for
    kinds = ("temperature", "time", "population-temperature", "population-drift")
    assert set(tracking_figures(found)) == {f"track-{kind}" for kind in kinds}
    assert "21" in {text.get_text() for text in plot_law(found, "drift").texts}
    for ax in (plot_law(found, "temperature"), plot_population(found, "temperature")):
        assert "5" in {text.get_text() for text in ax.texts}
    assert "5" not in {text.get_text() for text in plot_population(found, "drift").texts}
    points = [line for line in plot_law(found, "temperature").lines if len(line.get_xdata()) == 6]
    slope = [np.polyfit(p.get_xdata(), p.get_ydata(), 1)[0] for p in points]
    assert np.median(slope) == pytest.approx(100 * np.median(found.coefficient), rel=0.1)


@pytest.mark.study
def test_nobody_leaves_in_quiet_families():
    alarms = [tn.track(*drawn(100 + seed, K, R, gap=90.0)).outliers for seed in range(20)]
    assert sum(map(bool, alarms)) <= 1  # 1 % of mirrors; two of twenty by chance: 1.7 %


# What can be said, and what cannot


def test_cycles_of_one_campaign_at_two_temperatures_are_calibrated_apart():
    cold, warm = days_of(8, K, temperatures=(12.0, 24.0), gap=0.0)
    warm = [dataclasses.replace(c, number=c.number + 10) for c in warm.cycles]
    found = tn.track(tn.Campaign((*cold.cycles, *warm)))
    assert [round(day.temperature) for day in found.days] == [12, 24]
    assert found.effects == ("temperature",)
    assert "drift is not determined" in found.limits[0]
    assert np.sqrt(np.mean((found.coefficient - K) ** 2)) < 2e-4
    apart = tn.track(cold, tn.Campaign(tuple(warm)))
    assert np.array_equal(apart.coefficient, found.coefficient)


def test_one_temperature_or_none_tells_drift_alone():
    found = tn.track(*drawn(9, K, R, gap=200.0, temperatures=(18.0, 18.2, 17.9)))
    assert found.effects == ("drift",)
    assert "the same temperature" in found.limits[0]
    assert (found.coefficient == 0).all()
    assert found.errors[1].max() == 0
    assert np.isfinite(found.alpha_at(18.5).alpha).all()
    with pytest.raises(RankDeficient, match="not known"):
        found.alpha_at(25.0)
    days = [dataclasses.replace(c, temperature=np.nan) for c in drawn(9, 0.0, R, gap=200.0)]
    found = tn.track(*days)
    assert found.effects == ("drift",)
    assert "effects of temperature" in found.limits[0]


def test_temperature_and_time_that_went_together_are_not_told_apart(tmp_path):
    """And the file holds that limit, and who leaves."""
    k = np.where(np.arange(45) == 4, 3e-3, K)
    found = tn.track(*drawn(7, k, temperatures=(12.0, 16.0, 20.0)))
    assert found.effects == ("temperature",)
    assert "changed together" in found.limits[0]
    with pytest.raises(RankDeficient, match="drift"):
        found.alpha_at(time=found.date + datetime.timedelta(days=400))
    found.write(tmp_path / "t.fits")
    back = tn.read_tracking(tmp_path / "t.fits")
    assert back.outliers == found.outliers != ()
    assert back.limits == found.limits


def test_an_actuator_that_was_disabled_on_a_day_is_left_out():
    days = drawn(10, K)
    alpha = np.where(np.arange(45) == 7, np.nan, days[0].alpha)
    layout = dataclasses.replace(days[0].layout, enabled=np.isfinite(alpha))
    days[0] = dataclasses.replace(days[0], alpha=alpha, layout=layout)
    found = tn.track(*days)
    assert np.flatnonzero(np.isnan(found.alpha)).tolist() == [7]
    assert "not enabled on every day: 1 actuator" in found.limits[-1]
    assert np.isnan(found.alpha_at(20.0).error[7])
    assert np.isfinite(validity_of(found, 0.01).now)


def test_what_cannot_be_tracked_is_refused():
    one, two = drawn(1, K)[:2]

    def refused(error, words, *given):
        with pytest.raises(error, match=words):
            tn.track(*given)

    refused(RankDeficient, "one calibration", one)
    refused(RankDeficient, "same date and temperature", one,
            dataclasses.replace(one, alpha=two.alpha))  # fmt: skip
    refused(CampaignMismatch, "of OTHER", one, dataclasses.replace(two, instrument="OTHER"))
    elsewhere = dataclasses.replace(two.layout, x=two.layout.x + 1e-3)
    refused(CampaignMismatch, "other actuators", one, dataclasses.replace(two, layout=elsewhere))
    refused(FormatError, "has no temperature", one, dataclasses.replace(two, temperature=np.nan))
    refused(FormatError, "relative to its mean", one, dataclasses.replace(two, scale="mean 1"))
    refused(FormatError, "earlier calibration", one, dataclasses.replace(two, scale="given"))
    source = (Source("a.fits", "f" * 64, 1, 0),)
    refused(CampaignMismatch, "same files", dataclasses.replace(one, sources=source),
            dataclasses.replace(two, sources=source))  # fmt: skip


def test_two_units_of_one_name_are_told_apart():
    days = drawn(1, K)
    other = [dataclasses.replace(day, alpha=np.roll(day.alpha, 7)) for day in days[3:]]
    with pytest.raises(CampaignMismatch, match="same mirror"):
        tn.track(*days[:3], *other)
    # Nor is it hidden by a day that is so noisy that it may be anything.
    noise = 1 + 0.25 * np.random.default_rng(4).standard_normal(45)
    wild = dataclasses.replace(
        days[1], alpha=days[1].alpha * noise, statistical_error=0.2 * days[1].alpha
    )
    with pytest.raises(CampaignMismatch, match="same mirror"):
        tn.track(days[0], wild, *other)


def test_a_load_that_lacks_at_one_temperature_is_named():
    cold, warm = days_of(8, K, temperatures=(12.0, 24.0), gap=0.0)
    bare = [dataclasses.replace(c, number=9) for c in warm.cycles if c.load.name == "bare"]
    with pytest.raises(RankDeficient, match=r"at 24\.0 deg C: there is only one load"):
        tn.track(tn.Campaign((*cold.cycles, *bare[:1])))


def test_days_share_the_error_of_a_weight_only_where_all_agrees():
    one, two = (DatedCalibration("", c) for c in drawn(1, K)[:2])
    assert weight_groups([one, two]) == [[0, 1]]
    for change in ({"tool": "another"}, {"added_error": 0.004}, {"added": -0.3}):
        loads = tuple(dataclasses.replace(load, **change) if load.added else load
                      for load in two.calibration.loads)  # fmt: skip
        other = DatedCalibration("", dataclasses.replace(two.calibration, loads=loads))
        assert weight_groups([one, other]) == [[0], [1]], change
    unnamed = tuple(dataclasses.replace(load, tool=None) for load in two.calibration.loads)
    assert weight_groups(
        [one, DatedCalibration("", dataclasses.replace(two.calibration, loads=unnamed))]
    ) == [[0, 1]]
    apart = tn.track(one.calibration, dataclasses.replace(two.calibration, loads=(
        Load("bare"), dataclasses.replace(two.calibration.loads[1], tool="another"))))  # fmt: skip
    together = tn.track(one.calibration, two.calibration)
    assert apart.populations[0].mean_error > 5 * together.populations[0].mean_error


# When to calibrate again


def test_a_calibration_serves_as_far_as_its_error_stays_below_what_is_wanted(tracking):
    wanted = 0.0025
    v, last = validity_of(tracking, wanted), tracking.days[-1]
    alpha, k = tracking.alpha, tracking.coefficient
    of_days = tracking.scatter[0] ** 2 + tracking.common_scatter**2 * T_OF_3**2
    now = np.mean((last.error / last.alpha) ** 2) + 2 * of_days
    assert v.now == pytest.approx(np.sqrt(now))
    for edge in v.temperatures:
        away = edge - last.temperature
        off = np.mean((k * away) ** 2 + (tracking.errors[1] * away) ** 2)
        assert np.sqrt(now + off) == pytest.approx(wanted, rel=1e-4)
    years = (v.until - last.date) / datetime.timedelta(days=365.25)
    off = np.mean(((tracking.drift / alpha) ** 2 + (tracking.errors[2] / alpha) ** 2) * years**2)
    assert np.sqrt(now + off) == pytest.approx(wanted, rel=1e-2)
    assert v.law_until > v.until


def test_a_law_is_promised_as_far_as_its_error_stays_below_what_is_wanted(tracking):
    wanted = 1e-3
    v, last = validity_of(tracking, wanted), tracking.days[-1]

    def of_law(temperature, time):
        at = tracking.alpha_at(temperature, time)
        variance = np.diag(at.covariance - at.systematic_covariance)
        return np.sqrt(np.mean(variance / tracking.alpha**2))

    low, high = v.law_temperatures
    assert low > 12.0
    assert of_law(low, last.date) == pytest.approx(wanted, rel=0.05)
    assert of_law(high, last.date) < wanted
    assert high == 24.0
    assert of_law(last.temperature, v.law_until) == pytest.approx(wanted, rel=0.05)


def test_nothing_is_promised_where_no_day_has_been(tracking):
    """12 to 24 deg C and 450 days do not tell of -31 and 70 deg C, nor of the next century."""
    v = validity_of(tracking, 0.5)
    assert v.temperatures == v.law_temperatures == (12.0, 24.0)
    first, last = tracking.days[0].date, tracking.days[-1].date
    assert v.until == v.law_until == last + (last - first)
    said = " ".join(lines(tracking, 0.5))
    assert "from 12.0 to 24.0 deg C (range of the data)" in said
    assert "(limit of extrapolation)" in said
    too_noisy = validity_of(tracking, 1e-5)
    assert too_noisy.now > 1e-5
    assert too_noisy.temperatures == (tracking.days[-1].temperature,) * 2
    assert too_noisy.until == last
    assert (too_noisy.law_temperatures, too_noisy.law_until) == (None, None)


# Files, figures, commands


def test_the_file_holds_all_and_serves_electronics(tracking, tmp_path):
    from astropy.io import fits

    tracking.write(tmp_path / "t.fits")
    with pytest.raises(FormatError, match="is a tracking file; give it to `recalibrate --known`"):
        tn.read(tmp_path / "t.fits")
    back = tn.read_tracking(tmp_path / "t.fits")
    assert validity_of(back, 0.004) == validity_of(tracking, 0.004)
    one, two = (t.alpha_at(14.0, t.days[2].date) for t in (tracking, back))
    assert np.array_equal(one.covariance, two.covariance)
    assert (back.populations, back.outliers, back.limits, back.effects) == (
        tracking.populations, tracking.outliers, tracking.limits, tracking.effects)  # fmt: skip
    with fits.open(tmp_path / "t.fits") as hdus:  # as electronics would, with nothing of ours
        table, head = hdus["TRACKING"].data, hdus[0].header
        years = (
            tracking.days[2].date.replace(tzinfo=None)
            - datetime.datetime.fromisoformat(head["DATE-REF"])
        ).total_seconds() / 31557600
        alpha = table["ALPHA"] * (1 + table["K"] * (14.0 - head["TEMPERAT"])) + (
            table["DRIFT"] * years)  # fmt: skip
        units = [hdus["TRACKING"].columns[name].unit for name in ("K", "DRIFT")]
    assert alpha == pytest.approx(one.alpha, rel=1e-12)
    assert units == ["1/K", "1/yr"]


def test_the_command_tells_people_and_scripts(inside, tmp_path):
    for place, calibration in enumerate(drawn(1, K, R, gap=90.0)):
        calibration.write(tmp_path / f"{place}.fits")
    files = sorted(tmp_path.glob("*.fits"))
    out = inside.prints("track", *files, "-o", tmp_path / "t.fits", "--accuracy", "0.004")
    for words in ("coefficient k, mean", "spread of actuators", "no outliers",
                  "valid to 0.4 % from", f"written: {tmp_path / 't.fits'}", "0.fits"):  # fmt: skip
        assert words in out
    assert "spread of actuators" in inside("info", tmp_path / "t.fits")[1]
    assert inside("track", *files, "-o", tmp_path / "t.fits")[0] == 2
    assert "--accuracy" in inside.refuses("track", *files, "--accuracy", "-1")
    code, out, _ = inside("track", *files, "--json", "--accuracy", "0.004", "-o",
                          tmp_path / "t.fits", "--overwrite")  # fmt: skip
    assert code == 0
    values = json.loads(out)
    assert values["effects"] == ["temperature", "drift"]
    assert values["families"][0]["mean"] == pytest.approx(MEAN_K, rel=0.2)
    assert len(values["actuators"]["k"]) == 45
    assert values["validity"]["until"].startswith("20")


def test_a_campaign_and_a_calibration_are_tracked_together(inside, tmp_path):
    one, two = days_of(3, K, temperatures=(12.0, 24.0))
    tn.write_campaign(one.cycles, tmp_path / "one")
    tn.calibrate(two).write(tmp_path / "two.fits")
    code, out, _ = inside("track", tmp_path / "one", tmp_path / "two.fits",
                          "--figures", tmp_path / "figures")  # fmt: skip
    assert code == 0
    kinds = {path.stem for path in (tmp_path / "figures").iterdir()}
    assert kinds == {"track-temperature", "track-population-temperature"}
    assert "one\n" in out
    assert "limit: Temperature and time changed together" in out
