"""The fault study as a table: each fault with two seeds and two noises, a line a campaign.

It shows at a glance what a change of the estimation does: level, codes, true and stated error.
"""

from __future__ import annotations

import re
import time
import warnings
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

import numpy as np

import truenewton as tn
from studies.faults import ALL, day_with_fault, rms
from studies.faulty.fault import Fault
from truenewton.errors import TrueNewtonError, TrueNewtonWarning

PATH = Path(__file__).parent / "fault_table.txt"
NOISES, SEEDS = (1e-3, 5e-5), (0, 1)  # [N], as in `studies.faults`
CYCLES = 4  # under each load
# Of the errors: another processor changes alpha by less than 1e-4 of its error.
TOLERANCE = 1e-3
HEAD = ("fault", "noise/mN", "seed", "level", "error/%", "stated/%", "codes (+: corrected)")


class Row(NamedTuple):
    """One campaign: rms relative errors in %, and the codes of all findings, worst first."""

    fault: str
    noise: str  # [mN]
    seed: str
    level: str
    error: float
    stated: float
    codes: str

    @property
    def key(self) -> tuple[str, str, str]:
        """What was simulated."""
        return self.fault, self.noise, self.seed


def rows_of(noise: float, seed: int) -> list[Row]:
    """Calibrate the campaigns of all faults with one noise [N] and seed.

    Faults that have a noise of their own come with the last of `NOISES`.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", TrueNewtonWarning)
        return [
            _row(fault, noise, seed) for fault in ALL if fault.noise is None or noise == NOISES[-1]
        ]


def _row(fault: Fault, noise: float, seed: int) -> Row:
    day = day_with_fault(fault, "p45", seed, noise, CYCLES)
    about = fault.name, f"{1e3 * day.noise:g}", str(seed)
    try:
        found = tn.calibrate(day.campaign())
    except TrueNewtonError as error:
        return Row(*about, "no alpha", np.nan, np.nan, type(error).__name__)
    error, stated = (
        100.0 * rms(values[day.judged])
        for values in (found.alpha / day.truth - 1.0, found.error / day.truth)
    )
    codes = dict.fromkeys(f"{each.code}{'+' * each.corrected}" for each in found.findings)
    return Row(*about, str(found.verdict.level), error, stated, " ".join(codes))


def read() -> list[Row]:
    """Return the recorded table."""
    if not PATH.exists():
        return []
    made = []
    for line in PATH.read_text(encoding="utf-8").splitlines()[1:]:
        fault, noise, seed, level, error, stated, *codes = re.split(" {2,}", line)
        made.append(Row(fault, noise, seed, level, float(error), float(stated), "".join(codes)))
    return made


def as_text(rows: Iterable[Row]) -> str:
    """Return the table as it is written: columns are two blanks or more apart."""
    cells = [HEAD] + [
        (*row[:4], f"{row.error:.4g}", f"{row.stated:.4g}", row.codes) for row in rows
    ]
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
    return "".join(
        "  ".join(f"{cell:{width}}" for cell, width in zip(line, widths, strict=True)).rstrip()
        + "\n"
        for line in cells
    )


def compare(old: Iterable[Row], new: Iterable[Row]) -> list[str]:
    """Return what changed, a line a campaign: before and after."""
    before, after = ({row.key: row for row in rows} for rows in (old, new))
    found = [f"- {', '.join(key)}" for key in before if key not in after]
    for key, row in after.items():
        if key not in before:
            found.append(f"+ {', '.join(key)}: {row.level}, {row.error:.4g} %, {row.codes}")
        elif changes := _changes(before[key], row):
            fault, noise, seed = key
            found.append(f"{fault} ({noise} mN, seed {seed}): {'; '.join(changes)}")
    return found


def _changes(old: Row, new: Row) -> list[str]:
    said = [] if old.level == new.level else [f"{old.level} -> {new.level}"]
    for name in ("error", "stated"):
        was, now = getattr(old, name), getattr(new, name)
        if not np.isclose(now, was, rtol=TOLERANCE, atol=0.0, equal_nan=True):
            said.append(f"{name} {was:.4g} -> {now:.4g} %")
    was, now = old.codes.split(), new.codes.split()
    gone, added = ([f"{sign}{code}" for code in some if code not in others]
                   for sign, some, others in (("-", was, now), ("+", now, was)))  # fmt: skip
    if gone or added:
        said.append(" ".join([*gone, *added]))
    elif was != now:
        said.append(f"order of codes: {new.codes}")
    return said


def record() -> None:
    """Record the table anew, and print what differs."""
    began = time.perf_counter()
    every = [row for noise in NOISES for seed in SEEDS for row in rows_of(noise, seed)]
    place = [fault.name for fault in ALL]
    every.sort(key=lambda row: place.index(row.fault))
    before = read()
    changes = compare(before, every) if before else [f"new, {len(every)} rows"]
    print(f"fault table, {time.perf_counter() - began:.0f} s:", *(changes or ["as recorded"]),
          sep="\n    ")  # fmt: skip
    if changes:
        PATH.write_text(as_text(every), encoding="utf-8")
