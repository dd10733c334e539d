"""Properties of a stiffness matrix, each computed once, and tests of alpha that they permit.

A rigid motion costs a free shell no force: K {1, x, y} vanishes except for the gains of the
sensors, and {1, x, y}' K except for alpha, which scatters more. In a transposed matrix they change
places.

The true stiffness K = diag(alpha) M diag(1 / g) of an elastic body is symmetric and has no negative
mode (M: commanded force per reading, g: true displacement per reading). Neither property enters the
balance of forces, so both test alpha and the matrix independently.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.linalg

from truenewton import linalg
from truenewton.arrays import Array
from truenewton.estimation.findings.code import LIMITS, Code
from truenewton.estimation.findings.finding import Finding
from truenewton.estimation.matrix.couplings import pair_ratios
from truenewton.estimation.readings.moments import rounding_steps
from truenewton.records.stiffness_matrix import StiffnessMatrix
from truenewton.statics.arms import comparable_arms

# Of the stiffest: softer modes mix with the rigid motions through the bias magnets' gradient.
MIN_SINGULAR_VALUE = 1e-4
MIN_ASYMMETRY = 0.005  # below which symmetry is not judged
TRANSPOSED_COST_RATIO = 2.0  # cost of rigid displacements relative to the imbalance of columns
# Of the diagonal element: more than the gains of sensors cost, which scatter by per cent.
MAX_SENSOR_COST = 0.05
# Imbalance and asymmetry, relative to the stiffness: no measured matrix has less.
MIN_MEASURED_DEVIATION = 1e-6


@dataclass(frozen=True, eq=False)
class ElasticModes:
    """The elastic modes U S V' of a stiffness, stiffest first, without the softest."""

    forces: Array  # (n, m) U, of unit length
    values: Array  # (m,) S [N/m]
    readings: Array  # (n, m) V

    def every(self, some: slice) -> ElasticModes:
        """Return some of the modes."""
        return ElasticModes(self.forces[:, some], self.values[some], self.readings[:, some])

    @property
    def stiffness(self) -> Array:
        """(n, n) stiffness of these modes alone [N/m]."""
        return np.asarray((self.forces * self.values) @ self.readings.T)


@dataclass(frozen=True, eq=False)
class MatrixFacts:
    """Properties of a stiffness matrix, each computed when it is first used."""

    stiffness: Array  # (n, n) commanded force per reading [N/m]
    arms: Array  # (3, n) in comparable units

    @classmethod
    def of(cls, matrix: StiffnessMatrix) -> MatrixFacts:
        """Return those of the enabled actuators of a matrix."""
        return cls(matrix.used_stiffness, comparable_arms(matrix.layout))

    @cached_property
    def _decomposition(self) -> tuple[Array, Array, Array]:
        return linalg.singular_values_and_vectors(self.stiffness)

    @property
    def singular_values(self) -> Array:
        """(n,) descending [N/m]."""
        return self._decomposition[1]

    @property
    def elastic_modes(self) -> ElasticModes:
        """The elastic modes, n - 3 at most."""
        forces, values, readings = self._decomposition
        stiff = np.count_nonzero(values > MIN_SINGULAR_VALUE * values[0])
        count = min(int(stiff), len(values) - 3)  # noise may lift the three rigid motions
        return ElasticModes(forces[:, :count], values[:count], readings[:count].T)

    @cached_property
    def asymmetry(self) -> float:
        """|K - K'| / |K + K'|; 0 for calibrated actuators and sensors (Maxwell and Betti)."""
        return linalg.asymmetry(self.stiffness)

    @cached_property
    def squares(self) -> tuple[Array, Array]:
        """(n, n) K'K and KK'."""
        k = self.stiffness
        return k.T @ k, k @ k.T

    @cached_property
    def pair_ratios(self) -> tuple[Array, Array]:
        """(n,) log alpha from symmetry, and the (n, n) misfit of pairs (`couplings`)."""
        return pair_ratios(self.stiffness)

    @cached_property
    def _cost_and_imbalance(self) -> tuple[float, float]:
        own = np.abs(np.diag(self.stiffness))
        own = np.where(own > 0.0, own, np.inf)
        rows = np.linalg.norm(self.stiffness @ self.arms.T, axis=1)
        columns = np.linalg.norm(self.arms @ self.stiffness, axis=0)
        return float(np.median(rows / own)), float(np.median(columns / own))

    @property
    def rigid_cost(self) -> float:
        """Median force of a rigid displacement, relative to the diagonal element."""
        return self._cost_and_imbalance[0]

    @property
    def imbalance(self) -> float:
        """Median imbalance of a column, relative to its diagonal element."""
        return self._cost_and_imbalance[1]

    @cached_property
    def balances_by_rounding(self) -> bool:
        """Whether commanded forces balance except for rounding, so that alpha cannot be estimated.

        The rounding is that of the computer, of single precision, or of a file with few digits. If
        rigid motions cost more than the gains of sensors do, only displacements were cleaned, and
        the matrix is transposed.
        """
        imbalance, unlike, k = self.imbalance, self.asymmetry, self.stiffness
        if self.rigid_cost > MAX_SENSOR_COST:
            return False
        # No measured columns balance a thousand times better than rows are like columns.
        if imbalance < max(MIN_MEASURED_DEVIATION, 1e-3 * unlike):
            return True
        if imbalance > 0.2 * unlike:  # rounding would hide the asymmetry as well
            return False
        own, steps = np.abs(np.diag(k)), rounding_steps(list(k.T))[:, None]  # of each actuator
        variances = np.maximum(steps, _digit_steps(k)) ** 2 / 12.0
        rounded = np.sqrt(np.sum(self.arms**2, axis=0) @ variances)
        rounded = rounded / np.where(own > 0.0, own, np.inf)
        return imbalance < 2.0 * float(np.median(rounded))

    @property
    def looks_transposed(self) -> bool:
        """Whether rigid displacements cost much more than the imbalance of columns."""
        costs_more = self.rigid_cost > TRANSPOSED_COST_RATIO * self.imbalance
        return costs_more and not self.balances_by_rounding


def _digit_steps(k: Array) -> Array:
    """Return the (n, n) rounding steps of the significant digits that all elements have, or 0."""
    size = np.abs(k)
    tens = 10.0 ** np.floor(np.log10(np.where(size > 0.0, size, 1.0)))
    for digits in range(3, 7):  # more digits leave what single precision leaves
        steps = tens * 10.0 ** (1 - digits)
        if (np.abs(size / steps - np.round(size / steps)) < 0.02).all():
            return np.where(size > 0.0, steps, 0.0)
    return np.zeros_like(k)


@dataclass(frozen=True)
class Symmetry:
    """|K - K'| / |K + K'| of a measured matrix (Frobenius norms); NaN if not known."""

    asymmetry: float  # as commanded
    asymmetry_with_alpha: float  # with alpha
    asymmetry_with_gains: float = float("nan")  # with alpha and the gains of the sensors


def symmetry_of(facts: MatrixFacts, alpha: Array, gain: Array | None = None) -> Symmetry:
    """Return the symmetry of a matrix of commanded forces with (n,) alpha and gains."""
    k = alpha[:, None] * facts.stiffness
    with_gains = float("nan") if gain is None else linalg.asymmetry(k / gain)
    return Symmetry(facts.asymmetry, linalg.asymmetry(k), with_gains)


def negative_modes(commanded: Array, alpha: Array) -> tuple[Array, float]:
    """Return the stiffness of negative elastic modes, ascending, and the largest by noise [N/m]."""
    k = alpha[:, None] * commanded
    # A symmetric matrix of noise with standard deviation s has no mode beyond 2 s root n (Wigner).
    s = float(np.sqrt(np.mean((k - k.T) ** 2))) / 2.0  # of the noise in the symmetric part
    values = np.sign(np.trace(k)) * scipy.linalg.eigvalsh(0.5 * (k + k.T))
    elastic = values[np.argsort(np.abs(values))[3:]]  # rigid modes: about 0, of either sign
    return np.sort(elastic[elastic < 0.0]), 2.0 * s * float(np.sqrt(len(k)))


def doubts_of(commanded: Array, alpha: Array, symmetry: Symmetry) -> Iterator[Finding]:
    """Yield what contradicts an (n, n) matrix or its (n,) alpha."""
    negative, by_noise = negative_modes(commanded, alpha)
    if negative.size:
        beyond = -negative[0] > LIMITS.negative_edges * by_noise
        yield Finding.of(
            Code.NEGATIVE_MODES if beyond else Code.NEGATIVE_MODES_IN_NOISE,
            count=negative.size,
            lowest=negative[0],
            stiffness=negative.tolist(),
        )
    before, after = symmetry.asymmetry, symmetry.asymmetry_with_alpha
    if before > MIN_ASYMMETRY and after > LIMITS.asymmetry_ratio * before:
        yield Finding.of(Code.SYMMETRY_NOT_IMPROVED, before=before, after=after)
