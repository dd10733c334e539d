"""Mirrors in segments: those that are known, those of files, and their simulation."""

import json
import os
import re
import sys
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import cKDTree

import truenewton as tn
from helpers.json_output import checked
from truenewton.acquisition.acquire import chosen_bench
from truenewton.bench.choice import BenchChoice
from truenewton.bench.simulated.static import bench_of, campaign_on, static_bench, truth_of
from truenewton.cli.segments import numbered_path
from truenewton.errors import FormatError
from truenewton.mirrors.file import check_mirror, mirror_from, whole_mirror_from
from truenewton.mirrors.glass import Outline
from truenewton.mirrors.known import GRAVITY
from truenewton.mirrors.segmented import SEGMENTED
from truenewton.mirrors.sensor_model import edges_for, segment_sensor_models, sensor_model
from truenewton.mirrors.shell.mesh import depth_inside
from truenewton.statics.arms import effective_weight, external_load, resultants
from truenewton.statics.layout import layout

WHOLE = """
name = "TINY"
segments = [
    {file = "disc.toml", x = 0.11, y = 0.0},
    {file = "square.toml", x = -0.1, y = 0.08, turned = 30.0},
    {file = "disc.toml", x = 0.02, y = -0.19, turned = -100.0},
]
"""
ONE = """
name = "%s"
actuators = "%s"
weight = %g
weight_error = 0.002
added_weight = -0.1
added_weight_error = 0.002
bias_force = 0.09
bias_gradient = 31.0
tool_radius = 0.02
[shell]
inner_radius = 0.0
outer_radius = %g
thickness = 1.6e-3
%s
"""
SQUARE = "[shell.outline]\nedge = [[-0.08, -0.08], [0.08, -0.08], [0.08, 0.08], [-0.08, 0.08]]"


@pytest.fixture
def tiny(tmp_path):
    """Return the file of a mirror of two discs of 7 and a square of 16 actuators."""
    angle = np.radians(60 * np.arange(6))
    ring = zip(0.05 * np.cos(angle), 0.05 * np.sin(angle), strict=True)
    at = [(0.0, 0.0), *ring]
    side = [-0.06, -0.02, 0.02, 0.06]
    for name, places in (("disc", at), ("square", [(x, y) for x in side for y in side])):
        rows = "".join(f"{x:.9g},{y:.9g}\n" for x, y in places)
        (tmp_path / f"{name}.csv").write_text(f"X,Y\n{rows}")
    (tmp_path / "disc.toml").write_text(ONE % ("DISC", "disc.csv", -0.85, 0.075, ""))
    (tmp_path / "square.toml").write_text(ONE % ("SQUARE", "square.csv", -1.45, 0.12, SQUARE))
    path = tmp_path / "tiny.toml"
    path.write_text(WHOLE)
    return path


@pytest.mark.parametrize(("name", "counts"), [("m4", [892] * 6), ("gmt", [672] + [675] * 6)])
def test_known_segments_stand_on_their_glass(name, counts):
    mirror = SEGMENTED[name]()
    assert np.bincount(mirror.layout.segment)[1:].tolist() == counts
    for segment in {id(one): one for one in mirror.segments}.values():
        check_mirror(segment)
        mass = segment.shell.mass + segment.magnet_mass * segment.layout.n
        assert -segment.weight == pytest.approx(mass * GRAVITY, abs=6e-3)
    places = np.stack([mirror.layout.x, mirror.layout.y], axis=1)
    gap = cKDTree(places).query(places, k=2)[0][:, 1]
    assert gap.min() > 0.025  # sensors of neighbours do not touch, over the edges of segments too


def test_places_of_segments(tiny):
    mirror = whole_mirror_from(tiny)
    layout, one = mirror.layout, mirror.segments[1].layout
    assert mirror.segments[0] is mirror.segments[2]
    assert layout.segment.tolist() == [1] * 7 + [2] * 16 + [3] * 7
    at = (layout.x + 1j * layout.y)[7:23]
    assert at == pytest.approx(-0.1 + 0.08j + np.exp(1j * np.pi / 6) * (one.x + 1j * one.y))


def test_true_forces_of_each_segment_balance_its_own_load(tiny):
    """Noiseless, in the frame of the mirror; the sums over segments are those of the truth."""
    bench = bench_of(whole_mirror_from(tiny), 5, force_noise=0.0, temperature=20.0)
    truth = truth_of(bench)
    assert len(bench.shapes) == 16
    by_load = [[row for row in truth.segments if row.load == load] for load in truth.loads]
    for cycle, rows in zip(campaign_on(bench, 1), by_load, strict=True):
        assert cycle.weight == pytest.approx(-0.85 - 1.45 - 0.85)
        assert cycle.layout.same_as(truth.layout)
        # Less what the bias magnets change with displacement, which is not the coils' to bear.
        softer = cycle.force * truth.alpha + 31.0 * truth.sensor_gain * cycle.position
        for row in rows:
            own = truth.layout.segment == row.number
            weight = effective_weight(row.weight, row.added, 0.0)
            load = external_load(weight, row.bias_force, row.torque_y, row.torque_x)
            got = resultants(truth.layout.part(own), softer[:, own])
            assert np.abs(got + load).max() < 1e-7
    for name in ("bias_force", "torque_y", "torque_x"):
        total = [sum(getattr(row, name) for row in rows) for rows in by_load]
        assert getattr(truth, name) == pytest.approx(total if name != "bias_force" else total[0])


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("x = 0.02, y = -0.19", "x = 0.11, y = 0.0", "two actuators are at"),
        ("x = 0.02, ", "", "lacks 'x'; add it"),
        ('"disc.toml", x = 0.11', '"no.toml", x = 0.11', "no.toml: cannot be read"),
        ('"disc.toml", x = 0.11', '"tiny.toml", x = 0.11', "takes tiny.toml for a segment"),
        (
            "x = 0.02, y = -0.19",
            "x = 0.11, y = -0.14",
            "1 (DISC) and 3 (DISC) overlap, by 10 mm",
        ),
        ("x = 0.11", "x = 110.0", " is 110 m from the axis"),
    ],
)
def test_segments_that_cannot_be(inside, tiny, old, new, said):
    assert old in WHOLE
    tiny.write_text(WHOLE.replace(old, new, 1))
    error = inside.refuses("simulate", tiny, "-o", tiny.with_name("c"))
    assert said in error


def test_parts_that_do_not_go_together(inside, tiny):
    """Another gap, and forces that are not vertical."""
    disc, table, folder = (tiny.with_name(name) for name in ("disc.toml", "disc.csv", "c"))
    text = disc.read_text()
    disc.write_text(text.replace("[shell]", "gap = 70e-6\n[shell]"))
    assert "gap of SQUARE is not that of DISC" in inside("simulate", tiny, "-o", folder)[2]
    disc.write_text(text)
    head, *rows = table.read_text().splitlines()
    table.write_text("\n".join([f"{head},NZ", *(f"{row},0.99" for row in rows)]))
    assert "segment DISC has NZ other than 1" in inside("simulate", tiny, "-o", folder)[2]


@pytest.mark.parametrize("command", ["prove", "simulate --fidelity loop -o c"])
def test_what_takes_no_segments_says_so(inside, tiny, monkeypatch, command):
    monkeypatch.chdir(tiny.parent)
    name, *more = command.split()
    error = inside.refuses(name, tiny, *more)
    assert "in segments" in error
    assert mirror_from(tiny.with_name("disc.toml")).layout.n == 7


def test_a_plan_of_segments_is_that_of_the_worst(inside, tiny):
    """Each as planned by itself; what acquires takes one segment at a time, and says so."""
    said = {}
    text = inside("plan", "--new")[1].replace("-0.289", "-0.1")
    for name in ("disc", "square", "tiny"):
        path = tiny.with_name(f"plan-{name}.toml")
        path.write_text(text.replace('"p45"', f'"{name}.toml"'))
        out = inside.prints("plan", path, "--json")
        said[name] = json.loads(out)
    worst = max(("disc", "square"), key=lambda name: said[name]["typical_error"])
    assert said["tiny"]["typical_error"] == said[worst]["typical_error"]
    which = {"disc": "1 (as segment 3)", "square": "2"}[worst]
    assert said["tiny"]["instrument"] == f"TINY segment {which}, the worst of 2 that differ"
    error = inside.refuses("acquire", path, "-o", tiny.with_name("c"))
    assert "is a mirror in segments; give the file of one segment" in error


def test_segments_are_acquired_one_by_one_and_read_from_all_their_files(inside, tiny):
    """Each has its actuators, and the truth that a simulation of the whole mirror has."""
    plan, folders = tiny.with_name("plan.toml"), []
    text = inside("plan", "--new")[1].replace("-0.289", "-0.1").replace('"p45"', '"tiny.toml"')
    for old, new in (
        ("cycles = 4", "cycles = 1"),
        ("turns = 3", "turns = 1"),
        ("count = 0", "count = 12"),
    ):
        text = text.replace(old, new)
    plan.write_text(text)
    for number in (1, 2, 3):
        folders.append(tiny.with_name(f"segment-{number}"))
        words = ("acquire", plan, "--segment", number, "-o", folders[-1], "--yes")
        inside.prints(*words)
    mirror = whole_mirror_from(tiny)
    truth = truth_of(bench_of(mirror, 1, force_noise=1e-4, temperature=20.0))
    assert np.array_equal(
        np.concatenate([tn.read_truth(f"{folder}.truth.fits").alpha for folder in folders]),
        truth.alpha,
    )
    for number in (1, 2, 3):
        data, own = tn.read(folders, segment=number), mirror.layout.in_segment(number)
        assert data.instrument == f"TINY segment {number}"
        assert data.layout.same_as(mirror.layout.part(own))
        made = tn.calibrate(data)
        assert np.abs((made.alpha - truth.alpha[own]) / made.error).max() < 4.5
    assert tn.read(folders[1]).instrument == "TINY segment 2"
    elsewhere = replace(tn.read_plan(plan), bench=BenchChoice("opticalib", "lab:mirror"))
    with pytest.raises(FormatError, match=r"tiny\.toml' is a mirror in segments"):
        chosen_bench(elsewhere, tiny.parent)
    error = inside.refuses("info", folders[1], "--segment", 3)
    assert f"{folders[1]}{os.sep}" in error
    assert "there is no segment 3; choose 2" in error
    alone = tiny.with_name("alone.fits")
    tn.calibrate(tn.read(folders[1])).write(alone)
    assert inside("info", alone, "--segment", 2)[0] == 0
    error = inside.refuses("info", alone, "--segment", 3)
    assert f"{alone}: there is no segment 3; choose 2" in error
    again = inside("acquire", plan, "--segment", 1, "-o", folders[0], "--yes")[1]
    assert "complete already" in again
    error = inside.refuses("acquire", plan, "--segment", 3, "-o", folders[0], "--yes")
    assert "was begun with another plan: -segment = 1, +segment = 3" in error


CONTROL = """
import truenewton as tn

def unit(seed):
    return lambda mirror: tn.SimulatedBench(mirror, seed)

unit1, unit2, unit3 = map(unit, (71, 72, 73))
"""


def test_a_segment_is_acquired_at_its_own_address(inside, tiny, monkeypatch):
    """As each has a control unit of its own: its number stands in the address."""
    monkeypatch.setattr(sys, "path", list(sys.path))
    tiny.with_name("control_of_tiny.py").write_text(CONTROL)
    text = inside("plan", "--new")[1].replace("-0.289", "-0.1").replace('"p45"', '"tiny.toml"')
    text = re.sub("(?m)^(cycles|turns) = .*$", r"\1 = 1", re.sub("(?m)^settling = .*$", "", text))
    bench = '[bench]\nkind = "python"\naddress = "control_of_tiny:unit{segment}"\n'
    plan, folder = tiny.with_name("plan.toml"), tiny.with_name("second")
    plan.write_text("settling = 0.0\n" + text.split("[bench]")[0] + bench)
    error = inside.refuses("acquire", plan, "--segment", 4, "-o", folder, "--yes")
    assert "there is no segment 4; choose 1, 2, 3" in error
    inside.prints("acquire", plan, "--segment", 2, "-o", folder, "--yes")
    whole, found = whole_mirror_from(tiny), tn.calibrate(tn.read(folder))
    assert found.layout.same_as(whole.layout.part(whole.layout.segment == 2))
    truth = static_bench(whole.segments[1], 72).truth
    assert np.abs((found.alpha - truth.alpha) / found.error).max() < 4.5


def test_what_sensors_of_segments_see(inside, tiny):
    """Turned as a glass whose outline was turned; by reciprocity alpha is within its errors."""
    whole = whole_mirror_from(tiny)
    square, place = whole.segments[1], whole.places[1]
    own = whole.layout.segment == 2
    seen = sensor_model(whole, whole.layout)
    assert not seen[:, own][:, :, ~own].any()
    by_segment = segment_sensor_models(whole, whole.layout)
    assert sorted(by_segment) == [1, 2, 3]
    for number, of_it in by_segment.items():
        part = whole.layout.in_segment(number)
        assert np.array_equal(seen[:, part][:, :, part], of_it)
    assert np.array_equal(sensor_model(whole, whole.layout.part(own)), by_segment[2])
    (edge,) = (whole.seen_edges()[1] - [place.x, place.y],)
    at = whole.layout.part(own)
    alone = replace(
        square,
        shell=replace(square.shell, outline=Outline(tuple(map(tuple, edge.tolist())))),
        layout=layout(at.x - place.x, at.y - place.y),
    )
    expected = sensor_model(alone, alone.layout)
    for one, other in zip(seen[:, own][:, :, own], expected, strict=True):
        assert np.linalg.norm(one - other) < 0.02 * np.linalg.norm(other)
    folder, found = tiny.with_name("r"), tiny.with_name("r.fits")
    assert inside("simulate", tiny, "-o", folder, "--cycles", 2, "--noise", 3e-5)[0] == 0
    asked = ("--method", "reciprocity", "--mirror", tiny)
    assert inside("calibrate", folder, *asked, "-o", found)[0] == 0
    truth = tn.read_truth(tiny.with_name("r.truth.fits"))
    for number in by_segment:
        part, made = whole.layout.in_segment(number), tn.read(numbered_path(found, number))
        assert np.abs((made.alpha - truth.alpha[part]) / made.error).max() < 4
    code, _, error = inside("calibrate", folder, *asked[:3], tiny.with_name("square.toml"))
    assert code == 2
    assert "with its ACTUATORS table; of a segment, that of the whole" in error
    check_edges_on_maps(inside, whole, tiny, found)


def check_edges_on_maps(inside, whole, tiny, found):
    """Behind the actuators of a calibration; of another mirror none."""
    page = tiny.with_name("e.html")
    edges = whole.seen_edges()
    for number, edge in enumerate(edges, 1):
        made = numbered_path(found, number)
        inside.prints("report", made, "--mirror", tiny, "-o", page, "--overwrite")
        text = page.read_text("utf-8")
        assert "Lines: edges of the glass." in text
        x, y = (json.loads(re.findall(rf'\["{k}s",(\[\[.*?\]\])\]', text)[0]) for k in "xy")
        closed = np.concatenate([edge, edge[:1]])
        assert np.stack([x[0], y[0]], axis=1) == pytest.approx(1e3 * closed)
    with pytest.raises(tn.errors.CampaignMismatch, match="of P45 are not those of the data"):
        edges_for(tn.mirrors.p45(), whole.layout)
    for edge, number in zip(edges, (1, 2, 3), strict=True):
        own = whole.layout.part(whole.layout.segment == number)
        (alone,) = edges_for(whole, replace(own, segment=None))
        assert np.array_equal(alone, edge)
        assert depth_inside([alone], np.stack([own.x, own.y], axis=1)).min() > 0.01


@pytest.mark.parametrize("lost", [True, False])
def test_segments_of_data_are_those_of_the_glass(tiny, lost):
    """Discs 1 and 3 hold as many actuators, so nothing else would tell them apart."""
    whole = whole_mirror_from(tiny)
    other = None if lost else 4 - np.asarray(whole.layout.segment)
    for of in (sensor_model, edges_for):
        with pytest.raises(tn.errors.CampaignMismatch, match="other actuators behind a segment"):
            of(whole, replace(whole.layout, segment=other))


def test_the_command_tells_of_segments(inside, tiny):
    listed = inside("mirrors")[1]
    assert re.search(r"M4, 6 x +892", listed)
    assert re.search(r"GMT, 6 x +675", listed)
    told = inside("mirrors", tiny)[1]
    assert "segments 1 at 0.11, 0 m, turned 0 deg, 3 at 0.02, -0.19 m, turned -100 deg:" in told
    values = checked(inside("mirrors", tiny, "--json")[1])
    assert [one["actuators"] for one in values["segments"]] == [7, 16, 7]
    assert "[assumed]" in inside("mirrors", "gmt")[1]
