"""What a mirror's glass must be to be simulated, held against its actuators, tool and weight."""

from __future__ import annotations

import numpy as np

from truenewton.arrays import Array
from truenewton.errors import GeometryError
from truenewton.mirrors.glass import Shell, check_shell
from truenewton.mirrors.known import GRAVITY, Mirror
from truenewton.mirrors.shell.finite_elements.meshing import mesh_size_of
from truenewton.mirrors.shell.finite_elements.outline import (
    check_mesh_size,
    checked_polygons,
    depth_inside,
)
from truenewton.mirrors.shell.places import SMALLEST_HOLE
from truenewton.mirrors.shell.shell_model import tool_wedges
from truenewton.rounding import counted

OTHER_WEIGHT = 3.0  # and its inverse: so far may it be from glass and magnets, which vary


def _check_shell(mirror: Mirror) -> None:
    shell = mirror.shell
    check_shell(shell, SMALLEST_HOLE if shell.outline is None and shell.inner_radius else 0.0)


def check_outline(mirror: Mirror) -> None:
    """Refuse polygons round which there is no glass, and corners that elements cannot follow."""
    if mirror.shell.outline is not None:
        checked_polygons(mirror.shell.polygons())


def _check_elements(mirror: Mirror) -> None:
    """Refuse elements too small for an outline, and a radius that it does not stay within."""
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
    """Refuse actuators that reach off the glass, with their puck or sensor."""
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
    """Refuse a weight that is a slip of the unit beside glass and magnets, or they beside it."""
    shell, magnets = mirror.shell, mirror.layout.n
    expected = -GRAVITY * (shell.mass + magnets * mirror.magnet_mass)
    if not expected * OTHER_WEIGHT < mirror.weight < expected / OTHER_WEIGHT:
        raise GeometryError(
            f"weight is {mirror.weight:.4g} N, but glass of {1e3 * shell.thickness:.3g} mm and"
            f" {counted(magnets, 'magnet')} of {1e3 * mirror.magnet_mass:.3g} g weigh"
            f" {expected:.3g} N",
            remedy="correct weight (N, not kg), thickness, density or magnet_mass",
            got=mirror.weight,
            want=expected,
        )


# Each refuses with a GeometryError: a shell that cannot be, actuators or a tool off the glass, a
# foreign weight.
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
