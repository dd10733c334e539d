"""The bench over real OPC UA on the loopback: the same to the bit, and closed to strangers."""

import asyncio
import contextlib
import dataclasses
import signal
import socket
import stat
import subprocess
import sys
import time
import tomllib

import numpy as np
import pytest
from asyncua import Client, ua

import truenewton as tn
from helpers.opcua_server import RecordingBench, behind, choice, free_port, known_client
from truenewton.acquisition.acquire import chosen_bench
from truenewton.bench.opcua import connect, keys
from truenewton.bench.opcua.client import OpcUaBench
from truenewton.bench.opcua.methods import METHODS, scalar
from truenewton.bench.protocol import Bench, BenchChoice, Operator, Reading, Shape
from truenewton.bench.simulated.loop import SAMPLES
from truenewton.bench.simulated.static import static_bench
from truenewton.errors import BenchFault, FormatError, UnknownName, UnreadableFile
from truenewton.mirrors.known import ring

BARE = tn.Load("bare")


# -- the same as in process ----------------------------------------------------------------------


def test_a_served_bench_gives_what_the_bench_gives_to_the_bit(recorder, keys_folder):
    here, plan = tn.SimulatedBench(ring(8), 3), static_bench(ring(8), 3)
    with connect(choice(recorder[1]), keys_folder) as there:
        _bench: Bench = there
        _operator: Operator = there
        assert (there.instrument, there.gap) == (here.instrument, here.gap)
        for name in ("id", "x", "y", "nz", "enabled"):
            ours, theirs = getattr(here.layout, name), getattr(there.layout, name)
            assert theirs.dtype == ours.dtype
            assert np.array_equal(theirs, ours)
        for load in plan.loads:
            for bench in (here, there):
                bench.put_on(load)
            for number, sign in ((1, 1), (1, -1), (8, 1)):
                readings = []
                for bench in (here, there):
                    bench.command(Shape(load, 2, number, sign, sign * plan.shapes[number - 1]))
                    assert bench.status().message == "in shape"
                    readings.append(bench.read(SAMPLES))
                for field in dataclasses.fields(Reading):
                    ours, theirs = (getattr(reading, field.name) for reading in readings)
                    assert type(theirs) is type(ours)
                    assert np.array_equal(theirs, ours), field.name
        there.rest()
        here.rest()
        assert there.status() == here.status()


def test_our_own_server_declares_the_methods_of_the_page(recorder, keys_folder):
    """What each takes and gives, with its type, as a browser of OPC UA sees it."""
    with connect(choice(recorder[1]), keys_folder) as there:

        async def declared(name):
            node = there._client.get_node(ua.NodeId(f"Bench.{name}", there._space))
            sides = {(await one.read_browse_name()).Name: await one.read_value()
                     for one in await node.get_properties()}  # fmt: skip
            return [
                [(one.Name, one.DataType.Identifier, one.ValueRank > 0)
                 for one in sides.get(which, ())]
                for which in ("InputArguments", "OutputArguments")
            ]  # fmt: skip

        for name, (takes, gives) in METHODS.items():
            assert there._thread.post(declared(name)) == [
                [(each, scalar(kind).value, isinstance(kind, list)) for each, kind in arguments]
                for arguments in (takes, [("Fault", [ua.VariantType.String]), *gives])
            ]


def test_serve_then_a_campaign_over_opc_ua_recovers_alpha(tmp_path):
    """The command in a process of its own; a person pastes what it prints into a plan.

    A client that sends no OPC UA, and one that does not leave, change nothing.
    """
    port, seed = free_port(), 5
    bench = static_bench(ring(8), seed)
    command = [sys.executable, "-m", "truenewton", "serve", "ring8", "--port", str(port),
               "--seed", str(seed), "-o", str(tmp_path / "keys")]  # fmt: skip
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as server:
        try:
            printed = [server.stdout.readline() for _ in range(10)]
            table = tomllib.loads("".join(printed[1:]))["bench"]
            with socket.create_connection(("127.0.0.1", port)) as stranger:
                stranger.sendall(b"GET / HTTP/1.1\r\n\r\n")
            stays = socket.create_connection(("127.0.0.1", port))
            plan = tn.CampaignPlan(
                "ring8", bench.loads, cycles=2, settling=0.0, bench=BenchChoice(**table)
            )
            with chosen_bench(plan, tmp_path) as there:
                tn.acquire(there, plan, tmp_path / "campaign", beside=tmp_path)
        finally:
            server.send_signal(signal.SIGINT)
            out, err = server.communicate(timeout=20)
            stays.close()
    assert (server.returncode, out, err) == (0, "", "")
    found = tn.calibrate(tn.read(tmp_path / "campaign"))
    expected = bench.truth.alpha * bench.loads[1].added / bench.truth.added[1]
    pull = (found.alpha - expected) / found.statistical_error
    assert 0.1 < np.abs(pull).max() < 4.5
    assert found.statistical_error.max() < 3e-3
    assert found.goodness.probability > 0.01


# -- strangers get nothing -----------------------------------------------------------------------


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"user": "admin"}, "refuses user 'admin'"),
        ({"password_file": "wrong"}, "refuses user 'operator'"),
        # The server's own identity is not among the clients that it trusts.
        (
            {"certificate": keys.SERVER_CERTIFICATE, "private_key": keys.SERVER_KEY},
            "refuses user 'operator'",
        ),
        ({"private_key": keys.SERVER_KEY}, "cannot be reached"),
        ({"server_certificate": keys.CLIENT_CERTIFICATE}, "cannot be reached"),
    ],
    ids=["user", "password", "certificate", "signature", "server"],
)
def test_a_client_with_one_wrong_credential_gets_nothing(
    recorder, keys_folder, tmp_path, monkeypatch, change, said
):
    bench, address = recorder
    if "password_file" in change:
        wrong = tmp_path / "wrong.txt"
        keys._write_secret(wrong, b"nothing\n")
        change = {"password_file": str(wrong)}
    if said == "cannot be reached":  # a refusal may take its time
        monkeypatch.setattr(OpcUaBench, "_patience", 0.5)
    with pytest.raises(BenchFault, match=said) as fault:
        OpcUaBench(choice(address, **change), keys_folder)
    assert str(fault.value).startswith(f"{address}: ")
    assert "\n" not in str(fault.value)
    assert bench.asked == []


async def refused(client, *steps):
    """Take steps without a right to them; each must fail, or bring nothing."""
    client.uaclient.protocol.timeout = 0.5
    request = ua.CallMethodRequest(ua.NodeId("Bench", 2), ua.NodeId("Bench.Rest", 2), [])
    instrument = client.get_node(ua.NodeId("Bench.Instrument", 2))
    try:
        for step in (*steps, instrument.read_value, lambda: client.uaclient.call([request])):
            with pytest.raises((ua.UaError, OSError, TimeoutError)):
                await asyncio.wait_for(step(), 2.0)
    finally:
        client.uaclient.disconnect_socket()
        await asyncio.sleep(0.05)


def test_an_anonymous_client_with_a_trusted_certificate_gets_nothing(recorder, keys_folder):
    bench, address = recorder

    async def come():
        client = known_client(address, keys_folder)
        await client.connect_sessionless()
        await client.create_session()
        await refused(client, client.activate_session)

    asyncio.run(come())
    assert bench.asked == []


def test_a_channel_that_is_only_signed_is_not_opened(recorder, keys_folder):
    async def come():
        client = known_client(recorder[1], keys_folder, ua.MessageSecurityMode.Sign)
        await client.connect_socket()
        await client.send_hello()
        with pytest.raises(TimeoutError):
            await asyncio.wait_for(client.open_secure_channel(), 0.5)
        client.uaclient.disconnect_socket()

    asyncio.run(come())


def test_a_channel_without_security_gives_nothing_even_with_the_password(recorder, keys_folder):
    bench, address = recorder
    password = keys.read_password(keys_folder / keys.PASSWORD).encode()
    who = ua.UserNameIdentityToken(PolicyId="username", UserName=keys.USER, Password=password)

    async def come():
        client = Client(address)
        await client.connect_socket()
        await client.send_hello()
        await client.open_secure_channel()
        await client.uaclient.create_session(ua.CreateSessionParameters())
        logon = ua.ActivateSessionParameters(UserIdentityToken=who)
        await refused(client, lambda: client.uaclient.activate_session(logon))

    asyncio.run(come())
    assert bench.asked == []


def test_a_client_does_not_take_over_the_session_of_another(recorder, keys_folder):
    """Its number can be guessed; the client here even knows it, and has a trusted certificate."""
    bench, address = recorder
    with connect(choice(address), keys_folder) as there:
        token = there._client.uaclient.session.authentication_token

        async def come():
            client = known_client(address, keys_folder)
            await client.connect_sessionless()
            client.uaclient.session.restore_authentication_token(token)
            client._server_nonce = b"guess"
            client._policy_ids = there._client._policy_ids
            await refused(client, client.activate_session)

        asyncio.run(come())
        assert bench.asked == []
        there.rest()
        node = there._client.get_node(ua.NodeId("Bench.Gap", 2))
        for change in (
            node.write_value(list(range(200_000)), ua.VariantType.Double),  # of many frames
            there._client.nodes.objects.add_object(2, "mine"),
        ):
            with pytest.raises(ua.UaError):  # its owner may write nothing
                there._thread.post(change)
    assert bench.asked == ["rest"]


# -- servers that go and come, faults ------------------------------------------------------------


@pytest.mark.study
def test_the_connection_comes_back_with_the_server(keys_folder):
    port, shape = free_port(), Shape(BARE, 1, 1, 1, np.zeros(8))
    with behind(RecordingBench(), keys_folder, port) as address:
        there = OpcUaBench(choice(address), keys_folder)
        there.put_on(BARE)
        there.command(shape)
    with there:
        there._patience = 0.3  # nobody is there
        for method in (there.status, there.rest, lambda: there.read(1)):
            with pytest.raises(
                BenchFault, match=f"^{address}: the server cannot be reached"
            ) as fault:
                method()
            assert "\n" not in str(fault.value)
        there._patience = 10.0
        bench = RecordingBench()
        with behind(bench, keys_folder, port):
            with pytest.raises(BenchFault, match="was lost since the shape was commanded"):
                there.read(1)
            with pytest.raises(BenchFault, match="but no load is on the mirror"):
                there.command(shape)
            assert bench.asked == []
            there.put_on(BARE)
            there.command(shape)
            assert np.isfinite(there.read(1).force).all()
        with (
            behind(RecordingBench(9), keys_folder, port),
            pytest.raises(BenchFault, match="is no longer that of RING8 with its 8"),
        ):
            there.put_on(BARE)


def test_a_connection_that_breaks_comes_back_and_no_row_is_taken_blindly(recorder, keys_folder):
    _, address = recorder
    shape = Shape(BARE, 1, 1, 1, np.zeros(8))
    with connect(choice(address), keys_folder) as there:
        there.put_on(BARE)
        there.command(shape)
        there._thread.loop.call_soon_threadsafe(there._client.disconnect_socket)
        with pytest.raises(BenchFault, match="command it again"):
            there.read(1)
        there.command(shape)  # the server still knows which load it is
        assert np.isfinite(there.read(1).force).all()


def test_a_bench_that_does_not_answer_is_a_fault(recorder, keys_folder, monkeypatch):
    bench, address = recorder
    monkeypatch.setattr(OpcUaBench, "_timeout", 1.5)
    with OpcUaBench(choice(address), keys_folder) as there:
        there.put_on(BARE)
        bench.seconds = 2.5
        with pytest.raises(BenchFault, match=r"does not answer Status within 1\.5 s"):
            there.status()
        bench.seconds = 0.0
        time.sleep(1.0)
        there.rest()


def test_what_the_bench_raises_comes_out_as_it_is(recorder, keys_folder):
    bench, address = recorder
    here = tn.SimulatedBench(ring(8), 3)
    with connect(choice(address), keys_folder) as there:
        for raise_it, kind in (
            (lambda one: one.put_on(tn.Load("anvil")), UnknownName),
            (lambda one: one.read(10), BenchFault),
        ):
            with pytest.raises(kind) as ours:
                raise_it(here)
            with pytest.raises(kind) as theirs:
                raise_it(there)
            assert str(theirs.value) == str(ours.value)
            assert theirs.value.remedy == ours.value.remedy
        there.put_on(BARE)
        with pytest.raises(BenchFault, match="3 displacements for 8"):
            there.command(Shape(BARE, 1, 1, 1, np.zeros(3)))
        with pytest.raises(BenchFault, match=r"is for load 'ring', .* 'bare' is on the mirror"):
            there.command(Shape(tn.Load("ring"), 1, 1, 1, np.zeros(8)))
        with pytest.raises(BenchFault, match="not finite"):
            there.command(Shape(BARE, 1, 1, 1, np.full(8, np.nan)))
        bench.fault = ZeroDivisionError("a slip")
        with pytest.raises(BenchFault, match=r"fails in Rest \(BadUnexpectedError\)"):
            there.rest()


# -- keys ----------------------------------------------------------------------------------------


def test_keys_are_the_owners_alone_and_made_once(keys_folder):
    assert stat.S_IMODE(keys_folder.stat().st_mode) == 0o700
    for name in (keys.PASSWORD, keys.SERVER_KEY, keys.CLIENT_KEY):
        assert stat.S_IMODE((keys_folder / name).stat().st_mode) == 0o600
    before = keys.read_password(keys_folder / keys.PASSWORD)
    assert len(before) > 40
    keys.make_keys(keys_folder)
    assert keys.read_password(keys_folder / keys.PASSWORD) == before


def test_keys_that_cannot_be_used_are_refused_in_one_line(tmp_path, keys_folder, monkeypatch):
    loose = tmp_path / "password.txt"
    loose.write_text("secret\n")
    loose.chmod(0o640)
    with pytest.raises(UnreadableFile, match="may be read by others"):
        keys.read_password(loose)
    with pytest.raises(UnreadableFile, match="No such file"):
        keys.read_private_key(tmp_path / "none.pem")
    loose.chmod(0o600)
    with pytest.raises(FormatError, match="is not an RSA private key"):
        keys.read_private_key(loose)
    with pytest.raises(FormatError, match="is not a certificate"):
        keys.read_certificate(loose)
    loose.write_text("\n")
    with pytest.raises(FormatError, match="contains no password"):
        keys.read_password(loose)
    with pytest.raises(BenchFault, match=r"needs bench\.server_certificate"):
        connect(choice("opc.tcp://127.0.0.1:1", server_certificate=""), keys_folder)
    with pytest.raises(BenchFault, match="cannot be reached"):
        connect(choice("opc.tcp://"), keys_folder)
    monkeypatch.setattr(keys, "YEARS", 0)
    keys.make_keys(tmp_path / "keys")
    with pytest.raises(FormatError, match=r"is valid from .* only; make new keys"):
        keys.read_certificate(tmp_path / "keys" / keys.CLIENT_CERTIFICATE)


def test_serve_that_cannot_is_one_line_and_code_2(inside, keys_folder, tmp_path):
    with contextlib.closing(socket.socket()) as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        code, out, err = inside("serve", "p45", "--port", port, "-o", keys_folder)
    assert (code, out) == (2, "")
    assert (
        err
        == f"truenewton: port {port} cannot be had (Address already in use); choose another port\n"
    )
    empty = tmp_path / "empty"
    empty.mkdir()
    code, _, err = inside("serve", "p45", "-o", empty)
    assert code == 2
    assert err.startswith(f"truenewton: {empty}/server.der: cannot be read (No such file")
    assert err.count("\n") == 1
    assert list(empty.iterdir()) == []
    code, _, err = inside("serve", "p45", "--fidelity", "dynamic", "-o", keys_folder)
    assert (code, err.count("\n")) == (2, 1)
    assert "there is no fidelity 'dynamic'; choose static, loop" in err


def test_without_the_extra_its_name_is_told(inside, keys_folder, monkeypatch):
    monkeypatch.setitem(sys.modules, "asyncua", None)
    with pytest.raises(BenchFault, match=r"needs asyncua; install it: pip install 'truenewton\["):
        connect(choice("opc.tcp://127.0.0.1:1"), keys_folder)
    code, _, err = inside("serve", "p45", "-o", keys_folder)
    assert (code, err.count("\n")) == (2, 1)
    assert "pip install 'truenewton[opcua]'" in err
