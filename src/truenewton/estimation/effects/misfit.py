"""What is left after effects were looked for, and what differs between loads."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from truenewton.estimation.diagnosis import ErrorKind, ScaleError
from truenewton.estimation.effects.examined import Examined
from truenewton.estimation.findings.code import Code
from truenewton.estimation.findings.finding import Finding
from truenewton.records.campaign import Campaign, load_temperatures


def misfit_findings(left: Examined) -> Iterator[Finding]:
    """Yield that the model does not fit, and by how much errors grew for it."""
    if left.fits:
        return
    if left.explained:
        yield Finding.of(Code.MISFIT_EXPLAINED)
    elif left.excess > 1.0:
        yield Finding.of(Code.MISFIT, factor=float(np.sqrt(left.excess)))
    elif left.too_well and left.structure is not None:
        yield Finding.of(Code.FIT_TOO_GOOD)


def warmer_loads(campaign: Campaign, scale_errors: Iterable[ScaleError]) -> Iterator[Finding]:
    """Name a temperature that differs between loads by more than the readings leave open."""
    relative = {line.source.kind: line.relative for line in scale_errors}
    if relative.get(ErrorKind.BETWEEN_LOADS, 0.0) <= relative.get(ErrorKind.READINGS, np.inf):
        return
    yield Finding(
        code=Code.TEMPERATURE_BETWEEN_LOADS,
        size=float(np.ptp(load_temperatures(campaign))),
        unit="K",
        remedy="keep the temperature, or take bare and loaded cycles in turn; if it was kept, check"
        " TEMPERATURE and its unit",
    )
