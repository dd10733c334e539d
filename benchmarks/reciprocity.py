"""Reciprocity on simulated mirrors and on a measured one: scatter against the bound, coverage.

    python benchmarks/reciprocity.py [--seeds 30] [--bounds 5] [--noise 1e-3] [--loop]
    python benchmarks/reciprocity.py --gate [--seeds 12]
    python benchmarks/reciprocity.py --large
    TRUENEWTON_REAL_DATA=FOLDER python benchmarks/reciprocity.py --measured

The first prints, for campaigns of P45 (4 cycles under each of two loads), the relative error of
alpha with sensor gains known, with a spread of 0.4 %, and free, in terms of the Cramer-Rao bound
with all of K unknown (`joint_bound`), and how many of the 95 % intervals hold the truth; beside it
`ml`, and reciprocity without a model of the glass, as a user without one has it. --loop holds the
shapes in closed loop. The second prints how often the gate accepts stiffnesses of P45 with faults,
and whether it should. The third prints error and coverage of stiffnesses of LBT672, 672 actuators
with offsets of 0.5 mm. The last prints what is left out of balance on held-out modes of a measured
LBT672, FOLDER holding lbt672/lbt672-feedforward.fits.
"""

import argparse
import os
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from joint_bound import BruteForce

import truenewton as tn
from truenewton.bench.simulated.static import (
    SENSOR_NOISE,
    loop_of,
    rest_displacement,
    run_cycles,
    static_bench,
)
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
from truenewton.mirrors.known import lbt672, p45
from truenewton.mirrors.shell.held_glass import held_glass
from truenewton.mirrors.shell.puck_motion import puck_motion
from truenewton.records.campaign import Campaign
from truenewton.records.stiffness_matrix import StiffnessMatrix

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


def matrix_of(random, glass, layout, *, gain=0.004, offset=0.0, asymmetry=0.0, dead=0, noise=1e-3):
    """Return a stiffness as measured in 8 readings with noise [N], and log alpha."""
    n = layout.n
    alpha = random.normal(0.0, 0.05, n)
    values = Values(alpha, random.normal(0.0, gain, n), offset * random.normal(0, 1, (2, n)))
    motion = sight(places_of(layout), values, slopes=bool(offset)).motion
    stiffness = 0.5 * (glass.stiffness + glass.stiffness.T)
    stiffness = stiffness * (1.0 + asymmetry * random.standard_normal((n, n)))
    stiffness = stiffness @ (motion * values.gain) / values.alpha[:, None]
    _, size, right = np.linalg.svd(stiffness)
    stroke = np.minimum(1e-6, 0.4 / np.maximum(size, 1.0)) * np.sqrt(8)
    stiffness = stiffness + (noise * random.standard_normal((n, n)) / stroke) @ right
    if dead:
        some = random.choice(n, dead, replace=False)
        stiffness[:, some] = stiffness[:, some] @ random.standard_normal((dead, dead))
    return stiffness, alpha


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


def measured():
    """Print what is left of a measured LBT672."""
    matrix = tn.read(Path(os.environ["TRUENEWTON_REAL_DATA"]) / "lbt672/lbt672-feedforward.fits")
    begin, cpu = time.perf_counter(), time.process_time()
    modes = modes_of(matrix)
    joint = modes.fit(USUAL)
    print(
        f"{modes.places.n} actuators, {len(joint.covariance)} unknowns: {joint.steps} steps in"
        f" {time.perf_counter() - begin:.0f} s, {time.process_time() - cpu:.0f} s of processor"
    )
    found = examined(modes)
    for line in found.imbalances:
        print(f"    imbalance, {line.modes:<32}{line.before:.4f} -> {line.after:.4f}")
    work = found.joint.point.left.work
    asymmetry = np.linalg.norm(work - work.T) / np.linalg.norm(work + work.T)
    evidence = found.evidence
    print(f"    asymmetry {tn_asymmetry(matrix):.4f} -> {asymmetry:.4f}")
    print(f"    halves differ by {found.split_half:.4f} rms")
    print(f"    held out {evidence.held_out:.4f}, by balance alone {evidence.by_balance:.4f}")
    print(f"    balance alone against reciprocity alone: chi2/DOF {evidence.apart:.2f}")
    print(
        f"    gains spread by {evidence.gain_spread:.4f}, offsets by"
        f" {1e3 * evidence.offset_spread:.2f} mm"
    )
    print(f"    refused because: {[fault for fault, _ in refusals(evidence)] or 'accepted'}")


def large():
    """Print error and coverage of stiffnesses of LBT672 at three noises."""
    mirror, date = lbt672(), next(run_cycles(static_bench(p45(), 0), 1)).date
    glass = held_glass(mirror)
    for noise in (1e-3, 3e-4, 1e-4):
        random = np.random.default_rng([0, 7])
        stiffness, alpha = matrix_of(random, glass, mirror.layout, offset=5e-4, noise=noise)
        modes = modes_of(StiffnessMatrix("LBT672", date, mirror.layout, stiffness))
        joint, one, other = (
            each.fit(USUAL)
            for each in (modes, modes.every(slice(0, None, 2)), modes.every(slice(1, None, 2)))
        )
        error = joint.values.log_alpha - alpha
        error -= error.mean()
        stated = np.sqrt(np.diag(joint.covariance_of(Kind.ALPHA)))
        formal, rms = np.sqrt(np.mean(stated**2)), np.std(error)
        halves = np.std(one.values.log_alpha - other.values.log_alpha)
        inside = [
            np.mean(np.abs(error) < 1.96 * size * stated) for size in (1.0, max(1, halves / formal))
        ]
        print(
            f"{1e3 * noise:.1f} mN: rms {rms:.4f}, stated {formal:.4f}, halves differ by"
            f" {halves:.4f}; coverage {inside[0]:.3f}, by halves {inside[1]:.3f}",
            flush=True,
        )


def tn_asymmetry(matrix):
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
    parser.add_argument("--large", action="store_true")
    parser.add_argument("--measured", action="store_true")
    options = parser.parse_args()
    if options.measured:
        measured()
    elif options.large:
        large()
    elif options.gate:
        gate(options.seeds)
    else:
        campaigns(options.seeds, options.bounds, options.noise, options.loop)


if __name__ == "__main__":
    main()
