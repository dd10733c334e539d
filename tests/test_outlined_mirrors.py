"""Mirrors of any outline: their file, and the simulated bench on their finite elements."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import eigh
from shells import influence

from truenewton.bench.simulated.static import held_command, loop_of, run_cycles, static_bench
from truenewton.errors import GeometryError
from truenewton.mirrors.file import mirror_from
from truenewton.mirrors.glass import Annulus, Outline, Shell
from truenewton.mirrors.known import ring
from truenewton.mirrors.shell.held_glass import forces_under, held_glass, weight_on
from truenewton.mirrors.shell.moving_mass import moving_mass, static_shapes
from truenewton.mirrors.shell.puck_motion import displaced_readings
from truenewton.statics.arms import external_load, resultants
from truenewton.statics.layout import layout

ROUND = ring(8)


def polygon(radius, n, curvature):
    """Return a regular polygon of a circle's area along the glass, seen along the axis."""
    angle = 2 * np.pi * np.arange(n) / n
    along = radius * np.sqrt(2 * np.pi / n / np.sin(2 * np.pi / n))
    corner = curvature * np.sin(along / curvature)
    return tuple(zip(corner * np.cos(angle), corner * np.sin(angle), strict=True))


def outlined(mirror, mesh_size):
    shell = mirror.shell
    edge, hole = (
        polygon(radius, n, shell.radius_of_curvature)
        for radius, n in ((shell.outer_radius, 64), (shell.inner_radius, 32))
    )
    wider = replace(shell, outer_radius=1.01 * shell.outer_radius)
    return replace(mirror, shell=replace(wider, outline=Outline(edge, (hole,), mesh_size)))


@pytest.fixture(scope="module")
def glasses():
    """Return the glass of a round mirror by both models."""
    return held_glass(ROUND), held_glass(outlined(ROUND, 8e-3))


def test_a_nearly_round_outline_is_the_ring(glasses):
    one, other = glasses
    assert other.stiffness == pytest.approx(one.stiffness, abs=3e-3 * np.abs(one.stiffness).max())
    stretch = [np.linalg.svd(glass.stiffness, compute_uv=False)[:-3] for glass in glasses]
    assert stretch[1] == pytest.approx(stretch[0], rel=3e-3)
    shells = [glass.mirror.shell for glass in glasses]
    assert shells[1].mass == pytest.approx(shells[0].mass, rel=1e-9)
    assert shells[1].centroid == pytest.approx((0.0, 0.0), abs=1e-15)


def test_what_hangs_on_it_is_held_as_on_the_ring(glasses):
    """Weight, magnets, a tool off its centre and bias magnets, by both models."""
    bias = np.linspace(0.05, 0.09, 8)
    held = [
        forces_under(glass, weight_on(glass.mirror, -1.0, -0.2, off_centre=(2e-4, 0), bias=bias))
        for glass in glasses
    ]
    assert held[1] == pytest.approx(held[0], abs=1e-3 * np.abs(held[0]).max())


def test_the_mass_that_moves_is_that_of_the_ring(glasses):
    """Through pucks of 5 mm, which the annulus of the sensor does not see."""
    (mass, pucks), (other_mass, other_pucks) = (
        moving_mass(glass, static_shapes(glass)) for glass in glasses
    )
    assert other_mass == pytest.approx(mass, abs=2e-3 * mass.max())
    assert other_pucks == pytest.approx(pucks, abs=2e-3)
    assert other_mass.sum() == pytest.approx(glasses[1].mirror.shell.mass + 8 * 2.75e-3, rel=1e-9)


def test_sensors_off_their_magnets_read_what_they_read_on_the_ring(glasses):
    one, other = map(displaced_readings, glasses)
    for kind, worst in zip(range(5), (2e-3, 2e-3, 1e-2, 1e-2, 1e-2), strict=True):
        assert np.linalg.norm(other[kind] - one[kind]) < worst * np.linalg.norm(one[kind])


SQUARE = ((-0.1, -0.1), (0.1, -0.1), (0.1, 0.1), (-0.1, 0.1))


def test_frequencies_of_a_square():
    """A. W. Leissa, J. Sound Vibration 31 (1973) 257, nu = 0.3: stiffness and mass, from above."""
    at = np.linspace(-0.095, 0.095, 8)
    x, y = (grid.ravel() for grid in np.meshgrid(at, at))
    plate = Shell(0.0, 0.15, 1.6e-3, poisson_ratio=0.3, outline=Outline(SQUARE, mesh_size=30e-3))
    mirror = replace(
        ROUND, layout=layout(x, y), shell=plate, magnet_mass=0.0, puck_radius=0.0,
        sensor=Annulus(1e-6, 1e-6),
    )  # fmt: skip
    glass = held_glass(mirror)
    K, M = 0.5 * (glass.stiffness + glass.stiffness.T), moving_mass(glass, static_shapes(glass))[0]
    per_mass = plate.density * plate.thickness / plate.bending_stiffness
    got = np.sqrt(eigh(K, M, eigvals_only=True)[3:8] * per_mass) * 0.2**2
    excess = got / [13.468, 19.596, 24.270, 34.801, 34.801] - 1
    assert np.all((excess > -1e-4) & (excess < 2e-3)), excess


L_SHAPE = ((-0.08, -0.08), (0.12, -0.08), (0.12, 0.02), (0.02, 0.02), (0.02, 0.12), (-0.08, 0.12))
MINE = f"""
name = "CORNER"
actuators = "actuators.csv"
weight = -1.2
weight_error = 0.002
added_weight = -0.1
added_weight_error = 0.002
bias_force = 0.09

[shell]
inner_radius = 0.01
outer_radius = 0.16
thickness = 1.6e-3
radius_of_curvature = 2.0

[shell.outline]
edge = {[list(vertex) for vertex in L_SHAPE]}
holes = [[[0.07, -0.05], [0.09, -0.05], [0.09, -0.03], [0.07, -0.03]]]
mesh_size = 0.025
"""
AT = [(-0.06, -0.06), (-0.02, -0.055), (0.045, -0.05), (0.1, -0.06), (0.1, -0.02), (0.04, -0.02),
      (-0.055, 0.02), (-0.02, 0.05), (-0.06, 0.1), (-0.02, 0.1)]  # fmt: skip


@pytest.fixture
def corner(tmp_path):
    rows = [f"{x},{y},{np.sqrt(1 - (x * x + y * y) / 4)}" for x, y in AT]
    (tmp_path / "actuators.csv").write_text("\n".join(["X,Y,NZ", *rows]))
    path = tmp_path / "corner.toml"
    path.write_text(MINE)
    return path


def test_a_corner_on_the_bench(corner):
    """Area 300 cm2 less 4; forces balance what is written down; the loop finds the same forces."""
    mirror = mirror_from(corner)
    assert mirror.shell.mass == pytest.approx(0.0296 * 1.6e-3 * 2530, rel=2e-3)
    moments = 0.02 * np.array([0.02, -0.03]) + 0.01 * np.array([-0.03, 0.07])
    centre = (moments - 4e-4 * np.array([0.08, -0.04])) / 0.0296
    assert mirror.shell.centroid == pytest.approx(centre, abs=1e-5)
    bench = static_bench(mirror, 1, force_noise=0.0)
    truth = bench.truth
    for k, force in enumerate(bench.load_force):
        load = external_load(
            truth.weight + truth.added[k], truth.bias_force, truth.torque_y[k], truth.torque_x[k]
        )
        assert resultants(mirror.layout, force) == pytest.approx(-load, abs=1e-9)
    static, settled = next(run_cycles(bench, 1)), next(run_cycles(bench, 1, loop_of(bench)))
    assert settled.valid.all()
    expected = held_command(bench, 0, settled.position - bench.sensors.offset)
    assert settled.force == pytest.approx(expected, abs=2e-3)
    assert np.abs(static.force).max() < 0.4


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("0.01\nouter", "-0.01\nouter", "reaches from -0.01 m"),
        ("inner_radius = 0.01", "inner_radius = 0.12", "the weight tool, 0.12 m from"),
        ("outer_radius = 0.16", "outer_radius = 0.1", "the outline reaches 0.14"),
        ("mesh_size = 0.025", "mesh_size = 0.0", "mesh size 0 m"),
        ("[0.02, 0.12]", "[0.15, -0.15]", "turns back to"),
        ("[0.07, -0.05], [0.09, -0.05]", "[0.07, 0.05], [0.09, 0.05]", "outline meet"),
        ("[0.12, 0.02]", "[0.12]", "give 2 values"),
        ("[0.12, -0.08], ", "[0.11, -0.08], ", "actuator 4 stands 0.1167 m"),
        ("edge =", "rim =", "knows no 'rim'"),
    ],
)
def test_outlines_that_cannot_be(corner, old, new, said):
    assert old in MINE
    corner.write_text(MINE.replace(old, new, 1))
    with pytest.raises(Exception, match=r"corner\.toml: ") as refused:
        mirror_from(corner)
    assert said in str(refused.value)


def test_rings_of_fourier_refuse_an_outline():
    shell = outlined(ROUND, 8e-3).shell
    at = np.array([0.05]), np.array([0.0])
    with pytest.raises(GeometryError, match="is no ring"):
        influence(shell, at, at)
