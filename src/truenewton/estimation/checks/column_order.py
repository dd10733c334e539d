"""Whether the columns of FORCE and POSITION belong to the actuators that they claim.

By the stiffness: forces on displacements over the shapes of a campaign give that of the glass, K,
but for the gain of each row (alpha) and of each column (the sensor). K is symmetric and not
negative, so K_ij^2 <= K_ii K_jj, and no permutation has a larger product |K_1p(1) ... K_np(n)| than
the diagonal; gains do not change which one is largest. So where another one is, FORCE stands in
that order.

By the balance: whatever the shapes, A diag(alpha) (c - c_mean) is no more than noise. Its three
rows span the directions in which centred readings do not stand. So the three least eigenvectors of
their second moment, scaled by the noise, are T A diag(alpha) with some T (3, 3): homogeneous
coordinates of where each actuator stands, seen in a projection of the plane. T follows from the
coordinates as the files have them, by least squares that leave out what lies far (direct linear
transformation); its inverse shows each actuator where its forces act. Two that are seen at each
other's place have their cables exchanged. It is said if the balance fits with the columns back in
order, and did not before.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import scipy
import scipy.linalg
from numpy.typing import NDArray

from truenewton.arrays import Array
from truenewton.errors import TrueNewtonError
from truenewton.estimation.effects.examination import chi2_probability
from truenewton.estimation.findings.catalogue import ORDER_OF_BOTH
from truenewton.estimation.findings.code import Code
from truenewton.estimation.findings.estimate import NoiseSource
from truenewton.estimation.findings.finding import MAX_NAMED_ACTUATORS, Finding, about_actuators
from truenewton.estimation.matrix.couplings import MIN_PLACED_ACTUATORS, misplaced, projected
from truenewton.estimation.paper.identifiability import centred_means
from truenewton.estimation.problem import Problem, roughly_scaled
from truenewton.estimation.readings.moments import Moments
from truenewton.estimation.screening.noise import MIN_FIT_PROBABILITY
from truenewton.linalg import assignment, asymmetry
from truenewton.records.campaign import Campaign
from truenewton.statics.arms import arms_in_units_of_rms

MIN_SHAPE_ASYMMETRY = 0.2  # asymmetry of the stiffness in terms of its size
MAX_REMAINING_ASYMMETRY = 0.5  # of it, which the better order leaves at most
MIN_LOG_GAIN_OF_ORDER = np.log(1.5)  # larger each element of a better order is, on the average


def misordered_columns(campaign: Campaign, moments: Moments) -> tuple[Finding, ...]:
    """Name an order of FORCE that POSITION contradicts.

    Nothing is said where POSITION is not at hand, or shapes are too few for a stiffness.
    """
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
    code, detail = (
        (Code.EXCHANGED_COLUMNS, "FORCE or POSITION") if few else (Code.ORDER_OF_POSITION, "")
    )
    return (
        about_actuators(
            campaign.layout,
            code,
            moved,
            where,
            many="columns",
            detail=detail,
            size=before,
            remedy=ORDER_OF_BOTH,
        ),
    )


def stiffness_of_shapes(moments: Moments) -> Array | None:
    """Return (n, n) commanded forces on displacements [N/m]; None where the data do not hold it."""
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


MIN_SHAPE_TO_NOISE = 2.0  # times its noise the weakest elastic shape must stand
MAX_ORDER_PASSES = 10  # passes of the order
HOME_SPACING_FRACTION = 0.1  # of the spacing of the actuators: nearer, they are seen at home
TURN_COUNT, TRIED_TURNS = 72, 4  # of the places as a whole; the best of these
MAX_COORDINATE = 10.0  # in units of the rms coordinate, beyond which one place is as bad as another
MIN_DISTANCE_RATIO = 3.0  # times as far from its own place as all are from where they are seen
MAX_ALPHA_FACTOR = 10.0  # alphas of a fit that counts lie within this factor
MAX_CHI2_RATIO = 0.25  # of chi^2, where nothing tells what it should be


def exchanged_columns(problem: Problem, moments: Moments) -> tuple[Finding, ...]:
    """Name actuators that stand elsewhere, or whose columns of FORCE are exchanged.

    Nothing is said unless the balance is bad as they stand, and good or far better in their place.

    Parameters
    ----------
    problem, moments
        What was fitted, or could not be; all groups, also those that do not balance.
    """
    (probability, chi2), layout = _fit(problem, moments), problem.campaign.layout
    unknown = problem.noise.source == NoiseSource.MINIMUM
    if not unknown and probability > MIN_FIT_PROBABILITY:
        return ()  # single rows lie far, no more
    seen = _homogeneous(problem, moments)
    if seen is None:
        return ()
    elsewhere = misplaced(seen, problem.a) if problem.n >= MIN_PLACED_ACTUATORS else {}
    places = problem.a.copy()
    for i, place in elsewhere.items():
        places[1:, i] = place
    if elsewhere and _fit_at(problem, moments, places)[1] <= MAX_CHI2_RATIO * chi2:
        return tuple(
            about_actuators(
                layout,
                Code.MISPLACED_ACTUATOR,
                [i],
                f"{{}}, about x = {x:.3g}, y = {y:.3g} m",
                probability=probability,
                size=float(np.hypot(x - problem.a[1, i], y - problem.a[2, i])),
                unit="m",
            )
            for i, (x, y) in elsewhere.items()
        )
    for order in seen_orders(problem, seen):
        moved, places = np.flatnonzero(order != np.arange(problem.n)), problem.a[:, order]
        if not moved.size:
            continue
        there = _fit_at(problem, moments, places)
        if there[1] < MAX_CHI2_RATIO * chi2 if unknown else there[0] > MIN_FIT_PROBABILITY:
            remedy = "command one of them alone: if another responds, exchange the cables and"
            remedy += " measure again; otherwise exchange the columns of FORCE"
            few = moved.size <= MAX_NAMED_ACTUATORS
            found = about_actuators(
                layout,
                Code.EXCHANGED_COLUMNS if few else Code.OTHER_ORDER,
                moved,
                many="columns",
                detail="FORCE",
                probability=probability,
                size=float(np.hypot(*(places - problem.a)[1:]).max()),
                unit="m",
                remedy=remedy,
            )
            return (found,)
    return ()


def _fit_at(problem: Problem, moments: Moments, places: Array) -> tuple[float, float]:
    """Return the same as `_fit`, with actuators at (3, n) other arms."""
    return _fit(replace(problem, moved=problem.moved + (places - problem.a)), moments)


def _fit(problem: Problem, moments: Moments) -> tuple[float, float]:
    """Return the probability of the balance of a fit, and its chi^2; 0 where there is none."""
    try:
        scaled = roughly_scaled(problem, moments)
        minimum = scaled.fitted(moments)
    except (TrueNewtonError, np.linalg.LinAlgError):
        return 0.0, np.inf
    alpha = np.maximum(np.abs(minimum.values[: problem.n]), 1e-300)
    if np.ptp(np.log(alpha)) > np.log(MAX_ALPHA_FACTOR):  # a fit of forces that vanish
        return 0.0, np.inf
    chi2 = minimum.chi2 * float(scaled.noise.variance.mean() / problem.noise.variance.mean())
    return chi2_probability(chi2, problem.degrees_of_freedom(moments), problem.noise), chi2


def seen_orders(problem: Problem, seen: Array) -> Iterator[NDArray[np.int64]]:
    """Yield (n,) the actuator at whose place each is seen, itself unless clearly at another.

    First as most stand at their own place; then whatever order shows the layout best.
    """
    arms = arms_in_units_of_rms(problem.campaign.layout)
    places, itself = (arms[1:] / arms[0]).T, np.arange(problem.n)
    distance, order = _settled(seen, arms, itself)
    own, best = distance[itself, itself], distance[itself, order]
    clear = (order != itself) & (own > MIN_DISTANCE_RATIO * np.median(best))
    if clear[order[clear]].all():  # else a circle is not closed
        yield np.where(clear, order, itself)
    yield order
    spacing = np.sort(np.linalg.norm(places[:, None] - places, axis=2), axis=1)[:, 1]
    at_home = np.median(own) < HOME_SPACING_FRACTION * np.median(spacing)
    if at_home or problem.noise.source == NoiseSource.MINIMUM:  # nothing tells whether that fits
        return
    answers = []
    for start in _turned(seen, places):
        distance, order = _settled(seen, arms, start)
        answers.append((float(np.median(distance[itself, order])), order))
    least = min(size for size, _ in answers)
    alike = [order for size, order in answers if size <= 2.0 * least]
    yield max(alike, key=lambda order: np.count_nonzero(order == itself))


def _settled(seen: Array, arms: Array, order: NDArray[np.int64]) -> tuple[Array, NDArray[np.int64]]:
    """Return (n, n) distances of places seen from places, and the order that these settle at."""
    places = (arms[1:] / arms[0]).T
    for _ in range(MAX_ORDER_PASSES):
        distance = np.linalg.norm(projected(seen, arms[:, order])[:, None] - places, axis=2)
        before, order = order, assignment(np.minimum(distance, MAX_COORDINATE) ** 2)
        if np.array_equal(order, before):
            break
    return distance, order


def _turned(seen: Array, places: Array) -> Iterator[NDArray[np.int64]]:
    """Yield the orders in which places seen, turned or mirrored as a whole, are most like places.

    If alpha were the same for all, (n, 2) places were (3, n) seen but for a linear map, and a turn
    once both have unit moments.
    """
    flat = np.linalg.lstsq(seen.T, np.ones(len(places)), rcond=None)[0] @ seen
    whole = np.linalg.svd(seen / flat)[2]  # one row of its span is that of ones
    across = scipy.linalg.null_space(np.ones((1, len(places))) @ whole[:3].T).T @ whole[:3]
    of_places = np.linalg.svd((places - places.mean(axis=0)).T, full_matrices=False)[2].T
    tree, turns = scipy.spatial.cKDTree(of_places), []
    for angle in np.linspace(0.0, 2.0 * np.pi, TURN_COUNT, endpoint=False):
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        for mirror in (1.0, -1.0):
            turned = (turn @ (across * np.array([[1.0], [mirror]]))).T
            turns.append((float(np.mean(tree.query(turned)[0] ** 2)), turned))
    turns.sort(key=lambda one: one[0])
    for _, turned in turns[:TRIED_TURNS]:
        yield assignment(np.linalg.norm(turned[:, None] - of_places, axis=2) ** 2)


def _homogeneous(problem: Problem, moments: Moments) -> Array | None:
    """Return (3, n) T A diag(alpha), with some (3, 3) T; None where more than these drowns."""
    sigma = np.sqrt(problem.noise.variance)
    centred = centred_means(moments) / sigma
    values, vectors = scipy.linalg.eigh(centred.T @ centred, subset_by_index=(0, 3))
    noise = max(float(values[:3].mean()), 1e-13 * float(np.sum(centred**2)))
    if problem.noise.source != NoiseSource.MINIMUM:
        noise = max(noise, float(len(centred)))
    if values[3] < MIN_SHAPE_TO_NOISE * noise:
        return None
    return np.asarray((vectors[:, :3] / sigma[:, None]).T)
