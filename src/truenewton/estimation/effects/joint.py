"""A fit together with effects of the bench: one linear mixed model, one covariance.

The parameters theta of all effects in a fit are unknowns besides alpha, with a normal prior about 0
of a spread tau for each effect. At every theta the data without the effects are fitted as usual
(`Derivative.remove`), and theta takes a Newton step with its score and information, all else being
free. The data determine tau (MacKay 1992, Neural Computation 4, 415; restricted maximum
likelihood): with C the covariance of theta,

    tau^2 <- sum theta^2 / nu,        nu = sum (1 - C_ii / tau^2).

Whether the data support an effect is its gain, twice the logarithm of the marginal likelihood with
it over that without it. It follows from the fit with it, of prior covariance T and posterior mean
theta and covariance C, by the ratio of Savage and Dickey (Dickey 1971, Ann. Math. Stat. 42, 204):

    theta' C^-1 theta + log det C - log det T.

Zeros of each actuator in each file have two spreads: one of their sums over actuators, weighted as
forces, and one of all else. A sum moves the common scale, and zeros that all actuators share move
it most.

A spread found from nu parameters is uncertain, and theta with it: its distribution is Student's t
(Box and Tiao 1973, Bayesian Inference in Statistical Analysis, 2.7). So C of the result has tau^2
larger by (t_nu / 1.96)^2, with the limits of 95 % of both distributions. Alpha moves by -B' theta
(`derivative`), and B' C B is added to its covariance, in every later fit (`Problem.with_error`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from truenewton.arrays import Array
from truenewton.chance import normal_isf, t_isf
from truenewton.errors import NotConverged, RankDeficient
from truenewton.estimation.effects.catalogue import Effect, removed
from truenewton.estimation.effects.derivative import Derivative, FittedRows, Scored, scored
from truenewton.estimation.findings.estimate import NoiseSource
from truenewton.estimation.likelihood import Minimum
from truenewton.estimation.problem import Problem
from truenewton.estimation.readings.moments import Moments, reading_noise
from truenewton.linalg import inverse_of_positive

MIN_DETERMINED = 0.3  # parameters of an effect; with fewer, its gain is below 1
MAX_PARAMETERS = 10_000  # a matrix of them takes 0.8 GB, and several are needed


@dataclass(frozen=True, eq=False)
class Spreads:
    """Parameters (k,) whose prior has one variance, or one more along a direction.

    (1,) of all parameters; or (2,) of all else, and of those along the direction.
    """

    count: int  # k
    unit: Array | None  # (n,) the direction of parameters (K, n) of each actuator, of length 1

    @classmethod
    def of(cls, derivative: Derivative) -> Spreads:
        """Return the components of the parameters of an effect."""
        along = derivative.direction
        return cls(derivative.count, None if along is None else along / np.linalg.norm(along))

    def along(self, values: Array) -> Array:
        """Return (K,) parameters along the direction of (k,), or (K, K) of a (k, k) matrix."""
        assert self.unit is not None  # asked only of effects with a direction
        n = len(self.unit)
        each = values.reshape((len(values) // n, n) * values.ndim) @ self.unit
        return np.asarray(each if values.ndim == 1 else np.einsum("kil,i->kl", each, self.unit))

    def _parts(self, whole: float, along: float) -> Array:
        return np.array([whole] if self.unit is None else [whole - along, along])

    def sizes(self) -> Array:
        """Return the (1,) or (2,) number of parameters of each component."""
        files = 0.0 if self.unit is None else self.count / len(self.unit)
        return self._parts(self.count, files)

    def squares(self, theta: Array) -> Array:
        """Return the (1,) or (2,) sum of the squares of (k,) parameters of each component."""
        along = 0.0 if self.unit is None else float(np.sum(self.along(theta) ** 2))
        return self._parts(float(theta @ theta), along)

    def precision(self, variances: Array) -> Array:
        """Return the (k, k) inverse of the prior covariance."""
        diagonal = np.diag(np.full(self.count, 1.0 / variances[0]))
        if self.unit is None:
            return diagonal
        apart = 1.0 / variances[1] - 1.0 / variances[0]
        files = np.eye(self.count // len(self.unit))
        return np.asarray(diagonal + np.kron(files, apart * np.outer(self.unit, self.unit)))

    def determined(self, covariance: Array, variances: Array) -> Array:
        """Return the (1,) or (2,) nu of each component, from the (k, k) covariance."""
        along = 0.0 if self.unit is None else float(np.trace(self.along(covariance)))
        parts = self._parts(float(np.trace(covariance)), along)
        return np.asarray(self.sizes() - parts / variances)


@dataclass(frozen=True, eq=False)
class Part:
    """An effect in a fit."""

    effect: Effect
    spreads: Spreads
    variances: Array  # (1,) or (2,) tau^2 of its components
    theta: Array  # (k,) its parameters
    actuators: NDArray[np.intp] | None = None  # the actuators that have parameters, if only some
    seen: Array | float = 1e-3  # the largest nu of each component so far
    log_probability: float = 0.0  # of the test by which it came into the fit
    covariance: Array | None = None  # (k, k) of theta at the end
    gain: float = 0.0  # at the end

    @property
    def count(self) -> int:
        """Number of its parameters."""
        return len(self.theta)


@dataclass(frozen=True, eq=False)
class Joint:
    """A fit together with effects."""

    # The data without the effects and their fit, whose covariance includes that of the effects
    problem: Problem
    moments: Moments
    minimum: Minimum
    parts: tuple[Part, ...]
    at: FittedRows  # the rows of this fit
    scored: Scored  # score and information of the effects in it
    covariance: Array  # (k, k) of all their parameters
    effective_parameters: float  # number of these that the balance determined


def new_part(fit: FittedRows, effect: Effect, derivative: Derivative) -> Part | None:
    """Return an effect with a first spread from its score in a fit; None if it is too large.

    U U' = V + V T V of the effect, on the average.
    """
    if derivative.count > MAX_PARAMETERS:
        return None
    result = scored(fit, derivative)
    score, variance = result.score, result.variance
    size = np.trace(variance) / np.sum(variance**2)
    first = float(max(np.sum(score**2) * size - 1.0, 1e-3)) * float(size)
    spreads = Spreads.of(derivative)
    variances = np.full(len(spreads.sizes()), first)
    return Part(effect, spreads, variances, np.zeros(derivative.count), derivative.actuators)


def correction(fit: FittedRows, effect: Effect) -> Joint | None:
    """Estimate an effect together with alpha; None if it does not converge, or is too large."""
    derivative = effect.derivative(fit)
    part = derivative and new_part(fit, effect, derivative)
    return joined(fit, (part,)) if part else None


def joined(fit: FittedRows, parts: Sequence[Part], start: FittedRows | None = None) -> Joint | None:
    """Estimate effects together with alpha; None if it does not converge.

    An effect of which the data determine next to nothing is left out: its spread becomes 0.
    The ``fit`` is that without effects; ``start`` that with the parameters that the parts have.
    """
    parts, settled = tuple(parts), False
    affected = next((part.actuators for part in parts if part.actuators is not None), None)
    at = replace(start or fit, affected=affected)
    for iteration in range(40):
        made = [part.effect.derivative(at) for part in parts]
        derivatives = [each for each in made if each is not None]
        if len(derivatives) < len(parts):
            return None
        result, theta = scored(at, *derivatives), np.concatenate([part.theta for part in parts])
        precision = _precision(parts, [part.variances for part in parts])
        try:  # an effect without any size does not converge
            inverse = _covariance(result.information, precision)
        except np.linalg.LinAlgError:
            return None
        nu = [part.spreads.determined(inverse[k, k], part.variances) for part, k in _places(parts)]
        index = int(np.argmin([each.sum() for each in nu]))
        if iteration > 2 and nu[index].sum() < MIN_DETERMINED:
            return joined(fit, (*parts[:index], *parts[index + 1 :]), at) if parts[1:] else None
        step = -inverse @ (result.score + precision @ theta)
        seen = [np.maximum(part.seen, each) for part, each in zip(parts, nu, strict=True)]
        parts = tuple(replace(part, seen=most) for part, most in zip(parts, seen, strict=True))
        # Theta has converged if its step is below 0.01 standard errors.
        if settled and float(step @ result.information @ step) < 1e-4:
            return _ended(at, parts, nu, result, inverse)
        theta = theta + step
        parts, settled = _moved(parts, nu, theta)
        effects = [(each, part.theta) for each, part in zip(derivatives, parts, strict=True)]
        problem, moments = removed(at, (fit.problem, fit.moments), effects)
        problem = _with_new_noise(problem, moments)
        try:
            minimum = problem.fitted(moments, at.minimum.values)
        except (NotConverged, RankDeficient):
            return None
        apart = fit.removed + fit.moments.mean - moments.mean
        found = {"before": at.found.get("columns")}
        at = FittedRows(problem, moments, minimum, fit.independent, apart, affected, found)
    return None


def _places(parts: Sequence[Part]) -> list[tuple[Part, slice]]:
    """Return the parts with the places of their parameters among all."""
    ends = np.cumsum([part.count for part in parts])
    return [(p, slice(end - p.count, end)) for p, end in zip(parts, ends, strict=True)]


def _precision(parts: Sequence[Part], variances: Sequence[Array]) -> Array:
    """Return the (k, k) inverse of the prior covariance of all parameters."""
    each = [part.spreads.precision(v) for part, v in zip(parts, variances, strict=True)]
    return np.asarray(scipy.linalg.block_diag(*each))


def _moved(
    parts: Sequence[Part], nu: Sequence[Array], theta: Array
) -> tuple[tuple[Part, ...], bool]:
    """Return the parts with new parameters and spreads, and whether the spreads have converged.

    A spread has converged if it moves by less than 1 % of the scatter of its parameters.
    """
    moved, settled = [], True
    for (part, k), each in zip(_places(parts), nu, strict=True):
        before, least = part.variances, np.maximum(each, 1e-3)
        variances = np.maximum(part.spreads.squares(theta[k]) / least, 1e-300)
        settled &= bool((np.abs(variances - before) < 1e-2 * variances * part.seen / least).all())
        moved.append(replace(part, theta=theta[k], variances=variances))
    return tuple(moved), settled


def _ended(
    at: FittedRows, parts: Sequence[Part], nu: Sequence[Array], result: Scored, inverse: Array
) -> Joint:
    """Return the fit with the covariance of its effects."""
    wide, ended = [], []
    for (part, k), each in zip(_places(parts), nu, strict=True):
        excess = (excess_of_t(np.asarray(part.seen)) - 1.0) * part.seen / np.maximum(each, 1e-3)
        wide.append(part.variances * (1.0 + excess))
        ended.append(replace(part, gain=_gain(part, inverse[k, k])))
    covariance = _covariance(result.information, _precision(parts, wide))
    problem, minimum = at.problem.with_error(at.minimum, result.moves, covariance)
    parts = tuple(replace(part, covariance=covariance[k, k]) for part, k in _places(ended))
    effective = float(np.sum(inverse * result.by_balance))
    return Joint(problem, at.moments, minimum, parts, at, result, covariance, effective)


def _gain(part: Part, covariance: Array) -> float:
    """Return twice the log of the marginal likelihood with an effect over that without it."""
    explained = part.theta @ scipy.linalg.solve(covariance, part.theta, assume_a="pos")
    of_prior = np.linalg.slogdet(part.spreads.precision(part.variances))[1]
    return float(explained + np.linalg.slogdet(covariance)[1] + of_prior)


def _covariance(information: Array, precision: Array) -> Array:
    """Return the (k, k) covariance of theta."""
    whole = information + precision
    return inverse_of_positive(0.5 * (whole + whole.T), overwrite=True)


def excess_of_t(freedom: Array) -> Array:
    """Return (...,) the square of the 95 % limit of Student's t over that of a normal number.

    A variance of fewer than one parameter is taken for one of one.
    """
    tail = 0.5 * (1.0 - 0.95)
    return np.asarray((t_isf(tail, np.maximum(freedom, 1.0)) / normal_isf(tail)) ** 2)


def _with_new_noise(problem: Problem, moments: Moments) -> Problem:
    """Return the problem with the noise of repeats without the effects."""
    if problem.noise.source != NoiseSource.REPEATS:
        return problem
    noise = reading_noise(problem.campaign, moments)
    share, freedom = problem.noise.share, problem.noise.share_freedom
    return replace(problem, noise=replace(noise, share=share, share_freedom=freedom))
