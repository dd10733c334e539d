"""What is wrong is refused at the command line: exit code 2, one line, nothing left behind."""

import dataclasses
import gzip
import io
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest
from astropy.io import fits

from truenewton.records.file import write_campaign, write_cycle, write_stiffness
from truenewton.records.stiffness_matrix import StiffnessMatrix


@pytest.fixture
def refused(inside, tmp_path):
    """Return a function that runs a command line, which is refused and leaves no file."""

    def run(*arguments):
        before = sorted(tmp_path.rglob("*"))
        error = inside.refuses(*arguments)
        assert sorted(tmp_path.rglob("*")) == before
        return error

    return run


@pytest.fixture
def folder(sound_folder, tmp_path):
    """A sound campaign of two files, of which each test has its own copy."""
    return Path(shutil.copytree(sound_folder, tmp_path / "c"))


@pytest.fixture(scope="module")
def sound_folder(tiny, tmp_path_factory):
    path = tmp_path_factory.mktemp("sound") / "c"
    write_campaign(tiny.cycles, path)
    return path


def edit(path, *edits):
    """Edit the HDUs of a file and write it again, with new checksums."""
    with fits.open(path) as hdus:
        for hdu in hdus:
            hdu.data  # noqa: B018 - astropy loads late
        for change in edits:
            change(hdus)
        hdus.writeto(path, overwrite=True, checksum=True)


def keyword(name, value):
    return lambda hdus: hdus[0].header.set(name, value, "")


def no_keyword(name):
    return lambda hdus: hdus[0].header.remove(name)


def cells(table, name, where, value):
    def change(hdus):
        hdus[table].data[name][where] = value

    return change


def columns(table, change):
    """Make a table anew from what ``change`` makes of its columns, as a dictionary."""

    def rebuild(hdus):
        old = hdus[table]
        parts = {
            c.name: {"name": c.name, "format": c.format, "unit": c.unit, "array": old.data[c.name]}
            for c in old.columns
        }
        change(parts)
        new = [fits.Column(**part) for part in parts.values()]
        hdus[table] = fits.BinTableHDU.from_columns(new, name=table)

    return rebuild


def no_column(table, name):
    return columns(table, lambda parts: parts.pop(name))


def column(table, name, **new):
    return columns(table, lambda parts: parts[name].update(new))


def rows(table, keep):
    def change(hdus):
        hdus[table].data = hdus[table].data[keep]

    return change


def doubled(name):
    return lambda hdus: hdus.append(hdus[name].copy())


def disabled(hdus):
    add = {"name": "ENABLED", "format": "L", "unit": None, "array": np.zeros(12, dtype=bool)}
    columns(A, lambda parts: parts.update(ENABLED=add))(hdus)


def named(table, name):
    return lambda hdus: setattr(hdus[table], "name", name)


A, M = "ACTUATORS", "MEASUREMENTS"

FILE_FAULTS = {
    **{f"no {key}": (no_keyword(key), f"no {key}") for key in ("DATE-OBS", "WEIGHT")},
    "WEIGHT is text": (keyword("WEIGHT", "-3.0"), "WEIGHT is '-3.0' .. store a number"),
    "LOAD is a number": (keyword("LOAD", 5), "LOAD is 5"),
    "DATE-OBS is no date": (keyword("DATE-OBS", "4 May"), "DATE-OBS is '4 May' .. write ISO 8601"),
    "DATE-OBS is of no century": (keyword("DATE-OBS", "0001-01-01"), "is '0001 .. 1950 to"),
    "CYCLE is real": (keyword("CYCLE", 1.0), "CYCLE is 1.0"),
    "CYCLE is zero": (keyword("CYCLE", 0), "CYCLE is 0"),
    "LOAD is blank": (keyword("LOAD", "   "), "LOAD is blank"),
    "WEIGHT is positive": (keyword("WEIGHT", 3.0), "WEIGHT is 3 N .. in N is negative"),
    "E_ADDED is negative": (keyword("E_ADDED", -0.1), "E_ADDED is -0.1"),
    "FORCERR is below all sense": (keyword("FORCERR", 1e-155), "FORCERR is 1e-155 N"),
    "TILT is upright": (keyword("TILT", 90.0), "TILT is 90 deg"),
    "WEIGHT is huge": (keyword("WEIGHT", -1e300), "WEIGHT is -1e+300 N"),
    "COILGRAD is huge": (keyword("COILGRAD", 1e300), "COILGRAD is 1e+300"),
    "E_WEIGHT is a huge integer": (keyword("E_WEIGHT", 10**60), "E_WEIGHT is 1e+60"),
    # tables
    "MEASUREMENTS misnamed": (
        named(M, "MEASUREMENT"),
        "no table MEASUREMENTS .. there is ACTUATORS, MEASUREMENT;",
    ),
    "FORCE misnamed": (
        columns(M, lambda parts: parts["FORCE"].update(name="FORCES")),
        "MEASUREMENTS has no column FORCE .. name it so: there is TIME, SHAPE, SIGN",
    ),
    "no actuator is enabled": (disabled, "no actuator is ENABLED .. set ENABLED to T"),
    "two ACTUATORS": (doubled(A), "two ACTUATORS"),
    "no X": (no_column(A, "X"), "ACTUATORS has no column X"),
    "two columns X": (
        columns(A, lambda parts: parts["Y"].update(name="x")),
        "two columns X",
    ),
    # types and widths
    "ID is real": (column(A, "ID", format="D"), "column ID of ACTUATORS holds float64"),
    "X is a pair": (column(A, "X", format="2D", array=np.zeros((12, 2))), "instead of 1"),
    "ENABLED is a number": (
        column(A, "ENABLED", format="J", array=np.ones(12)),
        "column ENABLED of ACTUATORS holds int32",
    ),
    "FORCE is complex": (column(M, "FORCE", format="12M"), "FORCE of MEASUREMENTS holds complex"),
    "FORCE varies in length": (
        column(M, "FORCE", format="PD()", array=np.array([np.ones(k) for k in range(24)], object)),
        "FORCE of MEASUREMENTS holds object",
    ),
    "ACTUATORS lacks a row": (rows(A, slice(11)), "12 values a row instead of 11"),
    # units
    "FORCE declares no unit": (
        column(M, "FORCE", unit=None),
        "column FORCE of MEASUREMENTS declares no unit",
    ),
    **{
        f"FORCE in {unit}": (
            column(M, "FORCE", unit=unit),
            f"FORCE of MEASUREMENTS is in '{unit}' .. store it in",
        )
        for unit in ("m", "counts", "mag(N)")
    },
    # values that count
    **{
        f"{value} in {name}": (cells(table, name, where, value), words)
        for value in (np.nan, 1e300)
        for table, name, where, words in (
            (A, "X", 2, "actuator"), (A, "NZ", 2, "NZ"),
            (M, "TIME", 7, "TIME in row 8"), (M, "TEMPERATURE", 7, "TEMPERATURE in row 8"),
            (M, "FORCE", (7, 3), "FORCE in row 8"),
            (M, "POSITION", (7, 3), "POSITION in row 8"),
        )
    },
    "NaN of a dead sensor": (
        cells(M, "FORCE", (7, 3), np.nan),
        "FORCE in row 8 is nan for actuator 4 .. set ENABLED of the actuator to F",
    ),
    "FORCE is next to nothing": (
        cells(M, "FORCE", slice(None), 1e-300),
        "FORCE is below 1e-09 N throughout",
    ),
    "SIGN is 2": (cells(M, "SIGN", 4, 2), "SIGN in row 5 is 2"),
    "SHAPE is 0": (cells(M, "SHAPE", 4, 0), "SHAPE in row 5 is 0"),
    "no rows": (rows(M, slice(0)), "MEASUREMENTS has no rows"),
    "no actuators": (rows(A, slice(0)), "there are no actuators"),
    "no row is valid": (cells(M, "VALID", slice(None), False), "MEASUREMENTS has no valid rows"),
    "an ID stands twice": (cells(A, "ID", 3, 1), "ID 1 occurs 2 times"),
    "two actuators at one place": (
        lambda hdus: (cells(A, "X", 3, 0.01)(hdus), cells(A, "X", 4, 0.01)(hdus),
                      cells(A, "Y", 3, 0.01)(hdus), cells(A, "Y", 4, 0.01)(hdus)),
        "two actuators are at x = 0.01 m, y = 0.01 m",
    ),
    "NZ is beyond 1": (cells(A, "NZ", 3, 1.1), "NZ lies outside"),
    "X in mm is called m": (cells(A, "X", slice(None), np.arange(12) * 30.0), "check their unit"),
}  # fmt: skip


def assert_told(words, line):
    """Check that a line has a remedy, and what is given of fault and remedy: fault .. remedy."""
    fault, _, remedy = words.partition(" .. ")
    assert fault in line
    assert remedy in line.split("; ", 1)[1]


@pytest.mark.parametrize(("fault", "words"), FILE_FAULTS.values(), ids=FILE_FAULTS)
def test_a_cycle_file_with_a_fault_is_refused_by_name(folder, refused, fault, words):
    edit(folder / "ring-001.fits", fault)
    line = refused("calibrate", folder, "-o", folder.parent / "alpha.fits")
    assert f"{folder}/ring-001.fits: " in line
    assert_told(words, line)


def test_what_does_not_count_may_hold_anything(folder, inside, tiny):
    edit(folder / "ring-001.fits", lambda hdus: hdus[A].data["X"].__iadd__(5e-10))  # of no account
    for name in ("bare-001.fits", "ring-001.fits"):
        edit(
            folder / name,
            cells(M, "VALID", slice(20, 24), False),
            cells(M, "FORCE", slice(20, 24), np.nan),
            cells(M, "TIME", 21, np.inf),
            cells(M, "TEMPERATURE", 22, -1e300),
            cells(M, "POSITION", 23, np.nan),
            cells(M, "SIGN", 20, 77),
            cells(M, "SHAPE", 20, -5),
        )
    assert "8 rows not valid left out" in inside.prints("calibrate", folder)


# --- damaged files -----------------------------------------------------------------------------


@pytest.mark.parametrize("suffix", ["", ".gz"])
def test_a_truncated_file_is_refused_at_every_length(folder, refused, suffix):
    plain, path = folder / "ring-001.fits", folder / f"ring-001.fits{suffix}"
    sound = plain.read_bytes()
    sound = gzip.compress(sound, mtime=0) if suffix else sound
    plain.unlink()
    for length in (*range(0, len(sound), 1 + len(sound) // 15), len(sound) - 1):
        path.write_bytes(sound[:length])
        line = refused("calibrate", folder, "-o", folder.parent / "alpha.fits")
        assert f"{path.name}: " in line
        assert any(w in line for w in ("truncated", "damaged", "not a FITS", "no table")), length
    nulls, of_one_byte = b"SIMPLE  = " + b"\0" * 2870, gzip.compress(b"x")
    for content in (b"time,force\n1,2\n", b"\x1f\x8b" + b"x" * 999, nulls, of_one_byte):
        path.write_bytes(content)
        assert f"{path.name}: is " in refused("calibrate", folder)


@pytest.mark.parametrize("place", ["comment", "data", "padding"])
def test_a_changed_byte_anywhere_breaks_the_checksum(folder, refused, place):
    path = folder / "ring-001.fits"
    raw = bytearray(path.read_bytes())
    with fits.open(path) as hdus:
        start, size = hdus[M].fileinfo()["datLoc"], hdus[M].data.nbytes
    comment = raw.index(b"name of the load")
    raw[{"comment": comment, "data": start + 100, "padding": start + size}[place]] ^= 1
    path.write_bytes(raw)
    line = refused("calibrate", folder)
    assert "ring-001.fits: a CHECKSUM or DATASUM does not match; " in line


def test_a_column_count_beyond_all_reason_is_refused(folder, refused):
    path = folder / "ring-001.fits"
    raw = path.read_bytes().replace(b"CHECKSUM=", b"CHECKSUX=")
    path.write_bytes(raw.replace(b"=                    7 / n", b"=           9999999999 / n"))
    assert "MEASUREMENTS has over 999 columns; " in refused("calibrate", folder)


# --- files that do not belong together ------------------------------------------------------------

DISAGREEMENTS = {
    "WEIGHT": (keyword("WEIGHT", -3.0000001), "on WEIGHT (-3.0000001 and -3.0)"),
    "ACTUATORS, order": (rows(A, np.arange(12)[::-1]), "on the ACTUATORS table"),
    "ACTUATORS, place": (
        lambda hdus: hdus[A].data["X"].__iadd__(2e-6),
        "2 um apart; and 11",
    ),
    "ACTUATORS, enabled": (cells(A, "ENABLED", 3, False), "on the ACTUATORS table"),
    "ADDED": (keyword("ADDED", -0.51), "on ADDED (-0.51 and -0.5)"),
    "CYCLE": (keyword("CYCLE", 1), "LOAD 'ring' has CYCLE 1 twice .. remove one, or"),
    "LOAD": (
        keyword("LOAD", "bare"),
        "on ADDED (-0.5 .. correct it, or LOAD, which is 'bare'",
    ),
    "FORCE in mN": (
        lambda hdus: hdus[M].data["FORCE"].__imul__(1e3),
        "FORCE in another unit .. correct the unit of FORCE in that file",
    ),
}


@pytest.mark.parametrize(("fault", "words"), DISAGREEMENTS.values(), ids=DISAGREEMENTS)
def test_files_that_disagree_are_refused(folder, refused, tiny, fault, words):
    write_cycle(dataclasses.replace(tiny.cycles[1], number=2), folder / "ring-002.fits")
    edit(folder / "ring-002.fits", fault)
    line = refused("calibrate", folder, "-o", folder.parent / "alpha.fits")
    assert "ring-002.fits" in line
    assert_told(words, line)


@pytest.fixture
def stiffness(tiny):
    """A stiffness matrix of rank 9 with alpha in it."""
    arms = np.stack([tiny.layout.nz, tiny.layout.x, tiny.layout.y])
    root = np.random.default_rng(5).standard_normal((12, 9)) * 1e3
    root -= np.linalg.pinv(arms) @ arms @ root
    return StiffnessMatrix("TINY", tiny.cycles[0].date, tiny.layout, root @ root.T)


def test_a_second_stiffness_file_or_that_of_another_mirror_is_refused(folder, refused, stiffness):
    write_stiffness(dataclasses.replace(stiffness, instrument="OTHER"), folder / "k.fits")
    said = refused("calibrate", folder)
    assert "k.fits: disagrees with " in said
    assert " on INSTRUME; " in said
    write_stiffness(stiffness, folder / "l.fits")
    assert "l.fits: is a second stiffness file among others; " in refused("calibrate", folder)


def test_a_calibration_among_cycle_files_is_refused(folder, refused, inside):
    inside("calibrate", folder, "-o", folder / "alpha.fits")
    assert "alpha.fits: is a calibration file among others; " in refused("calibrate", folder)
    alone = refused("calibrate", folder / "alpha.fits")
    assert "alpha.fits: is a calibration already; " in alone


def test_a_fits_file_without_measurements_among_cycle_files_is_refused(folder, refused):
    image = fits.PrimaryHDU(np.zeros((3, 3)))
    image.writeto(folder / "map.fits")
    line = refused("calibrate", folder)
    assert_told("map.fits: there is no table MEASUREMENTS .. there is a plain image; give", line)
    matrix = fits.ImageHDU(np.eye(12), name="FFMATRIX")
    fits.HDUList([image, matrix]).writeto(folder / "map.fits", overwrite=True)
    assert "FFMATRIX; give cycle files only" in refused("calibrate", folder)


def matrix(values):
    return lambda hdus: setattr(hdus["STIFFNESS"], "data", values)


def element(value):
    return lambda hdus: hdus["STIFFNESS"].data.__setitem__((3, 4), value)


STIFFNESS_FAULTS = {
    "not square": (matrix(np.ones((12, 11))), "12 x 11"),
    "empty": (matrix(None), "an image STIFFNESS"),
    "next to nothing": (matrix(np.full((12, 12), 1e-300)), "or next to it"),
    "NaN": (element(np.nan), "STIFFNESS contains NaN"),
    "no unit": (lambda hdus: hdus["STIFFNESS"].header.remove("BUNIT"), "declares no unit"),
    "N": (lambda hdus: hdus["STIFFNESS"].header.set("BUNIT", "N"), "STIFFNESS is in 'N'"),
    "no INSTRUME": (no_keyword("INSTRUME"), "no INSTRUME"),
    "two": (doubled("STIFFNESS"), "two STIFFNESS"),
}


@pytest.mark.parametrize(("fault", "words"), STIFFNESS_FAULTS.values(), ids=STIFFNESS_FAULTS)
def test_a_stiffness_file_with_a_fault_is_refused(tmp_path, refused, stiffness, fault, words):
    write_stiffness(stiffness, tmp_path / "k.fits")
    edit(tmp_path / "k.fits", fault)
    line = refused("calibrate", tmp_path / "k.fits", "-o", tmp_path / "alpha.fits")
    assert "k.fits: " in line
    assert_told(words, line)


# --- paths, outputs, the command line itself ------------------------------------------------------


def test_an_output_that_stands_is_refused_and_kept(folder, refused, inside):
    target = folder.parent / "alpha.fits"
    target.write_text("mine")
    line = refused("calibrate", folder, "-o", target)
    assert f"{target}: exists already; choose another name, or overwrite it" in line
    assert target.read_text() == "mine"
    assert inside("calibrate", folder, "-o", target, "--overwrite")[0] == 0
    sound = target.read_bytes()
    assert sound.startswith(b"SIMPLE")
    edit(folder / "ring-001.fits", keyword("WEIGHT", 3.0))
    refused("calibrate", folder, "-o", target, "--overwrite")
    assert target.read_bytes() == sound


def test_a_folder_that_stands_is_refused_and_kept(folder, refused, tmp_path):
    target = tmp_path / "out"
    target.mkdir()
    (target / "notes.txt").write_text("mine")
    for words in (("simulate", "ring8"), ("figures", folder)):
        assert "out: exists already; " in refused(*words, "-o", target)
        line = refused(*words, "-o", target, "--overwrite")
        assert (
            "out: contains notes.txt, which this program did not write; choose another name" in line
        )
    assert (target / "notes.txt").read_text() == "mine"


def test_a_full_disk_leaves_no_half_written_output(folder, refused, monkeypatch):
    class Full(io.FileIO):
        def write(self, data):
            super().write(bytes(data[:1000]))
            raise OSError(28, "No space left on device")

    sound = Path.open
    monkeypatch.setattr(
        Path, "open", lambda path, mode: (Full if mode == "wb" else sound)(path, mode)
    )
    target = folder.parent / "alpha.fits"
    line = refused("calibrate", folder, "-o", target)
    assert f"{target}: cannot be written (No space left on device); " in line
    line = refused("simulate", "ring8", "--cycles", 1, "-o", folder.parent / "sim")
    assert f"{folder.parent / 'sim'}: cannot be written (No space left on device); " in line


COMMAND_LINES = {
    "no command like it": (
        ["calibrat", "x"],
        "No such command 'calibrat'. Did you mean 'calibrate', 'recalibrate'?",
    ),
    "no option like it": (["calibrate", "x", "--jsno"], "--json"),
    "no output": (["figures", "x"], "Missing option '-o' / '--output'; see 'truenewton figures"),
    "no number": (["simulate", "p45", "-o", "x", "--seed", "one"], "Invalid value for '--seed'"),
    "words for IDs": (
        ["recalibrate", "x", "--known", "y", "--actuators", "17,,18"],
        "'17,,18'; give IDs, such as 17,18",
    ),
    "no mirror like it": (["simulate", "p54", "-o", "x"], "p54"),
}


@pytest.mark.parametrize(("arguments", "words"), COMMAND_LINES.values(), ids=COMMAND_LINES.keys())
def test_a_wrong_command_line_is_refused(refused, tmp_path, monkeypatch, arguments, words):
    monkeypatch.chdir(tmp_path)
    assert words in refused(*arguments)


def test_a_name_with_line_breaks_still_makes_one_line(tmp_path, refused):
    (tmp_path / "two\nlines\x1b[31m.fits").write_bytes(b"no FITS")
    assert "two\\nlines\\x1b[31m.fits: is not a FITS file; " in refused("calibrate", tmp_path)


def test_a_closed_standard_output_is_no_fault(folder, inside, monkeypatch):
    monkeypatch.setattr(sys, "stdout", None)
    target = folder.parent / "alpha.fits"
    assert inside("calibrate", folder, "-o", target)[0] == 0
    assert target.exists()
