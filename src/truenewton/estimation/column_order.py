"""Whether FORCE and POSITION have their columns in one order.

Forces on displacements over the shapes of a campaign give the stiffness of the glass, K, but for
the gain of each row (alpha) and of each column (the sensor). K is symmetric and not negative, so
K_ij^2 <= K_ii K_jj, and no permutation has a larger product |K_1p(1) ... K_np(n)| than the
diagonal; gains do not change which one is largest. So where another one is, FORCE stands in that
order.
"""

from __future__ import annotations

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from truenewton.arrays import Array
from truenewton.estimation.findings.code import Code
from truenewton.estimation.findings.finding import Finding
from truenewton.estimation.moments import Moments
from truenewton.linalg import assignment, asymmetry
from truenewton.records.campaign import Campaign
from truenewton.rounding import named

CONTRADICTS = 0.2  # asymmetry of the stiffness in terms of its size
CURES = 0.5  # of it, which the better order leaves at most
FEW = 4  # columns that are named one by one
CLEARLY = np.log(1.5)  # larger each element of a better order is, on the average


def misordered_columns(campaign: Campaign, moments: Moments) -> tuple[Finding, ...]:
    """Name an order of FORCE that POSITION contradicts.

    Nothing is said where POSITION is not at hand, or shapes are too few for a stiffness.
    """
    stiffness = stiffness_of_shapes(moments)
    if stiffness is None:
        return ()
    order = likeliest_order(stiffness)
    moved = np.flatnonzero(order != np.arange(len(order)))
    if not moved.size:
        return ()
    before, after = asymmetry(stiffness), asymmetry(stiffness[np.argsort(order)])
    element, best = np.abs(stiffness[moved, moved]), np.abs(stiffness[moved, order[moved]])
    gain = float(np.mean(np.log(best / np.maximum(element, 1e-300))))
    few = moved.size <= FEW  # two columns of many hardly show in all of the matrix
    if gain < CLEARLY or not (after < CURES * before or (few and after < before)):
        return ()
    if not few and before < CONTRADICTS:
        return ()
    ids = campaign.layout.id[campaign.layout.enabled][moved].tolist()
    percent = f"asymmetry of the stiffness {100 * before:.0f} %, in the best order"
    percent += f" {100 * after:.0f} %"
    which = f"{moved.size} of {len(order)} columns" if not few else named("actuator", ids, FEW)
    return (
        Finding(
            code=Code.EXCHANGED_COLUMNS if few else Code.ORDER_OF_POSITION,
            detail="FORCE or POSITION" if few else "",
            where=f"{which} ({percent})",
            actuators=tuple(ids),
            size=before,
            remedy="put the columns of FORCE and POSITION in the order of the ACTUATORS table",
        ),
    )  # fmt: skip


def stiffness_of_shapes(moments: Moments) -> Array | None:
    """Return (n, n) commanded forces on displacements [N/m]; None where the data do not hold it."""
    counted = moments.weight > 0
    if moments.displacement is None:
        return None
    n, loads = moments.mean.shape[1], moments.labels[counted, 0]
    if len(np.unique(moments.labels[counted, 1])) < n - 3:
        return None
    # Both are as large as all means are: the decomposition takes their room.
    moved, force = np.asfortranarray(moments.displacement[counted]), moments.mean[counted]
    for load in np.unique(loads):
        some = loads == load
        force[some] -= force[some].mean(axis=0)
        moved[some] -= moved[some].mean(axis=0)
    projected, upper = scipy.linalg.qr_multiply(moved, force.T, overwrite_a=True, overwrite_c=True)
    # All but piston and tilt, in which no shape needs stand.
    left, size, right = np.linalg.svd(upper)
    left, size, right = left[:, : n - 3], size[: n - 3], right[: n - 3]
    if len(size) < n - 3 or size[-1] <= 1e-9 * size[0]:
        return None
    return np.asarray(projected @ (left / size) @ right)


def likeliest_order(stiffness: Array) -> NDArray[np.int64]:
    """Return (n,) the column of POSITION that belongs to each of FORCE."""
    size = np.abs(stiffness)
    return assignment(-np.log(np.maximum(size, 1e-12 * size.max())))
