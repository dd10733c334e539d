"""How many true Newtons an actuator gives for one commanded, from nothing but statics.

After Ricci, Riccardi and Zanotti, "Calibration of force actuators on an adaptive secondary
prototype", Applied Optics 47 (2008). Start with ``truenewton demo``, or::

    import truenewton as tn

    campaign = tn.read("p45-2026-11/")
    calibration = tn.calibrate(campaign)
    calibration.write("alpha.fits")
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from truenewton import errors, mirrors
    from truenewton.acquisition.acquire import acquire
    from truenewton.actuators import Layout, layout, rings, spherical_rings
    from truenewton.bench.simulated.simulated_bench import SimulatedBench
    from truenewton.bench.simulated.static import run_cycles, static_bench
    from truenewton.calibration import Calibration
    from truenewton.campaign import Campaign
    from truenewton.campaign_files import write_campaign, write_cycle, write_stiffness
    from truenewton.campaign_plan import CampaignPlan, read_plan
    from truenewton.estimators import calibrate
    from truenewton.figures import write_figures
    from truenewton.load import Load
    from truenewton.measurements import Cycle, StiffnessMatrix
    from truenewton.modal.dissipation import Limits
    from truenewton.modal.findings import find_modes
    from truenewton.modal.modes_files import write_modes
    from truenewton.modal.turbulence import Atmosphere
    from truenewton.reading import read
    from truenewton.report.change import change
    from truenewton.report.findings import investigate
    from truenewton.report.page import write_report
    from truenewton.tracking import Tracking, read_tracking, recalibrate, track

__version__ = "0.1.0"

__all__ = [
    "Atmosphere",
    "Calibration",
    "Campaign",
    "CampaignPlan",
    "Cycle",
    "Layout",
    "Limits",
    "Load",
    "SimulatedBench",
    "StiffnessMatrix",
    "Tracking",
    "acquire",
    "calibrate",
    "change",
    "errors",
    "find_modes",
    "investigate",
    "layout",
    "mirrors",
    "read",
    "read_plan",
    "read_tracking",
    "recalibrate",
    "rings",
    "run_cycles",
    "spherical_rings",
    "static_bench",
    "track",
    "write_campaign",
    "write_cycle",
    "write_figures",
    "write_modes",
    "write_report",
    "write_stiffness",
]

# Imported on first use: the command line answers --help without numpy.
_HOMES = {
    "Atmosphere": "modal.turbulence",
    "Calibration": "calibration",
    "Campaign": "campaign",
    "CampaignPlan": "campaign_plan",
    "Cycle": "measurements",
    "Layout": "actuators",
    "Limits": "modal.dissipation",
    "Load": "load",
    "SimulatedBench": "bench.simulated.simulated_bench",
    "StiffnessMatrix": "measurements",
    "acquire": "acquisition.acquire",
    "Tracking": "tracking",
    "calibrate": "estimators",
    "change": "report.change",
    "find_modes": "modal.findings",
    "investigate": "report.findings",
    "layout": "actuators",
    "read": "reading",
    "read_plan": "campaign_plan",
    "read_tracking": "tracking",
    "recalibrate": "tracking",
    "rings": "actuators",
    "run_cycles": "bench.simulated.static",
    "spherical_rings": "actuators",
    "static_bench": "bench.simulated.static",
    "track": "tracking",
    "write_campaign": "campaign_files",
    "write_cycle": "campaign_files",
    "write_figures": "figures",
    "write_modes": "modal.modes_files",
    "write_report": "report.page",
    "write_stiffness": "campaign_files",
}


def __getattr__(name: str) -> Any:
    if name in _HOMES:
        return getattr(importlib.import_module(f"truenewton.{_HOMES[name]}"), name)
    if name in __all__:
        return importlib.import_module(f"truenewton.{name}")
    raise AttributeError(f"module 'truenewton' has no attribute '{name}'")


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
