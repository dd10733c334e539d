"""The structure of the package, and whether the pages that describe it are correct."""

import ast
import importlib
import re
import sys
from dataclasses import fields, is_dataclass
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "docs"))
import constants  # noqa: E402
import house  # noqa: E402
import measures  # noqa: E402

PACKAGES = sorted(path.parent for path in house.SOURCE.rglob("__init__.py"))
# A shape such as (n,), (N, 3), (..., 3), or a unit in brackets.
SHAPE_OR_UNIT = re.compile(r"\((?!paper)[\w .+*/-]+(?:,[\w .+*/-]*)+\)|\[[^\]\n]+\]")


@pytest.mark.parametrize("package", PACKAGES[1:], ids=lambda path: path.name)
def test_the_docstring_of_a_package_lists_its_modules(package):
    text = ast.get_docstring(ast.parse((package / "__init__.py").read_text(encoding="utf-8")))
    listed = set(re.findall(r"^ *(\w+)/? {2,}\S", text, re.MULTILINE))
    present = {path.stem for path in package.glob("*.py")} - {"__init__"}
    present |= {path.parent.name for path in package.glob("*/__init__.py")}
    assert listed >= present
    assert {name for name in listed - present if not name.startswith(("eq", "sec"))} == set()


def test_the_picture_agrees_with_the_import_contract():
    drawn = {package for layer in house.layers() for package in layer}
    packages = {path.name for path in PACKAGES[1:] if path.parent == house.SOURCE}
    assert drawn == packages | {path.stem for path in house.SOURCE.glob("[!_]*.py")}
    assert house.PICTURE.read_text(encoding="utf-8") == house.picture()


def test_every_constant_on_the_page_has_an_explanation():
    rows = [line for line in constants.tables().splitlines() if line.startswith("| [")]
    assert len(rows) > 50
    assert [row for row in rows if row.endswith("|  |")] == []


def test_modules_and_functions_are_within_the_size_limits():
    assert house.module_sizes()[0][0] <= house.MAX_MODULE_LINES
    assert house.function_sizes()[0][0] <= house.MAX_FUNCTION_LINES
    complexities = house.complexities()
    assert len(complexities) > 1000
    assert complexities[0][0] <= house.MAX_COMPLEXITY


SOURCE = '''"""A docstring is no code."""

import os  # and an import neither

MAX_STEPS = 30  # a decision
_LIMIT: float = 0.1  # a decision, but no public name
TITLE = "text"
TABLE = {"a": 0.3}
ENABLED = True


class Fit(NamedTuple):
    """A record."""

    error: float = 1.5


@dataclass(frozen=True)
class Result:
    steps: int


class Plain:
    def method(self, x):
        return 1.27 * x + 0.5 + 7


def _scaled(x):
    """A number 2.5 in a docstring."""
    return x * 1e-3 if x > 2.0 else TITLE
'''


def test_decisions_names_and_records_of_a_source_are_counted(tmp_path):
    # Decisions: two constants, 1.27 and 1e-3. Names: four constants and three classes.
    expected = measures.Counts(code_lines=15, decisions=4, names=7, records=2)
    assert measures.counts(SOURCE) == expected
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "__init__.py").write_text(SOURCE)
    (tmp_path / "cache").mkdir()
    (tmp_path / "root.py").write_text(SOURCE)
    rows = dict(measures.of_packages(tmp_path))
    assert list(rows) == ["a", "b", tmp_path.name, "all"]
    assert rows["all"] == tuple(3 * count for count in expected)
    assert "all                        45      266.7     467    133.3" in measures.table(tmp_path)


def top_level(tree):
    """Return the functions of a module and the methods of its classes."""
    classes = [node for node in tree.body if isinstance(node, ast.ClassDef)]
    inside = [node for part in (tree, *classes) for node in part.body]
    return [node for node in inside if isinstance(node, ast.FunctionDef)]


def test_docstrings_state_shapes_or_units_of_arrays():
    missing = []
    for path in house.modules():
        for function in top_level(ast.parse(path.read_text(encoding="utf-8"))):
            if function.name.startswith("_") or "@overload" in ast.unparse(function):
                continue
            types = ast.unparse(function.args) + ast.unparse(function.returns or ast.Constant(None))
            text = ast.get_docstring(function) or ""
            if re.search(r"Array\b|NDArray|ArrayLike", types) and not SHAPE_OR_UNIT.search(text):
                missing.append(f"{path.relative_to(house.SOURCE)}: {function.name}")
    assert missing == []


def glossary():
    """Return the names of code in the table of docs/glossary.md."""
    text = (ROOT / "docs" / "glossary.md").read_text(encoding="utf-8").split("## Symbols")[1]
    rows = [line for line in text.split("\n## ")[0].splitlines() if line.startswith("|")][2:]
    return [name for row in rows for name in re.findall(r"`([\w.]+)`", row.split("|")[3])]


def exists(name):
    """Return whether a module, a name in it, or an attribute or field of that name exists."""
    parts = name.split(".")
    for k in range(len(parts), -1, -1):
        try:
            value = importlib.import_module(".".join(["truenewton", *parts[:k]]))
        except ModuleNotFoundError:
            continue
        for part in parts[k:]:
            if is_dataclass(value) and part in {field.name for field in fields(value)}:
                return part == parts[-1]
            if not hasattr(value, part):
                return False
            value = getattr(value, part)
        return True
    return False


def test_every_name_in_the_glossary_exists():
    names = glossary()
    assert len(names) > 40
    assert [name for name in names if not exists(name)] == []
    assert not exists("estimation.minimum.Minimum.feigned")


def test_every_name_on_the_page_of_the_api_exists():
    page = (ROOT / "docs" / "api.md").read_text(encoding="utf-8")
    names = re.findall(r"^\.\. auto\w+:: truenewton\.(\S+)$", page, re.MULTILINE)
    assert len(names) > 60
    assert [name for name in names if not exists(name)] == []


@pytest.mark.parametrize(
    ("folder", "command"),
    [("benchmarks", r"`python benchmarks/(\w+)\.py"), ("studies", r"`python -m studies\.(\w+)")],
)
def test_the_evidence_page_lists_every_study_and_benchmark(folder, command):
    page = (ROOT / "docs" / "evidence.md").read_text(encoding="utf-8")
    files = (ROOT / folder).glob("*.py")
    run = {path.stem for path in files if "__main__" in path.read_text(encoding="utf-8")}
    assert set(re.findall(command, page)) == run


POSIX = "fcntl", "grp", "posix", "pty", "pwd", "resource", "syslog", "termios", "tty"


def test_nothing_needs_posix():
    """Windows has none of these."""
    imports = re.compile(rf"^\s*(?:import|from) (?:{'|'.join(POSIX)})\b", re.MULTILINE)
    texts = {path.name: path.read_text(encoding="utf-8") for path in house.modules()}
    assert [name for name, text in texts.items() if imports.search(text)] == []


def test_tests_are_in_the_folder_of_the_package_that_they_test():
    tests = ROOT / "tests"
    folders = {path.parent.relative_to(tests) for path in tests.rglob("test_*.py")}
    assert len(folders) > 20
    packages = {package.relative_to(house.SOURCE) for package in PACKAGES}
    assert folders - packages == {Path("docs")}
