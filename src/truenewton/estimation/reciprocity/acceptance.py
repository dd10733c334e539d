"""Whether reciprocity is accepted, what speaks against it, and what it finds of the sensors."""

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

# Of simulated stiffnesses of P45 these keep those whose alpha is better with reciprocity than by
# balance alone (docs/reciprocity.md).
MAX_HELD_OUT_RATIO = 1.15  # held-out imbalance in terms of that of balance alone
MAX_CHI2_BETWEEN = 6.0  # chi2 per degree of freedom between balance alone and reciprocity alone
MAX_BLOCK_CHI2 = 1.5  # chi2 per degree of freedom of a block, where the noise is known
MAX_OFFSET_SPREAD = 1.2e-3  # rms offset of the sensors along an axis [m]
# Error of reciprocity on no mirror; that of ml in terms of it.
SENSELESS_ERROR, SURE_ERROR_RATIO = 0.1, 0.03
BLOCKS = ("balance", "rigid motions", "reciprocity")


@dataclass(frozen=True)
class Evidence:
    """What there is for and against reciprocity; NaN where nothing tells.

    Attributes
    ----------
    blocks
        chi2 per degree of freedom of `BLOCKS`, against noise that is known.
    held_out, by_balance
        Rms imbalance of modes that the fit has not seen, with reciprocity and by balance alone.
    apart
        chi2 per degree of freedom between alpha by balance alone and by reciprocity alone.
    as_stated
        The same by the covariances of the fits, to which noise is one of modes.
    odd
        Actuators that are not like the others; more than may be left free.
    transposed
        Whether rows and columns look exchanged.
    disturbed
        Whether something pushes many actuators at once, from reading to reading.
    untried
        Number of actuators, where nobody has held errors of so many against the truth.
    error, error_by_balance
        Typical relative E_STAT, with reciprocity and of `ml`.
    gain_spread, offset_spread
        Spreads of log g and of the offsets [m], as the data give them.
    """

    blocks: tuple[float, ...] = ()
    held_out: float = float("nan")
    by_balance: float = float("nan")
    apart: float = float("nan")
    as_stated: float = float("nan")
    odd: tuple[int, ...] = ()
    transposed: bool = False
    disturbed: bool = False
    untried: int = 0
    error: float = float("nan")
    error_by_balance: float = float("nan")
    gain_spread: float = float("nan")
    offset_spread: float = float("nan")


def refusals(evidence: Evidence) -> Iterator[Finding]:
    """Yield why reciprocity is not to be believed."""
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


def failed(error: TrueNewtonError) -> Finding:
    """Return that an estimate ended in an error."""
    return Finding.of(Code.ESTIMATE_FAILED, fault=error.fault, remedy=error.remedy)


def doubts(against: Iterable[Finding]) -> tuple[Finding, ...]:
    """Return of an answer by reciprocity what speaks against it."""
    return tuple(Finding.of(Code.RECIPROCITY_DOUBTFUL, cause=each) for each in against)


@contextmanager
def advising_ml() -> Iterator[None]:
    """Let a refusal of reciprocity advise `ml`: only where `ml` was not taken already."""
    try:
        yield
    except (RankDeficient, NotConverged) as error:
        raise error.changed(remedy=f"{error.remedy}; or use ml") from None


def instead(against: Iterable[Finding]) -> tuple[Finding, ...]:
    """Return of an answer by `ml` why it is not by reciprocity, and what speaks against both."""
    return tuple(
        each
        if each.code is Code.BALANCE_CONTRADICTS_SYMMETRY
        else Finding.of(Code.RECIPROCITY_NOT_USED, cause=each)
        for each in against
    )


def disagreement(one: Fit, other: Fit) -> float:
    """Return the variance between the log alpha of two independent fits over what they state.

    1 at least: what two halves of the modes leave is more than noise where it is larger.
    """
    difference = one.values.log_alpha - other.values.log_alpha
    stated = sum(float(np.trace(fit.covariance_of(Kind.ALPHA))) for fit in (one, other))
    return max(1.0, len(difference) * float(np.var(difference)) / stated)


def apart(one: Fit, other: Fit, excess: float, other_excess: float) -> float:
    """Return chi2 per degree of freedom between the log alpha of two independent fits.

    Their covariances are so much larger than stated.
    """
    difference = one.values.log_alpha - other.values.log_alpha
    difference = difference - difference.mean()
    covariance = excess * one.covariance_of(Kind.ALPHA)
    covariance = covariance + other_excess * other.covariance_of(Kind.ALPHA)
    n = len(difference)
    held: Array = covariance + np.trace(covariance) / n**2  # the common scale is no difference
    return float(difference @ scipy.linalg.solve(held, difference, assume_a="pos")) / (n - 1)


def errors_of_sensors(fit: Fit) -> dict[Kind, Array]:
    """Return (n,) errors of log g and of offsets [m], if asked for, as a fit states them."""
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
    """Return the sensors of a fit to those kept of (n,) IDs; what was not asked has no error."""
    none = np.zeros(int(keep.sum()))
    of_gain, of_x, of_y = (errors.get(kind, none) for kind in (Kind.GAIN, *OFFSETS))
    gain, (dx, dy) = fit.values.gain, fit.values.offset
    columns = (gain, gain * of_gain, dx, of_x, dy, of_y)
    cells = (spread(column, keep).tolist() for column in columns)
    states = np.where(keep, "fitted", "free").tolist()
    return tuple(itertools.starmap(Sensor, zip(ids.tolist(), *cells, states, strict=True)))
