"""The fault study gives what was recorded of it (`make reference CASES="fault table"`)."""

import pytest

from reference.fault_table import ALL, NOISES, SEEDS, Row, as_text, compare, read, rows_of

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


def test_each_difference_is_one_readable_line():
    old = Row("clean", "1", "0", "usable", 0.2, 0.3, "positions+ misfit")
    assert compare([old], [old._replace(error=0.2 * (1 + 5e-4))]) == []
    new = old._replace(level="doubtful", error=0.4, codes="misfit rows-rejected")
    other = old._replace(fault="dust")
    assert compare([old], [new, other]) == [
        "clean (1 mN, seed 0): usable -> doubtful; error 0.2 -> 0.4 %; -positions+ +rows-rejected",
        "+ dust, 1, 0: usable, 0.2 %, positions+ misfit",
    ]
    assert compare([old, other], [old]) == ["- dust, 1, 0"]
    assert "order of codes" in compare([old], [old._replace(codes="misfit positions+")])[0]


def test_the_table_is_read_as_it_was_written(monkeypatch, tmp_path):
    rows = read()
    path = tmp_path / "table.txt"
    path.write_text(as_text(rows), encoding="utf-8")
    monkeypatch.setattr("reference.fault_table.PATH", path)
    assert compare(rows, read()) == []
    assert {(row.fault, row.seed) for row in rows} == {(f.name, str(s)) for f in ALL for s in SEEDS}
    assert len(rows) == len({row.key for row in rows})
