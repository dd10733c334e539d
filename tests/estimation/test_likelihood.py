"""`ml`: sums compared with loops, errors with the Cramer-Rao bound, and refusals."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg
import scipy.stats

from helpers.balanced import (
    BARE_AND_RING,
    LAYOUT,
    RING,
    START,
    arms_of,
    campaign_of,
    changed,
    noisy,
    p45_bench,
)
from truenewton.calibration.methods import calibrate
from truenewton.errors import UnknownName
from truenewton.estimation import campaign_ml
from truenewton.estimation.findings.estimate import weight_errors
from truenewton.estimation.likelihood import (
    DataSet,
    Prior,
    _terms,
    chi2_at,
    likeliest_spread,
    minimise,
    smooth_patterns,
    start_values,
    with_population,
)
from truenewton.estimation.matrix.modes import column_fit, columns_of
from truenewton.estimation.matrix.screen import screen_matrix
from truenewton.estimation.paper.svd import condition_in_units_of_rms
from truenewton.estimation.readings.moments import shape_sums
from truenewton.estimation.screening.screen import screen_campaign
from truenewton.mirrors.known import lbt672, p45
from truenewton.records.campaign import Campaign
from truenewton.records.stiffness_matrix import StiffnessMatrix
from truenewton.statics.arms import arms
from truenewton.statics.layout import Layout, rings
from truenewton.statics.load import Load

FEW, MANY = 50, 120
EXACT = (Load("bare"), replace(RING, added_error=0.0))  # weights without error: E_STAT alone
EXACT_TILT = (Load("bare"), Load("tilt", tilt=60.0))
EXACT_THREE = (*EXACT, Load("leaning", -0.1, tilt=60.0))
THREE = (*BARE_AND_RING, Load("leaning", -0.1, 0.002, tilt=60.0, tilt_error=0.1))
CURVED = rings([0.06, 0.1], [5, 9], nz=[0.97, 0.8])
SIGMA = 1e-3


def find(campaign, population=False):
    """Return the estimate of ml for a campaign."""
    return campaign_ml.fit_campaign(screen_campaign(campaign), population)


def of_one_load(c, r=None, q=None, variance=0.0, load=(0.0, 0.0, 0.0), place=0):
    """Return a set of shapes under the first or second of two loads, with weights 1 by default."""
    r = np.ones(len(c)) if r is None else r
    sums = shape_sums(c, r, np.zeros((len(c), 3)) if q is None else q, np.ones((1, len(c))))
    nuisance = np.zeros((3, 5))
    nuisance[0, 0], nuisance[1, 1 + 2 * place], nuisance[2, 2 + 2 * place] = 1.0, 1.0, -1.0
    return DataSet(sums, variance, np.array([load]), nuisance[None])


# Sums compared with loops over shapes.


def problem(seed=0, n=9, shapes=20):
    """Return arms, rows and two sets of shapes with unequal weights and known parts, and values."""
    random = np.random.default_rng(seed)
    a = np.stack([random.uniform(0.8, 1.0, n), *random.normal(0.0, 0.1, (2, n))])
    rows, sets = [], []
    for load in range(2):
        c, q = random.normal(0.0, 0.3, (shapes, n)), random.normal(0.0, 1e-3, (shapes, 3))
        r = random.uniform(0.5, 4.0, shapes)
        variance = random.uniform(0.5, 2.0, n) * 1e-2
        rows.append((c, r, q))
        sets.append(of_one_load(c, r, q, variance, (-2.9 - load, 0.0, 0.0), load))
    values = np.concatenate([random.uniform(0.7, 1.1, n), random.normal(0.0, 1.0, 5)])
    return a, rows, sets, values


def looped(a, rows, sets, values):
    """Return chi2, gradient, M and D, shape by shape."""
    n, u = a.shape[1], len(values)
    chi2, gradient, m, d = 0.0, np.zeros(u), np.zeros((u, u)), np.zeros((u, u))
    arms = a * values[:n]
    for (c_all, r_all, q_all), part in zip(rows, sets, strict=True):
        sigma = np.diag(part.variance)
        s_inverse = np.linalg.inv(arms @ sigma @ arms.T)
        v = sigma - sigma @ arms.T @ s_inverse @ arms @ sigma
        for c, r, q in zip(c_all, r_all, q_all, strict=True):
            rho = arms @ c + q + part.external(values[n:])[0]
            fitted = c - sigma @ arms.T @ s_inverse @ rho
            jacobian = np.hstack([a * fitted, part.nuisance[0]])
            chi2 += r * rho @ s_inverse @ rho
            gradient += r * jacobian.T @ s_inverse @ rho
            m += r * jacobian.T @ s_inverse @ jacobian
            d[:n, :n] += (a.T @ s_inverse @ a) * v  # V / r, r times
    return chi2, gradient, m, d[:n, :n]


def test_sums_equal_loops_over_shapes():
    a, rows, sets, values = problem()
    terms = _terms(a, sets, values)
    chi2, gradient, m, d = looped(a, rows, sets, values)
    assert terms.chi2 == pytest.approx(chi2, rel=1e-11)
    assert chi2_at(a, sets, values) == pytest.approx(chi2, rel=1e-11)
    assert terms.gradient == pytest.approx(gradient, rel=1e-9, abs=1e-11 * np.abs(gradient).max())
    assert terms.m == pytest.approx(m, rel=1e-9, abs=1e-11 * np.abs(m).max())
    assert terms.noise_information @ np.eye(len(d)) == pytest.approx(
        d, rel=1e-11, abs=1e-12 * np.abs(d).max()
    )


def test_the_gradient_is_the_derivative_of_half_chi2():
    a, _, sets, values = problem(seed=1)
    gradient = _terms(a, sets, values).gradient
    for k in range(len(values)):
        step = np.zeros(len(values))
        step[k] = 1e-5
        rise = chi2_at(a, sets, values + step) - chi2_at(a, sets, values - step)
        # The third derivative limits central differences to 1e-10 of the largest component.
        assert rise / 4e-5 == pytest.approx(gradient[k], abs=1e-7 * np.abs(gradient).max())


def test_the_mean_of_m_at_the_truth_is_information_plus_d():
    """The information is that of noiseless shapes; the mean is taken over 1000 draws of noise."""
    quiet, truth = campaign_of(seed=2, noise=0.0, cycles=1, loads=EXACT)
    a, values = arms_of(LAYOUT), truth
    large = 0.15  # of noise, so that D matters
    clean, total, draws = quiet_sets(quiet, large), 0.0, 1000
    random = np.random.default_rng(3)
    for _ in range(draws):
        noised = [
            replace(part, sums=of_one_load(c + large * random.standard_normal(c.shape)).sums)
            for part, c in clean
        ]
        total = total + _terms(a, noised, values).m
    expected = _terms(a, [part for part, _ in clean], values)
    information, noise_information = expected.m[:14, :14], expected.noise_information @ np.eye(14)
    mean = total[:14, :14] / draws - information
    # D is 0.17 of the information. The mean of 1000 draws has an error of 1.5 % of D, and each
    # diagonal element of a few per cent.
    assert np.trace(noise_information) > 0.05 * np.trace(information)
    assert np.trace(mean) == pytest.approx(np.trace(noise_information), rel=0.05)
    assert np.diag(mean) == pytest.approx(np.diag(noise_information), rel=0.2)


def quiet_sets(campaign, sigma):
    """Return the set of shapes and their forces for each load of a noiseless campaign."""
    variance = np.full(14, sigma**2)
    return [
        (of_one_load(c.used_force, None, None, variance, (weight, 0.0, 0.0), place), c.used_force)
        for place, (c, weight) in enumerate(
            zip(campaign.cycles, campaign.effective_weights, strict=True)
        )
    ]


# Symmetries.


@pytest.mark.parametrize(
    ("loads", "cycles", "declared"),
    [
        (EXACT, 1, None),
        (EXACT, 1, 1e-6),
        (EXACT, 2, None),
        (EXACT_TILT, 1, 1e-6),
        (EXACT_THREE, 2, None),
        (BARE_AND_RING, 2, None),
        (THREE, 1, 1e-6),
    ],
)
def test_noiseless_readings_give_the_truth(loads, cycles, declared):
    """If weights have errors, alpha is exact to 1e-3 of the error of the common scale.

    With a FORCERR of 1 uN the iteration ends at 1e-5 of a standard error of 2e-6.
    """
    exact = all(k.added_error == 0 for k in loads)
    error = 0.0 if exact or declared else 0.005
    campaign, truth = campaign_of(5, 0.0, cycles=cycles, loads=loads, weight_error=error)
    found = find(changed(campaign, force_error=declared))
    tolerance = (1e-10, 1e-6) if declared else (1e-9, 2e-5)
    assert found.values == pytest.approx(truth, abs=tolerance[0 if exact else 1])
    assert np.isfinite(found.reading_covariance).all()


@pytest.mark.parametrize(("method", "metre"), [("ml", 50.0), ("svd", 1.0)])
def test_alpha_does_not_depend_on_axes_and_units(method, metre):
    """Axes rotate by 2 rad; forces are in units of 0.25 N, and lengths, for `ml`, of 2 cm."""
    campaign, _ = campaign_of(seed=7, noise=SIGMA, cycles=3)
    of, c, s = campaign.layout, metre * np.cos(2.0), metre * np.sin(2.0)
    layout = Layout(of.id, c * of.x - s * of.y, s * of.x + c * of.y, of.nz, of.enabled)
    other = changed(campaign, layout=layout, force=lambda _, cycle: 4 * cycle.force)
    one, two = calibrate(campaign, method), calibrate(other, method)
    assert np.abs((4 * two.alpha - one.alpha) / one.statistical_error).max() < 1e-5
    assert 4 * two.error == pytest.approx(one.error, rel=1e-6)
    assert two.noise == pytest.approx(4 * one.noise, rel=1e-9)
    # (M_y, -M_x) rotate like the moments of (x, y).
    assert two.torque_y == pytest.approx(c * one.torque_y + s * one.torque_x, abs=1e-8 * metre)
    assert two.torque_x == pytest.approx(-s * one.torque_y + c * one.torque_x, abs=1e-8 * metre)


@pytest.mark.parametrize("method", ["ml", "svd"])
def test_the_order_of_actuators_does_not_matter(method):
    campaign, _ = campaign_of(seed=10, noise=SIGMA, disabled=(3,))
    of, order = campaign.layout, np.random.default_rng(1).permutation(14)
    shuffled = Layout(*(getattr(of, k)[order] for k in ("id", "x", "y", "nz", "enabled")))
    other = changed(campaign, layout=shuffled, force=lambda _, c: c.force[:, order])
    one, two = calibrate(campaign, method), calibrate(other, method)
    on = shuffled.enabled
    apart = (two.alpha - one.alpha[order]) / one.statistical_error[order]
    assert np.abs(apart[on]).max() < 1e-5
    assert np.isnan(apart[~on]).all()
    assert two.error[on] == pytest.approx(one.error[order][on], rel=1e-6)
    assert two.bias_force == pytest.approx(one.bias_force, rel=1e-6)


# The bound.


def information(quiet, truth, sigma, weights=None):
    """Return the Fisher information of alpha, B and torques, from noiseless readings.

    Brute force: the mean reading of a shape is a function of the unknowns and of n - 3 coordinates
    of its own (all forces that balance), which are eliminated for each shape. `sigma` is the (n,)
    noise of one reading; `weights` are those of the cycles.
    """
    a = arms_of(quiet.layout)[:, quiet.layout.enabled]
    n, loads = a.shape[1], len(quiet.loads)
    arms = a * truth[:n]
    back, free = np.linalg.pinv(arms), scipy.linalg.null_space(arms)
    errors = weight_errors(quiet)
    total = np.zeros((n + 1 + 2 * loads + len(errors),) * 2)
    for k, (cycle, place) in enumerate(zip(quiet.cycles, quiet.load_index, strict=True)):
        of_load = np.zeros((3, total.shape[0] - n))
        of_load[0, 0] = 1.0
        of_load[1, 1 + 2 * place], of_load[2, 2 + 2 * place] = 1.0, -1.0
        of_load[0, 1 + 2 * loads :] = [change[place] for change in errors.values()]
        whitening = np.sqrt(1.0 if weights is None else weights[k]) / sigma
        # Orthonormal basis of the coordinates, in units of the noise.
        span = np.linalg.qr(free * whitening[:, None])[0]
        for c in cycle.used_force:
            slope = -back @ np.hstack([a * c, of_load]) * whitening[:, None]
            projected = slope - span @ (span.T @ slope)
            total += projected.T @ projected
    return total


def check_calibrated(found, truth, fisher):
    """Check bias, scatter and stated errors of many campaigns with the same truth.

    In units of the bound every error has u components of variance 1. The mean square of N campaigns
    has a relative error of root(2 / u N), 3.0 % for u = 19 and N = 120; the rms has half of that.
    """
    errors = np.array([f.values for f in found]) - truth
    campaigns, u = errors.shape
    root = np.linalg.cholesky(fisher)
    white = errors @ root
    ratio = np.sqrt(np.mean(white**2))  # RMS error over the bound
    sampling = np.sqrt(0.5 / (u * campaigns))
    assert ratio == pytest.approx(1.0, abs=0.03 + 3 * sampling)
    bias = np.mean(white.mean(axis=0) ** 2) - np.mean(white.var(axis=0, ddof=1)) / campaigns
    assert bias < 0.1**2  # a tenth of the scatter; sampling leaves root(2 / u) / N, 0.003
    # The same for the stated errors of each campaign.
    stated = np.mean([trace_in(f.reading_covariance, fisher) for f in found])
    assert np.sqrt(stated) == pytest.approx(ratio, rel=0.03 + 3 * sampling)
    rms = np.sqrt(np.mean(errors**2, axis=0))
    stated_rms = np.sqrt(np.mean([np.diag(f.reading_covariance) for f in found], axis=0))
    # Sampling error of each: 1 / root(2 N), four sigma.
    assert stated_rms == pytest.approx(rms, rel=4 / np.sqrt(2 * campaigns))
    each = np.sqrt([np.diag(f.reading_covariance) for f in found])
    # Worst case, fully correlated components: root(0.05 * 0.95 / N), three sigma.
    assert np.mean(np.abs(errors) < 1.96 * each) == pytest.approx(0.95, abs=0.654 / campaigns**0.5)


def trace_in(covariance, fisher):
    """Return the mean variance in units of the bound."""
    return np.trace(covariance @ fisher) / len(fisher)


def check_goodness(found):
    """Check that reduced chi2 is 1 on average and its probability uniform."""
    reduced = np.array([f.goodness.reduced for f in found])
    freedom = found[0].goodness.degrees_of_freedom
    assert reduced.mean() == pytest.approx(1.0, abs=0.02 + 4 * np.sqrt(2 / freedom / len(found)))
    probability = np.array([f.goodness.probability for f in found])
    for level in (0.05, 0.5, 0.95):
        fraction = np.mean(probability < level)
        # Binomial, four sigma, and 0.02 because the noise is estimated.
        sampling = np.sqrt(level * (1 - level) / len(found))
        assert fraction == pytest.approx(level, abs=0.02 + 4 * sampling)


UNEQUAL = np.array([1e-3, 2e-3, 0.5e-3] * 2)
# Options of campaigns, noise, and the FORCERR of each cycle.
BENCHES = {
    "two loads": ({"cycles": 3, "loads": EXACT}, SIGMA, [None] * 6),
    "three loads": ({"cycles": 3, "loads": EXACT_THREE}, SIGMA, [None] * 9),
    "a tilt instead of the ring": ({"cycles": 3, "loads": EXACT_TILT}, SIGMA, [None] * 6),
    "curved": ({"cycles": 3, "loads": EXACT, "layout": CURVED}, SIGMA, [None] * 6),
    "disabled": ({"cycles": 3, "loads": EXACT, "disabled": (2, 7)}, SIGMA, [None] * 6),
    "P45": ({"cycles": 3, "loads": EXACT, "layout": p45().layout}, SIGMA, [None] * 6),
    "noise by actuator": ({"cycles": 4, "loads": EXACT}, SIGMA * np.tile([1, 3], 7), [None] * 8),
    "one cycle, noise declared": ({"cycles": 1, "loads": EXACT}, SIGMA, [SIGMA] * 2),
    "one cycle": ({"cycles": 1, "loads": EXACT}, SIGMA, [None] * 2),
    "noise by cycle": ({"cycles": 3, "loads": EXACT}, UNEQUAL[:, None], UNEQUAL.tolist()),
}


@pytest.mark.parametrize(
    ("bench", "campaigns"),
    [
        ("two loads", FEW),
        ("one cycle, noise declared", FEW),
        *(pytest.param(b, MANY, marks=pytest.mark.study) for b in BENCHES),
    ],
)
def test_scatter_reaches_the_cramer_rao_bound(bench, campaigns):
    options, sigma, declared = BENCHES[bench]
    quiet, truth = campaign_of(11, 0.0, weight_error=0.0, **options)
    quiet = changed(quiet, force_error=lambda k, _: declared[k])
    found = [find(noisy(quiet, sigma, [12, k])) for k in range(campaigns)]
    weights = (0.5e-3 / UNEQUAL) ** 2 if bench == "noise by cycle" else None
    of_one = 0.5e-3 if bench == "noise by cycle" else sigma
    n = int(quiet.layout.enabled.sum())
    check_calibrated(found, truth, information(quiet, truth, np.broadcast_to(of_one, n), weights))
    against = {"one cycle, noise declared": "FORCERR", "one cycle": "minimum"}.get(bench, "repeats")
    assert {f.goodness.against for f in found} == {against}
    assert max(f.diagnosis.undetermined for f in found) == 0
    if against == "minimum":
        assert np.isnan(found[0].goodness.probability)
        noise = np.array([f.noise for f in found])
        # One campaign: 1 / root(2 DOF) = 5.8 %; their mean: an eleventh of it.
        assert noise.mean() == pytest.approx(SIGMA, rel=0.02)
        freedom = found[0].goodness.degrees_of_freedom
        assert np.std(noise) / SIGMA == pytest.approx(1 / np.sqrt(2 * freedom), rel=0.25)
    else:
        check_goodness(found)


ELASTIC_NOISE = 2e-4  # of an element of a unit mode


def with_matrix(campaign, truth, seed, noise=ELASTIC_NOISE):
    """Return the campaign with a stiffness matrix whose modes have equal noise.

    All modes are equally stiff, so that equal noise in the matrix is equal noise in every mode.
    """
    random = np.random.default_rng(seed)
    a, n = arms_of(LAYOUT), LAYOUT.n
    balanced = scipy.linalg.null_space(a * truth[:n])
    k = balanced @ scipy.linalg.null_space(a).T + noise * random.standard_normal((n, n))
    matrix = StiffnessMatrix("TEST", START, LAYOUT, 3e5 * k)
    return Campaign(campaign.cycles, matrix)


def elastic_information(truth, unknowns, noise=ELASTIC_NOISE):
    """Return the information of the modes on alpha, by brute force."""
    a, n = arms_of(LAYOUT), LAYOUT.n
    arms = a * truth[:n]
    s_inverse = np.linalg.inv(noise**2 * arms @ arms.T)
    total = np.zeros((unknowns, unknowns))
    for u in scipy.linalg.null_space(arms).T:
        total[:n, :n] += (a * u).T @ s_inverse @ (a * u)
    return total


@pytest.mark.study
@pytest.mark.parametrize("repeats", [True, False])
def test_a_stiffness_matrix_adds_its_information_to_that_of_cycles(repeats):
    cycles = 3 if repeats else 1
    quiet, truth = campaign_of(19, 0.0, cycles=cycles, weight_error=0.0, loads=EXACT)
    found = [find(with_matrix(noisy(quiet, SIGMA, [20, k]), truth, [21, k])) for k in range(MANY)]
    alone = information(quiet, truth, np.full(14, SIGMA))
    both = alone + elastic_information(truth, len(truth))
    gain = np.trace(np.linalg.inv(both)[:14, :14]) / np.trace(np.linalg.inv(alone)[:14, :14])
    assert gain < 0.95
    # The noise of the modes is estimated with 33 - 13 degrees of freedom, to 16 %.
    errors = (np.array([f.values for f in found]) - truth) @ np.linalg.cholesky(both)
    ratio = np.sqrt(np.mean(errors**2))
    assert ratio == pytest.approx(1.0, abs=0.08)
    stated = np.sqrt(np.mean([trace_in(f.reading_covariance, both) for f in found]))
    assert stated == pytest.approx(ratio, rel=0.08)
    noise = np.mean([f.noise for f in found])
    assert noise == pytest.approx(SIGMA, rel=0.02)


@pytest.mark.study
@pytest.mark.parametrize("loads", [BARE_AND_RING, THREE])
def test_errors_of_weights_are_covered_and_reach_the_bound(loads):
    """Declared weights differ from the true ones by their errors."""
    quiet, truth = campaign_of(22, 0.0, cycles=2, loads=loads)
    sources, n = weight_errors(quiet), 14
    fisher = information(quiet, truth, np.full(n, SIGMA))
    prior = np.zeros(len(fisher))
    prior[-len(sources) :] = 1.0
    bound = np.linalg.inv(fisher + np.diag(prior))[: len(truth), : len(truth)]
    white, inside = [], []
    for k in range(300):
        random = np.random.default_rng([23, k])
        declared = declared_weights(quiet, random)
        f = find(noisy(declared, SIGMA, random))
        error = f.values - truth
        white.append(np.linalg.solve(np.linalg.cholesky(bound), error))
        variance = np.diag(f.reading_covariance + f.systematic_covariance)
        inside.append(np.abs(error)[:n] < 1.96 * np.sqrt(variance)[:n])
    # 300 campaigns of 19 or 21 components; the common scale is one of them.
    assert np.sqrt(np.mean(np.square(white))) == pytest.approx(1.0, abs=0.05)
    # All actuators share the scale: root(0.05 * 0.95 / 300) = 1.3 %, three sigma.
    assert np.mean(inside) == pytest.approx(0.95, abs=0.038)


def declared_weights(quiet, random):
    """Return a campaign whose declared weights and tilt are off by their standard errors."""
    weight = quiet.weight + quiet.weight_error * random.standard_normal()
    loads = {
        load.key: replace(
            load,
            added=min(load.added + load.added_error * random.standard_normal(), 0.0),
            tilt=load.tilt + load.tilt_error * random.standard_normal(),
        )
        for load in quiet.loads
    }
    return changed(quiet, weight=weight, load=lambda _, c: loads[c.load.key])


@pytest.mark.parametrize("noise", [4e-6, 1e-4])
def test_stated_errors_are_valid_for_low_noise(noise):
    """The lowest noise, 4 uN, is that of means of the control loop."""
    quiet, truth = campaign_of(25, 0.0, cycles=2)
    exact = campaign_of(25, 0.0, cycles=2, loads=EXACT, weight_error=0.0)[0]
    fisher = information(exact, truth, np.full(14, noise))
    for k in range(10):
        f = find(noisy(quiet, noise, [26, k]))
        white = (f.values - truth) @ np.linalg.cholesky(fisher)
        assert white @ white < scipy.stats.chi2.isf(1e-4, 19)
        bound = np.sqrt(np.diag(np.linalg.inv(fisher)))
        assert np.sqrt(np.diag(f.reading_covariance)) == pytest.approx(bound, rel=0.25)


# Convergence and conditioning.


def test_the_minimum_does_not_depend_on_the_start():
    quiet, truth = campaign_of(28, SIGMA, cycles=1, loads=EXACT)
    sets = [part for part, _ in quiet_sets(quiet, SIGMA)]
    prior, a = Prior(np.zeros(19), np.zeros((19, 19))), arms_of(LAYOUT)
    best = minimise(a, sets, prior, start_values(a, sets, prior)).values
    for seed in range(10):
        start = truth + 0.3 * np.random.default_rng(seed).standard_normal(19)
        assert minimise(a, sets, prior, start).values == pytest.approx(best, abs=1e-6)


@pytest.mark.parametrize("kind", ["quiet", "noisy", "three loads", "one disabled", "population"])
def test_the_condition_number_is_that_of_e(kind):
    """CONDITIO is computed iteratively. The noise of repeats adds to E."""
    options = {"noisy": {"noise": 0.01, "cycles": 1}, "three loads": {"loads": THREE},
               "one disabled": {"disabled": (4,)}}.get(kind, {})  # fmt: skip
    campaign, _ = campaign_of(40, **{"noise": 1e-5} | options)
    found = calibrate(campaign, population=kind == "population")
    assert found.condition == pytest.approx(condition_in_units_of_rms(campaign), rel=1e-3)


# Population prior.


def test_a_population_prior_is_optional_and_shrinks_alpha_to_the_mean():
    campaign, _ = campaign_of(29, 5e-3, cycles=2, shapes=6, loads=EXACT, weight_error=0.0)
    plain, pooled = calibrate(campaign), calibrate(campaign, population=True)
    assert plain.method == "ml"
    assert pooled.method.startswith("ml, population 0.")
    assert np.std(pooled.alpha) < np.std(plain.alpha)
    assert (pooled.statistical_error < plain.statistical_error).mean() > 0.7
    with pytest.raises(UnknownName, match="svd takes neither a population"):
        calibrate(campaign, "svd", population=True)


def test_inconsistent_weights_cause_a_warning():
    """One of three loads is wrong by 20 sigma; two loads could not show this."""
    campaign, _ = campaign_of(40, 1e-4, loads=THREE)
    assert find(campaign).diagnosis.warnings == ()
    ring = campaign.loads[1]
    wrong = replace(ring, added=ring.added - 20 * ring.added_error)
    found = find(changed(campaign, load=lambda _, c: wrong if c.load.name == "ring" else c.load))
    assert found.diagnosis.warnings[0].fault.startswith("the weights of the 3 loads disagree by ")


def test_all_files_have_equal_weight_if_one_declares_no_noise():
    campaign, _ = campaign_of(41, 1e-5, cycles=3)
    undeclared = find(campaign)
    one = find(changed(campaign, force_error=lambda k, _: None if k else 1e-5))
    assert one.values == pytest.approx(undeclared.values, rel=1e-12, abs=1e-14)
    assert one.noise == pytest.approx(undeclared.noise, rel=1e-12)


def test_a_large_mirror_with_low_noise_is_calibrated():
    """With 672 actuators at 10 uN, the information spans twelve orders of magnitude."""
    campaign, truth = campaign_of(42, 1e-5, layout=lbt672().layout, cycles=2)
    found = calibrate(campaign)
    error = (found.alpha - truth[:672]) / found.statistical_error
    assert np.sqrt(np.mean(error**2)) < 1.6  # a few patterns and the common scale dominate
    assert found.diagnosis.undetermined == 0
    assert found.goodness.reduced == pytest.approx(1.0, abs=0.1)


def places(n):
    """Return (3, n) arms of actuators scattered over a disc."""
    random = np.random.default_rng(1)
    radius, angle = np.sqrt(random.random(n)), 2 * np.pi * random.random(n)
    return np.stack([np.ones(n), radius * np.cos(angle), radius * np.sin(angle)])


def test_the_population_spread_is_estimated_beside_a_smooth_pattern():
    a, random = places(400), np.random.default_rng(2)
    covariance = np.diag(random.uniform(0.01, 0.03, 400) ** 2)
    found = []
    for _ in range(20):
        log_alpha = 0.5 * (a[1] ** 4 - a[2] ** 2 * a[1]) + 0.02 * random.standard_normal(400)
        alpha = np.exp(log_alpha)
        noise = alpha * (np.linalg.cholesky(covariance) @ random.standard_normal(400))
        scaled = covariance * np.outer(alpha, alpha)
        found.append(likeliest_spread(smooth_patterns(a), alpha + noise, scaled))
    assert np.mean(found) == pytest.approx(0.02, rel=0.05)


@pytest.mark.parametrize("n", [45, 400])
def test_a_population_prior_does_not_change_a_smooth_alpha(n):
    """Smooth means of degree 2, and of degree 4 with many actuators. The scale is kept as well."""
    a = places(n)
    rise = 0.3 * (a[1] ** 2 + a[2]) + (0.2 * a[1] ** 3 * a[2] if n > 100 else 0.0)
    alpha = 1.7 * np.exp(rise)
    before = Prior(np.ones(n), np.zeros((n, n)))
    prior = with_population(before, smooth_patterns(a), alpha, 0.02)
    gradient = prior.information @ (alpha - prior.mean)
    assert np.abs(gradient).max() < 1e-8 * np.abs(prior.information).max()
    assert prior.mean.mean() == pytest.approx(1.0, rel=1e-12)


@pytest.mark.study
def test_errors_cover_an_alpha_that_increases_towards_the_rim():
    """Alpha of P45 increases by 10 % and scatters by 2 %; elements have a noise of 300 N/m."""
    truth, covered = p45_bench().truth, []
    radius = np.hypot(*arms(truth.layout)[1:])
    for seed in range(60):
        random = np.random.default_rng([3, seed])
        alpha = (
            1.0 + 0.1 * (radius / radius.max()) ** 2 + 0.02 * random.standard_normal(radius.size)
        )
        k = truth.stiffness / alpha[:, None] + 300 * random.standard_normal(truth.stiffness.shape)
        matrix = StiffnessMatrix("P45", START, truth.layout, k)
        fit = column_fit(columns_of(screen_matrix(matrix)), population=True)
        error = np.abs(fit.alpha - alpha / alpha.mean())
        covered.append(np.mean(error < 1.96 * np.sqrt(np.diag(fit.covariance))))
    assert 0.91 < np.mean(covered) < 0.98
