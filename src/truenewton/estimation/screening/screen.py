"""Outlying rows are left out, and files checked.

A row is an outlier if its reading of one actuator is far from the mean of the others of its group.
The worst row of each group is removed first, the scatter is estimated again, until no outlier is
left; if only two rows disagree, neither can be trusted and both are removed. A sound campaign loses
a row once in four hundred.

If the remaining rows still scatter more than their median, outliers were not accidents but the tail
of an effect on all rows, a drift perhaps: then only those are removed that stand out from that as
well.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from truenewton.arrays import Array
from truenewton.chance import OF_EACH_KIND, chi2_ppf, normal_isf, t_isf
from truenewton.errors import TooManyOutliers, TrueNewtonError
from truenewton.estimation.findings.code import Code
from truenewton.estimation.findings.estimate import RejectedRow
from truenewton.estimation.findings.finding import Finding, about_actuators
from truenewton.estimation.readings.moments import (
    Moments,
    Noise,
    Structure,
    pooled_where_it_fits,
    reading_noise,
)
from truenewton.estimation.readings.repeats import (
    Prints,
    Scatter,
    common_rows,
    moments_of,
    prints_of,
    step_of,
)
from truenewton.estimation.readings.rows import Rows, rest_positions, rows_of
from truenewton.estimation.screening.hypotheses import (
    columns_of_other_rows,
    compare_files,
    copied_files,
    mislabelled_files,
    mislabelled_rows,
    named_files,
)
from truenewton.records.campaign import Campaign
from truenewton.rounding import percent
from truenewton.statics.layout import Layout

MAX_REJECTED_FRACTION = 0.3  # of the rows; beyond this the campaign is refused
SYSTEMATIC_FRACTION = 0.15  # of the rows of a file: if more are outliers, its labels are checked
LONG_TAIL_RATIO = 1.08  # of scatter to that by the median: beyond, outliers are a tail
GROSS_SCATTER = 0.02  # of repeats relative to the forces: more is not a drift
FAR_OUT_FACTOR = 3.0  # on the usual limit, if outliers are a tail


@dataclass(frozen=True, eq=False)
class ScreenedCampaign:
    """A campaign without outliers, and the moments of its rows."""

    campaign: Campaign  # as given
    sound: Campaign  # with the rejected rows marked as not valid
    rejected: tuple[RejectedRow, ...]  # rows that differ from their repeats
    moments: Moments  # of the sound rows; pooled if shapes repeat over loads and signs
    noise: Noise  # of a reading of them
    samples: (
        Array  # (m, n) deviations of some rows from the others of their groups [N], see `Scatter`
    )
    structure: Structure | None  # test of these repeats; None if not possible
    suspects: tuple[Finding, ...] = ()  # files that are not what they claim
    # sensors that read the same in all rows; their displacement is 0
    frozen: tuple[Finding, ...] = ()


def screen_campaign(campaign: Campaign) -> ScreenedCampaign:
    """Leave out rows that differ from their repeats, and check files and readings.

    Raises TooManyOutliers if a cycle would lose all its rows.
    """
    prints = prints_of(campaign)
    step = step_of(prints)
    repeats = _repeats_of(campaign, step)
    apart = compare_files(campaign, prints)
    suspects = (
        *apart,
        *copied_files(campaign, prints, in_steps=bool(np.any(step))),
        *mislabelled_files(campaign, repeats.moments),
        *columns_of_other_rows(campaign, repeats.moments),
    )
    refusal: TooManyOutliers | None = None
    try:
        repeats, sound, rejected = _left_out(repeats, campaign, accidents=True)
        refuse_too_many(len(rejected), len(rejected) + int(repeats.moments.rows.sum()))
        accidents = not rejected or _tails(repeats) <= LONG_TAIL_RATIO
    except TooManyOutliers as error:  # if of one cycle, it differs as a whole
        accidents, refusal = False, error
    if not accidents:
        try:
            repeats, sound, rejected = _left_out(
                _repeats_of(campaign, step), campaign, accidents=False
            )
            moments = repeats.moments
            gross = moments.noise > GROSS_SCATTER * np.sqrt(np.mean(moments.mean**2))
            if refusal is not None and gross:
                raise refusal
        except TooManyOutliers as error:
            suspects += () if apart else mislabelled_rows(campaign, range(len(campaign)))
            if not (suspects or error.path):  # of all files
                suspects = louder_with_force(campaign, prints)
            raise with_suspects(error, suspects) from None
    lost = np.bincount([row.cycle for row in rejected], minlength=len(campaign))
    valid = np.array([cycle.valid.sum() for cycle in campaign.cycles])
    affected = np.flatnonzero(lost > np.maximum(2, SYSTEMATIC_FRACTION * valid)).tolist()
    suspects += mislabelled_rows(campaign, affected) if affected and not apart else ()
    # Rounding is no normal noise, and files that are not what they claim make noise of their own.
    louder = () if suspects or np.any(step) else louder_with_force(sound, prints_of(sound))
    suspects += louder
    moments, frozen = repeats.moments, tuple[Finding, ...]()
    moments = replace(moments, by_force=sum(each.size for each in louder))
    noise = reading_noise(sound, moments)
    if (displacement := _displacement(repeats.rows, sound)) is not None:
        frozen = tuple(frozen_sensors(campaign))
        displacement[:, still_sensors(campaign).any(axis=0)] = 0.0
        moments = replace(moments, displacement=displacement)
    moments, structure = pooled_where_it_fits(moments, noise, repeats.scatter.samples)
    return ScreenedCampaign(
        campaign,
        sound,
        tuple(rejected),
        moments,
        noise,
        repeats.scatter.samples,
        structure,
        suspects,
        frozen,
    )


def louder_with_force(campaign: Campaign, prints: Sequence[Prints]) -> tuple[Finding, ...]:
    """Return that noise grows with the force, if it does."""
    share = noise_by_force(campaign, prints)
    where = f"{percent(share)} of its variance"
    return (Finding(code=Code.NOISE_BY_FORCE, size=share, where=where),) if share else ()


def noise_by_force(campaign: Campaign, prints: Sequence[Prints]) -> float:
    """Return the share of the noise that is in proportion to the force; 0 unless it is significant.

    The deviation of a row from its repeats, without the zero and the gain of each actuator in its
    file, has the variance s^2 (1 + share (c^2 / m - 1)), m the mean of c^2. Large deviations count
    as of five standard deviations, so that accidents do not decide.
    """
    rows, along, square, noise = common_rows(prints).astype(np.float64), 0.0, 0.0, 0.0
    for load in range(len(campaign.loads)):
        files = rows[np.array(campaign.load_index) == load]
        if len(files) < 2 or files.shape[1] < MIN_ROWS_OF_NOISE:
            continue
        mean = files.mean(axis=0)
        excess = mean**2 / _some(np.mean(mean**2, axis=0)) - 1.0
        centred = (mean - mean.mean(axis=0)) / _some(np.std(mean, axis=0))
        kept = np.maximum(1.0 - (1.0 + centred**2) / len(mean), 0.1)  # of the variance, by the fit
        kept *= 1.0 - 1.0 / len(files)
        for apart in files - mean:
            left = apart - apart.mean(axis=0) - np.mean(apart * centred, axis=0) * centred
            left /= np.sqrt(kept)
            variance = np.median(left**2, axis=0) / chi2_ppf(0.5, 1)
            deviation = np.minimum(left**2 / _some(variance), LARGEST_DEVIATION**2)
            deviation -= deviation.mean(axis=0)
            along += float(np.sum(excess * deviation))
            square += float(np.sum(excess**2))
            noise += float(np.sum((excess * deviation) ** 2))
    significant = along > normal_isf(OF_EACH_KIND) * np.sqrt(noise)
    return min(along / square, 1.0) if significant else 0.0


def _some(values: Array) -> Array:
    return np.maximum(values, 1e-300)


def with_suspects(error: TrueNewtonError, suspects: Sequence[Finding]) -> TrueNewtonError:
    """Return an error that names the suspected cause."""
    if not suspects:
        return error
    what = "; ".join(f"{effect.name}: {effect.where}" for effect in suspects)
    return type(error)(
        f"{what} ({error.fault})",
        remedy=suspects[0].remedy,
        path=error.path,
    )


class Repeats(NamedTuple):
    """The rows of a campaign, their moments and scatter."""

    rows: Rows
    moments: Moments
    scatter: Scatter


def _repeats_of(campaign: Campaign, step: Array | float) -> Repeats:
    rows = rows_of(campaign)
    return Repeats(rows, *moments_of(rows, step))


def _left_out(
    repeats: Repeats, campaign: Campaign, *, accidents: bool
) -> tuple[Repeats, Campaign, list[RejectedRow]]:
    """Leave out outliers, as accidents or as a tail."""
    rejected, step = list[RejectedRow](), repeats.moments.step
    while worst := _worst_rows(repeats, campaign.layout, accidents=accidents):
        rejected += worst
        campaign = without(campaign, worst)
        repeats = _repeats_of(campaign, step)
    return repeats, campaign, rejected


def _tails(repeats: Repeats) -> float:
    """Return the scatter of rows over that by the median; 1 of a normal distribution."""
    if repeats.moments.repeats < 2:
        return 1.0
    noise, robust = _noises(repeats)
    return float(np.median(noise / np.maximum(robust, 1e-300)))


def _displacement(rows: Rows, campaign: Campaign) -> Array | None:
    """Return (g, n) mean displacements of the groups [m]; None without POSITION."""
    zeros = rest_positions(campaign)
    if zeros is None:
        return None
    displaced = (
        cycle.used(cycle.position, slice(None)) - zero
        for cycle, zero in zip(campaign.cycles, zeros, strict=True)
        if cycle.position is not None
    )
    return rows.means(displaced, len(rows.reference))


def campaign_moments(campaign: Campaign) -> Moments:
    """Return the moments of all valid rows of a campaign."""
    return moments_of(rows_of(campaign), step_of(prints_of(campaign)))[0]


def without(campaign: Campaign, rows: list[RejectedRow]) -> Campaign:
    """Return the campaign without some rows; raise TooManyOutliers if a cycle has no other."""
    cycles = list(campaign.cycles)
    for k in {row.cycle for row in rows}:
        valid = cycles[k].valid.copy()
        valid[[row.row for row in rows if row.cycle == k]] = False
        if not valid.any():
            raise TooManyOutliers(
                "not one of its rows fits the other files",
                remedy="compare its LOAD, SHAPE and SIGN with theirs, and the unit, sign and order"
                " of its FORCE and POSITION; or leave it out",
                path=cycles[k].name,
            )
        cycles[k] = replace(cycles[k], valid=valid)
    return Campaign(tuple(cycles))


def _worst_rows(repeats: Repeats, layout: Layout, *, accidents: bool) -> list[RejectedRow]:
    """Return the worst outlier of each group that has one; both rows of a pair."""
    rows, moments, scatter = repeats
    if moments.repeats < 2:
        return []
    noise, robust = _noises(repeats)
    # The median is less sure than the scatter: it counts where spikes have swollen that.
    noise = np.where(accidents & (noise > 1.5 * robust), robust, noise)
    tests = moments.rows.sum() * len(noise)
    limit = t_isf(OF_EACH_KIND / 2 / tests, moments.repeats - 1)
    limit *= 1.0 if accidents else FAR_OUT_FACTOR
    if not (scatter.furthest > limit * noise).any():
        return []
    # noise of rounding
    noise = np.maximum(noise, 1e-12 * max(moments.mean.max(), -moments.mean.min()))
    ids, worst, pairs = layout.id[layout.enabled], dict[int, RejectedRow](), list[RejectedRow]()
    for some, _, apart in rows.deviations():
        sigmas = np.abs(apart) * np.sqrt(rows.distance_factor[some])[:, None] / noise
        for at in np.flatnonzero(sigmas.max(axis=1) > limit).tolist():
            i, r = int(sigmas[at].argmax()), some.start + at
            group, far = int(rows.group[r]), float(sigmas[at, i])
            row = RejectedRow(int(rows.file[r]), int(rows.row[r]), int(ids[i]), far, "repeats")
            if rows.number[group] == 2:
                pairs.append(row)
            elif group not in worst or worst[group].sigmas < far:
                worst[group] = row
    return sorted([*worst.values(), *pairs], key=lambda row: (row.cycle, row.row))


def _noises(repeats: Repeats) -> tuple[Array, Array]:
    """Return (n,) noise of a reading from all rows, and from the median; both with rounding.

    If most repeats have the same rounding step, those of the next one are not outliers, and a
    median does not measure noise.
    """
    moments = repeats.moments
    scatter, robust = moments.scatter / moments.repeats, _robust(repeats.scatter.samples)
    rounding = moments.rounding
    return np.sqrt(scatter + rounding), np.sqrt(robust**2 + 12 * rounding)


def _robust(samples: Array) -> Array:
    """Return (n,) noise of a reading from the median, which an actuator's spikes do not affect."""
    some = samples[:: max(1, len(samples) // 200)].T  # which give the noise to 8 %
    ordered = np.sort(np.abs(some))  # faster than np.median
    count = ordered.shape[1]
    middle = slice((count - 1) // 2, count // 2 + 1)
    return np.asarray(ordered[:, middle].mean(axis=1) / normal_isf(0.25))  # median of |z|


def refuse_too_many(rejected: int, rows: int) -> None:
    """Refuse a campaign that has lost more rows than accidents explain."""
    if rejected > MAX_REJECTED_FRACTION * rows:
        raise TooManyOutliers(
            f"{rejected} of {rows} rows do not fit their repeats or the balance",
            remedy="look whether SHAPE and SIGN are those that were applied, and at what happened"
            " during the run; or mark the bad rows as not VALID",
        )


MIN_ROWS_OF_NOISE, LARGEST_DEVIATION = 8, 5.0  # of each file; in standard deviations
MIN_STILL_ROWS = 3  # of a file, all of which have the same reading of a sensor


def still_sensors(campaign: Campaign) -> NDArray[np.bool_]:
    """Return which of (files, n) sensors read the same in all rows of a file.

    If all do, none may have been read, which `compare_files` reports.
    """
    still = [
        (cycle.stroke == 0.0)
        & (cycle.position is not None)
        & (np.count_nonzero(cycle.valid) >= MIN_STILL_ROWS)
        for cycle in campaign.cycles
    ]
    return np.array([each & ~each.all() for each in still])


def frozen_sensors(campaign: Campaign) -> Iterator[Finding]:
    """Yield sensors that read the same in all rows of a file."""
    still = still_sensors(campaign)
    for pattern in dict.fromkeys(map(tuple, still.T[still.any(axis=0)].tolist())):
        files = np.array(pattern)
        where, remedy = "POSITION of {} is the same in all rows", ""
        if files.all():
            remedy = "check its electronics: it counts as if it did not move, and its stiffness"
            remedy += " cannot be measured"
        else:
            where += f" of {named_files(campaign, np.flatnonzero(files))}"
        which = (files == still.T).all(axis=1)
        size = float(np.mean(files))
        yield about_actuators(
            campaign.layout, Code.FROZEN_SENSOR, which, where, size=size, remedy=remedy
        )
