"""Small campaigns made by hand: random forces that balance, divided by random alpha."""

import datetime
from dataclasses import replace
from functools import cache

import numpy as np

from truenewton.bench.simulated.static import run_cycles, static_bench
from truenewton.mirrors.known import p45
from truenewton.records.campaign import Campaign
from truenewton.records.cycle import Cycle
from truenewton.records.stiffness_matrix import StiffnessMatrix
from truenewton.statics.layout import rings
from truenewton.statics.load import Load

LAYOUT = rings([0.06, 0.1], [5, 9], nz=[0.999, 0.99])
START = datetime.datetime(2026, 3, 4, 5, 6, 7, tzinfo=datetime.UTC)
WEIGHT, BIAS = -2.9, 3.6
RING = Load("ring", -0.289, 0.005, tool="ring A")
BARE_AND_RING = (Load("bare"), RING)


def arms_of(layout):
    return np.array([layout.nz, layout.x, layout.y])


def balanced_rows(random, a, k, rows, size=0.3):
    """Return true forces with A f = -k: random ones, their imbalance taken out."""
    force = size * random.standard_normal((rows, a.shape[1]))
    return force - (force @ a.T + k) @ np.linalg.pinv(a).T


def campaign_of(
    seed,
    noise,
    *,
    layout=LAYOUT,
    loads=BARE_AND_RING,
    cycles=2,
    shapes=None,
    disabled=(),
    invalid=(),
    weight_error=0.005,
):
    """Return a campaign and its truth (alpha, B, then M_y, M_x of each load)."""
    random = np.random.default_rng(seed)
    n = layout.n
    on = ~np.isin(np.arange(n), disabled)
    layout = type(layout)(layout.id, layout.x, layout.y, layout.nz, on)
    a = arms_of(layout)[:, on]
    alpha = random.uniform(0.7, 1.1, n)
    torques = random.normal(0, 0.05, (len(loads), 2))
    count = shapes or n
    elastic = balanced_rows(random, a, np.zeros(3), count)
    made = []
    for load, (torque_y, torque_x) in zip(loads, torques, strict=True):
        w = (WEIGHT + load.added) * np.cos(np.radians(load.tilt))
        k = np.array([w + BIAS, torque_y, -torque_x])
        rest = -np.linalg.pinv(a) @ k
        true_force = np.concatenate([elastic + rest, -elastic + rest])
        for number in range(1, cycles + 1):
            c = np.full((2 * count, n), np.nan)
            c[:, on] = true_force / alpha[on] + noise * random.standard_normal(true_force.shape)
            valid = ~np.isin(np.arange(2 * count), invalid)
            c[~valid] = 1e9
            made.append(
                Cycle(
                    instrument="TEST",
                    date=START,
                    number=number,
                    load=load,
                    weight=WEIGHT,
                    weight_error=weight_error,
                    layout=layout,
                    time=np.arange(2 * count, dtype=float),
                    shape=np.tile(np.arange(1, count + 1), 2),
                    sign=np.repeat([1, -1], count),
                    force=c,
                    valid=valid,
                )
            )
    return Campaign(tuple(made)), np.concatenate([alpha[on], [BIAS], torques.ravel()])


def gradients(seed, noise, offset, cycles=3, *, moved=0.0, zeros=0.0):
    """Return a campaign whose coils and bias magnets feel the displacement, and its alpha.

    f = alpha c (1 + 600 z), and 31 N/m z more from each bias magnet; sensors have offsets. Forces
    are made here, from the equations of the file contract alone. Under each load the glass rests
    elsewhere, about a mean of 0, by ``moved`` [m, rms], and each file has zeros of its own, by
    ``zeros``.
    """
    coil, bias = 600.0, 31.0
    plain, truth = campaign_of(seed, 0.0, cycles=cycles)
    random = np.random.default_rng([seed, 1])
    a, alpha = arms_of(LAYOUT), truth[:14]
    elastic = balanced_rows(random, a, np.zeros(3), 14)
    shape = 1e-6 * random.standard_normal((14, 14))
    shape = np.concatenate([shape, -shape])
    offsets = offset * random.standard_normal(14)
    rest, *anew = np.random.default_rng([seed, 2]).standard_normal((1 + 2 * cycles, 14))
    made = []
    for k, (cycle, place) in enumerate(zip(plain.cycles, plain.load_index, strict=True)):
        torque_y, torque_x = truth[15 + 2 * place : 17 + 2 * place]
        external = np.array([-2.9 + cycle.load.added + BIAS, torque_y, -torque_x])
        z = shape + moved * (-1) ** place * rest
        # All that the bias magnets change, the coils must balance.
        missing = np.concatenate([elastic, -elastic]) @ a.T + bias * z @ a.T + external
        f = np.concatenate([elastic, -elastic]) - missing @ np.linalg.pinv(a).T
        c = f / (alpha * (1 + coil * z))
        made.append(
            replace(
                cycle,
                force=c + noise * random.standard_normal(c.shape),
                position=z + offsets + zeros * anew[k],
                coil_gradient=coil,
                bias_gradient=bias,
                force_error=1e-4,
            )
        )
    return Campaign(tuple(made)), alpha


def three_loads(seed, noise, **options):
    """Return a campaign under the bare mirror, a ring, and a tilt."""
    loads = (Load("bare"), RING, Load("tilt", -0.1, 0.002, tilt=60.0, tilt_error=0.1))
    return campaign_of(seed, noise, loads=loads, **options)[0]


def ungraded(bench):
    """Return a bench whose forces do not change with the gap: exact without its sensors."""
    return replace(bench, coils=replace(bench.coils, coil_gradient=0.0, bias_gradient=0.0))


@cache
def p45_bench():
    """Return a simulated P45 at 1 mN, no gradients."""
    return ungraded(static_bench(p45(), seed=1, force_noise=1e-3))


def p45_matrix(noise=1e-4, seed=2):
    """Return its stiffness in commanded Newtons, noise in proportion to each element; and alpha."""
    truth = p45_bench().truth
    k = truth.stiffness / truth.alpha[:, None]
    k = k * (1.0 + noise * np.random.default_rng(seed).standard_normal(k.shape))
    return StiffnessMatrix("P45", START, truth.layout, k), truth.alpha


@cache
def p45_campaign(cycles=4):
    """Return a campaign on it."""
    return Campaign(tuple(run_cycles(p45_bench(), cycles)))


def changed(campaign, **fields):
    """Return a campaign with fields of its cycles changed, to values or functions of (k, cycle)."""
    return Campaign(
        tuple(
            replace(c, **{name: v(k, c) if callable(v) else v for name, v in fields.items()})
            for k, c in enumerate(campaign.cycles)
        ),
        campaign.stiffness,
    )


def with_spike(campaign, cycle, row, actuator, size):
    """Return the campaign with one force off by so much."""
    force = campaign.cycles[cycle].force.copy()
    force[row, actuator] += size
    return changed(campaign, force=lambda k, c: force if k == cycle else c.force)


def exact_weights(bench, cycles=4):
    """Return a campaign on a bench whose weights are declared as they are, without error."""
    true = bench.truth
    return changed(
        Campaign(tuple(run_cycles(bench, cycles))),
        weight=true.weight,
        weight_error=0.0,
        load=lambda k, c: replace(c.load, added=true.added[k // cycles], added_error=0.0),
    )


def rms_z(found, alpha):
    """Return the RMS of the errors of alpha in units of what is stated of them."""
    return np.sqrt(np.mean(((found.alpha - alpha) / found.error) ** 2))


def p45_shapes(shapes, noise, cycles=2):
    """Return a campaign of P45 that applies only the given displacements."""
    bench = replace(p45_bench(), shapes=shapes, force_noise=noise)
    return Campaign(tuple(run_cycles(bench, cycles)))


def noisy(quiet, sigma, seed):
    """Return a campaign with noise of (n,) standard deviations, or of one for each cycle."""
    random = np.random.default_rng(seed)
    sigma = np.broadcast_to(sigma, (len(quiet.cycles), quiet.layout.n))
    return changed(
        quiet, force=lambda k, c: c.force + sigma[k] * random.standard_normal(c.force.shape)
    )
