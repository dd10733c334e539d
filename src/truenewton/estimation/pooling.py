"""Rows pooled over loads and signs: what shapes share besides their repeats.

A true shape costs the same elastic forces under every load, and the opposite ones with the opposite
sign. So the (g, n) means c of groups (`moments`), of weights r, are linear in a few rows,

    c = X b,    X: a column for each load and sign (statics), one for each SHAPE times its SIGN

(and times the size of the displacements under that load, where POSITION tells another than 1), and
with U spanning X, U' diag(r) U = 1, all that the balance hears of c is the R rows y = U' r c,
each with the noise of one reading. What is left, c - U y, is noise alone if shapes do repeat over
loads and signs: that is tested, and where it does not hold every group stands for itself, R = g.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.sparse
from numpy.typing import NDArray

from truenewton.arrays import Array

SMALLEST = 1e-9  # eigenvalue, in terms of the largest, of a direction of X that counts


@dataclass(frozen=True, eq=False)
class Pooling:
    """Rows that carry what groups share.

    Attributes
    ----------
    basis
        (g, R) U.
    weight
        (g,) r.
    """

    basis: scipy.sparse.csr_array
    weight: Array

    @property
    def count(self) -> int:
        """R."""
        return int(self.basis.shape[1])

    @cached_property
    def _transposed(self) -> scipy.sparse.csr_array:
        return self.basis.T.tocsr()

    def weighed(self, factor: Array | float = 1.0) -> scipy.sparse.csr_array:
        """Return (R, g) U' r f, f a (g,) factor."""
        weighed, heavy = self._transposed.copy(), self.weight * factor
        weighed.data *= heavy[weighed.indices]
        return weighed

    def rows(self, values: Array) -> Array:
        """Return (R, m) U' r v of (g, m) values v of the groups."""
        return np.asarray(self.weighed() @ values)

    @property
    def squared_lengths(self) -> Array:
        """(g,) sum of the squares of each row of U."""
        return np.asarray(self.basis.multiply(self.basis).sum(axis=1)).ravel()

    def groups(self, rows: Array) -> Array:
        """Return (g, m) U y, what (R, m) rows y say of the groups."""
        return np.asarray(self.basis @ rows)


def each_by_itself(weight: Array) -> Pooling:
    """Return the rows of groups that share nothing; those of weight 0 have none."""
    counted = np.flatnonzero(weight)
    values = (1.0 / np.sqrt(weight[counted]), (counted, np.arange(counted.size)))
    return Pooling(scipy.sparse.csr_array(values, shape=(weight.size, counted.size)), weight)


def over_loads_and_signs(labels: NDArray[np.int64], weight: Array, size: Array) -> Pooling:
    """Return the rows of groups whose shapes repeat over loads and signs.

    Parameters
    ----------
    labels, weight
        (g, 3) index of the load, SHAPE, SIGN; (g,) r, 0 of groups that do not count.
    size
        (L,) of shapes under each load, 1 under the first.
    """
    g, on = len(labels), np.flatnonzero(weight)
    _, shape = np.unique(labels[on, 1], return_inverse=True)
    _, statics = np.unique(2 * labels[on, 0] + (labels[on, 2] > 0), return_inverse=True)
    sign = labels[on, 2] * size[labels[on, 0]]
    r = weight[on]
    of_shape = scipy.sparse.csr_array((sign, (on, shape.ravel())), shape=(g, shape.max() + 1))
    of_statics = np.zeros((g, statics.max() + 1))
    of_statics[on, statics.ravel()] = 1.0
    # Of the statics what shapes do not tell already; both orthonormal in r.
    total = np.bincount(shape.ravel(), weights=r * sign**2)
    told = of_shape.T @ (weight[:, None] * of_statics) / total[:, None]
    apart = of_statics - of_shape @ told
    values, vectors = np.linalg.eigh(apart.T @ (weight[:, None] * apart))
    counted = values > SMALLEST * r.sum()
    rest = apart @ (vectors[:, counted] / np.sqrt(values[counted]))
    parts = [of_shape / np.sqrt(total), scipy.sparse.csr_array(rest)]
    return Pooling(scipy.sparse.hstack(parts, format="csr"), weight)
