"""Matrices in place against copies, eigenvalues against LAPACK, least squares against NIST."""

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from helpers.nist import SETS
from truenewton import linalg
from truenewton.errors import RankDeficient
from truenewton.linalg import (
    CLOSE,
    MOST_STEPS,
    inverse_of_positive,
    largest_eigenvalue,
    least_squares,
    mirrored,
    smallest_eigenvalue,
    threads,
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
    smallest, vector = smallest_eigenvalue(matrix)
    assert smallest == pytest.approx(values.min(), rel=1e-5)
    assert abs(vector @ vectors[:, 0]) == pytest.approx(1.0, abs=1e-5)
    assert largest_eigenvalue(matrix)[0] == pytest.approx(values.max(), rel=CLOSE)


class Counted(np.ndarray):
    """A matrix that counts its products."""

    def __matmul__(self, other):
        self.products = getattr(self, "products", 0) + 1
        return np.asarray(self) @ other


def test_a_solution_nearby_saves_most_steps():
    """As CONDITIO has it: a spectrum over nine decades, and an inverse that is off by a third."""
    matrix, vectors = symmetric(np.logspace(0, 9, 300), 1)
    off = np.random.default_rng(2).uniform(0.7, 1.3, 300)
    inverse = (vectors * (7.0 * off / np.logspace(0, 9, 300))) @ vectors.T
    matrix = matrix.view(Counted)
    assert smallest_eigenvalue(matrix, inverse)[0] == pytest.approx(1.0, rel=CLOSE)
    assert matrix.products < MOST_STEPS // 2


def test_what_takes_too_many_steps_is_decomposed():
    matrix = symmetric(np.logspace(0, 8, 300), 3)[0].view(Counted)
    assert smallest_eigenvalue(matrix)[0] == pytest.approx(1.0, rel=1e-6)
    assert matrix.products == MOST_STEPS + 1


@pytest.mark.parametrize("n", [3, 150])
def test_a_singular_matrix_has_the_eigenvalue_0(n):
    values = np.linspace(0.0, 1.0, n)
    matrix, _ = symmetric(values, 4)
    assert smallest_eigenvalue(matrix)[0] == pytest.approx(0.0, abs=1e-12)


def test_small_products_keep_to_one_thread_and_others_get_theirs_back():
    def counts():
        return {each["num_threads"] for each in threadpool_info() if each["user_api"] == "blas"}

    with threadpool_limits(2, user_api="blas"):
        with threads(1):
            assert counts() == {1}
        assert counts() == {2}


@pytest.mark.parametrize("n", [1, 5, 128, 300])
def test_a_triangle_is_mirrored(n):
    upper = np.triu(np.random.default_rng(n).standard_normal((n, n)))
    assert (mirrored(upper.copy()) == upper + np.triu(upper, 1).T).all()


def digits(found, certified):
    off = np.abs(found - certified) / np.where(certified == 0, 1.0, np.abs(certified))
    return -np.log10(max(np.max(off), 1e-17))


@pytest.mark.parametrize("name", SETS)
def test_least_squares_reach_the_certified_answers_of_nist(name):
    certified = SETS[name]
    found = least_squares(certified.matrix, certified.response)
    size = np.sqrt(found.chi2 / (len(certified.matrix) - certified.matrix.shape[1]))
    errors = size * np.sqrt(np.sum(found.root**2, axis=1))
    assert digits(found.values, certified.estimate) >= certified.digits[0]
    assert digits(errors, certified.deviation) >= certified.digits[1]
    assert digits(size, np.array(certified.residual)) >= certified.digits[2]


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


SIZES = [1, 95, 96, 97, 230]  # about one block of rows, and several


@pytest.mark.parametrize("n", SIZES)
def test_they_are_what_copies_would_be(n):
    given = np.random.default_rng(n).standard_normal((n, n))
    order = np.random.default_rng(0).permutation(n)
    for in_place, wanted in (
        (linalg.transposed, given.T),
        (linalg.symmetrised, 0.5 * (given + given.T)),
        (lambda m: linalg.rearranged(m, order), given[:, order]),
    ):
        matrix = given.copy()
        assert in_place(matrix) is matrix
        np.testing.assert_array_equal(matrix, wanted)


@pytest.mark.parametrize("n", SIZES)
def test_eigenvectors_are_those_of_lapack_for_pairs_too(n):
    q = np.linalg.qr(np.random.default_rng(n).standard_normal((n, n)))[0]
    values = np.repeat(np.geomspace(1.0, 1e6, n), 2)[:n]  # pairs of equals
    matrix = linalg.symmetrised(q * values @ q.T)
    wanted = np.linalg.eigh(matrix)[0]
    found, vectors = linalg.eigenvectors(matrix.copy())
    assert vectors.flags.c_contiguous
    np.testing.assert_allclose(found, wanted, atol=1e-9 * values[-1])
    np.testing.assert_allclose(vectors.T @ vectors, np.eye(n), atol=1e-12)
    np.testing.assert_allclose(matrix @ vectors, vectors * found, atol=1e-8 * values[-1])


@pytest.mark.parametrize(("dtype", "off"), [(np.float64, 1e-13), (np.float32, 1e-4)])
def test_a_positive_matrix_is_inverted_in_its_own_precision(dtype, off):
    units = np.logspace(-6, 6, 60)  # of unlike unknowns
    plain = symmetric(np.logspace(0, 2, 60), 5)[0]
    inverse = inverse_of_positive((plain * np.outer(units, units)).astype(dtype))
    assert inverse.dtype == dtype
    assert inverse * np.outer(units, units) == pytest.approx(np.linalg.inv(plain), abs=off)
