"""What the first N modes of a base leave of the turbulence, and what they cost.

With orthonormal modes V, the covariance C of the wavefront, of which the surface takes half, and
the true forces G that hold unit displacements, the first N modes have the amplitudes and forces

    a = V' w / 2,    cov a = V' C V / 4,    f = (G V)_N a_N,    cov f = (G V)_N (cov a)_NN (G V)_N'

Actuators that are not commanded follow, and leave what they do not hit.

No more than a few modes at a time are in memory: of thousands of actuators each matrix counts.

A coil is heated by its *commanded* force, (c / efficiency)^2 with c = f / alpha; the glass and the
margin to saturation feel the true one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from truenewton.arrays import Array, freeze
from truenewton.errors import FormatError
from truenewton.modal.pupil import SeenTurbulence
from truenewton.modal.true_stiffness import TrueStiffness
from truenewton.quantities import Quantity, check_quantities, convert_quantities

EFFICIENCY = 0.51  # commanded force per root of power, of LBT's and P45's coils [N/W^1/2]
SIGMAS = 3.0  # of the turbulent force, beside the static one, that an actuator has to reach
LEAST = 1e-12  # of a limit; squares stay above zero
LEAST_EFFICIENCY = 1e-6
SHARE = 16  # of the modes that are taken together at a time
FEWEST = 16


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

    QUANTITIES: ClassVar = {
        name: Quantity(
            unit, LEAST, np.inf, f"give a positive one, in {unit}",
            f"the largest {name} is {{:g}} {unit}",
        )
        for name, unit in (("power", "W"), ("total", "W"), ("force", "N"))
    }  # fmt: skip

    power: float = np.inf
    total: float = np.inf
    force: float = np.inf

    def __post_init__(self) -> None:
        convert_quantities(self)
        check_quantities(self)


@dataclass(frozen=True, eq=False, repr=False)
class Dissipation:
    """Wavefront left, forces and powers of the first N = 1..m modes of a base.

    Attributes
    ----------
    base
        'stiffness', 'Zernike', ...
    modes
        (m, m) displacement at the commanded actuators, one mode a column, of unit length.
    stiffness, seen
        Forces per displacement, and the turbulence.
    static
        (n,) true force that stands whatever the turbulence does: weight, bias, flattening [N].
    efficiency
        Commanded force per root of power [N/W^1/2].
    residual
        (m,) rms wavefront that the first N modes leave, at all enabled actuators [m].
    force_rms, force_worst
        (m,) of ``force``, over the actuators [N].
    reach_worst
        (m,) largest ``reach`` [N].
    power_total, power_worst
        (m,) of all coils together, and of the worst [W].

    Raises
    ------
    FormatError
        An efficiency that is not positive.
    """

    base: str
    modes: Array
    stiffness: TrueStiffness
    seen: SeenTurbulence
    static: Array
    efficiency: float
    residual: Array
    force_rms: Array
    force_worst: Array
    reach_worst: Array
    power_total: Array
    power_worst: Array

    def __post_init__(self) -> None:
        freeze(self, "modes", "static", "residual", "force_rms", "force_worst", "reach_worst",
               "power_total", "power_worst")  # fmt: skip

    def __repr__(self) -> str:
        return f"<Dissipation of {self.residual.size} {self.base} modes>"

    @property
    def alpha(self) -> Array:
        """(n,) true Newton / commanded Newton."""
        return self.stiffness.enabled_alpha

    @property
    def force(self) -> Array:
        """(n, m) rms true force of the turbulence on each actuator [N]; found anew when asked."""
        found = np.empty((len(self.static), len(self.residual)))
        for some, force in self._forces():
            found[:, some] = force
        return found

    @property
    def power(self) -> Array:
        """(n, m) mean power of each coil, static force included [W]."""
        return _powers(self.force, self.static, self.alpha * self.efficiency)

    @property
    def reach(self) -> Array:
        """(n, m) true force that each actuator has to reach: static and three sigma [N]."""
        return _reached(self.force, self.static)

    @property
    def power_mean(self) -> Array:
        """(m,) of all coils [W]."""
        return np.asarray(self.power_total / len(self.static))

    def _forces(self) -> Iterator[tuple[slice, Array]]:
        """Yield (n, b) forces of the first modes up to each of some, and which these are."""
        for answer in _answers(self.modes, self.stiffness, self.seen.wavefront):
            yield answer.some, answer.force

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
        beyond = (self.power_worst > limits.power) | (self.power_total > limits.total)
        if higher.size == 1:
            beyond |= higher[0, 0] * self.reach_worst > limits.force
        elif np.isfinite(limits.force):
            for some, force in self._forces():
                reached = higher * _reached(force, self.static)
                beyond[some] |= (reached > limits.force).any(axis=0)
        return int(np.argmax(beyond)) if beyond.any() else beyond.size


# What stands for the first N = 1..m modes in files and for scripts: name, unit, (m,) values.
SUMMARIES: tuple[tuple[str, str, Callable[[Dissipation], Array]], ...] = (
    ("residual", "m", lambda cost: cost.residual),
    ("force_rms", "N", lambda cost: cost.force_rms),
    ("force_worst", "N", lambda cost: cost.force_worst),
    ("reach", "N", lambda cost: cost.reach_worst),
    ("power_mean", "W", lambda cost: cost.power_mean),
    ("power_worst", "W", lambda cost: cost.power_worst),
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

    Raises
    ------
    FormatError
        An efficiency that is not positive.
    """
    if not LEAST_EFFICIENCY <= efficiency <= 1.0 / LEAST_EFFICIENCY:
        raise FormatError(
            f"an efficiency of {efficiency:g} N/W^1/2",
            remedy="give the commanded force per root of power, as 0.51",
            got=efficiency,
        )
    own, missed, *summaries = np.empty((7, modes.shape[1]))
    for answer in _answers(modes, stiffness, seen.wavefront):
        own[answer.some], missed[answer.some] = answer.own, answer.missed
        power = _powers(answer.force, static, stiffness.enabled_alpha * efficiency)
        for summary, values in zip(
            summaries,
            (np.sqrt(np.mean(answer.force**2, axis=0)), answer.force.max(axis=0),
             _reached(answer.force, static).max(axis=0), power.sum(axis=0), power.max(axis=0)),
            strict=True,
        ):  # fmt: skip
            summary[answer.some] = values
    # Summed from the end: the little that the last modes leave is no difference of large numbers.
    left = np.append(np.cumsum(own[:0:-1])[::-1], 0.0)
    residual = np.sqrt((left + missed) / len(seen.wavefront))
    return Dissipation(base, modes, stiffness, seen, static, efficiency, residual, *summaries)


def _powers(force: Array, static: Array, per_root: Array) -> Array:
    """Return (n, b) powers [W] of forces, by the (n,) true force per root of power."""
    return np.asarray((force**2 + static[:, None] ** 2) / per_root[:, None] ** 2)


def _reached(force: Array, static: Array) -> Array:
    """Return (n, b) true forces that actuators have to reach [N]."""
    return np.asarray(np.abs(static)[:, None] + SIGMAS * force)


class _Answer(NamedTuple):
    """What b modes more answer to: variance of each (b,), force of all up to each (n, b)."""

    some: slice
    own: Array  # variance of the wavefront along each [m^2]
    missed: Array  # sum of what is left, up to each, where actuators follow [m^2]
    force: Array  # rms [N]


def _answers(modes: Array, stiffness: TrueStiffness, wavefront: Array) -> Iterator[_Answer]:
    """Yield what modes answer to, some after some.

    One mode more adds to the variance of a force b_N^2 A_NN, with A = V'CV and b = G V, and twice
    b_N times what it shares with those before it: sum_j<N b_j A_jN = G V_<N (V_<N' C v_N).
    """
    on, n = stiffness.commanded, len(wavefront)
    m, step = modes.shape[1], max(modes.shape[1] // SHARE, FEWEST)
    variance, left_there = np.zeros((n, 1)), np.diag(wavefront)[~on, None]
    for start in range(0, m, step):
        V, before = modes[:, start : start + step], modes[:, :start]
        everywhere = np.zeros((n, V.shape[1]))
        everywhere[on] = V
        met = wavefront @ everywhere
        own = np.einsum("ij,ij->j", V, met[on])
        shared = before @ (before.T @ met[on]) + V @ np.triu(V.T @ met[on], 1)
        moved, moved_before = stiffness.displaced(V), stiffness.displaced(shared)
        follow, follow_before = moved[~on], moved_before[~on]
        left_there = left_there + np.cumsum(
            _growth(follow, follow_before, own) - 2.0 * follow * met[~on], axis=1
        )
        G = stiffness.acting_stiffness
        variance = variance + np.cumsum(_growth(G @ moved, G @ moved_before, own) / 4.0, axis=1)
        yield _Answer(
            slice(start, start + step),
            own,
            np.maximum(left_there, 0.0).sum(axis=0),
            np.sqrt(np.maximum(variance, 0.0)),
        )
        variance, left_there = variance[:, -1:], left_there[:, -1:]


def _growth(answers: Array, before: Array, own: Array) -> Array:
    """Return by how much (n, b) answers let variances grow, given what they share with others."""
    return np.asarray(answers * (2.0 * before + answers * own))
