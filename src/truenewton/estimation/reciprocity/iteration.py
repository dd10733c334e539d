"""Iteration to the most likely unknowns."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from truenewton.arrays import Array
from truenewton.errors import NotConverged, RankDeficient
from truenewton.estimation.matrix.columns import SETTLED_STEP
from truenewton.estimation.reciprocity.information import (
    Fitted,
    Leverage,
    Point,
    States,
    Weights,
    designs,
    information,
    likeliest,
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
    sensors_at,
)
from truenewton.linalg import inverse_of_positive, thread_count, threads

MAX_STEPS = 60  # of the iteration

# Makes states and weights at given values of the unknowns.
StatesAt = Callable[[Places, Values, SensorModel], tuple[States, Weights]]


@dataclass(frozen=True, eq=False)
class Fit:
    """The most likely unknowns."""

    values: Values
    asked: Request  # the request, with the estimated spreads
    covariance: Array  # (u, u) where mean log alpha is 0, and mean log g if it is free
    chi2: tuple[float, float, float]  # of statics, rigid motions and reciprocity
    equations: tuple[int, int, int]  # number in each block
    leverage: Leverage | None  # of the equations; None if their weights are fixed
    point: Point  # everything else, at the most likely unknowns

    def covariance_of(self, kind: Kind) -> Array:
        """Return the (n, n) covariance of one kind of unknowns."""
        n, k = len(self.values.log_alpha), self.asked.kinds.index(kind)
        return self.covariance[k * n : (k + 1) * n, k * n : (k + 1) * n]

    @property
    def parameters(self) -> tuple[float, float, float]:
        """Number of unknowns that each block determines; NaN without leverages."""
        if self.leverage is None:
            return (np.nan,) * 3
        pairs = np.triu(self.leverage.reciprocity)
        parts = (self.leverage.statics, self.leverage.rigid, pairs)
        return tuple(float(part.sum()) for part in parts)  # type: ignore[return-value]

    @property
    def information(self) -> Array:
        """(u, u) information on the unknowns, with that of the spreads; scales are free."""
        whole = information(self.point)[0]
        whole[np.diag_indices(len(whole))] += self.asked.information(len(self.values.log_alpha))
        return whole

    @property
    def of_alpha(self) -> Fit:
        """The fit with only (u, n) of its covariance, which is large."""
        n = len(self.values.log_alpha)
        return replace(self, covariance=self.covariance[:, :n].copy())

    @property
    def reduced(self) -> tuple[float, float, float]:
        """chi2 of each block over its degrees of freedom."""
        return tuple(  # type: ignore[return-value]
            chi2 / max(count - taken, 1.0)
            for chi2, count, taken in zip(self.chi2, self.equations, self.parameters, strict=True)
        )


def point_at(places: Places, values: Values, asked: Request, states_at: StatesAt) -> Point:
    """Return everything at given values of the unknowns."""
    seen = sensors_at(places, values, slopes=bool(asked.offset_spread))
    states, weights = states_at(places, values, seen)
    fitted = likeliest(states, states.residuals, weights)
    made = designs(asked.kinds, values, seen, states, fitted, places.length)
    return Point(states, states.residuals, weights, fitted, made)


@threads(1)
def fit(
    places: Places,
    asked: Request,
    states_at: StatesAt,
    *,
    start: Values | None = None,
    told: Callable[[Leverage], None] | None = None,
    fixed: bool = False,
    until: float = SETTLED_STEP,
) -> Fit:
    """Return the most likely unknowns.

    ``states_at`` gives states and weights, ``start`` the first values (nominal by default), and
    ``told`` is called with the leverages after each step. ``fixed``: weights and spreads are fixed,
    and a factor is reused while steps become shorter. The iteration ends when a step,
    and what is left of steps that keep their ratio, are shorter than ``until``, relative to the
    error of alpha. Steps, and the covariance, are in single precision: the score determines where
    they end.

    Raises
    ------
    RankDeficient
        The data do not determine all unknowns.
    NotConverged
    """
    values = at_nominal(places.n) if start is None else start
    n, before = places.n, None
    size = last = np.inf
    single = True
    for step in range(MAX_STEPS):
        point = point_at(places, values, asked, states_at)
        known = asked.information(n)
        if not (fixed and step and size < 0.25 * last):  # a kept factor serves while steps shorten
            covariance, leverage = _covariance(point, asked, known, before, single=single)
            single = covariance.dtype == np.float32  # where that fails once, it does again
        before = None if fixed else Fitted(covariance, point.weights)
        if leverage is not None and told is not None:
            told(leverage)
        gradient = score(point) + known * asked.vector(values)
        move = -(covariance @ gradient.astype(covariance.dtype)).astype(float)
        error = np.sqrt(np.mean(np.diag(covariance)[:n]))
        last, size = size, float(np.sqrt(np.mean(move[:n] ** 2)))
        rest = size**2 / max(last - size, 1e-3 * size, 1e-300)  # if steps keep their ratio
        settled = step > 0 and max(size, rest) < until * error
        logs = move[: n * sum(kind not in OFFSETS for kind in asked.kinds)]
        move = move * min(1.0, 0.3 / max(float(np.abs(logs).max()), 1e-300))
        values = asked.moved(values, move)
        if settled:
            return _fit(values, asked, covariance, point, leverage)
        if asked.estimated:
            asked = _with_spreads(asked, values, covariance)
        del point  # the next one needs its memory
    raise NotConverged(
        f"reciprocity has not settled after {MAX_STEPS} steps",
        remedy="check gains and positions of the sensors",
    )


@threads(1)
def in_double(fitted: Fit) -> Fit:
    """Return a fit with its covariance in double precision. Raises RankDeficient."""
    if fitted.covariance.dtype == np.float64:
        return fitted
    known = fitted.asked.information(len(fitted.values.log_alpha))
    covariance, _ = _covariance(fitted.point, fitted.asked, known, single=False)
    return replace(fitted, covariance=covariance)


def _covariance(
    point: Point, asked: Request, known: Array, before: Fitted | None = None, *, single: bool
) -> tuple[Array, Leverage | None]:
    """Return the covariance, with free scales at mean log 0, and leverages of the fit before."""
    held, leverage = information(point, before, single=single)
    n = len(point.states.readings)
    held[np.diag_indices(len(held))] += known
    held[:n, :n] += np.trace(held[:n, :n]) / n**2
    if np.isinf(asked.gain_spread):
        held[n : 2 * n, n : 2 * n] += np.trace(held[n : 2 * n, n : 2 * n]) / n**2
    try:
        with threads(thread_count()):
            inverse = inverse_of_positive(held, overwrite=True)
    except np.linalg.LinAlgError:
        if single:
            return _covariance(point, asked, known, before, single=False)
        raise RankDeficient(
            "reciprocity does not determine all unknowns",
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
) -> Fit:
    m = point.states.count
    return Fit(
        values=values,
        asked=asked,
        covariance=covariance,
        chi2=point.left.chi2(point.weights),
        equations=(3 * m, 3 * m, m * (m - 1) // 2),
        leverage=leverage,
        point=point,
    )


def _with_spreads(asked: Request, values: Values, covariance: Array) -> Request:
    """Return the request with the spreads of the data (MacKay).

    The information l = 1 / s^2 of a spread is the number of unknowns that the data determine, g = n
    - l tr(C), over the sum of their squares v'v. Both change with it, dv = -C v dl, dC = -C C dl:
    the step is that of Newton's method in log l.
    """
    n = len(values.log_alpha)
    # If data do not determine a spread, each step finds it smaller: below these it is none [-, m].
    for kinds, name, least in (
        ((Kind.GAIN,), "gain_spread", 1e-6),
        (OFFSETS, "offset_spread", 1e-8),
    ):
        size = getattr(asked, name)
        if not size or np.isinf(size):
            continue
        first = asked.kinds.index(kinds[0]) * n
        some = slice(first, first + n * len(kinds))
        c, v = covariance[some, some] / size**2, asked.vector(values)[some]
        square, determined = max(float(v @ v), 1e-300), max(len(v) - float(np.trace(c)), 1.0)
        away = np.log(determined * size**2 / square)
        rate = (
            1.0 - 2.0 * float(v @ c @ v) / square + float(np.trace(c) - np.sum(c**2)) / determined
        )
        # Far from the solution the rate is that of another curve: not far from the plain step.
        step = np.clip(away / max(rate, 0.1), away - 1.0, away + 1.0)
        asked = replace(asked, **{name: max(size * float(np.exp(-0.5 * step)), least)})
    return asked
