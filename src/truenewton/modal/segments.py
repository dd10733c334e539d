"""Stiffness modes of a mirror in several segments: each has its own, side by side."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from truenewton.calibration.result import Calibration
from truenewton.calibration.segmented import SegmentedCalibration
from truenewton.calibration.segments import Seen, of_each, seen_of, sorted_out
from truenewton.errors import CampaignMismatch, Fault, RankDeficient, UnknownName
from truenewton.modal.findings import ModalFindings, find_modes
from truenewton.modal.modal_base import EFFICIENCY
from truenewton.modal.turbulence import Atmosphere, pupil_of
from truenewton.records.campaign import Campaign
from truenewton.records.segmented import SegmentedData
from truenewton.records.stiffness_matrix import StiffnessMatrix


def modes_of_segments(
    data: SegmentedData,
    calibration: SegmentedCalibration | None = None,
    atmosphere: Atmosphere | None = None,
    *,
    diameter: float | None = None,
    radius: float | None = None,
    efficiency: float = EFFICIENCY,
    motion: Seen | None = None,
    off: Sequence[int] = (),
    slaved: Sequence[int] = (),
    force: bool = False,
    processes: int | None = None,
) -> dict[int, ModalFindings | Fault]:
    """Find the modes of each segment, by its number, or why it tells none.

    Parameters
    ----------
    data, calibration, atmosphere, efficiency, motion, off, slaved, force
        As of `find_modes`, of all segments.
    diameter, radius
        Of the entrance pupil, and of all segments together that fill it [m]; see `pupil_of`. Each
        segment fills its part of it, seen from its own middle.
    processes
        As of `calibrate`.

    Raises
    ------
    RankDeficient
        No segment tells its modes.
    CampaignMismatch
        Data and calibration are of two mirrors.
    UnknownName
        An ID that no actuator has.
    """
    apart = "" if calibration is None else calibration.layout.other_actuators(data.layout)
    if apart:
        raise CampaignMismatch(
            f"data and calibration are of two mirrors: {apart}",
            remedy="give both of the same mirror",
        )
    pupil = pupil_of(data.layout, diameter, radius)
    known = set(data.layout.id.tolist())
    for unknown in (name for name in (*off, *slaved) if name not in known):
        raise UnknownName(f"there is no actuator {unknown}", remedy="give IDs of ACTUATORS")

    def solver(number: int) -> Callable[[Campaign | StiffnessMatrix], ModalFindings]:
        if calibration is not None and number in calibration.refused:
            fault, remedy = calibration.refused[number][0]
            raise RankDeficient(fault, remedy=remedy)
        here = np.asarray(data.layout.segment) == number
        of_it = set(data.layout.id[here].tolist())
        alpha: Calibration | None = None if calibration is None else calibration.segment(number)
        floats, follows = (tuple(k for k in names if k in of_it) for names in (off, slaved))
        own = pupil_of(data.layout.part(here)).radius
        return partial(
            find_modes, calibration=alpha, atmosphere=atmosphere, radius=own,
            diameter=pupil.diameter * own / pupil.radius, efficiency=efficiency,
            motion=seen_of(motion, data.layout, number),
            off=floats, slaved=follows, force=force,
        )  # fmt: skip

    answers = list(of_each(data, solver, processes))
    sorted_out(data, answers, "modes")
    return dict(zip(data.numbers, answers, strict=True))
