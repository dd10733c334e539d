"""The page's sections of the modal base: stiffness modes, turbulence, dissipation."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from truenewton.calibration.summary import as_sentences
from truenewton.modal.figures import chosen_modes
from truenewton.modal.findings import ModalFindings
from truenewton.modal.modal_base import ModalBase
from truenewton.modal.summary import (
    comparison_text,
    cost_rows,
    fitting_error_text,
    measured_text,
    rigid_text,
    sensor_gains_text,
    static_force_text,
    stiffness_text,
    turbulence_text,
)
from truenewton.report.investigate import Findings
from truenewton.report.page.section import Section, TextTable
from truenewton.rounding import counted, percent


def modal_sections(findings: Findings) -> Iterator[Section]:
    """Yield the modal base, or why there is none; nothing of a calibration file."""
    modes = findings.modes
    if modes is not None:
        yield _modes(modes)
        yield _turbulence(modes.after)
        yield _dissipation(modes.after)
    elif findings.no_modes:
        yield Section("modes", "Stiffness modes", (findings.no_modes,))


def _modes(modes: ModalFindings) -> Section:
    values = modes.after.modes.stiffness
    elastic = values[3:]
    negative = elastic[elastic < 0.0]
    softest, stiffest = elastic[elastic > 0.0].min(initial=np.inf), elastic.max()
    rigid = ", ".join(stiffness_text(value) for value in values[:3])
    words = [
        f"Of {counted(values, 'mode')} the softest elastic one has {stiffness_text(softest)}, the"
        f" stiffest {stiffness_text(stiffest)}. Piston and tilts bend nothing; bias magnets and"
        f" errors leave them {rigid}.",
    ]
    if negative.size:
        words.append(
            f"{counted(negative, 'elastic mode')} with negative stiffness, down to"
            f" {stiffness_text(float(negative.min()))}: no elastic body has any."
        )
    if compared := comparison_text(modes):
        words.append(f"Modes found with alpha = 1 lie {compared}.")
    if modes.measured is not None:
        texts = filter(None, (measured_text(modes.measured), rigid_text(modes.measured)))
        words.append(f"Measured stiffness: {'; '.join(texts)}.")
    if gains := sensor_gains_text(modes.after):
        words.append(f"Gains of the sensors: {gains}.")
    words += [f"Warning: {as_sentences(each)}" for each in modes.warnings]
    rows = (
        ("asymmetry", *map(percent, modes.asymmetry)),
        ("out of balance", *map(percent, modes.imbalance)),
    )
    drawn = [f"{k + 1}: {stiffness_text(values[k])}" for k in chosen_modes(values.size)]
    caption = (
        "Maps of modes, seen along -z, softest first: each actuator's displacement in terms of the"
        " mode's largest, one way purple, the other orange. Modes and their stiffness:"
        f" {'; '.join(drawn)}."
    )
    table = TextTable("Faults of the stiffness", ("of", "alpha = 1", "calibrated"), rows)
    return Section("modes", "Stiffness modes", tuple(words), "modes", caption, (table,))


def _turbulence(base: ModalBase) -> Section:
    count = base.modes.stiffness.size
    half = count // 2
    left = ", ".join(f"{1e9 * cost.residual[half - 1]:.3g} nm {cost.base}" for cost in base.costs)
    caption = (
        "Rms wavefront that the first N modes of three bases leave on the actuators. After"
        f" {half} of {count}: {left}."
    )
    words = (f"For {turbulence_text(base)}.", f"Between actuators: {fitting_error_text(base)}.")
    return Section("turbulence", "Turbulence", words, "modes-residual", caption)


def _dissipation(base: ModalBase) -> Section:
    cost = base.costs[0]
    caption = (
        "Mean power of the worst coil (full) and of all coils (dotted), static force included,"
        " against the number of modes. With all"
        f" {cost.residual.size}: {cost.power[:, -1].max():.2g} W and"
        f" {cost.power[:, -1].mean():.2g} W."
    )
    words = (
        f"Static force of the actuators: {static_force_text(cost)}.",
        "truenewton modes --power W --force N tells how many modes a limit allows.",
    )
    head = ("N", *(f"{each.base} (nm)" for each in base.costs), "force rms (mN)",
            "worst (mN)", "power mean (W)", "worst (W)", "total (W)")  # fmt: skip
    table = TextTable(
        "Rms wavefront that N modes of each base leave; force and power of N stiffness modes",
        head, tuple(cost_rows(base)),
    )  # fmt: skip
    return Section("dissipation", "Dissipation", words, "modes-power", caption, (table,))
