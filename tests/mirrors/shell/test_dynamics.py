"""The air film against closed forms of Reynolds' equation, finite differences, and itself."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.sparse import csc_array, diags_array, eye_array, kron
from scipy.sparse.linalg import spsolve

from truenewton.errors import GeometryError
from truenewton.mirrors.glass import Outline
from truenewton.mirrors.known import p45, ring
from truenewton.mirrors.shell.dynamics import (
    VISCOSITY,
    film_damping,
)
from truenewton.mirrors.shell.shell_model import model_shell, static_shapes
from truenewton.statics.layout import layout


def damping_of(mirror):
    glass = model_shell(mirror)
    return film_damping(glass, static_shapes(glass)), np.array(glass.places)


@pytest.fixture(scope="module")
def closed():
    return damping_of(p45())


def exact_ring(mirror):
    """Return the force on a piston and the torque on a tilt, both of unit speed."""
    a, b = mirror.shell.inner_radius, mirror.shell.outer_radius
    q = 12 * VISCOSITY / mirror.gap**3
    squares = b**2 - a**2
    piston = np.pi * q / 8 * (b**4 - a**4 - squares**2 / np.log(b / a))
    # p = cos(theta) (A r + B / r - q r^3 / 8), 0 at both edges
    A, B = q / 8 * (a**2 + b**2), -q / 8 * a**2 * b**2
    tilt = np.pi * (A * (b**4 - a**4) / 4 + B * squares / 2 - q / 48 * (b**6 - a**6))
    return piston, tilt


def test_piston_and_tilts_of_a_ring_are_the_closed_forms(closed):
    damping, (x, y) = closed
    piston, tilt = exact_ring(p45())
    assert damping.sum() == pytest.approx(piston, rel=1e-9)
    assert x @ damping @ x == pytest.approx(tilt, rel=1e-9)
    assert y @ damping @ y == pytest.approx(tilt, rel=1e-9)
    assert abs(x @ damping @ y) < 1e-9 * tilt
    assert abs(x @ damping.sum(axis=0)) < 1e-9 * np.sqrt(tilt * piston)


def test_the_film_takes_energy_from_every_motion_and_goes_as_the_gap_to_the_minus_third(closed):
    damping, _ = closed
    assert damping == pytest.approx(damping.T, rel=1e-12)
    assert np.linalg.eigvalsh(damping).min() > 10
    narrow, _ = damping_of(replace(p45(), gap=34e-6))
    assert narrow == pytest.approx(8 * damping, rel=1e-9)


@pytest.mark.parametrize(
    ("whole", "vent", "stiff", "extrapolated"),
    [
        pytest.param(p45(), 0.0, 0.1, 3e-3, marks=pytest.mark.study),
        pytest.param(p45(), 3e-3, 0.2, 0.02, marks=pytest.mark.study),
        (ring(16), 3e-3, 0.1, 0.04),
    ],
)
def test_elements_of_an_outline_come_to_the_films_of_the_ring(whole, vent, stiff, extrapolated):
    """A polygon of its circles' area; linear elements, wrong by the square of their size."""
    angle = np.pi / 60 * np.arange(120)
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    circle *= np.sqrt(np.pi / 60 / np.sin(np.pi / 60))
    shell, mirror = whole.shell, replace(whole, vent_radius=vent)
    edge, hole = (tuple(map(tuple, r * circle)) for r in (shell.outer_radius, shell.inner_radius))
    meshed = (
        replace(
            shell,
            outer_radius=1.005 * shell.outer_radius,
            outline=Outline(edge, (hole,), mesh_size=size),
        )
        for size in (0.012, 0.008)
    )
    coarse, fine = (damping_of(replace(mirror, shell=each))[0] for each in meshed)
    round_film, _ = damping_of(mirror)
    assert np.abs(fine - round_film).max() < stiff * np.abs(round_film).max()
    total = fine.sum() + (fine.sum() - coarse.sum()) / (1.5**2 - 1)
    assert total == pytest.approx(round_film.sum(), rel=extrapolated)


def six_bores(vent):
    turn = np.pi / 3 * np.arange(6) + 0.2
    shell = replace(p45().shell, inner_radius=0.012, outer_radius=0.048)
    mirror = replace(
        p45(),
        layout=layout(0.03 * np.cos(turn), 0.03 * np.sin(turn)),
        shell=shell,
        sensor=replace(p45().sensor, inner_radius=5e-3, outer_radius=6e-3),
        vent_radius=vent,
    )
    return mirror, 0.03 * np.exp(1j * turn)


def finite_differences(mirror, bores, step):
    """Return the force on a piston of unit speed; wrong by the step's first power."""
    line = np.arange(-0.048, 0.048 + step / 2, step)
    at = line[:, None] + 1j * line
    film = (np.abs(at) < 0.048) & (np.abs(at) > 0.012)
    film &= (np.abs(at[..., None] - bores) > mirror.vent_radius).all(axis=-1)
    along = diags_array([-1.0, 2.0, -1.0], offsets=[-1, 0, 1], shape=(line.size, line.size))
    one = eye_array(line.size)
    laplace = csc_array(kron(along, one) + kron(one, along))[film.ravel()][:, film.ravel()]
    pressure = spsolve(laplace, np.full(film.sum(), step**2))
    return 12 * VISCOSITY / mirror.gap**3 * pressure.sum() * step**2


def test_bores_let_out_what_finite_differences_say():
    mirror, bores = six_bores(4e-3)
    coarse, fine = (finite_differences(mirror, bores, step) for step in (0.5e-3, 0.25e-3))
    damping, _ = damping_of(mirror)
    assert damping.sum() == pytest.approx(2 * fine - coarse, rel=5e-3)
    closed, _ = damping_of(replace(mirror, vent_radius=0.0))
    assert damping.sum() < 0.7 * closed.sum()


def test_bores_that_touch_or_reach_over_an_edge_are_refused():
    with pytest.raises(GeometryError, match=r"bores of 0.016 m touch .* smaller vent_radius"):
        damping_of(six_bores(16e-3)[0])
