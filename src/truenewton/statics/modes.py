"""Stiffness modes: the eigenmodes of a stiffness matrix, softest first."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from truenewton.arrays import Array
from truenewton.linalg import ROWS_AT_ONCE, eigenvectors, rearranged, symmetrised


@dataclass(frozen=True, eq=False)
class StiffnessModes:
    """Eigenmodes of a symmetric stiffness."""

    # (n,) eigenvalues, of ascending magnitude but for rigid motions, which come first [N/m]
    stiffness: Array
    modes: Array  # (n, n), one mode a column, of unit length


def stiffness_modes(stiffness: Array, rigid: Array | None = None) -> StiffnessModes:
    """Return the eigenmodes of a symmetric (n, n) stiffness by ascending magnitude.

    Bias magnets make the stiffness of rigid motions negative, errors of measurement that of soft
    modes. On large mirrors rigid motions may be stiffer than the softest bending. With (n, r)
    ``rigid`` motions, the r modes nearest to their span come first, and are rotated within their
    span towards these motions, in their order: piston stays piston.

    Bases of modes of equal stiffness are chosen by `settled`.
    """
    values, vectors = eigenvectors(symmetrised(np.array(stiffness)))
    order = np.argsort(np.abs(values), kind="stable")
    if rigid is not None:
        names, upright = np.linalg.qr(rigid)
        part = np.sum((names.T @ vectors) ** 2, axis=0)
        first = np.zeros(len(values), dtype=bool)
        first[np.argsort(-part, kind="stable")[: rigid.shape[1]]] = True
        order = np.concatenate([order[first[order]], order[~first[order]]])
    values, modes = values[order], rearranged(vectors, order)
    first_modes = modes[:, : 0 if rigid is None else rigid.shape[1]].copy()
    settled(modes, values)
    if rigid is not None:
        r = rigid.shape[1]
        turn = _nearest_rotation(first_modes.T @ (names * np.sign(np.diag(upright))))
        modes[:, :r] = first_modes @ turn
        values[:r] = values[:r] @ turn**2
    modes.setflags(write=False)  # so that records need not copy them
    return StiffnessModes(values, modes)


def scaled_modes(modes: Array, stiffness: Array, stroke: float, force: Array | float) -> Array:
    """Return (m, n) modes, one a row, scaled to the largest stroke [m] and force, (n,) or one [N].

    The (n, n) stiffness is the force per displacement [N/m].
    """
    taken = np.maximum(np.abs(modes @ stiffness.T), 1e-12 * np.max(force))
    largest = np.abs(modes).max(axis=1)
    amplitude = np.minimum(stroke / largest, (force / taken).min(axis=1))
    return np.asarray(modes * amplitude[:, None])


def settled(vectors: Array, values: Array) -> Array:
    """Choose signs and rotations of (n, k) eigenvectors independently of rounding; in place.

    Each set of equal eigenvalues, adjacent in (k,) values, gets the basis nearest to fixed random
    vectors, which is the same on every machine. The vectors are also returned.
    """
    rounding = 1e-11 * np.abs(values).max() + 1e-6 * np.abs(values[1:])
    apart = np.abs(np.diff(values)) > rounding
    n, count = vectors.shape
    starts = np.concatenate([[0], np.flatnonzero(apart) + 1, [count]])
    several = np.flatnonzero(np.diff(starts) > 1)
    equals = [slice(*starts[k : k + 2]) for k in several]
    overlaps = [np.zeros((starts[k + 1] - starts[k],) * 2) for k in several]
    along = np.zeros(count)
    random = np.random.default_rng(0)
    for start in range(0, n, ROWS_AT_ONCE):
        rows = vectors[start : start + ROWS_AT_ONCE]
        reference = random.standard_normal(rows.shape)
        along += np.einsum("ij,ij->j", rows, reference)
        for overlap, equal in zip(overlaps, equals, strict=True):
            overlap += rows[:, equal].T @ reference[:, equal]
    for equal in equals:
        along[equal] = 0.0
    vectors *= np.where(along < 0.0, -1.0, 1.0)
    for overlap, equal in zip(overlaps, equals, strict=True):
        vectors[:, equal] = vectors[:, equal] @ _nearest_rotation(overlap)
    return vectors


def _nearest_rotation(overlaps: Array) -> Array:
    """Return the orthogonal matrix nearest to overlaps, by polar decomposition: no ties."""
    left, _, right = np.linalg.svd(overlaps)
    return np.asarray(left @ right)
