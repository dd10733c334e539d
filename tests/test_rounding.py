"""Numbers as people read them, rounded with their errors (the rule of the Particle Data Group)."""

import json

import numpy as np
import pytest

from truenewton.cli.terminal import print_result
from truenewton.rounding import (
    WIDTH,
    chance_text,
    percent,
    row,
    significant,
    table_lines,
    to_digits,
    with_error,
    wrapped,
)


@pytest.mark.parametrize(
    ("value", "error", "text"),
    [
        # The examples of the Review of Particle Physics, section 5.3.
        (0.827, 0.119, "0.83 ± 0.12"),
        (3.60123, 0.0356, "3.60 ± 0.04"),
        (3.60123, 0.0952, "3.60 ± 0.10"),
        (-2.92, 0.005, "-2.920 ± 0.005"),
        (1234.5, 56.0, "1230 ± 60"),
        (2.5, 0.0, "2.5"),
        (2.5, float("nan"), "2.5"),
        (float("nan"), 1.0, "unknown"),
    ],
)
def test_a_value_goes_as_far_as_its_error(value, error, text):
    assert with_error(value, error) == text


def test_to_digits_leaves_the_error_out():
    assert to_digits(3.60123, 0.0354) == "3.601"
    assert to_digits(2.5, float("nan")) == "2.5"


@pytest.mark.parametrize(
    ("value", "digits", "text"),
    [
        (0.0199, 2, "0.020"),
        (0.0996, 2, "0.10"),
        (1.5e-9, 2, "1.5e-09"),
        (0.0, 2, "0"),
        (float("nan"), 2, "unknown"),
    ],
)
def test_significant_digits_keep_their_zeros(value, digits, text):
    assert significant(value, digits) == text


@pytest.mark.parametrize(
    ("ratio", "text"),
    [(0.0199, "2.0 %"), (0.01734, "1.7 %"), (0.00021, "0.021 %"), (0.5, "50 %"), (1.5, "150 %")],
)
def test_percent_has_two_digits(ratio, text):
    assert percent(ratio) == text


def test_json_has_null_for_what_is_not_finite(capsys):
    values = {"a": np.array([1.0, np.nan]), "b": [float("inf")], "c": "x", "d": np.int64(3)}
    print_result([], values=values, schema="any", json=True)
    plain = {"a": [1.0, None], "b": [None], "c": "x", "d": 3}
    assert json.loads(capsys.readouterr().out) == {"schema": "truenewton.any/2", **plain}


def test_a_table_is_aligned_in_columns():
    lines = table_lines("title", ("name", "x"), ("a", "1.0"), ("long", "10.0"))
    assert list(lines) == ["title", "  name     x", "  a      1.0", "  long  10.0"]


def test_a_long_line_continues_below_its_last_column():
    note = "E_ALPHA, one sigma; largest: actuator 35, 1.7 %, and some more words"
    lines = list(wrapped([row("typical error of alpha", "1.7 %", note), "", "short"]))
    assert [lines[0].index("E_ALPHA"), len(lines[1]) - len(lines[1].lstrip())] == [56, 56]
    assert lines[2:] == ["", "short"]
    assert max(map(len, lines)) <= WIDTH
    assert list(wrapped(["in " + 30 * "long/"])) == [
        "in",
        "  " + 30 * "long/",
    ]  # a path stays whole


def test_chance_is_told_in_words():
    assert chance_text(0.0034) == "chance probability 0.003"
    assert chance_text(0.0) == "chance probability below 1e-12"
