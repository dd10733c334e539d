"""The added weight and the tilt of the mirror, and the limits of weights."""

from __future__ import annotations

from dataclasses import dataclass

from truenewton.arrays import in_units
from truenewton.errors import FormatError

LEAST_NOISE = 1e-15  # a standard deviation below is none; its inverse square stays finite [N]
LARGEST_FORCE = 1e6  # beyond it a force is a slip of the unit, and squares must stay finite [N]
SMALLEST_FORCE = 1e-9  # and the least that the largest one may be: squares stay above zero [N]
UNITS = {"added": "N", "added_error": "N", "tilt": "deg", "tilt_error": "deg"}


@dataclass(frozen=True)
class Load:
    """The added weight and the tilt of the mirror; Quantities are converted.

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

    Examples
    --------
    >>> tn.Load("ring", added=-0.289, added_error=0.005, tool="ring A").added
    -0.289
    """

    name: str
    added: float = 0.0
    added_error: float = 0.0
    tool: str | None = None
    tilt: float = 0.0
    tilt_error: float = 0.0

    def __post_init__(self) -> None:
        in_units(self, UNITS)

    @property
    def key(self) -> str:
        """The name as it is compared."""
        return self.name.strip().casefold()


def check_load(load: Load) -> None:
    """Refuse an invalid load.

    Raises
    ------
    FormatError
    """
    check_weight("ADDED", load.added)
    downward = f"z points up, so an added weight is negative: store {-abs(load.added):g}"
    check_number("ADDED", load.added, load.added <= 0.0, downward, " N")
    check_error("E_ADDED", load.added_error)
    check_error("E_TILT", load.tilt_error)
    upright = "give the angle between axis and vertical, under 90 deg"
    check_number("TILT", load.tilt, abs(load.tilt) < 90.0, upright, " deg")
    if not load.name.strip():
        raise FormatError("LOAD is blank", remedy="name the load")


def check_weight(name: str, weight: float) -> None:
    """Refuse a weight beyond `LARGEST_FORCE` [N]."""
    check_number(name, weight, abs(weight) <= LARGEST_FORCE, "give the weight in Newton", " N")


def check_error(name: str, error: float) -> None:
    """Refuse an invalid standard uncertainty."""
    remedy = "give a standard uncertainty, zero or more, in N or deg"
    check_number(name, error, 0.0 <= error <= LARGEST_FORCE, remedy)


def check_number(name: str, value: float, sound: bool, remedy: str, unit: str = "") -> None:
    """Refuse an invalid number of a keyword."""
    if not sound:
        raise FormatError(f"{name} is {value:g}{unit}", remedy=remedy, got=value)
