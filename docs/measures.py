"""What a reader has to learn, for each package and per 1,000 code lines.

Code lines are lines without docstrings, comments, blank lines and imports.

decisions  constants of modules with a number, and float literals in functions that are not PLAIN
names      public functions, classes and constants of modules
records    dataclasses and named tuples
"""

from __future__ import annotations

import ast
import io
import tokenize
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

PLAIN = {0.0, 0.25, 0.5, 1.0, 2.0, 3.0, 4.0, -1.0, 1e-300}
NO_CODE = {tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT,
           tokenize.ENDMARKER}  # fmt: skip


class Counts(NamedTuple):
    """What one source contains."""

    code_lines: int
    decisions: int
    names: int
    records: int


def has_type(node: ast.AST, *types: type) -> bool:
    """Return whether a node is a literal of one of these types (a bool is no int)."""
    return isinstance(node, ast.Constant) and type(node.value) in types


def code_lines(text: str) -> int:
    """Return the number of lines with code."""
    lines: set[int] = set()
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type not in NO_CODE:
            lines.update(range(token.start[0], token.end[0] + 1))
    for node in ast.walk(ast.parse(text)):
        docstring = isinstance(node, ast.Expr) and has_type(node.value, str)
        if docstring or isinstance(node, ast.Import | ast.ImportFrom):
            lines.difference_update(range(node.lineno, (node.end_lineno or node.lineno) + 1))
    return len(lines)


def assigned(node: ast.stmt) -> tuple[list[str], list[ast.AST]]:
    """Return the names that a statement assigns, and every node of their value."""
    if not isinstance(node, ast.Assign | ast.AnnAssign):
        return [], []
    targets = node.targets if isinstance(node, ast.Assign) else [node.target]
    names = [target.id for target in targets if isinstance(target, ast.Name)]
    return names, list(ast.walk(node.value)) if node.value else []


def is_record(node: ast.ClassDef) -> bool:
    """Return whether a class is a dataclass or a named tuple."""
    decorated = any("dataclass" in ast.dump(decorator) for decorator in node.decorator_list)
    return decorated or "NamedTuple" in {getattr(base, "id", "") for base in node.bases}


def counts(text: str) -> Counts:
    """Return the counts of a source."""
    tree = ast.parse(text)
    decisions, names = 0, []
    for node in tree.body:
        constants, value = assigned(node)
        has_number = any(has_type(part, int, float) for part in value)
        is_table = any(isinstance(part, ast.Dict) for part in value)
        decisions += sum(n.isupper() for n in constants) if has_number and not is_table else 0
        names += constants
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            names.append(node.name)
    nodes = list(ast.walk(tree))
    literals = [part for node in nodes if isinstance(node, ast.FunctionDef)
                for part in ast.walk(node) if has_type(part, float)]  # fmt: skip
    return Counts(
        code_lines(text),
        decisions + sum(part.value not in PLAIN for part in literals),  # type: ignore[attr-defined]
        sum(not name.startswith("_") for name in names),
        sum(isinstance(node, ast.ClassDef) and is_record(node) for node in nodes),
    )


def of_packages(root: Path) -> Iterator[tuple[str, Counts]]:
    """Yield the name and the counts of each package, of the modules beside them, and of all."""
    total = Counts(0, 0, 0, 0)
    for package in [*sorted(path.parent for path in root.glob("*/__init__.py")), root]:
        files = package.glob("*.py") if package == root else package.rglob("*.py")
        found = [counts(path.read_text(encoding="utf-8")) for path in files]
        sums = Counts(*map(sum, zip(*found, strict=True)))
        total = Counts(*map(sum, zip(total, sums, strict=True)))
        yield package.name, sums
    yield "all", total


def table(root: Path) -> str:
    """Return decisions, public names and records per 1,000 code lines of each package."""
    lines = ["per 1,000 code lines:      code  decisions   names  records"]
    for name, (code, *others) in of_packages(root):
        decisions, names, records = (1000 * count / max(code, 1) for count in others)
        lines.append(f"  {name:<22}{code:>7}{decisions:>11.1f}{names:>8.0f}{records:>9.1f}")
    return "\n".join(lines)
