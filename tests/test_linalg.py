"""Extreme eigenvalues, step by step, against full decompositions."""

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from truenewton.linalg import (
    CLOSE,
    MOST_STEPS,
    largest_eigenvalue,
    one_thread,
    smallest_eigenvalue,
)


def symmetric(values, seed):
    """Return a symmetric matrix with these eigenvalues, and its eigenvectors in columns."""
    random = np.random.default_rng(seed)
    vectors = np.linalg.qr(random.standard_normal((len(values), len(values))))[0]
    return (vectors * values) @ vectors.T, vectors


@pytest.mark.parametrize("n", [1, 2, 5, 45, 200])
def test_both_ends_of_a_spectrum(n):
    values = np.random.default_rng(n).uniform(1.0, 10.0, n)
    values[0] = 0.1
    matrix, vectors = symmetric(values, n)
    smallest, vector = smallest_eigenvalue(lambda x: matrix @ x, n)
    assert smallest == pytest.approx(values.min(), rel=1e-5)
    assert abs(vector @ vectors[:, 0]) == pytest.approx(1.0, abs=1e-5)
    assert largest_eigenvalue(matrix)[0] == pytest.approx(values.max(), rel=CLOSE)


def test_a_solution_nearby_saves_most_steps():
    """As CONDITIO has it: a spectrum over nine decades, and an inverse that is off by a third."""
    matrix, vectors = symmetric(np.logspace(0, 9, 300), 1)
    off = np.random.default_rng(2).uniform(0.7, 1.3, 300)
    inverse = (vectors * (7.0 * off / np.logspace(0, 9, 300))) @ vectors.T
    calls = []

    def times(x):
        calls.append(x)
        return matrix @ x

    assert smallest_eigenvalue(times, 300, lambda x: inverse @ x)[0] == pytest.approx(
        1.0, rel=CLOSE
    )
    assert len(calls) < MOST_STEPS // 2


def test_what_takes_too_many_steps_is_decomposed():
    matrix, _ = symmetric(np.logspace(0, 8, 300), 3)
    calls = []

    def times(x):
        calls.append(x)
        return matrix @ x

    assert smallest_eigenvalue(times, 300)[0] == pytest.approx(1.0, rel=1e-6)
    assert len(calls) == MOST_STEPS + 1


@pytest.mark.parametrize("n", [3, 150])
def test_a_singular_matrix_has_the_eigenvalue_0(n):
    values = np.linspace(0.0, 1.0, n)
    matrix, _ = symmetric(values, 4)
    assert smallest_eigenvalue(lambda x: matrix @ x, n)[0] == pytest.approx(0.0, abs=1e-12)


def test_small_products_keep_to_one_thread_and_others_get_theirs_back():
    def threads():
        return {each["num_threads"] for each in threadpool_info() if each["user_api"] == "blas"}

    with threadpool_limits(2, user_api="blas"):
        with one_thread():
            assert threads() == {1}
        assert threads() == {2}
