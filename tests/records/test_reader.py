"""Files that workers of a cluster open."""

import gzip

import pytest

from truenewton.errors import FormatError
from truenewton.records.reader import open_by_worker


def test_a_worker_refuses_a_gzipped_file_of_which_it_cannot_read_parts(p45_folder, tmp_path):
    packed = tmp_path / "bare-001.fits.gz"
    packed.write_bytes(gzip.compress((p45_folder / "bare-001.fits").read_bytes()))
    with pytest.raises(FormatError, match=r"^there\.fits\.gz: is gzipped"):
        open_by_worker((str(packed), "there.fits.gz")).require_cycle()
