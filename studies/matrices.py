"""How alpha from a stiffness matrix, its errors and its bad actuators fare on known truths.

    [TRUENEWTON_REAL_DATA=FOLDER] python -m studies.matrices [--seeds 20] [--faults]
    python -m studies.matrices --mirror mmt336 --method auto [--seeds 20] [--faults]
        [--first 0] [--laws proportional mixed] [--levels .1] [--annular]

The truth is that of a simulated mirror, or FOLDER/lbt672/lbt672-feedforward.fits made symmetric and
balanced, divided by a known alpha that scatters by 5 %. Noise of 0.02, 0.05 and 0.1 %: proportional
to each element, equal in all elements, both with half of the variance, or different at each sensor
(by a factor of two). Prints the rms error of alpha, the stated error, the coverage of 95 %
intervals with its Monte Carlo error, e'C^-1 e / number of patterns (1 if C is the covariance of the
errors e), bad actuators missed, sound ones excluded, seeds refused, seeds in which `auto` used
`ml`, and for the others the ratio of actual and stated rms error of sensor gains and positions.
--faults: the same with bad actuators and 0.02 % of equal noise. --first: the first seed; --laws,
--levels (%): a selection of the noise. --annular: the simulated stiffness is that read by annular
sensors.
"""

import argparse
import datetime
import os
from dataclasses import replace
from pathlib import Path

import numpy as np

import truenewton as tn
from truenewton.bench.simulated.static import static_bench
from truenewton.calibration.methods import METHODS, Options
from truenewton.errors import TrueNewtonError
from truenewton.estimation.findings.estimate import Sensor
from truenewton.estimation.matrix.misfits import condensed
from truenewton.estimation.matrix.modes import column_fit, columns_of
from truenewton.estimation.matrix.screen import screen_matrix
from truenewton.records.stiffness_matrix import StiffnessMatrix
from truenewton.statics.arms import arms

LEVELS = (2e-4, 5e-4, 1e-3)
LAWS = ("proportional", "equal", "mixed", "by sensor")
FAULTS = ("sign", "times ten", "element", "own element", "rows exchanged", "exchanged", "off",
          "zeroed", "sensor gain", "sensor noise")  # fmt: skip


def measured_lbt672():
    """Return the measured LBT672."""
    return tn.read(Path(os.environ["TRUENEWTON_REAL_DATA"]) / "lbt672" / "lbt672-feedforward.fits")


def without_polynomial(values, layout, degree=6):
    """Return values without a polynomial of x and y, that is differences between neighbours."""
    x, y = (at[layout.enabled] / 0.45 for at in (layout.x, layout.y))
    powers = [(i, j) for i in range(degree + 1) for j in range(degree + 1 - i)]
    terms = np.stack([x**i * y**j for i, j in powers], axis=1)
    return values - terms @ np.linalg.lstsq(terms, np.asarray(values), rcond=None)[0]


def measured_or_made(mirror):
    """Return the measured LBT672 if its folder is given, otherwise a simulated mirror."""
    if mirror == "lbt672" and "TRUENEWTON_REAL_DATA" in os.environ:
        return measured_lbt672()
    nominal = tn.mirrors.ring(60) if mirror == "ring60" else getattr(tn.mirrors, mirror)()
    truth = static_bench(nominal, 1).truth
    date = datetime.datetime(2026, 5, 6, tzinfo=datetime.UTC)
    return StiffnessMatrix(mirror.upper(), date, truth.layout, truth.stiffness)


def true_stiffness(matrix):
    """Return the nearest symmetric stiffness whose rigid-body motions require no force."""
    k, rigid = matrix.stiffness, np.linalg.qr(arms(matrix.layout).T)[0]
    elastic = np.eye(len(k)) - rigid @ rigid.T
    return elastic @ (0.5 * (k + k.T)) @ elastic


def noisy(matrix, k, seed, law, level):
    """Return the true alpha and a measured matrix."""
    random = np.random.default_rng(seed)
    alpha = 1.0 + 0.05 * random.standard_normal(len(k))
    commanded = k / alpha[:, None]
    noise = random.standard_normal(k.shape)
    fraction = {"proportional": 1.0, "mixed": 0.5}.get(law, 0.0)
    noise *= np.sqrt(fraction * commanded**2 + (1.0 - fraction) * np.mean(commanded**2))
    if law == "by sensor":
        noise *= np.exp(0.7 * random.standard_normal(len(k)))
    return alpha, replace(matrix, stiffness=commanded + level * noise)


def with_faults(matrix, seed, count, fault):
    """Return the matrix with bad actuators, and their indices; fifteen are in one sector."""
    random, k, n = np.random.default_rng([9, seed]), matrix.stiffness.copy(), matrix.layout.n
    x, y = matrix.layout.x, matrix.layout.y
    distance = np.hypot(x[:, None] - x, y[:, None] - y)
    bad = random.choice(n, count, replace=False)
    if count >= 15:
        bad = np.argsort(distance[bad[0]])[:count]
    order, good = np.arange(n), ~np.isin(np.arange(n), bad)
    if fault == "off":
        k[np.ix_(good, good)] = condensed(k, good)[0]
    for i in bad:
        j = np.argsort(distance[i])[1]
        if fault == "sign":
            k[i] *= -1.0
        elif fault == "times ten":
            k[i] *= 10.0
        elif fault == "element":
            k[i, j] *= 1.2
        elif fault == "own element":
            k[i, i] *= 1.2
        elif fault == "sensor gain":
            k[:, i] *= 1.5
        elif fault == "sensor noise":
            k[:, i] *= 3.0 * (1.0 + 0.3 * random.standard_normal(n))
        elif fault in ("off", "zeroed"):
            k[i] = k[:, i] = 0.0
        elif order[i] == i and order[j] == j:
            order[[i, j]] = order[[j, i]]
    if "exchanged" in fault:
        k = k[order]
        k = k if fault == "rows exchanged" else k[:, order]
        bad = np.flatnonzero(order != np.arange(n))
    return replace(matrix, stiffness=k), {int(i) for i in bad}


def judged(alpha, matrix, bad=frozenset(), *, method="ml", population=False):
    """Return error, stated error, coverage, chi2, missed, falsely excluded, by ml, sensors."""
    sensors: tuple[Sensor, ...] = ()
    try:
        screened = screen_matrix(matrix)
        if method == "ml":
            fit = column_fit(columns_of(screened), population=population)
            found, covariance, by_ml = fit.alpha, fit.covariance, True
        else:
            estimate, _ = METHODS[method].of_stiffness(screened, Options())
            found, covariance = estimate.values, estimate.reading_covariance
            by_ml, sensors = estimate.method == "ml", estimate.sensors
    except TrueNewtonError:
        return (np.nan,) * 9
    on = screened.matrix.layout.enabled
    error, stated = found - alpha[on] / alpha[on].mean(), np.sqrt(np.diag(covariance))
    covered, out = np.mean(np.abs(error) < 1.96 * stated), set(np.flatnonzero(~on).tolist())
    rms = np.sqrt(np.mean(error**2)), np.sqrt(np.mean(stated**2))
    counts = len(bad - out), len(out - bad), by_ml
    return *rms, covered, chi2(error, covariance), *counts, *of_sensors(sensors)


def of_sensors(sensors):
    """Return mean squares of error / stated error of gains and positions; true gains are 1."""
    fitted = [each for each in sensors if each.state == "fitted" and each.gain_error]
    gain = [(each.gain - 1.0) / each.gain_error for each in fitted]
    place = [(each.x / each.x_error, each.y / each.y_error) for each in fitted if each.x_error]
    return tuple(np.mean(np.square(some)) if some else np.nan for some in (gain, place))


def chi2(error, covariance):
    """Return e'C^-1 e / number of patterns, without the scale, which has no error."""
    values, vectors = np.linalg.eigh(covariance)
    real = values > 1e-9 * values[-1]
    return np.mean((error @ vectors[:, real]) ** 2 / values[real])


def line(name, rows):
    """Print the means over seeds."""
    rows = np.array(rows)
    kept = rows[~np.isnan(rows[:, 0])]
    if not len(kept):
        print(f"  {name:36} refused", flush=True)
        return
    error, stated, covered, square, missed, lost, by_ml, *_ = kept.mean(axis=0)
    used = kept[kept[:, 6] == 0.0, 7:]
    sensors = "  ".join(f"{each:5.2f}" for each in np.sqrt(used.mean(axis=0))) if len(used) else ""
    sure = kept[:, 2].std(ddof=1) / np.sqrt(len(kept)) if len(kept) > 1 else np.nan
    print(f"  {name:36} {100 * error:6.3f}  {100 * stated:6.3f}  {100 * covered:5.1f} +-"
          f" {100 * sure:3.1f}  {square:5.2f}  {missed:6.2f}  {lost:5.2f}"
          f"  {len(rows) - len(kept):3d}      {by_ml * len(kept):3.0f}  {sensors}",
          flush=True)  # fmt: skip


def main():
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--levels", nargs="+", type=float, default=[100 * each for each in LEVELS])
    parser.add_argument("--laws", nargs="+", choices=LAWS, default=LAWS)
    parser.add_argument("--faults", action="store_true")
    parser.add_argument("--annular", action="store_true")
    parser.add_argument("--mirror", choices=("lbt672", "mmt336", "p45", "ring60"), default="lbt672")
    parser.add_argument("--method", choices=("ml", "auto"), default="ml")
    options = parser.parse_args()
    seeds = range(options.first, options.first + options.seeds)
    matrix = measured_or_made(options.mirror)
    k = matrix.stiffness if options.annular else true_stiffness(matrix)
    print(
        f"{'':38} error  stated   covered      chi2  missed   lost  refused   ml"
        "   gain  place   (%, actuators, seeds)"
    )
    if options.faults:
        for fault in FAULTS:
            for count in (1, 5, 15):
                rows = []
                for seed in seeds:
                    alpha, measured = noisy(matrix, k, seed, "equal", 2e-4)
                    wrong = with_faults(measured, seed, count, fault)
                    rows.append(judged(alpha, *wrong, method=options.method))
                line(f"{fault}, {count}", rows)
        return
    for law in options.laws:
        for level in (each / 100 for each in options.levels):
            for population in (False, True)[: 2 if options.method == "ml" else 1]:
                rows = [
                    judged(*noisy(matrix, k, seed, law, level), method=options.method,
                           population=population)
                    for seed in seeds
                ]  # fmt: skip
                line(f"{law}, {100 * level:g} %{', population' if population else ''}", rows)


if __name__ == "__main__":
    main()
