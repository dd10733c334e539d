"""Each constant that decides about reciprocity: a case just below, and a case just above."""

from types import SimpleNamespace
from unittest import mock

import numpy as np

from helpers.thresholds import between, outcome
from truenewton.estimation.findings.code import Code
from truenewton.estimation.reciprocity import matrix, noise, regression
from truenewton.estimation.reciprocity.acceptance import Evidence, refusals


def refused(**evidence):
    return [each.code for each in refusals(Evidence(**evidence))]


def of_errors(error, ratio):
    """Both are contradicted if reciprocity is useless and ml far better, and they differ."""
    codes = refused(error=error, error_by_balance=ratio * error, as_stated=100.0)
    return codes == [Code.BALANCE_CONTRADICTS_SYMMETRY]


def unheld(amplitude):
    square = np.diag(np.append(np.ones(5), amplitude**2))
    return outcome(lambda: regression.refuse_unheld(square))


def judges_noise_by_misfit(spare):
    """Shapes in excess of 20 actuators."""
    groups, n = 21 + spare, 20
    random = np.random.default_rng(1)
    moments = SimpleNamespace(
        displacement=random.standard_normal((groups, n)), weight=np.ones(groups),
        mean=random.standard_normal((groups, n)), of_load=np.ones((groups, 1)), groups=groups,
        loads=(0,), repeats=0,
    )  # fmt: skip
    with mock.patch.object(regression, "noise_of_rows") as judged:
        regression.regressed(moments, np.ones(n))
    return judged.called


def odd_actuators(worst, usual):
    """Asymmetry of the rows of 20 actuators, 1 without one of them."""
    first = np.append(np.full(19, usual), worst)

    def asymmetry(stiffness, _):
        return first if len(stiffness) == 20 else np.ones(len(stiffness))

    with mock.patch.object(regression, "_asymmetry", asymmetry):
        return len(regression.odd_actuators(np.ones((20, 20)) + 9.0 * np.eye(20)))


def is_beyond_noise(square, large_draws=0):
    """The square of a difference; of 1000 draws of noise some have 100, the others 1."""
    drawn = np.where(np.arange(1000) < large_draws, 10.0, 1.0)[:, None]
    fits = [
        SimpleNamespace(
            values=SimpleNamespace(log_alpha=np.array([each])),
            covariance_of=lambda _: np.eye(1),
        )
        for each in (np.sqrt(square), 0.0)
    ]
    with mock.patch.object(noise, "_by_size", return_value=(np.ones(1), np.eye(1))):
        return noise.beyond_noise(fits, drawn, alike=True, doubtful=False) > 1.0


def offsets_make_doubtful(spread):
    """Sensors off their magnets, without a model of the glass."""
    joint = SimpleNamespace(
        asked=None, values=None, point=mock.MagicMock(), of_alpha=SimpleNamespace(
            asked=SimpleNamespace(offset_spread=spread), values=None, point=mock.MagicMock()
        )
    )  # fmt: skip
    modes = mock.MagicMock(places=SimpleNamespace(changes=None))
    with (
        mock.patch.multiple(
            matrix, in_double=lambda fit: fit, stated_errors=lambda *_: (None, None),
            replace=mock.DEFAULT, drawn_differences=mock.DEFAULT, report_progress=mock.DEFAULT,
        ),
        mock.patch.object(matrix, "beyond_noise", side_effect=InterruptedError) as judged,
    ):  # fmt: skip
        try:
            matrix.examined(modes, joint, None)
        except InterruptedError:
            return judged.call_args.kwargs["doubtful"]


CASES = [
    ("AT_MAGNETS_OFFSET", offsets_make_doubtful, 4.9e-5, False, 5.1e-5, True),
    ("MIN_AMPLITUDE", unheld, 0.9e-5, "refused", 1.1e-5, "accepted"),
    ("MIN_SPARE_SHAPES", judges_noise_by_misfit, 4, False, 5, True),
    ("MAX_ROW_ASYMMETRY", lambda x: odd_actuators(x, 1.0), 3.9, 0, 4.1, 1),
    ("MIN_ASYMMETRY_RATIO", lambda x: odd_actuators(x, x), 1.9, 0, 2.1, 1),
    ("UNCERTAIN_VARIANCE_FACTOR", is_beyond_noise, 1.4, False, 1.6, True),
    ("RARE_DRAW_FRACTION", lambda k: is_beyond_noise(9.0, k), 8, True, 12, False),
    ("MAX_HELD_OUT_RATIO", lambda x: refused(held_out=x, by_balance=1.0),
     1.14, [], 1.16, [Code.HELD_OUT_WORSE]),
    ("MAX_CHI2_BETWEEN", lambda x: refused(apart=x), 5.9, [], 6.1, [Code.ESTIMATES_APART]),
    ("MAX_BLOCK_CHI2", lambda x: refused(blocks=(x,)), 1.4, [], 1.6, [Code.EQUATIONS_MISFIT]),
    ("MAX_OFFSET_SPREAD", lambda x: refused(offset_spread=x),
     1.1e-3, [], 1.3e-3, [Code.SENSORS_FAR]),
    ("SENSELESS_ERROR", lambda x: of_errors(x, 0.01), 0.09, False, 0.11, True),
    ("SURE_ERROR_RATIO", lambda x: of_errors(0.5, x), 0.029, True, 0.031, False),
]  # fmt: skip

test_a_threshold_is_between = between(CASES)
