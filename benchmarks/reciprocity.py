"""Reciprocity on simulated mirrors and on a measured one: scatter against the bound, coverage.

    python benchmarks/reciprocity.py [--seeds 30] [--bounds 5] [--noise 1e-3] [--loop]
    python benchmarks/reciprocity.py --gate [--seeds 12]
    python benchmarks/reciprocity.py --foreign [--seeds 3]
    python benchmarks/reciprocity.py --large
    python benchmarks/reciprocity.py --time 1170
    TRUENEWTON_REAL_DATA=FOLDER python benchmarks/reciprocity.py --measured

The first prints, for campaigns of P45 (4 cycles under each of two loads), the relative error of
alpha with sensor gains known, with a spread of 0.4 %, and free, in terms of the Cramer-Rao bound
with all of K unknown (`joint_bound`), and how many of the 95 % intervals hold the truth; beside it
`ml`, and reciprocity without a model of the glass, as a user without one has it. --loop holds the
shapes in closed loop. The second prints how often the gate accepts stiffnesses of P45 with faults,
and whether it should; --foreign what `ml`, `auto` and `reciprocity` make of matrices of many other
kinds. --large prints error, bound and coverage of stiffnesses of 650 actuators of LBT672, sensors
0.5 mm off; --time what time and memory `auto` takes. The last prints what is left out of balance on
held-out modes of a measured LBT672, FOLDER holding lbt672/lbt672-feedforward.fits.
"""

import argparse
import os
import resource
import time
import warnings
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
from joint_bound import BruteForce
from simulated_matrices import bound as bound_of_matrix
from simulated_matrices import by_glass, by_plate, drawn, foreign
from simulated_matrices import measured as with_noise

import truenewton as tn
from truenewton.bench.simulated.static import (
    SENSOR_NOISE,
    loop_of,
    rest_displacement,
    run_cycles,
    static_bench,
)
from truenewton.calibration.methods import calibrate
from truenewton.errors import TrueNewtonError
from truenewton.estimation import cycles_ml
from truenewton.estimation.noise import reading_noise
from truenewton.estimation.reciprocity import cycles
from truenewton.estimation.reciprocity.gate import refusals
from truenewton.estimation.reciprocity.iteration import fit
from truenewton.estimation.reciprocity.matrix import examined, modes_of
from truenewton.estimation.reciprocity.regression import regressed
from truenewton.estimation.reciprocity.sight import places_of, sight
from truenewton.estimation.reciprocity.unknowns import USUAL, Asked, Kind, Values, at_nominal
from truenewton.estimation.sifted import sift
from truenewton.mirrors.known import lbt672, p45, ring
from truenewton.mirrors.shell.held_glass import held_glass
from truenewton.mirrors.shell.puck_motion import puck_motion
from truenewton.records.campaign import Campaign
from truenewton.records.stiffness_matrix import StiffnessMatrix
from truenewton.statics.layout import layout as actuators_at

GAINS = {"gains known": Asked(), "gains +- 0.4 %": Asked(0.004), "gains free": Asked(np.inf)}


def about_mean(covariance):
    """Return the covariance of differences from the mean."""
    mean = np.eye(len(covariance)) - 1.0 / len(covariance)
    return mean @ covariance @ mean


def bound(bench, places, square, noise, asked):
    """Return the bound of the rms error of log alpha about its mean."""
    alpha, gain = bench.truth.alpha, bench.truth.sensor_gain
    values = Values(np.log(alpha), np.log(gain), np.zeros((2, places.n)))
    stiffness = bench.glass.stiffness @ np.linalg.inv(places.motion)
    commanded = (0.5 * (stiffness + stiffness.T)) @ (places.motion * gain) / alpha[:, None]
    rows = noise**2 * np.eye(places.n) + SENSOR_NOISE**2 * commanded @ commanded.T
    brute = BruteForce(places, commanded, np.linalg.inv(np.linalg.cholesky(rows)),
                       np.linalg.cholesky(square), slopes=False)  # fmt: skip
    steps = np.full(places.n * len(asked.kinds), 1e-4)
    known = brute.information(values, list(asked.kinds), steps)
    known += np.diag(asked.information(places.n))
    for k in range(0, len(known), places.n):  # free scales
        if k == 0 or np.isinf(asked.gain_spread):
            some = slice(k, k + places.n)
            known[some, some] += np.trace(known[some, some]) / places.n**2
    inverse = about_mean(np.linalg.inv(known)[: places.n, : places.n])
    return np.sqrt(np.trace(inverse) / places.n)


class Line:
    """What came of one way over the seeds."""

    def __init__(self):
        self.errors, self.stated, self.inside, self.bounds, self.chi2 = [], [], [], [], []

    def add(self, error, covariance, chi2):
        stated = np.sqrt(np.diag(about_mean(covariance)))
        error = error - error.mean()
        self.errors.append(np.mean(error**2))
        self.stated.append(np.mean(stated**2))
        self.inside.append(np.mean(np.abs(error) < 1.96 * stated))
        self.chi2.append(chi2)

    def __str__(self):
        rms, stated = np.sqrt([np.mean(self.errors), np.mean(self.stated)])
        ratio = ""
        if self.bounds:
            ratio = f"{np.sqrt(np.mean(self.errors) / np.mean(self.bounds)):6.3f}"
        chi2 = np.round(np.mean(self.chi2, axis=0), 3)
        return f"{rms:.2e}   {stated:.2e}   {ratio:>6}   {np.mean(self.inside):.3f}      {chi2}"


def campaigns(seeds, bounds, noise, loop):
    """Print scatter, bound and coverage over campaigns."""
    mirror = p45()
    exact = places_of(mirror.layout, puck_motion(held_glass(mirror)))
    lines, n = {}, mirror.layout.n
    for seed in range(seeds):
        bench = static_bench(mirror, seed, force_noise=noise)
        campaign = Campaign(tuple(run_cycles(bench, 4, loop_of(bench) if loop else None)))
        alpha = bench.truth.alpha
        if loop:
            alpha = alpha * (1 + bench.coils.coil_gradient * rest_displacement(bench).mean(axis=0))
        sifted = sift(campaign)
        for name, estimate in (
            ("ml", cycles_ml.find(sifted)),
            ("reciprocity, glass known", cycles.find(sifted, exact.motion)),
            ("reciprocity", cycles.find(sifted)),
        ):
            found = estimate.values[:n]
            relative = estimate.reading_covariance[:n, :n] / np.outer(found, found)
            lines.setdefault(name, Line()).add(
                np.log(found / alpha), relative, [estimate.goodness.reduced]
            )
        noises = reading_noise(campaign, sifted.moments)
        gradients = {"bias_gradient": mirror.bias_gradient, "coil_gradient": mirror.coil_gradient}
        stiffness = regressed(sifted.moments, noises.variance, **gradients)
        for name, asked in GAINS.items():
            start = replace(at_nominal(n), log_alpha=np.log(found) - np.mean(np.log(found)))
            if not asked.gain_spread:
                start = replace(start, log_gain=np.log(bench.truth.sensor_gain))
            made = fit(exact, asked, stiffness.states, start=start)
            line = lines.setdefault(name, Line())
            covariance = made.covariance_of(Kind.ALPHA)
            line.add(made.values.log_alpha - np.log(alpha), covariance, made.reduced)
            if seed < bounds and not loop:
                line.bounds.append(bound(bench, exact, stiffness.square, noise, asked) ** 2)
    print(f"{'':<26}rms        stated     /bound   coverage   chi2/DOF")
    for name, line in lines.items():
        print(f"{name:<26}{line}")


def matrix_of(random, glass, layout, *, gain=0.004, offset=0.0, asymmetry=0.0, dead=0):
    """Return a stiffness as measured in 8 readings with 1 mN of noise, and log alpha."""
    n = layout.n
    values = drawn(random, n, gain, offset)
    stiffness = 0.5 * (glass.stiffness + glass.stiffness.T)
    stiffness = stiffness * (1.0 + asymmetry * random.standard_normal((n, n)))
    motion = sight(places_of(layout), values, slopes=bool(offset)).motion
    stiffness = stiffness @ (motion * values.gain) / values.alpha[:, None]
    stiffness = with_noise(random, stiffness, values).stiffness
    if dead:
        some = random.choice(n, dead, replace=False)
        stiffness[:, some] = stiffness[:, some] @ random.standard_normal((dead, dead))
    return stiffness, values.log_alpha


FAULTS = {
    "clean": {},
    "offsets 0.5 mm": {"offset": 5e-4},
    "offsets 1 mm": {"offset": 1e-3},
    "offsets 3 mm": {"offset": 3e-3},
    "asymmetry 1e-3": {"asymmetry": 1e-3},
    "asymmetry 1e-2": {"asymmetry": 1e-2},
    "gains 2 %": {"gain": 0.02},
    "10 sensors dead": {"dead": 10},
}


def gate(seeds):
    """Print what the gate makes of stiffnesses with faults; good is what beats balance alone."""
    mirror = p45()
    glass, date = held_glass(mirror), next(run_cycles(static_bench(mirror, 0), 1)).date
    print(f"{'':<18}joint      balance    apart   good  accepted  falsely  rejected falsely")
    for name, options in FAULTS.items():
        rows = []
        for seed in range(seeds):
            random = np.random.default_rng([seed, 7])
            stiffness, alpha = matrix_of(random, glass, mirror.layout, **options)
            modes = modes_of(StiffnessMatrix("P45", date, mirror.layout, stiffness))
            truth = alpha - alpha.mean()
            alone = np.nan
            try:
                alone = np.std(modes.fit(Asked(), reciprocity=False).values.log_alpha - truth)
                found = examined(modes, USUAL)
            except TrueNewtonError:
                rows.append((np.nan, alone, np.nan, False))
                continue
            joint = np.std(found.joint.values.log_alpha - truth)
            refused = bool([*refusals(found.evidence)])
            rows.append((joint, alone, found.evidence.apart, not refused))
        joint, alone, apart, accepted = np.array(rows).T
        good, accepted = (joint < alone) | (np.isfinite(joint) & np.isnan(alone)), accepted > 0
        print(
            f"{name:<18}{np.nanmedian(joint):.2e}   {np.nanmedian(alone):.2e}   "
            f"{np.nanmedian(apart):5.1f}   {good.sum():4d}  {accepted.sum():8d}  "
            f"{(accepted & ~good).sum():7d}  {(good & ~accepted).sum():7d}"
        )


OF_THE_GATE = ("reciproc", "balance worse", "off their magnets")


def fate(matrix, method, truth):
    """Return what comes of a calibration: its method, or why there is none; error, coverage."""
    begin = time.process_time()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            made = calibrate(matrix, method)
        except TrueNewtonError as error:
            return "refused", f"{error.fault}", np.nan, np.nan, np.nan, time.process_time() - begin
    seconds = time.process_time() - begin
    error, stated = np.log(made.alpha) - truth, made.reading_error / made.alpha
    some = np.isfinite(error) & (stated > 0.0)
    error = error - np.mean(error[some])
    said = [fault for fault, _ in made.verdict.faults]
    return (
        f"{made.method}, {made.verdict.level}",
        next((f for f in said if any(word in f for word in OF_THE_GATE)), "".join(said[:1])),
        np.sqrt(np.mean(error[some] ** 2)),
        np.sqrt(np.mean(stated[some] ** 2)),
        np.mean(np.abs(error[some]) < 1.96 * stated[some]),
        seconds,
    )  # fmt: skip


def foreign_matrices(seeds):
    """Print what becomes of matrices that were not made for us."""
    date = next(run_cycles(static_bench(p45(), 0), 1)).date
    print("matrix | method | outcome | rms | stated | coverage | seconds | what is said")
    for name, make in foreign(date):
        for method in ("ml", "auto", "reciprocity"):
            rows = [fate(matrix, method, truth) for matrix, truth in map(make, range(seeds))]
            outcomes = Counter(row[0] for row in rows)
            ends = ", ".join(f"{count} {what}" for what, count in outcomes.most_common())
            numbers = np.array([row[2:5] for row in rows])
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # of means of nothing
                rms, stated, inside = np.nanmean(numbers, axis=0)
            reason = "" if method == "ml" else rows[0][1]
            print(
                f"{name} | {method} | {ends} | {rms:.1e} | {stated:.1e} | {inside:.2f}"
                f" | {max(row[5] for row in rows):.1f} | {reason}",
                flush=True,
            )


def without_smooth(layout, values, degree=6):
    """Return (n,) values less the Zernike patterns of a degree and below."""
    x, y = (at / np.abs(at).max() for at in (layout.x[layout.enabled], layout.y[layout.enabled]))
    smooth = np.stack([x**i * y**j for i in range(degree + 1) for j in range(degree + 1 - i)], 1)
    basis = np.linalg.qr(smooth)[0]
    return values - basis @ (basis.T @ values)


def real():
    """Print what is left of a measured LBT672."""
    matrix = tn.read(Path(os.environ["TRUENEWTON_REAL_DATA"]) / "lbt672/lbt672-feedforward.fits")
    cpu, layout = time.process_time(), matrix.layout
    modes = modes_of(matrix)
    found = examined(modes)
    n, unknowns, steps = modes.places.n, len(found.joint.covariance), found.joint.steps
    print(
        f"{n} actuators, {unknowns} unknowns, {steps} steps; with halves and each alone"
        f" {time.process_time() - cpu:.0f} s of processor"
    )
    for line in found.imbalances:
        print(f"    imbalance, {line.modes:<32}{line.before:.4f} -> {line.after:.4f}")
    work = found.joint.point.left.work
    asymmetry = np.linalg.norm(work - work.T) / np.linalg.norm(work + work.T)
    evidence = found.evidence
    print(f"    asymmetry {asymmetry_of(matrix):.4f} -> {asymmetry:.4f}")
    one, other = found.halves
    print(
        f"    halves differ by {np.std(one - other):.4f} rms, without degree 6 and below by"
        f" {np.std(without_smooth(layout, one - other)):.4f}"
    )
    formal = np.sqrt(np.mean(np.diag(found.joint.covariance_of(Kind.ALPHA))))
    print(
        f"    formal error {formal:.4f}, halves differ by {np.sqrt(found.of_halves):.2f} times what"
        f" they state; E_STAT {formal * np.sqrt(found.excess):.4f}"
    )
    print(f"    held out {evidence.held_out:.4f}, by balance alone {evidence.by_balance:.4f}")
    alone, apart = found.alone, [without_smooth(layout, each) for each in found.alone]
    print(
        f"    balance alone against reciprocity alone: r {np.corrcoef(*alone)[0, 1]:.3f}, without"
        f" degree 6 and below {np.corrcoef(*apart)[0, 1]:.3f}, chi2/DOF {evidence.apart:.2f}"
    )
    print(
        f"    gains spread by {evidence.gain_spread:.4f}, offsets by"
        f" {1e3 * evidence.offset_spread:.2f} mm"
    )
    print(f"    refused because: {[fault for fault, _ in refusals(evidence)] or 'accepted'}")


def large():
    """Print error, bound and coverage of stiffnesses of LBT672 with 650 of its actuators."""
    whole, date = lbt672(), next(run_cycles(static_bench(p45(), 0), 1)).date
    some = np.sort(np.random.default_rng(1).choice(whole.layout.n, 650, replace=False))
    at = actuators_at(*(getattr(whole.layout, name)[some] for name in ("x", "y")),
                      nz=whole.layout.nz[some])  # fmt: skip
    glass = held_glass(replace(whole, layout=at))
    cases = (
        ("plate, 1 mN, 1 um at most", None, 1e-3, 1e-6),
        ("plate, 0.3 mN, 1 um at most", None, 3e-4, 1e-6),
        ("shell, annuli, 1 mN at 0.4 N", "without", 1e-3, np.inf),
        ("the same, glass known", "with", 1e-3, np.inf),
    )
    print(f"{'':<32}rms      bound    /bound  formal  coverage  excess  coverage with it")
    for name, shell, noise, stroke in cases:
        random = np.random.default_rng([0, 7])
        values = drawn(random, at.n, offset=5e-4)
        exact = by_glass(glass, values) if shell else by_plate(at, glass.stiffness, values)
        made = with_noise(random, exact, values, noise, stroke)
        motion = puck_motion(glass) if shell == "with" else None
        matrix = StiffnessMatrix("LBT672", date, at, made.stiffness)
        found = examined(modes_of(matrix, motion))
        least = bound_of_matrix(made, at, USUAL, motion)
        error = found.joint.values.log_alpha - values.log_alpha
        error -= error.mean()
        stated = np.sqrt(np.diag(found.joint.covariance_of(Kind.ALPHA)))
        inside, grown = (
            np.mean(np.abs(error) < 1.96 * size * stated) for size in (1.0, np.sqrt(found.excess))
        )
        print(
            f"{name:<32}{np.std(error):.5f}  {least:.5f}  {np.std(error) / least:.3f}  "
            f" {np.sqrt(np.mean(stated**2)):.5f}  {inside:.3f}     {found.excess:.2f}   {grown:.3f}"
            f"   halves {np.std(found.halves[0] - found.halves[1]):.5f},"
            f" {found.of_halves:.2f} apart {found.evidence.apart:.2f}",
            flush=True,
        )


def timed(actuators):
    """Print time and memory of `auto` on a stiffness of so many actuators."""
    mirror, date = ring(actuators), next(run_cycles(static_bench(p45(), 0), 1)).date
    random, layout = np.random.default_rng(5), mirror.layout
    values = drawn(random, layout.n, offset=5e-4)
    exact = by_plate(layout, held_glass(mirror).stiffness, values)
    matrix = StiffnessMatrix("RING", date, layout, with_noise(random, exact, values).stiffness)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    begin, cpu = time.perf_counter(), time.process_time()
    made = calibrate(matrix, "auto")
    after = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    print(
        f"{layout.n} actuators, {4 * layout.n} unknowns: {made.method} in"
        f" {time.perf_counter() - begin:.0f} s, {time.process_time() - cpu:.0f} s of processor;"
        f" at most {after / 1e6:.2f} GB, {before / 1e6:.2f} GB before; rms error of alpha"
        f" {np.std(np.log(made.alpha) - values.log_alpha):.5f}"
    )


def asymmetry_of(matrix):
    """Return |K - K'| / |K + K'|."""
    k = matrix.used_stiffness
    return np.linalg.norm(k - k.T) / np.linalg.norm(k + k.T)


def main():
    """Print what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("--seeds", type=int, default=30)
    parser.add_argument("--bounds", type=int, default=5, help="seeds whose bound is computed")
    parser.add_argument("--noise", type=float, default=1e-3, help="of a force reading [N]")
    parser.add_argument("--loop", action="store_true", help="in closed loop")
    parser.add_argument("--gate", action="store_true")
    parser.add_argument("--foreign", action="store_true")
    parser.add_argument("--time", type=int, default=0, metavar="ACTUATORS")
    parser.add_argument("--large", action="store_true")
    parser.add_argument("--measured", action="store_true")
    options = parser.parse_args()
    if options.measured:
        real()
    elif options.time:
        timed(options.time)
    elif options.foreign:
        foreign_matrices(options.seeds)
    elif options.large:
        large()
    elif options.gate:
        gate(options.seeds)
    else:
        campaigns(options.seeds, options.bounds, options.noise, options.loop)


if __name__ == "__main__":
    main()
