"""Do the stated errors hold in every grade of the verdict, and is a grade false on sound data?

    python -m studies.grades [--seeds 4] [--first 0] [--noise 1e-3 5e-5] [--only NAME ...]
    python -m studies.grades --only clean --seeds 50        how often 'doubtful' is false

Campaigns of P45 with each fault of `faulty`. A line for each fault and noise: the grades (S sound,
U usable, D doubtful, R rejected, - no alpha), the share of the 95 % intervals that contain the
truth, and the rms error in units of the stated one. At the end: of the faults that are usable or
sound in most seeds, those whose errors do not hold (fewer than 90 % covered); of the campaigns in
which nothing is wrong, the share that is doubtful or worse. Faults that no such data can show
('blind') are listed apart.
"""

from __future__ import annotations

import argparse
import os
import warnings
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from functools import partial

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

import truenewton as tn
from studies.faults import ALL, COVERED, TWO_SIGMA, happening
from studies.faulty.fault import FAULTS
from truenewton.errors import TrueNewtonError

LETTERS = {"sound": "S", "usable": "U", "doubtful": "D", "rejected": "R", "no alpha": "-"}


def graded(seed: int, name: str, noise: float) -> tuple[str, float, float]:
    """Return the grade of a campaign, the share of intervals that cover, and rms error / stated."""
    fault = next(each for each in FAULTS if each.name == name)
    day = happening(fault, "p45", seed, noise, 4)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            found = tn.calibrate(day.campaign())
        except TrueNewtonError:
            return LETTERS["no alpha"], np.nan, np.nan
    ratio = ((found.alpha - day.truth) / found.error)[day.judged & np.isfinite(found.alpha)]
    covered = float(np.mean(np.abs(ratio) < TWO_SIGMA))
    return LETTERS[str(found.verdict.level)], covered, float(np.sqrt(np.mean(ratio**2)))


def main() -> None:
    """Run from the command line."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("--seeds", type=int, default=4)
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--noise", type=float, nargs="+", default=[1e-3, 5e-5], help="[N]")
    parser.add_argument("--only", nargs="+", metavar="NAME", help="faults whose name begins so")
    options = parser.parse_args()
    chosen = [f for f in ALL if not options.only or f.name.startswith(tuple(options.only))]
    seeds = range(options.first, options.first + options.seeds)
    false, sound, wrong, blind = 0, 0, [], []
    print(f"{'':52s} noise/mN  grades      covered  error/stated")
    with ProcessPoolExecutor() as pool:
        for fault in chosen:
            for noise in options.noise if fault.noise is None else [fault.noise]:
                rows = list(pool.map(partial(graded, name=fault.name, noise=noise), seeds))
                grades = Counter(grade for grade, *_ in rows)
                covered, size = (
                    float(np.nanmedian([row[k] for row in rows]))
                    if len(rows) > grades["-"]
                    else np.nan
                    for k in (1, 2)
                )
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


if __name__ == "__main__":
    main()
