"""Columns of FORCE that were exchanged: cables at the sockets of others.

Whatever the shapes, A diag(alpha) (c - c_mean) is no more than noise: its three rows span the
directions in which centred readings do not stand. So the three least eigenvectors of their second
moment, scaled by the noise, are T A diag(alpha) with some T (3, 3): homogeneous coordinates of
where each actuator stands, seen in a projection of the plane. T follows from the coordinates as the
files have them, by least squares that leave out what lies far (direct linear transformation); its
inverse shows each actuator where its forces act. Two that are seen at each other's place have their
cables exchanged. It is said if the balance fits with the columns back in order, and did not before.
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
from truenewton.estimation.diagnosis import NoiseSource
from truenewton.estimation.effects.examined import chi2_probability
from truenewton.estimation.findings.code import Code
from truenewton.estimation.findings.finding import Finding
from truenewton.estimation.identifiability import centred_means
from truenewton.estimation.moments import Moments
from truenewton.estimation.problem import Problem, roughly_scaled
from truenewton.estimation.seen_places import FEWEST, out_of_place, projected
from truenewton.estimation.structure import FITS
from truenewton.linalg import assignment
from truenewton.rounding import named
from truenewton.statics.arms import arms_in_units_of_rms

ABOVE = 2.0  # times its noise the weakest elastic shape must stand
SETTLED = 10  # passes of the order
HOME = 0.1  # of the spacing of the actuators: nearer, they are seen at their own places
TURNS, TRIED = 72, 4  # of the places as a whole; the best of these
FEW = 4  # actuators that are named one by one
FAR = 10.0  # in units of the rms coordinate, beyond which one place is as bad as another
CLEARLY = 3.0  # times as far from its own place as all are from where they are seen
ALIKE = 10.0  # alphas of a fit that counts lie within this factor
BETTER = 0.25  # of chi^2, where nothing tells what it should be


def exchanged_columns(problem: Problem, moments: Moments) -> tuple[Finding, ...]:
    """Name actuators whose columns of FORCE are exchanged, by a fit that is bad as they stand.

    Parameters
    ----------
    problem, moments
        What was fitted, or could not be; all groups, also those that do not balance.
    """
    if problem.noise.source != NoiseSource.MINIMUM and _fit(problem, moments)[0] > FITS:
        return ()  # single rows lie far, no more
    if misplaced := _misplaced(problem, moments):
        return misplaced
    for order in seen_orders(problem, moments):
        moved = np.flatnonzero(order != np.arange(problem.n))
        if moved.size and _cures(problem, moments, order):
            return (_named(problem, moments, order, moved),)
    return ()


def _misplaced(problem: Problem, moments: Moments) -> tuple[Finding, ...]:
    """Name actuators that stand at no place of the layout, if the balance is better where seen."""
    layout, seen = problem.campaign.layout, _homogeneous(problem, moments)
    if seen is None or problem.n < FEWEST:
        return ()
    on = layout.enabled
    moved = out_of_place(seen, problem.a)
    if not moved:
        return ()
    back, at = np.zeros((3, problem.n)), list(moved)
    back[1:, at] = np.array([moved[i] for i in at]).T - problem.a[1:, at]
    there = replace(problem, moved=problem.moved + back)
    probability, chi2 = _fit(problem, moments)
    if _fit(there, moments)[1] > BETTER * chi2:
        return ()
    return tuple(
        Finding(
            code=Code.MISPLACED_ACTUATOR,
            where=f"actuator {layout.id[on][i]}, about x = {x:.3g}, y = {y:.3g} m",
            actuators=(int(layout.id[on][i]),),
            probability=probability,
            size=float(np.hypot(x - layout.x[on][i], y - layout.y[on][i])),
            unit="m",
            remedy="correct X and Y in that row of ACTUATORS, in m",
        )
        for i, (x, y) in moved.items()
    )


def _cures(problem: Problem, moments: Moments, order: NDArray[np.int64]) -> bool:
    """Tell whether the balance fits if columns are those of other actuators."""
    back = replace(problem, moved=problem.moved + (problem.a[:, order] - problem.a))
    probability, chi2 = _fit(back, moments)
    if problem.noise.source == NoiseSource.MINIMUM:
        return chi2 < BETTER * _fit(problem, moments)[1]
    return probability > FITS


def _named(
    problem: Problem, moments: Moments, order: NDArray[np.int64], moved: NDArray[np.int64]
) -> Finding:
    layout, few = problem.campaign.layout, moved.size <= FEW
    ids = layout.id[layout.enabled][moved].tolist()
    far = np.hypot(*(problem.a[1:, order[moved]] - problem.a[1:, moved]))
    return Finding(
        code=Code.EXCHANGED_COLUMNS if few else Code.OTHER_ORDER,
        detail="FORCE",
        where=named("actuator", ids, FEW) if few else f"{moved.size} of {problem.n} columns",
        actuators=tuple(ids),
        probability=_fit(problem, moments)[0],
        size=float(far.max()),
        unit="m",
        remedy="command one of them alone: if another responds, exchange the cables and measure"
        " again; otherwise exchange the columns of FORCE",
    )


def _fit(problem: Problem, moments: Moments) -> tuple[float, float]:
    """Return the probability of the balance of a fit, and its chi^2; 0 where there is none."""
    try:
        scaled = problem
        if problem.noise.source == NoiseSource.MINIMUM:
            scaled = roughly_scaled(problem, moments)
        minimum = scaled.fitted(moments)
    except (TrueNewtonError, np.linalg.LinAlgError):
        return 0.0, np.inf
    alpha = np.abs(minimum.values[: problem.n])
    if np.ptp(np.log(np.maximum(alpha, 1e-300))) > np.log(ALIKE):  # a fit of forces that vanish
        return 0.0, np.inf
    chi2 = minimum.chi2 * float(scaled.noise.variance.mean() / problem.noise.variance.mean())
    return chi2_probability(chi2, problem.degrees_of_freedom(moments), problem.noise), chi2


def seen_orders(problem: Problem, moments: Moments) -> Iterator[NDArray[np.int64]]:
    """Yield (n,) the actuator at whose place each is seen, itself unless clearly at another.

    First as most stand at their own place; then whatever order shows the layout best.
    """
    arms = arms_in_units_of_rms(problem.campaign.layout)
    places, seen = (arms[1:] / arms[0]).T, _homogeneous(problem, moments)
    if seen is None:
        return
    itself = np.arange(problem.n)
    distance, order = _settled(seen, arms, itself)
    own, best = distance[itself, itself], distance[itself, order]
    clear = (order != itself) & (own > CLEARLY * np.median(best))
    if clear[order[clear]].all():  # else a circle is not closed
        yield np.where(clear, order, itself)
    yield order
    spacing = np.sort(np.linalg.norm(places[:, None] - places, axis=2), axis=1)[:, 1]
    at_home = np.median(own) < HOME * np.median(spacing)
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
    for _ in range(SETTLED):
        distance = np.linalg.norm(projected(seen, arms[:, order])[:, None] - places, axis=2)
        before = order
        order = assignment(np.minimum(distance, FAR) ** 2)
        if np.array_equal(order, before):
            break
    return distance, order


def _turned(seen: Array, places: Array) -> list[NDArray[np.int64]]:
    """Return the orders in which places seen, turned or mirrored as a whole, are most like places.

    If alpha were the same for all, (n, 2) places were (3, n) seen but for a linear map, and a turn
    once both have unit moments.
    """
    flat = np.linalg.lstsq(seen.T, np.ones(len(places)), rcond=None)[0] @ seen
    whole = np.linalg.svd(seen / flat)[2]  # one row of its span is that of ones
    across = scipy.linalg.null_space(np.ones((1, len(places))) @ whole[:3].T).T @ whole[:3]
    of_places = np.linalg.svd((places - places.mean(axis=0)).T, full_matrices=False)[2]
    tree = scipy.spatial.cKDTree(of_places.T)
    turns = []
    for angle in np.linspace(0.0, 2.0 * np.pi, TURNS, endpoint=False):
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        for mirror in (1.0, -1.0):
            turned = (turn @ (across * np.array([[1.0], [mirror]]))).T
            turns.append((float(np.mean(tree.query(turned)[0] ** 2)), turned))
    turns.sort(key=lambda one: one[0])
    apart = [np.linalg.norm(turned[:, None] - of_places.T, axis=2) for _, turned in turns[:TRIED]]
    return [assignment(d**2) for d in apart]


def _homogeneous(problem: Problem, moments: Moments) -> Array | None:
    """Return (3, n) T A diag(alpha), with some (3, 3) T; None where more than these drowns."""
    sigma = np.sqrt(problem.noise.variance)
    centred = centred_means(moments) / sigma
    values, vectors = scipy.linalg.eigh(centred.T @ centred, subset_by_index=(0, 3))
    noise = max(float(values[:3].mean()), 1e-13 * float(np.sum(centred**2)))
    if problem.noise.source != NoiseSource.MINIMUM:
        noise = max(noise, float(len(centred)))
    if values[3] < ABOVE * noise:
        return None
    return np.asarray((vectors[:, :3] / sigma[:, None]).T)
