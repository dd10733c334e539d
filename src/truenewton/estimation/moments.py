"""What a campaign boils down to: repeats put together, then sums over shapes.

Rows with the same load, SHAPE and SIGN share their true forces, so their number, mean and scatter
hold all that they say of alpha. From the means, everything the likelihood needs of a load is their
number, sum and second moment: one symmetric rank-k update by BLAS.

Where POSITION and the gradients are given, c becomes c (1 + COILGRAD z), and the bias magnets'
change BIASGRAD z is kept as a known part of the balance (docs/files.md). Displacements count from
one reading of each sensor for the whole campaign (`displaced_rows.common_reference`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from truenewton.arrays import Array
from truenewton.estimation.shape_sums import ShapeSums, shape_sums
from truenewton.statics.load import Load


@dataclass(frozen=True, eq=False)
class Moments:
    """Groups of rows that repeat one shape.

    Attributes
    ----------
    loads
        The L loads.
    labels
        (g, 3) index of the load, SHAPE, SIGN; sorted.
    rows
        (g,) number of rows; 0, as its weight, for a group that is left out.
    weight
        (g,) sum of the weights of the rows; their number where no file declares its noise.
    mean
        (g, n) mean commanded force of the enabled actuators, COILGRAD taken in [N].
    known
        (g, 3) mean of what is known of the balance beforehand: A (BIASGRAD z).
    scatter
        (n,) weighted sum of squared deviations of rows from their group's mean [N^2].
    reference
        (n,) readings from which displacements count [m]; NaN where from the mean of each cycle.
    """

    loads: tuple[Load, ...]
    labels: NDArray[np.int64]
    rows: NDArray[np.int64]
    weight: Array
    mean: Array
    known: Array
    scatter: Array
    reference: Array

    @property
    def groups(self) -> int:
        """Number of groups that are not left out: of distinct shapes, each with its own noise."""
        return int(np.count_nonzero(self.rows))

    @property
    def repeats(self) -> int:
        """Rows less groups: the degrees of freedom of the scatter of one actuator."""
        return int(self.rows.sum()) - self.groups

    @property
    def noise(self) -> float:
        """Standard deviation of one reading, RMS over actuators [N]; NaN if nothing repeats."""
        if not self.repeats:
            return float("nan")
        return float(np.sqrt(self.scatter.mean() / self.repeats * self.typical_variance))

    @property
    def typical_variance(self) -> float:
        """Variance of a typical row in terms of one of weight 1."""
        return float(self.rows.sum() / self.weight.sum())

    @cached_property
    def sums(self) -> ShapeSums:
        """The sums over groups; taken once."""
        load = self.labels[:, 0]
        return shape_sums(self.mean, self.weight, self.known, load, len(self.loads))


def chosen_groups(moments: Moments, chosen: NDArray[np.bool_]) -> Moments:
    """Return moments in which only the (g,) chosen groups count; scatter stays that of all.

    The others keep their place and lose their rows and weight, so that no mean is copied.
    """
    rows, weight = np.where(chosen, moments.rows, 0), np.where(chosen, moments.weight, 0.0)
    return replace(moments, rows=rows, weight=weight)
