"""Properties of a stiffness matrix, each computed once, and the tests of alpha based on them.

A rigid-body motion of a free shell requires no force. Therefore K {1, x, y} differs from zero only
by sensor gains, and {1, x, y}' K only by alpha, which scatters more. Transposing the matrix
exchanges the two.

The true stiffness K = diag(alpha) M diag(1 / g) of an elastic body is symmetric and has no negative
mode (M: commanded force per reading, g: true displacement per reading). The
force balance uses neither property, so both are independent tests of alpha and the matrix.
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

# Relative to the stiffest mode. The bias magnets' gradient mixes softer modes with rigid motions.
MIN_SINGULAR_VALUE = 1e-4
MIN_ASYMMETRY = 0.005  # symmetry is not judged below this
TRANSPOSED_COST_RATIO = 2.0  # rigid-body residual relative to the column imbalance
# Rigid-body residual relative to the diagonal. Sensor gains, which scatter by 1 %, cause less.
MAX_SENSOR_COST = 0.05
# Imbalance and asymmetry relative to the stiffness. Every measured matrix has more.
MIN_MEASURED_DEVIATION = 1e-6


@dataclass(frozen=True, eq=False)
class ElasticModes:
    """The elastic modes U S V' of a stiffness, stiffest first, without the softest."""

    forces: Array  # (n, m) U, of unit length
    values: Array  # (m,) S [N/m]
    readings: Array  # (n, m) V

    def every(self, some: slice) -> ElasticModes:
        """Return the selected modes."""
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
        """Return the properties of a matrix, restricted to enabled actuators."""
        return cls(matrix.used_stiffness, comparable_arms(matrix.layout))

    @cached_property
    def _decomposition(self) -> tuple[Array, Array, Array]:
        return linalg.singular_values_and_vectors(self.stiffness)

    @property
    def singular_values(self) -> Array:
        """(n,) singular values, descending [N/m]."""
        return self._decomposition[1]

    @property
    def elastic_modes(self) -> ElasticModes:
        """The elastic modes, at most n - 3."""
        forces, values, readings = self._decomposition
        stiff = np.count_nonzero(values > MIN_SINGULAR_VALUE * values[0])
        count = min(int(stiff), len(values) - 3)  # noise may raise the three rigid-body modes
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
        """Rigid-body residual: median force of a rigid motion, relative to the diagonal element."""
        return self._cost_and_imbalance[0]

    @property
    def imbalance(self) -> float:
        """Median column imbalance, relative to the diagonal element."""
        return self._cost_and_imbalance[1]

    @cached_property
    def balances_by_rounding(self) -> bool:
        """Whether commanded forces balance except for rounding, so that alpha cannot be estimated.

        The rounding may be that of double or single precision, or of a file with few digits. A
        large rigid-body residual means a transposed matrix with only its displacements cleaned.
        """
        imbalance, asymmetry, k = self.imbalance, self.asymmetry, self.stiffness
        if self.rigid_cost > MAX_SENSOR_COST:
            return False
        # In a measured matrix the imbalance exceeds a thousandth of the asymmetry.
        if imbalance < max(MIN_MEASURED_DEVIATION, 1e-3 * asymmetry):
            return True
        if imbalance > 0.2 * asymmetry:  # rounding alone would produce this asymmetry too
            return False
        own, steps = np.abs(np.diag(k)), rounding_steps(list(k.T))[:, None]  # of each actuator
        variances = np.maximum(steps, _digit_steps(k)) ** 2 / 12.0
        rounded = np.sqrt(np.sum(self.arms**2, axis=0) @ variances)
        rounded = rounded / np.where(own > 0.0, own, np.inf)
        return imbalance < 2.0 * float(np.median(rounded))

    @property
    def without_forces_at_rest(self) -> MatrixFacts:
        """The same without the forces f of K + f 1', as the stiffness K is almost symmetric.

        Then f_i - f_j is the asymmetry of almost all pairs. Their mean follows from piston, which
        costs no force. Both are of the median pair, so that single wrong sensors do not imitate f.
        """
        k = self.stiffness
        force = np.median(k - k.T, axis=1)
        force += float(np.mean(k)) - force.mean()
        return MatrixFacts(k - force[:, None], self.arms)

    @property
    def looks_transposed(self) -> bool:
        """Whether the rigid-body residual is much larger than the column imbalance."""
        costs_more = self.rigid_cost > TRANSPOSED_COST_RATIO * self.imbalance
        return costs_more and not self.balances_by_rounding


def _digit_steps(k: Array) -> Array:
    """Return (n, n) rounding steps if all elements have few significant digits, otherwise 0."""
    size = np.abs(k)
    tens = 10.0 ** np.floor(np.log10(np.where(size > 0.0, size, 1.0)))
    for digits in range(3, 7):  # more digits: as single precision
        steps = tens * 10.0 ** (1 - digits)
        if (np.abs(size / steps - np.round(size / steps)) < 0.02).all():
            return np.where(size > 0.0, steps, 0.0)
    return np.zeros_like(k)


@dataclass(frozen=True)
class Symmetry:
    """|K - K'| / |K + K'| of a measured matrix (Frobenius norms)."""

    asymmetry: float  # of commanded forces
    asymmetry_with_alpha: float  # of true forces
    asymmetry_with_gains: float = float("nan")  # with sensor gains too; NaN if they are unknown


def symmetry_of(facts: MatrixFacts, alpha: Array, gain: Array | None = None) -> Symmetry:
    """Return the asymmetry of a matrix before and after correction for (n,) alpha and gains."""
    k = alpha[:, None] * facts.stiffness
    with_gains = float("nan") if gain is None else linalg.asymmetry(k / gain)
    return Symmetry(facts.asymmetry, linalg.asymmetry(k), with_gains)


def negative_modes(commanded: Array, alpha: Array) -> tuple[Array, float]:
    """Return (m,) negative elastic stiffnesses, ascending, and the noise limit of |k| [N/m]."""
    k = alpha[:, None] * commanded
    # Eigenvalues of an n x n symmetric noise matrix (sigma s) are within 2 s sqrt(n) (Wigner).
    s = float(np.sqrt(np.mean((k - k.T) ** 2))) / 2.0  # noise of the symmetric part
    values = np.sign(np.trace(k)) * scipy.linalg.eigvalsh(0.5 * (k + k.T))
    elastic = values[np.argsort(np.abs(values))[3:]]  # rigid modes: about 0, of either sign
    return np.sort(elastic[elastic < 0.0]), 2.0 * s * float(np.sqrt(len(k)))


def doubts_of(commanded: Array, alpha: Array, symmetry: Symmetry) -> Iterator[Finding]:
    """Yield evidence against an (n, n) matrix or its (n,) alpha."""
    negative, by_noise = negative_modes(commanded, alpha)
    if negative.size:
        own = float(np.median(np.abs(alpha * np.diag(commanded))))
        # A noise that makes stiff modes negative is no excuse.
        allowed = min(LIMITS.negative_edges * by_noise, MAX_SENSOR_COST * own)
        beyond = -negative[0] > allowed
        yield Finding.of(
            Code.NEGATIVE_MODES if beyond else Code.NEGATIVE_MODES_IN_NOISE,
            count=negative.size,
            lowest=negative[0],
            stiffness=negative.tolist(),
        )
    before, after = symmetry.asymmetry, symmetry.asymmetry_with_alpha
    if before > MIN_ASYMMETRY and after > LIMITS.asymmetry_ratio * before:
        yield Finding.of(Code.SYMMETRY_NOT_IMPROVED, before=before, after=after)
