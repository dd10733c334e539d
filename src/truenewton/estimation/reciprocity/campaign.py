"""Reciprocity of a campaign: relative alpha and sensors from POSITION, the scale from the weights.

The stiffness, regressed under all loads together, does not depend on their mean forces. These
balance the weights, and are fitted by the likelihood of `ml` with the alpha of reciprocity as a
prior: so B, torques, E_SYST and COVARIANCE are those of `ml`.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from truenewton.arrays import Array
from truenewton.chance import f_sf
from truenewton.errors import NotConverged, RankDeficient
from truenewton.estimation import campaign_ml
from truenewton.estimation.checks import refusal_naming
from truenewton.estimation.findings.code import LIMITS, Code
from truenewton.estimation.findings.estimate import (
    Estimate,
    Goodness,
    NoiseSource,
    errors_between_loads,
    weight_errors,
)
from truenewton.estimation.findings.finding import Finding
from truenewton.estimation.likelihood import DataSet, Minimum, Prior, minimise
from truenewton.estimation.problem import Problem, load_data, problem_of, with_share_in_balance
from truenewton.estimation.readings.moments import Moments, chosen_groups, reading_noise, shape_sums
from truenewton.estimation.reciprocity import acceptance
from truenewton.estimation.reciprocity.iteration import Fit, fit, in_double
from truenewton.estimation.reciprocity.regression import (
    MAX_SINGLE_STATES,
    Regressed,
    condensed_regression,
    kept,
    kept_places,
    regressed,
)
from truenewton.estimation.reciprocity.sensor_model import (
    START_REQUEST,
    Kind,
    Request,
    at_nominal,
    places_of,
)
from truenewton.estimation.screening.screen import ScreenedCampaign

METHOD = "reciprocity"
MIN_START_ALPHA = 0.05  # first alpha of an iteration


def fit_campaign(
    screened: ScreenedCampaign, motion: Array | None = None, *, where_it_holds: bool = False
) -> Estimate:
    """Return alpha and the sensors of a campaign; contradictions are among the warnings.

    The cycles contain POSITION, under at least two loads. ``motion`` is the (n, n) or (6, n, n)
    sensor model of the shell (`places_of`). ``where_it_holds``: if reciprocity is not accepted,
    return the estimate by `ml`, with the reason.
    Raises RankDeficient, TooManyOutliers, NotConverged.
    """
    base = campaign_ml.fit_campaign(screened)
    if not where_it_holds:
        with acceptance.advising_ml():
            estimate, against = _found(screened, base, motion)
        return estimate.with_warnings(acceptance.doubts(against))
    if screened.moments.displacement is None:
        return base
    if base.effects:
        first = next((effect for effect in base.effects if effect.corrected), base.effects[0])
        alone = ", which only ml corrects" if first.corrected else ""
        untried = Finding.of(Code.EFFECT_PRESENT, effect=f"{first.name}{alone}")
        return base.with_warnings(acceptance.instead([untried]))
    try:
        estimate, against = _found(screened, base, motion)
    except (RankDeficient, NotConverged) as error:
        against = (acceptance.failed(error),)
    return base.with_warnings(acceptance.instead(against)) if against else estimate


def _found(
    screened: ScreenedCampaign, base: Estimate, motion: Array | None
) -> tuple[Estimate, tuple[Finding, ...]]:
    """Return the estimate and what contradicts it; ``base`` is that of `ml`."""
    campaign, moments = screened.sound, _balancing(screened, base)
    layout, noise = campaign.layout, reading_noise(campaign, moments)
    gradients = {(c.bias_gradient or 0.0, c.coil_gradient or 0.0) for c in campaign.cycles}
    if len(gradients) > 1:
        raise RankDeficient(
            "COILGRAD or BIASGRAD differs between cycle files, which reciprocity puts together",
            remedy="declare one pair for all",
        )
    bias, coil = gradients.pop()
    with refusal_naming(lambda: screened.frozen):
        stiffness = regressed(moments, noise.variance, bias_gradient=bias, coil_gradient=coil)
    keep, odd = kept(stiffness.stiffness)
    places = kept_places(places_of(layout, motion), keep, stiffness.stiffness)
    stiffness = condensed_regression(stiffness, keep)
    # Near enough for the quietest readings: alpha of `ml`, about mean 1.
    log_alpha = np.log(np.maximum(base.values[: len(keep)][keep], MIN_START_ALPHA))
    start = replace(at_nominal(places.n), log_alpha=log_alpha - log_alpha.mean())
    fitted = in_double(fit(places, START_REQUEST, stiffness.states, start=start))
    goodness = _goodness(fitted, stiffness)
    excess = goodness.reduced if goodness.probability < LIMITS.fit_probability else 1.0
    force = moments.sums.force.sum(axis=1) / moments.sums.weight
    errors = {**weight_errors(campaign), **errors_between_loads(campaign, force)}
    problem = problem_of(campaign, noise, errors)
    shared = with_share_in_balance(problem, screened, base.values[: problem.n])
    minimum = _with_weights(problem, moments, (fitted, keep), base, excess)
    estimate = campaign_ml.estimate_of(METHOD, problem, moments, minimum, base.rejected_rows, 0)
    effects = tuple(replace(effect, corrected=False) for effect in base.effects)  # by `ml` alone
    said = estimate.diagnosis.warnings
    if excess > 1.0:
        remedy = "give the mirror, so that what its sensors see is known" if motion is None else ""
        said += (Finding.of(Code.RECIPROCITY_INFLATED, factor=np.sqrt(excess), remedy=remedy),)
    ids = layout.id[layout.enabled]
    if not keep.all():
        said += (Finding.of(Code.RECIPROCITY_EXCLUDED, actuators=ids[~keep]),)
    estimate = replace(
        estimate,
        goodness=goodness,
        effects=effects,
        unseen=base.unseen,
        chi2=base.chi2,
        diagnosis=replace(estimate.diagnosis, warnings=said),
        sensors=acceptance.sensors_of(fitted, acceptance.errors_of_sensors(fitted), ids, keep),
    )
    evidence = acceptance.Evidence(
        fitted.reduced,
        odd=odd,
        disturbed=bool(np.any(shared.disturbance)),
        untried=problem.n if problem.n > MAX_SINGLE_STATES else 0,
        offset_spread=fitted.asked.offset_spread if fitted.asked.estimated else float("nan"),
    )
    return estimate, tuple(acceptance.refusals(evidence))


def _balancing(screened: ScreenedCampaign, base: Estimate) -> Moments:
    """Return the moments without the groups that did not balance for `ml`."""
    moments, campaign = screened.moments, screened.campaign
    out = {
        (campaign.load_index[row.cycle], int(cycle.shape[row.row]), int(cycle.sign[row.row]))
        for row in base.rejected_rows
        if row.against == "balance"
        for cycle in (campaign.cycles[row.cycle],)
    }
    if not out:
        return moments
    return chosen_groups(
        moments, np.array([tuple(label) not in out for label in moments.labels.tolist()])
    )


def _goodness(fitted: Fit, stiffness: Regressed) -> Goodness:
    """Return chi2 of all blocks, with the degrees of freedom of the noise."""
    chi2, freedom = sum(fitted.chi2), sum(fitted.equations) - sum(fitted.parameters)
    probability = f_sf(chi2 / freedom, freedom, stiffness.noise_freedom)
    return Goodness(chi2, round(freedom), NoiseSource.REPEATS, float(probability))


def alpha_information(whole: Array, asked: Request) -> Array:
    """Return (n, n) information on log alpha with unknown sensors, of all (u, u)."""
    if asked.kinds == (Kind.ALPHA,):
        return whole
    n = len(whole) // len(asked.kinds)
    rest, cross = whole[n:, n:].copy(), whole[n:, :n]
    if np.isinf(asked.gain_spread):  # what holds their free scale does not reach alpha
        rest[:n, :n] += np.trace(rest[:n, :n]) / n**2
    taken = cross.T @ scipy.linalg.solve(rest, cross, assume_a="pos")
    return np.asarray(whole[:n, :n] - 0.5 * (taken + taken.T))


def _with_weights(
    problem: Problem,
    moments: Moments,
    kept_fit: tuple[Fit, NDArray[np.bool_]],
    base: Estimate,
    excess: float,
) -> Minimum:
    """Return the most likely alpha, B and torques by the mean force under each load.

    The prior covers the actuators that the fit keeps; alpha of the others stays that of the
    balance.
    """
    fitted, keep = kept_fit
    unknowns, n = problem.unknowns, problem.n
    data = mean_forces(problem, moments)
    scale = np.exp(np.mean(np.log(np.maximum(base.values[:n][keep], MIN_START_ALPHA))))
    start = np.zeros(unknowns.total)
    start[: unknowns.count] = base.values
    start[:n][keep] = scale * fitted.values.alpha
    free = np.where(keep, np.inf, np.diag(base.reading_covariance)[:n])
    information = np.diag(1.0 / free)
    root = start[:n][keep]
    relative = alpha_information(fitted.information, fitted.asked)
    information[np.ix_(keep, keep)] += relative / np.outer(root, root) / excess
    own = problem.prior
    prior = Prior(np.concatenate([start[:n], own.mean[n:]]), information, own.measured, own.held)
    return minimise(problem.a, [data], prior, start)


def mean_forces(problem: Problem, moments: Moments) -> DataSet:
    """Return the mean force under each load, as a shape of its own."""
    share = moments.of_load * moments.weight[:, None]
    weight = share.sum(axis=0)
    mean, known = (share.T @ values / weight[:, None] for values in (moments.mean, moments.known))
    sums = shape_sums(mean, weight, known, np.eye(len(weight)))
    data = load_data(problem.campaign, moments, problem.noise.in_balance, problem.errors)
    return replace(data, sums=sums)
