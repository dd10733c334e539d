"""A matrix comes back as it was stored: sign, unit, order, orientation and sensors, times alpha."""

from dataclasses import replace
from functools import cache, partial

import numpy as np
import pytest
from astropy.io import fits

import truenewton as tn
from helpers.balanced import p45_matrix
from helpers.foreign_files import N, measured, supervisor_folder
from truenewton.errors import CampaignMismatch, FormatError
from truenewton.importers.stored import read_stored
from truenewton.records.stiffness_matrix import StoredAs

CASE = measured()
ORDER = np.random.default_rng(3).permutation(N)  # of the channels
STORED = 1e-6 * CASE.k[np.ix_(ORDER, ORDER)]  # negative, N/um, with the gains of its sensors
IDS = 100 + ORDER


@cache
def made(**options):
    """Return the import of the stored matrix with some options."""
    values = STORED.T if options.get("transpose") else STORED
    at = replace(CASE.layout, id=100 + np.arange(N))
    return tn.stiffness_from(values, at, ids=IDS.tolist(), unit="N/um", instrument="M", **options)


@cache
def calibrated():
    return tn.calibrate(made().matrix, "svd")


def written(tmp_path, matrix):
    tn.write_stiffness(matrix, tmp_path / "ff.fits")
    return tmp_path / "ff.fits"


def with_alpha(alpha):
    """Return the calibration with other alpha of its actuators, and the factors of all rows."""
    found = calibrated()
    known = np.isfinite(found.alpha)
    return replace(found, alpha=np.where(known, alpha, np.nan)), np.where(known, alpha, 1.0)


def with_layout(calibration, layout):
    return replace(calibration, layout=replace(layout, enabled=calibration.layout.enabled))


export = partial(tn.export_matrix, accept_rejected=True)


@pytest.mark.parametrize("ending", ["npy", "NPY", "fits", "csv", "mat"])
def test_a_stored_matrix_comes_back_in_its_own_convention(tmp_path, ending):
    """Import, calibrate, export: rows times alpha, and nothing else has changed."""
    calibration, source = calibrated(), written(tmp_path, made().matrix)
    lines = export(source, calibration, tmp_path / f"new.{ending}")
    [item] = read_stored(tmp_path / f"new.{ending}").arrays.values()
    alpha = np.where(np.isfinite(calibration.alpha), calibration.alpha, 1.0)
    assert np.ptp(alpha) > 0.1
    assert np.array_equal(calibration.layout.id, IDS)
    np.testing.assert_allclose(item.values, alpha[:, None] * STORED, rtol=1e-14)
    assert f"{N} x {N}, unit N/um, negative diagonal, actuators in rows" in lines[1]
    export(source, with_alpha(1.0)[0], tmp_path / f"same.{ending}")
    [item] = read_stored(tmp_path / f"same.{ending}").arrays.values()
    np.testing.assert_allclose(item.values, STORED, rtol=1e-14)


def test_the_unit_is_that_of_the_file_and_a_transposed_one_is_transposed_again(tmp_path):
    random = np.random.default_rng(1)
    calibration, factors = with_alpha(random.normal(1.0, 0.1, N))
    source = written(tmp_path, made(transpose=True).matrix)
    lines = export(source, calibration, tmp_path / "new.fits")
    with fits.open(tmp_path / "new.fits") as hdus:
        np.testing.assert_allclose(hdus[0].data.T, factors[:, None] * STORED, rtol=1e-14)
        assert hdus[0].header["BUNIT"] == "N/um"
        assert hdus[0].header["CONTENT"].endswith("forces in columns")
    assert "each column of the matrix" in lines[0]
    steps = tn.stiffness_from(STORED, CASE.layout.part(ORDER), unit="unknown", instrument="M")
    assert np.median(np.diag(steps.matrix.stiffness)[~CASE.off[ORDER]]) == pytest.approx(1e6)
    (tmp_path / "steps").mkdir()
    by_id = with_layout(with_alpha(1.0)[0], steps.matrix.layout)
    export(written(tmp_path / "steps", steps.matrix), by_id, tmp_path / "steps.fits")
    with fits.open(tmp_path / "steps.fits") as hdus:
        np.testing.assert_allclose(hdus[0].data, STORED, rtol=1e-14)
        assert "BUNIT" not in hdus[0].header


def test_rows_without_an_actuator_stay_where_they_are(tmp_path):
    """Rows that are off and have no position are left out of the stiffness file."""
    whole, there = np.zeros((N + 2, N + 2)), np.delete(np.arange(N + 2), [3, 20])
    whole[np.ix_(there, there)] = STORED
    x, y = np.full((2, N + 2), np.nan)
    x[there], y[there] = CASE.layout.x[ORDER], CASE.layout.y[ORDER]
    short = tn.stiffness_from(whole, np.stack([x, y]), unit="N/um", lengths="m", instrument="M")
    assert short.matrix.layout.n == N
    calibration, factors = with_alpha(2.0)
    calibration = with_layout(calibration, short.matrix.layout)
    export(written(tmp_path, short.matrix), calibration, tmp_path / "new.npy")
    whole[there] *= factors[:, None]
    np.testing.assert_allclose(np.load(tmp_path / "new.npy"), whole, rtol=1e-14)


def test_a_folder_of_opticalib_is_exported_as_it_is_imported(tmp_path, inside):
    folder = tmp_path / "conf"
    folder.mkdir()
    fits.PrimaryHDU(np.float32(1e6 * STORED)).writeto(folder / "ff_matrix.fits")
    at = 1e3 * np.stack([CASE.layout.x, CASE.layout.y])[:, ORDER]
    fits.PrimaryHDU(at.T).writeto(folder / "ActuatorsCoordinates.fits")
    matrix = tn.stiffness_from(folder).matrix
    calibration, factors = with_alpha(np.random.default_rng(1).normal(1.0, 0.1, N))
    calibration = replace(with_layout(calibration, matrix.layout), instrument=matrix.instrument)
    calibration.write(tmp_path / "alpha.fits")
    command = "export", folder, "--calibration", tmp_path / "alpha.fits", "--anyway", "-o"
    assert "unit N/m, negative diagonal" in inside.prints(*command, tmp_path / "new")
    with fits.open(tmp_path / "new" / "ff_matrix.fits") as hdus:
        expected = factors[:, None] * np.float32(1e6 * STORED)
        np.testing.assert_allclose(hdus[0].data, expected, rtol=1e-14)
    assert "MULTIPLIED by alpha" in (tmp_path / "new" / "README.txt").read_text()
    assert sorted(each.name for each in (tmp_path / "new").iterdir()) == [
        "README.txt", "ff_matrix.fits",
    ]  # fmt: skip
    (folder / "ActuatorsCoordinates.fits").unlink()
    err = inside.refuses(*command, tmp_path / "other")
    assert "has no positions; give the stiffness file that `truenewton import` wrote" in err


def test_a_supervisors_matrix_can_also_be_one_file(tmp_path):
    supervisor_folder(tmp_path / "meas", positions="coordinates")
    old = fits.getdata(tmp_path / "meas" / "ff_matrix.fits")
    calibration = tn.calibrate(tn.stiffness_from(tmp_path / "meas").matrix, "svd")
    lines = export(tmp_path / "meas", calibration, tmp_path / "new.npy")
    known = np.where(np.isfinite(calibration.alpha), calibration.alpha, 1.0)
    np.testing.assert_allclose(np.load(tmp_path / "new.npy"), known[:, None] * old, rtol=1e-14)
    assert "39 channels" in lines[0]
    assert not any("track number" in line for line in lines)


def test_what_cannot_be_written_back_is_refused_in_one_line(tmp_path):
    calibration, source = calibrated(), written(tmp_path, made().matrix)
    np.save(tmp_path / "k.npy", STORED)
    tn.write_stiffness(replace(made().matrix, stored=None), tmp_path / "own.fits")
    moved = replace(calibration.layout, x=calibration.layout.x[::-1])
    for error, said, given, alpha, output in (
        (FormatError, "no name for a matrix; use a name that ends in .npy, .fits",
         source, calibration, "new"),
        (Exception, "give the stiffness file that `truenewton import` wrote", tmp_path / "k.npy",
         calibration, "new.npy"),
        (FormatError, "was not imported", tmp_path / "own.fits", calibration, "new.npy"),
        (CampaignMismatch, "of M, the calibration of P45", source,
         replace(calibration, instrument="P45"), "new.npy"),
        (CampaignMismatch, "disagree on X of actuator", source,
         replace(calibration, layout=moved), "new.npy"),
    ):  # fmt: skip
        with pytest.raises(error, match=said):
            export(given, alpha, tmp_path / output)
        assert not (tmp_path / output).exists()


@pytest.mark.parametrize(
    ("change", "said"),
    [({"factor": 0.0}, "STORFACT is 0"), ({"rows": np.array([0, 0])}, "does not number rows")],
)
def test_a_wrong_record_of_the_file_is_refused(change, said):
    sound = {"factor": -1e6, "unit": "N/um", "transposed": False, "rows": np.arange(2), "size": 2}
    with pytest.raises(FormatError, match=said):
        StoredAs(**sound | change)


def test_the_record_of_the_file_is_kept(tmp_path):
    for matrix in (made().matrix, p45_matrix()[0]):
        again = tn.read_stiffness(written(tmp_path, matrix)).stored
        if matrix.stored is None:
            assert again is None
            continue
        assert {k: v for k, v in vars(again).items() if k != "rows"} == {
            k: v for k, v in vars(matrix.stored).items() if k != "rows"
        }
        np.testing.assert_array_equal(again.rows, matrix.stored.rows)
        assert matrix.stored.factor == pytest.approx(-1e6, rel=1e-15)
        (tmp_path / "ff.fits").unlink()
