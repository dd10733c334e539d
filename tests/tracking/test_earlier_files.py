"""Calibration and tracking files that `recalibrate` and `track` are given: checked on reading."""

import dataclasses

import numpy as np
import pytest
from astropy.io import fits

import truenewton as tn
from helpers.tracked import MEAN_K, SPREAD_K, campaign_at, drawn

K = np.random.default_rng(11).normal(MEAN_K, SPREAD_K, 45)


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """Return a folder with a run, two calibrations and a tracking file."""
    folder = tmp_path_factory.mktemp("earlier")
    run = campaign_at(np.ones(45), np.random.default_rng(1), cycles=1, loads=1)
    tn.write_campaign(run.cycles, folder / "run")
    days = drawn(1, K)
    for day in (0, 1):
        days[day].write(folder / f"calibration-{day}.fits")
    tn.track(*days).write(folder / "tracking.fits")
    return folder


def put(table, column, value, row=0):
    """Return a fault: a value of a column, or of a keyword of the first header."""

    def fault(hdus):
        if table == 0:
            hdus[0].header[column] = value
        else:
            hdus[table].data[column][row] = value

    return fault


def element(image, place, value):
    def fault(hdus):
        hdus[image].data[place] = value

    return fault


def correlated(hdus):
    matrix = hdus["SYSTEMATIC"].data
    matrix[0, 1] = matrix[1, 0] = 1.5 * np.sqrt(matrix[0, 0] * matrix[1, 1])


def larger_than_the_whole(hdus):
    hdus["SYSTEMATIC"].data *= 1.01


def without_temperature(hdus):
    del hdus[0].header["TEMPERAT"]


COVARIANCES = [
    (correlated, "SYSTEMATIC is not positive semi-definite"),
    (larger_than_the_whole, "COVARIANCE less SYSTEMATIC is not positive semi-definite"),
    (element("COVARIANCE", (0, 1), 0.01), "COVARIANCE is not symmetric"),
    (element("SYSTEMATIC", (2, 2), np.inf), "SYSTEMATIC is infinite"),
    (element("COVARIANCE", (3, 3), 1e155), "COVARIANCE holds absurd or negative variances"),
    (element("COVARIANCE", (0, 1), np.nan), "COVARIANCE holds NaN among numbers"),
]
CALIBRATIONS = [
    (put("CALIBRATION", "ALPHA", np.nan, slice(None)), "ALPHA"),
    (put("CALIBRATION", "ALPHA", 5e-324), "ALPHA"),
    (put("CALIBRATION", "ALPHA", 1e300), "ALPHA"),
    (put("LOADS", "TILT", np.inf), "TILT is inf deg"),
    (put("LOADS", "ADDED", -np.inf), "ADDED is -inf N"),
    (put("LOADS", "E_ADDED", np.nan), "E_ADDED is nan"),
    (put("LOADS", "MY", np.nan), "BIAS, MY or MX is no number"),
    (put("BUDGET", "RELATIVE", np.nan), "RELATIVE of BUDGET holds NaN or inf"),
    (put("CALIBRATION", "E_CYCLE", 1e200), "E_CYCLE of CALIBRATION is 1e+200"),
    (put("CALIBRATION", "E_STAT", 0.1), "E_STAT and E_SYST are not those of the covariances"),
    (put(0, "SCALE", "weight"), "SCALE is 'weight'; it is weights, given, mean 1"),
    (put(0, "WEIGHT", 0.0), "WEIGHT or E_WEIGHT has the wrong sign"),
    (put(0, "NOISE", 1e300), "NOISE is 1e+300"),
]
LAWS = [
    (put("TRACKING", "ALPHA", np.nan, slice(None)), "ALPHA"),
    (put("TRACKING", "ALPHA", 5e-324), "ALPHA"),
    (put("TRACKING", "K", np.inf), "K contains no usable"),
    (put("TRACKING", "DRIFT", np.nan), "DRIFT contains no usable"),
    (without_temperature, "TEMPERAT is missing"),
    (put("DAYS", "TEMPERATURE", np.nan, 1), "TEMPERATURE of DAYS"),
    (put("DAYS", "DATE", "yesterday"), "DATE in DAYS"),
    (put("FAMILIES", "EFFECT", "humidity"), "EFFECT is humidity"),
    (put(0, "SCATTER", -0.001), "SCATTER is negative"),
]
FAULTS = [
    *(("track", "calibration-0", *fault) for fault in COVARIANCES + CALIBRATIONS),
    ("recalibrate", "calibration-0", *CALIBRATIONS[0]),
    *(("recalibrate", "tracking", *fault) for fault in COVARIANCES + LAWS),
]


@pytest.mark.parametrize(("command", "name", "change", "said"), FAULTS)
def test_a_damaged_file_is_refused(inside, written, tmp_path, command, name, change, said):
    """What was changed in it leaves its checksums right."""
    bad = tmp_path / "bad.fits"
    with fits.open(written / f"{name}.fits") as hdus:
        change(hdus)
        hdus.writeto(bad, checksum=True)
    given = {
        "track": (bad, written / "calibration-1.fits"),
        "recalibrate": (written / "run", "--known", bad, "--actuators", "auto"),
    }
    err = inside.refuses(command, *given[command], "-o", tmp_path / "out.fits")
    assert err.startswith(f"truenewton: {bad}: "), err
    assert said in err, err
    assert not (tmp_path / "out.fits").exists()


def test_a_calibration_without_temperature_is_taken_and_said(inside, written, tmp_path):
    calibration = tn.read(written / "calibration-0.fits")
    dataclasses.replace(calibration, temperature=np.nan).write(tmp_path / "cold.fits")
    code, out, err = inside("recalibrate", written / "run", "--known", tmp_path / "cold.fits",
                            "--actuators", "auto")  # fmt: skip
    assert (code, err) == (0, "")
    assert "Not all temperatures are recorded" in out
    err = inside.refuses("track", tmp_path / "cold.fits", written / "calibration-1.fits")
    assert "cold.fits: has no temperature" in err
