"""Each constant that decides about effects: a case just below, and a case just above."""

from types import SimpleNamespace
from unittest import mock

from helpers.thresholds import between
from truenewton.estimation.effects import examination
from truenewton.estimation.effects.examination import _entered, _similar

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
        mock.patch.object(examination, "new_part", return_value=made),
        mock.patch.object(examination, "replace", lambda one, **_: one),
        mock.patch.object(examination, "joined", return_value=NS(parts=(made,), at=None)),
    ):
        return _entered(None, None, (), test) is not None


CASES = [
    ("MAX_SIMILAR", tried, 3, 3, 5, 4),
    ("SIMILAR_LOG_PROBABILITY", similar, 0.84, 1, 0.86, 2),
    ("MIN_GAIN", supported, 3.9, False, 4.1, True),
]

test_a_threshold_is_between = between(CASES)
