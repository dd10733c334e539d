"""Each constant that decides about a plan: a case just below, and a case just above."""

from helpers.thresholds import between
from truenewton.acquisition.plan import CampaignPlan
from truenewton.planning.plan_prediction import _more_cycles, _tilted
from truenewton.statics.load import Load

PLAN = CampaignPlan("p45", (Load("bare"), Load("ring", -0.289, 0.005, tool="ring")))
TILTED = [change["loads"][-1] for _, change in _tilted(PLAN)]


def tilt_is_tried(tilt):
    return any(load.tilt == tilt for load in TILTED)


def tilt_is_known_to(error):
    return TILTED[0].tilt_error < error


def cycles_are_tried(cycles):
    return any(change["cycles"] == cycles for _, change in _more_cycles(PLAN))


CASES = [
    ("MAX_CYCLES", cycles_are_tried, 999, True, 1000, False),
    ("MAX_TILT", tilt_is_tried, 60, True, 61, False),
    ("TILT_ERROR", tilt_is_known_to, 0.09, False, 0.11, True),
]

test_a_threshold_is_between = between(CASES)
