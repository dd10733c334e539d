"""Each constant that decides about data: a case just below, and a case just above."""

from dataclasses import make_dataclass
from types import SimpleNamespace
from unittest import mock

import numpy as np

from helpers.thresholds import between, outcome
from truenewton.recalibration import fit, prior
from truenewton.tracking.lines import Scatter

N = 20


def limits(probability):
    """Limits beside the one on temperatures, which are unknown here."""
    known = SimpleNamespace(temperature=np.nan, temperatures=None)
    return len(list(fit._limits(known, SimpleNamespace(cycles=()), probability, 0.0))) - 1


def moved(count):
    """Actuators of which each is found by 100 sigma in its turn."""
    far = np.where(np.arange(N) < count, 100.0, 0.0)
    layout = SimpleNamespace(id=np.arange(N), enabled=np.ones(N, dtype=bool))
    problem = SimpleNamespace(
        campaign=SimpleNamespace(layout=layout),
        fitted=lambda *_: SimpleNamespace(values=None),
    )

    def residuals(problem, minimum, stay):
        return SimpleNamespace(sigmas=far * stay, variance=np.ones(N), scatter=Scatter())

    with (
        mock.patch.object(fit, "constrain", lambda problem, *_: problem),
        mock.patch.object(fit, "prior_residuals", residuals),
    ):
        minimum, stay = SimpleNamespace(values=None), np.ones(N, dtype=bool)
        known = SimpleNamespace(name="earlier")
        return outcome(lambda: fit._find_moved(problem, known, None, minimum, stay))


def loose_prior():
    """The information of the prior in which every actuator may have moved, alpha = 1."""
    given = make_dataclass("Prior", ["mean", "information"])(np.ones(N), None)
    posed = make_dataclass("Problem", ["prior", "n"])(given, N)
    screened, seen = SimpleNamespace(moments=None), []

    def balancing_groups(problem, moments):
        seen.append(problem.prior.information)
        raise InterruptedError

    with mock.patch.object(prior, "balancing_groups", balancing_groups):
        try:
            prior.balancing(posed, None, screened, np.zeros(N, dtype=bool))
        except InterruptedError:
            return np.linalg.inv(seen[0])
    raise AssertionError


def moves_by(size):
    """Whether an actuator may move by more than a size, one sigma."""
    contrast = np.eye(N)[0] - np.eye(N)[1]
    return bool(contrast @ loose_prior() @ contrast / 2 > size**2)


def scale_moves_by(size):
    mean = np.full(N, 1 / N)
    return bool(mean @ loose_prior() @ mean > size**2)


def contrasts(information):
    """Of two actuators, about one of which a run has little information, in units of the prior."""
    run = np.array([information, 1.0])
    inverse = np.diag(1.0 / (1.0 + run))
    problem = SimpleNamespace(
        n=2, prior=SimpleNamespace(information=np.eye(2), mean=np.ones(2), held=False)
    )
    minimum = SimpleNamespace(
        values=np.ones(2), information=np.diag(1.0 + run), reading_covariance=inverse,
        changes=np.zeros((2, 1)),
    )  # fmt: skip
    return prior.prior_residuals(problem, minimum, np.ones(2, dtype=bool)).contrasts.size


CASES = [
    ("MIN_PROBABILITY", limits, 0.9e-3, 1, 1.1e-3, 0),
    ("MAX_MOVED_FRACTION", moved, 5, "accepted", 6, "refused"),
    ("LOOSE_ERROR", moves_by, 0.19, True, 0.21, False),
    ("SCALE_ERROR", scale_moves_by, 0.9e-4, True, 1.1e-4, False),
    ("MIN_VARIANCE", contrasts, 0.9e-6, 1, 1.1e-6, 2),
]

test_a_threshold_is_between = between(CASES)
