"""docs/files.md says what the declared formats say, no more and no less."""

import re
from pathlib import Path

import pytest

from truenewton.bench.simulated.truth import TRUTH
from truenewton.calibration.result import CALIBRATION
from truenewton.comparison.result import COMPARISON
from truenewton.estimation.findings.code import rows as threshold_rows
from truenewton.files.format import REQUIRED, FileFormat, ImageFormat
from truenewton.modal.file import MODES, PLAIN
from truenewton.records.file import CYCLE, SEGMENTS, STIFFNESS
from truenewton.tracking.law import TRACKING

DOCS = Path(__file__).parents[2] / "docs" / "files.md"
VERDICT = DOCS.with_name("verdict.md")
KINDS = {
    "str": "text",
    "date": "date",
    "int": "integer",
    "count": "integer",
    "bool": "logical",
    "float": "number",
    "label": "integer or text",
}
FORMATS = {
    "The cycle file": CYCLE,
    "Mirrors in several segments": FileFormat(extensions=(SEGMENTS,)),
    "The stiffness file": STIFFNESS,
    "The calibration file": CALIBRATION,
    "The tracking file": TRACKING,
    "The comparison file": COMPARISON,
    "The modal basis": MODES,
    "The truth of a simulation": TRUTH,
    "The plain matrices": PLAIN["ff_matrix"],
}


def sections():
    """Return the rows of the tables of each section, cells stripped."""
    parts = re.split(r"^#{2,3} (.+)$", DOCS.read_text(), flags=re.M)[1:]
    rows = {}
    for title, text in zip(parts[::2], parts[1::2], strict=True):
        lines = [line for line in text.splitlines() if line.startswith("|")]
        rows[title] = [[c.strip() for c in line.strip("|").split("|")] for line in lines]
    return rows


def documented(title):
    """Return what the section says of keywords and columns: (extension, name, unit or kind)."""
    said = {}
    for row in sections()[title]:
        if row[0] in ("keyword", "extension") or not row[0].strip("-"):
            continue
        extensions, names, unit, text = row if len(row) == 4 else ["", *row]
        for extension in extensions.split(", "):
            if names == "as in the cycle file":
                said |= {k: v for k, v in documented("The cycle file").items() if k[0] == extension}
                continue
            for name in names.split(", "):
                assert (extension, name) not in said
                said[extension, name] = unit, text.startswith("optional")
    return said


def declared(form):
    """Return the same of a declared format."""
    said = {
        ("", keyword.name): (keyword.unit or KINDS[keyword.kind], keyword.absent is not REQUIRED)
        for keyword in form.keywords
    }
    for extension in form.extensions:
        if isinstance(extension, ImageFormat):
            said[extension.name, "image"] = extension.unit or "number", False
            continue
        for column in extension.columns:
            unit = column.unit or KINDS[column.kind]
            said[extension.name, column.name] = unit, column.absent is not REQUIRED
    return said


@pytest.mark.parametrize("title", FORMATS)
def test_every_keyword_column_and_unit_is_declared_and_documented(title):
    said, want = documented(title), declared(FORMATS[title])
    assert {key: unit for key, (unit, _) in said.items()} == {
        key: unit for key, (unit, _) in want.items()
    }
    # Which keywords of our own outputs are absent depends on what is known.
    ours = title not in ("The cycle file", "The stiffness file")
    for (extension, name), (_, optional) in want.items():
        if extension or not ours:
            assert said[extension, name][1] == optional, name


def test_every_section_with_a_table_is_checked():
    assert {title for title, rows in sections().items() if rows} == set(FORMATS)
    assert all(declared(form) == declared(PLAIN["ff_matrix"]) for form in PLAIN.values())


def test_the_page_of_the_verdict_has_all_thresholds():
    page = VERDICT.read_text(encoding="utf-8")
    table = [f"| {' | '.join(row)} |" for row in threshold_rows()]
    assert len(table) > 15
    assert [row for row in table if row not in page] == []
