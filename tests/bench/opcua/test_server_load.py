"""The OPC UA server under clients that err: it ends their connection and serves the others."""

import asyncio
import contextlib
import struct
from types import SimpleNamespace
from unittest.mock import Mock

import pytest
from asyncua import ua
from asyncua.common.utils import Buffer, NotEnoughData
from asyncua.ua import ua_binary

from helpers.opcua_server import known_client
from truenewton.bench.opcua import keys, limits
from truenewton.mirrors.known import ring

GAP = ua.NodeId("Bench.Gap", 2)


@pytest.fixture
def place(served, keys_folder):
    """Give address, keys and port of the server."""
    address = served[1]
    return address, keys_folder, int(address.rpartition(":")[2])


@contextlib.asynccontextmanager
async def session(address, folder):
    """Give a client with a session; it leaves without a word."""
    client = known_client(address, folder)
    client.set_user(keys.USER)
    client.set_password(keys.read_password(folder / keys.PASSWORD))
    try:
        await client.connect()
        yield client
    finally:
        client.disconnect_socket()
        await client.disconnect()


async def gap_by(client):
    return await client.get_node(GAP).read_value()


async def visit(port, message, stay=5.0):
    """Send a message; return the answer, and whether the server ended the connection in time."""
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    heard = bytearray()

    async def listen():
        with contextlib.suppress(ConnectionError):
            while part := await reader.read(65536):
                heard.extend(part)

    writer.write(message)
    listening = asyncio.create_task(listen())
    ended, _ = await asyncio.wait([listening], timeout=stay)
    listening.cancel()
    writer.transport.abort()
    return bytes(heard), bool(ended)


def frame(kind, body, size=None):
    """Return a frame; its size as declared, or as it is."""
    return kind + struct.pack("<I", 8 + len(body) if size is None else size) + body


def text(value):
    return struct.pack("<I", len(value)) + value


def opening(policy, certificate=b""):
    return frame(b"OPNF", bytes(4) + policy + text(certificate) + text(bytes(20)) + bytes(512))


HELLO = frame(b"HELF", struct.pack("<5I", 0, 65535, 65535, 0, 0) + text(b"opc.tcp://127.0.0.1"))
NO_SECURITY = text(b"http://opcfoundation.org/UA/SecurityPolicy#None")
SECURITY = text(b"http://opcfoundation.org/UA/SecurityPolicy#Basic256Sha256")
WRONG = {
    "a web browser": b"GET / HTTP/1.1\r\nHost: localhost\r\n\r\n",
    "too short a length": frame(b"HELF", HELLO[8:], 9),
    "4 GB declared": HELLO + frame(b"OPNF", bytes(4), 0xFFFFFFFF),
    "unknown type": HELLO + frame(b"XYZF", bytes(24)),
    "messages before a channel": HELLO + 2 * frame(b"MSGF", bytes(64)),
    "part of a message before a channel": HELLO + frame(b"MSGC", bytes(64)),
    "no security": HELLO + opening(NO_SECURITY),
    "unknown certificate": HELLO + opening(SECURITY, bytes(900)),
    "length below zero": HELLO + opening(struct.pack("<i", -60)),
}


def test_a_message_that_is_wrong_ends_its_connection_and_the_server_goes_on(place):
    """It hears an acknowledgement of 28 bytes at most, which names buffers."""
    address, folder, port = place

    async def come():
        heard = await asyncio.gather(*(visit(port, message) for message in WRONG.values()))
        async with session(address, folder) as client:
            return heard, await gap_by(client)

    heard, gap = asyncio.run(come())
    for name, (answer, ended) in zip(WRONG, heard, strict=True):
        assert ended, name
        assert answer[:4] in (b"", b"ACKF"), name
        assert len(answer) <= 28, name
    assert gap == ring(8).gap


def test_numbers_of_values_that_a_message_cannot_hold_are_refused():
    with pytest.raises(NotEnoughData, match="a length of -4"):
        Buffer(bytes(20)).read(-4)
    with pytest.raises(ua.UaError, match="an array of nothing"):
        ua_binary.unpack_uatype_array(ua.VariantType.Null, Buffer(struct.pack("<i", 2**31 - 1)))


def test_a_known_client_has_one_session_no_subscription_and_registers_no_server(place):
    address, folder, _ = place

    async def come():
        async with session(address, folder) as client:
            with pytest.raises(ua.uaerrors.BadTooManySessions):
                await client.create_session()
            with pytest.raises(ua.uaerrors.BadTooManySubscriptions):
                await client.create_subscription(100, None)
            with pytest.raises(ua.uaerrors.BadServiceUnsupported):
                await client.uaclient.register_server(ua.RegisteredServer(ServerUri="urn:me"))
            return await gap_by(client)

    assert asyncio.run(come()) == ring(8).gap


def test_a_client_that_reads_no_answer_is_put_out():
    protocol = SimpleNamespace(transport=Mock())
    limits.BoundedProtocol.pause_writing(protocol)
    protocol.transport.abort.assert_called_once_with()


def test_a_client_without_a_session_in_time_and_a_silent_one_are_put_out(place, monkeypatch):
    monkeypatch.setattr(limits, "BEFORE_SESSION", 2.0)
    monkeypatch.setattr(limits, "SILENCE", 1.0)
    address, folder, port = place

    async def come(pause, times):
        async with session(address, folder) as client:
            for _ in range(times):
                await asyncio.sleep(pause)
                await gap_by(client)

    async def all_of_them():
        return await asyncio.gather(
            visit(port, HELLO), come(0.4, 7), come(3.0, 1), return_exceptions=True
        )

    (answer, ended), lively, silent = asyncio.run(all_of_them())
    assert (answer[:4], ended) == (b"ACKF", True)
    assert lively is None
    assert isinstance(silent, OSError | ua.UaError)


def test_a_newcomer_takes_the_place_of_a_client_without_a_session_only(place, monkeypatch):
    monkeypatch.setattr(limits, "CONNECTIONS", 2)
    address, folder, port = place

    async def come():
        await asyncio.sleep(0.5)  # the clients before are gone
        async with session(address, folder) as one:
            silent = asyncio.create_task(visit(port, HELLO))
            await asyncio.sleep(0.2)
            async with session(address, folder) as two:
                refused = await visit(port, HELLO)
                return await silent, refused, [await gap_by(each) for each in (one, two)]

    (answer, ended), refused, gaps = asyncio.run(come())
    assert (answer[:4], ended) == (b"ACKF", True)
    assert refused == (b"", True)
    assert gaps == [ring(8).gap] * 2
