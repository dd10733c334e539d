"""What the data can and cannot determine, judged against noise; and what to do about it.

Noise fills null spaces, so the rank of E has no meaning. Instead, with noise Sigma in the readings
and orthonormal arms U = (A Sigma A')^-1/2 A, alpha is the pattern v for which the centred forces
are in balance:

    v' G v / v' D v = least,    G = sum over shapes (c - c_mean)(c - c_mean)' o (U' U),
                                D = number of shapes * Sigma o (U' U)           (o: elementwise)

The eigenvalues of G in units of D are about 1 in every pattern that the data leave free, and larger
in every pattern that they determine. The least belongs to alpha itself; every further one that is
not well above it is a direction that only noise decides (docs/method.md).
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import scipy.linalg

from truenewton.arrays import Array
from truenewton.errors import Fault, RankDeficient
from truenewton.estimation.findings.code import Code
from truenewton.estimation.findings.estimate import Diagnosis, separation_of
from truenewton.estimation.findings.finding import Finding
from truenewton.estimation.paper.equations import imbalance_covariance
from truenewton.estimation.readings.moments import MIN_REPEATS, Moments
from truenewton.records.campaign import Campaign
from truenewton.rounding import counted
from truenewton.statics.arms import enabled_arms
from truenewton.statics.layout import Layout

MAX_UNSEEN_LOAD = 0.1  # difference of the forces relative to that of the loads
SIMILAR_LOADS_FRACTION = 0.01  # of the weight: loads that differ by less fix no scale to that
NO_LOAD_SEEN = Finding.of(Code.NO_LOAD_SEEN)


def balance_spectrum(force: Array, a: Array, variance: Array) -> Array:
    """Return (n,) ascending eigenvalues of G in units of D.

    From (shapes, n) commanded forces, centred on the mean of their load, times the root of their
    weight; (3, n) arms; and the (n,) variance of one reading, or ones.
    """
    scaled, _ = _in_terms_of_noise(force, a, variance)
    return np.asarray(np.maximum(scipy.linalg.eigvalsh(scaled), 0.0))


def balance_patterns(force: Array, a: Array, variance: Array, count: int) -> tuple[Array, Array]:
    """Return the (count,) least eigenvalues of G in units of D, and their (n, count) patterns."""
    scaled, root = _in_terms_of_noise(force, a, variance)
    values, vectors = scipy.linalg.eigh(scaled, subset_by_index=(0, count - 1))
    return values, vectors / root[:, None]


def _in_terms_of_noise(force: Array, a: Array, variance: Array) -> tuple[Array, Array]:
    """Return D^-1/2 G D^-1/2 and the (n,) roots of D."""
    gram = a.T @ np.linalg.solve((a * variance) @ a.T, a)  # U' U
    root = np.sqrt(len(force) * np.diag(gram) * variance)
    return (force.T @ force) * gram / np.outer(root, root), root


def free_patterns(eigenvalues: Array, shapes: int, *, known: bool = False) -> int:
    """Count the patterns beside alpha that cannot be distinguished from noise, by (n,) eigenvalues.

    Noise is 1 if it is ``known``, otherwise that of alpha itself; if the mirror's own motion
    balances, it is less than 1 in alpha alone. Pure noise in 3 N equations spreads the eigenvalues
    over (1 +- root(n / 3 N))^2 (Marchenko and Pastur); those within that spread above the least are
    noise.
    """
    spread = np.sqrt(min(len(eigenvalues) / (3 * max(shapes, 1)), 0.49))
    factor = max(2.0, ((1 + spread) / (1 - spread)) ** 2)
    # Rounding: G squares the forces, so nothing below 1e-13 of its largest eigenvalue is real.
    noise = max(eigenvalues[0], 1.0 if known else 0.0, 1e-13 * eigenvalues[-1])
    return int(np.count_nonzero(eigenvalues[1:] <= factor * noise))


def diagnose(campaign: Campaign, moments: Moments) -> Diagnosis:
    """Judge whether a campaign determines alpha, B and the torques, and name what is missing."""
    a = enabled_arms(campaign.layout)
    faults = structural_faults(campaign, moments)
    n, distinct = a.shape[1], _distinct_shapes(moments)
    if geometry_fault(a) or 3 * distinct < n - 1:
        return Diagnosis(undetermined=max(n - 1 - 3 * distinct, 0), faults=faults)
    centred = centred_means(moments)
    variance = np.ones(n)
    known = moments.repeats >= MIN_REPEATS and bool((moments.scatter > 0).all())
    if known:
        variance = moments.scatter / moments.repeats
    eigenvalues = balance_spectrum(centred, a, variance)
    free = free_patterns(eigenvalues, len(centred) - len(campaign.loads), known=known)
    centred /= np.sqrt(variance)  # in place: it is as large as all means
    span = _span(centred, float(np.sqrt(eigenvalues[: free + 1].mean())))
    if free:
        fault = (
            f"the shapes stand above the noise in {span} of the {n - 3} elastic directions:"
            f" {free} pattern{'s' if free > 1 else ''} of alpha left to noise"
        )
        remedy = "check that X and Y are in the order of FORCE (as texts, F10 is before F2)."
        remedy += f" If they are, apply {n} independent shapes, larger or more often"
        faults += (Fault(fault, remedy),)
    unique = separation_of(eigenvalues)
    return Diagnosis(tuple(eigenvalues.tolist()), free, faults, span=span, separation=unique)


def structural_faults(campaign: Campaign, moments: Moments) -> tuple[Fault | Finding, ...]:
    """Name what is missing whatever the noise: actuators, loads, the number of shapes."""
    a = enabled_arms(campaign.layout)
    n, distinct = a.shape[1], _distinct_shapes(moments)
    too_few = Fault(
        f"there are too few shapes: {distinct} for {n} actuators",
        f"apply {n} independent shapes, both signs",
    )
    few = too_few if 3 * distinct < n - 1 else None
    faults = (geometry_fault(a), load_fault(campaign), few, gap_fault(campaign, moments))
    return tuple(fault for fault in faults if fault)


def gap_fault(campaign: Campaign, moments: Moments) -> Fault | None:
    """Return that positions exceed the gap, if it is given."""
    gaps = [cycle.gap for cycle in campaign.cycles if cycle.gap]
    if moments.displacement is None or not gaps:
        return None
    largest = float(np.abs(moments.displacement).max(initial=0.0))
    if largest <= max(gaps):
        return None
    file = max(
        campaign.cycles,
        key=lambda cycle: 0.0 if cycle.position is None else float(np.abs(cycle.position[0]).max()),
    )
    return Fault(
        f"POSITION reaches {largest:.2g} m in {file.name}, beyond the GAP of {max(gaps):.2g} m",
        "check the unit of POSITION, m along +z",
    )


def _distinct_shapes(moments: Moments) -> int:
    """Count shapes: both signs, and all loads, are one elastic pattern of three equations."""
    return len(np.unique(moments.labels[moments.rows > 0, 1]))


def centred_means(moments: Moments) -> Array:
    """Return (rows, n) pooled rows or means of repeats, centred by load, times root weight.

    This removes what is common to a load: weight, bias and torques, and its unknown B, M_y and M_x.
    """
    if moments.pooled:
        rows, share = map(moments.pooling.rows, (moments.mean, moments.of_load))
        rows -= share @ np.linalg.solve(share.T @ share, share.T @ rows)
        return rows
    counted = moments.rows > 0
    centred, load = moments.mean[counted], moments.labels[counted, 0]
    root = np.sqrt(moments.weight[counted])
    for load_index in np.unique(load):
        first, end = np.searchsorted(load, [load_index, load_index + 1])
        some, weight = centred[first:end], root[first:end] ** 2
        some -= weight @ some / weight.sum()
    centred *= root[:, None]
    return centred


def _span(centred: Array, noise: float) -> int:
    """Return how many elastic directions of force exceed what noise alone would reach.

    The largest singular value of N rows of n noisy readings is s (root N + root n). ``centred`` is
    overwritten.
    """
    values = scipy.linalg.svdvals(centred.T, overwrite_a=True, check_finite=False)
    edge = noise * np.sum(np.sqrt(centred.shape))
    above = np.count_nonzero(values > max(1.1 * edge, 1e-12 * values[0]))
    return int(min(above, centred.shape[1] - 3))


def geometry_fault(a: Array) -> Fault | None:
    """Name faults of (3, n) arms: too few, or all on one line or conic."""
    n = a.shape[1]
    if n < 4:
        return Fault(
            f"only {counted(n, 'actuator')} enabled", "enable at least four: three only fix tilts"
        )
    x, y = a[1], a[2]
    values = np.linalg.svd(np.stack([x - x.mean(), y - y.mean()]), compute_uv=False)
    if values[1] <= 1e-6 * values[0]:
        return Fault(
            "the actuators are collinear",
            "a mirror on one line has no torque about it; check X and Y",
        )
    # v A lies in the span of A if v' F v = 0 with F = sum_k diag(q_k) (1 - Q Q') diag(q_k); beside
    # the constants that happens on certain conics only.
    if _all_on_a_conic(np.linalg.qr(a.T)[0]):
        return Fault(
            "the actuators are on a conic, on which balance does not determine alpha",
            "add an actuator off it",
        )
    return None


def _all_on_a_conic(q: Array) -> bool:
    """Return whether F + 1 1' is singular, for (n, 3) orthonormal Q.

    F = diag(share) - (Q Q') o (Q Q') differs from a diagonal by the products of two columns of Q,
    rank 6, so signs of eigenvalues can be counted in 7 dimensions (Haynsworth): K below has one
    negative for the constants, and one more for each of F + 1 1'.
    """
    n = len(q)
    share = np.sum(q**2, axis=1)
    first, second = np.triu_indices(3)
    products = q[:, first] * q[:, second] * np.where(first == second, 1.0, np.sqrt(2.0))
    columns = np.column_stack([products, np.full(n, np.sqrt(share.mean() / n))])
    diagonal = share - 1e-12 * share.mean()
    k = np.diag([1.0] * 6 + [-1.0]) - columns.T @ (columns / diagonal[:, None])
    return int(np.count_nonzero(np.linalg.eigvalsh(k) < 0.0)) > 1


def load_fault(campaign: Campaign) -> Finding | None:
    """Judge the weights themselves: with noise, equal weights do not show in the rank."""
    weights = campaign.effective_weights
    if len(weights) == 1:
        return Finding.of(Code.ONE_LOAD, load=campaign.loads[0].name)
    if np.ptp(weights) <= 1e-6 * np.abs(weights).max():
        return Finding.of(Code.EQUAL_LOADS, count=len(weights))
    return None


def unseen_load(nz: Array, weights: Array, moments: Moments) -> Finding | None:
    """Return that forces hardly differ between loads of (L,) weights [N]; (n,) cosines NZ."""
    share = moments.of_load * moments.weight[:, None]
    rest = (share.T @ moments.mean @ nz) / share.sum(axis=0)
    return NO_LOAD_SEEN if np.ptp(rest) < MAX_UNSEEN_LOAD * np.ptp(weights) else None


def similar_loads(weights: Array) -> Finding | None:
    """Return that (L,) weights hardly differ: then the noise of the readings limits the scale."""
    largest = np.abs(weights).max(initial=0.0)
    apart = float(np.ptp(weights)) if weights.size else 0.0
    if not 0.0 < apart < SIMILAR_LOADS_FRACTION * largest:
        return None
    return Finding.of(Code.SIMILAR_LOADS, difference=apart, largest=largest)


def refuse(faults: Iterable[Fault | Finding | None]) -> None:
    """Raise RankDeficient with the first fault, if there is one."""
    for fault in faults:
        if fault is not None:
            raise RankDeficient(fault.fault, remedy=fault.remedy)


def leverage(scaled_arms: Array, variance: Array) -> Array:
    """Return (n,) the share of each actuator in the noise of the imbalance; they sum to 3.

    From (3, n) A diag(alpha) and the (n,) variance of one reading.
    """
    solved = np.linalg.solve(imbalance_covariance(scaled_arms, variance), scaled_arms)
    return np.asarray(np.einsum("kn,kn->n", scaled_arms, solved) * variance)


_SMOOTH = (
    ("uniform", lambda x, y: (np.ones_like(x + y),)),
    ("tilt-like", lambda x, y: (x, y)),
    ("defocus-like", lambda x, y: (x**2 + y**2,)),
    ("astigmatism-like", lambda x, y: (x**2 - y**2, x * y)),
    ("coma-like", lambda x, y: ((x**2 + y**2) * x, (x**2 + y**2) * y)),
    ("trefoil-like", lambda x, y: (x**3 - 3 * x * y**2, 3 * x**2 * y - y**3)),
)


def describe_pattern(pattern: Array, layout: Layout) -> str:
    """Describe an (n,) pattern over the enabled actuators in words.

    One actuator if it has more than half of the square; otherwise the first smooth shape that,
    without those before it, has more than half; otherwise how many actuators share it.
    """
    on = layout.enabled
    square = pattern**2 / np.sum(pattern**2)
    if square.max() > 0.5:
        return f"actuator {layout.shown[on][square.argmax()]}"
    radius = np.hypot(layout.x[on], layout.y[on]).max()
    x, y = layout.x[on] / radius, layout.y[on] / radius
    rest, size = pattern / np.sqrt(np.sum(pattern**2)), 1.0
    basis = np.empty((len(x), 0))
    for name, shape in _SMOOTH:
        basis = np.linalg.qr(np.column_stack([basis, *shape(x, y)]))[0]
        left = rest - basis @ (basis.T @ rest)
        remains = float(left @ left)
        if size - remains > 0.5:
            return f"a {name} pattern"
        size = remains
    return f"a pattern of about {round(1 / np.sum(square**2))} actuators"
