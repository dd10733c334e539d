"""People's own files: whatever layout a matrix lies in, calibrate finds the right alpha."""

import os
from dataclasses import replace
from functools import partial

import astropy.units as u
import numpy as np
import pytest
import scipy.io
from astropy.io import fits
from astropy.table import QTable

import truenewton as tn
from helpers.balanced import p45_matrix
from helpers.foreign_files import (
    CHANNELS_IN_ALL,
    OFF,
    TRACK,
    N,
    R,
    electronics,
    idl_save,
    measured,
    numbers_of,
    supervisor_folder,
)
from studies.matrices import measured_or_made, noisy, true_stiffness, with_faults
from truenewton.errors import (
    CampaignMismatch,
    FormatError,
    NotToBeUsed,
    OutputExists,
    TrueNewtonError,
    UnreadableFile,
)
from truenewton.importers.importing import judge
from truenewton.importers.inputs import supervisor_order
from truenewton.importers.selection import positions_in
from truenewton.importers.stored import read_stored
from truenewton.rounding import listed
from truenewton.statics.layout import ring_of

CASE = measured()
XY = np.stack([CASE.layout.x, CASE.layout.y])


def semicolons(values):
    return "\n".join(";".join(f"{v:.17g}".replace(".", ",") for v in row) for row in values) + "\n"


def matrix_file(folder, kind):
    """Write the matrix in a kind of file; return its path and what more is to be said."""
    path, k = folder / f"ff.{kind}", CASE.k
    if kind == "fits":
        fits.PrimaryHDU(k).writeto(path)
    elif kind == "fits.gz":
        hdu = fits.ImageHDU(1e-6 * k, name="FF")
        hdu.header["BUNIT"] = "N/um"
        fits.HDUList([fits.PrimaryHDU(), hdu]).writeto(path)
    elif kind == "npy":
        np.save(path, 1e-3 * k)
        return path, {"unit": "N/mm"}
    elif kind == "npz":
        np.savez(path, other=np.eye(N), mask=np.ones(3), ffwd=k)
    elif kind == "csv":
        path.write_text(semicolons(k))
    elif kind == "txt":
        np.savetxt(path, k, header="forces of actuators, N/m\nsaved by me, act1, act2", comments="")
    elif kind == "tsv":
        lines = ["\t".join(["", *map(str, range(N))])]
        lines += ["\t".join([str(i), *(f"{v:.17g}" for v in row)]) for i, row in enumerate(k)]
        path.write_text("\n".join(lines))
    elif kind == "mat":
        scipy.io.savemat(path, {"K": k, "comment": "x"})
    elif kind == "sav":
        idl_save(path, "FF_MATRIX", k)
    elif kind == "idl":
        np.savetxt(path, k.ravel(), header=f"; TN\ndouble {N} {N} # text", comments="")
    return path, {}


def positions_file(folder, kind):
    """Write positions in a kind of file; return its path and what more is to be said."""
    path = folder / f"xy.{kind}"
    x, y = 1e3 * XY
    if kind == "csv":
        lines = ["Actuator;Pos X [mm];Pos Y [mm];Type"]
        lines += [f"{i};{a:.9g};{b:.9g};A{i}".replace(".", ",")
                  for i, a, b in zip(CASE.layout.id, x, y, strict=True)]  # fmt: skip
        path.write_bytes("\r\n".join(lines).encode("utf-16"))
    elif kind == "txt":
        np.savetxt(path, np.stack([x, y]).T, header="x y")
    elif kind == "dat":
        np.savetxt(
            path, np.stack([CASE.layout.id, *XY]).T, delimiter=",", fmt=["%d", "%.12g", "%.12g"]
        )
    elif kind == "fits":
        fits.PrimaryHDU(np.stack([x, y])).writeto(path)
    elif kind == "npy":
        np.save(path, XY.T)
    elif kind == "mat":
        scipy.io.savemat(path, {"x": XY[0], "y": XY[1], "id": CASE.layout.id})
    elif kind == "table.fits":
        QTable({"X": XY[0] * u.m, "Y": XY[1] * u.m}).write(path)
    return path


def text(made):
    return " | ".join(made.lines)


KINDS = ["fits", "fits.gz", "npy", "npz", "csv", "txt", "tsv", "idl", "mat", "sav"]
PLACES = ["csv", "txt", "dat", "fits", "npy", "mat", "table.fits"]


@pytest.mark.parametrize("kind", KINDS)
def test_the_matrix_is_the_same_from_every_kind_of_file(tmp_path, kind):
    path, more = matrix_file(tmp_path, kind)
    made = tn.stiffness_from(path, XY.T * 1e3 * u.mm, **more)
    np.testing.assert_allclose(made.matrix.stiffness, -CASE.k, rtol=1e-12)
    assert np.array_equal(~made.matrix.layout.enabled, CASE.off)
    assert "negative: sign changed" in text(made)
    off = f"{OFF} disabled, because row and column are zero: {CASE.layout.id[CASE.off][0]}"
    assert off in text(made)
    assert "orientation  not transposed" in text(made)
    assert len(made.lines) <= 10


@pytest.mark.parametrize("kind", PLACES)
def test_positions_are_the_same_from_every_kind_of_file(tmp_path, kind):
    made = tn.stiffness_from(CASE.k, positions_file(tmp_path, kind), curvature=R)
    layout = made.matrix.layout
    np.testing.assert_allclose([layout.x, layout.y], XY, atol=2e-9)
    np.testing.assert_allclose(layout.nz, CASE.layout.nz, atol=1e-8)
    assert np.array_equal(layout.id, CASE.layout.id)


@pytest.mark.parametrize("positions", ["coordinates", "rings"])
def test_a_supervisors_folder(tmp_path, positions):
    rows = supervisor_folder(tmp_path / "meas", positions=positions)
    made = tn.stiffness_from(tmp_path / "meas", curvature=R if positions == "coordinates" else None)
    layout = made.matrix.layout
    np.testing.assert_allclose([layout.x, layout.y], XY[:, rows], atol=5e-6)  # angles to 1e-4 deg
    np.testing.assert_allclose(layout.nz, CASE.layout.nz[rows], atol=1e-6)
    assert made.matrix.date.isoformat() == "2011-03-11T13:05:23+00:00"
    if positions == "coordinates":
        table = positions_file(tmp_path, "csv")
        with pytest.raises(FormatError, match="no position of actuator"):  # these are no channels
            tn.stiffness_from(tmp_path / "meas", table)
    channels = fits.getdata(tmp_path / "meas" / "ff_list.fits")
    assert np.array_equal(layout.id, channels)
    np.testing.assert_allclose(made.matrix.stiffness, -CASE.k[np.ix_(rows, rows)], rtol=1e-12)


def test_a_supervisors_folder_with_a_known_mirror(tmp_path):
    supervisor_folder(tmp_path / "meas", positions="rings")
    told = tn.stiffness_from(tmp_path / "meas").matrix.layout
    known = tn.stiffness_from(tmp_path / "meas", mirror=tn.mirrors.lbt672().layout).matrix.layout
    np.testing.assert_allclose([known.x, known.y, known.nz], [told.x, told.y, told.nz], atol=5e-6)


def test_the_supervisors_order_of_rings():
    assert np.array_equal(supervisor_order(CASE.layout), numbers_of(CASE.layout))
    with pytest.raises(FormatError, match="ring 9 of the mirror has no actuator on its"):
        supervisor_order(tn.mirrors.mmt336().layout)


def test_the_supervisors_order_is_that_of_a_real_mirror(real_matrix):
    """Channels 0 and 1 are numbers 504 and 505 of the rings, by the supervisor's table."""
    mirror = tn.mirrors.lbt672().layout
    order = supervisor_order(mirror)[[504, 505, 506, 507, 585]]
    real = [int(np.flatnonzero(real_matrix.layout.id == i)[0]) for i in (0, 1, 2, 3, 4)]
    np.testing.assert_allclose(mirror.x[order], real_matrix.layout.x[real], atol=1e-4)
    np.testing.assert_allclose(mirror.y[order], real_matrix.layout.y[real], atol=1e-4)


def test_the_matrix_is_looked_for_down_the_tree(tmp_path):
    folder = tmp_path / "adsec" / TRACK
    supervisor_folder(folder, positions="rings")
    made = tn.stiffness_from(tmp_path)
    files = "ff_matrix.fits, ff_list.fits, conf/general/act2mir_act.txt, conf/LBT672a/shell.txt"
    assert f"found        {files}" in text(made)
    assert f"from {folder}, a supervisor's folder" in text(made)
    (folder / "conf").rename(tmp_path / "conf")
    assert tn.stiffness_from(tmp_path).matrix.layout.same_as(made.matrix.layout)
    with pytest.raises(FormatError, match=r"no positions of its channels, but ff_matrix.fits, ff"):
        tn.stiffness_from(folder)
    supervisor_folder(tmp_path / "adsec" / "20110312_000000", positions="rings")
    with pytest.raises(FormatError, match=r"2 measurements: adsec/20110311_130523 and adsec/2011"):
        tn.stiffness_from(tmp_path)


def test_the_tree_of_a_supervisor_is_searched_down_to_its_last_folder(tmp_path, monkeypatch):
    """As calib/adsec/585m/data/TRACK and conf/adsec/..., beside another mirror's configuration."""
    folder = tmp_path / "calib" / "adsec" / "585m" / "data" / TRACK
    supervisor_folder(folder, positions="rings")
    conf = tmp_path / "conf" / "adsec" / "lbt"
    conf.parent.mkdir(parents=True)
    (folder / "conf").rename(conf)
    (tmp_path / "loop").symlink_to(tmp_path)
    found = tn.stiffness_from(tmp_path).matrix.layout
    own = tn.stiffness_from(folder, conf).matrix.layout
    np.testing.assert_allclose([found.x, found.y], [own.x, own.y])
    other = conf.parent / "mmt" / "shell.txt"
    other.parent.mkdir()
    other.write_text((conf / "LBT672a" / "shell.txt").read_text())
    assert tn.stiffness_from(tmp_path).matrix.layout.same_as(found)
    other.write_text(other.read_text().replace("1955", "1700"))
    said = "2 files shell.txt that differ: conf/adsec/mmt/shell.txt and conf/adsec/lbt/LBT672a/sh"
    with pytest.raises(FormatError, match=f"{said}.*; give the folder of this mirror"):
        tn.stiffness_from(tmp_path)
    assert tn.stiffness_from(tmp_path, conf).matrix.layout.same_as(found)
    monkeypatch.setattr("truenewton.importers.inputs.MAX_FILES", 2)
    with pytest.raises(FormatError, match=r"contains no ff_matrix.fits among its first 2 files"):
        tn.stiffness_from(tmp_path)


@pytest.mark.parametrize(("first", "how"), [(1, "ID"), (0, "channel")])
def test_a_known_mirror_may_have_more_actuators_than_the_matrix(tmp_path, first, how):
    mirror, rows = tn.mirrors.ring(N), np.random.default_rng(2).permutation(N)[:40]
    if how == "channel":
        rows[np.argmin(rows)] = 0
    k = CASE.k[np.ix_(rows, rows)]
    made = tn.stiffness_from(k, mirror=mirror, ids=rows + first)
    assert f"40 of 45 matched by {how}" in text(made)
    np.testing.assert_allclose([made.matrix.layout.x, made.matrix.layout.y], XY[:, rows])
    assert made.matrix.instrument == made.matrix.mirror == "RING45"
    tn.write_stiffness(made.matrix, tmp_path / "k.fits")
    assert tn.read_stiffness(tmp_path / "k.fits").mirror == "RING45"
    with pytest.raises(FormatError, match=r"positions of P45 do not fit: .* % of the couplings"):
        tn.stiffness_from(k, mirror=tn.mirrors.p45(), ids=np.sort(rows) + first)


def test_without_positions_a_mirror_is_suggested(tmp_path, inside):
    np.save(tmp_path / "k.npy", CASE.k)
    assert "; --mirror p45 has 45 actuators" in inside("import", tmp_path / "k.npy")[2]


def two_shells():
    """Return the matrix of the mirror twice, and positions of both."""
    k = np.zeros((2 * N, 2 * N))
    k[:N, :N], k[N:, N:] = -CASE.k, -2.0 * CASE.k
    return k, np.concatenate([XY.T + np.array([0.0, y]) for y in (1.0, 0.3)])


def test_two_shells_in_blocks():
    k, positions = two_shells()
    with pytest.raises(FormatError, match="2 separate shells, of 39, 39 actuators"):
        tn.stiffness_from(k, positions)
    made = tn.stiffness_from(k, positions, shell=2)
    x, y = XY[:, ~CASE.off]
    np.testing.assert_allclose(made.matrix.layout.x, x - x.mean(), atol=1e-9)
    np.testing.assert_allclose(made.matrix.layout.y, y - y.mean(), atol=1e-9)
    np.testing.assert_array_equal(
        made.matrix.stiffness, -2.0 * CASE.k[np.ix_(~CASE.off, ~CASE.off)]
    )


def test_opticalibs_configuration_folder(tmp_path):
    fits.PrimaryHDU(np.float32(-CASE.k)).writeto(tmp_path / "ff_matrix.fits")
    fits.PrimaryHDU(1e3 * XY.T).writeto(tmp_path / "ActuatorsCoordinates.fits")
    made = tn.stiffness_from(tmp_path, curvature=R)
    np.testing.assert_allclose(made.matrix.layout.x, XY[0], atol=1e-9)
    assert "opticalib's configuration" in made.lines[0]


def test_two_shells_in_a_cube(tmp_path):
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "shells.h5", "w") as file:
        file["FFWD"] = np.stack([-CASE.k, -CASE.k])
        file["coordinates"] = np.concatenate([XY.T, XY.T + 2.0])
        file["IM0"] = np.ones((N, 300))
        file["mirrorModes"] = np.ones((2 * N, 2 * N))
    with pytest.raises(FormatError, match="2 separate shells, of 45, 45 actuators"):
        tn.stiffness_from(tmp_path / "shells.h5")
    made = tn.stiffness_from(tmp_path / "shells.h5", shell=2)
    x = XY[0] - XY[0].mean()
    np.testing.assert_allclose(made.matrix.layout.x, x, atol=1e-12)


@pytest.mark.parametrize("order", ["channels", "rings"])
def test_positions_of_all_channels_may_come_ring_by_ring(tmp_path, order):
    rows = supervisor_folder(tmp_path / "meas", positions="rings")
    by_number = np.zeros((CHANNELS_IN_ALL, 2))
    by_number[:N] = 1e3 * XY.T[numbers_of(CASE.layout)]
    path = tmp_path / "coordinates.txt"
    np.savetxt(path, by_number if order == "rings" else by_number[electronics()])
    made = tn.stiffness_from(tmp_path / "meas", path)
    np.testing.assert_allclose([made.matrix.layout.x, made.matrix.layout.y], XY[:, rows], atol=1e-9)
    assert ("in the order of act2mir_act.txt" in text(made)) == (order == "rings")


@pytest.mark.parametrize(
    "given",
    [(1e3 * XY[0] * u.mm, XY[1]), {"X [mm]": 1e3 * XY[0], "Y [mm]": 1e3 * XY[1]}],
    ids=["pair", "columns"],
)
def test_positions_may_be_a_pair_or_columns_with_units(given):
    made = tn.stiffness_from(CASE.k, given).matrix.layout
    expected = tn.stiffness_from(CASE.k, XY * u.m).matrix.layout
    np.testing.assert_allclose([made.x, made.y], [expected.x, expected.y], rtol=1e-12)


def test_one_sensor_without_numbers_is_left_out():
    k, bad = CASE.k.copy(), int(np.flatnonzero(~CASE.off)[20])
    k[[3, 9], bad] = np.nan
    made = tn.stiffness_from(k, XY)
    assert f"2 elements of sensor {bad + 1} are not numbers" in text(made)
    assert "its sensor reads nothing" in text(made)
    assert not made.matrix.stiffness[:, bad].any()


def test_one_that_is_zero_but_pushed_stays_enabled():
    matrix, _ = p45_matrix()
    k = matrix.stiffness.copy()
    k[20] = k[:, 20] = 0.0
    made = tn.stiffness_from(k, matrix.layout)
    assert made.matrix.layout.enabled.all()
    assert (
        f"around it do not balance, as if it had exerted a force: {matrix.layout.id[20]}"
        in text(made)
    )


def test_a_pipe_is_no_file_of_positions(tmp_path):
    path = tmp_path / "xy.txt"
    os.mkfifo(path)
    with pytest.raises(UnreadableFile, match="is a pipe or a device; give a file"):
        tn.stiffness_from(CASE.k, path)


def test_names_choose_positions_of_more_actuators(tmp_path):
    rows = np.random.default_rng(2).permutation(N)[:40]
    k = -CASE.k[np.ix_(rows, rows)]
    path = positions_file(tmp_path, "dat")
    with pytest.raises(FormatError, match=r"45 positions for 40 rows and columns; .*--ids"):
        tn.stiffness_from(k, path)
    made = tn.stiffness_from(k, path, ids=CASE.layout.id[rows])
    np.testing.assert_allclose(made.matrix.layout.x, XY[0, rows], atol=1e-9)
    assert np.array_equal(made.matrix.layout.id, CASE.layout.id[rows])


@pytest.mark.parametrize(
    "lines",
    [
        *(
            [f"{name},{name.replace('x', 'y').replace('X', 'Y')}", "1,2", "3,4", "5,6"]
            for name in ("X(mm)", "Pos x in mm", "x_mm")
        ),
        ["Y [mm],X [mm],remark", "2,1,", "4,3,", "6,5,"],
        ["ID,Y,X", "-,mm,mm", "8,2,1", "9,4,3", "7,6,5"],
        ["CAD of November", "Y;X;ID", "[mm];[mm];", "2,0;1,0;8", "4,0;3,0;9", "6,0;5,0;7"],
    ],
    ids=lambda lines: lines[0],
)
def test_names_and_units_of_columns_are_never_lost(tmp_path, lines):
    (tmp_path / "xy.csv").write_text("\n".join(lines))
    found = positions_in(read_stored(tmp_path / "xy.csv"))
    assert (found.unit, found.x.tolist(), found.y.tolist()) == ("mm", [1, 3, 5], [2, 4, 6])


def test_rows_may_have_names_where_columns_have_none(tmp_path):
    named = [f"A{i}," + ",".join(map(repr, row)) for i, row in enumerate(CASE.k[:4, :4].tolist())]
    for header in ([], ["row,1,2,3,4"]):
        (tmp_path / "k.csv").write_text("\n".join(header + named))
        kept = read_stored(tmp_path / "k.csv").arrays[""].values
        np.testing.assert_array_equal(kept, CASE.k[:4, :4])


@pytest.mark.parametrize("between", ["\n", ","])
def test_ids_that_are_texts_can_be_in_a_file(tmp_path, between):
    names = [f"A{i:02d}" for i in range(N)]
    order = np.random.default_rng(1).permutation(N)
    lines = [f"{names[i]},{XY[0][i]},{XY[1][i]}" for i in order]
    (tmp_path / "xy.csv").write_text("\n".join(["ID,x,y", *lines]))
    (tmp_path / "ids.txt").write_text(between.join(["ID", *names]))
    made = tn.stiffness_from(CASE.k, tmp_path / "xy.csv", ids=tmp_path / "ids.txt")
    np.testing.assert_allclose(made.matrix.layout.x, XY[0])
    assert made.matrix.layout.shown.tolist() == [f"{k} ({name})" for k, name in enumerate(names, 1)]


def test_positions_without_ids_are_told_which_columns_there_are(tmp_path):
    order = np.random.default_rng(1).permutation(N)
    rows = np.stack([CASE.layout.id, *XY]).T[order]
    path = tmp_path / "xy.csv"
    np.savetxt(path, rows, delimiter=",", header="knob,x,y", comments="")
    said = "a column named ID; there is knob, x, y$"
    for ids in (None, CASE.layout.id):
        with pytest.raises(FormatError, match=said):
            tn.stiffness_from(CASE.k, path, ids=ids)
    np.savetxt(path, rows, delimiter=",", header="coil,x,y", comments="")
    assert "in the order of their IDs" in text(tn.stiffness_from(CASE.k, path))
    rows = np.insert(rows, 1, 1.0, axis=1)
    np.savetxt(path, rows, delimiter=",", header="knob,ring,east,north", comments="")
    with pytest.raises(FormatError, match=r"contains no positions; .*'knob', column 'ring'"):
        tn.stiffness_from(CASE.k, path)


def test_hdf5_declares_units_and_it_is_said_which_of_two_was_taken(tmp_path):
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "k.h5", "w") as file:
        file["run7/FF"], file["intmat"], file["xy"] = 1e-6 * CASE.k, np.eye(N), 1e3 * XY.T
        file["run7/FF"].attrs["unit"], file["xy"].attrs["units"] = "N/um", np.bytes_("mm")
    made = tn.stiffness_from(tmp_path / "k.h5", curvature=R)
    np.testing.assert_allclose(made.matrix.stiffness, -CASE.k, rtol=1e-12)
    assert "45 x 45, 'run7/FF' of intmat, run7/FF, N/um as declared: median diagonal" in text(made)
    assert "mm as declared" in text(made)


def test_disabled_actuators_need_no_position():
    x, y = XY.copy()
    at = np.flatnonzero(CASE.off)
    x[at[0]] = np.nan
    x[at[1]], y[at[1]] = x[0], y[0]
    k = CASE.k.copy()
    k[at[2]] = k[:, at[2]] = np.nan
    made = tn.stiffness_from(np.ma.masked_invalid(k), np.stack([x, y]), ids=CASE.layout.id)
    assert made.matrix.layout.n == N - 2
    assert np.count_nonzero(~made.matrix.layout.enabled) == OFF - 2
    assert "2 that are off and have no position" in text(made)


def test_units_of_electronics_and_unlikely_units():
    steps = tn.stiffness_from(CASE.k / 41.6, CASE.layout, unit="unknown")
    newton = tn.stiffness_from(CASE.k, CASE.layout)
    for made in (steps, newton):
        assert np.array_equal(made.matrix.layout.enabled, ~CASE.off)
    ratio = steps.matrix.used_stiffness / newton.matrix.used_stiffness
    np.testing.assert_allclose(ratio, ratio[0, 0], rtol=1e-12)
    assert "unit unknown" in text(steps)
    assert "UNLIKELY" not in text(newton)
    slipped = tn.stiffness_from(CASE.k, CASE.layout, unit="mN/m")
    assert "N/m, UNLIKELY for a mirror: check it" in text(slipped)
    counted = tn.stiffness_from(CASE.k / 41.6, CASE.layout, unit="41.6 N/m")
    np.testing.assert_allclose(counted.matrix.stiffness, newton.matrix.stiffness, rtol=1e-12)


def scrambled():
    return XY[:, np.random.default_rng(1).permutation(N)]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"coordinates": scrambled()}, "positions are in another order than rows and columns"),
        ({"coordinates": XY[:, :-1]}, "44 positions for 45 rows and columns"),
        ({"coordinates": None}, "has no positions; give positions"),
        ({"coordinates": XY[:, [*range(N - 1), 0]]}, r"two actuators are at x = .* m: 1 and 45"),
        ({"coordinates": XY * 100}, "unit is not declared; give it by --lengths"),
        ({"coordinates": XY * u.s}, "unit of positions is 's'; give one as mm"),
        ({"matrix": 1e-6 * CASE.k}, "no unit, .* is implausible; give it by --unit .*, as N/um"),
        ({"matrix": CASE.k * u.N}, "unit of the matrix is 'N'; give one as N/um"),
        ({"matrix": CASE.k[:, 1:]}, "contains no square matrix"),
        ({"matrix": 1j * CASE.k}, "contains no real numbers"),
        ({"matrix": np.where(np.eye(N, k=5), np.nan, CASE.k)}, "elements are NaN or infinite"),
        ({"matrix": np.triu(CASE.k)}, "zero below its diagonal: half of it is not there; store"),
        ({"matrix": np.clip(CASE.k, -1e5, 1e5)}, "45 own elements of STIFFNESS are the same"),
        ({"matrix": np.linalg.pinv(CASE.k), "unit": "unknown"}, "looks like a compliance, disp"),
        ({"ids": [1] * N}, "actuator ID 1 occurs 45 times"),
        ({"ids": [1, 2]}, "2 IDs for 45 rows"),
        ({"shell": 2}, "there is no shell 2"),
        ({"matrix": CASE.k + 1e40 * np.eye(N)}, "contains an element of 1e[+]40; measure it again"),
        ({"matrix": np.full((N, N), np.inf)}, "contains no finite number; measure it again"),
        ({"coordinates": XY + np.where(np.arange(N), 0.0, np.inf)}, "actuator 1 is not finite"),
        ({"coordinates": XY * np.inf}, "contains no finite positions; give X and Y"),
        ({"curvature": np.inf}, "curvature radius is inf m"),
        ({"curvature": 0.1}, "from the axis of a surface of R = 0.1 m"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_said_in_one_line(change, said):
    given = {"matrix": CASE.k, "coordinates": XY} | change
    with pytest.raises(TrueNewtonError, match=said) as caught:
        tn.stiffness_from(given.pop("matrix"), given.pop("coordinates"), **given)
    assert "\n" not in str(caught.value)


def test_polar_coordinates_are_no_x_and_y(tmp_path):
    path = tmp_path / "xy.csv"
    np.savetxt(path, XY.T, delimiter=",", header="r [mm],theta [deg]", comments="")
    with pytest.raises(
        FormatError, match=r"contains polar coordinates, .* give X and Y, both in a"
    ):
        tn.stiffness_from(CASE.k, path)


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("a.npy", b"\x93NUMPYjunk", "a.npy: cannot be read"),
        ("a.mat", b"MATLAB 5.0 MAT-file" + bytes(200), "a.mat: cannot be read"),
        ("a.png", b"\x89PNG\r\n\x1a\n\0\0", "a.png: is of an unknown format"),
        (
            "a.csv",
            b"1,2,3\n4,5\n7,8,9\n",
            "line 2 has 2 cells, line 1 has 3: '4,5'; give",
        ),
        ("a.csv", b"1,5,2,5,3,5\n" * 3, "are decimal ones too, put semicolons between columns"),
        ("a.csv", b"a,b,c\n", "contains a header and no numbers"),
        ("a.txt", b"# nothing\n", "contains no numbers"),
        ("a.txt", b"double 3 3\n1 2 3 4\n", "contains 4 numbers; give 3 x 3 numbers"),
        ("a.ecsv", b"# %ECSV 1.0\n# ---\nX Y\n1 2\n", "is not ECSV ("),
    ],
)
def test_what_is_wrong_with_a_file_is_said_in_one_line(tmp_path, name, content, said):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(TrueNewtonError) as caught:
        tn.stiffness_from(tmp_path / name, XY)
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_wide_text_file_names_the_place_of_what_is_no_number(tmp_path):
    lines = semicolons(CASE.k).splitlines()
    lines[4] = "oops" + lines[4][lines[4].index(";") :]
    (tmp_path / "k.csv").write_text("\n".join(lines))
    with pytest.raises(FormatError, match="line 5, column 1 is 'oops'; give a number there"):
        tn.stiffness_from(tmp_path / "k.csv", XY)


def test_folders_and_missing_files(tmp_path):
    with pytest.raises(FormatError, match=r"no ff_matrix.fits; there is no other file .*; give"):
        tn.stiffness_from(tmp_path)
    with pytest.raises(UnreadableFile, match="No such file"):
        tn.stiffness_from(tmp_path / "ff.fits", XY)
    supervisor_folder(tmp_path / "meas", positions="rings")
    (tmp_path / "meas" / "conf" / "LBT672a" / "shell.txt").unlink()
    with pytest.raises(FormatError, match=r"but no shell\.txt; give its folder, or the mirror"):
        tn.stiffness_from(tmp_path / "meas")


def test_the_command_says_what_it_found_and_alpha_is_right(tmp_path, inside):
    path, _ = matrix_file(tmp_path, "csv")
    xy = positions_file(tmp_path, "csv")
    command = ["import", path, xy, "-o", tmp_path / "k.fits", "--curvature", R, "--instrument",
               "X9", "--date", "2026-01-02T03:04:05"]  # fmt: skip
    out = inside.prints(*command)
    assert out.startswith("X9: 45 actuators, from ")
    assert "mm as declared" in out
    assert all(str(CASE.layout.id[b]) in out.split("do not fit")[1] for b in CASE.bad)
    assert "2026-01-02 03:04:05 (as specified)" in out
    assert f"truenewton calibrate {tmp_path / 'k.fits'}" in out
    assert "alpha        not estimated: use `truenewton calibrate`" in out
    np.testing.assert_array_equal(tn.read(tmp_path / "k.fits").stiffness, -CASE.k)
    assert "exists already" in inside.refuses(*command)
    found = tn.calibrate(tmp_path / "k.fits", "ml")
    some = np.isfinite(CASE.alpha)
    assert np.array_equal(found.layout.enabled, some)
    expected = CASE.alpha[some] / CASE.alpha[some].mean()
    apart = found.alpha[some] / found.alpha[some].mean() - expected
    assert np.std(apart) < 0.01  # alpha scatters by 6 %
    assert np.sqrt(np.mean((apart / found.error[some]) ** 2)) < 1.6


def test_a_transposed_matrix_is_named_and_gets_no_alpha(tmp_path, inside):
    sound = tn.stiffness_from(CASE.k, CASE.layout)
    back = tn.stiffness_from(CASE.k.T, CASE.layout, transpose=True)
    np.testing.assert_array_equal(back.matrix.stiffness, sound.matrix.stiffness)
    np.save(tmp_path / "k.npy", CASE.k.T)
    command = "import", tmp_path / "k.npy", positions_file(tmp_path, "csv")
    out = inside.prints(*command)
    assert "LOOKS TRANSPOSED" in out
    assert "next: the same command with --transpose" in out
    np.save(tmp_path / "k.npy", CASE.k)
    out = inside(*command, "--transpose")[1]
    assert "next: the same command without --transpose" in out


def test_a_slightly_wrong_numbering_is_doubted():
    """Every other ring of six is numbered clockwise."""
    case = measured(144, 20, (30, 120))
    order, at = np.arange(144), ring_of(case.layout)
    for r in range(0, 6, 2):
        some = np.flatnonzero(at == r)
        order[some] = some[::-1]
    made = tn.stiffness_from(case.k, np.stack([case.layout.x, case.layout.y])[:, order])
    assert "LOW, check numbering" in text(made)


def test_a_supervisors_files_come_back_with_alpha_in(tmp_path):
    """What the supervisor reads: its checks, its singular vectors, and the forces are true."""
    rows = supervisor_folder(tmp_path / "meas", positions="rings")
    calibration = tn.calibrate(tn.stiffness_from(tmp_path / "meas").matrix, "svd")
    calibration.write(tmp_path / "alpha.fits")
    for each in (calibration, tn.read_calibration(tmp_path / "alpha.fits")):
        number = each.layout.number
        assert sorted(number) != number.tolist()
        np.testing.assert_array_equal(each.table["NUMBER"], number)
    assert "numbering               IDs are channels" in calibration.summary()
    assert calibration.plot("mirror_number") is not None
    known = np.isfinite(CASE.alpha[rows])
    layout = replace(calibration.layout, enabled=known)
    calibration = replace(calibration, layout=layout, alpha=CASE.alpha[rows])
    with pytest.raises(NotToBeUsed, match=r"doubtful: .*--anyway"):
        tn.export_matrix(tmp_path / "meas", calibration, tmp_path / "new")
    export = partial(tn.export_matrix, tmp_path / "meas", accept_rejected=True)
    told = export(calibration, tmp_path / "20261122_101500")
    new = {name: fits.getdata(tmp_path / "20261122_101500" / f"{name}.fits")
           for name in ("ff_matrix", "ff_list", "ff_f_svec", "ff_p_svec", "ff_sval")}  # fmt: skip
    old = fits.getdata(tmp_path / "meas" / "ff_matrix.fits")
    assert new["ff_list"].dtype.kind == "i"
    np.testing.assert_array_equal(new["ff_list"], calibration.layout.id)
    ratio = new["ff_matrix"][known] / old[known] / CASE.alpha[rows][known, None]
    np.testing.assert_allclose(ratio, 1.0, rtol=1e-12)
    np.testing.assert_array_equal(new["ff_matrix"][~known], old[~known])
    assert "without alpha, so not multiplied: channel " in told[-1]
    readme = (tmp_path / "20261122_101500" / "README.txt").read_text()
    assert readme.startswith("\n".join(told))
    assert "verdict on alpha: doubtful: " in readme
    assert "common scale of alpha: not measured (mean alpha is 1)" in readme
    assert all(f"{name}.fits" in readme for name in new)
    assert "was MULTIPLIED by alpha" in readme
    assert f"load the measured matrix ({TRACK})" in " ".join(readme.split())
    assert (np.diag(new["ff_matrix"]) < 0.0).all()  # the sign of the electronics
    assert (np.diff(new["ff_sval"]) >= 0.0).all()
    product = new["ff_f_svec"] * new["ff_sval"] @ new["ff_p_svec"].T
    np.testing.assert_allclose(product, new["ff_matrix"], atol=1e-6 * abs(old).max())
    header = fits.getheader(tmp_path / "20261122_101500" / "ff_matrix.fits")
    assert header["TRACKNUM"] == "20261122_101500"
    assert header["DATE"].startswith("20")
    export(calibration, tmp_path / "new")
    own = fits.getheader(tmp_path / "new" / "ff_matrix.fits")["TRACKNUM"]
    assert own > "20261122_101500"
    with pytest.raises(OutputExists, match="track number of the measured"):
        export(calibration, tmp_path / TRACK)
    again = tmp_path / "again"
    with pytest.raises(FormatError, match="multiplied by alpha already"):
        tn.export_matrix(tmp_path / "new", calibration, again, accept_rejected=True)
    other = replace(calibration.layout, id=calibration.layout.id + 1000)
    wrong = replace(calibration, layout=other)
    with pytest.raises(CampaignMismatch, match=r"no actuator .*, which is a channel"):
        export(wrong, tmp_path / "wrong")
    with pytest.raises(OutputExists):
        export(calibration, tmp_path / "new")


def test_import_says_who_is_left_out_only_if_somebody_is():
    """A matrix of which too much does not fit is kept whole, and `import` says so alone."""
    made = measured_or_made("p45")
    sound = noisy(made, true_stiffness(made), 5, "equal", 5e-4)[1]
    random, k = np.random.default_rng(1), sound.stiffness.copy()
    k[random.choice(45, 8, replace=False)] *= 1.0 + 0.3 * random.standard_normal((8, 45))
    text = str(judge(replace(sound, stiffness=k)).lines)
    assert "too many to leave out" in text
    assert "excluded by calibrate" not in text
    one, bad = with_faults(sound, 5, 1, "sign")
    text = str(judge(one).lines)
    assert f"actuator {sound.layout.id[bad.pop()]}: wrong sign (excluded" in text


def test_a_supervisors_folder_is_to_be_imported_first_and_a_calibration_to_be_fits(
    tmp_path, inside
):
    supervisor_folder(tmp_path / "meas", positions="rings")
    tn.write_stiffness(tn.stiffness_from(CASE.k, CASE.layout).matrix, tmp_path / "k.fits")
    for command in (["calibrate"], ["compare", tmp_path / "k.fits"]):
        error = inside.refuses(*command, tmp_path / "meas")
        assert f"first; run `truenewton import {tmp_path / 'meas'} -o matrix.fits`" in error
    (tmp_path / "alpha.csv").write_text("ID,ALPHA\n1,1.0\n")
    command = "export", tmp_path / "meas", "--calibration", tmp_path / "alpha.csv"
    error = inside.refuses(*command, "-o", tmp_path / "new")
    assert "contains only the table; give the .fits" in error
    (tmp_path / "k.fits").unlink()
    out = inside("import", tmp_path / "meas", "-o", tmp_path / "k.fits", "--curvature", "0")[1]
    assert f"truenewton export {tmp_path / 'meas'} --calibration {tmp_path / 'k-alpha.fits'}" in out


def test_the_radius_of_a_convex_mirror_is_negative(tmp_path, inside):
    """As `truenewton mirrors` prints it; the arms are those of a concave mirror."""
    concave, convex = (tn.stiffness_from(CASE.k, XY, curvature=r) for r in (R, -R))
    assert convex.matrix.layout.same_as(concave.matrix.layout)
    assert "R -1.955 m, NZ 0.99" in text(convex)
    np.save(tmp_path / "k.npy", CASE.k)
    command = "import", tmp_path / "k.npy", positions_file(tmp_path, "csv")
    assert inside(*command, "--curvature", "-1.955")[0] == 0
    with pytest.raises(FormatError, match="radius is nan m; give R in m"):
        tn.stiffness_from(CASE.k, XY, curvature=np.nan)


def test_it_is_said_how_rows_are_numbered(tmp_path, inside):
    """Channels that are off, of electronics that count from 0."""
    dead, k = np.flatnonzero(CASE.off), CASE.k
    scipy.io.savemat(tmp_path / "plain.mat", {"K": k})
    scipy.io.savemat(tmp_path / "named.mat", {"K": k, "chan": np.arange(N)[:, None]})
    np.savetxt(tmp_path / "xy.txt", XY.T)
    first = "import", tmp_path / "plain.mat", tmp_path / "xy.txt"
    for command, how, names in (
        (first, "rows from 1, as there is no ID; if they count from 0, --ids 0-44", dead + 1),
        ((*first, "--ids", "0-44"), "IDs as specified", dead),
        ((*first, "--ids", "0-20,21,22-44"), "IDs as specified", dead),
        (("import", tmp_path / "named.mat", tmp_path / "xy.txt"), "IDs: 'chan' of this f", dead),
        ((*first[:2], positions_file(tmp_path, "csv")), "IDs of the positions", dead + 1),
    ):
        out = inside(*command)[1]
        assert f"numbering    {how}" in out
        assert f"disabled, because row and column are zero: {listed(names)}\n" in out
    assert "there are 57 IDs for 45 rows" in inside(*first, "--ids", "0-56")[2]
    assert "there are 2 IDs for 45 rows" in inside(*first, "--ids", "3-1,3-2")[2]


def test_a_matrix_transposed_by_mistake_gets_one_advice(tmp_path, inside):
    np.save(tmp_path / "k.npy", CASE.k)
    command = "import", tmp_path / "k.npy", positions_file(tmp_path, "csv")
    out = inside(*command, "--transpose")[1]
    assert "LOOKS TRANSPOSED" in out
    assert "add --transpose" not in out
    assert "omit --transpose" in out
    np.save(tmp_path / "k.npy", CASE.k.T)
    assert "correct as transposed (rigid-body" in inside(*command, "--transpose")[1]


def test_a_date_that_no_file_contains_is_called_assumed(tmp_path):
    np.save(tmp_path / "k.npy", CASE.k)
    assert "(assumed, that of the file; --date" in text(tn.stiffness_from(tmp_path / "k.npy", XY))
    assert "(assumed, now; to set it, use --date" in text(tn.stiffness_from(CASE.k, XY))
