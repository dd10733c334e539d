"""Sums over shapes: all that the likelihood needs of the forces under each load."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg.blas import dsyrk

from truenewton.arrays import Array
from truenewton.files.stored_rows import blocks
from truenewton.linalg import mirrored


@dataclass(frozen=True, eq=False)
class ShapeSums:
    """Sums over shapes under L loads, each shape counted with its weight r.

    Attributes
    ----------
    shapes
        Number of distinct shapes: each brings its own noise.
    weight, force, known
        (L,), (L, n) and (L, 3) sums of r, r c and r q, each load by itself; q is the balance known
        beforehand.
    square
        (n, n) sum of r c c' over all loads.
    known_force, known_square
        (3, n) and (3, 3) sums of r q c' and r q q' over all loads.
    """

    shapes: int
    weight: Array
    force: Array
    square: Array
    known: Array
    known_force: Array
    known_square: Array


def shape_sums(mean: Array, weight: Array, known: Array, share: Array) -> ShapeSums:
    """Return the sums over shapes.

    Parameters
    ----------
    mean, weight, known
        (g, n) forces [N], (g,) weights r, (g, 3) known balance.
    share
        (L, g) how much of the load each shape carries: 1 of its own, but of pooled rows some of
        each (`pooling`).
    """
    n = mean.shape[1]
    if (weight == weight[0]).all():
        square = dsyrk(float(weight[0]), mean.T)
    else:
        square = np.zeros((n, n), order="F")
        for some in blocks(len(mean), 8 * n):
            heavy = mean[some] * np.sqrt(weight[some])[:, None]
            square = dsyrk(1.0, heavy.T, beta=1.0, c=square, overwrite_c=True)
    square = mirrored(square).T  # in the order of C
    of_load = share * weight
    q = known * weight[:, None]
    anything = bool(q.any())
    return ShapeSums(
        shapes=int(np.count_nonzero(weight)),
        weight=np.sum(of_load * share, axis=1),
        force=of_load @ mean,
        square=square,
        known=of_load @ known,
        known_force=q.T @ mean if anything else np.zeros((3, n)),
        known_square=q.T @ known,
    )
