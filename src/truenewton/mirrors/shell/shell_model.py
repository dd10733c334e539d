"""The shell of a mirror between its actuators: the forces that hold it, and the shapes it takes.

The shell is free to move: by Fourier series for rings, by finite elements for any outline.
Displacements are along the normal, up to rigid motions, and correct for every combination of forces
whose sum and torques vanish. A single force has no equilibrium on a free shell: its column of an
influence matrix is meaningful only in such sums.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import qr

from truenewton.arrays import Array
from truenewton.errors import GeometryError
from truenewton.mirrors.glass import Annulus, Points, rim
from truenewton.mirrors.known import GRAVITY, Mirror
from truenewton.mirrors.shell.mesh import mesh_size_of, shell_mesh
from truenewton.mirrors.shell.meshed_shell import MeshedShell
from truenewton.mirrors.shell.round_shell import RoundShell
from truenewton.statics.arms import arms, resultants

WEDGE_MARGIN = 1.5e-3  # from the inner edge of the shell to the wedges of the tool [m, guess]


@dataclass(frozen=True, eq=False)
class Condensed:
    """The forces that hold a free glass at its actuators."""

    stiffness: Array  # (n, n) K [N/m]; rigid motions need no force
    # (n, 3) R; -R T_q are the forces that carry a load of resultants T_q at fixed actuators, apart
    # from the displacement of the load
    reaction: Array
    # (3, n) rigid motion, as multiples of the tilts, that goes with displacements [1/m per m]
    motion: Array


def rigid_motions(x: Array, y: Array) -> Array:
    """Return T, (3, n): the rigid motions 1, x, y of a shallow shell at (n,) places [-, m, m]."""
    return np.array([np.ones_like(x), x, y])


def condense(compliance: Array, tilts: Array) -> Condensed:
    """Return the forces that hold displacements, from influences for balanced forces.

    Displacements z at the actuators, under a load that alone moves them by w_q and whose force and
    moments are T_q, need the forces f = K (z - w_q) - R T_q. K is symmetric if displacements are
    read at the points of the forces. A sensor reads another mean of the shape, z = S w, and
    K = K_w S^-1 with the symmetric stiffness K_w by the displacement w that the forces do work on.

    This inverts the bordered system [[G, T'], [T, 0]] (forces f and a rigid motion c such that G f
    + T' c = z and T f = 0) on the balanced forces alone. The compliance G is (n, n), up to rigid
    motions [m/N]. The tilts T are (3, n), rows 1, x, y at the actuators [-, m, m]: the rigid
    motions, and the arms of the forces that the compliance is right for.
    """
    n = tilts.shape[1]
    if np.linalg.matrix_rank(tilts) < 3:
        raise GeometryError(
            f"the {n} actuators are on one line and cannot control a tilt",
            remedy="give at least three that do not",
        )
    basis, triangle = qr(tilts.T)
    balanced, arms = basis[:, 3:], np.linalg.solve(triangle[:3], basis[:, :3].T).T
    flexibility = balanced.T @ compliance @ balanced
    # The inverse, not a solve: balanced' tilts' = 0 then makes rigid motions free to rounding.
    stiffness: Array = balanced @ np.linalg.inv(flexibility) @ balanced.T
    motion = arms.T - (arms.T @ compliance) @ stiffness
    return Condensed(stiffness, arms - stiffness @ (compliance @ arms), motion)


def rearming(tilts: Array, arms: Array) -> Array:
    """Return J, (n, n): the displacements of a sphere for those of a shallow shell, z = J w.

    A shallow shell is free to move as T, (3, n): 1, x, y along the glass. A sphere is free to move
    as nz and the distances from the axis, the arms of the balance (`statics.arms`), which differ by
    2.5 % at the edge of LBT672. Only the rigid part of w is exchanged,

        J = 1 + (arms - T)' (T T')^-1 T

    so that J T' are the arms, and motions without a rigid part do not change. By virtual work the
    shell feels the forces J' f, balanced over the tilts if f is balanced over the arms. So J G J'
    is the compliance to `condense` with the arms, and J w_q the influence of a load. Without J the
    springs that hold the unbalanced shell would change the result.
    """
    return np.asarray(np.eye(tilts.shape[1]) + (arms - tilts).T @ np.linalg.pinv(tilts).T)


@dataclass(frozen=True, eq=False)
class ShellModel:
    """The shell of a mirror, under forces on its pucks and read by its sensors."""

    mirror: Mirror
    free: RoundShell | MeshedShell  # its free shell
    places: Points  # x and y of the actuators along the glass [m]
    # (n, n) reading per true force [m/N], correct for balanced forces on the shallow shell
    compliance: Array
    # (n, n) J, from motions of the shallow shell to those of the sphere (`rearming`)
    exchange: Array
    # its stiffness, force per reading, free to move as the arms of the balance
    condensed: Condensed

    @property
    def shallow(self) -> Condensed:
        """The same of the shallow shell, free to move as 1, x, y along the glass; not kept."""
        return condense(self.compliance, rigid_motions(*self.places))

    @property
    def stiffness(self) -> Array:
        """(n, n) true force per true displacement under the sensors [N/m]."""
        return self.condensed.stiffness

    @cached_property
    def uniform_influence(self) -> Array:
        """(n,) reading per unit force spread evenly over the glass [m/N]."""
        return self.free.uniform_influence(self.places, sensor=self.mirror.sensor)


def model_shell(mirror: Mirror) -> ShellModel:
    """Return the shell of a mirror: rings semi-analytically, discs and outlines by elements."""
    shell = mirror.shell
    places = shell.along(mirror.layout.x, mirror.layout.y)
    free: RoundShell | MeshedShell = RoundShell(shell)
    if shell.outline is not None or shell.inner_radius == 0:
        mesh = shell_mesh(shell, *places, mesh_size=mesh_size_of(shell, *places))
        free = MeshedShell(shell, mesh)
    compliance = free.influence(places, places, mirror.sensor, mirror.puck_radius)
    exchange = rearming(rigid_motions(*places), arms(mirror.layout))
    condensed = condense(exchange @ compliance @ exchange.T, arms(mirror.layout))
    return ShellModel(mirror, free, places, compliance, exchange, condensed)


@dataclass(frozen=True, eq=False)
class ExternalForces:
    """Forces on a flat mirror other than those of its actuators, along +z [N]."""

    spread: float  # distributed evenly over the glass
    # x and y [m] and size (k,) of forces at points off the actuators, along the glass
    at: Points
    force: Array
    local: Array  # (n,) at each actuator, along its normal


def weight_on(
    mirror: Mirror,
    weight: float,
    added: float = 0.0,
    *,
    cosine: float = 1.0,
    off_centre: Sequence[float] | Array = (0.0, 0.0),
    bias: Array | float = 0.0,
) -> ExternalForces:
    """Return the forces of the weights P (glass and magnets) and Q (tool) [N], and of the bias.

    The cosine is that of the tilt of the axis from the vertical, ``off_centre`` x and y of the
    middle of the tool [m]; the (n,) forces of the bias magnets act along the normals [N].
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
    bent += glass.free.influence(glass.places, external.at, sensor) @ external.force
    straightened = glass.stiffness @ (glass.exchange @ bent)
    borne = glass.condensed.reaction @ _resultants_on_glass(glass.mirror, external)
    return np.asarray(-straightened - borne - external.local)


def external_resultants(mirror: Mirror, external: ExternalForces) -> Array:
    """Return k, (3,): total force [N] and moments x f and y f [N m], that is W + B, M_y, -M_x."""
    return _resultants_on_glass(mirror, external) + resultants(mirror.layout, external.local)


def _resultants_on_glass(mirror: Mirror, external: ExternalForces) -> Array:
    """Return the same without the forces at the actuators."""
    spread, force, (x, y) = external.spread, external.force, mirror.shell.centroid
    moments = [spread * x + external.at[0] @ force, spread * y + external.at[1] @ force]
    return np.array([spread + force.sum(), *moments])


@dataclass(frozen=True, eq=False)
class StaticShapes:
    """The shapes of a glass with one actuator reading 1 and the others 0."""

    area: Array  # (points,) that each point along the glass stands for [m^2]
    shape: Array  # (points, n) displacement per reading


def static_shapes(glass: ShellModel) -> StaticShapes:
    """Return the influence functions of a glass at the points of a quadrature over it."""
    at, area = glass.free.quadrature(glass.mirror.layout.n)
    return StaticShapes(area, shapes_at(glass, at))


def shapes_at(glass: ShellModel, at: Points, over: Annulus | None = None) -> Array:
    """Return (points, n) influence functions at points, or their means over a sensor there."""
    shallow = glass.shallow
    read = glass.free.influence(at, glass.places, over, glass.mirror.puck_radius)
    return np.asarray(read @ shallow.stiffness + rigid_motions(*at).T @ shallow.motion)


def moving_mass(glass: ShellModel, shapes: StaticShapes) -> tuple[Array, Array]:
    """Return M [kg] and S, (n, n) each, in M z'' + K~ z = S' f, z the readings and f the forces.

    M = rho t integral of phi_i phi_j + magnet_mass S' S (Guyan's reduction), with phi the influence
    functions and S the displacement of the pucks with their magnets per reading, 1 if actuators are
    read at the points of their forces. S transforms the forces to the readings by virtual work; K~
    = S' K. Motion along the glass and the inertia of rotation are neglected. M is symmetric; for
    rigid motions it is that of the whole.
    """
    mirror = glass.mirror
    mass = shapes.shape.T @ (shapes.area[:, None] * shapes.shape)
    mass *= mirror.shell.density * mirror.shell.thickness
    pucks, on_puck = np.eye(mirror.layout.n), rim(mirror.puck_radius)
    if mirror.sensor != on_puck:
        pucks = shapes_at(glass, glass.places, on_puck)
    mass += mirror.magnet_mass * pucks.T @ pucks
    return 0.5 * (mass + mass.T), pucks
