"""What is suspected of not being what it says: files, columns, actuators.

Only the user can settle it: suspects are named, in a refusal too, and never corrected.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace

from truenewton.errors import NotConverged, RankDeficient, TooManyOutliers
from truenewton.estimation.checks.column_order import exchanged_columns, misordered_columns
from truenewton.estimation.checks.dead_actuators import (
    constant_actuators,
    readings_change,
    stuck_faults,
)
from truenewton.estimation.findings.finding import Finding
from truenewton.estimation.paper.identifiability import refuse
from truenewton.estimation.problem import Problem
from truenewton.estimation.readings.moments import Moments
from truenewton.estimation.screening.screen import ScreenedCampaign, naming


@dataclass(frozen=True)
class InputChecks:
    """What is suspected before effects are looked for.

    Attributes
    ----------
    files, actuators
        Files that are not what they say; actuators whose reading does not change.
    order, exchanged
        Columns in another order, by the stiffness that shapes show; by the balance.
    unlike
        Files in two lots, each of which repeats.
    """

    files: tuple[Finding, ...]
    actuators: tuple[Finding, ...]
    order: tuple[Finding, ...]
    exchanged: tuple[Finding, ...] = ()
    unlike: tuple[Finding, ...] = ()

    @property
    def columns(self) -> tuple[Finding, ...]:
        """Columns that stand for other actuators; the balance knows better which."""
        return self.exchanged or self.order

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
        return replace(self, exchanged=exchanged_columns(problem, moments))


def check_inputs(screened: ScreenedCampaign, problem: Problem) -> InputChecks:
    """Return what rows alone make suspect.

    Raises
    ------
    RankDeficient
        A reading is stuck.
    """
    change = readings_change(screened.moments, problem.noise)
    refuse(stuck_faults(screened.campaign, change))
    return InputChecks(
        screened.suspects,
        constant_actuators(screened.campaign, change),
        misordered_columns(screened.campaign, screened.moments),
        unlike=screened.unlike,
    )


@contextmanager
def refusal_naming(suspects: Callable[[], Sequence[Finding]]) -> Iterator[None]:
    """Let a refusal name what is suspected of being its cause."""
    try:
        yield
    except (RankDeficient, TooManyOutliers, NotConverged) as error:
        raise naming(error, suspects()) from None
