"""Packages as a picture, drawn from the import contract, and the sizes of modules and functions.

python docs/house.py            writes docs/images/house.svg
python docs/house.py --sizes    prints the largest modules and functions; exit code 1 beyond a limit
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

ROOT = Path(__file__).parent.parent
SOURCE = ROOT / "src" / "truenewton"
PICTURE = ROOT / "docs" / "images" / "house.svg"

MOST_LINES, LONGEST_FUNCTION, MOST_COMPLEX = 600, 80, 15

WIDTH, MARGIN, GAP, PADDING = 1000, 16, 10, 10
NAME, TEXT, LINE = 15, 12, 16  # sizes of type, and from line to line [px]
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
    """Return the packages and single modules, layer by layer from the top."""
    (only,) = (c for c in contracts() if c.get("containers") == ["truenewton"])
    return [re.split(r"\s*[|:]\s*", str(layer)) for layer in only["layers"]]  # type: ignore[attr-defined]


def sides() -> dict[str, set[str]]:
    """Return the packages that make data and those that analyse them, from the contract."""
    pairs = [c for c in contracts() if c["type"] == "forbidden"]
    sides = [{str(m).split(".")[1] for m in c["source_modules"]} for c in pairs]  # type: ignore[attr-defined]
    makes = next(side for side in sides if "bench" in side)
    reads = next(side for side in sides if "estimation" in side)
    return {
        "makes data, contains true alpha": makes,
        "analyses data without true alpha": reads,
    }


def side(room: str) -> str:
    """Return the group to which a package belongs by the contract."""
    for name, rooms in sides().items():
        if room in rooms:
            return name
    levels = layers()
    at = next(k for k, level in enumerate(levels) if room in level)
    both = next(k for k, level in enumerate(levels) if "planning" in level)
    return "imports from both groups" if at <= both else "used by both groups"


def first_line(room: str) -> str:
    """Return the first line of the docstring of a package."""
    path = SOURCE / room / "__init__.py"
    path = path if path.exists() else SOURCE / f"{room}.py"
    return (ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or "").split("\n")[0]


def stories(
    levels: list[list[str]], left: float, width: float, top: float, bottom: float = 0.0
) -> tuple[str, float]:
    """Return layers drawn above each other, down to ``bottom`` if given, and the end."""
    texts = {
        room: textwrap.wrap(
            first_line(room), int((width / len(rooms) - 2 * PADDING - GAP) / (0.58 * TEXT))
        )
        for rooms in levels
        for room in rooms
    }
    heights = [2 * PADDING + NAME + LINE * max(len(texts[r]) for r in rooms) for rooms in levels]
    more = (bottom - top - sum(heights) - GAP * len(levels)) / len(levels) if bottom else 0.0
    drawn = []
    for rooms, least in zip(levels, heights, strict=True):
        tall, wide = least + more, (width - GAP * (len(rooms) - 1)) / len(rooms)
        for k, room in enumerate(rooms):
            x, y = left + k * (wide + GAP), top + PADDING + NAME - 3
            name = f"{room}/" if (SOURCE / room).is_dir() else f"{room}.py"
            drawn.append(
                f'<rect x="{x:.0f}" y="{top:.0f}" width="{wide:.0f}" height="{tall:.0f}" rx="4"'
                f' fill="{FILLS[side(room)]}"/>'
                f'<text x="{x + PADDING:.0f}" y="{y:.0f}" font-size="{NAME}" font-weight="bold">'
                f"{name}</text>"
            )
            drawn += [
                f'<text x="{x + PADDING:.0f}" y="{y + LINE * (1 + j):.0f}" font-size="{TEXT}"'
                f' fill="{FAINT}">{html.escape(line)}</text>'
                for j, line in enumerate(texts[room])
            ]
        top += tall + GAP
    return "\n".join(drawn), top


def picture() -> str:
    """Return the packages in layers as SVG: each imports only from those below it."""
    whole = WIDTH - 2 * MARGIN
    half = (whole - 3 * GAP) / 2
    makes, reads = ([[r for r in level if r in rooms] for level in layers()]
                    for rooms in sides().values())  # fmt: skip
    makes, reads = ([level for level in levels if level] for levels in (makes, reads))
    above, floor = (
        [level for level in layers() if side(level[0]) == name]
        for name in ("imports from both groups", "used by both groups")
    )

    roof, walls = stories(above, MARGIN, whole, MARGIN)
    right, floor_top = stories(reads, MARGIN + half + 3 * GAP, half, walls)
    left, _ = stories(makes, MARGIN, half, walls, floor_top)
    base, bottom = stories(floor, MARGIN, whole, floor_top)
    legend = "\n".join(
        f'<rect x="{x:.0f}" y="{bottom + 4:.0f}" width="14" height="14" fill="{fill}"/>'
        f'<text x="{x + 20:.0f}" y="{bottom + 15:.0f}" font-size="{TEXT}">{name}</text>'
        for x, (name, fill) in zip(
            (MARGIN + k * whole / len(FILLS) for k in range(len(FILLS))), FILLS.items(), strict=True
        )
    )
    height = bottom + 18 + MARGIN
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {height:.0f}" role="img"'
        f' font-family="sans-serif" fill="{INK}">\n'
        "<title>Packages of truenewton: each imports only from those below it</title>\n"
        f'<rect width="{WIDTH}" height="{height:.0f}" fill="white"/>\n'
        + "\n".join((roof, left, right, base, legend))
        + "\n</svg>\n"
    )


def modules() -> list[Path]:
    """Return every module of the package."""
    return sorted(SOURCE.rglob("*.py"))


def functions(path: Path) -> list[ast.FunctionDef]:
    """Return every function of a module, methods and inner ones among them."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    return [node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)]


def module_sizes() -> list[tuple[int, str]]:
    """Return lines and name of every module, the largest first."""
    sizes = ((len(p.read_text(encoding="utf-8").splitlines()), p) for p in modules())
    return sorted(((n, str(p.relative_to(SOURCE))) for n, p in sizes), reverse=True)


def function_sizes() -> list[tuple[int, str]]:
    """Return lines and name of every function, the longest first."""
    return sorted(
        ((1 + (f.end_lineno or f.lineno) - f.lineno, f"{p.relative_to(SOURCE)}: {f.name}")
         for p in modules() for f in functions(p)), reverse=True,
    )  # fmt: skip


def complexities() -> list[tuple[int, str]]:
    """Return McCabe's complexity of every function as ruff counts it, the largest first."""
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
    """Print the largest of everything; return whether all is within its limit."""
    lines = module_sizes()
    print(f"{sum(n for n, _ in lines)} lines in {len(lines)} modules")
    sound = True
    for what, sizes, most in (
        ("lines of a module", lines, MOST_LINES),
        ("lines of a function", function_sizes(), LONGEST_FUNCTION),
        ("complexity of a function", complexities(), MOST_COMPLEX),
    ):
        print(f"{what}, at most {most}:")
        for size, name in sizes[:5]:
            print(f"  {size:>4}  {name}")
        sound &= sizes[0][0] <= most
    return sound


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sizes", action="store_true")
    if parser.parse_args().sizes:
        sys.exit(0 if print_sizes() else 1)
    PICTURE.write_text(picture(), encoding="utf-8")
    print(f"written: {PICTURE.relative_to(ROOT)}")
