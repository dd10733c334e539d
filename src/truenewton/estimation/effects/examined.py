"""What is left of data and their fit after effects were looked for, and how well it fits."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from truenewton.chance import chi2_sf, f_sf
from truenewton.estimation.findings.finding import Finding
from truenewton.estimation.minimum import Minimum
from truenewton.estimation.moments import Moments
from truenewton.estimation.noise import Noise
from truenewton.estimation.problem import Problem
from truenewton.estimation.structure import FITS, Structure


@dataclass(frozen=True, eq=False)
class Examined:
    """What is left after effects were looked for.

    Attributes
    ----------
    problem, moments, minimum
        The data without the effects that were taken out, and their fit.
    told
        How many of their parameters the balance had to tell.
    effects
        Those named, the likeliest first.
    structure
        How well shapes repeat over loads and signs; None where that was not asked.
    correlated
        Whether noise hangs together from row to row, so that shapes may balance too well.
    explained
        Whether what was named but not taken out would make it fit.
    """

    problem: Problem
    moments: Moments
    minimum: Minimum
    told: float = 0.0
    effects: tuple[Finding, ...] = ()
    structure: Structure | None = None
    correlated: bool = False
    explained: bool = False

    @property
    def probability(self) -> float:
        """Chance of a larger chi^2 of the balance."""
        freedom = self.problem.degrees_of_freedom(self.moments) - self.told
        return chi2_probability(self.minimum.chi2, freedom, self.problem.noise)

    @property
    def too_well(self) -> bool:
        """Whether the shapes balance better than their noise lets expect."""
        freedom = self.problem.degrees_of_freedom(self.moments) - self.told
        if freedom <= 0:
            return False
        return chi2_probability(self.minimum.chi2, freedom, self.problem.noise) > 1.0 - FITS

    @property
    def fits(self) -> bool:
        """Whether both the balance and the repetition of shapes fit."""
        repeated = self.structure is None or self.structure.probability > FITS
        return self.probability > FITS and repeated and (self.correlated or not self.too_well)

    @property
    def excess(self) -> float:
        """By how much the variance of what is left is larger than the noise says, if at all."""
        freedom = self.problem.degrees_of_freedom(self.moments) - self.told
        balance = self.minimum.chi2 / max(freedom, 1.0)
        return max(1.0, balance, self.structure.reduced if self.structure else 1.0)


def chi2_probability(chi2: float, freedom: float, noise: Noise) -> float:
    """Return how often chance makes chi^2 as large, the noise being known only so well."""
    if freedom <= 0:
        return 1.0
    if np.isinf(noise.share_freedom):
        return float(chi2_sf(chi2, freedom))
    return float(f_sf(chi2 / freedom, freedom, noise.share_freedom))
