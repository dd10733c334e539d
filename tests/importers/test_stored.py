"""Tables in text, Excel and FITS files: names of columns, separators, numbers of lines."""

import sys

import h5py
import numpy as np
import openpyxl
import pytest
import scipy.io
from astropy.table import Table

from truenewton.errors import FormatError, UnreadableFile
from truenewton.importers.selection import matrix_in, positions_in
from truenewton.importers.stored import read_stored
from truenewton.mirrors.file import layout_in

TWICE = [f"F{i}" for i in range(1, 10)] * 2  # commands, then a force monitor
PLACES = {"x": [0.0, 0.1, -0.1], "y": [0.1, 0.0, 0.0]}


@pytest.mark.parametrize("ending", ["csv", "narrow.csv", "xlsx"])
def test_columns_of_one_name_are_refused(tmp_path, ending):
    names = TWICE if "narrow" not in ending else ["shape", "F1", "F1"]
    rows = np.random.default_rng(1).normal(size=(3, len(names))).tolist()
    path = tmp_path / f"a.{ending}"
    if ending == "xlsx":
        book = openpyxl.Workbook()
        for row in [names, *rows]:
            book.active.append(row)
        book.save(path)
    else:
        path.write_text("\n".join(",".join(map(str, row)) for row in [names, *rows]))
    said = "two columns F1, F2, F3 and 6 more;" if names is TWICE else "two columns F1; keep one"
    with pytest.raises(FormatError, match=said):
        read_stored(path)


def test_positions_with_nz_twice_are_refused(tmp_path):
    path = tmp_path / "xy.csv"
    for names in ("X,Y,NZ,NZ", "X,Y,NZ,nz", "X,X [mm],Y,NZ"):
        path.write_text(f"{names}\n" + "\n".join(f"{k},{k % 2},1,0.5" for k in range(3)))
        with pytest.raises(FormatError, match=r"two columns NZ|may be NZ: NZ, nz|may be X: X, X"):
            positions_in(read_stored(path))
    path.write_text("X,Y,NZ,NZ\n0,0.1,1,0.5\n0.1,0,1,0.5\n-0.1,0,1,0.5\n")
    with pytest.raises(FormatError, match=r"xy\.csv: there are two columns NZ"):
        layout_in(path)


def test_a_column_of_two_tables_is_not_taken_from_the_first(tmp_path):
    path = tmp_path / "a.fits"
    for k, mode in ((1, "overwrite"), (2, "append")):
        table = Table({"X": k * np.array(PLACES["x"]), "Y": PLACES["y"]}, meta={"EXTNAME": f"T{k}"})
        table.write(path, **{mode: True})
    stored = read_stored(path)
    assert set(stored.columns) == {"T1/X", "T1/Y", "T2/X", "T2/Y"}
    with pytest.raises(FormatError, match="several columns may be X: T1/X, T2/X; keep one"):
        positions_in(stored)
    assert "x" not in stored.names


@pytest.mark.parametrize("n", [3, 20])
def test_lines_may_end_with_their_separator(tmp_path, n):
    values = np.random.default_rng(2).normal(size=(4, n)).round(3)
    names, path = [f"F{k}" for k in range(n)], tmp_path / "a.csv"
    for head in ("", ";"):  # after the names, too
        lines = [";".join(names) + head] + [";".join(map(str, row)) + ";" for row in values]
        path.write_text("\n".join(lines))
        stored = read_stored(path)
        assert list(stored.columns) == names
        np.testing.assert_array_equal(stored.arrays[""].values, values)
        np.testing.assert_array_equal(stored.columns["F2"].values, values[:, 2])


@pytest.mark.parametrize("cell", ["1.234", "-1.234,5", "1.234.567"])
def test_a_point_between_thousands_is_refused_beside_decimal_commas(tmp_path, cell):
    path = tmp_path / "a.csv"
    path.write_text(f"x;y;remark\n{cell};0,5;a, b\n3,5;4;c\n")
    with pytest.raises(FormatError, match=f"line 2 has '{cell}', and commas are decimal; write"):
        read_stored(path)
    path.write_text("x;y;remark\n1.234;0.5;a, b\n3.5;4;c, d\n")
    assert read_stored(path).columns["x"].values.tolist() == [1.234, 3.5]


def test_arrays_in_structs_of_matlab_are_found(tmp_path):
    path, k = tmp_path / "a.mat", np.random.default_rng(3).normal(size=(5, 5))
    scipy.io.savemat(path, {"sys": {"ff_matrix": k, "pos": {"x": k[0], "y": k[1]}, "name": "M"}})
    item, _ = matrix_in(read_stored(path), None)
    np.testing.assert_array_equal(item.values, k)
    np.testing.assert_array_equal(positions_in(read_stored(path)).y, k[1])
    shells = np.zeros(2, dtype=[("ff", object)])
    shells["ff"] = [k, 2.0 * k]
    scipy.io.savemat(path, {"dm": shells})
    with pytest.raises(FormatError, match=r"2 square matrices; .*dm\(1\).ff, dm\(2\).ff"):
        matrix_in(read_stored(path), None)
    np.testing.assert_array_equal(matrix_in(read_stored(path), "dm(2).ff")[0].values, 2.0 * k)
    with h5py.File(path, "w", userblock_size=512) as file:  # version 7.3
        file["sys/ff_matrix"] = k.T
        file["sys/ff_matrix"].attrs["MATLAB_class"] = np.bytes_("double")
    path.write_bytes(b"MATLAB 7.3 MAT-file".ljust(128) + path.read_bytes()[128:])
    np.testing.assert_array_equal(matrix_in(read_stored(path), "sys.ff_matrix")[0].values, k)


def test_a_fault_in_excel_has_the_number_of_its_row(tmp_path):
    book = openpyxl.Workbook()
    names = [f"a\nmm{k}" for k in range(20)]
    for row in [["made\nby me"], [], [], names, [], *[[1.0] * 20] * 3, [1.0, "oops", *[1.0] * 18]]:
        book.active.append(row)
    book.save(tmp_path / "a.xlsx")
    with pytest.raises(FormatError, match="line 9, column 2 is 'oops'"):
        read_stored(tmp_path / "a.xlsx")


def test_without_h5py_the_extra_is_named(tmp_path, monkeypatch):
    with h5py.File(tmp_path / "k.h5", "w") as file:
        file["k"] = np.eye(3)
    monkeypatch.setitem(sys.modules, "h5py", None)
    with pytest.raises(UnreadableFile, match=r"k.h5: is HDF5, .*'truenewton\[hdf5\]'"):
        read_stored(tmp_path / "k.h5")
