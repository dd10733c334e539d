"""Small campaigns, each with a finding or two: 12 to 24 actuators, a fraction of a second each.

With `small_matrices` they have every code of a finding that no case of `cases` has.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np

import truenewton as tn
from helpers.balanced import (
    LAYOUT,
    RING,
    WEIGHT,
    arms_of,
    campaign_of,
    changed,
    gradients,
    three_loads,
    with_spike,
)
from helpers.small_bench import SmallBench
from reference.cases import Result, calibration_result, finding_line, small, verdict_lines
from studies.simulated_matrices import springs
from truenewton.acquisition.plan import CampaignPlan
from truenewton.bench.simulated.static import run_cycles, static_bench
from truenewton.calibration.survey import survey
from truenewton.estimation.findings.estimate import Goodness, NoiseSource
from truenewton.planning.forces import prepared_bodies
from truenewton.planning.plan_prediction import predict_errors, predict_prepared
from truenewton.records.cycle import Cycle

Array = np.ndarray
N, ONE = LAYOUT.n, 6  # of eight files, four under each of two loads, the one that is changed
EIGHTH = np.arange(N) == 7
BARE = tn.Load("bare")


def files(
    change: Callable[[SmallBench], object] = lambda _: None,
    noise: float = 1e-4,
    **order: tuple[int, ...],
) -> tn.Campaign:
    """Return a campaign on a bench that a function changes."""
    bench = SmallBench(3, noise, **order)
    change(bench)
    return bench.campaign()


def one(**fields: Callable[[Cycle], Any]) -> tn.Campaign:
    """Return a campaign of which fields of one file are changed."""
    some = {
        name: lambda k, c, name=name, new=new: new(c) if k == ONE else getattr(c, name)
        for name, new in fields.items()
    }
    return changed(files(), **some)


def every(of: tn.Campaign | None = None, **fields: Callable[[Cycle], Any]) -> tn.Campaign:
    """Return a campaign of which fields of all files are changed."""
    some = {name: lambda _, c, new=new: new(c) for name, new in fields.items()}
    return changed(of or files(), **some)


def other_added(name: str, factor: float) -> tn.Campaign:
    """Return a campaign under three loads, the weight of one of which is wrong."""
    return every(
        three_loads(40, 1e-4),
        load=lambda c: replace(c.load, added=factor * c.load.added) if c.load.name == name
        else c.load,
    )  # fmt: skip


def in_proportion(bench: SmallBench) -> None:
    """Let the noise of a reading be 1 % of the force."""
    force = bench.readings
    bench.error = bench.error + 0.01 * force * bench.random.standard_normal(force.shape)


def zeros_that_jump(bench: SmallBench) -> None:
    """Let the zero of all jump before each file, and stay."""
    jumps = 2e-4 * bench.random.standard_normal(len(bench.order))
    bench.zero = np.cumsum(jumps)[bench.file][:, None]


def flatter(bench: SmallBench) -> None:
    """Let NZ be less than declared, by 1 % at 0.1 m from the centre."""
    bench.arms = bench.arms.copy()
    bench.arms[0] -= bench.arms[1] ** 2 + bench.arms[2] ** 2


def stuck_with_noise() -> Result:
    """Return the verdict alone: alpha of what reads the same in all rows is rounding."""
    reads = every(
        simulated(24), force=lambda c: np.where(np.arange(24) == 7, noise_of(c) + 0.2, c.force)
    )
    return Result(verdict_lines(tn.calibrate(reads, population=True).verdict))


small("files", {
    "POSITION of one file in another unit": lambda: one(position=lambda c: 3.0 * c.position),
    "POSITION of one file of the other sign": lambda: one(position=lambda c: -c.position),
    "POSITION of one file in another order": lambda: one(
        position=lambda c: np.roll(c.position, 1, axis=1)
    ),
    "POSITION not read": lambda: every(position=lambda c: 0.0 * c.position),
    "a sensor frozen in one file": lambda: one(
        position=lambda c: np.where(EIGHTH, c.position[:1], c.position)
    ),
    "poles exchanged in one file": lambda: one(force=lambda c: np.where(EIGHTH, -1, 1) * c.force),
    "a load under two names": lambda: one(load=lambda c: replace(c.load, name="rign")),
    "shapes in another order in one file": lambda: one(
        shape=lambda c: (np.random.default_rng(0).permutation(N) + 1)[c.shape - 1]
    ),
    "a date of next century": lambda: one(date=lambda c: c.date.replace(year=2062)),
    "degrees Fahrenheit": lambda: every(temperature=lambda c: np.full(len(c.time), 68.0)),
    "an actuator 50 mm off": lambda: every(
        simulated(24),
        layout=lambda c: replace(c.layout, x=c.layout.x + 0.05 * (np.arange(24) == 5)),
    ),
    "a shell of another curvature": lambda: files(flatter, noise=1e-3),
})  # fmt: skip

small("actuators", {
    "a reading that is stuck": lambda: every(
        force=lambda c: np.where(EIGHTH, 0.2, c.force)
    ),
    "a reading that is stuck, with noise": stuck_with_noise,
    "three without a command": lambda: every(
        simulated(45), force=lambda c: np.where(np.arange(45) % 20 == 3, noise_of(c), c.force)
    ),
    "one does nothing": lambda: files(lambda b: b.arms.__setitem__(np.s_[:, 5], 0.0), 1e-3),
    "all reversed": lambda: every(force=lambda c: -c.force),
    "alpha of one is 0": lambda: with_alpha(0.001, 0.002),
})  # fmt: skip

small("weights", {
    "FORCE in mN": lambda: every(force=lambda c: 1e3 * c.force),
    "WEIGHT ten times too large": lambda: every(weight=lambda c: 10.0 * c.weight),
    "WEIGHT ten times too small": lambda: every(weight=lambda c: 0.1 * c.weight),
    "a ring that was never on": lambda: tn.Campaign(tuple(
        c if c.number < 3 else replace(c, load=files().loads[1], number=c.number - 2)
        for c in files().cycles[:4]
    )),
    "a load as light as nothing": lambda: campaign_of(
        5, 1e-3, loads=(BARE, tn.Load("ring", 1e-3 * WEIGHT, 5e-5)), cycles=4
    )[0],
    "one load": lambda: surveyed(tn.Campaign(files().cycles[:4])),
    "equal loads": lambda: surveyed(every(load=lambda c: replace(c.load, added=0.0))),
    "one load left of two": lambda: left_with_one_load(tn.calibrate(files())),
    "one of three wrong": lambda: other_added("ring", 1.0 + 20 * RING.added_error / 0.289),
    "loud readings": lambda: files(noise=0.2),
})  # fmt: skip

small("columns", {
    "a column that lags by a row": lambda: every(force=lambda c: np.where(
        EIGHTH, np.roll(c.force, 1, axis=0), c.force
    )),
    "a column that repeats another": lambda: every(force=lambda c: np.where(
        EIGHTH, np.roll(c.force, 1, axis=1), c.force
    )),
})  # fmt: skip

small("noise", {
    "FORCE in steps": lambda: every(files(noise=0.0),
                                    force=lambda c: 4e-5 * np.round(c.force / 4e-5)),
    "louder than declared": lambda: every(files(noise=1e-3), force_error=lambda _: 2e-4),
    "quieter than declared, one cycle": lambda: tn.Campaign(tuple(
        replace(files(noise=1e-3).cycles[k], force_error=5e-3) for k in (0, 4)
    )),
    "in proportion to the force": lambda: files(in_proportion),
    "zeros reset with each file": lambda: gradients(9, 1e-5, 1e-5, zeros=1e-2)[0],
    "zeros that jump and stay": lambda: files(zeros_that_jump, order=(0, 1, 0, 1, 0, 1, 0, 1)),
    "svd": lambda: tn.calibrate(files(), "svd"),
    "svd, loud": lambda: tn.calibrate(files(noise=1e-2), "svd"),
    "svd, a spike": lambda: tn.calibrate(with_spike(files(), 2, 4, 3, 0.3), "svd"),
    "svd, no fit": lambda: replace(tn.calibrate(files(), "svd"),
                                   goodness=Goodness(900.0, 100, NoiseSource.REPEATS, 0.0)),
})  # fmt: skip


@cache
def simulated(actuators: int) -> tn.Campaign:
    """Return a campaign of the mirror ring12 and so on, without gradients of its magnets."""
    bench = static_bench(tn.mirrors.ring(actuators), 3, force_noise=1e-4)
    return tn.Campaign(tuple(run_cycles(bench, 2)))


def noise_of(cycle: Cycle) -> Array:
    random = np.random.default_rng([cycle.number, len(cycle.load.name)])
    return 1e-4 * random.standard_normal(cycle.force.shape)


def with_alpha(alpha: float, error: float) -> tn.Calibration:
    """Return a calibration of which one alpha and its error are others."""
    made = tn.calibrate(files())
    return replace(
        made,
        alpha=np.where(EIGHTH, alpha, made.alpha),
        statistical_error=np.where(EIGHTH, error, made.statistical_error),
    )


def left_with_one_load(made: tn.Calibration) -> tn.Calibration:
    return replace(
        made, loads=made.loads[:1], torque_y=made.torque_y[:1], torque_x=made.torque_x[:1]
    )


def surveyed(campaign: tn.Campaign) -> Result:
    """Return the verdict on data that are refused."""
    return Result(verdict_lines(survey(campaign)[0]["verdict"]))


# -- reciprocity of campaigns ---------------------------------------------------------------------


def with_glass(change: Callable[[SmallBench], object] = lambda _: None) -> tn.Campaign:
    """Return a campaign whose displacements are those of a plate, moved as a whole besides."""

    def bent(bench: SmallBench) -> None:
        stiffness = springs(LAYOUT, lambda square: square * np.log(square) / (480.0 * np.pi))
        arms = arms_of(LAYOUT)
        moved = 1e-6 * bench.random.standard_normal((N, 3)) / np.abs(arms).max(axis=1)
        bench.displaced = bench.elastic @ np.linalg.pinv(stiffness) + moved @ arms
        change(bench)

    return files(bent)


def mixed(share: float, *rows: int) -> tn.Campaign:
    """Return a campaign in which sensors, some or all, read a share of all others."""
    mixture = share * np.random.default_rng(1).standard_normal((N, N))
    kept = np.isin(np.arange(N), rows) if rows else np.ones(N, dtype=bool)
    mixture = np.eye(N) + np.where(kept, mixture, 0.0)
    return every(with_glass(), position=lambda c: c.position @ mixture)


def in_pairs(position: Array) -> Array:
    order = np.arange(N)
    order[:10] = order[:10].reshape(-1, 2)[:, ::-1].ravel()
    return position[:, order]


def common_noise(bench: SmallBench) -> None:
    each = np.random.default_rng(1).standard_normal((len(bench.file), 1))
    bench.error = bench.error + 2e-4 * each * LAYOUT.nz


def drift(bench: SmallBench) -> None:
    bench.gain = 1.0 + 0.01 * (bench.hours / bench.hours.max())[:, None]


small("reciprocity", {
    "auto": lambda: tn.calibrate(with_glass(), "auto"),
    "sensors in another order": lambda: every(with_glass(),
                                              position=lambda c: in_pairs(c.position)),
    "auto, a drift": lambda: tn.calibrate(with_glass(drift), "auto"),
    "auto, common noise": lambda: tn.calibrate(with_glass(common_noise), "auto"),
    "sensors read others": lambda: tn.calibrate(mixed(0.002), "reciprocity"),
    "auto, sensors read others": lambda: tn.calibrate(mixed(0.005), "auto"),
    "a sensor reads others": lambda: tn.calibrate(mixed(0.3, 7), "reciprocity"),
})  # fmt: skip


# -- before and after -----------------------------------------------------------------------------

RING12 = CampaignPlan("ring12", (BARE, tn.Load("ring", -0.05, 0.001, tool="ring")), cycles=2)


def planned(*, whole: bool = False, **changes: Any) -> Result:
    """Return what is said of a plan; as a whole with its forces."""
    ready = prepared_bodies(replace(RING12, **changes))[0]
    if whole:
        return Result(tuple(map(finding_line, predict_prepared(ready).warnings)))
    found = predict_errors(ready)
    columns = {"ALPHA": found.alpha, "E_STAT": found.statistical_error}
    warnings = tuple(map(finding_line, found.diagnosis.warnings))
    return Result(warnings, tuple(range(len(found.alpha))), columns)


small("plans", {
    "one load": lambda: planned(loads=(BARE,)),
    "equal loads": lambda: planned(loads=(BARE, tn.Load("again"))),
    "weak patterns": lambda: planned(mirror="ring20", force_noise=0.1),
    "too much noise": lambda: planned(mirror="ring20", force_noise=0.14),
    "forces near their limit": lambda: planned(
        whole=True, limits=replace(RING12.limits, force=0.52)
    ),
})  # fmt: skip


def recalibrated(known: Any, *, temperature: float = 20.0) -> Result:
    """Return a recalibration of actuator 5 from one file, and what it says."""
    first = simulated(12).cycles[0]
    new = replace(
        first,
        force=first.force / np.where(np.arange(12) == 4, 0.8, 1.0),
        temperature=np.full(len(first.time), temperature),
    )
    made = tn.recalibrate(tn.Campaign((new,)), known, [5], accept_rejected=True)
    return calibration_result(made.calibration)


def earlier(**changes: Any) -> tn.Calibration:
    return replace(tn.calibrate(simulated(12)), sources=(), **{"temperature": 20.0, **changes})


def law(rejected: int) -> tn.Tracking:
    """Return a tracking of four days, one of which was rejected."""
    one, random = earlier(), np.random.default_rng(2)
    return tn.track(
        *(
            replace(
                one,
                date=one.date.replace(month=1 + day),
                date_end=one.date_end.replace(month=1 + day),
                temperature=16.0 + 2 * day,
                alpha=one.alpha * (1.0 + 1e-3 * random.standard_normal(12)),
                statistical_error=(6.6 if day == rejected else 0.001) * one.alpha,
            )
            for day in range(4)
        ),
        accept_rejected=True,
    )


small("recalibrations", {
    "another temperature": lambda: recalibrated(earlier(), temperature=28.0),
    "a calibration that was rejected": lambda: recalibrated(
        earlier(statistical_error=6.6 * earlier().alpha)
    ),
    "a law with a day that was rejected": lambda: recalibrated(law(0), temperature=18.0),
})  # fmt: skip
