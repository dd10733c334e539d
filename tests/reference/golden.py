"""What the command line writes: a checksum and summary numbers of each output (`make golden`).

    python -m reference.golden [--record] [WORD...]

Runs the commands below, or those that contain a word and all before them, on P45 and on a hexagon
in a temporary folder. Prints which outputs differ from the recorded ones. On the machine and with
the versions of the record, each output must have the same checksum. Elsewhere the words must be the
same, and of each column of numbers the count, mean and rms (`TOLERANCE`). --record records all.
"""

from __future__ import annotations

import argparse
import contextlib
import datetime
import hashlib
import io
import itertools
import json
import os
import platform
import re
import sys
import tempfile
import uuid
import warnings
from collections.abc import Iterator
from importlib.metadata import version
from pathlib import Path
from types import SimpleNamespace
from unittest import mock

import matplotlib as mpl
import numpy as np
import threadpoolctl
from astropy.io import fits

from helpers.foreign_files import measured, supervisor_folder
from truenewton.cli.main import main as run_main
from truenewton.importers import export

RECORD = Path(__file__).parent / "golden.txt"
TOLERANCE = 1e-4  # of the rms of a column of numbers
# Of outputs with rounding errors, and of an iteration that ends before the last digits.
TOLERANCES = {"prove": 1e9, "calibrate_loop": 0.02, "loop.fits": 0.02}
PACKAGES = ("numpy", "scipy", "astropy", "matplotlib", "bokeh", "jinja2", "rich", "typer")
NUMBER = re.compile(r"(?<![\w.#])[-+]?\d+\.?\d*(?:[eE][-+]?\d+)?(?!\w)")
# What differs from run to run; data and code of a page, which its text and figures repeat;
# checksums.
PASSING = re.compile(
    r'"(?:time|elapsed|python|host|process)": [^,]+, |<script.*?</script>'
    r"|base64,[\w+/=]+|\d{4}-\d\d-\d\dT[\d:.]+|\b[0-9a-f]{64}\b",
    re.DOTALL,
)
COMMANDS = """
mirrors --json
mirrors hexagon.toml --plot -o hexagon.png
prove p45 --json
simulate p45 -o p45 --cycles 2
simulate p45 -o warm --cycles 2 --temperature 28 --noise 2e-4
simulate p45 -o hot --cycles 2 --temperature 35
simulate p45 -o loop --cycles 1 --fidelity loop
simulate hexagon.toml -o hexagon --cycles 2
info p45 --json
calibrate p45 -o p45.fits --json
calibrate warm -o warm.fits -v
calibrate p45 -o svd.ecsv --method svd
calibrate loop -o loop.fits --mirror p45 --json
calibrate hexagon -o hexagon.fits --population --json
report p45 --calibration p45.fits -o p45.html --json
report hexagon -o hexagon.html --diameter 1.0
figures p45.fits -o figures
plan --new -o full.toml
plan full.toml --target 0.005 --plot plan.svg --json
modes hexagon --calibration hexagon.fits --diameter 1.0 --efficiency 0.5 -o modes.fits --json
acquire plan.toml -o taken --yes --json
calibrate taken -o taken.fits
track p45.fits warm.fits hot -o track.fits --json
compare p45 warm -o compare.fits --json
recalibrate warm --known p45.fits --actuators 5,17 -o new.fits --json
import k.npy places.csv -o k.fits --unit N/m --date 2026-05-04 --instrument RING --json
calibrate k.fits -o k.ecsv --anyway --json
import supervisor -o rows.fits --lengths mm --curvature 1.955 --arc --json
calibrate rows.fits -o rows-alpha.fits --method ml
export supervisor --calibration rows-alpha.fits -o calibrated --anyway
"""
HEXAGON = """name = "HEXAGON"
actuators = "places-19.csv"
weight = -2.36
weight_error = 0.002
added_weight = -0.25
added_weight_error = 0.001
tool_radius = 0.05
[shell]
thickness = 1.6e-3
outline.edge = [[0.115, 0], [0.0575, 0.0996], [-0.0575, 0.0996], [-0.115, 0], [-0.0575, -0.0996],
                [0.0575, -0.0996]]
"""
PLAN = """mirror = "p45"
cycles = 1
shapes = {count = 12}
loads = [{name = "bare"}, {name = "ring", added = -0.289, added_error = 0.005, tool = "ring"}]
"""
ENVIRONMENT = {"SOURCE_DATE_EPOCH": "1700000000", "COLUMNS": "80"}  # date in a PDF; line length


def machine() -> str:
    """Return what the last digits of a result depend on."""
    blas = {str(pool.get("architecture")) for pool in threadpoolctl.threadpool_info()}
    versions = ", ".join(f"{name} {version(name)}" for name in PACKAGES)
    return (
        f"{platform.system()}, {', '.join(sorted(blas))}, {platform.python_version()}, {versions}"
    )


def write_inputs() -> None:
    """Write the files that the commands read."""
    steps = range(-2, 3)
    places = [(0.04 * (i + j / 2), 0.03464 * j) for j in steps for i in steps if abs(i + j) <= 2]
    np.savetxt("places-19.csv", places, "%.5f", delimiter=",", header="X,Y", comments="")
    Path("hexagon.toml").write_text(HEXAGON, encoding="utf-8")
    Path("plan.toml").write_text(PLAN, encoding="utf-8")
    matrix = measured()
    np.save("k.npy", matrix.k)
    at = np.stack([matrix.layout.x, matrix.layout.y], axis=1)
    np.savetxt("places.csv", at, "%.8f", delimiter=",", header="X,Y", comments="")
    supervisor_folder(Path("supervisor"), positions="coordinates")


def run(command: str) -> str:
    """Return exit code, output and errors of a command in the present folder."""
    out, code = io.StringIO(), None
    argv = mock.patch.object(sys, "argv", ["truenewton", *command.split()])
    with argv, contextlib.redirect_stdout(out), contextlib.redirect_stderr(out):
        try:
            run_main()
        except SystemExit as end:
            code = end.code
    return f"exit code {code}\n{out.getvalue()}"


def of_json(value: object, name: str = "") -> Iterator[tuple[str, float]]:
    """Yield the path (without indices) and value of every number."""
    if isinstance(value, dict):
        for key, item in value.items():
            yield from of_json(item, f"{name}.{key}")
    elif isinstance(value, list):
        for item in value:
            yield from of_json(item, name)
    elif isinstance(value, int | float):
        yield name, float(value)


def of_text(text: str) -> dict[str, list[float]]:
    """Return the numbers of a text by their place in a line; of JSON by their names."""
    found: dict[str, list[float]] = {}
    with contextlib.suppress(ValueError):
        for name, value in of_json(json.loads(text.partition("\n")[2])):
            found.setdefault(name, []).append(value)
        return found
    for line in text.splitlines():
        for place, number in enumerate(NUMBER.findall(line)):
            found.setdefault(str(min(place, 9)), []).append(float(number))
    return found


def of_fits(content: bytes) -> dict[str, np.ndarray]:
    """Return the numbers of all images, columns and header cards."""
    found: dict[str, np.ndarray] = {}
    with fits.open(io.BytesIO(content)) as file:
        for k, hdu in enumerate(file):
            skipped = ("CHECKSUM", "DATASUM")
            cards = [v for key, v in hdu.header.items() if key not in skipped]
            found[f"{k}"] = np.array([v for v in cards if isinstance(v, int | float)], dtype=float)
            names = getattr(hdu.data, "names", None) or ([] if hdu.data is None else [""])
            for name in names:
                values = np.asarray(hdu.data[name] if name else hdu.data)
                if values.dtype.kind in "fiub":
                    found[f"{k}.{name}"] = values.astype(float).ravel()
    return found


def summary(name: str, content: bytes) -> list[str]:
    """Return the lines of an output: checksum, words, and count, mean and rms of its columns."""
    suffix, words, columns = Path(name).suffix, "", {}
    if suffix == ".fits":
        columns = of_fits(content)
    elif suffix == ".npy":
        columns = {"": np.load(io.BytesIO(content))}
    elif suffix not in (".png", ".pdf"):
        text = PASSING.sub("", content.decode("utf-8"))
        columns = of_text(text)
        visible = re.sub(r"<[^>]*>", "", text) if suffix in (".html", ".svg") else text
        words = hashlib.sha256(NUMBER.sub("#", visible).encode()).hexdigest()[:8]
        content = text.encode() if suffix == ".jsonl" else content
    lines = [f"{name} {hashlib.sha256(content).hexdigest()[:16]} {words}"]
    for key, values in columns.items():
        finite = np.asarray(values, dtype=float)
        finite = finite[np.isfinite(finite)]
        mean, rms = (float(np.mean(finite**p)) if finite.size else 0.0 for p in (1, 2))
        lines.append(f"    {key.replace(' ', '_')} {finite.size} {mean:.7g} {rms**0.5:.7g}")
    return lines


class Clock(datetime.datetime):
    """A clock that stands still."""

    @classmethod
    def now(cls, tz: datetime.tzinfo | None = None) -> datetime.datetime:
        return datetime.datetime(2026, 5, 4, 9, 30, tzinfo=tz)


def outputs(words: list[str]) -> dict[str, list[str]]:
    """Run the commands; return the summary of what each prints, and of each written file."""
    commands = [line for line in COMMANDS.splitlines() if line]
    last = max(k for k, line in enumerate(commands) if not words or any(w in line for w in words))
    names = map(uuid.UUID, map("{:032x}".format, itertools.count()))
    clock = SimpleNamespace(datetime=Clock, UTC=datetime.UTC)
    found: dict[str, list[str]] = {}
    with (
        tempfile.TemporaryDirectory() as folder,
        contextlib.chdir(folder),
        warnings.catch_warnings(action="ignore"),
        mpl.rc_context({"svg.hashsalt": "golden"}),
        mock.patch.dict(os.environ, ENVIRONMENT),
        mock.patch("uuid.uuid4", names.__next__),
        mock.patch.object(export, "datetime", clock),
    ):
        write_inputs()
        known = set(Path().rglob("*"))
        for command in commands[: last + 1]:
            name = f"{command.replace(' ', '_')}.txt"
            found[name] = summary(name, run(command).encode())
            for path in sorted(set(Path().rglob("[!.]*")) - known):
                known.add(path)
                if path.is_file():
                    found[str(path)] = summary(str(path), path.read_bytes())
    return found


def differences(old: list[str], new: list[str], *, bytewise: bool) -> list[str]:
    """Return how an output differs from the recorded one; nothing if it does not."""
    if old[0].split()[1] == new[0].split()[1]:
        return []
    tolerance = next((x for k, x in TOLERANCES.items() if old[0].startswith(k)), TOLERANCE)
    was, now = ({line.split()[0]: line.split()[1:] for line in lines[1:]} for lines in (old, new))
    said = ["other words"] if old[0].split()[2:] != new[0].split()[2:] else []
    said += [f"- {key}" for key in was.keys() - now.keys()]
    said += [f"+ {key}" for key in now.keys() - was.keys()]
    for key in [key for key in was if key in now]:
        (n, mean, rms), (other, *values) = np.array([was[key], now[key]], dtype=float)
        if n != other:
            said.append(f"{key}: {other:.0f} numbers instead of {n:.0f}")
        elif max(abs(values[0] - mean), abs(values[1] - rms)) > tolerance * rms:
            said.append(f"{key}: mean {mean:g}, rms {rms:g} became {values[0]:g}, {values[1]:g}")
    return said or (["other bytes; words and numbers agree"] if bytewise else [])


def main() -> None:
    """Record the outputs, or print which differ from the recorded ones."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("--record", action="store_true")
    parser.add_argument("words", nargs="*")
    options = parser.parse_args()
    found = outputs([] if options.record else options.words)
    recorded, blocks = "", {}
    if RECORD.exists():
        recorded, *rest = re.split(r"\n(?! |$)", RECORD.read_text(encoding="utf-8").rstrip())
        blocks = {block.split()[0]: block.splitlines() for block in rest}
    same_machine = recorded == machine()
    print(f"{len(found)} outputs; {'checksums' if same_machine else 'another machine: numbers'}")
    missing = [] if options.words else blocks.keys() - found.keys()
    said = {name: ["is missing"] for name in missing}
    said |= {name: differences(blocks[name], lines, bytewise=same_machine)
             if name in blocks else ["is new"] for name, lines in found.items()}  # fmt: skip
    for name in (name for name in said if said[name]):
        print("\n    ".join([name, *said[name][:8]]))
    if options.record:
        lines = [line for block in found.values() for line in block]
        RECORD.write_text("\n".join([machine(), *lines]) + "\n", encoding="utf-8")
    elif any(said.values()):
        sys.exit(1)


if __name__ == "__main__":
    main()
