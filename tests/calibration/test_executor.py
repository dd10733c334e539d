"""Campaigns calibrated by the workers of an executor: the same results, and the same errors."""

import pickle

import numpy as np
import pytest

import truenewton as tn
from helpers.balanced import campaign_of
from truenewton import errors
from truenewton.errors import RankDeficient, TrueNewtonError


def test_errors_cross_from_machine_to_machine():
    kinds = [each for each in vars(errors).values() if isinstance(each, type)]
    kinds = [each for each in kinds if issubclass(each, TrueNewtonError)]
    assert len(kinds) > 10
    for kind in kinds:
        one = kind("is\nwrong", remedy="mend it", path="c.fits")
        other = pickle.loads(pickle.dumps(one))
        assert type(other) is kind
        assert str(other) == str(one) == "c.fits: is\\nwrong; mend it"
        assert vars(other) == vars(one)


def test_a_dask_cluster_calibrates_one_campaign_on_each_worker(tmp_path):
    distributed = pytest.importorskip("distributed")
    folders = [tmp_path / f"night-{k}" for k in (1, 2)]
    for k, folder in enumerate(folders):
        tn.write_campaign(campaign_of(seed=k, noise=1e-4)[0], folder)
    with (
        distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, processes=True, dashboard_address=":0"
        ) as local,
        distributed.Client(local, set_as_default=False) as client,
    ):
        workers = client.get_executor()
        for folder, found in zip(folders, workers.map(tn.calibrate, folders), strict=True):
            assert np.array_equal(found.alpha, tn.calibrate(folder).alpha)
        with pytest.raises(RankDeficient, match="there is only one load"):
            list(workers.map(tn.calibrate, [folders[0] / "bare-001.fits"]))
