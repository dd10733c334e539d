"""What the first N modes of a base leave of the turbulence, and what they cost.

With orthonormal modes V, the covariance C of the wavefront, of which the surface takes half, and
the true forces G that hold unit displacements, the first N modes have the amplitudes and forces

    a = V' w / 2,    cov a = V' C V / 4,    f = (G V)_N a_N,    cov f = (G V)_N (cov a)_NN (G V)_N'

Actuators that are not commanded follow, and leave what they do not hit.

A coil is heated by its *commanded* force, (c / efficiency)^2 with c = f / alpha; the glass and the
margin to saturation feel the true one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from truenewton.arrays import Array, freeze, in_units
from truenewton.errors import FormatError
from truenewton.modal.pupil import SeenTurbulence
from truenewton.modal.true_stiffness import TrueStiffness

EFFICIENCY = 0.51  # commanded force per root of power, of LBT's and P45's coils [N/W^1/2]
SIGMAS = 3.0  # of the turbulent force, beside the static one, that an actuator has to reach


LEAST = 1e-12  # of a limit; squares stay above zero
LEAST_EFFICIENCY = 1e-6


@dataclass(frozen=True)
class Budget:
    """What actuators may bear.

    Attributes
    ----------
    power
        Largest mean power of any coil [W].
    total
        Largest mean power of all coils together [W].
    force
        Largest true force that any actuator has to reach [N]; see `Dissipation.reach`.

    Raises
    ------
    FormatError
        A limit that is not positive.

    Examples
    --------
    >>> stiffness_modes = tn.find_modes(campaign, calibration).after.costs[0]
    >>> stiffness_modes.modes_within(tn.Budget(power=0.1))
    41
    """

    power: float = np.inf
    total: float = np.inf
    force: float = np.inf

    def __post_init__(self) -> None:
        units = {"power": "W", "total": "W", "force": "N"}
        in_units(self, units)
        for name, unit in units.items():
            limit = getattr(self, name)
            if not limit >= LEAST:
                raise FormatError(
                    f"the largest {name} is {limit:g} {unit}",
                    remedy=f"give a positive one, in {unit}",
                    got=limit,
                )


@dataclass(frozen=True, eq=False, repr=False)
class Dissipation:
    """Wavefront left, forces and powers of the first N = 1..m modes of a base.

    Attributes
    ----------
    base
        'stiffness', 'Zernike', ...
    modes
        (m, m) displacement at the commanded actuators, one mode a column, of unit length.
    residual
        (m,) rms wavefront that the first N modes leave, at all enabled actuators [m].
    force
        (n, m) rms true force of the turbulence on each actuator [N].
    static
        (n,) true force that stands whatever the turbulence does: weight, bias, flattening [N].
    alpha
        (n,) true Newton / commanded Newton.
    efficiency
        Commanded force per root of power [N/W^1/2].

    Raises
    ------
    FormatError
        An efficiency that is not positive.
    """

    base: str
    modes: Array
    residual: Array
    force: Array
    static: Array
    alpha: Array
    efficiency: float

    def __post_init__(self) -> None:
        freeze(self, "modes", "residual", "force", "static", "alpha")
        if not LEAST_EFFICIENCY <= self.efficiency <= 1.0 / LEAST_EFFICIENCY:
            raise FormatError(
                f"an efficiency of {self.efficiency:g} N/W^1/2",
                remedy="give the commanded force per root of power, as 0.51",
                got=self.efficiency,
            )

    def __repr__(self) -> str:
        return f"<Dissipation of {self.residual.size} {self.base} modes>"

    @property
    def power(self) -> Array:
        """(n, m) mean power of each coil, static force included [W]."""
        mean_square = self.force**2 + self.static[:, None] ** 2
        return np.asarray(mean_square / (self.alpha[:, None] * self.efficiency) ** 2)

    @property
    def reach(self) -> Array:
        """(n, m) true force that each actuator has to reach: static and three sigma [N]."""
        return np.asarray(np.abs(self.static)[:, None] + SIGMAS * self.force)

    def modes_within(self, limits: Budget, *, alpha_error: ArrayLike = 0.0) -> int:
        """Return the largest N such that the first 1..N modes all keep within the limits.

        Parameters
        ----------
        limits
            Of power and force.
        alpha_error
            (n,) or one for all: relative, by which alpha of each actuator may be higher than
            assumed: the true force of what is commanded is so too. The power is that of the
            commands, which were measured.
        """
        higher = 1.0 + np.asarray(alpha_error, dtype=float).reshape(-1, 1)
        power = self.power
        beyond = (power > limits.power).any(axis=0) | (power.sum(axis=0) > limits.total)
        beyond |= (higher * self.reach > limits.force).any(axis=0)
        return int(np.argmax(beyond)) if beyond.any() else beyond.size


# What stands for the first N = 1..m modes in files and for scripts: name, unit, (m,) values.
SUMMARIES: tuple[tuple[str, str, Callable[[Dissipation], Array]], ...] = (
    ("residual", "m", lambda cost: cost.residual),
    ("force_rms", "N", lambda cost: np.sqrt(np.mean(cost.force**2, axis=0))),
    ("force_worst", "N", lambda cost: cost.force.max(axis=0)),
    ("reach", "N", lambda cost: cost.reach.max(axis=0)),
    ("power_mean", "W", lambda cost: cost.power.mean(axis=0)),
    ("power_worst", "W", lambda cost: cost.power.max(axis=0)),
)


def dissipation(
    base: str,
    modes: Array,
    stiffness: TrueStiffness,
    seen: SeenTurbulence,
    static: Array,
    efficiency: float = EFFICIENCY,
) -> Dissipation:
    """Return what correcting turbulence with 1..m modes leaves and costs.

    Parameters
    ----------
    base, static, efficiency
        As in `Dissipation`.
    modes
        (m, m) V, orthonormal on the commanded actuators.
    stiffness
        Tells the forces per displacement G, (n, m), and where actuators follow that are not
        commanded.
    seen
        The turbulence at all n actuators.
    """
    on, C = stiffness.commanded, seen.wavefront
    amplitudes = modes.T @ C[np.ix_(on, on)] @ modes
    own = np.diag(amplitudes)
    # Summed from the end: the little that the last modes leave is no difference of large numbers.
    left = np.append(np.cumsum(own[:0:-1])[::-1], 0.0)
    follow = stiffness.shapes[~on] @ modes
    shared = follow * (C[np.ix_(~on, on)] @ modes)
    left_there = np.diag(C)[~on, None] - 2.0 * np.cumsum(shared, axis=1)
    left_there += _growing_variance(follow, amplitudes)
    return Dissipation(
        base,
        modes,
        np.sqrt((left + np.maximum(left_there, 0.0).sum(axis=0)) / len(C)),
        np.sqrt(np.maximum(_growing_variance(stiffness.forces @ modes, amplitudes / 4.0), 0.0)),
        static,
        stiffness.enabled_alpha,
        efficiency,
    )


def _growing_variance(answers: Array, amplitudes: Array) -> Array:
    """Return (n, m) variances of (n, m) answers to 1..m modes, whose amplitudes covary so.

    One mode more adds b_N^2 A_NN, and twice b_N times what it shares with those before it.
    """
    before = answers @ np.triu(amplitudes, 1)
    return np.cumsum(answers * (2.0 * before + answers * np.diag(amplitudes)), axis=1)
