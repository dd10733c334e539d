"""The page and its sections: one file that opens in any browser without network.

Every figure is also described in words.
"""

from __future__ import annotations

import os
import platform
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from bokeh.core.json_encoder import serialize_json
from bokeh.document import Document
from bokeh.resources import Resources
from jinja2 import Environment, PackageLoader, StrictUndefined
from jinja2.utils import htmlsafe_json_dumps

from truenewton.arrays import Array
from truenewton.calibration.result import Calibration
from truenewton.calibration.summary import (
    LABELS,
    NOISE_PART,
    headline,
    rejected_values,
    summary_rows,
)
from truenewton.comparison.calibrations import Change
from truenewton.comparison.result import Comparison
from truenewton.comparison.summary import UNDETECTABLE, changed_actuators, figures
from truenewton.estimation.findings.estimate import Scale, scale_budget, typical
from truenewton.estimation.findings.finding import as_sentences
from truenewton.figures.layers import Layer
from truenewton.figures.writing import inline_svg
from truenewton.files.outputs import file_beside
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
from truenewton.records.campaign import Campaign
from truenewton.records.cycle import Source
from truenewton.report.figures import columns_of_shapes, findings_figures
from truenewton.report.findings import (
    Evidence,
    Findings,
    ModeResiduals,
    RowResiduals,
    investigate,
)
from truenewton.report.page.views import (
    Actuators,
    calibration_views,
    change_views,
    palette,
    shown_outliers,
)
from truenewton.report.verdict import Reported, headline_of
from truenewton.rounding import counted, percent, significant

# Bokeh's script, part of the page: only what the figures need.
BOKEH = Resources(mode="inline", components=["bokeh"], minified=True)
LIBRARIES = ("numpy", "scipy", "astropy", "matplotlib", "bokeh")


def write_report(
    path: str | os.PathLike[str],
    findings: Reported | Calibration,
    *,
    command: str = "",
    edges: Sequence[Array] = (),
    overwrite: bool = False,
) -> None:
    """Write findings, or a comparison, as one page that opens without network.

    Parameters
    ----------
    path
        The page, HTML.
    findings
        From `investigate`, `compare` or `calibrate`.
    command
        The command that makes the page again, if there is one.
    edges
        Edges of the glass to draw on the map, (vertices, 2) polygons [m].
    overwrite
        Replace an existing page.

    Raises
    ------
    OutputExists, OutputFailed

    Examples
    --------
    >>> tn.write_report("report.html", tn.compare(calibration, warm))
    """
    if not isinstance(path, str | os.PathLike):
        raise TypeError("write_report takes the name of the page first, then what it shows")
    shown = investigate(findings) if isinstance(findings, Calibration) else findings
    with file_beside(path, overwrite=overwrite) as temporary:
        text = page(shown, command, edges)
        # A path may hold bytes that are no text.
        temporary.write_text(text, encoding="utf-8", errors="backslashreplace")


def page(findings: Reported, command: str = "", edges: Sequence[Array] = ()) -> str:
    """Return the page as HTML; edges of the glass are (vertices, 2) polygons [m]."""
    sections: tuple[Section, ...] = ()
    look: Section | None = None
    drawn: dict[str, str] = {}
    actuators: Actuators | None = None
    if isinstance(findings, Comparison):
        title, heading = f"{findings.instrument}: what changed", findings.summary().split("\n")[0]
        actuators, tables = change_views(findings, edges), []
        sections = (changes_section(findings),)
    elif isinstance(findings, Change):
        title = f"{findings.one.instrument}: what changed"
        heading = f"{findings.one.instrument}: two calibrations compared"
        actuators = change_views(findings, edges)
        tables = [
            _summaries(findings),
            _files(findings.one.sources, "First calibration: files"),
            _files(findings.other.sources, "Second calibration: files"),
        ]
    else:
        c, instrument = findings.calibration, findings.data.instrument
        title, heading = (
            f"{instrument}: calibration of its actuators",
            f"{instrument}: no calibration",
        )
        tables = []
        if c is not None:
            heading, actuators = headline(c), calibration_views(c, findings.evidence, edges)
            look = what_to_look_at(c, actuators.layers, worst_residuals(findings))
            tables = [all_figures(c)]
        sections = (*evidence_sections(findings), *modal_sections(findings), times(findings))
        figures = findings_figures(findings)
        drawn = {part.key: inline_svg(figures[part.figure](), part.key)
                 for part in sections if part.figure}  # fmt: skip
        tables.append(_files(findings.inputs, "Files"))
    tables += [table for part in sections for table in part.tables if table.wide]
    # Text from files passes through autoescape or JSON.
    environment = Environment(
        loader=PackageLoader("truenewton.report.page"), autoescape=True, undefined=StrictUndefined,
        trim_blocks=True, lstrip_blocks=True,
    )  # fmt: skip
    return environment.get_template("page.html.j2").render(
        title=title, heading=heading, verdict=headline_of(findings), actuators=actuators,
        look=look, labels=LABELS, sections=[part for part in sections if part.shows], drawn=drawn,
        notes=[words for part in sections if not part.shows for words in part.words],
        tables=tables, command=command, versions=_versions(),
        bokeh="\n".join(BOKEH.js_raw),
        payload=htmlsafe_json_dumps(_payload(actuators), dumps=serialize_json) if actuators else "",
    )  # fmt: skip


def changes_section(c: Comparison) -> Section:
    """Return what changed, and the couplings that changed by themselves."""
    couplings = tuple((str(i), str(j), percent(size)) for i, j, size in c.couplings)
    return Section(
        "changes",
        "Changes",
        tuple(f"Undetectable here: {text}." for text in UNDETECTABLE),
        tables=(
            TextTable(
                "Actuators that changed",
                ("actuator", "alpha, new / old", "sensor gain, new / old"),
                tuple(changed_actuators(c)),
            ),
            TextTable(
                "Couplings that changed by themselves",
                ("actuator", "sensor", "change relative to the diagonal"),
                couplings,
            ),
            TextTable("All numbers", ("quantity", "value", "note"), tuple(figures(c)), wraps=True),
        ),
    )


def _summaries(change: Change) -> TextTable:
    pair = change.one, change.other
    one, other = ({name: value for name, value, _ in summary_rows(c)} for c in pair)
    rows = [("measured", *(f"{c.date:%Y-%m-%d %H:%M}" for c in pair)),
            ("method", *(c.method for c in pair))]  # fmt: skip
    rows += [(name, one.get(name, ""), other.get(name, "")) for name in {**one, **other}]
    return TextTable("All numbers", ("quantity", "first", "second"), tuple(rows), wraps=True)


def _files(sources: tuple[Source, ...], caption: str) -> TextTable:
    rows = tuple(
        (s.file, str(s.rows) if s.rows else "none", str(s.rejected), s.sha256) for s in sources
    )
    return TextTable(caption, ("file", "rows used", "rejected", "SHA256"), rows)


def _payload(actuators: Actuators) -> dict[str, Any]:
    """Return the data of the script: Bokeh's document, the places of its figures, the layers."""
    document = Document()
    for view in actuators.views:
        document.add_root(view.plot)
    hosts = {view.plot.id: f"plot-{view.key}" for view in actuators.views}
    return {
        "documents": {"report": document.to_json(deferred=False)},
        "places": [{"docid": "report", "roots": hosts, "root_ids": list(hosts)}],
        "layers": [
            {name: getattr(layer, name) for name in ("key", "name", "unit", "title")}
            | {
                "low": layer.limits[0],
                "high": layer.limits[1],
                "palette": list(palette(layer)),
                "meaning": f"{layer.meaning} {layer.colour_note(*layer.limits)}",
            }
            | shown_outliers(layer, actuators.layout)
            for layer in actuators.layers
        ],
    }


def _versions() -> str:
    libraries = ", ".join(f"{name} {version(name)}" for name in LIBRARIES)
    return f"truenewton {version('truenewton')}, Python {platform.python_version()}, {libraries}"


@dataclass(frozen=True)
class TextTable:
    """A table of text, omitted without rows; its first column is a name, long cells may wrap."""

    caption: str
    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    wraps: bool = False

    @property
    def wide(self) -> bool:
        """Whether it needs the full width of the page: it is then at its end."""
        return len(self.head) > 5


@dataclass(frozen=True)
class Section:
    """A section: paragraphs, then a figure of `Findings.plot`, then tables.

    The figure has a short caption, and numbers that only screen readers need.
    """

    key: str
    title: str
    words: tuple[str, ...] = ()
    figure: str = ""
    caption: str = ""
    more: str = ""
    tables: tuple[TextTable, ...] = ()

    @property
    def shows(self) -> bool:
        """Whether it has a figure or a table; otherwise it is a note."""
        return bool(self.figure) or not all(table.wide for table in self.tables)


NO_DATA = (
    "Residuals, singular values and balance: this page was made from a calibration file, which does"
    " not contain them. To show them, give the cycles, and the calibration with --calibration."
)
WORST = 3  # rows and actuators, listed
LOOKED_AT = ("alpha", "noise", "sensor_gain", "sensor_dx", "sensor_dy", "halves", "findings")
MAX_REJECTED_ROWS = 50  # in the table


def worst_residuals(findings: Findings) -> Iterator[tuple[str, str, str]]:
    """Yield what is farthest from balance: rows or modes, and actuators."""
    if findings.evidence is None or findings.calibration is None:
        return
    residuals, ids = findings.evidence.residuals, findings.calibration.layout.shown
    if isinstance(residuals, ModeResiduals):
        worst = np.argsort(-residuals.after)[:WORST]
        yield ("modes with the largest imbalance",
               ", ".join(f"{stiffness_text(residuals.stiffness[k])} ({percent(residuals.after[k])})"
                         for k in worst), "Largest of all modes, per unit of force.")  # fmt: skip
    else:
        shape = columns_of_shapes(residuals)[0]
        worst = np.argsort(-np.where(residuals.kept, residuals.after, 0.0))[:WORST]
        yield ("rows with the largest imbalance",
               ", ".join(f"shape {shape[k]} of cycle {residuals.cycle[k] + 1}"
                         f" ({residuals.after[k]:.1f})" for k in worst),
               f"Largest of {residuals.kept.sum()} rows, in units of their noise.")  # fmt: skip
    size = np.nan_to_num(findings.evidence.actuator_residual)
    worst = np.argsort(-size)[:WORST]
    yield ("largest residuals", ", ".join(f"{ids[k]} ({size[k]:.2f})" for k in worst),
           "Rms correction of the readings that would restore the balance, divided by the"
           " correction that noise alone would cause.")  # fmt: skip


def what_to_look_at(
    c: Calibration, layers: Sequence[Layer], worst: Iterable[tuple[str, str, str]]
) -> Section | None:
    """Return the worst residuals, and actuators that are disabled, in findings, or outliers."""
    ids, rows = c.layout.shown, list(worst)
    if not c.layout.enabled.all():
        disabled = ", ".join(map(str, ids[~c.layout.enabled]))
        rows.append(("disabled actuators", disabled, "They have no alpha."))
    for layer in layers:
        which = np.flatnonzero(layer.values > 0) if layer.key == "findings" else layer.outliers
        if layer.key in LOOKED_AT and which.size:
            values = ", ".join(f"{ids[k]} ({layer.texts[k]})" for k in which)
            rows.append((layer.name if layer.key == "findings" else f"outliers: {layer.name}",
                         values, layer.meaning))  # fmt: skip
    table = TextTable("Worst residuals, and actuators that differ from the others",
                      ("what", "where (value)", "meaning"), tuple(rows), wraps=True)  # fmt: skip
    return Section("look", "What to look at", tables=(table,)) if rows else None


def evidence_sections(findings: Findings) -> Iterator[Section]:
    """Yield the evidence for alpha, in the order of the page."""
    c, evidence = findings.calibration, findings.evidence
    if c is None:
        return
    yield _budget(c)
    if evidence is None:
        yield Section("residuals", "Residuals, singular values and balance", (NO_DATA,))
        return
    if isinstance(evidence.residuals, ModeResiduals):
        yield _modes(evidence.residuals)
    elif isinstance(findings.data, Campaign):
        yield _rows(findings.data, c, evidence.residuals)
    if evidence.singular_values.size:  # of a matrix the calibration file does not contain them
        yield _singular_values(evidence)
    yield _balance(evidence)


def _budget(c: Calibration) -> Section:
    """Return the error budget of a typical actuator, and of the common scale by source."""
    if c.scale == Scale.MEAN_ONE:
        words = (
            "Error budget: the common scale is a convention (mean alpha 1). The typical error, from"
            f" the readings, is {percent(typical(c.error, c.alpha))}."
        )
        return Section("budget", "Error budget", (words,))
    unseen = tuple((f"if {error.name}", percent(error.relative)) for error in c.unseen)
    rows = ((what, percent(part)) for what, part in scale_budget(c.scale_errors).items())
    tables = (
        TextTable("Undetectable here, not in E_ALPHA", ("assumption", "error"), unseen, wraps=True),
        TextTable(
            f"Uncertainty of the common scale ({NOISE_PART})",
            ("source", "relative error"),
            tuple(rows),
        ),
    )
    caption = "Error of a typical actuator, one sigma."
    return Section("budget", "Error budget", (), "budget", caption, tables=tables)


def _rows(campaign: Campaign, c: Calibration, residuals: RowResiduals) -> Section:
    after = residuals.after[residuals.kept]
    caption = (
        f"Imbalance of each of the {counted(after, 'row')} in units of its noise."
        f" Rms: {_rms(after):.2f} (noise alone: 1)."
    )
    more = f"By shape and cycle, {counted(campaign.cycles, 'cycle')}."
    listed = rejected_values(campaign, c.rejected_rows)
    rows = tuple(
        (Path(str(row["file"])).name, str(row["row"]), f"{row['sigmas']:.1f}",
         str(row["against"]), str(row["actuator"]))
        for row in listed[:MAX_REJECTED_ROWS]
    )  # fmt: skip
    part = f"; the farthest {MAX_REJECTED_ROWS}" if len(listed) > MAX_REJECTED_ROWS else ""
    head = ("file", "row", "sigma", "against", "largest contribution by actuator")
    table = TextTable(f"Rejected rows: {len(listed)}{part}", head, rows)
    return Section("residuals", "Residuals by shape and cycle", (), "residuals", caption, more,
                   (table,))  # fmt: skip


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _modes(residuals: ModeResiduals) -> Section:
    before, after = percent(_rms(residuals.before)), percent(_rms(residuals.after))
    caption = (
        f"Imbalance of {residuals.after.size} elastic modes: {before} rms with alpha = 1, {after}"
        " calibrated."
    )
    return Section("residuals", "Residuals by mode", (), "residuals", caption)


def _singular_values(evidence: Evidence) -> Section:
    values = evidence.singular_values
    ratio = float(values[1] / max(values[0], 1e-16 * values[-1]))
    caption = (
        "Singular values of the balance, in ascending order. The first belongs to alpha. The second"
        f" is {significant(ratio)} times the first. If both were equal, alpha would not be unique."
    )
    more = "Patterns with a singular value close to the smallest are poorly determined."
    return Section("singular-values", "Singular values", (), "singular-values", caption, more)


def _balance(evidence: Evidence) -> Section:
    title = "The balance before and after"
    noise = any(np.isfinite(line.noise) for line in evidence.balance)
    head = ("quantity", "alpha = 1", "calibrated", "noise alone")[: 4 if noise else 3]
    rows = tuple(
        (line.what, *(f"{significant(value)} {line.unit}".rstrip() for value in
                      (line.before, line.after, line.noise)[: len(head) - 1]))
        for line in evidence.balance
    )  # fmt: skip
    table = TextTable("Rms imbalance" if noise else "Rms imbalance per unit of force", head, rows)
    if isinstance(evidence.residuals, ModeResiduals):
        words = (
            "Held-out modes show how well alpha applies to forces that were not used in the fit."
        )
        return Section("balance", title, (words,), tables=(table,))
    caption = "Rms imbalance of each signed shape, with alpha = 1 and with the calibrated alpha."
    return Section("balance", title, (), "balance", caption, tables=(table,))


def times(findings: Findings) -> Section:
    """Return the times and temperatures of the data."""
    title, c, data = "Temperatures and times", findings.calibration, findings.data
    if not isinstance(data, Campaign):
        words = f"Measured on {data.date:%Y-%m-%d %H:%M} UTC"
        if c is not None and c.date_end != c.date:
            words += f" to {c.date_end:%Y-%m-%d %H:%M} UTC"
        if c is not None and np.isfinite(c.temperature):
            words += f", mean temperature {c.temperature:.1f} °C"
        return Section("times", title, (f"{words}.",))
    rejected = Counter(row.cycle for row in c.rejected_rows) if c is not None else Counter()
    rows = []
    for k, cycle in enumerate(data.cycles):
        time = cycle.time[cycle.valid]
        span = "unknown"
        if cycle.temperature is not None:
            some = cycle.temperature[cycle.valid]
            span = f"{some.min():.2f} to {some.max():.2f}"
        rows.append(
            (str(k + 1), cycle.load.name, str(cycle.number), Path(cycle.name).name,
             f"{cycle.date:%Y-%m-%d %H:%M:%S}{f' ({cycle.times})' * bool(cycle.times)}",
             f"{np.ptp(time) / 60:.1f}", str(time.size),
             str(rejected[k]), span)
        )  # fmt: skip
    head = ("cycle", "load", "number within the load", "file", "start (UTC)", "minutes", "rows",
            "rejected", "temperature (°C)")  # fmt: skip
    caption = f"{counted(rows, 'cycle')}; see the table Cycles under Inputs and numbers."
    tables = (TextTable("Cycles", head, tuple(rows)),)
    return Section("times", title, (), "temperatures", caption, tables=tables)


def all_figures(c: Calibration) -> TextTable:
    """Return name, value and note of all figures of a calibration."""
    rows = tuple(summary_rows(c))
    return TextTable("All numbers", ("quantity", "value", "note"), rows, wraps=True)


def modal_sections(findings: Findings) -> Iterator[Section]:
    """Yield the modal basis, or why there is none; nothing of a calibration file."""
    modes = findings.modes
    if modes is not None:
        yield _stiffness_modes(modes)
        if modes.after.costs:
            yield _turbulence(modes.after)
            yield _dissipation(modes.after)
    elif findings.no_modes:
        yield Section("modes", "Stiffness modes", (findings.no_modes,))


def _stiffness_modes(modes: ModalFindings) -> Section:
    values = modes.after.modes.stiffness
    elastic = values[3:]
    softest = elastic[elastic > 0.0].min(initial=np.inf)
    rigid = ", ".join(map(stiffness_text, values[:3]))
    negative = counted(elastic[elastic < 0.0], "elastic mode")
    words = [
        f"{counted(values, 'mode')}. Elastic modes: {stiffness_text(softest)} to"
        f" {stiffness_text(elastic.max())}; {negative} with negative stiffness (expected: 0)."
        f" Rigid-body modes: {rigid} (expected for a free body without bias magnets: 0)."
    ]
    if compared := comparison_text(modes):
        words.append(f"Modes with alpha = 1: {compared}.")
    if modes.measured is not None:
        texts = filter(None, (measured_text(modes.measured), rigid_text(modes.measured)))
        words.append(f"Measured stiffness: {'; '.join(texts)}.")
    if gains := sensor_gains_text(modes.after):
        words.append(f"Sensor gains: {gains}.")
    words += [f"Warning: {as_sentences(each)}" for each in modes.warnings]
    rows = (
        ("asymmetry", *map(percent, modes.asymmetry)),
        ("net forces and torques of the columns", *map(percent, modes.imbalance)),
    )
    table = TextTable(
        "Errors of the stiffness matrix", ("quantity", "alpha = 1", "calibrated"), rows
    )
    drawn = [f"{k + 1}: {stiffness_text(values[k])}" for k in chosen_modes(values.size)]
    caption = "Displacement of each actuator relative to the largest of the mode."
    more = f"Maps of modes, softest first. Modes and their stiffness: {'; '.join(drawn)}."
    return Section("modes", "Stiffness modes", tuple(words), "modes", caption, more, (table,))


def _turbulence(base: ModalBase) -> Section:
    caption = "Rms wavefront at the actuators that remains after the first N modes of each basis."
    words = (f"For {turbulence_text(base)}.", f"Fitting error: {fitting_error_text(base)}.")
    return Section("turbulence", "Turbulence", words, "modes-residual", caption)


def _dissipation(base: ModalBase) -> Section:
    rows = cost_rows(base)
    caption = "Power of N modes of each basis, static force included."
    words = (
        f"Static forces of the actuators: {static_force_text(base)}.",
        "truenewton modes --power W --force N prints the number of modes within a limit.",
    )
    head = ("N", *(f"{each.base} (nm)" for each in base.costs), "force rms (mN)",
            "worst (mN)", "power mean (W)", "worst (W)", "total (W)")  # fmt: skip
    table = TextTable(
        "Residual wavefront after N modes of each basis; force and power of N stiffness modes",
        head[: len(rows[0])], tuple(rows),
    )  # fmt: skip
    figure = "modes-power" if np.isfinite(base.costs[0].efficiency) else ""
    return Section("dissipation", "Dissipation", words, figure, caption, tables=(table,))
