"""Matrices that are worked on in place, against NumPy's plain copies."""

import numpy as np
import pytest

from truenewton import linalg

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
