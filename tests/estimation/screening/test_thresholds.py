"""Each constant that decides about rows and files: a case just below, and a case just above."""

from types import SimpleNamespace
from unittest import mock

import numpy as np
import scipy.stats

from helpers.thresholds import between, outcome
from truenewton.chance import OF_EACH_KIND
from truenewton.errors import TooManyOutliers
from truenewton.estimation.findings.code import Code
from truenewton.estimation.readings.repeats import Prints, Scatter
from truenewton.estimation.screening import screen
from truenewton.estimation.screening.hypotheses import (
    _differences,
    _mislabelled,
    _nearly_alike,
    _other_labels,
    clusters,
    copied_files,
)
from truenewton.estimation.screening.screen import (
    Repeats,
    _worst_rows,
    refuse_too_many,
)
from truenewton.statics.arms import enabled_arms
from truenewton.statics.layout import rings

LAYOUT = rings([0.03, 0.07], [4, 8])


def campaign(*loads, weights=()):
    """Return files of loads, by their indices."""
    return SimpleNamespace(
        cycles=[SimpleNamespace(name=f"file {k}") for k in range(len(loads))],
        load_index=loads, effective_weights=np.array(weights), layout=LAYOUT,
        loads=[SimpleNamespace(name=f"load {k}") for k in range(len(weights))],
    )  # fmt: skip


def codes(findings):
    return [finding.code for finding in findings]


def form_clusters(within):
    """Two files at a distance, a third at 1 from both."""
    distance = np.array([[0.0, within, 1.0], [within, 0.0, 1.0], [1.0, 1.0, 0.0]])
    return clusters(distance, 2) is not None


def prints_of(difference, labels=16):
    """Of three files one differs by a fraction, orthogonal to the others in each column."""
    rows, _ = np.linalg.qr(np.random.default_rng(1).standard_normal((labels, 7)))
    rows, _ = np.linalg.qr(rows - rows.mean(axis=0))
    one, across = rows[:, :3], rows[:, 3:6]
    files = (one, one, one + difference * across)
    return [Prints(np.arange(1, labels + 1), force) for force in files]


def nearly_alike(labels):
    return _nearly_alike(campaign(0, 0, 0), prints_of(0.5, labels))


def unit_of(times):
    typical = np.random.default_rng(1).standard_normal((20, 5))
    return [each.code for each in _differences(times * typical, typical)]


def label_finding(reversed_rows, other_rows=0):
    """Of 20 rows some fit the label of the other sign, some the next shape."""
    others = np.random.default_rng(2).standard_normal((10, 40))
    others = np.concatenate([others, -others])
    labels = np.concatenate([np.arange(1, 11), -np.arange(1, 11)])
    said = labels.copy()
    said[:reversed_rows] *= -1
    moved = slice(reversed_rows, reversed_rows + other_rows)
    said[moved] = np.sign(said[moved]) * (np.abs(said[moved]) % 10 + 1)
    return _other_labels(others, said, others, labels)


def load_finding(alpha):
    """The second file is at rest as the last two; the loads differ by 1 N, forces by 1 / alpha."""
    sums = np.array([0.0, 1.0, 1.0, 1.0]) / alpha
    nz = enabled_arms(LAYOUT)[0]
    rest = sums[:, None] * nz / (nz @ nz)
    distance = np.abs(sums[:, None] - sums)
    files = campaign(0, 0, 1, 1, weights=(-2.0, -3.0))
    return codes(_mislabelled(files, rest, distance, np.array([0, 1, 1, 1])))


def load_of_two_names(ratio):
    distance = np.array([[0.0, ratio, ratio], [ratio, 0.0, 1.0], [ratio, 1.0, 0.0]])
    files = campaign(0, 1, 1, weights=(-3.0, -3.0))
    return codes(_mislabelled(files, np.zeros((3, 12)), distance, np.ones(3, dtype=int)))


def copied(*alike, in_steps=False):
    """Of 100 rows, the first file shares some with the second; both share some with a third."""
    files = len(alike) + 1
    force = np.random.default_rng(1).standard_normal((files, 100, 4))
    force[1, : alike[0]] = force[0, : alike[0]]
    force[:, 90 : 90 + sum(alike[1:])] = force[0, 90 : 90 + sum(alike[1:])]
    prints = [Prints(np.arange(1, 101), each) for each in force]
    return len(copied_files(campaign(*[0] * files), prints, in_steps=in_steps))


def left_out_of_a_tail(times):
    """A row at a multiple of the usual limit, if outliers are a tail."""
    moments = SimpleNamespace(
        repeats=10**9, rows=np.array([1000]), scatter=np.array([1e9]), rounding=np.zeros(1),
        mean=np.ones((1, 1)),
    )  # fmt: skip
    usual = scipy.stats.norm.isf(OF_EACH_KIND / 2 / 1000)
    far = np.array([times * usual])
    rows = SimpleNamespace(
        deviations=lambda: [(slice(0, 1), None, far[None])], distance_factor=np.ones(1),
        number=np.array([3]), group=[0], file=[0], row=[0],
    )  # fmt: skip
    samples = scipy.stats.norm.ppf(np.linspace(0.01, 0.99, 99))[:, None]
    one = LAYOUT.part(np.arange(LAYOUT.n) == 0)
    return len(_worst_rows(Repeats(rows, moments, Scatter(far, samples)), one, accidents=False))


class Stop(Exception):
    """Raised where a test needs no more of `screen_campaign`."""


def screened(rejected=(), tails=1.0, noise=1e-3, first=None, rows=100):
    """Screen a file of which rows were left out; return the calls that matter."""
    files = SimpleNamespace(cycles=[SimpleNamespace(valid=np.ones(rows, dtype=bool))])
    files = type("Files", (), {"cycles": files.cycles, "__len__": lambda _: 1})()
    moments = SimpleNamespace(rows=np.array([rows]), noise=noise, mean=np.ones(4))
    repeats = SimpleNamespace(rows=None, moments=moments, scatter=Scatter(None, ()))
    left_out = (repeats, files, [SimpleNamespace(cycle=0) for _ in rejected])
    nothing, relabelled = mock.Mock(return_value=()), mock.Mock(return_value=())
    with mock.patch.multiple(
        screen, prints_of=nothing, step_of=mock.Mock(return_value=0.0),
        _repeats_of=mock.Mock(return_value=repeats), compare_files=nothing,
        _displacement=mock.Mock(return_value=None),
        columns_of_other_rows=nothing, louder_with_force=nothing,
        replace=mock.Mock(return_value=moments),
        copied_files=nothing, mislabelled_files=nothing,
        _left_out=mock.Mock(side_effect=[first or left_out, left_out]),
        _tails=mock.Mock(return_value=tails), mislabelled_rows=relabelled,
        reading_noise=mock.Mock(side_effect=Stop),
    ):  # fmt: skip
        try:
            return screen.screen_campaign(files)
        except Stop:
            return screen._left_out.call_count, relabelled.called


def readings_are_tailed(ratio):
    return screened(rejected=(1,), tails=ratio)[0] == 2


def files_are_affected(rows):
    return screened(rejected=range(rows))[1]


def scatter_of_repeats(noise):
    refusal = TooManyOutliers("not one of its rows fits", remedy="")
    return outcome(lambda: screened(noise=noise, first=refusal))


SIGN, OTHER = Code.SIGN_REVERSED, Code.OTHER_LABELS
CASES = [
    ("MAX_SAME_DISTANCE", form_clusters, 0.29, True, 0.31, False),
    ("MIN_SHARED_LABELS", nearly_alike, 7, [], 8, [(0, 1)]),
    ("MIN_UNIT_FACTOR", unit_of, 1.9, [], 2.1, [Code.OTHER_UNIT]),
    ("MIN_RELABELLED_FRACTION", label_finding, 5, None, 6, SIGN),
    ("MIN_SAME_SHIFT_FRACTION", lambda k: label_finding(k, 10 - k), 8, OTHER, 9, SIGN),
    ("MAX_PLAUSIBLE_ALPHA", load_finding, 4.9, [Code.OTHER_LOAD], 5.1, []),
    ("INDISTINCT_RATIO", load_of_two_names, 1.4, [Code.LOAD_OF_TWO_NAMES], 1.6, []),
    ("MIN_IDENTICAL_FRACTION", copied, 19, 0, 20, 1),
    ("MIN_IDENTICAL_FRACTION_OF_STEPS", lambda k: copied(k, in_steps=True), 89, 0, 90, 1),
    ("MIN_RATIO_TO_OTHER_FILES", lambda k: copied(k, 10), 30, 0, 31, 1),
    ("MAX_REJECTED_FRACTION", lambda k: outcome(lambda: refuse_too_many(k, 100)),
     30, "accepted", 31, "refused"),
    ("LONG_TAIL_RATIO", readings_are_tailed, 1.07, False, 1.09, True),
    ("SYSTEMATIC_FRACTION", files_are_affected, 15, False, 16, True),
    ("GROSS_SCATTER", scatter_of_repeats, 0.019, "accepted", 0.021, "refused"),
    ("FAR_OUT_FACTOR", left_out_of_a_tail, 2.9, 0, 3.1, 1),
]  # fmt: skip

test_a_threshold_is_between = between(CASES)
