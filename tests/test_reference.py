"""Results are those that were recorded (tests/reference; `make reference` records them anew)."""

from dataclasses import replace

import pytest

from reference.cases import CASES
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


def test_a_small_change_is_seen():
    before = from_text(recorded("p45, 1 mN"))
    columns = before.columns | {"ALPHA": before.columns["ALPHA"] * (1 + 1e-6)}
    assert len(compare(before, replace(before, columns=columns))) == 1
    less = replace(before, sentences=before.sentences[:-1])
    assert compare(before, less) == [f"- {before.sentences[-1]}"]
    verdict = tuple(x.replace("verdict: ", "verdict: not ") for x in before.sentences)
    assert len(compare(before, replace(before, sentences=verdict))) == 2
