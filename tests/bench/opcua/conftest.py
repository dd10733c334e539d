"""One server for all: it takes seconds to start."""

import pytest

from helpers.opcua_server import RecordingBench, behind, free_port


@pytest.fixture(scope="session")
def served(keys_folder):
    """Serve a recording bench from another thread; give it and its address."""
    bench = RecordingBench()
    with behind(bench, keys_folder, free_port()) as address:
        yield bench, address


@pytest.fixture
def recorder(served):
    """Give the same, as it was made, with nothing on record yet."""
    served[0].renew()
    return served
