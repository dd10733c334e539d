"""Which bench takes a campaign, as a plan names it."""

from __future__ import annotations

from dataclasses import dataclass

KINDS = ("simulated", "opcua", "opticalib", "replay")


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
