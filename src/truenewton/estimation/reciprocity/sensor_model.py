"""The unknowns of reciprocity, and the readings of the sensors at given offsets.

The unknowns are the logarithms of alpha and of the sensor gains, and the offsets of the sensors
from their magnets. The magnets are at x_j, where the forces do work, and the sensors at
x_j - delta_j. H converts displacements at the sensors to displacements at the magnets.

If the shell is not modelled, its shape is that of a thin plate through the readings:

    u(x) = sum_k beta_k phi(|x - x_k|) + gamma (1, x),    phi(d) = d^2 log d
    sum beta = 0,  sum beta x = 0

G_x and G_y convert displacements at the sensors to slopes there. u is linear in the readings z, so
the derivative of H by an offset is exact:

    d(H z) / d(delta_xj) = H e_j (G_x z)_j

A model of the shell is more accurate: H = H_0 Lambda^-1 and G_x = Lambda_x Lambda^-1. H_0 is H for
sensors at their magnets. Lambda(delta) converts readings at the magnets to readings at the sensors,
to second order in the offset of each sensor. Lambda_x is its derivative along x.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np
from scipy.linalg import lu_factor, lu_solve

from truenewton.arrays import Array
from truenewton.linalg import ROWS_AT_ONCE
from truenewton.statics.layout import Layout


class Kind(StrEnum):
    """A kind of unknown, one of each actuator."""

    ALPHA = "log alpha"
    GAIN = "log g"
    X = "delta x"
    Y = "delta y"


OFFSETS = (Kind.X, Kind.Y)


@dataclass(frozen=True, eq=False)
class Values:
    """Values of the unknowns."""

    log_alpha: Array  # (n,) of true / commanded Newton
    log_gain: Array  # (n,) of true displacement / reading
    offset: Array  # (2, n) x and y of magnet less sensor [m]

    @property
    def alpha(self) -> Array:
        """(n,) true Newton / commanded Newton."""
        return np.exp(self.log_alpha)

    @property
    def gain(self) -> Array:
        """(n,) true displacement / reading."""
        return np.exp(self.log_gain)

    def same_sensors(self, other: Values) -> bool:
        """Return whether gains and offsets are the same."""
        same_gain = np.array_equal(self.log_gain, other.log_gain)
        return same_gain and np.array_equal(self.offset, other.offset)

    def of(self, kind: Kind) -> Array:
        """Return the (n,) unknowns of a kind."""
        if kind in OFFSETS:
            return np.asarray(self.offset[OFFSETS.index(kind)])
        return self.log_alpha if kind == Kind.ALPHA else self.log_gain


def at_nominal(n: int) -> Values:
    """Return the declared values: every alpha and gain 1, sensors at their magnets."""
    return Values(np.zeros(n), np.zeros(n), np.zeros((2, n)))


@dataclass(frozen=True)
class Request:
    """Which unknowns are estimated, and their spreads."""

    # standard deviation of log g over the sensors; 0: gains known, infinite: free
    gain_spread: float = 0.0
    # standard deviation of an offset along an axis [m]; 0: at the magnets
    offset_spread: float = 0.0
    estimated: bool = False  # whether spreads that are neither 0 nor infinite follow from the data

    @property
    def kinds(self) -> tuple[Kind, ...]:
        """The kinds of unknowns, in their order."""
        gains = (Kind.GAIN,) if self.gain_spread else ()
        return (Kind.ALPHA, *gains, *(OFFSETS if self.offset_spread else ()))

    def information(self, n: int) -> Array:
        """Return the (u,) prior information on the unknowns."""
        spreads = {Kind.ALPHA: np.inf, Kind.GAIN: self.gain_spread}
        return np.concatenate(
            [np.full(n, spreads.get(kind, self.offset_spread) ** -2.0) for kind in self.kinds]
        )

    def vector(self, values: Values) -> Array:
        """Return the (u,) unknowns that are estimated."""
        return np.concatenate([values.of(kind) for kind in self.kinds])

    def moved(self, values: Values, step: Array) -> Values:
        """Return the values after a (u,) step, with free scales at mean log 0."""
        by = dict(zip(self.kinds, np.split(step, len(self.kinds)), strict=True))
        nothing = np.zeros_like(values.log_alpha)
        log_alpha = values.log_alpha + by[Kind.ALPHA]
        log_gain = values.log_gain + by.get(Kind.GAIN, nothing)
        return replace(
            values,
            log_alpha=log_alpha - log_alpha.mean(),
            log_gain=log_gain - (log_gain.mean() if np.isinf(self.gain_spread) else 0.0),
            offset=values.offset + np.array([by.get(kind, nothing) for kind in OFFSETS]),
        )


# First spreads of log g and of offsets [m], before they are estimated.
START_REQUEST = Request(gain_spread=0.004, offset_spread=5e-4, estimated=True)


@dataclass(frozen=True, eq=False)
class Places:
    """Positions of the enabled actuators."""

    x: Array  # (n,) of their magnets [m]
    y: Array  # (n,) of their magnets [m]
    nz: Array  # (n,) z component of the normals
    motion: Array | None = None  # (n, n) H_0 for sensors at the magnets, by a model of the shell
    # (5, n, n) derivatives of the readings with the positions of the sensors, x, y [1/m], xx, xy,
    # yy [1/m2], for what all would read at their magnets, by a model of the shell
    changes: Array | None = None

    @property
    def n(self) -> int:
        """Number of actuators."""
        return len(self.x)

    @property
    def length(self) -> float:
        """Rms distance from the axis [m]."""
        return float(np.sqrt(np.mean(self.x**2 + self.y**2)))

    @property
    def rigid(self) -> Array:
        """(n, 3) R: rigid motions of the magnets, tilts in units of ``length``."""
        return np.stack([self.nz, self.x / self.length, self.y / self.length], axis=1)

    def rigid_readings(self, values: Values) -> Array:
        """Return (n, 3) readings of rigid motions, by gains and offsets of the sensors."""
        dx, dy = values.offset
        seen = [self.nz, (self.x - dx) / self.length, (self.y - dy) / self.length]
        return np.asarray(np.stack(seen, axis=1) / values.gain[:, None])


def places_of(layout: Layout, motion: Array | None = None) -> Places:
    """Return the positions of the enabled actuators of a layout, and what a shell model implies.

    ``motion`` is (n, n) for all actuators, or (6, n, n) with its changes. Disabled actuators float:
    their sensors read the plate between the others.
    """
    on = layout.enabled
    places = Places(layout.x[on], layout.y[on], layout.nz[on])
    if motion is None:
        return places
    read = np.zeros((layout.n, places.n))
    read[on] = np.eye(places.n)
    if not on.all():
        at = np.stack([layout.x, layout.y]) / places.length
        rows = _plate_rows(at[:, ~on], at[:, on], np.empty((layout.n - places.n, places.n + 3)))
        read[~on] = np.linalg.solve(_held_plate(at[:, on], at[:, on]).T, rows.T).T[:, : places.n]
    seen = (motion[..., on, :] @ read).reshape(-1, places.n, places.n)
    return replace(places, motion=seen[0], changes=seen[1:] if len(seen) > 1 else None)


@dataclass(frozen=True, eq=False)
class SensorModel:
    """What the sensors see."""

    motion: Array  # (n, n) H, displacements at the magnets for those at the sensors
    # (2, n, n) G_x, G_y: slopes for displacements at the sensors [1/m]; None without offsets
    slopes: Array | None = None


def sensors_at(places: Places, values: Values, *, slopes: bool) -> SensorModel:
    """Return the (n, n) sensor model at given values, by a model of the shell or by a plate.

    Without either H is 1: an annular sensor around its magnet sees less of a bend, but nearly in
    proportion over the mirror, so that the stiffness stays nearly symmetric.
    """
    n = places.n
    motion = np.eye(n) if places.motion is None else places.motion
    if not slopes:
        return SensorModel(motion)
    if places.changes is not None:
        return _by_glass(motion, places.changes, values.offset)
    unit = places.length
    at = np.stack([places.x, places.y]) / unit
    seen = at - values.offset / unit
    system, dx, dy = _held_plate(seen, at), *_plate(seen, at)[1:]
    rows = np.zeros((3, n, n + 3))
    _plate_rows(at, at, rows[0])
    rows[1, :, :n], rows[1, :, n + 1] = dx / unit, 1.0 / unit
    rows[2, :, :n], rows[2, :, n + 2] = dy / unit, 1.0 / unit
    solved = lu_solve(lu_factor(system, check_finite=False), rows.reshape(3 * n, -1).T, trans=1)
    across = solved.T.reshape(3, n, n + 3)[:, :, :n]
    return SensorModel(across[0] if places.motion is None else motion @ across[0], across[1:])


def motion_from(places: Places, offset: Array) -> Array:
    """Return only the (n, n) H of `sensors_at` for (2, n) offsets, with little memory."""
    if places.motion is not None or not offset.any():
        values = Values(np.zeros(places.n), np.zeros(places.n), offset)
        return sensors_at(places, values, slopes=bool(offset.any())).motion
    n, at = places.n, np.stack([places.x, places.y]) / places.length
    system = _held_plate(at - offset / places.length, at)
    factors = lu_factor(system.T, overwrite_a=True, check_finite=False)
    rows = _plate_rows(at, at, np.empty((n, n + 3)))
    return np.asarray(lu_solve(factors, rows.T, overwrite_b=True, check_finite=False).T[:, :n])


def _by_glass(motion: Array, changes: Array, offset: Array) -> SensorModel:
    """Return what sensors off their magnets see, by a model of the shell."""
    x, y = -offset[:, :, None]
    along, across, xx, xy, yy = changes
    slopes = np.stack([along + x * xx + y * xy, across + x * xy + y * yy])
    read = 0.5 * (x * (along + slopes[0]) + y * (across + slopes[1]))
    read[np.diag_indices(len(read))] += 1.0
    back = np.linalg.inv(read)
    return SensorModel(motion @ back, slopes @ back)


def _held_plate(seen: Array, centres: Array) -> Array:
    """Return the (n + 3, n + 3) equations of a plate through (2, n) sensor positions."""
    n = seen.shape[1]
    system = np.zeros((n + 3, n + 3))
    _plate_rows(seen, centres, system[:n])
    system[n:, :n] = _linear(centres).T
    return system


def _plate_rows(of: Array, centres: Array, rows: Array) -> Array:
    """Fill (m, n + 3) rows with the plate at positions (2, m), in parts; return them."""
    m, n = of.shape[1], centres.shape[1]
    for start in range(0, m, ROWS_AT_ONCE):
        some = slice(start, min(start + ROWS_AT_ONCE, m))
        rows[some, :n] = _plate(of[:, some], centres)[0]
    rows[:, n:] = _linear(of)
    return rows


def _linear(of: Array) -> Array:
    """Return (n, 3) 1, x and y of positions (2, n)."""
    return np.concatenate([np.ones((1, of.shape[1])), of]).T


def _plate(of: Array, centres: Array) -> tuple[Array, Array, Array]:
    """Return (n, n) d^2 log d of positions (2, n) from centres, and its slopes along x and y."""
    x, y = of[:, :, None] - centres[:, None, :]
    square = x**2 + y**2
    log = np.log(np.where(square > 0.0, square, 1.0))
    return 0.5 * square * log, x * (log + 1.0), y * (log + 1.0)
