"""The shapes of a plan, and the forces that they take."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import numpy as np

from truenewton.acquisition.plan import CampaignPlan
from truenewton.arrays import Array
from truenewton.errors import FormatError
from truenewton.files.fits import read_fits
from truenewton.mirrors.known import Mirror
from truenewton.mirrors.shell.held_glass import HeldGlass, held_glass
from truenewton.records.cycle import LARGEST_DISPLACEMENT
from truenewton.records.file import stiffness_from
from truenewton.statics.layout import Layout
from truenewton.statics.modes import scaled_modes, stiffness_modes


def expected_alpha(mirror: Mirror) -> float:
    """Return the true over commanded Newton that a plan reckons with: the middle of its range."""
    return float(np.mean(mirror.alpha_range))


def shapes_and_forces(
    plan: CampaignPlan,
    mirror: Mirror,
    folder: str | os.PathLike[str] = ".",
    glass: HeldGlass | None = None,
) -> tuple[Array, Array, bool]:
    """Return the shapes of a plan, and the forces that the electronics may be expected to command.

    Disabled actuators take no part: their displacement and force are 0. Files that the plan names
    stand relative to a folder; the model's glass is made unless it is given.

    Returns
    -------
    shapes
        (shapes, n) displacements [m], each to be taken with both signs.
    force
        (shapes, n) commanded forces, those of the loads aside [N]: by the measured matrix where
        that gives the shapes, else by the model over `expected_alpha`.
    given
        Whether a file gives the shapes as they stand, whatever stroke and force say.
    """
    on, path = mirror.layout.enabled, Path(folder) / plan.shapes.source
    file = None if plan.shapes.source == "modes" else read_fits(path)
    given = file is not None and "STIFFNESS" not in file.extensions
    if file is None:
        true = (glass or model_glass(mirror)).stiffness
        stiffness = true / expected_alpha(mirror)
        chosen = _scaled(stiffness_modes(true).modes.T, true, plan)
    elif not given:
        matrix = stiffness_from(file)
        if apart := mirror.layout.difference(matrix.layout):
            raise FormatError(
                f"is not of the actuators of {mirror.name}: {apart}",
                remedy="plan with the measured matrix of the same mirror",
                path=path,
            )
        stiffness = matrix.used_stiffness
        chosen = _scaled(np.linalg.svd(stiffness)[2][::-1], stiffness, plan)
    else:
        image = file.pixels("SHAPES", "m")
        if image.ndim != 2 or image.shape[1] != on.size or not len(image):
            raise FormatError(
                f"SHAPES is {image.shape}", remedy=f"give shapes x {on.size} actuators", path=path
            )
        chosen = image[: plan.shapes.count or None, on]
        if not (np.abs(chosen) <= LARGEST_DISPLACEMENT).all():
            raise FormatError(
                "SHAPES holds NaN, inf or absurd values", remedy="correct it", path=path
            )
        stiffness = (glass or model_glass(mirror)).stiffness / expected_alpha(mirror)
    shapes, force = np.zeros((2, len(chosen), on.size))
    shapes[:, on], force[:, on] = chosen, chosen @ stiffness.T
    return shapes, force, given


def _scaled(modes: Array, stiffness: Array, plan: CampaignPlan) -> Array:
    """Return as many modes as planned, as large as planned."""
    shapes = plan.shapes
    return scaled_modes(modes[: shapes.count or None], stiffness, shapes.stroke, shapes.force)


def model_glass(mirror: Mirror) -> HeldGlass:
    """Return the glass that a plan reckons with, held by the enabled actuators alone."""
    layout, on = mirror.layout, mirror.layout.enabled
    enabled = Layout(layout.id[on], layout.x[on], layout.y[on], layout.nz[on], on[on])
    return held_glass(replace(mirror, layout=enabled))
