"""Each constant that decides about effects: a case just below, and a case just above."""

from types import SimpleNamespace
from unittest import mock

import numpy as np

from helpers.thresholds import between
from truenewton.estimation.effects import examination, joint
from truenewton.estimation.effects.catalogue import significant_tests
from truenewton.estimation.effects.examination import _corrected, _entered, _similar

NS = SimpleNamespace


def likely(*log_probabilities):
    effect = NS(code="some")
    derivative = NS(count=1)
    return [
        NS(effect=effect, derivative=derivative, log_probability=each) for each in log_probabilities
    ]


def similar(ratio):
    return len(_similar(likely(-100.0, -100.0 * ratio)))


def tried(count):
    return len(_similar(likely(*[-100.0] * count)))


def supported(gain):
    """One effect of a gain is put beside nothing."""
    made = NS(effect="one", gain=gain)
    test = NS(effect="one", derivative=NS(count=1), log_probability=0.0)
    with (
        mock.patch.object(examination, "scored", return_value=NS(score=0, variance=0)),
        mock.patch.object(examination, "new_part", return_value=made),
        mock.patch.object(examination, "replace", lambda one, **_: one),
        mock.patch.object(examination, "joined", return_value=NS(parts=(made,), at=None)),
    ):
        return _entered(None, None, (), test) is not None


def looked_at(chance):
    """The likeliest effect, which is not significant, is put into the fit to see."""
    [test] = likely(np.log(chance))
    seen = []
    start = NS(rows=NS(), effects=(), fits=True)
    with (
        mock.patch.object(examination, "free_effects", return_value=()),
        mock.patch.object(examination, "effect_tests", side_effect=[[test], []]),
        mock.patch.object(examination, "unknown_force", return_value=None),
        mock.patch.object(examination, "_entered", side_effect=lambda *_: seen.append(1)),
    ):
        assert not significant_tests([test])
        _corrected(start, independent=True, samples=np.empty((0, 1)))
    return bool(seen)


def free(square):
    """An effect of one parameter moves alpha, of variance 1, by a square per its variance."""
    effect = NS(corrected=lambda _: True, derivative=lambda _: NS(of_each=None, count=1))
    fit = NS(problem=NS(n=1), minimum=NS(reading_covariance=np.eye(1)))
    result = NS(information=np.eye(1), moves=np.array([[np.sqrt(square)]]), whole=np.ones(1))
    with (
        mock.patch.object(joint, "CATALOGUE", (effect,)),
        mock.patch.object(joint, "scored", return_value=result),
        mock.patch.object(joint, "free_part", return_value=None),
    ):
        return len(joint.free_effects(fit))


CASES = [
    ("MAX_SIMILAR", tried, 3, 3, 5, 4),
    ("SIMILAR_LOG_PROBABILITY", similar, 0.84, 1, 0.86, 2),
    ("MIN_GAIN", supported, 3.9, False, 4.1, True),
    ("MAX_CHANCE", looked_at, 0.099, True, 0.101, False),
    ("MAX_PRICE", free, 1.019**2 - 1, 1, 1.021**2 - 1, 0),
]

test_a_threshold_is_between = between(CASES)
