"""A bench behind an OPC UA server, used like any other bench: its calls wait for their answer."""

from __future__ import annotations

import asyncio
import os
import threading
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, Self

from asyncua import Client, ua
from asyncua.client.ua_client import UaClientState
from asyncua.crypto.security_policies import SecurityPolicyBasic256Sha256
from asyncua.sync import ThreadLoop

from truenewton.bench.opcua import keys
from truenewton.bench.opcua.methods import (
    MAX_MESSAGE,
    METHODS,
    VARIABLES,
    mirror_of,
    received_answer,
    variants,
)
from truenewton.bench.protocol import BenchChoice, Reading, Shape, Status
from truenewton.errors import BenchFault, Interrupted, TrueNewtonError
from truenewton.statics.layout import Layout
from truenewton.statics.load import Load

ERRORS = {  # an interruption is always our own
    error.__name__: error for error in TrueNewtonError.__subclasses__() if error is not Interrupted
}


class OpcUaBench:
    """A mirror behind an OPC UA server: signed, encrypted, with user and password.

    A lost connection is opened again by the next call. A reading is then refused until a shape has
    been commanded, because the mirror may have moved. See `opcua.connect` for arguments and errors.

    Attributes
    ----------
    instrument, layout, gap, gradients
        As of `Bench` and `gradients_of`.
    put_on
        As of `Operator`, if the server has PutOn; otherwise there is no such attribute.
    """

    instrument: str
    layout: Layout
    gap: float
    gradients: tuple[float | None, float | None]
    put_on: Callable[[Load], None]

    _timeout = 60.0  # for one answer; a reading waits for the mirror to settle [s]
    _patience = 10.0  # for a connection [s]

    def __init__(self, choice: BenchChoice, folder: str | os.PathLike[str] = ".") -> None:
        for name in ("address", "user", *keys.CLIENT_FILES):
            if not getattr(choice, name):
                raise BenchFault(
                    f"OPC UA needs bench.{name}",
                    remedy="specify it in the plan; `truenewton serve` prints the right one",
                )
        self._choice, folder = choice, Path(folder)
        self._password = keys.read_password(folder / choice.password_file)
        self._new_policy = partial(
            SecurityPolicyBasic256Sha256,
            keys.read_certificate(folder / choice.server_certificate),
            keys.read_certificate(folder / choice.certificate),
            keys.read_private_key(folder / choice.private_key),
            ua.MessageSecurityMode.SignAndEncrypt,
        )
        self._client: Client | None = None
        self._connections = 0  # so far
        self._commanded: int | None = None  # in which of them the last shape was commanded
        self._thread = ThreadLoop(timeout=None)
        self._thread.daemon = True
        self._thread.start()
        self._one_at_a_time = threading.Lock()
        try:
            self._thread.post(self._connected())
        except BaseException:
            self.close()
            raise

    def _put_on(self, load: Load) -> None:
        """Have a load put on, or taken off for the bare mirror."""
        self._call("PutOn", load.name)

    def command(self, shape: Shape) -> None:
        """Bring the mirror to a shape."""
        self._call(
            "Command", shape.load.name, shape.cycle, shape.number, shape.sign, shape.position
        )
        self._commanded = self._connections

    def read(self, samples: int) -> Reading:
        """Return the mean of so many samples, when the mirror has settled."""
        given = self._call("Read", samples)
        if not len(given[-1]):
            given[-1] = None
        return Reading(*given)

    def status(self) -> Status:
        """Return how the bench is."""
        return Status(*self._call("Status"))

    def rest(self) -> None:
        """Bring the mirror to rest."""
        self._call("Rest")

    def close(self) -> None:
        """Close the connection for good."""
        if self._thread.is_alive():
            self._thread.post(self._drop(broken=False))
            self._thread.stop()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _call(self, method: str, *values: Any) -> list[Any]:
        """Call a method of the server and return what it gives; raise its fault."""
        arguments = variants(values, METHODS[method][0])
        with self._one_at_a_time:
            answer: list[Any] = self._thread.post(self._answer(method, arguments))
        try:
            fault, given = received_answer(method, answer)
        except BenchFault as error:
            raise self._fault(f"{error.fault}, in Bench.{method}", error.remedy) from None
        if fault:
            name, what, remedy = fault
            raise ERRORS.get(name, BenchFault)(what, remedy=remedy)
        return given

    async def _answer(self, method: str, arguments: list[ua.Variant]) -> list[Any]:
        client = await self._connected()
        if method == "Read" and self._commanded not in (None, self._connections):
            raise BenchFault(
                "the connection to the server was lost since the shape was commanded",
                remedy="command it again",
            )
        request = ua.CallMethodRequest(
            ua.NodeId("Bench", self._space), ua.NodeId(f"Bench.{method}", self._space), arguments
        )
        try:
            (result,) = await client.uaclient.call([request])
        except TimeoutError:
            await self._drop()
            raise self._fault(
                f"does not answer {method} within {self._timeout:g} s",
                "check the bench: it may still be moving",
            ) from None
        except (OSError, ua.UaError) as error:
            await self._drop()
            raise self._fault(f"was lost in {method} ({_text(error)})", "try again") from error
        if not result.StatusCode.is_good():
            raise self._fault(f"fails in {method} ({result.StatusCode.name})", "see its log")
        return [variant.Value for variant in result.OutputArguments or ()]

    async def _connected(self) -> Client:
        """Return a client with a session, the present or a new one."""
        client = self._client
        if client is not None and client.uaclient.state is UaClientState.CONNECTED:
            return client
        await self._drop()
        client = self._new_client()
        try:
            await asyncio.wait_for(client.connect(), self._patience)
        except (OSError, TimeoutError) as error:
            client.disconnect_socket()
            raise self._fault(
                f"cannot be reached ({_text(error)})",
                "start it; if it runs, it does not trust this certificate, is not the one of"
                " server_certificate, or offers no Basic256Sha256, signed and encrypted",
            ) from error
        except ValueError as error:  # of the address
            raise self._fault(
                f"cannot be reached ({_text(error)})", "give opc.tcp://host:port"
            ) from error
        except ua.UaError as error:
            client.disconnect_socket()
            raise self._fault(
                f"refuses user '{self._choice.user}' ({_text(error)})",
                "check user, password_file, certificate and server_certificate",
            ) from error
        self._client, self._connections = client, self._connections + 1
        try:
            await self._recognise(client)
        except BaseException:
            await self._drop()
            raise
        return client

    def _new_client(self) -> Client:
        """Return a client that is not yet connected."""
        # asyncua's watchdog must not give up while the client waits for a reading.
        client = Client(
            self._choice.address, timeout=self._timeout, watchdog_intervall=self._timeout
        )
        client.application_uri = keys.CLIENT_URI
        client.session_timeout = 600_000  # [ms]
        client.max_messagesize = MAX_MESSAGE
        client.set_user(self._choice.user)
        client.set_password(self._password)
        client.security_policy = self._new_policy()
        client.uaclient.set_security(client.security_policy)
        return client

    async def _recognise(self, client: Client) -> None:
        """Read what the mirror is, or check that it is still the same."""
        try:
            self._space = await client.get_namespace_index(keys.NAMESPACE)
            values = await self._attributes(
                client, [name for name, _ in VARIABLES], ua.AttributeIds.Value
            )
            methods = await self._attributes(client, list(METHODS), ua.AttributeIds.NodeClass)
        except (OSError, ValueError, ua.UaError) as error:
            raise self._fault(
                f"is not that of a bench ({_text(error)})", "check bench.address"
            ) from error
        try:
            instrument, gap, gradients, layout = mirror_of(values, methods)
        except BenchFault as error:
            raise self._fault(error.fault, error.remedy) from None
        except TrueNewtonError as error:
            what = f"gives Id, X, Y, Nz or Enabled that cannot be: {error.fault}"
            raise self._fault(what, error.remedy) from None
        if self._connections == 1:
            self.instrument, self.layout, self.gap = instrument, layout, gap
            self.gradients = gradients
            if "PutOn" in methods:
                self.put_on = self._put_on
        elif instrument != self.instrument or not layout.same_as(self.layout):
            raise self._fault(
                f"is no longer that of {self.instrument} with its {self.layout.n} actuators",
                "connect again",
            )

    async def _attributes(
        self, client: Client, names: list[str], attribute: ua.AttributeIds
    ) -> dict[str, Any]:
        """Return an attribute of the nodes that exist, by name."""
        nodes = [client.get_node(ua.NodeId(f"Bench.{name}", self._space)) for name in names]
        found = zip(names, await client.read_attributes(nodes, attribute), strict=True)
        return {name: one.Value.Value for name, one in found if one.StatusCode.is_good()}

    async def _drop(self, *, broken: bool = True) -> None:
        """Close the connection; if it is broken, without a message to the server."""
        client, self._client = self._client, None
        if client is not None:
            if broken:
                client.disconnect_socket()
            await client.disconnect()

    def _fault(self, what: str, remedy: str) -> BenchFault:
        return BenchFault(f"the server {what}", remedy=remedy, path=self._choice.address)


def _text(error: BaseException) -> str:
    return str(error) or type(error).__name__
