"""`truenewton serve`: the simulated bench behind a real OPC UA server."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import typer

if TYPE_CHECKING:
    from truenewton.bench.opcua.server import ServedBench


def run(
    mirror: str = typer.Argument(..., help="A known mirror, or its TOML file."),
    keys: Path = typer.Option(
        Path("truenewton-keys"),
        "-o",
        "--keys",
        help="Folder of certificates, keys and password; made where there is none.",
    ),
    port: int = typer.Option(4840, min=1, max=65535, help="TCP port."),
    seed: int = typer.Option(1, min=0, help="Decides everything random."),
    noise: float = typer.Option(1e-4, min=0.0, max=1.0, help="Of one force reading [N]."),
) -> None:
    """Serve the simulated bench over OPC UA on this machine, for known clients only."""
    import asyncio

    from truenewton.bench.opcua import require_asyncua

    require_asyncua()
    from truenewton.bench.opcua.keys import make_keys
    from truenewton.bench.simulated.bench import SimulatedBench
    from truenewton.mirrors.file import mirror_from

    bench = SimulatedBench(mirror_from(mirror), seed, force_noise=noise)
    make_keys(keys)
    asyncio.run(_until_stopped(bench, keys, port))


async def _until_stopped(bench: ServedBench, folder: Path, port: int) -> None:
    """Serve until Ctrl-C, or until the process is told to end."""
    import asyncio
    import signal

    from truenewton.bench.opcua.server import serving

    stopped, loop = asyncio.Event(), asyncio.get_running_loop()
    for number in (signal.SIGINT, signal.SIGTERM):  # Windows has no loop.add_signal_handler
        signal.signal(number, lambda *_: loop.call_soon_threadsafe(stopped.set))
    async with serving(bench, folder, port) as address:
        print(
            f"the simulated bench of {bench.instrument}, {bench.layout.n} actuators; Ctrl-C ends"
            f" it. For a plan:\n\n{_table(address, folder)}",
            flush=True,
        )
        await stopped.wait()


def _table(address: str, folder: Path) -> str:
    """Return the [bench] table of a plan for this server."""
    import json

    from truenewton.bench.opcua import keys as keys

    values = {
        "kind": "opcua",
        "address": address,
        "user": keys.USER,
        "password_file": str(folder.resolve() / keys.PASSWORD),
        "certificate": str(folder.resolve() / keys.CLIENT_CERTIFICATE),
        "private_key": str(folder.resolve() / keys.CLIENT_KEY),
        "server_certificate": str(folder.resolve() / keys.SERVER_CERTIFICATE),
    }
    # A string of JSON is a string of TOML.
    return "\n".join(
        ["[bench]", *(f"{name} = {json.dumps(value)}" for name, value in values.items())]
    )
