"""Mistakes of geometry and processing leave a pattern in the imbalance of a matrix."""

from dataclasses import replace

import numpy as np
import pytest

import truenewton as tn
from studies.matrices import measured_or_made, noisy, true_stiffness
from studies.matrix_grades import mistakes, sound_matrices
from studies.simulated_matrices import hexagon, springs
from truenewton.estimation.findings.code import LIMITS
from truenewton.estimation.matrix.coherent_imbalance import (
    coherent_imbalance,
    patterns_of,
    sensor_gains,
)
from truenewton.estimation.matrix.facts import (
    MatrixFacts,
    doubts_of,
    negative_modes,
    symmetry_of,
)
from truenewton.estimation.matrix.modes import column_fit, columns_of
from truenewton.estimation.matrix.screen import screen_matrix
from truenewton.statics.arms import comparable_arms

Level, Code = tn.Level, tn.Code
pytestmark = pytest.mark.filterwarnings("ignore::truenewton.errors.TrueNewtonWarning")


@pytest.fixture(scope="module")
def p45():
    """Return an exact stiffness of P45, and one with alpha and noise."""
    made = measured_or_made("p45")
    exact = true_stiffness(made)
    alpha, matrix = noisy(made, exact, 3, "equal", 5e-5)
    return replace(made, stiffness=exact), matrix, alpha


@pytest.fixture(scope="module")
def sound():
    """Return sound matrices with little noise, and their alpha, by name."""
    return {name: each for name, *each in sound_matrices(101) if "0.0005" not in name}


def test_patterns_are_the_derivatives_of_the_imbalance(p45):
    """Compare with differences of the balance, for a ring 1 um wider and a diagonal 1e-6 larger."""
    exact, *_ = p45
    arms = comparable_arms(exact.layout)
    q = np.linalg.qr(arms.T)[0]
    m = exact.stiffness / np.median(np.diag(exact.stiffness))
    patterns = list(patterns_of(m, arms, q))
    radius = np.hypot(*arms[1:])
    rings = [each for each in patterns if each.name.startswith("the radius of ring")]
    edges = np.unique(np.round(radius, 3))
    assert len(rings) == len(edges)
    for ring, edge in zip(rings, edges, strict=True):
        wider = arms.copy()
        wider[1:] *= np.where(np.abs(radius - edge) < 1e-3, 1.0 + 1e-6 / radius, 1.0)
        change = np.linalg.inv(arms @ q) @ (wider - arms) @ m / 1e-6
        np.testing.assert_allclose(
            -change, ring.imbalance, rtol=3e-3, atol=1e-6
        )  # NZ at the rim: 0.998
    diagonal = next(each for each in patterns if each.name == "the diagonal of the matrix")
    np.testing.assert_allclose(q.T @ np.diag(np.diag(m)), diagonal.imbalance, atol=1e-12)


def test_the_predicted_shift_is_the_error_of_alpha(p45):
    """For a ring 1 mm wider, the pattern explains all imbalance; the shift restores the truth."""
    exact, *_ = p45
    layout, radius = exact.layout, np.hypot(exact.layout.x, exact.layout.y)
    middle = np.abs(radius - np.unique(np.round(radius, 3))[1]) < 5e-3
    part = np.where(middle, 1.0 + 1e-3 / radius, 1.0)
    wrong = replace(exact, layout=replace(layout, x=layout.x * part, y=layout.y * part))
    found = column_fit(columns_of(screen_matrix(wrong)))
    pattern = coherent_imbalance(wrong.stiffness, comparable_arms(wrong.layout), found.alpha)
    assert pattern.names[0] == "the radius of ring 2"
    assert pattern.share > 0.95
    remaining = np.log(found.alpha) + pattern.shift
    assert np.std(np.log(found.alpha)) > 0.02
    assert np.std(remaining) < 0.05 * np.std(np.log(found.alpha))


WRONG = {  # matrices whose stated errors would not be valid
    "middle ring 0.5 mm wider": (Code.COHERENT_IMBALANCE, "ml"),
    "middle ring 2 mm wider": (Code.COHERENT_IMBALANCE, "ml"),
    "middle ring 6 mm wider": (Code.COHERENT_IMBALANCE, "ml"),
    "positions along a surface (2 % at the rim)": (Code.COHERENT_IMBALANCE, "ml"),
    "positions stretched 1 % to one side": (Code.GAINS_HAVE_GRADIENT, "ml"),
    "diagonal 1 % too large": (Code.COHERENT_IMBALANCE, "svd"),
    "50 % of rigid motions removed": (Code.GAINS_FOLLOW_ALPHA, "svd"),
}
SLOW = [
    "middle ring 0.5 mm wider",
    "middle ring 6 mm wider",
    "positions along a surface (2 % at the rim)",
]


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=[pytest.mark.study] * (n in SLOW)) for n in WRONG]
)
def test_a_mistake_not_covered_by_the_errors_is_doubtful_or_rejected(p45, name):
    code, method = WRONG[name]
    found = tn.calibrate(dict(mistakes(p45[1]))[name], method)
    assert found.verdict.level <= Level.DOUBTFUL
    assert code in {each.code for each in found.findings}
    if code is Code.COHERENT_IMBALANCE:  # the errors include how far the pattern moves alpha
        error = found.alpha - p45[2] / p45[2].mean()
        assert np.mean(error**2) < 2.0 * np.mean(found.error**2)


@pytest.mark.parametrize("method", ["svd", pytest.param("ml", marks=pytest.mark.study)])
def test_sound_matrices_are_not_doubtful(sound, method):
    levels = {name: tn.calibrate(each, method).verdict.level for name, (each, _) in sound.items()}
    assert len(levels) >= 6
    assert min(levels.values()) >= Level.USABLE, levels


def test_stiff_negative_modes_are_not_excused_by_a_large_noise(p45):
    """A tenth of the stiffness is noise: half of the modes are lost in it."""
    exact, *_ = p45
    k, random = np.asarray(exact.stiffness), np.random.default_rng(18)
    for level, code in ((0.1, Code.NEGATIVE_MODES), (1e-3, Code.NEGATIVE_MODES_IN_NOISE)):
        noisy_k = k + level * np.median(np.diag(k)) * random.standard_normal(k.shape)
        facts = MatrixFacts(noisy_k, comparable_arms(exact.layout))
        found = [*doubts_of(noisy_k, np.ones(45), symmetry_of(facts, np.ones(45)))]
        [negative] = [each for each in found if each.code.startswith("negative-modes")]
        assert negative.code is code
        assert negative.level == ("doubtful" if code is Code.NEGATIVE_MODES else "usable")


def gains_of_hexagon(log_gain, seed):
    """Return what the gains of 37 sensors show if alpha is known to 0.05 %."""
    layout, random = hexagon(3), np.random.default_rng([seed, 12])
    k = springs(layout, lambda square: square * np.log(square))
    alpha = np.exp(random.normal(0.0, 0.05, layout.n))
    k = k * (1.0 + 2e-4 * random.standard_normal(k.shape)) / alpha[:, None] * np.exp(log_gain)
    facts = MatrixFacts(k, comparable_arms(layout))
    return sensor_gains(facts, alpha, np.diag((5e-4 * alpha) ** 2))


@pytest.mark.parametrize("scatter", [0.001, 0.005, 0.02])
def test_the_gradient_of_independent_gains_is_no_finding(scatter):
    random = np.random.default_rng(int(1e4 * scatter))
    sizes = [
        gains_of_hexagon(scatter * random.standard_normal(37), seed).gradient_sigmas
        for seed in range(20)
    ]
    assert max(sizes) < 4.0  # chance: exp(-16) each
    assert 0.4 < np.median(sizes) < 1.4  # of two normal components: 0.83


def test_a_gradient_of_the_gains_beyond_their_scatter_is_a_finding():
    layout = hexagon(3)
    gradient = 0.02 * layout.x / layout.x.max()
    scatter = 0.002 * np.random.default_rng(3).standard_normal(layout.n)
    found = gains_of_hexagon(scatter + gradient, 1)
    assert found.gradient_sigmas > LIMITS.gradient_sigmas


def test_symmetry_and_negative_modes_agree_with_construction(p45):
    exact, matrix, alpha = p45
    k, ones = np.asarray(exact.stiffness), np.ones(45)
    assert symmetry_of(MatrixFacts(k, np.ones((3, len(k)))), ones).asymmetry == pytest.approx(
        0.0, abs=1e-12
    )
    facts = symmetry_of(MatrixFacts(k / alpha[:, None], np.ones((3, len(k)))), alpha)
    assert facts.asymmetry > 0.01
    assert facts.asymmetry_with_alpha == pytest.approx(0.0, abs=1e-12)
    assert negative_modes(matrix.stiffness, alpha)[0].size == 0
    values, vectors = np.linalg.eigh(k)
    turned = k - 2.0 * np.outer(vectors[:, 10], vectors[:, 10]) * values[10]
    assert negative_modes(turned, ones)[0] == pytest.approx([-values[10]], rel=1e-9)
    found = tn.calibrate(replace(matrix, stiffness=turned / alpha[:, None]), "svd")
    [negative] = [each for each in found.findings if each.code is Code.NEGATIVE_MODES]
    assert negative.values["count"] == 1
    assert found.verdict.level <= Level.DOUBTFUL


@pytest.mark.parametrize("method", ["svd", pytest.param("ml", marks=pytest.mark.study)])
def test_an_element_that_is_wrong_by_20_percent_is_found(sound, method):
    """Sensors are off their magnets, so that the symmetry of pairs does not reveal it."""
    matrix, alpha = sound["annular, 0.3 mm off"]
    k, random = np.array(matrix.stiffness), np.random.default_rng(1)
    coupled = (np.abs(k) > 0.02 * np.median(np.diag(k))) & ~np.eye(45, dtype=bool)
    for row, column in random.choice(np.argwhere(coupled), 4, replace=False):
        wrong = k.copy()
        wrong[row, column] *= 1.2
        found = tn.calibrate(replace(matrix, stiffness=wrong), method)
        on = np.isfinite(found.alpha)
        assert np.std((found.alpha - alpha / alpha[on].mean())[on] / found.error[on]) < 2.5
        named = {i for each in found.findings for i in each.actuators}
        assert {int(matrix.layout.id[row]), int(matrix.layout.id[column])} & named
