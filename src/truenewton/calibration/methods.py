"""From data to a calibration: one door to all methods, and the numbers where they belong."""

from __future__ import annotations

import datetime
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from truenewton.arrays import Array, spread, spread_covariance
from truenewton.calibration.result import Calibration
from truenewton.calibration.verdict import warn_of
from truenewton.cluster import Client
from truenewton.errors import NotConverged, RankDeficient, TrueNewtonError, UnknownName, located
from truenewton.estimation import cycles_ml, cycles_svd, stiffness_ml, stiffness_svd
from truenewton.estimation.cycle_errors import CycleErrors
from truenewton.estimation.effects.words import effect_warnings
from truenewton.estimation.estimate import Estimate, with_warnings
from truenewton.estimation.identifiability import diagnose
from truenewton.estimation.reciprocity import cycles as reciprocity_of_cycles
from truenewton.estimation.reciprocity import matrix as reciprocity_of_matrix
from truenewton.estimation.reciprocity.gate import doubts, instead
from truenewton.estimation.row_readers import RowReader
from truenewton.estimation.sifted import Sifted, campaign_moments, sift
from truenewton.estimation.sifted_matrix import SiftedMatrix, sift_matrix
from truenewton.estimation.structure import FITS
from truenewton.estimation.unknowns import Unknowns
from truenewton.records.campaign import Campaign, mean_temperature
from truenewton.records.fault import Fault
from truenewton.records.source import Source
from truenewton.records.stiffness_matrix import StiffnessMatrix
from truenewton.rounding import counted

Imbalances = tuple[stiffness_svd.Imbalance, ...]


class Known(NamedTuple):
    """What is known beside the data, as `calibrate` takes it."""

    population: bool = False
    motion: Array | None = None


class Method(NamedTuple):
    """A method: of a sifted campaign to its estimate; of a stiffness, with what modes leave."""

    of_cycles: Callable[[Sifted, Known], Estimate]
    of_stiffness: Callable[[SiftedMatrix, Known], tuple[Estimate, Imbalances]]


def _svd_of_cycles(sifted: Sifted, _: Known) -> Estimate:
    """Solve the paper's system, of all rows; what the data are worth `ml` says, as for itself."""
    judged = cycles_ml.find(sifted)
    campaign = sifted.campaign
    moments = campaign_moments(campaign) if sifted.rejected else sifted.moments
    found = cycles_svd.find(campaign, moments)
    effects = tuple(replace(effect, corrected=False) for effect in judged.effects)
    of_effects = {*effect_warnings(judged.effects), *effect_warnings(effects)}
    others = [fault for fault in judged.diagnosis.warnings if fault not in of_effects]
    warnings = (*found.diagnosis.warnings, *effect_warnings(effects), *others)
    if judged.rejected:
        out = counted(judged.rejected, "row")
        rows = f"svd takes all rows, {out} among them that ml leaves out"
        warnings += (Fault(rows, "use ml, or mark as not VALID those that do not belong"),)
    diagnosis = replace(found.diagnosis, warnings=warnings)
    fit = judged.goodness  # of `ml`: told where no alpha balances the data
    goodness = fit if fit is not None and fit.probability < FITS else None
    return replace(found, effects=effects, diagnosis=diagnosis, goodness=goodness)


def _by_balance(
    sifted: SiftedMatrix, method: stiffness_svd.ElasticMethod
) -> tuple[Estimate, Imbalances]:
    """Return the estimate of a method that balances forces, and how well it does."""
    return _with_imbalances(sifted, method, stiffness_svd.find(sifted, method))


def _with_imbalances(
    sifted: SiftedMatrix, method: stiffness_svd.ElasticMethod, estimate: Estimate
) -> tuple[Estimate, Imbalances]:
    """Return an estimate, which says so where halves give no alpha, and how modes balance."""
    try:
        return estimate, stiffness_svd.imbalances(sifted, method)
    except (RankDeficient, NotConverged) as error:
        fault = Fault(f"every second mode alone gives no alpha: {error.fault}", error.remedy)
        return with_warnings(estimate, (fault,)), ()


def _reciprocal(
    sifted: SiftedMatrix, known: Known, *, where_it_holds: bool = False
) -> tuple[Estimate, Imbalances]:
    """Return the estimate of reciprocity; of `ml`, with the reason, only where that is allowed."""
    base = stiffness_svd.find(sifted, stiffness_ml.column_fit)
    try:
        estimate, of_modes, against = reciprocity_of_matrix.find(sifted.matrix, base, known.motion)
    except (RankDeficient, NotConverged) as error:
        if not where_it_holds:
            raise
        against = (Fault(error.fault, error.remedy),)
    else:
        if not (against and where_it_holds):
            return with_warnings(estimate, doubts(against)), of_modes
    base = with_warnings(base, instead(against))
    return _with_imbalances(sifted, stiffness_ml.column_fit, base)


METHODS = {
    "ml": Method(
        lambda sifted, known: cycles_ml.find(sifted, known.population),
        lambda sifted, known: _by_balance(
            sifted, partial(stiffness_ml.column_fit, population=known.population)
        ),
    ),
    "svd": Method(
        _svd_of_cycles, lambda sifted, _: _by_balance(sifted, stiffness_svd.singular_fit)
    ),
    "reciprocity": Method(
        lambda sifted, known: reciprocity_of_cycles.find(sifted, known.motion), _reciprocal
    ),
    "auto": Method(
        lambda sifted, known: reciprocity_of_cycles.find_where_it_holds(sifted, known.motion),
        partial(_reciprocal, where_it_holds=True),
    ),
}


def calibrate(
    data: Campaign | StiffnessMatrix,
    method: str | None = None,
    *,
    population: bool = False,
    motion: Array | None = None,
    client: Client | None = None,
) -> Calibration:
    """Find alpha of every actuator.

    Parameters
    ----------
    data
        A campaign under two loads at least, or a measured stiffness matrix (relative alpha).
    method
        'ml', maximum likelihood; 'svd', the paper's; 'reciprocity', which makes use of what the
        sensors read; 'auto', reciprocity where it holds, else 'ml'. Unless given, 'auto' with
        ``motion``, else 'ml' (docs/decisions/0021).
    population
        Take the actuators for samples of one normal population, whose spread the data give: pulls
        what the data hardly hold toward the mean. With 'ml' only; the result names it.
    motion
        (n, n) displacements where forces act for those that the sensors see, of all actuators, by a
        model of the glass; with 'reciprocity' and 'auto' only.
    client
        A `dask.distributed.Client`, which ``read`` was given as well (docs/cluster.md).

    Raises
    ------
    RankDeficient
        The data cannot fix alpha; the message says what is missing.
    TooManyOutliers, NotConverged
        The data do not fit together.
    UnknownName
        There is no such method, or it takes no such data.
    TypeError
        The data are neither.

    Warns
    -----
    TrueNewtonWarning
        The verdict is 'not to be used', or the data show what was not taken out of them.
    """
    method, known = asked(data, method, population=population, motion=motion)
    if isinstance(data, Campaign):
        estimate = METHODS[method].of_cycles(sift(data, client), known)
        made = calibration_of(data, estimate, client=client)
    elif isinstance(data, StiffnessMatrix):
        try:
            sifted = sift_matrix(data)
            found = METHODS[method].of_stiffness(sifted, known)
        except (RankDeficient, NotConverged) as error:
            raise located(error, data.source and Path(data.source.file).name) from None
        made = _from_stiffness(sifted.matrix, *found)
    else:
        raise TypeError(
            f"cannot calibrate a {type(data).__name__}; give a Campaign or StiffnessMatrix"
        )
    warn_of(made)
    return made


def asked(
    data: Campaign | StiffnessMatrix,
    method: str | None,
    *,
    population: bool,
    motion: Array | None,
) -> tuple[str, Known]:
    """Return the method that is asked for, as of `calibrate`, and what it is told.

    ``motion`` is (n, n). Raises UnknownName where there is no such method, or it takes no such
    data.
    """
    if method is None:
        method = "ml" if motion is None or population else "auto"
    if method not in METHODS:
        raise UnknownName(
            f"there is no method '{method}'", remedy=f"choose {', '.join(METHODS)}", got=method
        )
    if population and method not in ("ml", "svd"):
        raise UnknownName("a population goes with ml only", remedy="use ml", got=method)
    if method == "svd" and (population or (isinstance(data, Campaign) and data.stiffness)):
        raise UnknownName(
            "svd takes neither a population nor a stiffness matrix beside cycles", remedy="use ml"
        )
    if motion is not None and method in ("ml", "svd"):
        raise UnknownName(
            f"{method} does not ask what the sensors see of the glass",
            remedy="leave the mirror out, or use reciprocity or auto",
            got=method,
        )
    return method, Known(population, motion)


def find_alpha(sifted: Sifted, method: str, known: Known) -> Estimate:
    """Find alpha of a campaign that was sifted, as `calibrate` does; 'ml' reads no row."""
    return METHODS[method].of_cycles(sifted, known)


def refusals(error: TrueNewtonError, sifted: Sifted | None) -> tuple[Fault, ...]:
    """Return why there is no alpha, first what the error says, then what else is missing."""
    first = Fault(error.fault, error.remedy)
    if sifted is None or not isinstance(error, RankDeficient):
        return (first,)
    others = [*diagnose(sifted.sound, sifted.moments).faults]
    return first, *(fault for fault in others if fault.fault not in first.fault)


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
    matrix = campaign.stiffness
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
        + (_matrix_source(matrix) if matrix else ()),
        rejected_rows=estimate.rejected,
        effects=estimate.effects,
        unseen=estimate.unseen,
        **_common(estimate, on),
    )


def _from_stiffness(
    matrix: StiffnessMatrix, estimate: Estimate, imbalances: Imbalances
) -> Calibration:
    on = matrix.layout.enabled
    # B is not to be had from elastic forces.
    reading, systematic = (
        np.pad(covariance, (0, 1), constant_values=np.nan)
        for covariance in (estimate.reading_covariance, estimate.systematic_covariance)
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
        shapes_used=len(stiffness_svd.elastic_modes(matrix)),
        rejected=0,
        invalid=0,
        sources=_matrix_source(matrix),
        effects=estimate.effects,
        imbalances=imbalances,
        **_common(estimate, on),
    )


def _matrix_source(matrix: StiffnessMatrix) -> tuple[Source, ...]:
    if matrix.source is None:
        return ()
    modes = len(stiffness_svd.elastic_modes(matrix))
    return (replace(matrix.source, file=Path(matrix.source.file).name, rows=modes),)


def _common(estimate: Estimate, on: NDArray[np.bool_]) -> dict[str, Any]:
    """Return what is the same for all data, spread over all actuators."""
    n, goodness = int(on.sum()), estimate.goodness
    reading, systematic = estimate.reading_covariance, estimate.systematic_covariance
    return {
        "method": estimate.method,
        "scale": estimate.scale.value,
        "alpha": spread(estimate.values[:n], on),
        "reading_error": spread(np.sqrt(np.diag(reading)[:n]), on),
        "systematic_error": spread(np.sqrt(np.diag(systematic)[:n]), on),
        "covariance": spread_covariance(reading + systematic, on),
        "systematic_covariance": spread_covariance(systematic, on),
        "condition": estimate.condition,
        "solved_condition": estimate.solved_condition,
        "rank": estimate.rank,
        "noise": estimate.noise,
        "degrees_of_freedom": goodness.degrees_of_freedom if goodness else None,
        "chi2": estimate.declared_chi2,
        "diagnosis": estimate.diagnosis,
        "goodness": goodness,
        "scale_errors": estimate.scale_errors,
        "sensors": estimate.sensors,
    }
