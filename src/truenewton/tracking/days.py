"""The calibrations that are tracked: read, split by temperature, checked, put in order of time."""

from __future__ import annotations

import datetime
import os
from collections.abc import Iterable, Sequence
from dataclasses import replace
from itertools import combinations
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from truenewton.arrays import Array
from truenewton.calibration.methods import calibrate
from truenewton.calibration.result import Calibration
from truenewton.calibration.verdict import refuse_unusable
from truenewton.errors import CampaignMismatch, FormatError, RankDeficient, TrueNewtonError, located
from truenewton.estimation.findings.estimate import Scale
from truenewton.reading import Read, read
from truenewton.records.campaign import Campaign, mean_temperature, refuse_other_mirror
from truenewton.records.stiffness_matrix import StiffnessMatrix


class Named(NamedTuple):
    """Calibrations or cycles to be tracked, and the name of their file or folder."""

    name: str
    data: Read


Given = Calibration | Campaign | Named | str | os.PathLike[str]
ONE_MIRROR = "track one mirror at a time"
SAME_TEMPERATURE = 1.0  # [K]; cycles that differ by more are calibrated separately
# Typical change of alpha beyond its error, of another unit: 50 K make 0.3 % between actuators.
OTHER_UNIT = 0.03
YEAR = datetime.timedelta(days=365.25)


class DatedCalibration(NamedTuple):
    """A calibration, and the name of its file or folder."""

    name: str
    calibration: Calibration

    @property
    def date(self) -> datetime.datetime:
        """The middle of its data, where its alpha holds."""
        c = self.calibration
        return c.date + (c.date_end - c.date) / 2


def named(item: Given, segment: int | None = None) -> Named:
    """Return the data with a name; read them, or one segment of them, if a path is given."""
    if isinstance(item, Named):
        return item
    if isinstance(item, str | os.PathLike):
        return Named(os.fspath(item), read(item, segment=segment))
    cycles = item.cycles if isinstance(item, Campaign) else (item,)
    return Named(f"{item.instrument} of {min(one.date for one in cycles):%Y-%m-%d}", item)


def gather_days(
    given: Iterable[Named], *, accept_rejected: bool = False
) -> tuple[DatedCalibration, ...]:
    """Return the calibrations in order of time; cycles are calibrated first.

    Raises an error if calibrations do not belong together, or are rejected (`accept_rejected`).
    """
    days = sorted(
        (day for item in given for day in _dated(*item)),
        key=lambda day: (day.date, day.calibration.temperature),
    )
    for day in days:
        _refuse_unfit(day)
        refuse_unusable(day.calibration, accept_rejected=accept_rejected, path=day.name)
    for earlier, day in combinations(days, 2):
        _refuse_other_mirror(earlier, day)
    without = [day for day in days if not np.isfinite(day.calibration.temperature)]
    if without and len(without) < len(days):
        raise FormatError(
            "has no temperature, and others do",
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
        )
    return tuple(days)


def _dated(name: str, data: Read) -> list[DatedCalibration]:
    if isinstance(data, StiffnessMatrix):
        raise FormatError(
            "is a stiffness file", remedy="give calibrations, or campaigns", path=name
        )
    if isinstance(data, Calibration):
        return [DatedCalibration(name, data)]
    parts = _by_temperature(data)
    days = []
    for mean, part in parts:
        named = f"{name} at {mean:.1f} deg C" if len(parts) > 1 else name
        try:
            days.append(DatedCalibration(named, calibrate(part)))
        except TrueNewtonError as error:
            raise located(error, named) from None
    return days


def _by_temperature(campaign: Campaign) -> list[tuple[float, Campaign]]:
    """Split a campaign whose cycles differ by more than 1 K; each part has its mean temperature."""
    means = np.array([mean_temperature([cycle]) for cycle in campaign.cycles])
    if not np.ptp(means) > SAME_TEMPERATURE:  # or unknown
        return [(float(np.mean(means)), campaign)]
    parts: list[list[int]] = []
    for k in np.argsort(means, kind="stable").tolist():
        if not parts or means[k] - means[parts[-1][0]] > SAME_TEMPERATURE:
            parts.append([])
        parts[-1].append(k)
    return [
        (float(np.mean(means[ks])), replace(campaign, cycles=tuple(campaign.cycles[k] for k in ks)))
        for ks in parts
    ]


def _refuse_unfit(day: DatedCalibration) -> None:
    c, on = day.calibration, day.calibration.layout.enabled
    for unfit, fault, remedy in (
        (c.scale == Scale.MEAN_ONE,
         "gives alpha relative to its mean, without what is common to all",
         "give calibrations whose scale comes from weights"),
        (c.scale == Scale.GIVEN or "recalibrated" in c.method,
         "contains an earlier calibration, which would count twice",
         "give the campaigns themselves, or full calibrations"),
        (not np.isfinite(c.covariance[np.ix_(on, on)]).all(),
         "COVARIANCE contains no numbers", "calibrate again"),
    ):  # fmt: skip
        if unfit:
            raise FormatError(fault, remedy=remedy, path=day.name)


def _refuse_other_mirror(one: DatedCalibration, other: DatedCalibration) -> None:
    a, b = one.calibration, other.calibration
    refuse_other_mirror(b, a, one.name, other.name, ONE_MIRROR)
    files = [{source.sha256 for source in c.sources} for c in (a, b)]
    if all(files) and (files[0] <= files[1] or files[1] <= files[0]):
        raise CampaignMismatch(
            f"rests on the same files as {one.name}",
            remedy="give each measurement once",
            path=other.name,
        )


def covariances(calibration: Calibration, on: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Return statistical and systematic (m, m) covariance of alpha of the m actuators ``on``."""
    at = np.ix_(on, on)
    systematic_covariance = calibration.systematic_covariance[at]
    return calibration.covariance[at] - systematic_covariance, systematic_covariance


def weight_groups(days: Sequence[DatedCalibration]) -> list[list[int]]:
    """Group the indices of days with the same weights and declared errors: they share one error."""
    groups: list[list[int]] = []
    for day_index, day in enumerate(days):
        for group in groups:
            if all(_same_weights(days[k].calibration, day.calibration) for k in group):
                group.append(day_index)
                break
        else:
            groups.append([day_index])
    return groups


def _same_weights(a: Calibration, b: Calibration) -> bool:
    def weights(c: Calibration) -> tuple[float, float, list[tuple[float, float, float]]]:
        return c.weight, c.weight_error, sorted((q.added, q.added_error, q.tilt) for q in c.loads)

    tools = [{load.tool for load in c.loads if load.tool} for c in (a, b)]
    return weights(a) == weights(b) and (not all(tools) or tools[0] == tools[1])
