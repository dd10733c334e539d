"""The fault study gives what was recorded of it (`make reference CASES="fault table"`)."""

import pytest

from reference.fault_table import ALL, NOISES, SEEDS, as_text, compare, read, rows_of

QUICK = NOISES[-1], SEEDS[0]  # the smaller noise shows more; 75 campaigns take 10 s


@pytest.mark.parametrize(
    ("noise", "seed"),
    [
        pytest.param(noise, seed, marks=() if (noise, seed) == QUICK else pytest.mark.study)
        for noise in NOISES
        for seed in SEEDS
    ],
)
def test_levels_codes_and_errors_are_as_recorded(noise, seed):
    rows = rows_of(noise, seed)
    keys = {row.key for row in rows}
    assert compare([row for row in read() if row.key in keys], rows) == []


def test_the_table_is_read_as_it_was_written_and_a_difference_is_seen(monkeypatch, tmp_path):
    rows = read()
    path = tmp_path / "table.txt"
    path.write_text(as_text(rows), encoding="utf-8")
    monkeypatch.setattr("reference.fault_table.PATH", path)
    assert compare(rows, read()) == []
    first, *others = rows
    for change in ({"level": "sound"}, {"error": 1.1 * first.error}, {"codes": "misfit"}):
        assert len(compare(rows, [first._replace(**change), *others])) == 1
    assert compare(rows, others) == [f"- {', '.join(first.key)}"]
    assert {(row.fault, row.seed) for row in rows} == {(f.name, str(s)) for f in ALL for s in SEEDS}
    assert len(rows) == len({row.key for row in rows})
