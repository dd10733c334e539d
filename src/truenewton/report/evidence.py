"""The evidence for a calibration: residuals, balance before and after, singular values.

The imbalance of a row is rho = A (alpha c) + k, three numbers, with the covariance
S = A diag(alpha) Sigma diag(alpha) A' (docs/likelihood.md). In units of its noise it is
(rho' S^-1 rho / 3)^1/2; its rms is 1 if there is nothing but noise.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from truenewton.arrays import Array, spread
from truenewton.calibration.result import Calibration
from truenewton.estimation.findings.estimate import NoiseSource
from truenewton.estimation.matrix.facts import MatrixFacts
from truenewton.estimation.matrix.screen import as_calibrated
from truenewton.estimation.paper.equations import imbalance_covariance, squared_distances
from truenewton.estimation.paper.identifiability import balance_spectrum, centred_means
from truenewton.estimation.problem import problem_of, with_share_in_balance
from truenewton.estimation.readings.moments import chosen_groups
from truenewton.estimation.readings.repeats import row_groups, row_weights
from truenewton.estimation.readings.row_readers import RowBlock
from truenewton.estimation.readings.rows import balanced_rows, is_displaced
from truenewton.estimation.screening.noise import reading_noise
from truenewton.estimation.screening.screen import ScreenedCampaign, without
from truenewton.records.campaign import Campaign
from truenewton.records.stiffness_matrix import StiffnessMatrix
from truenewton.statics.arms import enabled_arms

EQUATIONS = (("force", "mN"), ("torque M_y", "mN m"), ("torque M_x", "mN m"))


@dataclass(frozen=True)
class BalanceLine:
    """An rms imbalance: with alpha = 1, with the calibration, and expected from noise.

    ``what``, ``unit``: 'force, bare' in 'mN'; '' for an imbalance per unit of force. NaN if
    unknown.
    """

    what: str
    unit: str
    before: float
    after: float
    noise: float


@dataclass(frozen=True, eq=False)
class RowResiduals:
    """Imbalance of the N valid rows of a campaign in units of their noise.

    Attributes
    ----------
    cycle, signed_shape
        (N,) index of the cycle in the campaign; SHAPE times SIGN.
    before, after
        (N,) with alpha = 1 and with the calibration.
    kept
        (N,) false for rejected rows.
    """

    cycle: NDArray[np.int64]
    signed_shape: NDArray[np.int64]
    before: Array
    after: Array
    kept: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class ModeResiduals:
    """Rms imbalance of the m elastic modes of a stiffness matrix per unit of force.

    Attributes
    ----------
    stiffness
        (m,) of the modes [N/m].
    before, after
        (m,) with alpha = 1 and with the calibration.
    """

    stiffness: Array
    before: Array
    after: Array


@dataclass(frozen=True, eq=False)
class Evidence:
    """The evidence for a calibration.

    Attributes
    ----------
    residuals
        Of rows or of modes.
    balance
        Imbalance before and after.
    actuator_residual
        (n,) rms over rows of the correction of each actuator's reading that the imbalance implies,
        in units of its noise; NaN if disabled.
    actuator_noise
        (n,) standard deviation of one reading among repeats [N]; NaN without repeats.
    singular_values
        Of the balance, ascending; the first belongs to alpha itself.
    in_noise
        Whether they are in units of noise.
    """

    residuals: RowResiduals | ModeResiduals
    balance: tuple[BalanceLine, ...]
    actuator_residual: Array
    actuator_noise: Array
    singular_values: Array
    in_noise: bool


class RowImbalance:
    """Imbalance of the rows of a campaign with alpha = 1 and with (n,) alpha, as they are read."""

    def __init__(self, screened: ScreenedCampaign, alpha: Array) -> None:
        campaign, a = screened.campaign, enabled_arms(screened.campaign.layout)
        self._balanced = [balanced_rows(c, a, screened.moments.reference) for c in campaign.cycles]
        self._arms = (a, a * alpha)
        self._parts: list[Array] = []

    def take(self, block: RowBlock) -> None:
        """Add the next rows."""
        position = block.position if is_displaced(block.cycle) else None
        force, known = self._balanced[block.cycle_index].of(block.force, position)
        other = 0.0 if known is None else known
        self._parts.append(np.stack([force @ arms.T + other for arms in self._arms]))

    def before_and_after(self, load: NDArray[np.int64], kept: NDArray[np.bool_]) -> Array:
        """Return (2, N, 3) imbalances of all rows about the mean of the rows kept under their load.

        The mean is absorbed by weight, B and torques.
        """
        rho = np.concatenate(self._parts, axis=1)
        for index in np.unique(load[kept]):
            rho[:, load == index] -= rho[:, kept & (load == index)].mean(axis=1, keepdims=True)
        return rho


def campaign_evidence(
    screened: ScreenedCampaign, calibration: Calibration, imbalance: RowImbalance
) -> Evidence:
    """Return the evidence of a campaign for its calibration; no row is read."""
    campaign = screened.campaign
    a, on = enabled_arms(campaign.layout), campaign.layout.enabled
    scaled_arms = a * calibration.alpha[on]
    valid = np.concatenate([c.valid for c in campaign.cycles])
    cycle = np.repeat(np.arange(len(campaign.cycles)), [c.valid.sum() for c in campaign.cycles])
    balancing = without(campaign, list(calibration.rejected_rows))
    kept, sound = (
        np.concatenate([c.valid for c in part.cycles])[valid]
        for part in (balancing, screened.sound)
    )
    group = np.concatenate(row_groups(screened.sound)[2])
    belongs = np.bincount(group[kept[sound]], minlength=len(screened.moments.rows)) > 0
    moments = chosen_groups(screened.moments, belongs)
    noise = reading_noise(screened.sound, screened.moments)
    weight, load = np.array(row_weights(campaign))[cycle], np.array(campaign.load_index)[cycle]
    rho = imbalance.before_and_after(load, kept)
    before, after = rho
    variance = noise.variance
    if noise.source == NoiseSource.MINIMUM:
        # Known in shape only: its size is what the residuals have.
        s = imbalance_covariance(scaled_arms, variance)
        variance = variance * np.mean(squared_distances(after, weight, s)[kept]) / 3
    problem = problem_of(screened.sound, replace(noise, variance=variance))
    share = with_share_in_balance(problem, screened, calibration.alpha[on]).noise.share
    s, s_before = (share * imbalance_covariance(each, variance) for each in (scaled_arms, a))
    readings = np.sqrt(variance * moments.typical_variance)
    return Evidence(
        residuals=RowResiduals(
            cycle=cycle,
            signed_shape=np.concatenate([c.shape * c.sign for c in campaign.cycles])[valid],
            before=np.sqrt(squared_distances(before, weight, s_before) / 3),
            after=np.sqrt(squared_distances(after, weight, s) / 3),
            kept=kept,
        ),
        balance=_balance_lines(campaign, rho, s, weight, load, kept),
        actuator_residual=spread(_pull(after[kept], weight[kept], scaled_arms, s), on),
        actuator_noise=spread(
            readings if noise.source == NoiseSource.REPEATS else np.full(readings.size, np.nan), on
        ),
        singular_values=np.sqrt(balance_spectrum(centred_means(moments), a, variance)),
        in_noise=noise.source != NoiseSource.MINIMUM,
    )


def _pull(rho: Array, weight: Array, scaled_arms: Array, s: Array) -> Array:
    """Return (n,) rms over rows of (alpha_i a_i)' S^-1 rho, in units of its noise.

    It is the correction of the reading of actuator i that rho implies, over that expected from
    noise.
    """
    solved = np.linalg.solve(s, rho.T)
    mean_square = (weight * solved) @ solved.T / len(rho)
    asked = np.einsum("kn,kl,ln->n", scaled_arms, mean_square, scaled_arms)
    by_noise = np.einsum("kn,kn->n", scaled_arms, np.linalg.solve(s, scaled_arms))
    return np.asarray(np.sqrt(asked / by_noise))


def _balance_lines(
    campaign: Campaign,
    rho: Array,
    s: Array,
    weight: Array,
    load: NDArray[np.int64],
    kept: NDArray[np.bool_],
) -> tuple[BalanceLine, ...]:
    """Return the rms imbalance of force and torques under each load, in mN and mN m."""
    lines = []
    for index, name in enumerate(each.name for each in campaign.loads):
        some = kept & (load == index)
        rms = np.sqrt(np.mean(rho[:, some] ** 2, axis=1))
        noise = np.sqrt(np.diag(s) * np.mean(1 / weight[some]))
        figures = 1e3 * np.column_stack([*rms, noise])
        lines += [
            BalanceLine(f"{what}, {name}", unit, *row)
            for (what, unit), row in zip(EQUATIONS, figures.tolist(), strict=True)
        ]
    return tuple(lines)


def stiffness_evidence(matrix: StiffnessMatrix, calibration: Calibration) -> Evidence:
    """Return the evidence of a stiffness matrix for its relative alpha."""
    matrix = as_calibrated(matrix, calibration.effects)
    facts, on = MatrixFacts.of(matrix), matrix.layout.enabled
    a, elastic, alpha = facts.arms, facts.elastic_modes, calibration.alpha[on]
    modes = elastic.forces.T
    before, after = (modes * values @ a.T for values in (np.ones(len(alpha)), alpha))
    scaled_arms, even = a * alpha, np.ones(len(modes))
    s = scaled_arms @ scaled_arms.T
    s *= np.mean(squared_distances(after, even, s)) / 3
    eigenvalues = calibration.diagnosis.eigenvalues if calibration.diagnosis else ()
    return Evidence(
        residuals=ModeResiduals(
            elastic.values,
            *(np.sqrt(np.mean(rho**2, axis=1)) for rho in (before, after)),
        ),
        balance=tuple(
            BalanceLine(line.modes, "", line.before, line.after, float("nan"))
            for line in calibration.imbalances
        ),
        actuator_residual=spread(_pull(after, even, scaled_arms, s), on),
        actuator_noise=np.full(on.size, np.nan),
        singular_values=np.sqrt(np.maximum(eigenvalues, 0.0)),
        in_noise=False,
    )
