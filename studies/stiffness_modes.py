"""Distance of measured stiffness modes from the true ones, after each step of the calibration.

    [TRUENEWTON_REAL_DATA=FOLDER] python -m studies.stiffness_modes

For a simulated P45 (20 seeds, two cycles per load): the distance of modes (`compare_modes`) from
those of the true stiffness. With FOLDER/lbt672/lbt672-feedforward.fits also for the measured
LBT672, compared with the modes of the independent shell model.
"""

import os
from dataclasses import replace

import numpy as np

import truenewton as tn
from studies.matrices import measured_lbt672
from truenewton.bench.simulated.static import run_cycles, static_bench
from truenewton.mirrors.known import lbt672, p45
from truenewton.mirrors.shell.shell_model import model_shell
from truenewton.modal.findings import compare_modes
from truenewton.modal.measured_stiffness import measured_stiffness
from truenewton.modal.true_stiffness import true_stiffness
from truenewton.statics.arms import arms, arms_in_units_of_rms
from truenewton.statics.modes import stiffness_modes

SEEDS = 20
ORDERS = (3, 5, 7, 9, 11, 15, 25)
STEPS = (
    "alpha = 1, right singular vectors",
    "alpha = 1, made symmetric",
    "calibrated, right singular vectors",
    "calibrated, made symmetric",
    "calibrated, rigid motions uncoupled",
)


def singular(k):
    """Return the singular vectors of displacements, which laboratories often use as modes."""
    return np.linalg.svd(k)[2][::-1].T


def steps(matrix, calibration, gain):
    """Yield the modes after each step."""
    k = matrix.stiffness / gain
    yield singular(k)
    yield true_stiffness(matrix, None, sensor_gain=gain).modes.modes
    k = calibration.alpha[:, None] * k
    yield singular(k)
    yield stiffness_modes(k, arms(matrix.layout).T).modes
    yield true_stiffness(matrix, calibration, sensor_gain=gain).modes.modes


def simulated(force_noise, gains_known):
    """Return (seeds, steps) distances to the true modes."""
    distances = []
    for seed in range(SEEDS):
        bench = static_bench(p45(), seed, force_noise=force_noise)
        campaign = tn.Campaign(tuple(run_cycles(bench, 2)))
        softer = bench.truth.stiffness - bench.coils.bias_gradient * np.eye(45)
        true = stiffness_modes(softer, arms(bench.truth.layout).T)
        gain = bench.truth.sensor_gain if gains_known else np.ones(45)
        matrix = measured_stiffness(campaign).matrix
        distances.append(
            [
                compare_modes(modes, true.modes, true.stiffness).distance
                for modes in steps(matrix, tn.calibrate(campaign), gain)
            ]
        )
    return np.array(distances)


def measured(matrix):
    """Return (steps, orders) rms angles between measured and modelled modes."""
    modelled = model_shell(replace(lbt672(), layout=matrix.layout)).stiffness
    modelled = modelled - 31.0 * np.eye(len(modelled))
    model = stiffness_modes(modelled, arms(matrix.layout).T)
    calibration = tn.calibrate(matrix, population=True)
    print("measured LBT672")
    for name, each in (("alpha = 1", None), ("calibrated", calibration)):
        found = true_stiffness(matrix, each)
        rigid = np.linalg.qr(arms_in_units_of_rms(found.layout).T)[0]
        held = np.sum(rigid * (found.stiffness @ rigid), axis=0)
        print(
            f"  {name}: asymmetry {found.asymmetry:.4f}, coupling of rigid motions"
            f" {found.imbalance:.1e}, their stiffness"
            f" {', '.join(f'{value:.0f}' for value in held)} N/m, softest modes"
            f" {', '.join(f'{value:.0f}' for value in found.modes.stiffness[3:8])} N/m"
        )
    return [
        compare_modes(modes, model.modes, model.stiffness).rms_angle[np.array(ORDERS) - 1]
        for modes in steps(matrix, calibration, np.ones(matrix.layout.n))
    ]


def main():
    """Print the tables."""
    print(f"simulated P45, mean distance over {SEEDS} seeds, and seeds in which it is the least")
    for title, options in (
        ("0.1 mN", (1e-4, False)),
        ("1 mN", (1e-3, False)),
        ("0.1 mN, sensor gains known", (1e-4, True)),
    ):
        distances = simulated(*options)
        print(f"  {title}")
        least = np.bincount(distances.argmin(axis=1), minlength=len(STEPS))
        for name, values, count in zip(STEPS, distances.T, least, strict=True):
            print(f"    {name:36} {values.mean():.5f}  {count:2d}")
    if "TRUENEWTON_REAL_DATA" in os.environ:
        rows = measured(measured_lbt672())
        print(f"  rms angle to the modes of the model, of the first {ORDERS}")
        for name, values in zip(STEPS, rows, strict=True):
            print(f"    {name:36} " + "  ".join(f"{value:.4f}" for value in values))


if __name__ == "__main__":
    main()
