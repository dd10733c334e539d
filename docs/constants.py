"""The numeric constants of estimation, each with the comment beside or above it in its module.

python docs/constants.py    prints the tables that the site's page of constants shows
"""

from __future__ import annotations

import ast
import importlib
import io
import tokenize
from collections.abc import Iterator
from pathlib import Path

SOURCE = Path(__file__).parent.parent / "src"


def constants(path: Path) -> Iterator[tuple[str, str | None, str]]:
    """Yield name, value and reason of each numeric constant of a module."""
    text = path.read_text(encoding="utf-8")
    module = importlib.import_module(".".join(path.relative_to(SOURCE).with_suffix("").parts))
    tokens = tokenize.generate_tokens(io.StringIO(text).readline)
    comments = {t.start: t.string.lstrip("# ") for t in tokens if t.type == tokenize.COMMENT}
    for node in ast.parse(text).body:
        if not isinstance(node, ast.Assign):
            continue
        first = node.lineno
        while (first - 1, 0) in comments:
            first -= 1
        lines = range(first, (node.end_lineno or first) + 1)
        reason = " ".join(said for (line, _), said in comments.items() if line in lines)
        sides = [side.elts if isinstance(side, ast.Tuple) else [side]
                 for side in (node.targets[0], node.value)]  # fmt: skip
        for target, value in zip(*sides, strict=False):
            name = ast.unparse(target)
            if name.isupper() and isinstance(getattr(module, name, None), int | float):
                yield name, ast.get_source_segment(text, value), reason.replace("|", r"\|")


def tables() -> str:
    """Return a table of constants for each package."""
    found: dict[str, str] = {}
    for path in sorted((SOURCE / "truenewton" / "estimation").rglob("*.py")):
        for name, value, reason in constants(path):
            head = f"\n## {path.parent.name}\n\n| constant | value | reason |\n|---|---|---|\n"
            row = f"| [`{name}`](../{path.relative_to(SOURCE.parent)}) | `{value}` | {reason} |\n"
            found[head] = found.get(head, head) + row
    return "".join(found.values())


if __name__ == "__main__":
    print(tables())
