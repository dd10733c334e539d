"""What people take away: files for other programs, figures that show, results that read well."""

import ast
import datetime
import re
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import matplotlib as mpl
import numpy as np
import pytest
from astropy.table import QTable
from matplotlib import pyplot

import truenewton as tn
from helpers.balanced import campaign_of, p45_campaign
from truenewton.calibration import summary as calibration_summary
from truenewton.calibration.summary import warning_lines
from truenewton.errors import OutputFailed
from truenewton.modal import summary as modal_summary
from truenewton.tracking import summary as tracking_summary

ROOT = Path(__file__).parents[2]
NAMES = ["ID", "X", "Y", "ALPHA", "E_ALPHA", "E_STAT", "E_SYST", "E_CYCLE"]


@pytest.fixture(scope="module")
def campaign():
    return campaign_of(seed=1, noise=1e-4, disabled=(4,))[0]


@pytest.fixture(scope="module")
def calibration(campaign):
    return tn.calibrate(campaign)


def columns(calibration):
    c = calibration
    return [c.layout.id, c.layout.x, c.layout.y, c.alpha, c.error, c.statistical_error,
            c.systematic_error, c.cycle_error]  # fmt: skip


@pytest.mark.parametrize("suffix", [".csv", ".ecsv"])
def test_a_table_holds_every_digit(calibration, tmp_path, suffix):
    path = tmp_path / f"alpha{suffix}"
    calibration.write(path)
    table = QTable.read(path)
    assert table.colnames == NAMES
    for name, values in zip(NAMES, columns(calibration), strict=True):
        assert np.array_equal(np.asarray(table[name]), values, equal_nan=name != "ID"), name
    assert np.isnan(table["ALPHA"]).sum() == 1
    calibration.write(tmp_path / "alpha.npy")
    assert np.array_equal(np.load(tmp_path / "alpha.npy"), table["ALPHA"], equal_nan=True)
    if suffix == ".csv":  # without astropy
        plain = np.genfromtxt(path, delimiter=",", names=True)
        assert np.array_equal(plain["ALPHA"], table["ALPHA"], equal_nan=True)
        return
    assert table["X"].unit == "m"
    assert table.meta["VERDICT"] == str(calibration.verdict.level)
    assert table.meta["INSTRUME"] == calibration.instrument
    assert table.meta["WEIGHT"] == calibration.weight
    told = [each.fault for each in calibration.verdict.faults]
    assert len(told) > 0
    assert all(fault[1:] in text for text, fault in zip(table.meta["FAULTS"], told, strict=True))


def test_the_command_says_what_a_form_leaves_out(campaign, inside, tmp_path):
    tn.write_campaign(campaign, tmp_path / "day")
    for suffix in (".csv", ".fits"):
        words = "calibrate", tmp_path / "day", "-o", tmp_path / f"a{suffix}", "--method", "svd"
        assert (f"a{suffix} contains" in inside.prints(*words)) == (suffix != ".fits")


@pytest.mark.parametrize("name", ["alpha.txt", "alpha", "alpha.csv.gz"])
def test_another_suffix_is_refused_before_anything_is_read(calibration, inside, tmp_path, name):
    said = "is no name for a calibration; let it end in .fits, .fits.gz, .ecsv, .csv, .npy"
    with pytest.raises(OutputFailed, match=re.escape(said)):
        calibration.write(tmp_path / name)
    assert said in inside.refuses("calibrate", tmp_path / "nowhere", "-o", tmp_path / name)
    assert list(tmp_path.iterdir()) == []


def test_plots_of_a_result_are_figures_of_pyplot(calibration):
    findings, change = tn.investigate(calibration), tn.compare(calibration, calibration)
    calls = (
        calibration.plot, calibration.plot_actuators, change.plot, change.plot_actuators,
        lambda: findings.plot("map-leverage"),
    )  # fmt: skip
    for count, call in enumerate(calls, 1):
        ax = call()
        assert len(pyplot.get_fignums()) == count
        assert pyplot.gcf() is ax.figure
    mine = pyplot.figure().add_subplot()
    assert calibration.plot(ax=mine) is mine
    assert len(pyplot.get_fignums()) == len(calls) + 1


def test_what_a_backend_sets_up_stays(calibration, monkeypatch):
    """In Jupyter the first figure turns `interactive` on, without which no second one shows."""
    whole = pyplot.figure

    def first(**settings):
        mpl.rcParams["interactive"] = True
        return whole(**settings)

    with mpl.rc_context():
        assert not mpl.rcParams["interactive"]
        monkeypatch.setattr(pyplot, "figure", first)
        calibration.plot()
        assert mpl.rcParams["interactive"]


def text_of(html):
    """Return the words of HTML, which has to be well formed."""
    return " ".join(" ".join(ElementTree.fromstring(html).itertext()).split())


def test_a_notebook_shows_what_the_terminal_says(campaign, calibration):
    random = np.random.default_rng(1)
    scatter = np.nan_to_num(calibration.statistical_error)
    days = [
        replace(
            calibration,
            temperature=10.0 + k,
            date=start,
            date_end=start,
            sources=(),
            alpha=calibration.alpha + random.normal(0.0, scatter),
        )
        for k in range(4)
        for start in [calibration.date + datetime.timedelta(days=30 * k)]
    ]
    modes = tn.find_modes(p45_campaign(1))
    results = (
        (calibration, calibration_summary, list(warning_lines(calibration.verdict.faults))),
        (tn.track(*days), tracking_summary, ["no outliers"]),
        (modes, modal_summary, [f"verdict on alpha {modes.calibration.verdict}"]),
    )
    for result, words, more in results:
        shown = text_of(result._repr_html_())
        assert shown.startswith(words.headline(result))
        rows = [" ".join(" ".join(row).split()) for row in words.summary_rows(result) if row[1]]
        assert len(rows) > 2
        assert [row for row in (*rows, *more) if " ".join(row.split()) not in shown] == []
    shown = text_of(campaign._repr_html_())
    assert shown.startswith(repr(campaign)[1:-1])
    assert all(load.name in shown for load in campaign.loads)


def test_a_name_from_a_file_is_text_in_a_notebook(campaign):
    name = "<script>alert(1)</script>&"
    html = tn.Campaign(tuple(replace(c, instrument=name) for c in campaign))._repr_html_()
    assert "<script>" not in html
    assert name in text_of(html)


@pytest.fixture(scope="module")
def kinds(campaign, calibration, tmp_path_factory):
    """Return what reads each kind of file, with such a file."""
    folder = tmp_path_factory.mktemp("kinds")
    tn.write_campaign(campaign, folder / "day")
    calibration.write(folder / "alpha.fits")
    n = campaign.layout.n
    layout = replace(campaign.layout, enabled=np.ones(n, dtype=bool))
    matrix = tn.StiffnessMatrix(campaign.instrument, calibration.date, layout, np.eye(n))
    tn.write_stiffness(matrix, folder / "stiffness.fits")
    return {
        tn.read_campaign: (folder / "day", tn.Campaign),
        tn.read_calibration: (folder / "alpha.fits", tn.Calibration),
        tn.read_stiffness: (folder / "stiffness.fits", tn.StiffnessMatrix),
    }


def test_a_reader_of_one_kind_reads_it_and_names_the_others(kinds):
    for reader, (path, kind) in kinds.items():
        assert isinstance(reader(path), kind)
        for other in kinds.keys() - {reader}:
            with pytest.raises(tn.errors.FormatError) as refused:
                other(path)
            line = str(refused.value)
            assert line.startswith(f"{path}: is not a ")
            assert f"or read it with {reader.__name__} in Python" in line
            assert "\n" not in line


def test_paths_come_one_by_one_or_in_lists(campaign, kinds):
    folder, _ = kinds[tn.read_campaign]
    files = sorted(folder.iterdir())
    assert len(files) == len(campaign) == 4
    for given in ([files], [files[:2], files[2:]], [[str(files[0])], *files[1:]], files):
        read = tn.read(*given)
        assert [cycle.name for cycle in read] == [cycle.name for cycle in read.cycles]
        assert len(read) == 4
    assert len(tn.read_campaign(files[:2])) == 2


def test_pages_import_nothing_from_below():
    """A user needs `truenewton` alone; docs/effects.md tells who writes an effect, below."""
    pages = [ROOT / "README.md", *ROOT.glob("docs/*.md"), *ROOT.glob("docs/tutorials/*.md")]
    deep = [
        f"{page.name}: {line}"
        for page in pages
        if page.name != "effects.md"
        for line in re.findall(r"^ *(?:from|import) truenewton\..*", page.read_text(), re.MULTILINE)
    ]
    assert len(pages) > 20
    assert deep == []


def test_type_checkers_see_every_public_name():
    tree = ast.parse((ROOT / "src" / "truenewton" / "__init__.pyi").read_text())
    imports = [node for node in tree.body if isinstance(node, ast.ImportFrom)]
    assert [name.asname for node in imports for name in node.names] == tn.__all__
    assert all(getattr(tn, name) for name in tn.__all__)
