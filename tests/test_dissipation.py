"""Forces and powers of turbulence: against sampled wavefronts and plain sums."""

import numpy as np
import pytest

from truenewton.errors import FormatError
from truenewton.modal.dissipation import Limits, dissipation


@pytest.fixture(scope="module")
def case():
    rng = np.random.default_rng(7)
    n = 12
    root = rng.standard_normal((n, n)) * 1e-7
    stiffness = rng.standard_normal((n, n)) * 1e6
    modes = np.linalg.qr(rng.standard_normal((n, n)))[0]
    alpha = rng.uniform(0.7, 1.1, n)
    static = rng.uniform(-0.1, 0.1, n)
    cost = dissipation("any", modes, stiffness, root @ root.T, alpha=alpha, static=static)
    return root, stiffness, modes, alpha, static, cost


@pytest.mark.parametrize("number", [1, 2, 7, 12])
def test_forces_and_residual_are_those_of_the_projected_wavefront(case, number):
    root, stiffness, modes, _, _, cost = case
    used = modes[:, :number]
    projector = used @ used.T
    surface = projector @ (root @ root.T / 4) @ projector
    force = np.sqrt(np.diag(stiffness @ surface @ stiffness.T))
    np.testing.assert_allclose(cost.force[:, number - 1], force, rtol=1e-10)
    rest = np.eye(12) - projector
    left = np.sqrt(np.trace(rest @ root @ root.T @ rest) / 12)
    assert cost.residual[number - 1] == pytest.approx(left, rel=1e-10, abs=1e-20)


def test_power_is_that_of_sampled_wavefronts(case):
    root, stiffness, modes, alpha, static, cost = case
    waves = root @ np.random.default_rng(1).standard_normal((12, 40_000))
    used = modes[:, :5]
    force = stiffness @ used @ (used.T @ (waves / 2)) + static[:, None]
    heat = np.mean((force / alpha[:, None] / 0.51) ** 2, axis=1)
    # The mean of 40,000 squares is known to 0.7 %.
    np.testing.assert_allclose(cost.power[:, 4], heat, rtol=0.035)


def test_the_number_of_modes_is_the_largest_within_the_limits(case):
    *_, cost = case
    worst = cost.power.max(axis=0)
    for number in range(1, 13):
        limit = worst[:number].max()
        found = cost.modes_within(Limits(power=limit))
        assert found >= number
        assert worst[:found].max() <= limit
        assert found == 12 or worst[found] > limit
    reach = cost.reach.max(axis=0)
    assert cost.modes_within(Limits(force=reach[:6].max())) >= 6
    assert cost.modes_within(Limits(power=1e-9)) == 0
    assert cost.modes_within(Limits(force=np.abs(cost.static).max())) == 0
    assert cost.modes_within(Limits()) == 12


def test_a_higher_alpha_takes_force_but_no_power(case):
    *_, cost = case
    reach, power = cost.reach.max(axis=0), cost.power.max(axis=0)
    limits = Limits(force=1.0001 * reach.max())
    assert cost.modes_within(limits) == 12
    assert cost.modes_within(limits, alpha_error=0.05) < 12
    assert cost.modes_within(Limits(power=1.0001 * power.max()), alpha_error=0.05) == 12


@pytest.mark.parametrize("limit", [{"power": 0.0}, {"force": -1.0}, {"power": np.nan}])
def test_limits_are_positive(limit):
    with pytest.raises(FormatError):
        Limits(**limit)
