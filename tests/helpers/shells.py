"""The shell by either model, in one call; the glass and the actuators that tests take."""

from dataclasses import replace

import numpy as np

from truenewton.mirrors.glass import Shell, rim
from truenewton.mirrors.shell import shell_model
from truenewton.mirrors.shell.mesh import shell_mesh
from truenewton.mirrors.shell.meshed_shell import MeshedShell
from truenewton.mirrors.shell.round_shell import RoundShell
from truenewton.statics.layout import rings

FLAT = Shell(inner_radius=20e-3, outer_radius=125e-3, thickness=1.6e-3)
SPHERE = replace(FLAT, radius_of_curvature=2.0)
COUNTS = np.array([9, 15, 21])
LAYOUT = rings(list(COUNTS * 30.5e-3 / (2 * np.pi)), list(COUNTS))
X, Y = LAYOUT.x, LAYOUT.y
TILTS = shell_model.rigid_motions(X, Y)


def circle(radius, n, first=0.0):
    angle = first + 2 * np.pi * np.arange(n) / n
    return radius * np.cos(angle), radius * np.sin(angle)


def influence(shell, at, of, **reading):
    return RoundShell(shell).influence(at, of, **reading)


def uniform_influence(shell, at, **reading):
    return RoundShell(shell).uniform_influence(at, **reading)


def condense(compliance, tilts):
    """Condense what is read just as forces act, so that the stiffness is symmetric."""
    condensed = shell_model.condense(compliance, tilts)
    return replace(condensed, stiffness=0.5 * (condensed.stiffness + condensed.stiffness.T))


def holding_forces(condensed, displacement, load_influence, load_resultants):
    held = condensed.stiffness @ (displacement - load_influence)
    return held - condensed.reaction @ load_resultants


def free_stiffness(free, at, *, sensor=None, puck_radius=0.0):
    compliance = free.influence(at, at, sensor, puck_radius)
    condensing = condense if sensor == rim(puck_radius) else shell_model.condense
    return condensing(compliance, shell_model.rigid_motions(*at)).stiffness


def stiffness(shell, x, y, **reading):
    return free_stiffness(RoundShell(shell), (x, y), **reading)


def meshed_stiffness(shell, x, y, *, mesh_size, sensor=None):
    free = MeshedShell(shell, shell_mesh(shell, x, y, mesh_size=mesh_size))
    return free_stiffness(free, (np.asarray(x), np.asarray(y)), sensor=sensor)
