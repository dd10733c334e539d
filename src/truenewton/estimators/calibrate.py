"""From data to a calibration: check, solve, and put the numbers where they belong."""

from __future__ import annotations

import datetime
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from truenewton.actuators import Array
from truenewton.calibration import Calibration, UsedSource
from truenewton.campaign import Campaign
from truenewton.diagnosis import Diagnosis
from truenewton.errors import RankDeficient, UnknownName
from truenewton.estimators import elastic, svd
from truenewton.identifiability import diagnose, geometry_faults, refuse
from truenewton.measurements import StiffnessMatrix
from truenewton.repeats import row_groups

METHODS = ("svd",)


def calibrate(data: Campaign | StiffnessMatrix, method: str = "svd") -> Calibration:
    """Find alpha of every actuator.

    Parameters
    ----------
    data
        A campaign under two loads at least, or a measured stiffness matrix (relative alpha).
    method
        'svd', the paper's.

    Raises
    ------
    RankDeficient
        The data cannot fix alpha; the message says what is missing.
    UnknownName
        There is no such method.
    TypeError
        The data are neither.
    """
    if method not in METHODS:
        raise UnknownName(
            f"there is no method '{method}'", remedy=f"choose {', '.join(METHODS)}", got=method
        )
    if isinstance(data, StiffnessMatrix):
        return _from_stiffness(data)
    if isinstance(data, Campaign):
        return _from_campaign(data)
    raise TypeError(f"cannot calibrate a {type(data).__name__}; give a Campaign or StiffnessMatrix")


def _from_campaign(campaign: Campaign) -> Calibration:
    diagnosis = diagnose(campaign)
    refuse(diagnosis)
    fit = svd.fit(campaign)
    found = fit.found
    systematic = svd.weight_covariance(campaign, fit)
    scatter = svd.scatter_covariance(campaign, fit)
    layout, loads = campaign.layout, campaign.loads
    on = layout.enabled
    n = int(on.sum())
    torques = found.solution[n + 1 :].reshape(-1, 2)
    start, end, temperature = _times(campaign)
    return Calibration(
        instrument=campaign.instrument,
        date=start,
        date_end=end,
        method="svd",
        scale="weights",
        layout=layout,
        loads=loads,
        alpha=_spread(found.solution[:n], on),
        statistical=_spread(np.sqrt(np.diag(scatter)[:n]), on),
        systematic_error=_spread(np.sqrt(np.diag(systematic)[:n]), on),
        cycle_error=_spread(svd.cycle_errors(campaign, found.solution), on),
        covariance=_spread_square(scatter + systematic, on),
        systematic=_spread_square(systematic, on),
        bias_force=float(found.solution[n]),
        torque_y=torques[:, 0],
        torque_x=torques[:, 1],
        weight=campaign.weight,
        weight_error=campaign.weight_error,
        temperature=temperature,
        shapes_used=sum(int(c.valid.sum()) for c in campaign.cycles),
        rejected=0,
        invalid=sum(int((~c.valid).sum()) for c in campaign.cycles),
        condition=svd.condition_in_units_of_rms(campaign),
        rank=len(found.solution) - diagnosis.undetermined,
        noise=row_groups(campaign).noise,
        degrees_of_freedom=None,
        chi2=float("nan"),
        sources=tuple(
            UsedSource(Path(c.source.file).name, c.source.sha256, int(c.valid.sum()), 0)
            for c in campaign.cycles
            if c.source
        ),
        diagnosis=replace(diagnosis, warnings=_implausible(found.solution[:n])),
    )


def _from_stiffness(matrix: StiffnessMatrix) -> Calibration:
    layout = matrix.layout
    on = layout.enabled
    a = elastic.comparable_arms(matrix)
    faults = geometry_faults(a)
    if faults:
        raise RankDeficient(faults[0][0], remedy=faults[0][1])
    modes = elastic.elastic_modes(matrix)
    found = elastic.balance_modes(modes, a)
    n = int(on.sum())
    unknown = np.full(n + 1, np.nan)  # B is not to be had from elastic forces
    covariance = np.full((n + 1, n + 1), np.nan)
    covariance[:n, :n] = found.covariance
    systematic = np.zeros((n + 1, n + 1))
    systematic[n], systematic[:, n] = unknown, unknown
    source = matrix.source
    return Calibration(
        instrument=matrix.instrument,
        date=matrix.date,
        date_end=matrix.date,
        method="svd",
        scale="mean 1",
        layout=layout,
        loads=(),
        alpha=_spread(found.alpha, on),
        statistical=_spread(np.sqrt(np.diag(found.covariance)), on),
        systematic_error=_spread(np.zeros(n), on),
        cycle_error=np.full(layout.n, np.nan),
        covariance=_spread_square(covariance, on),
        systematic=_spread_square(systematic, on),
        bias_force=float("nan"),
        torque_y=np.empty(0),
        torque_x=np.empty(0),
        weight=float("nan"),
        weight_error=float("nan"),
        temperature=float("nan"),
        shapes_used=len(modes),
        rejected=0,
        invalid=0,
        condition=float(found.singular_values[-1] / found.singular_values[1]),
        rank=n - 1,
        noise=float("nan"),
        degrees_of_freedom=None,
        chi2=float("nan"),
        sources=(UsedSource(Path(source.file).name, source.sha256, len(modes), 0),)
        if source
        else (),
        diagnosis=Diagnosis(
            tuple((found.singular_values**2).tolist()), 0, (), elastic.orientation_warning(matrix)
        ),
    )


def _implausible(alpha: Array) -> tuple[tuple[str, str], ...]:
    """Warn of an alpha that only a slip of a unit or a sign explains."""
    if (alpha <= 0).any():
        return (
            (
                f"alpha is negative for {np.count_nonzero(alpha <= 0)} actuators",
                "check the signs of FORCE, WEIGHT and ADDED: z points up",
            ),
        )
    if not 0.2 < np.median(alpha) < 5.0:
        return (
            (
                f"alpha is about {np.median(alpha):.2g}",
                "check the units of FORCE, WEIGHT and ADDED: they are Newton",
            ),
        )
    return ()


def _spread(values: Array, on: NDArray[np.bool_]) -> Array:
    """Put values of the enabled actuators in the order of all, NaN elsewhere."""
    out = np.full(on.size, np.nan)
    out[on] = values
    return out


def _spread_square(values: Array, on: NDArray[np.bool_]) -> Array:
    """Put a covariance of enabled actuators and the rest in the order of all, NaN elsewhere."""
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
