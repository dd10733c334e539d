"""Results are those that were recorded (tests/reference; `make reference` records them anew)."""

from dataclasses import replace

import pytest

from reference import golden
from reference.cases import CASES, FAST, TOLERANCES
from reference.recorded import as_text, compare, compute, from_text, path_of


@pytest.mark.parametrize(
    "name",
    [pytest.param(n, marks=() if n in FAST else pytest.mark.study) for n in CASES],
)
def test_a_result_is_as_it_was_recorded(name):
    result = compute(name)
    if result is None:
        pytest.skip("TRUENEWTON_REAL_DATA, the folder of measured matrices, is not set")
    recorded = from_text(path_of(name).read_text(encoding="utf-8"))
    assert compare(recorded, from_text(as_text(result)), TOLERANCES[name]) == []


def test_every_recorded_file_has_a_case():
    paths = {path_of(name) for name in CASES}
    assert len(paths) == len(CASES)
    assert set(path_of("plan").parent.glob("*")) == paths


def test_a_small_change_is_seen():
    recorded = from_text(path_of("p45, 1 mN").read_text(encoding="utf-8"))
    columns = recorded.columns | {"ALPHA": recorded.columns["ALPHA"] * (1 + 1e-6)}
    assert len(compare(recorded, replace(recorded, columns=columns))) == 1
    less = replace(recorded, sentences=recorded.sentences[:-1])
    assert compare(recorded, less) == [f"- {recorded.sentences[-1]}"]
    verdict = tuple(x.replace("verdict: ", "verdict: not ") for x in recorded.sentences)
    assert len(compare(recorded, replace(recorded, sentences=verdict))) == 2


def test_the_same_commands_write_the_same_bytes():
    first, second = golden.outputs(["prove"]), golden.outputs(["prove"])
    assert len(first) == 4  # three commands and a figure
    assert first == second


def test_another_output_is_seen_on_this_and_another_machine():
    text = "exit code 0\nactuator 1: alpha 0.91\nactuator 2: alpha 0.93\n"
    old = golden.summary("a.txt", text.encode())
    for change, same_machine, elsewhere in (
        ("0.93", 0, 0),
        ("0.93000001", 1, 0),
        ("0.94", 1, 1),
        ("0.93 doubtful", 1, 1),
        ("0.93 0.94", 2, 2),
    ):
        new = golden.summary("a.txt", text.replace("0.93", change).encode())
        assert len(golden.differences(old, new, bytewise=True)) == same_machine
        assert len(golden.differences(old, new, bytewise=False)) == elsewhere
