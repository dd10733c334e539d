"""What a third load would show that two cannot, and what it would cost.

Under two loads scale and bias magnets take up whatever the sums of the forces say. Under three they
leave one equation, v'(S + W / s) = 0 with v orthogonal to S and to 1: a weight that is wrong breaks
it, and so does something that bears part of it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from truenewton.acquisition.load_order import mounting_variance, order_cost, scale_balance
from truenewton.planning.forces import Prepared

SIGMAS = 3.0  # at which something is seen


@dataclass(frozen=True)
class ThirdLoad:
    """A third load, as heavy and as well known as the one that gives the scale, by itself.

    Attributes
    ----------
    like
        Name of the load that it is like, and that it would watch.
    seen
        Weight by which that load must be wrong, or be borne by something else, to be seen [N].
    relative
        The same in terms of the difference that the load makes: of the scale, if it is not seen.
    duration, mountings
        How much longer the campaign becomes [s], and how many mountings more.
    error, error_now
        Of the scale with it and without, drift and mounting included.
    """

    like: str
    seen: float
    relative: float
    duration: float
    mountings: int
    error: float
    error_now: float


def third_load(ready: Prepared) -> ThirdLoad | None:
    """Return what a third load would do; None where there are three, or no scale."""
    plan, mirror, shapes = ready.plan, ready.mirror, len(ready.shapes)
    now = order_cost(plan, mirror, shapes)
    balance = scale_balance(plan, mirror, shapes)
    if now is None or balance is None or len(np.unique(balance.held)) > 2:
        return None
    apart = np.abs(balance.held - balance.held[0])
    watched = int(apart.argmax())
    like = plan.loads[watched]
    taken = {load.key for load in plan.loads}
    name = next(name for k in range(len(taken) + 1) if (name := f"third{k or ''}") not in taken)
    wider = replace(plan, loads=(*plan.loads, replace(like, name=name, tool=None)))
    then, with_it = order_cost(wider, mirror, shapes), scale_balance(wider, mirror, shapes)
    if then is None or with_it is None:
        return None
    # What least squares leave of a step in the sum of one load.
    design = np.column_stack([with_it.held, np.ones_like(with_it.held)])
    moved = np.diag(mounting_variance(wider, with_it))
    inverse = np.linalg.inv(with_it.covariance + moved)
    step = np.eye(len(wider.loads))[watched]
    fitted = design @ np.linalg.solve(design.T @ inverse @ design, design.T @ inverse @ step)
    seen = SIGMAS / float(np.sqrt(step @ inverse @ (step - fitted)))
    return ThirdLoad(
        like=like.name,
        seen=seen,
        relative=seen / float(apart[watched]),
        duration=then.duration - now.duration,
        mountings=then.changes - now.changes,
        error=then.error,
        error_now=now.error,
    )
