"""Situations that a report must tell apart, and a large mirror."""

from dataclasses import replace

import numpy as np
from balanced import BARE_AND_RING, BIAS, START, campaign_of

from truenewton.calibration.result import Calibration
from truenewton.mirrors.known import ring
from truenewton.records.campaign import Campaign
from truenewton.statics.load import Load

FINE_RING = Load("ring", -0.289, 2e-5, tool="ring A")


def fine(**options):
    """Return a campaign whose readings and weights are about equally good."""
    loads = (Load("bare"), FINE_RING)
    return campaign_of(3, 1e-4, loads=loads, weight_error=1e-5, cycles=4, **options)[0]


def scale_limited():
    return campaign_of(3, 1e-4, loads=BARE_AND_RING, cycles=4)[0]


def with_weak_actuator():
    """Actuator 8 gives a tenth of the force that it is told to give."""
    return _each(fine(), lambda force: _times(force, 7, 10.0))


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


def large(actuators=5352):
    """Return a calibration of a large mirror, its covariance left empty."""
    layout, random = ring(actuators).layout, np.random.default_rng(5)
    n = layout.n
    nothing = np.zeros((n + 1, n + 1))  # never touched, so it takes no memory
    nothing.setflags(write=False)
    return Calibration(
        instrument="LARGE",
        date=START,
        date_end=START,
        method="ml",
        scale="mean 1",
        layout=layout,
        loads=(),
        alpha=random.normal(1.0, 0.03, n),
        reading_error=np.full(n, 0.005),
        systematic_error=np.zeros(n),
        cycle_error=np.full(n, np.nan),
        covariance=nothing,
        systematic_covariance=nothing,
        bias_force=BIAS,
        torque_y=np.empty(0),
        torque_x=np.empty(0),
        weight=float("nan"),
        weight_error=float("nan"),
        temperature=20.0,
        shapes_used=n - 3,
        rejected=0,
        invalid=0,
        condition=10.0,
        rank=n - 1,
        noise=float("nan"),
        degrees_of_freedom=None,
        chi2=float("nan"),
        sources=(),
    )


def _each(campaign, change):
    return Campaign(tuple(replace(c, force=change(c.force)) for c in campaign.cycles))


def _times(force, actuator, factor):
    force = force.copy()
    force[:, actuator] *= factor
    return force
