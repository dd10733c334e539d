"""The numbers of an estimate where a calibration keeps them, spread over all actuators."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from truenewton.arrays import Array, spread, spread_covariance
from truenewton.calibration.result import Calibration
from truenewton.estimation.findings.estimate import Estimate, with_warnings
from truenewton.estimation.matrix import modes as matrix_modes
from truenewton.estimation.matrix.coherent_imbalance import doubts_of_balance
from truenewton.estimation.matrix.facts import doubts_of, matrix_facts
from truenewton.records.source import Source
from truenewton.records.stiffness_matrix import StiffnessMatrix
from truenewton.statics.arms import comparable_arms

Imbalances = tuple[matrix_modes.Imbalance, ...]


def from_stiffness(
    matrix: StiffnessMatrix, estimate: Estimate, imbalances: Imbalances
) -> Calibration:
    """Return an estimate from a stiffness matrix as a calibration."""
    on = matrix.layout.enabled
    n = int(on.sum())
    alpha, gain = estimate.values[:n], None
    if estimate.sensors:
        gain = np.array([each.gain if each.state == "fitted" else 1.0 for each in estimate.sensors])
    k, arms, ids = matrix.used_stiffness, comparable_arms(matrix.layout), matrix.layout.id[on]
    facts, covariance = matrix_facts(k, alpha, gain), estimate.reading_covariance[:n, :n]
    of_balance, covariance = doubts_of_balance(k, arms, alpha, covariance, ids)
    estimate = with_warnings(estimate, (*doubts_of(k, alpha, facts), *of_balance))
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
        shapes_used=len(matrix_modes.elastic_modes(matrix)),
        rejected=0,
        invalid=0,
        sources=matrix_source(matrix),
        effects=estimate.effects,
        imbalances=imbalances,
        matrix_facts=facts,
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


def matrix_source(matrix: StiffnessMatrix | None) -> tuple[Source, ...]:
    """Return the file of a matrix, its elastic modes for rows; nothing where it has none."""
    if matrix is None or matrix.source is None:
        return ()
    modes = len(matrix_modes.elastic_modes(matrix))
    return (replace(matrix.source, file=Path(matrix.source.file).name, rows=modes),)


def common(estimate: Estimate, on: NDArray[np.bool_]) -> dict[str, Any]:
    """Return what is the same for all data, spread over all actuators, (n,)."""
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
