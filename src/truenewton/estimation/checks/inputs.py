"""What is suspected of not being what it says: files, columns, actuators.

Only the user can settle it: suspects are named, in a refusal too, and never corrected.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from truenewton.arrays import Array
from truenewton.chance import FALSE_ALARM, f_isf, normal_sf
from truenewton.errors import Fault, NotConverged, RankDeficient, TooManyOutliers
from truenewton.estimation.checks.column_order import exchanged_columns, misordered_columns
from truenewton.estimation.findings.catalogue import ENTRIES
from truenewton.estimation.findings.code import Code
from truenewton.estimation.findings.estimate import NoiseSource
from truenewton.estimation.findings.finding import Finding, about_actuators
from truenewton.estimation.paper.identifiability import refuse
from truenewton.estimation.problem import Problem
from truenewton.estimation.readings.moments import Moments
from truenewton.estimation.screening.noise import Noise
from truenewton.estimation.screening.screen import ScreenedCampaign, naming
from truenewton.linalg import ROWS_AT_ONCE
from truenewton.records.campaign import Campaign
from truenewton.rounding import named

MIN_VARIANCE_RATIO = 100.0  # times its noise the variance of a typical reading over shapes is
MIN_RELATIVE_CHANGE = 0.03  # of a typical change, where nothing tells the noise
STUCK_CHANGE = 1e-9  # of a typical reading: it does not change at all
MAX_ALPHA_SIGMAS = 3.0  # from 0
MAX_DEAD_FRACTION = 0.03  # of the actuators
WELL_KNOWN_ERROR = 0.1  # error of an alpha in terms of the typical one


@dataclass(frozen=True)
class InputChecks:
    """What is suspected before effects are looked for.

    Attributes
    ----------
    files, actuators
        Files that are not what they say; actuators whose reading does not change.
    columns
        Columns that stand for other actuators: by the balance, else by the stiffness of shapes.
    unlike
        Files in two lots, each of which repeats.
    """

    files: tuple[Finding, ...]
    actuators: tuple[Finding, ...]
    columns: tuple[Finding, ...]
    unlike: tuple[Finding, ...] = ()

    @property
    def named(self) -> tuple[Finding, ...]:
        """All of them."""
        return (*self.files, *self.actuators, *self.columns)

    def where_nothing_balances(self, problem: Problem, moments: Moments) -> InputChecks:
        """Return these, with files in two lots, or columns that would balance exchanged.

        A dead actuator explains all.
        """
        if self.actuators:
            return self
        if self.unlike:
            return replace(self, files=self.files + self.unlike, unlike=())
        return replace(self, columns=exchanged_columns(problem, moments) or self.columns)


def check_inputs(screened: ScreenedCampaign, problem: Problem) -> InputChecks:
    """Return what rows alone make suspect.

    Raises
    ------
    RankDeficient
        A reading is stuck.
    """
    campaign, moments = screened.campaign, screened.moments
    actuators = constant_actuators(campaign, moments, problem.noise)
    columns = misordered_columns(campaign, moments)
    return InputChecks(screened.suspects, actuators, columns, screened.unlike)


@contextmanager
def refusal_naming(suspects: Callable[[], Sequence[Finding]]) -> Iterator[None]:
    """Let a refusal name what is suspected of being its cause."""
    try:
        yield
    except (RankDeficient, TooManyOutliers, NotConverged) as error:
        raise naming(error, suspects()) from None


def constant_actuators(campaign: Campaign, moments: Moments, noise: Noise) -> tuple[Finding, ...]:
    """Name actuators whose reading does not change from shape to shape by more than noise.

    Raises
    ------
    RankDeficient
        One does not change at all: no alpha of it can be had, nor the common scale, since whatever
        force it exerts, and it may be any, could carry the load.
    """
    weight, mean, n = moments.weight, moments.mean, moments.mean.shape[1]
    share = (moments.of_load * weight[:, None]).T
    total = share.sum(axis=1)
    centre = share @ mean / np.where(total > 0.0, total, 1.0)[:, None]
    square, statics, loads = np.zeros(n), np.abs(centre).max(axis=0), np.count_nonzero(total)
    for start in range(0, len(mean), ROWS_AT_ONCE):
        some = slice(start, start + ROWS_AT_ONCE)
        square += weight[some] @ (mean[some] - centre[moments.labels[some, 0]]) ** 2
    freedom, change = moments.groups - loads, np.sqrt(square / weight.sum())
    if freedom < 1:
        return ()
    _refuse_stuck(campaign, change <= STUCK_CHANGE * np.sqrt(np.mean(change**2 + statics**2)))
    if noise.source == NoiseSource.MINIMUM:
        constant = change < MIN_RELATIVE_CHANGE * np.median(change)
    else:
        ratio = square / freedom / noise.variance
        limit = float(f_isf(FALSE_ALARM / n, freedom, moments.repeats or 1e9))
        constant = (ratio <= limit) & (np.median(ratio) > MIN_VARIANCE_RATIO * limit)
    at_zero = statics < 5.0 * change * np.sqrt(loads / moments.groups)
    found = []
    for i in np.flatnonzero(constant):
        code, size = Code.DEAD_NO_FORCE if at_zero[i] else Code.STUCK_READING, float(change[i])
        found.append(about_actuators(campaign.layout, code, [i], size=size, unit="N"))
    return tuple(found)


def _refuse_stuck(campaign: Campaign, stuck: NDArray[np.bool_]) -> None:
    """Refuse readings that do not change at all, given (n,) which."""
    ids = campaign.layout.id[campaign.layout.enabled][stuck].tolist()
    if stuck.all():
        fault = "FORCE is the same for all shapes"
        remedy = "record the forces commanded for each shape, once the mirror has settled"
        refuse([Fault(fault, remedy)])
    if ids:
        fault = f"the reading of {named('actuator', ids, len(ids))} is stuck: it is the same for"
        refuse([Fault(f"{fault} all shapes", ENTRIES[Code.STUCK_READING].remedy)])


def strange_alphas(campaign: Campaign, alpha: Array, error: Array) -> tuple[Finding, ...]:
    """Name actuators whose alpha is 0 or negative while that of the others is not.

    Parameters
    ----------
    campaign
        The actuators.
    alpha, error
        (n,) of the enabled ones, and E_STAT.
    """
    typical = float(np.median(alpha))
    known = error < WELL_KNOWN_ERROR * typical
    dead = known & (np.abs(alpha) < MAX_ALPHA_SIGMAS * error)
    negative = known & (alpha <= -MAX_ALPHA_SIGMAS * error)
    many = max(2, MAX_DEAD_FRACTION * alpha.size)
    if np.count_nonzero(dead | negative) > many:  # the model is wrong, not they
        return ()
    return tuple(
        about_actuators(
            campaign.layout,
            code,
            [i],
            probability=float(normal_sf((typical - alpha[i]) / error[i])),
            size=float(alpha[i]),
        )
        for which, code in ((dead, Code.DEAD_ALPHA_ZERO), (negative, Code.NEGATIVE_ALPHA))
        for i in np.flatnonzero(which)
    )
