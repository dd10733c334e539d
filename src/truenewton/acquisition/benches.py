"""The bench that a plan chooses."""

from __future__ import annotations

import os
from pathlib import Path

from truenewton.acquisition.plan import CampaignPlan, planned_mirror
from truenewton.bench.opcua import connect
from truenewton.bench.opticalib import from_address
from truenewton.bench.protocol import Bench
from truenewton.bench.replay import ReplayBench
from truenewton.bench.simulated.bench import SimulatedBench


def chosen_bench(plan: CampaignPlan, beside: str | os.PathLike[str] = ".") -> Bench:
    """Return the bench of a plan; files that the plan names stand relative to a folder.

    Raises
    ------
    BenchFault
        It needs what is not installed, or cannot be reached.
    TrueNewtonError
        What the plan says of it is wrong.
    """
    choice = plan.bench
    if choice.kind == "simulated":
        return _simulated(plan, beside)
    if choice.kind == "replay":
        return ReplayBench(Path(beside) / choice.address)
    if choice.kind == "opticalib":
        return from_address(choice.address, planned_mirror(plan, beside), beside)
    return connect(choice, beside)


def seal_truth(
    plan: CampaignPlan, beside: str | os.PathLike[str], campaign: str | os.PathLike[str]
) -> None:
    """Keep the truth of the simulated bench of a plan beside a campaign's folder, for scoring only.

    Raises
    ------
    OutputFailed
    """
    _simulated(plan, beside).write_truth(campaign, overwrite=True)


def _simulated(plan: CampaignPlan, beside: str | os.PathLike[str]) -> SimulatedBench:
    return SimulatedBench(
        planned_mirror(plan, beside),
        plan.bench.seed,
        loads=plan.loads,
        force_noise=plan.bench.force_noise,
        fidelity=plan.bench.fidelity,
    )
