"""Damaged files: a named refusal or the right result, and nothing else.

Mutations, the same in every run, of sound cycle files without checksums. An oracle that
shares no code with the package says what is right: astropy for the file, E written out row by row
for the balance, numpy's least squares for the solution.
"""

import dataclasses
import random
import warnings
from collections import Counter

import astropy.units as u
import numpy as np
import pytest
from astropy.io import fits

from helpers.spoiled import bytes_of, fits_cards
from truenewton.calibration.methods import calibrate
from truenewton.errors import TrueNewtonError
from truenewton.reading import read_data
from truenewton.records.file import write_cycle

# --- sound files ----------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def sound(tiny, tmp_path_factory):
    """The two files of a sound campaign, without CHECKSUM and DATASUM."""
    path, files = tmp_path_factory.mktemp("sound") / "c.fits", []
    for cycle in tiny.cycles:
        valid, force = cycle.valid.copy(), cycle.force.copy()
        valid[[6, 17]], force[6], force[17, 3] = False, np.nan, 1e300
        write_cycle(dataclasses.replace(cycle, valid=valid, force=force), path, overwrite=True)
        with fits.open(path) as hdus:
            for hdu in hdus:
                del hdu.header["CHECKSUM"], hdu.header["DATASUM"]
            hdus.writeto(path, overwrite=True)
        files.append(path.read_bytes())
    return tuple(files)


# --- the oracle -----------------------------------------------------------------------------------


def column(hdu, name, unit=None, default=None):
    names = [n.upper() for n in hdu.columns.names]
    if name not in names and default is not None:
        return np.full(len(hdu.data), default)
    values = np.array(hdu.data.field(names.index(name)))
    if unit is None:
        return values
    declared = u.Unit(hdu.columns[names.index(name)].unit)
    return u.Quantity(values.astype(float), declared).to_value(unit)


def equations(path):
    """Return LOAD, the arms of the enabled actuators, W, and the valid rows of forces."""
    with warnings.catch_warnings(action="ignore"), fits.open(path) as hdus:
        header, actuators, table = hdus[0].header, hdus["ACTUATORS"], hdus["MEASUREMENTS"]
        on = column(actuators, "ENABLED", default=True)
        arms = [column(actuators, "NZ", default=1.0)]
        arms += [column(actuators, name, "m") for name in ("X", "Y")]
        force = column(table, "FORCE", "N").reshape(len(table.data), -1)
        force = force[column(table, "VALID", default=True)][:, on]
        tilt = header.get("TILT", 0.0)
        cosine = np.cos(np.radians(tilt if isinstance(tilt, int | float) else 0.0))
        weight = (header["WEIGHT"] + header["ADDED"]) * cosine
        return header["LOAD"].strip().casefold(), np.array(arms)[:, on], weight, force


def oracle(files):
    """Return alpha and B from E alpha' = r, one equation after the other."""
    rows, right_side, loads = [], [], sorted({load for load, *_ in files})
    for load, arms, weight, force in files:
        for c in force:
            for axis, known in enumerate((weight, 0.0, 0.0)):
                others = np.zeros(1 + 2 * len(loads))  # B, and M_y, -M_x of each load
                others[0 if axis == 0 else 2 * loads.index(load) + axis] = 1.0
                rows.append([*(arms[axis] * c), *others])
                right_side.append(-known)
    return np.linalg.lstsq(np.array(rows), np.array(right_side), rcond=None)[0][: len(arms[0]) + 1]


def judge(changed, other, other_equations):
    """Read and calibrate; say 'refused' or 'right', and fail for anything else."""
    try:
        calibration = calibrate(read_data(changed, other), "svd")
    except TrueNewtonError as error:
        return "refused" if error.remedy and "\n" not in str(error) else repr(error)
    want = oracle([equations(changed), other_equations])
    got = np.append(calibration.alpha[calibration.layout.enabled], calibration.bias_force)
    assert np.abs(got - want).max() <= 1e-7 * np.abs(want).max()
    return "right"


# --- mutations ------------------------------------------------------------------------------------


@pytest.mark.parametrize("examples", [80, pytest.param(600, marks=pytest.mark.study)])
def test_a_mutated_file_is_refused_or_gives_the_right_result(sound, tmp_path, examples):
    paths, judgements = (tmp_path / "bare.fits", tmp_path / "ring.fits"), Counter()
    for path, raw in zip(paths, sound, strict=True):
        path.write_bytes(raw)
    right = tuple(map(equations, paths))
    for seed in range(examples):
        pick = random.Random(seed)
        which = pick.randrange(2)
        for _ in range(pick.choice((1, 1, 2))):
            pick.choice((fits_cards, bytes_of))(pick, paths[which])
        judgements[judge(paths[which], paths[1 - which], right[1 - which])] += 1
        paths[which].write_bytes(sound[which])
    assert set(judgements) == {"refused", "right"}
    assert judgements["refused"] >= 0.3 * examples
    assert judgements["right"] >= 0.1 * examples
