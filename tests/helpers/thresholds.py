"""Multiply each constant that decides about data by three; a test of its package must fail.

    python -m helpers.thresholds [WORD...]     (make thresholds CASES="WORD ...")

Runs tests/<package>/test_thresholds.py with each constant whose path or name contains a word (all
without words), in a copy of the source. Prints constants that survive; exits with code 1 for any.
"""

import argparse
import ast
import importlib.util
import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from truenewton.errors import TrueNewtonError
from truenewton.estimation.findings.code import LIMITS

ROOT = Path(__file__).parents[2]
SOURCE = ROOT / "src" / "truenewton"
FILE = "test_thresholds.py"
PACKAGES = ("modal", "comparison", "tracking", "recalibration", "planning", "calibration",
            "estimation")  # fmt: skip
# Drawing and tables; files whose mechanism goes or is about to be built anew.
NO_DECISIONS = ("figures.py", "summary.py", "estimation/effects/",
                "estimation/campaign_ml.py")  # fmt: skip
# Steps, sizes of blocks, rounding, physics: of the computation, not of the data.
# NEGLIGIBLE_SCALE_ERROR is used in estimation/effects.
COMPUTATION = re.compile(
    r"(?:MAX_|SCALE_|LAW_)?(?:STEPS|PASSES|ITERATIONS|NAMING_PASSES|PREDICTION_STEPS|DRAWS)|BLOCKS?"
    r"|ROUNDING|GRAVITY|POUND|WAVELENGTH|FRIED|SPECTRUM|ORDER|SERIES_\w+|\w+_AT_ONCE"
    r"|MIN_BLOCK|MAX_EXACT_ORDER|MAX_ORDERS|MIN_LIMIT|BY_TURBULENCE|MAX_STEP"
    r"|STEP_TOLERANCE|SETTLED_STEP|MIN_RELATIVE_SIZE|MAX_LEVERAGE|MIX_\w+|UNCONSTRAINED"
    r"|SPREAD_GRID|DISTANCE_BINS|TYPICAL_STIFFNESS|MAX_NUMBER|LARGEST_ALPHA|MIN_START_ALPHA"
    r"|NEGLIGIBLE_SCALE_ERROR"
)


def outcome(call: Callable[[], object]) -> str:
    """Return whether a call is refused."""
    try:
        call()
    except TrueNewtonError:
        return "refused"
    return "accepted"


def between(cases: list[tuple[Any, ...]]) -> Callable[..., None]:
    """Return the test of (constant, function, below, result there, above, result there)."""
    names = ("function", "below", "at_below", "above", "at_above")

    @pytest.mark.parametrize(names, [case[1:] for case in cases], ids=[c[0] for c in cases])
    def test(
        function: Callable[[Any], object], below: Any, at_below: Any, above: Any, at_above: Any
    ) -> None:
        assert function(below) == at_below
        assert function(above) == at_above

    return test


def assigned(tree: ast.Module) -> Iterator[tuple[str, ast.expr]]:
    """Yield name and value of each number that a module or its class Thresholds assigns."""
    for node in tree.body:
        if isinstance(node, ast.Assign):
            sides = [side.elts if isinstance(side, ast.Tuple) else [side]
                     for side in (node.targets[0], node.value)]  # fmt: skip
            for target, value in zip(*sides, strict=False):
                name, text = ast.unparse(target), re.sub(r"np\.log|[\s(]", "", ast.unparse(value))
                if name.isupper() and re.match(r"[-+]?\d", text) and "arange" not in text:
                    yield name, value
        elif isinstance(node, ast.ClassDef) and node.name == "Thresholds":
            for field in node.body:
                if isinstance(field, ast.AnnAssign) and isinstance(field.value, ast.Call):
                    yield ast.unparse(field.target), field.value.args[0]


def constants(words: list[str]) -> list[tuple[Path, str, ast.expr]]:
    """Return path, name and value of each constant that decides about data."""
    found = []
    for path in (path for package in PACKAGES for path in (SOURCE / package).rglob("*.py")):
        own = str(path.relative_to(SOURCE))
        if any(part in own for part in NO_DECISIONS):
            continue
        for name, value in assigned(ast.parse(path.read_text(encoding="utf-8"))):
            chosen = not words or any(word in f"{own} {name}" for word in words)
            if chosen and not COMPUTATION.fullmatch(name):
                found.append((path, name, value))
    return sorted(
        found, key=lambda one: (PACKAGES.index(one[0].relative_to(SOURCE).parts[0]), one[0])
    )


def cases_of(files: list[Path], name: str) -> list[tuple[Any, ...]]:
    """Return the cases of a constant in test files."""
    found = []
    for path in files:
        spec = importlib.util.spec_from_file_location("_".join(path.parts[-3:])[:-3], path)
        if spec.name not in sys.modules:
            sys.modules[spec.name] = importlib.util.module_from_spec(spec)
            spec.loader.exec_module(sys.modules[spec.name])
        found += [case for case in sys.modules[spec.name].CASES if case[0].split()[0] == name]
    return found


def fails_here(path: Path, name: str, cases: list[tuple[Any, ...]]) -> bool:
    """Return whether a case fails with a constant three times as large in all modules."""
    users: list[Any] = [LIMITS]
    if not name.islower():
        own = ".".join(path.relative_to(SOURCE.parent).with_suffix("").parts)
        value = getattr(importlib.import_module(own), name)
        modules = [module for of, module in sys.modules.items() if of.startswith("truenewton")]
        users = [module for module in modules if vars(module).get(name) is value]
    value = vars(users[0])[name]
    for user in users:
        vars(user)[name] = 3 * value
    try:
        results = [(of(at), of(above)) for _, of, at, _, above, _ in cases]
        return results != [(case[3], case[5]) for case in cases]
    except Exception:
        return True
    finally:
        for user in users:
            vars(user)[name] = value


def passes(source: Path, paths: list[Path], name: str = "") -> bool:
    """Return whether tests whose name contains one pass with the package below ``source``."""
    command = [sys.executable, "-m", "pytest", "-q", "-x", "-p", "no:cacheprovider",
               "-m", "not study", "-k", name, *map(str, paths)]  # fmt: skip
    places = (source, ROOT, ROOT / "tests")
    environment = os.environ | {
        "PYTHONPATH": os.pathsep.join(map(str, places)), "PYTHONDONTWRITEBYTECODE": "1",
        "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1",
    }  # fmt: skip
    run = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, check=False)
    return run.returncode == 0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("words", nargs="*")
    options = parser.parse_args()
    survivors, chosen = [], constants(options.words)
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "truenewton"
        shutil.copytree(SOURCE, copy)
        if not passes(Path(folder), sorted((ROOT / "tests").rglob(FILE))):
            parser.error(f"a {FILE} fails without any change")
        for path, name, value in chosen:
            own = path.relative_to(SOURCE)
            # The thresholds of the verdict are used in both.
            packages = ("calibration", "estimation") if name.islower() else own.parts[:1]
            folders = [ROOT / "tests" / package for package in packages]
            files = [path for one in folders for path in one.rglob(FILE)]
            cases = cases_of(files, name)
            survives = not (cases and fails_here(path, name, cases))
            text = path.read_text(encoding="utf-8")
            lines = text.splitlines(keepends=True)
            start = sum(map(len, lines[: value.lineno - 1])) + value.col_offset
            end = sum(map(len, lines[: value.end_lineno - 1])) + value.end_col_offset
            changed = f"{text[:start]}3 * ({text[start:end]}){text[end:]}"
            (copy / own).write_text(changed, encoding="utf-8")
            if survives and cases:  # a default, or a value made of it at import
                survives = passes(Path(folder), files, name)
            (copy / own).write_text(text, encoding="utf-8")
            survivors += [name] if survives else []
            print(f"{own} {name}: {'SURVIVES' if survives else 'fails a test'}", flush=True)
    print(f"{len(chosen) - len(survivors)} of {len(chosen)} constants are pinned")
    sys.exit(1 if survivors else 0)


if __name__ == "__main__":
    main()
