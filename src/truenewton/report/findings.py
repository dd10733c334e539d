"""`investigate`: a calibration, its evidence and modal basis, or why the data give none.

The evidence is residuals, balance before and after, and singular values. The imbalance of a row is
rho = A (alpha c) + k, three numbers, with the covariance S = A diag(alpha) Sigma diag(alpha) A'
(docs/likelihood.md). In units of its noise it is (rho' S^-1 rho / 3)^1/2; its rms is 1 if there is
nothing but noise.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import TypeVar

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from truenewton.arrays import Array, spread
from truenewton.calibration.methods import (
    calibrate,
    calibration_of,
    disabled,
    estimate_alpha,
    refusals,
    resolve_method,
)
from truenewton.calibration.result import Calibration
from truenewton.errors import (
    CampaignMismatch,
    Fault,
    NotConverged,
    RankDeficient,
    TooManyOutliers,
    TrueNewtonError,
    UnknownName,
)
from truenewton.estimation.campaign_ml import fit_campaign
from truenewton.estimation.findings.estimate import NoiseSource
from truenewton.estimation.findings.finding import as_sentences
from truenewton.estimation.matrix.facts import MatrixFacts
from truenewton.estimation.matrix.screen import as_calibrated
from truenewton.estimation.paper.equations import imbalance_covariance, squared_distances
from truenewton.estimation.paper.identifiability import balance_spectrum, centred_means
from truenewton.estimation.problem import problem_of, with_share_in_balance
from truenewton.estimation.readings.moments import chosen_groups, reading_noise
from truenewton.estimation.readings.rows import balanced, row_groups, row_weights
from truenewton.estimation.screening.screen import ScreenedCampaign, screen_campaign, without
from truenewton.figures.style import on_screen
from truenewton.modal.findings import ModalFindings, find_modes
from truenewton.modal.measured_stiffness import motion_sums
from truenewton.reading import Read
from truenewton.records.campaign import Campaign, refuse_other_mirror
from truenewton.records.cycle import Source
from truenewton.records.result import figures_of
from truenewton.records.stiffness_matrix import StiffnessMatrix
from truenewton.statics.arms import enabled_arms

EQUATIONS = (("force", "mN"), ("torque M_y", "mN m"), ("torque M_x", "mN m"))


@dataclass(frozen=True)
class BalanceLine:
    """An rms imbalance with alpha = 1, calibrated, and expected from noise; NaN if unknown."""

    what: str  # 'force, bare', ...
    unit: str  # 'mN', ...; '' for an imbalance per unit of force
    before: float
    after: float
    noise: float


@dataclass(frozen=True, eq=False)
class RowResiduals:
    """Imbalance of the N valid rows of a campaign in units of their noise."""

    cycle: NDArray[np.int64]  # (N,) index of the cycle in the campaign
    signed_shape: NDArray[np.int64]  # (N,) SHAPE times SIGN
    before: Array  # (N,) with alpha = 1
    after: Array  # (N,) with the calibration
    kept: NDArray[np.bool_]  # (N,) false for rejected rows


@dataclass(frozen=True, eq=False)
class ModeResiduals:
    """Rms imbalance of the m elastic modes of a stiffness matrix per unit of force."""

    stiffness: Array  # (m,) of the modes [N/m]
    before: Array  # (m,) with alpha = 1
    after: Array  # (m,) with the calibration


@dataclass(frozen=True, eq=False)
class Evidence:
    """The evidence for a calibration; arrays of actuators are NaN if unknown."""

    residuals: RowResiduals | ModeResiduals
    balance: tuple[BalanceLine, ...]
    # (n,) rms correction of each reading that the imbalance implies, in its noise
    actuator_residual: Array
    actuator_noise: Array  # (n,) standard deviation of one reading among repeats [N]
    singular_values: Array  # of the balance, ascending; the first belongs to alpha itself
    in_noise: bool  # whether these are in units of noise


def campaign_evidence(screened: ScreenedCampaign, calibration: Calibration) -> Evidence:
    """Return the evidence of a campaign for its calibration."""
    campaign = screened.campaign
    a, on = enabled_arms(campaign.layout), campaign.layout.enabled
    alpha = _alpha_of_all(screened, calibration)
    scaled_arms = a * alpha
    valid = np.concatenate([c.valid for c in campaign.cycles])
    cycle = np.repeat(np.arange(len(campaign.cycles)), [c.valid.sum() for c in campaign.cycles])
    balancing = without(campaign, list(calibration.rejected_rows))
    kept, sound = (
        np.concatenate([c.valid for c in part.cycles])[valid]
        for part in (balancing, screened.sound)
    )
    group = np.concatenate(row_groups(screened.sound)[1])
    belongs = np.bincount(group[kept[sound]], minlength=len(screened.moments.rows)) > 0
    moments = chosen_groups(screened.moments, belongs)
    noise = reading_noise(screened.sound, screened.moments)
    weight, load = np.array(row_weights(campaign))[cycle], np.array(campaign.load_index)[cycle]
    rho = _imbalance(screened, (a, scaled_arms), load, kept)
    before, after = rho
    variance = noise.variance
    if noise.source == NoiseSource.MINIMUM:
        # Known in shape only: its size is what the residuals have.
        s = imbalance_covariance(scaled_arms, variance)
        variance = variance * np.mean(squared_distances(after, weight, s)[kept]) / 3
    problem = problem_of(screened.sound, replace(noise, variance=variance))
    share = with_share_in_balance(problem, screened, alpha).noise.share
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


def _alpha_of_all(screened: ScreenedCampaign, calibration: Calibration) -> Array:
    """Return (n,) alpha; that of actuators without one, whose FORCE is not 0, is fitted again."""
    alpha = calibration.alpha[screened.campaign.layout.enabled]
    if np.isnan(alpha).any():
        fitted = fit_campaign(screened).values[: alpha.size]
        alpha = np.where(np.isnan(alpha), fitted, alpha)
    return alpha


def _imbalance(
    screened: ScreenedCampaign,
    arms: tuple[Array, Array],
    load: NDArray[np.int64],
    kept: NDArray[np.bool_],
) -> Array:
    """Return (2, N, 3) imbalances of all rows with two kinds of (3, n) arms.

    They are about the mean of the rows kept under their load, which weight, B and torques absorb.
    """
    a, parts = enabled_arms(screened.campaign.layout), list[Array]()
    for cycle in screened.campaign.cycles:
        force, known = balanced(cycle, a, screened.moments.reference)
        parts.append(np.stack([force @ each.T + known for each in arms]))
    rho = np.concatenate(parts, axis=1)
    for index in np.unique(load[kept]):
        rho[:, load == index] -= rho[:, kept & (load == index)].mean(axis=1, keepdims=True)
    return rho


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


MAX_MODES = 1500  # actuators; eigenmodes of thousands take minutes
OWN_CALIBRATION = "give the calibration of these data"
Modal = TypeVar("Modal")


@dataclass(frozen=True, eq=False)
class Findings:
    """The content of a report on data, or on a finished calibration.

    Attributes
    ----------
    data
        Data, or a finished calibration.
    calibration
        Its result; None if the data cannot give one.
    evidence
        Residuals, balance and singular values; None without data or without calibration.
    faults
        Why there is no calibration, each with its remedy.
    modes
        The modal basis of data and alpha, if there is one.
    no_modes
        Why there is none, in a sentence; empty without data or without calibration.
    """

    data: Campaign | StiffnessMatrix | Calibration
    calibration: Calibration | None
    evidence: Evidence | None = None
    faults: tuple[Fault, ...] = ()
    modes: ModalFindings | None = None
    no_modes: str = ""

    @property
    def inputs(self) -> tuple[Source, ...]:
        """The files of the calibration, or those that did not suffice."""
        known = self.calibration or self.data
        if isinstance(known, Calibration):
            return known.sources
        records = known.cycles if isinstance(known, Campaign) else (known,)
        return tuple(record.source for record in records if record.source)

    def plot(self, name: str, ax: Axes | None = None) -> Axes:
        """Draw a figure by its name, as 'budget', 'map-leverage' or 'modes'; return the axes.

        Raises
        ------
        UnknownName
            There is no such figure; the message lists those that exist.
        ValueError
            These findings do not contain what it shows.
        """
        drawn = figures_of(self)
        if name in drawn:
            with on_screen():
                axes: Axes = drawn[name](ax=ax)
                return axes
        if name in ("residuals", "singular-values", "balance"):
            raise ValueError("a calibration file contains no residuals; give the cycles")
        if name == "temperatures":
            raise ValueError("only the cycles of a campaign have times")
        if name.startswith("modes"):
            missing = "turbulence and power need the diameter of the pupil, and the efficiency"
            no_modes = self.no_modes or "a calibration file has no modes; give the data"
            raise ValueError(missing if self.modes else no_modes)
        remedy = f"choose {', '.join(drawn)}"
        raise UnknownName(f"there is no figure '{name}'", remedy=remedy)


def investigate(
    data: Read,
    method: str | None = None,
    *,
    calibration: Calibration | None = None,
    population: bool = False,
    motion: Array | None = None,
    diameter: float | None = None,
    efficiency: float | None = None,
) -> Findings:
    """Calibrate data and collect the evidence; data that do not suffice are diagnosed instead.

    Parameters
    ----------
    data
        Data, or a finished calibration.
    calibration
        The result of an earlier calibration of these data, which are then not fitted again.
    method, population, motion
        As in `calibrate`; (n, n).
    diameter, efficiency
        Of the telescope's pupil [m], and of the coils, as in `find_modes`. Turbulence is left out
        if the diameter is not given.

    Raises
    ------
    CampaignMismatch
        The calibration is of another mirror, or of other files.
    UnknownName
        There is no such method, or it does not apply to the data.

    Examples
    --------
    >>> findings = tn.investigate(campaign)
    >>> findings.faults, findings.modes
    ((), <ModalFindings of P45: 45 modes>)
    """
    if calibration is not None:
        refuse_other_mirror(calibration, data, "the data", "the calibration", OWN_CALIBRATION)
    if isinstance(data, Calibration):
        return Findings(data, data)
    off = calibration.layout.id[~calibration.layout.enabled].tolist() if calibration else []
    data = disabled(data, off)
    method, options = resolve_method(data, method, population=population, motion=motion)
    modes = partial(find_modes, diameter=diameter, efficiency=efficiency, accept_rejected=True)
    screened: ScreenedCampaign | None = None
    try:
        if isinstance(data, StiffnessMatrix):
            made = calibration or calibrate(data, method, **options._asdict())
            return _of_matrix(data, made, modes)
        screened = screen_campaign(data)
        if calibration is not None:
            _refuse_other_files(calibration, data)
            return _of_campaign(screened, calibration, modes)
        estimate = estimate_alpha(screened, method, options)
    except (RankDeficient, TooManyOutliers, NotConverged) as error:
        return Findings(data, None, faults=refusals(error, screened))
    return _of_campaign(screened, calibration_of(data, estimate), modes)


def _refuse_other_files(calibration: Calibration, campaign: Campaign) -> None:
    """Raise `CampaignMismatch` if the calibration was made without a file of the campaign."""
    files = {source.sha256 for source in calibration.sources}
    for cycle in campaign.cycles:
        if files and cycle.source and cycle.source.sha256 not in files:
            raise CampaignMismatch(
                "was not used for the calibration", remedy=OWN_CALIBRATION, path=cycle.name
            )


def _of_matrix(
    matrix: StiffnessMatrix, calibration: Calibration, find: Callable[..., ModalFindings]
) -> Findings:
    evidence = stiffness_evidence(matrix, calibration)
    modes, no_modes = _modes(matrix, lambda: find(matrix, calibration))
    return Findings(matrix, calibration, evidence, modes=modes, no_modes=no_modes)


def _of_campaign(
    screened: ScreenedCampaign, calibration: Calibration, find: Callable[..., ModalFindings]
) -> Findings:
    campaign, modes = screened.campaign, None
    evidence = campaign_evidence(screened, calibration)
    sums, no_modes = _modes(campaign, lambda: motion_sums(screened))
    if sums is not None:
        modes, no_modes = _modes(campaign, lambda: find(campaign, calibration, sums=sums))
    return Findings(campaign, calibration, evidence, modes=modes, no_modes=no_modes)


def _modes(data: Campaign | StiffnessMatrix, find: Callable[[], Modal]) -> tuple[Modal | None, str]:
    """Return the modal basis, or a step towards it, or why there is none."""
    if data.layout.n > MAX_MODES:
        how = f"Those of {data.layout.n} actuators take minutes. Use truenewton modes."
        return None, f"Stiffness modes are not shown. {how}"
    try:
        return find(), ""
    except TrueNewtonError as error:
        why = as_sentences(Fault(error.fault, error.remedy))
        return None, f"Stiffness modes are not shown. {why}"


def require_calibration(findings: Findings) -> Calibration:
    """Return the calibration; raise `RankDeficient` if the data do not suffice."""
    if findings.calibration is None:
        fault, remedy = findings.faults[0]
        raise RankDeficient(fault, remedy=remedy)
    return findings.calibration
