"""Each constant that decides about reciprocity: a case just below, and a case just above."""

from helpers.thresholds import below_and_above
from truenewton.estimation.findings.code import Code
from truenewton.estimation.reciprocity.acceptance import Evidence, refusals


def refused(**evidence):
    return [each.code for each in refusals(Evidence(**evidence))]


def of_errors(error, ratio):
    """Both are contradicted if reciprocity is useless and ml far better, and they differ."""
    codes = refused(error=error, error_by_balance=ratio * error, as_stated=100.0)
    return codes == [Code.BALANCE_CONTRADICTS_SYMMETRY]


CASES = [
    ("MAX_HELD_OUT_RATIO", lambda x: refused(held_out=x, by_balance=1.0),
     1.14, [], 1.16, [Code.HELD_OUT_WORSE]),
    ("MAX_CHI2_BETWEEN", lambda x: refused(apart=x), 5.9, [], 6.1, [Code.ESTIMATES_APART]),
    ("MAX_BLOCK_CHI2", lambda x: refused(blocks=(x,)), 1.4, [], 1.6, [Code.EQUATIONS_MISFIT]),
    ("MAX_OFFSET_SPREAD", lambda x: refused(offset_spread=x),
     1.1e-3, [], 1.3e-3, [Code.SENSORS_FAR]),
    ("SENSELESS_ERROR", lambda x: of_errors(x, 0.01), 0.09, False, 0.11, True),
    ("SURE_ERROR_RATIO", lambda x: of_errors(0.5, x), 0.029, True, 0.031, False),
]  # fmt: skip


@below_and_above(CASES)
def test_a_threshold_is_between(function, below, at_below, above, at_above):
    assert function(below) == at_below
    assert function(above) == at_above
