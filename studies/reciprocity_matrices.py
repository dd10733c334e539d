"""Reciprocity with simulated, foreign, large and measured matrices (see `reciprocity.py`)."""

import time
import warnings
from collections import Counter
from dataclasses import replace
from typing import Any

import numpy as np

from studies.matrices import measured_lbt672, without_polynomial
from studies.simulated_matrices import bound as bound_of_matrix
from studies.simulated_matrices import by_glass, by_plate, drawn, foreign
from studies.simulated_matrices import measured as with_noise
from truenewton.bench.simulated.static import START
from truenewton.calibration.methods import calibrate
from truenewton.errors import TrueNewtonError
from truenewton.estimation.matrix.facts import MatrixFacts
from truenewton.estimation.reciprocity.acceptance import refusals
from truenewton.estimation.reciprocity.matrix import examined, fit_jointly, fit_roughly, modes_of
from truenewton.estimation.reciprocity.sensor_model import (
    START_REQUEST,
    Kind,
    Request,
    places_of,
    sensors_at,
)
from truenewton.linalg import asymmetry
from truenewton.mirrors.known import lbt672, p45
from truenewton.mirrors.sensor_model import model_sensors
from truenewton.mirrors.shell.shell_model import model_shell
from truenewton.records.stiffness_matrix import StiffnessMatrix
from truenewton.statics.arms import arms
from truenewton.statics.layout import layout as actuators_at


def matrix_of(
    random, glass, layout, *, gain=0.004, offset=0.0, asymmetry=0.0, balanced=True, dead=0
):
    """Return a stiffness measured in 8 readings with 1 mN of noise, and log alpha.

    ``asymmetry`` is that of each element, relative. If ``balanced``, forces still balance and
    rigid-body motions require no force.
    """
    n = layout.n
    values = drawn(random, n, gain, offset)
    stiffness = 0.5 * (glass.stiffness + glass.stiffness.T)
    wrong = asymmetry * random.standard_normal((n, n)) * stiffness
    if balanced:
        rigid = np.linalg.qr(arms(layout).T)[0]
        elastic = np.eye(n) - rigid @ rigid.T
        wrong = elastic @ wrong @ elastic
    stiffness = stiffness + wrong
    motion = sensors_at(places_of(layout), values, slopes=bool(offset)).motion
    stiffness = stiffness @ (motion * values.gain) / values.alpha[:, None]
    stiffness = with_noise(random, stiffness, values).stiffness
    if dead:
        some = random.choice(n, dead, replace=False)
        stiffness[:, some] = stiffness[:, some] @ random.standard_normal((dead, dead))
    return stiffness, values.log_alpha


FAULTS: dict[str, dict[str, Any]] = {
    "clean": {},
    "offsets 0.5 mm": {"offset": 5e-4},
    "offsets 1 mm": {"offset": 1e-3},
    "offsets 3 mm": {"offset": 3e-3},
    "asymmetry 1e-3": {"asymmetry": 1e-3},
    "asymmetry 3e-3": {"asymmetry": 3e-3},
    "asymmetry 1e-2": {"asymmetry": 1e-2},
    "asymmetry 3e-2": {"asymmetry": 3e-2},
    "1e-2, unbalanced": {"asymmetry": 1e-2, "balanced": False},
    "gains 2 %": {"gain": 0.02},
    "10 sensors dead": {"dead": 10},
}


def gate(seeds):
    """Print decisions of `auto` on faulty stiffnesses; good: better than balance alone."""
    mirror = p45()
    glass = model_shell(mirror)
    print(f"{'':<18}joint      balance    apart   good  accepted  falsely  rejected falsely")
    for name, options in FAULTS.items():
        rows = []
        for seed in range(seeds):
            random = np.random.default_rng([seed, 7])
            stiffness, alpha = matrix_of(random, glass, mirror.layout, **options)
            matrix = StiffnessMatrix("P45", START, mirror.layout, stiffness)
            modes = modes_of(matrix.layout, MatrixFacts.of(matrix))
            truth = alpha - alpha.mean()
            alone = np.nan
            try:
                alone = np.std(modes.fit(Request(), balance=True).values.log_alpha - truth)
                found = examined(modes, *fit_jointly(modes, fit_roughly(modes)))
            except TrueNewtonError:
                rows.append((np.nan, alone, np.nan, False))
                continue
            joint = np.std(found.joint.values.log_alpha - truth)
            rows.append((joint, alone, found.evidence.apart, chosen(matrix) == "reciprocity"))
        joint, alone, apart, accepted = np.array(rows).T
        middle = [
            np.median(x[~np.isnan(x)]) if not np.isnan(x).all() else np.nan
            for x in (joint, alone, apart)
        ]
        good, accepted = (joint < alone) | (np.isfinite(joint) & np.isnan(alone)), accepted > 0
        print(
            f"{name:<18}{middle[0]:.2e}   {middle[1]:.2e}   "
            f"{middle[2]:5.1f}   {good.sum():4d}  {accepted.sum():8d}  "
            f"{(accepted & ~good).sum():7d}  {(good & ~accepted).sum():7d}"
        )


def chosen(matrix):
    """Return the method that `auto` uses, or an empty text if it refuses."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            return calibrate(matrix).method
        except TrueNewtonError:
            return ""


OF_THE_GATE = ("reciproc", "balance worse", "off their magnets")


def fate(matrix, method, truth):
    """Return outcome, message, error, stated error, coverage and duration of a calibration."""
    begin = time.process_time()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            made = calibrate(matrix, method)
        except TrueNewtonError as refusal:
            seconds = time.process_time() - begin
            return "refused", f"{refusal.fault}", np.nan, np.nan, np.nan, seconds
    seconds = time.process_time() - begin
    error, stated = np.log(made.alpha) - truth, made.statistical_error / made.alpha
    some = np.isfinite(error) & (stated > 0.0)
    error = error - np.mean(error[some])
    faults = [each.fault for each in made.verdict.findings]
    return (
        f"{made.method}, {made.verdict.level}",
        next((f for f in faults if any(word in f for word in OF_THE_GATE)), "".join(faults[:1])),
        np.sqrt(np.mean(error[some] ** 2)),
        np.sqrt(np.mean(stated[some] ** 2)),
        np.mean(np.abs(error[some]) < 1.96 * stated[some]),
        seconds,
    )  # fmt: skip


def foreign_matrices(seeds):
    """Print the outcomes for matrices that were not made for this package."""
    print("matrix | method | outcome | rms | stated | coverage | seconds | what is said")
    for name, make in foreign(START):
        for method in ("ml", "auto", "reciprocity"):
            rows = [fate(matrix, method, truth) for matrix, truth in map(make, range(seeds))]
            outcomes = Counter(row[0] for row in rows)
            ends = ", ".join(f"{count} {what}" for what, count in outcomes.most_common())
            numbers = np.array([row[2:5] for row in rows])
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # means of empty arrays
                rms, stated, inside = np.nanmean(numbers, axis=0)
            reason = "" if method == "ml" else rows[0][1]
            print(
                f"{name} | {method} | {ends} | {rms:.1e} | {stated:.1e} | {inside:.2f}"
                f" | {max(row[5] for row in rows):.1f} | {reason}",
                flush=True,
            )


def real():
    """Print residuals of a measured LBT672, without and with a model of its glass."""
    matrix = measured_lbt672()
    print("without a model of the glass")
    examine(matrix)
    print("the glass as LBT672 has it")
    examine(matrix, model_sensors(model_shell(replace(lbt672(), layout=matrix.layout))))


def examine(matrix, motion=None):
    """Print residuals of a measured matrix."""
    cpu, layout = time.process_time(), matrix.layout
    modes = modes_of(matrix.layout, MatrixFacts.of(matrix), motion)
    found = examined(modes, *fit_jointly(modes, fit_roughly(modes)))
    n, unknowns = modes.places.n, len(found.joint.covariance)
    print(
        f"{n} actuators, {unknowns} unknowns; with halves and each alone"
        f" {time.process_time() - cpu:.0f} s of processor"
    )
    for line in found.imbalances:
        print(f"    imbalance, {line.modes:<32}{line.before:.4f} -> {line.after:.4f}")
    before, after = map(asymmetry, (matrix.used_stiffness, found.joint.point.left.work))
    evidence = found.evidence
    print(f"    asymmetry {before:.4f} -> {after:.4f}")
    one, other = found.halves
    print(
        f"    halves differ by {np.std(one - other):.4f} rms, without degree 6 and below by"
        f" {np.std(without_polynomial(one - other, layout)):.4f}"
    )
    formal, stated = (
        np.sqrt(np.mean(np.diag(each)))
        for each in (found.joint.covariance_of(Kind.ALPHA), found.covariance)
    )
    print(f"    formal error {formal:.4f}, E_STAT {stated:.4f}")
    print(f"    held out {evidence.held_out:.4f}, by balance alone {evidence.by_balance:.4f}")
    alone, apart = found.alone, [without_polynomial(each, layout) for each in found.alone]
    print(
        f"    balance alone against reciprocity alone: r {np.corrcoef(*alone)[0, 1]:.3f}, without"
        f" degree 6 and below {np.corrcoef(*apart)[0, 1]:.3f}, chi2/DOF {evidence.apart:.2f}"
    )
    print(
        f"    gains spread by {evidence.gain_spread:.4f}, offsets by"
        f" {1e3 * evidence.offset_spread:.2f} mm"
    )
    print(f"    refused because: {[each.fault for each in refusals(evidence)] or 'accepted'}")


def large():
    """Print error, bound and coverage of stiffnesses of LBT672 with 650 of its actuators."""
    whole = lbt672()
    some = np.sort(np.random.default_rng(1).choice(whole.layout.n, 650, replace=False))
    at = actuators_at(*(getattr(whole.layout, name)[some] for name in ("x", "y")),
                      nz=whole.layout.nz[some])  # fmt: skip
    glass = model_shell(replace(whole, layout=at))
    cases = (
        ("plate, 1 mN, 1 um at most", None, 1e-3, 1e-6),
        ("plate, 0.3 mN, 1 um at most", None, 3e-4, 1e-6),
        ("shell, annuli, 1 mN at 0.4 N", "without", 1e-3, np.inf),
        ("the same, glass known", "with", 1e-3, np.inf),
    )
    print(f"{'':<32}rms      bound    /bound  formal  coverage  E_STAT   coverage")
    for name, shell, noise, stroke in cases:
        random = np.random.default_rng([0, 7])
        values = drawn(random, at.n, offset=5e-4)
        exact = by_glass(glass, values) if shell else by_plate(at, glass.stiffness, values)
        made = with_noise(random, exact, values, noise, stroke)
        motion = model_sensors(glass) if shell == "with" else None
        matrix = StiffnessMatrix("LBT672", START, at, made.stiffness)
        modes = modes_of(matrix.layout, MatrixFacts.of(matrix), motion)
        found = examined(modes, *fit_jointly(modes, fit_roughly(modes)))
        least = bound_of_matrix(made, at, START_REQUEST, motion)
        error = found.joint.values.log_alpha - values.log_alpha
        error -= error.mean()
        formal, stated = (
            np.sqrt(np.diag(each))
            for each in (found.joint.covariance_of(Kind.ALPHA), found.covariance)
        )
        inside, by_stated = (np.mean(np.abs(error) < 1.96 * each) for each in (formal, stated))
        size = np.sqrt(np.mean(stated**2))
        print(
            f"{name:<32}{np.std(error):.5f}  {least:.5f}  {np.std(error) / least:.3f}  "
            f" {np.sqrt(np.mean(formal**2)):.5f}  {inside:.3f}     {size:.5f}  {by_stated:.3f}"
            f"   halves {np.std(found.halves[0] - found.halves[1]):.5f},"
            f" apart {found.evidence.apart:.2f}",
            flush=True,
        )
