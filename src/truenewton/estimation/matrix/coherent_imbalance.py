"""Whether the remaining imbalance of the columns is noise, or the pattern of a mistake.

With the arms A (3, n), orthonormal Q (n, 3) over the same span and M = diag(alpha) K_c, every
column of M is a set of forces in equilibrium, whatever its sensor reads:

    e_j = Q' M_j = 0,      d e_j / d log alpha_i = Q_i M_ij

Noise of the elements gives e the variance Q' diag(a^2 + p^2 M_ij^2) Q c_j, with the most likely a,
p and factors c_j of the columns. A mistake of geometry or processing leaves a pattern instead,
however small. Positions that are wrong by a smooth field, or by the radius of a ring, leave -dA M
(in the units of Q). A diagonal, or couplings changed by their distance, leave Q' dM. Each such
pattern z is tested alone beside alpha, as one parameter against the scatter of the rest:

    share = (z' r)^2 / r' r,    r: whitened residual

For sound matrices, share is the largest of about fifty, each about 1 / f of f degrees of freedom.
The test needs neither symmetry nor a model of the sensors. The significance of the pattern is how
far alpha moves if it is fitted as well.

A few mistakes leave no imbalance. If positions are stretched to one side, alpha absorbs it as a
gradient; if a part of the rigid motions is removed, the balance is better than measured. Then the
gains of the sensors implied by symmetry, log g = log(alpha g) - log alpha, follow alpha or have a
gradient, which those of sound sensors do not.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise, product
from typing import NamedTuple

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from truenewton.arrays import Array
from truenewton.estimation.findings.code import LIMITS, Code
from truenewton.estimation.findings.finding import Finding
from truenewton.estimation.matrix.couplings import relative_couplings
from truenewton.estimation.matrix.facts import MatrixFacts

MIN_ACTUATORS = 12  # with fewer, no pattern is tested
PRIOR_READINGS = 12.0  # weight of the other columns' noise in that of one
DISTANCE_BINS = (0.0, 0.03, 0.1, 0.25, 0.5, 1.0)  # quantiles of the distances of pairs


class Pattern(NamedTuple):
    """A mistake, the imbalance (3, n) of the columns that it leaves, and what to do about it."""

    name: str
    imbalance: Array
    remedy: str = "find out how the matrix was processed, and use it as it was measured"


class CoherentImbalance(NamedTuple):
    """The mistake that explains most of the imbalance of the columns."""

    names: tuple[str, ...]  # of the pattern, and of others that explain nearly as much
    share: float  # of the imbalance, in units of its noise, that it explains
    shift: Array  # (n,) change of log alpha if it is fitted as well
    column_noise: Array  # (n,) variance of the imbalance of each column, relative to the median
    remedy: str  # for the mistake


def coherent_imbalance(commanded: Array, arms: Array, alpha: Array) -> CoherentImbalance | None:
    """Return the pattern that explains most of the remaining imbalance; None for few actuators.

    ``commanded`` is the (n, n) force of actuator i per reading of sensor j, ``arms`` (3, n) in
    comparable units, ``alpha`` (n,) as fitted.
    """
    n = len(commanded)
    if n < MIN_ACTUATORS:
        return None
    q = np.linalg.qr(arms.T)[0]
    m = alpha[:, None] * commanded
    m = m / np.median(np.abs(np.diag(m)))
    e = (q.T @ m).T.ravel()
    by_alpha = np.einsum("ia,ij->jai", q, m).reshape(3 * n, n)
    mean_free = np.linalg.qr(np.column_stack([np.ones(n), np.eye(n)[:, 1:]]))[0][:, 1:]
    by_alpha = by_alpha @ mean_free  # the common scale is no unknown
    patterns = list(patterns_of(m, arms, q))
    z = np.stack([each.imbalance.T.ravel() for each in patterns], axis=1)
    root = _noise_root(q, m, e, by_alpha)
    basis, triangle = scipy.linalg.qr(_whitened(root, by_alpha), mode="economic")
    residual = _whitened(root, e)
    by_fit = basis.T @ residual
    residual = residual - basis @ by_fit
    white = _whitened(root, z)
    inside = basis.T @ white
    white = white - basis @ inside
    length = np.linalg.norm(white, axis=0)
    along = (white.T @ residual) / np.where(length > 0.0, length, np.inf)
    shares = along**2 / float(residual @ residual)
    best = int(np.argmax(shares))
    order = [k for k in np.argsort(-shares) if shares[k] > 0.8 * shares[best]]
    names = dict.fromkeys(patterns[k].name for k in order)
    size = along[best] / length[best]
    shift = -mean_free @ np.linalg.solve(triangle, by_fit - inside[:, best] * size)
    volume = np.linalg.det(root) ** (-2.0 / 3.0)
    noise = volume / np.median(volume)
    return CoherentImbalance(tuple(names), float(shares[best]), shift, noise, patterns[best].remedy)


def patterns_of(m: Array, arms: Array, q: Array) -> Iterator[Pattern]:
    """Yield the imbalance that mistakes leave of an (n, n) matrix; (3, n) arms, (n, 3) Q."""
    x, y = arms[1] / arms[0], arms[2] / arms[0]
    largest = float(np.hypot(x, y).max())
    x, y = x / largest, y / largest
    inverse = np.linalg.inv(arms @ q)  # Q' = inverse A

    def of_positions(name: str, dx: Array, dy: Array) -> Pattern:
        moved = -inverse @ (np.stack([0.0 * dx, dx, dy]) * arms[0]) @ m
        return Pattern(name, moved, "compare X and Y of the actuators with the drawing")

    nothing, radius = np.zeros_like(x), np.hypot(x, y)
    for p, r in product(range(4), repeat=2):
        if 2 <= p + r <= 3:  # below, A is only transformed
            field = x**p * y**r
            yield of_positions("a smooth distortion of the positions", field, nothing)
            yield of_positions("a smooth distortion of the positions", nothing, field)
    for power in (2, 3):
        part = (x * radius ** (2 * power), y * radius ** (2 * power))
        yield of_positions("radii (positions along the surface, a scale that varies)", *part)
    ordered = np.sort(radius)
    edges = ordered[1:][np.diff(ordered) > 0.03]  # the first radius of each ring
    ring = np.digitize(radius, edges - 1e-9)
    for number in range(ring.max() + 1 if ring.max() < 20 else 0):
        part = np.where(ring == number, 1.0, 0.0) / np.maximum(radius, 1e-9)
        yield of_positions(f"the radius of ring {number + 1}", part * x, part * y)
        yield of_positions(f"the rotation of ring {number + 1}", -part * y, part * x)
    own = np.diag(m)
    yield Pattern("the diagonal of the matrix", q.T * own)
    yield Pattern("the diagonal of the matrix", q.T * np.mean(np.abs(own)))
    apart = np.hypot(x[:, None] - x, y[:, None] - y)
    edges = np.quantile(apart[~np.eye(len(x), dtype=bool)], DISTANCE_BINS)
    for low, high in pairwise(edges):
        some = (apart >= low) & (apart <= high) & (apart > 0.0)
        yield Pattern("couplings that were changed by their distance", q.T @ (m * some))
        yield Pattern("couplings that were changed by their distance", q.T @ some.astype(float))
    yield Pattern("couplings compressed or stretched", q.T @ (m * np.log(np.abs(m) + 1e-300)))


def doubts_of_balance(
    facts: MatrixFacts, alpha: Array, covariance: Array, ids: NDArray[np.int64]
) -> tuple[tuple[Finding, ...], Array]:
    """Return the mistakes that the balance of a matrix shows, and the (n, n) covariance with them.

    If one mistake explains much of the imbalance, alpha may be wrong by as much as it moves if the
    mistake is fitted: this is added to the (n, n) ``covariance`` of (n,) alpha.
    """
    said = list[Finding]()
    found = coherent_imbalance(facts.stiffness, facts.arms, alpha)
    stated = float(np.sqrt(np.mean(np.diag(covariance) / alpha**2)))
    if found is not None and (far := found.column_noise > LIMITS.column_noise).any():
        said.append(Finding.of(Code.COLUMNS_UNBALANCED, actuators=ids[far]))
    if found is not None and found.share > LIMITS.pattern_share:
        moved = float(np.sqrt(np.mean(found.shift**2)))
        if moved > LIMITS.pattern_shift * stated:
            mistake = Finding.of(
                Code.COHERENT_IMBALANCE,
                pattern=" or ".join(found.names[:3]),
                share=found.share,
                shift=moved,
                ratio=moved / stated,
                remedy=found.remedy,
            )
            shift = alpha * found.shift
            # wrong alpha makes wrong gains, so these are not asked
            return (mistake, *said), covariance + np.outer(shift, shift)
    gains = sensor_gains(facts, alpha, covariance)
    if abs(gains.with_alpha) > LIMITS.gain_correlation and gains.sigmas > LIMITS.gain_sigmas:
        said.append(Finding.of(Code.GAINS_FOLLOW_ALPHA, correlation=gains.with_alpha))
    elif gains.gradient_sigmas > LIMITS.gradient_sigmas:
        said.append(Finding.of(Code.GAINS_HAVE_GRADIENT, sigmas=gains.gradient_sigmas))
    return tuple(said), covariance


class SensorGains(NamedTuple):
    """Anomalies of the sensor gains implied by symmetry."""

    with_alpha: float  # correlation with alpha; 0 if alpha varies no more than its error
    sigmas: float  # its size over its standard deviation
    gradient_sigmas: float  # gradient across the mirror over its standard deviation


def sensor_gains(facts: MatrixFacts, alpha: Array, covariance: Array) -> SensorGains:
    """Return whether gains by symmetry follow (n,) alpha, or have a gradient.

    The effect of errors of alpha, with (n, n) covariance, is removed from both. These errors
    consist of few smooth patterns, so the correlation scatters much more than 1 / root n.
    """
    if (alpha <= 0.0).any() or len(alpha) < MIN_ACTUATORS:
        return SensorGains(0.0, 0.0, 0.0)
    log_alpha = np.log(alpha) - np.mean(np.log(alpha))
    log_ratio, misfit = facts.pair_ratios
    log_gain = log_ratio - log_alpha
    log_gain = log_gain - np.mean(log_gain)
    relative = covariance / np.outer(alpha, alpha)
    of_gains = _covariance_of_ratios(facts.stiffness, misfit) + relative
    noise = float(np.mean(np.diag(relative)))
    own = max(float(np.mean(log_gain**2)) - noise, noise, 1e-300)
    spread = float(np.mean(log_alpha**2)) - noise
    with_alpha = sigmas = 0.0
    if spread > 9.0 * noise:  # three times the error of log alpha
        together = float(np.mean(log_gain * log_alpha)) + noise
        with_alpha = together / float(np.sqrt(spread * own))
        scatter = max(float(np.mean(log_gain**2) - np.mean(np.diag(of_gains))), 0.0)
        variance = log_alpha @ of_gains @ log_alpha + scatter * (log_alpha @ log_alpha)
        sigmas = len(alpha) * abs(together) / float(np.sqrt(variance))
    position = facts.arms[1:].T - facts.arms[1:].T.mean(axis=0)
    position = np.linalg.qr(position)[0]
    gradient = position.T @ log_gain
    # independent gains have a gradient, too: that of their scatter about it
    rest = log_gain - position @ gradient
    scatter = max(float(rest @ rest - np.trace(of_gains)) / (len(rest) - 3), 0.0)
    by_chance = position.T @ of_gains @ position + scatter * np.eye(2)
    chi2 = gradient @ np.linalg.solve(by_chance, gradient)
    return SensorGains(with_alpha, sigmas, float(np.sqrt(chi2 / 2.0)))


def _covariance_of_ratios(commanded: Array, misfit: Array) -> Array:
    """Return the (n, n) covariance of log(alpha g) from the (n, n) misfit of pairs."""
    linked = np.isfinite(misfit)
    c = relative_couplings(commanded)
    weight = np.where(linked, np.abs(c * c.T), 0.0)
    laplacian = np.diag(weight.sum(axis=1)) - weight
    pairs = max(np.count_nonzero(linked) / 2 - len(c), 1.0)
    square = 0.5 * float(np.sum(weight * np.where(linked, misfit, 0.0) ** 2)) / pairs
    return np.asarray(square * np.linalg.pinv(laplacian, hermitian=True))


def _noise_root(q: Array, m: Array, e: Array, by_alpha: Array) -> Array:
    """Return (n, 3, 3) inverse roots of the noise of the imbalance of each column.

    Steps are those of a minorant of the likelihood, in which no variance becomes negative (Zhou et
    al., J. Comput. Graph. Stat. 28, 350, 2019).
    """
    n = len(m)
    laws = np.stack([np.broadcast_to(np.eye(3), (n, 3, 3)), np.einsum("ia,ij,ib->jab", q, m**2, q)])
    laws[1] *= 3.0 / np.trace(laws[1], axis1=1, axis2=2).mean()
    size, column = np.full(2, 0.5 * float(np.mean(e**2))), np.ones(n)
    for _ in range(10):
        root = _root(np.tensordot(size, laws, 1) * column[:, None, None])
        columns = _whitened(root, by_alpha)
        gram = columns.T @ columns  # Cholesky is accurate enough to estimate noise
        gram[np.diag_indices(len(gram))] *= 1.0 + 1e-12
        factor = scipy.linalg.cholesky(gram, lower=True)
        basis = scipy.linalg.solve_triangular(factor, columns.T, lower=True).T
        r = _whitened(root, e)
        r = (r - basis @ (basis.T @ r)).reshape(n, 3)
        free = 1.0 - np.sum(basis**2, axis=1).reshape(n, 3).mean(axis=1)
        weighted = np.einsum("jba,jb->ja", root, r)
        inverse = np.einsum("jca,jcb->jab", root, root)
        wanted = np.einsum("ja,kjab,jb,j->k", weighted, laws, weighted, column)
        had = np.einsum("jab,kjba,j->k", inverse, laws, column * free)
        size = np.maximum(size * np.sqrt(wanted / had), 1e-300)
        seen = np.sum(r**2, axis=1) + PRIOR_READINGS
        column = column * np.sqrt(seen / (3.0 * free + PRIOR_READINGS))
        column /= np.exp(np.mean(np.log(column)))
    return _root(np.tensordot(size, laws, 1) * column[:, None, None])


def _root(variance: Array) -> Array:
    return np.asarray(np.linalg.inv(np.linalg.cholesky(variance)))


def _whitened(root: Array, rows: Array) -> Array:
    """Return (3 n,) or (3 n, m) rows, three of each column, in units of their noise."""
    n = len(root)
    return np.asarray(np.matmul(root, rows.reshape(n, 3, -1)).reshape(rows.shape))
