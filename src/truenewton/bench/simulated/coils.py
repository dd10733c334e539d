"""Coils and magnets: from what the DAC is told to what pushes the glass.

Of one actuator, with z its displacement along +z and T the temperature:

    true force = alpha c (1 + k_T (T - 20 degC)) (1 + COILGRAD z)        bias = b + BIASGRAD z
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from truenewton.arrays import Array

REFERENCE_TEMPERATURE = 20.0  # at which alpha holds [degC]


@dataclass(frozen=True, eq=False)
class Coils:
    """The actuators of a mirror as they truly are.

    Attributes
    ----------
    alpha
        (n,) true Newton / commanded Newton at 20 degC, mirror flat; 0.70 to 1.10 on P45 [paper].
        The scatter of 1.2 % of the force per ampere [conf] is part of it.
    bias_gradient
        BIASGRAD, change of one bias force per displacement along +z [N/m]; plate above, so that
        -31 N/m of gap [conf] is +31.
    coil_gradient
        COILGRAD, relative change of one coil's force per displacement along +z [1/m]; plate above,
        so that -0.6 % for 10 um of gap [conf] is +600.
    magnet_coefficient
        Relative change of force with temperature [1/K]; NdFeB -0.11 %/K [lit].
    dac_step
        Of the commanded force [N]; 41.6 uN, 16 bit [conf].
    saturation
        Largest commanded force, either sign [N]; 0.8 N [conf].
    driver_noise
        Standard deviation of one sample of the force that the drivers add, in commanded Newtons
        [N]; 30 uN [guess].
    temperature
        Of magnets and coils [deg C], one or (batch,).
    """

    alpha: Array
    bias_gradient: float = 31.0
    coil_gradient: float = 600.0
    magnet_coefficient: float = -1.1e-3
    dac_step: float = 41.6e-6
    saturation: float = 0.8
    driver_noise: float = 30e-6
    temperature: float | Array = REFERENCE_TEMPERATURE


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
    """Return the (n, batch) commanded forces [N] as the DAC is told: whole steps, clipped."""
    most = np.floor(coils.saturation / coils.dac_step)
    return np.asarray(coils.dac_step * np.clip(np.rint(force / coils.dac_step), -most, most))
