"""A bench behind OPC UA; the extra `opcua` is needed only to connect or serve.

client    a bench behind an OPC UA server, used like any other bench
server    a bench behind a server on the loopback
methods   the variables and methods of its node
keys      certificates, private keys and a password, in a folder of the owner
"""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

from truenewton.bench.protocol import BenchChoice
from truenewton.errors import BenchFault

if TYPE_CHECKING:
    from truenewton.bench.opcua.client import OpcUaBench


def require_asyncua() -> None:
    """Raise BenchFault if the extra is not installed."""
    try:
        import asyncua  # noqa: F401
    except ModuleNotFoundError as error:
        raise BenchFault(
            f"OPC UA needs {error.name}", remedy="install it: pip install 'truenewton[opcua]'"
        ) from error


def connect(choice: BenchChoice, folder: str | os.PathLike[str] = ".") -> OpcUaBench:
    """Return a bench behind an OPC UA server, connected.

    Parameters
    ----------
    choice
        Its address, user, password_file, certificate, private_key and server_certificate.
    folder
        To which the files are relative: that of the plan.

    Raises
    ------
    BenchFault
        The extra is not installed, the choice is incomplete, or the server does not answer or
        refuses the client.
    UnreadableFile, FormatError
        Keys that cannot be used.

    Examples
    --------
    >>> plan = tn.read_plan("day.toml")
    >>> tn.connect(plan.bench)  # of a plan for a simulated bench
    Traceback (most recent call last):
        ...
    truenewton.errors.BenchFault: OPC UA needs bench.address; specify it in the plan; ...
    """
    require_asyncua()
    from truenewton.bench.opcua.client import OpcUaBench

    return OpcUaBench(choice, folder)
