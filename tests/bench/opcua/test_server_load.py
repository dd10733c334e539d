"""The OPC UA server under strangers: sound clients go on, bounds hold, and nothing is told."""

import asyncio
import random
import signal
import struct
import sys
import threading

import pytest
from asyncua import ua

import truenewton as tn
from helpers.opcua_server import RecordingBench, behind, free_port, memory_and_files, serve
from helpers.opcua_strangers import DEEDS, HELLO, channel, do, record, strangers, visit
from truenewton.acquisition.plan import PlannedShapes
from truenewton.bench.choice import BenchChoice
from truenewton.bench.opcua import connect, keys, limits
from truenewton.bench.simulated.static import static_bench
from truenewton.mirrors.known import p45

BOUND = (
    48.0  # of what the load adds to the server's memory; 8 deaf clients took 400 unbounded [MiB]
)
GAP = ua.NodeId("Bench.Gap", 2)
LINUX = sys.platform.startswith("linux")  # has /proc


@pytest.fixture(scope="module")
def served(tmp_path_factory):
    """`truenewton serve` in a process of its own, its keys, port and table for a plan."""
    folder, port = tmp_path_factory.mktemp("load") / "keys", free_port()
    with serve(folder, port) as (server, table):
        yield server, folder, port, table


@pytest.mark.study
def test_a_campaign_goes_on_under_200_strangers_who_learn_nothing(served, tmp_path):
    server, folder, port, table = served
    loads = static_bench(p45(), 1).loads
    plan = tn.CampaignPlan(
        "p45", loads, cycles=1, samples=16, shapes=PlannedShapes(count=4),
        bench=BenchChoice(**table),
    )  # fmt: skip
    ended, files = [], []

    def campaign():
        with connect(plan.bench) as bench:
            ended.append(len(tn.acquire(bench, plan, tmp_path / "campaign")))

    certificate = (folder / keys.CLIENT_CERTIFICATE).read_bytes()
    recorded = asyncio.run(record(port, folder))
    kinds = strangers(certificate, recorded, megabytes=2)
    names = [name for name in kinds for _ in range(200 // len(kinds) + 1)]
    random.Random(1).shuffle(names)
    before = memory_and_files(server.pid)[0] if LINUX else 0.0

    async def come(name):
        _, heard, _ = await visit(port, kinds[name](), stay=2.0, deaf="endless" in name)
        if LINUX:
            files.append(memory_and_files(server.pid)[1])
        return name, heard

    async def all_of_them():
        return await asyncio.gather(*map(come, names))

    taking = threading.Thread(target=campaign)
    taking.start()
    heard = asyncio.run(all_of_them())
    taking.join()
    assert ended == [2]
    assert [int(cycle.valid.sum()) for cycle in tn.read(tmp_path / "campaign").cycles] == [8, 8]
    assert len(heard) >= 200
    for name, answer in heard:
        # An acknowledgement of 28 bytes, which names buffers; who replays, the opening of a
        # channel to the one who was recorded, too.
        assert len(answer) <= 28 or "replayed" in name, name
        assert answer[:4] in (b"", b"ACKF"), name
        assert b"P45" not in answer, name
        assert b"Bench" not in answer, name
    if LINUX:
        assert max(files) < limits.CONNECTIONS + 100 + 16  # 100 are accepted at a time
        assert memory_and_files(server.pid)[0] - before < BOUND


def test_holders_of_keys_do_no_harm_either(served):
    server, folder, port, _ = served
    before = memory_and_files(server.pid)[0] if LINUX else 0.0
    for name in DEEDS:
        assert asyncio.run(do(f"opc.tcp://127.0.0.1:{port}", folder, name)), name
    if LINUX:
        assert memory_and_files(server.pid)[0] - before < BOUND


@pytest.mark.skipif(sys.platform == "win32", reason="no signals")
def test_the_server_ends_in_peace_after_all_that(served):
    server, _, port, _ = served
    asyncio.run(visit(port, [HELLO], stay=0.1))
    server.send_signal(signal.SIGTERM)
    out, err = server.communicate(timeout=30)
    assert (server.returncode, out, err) == (0, "", "")


# -- one by one, with bounds that are soon reached ------------------------------------------------


@pytest.fixture(scope="module")
def here(tmp_path_factory):
    """A server in this process, its address and keys."""
    folder = tmp_path_factory.mktemp("load-here") / "keys"
    keys.make_keys(folder)
    with behind(RecordingBench(), folder, free_port()) as address:
        yield address, folder, int(address.rpartition(":")[2])


def test_who_has_no_session_in_time_is_put_out(here, monkeypatch):
    port = here[2]
    monkeypatch.setattr(limits, "BEFORE_SESSION", 0.3)

    async def come():
        drip = (HELLO[i : i + 1] for i in range(len(HELLO)))
        return await asyncio.gather(
            visit(port, [], stay=8.0),
            visit(port, [HELLO], stay=8.0),
            visit(port, drip, pause=0.3, stay=8.0),
        )

    assert [out for _, _, out in asyncio.run(come())] == [True] * 3


def test_who_is_silent_for_long_is_put_out_and_who_speaks_is_not(here, monkeypatch):
    address, folder, _ = here
    monkeypatch.setattr(limits, "BEFORE_SESSION", 2.0)
    monkeypatch.setattr(limits, "SILENCE", 1.0)

    async def come(pause, times):
        async with channel(address, folder, keys.USER) as client:
            for _ in range(times):
                await asyncio.sleep(pause)
                await client.get_node(GAP).read_value()

    async def both():
        return await asyncio.gather(come(0.5, 7), come(3.5, 1), return_exceptions=True)

    lively, silent = asyncio.run(both())
    assert lively is None
    assert isinstance(silent, OSError | ua.UaError)


def test_a_newcomer_gets_in_where_silent_strangers_hold_all_places(here, monkeypatch):
    address, folder, port = here
    monkeypatch.setattr(limits, "CONNECTIONS", 6)

    async def come():
        silent = [asyncio.create_task(visit(port, [HELLO])) for _ in range(6)]
        await asyncio.sleep(0.2)
        async with (
            channel(address, folder, keys.USER) as one,
            channel(address, folder, keys.USER) as two,
        ):
            gaps = [await each.get_node(GAP).read_value() for each in (one, two)]
            return gaps, [task.done() for task in silent]

    assert asyncio.run(come()) == ([65e-6] * 2, [True] * 2 + [False] * 4)


def test_where_all_have_sessions_a_newcomer_is_refused(here, monkeypatch):
    address, folder, port = here
    monkeypatch.setattr(limits, "CONNECTIONS", 1)

    async def come():
        await asyncio.sleep(0.2)  # who came before is gone
        async with channel(address, folder, keys.USER) as client:
            refused = await visit(port, [HELLO], stay=5.0)
            return refused, await client.get_node(GAP).read_value()

    (_, heard, out), gap = asyncio.run(come())
    assert (heard, out, gap) == (b"", True, 65e-6)


def test_frames_that_come_in_pieces_or_together_are_the_same_frames(here):
    """What a network does to a sound client; and its channel is renewed under way."""
    address, folder, port = here
    recorded = asyncio.run(record(port, folder))
    (size,) = struct.unpack_from("<I", recorded, 4)
    opened = size + struct.unpack_from("<I", recorded, size + 4)[0]

    async def answers(pieces):
        return (await visit(port, pieces, stay=1.0))[1]

    whole = asyncio.run(answers([recorded[:opened]]))
    single = asyncio.run(answers(recorded[i : i + 1] for i in range(opened)))
    assert whole[:4] == single[:4] == b"ACKF"
    assert len(whole) == len(single) > 1000  # the opening answered, though not to us

    async def renew():
        async with channel(address, folder, keys.USER) as client:
            for _ in range(3):
                await client.open_secure_channel(renew=True)
                await client.get_node(GAP).read_value()
            values = list(range(200_000))
            with pytest.raises(ua.UaError):  # many frames, and no right to write
                await client.get_node(GAP).write_value(values, ua.VariantType.Double)
            return await client.get_node(GAP).read_value()

    assert asyncio.run(renew()) == 65e-6
