"""Rows that repeat one shape: same load, SHAPE and SIGN, so the same true forces but for noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truenewton.actuators import Array
from truenewton.campaign import Campaign


@dataclass(frozen=True, eq=False)
class RowGroups:
    """The valid rows of a campaign, put together by load, shape and sign.

    Attributes
    ----------
    labels
        (g, 3) place of the load, SHAPE, SIGN of each group.
    count
        (g,) number of rows.
    mean
        (g, n_enabled) mean commanded force [N].
    scatter
        (n_enabled,) sum over rows of the squared deviations from their group's mean [N^2].
    """

    labels: NDArray[np.int64]
    count: NDArray[np.int64]
    mean: Array
    scatter: Array

    @property
    def degrees_of_freedom(self) -> int:
        """Rows less groups: what the scatter rests on."""
        return int((self.count - 1).sum())

    @property
    def noise(self) -> float:
        """Standard deviation of one reading, RMS over actuators [N]; NaN if nothing repeats."""
        freedom = self.degrees_of_freedom
        return float(np.sqrt(self.scatter.mean() / freedom)) if freedom else float("nan")


def row_labels(campaign: Campaign) -> NDArray[np.int64]:
    """Return (rows, 3) place of the load, SHAPE and SIGN of each valid row, load by load.

    The order is that of the rows of E, block by block: loads in turn, in each its cycles in turn.
    """
    labels = []
    for place in range(len(campaign.loads)):
        for cycle, at in zip(campaign.cycles, campaign.load_index, strict=True):
            if at == place:
                on = cycle.valid
                labels.append(
                    np.stack([np.full(on.sum(), place), cycle.shape[on], cycle.sign[on]], axis=1)
                )
    return np.concatenate(labels)


def group_rows(labels: NDArray[np.int64], values: Array) -> tuple[NDArray[np.int64], RowGroups]:
    """Put rows with the same label together.

    Parameters
    ----------
    labels
        (rows, 3).
    values
        (rows, columns).

    Returns
    -------
    member, groups
        (rows,) group of each row; the groups.
    """
    unique, member = np.unique(labels, axis=0, return_inverse=True)
    member = member.ravel()
    count = np.bincount(member, minlength=len(unique))
    order = np.argsort(member, kind="stable")
    starts = np.concatenate([[0], np.cumsum(count)[:-1]])
    mean = np.add.reduceat(values[order], starts, axis=0) / count[:, None]
    scatter = np.sum((values - mean[member]) ** 2, axis=0)
    return member, RowGroups(unique, count, mean, scatter)


def row_groups(campaign: Campaign) -> RowGroups:
    """Return the valid rows of a campaign, grouped."""
    order = np.argsort(campaign.load_index, kind="stable")
    force = np.vstack([campaign.cycles[i].used_force for i in order])
    return group_rows(row_labels(campaign), force)[1]
