"""What is weak in a campaign and its fit, in words."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from truenewton.chance import chi2_sf
from truenewton.estimation.diagnosis import NoiseSource
from truenewton.estimation.displaced_rows import is_displaced
from truenewton.estimation.minimum import Minimum
from truenewton.estimation.moments import Moments
from truenewton.estimation.problem import Problem
from truenewton.estimation.repeats import WEIGHED_NOISE
from truenewton.estimation.still_readings import still_sensors
from truenewton.records.campaign import mean_temperature
from truenewton.records.fault import Fault
from truenewton.rounding import counted, listed

LOUDER = 1.5  # times FORCERR: a scatter of the repeats that is said
PLAUSIBLE = (0.5, 2.0)  # alpha in the median: beyond, a unit or a weight is wrong
LONG_AFTER, SAID = 30.0, 2  # days without a file, in one campaign; files that are named
WARM = 50.0  # [deg C]
FARTHER = 3.0  # times the weight: bias magnets that hold so much hold another weight


def noise_warnings(free: int, weakest: str, held: int, error: float) -> Iterator[Fault]:
    """Warn of patterns hardly above the noise, and of those held, with the error of each."""
    if free:
        patterns = "pattern of alpha stands" if free == 1 else "patterns of alpha stand"
        yield Fault(
            f"{free} {patterns} hardly above the noise, the weakest {weakest}",
            "repeat more often, use larger forces, or add a stiffness matrix",
        )
    if held:
        each = "pattern of alpha drowns" if held == 1 else "patterns of alpha drown"
        yield Fault(
            f"{held} {each} in noise: held even over the mirror, each uncertain by as much as"
            f" alpha varies otherwise, {100 * error:.2g} % of it RMS",
            "trust E_ALPHA, and differences along other patterns by COVARIANCE",
        )


def campaign_warnings(problem: Problem, moments: Moments, minimum: Minimum) -> Iterator[Fault]:
    """Warn of weights that disagree more than their errors allow, and of sensors set anew."""
    loads = len(problem.campaign.loads)  # the common scale and B take up two of them
    size = float(np.sum(minimum.values[problem.unknowns.weights] ** 2))
    if loads > 2 and chi2_sf(size, loads - 2) <= 1e-3:
        yield Fault(
            f"the weights of the {loads} loads disagree by {np.sqrt(size):.1f} sigma",
            "check ADDED, TILT and their errors",
        )
    yield from _date_warnings(problem)
    yield from _warm_warnings(problem)
    yield from _weight_warnings(problem, moments, minimum)
    yield from _rounding_warnings(problem, moments)
    declared = all(cycle.force_error for cycle in problem.campaign.cycles)
    expected = WEIGHED_NOISE**2 + np.mean(moments.rounding)
    louder = float(np.sqrt(problem.noise.seen.mean() / expected))
    known = declared and problem.noise.source == NoiseSource.REPEATS
    if known and louder > LOUDER and _is_in_newton(problem, minimum):
        noise = 1e3 * moments.noise
        yield Fault(
            f"repeated shapes scatter by {noise:.2g} mN, {louder:.3g} times what FORCERR says",
            "look for what moves the mirror or the readings between repeats, and correct FORCERR",
        )
    anew = int(np.count_nonzero(_set_anew(problem, moments)))
    if anew:
        yield Fault(
            f"the zeros of {counted(anew, 'sensor')} were set anew between files: these count from"
            " each file's own mean, and E_STAT knows nothing of motion between files",
            "keep the zeros of the sensors through a campaign",
        )


def _set_anew(problem: Problem, moments: Moments) -> NDArray[np.bool_]:
    """Return (n,) whose zero was set anew, those left aside that do not move at all."""
    anew, campaign = np.isnan(moments.reference), problem.campaign
    if not (anew.any() and any(map(is_displaced, campaign.cycles))):
        return np.zeros_like(anew)
    return np.asarray(anew & ~still_sensors(campaign).any(axis=0))


def _date_warnings(problem: Problem) -> Iterator[Fault]:
    """Warn of files that were taken long before or after the others, if it is true."""
    files = sorted(problem.campaign.cycles, key=lambda cycle: cycle.date)
    days = [(b.date - a.date).total_seconds() / 86400 for a, b in pairwise(files)]
    if max(days, default=0.0) < LONG_AFTER:
        return
    cut = int(np.argmax(days)) + 1
    lot = min(files[cut:], files[:cut], key=len)
    yield Fault(
        f"by DATE-OBS {max(days):.0f} days lie between"
        f" {listed([cycle.name for cycle in lot], SAID)} and the other files",
        "correct DATE-OBS, by which drifts are found; or calibrate what was taken together",
    )


def _warm_warnings(problem: Problem) -> Iterator[Fault]:
    """Warn of a temperature at which nobody works at a bench."""
    warm = mean_temperature(problem.campaign.cycles)
    if warm > WARM:
        yield Fault(
            f"TEMPERATURE is {warm:.3g} deg C in the mean",
            "check its unit: 68 is 20 deg C in Fahrenheit",
        )


def _is_in_newton(problem: Problem, minimum: Minimum) -> bool:
    """Tell whether alpha is near 1; else a unit is wrong, and the verdict says so."""
    return PLAUSIBLE[0] < float(np.median(minimum.values[: problem.n])) < PLAUSIBLE[1]


def _weight_warnings(problem: Problem, moments: Moments, minimum: Minimum) -> Iterator[Fault]:
    """Warn of a WEIGHT that actuators cannot have held, or magnets not have been made for.

    Shapes take several times the share of an actuator in the weight, and bias magnets are made to
    bear about that weight. Alpha rests on the differences between loads alone, unless they tilt.
    """
    campaign, n = problem.campaign, problem.n
    if not _is_in_newton(problem, minimum):
        return  # it may be the unit of FORCE that is wrong
    # By actuators first: another array of all means would be the largest of a calibration.
    commanded = np.maximum(moments.mean.max(axis=0), -moments.mean.min(axis=0))
    largest = float(np.max(np.abs(minimum.values[:n]) * commanded))
    each, bias = abs(campaign.weight) / n, float(minimum.values[problem.unknowns.bias])
    if each > largest:
        why = f"{each:.2g} N for each actuator, none of which ever gave more than {largest:.2g} N"
    elif abs(bias) > FARTHER * abs(campaign.weight):
        why = "several times less than bias magnets hold"
    else:
        return
    yield Fault(
        f"WEIGHT is {campaign.weight:.3g} N, {why}: B comes to {bias:.3g} N",
        "check WEIGHT and its unit, N (kilograms times -9.81), and those of FORCE; B is wrong by as"
        " much, and alpha too where a load is tilted",
    )


def _rounding_warnings(problem: Problem, moments: Moments) -> Iterator[Fault]:
    """Say that forces come in steps, where that makes most of their noise."""
    noise, repeats = problem.noise, moments.rows.sum() / moments.groups
    rounding, variance = float(np.mean(moments.rounding)), noise.seen + noise.hidden / repeats
    if noise.source == NoiseSource.MINIMUM or 2 * rounding < variance.mean():
        return
    step = 1e3 * float(np.sqrt(np.mean(np.square(moments.step))))
    yield Fault(
        f"FORCE comes in steps of {step:.3g} mN, which is most of its noise:"
        f" {step / np.sqrt(12):.2g} mN, step / root 12, is in E_STAT",
        "nothing, if that is good enough; else record FORCE in finer steps, or means of several"
        " readings",
    )
