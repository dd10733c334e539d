"""The door of an OPC UA server: nothing is said, and nothing heard, but to known clients.

asyncua 2.1 is open before it is closed: without a channel, or through one without security, it
answers whatever needs no session, tells its endpoints, and ties a session to whoever guesses its
number before it has checked who asks. So a channel opens to trusted certificates alone, nothing is
processed before, a session ends with its connection, and the password is checked with the
certificate of the channel.
"""

from __future__ import annotations

import asyncio
import hmac
from dataclasses import dataclass
from typing import Any

from asyncua import Server, ua
from asyncua.crypto.permission_rules import SimpleRoleRuleset, User, UserRole
from asyncua.crypto.security_policies import (
    CryptographyNone,
    SecurityPolicyBasic256Sha256,
    SecurityPolicyFactory,
    SecurityPolicyNone,
)
from asyncua.server.binary_server_asyncio import BinaryServer
from asyncua.server.internal_server import InternalServer
from asyncua.server.internal_session import InternalSession
from asyncua.ua.uaerrors import BadServiceUnsupported, BadTooManySessions, BadUserAccessDenied
from cryptography import x509
from cryptography.hazmat.primitives.asymmetric.rsa import RSAPrivateKey

import truenewton.bench.opcua.decoding  # noqa: F401
from truenewton.bench.opcua.limits import LIMITS, BoundedProtocol, bound


@dataclass(frozen=True, repr=False)
class KnownClients:
    """Who may come: the holder of a trusted certificate (DER) who also knows user and password."""

    trusted: frozenset[bytes]
    user: str
    password: str

    def get_user(
        self,
        iserver: InternalServer,  # noqa: ARG002
        username: str | None = None,
        password: str | None = None,
        certificate: bytes | None = None,
    ) -> User | None:
        """Return the user, or None; the certificate is that with which the channel was opened."""
        right = hmac.compare_digest((password or "").encode(), self.password.encode())
        if right and username == self.user and certificate in self.trusted:
            return User(role=UserRole.User, name=username)
        return None


class ClosedServer(Server):
    """An OPC UA server that speaks Basic256Sha256, signed and encrypted, with known clients only.

    Parameters
    ----------
    clients
        Who may come.
    certificate, key
        The server's.
    """

    def __init__(
        self, clients: KnownClients, certificate: x509.Certificate, key: RSAPrivateKey
    ) -> None:
        super().__init__(_InternalServer(user_manager=clients))
        self.iserver.certificate, self.iserver.private_key = certificate, key
        self.limits = LIMITS
        bound(self.iserver)
        self.set_security_policy([ua.SecurityPolicyType.Basic256Sha256_SignAndEncrypt])
        self.set_identity_tokens([ua.UserNameIdentityToken])
        self._door = _TrustedOnly(clients.trusted, certificate, key)

    async def start(self) -> None:
        """Listen; as the base class, but with our own door."""
        await self._setup_server_nodes()
        await self.iserver.start()
        self.bserver = _BinaryServer(
            self.iserver, self.endpoint.hostname, self.endpoint.port, self.limits
        )
        self.bserver.set_policies([self._door])
        try:
            await self.bserver.start()
        except BaseException:
            await self.iserver.stop()
            raise


class _InternalServer(InternalServer):
    def lookup_external_session(self, auth_token: ua.NodeId) -> None:  # noqa: ARG002
        """Find no session of another connection."""
        return

    def create_session(self, name: str, *user: User, external: bool = False) -> InternalSession:
        """Return a session; the only one of its connection, after whose address it is named."""
        if external and any(one.name == name for one in self._external_sessions.values()):
            raise BadTooManySessions
        return super().create_session(name, *user, external=external)

    def register_server(self, server: Any, conf: Any = None) -> None:  # noqa: ARG002
        """Refuse: asyncua would keep the names of as many servers as anybody tells."""
        raise BadServiceUnsupported


class _BinaryServer(BinaryServer):
    def _make_protocol(self) -> _Protocol:
        return _Protocol(
            self.iserver, self._policies, self.clients, self.closing_tasks, self.limits
        )

    async def stop(self) -> None:
        """End; without waiting for clients that do not fetch their answers."""
        if self._server is not None:
            self._server.close()
        for client in self.clients:
            if client.transport is not None:
                client.transport.abort()
        await super().stop()


class _Protocol(BoundedProtocol):
    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Begin without any security policy, not even that of no security."""
        super().connection_made(transport)
        if self.processor is not None:
            self.processor._connection.security_policy = _Nothing()


class _Nothing(SecurityPolicyNone):
    """What holds before a channel is open: nothing can be read."""

    URI = ""

    def __init__(self) -> None:
        super().__init__()
        self.asymmetric_cryptography = self.symmetric_cryptography = _Unreadable()


class _Unreadable(CryptographyNone):
    def decrypt(self, data: bytes) -> bytes:  # noqa: ARG002
        """Refuse; asyncua closes the connection on this error."""
        raise BadUserAccessDenied


class _TrustedOnly(SecurityPolicyFactory):
    """Opens a channel to trusted certificates alone."""

    def __init__(self, trusted: frozenset[bytes], certificate: Any, key: Any) -> None:
        mode = ua.MessageSecurityMode.SignAndEncrypt
        super().__init__(SecurityPolicyBasic256Sha256, mode, certificate, key, SimpleRoleRuleset())
        self._trusted = trusted

    def matches(self, uri: str, mode: ua.MessageSecurityMode | None = None) -> bool:
        """Accept the one policy; asyncua closes the connection on this error."""
        if not super().matches(uri, mode):
            raise BadUserAccessDenied
        return True

    def create(self, peer_certificate: bytes | None) -> SecurityPolicyBasic256Sha256:
        """Return the policy of a channel to a trusted certificate."""
        if peer_certificate not in self._trusted:
            raise BadUserAccessDenied
        return super().create(peer_certificate)
