"""Whether tracking keeps what it states, by Monte Carlo.

    python -m studies.tracking [--seeds 200] [--mirrors 1000] [--replacements 1000]
                                  [--scatter 100]

Law: six days at 12 to 24 deg C, k ~ N(-1.1e-3, 2e-4) / K, drift ~ N(-2e-3, 1e-3) / yr. Calibrations
are drawn from the COVARIANCE of one simulated P45 campaign (4 cycles); the error of the ring is the
same on all days. False alarms: likewise. Replacement: one cycle under one load after actuator 17
was replaced; readings and earlier calibration have noise. Bounds: the inverse of the information on
all unknowns, computed independently.

Scatter: calibrations are thirty days apart. Actuators scatter about their laws, independently or
also in common, or drift independently before a short run. Another actuator may change by 1 %.
Predictions refer to a new day with scatter, without the error of the ring, which is constant for a
mirror. "Stated" is the ratio of stated errors to those if zero scatter were known.
"""

from __future__ import annotations

import argparse
import datetime
from dataclasses import replace
from unittest import mock

import numpy as np

import truenewton as tn
from studies.accuracy import TWO_SIGMA
from truenewton.bench.simulated.static import run_cycles, static_bench
from truenewton.mirrors.known import p45
from truenewton.tracking import fit
from truenewton.tracking.days import YEAR, covariances
from truenewton.tracking.lines import Scatter

SEED = 8171
MEAN_K, SPREAD_K = -1.1e-3, 2e-4
MEAN_R, SPREAD_R = -2e-3, 1e-3
TEMPERATURES = np.array([12.0, 19.2, 14.4, 24.0, 16.8, 21.6])

Array = np.ndarray


def one_calibration(noise: float = 1e-3, cycles: int = 4) -> tn.Calibration:
    """Calibrate a simulated P45. Days are drawn from its covariance."""
    bench = static_bench(p45(), SEED, force_noise=noise)
    return tn.calibrate(tn.Campaign(tuple(run_cycles(bench, cycles))))


class World:
    """One mirror: its true law, and calibrations on six days."""

    def __init__(self, pattern: tn.Calibration, seed: int, gap: float = 1.0) -> None:
        random = np.random.default_rng([SEED, seed])
        n = pattern.layout.n
        self.a = pattern.alpha
        self.k = random.normal(MEAN_K, SPREAD_K, n)
        self.r = random.normal(MEAN_R, SPREAD_R, n)
        self.start = pattern.date
        reading_covariance, systematic_covariance = covariances(pattern, np.ones(n, dtype=bool))
        root = np.linalg.cholesky(reading_covariance)
        scale = np.sqrt(systematic_covariance[0, 0]) / self.a[0] * random.standard_normal()
        self.scale = scale
        self.days = []
        for place, temperature in enumerate(TEMPERATURES):
            date = self.start + place * gap * datetime.timedelta(days=1)
            read = self.alpha(temperature, date) * (1 + scale) + root @ random.standard_normal(n)
            whole, weights = pattern.covariance.copy(), pattern.systematic_covariance.copy()
            weights[:n, :n] = systematic_covariance[0, 0] / self.a[0] ** 2 * np.outer(read, read)
            whole[:n, :n] = reading_covariance + weights[:n, :n]
            self.days.append(
                replace(
                    pattern,
                    alpha=read,
                    covariance=whole,
                    systematic_covariance=weights,
                    temperature=temperature,
                    date=date,
                    date_end=date,
                    sources=(),
                )
            )

    def alpha(self, temperature: float, date: datetime.datetime) -> Array:
        """Return (n,) true alpha."""
        years = (date - self.start) / YEAR
        return self.a * (1 + self.k * (temperature - 18.0) + self.r * years)


def bound(pattern: tn.Calibration, gap: float) -> float:
    """Return the lower bound of the rms error of k, for known spreads and unknown means."""
    n = pattern.layout.n
    reading_covariance, _ = covariances(pattern, np.ones(n, dtype=bool))
    weight = np.linalg.inv(reading_covariance / np.outer(pattern.alpha, pattern.alpha))
    information = np.zeros((3 * n + 2, 3 * n + 2))
    for place, temperature in enumerate(TEMPERATURES):
        row = np.array([1.0, temperature - TEMPERATURES.mean(), (place - 2.5) * gap / 365.25])
        information[: 3 * n, : 3 * n] += np.kron(np.outer(row, row), weight)
    for place, spread in ((1, SPREAD_K), (2, SPREAD_R)):
        own, mean = slice(place * n, (place + 1) * n), 3 * n + place - 1
        information[own, own] += np.eye(n) / spread**2
        information[own, mean] -= 1 / spread**2
        information[mean, own] -= 1 / spread**2
        information[mean, mean] += n / spread**2
    scale = 1 / np.sqrt(np.diag(information))
    inverse = np.linalg.inv(information * np.outer(scale, scale)) * np.outer(scale, scale)
    return float(np.sqrt(np.mean(np.diag(inverse)[n : 2 * n])))


def law(pattern: tn.Calibration, seeds: int, gap: float, words: str) -> None:
    """Print coverage of means, spreads and predictions, and the error of k / its bound."""
    mean, spread, squares, stated, inside = [], [], [], [], []
    for seed in range(seeds):
        world = World(pattern, seed, gap)
        found = tn.track(*world.days)
        population = found.populations[0]
        mean.append(population.mean_interval[0] <= MEAN_K <= population.mean_interval[1])
        spread.append(population.spread_interval[0] <= SPREAD_K <= population.spread_interval[1])
        squares.append(np.mean((found.coefficient - world.k) ** 2))
        stated.append(np.mean(found.errors[1] ** 2))
        at = [(10.0, found.days[-1].date), (18.0, found.date), (27.0, found.days[0].date)]
        for temperature, date in at:
            predicted = found.alpha_at(temperature, date)
            off = np.abs(predicted.alpha - world.alpha(temperature, date))
            inside.append(np.mean(off <= TWO_SIGMA * predicted.error))
    least = bound(pattern, gap)
    rms = np.sqrt(np.mean(squares))
    error = np.std(squares) / np.sqrt(seeds) / (2 * rms) / least
    print(f"{words}, {seeds} mirrors")
    print(f"  mean of k in its 95 % interval      {rate(mean)}")
    print(f"  spread of k in its 95 % interval    {rate(spread)}")
    print(f"  RMS error of k / bound {least:.3g}/K    {rms / least:.3f} +- {error:.3f}")
    print(f"  stated / RMS error of k             {np.sqrt(np.mean(stated)) / rms:.3f}")
    print(f"  95 % predictions of alpha cover     {100 * np.mean(inside):.1f} %"
          f" +- {100 * np.std(inside) / np.sqrt(seeds):.1f} %")  # fmt: skip


def rate(hits: list[bool]) -> str:
    """Return a rate with its binomial error."""
    p = np.mean(hits)
    return f"{100 * p:.1f} % +- {100 * np.sqrt(p * (1 - p) / len(hits)):.1f} %"


def alarms(pattern: tn.Calibration, mirrors: int) -> None:
    """Print the rate of false outliers."""
    false = [bool(tn.track(*World(pattern, 10_000 + s).days).outliers) for s in range(mirrors)]
    print(f"no outlier, {mirrors} mirrors\n  any false alarm (stated 1 %)        {rate(false)}")


STEP = 0.01
SCATTERS = [(0.0, 0.0), (3e-4, 0.0), (1e-3, 0.0), (3e-3, 0.0), (3e-4, 3e-4), (1e-3, 1e-3),
            (3e-3, 3e-3)]  # fmt: skip


def scattered(world: World, seed: int, own: float, common: float) -> list[tn.Calibration]:
    """Return the days of a world with independent and common scatter about the law."""
    random = np.random.default_rng([SEED, 3, seed])
    return [
        replace(
            day,
            alpha=day.alpha
            * (1 + own * random.standard_normal(day.layout.n))
            * (1 + common * random.standard_normal()),
        )
        for day in world.days
    ]


def scatter(pattern: tn.Calibration, noise: float, seeds: int, own: float, common: float) -> None:
    """Print false alarms, coverage and power if days scatter."""
    n = pattern.layout.n
    false, mean, ofk, inside, named, alone, ratio, off = [], [], [], [], [], [], [], []
    for seed in range(seeds):
        world = World(pattern, seed, 30.0)
        days = scattered(world, seed, own, common)
        found = tn.track(*days)
        false.append(bool(found.outliers))
        low, high = found.populations[0].mean_interval
        mean.append(low <= MEAN_K <= high)
        ofk.append(np.mean(np.abs(found.coefficient - world.k) <= TWO_SIGMA * found.errors[1]))
        off.append(np.mean((found.coefficient - world.k) ** 2))
        random = np.random.default_rng([SEED, 4, seed])
        for temperature, date in [(13.0, found.days[-1].date), (18.0, found.date),
                                  (23.0, found.days[0].date)]:  # fmt: skip
            at = found.alpha_at(temperature, date)
            truth = world.alpha(temperature, date) * (1 + common * random.standard_normal())
            truth = truth * (1 + own * random.standard_normal(n))
            error = np.sqrt(np.diag(at.covariance - at.systematic_covariance))
            residual = np.abs(at.alpha / (1 + world.scale) - truth)
            inside.append(np.mean(residual <= TWO_SIGMA * error))
        if not own and not common:
            with mock.patch.object(
                fit, "estimate_scatter", lambda y, *_, **__: Scatter(degrees=len(y))
            ):
                known = tn.track(*days)
            ratio.append(np.median(found.errors[1] / known.errors[1]))
        stepped = np.where(np.arange(n) == REPLACED, 1 + STEP, 1.0)
        after = [replace(day, alpha=day.alpha * stepped) for day in days[3:]]
        names = [one.actuator for one in tn.track(*days[:3], *after).outliers]
        named.append(int(pattern.layout.id[REPLACED]) in names)
        alone.append(len(set(names) - {int(pattern.layout.id[REPLACED])}) == 0)
    print(f"scatter {100 * own:g} % each, {100 * common:g} % in common, {1e3 * noise:g} mN,"
          f" {seeds} mirrors")  # fmt: skip
    print(f"  others reported as changed          {rate(false)}")
    print(f"  mean of k in its 95 % interval      {rate(mean)}")
    print(f"  95 % intervals of k cover           {share(ofk)}")
    print(f"  RMS error of k                      {np.sqrt(np.mean(off)):.3g}/K")
    print(f"  95 % predictions of a day cover     {share(inside)}")
    print(f"  a step of 1 % named                 {rate(named)}")
    print(f"    and nobody else                   {rate(alone)}")
    if ratio:
        low, middle, high = np.quantile(ratio, [0.05, 0.5, 0.95])
        print(f"  stated E_K / with no scatter known  median {middle:.3f}, mean"
              f" {np.mean(ratio):.3f}, 90 % within {low:.3f} .. {high:.3f}")  # fmt: skip


def share(parts: list[float]) -> str:
    """Return a mean of fractions with its error."""
    return f"{100 * np.mean(parts):.1f} % +- {100 * np.std(parts) / np.sqrt(len(parts)):.1f} %"


def drifted(noise: float, runs: int, drift: float) -> None:
    """Print the same for a short run after independent drifts of the other actuators."""
    mirror, ids = Mirror(noise), p45().layout.id
    off, stated, false, named, found = [], [], [], [], []
    for seed in range(runs):
        random = np.random.default_rng([SEED, 8, seed])
        known = mirror.earlier(random)
        factor = 1 + drift * random.standard_normal(len(ids))
        factor[REPLACED] = 0.8
        made = tn.recalibrate(mirror.run(factor, random), known, [int(ids[REPLACED])])
        truth = mirror.truth.alpha[REPLACED] * 0.8
        off.append(made.calibration.alpha[REPLACED] - truth)
        stated.append(made.calibration.statistical_error[REPLACED])
        found.append(made.scatter)
        false.append(bool(made.moved))
        factor[SECOND] *= 1 + STEP
        made = tn.recalibrate(mirror.run(factor, random), known, [int(ids[REPLACED])])
        named.append([one.actuator for one in made.moved] == [int(ids[SECOND])])
    inside = np.abs(off) <= TWO_SIGMA * np.array(stated)
    print(f"others drifted by {100 * drift:g} % each before a short run, {1e3 * noise:g} mN,"
          f" {runs} runs")  # fmt: skip
    print(f"  found                               {100 * np.sqrt(np.mean(np.square(found))):.2g} %")
    print(f"  others reported as changed          {rate(false)}")
    print(f"  95 % intervals of the new alpha     {rate(list(inside))}")
    print(f"  RMS error of the new alpha          {np.sqrt(np.mean(np.square(off))):.2g}")
    print(f"  a step of 1 % named, and nobody else  {rate(named)}")


REPLACED, SECOND = 16, 30  # indices of actuators


class Mirror:
    """P45 with a replaced actuator 17: earlier calibration, and runs of one cycle and load."""

    def __init__(self, noise: float) -> None:
        bench = replace(static_bench(p45(), SEED, force_noise=noise), force_noise=0.0)
        self.noise, self.truth = noise, bench.truth
        self.pattern = one_calibration(noise)
        [self.quiet] = [c for c in run_cycles(bench, 1) if c.load.name == "bare"]
        every = np.ones(bench.truth.layout.n, dtype=bool)
        self.reading_covariance = covariances(self.pattern, every)[0]
        self.root = np.linalg.cholesky(self.reading_covariance)

    def earlier(self, random: np.random.Generator) -> tn.Calibration:
        """Return the earlier calibration, with independent errors."""
        return replace(
            self.pattern,
            alpha=self.truth.alpha + self.root @ random.standard_normal(len(self.root)),
        )

    def run(self, factor: Array, random: np.random.Generator) -> tn.Campaign:
        """Return a run in which alpha is multiplied by (n,) factors."""
        clean = self.quiet.force / factor
        force = clean + self.noise * random.standard_normal(clean.shape)
        return tn.Campaign((replace(self.quiet, force=force, force_error=self.noise),))

    def bound(self, factor: Array) -> float:
        """Return the bound of the error of the new alpha, from the run and the prior."""
        layout, alpha = self.truth.layout, self.truth.alpha * factor
        a = np.array([layout.nz, layout.x, layout.y])
        inverse = np.linalg.inv((a * alpha) @ (a * alpha).T * self.noise**2)
        n = layout.n
        information = np.zeros((n + 3, n + 3))
        external = np.diag([1.0, 1.0, -1.0])
        for c in self.quiet.force / factor:
            j = np.hstack([a * c, external])
            information += j.T @ inverse @ j
        others = np.arange(n) != REPLACED
        at = np.ix_(np.flatnonzero(others), np.flatnonzero(others))
        information[at] += np.linalg.inv(self.reading_covariance[at])
        return float(np.sqrt(np.linalg.inv(information)[REPLACED, REPLACED]))


def replacements(noise: float, runs: int) -> None:
    """Print the error of the new alpha, false alarms, and the power for a second change."""
    mirror, new = Mirror(noise), np.ones(45)
    new[REPLACED] = 0.8
    ids = mirror.truth.layout.id
    both = new.copy()
    both[SECOND] = 1 + 6 * mirror.bound(new)
    off, stated, false, false_auto, found = [], [], [], [], []
    for seed in range(runs):
        random = np.random.default_rng([SEED, 7, seed])
        known = mirror.earlier(random)
        made = tn.recalibrate(mirror.run(new, random), known, [int(ids[REPLACED])])
        off.append(made.calibration.alpha[REPLACED] - mirror.truth.alpha[REPLACED] * 0.8)
        stated.append(made.calibration.statistical_error[REPLACED])
        false.append(bool(made.moved))
        false_auto.append(bool(tn.recalibrate(mirror.run(np.ones(45), random), known).moved))
        made = tn.recalibrate(mirror.run(both, random), known, [int(ids[REPLACED])])
        found.append([one.actuator for one in made.moved] == [int(ids[SECOND])])
    bound, rms = mirror.bound(new), np.sqrt(np.mean(np.square(off)))
    inside = np.abs(off) <= TWO_SIGMA * np.array(stated)
    print(f"one cycle, one load after a replacement, {1e3 * noise:g} mN, {runs} runs")
    print(f"  RMS error of the new alpha / bound {bound:.2g}    {rms / bound:.3f}"
          f" +- {rms / bound / np.sqrt(2 * runs):.3f}")  # fmt: skip
    print(f"  bias / scatter                      {np.mean(off) / np.std(off):.3f}"
          f" +- {1 / np.sqrt(runs):.3f}")  # fmt: skip
    print(f"  95 % intervals (E_STAT) cover       {rate(list(inside))}")
    print(f"  others reported as changed (1 %)    {rate(false)}")
    print(f"  the same, nobody replaced or named  {rate(false_auto)}")
    print(f"  a second change of {100 * (both[SECOND] - 1):.1f} % found, alone  {rate(found)}")


def main() -> None:
    """Run all parts; 0 skips a part."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=200)
    parser.add_argument("--mirrors", type=int, default=1000)
    parser.add_argument("--replacements", type=int, default=1000)
    parser.add_argument("--scatter", type=int, default=100)
    options = parser.parse_args()
    pattern, quiet = one_calibration(), one_calibration(1e-4)
    if options.seeds:
        law(pattern, options.seeds, 1.0, "six days, 1 mN")
        law(quiet, options.seeds, 1.0, "six days, 0.1 mN")
        law(quiet, options.seeds, 60.0, "six days sixty days apart, 0.1 mN")
    for seen in (pattern, quiet) * bool(options.mirrors):
        alarms(seen, options.mirrors)
    for noise in (1e-3, 1e-4) * bool(options.replacements):
        replacements(noise, options.replacements)
    for noise, seen in ((1e-4, quiet), (1e-3, pattern)) * bool(options.scatter):
        for own, common in SCATTERS:
            scatter(seen, noise, options.scatter, own, common)
        for drift in (0.0, 3e-4, 1e-3, 3e-3):
            drifted(noise, options.scatter, drift)


if __name__ == "__main__":
    main()
