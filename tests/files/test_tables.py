"""A table of text means the same wherever it is read: as a mirror's, for an import, for arrays."""

import numpy as np
import pandas as pd
import pytest

from truenewton.errors import FormatError
from truenewton.files.tables import table_in, text_of
from truenewton.importers.selection import Surface, in_metres, read_positions
from truenewton.mirrors.file import layout_in
from truenewton.records.tables import layout_of

COLUMNS = "".join(f"# - {{name: {n}, unit: mm, datatype: float64}}\n" for n in "XY")
HEAD = f"# %ECSV 1.0\n# ---\n# datatype:\n# - {{name: ID, datatype: int64}}\n{COLUMNS}"
TABLES = {
    "comma.csv": "ID,X [mm],Y [mm]\n7,-50,0\n8,50,0.5\n9,0,50\n",
    "decimal.csv": "ID;X [mm];Y [mm]\n7;-50;0\n8;50;0,5\n9;0;50,0\n",
    "blank.txt": "# of the laboratory\n\nID X Y\n - mm mm\n7 -50 0\n8 50 0.5\n9 0 50\n",
    "units.ecsv": f"{HEAD}ID X Y\n7 -50 0\n8 50 .5\n9 0 50\n",
}


@pytest.mark.parametrize("name", TABLES)
def test_positions_are_the_same_for_a_mirror_an_import_and_arrays(tmp_path, name):
    path = tmp_path / name
    path.write_text(TABLES[name])
    places = {"ID": [7, 8, 9], "X [mm]": [-50.0, 50.0, 0.0], "Y [mm]": [0.0, 0.5, 50.0]}
    expected = layout_of(pd.DataFrame(places))
    np.testing.assert_array_equal(expected.x, [-0.05, 0.05, 0.0])
    np.testing.assert_array_equal(expected.id, [7, 8, 9])
    assert layout_in(path).same_as(expected)
    assert in_metres(read_positions(path), Surface()).layout().same_as(expected)


def test_a_cell_that_is_missing_in_ecsv_is_not_a_number(tmp_path):
    path = tmp_path / "a.ecsv"
    path.write_text(TABLES["units.ecsv"].replace("8 50 .5", '8 "" .5'))
    x = table_in(text_of(path)).columns["X"]
    assert (x.unit, x.values[0], np.isnan(x.values[1])) == ("mm", -50.0, True)
    with pytest.raises(ValueError, match=r"a\.ecsv: X of actuator 8 is not finite"):
        layout_in(path)


def test_damaged_ecsv_of_a_mirror_is_refused(tmp_path):
    path = tmp_path / "a.ecsv"
    path.write_text("# %ECSV 1.0\n# ---\nX Y\n1 2\n")
    with pytest.raises(FormatError, match=r"a\.ecsv: is not ECSV \("):
        layout_in(path)


def test_a_number_too_large_for_an_id_is_refused(tmp_path):
    path = tmp_path / "a.txt"
    path.write_text("1 -50 0\n2 50 0\n999999999999999999999 0 50\n")
    with pytest.raises(FormatError, match="the first no numbers of actuators"):
        read_positions(path)
