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
        """Refuse to go on where (n,) forces at rest [N] leave no room for those of the shapes.

        Before a shape is first taken nobody knows what it takes but for what the plan allows: a
        true force, for which the weakest actuator is commanded that over the lowest alpha.
        """
        force = plan.shapes.force
        largest = self._enabled(np.abs(rest_force)) + force / mirror.alpha_range[0]
        said = f"may take {{:.4g}} N, {force:g} N for the shapes included, beyond its limit of"
        self._refuse(largest, self.limits.force, said, f"at rest under '{load.name}'")

    def check_command(self, shape: Shape, forecast: Array | None) -> None:
        """Refuse a command before it is given, also by (n,) forces [N] where they are forecast."""
        where = f"in {shape_name(shape)}, which was not commanded"
        self._check_planned_stroke(shape.position, where)
        if forecast is not None:
            said = "takes {:.4g} N by forecast, beyond its limit of"
            self._refuse(self._enabled(forecast), self.limits.force, said, where)

    def check_reading(self, shape: Shape, reading: Reading) -> None:
        """Refuse to go on from a reading; what is NaN is for others to judge."""
        where, limits = f"in {shape_name(shape)}", self.limits
        force = self._enabled(np.abs(reading.force))
        self._refuse(force, limits.force, "takes {:.4g} N, beyond its limit of", where)
        sampled = force + CLIPPED * self._enabled(np.nan_to_num(reading.force_scatter))
        said = "takes {:.4g} N in single samples, beyond saturation at"
        self._refuse(sampled, limits.saturation, said, where)
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

    def _enabled(self, values: Array) -> Array:
        return np.where(self.layout.enabled, values, 0.0)

    def _check_planned_stroke(self, position: Array, where: str) -> None:
        """Refuse also what is no number; the glass is everywhere, also where an actuator is off."""
        if not np.isfinite(position).all():
            raise LimitExceeded(f"a displacement is NaN, {where}", remedy="correct the shape")
        self._check_stroke(position, where)

    def _check_stroke(self, position: Array, where: str) -> None:
        said = "takes {:.4g} m of stroke, beyond its limit of"
        self._refuse(position, self.limits.displacement, said, where)
        # On whichever side the plate is.
        said = f"takes {{:.4g}} m of a gap of {self.gap:g} m, beyond its limit of"
        self._refuse(position, self.gap - self.limits.gap, said, where)

    def _refuse(self, values: Array, limit: float, said: str, where: str) -> None:
        """Raise LimitExceeded, and what was said, where an actuator has more; NaN is not more."""
        size = np.where(np.isnan(values), 0.0, np.abs(values))
        worst = int(size.argmax())
        if size[worst] > limit:
            raise LimitExceeded(
                f"actuator {self.layout.id[worst]} {said.format(size[worst])} {limit:g}, {where}",
                remedy="find out why, or plan anew into another folder",
                got=float(size[worst]),
                want=limit,
            )


def shape_name(shape: Shape) -> str:
    """Return which shape it is, for people."""
    which = f"shape {shape.number} {'+' if shape.sign > 0 else '-'}" if shape.number else "rest"
    return f"{which} of cycle {shape.cycle} under '{shape.load.name}'"
