"""The modal basis of a mirror: residual wavefront, forces and powers of the first N modes.

With orthonormal modes V, the covariance C of the wavefront, of which the surface takes half, and
the true forces G that hold unit displacements, the first N modes have the amplitudes and forces

    a = V' w / 2,    cov a = V' C V / 4,    f = (G V)_N a_N,    cov f = (G V)_N (cov a)_NN (G V)_N'

Actuators that are not commanded follow the others, and their deviation is part of the residual.
Only some modes at a time are in memory, since matrices of thousands of actuators are large.

The power of a coil is that of its *commanded* force, (c / efficiency)^2 with c = f / alpha; stress
in the glass and saturation depend on the true force.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from truenewton.arrays import Array, freeze
from truenewton.errors import FormatError
from truenewton.modal.true_stiffness import TrueStiffness
from truenewton.modal.turbulence import SeenTurbulence
from truenewton.quantities import Quantity, check_quantities, convert_quantities
from truenewton.records.stiffness_matrix import StiffnessMatrix
from truenewton.statics.layout import Layout
from truenewton.statics.modes import StiffnessModes

FORCE_SIGMAS = 3.0  # of the turbulent force that an actuator has to reach in addition to the static
EFFICIENCIES = Quantity(
    "N W(-1/2)", 1e-6, 1e6, "give the commanded force per root of power, as 0.51",
    "an efficiency of {:g} N/W^1/2",
)  # fmt: skip
MIN_LIMIT = 1e-12  # squares stay above zero
BLOCKS = 16  # of modes that are computed together
MIN_BLOCK = 16  # modes


@dataclass(frozen=True)
class Budget:
    """Limits of power and force of the actuators.

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
    >>> found = tn.find_modes(campaign, calibration, diameter=2.13, efficiency=0.51)
    >>> found.after.costs[0].modes_within(tn.Budget(power=0.1))  # of the stiffness modes
    41
    """

    QUANTITIES: ClassVar = {
        name: Quantity(
            unit, MIN_LIMIT, np.inf, f"give a positive one, in {unit}",
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
    """Residual wavefront, forces and powers of the first N = 1..m modes of a basis."""

    base: str  # 'stiffness', 'Zernike' or 'Karhunen-Loeve'
    # (m, m) displacement at the commanded actuators, one mode a column, of unit length
    modes: Array
    # the stiffness and the turbulence
    stiffness: TrueStiffness
    seen: SeenTurbulence
    static: Array  # (n,) static part of the true force: weight, bias, flattening [N]
    efficiency: float  # commanded force per root of power [N/W^1/2]; NaN if unknown, as powers
    residual: Array  # (m,) rms residual wavefront at all enabled actuators [m]
    # (m,) of ``force``, over the actuators [N]
    force_rms: Array
    force_worst: Array
    reach_worst: Array  # (m,) largest ``reach`` [N]
    # (m,) of all coils together, and of the worst [W]
    power_total: Array
    power_worst: Array

    def __post_init__(self) -> None:
        freeze(self, "modes", "static", "residual", "force_rms", "force_worst", "reach_worst",
               "power_total", "power_worst")  # fmt: skip

    def __repr__(self) -> str:
        return f"<Dissipation of {self.residual.size} {self.base} modes>"

    @property
    def force(self) -> Array:
        """(n, m) rms true force of the turbulence on each actuator [N]; computed at each access."""
        found = np.empty((len(self.static), len(self.residual)))
        for some, force in self._forces():
            found[:, some] = force
        return found

    @property
    def power(self) -> Array:
        """(n, m) mean power of each coil, static force included [W]."""
        return _powers(self.force, self.static, self.stiffness.enabled_alpha * self.efficiency)

    @property
    def reach(self) -> Array:
        """(n, m) true force that each actuator has to reach: static plus three sigma [N]."""
        return _reached(self.force, self.static)

    @property
    def power_mean(self) -> Array:
        """(m,) of all coils [W]."""
        return np.asarray(self.power_total / len(self.static))

    def _forces(self) -> Iterator[tuple[slice, Array]]:
        """Yield blocks of modes and the (n, b) forces of the first modes up to each."""
        for some, _, _, force in _answers(self.modes, self.stiffness, self.seen.wavefront):
            yield some, force

    def modes_within(self, limits: Budget, *, alpha_error: ArrayLike = 0.0) -> int:
        """Return the largest N such that the first 1..N modes are all within the limits.

        With a relative alpha_error, (n,) or one for all, true forces are larger by that factor; the
        powers of the commands do not change.

        Raises
        ------
        FormatError
            A limit of power, without the efficiency of the coils.
        """
        if np.isnan(self.efficiency) and min(limits.power, limits.total) < np.inf:
            raise FormatError("powers are unknown", remedy="give the efficiency of the coils")
        higher = 1.0 + np.asarray(alpha_error, dtype=float).reshape(-1, 1)
        beyond = (self.power_worst > limits.power) | (self.power_total > limits.total)
        if higher.size == 1:
            beyond |= higher[0, 0] * self.reach_worst > limits.force
        elif np.isfinite(limits.force):
            for some, force in self._forces():
                reached = higher * _reached(force, self.static)
                beyond[some] |= (reached > limits.force).any(axis=0)
        return int(np.argmax(beyond)) if beyond.any() else beyond.size


# In files and for scripts: name, unit, (m,) values of the first N = 1..m modes.
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
    efficiency: float | None,
) -> Dissipation:
    """Return residual and cost of correcting turbulence with 1..m modes, see `Dissipation`.

    The (m, m) modes are orthonormal on the commanded actuators; static forces are (n,) [N].
    """
    EFFICIENCIES.check(efficiency)
    efficiency = np.nan if efficiency is None else efficiency
    own, missed, *summaries = np.empty((7, modes.shape[1]))
    for some, of_each, of_others, force in _answers(modes, stiffness, seen.wavefront):
        own[some], missed[some] = of_each, of_others
        power = _powers(force, static, stiffness.enabled_alpha * efficiency)
        for summary, values in zip(
            summaries,
            (np.sqrt(np.mean(force**2, axis=0)), force.max(axis=0),
             _reached(force, static).max(axis=0), power.sum(axis=0), power.max(axis=0)),
            strict=True,
        ):  # fmt: skip
            summary[some] = values
    # Summed from the end: the small residual of the last modes is no difference of large numbers.
    left = np.append(np.cumsum(own[:0:-1])[::-1], 0.0)
    residual = np.sqrt((left + missed) / len(seen.wavefront))
    return Dissipation(base, modes, stiffness, seen, static, efficiency, residual, *summaries)


def _powers(force: Array, static: Array, per_root: Array) -> Array:
    """Return (n, b) powers [W] of forces, by the (n,) true force per root of power."""
    return np.asarray((force**2 + static[:, None] ** 2) / per_root[:, None] ** 2)


def _reached(force: Array, static: Array) -> Array:
    """Return (n, b) true forces that actuators have to reach [N]."""
    return np.asarray(np.abs(static)[:, None] + FORCE_SIGMAS * force)


def _answers(
    modes: Array, stiffness: TrueStiffness, wavefront: Array
) -> Iterator[tuple[slice, Array, Array, Array]]:
    """Yield blocks of b modes with three results.

    These are (b,) the variance of the wavefront along each [m^2]; with all modes up to each, (b,)
    the residual of the actuators that follow [m^2] and (n, b) the rms forces [N].

    One more mode adds b_N^2 A_NN to the variance of a force, with A = V'CV and b = G V, and twice
    b_N times its covariance with those before it: sum_j<N b_j A_jN = G V_<N (V_<N' C v_N).
    """
    on, n = stiffness.commanded, len(wavefront)
    m, step = modes.shape[1], max(modes.shape[1] // BLOCKS, MIN_BLOCK)
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
        yield (
            slice(start, start + step),
            own,
            np.maximum(left_there, 0.0).sum(axis=0),
            np.sqrt(np.maximum(variance, 0.0)),
        )
        variance, left_there = variance[:, -1:], left_there[:, -1:]


def _growth(answers: Array, before: Array, own: Array) -> Array:
    """Return the increase of variances by (n, b) modes, given their covariance with others."""
    return np.asarray(answers * (2.0 * before + answers * own))


@dataclass(frozen=True, eq=False, repr=False)
class ModalBase:
    """Stiffness modes of a mirror, and the cost of correcting turbulence."""

    # the measured stiffness of all N actuators, disabled ones and those off included
    matrix: StiffnessMatrix
    stiffness: TrueStiffness  # the true stiffness, with alpha or with alpha = 1
    modes: StiffnessModes  # its eigenmodes, softest first
    static: Array  # (n,) static part of the true force: weight, bias, flattening [N]
    seen: SeenTurbulence | None  # the turbulence, if the pupil is known
    # of the stiffness modes, Zernike's and those of Karhunen and Loeve; empty without turbulence
    costs: tuple[Dissipation, ...]

    def __repr__(self) -> str:
        return f"<ModalBase of {self.matrix.instrument}: {self.modes.stiffness.size} modes>"

    @property
    def layout(self) -> Layout:
        """All N actuators of the stiffness."""
        return self.matrix.layout


def modal_base(
    matrix: StiffnessMatrix,
    stiffness: TrueStiffness,
    modes: StiffnessModes,
    seen: SeenTurbulence | None,
    static: Array,
    efficiency: float | None,
) -> ModalBase:
    """Return the modal basis of a stiffness, with (n,) `static_force` [N], efficiency [N/W^1/2]."""
    if seen is None:
        return ModalBase(matrix, stiffness, modes, static, None, ())
    costs = (
        dissipation(name, vectors, stiffness, seen, static, efficiency)
        for name, vectors in (
            ("stiffness", modes.modes),
            ("Zernike", seen.zernike),
            ("Karhunen-Loeve", seen.karhunen_loeve),
        )
    )
    return ModalBase(matrix, stiffness, modes, static, seen, tuple(costs))
