"""The three blocks of equations that a true stiffness obeys, and the information in them.

    S = Q'F                  statics: forces of a free shell balance            (3 x m)
    t = W'D_alpha K_c z_R    rigid motions cost no force                        (m x 3)
    A = T - T', T = W'F      reciprocity: the work of each state's displacement on the other's
                             force is the same                                  m (m - 1) / 2

Score and information of the unknowns are sums of Hadamard products, as the derivative of T = W'F
with respect to each unknown has rank one, dT = p q':

    log alpha_i    p = W'e_i            q = F^'e_i
    log g_j        p = (D_g V)'e_j      q = F^'H e_j
    delta_j        p = (G D_g V)'e_j    q = F^'H e_j

with the most likely forces F^ in place of F. By the envelope theorem that is the score of the
likelihood from which the unknown stiffness is eliminated, and noise is not multiplied by noise.
"""

from __future__ import annotations

import functools
import itertools
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np

from truenewton.arrays import Array
from truenewton.estimation.reciprocity.sensor_model import OFFSETS, Kind, SensorModel, Values
from truenewton.linalg import thread_count


@dataclass(frozen=True, eq=False)
class States:
    """States of the mirror at given unknowns, and the rigid motions beside them.

    W, Q span the displacements at the magnets and X, Y the forces, with W'X = 1, Q'Y = 1, W'Y = Q'X
    = 0. Likewise the readings V, z_R with ``dual``: V'dual = 1, z_R'dual = 0.
    """

    readings: Array  # (n, m) V
    forces: Array  # (n, m) true F = D_alpha K_c V
    displacements: Array  # (n, m) W = H D_g V except for rigid motions
    rigid_readings: Array  # (n, 3) z_R = D_g^-1 [nz, (x - dx)/L, (y - dy)/L] turn
    rigid_forces: Array  # (n, 3) D_alpha K_c z_R, only errors
    turn: Array  # (3, 3) of the rigid readings
    rigid: Array  # (n, 3) Q, rigid motions of the magnets
    displaced: Array  # (n, m) X
    balancing: Array  # (n, 3) Y
    dual: Array  # (n, m) of the readings

    @property
    def count(self) -> int:
        """Number of states."""
        return int(self.readings.shape[1])

    @functools.cached_property
    def residuals(self) -> Residuals:
        """The residuals of the equations."""
        w = self.displacements
        return Residuals(self.rigid.T @ self.forces, w.T @ self.rigid_forces, w.T @ self.forces)


@dataclass(frozen=True, eq=False)
class Weights:
    """Weights of the equations: 1 over the variance of each residual."""

    statics: Array  # (3, m) of S
    rigid: Array  # (m, 3) of t
    reciprocity: Array  # (b, b) of A, by bins of states
    bins: tuple[slice, ...]  # slices of similar states
    share: Array | None = None  # (m, m) variance of T over that of A; None for one half
    exact: Array | None = None  # (m, m) weights of A, if known state by state

    def every(self, some: slice) -> Weights:
        """Return those of some of the states, in the same bins."""
        kept = np.arange(self.statics.shape[1])[some]
        edges = np.searchsorted(kept, [0, *(each.stop for each in self.bins)]).tolist()
        return replace(
            self,
            statics=self.statics[:, some],
            rigid=self.rigid[some],
            bins=tuple(slice(*pair) for pair in itertools.pairwise(edges)),
            share=None if self.share is None else self.share[some, some],
            exact=None if self.exact is None else self.exact[some, some],
        )

    @property
    def of_balance(self) -> Weights:
        """Those of statics only."""
        return replace(self, rigid=0.0 * self.rigid, reciprocity=0.0 * self.reciprocity)

    @property
    def of_symmetry(self) -> Weights:
        """Those of rigid motions and reciprocity only."""
        return replace(self, statics=0.0 * self.statics)

    @property
    def of_pairs(self) -> Array:
        """(m, m) weights of A."""
        if self.exact is not None:
            return self.exact
        sizes = [some.stop - some.start for some in self.bins]
        return np.asarray(np.repeat(np.repeat(self.reciprocity, sizes, axis=0), sizes, axis=1))


def equal_bins(count: int, bins: int) -> tuple[slice, ...]:
    """Return slices that divide so many states into bins of nearly equal number."""
    edges = np.linspace(0, count, max(1, min(bins, count)) + 1).round().astype(int)
    return tuple(slice(int(a), int(b)) for a, b in itertools.pairwise(edges))


@dataclass(frozen=True, eq=False)
class Residuals:
    """Residuals of the equations."""

    statics: Array  # (3, m) S
    rigid: Array  # (m, 3) t
    work: Array  # (m, m) T

    @property
    def reciprocity(self) -> Array:
        """(m, m) A."""
        return np.asarray(self.work - self.work.T)

    def chi2(self, weights: Weights) -> tuple[float, float, float]:
        """Return the weighted sums of squares of S, t and A."""
        pairs = weights.of_pairs * self.reciprocity**2
        return (
            float(np.sum(weights.statics * self.statics**2)),
            float(np.sum(weights.rigid * self.rigid**2)),
            float(0.5 * np.sum(pairs)),
        )


@dataclass(frozen=True, eq=False)
class Likeliest:
    """The most likely true forces of the states, which obey the equations."""

    forces: Array  # (n, m) F^: Q'F^ = 0, W'F^ symmetric
    # (n, m) true work on each state by a reading at each sensor, (D_alpha K_c^)' W
    by_reading: Array


def likeliest(states: States, left: Residuals, weights: Weights) -> Likeliest:
    """Return the most likely forces: residuals of the measured ones are shared by variance."""
    share = 0.5 if weights.share is None else weights.share
    forces, work = states.forces, left.work
    if weights.statics.any():  # what is not asked for corrects nothing
        forces = forces - states.balancing @ left.statics
    if weights.reciprocity.any():
        correction = -share * left.reciprocity
        forces, work = forces + states.displaced @ correction, work + correction
    return Likeliest(forces, states.dual @ work.T)


@dataclass(frozen=True, eq=False)
class Design:
    """Effect of one kind of unknowns."""

    p: Array  # (m, n) dT = p_j q_j' for unknown j
    q: Array  # (m, n)
    # (n, 3) c: dt = by_reading_j c_j' for unknown j; None without effect on t
    rigid: Array | None = None


@dataclass(frozen=True, eq=False)
class Point:
    """Everything at one set of values of the unknowns."""

    states: States
    left: Residuals
    weights: Weights
    fitted: Likeliest
    designs: dict[Kind, Design]  # of each kind of unknowns


def designs(
    kinds: tuple[Kind, ...],
    values: Values,
    seen: SensorModel,
    states: States,
    fitted: Likeliest,
    length: float,
) -> dict[Kind, Design]:
    """Return the design of each kind at given values, with (m, n) p and q."""
    made = {Kind.ALPHA: Design(states.displacements.T, fitted.forces.T)}
    if len(kinds) == 1:
        return made
    gain = values.gain
    read = gain[:, None] * states.readings
    q = (seen.motion.T @ fitted.forces).T
    for kind in kinds[1:]:
        if kind == Kind.GAIN:
            made[kind] = Design(read.T, q, -states.rigid_readings)
        elif seen.slopes is not None:
            axis = OFFSETS.index(kind)
            tilt = -np.outer(1.0 / (gain * length), states.turn[1 + axis])
            made[kind] = Design((seen.slopes[axis] @ read).T, q, tilt)
    return made


def score(point: Point) -> Array:
    """Return the (u,) gradient of half the sum of squares."""
    states, left, weights = point.states, point.left, point.weights
    symmetric = bool(weights.reciprocity.any())
    by_rigid = point.fitted.by_reading @ (weights.rigid * left.rigid)
    parts = []
    pulled = dict[int, Array]()
    if symmetric:
        pull = (weights.of_pairs * left.reciprocity).astype(left.work.dtype, copy=False)
        forces = {id(design.q): design.q for design in point.designs.values()}
        pulled = {key: pull @ q for key, q in forces.items()}
    for kind, design in point.designs.items():
        part = np.zeros(design.p.shape[1])
        if symmetric:
            part += np.sum(design.p * pulled[id(design.q)], axis=0)
        if kind == Kind.ALPHA:
            on = (weights.statics * left.statics) @ point.fitted.forces.T
            part += np.sum(states.rigid * on.T, axis=1)
        if design.rigid is not None:
            part += np.sum(by_rigid * design.rigid, axis=1)
        parts.append(part)
    return np.concatenate(parts)


@dataclass(frozen=True, eq=False)
class Leverage:
    """Sums of leverages: how much of each block of residuals a fit takes up."""

    statics: Array  # (3, b)
    rigid: Array  # (b, 3)
    reciprocity: Array  # (b, b) of unordered pairs of bins, in either place


@dataclass(frozen=True, eq=False)
class Fitted:
    """The (u, u) covariance of the unknowns, with its weights."""

    covariance: Array
    weights: Weights


def information(
    point: Point, before: Fitted | None = None, *, single: bool = False
) -> tuple[Array, Leverage | None]:
    """Return the (u, u) information, and the leverages of the fit ``before``, if given.

    ``single`` precision is sufficient for a step and takes half the time.
    """
    kinds, n = list(point.designs), point.states.readings.shape[0]
    total = np.zeros((n * len(kinds), n * len(kinds)))
    if single:
        point, total = in_single(point), to_single(total)
    bins = len(point.weights.bins)
    taken = Leverage(np.zeros((3, bins)), np.zeros((bins, 3)), np.zeros((bins, bins)))
    size = 32  # actuators at once, so that their products stay in the cache
    blocks = range(0, n if point.weights.reciprocity.any() else 0, size)

    def add(starts: range) -> list[Array]:
        # Allocation is slow: each thread has its own memory, once.
        room = np.empty((5 + 4 * len(kinds), bins * size * n), total.dtype)
        some = (slice(start, min(start + size, n)) for start in starts)
        return [_add_reciprocity(total, point, rows, before, room) for rows in some]

    if blocks:
        count = min(thread_count(), 4, len(blocks))  # each needs some tens of megabytes
        parts = np.empty((len(blocks), bins, bins))  # summed in one order, for any threads
        with ThreadPoolExecutor(count) as pool:
            for k, each in enumerate(pool.map(add, (blocks[k::count] for k in range(count)))):
                parts[k::count] = each
        taken.reciprocity[:] = parts.sum(axis=0)
        by_kind = total.reshape(len(kinds), n, len(kinds), n)
        for i, j in itertools.combinations_with_replacement(range(len(kinds)), 2):
            above, below = by_kind[i, :, j], by_kind[j, :, i]
            above[:] = np.triu(above) + np.tril(below.T, -1)
    _add_statics(total, point, before, taken)
    _add_rigid(total, point, before, taken)
    for k in range(1, len(kinds)):
        total[k * n : (k + 1) * n, : k * n] = total[: k * n, k * n : (k + 1) * n].T
    return total, None if before is None else taken


def to_single(values: Array) -> Array:
    """Return values of any shape, such as (n, m), in single precision."""
    return np.asarray(values, dtype=np.float32)


def in_single(point: Point) -> Point:
    """Return a point with large matrices in single precision; designs still share q."""
    q = {id(design.q): to_single(design.q) for design in point.designs.values()}
    made = {
        kind: replace(design, p=to_single(design.p), q=q[id(design.q)])
        for kind, design in point.designs.items()
    }
    fitted = Likeliest(to_single(point.fitted.forces), to_single(point.fitted.by_reading))
    return replace(point, fitted=fitted, designs=made)


def _add_reciprocity(
    total: Array, point: Point, some: slice, before: Fitted | None, room: Array
) -> Array:
    """Add sums over pairs of bins of w [(P'p) o (Q'q) - (P'q) o (Q'p)] to some rows.

    For every pair of kinds, but only columns from these rows on: the information is symmetric. All
    kinds of unknowns of the sensors share one q. Returns the (b, b) part of the `Leverage` of these
    elements and their counterparts.
    """
    weights, designs = point.weights, [*point.designs.values()]
    bins, n = len(weights.bins), designs[0].p.shape[1]
    w = weights.reciprocity.astype(total.dtype)
    rest, size = slice(some.start, n), some.stop - some.start
    count = size * (n - some.start)
    forces = list({id(design.q): design.q for design in designs}.values())
    of = [next(k for k, q in enumerate(forces) if q is design.q) for design in designs]
    spare = iter(room[:, : bins * count].reshape(-1, bins, count))

    def grams(left: Array, right: Array, out: Array | None = None) -> Array:
        out = next(spare) if out is None else out
        for each, k in zip(out, weights.bins, strict=True):
            np.matmul(left[k, some].T, right[k, rest], out=each.reshape(size, -1))
        return out

    pp = next(spare)
    qq = [[grams(q, other) for other in forces] for q in forces]
    pq = [[grams(design.p, q) for q in forces] for design in designs]
    qp = [[grams(q, design.p) for q in forces] for design in designs]
    weighed_qq, weighed_qp = ([[w @ each for each in row] for row in rows] for rows in (qq, qp))
    taken = np.zeros((bins, bins))
    for (i, one), (j, other) in itertools.product(enumerate(designs), repeat=2):
        rows, columns = slice(i * n, (i + 1) * n), slice(j * n, (j + 1) * n)
        grams(one.p, other.p, pp)
        both = np.einsum("ak,ak->k", pp, weighed_qq[of[i]][of[j]])
        both -= np.einsum("ak,ak->k", pq[i][of[j]], weighed_qp[j][of[i]])
        total[rows, columns][some, rest] += both.reshape(size, -1)
        if before is not None:
            c = before.covariance[rows, columns][some, rest].copy()
            c[:, size:] *= 2.0  # for their counterparts in the lower triangle
            c = c.ravel()
            pp *= c
            taken += pp @ qq[of[i]][of[j]].T - (pq[i][of[j]] * c) @ qp[j][of[i]].T
    if before is not None:
        taken *= before.weights.reciprocity
        taken += taken.T
        taken[np.diag_indices(bins)] *= 0.5
    return taken


def _add_statics(total: Array, point: Point, before: Fitted | None, taken: Leverage) -> None:
    """Add the (n, n) sum over the three equations of (Q_r Q_r') o (F^ diag(w) F^')."""
    f, weights = point.fitted.forces, point.weights
    q, n = point.states.rigid.astype(f.dtype), len(f)
    if Kind.ALPHA not in point.designs:
        return
    for r in range(3):
        scaled = q[:, r, None] * f
        weighted = scaled * np.sqrt(weights.statics[r]).astype(f.dtype)
        total[:n, :n] += weighted @ weighted.T
        if before is not None:
            each = np.sum(scaled * (before.covariance[:n, :n] @ scaled), axis=0)
            taken.statics[r] += _by_bin(each * before.weights.statics[r], weights)


def _add_rigid(total: Array, point: Point, before: Fitted | None, taken: Leverage) -> None:
    """Add the (n, n) sums over rigid motions of (c_r d_r') o (KV diag(w) KV')."""
    kv, weights = point.fitted.by_reading, point.weights
    n = len(kv)
    felt = [(i, d.rigid) for i, d in enumerate(point.designs.values()) if d.rigid is not None]
    for r in range(3):
        if not felt:
            return
        weighted = kv * np.sqrt(weights.rigid[:, r]).astype(kv.dtype)
        gram = weighted @ weighted.T
        met = np.zeros_like(gram)
        for k, (i, c) in enumerate(felt):
            for j, d in felt[k:]:
                rows, columns = slice(i * n, (i + 1) * n), slice(j * n, (j + 1) * n)
                both = np.outer(c[:, r], d[:, r]).astype(kv.dtype)
                total[rows, columns] += both * gram
                if before is not None:
                    met += (1 + (i != j)) * both * before.covariance[rows, columns]
        if before is not None:
            each = np.sum(kv * (met @ kv), axis=0)
            taken.rigid[:, r] += _by_bin(each * before.weights.rigid[:, r], weights)


def _by_bin(values: Array, weights: Weights) -> Array:
    """Return (b,) sums of (m,) values of the states over each bin."""
    return np.asarray(np.add.reduceat(values, [some.start for some in weights.bins]))
