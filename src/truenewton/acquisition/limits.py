"""What the mirror may bear, held against every command and every reading."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from truenewton.acquisition.plan import CampaignPlan, MirrorLimits
from truenewton.arrays import Array
from truenewton.bench.protocol import Reading, Shape
from truenewton.errors import LimitExceeded
from truenewton.mirrors.known import Mirror
from truenewton.statics.layout import Layout
from truenewton.statics.load import Load

CLIPPED = 3.0  # standard deviations: a sample that far beyond the mean shall not saturate either


@dataclass(frozen=True, eq=False)
class Guard:
    """Refuses whatever is beyond a limit; every method raises LimitExceeded.

    Attributes
    ----------
    limits
        What the mirror may bear.
    layout
        The n actuators.
    gap
        Nominal distance from the reference plate [m].
    """

    limits: MirrorLimits
    layout: Layout
    gap: float

    def check_shapes(self, shapes: Array) -> None:
        """Refuse (shapes, n) planned displacements [m] of which any takes too large a stroke."""
        worst = np.abs(shapes).max(axis=1).argmax()  # NaN before any number
        self._check_planned_stroke(shapes[worst], f"in planned shape {worst + 1}")

    def check_room(self, plan: CampaignPlan, mirror: Mirror, load: Load, rest_force: Array) -> None:
        """Refuse to go on where the forces at rest leave no room for those of the shapes.

        Before a shape is first taken nobody knows what it takes but for what the plan allows: a
        true force, for which the weakest actuator is commanded that over the lowest alpha.

        Parameters
        ----------
        plan, mirror
            The shapes; the lowest alpha.
        load
            The one that is on.
        rest_force
            (n,) commanded forces at rest [N].
        """
        largest = self._enabled(np.abs(rest_force)) + plan.shapes.force / mirror.alpha_range[0]
        what = f"N, {plan.shapes.force:g} N for the shapes included,"
        self._refuse(largest, self.limits.force, what, f"at rest under '{load.name}'", "may take")

    def check_command(self, shape: Shape, forecast: Array | None) -> None:
        """Refuse a command before it is given.

        Parameters
        ----------
        shape
            The command.
        forecast
            (n,) commanded forces that it will take [N], where they can be predicted.
        """
        where = f"in {shape_name(shape)}, which was not commanded"
        self._check_planned_stroke(shape.position, where)
        if forecast is not None:
            force = self._enabled(np.abs(forecast))
            self._refuse(force, self.limits.force, "N by forecast,", where)

    def check_reading(self, shape: Shape, reading: Reading) -> None:
        """Refuse to go on from a reading; what is NaN is for others to judge."""
        where, limits = f"in {shape_name(shape)}", self.limits
        force = self._enabled(np.abs(reading.force))
        self._refuse(force, limits.force, "N,", where)
        sampled = force + CLIPPED * self._enabled(np.nan_to_num(reading.force_scatter))
        self._refuse(sampled, limits.saturation, "N in single samples,", where, of="saturation at")
        self._check_stroke(self._enabled(reading.position), where)
        low, high = limits.temperature
        if reading.temperature < low or reading.temperature > high:
            raise LimitExceeded(
                f"the mirror has {reading.temperature:g} deg C {where}, and may have {low:g} to"
                f" {high:g}",
                remedy="wait until it has",
                got=reading.temperature,
                want=limits.temperature,
            )

    def smallest_gap(self, reading: Reading) -> float:
        """Return the smallest distance from the reference plate in a reading [m]."""
        stroke = np.abs(reading.position[self.layout.enabled])
        return float(self.gap - np.nan_to_num(stroke).max(initial=0.0))

    def largest_force(self, reading: Reading) -> float:
        """Return the largest commanded force in a reading [N]."""
        return float(np.nan_to_num(np.abs(reading.force[self.layout.enabled])).max(initial=0.0))

    def _enabled(self, values: Array) -> Array:
        return np.where(self.layout.enabled, values, 0.0)

    def _check_planned_stroke(self, position: Array, where: str) -> None:
        """Refuse also what is no number; the glass is everywhere, also where an actuator is off."""
        if not np.isfinite(position).all():
            raise LimitExceeded(f"a displacement is NaN, {where}", remedy="correct the shape")
        self._check_stroke(position, where)

    def _check_stroke(self, position: Array, where: str) -> None:
        stroke, gap = np.abs(position), self.gap
        self._refuse(stroke, self.limits.displacement, "m of stroke,", where)
        # On whichever side the plate is.
        self._refuse(stroke, gap - self.limits.gap, f"m of a gap of {gap:g} m,", where)

    def _refuse(
        self,
        values: Array,
        limit: float,
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
                f"actuator {self.layout.id[worst]} {takes} {counted[worst]:.4g} {what} beyond {of}"
                f" {limit:g}, {where}",
                remedy="find out why, or plan anew into another folder",
                got=float(counted[worst]),
                want=limit,
            )


def shape_name(shape: Shape) -> str:
    """Return which shape it is, for people."""
    which = f"shape {shape.number} {'+' if shape.sign > 0 else '-'}" if shape.number else "rest"
    return f"{which} of cycle {shape.cycle} under '{shape.load.name}'"
