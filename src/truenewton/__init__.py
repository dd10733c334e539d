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
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"  # here, since to ask what is installed takes a fifth of `--version`

if TYPE_CHECKING:  # `as` tells type checkers that a name is meant for others
    from truenewton import errors as errors
    from truenewton import mirrors as mirrors
    from truenewton.acquisition.acquire import acquire as acquire
    from truenewton.acquisition.plan import CampaignPlan as CampaignPlan
    from truenewton.acquisition.plan import MirrorLimits as MirrorLimits
    from truenewton.acquisition.plan import PlannedShapes as PlannedShapes
    from truenewton.acquisition.plan import read_plan as read_plan
    from truenewton.bench.opticalib import OpticalibMirror as OpticalibMirror
    from truenewton.bench.protocol import Reading as Reading
    from truenewton.bench.protocol import Shape as Shape
    from truenewton.bench.protocol import Status as Status
    from truenewton.bench.simulated.bench import SimulatedBench as SimulatedBench
    from truenewton.bench.simulated.static import run_cycles as run_cycles
    from truenewton.bench.simulated.static import static_bench as static_bench
    from truenewton.bench.simulated.truth import Truth as Truth
    from truenewton.bench.simulated.truth import read_truth as read_truth
    from truenewton.calibration.figures import write_figures as write_figures
    from truenewton.calibration.methods import calibrate as calibrate
    from truenewton.calibration.result import Calibration as Calibration
    from truenewton.cli.json_schema import json_schema as json_schema
    from truenewton.comparison.calibrations import Change as Change
    from truenewton.comparison.compare import compare as compare
    from truenewton.comparison.result import Comparison as Comparison
    from truenewton.comparison.result import read_comparison as read_comparison
    from truenewton.estimation.findings.code import Code as Code
    from truenewton.estimation.findings.code import Level as Level
    from truenewton.estimation.findings.finding import Finding as Finding
    from truenewton.estimation.findings.finding import Verdict as Verdict
    from truenewton.importers.export import export_matrix as export_matrix
    from truenewton.importers.importing import stiffness_from as stiffness_from
    from truenewton.mirrors.sensor_model import sensor_model as sensor_model
    from truenewton.modal.bases import karhunen_loeve_modes as karhunen_loeve_modes
    from truenewton.modal.bases import zernike_modes as zernike_modes
    from truenewton.modal.file import write_modes as write_modes
    from truenewton.modal.findings import ModalFindings as ModalFindings
    from truenewton.modal.findings import find_modes as find_modes
    from truenewton.modal.measured_stiffness import measured_stiffness as measured_stiffness
    from truenewton.modal.modal_base import Budget as Budget
    from truenewton.modal.true_stiffness import true_stiffness as true_stiffness
    from truenewton.modal.turbulence import Atmosphere as Atmosphere
    from truenewton.modal.turbulence import wavefront_covariance as wavefront_covariance
    from truenewton.planning.plan_prediction import predict_plan as predict_plan
    from truenewton.reading import read as read
    from truenewton.reading import read_calibration as read_calibration
    from truenewton.reading import read_campaign as read_campaign
    from truenewton.reading import read_stiffness as read_stiffness
    from truenewton.recalibration.fit import recalibrate as recalibrate
    from truenewton.records.campaign import Campaign as Campaign
    from truenewton.records.cycle import Cycle as Cycle
    from truenewton.records.cycle import Segment as Segment
    from truenewton.records.file import write_campaign as write_campaign
    from truenewton.records.file import write_cycle as write_cycle
    from truenewton.records.file import write_stiffness as write_stiffness
    from truenewton.records.stiffness_matrix import StiffnessMatrix as StiffnessMatrix
    from truenewton.report.findings import investigate as investigate
    from truenewton.report.page.page import write_report as write_report
    from truenewton.statics.layout import Layout as Layout
    from truenewton.statics.layout import layout as layout
    from truenewton.statics.layout import rings as rings
    from truenewton.statics.layout import spherical_rings as spherical_rings
    from truenewton.statics.load import Load as Load
    from truenewton.tracking.fit import track as track
    from truenewton.tracking.law import Tracking as Tracking
    from truenewton.tracking.law import Validity as Validity
    from truenewton.tracking.law import read_tracking as read_tracking
    from truenewton.tracking.law import validity_of as validity_of

# Imported on first use: the command line answers --help without numpy.
_NAMES = {
    "acquisition.acquire": ["acquire"],
    "acquisition.plan": [
        "CampaignPlan",
        "MirrorLimits",
        "PlannedShapes",
        "read_plan",
    ],
    "bench.opticalib": ["OpticalibMirror"],
    "bench.protocol": ["Reading", "Shape", "Status"],
    "bench.simulated.bench": ["SimulatedBench"],
    "bench.simulated.static": ["run_cycles", "static_bench"],
    "bench.simulated.truth": ["Truth", "read_truth"],
    "calibration.figures": ["write_figures"],
    "calibration.methods": ["calibrate"],
    "calibration.result": ["Calibration"],
    "cli.json_schema": ["json_schema"],
    "comparison.calibrations": ["Change"],
    "comparison.compare": ["compare"],
    "comparison.result": ["Comparison", "read_comparison"],
    "estimation.findings.code": ["Code", "Level"],
    "estimation.findings.finding": ["Finding", "Verdict"],
    "importers.export": ["export_matrix"],
    "importers.importing": ["stiffness_from"],
    "mirrors.sensor_model": ["sensor_model"],
    "modal.bases": ["karhunen_loeve_modes", "zernike_modes"],
    "modal.modal_base": ["Budget"],
    "modal.file": ["write_modes"],
    "modal.findings": ["ModalFindings", "find_modes"],
    "modal.measured_stiffness": ["measured_stiffness"],
    "modal.true_stiffness": ["true_stiffness"],
    "modal.turbulence": ["Atmosphere", "wavefront_covariance"],
    "planning.plan_prediction": ["predict_plan"],
    "reading": ["read", "read_calibration", "read_campaign", "read_stiffness"],
    "recalibration.fit": ["recalibrate"],
    "records.campaign": ["Campaign"],
    "records.cycle": ["Cycle", "Segment"],
    "records.file": ["write_campaign", "write_cycle", "write_stiffness"],
    "records.stiffness_matrix": ["StiffnessMatrix"],
    "report.findings": ["investigate"],
    "report.page.page": ["write_report"],
    "statics.layout": ["Layout", "layout", "rings", "spherical_rings"],
    "statics.load": ["Load"],
    "tracking.fit": ["track"],
    "tracking.law": ["Tracking", "Validity", "read_tracking", "validity_of"],
}
_HOMES = {name: home for home, names in _NAMES.items() for name in names}
__all__ = ["errors", "mirrors"]
__all__ += list(_HOMES)


def __getattr__(name: str) -> Any:
    if name in _HOMES:
        return getattr(importlib.import_module(f"truenewton.{_HOMES[name]}"), name)
    if name in __all__:
        return importlib.import_module(f"truenewton.{name}")
    raise AttributeError(f"module 'truenewton' has no attribute '{name}'")


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
