"""The page's sections of the modal base: stiffness modes, turbulence, dissipation."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from truenewton.figures.style import CURVES
from truenewton.modal.findings import ModalFindings
from truenewton.modal.modal_base import ModalBase
from truenewton.modal.words import (
    apart,
    between_actuators,
    chosen_modes,
    cost_rows,
    measured_text,
    rigid_text,
    static_force,
    stiffness_text,
    turbulence,
)
from truenewton.report.investigate import Findings
from truenewton.report.page import modal_plots
from truenewton.report.page.section import Section, TextTable
from truenewton.rounding import percent

LINES = ("full", "dashed", "dash and dot")  # of the three bases, as drawn


def modal_sections(findings: Findings) -> Iterator[Section]:
    """Yield the modal base, or why there is none; nothing of a calibration file."""
    found = findings.modes
    if found is not None:
        yield _modes(found)
        yield _turbulence(found.after)
        yield _dissipation(found.after)
    elif findings.no_modes:
        yield Section("modes", "Stiffness modes", (findings.no_modes,))


def _modes(found: ModalFindings) -> Section:
    base, before, after = found.after, found.before.stiffness, found.after.stiffness
    values = base.modes.stiffness
    elastic = values[3:]
    softest, stiffest = (elastic[k] for k in (np.abs(elastic).argmin(), np.abs(elastic).argmax()))
    rigid = ", ".join(stiffness_text(value) for value in after.rigid_stiffness)
    words = [
        f"Of {values.size} modes the softest elastic one has {stiffness_text(softest)}, the"
        f" stiffest {stiffness_text(stiffest)}. Rigid motions bend nothing; bias magnets and errors"
        f" leave them {rigid}.",
        f"Modes found with alpha = 1 lie {apart(found.comparison)}.",
    ]
    if found.measured is not None:
        told = filter(None, (measured_text(found.measured), rigid_text(found.measured)))
        words.append(f"Measured stiffness: {'; '.join(told)}.")
    words += [f"Warning: {fault}; {remedy}." for fault, remedy in found.warnings]
    rows = (
        ("asymmetry", percent(before.asymmetry), percent(after.asymmetry)),
        ("out of balance", percent(before.imbalance), percent(after.imbalance)),
    )
    drawn = [f"{k + 1}: {stiffness_text(values[k])}" for k in chosen_modes(values.size)]
    caption = (
        "Maps of modes, seen along -z, softest first: each actuator's displacement in terms of the"
        " mode's largest, one way purple, the other orange. Modes and their stiffness:"
        f" {'; '.join(drawn)}."
    )
    table = TextTable("Faults of the stiffness", ("of", "alpha = 1", "calibrated"), rows)
    return Section(
        "modes", "Stiffness modes", tuple(words), modal_plots.modes(base), caption, tables=(table,)
    )


def _turbulence(base: ModalBase) -> Section:
    count = base.modes.stiffness.size
    half = count // 2
    left = ", ".join(f"{1e9 * cost.residual[half - 1]:.3g} nm {cost.base}" for cost in base.costs)
    caption = (
        "Rms wavefront that the first N modes of three bases leave on the actuators. After"
        f" {half} of {count}: {left}."
    )
    words = (f"For {turbulence(base)}.", f"Between actuators: {between_actuators(base)}.")
    return Section(
        "turbulence", "Turbulence", words, modal_plots.residual(base), caption, _legend(base)
    )


def _dissipation(base: ModalBase) -> Section:
    cost = base.costs[0]
    caption = (
        "Mean power of the worst coil (thick) and of all coils (thin), static force included,"
        " against the number of modes. With all"
        f" {cost.residual.size}: {cost.power[:, -1].max():.2g} W and"
        f" {cost.power[:, -1].mean():.2g} W."
    )
    words = (
        f"Static force of the actuators: {static_force(cost)}.",
        "truenewton modes --power W --force N tells how many modes a limit allows.",
    )
    head = ("N", *(f"{each.base} (nm)" for each in base.costs), "force rms (mN)",
            "worst (mN)", "power mean (W)", "worst (W)", "total (W)")  # fmt: skip
    table = TextTable(
        "Rms wavefront that N modes of each base leave; force and power of N stiffness modes",
        head, tuple(cost_rows(base)),
    )  # fmt: skip
    return Section(
        "dissipation", "Dissipation", words, modal_plots.power(base), caption, _legend(base),
        tables=(table,),
    )  # fmt: skip


def _legend(base: ModalBase) -> tuple[tuple[str, str], ...]:
    return tuple(
        (colour, f"{cost.base}, {line}")
        for cost, colour, line in zip(base.costs, CURVES, LINES, strict=False)
    )
