"""The OPC UA server of `truenewton serve` under a bounded load of strangers, on the loopback.

    python benchmarks/server_load.py [cycles of the campaign, 4]

A sound client takes a campaign meanwhile, in a process of its own. 200 strangers at a time come
without keys, with frames that are wrong, slow, endless, cut or replayed; 8 holders of a trusted key
come without the password, or with it and do what they may not. Memory and open files are the
server's, from /proc (Linux).
"""

import asyncio
import contextlib
import itertools
import multiprocessing
import os
import random
import signal
import socket
import struct
import subprocess
import sys
import tempfile
import time
import tomllib
from collections import Counter
from collections.abc import AsyncIterator, Awaitable, Callable, Iterable, Iterator
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from asyncua import Client, ua
from asyncua.common.connection import MessageChunk
from asyncua.crypto.security_policies import SecurityPolicyBasic256Sha256
from asyncua.ua.ua_binary import nodeid_to_binary, struct_to_binary

import truenewton as tn
from truenewton.bench.choice import BenchChoice
from truenewton.bench.opcua import keys
from truenewton.bench.opcua.client import OpcUaBench
from truenewton.bench.simulated.static import static_bench
from truenewton.mirrors.known import p45

AT_ONCE, HOLDERS = 200, 8  # strangers, and those with keys
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
    client = Client(address, timeout=10.0)
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
