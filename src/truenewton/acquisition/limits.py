"""What the mirror may bear, held against every command and every reading."""

from __future__ import annotations

import numpy as np

from truenewton.acquisition.plan import CampaignPlan, MirrorLimits
from truenewton.arrays import Array
from truenewton.bench.protocol import Reading, Shape
from truenewton.errors import LimitExceeded
from truenewton.mirrors.known import Mirror
from truenewton.statics.layout import Layout
from truenewton.statics.load import Load

CLIPPED = 3.0  # standard deviations: a sample that far beyond the mean shall not saturate either


def check_shapes(plan: CampaignPlan, layout: Layout, gap: float, shapes: Array) -> None:
    """Refuse planned shapes of which any, with either sign, takes a stroke beyond a limit.

    Raises
    ------
    LimitExceeded
    """
    worst = np.abs(shapes).max(axis=1).argmax()  # NaN before any number
    where = f"in planned shape {worst + 1}"
    _check_planned_stroke(plan.limits, layout, gap, shapes[worst], where)


def check_room(plan: CampaignPlan, mirror: Mirror, load: Load, rest_force: Array) -> None:
    """Refuse to go on where the forces at rest leave no room for those of the shapes.

    Before a shape is first taken nobody knows what it takes but for what the plan allows: a true
    force, for which the weakest actuator is commanded that over the lowest alpha.

    Parameters
    ----------
    plan, mirror
        Limits and shapes; the lowest alpha.
    load
        The one that is on.
    rest_force
        (n,) commanded forces at rest [N].

    Raises
    ------
    LimitExceeded
    """
    largest = (
        np.where(mirror.layout.enabled, np.abs(rest_force), 0.0)
        + plan.shapes.force / mirror.alpha_range[0]
    )
    what = f"N, {plan.shapes.force:g} N for the shapes included,"
    where = f"at rest under '{load.name}'"
    _refuse(largest, plan.limits.force, mirror.layout, what, where, "may take")


def check_command(
    limits: MirrorLimits, layout: Layout, gap: float, shape: Shape, forecast: Array | None
) -> None:
    """Refuse a command beyond a limit, before it is given.

    Parameters
    ----------
    limits
        What the mirror may bear.
    layout
        The n actuators.
    gap
        Nominal distance from the reference plate [m].
    shape
        The command.
    forecast
        (n,) commanded forces that it will take [N], where that can be told.

    Raises
    ------
    LimitExceeded
    """
    where = f"in {shape_name(shape)}, which was not commanded"
    _check_planned_stroke(limits, layout, gap, shape.position, where)
    if forecast is not None:
        forecast = np.where(layout.enabled, np.abs(forecast), 0.0)
        _refuse(forecast, limits.force, layout, "N by forecast,", where)


def check_reading(
    limits: MirrorLimits, layout: Layout, gap: float, shape: Shape, reading: Reading
) -> None:
    """Refuse to go on from a reading beyond a limit; what is NaN is for others to judge.

    Raises
    ------
    LimitExceeded
    """
    where = f"in {shape_name(shape)}"
    force = np.where(layout.enabled, np.abs(reading.force), 0.0)
    _refuse(force, limits.force, layout, "N,", where)
    scatter = np.where(layout.enabled, np.nan_to_num(reading.force_scatter), 0.0)
    sampled = force + CLIPPED * scatter
    _refuse(sampled, limits.saturation, layout, "N in single samples,", where, of="saturation at")
    measured = np.where(layout.enabled, reading.position, 0.0)
    _check_stroke(limits, layout, gap, measured, where)
    low, high = limits.temperature
    if reading.temperature < low or reading.temperature > high:
        raise LimitExceeded(
            f"the mirror has {reading.temperature:g} deg C {where}, and may have {low:g} to"
            f" {high:g}",
            remedy="wait until it has",
            got=reading.temperature,
            want=limits.temperature,
        )


def _check_planned_stroke(
    limits: MirrorLimits, layout: Layout, gap: float, position: Array, where: str
) -> None:
    """Refuse also what is no number; the glass is everywhere, also where an actuator is off."""
    if not np.isfinite(position).all():
        raise LimitExceeded(f"a displacement is NaN, {where}", remedy="correct the shape")
    _check_stroke(limits, layout, gap, position, where)


def _check_stroke(
    limits: MirrorLimits, layout: Layout, gap: float, position: Array, where: str
) -> None:
    stroke = np.abs(position)
    _refuse(stroke, limits.displacement, layout, "m of stroke,", where)
    # On whichever side the plate is.
    _refuse(stroke, gap - limits.gap, layout, f"m of a gap of {gap:g} m,", where)


def _refuse(
    values: Array,
    limit: float,
    layout: Layout,
    what: str,
    where: str,
    takes: str = "takes",
    of: str = "its limit of",
) -> None:
    """Raise LimitExceeded where an actuator has more than the limit; NaN is not more."""
    counted = np.where(np.isnan(values), 0.0, values)
    worst = int(counted.argmax())
    if counted[worst] > limit:
        raise LimitExceeded(
            f"actuator {layout.id[worst]} {takes} {counted[worst]:.4g} {what} beyond {of}"
            f" {limit:g}, {where}",
            remedy="find out why, or plan anew into another folder",
            got=float(counted[worst]),
            want=limit,
        )


def shape_name(shape: Shape) -> str:
    """Return which shape it is, for people."""
    which = f"shape {shape.number} {'+' if shape.sign > 0 else '-'}" if shape.number else "rest"
    return f"{which} of cycle {shape.cycle} under '{shape.load.name}'"


def smallest_gap(layout: Layout, gap: float, reading: Reading) -> float:
    """Return the smallest distance from the reference plate in a reading [m]."""
    stroke = np.abs(reading.position[layout.enabled])
    return float(gap - np.nan_to_num(stroke).max(initial=0.0))


def largest_force(layout: Layout, reading: Reading) -> float:
    """Return the largest commanded force in a reading [N]."""
    return float(np.nan_to_num(np.abs(reading.force[layout.enabled])).max(initial=0.0))
