"""The known mirrors, their family, and mirrors from a file."""

import json
import re
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from helpers.acquisition_plans import small_plan
from truenewton.acquisition.plan import shapes_and_forces
from truenewton.errors import FormatError, GeometryError, UnknownName, UnreadableFile
from truenewton.mirrors import known
from truenewton.mirrors.file import check_mirror, mirror_from
from truenewton.mirrors.glass import Annulus, Shell

PAGE = Path(__file__).parents[2] / "docs" / "mirrors.md"
MINE = """
name = "MINE"
actuators = "actuators.csv"
weight = -1.0
weight_error = 0.002
added_weight = -0.1
added_weight_error = 0.002

[shell]
inner_radius = 0.02
outer_radius = 0.1
thickness = 1.6e-3
"""
TABLE = "X,Y\n" + "\n".join(f"{0.05 * np.cos(k)},{0.05 * np.sin(k)}" for k in range(6))


@pytest.fixture
def mine(tmp_path):
    (tmp_path / "actuators.csv").write_text(TABLE)
    path = tmp_path / "mine.toml"
    path.write_text(MINE)
    return path


@pytest.mark.parametrize(
    ("name", "n"),
    [("p45", 45), ("mmt336", 336), ("mag585", 585), ("LBT672", 672), ("ring5352", 5352)],
)
def test_known_mirrors_stand_on_their_glass(name, n):
    mirror = known.mirror(name)
    assert mirror.layout.n == n
    check_mirror(mirror)
    shell = mirror.shell
    # NZ is the cosine of the normal where the actuator stands.
    r = np.hypot(mirror.layout.x, mirror.layout.y)
    assert mirror.layout.nz == pytest.approx(np.sqrt(1 - (r / shell.radius_of_curvature) ** 2))
    # Shell and magnets weigh what the mirror is said to, P45's to the paper's 5 mN and the spread
    # of its magnets' mass.
    mass = shell.mass + mirror.magnet_mass * n
    assert -mirror.weight == pytest.approx(mass * known.GRAVITY, rel=0.02)


def test_rings_of_the_mmt():
    layout = known.mmt336().layout
    radius = np.hypot(layout.x, layout.y)
    values, counts = np.unique(np.round(1e3 * radius, 1), return_counts=True)
    assert values.tolist() == [42.1, 73.4, 104.8, 136.1, 167.5, 198.8, 230.1, 261.5, 290.8, 313.1]
    assert counts.tolist() == [6, 12, 18, 24, 30, 36, 42, 48, 60, 60]
    ninth = np.flatnonzero(np.round(1e3 * radius, 1) == 290.8)[0]
    assert np.degrees(np.arctan2(layout.y[ninth], layout.x[ninth])) == pytest.approx(93.0)


def test_the_family_carries_the_rings_of_lbt672_on():
    one, other = known.ring(672), known.lbt672()
    assert one.layout.x == pytest.approx(other.layout.x, rel=1e-4, abs=1e-6)
    assert one.weight == pytest.approx(other.weight, rel=0.01)
    for name in ("ring3", "ring5353", "ring", "ringo"):
        with pytest.raises(UnknownName):
            known.mirror(name)


def test_a_mirror_from_a_file(mine):
    mirror = mirror_from(mine)
    assert (mirror.name, mirror.layout.n, mirror.weight) == ("MINE", 6, -1.0)
    assert mirror.shell == Shell(0.02, 0.1, 1.6e-3)
    assert mirror.layout.x[1] == pytest.approx(0.05 * np.cos(1))
    assert mirror.sensor == Annulus(8e-3, 12.5e-3)


def test_a_table_with_units_and_names(mine):
    from astropy.table import QTable

    table = QTable({"ID": [7, 8, 9, 11], "X": [-50.0, 50, 0, 0], "Y": [0.0, 0, 50, -50],
                    "ENABLED": [True, True, False, True]})  # fmt: skip
    table["X"].unit = table["Y"].unit = "mm"
    table.write(mine.parent / "actuators.ecsv")
    mine.write_text(MINE.replace(".csv", ".ecsv"))
    layout = mirror_from(mine).layout
    assert layout.id.tolist() == [7, 8, 9, 11]
    assert layout.y.tolist() == pytest.approx([0.0, 0.0, 0.05, -0.05])
    assert layout.enabled.tolist() == [True, True, False, True]


@pytest.mark.parametrize(
    ("old", "new", "error", "said"),
    [
        ('name = "MINE"', "name = 3", FormatError, "name is 3; give text"),
        ("weight = -1.0", "weight = 1.0", FormatError, "weight is 1; weights are negative"),
        ("weight = -1.0", "weight = -1e16", FormatError, "check its unit; numbers are in SI"),
        ("weight = -1.0", "weigth = -1.0", FormatError, "knows no 'weigth'; did you mean"),
        ("weight = -1.0", "weight = -0.1", GeometryError, "weight is -0.1 N, but glass of 1.6 mm"),
        ("weight = -1.0", "weight = -10", GeometryError, "6 magnets of 2.75 g weigh -1.36 N; corr"),
        ("[shell]", "[shell]\ntool_radius = 0.05", FormatError, "write it above [shell]"),
        ("weight = -1.0", "", FormatError, "lacks 'weight'"),
        ("weight = -1.0", "weight = ", UnreadableFile, "is not TOML"),
        ("thickness = 1.6e-3", "thickness = 0", GeometryError, "thickness is 0 m"),
        ("thickness = 1.6e-3", "thickness = 1.6", GeometryError, "metres: 1.6 mm are 1.6e-3"),
        ("inner_radius = 0.02", "inner_radius = 0.06", GeometryError, "actuator 1 is 0.05 m"),
        ("thickness", "radius_of_curvature = -0.05\nthickness", GeometryError, "cannot carry"),
        ("[shell]", "alpha_range = [0.1]\n[shell]", FormatError, "give 2 values"),
        ("[shell]", "[sensor]\nouter_radius = 0.001\n[shell]", GeometryError, "a sensor from"),
        ("[shell]", "[sensor]\nouter_radius = 0.05\n[shell]", GeometryError, "its sensor reaches"),
        ("[shell]", "alpha_range = [5e-324, 1.0]\n[shell]", FormatError, "positive and near 1"),
        ("[shell]", "coil_gradient = -1e6\n[shell]", FormatError, "sign within the gap"),
        ("[shell]", "puck_radius = -1e-3\n[shell]", FormatError, "puck_radius is -0.001; give z"),
        ("actuators.csv", "nowhere.csv", UnreadableFile, "cannot be read"),
        ("actuators.csv", "mine.toml", FormatError, "line 9 has 1 cell, line 4 has"),
    ],
)  # fmt: skip
def test_what_is_wrong_with_a_file_is_said_in_one_line(mine, old, new, error, said):
    mine.write_text(MINE.replace(old, new, 1))
    with pytest.raises(error) as refused:
        mirror_from(mine)
    assert said in str(refused.value)
    assert ".toml: " in str(refused.value) or ".csv: " in str(refused.value)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("0.05,0.0\n", "\nO.05,0.0\n", "actuators.csv: line 3: X is 'O.05'; give a number"),
        (
            "0.05,0.0\n",
            "0.05,\n",
            "actuators.csv: Y of actuator 1 is not finite; give",
        ),
        ("0.05,0.0\n", "0.09,0.0\n", "actuators.csv: actuator 1 is 0.09 m from the axis"),
        ("X,Y", "A,B", "have no columns x and y, but A and B; name two columns x and y"),
    ],
)
def test_what_is_wrong_with_a_table_names_it_and_the_line(mine, old, new, said):
    assert old in TABLE
    table = TABLE.replace(old, new, 1)
    (mine.parent / "actuators.csv").write_text(table)
    with pytest.raises((FormatError, GeometryError)) as refused:
        mirror_from(mine)
    assert said in str(refused.value)


def test_the_command_lists_tells_and_draws(inside, tmp_path, monkeypatch, mine):
    monkeypatch.chdir(tmp_path)
    _, listed, _ = inside("mirrors")
    assert all(name in listed for name in ("P45", "MMT336", "MAG585", "LBT672", "RING5352"))
    told = inside.prints("mirrors", "p45", "--plot")
    assert "weight                -2.92" in told
    assert "[paper]" in told
    assert ">>>" not in told
    assert (tmp_path / "p45.png").read_bytes().startswith(b"\x89PNG")
    assert inside("mirrors", "p45", "--plot")[0] == 2
    assert json.loads(inside("mirrors", mine, "--json")[1])["actuators"] == 6
    assert inside("mirrors", "p45", "--plot", "-o", "p45.doc")[0] == 2
    assert inside("mirrors", "nobody")[2].startswith("truenewton: no mirror is called 'nobody'")


def test_the_mirror_file_of_the_page_is_a_mirror(tmp_path):
    """With its table; what may be left out is left out, and has the value that the page gives."""
    text = PAGE.read_text(encoding="utf-8")
    (mine,) = re.findall(r'```toml\n(name = "MINE".*?)```', text, re.DOTALL)
    (table,) = re.findall(r"```text\n(ID,X.*?)```", text, re.DOTALL)
    (tmp_path / "actuators.csv").write_text(table)
    (tmp_path / "mine.toml").write_text(mine)
    mirror = mirror_from(tmp_path / "mine.toml")
    plan = replace(small_plan(count=2), mirror="mine.toml")
    assert shapes_and_forces(plan, mirror, tmp_path)[0].shape == (2, 6)
    given = re.findall(r"`(\w+ = [^`]+)`", text.split("## Optional entries")[1].split("\n\n")[2])
    assert len(given) == 8
    for name, value in tomllib.loads("\n".join(given)).items():
        assert np.array_equal(getattr(mirror, name), value), name
    needed = mine.split("[sensor]")[0]
    (tmp_path / "mine.toml").write_text(needed)
    mirror_from(tmp_path / "mine.toml")
    for line in needed.splitlines():
        if "=" in line and not line.startswith("radius_of_curvature"):
            (tmp_path / "mine.toml").write_text(f"\n{needed}".replace(f"\n{line}\n", "\n"))
            with pytest.raises(FormatError, match=f"lacks '{line.split(' ')[0]}'; add it"):
                mirror_from(tmp_path / "mine.toml")
