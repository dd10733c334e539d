"""Whether reciprocity holds: what speaks against it, in words."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from truenewton.arrays import Array
from truenewton.errors import NotConverged, RankDeficient
from truenewton.estimation.reciprocity.iteration import Fit
from truenewton.estimation.reciprocity.unknowns import Kind
from truenewton.records.fault import Fault
from truenewton.rounding import counted, percent

# Of simulated stiffnesses of P45 these keep those whose alpha is better with reciprocity than by
# balance alone (docs/reciprocity.md).
WORSE = 1.15  # held-out imbalance in terms of that of balance alone
APART = 6.0  # chi2 per degree of freedom between balance alone and reciprocity alone
BLOCK = 1.5  # chi2 per degree of freedom of a block, where the noise is known
FARTHEST = 1.2e-3  # rms offset of the sensors along an axis [m]
REMEDY = "give the mirror (--mirror) if not given, and check places and order of the sensors"
BY_ML = "alpha is by ml, not by reciprocity"
CONTRADICTED = "balance and reciprocity contradict each other"
SENSELESS, SURE = 0.1, 0.03  # error of reciprocity on no mirror; that of ml in terms of it
BLOCKS = ("balance", "rigid motions", "reciprocity")


@dataclass(frozen=True)
class Evidence:
    """What there is for and against reciprocity; NaN where nothing tells.

    Attributes
    ----------
    blocks
        chi2 per degree of freedom of `gate.BLOCKS`, against noise that is known.
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


def refusals(evidence: Evidence) -> Iterator[Fault]:
    """Yield why reciprocity is not to be believed."""
    if evidence.odd:
        many = counted(len(evidence.odd), "actuator")
        yield Fault(f"it does not hold for {many} or more", REMEDY)
    if evidence.transposed:
        yield Fault(
            "STIFFNESS looks transposed, and then it takes alpha for sensor gains",
            "store [i, j], the force of actuator i per displacement of sensor j",
        )
    if evidence.disturbed:
        yield Fault(
            "noise of the readings is common to many actuators, and it takes that of each for"
            " independent",
            "look for what pushes the mirror",
        )
    if evidence.untried:
        yield Fault(
            f"its errors were never held against a truth of"
            f" {counted(evidence.untried, 'actuator')}: noise in forces may make them too small",
            "compare two campaigns",
        )
    for name, size in zip(BLOCKS, evidence.blocks, strict=False):
        if size > BLOCK:
            yield Fault(f"its fit leaves {np.sqrt(size):.2g} times the noise of {name}", REMEDY)
    if evidence.held_out > WORSE * evidence.by_balance:
        yield Fault(
            f"modes that its fit has not seen are out of balance by"
            f" {percent(evidence.held_out)} of their force, by balance alone by"
            f" {percent(evidence.by_balance)}",
            REMEDY,
        )
    if evidence.apart > APART:
        yield Fault(
            f"alpha by balance and alpha by reciprocity are {np.sqrt(evidence.apart):.2g} times"
            " as far apart as their errors let expect",
            REMEDY,
        )
    if evidence.as_stated > APART and evidence.error > evidence.error_by_balance:
        sizes = (
            f"errors are {percent(evidence.error)} typically, those of ml"
            f" {percent(evidence.error_by_balance)}"
        )
        if evidence.error > SENSELESS and evidence.error_by_balance < SURE * evidence.error:
            remedy = "find out what was done to the matrix, and give it as it was measured"
            yield Fault(f"{CONTRADICTED}: of reciprocity {sizes}", remedy)
        else:
            yield Fault(f"its {sizes}", REMEDY)
    if evidence.offset_spread > FARTHEST:
        yield Fault(
            f"the sensors would have to be {1e3 * evidence.offset_spread:.2g} mm off their magnets",
            REMEDY,
        )


def doubts(against: Iterable[Fault]) -> tuple[Fault, ...]:
    """Say of an answer by reciprocity what speaks against it."""
    return tuple(
        Fault(f"reciprocity is in doubt: {fault}", f"use ml; {remedy}") for fault, remedy in against
    )


@contextmanager
def advising_ml() -> Iterator[None]:
    """Let a refusal of reciprocity advise `ml`: only where `ml` was not taken already."""
    try:
        yield
    except (RankDeficient, NotConverged) as error:
        raise error.changed(remedy=f"{error.remedy}; or use ml") from None


def instead(against: Iterable[Fault]) -> tuple[Fault, ...]:
    """Say of an answer by `ml` why it is not by reciprocity, and what speaks against both."""
    return tuple(
        each
        if each.fault.startswith(CONTRADICTED)
        else Fault(f"{BY_ML}: {each.fault}", each.remedy)
        for each in against
    )


def left_free(ids: NDArray[np.int64]) -> Iterator[Fault]:
    """Say of which actuators, by their (n,) IDs, alpha is that of the balance."""
    if ids.size:
        which = ", ".join(map(str, ids.tolist()))
        yield Fault(
            f"actuators or sensors that do not obey reciprocity were left out of it: {which}",
            "look at their sensors, wiring and places; their alpha is that of ml",
        )


def disagreement(one: Fit, other: Fit) -> float:
    """Return the variance between the log alpha of two independent fits over what they state.

    1 at least: what two halves of the modes leave is more than noise where it is larger.
    """
    difference = one.values.log_alpha - other.values.log_alpha
    stated = sum(float(np.trace(fit.covariance_of(Kind.ALPHA))) for fit in (one, other))
    return max(1.0, len(difference) * float(np.var(difference)) / stated)


def apart(one: Fit, other: Fit, excess: float = 1.0, other_excess: float = 1.0) -> float:
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
