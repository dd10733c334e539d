"""Strangers to an OPC UA server, and holders of keys who do what they may not (server_load.py)."""

import asyncio
import contextlib
import itertools
import os
import struct
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Iterable, Iterator
from pathlib import Path

from asyncua import Client, ua
from asyncua.common.connection import MessageChunk
from asyncua.crypto.security_policies import SecurityPolicyBasic256Sha256
from asyncua.ua.ua_binary import nodeid_to_binary, struct_to_binary

from truenewton.bench.opcua import keys

MEBI = 2**20


# -- strangers -----------------------------------------------------------------------------------


def frame(kind: bytes, body: bytes = b"", size: int | None = None) -> bytes:
    """Return a frame; its size as declared, or as it is."""
    return kind + struct.pack("<I", 8 + len(body) if size is None else size) + body


def text(value: bytes) -> bytes:
    return struct.pack("<I", len(value)) + value


HELLO = frame(b"HELF", struct.pack("<5I", 0, 65535, 65535, 0, 0) + text(b"opc.tcp://127.0.0.1"))
NO_SECURITY = text(b"http://opcfoundation.org/UA/SecurityPolicy#None")
SECURITY = text(b"http://opcfoundation.org/UA/SecurityPolicy#Basic256Sha256")


def opening(policy: bytes, certificate: bytes, rest: bytes) -> bytes:
    return frame(b"OPNF", bytes(4) + policy + text(certificate) + text(bytes(20)) + rest)


def strangers(
    certificate: bytes, recorded: bytes, megabytes: int = 16
) -> dict[str, Callable[[], Iterable[bytes]]]:
    """Return what strangers send, by what they are, piece by piece.

    Parameters
    ----------
    certificate
        A trusted one (DER), which is no secret.
    recorded
        What a sound client sent.
    megabytes
        How much is sent where there is no end.
    """
    block = bytes(65536)

    def endless(piece: bytes) -> Iterator[bytes]:
        return itertools.repeat(piece, megabytes * MEBI // len(piece))

    huge = frame(b"OPNF", bytes(4), 0xFFFFFFFF)
    return {
        "silent": lambda: [],
        "hello, then silent": lambda: [HELLO],
        "a byte at a time": lambda: (HELLO[i : i + 1] for i in range(len(HELLO))),
        "endless hello": lambda: endless(HELLO * 512),
        "a web browser": lambda: [b"GET / HTTP/1.1\r\nHost: localhost\r\n\r\n"],
        "noise": lambda: [os.urandom(4096)],
        "unknown type": lambda: [HELLO, frame(b"XYZF", bytes(8))],
        "endless unknown type": lambda: itertools.chain(
            [HELLO], endless(frame(b"ACKF", bytes(20)) * 1000)
        ),
        "no length": lambda: [frame(b"HELF", HELLO[8:], 0)],
        "too short a length": lambda: [frame(b"HELF", HELLO[8:], 9)],
        "4 GB declared and begun": lambda: itertools.chain([HELLO, huge], endless(block)),
        "4 GB of hello": lambda: itertools.chain([frame(b"HELF", b"", 0xFFFFFFFF)], endless(block)),
        "cut in the middle": lambda: [HELLO, recorded[len(HELLO) : len(HELLO) + 700]],
        "message before a channel": lambda: [HELLO, frame(b"MSGF", bytes(64))],
        "chunks before a channel": lambda: itertools.chain(
            [HELLO], endless(frame(b"MSGC", bytes(8000)))
        ),
        "no security": lambda: [HELLO, opening(NO_SECURITY, b"", bytes(100))],
        "unknown certificate": lambda: [HELLO, opening(SECURITY, bytes(900), bytes(512))],
        "trusted certificate without its key": lambda: itertools.chain(
            [HELLO], itertools.repeat(opening(SECURITY, certificate, os.urandom(512)), 50)
        ),
        "lengths below zero": lambda: [HELLO, opening(struct.pack("<i", -60), b"", bytes(64))],
        "recorded and replayed": lambda: [recorded],
        "recorded and replayed twice": lambda: [recorded, recorded],
        "tiny buffers": lambda: [
            frame(b"HELF", bytes(4) + struct.pack("<4I", 0, 0, 1, 1) + text(b""))
        ],
    }


async def visit(
    port: int, pieces: Iterable[bytes], *, pause: float = 0.0, stay: float = 60.0,
    deaf: bool = False,
) -> tuple[int, bytes, bool]:  # fmt: skip
    """Come, say all pieces, listen; return bytes sent, what was heard, and whether we were put out.

    Parameters
    ----------
    port
        Of the server.
    pieces, pause
        What is said, and how long to wait after each [s].
    stay
        For so long at most [s].
    deaf
        Whether answers are left unread.
    """
    sent, heard, out = 0, b"", False

    async def talk(writer: asyncio.StreamWriter) -> None:
        nonlocal sent
        for piece in pieces:
            writer.write(piece)
            await writer.drain()
            sent += len(piece)
            await asyncio.sleep(pause)

    async def listen(reader: asyncio.StreamReader) -> None:
        nonlocal heard, out
        while not deaf:
            more = await reader.read(65536)
            if not more:
                out = True
                return
            heard += more

    try:
        reader, writer = await asyncio.open_connection("127.0.0.1", port)
    except OSError:
        return 0, b"", True
    ours = [asyncio.create_task(talk(writer)), asyncio.create_task(listen(reader))]
    try:
        await asyncio.wait(ours, timeout=stay)
    finally:
        for task in ours:
            task.cancel()
        writer.transport.abort()
    for result in await asyncio.gather(*ours, return_exceptions=True):
        out = out or isinstance(result, OSError)
    return sent, heard, out


# -- holders of keys -----------------------------------------------------------------------------


@contextlib.asynccontextmanager
async def channel(address: str, folder: Path, user: str = "") -> AsyncIterator[Client]:
    """Give a client with a trusted certificate; with a session where there is a user.

    It leaves without a word.
    """
    client = Client(address, timeout=10.0, watchdog_intervall=60.0)  # silent by itself
    client.application_uri = keys.CLIENT_URI
    client.security_policy = SecurityPolicyBasic256Sha256(
        keys.read_certificate(folder / keys.SERVER_CERTIFICATE),
        keys.read_certificate(folder / keys.CLIENT_CERTIFICATE),
        keys.read_private_key(folder / keys.CLIENT_KEY),
        ua.MessageSecurityMode.SignAndEncrypt,
    )
    client.uaclient.set_security(client.security_policy)
    if user:
        client.set_user(user)
        client.set_password(keys.read_password(folder / keys.PASSWORD))
    try:
        await (client.connect() if user else client.connect_sessionless())
        yield client
    finally:
        protocol = client.uaclient.protocol
        if protocol is not None and protocol.transport is not None:
            protocol.transport.abort()
        await client.disconnect()


def post(client: Client, body: bytes, *, last: bool = True, skip: int = 1, spoil: int = 0) -> None:
    """Send one frame on an open channel, and wait for nothing.

    Parameters
    ----------
    client
        Whose channel.
    body
        Of the message, or a part of it.
    last
        Whether it is the last part.
    skip
        By how much the sequence number grows.
    spoil
        What is added to the last byte.
    """
    protocol = client.uaclient.protocol
    if protocol is None or protocol.transport is None:
        raise ConnectionError
    connection = protocol._connection
    token = connection.security_token
    (chunk,) = MessageChunk.message_to_chunks(
        connection.security_policy, body, 65535, channel_id=token.ChannelId, request_id=99,
        token_id=token.TokenId,
    )  # fmt: skip
    if not last:
        chunk.MessageHeader.ChunkType = ua.ChunkType.Intermediate
    connection._sequence_number += skip
    chunk.SequenceHeader.SequenceNumber = connection._sequence_number
    sent = chunk.to_binary()
    protocol.transport.write(sent[:-1] + bytes([(sent[-1] + spoil) % 256]))


async def put_out(client: Client, seconds: float = 10.0) -> bool:
    """Return whether the server ends the connection in time."""
    protocol = client.uaclient.protocol
    end = time.monotonic() + seconds
    while protocol is not None and protocol.transport is not None:
        if time.monotonic() > end:
            return False
        await asyncio.sleep(0.02)
    return True


def request(kind: int, parameters: bytes) -> bytes:
    """Return the body of a request, its parameters as they come."""
    return nodeid_to_binary(ua.NodeId(kind)) + struct_to_binary(ua.RequestHeader()) + parameters


LENGTHS = struct.pack("<i", -1) + struct.pack("<i", 2**31 - 1) + struct.pack("<i", -4) * 4
ENDPOINTS = ua.ObjectIds.GetEndpointsRequest_Encoding_DefaultBinary
CALL = ua.ObjectIds.CallRequest_Encoding_DefaultBinary


async def out_of_order(client: Client) -> bool:
    post(client, request(ENDPOINTS, bytes(12)), skip=5)
    return await put_out(client)


async def wrong_signature(client: Client) -> bool:
    post(client, request(ENDPOINTS, bytes(12)), spoil=1)
    return await put_out(client)


async def bottomless(client: Client) -> bool:
    """Send 2^31 texts in 20 bytes."""
    post(client, request(ENDPOINTS, LENGTHS))
    with contextlib.suppress(ua.UaError, OSError):
        await client.get_endpoints()
    return True


async def parts_without_session(client: Client) -> bool:
    post(client, bytes(60000), last=False)
    return await put_out(client)


async def many_sessions(client: Client) -> bool:
    await client.create_session()
    for _ in range(20):
        try:
            await client.create_session()
        except ua.uaerrors.BadTooManySessions:
            continue
        return False
    return True


async def registers(client: Client) -> bool:
    server = ua.RegisteredServer(ServerUri="urn:me", ServerNames=[ua.LocalizedText("me")])
    try:
        await client.uaclient.register_server(server)
    except ua.uaerrors.BadServiceUnsupported:
        return True
    return False


async def deaf(client: Client) -> bool:
    """Ask for ever more, and read no answer: until the server has enough of it."""
    protocol = client.uaclient.protocol
    assert protocol is not None
    assert protocol.transport is not None
    protocol.transport.pause_reading()
    asked = 0
    with contextlib.suppress(ConnectionError):
        while asked < 200_000:
            post(client, request(ENDPOINTS, struct.pack("<3i", -1, -1, -1)))
            asked += 1
            await asyncio.sleep(0)
    return asked < 200_000


async def huge_message(client: Client) -> bool:
    with contextlib.suppress(ConnectionError):
        for _ in range(64 * MEBI // 60000):
            post(client, bytes(60000), last=False)
            await asyncio.sleep(0)
    return await put_out(client)


async def array_of_nothing(client: Client) -> bool:
    """Send an argument of 2^31 nothings."""
    method = nodeid_to_binary(ua.NodeId("Bench", 2)) + nodeid_to_binary(ua.NodeId("Bench.Rest", 2))
    nothings = struct.pack("<i", 1) + b"\x80" + struct.pack("<i", 2**31 - 1)
    post(client, request(CALL, struct.pack("<i", 1) + method + nothings))
    with contextlib.suppress(ua.UaError, OSError):
        await client.get_node(ua.NodeId("Bench.Gap", 2)).read_value()
    return True


async def subscribes(client: Client) -> bool:
    try:
        await client.create_subscription(100, None)
    except ua.uaerrors.BadTooManySubscriptions:
        return True
    return False


async def leaves_in_the_middle(client: Client) -> bool:
    reading = ua.CallMethodRequest(
        ua.NodeId("Bench", 2), ua.NodeId("Bench.Read", 2), [ua.Variant(10, ua.VariantType.Int32)]
    )
    asyncio.ensure_future(client.uaclient.call([reading])).cancel()
    return True


# What they do, which returns whether the server bears it; and whether they know the password.
Deed = Callable[[Client], Awaitable[bool]]
DEEDS: dict[str, tuple[Deed, bool]] = {
    "frames out of order": (out_of_order, False),
    "wrong signature": (wrong_signature, False),
    "2^31 texts in 20 bytes": (bottomless, False),
    "parts without a session": (parts_without_session, False),
    "many sessions": (many_sessions, False),
    "registers servers": (registers, False),
    "reads no answer": (deaf, False),
    "64 MiB in parts": (huge_message, True),
    "2^31 nothings in 5 bytes": (array_of_nothing, True),
    "subscribes": (subscribes, True),
    "leaves in the middle": (leaves_in_the_middle, True),
}


async def do(address: str, folder: Path, name: str) -> bool:
    """Come with keys, do something, and leave; return whether the server bore it."""
    deed, known = DEEDS[name]
    async with channel(address, folder, keys.USER if known else "") as client:
        return await deed(client)


async def record(port: int, folder: Path) -> bytes:
    """Return what a sound client sends, from hello to one value read."""
    sent = bytearray()

    async def between(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        server_reader, server_writer = await asyncio.open_connection("127.0.0.1", port)

        async def pass_on(
            source: asyncio.StreamReader, sink: asyncio.StreamWriter, note: bytearray
        ) -> None:
            with contextlib.suppress(OSError):
                while data := await source.read(65536):
                    note += data
                    sink.write(data)
            sink.close()

        await asyncio.gather(
            pass_on(reader, server_writer, sent), pass_on(server_reader, writer, bytearray())
        )

    relay = await asyncio.start_server(between, "127.0.0.1", 0)
    async with relay:
        here = relay.sockets[0].getsockname()[1]
        async with channel(f"opc.tcp://127.0.0.1:{here}", folder, keys.USER) as client:
            await client.get_node(ua.NodeId("Bench.Gap", 2)).read_value()
    return bytes(sent)
