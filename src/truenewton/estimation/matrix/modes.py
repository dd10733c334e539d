"""Relative alpha from a stiffness matrix alone: elastic forces balance by themselves (k = 0).

The left singular vectors of the measured stiffness are force patterns in which weight, bias and
torques cancel. `svd` weights them equally: alpha is the smallest singular vector of the stacked A
diag(u), its mean set to 1. `ml` uses the columns, each with the noise that its data show; beside
cycles, the modes are used as shapes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace

import numpy as np
import scipy.linalg

from truenewton.arrays import Array
from truenewton.errors import NotConverged, RankDeficient
from truenewton.estimation.findings.code import Code
from truenewton.estimation.findings.estimate import Diagnosis, Estimate, Scale, separation_of
from truenewton.estimation.findings.finding import Finding
from truenewton.estimation.likelihood import (
    DataSet,
    Prior,
    likeliest_spread,
    minimise,
    on_logarithms,
    pull,
    smooth_patterns,
    with_population,
)
from truenewton.estimation.matrix.columns import Columns, ElasticFit, fit_columns
from truenewton.estimation.matrix.facts import MIN_SINGULAR_VALUE, MatrixFacts
from truenewton.estimation.matrix.screen import ScreenedMatrix
from truenewton.estimation.paper.equations import balance_rows
from truenewton.estimation.paper.identifiability import geometry_fault, refuse
from truenewton.estimation.readings.moments import shape_sums
from truenewton.linalg import singular_values_and_vectors
from truenewton.rounding import counted
from truenewton.statics.arms import enabled_arms

TYPICAL_STIFFNESS = 2e6  # diagonal element of a mirror's stiffness [N/m]
UNITS = {-1: "N/mm", -2: "N/um", -3: "N/nm"}  # by powers of a thousand
# No gains explain more: alpha that scatters by a third makes 0.25, another order 1.
MAX_ASYMMETRY = 0.5
EVEN_MODES, ODD_MODES = slice(0, None, 2), slice(1, None, 2)  # modes, the first stiffest


ElasticMethod = Callable[[Columns], ElasticFit]


def columns_of(screened: ScreenedMatrix) -> Columns:
    """Return the columns of a screened matrix."""
    facts = screened.facts
    k, a = facts.stiffness, facts.arms
    return Columns(k, a, screened.disturbance, screened.start, k, facts.elastic_modes)


def refuse_few_modes(count: int, n: int) -> None:
    """Raise RankDeficient if so many elastic modes cannot determine alpha of n actuators."""
    if count * 3 < n + 1:
        raise RankDeficient(
            f"only {counted(count, 'mode')} of STIFFNESS stiffer than"
            f" {MIN_SINGULAR_VALUE:g} of the stiffest, for {counted(n, 'actuator')}",
            remedy="measure a stiffness matrix of full rank",
        )


def balance_modes(modes: Array, a: Array) -> tuple[Array, Array]:
    """Return (n,) alpha of mean 1 that balances (m, n) modes best, and (n,) singular values.

    Alpha is the smallest singular vector of the stacked system; the values ascend.

    Raises
    ------
    RankDeficient
        The modes are too few, or a second pattern balances them as well.
    """
    n = a.shape[1]
    refuse_few_modes(len(modes), n)
    triangle = scipy.linalg.qr(balance_rows(modes, a), mode="r")[0][:n]
    _, values, right = singular_values_and_vectors(triangle)
    values, right = values[::-1], right[::-1]
    # Nearer than this the second pattern is decided by the same noise as the first.
    if values[1] < 1.5 * max(values[0], 1e-10 * values[-1]):
        raise RankDeficient(
            "alpha is not unique: two patterns balance the modes almost equally well (imbalance"
            f" {values[0]:.2g} and {values[1]:.2g})",
            remedy="check unit, X, Y and order of actuators; or measure a less noisy matrix",
        )
    mean = right[0].mean()
    alpha = right[0] / mean
    if abs(mean) * np.sqrt(n) < 0.1 or (alpha <= 0).any():
        raise RankDeficient(
            "the alpha that balances the modes is not positive for every actuator",
            remedy="check X, Y, NZ and the order of rows and columns in STIFFNESS",
        )
    return alpha, values


def mode_covariance(modes: Array, a: Array, alpha: Array, s: Array, prior: Array) -> Array:
    """Return the (n, n) covariance of alpha with mean 1, from the imbalance of each mode.

    The noise of one mode may differ from that of another: soft ones carry more. So each mode is
    left out in turn, to first order, and the scatter of the remaining results is the error, which
    is conservative (the jackknife HC3; MacKinnon and White, J. Econometrics 29, 1985). With e the
    three equations of a mode, whitened by the (3, 3) S, and G = sum e'e plus the (n, n) prior, its
    omission moves alpha by G^-1 e' (1 - e G^-1 e')^-1 e alpha. ``s`` and ``prior`` share an
    arbitrary factor.
    """
    n = len(alpha)
    root = np.linalg.inv(np.linalg.cholesky(s))
    e = balance_rows(modes, root @ a).reshape(3, -1, n)
    information = e.reshape(-1, n).T @ e.reshape(-1, n) + prior
    # The modes leave the scale free; the mean of alpha is held, so what is common is no error.
    inverse = np.linalg.inv(information + np.trace(information) / n**2)
    held = np.eye(n) - np.outer(alpha, np.full(n, 1.0 / n))
    inverse = held @ inverse @ held.T
    solved = e @ inverse
    leverage = np.einsum("kmi,lmi->mkl", solved, e)
    residual = np.einsum("kmi,i->mk", e, alpha)
    weighed = np.linalg.solve(np.eye(3) - leverage, residual[:, :, None])[:, :, 0]
    moved = np.einsum("kmi,mk->mi", solved, weighed)
    return np.asarray(moved.T @ moved)


def singular_fit(columns: Columns) -> ElasticFit:
    """Balance the elastic modes of columns by the smallest singular vector of all."""
    modes, a, n = columns.modes.forces.T, columns.a, columns.a.shape[1]
    alpha, singular_values = balance_modes(modes, a)
    covariance = mode_covariance(modes, a, alpha, np.eye(3), np.zeros((n, n)))
    return ElasticFit("svd", alpha, covariance, singular_values)


SPURIOUS_FACTOR = 1.27  # variance relative to the information's: more, and noise decides alpha


def mode_data(modes: Array, variance: float) -> DataSet:
    """Return (m, n) elastic modes as shapes without external load, for the likelihood."""
    m, n = modes.shape
    sums = shape_sums(modes, np.ones(m), np.zeros((m, 3)), np.ones((1, m)))
    return DataSet(sums, np.full(n, variance), np.zeros((1, 3)), np.zeros((1, 3, 0)))


def column_fit(columns: Columns, *, population: bool = False) -> ElasticFit:
    """Return the most likely relative alpha from columns alone.

    If the remaining imbalance is not noise of independent elements, alpha is that of the modes, all
    with the same noise, and its errors follow from the imbalance of each mode.
    Raises RankDeficient, NotConverged.
    """
    n = columns.a.shape[1]
    refuse_few_modes(len(columns.modes.values), n)
    try:
        fit, inflation = fit_columns(columns, population=population)
    except (RankDeficient, NotConverged):
        fit_of_modes = likeliest(columns.modes.forces.T, columns.a, population=population)
        return replace(fit_of_modes, warnings=(Finding.of(Code.COLUMN_NOISE_NOT_INDEPENDENT),))
    if inflation > SPURIOUS_FACTOR:
        raise RankDeficient(
            "noise decides some patterns of alpha: the matrix is too noisy for so many actuators",
            remedy="use --population, or measure a less noisy matrix",
        )
    if (fit.alpha <= 0.0).any():
        raise RankDeficient(
            "the alpha that balances the columns is not positive for every actuator",
            remedy="check X, Y, NZ and the order of rows and columns in STIFFNESS",
        )
    return fit


def likeliest(modes: Array, a: Array, *, population: bool = False) -> ElasticFit:
    """Return the most likely relative alpha of (m, n) modes with equal noise in all elements.

    ``population``: treat what is not smooth in alpha as samples of a normal population, whose
    spread is estimated. The arms ``a`` are (3, n).
    Raises RankDeficient, NotConverged.
    """
    start, singular_values = balance_modes(modes, a)
    fit = _at_spread(modes, a, np.inf, start, singular_values)
    if not population:
        return fit
    spread = likeliest_spread(smooth_patterns(a), fit.alpha, fit.covariance)
    fit = _at_spread(modes, a, spread, start, singular_values)
    return replace(fit, method=f"ml, population {spread:.2g}")


def _at_spread(
    modes: Array, a: Array, spread: float, start: Array, singular_values: Array
) -> ElasticFit:
    n, freedom = a.shape[1], 3 * len(modes) - a.shape[1] + 1
    s, smooth = (a * start**2) @ a.T, smooth_patterns(a)
    if np.linalg.cond(s) > 1e12:  # fewer than three actuators have an alpha
        raise RankDeficient(
            "the alpha that balances STIFFNESS is that of a few actuators alone",
            remedy="look for rows that are not like the others",
        )
    white = np.linalg.inv(np.linalg.cholesky(s)) @ a
    rows = balance_rows(modes, white) @ start
    least = 1e-18 / n  # rounding of a mode's element
    variance, values = max(float(rows @ rows) / freedom, least), start
    for _ in range(20):
        # Elastic forces leave the scale free, so nothing but this holds the mean at 1.
        scale = float(np.sum(singular_values**2)) / variance
        prior = Prior(np.ones(n), np.full((n, n), scale / n))
        prior = with_population(prior, smooth, values, spread)
        minimum = minimise(a, [mode_data(modes, variance)], prior, values)
        size, values = minimum.chi2 / freedom, minimum.values / minimum.values.mean()
        if abs(size - 1.0) < 1e-6 or variance * size < least:
            break
        variance *= size
    s = (a * values**2) @ a.T
    pulled = pull(on_logarithms(smooth, spread), values)[1] * variance
    covariance = mode_covariance(modes, a, values, s, pulled)
    if np.isfinite(spread):
        rows = balance_rows(modes, np.linalg.inv(np.linalg.cholesky(s)) @ a)
        information = rows.T @ rows + pulled
        information += np.trace(information) / len(pulled) ** 2
        inverse = np.linalg.inv(information)  # the effect of the population on alpha
        covariance = covariance + inverse @ pulled @ inverse * variance
    return ElasticFit("ml", values, covariance, singular_values, variance)


def fit_balance(screened: ScreenedMatrix, fit: ElasticMethod) -> Estimate:
    """Return relative alpha from the balance of the modes or columns.

    Raises RankDeficient, NotConverged.
    """
    facts = screened.facts
    refuse([geometry_fault(enabled_arms(screened.matrix.layout))])
    try:
        fitted = fit(columns_of(screened))
    except (RankDeficient, NotConverged) as error:
        for effect in screened.effects:  # the reason, where alpha cannot even be found
            if not effect.corrected:
                raise error.changed(fault=effect.name, remedy=effect.remedy) from None
        raise
    n, singular_values = len(fitted.alpha), fitted.singular_values
    eigenvalues = singular_values**2
    of_file = [*_unit_warnings(facts)]
    if facts.looks_transposed and not any(
        effect.code == Code.TRANSPOSED_STIFFNESS for effect in screened.effects
    ):
        of_file.append(Finding.of(Code.LOOKS_TRANSPOSED))
    warnings = (*screened.warnings, *of_file, *fitted.warnings)
    return Estimate(
        method=fitted.method,
        scale=Scale.MEAN_ONE,
        values=fitted.alpha,
        reading_covariance=fitted.covariance,
        systematic_covariance=np.zeros((n, n)),
        noise=float("nan"),
        condition=float(singular_values[-1] / singular_values[1]),
        rank=n - 1,
        diagnosis=Diagnosis(
            tuple(eigenvalues.tolist()), warnings=warnings, separation=separation_of(eigenvalues)
        ),
        effects=(*_not_as_agreed(facts), *screened.effects),
    )


def _not_as_agreed(facts: MatrixFacts) -> Iterator[Finding]:
    """Yield rows and columns in different orders, or a negative stiffness."""
    if np.trace(facts.stiffness) < 0.0:
        yield Finding(
            code=Code.NEGATIVE_STIFFNESS,
            remedy="reverse the sign of STIFFNESS; relative alpha is the same, modes are not",
        )
    if facts.asymmetry > MAX_ASYMMETRY:
        yield Finding(
            code=Code.ASYMMETRIC_STIFFNESS,
            size=facts.asymmetry,
            unit="|K + K'|",
            remedy="put rows and columns of STIFFNESS in the order of the ACTUATORS table",
        )


def _unit_warnings(facts: MatrixFacts) -> Iterator[Finding]:
    """Yield that the matrix is not in N/m, which does not affect relative alpha."""
    own = float(np.median(np.abs(np.diag(facts.stiffness))))
    if not 1e-2 < own / TYPICAL_STIFFNESS < 1e3:  # of any mirror in N/m
        power = round(np.log10(max(own, 1e-300) / TYPICAL_STIFFNESS) / 3.0)
        unit = UNITS.get(power, "counts, or at least not in N/m")
        yield Finding.of(Code.STIFFNESS_UNIT, unit=unit, own=own, usual=TYPICAL_STIFFNESS)


@dataclass(frozen=True)
class Imbalance:
    """Rms imbalance of elastic modes, each of unit length, over modes and the three equations."""

    modes: str
    before: float
    after: float
    alpha: Array | None = field(default=None, compare=False, repr=False)  # (n,) as fitted


def rms_imbalance(modes: Array, alpha: Array, a: Array) -> float:
    """Return the rms of A diag(alpha) u over (m, n) modes of unit length and three equations."""
    return float(np.sqrt(np.mean((modes * alpha @ a.T) ** 2)))


def imbalances(screened: ScreenedMatrix, fit: ElasticMethod, alpha: Array) -> tuple[Imbalance, ...]:
    """Return the imbalance with alpha = 1 and with the fitted (n,) alpha: all modes, and held-out.

    Held-out: fitted on every second mode, evaluated on the others, both ways round.

    Raises
    ------
    RankDeficient, NotConverged
        Half of the modes do not determine alpha.
    """
    columns = columns_of(screened)
    halves = (columns.modes.every(half) for half in (EVEN_MODES, ODD_MODES))
    fitted = (fit(replace(columns, stiffness=half.stiffness, modes=half)).alpha for half in halves)
    return imbalances_of(columns.modes.forces, columns.a, alpha, *fitted)


def imbalances_of(
    forces: Array, a: Array, alpha: Array, of_even: Array, of_odd: Array
) -> tuple[Imbalance, ...]:
    """Return the imbalance of all modes and of every second one, with alpha of the others.

    ``forces`` are (n, m) elastic modes of unit length, stiffest first, ``a`` (3, n) arms. The
    alphas, (n,), were fitted to all modes, to the even and to the odd; each is divided by its mean.
    """
    ones = np.ones(len(alpha))

    def of(name: str, some: slice, fitted: Array) -> Imbalance:
        modes = forces[:, some].T
        before, after = (rms_imbalance(modes, x / x.mean(), a) for x in (ones, fitted))
        return Imbalance(name, before, after, fitted)

    return (
        of("all modes, fitted", slice(None), alpha),
        of("odd modes, fitted on the even", ODD_MODES, of_even),
        of("even modes, fitted on the odd", EVEN_MODES, of_odd),
    )
