"""Simulated measured stiffness matrices with known alpha, sensors and noise; foreign matrices."""

from dataclasses import dataclass, replace

import numpy as np

from truenewton.estimation.reciprocity.information import information
from truenewton.estimation.reciprocity.iteration import point_at
from truenewton.estimation.reciprocity.regression import Regressed
from truenewton.estimation.reciprocity.sensor_model import Values, places_of, sensors_at
from truenewton.mirrors.known import p45, ring
from truenewton.mirrors.shell.shell_model import (
    condense,
    model_shell,
    rearming,
    rigid_motions,
)
from truenewton.records.stiffness_matrix import StiffnessMatrix
from truenewton.statics.arms import arms
from truenewton.statics.layout import layout as actuators_at

PUSH = 0.4  # force of an actuator on each mode [N]
CIRCLES, ANGLES = 2, 12  # of an annulus


@dataclass(frozen=True, eq=False)
class Measured:
    """A measured stiffness, the truth, and the noise of each mode.

    Attributes
    ----------
    stiffness, exact
        (n, n) commanded force per reading, with and without noise [N/m].
    values
        True alpha and sensor parameters.
    readings, level
        (n, n) V, orthonormal; (n,) noise of an element of K_c V [N/m].
    """

    stiffness: np.ndarray
    exact: np.ndarray
    values: Values
    readings: np.ndarray
    level: np.ndarray


def drawn(random, n, gain=0.004, offset=0.0):
    """Return random alpha (5 %) and sensor parameters."""
    alpha, gains = random.normal(0.0, 0.05, n), random.normal(0.0, gain, n)
    return Values(alpha, gains, offset * random.normal(0.0, 1.0, (2, n)))


def by_plate(layout, stiffness, values, offsets=True):
    """Return K_c of the symmetrised stiffness; offset sensors read a thin plate."""
    motion = sensors_at(places_of(layout), values, slopes=offsets).motion
    return (0.5 * (stiffness + stiffness.T)) @ (motion * values.gain) / values.alpha[:, None]


def by_glass(glass, values):
    """Return K_c of the exact shell with annular sensors off their magnets."""
    mirror = glass.mirror
    layout, (dx, dy) = mirror.layout, values.offset
    seen = replace(layout, x=layout.x - dx, y=layout.y - dy)
    at = mirror.shell.along(seen.x, seen.y)
    # Mean over an annulus that is not centred on the puck, by points on circles.
    inner, outer = mirror.sensor.inner_radius, mirror.sensor.outer_radius
    nodes, weights = np.polynomial.legendre.leggauss(CIRCLES)
    radius = np.sqrt(0.5 * (inner**2 + outer**2) + 0.5 * (outer**2 - inner**2) * nodes)
    angle = 2.0 * np.pi * np.arange(ANGLES) / ANGLES
    read = np.zeros((layout.n, layout.n))
    for r, weight in zip(radius, 0.5 * weights / ANGLES, strict=True):
        for x, y in zip(r * np.cos(angle), r * np.sin(angle), strict=True):
            point = (at[0] + x, at[1] + y)
            read += weight * glass.free.influence(point, glass.places, None, mirror.puck_radius)
    rearmed = rearming(rigid_motions(*at), arms(seen)) @ read @ glass.exchange.T
    n, unit = layout.n, 1e-6  # m/N, for comparable magnitudes
    bordered = np.block([[rearmed / unit, arms(seen).T], [arms(layout), np.zeros((3, 3))]])
    return np.linalg.inv(bordered)[:n, :n] / unit * values.gain / values.alpha[:, None]


def measured(random, exact, values, noise=1e-3, stroke=1e-6):
    """Return K_c measured by modes in 8 readings, with noise [N] and a largest stroke [m]."""
    _, size, right = np.linalg.svd(exact)
    moved = np.minimum(stroke, PUSH / np.maximum(size, 1.0)) * np.sqrt(8)
    error = (noise * random.standard_normal(exact.shape) / moved) @ right
    return Measured(exact + error, exact, values, right.T, noise / moved)


def bound(made, layout, asked, motion=None):
    """Return the bound of the rms error of log alpha about its mean, for the known noise.

    It follows from the information of the likelihood at the truth, with all of K unknown.
    """
    places, n = places_of(layout, motion), layout.n
    square = (made.readings / made.level**2) @ made.readings.T
    point = point_at(places, made.values, asked, Regressed(made.exact, square, np.eye(n)).states)
    known, _ = information(point)
    known[np.diag_indices(len(known))] += asked.information(n)
    known[:n, :n] += np.trace(known[:n, :n]) / n**2
    mean = np.eye(n) - 1.0 / n
    return float(np.sqrt(np.trace(mean @ np.linalg.inv(known)[:n, :n] @ mean) / n))


# --- matrices not made for this package


def hexagon(rings_, pitch=0.03):
    """Return the layout of a hexagon of actuators."""
    q, r = np.mgrid[-rings_ : rings_ + 1, -rings_ : rings_ + 1].reshape(2, -1)
    some = np.abs(q + r) <= rings_
    return actuators_at(pitch * (q + 0.5 * r)[some], pitch * np.sqrt(0.75) * r[some])


def springs(layout, of_distance):
    """Return the stiffness whose compliance is a function of the squared distance."""
    square = (layout.x[:, None] - layout.x) ** 2 + (layout.y[:, None] - layout.y) ** 2
    return condense(of_distance(square + (5e-3) ** 2), arms(layout)).stiffness


def _plate(rigidity):
    return lambda square: square * np.log(square) / (16.0 * np.pi * rigidity)


def _membrane(tension):
    return lambda square: -np.log(square) / (4.0 * np.pi * tension)


def _neighbours(layout):
    """Return (n, n) whether two actuators are neighbours."""
    distance = np.hypot(layout.x[:, None] - layout.x, layout.y[:, None] - layout.y)
    np.fill_diagonal(distance, np.inf)
    return distance < 1.5 * np.median(distance.min(axis=1))


def _slaved(k, layout, random):
    k, near = k.copy(), _neighbours(layout)
    for i in random.choice(layout.n, 4, replace=False):
        k[i] = k[near[i]].mean(axis=0)
    return k


def without_modes(k, some):
    """Return a matrix without some modes; the stiffest is the first."""
    left, size, right = np.linalg.svd(k)
    size[some] = 0.0
    return (left * size) @ right


def _cross_talk(k, layout, share):
    return k @ np.linalg.inv(np.eye(layout.n) + share * _neighbours(layout))


def _noise_rows(k, layout, random, count):
    """Return K_c with a dead sector that contains only noise."""
    k = k.copy()
    angle = np.arctan2(layout.y, layout.x)
    some = np.argsort(np.abs(angle - angle[-1]))[:count]
    k[some] = 1e-3 * np.abs(k).max() * random.standard_normal((count, layout.n))
    return k


def _exchanged(k, random, count):
    order, some = np.arange(len(k)), random.choice(len(k), count, replace=False)
    order[some] = np.roll(some, 1)
    return k[:, order]


def foreign(date):
    """Yield names of kinds of matrices, and a function of a seed: a matrix and its log alpha."""
    mirror = p45()
    glass = model_shell(mirror)

    def made(change=lambda k, *_: k, *, layout=None, stiffness=None, noise=1e-3,
             gain=0.004):  # fmt: skip
        def by_seed(seed):
            random = np.random.default_rng([seed, 11])
            at = mirror.layout if layout is None else layout
            if stiffness is None:
                values = drawn(random, at.n, gain, 5e-4)
                exact = by_glass(glass, values)
            else:
                values = drawn(random, at.n, gain)
                exact = by_plate(at, stiffness, values, offsets=False)
            k = change(measured(random, exact, values, noise).stiffness, at, random)
            return StiffnessMatrix("FOREIGN", date, at, k), values.log_alpha

        return by_seed

    yield "P45, annuli, offsets 0.5 mm", made()
    yield "4 actuators slaved to neighbours", made(_slaved)
    yield (
        "softest eighth of modes cut",
        made(lambda k, at, _: without_modes(k, slice(-at.n // 8, None))),
    )
    yield "stiffest eighth of modes cut", made(lambda k, at, _: without_modes(k, slice(at.n // 8)))
    yield "made symmetric by its makers", made(lambda k, *_: 0.5 * (k + k.T))
    yield "cross-talk of 2 % between sensors", made(lambda k, at, _: _cross_talk(k, at, 0.02))
    yield "cross-talk of 10 %", made(lambda k, at, _: _cross_talk(k, at, 0.1))
    yield "5 % of asymmetry", made(lambda k, _, r: k * (1.0 + 0.05 * r.standard_normal(k.shape)))
    yield "6 dead actuators in a sector", made(lambda k, at, r: _noise_rows(k, at, r, 6))
    yield "12 sensors in another order", made(lambda k, _, r: _exchanged(k, r, 12))
    yield "transposed", made(lambda k, *_: k.T)
    yield "in N/um", made(lambda k, *_: 1e-6 * k)
    yield "in mN/m", made(lambda k, *_: 1e3 * k)
    yield "gains within 5 %", made(gain=0.05)
    at = ring(78)
    stiff = model_shell(at).stiffness
    yield "78 actuators, 20 mN of noise", made(layout=at.layout, stiffness=stiff, noise=0.02)
    small, wide = hexagon(3), hexagon(4)
    yield "hexagon of 37, thin plate", made(layout=small, stiffness=springs(small, _plate(30.0)))
    for name, tension in (("1e5", 1e5), ("100", 100.0)):
        stiff = springs(wide, _membrane(tension))
        yield f"membrane, 61 on a hexagon, {name} N/m", made(layout=wide, stiffness=stiff)
