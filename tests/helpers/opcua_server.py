"""A recording bench behind a real OPC UA server on the loopback."""

import asyncio
import contextlib
import dataclasses
import socket
import threading
import time

from asyncua import Client, ua
from asyncua.crypto.security_policies import SecurityPolicyBasic256Sha256

from truenewton.bench.opcua import keys
from truenewton.bench.opcua.server import serving
from truenewton.bench.protocol import BenchChoice
from truenewton.bench.simulated.bench import SimulatedBench
from truenewton.mirrors.known import ring


class RecordingBench(SimulatedBench):
    """A simulated mirror that notes what it was asked; it fails, and takes time, as it is told."""

    def __init__(self, n=8):
        super().__init__(ring(n), 3)
        self.asked, self.fault, self.seconds = [], None, 0.0
        self._new = dict(vars(self))

    def renew(self):
        """Be as it was made."""
        vars(self).update(self._new, asked=[])

    def _note(self, what):
        self.asked.append(what)
        time.sleep(self.seconds)
        if self.fault is not None:
            raise self.fault

    def put_on(self, load):
        self._note(("put_on", load.name))
        super().put_on(load)

    def command(self, shape):
        self._note(("command", shape))
        super().command(shape)

    def rest(self):
        self._note("rest")
        super().rest()

    def read(self, samples):
        self._note(("read", samples))
        return super().read(samples)

    def status(self):
        self._note("status")
        return super().status()


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
def in_thread(server):
    """Hold an asynchronous context in another thread while the block lasts.

    Give its event loop and what the context gives.
    """
    started, given, failed = threading.Event(), [], []

    async def run():
        stop = asyncio.Event()
        async with server as value:
            given.extend([asyncio.get_running_loop(), value, stop])
            started.set()
            await stop.wait()

    def thread():
        try:
            asyncio.run(run())
        except Exception as error:
            failed.append(error)
        finally:
            started.set()

    running = threading.Thread(target=thread)
    running.start()
    started.wait()
    try:
        if failed:
            raise failed[0]
        yield given[:2]
    finally:
        if given:
            given[0].call_soon_threadsafe(given[2].set)
        running.join()


@contextlib.contextmanager
def behind(bench, keys_folder, port):
    """Serve a bench from another thread while the block lasts; give its address."""
    with in_thread(serving(bench, keys_folder, port)):
        yield f"opc.tcp://127.0.0.1:{port}"


def choice(address, **other):
    return dataclasses.replace(
        BenchChoice("opcua", address, user=keys.USER, **keys.CLIENT_FILES), **other
    )


def known_client(address, folder, mode=ua.MessageSecurityMode.SignAndEncrypt):
    """Return a client with the trusted certificate and its key, but without user and password."""
    client = Client(address, timeout=10.0, watchdog_intervall=60.0)  # silent by itself
    client.application_uri = keys.CLIENT_URI
    client.session_timeout = 60_000
    client.security_policy = SecurityPolicyBasic256Sha256(
        keys.read_certificate(folder / keys.SERVER_CERTIFICATE),
        keys.read_certificate(folder / keys.CLIENT_CERTIFICATE),
        keys.read_private_key(folder / keys.CLIENT_KEY),
        mode,
    )
    client.uaclient.set_security(client.security_policy)
    return client
