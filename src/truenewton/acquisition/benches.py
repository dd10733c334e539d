"""The bench that a plan chooses."""

from __future__ import annotations

import importlib
import os
from pathlib import Path
from typing import cast

from truenewton.acquisition.plan import CampaignPlan, planned_mirror
from truenewton.bench.protocol import Bench
from truenewton.bench.replay import ReplayBench
from truenewton.bench.simulated.bench import SimulatedBench
from truenewton.errors import BenchFault


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
        return simulated_bench(plan, beside)
    if choice.kind == "replay":
        return ReplayBench(Path(beside) / choice.address)
    try:  # imported where it is chosen: it needs what its extra installs
        module = importlib.import_module(f"truenewton.bench.{choice.kind}")
    except ImportError as error:
        raise BenchFault(
            f"the bench '{choice.kind}' needs what is not installed ({error})",
            remedy=f"pip install 'truenewton[{choice.kind}]'",
        ) from error
    if choice.kind == "opticalib":
        return cast(
            Bench, module.from_address(choice.address, planned_mirror(plan, beside), beside)
        )
    return cast(Bench, module.connect(choice, beside))


def simulated_bench(plan: CampaignPlan, beside: str | os.PathLike[str] = ".") -> SimulatedBench:
    """Return the simulated bench of a plan, which has the same truth each time."""
    return SimulatedBench(
        planned_mirror(plan, beside),
        plan.bench.seed,
        loads=plan.loads,
        force_noise=plan.bench.force_noise,
        fidelity=plan.bench.fidelity,
    )
