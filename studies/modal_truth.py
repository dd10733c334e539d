"""Errors of modes and of their number, with and without calibration, for a known truth."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from truenewton.arrays import Array
from truenewton.bench.simulated.truth import Truth
from truenewton.estimation.screening.screen import screen_campaign
from truenewton.modal.findings import ModalFindings, compare_modes
from truenewton.modal.measured_stiffness import motion_sums
from truenewton.modal.modal_base import Budget, Dissipation, ModalBase, dissipation, modal_base
from truenewton.modal.true_stiffness import static_force, true_stiffness
from truenewton.records.campaign import Campaign
from truenewton.records.stiffness_matrix import StiffnessMatrix

Three = tuple[float, float, float]
FRACTIONS = np.linspace(0.05, 0.95, 19)  # of the range of a limit


@dataclass(frozen=True)
class ModesScore:
    """Errors of modes, estimated in three ways.

    With alpha = 1 and a symmetrised stiffness; with right singular vectors as modes, as used at
    observatories; and calibrated.

    Attributes
    ----------
    distance
        Distance of the stiffness modes from the true ones [rad], see `compare_modes`.
    power_number, force_number
        Mean error of the number of modes within a limit of power or force, over limits from 5 to
        95 % of the range between the first mode and all modes.
    """

    distance: Three
    power_number: Three
    force_number: Three


def true_base(campaign: Campaign, found: ModalFindings, truth: Truth) -> ModalBase:
    """Return the modal base of true alpha and true stiffness; all else is measured."""
    matrix = StiffnessMatrix(
        campaign.instrument,
        found.after.matrix.date,
        campaign.layout,
        truth.stiffness / truth.alpha[:, None],
    )
    calibration = replace(found.calibration, alpha=truth.alpha)
    stiffness = true_stiffness(matrix, calibration)
    sums = motion_sums(screen_campaign(campaign))
    static = static_force(stiffness, calibration, sums.force_at_rest)
    efficiency = found.after.costs[0].efficiency
    return modal_base(matrix, stiffness, stiffness.modes, found.after.seen, static, efficiency)


def score_modes(campaign: Campaign, found: ModalFindings, truth: Truth) -> ModesScore:
    """Compare estimated modes with the truth. All actuators must be enabled."""
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
    """Return the dissipation of the right singular vectors of the measured stiffness."""
    if found.measured is None or found.after.modes.stiffness.size != campaign.layout.n:
        raise ValueError("give the campaign, with all actuators on, and what was found of it")
    base, matrix = found.before, found.measured.matrix.stiffness
    cost = base.costs[0]
    assert base.seen is not None  # because there are costs
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
    """Return limits in the range of the worst actuator, from the first mode to all modes."""
    worst = values.max(axis=0)
    return np.asarray(worst[0] + FRACTIONS * (worst[-1] - worst[0]))
