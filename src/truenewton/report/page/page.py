"""The page: one file that opens in any browser without network."""

from __future__ import annotations

import os
import platform
from collections.abc import Sequence
from importlib.metadata import version
from typing import Any

from bokeh.core.json_encoder import serialize_json
from bokeh.document import Document
from bokeh.resources import Resources
from jinja2 import Environment, PackageLoader, StrictUndefined
from jinja2.utils import htmlsafe_json_dumps

from truenewton.arrays import Array
from truenewton.calibration.result import Calibration
from truenewton.calibration.summary import headline, summary_rows
from truenewton.figures.writing import inline_svg
from truenewton.files.outputs import file_beside
from truenewton.records.cycle import Source
from truenewton.records.parts import has_parts
from truenewton.report.change import Change
from truenewton.report.figures import findings_figures
from truenewton.report.page.sections import (
    Section,
    TextTable,
    all_figures,
    changed_segments,
    evidence_sections,
    modal_sections,
    segment_sections,
    times,
)
from truenewton.report.page.views import Actuators, calibration_views, change_views, palette
from truenewton.report.verdict import Reported, headline_of, sources_of

# Bokeh's script, which stands in the page; only what figures need.
BOKEH = Resources(mode="inline", components=["bokeh"], minified=True)
LIBRARIES = ("numpy", "scipy", "astropy", "matplotlib", "bokeh")


def write_report(
    path: str | os.PathLike[str],
    findings: Reported,
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
        From `investigate`, `change`, or `calibrate` of a mirror in several segments.
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
    >>> tn.write_report("report.html", tn.change(calibration, warm))
    """
    with file_beside(path, overwrite=overwrite) as temporary:
        text = page(findings, command, edges)
        # A path may hold bytes that are no text.
        temporary.write_text(text, encoding="utf-8", errors="backslashreplace")


def page(findings: Reported, command: str = "", edges: Sequence[Array] = ()) -> str:
    """Return the page as HTML; edges of the glass are (vertices, 2) polygons [m]."""
    sections: tuple[Section, ...] = ()
    drawn: dict[str, str] = {}
    actuators: Actuators | None = None
    if has_parts(findings):
        title, heading = f"{findings.instrument}: calibration of its segments", headline(findings)
        actuators, sections = calibration_views(findings, None, edges), segment_sections(findings)
        tables = [_files(sources_of(findings), "Files")]
    elif isinstance(findings, Change):
        title = f"{findings.one.instrument}: what changed"
        heading = f"{findings.one.instrument}: two calibrations compared"
        actuators = change_views(findings, edges)
        tables = [
            _summaries(findings),
            _files(sources_of(findings.one), "First calibration: files"),
            _files(sources_of(findings.other), "Second calibration: files"),
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
            tables = [all_figures(c)]
        sections = (*evidence_sections(findings), *modal_sections(findings), times(findings))
        figures = findings_figures(findings)
        drawn = {part.key: inline_svg(figures[part.figure](), part.key)
                 for part in sections if part.figure}  # fmt: skip
        tables.append(_files(findings.inputs, "Files"))
    # Text from files passes through autoescape or JSON.
    environment = Environment(
        loader=PackageLoader("truenewton.report.page"), autoescape=True, undefined=StrictUndefined,
        trim_blocks=True, lstrip_blocks=True,
    )  # fmt: skip
    return environment.get_template("page.html.j2").render(
        title=title, heading=heading, verdict=headline_of(findings), actuators=actuators,
        sections=sections, drawn=drawn, tables=tables, command=command, versions=_versions(),
        bokeh="\n".join(BOKEH.js_raw),
        payload=htmlsafe_json_dumps(_payload(actuators), dumps=serialize_json) if actuators else "",
    )  # fmt: skip


def _summaries(change: Change) -> TextTable:
    if change.segments:
        return changed_segments(change)
    pair = [c for c in (change.one, change.other) if isinstance(c, Calibration)]
    one, other = ({name: value for name, value, _ in summary_rows(c)} for c in pair)
    rows = [("measured", *(f"{c.date:%Y-%m-%d %H:%M}" for c in pair)),
            ("method", *(c.method for c in pair))]  # fmt: skip
    rows += [(name, one.get(name, ""), other.get(name, "")) for name in {**one, **other}]
    return TextTable("All figures", ("figure", "first", "second"), tuple(rows), wraps=True)


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
        "group": actuators.group,
        "layers": [
            {name: getattr(layer, name) for name in ("key", "name", "unit", "title", "meaning")}
            | {"low": layer.limits[0], "high": layer.limits[1], "palette": list(palette(layer))}
            for layer in actuators.layers
        ],
    }


def _versions() -> str:
    libraries = ", ".join(f"{name} {version(name)}" for name in LIBRARIES)
    return f"truenewton {version('truenewton')}, Python {platform.python_version()}, {libraries}"
