"""Hardware as it comes: servers written from the page, what they may leave out and get wrong."""

import asyncio
import contextlib
import datetime
import logging
import re
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from asyncua import ua

import truenewton as tn
from helpers.acquisition_plans import small_plan
from helpers.foreign_server import NAMESPACE, electronics
from helpers.opcua_server import choice, free_port, in_thread
from helpers.stub_bench import SMALL
from truenewton.acquisition.acquire import chosen_bench
from truenewton.acquisition.plan import shapes_and_forces
from truenewton.bench.opcua import connect, keys
from truenewton.bench.opcua.methods import (
    METHODS,
    OPTIONAL,
    VARIABLES,
    mirror_of,
    received_answer,
    scalar,
    variants,
)
from truenewton.bench.protocol import BenchChoice, Operator, gradients_of
from truenewton.errors import BenchFault, FormatError, TrueNewtonError
from truenewton.files.toml import toml_text
from truenewton.mirrors.file import mirror_from

PAGE = Path(__file__).parents[3] / "docs" / "hardware.md"
HELPERS = Path(__file__).parents[2] / "helpers"
TYPE = re.compile(r"(\w+) (\w+)(\[\])?(?: \[[^\]]+\])?( \(optional\))?")


@pytest.fixture(scope="module")
def foreign(keys_folder):
    """Serve what was written from the page, in another thread; give address, server, its loop."""
    logging.getLogger("asyncua").setLevel(logging.CRITICAL)
    address = f"opc.tcp://127.0.0.1:{free_port()}"

    @contextlib.asynccontextmanager
    async def served():
        columns = (getattr(SMALL.layout, name).tolist() for name in ("x", "y", "nz"))
        async with await electronics(
            address, keys_folder, SMALL.name, SMALL.gap, *columns
        ) as server:
            yield server

    with in_thread(served()) as (loop, server):
        yield address, server, loop


# -- the page ------------------------------------------------------------------------------------


def declared(kinds):
    """Return names, types and whether they are optional, as the page writes them."""
    return [
        (name, scalar(kind).name, isinstance(kind, list), name in OPTIONAL) for name, kind in kinds
    ]


def told(cell):
    """Return the same of a cell of the page's table."""
    parts = [TYPE.fullmatch(part.strip()) for part in cell.split(";") if part.strip()]
    assert None not in parts, cell
    return [(part[1], part[2], bool(part[3]), bool(part[4])) for part in parts]


def rows_of(head):
    """Return the cells of the rows below a head of a table."""
    lines = PAGE.read_text(encoding="utf-8").split(head)[1].splitlines()[2:]
    rows = []
    for line in lines:
        if not line.startswith("|"):
            break
        rows.append([cell.strip() for cell in line.strip("|").split("|")])
    return rows


def test_the_page_has_the_nodes_of_client_and_server():
    variables = rows_of("| variable | type | contents |")
    said = [told(re.sub(r"`(\w+)`( \(optional\))?", rf"\1 {kind}\2", name))[0]
            for name, kind, _ in variables]  # fmt: skip
    assert said == declared(VARIABLES)
    methods = rows_of("| method | inputs | outputs |")
    assert [name for name, *_ in methods] == [
        f"`{name}`{' (optional)' if name in OPTIONAL else ''}" for name in METHODS
    ]
    for (_, takes, gives), expected in zip(methods, METHODS.values(), strict=True):
        assert told(takes) == declared(expected[0])
        assert told(gives) == [("Fault", "String", True, False), *declared(expected[1])]


def test_the_page_tells_what_the_server_of_the_tests_switches_on():
    source = (HELPERS / "foreign_server.py").read_text(encoding="utf-8")
    (block,) = re.findall(r"```text\n(server = Server.*?)```", PAGE.read_text("utf-8"), re.DOTALL)
    lines = [line.split("  #")[0] for line in block.splitlines()]
    assert len(lines) == 11
    for line in lines:
        assert f"    {line}\n" in source


def test_the_mirror_file_of_the_page_is_a_mirror(tmp_path):
    """With its table; what may be left out is left out, and has the value that the page gives."""
    text = (PAGE.parent / "mirrors.md").read_text(encoding="utf-8")
    (mine,) = re.findall(r'```toml\n(name = "MINE".*?)```', text, re.DOTALL)
    (table,) = re.findall(r"```text\n(ID,X.*?)```", text, re.DOTALL)
    (tmp_path / "actuators.csv").write_text(table)
    (tmp_path / "mine.toml").write_text(mine)
    mirror = mirror_from(tmp_path / "mine.toml")
    plan = replace(small_plan(count=2), mirror="mine.toml")
    assert shapes_and_forces(plan, mirror, tmp_path)[0].shape == (2, 6)
    given = re.findall(r"`(\w+ = [^`]+)`", text.split("## Optional entries")[1].split("\n\n")[2])
    assert len(given) == 8
    for name, value in tomllib.loads("\n".join(given)).items():
        assert np.array_equal(getattr(mirror, name), value), name
    needed = mine.split("[sensor]")[0]
    (tmp_path / "mine.toml").write_text(needed)
    mirror_from(tmp_path / "mine.toml")
    for line in needed.splitlines():
        if "=" in line and not line.startswith("radius_of_curvature"):
            (tmp_path / "mine.toml").write_text(f"\n{needed}".replace(f"\n{line}\n", "\n"))
            with pytest.raises(FormatError, match=f"lacks '{line.split(' ')[0]}'; add it"):
                mirror_from(tmp_path / "mine.toml")


NAN = float("nan")
OUT_OF_MEMORY = ua.StatusCode(ua.StatusCodes.BadOutOfMemory)
NONSENSE = [  # which of the values of Read, and what it is instead
    (0, ["Interrupted", "stop", ""], "stop"),
    (1, datetime.datetime(1601, 1, 1), "the time of a reading is 1601-01-01 00:00:00+00:00 (set"),
    (2, [0.1] * 3, "force of shape (3,) for 8 actuators"),
    (2, [[0.1] * 4] * 2, "gives Force as [[0.1"),
    (3, [NAN] * 8, "the position of actuator 1 is NaN"),
    (4, [float("inf")] * 8, "the force_scatter of a reading is inf"),
    (5, [-1.0] * 8, "the position_scatter of a reading is -1"),
    (8, 1, "the server gives Settled as 1, in Bench.Read (it is Boolean)"),
    (None, OUT_OF_MEMORY, "the server fails in Read (BadOutOfMemory)"),
    (None, ZeroDivisionError("x"), "fails in Read (BadUnexpectedError)"),
    (2, [0.1] * 300_000, "the server was lost in Read"),  # 2.4 MB, more than a message may have
]


def test_a_server_written_from_the_page_takes_a_campaign_and_no_row_is_lost_by_nonsense(
    foreign, keys_folder, tmp_path, inside
):
    """Each shape is tried three times; five that fail end it. The same command then goes on."""
    address, server, _ = foreign
    read = server.iserver.aspace[ua.NodeId("Bench.Read", 2)]
    sound, asked = read.call, iter(range(10**6))

    def nonsense(parent, samples):
        number = next(asked) - 2  # one at rest, one shape
        answer = sound(parent, samples)
        if number < 0:
            return answer
        place, value, _ = NONSENSE[number % len(NONSENSE)]
        if isinstance(value, Exception):
            raise value
        if place is None:
            return value
        answer[place] = ua.Variant(value)
        return answer

    files = {name: str(keys_folder / file) for name, file in keys.CLIENT_FILES.items()}
    plan = small_plan(cycles=1, bench=choice(address, **files), samples=16, settling=0.0)
    with chosen_bench(plan, tmp_path) as bench:
        assert not isinstance(bench, Operator)  # it has no PutOn
        assert gradients_of(bench) == (None, None)
        assert bench.layout.enabled.all()
    (tmp_path / "plan.toml").write_text(toml_text(plan))
    command = "acquire", tmp_path / "plan.toml", "-o", tmp_path / "c", "--yes"
    read.call = nonsense
    try:
        code, out, err = inside(*command)
    finally:
        read.call = sound
    assert (code, err.count("\n")) == (2, 1)
    assert "5 shapes in a row gave no valid reading" in err
    for _, _, said in NONSENSE:
        assert said in out + err
    assert inside(*command)[0] == 0
    cycles = tn.read(tmp_path / "c").cycles
    assert [cycle.valid.tolist() for cycle in cycles] == [[True] * 6] * 2
    for cycle in cycles:
        assert cycle.force_error is cycle.temperature is cycle.coil_gradient is None
        held = 0.1 + (0.05 / 8 if cycle.load.key == "ring" else 0.0)
        expected = held + 1e5 * np.asarray(cycle.position)
        assert np.asarray(cycle.force) == pytest.approx(expected, abs=1e-4)


def test_a_mirror_without_a_node_is_refused_in_one_line_with_the_address(foreign, keys_folder):
    """Last of those that use the server, which it spoils."""
    address, server, loop = foreign

    async def spoil():
        space = await server.get_namespace_index(NAMESPACE)
        await server.delete_nodes([server.get_node(ua.NodeId("Bench.Gap", space))])

    asyncio.run_coroutine_threadsafe(spoil(), loop).result(20)
    said = f"{address}: the server has no node Bench.Gap; add it, in {NAMESPACE}"
    with pytest.raises(BenchFault, match=f"^{said}$"):
        connect(choice(address), keys_folder)


GOOD = {
    "Instrument": "RING8", "Gap": 65e-6, "Id": [1, 2, 3, 4], "X": [0.0, 1.0, 0.0, -1.0],
    "Y": [1.0, 0.0, -1.0, 0.0], "Nz": [1.0] * 4,
}  # fmt: skip


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"Gap": "68 um"}, "gives Bench.Gap as '68 um'; it is Double"),
        ({"Instrument": 8}, "gives Bench.Instrument as 8; it is String"),
        ({"X": [0.1, True, 0.2, 0.3]}, "gives Bench.X as [0.1, True, 0.2, 0.3]; it is Double[]"),
        ({"X": [0.1] * 3}, "gives 3 values of Bench.X for 4 actuators"),
        ({"Id": None}, "gives 0 values of Bench.Id for 0 actuators"),
        ({"Enabled": [1, 1, 1, 1]}, "gives Bench.Enabled as [1, 1, 1, 1]; it is Boolean[]"),
        ({"Gradients": 0.0}, "gives Bench.Gradients as 0.0; it is Double[]"),
        ({"Gradients": [1.0]}, "gives 1 value of Bench.Gradients; they are two"),
        ({"X": [np.nan] * 4}, "X"),
        ({"X": [0, 1, 0, -1]}, "gives Bench.X as whole numbers; it is Double[]"),
    ],
)
def test_variables_of_another_kind_are_refused_by_name(change, said):
    assert mirror_of(GOOD, set(METHODS))[3].n == 4
    with pytest.raises(TrueNewtonError, match=re.escape(said)):
        mirror_of(GOOD | change, set(METHODS))


@pytest.mark.parametrize("name", [*dict(VARIABLES), *METHODS])
def test_a_node_that_is_missing_is_named_unless_it_is_optional(name):
    values = {key: value for key, value in GOOD.items() if key != name}
    methods = set(METHODS) - {name}
    if name in OPTIONAL:
        mirror_of(values, methods)
        return
    with pytest.raises(BenchFault, match=rf"has no node Bench\.{name}; add it, in urn:truenewton"):
        mirror_of(values, methods)


@pytest.mark.parametrize(
    ("method", "values", "said"),
    [
        ("Status", [[], "yes", "", 1], "gives Ready as 'yes'; it is Boolean"),
        (
            "Status",
            [[]],
            "gives 0 values after the fault, where 3 are due; they are Ready, Message, Counter",
        ),
        ("Status", ["", True, "", 1], "gives Fault as ''; it is String[]"),
        ("Rest", [["hot"]], "gives Fault as ['hot']; it is empty, or kind, fault and remedy"),
        ("Rest", [[], 1], "gives 1 value after the fault, where 0 are due; they are none"),
        ("Read", [[], None, [], [], [], [], 1.0, 1, True], "gives Time as None; it is DateTime"),
    ],
)
def test_answers_of_another_kind_are_refused_by_name(method, values, said):
    assert received_answer("Rest", []) == ([], [])
    assert variants([None], [("ForceError", [ua.VariantType.Double])])[0].Value == []
    assert received_answer("Rest", [["BenchFault", "hot", "cool it"]])[0][1] == "hot"
    with pytest.raises(BenchFault, match=re.escape(said)):
        received_answer(method, values)


# -- what a plan says of its bench ---------------------------------------------------------------


@pytest.mark.parametrize(
    ("choice", "said"),
    [
        (BenchChoice("opcua", seed=7), "seed is 7; remove it: a bench of kind 'opcua'"),
        (BenchChoice("opticalib", seed=7), "seed is 7; remove it: a bench of kind 'opticalib'"),
        (BenchChoice("simulated", address="a"), "address is 'a'; remove it"),
    ],
)
def test_what_a_bench_does_not_use_is_refused(choice, said):
    with pytest.raises(FormatError, match=re.escape(f"bench.{said}")):
        small_plan(bench=choice)
