"""Sensors, pucks, shapes and mass of the shell model against brute force and closed forms."""

from dataclasses import replace

import numpy as np
import pytest

from helpers.shells import (
    FLAT,
    LAYOUT,
    SPHERE,
    TILTS,
    X,
    Y,
    circle,
    influence,
    stiffness,
    uniform_influence,
)
from truenewton.errors import GeometryError
from truenewton.mirrors.glass import Annulus
from truenewton.mirrors.known import ring
from truenewton.mirrors.sensor_model import sensor_model
from truenewton.mirrors.shell.shell_model import model_shell, moving_mass, static_shapes
from truenewton.statics.layout import layout

ELECTRODE = Annulus(8e-3, 12.5e-3)


# --- sensors and pucks -----------------------------------------------------------------------


def around(centre, radius, n=64):
    x, y = circle(radius, n)
    return centre[0] + x, centre[1] + y


def over_annulus(shell, sensor, centre, forces):
    """Mean by brute force: Gauss in radius, even steps in angle."""
    xi, gauss = np.polynomial.legendre.leggauss(6)
    half = 0.5 * (sensor.outer_radius - sensor.inner_radius)
    radii = sensor.inner_radius + half * (1 + xi)
    means = [influence(shell, around(centre, r), forces).mean(axis=0) for r in radii]
    return gauss * radii @ np.array(means) / (gauss @ radii)


@pytest.mark.parametrize("shell", [FLAT, SPHERE])
def test_sensor_reads_the_mean(shell):
    """Its own force in its middle, others beside it, near both edges."""
    forces = (np.array([60e-3, 105e-3, 38e-3]), np.array([10e-3, 30e-3, -5e-3]))
    got = influence(shell, forces, forces, sensor=ELECTRODE)
    want = np.array([over_annulus(shell, ELECTRODE, c, forces) for c in zip(*forces, strict=True)])
    assert got == pytest.approx(want, abs=1e-11 * np.abs(want).max())


def test_a_sensor_off_its_puck_reads_the_mean():
    """Round its own force, not in its middle, and beside another near the edge."""
    forces = (np.array([60e-3, 40e-3]), np.array([10e-3, -5e-3]))
    at = tuple(place + off for place, off in zip(forces, (2e-3, -1e-3), strict=True))
    got = influence(SPHERE, at, forces, sensor=ELECTRODE, puck_radius=5e-3)
    rims = [np.array(around(centre, 5e-3, 32)) for centre in zip(*forces, strict=True)]
    rims = tuple(np.concatenate(rims, axis=1))
    want = [
        over_annulus(SPHERE, ELECTRODE, centre, rims).reshape(2, 32).mean(axis=1)
        for centre in zip(*at, strict=True)
    ]
    assert got == pytest.approx(np.array(want), abs=1e-10 * np.abs(want).max())


@pytest.mark.parametrize("shell", [FLAT, SPHERE])
def test_even_load_is_read_as_the_mean(shell):
    xi, gauss = np.polynomial.legendre.leggauss(6)
    radii = 10.25e-3 + 2.25e-3 * xi
    centres = [(40e-3, 10e-3), (80e-3, -75e-3)]
    want = [
        gauss * radii @ [uniform_influence(shell, around(c, r)).mean() for r in radii]
        / (gauss @ radii)
        for c in centres
    ]  # fmt: skip
    got = uniform_influence(shell, tuple(np.array(centres).T), sensor=ELECTRODE)
    assert got == pytest.approx(want, rel=1e-9)


@pytest.mark.parametrize("shell", [FLAT, SPHERE])
def test_puck_presses_with_its_rim(shell):
    """Read beside the puck, under it, on its axis and by a sensor round it."""
    centre, puck = (70e-3, 20e-3), 5e-3
    rim = around(centre, puck)
    at = (np.array([70e-3, 72e-3, 69e-3, 100e-3]), np.array([20e-3, 23e-3, 19e-3, -40e-3]))
    force = tuple(np.array([c]) for c in centre)
    got = influence(shell, at, force, puck_radius=puck)[:, 0]
    want = influence(shell, at, rim).mean(axis=1)
    assert got == pytest.approx(want, abs=1e-12 * np.abs(want).max())
    got = influence(shell, force, force, puck_radius=puck, sensor=ELECTRODE)
    assert got == pytest.approx(over_annulus(shell, ELECTRODE, centre, rim).mean(), rel=1e-12)


def test_symmetric_only_where_read_as_pressed():
    G = influence(SPHERE, (X, Y), (X, Y), sensor=Annulus(6e-3, 6e-3), puck_radius=6e-3)
    apart = np.eye(LAYOUT.n) - TILTS.T @ np.linalg.pinv(TILTS.T)
    elastic = apart @ G @ apart
    assert np.abs(elastic - elastic.T).max() < 1e-12 * np.abs(elastic).max()
    unlike = stiffness(SPHERE, X, Y, sensor=ELECTRODE)
    assert np.abs(unlike - unlike.T).max() > 1e-4 * np.abs(unlike).max()
    assert np.abs(unlike @ TILTS.T).max() < 2e-8
    assert np.abs(TILTS @ unlike).max() < 2e-8


# --- shapes and mass -------------------------------------------------------------------------


def moved(shell, at, sensor, puck, magnet_mass):
    """Return stiffness, mass and motion of the pucks of a mirror with its actuators along it."""
    shorter = np.sinc(np.hypot(at.x, at.y) / shell.radius_of_curvature / np.pi)
    at = layout(shorter * at.x, shorter * at.y)
    glass = model_shell(
        replace(
            ring(4), layout=at, shell=shell, sensor=sensor, puck_radius=puck,
            magnet_mass=magnet_mass,
        )
    )  # fmt: skip
    return glass.stiffness, *moving_mass(glass, static_shapes(glass))


@pytest.mark.parametrize(("sensor", "puck"), [(None, 0.0), (ELECTRODE, 5e-3)])
def test_mass_of_rigid_motions_is_that_of_glass_and_magnets(sensor, puck):
    _, M, S = moved(SPHERE, LAYOUT, sensor, puck, 2.75e-3)
    a, b = SPHERE.inner_radius, SPHERE.outer_radius
    glass = SPHERE.mass * np.diag([1.0, (a**2 + b**2) / 4, (a**2 + b**2) / 4])
    assert pytest.approx(glass + 2.75e-3 * TILTS @ TILTS.T, abs=1e-12) == TILTS @ M @ TILTS.T
    assert np.array_equal(M, M.T)
    assert np.linalg.eigvalsh(M).min() > 0
    assert pytest.approx(TILTS.T, abs=1e-12) == S @ TILTS.T


def test_magnets_stand_on_the_diagonal_where_points_are_read():
    with_magnets, without = (moved(FLAT, LAYOUT, None, 0.0, m)[1] for m in (3e-3, 0.0))
    assert with_magnets - without == pytest.approx(3e-3 * np.eye(LAYOUT.n), abs=1e-15)


# --- refusals --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("sensor", "puck", "fault"),
    [
        (Annulus(8e-3, 30e-3), 0.0, "0.03 m round it is off the glass"),
        (ELECTRODE, 9e-3, "over the place where a force acts"),
        (None, 40e-3, "0.04 m round it is off the glass"),
    ],
)
def test_bad_sensors_and_pucks_are_refused(sensor, puck, fault):
    with pytest.raises(GeometryError, match=fault) as refusal:
        stiffness(SPHERE, X, Y, sensor=sensor, puck_radius=puck)
    assert refusal.value.remedy
    assert "\n" not in str(refusal.value)


def test_a_sensor_over_the_force_of_another_is_refused():
    force = (np.array([70e-3]), np.zeros(1))
    cases = (
        (12.4e-3, 0.0, True),
        (13e-3, 0.0, False),
        (13e-3, 3e-3, True),
        (2.9e-3, 5e-3, False),  # its own puck, not in its middle
        (3.1e-3, 5e-3, True),
    )
    for distance, puck, over in cases:
        beside = (force[0] + distance, force[1])
        if over:
            with pytest.raises(GeometryError, match="only encircle the puck of their own"):
                influence(FLAT, beside, force, sensor=ELECTRODE, puck_radius=puck)
        else:
            assert influence(FLAT, beside, force, sensor=ELECTRODE, puck_radius=puck).size == 1


@pytest.mark.parametrize("radii", [(2e-3, 1e-3), (-1e-3, 1e-3), (0, 0), (np.nan, 1.0), (0, np.inf)])
def test_annuli_that_cannot_be_are_refused(radii):
    with pytest.raises(GeometryError, match="a sensor from"):
        Annulus(*radii)


def test_data_may_number_the_actuators_of_a_mirror_by_channel():
    mirror = ring(24)
    channels = replace(mirror.layout, id=np.arange(24))
    assert np.array_equal(sensor_model(mirror, channels), sensor_model(mirror, mirror.layout))
