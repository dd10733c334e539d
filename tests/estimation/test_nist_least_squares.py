"""Certified answers of NIST, to the digits that double precision gives."""

import numpy as np
import pytest

from helpers.nist import SETS
from truenewton.errors import RankDeficient
from truenewton.linalg import least_squares

# Correct digits of the worst estimate, the worst standard deviation of an estimate, and the
# residual standard deviation (0 for the exact sets, which is held to as many decimals).
DIGITS = {
    "Norris": (12, 13, 13),
    "Pontius": (11, 13, 13),
    "NoInt1": (14, 14, 14),
    "Longley": (10, 12, 12),
    "Wampler1": (9, 9, 9),
    "Wampler2": (12, 14, 14),
    "Wampler3": (9, 13, 14),
    "Wampler4": (7, 13, 14),
    "Wampler5": (5, 13, 14),
    "Filip": (7, 7, 7),
}


def digits(found, certified):
    off = np.abs(found - certified) / np.where(certified == 0, 1.0, np.abs(certified))
    return -np.log10(max(np.max(off), 1e-17))


@pytest.mark.parametrize("name", SETS)
def test_the_answers_of_nist(name):
    matrix, response, estimate, deviation, residual = SETS[name]
    found = least_squares(matrix, response)
    size = np.sqrt(found.chi2 / (len(matrix) - matrix.shape[1]))
    errors = size * np.sqrt(np.sum(found.root**2, axis=1))
    wanted = DIGITS[name]
    assert digits(found.values, estimate) >= wanted[0]
    assert digits(errors, deviation) >= wanted[1]
    assert digits(size, np.array(residual)) >= wanted[2]


def test_all_ten_are_there():
    assert set(DIGITS) == set(SETS)
    assert [len(SETS[name].response) for name in ("Norris", "Longley", "Filip")] == [36, 16, 82]


def test_the_leading_block_is_the_covariance_where_the_others_are_known():
    random = np.random.default_rng(3)
    matrix, right = random.standard_normal((9, 4)), random.standard_normal(9)
    root = least_squares(matrix, right).root
    known = np.linalg.inv(matrix[:, :2].T @ matrix[:, :2])
    assert root[:2, :2] @ root[:2, :2].T == pytest.approx(known, rel=1e-10)
    assert root @ root.T == pytest.approx(np.linalg.inv(matrix.T @ matrix), rel=1e-10)


def test_a_column_that_depends_on_others_is_refused():
    matrix = np.ones((5, 2))
    with pytest.raises(RankDeficient):
        least_squares(matrix, np.arange(5.0))
    with pytest.raises(RankDeficient):
        least_squares(matrix * [1.0, 0.0], np.arange(5.0))
