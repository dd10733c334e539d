"""Mirrors after opticalib's protocol: the adapter, and the published package's own device."""

import datetime
import importlib.util
import json
import os
import subprocess
import sys
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import truenewton as tn
from truenewton.bench.opticalib import OpticalibMirror
from truenewton.bench.protocol import Bench, Shape
from truenewton.bench.simulated.loop import SAMPLES
from truenewton.bench.simulated.static import static_bench
from truenewton.errors import BenchFault
from truenewton.mirrors.known import p45, ring

BARE = tn.Load("bare")


@cache
def truth():
    return static_bench(p45(), 3).truth


class Device:
    """P45 as opticalib's drivers behave: positions hold a bias, commands are changed in place."""

    def __init__(self, noise=0.0, force_noise=0.0):
        self.n_acts = 45
        self.noise, self.force_noise = noise, force_noise
        self.random = np.random.default_rng(4)
        self.response = truth().stiffness / truth().alpha
        self.bias = 1e-6 * np.arange(45)
        self.displacement = np.full(45, 7e-6)
        self.drift = 0.0
        self.calls = []

    def set_shape(self, cmd, differential=False, *, slave=False):
        self.calls.append((cmd.copy(), differential, slave))
        cmd += self.displacement if differential else 0.0
        self.displacement = cmd

    def get_shape(self):
        self.displacement = self.displacement + self.drift
        return self.bias + self.displacement + self.noise * self.random.standard_normal(45)

    def get_force(self):
        noise = self.force_noise * self.random.standard_normal(45)
        return self.displacement @ self.response + noise


@pytest.fixture
def device():
    return Device()


def test_a_reading_is_the_displacement_from_rest_and_its_force(device):
    bench: Bench = OpticalibMirror(device, p45(), settling=0.0)
    assert bench.instrument == "P45"
    assert bench.layout.same_as(p45().layout)
    assert bench.gap == p45().gap
    assert bench.gradients == (p45().coil_gradient, p45().bias_gradient)
    for number, shape in enumerate(static_bench(p45(), 3).shapes[:5], start=1):
        kept = shape.copy()
        bench.command(Shape(BARE, 1, number, 1, shape))
        reading = bench.read(3)
        assert np.array_equal(shape, kept)
        assert reading.position == pytest.approx(shape, abs=1e-18)
        assert reading.force == pytest.approx(shape @ device.response, rel=1e-12)
        assert reading.counter == number
        assert reading.settled
        assert np.isnan(reading.temperature)
    assert device.calls[0][0].tolist() == [0.0] * 45  # to rest first, once
    assert len(device.calls) == 6
    assert {(differential, slave) for _, differential, slave in device.calls} == {(False, False)}
    bench.rest()
    assert device.displacement.tolist() == [0.0] * 45
    assert bench.status().message == "at rest"


def test_scatter_drift_and_stale_readings_are_told():
    device = Device(noise=1e-9)
    bench = OpticalibMirror(device, p45(), settling=0.0)
    bench.command(Shape(BARE, 1, 1, 1, np.zeros(45)))
    reading = bench.read(400)
    assert reading.position_scatter == pytest.approx(np.full(45, 1e-9), rel=0.2)
    assert reading.position == pytest.approx(np.zeros(45), abs=1e-9)
    assert reading.settled
    device.drift = 1e-10
    assert not bench.read(400).settled
    device.drift = device.noise = 0.0
    counter = bench.read(2).counter
    assert bench.read(2).counter == counter  # to the bit the same: it stands still


def test_faults_are_one_line(device):
    bench = OpticalibMirror(device, p45(), settling=0.0)
    with pytest.raises(BenchFault, match="at rest; command a shape"):
        bench.read(1)
    with pytest.raises(BenchFault, match="3 displacements for 45"):
        bench.command(Shape(BARE, 1, 1, 1, np.zeros(3)))
    assert device.calls == []
    bench.command(Shape(BARE, 1, 1, 1, np.zeros(45)))
    device.get_force = lambda: np.full(45, np.nan)
    with pytest.raises(BenchFault, match="finite: False"):
        bench.read(2)
    device.get_force = lambda: 1 / 0
    with pytest.raises(BenchFault, match=r"^Device.get_shape or get_force fails \(ZeroDiv"):
        bench.read(2)
    device.n_acts = 44
    with pytest.raises(BenchFault, match="Device has 44 actuators, P45 has 45"):
        OpticalibMirror(device, p45())
    with pytest.raises(BenchFault, match="object has no n_acts, set_shape, get_shape, get_force"):
        OpticalibMirror(object(), p45())


def test_independent_samples_give_their_error_by_batches():
    bench = OpticalibMirror(device := Device(force_noise=1e-3), p45(), settling=0.0)
    device.get_temperature = lambda: 21.5
    bench.command(Shape(BARE, 1, 1, 1, np.zeros(45)))
    assert bench.read(3).force_error is None
    readings = [bench.read(64) for _ in range(20)]
    # 2700 degrees of freedom: known to 1.4 %.
    error = np.sqrt(np.mean([reading.force_error**2 for reading in readings]))
    assert error == pytest.approx(1e-3 / 8, rel=0.06)
    assert readings[0].temperature == 21.5


def test_a_campaign_on_such_a_mirror_recovers_alpha(tmp_path):
    """The whole way, with the simulated bench behind the four calls."""
    mirror = replace(ring(8), coil_gradient=0.0, bias_gradient=0.0)
    inside, bench = tn.SimulatedBench(mirror, 6), static_bench(mirror, 6)

    class Simulated:
        n_acts, place = 8, 0

        def set_shape(self, cmd, differential):
            assert not differential
            self.place += 1
            inside.command(Shape(BARE, 1, self.place, 1, cmd))

        def get_shape(self):
            return inside.read(SAMPLES).position

        def get_force(self):
            return inside.read(SAMPLES).force

    plan = tn.CampaignPlan("ring8", bench.loads, cycles=2, settling=0.0, samples=1)
    device = OpticalibMirror(Simulated(), mirror, settling=0.0)
    tn.acquire(device, plan, tmp_path / "c", operator=inside)
    found = tn.calibrate(tn.read(tmp_path / "c"))
    expected = bench.truth.alpha * bench.loads[1].added / bench.truth.added[1]
    assert 0.1 < np.abs((found.alpha - expected) / found.statistical_error).max() < 4.5
    assert found.statistical_error.max() < 3e-3


needs_opticalib = pytest.mark.skipif(
    importlib.util.find_spec("opticalib") is None,
    reason="opticalib is not installed: make test-opticalib",
)


def by_opticalib(script, folder, *arguments):
    """Return what a script prints as JSON, in a process and home of its own."""
    done = subprocess.run(
        [sys.executable, "-c", script, *map(str, arguments)], capture_output=True, text=True,
        env={**os.environ, "HOME": str(folder), "MPLBACKEND": "agg"}, cwd=folder, timeout=120,
        check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


PACKAGE = """
import inspect, json, types
import numpy as np
import opticalib
from opticalib.devices import DP, M4AU, AdOpticaDm
from opticalib.devices._API.base_devices import BaseDeformableMirror
import truenewton as tn
from truenewton.bench.opticalib import OpticalibMirror
from truenewton.bench.protocol import Shape
from truenewton.mirrors.known import p45, ring

class Client:
    '''What the electronics' own library does for the device.'''
    bias = 1e-6 * np.arange(45)
    command = np.zeros(45)
    counters = types.SimpleNamespace(skipByCommand=0, skipByDeltaCommand=0, skipByForce=0)
    def mirrorCommand(self, command): self.command = command.copy()
    def getPosition(self): return self.bias + self.command
    def getForce(self): return 1e5 * self.command[::-1] + 0.1
    def getCounters(self): return self.counters

class Device(AdOpticaDm):
    def __init__(self):  # without the electronics
        self._aoClient, self.n_acts, self._last_cmd = Client(), 45, np.zeros(45)

bench = OpticalibMirror(Device(), p45(), settling=0.0)
shape = 1e-6 * np.random.default_rng(3).standard_normal(45)
bench.command(Shape(tn.Load("bare"), 1, 1, 1, shape))
reading = bench.read(5)
protocol = opticalib.typings._DMProtocol
print(json.dumps({
    "version": opticalib.__version__,
    "protocol": sorted(n for n in dir(protocol) if n in ("n_acts", "set_shape", "get_shape")),
    "arguments": list(inspect.signature(protocol.set_shape).parameters),
    "abstract": sorted(BaseDeformableMirror.__abstractmethods__),
    "forces": [hasattr(one, "get_force") for one in (AdOpticaDm, DP, M4AU)],
    "follows": isinstance(bench._device, protocol),
    "position": float(np.abs(reading.position - shape).max()),
    "force": float(np.abs(reading.force - (1e5 * shape[::-1] + 0.1)).max()),
}))
"""


@needs_opticalib
def test_the_published_package_does_what_we_take_it_to_do(tmp_path):
    """Its own AdOpticaDm, without the electronics behind it."""
    told = by_opticalib(PACKAGE, tmp_path)
    assert told["version"].startswith("2.")
    assert told["protocol"] == ["get_shape", "n_acts", "set_shape"]
    assert told["arguments"] == ["self", "cmd", "differential"]
    assert {"get_shape", "set_shape"} <= set(told["abstract"])
    assert told["forces"] == [True, True, True]
    assert told["follows"]
    assert told["position"] < 1e-18
    assert told["force"] < 1e-12


MATRICES = """
import json, sys, types
import numpy as np
from opticalib import load_fits, save_fits
from opticalib.dmutils.slaving import compute_slave_cmd

modes, commanded, true = (load_fits(path) for path in sys.argv[1:4])
save_fits("again.fits", modes)
mirror = types.SimpleNamespace(n_acts=45, slave_ids=[16, 20], ff=np.asarray(true))
command = 1e-6 * np.sin(np.arange(45.0))
print(json.dumps({
    "axes": [modes.header["CTYPE1"], modes.header["CTYPE2"]],
    "modes": np.asarray(modes).tolist(), "commanded": np.asarray(commanded).tolist(),
    "again": np.asarray(load_fits("again.fits"), dtype=float).tolist(),
    "command": command.tolist(),
    "zero-force": np.asarray(compute_slave_cmd(mirror, command, "zero-force")).tolist(),
    "minimum-rms": np.asarray(compute_slave_cmd(mirror, command, "minimum-rms")).tolist(),
}))
"""


@needs_opticalib
def test_the_published_package_reads_the_modal_base(tmp_path):
    """And its slaving agrees with ours: zero force with what is off, least force with slaves."""
    bench = static_bench(p45(), 3)
    matrix = tn.StiffnessMatrix(
        "P45",
        datetime.datetime.now(datetime.UTC),
        p45().layout,
        bench.truth.stiffness / bench.truth.alpha[:, None],
    )
    found = tn.find_modes(matrix)
    written = tn.write_modes(found, tmp_path / "m.fits")
    told = by_opticalib(MATRICES, tmp_path, *written[3:])
    assert told["axes"] == ["MODE", "ACTUATOR"]
    base = found.after
    np.testing.assert_array_equal(told["modes"], base.modes.modes)
    np.testing.assert_allclose(told["again"], base.modes.modes, atol=1e-7)  # single precision
    np.testing.assert_array_equal(told["commanded"], base.stiffness.feed_forward_commanded)
    masters = np.delete(told["command"], [16, 20])
    ids = p45().layout.id[[16, 20]].tolist()
    for theirs, ours in (("zero-force", {"off": ids}), ("minimum-rms", {"slaved": ids})):
        followed = tn.find_modes(matrix, found.calibration, **ours).after.stiffness.shapes @ masters
        np.testing.assert_allclose(told[theirs], followed, atol=1e-12)
