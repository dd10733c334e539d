"""Forces of turbulence on the measured LBT672 matrix, beside figures that others computed."""

from dataclasses import replace

import numpy as np
import pytest

import truenewton as tn
from truenewton.modal.modal_base import modal_base
from truenewton.modal.true_stiffness import true_stiffness
from truenewton.modal.turbulence import Atmosphere, Pupil, seen_turbulence, structure_function

NUMBERS = np.array([100, 200, 400, 600, 650])
PUPIL, EFFICIENCY = Pupil(radius=0.452, diameter=8.22), 0.508
# seeing: force rms and of the worst actuator [mN], residual surface [nm]; power of all modes [W]
COMPUTED = {
    0.8: ([16, 27, 78, 178, 226], [24, 36, 186, 340, 421], [90, 66, 43, 19], 128),
    1.5: ([27, 45, 132, 300, 381], [41, 60, 313, 575, 711], [153, 111, 73, 32], 366),
}


def cost_of(matrix, calibration, seen):
    stiffness = true_stiffness(matrix, calibration)
    return modal_base(matrix, stiffness, stiffness.modes, seen, np.zeros(650), EFFICIENCY).costs[0]


@pytest.mark.parametrize("seeing", [0.8, 1.5])
def test_forces_residual_and_power_are_those_computed_elsewhere(real_matrix, seeing):
    """Uncalibrated, and with piston in the turbulence, as they were computed."""
    atmosphere, layout = Atmosphere(seeing), real_matrix.layout
    x, y = (PUPIL.diameter / 2 / PUPIL.radius * v for v in (layout.x, layout.y))
    seen = seen_turbulence(layout, layout.enabled, atmosphere, PUPIL)
    variance = structure_function(np.array(1e9), atmosphere) / 2
    distance = np.hypot(x[:, None] - x, y[:, None] - y)
    with_piston = variance - structure_function(distance, atmosphere) / 2
    cost = cost_of(real_matrix, None, replace(seen, wavefront=with_piston))
    at = NUMBERS - 1
    rms, worst, surface, power = COMPUTED[seeing]
    assert 1e3 * np.sqrt(np.mean(cost.force[:, at] ** 2, axis=0)) == pytest.approx(rms, rel=0.1)
    assert 1e3 * cost.force[:, at].max(axis=0) == pytest.approx(worst, rel=0.1)
    assert 0.5e9 * cost.residual[at[:-1]] == pytest.approx(surface, rel=0.1)
    assert cost.power[:, -1].sum() == pytest.approx(power, rel=0.1)


@pytest.mark.study
def test_alpha_and_a_turbulence_without_piston_save_a_third_of_the_power(real_matrix):
    layout = real_matrix.layout
    seen = seen_turbulence(layout, layout.enabled, Atmosphere(0.8), PUPIL)
    before, after = (cost_of(real_matrix, c, seen) for c in (None, tn.calibrate(real_matrix, "ml")))
    assert after.power[:, -1].sum() < before.power[:, -1].sum() < 0.8 * 128
    assert after.power[:, -1].sum() < 0.72 * 128
    assert after.force[:, -1].max() < 0.8 * before.force[:, -1].max() < 0.6 * 0.421
