"""Every command, as a person at a terminal or a script would run it."""

import io
import json
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from astropy.io import fits

import truenewton
from helpers.balanced import p45_matrix
from helpers.json_output import checked
from truenewton.cli import terminal
from truenewton.cli.main import EXAMPLES, GROUPS, app
from truenewton.cli.terminal import say
from truenewton.mirrors.known import ring

ROOT = Path(__file__).parents[2]
README = ROOT / "README.md"


def run(*words):
    """Run truenewton in a process of its own; return exit code, output, errors."""
    command = [sys.executable, "-m", "truenewton", *map(str, words)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    return done.returncode, done.stdout, done.stderr


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Return a simulated campaign of eight actuators, made by the command."""
    path = tmp_path_factory.mktemp("campaign") / "ring8"
    code, out, err = run("simulate", "ring8", "-o", path, "--cycles", "2")
    assert (code, err) == (0, "")
    said = f"{path}: RING8, 2 loads, 2 cycles per load, 8 shapes with both signs;"
    said += " true values: ring8.truth.fits"
    assert " ".join(out.split()) == said
    return path


def test_simulate_writes_the_files_of_the_contract(folder):
    assert sorted(p.name for p in folder.iterdir()) == [
        "bare-001.fits", "bare-002.fits", "ring-001.fits", "ring-002.fits",
    ]  # fmt: skip
    with fits.open(folder.with_name("ring8.truth.fits")) as truth:
        assert "MEASUREMENTS" not in truth


def test_calibrate_writes_a_calibration_near_the_truth(inside, folder, tmp_path):
    output = tmp_path / "alpha.fits"
    assert f"written: {output}" in inside.prints("calibrate", folder, "-o", output)
    with fits.open(output) as made, fits.open(folder.with_name("ring8.truth.fits")) as truth:
        table, true = made["CALIBRATION"].data, truth["TRUTH"].data["ALPHA"]
        assert np.all(np.abs(table["ALPHA"] - true) < 4 * table["E_ALPHA"])
        assert np.abs(table["ALPHA"] - true).max() > 1e-9  # it never saw the truth


def test_default_output_is_short_and_no_line_is_over_100_columns(inside, p45_folder, monkeypatch):
    monkeypatch.chdir(p45_folder.parent)
    monkeypatch.setattr(terminal, "WIDTH", 100)
    alpha, folder = ("alpha.fits", p45_folder.name)
    out = inside.prints("calibrate", folder, "-o", alpha)
    assert len(out.splitlines()) <= 20
    assert f"next: truenewton report {folder} --calibration {alpha} -o report.html\n" in out
    assert out.index("  verdict  ") < out.index("  limit: ") < out.index("  advice: ")
    for words in (("info", folder), ("info", alpha, "-v"), ("mirrors",), ("mirrors", "p45"),
                  ("modes", folder, "--calibration", alpha, "--power", "0.1"), ("prove",),
                  ("recalibrate", folder, "--known", alpha, "--actuators", "3", "-v")):  # fmt: skip
        out += inside(*words)[1]
    assert [line for line in out.splitlines() if len(line) > 100] == []
    assert "a calibration, method ml, common scale from the weights\n" in out


def test_info_says_what_files_hold_and_what_they_lack(inside, p45_folder):
    out = inside.prints("info", p45_folder)
    assert "a campaign of P45: 45 actuators, 4 cycle files, 45 shapes" in out
    assert "alpha                   determined by the data        uniqueness " in out
    out = inside.prints("info", p45_folder / "bare-001.fits")
    assert "alpha is not determined: There is only one load, 'bare'" in out
    assert "1 cycle file, " in out
    assert "1 cycle, 90 rows" in out
    _, out, _ = inside("info", p45_folder / "bare-001.fits", "--json")
    assert json.loads(out)["faults"][0]["remedy"].startswith("add cycles under a load")


def test_prove_prints_the_paper_and_passes(inside):
    out = inside.prints("prove", "p45", "--seed", "3")
    assert out.splitlines()[-1].startswith("alpha is recovered to machine precision")
    _, out, _ = inside("prove", "--json", "--seeds", "2")
    values = json.loads(out)
    assert values["passed"] is True
    assert len(values["proofs"]) == 2 * 8
    assert values["worst"] == max(p["ratio"] for p in values["proofs"]) <= 20


def test_prove_exits_with_1_where_the_proof_fails(inside, monkeypatch):
    from truenewton.studies import proof

    monkeypatch.setattr(proof, "LIMIT", 1e-9)
    code, out, err = inside("prove")
    assert code == 1
    assert "PROOF FAILED" in out
    assert err == ""


def test_prove_exits_with_1_where_the_rank_is_short(inside, p45_folder, tmp_path):
    """As its help says: all actuators on a line but one, whose alpha is free."""
    with fits.open(p45_folder / "bare-001.fits") as file:
        actuators = file["ACTUATORS"]
        actuators.data["X"][:-1], actuators.data["X"][-1] = 0.0, 0.1
        actuators.data["Y"][:] = np.linspace(-0.1, 0.1, 45)
        fits.HDUList([fits.PrimaryHDU(), actuators]).writeto(tmp_path / "line.fits", checksum=True)
    code, out, err = inside("prove", tmp_path / "line.fits")
    assert (code, err) == (1, "")
    assert "44 of 45" in out
    assert "49 of 50" in out
    assert "PROOF FAILED" in out


@pytest.mark.study
def test_demo_prints_its_four_parts_and_writes_its_files(tmp_path, monkeypatch, inside):
    monkeypatch.chdir(tmp_path)
    out = inside.prints("demo")
    for words in (
        "1. A simulated campaign",
        "2. The calibration",
        "3. Comparison",
        "4. The report",
    ):
        assert words in out
    made = {str(p.relative_to(tmp_path)) for p in tmp_path.rglob("*") if p.is_file()}
    assert "truenewton-demo/alpha.fits" in made
    assert "truenewton-demo/figures/fig6-alpha-map.pdf" in made
    assert "truenewton-demo/report.html" in made
    assert "exists already" in inside.refuses("demo")
    assert inside("demo", "--overwrite")[0] == 0


def test_help_has_every_command_in_a_group_and_an_example_of_each(inside):
    assert inside("--version")[:2] == (0, f"truenewton {truenewton.__version__}\n")
    code, out, _ = inside("--help")
    assert inside() == (code, out, "")
    assert (code, out.count("Usage: truenewton")) == (0, 1)
    assert "..." not in out.split("To begin:")[1]
    assert all(f"\n{title}:\n" in out for title in GROUPS)
    assert len(EXAMPLES) == len(app.registered_commands) == 16
    for name, example in EXAMPLES.items():
        assert f"\n  {name} " in out
        _, shown, _ = inside(name, "--help")
        assert f"For example:\n    {example}\n" in shown
        assert "-q, --quiet" in shown
        options = set(re.findall(r" (--?[a-z]+)", example))
        assert options <= set(re.findall(r"--?[a-z]+", shown.split("For example")[0]))
    assert "[ml|svd|reciprocity|auto]" in inside("calibrate", "--help")[1]


def test_quiet_prints_what_was_written_and_what_is_wrong(inside, folder, tmp_path):
    alpha = tmp_path / "alpha.fits"
    assert inside("calibrate", folder, "-q", "-o", alpha) == (0, f"written: {alpha}\n", "")
    assert inside("calibrate", folder, "--quiet") == (0, "", "")
    assert str(alpha) in inside.refuses("calibrate", folder, "-q", "-o", alpha)


@pytest.fixture(scope="module")
def inputs(folder, tmp_path_factory):
    """Return a folder with a plan, a campaign in the cold, two matrices and a calibration."""
    path = tmp_path_factory.mktemp("inputs")
    run("calibrate", folder, "-o", path / "alpha.fits")
    run("plan", "--new", "-o", path / "plan.toml")
    plan = (path / "plan.toml").read_text().replace("cycles = 4", "cycles = 2")
    (path / "plan.toml").write_text(plan.replace("turns = 3", "turns = 2").replace("p45", "ring8"))
    run("simulate", "ring8", "-o", path / "cool", "--cycles", "2", "--temperature", "10")
    truth = truenewton.static_bench(ring(8), 1).truth
    measured = truth.stiffness / truth.alpha[:, None]
    for name, noise in {"matrix": 0.0, "again": 1e-3}.items():
        noisy = measured * (1.0 + noise * np.random.default_rng(1).standard_normal((8, 8)))
        np.save(path / f"{name}.npy", noisy)
        run("import", path / f"{name}.npy", "--mirror", "ring8", "-o", path / f"{name}.fits")
    return path


@pytest.mark.parametrize(
    "words",
    [
        "calibrate {folder}",
        "recalibrate {folder} --known {inputs}/alpha.fits --actuators 3",
        "info {folder}",
        "info {inputs}/matrix.fits",
        "info {inputs}/alpha.fits",
        "track {inputs}/alpha.fits {inputs}/cool --accuracy 0.005",
        "compare {inputs}/matrix.fits {inputs}/again.fits",
        "compare {inputs}/alpha.fits {inputs}/alpha.fits",
        "modes {folder}",
        "modes {folder} --diameter 2.13 --efficiency 0.51",
        "plan {inputs}/plan.toml --target 1e-4",
        "acquire {inputs}/plan.toml -o {new}/day --yes",
        "import {inputs}/matrix.npy --mirror ring8",
        "figures {inputs}/alpha.fits -o {new}/figures",
        "report {inputs}/alpha.fits -o {new}/page.html",
        "prove",
        "mirrors",
        "mirrors p45",
        "mirrors gmt",
    ],
)
def test_json_is_as_its_schema_declares(inside, folder, inputs, tmp_path, words):
    given = words.format(folder=folder, inputs=inputs, new=tmp_path).split()
    code, out, _ = inside(*given, "--json")
    assert code == 0
    known = {"mirrors p45": "mirror", "mirrors gmt": "mirror"}
    assert checked(out)["schema"] == f"truenewton.{known.get(words, given[0])}/2"


def test_json_of_modes_of_a_large_mirror_is_as_its_schema_declares(inside, folder, monkeypatch):
    monkeypatch.setattr("truenewton.modal.findings.MAX_COMPARED", 0)
    assert checked(inside("modes", folder, "--json")[1])["uncalibrated_modes"] is None


def test_the_schema_declares_every_command_with_json(inside):
    schema = truenewton.json_schema()
    commands = {name for name in EXAMPLES if "--json" in inside(name, "--help")[1]}
    assert commands < set(schema["$defs"])
    assert json.loads(inside("--json-schema")[1]) == schema


def closed_pipe():
    """Return a descriptor to write to that has no reader any more."""
    reader, writer = os.pipe()
    os.close(reader)
    return writer


def full_disk():
    return os.open("/dev/full", os.O_WRONLY)


@pytest.mark.skipif(os.name == "nt", reason="Windows has no such files")
@pytest.mark.parametrize(
    ("words", "output", "errors", "code"),
    [
        ("calibrat", None, full_disk, 2),
        ("--version", full_disk, None, 2),
        ("mirrors", closed_pipe, closed_pipe, 0),
    ],
)
def test_a_stream_that_cannot_be_written_does_not_hide_the_exit_code(words, output, errors, code):
    """Python writes what it holds back once more when it ends; its code is 120 if that fails."""
    buffered = {k: value for k, value in os.environ.items() if k != "PYTHONUNBUFFERED"}
    streams = [each() if each else os.open(os.devnull, os.O_WRONLY) for each in (output, errors)]
    try:
        done = subprocess.run(
            [sys.executable, "-m", "truenewton", *words.split()],
            stdout=streams[0], stderr=streams[1], env=buffered, check=False,
        )  # fmt: skip
    finally:
        for stream in streams:
            os.close(stream)
    assert done.returncode == code


def test_a_command_goes_on_if_the_reader_of_its_errors_goes_away(monkeypatch):
    class Gone(io.StringIO):
        def write(self, _):
            raise BrokenPipeError

    gone = Gone()
    monkeypatch.setattr(sys, "stderr", gone)
    say("one", "two", stream=gone)
    with pytest.raises(BrokenPipeError):
        say("one", stream=Gone())


def test_ctrl_c_while_loading_leaves_no_traceback():
    code = (
        "import sys\n"
        "class Stop:\n"
        "    def find_spec(self, name, *_):\n"
        "        if name == 'typer': raise KeyboardInterrupt\n"
        "sys.meta_path.insert(0, Stop())\n"
        "from truenewton.__main__ import main\n"
        "main()\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (130, b"", b"")


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ("truenewton re", ["recalibrate", "report"]),
        ("truenewton calibrate --method r", ["reciprocity"]),
    ],
)
def test_a_shell_completes_commands_options_and_choices(words, expected):
    """As bash asks: what begins with the last word, one a line."""
    asked = {
        **os.environ, "_TRUENEWTON_COMPLETE": "complete_bash", "COMP_WORDS": words,
        "COMP_CWORD": str(len(words.split()) - 1),
    }  # fmt: skip
    done = subprocess.run(
        [sys.executable, "-m", "truenewton"], capture_output=True, text=True, check=False, env=asked
    )
    assert done.stdout.split() == expected
    assert done.stderr == ""


def imported(*lines):
    """Return all modules that command lines import, which is what they cost before they begin."""
    code = (
        "import sys\n"
        "from truenewton.cli import main\n"
        f"for words in {[[*map(str, words)] for words in lines]}:\n"
        "    sys.argv = ['truenewton', *words]\n"
        "    try: main()\n"
        "    except SystemExit as left: assert not left.code\n"
        "print(*sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return set(done.stdout.splitlines()[-1].split())


def test_help_needs_no_numpy():
    """So that it answers at once."""
    heavy = {"numpy", "scipy", "astropy", "matplotlib", "bokeh", "jinja2", "rich"}
    assert heavy.isdisjoint(imported(["--help"], ["--version"]))


def test_calibrate_and_info_import_nothing_heavy_for_little(p45_folder):
    """Half of what they cost is importing; of SciPy they need linear algebra and functions."""
    heavy = {"scipy.stats", "scipy.optimize", "scipy.interpolate", "scipy.spatial", "scipy.fft"}
    heavy |= {"scipy.integrate", "astropy.table", "matplotlib", "bokeh", "jinja2", "rich"}
    made = imported(["calibrate", p45_folder], ["info", p45_folder])
    assert {"scipy.linalg", "astropy.io.fits"} <= made
    assert heavy.isdisjoint(made)


def test_a_terminal_without_the_characters_is_no_error(inside, folder, monkeypatch):
    raw = io.BytesIO()
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(raw, encoding="ascii"))
    assert inside("info", folder)[::2] == (0, "")
    assert b"a campaign of RING8" in raw.getvalue()


def blocks(page):
    """Return the blocks of shell commands and of Python in a page."""
    return re.findall(r"```(sh|python)\n(.*?)```", page.read_text(), flags=re.DOTALL)


def run_page(page, inside):
    """Run every command and every example of a page in order; return how many."""
    ran = 0
    for language, block in blocks(page):
        if language == "python":
            exec(compile(block, page.name, "exec"), {})
            ran += 1
            continue
        for line in block.splitlines():
            words = shlex.split(line, comments=True)
            if not words or words[0] in ("make", "pip", "git", "cd", "python3"):
                continue
            assert words[0] == "truenewton", line
            inside.prints(*words[1:])
            ran += 1
    return ran


@pytest.mark.study
def test_every_command_and_example_in_the_readme_runs(tmp_path, monkeypatch, inside):
    """In order, in one folder, as a reader would; `make` and installing are tried elsewhere."""
    monkeypatch.chdir(tmp_path)
    truenewton.write_stiffness(p45_matrix(0.0)[0], tmp_path / "feedforward.fits")
    assert run_page(README, inside) == 4
    assert sum(run_page(page, inside) for page in sorted((ROOT / "docs").glob("*.md"))) >= 4
    assert run_page(ROOT / "CONTRIBUTING.md", inside) == 3
