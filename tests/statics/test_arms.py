"""Arms and signs, against numbers worked out by hand: off axis, and nothing zero."""

import numpy as np
import pytest

from studies import faults
from studies.faulty.bench import Day, bench_of
from truenewton.estimation.paper.equations import system_c
from truenewton.statics.arms import effective_weight, enabled_arms, external_load, resultants
from truenewton.statics.layout import layout

# Four actuators, none on an axis, one leaning: (x, y) in metres, forces in Newton.
FOUR = layout([0.3, -0.1, 0.2, -0.4], [0.1, 0.5, -0.2, -0.3], nz=[1.0, 1.0, 0.5, 1.0])
FORCE = np.array([1.0, 2.0, -4.0, 3.0])
# By hand: 1 + 2 - 4 * 0.5 + 3 = 4; 0.3 - 0.2 - 0.8 - 1.2 = -1.9; 0.1 + 1.0 + 0.8 - 0.9 = 1.0.
TOTAL, MOMENT_OF_X, MOMENT_OF_Y = 4.0, -1.9, 1.0


def test_resultants_by_hand():
    assert resultants(FOUR, FORCE) == pytest.approx([TOTAL, MOMENT_OF_X, MOMENT_OF_Y], abs=1e-15)


def test_the_papers_signs_hold_for_bias_and_torques_by_hand():
    """Paper, eq. 1: -sum f = P + B, -sum x f = M_y, -sum y f = -M_x."""
    weight = -3.5
    bias = -TOTAL - weight  # -0.5
    torque_y, torque_x = 1.9, 1.0
    assert bias == -0.5
    k = external_load(weight, bias, torque_y, torque_x)
    assert k.tolist() == [-4.0, 1.9, -1.0]
    assert resultants(FOUR, FORCE) + k == pytest.approx([0, 0, 0], abs=1e-15)


def test_system_c_holds_for_true_forces_and_fails_for_any_sign_turned():
    alpha = np.array([0.8, 0.9, 1.1, 1.05])
    c = np.array([FORCE / alpha])
    signs = (-3.5, -0.5, 1.9, 1.0)
    matrix, p = system_c(c, enabled_arms(FOUR), *signs)
    assert matrix @ alpha == pytest.approx(p, abs=1e-14)
    for k in range(4):
        turned = [-value if i == k else value for i, value in enumerate(signs)]
        _, wrong = system_c(c, enabled_arms(FOUR), *turned)
        assert np.abs(matrix @ alpha - wrong).max() > 0.9


def test_weight_along_the_axis_of_a_tilted_mirror():
    """cos 60 deg = 1/2: a 60 degree tilt takes away half of P + Q."""
    w = effective_weight(-2.920, [0.0, -0.289, 0.0], [0.0, 0.0, 60.0])
    assert w == pytest.approx([-2.920, -3.209, -1.460], rel=1e-15)


QUICK = {fault.happens.__module__: fault for fault in faults.ALL}.values()  # one of each kind


@pytest.mark.parametrize(
    "fault",
    [
        fault if fault in QUICK else pytest.param(fault, marks=pytest.mark.study)
        for fault in faults.ALL
    ],
    ids=lambda fault: fault.name,
)
def test_a_faulty_bench_is_in_balance(fault):
    """What goes wrong in `studies/faults.py` goes wrong as physics: nothing is left over."""
    day = faults.day_with_fault(fault, "p45", seed=1, noise=0.0, cycles=2)
    assert np.abs(day.imbalance).max() < 1e-12
    if fault.happens.__module__ != "studies.faulty.forces":
        weight = -2.920 - 0.289 * day.load
        total = (day.true_force + day.bias) @ day.bench.arms[0]
        assert total == pytest.approx(-weight, abs=1e-12)


@pytest.mark.parametrize("name", ["clean", "gradients not declared, 10 uN", "coils 1 % cubic"])
def test_a_faulty_bench_reads_what_its_coils_give(name):
    fault = next(fault for fault in faults.ALL if fault.name.startswith(name))
    day = Day(bench_of("p45"), seed=1, noise=0.0, order=[0, 1])
    fault.happens(day)
    c = day.readings
    assert day.alpha * day.gain * day.law(c) * c == pytest.approx(day.true_force, abs=1e-15)


@pytest.mark.study
def test_a_bench_without_fault_is_covered():
    clean = faults.ALL[0]
    days = [faults.day_with_fault(clean, "p45", seed, 1e-3, 4) for seed in range(6)]
    figures = faults.summary(clean, [faults.trial(day) for day in days])
    assert figures["verdict"] == "covered"
    assert figures["covers"] > 93
    assert 0.3 < float(figures["error"]) < 0.5
    assert figures["said"] == 0
