"""A free shell under forces, by either model: Fourier for rings, finite elements for any outline.

Displacements are along the normal, up to rigid motions, and right for every combination of forces
whose sum and torques vanish. One force alone finds no equilibrium on a free shell; its column means
something only in such sums. x and y are positions along the glass [m].
"""

from __future__ import annotations

import numpy as np

from truenewton.arrays import Array
from truenewton.mirrors.glass import Annulus, Shell
from truenewton.mirrors.shell.finite_elements.meshed_shell import MeshedShell
from truenewton.mirrors.shell.finite_elements.meshing import shell_mesh
from truenewton.mirrors.shell.fourier import RoundShell
from truenewton.mirrors.shell.places import Points

FreeShell = RoundShell | MeshedShell


def free_shell(shell: Shell, at: Points) -> FreeShell:
    """Return the model of a shell whose actuators stand at x and y.

    Raises
    ------
    GeometryError
        An outlined glass that cannot be, or that cannot be meshed.
    """
    if shell.outline is None:
        return RoundShell(shell)
    return MeshedShell(shell, shell_mesh(shell, *at, mesh_size=shell.outline.mesh_size))


def influence(
    free: FreeShell,
    at: Points,
    of: Points,
    *,
    sensor: Annulus | None = None,
    puck_radius: float = 0.0,
) -> Array:
    """Return (n_at, n_of) displacement at points, or reading of sensors, per unit force [m/N].

    Where forces and readings share their places this is the compliance of the actuators. It is
    symmetric only where displacements are read just as forces act: at points under point forces,
    or on a circle as wide as the puck.

    Parameters
    ----------
    at
        x and y, (n_at,) each, of the points where the displacement is read, edges included, or of
        the centres of the sensors.
    of
        x and y, (n_of,) each, of the forces; off the edges.
    sensor
        Over which a reading is the mean; none reads at the points.
    puck_radius
        Radius of the circle on which the force enters the glass [m]; 0 for a point. A stiff puck
        that is glued to the glass presses with its rim, for the glass under it does not bend; that
        it stiffens the glass as well is not modelled. Nobody vouches for a radius [guess].

    Raises
    ------
    GeometryError
        What the model raises.
    """
    parts = free.influence_in_parts(at, of, sensor=sensor, puck_radius=puck_radius)
    return np.concatenate([*parts])
