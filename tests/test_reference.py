"""Results are those that were recorded (tests/reference; `make reference` records them anew)."""

from dataclasses import replace

import pytest

from reference.cases import CASES, Result, finding_line
from reference.recorded import (
    FOLDER,
    as_text,
    compare,
    compute,
    from_text,
    path_of,
    recorded,
    sections,
)
from truenewton.estimation.findings.code import Code
from truenewton.estimation.findings.finding import Finding


@pytest.mark.parametrize(
    "name",
    [pytest.param(n, marks=() if case.fast else pytest.mark.study) for n, case in CASES.items()],
)
def test_a_result_is_as_it_was_recorded(name):
    result = compute(name)
    if result is None:
        pytest.skip("TRUENEWTON_REAL_DATA, the folder of measured matrices, is not set")
    before = from_text(recorded(name))
    assert compare(before, from_text(as_text(result)), CASES[name].tolerance) == []


def test_every_recorded_result_has_a_case():
    paths = {path_of(name) for name in CASES}
    assert set(FOLDER.glob("*")) == paths
    heads = [head for path in paths for head in sections(path) if head]
    assert sorted(heads) == sorted(name for name, case in CASES.items() if case.file)


# Codes that need no case, and why.
WITHOUT_CASE = {
    "other": "read from files of other versions alone",
}


def test_every_code_of_a_finding_occurs_in_a_recorded_result():
    """A mechanism without a recorded result must not be restructured."""
    texts = [path.read_text(encoding="utf-8") for path in FOLDER.glob("*")]
    lines = [line for text in texts for line in text.splitlines() if line.startswith("finding: ")]
    found = {word for line in lines for word in line.partition(" | ")[0].split()}
    assert {str(code) for code in Code} - found == set(WITHOUT_CASE)


def test_a_small_change_is_seen():
    before = from_text(recorded("p45, 1 mN"))
    columns = before.columns | {"ALPHA": before.columns["ALPHA"] * (1 + 1e-6)}
    assert len(compare(before, replace(before, columns=columns))) == 1
    less = replace(before, sentences=before.sentences[:-1])
    assert compare(before, less) == [f"- {before.sentences[-1]}"]
    twice = replace(before, sentences=(*before.sentences, before.sentences[-1]))
    assert compare(before, twice) == [f"+ {before.sentences[-1]}"]
    turned = replace(before, sentences=before.sentences[::-1])
    assert compare(before, turned)[0].startswith("other order")
    verdict = tuple(x.replace("verdict: ", "verdict: not ") for x in before.sentences)
    assert len(compare(before, replace(before, sentences=verdict))) == 2


def test_the_last_digits_of_a_number_may_differ_and_those_of_a_count_may_not():
    def result(**values):
        return Result((finding_line(Finding.of(Code.MISFIT_SENSELESS, **values)),))

    assert compare(result(factor=433.4), result(factor=431.0)) == []
    assert len(compare(result(factor=433.4), result(factor=412.0))) == 2
    assert len(compare(result(factor=433), result(factor=431))) == 2
