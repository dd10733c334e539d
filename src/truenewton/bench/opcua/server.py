"""A bench behind an OPC UA server on the loopback (docs/hardware.md)."""

from __future__ import annotations

import contextlib
import hmac
import os
import socket
import threading
from collections.abc import AsyncIterator, Callable, Iterable, Iterator
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from asyncua import Server, ua
from asyncua.common.connection import TransportLimits
from asyncua.crypto.permission_rules import User, UserRole
from asyncua.server.internal_server import InternalServer

from truenewton.bench.opcua import keys
from truenewton.bench.opcua.methods import MAX_MESSAGE, METHODS, VARIABLES, Type, scalar, variants
from truenewton.bench.protocol import Bench, Operator, Shape, check_samples, gradients_of
from truenewton.errors import BenchFault, TrueNewtonError
from truenewton.statics.load import Load

PORT = 4840  # registered for OPC UA


class ServedBench(Bench, Operator, Protocol):
    """A bench on which loads can be put by a command."""


def check_port(port: int) -> None:
    """Refuse a port that is taken, before anything is made for it."""
    with _port_faults(port):
        socket.create_server(("127.0.0.1", port)).close()


@contextlib.contextmanager
def _port_faults(port: int) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        reason = os.strerror(error.errno or 0)
        raise BenchFault(
            f"port {port} cannot be had ({reason})", remedy="choose another port"
        ) from error


class _KnownClients:
    """Admits a client with a trusted certificate (DER), user and password."""

    def __init__(self, trusted: frozenset[bytes], password: str) -> None:
        self._trusted, self._password = trusted, password.encode()

    def get_user(
        self,
        _server: InternalServer,
        username: str | None = None,
        password: str | None = None,
        certificate: bytes | None = None,
    ) -> User | None:
        """Return the user, or None; the certificate is that of the channel."""
        right = hmac.compare_digest((password or "").encode(), self._password)
        if right and username == keys.USER and certificate in self._trusted:
            return User(role=UserRole.User, name=username)
        return None


class _InternalServer(InternalServer):
    def lookup_external_session(self, auth_token: ua.NodeId) -> None:
        """Find no session of another connection: asyncua 2.1 would hand it over unchecked."""


@contextlib.asynccontextmanager
async def serving(
    bench: ServedBench, folder: str | os.PathLike[str], port: int = PORT
) -> AsyncIterator[str]:
    """Serve a bench at 127.0.0.1 while the block lasts, and give its address.

    The folder contains keys, as `keys.make_keys` makes them. The bench is never called twice at
    once. A port that is taken is a `BenchFault`.
    """
    folder = Path(folder)
    certificate = keys.read_certificate(folder / keys.SERVER_CERTIFICATE)
    private = keys.read_private_key(folder / keys.SERVER_KEY)
    trusted = keys.read_trusted(folder / keys.TRUSTED)
    password = keys.read_password(folder / keys.PASSWORD)
    server = Server(_InternalServer(user_manager=_KnownClients(trusted, password)))
    server.iserver.certificate, server.iserver.private_key = certificate, private
    server.limits = TransportLimits(max_message_size=MAX_MESSAGE)
    await server.init()
    await server.set_application_uri(keys.SERVER_URI)
    server.set_security_policy([ua.SecurityPolicyType.Basic256Sha256_SignAndEncrypt])
    server.set_identity_tokens([ua.UserNameIdentityToken])
    server.set_server_name(f"truenewton {bench.instrument}")
    server.set_endpoint(f"opc.tcp://127.0.0.1:{port}")
    await _publish(server, bench)
    with _port_faults(port):
        await server.start()
    try:
        yield server.endpoint.geturl()
    finally:
        await server.stop()


async def _publish(server: Server, bench: ServedBench) -> None:
    """Add the nodes of a bench."""
    space = await server.register_namespace(keys.NAMESPACE)
    node = await server.nodes.objects.add_object(ua.NodeId("Bench", space), f"{space}:Bench")
    layout = bench.layout
    values = (
        bench.instrument, float(bench.gap),
        np.array(gradients_of(bench), dtype=float),  # None becomes NaN
        layout.id, layout.x, layout.y, layout.nz, layout.enabled,
    )  # fmt: skip
    for (name, _), variant in zip(VARIABLES, variants(values, VARIABLES), strict=True):
        await node.add_variable(ua.NodeId(f"Bench.{name}", space), f"{space}:{name}", variant)
    methods = _Methods(bench)
    for name, (takes, gives) in METHODS.items():
        await node.add_method(
            ua.NodeId(f"Bench.{name}", space),
            f"{space}:{name}",
            methods.guarded(name),
            [_argument(*one) for one in takes],
            [_argument(*one) for one in (("Fault", [Type.String]), *gives)],
        )


def _argument(name: str, kind: Any) -> ua.Argument:
    array = isinstance(kind, list)
    return ua.Argument(
        Name=name,
        DataType=ua.NodeId(scalar(kind).value),
        ValueRank=ua.ValueRank.OneDimension if array else ua.ValueRank.Scalar,
    )


class _Methods:
    """The methods of the node, one at a time; each raises what the bench raises.

    After a restart the server does not know which load is on the mirror. It takes no shape before
    `PutOn`, so that no row is recorded under a wrong load.
    """

    def __init__(self, bench: ServedBench) -> None:
        self._bench = bench
        self._one_at_a_time = threading.Lock()
        self._load: Load | None = None

    def guarded(self, name: str) -> Callable[..., list[ua.Variant]]:
        """Return a method of the node: it gives its fault, then its values."""
        methods: dict[str, Callable[..., Any]] = {
            "PutOn": self._put_on,
            "Command": self._command,
            "Read": self._read,
            "Status": lambda: vars(self._bench.status()).values(),
            "Rest": self._bench.rest,
        }
        method = methods[name]

        def call(_parent: ua.NodeId, *arguments: ua.Variant) -> list[ua.Variant]:
            try:
                with self._one_at_a_time:
                    values = method(*(argument.Value for argument in arguments)) or ()
            except TrueNewtonError as error:
                fault = [type(error).__name__, error.fault, error.remedy]
                return [ua.Variant(fault, Type.String)]
            return [ua.Variant([], Type.String), *variants(values, METHODS[name][1])]

        return call

    def _put_on(self, name: str) -> None:
        load = Load(name)
        self._load = None
        self._bench.put_on(load)
        self._load = load

    def _read(self, samples: int) -> Iterable[Any]:
        check_samples(samples)
        return vars(self._bench.read(samples)).values()

    def _command(
        self, load: str, cycle: int, number: int, sign: int, position: list[float]
    ) -> None:
        present = self._load
        if present is None or present.key != Load(load).key:
            there = "no load" if present is None else f"'{present.name}'"
            raise BenchFault(
                f"the shape is for load '{load}', but {there} is on the mirror",
                remedy="put the load on first",
            )
        displacement = np.array(position, dtype=float)
        if not np.isfinite(displacement).all():
            raise BenchFault("a displacement is not finite", remedy="give metres")
        self._bench.command(Shape(present, cycle, number, sign, displacement))
