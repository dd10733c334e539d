"""What the calibration buys: modes, dissipation and the number of modes.

    python -m studies.modes [--seeds 20]             # P45 in closed loop, beside the truth
    python -m studies.modes --sensors                # what gains and places of the sensors do
    python -m studies.modes --real FOLDER            # the measured LBT672 matrix, beside figures
                                                        # computed elsewhere

The last holds the published set-up: stiffness symmetrised as measured, modes by magnitude, 452 mm
of the mirror on 4.11 m of the pupil, L0 = 40 m, no static force, 0.508 N/W^1/2; its turbulence has
piston in it. Below, what is right: alpha known, no piston.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

import truenewton as tn
from studies.modal_truth import score_modes
from truenewton.bench.simulated.static import loop_of, run_cycles, static_bench
from truenewton.estimation.reciprocity.sensor_model import at_nominal, places_of, sensors_at
from truenewton.mirrors.sensor_model import sensor_model
from truenewton.modal.findings import compare_modes, find_modes
from truenewton.modal.modal_base import Dissipation, dissipation, modal_base
from truenewton.modal.true_stiffness import TrueStiffness, true_stiffness
from truenewton.modal.turbulence import Atmosphere, Pupil, seen_turbulence, structure_function
from truenewton.records.campaign import Campaign
from truenewton.statics.arms import arms
from truenewton.statics.modes import stiffness_modes

WAYS = ("alpha = 1, symmetric", "singular vectors", "calibrated")
PUPIL, EFFICIENCY = Pupil(radius=0.452, diameter=8.22), 0.508
OFFSET = 5e-4  # of a sensor off its magnet along an axis [m]
NUMBERS = (100, 200, 400, 600, 650)
# seeing: force rms [mN], worst actuator [mN], residual surface [nm] for these numbers; power [W]
Published = tuple[tuple[int, ...], tuple[int, ...], tuple[int, ...], int]
PUBLISHED: dict[float, Published] = {
    0.8: ((16, 27, 78, 178, 226), (24, 36, 186, 340, 421), (90, 66, 43, 19, 0), 128),
    1.5: ((27, 45, 132, 300, 381), (41, 60, 313, 575, 711), (153, 111, 73, 32, 0), 366),
}


def known(seeds: int) -> None:
    """Print errors of modes and of their number, with and without calibration."""
    scores = []
    for seed in range(seeds):
        bench = static_bench(tn.mirrors.p45(), seed)
        campaign = Campaign(tuple(run_cycles(bench, 2, loop_of(bench))))
        found = find_modes(campaign, diameter=2.13, efficiency=0.51)
        scores.append(score_modes(campaign, found, bench.truth))
        print(f"  {seed + 1} of {seeds}", file=sys.stderr)
    print(f"P45 in closed loop, 2 cycles x 2 loads, {seeds} seeds: mean and its error")
    print(f"{'':<46}" + "".join(f"{name:<24}" for name in WAYS))
    degrees = np.degrees([s.distance for s in scores])
    row("distance from the true modes [deg]", degrees)
    row("distance, over that of calibrated modes", degrees / degrees[:, 2:])
    row("error of the number of modes within a power", [s.power_number for s in scores])
    row("error of the number of modes within a force", [s.force_number for s in scores])


def of_sensors(seeds: int) -> None:
    """Print errors of modes for different knowledge of sensors, which are 0.5 mm off.

    With a model of the glass, true modes are those at the magnets; otherwise as read by sensors.
    """
    mirror = tn.mirrors.p45()
    motion = sensor_model(mirror, mirror.layout)
    assert motion is not None
    places = places_of(mirror.layout, motion)
    assert places.motion is not None
    scores: dict[str, list[list[float]]] = {}
    for seed in range(seeds):
        bench = static_bench(mirror, seed)
        offset = OFFSET * np.random.default_rng([seed, 5]).standard_normal((2, places.n))
        for name, far in (("at their magnets", 0.0 * offset), ("0.5 mm off", offset)):
            values = replace(at_nominal(places.n), offset=far)
            seen = sensors_at(places, values, slopes=bool(far.any()))
            back = np.linalg.solve(seen.motion, places.motion).T
            campaign = Campaign(
                tuple(
                    replace(c, position=np.asarray(c.position) @ back) for c in run_cycles(bench, 2)
                )
            )
            for glass, known_motion in (("", None), (", glass known", motion)):
                made = tn.calibrate(campaign, "reciprocity", motion=known_motion)
                measured = find_modes(campaign, made).measured
                assert measured is not None
                found = measured.matrix
                here = replace(made, sensors=tuple(replace(s, x=0.0, y=0.0) for s in made.sensors))
                truth = bench.truth.stiffness
                if known_motion is not None:
                    truth = truth @ np.linalg.inv(places.motion)
                scores.setdefault(name + glass, []).append(
                    [
                        off_the_truth(true_stiffness(found, c, motion=known_motion), truth)
                        for c in (replace(made, sensors=()), here, made)
                    ]
                )
    print(f"P45, 2 cycles x 2 loads, {seeds} seeds: distance from the true modes [deg]")
    print(f"{'sensors':<46}" + "".join(f"{n:<24}" for n in ("not used", "gains", "and places")))
    for name, rows in scores.items():
        row(name, rows)


def off_the_truth(found: TrueStiffness, truth: np.ndarray) -> float:
    """Return the distance of modes from those of the (n, n) true stiffness [deg]."""
    true = stiffness_modes(0.5 * (truth + truth.T), arms(found.layout).T)
    compared_modes = compare_modes(true.modes, found.modes.modes, true.stiffness)
    return float(np.degrees(compared_modes.distance))


def row(what: str, threes: object) -> None:
    columns = np.asarray(threes, dtype=float).T
    print(f"  {what:<44}" + "".join(f"{with_error(values):<24}" for values in columns))


def with_error(values: np.ndarray) -> str:
    return f"{values.mean():.3g} +- {values.std(ddof=1) / np.sqrt(len(values)):.1g}"


def real(folder: str) -> None:
    """Print forces, residual and power of the measured matrix and the published ones."""
    matrix = tn.read_stiffness(Path(folder) / "lbt672" / "lbt672-feedforward.fits")
    calibration = tn.calibrate(matrix, "ml")
    x, y = (PUPIL.diameter / 2 / PUPIL.radius * v for v in (matrix.layout.x, matrix.layout.y))
    for seeing, published in PUBLISHED.items():
        atmosphere = Atmosphere(seeing)
        seen = seen_turbulence(matrix.layout, matrix.layout.enabled, atmosphere, PUPIL)
        measured, right = (
            modal_base(matrix, each, each.modes, seen, np.zeros(650), EFFICIENCY)
            for each in (true_stiffness(matrix, alpha) for alpha in (None, calibration))
        )
        separation = np.hypot(x[:, None] - x, y[:, None] - y)
        far = structure_function(np.array(1e9), atmosphere)  # twice the variance
        with_piston = 0.5 * (far - structure_function(separation, atmosphere))
        as_published = dissipation(
            "stiffness", measured.modes.modes, measured.stiffness,
            replace(seen, wavefront=with_piston), np.zeros(650), EFFICIENCY,
        )  # fmt: skip
        print(f"seeing {seeing} arcsec")
        print(f"  {'modes':<36}" + "".join(f"{number:<12}" for number in NUMBERS))
        compared("as published", as_published, published)
        for name, base in (("alpha = 1, no piston", measured), ("calibrated, no piston", right)):
            table(name, base.costs[0])


def figures(cost: Dissipation) -> tuple[tuple[str, np.ndarray], ...]:
    at = np.array(NUMBERS) - 1
    return (
        ("force rms [mN]", 1e3 * np.sqrt(np.mean(cost.force[:, at] ** 2, axis=0))),
        ("worst actuator [mN]", 1e3 * cost.force[:, at].max(axis=0)),
        ("residual surface [nm]", 0.5e9 * cost.residual[at]),
    )


def compared(name: str, cost: Dissipation, published: Published) -> None:
    worst = 0.0
    for (what, values), wanted in zip(figures(cost), published[:3], strict=True):
        pairs = "".join(f"{f'{v:.3g} / {w}':<12}" for v, w in zip(values, wanted, strict=True))
        print(f"  {name + ', ' + what:<36}{pairs}")
        worst = max(worst, *(abs(v / w - 1) for v, w in zip(values, wanted, strict=True) if w))
    power = cost.power[:, -1].sum()
    worst = max(worst, abs(power / published[3] - 1))
    print(f"  {name}, power of all modes: {power:.4g} / {published[3]} W; worst ratio off by"
          f" {100 * worst:.1f} %")  # fmt: skip


def table(name: str, cost: Dissipation) -> None:
    for what, values in figures(cost):
        print(f"  {name + ', ' + what:<44}" + "".join(f"{value:<12.3g}" for value in values))
    print(f"  {name}, power of all modes: {cost.power[:, -1].sum():.4g} W")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--sensors", action="store_true")
    parser.add_argument("--real")
    asked = parser.parse_args()
    if asked.real:
        real(asked.real)
    else:
        (of_sensors if asked.sensors else known)(asked.seeds)
