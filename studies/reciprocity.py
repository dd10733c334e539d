"""Reciprocity on simulated mirrors and on a measured one: scatter against the bound, coverage.

    python -m studies.reciprocity [--seeds 30] [--bounds 5] [--noise 1e-3] [--loop]
    python -m studies.reciprocity --gate [--seeds 12]
    python -m studies.reciprocity --foreign [--seeds 3]
    python -m studies.reciprocity --large
    TRUENEWTON_REAL_DATA=FOLDER python -m studies.reciprocity --measured

The first command simulates campaigns of P45 (4 cycles under each of two loads). Sensor gains are
known, have a prior of 0.4 %, or are free. It prints the relative error of alpha; its ratio to the
Cramer-Rao bound with K unknown (`joint_bound`); the coverage of 95 % intervals; chi2 of the errors
with their covariance C; and the effective number of independent patterns of an error, (tr C)^2 / tr
C^2, which limits the precision of the coverage. `ml` and reciprocity without a model of the glass
are printed for comparison. --loop simulates the closed loop. --gate prints how often `auto` accepts
stiffnesses of P45 with faults, and whether it should. --foreign prints the results of `ml`, `auto`
and `reciprocity` for matrices of other kinds. --large prints error, bound and coverage for 650
actuators of LBT672, with sensors 0.5 mm off. --measured prints the imbalance of held-out modes of a
measured LBT672, FOLDER/lbt672/lbt672-feedforward.fits.
"""

import argparse
from dataclasses import replace

import numpy as np

from studies.joint_bound import BruteForce
from studies.reciprocity_matrices import foreign_matrices, gate, large, real
from truenewton.bench.simulated.static import (
    SENSOR_NOISE,
    loop_of,
    rest_displacement,
    run_cycles,
    static_bench,
)
from truenewton.estimation import campaign_ml
from truenewton.estimation.readings.moments import reading_noise
from truenewton.estimation.reciprocity import campaign as reciprocity_of_campaign
from truenewton.estimation.reciprocity.iteration import fit, point_at
from truenewton.estimation.reciprocity.regression import regressed
from truenewton.estimation.reciprocity.sensor_model import (
    Kind,
    Request,
    Values,
    at_nominal,
    places_of,
)
from truenewton.estimation.screening.screen import screen_campaign
from truenewton.mirrors.known import p45
from truenewton.mirrors.sensor_model import sensor_model
from truenewton.records.campaign import Campaign

GAINS = {"gains known": Request(), "gains +- 0.4 %": Request(0.004), "gains free": Request(np.inf)}


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


def log_about(alpha):
    """Return log alpha minus its mean."""
    return np.log(alpha) - np.mean(np.log(alpha))


def chi2_at(places, stiffness, values):
    """Return chi2 of S, t and A, relative to their numbers of elements, for given values."""
    point = point_at(places, values, Request(), stiffness.states)
    m = point.states.count
    return np.array(point.left.chi2(point.weights)) / (3 * m, 3 * m, m * (m - 1) / 2)


class Line:
    """Results of one method over the seeds."""

    def __init__(self):
        self.errors, self.stated, self.inside, self.bounds, self.chi2 = [], [], [], [], []
        self.distances, self.patterns = [], []

    def add(self, error, covariance, chi2):
        covariance = about_mean(covariance)
        stated = np.sqrt(np.diag(covariance))
        error = error - error.mean()
        size, axes = (part[..., 1:] for part in np.linalg.eigh(covariance))
        self.distances.append(np.mean((error @ axes) ** 2 / size))
        self.patterns.append(size.sum() ** 2 / np.sum(size**2))
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
        return (
            f"{rms:.2e}   {stated:.2e}   {ratio:>6}   {np.mean(self.inside):.3f}"
            f"      {np.mean(self.distances):.2f}     {np.mean(self.patterns):4.1f}      {chi2}"
        )


def campaigns(seeds, bounds, noise, loop):
    """Print scatter, bound and coverage over campaigns."""
    mirror = p45()
    motion = sensor_model(mirror, mirror.layout)
    exact = places_of(mirror.layout, motion)
    lines: dict[str, Line] = {}
    at_truth, n = [], mirror.layout.n
    for seed in range(seeds):
        bench = static_bench(mirror, seed, force_noise=noise)
        campaign = Campaign(tuple(run_cycles(bench, 4, loop_of(bench) if loop else None)))
        alpha = bench.truth.alpha
        if loop:
            alpha = alpha * (1 + bench.coils.coil_gradient * rest_displacement(bench).mean(axis=0))
        screened = screen_campaign(campaign)
        for name, estimate in (
            ("ml", campaign_ml.fit_campaign(screened)),
            ("reciprocity, glass known", reciprocity_of_campaign.fit_campaign(screened, motion)),
            ("reciprocity", reciprocity_of_campaign.fit_campaign(screened)),
        ):
            found = estimate.values[:n]
            relative = estimate.reading_covariance[:n, :n] / np.outer(found, found)
            assert estimate.goodness is not None
            lines.setdefault(name, Line()).add(
                np.log(found / alpha), relative, [estimate.goodness.reduced]
            )
        gain, offset = np.log(bench.truth.sensor_gain), np.zeros((2, n))
        noises = reading_noise(campaign, screened.moments)
        gradients = {"bias_gradient": mirror.bias_gradient, "coil_gradient": mirror.coil_gradient}
        stiffness = regressed(screened.moments, noises.variance, **gradients)
        at_truth.append(chi2_at(exact, stiffness, Values(log_about(alpha), gain, offset)))
        for name, asked in GAINS.items():
            start = replace(at_nominal(n), log_alpha=log_about(found))
            if not asked.gain_spread:
                start = replace(start, log_gain=gain)
            made = fit(exact, asked, stiffness.states, start=start)
            line = lines.setdefault(name, Line())
            covariance = made.covariance_of(Kind.ALPHA)
            line.add(made.values.log_alpha - np.log(alpha), covariance, made.reduced)
            if seed < bounds and not loop:
                line.bounds.append(bound(bench, exact, stiffness.square, noise, asked) ** 2)
    print(f"{'':<26}rms        stated     /bound   coverage   errors   patterns  chi2/DOF")
    for name, line in lines.items():
        print(f"{name:<26}{line}")
    print(f"chi2 of S, t and A at the truth: {np.round(np.mean(at_truth, axis=0), 3)}")


def main():
    """Run from the command line."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("--seeds", type=int, default=30)
    parser.add_argument("--bounds", type=int, default=5, help="seeds whose bound is computed")
    parser.add_argument("--noise", type=float, default=1e-3, help="of a force reading [N]")
    parser.add_argument("--loop", action="store_true", help="in closed loop")
    parser.add_argument("--gate", action="store_true")
    parser.add_argument("--foreign", action="store_true")
    parser.add_argument("--large", action="store_true")
    parser.add_argument("--measured", action="store_true")
    options = parser.parse_args()
    if options.measured:
        real()
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
