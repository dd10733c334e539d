"""Checks of a mirror before it is simulated: glass, outline, actuators, tool and weight."""

from __future__ import annotations

import numpy as np

from truenewton.arrays import Array
from truenewton.errors import GeometryError
from truenewton.mirrors.glass import Shell, check_shell
from truenewton.mirrors.known import GRAVITY, Mirror
from truenewton.mirrors.shell.finite_elements.mesh import mesh_size_of
from truenewton.mirrors.shell.finite_elements.outline import (
    check_mesh_size,
    checked_polygons,
    depth_inside,
)
from truenewton.mirrors.shell.round_shell import MIN_HOLE
from truenewton.mirrors.shell.shell_model import tool_wedges
from truenewton.rounding import counted

MAX_WEIGHT_RATIO = 3.0  # and its inverse, to the weight of glass and magnets


def _check_shell(mirror: Mirror) -> None:
    shell = mirror.shell
    check_shell(shell, MIN_HOLE if shell.outline is None and shell.inner_radius else 0.0)


def check_outline(mirror: Mirror) -> None:
    """Refuse polygons that do not bound a glass, and corners that elements cannot follow."""
    if mirror.shell.outline is not None:
        checked_polygons(mirror.shell.polygons())


def _check_elements(mirror: Mirror) -> None:
    """Refuse elements too small for an outline, and an outline beyond the outer radius."""
    shell, loops = mirror.shell, mirror.shell.polygons()
    if not loops:
        return
    at = shell.along(mirror.layout.x, mirror.layout.y)
    check_mesh_size(loops, mesh_size_of(shell, *at))
    furthest = float(np.hypot(*loops[0].T).max())
    if furthest > shell.outer_radius:
        raise GeometryError(
            f"the outline reaches {furthest:.6g} m from the axis",
            remedy=f"leave outer_radius out, or give more than {shell.outer_radius:g} m",
        )


def check_actuators(mirror: Mirror) -> None:
    """Refuse actuators whose puck or sensor reaches off the glass."""
    places = np.stack(mirror.shell.along(mirror.layout.x, mirror.layout.y), axis=1)
    reach = max(mirror.puck_radius, mirror.sensor.outer_radius)
    off = _depth(mirror.shell, places) < reach
    if off.any():
        i = off.argmax()
        raise GeometryError(
            f"actuator {mirror.layout.id[i]} stands {np.hypot(*places[i]):.4g} m from the axis: it"
            " or its sensor reaches off the glass",
            remedy=f"{_where(mirror.shell)}; the sensor reaches {reach:g} m",
        )


def _check_tool(mirror: Mirror) -> None:
    wedges = np.stack(tool_wedges(mirror), axis=1)
    if (_depth(mirror.shell, wedges) < 0).any():
        raise GeometryError(
            f"the weight tool, {np.hypot(*wedges[0]):g} m from the axis, stands off the glass",
            remedy="give as tool_radius that of a circle on the glass, about x = y = 0",
        )


def _check_weight(mirror: Mirror) -> None:
    """Refuse a weight far from that of glass and magnets: one of their units is wrong."""
    shell, magnets = mirror.shell, mirror.layout.n
    expected = -GRAVITY * (shell.mass + magnets * mirror.magnet_mass)
    if not expected * MAX_WEIGHT_RATIO < mirror.weight < expected / MAX_WEIGHT_RATIO:
        raise GeometryError(
            f"weight is {mirror.weight:.4g} N, but glass of {1e3 * shell.thickness:.3g} mm and"
            f" {counted(magnets, 'magnet')} of {1e3 * mirror.magnet_mass:.3g} g weigh"
            f" {expected:.3g} N",
            remedy="correct weight (N, not kg), thickness, density or magnet_mass",
            got=mirror.weight,
            want=expected,
        )


# Each raises a GeometryError.
CHECKS = (_check_shell, check_outline, _check_elements, check_actuators, _check_tool,
          _check_weight)  # fmt: skip


def _depth(shell: Shell, places: Array) -> Array:
    """Return (n,) how far (n, 2) places along a glass lie from its edges [m], negative off it."""
    if shell.outline is not None:
        return depth_inside(shell.polygons(), places)
    a, b, r = shell.inner_radius, shell.outer_radius, np.hypot(*places.T)
    return np.asarray(np.minimum(r - a if a else np.inf, b - r))


def _where(shell: Shell) -> str:
    if shell.outline is not None:
        return "bring it further within the outline"
    return f"that is from {shell.inner_radius:g} m to {shell.outer_radius:g} m"
