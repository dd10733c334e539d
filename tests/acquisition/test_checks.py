"""No command beyond a limit ever reaches a bench; a reading beyond one is the last."""

import dataclasses

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import truenewton as tn
from helpers.acquisition_plans import LOADS, small_plan, write_shapes
from helpers.stub_bench import SMALL, StubBench
from truenewton.acquisition.plan import MirrorLimits, PlannedShapes
from truenewton.acquisition.taker import Guard
from truenewton.bench.protocol import Shape
from truenewton.errors import BenchFault, FormatError, LimitExceeded

GAP, STROKE = 65e-6, 1e-6


def limited(count=8, **limits):
    force = min(0.05, limits.get("force", 0.05))
    return small_plan(
        shapes=PlannedShapes(count=count, stroke=STROKE, force=force), limits=MirrorLimits(**limits)
    )


def spoilt(**values):
    """Return a spoiler of the first + of shape 5 in cycle 1 under the ring."""

    def spoil(shape, reading):
        if (shape.load.name, shape.cycle, shape.number, shape.sign) != ("ring", 1, 5, 1):
            return reading
        changed = {
            name: np.where(np.arange(8) == 3, value, getattr(reading, name))
            if np.ndim(getattr(reading, name))
            else value
            for name, value in values.items()
        }
        return dataclasses.replace(reading, **changed)

    return spoil


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"force": 0.61}, "actuator 4 takes 0.61 N, beyond its limit of 0.6, in shape 5 +"),
        ({"force": np.inf}, "actuator 4 takes inf N, beyond its limit of 0.6"),
        ({"force": 0.5, "force_scatter": 0.101}, "takes 0.803 N in single samples, beyond satur"),
        ({"position": -5.1e-6}, "actuator 4 takes 5.1e-06 m of stroke, beyond its limit of 5e-06"),
        ({"temperature": 41.0}, "the mirror has 41 deg C in shape 5 [+] of cycle 1 under 'ring'"),
        ({"force": 0.61, "settled": False}, "actuator 4 takes 0.61 N"),  # sound or not
    ],
)  # fmt: skip
def test_a_reading_beyond_a_limit_is_the_last(tmp_path, values, said):
    bench = StubBench(spoil=spoilt(**values))
    said = said if "[" in said else said.replace("+", "[+]")
    with pytest.raises(LimitExceeded, match=said) as raised:
        tn.acquire(bench, limited(), tmp_path / "c")
    assert raised.value.remedy.endswith("the same command takes the others, once that is corrected")
    assert bench.read_of[-1] == ("ring", 1, 5, 1)
    assert len(bench.commanded) == len(bench.read_of)
    assert bench.shape is None
    assert sorted(p.name for p in (tmp_path / "c").glob("*.fits")) == [
        "bare-001.fits", "bare-002.fits",
    ]  # fmt: skip
    again = StubBench()
    tn.acquire(again, limited(), tmp_path / "c")
    assert again.read_of[1] == ("ring", 1, 1, 1)  # the cycle begins again


def test_a_gap_that_closes_is_a_limit_too(tmp_path):
    bench = StubBench(spoil=spoilt(position=36e-6))
    with pytest.raises(LimitExceeded, match=r"3\.6e-05 m of a gap of 6\.5e-05 m"):
        tn.acquire(bench, limited(displacement=1e-3), tmp_path / "c")


@pytest.mark.parametrize(
    ("limits", "said"),
    [
        ({"gap": 64.5e-6}, "in planned shape 1"),
        (
            {"force": 0.07},
            "for the shapes included, beyond its limit of 0.07, at rest under 'bare'",
        ),
    ],
)
def test_a_plan_without_room_is_refused_at_rest(tmp_path, limits, said):
    bench = StubBench()
    with pytest.raises(LimitExceeded, match=said):
        tn.acquire(bench, limited(**limits), tmp_path / "c")
    assert all(not shape.position.any() for shape in bench.commanded)


@pytest.mark.parametrize(
    ("where", "value", "said"),
    [
        (2, 5.1e-6, r"actuator 3 takes 5\.1e-06 m of stroke, beyond its limit of 5e-06"),
        (2, -5.1e-6, r"actuator 3 takes 5\.1e-06 m of stroke"),
        (7, np.nan, "a displacement is NaN"),
        (7, np.inf, "a displacement is NaN"),
    ],
)
def test_a_shape_beyond_a_limit_is_never_commanded(tmp_path, where, value, said):
    position = np.where(np.arange(8) == where, value, 1e-7)
    # Alone, whatever was checked before; off actuators have glass too.
    off = dataclasses.replace(SMALL.layout, enabled=np.arange(8) != where)
    with pytest.raises(LimitExceeded, match=f"{said}.*shape 2 . of cycle 1"):
        Guard(MirrorLimits(), off, GAP).check_command(Shape(LOADS[0], 1, 2, 1, position))
    image = np.stack([np.full(8, 1e-7), position])
    write_shapes(tmp_path / "shapes.fits", image)
    bench, plan = StubBench(), small_plan(shapes=PlannedShapes(source="shapes.fits"))
    reason = f"{said}.*in planned shape 2|SHAPES contains NaN"
    with pytest.raises((LimitExceeded, FormatError), match=reason):
        tn.acquire(bench, plan, tmp_path / "c", beside=tmp_path)
    assert not bench.commanded


FAULTS = st.sampled_from(["nan", "unsettled", "stale", "fault", "position"])


def upset(faults):
    """Return a spoiler that upsets the readings at some counts."""

    def spoil(shape, reading):
        kind = faults.get(reading.counter, "")
        if kind == "fault":
            raise BenchFault("something")
        return dataclasses.replace(
            reading,
            force=np.full(8, np.nan) if kind == "nan" else reading.force,
            position=reading.position + 4e-6 if kind == "position" else reading.position,
            settled=kind != "unsettled",
            counter=reading.counter - 1 if kind == "stale" else reading.counter,
        )

    return spoil


@pytest.mark.study
@settings(
    max_examples=60,
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(
    stroke=st.floats(1e-8, 9e-6),
    displacement=st.floats(1e-7, 6e-6),
    closest=st.floats(5.9e-5, 6.45e-5),
    force=st.floats(0.03, 0.2),
    share=st.floats(1e-3, 1.0),
    stiffer=st.floats(0.2, 1.0),
    rest=st.floats(0.0, 0.06),
    seed=st.integers(0, 2**32 - 1),
    faults=st.dictionaries(st.integers(1, 80), FAULTS, max_size=12),
)
def test_no_command_beyond_a_limit_reaches_a_bench(
    tmp_path_factory, stroke, displacement, closest, force, share, stiffer, rest, seed, faults
):
    """The bench counts; the plan keeps its word on forces, the rest is anything."""
    folder = tmp_path_factory.mktemp("p")
    limits = MirrorLimits(force=force, displacement=displacement, gap=closest)
    bench = StubBench(stiffer=stiffer, rest=rest, noise=1e-9, spoil=upset(faults))
    random = np.random.default_rng(seed)
    shapes = random.standard_normal((4, 8))
    shapes *= stroke / np.abs(shapes).max()
    # What the plan says of the forces is true, of glass as stiff as its model at most.
    planned = share * force
    taken = np.abs(shapes @ bench.stiffness / stiffer).max()
    shapes *= min(1.0, planned / taken)
    write_shapes(folder / "shapes.fits", shapes)
    plan = small_plan(
        shapes=PlannedShapes(source="shapes.fits", stroke=1e-9, force=planned), limits=limits
    )
    beyond, after, read = [], [], bench.spoil

    def count(shape):
        if after:
            beyond.append(("after a reading beyond a limit", shape))
        z = np.abs(shape.position).max()
        if z > displacement or z > GAP - closest:
            beyond.append(("stroke", shape))
        if shape.number and np.abs(bench.exact(shape)).max() > force + 1e-7:
            beyond.append(("force", shape))
        StubBench.command(bench, shape)

    def note(shape, reading):
        reading = read(shape, reading)
        z = np.abs(reading.position).max()
        if (
            z > min(displacement, GAP - closest)
            or np.nanmax(np.abs(reading.force), initial=0) > force
        ):
            after.append(shape)
        return reading

    bench.command, bench.spoil = count, note
    try:
        tn.acquire(bench, plan, folder / "c", beside=folder)
    except (LimitExceeded, BenchFault):
        pass
    else:
        assert len(bench.read_of) >= 2 * (1 + 2 * 8)
    assert not beyond
    assert bench.shape is None or not bench.commanded


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (lambda shape, z: np.roll(z, 1), "in a shape of 1e-06 m; .* plan fewer shapes"),
        (lambda shape, z: z + 2e-7 * shape.number * np.eye(8)[2], "actuator 3 is .* m from"),
        (
            lambda shape, z: 0.8 * z,
            "allowed are 10% of the stroke and 6 times its position_scatter of 1e-",
        ),
    ],
    ids=["cables", "one actuator", "scale"],
)
def test_a_bench_in_another_shape_than_commanded_is_noticed(tmp_path, spoil, said):
    scatter = 1e-9 if "scatter" in said else np.nan
    bench = StubBench(
        spoil=lambda shape, reading: dataclasses.replace(
            reading,
            position=spoil(shape, reading.position),
            position_scatter=np.full(8, scatter),
        )
    )
    with pytest.raises(BenchFault, match=said):
        tn.acquire(bench, small_plan(), tmp_path / "c")


def test_what_its_noise_explains_is_no_other_shape(tmp_path):
    """Sensors of 60 nm in shapes of 1 um: within six standard deviations of a sample."""
    random = np.random.default_rng(1)
    bench = StubBench(
        spoil=lambda shape, reading: dataclasses.replace(
            reading,
            position=reading.position + 6e-8 * random.standard_normal(8),
            position_scatter=np.full(8, 6e-8),
        )
    )
    tn.acquire(bench, small_plan(), tmp_path / "c")
    assert all(cycle.valid.all() for cycle in tn.read(tmp_path / "c").cycles)


@pytest.mark.parametrize("given", [(1.0,), ("steep", None), (np.nan, 1.0), (1e9, None), 3.0])
def test_gradients_that_are_none_are_refused_before_anything_is_taken(tmp_path, given):
    class Odd(StubBench):
        gradients = given

    bench = Odd()
    with pytest.raises(BenchFault, match="the bench gives gradients"):
        tn.acquire(bench, small_plan(), tmp_path / "c")
    assert bench.commanded == []


def test_a_reading_of_lists_counts_and_one_of_words_is_a_fault(tmp_path):
    as_lists = StubBench(spoil=lambda shape, r: dataclasses.replace(r, force=r.force.tolist()))
    tn.acquire(as_lists, small_plan(), tmp_path / "c")
    assert len(tn.read(tmp_path / "c").cycles) == 4
    words = StubBench(spoil=lambda shape, r: dataclasses.replace(r, force=["much"] * 8))
    with pytest.raises(BenchFault, match="the force of a reading is no array of numbers"):
        tn.acquire(words, small_plan(), tmp_path / "d")
