"""Effects: derivatives by finite differences, significance of their tests, and corrections."""

import datetime
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import scipy.signal
import scipy.stats

from helpers.balanced import BIAS, campaign_of, changed, exact_weights, rms_z, with_spike
from helpers.small_bench import SmallBench
from truenewton.bench.simulated.static import static_bench
from truenewton.calibration.methods import calibrate
from truenewton.chance import OF_EACH_KIND
from truenewton.estimation.effects.catalogue import (
    CATALOGUE,
    effect_tests,
    removed,
    significant_tests,
)
from truenewton.estimation.effects.correction import unknown_force
from truenewton.estimation.effects.derivative import FittedRows, scored, variance_at_least
from truenewton.estimation.effects.examination import chi2_probability
from truenewton.estimation.effects.joint import correction
from truenewton.estimation.effects.score_test import log_chance, surely_sound
from truenewton.estimation.findings.catalogue import ENTRIES
from truenewton.estimation.findings.code import LIMITS, Code
from truenewton.estimation.problem import problem_of
from truenewton.estimation.readings.moments import reading_noise
from truenewton.estimation.screening.screen import campaign_moments, screen_campaign
from truenewton.linalg import mirrored
from truenewton.mirrors.known import p45
from truenewton.records.campaign import Campaign
from truenewton.statics.layout import rings
from truenewton.statics.load import Load

SIGMA = 1e-3
NAMES = [ENTRIES[effect.code].name for effect in CATALOGUE]
THREE = (0, 1, 0, 1, 2, 2, 0)
OF = dict(zip(NAMES, CATALOGUE, strict=True))
# Tested only if an actuator is an outlier.
SINGLE = {"gain of single actuators by file"}
AFFECTED = np.array([3, 9])


def fit_of(campaign, *, pooled=None):
    """Return the fit of a campaign without effects."""
    moments = screen_campaign(campaign).moments
    if pooled is not None:
        moments = replace(moments, pooled=pooled)
    problem = problem_of(campaign, reading_noise(campaign, moments))
    return FittedRows(problem, moments, problem.fitted(moments), independent=True)


# ----------------------------------------------------------------------------------- derivatives


@cache
def uneven(pooled):
    """Return a fit to a campaign of three loads with missing rows and one noisier file.

    It is far enough from the truth that no sum vanishes.
    """
    bench = SmallBench(1, SIGMA, order=THREE)
    bench.gain = 1 + 2e-3 * bench.hours[:, None]
    bench.zero = 1e-3 * bench.random.standard_normal((7, 14))[bench.file]
    missing = np.isin(np.arange(28), [2, 9, 10])
    campaign = changed(
        bench.campaign(),
        force_error=lambda k, _: 2e-3 if k == 2 else 1e-3,
        valid=lambda k, c: c.valid & ~(missing & (k == 3)),
    )
    return fit_of(campaign, pooled=pooled)


def affected(fit, name):
    """Return a fit in which two actuators are outliers, if the effect requires outliers."""
    return replace(fit, affected=AFFECTED) if name in SINGLE else fit


def without(fit, *effects):
    """Return problem and moments of a fit without effects, each with its parameters."""
    return removed(fit, (fit.problem, fit.moments), effects)


def balance(fit, problem, moments):
    """Return half of the chi^2 of the balance at the unknowns of the fit."""
    at = FittedRows(problem, moments, fit.minimum, fit.independent)
    return 0.5 * float(at.white_rho @ at.white_rho)


def structure(fit, moments):
    """Return half of the chi^2 of rows relative to their pooled means."""
    pooling = moments.pooling
    apart = moments.mean - pooling.groups(pooling.rows(moments.mean))
    return 0.5 * float(
        (moments.weight @ apart**2 + moments.scatter) @ (1.0 / fit.problem.noise.variance)
    )


def steps(fit, name, function):
    """Return first and second differences of a function of data, by each parameter removed.

    They are exact for a sum of squares. The step is a tenth of a standard error.
    """
    derivative = OF[name].derivative(affected(fit, name))
    result = scored(fit, derivative)
    h = 0.1 / np.sqrt(np.maximum(result.whole, 1e-300))
    first, second = np.empty((2, len(h)))
    middle = function(*without(fit, (derivative, np.zeros(len(h)))))
    for k, step in enumerate(h):
        theta = np.zeros(len(h))
        theta[k] = step
        up = function(*without(fit, (derivative, theta)))
        down = function(*without(fit, (derivative, -theta)))
        first[k] = (up - down) / (2 * step)
        second[k] = (up + down - 2 * middle) / step**2
    return derivative, result, first, second


@pytest.mark.parametrize(
    ("name", "pooled"),
    [*((name, True) for name in NAMES), ("gain by hour", False), ("positions", False)],
)
def test_score_and_information_are_derivatives_of_chi2(name, pooled):
    fit = uneven(pooled)
    derivative, result, of_balance, more = steps(fit, name, lambda *at: balance(fit, *at))
    unit = 1.0 / np.sqrt(result.whole)
    assert (result.score - derivative.score) * unit == pytest.approx(of_balance * unit, abs=2e-4)
    *_, of_structure, spread = steps(fit, name, lambda _, moments: structure(fit, moments))
    expected = np.broadcast_to(derivative.score, len(unit))
    assert expected * unit == pytest.approx(of_structure * unit, abs=1e-4)
    # For positions, the noise of fitted rows reduces it slightly.
    tolerance = 1e-2 if name == "positions" else 1e-3
    assert (more + spread) * unit**2 == pytest.approx(1.0, abs=tolerance)


@pytest.mark.parametrize(
    "names",
    [
        ("gain by hour", "zero by file of each"),
        ("gain by file", "zero by hour"),
        ("gain by hour of each", "random walk of the zero"),
        ("gain by load", "zero by hour of each"),
        ("quadratic coil of each", "cubic coil"),
        ("coil gradient", "bias gradient"),
        ("contact in one sign by load", "zero by file"),
    ],
)
def test_the_joint_information_of_two_effects_is_a_derivative_of_chi2(names):
    """Second differences by one parameter of each; they are exact for a sum of squares."""
    fit = uneven(pooled=True)
    both = [OF[name].derivative(fit) for name in names]
    result, first = scored(fit, *both), both[0].count
    h = 0.1 / np.sqrt(result.whole)
    for k, j in {(0, 0), (first - 1, 0), (first // 2, both[1].count - 1)}:
        mixed = 0.0
        for one, other in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
            theta = np.zeros(len(h))
            theta[k], theta[first + j] = one * h[k], other * h[first + j]
            at = without(fit, (both[0], theta[:first]), (both[1], theta[first:]))
            mixed += 0.25 * one * other * (balance(fit, *at) + structure(fit, at[1]))
        unit = h[k] * h[first + j]
        assert mixed == pytest.approx(unit * result.joint[k, first + j], abs=1e-3 * 0.1**2)


@pytest.mark.parametrize("name", NAMES)
def test_the_predicted_shift_of_alpha_is_that_of_a_new_fit(name):
    """Refit after removing a small amount of each parameter; with little noise D is negligible."""
    fit = affected(fit_of(SmallBench(2, 1e-5, order=THREE).campaign()), name)
    derivative = OF[name].derivative(fit)
    result = scored(fit, derivative)
    count = len(result.score)
    # In units of the standard errors.
    information = mirrored(fit.minimum.information[: fit.free, : fit.free])
    scale = 1.0 / np.sqrt(np.diag(information))
    for k in {0, count // 2, count - 1}:
        unit = np.sqrt(result.whole[k])
        step = 3.0 / unit
        values = []
        for way in (step, -step):
            theta = np.zeros(count)
            theta[k] = way
            problem, moments = without(fit, (derivative, theta))
            values.append(problem.fitted(moments, fit.minimum.values).values[: fit.free])
        moved = (values[0] - values[1]) / (2 * step)
        shift = -result.moves[k] / scale
        assert moved / scale == pytest.approx(shift, abs=2e-3 * np.abs(shift).max() + 1e-3 * unit)


@pytest.mark.study
@pytest.mark.parametrize(("name", "pooled"), [("gain by hour of each", False), ("positions", True)])
def test_the_spurious_score_of_noise_is_as_computed(name, pooled):
    """D_te: the derivative of the score with respect to alpha, at the truth, over drawn noise.

    Its mean is M_te - D_te; M_te alone would differ by many standard errors.
    """
    order, step = (0, 1, 1, 1, 1), 1e-4
    quiet = fit_of(SmallBench(30, 1e-7, order=order).campaign(), pooled=pooled)
    noise, off, spurious = 0.15, [], []

    def score(problem, moments, values):
        fit = FittedRows(problem, moments, replace(quiet.minimum, values=values), True)
        derivative = OF[name].derivative(fit)
        return fit, derivative, scored(fit, derivative)

    for seed in range(40):
        bench = SmallBench(30, 0.0, order=order)
        bench.error = noise * np.random.default_rng([seed, 31]).standard_normal(bench.error.shape)
        moments = replace(campaign_moments(bench.campaign()), pooled=pooled)
        known = replace(quiet.problem.noise, variance=np.full(14, noise**2))
        problem = replace(quiet.problem, noise=known)
        fit, derivative, result = score(problem, moments, quiet.minimum.values)
        information = mirrored(fit.minimum.information[: fit.free, : fit.free])
        change = np.empty((len(result.score), 14))
        for k, way in enumerate(step * np.eye(len(quiet.minimum.values))[:14]):
            ends = (score(problem, moments, quiet.minimum.values + s * way) for s in (1, -1))
            up, down = (end.score - at.score for _, at, end in ends)
            change[:, k] = (up - down) / (2 * step)
        off.append(change - (result.moves @ information)[:, :14])  # M_te - D_te
        spurious.append(derivative.spurious()[0])
    direction = np.mean(spurious, axis=0)
    size = np.linalg.norm(direction)
    along = np.sum(off * direction, axis=(1, 2)) / size
    error = np.std(along) / np.sqrt(len(along))
    assert size > 5 * error
    assert abs(np.mean(along)) < 3 * error


@pytest.mark.parametrize("pooled", [True, False])
@pytest.mark.parametrize("name", [name for name in NAMES if "each" in name or name == "positions"])
def test_the_cheap_bound_does_not_exceed_the_variance_of_a_score(name, pooled):
    for fit in (uneven(pooled), fit_of(SmallBench(8, 3e-2).campaign(), pooled=pooled)):
        derivative = OF[name].derivative(fit)
        score, whole, variance = variance_at_least(fit, derivative)
        exact = scored(fit, derivative)
        assert score == pytest.approx(exact.score, rel=1e-9, abs=1e-9 * np.abs(exact.score).max())
        assert whole == pytest.approx(exact.whole, rel=1e-9)
        diagonal = np.diag(exact.variance)
        assert (variance <= diagonal + 1e-9 * exact.whole).all()
        if name == "positions":
            assert (variance >= diagonal - 4e-3 * whole).all()


# ------------------------------------------------------------------------------ score and chance


IN_BLOCKS = (0, 0, 0, 0, 1, 1, 1, 1)


@pytest.mark.parametrize(
    ("count", "noise", "order", "error"),
    [
        pytest.param(24, 1e-3, THREE, None, id="few"),
        *(
            pytest.param(200, *case, marks=pytest.mark.study, id=name)
            for name, *case in (
                ("three loads", 1e-3, THREE, None),
                ("loud", 3e-2, IN_BLOCKS, None),
                ("one cycle, loud", 2e-2, (0, 1), 2e-2),
            )
        ),
    ],
)
def test_p_values_of_clean_campaigns_are_uniform(count, noise, order, error):
    """The tolerance is four standard errors."""
    p = {name: [] for name in NAMES}
    for seed in range(count):
        campaign = SmallBench([seed, 5], noise, order=order).campaign()
        for test in effect_tests(fit_of(changed(campaign, force_error=error), pooled=True)):
            p[ENTRIES[test.effect.code].name].append(np.exp(test.log_probability))
    for name, found in p.items():
        if not found:
            assert name in SINGLE or len(order) == 2 or max(order) == 1
            continue
        assert np.mean(found) == pytest.approx(0.5, abs=4 * np.sqrt(1 / 12 / count)), name
        significant = np.mean(np.less(found, 0.05))
        assert significant <= 0.05 + 4 * np.sqrt(0.05 * 0.95 / count), name
        if count >= 200:
            assert significant >= 0.005, name
            assert np.mean(np.less(found, 0.001)) <= 0.01, name
    every = np.concatenate(list(p.values()))
    assert np.mean(every) == pytest.approx(0.5, abs=0.06)
    assert 0.02 < np.mean(every < 0.05) < 0.09


def test_tiny_probabilities_of_chi2_are_finite_and_correct():
    for chi2, freedom in ((3.0, 1.0), (80.0, 20.0)):
        exact = scipy.stats.chi2.logsf(chi2, freedom)
        assert log_chance(chi2, freedom) == pytest.approx(exact)
    far = log_chance(1e7, 3.0)
    assert np.isfinite(far)
    assert far == pytest.approx(-5e6, rel=1e-4)
    assert far < log_chance(9e6, 3.0)


@pytest.mark.parametrize("drift", [0.0, 2e-2])
def test_bounded_tests_find_the_same_effects_as_exact_ones(drift):
    """Effects that are skipped by the bound would not be significant in an exact test.

    With 40 actuators, because V is always computed exactly for few parameters.
    """
    campaign, _ = campaign_of(1, 1e-3, layout=rings([0.05, 0.1, 0.15], [8, 13, 19]))
    each = 1 + np.outer(np.arange(4.0), drift * np.random.default_rng(3).standard_normal(40))
    drifting = changed(
        campaign,
        force=lambda k, c: c.force * each[k],
        date=lambda k, c: c.date + datetime.timedelta(hours=k),
    )
    fit = fit_of(drifting, pooled=True)
    found = effect_tests(fit)
    limit = np.log(1.0 - (1.0 - OF_EACH_KIND) ** (1.0 / len(found)))
    expected = [(t.effect.code, t.log_probability) for t in found if t.log_probability < limit]
    assert [
        (t.effect.code, t.log_probability)
        for t in significant_tests(effect_tests(fit, bounded=True))
    ] == expected
    assert bool(expected) == bool(drift)
    passed = [t for t in found if surely_sound(fit, t.derivative, 1e-6)]
    assert len(passed) >= 2
    assert all(t.log_probability > np.log(OF_EACH_KIND) for t in passed)


@pytest.mark.study
def test_false_positive_rate_of_effects_is_low():
    said = sum(bool(calibrate(SmallBench([k, 6], SIGMA).campaign()).effects) for k in range(40))
    assert said <= 2


# ------------------------------------------------------------------------------ found, corrected


def in_order(bench, files):
    """Return values of files in the order of the campaign's cycles: by load, then in time."""
    return np.asarray(files)[np.argsort(bench.order, kind="stable")]


def balanced_files(bench, spread):
    """Return a number for each file, with this rms and with zero mean under each load."""
    drawn = bench.random.standard_normal(len(bench.order))
    for load in set(bench.order.tolist()):
        under = bench.order == load
        drawn[under] -= drawn[under].mean()
    return spread * drawn / np.sqrt(np.mean(drawn**2))


def middle(bench):
    return bench.hours - bench.hours.mean()


def drawn(bench, size):
    return size * bench.random.standard_normal(14)


def drift(bench, what, size):
    """Let gains or zeros drift per hour, by one size or by (n,) sizes."""
    setattr(bench, what, (what == "gain") + np.outer(middle(bench), size))
    return np.atleast_1d(size)


def differ(bench, what, spread, whose):
    """Let gains or zeros differ by file, in common or for each actuator in a list."""
    files = np.array([balanced_files(bench, spread) for _ in whose or [0]]).T
    changes = np.zeros((len(files), 14))
    changes[:, whose or slice(None)] = files
    setattr(bench, what, (what == "gain") + changes[bench.file])
    return in_order(bench, files).ravel()


def random_walk(bench, size, *, balanced=True):
    """Let the zero of all jump before each file but the first, and stay.

    Jumps as the load changes, up and down by the same, move the scale, and are not determined.
    """
    jumps = size * bench.random.standard_normal(len(bench.order) - 1)
    change = np.diff(bench.order)
    if balanced:
        jumps -= change * (change @ jumps) / (change @ change)
    jumps = np.concatenate([[0.0], jumps])  # that before the first file is of all: none
    bench.zero = np.cumsum(jumps)[bench.file][:, None]
    return jumps


def gain_by_load(bench):
    bench.gain = 1 - 4e-3 * ((bench.load == 1) - 0.5)[:, None]
    return [-4e-3]


def weight_of_load(bench):
    bench.external = bench.external + np.outer(bench.load == 1, [0.05, 0.0, 0.0])
    return  # the three weights are determined in one direction only


def coil_law(bench, power, size):
    bench.law = lambda c: 1 + size * c**power
    return np.atleast_1d(size)


def coil_gradient(bench):
    bench.gain = 1 + 2000 * bench.z
    return [2000]


def bias_gradient(bench):
    bench.external = bench.external + 1000 * bench.z @ bench.arms.T
    return [1000]


CONTACT = np.array([0.02, 1e-3, -5e-4])


def contact(bench):
    bench.external = bench.external + np.outer(bench.sign > 0, CONTACT)
    return CONTACT


def contact_by_load(bench):
    bench.external = bench.external + np.outer((bench.sign > 0) & (bench.load == 1), CONTACT)
    return [0.0, 0.0, 0.0, *CONTACT]


def positions(bench):
    moved = 0.5e-3 * bench.random.standard_normal((2, 14))
    bench.arms = bench.arms.copy()
    bench.arms[1:] += moved
    return moved.ravel()


def shell_curvature(bench):
    """Let NZ be less than declared by r^2 times 1 per square metre, 1 % at r = 0.1 m."""
    bench.arms = bench.arms.copy()
    bench.arms[0] -= 0.5 * 2.0 * (bench.arms[1] ** 2 + bench.arms[2] ** 2)
    return [2.0]


IN_TURN = (0, 1, 0, 1, 0, 1, 0, 1)
EACH = list(range(14))
CASES = {
    "gain by hour": lambda bench: drift(bench, "gain", 3e-3),
    "gain by hour of each": lambda bench: drift(bench, "gain", drawn(bench, 5e-3)),
    "gain by file": lambda bench: differ(bench, "gain", 4e-3, None),
    "gain of single actuators by file": lambda bench: differ(bench, "gain", 3e-3, [5]),
    "gain by load": gain_by_load,
    "weight of a load": weight_of_load,
    "zero by hour": lambda bench: drift(bench, "zero", 0.4 * bench.noise),
    "zero by hour of each": lambda bench: drift(bench, "zero", drawn(bench, 0.4 * bench.noise)),
    "zero by file": lambda bench: differ(bench, "zero", 0.6 * bench.noise, None),
    "zero by file of each": lambda bench: differ(bench, "zero", 0.8 * bench.noise, EACH),
    "random walk of the zero": lambda bench: random_walk(bench, 0.6 * bench.noise),
    "quadratic coil": lambda bench: coil_law(bench, 1, 0.01),
    "quadratic coil of each": lambda bench: coil_law(bench, 1, drawn(bench, 0.02)),
    "cubic coil": lambda bench: coil_law(bench, 2, 0.01),
    "cubic coil of each": lambda bench: coil_law(bench, 2, drawn(bench, 0.02)),
    "coil gradient": coil_gradient,
    "bias gradient": bias_gradient,
    "contact in one sign": contact,
    "contact in one sign by load": contact_by_load,
    "positions": positions,
    "shell curvature": shell_curvature,
}
SEEDS = {"positions": 2}  # seeds 0 and 1 deviate by 2.3 sigma, in the common scale only
UNCORRECTED = {"weight of a load"}  # reported, but not corrected
ORDERS = {"weight of a load": (0, 1, 2, 0, 1, 2, 0, 1, 2)}


def bench_with(name, seed, noise=SIGMA):
    """Return a bench with an effect of the catalogue, and its parameters."""
    bench = SmallBench([seed, 8], noise, order=ORDERS.get(name, IN_TURN))
    return bench, CASES[name](bench)


def truth_of(bench):
    """Return (n,) alpha, the mean over the campaign."""
    return bench.alpha * np.broadcast_to(bench.gain, bench.error.shape).mean(axis=0)


@pytest.mark.parametrize("name", NAMES)
def test_an_effect_is_identified_estimated_and_corrected(name):
    z, distances = [], []
    for seed in range(3):
        bench, theta = bench_with(name, SEEDS.get(name, 0) + seed)
        found = calibrate(bench.campaign())
        assert (found.effects[0].name, found.effects[0].unit) == (name, OF[name].unit)
        assert found.effects[0].probability < 1e-4
        assert all(effect.corrected == (name not in UNCORRECTED) for effect in found.effects)
        assert found.rejected == 0
        z.append((found.alpha - truth_of(bench)) / found.error)
        if name not in UNCORRECTED:
            corrected = correction(fit_of(bench.campaign(), pooled=True), OF[name])
            apart = corrected.parts[0].theta - np.array(theta)
            distances.append(apart @ np.linalg.solve(corrected.covariance, apart) / len(apart))
            largest = (0.9 if name == "positions" else 0.5) * np.linalg.norm(theta)
            assert np.linalg.norm(apart) < largest
    assert np.mean(np.abs(z) < 2.58) > 0.9
    assert np.sqrt(np.mean(np.square(z))) < 1.6
    assert name in UNCORRECTED or 0.05 < np.mean(distances) < 2.5


@pytest.mark.parametrize(
    ("name", "where"),
    [
        ("gain by hour of each", lambda bench, worst: f"actuator {bench.layout.id[worst]}"),
        ("gain by file", lambda bench, worst: bench.campaign().cycles[worst].name),
        ("gain of single actuators by file", lambda bench, _: f"actuator {bench.layout.id[5]}"),
        ("contact in one sign by load", lambda *_: "load 1"),
    ],
)
def test_the_place_of_the_largest_effect_is_reported(name, where):
    bench, theta = bench_with(name, 1, noise=2e-4)
    effect = calibrate(bench.campaign()).effects[0]
    assert effect.where == where(bench, int(np.abs(theta).argmax()))
    if "gain" in name:
        assert abs(effect.size) == pytest.approx(np.abs(theta).max(), rel=0.3)


def test_the_error_covers_the_scale_that_a_random_walk_of_the_zero_moves():
    """What differs between loads is not determined; the spread of the jumps tells it.

    Seven jumps may also look like zeros that are independent in each file.
    """
    z, named = [], []
    for seed in range(12):
        bench = SmallBench([seed, 15], SIGMA, order=IN_TURN)
        random_walk(bench, 0.6 * SIGMA, balanced=False)
        found = calibrate(bench.campaign())
        named.append(found.effects[0].code)
        z.append(np.mean((found.alpha - bench.alpha) / found.error))
    assert named.count(Code.ZERO_RANDOM_WALK) >= 8
    assert set(named) <= {Code.ZERO_RANDOM_WALK, Code.ZERO_BY_FILE}
    assert 0.4 < np.sqrt(np.mean(np.square(z))) < 1.6
    assert np.max(np.abs(z)) < 3.0


def test_two_simultaneous_effects_are_found():
    for seed in range(3):
        bench, _ = bench_with("gain by hour", seed)
        contact(bench)
        found = calibrate(bench.campaign())
        assert {effect.name for effect in found.effects} == {"gain by hour", "contact in one sign"}
        assert all(effect.corrected for effect in found.effects)
        assert rms_z(found, truth_of(bench)) < 2.5


def test_an_effect_that_the_data_cannot_show_is_not_tested():
    """The weight of one of two loads; gradients without POSITION; contact with one sign only."""
    bench = SmallBench(9, SIGMA)
    bench.has_position = False
    tested = {ENTRIES[test.effect.code].name for test in effect_tests(fit_of(bench.campaign()))}
    assert tested == set(NAMES) - SINGLE - {"coil gradient", "bias gradient", "weight of a load"}
    one = changed(bench.campaign(), valid=lambda _, c: c.sign > 0)
    tested = {ENTRIES[test.effect.code].name for test in effect_tests(fit_of(one))}
    assert not any("contact" in name for name in tested)


# -------------------------------------------------------------------------- undetectable effects


def support(bench):
    bench.external = bench.external + np.outer(bench.load == 1, [5e-3, 0.0, 0.0])


def other_gains(bench):
    """Change the gains of elastic forces only, and not of forces at rest."""
    each = 1 + 0.01 * bench.random.standard_normal(14)
    elastic = bench.sign[:, None] * bench.elastic[bench.shape - 1]
    bench.zero = elastic / bench.alpha * (1 / each - 1)


@pytest.mark.parametrize(
    ("change", "name", "tolerance"),
    [
        (support, "something else supports 5 mN of an added weight", 0.05),
        (other_gains, "coil gains differ by 1 % between static and elastic forces", 0.6),
    ],
)
def test_undetectable_effects_shift_the_scale_as_stated(change, name, tolerance):
    ratio = []
    for seed in range(6):
        bench = SmallBench([seed, 12], 1e-5)
        change(bench)
        found = calibrate(bench.campaign())
        stated = {error.name: error.relative for error in found.unseen}[name]
        ratio.append((np.mean(found.alpha / bench.alpha) - 1) / stated)
    assert not found.effects
    assert np.sqrt(np.mean(np.square(ratio))) == pytest.approx(1.0, abs=tolerance)


WARM = "the bias magnets are 1 K warmer under one load"


def warmer(bench, kelvins=1.0):
    """Let all magnets lose 0.11 %/K under the load; the bias force, of two magnets, twice that."""
    bench.gain = 1 - 1.1e-3 * kelvins * (bench.load == 1)[:, None]
    bench.external = bench.external - np.outer(bench.load == 1, [2.2e-3 * kelvins * BIAS, 0, 0])


def test_warmer_magnets_under_a_load_shift_the_scale_as_stated():
    bench, unchanged = SmallBench([1, 13], 1e-4), SmallBench([1, 13], 1e-4)
    warmer(bench)
    found, truth = calibrate(bench.campaign()), truth_of(bench)
    assert [(effect.name, effect.corrected) for effect in found.effects] == [("gain by load", True)]
    off = np.mean(found.alpha / truth) - 1
    of_one = {error.name: error.relative for error in calibrate(unchanged.campaign()).unseen}
    assert abs(off) == pytest.approx(of_one[WARM], rel=0.05)
    # E_STAT includes the shift, because the coil gains show the temperature change.
    assert found.error / truth == pytest.approx(abs(off), rel=0.1)
    recorded = changed(unchanged.campaign(), temperature=np.full(28, 20.0))
    names = {error.name for error in calibrate(recorded).unseen}
    assert names == of_one.keys() - {WARM}


def tilted(true, **declared):
    """Return a campaign under the bare mirror and a tilt, with its declaration, and its alpha."""
    loads = (Load("bare"), Load("tilted", tilt=true))
    campaign, truth = campaign_of(5, 1e-5, loads=loads)
    load = [Load("bare"), Load("tilted", **declared)]
    return changed(campaign, load=lambda k, c: load[k // 2]), truth[:14]


def test_a_misaligned_tilt_is_undetectable_and_shifts_the_scale_as_stated():
    """45 +- 0.1 degrees, and 46 in truth: 9.5 stated errors, which nothing else showed."""
    campaign, alpha = tilted(46.0, tilt=45.0, tilt_error=0.1)
    found = calibrate(campaign)
    [stated] = [e.relative for e in found.unseen if e.name == "the tilt is wrong by 1 degree"]
    off = np.mean(found.alpha / alpha) - 1
    assert abs(off) > 8 * np.mean(found.error / alpha)
    assert stated == pytest.approx(abs(off), rel=0.05)
    unsure, _ = tilted(45.0, tilt=45.0, tilt_error=1.0)  # E_SYST contains it
    assert "the tilt is wrong by 1 degree" not in {e.name for e in calibrate(unsure).unseen}


def test_without_an_added_weight_there_is_nothing_to_support():
    campaign, _ = tilted(45.0, tilt=45.0, tilt_error=0.1)
    assert not [each.name for each in calibrate(campaign).unseen if "support" in each.name]


# ------------------------------------------------------------------------------ forces, and noise


def test_an_unknown_force_is_reported_with_its_actuator():
    """Position errors would explain a part of it; correcting them would bias alpha."""
    bench, actuator, size = SmallBench([1, 10], SIGMA), 5, 5e-3
    way = np.sign(bench.z[:, actuator]) * (1 + 0.5 * np.sin(3 * bench.shape))
    bench.external = bench.external - np.outer(size * way, bench.arms[:, actuator])
    found = calibrate(bench.campaign())
    force = found.effects[-1]
    assert (force.name, force.where) == ("unknown force", f"actuator {actuator + 1}")
    assert not any(effect.corrected for effect in found.effects)
    # The size refers to one row of weight 1; a shape is the mean of 16 rows.
    assert force.size == pytest.approx(size * np.sqrt(16), rel=0.5)
    assert rms_z(found, bench.alpha) < 2
    assert found.error.mean() > calibrate(SmallBench([1, 10], SIGMA).campaign()).error.mean()
    wrong = correction(fit_of(bench.campaign(), pooled=True), OF["positions"])
    freedom = wrong.problem.degrees_of_freedom(wrong.moments) - wrong.effective_parameters
    assert (
        chi2_probability(wrong.minimum.chi2, freedom, wrong.problem.noise) < LIMITS.fit_probability
    )


def test_no_unknown_force_is_found_in_clean_campaigns():
    assert not any(unknown_force(fit_of(SmallBench([k, 11], SIGMA).campaign())) for k in range(10))


def correlated(bench):
    """Make the noise a first-order autoregression over the rows of each file."""
    for file in range(8):
        rows = bench.file == file
        bench.error[rows] = scipy.signal.lfilter(
            [np.sqrt(1 - 0.9**2)], [1.0, -0.9], bench.error[rows], axis=0
        )


def shared_in_rows(bench):
    bench.error += 0.5 * SIGMA * bench.random.standard_normal((len(bench.file), 1))


@pytest.mark.parametrize(
    ("change", "expected"),
    [(correlated, {"correlated noise", "zero by file of each"}), (shared_in_rows, set())],
)
def test_stated_errors_cover_correlated_noise(change, expected):
    """Correlated rows are reported. Noise shared within a row is no effect.

    Its mean over a file is a common zero offset, but no larger than the noise explains.
    """
    z = []
    for seed in range(10):
        bench = SmallBench([seed, 12 if expected else 13], SIGMA)
        change(bench)
        found = calibrate(bench.campaign())
        names = {effect.name for effect in found.effects}
        assert bool(names & expected) == bool(names) == bool(expected), seed
        z.append((found.alpha - bench.alpha) / found.error)
    assert np.mean(np.abs(z) < 1.96) > 0.85
    assert np.sqrt(np.mean(np.square(z))) < 1.5


def test_an_uncorrected_effect_adds_its_shift_to_the_error():
    """A wrong weight of three: E_STAT is less than five times the error of alpha."""
    bench, _ = bench_with("weight of a load", 1, noise=1e-4)
    found = calibrate(bench.campaign())
    assert found.goodness.probability < LIMITS.fit_probability
    off = np.abs(found.alpha / bench.alpha - 1)
    assert np.mean(off < 1.96 * found.error / bench.alpha) > 0.9
    assert np.median(found.error / bench.alpha) < 5 * np.median(off)
    assert [each.code for each in found.diagnosis.warnings] == ["misfit-explained"]


def leaning_campaign(shift, *, declared=False, **left_out):
    """Return a campaign whose coils shift when the mirror is tilted, and its alpha."""
    tilted = Load("tilted", tilt=60.0, coil_shift=shift)
    bench = static_bench(p45(), 1, loads=(Load("bare"), tilted))
    campaign, known = exact_weights(bench), {} if declared else {"coil_shift": None}
    cycles = (replace(c, load=replace(c.load, **known), **left_out) for c in campaign.cycles)
    return Campaign(tuple(cycles)), bench.truth.alpha


@pytest.mark.parametrize("declared", [True, False])
def test_coils_that_shift_with_tilt_do_not_change_the_scale(declared):
    """A shift of 10 um changes gains by 0.6 %, and the bias force by 14 mN (1.5 N by the tilt)."""
    campaign, alpha = leaning_campaign(10e-6, declared=declared)
    found = calibrate(campaign)
    assert rms_error(found, alpha) < 5e-4
    named = [(e.code, e.where, e.size) for e in found.effects if e.corrected]
    assert declared or named == [("gain-by-load", "tilted", pytest.approx(-6e-3, rel=0.01))]
    assert declared != bool(named)
    assert "the coils move by 5 um when the mirror is tilted" not in {e.name for e in found.unseen}


def test_undeclared_coil_shifts_are_undetectable_without_position():
    def unseen(**options):
        campaign, _ = leaning_campaign(0.0, position=None, **options)
        return {e.name: e.relative for e in calibrate(campaign).unseen}

    name = "the coils move by 5 um when the mirror is tilted"
    assert name not in unseen(declared=True)
    # COILGRAD (W + B) - 45 BIASGRAD under the tilt, for B of 4.4 N, of 1.46 N.
    assert unseen()[name] == pytest.approx(5e-6 * (600 * 2.9 - 45 * 31) / 1.46, rel=0.15)


# ------------------------------------------------------------------------------------- rejection


@cache
def p45_with_gradients():
    """Return four cycles per load of P45 with undeclared gradients, and its alpha."""
    bench = static_bench(p45(), 1, force_noise=1e-5)
    campaign = changed(exact_weights(bench), coil_gradient=None, bias_gradient=None)
    return campaign, bench.truth.alpha


def rms_error(found, alpha):
    return float(np.sqrt(np.mean((found.alpha / alpha - 1) ** 2)))


@pytest.mark.parametrize("position", [True, False])
def test_undeclared_gradients_reject_no_rows_and_hardly_change_alpha(position):
    """Without POSITION the cause is unknown, but shapes that agree are not outliers."""
    campaign, alpha = p45_with_gradients()
    found = calibrate(campaign if position else changed(campaign, position=None))
    assert found.rejected == 0
    assert rms_error(found, alpha) < 2e-4
    for name, size in (("coil gradient", 600), ("bias gradient", 31)):
        corrected = sum(e.size for e in found.effects if e.name == name and e.corrected)
        assert corrected == pytest.approx(size * position, rel=0.05)
    assert position or not any(effect.corrected for effect in found.effects)
    assert np.mean(np.abs(found.alpha - alpha) < 1.96 * found.statistical_error) > 0.85


def test_spikes_are_rejected_in_spite_of_undeclared_gradients():
    campaign, alpha = p45_with_gradients()
    random, places = np.random.default_rng(3), set()
    for _ in range(20):
        k, row, actuator = random.integers([8, 90, 45]).tolist()
        campaign = with_spike(campaign, k, row, actuator, 5e-3)
        places.add((k, row))
    found = calibrate(campaign)
    assert {(row.cycle, row.row) for row in found.rejected_rows} == places
    assert rms_error(found, alpha) < 2e-4


def test_few_rows_are_rejected_if_the_noise_has_long_tails():
    """The noise follows Student's t distribution with three degrees of freedom."""
    bench = SmallBench(17, SIGMA)
    tails = scipy.stats.t.rvs(3, size=bench.error.shape, random_state=bench.random)
    bench.error = SIGMA * tails / np.sqrt(3)
    found = calibrate(bench.campaign())
    assert found.rejected <= 0.1 * len(bench.file)
    assert rms_z(found, bench.alpha) < 2


# --------------------------------------------------------------------------------- missing data


def test_equal_dates_of_files_cause_no_effect():
    """DATE-OBS may be that of the folder. The times of rows within a file are then still used."""
    bench = SmallBench(20, SIGMA)
    date = datetime.datetime(2026, 1, 1, tzinfo=datetime.UTC)
    campaign = changed(bench.campaign(), date=date)
    assert not calibrate(campaign).effects
    still = changed(campaign, time=np.zeros(28))
    tested = {ENTRIES[test.effect.code].name for test in effect_tests(fit_of(still))}
    assert not any("hour" in name for name in tested)
    assert not calibrate(still).effects
