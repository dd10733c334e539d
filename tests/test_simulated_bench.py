"""The simulated bench behind its protocol gives the rows of the simulated campaign."""

import numpy as np
import pytest

import truenewton as tn
from truenewton.bench.protocol import Bench, Shape
from truenewton.bench.simulated.simulated_bench import SAMPLES
from truenewton.bench.simulated.static import run_cycles, static_bench
from truenewton.bench.simulated.truth import read_truth
from truenewton.errors import BenchFault, UnknownName
from truenewton.mirrors import p45


def test_rows_taken_one_by_one_are_those_of_the_campaign():
    plan = static_bench(p45(), 3)
    bench: Bench = tn.SimulatedBench(p45(), 3)
    for cycle in run_cycles(plan, 2):
        bench.put_on(cycle.load)
        for row in (0, 1, 7, 6, 89):
            k, s = int(cycle.shape[row]), int(cycle.sign[row])
            bench.command(Shape(cycle.load, cycle.number, k, s, s * plan.shapes[k - 1]))
            reading = bench.read(SAMPLES)
            assert reading.force == pytest.approx(cycle.force[row], rel=1e-9, abs=1e-12)
            assert reading.position == pytest.approx(cycle.position[row], rel=1e-9, abs=1e-18)
    bench.rest()
    assert bench.status().message == "at rest"


def test_fewer_samples_are_noisier():
    bench, load = tn.SimulatedBench(p45(), 3), tn.Load("bare")
    shape = Shape(load, 1, 1, 1, np.zeros(45))
    bench.command(shape)
    quiet, loud = bench.read(SAMPLES), bench.read(SAMPLES // 16)
    rest = tn.SimulatedBench(p45(), 3, force_noise=0.0)
    rest.command(shape)
    exact = rest.read(1).force
    assert loud.force - exact == pytest.approx(4 * (quiet.force - exact))
    assert loud.counter == quiet.counter + 1


def test_what_cannot_be_done_is_a_fault(tmp_path):
    bench = tn.SimulatedBench(p45(), 3)
    with pytest.raises(BenchFault, match="at rest"):
        bench.read(10)
    with pytest.raises(BenchFault, match="3 displacements for 45"):
        bench.command(Shape(tn.Load("bare"), 1, 1, 1, np.zeros(3)))
    with pytest.raises(UnknownName, match="no load 'anvil'"):
        bench.put_on(tn.Load("anvil", -1.0, 0.1))


def test_the_truth_stays_inside_but_for_its_sealed_file(tmp_path):
    bench = tn.SimulatedBench(p45(), 3)
    assert [name for name in dir(bench) if "truth" in name] == ["write_truth"]
    bench.write_truth(tmp_path / "campaign")
    truth = read_truth(tmp_path / "campaign.truth.fits")
    assert truth.alpha == pytest.approx(static_bench(p45(), 3).truth.alpha)
