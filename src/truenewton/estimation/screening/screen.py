"""Outlying rows are left out, and files and readings checked, in one reading of the rows.

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

import numpy as np
from numpy.typing import NDArray

from truenewton.arrays import Array
from truenewton.chance import OF_EACH_KIND, chi2_ppf, normal_isf, t_isf
from truenewton.errors import TooManyOutliers, TrueNewtonError
from truenewton.estimation.findings.code import LIMITS, Code
from truenewton.estimation.findings.estimate import RejectedRow
from truenewton.estimation.findings.finding import Finding, about_actuators
from truenewton.estimation.readings.moments import (
    Moments,
    Noise,
    Structure,
    pooled_where_it_fits,
    reading_noise,
)
from truenewton.estimation.readings.repeats import RepeatSums, RowPrints
from truenewton.estimation.screening.hypotheses import (
    MIN_DIFFERENCE_OF_REPEATING_FILES,
    columns_of_other_rows,
    compare_files,
    copied_files,
    mislabelled_files,
    mislabelled_rows,
    named_files,
    unlike_files,
)
from truenewton.records.campaign import Campaign
from truenewton.rounding import percent

MAX_REJECTED_FRACTION = 0.3  # of the rows; beyond this the campaign is refused
SYSTEMATIC_FRACTION = 0.15  # of the rows of a file: if more are outliers, its labels are checked
LONG_TAIL_RATIO = 1.08  # of scatter to that by the median: beyond, outliers are a tail
GROSS_SCATTER = 0.02  # of repeats relative to the forces: more is not a drift
FAR_OUT_FACTOR = 3.0  # on the usual limit, if outliers are a tail


@dataclass(frozen=True, eq=False)
class ScreenedCampaign:
    """A campaign whose rows were read once, without outliers."""

    campaign: Campaign  # as given
    sound: Campaign  # with the rejected rows marked as not valid
    rejected: tuple[RejectedRow, ...]  # rows that differ from their repeats
    moments: Moments  # of the sound rows; pooled if shapes repeat over loads and signs
    noise: Noise  # of a reading of them
    # parts of (m, n) deviations of some rows from the others of their groups, at weight 1 [N]
    samples: tuple[Array, ...]
    structure: Structure | None  # test of these repeats; None if not possible
    suspects: tuple[Finding, ...] = ()  # files that are not what they claim, frozen readings
    # readings that end at a limit: a fault if the data do not fit
    clipped: tuple[Finding, ...] = ()
    # files that form two groups, as of two mirrors: a fault if nothing balances
    unlike: tuple[Finding, ...] = ()
    # sensors that read the same in all rows; their displacement is 0
    frozen: tuple[Finding, ...] = ()


def screen_campaign(campaign: Campaign) -> ScreenedCampaign:
    """Read a campaign and leave out rows that differ from their repeats.

    FORCE is read once, and blocks with removed rows once more; all of it if the mean of POSITION,
    or two lone repeats, were removed.

    Raises TooManyOutliers if a cycle would lose all its rows.
    """
    sums = RepeatSums(campaign)
    prints = sums.prints
    apart = compare_files(campaign, prints)
    suspects = (
        *apart,
        *copied_files(campaign, prints, in_steps=bool(np.any(sums.step))),
        *mislabelled_files(campaign, sums.moments),
        *columns_of_other_rows(campaign, sums.moments),
        *frozen_readings(campaign, prints),
    )
    clipped = clipped_readings(campaign, prints)
    refusal: TooManyOutliers | None = None
    try:
        sums, sound, rejected = _left_out(sums, campaign, accidents=True)
        refuse_too_many(len(rejected), len(rejected) + int(sums.moments.rows.sum()))
        accidents = not rejected or _tails(sums) <= LONG_TAIL_RATIO
    except TooManyOutliers as error:  # if of one cycle, it differs as a whole
        accidents, refusal = False, error
    if not accidents:
        try:
            sums, sound, rejected = _left_out(RepeatSums(campaign), campaign, accidents=False)
            moments = sums.moments
            gross = moments.noise > GROSS_SCATTER * np.sqrt(np.mean(moments.mean**2))
            if refusal is not None and gross:
                raise refusal
        except TooManyOutliers as error:
            suspects += () if apart else _relabelled(campaign, prints, range(len(campaign)))
            suspects = suspects or louder_with_force(campaign, prints)
            raise with_suspects(error, suspects + clipped) from None
    lost = np.bincount([row.cycle for row in rejected], minlength=len(campaign))
    valid = np.array([cycle.valid.sum() for cycle in campaign.cycles])
    affected = np.flatnonzero(lost > np.maximum(2, SYSTEMATIC_FRACTION * valid)).tolist()
    suspects += () if apart else _relabelled(campaign, prints, affected)
    # Rounding is no normal noise, and files that are not what they claim make noise of their own.
    louder = () if suspects or np.any(sums.step) else louder_with_force(campaign, prints)
    suspects += louder
    moments, frozen = sums.moments, tuple[Finding, ...]()
    moments = replace(moments, by_force=sum(each.size for each in louder))
    noise = reading_noise(sound, moments)
    if (displacement := sums.displacement()) is not None:
        frozen = tuple(frozen_sensors(campaign))
        displacement[:, still_sensors(campaign).any(axis=0)] = 0.0
        moments = replace(moments, displacement=displacement)
    moments, structure = pooled_where_it_fits(moments, noise, sums.samples)
    samples = tuple(sums.samples)
    unlike = (
        ()
        if len(suspects) > len(louder)
        else unlike_files(campaign, prints, MIN_DIFFERENCE_OF_REPEATING_FILES)
    )
    left_out = tuple(rejected)
    return ScreenedCampaign(
        campaign,
        sound,
        left_out,
        moments,
        noise,
        samples,
        structure,
        suspects,
        clipped,
        unlike,
        frozen,
    )


def louder_with_force(campaign: Campaign, prints: RowPrints) -> tuple[Finding, ...]:
    """Return that noise grows with the force, if it does."""
    share = noise_by_force(campaign, prints)
    where = f"{percent(share)} of its variance"
    return (Finding(code=Code.NOISE_BY_FORCE, size=share, where=where),) if share else ()


def noise_by_force(campaign: Campaign, prints: RowPrints) -> float:
    """Return the share of the noise that is in proportion to the force; 0 unless it is significant.

    The deviation of a row from its repeats, without the zero and the gain of each actuator in its
    file, has the variance s^2 (1 + share (c^2 / m - 1)), m the mean of c^2. Large deviations count
    as of five standard deviations, so that accidents do not decide.
    """
    rows, along, square, noise = prints.common_rows.astype(np.float64), 0.0, 0.0, 0.0
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


def _relabelled(campaign: Campaign, prints: RowPrints, files: Sequence[int]) -> tuple[Finding, ...]:
    """Return why rows of some files differ: their labels, or the origin of the files."""
    if not files:
        return ()
    return mislabelled_rows(campaign, files) or unlike_files(campaign, prints)


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


def _left_out(
    sums: RepeatSums, campaign: Campaign, *, accidents: bool
) -> tuple[RepeatSums, Campaign, list[RejectedRow]]:
    """Leave out outliers, as accidents or as a tail."""
    rejected = list[RejectedRow]()
    while worst := _leave_out_worst(sums, accidents=accidents):
        rejected += worst
        campaign = without(campaign, worst)
        if sums.stale:
            del sums  # there is no room for two where the mirror is large
            sums = RepeatSums(campaign)
    return sums, campaign, rejected


def _tails(sums: RepeatSums) -> float:
    """Return the scatter of rows over that by the median; 1 of a normal distribution."""
    moments = sums.moments
    if moments.repeats < 2:
        return 1.0
    noise, robust = _noises(sums)
    return float(np.median(noise / np.maximum(robust, 1e-300)))


def campaign_moments(campaign: Campaign, reference: Array | None = None) -> Moments:
    """Return the moments of all valid rows of a campaign or a part of it.

    ``reference`` is the (n,) zero of displacements [m]: for a part, the `common_reference` of the
    campaign. If it is NaN, a part must contain whole cycles.
    """
    return RepeatSums(campaign, reference).moments


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


def _leave_out_worst(sums: RepeatSums, *, accidents: bool) -> list[RejectedRow]:
    """Leave out the worst outlier of each group; both rows of a pair."""
    moments = sums.moments
    if moments.repeats < 2:
        return []
    noise, robust = _noises(sums)
    # The median is less sure than the scatter: it counts where spikes have swollen that.
    noise = np.where(accidents & (noise > 1.5 * robust), robust, noise)
    tests = moments.rows.sum() * len(noise)
    limit = t_isf(OF_EACH_KIND / 2 / tests, moments.repeats - 1)
    limit *= 1.0 if accidents else FAR_OUT_FACTOR
    suspicious = np.flatnonzero((sums.furthest > limit * noise).any(axis=1))
    if suspicious.size:  # noise of rounding
        noise = np.maximum(noise, 1e-12 * max(moments.mean.max(), -moments.mean.min()))
    return sums.leave_out_worst(suspicious.tolist(), noise, limit)


def _noises(sums: RepeatSums) -> tuple[Array, Array]:
    """Return (n,) noise of a reading from all rows, and from the median; both with rounding.

    If most repeats have the same rounding step, those of the next one are not outliers, and a
    median does not measure noise.
    """
    moments = sums.moments
    scatter, robust = moments.scatter / moments.repeats, _robust(sums.samples)
    rounding = moments.rounding
    return np.sqrt(scatter + rounding), np.sqrt(robust**2 + 12 * rounding)


def _robust(samples: Sequence[Array]) -> Array:
    """Return (n,) noise of a reading from the median, which an actuator's spikes do not affect."""
    stride = max(1, sum(map(len, samples)) // 200)  # which give the noise to 8 %
    some = np.concatenate([sample[::stride] for sample in samples]).T
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
MIN_FROZEN_ROWS = 3  # consecutive, at least
MIN_FROZEN_FRACTION = 0.1  # of the rows of a file, consecutive


def frozen_readings(campaign: Campaign, prints: RowPrints) -> Iterator[Finding]:
    """Yield readings that do not change from shape to shape in a file, while others do.

    Readings that are constant in all files are those of `checks.constant_actuators`.
    """
    whole = [prints.longest[file] == prints.rows[file] - 1 for file in prints.longest]
    constant = np.logical_and.reduce(whole)
    for file, longest in sorted(prints.longest.items()):
        still, share = _stand_still(prints, file), longest / prints.rows[file]
        frozen = np.flatnonzero(still & ~constant)
        if still.all() and not constant.all():
            where, size = f"all actuators in {campaign.cycles[file].name}", float(share.min())
            yield Finding(code=Code.FROZEN_READINGS, where=where, size=size)
        elif frozen.size <= max(1, LIMITS.bad_fraction * still.size):
            for i in frozen.tolist():
                where, size = f"{{}} in {campaign.cycles[file].name}", float(share[i])
                yield about_actuators(campaign.layout, Code.FROZEN_READING, [i], where, size=size)


def _stand_still(prints: RowPrints, file: int) -> NDArray[np.bool_]:
    """Return which (n,) readings of a file are frozen, but not at a limit of several."""
    longest, common = prints.longest[file], _at_common_limit(prints, file)
    at_limit = common & (np.count_nonzero(common) > 1) & (prints.at_limit[file] > longest)
    least = max(MIN_FROZEN_ROWS, MIN_FROZEN_FRACTION * prints.rows[file])
    return np.asarray((longest >= least) & ~at_limit)


def _at_common_limit(prints: RowPrints, file: int) -> NDArray[np.bool_]:
    """Return which (n,) readings of a file reach the largest of all."""
    limit = prints.limit[file]
    return np.asarray(limit == limit.max(initial=0.0))


def clipped_readings(campaign: Campaign, prints: RowPrints) -> tuple[Finding, ...]:
    """Return readings that end at a limit, which several shapes reach to the last bit.

    If the force ends there as well, a limit is no fault: it is one if data do not fit.
    """
    clipped, largest = np.zeros(int(campaign.layout.enabled.sum()), dtype=bool), 0.0
    for file, limit in prints.limit.items():
        count, common = prints.at_limit[file], _at_common_limit(prints, file)
        here = (count >= MIN_FROZEN_ROWS) | (common & (count[common].sum() >= MIN_FROZEN_ROWS))
        here &= (limit > 0.0) & ~_stand_still(prints, file)
        clipped |= here
        largest = max(largest, float(limit[here].max(initial=0.0)))
    if not clipped.any() or _few_valued(prints):
        return ()
    where, size = f"{{}}, at {largest:.4g} N", float(clipped.mean())
    return (about_actuators(campaign.layout, Code.CLIPPED_READINGS, clipped, where, size=size),)


def _few_valued(prints: RowPrints) -> bool:
    """Return whether readings have only few values, as if shapes are commanded in levels."""
    ordered = np.sort(np.abs(prints.of_first), axis=0)
    rest = ordered < ordered[-1:]
    distinct = (np.diff(ordered, axis=0) > 0.0) & rest[1:]
    return bool(np.median(distinct.sum(axis=0) / np.maximum(rest.sum(axis=0), 1)) < 0.5)


def still_sensors(campaign: Campaign) -> NDArray[np.bool_]:
    """Return which of (files, n) sensors read the same in all rows of a file.

    If all do, none may have been read, which `compare_files` reports.
    """
    still = [
        (cycle.stroke == 0.0)
        & (cycle.position is not None)
        & (np.count_nonzero(cycle.valid) >= MIN_FROZEN_ROWS)
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
