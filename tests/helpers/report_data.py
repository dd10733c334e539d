"""Situations that a report must tell apart, and a large mirror."""

from dataclasses import replace

import numpy as np

from helpers.balanced import BARE_AND_RING, campaign_of
from truenewton.calibration.methods import calibrate
from truenewton.estimation.findings.estimate import Diagnosis, Sensor
from truenewton.mirrors.known import ring
from truenewton.records.campaign import Campaign
from truenewton.records.cycle import Source
from truenewton.statics.load import Load

FINE_RING = Load("ring", -0.289, 2e-5, tool="ring A")


def fine(**options):
    """Return a campaign whose readings and weights are about equally good."""
    loads = (Load("bare"), FINE_RING)
    return campaign_of(3, 1e-4, loads=loads, weight_error=1e-5, cycles=4, **options)[0]


def scale_limited():
    return campaign_of(3, 1e-4, loads=BARE_AND_RING, cycles=4)[0]


def with_outliers(rows=3, size=0.05):
    campaign = fine()
    first, *rest = campaign.cycles
    force = first.force.copy()
    force[np.arange(rows), 5] += size
    return Campaign((replace(first, force=force), *rest))


def one_load():
    return Campaign(tuple(c for c in fine().cycles if c.load.name == "bare"))


def too_few_shapes():
    return fine(shapes=3)


def large(actuators):
    """Return a calibration of a large mirror, its covariance left empty."""
    layout, random = ring(actuators).layout, np.random.default_rng(5)
    n = layout.n
    nothing = np.zeros((n + 1, n + 1))  # never touched, so it takes no memory
    nothing.setflags(write=False)
    return replace(
        calibrate(scale_limited()),
        instrument="LARGE",
        scale="mean 1",
        layout=layout,
        loads=(),
        alpha=random.normal(1.0, 0.03, n),
        statistical_error=np.full(n, 0.005),
        systematic_error=np.zeros(n),
        cycle_error=np.full(n, np.nan),
        covariance=nothing,
        systematic_covariance=nothing,
        torque_y=np.empty(0),
        torque_x=np.empty(0),
        effects=(),
        scale_errors=(),
        unseen=(),
        diagnosis=Diagnosis(),
        goodness=None,
        sources=(),
    )


HOSTILE = (
    "<script>window.hit=1</script>\"'&\n</script><img src=x onerror=window.hit=1> $$x$$ {{7*7}}"
)


def with_sensors(calibration):
    """Return a calibration that holds sensors; that of actuator 8 is free."""
    random = np.random.default_rng(3)
    gains, places = random.normal(1.0, 4e-3, 45), random.normal(0.0, 5e-4, (45, 2))
    sensors = [
        Sensor(actuator, gain, 2e-3, x, 1e-4, y, 1e-4, "fitted")
        for actuator, gain, (x, y) in zip(
            calibration.layout.id.tolist(), gains.tolist(), places.tolist(), strict=True
        )
    ]
    nothing = [float("nan")] * 6
    sensors[7] = Sensor(8, *nothing, "free")
    return replace(calibration, sensors=tuple(sensors))


def changed_by(sigmas, *, ratio=1.02):
    """Return a calibration and another whose actuator 7 moved by so many sigmas."""
    one = calibrate(campaign_of(3, 1e-4, cycles=4)[0])
    alpha = one.alpha.copy()
    alpha[6] += sigmas * np.sqrt(2) * one.statistical_error[6]
    other = replace(
        one, alpha=ratio * alpha, statistical_error=ratio * one.statistical_error, sources=(),
        systematic_error=ratio * one.systematic_error,
    )  # fmt: skip
    return one, other


def hostile_campaign():
    """Return a campaign with outliers whose every name is an attack."""
    campaign = with_outliers()
    cycles = []
    for k, cycle in enumerate(campaign.cycles):
        load = replace(cycle.load, name=f"{cycle.load.name}{HOSTILE}", tool=HOSTILE)
        source = Source(f'{k}<img src=x onerror=window.hit=1>".fits', f"{k:064x}")
        cycles.append(replace(cycle, instrument=HOSTILE, load=load, source=source))
    return Campaign(tuple(cycles))
