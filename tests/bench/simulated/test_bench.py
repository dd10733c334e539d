"""The simulated bench behind its protocol gives the rows of the simulated campaign."""

from dataclasses import replace

import numpy as np
import pytest

import truenewton as tn
from helpers.acquisition_plans import LOADS
from helpers.stub_bench import SMALL
from truenewton.bench.protocol import Shape
from truenewton.bench.simulated.loop import SAMPLES
from truenewton.bench.simulated.static import (
    held_command,
    loop_of,
    rest_displacement,
    run_cycles,
    static_bench,
)
from truenewton.bench.simulated.truth import read_truth
from truenewton.errors import BenchFault, GeometryError, UnknownName
from truenewton.mirrors.known import p45, ring


def test_fewer_samples_are_noisier():
    bench, load = tn.SimulatedBench(ring(8), 3), tn.Load("bare")
    shape = Shape(load, 1, 1, 1, np.zeros(8))
    bench.command(shape)
    quiet, loud = bench.read(SAMPLES), bench.read(SAMPLES // 16)
    rest = tn.SimulatedBench(ring(8), 3, force_noise=0.0)
    rest.command(shape)
    exact = rest.read(1).force
    assert loud.force - exact == pytest.approx(4 * (quiet.force - exact))
    assert loud.force_error == pytest.approx(4 * quiet.force_error)
    assert loud.counter == quiet.counter + 1


def test_what_cannot_be_done_is_a_fault():
    bench = tn.SimulatedBench(p45(), 3)
    with pytest.raises(BenchFault, match="at rest"):
        bench.read(10)
    with pytest.raises(BenchFault, match="3 displacements for 45"):
        bench.command(Shape(tn.Load("bare"), 1, 1, 1, np.zeros(3)))
    with pytest.raises(UnknownName, match="no load 'anvil'"):
        bench.put_on(tn.Load("anvil", -1.0, 0.1))
    bench.command(Shape(tn.Load("bare"), 1, 1, 1, np.zeros(45)))
    for samples in (0, 10**10):
        with pytest.raises(BenchFault, match=f"a reading of {samples} samples; ask for 1 to"):
            bench.read(samples)


def test_the_truth_stays_inside_but_for_its_sealed_file(tmp_path):
    bench = tn.SimulatedBench(ring(8), 3)
    assert [name for name in dir(bench) if "truth" in name] == ["write_truth"]
    bench.write_truth(tmp_path / "campaign")
    truth = read_truth(tmp_path / "campaign.truth.fits")
    assert truth.alpha == pytest.approx(static_bench(ring(8), 3).truth.alpha)


@pytest.fixture(scope="module")
def loop():
    """Return a plan of twelve shapes, and the first cycle that the closed loop makes of it."""
    plan = static_bench(p45(), 3)
    plan = replace(plan, shapes=plan.shapes[::-4])
    return plan, next(run_cycles(plan, 1, loop_of(plan)))


def test_the_static_bench_agrees_with_the_settled_loop_within_its_noise(loop):
    """The loop's forces are those that hold the readings it comes to rest at."""
    plan, cycle = loop
    assert cycle.valid.all()
    flat = plan.sensors.offset
    expected = held_command(plan, 0, cycle.position - flat)
    apart = cycle.force - expected
    assert np.abs(expected).max() > 0.3
    # Sensors scatter by 3 nm a sample; through a stiffness of 4e6 N/m their mean makes 0.3 mN.
    noise = 3e-9 / np.sqrt(2048) * np.sqrt(np.sum(plan.glass.stiffness**2, axis=1)) / 0.7
    assert np.abs(apart / noise).max() < 6


def test_the_loop_rests_where_its_sensors_say(loop):
    """Their gain and offset known, which a campaign does not know."""
    plan, cycle = loop
    found = rest_displacement(plan)[0]
    read = cycle.rest_position
    seen = plan.sensors.gain * (read - plan.sensors.offset)
    # The mean of 24 records of 2,048 samples of 3 nm; the coils' gradient alone moves it by 20 pm.
    assert found == pytest.approx(seen, abs=0.1e-9)
    assert np.sqrt(np.mean(found**2)) > 30e-9


def test_the_loop_behind_the_protocol_gives_the_rows_of_its_campaign(loop):
    plan, cycle = loop
    bench = tn.SimulatedBench(p45(), 3, fidelity="loop")
    bench.put_on(cycle.load)
    k, s = int(cycle.shape[17]), int(cycle.sign[17])
    bench.command(Shape(cycle.load, 1, k, s, s * plan.shapes[k - 1]))
    reading = bench.read(SAMPLES)
    assert reading.settled
    assert reading.force == pytest.approx(cycle.force[17], abs=1e-11)
    assert reading.position == pytest.approx(cycle.position[17], abs=1e-16)


@pytest.mark.study
def test_a_closed_loop_campaign_fits_and_gives_alpha_within_its_errors():
    """Without the gradients POSITION tells them; without that too, something is said to be."""
    plan = static_bench(p45(), 2)
    cycles = tuple(run_cycles(plan, 3, loop_of(plan)))
    found = tn.calibrate(tn.Campaign(cycles))
    assert 0.75 < found.goodness.reduced < 1.3
    # At the mean place of the campaign: 50 nm off, other under each load, by 600 /m.
    there = 1 + 600 * rest_displacement(plan).mean(axis=0)
    expected = plan.truth.alpha * plan.loads[1].added / plan.truth.added[1]
    sigmas = [(found.alpha - expected * place) / found.statistical_error for place in (there, 1.0)]
    at_mean, at_nominal = np.sqrt(np.mean(np.square(sigmas), axis=1))
    assert at_mean < 1.5 < at_nominal
    assert found.statistical_error.max() < 1e-4
    bare = tuple(replace(c, coil_gradient=None, bias_gradient=None) for c in cycles)
    told = tn.calibrate(tn.Campaign(bare))
    sizes = {name: sum(e.size for e in told.effects if e.name == name)
             for name in ("coil gradient", "bias gradient")}  # fmt: skip
    assert sizes == pytest.approx({"coil gradient": 600, "bias gradient": 31}, rel=0.05)
    assert all(effect.corrected for effect in told.effects)
    sigmas = (told.alpha - expected * there) / told.statistical_error
    assert np.sqrt(np.mean(sigmas**2)) < 2
    told = tn.calibrate(tn.Campaign(tuple(replace(c, position=None) for c in bare)))
    assert told.effects
    assert not any(effect.corrected for effect in told.effects)
    assert told.statistical_error.mean() > 3 * found.statistical_error.mean()


def test_unknown_fidelity_and_a_gap_that_closes_are_refused():
    with pytest.raises(UnknownName, match="no fidelity 'quantum'"):
        tn.SimulatedBench(p45(), fidelity="quantum")
    with pytest.raises(GeometryError, match="closes the gap"):
        static_bench(p45(), 1, stroke=7e-5)


def test_a_short_record_of_the_loop_has_means():
    """No division by the samples of a half that has none (warnings are errors here)."""
    bench = tn.SimulatedBench(SMALL, 1, fidelity="loop")
    bench.command(Shape(LOADS[0], 1, 1, 1, np.zeros(8)))
    for samples in (1, 3, 5):
        reading = bench.read(samples)
        assert np.isfinite(reading.force).all()
        assert (reading.force_error is None) == (samples < 4)
        assert (samples > 1) == bool(reading.force_scatter.any())


def test_the_error_of_a_mean_in_closed_loop_is_that_of_readings_taken_again():
    """Samples taken for independent were 11 times too large."""
    from studies.closed_loop import errors_of_means

    again, batches, independent = errors_of_means(SMALL, 40)
    assert batches == pytest.approx(again, rel=0.15)
    assert independent > 8 * again
