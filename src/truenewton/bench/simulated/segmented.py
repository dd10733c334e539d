"""A mirror in segments on the static bench: a bench for each, which move together.

Nothing acts between segments: each has its own glass, weights, tool, coils and sensors. All take
the shape of the same number at once, each its own stiffness mode of that number.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from truenewton.arrays import Array
from truenewton.bench.simulated.static import StaticBench, loop_of, run_cycles, static_bench
from truenewton.bench.simulated.truth import SegmentTruth, Truth
from truenewton.errors import BenchFault
from truenewton.mirrors.known import Mirror
from truenewton.mirrors.segmented import SegmentedMirror
from truenewton.mirrors.shell.shell_model import ShellModel, model_shell
from truenewton.records.cycle import Cycle, Segment, sums_of
from truenewton.statics.arms import effective_weight, external_load

SEEDS = 1000  # of one mirror: more segments than that would share their noise


@dataclass(frozen=True, eq=False)
class SegmentedBench:
    """A mirror in segments, each with its truth and its plan of shapes.

    All have as many shapes; a segment with fewer takes its first ones again.
    """

    mirror: SegmentedMirror
    benches: tuple[StaticBench, ...]
    seed: int  # segment k has that of `seed_of`

    @property
    def shapes(self) -> Array:
        """(shapes, n) readings along z of all actuators [m]."""
        return np.concatenate([bench.shapes for bench in self.benches], axis=1)


def seed_of(seed: int, number: int) -> int:
    """Return the seed of a segment of a mirror."""
    return SEEDS * seed + number


def segmented_bench(
    mirror: SegmentedMirror, seed: int, *, force_noise: float, temperature: float
) -> SegmentedBench:
    """Draw the truth of each segment, under the bare mirror and its own tool, as `static_bench`."""
    glasses: dict[int, ShellModel] = {}
    for part, alike in mirror.kinds:
        glasses |= dict.fromkeys(alike, model_shell(part))
    benches = [
        static_bench(
            segment,
            seed_of(seed, k),
            force_noise=force_noise,
            temperature=temperature,
            glass=glasses[k],
        )
        for k, segment in enumerate(mirror.segments, 1)
    ]
    most = max(len(bench.shapes) for bench in benches)
    filled = (
        replace(bench, shapes=bench.shapes[np.arange(most) % len(bench.shapes)])
        for bench in benches
    )
    return SegmentedBench(mirror, tuple(filled), seed)


def bench_of(
    mirror: Mirror | SegmentedMirror, seed: int, *, force_noise: float, temperature: float
) -> StaticBench | SegmentedBench:
    """Return the static bench of a mirror in one piece or in segments."""
    if isinstance(mirror, SegmentedMirror):
        return segmented_bench(mirror, seed, force_noise=force_noise, temperature=temperature)
    return static_bench(mirror, seed, force_noise=force_noise, temperature=temperature)


def campaign_on(
    bench: StaticBench | SegmentedBench, cycles: int, fidelity: str = "static"
) -> Iterator[Cycle]:
    """Return the cycles of a campaign on a bench, as `run_cycles`; 'loop' closes the loop.

    A mirror in segments is not simulated in closed loop.
    """
    if isinstance(bench, StaticBench):
        return run_cycles(bench, cycles, loop_of(bench) if fidelity == "loop" else None)
    if fidelity == "loop":
        raise BenchFault(
            f"{bench.mirror.name} is in segments, whose loop is not simulated",
            remedy="leave --fidelity out, or give the file of one segment",
        )
    first, *others = (run_cycles(one, cycles) for one in bench.benches)
    # Of a cycle that was written only the first segment is kept while the next one is made.
    return (_joined(bench.mirror, [part, *map(next, others)]) for part in first)


def _joined(mirror: SegmentedMirror, parts: Sequence[Cycle]) -> Cycle:
    """Return the cycle that the cycles of all segments make."""
    segments = tuple(
        Segment(k, part.weight, part.weight_error, part.load.added, part.load.added_error)
        for k, part in enumerate(parts, 1)
    )
    sums, first = sums_of(segments), parts[0]
    return replace(
        first,
        instrument=mirror.name,
        load=replace(first.load, added=sums["added"], added_error=sums["added_error"]),
        weight=sums["weight"],
        weight_error=sums["weight_error"],
        layout=mirror.layout,
        force=np.concatenate([np.asarray(part.force) for part in parts], axis=1),
        position=np.concatenate([np.asarray(part.position) for part in parts], axis=1),
        segments=segments,
    )


def truth_of(bench: StaticBench | SegmentedBench) -> Truth:
    """Return what is true of a bench."""
    if isinstance(bench, StaticBench):
        return bench.truth
    truths = [one.truth for one in bench.benches]
    widest = max(len(truth.alpha) for truth in truths)
    padded = [np.pad(one.stiffness, ((0, 0), (0, widest - len(one.alpha)))) for one in truths]
    places = [place.motion for place in bench.mirror.places]
    torques = np.array([_torques_about_axis(*each) for each in zip(truths, places, strict=True)])
    segments = [
        SegmentTruth(k, load, truth.weight, float(added), truth.bias_force, *torque)
        for k, (truth, of_loads) in enumerate(zip(truths, torques.tolist(), strict=True), 1)
        for load, added, torque in zip(truth.loads, truth.added, of_loads, strict=True)
    ]
    return replace(
        truths[0],
        instrument=bench.mirror.name,
        layout=bench.mirror.layout,
        alpha=np.concatenate([truth.alpha for truth in truths]),
        stiffness=np.concatenate(padded),
        sensor_gain=np.concatenate([truth.sensor_gain for truth in truths]),
        weight=sum(truth.weight for truth in truths),
        added=np.sum([truth.added for truth in truths], axis=0),
        bias_force=sum(truth.bias_force for truth in truths),
        torque_y=torques[..., 0].sum(axis=0),
        torque_x=torques[..., 1].sum(axis=0),
        seed=bench.seed,
        segments=tuple(segments),
    )


def _torques_about_axis(truth: Truth, motion: Array) -> Array:
    """Return (L, 2) M_y and M_x under each load about the origin of the mirror [N m]."""
    weight = effective_weight(truth.weight, truth.added, truth.tilt)
    load = external_load(weight, truth.bias_force, truth.torque_y, truth.torque_x)
    _, along_x, along_y = motion @ load.T
    return np.stack([along_x, -along_y], axis=1)
