"""Sound files of other people's layouts, and ways to spoil those that hold arrays by name."""

from __future__ import annotations

import random
from pathlib import Path

import h5py
import numpy as np
import scipy.io
from astropy.io import fits
from astropy.table import Table

from truenewton.files.fits import read_fits

from .fits import spoil_array
from .process import must


def make_foreign(at: Path) -> None:
    """Make files of a matrix of 24 actuators as others have it, of the one that is there."""
    k = -np.asarray(read_fits(at / "stiffness.fits").pixels("STIFFNESS"))
    table = np.genfromtxt(at / "actuators.csv", delimiter=",", skip_header=1)
    ids, x, y, n = table[:, 0].astype(int), 1e3 * table[:, 1], 1e3 * table[:, 2], len(k)
    f = at / "f"
    f.mkdir()
    write_arrays(f / "ff.npy", {"": k})
    write_arrays(f / "ff.npz", {"ffwd": k, "xy": np.stack([x, y])})
    write_arrays(f / "ff.mat", {"FF": k, "x": x, "y": y})
    write_arrays(f / "ff.h5", {"ffwd": k, "coords": np.stack([x, y]).T})
    fits.PrimaryHDU(k).writeto(f / "ff.fits")
    np.savetxt(f / "ff.csv", k, delimiter=",", header=",".join(map(str, ids)), comments="")
    rows = list(zip(ids.tolist(), x.round(3).tolist(), y.round(3).tolist(), strict=True))
    (f / "xy.csv").write_text("ID;X [mm];Y [mm]\n" + "".join(f"{i};{a};{b}\n" for i, a, b in rows))
    (f / "xy.txt").write_text("# x y\n" + "".join(f"{a} {b}\n" for _, a, b in rows))
    Table({"X": x, "Y": y}).write(f / "xy.fits")
    for name in ("s", "o"):
        (at / name).mkdir()
        fits.PrimaryHDU(k).writeto(at / name / "ff_matrix.fits")
    fits.PrimaryHDU(np.stack([x, y]).T).writeto(at / "o" / "ActuatorsCoordinates.fits")
    channels = np.arange(n + 6)[3:-3]
    fits.PrimaryHDU(channels.astype("i4")).writeto(at / "s" / "ff_list.fits")
    places = np.zeros((n + 6, 2))
    places[channels] = np.stack([x, y]).T
    fits.PrimaryHDU(places).writeto(at / "s" / "act_coordinates.fits")
    numbers = "\n".join(map(str, np.roll(np.arange(n + 6), 3)))
    (at / "s" / "act2mir_act.txt").write_text(f";;+& TN &-;;\nfloat {n + 6}\n{numbers}\n")
    must("import s -o sup.fits", at)
    must("calibrate sup.fits -o chan.fits", at)


def read_arrays(path: Path) -> dict[str, np.ndarray]:
    """Return the arrays of a file by name; that of an .npy is ''."""
    if path.suffix == ".mat":
        return {k: v for k, v in scipy.io.loadmat(path).items() if not k.startswith("__")}
    if path.suffix == ".h5":
        with h5py.File(path) as file:
            return {name: np.asarray(held[()]) for name, held in file.items()}
    held = np.load(path)
    return {"": held} if path.suffix == ".npy" else dict(held)


def write_arrays(path: Path, named: dict[str, np.ndarray]) -> None:
    """Write arrays by name."""
    if path.suffix == ".mat":
        scipy.io.savemat(path, named)
    elif path.suffix == ".h5":
        with h5py.File(path, "w") as file:
            for name, values in named.items():
                file[name] = values
    elif path.suffix == ".npz":
        np.savez(path, **named)
    else:
        np.save(path, next(iter(named.values())))


def arrays(pick: random.Random, path: Path) -> str:
    """Spoil one of the arrays of a file by its values, shape, type or name."""
    named = read_arrays(path)
    name = pick.choice(list(named))
    values = np.atleast_2d(np.array(named[name], dtype=float))
    kind = pick.choice(("values", "values", "values", "shape", "type", "name"))
    with np.errstate(all="ignore"):
        if kind == "values":
            spoil_array(pick, values)
        elif kind == "shape":
            ways = (values.T, values[:-1], values[:, :-1], values[:1, :1], values[:0], values[None],
                    np.stack([values, values]), values.ravel(), values[0, 0], values[::-1],
                    np.zeros((3, 3)), np.eye(len(values)))  # fmt: skip
            values = np.asarray(pick.choice(ways))
        elif kind == "type":
            types = ("f2", "f4", ">f8", "i1", "i8", "u2", "?", "c16", "S8", "M8[s]")
            values = values.astype(pick.choice(types))
    named[name] = values
    if kind == "name":
        named[pick.choice(("x", "X", "other", "a" * 31, "FFWD"))] = named.pop(name)
    write_arrays(path, named)
    return f"{name}: {kind}"
