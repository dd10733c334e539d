"""Every example of the docs under mypy --strict, in one run; exit code 1 where one is wrong.

Examples are the blocks of Python in README, CONTRIBUTING and docs, each by itself; the cells of a
tutorial, together; and the examples of public docstrings, each after what docs/api.md runs first.
"""

from __future__ import annotations

import doctest
import inspect
import os
import re
import subprocess
import sys
import tempfile
import types
from collections.abc import Iterator
from pathlib import Path

import truenewton as tn

ROOT = Path(__file__).parent.parent
SOURCE, TUTORIALS = ROOT / "src", ROOT / "docs" / "tutorials"
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("**/*.md"))]
FENCE = re.compile(r"^```(python|\{code-cell\}[^\n]*)\n(.*?)^```", re.MULTILINE | re.DOTALL)
SHELL = "%%bash"


def blocks(page: Path) -> list[tuple[str, int, str]]:
    """Return kind, number of the first line, and code of each block of Python in a page."""
    text = page.read_text(encoding="utf-8")
    found = [
        (m[1], text[: m.start(2)].count("\n"), re.sub(r"^:.*", "", m[2], flags=re.MULTILINE))
        for m in FENCE.finditer(text)  # a line such as ":tags: [hide-input]" is no code
    ]
    return [one for one in found if not one[2].startswith(SHELL)]


def public_names() -> dict[str, object]:
    """Return what is public and no module, by the name that users write."""
    homes = {"": tn, "mirrors.": tn.mirrors}
    names = {
        f"{home}{name}": getattr(of, name) for home, of in homes.items() for name in of.__all__
    }
    names["errors.TrueNewtonError"] = tn.errors.TrueNewtonError
    return {name: one for name, one in names.items() if not isinstance(one, types.ModuleType)}


def programs() -> Iterator[tuple[str, str]]:
    """Yield where each example stands, and it as a program whose lines are numbered as there."""
    for page in PAGES:
        where, cells = str(page.relative_to(ROOT)), ""
        for kind, line, code in blocks(page):
            if kind != "python":
                cells += "\n" * (line - cells.count("\n")) + code
            else:
                yield where, "\n" * line + code
        if cells:
            yield where, cells
    (first,) = [code for _, _, code in blocks(ROOT / "docs" / "api.md")]
    for name, one in public_names().items():
        text = doctest.script_from_examples(inspect.getdoc(one) or "")
        yield f"tn.{name}", f"{first}\n{text}"


def main() -> int:
    """Check all; print what mypy says, of pages and names."""
    places = []
    with tempfile.TemporaryDirectory() as folder:
        for k, (where, code) in enumerate(programs()):
            (Path(folder) / f"example_{k}.py").write_text(code, encoding="utf-8")
            places.append(where)
        done = subprocess.run(
            [sys.executable, "-m", "mypy", "--config-file", "pyproject.toml", folder],
            cwd=ROOT, env={**os.environ, "MYPYPATH": f"{SOURCE}{os.pathsep}{TUTORIALS}"},
            stdout=subprocess.PIPE, text=True, check=False,
        )  # fmt: skip
    print(re.sub(r"\S*example_(\d+)\.py", lambda m: places[int(m[1])], done.stdout), end="")
    return done.returncode


if __name__ == "__main__":
    sys.exit(main())
