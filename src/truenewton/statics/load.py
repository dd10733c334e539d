"""What hangs on the mirror and how it leans, and what a weight may be."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from truenewton.errors import FormatError

LARGEST_FORCE = 1e6  # beyond it a force is a slip of the unit, and squares must stay finite [N]


@dataclass(frozen=True)
class Load:
    """What hangs on the mirror, and how it leans.

    Attributes
    ----------
    name
        'bare', 'ring', ...; case and surrounding blanks do not count.
    added, added_error
        Q and its standard uncertainty [N]; Q is negative, 0 for the bare mirror.
    tool
        Name of the weight; loads with the same tool share one error of their weight.
    tilt, tilt_error
        Angle between optical axis and vertical, and its standard uncertainty [deg].
    """

    name: str
    added: float = 0.0
    added_error: float = 0.0
    tool: str | None = None
    tilt: float = 0.0
    tilt_error: float = 0.0

    @property
    def key(self) -> str:
        """The name as it is compared."""
        return self.name.strip().casefold()


def check_load(load: Load) -> None:
    """Refuse a load that cannot be.

    Raises
    ------
    FormatError
    """
    check_weight("ADDED", load.added)
    if load.added > 0.0:
        raise FormatError(
            f"ADDED is {load.added:g} N",
            remedy="z points up, so an added weight is negative",
            got=load.added,
        )
    check_error("E_ADDED", load.added_error)
    check_error("E_TILT", load.tilt_error)
    if not abs(load.tilt) < 90.0:
        raise FormatError(
            f"TILT is {load.tilt:g} deg",
            remedy="give the angle between axis and vertical, under 90 deg",
        )
    if not load.name.strip():
        raise FormatError("LOAD is blank", remedy="name the load")


def check_weight(name: str, weight: float) -> None:
    """Refuse a weight that is absurd [N]."""
    if not np.isfinite(weight) or abs(weight) > LARGEST_FORCE:
        raise FormatError(f"{name} is {weight:g} N", remedy="give the weight in Newton")


def check_error(name: str, error: float) -> None:
    """Refuse a standard uncertainty that cannot be."""
    if not 0.0 <= error <= LARGEST_FORCE:
        raise FormatError(
            f"{name} is {error:g}",
            remedy="give a standard uncertainty, zero or more, in N or deg",
        )
