"""What stands where a file was to be: pipes, devices, bombs; and calculations that break down."""

import datetime
import gzip
import os
import sys

import h5py
import numpy as np
import pytest
import scipy.io

from truenewton.calibration.methods import calibrate
from truenewton.errors import (
    FormatError,
    GeometryError,
    TrueNewtonError,
    UnknownName,
    UnreadableFile,
)
from truenewton.figures.style import plain
from truenewton.files import opening
from truenewton.files.fits import BLOCK, CARD, read_fits
from truenewton.files.toml import read_toml
from truenewton.linalg import inverse_of_positive
from truenewton.mirrors.file import layout_in
from truenewton.mirrors.shell.mesh import check_mesh_size
from truenewton.modal.true_stiffness import off_and_slaved
from truenewton.modal.turbulence import Atmosphere, Pupil
from truenewton.records.stiffness_matrix import StiffnessMatrix
from truenewton.statics.layout import layout


def header(*cards):
    return "".join(card.ljust(CARD) for card in (*cards, "END")).ljust(BLOCK).encode()


START = header("SIMPLE  = T", "BITPIX  = 8", "NAXIS   = 0")


def pipe(path):
    os.mkfifo(path)


def device(path):
    path.symlink_to("/dev/zero")


def loop(path):
    path.symlink_to(path.name)


def sparse(path):
    with path.open("wb") as file:
        file.write(START)
        file.truncate(2**40)


@pytest.mark.skipif(os.name == "nt", reason="Windows has neither")
@pytest.mark.parametrize(
    ("make", "said"),
    [
        (pipe, "is a pipe or a device"),
        (loop, "cannot be read (Too many levels of symbolic links)"),
        (sparse, "is damaged"),
    ],
)
def test_what_is_no_file_is_not_waited_for(tmp_path, make, said):
    path = tmp_path / "x.fits"
    make(path)
    with pytest.raises(UnreadableFile) as refused:
        read_fits(path)
    assert said in str(refused.value)
    if make is not sparse:
        with pytest.raises(UnreadableFile):
            read_toml(path)


def test_what_unpacks_to_too_much_is_refused(inside, tmp_path, monkeypatch):
    monkeypatch.setattr(opening, "MAX_UNPACKED_BYTES", 2**20)
    path = tmp_path / "x.fits.gz"
    path.write_bytes(gzip.compress(START + bytes(2**23)))
    with pytest.raises(UnreadableFile, match=r"unpacks to .* GB, more than"):
        read_fits(path)
    path.write_bytes(gzip.compress(START))
    assert read_fits(path).header["NAXIS"] == 0
    zeros = np.zeros((400, 400))
    np.savez_compressed(tmp_path / "k.npz", K=zeros)
    scipy.io.savemat(tmp_path / "k.mat", {"K": zeros}, do_compression=True)
    with h5py.File(tmp_path / "k.h5", "w") as file:
        file.create_dataset("K", data=zeros, compression="gzip")
    for name in ("k.npz", "k.mat", "k.h5"):
        err = inside.refuses("import", tmp_path / name, "--mirror", "p45")
        assert "unpacks to 0.0 GB, more than" in err


def test_tiles_that_unpack_to_too_much_are_refused(tmp_path):
    tiles = header(
        "XTENSION= 'BINTABLE'", "BITPIX  = 8", "NAXIS   = 2", "NAXIS1  = 0", "NAXIS2  = 0",
        "PCOUNT  = 0", "GCOUNT  = 1", "TFIELDS = 0", "ZIMAGE  = T", "ZBITPIX = -64",
        "ZNAXIS  = 2", "ZNAXIS1 = 99999", "ZNAXIS2 = 99999",
    )  # fmt: skip
    path = tmp_path / "x.fits"
    path.write_bytes(START + tiles)
    with pytest.raises(UnreadableFile, match=r"unpacks to .* GB, more than"):
        read_fits(path)


def test_a_text_file_that_is_too_long_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(opening, "MAX_TEXT_BYTES", 100)
    (tmp_path / "plan.toml").write_text("#" * 101)
    with pytest.raises(UnreadableFile, match="is longer than"):
        read_toml(tmp_path / "plan.toml")


@pytest.mark.parametrize(
    ("table", "said"),
    [
        ("ID,X,Y\n1.5,0.1,0.2\n2,0.2,0.3\n", "the ID in row 1 is 1.5; give an integer"),
        (
            "ENABLED,X,Y\nmaybe,0.1,0.2\nTrue,0.2,0.3\n",
            "line 2: ENABLED is 'maybe'; give a number",
        ),
        ("X,Y\none,0.2\ntwo,0.3\n", "line 2: X is 'one'; give a number"),
        ("X,Y\n0.1\n", "have no columns x and y, but X,Y; name two columns x and y"),
        ("X,Y\n1e400,0.2\n0.1,0.3\n", "X of actuator 1 is not finite"),
    ],
)
def test_a_table_of_text_is_held_against_what_it_is_to_be(tmp_path, table, said):
    path = tmp_path / "a.csv"
    path.write_text(table)
    with pytest.raises(ValueError, match=r"a\.csv: ") as refused:
        layout_in(path)
    assert said in str(refused.value)


def test_words_for_enabled_mean_what_they_say(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("ENABLED,X,Y\nTrue,0.1,0.2\nfalse,0.2,0.3\n")
    assert layout_in(path).enabled.tolist() == [True, False]


def test_a_null_character_is_no_name(tmp_path):
    from truenewton.acquisition.plan import read_plan

    (tmp_path / "plan.toml").write_text('mirror = "a\\u0000b"\nloads = []\n')
    with pytest.raises(FormatError, match="without null characters"):
        read_plan(tmp_path / "plan.toml")


def test_an_inverse_does_not_depend_on_units():
    random = np.random.default_rng(3)
    root = random.standard_normal((6, 6))
    matrix = root @ root.T + np.eye(6)
    units = 10.0 ** np.arange(-20, 40, 10)
    scaled = matrix * units * units[:, None]
    assert inverse_of_positive(scaled) * units * units[:, None] == pytest.approx(
        np.linalg.inv(matrix), rel=1e-10
    )
    for wrong in (np.zeros((2, 2)), np.diag([1.0, -1.0])):
        with pytest.raises(np.linalg.LinAlgError):
            inverse_of_positive(wrong)


@pytest.mark.parametrize("broken", [lambda: np.linalg.inv(np.zeros((2, 2))), lambda: 1.0 / 0.0])
def test_a_calculation_that_breaks_down_is_one_line(inside, monkeypatch, broken):
    main = sys.modules["truenewton.cli.main"]
    monkeypatch.setattr(main, "app", lambda *_, **__: broken())
    error = inside.refuses("info", "x")
    assert error.startswith("truenewton: the calculation broke down (")


def test_an_error_of_the_program_keeps_its_traceback(monkeypatch):
    main = sys.modules["truenewton.cli.main"]
    monkeypatch.setattr(main, "app", lambda *_, **__: int("x"))
    monkeypatch.setattr(sys, "argv", ["truenewton", "info", "x"])
    with pytest.raises(ValueError, match="invalid literal"):
        main.main()


SQUARE = [[[0, 0], [1, 0], [1, 1], [0, 1]]]


@pytest.mark.parametrize(
    ("make", "kind", "said"),
    [
        (lambda: layout(np.linspace(0, 1, 20001), np.zeros(20001)), GeometryError, "are 20001 act"),
        (lambda: check_mesh_size(list(map(np.array, SQUARE)), 1e-300), GeometryError, "mesh size"),
        (
            lambda: off_and_slaved(layout([0.0, 0.1], [0.1, 0.0]), [10**30], ()),
            UnknownName,
            "no actuator 1",
        ),
        (lambda: Atmosphere(1e-320), FormatError, None),
        (lambda: Pupil(1e-320, 8.0), FormatError, None),
    ],
)
def test_numbers_of_no_mirror_are_refused(make, kind, said):
    with pytest.raises(kind, match=said):
        make()


def test_elements_next_to_nothing_are_nothing():
    k = np.diag([1.0, 2.0]) + 1e-300
    made = StiffnessMatrix("M", datetime.datetime.now(datetime.UTC), layout([0, 1], [1, 0]), k)
    assert made.stiffness.tolist() == [[1.0, 0.0], [0.0, 2.0]]
    assert not made.stiffness.flags.writeable


def test_a_diagonal_stiffness_is_no_glass():
    angle = np.arange(12.0)
    where = layout(0.1 * np.cos(angle), 0.1 * np.sin(angle))
    matrix = StiffnessMatrix("M", datetime.datetime.now(datetime.UTC), where, 1e5 * np.eye(12))
    with pytest.raises(TrueNewtonError, match="STIFFNESS is diagonal: no actuator feels another"):
        calibrate(matrix)


def test_a_name_of_odd_characters_is_a_label():
    assert plain("a\x0b\ufffe b$") == r"a b\$"
