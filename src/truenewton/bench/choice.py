"""Which bench takes a campaign, as a plan names it."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import ClassVar

import numpy as np

from truenewton.quantities import Quantity, convert_quantities

# What each kind of bench takes from a plan.
KINDS = {
    "simulated": ("seed", "force_noise", "fidelity"),
    "opcua": (
        "address", "user", "password_file", "certificate", "private_key", "server_certificate",
    ),
    "opticalib": ("address",),
    "replay": ("address",),
}  # fmt: skip


@dataclass(frozen=True)
class BenchChoice:
    """Which bench takes the campaign.

    Attributes
    ----------
    kind
        'simulated', 'opcua', 'opticalib' or 'replay'.
    address
        URL of an OPC UA server, `module:object` of a mirror after opticalib, a recorded folder.
    seed, force_noise, fidelity
        Of the simulated bench.
    user, password_file, certificate, private_key, server_certificate
        With which to log on to an OPC UA server.
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
    user: str = ""
    password_file: str = ""
    certificate: str = ""
    private_key: str = ""
    server_certificate: str = ""

    def __post_init__(self) -> None:
        convert_quantities(self)


def foreign_keys(choice: BenchChoice) -> list[str]:
    """Return what a choice says beyond the defaults that its kind of bench does not use."""
    own = ("kind", *KINDS[choice.kind])
    given = [each.name for each in fields(choice) if getattr(choice, each.name) != each.default]
    return [name for name in given if name not in own]
