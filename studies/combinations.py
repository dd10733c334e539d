"""Several small effects at once: do the stated errors contain what they do to alpha?

    python -m studies.combinations                       120 mixes of three effects
    python -m studies.combinations --effects 2 --mixes 60 --first 500
    python -m studies.combinations --list                each mix on a line
    python -m studies.combinations --prices              what a free effect costs

A mix is drawn by its seed: the effects, their size (1 or 3 times the usual one, which is small for
a bench), and the noise of a reading (0.05, 0.2 or 1 mN). The weights are declared without error,
because two loads cannot show one; stated errors are statistical. The columns are:

    covered        95 % intervals of alpha that contain the truth
    error/stated   median and largest ratio of rms error to rms stated error
    over 3         results with a ratio above 3 whose verdict is not *doubtful* or worse
    S U D R -      verdicts: sound, usable, doubtful, rejected; no alpha

The price of an effect is E_STAT with the effect free over E_STAT without it, in a fit to a sound
campaign. Columns are of loads in turn and in a row.
Without a prior, the balance cannot distinguish *undetermined* effects from alpha.
"""

from __future__ import annotations

import argparse
import os
import warnings
from collections import Counter
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

import truenewton as tn
from studies.accuracy import TWO_SIGMA
from studies.faults import LETTERS
from studies.faulty.bench import Day, bench_of
from studies.faulty.fault import ORDERS
from truenewton.errors import TrueNewtonError, TrueNewtonWarning
from truenewton.estimation.effects.catalogue import CATALOGUE
from truenewton.estimation.effects.derivative import FittedRows, scored
from truenewton.estimation.problem import problem_of
from truenewton.estimation.readings.moments import reading_noise
from truenewton.estimation.screening.screen import screen_campaign
from truenewton.linalg import inverse_of_positive

Array = np.ndarray
SEED = 46
SIZES, NOISES = (1.0, 3.0), (5e-5, 2e-4, 1e-3)
FULL_SCALE = 0.4  # of a coil's force [N], at which a law deviates by what is given


def of_file(day: Day, of_each: bool) -> Array:
    """Draw a normal number of each row's file, (N, 1) or (N, n) of each actuator."""
    drawn = day.random.standard_normal((len(day.order), day.n if of_each else 1))
    return np.asarray(drawn[day.file])


def zeros_by_file(day: Day, size: float, *, of_each: bool) -> None:
    day.zero = day.zero + 1e-4 * size * of_file(day, of_each)


def zeros_drift(day: Day, size: float) -> None:
    day.zero = day.zero + 5e-5 * size * np.outer(day.hours, day.random.standard_normal(day.n))


def gain_drifts(day: Day, size: float, *, of_each: bool) -> None:
    each = 5e-4 * day.random.standard_normal(day.n) if of_each else np.full(day.n, 1e-3)
    day.gain = day.gain * (1 + size * np.outer(day.hours, each))


def gain_by_file(day: Day, size: float) -> None:
    day.gain = day.gain * (1 + 5e-4 * size * of_file(day, False))


def coils_warm_up(day: Day, size: float) -> None:
    day.gain = day.gain * (1 + 1e-3 * size * np.exp(-day.hours[:, None] / 0.5))


def coil_weakens(day: Day, size: float) -> None:
    lost = np.outer(day.hours > np.median(day.hours), np.arange(day.n) == day.actuator())
    day.gain = day.gain * (1 - 2e-3 * size * lost)


def coils_bend(day: Day, size: float, *, power: int, of_each: bool) -> None:
    each = 2e-3 * size * (day.random.standard_normal(day.n) if of_each else 1.0)
    before = day.law
    day.law = lambda c: before(c) * (1 + each * (c / FULL_SCALE) ** power)


def gradients(day: Day, size: float) -> None:
    day.gain = day.gain * (1 + 100.0 * size * day.z)
    day.bias = day.bias + 5.0 * size * day.z


def contact_in_one_sign(day: Day, size: float) -> None:
    day.push(np.where(day.sign > 0, 2e-3 * size, 0.0), day.somewhere())


def force_in_a_file(day: Day, size: float) -> None:
    file = day.random.integers(len(day.order))
    day.push(np.where(day.file == file, 2e-3 * size, 0.0), day.somewhere())


def bias_drifts(day: Day, size: float) -> None:
    day.bias = day.bias + 1e-3 * size / day.n * day.hours[:, None]


def misplaced(day: Day, size: float) -> None:
    x, y = 1e-4 * size * day.random.standard_normal((2, day.n))
    true = day.layout
    day.layout = tn.layout(true.x + x, true.y + y, id=true.id, nz=true.nz)


def ring_repositioned(day: Day, size: float) -> None:
    (x, y), added = day.wedges[1], day.bench.mirror.added_weight
    for file in np.unique(day.file[day.load == 1]):
        dx, dy = day.random.normal(0.0, 5e-5 * size, 2)
        force = np.where(day.file == file, added, 0.0)
        day.push(force, (x + dx, y + dy))
        day.push(-force, (x, y))


EFFECTS: dict[str, Callable[[Day, float], None]] = {
    "zero by file of all": partial(zeros_by_file, of_each=False),
    "zero by file of each": partial(zeros_by_file, of_each=True),
    "zeros drift": zeros_drift,
    "gain drifts": partial(gain_drifts, of_each=False),
    "gain of each drifts": partial(gain_drifts, of_each=True),
    "gain by file": gain_by_file,
    "coils warm up": coils_warm_up,
    "one coil weakens": coil_weakens,
    "quadratic coils": partial(coils_bend, power=1, of_each=False),
    "quadratic coils of each": partial(coils_bend, power=1, of_each=True),
    "cubic coils": partial(coils_bend, power=2, of_each=False),
    "cubic coils of each": partial(coils_bend, power=2, of_each=True),
    "gradients": gradients,
    "contact in one sign": contact_in_one_sign,
    "force in a file": force_in_a_file,
    "bias magnets drift": bias_drifts,
    "positions": misplaced,
    "ring repositioned": ring_repositioned,
}


@dataclass(frozen=True, eq=False)
class Mix:
    """What was drawn, and the result of its calibration.

    Attributes
    ----------
    name
        Noise, size and effects.
    size
        1 or 3; 0 without effects.
    ratio
        rms error of alpha / rms stated error; NaN without alpha.
    covered
        Fraction of the 95 % intervals that contain the truth.
    grade, codes
        Letter of the verdict, '-' without alpha; codes of the effects that were found.
    """

    name: str
    size: float
    ratio: float = float("nan")
    covered: float = float("nan")
    grade: str = "-"
    codes: tuple[str, ...] = ()


def mix(seed: int, count: int, mirror: str, cycles: int) -> Mix:
    """Draw a mix of effects, simulate its campaign and calibrate it."""
    warnings.simplefilter("ignore", TrueNewtonWarning)
    random = np.random.default_rng([SEED, seed])
    chosen = random.choice(list(EFFECTS), count, replace=False)
    size, noise = float(random.choice(SIZES)), float(random.choice(NOISES))
    day = Day(bench_of(mirror), seed, noise, ORDERS["in a row"](cycles))
    for name in chosen:
        EFFECTS[name](day, size)
    name = f"{1e3 * noise:g} mN, size {size:g}: {', '.join(chosen)}"
    try:
        found = tn.calibrate(day.campaign())
    except TrueNewtonError:
        return Mix(name, size)
    error = found.alpha - day.truth
    return Mix(
        name,
        size,
        float(np.sqrt(np.mean(error**2) / np.mean(found.error**2))),
        float(np.mean(np.abs(error) < TWO_SIGMA * found.error)),
        LETTERS[str(found.verdict.level)],
        tuple(str(effect.code) for effect in found.effects),
    )


def print_prices(mirror: str, cycles: int) -> None:
    """Print the price of each effect in a sound campaign, with loads in turn and in a row."""
    warnings.simplefilter("ignore", TrueNewtonWarning)
    prices: dict[str, dict[str, str]] = {str(effect.code): {} for effect in CATALOGUE}
    orders = ("in turn", "in a row")
    for order in orders:
        day = Day(bench_of(mirror), 0, NOISES[1], ORDERS[order](cycles))
        campaign = day.campaign()
        moments = replace(screen_campaign(campaign).moments, pooled=True)
        problem = problem_of(campaign, reading_noise(campaign, moments))
        fit = FittedRows(problem, moments, problem.fitted(moments), independent=True)
        whole = float(np.trace(fit.minimum.reading_covariance[: day.n, : day.n]))
        for effect in CATALOGUE:
            derivative = effect.derivative(fit)
            if derivative is None:
                continue
            result = scored(fit, derivative)
            moves = result.moves[:, : day.n]
            covariance = inverse_of_positive(result.information + np.diag(1e-9 * result.whole))
            price = np.sqrt(1.0 + np.sum((covariance @ moves) * moves) / whole)
            # Beyond this it is set by the small precision that keeps the inverse finite.
            known = f"{price:.4f}" if price < 100.0 else "undetermined"
            prices[str(effect.code)][order] = known
    print(f"{mirror}, {cycles} cycles a load\n{'':<32}" + "".join(f"{o:>15}" for o in orders))
    for code, of_order in prices.items():
        print(f"{code:<32}" + "".join(f"{of_order.get(o, '-'):>15}" for o in orders))


def print_summary(name: str, rows: list[Mix]) -> None:
    """Print the figures of some mixes on a line."""
    known = [row for row in rows if row.grade != "-"]
    if not known:
        return
    ratio = np.array([row.ratio for row in known])
    wrong = sum(row.ratio > 3 and row.grade in "SU" for row in known)
    covered = np.mean([row.covered for row in known])
    grades = " ".join(f"{g}{k}" for g, k in Counter(row.grade for row in rows).most_common())
    print(
        f"{name:<14}{len(rows):6d}{covered:10.1%}{np.median(ratio):10.2f}{ratio.max():8.2f}"
        f"{wrong:8d}   {grades}",
        flush=True,
    )


def main() -> None:
    """Run from the command line."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("--mixes", type=int, default=120)
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--effects", type=int, default=3, help="in each mix")
    parser.add_argument("--mirror", choices=("p45", "336"), default="p45")
    parser.add_argument("--cycles", type=int, default=4, help="under each load")
    parser.add_argument("--list", action="store_true", help="print each mix")
    parser.add_argument("--prices", action="store_true", help="print the price of each effect")
    options = parser.parse_args()
    if options.prices:
        print_prices(options.mirror, options.cycles)
        return
    one = partial(mix, count=options.effects, mirror=options.mirror, cycles=options.cycles)
    with ProcessPoolExecutor() as pool:
        rows = list(pool.map(one, range(options.first, options.first + options.mixes)))
    if options.list:
        for row in rows:
            said = ", ".join(row.codes) or "none"
            print(f"{row.grade} {row.ratio:7.2f} {row.covered:5.0%}  {row.name} -> {said}")
    print(
        f"{options.mirror}, {options.cycles} cycles a load, {options.effects} effects in each mix"
    )
    print(f"{'':<14}{'mixes':>6}{'covered':>10}{'error/stated':>18}{'over 3':>8}   verdicts")
    for size in SIZES:
        print_summary(f"size {size:g}", [row for row in rows if row.size == size])
    print_summary("all", rows)


if __name__ == "__main__":
    main()
