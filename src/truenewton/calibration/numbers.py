"""The numbers of an estimate where a calibration keeps them, spread over all actuators."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from truenewton.arrays import Array, spread, spread_covariance
from truenewton.calibration.result import Calibration
from truenewton.errors import UnknownName
from truenewton.estimation.findings.estimate import Estimate, with_warnings
from truenewton.estimation.matrix import modes as matrix_modes
from truenewton.estimation.matrix.coherent_imbalance import doubts_of_balance
from truenewton.estimation.matrix.facts import MatrixFacts, doubts_of, symmetry_of
from truenewton.estimation.matrix.screen import ScreenedMatrix
from truenewton.files.format import attributes
from truenewton.records.campaign import Campaign
from truenewton.records.source import Source
from truenewton.records.stiffness_matrix import StiffnessMatrix
from truenewton.rounding import named
from truenewton.statics.layout import Layout

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
