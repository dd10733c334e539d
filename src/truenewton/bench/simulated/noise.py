"""Random numbers of the rows: each has its own, so that rows can be taken again in any order."""

from __future__ import annotations

import zlib

import numpy as np

STATIC, LOOP = 1, 2  # streams, beside that from which the truth is drawn
SAMPLES = 2048  # of a reading [conf]


def row_noise(
    seed: int, load: str, cycle: int, shape: int, sign: int, stream: int = LOOP
) -> np.random.Generator:
    """Return the noise of one row, which its labels alone decide; of the load its key."""
    return np.random.default_rng([seed, stream, zlib.crc32(load.encode()), cycle, shape, sign + 1])
