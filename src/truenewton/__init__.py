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
    from truenewton.acquisition.plan import CampaignPlan, read_plan
    from truenewton.bench.simulated.bench import SimulatedBench
    from truenewton.bench.simulated.static import run_cycles, static_bench
    from truenewton.calibration.figures import write_figures
    from truenewton.calibration.methods import calibrate
    from truenewton.calibration.result import Calibration
    from truenewton.modal.dissipation import Budget
    from truenewton.modal.file import write_modes
    from truenewton.modal.findings import find_modes
    from truenewton.modal.turbulence import Atmosphere
    from truenewton.reading import read
    from truenewton.recalibration.fit import recalibrate
    from truenewton.records.campaign import Campaign
    from truenewton.records.cycle import Cycle
    from truenewton.records.file import write_campaign, write_cycle, write_stiffness
    from truenewton.records.stiffness_matrix import StiffnessMatrix
    from truenewton.report.change import change
    from truenewton.report.investigate import investigate
    from truenewton.report.page.page import write_report
    from truenewton.statics.layout import Layout, layout, rings, spherical_rings
    from truenewton.statics.load import Load
    from truenewton.tracking.file import read_tracking
    from truenewton.tracking.fit import track
    from truenewton.tracking.law import Tracking

__all__ = [
    "Atmosphere",
    "Budget",
    "Calibration",
    "Campaign",
    "CampaignPlan",
    "Cycle",
    "Layout",
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
    "Calibration": "calibration.result",
    "Campaign": "records.campaign",
    "CampaignPlan": "acquisition.plan",
    "Cycle": "records.cycle",
    "Layout": "statics.layout",
    "Budget": "modal.dissipation",
    "Load": "statics.load",
    "SimulatedBench": "bench.simulated.bench",
    "StiffnessMatrix": "records.stiffness_matrix",
    "Tracking": "tracking.law",
    "acquire": "acquisition.acquire",
    "calibrate": "calibration.methods",
    "change": "report.change",
    "find_modes": "modal.findings",
    "investigate": "report.investigate",
    "layout": "statics.layout",
    "read": "reading",
    "read_plan": "acquisition.plan",
    "read_tracking": "tracking.file",
    "recalibrate": "recalibration.fit",
    "rings": "statics.layout",
    "run_cycles": "bench.simulated.static",
    "spherical_rings": "statics.layout",
    "static_bench": "bench.simulated.static",
    "track": "tracking.fit",
    "write_campaign": "records.file",
    "write_cycle": "records.file",
    "write_figures": "calibration.figures",
    "write_modes": "modal.file",
    "write_report": "report.page.page",
    "write_stiffness": "records.file",
}


def __getattr__(name: str) -> Any:
    if name in _HOMES:
        return getattr(importlib.import_module(f"truenewton.{_HOMES[name]}"), name)
    if name == "__version__":
        from importlib.metadata import version

        return version("truenewton")
    if name in __all__:
        return importlib.import_module(f"truenewton.{name}")
    raise AttributeError(f"module 'truenewton' has no attribute '{name}'")


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
