"""Each constant that decides about a matrix: a case just below, and a case just above."""

from functools import cache
from types import SimpleNamespace
from unittest import mock

import numpy as np

from helpers.thresholds import between, outcome
from truenewton.bench.simulated.static import static_bench
from truenewton.estimation.findings.code import Code
from truenewton.estimation.matrix import (
    coherent_imbalance,
    columns,
    couplings,
    facts,
    misfits,
    modes,
    order,
    screen,
)
from truenewton.estimation.matrix.facts import MatrixFacts
from truenewton.mirrors.known import ring
from truenewton.statics.arms import comparable_arms
from truenewton.statics.layout import rings

LAYOUT = rings([0.03, 0.06, 0.09], [6, 12, 18])


def codes(findings):
    return [finding.code for finding in findings]


# -- facts ---------------------------------------------------------------------------------------


def elastic_modes(smallest):
    """Of 10 modes 6 are stiff and 3 rigid."""
    values = np.array([1.0] * 6 + [smallest] + [0.0] * 3)
    found = SimpleNamespace(_decomposition=(np.eye(10), values, np.eye(10)))
    return MatrixFacts.elastic_modes.fget(found).values.size


def by_rounding(rigid_cost, imbalance):
    found = SimpleNamespace(
        rigid_cost=rigid_cost, imbalance=imbalance, asymmetry=1e-9, stiffness=np.eye(4)
    )
    return MatrixFacts.balances_by_rounding.func(found)


def transposed(ratio):
    found = SimpleNamespace(rigid_cost=ratio, imbalance=1.0, balances_by_rounding=False)
    return MatrixFacts.looks_transposed.fget(found)


def not_improved(before, ratio):
    symmetry = SimpleNamespace(asymmetry=before, asymmetry_with_alpha=ratio * before)
    return codes(facts.doubts_of(100.0 * np.eye(8), np.ones(8), symmetry))


def negative(edges):
    symmetry = SimpleNamespace(asymmetry=0.0, asymmetry_with_alpha=0.0)
    with mock.patch.object(facts, "negative_modes", return_value=(np.array([-edges]), 1.0)):
        return codes(facts.doubts_of(100.0 * np.eye(8), np.ones(8), symmetry))


# -- order of rows -------------------------------------------------------------------------------


def compliance(cost):
    with mock.patch.object(order, "rigid_cost", return_value=cost):
        return outcome(lambda: order.refuse_compliance(SimpleNamespace(squares=None), LAYOUT))


def true_stiffness(imbalance):
    found = SimpleNamespace(asymmetry=0.0, imbalance=imbalance, balances_by_rounding=False)
    return codes(order.balance_effects(found))


def disordered(size, other=np.inf, explained=0.0):
    """Costs of rigid motions in this order and in another one."""
    found = SimpleNamespace(squares=None, stiffness=None, arms=None)
    with (
        mock.patch.object(order, "rigid_cost", side_effect=[size, other]),
        mock.patch.object(order, "other_orders", return_value=[("reversed", np.arange(36))]),
        mock.patch.object(order, "share_by_distance", return_value=explained),
    ):
        return codes(order.order_effects(found, LAYOUT))


def equal_diagonals(n):
    return outcome(lambda: order.refuse_no_stiffness(np.eye(n) + 0.1))


def explained_at(distance):
    """Couplings at one distance of a row of actuators, none at others: all that far are alike."""
    x = np.arange(30.0)
    apart = np.abs(x[:, None] - x)
    k = np.eye(30) + 0.1 * (apart == distance)
    return order.share_by_distance(k, np.stack([np.ones(30), x, 0.0 * x])) == 1.0


# -- couplings -----------------------------------------------------------------------------------


def is_weak(coupling):
    return bool(np.isnan(couplings.pair_ratios(np.array([[1, coupling], [coupling, 1]]))[1][0, 1]))


def strong_pair_yields(coupling):
    """A pair against two paths of pairs of 0.09, which together count 1.6 times its limit."""
    k = np.eye(4)
    for i, j in ((0, 2), (2, 1), (0, 3), (3, 1)):
        k[i, j] = k[j, i] = 0.09
    k[0, 1], k[1, 0] = coupling * 1.1, coupling / 1.1
    return bool(couplings.pair_ratios(k)[1][0, 1] > 0.1)


# -- misfits -------------------------------------------------------------------------------------


@cache
def sound():
    truth = static_bench(ring(45), 7).truth
    return comparable_arms(truth.layout), truth.stiffness


def reasons(k):
    found, _ = misfits.bad_actuators(MatrixFacts(k, sound()[0]), np.zeros((3, 0)))
    return [each.reason for each in found]


def row_of_alpha(ratio):
    k = sound()[1].copy()
    k[20] *= ratio
    return len(reasons(k))


def sensor_gain(factor, scatter=0.0):
    """Whether the gain of one sensor is found while those of the others scatter."""
    gain = np.exp(scatter * np.random.default_rng(3).standard_normal(45))
    gain[20] = factor
    return misfits.SENSOR_GAIN in reasons(sound()[1] * gain)


def element_changed_by(share):
    k = sound()[1].copy()
    k[20, 21] += share * k[20, 20]
    return misfits.ELEMENT_WRONG in reasons(k)


@cache
def antisymmetric():
    """Return the arms, and a stiffness whose pairs differ by 0.001 of the diagonal elements."""
    arms, k = sound()
    sign = np.triu(np.sign(np.random.default_rng(6).standard_normal(k.shape)), 1)
    own = np.sqrt(np.diag(k))
    return arms, k + 0.5e-3 * (sign - sign.T) * np.outer(own, own)


def element_against_noise(times):
    arms, k = (each.copy() for each in antisymmetric())
    own = np.sqrt(k[3, 3] * k[4, 4])
    middle = 0.5 * (k[3, 4] + k[4, 3])
    k[3, 4], k[4, 3] = middle + 0.5e-3 * times * own, middle - 0.5e-3 * times * own
    found = misfits._mend_elements(k, arms, np.zeros((3, 0)), ())
    return [(3, 4) for row, _ in found if row in (3, 4)]


def column_against_noise(times):
    """The diagonal element is changed, so that its column is out of balance by a multiple."""
    arms, k = (each.copy() for each in antisymmetric())
    usual = np.median(np.linalg.norm(arms @ k, axis=0) / np.diag(k))
    change = times * usual / np.linalg.norm(arms[:, 20])
    k[20, 20] *= 1.0 + change / (1.0 - change)
    return [row for row, _ in misfits._mend_elements(k, arms, np.zeros((3, 0)), ())]


def element_agrees(difference):
    k = np.full((9, 9), 1.0)
    k[:, 0] += difference
    return misfits.agrees(k, 0, np.arange(9) > 0)


def unlike(misfit, usual):
    size = np.full((12, 12), usual)
    size[0] = size[:, 0] = misfit
    return len(misfits._unlike_their_columns(size))


def unknown_force(reason, share):
    return misfits.BadActuator(0, reason, 1.0).doubt > share


# -- balance and noise ---------------------------------------------------------------------------


def looks_for_patterns(n):
    k, arms = sound()[1][:n, :n], sound()[0][:, :n]
    return coherent_imbalance.coherent_imbalance(k, arms, np.ones(n)) is not None


def doubts(share=0.0, shift=1.0, noise=1.0, correlation=0.0, sigmas=9.0, gradient=0.0):
    found = SimpleNamespace(
        share=share, shift=np.full(4, shift), column_noise=np.array([1.0, noise]),
        names=("pattern",), remedy="",
    )  # fmt: skip
    gains = SimpleNamespace(with_alpha=correlation, sigmas=sigmas, gradient_sigmas=gradient)
    with (
        mock.patch.object(coherent_imbalance, "coherent_imbalance", return_value=found),
        mock.patch.object(coherent_imbalance, "sensor_gains", return_value=gains),
    ):
        seen = SimpleNamespace(stiffness=None, arms=None)
        said, _ = coherent_imbalance.doubts_of_balance(seen, np.ones(4), np.eye(4), np.arange(2))
    return codes(said)


def noisy_columns(inflation):
    given = SimpleNamespace(a=np.ones((3, 9)), modes=SimpleNamespace(values=np.ones(6)))
    with mock.patch.object(
        modes, "fit_columns", return_value=(SimpleNamespace(alpha=np.ones(9)), inflation)
    ):
        return outcome(lambda: modes.column_fit(given))


def parameter_costs(gain):
    """Whether a further parameter of the noise must raise the log likelihood by more."""
    plain, mixed = (columns.ColumnNoise(1.0, share) for share in (0.0, 0.5))
    return mixed.cost(np.ones(9)) - plain.cost(np.ones(9)) > gain


def asymmetric(size):
    return codes(modes._not_as_agreed(SimpleNamespace(stiffness=2e6 * np.eye(4), asymmetry=size)))


def many_misfits(count):
    bad = [SimpleNamespace(index=k) for k in range(count)]
    off = np.zeros(100, dtype=bool)
    return codes(screen._warnings(np.arange(100), off, bad, pushing=False))


PATTERN, FOLLOW = [Code.COHERENT_IMBALANCE], [Code.GAINS_FOLLOW_ALPHA]
WORSE = [Code.SYMMETRY_NOT_IMPROVED]
DISORDERED, INCOMPLETE = [Code.DISORDERED_STIFFNESS], [Code.INCOMPLETE_STIFFNESS]
CASES = [
    ("MIN_SINGULAR_VALUE", elastic_modes, 0.9e-4, 6, 1.1e-4, 7),
    ("MAX_SENSOR_COST", lambda x: by_rounding(x, 0.0), 0.049, True, 0.051, False),
    ("MIN_MEASURED_DEVIATION", lambda x: by_rounding(0.0, x), 0.9e-6, True, 1.1e-6, False),
    ("TRANSPOSED_COST_RATIO", transposed, 1.9, False, 2.1, True),
    ("MIN_ASYMMETRY", lambda x: not_improved(x, 1.0), 0.0049, [], 0.0051, WORSE),
    ("asymmetry_ratio", lambda x: not_improved(0.1, x), 0.94, [], 0.96, WORSE),
    ("negative_edges", negative,
     1.4, [Code.NEGATIVE_MODES_IN_NOISE], 1.6, [Code.NEGATIVE_MODES]),
    ("MAX_SOFTEST_COST", compliance, 1.4, "accepted", 1.6, "refused"),
    ("MIN_MEASURED_IMBALANCE", true_stiffness, 0.019, [Code.TRUE_STIFFNESS], 0.021, []),
    ("MAX_RIGID_COST", disordered, 0.11, [], 0.13, DISORDERED),
    ("MIN_COST_RATIO", lambda x: disordered(0.1, 0.1 / x), 2.9, [], 3.1, DISORDERED),
    ("MIN_EXPLAINED_COUPLING", lambda x: disordered(0.13, explained=x),
     0.64, DISORDERED, 0.66, INCOMPLETE),
    ("MIN_JUDGED_ACTUATORS", equal_diagonals, 19, "accepted", 20, "refused"),
    ("NEAR_SPACINGS", explained_at, 11, True, 13, False),
    ("STRONG_COUPLING", is_weak, 0.049, True, 0.051, False),
    ("EQUAL_WEIGHT_COUPLING", strong_pair_yields, 0.09, True, 0.14, True),
    ("MAX_ALPHA_RATIO", row_of_alpha, 2.9, 0, 3.1, 1),
    ("MIN_GAIN_FACTOR", sensor_gain, 1.09, False, 1.11, True),
    ("MIN_GAIN_DEVIATION", lambda x: sensor_gain(x, 0.02), 1.2, False, 1.3, True),
    ("MIN_ELEMENT_DIFFERENCE", element_changed_by, 0.009, False, 0.011, True),
    ("ELEMENT_TOLERANCE", element_agrees, 0.029, True, 0.031, False),
    ("ASYMMETRY_RATIO", lambda x: unlike(x, 0.01), 0.079, 0, 0.081, 1),
    ("MIN_MISFIT", lambda x: unlike(x, 0.001), 0.049, 0, 0.051, 1),
    ("UNKNOWN_FORCE", lambda x: unknown_force(misfits.NO_SENSOR, x), 0.29, True, 0.31, False),
    ("MIN_ACTUATORS", looks_for_patterns, 11, False, 12, True),
    ("pattern_share", lambda x: doubts(share=x), 0.39, [], 0.41, PATTERN),
    ("pattern_shift", lambda x: doubts(share=0.5, shift=x), 0.89, [], 0.91, PATTERN),
    ("column_noise", lambda x: doubts(noise=x), 59.0, [], 61.0, [Code.COLUMNS_UNBALANCED]),
    ("gain_correlation", lambda x: doubts(correlation=x), 0.29, [], 0.31, FOLLOW),
    ("gain_sigmas", lambda x: doubts(correlation=0.5, sigmas=x), 3.4, [], 3.6, FOLLOW),
    ("gradient_sigmas", lambda x: doubts(gradient=x), 6.9, [], 7.1, [Code.GAINS_HAVE_GRADIENT]),
    ("MAX_ASYMMETRY", asymmetric, 0.49, [], 0.51, [Code.ASYMMETRIC_STIFFNESS]),
    ("misfit_fraction", many_misfits, 10, [], 11, [Code.MANY_MISFITS]),
    ("ELEMENT_RATIO", element_against_noise, 29.0, [], 31.0, [(3, 4)]),
    ("COLUMN_IMBALANCE_RATIO", column_against_noise, 11.0, [], 13.0, [20]),
    ("MIN_LOG_LIKELIHOOD_GAIN", parameter_costs, 2.9, True, 3.1, False),
    ("SPURIOUS_FACTOR", noisy_columns, 1.26, "accepted", 1.28, "refused"),
]  # fmt: skip

test_a_threshold_is_between = between(CASES)
