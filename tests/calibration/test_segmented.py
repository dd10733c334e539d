"""A segment is calibrated as if it were alone; several at once by any executor."""

from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace

import numpy as np
import pytest

import truenewton as tn
from helpers.segmented import in_one, pieces
from truenewton.estimation.findings.code import Level
from truenewton.records.file import write_campaign
from truenewton.statics.arms import enabled_arms


@pytest.fixture(scope="module")
def cycles():
    return in_one(pieces(3)[0])


@pytest.fixture(scope="module")
def folder(cycles, tmp_path_factory):
    path = tmp_path_factory.mktemp("segments") / "campaign"
    write_campaign(cycles, path)
    return path


def same(one, other):
    """Hold a calibration of a segment, its actuators in any order, against one of it alone."""
    order, there = np.argsort(one.layout.id), np.argsort(other.layout.id)
    for name in ("alpha", "error", "statistical_error", "systematic_error", "cycle_error"):
        mine, yours = getattr(one, name)[order], getattr(other, name)[there]
        assert mine == pytest.approx(yours, rel=1e-6, abs=1e-9), name
    for name in ("bias_force", "bias_force_error", "noise", "weight"):
        assert getattr(one, name) == pytest.approx(getattr(other, name), rel=1e-6), name
    assert one.torque_y == pytest.approx(other.torque_y, rel=1e-6, abs=1e-9)


def test_each_segment_is_calibrated_as_if_alone(folder):
    for number, (alone, truth) in enumerate(zip(*pieces(3), strict=True), 1):
        made = tn.calibrate(tn.read(folder, segment=number))
        same(made, tn.calibrate(alone))
        order = np.argsort(made.layout.id)
        assert np.abs((made.alpha[order] - truth[:14]) / made.error[order]).max() < 5.0


def test_three_bodies_taken_for_one_are_not_sound(cycles):
    """One B and one pair of torques for all of them."""
    whole = replace(cycles[0].layout, segment=None)
    joined = tuple(replace(c, layout=whole, segments=()) for c in cycles)
    assert tn.calibrate(tn.Campaign(joined)).verdict.level != Level.SOUND


def test_any_executor_calibrates_segments_at_the_same_time(folder):
    """Processes here, and the workers of a dask cluster: docs/campaign.md."""
    distributed = pytest.importorskip("distributed")
    segments = [tn.read(folder, segment=number) for number in (1, 2, 3)]
    alone = list(map(tn.calibrate, segments))
    with (
        distributed.LocalCluster(
            n_workers=1, threads_per_worker=1, processes=False, dashboard_address=":0"
        ) as cluster,
        distributed.Client(cluster, set_as_default=False) as client,
        ProcessPoolExecutor(1) as processes,
    ):
        for executor in (client.get_executor(), processes):
            for made, other in zip(executor.map(tn.calibrate, segments), alone, strict=True):
                assert np.array_equal(made.alpha, other.alpha)
                assert np.array_equal(made.covariance, other.covariance)
                assert made.verdict == other.verdict


@pytest.fixture(scope="module")
def two():
    """A stiffness of two segments, and of each alone."""
    random = np.random.default_rng(3)
    layout = tn.rings([0.05, 0.1], [6, 12])
    blocks = []
    for _ in range(2):
        a = enabled_arms(layout)
        out = np.eye(18) - np.linalg.pinv(a) @ a
        root = out @ random.standard_normal((18, 18))
        blocks.append(1e4 * root @ root.T / random.uniform(0.8, 1.2, 18)[:, None])
    n = 36
    stiffness = np.zeros((n, n))
    stiffness[:18, :18], stiffness[18:, 18:] = blocks
    both = tn.layout(
        np.concatenate([layout.x, layout.x + 0.5]),
        np.tile(layout.y, 2),
        segment=np.repeat([1, 2], 18),
    )
    date = pieces(1)[0][0].cycles[0].date
    alone = []
    for where, block in zip((slice(18), slice(18, 36)), blocks, strict=True):
        place = tn.layout(layout.x, layout.y, id=both.id[where])  # from its own middle
        alone.append(tn.StiffnessMatrix("ONE", date, place, block))
    return tn.StiffnessMatrix("TWO", date, both, stiffness), alone


def test_a_segment_of_a_stiffness_is_calibrated_as_if_alone(two):
    matrix, alone = two
    for number, one in enumerate(alone, 1):
        made, other = (tn.calibrate(k, "svd") for k in (matrix.of_segment(number), one))
        assert made.alpha == pytest.approx(other.alpha, rel=1e-7)
        assert tn.Code.SEGMENTS_COUPLED not in {each.code for each in made.findings}


@pytest.mark.parametrize("command", ["info", "calibrate"])
def test_a_segment_that_is_joined_to_another_is_reported(two, inside, tmp_path, command):
    matrix, random = two[0], np.random.default_rng(4)
    joined = matrix.stiffness.copy()
    link = 1e-3 * np.abs(joined).max() * random.standard_normal((18, 18))
    joined[:18, 18:], joined[18:, :18] = link, link.T
    tn.write_stiffness(replace(matrix, stiffness=joined), tmp_path / "k.fits")
    anyway = () if command == "info" else ("--anyway",)
    said = inside.prints(command, tmp_path / "k.fits", *anyway)
    assert said.count("The segment is coupled to others by ") == 2


def test_modes_of_a_segment_are_those_of_it_alone(two):
    matrix, alone = two
    for number, one in enumerate(alone, 1):
        asked = {"accept_rejected": True, "diameter": 2.13, "off": [int(one.layout.id[0])]}
        made, other = (tn.find_modes(k, **asked) for k in (matrix.of_segment(number), one))
        base = other.after.modes.stiffness
        assert made.after.modes.stiffness == pytest.approx(
            base, rel=1e-6, abs=1e-6 * np.abs(base).max()
        )
        assert made.after.costs[0].residual == pytest.approx(
            other.after.costs[0].residual, rel=1e-6
        )
