"""`truenewton import campaign.toml`: cycles in files of other software become cycle files."""

import os

import h5py
import numpy as np
import pandas as pd
import pytest

import truenewton as tn
from helpers.balanced import campaign_of
from truenewton.importers.campaign import example

CAMPAIGN = campaign_of(seed=3, noise=1e-4)[0]
IDS = CAMPAIGN.layout.id
DEFAULT = 'force = "F{id}"'


def written(folder, ending, changes):
    """Write the files of a campaign and its description, with changes; return the latter."""
    layout = CAMPAIGN.layout
    positions = {"ID": layout.id, "x [mm]": 1e3 * layout.x, "y [mm]": 1e3 * layout.y}
    pd.DataFrame(positions | {"NZ": layout.nz}).to_csv(folder / "positions.csv", index=False)
    for cycle in CAMPAIGN:
        path = folder / f"{cycle.load.name}-{cycle.number}.{ending}"
        millinewtons = pd.DataFrame(1e3 * cycle.force, columns=[f"F{i}" for i in IDS])
        table = pd.DataFrame({"shape": cycle.shape, "sign": cycle.sign})
        wide = pd.concat([table, millinewtons], axis=1)
        if ending == "csv":
            wide.to_csv(path, sep=";", decimal=",", index=False)
        elif ending == "xlsx":
            wide.assign(good=True).to_excel(path, index=False)
        elif ending == "txt":
            np.savetxt(path, wide)
        elif ending == "h5":
            with h5py.File(path, "w") as file:
                file["run/shape"], file["run/sign"] = cycle.shape, cycle.sign
                file["run/FORCE"] = cycle.force
                file["run/FORCE"].attrs["unit"] = "N"
        else:
            long = wide.melt(["shape", "sign"], var_name="name", value_name="f")
            long.to_csv(path, index=False)
    text = example().replace('"298 g"', str(CAMPAIGN.weight)).replace("29.5 g", "-0.289 N")
    for load in CAMPAIGN.loads:
        for k in (1, 2):
            text = text.replace(f"{load.name}-{k}.csv", f"{load.name}-{k}.{ending}")
    for old, new in changes.items():
        assert old in text
        text = text.replace(old, new)
    (folder / "campaign.toml").write_text(text)
    return folder / "campaign.toml"


@pytest.mark.parametrize(
    ("ending", "changes"),
    [
        ("csv", {}),
        ("xlsx", {DEFAULT: DEFAULT + '\nvalid = "good"'}),
        ("h5", {DEFAULT: 'force = "FORCE"'}),
        (
            "txt",
            {'shape = "shape"': "shape = 1", 'sign = "sign"': "sign = 2", DEFAULT: "force = 3"},
        ),
        ("long.csv", {DEFAULT: 'force = "f"\nactuator = "name"'}),
    ],
)
def test_files_of_a_campaign_become_cycle_files(tmp_path, inside, ending, changes):
    path = written(tmp_path, ending, changes)
    out = inside.prints("import", path, "-o", tmp_path / "made")
    assert "MIRROR: 14 actuators" in out
    assert f"calibrate {tmp_path / 'made'} -o {tmp_path / 'made-alpha.fits'}" in out
    made = tn.read(tmp_path / "made")
    for one, other in zip(made, CAMPAIGN, strict=True):
        np.testing.assert_allclose(one.force, other.force, rtol=1e-12)
        assert np.array_equal(one.sign * one.shape, other.sign * other.shape)
    assert made.weight == CAMPAIGN.weight
    assert made.layout.same_as(CAMPAIGN.layout)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('"-0.289 N"', "0.289", "load 'ring': ADDED is 0.289 N; z points up"),
        ('"-0.289 N"', '"29 parrots"', "ADDED is in '29 parrots'; give it in N, g or a unit"),
        ("F{id}", "G{id}", "bare-1.csv: there is no column 'G1'; name the columns of the file"),
        ('added_error = "0.5 g"', "", "load 'ring' lacks 'added_error'"),
        (
            '# unit = "mm"',
            'unit = "um"',
            "are up to 0.1 mm from the axis, and the mirror weighs 2.9",
        ),
        ("F{id}", "shape", "'shape' has shape (28,); give an array of rows by 14 actuators, or"),
        ("added_error", "added_errors", "'added_errors'; did you mean 'added_error'?"),
        ("mN", "mn", "bare-1.csv: FORCE is in mn; give it in N or a unit that converts to it"),
        ('files = ["bare-1.csv", "bare-2.csv"]', "files = []", "load 'bare' has no files"),
    ],
)
def test_what_is_wrong_with_a_description_is_said_in_one_line(tmp_path, inside, old, new, words):
    assert words in inside.refuses("import", written(tmp_path, "csv", {old: new}))


def test_centimetres_for_millimetres_are_doubted_and_options_of_a_matrix_refused(tmp_path, inside):
    path = written(tmp_path, "csv", {'# unit = "mm"': 'unit = "cm"'})
    out = inside.prints("import", path, "-o", tmp_path / "made")
    said = inside("calibrate", tmp_path / "made")[1]
    assert "limit: Actuators are up to 1000 mm from the axis, and the mirror" in said
    assert "UNLIKELY  actuators are up to 1000 mm from the axis, and the mirror weighs" in out
    error = inside.refuses("import", path, "positions.csv", "--transpose")
    assert "only a matrix is imported with POSITIONS and --transpose; give " in error


def test_an_error_without_the_unit_of_its_weight_is_refused_or_doubted(tmp_path, inside):
    bare = {'"0.5 g"  ': "0.5  "}
    path = written(tmp_path, "csv", {"weight = -2": 'weight = "298 g"  # -2', **bare})
    error = inside.refuses("import", path)
    assert "campaign.toml: weight_error is 0.5 without a unit, but weight is a mass; give" in error
    path = written(tmp_path, "csv", bare)
    out = inside.prints("import", path, "-o", tmp_path / "made")
    assert "UNLIKELY  the error of the weight is 17 % of it: check its unit (N, if it has" in out


def test_an_added_weight_beyond_the_mirror_and_the_date_of_a_file_are_shown(tmp_path, inside):
    path = written(tmp_path, "csv", {"-0.289 N": "30 kg"})
    os.utime(tmp_path / "bare-1.csv", (1.7e9, 1.7e9))
    out = inside.prints("import", path, "-o", tmp_path / "made")
    assert "UNLIKELY  load ring is 101 times the weight of the mirror: check the unit" in out
    assert "date 2023-11-14 22:13:20 UTC (assumed, that of the file bare-1.csv; to change" in out
    path = written(tmp_path, "csv", {"# date": "date"})
    out = inside("import", path)[1]
    assert "UNLIKELY" not in out
    assert "date 2026-11-21 09:30:00 UTC (as specified)" in out
    assert "only one load" not in out


def test_a_campaign_of_one_load_is_called_so_before_the_next_command(tmp_path, inside):
    path = written(tmp_path, "csv", {})
    bare = path.read_text().rpartition("[[loads]]")[0]
    path.write_text(bare)
    out = inside("import", path, "-o", tmp_path / "made")[1]
    assert "only one load, bare: alpha also needs a load of another" in out.partition("next:")[0]
    assert "there is only one load, 'bare'" in inside("calibrate", tmp_path / "made")[2]


def test_segments_are_described_one_by_one_with_text_ids_in_any_order(tmp_path, inside):
    path = written(tmp_path, "csv", {})
    places = pd.read_csv(tmp_path / "positions.csv").iloc[::-1]
    places["ID"] = "F" + places.ID.astype(str)
    places.assign(SEGMENT=1).to_csv(tmp_path / "positions.csv", index=False)
    assert inside("import", path, "-o", tmp_path / "made")[0] == 0
    layout = tn.read(tmp_path / "made").layout
    assert layout.names.tolist() == places.ID.tolist()
    assert np.array_equal(layout.id, np.sort(IDS))
    assert np.array_equal(layout.segment, np.ones(IDS.size))
    places.assign(SEGMENT=1 + np.arange(IDS.size) // 7).to_csv(tmp_path / "positions.csv")
    error = inside.refuses("import", path)
    assert "has actuators of 2 segments, which balance separately; describe each" in error


@pytest.mark.parametrize("force", ["{id}", "F{id}", "force [mN]"])
def test_texts_as_ids_are_kept_beside_numbers_in_the_order_of_the_positions(
    tmp_path, inside, force
):
    """F01, F02, ..., in columns of their own or in a column of a long table."""
    names = np.array([f"F{i:02d}" for i in IDS])
    path = written(tmp_path, "csv", {DEFAULT: f'force = "{force}"'})
    places = pd.read_csv(tmp_path / "positions.csv").assign(ID=names)
    places.iloc[::-1].to_csv(tmp_path / "positions.csv", index=False)
    for cycle in CAMPAIGN:
        table = pd.DataFrame(1e3 * cycle.force, columns=names)
        table = pd.concat([pd.DataFrame({"Shape": cycle.shape, "Sign": cycle.sign}), table], axis=1)
        if "{id}" not in force:
            table = table.melt(["Shape", "Sign"], var_name="actuator", value_name=force)
            text = path.read_text().replace('mN"\n\n[units]', 'mN"\n[units]')
            path.write_text(text.replace('# actuator = "actuator"', 'actuator = "actuator"'))
        table.to_csv(tmp_path / f"{cycle.load.name}-{cycle.number}.csv", index=False)
    out = inside.prints("import", path, "-o", tmp_path / "made")
    assert "IDs are texts (NUMBER): numbered from 1 in this order" in " ".join(out.split())
    made = tn.read(tmp_path / "made")
    assert made.layout.number.tolist() == names[::-1].tolist()
    for one, other in zip(made, CAMPAIGN, strict=True):
        np.testing.assert_allclose(one.force[:, ::-1], other.force, rtol=1e-12)
    out = inside("calibrate", tmp_path / "made", "-o", tmp_path / "a.fits", "--exclude", "F03")[1]
    known = tn.read_calibration(tmp_path / "a.fits")
    assert np.isnan(known.alpha_of(["F03"]))
    with pytest.raises(tn.errors.UnknownName, match="there is no actuator 4; IDs run from 1"):
        known.alpha_of(["4"])  # docs/before-loading.md: a channel is no number of a row
    lowest = known.layout.shown[np.nanargmin(known.alpha)]
    assert f"lowest: actuator {lowest}" in " ".join(out.split())
    known.write(tmp_path / "a.csv")
    assert "F14" in (tmp_path / "a.csv").read_text()
    error = inside.refuses("calibrate", tmp_path / "made", "--exclude", "F3")
    assert "there is no actuator F3; IDs run from 1 (F14) to 14 (F01)" in error


def test_names_of_columns_are_shown_as_they_are_in_the_file(tmp_path, inside):
    path = written(tmp_path, "csv", {DEFAULT: 'force = "Kraft{id}"'})
    error = inside("import", path)[2]
    assert "no column 'Kraft1'" in error
    assert "the file has shape, sign, F1, F2" in error
    (tmp_path / "bare-1.csv").write_text("shape,sign,Kraft1\n1,1,two\n")
    text = path.read_text().replace('"Kraft{id}"', '"Kraft1"')
    path.write_text(text.replace("# actuator = ", "actuator = ").replace('"actuator"', '"sign"'))
    assert "line 2: Kraft1 is 'two'; give a number" in inside("import", path)[2]


def test_a_file_without_names_of_columns_is_told_so(tmp_path, inside):
    path = written(tmp_path, "txt", {})
    error = inside("import", path)[2]
    assert "bare-1.txt: there is no column 'shape'" in error
    assert "the file has none" in error


@pytest.mark.parametrize("changes", [{}, {DEFAULT: "force = 3"}])
def test_columns_in_the_order_of_texts_are_refused_without_ids(tmp_path, inside, changes):
    """F1, F10, F11, ...: positions numbered by their lines may be in the same order."""
    path = written(tmp_path, "csv", changes)
    pd.read_csv(tmp_path / "positions.csv").drop(columns="ID").to_csv(tmp_path / "positions.csv")
    assert inside("import", path)[0] == 0
    for name in tmp_path.glob("*-?.csv"):
        table = pd.read_csv(name, sep=";", decimal=",")
        table[["shape", "sign", *sorted(table.columns[2:])]].to_csv(name, index=False)
    error = inside("import", path)[2]
    assert "columns are in the order F1, F10, F11, F12 and 10 more, and actuators are 1, 2" in error


def with_forces(path, change):
    """Change the forces [mN] in each file of a campaign, written as text with all digits."""
    for name in path.parent.glob("*-?.csv"):
        table = pd.read_csv(name, sep=";", decimal=",")
        forces = table.columns[2:]
        pd.concat([table[["shape", "sign"]], change(table[forces])], axis=1).to_csv(
            name, index=False
        )


def test_a_point_between_thousands_and_a_forgotten_unit_are_unlikely(tmp_path, inside):
    path = written(tmp_path, "csv", {})
    said = "UNLIKELY  force has numbers from 1 to 999 with three decimals or none"

    def grouped(forces):
        return (1e2 * forces).round().astype(int).map("{:,}".format).replace(",", ".", regex=True)

    for change, is_doubted in (
        (grouped, True),
        (lambda forces: forces.round(3), False),
        (lambda forces: (8 * forces).round() / 8, False),
    ):
        path = written(tmp_path, "csv", {})
        with_forces(path, change)
        assert (said in inside("import", path)[1]) == is_doubted
    path = written(tmp_path, "csv", {'force = "mN"': ""})
    out = inside("import", path)[1]
    assert "from bare to ring, the sum of forces changes by 353 N and the weight by -0.289 N" in out


def test_times_that_no_clock_gave_are_called_assumed(tmp_path, inside):
    path = written(tmp_path, "csv", {"# date": "date"})
    out = inside("import", path, "-o", tmp_path / "made")[1]
    assert "times assumed: one row a second, as there is no column of time; each cycle" in out
    assert all(cycle.times == "assumed" for cycle in tn.read(tmp_path / "made"))
    inside("report", tmp_path / "made", "-o", tmp_path / "a.html")
    assert "2026-11-21 09:30:00 (assumed)" in (tmp_path / "a.html").read_text()
    for name in tmp_path.glob("*-?.csv"):
        table = pd.read_csv(name, sep=";", decimal=",")
        table.assign(time=2.0 * np.arange(len(table))).to_csv(name, index=False)
    path.write_text(path.read_text().replace("# time = ", "time = "))
    out = inside("import", path, "-o", tmp_path / "clock")[1]
    assert "times assumed: each cycle begins 1 s after the end of the one before" in out
    made = tn.read(tmp_path / "clock")
    assert [cycle.times for cycle in made] == [None, *["assumed"] * 3]
    path.write_text(path.read_text().replace("date = 2026", "# date = 2026"))
    out = inside("import", path, "-o", tmp_path / "file")[1]
    assert "UTC (assumed, that of the file bare-1.csv; to change it, specify date" in out
    assert all(cycle.times == "assumed" for cycle in tn.read(tmp_path / "file"))


def test_the_example_has_the_column_that_numbers_repeated_readings(tmp_path, inside):
    changes = {DEFAULT: 'force = "f"', "# actuator": "actuator"}
    path = written(tmp_path, "long.csv", changes)
    path.write_text(path.read_text().replace('actuator = "actuator"', 'actuator = "name"'))
    for name in tmp_path.glob("*.long.csv"):
        once = pd.read_csv(name).assign(row=1)
        pd.concat([once, once.assign(row=2)]).to_csv(name, index=False)
    assert "two readings of shape 1 with sign 1; add a column 'row'" in inside("import", path)[2]
    path.write_text(path.read_text().replace("# row", "row"))
    out = inside("import", path)[1]
    assert f"bare 1   {2 * len(CAMPAIGN.cycles[0].shape)} rows" in out


def test_a_file_of_one_row_is_read(tmp_path, inside):
    path = written(tmp_path, "csv", {})
    lines = (tmp_path / "bare-1.csv").read_text().splitlines()
    (tmp_path / "bare-1.csv").write_text("\n".join(lines[:2]))
    assert "bare 1   1 rows, forces up to" in inside.prints("import", path)
