"""What the calibration buys: modes and their number with and without it, beside the true ones."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from truenewton.arrays import Array
from truenewton.bench.simulated.truth import Truth
from truenewton.estimation.readings.repeats import read_rows
from truenewton.estimation.screening.screen import screen_campaign
from truenewton.modal.findings import ModalFindings, compare_modes
from truenewton.modal.measured_stiffness import motion_reader
from truenewton.modal.modal_base import Budget, Dissipation, ModalBase, dissipation, modal_base
from truenewton.modal.true_stiffness import static_force, true_stiffness
from truenewton.records.campaign import Campaign
from truenewton.records.stiffness_matrix import StiffnessMatrix

Three = tuple[float, float, float]
SHARES = np.linspace(0.05, 0.95, 19)  # of the range of a limit


@dataclass(frozen=True)
class ModesScore:
    """How far from the truth one gets.

    Each with alpha = 1 and the measured stiffness made symmetric; with its right singular vectors
    for the modes, as observatories have them; and calibrated.

    Attributes
    ----------
    distance
        Of the stiffness modes from the true ones [rad], see `compare_modes`.
    power_number, force_number
        Mean error of the number of modes within a limit of power or force, over limits from 5 to
        95 % of the range between the first mode and all.
    """

    distance: Three
    power_number: Three
    force_number: Three


def true_base(campaign: Campaign, found: ModalFindings, truth: Truth) -> ModalBase:
    """Return the modal base that true alpha and true stiffness give, the rest as measured."""
    matrix = StiffnessMatrix(
        campaign.instrument,
        found.after.matrix.date,
        campaign.layout,
        truth.stiffness / truth.alpha[:, None],
    )
    calibration = replace(found.calibration, alpha=truth.alpha)
    stiffness = true_stiffness(matrix, calibration)
    reader = motion_reader(screen_campaign(campaign))
    read_rows(campaign, (reader.take,))
    static = static_force(stiffness, calibration, reader.force_at_rest)
    efficiency = found.after.costs[0].efficiency
    return modal_base(matrix, stiffness, stiffness.modes, found.after.seen, static, efficiency)


def score_modes(campaign: Campaign, found: ModalFindings, truth: Truth) -> ModesScore:
    """Compare what was found of the modes with the truth; all actuators commanded."""
    true = true_base(campaign, found, truth)
    costs = (found.before.costs[0], _singular(campaign, found), found.after.costs[0])
    power, force = (
        [
            [abs(cost.modes_within(limit) - true.costs[0].modes_within(limit)) for limit in limits]
            for cost in costs
        ]
        for limits in (
            [Budget(power=p) for p in _levels(true.costs[0].power)],
            [Budget(force=f) for f in _levels(true.costs[0].reach)],
        )
    )
    apart = (compare_modes(true.modes.modes, c.modes, true.modes.stiffness) for c in costs)
    return ModesScore(
        _three(each.distance for each in apart),
        _three(float(np.mean(errors)) for errors in power),
        _three(float(np.mean(errors)) for errors in force),
    )


def _singular(campaign: Campaign, found: ModalFindings) -> Dissipation:
    """Return what the right singular vectors cost, by the stiffness as measured."""
    if found.measured is None or found.after.modes.stiffness.size != campaign.layout.n:
        raise ValueError("give the campaign, with all actuators on, and what was found of it")
    base, matrix = found.before, found.measured.matrix.stiffness
    cost = base.costs[0]
    assert base.seen is not None  # as it costs something
    return dissipation(
        "singular vectors",
        np.linalg.svd(matrix)[2][::-1].T,
        replace(base.stiffness, acting_stiffness=matrix),
        base.seen,
        cost.static,
        cost.efficiency,
    )


def _three(values: Iterable[float]) -> Three:
    one, two, three = map(float, values)
    return one, two, three


def _levels(values: Array) -> Array:
    """Return limits across the range of the worst actuator, from the first mode to all."""
    worst = values.max(axis=0)
    return np.asarray(worst[0] + SHARES * (worst[-1] - worst[0]))
