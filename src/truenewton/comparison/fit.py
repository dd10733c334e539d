"""Factors of rows and columns between two stiffness matrices of one mirror, with their errors.

    K_1 = T + E_1,    K_2 = diag(1/r) T diag(1/q) + E_2,    f_ij = 1 / (r_i q_j)

r = alpha_2 / alpha_1, and q is the same ratio of sensor gains. The true stiffness T (n^2 unknowns)
is eliminated. With a = -log r, b = -log q and

    u = K_2 / f - K_1,    t = (K_1 + K_2 / f) / 2,    v = variance of u

the score is the sum of u t / v over a row (a) or a column (b), and with W = t^2 / v the information
is [[diag(W 1), W], [W', diag(1'W)]]. Its null vector is (1, -1): r is determined up to a factor and
q up to its inverse. The mean t of both matrices makes the score unbiased for equal noise.

The variance v is one of these laws, whichever is more likely:

- elements: v_ij = rho_i gamma_j s_ij (A + B t_ij^2), with s_ij from condensation;
- modes: u V has independent columns, v_ik = rho_i lambda_k, V the right singular vectors of K_1, as
  in a matrix that was measured mode by mode;
- shapes, if K_1 or K_2 is a regression of the shapes X of a campaign: U'u V is independent, v_kl =
  rho_k lambda_l. The rows of K have the covariance sigma^2 (X'X)^-1, whose eigenvectors are V. U
  are the left singular vectors of K_1, since noise e of the readings is K e in the forces;
- elements and shapes, if one of them is a regression and the other a matrix: a row of u has the
  covariance C + diag(v_i), with C = sigma^2 (X'X)^-1 of the regression and v_ij of the matrix.
  The noise of the sensors of the campaign, which rows share, is not part of it. Therefore the
  errors are multiplied by the largest pattern of the residual over noise.

The logarithms of rho, gamma and lambda are shrunk towards their mean (empirical Bayes), because a
row of 45 elements alone would determine its variance only to 20 %.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar

import numpy as np
import scipy.linalg
import scipy.optimize
from numpy.typing import NDArray

from truenewton import linalg
from truenewton.arrays import Array
from truenewton.chance import FALSE_ALARM, normal_isf

MAX_STEPS = 12
MAX_STEP = 0.3  # of a logarithm
STEP_TOLERANCE = 1e-3  # of its error, below which a step ends the iteration
LAW_STEPS = 6  # in which the variances follow the residuals; then they are kept
SCALE_PASSES = 5  # over rows and columns, each given the others; further ones change nothing
MIN_RELATIVE_SIZE = 1e-9  # of a singular value: rigid motions may cost nothing
MAX_LEVERAGE = 0.9  # of an element, in the correction of its residual
# log of B t^2 / A for a typical element: from constant to proportional noise, and its step
MIX_RANGE, MIX_STEP = (-10.0, 12.0), 2.0
MIX_TOLERANCE = 0.2
# of all elements, and not more than actuators; with more, the noise law is wrong instead
MAX_CHANGED_COUPLINGS = 0.01
GROSS_CHANGE = 2.5  # of the limit of a coupling: it would spoil the fit of other noise laws
MAX_NAMING_PASSES = 10


Couplings = NDArray[np.int64]  # (k, 2) rows and columns of elements
NO_COUPLINGS: Couplings = np.zeros((0, 2), dtype=np.int64)


@dataclass(frozen=True, eq=False)
class ElementNoise:
    """Independent noise of the elements, of product form.

    Attributes
    ----------
    inflation
        (n, n) s, relative variance after condensation.
    variance
        (n, n) v of u [N^2/m^2].
    leverage
        (n, n) share of the variance of an element that the factors absorb.
    log_mix
        log of B t^2 / A for the median t^2.
    """

    name: ClassVar = "elements"

    inflation: Array
    variance: Array
    leverage: Array
    log_mix: float = np.nan

    @classmethod
    def start(cls, one: Array, inflation: Array) -> ElementNoise:
        """Return equal noise, of (n, n) K_1 and inflation s."""
        return cls(inflation, inflation, np.zeros_like(one))

    def refitted(self, u: Array, t: Array) -> ElementNoise:
        """Return the likeliest law for (n, n) residuals u and mean t."""
        square = u**2 / (1.0 - np.minimum(self.leverage, MAX_LEVERAGE)) / self.inflation
        power = t**2 / np.median(t**2)

        def cost(log_mix: float) -> float:
            v = product_variances(square, 1.0 + np.exp(log_mix) * power)
            return float((square / v + np.log(v)).sum())

        log_mix = self.log_mix
        if not np.isfinite(log_mix):
            log_mix = min(np.arange(*MIX_RANGE, MIX_STEP), key=cost)
        log_mix = float(
            scipy.optimize.minimize_scalar(
                cost,
                bounds=(log_mix - MIX_STEP, log_mix + MIX_STEP),
                method="bounded",
                options={"xatol": MIX_TOLERANCE},
            ).x
        )
        v = product_variances(square, 1.0 + np.exp(log_mix) * power) * self.inflation
        return replace(self, variance=v, log_mix=log_mix)

    def unchanged(self, u: Array, couplings: Couplings) -> Array:
        """Return (n, n) u with what the others predict in place of changed couplings, 0."""
        u = u.copy()
        u[tuple(couplings.T)] = 0.0
        return u

    def equations(self, u: Array, t: Array, couplings: Couplings) -> tuple[Array, Array]:
        """Return the (2n,) score and the (2n, 2n) information of a and b without couplings."""
        score, weight = u * t / self.variance, t**2 / self.variance
        weight[tuple(couplings.T)] = 0.0
        information = np.block(
            [[np.diag(weight.sum(axis=1)), weight], [weight.T, np.diag(weight.sum(axis=0))]]
        )
        return np.concatenate([score.sum(axis=1), score.sum(axis=0)]), information

    def with_leverage(self, t: Array, covariance: Array) -> ElementNoise:
        """Return the law with the leverage that factors of (2n, 2n) covariance have."""
        n = len(t)
        own = np.diag(covariance)
        shared = own[:n, None] + own[n:] + 2.0 * covariance[:n, n:]
        return replace(self, leverage=t**2 / self.variance * shared)

    def innovations(self, u: Array) -> tuple[Array, Array]:
        """Return (n, n) by how much each element differs from the others' prediction, and error."""
        return u, np.sqrt(self.variance * (1.0 - np.minimum(self.leverage, MAX_LEVERAGE)))

    def whitened(self, u: Array) -> Array:
        """Return (n, n) residuals of unit variance."""
        return np.asarray(u / np.sqrt(self.variance))

    def cost(self, u: Array) -> float:
        """Return -2 log likelihood of (n, n) residuals, but for a constant."""
        return float((self.whitened(u) ** 2 + np.log(self.variance)).sum())


@dataclass(frozen=True, eq=False)
class ModeNoise:
    """Noise of a matrix or a campaign that was measured shape by shape: U'u V is independent.

    Attributes
    ----------
    name
        'modes' or 'shapes'.
    left, right
        (n, n) U and V.
    sizes
        (n,) by which the noise of the columns of V increases, but for a power.
    rows, variances
        (n,) rho of each column of U, and lambda of each of V [N^2/m^2].
    leverage
        (n, n) share of the variance of U'u V that the factors absorb.
    """

    name: str
    left: Array
    right: Array
    sizes: Array
    rows: Array
    variances: Array
    leverage: Array

    @classmethod
    def start(cls, name: str, left: Array, right: Array, sizes: Array) -> ModeNoise:
        """Return noise of the columns of (n, n) U and V proportional to (n,) sizes."""
        sizes = np.maximum(sizes, MIN_RELATIVE_SIZE * sizes.max())
        return cls(name, left, right, sizes, np.ones(len(sizes)), sizes**2, np.zeros_like(left))

    def refitted(self, u: Array, t: Array) -> ModeNoise:
        """Return the likeliest law for (n, n) residuals u and mean t."""
        del t
        n = len(u)
        free = 1.0 - np.minimum(self.leverage, MAX_LEVERAGE)
        square = (self.left.T @ u @ self.right) ** 2 / free
        # The factors absorb most of the residual of stiff modes, which then say little of lambda.
        of_modes, of_rows = 2.0 / free.sum(axis=0), 2.0 / free.sum(axis=1)
        rows, logs = np.ones(n), np.log(self.sizes)
        for _ in range(SCALE_PASSES):
            found = np.log((square / rows[:, None]).mean(axis=0))
            line = np.polyval(np.polyfit(logs, found, 1, w=of_modes**-0.5), logs)
            variances = np.exp(line + shrunk(found - line, of_modes))
            rows = np.exp(shrunk(np.log((square / variances).mean(axis=1)), of_rows))
        return replace(self, rows=rows, variances=variances)

    @cached_property
    def _inverses(self) -> tuple[Array, Array]:
        """(n, n) inverse covariances of the columns and of the rows of u."""
        left, right = (
            np.asarray((vectors / variances) @ vectors.T)
            for vectors, variances in ((self.left, self.rows), (self.right, self.variances))
        )
        return left, right

    def _between(self, couplings: Couplings) -> Array:
        """Return the (k, k) inverse covariance of elements of u given all others."""
        (left, right), (i, j) = self._inverses, couplings.T
        return np.asarray(left[np.ix_(i, i)] * right[np.ix_(j, j)])

    def unchanged(self, u: Array, couplings: Couplings) -> Array:
        """Return (n, n) u with what the others predict in place of changed couplings."""
        (left, right), (i, j) = self._inverses, couplings.T
        u = u.copy()
        pulls = np.einsum("km,km->k", left[i] @ u, right[j])
        u[i, j] -= np.linalg.solve(self._between(couplings), pulls)
        return u

    def equations(self, u: Array, t: Array, couplings: Couplings) -> tuple[Array, Array]:
        """Return the (2n,) score and the (2n, 2n) information of a and b without couplings."""
        left, right = self._inverses
        left_t, t_right = left @ t, t @ right
        score, cross = t * (left @ u @ right), left_t * t_right
        information = np.block([[left * (t_right @ t.T), cross], [cross.T, right * (t.T @ left_t)]])
        if len(couplings):
            i, j = couplings.T
            pulls = np.concatenate([left[:, i] * t_right[:, j], left_t[i].T * right[:, j]])
            information -= pulls @ np.linalg.solve(self._between(couplings), pulls.T)
        return np.concatenate([score.sum(axis=1), score.sum(axis=0)]), information

    def with_leverage(self, t: Array, covariance: Array) -> ModeNoise:
        """Return the law with the leverage that factors of (2n, 2n) covariance have.

        The means over rows and over modes are exact; the elements follow as if of product form.
        """
        n, (left, right) = len(t), self._inverses
        a, ab, b = covariance[:n, :n], covariance[:n, n:], covariance[n:, n:]

        def absorbed(t: Array, inverse: Array, own: Array, both: Array, other: Array) -> Array:
            """Return (n, n) covariance of the changes of u, summed over its whitened columns."""
            weighted = t @ inverse
            shared = (weighted * both) @ t.T
            return own * (weighted @ t.T) + t @ (other * inverse) @ t.T + shared + shared.T

        of_rows, of_modes = (
            np.einsum("ik,ik->k", vectors, changes @ vectors) / (n * variances)
            for vectors, variances, changes in (
                (self.left, self.rows, absorbed(t, right, a, ab, b)),
                (self.right, self.variances, absorbed(t.T, left, b, ab.T, a)),
            )
        )
        return replace(self, leverage=np.outer(of_rows, of_modes) / of_modes.mean())

    def innovations(self, u: Array) -> tuple[Array, Array]:
        """Return (n, n) by how much each element differs from the others' prediction, and error."""
        left, right = self._inverses
        own = np.outer(np.diag(left), np.diag(right))
        return left @ u @ right / own, 1.0 / np.sqrt(own)

    def whitened(self, u: Array) -> Array:
        """Return (n, n) residuals of unit variance."""
        return np.asarray(
            self.left.T @ u @ self.right / np.sqrt(np.outer(self.rows, self.variances))
        )

    def cost(self, u: Array) -> float:
        """Return -2 log likelihood of (n, n) residuals, but for a constant."""
        logs = len(u) * (np.log(self.rows).sum() + np.log(self.variances).sum())
        return float((self.whitened(u) ** 2).sum() + logs)


@dataclass(frozen=True, eq=False)
class RowNoise:
    """Independent noise of the elements of a matrix, and of a regression, common to each row.

    Attributes
    ----------
    elements
        Noise of the matrix.
    covariance
        (n, n) C of the elements of a row by regression [N^2/m^2].
    """

    name: ClassVar = "elements and shapes"

    elements: ElementNoise
    covariance: Array

    def _rows(self, couplings: Couplings) -> Iterator[tuple[Array, Array]]:
        """Yield (n, n) inverse covariance P of each row without couplings, and its covariance."""
        rows, columns = couplings.T
        for i, variance in enumerate(self.elements.variance):
            covariance = self.covariance + np.diag(variance)
            changed = columns[rows == i]
            if not changed.size:
                yield linalg.inverse_of_positive(covariance), covariance
                continue
            kept = np.setdiff1d(np.arange(len(variance)), changed)
            inverse = np.zeros_like(covariance)
            inverse[np.ix_(kept, kept)] = linalg.inverse_of_positive(covariance[np.ix_(kept, kept)])
            yield inverse, covariance

    def refitted(self, u: Array, t: Array) -> RowNoise:
        """Return the likeliest law for (n, n) residuals u and mean t, by a step of EM.

        The first step takes all of u as noise of the matrix.
        """
        u = u / np.sqrt(1.0 - np.minimum(self.elements.leverage, MAX_LEVERAGE))
        square = u**2
        if np.isfinite(self.elements.log_mix):
            for i, (inverse, _) in enumerate(self._rows(NO_COUPLINGS)):
                own = self.elements.variance[i]
                square[i] = (own * (inverse @ u[i])) ** 2 + own - own**2 * np.diag(inverse)
        free = replace(self.elements, leverage=np.zeros_like(u))
        return replace(self, elements=free.refitted(np.sqrt(square), t))

    def unchanged(self, u: Array, couplings: Couplings) -> Array:
        """Return (n, n) u with what the others predict in place of changed couplings."""
        u = u.copy()
        u[tuple(couplings.T)] = 0.0
        predicted = [
            covariance @ (inverse @ u[i])
            for i, (inverse, covariance) in enumerate(self._rows(couplings))
        ]
        i, j = couplings.T
        u[i, j] = np.array(predicted)[i, j]
        return u

    def equations(self, u: Array, t: Array, couplings: Couplings) -> tuple[Array, Array]:
        """Return the (2n,) score and the (2n, 2n) information of a and b without couplings."""
        n = len(t)
        score, information = np.zeros((2, n)), np.zeros((2 * n, 2 * n))
        for i, (inverse, _) in enumerate(self._rows(couplings)):
            pull, weighted = inverse @ u[i], t[i] * (inverse @ t[i])
            score[0, i] = t[i] @ pull
            score[1] += t[i] * pull
            information[i, i] = weighted.sum()
            information[i, n:] = information[n:, i] = weighted
            information[n:, n:] += t[i][:, None] * inverse * t[i]
        return score.ravel(), information

    def with_leverage(self, t: Array, covariance: Array) -> RowNoise:
        """Return the law with the leverage that factors of (2n, 2n) covariance have."""
        total = self.elements.variance + np.diag(self.covariance)
        whole = replace(self.elements, variance=total).with_leverage(t, covariance)
        return replace(self, elements=replace(self.elements, leverage=whole.leverage))

    def innovations(self, u: Array) -> tuple[Array, Array]:
        """Return (n, n) by how much each element differs from the others' prediction, and error."""
        pulls, own = np.array(
            [(p @ u[i], np.diag(p)) for i, (p, _) in enumerate(self._rows(NO_COUPLINGS))]
        ).transpose(1, 0, 2)
        return pulls / own, 1.0 / np.sqrt(own)

    def whitened(self, u: Array) -> Array:
        """Return (n, n) residuals of unit variance."""
        return self._whitened(u)[0]

    def _whitened(self, u: Array) -> tuple[Array, float]:
        """Return (n, n) residuals of unit variance, and the logarithm of their covariance."""
        whitened, logs = np.empty_like(u), 0.0
        for i, (inverse, _) in enumerate(self._rows(NO_COUPLINGS)):
            root = np.linalg.cholesky(inverse)
            whitened[i] = u[i] @ root
            logs -= 2.0 * float(np.log(np.diag(root)).sum())
        return whitened, logs

    def cost(self, u: Array) -> float:
        """Return -2 log likelihood of (n, n) residuals, but for a constant."""
        whitened, logs = self._whitened(u)
        return float((whitened**2).sum() + logs)


Noise = ElementNoise | ModeNoise | RowNoise


def shrunk(logs: Array, variance: Array | float) -> Array:
    """Return (n,) logarithms moved towards their mean by the share of noise in their variance.

    ``variance`` is that of the noise of each; the variance of the population is estimated from what
    exceeds it (DerSimonian and Laird, Controlled Clin. Trials 7, 177, 1986).
    """
    noise = np.broadcast_to(variance, logs.shape)
    weight = 1.0 / noise
    spread = float(weight @ (logs - weight @ logs / weight.sum()) ** 2)
    scale = float(weight.sum() - weight @ weight / weight.sum())
    excess = max(0.0, (spread - (len(logs) - 1)) / scale)
    weight = 1.0 / (noise + excess)
    mean = weight @ logs / weight.sum()
    return np.asarray(mean + (logs - mean) * excess * weight)


def product_variances(square: Array, shape: Array) -> Array:
    """Return (n, n) rho_i gamma_j shape_ij for squares of residuals, rho and gamma shrunk."""
    noise = 2.0 / len(square)  # variance of the logarithm of a mean of n squares
    columns = np.ones(len(square))
    for _ in range(SCALE_PASSES):
        scaled = square / shape
        rows = np.exp(shrunk(np.log((scaled / columns).mean(axis=1)), noise))
        columns = np.exp(shrunk(np.log((scaled / rows[:, None]).mean(axis=0)), noise))
    v = shape * rows[:, None] * columns
    return np.asarray(v * (square / v).mean())


@dataclass(frozen=True, eq=False)
class PairFit:
    """Factors between two matrices.

    Attributes
    ----------
    a, b
        (n,) -log |r| and -log |q|; only the sum of their means is determined.
    signs
        (2, n) sign of the factor of each row and each column.
    covariance
        (2n, 2n) of a and b.
    noise
        Its law.
    residual, unchanged
        (n, n) u, and u with what the others predict in place of changed couplings [N/m].
    couplings
        (k, 2) row and column of the elements that changed by themselves.
    coupling_sizes
        (k,) by how much, relative to K_1 [N/m].
    cost
        -2 log likelihood, restricted to what the factors leave.
    converged
        Whether the last step was below the tolerance.
    """

    a: Array
    b: Array
    signs: Array
    covariance: Array
    noise: Noise
    residual: Array
    unchanged: Array
    couplings: Couplings
    coupling_sizes: Array
    cost: float
    converged: bool

    @cached_property
    def pattern(self) -> float:
        """Largest singular value of the whitened residual over 2 sqrt(n): about 1 for noise."""
        whitened = self.noise.whitened(self.unchanged)
        return float(np.linalg.norm(whitened, 2)) / (2.0 * math.sqrt(len(self.a)))

    def deviating(self, limit: float) -> Couplings:
        """Return the elements that deviate from the prediction of the others by a limit."""
        sizes, errors = self.noise.innovations(self.unchanged)
        sizes = sizes.copy()
        sizes[tuple(self.couplings.T)] = self.coupling_sizes
        return np.argwhere(np.abs(sizes) > limit * errors)


def fit_pair(
    one: Array,
    other: Array,
    inflation: Array,
    covariance: Array,
    noise: Noise | None = None,
    *,
    beside_matrix: bool = False,
) -> PairFit:
    """Return the fit with the likeliest of the noise laws.

    Couplings that changed by themselves do not count.

    Parameters
    ----------
    one, other
        (n, n) K_1 and K_2 of the same actuators in the same order [N/m].
    inflation
        (n, n) s, variance of an element relative to that of a matrix that was not condensed.
    covariance
        (n, n) of the elements of a row by regression, up to a factor; 0 without a campaign.
    noise
        The law with its variances, if they are known.
    beside_matrix
        Whether one is a regression whose covariance is known and the other a matrix.
    """
    if noise:
        laws = [noise]
    elif beside_matrix:  # the likelihoods do not show well how much of the noise is the matrix's
        laws = [RowNoise(ElementNoise.start(one, inflation), covariance)]
    else:
        laws = _laws(one, inflation, covariance)
    fixed = noise is not None
    limit = normal_isf(FALSE_ALARM / 4 / one.size)
    most = min(MAX_CHANGED_COUPLINGS * one.size, len(one))
    start, signs = rough_factors(one, other)
    other = other * signs[0][:, None] * signs[1]
    couplings = NO_COUPLINGS
    fits: list[PairFit] = []
    for law in laws:
        fit = _iterated(law, one, other, start, couplings, fixed=fixed)
        # Large changes would spoil the fits of the other laws.
        if not fits and 0 < len(gross := fit.deviating(GROSS_CHANGE * limit)) <= most:
            fit = _iterated(fit.noise, one, other, start, gross, fixed=fixed)
            couplings, start = gross, np.array([fit.a, fit.b])
        fits.append(fit)
    fit = min(fits, key=lambda fit: fit.cost)
    for _ in range(MAX_NAMING_PASSES):
        now = fit.deviating(limit)
        if np.array_equal(now, fit.couplings) or len(now) > most:
            break
        fit = _iterated(fit.noise, one, other, np.array([fit.a, fit.b]), now, fixed=fixed)
    return replace(fit, signs=signs)


def _laws(one: Array, inflation: Array, covariance: Array) -> list[Noise]:
    """Return the laws that are possible for (n, n) K_1."""
    left, sizes, right = linalg.singular_values_and_vectors(one)
    laws: list[Noise] = [
        ElementNoise.start(one, inflation),
        ModeNoise.start("modes", np.eye(len(one)), right.T, sizes),
    ]
    if covariance.any():
        values, vectors = np.linalg.eigh(covariance)
        laws.append(ModeNoise.start("shapes", left, vectors, np.sqrt(np.maximum(values, 0.0))))
    return laws


def rough_factors(one: Array, other: Array) -> tuple[Array, Array]:
    """Return (2, n) logarithms and signs of the factors of rows and columns, by least squares."""
    columns = np.ones(len(one))
    for _ in range(3):
        fitted = one * columns
        rows = np.einsum("ij,ij->i", other, fitted) / np.einsum("ij,ij->i", fitted, fitted)
        fitted = one * rows[:, None]
        columns = np.einsum("ij,ij->j", other, fitted) / np.einsum("ij,ij->j", fitted, fitted)
    factors = np.array([rows, columns])
    signs = np.where(factors < 0.0, -1.0, 1.0)
    return np.log(np.maximum(np.abs(factors), np.finfo(float).tiny)), signs


def _iterated(
    noise: Noise, one: Array, other: Array, start: Array, couplings: Couplings, *, fixed: bool
) -> PairFit:
    """Return the fit by Newton's method; a law that is not fixed follows the first residuals."""
    n = len(one)
    a, b = start
    converged = False
    for step in range(MAX_STEPS):
        residual = other / np.exp(a[:, None] + b) - one
        u = noise.unchanged(residual, couplings) if len(couplings) else residual
        t = one + 0.5 * u
        if step < LAW_STEPS and not fixed:
            noise = noise.refitted(u, t)
        score, information = noise.equations(u, t, couplings)
        covariance, logarithm = _pseudo_inverse(information)
        noise = noise.with_leverage(t, covariance)
        if converged:
            break
        change = np.clip(covariance @ score, -MAX_STEP, MAX_STEP)
        a, b = a + change[:n], b + change[n:]
        errors = np.sqrt(np.diag(covariance))
        converged = step >= 2 and bool((np.abs(change) < STEP_TOLERANCE * errors).all())
    return PairFit(
        a=a,
        b=b,
        signs=np.ones((2, n)),
        covariance=covariance,
        noise=noise,
        residual=residual,
        unchanged=u,
        couplings=couplings,
        cost=noise.cost(u) + logarithm,
        coupling_sizes=(residual - u)[tuple(couplings.T)],
        converged=converged,
    )


def _pseudo_inverse(information: Array) -> tuple[Array, float]:
    """Return the (2n, 2n) inverse of the information on all but its null vector (1, -1).

    Also the logarithm of its determinant there, but for a constant.
    """
    n = len(information) // 2
    scale = 1.0 / np.sqrt(np.diag(information))
    scaled = information * scale * scale[:, None]
    null = np.repeat([1.0, -1.0], n) / scale
    length = np.linalg.norm(null)
    null /= length
    outer = np.outer(null, null)
    factor = scipy.linalg.cholesky(scaled + outer, lower=True)
    logarithm = 2.0 * float(np.log(np.diag(factor)).sum() - np.log(scale).sum() - np.log(length))
    covariance = (linalg.inverse_of_factor(factor) - outer) * scale * scale[:, None]
    # The means of a and b are made equal.
    gauge = np.repeat([1.0, -1.0], n) / np.sqrt(2 * n)
    shift = covariance @ gauge
    moved = np.outer(gauge, shift)
    return covariance - moved - moved.T + (gauge @ shift) * np.outer(gauge, gauge), logarithm
