"""Capacitive sensors: from the distance of the glass to counts, and back to a displacement.

    distance = d0 / (v ADC / codes - c)            reading = gap - distance, along +z (plate above)

True displacement = gain x reading, but for an offset of each sensor.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from truenewton.arrays import Array

GAIN_SCATTER = 0.004  # relative, after calibration: 0.25-0.5 % [derived], 2 % before
OFFSET_SCATTER = 0.5e-6  # of what a sensor reads on the flat mirror [m, guess]


@dataclass(frozen=True, eq=False)
class Sensors:
    """The sensors of a mirror as they truly are, and the law that the electronics apply.

    Attributes
    ----------
    gain
        (n,) true displacement / reading.
    offset
        (n,) reading of the flat mirror [m].
    gap
        Distance of the flat mirror [m]; 68 um on P45 [paper].
    noise
        Standard deviation of one sample [m]; 3 nm [paper].
    d0, c, v, codes
        Of the law: d0 about 65 um, c 0.1364, v 2, 16 bit [conf]; one count is 2.2 nm at 68 um.
    """

    gain: Array
    offset: Array
    gap: float
    noise: float = 3e-9
    d0: float = 65e-6
    c: float = 0.1364
    v: float = 2.0
    codes: int = 65536


def draw_sensors(n: int, gap: float, random: np.random.Generator) -> Sensors:
    """Draw the gains and offsets of n calibrated sensors at a nominal gap [m]."""
    return Sensors(
        gain=random.normal(1.0, GAIN_SCATTER, n),
        offset=random.normal(0.0, OFFSET_SCATTER, n),
        gap=gap,
    )


def counts(sensors: Sensors, displacement: Array, noise: Array | float = 0.0) -> Array:
    """Return the (n, batch) counts of the ADC, whole numbers, of true displacements along +z [m].

    Noise is (n, batch) of unit standard deviation. Counts are infinite where the gap is closed;
    those beyond codes - 1 an ADC does not have: see `out_of_range`.
    """
    distance = (sensors.gap - sensors.offset)[:, None] - displacement / sensors.gain[:, None]
    distance = distance + sensors.noise * noise
    with np.errstate(divide="ignore"):
        inverse = np.where(distance > 0, sensors.d0 / distance, np.inf)
    return np.asarray(np.rint((inverse + sensors.c) * (sensors.codes / sensors.v)))


def out_of_range(sensors: Sensors, counted: Array) -> Array:
    """Return which (n, batch) counts the ADC does not have: the glass is too near, or touches."""
    return np.asarray(~(counted <= sensors.codes - 1))


def reading(sensors: Sensors, counted: Array) -> Array:
    """Return the displacement along +z [m] that the electronics make of (n, batch) counts."""
    distance = sensors.d0 / (counted * (sensors.v / sensors.codes) - sensors.c)
    return np.asarray(sensors.gap - distance)
