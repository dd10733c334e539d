"""Every public name is documented, with an example that gives what it says.

Examples on pages are run by `tests/cli/test_commands.py`, tutorials by `make docs`;
the types of all of them are checked by `make types`.
"""

import doctest
import inspect
import re
import shlex
import shutil
import sys
from dataclasses import fields, is_dataclass
from enum import Enum
from pathlib import Path

import pytest

from truenewton.cli.main import main

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "docs"))
import examples  # noqa: E402

API = (ROOT / "docs" / "api.md").read_text(encoding="utf-8").partition("## Reading")[0]
OPTIONS = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE

PUBLIC = examples.public_names()


def block(language):
    (found,) = re.findall(rf"```{language}\n(.*?)```", API, re.DOTALL)
    return found


@pytest.fixture(scope="module")
def prepared(tmp_path_factory):
    """Return the folder in which examples are run, and their names, as docs/api.md says."""
    folder = tmp_path_factory.mktemp("examples")
    names = {}
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        for line in block("sh").splitlines():
            patch.setattr(sys, "argv", shlex.split(line))
            with pytest.raises(SystemExit, match="0"):
                main()
        exec(block("python"), names)
    return folder, names


@pytest.mark.study
@pytest.mark.parametrize("name", PUBLIC)
def test_the_example_of_a_public_name_gives_what_it_says(name, prepared, tmp_path, monkeypatch):
    folder, names = prepared
    shutil.copytree(folder, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    text = inspect.getdoc(PUBLIC[name])
    example = doctest.DocTestParser().get_doctest(text, dict(names), name, None, None)
    assert example.examples, "has no example"
    said = []
    doctest.DocTestRunner(optionflags=OPTIONS).run(example, out=said.append)
    assert not said, "".join(said)


def described(thing):
    """Return the parameters or attributes that a docstring describes."""
    text = inspect.getdoc(thing)
    parts = re.findall(r"^(?:Parameters|Attributes)\n-+\n(.*?)(?=^\w+\n--|\Z)", text, re.M | re.S)
    heads = re.findall(r"^(\w[\w, ]*?)(?: :.*)?$", "\n".join(parts), re.MULTILINE)
    return {name for head in heads for name in head.split(", ")}


@pytest.mark.parametrize("name", PUBLIC)
def test_all_parameters_of_a_public_name_are_described(name):
    thing = PUBLIC[name]
    if inspect.isclass(thing) and issubclass(thing, Enum):
        return  # its parameters are those of any enumeration
    wanted = set(inspect.signature(thing).parameters)
    if is_dataclass(thing):
        wanted = {field.name for field in fields(thing)}
        for base in thing.__bases__:
            wanted -= described(base) if is_dataclass(base) else set()
    assert wanted - described(thing) == set()
