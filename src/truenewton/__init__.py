"""How many true Newtons an actuator gives for one commanded, from nothing but statics.

After Ricci, Riccardi and Zanotti, "Calibration of force actuators on an adaptive secondary
prototype", Applied Optics 47 (2008). Start with ``truenewton demo``, or::

    import truenewton as tn

    campaign = tn.read("p45-2026-11/")
    calibration = tn.calibrate(campaign)
    calibration.write("alpha.fits")

docs/method.md lists the equations of the paper with their place in the code, and the packages.
"""

from __future__ import annotations

import importlib
from typing import Any

__version__ = "0.1.0"  # here, since to ask what is installed takes a fifth of `--version`

# The stub names the home of each public name, for type checkers and for the import on first use:
# the command line answers --help without numpy.
_LINES = __loader__.get_data(f"{__file__}i").decode().splitlines()
_HOMES = {line.split()[3]: line.split()[1] for line in _LINES if line.startswith("from ")}
__all__ = list(_HOMES)


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'truenewton' has no attribute '{name}'")
    if _HOMES[name] == __name__:
        return importlib.import_module(f"truenewton.{name}")
    return getattr(importlib.import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
