"""The shell by either model, in one call."""

import numpy as np

from truenewton.mirrors.shell import free_shell
from truenewton.mirrors.shell.finite_elements.meshed_shell import meshed_shell
from truenewton.mirrors.shell.fourier import RoundShell


def influence(shell, at, of, *, digits=13, **reading):
    return free_shell.influence(RoundShell(shell, digits), at, of, **reading)


def uniform_influence(shell, at, **reading):
    return RoundShell(shell).uniform_influence(at, **reading)


def stiffness(shell, x, y, *, digits=13, **reading):
    return free_shell.stiffness(RoundShell(shell, digits), (x, y), **reading)


def meshed_stiffness(shell, x, y, *, mesh_size, sensor=None):
    free = meshed_shell(shell, x, y, mesh_size=mesh_size)
    return free_shell.stiffness(free, (np.asarray(x), np.asarray(y)), sensor=sensor)
