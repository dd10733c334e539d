"""The electronics of each actuator: its sensor, what runs in between, and its coil.

Sensors are capacitive. They turn the distance of the glass into counts, and these into a
displacement:

    distance = d0 / (v ADC / codes - c)            reading = gap - distance, along +z (plate above)

True displacement = gain x reading, but for an offset of each sensor.

The control of an actuator sees its own sensor (y, a displacement along +z) and the command of the
whole mirror (z_c, its shape; K_c, the feed-forward):

    c = r_f(t) K_c z_c + k_p L(r_p(t) z_c - y) - k_d D y

r_p and r_f are the ramps of position and force; L = g (1 + s/w) / (1 + s g/w) is the
pseudo-integrator, of gain g far below w and 1 above; D = s / (1 + s/p)^2 the derivative. Poles are
mapped to samples exactly (z = exp(s period)); the derivative is a backward difference.

The DAC passes c on in whole steps. With z the displacement along +z and T the temperature:

    true force = alpha c (1 + k_T (T - 20 degC)) (1 + COILGRAD z)        bias = b + BIASGRAD z
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from truenewton.arrays import Array

SAMPLES = 2048  # of a reading [conf]
GAIN_SCATTER = 0.004  # relative, after calibration: 0.25-0.5 % [derived], 2 % before
OFFSET_SCATTER = 0.5e-6  # of what a sensor reads on the flat mirror [m, guess]
REFERENCE_TEMPERATURE = 20.0  # at which alpha holds [degC]


@dataclass(frozen=True, eq=False)
class Sensors:
    """The sensors of a mirror as they truly are, and the law that the electronics apply.

    The constants of the law are those of 16 bit [conf]; one count is 2.2 nm at 68 um.
    """

    gain: Array  # (n,) true displacement / reading
    offset: Array  # (n,) reading of the flat mirror [m]
    gap: float  # distance of the flat mirror [m]; 68 um on P45 [paper]
    noise: float = 3e-9  # standard deviation of one sample [m]; [paper]
    d0: float = 65e-6  # [m], about
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


@dataclass(frozen=True, eq=False)
class Control:
    """What runs in the electronics. Numbers are [conf] unless they are [guess]."""

    feed_forward: Array  # (n, n) K_c, commanded force per measured displacement [N/m]
    proportional: float = 0.13e6  # k_p, commanded force per displacement [N/m]
    derivative: float = 30.0  # k_d [N s/m]; of the measured displacement alone [guess]
    derivative_pole: float = 15e3  # both [Hz]
    # Of the pseudo-integrator: g and w / 2 pi [Hz]. That its gain is back at 1 above w, its pole so
    # at w / g = 2 Hz, is how we read that [guess].
    slow_gain: float = 5.0
    slow_corner: float = 10.0
    position_ramp: float = 0.1e-3  # [s], half a cosine wave [guess]
    force_ramp: float = 0.75e-3  # likewise
    rate: float = 71.6e3  # samples a second
    delay: int = 1  # whole samples between a reading and the force that answers it [guess]

    @property
    def period(self) -> float:
        """Between samples [s]."""
        return 1 / self.rate

    @property
    def swift(self) -> float:
        """How much of a step each derivative pole follows in one sample."""
        return float(1 - np.exp(-2 * np.pi * self.derivative_pole / self.rate))

    @property
    def slow(self) -> float:
        """The same of the pseudo-integrator's pole, w / g."""
        return float(1 - np.exp(-2 * np.pi * self.slow_corner / self.slow_gain / self.rate))


def ramp(time: float, duration: float) -> float:
    """Return how much of a step has been commanded: half a cosine wave from 0 to 1."""
    return float(0.5 - 0.5 * np.cos(np.pi * min(time / duration, 1.0)))


@dataclass(frozen=True, eq=False)
class Coils:
    """The actuators of a mirror as they truly are."""

    # (n,) true Newton / commanded Newton at 20 degC, mirror flat; 0.70 to 1.10 on P45 [paper]. The
    # scatter of 1.2 % of the force per ampere [conf] is part of it.
    alpha: Array
    # BIASGRAD, change of one bias force per displacement along +z [N/m]; plate above, so that
    # -31 N/m of gap [conf] is +31.
    bias_gradient: float = 31.0
    # COILGRAD, relative change of one coil's force per displacement along +z [1/m]; plate above, so
    # that -0.6 % for 10 um of gap [conf] is +600.
    coil_gradient: float = 600.0
    magnet_coefficient: float = -1.1e-3  # relative change of force [1/K]; NdFeB [lit]
    dac_step: float = 41.6e-6  # of the commanded force [N]; 16 bit [conf]
    saturation: float = 0.8  # largest commanded force, either sign [N]; [conf]
    # Standard deviation of one sample of the force that the drivers add, in commanded Newtons [N].
    driver_noise: float = 30e-6  # [guess]
    temperature: float | Array = REFERENCE_TEMPERATURE  # of magnets and coils [deg C], or (batch,)


def gain(coils: Coils) -> Array:
    """Return (n, batch) true Newton / commanded Newton, mirror flat; batch 1 at one temperature."""
    warmer = np.atleast_1d(coils.temperature) - REFERENCE_TEMPERATURE
    return np.asarray(coils.alpha[:, None] * (1 + coils.magnet_coefficient * warmer))


def true_force(coils: Coils, force: Array, displacement: Array) -> Array:
    """Return the coils' (n, batch) force on the glass [N]; the bias magnets not included.

    Of (n, batch) commanded forces that stand at the coils [N] and displacements along +z [m].
    """
    return np.asarray(gain(coils) * force * (1 + coils.coil_gradient * displacement))


def saturated(coils: Coils, force: Array) -> Array:
    """Return which (n, batch) commanded forces are more than the coils can give."""
    return np.asarray(~(np.abs(force) <= coils.saturation))  # not a number: as bad as too much


def dac(coils: Coils, force: Array) -> Array:
    """Return the (n, batch) commanded forces [N] that the DAC takes: whole steps, clipped."""
    most = np.floor(coils.saturation / coils.dac_step)
    return np.asarray(coils.dac_step * np.clip(np.rint(force / coils.dac_step), -most, most))
