"""What one connection may take of the server, in bytes, messages and time, and how many there are.

asyncua 2.1 waits for whatever length a frame declares, hears on after an error, piles up answers
that nobody fetches, and keeps connections whose session has ended. Here every connection has its
bounds, and who leaves them is put out without a word. Without a session it holds a begun frame and
what is read at once, 64 and 256 KiB: 80 MiB in all.
"""

from __future__ import annotations

import asyncio
import struct
import time
from typing import Any

from asyncua.common.connection import TransportLimits
from asyncua.common.utils import Buffer
from asyncua.server.binary_server_asyncio import OPCUAProtocol
from asyncua.server.internal_server import InternalServer

CONNECTIONS = 256
BEFORE_SESSION = 10.0  # a client has a session by then [s]
SILENCE = 600.0  # of a client with a session [s]
SHORTEST, LONGEST = 32, 65535  # frames; the shortest is a hello without an address [bytes]
MESSAGE = 2 * 2**20  # of many frames: 50,000 actuators [bytes]
WAITING = 50  # messages of one client that are not yet answered
UNREAD = 2 * MESSAGE  # answers that a client does not fetch [bytes]
HEAD = struct.Struct("<4sI")  # of a frame: kind, length
LIMITS = TransportLimits(LONGEST, LONGEST, MESSAGE // 8192, MESSAGE)


def bound(server: InternalServer) -> None:
    """Set the bounds for which asyncua has a name."""
    server.max_pending_messages_per_connection = WAITING
    server.max_pending_activation_seconds = 0.0  # BEFORE_SESSION, here
    server.max_subscriptions = 0  # nothing here changes by itself, and they outlive their client


class BoundedProtocol(OPCUAProtocol):
    """A connection within its bounds."""

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Begin; where there are too many, who has come least far makes room, the oldest first."""
        if len(self.clients) >= CONNECTIONS:
            last = min(self.clients, key=_standing)
            if _standing(last) == 2 or last.transport is None:
                transport.close()
                return
            self.clients.remove(last)
            last.transport.abort()
        super().connection_made(transport)
        assert self.transport is not None
        self.transport.set_write_buffer_limits(high=UNREAD)
        self._received, self._greeted, self._heard = bytearray(), False, time.monotonic()
        self._timer = asyncio.get_running_loop().call_later(BEFORE_SESSION, self._expire)

    def connection_lost(self, ex: BaseException | None) -> None:
        """End."""
        super().connection_lost(ex)
        if self.transport is not None:  # it was not refused
            self._timer.cancel()

    def data_received(self, data: bytes) -> None:
        """Hand on frames, one by one, that may come now and are of a length that may be."""
        assert self.transport is not None
        self._heard = time.monotonic()
        self._received += data
        while len(self._received) >= HEAD.size and not self.transport.is_closing():
            kind, size = HEAD.unpack_from(self._received)
            if not (self._may_come(kind) and SHORTEST <= size <= LONGEST):
                self.transport.abort()
                return
            if len(self._received) < size:
                return
            frame = bytes(self._received[:size])
            del self._received[:size]
            self._greeted = True
            super().data_received(frame)

    def pause_writing(self) -> None:
        """End where answers are not fetched."""
        assert self.transport is not None
        self.transport.abort()

    async def _process_one_msg(self, header: Any, buf: Buffer) -> bool:
        """Process a message; end where it is wrong, as OPC UA demands (part 6, 6.7.2)."""
        assert self.transport is not None
        if self.transport.is_closing():  # what waits is not heard
            return False
        try:
            good: bool = await super()._process_one_msg(header, buf)
        except Exception:
            self.transport.abort()
            return False
        return good

    def _may_come(self, kind: bytes) -> bool:
        if not self._greeted:
            return kind == b"HELF"
        # Before there is a session, a message is of one frame.
        return kind in (b"OPNF", b"MSGF", b"CLOF") or (
            kind in (b"MSGC", b"MSGA") and _standing(self) == 2
        )

    def _expire(self) -> None:
        """End, unless there is a session that was heard of lately."""
        assert self.transport is not None
        left = self._heard + SILENCE - time.monotonic() if _standing(self) == 2 else 0.0
        if left <= 0.0:
            self.transport.abort()
        else:
            self._timer = asyncio.get_running_loop().call_later(left, self._expire)


def _standing(client: OPCUAProtocol) -> int:
    """Return how far a client has come: 0 nowhere, 1 a channel, 2 a session."""
    processor = client.processor
    if processor is None:
        return 0
    if processor.session is not None and processor.session.is_activated():
        return 2
    return int(processor._connection.is_open())
