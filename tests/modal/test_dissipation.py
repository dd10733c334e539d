"""Forces and powers of turbulence: against sampled wavefronts and plain sums."""

import dataclasses
import datetime

import numpy as np
import pytest

import truenewton as tn
from truenewton.errors import FormatError
from truenewton.modal.modal_base import Budget, dissipation
from truenewton.modal.true_stiffness import true_stiffness
from truenewton.modal.turbulence import Atmosphere, Pupil, SeenTurbulence

N = 12
ALL = np.ones(N, dtype=bool)


def stiffness_of(forces, followers, alpha, commanded):
    """Return twelve actuators, of which some are commanded and the others follow as told."""
    layout = tn.rings([0.05, 0.1], [4, 8])
    matrix = tn.StiffnessMatrix("TINY", datetime.datetime(2026, 5, 4), layout, np.eye(N))
    slaved = layout.id[~commanded].tolist()
    return dataclasses.replace(
        true_stiffness(matrix, None, slaved=slaved),
        acting_stiffness=forces, followers=followers, enabled_alpha=alpha,
    )  # fmt: skip


def seen(wavefront, commanded):
    m = int(commanded.sum())
    return SeenTurbulence(Atmosphere(1.0), Pupil(0.1, 1.0), wavefront, np.eye(m), np.eye(m))


@pytest.fixture(scope="module")
def case():
    rng = np.random.default_rng(7)
    root = rng.standard_normal((N, N)) * 1e-7
    forces = rng.standard_normal((N, N)) * 1e6
    modes = np.linalg.qr(rng.standard_normal((N, N)))[0]
    alpha = rng.uniform(0.7, 1.1, N)
    static = rng.uniform(-0.1, 0.1, N)
    stiffness = stiffness_of(forces, np.empty((0, N)), alpha, ALL)
    cost = dissipation("any", modes, stiffness, seen(root @ root.T, ALL), static, 0.51)
    return root, forces, modes, alpha, static, cost


@pytest.mark.parametrize("number", [1, 2, 7, 12])
def test_forces_and_residual_are_those_of_the_projected_wavefront(case, number):
    root, forces, modes, _, _, cost = case
    used = modes[:, :number]
    projector = used @ used.T
    surface = projector @ (root @ root.T / 4) @ projector
    force = np.sqrt(np.diag(forces @ surface @ forces.T))
    np.testing.assert_allclose(cost.force[:, number - 1], force, rtol=1e-10)
    rest = np.eye(N) - projector
    left = np.sqrt(np.trace(rest @ root @ root.T @ rest) / N)
    assert cost.residual[number - 1] == pytest.approx(left, rel=1e-10, abs=1e-20)


@pytest.mark.parametrize("number", [1, 4, 9])
def test_those_that_follow_leave_what_they_do_not_hit(number):
    rng = np.random.default_rng(9)
    commanded = ~np.isin(np.arange(N), [2, 5, 11])
    root = rng.standard_normal((N, N)) * 1e-7
    shapes = np.zeros((N, 9))
    shapes[commanded] = np.eye(9)
    shapes[~commanded] = rng.standard_normal((3, 9))
    modes = np.linalg.qr(rng.standard_normal((9, 9)))[0]
    stiffness = stiffness_of(rng.standard_normal((N, N)), shapes[~commanded], np.ones(N), commanded)
    cost = dissipation("any", modes, stiffness, seen(root @ root.T, commanded), np.zeros(N), 0.51)
    used = modes[:, :number]
    hit = shapes @ used @ used.T @ np.eye(N)[commanded]
    rest = (np.eye(N) - hit) @ root
    assert cost.residual[number - 1] == pytest.approx(np.sqrt(np.sum(rest**2) / N), rel=1e-10)


def test_power_is_that_of_sampled_wavefronts(case):
    root, forces, modes, alpha, static, cost = case
    waves = root @ np.random.default_rng(1).standard_normal((12, 40_000))
    used = modes[:, :5]
    force = forces @ used @ (used.T @ (waves / 2)) + static[:, None]
    heat = np.mean((force / alpha[:, None] / 0.51) ** 2, axis=1)
    # The mean of 40,000 squares is known to 0.7 %.
    np.testing.assert_allclose(cost.power[:, 4], heat, rtol=0.035)


def test_the_number_of_modes_is_the_largest_within_the_limits(case):
    *_, cost = case
    worst = cost.power.max(axis=0)
    for number in range(1, 13):
        limit = worst[:number].max()
        found = cost.modes_within(Budget(power=limit))
        assert found >= number
        assert worst[:found].max() <= limit
        assert found == 12 or worst[found] > limit
    reach = cost.reach.max(axis=0)
    assert cost.modes_within(Budget(force=reach[:6].max())) >= 6
    assert cost.modes_within(Budget(power=1e-9)) == 0
    assert cost.modes_within(Budget(force=np.abs(cost.static).max())) == 0
    assert cost.modes_within(Budget()) == 12


@pytest.mark.parametrize("limit", [{"power": 0.0}, {"force": -1.0}, {"power": np.nan}])
def test_limits_are_positive(limit):
    with pytest.raises(FormatError):
        Budget(**limit)
