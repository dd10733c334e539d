"""What changed between two matrices of one mirror, and whether the stated errors are valid."""

from __future__ import annotations

import math
import os
from dataclasses import dataclass
from typing import ClassVar, overload

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from truenewton.arrays import Array
from truenewton.calibration.result import AnyCalibration
from truenewton.chance import FALSE_ALARM, t_isf
from truenewton.comparison.calibrations import Change, Tabulated, compare_calibrations
from truenewton.comparison.fit import ElementNoise, PairFit, fit_pair, rough_factors
from truenewton.comparison.pairing import Pair, pair_matrices, rough_residual
from truenewton.errors import CampaignMismatch
from truenewton.estimation.findings.code import Code
from truenewton.estimation.findings.finding import Finding, Verdict, judged
from truenewton.estimation.matrix.facts import MatrixFacts
from truenewton.estimation.matrix.order import balance_effects, orientation_effects
from truenewton.figures.layers import Layer
from truenewton.figures.style import on_screen
from truenewton.files.format import Column, TableFormat
from truenewton.reading import Read, holds_alpha, read
from truenewton.records.file import ID, X, Y
from truenewton.records.reader import AnyPath
from truenewton.records.stiffness_matrix import StiffnessMatrix
from truenewton.statics.arms import comparable_arms
from truenewton.statics.layout import Layout

DERIVED_NOISE = 1e-6  # relative residual below which one matrix was computed from the other
MAX_RESIDUAL = 0.1  # of the rms element: two matrices of different mirrors differ by more
MAX_PATTERN = (
    1.15  # largest singular value of n x n noise over 2 sqrt(n): 0.9 to 1.05 if it is noise
)
# Spread of the factors without transposition, relative to that with it: between two matrices of
# one mirror the true factors are near 1, and alpha over sensor gain is not.
TRANSPOSED_SPREAD_RATIO = 3.0
MAX_NAMING_PASSES = 20


CHANGES = TableFormat(
    "CHANGE",
    (
        ID,
        X,
        Y,
        Column("ALPHA", "alpha_ratio"),
        Column("E_ALPHA", "alpha_ratio_error"),
        Column("A_CHANGE", "alpha_changed", kind="bool"),
        Column("GAIN", "sensor_ratio"),
        Column("E_GAIN", "sensor_ratio_error"),
        Column("G_CHANGE", "sensor_changed", kind="bool"),
    ),
)


@dataclass(frozen=True, eq=False)
class Comparison(Tabulated):
    """What changed from an old to a new stiffness matrix of one mirror.

    Attributes
    ----------
    instrument
        INSTRUME of the old matrix.
    layout
        The n actuators that both contain.
    alpha_ratio, alpha_ratio_error
        (n,) alpha of the new over that of the old matrix, relative to the mean of the actuators
        that did not change, and its standard uncertainty.
    sensor_ratio, sensor_ratio_error
        (n,) the same of the sensor gains.
    alpha_changed, sensor_changed
        (n,) those that deviate from the population of the others (1 % false alarms in all).
    alpha_scatter, sensor_scatter
        Standard deviation of that population beyond the errors.
    common, common_error
        Mean of alpha_ratio times mean of sensor_ratio of those that did not change, which both were
        divided by: the weight, Young's modulus, the gap or a unit cannot be told from it.
    couplings
        IDs of actuator and sensor of the elements that changed by themselves, and by how much,
        relative to the geometric mean of the two diagonal elements.
    noise_law, relative_noise
        'elements' or 'modes'; rms difference that is not explained, relative to the rms element.
    pattern
        Largest singular value of the whitened residual over 2 sqrt(n): about 1 if it is noise.
    pair
        How actuators, rows and columns were matched.
    converged
        Whether the fit converged.

    Examples
    --------
    >>> tn.compare(matrix_2025, matrix_2026).verdict.level
    <Level.SOUND: 'sound'>
    """

    COLUMNS: ClassVar = CHANGES

    instrument: str
    layout: Layout
    alpha_ratio: Array
    alpha_ratio_error: Array
    sensor_ratio: Array
    sensor_ratio_error: Array
    alpha_changed: NDArray[np.bool_]
    sensor_changed: NDArray[np.bool_]
    alpha_scatter: float
    sensor_scatter: float
    common: float
    common_error: float
    couplings: tuple[tuple[int, int, float], ...]
    noise_law: str
    relative_noise: float
    pattern: float
    pair: Pair
    converged: bool

    def plot_map(self, ax: Axes | None = None) -> Axes:
        """Draw the change of alpha on the map of the actuators, and return the axes."""
        change = 100.0 * (np.abs(self.alpha_ratio) - 1.0)
        limit = float(np.percentile(np.abs(change), 98.0)) or 1.0
        layer = Layer("alpha", "change of alpha", "%", change, "", centre=0.0, reach=limit)
        with on_screen():
            return layer.plot(self.layout, ax)

    @property
    def findings(self) -> tuple[Finding, ...]:
        """What limits the errors."""
        found = []
        if self.pattern > MAX_PATTERN:
            found.append(Finding.of(Code.PAIR_PATTERN, pattern=self.pattern))
        if not self.converged:
            found.append(Finding.of(Code.PAIR_NOT_CONVERGED))
        return tuple(found)

    @property
    def verdict(self) -> Verdict:
        """Whether the stated errors are valid; a change is no fault."""
        return judged(self.findings)


@overload
def compare(old: StiffnessMatrix, new: StiffnessMatrix) -> Comparison: ...
@overload
def compare(old: AnyCalibration, new: AnyCalibration) -> Change: ...
@overload
def compare(old: Read | AnyPath, new: Read | AnyPath) -> Comparison | Change: ...
def compare(old: Read | AnyPath, new: Read | AnyPath) -> Comparison | Change:
    """Return what changed between two stiffness matrices, or two calibrations, of one mirror.

    Two matrices show the change of each alpha and of each sensor gain without weights, balance or
    symmetry, since the true stiffness cancels. A local change of the glass that resembles a product
    of factors cannot be told from a change of alpha. Two calibrations show the same with the errors
    of both, 2 to 100 times larger.

    Parameters
    ----------
    old, new
        Before and after, or their paths. Actuators of matrices are matched by ID and position.

    Raises
    ------
    CampaignMismatch
        They are not of one mirror or not of one kind, a matrix is transposed or has the other sign,
        or one was computed from the other.
    RankDeficient
        No segment has alpha in both calibrations.

    Examples
    --------
    >>> compared = tn.compare(matrix_2025, matrix_2026)
    >>> int(compared.alpha_changed.sum())
    0
    >>> moved = tn.compare(calibration, warm)
    >>> f"{moved.ratio:.2f}, and beside it {len(moved.changed)} actuators"
    '0.99, and beside it 0 actuators'
    """
    pair = [read(each) if isinstance(each, (str, os.PathLike)) else each for each in (old, new)]
    one, other = pair
    if isinstance(one, StiffnessMatrix) and isinstance(other, StiffnessMatrix):
        return compare_matrices(one, other)
    if holds_alpha(one) and holds_alpha(other):
        return compare_calibrations(one, other)
    raise CampaignMismatch(
        "only two stiffness matrices, or two calibrations, can be compared",
        remedy="give two files of one kind; of a mirror in segments two calibrations",
    )


def compare_matrices(old: StiffnessMatrix, new: StiffnessMatrix) -> Comparison:
    """Return what changed between two measured stiffness matrices of one mirror.

    Raises
    ------
    CampaignMismatch
        As of `compare`.
    """
    pair = pair_matrices(old, new)
    _refuse_processed(pair)
    fit = fit_pair(pair.old, pair.new, pair.inflation)
    n = pair.layout.n
    names = [_changed(part, fit.signs[k], cov) for k, (part, cov) in enumerate(_halves(fit))]
    ratios, errors, means = [], [], np.zeros(2 * n)
    for k, (part, own_covariance) in enumerate(_halves(fit)):
        weights = ~names[k].changed / np.count_nonzero(~names[k].changed)
        about = np.eye(n) - weights
        covariance = about @ own_covariance @ about.T
        ratios.append(fit.signs[k] * np.exp(-about @ part))
        errors.append(np.abs(ratios[k]) * np.sqrt(np.diag(covariance)))
        means[k * n : (k + 1) * n] = weights
    common = float(np.exp(-means @ np.concatenate([fit.a, fit.b])))
    own = np.sqrt(np.abs(np.diag(pair.old)))
    ids = pair.layout.id
    couplings = tuple(
        (int(ids[i]), int(ids[j]), float(size / (own[i] * own[j])))
        for (i, j), size in zip(fit.couplings, fit.coupling_sizes, strict=True)
    )
    whitened = fit.noise.whitened(fit.unchanged)
    return Comparison(
        instrument=old.instrument,
        layout=pair.layout,
        alpha_ratio=ratios[0],
        alpha_ratio_error=errors[0],
        sensor_ratio=ratios[1],
        sensor_ratio_error=errors[1],
        alpha_changed=names[0].changed,
        sensor_changed=names[1].changed,
        alpha_scatter=names[0].scatter,
        sensor_scatter=names[1].scatter,
        common=common,
        common_error=common * math.sqrt(means @ fit.covariance @ means),
        couplings=couplings,
        noise_law="elements" if isinstance(fit.noise, ElementNoise) else "modes",
        relative_noise=float(np.sqrt((fit.residual**2).mean())) / fit.size,
        pattern=float(np.linalg.norm(whitened, 2)) / (2.0 * math.sqrt(n)),
        pair=pair,
        converged=fit.converged,
    )


def _halves(fit: PairFit) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
    """Return a and b, each with its covariance."""
    n = len(fit.a)
    return (fit.a, fit.covariance[:n, :n]), (fit.b, fit.covariance[n:, n:])


@dataclass(frozen=True)
class Deviations:
    """Which of n values deviate from the others, and the scatter of these beyond the errors."""

    changed: NDArray[np.bool_]
    scatter: float


def _changed(values: Array, signs: Array, covariance: Array) -> Deviations:
    """Return which (n,) logarithms of factors deviate from the population of the others."""
    n = len(values)
    variance = np.diag(covariance) - 2.0 * covariance.mean(axis=0) + covariance.mean()
    usual = np.sign(np.median(signs))
    far = np.abs(values - np.median(values))
    changed = (signs != usual) | (far > 3.0 * np.median(far))
    for _ in range(MAX_NAMING_PASSES):
        # Each against the others without it, whose scatter it would inflate.
        kept = ~changed
        others = np.count_nonzero(kept) - kept
        centred = values - values[kept].mean()
        mean = np.where(kept, -centred, 0.0) / others
        squares = (centred[kept] ** 2).sum() - kept * centred**2 - others * mean**2
        scatter = np.maximum(0.0, squares / (others - 1) - variance[kept].mean())
        sigmas = np.abs(centred - mean) / np.sqrt((variance + scatter) * (1.0 + 1.0 / others))
        # Half of the false alarms are left to couplings; two sides, rows and columns.
        now = (signs != usual) | (sigmas > t_isf(FALSE_ALARM / 8 / n, others - 1))
        if (now == changed).all():
            break
        changed = now
    excess = float(values[~changed].var(ddof=1) - variance[~changed].mean())
    return Deviations(np.asarray(changed), math.sqrt(max(0.0, excess)))


def _refuse_processed(pair: Pair) -> None:
    """Raise CampaignMismatch if one matrix is not a measurement of the same kind as the other."""
    for name, k in (("old", pair.old), ("new", pair.new)):
        facts = MatrixFacts(k, comparable_arms(pair.layout))
        for finding in (*balance_effects(facts), *orientation_effects(facts)):
            if finding.code is not Code.TRANSPOSED_STIFFNESS:  # the comparison itself tells
                raise CampaignMismatch(f"the {name} matrix: {finding.name}", remedy=finding.remedy)
    logs, signs = rough_factors(pair.old, pair.new)
    residual = rough_residual(pair.old, pair.new)
    crossed, _ = rough_factors(pair.old, pair.new.T)
    spread, spread_transposed = (
        float(np.linalg.norm(each.std(axis=1))) for each in (logs, crossed)
    )
    if spread > TRANSPOSED_SPREAD_RATIO * spread_transposed:
        raise CampaignMismatch(
            "one of the two matrices is transposed",
            remedy="store [i, j], the force of actuator i per displacement of sensor j, in both",
        )
    if np.median(signs[0]) * np.median(signs[1]) < 0.0:
        raise CampaignMismatch(
            "the two matrices have opposite signs",
            remedy="multiply the matrix with the negative diagonal by -1",
        )
    if residual < DERIVED_NOISE:
        raise CampaignMismatch(
            "one of the two matrices was computed from the other: they differ by less than noise",
            remedy="give two matrices that were measured independently",
        )
    if residual > MAX_RESIDUAL:
        raise CampaignMismatch(
            f"the two matrices differ by {100 * residual:.0f} % beyond factors of rows and columns",
            remedy="give two complete matrices of one mirror",
        )
