"""What is checked: the limits of the mirror, and whether a load is on.

Whether a load is on follows from the forces that hold the mirror at rest.
At rest sum nz_i alpha_i c_i = -(W + B) (docs/method.md), so between two loads the sum of nz_i c_i
changes by -(W_1 - W_2) over a mean of alpha. B is not known, alpha only roughly: one load alone
shows nothing, two show whether about the right weight was put on or taken off.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truenewton.acquisition.plan import CampaignPlan, MirrorLimits
from truenewton.arrays import Array
from truenewton.bench.protocol import Reading, Shape
from truenewton.errors import LimitExceeded
from truenewton.mirrors.known import Mirror
from truenewton.statics.arms import effective_weight
from truenewton.statics.layout import Layout
from truenewton.statics.load import Load

SATURATION_SIGMAS = (
    3.0  # standard deviations: a sample that far beyond the mean shall not saturate either
)
# alpha lies between 0.7 and 1.1 [paper]; a simulated P45 gave 0.96 to 1.38 in 60 draws.
CHANGE_RANGE = (0.6, 1.5)
MAX_CHANGE = (
    0.4  # of the smallest step between two loads: so little may the sum change under one load
)
MIN_STEP_SIGMAS = 5.0  # standard deviations of a sum, to which the smallest step must be large


@dataclass(frozen=True, eq=False)
class Guard:
    """Refuses whatever is beyond a limit; every method raises LimitExceeded."""

    limits: MirrorLimits
    layout: Layout
    gap: float  # nominal distance from the reference plate [m]

    def check_shapes(self, shapes: Array) -> None:
        """Refuse (shapes, n) planned displacements [m] of which any takes too large a stroke."""
        worst = np.abs(shapes).max(axis=1).argmax()  # NaN before any number
        self._check_planned_stroke(shapes[worst], f"in planned shape {worst + 1}")

    def check_room(self, plan: CampaignPlan, mirror: Mirror, load: Load, rest_force: Array) -> None:
        """Refuse to go on where (n,) forces at rest [N] leave no room for those of the shapes.

        Before a shape is first taken, only the limit of the plan for its true force is known; the
        weakest actuator is then commanded that over the lowest alpha.
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
        sampled = force + SATURATION_SIGMAS * self._enabled(np.nan_to_num(reading.force_scatter))
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


def sum_at_rest(layout: Layout, force: Array) -> float:
    """Return the sum of nz_i c_i of the enabled actuators [N]."""
    on = layout.enabled
    return float(layout.nz[on] @ force[on])


def mean_sum(
    layout: Layout,
    force: Array,
    shape: NDArray[np.int64],
    sign: NDArray[np.int64],
    valid: NDArray[np.bool_],
) -> float | None:
    """Return the sum at rest by (N, n) commanded forces [N]; None where no shape has both signs.

    Of shapes that have: there the elastic forces cancel.
    """
    plus, minus = (valid.astype(bool) & (sign == each) for each in (1, -1))
    both = np.isin(shape, np.intersect1d(shape[plus], shape[minus]))
    if not both.any():
        return None
    means = [force[both & each].mean(axis=0) for each in (plus, minus)]
    return sum_at_rest(layout, np.mean(means, axis=0))


def sum_error(layout: Layout, reading: Reading, samples: int) -> float:
    """Return the standard deviation of that sum [N]; 0 if unknown.

    By the scatter of samples where the bench does not say how they depend on each other.
    """
    error = reading.force_error
    if error is None:
        error = reading.force_scatter / np.sqrt(samples)
    return float(np.linalg.norm(np.nan_to_num((layout.nz * error)[layout.enabled])))


def judge(
    weight: float,
    loads: Iterable[Load],
    load: Load,
    rest_sums: Mapping[str, float],
    total: float,
    error: float = 0.0,
) -> tuple[bool | None, str]:
    """Return whether one of the loads of a plan is on, None if the forces do not show it, and why.

    Compare the sum at rest now, with its standard deviation [N], with those under the loads that
    were on before [N], by key, with this one's own if it was. The weight of the mirror is P [N].
    """
    names = {each.key: each.name for each in loads}
    weights = {each.key: float(effective_weight(weight, each.added, each.tilt)) for each in loads}
    step = {key: other - weights[load.key] for key, other in weights.items()}
    smallest = min((abs(value) for value in step.values() if value), default=0.0)
    if smallest * MAX_CHANGE <= MIN_STEP_SIGMAS * error:
        return None, f"the loads differ by {smallest:.3g} N, too little to tell them apart"
    compared = [key for key in rest_sums if key == load.key or step[key]]
    if not compared:
        return None, "no other load to compare with yet: taken on trust"
    for key in compared:
        change, name = total - rest_sums[key], names[key]
        changed = f"the sum of the forces changed by {change:.4g} N"
        if key == load.key:
            if abs(change) > MAX_CHANGE * smallest:
                return False, f"{changed} since '{name}' was on before"
        elif not CHANGE_RANGE[0] <= change / step[key] <= CHANGE_RANGE[1]:
            low, high = (100 * part for part in CHANGE_RANGE)
            due = f"{step[key]:.4g} N are due ({low:.0f} to {high:.0f} % of it)"
            sign = ": the wrong way, as where Force is not positive along +z"
            turned = sign if change / step[key] <= -CHANGE_RANGE[0] else ""
            return False, f"{changed} from '{name}', where {due}{turned}"
    beside = ", ".join(f"'{names[key]}'" for key in compared)
    return True, f"the sum of the forces is {total:.4g} N, as due beside {beside}"
