"""From data to a calibration: one door to all methods, and the numbers where they belong."""

from __future__ import annotations

import datetime
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple, overload

import numpy as np
from numpy.typing import NDArray

from truenewton.arrays import Array, spread, spread_covariance
from truenewton.calibration.result import AnyCalibration, Calibration
from truenewton.calibration.verdict import warn_of
from truenewton.calibration.workers import executor_for
from truenewton.cluster import Client
from truenewton.errors import (
    Fault,
    NotConverged,
    RankDeficient,
    TrueNewtonError,
    UnknownName,
    located,
)
from truenewton.estimation import campaign_ml
from truenewton.estimation.findings.code import Code
from truenewton.estimation.findings.estimate import Diagnosis, Estimate, typical, with_warnings
from truenewton.estimation.findings.finding import Finding, distinct
from truenewton.estimation.matrix import modes as matrix_modes
from truenewton.estimation.matrix.coherent_imbalance import doubts_of_balance
from truenewton.estimation.matrix.facts import MatrixFacts, doubts_of, symmetry_of
from truenewton.estimation.matrix.screen import ScreenedMatrix, screen_matrix
from truenewton.estimation.paper import svd as paper_svd
from truenewton.estimation.paper.equations import Unknowns
from truenewton.estimation.paper.identifiability import diagnose
from truenewton.estimation.paper.svd import CycleErrors
from truenewton.estimation.readings.row_readers import RowReader
from truenewton.estimation.reciprocity import campaign as reciprocity_of_campaign
from truenewton.estimation.reciprocity import matrix as reciprocity_of_matrix
from truenewton.estimation.reciprocity.acceptance import advising_ml, doubts, failed, instead
from truenewton.estimation.screening.noise import MIN_FIT_PROBABILITY
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
from truenewton.records.parts import Parts, has_parts
from truenewton.records.reader import AnyPath, Measured, measured_from
from truenewton.records.segmented import SegmentedData, segment_couplings
from truenewton.records.stiffness_matrix import StiffnessMatrix
from truenewton.rounding import named, percent
from truenewton.statics.layout import Layout

Data = Measured
Seen = Array | Mapping[int, Array]  # by sensors: by those of all segments, or of each by its number


class Options(NamedTuple):
    """Options of `calibrate` that some methods use."""

    population: bool = False
    motion: Array | None = None


class Method(NamedTuple):
    """A method: of a screened campaign to its estimate; of a stiffness, with what modes leave."""

    of_cycles: Callable[[ScreenedCampaign, Options], Estimate]
    of_stiffness: Callable[[ScreenedMatrix, Options], tuple[Estimate, Imbalances]]


def _svd_of_cycles(screened: ScreenedCampaign, _: Options) -> Estimate:
    """Solve the paper's system, of all rows; what the data are worth `ml` says, as for itself."""
    judged = campaign_ml.fit_campaign(screened)
    campaign = screened.campaign
    moments = campaign_moments(campaign) if screened.rejected else screened.moments
    found = paper_svd.solve_campaign(campaign, moments)
    effects = tuple(replace(effect, corrected=False) for effect in judged.effects)
    warnings = distinct((*found.diagnosis.warnings, *judged.diagnosis.warnings))
    if judged.rejected:
        warnings += (Finding.of(Code.SVD_USES_ALL_ROWS, count=len(judged.rejected)),)
    diagnosis = replace(found.diagnosis, warnings=warnings)
    fit = judged.goodness  # of `ml`: told where no alpha balances the data
    goodness = fit if fit is not None and fit.probability < MIN_FIT_PROBABILITY else None
    return replace(found, effects=effects, diagnosis=diagnosis, goodness=goodness)


def _by_balance(
    screened: ScreenedMatrix, method: matrix_modes.ElasticMethod
) -> tuple[Estimate, Imbalances]:
    """Return the estimate of a method that balances forces, and how well it does."""
    return _with_imbalances(screened, method, matrix_modes.fit_balance(screened, method))


def _with_imbalances(
    screened: ScreenedMatrix, method: matrix_modes.ElasticMethod, estimate: Estimate
) -> tuple[Estimate, Imbalances]:
    """Return an estimate, which says so where halves give no alpha, and how modes balance."""
    try:
        return estimate, matrix_modes.imbalances(screened, method, estimate.values)
    except (RankDeficient, NotConverged) as error:
        alone = Finding.of(Code.HALVES_INSUFFICIENT, fault=error.fault, remedy=error.remedy)
        return with_warnings(estimate, (alone,)), ()


def _reciprocal(screened: ScreenedMatrix, options: Options) -> tuple[Estimate, Imbalances]:
    """Return the estimate of reciprocity, and what speaks against it."""
    base = matrix_modes.fit_balance(screened, matrix_modes.column_fit)
    with advising_ml():
        estimate, of_modes, against = reciprocity_of_matrix.fit_matrix(
            screened, base, options.motion
        )
    return with_warnings(estimate, doubts(against)), of_modes


def _where_reciprocity_holds(
    screened: ScreenedMatrix, options: Options
) -> tuple[Estimate, Imbalances]:
    """Return the estimate of reciprocity, or that of `ml` with the reason.

    That of `ml` comes first, for whoever does not want to wait.
    """
    base = matrix_modes.fit_balance(screened, matrix_modes.column_fit)

    def of_balance(against: Iterable[Finding]) -> tuple[Estimate, Imbalances]:
        told = with_warnings(base, instead(against))
        return _with_imbalances(screened, matrix_modes.column_fit, told)

    report_progress(_in_short(base), keep=lambda: of_balance([Finding.of(Code.INTERRUPTED)]))
    try:
        estimate, of_modes, against = reciprocity_of_matrix.fit_matrix(
            screened, base, options.motion, where_it_holds=True
        )
        if not against:
            return estimate, of_modes
    except (RankDeficient, NotConverged) as error:
        against = (failed(error),)
    return of_balance(against)


def _in_short(base: Estimate) -> str:
    """Return the alpha of an estimate of `ml` and its error, in words."""
    alpha = base.values[: len(base.reading_covariance)]
    error = typical(np.sqrt(np.diag(base.reading_covariance)), alpha)
    return (
        f"by the balance of forces alone (ml): alpha {alpha.min():.3g} .. {alpha.max():.3g},"
        f" typical error {percent(error)}"
    )


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


@overload
def calibrate(
    data: Campaign | StiffnessMatrix, method: str | None = None, *, population: bool = False,
    motion: Array | None = None, exclude: Collection[int] = (), client: Client | None = None,
    processes: int | None = None,
) -> Calibration: ...  # fmt: skip
@overload
def calibrate(
    data: SegmentedData, method: str | None = None, *, population: bool = False,
    motion: Seen | None = None, exclude: Collection[int] = (), client: Client | None = None,
    processes: int | None = None,
) -> Parts[Calibration]: ...  # fmt: skip
@overload
def calibrate(
    data: Data | AnyPath | Iterable[AnyPath | Cycle], method: str | None = None, *,
    population: bool = False, motion: Seen | None = None, exclude: Collection[int] = (),
    client: Client | None = None, processes: int | None = None,
) -> AnyCalibration: ...  # fmt: skip
def calibrate(
    data: Data | AnyPath | Iterable[AnyPath | Cycle],
    method: str | None = None,
    *,
    population: bool = False,
    motion: Seen | None = None,
    exclude: Collection[int] = (),
    client: Client | None = None,
    processes: int | None = None,
) -> AnyCalibration:
    """Find alpha of every actuator.

    Parameters
    ----------
    data
        A campaign under two loads at least, or a measured stiffness matrix (relative alpha), or a
        path, paths or cycles. Segments of a mirror are calibrated separately.
    method
        'ml', maximum likelihood; 'svd', the paper's; 'reciprocity', which makes use of what the
        sensors read; 'auto', reciprocity where it holds, else 'ml', which the verdict notes. Unless
        given, 'auto' of a matrix and with ``motion``, else 'ml' (docs/decisions.md, 21).
    population
        Take the actuators for samples of one normal population of unknown spread: pulls what the
        data hardly hold toward the mean. With 'ml' only; the result names it.
    motion
        (6, n, n) what the sensors see of the glass, from `sensor_model`; or (n, n)
        displacements where forces act for those seen; of several segments, also {number: that of
        each}. With 'reciprocity' and 'auto' only.
    exclude
        IDs of actuators whose alpha is not wanted, as of channels that are known to be bad. Those
        of a matrix are released: the others are seen in states in which these push nothing.
    client
        A `dask.distributed.Client`, which ``read`` was given as well (docs/campaign.md).
    processes
        How many segments are calibrated at once, each in a process of its own; unless given, as
        many as there are processors, or one where segments are small or there is a client.

    Raises
    ------
    RankDeficient
        The data cannot fix alpha, of no segment; the message says what is missing.
    TooManyOutliers, NotConverged
        The data do not fit together.
    UnknownName, TypeError
        There is no such method, or it takes no such data.

    Warns
    -----
    TrueNewtonWarning
        The verdict is 'rejected' or 'doubtful'.

    Examples
    --------
    >>> tn.calibrate(campaign)
    <Calibration of P45: 45 actuators, alpha 0.715 .. 1.1, typical error 0.016, ...>
    """
    data = measured_from(data, client)
    method, options = resolve_method(data, method, population=population, motion=motion)
    ids = sorted(set(exclude))
    require_known(data.layout, ids)
    if has_parts(data):
        one = partial(calibrate, method=method, population=population, client=client)
        of_all = _of_segments(data, one, motion, ids, 1 if client is not None else processes)
        warn_of(of_all)
        return of_all
    left = disabled(data, ids)
    if isinstance(left, Campaign):
        estimate = METHODS[method].of_cycles(screen_campaign(left, client), options)
        made = without(calibration_of(left, estimate, client=client), ids)
    else:
        made = _of_matrix(left, method, options, ids)
    warn_of(made)
    return made


def _of_matrix(
    matrix: StiffnessMatrix, method: str, options: Options, excluded: Sequence[int]
) -> Calibration:
    """Calibrate; what is found before the end can be kept as a calibration, too."""

    def made_of(found: tuple[Estimate, Imbalances]) -> Calibration:
        return without(from_stiffness(screened, *found), excluded)

    try:
        with threads(1), kept_as(made_of):
            screened = screen_matrix(matrix)
            found = METHODS[method].of_stiffness(screened, options)
    except (RankDeficient, NotConverged) as error:
        raise located(error, matrix.source and Path(matrix.source.file).name) from None
    return made_of(found)


def _of_segments(
    data: SegmentedData,
    solve: Callable[..., Calibration],
    motion: Seen | None,
    excluded: Sequence[int],
    processes: int | None,
) -> Parts[Calibration]:
    """Calibrate each segment by itself; one whose stiffness is coupled to others says so."""

    def solver(number: int) -> Callable[[Campaign | StiffnessMatrix], Calibration]:
        seen = seen_of(motion, data.layout, number)
        return partial(solve, motion=seen, exclude=data.own(number, excluded))

    made = data.solved(solver, "alpha", executor_for(data.layout, processes))
    found = dict(made.found)
    couplings = {} if data.stiffness is None else segment_couplings(data.stiffness)
    for number, (size, own) in couplings.items():
        if number in found:
            diagnosis = found[number].diagnosis or Diagnosis()
            coupled = Finding.of(Code.SEGMENTS_COUPLED, size=size, own=own)
            diagnosis = replace(diagnosis, warnings=(*diagnosis.warnings, coupled))
            found[number] = replace(found[number], diagnosis=diagnosis)
    return replace(made, found=found)


def seen_of(motion: Seen | None, layout: Layout, number: int) -> Array | None:
    """Return what the sensors of one segment see, (6, k, k) or (k, k) of its k actuators."""
    if motion is None or isinstance(motion, Mapping):
        return None if motion is None else motion[number]
    own = np.asarray(layout.segment) == number
    return np.asarray(motion[..., own, :][..., own])


def resolve_method(
    data: Data,
    method: str | None,
    *,
    population: bool,
    motion: Seen | None,
) -> tuple[str, Options]:
    """Return the method that is asked for, as of `calibrate`, and what it is told.

    ``motion`` is (6, n, n) or (n, n). Raises UnknownName where there is no such method, or it takes
    no such data.
    """
    if method is None:
        tried = isinstance(data, StiffnessMatrix) or motion is not None
        method = "auto" if tried and not population else "ml"
    if method not in METHODS:
        raise UnknownName(
            f"there is no method '{method}'", remedy=f"choose {', '.join(METHODS)}", got=method
        )
    if population and method not in ("ml", "svd"):
        raise UnknownName("a population goes with ml only", remedy="use ml", got=method)
    both = not isinstance(data, StiffnessMatrix) and data.cycles and data.stiffness
    if method == "svd" and (population or both):
        raise UnknownName(
            "svd takes neither a population nor a stiffness matrix beside cycles", remedy="use ml"
        )
    if motion is not None and method in ("ml", "svd"):
        raise UnknownName(
            f"{method} does not ask what the sensors see of the glass",
            remedy="leave the mirror out, or use reciprocity or auto",
            got=method,
        )
    if isinstance(motion, Mapping) and not has_parts(data):
        raise UnknownName(
            "motion is given by segment, and the data are of a mirror in one piece",
            remedy="give the (6, n, n) or (n, n) motion of that mirror",
            got=sorted(motion),
        )
    if isinstance(motion, Mapping):  # for segments, each of which is asked on its own
        return method, Options(population)
    return method, Options(population, motion)


def estimate_alpha(screened: ScreenedCampaign, method: str, options: Options) -> Estimate:
    """Find alpha of a campaign that was screened, as `calibrate` does; 'ml' reads no row."""
    return METHODS[method].of_cycles(screened, options)


def refusals(error: TrueNewtonError, screened: ScreenedCampaign | None) -> tuple[Fault, ...]:
    """Return why there is no alpha, first what the error says, then what else is missing."""
    first = Fault(error.fault, error.remedy)
    if screened is None or not isinstance(error, RankDeficient):
        return (first,)
    others = diagnose(screened.sound, screened.moments).faults
    return first, *(Fault(x.fault, x.remedy) for x in others if x.fault != error.fault)


def calibration_of(
    campaign: Campaign,
    estimate: Estimate,
    readers: Sequence[RowReader] = (),
    client: Client | None = None,
) -> Calibration:
    """Return an estimate as a calibration; the rows are read for E_CYCLE, and for more readers."""
    layout, cycles, on = campaign.layout, campaign.cycles, campaign.layout.enabled
    unknowns = Unknowns(int(on.sum()), len(campaign.loads))
    torques = estimate.values[unknowns.torques].reshape(-1, 2)
    lost = [sum(row.cycle == k for row in estimate.rejected) for k in range(len(cycles))]
    cycle_errors = CycleErrors(campaign, estimate.values)
    cycle_errors.read(readers, client)
    return Calibration(
        instrument=campaign.instrument,
        date=min(c.date for c in cycles),
        date_end=max(
            c.date + datetime.timedelta(seconds=float(c.time[c.valid].max())) for c in cycles
        ),
        layout=layout,
        loads=campaign.loads,
        cycle_error=spread(cycle_errors.errors, on),
        bias_force=float(estimate.values[unknowns.bias]),
        torque_y=torques[:, 0],
        torque_x=torques[:, 1],
        weight=campaign.weight,
        weight_error=campaign.weight_error,
        temperature=mean_temperature(cycles),
        shapes_used=sum(int(c.valid.sum()) for c in cycles) - len(estimate.rejected),
        rejected=len(estimate.rejected),
        invalid=sum(int((~c.valid).sum()) for c in cycles),
        sources=tuple(
            Source(Path(c.source.file).name, c.source.sha256, int(c.valid.sum()) - less, less)
            for c, less in zip(cycles, lost, strict=True)
            if c.source
        )
        + matrix_source(campaign.stiffness),
        rejected_rows=estimate.rejected,
        effects=estimate.effects,
        unseen=estimate.unseen,
        **common(estimate, on),
    )


Imbalances = tuple[matrix_modes.Imbalance, ...]


def from_stiffness(
    screened: ScreenedMatrix, estimate: Estimate, imbalances: Imbalances
) -> Calibration:
    """Return an estimate from a stiffness matrix as a calibration."""
    matrix, facts = screened.matrix, screened.facts
    on = matrix.layout.enabled
    n = int(on.sum())
    alpha, gain = estimate.values[:n], None
    if estimate.sensors:
        gain = np.array([each.gain if each.state == "fitted" else 1.0 for each in estimate.sensors])
    ids, covariance = matrix.layout.id[on], estimate.reading_covariance[:n, :n]
    of_balance, covariance = doubts_of_balance(facts, alpha, covariance, ids)
    symmetry = symmetry_of(facts, alpha, gain)
    of_symmetry = doubts_of(facts.stiffness, alpha, symmetry)
    estimate = with_warnings(estimate, (*of_symmetry, *of_balance))
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
        loads=(),
        cycle_error=np.full(matrix.layout.n, np.nan),
        bias_force=float("nan"),
        torque_y=np.empty(0),
        torque_x=np.empty(0),
        weight=float("nan"),
        weight_error=float("nan"),
        temperature=float("nan"),
        shapes_used=len(facts.elastic_modes.values),
        rejected=0,
        invalid=0,
        sources=matrix_source(matrix, facts),
        effects=estimate.effects,
        imbalances=imbalances,
        matrix_facts=symmetry,
        halves=spread(_halves(imbalances, n), on),
        **common(estimate, on),
    )


def _halves(imbalances: Imbalances, n: int) -> Array:
    """Return (n,) how far alpha of one half of the modes is above that of the other, relative."""
    fitted = [line.alpha for line in imbalances[1:] if line.alpha is not None]
    if [each.size for each in fitted] != [n, n]:
        return np.full(n, np.nan)
    one, other = (each / each.mean() for each in fitted)
    return np.asarray(one - other)


def matrix_source(
    matrix: StiffnessMatrix | None, facts: MatrixFacts | None = None
) -> tuple[Source, ...]:
    """Return the file of a matrix, its elastic modes for rows; nothing where it has none."""
    if matrix is None or matrix.source is None:
        return ()
    modes = len((facts or MatrixFacts.of(matrix)).elastic_modes.values)
    return (replace(matrix.source, file=Path(matrix.source.file).name, rows=modes),)


def common(estimate: Estimate, on: NDArray[np.bool_]) -> dict[str, Any]:
    """Return what is the same for all data, spread over all actuators, (n,)."""
    n, goodness = int(on.sum()), estimate.goodness
    reading, systematic = estimate.reading_covariance, estimate.systematic_covariance
    return {
        **attributes(estimate, "method", "condition", "solved_condition", "rank", "noise"),
        **attributes(estimate, "diagnosis", "goodness", "scale_errors", "sensors"),
        "scale": estimate.scale.value,
        "alpha": spread(estimate.values[:n], on),
        "reading_error": spread(np.sqrt(np.diag(reading)[:n]), on),
        "systematic_error": spread(np.sqrt(np.diag(systematic)[:n]), on),
        "covariance": spread_covariance(reading + systematic, on),
        "systematic_covariance": spread_covariance(systematic, on),
        "degrees_of_freedom": goodness.degrees_of_freedom if goodness else None,
        "chi2": estimate.declared_chi2,
    }


def require_known(layout: Layout, ids: Collection[int]) -> None:
    """Refuse IDs that no actuator has.

    Raises
    ------
    UnknownName
    """
    unknown = sorted(set(ids) - set(layout.id.tolist()))
    if unknown:
        raise UnknownName(
            f"there is no {named('actuator', unknown, 5)} to exclude",
            remedy=f"IDs run from {layout.id.min()} to {layout.id.max()}",
            got=unknown,
        )


def disabled(data: Campaign | StiffnessMatrix, ids: Sequence[int]) -> Campaign | StiffnessMatrix:
    """Return data in which excluded actuators are disabled, as far as the balance allows.

    Those of a matrix are released (`matrix.screen.released`). One of a campaign is disabled if its
    FORCE never changes; the force of others is part of the balance, and alpha is fitted to it.
    """
    if not ids:
        return data
    if isinstance(data, StiffnessMatrix):
        return replace(data, layout=_without(data.layout, np.isin(data.layout.id, ids)))
    out = np.isin(data.layout.id, ids)
    for cycle in data.cycles:
        out &= np.ptp(np.asarray(cycle.force)[np.asarray(cycle.valid)], axis=0) == 0.0
    if not out.any():
        return data
    cycles = tuple(replace(c, layout=_without(c.layout, out)) for c in data.cycles)
    matrix = data.stiffness
    if matrix is not None:
        matrix = replace(matrix, layout=_without(matrix.layout, out))
    return replace(data, cycles=cycles, stiffness=matrix)


def without(calibration: Calibration, ids: Sequence[int]) -> Calibration:
    """Return a calibration that gives no alpha of some actuators, by their IDs."""
    layout = calibration.layout
    out = np.isin(layout.id, ids) & layout.enabled
    if not out.any():
        return calibration
    names = ("alpha", "reading_error", "systematic_error", "cycle_error", "halves")
    values = {name: getattr(calibration, name) for name in names}
    changed: dict[str, Any] = {
        k: np.where(out, np.nan, v) for k, v in values.items() if v is not None
    }
    for name in ("covariance", "systematic_covariance"):
        matrix = np.array(getattr(calibration, name))
        matrix[: layout.n][out] = np.nan
        matrix[:, : layout.n][:, out] = np.nan
        changed[name] = matrix
    return replace(calibration, layout=_without(layout, out), **changed)


def _without(layout: Layout, out: NDArray[np.bool_]) -> Layout:
    return replace(layout, enabled=layout.enabled & ~out)
