"""What changed between two states of one mirror, given by matrices, campaigns or calibrations."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, overload

import numpy as np
from numpy.typing import NDArray

from truenewton.arrays import Array, spread
from truenewton.calibration.result import Calibration
from truenewton.chance import FALSE_ALARM, t_isf
from truenewton.comparison.calibrations import Change, compare_calibrations
from truenewton.comparison.fit import Noise, PairFit, fit_pair, rough_factors
from truenewton.comparison.pairing import Pair, Side, pair_matrices, rough_residual
from truenewton.comparison.result import AnyChange, Comparison
from truenewton.errors import CampaignMismatch, TrueNewtonError
from truenewton.estimation.findings.code import Code
from truenewton.estimation.matrix.facts import MatrixFacts
from truenewton.estimation.matrix.order import balance_effects, orientation_effects
from truenewton.modal.measured_stiffness import measured_stiffness
from truenewton.reading import Read, read
from truenewton.records.campaign import Campaign
from truenewton.records.reader import AnyPath, Measured
from truenewton.records.segmented import refuse_segments
from truenewton.records.stiffness_matrix import StiffnessMatrix
from truenewton.rounding import counted
from truenewton.statics.arms import comparable_arms

DERIVED_NOISE = 1e-6  # relative residual below which one matrix was computed from the other
MAX_RESIDUAL = 0.1  # of the rms element: two matrices of different mirrors differ by more
# Spread of the factors without transposition, relative to that with it: between two matrices of
# one mirror the true factors are near 1, and alpha over sensor gain is not.
TRANSPOSED_SPREAD_RATIO = 3.0
# A mode was left out if its singular value is a thousandth of the noise or less. The three rigid
# motions may be as small if there is little noise; if they were removed, a pattern shows it.
MAX_EMPTY_MODE, MIN_MISSING_MODES = 1e-3, 4
MAX_NAMING_PASSES = 20


@overload
def compare(
    old: Measured, new: Measured, *, repeat: Measured | AnyPath | None = None
) -> Comparison: ...
@overload
def compare(old: Calibration, new: Calibration, *, repeat: None = None) -> Change: ...
@overload
def compare(
    old: Read | AnyPath, new: Read | AnyPath, *, repeat: Read | AnyPath | None = None
) -> AnyChange: ...
def compare(
    old: Read | AnyPath, new: Read | AnyPath, *, repeat: Read | AnyPath | None = None
) -> AnyChange:
    """Return what changed between two states of one mirror.

    Two stiffness matrices, two campaigns with POSITION, or one of each show the change of each
    alpha and of each sensor gain without weights, balance or symmetry, since the true stiffness
    cancels. A local change of the glass that resembles a product of factors cannot be told from a
    change of alpha. Two calibrations show the same with the errors of both, 2 to 100 times larger.

    Parameters
    ----------
    old, new
        Before and after, or their paths. Actuators are matched by ID and position. A campaign needs
        at least as many shapes as actuators; if it has a stiffness matrix, that is compared.
    repeat
        A further measurement of the same day as one of them: the errors then rest on the scatter of
        these two.

    Raises
    ------
    CampaignMismatch
        They are not of one mirror or not of one kind, a matrix is transposed or has the other sign,
        or one was computed from the other.
    RankDeficient
        The shapes of a campaign do not determine a stiffness.

    Examples
    --------
    >>> compared = tn.compare(matrix_2025, matrix_2026)
    >>> int(compared.alpha_changed.sum())
    0
    >>> moved = tn.compare(calibration, warm)
    >>> f"{moved.ratio:.2f}, and beside it {len(moved.changed)} actuators"
    '0.99, and beside it 0 actuators'
    """
    given = [
        read(each) if isinstance(each, str | os.PathLike) else each
        for each in (old, new, repeat)
        if each is not None
    ]
    if len(calibrations := [each for each in given if isinstance(each, Calibration)]) == 2:
        if len(given) == 2:
            return compare_calibrations(*calibrations)
    elif not calibrations:
        return _compare_bodies([each for each in given if isinstance(each, Measured)])
    raise CampaignMismatch(
        "only stiffness matrices and campaigns, or two calibrations, can be compared",
        remedy="give two files or folders of one kind",
    )


def _sides(data: Sequence[Measured]) -> tuple[list[Side], bool]:
    """Return the stiffness of each, measured or by regression, and whether all noise is known."""
    sides, residuals = [], []
    for name, given in zip(("old", "new", "repeat"), data, strict=False):
        matrix = given.stiffness if isinstance(given, Campaign) else given
        covariance, residual = np.zeros((given.layout.n, given.layout.n)), 1.0
        if isinstance(given, Campaign) and matrix is None:
            try:
                found = measured_stiffness(given)
            except TrueNewtonError as error:
                raise error.changed(fault=f"the {name} data: {error.fault}") from None
            matrix, covariance, residual = found.matrix, found.inverse, found.residual
        assert matrix is not None
        refuse_segments(matrix)
        sides.append(Side(matrix, covariance))
        residuals.append(residual)
    if not np.isfinite(residuals).all():  # the noise of all is taken as equal
        return sides, False
    return [
        Side(side.matrix, residual**2 * side.covariance)
        for side, residual in zip(sides, residuals, strict=True)
    ], True


def _compare_bodies(data: Sequence[Measured]) -> Comparison:
    """Compare old, new and perhaps a repeat."""
    (one, other, *third), known = _sides(data)
    pair = pair_matrices(one, other)
    _refuse_processed(pair)
    beside_matrix = known and bool(one.covariance.any()) != bool(other.covariance.any())
    fit = fit_pair(pair.old, pair.new, pair.inflation, pair.covariance, beside_matrix=beside_matrix)
    if beside_matrix:
        fit = replace(fit, covariance=fit.covariance * max(1.0, fit.pattern) ** 2)
    excess = math.nan
    if third:
        noise = _noise_of_repeat(pair, fit, one, third[0])
        fit = fit_pair(pair.old, pair.new, pair.inflation, pair.covariance, noise)
        free = 1.0 - 1.0 / pair.layout.n  # root of the share that factors do not absorb
        excess = float(np.sqrt((fit.noise.whitened(fit.unchanged) ** 2).mean())) / free
        fit = replace(fit, covariance=fit.covariance * max(1.0, excess) ** 2)
    return _comparison(one.matrix, other.matrix, pair, fit, excess)


def _comparison(
    old: StiffnessMatrix,
    new: StiffnessMatrix,
    pair: Pair,
    fit: PairFit,
    excess: float,
) -> Comparison:
    """Return the factors relative to the actuators that did not change."""
    n, means, arrays = pair.layout.n, list[Array](), dict[str, Any]()
    unchanged = np.ones(n, dtype=bool)
    on = np.zeros(old.layout.n, dtype=bool)
    on[pair.at] = True
    for k, (name, part, own) in enumerate(
        (("alpha", fit.a, fit.covariance[:n, :n]), ("sensor", fit.b, fit.covariance[n:, n:]))
    ):
        changed, scatter = _changed(part, fit.signs[k], own)
        unchanged &= ~changed
        means.append(~changed / np.count_nonzero(~changed))
        about = np.eye(n) - means[k]
        ratio = fit.signs[k] * np.exp(-about @ part)
        error = np.abs(ratio) * np.sqrt(np.diag(about @ own @ about.T))
        arrays |= {
            f"{name}_ratio": spread(ratio, on),
            f"{name}_ratio_error": spread(error, on),
            f"{name}_changed": spread(changed.astype(float), on) == 1.0,
            f"{name}_scatter": scatter,
        }
    mean = np.concatenate(means)
    common = float(np.exp(-mean @ np.concatenate([fit.a, fit.b])))
    diagonal, ids = np.sqrt(np.abs(np.diag(pair.old))), pair.layout.id
    square = np.divide(*fit.noise.innovations(fit.unchanged)) ** 2
    return Comparison(
        instrument=old.instrument,
        date=old.date,
        date_end=new.date,
        layout=replace(old.layout, enabled=on),
        **arrays,
        common=common,
        common_error=common * math.sqrt(mean @ fit.covariance @ mean),
        couplings=tuple(
            (int(ids[i]), int(ids[j]), float(size / (diagonal[i] * diagonal[j])))
            for (i, j), size in zip(fit.couplings, fit.coupling_sizes, strict=True)
        ),
        noise_law=fit.noise.name,
        relative_noise=float(np.sqrt((fit.residual**2).mean() / (pair.old**2).mean())),
        pattern=fit.pattern,
        tails=float((square**2).mean() / square.mean() ** 2) - 3.0,
        resemblance=_resemblance(fit, unchanged),
        excess=excess,
        matching=pair.matching,
        converged=fit.converged,
    )


def _noise_of_repeat(pair: Pair, fit: PairFit, old: Side, repeat: Side) -> Noise:
    """Return the noise of a repeat and the matrix of the same day, which it resembles more.

    Both are multiplied by the factors that make the new matrix equal to the old one.
    """
    third = pair_matrices(old, repeat)
    if not np.array_equal(third.at, pair.at):
        raise CampaignMismatch(
            "the repeat lacks actuators that both others contain, or has others",
            remedy="give a repeat of the same actuators",
        )
    same = pair.old
    repeated = third.new
    if rough_residual(pair.new, repeated) < rough_residual(pair.old, repeated):
        factors = fit.signs[0][:, None] * fit.signs[1] / np.exp(fit.a[:, None] + fit.b)
        same, repeated = pair.new * factors, repeated * factors
    return fit_pair(same, repeated, pair.inflation, pair.covariance).noise


def _resemblance(fit: PairFit, unchanged: NDArray[np.bool_]) -> float:
    """Return by how many sigmas the factors of rows and of columns are equal, not independent.

    Glass that becomes stiffer somewhere multiplies rows and columns there alike, to first order.
    """
    half = np.flatnonzero(unchanged)
    m = len(half)
    about = np.eye(m) - 1.0 / m
    logs = [about @ each[half] for each in (fit.a, fit.b)]
    parts = fit.covariance.reshape(2, len(unchanged), 2, -1)[:, half][..., half]
    rows, both, columns = (about @ parts[i, :, j] @ about for i, j in ((0, 0), (0, 1), (1, 1)))
    for own, values in ((rows, logs[0]), (columns, logs[1])):  # the scatter of the population
        own += max(0.0, (values @ values - np.trace(own)) / (m - 1)) * about
    variance = np.sum(rows * columns) + np.sum(both * both.T)
    return float((logs[0] @ logs[1] - np.trace(both)) / np.sqrt(variance))


def _changed(values: Array, signs: Array, covariance: Array) -> tuple[NDArray[np.bool_], float]:
    """Return which (n,) logarithms of factors deviate from the others, and the others' scatter."""
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
    return np.asarray(changed), math.sqrt(max(0.0, excess))


def _refuse_processed(pair: Pair) -> None:
    """Raise CampaignMismatch if one matrix is not a measurement of the same kind as the other."""
    residual, missing = rough_residual(pair.old, pair.new), []
    for name, k in (("old", pair.old), ("new", pair.new)):
        facts = MatrixFacts(k, comparable_arms(pair.layout))
        noise = residual * np.sqrt((k**2).mean())
        missing.append(np.count_nonzero(facts.singular_values < MAX_EMPTY_MODE * noise))
        for finding in (*balance_effects(facts), *orientation_effects(facts)):
            if finding.code is not Code.TRANSPOSED_STIFFNESS:  # the comparison itself tells
                raise CampaignMismatch(f"the {name} matrix: {finding.name}", remedy=finding.remedy)
    logs, signs = rough_factors(pair.old, pair.new)
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
    if abs(missing[1] - missing[0]) >= MIN_MISSING_MODES:
        name, count = ("old", "new")[int(np.argmax(missing))], abs(missing[1] - missing[0])
        raise CampaignMismatch(
            f"the {name} matrix lacks {counted(int(count), 'mode')} that the other contains",
            remedy="give two complete matrices, or two with the same modes",
        )
    if residual > MAX_RESIDUAL:
        raise CampaignMismatch(
            f"the two matrices differ by {100 * residual:.0f} % beyond factors of rows and columns",
            remedy="give two complete matrices of one mirror",
        )
