"""Which bench a plan names, and the one table from its kind to what makes it."""

from __future__ import annotations

import importlib
import inspect
import os
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import numpy as np

from truenewton.bench.opticalib import DeformableMirror, OpticalibMirror
from truenewton.bench.protocol import Bench, faults_of, lacking
from truenewton.bench.simulated.bench import SimulatedBench
from truenewton.errors import BenchFault, UnknownName, naming
from truenewton.mirrors.known import Mirror
from truenewton.quantities import Quantity, convert_quantities
from truenewton.statics.load import Load


@dataclass(frozen=True)
class BenchChoice:
    """Which bench takes the campaign.

    Attributes
    ----------
    kind
        'simulated', 'python' or 'opticalib'.
    address
        `package.module:Name` of a bench, or of a mirror with opticalib's protocol.
    seed, force_noise, fidelity
        Of the simulated bench.
    """

    QUANTITIES: ClassVar = {
        "seed": Quantity("", 0, np.inf, "give zero or more"),
        "force_noise": Quantity("N", 0.0, 1e9),
    }

    kind: str = "simulated"
    address: str = ""
    seed: int = 1
    force_noise: float = 1e-4
    fidelity: str = "static"

    def __post_init__(self) -> None:
        convert_quantities(self)


class Order(NamedTuple):
    """What a bench is made from."""

    choice: BenchChoice
    mirror: Mirror
    loads: Sequence[Load]
    folder: str | os.PathLike[str]  # of the plan


def _simulated(order: Order) -> Bench:
    of = order.choice
    return SimulatedBench(
        order.mirror, of.seed, loads=order.loads, force_noise=of.force_noise, fidelity=of.fidelity
    )


def _python(order: Order) -> Bench:
    made: Bench = object_at(order, Bench, "a bench (docs/hardware.md)")
    return made


def _opticalib(order: Order) -> Bench:
    device = object_at(order, DeformableMirror, "a mirror with opticalib's protocol, with forces")
    return OpticalibMirror(device, order.mirror)


# What makes each kind, and what it takes from the table of a plan.
BENCH_KINDS: dict[str, tuple[Callable[[Order], Bench], tuple[str, ...]]] = {
    "simulated": (_simulated, ("seed", "force_noise", "fidelity")),
    "python": (_python, ("address",)),
    "opticalib": (_opticalib, ("address",)),
}


def foreign_keys(choice: BenchChoice) -> list[str]:
    """Return the settings of a choice that its kind of bench does not use."""
    own = ("kind", *BENCH_KINDS[choice.kind][1])
    given = [each.name for each in fields(choice) if getattr(choice, each.name) != each.default]
    return [name for name in given if name not in own]


def object_at(order: Order, protocol: type, wanted: str) -> Any:
    """Return the object at an address, or the one that its class or function makes.

    The module is installed, or is in the folder of the plan. A parameter `mirror` of the class or
    function gets the mirror of the plan.
    """
    address = order.choice.address
    module, _, name = address.partition(":")
    if not all(part.isidentifier() for part in [*module.split("."), *name.split(".")]):
        raise UnknownName(f"bench.address is {address!r}", remedy="write it as package.module:Name")
    with naming(address):
        named = _named(module, name, str(Path(order.folder).absolute()))
        with faults_of(f"{name}()"):
            if isinstance(named, type) or (callable(named) and lacking(named, protocol)):
                signature = inspect.signature(named)
                given = {"mirror": order.mirror} if "mirror" in signature.parameters else {}
                try:
                    signature.bind(**given)
                except TypeError as error:
                    raise BenchFault(
                        f"{name}() is called without arguments, or with `mirror` ({error})",
                        remedy="give the other parameters defaults",
                    ) from error
                named = named(**given)
            missing = lacking(named, protocol)
        if missing:
            raise BenchFault(f"has no {', '.join(missing)}", remedy=f"give {wanted}")
    return named


def _named(module: str, name: str, folder: str) -> Any:
    """Return what a module calls by a name."""
    if folder not in sys.path:
        sys.path.append(folder)  # for good: a bench may import while it runs
    try:
        named: Any = importlib.import_module(module)
    except (Exception, SystemExit) as error:
        if isinstance(error, ModuleNotFoundError) and f"{module}.".startswith(f"{error.name}."):
            raise UnknownName(
                f"there is no module '{error.name}'",
                remedy=f"install it, or put its file into the folder of the plan, {folder}",
            ) from error
        raise BenchFault(
            f"the module cannot be imported ({type(error).__name__}: {error})",
            remedy="correct it",
        ) from error
    for part in name.split("."):
        if not hasattr(named, part):
            where = sys.modules[module].__file__
            raise UnknownName(f"{where} has no '{name}'", remedy="correct bench.address")
        named = getattr(named, part)
    return named
