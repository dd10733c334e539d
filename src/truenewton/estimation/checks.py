"""Stuck readings, dead actuators, exchanged columns, weights and dates that do not agree.

Only the user can decide this: suspects are named, also in the error if there is no alpha, and never
corrected.

Columns that belong to other actuators are found by the stiffness. Forces on displacements over the
shapes of a campaign give that of the glass, K, except for the gain of each row (alpha) and of each
column (the sensor). K is symmetric and not negative, so K_ij^2 <= K_ii K_jj, and no permutation has
a larger product |K_1p(1) ... K_np(n)| than the diagonal; gains do not change which one is largest.
If another one is, FORCE is in that order.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
import scipy
import scipy.linalg
from numpy.typing import NDArray

from truenewton.arrays import Array
from truenewton.chance import FALSE_ALARM, chi2_sf, f_isf, normal_sf
from truenewton.errors import Fault, NotConverged, RankDeficient, TooManyOutliers
from truenewton.estimation.findings.catalogue import ENTRIES, ORDER_OF_BOTH
from truenewton.estimation.findings.code import LIMITS, Code
from truenewton.estimation.findings.estimate import NoiseSource
from truenewton.estimation.findings.finding import MAX_NAMED_ACTUATORS, Finding, about_actuators
from truenewton.estimation.likelihood import Minimum
from truenewton.estimation.paper.identifiability import refuse
from truenewton.estimation.problem import Problem
from truenewton.estimation.readings.moments import Moments, Noise
from truenewton.estimation.readings.rows import WEIGHED_NOISE, is_displaced
from truenewton.estimation.screening.hypotheses import squared_differences
from truenewton.estimation.screening.screen import ScreenedCampaign, still_sensors, with_suspects
from truenewton.linalg import ROWS_AT_ONCE, assignment, asymmetry
from truenewton.records.campaign import Campaign, mean_temperature
from truenewton.rounding import named

MIN_VARIANCE_RATIO = 100.0  # variance of a typical reading over shapes, in units of its noise
MIN_RELATIVE_CHANGE = 0.03  # of a typical change, if the noise is unknown
MAX_ALPHA_SIGMAS = 3.0  # from 0, of an alpha that is 0
WELL_KNOWN_ERROR = 0.1  # error of an alpha relative to the typical alpha

MIN_SHAPE_ASYMMETRY = 0.2  # asymmetry of the stiffness relative to its size
MAX_REMAINING_ASYMMETRY = 0.5  # of it, in the better order
MIN_LOG_GAIN_OF_ORDER = np.log(1.5)  # mean gain of the elements in a better order

MIN_SCATTER_RATIO = 1.5  # reported scatter of the repeats, in units of FORCERR
MAX_DAYS_APART = 30.0  # days without a file, in one campaign
WARM_TEMPERATURE = 50.0  # [deg C]
MAX_BIAS_TO_WEIGHT = 3.0  # force of the bias magnets in units of the weight


@dataclass(frozen=True)
class InputChecks:
    """Suspects found before effects are looked for."""

    # Files that are not what they claim; actuators whose reading does not change.
    files: tuple[Finding, ...]
    actuators: tuple[Finding, ...]
    # Columns of other actuators: by the balance, otherwise by the stiffness of the shapes.
    columns: tuple[Finding, ...]

    @property
    def named(self) -> tuple[Finding, ...]:
        """All of them."""
        return (*self.files, *self.actuators, *self.columns)

    def where_nothing_balances(self, problem: Problem, moments: Moments) -> InputChecks:
        """Return these, with columns that are the same.

        A dead actuator explains the imbalance alone.
        """
        if self.actuators:
            return self
        return replace(self, columns=same_columns(problem, moments) or self.columns)


def check_inputs(screened: ScreenedCampaign, problem: Problem) -> InputChecks:
    """Return the suspects by the rows alone; raise RankDeficient if a reading is stuck."""
    campaign, moments = screened.campaign, screened.moments
    actuators = constant_actuators(campaign, moments, problem.noise)
    columns = misordered_columns(campaign, moments)
    return InputChecks(screened.suspects, actuators, columns)


@contextmanager
def refusal_naming(suspects: Callable[[], Sequence[Finding]]) -> Iterator[None]:
    """Add the suspects to an error as its possible causes."""
    try:
        yield
    except (RankDeficient, TooManyOutliers, NotConverged) as error:
        raise with_suspects(error, suspects()) from None


def constant_actuators(campaign: Campaign, moments: Moments, noise: Noise) -> tuple[Finding, ...]:
    """Name actuators whose reading does not change from shape to shape by more than noise.

    Raises RankDeficient if one does not change at all: it may exert any force, so that neither its
    alpha nor the common scale can be determined.
    """
    weight, mean, n = moments.weight, moments.mean, moments.mean.shape[1]
    share = (moments.of_load * weight[:, None]).T
    total = share.sum(axis=1)
    centre = share @ mean / np.where(total > 0.0, total, 1.0)[:, None]
    square, statics, loads = np.zeros(n), np.abs(centre).max(axis=0), np.count_nonzero(total)
    for start in range(0, len(mean), ROWS_AT_ONCE):
        some = slice(start, start + ROWS_AT_ONCE)
        square += weight[some] @ (mean[some] - centre[moments.labels[some, 0]]) ** 2
    freedom, change = moments.groups - loads, np.sqrt(square / weight.sum())
    if freedom < 1:
        return ()
    # Rounding of a reading that does not change at all, relative to a typical one.
    stuck = change <= 1e-9 * np.sqrt(np.mean(change**2 + statics**2))
    if stuck.all():
        fault = "FORCE is the same for all shapes"
        remedy = "record the forces commanded for each shape, once the mirror has settled"
        refuse([Fault(fault, remedy)])
    if stuck.any():
        ids = campaign.layout.shown[campaign.layout.enabled][stuck].tolist()
        fault = f"the reading of {named('actuator', ids, len(ids))} is stuck: it is the same for"
        refuse([Fault(f"{fault} all shapes", ENTRIES[Code.STUCK_READING].remedy)])
    if noise.source == NoiseSource.MINIMUM:
        constant = change < MIN_RELATIVE_CHANGE * np.median(change)
    else:
        ratio = square / freedom / noise.variance
        limit = float(f_isf(FALSE_ALARM / n, freedom, moments.repeats or 1e9))
        constant = (ratio <= limit) & (np.median(ratio) > MIN_VARIANCE_RATIO * limit)
    at_zero = statics < 5.0 * change * np.sqrt(loads / moments.groups)
    found = []
    for i in np.flatnonzero(constant):
        code, size = Code.DEAD_NO_FORCE if at_zero[i] else Code.STUCK_READING, float(change[i])
        found.append(about_actuators(campaign.layout, code, [i], size=size, unit="N"))
    return tuple(found)


def strange_alphas(campaign: Campaign, alpha: Array, error: Array) -> tuple[Finding, ...]:
    """Name actuators whose (n,) alpha is 0 or negative while that of the others is not."""
    typical = float(np.median(alpha))
    known = error < WELL_KNOWN_ERROR * typical
    dead = known & (np.abs(alpha) < MAX_ALPHA_SIGMAS * error)
    negative = known & (alpha <= -MAX_ALPHA_SIGMAS * error)
    many = max(2, LIMITS.bad_fraction * alpha.size)
    if np.count_nonzero(dead | negative) > many:  # the model is wrong, not the actuators
        return ()
    return tuple(
        about_actuators(
            campaign.layout,
            code,
            [i],
            probability=float(normal_sf((typical - alpha[i]) / error[i])),
            size=float(alpha[i]),
        )
        for which, code in ((dead, Code.DEAD_ALPHA_ZERO), (negative, Code.NEGATIVE_ALPHA))
        for i in np.flatnonzero(which)
    )


def misordered_columns(campaign: Campaign, moments: Moments) -> tuple[Finding, ...]:
    """Name an order of FORCE that POSITION contradicts; none without a stiffness of the shapes."""
    stiffness = stiffness_of_shapes(moments)
    if stiffness is None:
        return ()
    order = likeliest_order(stiffness)
    moved = np.flatnonzero(order != np.arange(len(order)))
    if not moved.size:
        return ()
    before, after = asymmetry(stiffness), asymmetry(stiffness[np.argsort(order)])
    element, best = np.abs(stiffness[moved, moved]), np.abs(stiffness[moved, order[moved]])
    gain = float(np.mean(np.log(best / np.maximum(element, 1e-300))))
    few = moved.size <= MAX_NAMED_ACTUATORS  # two columns of many hardly show in all of the matrix
    likelier = after < MAX_REMAINING_ASYMMETRY * before or (few and after < before)
    if gain < MIN_LOG_GAIN_OF_ORDER or not likelier or (not few and before < MIN_SHAPE_ASYMMETRY):
        return ()
    where = f"{{}} (asymmetry of the stiffness {100 * before:.0f} %, in the best order"
    where += f" {100 * after:.0f} %)"
    what: dict[str, Any] = {"many": "columns", "size": before, "remedy": ORDER_OF_BOTH}
    code = Code.ORDER_OF_POSITION
    if few:
        code, what["detail"] = Code.EXCHANGED_COLUMNS, "FORCE or POSITION"
    return (about_actuators(campaign.layout, code, moved, where, **what),)


def stiffness_of_shapes(moments: Moments) -> Array | None:
    """Return (n, n) commanded forces on displacements [N/m]; None if there are too few data."""
    counted = moments.weight > 0
    if moments.displacement is None:
        return None
    n, loads = moments.mean.shape[1], moments.labels[counted, 0]
    if len(np.unique(moments.labels[counted, 1])) < n - 3:
        return None
    # Both are as large as all means are: the decomposition takes their room.
    moved, force = np.asfortranarray(moments.displacement[counted]), moments.mean[counted]
    for load in np.unique(loads):
        some = loads == load
        force[some] -= force[some].mean(axis=0)
        moved[some] -= moved[some].mean(axis=0)
    rotated, upper = scipy.linalg.qr_multiply(moved, force.T, overwrite_a=True, overwrite_c=True)
    # All but piston and tilt, in which no shape needs stand.
    left, size, right = np.linalg.svd(upper)
    left, size, right = left[:, : n - 3], size[: n - 3], right[: n - 3]
    if len(size) < n - 3 or size[-1] <= 1e-9 * size[0]:
        return None
    return np.asarray(rotated @ (left / size) @ right)


def likeliest_order(stiffness: Array) -> NDArray[np.int64]:
    """Return (n,) the column of POSITION that belongs to each of FORCE."""
    size = np.abs(stiffness)
    return assignment(-np.log(np.maximum(size, 1e-12 * size.max())))


def same_columns(problem: Problem, moments: Moments) -> tuple[Finding, ...]:
    """Name pairs of actuators whose readings differ by no more than their noise in all shapes.

    Each alpha is another, and so are the forces of two actuators, even of neighbours.
    """
    variance, n = problem.noise.variance, problem.n
    rows = (moments.mean * np.sqrt(moments.weight)[:, None]).T
    apart = squared_differences(rows, rows) / (variance[:, None] + variance)
    limit = float(f_isf(FALSE_ALARM / n**2, moments.groups, moments.repeats or 1e9))
    shaken = np.sum(rows**2, axis=1) / variance > MIN_VARIANCE_RATIO * limit * moments.groups
    same = (apart <= limit * moments.groups) & shaken[:, None] & shaken
    return tuple(
        about_actuators(problem.campaign.layout, Code.SAME_READINGS, [i, j])
        for i, j in np.argwhere(np.triu(same, 1)).tolist()
    )


def campaign_warnings(problem: Problem, moments: Moments, minimum: Minimum) -> Iterator[Finding]:
    """Warn of weights, dates, noise and sensors that do not agree."""
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
    if known and louder > 1.0 and in_newton:
        yield from unlike_declared(1e3 * moments.noise, louder)
    reset = np.isnan(moments.reference)
    if reset.any() and any(map(is_displaced, problem.campaign.cycles)):
        reset &= ~still_sensors(problem.campaign).any(axis=0)  # of those that move at all
        if reset.any():
            yield Finding.of(Code.ZEROS_RESET, sensors=int(np.count_nonzero(reset)))


def unlike_declared(noise: float, ratio: float) -> Iterator[Finding]:
    """Warn that FORCERR is wrong, from the noise of a reading [mN] and its ratio to FORCERR."""
    if ratio > MIN_SCATTER_RATIO:
        yield Finding.of(Code.NOISE_ABOVE_DECLARED, noise=noise, ratio=ratio)
    elif ratio < 1.0 / MIN_SCATTER_RATIO:
        yield Finding.of(Code.NOISE_BELOW_DECLARED, noise=noise, ratio=ratio)


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
    """Warn of a WEIGHT that the actuators cannot have held, or that the magnets were not made for.

    Shapes take several times the share of an actuator in the weight, and bias magnets are made to
    bear about that weight. Alpha depends only on differences between loads, unless they tilt.
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
    """Warn that forces come in steps, if that makes most of their noise."""
    noise, repeats = problem.noise, moments.rows.sum() / moments.groups
    rounding, variance = float(np.mean(moments.rounding)), noise.seen + noise.hidden / repeats
    if noise.source == NoiseSource.MINIMUM or 2 * rounding < variance.mean():
        return
    step = 1e3 * float(np.sqrt(np.mean(np.square(moments.step))))
    yield Finding.of(Code.FORCE_STEPS, step=step, noise=step / np.sqrt(12))
