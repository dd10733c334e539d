"""The measured stiffness from cycle files: commanded force per reading, by weighted regression.

With z the reading and c' = c (1 + COILGRAD z) the force, both relative to rest in each cycle,

    c' = K_c z,    K_c = diag(1/alpha) (K - BIASGRAD) diag(sensor gain)

so that K_c includes the gradient of the magnets, which a feed-forward must include.

Rows with the same load, SHAPE and SIGN repeat each other; their deviations from their mean are
noise. A shape and its negative are one shape: their common part (the laws of coils and sensors, no
stiffness) cancels. Distinct shapes are weighted by their rows.

Noise in z makes an ordinary regression too soft. Repeated rows show that noise and its effect on c
through the loop; its share of sum z z' and sum c z' is subtracted (errors in variables, the method
of moments: Fuller, Measurement Error Models, 1987, chapter 2). At 66 pm of noise the effect is
negligible; it matters if noise times the root of the number of shapes approaches the displacement.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from truenewton.arrays import Array, blocks, freeze
from truenewton.errors import RankDeficient
from truenewton.estimation.checks import refusal_naming
from truenewton.estimation.findings.estimate import RejectedRow
from truenewton.estimation.findings.finding import Finding
from truenewton.estimation.readings.rows import grouped
from truenewton.estimation.screening.screen import ScreenedCampaign, frozen_sensors, screen_campaign
from truenewton.records.campaign import Campaign
from truenewton.records.cycle import Cycle
from truenewton.records.stiffness_matrix import StiffnessMatrix
from truenewton.statics.arms import arms_in_units_of_rms
from truenewton.statics.layout import Layout

MIN_SIGNAL_TO_NOISE = 3.0  # of a direction of motion that the shapes contain
MIN_AMPLITUDE = 1e-5  # of such a direction, relative to the largest
MIN_AMPLITUDE_WITHOUT_REPEATS = 3e-3  # the same if the noise is unknown
MIN_COSINE = 0.1  # of a missing direction to a rigid motion that it counts as


class Products:
    """Sums over rows of c_i^2 (n,), c z' and z z' (n, n)."""

    def __init__(self, n: int) -> None:
        self.cc, (self.cz, self.zz) = np.zeros(n), np.zeros((2, n, n))

    def add(self, c: Array, z: Array) -> None:
        """Add (m, n) rows."""
        self.cc += np.einsum("ri,ri->i", c, c)
        self.cz += c.T @ z
        self.zz += z.T @ z

    def unexplained(self, k: Array) -> Array:
        """Return (n,) the sum of (c - K z)^2."""
        left = self.cc - np.einsum("ij,ij->i", k, 2 * self.cz - k @ self.zz)
        return np.asarray(np.maximum(left, 0.0))


class MotionSums:
    """Sums of force and displacement over the rows of a campaign, relative to rest.

    Rest is the mean of c (1 + COILGRAD z) over the rows that have their opposite.

    ``sound`` is the campaign with excluded rows marked as not valid, ``positioned`` the indices of
    its cycles with POSITION, ``rejected`` the rows excluded from these. Without such cycles only
    ``force_at_rest`` is found.
    """

    def __init__(
        self,
        sound: Campaign,
        positioned: Sequence[int] = (),
        rejected: tuple[RejectedRow, ...] = (),
    ) -> None:
        self.sound, self.rejected = sound, rejected
        self.positioned = tuple(sound.cycles[k] for k in positioned)
        rests, forces, positions = list[Array](), list[Array](), list[Array]()
        for k, cycle in enumerate(sound.cycles):
            force = cycle.used_force
            if cycle.position is not None:
                z = cycle.used(cycle.position, slice(None)) - cycle.rest_position
                coil, shift = cycle.coil_gradient or 0.0, cycle.load.coil_shift or 0.0
                force = force * (1.0 + coil * (z - shift))
            rests.append(force[cycle.paired_rows].mean(axis=0))
            if k in positioned:
                forces.append(force - rests[-1])
                positions.append(z)
        bare = np.equal(sound.load_index, 0)
        # (n,) commanded force at rest under the first, bare load, mean of its cycles [N]
        self.force_at_rest = np.mean(np.array(rests)[bare], axis=0)
        if positioned:
            self._add(tuple(forces), positions)

    def _add(self, forces: tuple[Array, ...], positions: Sequence[Array]) -> None:
        """Add (N, n) forces and displacements of each cycle with POSITION."""
        n = len(self.force_at_rest)
        rows = grouped(Campaign(self.positioned), forces, (), np.zeros(n))
        self._labels, self.weight, self.rows = rows.labels, rows.total, len(rows.group)
        self._force, self._position = rows.mean, rows.means(positions, n)
        self.within = Products(n)
        for (some, c), (_, z) in zip(rows.parts(forces), rows.parts(positions), strict=True):
            group, root = rows.group[some], np.sqrt(rows.weight[some])[:, None]
            self.within.add(root * (c - self._force[group]), root * (z - self._position[group]))

    @property
    def spare(self) -> int:
        """Degrees of freedom of the repeats."""
        loads = {cycle.load.key for cycle in self.positioned}
        return self.rows - len(self.weight) - (len(self.positioned) - len(loads))

    def between(self) -> tuple[Products, int, float]:
        """Return sums over distinct shapes, their number, and the variance of a reading [m^2].

        The variance is that in a row of weight 1, from repeats and negatives; NaN
        if there are none.
        """
        label, heavy, n = self._labels, self.weight, len(self.force_at_rest)
        edge = np.flatnonzero(np.append(True, (label[1:, :2] != label[:-1, :2]).any(axis=1)))
        ends = np.append(edge, len(label))
        signed, total = label[:, 2] * heavy, np.add.reduceat(heavy, edge)
        between, uneven = Products(n), 0.0
        for some in blocks(len(edge), 4 * 8 * n):
            rows = slice(ends[some.start], ends[some.stop])
            force, position = self._force[rows], self._position[rows]
            uneven += float(heavy[rows] @ np.sum(position**2, axis=1))
            c, z = (
                np.add.reduceat(signed[rows, None] * mean, edge[some] - rows.start)
                / np.sqrt(total[some])[:, None]
                for mean in (force, position)
            )
            between.add(c, z)
            uneven -= float(np.sum(z**2))
        alike = self.rows - len(edge)
        variance = (float(np.trace(self.within.zz)) + uneven) / (n * alike) if alike else np.nan
        return between, len(edge), variance


@dataclass(frozen=True, eq=False)
class MeasuredStiffness:
    """A stiffness measured by a campaign, and its errors.

    Attributes
    ----------
    matrix
        The measured stiffness; 0 in rows and columns of disabled actuators.
    shapes, rows
        Number of distinct shapes (of each load), and of rows that repeat them.
    residual
        Rms residual force of one row and actuator [N].
    misfit
        Residual variance of distinct shapes over that of repeats: about 1 if c' = K_c z is
        complete; NaN if no shape is repeated or all shapes are needed.
    error
        (n, n) standard error of each element [N/m]; NaN without degrees of freedom.
    inverse
        (n, n) covariance of the elements of a row over ``residual`` squared [1/m^2].
    relative_error
        Norm of the expected error over that of the stiffness, without that of ``rigid_assumed``.
    rigid_assumed
        Number of rigid motions (of 3) that the shapes do not contain; they are assumed to need no
        force.
    rejected
        Rows excluded as outliers in force or position; cycle indices are among those with POSITION.
    warnings
        Of sensors with frozen readings in some files.
    """

    matrix: StiffnessMatrix
    shapes: int
    rows: int
    residual: float
    misfit: float
    error: Array
    inverse: Array
    relative_error: float
    rigid_assumed: int
    rejected: tuple[RejectedRow, ...]
    warnings: tuple[Finding, ...] = ()

    def __post_init__(self) -> None:
        freeze(self, "error", "inverse")


def measured_stiffness(campaign: Campaign) -> MeasuredStiffness:
    """Return commanded force per reading from the cycles that contain POSITION.

    Parameters
    ----------
    campaign
        With POSITION.

    Raises
    ------
    RankDeficient
        No POSITION, elastic motions that no shape contains, or a sensor with frozen readings in all
        files.
    TooManyOutliers
        Too many rows deviate from their repeats.

    Examples
    --------
    >>> tn.measured_stiffness(campaign).matrix
    <StiffnessMatrix of P45: 45 actuators>
    """
    return stiffness_of(motion_sums(screen_campaign(replace(campaign, stiffness=None))))


def motion_sums(screened: ScreenedCampaign) -> MotionSums:
    """Return the sums of force and displacement of all rows without outliers.

    If the campaign contains a stiffness, only the force at rest is found.
    """
    campaign, on = screened.campaign, screened.campaign.layout.enabled
    if campaign.stiffness is not None:
        return MotionSums(screened.sound)
    positioned = [
        k
        for k, cycle in enumerate(campaign.cycles)  # POSITION may be zeros
        if cycle.position is not None and cycle.position[np.ix_(cycle.valid, on)].any()
    ]
    if not positioned:
        raise RankDeficient(
            "no cycle contains POSITION, so the stiffness cannot be measured",
            remedy="record the sensors' readings, or give a measured stiffness file",
        )
    if len(positioned) < len(campaign.cycles):
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
    return MotionSums(Campaign(tuple(cycles)), positioned, rejected)


def stiffness_of(sums: MotionSums) -> MeasuredStiffness:
    """Return commanded force per reading.

    The standard error of element i, j is s_i (S^-1)_jj^1/2 with S = sum z z', and s_i^2 the larger
    of the residual variances of repeats and of distinct shapes; it includes noise of force and of
    position.
    """
    cycles = sums.positioned
    frozen = tuple(frozen_sensors(Campaign(cycles)))
    for effect in frozen:
        if effect.size == 1.0:  # the share of the files
            raise RankDeficient(f"{effect.name}: {effect.where}", remedy=effect.remedy)
    between, shapes, reading = sums.between()
    within, degrees_within = sums.within, sums.spare
    layout = sums.sound.layout
    n = int(layout.enabled.sum())
    # The fit of n columns takes up n + 1 parts of the noise of G shapes: subtract G - n - 1
    # leaves no bias to second order; to subtract all G would make K_c too stiff.
    share = max(shapes - n - 1, 0) / degrees_within if degrees_within > 0 else 0.0
    square = between.zz - share * within.zz
    square = 0.5 * (square + square.T)
    values, vectors = np.linalg.eigh(square)
    noise = reading * (np.sqrt(shapes) + np.sqrt(n)) ** 2
    least = MIN_AMPLITUDE_WITHOUT_REPEATS if np.isnan(noise) else MIN_AMPLITUDE
    held = values > max(MIN_SIGNAL_TO_NOISE**2 * np.nan_to_num(noise), least**2 * values[-1])
    with refusal_naming(lambda: frozen):
        along = _along_rigid(vectors[:, ~held], layout, any(c.has_opposites for c in cycles))
    # S^-1 on the directions of the shapes, projected along the missing rigid motions.
    half = along.T @ vectors[:, held] / np.sqrt(np.maximum(values[held], 1e-300))
    inverse = half @ half.T
    k = (between.cz - share * within.cz) @ inverse
    left = [
        products.unexplained(k) / degrees
        for products, degrees in ((within, degrees_within), (between, shapes - int(held.sum())))
        if degrees > 0
    ]
    variance = max(left, key=np.sum) if left else np.full(n, np.nan)
    error = np.sqrt(np.outer(variance, np.diag(inverse)))
    on = np.ix_(layout.enabled, layout.enabled)
    whole, whole_error, whole_inverse = np.zeros((3, layout.n, layout.n))
    whole[on], whole_error[on] = k, error
    weight = sums.weight.sum() / sums.rows  # of a row
    unknown = vectors[:, ~held] / (MIN_AMPLITUDE * np.sqrt(values[-1]))
    whole_inverse[on] = (inverse + unknown @ unknown.T) * weight
    first = min(cycles, key=lambda cycle: cycle.date)
    return MeasuredStiffness(
        matrix=StiffnessMatrix(first.instrument, first.date, layout, whole),
        shapes=shapes,
        rows=sums.rows,
        residual=float(np.sqrt(variance.mean() / weight)),
        misfit=float(left[1].sum() / left[0].sum()) if len(left) == 2 else float("nan"),
        error=whole_error,
        inverse=whole_inverse,
        relative_error=float(np.linalg.norm(error) / np.linalg.norm(k)),
        rigid_assumed=int((~held).sum()),
        rejected=sums.rejected,
        warnings=frozen,
    )


def _displacements(cycle: Cycle, positions: Array) -> Array:
    """Return (N, n) readings relative to rest.

    Rest is the median over shapes of the mean of a shape and its negative, which outliers do not
    move.
    """
    number, sign = cycle.shape[cycle.valid], cycle.sign[cycle.valid]
    up, down = np.flatnonzero(sign > 0), np.flatnonzero(sign < 0)
    _, first, second = np.intersect1d(number[up], number[down], return_indices=True)
    rest, on = np.zeros(cycle.layout.n), cycle.layout.enabled
    pairs = (cycle.used(positions, rows) for rows in (up[first], down[second]))
    rest[on] = np.median(0.5 * sum(pairs), axis=0) if first.size else cycle.rest_position
    return positions - rest


def _along_rigid(missing: Array, layout: Layout, has_opposites: bool) -> Array:
    """Return the (n, n) projection of displacements along rigid motions.

    It keeps the motions of the shapes, and removes as many rigid motions as there are (n, d)
    ``missing`` directions, those nearest to them.
    """
    n, count = missing.shape
    rigid = np.linalg.qr(arms_in_units_of_rms(layout).T)[0]
    _, cosine, right = np.linalg.svd(missing.T @ rigid)
    elastic = count - int(np.count_nonzero(cosine > MIN_COSINE))
    if elastic:
        raise RankDeficient(
            f"{elastic} of {n - 3} elastic motions are missing from the shapes, or below the noise",
            remedy="take shapes that span all stiffness modes, larger, or repeat them"
            if has_opposites
            else "take each shape with both signs, so that the mirror at rest is known",
        )
    assumed = rigid @ right[:count].T
    return np.asarray(np.eye(n) - assumed @ np.linalg.solve(missing.T @ assumed, missing.T))
