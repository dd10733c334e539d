"""A mirror's glass between its actuators: what forces hold it, under whatever hangs on it.

Its shell is free to move, by Fourier for rings, by finite elements for any outline. Displacements
are along the normal, up to rigid motions, and right for every combination of forces whose sum and
torques vanish. One force alone finds no equilibrium on a free shell; its column of an influence
matrix means something only in such sums.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from truenewton.arrays import Array
from truenewton.mirrors.glass import Annulus
from truenewton.mirrors.known import GRAVITY, Mirror
from truenewton.mirrors.shell.condensation import Condensed, condense, rearming, rigid_motions
from truenewton.mirrors.shell.finite_elements.meshed_shell import MeshedShell
from truenewton.mirrors.shell.finite_elements.meshing import mesh_size_of, shell_mesh
from truenewton.mirrors.shell.fourier import RoundShell
from truenewton.mirrors.shell.places import Points
from truenewton.statics.arms import arms, resultants

WEDGE_MARGIN = 1.5e-3  # wedges of the tool outside the inner edge of the shell [m, guess]


@dataclass(frozen=True, eq=False)
class ShellModel:
    """The glass of a mirror, pushed through its pucks and read by its sensors.

    Attributes
    ----------
    mirror
        Whose glass it is.
    free
        The model of its shell.
    places
        x and y of the actuators along the glass [m].
    compliance
        (n, n) reading per true force [m/N], right for forces in balance on the shallow shell.
    exchange
        (n, n) J, from motions of the shallow shell to those of the sphere (`rearming`).
    condensed
        Its stiffness, force per reading, free to move along the arms of the balance.
    """

    mirror: Mirror
    free: RoundShell | MeshedShell
    places: Points
    compliance: Array
    exchange: Array
    condensed: Condensed

    @property
    def stiffness(self) -> Array:
        """(n, n) true force per true displacement as the sensors read it [N/m]."""
        return self.condensed.stiffness

    @cached_property
    def uniform_influence(self) -> Array:
        """(n,) reading per unit force spread evenly over the glass [m/N]."""
        return self.free.uniform_influence(self.places, sensor=self.mirror.sensor)


def model_shell(mirror: Mirror) -> ShellModel:
    """Return the glass of a mirror: a ring semi-analytically, discs and outlines by elements.

    Raises
    ------
    GeometryError
        What `RoundShell`, `shell_mesh`, `MeshedShell` and `condense` raise.
    """
    shell = mirror.shell
    places = shell.along(mirror.layout.x, mirror.layout.y)
    free: RoundShell | MeshedShell = RoundShell(shell)
    if shell.outline is not None or shell.inner_radius == 0:
        mesh = shell_mesh(shell, *places, mesh_size=mesh_size_of(shell, *places))
        free = MeshedShell(shell, mesh)
    compliance = influence(free, places, places, mirror.sensor, mirror.puck_radius)
    exchange = rearming(rigid_motions(*places), arms(mirror.layout))
    condensed = condense(exchange @ compliance @ exchange.T, arms(mirror.layout))
    return ShellModel(mirror, free, places, compliance, exchange, condensed)


def influence(
    free: RoundShell | MeshedShell,
    at: Points,
    of: Points,
    sensor: Annulus | None,
    puck_radius: float = 0.0,
) -> Array:
    """Return all rows of the (n_at, n_of) displacement or reading per unit force [m/N]."""
    parts = free.influence_in_parts(at, of, sensor=sensor, puck_radius=puck_radius)
    return np.concatenate([*parts])


@dataclass(frozen=True, eq=False)
class ExternalForces:
    """What acts on a flat mirror beside its actuators, along +z [N].

    Attributes
    ----------
    spread
        Evenly over the glass.
    at, force
        x and y [m] and size (k,) of forces at points off the actuators, along the glass.
    local
        (n,) at each actuator, along its normal.
    """

    spread: float
    at: Points
    force: Array
    local: Array


def weight_on(
    mirror: Mirror,
    weight: float,
    added: float = 0.0,
    *,
    cosine: float = 1.0,
    off_centre: Sequence[float] | Array = (0.0, 0.0),
    bias: Array | float = 0.0,
) -> ExternalForces:
    """Return what a mirror's own weight, a weight tool and the bias magnets do to it.

    The glass spread evenly, magnets and bias magnets at their actuators, the tool on its wedges.

    Parameters
    ----------
    mirror
        Its magnets, and where the tool stands.
    weight, added
        P of glass and magnets, Q of the tool [N].
    cosine
        Of the tilt of the axis from the vertical.
    off_centre
        x and y of the middle of the tool [m].
    bias
        (n,) forces of the bias magnets along the normals [N].
    """
    x, y = tool_wedges(mirror)
    magnets = np.full(mirror.layout.n, -mirror.magnet_mass * GRAVITY)
    spread = cosine * (weight - magnets.sum())
    return ExternalForces(
        spread=spread,
        at=(x + off_centre[0], y + off_centre[1]),
        force=np.full(3, cosine * added / 3),
        local=cosine * magnets / mirror.layout.nz + bias,
    )


def tool_wedges(mirror: Mirror) -> Points:
    """Return x, y [m] of the weight tool's three wedges, 120 degrees apart."""
    angle = np.radians([90.0, 210.0, 330.0])
    shell, radius = mirror.shell, mirror.tool_radius
    if radius is None:  # round a hole; on a full disc not all on the magnet in its middle
        hole = shell.inner_radius
        radius = hole + WEDGE_MARGIN if hole else shell.outer_radius / 2
    return radius * np.cos(angle), radius * np.sin(angle)


def forces_under(glass: ShellModel, external: ExternalForces) -> Array:
    """Return the (n,) forces that hold the flat mirror under external ones [N]."""
    sensor = glass.mirror.sensor
    bent = external.spread * glass.uniform_influence
    bent += influence(glass.free, glass.places, external.at, sensor) @ external.force
    straightened = glass.stiffness @ (glass.exchange @ bent)
    borne = glass.condensed.reaction @ _resultants_on_glass(glass.mirror, external)
    return np.asarray(-straightened - borne - external.local)


def external_resultants(mirror: Mirror, external: ExternalForces) -> Array:
    """Return k, (3,): total force [N] and moments x f and y f [N m], that is W + B, M_y, -M_x."""
    return _resultants_on_glass(mirror, external) + resultants(mirror.layout, external.local)


def _resultants_on_glass(mirror: Mirror, external: ExternalForces) -> Array:
    """Return the same of what does not act at the actuators."""
    spread, force, (x, y) = external.spread, external.force, mirror.shell.centroid
    moments = [spread * x + external.at[0] @ force, spread * y + external.at[1] @ force]
    return np.array([spread + force.sum(), *moments])
