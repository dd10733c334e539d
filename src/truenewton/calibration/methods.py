"""From data to a calibration: one door to all methods, and the numbers where they belong."""

from __future__ import annotations

import datetime
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from truenewton.arrays import Array, spread
from truenewton.calibration.result import Calibration
from truenewton.errors import UnknownName
from truenewton.estimation import cycles_ml, cycles_svd, stiffness_ml, stiffness_svd
from truenewton.estimation.cycle_errors import cycle_errors
from truenewton.estimation.estimate import Estimate
from truenewton.records.campaign import Campaign
from truenewton.records.fault import Fault
from truenewton.records.source import Source
from truenewton.records.stiffness_matrix import StiffnessMatrix

METHODS = ("ml", "svd")


def calibrate(
    data: Campaign | StiffnessMatrix, method: str = "ml", *, population: bool = False
) -> Calibration:
    """Find alpha of every actuator.

    Parameters
    ----------
    data
        A campaign under two loads at least, or a measured stiffness matrix (relative alpha).
    method
        'ml', maximum likelihood; 'svd', the paper's.
    population
        Take the actuators for samples of one normal population, whose spread the data give: pulls
        what the data hardly hold toward the mean. With 'ml' only; the result names it.

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
    """
    if method not in METHODS:
        raise UnknownName(
            f"there is no method '{method}'", remedy=f"choose {', '.join(METHODS)}", got=method
        )
    if method == "svd" and (population or (isinstance(data, Campaign) and data.stiffness)):
        raise UnknownName(
            "svd takes neither a population nor a stiffness matrix beside cycles", remedy="use ml"
        )
    if isinstance(data, StiffnessMatrix):
        found = stiffness_svd.find(data) if method == "svd" else stiffness_ml.find(data, population)
        return _from_stiffness(data, found)
    if isinstance(data, Campaign):
        found = cycles_svd.find(data) if method == "svd" else cycles_ml.find(data, population)
        return calibration_of(data, found)
    raise TypeError(f"cannot calibrate a {type(data).__name__}; give a Campaign or StiffnessMatrix")


def held_out(
    matrix: StiffnessMatrix, method: str = "ml", *, population: bool = False
) -> tuple[stiffness_svd.Imbalance, ...]:
    """Return how well alpha restores the balance of elastic modes, fitted and held out."""
    if method == "svd":
        return stiffness_svd.imbalances(
            matrix, lambda modes, a: stiffness_svd.balance_modes(modes, a).alpha
        )
    return stiffness_svd.imbalances(
        matrix,
        lambda modes, a: stiffness_ml.likeliest(modes, a, population=population).alpha,
    )


def calibration_of(campaign: Campaign, found: Estimate) -> Calibration:
    """Return what was found of a campaign as a calibration."""
    layout, on = campaign.layout, campaign.layout.enabled
    n = int(on.sum())
    torques = found.values[n + 1 :].reshape(-1, 2)
    start, end, temperature = _times(campaign)
    lost = [
        sum(row.cycle == place for row in found.rejected) for place in range(len(campaign.cycles))
    ]
    warnings = found.diagnosis.warnings + _implausible(found.values[:n])
    matrix = campaign.stiffness
    return Calibration(
        instrument=campaign.instrument,
        date=start,
        date_end=end,
        layout=layout,
        loads=campaign.loads,
        cycle_error=spread(cycle_errors(campaign, found.values), on),
        bias_force=float(found.values[n]),
        torque_y=torques[:, 0],
        torque_x=torques[:, 1],
        weight=campaign.weight,
        weight_error=campaign.weight_error,
        temperature=temperature,
        shapes_used=sum(int(c.valid.sum()) for c in campaign.cycles) - len(found.rejected),
        rejected=len(found.rejected),
        invalid=sum(int((~c.valid).sum()) for c in campaign.cycles),
        sources=tuple(
            Source(Path(c.source.file).name, c.source.sha256, int(c.valid.sum()) - less, less)
            for c, less in zip(campaign.cycles, lost, strict=True)
            if c.source
        )
        + (_matrix_source(matrix) if matrix else ()),
        rejected_rows=found.rejected,
        **_common(replace(found, diagnosis=replace(found.diagnosis, warnings=warnings)), on),
    )


def _from_stiffness(matrix: StiffnessMatrix, found: Estimate) -> Calibration:
    on = matrix.layout.enabled
    # B is not to be had from elastic forces.
    found = replace(
        found,
        reading_covariance=np.pad(found.reading_covariance, (0, 1), constant_values=np.nan),
        systematic_covariance=np.pad(found.systematic_covariance, (0, 1), constant_values=np.nan),
    )
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
        **_common(found, on),
    )


def _matrix_source(matrix: StiffnessMatrix) -> tuple[Source, ...]:
    if matrix.source is None:
        return ()
    modes = len(stiffness_svd.elastic_modes(matrix))
    return (replace(matrix.source, file=Path(matrix.source.file).name, rows=modes),)


def _common(found: Estimate, on: NDArray[np.bool_]) -> dict[str, Any]:
    """Return what is the same for all data, spread over all actuators."""
    n = int(on.sum())
    goodness = found.goodness
    return {
        "method": found.method,
        "scale": found.scale,
        "alpha": spread(found.values[:n], on),
        "reading_error": spread(np.sqrt(np.diag(found.reading_covariance)[:n]), on),
        "systematic_error": spread(np.sqrt(np.diag(found.systematic_covariance)[:n]), on),
        "covariance": _spread_square(found.reading_covariance + found.systematic_covariance, on),
        "systematic_covariance": _spread_square(found.systematic_covariance, on),
        "condition": found.condition,
        "rank": found.rank,
        "noise": found.noise,
        "degrees_of_freedom": goodness.degrees_of_freedom if goodness else None,
        "chi2": found.declared_chi2,
        "diagnosis": found.diagnosis,
        "goodness": goodness,
        "scale_errors": found.scale_errors,
    }


def _implausible(alpha: Array) -> tuple[Fault, ...]:
    """Warn of an alpha that only a slip of a unit or a sign explains."""
    if (alpha <= 0).any():
        return (
            Fault(
                f"alpha is negative for {np.count_nonzero(alpha <= 0)} actuators",
                "check the signs of FORCE, WEIGHT and ADDED: z points up",
            ),
        )
    if not 0.2 < np.median(alpha) < 5.0:
        return (
            Fault(
                f"alpha is about {np.median(alpha):.2g}",
                "check the units of FORCE, WEIGHT and ADDED: they are Newton",
            ),
        )
    return ()


def _spread_square(values: Array, on: NDArray[np.bool_]) -> Array:
    """Put a covariance of enabled actuators and the rest in the order of all, NaN elsewhere."""
    if on.all():
        values.setflags(write=False)  # so that the calibration need not copy it
        return values
    rest = len(values) - int(on.sum())
    kept = np.concatenate([on, np.ones(rest, dtype=bool)])
    out = np.full((kept.size, kept.size), np.nan)
    out[np.ix_(kept, kept)] = values
    return out


def _times(campaign: Campaign) -> tuple[datetime.datetime, datetime.datetime, float]:
    """Return when the rows used begin and end, and their mean temperature."""
    used = [(c, c.time[c.valid]) for c in campaign.cycles if c.valid.any()]
    start = min(c.date for c, _ in used)
    end = max(c.date + datetime.timedelta(seconds=float(time.max())) for c, time in used)
    temperatures = [c.temperature[c.valid] for c, _ in used if c.temperature is not None]
    mean = float(np.concatenate(temperatures).mean()) if temperatures else float("nan")
    return start, end, mean
