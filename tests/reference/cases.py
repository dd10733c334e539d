"""The cases whose results are recorded: each a function of nothing, seeded, to a result.

To add a case, write a function and decorate it with `case`.
"""

from __future__ import annotations

import datetime
import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

import truenewton as tn
from helpers.balanced import gradients, three_loads
from helpers.segmented import in_one, pieces
from helpers.tracked import MEAN_K, campaign_at, days_of, pattern
from studies.faults import day_with_fault
from studies.faulty.fault import FAULTS
from studies.matrices import FAULTS as MATRIX_FAULTS
from studies.matrices import LAWS, measured_or_made, noisy, true_stiffness, with_faults
from studies.simulated_matrices import by_glass, drawn, hexagon, springs
from truenewton.acquisition.plan import CampaignPlan
from truenewton.bench.simulated.static import loop_of, run_cycles, static_bench
from truenewton.mirrors.known import mmt336, p45
from truenewton.mirrors.shell.shell_model import model_shell
from truenewton.modal.findings import find_modes
from truenewton.planning.forces import prepared_bodies
from truenewton.planning.plan_prediction import predict_errors

Array = np.ndarray
DATE = datetime.datetime(2026, 5, 6, tzinfo=datetime.UTC)


@dataclass(frozen=True, eq=False)
class Result:
    """What is recorded of a case.

    Attributes
    ----------
    sentences
        Verdict, findings, warnings: a line each.
    ids
        (n,) names of the rows.
    columns
        By name (n,) numbers: first the values, then their standard uncertainty, then others.
    """

    sentences: tuple[str, ...]
    ids: tuple[int, ...] = ()
    columns: dict[str, Array] | None = None


# Of the stated error. Sums in another order, another processor or number of threads move alpha by
# less; one part in a million of alpha is more wherever E_STAT is below 1 %.
TOLERANCE = 1e-4


@dataclass(frozen=True)
class Case:
    """How a result is made, and how it is recorded.

    Attributes
    ----------
    make
        A function of nothing.
    file
        The name of a file that several small cases share; otherwise empty.
    fast
        Whether it belongs to `make test`.
    tolerance
        Largest change of a value, in units of its error.
    """

    make: Callable[[], Any]
    file: str = ""
    fast: bool = False
    tolerance: float = TOLERANCE


CASES: dict[str, Case] = {}


def case(
    name: str, *, file: str = "", fast: bool = False, tolerance: float = TOLERANCE
) -> Callable[[Callable[[], Any]], Callable[[], Any]]:
    """List a function under a name."""

    def listed(make: Callable[[], Any]) -> Callable[[], Any]:
        assert name not in CASES, name
        CASES[name] = Case(make, file, fast, tolerance)
        return make

    return listed


def small(about: str, cases: dict[str, Callable[[], Any]], *, tolerance: float = TOLERANCE) -> None:
    """List cases of a fraction of a second each, all in one file; of alpha three sums are kept."""
    for name, make in cases.items():
        case(f"small {about}: {name}", file=f"small {about}", fast=True, tolerance=tolerance)(
            lambda make=make: folded(result_of(make()), 3)
        )


def result_of(made: Any) -> Result:
    """Return what is recorded of what a case made."""
    if isinstance(made, Result):
        return made
    if isinstance(made, list):
        parts = [result_of(one) for one in made]
        names = parts[0].columns
        return Result(
            tuple(line for part in parts for line in part.sentences),
            tuple(i for part in parts for i in part.ids),
            {name: np.concatenate([part.columns[name] for part in parts]) for name in names},
        )
    if isinstance(made, tn.Calibration):
        return calibration_result(made)
    return calibration_result(tn.calibrate(made))


def verdict_lines(verdict: Any) -> tuple[str, ...]:
    return f"verdict: {verdict.level}", *map(finding_line, verdict.findings)


def finding_line(finding: Any) -> str:
    """Return a finding as data: a sentence may be reworded, and nothing else changes."""
    assert finding.fault  # its sentence can be made of its values
    codes, one, numbers = [], finding, []
    while one is not None:
        codes.append(str(one.code))
        numbers += [f"{name}={_short(value)}" for name, value in one.values.items()]
        one = one.cause
    if finding.size:
        numbers.append(f"size={_short(finding.size)}{finding.unit and ' '}{finding.unit}")
    done = " corrected" if finding.corrected else ""
    about = " ".join(map(str, finding.actuators))
    parts = (f"{finding.level} {' of '.join(codes)}{done}", finding.detail, about, finding.where,
             ", ".join(numbers))  # fmt: skip
    return f"finding: {' | '.join(filter(None, parts))}"


def _short(value: Any) -> str:
    if not isinstance(value, float):
        return str(value)
    point = "." if 99.95 <= abs(value) < 999.5 else ""  # no count, which must not change
    return f"{value:.3g}{point}"


def calibration_result(c: tn.Calibration) -> Result:
    on = c.layout.enabled
    sentences = (
        f"method: {c.method}",
        *verdict_lines(c.verdict),
        f"rejected rows: {c.rejected}",
    )
    columns = {
        "ALPHA": c.alpha[on],
        "E_STAT": c.statistical_error[on],
        "E_SYST": c.systematic_error[on],
    }
    return Result(sentences, tuple(c.layout.id[on].tolist()), columns)


def folded(whole: Result, count: int) -> Result:
    """Return the first terms of the cosine series of alpha, with its rms errors."""
    if whole.columns is None:
        return whole
    n = len(whole.ids)
    waves = np.cos(np.pi * np.outer(np.arange(count), np.arange(n) + 0.5) / n) / np.sqrt(n)
    columns = {
        name: waves @ values
        if name == "ALPHA"
        else np.full(count, float(np.sqrt(np.mean(values**2))))
        for name, values in whole.columns.items()
    }
    return Result(whole.sentences, tuple(range(count)), columns)


# -- campaigns of P45 and others ------------------------------------------------------------------


def p45_cycles(noise: float, cycles: int = 2, **changes: Any) -> tn.Campaign:
    bench = static_bench(p45(), 3, force_noise=noise)
    return tn.Campaign(tuple(replace(c, **changes) for c in run_cycles(bench, cycles)))


for _name, _noise in (("clean", 1e-6), ("0.1 mN", 1e-4), ("1 mN", 1e-3), ("10 mN", 1e-2)):
    case(f"p45, {_name}", fast=True)(lambda noise=_noise: p45_cycles(noise))
case("p45, without positions", fast=True)(lambda: p45_cycles(1e-4, position=None))
case("p45, svd", fast=True)(lambda: tn.calibrate(p45_cycles(1e-4), "svd"))
case("a tilt as a load", fast=True)(lambda: three_loads(3, 1e-4))
case("gradients and positions", fast=True)(lambda: gradients(3, 1e-4, 1e-7)[0])
case("mmt336")(
    lambda: tn.Campaign(tuple(run_cycles(static_bench(mmt336(), 3, force_noise=1e-3), 1)))
)


@case("closed loop", tolerance=0.1)  # steps of its electronics flip
def closed_loop() -> tn.Campaign:
    bench = static_bench(p45(), 2)
    return tn.Campaign(tuple(run_cycles(bench, 1, loop_of(bench))))


@case("segments as of m4", fast=True)
def segments() -> list[tn.Calibration]:
    cycles = in_one(pieces(3)[0])
    return [tn.calibrate([cycle.of_segment(k) for cycle in cycles]) for k in (1, 2, 3)]


QUICK = {"clean", "all alphas drift 0.3 %/h", "two far cables swapped", "a dead actuator"}
for _fault in FAULTS:
    case(f"fault, {_fault.name}", fast=_fault.name in QUICK)(
        lambda fault=_fault: day_with_fault(fault, "p45", 0, 1e-4, 3).campaign()
    )


# -- stiffness matrices ---------------------------------------------------------------------------


def p45_matrix(law: str = "equal", level: float = 5e-4) -> tn.StiffnessMatrix:
    made = measured_or_made("p45")
    return noisy(made, true_stiffness(made), 5, law, level)[1]


for _law in LAWS:
    case(f"matrix, noise {_law}", fast=_law == "equal")(lambda law=_law: p45_matrix(law))
case("matrix, by ml", fast=True)(lambda: tn.calibrate(p45_matrix(), "ml"))
case("matrix, by svd", fast=True)(lambda: tn.calibrate(p45_matrix(), "svd"))
for _kind in MATRIX_FAULTS:
    case(f"matrix, {_kind}")(lambda kind=_kind: with_faults(p45_matrix(), 5, 1, kind)[0])


@case("matrix, cleaned", fast=True)
def cleaned() -> tn.StiffnessMatrix:
    matrix = p45_matrix()
    rigid = np.linalg.qr(np.stack([matrix.layout.nz, matrix.layout.x, matrix.layout.y], 1))[0]
    k = matrix.stiffness - rigid @ (rigid.T @ matrix.stiffness)
    return replace(matrix, stiffness=np.round(k - (k @ rigid) @ rigid.T, -2))


def noisy_elements(layout: tn.Layout, k: Array, level: float = 2e-4) -> tn.StiffnessMatrix:
    """Return a matrix with noise of its elements: that of modes depends on how they were found."""
    noise = np.random.default_rng(7).standard_normal(k.shape)
    return tn.StiffnessMatrix("REFERENCE", DATE, layout, k * (1.0 + level * noise))


def annuli(offset: float = 0.0, level: float = 2e-4) -> tn.StiffnessMatrix:
    """Return P45's matrix by its annular sensors, their rms offset from their magnets [m]."""
    values = drawn(np.random.default_rng(11), 45, 0.004, offset)
    return noisy_elements(p45().layout, by_glass(model_shell(p45()), values), level)


@case("matrix, hexagon of 37")
def hex37() -> tn.StiffnessMatrix:
    layout = hexagon(3)
    k = springs(layout, lambda square: square * np.log(square) / (480.0 * np.pi))
    alpha = np.exp(drawn(np.random.default_rng(12), 37).log_alpha)
    return noisy_elements(layout, 0.5 * (k + k.T) / alpha[:, None])


def changed(change: Callable[[Array], Array]) -> tn.StiffnessMatrix:
    matrix = annuli()
    return replace(matrix, stiffness=change(matrix.stiffness))


case("matrix, annular sensors")(annuli)
case("matrix, annular sensors 0.5 mm off")(lambda: annuli(5e-4))
case("matrix, made symmetric")(lambda: changed(lambda k: 0.5 * (k + k.T)))
case("matrix, transposed")(lambda: changed(lambda k: k.T))
case("matrix, of the other sign")(lambda: changed(lambda k: -k))
case("matrix, in N/um")(lambda: changed(lambda k: 1e-6 * k))
case("matrix, in another order")(lambda: changed(lambda k: np.roll(k, 1, axis=0)))
case("matrix, 5 % of asymmetry")(lambda: annuli(level=0.05))


@case("matrix, measured lbt672")
def lbt672() -> Result | None:
    """Nothing but sums of alpha is recorded of a measured mirror."""
    folder = os.environ.get("TRUENEWTON_REAL_DATA")
    if folder is None:
        return None
    c = tn.calibrate(tn.read(Path(folder) / "lbt672" / "lbt672-feedforward.fits"))
    whole = folded(calibration_result(c), 12)
    columns = {name: whole.columns[name] for name in ("ALPHA", "E_STAT")}
    return replace(whole, columns=columns)


# -- what is made of calibrations -----------------------------------------------------------------


@case("law of six days")
def law() -> Result:
    found = tn.track(*(tn.calibrate(day) for day in days_of(3, MEAN_K)))
    sentences = (f"effects: {' '.join(found.effects)}", *(f"limit: {x}" for x in found.limits))
    n = found.layout.n
    error = np.sqrt(np.diag(found.covariance))
    columns = {
        "COEFFICIENT": found.coefficient,
        "ERROR": error[n : 2 * n],
        "ALPHA": found.alpha,
        "E_ALPHA": error[:n],
    }
    return Result(sentences, tuple(found.layout.id.tolist()), columns)


@case("recalibration", fast=True)
def recalibration() -> tn.Calibration:
    factor = np.ones(45)
    factor[16] = 0.8
    short = campaign_at(factor, np.random.default_rng(4), cycles=1, loads=1)
    return tn.recalibrate(short, replace(pattern(), sources=()), [17]).calibration


@case("plan", fast=True)
def plan() -> Result:
    loads = (tn.Load("bare"), tn.Load("ring", -0.289, 0.005, tool="ring"))
    found = predict_errors(prepared_bodies(CampaignPlan("p45", loads))[0])
    sentences = tuple(f"{line.source}: {line.relative:.6g}" for line in found.scale_errors)
    columns = {
        "ALPHA": found.alpha,
        "E_STAT": found.statistical_error,
        "E_SYST": found.systematic_error,
    }
    return Result(sentences, tuple(found.layout.id.tolist()), columns)


@case("modal base", fast=True)
def modal_base() -> Result:
    campaign = p45_cycles(2e-5)
    found = find_modes(campaign, tn.calibrate(campaign))
    stiffness = found.after.modes.stiffness
    sentences = tuple(f"warning: {each.fault}; {each.remedy}" for each in found.warnings)
    columns = {"STIFFNESS": stiffness, "SIZE": stiffness}  # its own size is the scale
    return Result(sentences, tuple(range(1, len(stiffness) + 1)), columns)
