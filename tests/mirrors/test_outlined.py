"""Mirrors of any outline: their file, and the simulated bench on their finite elements."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import eigh

import truenewton as tn
from truenewton.bench.simulated.static import held_command, loop_of, run_cycles, static_bench
from truenewton.mirrors.file import mirror_from, whole_mirror_from
from truenewton.mirrors.glass import Annulus, Outline, Shell
from truenewton.mirrors.known import ring
from truenewton.mirrors.sensor_model import displaced_readings
from truenewton.mirrors.shell.shell_model import (
    forces_under,
    model_shell,
    moving_mass,
    static_shapes,
    tool_wedges,
    weight_on,
)
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


def test_a_nearly_round_outline_is_the_ring():
    """By both models: stiffness, what hangs on it, what moves, what sensors off their magnets read.

    The load is the weight, magnets, a tool off its centre and bias magnets. Pucks are of 5 mm,
    which the annulus of the sensor does not see.
    """
    glasses = one, other = model_shell(ROUND), model_shell(outlined(ROUND, 8e-3))
    assert other.stiffness == pytest.approx(one.stiffness, abs=3e-3 * np.abs(one.stiffness).max())
    stretch = [np.linalg.svd(glass.stiffness, compute_uv=False)[:-3] for glass in glasses]
    assert stretch[1] == pytest.approx(stretch[0], rel=3e-3)
    shells = [glass.mirror.shell for glass in glasses]
    assert shells[1].mass == pytest.approx(shells[0].mass, rel=1e-9)
    assert shells[1].centroid == pytest.approx((0.0, 0.0), abs=1e-15)

    bias = np.linspace(0.05, 0.09, 8)
    held = [
        forces_under(glass, weight_on(glass.mirror, -1.0, -0.2, off_centre=(2e-4, 0), bias=bias))
        for glass in glasses
    ]
    assert held[1] == pytest.approx(held[0], abs=1e-3 * np.abs(held[0]).max())

    (mass, pucks), (other_mass, other_pucks) = (
        moving_mass(glass, static_shapes(glass)) for glass in glasses
    )
    assert other_mass == pytest.approx(mass, abs=2e-3 * mass.max())
    assert other_pucks == pytest.approx(pucks, abs=2e-3)
    assert other_mass.sum() == pytest.approx(shells[1].mass + 8 * 2.75e-3, rel=1e-9)

    reading, other_reading = map(displaced_readings, glasses)
    for kind, worst in zip(range(5), (2e-3, 2e-3, 1e-2, 1e-2, 1e-2), strict=True):
        difference = np.linalg.norm(other_reading[kind] - reading[kind])
        assert difference < worst * np.linalg.norm(reading[kind])


def disc():
    """Return a disc without a hole, 91 actuators in a hexagon."""
    k = np.arange(-5, 6)
    i, j = (grid.ravel() for grid in np.meshgrid(k, k))
    keep = np.abs(i + j) <= 5
    at = layout(19e-3 * (i + 0.5 * j)[keep], 19e-3 * np.sqrt(0.75) * j[keep])
    return Shell(0.0, 0.1, 1.6e-3, poisson_ratio=0.3), at


def square():
    side = np.linspace(-0.095, 0.095, 8)
    x, y = (grid.ravel() for grid in np.meshgrid(side, side))
    outline = Outline(((-0.1, -0.1), (0.1, -0.1), (0.1, 0.1), (-0.1, 0.1)), mesh_size=30e-3)
    return Shell(0.0, 0.15, 1.6e-3, poisson_ratio=0.3, outline=outline), layout(x, y)


@pytest.mark.parametrize(
    ("plate_and_actuators", "length", "published", "worst"),
    [
        # A. W. Leissa, NASA SP-160 (1969), from the closed form: 2, 0 and 3 nodal diameters
        (
            disc(),
            0.1,
            [5.35833, 5.35833, 9.00314, 12.43899, 12.43899],
            [1e-3, 1e-3, 2e-3, 2e-3, 6e-3],
        ),
        # A. W. Leissa, J. Sound Vibration 31 (1973) 257
        (square(), 0.2, [13.468, 19.596, 24.270, 34.801, 34.801], 2e-3),
    ],
    ids=["disc", "square"],
)
def test_frequencies(plate_and_actuators, length, published, worst):
    """Stiffness and mass at nu = 0.3, from above."""
    plate, at = plate_and_actuators
    mirror = replace(
        ROUND, layout=at, shell=plate, magnet_mass=0.0, puck_radius=0.0,
        sensor=Annulus(1e-6, 1e-6),
    )  # fmt: skip
    glass = model_shell(mirror)
    shapes = static_shapes(glass)
    K, M = 0.5 * (glass.stiffness + glass.stiffness.T), moving_mass(glass, shapes)[0]
    per_mass = plate.density * plate.thickness / plate.bending_stiffness
    got = np.sqrt(eigh(K, M, eigvals_only=True)[3:8] * per_mass) * length**2
    excess = got / published - 1
    assert np.all((excess > -1e-4) & (excess < worst)), excess


L_SHAPE = ((-0.08, -0.08), (0.12, -0.08), (0.12, 0.02), (0.02, 0.02), (0.02, 0.12), (-0.08, 0.12))
HOLES = (
    ((0.07, -0.05), (0.09, -0.05), (0.09, -0.03), (0.07, -0.03)),
    ((-0.03, -0.01), (-0.02, -0.01), (-0.025, 0.0)),
)
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
holes = {[[list(vertex) for vertex in hole] for hole in HOLES]}
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
    """Area 300 cm2 less 4.5; forces balance what is written down; the loop finds them too."""
    mirror = mirror_from(corner)
    assert mirror.shell.mass == pytest.approx(0.02955 * 1.6e-3 * 2530, rel=2e-3)
    moments = 0.02 * np.array([0.02, -0.03]) + 0.01 * np.array([-0.03, 0.07])
    moments -= 4e-4 * np.array([0.08, -0.04]) + 5e-5 * np.array([-0.025, -0.02 / 3])
    centre = moments / 0.02955
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


def test_points_of_an_outline_from_a_table(corner):
    """Of text and of FITS, either way round, in other units too: the same glass."""
    from astropy.table import QTable

    written = mirror_from(corner).shell
    points = [(*at, k) for k, loop in enumerate((L_SHAPE[::-1], *HOLES)) for at in loop]
    table = QTable(rows=points, names=("X", "Y", "LOOP"))
    table.write(corner.parent / "edge.csv")
    for name in "XY":
        table[name] = 1e3 * table[name]
        table[name].unit = "mm"
    table.write(corner.parent / "edge.ecsv")
    table.meta["EXTNAME"] = "OUTLINE"
    table.write(corner.parent / "edge.fits")
    start, stop = MINE.index("edge ="), MINE.index("mesh_size")
    for name in ("edge.csv", "edge.ecsv", "edge.fits"):
        corner.write_text(f'{MINE[:start]}points = "{name}"\n{MINE[stop:]}')
        shell = mirror_from(corner).shell
        assert len(shell.outline.holes) == 2
        assert (shell.mass, *shell.centroid) == pytest.approx((written.mass, *written.centroid))


@pytest.mark.parametrize(
    ("table", "said"),
    [
        ("X,Y\n-0.1,-0.1\n0.1,0.05\n0.1,-0.1\n-0.1,0.05\n",
         "edge.csv: the edge crosses itself at x = 0 m, y = -0.025"),
        ("X,Y\n0,0\n100,0\n0,100\n", "the outline has a point at 100 m; x and y are"),
        ("X,Y,LOOP\n0,0,1\n", "LOOP contains 1; number the points of the edge 0"),
        ("X,Y,LOOP\n0,0,a\n", "line 2: LOOP is 'a'; give a number"),
        ("X,Y\n" + "".join(f"{np.cos(k)},{np.sin(k)}\n" for k in np.arange(2001) * 3e-3),
         "an outline of 2001 vertices; thin it to 2000"),
    ],
)  # fmt: skip
def test_tables_that_are_no_outline(corner, table, said):
    (corner.parent / "edge.csv").write_text(table)
    start, stop = MINE.index("edge ="), MINE.index("mesh_size")
    corner.write_text(f'{MINE[:start]}points = "edge.csv"\n{MINE[stop:]}')
    with pytest.raises(Exception, match=r"(corner\.toml|edge\.csv): ") as refused:
        mirror_from(corner)
    assert said in str(refused.value)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("holes =", 'points = "edge.csv"\nholes =', "has points and"),
        ("bias_force", "tool_radius = 0.2\nbias_force", "the weight tool, 0.2 m from"),
        ("inner_radius = 0.01", "inner_radius = 0.12", "the weight tool, 0.1215 m from"),
        ("outer_radius = 0.16", "outer_radius = 0.1", "the outline reaches 0.14"),
        ("mesh_size = 0.025", "mesh_size = 0.0", "mesh size 0 m"),
        ("[0.12, -0.08], ", "[0.11, -0.08], ", "actuator 4 is 0.1167 m"),
    ],
)
def test_outlines_that_cannot_be(corner, old, new, said):
    assert old in MINE
    corner.write_text(MINE.replace(old, new, 1))
    with pytest.raises(Exception, match=r"(corner\.toml|actuators\.csv): ") as refused:
        mirror_from(corner)
    assert said in str(refused.value)


def test_radii_beside_an_outline_may_be_left_out(corner):
    """The outer one is as far as the glass reaches; a tool without its own stands half as far."""
    radii = "inner_radius = 0.01\nouter_radius = 0.16\n"
    assert radii in MINE
    corner.write_text(MINE.replace(radii, "").replace("[shell]", "tool_radius = 0.02\n[shell]", 1))
    mirror = mirror_from(corner)
    reach = 2.0 * np.arcsin(np.hypot(0.12, 0.08) / 2.0)  # along the sphere
    assert (mirror.shell.inner_radius, mirror.shell.outer_radius) == (0.0, pytest.approx(reach))
    wedges = np.hypot(*tool_wedges(replace(mirror, tool_radius=None)))
    assert wedges == pytest.approx(np.full(3, reach / 2))


PAGE = Path(__file__).parents[2] / "docs" / "mirrors.md"


def test_the_hexagon_and_the_wall_of_the_page(inside, tmp_path, monkeypatch):
    """Its files, the commands below them, a plan; alpha is within its errors of the truth."""
    text, segments = (
        PAGE.read_text(encoding="utf-8").split("## Any outline")[1].split("## Segments")
    )
    (mine,) = re.findall(r'```toml\n(name = "HEXAGON".*?)```', text, re.DOTALL)
    (tmp_path / "hexagon.toml").write_text(mine)
    monkeypatch.chdir(tmp_path)
    (places,) = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    exec(places, {})
    mirror = mirror_from("hexagon.toml")
    assert mirror.layout.n == 37
    assert (0.0, 0.0) in zip(mirror.layout.x, mirror.layout.y, strict=True)
    (commands,) = re.findall(r"```console\n(.*?)```", text, re.DOTALL)
    for line in commands.splitlines():
        inside.prints(*line.removeprefix("$ truenewton ").split())
    found = tn.read_calibration("hexagon.fits")
    miss = (found.alpha - tn.read_truth("hexagon.truth.fits").alpha) / found.error
    assert np.abs(miss).max() < 4
    plan = inside("plan", "--new")[1].replace('"p45"', '"hexagon.toml"').replace("-0.289", "-0.25")
    (tmp_path / "plan.toml").write_text(plan)
    assert len(json.loads(inside.prints("plan", "plan.toml", "--json"))["actuators"]["id"]) == 37
    (wall,) = re.findall(r'```toml\n(name = "WALL".*?)```', segments, re.DOTALL)
    (tmp_path / "wall.toml").write_text(wall)
    whole = whole_mirror_from("wall.toml")
    assert np.bincount(whole.layout.segment).tolist() == [0, 37, 37, 37]
    assert whole.segments[0] is whole.segments[1] is whole.segments[2]
