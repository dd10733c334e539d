"""`truenewton serve`: the simulated bench behind a real OPC UA server."""

from __future__ import annotations

from pathlib import Path

import typer

from truenewton.cli import options


def run(
    mirror: str = typer.Argument(..., help="A known mirror, or its TOML file."),
    keys: Path = typer.Option(
        Path("truenewton-keys"),
        "-o",
        "--keys",
        help="Folder of certificates, keys and password; made where there is none.",
    ),
    port: int = typer.Option(4840, min=1, max=65535, help="TCP port."),
    segment: int | None = options.SEGMENT,
    seed: int = typer.Option(1, min=0, help="Decides everything random."),
    noise: float = typer.Option(1e-4, min=0.0, max=1.0, help="Of one force reading [N]; static."),
    fidelity: str = options.FIDELITY,
) -> None:
    """Serve the simulated bench over OPC UA on this machine, for known clients only."""
    from truenewton.bench.opcua import require_asyncua

    require_asyncua()
    import asyncio
    import json
    import signal

    from truenewton.bench.opcua.keys import CLIENT_FILES, USER, make_keys
    from truenewton.bench.opcua.server import check_port, serving
    from truenewton.bench.simulated.bench import SimulatedBench
    from truenewton.bench.simulated.segmented import seed_of
    from truenewton.cli.terminal import say
    from truenewton.mirrors.file import mirror_from, segment_from

    if segment is None:
        known = mirror_from(mirror)
    else:
        known, seed = segment_from(mirror, segment)[0], seed_of(seed, segment)
    bench = SimulatedBench(known, seed, force_noise=noise, fidelity=fidelity)
    check_port(port)
    make_keys(keys)

    async def serve_until_stopped() -> None:
        """Serve until Ctrl-C, or until the process is told to end."""
        stopped, loop = asyncio.Event(), asyncio.get_running_loop()
        for number in (signal.SIGINT, signal.SIGTERM):  # Windows has no loop.add_signal_handler
            signal.signal(number, lambda *_: loop.call_soon_threadsafe(stopped.set))
        async with serving(bench, keys, port) as address:
            say(
                f"the simulated bench of {bench.instrument}, {bench.layout.n} actuators; Ctrl-C"
                " ends it. For a plan:", "", "[bench]",
            )  # fmt: skip
            table = {"kind": "opcua", "address": address, "user": USER}
            table |= {name: str(keys.resolve() / file) for name, file in CLIENT_FILES.items()}
            for name, value in table.items():
                say(f"{name} = {json.dumps(value)}")  # a string of JSON is a string of TOML
            await stopped.wait()

    asyncio.run(serve_until_stopped())
