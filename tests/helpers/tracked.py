"""Days of one mirror at different temperatures: the simulated bench has no temperature yet."""

import datetime
from dataclasses import replace
from functools import cache

import numpy as np

import truenewton as tn
from truenewton.bench.simulated.static import run_cycles
from truenewton.tracking.days import YEAR, covariances

TEMPERATURES = (12.0, 19.2, 14.4, 24.0, 16.8, 21.6)
MEAN_K, SPREAD_K = -1.1e-3, 2e-4
NOISE = 2e-4


@cache
def quiet_cycles(cycles=2):
    """Return the noiseless cycles of P45, and its alpha."""
    from helpers.balanced import p45_bench

    bench = replace(p45_bench(), force_noise=0.0)
    return tuple(run_cycles(bench, cycles)), bench.truth.alpha


def campaign_at(factor, random, *, noise=NOISE, days=0.0, temperature=20.0, loads=2, cycles=2):
    """Return a campaign in which every alpha is (n,) factor times the true one."""
    made = [
        replace(
            c,
            date=c.date + datetime.timedelta(days=days),
            force=c.force / factor + noise * random.standard_normal(c.force.shape),
            force_error=noise,
            temperature=None if temperature is None else np.full(len(c.time), temperature),
        )
        for c in quiet_cycles(cycles)[0]
        if loads == 2 or c.load.name == "bare"
    ]
    return tn.Campaign(tuple(made))


def days_of(seed, k, r=0.0, *, gap=30.0, temperatures=TEMPERATURES, **options):
    """Return campaigns of days ``gap`` apart with k [1/K] and drift r [1/yr] about 18 deg C."""
    random = np.random.default_rng(seed)
    return [
        campaign_at(
            (1 + k * (t - 18.0) + r * (place * gap / 365.25)) * np.ones(45),
            random,
            days=place * gap,
            temperature=t,
            **options,
        )
        for place, t in enumerate(temperatures)
    ]


@cache
def pattern(noise=NOISE):
    """Return a calibration of P45, from whose covariance others are drawn."""
    return tn.calibrate(campaign_at(np.ones(45), np.random.default_rng(1), noise=noise))


def scaled(one, alpha, **changes):
    """Return a calibration with other alpha, the error of its ring in proportion to it."""
    factor = np.append(alpha / one.alpha, np.ones(len(one.covariance) - len(alpha)))
    systematic_covariance = one.systematic_covariance * np.outer(factor, factor)
    covariance = one.covariance - one.systematic_covariance + systematic_covariance
    return replace(
        one,
        alpha=alpha,
        systematic_covariance=systematic_covariance,
        covariance=covariance,
        systematic_error=one.systematic_error / one.alpha * alpha,
        sources=(),
        **changes,
    )


def drawn(seed, k, r=0.0, *, gap=30.0, temperatures=TEMPERATURES, noise=NOISE, scale=0.0):
    """Return calibrations of days drawn from a covariance: quicker than campaigns."""
    random = np.random.default_rng(seed)
    one = pattern(noise)
    reading_covariance = covariances(one, np.ones(45, dtype=bool))[0]
    root = np.linalg.cholesky(reading_covariance)
    made = []
    for place, t in enumerate(temperatures):
        date = one.date + datetime.timedelta(days=place * gap)
        law = quiet_cycles()[1] * (1 + k * (t - 18.0) + r * (date - one.date) / YEAR)
        made.append(
            scaled(
                one,
                law * (1 + scale) + root @ random.standard_normal(45),
                date=date,
                date_end=date + datetime.timedelta(hours=2),
                temperature=t,
            )
        )
    return made
