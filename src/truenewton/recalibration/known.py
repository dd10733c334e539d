"""What an earlier calibration knows, and what of its errors a new run shares."""

from __future__ import annotations

import os
from dataclasses import dataclass

import numpy as np

from truenewton.arrays import Array
from truenewton.calibration.result import Calibration
from truenewton.errors import CampaignMismatch, FormatError
from truenewton.estimation.weights import WeightError, weight_errors
from truenewton.files.fits import read_fits
from truenewton.linalg import factor_of
from truenewton.reading import read
from truenewton.records.campaign import Campaign
from truenewton.records.source import Source
from truenewton.statics.layout import Layout
from truenewton.statics.load import Load
from truenewton.tracking.days import SAME_TEMPERATURE
from truenewton.tracking.file import tracking_from
from truenewton.tracking.law import Tracking

EARLIER = "earlier calibration"
MAGNETS = -1.1e-3  # [1/K] of NdFeB, the law of a mirror that nobody tracked [lit]


@dataclass(frozen=True, eq=False)
class EarlierCalibration:
    """Alpha as it was, its errors told apart.

    Attributes
    ----------
    name, instrument, layout
        The file; the mirror.
    alpha, covariance
        (n,) and (n, n); errors of the weights left out but for ``uneven``.
    scale
        Relative standard uncertainty that all actuators share from the weights.
    uneven
        (n, m) relative change of alpha by errors of the weights beside the common scale.
    temperature
        At which alpha holds [deg C]; NaN if unknown.
    loads, sources
        Under which it was found, and from which files.
    """

    name: str
    instrument: str
    layout: Layout
    alpha: Array
    covariance: Array
    scale: float
    uneven: Array
    temperature: float
    loads: tuple[Load, ...]
    sources: tuple[Source, ...]


def known_from(
    given: Calibration | Tracking | str | os.PathLike[str], campaign: Campaign
) -> EarlierCalibration:
    """Return what is known of the mirror of a campaign.

    Parameters
    ----------
    given
        A calibration, or the law that tracking found, taken at the temperature and date of the
        campaign; or a path to either.
    campaign
        The new run.

    Raises
    ------
    UnreadableFile, FormatError, CampaignMismatch, RankDeficient
    """
    name = "the earlier calibration"
    loads: tuple[Load, ...] = ()
    sources: tuple[Source, ...] = ()
    if not isinstance(given, Calibration | Tracking):
        name = os.fspath(given)
        file = read_fits(given)
        given = tracking_from(file) if "TRACKING" in file.extensions else _calibration(name)
    if given.instrument != campaign.instrument or not given.layout.same_as(
        campaign.layout, enabled=False
    ):
        raise CampaignMismatch(
            f"is of {given.instrument}, the run of {campaign.instrument}"
            if given.instrument != campaign.instrument
            else "has other actuators than the run",
            remedy="give the calibration of the same mirror",
            path=name,
        )
    n = given.layout.n
    if isinstance(given, Tracking):
        temperature = run_temperature(campaign)
        date = campaign.cycles[0].date
        told = temperature if np.isfinite(temperature) else None
        at = given.alpha_at(told, date)
        alpha, whole, systematic_covariance = at.alpha, at.covariance, at.systematic_covariance
        temperature = temperature if told is not None else given.temperature
    else:
        if given.scale == "mean 1":
            raise FormatError(
                "gives alpha relative to its mean, so it carries no scale",
                remedy="give a calibration whose scale comes from weights",
                path=name,
            )
        alpha, temperature = given.alpha, given.temperature
        whole, systematic_covariance = given.covariance[:n, :n], given.systematic_covariance[:n, :n]
        loads, sources = given.loads, given.sources
    on = np.isfinite(alpha)
    scale, uneven = _told_apart(alpha[on], systematic_covariance[np.ix_(on, on)])
    full = np.full((n, uneven.shape[1]), np.nan)
    full[on] = uneven
    rest = alpha[:, None] * full
    return EarlierCalibration(
        name=name,
        instrument=given.instrument,
        layout=given.layout,
        alpha=alpha,
        covariance=whole - systematic_covariance + rest @ rest.T,
        scale=scale,
        uneven=full,
        temperature=temperature,
        loads=loads,
        sources=sources,
    )


def _calibration(name: str) -> Calibration:
    data = read(name)
    if not isinstance(data, Calibration):
        raise FormatError(
            "is no calibration", remedy="give --known the calibration from before", path=name
        )
    return data


def run_temperature(campaign: Campaign) -> float:
    """Return the mean temperature of the rows that count [deg C]; NaN where none is recorded."""
    held = [c.temperature[c.valid] for c in campaign.cycles if c.temperature is not None]
    return float(np.concatenate(held).mean()) if held else float("nan")


def _told_apart(alpha: Array, systematic_covariance: Array) -> tuple[float, Array]:
    """Return the relative error that all share, and the rest as (n, m) relative changes."""
    factor = factor_of(systematic_covariance / np.outer(alpha, alpha))
    mean = factor.mean(axis=0)
    scale = float(np.linalg.norm(mean))
    if scale == 0.0:
        return 0.0, factor
    turn = np.linalg.qr(np.column_stack([mean / scale, np.eye(len(mean))]))[0]
    turned = factor @ (turn * np.sign(mean @ turn[:, 0]))
    turned[:, 0] -= scale
    kept = np.abs(turned).max(axis=0) > 1e-6 * scale
    return scale, np.asarray(turned[:, kept])


def shared_errors(
    known: EarlierCalibration, campaign: Campaign
) -> tuple[tuple[WeightError, ...], float]:
    """Return the errors of the weights of a run, seen by who takes the earlier scale for true.

    With alpha, B and the torques all divided by 1 + s e, s e being the error of the earlier scale,
    the balance holds for weights W / (1 + s e): a change of -s W. Where one and the same tool made
    the earlier scale it also weighs in the run, and the two changes together leave only what B
    takes up. The first of the sources is the earlier scale.
    """
    weights = campaign.effective_weights
    sources = list(weight_errors(campaign))
    tool = _shared_tool(known, campaign)
    scale, change = known.scale, -known.scale * weights
    if tool is not None:
        # Alpha is in proportion to the added weight, which is negative.
        place = next(k for k, source in enumerate(sources) if tool in source.source)
        scale, change = -scale, sources.pop(place).change - change
    first = WeightError(EARLIER, change)
    away = run_temperature(campaign) - known.temperature
    if abs(away) > SAME_TEMPERATURE:
        # All alphas have changed alike; the earlier scale holds at the earlier temperature.
        sources.append(WeightError("temperature since then", MAGNETS * away * weights))
    return (first, *sources), scale


def _shared_tool(known: EarlierCalibration, campaign: Campaign) -> str | None:
    """Return how the run's one source of error is named that made the earlier scale, if any did."""
    made = [load for load in known.loads if load.added_error > 0]
    if len(made) != 1 or any(load.tilt for load in known.loads):
        return None
    for load in campaign.loads:
        alike = (load.added, load.added_error) == (made[0].added, made[0].added_error)
        if alike and load.added_error > 0 and made[0].tool in (None, load.tool):
            return f"'{load.tool or load.name}'"
    return None
