"""Properties of a stiffness matrix, each computed once, and what they show of alpha.

A free shell costs no force where it is moved rigidly: K {1, x, y} vanishes but for the gains of the
sensors, and {1, x, y}' K but for alpha, which scatters more; transposed, they change places.

The true stiffness K = diag(alpha) M diag(1 / g) of an elastic body is symmetric and has no negative
mode (M: commanded force per reading, g: true displacement per reading). Neither enters the balance
of forces, so both test alpha and the matrix independently.
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
from truenewton.estimation.readings.rounding_steps import rounding_steps
from truenewton.records.stiffness_matrix import StiffnessMatrix
from truenewton.statics.arms import comparable_arms

# Of the stiffest: softer modes mix with the rigid motions through the bias magnets' gradient.
MIN_SINGULAR_VALUE = 1e-4
RIGID_MODES = 3  # piston and two tilts: about 0, of either sign
MIN_ASYMMETRY = 0.005  # below which symmetry is not judged
# Times as much that rigid displacements cost as forces are out of balance.
TRANSPOSED_COST_RATIO = 2.0
# Of the own stiffness: more than gains of sensors cost, which scatter by per cent.
MAX_SENSOR_COST = 0.05
# Of the own stiffness: no measured columns balance so, nor are coils so alike.
MAX_REBALANCED_IMBALANCE = 1e-6
MIN_UNLIKENESS = 1e-3  # of the asymmetry: nor so much better than rows are like columns
# Of the asymmetry: rounding that leaves less than that out of balance may hide alpha.
MIN_ROUNDING_SHARE = 0.2
ROUNDING_RATIO = 2.0  # times as far out of balance as rounding leaves typically
DIGIT_COUNTS = range(3, 7)  # significant digits of a file; more leave what single precision leaves
WRITTEN_TOLERANCE = 0.02  # of a step, within which an element is written with so many digits


@dataclass(frozen=True, eq=False)
class ElasticModes:
    """The elastic modes U S V' of a stiffness, stiffest first; the softest are left out.

    Attributes
    ----------
    forces, values, readings
        (n, m) U, of unit length, (m,) S [N/m], (n, m) V.
    """

    forces: Array
    values: Array
    readings: Array

    def every(self, some: slice) -> ElasticModes:
        """Return some of the modes."""
        return ElasticModes(self.forces[:, some], self.values[some], self.readings[:, some])

    @property
    def stiffness(self) -> Array:
        """(n, n) of these modes alone [N/m]."""
        return np.asarray((self.forces * self.values) @ self.readings.T)


@dataclass(frozen=True, eq=False)
class MatrixFacts:
    """Properties of a stiffness matrix, each computed when it is first asked for.

    Attributes
    ----------
    stiffness, arms
        (n, n) commanded force per reading [N/m]; (3, n) arms in comparable units.
    """

    stiffness: Array
    arms: Array

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
        """The elastic modes; noise may lift rigid motions above the limit: three are never so."""
        forces, values, readings = self._decomposition
        stiff = np.count_nonzero(values > MIN_SINGULAR_VALUE * values[0])
        count = min(int(stiff), len(values) - 3)
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
        """What a rigid displacement costs in terms of the own stiffness, the median over all."""
        return self._cost_and_imbalance[0]

    @property
    def imbalance(self) -> float:
        """How far a column is out of balance, in the same terms."""
        return self._cost_and_imbalance[1]

    @cached_property
    def balances_by_rounding(self) -> bool:
        """Whether commanded forces balance but for rounding, so that nothing tells alpha.

        Rounding of the computer, of single precision, or that of a file with few digits. Not where
        rigid motions cost more than gains of sensors do: so are displacements cleaned, and
        transposed.
        """
        imbalance, unlike, k = self.imbalance, self.asymmetry, self.stiffness
        if self.rigid_cost > MAX_SENSOR_COST:
            return False
        if imbalance < max(MAX_REBALANCED_IMBALANCE, MIN_UNLIKENESS * unlike):
            return True
        if imbalance > MIN_ROUNDING_SHARE * unlike:
            return False
        own, steps = np.abs(np.diag(k)), rounding_steps(list(k.T))[:, None]  # of each actuator
        variances = np.maximum(steps, _digit_steps(k)) ** 2 / 12.0
        rounded = np.sqrt(np.sum(self.arms**2, axis=0) @ variances)
        rounded = rounded / np.where(own > 0.0, own, np.inf)
        return imbalance < ROUNDING_RATIO * float(np.median(rounded))

    @property
    def looks_transposed(self) -> bool:
        """Whether rigid displacements cost much more than columns are out of balance."""
        costs_more = self.rigid_cost > TRANSPOSED_COST_RATIO * self.imbalance
        return costs_more and not self.balances_by_rounding


def _digit_steps(k: Array) -> Array:
    """Return the step of each of (n, n) elements, by the significant digits that all have, or 0."""
    size = np.abs(k)
    tens = 10.0 ** np.floor(np.log10(np.where(size > 0.0, size, 1.0)))
    for digits in DIGIT_COUNTS:
        steps = tens * 10.0 ** (1 - digits)
        if (np.abs(size / steps - np.round(size / steps)) < WRITTEN_TOLERANCE).all():
            return np.where(size > 0.0, steps, 0.0)
    return np.zeros_like(k)


@dataclass(frozen=True)
class Symmetry:
    """Symmetry of a measured matrix: |K - K'| / |K + K'|, Frobenius norms.

    Attributes
    ----------
    asymmetry
        As commanded.
    asymmetry_with_alpha, asymmetry_with_gains
        With alpha, and with the gains of the sensors too; NaN if these are not known.
    """

    asymmetry: float
    asymmetry_with_alpha: float
    asymmetry_with_gains: float = float("nan")


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
    elastic = values[np.argsort(np.abs(values))[RIGID_MODES:]]
    return np.sort(elastic[elastic < 0.0]), 2.0 * s * float(np.sqrt(len(k)))


def doubts_of(commanded: Array, alpha: Array, symmetry: Symmetry) -> Iterator[Finding]:
    """Yield what speaks against an (n, n) matrix or its (n,) alpha."""
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
