"""An output appears complete or not at all; what is printed commands no terminal."""

import os
import signal
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest

import truenewton as tn
from helpers.acquisition_plans import small_plan
from helpers.stub_bench import StubBench
from truenewton.cli.terminal import say
from truenewton.errors import OutputExists, OutputFailed, UnreadableFile
from truenewton.files.outputs import file_beside, files_together, folder_beside, undisturbed


def write_file(folder, text, overwrite=False):
    with file_beside(folder / "a", overwrite=overwrite) as path:
        path.write_text(text)
        yield


def write_pair(folder, text, overwrite=False):
    pair = [folder / "b", folder / "c"]
    with files_together(pair, overwrite=overwrite) as work:
        for each in pair:
            with file_beside(work / each.name) as path:
                path.write_text(text)
        yield


def write_folder(folder, text, overwrite=False):
    with folder_beside(folder / "d", ("e",), overwrite=overwrite) as work:
        with file_beside(work / "e") as path:
            path.write_text(text)
        yield


KINDS = {write_file: ("a",), write_pair: ("b", "c"), write_folder: ("d/e",)}


def held(folder):
    return {str(p.relative_to(folder)): p.read_text() for p in folder.rglob("*") if p.is_file()}


def written_before(write, folder, before):
    """Write an output if there is to be one before, and return what the folder then contains."""
    for _ in write(folder, "old") if before else ():
        pass
    return dict.fromkeys(KINDS[write], "old") if before else {}


@pytest.mark.parametrize("before", [False, True])
@pytest.mark.parametrize("write", KINDS)
def test_an_output_takes_its_name_when_it_is_complete(tmp_path, write, before):
    old = written_before(write, tmp_path, before)
    for _ in write(tmp_path, "new", before):
        assert {k: v for k, v in held(tmp_path).items() if not k.startswith(".")} == old
    assert held(tmp_path) == dict.fromkeys(KINDS[write], "new")
    assert not list(tmp_path.glob(".*"))


@pytest.mark.parametrize("before", [False, True])
@pytest.mark.parametrize("write", KINDS)
@pytest.mark.parametrize("error", [KeyboardInterrupt, OSError(28, "No space left on device")])
def test_an_output_that_is_stopped_leaves_all_as_it_stood(tmp_path, write, before, error):
    old = written_before(write, tmp_path, before)
    writing = write(tmp_path, "new", before)
    next(writing)
    with pytest.raises((KeyboardInterrupt, OSError)):
        writing.throw(error)
    assert held(tmp_path) == old
    assert not list(tmp_path.glob(".*"))


@pytest.mark.parametrize("before", [False, True])
@pytest.mark.parametrize(
    ("write", "name"), [(write_file, "a"), (write_pair, "c"), (write_folder, "d")]
)
def test_an_output_that_cannot_take_its_name_gives_back_the_old_one(
    tmp_path, monkeypatch, write, name, before
):
    old = written_before(write, tmp_path, before)
    for way in ("replace", "rename"):
        real = getattr(Path, way)

        def stuck(path, target, real=real):
            if Path(path).name == name and Path(target) == tmp_path / name:
                raise OSError(5, "Input/output error")
            return real(path, target)

        monkeypatch.setattr(Path, way, stuck)
    with pytest.raises(OutputFailed, match=f"{KINDS[write][0][0]}: cannot be written"):
        for _ in write(tmp_path, "new", before):
            pass
    assert held(tmp_path) == old
    assert not list(tmp_path.glob(".*"))


def test_a_folder_is_no_file_to_be_overwritten(tmp_path):
    (tmp_path / "a").mkdir()
    with pytest.raises(OutputExists, match="exists already"), folder_beside(tmp_path / "a", ()):
        pass
    with (
        pytest.raises(OutputExists, match="is a folder"),
        file_beside(tmp_path / "a", overwrite=True),
    ):
        pass


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_waits_until_what_must_not_be_torn_is_done(number):
    before, done = signal.signal(number, signal.default_int_handler), []
    try:
        with pytest.raises(KeyboardInterrupt), undisturbed():  # noqa: PT012
            os.kill(os.getpid(), number)
            signal.raise_signal(number)
            done.append(1)
        assert done == [1]
        assert signal.getsignal(number) is signal.default_int_handler
    finally:
        signal.signal(number, before)
    thread = threading.Thread(target=lambda: undisturbed().__enter__())
    thread.start()
    thread.join()


STOPPED = """
import os, signal, sys, time
import truenewton.{module} as module
inner = module.{name}
def stopped(*arguments, **keywords):
    made = inner(*arguments, **keywords)
    os.kill(os.getpid(), signal.SIGTERM)
    time.sleep(10)
    return made
module.{name} = stopped
from truenewton.cli.main import main
sys.argv = ["truenewton", *sys.argv[1:]]
main()
"""


def test_sigterm_leaves_nothing(tmp_path):
    code = STOPPED.format(module="records.file", name="write_cycle")
    done = subprocess.run(
        [sys.executable, "-c", code, "simulate", "ring8", "-o", "s", "--cycles", "1"],
        cwd=tmp_path, capture_output=True, text=True, timeout=120, check=False,
    )  # fmt: skip
    said = "truenewton: interrupted; nothing was left half-written\n"
    assert (done.returncode, done.stderr) == (130, said)
    assert list(tmp_path.iterdir()) == []


def test_kill_9_leaves_only_a_hidden_folder(tmp_path):
    code = STOPPED.format(module="records.file", name="write_cycle")
    subprocess.run(
        [sys.executable, "-c", code.replace("SIGTERM", "SIGKILL"), "simulate", "ring8", "-o", "s"],
        cwd=tmp_path, timeout=120, check=False,
    )  # fmt: skip
    (hidden,) = tmp_path.iterdir()
    assert hidden.name.startswith(".s.")
    with folder_beside(tmp_path / "s", ()):
        pass
    assert hidden.exists()  # it may be that of a process that runs


# -- what is printed -----------------------------------------------------------------------------

NASTY = "b\x1b[31m\x07\u202ea\r\n\x9b"


def test_what_is_printed_commands_no_terminal(capsys):
    say(f"load {NASTY}")
    out = capsys.readouterr().out
    assert out == "load b\\x1b[31m\\x07\\u202ea\\r\\n\\x9b\n"


def test_nothing_prints_but_the_one_place():
    """So that no name from a file reaches a terminal as it is."""
    import ast

    import truenewton

    allowed = {"terminal.py": 3}  # JSON and lines; the one line of an error
    for path in Path(truenewton.__file__).parent.rglob("*.py"):
        text = path.read_text(encoding="utf-8")
        calls = "print(" in text and [
            node for node in ast.walk(ast.parse(text))
            if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "print"
        ]  # fmt: skip
        expected = allowed.get(path.name, 0) if path.parent.name == "cli" else 0
        assert len(calls or ()) == expected, path


def test_remembered_shapes_that_were_changed_are_one_line(tmp_path):
    folder, plan = tmp_path / "c", small_plan(cycles=1)
    tn.acquire(StubBench(), plan, folder)
    next(folder.glob("ring*.fits")).unlink()
    path = folder / ".shapes"
    raw = path.read_bytes()
    for changed in (raw[:90], b"", raw.replace(np.float64(1e-6).tobytes()[::-1], bytes(8))):
        path.write_bytes(changed)
        with pytest.raises(UnreadableFile, match=r"\.shapes: "):
            tn.acquire(StubBench(), plan, folder)
    path.write_bytes(raw)
    assert len(tn.acquire(StubBench(), plan, folder)) == 2
