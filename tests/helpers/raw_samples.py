"""Streams of raw samples, made of cycles."""

import numpy as np
import pytest

import truenewton as tn


def stream(cycle, path, *, per_row=40, way=7, noise=1e-3, seed=1):
    """Write raw samples of each row of a cycle, on their way between; return them, by row."""
    h5py = pytest.importorskip("h5py", reason="h5py, extra `hdf5`, is missing")
    random = np.random.default_rng(seed)
    number = per_row + random.integers(0, 9, len(cycle.time))
    held = np.repeat(np.arange(len(number)), number + way)
    place = np.concatenate([np.arange(m + way) for m in number])
    moving, wide = place < way, (len(held), cycle.layout.n)
    samples = {"TIME": 1e-3 * np.arange(len(held))}
    samples["SHAPE"] = np.where(moving, 0, cycle.shape[held])
    samples["SIGN"] = np.where(moving, 0, cycle.sign[held])
    samples["FORCE"] = cycle.force[held] + noise * random.standard_normal(wide)
    samples["FORCE"][moving] += 50.0
    samples["VALID"] = cycle.valid[held]
    samples["POSITION"] = 1e-8 * random.standard_normal(wide)
    tn.write_cycle(cycle, path, overwrite=True)
    units = {"TIME": "s", "FORCE": "N", "POSITION": "m"}
    with h5py.File(path, "r+") as file:
        del file["MEASUREMENTS"]
        for name, values in samples.items():
            file.create_dataset(f"SAMPLES/{name}", data=values, fletcher32=True, chunks=True)
            if name in units:
                file[f"SAMPLES/{name}"].attrs["unit"] = units[name]
    rows = [np.flatnonzero((held == k) & ~moving) for k in np.flatnonzero(cycle.valid)]
    return samples, rows
