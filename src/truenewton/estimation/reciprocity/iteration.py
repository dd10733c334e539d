"""Steps to the likeliest unknowns."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from truenewton.arrays import Array
from truenewton.errors import NotConverged, RankDeficient
from truenewton.estimation.reciprocity.information import (
    Fitted,
    Leverage,
    Point,
    States,
    Weights,
    designs,
    information,
    likeliest,
    residuals,
    score,
)
from truenewton.estimation.reciprocity.sensor_model import (
    OFFSETS,
    Kind,
    Places,
    Request,
    SensorModel,
    Values,
    at_nominal,
    sight,
)
from truenewton.linalg import inverse_of_positive, thread_count, threads

MAX_STEPS = 40
SETTLED_STEP = 0.02  # rms step of alpha over its rms error
# Spreads of log g and of offsets [m] below which they are none: where data do not hold them, each
# step would find them smaller.
MIN_GAIN_SPREAD, MIN_OFFSET_SPREAD = 1e-6, 1e-8
MIN_STEP_RATIO = 0.5  # ratio of successive steps of log spread, from which on they are extrapolated
MAX_EXTRAPOLATION = 0.7  # of a log spread

# What makes states and weights at a place of the unknowns, told of leverages once they are known.
StatesAt = Callable[[Places, Values, SensorModel], tuple[States, Weights]]


@dataclass(frozen=True, eq=False)
class Fit:
    """The likeliest unknowns.

    Attributes
    ----------
    values, asked
        The unknowns; what was asked, with the spreads that the data gave.
    covariance
        (u, u) where mean log alpha is 0, and mean log g where it is free.
    chi2, equations
        Weighted sum of squares of statics, rigid motions and reciprocity; number of each.
    parameters
        (3,) how many unknowns each block determines; NaN where leverages were not asked for.
    point
        All else, at the likeliest unknowns.
    steps
        Taken.
    """

    values: Values
    asked: Request
    covariance: Array
    chi2: tuple[float, float, float]
    equations: tuple[int, int, int]
    parameters: tuple[float, float, float]
    point: Point
    steps: int

    def covariance_of(self, kind: Kind) -> Array:
        """Return the (n, n) covariance of one kind of unknowns."""
        n, k = len(self.values.log_alpha), self.asked.kinds.index(kind)
        return self.covariance[k * n : (k + 1) * n, k * n : (k + 1) * n]

    @property
    def information(self) -> Array:
        """(u, u) of the unknowns, that of the spreads added; free scales are left free."""
        whole = information(self.point)[0]
        whole[np.diag_indices(len(whole))] += self.asked.information(len(self.values.log_alpha))
        return whole

    @property
    def of_alpha(self) -> Fit:
        """The fit without the covariance of the sensors, (u, n): that of u unknowns is large."""
        n = len(self.values.log_alpha)
        return replace(self, covariance=self.covariance[:, :n].copy())

    @property
    def asked_again(self) -> Request:
        """What was asked, the spreads taken for known."""
        return replace(self.asked, estimated=False)

    @property
    def reduced(self) -> tuple[float, float, float]:
        """chi2 of each block over its degrees of freedom."""
        return tuple(  # type: ignore[return-value]
            chi2 / max(count - taken, 1.0)
            for chi2, count, taken in zip(self.chi2, self.equations, self.parameters, strict=True)
        )


def point_at(places: Places, values: Values, asked: Request, states_at: StatesAt) -> Point:
    """Return all that is known at a place of the unknowns."""
    seen = sight(places, values, slopes=bool(asked.offset_spread))
    states, weights = states_at(places, values, seen)
    left = residuals(states)
    fitted = likeliest(states, left, weights)
    made = designs(asked.kinds, values, seen, states, fitted, places.length)
    return Point(states, left, weights, fitted, made)


@threads(1)
def fit(
    places: Places,
    asked: Request,
    states_at: StatesAt,
    *,
    start: Values | None = None,
    told: Callable[[Leverage], None] | None = None,
    fixed: bool = False,
) -> Fit:
    """Find the likeliest unknowns.

    Parameters
    ----------
    places
        Of the actuators.
    asked
        What is asked.
    states_at
        Gives states and weights.
    start
        Where to begin; at nominal values unless given.
    told
        Is told the leverages after each step.
    fixed
        Weights and spreads stay as they are. One factor serves as long as steps become short, and
        leverages are not asked for.

    Notes
    -----
    Steps are taken in single precision: the score says where they end. The covariance is made in
    double precision at the end, unless weights are fixed.

    Raises
    ------
    RankDeficient
        The data do not hold all that is asked.
    NotConverged
    """
    values = at_nominal(places.n) if start is None else start
    before: Fitted | None = None
    size = last = np.inf
    paces = dict[str, float]()
    for step in range(MAX_STEPS):
        point = point_at(places, values, asked, states_at)
        known = asked.information(places.n)
        if not (fixed and step and size < 0.25 * last):  # a kept factor serves while steps shorten
            covariance, leverage = _covariance(point, asked, before, single=True)
        before = None if fixed else Fitted(covariance, point.weights)
        if leverage is not None and told is not None:
            told(leverage)
        move = -covariance @ (score(point) + known * asked.vector(values))
        n = places.n
        error = np.sqrt(np.mean(np.diag(covariance)[:n]))
        last, size = size, float(np.sqrt(np.mean(move[:n] ** 2)))
        settled = step > 0 and size < SETTLED_STEP * error
        logs = move[: n * sum(kind not in OFFSETS for kind in asked.kinds)]
        move = move * min(1.0, 0.3 / max(float(np.abs(logs).max()), 1e-300))
        values = asked.moved(values, move)
        if settled:
            if not fixed:
                before, covariance = None, np.empty(0)  # their memory is needed
                covariance, _ = _covariance(point, asked, single=False)
            return _fit(values, asked, covariance, point, leverage, step + 1)
        if asked.estimated:
            found = _with_spreads(asked, values, covariance)
            asked, paces = _extrapolated(asked, found, paces)
    raise NotConverged(
        f"reciprocity has not settled after {MAX_STEPS} steps",
        remedy="check gains and positions of the sensors",
        got=size / float(error),
        want=SETTLED_STEP,
    )


def _covariance(
    point: Point, asked: Request, before: Fitted | None = None, *, single: bool
) -> tuple[Array, Leverage | None]:
    """Return the covariance, and the leverages of a fit before.

    The free scales are held at mean log 0.
    """
    held, leverage = information(point, before, single=single)
    n = len(point.states.readings)
    held[np.diag_indices(len(held))] += asked.information(n)
    held[:n, :n] += np.trace(held[:n, :n]) / n**2
    if np.isinf(asked.gain_spread):
        held[n : 2 * n, n : 2 * n] += np.trace(held[n : 2 * n, n : 2 * n]) / n**2
    try:
        with threads(thread_count()):
            inverse = inverse_of_positive(held, overwrite=True)
    except np.linalg.LinAlgError:
        if single:
            return _covariance(point, asked, before, single=False)
        raise RankDeficient(
            "reciprocity does not hold all that is asked of it",
            remedy="give the sensor gains",
        ) from None
    for k in range(2 if np.isinf(asked.gain_spread) else 1):  # what holds the scale is no knowledge
        some = slice(k * n, (k + 1) * n)
        inverse[some] -= inverse[some].mean(axis=0)
        inverse[:, some] -= inverse[:, some].mean(axis=1, keepdims=True)
    return inverse, leverage


def _fit(
    values: Values,
    asked: Request,
    covariance: Array,
    point: Point,
    leverage: Leverage | None,
    steps: int,
) -> Fit:
    m = point.states.count
    taken = (np.nan,) * 3
    if leverage is not None:
        pairs = np.triu(leverage.reciprocity)
        taken = (leverage.statics.sum(), leverage.rigid.sum(), pairs.sum())
    return Fit(
        values=values,
        asked=asked,
        covariance=covariance,
        chi2=point.left.chi2(point.weights),
        equations=(3 * m, 3 * m, m * (m - 1) // 2),
        parameters=tuple(map(float, taken)),  # type: ignore[arg-type]
        point=point,
        steps=steps,
    )


def _with_spreads(asked: Request, values: Values, covariance: Array) -> Request:
    """Return what is asked with the spreads that the data give (MacKay).

    sum v^2 over the number of unknowns less what the prior, not the data, says of them.
    """
    n = len(values.log_alpha)
    for names, spread, least in (
        ((Kind.GAIN,), "gain_spread", MIN_GAIN_SPREAD),
        (OFFSETS, "offset_spread", MIN_OFFSET_SPREAD),
    ):
        size = getattr(asked, spread)
        if not size or np.isinf(size):
            continue
        total, held = 0.0, 0.0
        for kind in names:
            k = asked.kinds.index(kind)
            total += float(np.sum(values.of(kind) ** 2))
            held += (
                n - float(np.trace(covariance[k * n : (k + 1) * n, k * n : (k + 1) * n])) / size**2
            )
        found = max(float(np.sqrt(total / max(held, 1.0))), least)
        asked = replace(asked, **{spread: found})  # type: ignore[arg-type]
    return asked


def _extrapolated(
    asked: Request, found: Request, paces: dict[str, float]
) -> tuple[Request, dict[str, float]]:
    """Return spreads where a series of them leads (Aitken), and the steps of their logarithms.

    Where sensors scatter less than the data can tell, each spread found is only a little less than
    the one before. After an extrapolated step, the next is taken as it is.
    """
    now = dict[str, float]()
    for name in ("gain_spread", "offset_spread"):
        before, after = getattr(asked, name), getattr(found, name)
        if not before or np.isinf(before):
            continue
        step = float(np.log(after / before))
        ratio = step / paces[name] if paces.get(name) else 0.0
        if MIN_STEP_RATIO < ratio < 1.0:
            further = np.clip(step * ratio / (1.0 - ratio), -MAX_EXTRAPOLATION, MAX_EXTRAPOLATION)
            found = replace(found, **{name: after * float(np.exp(further))})
        else:
            now[name] = step
    return found, now
