"""From data to a calibration: the choice of the method, and its numbers for all actuators."""

from __future__ import annotations

import datetime
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import fields, replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from truenewton.arrays import Array, spread, spread_covariance
from truenewton.calibration.result import Calibration
from truenewton.calibration.verdict import warn_of
from truenewton.errors import (
    Fault,
    NotConverged,
    RankDeficient,
    TrueNewtonError,
    UnknownName,
    located,
)
from truenewton.estimation import campaign_ml
from truenewton.estimation.findings.code import LIMITS, Code
from truenewton.estimation.findings.estimate import Estimate, EstimateFacts, typical
from truenewton.estimation.findings.finding import Finding, distinct
from truenewton.estimation.matrix import modes as matrix_modes
from truenewton.estimation.matrix.coherent_imbalance import doubts_of_balance
from truenewton.estimation.matrix.facts import MatrixFacts, doubts_of, symmetry_of
from truenewton.estimation.matrix.screen import ScreenedMatrix, screen_matrix
from truenewton.estimation.paper import svd as paper_svd
from truenewton.estimation.paper.equations import Unknowns
from truenewton.estimation.paper.identifiability import diagnose
from truenewton.estimation.paper.svd import cycle_errors
from truenewton.estimation.reciprocity import campaign as reciprocity_of_campaign
from truenewton.estimation.reciprocity import matrix as reciprocity_of_matrix
from truenewton.estimation.reciprocity.acceptance import advising_ml, doubts, failed, instead
from truenewton.estimation.screening.screen import (
    ScreenedCampaign,
    campaign_moments,
    screen_campaign,
)
from truenewton.files.format import attributes
from truenewton.linalg import threads
from truenewton.progress import kept_as, report_progress
from truenewton.records.campaign import Campaign, mean_temperature
from truenewton.records.cycle import Cycle, Source
from truenewton.records.reader import AnyPath, Measured, measured_from
from truenewton.records.stiffness_matrix import StiffnessMatrix
from truenewton.rounding import percent
from truenewton.statics.layout import Layout

Imbalances = tuple[matrix_modes.Imbalance, ...]


class Options(NamedTuple):
    """Options of `calibrate` that some methods use."""

    population: bool = False
    motion: Array | None = None


class Method(NamedTuple):
    """A method, for a screened campaign and for a stiffness, with the imbalance of its modes."""

    of_cycles: Callable[[ScreenedCampaign, Options], Estimate]
    of_stiffness: Callable[[ScreenedMatrix, Options], tuple[Estimate, Imbalances]]


def _svd_of_cycles(screened: ScreenedCampaign, _: Options) -> Estimate:
    """Solve the paper's system with all rows; the findings about the data are those of `ml`."""
    judged = campaign_ml.fit_campaign(screened)
    campaign = screened.campaign
    moments = campaign_moments(campaign) if screened.rejected else screened.moments
    found = paper_svd.solve_campaign(campaign, moments)
    effects = tuple(replace(effect, corrected=False) for effect in judged.effects)
    warnings = distinct((*found.diagnosis.warnings, *judged.diagnosis.warnings))
    if judged.rejected_rows:
        warnings += (Finding.of(Code.SVD_USES_ALL_ROWS, count=len(judged.rejected_rows)),)
    diagnosis = replace(found.diagnosis, warnings=warnings)
    fit = judged.goodness  # of `ml`: stated if no alpha balances the data
    goodness = fit if fit is not None and fit.probability < LIMITS.fit_probability else None
    return replace(found, effects=effects, diagnosis=diagnosis, goodness=goodness)


def _by_balance(
    screened: ScreenedMatrix, method: matrix_modes.ElasticMethod
) -> tuple[Estimate, Imbalances]:
    """Return the estimate of a method that balances forces, and the imbalance that it leaves."""
    return _with_imbalances(screened, method, matrix_modes.fit_balance(screened, method))


def _with_imbalances(
    screened: ScreenedMatrix, method: matrix_modes.ElasticMethod, estimate: Estimate
) -> tuple[Estimate, Imbalances]:
    """Return an estimate and the imbalance of its modes; warn if half of them is too few."""
    try:
        return estimate, matrix_modes.imbalances(screened, method, estimate.values)
    except (RankDeficient, NotConverged) as error:
        alone = Finding.of(Code.HALVES_INSUFFICIENT, fault=error.fault, remedy=error.remedy)
        return estimate.with_warnings((alone,)), ()


def _reciprocal(screened: ScreenedMatrix, options: Options) -> tuple[Estimate, Imbalances]:
    """Return the estimate of reciprocity, with the reasons to doubt it."""
    base = matrix_modes.fit_balance(screened, matrix_modes.column_fit)
    with advising_ml():
        estimate, of_modes, against = reciprocity_of_matrix.fit_matrix(
            screened, base, options.motion
        )
    return estimate.with_warnings(doubts(against)), of_modes


def _where_reciprocity_holds(
    screened: ScreenedMatrix, options: Options
) -> tuple[Estimate, Imbalances]:
    """Return the estimate of reciprocity, or that of `ml` with the reason.

    That of `ml` is available first, if the user interrupts.
    """
    base = matrix_modes.fit_balance(screened, matrix_modes.column_fit)

    def of_balance(against: Iterable[Finding]) -> tuple[Estimate, Imbalances]:
        told = base.with_warnings(instead(against))
        return _with_imbalances(screened, matrix_modes.column_fit, told)

    alpha = base.values[: len(base.reading_covariance)]
    error = typical(np.sqrt(np.diag(base.reading_covariance)), alpha)
    first = f"by the balance of forces alone (ml): alpha {alpha.min():.3g} .. {alpha.max():.3g},"
    first += f" typical error {percent(error)}"
    report_progress(first, keep=lambda: of_balance([Finding.of(Code.INTERRUPTED)]))
    try:
        estimate, of_modes, against = reciprocity_of_matrix.fit_matrix(
            screened, base, options.motion, where_it_holds=True
        )
        if not against:
            return estimate, of_modes
    except (RankDeficient, NotConverged) as error:
        against = (failed(error),)
    return of_balance(against)


METHODS = {
    "ml": Method(
        lambda screened, options: campaign_ml.fit_campaign(screened, options.population),
        lambda screened, options: _by_balance(
            screened, partial(matrix_modes.column_fit, population=options.population)
        ),
    ),
    "svd": Method(
        _svd_of_cycles, lambda screened, _: _by_balance(screened, matrix_modes.singular_fit)
    ),
    "reciprocity": Method(
        lambda screened, options: reciprocity_of_campaign.fit_campaign(screened, options.motion),
        _reciprocal,
    ),
    "auto": Method(
        lambda screened, options: reciprocity_of_campaign.fit_campaign(
            screened, options.motion, where_it_holds=True
        ),
        _where_reciprocity_holds,
    ),
}


def calibrate(
    data: Measured | AnyPath | Iterable[AnyPath | Cycle],
    method: str | None = None,
    *,
    population: bool = False,
    motion: Array | None = None,
    exclude: Collection[int | str] = (),
) -> Calibration:
    """Find alpha of every actuator.

    Parameters
    ----------
    data
        A campaign under at least two loads, or a measured stiffness matrix (relative alpha), or a
        path, paths or cycles. Read data of several segments one at a time.
    method
        'ml', maximum likelihood; 'svd', the paper's; 'reciprocity', which uses the
        readings of the sensors; 'auto', reciprocity if it is accepted, otherwise
        'ml', with the reason in the verdict. By default 'auto' for a matrix and with
        ``motion``, otherwise 'ml' (docs/decisions.md).
    population
        Take the actuators as samples of one normal population of unknown spread, which pulls poorly
        determined patterns toward the mean. With 'ml' only; the result names it.
    motion
        (6, n, n) what the sensors read of the glass, from `sensor_model`; or (n, n)
        displacements at the forces for those at the sensors. With 'reciprocity' and 'auto'
        only.
    exclude
        IDs of actuators without alpha, such as channels that are known to be bad. Those of a matrix
        are released: the others are taken in states in which these exert no force.

    Raises
    ------
    RankDeficient
        The data cannot determine alpha; the message says what is missing.
    SeveralSegments
        The data are of several segments.
    TooManyOutliers, NotConverged
        The data do not fit together.
    UnknownName, TypeError
        There is no such method, or it does not take such data.

    Warns
    -----
    TrueNewtonWarning
        The verdict is 'rejected' or 'doubtful'.

    Examples
    --------
    >>> tn.calibrate(campaign)
    <Calibration of P45: 45 actuators, alpha 0.715 .. 1.1, typical error 1.7 %, ...>
    """
    data = measured_from(data)
    method, options = resolve_method(data, method, population=population, motion=motion)
    ids = sorted(set(data.layout.ids_of(exclude)))
    left = disabled(data, ids)
    if isinstance(left, Campaign):
        estimate = METHODS[method].of_cycles(screen_campaign(left), options)
        made = _without(calibration_of(left, estimate), ids)
    else:
        made = _of_matrix(left, method, options, ids)
    warn_of(made)
    return made


def _of_matrix(
    matrix: StiffnessMatrix, method: str, options: Options, excluded: Sequence[int]
) -> Calibration:
    """Calibrate a matrix; if interrupted, the estimate so far can be kept as a calibration."""

    def made_of(found: tuple[Estimate, Imbalances]) -> Calibration:
        return _without(_of_stiffness(screened, *found), excluded)

    try:
        with threads(1), kept_as(made_of):
            screened = screen_matrix(matrix)
            found = METHODS[method].of_stiffness(screened, options)
    except (RankDeficient, NotConverged) as error:
        raise located(error, matrix.source and Path(matrix.source.file).name) from None
    return made_of(found)


def resolve_method(
    data: Measured,
    method: str | None,
    *,
    population: bool,
    motion: Array | None,
) -> tuple[str, Options]:
    """Return the method, by default chosen by the data, and its options, as of `calibrate`.

    Raises UnknownName if there is no such method, or it does not take such data or options;
    ``motion`` is (6, n, n) or (n, n).
    """
    if method is None:
        tried = isinstance(data, StiffnessMatrix) or motion is not None
        method = "auto" if tried and not population else "ml"
    both = isinstance(data, Campaign) and data.stiffness is not None
    for wrong, fault, remedy in (
        (method not in METHODS, f"there is no method '{method}'", f"choose {', '.join(METHODS)}"),
        (population and method not in ("ml", "svd"), "a population goes with ml only", "use ml"),
        (
            method == "svd" and (population or both),
            "svd takes neither a population nor a stiffness matrix beside cycles",
            "use ml",
        ),
        (
            motion is not None and method in ("ml", "svd"),
            f"{method} does not use what the sensors read of the glass",
            "leave the mirror out, or use reciprocity or auto",
        ),
    ):
        if wrong:
            raise UnknownName(fault, remedy=remedy)
    return method, Options(population, motion)


def estimate_alpha(screened: ScreenedCampaign, method: str, options: Options) -> Estimate:
    """Return the estimate of a screened campaign by a method; 'ml' reads no row."""
    return METHODS[method].of_cycles(screened, options)


def refusals(error: TrueNewtonError, screened: ScreenedCampaign | None) -> tuple[Fault, ...]:
    """Return why there is no alpha: the fault of the error, then what else is missing."""
    first = Fault(error.fault, error.remedy)
    if screened is None or not isinstance(error, RankDeficient):
        return (first,)
    others = diagnose(screened.sound, screened.moments).faults
    return first, *(Fault(x.fault, x.remedy) for x in others if x.fault != error.fault)


def calibration_of(campaign: Campaign, estimate: Estimate) -> Calibration:
    """Return an estimate as a calibration, with E_CYCLE."""
    layout, cycles, on = campaign.layout, campaign.cycles, campaign.layout.enabled
    estimate = estimate.with_warnings(doubts_of_coupling(campaign.stiffness))
    unknowns = Unknowns(int(on.sum()), len(campaign.loads))
    torques = estimate.values[unknowns.torques].reshape(-1, 2)
    lost = [sum(row.cycle == k for row in estimate.rejected_rows) for k in range(len(cycles))]
    return Calibration(
        instrument=campaign.instrument,
        date=min(c.date for c in cycles),
        date_end=max(
            c.date + datetime.timedelta(seconds=float(c.time[c.valid].max())) for c in cycles
        ),
        layout=layout,
        loads=campaign.loads,
        cycle_error=spread(cycle_errors(campaign, estimate.values), on),
        bias_force=float(estimate.values[unknowns.bias]),
        torque_y=torques[:, 0],
        torque_x=torques[:, 1],
        weight=campaign.weight,
        weight_error=campaign.weight_error,
        temperature=mean_temperature(cycles),
        shapes_used=sum(int(c.valid.sum()) for c in cycles) - len(estimate.rejected_rows),
        rejected=len(estimate.rejected_rows),
        invalid=sum(int((~c.valid).sum()) for c in cycles),
        sources=tuple(
            Source(Path(c.source.file).name, c.source.sha256, int(c.valid.sum()) - less, less)
            for c, less in zip(cycles, lost, strict=True)
            if c.source
        )
        + _matrix_source(campaign.stiffness),
        **_numbers_of(estimate, on),
    )


def doubts_of_coupling(matrix: StiffnessMatrix | None) -> tuple[Finding, ...]:
    """Return that a segment is coupled to others, so that it does not balance by itself."""
    if matrix is None or matrix.coupling is None:
        return ()
    size, own = matrix.coupling
    return (Finding.of(Code.SEGMENTS_COUPLED, size=size, own=own),)


def _of_stiffness(
    screened: ScreenedMatrix, estimate: Estimate, imbalances: Imbalances
) -> Calibration:
    """Return an estimate from a stiffness matrix as a calibration."""
    matrix, facts, on = screened.matrix, screened.facts, screened.matrix.layout.enabled
    n = int(on.sum())
    alpha, gain = estimate.values[:n], None
    if estimate.sensors:
        gain = np.array([each.gain if each.state == "fitted" else 1.0 for each in estimate.sensors])
    ids, covariance = matrix.layout.id[on], estimate.reading_covariance[:n, :n]
    of_balance, covariance = doubts_of_balance(facts, alpha, covariance, ids)
    symmetry = symmetry_of(facts, alpha, gain)
    of_symmetry = doubts_of(facts.stiffness, alpha, symmetry)
    of_coupling = doubts_of_coupling(matrix)
    estimate = estimate.with_warnings((*of_symmetry, *of_balance, *of_coupling))
    # B is not to be had from elastic forces.
    reading, systematic = (
        np.pad(each, (0, 1), constant_values=np.nan)
        for each in (covariance, estimate.systematic_covariance)
    )
    estimate = replace(estimate, reading_covariance=reading, systematic_covariance=systematic)
    return Calibration(
        instrument=matrix.instrument,
        date=matrix.date,
        date_end=matrix.date,
        layout=matrix.layout,
        cycle_error=np.full(matrix.layout.n, np.nan),
        shapes_used=len(facts.elastic_modes.values),
        sources=_matrix_source(matrix, facts),
        imbalances=imbalances,
        matrix_facts=symmetry,
        halves=spread(_halves(imbalances, n), on),
        **_numbers_of(estimate, on),
    )


def _halves(imbalances: Imbalances, n: int) -> Array:
    """Return (n,) the relative difference of alpha of the two halves of the modes."""
    fitted = [line.alpha for line in imbalances[1:] if line.alpha is not None]
    if [each.size for each in fitted] != [n, n]:
        return np.full(n, np.nan)
    one, other = (each / each.mean() for each in fitted)
    return np.asarray(one - other)


def _matrix_source(
    matrix: StiffnessMatrix | None, facts: MatrixFacts | None = None
) -> tuple[Source, ...]:
    """Return the file of a matrix, if it has one, with the number of its elastic modes as rows."""
    if matrix is None or matrix.source is None:
        return ()
    modes = len((facts or MatrixFacts.of(matrix)).elastic_modes.values)
    return (replace(matrix.source, file=Path(matrix.source.file).name, rows=modes),)


def _numbers_of(estimate: Estimate, on: NDArray[np.bool_]) -> dict[str, Any]:
    """Return the fields of a calibration that an estimate determines, for all actuators, (n,)."""
    n, reading = int(on.sum()), estimate.reading_covariance
    systematic = estimate.systematic_covariance
    return {
        **attributes(estimate, *(each.name for each in fields(EstimateFacts))),
        "scale": str(estimate.scale),
        "alpha": spread(estimate.values[:n], on),
        "statistical_error": spread(np.sqrt(np.diag(reading)[:n]), on),
        "systematic_error": spread(np.sqrt(np.diag(systematic)[:n]), on),
        "covariance": spread_covariance(reading + systematic, on),
        "systematic_covariance": spread_covariance(systematic, on),
    }


def disabled(data: Measured, ids: Sequence[int]) -> Measured:
    """Return data in which excluded actuators are disabled, if the balance allows that.

    Those of a matrix are released (`matrix.screen.released`). One of a campaign is disabled if its
    FORCE never changes; otherwise its force is part of the balance, and its alpha is fitted.
    """
    if not ids:
        return data
    if isinstance(data, StiffnessMatrix):
        return replace(data, layout=_disable(data.layout, np.isin(data.layout.id, ids)))
    out = np.isin(data.layout.id, ids)
    for cycle in data.cycles:
        out &= np.ptp(cycle.force[cycle.valid], axis=0) == 0.0
    if not out.any():
        return data
    cycles = tuple(replace(c, layout=_disable(c.layout, out)) for c in data.cycles)
    matrix = data.stiffness and replace(data.stiffness, layout=_disable(data.stiffness.layout, out))
    return replace(data, cycles=cycles, stiffness=matrix)


def _without(calibration: Calibration, ids: Sequence[int]) -> Calibration:
    """Return a calibration without alpha of some actuators, by their IDs."""
    layout = calibration.layout
    out = np.isin(layout.id, ids) & layout.enabled
    if not out.any():
        return calibration
    names = ("alpha", "statistical_error", "systematic_error", "cycle_error", "halves")
    values = attributes(calibration, *names)
    changed: dict[str, Any] = {
        k: np.where(out, np.nan, v) for k, v in values.items() if v is not None
    }
    for name in ("covariance", "systematic_covariance"):
        matrix = np.array(getattr(calibration, name))
        matrix[: layout.n][out] = np.nan
        matrix[:, : layout.n][:, out] = np.nan
        changed[name] = matrix
    return replace(calibration, layout=_disable(layout, out), **changed)


def _disable(layout: Layout, out: NDArray[np.bool_]) -> Layout:
    return replace(layout, enabled=layout.enabled & ~out)
