"""Where the errors come from: the weights (E_SYST) and the readings (E_STAT)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from truenewton.actuators import Array
from truenewton.campaign import Campaign


@dataclass(frozen=True, eq=False)
class WeightError:
    """One independent source of error of the weights.

    Attributes
    ----------
    source
        E_WEIGHT, E_ADDED of a tool, or E_TILT of a load, in words.
    change
        (L,) change of W of each load by one standard uncertainty [N].
    """

    source: str
    change: Array


def weight_errors(campaign: Campaign) -> tuple[WeightError, ...]:
    """Return the independent sources of error of W = (P + Q) cos(tilt) (docs/files.md).

    The error of P is common to all loads; loads with the same TOOL share one error of their added
    weight, each in proportion to its own; every other error is independent.
    """
    loads = campaign.loads
    cosine = np.cos(np.radians([load.tilt for load in loads]))
    sine = np.sin(np.radians([load.tilt for load in loads]))
    sources = [WeightError("weight of the mirror", campaign.weight_error * cosine)]
    tools = {load.tool or f"'{load.name}'": load.tool for load in loads if load.added_error > 0}
    for name, tool in tools.items():
        shared = [(load.tool or f"'{load.name}'") == name for load in loads]
        change = np.where(shared, [load.added_error for load in loads], 0.0) * cosine
        words = f"weight of {tool}" if tool else f"added weight of load {name}"
        sources.append(WeightError(words, change))
    for place, load in enumerate(loads):
        if load.tilt_error > 0:
            change = np.zeros(len(loads))
            total = campaign.weight + load.added
            change[place] = -total * sine[place] * np.radians(load.tilt_error)
            sources.append(WeightError(f"tilt of load '{load.name}'", change))
    return tuple(source for source in sources if np.any(source.change))
