"""Finite elements of the glass against closed forms, published figures and the other model."""

from dataclasses import replace

import numpy as np
import pytest

from helpers.shells import FLAT, SPHERE, TILTS, X, Y, meshed_stiffness, stiffness
from truenewton.errors import GeometryError
from truenewton.mirrors.glass import Annulus, Outline
from truenewton.mirrors.shell.mesh import checked_polygons, shell_mesh

SQUARE = np.array([[-0.1, -0.1], [0.1, -0.1], [0.1, 0.1], [-0.1, 0.1]])


def curl(angles, radius):
    return radius * np.stack([np.cos(angles), np.sin(angles)], axis=1)


def petal(first, last, inner=20e-3, outer=125e-3, n=12):
    """A sector of an annulus, as the petals of a segmented adaptive mirror are."""
    angles = np.linspace(first, last, n + 1)
    return np.concatenate([curl(angles, outer), curl(angles[::-1], inner)])


PETAL = petal(0.0, np.pi / 3)
STAR = curl(np.arange(10) * np.pi / 5, 1.0) * np.where(np.arange(10) % 2, 0.06, 0.11)[:, None]


def cut_to(shell, outline, holes=()):
    """Return a shell of an outline, its vertices given along the glass."""

    def seen(polygon):
        r = np.linalg.norm(polygon, axis=1)[:, None]
        shorter = np.sinc(r / shell.radius_of_curvature / np.pi)
        return tuple(map(tuple, polygon * shorter))

    return replace(shell, outline=Outline(seen(outline), tuple(map(seen, holes))))


def outline_mesh(outline, x, y, *, mesh_size, holes=()):
    return shell_mesh(replace(FLAT, outline=Outline(outline, holes)), x, y, mesh_size=mesh_size)


def smallest_angle(mesh):
    side = np.linalg.norm(mesh.corners - np.roll(mesh.corners, -1, axis=1), axis=2)
    a, b, c = side, np.roll(side, -1, axis=1), np.roll(side, -2, axis=1)
    return np.degrees(np.arccos((a**2 + c**2 - b**2) / (2 * a * c))).min()


def area(polygon):
    x, y = polygon.T
    return abs(0.5 * (x * np.roll(y, -1) - y * np.roll(x, -1)).sum())


def spread(polygon, n, seed, margin=0.85):
    """Points scattered in a star-shaped polygon."""
    random = np.random.default_rng(seed)
    middle = polygon.mean(axis=0)
    corner = random.integers(len(polygon), size=n)
    one, other = polygon[corner], np.roll(polygon, -1, axis=0)[corner]
    u, v = np.sqrt(random.uniform(size=(n, 1))) * margin, random.uniform(size=(n, 1))
    return middle + u * (one + v * (other - one) - middle)


# --- the mesh --------------------------------------------------------------------------------


def assert_sound(mesh, want_area, x, y):
    assert np.array_equal(mesh.points[: len(x)], np.stack([x, y], axis=1))
    assert smallest_angle(mesh) > 25
    assert mesh.areas.min() > 0
    assert mesh.areas.sum() == pytest.approx(want_area, rel=1e-9)
    beside = np.bincount(mesh.edge_of.ravel())
    assert set(beside) == {1, 2}
    assert np.unique(mesh.triangles).size == len(mesh.points)


@pytest.mark.parametrize("mesh_size", [30e-3, 15e-3, 6e-3])
def test_round_meshes_keep_the_area(mesh_size):
    mesh = shell_mesh(FLAT, X, Y, mesh_size=mesh_size)
    assert_sound(mesh, np.pi * (125e-3**2 - 20e-3**2), X, Y)
    assert mesh.size == pytest.approx(mesh_size, rel=0.35)


@pytest.mark.parametrize("outline", [SQUARE, PETAL, PETAL[::-1], STAR], ids=len)
def test_meshes_of_any_outline(outline):
    x, y = spread(outline, 30, seed=1).T
    assert_sound(outline_mesh(outline, x, y, mesh_size=15e-3), area(outline), x, y)


def test_meshes_of_outlines_by_chance():
    random = np.random.default_rng(7)
    for seed in range(10):
        n = random.integers(4, 9)
        angles = 2 * np.pi * (np.arange(n) + random.uniform(-0.15, 0.15, n)) / n
        outline = curl(angles, 1.0) * random.uniform(0.7, 1, n)[:, None]
        x, y = spread(outline, random.integers(0, 40), seed).T
        assert_sound(outline_mesh(outline, x, y, mesh_size=0.1), area(outline), x, y)


def test_holes_and_crowded_actuators():
    hole = SQUARE / 4 + 0.03
    x, y = np.array([-0.05, -0.0495, 0.0, 0.0994]), np.array([-0.05, -0.05, 0.08, 0.0994])
    mesh = outline_mesh(SQUARE, x, y, mesh_size=20e-3, holes=[hole])
    assert_sound(mesh, area(SQUARE) - area(hole), x, y)


@pytest.mark.parametrize("crowd", [[], [0.06, 0.0602, 0.0604]])
def test_the_triangle_at_a_place(crowd):
    mesh = outline_mesh(PETAL, crowd, np.full(len(crowd), 0.03), mesh_size=8e-3)
    random = np.random.default_rng(0)
    shares = random.dirichlet(np.full(3, 0.3), (len(mesh.triangles), 60))
    places = (shares @ mesh.corners).reshape(-1, 2)
    a, b, c = np.moveaxis(mesh.corners[mesh.triangle_at(places)], 1, 0)
    parts = [
        np.linalg.det(np.stack([q - p, places - p], axis=1)) for p, q in ((a, b), (b, c), (c, a))
    ]
    assert np.min(parts) > -1e-14
    with pytest.raises(GeometryError, match=r"point 1 .* off the glass"):
        mesh.triangle_at(np.array([[0.06, 0.03], [0.0, 0.0]]))


# --- stiffness -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("curvature", "sensor", "worst"), [(np.inf, None, 2e-3), (-0.7, Annulus(), 1.5e-3)]
)
def test_stiffness_is_that_of_the_semi_analytic_model(curvature, sensor, worst):
    """The two models share their last step alone."""
    shell = replace(FLAT, radius_of_curvature=curvature)
    one = stiffness(shell, X, Y, sensor=sensor)
    other = meshed_stiffness(shell, X, Y, mesh_size=8e-3, sensor=sensor)
    stretches = [np.linalg.svd(K, compute_uv=False)[:-3] for K in (other, one)]
    assert np.abs(stretches[0] / stretches[1] - 1).max() < worst
    assert np.linalg.norm(other - one) < worst * np.linalg.norm(one)


@pytest.mark.parametrize("sensor", [None, Annulus()], ids=["points", "sensors"])
def test_rigid_motions_are_free_and_forces_balance(sensor):
    K = meshed_stiffness(SPHERE, X, Y, mesh_size=16e-3, sensor=sensor)
    assert np.abs(K @ TILTS.T).max() < 2e-8
    assert np.abs(TILTS @ K).max() < 2e-8
    skew = np.abs(K - K.T).max() / K.max()
    assert skew == 0 if sensor is None else 1e-4 < skew < 1e-2


# --- any outline -----------------------------------------------------------------------------


def test_turning_shifting_and_scaling_an_outline():
    """K goes as D / length^2; a sphere may be shifted under a shallow shell as well."""
    angle, radius = np.meshgrid(np.radians([12, 30, 48]), [48e-3, 77e-3, 106e-3])
    x, y = (radius * np.cos(angle)).ravel(), (radius * np.sin(angle)).ravel()
    turn = np.array([[0.6, -0.8], [0.8, 0.6]])
    for shell in (FLAT, SPHERE):
        K = np.linalg.eigvalsh(meshed_stiffness(cut_to(shell, PETAL), x, y, mesh_size=8e-3))[3:]
        moved = 2 * PETAL @ turn + [0.1, -0.2]
        u, v = (2 * np.stack([x, y], axis=1) @ turn + [0.1, -0.2]).T
        twice = replace(
            shell, thickness=2 * shell.thickness, radius_of_curvature=2 * shell.radius_of_curvature
        )
        again = np.linalg.eigvalsh(meshed_stiffness(cut_to(twice, moved), u, v, mesh_size=16e-3))[
            3:
        ]
        assert again == pytest.approx(2 * K, rel=3e-3)


# --- what cannot be --------------------------------------------------------------------------

BOW = np.array([[0.0, 0.0], [0.1, 0.1], [0.1, 0.0], [0.0, 0.1]])
WEDGE = np.array([[0.0, 0.0], [0.1, 0.0], [0.1, 0.03]])


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"mesh_size": 0.0}, "mesh size"),
        ({"mesh_size": 1e-5}, r"makes some 1.1e\+09 triangles"),
        ({"x": [0.0, 0.05, -0.05], "y": [0.01, 0.05, 0.05]}, "actuator 0 .* off the glass"),
        ({"x": [0.1249, 0.05, -0.05], "y": [0.0, 0.05, 0.05]}, "actuator 0 .* on an edge"),
        ({"x": [0.05, 0.05, 0.0], "y": [0.05, 0.05, 0.05]}, "actuators 0 and 1 .* the same place"),
        ({"x": [0.03, 0.05, 0.07], "y": [0.03, 0.05, 0.07]}, "on one line"),
        ({"shell": replace(FLAT, thickness=-1e-3, young_modulus=-1.0)}, "thickness is -0.001"),
        ({"sensor": Annulus(8e-3, 60e-3)}, "sensor reaches over an edge"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_refused(change, words):
    given = {"shell": FLAT, "x": [0.03, 0.05, -0.05], "y": [0.03, -0.05, 0.05], "mesh_size": 2e-2}
    with pytest.raises(GeometryError, match=words):
        meshed_stiffness(**(given | change))


@pytest.mark.parametrize(
    ("outline", "holes", "words"),
    [
        (SQUARE[:2], [], "the edge has 2 points; give three or more"),
        (SQUARE[:, :1], [], "shape"),
        (SQUARE * np.nan, [], "finite"),
        (
            np.insert(SQUARE, 1, SQUARE[0], axis=0),
            [],
            "points 1 and 2 of the edge .* the same place",
        ),
        (BOW, [], r"edge crosses itself at x = 0.05 m, y = 0.05 m \(Self-intersection\)"),
        (WEDGE, [], "turns back to 16.7 degrees at its point 1, x = 0 m, y = 0 m"),
        (SQUARE, [SQUARE + 0.1], r"the edge and hole 1 meet at x = 0(\.1)? m"),
        (SQUARE, [SQUARE / 4, SQUARE / 4 + [0.05, 0]], "hole 1 and hole 2 meet at x = 0.025 m"),
        (SQUARE, [SQUARE / 4 + 0.3], "hole 1 does not lie"),
        (SQUARE, [SQUARE / 2, SQUARE / 4], "hole 2 does not lie"),
    ],
)
def test_refused_outlines(outline, holes, words):
    with pytest.raises(GeometryError, match=words):
        checked_polygons([outline, *holes])
