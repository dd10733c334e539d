"""A campaign that nothing stopped, for comparison; and no waiting for the disk."""

import os
import shutil

import pytest

import truenewton as tn
from helpers.acquisition_plans import contents, small_plan
from helpers.stub_bench import StubBench


@pytest.fixture(autouse=True)
def quick(monkeypatch):
    """Wait for no disk: the study of killed acquisitions does."""
    monkeypatch.setattr(os, "fsync", lambda handle: None)


@pytest.fixture(scope="session")
def whole_folder(tmp_path_factory):
    """Take the campaign of the small plan; never changed."""
    folder = tmp_path_factory.mktemp("whole") / "campaign"
    tn.acquire(StubBench(), small_plan(), folder)
    return folder


@pytest.fixture(scope="session")
def whole(whole_folder):
    """Return what it holds."""
    return contents(whole_folder)


@pytest.fixture
def complete(whole_folder, tmp_path):
    """Return a copy of it, to be changed."""
    return shutil.copytree(whole_folder, tmp_path / "c")
