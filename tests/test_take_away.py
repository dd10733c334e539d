"""What people take away: files for other programs, figures that show, results that read well."""

import json
import re

import numpy as np
import pytest
from astropy.table import QTable, Table
from balanced import campaign_of, p45_campaign
from matplotlib import pyplot

import truenewton as tn
from truenewton.errors import OutputFailed
from truenewton.report.figures import still_figures

NAMES = ["ID", "X", "Y", "ALPHA", "E_ALPHA", "E_STAT", "E_SYST", "E_CYCLE"]


@pytest.fixture(scope="module")
def campaign():
    return campaign_of(seed=1, noise=1e-4, disabled=(4,))[0]


@pytest.fixture(scope="module")
def calibration(campaign):
    return tn.calibrate(campaign)


def columns(calibration):
    c = calibration
    return [c.layout.id, c.layout.x, c.layout.y, c.alpha, c.error, c.reading_error,
            c.systematic_error, c.cycle_error]  # fmt: skip


@pytest.mark.parametrize("suffix", [".csv", ".ecsv"])
def test_a_table_holds_every_digit(calibration, tmp_path, suffix):
    path = tmp_path / f"alpha{suffix}"
    calibration.write(path)
    table = Table.read(path)
    assert table.colnames == NAMES
    for name, values in zip(NAMES, columns(calibration), strict=True):
        assert np.array_equal(table[name], values, equal_nan=name != "ID"), name
    assert np.isnan(table["ALPHA"]).sum() == 1


def test_a_csv_is_read_without_astropy(calibration, tmp_path):
    calibration.write(tmp_path / "alpha.csv")
    lines = (tmp_path / "alpha.csv").read_text().splitlines()
    assert lines[0] == ",".join(NAMES)
    assert len(lines) == 1 + calibration.layout.n
    plain = np.genfromtxt(tmp_path / "alpha.csv", delimiter=",", names=True)
    assert np.array_equal(plain["ALPHA"], calibration.alpha, equal_nan=True)


def test_an_ecsv_tells_units_and_the_verdict(calibration, tmp_path):
    calibration.write(tmp_path / "alpha.ecsv")
    table = QTable.read(tmp_path / "alpha.ecsv")
    assert np.array_equal(table["X"].to_value("m"), calibration.layout.x)
    assert table.meta["VERDICT"] == str(calibration.verdict.level)
    assert table.meta["INSTRUME"] == calibration.instrument
    assert table.meta["WEIGHT"] == calibration.weight
    told = [fault for fault, _ in calibration.verdict.faults]
    faults = table.meta["FAULTS"]
    assert len(faults) == len(told) > 0
    assert all(
        text.startswith(fault) for text, fault in zip(table.meta["FAULTS"], told, strict=True)
    )


def test_npy_holds_alpha_alone(calibration, tmp_path):
    calibration.write(tmp_path / "alpha.npy")
    assert np.array_equal(np.load(tmp_path / "alpha.npy"), calibration.alpha, equal_nan=True)


def test_the_command_says_what_a_form_leaves_out(campaign, inside, tmp_path):
    tn.write_campaign(campaign.cycles, tmp_path / "day")
    for suffix in (".csv", ".ecsv", ".npy", ".fits"):
        code, out, _ = inside("calibrate", tmp_path / "day", "-o", tmp_path / f"a{suffix}")
        assert code == 0
        assert (tmp_path / f"a{suffix}").stat().st_size
        assert (f"a{suffix} holds" in out) == (suffix != ".fits")
    code, out, _ = inside(
        "calibrate", tmp_path / "day", "-o", tmp_path / "a.csv", "--json", "--overwrite"
    )
    assert code == 0
    assert json.loads(out)["verdict"]


@pytest.mark.parametrize("name", ["alpha.txt", "alpha", "alpha.csv.gz"])
def test_another_suffix_is_refused_before_anything_is_read(calibration, inside, tmp_path, name):
    said = "is no name for a calibration; let it end in .fits, .fits.gz, .ecsv, .csv, .npy"
    with pytest.raises(OutputFailed, match=re.escape(said)):
        calibration.write(tmp_path / name)
    code, _, err = inside("calibrate", tmp_path / "nowhere", "-o", tmp_path / name)
    assert code == 2
    assert said in err
    assert list(tmp_path.iterdir()) == []


def test_what_stands_is_kept(calibration, tmp_path):
    for suffix in (".csv", ".npy"):
        path = tmp_path / f"alpha{suffix}"
        path.write_text("mine")
        with pytest.raises(tn.errors.OutputExists):
            calibration.write(path)
        assert path.read_text() == "mine"
        calibration.write(path, overwrite=True)
    assert {path.name for path in tmp_path.iterdir()} == {"alpha.csv", "alpha.npy"}


def test_what_a_user_draws_pyplot_shows(calibration):
    findings, change = tn.investigate(calibration), tn.change(calibration, calibration)
    calls = (
        calibration.plot_map, calibration.plot_actuators, change.plot_map, change.plot_actuators,
        lambda: findings.plot("map-leverage"),
    )  # fmt: skip
    for count, call in enumerate(calls, 1):
        ax = call()
        assert len(pyplot.get_fignums()) == count
        assert pyplot.gcf() is ax.figure
    mine = pyplot.figure().add_subplot()
    assert calibration.plot_map(mine) is mine
    assert len(pyplot.get_fignums()) == len(calls) + 1


def test_files_and_pages_leave_no_figure_open(tmp_path):
    findings = tn.investigate(p45_campaign(2))
    tn.write_report(tmp_path / "report.html", findings)
    assert "<svg" in (tmp_path / "report.html").read_text()
    tn.write_figures(findings.calibration, tmp_path / "figures", more=still_figures(findings))
    assert pyplot.get_fignums() == []
