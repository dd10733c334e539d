"""Every command on spoiled files and absurd options: a result, or one line and exit code 2.

`pytest --hypothesis-profile=thorough tests/cli/test_spoiled_inputs.py` runs 20,000 cases.
"""

import contextlib
import json
import random
import shutil
import signal
from pathlib import Path

import numpy as np
import pytest
import typer
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st
from typer.testing import CliRunner

import truenewton as tn
from helpers.foreign_files import supervisor_folder
from helpers.spoiled import NUMBERS, TEXTS, spoil
from truenewton.cli.main import app
from truenewton.cli.terminal import BROKEN

pytestmark = pytest.mark.study

MIRROR = """name = "SMALL"
actuators = "actuators.csv"
weight = -1.5
weight_error = 0.005
added_weight = -0.2
added_weight_error = 0.005
bias_force = 0.097
coil_gradient = 600.0
bias_gradient = 31.0
gap = 68e-6
shell = {inner_radius = 27.5e-3, outer_radius = 90e-3, thickness = 1.6e-3}
"""
PLAN = """mirror = "mirror.toml"
cycles = 2
turns = 1
loads = [{name = "bare"}, {name = "ring", added = -0.2, added_error = 0.005, tool = "ring"}]
shapes = {source = "modes", count = 0, stroke = 1e-6, force = 0.3}
limits = {force = 0.6, displacement = 5e-6, gap = 30e-6, temperature = [-10.0, 40.0]}
bench = {kind = "simulated", seed = 1}
"""
MADE = """simulate mirror.toml -o c --cycles 2
simulate mirror.toml -o warm --cycles 2 --seed 1 --temperature 25
calibrate c -o alpha.fits
calibrate warm -o day.fits
modes c -o m.fits
track alpha.fits day.fits -o law.fits
import s -o s.fits
calibrate s.fits -o chan.fits
acquire plan.toml -o run --yes"""
K = "m.commanded.fits"
LINES = f"""calibrate c
calibrate c --method reciprocity --mirror mirror.toml
calibrate {K} --method auto -o out.fits
info c --json
info law.fits
info m.fits
report c -o out.html --calibration alpha.fits --mirror mirror.toml
report alpha.fits day.fits -o out.html
figures alpha.fits -o out
plan plan.toml
acquire plan.toml -o run --yes
acquire plan.toml -o out --yes
import ff.npy xy.csv --unit N/m
import s
import {K} actuators.csv
export s --calibration chan.fits -o out
track alpha.fits day.fits warm
recalibrate c --known alpha.fits --actuators 3
recalibrate c --known law.fits --actuators auto --json
compare alpha.fits day.fits
compare {K} {K}
modes {K} --calibration alpha.fits -o out.fits
simulate mirror.toml -o out --cycles 1
prove mirror.toml
mirrors mirror.toml --json
demo -o out""".splitlines()
OPTIONS = {
    name: {option.opts[-1]: option.is_flag for option in command.params if option.opts[0][0] == "-"}
    for name, command in typer.main.get_command(app).commands.items()
}
OUTPUTS = "out.png", "/dev/full", "no/where/out.fits", "o" * 300 + ".fits", "out\n.fits", ".", "c"


@pytest.fixture(scope="module")
def sound(tmp_path_factory):
    """Return a folder with a file of each kind, of a mirror of 24 actuators."""
    folder = tmp_path_factory.mktemp("sound")
    at = tn.mirrors.p45().layout
    rows = zip(at.id[:24], at.x[:24], at.y[:24], at.nz[:24], strict=True)
    table = "".join(f"{i},{x:.6f},{y:.6f},{z:.6f}\n" for i, x, y, z in rows)
    (folder / "actuators.csv").write_text(f"ID,X,Y,NZ\n{table}")
    (folder / "mirror.toml").write_text(MIRROR)
    (folder / "plan.toml").write_text(PLAN)
    supervisor_folder(folder / "s", positions="coordinates")
    with contextlib.chdir(folder):
        for line in MADE.splitlines():
            assert CliRunner().invoke(app, line.split()).exit_code == 0, line
        matrix = tn.read_stiffness(K)
        np.save("ff.npy", matrix.stiffness)
        np.savetxt(
            "xy.csv", np.stack([matrix.layout.x, matrix.layout.y]).T, header="X,Y", delimiter=","
        )
    (folder / "run" / "ring-002.fits").unlink()  # to be resumed
    return folder


def spoiled(pick, words):
    """Spoil a file that a command line reads, or give it one option more; return its words."""
    if pick.random() < 0.3:
        name, is_flag = pick.choice([*OPTIONS[words[0]].items()])
        values = OUTPUTS if name in ("--output", "--plot", "--figure", "--figures") else ()
        return [*words, name] + [pick.choice(values or (*NUMBERS, *TEXTS))] * (not is_flag)
    named = [Path(word) for word in dict.fromkeys(words) if Path(word).exists()]
    files = [path for each in named for path in (each, *each.rglob("*")) if path.is_file()]
    files += [Path("actuators.csv")] * (Path("mirror.toml") in named)
    for path in pick.sample(files, pick.choice((1, min(2, len(files))))) if files else ():
        spoil(pick, path)
    return words


def contents():
    return {path: path.read_bytes() for path in Path().rglob("*") if path.is_file()}


def late(*_):
    raise TimeoutError


@settings(
    deadline=None,
    derandomize=True,
    phases=[Phase.generate],
    suppress_health_check=[*HealthCheck],
)
@given(line=st.sampled_from(LINES), seed=st.integers(0, 2**32))
def test_a_spoiled_input_gives_a_result_or_one_line(sound, inside, tmp_path_factory, line, seed):
    folder = shutil.copytree(sound, tmp_path_factory.mktemp("case") / "x")
    signal.signal(signal.SIGALRM, late)
    with contextlib.chdir(folder):
        words = spoiled(random.Random(seed), line.split())
        before = contents()
        signal.alarm(60)
        code, out, error = inside(*words)
        signal.alarm(0)
        after = contents()
    shutil.rmtree(folder)
    assert code in (0, 2) or (code, words[0]) == (1, "prove")
    if code == 2:
        assert error.startswith("truenewton: ")
        assert error[:-1].isprintable()
        assert BROKEN not in error
    elif words[0] != "acquire":  # which reports beside --json
        assert error == ""
    if code == 0 and "--json" in words:
        json.loads(out, parse_constant=pytest.fail)
    if words[0] != "acquire":
        assert before.items() <= after.items() or "--overwrite" in words
        assert code != 2 or before.keys() == after.keys()
