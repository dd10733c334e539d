"""Whether reciprocity is accepted, what contradicts it, and the estimated sensors."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from truenewton.arrays import Array, spread
from truenewton.errors import NotConverged, RankDeficient, TrueNewtonError
from truenewton.estimation.findings.code import Code
from truenewton.estimation.findings.estimate import Sensor
from truenewton.estimation.findings.finding import Finding
from truenewton.estimation.reciprocity.iteration import Fit
from truenewton.estimation.reciprocity.sensor_model import OFFSETS, Kind

# Simulated stiffnesses of P45 within these limits have a better alpha with reciprocity than by
# balance alone (docs/reciprocity.md).
MAX_HELD_OUT_RATIO = 1.15  # held-out imbalance relative to that of balance alone
MAX_CHI2_BETWEEN = 6.0  # chi2 per degree of freedom between balance alone and reciprocity alone
MAX_BLOCK_CHI2 = 1.5  # chi2 per degree of freedom of a block, if the noise is known
MAX_OFFSET_SPREAD = 1.2e-3  # rms offset of the sensors along an axis [m]
# No mirror has such an error of reciprocity together with such a ratio of the error of ml to it.
SENSELESS_ERROR, SURE_ERROR_RATIO = 0.1, 0.03
BLOCKS = ("balance", "rigid motions", "reciprocity")


@dataclass(frozen=True)
class Evidence:
    """Evidence for and against reciprocity; NaN if not available."""

    blocks: tuple[float, ...] = ()  # chi2 per degree of freedom of `BLOCKS`, against known noise
    held_out: float = float("nan")  # rms imbalance of held-out modes, with reciprocity
    by_balance: float = float("nan")  # the same by balance alone
    # chi2 per degree of freedom between alpha by balance alone and by reciprocity alone
    apart: float = float("nan")
    as_stated: float = float("nan")  # the same by the covariances of the fits, for noise of modes
    odd: tuple[int, ...] = ()  # actuators unlike the others, if more than may be left free
    transposed: bool = False  # whether the matrix looks transposed
    disturbed: bool = False  # whether readings of many actuators share noise
    untried: int = 0  # number of actuators, if errors of so many were never verified
    error: float = float("nan")  # typical relative E_STAT with reciprocity
    error_by_balance: float = float("nan")  # the same with `ml`
    gain_spread: float = float("nan")  # of log g, estimated
    offset_spread: float = float("nan")  # of the offsets [m], estimated


def refusals(evidence: Evidence) -> Iterator[Finding]:
    """Yield why reciprocity is not accepted."""
    if evidence.odd:
        yield Finding.of(Code.MISFIT_ACTUATORS, count=len(evidence.odd))
    if evidence.transposed:
        yield Finding.of(Code.TRANSPOSED)
    if evidence.disturbed:
        yield Finding.of(Code.SHARED_NOISE)
    if evidence.untried:
        yield Finding.of(Code.UNTESTED_SIZE, count=evidence.untried)
    for name, size in zip(BLOCKS, evidence.blocks, strict=False):
        if size > MAX_BLOCK_CHI2:
            yield Finding.of(Code.EQUATIONS_MISFIT, factor=np.sqrt(size), block=name)
    if evidence.held_out > MAX_HELD_OUT_RATIO * evidence.by_balance:
        yield Finding.of(
            Code.HELD_OUT_WORSE, held_out=evidence.held_out, by_balance=evidence.by_balance
        )
    if evidence.apart > MAX_CHI2_BETWEEN:
        yield Finding.of(Code.ESTIMATES_APART, factor=np.sqrt(evidence.apart))
    if evidence.error > evidence.error_by_balance:
        sizes: dict[str, Any] = {"error": evidence.error, "of_balance": evidence.error_by_balance}
        senseless = (
            evidence.error > SENSELESS_ERROR
            and evidence.error_by_balance < SURE_ERROR_RATIO * evidence.error
        )
        if evidence.as_stated > MAX_CHI2_BETWEEN and senseless:
            yield Finding.of(Code.BALANCE_CONTRADICTS_SYMMETRY, **sizes)
        else:
            yield Finding.of(Code.ERRORS_LARGER, **sizes)
    if evidence.offset_spread > MAX_OFFSET_SPREAD:
        yield Finding.of(Code.SENSORS_FAR, offset=1e3 * evidence.offset_spread)


def surely_worse(error: float, of_balance: float) -> bool:
    """Return whether noise alone makes errors larger than those of `ml`.

    Other evidence can only increase them. Only if that could make them senseless (three times as
    large), it would change the findings.
    """
    return of_balance < error < 0.3 * SENSELESS_ERROR


def failed(error: TrueNewtonError) -> Finding:
    """Return that an estimate ended in an error."""
    return Finding.of(Code.ESTIMATE_FAILED, fault=error.fault, remedy=error.remedy)


def doubts(against: Iterable[Finding]) -> tuple[Finding, ...]:
    """Return what contradicts a result by reciprocity."""
    return tuple(Finding.of(Code.RECIPROCITY_DOUBTFUL, cause=each) for each in against)


@contextmanager
def advising_ml() -> Iterator[None]:
    """Add the advice to use `ml` to errors of reciprocity."""
    try:
        yield
    except (RankDeficient, NotConverged) as error:
        raise error.changed(remedy=f"{error.remedy}; or use ml") from None


def instead(against: Iterable[Finding]) -> tuple[Finding, ...]:
    """Return why a result is by `ml` and not by reciprocity, and what contradicts both."""
    return tuple(
        each
        if each.code is Code.BALANCE_CONTRADICTS_SYMMETRY
        else Finding.of(Code.RECIPROCITY_NOT_USED, cause=each)
        for each in against
    )


def disagreement(one: Fit, other: Fit) -> float:
    """Return the variance between log alpha of two independent fits over that stated."""
    difference = one.values.log_alpha - other.values.log_alpha
    stated = sum(float(np.trace(fit.covariance_of(Kind.ALPHA))) for fit in (one, other))
    return max(1.0, len(difference) * float(np.var(difference)) / stated)


def apart(one: Fit, other: Fit, excess: float, other_excess: float) -> float:
    """Return chi2 per degree of freedom between two independent fits, with excess variances."""
    difference = one.values.log_alpha - other.values.log_alpha
    difference = difference - difference.mean()
    covariance = excess * one.covariance_of(Kind.ALPHA)
    covariance = covariance + other_excess * other.covariance_of(Kind.ALPHA)
    n = len(difference)
    held: Array = covariance + np.trace(covariance) / n**2  # the common scale is no difference
    return float(difference @ scipy.linalg.solve(held, difference, assume_a="pos")) / (n - 1)


def errors_of_sensors(fit: Fit) -> dict[Kind, Array]:
    """Return (n,) errors of log g and of offsets [m] that a fit states."""
    return {
        kind: np.sqrt(np.maximum(np.diag(fit.covariance_of(kind)), 0.0))
        for kind in fit.asked.kinds[1:]
    }


def sensors_of(
    fit: Fit,
    errors: Mapping[Kind, Array],
    ids: NDArray[np.int64],
    keep: NDArray[np.bool_],
) -> tuple[Sensor, ...]:
    """Return the sensors of a fit to those kept of (n,) IDs."""
    none = np.zeros(int(keep.sum()))
    of_gain, of_x, of_y = (errors.get(kind, none) for kind in (Kind.GAIN, *OFFSETS))
    gain, (dx, dy) = fit.values.gain, fit.values.offset
    columns = (gain, gain * of_gain, dx, of_x, dy, of_y)
    cells = (spread(column, keep).tolist() for column in columns)
    states = np.where(keep, "fitted", "free").tolist()
    return tuple(itertools.starmap(Sensor, zip(ids.tolist(), *cells, states, strict=True)))
