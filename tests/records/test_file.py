"""The three kinds of file: what is written is read back bit for bit, by us and by astropy."""

import dataclasses
import datetime
import hashlib
import warnings

import numpy as np
import pytest
from astropy.io import fits

from helpers.balanced import campaign_of
from helpers.comparison import same
from helpers.segmented import in_one, pieces
from truenewton.calibration.methods import calibrate
from truenewton.errors import FormatError, SeveralSegments
from truenewton.estimation.findings.estimate import Diagnosis
from truenewton.files.fits import read_fits
from truenewton.reading import read
from truenewton.records.campaign import Campaign
from truenewton.records.file import cycle_from, write_campaign, write_cycle, write_stiffness
from truenewton.records.stiffness_matrix import StiffnessMatrix
from truenewton.statics.layout import Layout
from truenewton.statics.load import Load


def edited(path, edit):
    """Rewrite a FITS file after an edit of its HDUs, with new checksums."""
    with fits.open(path) as hdus:
        for hdu in hdus:
            hdu.data  # noqa: B018 - astropy loads late
        edit(hdus)
        hdus.writeto(path, overwrite=True, checksum=True)


@pytest.fixture
def bare_file(tiny, tmp_path):
    write_cycle(tiny.cycles[0], tmp_path / "bare.fits")
    return tmp_path / "bare.fits"


@pytest.fixture
def full_cycle(tiny):
    """A cycle that uses all of the contract, with numbers that no decimal holds."""
    random = np.random.default_rng(3)
    enabled, valid = np.ones(12, dtype=bool), np.ones(24, dtype=bool)
    enabled[5], valid[[3, 4]] = False, False
    layout = Layout(
        id=random.permutation(1000)[:12],  # no order of ours
        x=tiny.layout.x,
        y=tiny.layout.y,
        nz=random.uniform(0.9, 1.0, 12),
        enabled=enabled,
    )
    force = tiny.cycles[1].force.copy()
    force[:, 5], force[3], force[4, 0] = np.nan, np.inf, 1e300
    return dataclasses.replace(
        tiny.cycles[1],
        layout=layout,
        valid=valid,
        force=force,
        date=datetime.datetime(2026, 5, 4, 9, 30, 7, 123457, tzinfo=datetime.UTC),
        number=41,
        weight=-np.pi,
        load=Load("Ring two", -1 / 3, 1e-3 / 7, "ring A", 1 / 7, 1 / 70, 1e-6 / 7, 1e-7 / 7),
        time=random.uniform(0, 100, 24),
        shape=random.permutation(24) + 1,
        coil_gradient=600.1,
        bias_gradient=-31.7,
        gap=68e-6 / 1.1,
        force_error=1e-4 / 3,
    )


def test_a_cycle_file_gives_every_bit_back(full_cycle, tmp_path):
    write_cycle(full_cycle, tmp_path / "c.fits")
    [cycle] = read(tmp_path / "c.fits").cycles
    assert same(cycle, full_cycle)
    assert cycle.source.file == str(tmp_path / "c.fits")


def test_what_a_cycle_does_not_know_is_neither_written_nor_read(tiny, tmp_path):
    cycle = dataclasses.replace(
        tiny.cycles[0], temperature=None, position=None, gap=float("nan"), coil_gradient=None
    )
    write_cycle(cycle, tmp_path / "c.fits")
    with fits.open(tmp_path / "c.fits") as hdus:
        absent = {"TOOL", "COILZ", "E_COILZ", "COILGRAD", "BIASGRAD", "GAP", "FORCERR"}
        assert not absent & set(hdus[0].header)
        assert hdus["MEASUREMENTS"].columns.names == ["TIME", "SHAPE", "SIGN", "FORCE", "VALID"]
    [back] = read(tmp_path / "c.fits").cycles
    assert same(back, dataclasses.replace(cycle, gap=None))
    assert back.load.tool is None


def test_a_stiffness_file_gives_every_bit_back_and_is_converted(tiny, tmp_path):
    stiffness = np.random.default_rng(1).standard_normal((12, 12)) * 1e5
    matrix = StiffnessMatrix("TINY", tiny.cycles[0].date, tiny.layout, stiffness)
    write_stiffness(matrix, tmp_path / "k.fits")
    assert same(read(tmp_path / "k.fits"), matrix)
    with fits.open(tmp_path / "k.fits") as hdus:
        assert hdus["STIFFNESS"].data[2, 9] == stiffness[2, 9]  # numpy order, actuator first
        assert hdus["STIFFNESS"].header["BUNIT"] == "N/m"

    def in_other_unit(hdus):
        hdus["STIFFNESS"].data *= 1e-3
        hdus["STIFFNESS"].header["BUNIT"] = "kN m-1"

    edited(tmp_path / "k.fits", in_other_unit)
    np.testing.assert_allclose(read(tmp_path / "k.fits").stiffness, stiffness, rtol=1e-14)


def contract(hdu):
    """Return names, types and units of a table's columns."""
    return [(c.name, c.format, c.unit) for c in hdu.columns]


def test_a_cycle_file_is_as_the_contract_says(full_cycle, tmp_path):
    write_cycle(full_cycle, tmp_path / "c.fits")
    with fits.open(tmp_path / "c.fits") as hdus:
        assert [hdu.name for hdu in hdus[1:]] == ["ACTUATORS", "MEASUREMENTS"]
        assert hdus[0].data is None
        header = hdus[0].header
        assert header["DATE-OBS"] == "2026-05-04T09:30:07.123457"
        wanted = {
            "INSTRUME": "TINY", "LOAD": "Ring two", "CYCLE": 41, "WEIGHT": -np.pi,
            "E_WEIGHT": 0.005, "ADDED": -1 / 3, "E_ADDED": 1e-3 / 7, "TOOL": "ring A",
            "TILT": 1 / 7, "E_TILT": 1 / 70, "COILZ": 1e-6 / 7, "E_COILZ": 1e-7 / 7,
            "COILGRAD": 600.1, "BIASGRAD": -31.7, "GAP": 68e-6 / 1.1, "FORCERR": 1e-4 / 3,
        }  # fmt: skip
        assert {key: header[key] for key in wanted} == wanted
        assert contract(hdus["MEASUREMENTS"]) == [
            ("TIME", "D", "s"), ("SHAPE", "J", None), ("SIGN", "J", None),
            ("TEMPERATURE", "D", "deg_C"), ("FORCE", "12D", "N"), ("POSITION", "12D", "m"),
            ("VALID", "L", None),
        ]  # fmt: skip


def test_a_calibration_file_is_as_the_contract_says_and_read_as_written(p45_folder, tmp_path):
    calibration = calibrate(read(p45_folder), "svd")
    calibration.write(tmp_path / "a.fits")
    with fits.open(tmp_path / "a.fits") as hdus:
        names = ["CALIBRATION", "LOADS", "COVARIANCE", "SYSTEMATIC", "SOURCES", "BUDGET"]
        assert [hdu.name for hdu in hdus[1:]] == names
        structure = {"SIMPLE", "BITPIX", "NAXIS", "EXTEND", "CHECKSUM", "DATASUM"}
        # DOF and CHI2 are absent: this method does not know them.
        assert set(hdus[0].header) - structure == {
            "INSTRUME", "DATE-OBS", "DATE-END", "TEMPERAT", "WEIGHT", "E_WEIGHT", "BIAS", "E_BIAS",
            "METHOD", "SCALE", "NSHAPES", "NREJECT", "NINVALID", "CONDITIO", "SOLVCOND", "RANK",
            "UNIQUE", "NOISE", "VERDICT",
        }  # fmt: skip
        assert hdus[0].header["DATE-OBS"] == "2026-01-01T09:00:00.000"
        assert hdus[0].header["TEMPERAT"] == 20.0
        assert (hdus[0].header["METHOD"], hdus[0].header["SCALE"]) == ("svd", "weights")
        table = hdus["CALIBRATION"]
        assert list(hdus["LOADS"].data["LOAD"]) == ["bare", "ring"]
        covariance, n = hdus["COVARIANCE"].data, 45
        assert covariance.shape == hdus["SYSTEMATIC"].data.shape == (50, 50)
        np.testing.assert_allclose(
            table.data["E_ALPHA"] ** 2, table.data["E_STAT"] ** 2 + table.data["E_SYST"] ** 2
        )
        np.testing.assert_allclose(np.diag(covariance)[:n], table.data["E_ALPHA"] ** 2)
        np.testing.assert_allclose(covariance[n, n], hdus[0].header["E_BIAS"] ** 2)
        np.testing.assert_allclose(
            np.diag(covariance)[n + 1 :].reshape(2, 2),
            np.transpose([hdus["LOADS"].data["E_MY"] ** 2, hdus["LOADS"].data["E_MX"] ** 2]),
        )
        sources = hdus["SOURCES"]
        files = sorted(p.name for p in p45_folder.iterdir())
        assert list(sources.data["FILE"]) == files
        digests = [hashlib.sha256((p45_folder / f).read_bytes()).hexdigest() for f in files]
        assert list(sources.data["SHA256"]) == digests
        assert list(sources.data["ROWS"]) == [90] * 4
        columns = [c for c in hdus["LOADS"].columns if c.name != "TOOL"]
        hdus["LOADS"] = fits.BinTableHDU.from_columns(columns, name="LOADS")
        hdus.writeto(tmp_path / "b.fits")
    table = calibration.table
    assert table["X"].unit == "m"
    np.testing.assert_array_equal(table["ALPHA"].value, calibration.alpha)
    assert same(read(tmp_path / "a.fits"), dataclasses.replace(calibration, diagnosis=Diagnosis()))
    assert [load.tool for load in read(tmp_path / "b.fits").loads] == [None, None]


def test_a_disabled_actuator_is_nan_in_the_calibration_file(tmp_path):
    calibration = calibrate(campaign_of(seed=1, noise=1e-4, disabled=(5,))[0], "svd")
    enabled = calibration.layout.enabled
    assert enabled.tolist() == [k != 5 for k in range(14)]
    calibration.write(tmp_path / "a.fits")
    with fits.open(tmp_path / "a.fits") as hdus:
        for name in ("ALPHA", "E_ALPHA", "E_STAT", "E_SYST", "E_CYCLE"):
            values = hdus["CALIBRATION"].data[name]
            np.testing.assert_array_equal(np.isnan(values), ~enabled)
        alone = np.outer(*2 * [np.append(enabled, np.ones(5, dtype=bool))])
        for name in ("COVARIANCE", "SYSTEMATIC"):
            np.testing.assert_array_equal(np.isfinite(hdus[name].data), alone)
    assert list(read(tmp_path / "a.fits").layout.enabled) == list(enabled)


def test_the_calibration_of_a_stiffness_file_is_read_as_it_was_written(tiny, tmp_path):
    root = np.random.default_rng(5).standard_normal((12, 9)) * 1e3
    arms = np.stack([tiny.layout.nz, tiny.layout.x, tiny.layout.y])
    root -= np.linalg.pinv(arms) @ arms @ root
    stiffness = root @ root.T / tiny.alpha[:, None]
    matrix = StiffnessMatrix("TINY", tiny.cycles[0].date, tiny.layout, stiffness)
    calibration = calibrate(matrix, "svd")
    np.testing.assert_allclose(calibration.alpha, tiny.alpha / tiny.alpha.mean(), rtol=1e-9)
    calibration.write(tmp_path / "a.fits")
    assert same(read(tmp_path / "a.fits"), calibration)
    with fits.open(tmp_path / "a.fits") as hdus:
        assert not {"WEIGHT", "E_WEIGHT", "BIAS", "E_BIAS", "TEMPERAT"} & set(hdus[0].header)
        assert len(hdus["LOADS"].data) == 0
        assert hdus["COVARIANCE"].data.shape == (13, 13)
        assert hdus[0].header["SCALE"] == "mean 1"


def write_each(tiny, p45_folder, folder):
    """Write one file of each kind."""
    write_cycle(tiny.cycles[1], folder / "cycle.fits")
    matrix = StiffnessMatrix("TINY", tiny.cycles[0].date, tiny.layout, np.diag(np.arange(12) + 1.0))
    write_stiffness(matrix, folder / "stiffness.fits")
    calibrate(read(p45_folder), "svd").write(folder / "alpha.fits")
    return sorted(folder.iterdir())


def test_the_same_data_give_the_same_bytes_with_checksums_that_astropy_confirms(
    tiny, p45_folder, tmp_path
):
    (tmp_path / "one").mkdir()
    (tmp_path / "two").mkdir()
    one = write_each(tiny, p45_folder, tmp_path / "one")
    two = write_each(tiny, p45_folder, tmp_path / "two")
    assert [p.read_bytes() for p in one] == [p.read_bytes() for p in two]
    for path in one:
        with warnings.catch_warnings(), fits.open(path, checksum=True) as hdus:
            warnings.simplefilter("error")
            hdus.verify("exception")
            sums = [(hdu.verify_checksum(), hdu.verify_datasum()) for hdu in hdus]
            assert sums == [(1, 1)] * len(hdus)
    write_cycle(tiny.cycles[0], tmp_path / "one" / "x.fits.gz")
    write_cycle(tiny.cycles[0], tmp_path / "two" / "x.fits.gz")
    assert (tmp_path / "one/x.fits.gz").read_bytes() == (tmp_path / "two/x.fits.gz").read_bytes()


def test_a_folder_is_read_by_suffix_and_other_files_are_ignored(tiny, tmp_path):
    write_campaign(tiny.cycles, tmp_path / "c")
    assert sorted(p.name for p in (tmp_path / "c").iterdir()) == ["bare-001.fits", "ring-001.fits"]
    for name in ("notes.txt", "bare-001.fits~", ".bare-002.fits", "fits", "map.fit"):
        (tmp_path / "c" / name).write_text("no FITS at all")
    assert len(read(tmp_path / "c").cycles) == 2


def test_loads_whose_names_hold_dots_and_slashes_are_written_and_read(tiny, tmp_path):
    bare, ring = tiny.cycles
    named = dataclasses.replace(ring, load=dataclasses.replace(ring.load, name="../.Ring 0.5"))
    write_campaign([bare, named], tmp_path / "c")
    assert read(tmp_path / "c").loads[1].name == "../.Ring 0.5"
    assert list(tmp_path.iterdir()) == [tmp_path / "c"]


def test_a_campaign_does_not_depend_on_the_order_of_its_files(tiny, tmp_path):
    write_campaign(tiny.cycles, tmp_path / "c")
    one = read(tmp_path / "c" / "bare-001.fits", tmp_path / "c" / "ring-001.fits")
    other = read(tmp_path / "c" / "ring-001.fits", tmp_path / "c" / "bare-001.fits")
    assert same(one, other)
    twice = read(tmp_path / "c", tmp_path / "c" / "ring-001.fits")
    assert same(one, twice)
    assert same(one, Campaign(tiny.cycles))


@pytest.mark.parametrize(
    ("table", "name", "unit", "factor"),
    [
        ("ACTUATORS", "X", "mm", 1e3),
        ("MEASUREMENTS", "FORCE", "mN", 1e3),
        ("MEASUREMENTS", "FORCE", "kg m s-2", 1.0),
        ("MEASUREMENTS", "POSITION", "um", 1e6),
        ("MEASUREMENTS", "TIME", "min", 1 / 60),
        *(("MEASUREMENTS", "TEMPERATURE", unit, 1.0) for unit in ("K", "Celsius", "degC", "deg C")),
    ],
)
def test_units_are_converted(tiny, bare_file, table, name, unit, factor):
    def store(hdus):
        hdus[table].data[name] *= factor
        hdus[table].data[name] += 273.15 if unit == "K" else 0.0
        hdus[table].columns[name].unit = unit

    edited(bare_file, store)
    [cycle] = read(bare_file).cycles
    got = getattr(cycle.layout if table == "ACTUATORS" else cycle, name.lower())
    want = getattr(tiny.layout if table == "ACTUATORS" else tiny.cycles[0], name.lower())
    np.testing.assert_allclose(got, want, rtol=1e-15, atol=1e-12 if unit == "K" else 0.0)


def test_unknown_keywords_columns_and_extensions_are_left_alone(tiny, bare_file):
    def add(hdus):
        hdus[0].header["OBSERVER"] = "Ricci"
        hdus[0].header["HIERARCH ESO INS TEMP"] = 12.5
        hdus[0].header["EMPTY"] = None
        for text in ("one", "one"):
            hdus[0].header["COMMENT"] = hdus[0].header["HISTORY"] = text
        note = fits.Column(name="NOTE", format="3A", array=["abc"] * 24)
        old = hdus["MEASUREMENTS"]
        hdus["MEASUREMENTS"] = fits.BinTableHDU.from_columns(old.columns + note, name=old.name)
        for _ in range(2):  # two without a name, two with the same
            hdus.append(fits.ImageHDU(np.zeros((3, 3), dtype=np.int16)))
            hdus.append(fits.ImageHDU(np.zeros(3), name="EXTRA"))
        text = fits.Column(name="A", format="A3", array=["abc"])
        hdus.append(fits.TableHDU.from_columns([text], name="ASCII"))
        unnamed = fits.BinTableHDU.from_columns([fits.Column(name="A", format="E", array=[1.0])])
        del unnamed.header["TTYPE1"]
        hdus.append(unnamed)

    edited(bare_file, add)
    [cycle] = read(bare_file).cycles
    assert same(cycle, tiny.cycles[0])


def test_a_file_from_plain_astropy_with_narrow_and_scaled_columns_is_read(tiny, tmp_path):
    cycle = tiny.cycles[0]
    header = {
        "INSTRUME": "TINY", "DATE-OBS": "2026-05-04T11:30:00+02:00", "LOAD": "bare", "CYCLE": 1,
        "WEIGHT": -3, "E_WEIGHT": 0.005, "ADDED": 0, "E_ADDED": 0,
    }  # fmt: skip
    counts = np.round(cycle.force * 1e3 * 20)  # int16 of 0.05 mN, zero at 0.1 N
    actuators = [
        fits.Column(name="y", format="E", unit="mm", array=tiny.layout.y * 1e3),
        fits.Column(name="x", format="E", unit="mm", array=tiny.layout.x * 1e3),
        fits.Column(name="id", format="I", array=tiny.layout.id),
    ]
    rows = [
        fits.Column(name="Force", format="12I", unit="mN", array=counts - 2000),
        fits.Column(name="sign", format="I", array=cycle.sign),
        fits.Column(name="SHAPE", format="B", array=cycle.shape),
        fits.Column(name="Time", format="E", unit="s", array=cycle.time),
    ]
    hdus = fits.HDUList(
        [
            fits.PrimaryHDU(header=fits.Header(header)),
            fits.BinTableHDU.from_columns(rows, name="measurements"),
            fits.BinTableHDU.from_columns(actuators, name="Actuators"),
        ]
    )
    hdus[1].header["TSCAL1"], hdus[1].header["TZERO1"] = 0.05, 100.0
    hdus.writeto(tmp_path / "c.fits")
    [back] = read(tmp_path / "c.fits").cycles
    assert isinstance(back.force, np.ndarray)
    with fits.open(tmp_path / "c.fits") as hdus:
        assert hdus[1].columns["Force"].format == "12I"  # scaled integers on disk indeed
        assert (hdus[1].header["TSCAL1"], hdus[1].header["TZERO1"]) == (0.05, 100.0)
    np.testing.assert_allclose(back.force, counts * 5e-5, rtol=0, atol=1e-12)
    np.testing.assert_allclose(back.layout.x, tiny.layout.x, rtol=1e-6, atol=1e-9)
    np.testing.assert_array_equal(back.time, cycle.time)
    assert (back.shape.tolist(), back.sign.tolist()) == (cycle.shape.tolist(), cycle.sign.tolist())
    assert back.date == cycle.date  # a zone is honoured
    assert back.force.dtype == back.layout.x.dtype == np.float64
    assert back.force_error is None


def test_identifiers_beyond_32_bits_are_kept(tiny, tmp_path):
    layout = dataclasses.replace(tiny.layout, id=tiny.layout.id + 5_000_000_000)
    write_campaign((dataclasses.replace(c, layout=layout) for c in tiny.cycles), tmp_path / "c")
    assert read(tmp_path / "c").layout.id[0] == 5_000_000_001


def test_dates_in_another_zone_are_written_in_utc(tiny, tmp_path):
    zone = datetime.timezone(datetime.timedelta(hours=2))
    cycle = dataclasses.replace(tiny.cycles[0], date=tiny.cycles[0].date.astimezone(zone))
    write_cycle(cycle, tmp_path / "c.fits")
    assert same(read(tmp_path / "c.fits").cycles[0].date, tiny.cycles[0].date)


@pytest.mark.parametrize("name", ["Größe", "two\nlines"])
def test_text_that_fits_cannot_hold_is_refused(tiny, tmp_path, name):
    cycle = dataclasses.replace(tiny.cycles[0], instrument=name)
    with pytest.raises(FormatError, match=r"INSTRUME .* ASCII"):
        write_cycle(cycle, tmp_path / "c.fits")
    assert not list(tmp_path.iterdir())


def test_degrees_of_freedom_may_be_a_float(tiny, tmp_path):
    """As another program may have written them."""
    path = tmp_path / "alpha.fits"
    calibrate(Campaign(tiny.cycles)).write(path)
    with fits.open(path, mode="update") as hdus:
        dof = hdus[0].header["DOF"]
        hdus[0].header["DOF"] = float(dof)
    for name in ("CHECKSUM", "DATASUM"):
        fits.delval(path, name)
    assert read(path).degrees_of_freedom == dof


def test_a_path_paths_and_cycles_are_calibrated_as_the_campaign(p45_folder, tmp_path):
    campaign = read(p45_folder)
    alpha = calibrate(campaign, "svd").alpha
    for data in (p45_folder, str(p45_folder), sorted(p45_folder.iterdir()), list(campaign)):
        assert np.array_equal(calibrate(data, "svd").alpha, alpha)
    segments = in_one(pieces(2)[0])
    write_campaign(segments, tmp_path / "two")
    for data in (tmp_path / "two", [tmp_path / "two"], segments):
        with pytest.raises(SeveralSegments):
            calibrate(data, "svd")
    calibrate(campaign, "svd").write(tmp_path / "alpha.fits")
    with pytest.raises(FormatError, match=r"alpha.fits: is a calibration already; give cycle"):
        calibrate(tmp_path / "alpha.fits")
    with pytest.raises(TypeError, match="cannot calibrate a ndarray; give a path, paths, cycles,"):
        calibrate(alpha)


def test_texts_of_actuators_are_kept_and_numbers_stay_numbers(tmp_path):
    cycle = campaign_of(seed=3, noise=1e-4)[0].cycles[0]
    layout = cycle.layout
    for given in ([f"{'AB'[k % 2]}{k}" for k in range(layout.n)], list(range(layout.n))):
        own = dataclasses.replace(layout, number=given)
        other = dataclasses.replace(cycle, layout=own)
        write_cycle(other, tmp_path / "k.fits", overwrite=True)
        assert read(tmp_path / "k.fits").layout.number.tolist() == given
    fewer = layout.part(np.arange(1, layout.n))
    assert fewer.difference(layout) == f"{layout.n} and {layout.n - 1} actuators; only one has 1"


def test_a_cycle_is_the_array_that_was_read(tiny, tmp_path):
    write_cycle(tiny.cycles[0], tmp_path / "c.fits")
    file = read_fits(tmp_path / "c.fits")
    force, _ = file.extensions["MEASUREMENTS"].columns["FORCE"]
    assert cycle_from(file).force is force
