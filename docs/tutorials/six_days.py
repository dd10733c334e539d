"""Campaigns of a simulated P45 on six days within half a year."""

import dataclasses
import datetime

import numpy as np
from numpy.typing import NDArray

import truenewton as tn

random = np.random.default_rng(4)
bench = tn.static_bench(tn.mirrors.p45(), seed=4, force_noise=1e-9)
k = random.normal(-1.1e-3, 2e-4, 45)
k[16] = -2.2e-3
NOISE = 2e-4  # N


def campaign(
    factor: NDArray[np.float64],
    temperature: float,
    days: float,
    loads: tuple[str, ...] = ("bare", "ring"),
    cycles: int = 2,
) -> list[tn.Cycle]:
    """Return cycles of a day on which each coil gives its force times factor."""
    return [
        dataclasses.replace(
            cycle,
            date=cycle.date + datetime.timedelta(days=days),
            force=cycle.force / factor + NOISE * random.standard_normal(cycle.force.shape),
            force_error=NOISE,
            temperature=np.full(len(cycle.time), temperature),
        )
        for cycle in tn.run_cycles(bench, cycles)
        if cycle.load.name in loads
    ]


for month, temperature in enumerate([12.0, 19.2, 14.4, 24.0, 16.8, 21.6]):
    factor = 1 + k * (temperature - 18.0) - 0.002 * month / 12
    tn.write_campaign(campaign(factor, temperature, 30 * month), f"month-{month}")
