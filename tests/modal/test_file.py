"""Plain matrices of the modal basis: what electronics read, in the convention of their own file."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from astropy.io import fits

import truenewton as tn
from helpers.balanced import p45_bench
from truenewton.bench.simulated.static import run_cycles
from truenewton.estimation.findings.estimate import Sensor
from truenewton.estimation.reciprocity.sensor_model import Values, places_of, sensors_at
from truenewton.mirrors.known import p45
from truenewton.modal.true_stiffness import true_stiffness
from truenewton.records.campaign import Campaign

ORDER = np.random.default_rng(4).permutation(45)  # of the channels
OFFSET = 5e-4 * np.random.default_rng(3).standard_normal((2, 45))


@cache
def known():
    """Return a true stiffness, the true displacement of readings, and a calibration."""
    bench = p45_bench()
    k = 0.5 * (bench.truth.stiffness + bench.truth.stiffness.T) - 31 * np.eye(45)
    gain = np.random.default_rng(5).normal(1.0, 0.02, 45)
    values = Values(np.zeros(45), np.log(gain), OFFSET)
    moved = sensors_at(places_of(p45().layout), values, slopes=True).motion * gain
    calibration = tn.calibrate(Campaign(tuple(run_cycles(bench, 1))), "svd")
    sensors = tuple(
        Sensor(i, g, 1e-3, x, 1e-5, y, 1e-5, "fitted")
        for i, g, (x, y) in zip(range(1, 46), gain, OFFSET.T, strict=True)
    )
    return k, moved, replace(calibration, alpha=bench.truth.alpha, sensors=sensors)


@pytest.mark.parametrize("transposed", [False, True])
def test_a_feed_forward_is_in_the_convention_of_the_imported_file(tmp_path, transposed):
    """Negative, N/um, channels in their order, per reading: the stored matrix comes back."""
    k, moved, calibration = known()
    stored = -1e-6 * (k @ moved / calibration.alpha[:, None])[np.ix_(ORDER, ORDER)]
    assert np.diag(stored).max() < 0.0
    at = p45().layout.part(ORDER)
    given = stored.T if transposed else stored
    made = tn.stiffness_from(given, at, unit="N/um", transpose=transposed, instrument="P45")
    tn.write_stiffness(made.matrix, tmp_path / "ff.fits")
    found = tn.find_modes(tn.read_stiffness(tmp_path / "ff.fits"), calibration)
    files = {path.name: path for path in tn.write_modes(found, tmp_path / "m.fits")}
    alpha, tiny = calibration.alpha[ORDER, None], 1e-9 * np.abs(stored).max()
    for name, wanted in {
        "m.ff_matrix.fits": stored,
        "m.ff_matrix_true.fits": alpha * stored,
    }.items():
        with fits.open(files[name]) as hdus:
            data, header = hdus[0].data, hdus[0].header
        np.testing.assert_allclose(data.T if transposed else data, wanted, atol=tiny)
        assert (header["BUNIT"], header["SIGN"], header["DISPLACE"]) == ("N/um", -1, "read")
        axes = ["SENSOR", "ACTUATOR"]
        assert [header["CTYPE1"], header["CTYPE2"]] == (axes[::-1] if transposed else axes)
        with pytest.raises(tn.errors.FormatError, match="plain matrix of a modal basis"):
            tn.read(files[name])
    readings = fits.getdata(files["m.ff_v_matrix.fits"])
    modes = fits.getdata(files["m.fits"], "MODES")
    np.testing.assert_allclose(moved @ readings[np.argsort(ORDER)], modes[np.argsort(ORDER)],
                               atol=1e-9)  # fmt: skip


def test_cycles_have_no_other_convention(tmp_path):
    """Positive forces per reading, N/m: the measured matrix made symmetric, and the header."""
    bench = p45_bench()
    found = tn.find_modes(Campaign(tuple(run_cycles(bench, 1))))
    files = tn.write_modes(found, tmp_path / "m.fits")
    with fits.open(files[4]) as hdus:
        data, header = hdus[0].data, hdus[0].header
    measured = found.measured.matrix.stiffness
    assert np.linalg.norm(data - measured) < 0.01 * np.linalg.norm(measured)
    assert (header["BUNIT"], header["SIGN"], header["DISPLACE"]) == ("N/m", 1, "read")


def test_forces_per_reading_are_exact_with_actuators_off_that_float():
    k, moved, calibration = known()
    at = p45().layout
    matrix = tn.StiffnessMatrix("P45", calibration.date, at, k @ moved / calibration.alpha[:, None])
    off = np.isin(at.id, (3, 17, 44))
    found = true_stiffness(matrix, calibration, off=(3, 17, 44), slaved=(20,))
    z = np.zeros(45)
    z[~off] = np.random.default_rng(6).standard_normal(42)
    z[off] = -np.linalg.solve(k[np.ix_(off, off)], k[np.ix_(off, ~off)] @ z[~off])
    readings = np.where(off, 1e9, np.linalg.solve(moved, z))
    per_reading = found.per_reading(found.acting_stiffness)
    np.testing.assert_allclose(per_reading @ readings, k @ z, atol=1e-7 * np.abs(k @ z).max())
