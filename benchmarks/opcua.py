"""What OPC UA costs on top of a bench: time per shape over the loopback, security on.

    python benchmarks/opcua.py

A bench that answers at once stands behind a real server in a process of its own; a shape is one
command, one reading and one status. Beside it, a bare request: a status alone.
"""

import asyncio
import contextlib
import datetime
import multiprocessing
import multiprocessing.connection
import socket
import tempfile
import time
from pathlib import Path

import numpy as np

from truenewton.bench.choice import BenchChoice
from truenewton.bench.opcua import connect
from truenewton.bench.opcua.client import OpcUaBench
from truenewton.bench.opcua.keys import CLIENT_FILES, USER, make_keys
from truenewton.bench.opcua.server import serving
from truenewton.bench.protocol import Reading, Shape, Status
from truenewton.statics.layout import Layout, layout
from truenewton.statics.load import Load

COUNTS = (45, 672, 5352)
SHAPES = 200
LIMIT = 10e-3  # wanted at 672 actuators [s]


class InstantBench:
    """A mirror that is always there already."""

    instrument, gap = "INSTANT", 65e-6

    def __init__(self, n: int) -> None:
        self.layout: Layout = layout(np.arange(n) * 1e-4, np.zeros(n))
        self._values = np.random.default_rng(1).standard_normal((4, n))
        self._counter = 0

    def put_on(self, load: Load) -> None: ...

    def command(self, shape: Shape) -> None: ...

    def rest(self) -> None: ...

    def read(self, samples: int) -> Reading:  # noqa: ARG002
        self._counter += 1
        return Reading(
            datetime.datetime.now(datetime.UTC), *self._values, 20.0, self._counter, True
        )

    def status(self) -> Status:
        return Status(True, "there", self._counter)


def serve(n: int, folder: str, port: int, pipe: multiprocessing.connection.Connection) -> None:
    """Serve until told to end."""

    async def run() -> None:
        async with serving(InstantBench(n), folder, port):
            pipe.send("ready")
            await asyncio.to_thread(pipe.recv)

    asyncio.run(run())


def seconds_each(bench: OpcUaBench, *, bare: bool) -> list[float]:
    """Return the time of each shape, or of each status alone [s]."""
    random, load = np.random.default_rng(2), Load("bare")
    times = []
    for number in range(1, SHAPES + 1):
        shape = Shape(load, 1, number, 1, 1e-6 * random.standard_normal(bench.layout.n))
        start = time.perf_counter()
        if not bare:
            bench.command(shape)
            bench.read(2048)
        bench.status()
        times.append(time.perf_counter() - start)
    return times


def main() -> None:
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary) / "keys"
        make_keys(folder)
        print("actuators   median ms   95 % ms   a bare request ms   rows per minute")
        for n in COUNTS:
            with contextlib.closing(socket.socket()) as free:
                free.bind(("127.0.0.1", 0))
                port = free.getsockname()[1]
            ours, theirs = multiprocessing.Pipe()
            process = multiprocessing.get_context("spawn").Process(
                target=serve, args=(n, str(folder), port, theirs)
            )
            process.start()
            ours.recv()
            address = f"opc.tcp://127.0.0.1:{port}"
            choice = BenchChoice("opcua", address, user=USER, **CLIENT_FILES)
            with connect(choice, folder) as bench:
                bench.put_on(Load("bare"))
                seconds_each(bench, bare=False)
                shape, request = seconds_each(bench, bare=False), seconds_each(bench, bare=True)
            ours.send("end")
            process.join()
            median, high = np.percentile(shape, [50, 95])
            wanted = (
                f"   wanted < {1e3 * LIMIT:.0f}: ratio {median / LIMIT:.2f}" if n == 672 else ""
            )
            print(
                f"{n:9d}{1e3 * median:12.2f}{1e3 * high:10.2f}{1e3 * np.median(request):20.2f}"
                f"{60 / median:18.0f}{wanted}"
            )


if __name__ == "__main__":
    main()
