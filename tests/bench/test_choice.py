"""The bench that a plan names: found by its address, called, and refused in one line."""

import re
import sys
from pathlib import Path

import pytest

import truenewton as tn
from helpers.acquisition_plans import small_plan
from truenewton.acquisition.acquire import chosen_bench
from truenewton.bench.choice import BenchChoice
from truenewton.bench.opticalib import OpticalibMirror
from truenewton.errors import BenchFault, FormatError, TrueNewtonError
from truenewton.files.toml import toml_text

PAGE = Path(__file__).parents[2] / "docs" / "hardware.md"
BLOCKS = re.findall(r"```python\n(.*?)```", PAGE.read_text("utf-8"), re.DOTALL)
(CLASS,) = [block for block in BLOCKS if "class MyBench" in block]
LABORATORY = """
import numpy as np
import truenewton as tn

class Device:
    n_acts = 8
    def set_shape(self, cmd, differential): self.shape = cmd
    def get_shape(self): return self.shape
    def get_force(self): return 1e5 * self.shape

class NoForce:
    n_acts = 8
    def set_shape(self, cmd, differential): ...
    def get_shape(self): ...

device, make = Device(), lambda: device
class Rack: slot = device

class Bench:
    instrument, gap = "RING8", 65e-6
    def __init__(self, mirror): self.layout = mirror.layout
    def command(self, shape): ...
    def read(self, samples): ...
    def status(self): ...
    def rest(self): ...

class Mute(Bench):
    read = rest = None

class Hosted(Bench):
    def __init__(self, mirror, host): ...

class Unplugged(Bench):
    def __init__(self): raise OSError("no power")

class Locked(Bench):
    def __init__(self): raise tn.errors.BenchFault("the key is out", remedy="turn it")

class Shapeless(Bench):
    def __init__(self): self.layout = [1, 2, 3]

number = 8
"""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Return the folder of a plan, with modules that are forgotten after the test."""
    monkeypatch.setattr(sys, "path", list(sys.path))
    for name, text in (
        ("my_bench", CLASS),
        ("laboratory", LABORATORY),
        ("broken", "def half(:\n"),
        ("needy", "import no_such_driver\n"),
        ("script", "raise SystemExit(0)\n"),
    ):
        (tmp_path / f"{name}.py").write_text(text, encoding="utf-8")
        monkeypatch.delitem(sys.modules, name, raising=False)
    return tmp_path


def at(address, kind="python"):
    return small_plan(cycles=1, settling=0.0, samples=100, bench=BenchChoice(kind, address))


def test_the_bench_of_the_page_runs_from_the_command_line(inside, folder):
    """As a reader would save it, without a change; nobody is asked, since it has put_on."""
    assert len(CLASS.splitlines()) < 50
    plan = folder / "plan.toml"
    plan.write_text(toml_text(at("my_bench:MyBench")), encoding="utf-8")
    assert "complete, 2 loads x 1 cycle" in inside.prints("acquire", plan, "-o", folder / "c")
    bare, loaded = tn.read(folder / "c").cycles
    assert bare.valid.all()
    assert loaded.force.sum(axis=1).mean() - bare.force.sum(axis=1).mean() == pytest.approx(
        0.05, abs=0.01
    )


def test_a_class_a_function_an_object_and_an_installed_class_are_taken(folder):
    found = [chosen_bench(at(f"laboratory:{name}", "opticalib"), folder)._device
             for name in ("device", "make", "Rack.slot", "Device")]  # fmt: skip
    assert found[0] is found[1] is found[2] is not found[3]
    own = chosen_bench(at("laboratory:Bench"), folder)
    assert own.layout.same_as(tn.mirrors.ring(8).layout)  # it asks for the mirror of the plan
    assert isinstance(chosen_bench(at("truenewton:SimulatedBench"), folder), tn.SimulatedBench)
    assert isinstance(chosen_bench(at("laboratory:Device", "opticalib"), folder), OpticalibMirror)


FORM = "; write it as package.module:Name"
PUT = "; install it, or put its file into the folder of the plan, {folder}"
GIVE = "; give a bench (docs/hardware.md)"


@pytest.mark.parametrize(
    ("address", "said"),
    [
        ("", f"bench.address is ''{FORM}"),
        ("laboratory", f"bench.address is 'laboratory'{FORM}"),
        ("./laboratory.py:Bench", f"bench.address is './laboratory.py:Bench'{FORM}"),
        ("laboratory:Bench{segment}", f"bench.address is 'laboratory:Bench{{segment}}'{FORM}"),
        ("labratory:Bench", f"labratory:Bench: there is no module 'labratory'{PUT}"),
        ("laboratory.py:Bench", f"laboratory.py:Bench: there is no module 'laboratory.py'{PUT}"),
        ("needy:Bench", "needy:Bench: the module cannot be imported (ModuleNotFoundError: No module"
         " named 'no_such_driver'); correct it"),
        ("broken:Bench", "broken:Bench: the module cannot be imported (SyntaxError: invalid syntax"
         " (broken.py, line 1)); correct it"),
        ("script:Bench", "script:Bench: the module cannot be imported (SystemExit: 0); correct it"),
        ("laboratory:Bnch", "laboratory:Bnch: {folder}/laboratory.py has no 'Bnch'; correct"
         " bench.address"),
        ("laboratory:Mute", f"laboratory:Mute: has no read, rest{GIVE}"),
        ("laboratory:number", "laboratory:number: has no instrument, layout, gap, command, read,"
         f" status, rest{GIVE}"),
        ("laboratory:Hosted", "laboratory:Hosted: Hosted() is called without arguments, or with"
         " `mirror` (missing a required argument: 'host'); give the other parameters defaults"),
        ("laboratory:Unplugged", "laboratory:Unplugged: Unplugged() fails (OSError: no power);"
         " check the bench"),
        ("laboratory:Locked", "laboratory:Locked: the key is out; turn it"),
        ("laboratory:Shapeless", "Shapeless with its instrument, layout, gap or gradients fails"
         " (AttributeError: 'list' object has no attribute 'n'); check the bench"),
    ],
)  # fmt: skip
def test_what_is_no_bench_is_refused_in_one_line(inside, folder, address, said):
    plan = folder / "plan.toml"
    plan.write_text(toml_text(at(address)), encoding="utf-8")
    code, out, error = inside("acquire", plan, "-o", folder / "c")
    assert (code, out, error) == (2, "", f"truenewton: {said.replace('{folder}', str(folder))}\n")
    assert not (folder / "c").exists()


def test_a_mirror_after_opticalib_without_forces_is_refused(folder):
    said = "^laboratory:NoForce: has no get_force; give a mirror with opticalib's protocol"
    with pytest.raises(BenchFault, match=said):
        chosen_bench(at("laboratory:NoForce", "opticalib"), folder)


@pytest.mark.parametrize("address", ["laboratory:Unplugged", "needy:Bench", "labratory:Bench"])
def test_an_error_of_the_users_code_keeps_its_cause(folder, address):
    with pytest.raises(TrueNewtonError) as raised:
        chosen_bench(at(address), folder)
    assert isinstance(raised.value.__cause__, OSError | ModuleNotFoundError)


@pytest.mark.parametrize(
    ("choice", "said"),
    [
        (BenchChoice("python", seed=7), "seed is 7; remove it: a bench of kind 'python'"),
        (BenchChoice("opticalib", seed=7), "seed is 7; remove it: a bench of kind 'opticalib'"),
        (BenchChoice("simulated", address="a"), "address is 'a'; remove it"),
        (BenchChoice("opcua"), "kind is 'opcua'; choose simulated, python, opticalib"),
    ],
)
def test_what_a_bench_does_not_use_is_refused(choice, said):
    with pytest.raises(FormatError, match=re.escape(f"bench.{said}")):
        small_plan(bench=choice)
