"""A matrix as observatories have it, laid in files as other software lays them."""

from functools import cache
from types import SimpleNamespace

import numpy as np
from astropy.io import fits

from truenewton.bench.simulated.static import static_bench
from truenewton.mirrors.known import ring

N, RINGS, R = 45, 3, 1.955  # the first rings of LBT672
OFF = 6  # actuators
CHANNELS_IN_ALL = 60
TRACK = "20110311_130523"


@cache
def measured(n=N, away=OFF, bad=(33,)):
    """Return a truth and its matrix: of negative sign, bad sensors, actuators off, noise."""
    truth = static_bench(ring(n), 7).truth
    random = np.random.default_rng(11)
    off = np.zeros(n, dtype=bool)
    off[random.choice(np.arange(10 if n < 100 else 20, n), away, replace=False)] = True
    on = ~off
    true = truth.stiffness
    free = true[np.ix_(on, on)] - true[np.ix_(on, off)] @ np.linalg.solve(
        true[np.ix_(off, off)], true[np.ix_(off, on)]
    )
    k = np.zeros((n, n))
    k[np.ix_(on, on)] = free
    k = k / truth.alpha[:, None] * (1.0 + 0.004 * random.standard_normal(n))
    k *= 1.0 + 1e-4 * random.standard_normal(k.shape)
    bad = np.flatnonzero(on)[list(bad)]
    k[:, bad] *= 3.0 * (1.0 + 0.3 * random.standard_normal((n, len(bad))))
    expected = np.where(on, truth.alpha, np.nan)
    expected[bad] = np.nan
    return SimpleNamespace(
        k=-k, layout=truth.layout, alpha=expected / np.nanmean(expected), off=off, bad=bad
    )


def electronics():
    """Return (60,) which number of the supervisor stands at each channel; some are spare."""
    return np.random.default_rng(5).permutation(CHANNELS_IN_ALL)


def supervisor_angles():
    """Return (n,) polar angle and azimuth of each number: shifted from ring to ring, from -y, x."""
    counts = 9 + 6 * np.arange(RINGS)
    polar = np.repeat(1.2615 + 0.8884 * np.arange(RINGS), counts)
    azimuth = []
    for r, n in enumerate(counts):
        theta = np.roll(np.arange(n) * 360.0 / n, r + 1)
        azimuth.append(theta)
    x, y = np.cos(np.radians(np.concatenate(azimuth))), np.sin(np.radians(np.concatenate(azimuth)))
    return np.radians(polar), np.arctan2(x, -y)  # new x, y = -y, x


def text_array(path, kind, values):
    """Write a text array of the supervisor."""
    lines = [f";;+& TN {TRACK} &-;;", f"{kind} {len(values)} ; comment", *map(str, values)]
    path.write_text("\n".join(lines) + "\n")


def idl_save(path, name, values):
    """Write an IDL save file with one array of doubles, by its published format."""

    def integers(*numbers):
        return np.array(numbers, dtype=">i4").tobytes()

    text = name.encode()
    body = integers(len(text)) + text + bytes(-len(text) % 4) + integers(5, 4)
    shape = values.shape[::-1]
    body += integers(8, 0, values.nbytes, values.size, len(shape), 0, 0, 8)
    body += integers(*shape, *[1] * (8 - len(shape))) + integers(7)
    body += values.astype(">f8").tobytes()
    first = 4 + 16 + len(body)
    path.write_bytes(b"SR\0\4" + integers(2, first, 0, 0) + body + integers(6, first + 16, 0, 0))


def numbers_of(layout):
    """Return (n,) which actuator of a layout each number of the supervisor is."""
    polar, azimuth = supervisor_angles()
    x, y = R * np.sin(polar) * np.cos(azimuth), R * np.sin(polar) * np.sin(azimuth)
    return np.argmin(np.hypot(layout.x - x[:, None], layout.y - y[:, None]), axis=1)


def supervisor_folder(folder, *, positions):
    """Write a supervisor's folder; return which actuators its rows are.

    Positions: 'coordinates', or 'rings' for the table of channels and the shell.
    """
    case, numbers = measured(), electronics()
    mirror_of_number = numbers_of(case.layout)
    there = numbers < N
    row_actuator = mirror_of_number[numbers[there]]
    good = ~case.off[row_actuator]
    channels, rows = np.flatnonzero(there)[good], row_actuator[good]
    k = case.k[np.ix_(rows, rows)]
    u, w, vt = np.linalg.svd(k)
    order = np.argsort(w)
    folder.mkdir(parents=True)
    for name, values in {
        "ff_matrix": k,
        "ff_f_svec": u[:, order],
        "ff_p_svec": vt.T[:, order],
        "ff_sval": w[order],
        "ff_list": channels.astype("i4"),
    }.items():
        hdu = fits.PrimaryHDU(values)
        hdu.header["DATE"] = "2011-03-14"
        hdu.header["TRACKNUM"] = TRACK
        hdu.writeto(folder / f"{name}.fits")
    if positions == "coordinates":
        at = np.zeros((2, CHANNELS_IN_ALL), dtype="f4")
        polar, azimuth = supervisor_angles()
        arc = 1e3 * R * polar
        xy = np.stack([arc * np.cos(azimuth), arc * np.sin(azimuth)])
        at[:, there] = xy[:, numbers[there]]
        fits.PrimaryHDU(at.T).writeto(folder / "act_coordinates.fits")
    else:
        (folder / "conf" / "general").mkdir(parents=True)
        (folder / "conf" / "LBT672a").mkdir()
        text_array(folder / "conf" / "general" / "act2mir_act.txt", "int", numbers)
        counts = 9 + 6 * np.arange(RINGS)
        angles = "\n".join(f"{1.2615 + 0.8884 * k:.4f}" for k in range(RINGS))
        (folder / "conf" / "LBT672a" / "shell.txt").write_text(
            "; the shell\nglass_mass double 2.0e3 ;[g]\nname string LBT672\n"
            f"curv_radius float {1e3 * R} ; [mm]\n"
            f"n_act_ring array ; on each\n int {RINGS}\n"
            + "\n".join(map(str, counts))
            + "\nend\n\n"
            f"angle_ring array\n float {RINGS}\n{angles}\nend\n"
            f"angle_act0 array\n float {RINGS}\n" + "0 " * RINGS + "\nend\n"
        )
    return rows
