"""Brute-force likelihood of reciprocity with all elements of K as unknowns, and its bound.

It shares only the sensor model with the method. The stiffness is fitted by least squares at each
point, and derivatives are finite differences.
"""

import itertools

import numpy as np

from truenewton.estimation.reciprocity.sensor_model import Values, sensors_at


def free_basis(places):
    """Return (n, n - 3) displacements orthogonal to rigid-body motions."""
    return np.linalg.qr(places.rigid, mode="complete")[0][:, 3:]


def shifted(values, vector, kinds):
    """Return values with the unknowns of some kinds increased by a vector."""
    parts = dict(zip(kinds, np.split(vector, len(kinds)), strict=True))
    zero = np.zeros(len(values.log_alpha))
    return Values(
        values.log_alpha + parts.get("log alpha", zero),
        values.log_gain + parts.get("log g", zero),
        values.offset + np.array([parts.get("delta x", zero), parts.get("delta y", zero)]),
    )


class BruteForce:
    """E = K_c - D^-1 K H D_g, whitened, with K fitted by least squares.

    ``rows`` and ``columns`` whiten: rows @ E @ columns has independent elements of variance 1.
    """

    def __init__(self, places, stiffness, rows, columns, slopes):
        self.places, self.stiffness = places, stiffness
        self.rows, self.columns, self.slopes = rows, columns, slopes
        self.basis = free_basis(places)
        count = self.basis.shape[1]
        self.pairs = np.array([*itertools.combinations_with_replacement(range(count), 2)]).T

    def sides(self, values):
        """Return the factors left and right of K in the whitened model."""
        motion = sensors_at(self.places, values, slopes=self.slopes).motion
        return self.rows / values.alpha, motion @ (values.gain[:, None] * self.columns)

    def model(self, values, stiffness):
        left, right = self.sides(values)
        return (left @ stiffness @ right).ravel()

    def stiffness_jacobian(self, values):
        left, right = self.sides(values)
        left, right = left @ self.basis, self.basis.T @ right
        i, j = self.pairs
        each = np.einsum("ak,kb->abk", left[:, i], right[j])
        each += (i != j) * np.einsum("ak,kb->abk", left[:, j], right[i])
        return each.reshape(-1, len(i))

    def fitted(self, values):
        """Return the most likely K for given values, and the residual."""
        jacobian = self.stiffness_jacobian(values)
        data = (self.rows @ self.stiffness @ self.columns).ravel()
        best = np.linalg.lstsq(jacobian, data, rcond=None)[0]
        inner = np.zeros((self.basis.shape[1],) * 2)
        inner[*self.pairs] = best
        inner = inner + inner.T - np.diag(np.diag(inner))
        return self.basis @ inner @ self.basis.T, data - jacobian @ best

    def objective(self, values):
        return 0.5 * float(np.sum(self.fitted(values)[1] ** 2))

    def gradient(self, values, kinds, steps):
        made = []
        for k, step in enumerate(steps):
            move = np.zeros(len(steps))
            move[k] = step
            up, down = (self.objective(shifted(values, s * move, kinds)) for s in (1, -1))
            made.append((up - down) / (2 * step))
        return np.array(made)

    def information(self, values, kinds, steps):
        """Return the information on the unknowns, with K eliminated."""
        best, _ = self.fitted(values)
        columns = []
        for k, step in enumerate(steps):
            move = np.zeros(len(steps))
            move[k] = step
            up, down = (self.model(shifted(values, s * move, kinds), best) for s in (1, -1))
            columns.append((up - down) / (2 * step))
        jacobian, other = np.stack(columns, axis=1), self.stiffness_jacobian(values)
        basis = np.linalg.qr(other)[0]
        reduced = jacobian - basis @ (basis.T @ jacobian)
        return reduced.T @ reduced
