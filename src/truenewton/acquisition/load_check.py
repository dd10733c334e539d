"""Whether a load is really on, from the forces that hold the mirror at rest.

At rest sum nz_i alpha_i c_i = -(W + B) (docs/method.md), so between two loads the sum of nz_i c_i
changes by -(W_1 - W_2) over a mean of alpha. B is not known, alpha only roughly: one load alone
tells nothing, two tell whether something of about the right weight came on or off.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np
from numpy.typing import NDArray

from truenewton.arrays import Array
from truenewton.bench.protocol import Reading
from truenewton.statics.arms import effective_weight
from truenewton.statics.layout import Layout
from truenewton.statics.load import Load

# alpha lies between 0.7 and 1.1 [paper]; a simulated P45 gave 0.96 to 1.38 in 60 draws.
CHANGE = (0.6, 1.5)
SAME = 0.4  # of the smallest step between two loads: so little may the sum change under one load
SURE = 5.0  # standard deviations of a sum, to which the smallest step must be large


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
    """Tell whether a load is on.

    Parameters
    ----------
    weight
        P [N].
    loads, load
        All loads of the plan, and the one that should be on.
    rest_sums
        Sums at rest under the loads that were on before [N], by key, with this one's own if it was.
    total, error
        The sum now, and its standard deviation [N].

    Returns
    -------
    on
        Whether it is on; None where the forces cannot tell.
    why
        One line.
    """
    names = {each.key: each.name for each in loads}
    weights = {each.key: float(effective_weight(weight, each.added, each.tilt)) for each in loads}
    step = {key: other - weights[load.key] for key, other in weights.items()}
    smallest = min((abs(value) for value in step.values() if value), default=0.0)
    if smallest * SAME <= SURE * error:
        return None, f"the loads differ by {smallest:.3g} N, too little to tell them apart"
    compared = [key for key in rest_sums if key == load.key or step[key]]
    if not compared:
        return None, "no other load to compare with yet: taken on trust"
    for key in compared:
        change, name = total - rest_sums[key], names[key]
        changed = f"the sum of the forces changed by {change:.4g} N"
        if key == load.key:
            if abs(change) > SAME * smallest:
                return False, f"{changed} since '{name}' was on before"
        elif not CHANGE[0] <= change / step[key] <= CHANGE[1]:
            low, high = (100 * part for part in CHANGE)
            due = f"{step[key]:.4g} N are due ({low:.0f} to {high:.0f} % of it)"
            sign = ": the wrong way, as where Force is not positive along +z"
            turned = sign if change / step[key] <= -CHANGE[0] else ""
            return False, f"{changed} from '{name}', where {due}{turned}"
    beside = ", ".join(f"'{names[key]}'" for key in compared)
    return True, f"the sum of the forces is {total:.4g} N, as due beside {beside}"
