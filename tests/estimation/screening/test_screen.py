"""What is said of noise after rows were left out."""

import numpy as np
import pytest

from helpers.changed import p45, with_forces
from truenewton.estimation.findings.code import Code
from truenewton.estimation.screening.screen import screen_campaign
from truenewton.records.campaign import Campaign


@pytest.mark.parametrize("seed", [0, 2])
def test_rows_that_were_left_out_are_no_noise_that_grows_with_the_force(seed):
    random = np.random.default_rng(seed)

    def with_spikes(_, force):
        return force * (1.0 + 0.5 * (random.random(force.shape) < 0.004))

    screened = screen_campaign(Campaign(tuple(with_forces(p45(5e-5, 3), with_spikes))))
    assert len(screened.rejected) > 90
    assert Code.NOISE_BY_FORCE not in [finding.code for finding in screened.suspects]
