"""What is weak in a campaign and its fit."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from truenewton.chance import chi2_sf
from truenewton.estimation.findings.code import Code
from truenewton.estimation.findings.estimate import NoiseSource
from truenewton.estimation.findings.finding import Finding
from truenewton.estimation.findings.thresholds import LIMITS
from truenewton.estimation.likelihood.minimum import Minimum
from truenewton.estimation.problem import Problem
from truenewton.estimation.readings.moments import Moments
from truenewton.estimation.readings.repeats import WEIGHED_NOISE
from truenewton.estimation.readings.rows import is_displaced
from truenewton.estimation.screening.frozen_readings import still_sensors
from truenewton.records.campaign import Campaign, mean_temperature

MIN_SCATTER_RATIO = 1.5  # times FORCERR: a scatter of the repeats that is said
MAX_DAYS_APART = 30.0  # days without a file, in one campaign
WARM_TEMPERATURE = 50.0  # [deg C]
MAX_BIAS_TO_WEIGHT = 3.0  # times the weight: bias magnets that hold so much hold another weight


def noise_warnings(free: int, weakest: str, held: int, error: float) -> Iterator[Finding]:
    """Warn of patterns hardly above the noise, and of those held, with the error of each."""
    if free:
        yield Finding.of(Code.WEAK_PATTERNS, count=free, weakest=weakest)
    if held:
        yield Finding.of(Code.CONSTRAINED_PATTERNS, count=held, error=error)


def campaign_warnings(problem: Problem, moments: Moments, minimum: Minimum) -> Iterator[Finding]:
    """Warn of weights that disagree more than their errors allow, and of sensors set anew."""
    loads = len(problem.campaign.loads)  # the common scale and B take up two of them
    size = float(np.sum(minimum.values[problem.unknowns.weights] ** 2))
    if loads > 2 and chi2_sf(size, loads - 2) <= 1e-3:
        yield Finding.of(Code.WEIGHTS_DISAGREE, loads=loads, sigmas=float(np.sqrt(size)))
    yield from _cycle_warnings(problem.campaign)
    in_newton = LIMITS.lowest_alpha < np.median(minimum.values[: problem.n]) < LIMITS.highest_alpha
    if in_newton:  # else a unit is wrong, perhaps of FORCE, and the verdict says so
        yield from _weight_warnings(problem, moments, minimum)
    yield from _rounding_warnings(problem, moments)
    declared = all(cycle.force_error for cycle in problem.campaign.cycles)
    expected = WEIGHED_NOISE**2 + np.mean(moments.rounding)
    louder = float(np.sqrt(problem.noise.seen.mean() / expected))
    known = declared and problem.noise.source == NoiseSource.REPEATS
    if known and louder > MIN_SCATTER_RATIO and in_newton:
        noise = 1e3 * moments.noise
        yield Finding.of(Code.NOISE_ABOVE_DECLARED, noise=noise, ratio=louder)
    anew = int(np.count_nonzero(_set_anew(problem, moments)))
    if anew:
        yield Finding.of(Code.ZEROS_RESET, sensors=anew)


def _set_anew(problem: Problem, moments: Moments) -> NDArray[np.bool_]:
    """Return (n,) whose zero was set anew, those left aside that do not move at all."""
    anew, campaign = np.isnan(moments.reference), problem.campaign
    if not (anew.any() and any(map(is_displaced, campaign.cycles))):
        return np.zeros_like(anew)
    return np.asarray(anew & ~still_sensors(campaign).any(axis=0))


def _cycle_warnings(campaign: Campaign) -> Iterator[Finding]:
    """Warn of files long before or after the others, and of a temperature too high for a bench."""
    files = sorted(campaign.cycles, key=lambda cycle: cycle.date)
    days = [(b.date - a.date).total_seconds() / 86400 for a, b in pairwise(files)]
    if max(days, default=0.0) >= MAX_DAYS_APART:
        cut = int(np.argmax(days)) + 1
        names = [cycle.name for cycle in min(files[cut:], files[:cut], key=len)]
        yield Finding.of(Code.DATES_APART, days=max(days), files=names)
    warm = mean_temperature(campaign.cycles)
    if warm > WARM_TEMPERATURE:
        yield Finding.of(Code.TEMPERATURE_IMPLAUSIBLE, temperature=warm)


def _weight_warnings(problem: Problem, moments: Moments, minimum: Minimum) -> Iterator[Finding]:
    """Warn of a WEIGHT that actuators cannot have held, or magnets not have been made for.

    Shapes take several times the share of an actuator in the weight, and bias magnets are made to
    bear about that weight. Alpha rests on the differences between loads alone, unless they tilt.
    """
    campaign, n = problem.campaign, problem.n
    # By actuators first: another array of all means would be the largest of a calibration.
    commanded = np.maximum(moments.mean.max(axis=0), -moments.mean.min(axis=0))
    largest = float(np.max(np.abs(minimum.values[:n]) * commanded))
    each, bias = abs(campaign.weight) / n, float(minimum.values[problem.unknowns.bias])
    held: dict[str, Any] = {"weight": campaign.weight, "bias": bias}
    if each > largest:
        yield Finding.of(Code.WEIGHT_ABOVE_FORCES, each=each, largest=largest, **held)
    elif abs(bias) > MAX_BIAS_TO_WEIGHT * abs(campaign.weight):
        yield Finding.of(Code.WEIGHT_BELOW_BIAS, **held)


def _rounding_warnings(problem: Problem, moments: Moments) -> Iterator[Finding]:
    """Say that forces come in steps, where that makes most of their noise."""
    noise, repeats = problem.noise, moments.rows.sum() / moments.groups
    rounding, variance = float(np.mean(moments.rounding)), noise.seen + noise.hidden / repeats
    if noise.source == NoiseSource.MINIMUM or 2 * rounding < variance.mean():
        return
    step = 1e3 * float(np.sqrt(np.mean(np.square(moments.step))))
    yield Finding.of(Code.FORCE_STEPS, step=step, noise=step / np.sqrt(12))
