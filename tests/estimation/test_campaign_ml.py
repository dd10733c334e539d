"""What maximum likelihood reports besides alpha: whether it is worth loading."""

import numpy as np
import pytest

import truenewton as tn
from helpers.small_bench import SmallBench
from truenewton.errors import TrueNewtonWarning


def alike(seed, noise, scatter=0.01):
    """Return a campaign of actuators whose alpha scatters little, and its alpha."""
    bench = SmallBench(seed, noise)
    bench.alpha = 1.0 + scatter * bench.random.standard_normal(bench.n)
    return bench.campaign(), bench.alpha


@pytest.mark.filterwarnings("ignore::truenewton.errors.TrueNewtonWarning")
@pytest.mark.parametrize("seed", range(3))
def test_an_alpha_that_is_worse_than_uniform_is_doubtful(seed):
    """Each alpha was known to 4 %, all scatter by 1 %, and the result was usable."""
    campaign, alpha = alike(seed, 0.07)
    found = tn.calibrate(campaign)
    [finding] = [e for e in found.findings if e.code is tn.Code.WORSE_THAN_UNIFORM]
    assert found.verdict.level == "doubtful"
    relative = found.alpha / found.alpha.mean() / alpha
    assert finding.values["error"] == pytest.approx(np.std(relative), rel=0.6)
    assert np.std(relative) > np.std(alpha)
    promised = float(finding.remedy.split(" %")[0].split()[-1]) / 100
    pulled = tn.calibrate(campaign, population=True)
    covariance = (pulled.covariance - pulled.systematic_covariance)[:14, :14]
    centred = np.eye(14) - 1 / 14  # without the common scale
    error = np.sqrt(np.median(np.diag(centred @ covariance @ centred))) / pulled.alpha.mean()
    assert promised == pytest.approx(error, rel=0.05)
    assert promised < finding.values["error"]
    assert tn.Code.WORSE_THAN_UNIFORM not in {e.code for e in pulled.findings}


def test_an_alpha_that_is_better_than_uniform_is_not_doubtful(recwarn):
    for seed in range(3):
        found = tn.calibrate(alike(seed, 1e-3)[0])
        assert found.verdict.level == "usable"
    assert not [each for each in recwarn if each.category is TrueNewtonWarning]
