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


def correlated(matrix):
    matrix[0, 1] = matrix[1, 0] = 1.5 * np.sqrt(matrix[0, 0] * matrix[1, 1])


def put(place, value):
    def fault(matrix):
        matrix[place] = value

    return fault


MATRIX = {
    "is not symmetric": put((0, 1), 0.01),
    "is not positive semi-definite": correlated,
    "is infinite": put((2, 2), np.inf),
    "holds absurd or negative variances": put((3, 3), 1e155),
    "holds NaN among numbers": put((0, 1), np.nan),
}
EXTENSION = {"calibration": "CALIBRATION", "tracking": "TRACKING"}


def refused(inside, written, tmp_path, kind, change, *words):
    """Change a file, leave its checksums right, and see it refused by whatever takes it."""
    name = "calibration-0" if kind == "calibration" else kind
    with fits.open(written / f"{name}.fits") as hdus:
        change(hdus)
        hdus.writeto(tmp_path / "bad.fits", checksum=True)
    commands = [("recalibrate", written / "run", "--known", tmp_path / "bad.fits",
                 "--actuators", "auto")]  # fmt: skip
    if kind == "calibration":
        commands.append(("track", tmp_path / "bad.fits", written / "calibration-1.fits"))
    for command in commands:
        code, out, err = inside(*command, "-o", tmp_path / "out.fits")
        assert (code, out, err.count("\n")) == (2, "", 1), (command[0], err)
        assert err.startswith(f"truenewton: {tmp_path / 'bad.fits'}: "), err
        for word in words:
            assert word in err, (command[0], err)
        assert not (tmp_path / "out.fits").exists()


@pytest.mark.parametrize("kind", ["calibration", "tracking"])
@pytest.mark.parametrize("image", ["COVARIANCE", "SYSTEMATIC"])
@pytest.mark.parametrize("fault", MATRIX)
def test_a_covariance_that_is_none_is_refused(inside, written, tmp_path, kind, image, fault):
    def change(hdus):
        MATRIX[fault](hdus[image].data)

    remedy = "calibrate again" if kind == "calibration" else "track again"
    refused(inside, written, tmp_path, kind, change, f"{image} {fault}", remedy)


@pytest.mark.parametrize("kind", ["calibration", "tracking"])
def test_a_systematic_part_larger_than_the_whole_is_refused(inside, written, tmp_path, kind):
    def change(hdus):
        hdus["SYSTEMATIC"].data *= 1.01

    said = "COVARIANCE less SYSTEMATIC is not positive semi-definite"
    refused(inside, written, tmp_path, kind, change, said, "again")


@pytest.mark.parametrize("kind", ["calibration", "tracking"])
@pytest.mark.parametrize("alpha", [np.nan, 5e-324, 1e300])
def test_alpha_of_no_use_is_refused(inside, written, tmp_path, kind, alpha):
    def change(hdus):
        hdus[EXTENSION[kind]].data["ALPHA"][slice(None) if np.isnan(alpha) else 4] = alpha

    refused(inside, written, tmp_path, kind, change, "ALPHA", "again")


@pytest.mark.parametrize("column", ["K", "DRIFT", "SCATTER"])
@pytest.mark.parametrize("value", [np.inf, np.nan])
def test_a_law_without_numbers_is_refused(inside, written, tmp_path, column, value):
    def change(hdus):
        hdus["TRACKING"].data[column][4] = value

    refused(inside, written, tmp_path, "tracking", change, f"{column} holds no usable", "track")


@pytest.mark.parametrize(
    ("table", "column", "value", "said"),
    [
        ("LOADS", "TILT", np.inf, "TILT is inf deg"),
        ("LOADS", "ADDED", -np.inf, "ADDED is -inf N"),
        ("LOADS", "E_ADDED", np.nan, "E_ADDED is nan"),
        ("LOADS", "MY", np.nan, "BIAS, MY or MX is no number"),
        ("BUDGET", "RELATIVE", np.nan, "RELATIVE of BUDGET holds NaN or inf"),
        ("CALIBRATION", "E_CYCLE", 1e200, "E_CYCLE of CALIBRATION is 1e+200"),
        ("CALIBRATION", "E_STAT", 0.1, "E_STAT and E_SYST are not those of the covariances"),
        (0, "SCALE", "weight", "SCALE is 'weight'; it is weights, given, mean 1"),
        (0, "WEIGHT", 0.0, "WEIGHT or E_WEIGHT has the wrong sign"),
        (0, "NOISE", 1e300, "NOISE is 1e+300"),
    ],
)
def test_what_no_calibration_can_hold_is_refused(inside, written, tmp_path, table, column, value,
                                                 said):  # fmt: skip
    def change(hdus):
        if table == 0:
            hdus[0].header[column] = value
        else:
            hdus[table].data[column][0] = value

    refused(inside, written, tmp_path, "calibration", change, said)


def without_temperature(hdus):
    del hdus[0].header["TEMPERAT"]


def without_that_of_a_day(hdus):
    hdus["DAYS"].data["TEMPERATURE"][1] = np.nan


def of_another_effect(hdus):
    hdus["FAMILIES"].data["EFFECT"][0] = "humidity"


def negative_scatter(hdus):
    hdus[0].header["SCATTER"] = -0.001


def no_date(hdus):
    hdus["DAYS"].data["DATE"][0] = "yesterday"


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (without_temperature, "TEMPERAT is missing"),
        (without_that_of_a_day, "TEMPERATURE of DAYS"),
        (of_another_effect, "EFFECT is humidity"),
        (negative_scatter, "SCATTER is negative"),
        (no_date, "DATE in DAYS"),
    ],
)
def test_a_law_that_lacks_what_it_needs_is_refused(inside, written, tmp_path, change, said):
    refused(inside, written, tmp_path, "tracking", change, said)


def test_a_calibration_without_temperature_is_taken_and_said(inside, written, tmp_path):
    calibration = tn.read(written / "calibration-0.fits")
    dataclasses.replace(calibration, temperature=np.nan).write(tmp_path / "cold.fits")
    code, out, err = inside("recalibrate", written / "run", "--known", tmp_path / "cold.fits",
                            "--actuators", "auto")  # fmt: skip
    assert (code, err) == (0, "")
    assert "The temperatures are not all known" in out
    code, _, err = inside("track", tmp_path / "cold.fits", written / "calibration-1.fits")
    assert code == 2
    assert "cold.fits: holds no temperature" in err
