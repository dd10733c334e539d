"""What maximum likelihood reports besides alpha: whether it is worth loading, a wrong FORCERR."""

from dataclasses import replace

import numpy as np
import pytest

import truenewton as tn
from helpers.small_bench import SmallBench
from truenewton.errors import TrueNewtonWarning
from truenewton.records.campaign import Campaign


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


@pytest.mark.parametrize(("times", "code"), [
    (0.1, "noise-above-declared"), (1 / 3, "noise-above-declared"),
    (3.0, "noise-below-declared"), (10.0, "noise-below-declared"),
])  # fmt: skip
def test_a_wrong_forcerr_of_a_single_cycle_is_named_and_does_no_harm(times, code):
    """Shapes repeat over loads and signs, which shows the noise; positions were 'found'."""

    def made(declared):
        cycles = SmallBench(1, 1e-3, order=(0, 1)).campaign().cycles
        return Campaign(tuple(replace(c, force_error=declared) for c in cycles))

    right, wrong = tn.calibrate(made(1e-3)), tn.calibrate(made(times * 1e-3))
    [finding] = [e for e in wrong.findings if str(e.code).startswith("noise")]
    assert finding.code == code
    assert finding.values["ratio"] == pytest.approx(1 / times, rel=0.1)
    assert finding.values["noise"] == pytest.approx(1.0, rel=0.1)
    assert wrong.verdict.level == right.verdict.level == "usable"
    assert wrong.statistical_error == pytest.approx(right.statistical_error, rel=0.1)
    assert not wrong.effects


def test_a_real_effect_in_a_single_cycle_is_no_wrong_forcerr():
    bench = SmallBench(1, 1e-4, order=(0, 1))
    bench.law = lambda c: 1 + 0.02 * c
    cycles = (replace(c, force_error=1e-4) for c in bench.campaign().cycles)
    effects = tn.calibrate(Campaign(tuple(cycles))).effects
    assert [(each.code, each.corrected) for each in effects] == [("quadratic-coil", True)]
