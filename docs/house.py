"""Packages as a picture, drawn from the import contract, and the sizes of modules and functions.

python docs/house.py            writes docs/images/house.svg
python docs/house.py --sizes    prints the largest modules and functions, and the measures of each
                                package (measures.py); exit code 1 beyond a limit
"""

from __future__ import annotations

import argparse
import ast
import html
import json
import re
import shutil
import subprocess
import sys
import textwrap
import tomllib
from pathlib import Path

import measures

ROOT = Path(__file__).parent.parent
SOURCE = ROOT / "src" / "truenewton"
PICTURE = ROOT / "docs" / "images" / "house.svg"

MAX_MODULE_LINES, MAX_FUNCTION_LINES, MAX_COMPLEXITY = 600, 80, 15

WIDTH, MARGIN, GAP, PADDING = 1000, 16, 10, 10
NAME, TEXT, LINE = 15, 12, 16  # font sizes and line spacing [px]
INK, FAINT = "#1a1a1a", "#5c5c5c"
FILLS = {
    "imports from both groups": "#ece4f2",
    "makes data, contains true alpha": "#fbe3cf",
    "analyses data without true alpha": "#d9e8f5",
    "used by both groups": "#eeeeee",
}


def contracts() -> list[dict[str, object]]:
    """Return the import contracts of pyproject.toml."""
    with (ROOT / "pyproject.toml").open("rb") as file:
        return list(tomllib.load(file)["tool"]["importlinter"]["contracts"])


def layers() -> list[list[str]]:
    """Return the packages and single modules of each layer, from the top."""
    (contract,) = (c for c in contracts() if c.get("containers") == ["truenewton"])
    return [re.split(r"\s*[|:]\s*", str(layer)) for layer in contract["layers"]]  # type: ignore[attr-defined]


def groups() -> dict[str, set[str]]:
    """Return the packages that make data and those that analyse data, from the contract."""
    pairs = [c for c in contracts() if c["type"] == "forbidden"]
    groups = [{str(m).split(".")[1] for m in c["source_modules"]} for c in pairs]  # type: ignore[attr-defined]
    makes = next(group for group in groups if "bench" in group)
    reads = next(group for group in groups if "estimation" in group)
    return {
        "makes data, contains true alpha": makes,
        "analyses data without true alpha": reads,
    }


def group_of(package: str) -> str:
    """Return the group to which a package belongs according to the contract."""
    for name, packages in groups().items():
        if package in packages:
            return name
    levels = layers()
    own = next(k for k, level in enumerate(levels) if package in level)
    common = next(k for k, level in enumerate(levels) if "planning" in level)
    return "imports from both groups" if own <= common else "used by both groups"


def first_line(package: str) -> str:
    """Return the first line of the docstring of a package."""
    path = SOURCE / package / "__init__.py"
    path = path if path.exists() else SOURCE / f"{package}.py"
    return (ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or "").split("\n")[0]


def draw_layers(
    levels: list[list[str]], left: float, width: float, top: float, bottom: float = 0.0
) -> tuple[str, float]:
    """Return SVG of stacked layers, stretched to ``bottom`` if given, and its lower edge [px]."""
    texts = {
        package: textwrap.wrap(
            first_line(package), int((width / len(packages) - 2 * PADDING - GAP) / (0.58 * TEXT))
        )
        for packages in levels
        for package in packages
    }
    heights = [2 * PADDING + NAME + LINE * max(len(texts[p]) for p in level) for level in levels]
    stretch = (bottom - top - sum(heights) - GAP * len(levels)) / len(levels) if bottom else 0.0
    drawn = []
    for packages, minimum in zip(levels, heights, strict=True):
        tall, wide = minimum + stretch, (width - GAP * (len(packages) - 1)) / len(packages)
        for k, package in enumerate(packages):
            x, y = left + k * (wide + GAP), top + PADDING + NAME - 3
            name = f"{package}/" if (SOURCE / package).is_dir() else f"{package}.py"
            drawn.append(
                f'<rect x="{x:.0f}" y="{top:.0f}" width="{wide:.0f}" height="{tall:.0f}" rx="4"'
                f' fill="{FILLS[group_of(package)]}"/>'
                f'<text x="{x + PADDING:.0f}" y="{y:.0f}" font-size="{NAME}" font-weight="bold">'
                f"{name}</text>"
            )
            drawn += [
                f'<text x="{x + PADDING:.0f}" y="{y + LINE * (1 + j):.0f}" font-size="{TEXT}"'
                f' fill="{FAINT}">{html.escape(line.replace("`", ""))}</text>'
                for j, line in enumerate(texts[package])
            ]
        top += tall + GAP
    return "\n".join(drawn), top


def picture() -> str:
    """Return an SVG of the packages in layers. Each imports only from layers below it."""
    inner = WIDTH - 2 * MARGIN
    half = (inner - 3 * GAP) / 2
    makes, reads = ([[r for r in level if r in packages] for level in layers()]
                    for packages in groups().values())  # fmt: skip
    makes, reads = ([level for level in levels if level] for levels in (makes, reads))
    above, below = (
        [level for level in layers() if group_of(level[0]) == name]
        for name in ("imports from both groups", "used by both groups")
    )

    upper, end = draw_layers(above, MARGIN, inner, MARGIN)
    right, end_of_groups = draw_layers(reads, MARGIN + half + 3 * GAP, half, end)
    left, _ = draw_layers(makes, MARGIN, half, end, end_of_groups)
    lower, bottom = draw_layers(below, MARGIN, inner, end_of_groups)
    legend = "\n".join(
        f'<rect x="{x:.0f}" y="{bottom + 4:.0f}" width="14" height="14" fill="{fill}"/>'
        f'<text x="{x + 20:.0f}" y="{bottom + 15:.0f}" font-size="{TEXT}">{name}</text>'
        for x, (name, fill) in zip(
            (MARGIN + k * inner / len(FILLS) for k in range(len(FILLS))), FILLS.items(), strict=True
        )
    )
    height = bottom + 18 + MARGIN
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {height:.0f}" role="img"'
        f' font-family="sans-serif" fill="{INK}">\n'
        "<title>Packages of truenewton: each imports only from those below it</title>\n"
        f'<rect width="{WIDTH}" height="{height:.0f}" fill="white"/>\n'
        + "\n".join((upper, left, right, lower, legend))
        + "\n</svg>\n"
    )


def modules() -> list[Path]:
    """Return every module of the package."""
    return sorted(SOURCE.rglob("*.py"))


def functions(path: Path) -> list[ast.FunctionDef]:
    """Return every function of a module, including methods and nested functions."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    return [node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)]


def module_sizes() -> list[tuple[int, str]]:
    """Return the number of lines and the name of every module, the largest first."""
    sizes = ((len(p.read_text(encoding="utf-8").splitlines()), p) for p in modules())
    return sorted(((n, str(p.relative_to(SOURCE))) for n, p in sizes), reverse=True)


def function_sizes() -> list[tuple[int, str]]:
    """Return the number of lines and the name of every function, the longest first."""
    return sorted(
        ((1 + (f.end_lineno or f.lineno) - f.lineno, f"{p.relative_to(SOURCE)}: {f.name}")
         for p in modules() for f in functions(p)), reverse=True,
    )  # fmt: skip


def complexities() -> list[tuple[int, str]]:
    """Return the McCabe complexity (by ruff) and name of every function, the largest first."""
    ruff = shutil.which("ruff", path=str(Path(sys.executable).parent)) or "ruff"
    limit = "lint.mccabe.max-complexity=0"
    command = [ruff, "check", "--isolated", "--select", "C901", "--config", limit,
               "--output-format", "json", str(SOURCE)]  # fmt: skip
    run = subprocess.run(command, capture_output=True, text=True, check=False)
    found = []
    for line in json.loads(run.stdout):
        name, size = re.findall(r"`(\w+)` is too complex \((\d+)", line["message"])[0]
        found.append((int(size), f"{Path(line['filename']).relative_to(SOURCE)}: {name}"))
    return sorted(found, reverse=True)


def print_sizes() -> bool:
    """Print sizes and measures; return whether all sizes are within their limits."""
    lines = module_sizes()
    print(f"{sum(n for n, _ in lines)} lines in {len(lines)} modules")
    within = True
    for what, sizes, limit in (
        ("lines of a module", lines, MAX_MODULE_LINES),
        ("lines of a function", function_sizes(), MAX_FUNCTION_LINES),
        ("complexity of a function", complexities(), MAX_COMPLEXITY),
    ):
        print(f"{what}, at most {limit}:")
        for size, name in sizes[:5]:
            print(f"  {size:>4}  {name}")
        within &= sizes[0][0] <= limit
    print(measures.table(SOURCE))
    return within


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sizes", action="store_true")
    if parser.parse_args().sizes:
        sys.exit(0 if print_sizes() else 1)
    PICTURE.write_text(picture(), encoding="utf-8")
    print(f"written: {PICTURE.relative_to(ROOT)}")
