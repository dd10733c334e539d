"""The shapes of a plan, and the forces that they take."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from truenewton.acquisition.plan import CampaignPlan
from truenewton.arrays import Array
from truenewton.errors import FormatError
from truenewton.files.fits import read_fits
from truenewton.mirrors.known import Mirror
from truenewton.mirrors.shell.held_glass import held_glass
from truenewton.records.file import stiffness_from
from truenewton.statics.layout import Layout
from truenewton.statics.modes import scaled_modes, stiffness_modes


def expected_alpha(mirror: Mirror) -> float:
    """Return the true over commanded Newton that a plan reckons with: the middle of its range."""
    return float(np.mean(mirror.alpha_range))


def shapes_and_forces(
    plan: CampaignPlan, mirror: Mirror, folder: str | os.PathLike[str] = "."
) -> tuple[Array, Array]:
    """Return the shapes of a plan, and the forces that the electronics may be expected to command.

    Disabled actuators take no part: their displacement and force are 0.

    Returns
    -------
    shapes
        (shapes, n) displacements [m], each to be taken with both signs.
    force
        (shapes, n) commanded forces, those of the loads aside [N]: by the measured matrix where
        that gives the shapes, else by the model over `expected_alpha`.

    Raises
    ------
    UnreadableFile, FormatError
    """
    on = mirror.layout.enabled
    path = Path(folder) / plan.shapes.source
    if plan.shapes.source == "modes":
        true = model_stiffness(mirror)
        modes = stiffness_modes(true).modes.T
        return _spread(_scaled(modes, true, plan), true / expected_alpha(mirror), on)
    file = read_fits(path)
    if "STIFFNESS" in file.extensions:
        matrix = stiffness_from(file)
        if not matrix.layout.same_as(mirror.layout):
            raise FormatError(
                f"is not of the actuators of {mirror.name}",
                remedy="plan with the measured matrix of the same mirror",
                path=path,
            )
        measured = matrix.used_stiffness
        modes = np.linalg.svd(measured)[2][::-1]
        return _spread(_scaled(modes, measured, plan), measured, on)
    shapes = file.pixels("SHAPES", "m")
    if shapes.ndim != 2 or shapes.shape[1] != on.size or not len(shapes):
        raise FormatError(
            f"SHAPES is {shapes.shape}", remedy=f"give shapes x {on.size} actuators", path=path
        )
    chosen = shapes[: plan.shapes.count or None, on]
    if not np.isfinite(chosen).all():
        raise FormatError("SHAPES holds NaN or inf", remedy="correct it", path=path)
    return _spread(chosen, model_stiffness(mirror) / expected_alpha(mirror), on)


def _scaled(modes: Array, stiffness: Array, plan: CampaignPlan) -> Array:
    """Return as many modes as planned, as large as planned."""
    shapes = plan.shapes
    return scaled_modes(modes[: shapes.count or None], stiffness, shapes.stroke, shapes.force)


def shapes_are_given(plan: CampaignPlan, folder: str | os.PathLike[str] = ".") -> bool:
    """Tell whether a file gives the shapes as they stand, whatever stroke and force say."""
    source = plan.shapes.source
    return source != "modes" and "STIFFNESS" not in read_fits(Path(folder) / source).extensions


def model_stiffness(mirror: Mirror) -> Array:
    """Return (m, m) true force per reading of the enabled actuators, along normals [N/m]."""
    return held_glass(with_enabled_only(mirror)).stiffness


def with_enabled_only(mirror: Mirror) -> Mirror:
    """Return the mirror without its disabled actuators."""
    layout, on = mirror.layout, mirror.layout.enabled
    enabled = Layout(layout.id[on], layout.x[on], layout.y[on], layout.nz[on], on[on])
    return replace(mirror, layout=enabled)


def _spread(shapes: Array, stiffness: Array, on: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Return shapes of the enabled actuators and their forces in the order of all."""
    both = np.zeros((2, len(shapes), on.size))
    both[:, :, on] = shapes, shapes @ stiffness.T
    return both[0], both[1]
