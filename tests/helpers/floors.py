"""Prints the floors of pyproject.toml as pip's constraints: `make test-floors` installs them."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path


def floors(pyproject: Path) -> list[str]:
    """Return name==version of each requirement, of all extras too, in alphabetical order."""
    project = tomllib.loads(pyproject.read_text(encoding="utf-8"))["project"]
    extras = project["optional-dependencies"].values()
    asked = {*project["dependencies"], *(each for extra in extras for each in extra)}
    named = [each for each in asked if not each.startswith(f"{project['name']}[")]
    return sorted(re.sub(r"^([\w.-]+)>=([\d.]+)(,<[\d.]+)?$", r"\1==\2", each) for each in named)


if __name__ == "__main__":
    print("\n".join(floors(Path(__file__).parents[2] / "pyproject.toml")))
