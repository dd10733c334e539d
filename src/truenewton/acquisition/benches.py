"""The bench that a plan chooses."""

from __future__ import annotations

import os
from dataclasses import replace
from typing import Any

from truenewton.acquisition.plan import CampaignPlan, planned_mirror
from truenewton.bench.opcua import connect
from truenewton.bench.opticalib import from_address
from truenewton.bench.protocol import Bench
from truenewton.bench.simulated.bench import SimulatedBench
from truenewton.bench.simulated.segmented import seed_of

SEGMENT = "{segment}"  # in address and keys: its number, since each has its own control unit


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
    mirror = planned_mirror(plan, beside)  # without its segment refused before anybody is called
    if plan.segment:
        given, number = vars(choice).items(), str(plan.segment)
        texts: dict[str, Any] = {k: text.replace(SEGMENT, number) for k, text in given
                                 if isinstance(text, str)}  # fmt: skip
        choice = replace(choice, **texts)
    if choice.kind == "opticalib":
        return from_address(choice.address, mirror, beside)
    return connect(choice, beside)


def simulated_bench(plan: CampaignPlan, beside: str | os.PathLike[str] = ".") -> SimulatedBench:
    """Return the simulated bench of a plan, which has the same truth each time.

    A segment's is that which `simulate` gives it.
    """
    seed = plan.bench.seed
    return SimulatedBench(
        planned_mirror(plan, beside),
        seed_of(seed, plan.segment) if plan.segment else seed,
        loads=plan.loads,
        force_noise=plan.bench.force_noise,
        fidelity=plan.bench.fidelity,
    )
