"""From data to a calibration: one door to all methods, and the numbers where they belong."""

from __future__ import annotations

import datetime
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import NamedTuple, overload

import numpy as np

from truenewton.arrays import Array, spread
from truenewton.calibration.numbers import (
    Imbalances,
    common,
    disabled,
    from_stiffness,
    matrix_source,
    require_known,
    without,
)
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
from truenewton.estimation.findings.estimate import Diagnosis, Estimate, with_warnings
from truenewton.estimation.findings.finding import Finding, distinct
from truenewton.estimation.findings.scale_budget import typical
from truenewton.estimation.matrix import ml as matrix_ml
from truenewton.estimation.matrix import modes as matrix_modes
from truenewton.estimation.matrix.screen import ScreenedMatrix, screen_matrix
from truenewton.estimation.paper import svd as paper_svd
from truenewton.estimation.paper.cycle_errors import CycleErrors
from truenewton.estimation.paper.equations import Unknowns
from truenewton.estimation.paper.identifiability import diagnose
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
from truenewton.linalg import threads
from truenewton.progress import kept_as, tell
from truenewton.records.campaign import Campaign, mean_temperature
from truenewton.records.parts import Parts, has_parts
from truenewton.records.segmented import SegmentedData, segment_couplings
from truenewton.records.source import Source
from truenewton.records.stiffness_matrix import StiffnessMatrix
from truenewton.rounding import percent
from truenewton.statics.layout import Layout

Data = Campaign | StiffnessMatrix | SegmentedData
Seen = Array | Mapping[int, Array]  # by sensors: by those of all segments, or of each by its number


class Known(NamedTuple):
    """What is known beside the data, as `calibrate` takes it."""

    population: bool = False
    motion: Array | None = None


class Method(NamedTuple):
    """A method: of a screened campaign to its estimate; of a stiffness, with what modes leave."""

    of_cycles: Callable[[ScreenedCampaign, Known], Estimate]
    of_stiffness: Callable[[ScreenedMatrix, Known], tuple[Estimate, Imbalances]]


def _svd_of_cycles(screened: ScreenedCampaign, _: Known) -> Estimate:
    """Solve the paper's system, of all rows; what the data are worth `ml` says, as for itself."""
    judged = campaign_ml.find(screened)
    campaign = screened.campaign
    moments = campaign_moments(campaign) if screened.rejected else screened.moments
    found = paper_svd.find(campaign, moments)
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
    return _with_imbalances(screened, method, matrix_modes.find(screened, method))


def _with_imbalances(
    screened: ScreenedMatrix, method: matrix_modes.ElasticMethod, estimate: Estimate
) -> tuple[Estimate, Imbalances]:
    """Return an estimate, which says so where halves give no alpha, and how modes balance."""
    try:
        return estimate, matrix_modes.imbalances(screened, method, estimate.values)
    except (RankDeficient, NotConverged) as error:
        alone = Finding.of(Code.HALVES_INSUFFICIENT, fault=error.fault, remedy=error.remedy)
        return with_warnings(estimate, (alone,)), ()


def _reciprocal(screened: ScreenedMatrix, known: Known) -> tuple[Estimate, Imbalances]:
    """Return the estimate of reciprocity, and what speaks against it."""
    base = matrix_modes.find(screened, matrix_ml.column_fit)
    with advising_ml():
        estimate, of_modes, against = reciprocity_of_matrix.find(screened, base, known.motion)
    return with_warnings(estimate, doubts(against)), of_modes


def _where_reciprocity_holds(screened: ScreenedMatrix, known: Known) -> tuple[Estimate, Imbalances]:
    """Return the estimate of reciprocity, or that of `ml` with the reason.

    That of `ml` comes first, for whoever does not want to wait.
    """
    base = matrix_modes.find(screened, matrix_ml.column_fit)

    def of_balance(against: Iterable[Finding]) -> tuple[Estimate, Imbalances]:
        told = with_warnings(base, instead(against))
        return _with_imbalances(screened, matrix_ml.column_fit, told)

    tell(_in_short(base), keep=lambda: of_balance([Finding.of(Code.INTERRUPTED)]))
    try:
        estimate, of_modes, against = reciprocity_of_matrix.find(
            screened, base, known.motion, where_it_holds=True
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
        lambda screened, known: campaign_ml.find(screened, known.population),
        lambda screened, known: _by_balance(
            screened, partial(matrix_ml.column_fit, population=known.population)
        ),
    ),
    "svd": Method(
        _svd_of_cycles, lambda screened, _: _by_balance(screened, matrix_modes.singular_fit)
    ),
    "reciprocity": Method(
        lambda screened, known: reciprocity_of_campaign.find(screened, known.motion), _reciprocal
    ),
    "auto": Method(
        lambda screened, known: reciprocity_of_campaign.find(
            screened, known.motion, where_it_holds=True
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
def calibrate(
    data: Data,
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
        A campaign under two loads at least, or a measured stiffness matrix (relative alpha); of a
        mirror in several segments each is calibrated by itself.
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
        A `dask.distributed.Client`, which ``read`` was given as well (docs/cluster.md).
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
    if not isinstance(data, Data):
        raise TypeError(
            f"cannot calibrate a {type(data).__name__}; give a Campaign, StiffnessMatrix or"
            " SegmentedData"
        )
    method, known = asked(data, method, population=population, motion=motion)
    ids = sorted(set(exclude))
    require_known(data.layout, ids)
    if has_parts(data):
        one = partial(calibrate, method=method, population=population, client=client)
        of_all = _of_segments(data, one, motion, ids, 1 if client is not None else processes)
        warn_of(of_all)
        return of_all
    left = disabled(data, ids)
    if isinstance(left, Campaign):
        estimate = METHODS[method].of_cycles(screen_campaign(left, client), known)
        made = without(calibration_of(left, estimate, client=client), ids)
    else:
        made = _of_matrix(left, method, known, ids)
    warn_of(made)
    return made


def _of_matrix(
    matrix: StiffnessMatrix, method: str, known: Known, excluded: Sequence[int]
) -> Calibration:
    """Calibrate; what is found before the end can be kept as a calibration, too."""

    def made_of(found: tuple[Estimate, Imbalances]) -> Calibration:
        return without(from_stiffness(screened, *found), excluded)

    try:
        with threads(1), kept_as(made_of):
            screened = screen_matrix(matrix)
            found = METHODS[method].of_stiffness(screened, known)
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


def asked(
    data: Data,
    method: str | None,
    *,
    population: bool,
    motion: Seen | None,
) -> tuple[str, Known]:
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
        return method, Known(population)
    return method, Known(population, motion)


def estimate_alpha(screened: ScreenedCampaign, method: str, known: Known) -> Estimate:
    """Find alpha of a campaign that was screened, as `calibrate` does; 'ml' reads no row."""
    return METHODS[method].of_cycles(screened, known)


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
