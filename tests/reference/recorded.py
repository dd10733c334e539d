"""Recording results as text, and comparing new ones with them, in units of the stated error."""

from __future__ import annotations

import re
import warnings
from pathlib import Path

import numpy as np

from reference import small_campaigns, small_matrices  # noqa: F401 (they list their cases)
from reference.cases import CASES, TOLERANCE, Result, result_of
from truenewton.errors import TrueNewtonError, TrueNewtonWarning

FOLDER = Path(__file__).parent / "results"
ROUNDING = 1e-10  # of a value, where its error is no more than rounding
NUMBER = re.compile(r"(?<![\w.])[-+]?\d+\.?\d*(?:e[-+]?\d+)?")
HEAD = re.compile(r"^== (.*)\n", re.MULTILINE)
LAST_DIGITS = 0.02  # by which numbers in sentences, of two digits or more, may differ


def path_of(name: str) -> Path:
    """Return the file of a case."""
    stem = CASES[name].file or name
    return FOLDER / f"{re.sub('[^a-z0-9.]+', '-', stem.lower()).strip('-')}.txt"


def sections(path: Path) -> dict[str, str]:
    """Return the texts in a file by case: below their names, or under '' that of a lone case."""
    if not path.exists():
        return {}
    first, *others = HEAD.split(path.read_text(encoding="utf-8"))
    return dict(zip(others[::2], others[1::2], strict=True)) if others else {"": first}


def recorded(name: str) -> str:
    """Return the recorded text of a case; '' if there is none."""
    return sections(path_of(name)).get(name if CASES[name].file else "", "")


def write(name: str, text: str) -> None:
    """Record the text of a case, beside others in a file that several share."""
    path = path_of(name)
    if CASES[name].file:
        found = sections(path) | {name: text}
        text = "".join(f"== {each}\n{found[each]}" for each, case in CASES.items()
                       if case.file == CASES[name].file and each in found)  # fmt: skip
    path.write_text(text, encoding="utf-8")


def compute(name: str) -> Result | None:
    """Return the result of a case; a refusal is a result too. None if its data are not here."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", TrueNewtonWarning)
        try:
            made = CASES[name].make()
            return None if made is None else result_of(made)
        except TrueNewtonError as error:
            return Result((f"refused: {type(error).__name__}: {error.fault}; {error.remedy}",))


def as_text(result: Result) -> str:
    """Return a result as it is written."""
    lines = [" ".join(sentence.split()) for sentence in result.sentences]
    if result.columns:
        lines.append(" ".join(["#", *result.columns]))
        rows = zip(result.ids, *result.columns.values(), strict=True)
        lines += [f"{i} {value:.13g} " + " ".join(f"{x:.7g}" for x in rest)
                  for i, value, *rest in rows]  # fmt: skip
    return "\n".join(lines) + "\n"


def from_text(text: str) -> Result:
    """Return a result as it was written."""
    sentences, _, table = text.partition("# ")
    if not table:
        return Result(tuple(sentences.splitlines()))
    head, *rows = table.splitlines()
    numbers = np.array([row.split() for row in rows], dtype=float)
    columns = dict(zip(head.split(), numbers[:, 1:].T, strict=True))
    return Result(tuple(sentences.splitlines()), tuple(numbers[:, 0].astype(int)), columns)


def compare(old: Result, new: Result, tolerance: float = TOLERANCE) -> list[str]:
    """Return how a result differs from the recorded one; nothing if it does not."""
    found = [f"- {line}" for line in _missing(old.sentences, new.sentences)]
    found += [f"+ {line}" for line in _missing(new.sentences, old.sentences)]
    if not found and not all(map(_same, old.sentences, new.sentences)):
        found = ["other order of the sentences:", *new.sentences]
    if (old.columns is None) != (new.columns is None) or old.ids != new.ids:
        return [*found, f"other rows: {len(new.ids)} instead of {len(old.ids)}"]
    if old.columns is None:
        return found
    (name, value), (_, error), *_ = old.columns.items()
    for key, was in old.columns.items():
        scale = np.abs(error if key == name else was)
        scale = np.maximum(scale, ROUNDING / tolerance * np.abs(value)) + 1e-300
        off = np.abs(new.columns[key] - was) / scale
        worst = int(off.argmax())
        if not off[worst] <= tolerance:
            of = "E" if key == name else "itself"
            found.append(f"{key} differs by at most {off[worst]:.2g} of {of} (row"
                         f" {old.ids[worst]}), rms {np.sqrt(np.mean(off**2)):.2g}")  # fmt: skip
    return found


def _missing(some: tuple[str, ...], others: tuple[str, ...]) -> list[str]:
    """Return the sentences of some that others lack, but for the last digit of numbers."""
    left, missing = list(others), []
    for one in some:
        alike = next((k for k, other in enumerate(left) if _same(one, other)), None)
        if alike is None:
            missing.append(one)
        else:
            del left[alike]
    return missing


def _same(one: str, other: str) -> bool:
    if one == other:
        return True
    if NUMBER.sub("0", one) != NUMBER.sub("0", other):
        return False
    pairs = zip(NUMBER.findall(one), NUMBER.findall(other), strict=True)
    return all(a == b or _rounded_alike(a, b) for a, b in pairs)


def _rounded_alike(a: str, b: str) -> bool:
    if not ("." in a or "e" in a) or not ("." in b or "e" in b):
        return False  # a count, or an actuator
    size = max(abs(float(a)), abs(float(b)))
    return size < ROUNDING or abs(float(a) - float(b)) <= LAST_DIGITS * size
