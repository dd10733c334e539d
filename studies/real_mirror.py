"""Alpha and sensors of a real LBT672 from its feed-forward matrix, and independent measurements.

    TRUENEWTON_REAL_DATA=FOLDER python -m studies.real_mirror [ALPHA.png SENSORS.png]

FOLDER contains lbt672/lbt672-feedforward.fits and lbt672/lbt672-tables.ecsv. Prints the imbalance
of fitted and held-out elastic modes for alpha = 1, by balance of forces and by reciprocity; the
correlation of alpha with the independently measured efficiency of the magnets; and outliers among
actuators and sensors. Takes about four minutes on one processor.
"""

import os
import sys
from pathlib import Path
from typing import Any

import numpy as np
from astropy.table import QTable
from matplotlib.figure import Figure

import truenewton as tn
from studies.matrices import without_polynomial
from truenewton.figures.maps import name_point
from truenewton.figures.style import ACCENT, COLUMN, INK

FAR = 4.0  # outlier limit in robust standard deviations


def shuffled_correlation(one, other, layout, tries=1000):
    """Return the largest |correlation| when actuators are permuted within their rings."""
    random = np.random.default_rng(0)
    ring = np.round(np.hypot(layout.x, layout.y) / 5e-3)
    largest = 0.0
    for _ in range(tries):
        order = np.lexsort((random.random(len(ring)), ring))
        back = np.empty(len(ring), dtype=int)
        back[np.argsort(ring, kind="stable")] = order
        largest = max(largest, abs(np.corrcoef(one[back], other)[0, 1]))
    return largest


def outliers(values, layout):
    """Return IDs and values of outliers after removal of the smooth part."""
    apart = without_polynomial(np.nan_to_num(values, nan=np.nanmedian(values)), layout)
    spread = 1.4826 * np.median(np.abs(apart - np.median(apart)))
    far = np.flatnonzero(np.abs(apart - np.median(apart)) > FAR * spread)
    far = far[np.argsort(-np.abs(apart[far]))]
    return [(int(layout.id[k]), float(values[k])) for k in far]


def main():
    """Print the figures and draw them."""
    folder = Path(os.environ["TRUENEWTON_REAL_DATA"]) / "lbt672"
    matrix = tn.read_stiffness(folder / "lbt672-feedforward.fits")
    table = QTable.read(folder / "lbt672-tables.ecsv")
    efficiency = without_polynomial(np.log(table["MAGNET_EFFICIENCY"]), matrix.layout)
    options: dict[str, Any]
    for label, options in (
        ("svd", {"method": "svd"}),
        ("ml", {"method": "ml"}),
        ("ml, population", {"method": "ml", "population": True}),
        ("auto", {"method": "auto"}),
    ):
        made = tn.calibrate(matrix, **options)
        apart = without_polynomial(made.alpha, matrix.layout)
        print(
            f"{label}: method {made.method}; alpha {made.alpha.min():.3f} .."
            f" {made.alpha.max():.3f}, typical error {np.median(made.error):.4f}, scatter without a"
            f" polynomial of degree 6 {apart.std():.4f}"
        )
        print(f"    verdict: {made.verdict}")
        for line in made.imbalances:
            print(f"    imbalance, {line.modes:<32}{line.before:.4f} -> {line.after:.4f}")
        correlation = np.corrcoef(apart, efficiency)[0, 1]
        slope = np.polyfit(efficiency, apart, 1)[0]
        print(f"    with log magnet efficiency: correlation {correlation:.3f}, slope {slope:.2f}")
    largest = shuffled_correlation(apart, efficiency, matrix.layout)
    print(f"    largest of 1000 permutations within rings {largest:.3f}")
    of_sensors(made)
    if len(sys.argv) > 2:
        draw_alpha(made, apart, efficiency, sys.argv[1])
        draw_sensors(made, sys.argv[2])


def of_sensors(made):
    """Print properties of the sensors, and outliers."""
    layout, gain = made.layout, made.of_sensors("gain")
    x, y = (1e3 * made.of_sensors(axis) for axis in "xy")
    free = [sensor.actuator for sensor in made.sensors if sensor.state == "free"]
    errors = [np.nanmedian(made.of_sensors(name)) for name in ("gain_error", "x_error")]
    print(f"    gains scatter by {np.nanstd(gain):.4f}, known to {errors[0]:.4f}")
    print(f"    places off by {np.nanstd(x):.2f}, {np.nanstd(y):.2f} mm, known to"
          f" {1e3 * errors[1]:.2f} mm")  # fmt: skip
    print(f"    left free: {free or 'none'}")
    for what, values in (("alpha", made.alpha), ("gain", gain)):
        named = ", ".join(f"{one} {value:.3f}" for one, value in outliers(values, layout))
        print(f"    {what} outliers: {named or 'none'}")
    far = np.hypot(x, y)
    worst = np.argsort(-np.nan_to_num(far))[:6]
    print("    farthest off their magnets [mm]: "
          + ", ".join(f"{layout.id[k]} {far[k]:.1f}" for k in worst))  # fmt: skip


def draw_alpha(made, apart, efficiency, path):
    """Draw a map of alpha, and its small-scale part against the efficiency of the magnets."""
    figure = Figure(figsize=(2.1 * COLUMN, 1.2 * COLUMN), layout="constrained")
    left, right = figure.subplots(1, 2)
    made.plot(ax=left)
    right.plot(100 * efficiency, 100 * apart, "o", color=ACCENT, markersize=1.8)
    slope = np.polyfit(100 * efficiency, 100 * apart, 1)
    ends = np.array([100 * efficiency.min(), 100 * efficiency.max()])
    right.plot(ends, np.polyval(slope, ends), color=INK, linewidth=0.8)
    right.set_xlabel("log magnet efficiency, smooth part removed (%)", fontsize=8)
    right.set_ylabel("α, smooth part removed (%)", fontsize=8)
    right.tick_params(labelsize=7)
    far = int(np.abs(apart).argmax())
    name_point(right, made.layout.id[far], 100 * efficiency[far], 100 * apart[far])
    figure.savefig(path, dpi=150)


def draw_sensors(made, path):
    """Draw a map of gains, and the offsets of sensors from magnets, magnified 30 times."""
    figure = Figure(figsize=(2.1 * COLUMN, 1.2 * COLUMN), layout="constrained")
    left, right = figure.subplots(1, 2)
    made.plot("sensor_gain", ax=left)
    layout = made.layout
    x, y = (-made.of_sensors(axis) for axis in "xy")
    right.quiver(
        layout.x, layout.y, 30 * x, 30 * y, angles="xy", scale_units="xy", scale=1.0, color=ACCENT,
        width=2.2e-3, headwidth=3.5, headlength=4.0,
    )  # fmt: skip
    right.quiver([0.35], [-0.43], [0.03], [0.0], angles="xy", scale_units="xy", scale=1.0,
                 color=INK, width=3e-3)  # fmt: skip
    right.annotate("1 mm", (0.365, -0.44), ha="center", va="top", fontsize=7)
    right.set_title("offset of each sensor from its magnet, seen along -z", fontsize=8)
    right.set_aspect("equal")
    right.set_axis_off()
    figure.savefig(path, dpi=150)


if __name__ == "__main__":
    main()
