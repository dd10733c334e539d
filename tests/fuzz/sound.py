"""Sound files of every kind, made with the project's own commands, of a mirror of 24 actuators."""

from __future__ import annotations

import shutil
from pathlib import Path

import truenewton as tn
from tests.helpers.acquisition_plans import write_shapes
from truenewton.files.fits import read_fits

from .foreign import make_foreign
from .process import must

MIRROR = """name = "SMALL"
actuators = "actuators.csv"
weight = -1.5
weight_error = 0.005
added_weight = -0.2
added_weight_error = 0.005
bias_force = 0.097
magnet_mass = 2.75e-3
alpha_range = [0.8, 1.1]
gap = 68e-6
coil_gradient = 600.0
bias_gradient = 31.0
[shell]
inner_radius = 27.5e-3
outer_radius = 90e-3
thickness = 1.6e-3
radius_of_curvature = 1.955
"""
PLAN = """mirror = "mirror.toml"
cycles = 2
samples = 64
settling = 0.15
pause = 100.0
force_noise = 1e-4
turns = 1
loads = [{name = "bare"}, {name = "ring", added = -0.2, added_error = 0.005, tool = "ring"}]
shapes = {source = "modes", count = 0, stroke = 1e-6, force = 0.3}
limits = {force = 0.6, displacement = 5e-6, gap = 30e-6, temperature = [-10.0, 40.0]}
drift = {alpha = 3e-3, zero = 1e-5, remounting = 1e-5}
"""
BENCHES = {
    "plan": '{kind = "simulated", seed = 1, force_noise = 1e-4, fidelity = "static"}',
    "loop": '{kind = "simulated", seed = 1, force_noise = 1e-4, fidelity = "loop"}',
    "away": '{kind = "python", address = "away:Bench"}',
}


def make_sound(at: Path) -> None:
    """Make a sound file of each kind, with the project's own commands."""
    layout = tn.mirrors.p45().layout
    rows = list(zip(range(1, 25), layout.x, layout.y, layout.nz, strict=False))
    lines = [f"{i},{x:.6f},{y:.6f},{z:.6f}" for i, x, y, z in rows]
    (at / "actuators.csv").write_text("\n".join(["ID,X,Y,NZ", *lines, ""]))
    columns = "".join(f"# - {{name: {n}, unit: mm, datatype: float64}}\n" for n in "XY")
    lines = [f"{1e3 * x:.3f} {1e3 * y:.3f}" for _, x, y, _ in rows]
    (at / "table.ecsv").write_text(
        "\n".join(["# %ECSV 1.0", "# ---", f"# datatype:\n{columns}X Y", *lines, ""])
    )
    (at / "mirror.toml").write_text(MIRROR)
    (at / "table.toml").write_text(MIRROR.replace("actuators.csv", "table.ecsv"))
    for name, bench in BENCHES.items():
        (at / f"{name}.toml").write_text(f"{PLAN}bench = {bench}\n")
    (at / "done.toml").write_text((at / "plan.toml").read_text())
    for name, old, new in (
        ("measured", '"modes"', '"stiffness.fits"'),
        ("given", '"modes"', '"shapes.fits"'),
        ("ecsv", "mirror.toml", "table.toml"),
    ):
        (at / f"{name}.toml").write_text(f"{PLAN.replace(old, new)}bench = {BENCHES['plan']}\n")
    days = [
        f"simulate mirror.toml -o d{k} --cycles 2 --seed 1 --temperature {15 + 4 * k}"
        for k in range(4)
    ]
    for line in (
        "simulate mirror.toml -o c --cycles 2", *days,
        *(f"calibrate d{k} -o day{k}.fits" for k in range(4)), "calibrate c -o ml.fits",
        "calibrate c --method svd -o svd.fits", "modes c -o m.fits",
        "calibrate c --method reciprocity --mirror mirror.toml -o rec.fits",
        "track day0.fits day1.fits day2.fits day3.fits -o track.fits",
        "acquire done.toml -o done --yes", "acquire plan.toml -o run --yes",
    ):  # fmt: skip
        must(line, at)
    (at / "m.commanded.fits").rename(at / "stiffness.fits")
    write_shapes(at / "shapes.fits", 1e-7 * read_fits(at / "m.fits").pixels("MODES").T)
    must("calibrate stiffness.fits -o feed.fits", at)
    make_foreign(at)
    for path in (at / "run").glob("ring*.fits"):  # as if it had been stopped in its third cycle
        path.unlink()
    for k in range(4):
        shutil.rmtree(at / f"d{k}")
