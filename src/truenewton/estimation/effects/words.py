"""What effects were found, and what is left, in words."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from truenewton.estimation.diagnosis import ErrorKind, ScaleError
from truenewton.estimation.effects.examined import Examined
from truenewton.estimation.findings.catalogue import Code
from truenewton.estimation.findings.finding import Finding
from truenewton.records.campaign import Campaign, load_temperatures
from truenewton.records.fault import Fault

MISFIT = "the model does not fit the data"


def effect_warnings(effects: Iterable[Finding]) -> Iterator[Fault]:
    """Say of each effect what it is, where, and whether it was taken out of the data."""
    for effect in effects:
        done = "taken out of them" if effect.corrected else "not taken out of them"
        yield Fault(f"the data show: {in_words(effect)}, {done}", effect.remedy)


def in_words(effect: Finding) -> str:
    """Return an effect with where it is largest, and its size where that is one of readings."""
    size = ""
    if effect.size and (effect.corrected or effect.unit == "K"):
        per_cent = effect.unit in ("", "1/h")
        value = 100 * effect.size if per_cent else effect.size
        unit = effect.unit.replace("1", "%") or "%" if per_cent else effect.unit
        size = f"{value:.2g} {unit}"
    inside = "; ".join(filter(None, (effect.where, size)))
    return f"{effect.name} ({inside})" if inside else effect.name


def misfit_warnings(left: Examined) -> Iterator[Fault]:
    """Say that the model does not fit, and by how much errors grew for it."""
    if left.fits:
        return
    if left.explained:
        yield Fault(
            f"{MISFIT} but for what was named: E_STAT has how far alpha would move by it",
            "settle what was named (docs/effects.md)",
        )
    elif left.excess > 1.0:
        yield Fault(
            f"{MISFIT}: E_STAT is {np.sqrt(left.excess):.2g} times larger for it",
            "look for what the bench does beside it (docs/effects.md)",
        )
    elif left.too_well and left.structure is not None:
        yield Fault(
            "the shapes balance better than the scatter of their repeats lets expect",
            "look for what differs between files: a label, a drift, zeros that move",
        )


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
