"""Rows that lie far from their repeats, left out; and what one reading of the rows leaves behind.

A row is far whose reading of one actuator lies far from the mean of the others of its group. The
worst row of each group goes first, the scatter is taken anew, until none is left; where only two
rows disagree neither can be trusted and both go. A sound campaign loses a row
once in four hundred.

Where those that are left still scatter more than their median says, rows were no accidents but the
tail of what happened to all, a drift perhaps: then only those go that stand out of that as well.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from truenewton.arrays import Array
from truenewton.chance import OF_EACH_KIND, t_isf
from truenewton.cluster import Client
from truenewton.errors import FormatError, TooManyOutliers, TrueNewtonError
from truenewton.estimation.findings.estimate import RejectedRow
from truenewton.estimation.findings.finding import Finding
from truenewton.estimation.readings.moments import QUARTILE, Moments
from truenewton.estimation.readings.repeats import RepeatSums
from truenewton.estimation.readings.row_readers import RowPrints
from truenewton.estimation.screening.frozen_readings import (
    clipped_readings,
    frozen_readings,
    frozen_sensors,
    still_sensors,
)
from truenewton.estimation.screening.hypotheses import (
    MIN_DIFFERENCE_OF_REPEATING_FILES,
    compare_files,
    copied_files,
    mislabelled_files,
    mislabelled_rows,
    unlike_files,
)
from truenewton.estimation.screening.noise import Structure, pooled_where_it_fits, reading_noise
from truenewton.records.campaign import Campaign

MEDIAN_ROWS = 200  # which tell the noise to 8 per cent
MAX_REJECTED_FRACTION = 0.3  # of the rows; beyond this the campaign is refused
SYSTEMATIC_FRACTION = 0.15  # of the rows of a file: where more lie far, its labels are looked at
LONG_TAIL_RATIO = 1.08  # of scatter over what the median says: beyond, rows are no accidents
GROSS_SCATTER = 0.02  # of the forces: repeats that scatter by more are no drift's doing
FAR_OUT_FACTOR = 3.0  # times the usual limit, where rows are the tail of what happened to all


@dataclass(frozen=True, eq=False)
class ScreenedCampaign:
    """A campaign whose rows were read once, and those that do not belong left out.

    Attributes
    ----------
    campaign, sound
        As it was given; with the rows rejected marked as not valid.
    rejected
        The rows that lie far from their repeats.
    moments
        Of the sound rows; pooled where shapes repeat over loads and signs.
    structure
        How well they do; None where nothing tells.
    suspects
        Files that are not what they say, readings that freeze.
    clipped
        Readings that end at a limit: a fault where the data do not fit.
    unlike
        Files that differ in two lots, as those of two mirrors do: a fault where nothing balances.
    frozen
        Sensors that read the same in all rows, whose displacement counts as 0.
    samples
        (m, n) deviations of some repeated rows from the others of their groups, at weight 1 [N], in
        some parts.
    """

    campaign: Campaign
    sound: Campaign
    rejected: tuple[RejectedRow, ...]
    moments: Moments
    samples: tuple[Array, ...]
    structure: Structure | None
    suspects: tuple[Finding, ...] = ()
    clipped: tuple[Finding, ...] = ()
    unlike: tuple[Finding, ...] = ()
    frozen: tuple[Finding, ...] = ()


def screen_campaign(campaign: Campaign, client: Client | None = None) -> ScreenedCampaign:
    """Read a campaign and leave out rows that lie far from their repeats.

    FORCE is read once, and once more what stands in the same blocks as rows left out; all of it
    where the mean of POSITION, or two lone repeats, went with them. With a client its workers read.

    Raises
    ------
    TooManyOutliers
        A cycle would lose all its rows.
    FormatError
        Rows are in memory, where no worker can read them.
    """
    if client is not None:
        _require_stored(campaign)
    sums = RepeatSums(campaign, client=client)
    prints = sums.prints
    apart = compare_files(campaign, prints)
    suspects = (
        *apart,
        *copied_files(campaign, prints, in_steps=bool(np.any(sums.step))),
        *mislabelled_files(campaign, sums.moments),
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
            sums, sound, rejected = _left_out(
                RepeatSums(campaign, client=client), campaign, accidents=False
            )
            if refusal is not None and _gross(sums):
                raise refusal
        except TooManyOutliers as error:
            suspects += () if apart else _relabelled(campaign, prints, range(len(campaign)))
            raise naming(error, suspects + clipped) from None
    suspects += () if apart else _relabelled(campaign, prints, _hit(campaign, rejected))
    noise = reading_noise(sound, sums.moments)
    moments, frozen = sums.moments, tuple[Finding, ...]()
    if (displacement := sums.displacement()) is not None:
        frozen = tuple(frozen_sensors(campaign))
        displacement[:, still_sensors(campaign).any(axis=0)] = 0.0
        moments = replace(moments, displacement=displacement)
    moments, structure = pooled_where_it_fits(moments, noise, sums.samples)
    samples = tuple(sums.samples)
    unlike = () if suspects else unlike_files(campaign, prints, MIN_DIFFERENCE_OF_REPEATING_FILES)
    left_out = tuple(rejected)
    return ScreenedCampaign(
        campaign, sound, left_out, moments, samples, structure, suspects, clipped, unlike, frozen
    )


def _require_stored(campaign: Campaign) -> None:
    """Refuse a campaign whose rows no worker can read."""
    for cycle in campaign.cycles:
        if isinstance(cycle.force, np.ndarray):
            raise FormatError(
                "its rows are in the memory of this process, where no worker can read them",
                remedy="read the campaign with read(..., client=client) as well",
                path=cycle.name,
            )


def _relabelled(campaign: Campaign, prints: RowPrints, files: Sequence[int]) -> tuple[Finding, ...]:
    """Say why rows of some files lie far from their repeats: their labels, or the files' origin."""
    if not files:
        return ()
    return mislabelled_rows(campaign, files) or unlike_files(campaign, prints)


def _hit(campaign: Campaign, rejected: list[RejectedRow]) -> list[int]:
    """Return the files that lost more rows than accidents take."""
    lost = np.bincount([row.cycle for row in rejected], minlength=len(campaign.cycles))
    rows = [int(cycle.valid.sum()) for cycle in campaign.cycles]
    return np.flatnonzero(lost > np.maximum(2, SYSTEMATIC_FRACTION * np.array(rows))).tolist()


def naming(error: TrueNewtonError, suspects: Sequence[Finding]) -> TrueNewtonError:
    """Return a refusal that names what is suspected of being its cause."""
    if not suspects:
        return error
    what = "; ".join(f"{effect.name}: {effect.where}" for effect in suspects)
    return type(error)(
        f"{what} ({error.fault})",
        remedy=suspects[0].remedy,
        path=error.path,
        got=error.got,
        want=error.want,
    )


def _left_out(
    sums: RepeatSums, campaign: Campaign, *, accidents: bool
) -> tuple[RepeatSums, Campaign, list[RejectedRow]]:
    """Leave out rows that lie far from their repeats, as accidents do or out of long tails."""
    rejected = list[RejectedRow]()
    while worst := _leave_out_worst(sums, accidents=accidents):
        rejected += worst
        campaign = without(campaign, worst)
        if sums.stale:
            client = sums.client
            del sums  # there is no room for two where the mirror is large
            sums = RepeatSums(campaign, client=client)
    return sums, campaign, rejected


def _tails(sums: RepeatSums) -> float:
    """Return how much more rows scatter than their median says; 1 of a normal distribution."""
    moments = sums.moments
    if moments.repeats < 2:
        return 1.0
    noise, robust = _noises(sums)
    return float(np.median(noise / np.maximum(robust, 1e-300)))


def _gross(sums: RepeatSums) -> bool:
    """Tell whether rows scatter as no drift makes them: by some per cent of their forces."""
    moments = sums.moments
    return bool(moments.noise > GROSS_SCATTER * np.sqrt(np.mean(moments.mean**2)))


def campaign_moments(campaign: Campaign, reference: Array | None = None) -> Moments:
    """Return the moments of all rows of a campaign that count, whatever they hold.

    Parameters
    ----------
    campaign
        The campaign, or a part of it.
    reference
        (n,) readings from which displacements count [m]: of a part the `common_reference` of the
        whole campaign. Where it is NaN, a part must hold whole cycles.
    """
    return RepeatSums(campaign, reference).moments


def without(campaign: Campaign, rows: list[RejectedRow]) -> Campaign:
    """Return the campaign with some rows marked as not valid.

    Raises
    ------
    TooManyOutliers
        A cycle would lose all its rows.
    """
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
                got=1.0,
                want=MAX_REJECTED_FRACTION,
            )
        cycles[k] = replace(cycles[k], valid=valid)
    return Campaign(tuple(cycles))


def _leave_out_worst(sums: RepeatSums, *, accidents: bool) -> list[RejectedRow]:
    """Leave out the worst row of each group that has one too far out; both rows of a pair."""
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
    """Return (n,) noise of a reading from all rows, and from the median; rounding in both.

    Where repeats tend to one step, those of the next one are no accidents, and a median is none of
    noise but of steps.
    """
    moments = sums.moments
    scatter, robust = moments.scatter / moments.repeats, _robust(sums.samples)
    rounding = moments.rounding
    return np.sqrt(scatter + rounding), np.sqrt(robust**2 + 12 * rounding)


def _robust(samples: Sequence[Array]) -> Array:
    """Return (n,) noise of a reading that an actuator's spikes cannot swell: from the median."""
    stride = max(1, sum(map(len, samples)) // MEDIAN_ROWS)
    some = np.concatenate([sample[::stride] for sample in samples]).T
    ordered = np.sort(np.abs(some))  # faster than np.median
    count = ordered.shape[1]
    middle = slice((count - 1) // 2, count // 2 + 1)
    return np.asarray(ordered[:, middle].mean(axis=1) / QUARTILE)


def refuse_too_many(rejected: int, rows: int) -> None:
    """Refuse a campaign that has lost more rows than can be explained by accidents."""
    if rejected > MAX_REJECTED_FRACTION * rows:
        raise TooManyOutliers(
            f"{rejected} of {rows} rows do not fit their repeats or the balance",
            remedy="look whether SHAPE and SIGN are those that were applied, and at what happened"
            " during the run; or mark the bad rows as not VALID",
            got=rejected / rows,
            want=MAX_REJECTED_FRACTION,
        )
