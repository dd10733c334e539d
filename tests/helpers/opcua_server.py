"""A recorded bench behind a real OPC UA server on the loopback."""

import asyncio
import contextlib
import dataclasses
import datetime
import socket
import subprocess
import sys
import threading
import time
import tomllib
from collections.abc import Iterator
from pathlib import Path

import numpy as np

import truenewton as tn
from truenewton.bench.choice import BenchChoice
from truenewton.bench.opcua import keys
from truenewton.bench.opcua.server import serving
from truenewton.bench.protocol import Reading, Status


class RecordingBench:
    """A mirror that notes what it was asked."""

    instrument, gap = "NOTED", 65e-6

    def __init__(self, n=5):
        self.layout = tn.rings([0.1], [n])
        self.asked = []
        self.fault = None
        self.seconds = 0.0

    def _note(self, what):
        self.asked.append(what)
        time.sleep(self.seconds)
        if self.fault is not None:
            raise self.fault

    def put_on(self, load):
        self._note(("put_on", load.name))

    def command(self, shape):
        self._note(("command", shape))

    def rest(self):
        self._note("rest")

    def read(self, samples):
        self._note(("read", samples))
        now = datetime.datetime(2026, 5, 4, 1, 2, 3, 456789, tzinfo=datetime.UTC)
        four = np.arange(4.0 * self.layout.n).reshape(4, -1)
        return Reading(now, *four, np.nan, 7, False)

    def status(self):
        self._note("status")
        return Status(False, "a coil is hot", 2**40)


def free_port():
    """Return a port that is given to nobody else for a minute: a connection to it has just ended.

    Who asks for it by number, as a server does, is given it all the same.
    """
    with contextlib.closing(socket.socket()) as listening:
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listening.bind(("127.0.0.1", 0))
        listening.listen(1)
        address = listening.getsockname()
        with socket.create_connection(address):
            listening.accept()[0].close()
    return address[1]


@contextlib.contextmanager
def behind(bench, keys_folder, port):
    """Serve a bench from another thread while the block lasts; give its address."""
    started, stop, failed = threading.Event(), [], []

    async def run():
        stop.extend([asyncio.get_running_loop(), asyncio.Event()])
        async with serving(bench, keys_folder, port):
            started.set()
            await stop[1].wait()

    def thread():
        try:
            asyncio.run(run())
        except Exception as error:
            failed.append(error)
        finally:
            started.set()

    server = threading.Thread(target=thread)
    server.start()
    started.wait()
    try:
        if failed:
            raise failed[0]
        yield f"opc.tcp://127.0.0.1:{port}"
    finally:
        if not failed:
            stop[0].call_soon_threadsafe(stop[1].set)
        server.join()


def choice(address, **other):
    return dataclasses.replace(
        BenchChoice("opcua", address, user=keys.USER, **keys.CLIENT_FILES), **other
    )


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
