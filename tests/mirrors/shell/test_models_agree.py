"""The two models of the curved shell, which share their last step alone, against each other."""

from dataclasses import replace

import numpy as np
import pytest

from helpers.shells import meshed_stiffness, stiffness
from truenewton.mirrors.glass import Annulus, Shell
from truenewton.statics.layout import rings

COUNTS = np.array([9, 15, 21])
LAYOUT = rings(list(COUNTS * 30.5e-3 / (2 * np.pi)), list(COUNTS))
FLAT = Shell(inner_radius=20e-3, outer_radius=125e-3, thickness=1.6e-3)


@pytest.mark.parametrize("curvature", [np.inf, 2.0, -0.7])
@pytest.mark.parametrize(
    ("sensor", "worst"), [(None, 2e-3), (Annulus(), 1.5e-3)], ids=["points", "sensors"]
)
def test_stiffness_agrees(curvature, sensor, worst):
    shell = replace(FLAT, radius_of_curvature=curvature)
    one = stiffness(shell, LAYOUT.x, LAYOUT.y, sensor=sensor)
    other = meshed_stiffness(shell, LAYOUT.x, LAYOUT.y, mesh_size=8e-3, sensor=sensor)
    stretches = [np.linalg.svd(K, compute_uv=False)[:-3] for K in (other, one)]
    assert np.abs(stretches[0] / stretches[1] - 1).max() < worst
    assert np.linalg.norm(other - one) < worst * np.linalg.norm(one)
