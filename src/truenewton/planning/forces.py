"""The forces of the shapes and loads of a plan, its stroke and its gap."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace

import numpy as np

from truenewton.acquisition.plan import (
    CampaignPlan,
    expected_alpha,
    model_glass,
    planned_bodies,
    shapes_and_forces,
)
from truenewton.arrays import Array
from truenewton.bench.simulated.static import START
from truenewton.errors import LimitExceeded
from truenewton.mirrors.known import Mirror
from truenewton.mirrors.shell.shell_model import ShellModel, forces_under, weight_on
from truenewton.records.campaign import Campaign
from truenewton.records.cycle import Cycle
from truenewton.statics.arms import arms
from truenewton.statics.load import LIKELY_COIL_SHIFT, leaning


@dataclass(frozen=True, eq=False)
class Prepared:
    """A plan with the forces that the model of the shell gives."""

    plan: CampaignPlan
    mirror: Mirror
    glass: ShellModel  # the shell model with the enabled actuators
    # (shapes, n) displacements [m] and their commanded forces without those of the loads [N]
    shapes: Array
    force: Array
    # (n_enabled,) true forces that hold the flat mirror, its axis vertical, under the weight of
    # glass and magnets, and per Newton of added weight, along +z as all forces [N]
    own: Array
    tool: Array
    given: bool  # whether a file gives the shapes, so that they cannot be scaled

    @property
    def rest_force(self) -> Array:
        """(L, n_enabled) commanded forces that hold the flat mirror under the planned loads [N]."""
        added = np.array([load.added for load in self.plan.loads])
        cosine = np.cos(np.radians([load.tilt for load in self.plan.loads]))
        weights = cosine[:, None] * (self.own + added[:, None] * self.tool)
        return np.asarray((weights - self.mirror.bias_force) / expected_alpha(self.mirror))

    def changed(self, plan: CampaignPlan) -> Prepared:
        """Return the same for other cycles or loads, or stroke and force times one factor."""
        larger = plan.shapes.stroke / self.plan.shapes.stroke
        if larger == 1.0 or self.given:
            return replace(self, plan=plan)
        return replace(self, plan=plan, shapes=larger * self.shapes, force=larger * self.force)


def prepared_bodies(plan: CampaignPlan, folder: str | os.PathLike[str] = ".") -> list[Prepared]:
    """Return a plan with its forces, of a mirror in one piece or each of the segments that differ.

    Every segment carries the loads of the plan and has its own shapes. Files that the plan names
    are relative to a folder.
    """
    bodies = planned_bodies(plan, folder)
    worst = f", the worst of {len(bodies)} that differ" if len(bodies) > 1 else ""
    return [
        _prepared(plan, replace(body, name=f"{name}{worst}"), folder)
        for name, body in bodies.items()
    ]


def _prepared(plan: CampaignPlan, mirror: Mirror, folder: str | os.PathLike[str]) -> Prepared:
    # Coils move as the mirror leans; what is not declared is assumed.
    loads = tuple(
        replace(load, coil_shift_error=LIKELY_COIL_SHIFT)
        if leans and load.coil_shift is load.coil_shift_error is None
        else load
        for load, leans in zip(plan.loads, leaning(plan.loads), strict=True)
    )
    plan = replace(plan, loads=loads)
    glass = model_glass(mirror)
    shapes, force, given = shapes_and_forces(plan, mirror, folder, glass)
    return Prepared(plan, mirror, glass, shapes, force, *holding(glass), given)


def holding(glass: ShellModel) -> tuple[Array, Array]:
    """Return `Prepared.own` and `tool` by the model, (n_enabled,) each [N]."""
    own = weight_on(glass.mirror, glass.mirror.weight)
    tool = replace(own, spread=0.0, force=np.full(3, 1 / 3), local=np.zeros_like(own.local))
    return forces_under(glass, own), forces_under(glass, tool)


@dataclass(frozen=True, eq=False)
class Strain:
    """The largest forces and displacements of a plan."""

    # largest commanded force [N], the ID of its actuator, the name of the load
    force: float
    actuator: int
    load: str
    force_at_worst: float  # the same if this actuator's alpha were the lowest of its range [N]
    # largest displacement of an actuator, smallest distance from the reference plate [m]
    stroke: float
    gap: float


def strain(ready: Prepared) -> Strain:
    """Return the largest forces and displacements of a plan."""
    plan, mirror, limits = ready.plan, ready.mirror, ready.plan.limits
    on, alpha = mirror.layout.enabled, expected_alpha(mirror)
    of_shapes = np.abs(ready.force[:, on]).max(axis=0)  # of both signs
    largest = np.abs(ready.rest_force) + of_shapes
    load_index, actuator_index = np.unravel_index(largest.argmax(), largest.shape)
    force, stroke = float(largest.max()), float(np.abs(ready.shapes).max())
    asked = Strain(
        force=force,
        actuator=int(mirror.layout.id[on][actuator_index]),
        load=plan.loads[load_index].name,
        force_at_worst=force * alpha / min(mirror.alpha_range),
        stroke=stroke,
        gap=mirror.gap - stroke,
    )
    for what, limit, beyond, remedy in (
        (f"actuator {asked.actuator} takes {force:.3g} N under load '{asked.load}'", limits.force,
         force > limits.force, "plan a smaller shapes.force, or a lighter load"),
        (f"the stroke is {stroke:.3g} m", limits.displacement, stroke > limits.displacement,
         "plan smaller shapes"),
        (f"the gap closes to {asked.gap:.3g} m", limits.gap, asked.gap < limits.gap,
         "plan a smaller shapes.stroke"),
    ):  # fmt: skip
        if beyond:
            raise LimitExceeded(f"{what}, beyond its limit of {limit:g}", remedy=remedy)
    return asked


def within_limits(ready: Prepared) -> bool:
    """Return whether a plan keeps within its own limits."""
    try:
        strain(ready)
    except LimitExceeded:
        return False
    return True


def noiseless(ready: Prepared) -> Campaign:
    """Return one cycle for each load, without noise, FORCERR that of the plan."""
    plan, mirror, count = ready.plan, ready.mirror, len(ready.shapes)
    layout, sign = mirror.layout, np.repeat([1, -1], count)
    static = np.zeros((len(plan.loads), layout.n))
    static[:, layout.enabled] = ready.rest_force
    a = arms(layout) * layout.enabled
    # Measured forces and given shapes do not satisfy A f = 0 exactly.
    elastic = ready.force - (ready.force @ a.T) @ np.linalg.pinv(a).T
    return Campaign(
        tuple(
            Cycle(
                instrument=mirror.name,
                date=START,
                number=1,
                load=replace(load, coil_shift=None),  # not in the forces, either
                weight=mirror.weight,
                weight_error=mirror.weight_error,
                layout=layout,
                time=np.arange(2.0 * count),
                shape=np.tile(np.arange(1, count + 1), 2),
                sign=sign,
                force=np.concatenate([elastic, -elastic]) + held,
                valid=np.ones(2 * count, dtype=bool),
                force_error=plan.force_noise,
                coil_gradient=mirror.coil_gradient,
                bias_gradient=mirror.bias_gradient,
            )
            for load, held in zip(plan.loads, static, strict=True)
        )
    )
