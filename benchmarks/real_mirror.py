"""Alpha of a real LBT672 from its feed-forward matrix, beside what was measured apart.

    TRUENEWTON_REAL_DATA=FOLDER python benchmarks/real_mirror.py [FIGURE.png]

FOLDER holds lbt672/lbt672-feedforward.fits and lbt672/lbt672-tables.ecsv. Prints the imbalance of
elastic modes, fitted and held out, and how alpha goes with the efficiency of the magnets, which
knows nothing of it.
"""

import os
import sys
from pathlib import Path

import numpy as np
from astropy.table import QTable
from matplotlib.figure import Figure

import truenewton as tn
from truenewton.calibration.methods import held_out
from truenewton.figures.maps import plot_map
from truenewton.figures.style import ACCENT, COLUMN, INK


def without_polynomial(values, layout, degree=6):
    """Take a polynomial of x and y out: what is left differs from neighbour to neighbour."""
    x, y = layout.x / 0.45, layout.y / 0.45
    powers = [(i, j) for i in range(degree + 1) for j in range(degree + 1 - i)]
    terms = np.stack([x**i * y**j for i, j in powers], axis=1)
    return values - terms @ np.linalg.lstsq(terms, np.asarray(values), rcond=None)[0]


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


def main():
    """Print the figures and draw them."""
    folder = Path(os.environ["TRUENEWTON_REAL_DATA"]) / "lbt672"
    matrix = tn.read(folder / "lbt672-feedforward.fits")
    table = QTable.read(folder / "lbt672-tables.ecsv")
    efficiency = without_polynomial(np.log(table["MAGNET_EFFICIENCY"]), matrix.layout)
    for label, options in (
        ("svd", {"method": "svd"}),
        ("ml", {}),
        ("ml, population", {"population": True}),
    ):
        calibration = tn.calibrate(matrix, **options)
        apart = without_polynomial(calibration.alpha, matrix.layout)
        print(
            f"{label}: method {calibration.method}; alpha {calibration.alpha.min():.3f} .. "
            f"{calibration.alpha.max():.3f}, typical error {np.median(calibration.error):.4f}, "
            f"scatter without a polynomial of degree 6 {apart.std():.4f}"
        )
        for line in held_out(matrix, **options):
            print(f"    imbalance, {line.modes:<32}{line.before:.4f} -> {line.after:.4f}")
        print(
            f"    correlation with log magnet efficiency {np.corrcoef(apart, efficiency)[0, 1]:.3f}"
        )
    print(
        "    largest of 1000 permutations within rings "
        f"{shuffled_correlation(apart, efficiency, matrix.layout):.3f}"
    )
    if len(sys.argv) > 1:
        draw(calibration, apart, efficiency, sys.argv[1])


def draw(calibration, apart, efficiency, path):
    """Draw alpha on the map, and its small scale against the efficiency of the magnets."""
    figure = Figure(figsize=(2.1 * COLUMN, 1.05 * COLUMN), layout="constrained")
    left, right = figure.subplots(1, 2)
    plot_map(calibration.layout, calibration.alpha, left)
    right.plot(100 * efficiency, 100 * apart, "o", color=ACCENT, markersize=1.8)
    slope = np.polyfit(100 * efficiency, 100 * apart, 1)
    ends = np.array([100 * efficiency.min(), 100 * efficiency.max()])
    right.plot(ends, np.polyval(slope, ends), color=INK, linewidth=0.8)
    right.set_xlabel("log magnet efficiency, smooth part taken out (%)", fontsize=8)
    right.set_ylabel(r"$\alpha$, smooth part taken out (%)", fontsize=8)
    right.tick_params(labelsize=7)
    figure.savefig(path, dpi=200)


if __name__ == "__main__":
    main()
