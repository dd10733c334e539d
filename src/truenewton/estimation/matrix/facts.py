"""What a measured stiffness matrix shows beside its fit: symmetry and the sign of its modes.

The true stiffness K = diag(alpha) M diag(1 / g) of an elastic body is symmetric and has no negative
mode (M: commanded force per reading, g: true displacement per reading). Neither enters the balance
of forces, so both test alpha and the matrix independently.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import scipy.linalg

from truenewton.arrays import Array
from truenewton.estimation.findings.code import Code
from truenewton.estimation.findings.finding import Finding
from truenewton.estimation.findings.thresholds import LIMITS

RIGID_MODES = 3  # piston and two tilts: about 0, of either sign
MIN_ASYMMETRY = 0.005  # below which symmetry is not judged


@dataclass(frozen=True)
class MatrixFacts:
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


def asymmetry_of(k: Array) -> float:
    """Return |K - K'| / |K + K'| of an (n, n) matrix."""
    return float(np.linalg.norm(k - k.T) / np.linalg.norm(k + k.T))


def matrix_facts(commanded: Array, alpha: Array, gain: Array | None = None) -> MatrixFacts:
    """Return the symmetry of an (n, n) matrix of commanded forces with (n,) alpha and gains."""
    k = alpha[:, None] * commanded
    with_gains = float("nan") if gain is None else asymmetry_of(k / gain)
    return MatrixFacts(asymmetry_of(commanded), asymmetry_of(k), with_gains)


def negative_modes(commanded: Array, alpha: Array) -> tuple[Array, float]:
    """Return the stiffness of negative elastic modes, ascending, and the largest by noise [N/m]."""
    k = alpha[:, None] * commanded
    # A symmetric matrix of noise with standard deviation s has no mode beyond 2 s root n (Wigner).
    s = float(np.sqrt(np.mean((k - k.T) ** 2))) / 2.0  # of the noise in the symmetric part
    values = np.sign(np.trace(k)) * scipy.linalg.eigvalsh(0.5 * (k + k.T))
    elastic = values[np.argsort(np.abs(values))[RIGID_MODES:]]
    return np.sort(elastic[elastic < 0.0]), 2.0 * s * float(np.sqrt(len(k)))


def doubts_of(commanded: Array, alpha: Array, facts: MatrixFacts) -> Iterator[Finding]:
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
    before, after = facts.asymmetry, facts.asymmetry_with_alpha
    if before > MIN_ASYMMETRY and after > LIMITS.asymmetry_ratio * before:
        yield Finding.of(Code.SYMMETRY_NOT_IMPROVED, before=before, after=after)
