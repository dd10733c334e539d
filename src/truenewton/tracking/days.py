"""The calibrations that are tracked: gathered, split by temperature, checked, put in order."""

from __future__ import annotations

import datetime
import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from truenewton.arrays import Array
from truenewton.calibration.methods import calibrate
from truenewton.calibration.result import Calibration
from truenewton.errors import CampaignMismatch, FormatError, RankDeficient, TrueNewtonError, located
from truenewton.linalg import factor_of
from truenewton.reading import read
from truenewton.records.campaign import Campaign
from truenewton.records.cycle import Cycle
from truenewton.records.stiffness_matrix import StiffnessMatrix

Given = Calibration | Campaign | str | os.PathLike[str]
SAME_TEMPERATURE = 1.0  # [K]; cycles of a campaign farther apart are calibrated apart
YEAR = datetime.timedelta(days=365.25)


@dataclass(frozen=True, eq=False)
class Day:
    """One calibration as tracking sees it.

    Attributes
    ----------
    name
        Of its file or folder.
    calibration
        As it was read or made.
    """

    name: str
    calibration: Calibration

    @property
    def date(self) -> datetime.datetime:
        """The middle of its data."""
        c = self.calibration
        return c.date + (c.date_end - c.date) / 2


def gathered(given: Iterable[Given]) -> tuple[Day, ...]:
    """Read and calibrate what is given; return the days in the order of time.

    Raises
    ------
    UnreadableFile, FormatError, CampaignMismatch, RankDeficient
        Files that cannot be tracked, or not together.
    """
    days = sorted(
        (day for item in given for day in _days_of(item)),
        key=lambda day: (day.date, day.calibration.temperature),
    )
    for day in days:
        _refuse_unfit(day)
    for place, day in enumerate(days):
        for other in days[:place]:
            _refuse_strangers(other, day)
    without = [day for day in days if not np.isfinite(day.calibration.temperature)]
    if without and len(without) < len(days):
        raise FormatError(
            "holds no temperature, though others do",
            remedy="leave it out, or record TEMPERATURE",
            path=without[0].name,
        )
    if len(days) < 2:
        raise RankDeficient(
            "there is one calibration, of one day and one temperature"
            if days
            else "there is no calibration",
            remedy="add one of another day or temperature",
            path=days[0].name if days else None,
            got=len(days),
            want=2,
        )
    return tuple(days)


def _days_of(item: Given) -> list[Day]:
    if isinstance(item, Campaign | Calibration):
        start = item.date if isinstance(item, Calibration) else item.cycles[0].date
        name, data = f"{item.instrument} of {start:%Y-%m-%d}", item
    else:
        name, read_data = os.fspath(item), read(item)
        if isinstance(read_data, StiffnessMatrix):
            raise FormatError(
                "is a stiffness file", remedy="give calibrations, or campaigns", path=name
            )
        data = read_data
    if isinstance(data, Calibration):
        return [Day(name, data)]
    parts = _by_temperature(data)
    names = [name if len(parts) == 1 else f"{name} at {t:.1f} deg C" for t, _ in parts]
    return [_calibrated(n, part) for n, (_, part) in zip(names, parts, strict=True)]


def _calibrated(name: str, campaign: Campaign) -> Day:
    try:
        return Day(name, calibrate(campaign))
    except TrueNewtonError as error:
        raise located(error, name) from None


def _by_temperature(campaign: Campaign) -> list[tuple[float, Campaign]]:
    """Split a campaign whose cycles differ by more than 1 K into parts that do not."""
    means = [_temperature(cycle) for cycle in campaign.cycles]
    if not (np.isfinite(means).all() and np.ptp(means) > SAME_TEMPERATURE):
        return [(float(np.mean(means)), campaign)]
    parts: list[list[tuple[float, Cycle]]] = []
    for mean, cycle in sorted(zip(means, campaign.cycles, strict=True), key=lambda pair: pair[0]):
        if not parts or mean - parts[-1][0][0] > SAME_TEMPERATURE:
            parts.append([])
        parts[-1].append((mean, cycle))
    return [
        (float(np.mean([t for t, _ in part])), replace(campaign, cycles=tuple(c for _, c in part)))
        for part in parts
    ]


def _temperature(cycle: Cycle) -> float:
    """Return the mean temperature of the rows that count; NaN where there is none."""
    if cycle.temperature is None:
        return float("nan")
    return float(cycle.temperature[cycle.valid].mean())


def _refuse_unfit(day: Day) -> None:
    c = day.calibration
    if c.scale == "mean 1":
        raise FormatError(
            "gives alpha relative to its mean, in which what is common to all is lost",
            remedy="give calibrations whose scale comes from weights",
            path=day.name,
        )
    if c.scale == "given" or "recalibrated" in c.method:
        raise FormatError(
            "was made with an earlier calibration, which it holds over again",
            remedy="give the campaigns themselves, or full calibrations",
            path=day.name,
        )
    if not np.isfinite(c.covariance[np.ix_(*[np.flatnonzero(c.layout.enabled)] * 2)]).all():
        raise FormatError("COVARIANCE holds no numbers", remedy="calibrate again", path=day.name)


def _refuse_strangers(one: Day, other: Day) -> None:
    a, b = one.calibration, other.calibration
    if a.instrument != b.instrument:
        raise CampaignMismatch(
            f"is of {b.instrument}, {one.name} of {a.instrument}",
            remedy="track one mirror at a time",
            path=other.name,
            got=b.instrument,
            want=a.instrument,
        )
    if not a.layout.same_as(b.layout, enabled=False):
        raise CampaignMismatch(
            f"has other actuators than {one.name}",
            remedy="track one mirror at a time",
            path=other.name,
        )
    files = [{source.sha256 for source in c.sources} for c in (a, b)]
    if all(files) and (files[0] <= files[1] or files[1] <= files[0]):
        raise CampaignMismatch(
            f"rests on the same files as {one.name}",
            remedy="give each measurement once",
            path=other.name,
        )


def tracked_actuators(days: Sequence[Day]) -> NDArray[np.bool_]:
    """Return (n,) true for the actuators that every calibration gives."""
    return np.asarray(np.all([day.calibration.layout.enabled for day in days], axis=0))


def covariances(day: Day, on: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Return the (n, n) covariance of alpha from the readings, and the part from the weights."""
    c, at = day.calibration, np.flatnonzero(on)
    whole, systematic_covariance = (
        matrix[np.ix_(at, at)] for matrix in (c.covariance, c.systematic_covariance)
    )
    return whole - systematic_covariance, systematic_covariance


def groups(days: Sequence[Day]) -> list[list[int]]:
    """Put together the days whose weights and declared errors agree: they share one error."""
    found: list[list[int]] = []
    for place, day in enumerate(days):
        for group in found:
            if all(_same_weights(days[k].calibration, day.calibration) for k in group):
                group.append(place)
                break
        else:
            found.append([place])
    return found


def _same_weights(a: Calibration, b: Calibration) -> bool:
    def key(c: Calibration) -> list[tuple[float, float, float]]:
        return sorted((load.added, load.added_error, load.tilt) for load in c.loads)

    def tools(c: Calibration) -> set[str]:
        return {load.tool for load in c.loads if load.tool}

    named = not (tools(a) and tools(b)) or tools(a) == tools(b)
    return (a.weight, a.weight_error, key(a)) == (b.weight, b.weight_error, key(b)) and named


def relative_factor(days: Sequence[Day], on: NDArray[np.bool_]) -> Array:
    """Return (n, m) relative change of alpha by each shared error of the weights: a mean of days.

    Taken relative, it does not carry the noise of the single days, and a common factor cancels
    from every temperature coefficient.
    """
    parts = []
    for day in days:
        alpha = day.calibration.alpha[on]
        parts.append(covariances(day, on)[1] / np.outer(alpha, alpha))
    return factor_of(np.mean(parts, axis=0))
