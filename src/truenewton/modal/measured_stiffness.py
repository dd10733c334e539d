"""The measured stiffness from cycle files: commanded force per reading, by weighted regression.

With z the reading and c' = c (1 + COILGRAD z) the force, both counted from rest in each cycle,

    c' = K_c z,    K_c = diag(1/alpha) (K - BIASGRAD) diag(sensor gain)

so the magnets' gradient stays inside: a feed-forward must hold it too. Repeats of a shape, its
negative counted as one, are put together first, and weigh as their rows do.

Noise in z makes an ordinary regression too soft. Rows that repeat each other show that noise, with
all that the loop makes of it in c; its share of sum z z' and sum c z' is taken out (errors in
variables, the method of moments: Fuller, Measurement Error Models, 1987, chapter 2). At 66 pm of
noise that is nothing; it counts where noise times the root of the number of shapes nears the
displacement.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from truenewton.arrays import Array, freeze
from truenewton.errors import RankDeficient
from truenewton.estimation.checks.inputs import refusal_naming
from truenewton.estimation.findings.estimate import RejectedRow
from truenewton.estimation.findings.finding import Finding
from truenewton.estimation.readings.row_readers import read_rows
from truenewton.estimation.screening.frozen_readings import frozen_sensors
from truenewton.estimation.screening.screen import ScreenedCampaign, screen_campaign
from truenewton.files.stored_rows import Rows, StoredRows, largest_in_rows
from truenewton.modal.shape_products import MotionReader
from truenewton.records.campaign import Campaign
from truenewton.records.cycle import Cycle
from truenewton.records.stiffness_matrix import StiffnessMatrix
from truenewton.statics.arms import arms_in_units_of_rms
from truenewton.statics.layout import Layout

HELD = 3.0  # times the most that noise feigns: above it shapes hold a direction
ROUNDING = 1e-5  # of the largest amplitude: below it a direction is rounding
UNTOLD = 3e-3  # the same where nothing repeats, so that nobody knows the noise
WITHIN = 0.1  # cosine to a rigid motion, from which on a missing direction counts as one


@dataclass(frozen=True, eq=False)
class MeasuredStiffness:
    """The stiffness that a campaign measured, and how well.

    Attributes
    ----------
    matrix
        The measured stiffness; 0 in rows and columns of disabled actuators.
    shapes, rows
        Number of distinct shapes (of each load), and of rows that repeat them.
    residual
        Rms force that the stiffness does not explain, of one row and actuator [N].
    misfit
        Variance of what distinct shapes leave over that of repeats: about 1 where c' = K_c z is all
        there is; NaN where nothing repeats or all shapes are needed.
    error
        (n, n) standard error of each element [N/m]; NaN where no row is to spare.
    relative_error
        Norm of the expected error over that of the stiffness; what ``rigid_assumed`` costs is not
        in it.
    rigid_assumed
        Number of rigid motions (of 3) that the shapes do not hold, which are taken to cost no
        force.
    rejected
        Rows left out because they stand off from their repeats, in force or position; their cycles
        count among those that hold POSITION.
    warnings
        Of sensors that read the same in all rows of some files.
    """

    matrix: StiffnessMatrix
    shapes: int
    rows: int
    residual: float
    misfit: float
    error: Array
    relative_error: float
    rigid_assumed: int
    rejected: tuple[RejectedRow, ...]
    warnings: tuple[Finding, ...] = ()

    def __post_init__(self) -> None:
        freeze(self, "error")


def measured_stiffness(campaign: Campaign) -> MeasuredStiffness:
    """Find commanded force per reading from the cycles that hold POSITION; others take no part.

    Parameters
    ----------
    campaign
        With POSITION.

    Raises
    ------
    RankDeficient
        No POSITION, elastic motions that no shape holds, or a sensor that reads the same in all
        rows of all files.
    TooManyOutliers
        So many rows stand off from their repeats that the rest cannot be trusted.

    Examples
    --------
    >>> tn.measured_stiffness(campaign).matrix
    <StiffnessMatrix of P45: 45 actuators>
    """
    reader = motion_reader(screen_campaign(replace(campaign, stiffness=None)))
    read_rows(campaign, (reader.take,))
    return stiffness_of(reader)


def motion_reader(screened: ScreenedCampaign) -> MotionReader:
    """Return who reads force and displacement of all rows that stand off in neither.

    Where a stiffness stands among the cycles, only the force at rest is read.

    Raises
    ------
    RankDeficient
        No cycle holds POSITION.
    TooManyOutliers
        So many rows stand off from their repeats that the rest cannot be trusted.
    """
    campaign, on = screened.campaign, screened.campaign.layout.enabled
    if campaign.stiffness is not None:
        return MotionReader(campaign, screened.sound)
    positioned = [
        k
        for k, cycle in enumerate(campaign.cycles)  # zeros may stand in place of POSITION
        if cycle.position is not None and largest_in_rows(cycle.position, on)[cycle.valid].any()
    ]
    if not positioned:
        raise RankDeficient(
            "no cycle holds POSITION, so nothing tells the stiffness",
            remedy="record the sensors' readings, or give a measured stiffness file",
            got=0,
        )
    if len(positioned) < len(campaign.cycles):  # others tell nothing of these
        by_force = screen_campaign(Campaign(tuple(campaign.cycles[k] for k in positioned)))
    else:
        by_force = screened
    displaced = tuple(
        replace(cycle, force=_displacements(cycle, positions), position=None, force_error=None)
        for cycle in by_force.sound.cycles
        if (positions := cycle.position) is not None
    )
    by_position = screen_campaign(Campaign(displaced))
    cycles = list(screened.sound.cycles)
    for k, cycle, other in zip(
        positioned, by_force.sound.cycles, by_position.sound.cycles, strict=True
    ):
        cycles[k] = cycle if cycle.valid is other.valid else replace(cycle, valid=other.valid)
    rejected = by_force.rejected + by_position.rejected
    return MotionReader(campaign, Campaign(tuple(cycles)), positioned, rejected)


def stiffness_of(reader: MotionReader) -> MeasuredStiffness:
    """Return commanded force per reading, all rows having been read.

    The standard error is that of the regression, from its residuals, in which noise of force and
    of position meet: of element i, j s_i (S^-1)_jj^1/2 with S = sum z z', and s_i^2 the larger of
    what repeats scatter and what distinct shapes leave.

    Raises
    ------
    RankDeficient
        Elastic motions that no shape holds, or a sensor that reads the same in all rows of all
        files.
    """
    cycles = reader.positioned
    frozen = frozen_sensors(Campaign(cycles))
    for effect in frozen:
        if effect.size == 1.0:  # the share of the files
            raise RankDeficient(f"{effect.name}: {effect.where}", remedy=effect.remedy)
    sums = reader.products()
    layout = reader.sound.layout
    n = int(layout.enabled.sum())
    # Of the noise of G shapes the fit of n columns takes n + 1 parts up: z'z - (G - n - 1) of it
    # leaves no bias to second order, z'z - G of it would make K_c too stiff.
    share = max(sums.shapes - n - 1, 0) / sums.spare if sums.spare > 0 else 0.0
    square = sums.between.zz - share * sums.within.zz
    square = 0.5 * (square + square.T)
    values, vectors = np.linalg.eigh(square)
    noise = sums.position_variance * (np.sqrt(sums.shapes) + np.sqrt(n)) ** 2
    least = UNTOLD if np.isnan(noise) else ROUNDING
    held = values > max(HELD**2 * np.nan_to_num(noise), least**2 * values[-1])
    with refusal_naming(lambda: frozen):
        along = _along_rigid(vectors[:, ~held], layout, any(c.has_opposites for c in cycles))
    # (S^-1) on what is held, seen along the rigid motions that are not.
    half = along.T @ vectors[:, held] / np.sqrt(np.maximum(values[held], 1e-300))
    inverse = half @ half.T
    k = (sums.between.cz - share * sums.within.cz) @ inverse
    spare = sums.shapes - int(held.sum())
    left = [
        sums_left.unexplained(k) / degrees
        for sums_left, degrees in ((sums.within, sums.spare), (sums.between, spare))
        if degrees > 0
    ]
    variance = max(left, key=np.sum) if left else np.full(n, np.nan)
    error = np.sqrt(np.outer(variance, np.diag(inverse)))
    on = np.ix_(layout.enabled, layout.enabled)
    whole, whole_error = np.zeros((2, layout.n, layout.n))
    whole[on], whole_error[on] = k, error
    first = min(cycles, key=lambda cycle: cycle.date)
    return MeasuredStiffness(
        matrix=StiffnessMatrix(first.instrument, first.date, layout, whole),
        shapes=sums.shapes,
        rows=sums.rows,
        residual=float(np.sqrt(variance.mean() * sums.rows / sums.weight)),
        misfit=float(left[1].sum() / left[0].sum()) if len(left) == 2 else float("nan"),
        error=whole_error,
        relative_error=float(np.linalg.norm(error) / np.linalg.norm(k)),
        rigid_assumed=int((~held).sum()),
        rejected=reader.rejected,
        warnings=frozen,
    )


def _displacements(cycle: Cycle, positions: Rows) -> Rows:
    """Return (N, n) readings less those at rest, wherever the cycle rests and whatever its zeros.

    Rest is the median, over shapes, of the mean of a shape and its negative: no row that stands off
    moves it.
    """
    number, sign = cycle.shape[cycle.valid], cycle.sign[cycle.valid]
    up, down = np.flatnonzero(sign > 0), np.flatnonzero(sign < 0)
    _, first, second = np.intersect1d(number[up], number[down], return_indices=True)
    rest, on = np.zeros(cycle.layout.n), cycle.layout.enabled
    pairs = (cycle.used(positions, rows) for rows in (up[first], down[second]))
    rest[on] = np.median(0.5 * sum(pairs), axis=0) if first.size else cycle.rest_position
    if isinstance(positions, StoredRows):
        in_unit = positions.in_unit
        return replace(positions, in_unit=lambda values: in_unit(values) - rest)
    return positions - rest


def _along_rigid(missing: Array, layout: Layout, has_opposites: bool) -> Array:
    """Return (n, n) the projection that takes rigid motions out of displacements.

    It keeps what the shapes hold, and takes away as many rigid motions as the (n, d) ``missing``
    directions, those nearest to them.

    Raises
    ------
    RankDeficient
        A missing direction is not rigid.
    """
    n, count = missing.shape
    rigid = np.linalg.qr(arms_in_units_of_rms(layout).T)[0]
    _, cosine, right = np.linalg.svd(missing.T @ rigid)
    elastic = count - int(np.count_nonzero(cosine > WITHIN))
    if elastic:
        raise RankDeficient(
            f"{elastic} of {n - 3} elastic motions are missing from the shapes or drowned in noise",
            remedy="take shapes that span all stiffness modes, larger, or repeat them"
            if has_opposites
            else "take each shape with both signs, so that the mirror at rest is known",
            got=n - 3 - elastic,
            want=n - 3,
        )
    assumed = rigid @ right[:count].T
    return np.asarray(np.eye(n) - assumed @ np.linalg.solve(missing.T @ assumed, missing.T))
