"""What one command makes appears together or not at all; what it prints commands no terminal."""

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
from truenewton.files.outputs import (
    atomic_outputs,
    file_beside,
    files_together,
    folder_beside,
    undisturbed,
)


def write_three(folder, text, overwrite=False):
    """Write a file, two files that belong together, and a folder."""
    with file_beside(folder / "a", overwrite=overwrite) as path:
        path.write_text(text)
    pair = [folder / "b", folder / "c"]
    with files_together(pair, overwrite=overwrite) as work:
        for each in pair:
            with file_beside(work / each.name) as path:
                path.write_text(text)
    with (
        folder_beside(folder / "d", ("e",), overwrite=overwrite) as work,
        file_beside(work / "e") as path,
    ):
        path.write_text(text)


def held(folder):
    return {str(p.relative_to(folder)): p.read_text() for p in folder.rglob("*") if p.is_file()}


ALL = ("a", "b", "c", "d/e")


@pytest.mark.parametrize("before", [False, True])
def test_outputs_of_a_block_appear_together(tmp_path, before):
    if before:
        write_three(tmp_path, "old")
    with atomic_outputs():
        write_three(tmp_path, "new", overwrite=before)
        there = {k: v for k, v in held(tmp_path).items() if not k.startswith(".")}
        assert there == (dict.fromkeys(ALL, "old") if before else {})
    assert held(tmp_path) == dict.fromkeys(ALL, "new")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a", "b", "c", "d"]


@pytest.mark.parametrize("before", [False, True])
@pytest.mark.parametrize("error", [KeyboardInterrupt, OSError(28, "No space left on device")])
def test_a_block_that_is_stopped_leaves_all_as_it_stood(tmp_path, before, error):
    if before:
        write_three(tmp_path, "old")
    with pytest.raises((KeyboardInterrupt, OSError)), atomic_outputs():  # noqa: PT012
        write_three(tmp_path, "new", overwrite=before)
        raise error
    assert held(tmp_path) == (dict.fromkeys(ALL, "old") if before else {})
    assert not [p.name for p in tmp_path.iterdir() if p.name.startswith(".")]


@pytest.mark.parametrize("before", [False, True])
@pytest.mark.parametrize("name", ["a", "b", "c", "d"])
def test_a_name_that_cannot_be_taken_gives_back_the_others(tmp_path, monkeypatch, before, name):
    if before:
        write_three(tmp_path, "old")
    replace = Path.replace

    def stuck(path, target):
        if path.name == name and Path(target).parent == tmp_path:
            raise OSError(5, "Input/output error")
        return replace(path, target)

    monkeypatch.setattr(Path, "replace", stuck)
    with pytest.raises(OutputFailed, match=f"{name}: cannot be written"), atomic_outputs():
        write_three(tmp_path, "new", overwrite=before)
    assert held(tmp_path) == (dict.fromkeys(ALL, "old") if before else {})
    assert not [p.name for p in tmp_path.iterdir() if p.name.startswith(".")]


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
    code = STOPPED.format(module="bench.simulated.truth", name="write_truth")
    done = subprocess.run(
        [sys.executable, "-c", code, "simulate", "ring8", "-o", "s", "--cycles", "1"],
        cwd=tmp_path, capture_output=True, text=True, timeout=120, check=False,
    )  # fmt: skip
    said = "truenewton: interrupted; nothing was left half-written\n"
    assert (done.returncode, done.stderr) == (130, said)
    assert list(tmp_path.iterdir()) == []


def test_kill_9_leaves_a_hidden_folder_that_the_next_run_removes(tmp_path):
    code = STOPPED.format(module="bench.simulated.truth", name="write_truth")
    subprocess.run(
        [sys.executable, "-c", code.replace("SIGTERM", "SIGKILL"), "simulate", "ring8", "-o", "s"],
        cwd=tmp_path, timeout=120, check=False,
    )  # fmt: skip
    assert all(path.name.startswith(".s.") for path in tmp_path.iterdir())
    assert list(tmp_path.iterdir())
    with folder_beside(tmp_path / "s", ()) as running:
        assert list(tmp_path.iterdir()) == [running.parent]
        with pytest.raises(KeyError), file_beside(tmp_path / "s"):
            raise KeyError
        assert running.exists()  # this process lives


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
