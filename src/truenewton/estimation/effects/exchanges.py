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

from dataclasses import replace

import numpy as np
import scipy.linalg
import scipy.optimize
from numpy.typing import NDArray

from truenewton.arrays import Array
from truenewton.errors import TrueNewtonError
from truenewton.estimation.diagnosis import FoundEffect, NoiseSource
from truenewton.estimation.effects.examination import chi2_probability
from truenewton.estimation.identifiability import centred_means
from truenewton.estimation.moments import Moments
from truenewton.estimation.problem import Problem, roughly_scaled
from truenewton.estimation.structure import FITS
from truenewton.statics.arms import arms_in_units_of_rms

PASSES = 30  # of the projection, each with what lies far left out
MOST = 0.25  # of the actuators: more are no exchange
NEARER = 0.5  # of the distance from its own place, to that of another
BETTER = 0.25  # of chi^2, where nothing tells what it should be


def exchanged_columns(problem: Problem, moments: Moments) -> tuple[FoundEffect, ...]:
    """Name actuators whose columns of FORCE are exchanged, by a fit that is bad as they stand.

    Parameters
    ----------
    problem, moments
        What was fitted, or could not be; all groups, also those that do not balance.
    """
    order = seen_order(problem, moments)
    moved = np.flatnonzero(order != np.arange(problem.n))
    if not moved.size or moved.size > MOST * problem.n:
        return ()
    back = replace(problem, moved=problem.moved + problem.a[:, order] - problem.a)
    probability, chi2 = _fit(back, moments)
    if problem.noise.source == NoiseSource.MINIMUM:
        if chi2 > BETTER * _fit(problem, moments)[1]:
            return ()
    elif probability < FITS:
        return ()
    layout = problem.campaign.layout
    ids = layout.id[layout.enabled][moved].tolist()
    far = np.hypot(*(problem.a[1:, order[moved]] - problem.a[1:, moved]))
    return (
        FoundEffect(
            name="exchanged columns",
            where=f"actuators {', '.join(map(str, ids[:-1]))} and {ids[-1]}",
            probability=_fit(problem, moments)[0],
            size=float(far.max()),
            unit="m",
            corrected=False,
            remedy="put the cables, or the columns of FORCE, in the order of the ACTUATORS table",
        ),
    )


def _fit(problem: Problem, moments: Moments) -> tuple[float, float]:
    """Return the probability of the balance of a fit, and its chi^2; 0 where there is none."""
    try:
        scaled = problem
        if problem.noise.source == NoiseSource.MINIMUM:
            scaled = roughly_scaled(problem, moments)
        chi2 = scaled.fitted(moments).chi2
    except TrueNewtonError:
        return 0.0, np.inf
    chi2 *= float(scaled.noise.variance.mean() / problem.noise.variance.mean())
    return chi2_probability(chi2, problem.degrees_of_freedom(moments), problem.noise), chi2


def seen_order(problem: Problem, moments: Moments) -> NDArray[np.int64]:
    """Return (n,) the actuator at whose place each is seen; itself, unless clearly at another."""
    n = problem.n
    arms = arms_in_units_of_rms(problem.campaign.layout)
    places = (arms[1:] / arms[0]).T
    seen = seen_places(problem, moments, arms)
    distance = np.linalg.norm(seen[:, None] - places, axis=2)
    usual = float(np.median(distance[np.arange(n), np.arange(n)]))
    order = scipy.optimize.linear_sum_assignment(np.minimum(distance, 1e6) ** 2)[1]
    own, best = distance[np.arange(n), np.arange(n)], distance[np.arange(n), order]
    clear = (best < NEARER * own) & (own > 5.0 * usual)
    if not clear[order[clear]].all():  # a circle is not closed
        return np.arange(n)
    return np.where(clear, order, np.arange(n))


def seen_places(problem: Problem, moments: Moments, arms: Array) -> Array:
    """Return (n, 2) where the forces of each actuator act, in the units of (3, n) arms."""
    n, sigma = problem.n, np.sqrt(problem.noise.variance)
    centred = centred_means(moments) / sigma
    vectors = scipy.linalg.eigh(centred.T @ centred, subset_by_index=(0, 2))[1]
    seen = (vectors / sigma[:, None]).T
    a = arms / np.linalg.norm(arms, axis=0)
    b = seen / np.maximum(np.linalg.norm(seen, axis=0), 1e-300)
    nothing = np.zeros(n)
    cross = np.array([[nothing, -b[2], b[1]], [b[2], nothing, -b[0]], [-b[1], b[0], nothing]])
    equations = np.einsum("uvi,wi->iuvw", cross, a).reshape(n, 3, 9)
    weight, away = np.ones(n), np.zeros((n, 2))
    for _ in range(PASSES):
        gram = np.einsum("i,iup,iuq->pq", weight, equations, equations, optimize=True)
        projection = np.linalg.eigh(gram)[1][:, 0].reshape(3, 3)
        found = np.linalg.pinv(projection) @ seen
        size = np.where(np.abs(found[0]) > 1e-9 * np.abs(found).max(), found[0], np.inf)
        away = (found[1:] / size - arms[1:] / arms[0]).T
        far = np.linalg.norm(away, axis=1)
        weight = 1.0 / (1.0 + (far / max(float(np.median(far)), 1e-12)) ** 2) ** 2
    return np.asarray(away + (arms[1:] / arms[0]).T)
