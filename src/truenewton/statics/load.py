"""The added weight and the tilt of the mirror, and the limits of weights."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from truenewton.arrays import Array
from truenewton.errors import FormatError
from truenewton.quantities import Quantity, check_quantities, convert_quantities

LEAST_NOISE = 1e-15  # a standard deviation below is none; its inverse square stays finite [N]
LARGEST_FORCE = 1e6  # beyond it a force is a slip of the unit, and squares must stay finite [N]
SMALLEST_FORCE = 1e-9  # and the least that the largest one may be: squares stay above zero [N]
GRAVITY = 9.80665  # standard acceleration, for weights that are given as masses [m/s^2]
STEEPEST = math.nextafter(90.0, 0.0)  # tilt [deg]
MIN_LEAN = 5.0  # beyond any error of levelling a bench [deg]
LARGEST_COIL_SHIFT = 1e-3  # more than any gap: a slip of the unit [m]
LIKELY_COIL_SHIFT = 5e-6  # of a mirror that leans [m, guess]
# COILGRAD [1/m] and BIASGRAD [N/m] if they are not declared: of P36 and the LBT secondaries [conf].
TYPICAL_GRADIENTS = 600.0, 31.0


def weight_quantity(name: str, highest: float) -> Quantity:
    """Return what the weight of a part is, by its keyword [N]; zero or less."""
    kind = "an added weight" if name == "ADDED" else "a weight"
    why = f"z points up, so {kind} in N is negative; a mass is positive with its unit, as '45 g'"
    return Quantity("N", -LARGEST_FORCE, highest, why, f"{name} is {{:g}} N", -GRAVITY)


def error_quantity(name: str, unit: str) -> Quantity:
    """Return what the standard uncertainty of a weight or angle is, by its keyword."""
    why = f"give a standard uncertainty, zero or more, in {unit}"
    of_mass = GRAVITY if unit == "N" else 0.0
    return Quantity(unit, 0.0, LARGEST_FORCE, why, f"{name} is {{:g}}", of_mass)


# Q and P with their standard uncertainties [N], of a mirror or a segment of one.
ADDED_WEIGHT = {
    "added": weight_quantity("ADDED", 0.0),
    "added_error": error_quantity("E_ADDED", "N"),
}
MIRROR_WEIGHT = {
    "weight": weight_quantity("WEIGHT", -LEAST_NOISE),
    "weight_error": error_quantity("E_WEIGHT", "N"),
}


@dataclass(frozen=True)
class Load:
    """The added weight and the tilt of the mirror; Quantities are converted.

    A mass, as ``45 * u.g``, becomes a weight at standard gravity, 9.80665 m/s2.

    Attributes
    ----------
    name
        'bare', 'ring', ...; case and surrounding blanks are ignored.
    added, added_error
        Q and its standard uncertainty [N]; Q is negative, 0 for the bare mirror.
    tool
        Name of the weight; loads with the same tool have a common error of their weight.
    tilt, tilt_error
        Angle between optical axis and vertical, and its standard uncertainty [deg].
    coil_shift, coil_shift_error
        Displacement of the coils along +z relative to the reference plate of the sensors, as the
        mirror leans, and its standard uncertainty [m]; None if they are not known.

    Raises
    ------
    FormatError
        A number is out of its range, such as a positive added weight, or its unit does not convert.
        The added weight is a mass, and its error has no unit.

    Examples
    --------
    >>> tn.Load("ring", added=-0.289, added_error=0.005, tool="ring A").added
    -0.289
    """

    QUANTITIES: ClassVar = {
        **ADDED_WEIGHT,
        "tilt": Quantity(
            "deg", -STEEPEST, STEEPEST,
            "give the angle between axis and vertical, under 90 deg", "TILT is {:g} deg",
        ),
        "tilt_error": error_quantity("E_TILT", "deg"),
        "coil_shift": Quantity(
            "m", -LARGEST_COIL_SHIFT, LARGEST_COIL_SHIFT,
            "give it in metres: 5e-6 is 5 um", "COILZ is {:g} m",
        ),
        "coil_shift_error": error_quantity("E_COILZ", "m"),
    }  # fmt: skip

    name: str
    added: float = 0.0
    added_error: float = 0.0
    tool: str | None = None
    tilt: float = 0.0
    tilt_error: float = 0.0
    coil_shift: float | None = None
    coil_shift_error: float | None = None

    def __post_init__(self) -> None:
        try:
            convert_quantities(self)
            check_quantities(self)
        except FormatError as error:
            raise error.changed(fault=f"load '{self.name}': {error.fault}") from None

    @cached_property
    def key(self) -> str:
        """The name as it is compared."""
        return self.name.strip().casefold()


def leaning(loads: Sequence[Load]) -> NDArray[np.bool_]:
    """Return under which of (L,) loads the mirror leans more than under the others."""
    tilt = np.abs([load.tilt for load in loads])
    return np.asarray(tilt > tilt.min() + MIN_LEAN)


def change_by_coil_shift(
    held: Array, nz: float, coil_gradient: float | None, bias_gradient: float | None
) -> Array:
    """Return (L,) the change of W equivalent to coils that are displaced along +z [N/m].

    Displaced by d, coils give 1 - COILGRAD d times their force, and each bias force changes by
    -BIASGRAD d. The balance A alpha c (1 - COILGRAD d) + W + B - BIASGRAD d sum(nz) is that of a
    weight W + d (COILGRAD (W + B) - BIASGRAD sum(nz)).

    Parameters
    ----------
    held
        (L,) W + B [N].
    nz
        Sum over the actuators.
    coil_gradient, bias_gradient
        COILGRAD and BIASGRAD; `TYPICAL_GRADIENTS` if one is unknown.
    """
    if not coil_gradient or bias_gradient is None:
        coil_gradient, bias_gradient = TYPICAL_GRADIENTS
    return np.asarray(coil_gradient * held - bias_gradient * nz)


def check_load(load: Load) -> None:
    """Raise FormatError for a load without a name."""
    if not load.name.strip():
        raise FormatError("LOAD is blank", remedy="name the load")
