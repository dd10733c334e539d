"""Errors of alpha and reported messages for simulated faults of the bench and of files.

    python -m studies.faults [--seeds 24] [--noise 1e-3 5e-5] [--only NAME ...] [--cycles 4]
    python -m studies.faults --only clean --seeds 1000      rate of false messages
    python -m studies.faults --mirror 336 --cycles 2        336 actuators on rings
    python -m studies.faults --method ml auto glass         methods on the same campaigns
    python -m studies.faults --grades --seeds 4             coverage of the errors by grade
    python -m studies.faults --grades --only clean --seeds 50    rate of false 'doubtful'

The bench is simulated in `faulty`. Alpha, noise and the affected files or actuators depend on the
seed. The weights are declared without error, because two loads cannot show one; stated errors are
statistical. Alpha is compared with its true mean over the campaign. Actuators that a fault disables
are excluded. The columns are:

    error, scale, stated   rms error of alpha; of its mean over actuators; stated error
    covers, none           95 % intervals that contain the truth; seeds without alpha
    p(chi2), <.001, out    median probability; seeds in which it is below 1e-3; rejected rows
    said, right, corr.     seeds with any message; with the right cause and place; corrected
    covered                verdict: at least 90 % of the intervals contain the truth
    said                   otherwise: the right cause is named in at least 95 % of the seeds
    refused                no alpha in at least 95 % of the seeds, for any reason
    budget                 undetectable in such data; the error budget states the effect
    SILENT, WRONG          none of these, and no message in most seeds; other messages
    FALSE                  no fault, but a message in at least 1 % of the seeds

The last column is the most frequent first message. With several methods each has its own line, with
the number of seeds solved by reciprocity / with a sound verdict. 'glass' is 'auto' with a sensor
model of the mirror, as in `calibrate --mirror`.

`--grades` prints the grades of the verdict instead (S sound, U usable, D doubtful, R rejected, - no
alpha), the coverage of the 95 % intervals, and the rms ratio of error to stated error. It then
prints the rate of fault-free campaigns that are doubtful or worse, and lists the faults that are
usable or sound in most seeds with a coverage below 90 %, undetectable ones ('blind') separately.
"""

from __future__ import annotations

import argparse
import os
import re
import warnings
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import cache, partial

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from typing import Any

import numpy as np

import truenewton as tn
from studies.accuracy import TWO_SIGMA
from studies.faulty import files, forces, gains, readings
from studies.faulty.bench import Bench, Day, bench_of
from studies.faulty.fault import FAULTS, ORDERS, Fault
from truenewton.errors import TrueNewtonError, TrueNewtonWarning
from truenewton.mirrors.sensor_model import model_sensors

# In the order of the modules that define them.
SECTIONS = [module.__name__ for module in (gains, readings, forces, files)]
ALL = sorted(FAULTS, key=lambda fault: SECTIONS.index(fault.happens.__module__))

LETTERS = {"sound": "S", "usable": "U", "doubtful": "D", "rejected": "R"}
METHODS = ("ml", "svd", "reciprocity", "auto", "glass")
COVERED, SAID, FALSE = 0.90, 0.95, 0.01
IMPROBABLE = 1e-3  # probability of chi2
Array = np.ndarray


@dataclass(frozen=True)
class Message:
    """An effect that a calibration reports: name, place, and whether it was corrected."""

    name: str
    where: str = ""
    corrected: bool = False


@dataclass(frozen=True, eq=False)
class Trial:
    """The result of one seed.

    Attributes
    ----------
    error, stated
        (n,) relative error of alpha and stated error; NaN if excluded or without alpha.
    messages, where
        Reported effects; places that the right message must contain, such as actuators.
    probability, rejected
        Probability of chi2; fraction of rejected rows.
    reciprocal, sound
        Whether reciprocity was used; whether the verdict is 'sound', apart from weights without
        errors.
    grade
        Letter of the verdict; '-' without alpha.
    """

    error: Array
    stated: Array
    messages: tuple[Message, ...]
    where: tuple[str, ...]
    probability: float = float("nan")
    rejected: float = float("nan")
    reciprocal: bool = False
    sound: bool = False
    grade: str = "-"


def day_with_fault(fault: Fault, mirror: str, seed: int, noise: float, cycles: int) -> Day:
    """Return the simulated campaign of a seed, with the fault."""
    day = Day(bench_of(mirror), seed, fault.noise or noise, ORDERS[fault.order](cycles))
    fault.happens(day)
    return day


@cache
def motion_of(bench: Bench) -> Array:
    """Return the sensor model of a bench."""
    return model_sensors(bench.glass)


def trial(day: Day, method: str = "ml") -> Trial:
    """Calibrate the campaign of a day and compare alpha with the truth."""
    how: dict[str, Any] = {"method": method}
    if method == "glass":
        how = {"method": "auto", "motion": motion_of(day.bench)}
    try:
        answer = tn.calibrate(day.campaign(), **how)
    except TrueNewtonError as error:
        no_alpha = np.full(day.n, np.nan)
        refusal = Message(f"refused, {type(error).__name__}: {error.fault}")
        return Trial(no_alpha, no_alpha, (refusal,), day.where)
    judged = np.where(day.judged, 1.0, np.nan)
    return Trial(
        error=judged * (answer.alpha / day.truth - 1),
        stated=judged * answer.error / day.truth,
        messages=tuple(Message(e.name, e.where, e.corrected) for e in answer.effects),
        where=day.where,
        probability=answer.goodness.probability if answer.goodness else np.nan,
        rejected=answer.rejected / (answer.rejected + answer.shapes_used),
        reciprocal=answer.method == "reciprocity",
        sound=all(each.code is tn.Code.WEIGHTS_WITHOUT_ERRORS for each in answer.verdict.faults),
        grade=LETTERS[str(answer.verdict.level)],
    )


def mean(values: Array) -> float:
    """Return the mean of finite values, NaN if there are none."""
    finite = values[np.isfinite(values)]
    return float(finite.mean()) if finite.size else float("nan")


def rms(values: Array) -> float:
    """Return the root mean square of finite values."""
    return float(np.sqrt(mean(values**2)))


def commonest(messages: Sequence[tuple[Message, ...]]) -> str:
    """Return the most frequent first message, without its numbers."""
    first = Counter(re.sub(r"\d[\d.e+-]*", "#", some[0].name) for some in messages if some)
    if not first:
        return ""
    what, count = first.most_common(1)[0]
    return f"{count}x {what}"


def is_right(message: Message, fault: Fault, where: tuple[str, ...]) -> bool:
    """Return whether a message names the cause and the affected places."""
    text = f"{message.name} {message.where}"
    places = all(re.search(rf"\b{re.escape(place)}\b", text) for place in where)
    return bool(fault.cause and re.search(fault.cause, text, re.IGNORECASE) and places)


def judgement(fault: Fault, covers: float, answered: float, said: float, right: float) -> str:
    """Return the verdict, as listed at the head of this module, from fractions."""
    if not fault.cause and not fault.blind and said >= FALSE:
        return "FALSE"
    if covers >= COVERED and answered >= SAID:
        return "covered"
    if right >= SAID:
        return "said"
    if answered <= 1 - SAID:
        return "refused"
    if fault.blind:
        return "budget"
    return "WRONG" if said >= 0.5 else "SILENT"


def summary(fault: Fault, trials: Sequence[Trial]) -> dict[str, float | str]:
    """Return the figures of a fault, one for each of `COLUMNS`."""
    error, stated = (np.array([getattr(t, name) for t in trials]) for name in ("error", "stated"))
    answered = np.isfinite(error).any(axis=1)
    probability, rejected = (
        np.array([getattr(t, name) for t in trials])[answered]
        for name in ("probability", "rejected")
    )
    covers = mean((np.abs(error) < TWO_SIGMA * stated)[np.isfinite(error)])
    right = [[each for each in t.messages if is_right(each, fault, t.where)] for t in trials]
    said, rightly = sum(bool(t.messages) for t in trials), sum(map(bool, right))
    fractions = (answered.mean(), said / len(trials), rightly / len(trials))
    return {
        "error": significant(100 * rms(error)),
        "scale": significant(100 * rms(np.array([mean(e) for e in error[answered]]))),
        "stated": significant(100 * rms(stated)),
        "covers": 100 * covers,
        "none": int((~answered).sum()),
        "p(chi2)": np.median(probability) if answered.any() else np.nan,
        "<.001": int((probability < IMPROBABLE).sum()),
        "out": 100 * mean(rejected),
        "said": said,
        "right": rightly,
        "corr.": sum(any(each.corrected for each in found) for found in right),
        "verdict": judgement(fault, covers, *fractions),
        "words": commonest([t.messages for t in trials]),
        "sound": sum(t.sound for t in trials),
        "reciprocal": sum(t.reciprocal for t in trials),
    }


# Heading, unit and format.
COLUMNS = (
    ("error", "%", ">9s"), ("scale", "%", ">9s"), ("stated", "%", ">9s"), ("covers", "%", "8.1f"),
    ("none", "seeds", "6d"), ("p(chi2)", "median", "9.2g"), ("<.001", "seeds", "6d"),
    ("out", "%", "6.1f"), ("said", "seeds", "6d"), ("right", "seeds", "6d"),
    ("corr.", "seeds", "6d"),
)  # fmt: skip


def significant(percentage: float) -> str:
    """Return a percentage with at least two significant digits."""
    digits = 4 if percentage < 0.1 else 3 if percentage < 10 else 1
    return f"{percentage:.{digits}f}"


def print_heads() -> None:
    """Print the headings and units of the table."""
    widths = [int(re.findall(r"\d+", how)[0]) for *_, how in COLUMNS]
    for k, first in enumerate(("noise", "mN")):
        cells = (f"{column[k]:>{width}s}" for column, width in zip(COLUMNS, widths, strict=True))
        print(f"{'':52s}{first:>7s}{''.join(cells)}")


def print_line(name: str, noise: float, figures: dict[str, float | str]) -> None:
    """Print the figures of a fault."""
    cells = "".join(f"{figures[head]:{how}}" for head, _, how in COLUMNS)
    line = f"{name:52s}{1e3 * noise:7.3g}{cells}  {figures['verdict']:8s}{figures['words']:.70s}"
    print(line.rstrip(), flush=True)


def graded(seed: int, name: str, mirror: str, noise: float, cycles: int) -> tuple[str, Array]:
    """Return the grade of a campaign, and the errors of alpha relative to the stated errors."""
    warnings.simplefilter("ignore", TrueNewtonWarning)
    fault = next(each for each in FAULTS if each.name == name)
    found = trial(day_with_fault(fault, mirror, seed, noise, cycles))
    ratio = found.error / found.stated
    return found.grade, ratio[np.isfinite(ratio)]


def print_grades(
    chosen: Sequence[Fault], seeds: range, noises: Sequence[float], mirror: str, cycles: int
) -> None:
    """Print the grades of faults, and the coverage of their errors."""
    false, sound, wrong, blind = 0, 0, list[str](), list[str]()
    print(f"{'':52s} noise/mN  grades      covered  error/stated")
    with ProcessPoolExecutor() as pool:
        for fault in chosen:
            for noise in noises if fault.noise is None else [fault.noise]:
                one = partial(graded, name=fault.name, mirror=mirror, noise=noise, cycles=cycles)
                rows = list(pool.map(one, seeds))
                grades = Counter(grade for grade, _ in rows)
                some = [ratio for _, ratio in rows if ratio.size]
                covered, size = np.nan, np.nan
                if some:
                    covered = np.median([np.mean(np.abs(ratio) < TWO_SIGMA) for ratio in some])
                    size = np.median([rms(ratio) for ratio in some])
                shown = " ".join(f"{g}{n}" for g, n in grades.most_common())
                line = (
                    f"{fault.name:52s} {1e3 * noise:8.3g}  {shown:12s}{covered:7.0%}  {size:8.2f}"
                )
                print(line, flush=True)
                good = grades["U"] + grades["S"]
                if not fault.cause and not fault.blind:
                    sound += len(rows)
                    false += len(rows) - good
                elif good > len(rows) / 2 and covered < COVERED:
                    (blind if fault.blind else wrong).append(line)
    print(f"doubtful or worse though nothing is wrong: {false} of {sound}")
    print("usable or sound, and errors do not hold:", *wrong or ["none"], sep="\n  ")
    print("the same, of what no such data can show:", *blind or ["none"], sep="\n  ")


def main() -> None:
    """Run from the command line."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("--seeds", type=int, default=24)
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--noise", type=float, nargs="+", default=[1e-3, 5e-5], help="[N]")
    parser.add_argument("--only", nargs="+", metavar="NAME", help="faults whose name begins so")
    parser.add_argument("--mirror", choices=("p45", "336"), default="p45")
    parser.add_argument("--cycles", type=int, default=4, help="under each load")
    parser.add_argument("--method", nargs="+", default=["ml"], choices=METHODS)
    parser.add_argument("--grades", action="store_true", help="of the verdict")
    options = parser.parse_args()
    warnings.simplefilter("ignore", TrueNewtonWarning)  # messages are counted instead
    chosen = [f for f in ALL if not options.only or f.name.startswith(tuple(options.only))]
    seeds = range(options.first, options.first + options.seeds)
    if options.grades:
        print_grades(chosen, seeds, options.noise, options.mirror, options.cycles)
        return
    print(f"{options.mirror}, {options.cycles} cycles a load, {options.seeds} seeds")
    print_heads()
    verdicts: dict[str, Counter[str]] = {method: Counter() for method in options.method}
    for fault in chosen:
        for noise in options.noise if fault.noise is None else [fault.noise]:
            trials: dict[str, list[Trial]] = {method: [] for method in options.method}
            for seed in seeds:
                day = day_with_fault(fault, options.mirror, seed, noise, options.cycles)
                for method, found in trials.items():
                    found.append(trial(day, method))
            for method, found in trials.items():
                figures = summary(fault, found)
                name = fault.name
                if len(trials) > 1:
                    name = f"{name[:39]} {method} {figures['reciprocal']}/{figures['sound']}"
                print_line(name, noise, figures)
                verdicts[method][str(figures["verdict"])] += 1
    for method, count in verdicts.items():
        sums = ", ".join(f"{number} {what}" for what, number in count.most_common())
        print(sums if len(verdicts) == 1 else f"{method}: {sums}")


if __name__ == "__main__":
    main()
