"""The OPC UA server of `truenewton serve` under a bounded load of strangers, on the loopback.

    python benchmarks/server_load.py [cycles of the campaign, 4]

A sound client takes a campaign meanwhile, in a process of its own. 200 strangers at a time come
without keys, with frames that are wrong, slow, endless, cut or replayed; 8 holders of a trusted key
come without the password, or with it and do what they may not. Memory and open files are the
server's, from /proc (Linux).
"""

import asyncio
import contextlib
import multiprocessing
import random
import signal
import socket
import subprocess
import sys
import tempfile
import time
import tomllib
from collections import Counter
from collections.abc import Callable, Iterator
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from asyncua import ua
from strangers import DEEDS, MEBI, do, record, strangers, visit

import truenewton as tn
from truenewton.bench.choice import BenchChoice
from truenewton.bench.opcua import keys
from truenewton.bench.opcua.client import OpcUaBench
from truenewton.bench.simulated.static import static_bench
from truenewton.mirrors.known import p45

AT_ONCE, HOLDERS = 200, 8  # strangers, and those with keys


# -- the server and a sound client ---------------------------------------------------------------


@contextlib.contextmanager
def serve(folder: Path, port: int) -> Iterator[tuple["subprocess.Popen[str]", dict[str, str]]]:
    """Give `truenewton serve p45` and the table that it prints for a plan."""
    command = [sys.executable, "-m", "truenewton", "serve", "p45", "--port", str(port), "-o",
               str(folder)]  # fmt: skip
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    with subprocess.Popen(command, text=True, **pipes) as server:
        assert server.stdout is not None
        try:
            printed = "".join(server.stdout.readline() for _ in range(10))
            yield server, tomllib.loads(printed.partition("\n")[2])["bench"]
        finally:
            server.kill()


def memory_and_files(process: int) -> tuple[float, int]:
    """Return the most memory that a process ever held [MiB], and its open files."""
    status = Path(f"/proc/{process}/status").read_text(encoding="ascii")
    peak = int(status.partition("VmHWM:")[2].split()[0]) / 1024
    return peak, len(list(Path(f"/proc/{process}/fd").iterdir()))


class TimedBench(OpcUaBench):
    """Notes the time that each answer took [s]."""

    def _call(self, method: str, *values: Any) -> list[Any]:
        start = time.perf_counter()
        try:
            return super()._call(method, *values)
        finally:
            vars(self).setdefault("taken", []).append(time.perf_counter() - start)


def sound(table: dict[str, str], cycles: int, pipe: Connection) -> None:
    """Take a campaign; tell how many rows it has, and what each answer took."""
    plan = tn.CampaignPlan(
        "p45", static_bench(p45(), 1).loads, cycles=cycles, bench=BenchChoice(**table)
    )
    with tempfile.TemporaryDirectory() as temporary, TimedBench(plan.bench) as bench:
        pipe.send("begun")
        tn.acquire(bench, plan, Path(temporary) / "campaign")
        campaign = tn.read(Path(temporary) / "campaign")
        pipe.send((sum(int(cycle.valid.sum()) for cycle in campaign.cycles), vars(bench)["taken"]))


# -- all together --------------------------------------------------------------------------------


async def flood(
    port: int, folder: Path, going_on: Callable[[], bool], watch: Callable[[], None]
) -> tuple[Counter[str], int, int, Counter[str]]:
    """Send strangers and holders of keys while something goes on.

    Returns
    -------
    connections, bytes_sent, most_heard, not_borne
        Connections by what they did; the most bytes that a stranger without a key heard; deeds
        that the server should have stopped.
    """
    certificate = (folder / keys.CLIENT_CERTIFICATE).read_bytes()
    kinds = strangers(certificate, await record(port, folder))
    order, connections, not_borne = random.Random(1), Counter[str](), Counter[str]()
    sent = heard = 0

    async def come() -> None:
        nonlocal sent, heard
        while going_on():
            name = order.choice(list(kinds))
            told, answer, _ = await visit(
                port, kinds[name](), pause=1.0 if "at a time" in name else 0.0,
                stay=order.choice((0.2, 2.0, 20.0)), deaf="endless" in name,
            )  # fmt: skip
            connections[name] += 1
            sent += told
            if "replayed" not in name:
                heard = max(heard, len(answer))

    async def come_with_keys() -> None:
        while going_on():
            name = order.choice(list(DEEDS))
            try:
                not_borne[name] += not await do(f"opc.tcp://127.0.0.1:{port}", folder, name)
            except (OSError, ua.UaError):  # no room, or put out
                connections["with keys, refused"] += 1
            else:
                connections[name] += 1

    async def look() -> None:
        while going_on():
            watch()
            await asyncio.sleep(0.1)

    each = [come() for _ in range(AT_ONCE)] + [come_with_keys() for _ in range(HOLDERS)]
    await asyncio.gather(look(), *each)
    return connections, sent, heard, +not_borne


def take(
    table: dict[str, str], cycles: int, meanwhile: Callable[[Callable[[], bool]], None], when: str
) -> None:
    """Have a campaign taken in a process of its own, do something meanwhile, print both."""
    ours, theirs = multiprocessing.Pipe()
    client = multiprocessing.get_context("spawn").Process(
        target=sound, args=(table, cycles, theirs)
    )
    client.start()
    ours.recv()
    meanwhile(lambda: not ours.poll())
    rows, taken = ours.recv()
    client.join()
    print(
        f"a campaign {when}: {rows} rows, {len(taken)} answers,"
        f" median {1e3 * sorted(taken)[len(taken) // 2]:.1f} ms, slowest {1e3 * max(taken):.0f} ms"
    )


def load(server: int, port: int, folder: Path, going_on: Callable[[], bool]) -> None:
    """Put the server under load, and print what came."""
    most, start = [0], time.monotonic()
    connections, sent, heard, not_borne = asyncio.run(
        flood(port, folder, going_on, lambda: most.append(memory_and_files(server)[1]))
    )
    for name, count in sorted(connections.items()):
        print(f"{count:9d}  {name}")
    print(
        f"{connections.total()} connections in {time.monotonic() - start:.0f} s, {sent / MEBI:.0f}"
        f" MiB sent; one without keys heard {heard} bytes at most; open files at most {max(most)};"
        f" not borne: {dict(not_borne) or 'nothing'}"
    )


def main(cycles: int) -> None:
    with contextlib.closing(socket.socket()) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary) / "keys"
        with serve(folder, port) as (server, table):
            take(table, cycles, lambda _: None, "alone")
            quiet, files = memory_and_files(server.pid)
            take(
                table, cycles, lambda going_on: load(server.pid, port, folder, going_on),
                "under load",
            )  # fmt: skip
            peak, after = memory_and_files(server.pid)
            print(
                f"memory at most {quiet:.0f} MiB without load, {peak:.0f} under it;"
                f" open files {files} before, {after} after"
            )
            start = time.monotonic()
            server.send_signal(signal.SIGTERM)
            out, err = server.communicate(timeout=30)
            print(
                f"ended {time.monotonic() - start:.1f} s after SIGTERM with code"
                f" {server.returncode}; it had printed {len(out) + len(err)} bytes"
            )


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 4)
