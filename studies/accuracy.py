"""How near to the Cramer-Rao bound alpha comes, by Monte Carlo.

    python -m studies.accuracy [--campaigns 1000] [--noise 1e-3]     P45, all methods
    python -m studies.accuracy --mirror 336 [--campaigns 20]         336 actuators on rings, ml

Every campaign has its own noise and true weights, drawn from the declared weights and their errors.
Two loads determine only the difference of their weights, so alpha is proportional to Q. Alpha times
true Q / declared Q is therefore the estimate with known weights; its error is that of the readings.
The bound is computed from the noiseless truth and the explicit Jacobian of every shape.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg

import truenewton as tn
from truenewton.bench.simulated.static import START, StaticBench, static_bench
from truenewton.errors import TrueNewtonError
from truenewton.estimation.findings.estimate import weight_errors
from truenewton.estimation.paper import svd as paper_svd
from truenewton.estimation.paper.equations import Unknowns, system_e
from truenewton.mirrors.glass import Annulus, Shell
from truenewton.mirrors.known import GRAVITY, Mirror, p45
from truenewton.statics.arms import arms_in_units_of_rms, enabled_arms

SEED = 20081
TWO_SIGMA = 1.959964

Array = np.ndarray


@dataclass(frozen=True, eq=False)
class Simulation:
    """A bench with the declared weights, and the effect of an error of each weight.

    Attributes
    ----------
    bench
        The bench with all weights as declared.
    loads
        The loads with their errors.
    weight_error
        Error of the mirror's weight [N].
    elastic
        (rows, n) noiseless commanded forces of the shapes, without load forces [N].
    changes
        (errors, L, n) change of the load forces by one standard uncertainty of each weight [N].
    """

    bench: StaticBench
    loads: tuple[tn.Load, ...]
    weight_error: float
    elastic: Array
    changes: Array

    @property
    def alpha(self) -> Array:
        """(n,) true alpha."""
        return self.bench.truth.alpha

    def noiseless(self, load_force: Array) -> Array:
        """Return (L, rows, n) noiseless commanded forces under (L, n) load forces."""
        return self.elastic + (load_force / self.alpha)[:, None, :]


def simulation(mirror: Mirror, loads: Sequence[tn.Load], noise: float) -> Simulation:
    """Return the bench for all campaigns, whose forces are linear in the weights."""
    exact = replace(mirror, weight_error=0.0)
    sure = [replace(load, added_error=0.0) for load in loads]

    def bench(at: Mirror, under: Sequence[tn.Load]) -> StaticBench:
        return static_bench(at, SEED, loads=under, force_noise=noise)

    declared = bench(exact, sure)
    others = [bench(replace(exact, weight=mirror.weight + mirror.weight_error), sure)]
    for tool in dict.fromkeys(load.tool for load in loads if load.added_error):
        heavier = [
            replace(one, added=load.added + load.added_error) if load.tool == tool else one
            for one, load in zip(sure, loads, strict=True)
        ]
        others.append(bench(exact, heavier))
    shapes = np.repeat(declared.shapes, 2, axis=0) * np.tile([1, -1], len(declared.shapes))[:, None]
    return Simulation(
        bench=declared,
        loads=tuple(loads),
        weight_error=mirror.weight_error,
        elastic=shapes @ declared.truth.stiffness.T / declared.truth.alpha,
        changes=np.array([other.load_force - declared.load_force for other in others]),
    )


def campaigns(
    simulated: Simulation, cycles: int, count: int
) -> Iterator[tuple[tn.Campaign, float]]:
    """Yield campaigns, each with true Q / declared Q of the last load."""
    bench, layout = simulated.bench, simulated.bench.mirror.layout
    rows, n = simulated.elastic.shape
    for number in range(count):
        random = np.random.default_rng([SEED, number])
        weight_deviation = random.standard_normal(len(simulated.changes))
        load_force = bench.load_force + np.tensordot(weight_deviation, simulated.changes, axes=1)
        exact = simulated.noiseless(load_force)
        reading = exact[:, None] + bench.force_noise * random.standard_normal(
            (len(exact), cycles, rows, n)
        )
        made = [
            tn.Cycle(
                instrument=bench.mirror.name,
                date=START,
                number=cycle + 1,
                load=load,
                weight=bench.mirror.weight,
                weight_error=simulated.weight_error,
                layout=layout,
                time=0.5 * np.arange(rows, dtype=float),
                shape=np.repeat(np.arange(1, rows // 2 + 1), 2),
                sign=np.tile([1, -1], rows // 2),
                force=reading[place, cycle],
                valid=np.ones(rows, dtype=bool),
                force_error=bench.force_noise,
            )
            for place, load in enumerate(simulated.loads)
            for cycle in range(cycles)
        ]
        last = simulated.loads[-1]
        heavier = (last.added + weight_deviation[-1] * last.added_error) / last.added
        yield tn.Campaign(tuple(made)), heavier


def information_of(
    a: Array, alpha: Array, noise: float, shapes: Iterable[Array], beside: Array
) -> Array:
    """Return the information on alpha and m other unknowns: the sum of J' S^-1 J over shapes.

    ``shapes`` are (rows, n) forces under each load. ``beside`` are the derivatives (L, 3, m) of the
    balance with respect to the other unknowns.
    """
    root = np.linalg.inv(np.linalg.cholesky((a * alpha * noise**2) @ (a * alpha).T))
    n, total = len(alpha), len(alpha) + beside.shape[-1]
    information = np.zeros((total, total))
    for forces, beside_alpha in zip(shapes, beside, strict=True):
        jacobian = np.empty((len(forces), 3, total))
        jacobian[:, :, :n] = a * forces[:, None, :]
        jacobian[:, :, n:] = beside_alpha
        whitened = (root @ jacobian).reshape(-1, total)
        information += whitened.T @ whitened
    return information


def bounds(simulated: Simulation, cycles: int) -> tuple[Array, Array]:
    """Return the (n,) Cramer-Rao bounds of alpha, for known weights and for weights with errors.

    The unknown true forces of every shape under every load are eliminated. The information on
    alpha, B, the torques and the errors of the weights is then the sum of r J' S^-1 J over shapes.
    """
    bench, alpha = simulated.bench, simulated.alpha
    a, n, loads = enabled_arms(bench.mirror.layout), len(alpha), len(simulated.loads)
    shapes = simulated.noiseless(bench.load_force)
    errors = weight_errors(next(campaigns(simulated, 1, 1))[0])
    unknowns = Unknowns(n, loads, len(errors))
    beside = unknowns.external_load_derivative(tuple(errors.values()))
    information = cycles * information_of(a, alpha, bench.force_noise, shapes, beside)
    sure = unknowns.count
    known = np.linalg.inv(information[:sure, :sure])
    # Errors of the weights, which have a prior, change alpha' = (B, torques, alpha) by -I^-1 I_w.
    response = known @ information[:sure, sure:]
    reduced = information[sure:, sure:] - information[sure:, :sure] @ response
    spread = np.linalg.inv(np.eye(len(errors)) + reduced)
    measured = known + response @ spread @ response.T
    return np.sqrt(np.diag(known)[:n]), np.sqrt(np.diag(measured)[:n])


@dataclass(frozen=True, eq=False)
class Answer:
    """The result of a method for one campaign: (n,) alpha and errors, NaN if not estimated."""

    alpha: Array
    statistical_error: Array
    error: Array
    undetermined: int = 0


def by_ml(campaign: tn.Campaign) -> Answer:
    """Calibrate by maximum likelihood."""
    found = tn.calibrate(campaign)
    return Answer(found.alpha, found.statistical_error, found.error, found.diagnosis.undetermined)


def _least_squares(campaign: tn.Campaign, a: Array) -> Answer:
    solved = paper_svd.solve(*system_e(campaign, a))
    n = a.shape[1]
    reading_covariance = np.diag(paper_svd.scatter_covariance(campaign, solved))[:n]
    changes = paper_svd.weight_changes(campaign, solved, weight_errors(campaign))[:, :n]
    whole = reading_covariance + np.sum(changes**2, axis=0)
    return Answer(solved.solution[:n], np.sqrt(reading_covariance), np.sqrt(whole))


def by_svd(campaign: tn.Campaign) -> Answer:
    """Solve E alpha' = r as in the paper, with torques in N m."""
    return _least_squares(campaign, enabled_arms(campaign.layout))


def by_svd_at_best(campaign: tn.Campaign) -> Answer:
    """Solve E alpha' = r with each coordinate in units of its rms."""
    return _least_squares(campaign, arms_in_units_of_rms(campaign.layout))


def by_mixed_total_least_squares(campaign: tn.Campaign) -> Answer:
    """Solve E alpha' = r by total least squares with the columns of B, torques and r exact.

    QR eliminates the exact columns. The smallest singular vector of the rest is alpha except for
    its scale, which follows from the exact columns (Golub, Hoffman and Stewart 1987).
    """
    a = arms_in_units_of_rms(campaign.layout)
    e, r = system_e(campaign, a)
    n = a.shape[1]
    exact = np.column_stack([e[:, n:], -r])
    triangle = scipy.linalg.qr(np.column_stack([exact, e[:, :n]]), mode="r")[0]
    k = exact.shape[1]
    alpha = scipy.linalg.svd(triangle[k : k + n, k:])[2][-1]
    rest = scipy.linalg.solve_triangular(triangle[:k, :k], -triangle[:k, k:] @ alpha)
    missing = np.full(n, np.nan)
    return Answer(alpha / rest[-1], missing, missing)


METHODS: dict[str, Callable[[tn.Campaign], Answer]] = {
    "svd, torques in N m": by_svd,
    "svd, units of RMS": by_svd_at_best,
    "TLS, B torques r exact": by_mixed_total_least_squares,
    "ml": by_ml,
}


@dataclass(frozen=True, eq=False)
class Errors:
    """Errors of one method: (campaigns, n) errors of alpha, and stated errors."""

    known: Array  # with the weights known
    whole: Array
    statistical_error: Array
    error: Array
    undetermined: Array
    failures: tuple[str, ...]


def run(
    method: Callable[[tn.Campaign], Answer], simulated: Simulation, cycles: int, count: int
) -> Errors:
    """Run a method on the campaigns, the same ones for every method."""
    answers, scales, failures = [], [], []
    for number, (campaign, heavier) in enumerate(campaigns(simulated, cycles, count)):
        if number and number % 100 == 0:
            print(f"  {number} of {count}", file=sys.stderr)
        try:
            answers.append(method(campaign))
            scales.append(heavier)
        except TrueNewtonError as error:
            failures.append(f"campaign {number}: {type(error).__name__}: {error}")
    alpha = np.array([answer.alpha for answer in answers]).reshape(-1, len(simulated.alpha))
    return Errors(
        known=alpha * np.array(scales)[:, None] - simulated.alpha,
        whole=alpha - simulated.alpha,
        statistical_error=np.array([answer.statistical_error for answer in answers]),
        error=np.array([answer.error for answer in answers]),
        undetermined=np.array([answer.undetermined for answer in answers]),
        failures=tuple(failures),
    )


def rms(values: Array) -> float:
    """Return the root mean square."""
    return float(np.sqrt(np.mean(values**2)))


def ratio(errors: Array, bound: Array) -> str:
    """Return the ratio of rms error and bound over actuators, with its Monte Carlo error."""
    square = np.mean(errors**2, axis=1)
    value = np.sqrt(square.mean()) / rms(bound)
    if len(square) < 2:
        return f"{value:.3f}"
    uncertain = value * 0.5 * square.std(ddof=1) / np.sqrt(len(square)) / square.mean()
    digits = 1 if value > 10 else 3
    return f"{value:.{digits}f}+-{uncertain:.{digits}f}"


def coverage(errors: Array, stated: Array) -> str:
    """Return the coverage of 95 % intervals, with its Monte Carlo error."""
    if np.isnan(stated).all():
        return "-"
    inside = (np.abs(errors) < TWO_SIGMA * stated).mean(axis=1)
    uncertain = 100 * inside.std(ddof=1) / np.sqrt(len(inside))
    return f"{100 * inside.mean():.1f}+-{uncertain:.1f}"


HEADS = ("bias", "scatter", "bias/scatter", "scatter/bound", "error/bound", "covers %",
         "error/bound", "covers %")  # fmt: skip
WIDTHS = (9, 9, 13, 14, 15, 11, 15, 11)


def print_head(first: str) -> None:
    """Print the column headings."""
    print(f"{'':38s}{'-- weights known (E_STAT) ':-<71s} {'- weights redrawn (E_ALPHA) ':->26s}")
    names = "".join(f"{head:>{width}s}" for head, width in zip(HEADS, WIDTHS, strict=True))
    print(f"{first:30s}{'runs':>8s}{names}")


def print_line(name: str, found: Errors, bound: tuple[Array, Array]) -> None:
    """Print the figures of one method."""
    bias = rms(found.known.mean(axis=0))
    scatter = rms(found.known.std(axis=0, ddof=1))
    cells = (
        f"{bias:.2e}", f"{scatter:.2e}", f"{bias / scatter:.3f}", f"{scatter / rms(bound[0]):.3f}",
        ratio(found.known, bound[0]), coverage(found.known, found.statistical_error),
        ratio(found.whole, bound[1]), coverage(found.whole, found.error),
    )  # fmt: skip
    line = "".join(f"{cell:>{width}s}" for cell, width in zip(cells, WIDTHS, strict=True))
    print(f"{name:30s}{len(found.known):8d}{line}", flush=True)
    for failure in found.failures[:3]:
        print(f"    failed, {len(found.failures)} in all: {failure}", flush=True)


def compare_methods(count: int, noise: float) -> None:
    """Print the table of all methods on P45."""
    mirror, cycles = p45(), 4
    simulated = simulation(mirror, (tn.Load("bare"), _ring(mirror)), noise)
    bound = bounds(simulated, cycles)
    print(
        f"P45, {cycles} cycles x 2 loads x {len(simulated.elastic)} shapes,"
        f" {1e3 * noise:g} mN; RMS over actuators; bound {rms(bound[0]):.3e} with the weights"
        f" known, {rms(bound[1]):.3e} with them"
    )
    print(f"A bias of scatter / {np.sqrt(count):.0f} is chance; an estimate without bias has error"
          " = scatter.")  # fmt: skip
    print_head("method")
    for name, method in METHODS.items():
        print(name, file=sys.stderr)
        print_line(name, run(method, simulated, cycles, count), bound)


def _ring(mirror: Mirror) -> tn.Load:
    return tn.Load("ring", mirror.added_weight, mirror.added_weight_error, tool="ring")


def rings336() -> Mirror:
    """Return 336 actuators on the rings of MMT336, a flat shell of 2 mm.

    Radii and counts are those of the MMT's secondary. There are no bias magnets. The ring (-0.5 N),
    all uncertainties and the range of alpha are guesses.
    """
    radii = [42.1, 73.4, 104.8, 136.1, 167.5, 198.8, 230.1, 261.5, 290.8, 313.1]
    shell = Shell(inner_radius=27.5e-3, outer_radius=321e-3, thickness=2e-3)
    layout = tn.rings([1e-3 * radius for radius in radii], [6, 12, 18, 24, 30, 36, 42, 48, 60, 60])
    return Mirror(
        name="RING336",
        layout=layout,
        shell=shell,
        weight=-round((shell.mass + 2.75e-3 * layout.n) * GRAVITY, 2),
        weight_error=0.02,
        added_weight=-0.5,
        added_weight_error=0.005,
        bias_force=0.0,
        magnet_mass=2.75e-3,
        alpha_range=(0.90, 1.10),
        gap=40e-6,
        puck_radius=3e-3,
        sensor=Annulus(3.5e-3, 6e-3),
        coil_gradient=600.0,
        bias_gradient=31.0,
    )


def large_mirror(mirror: Mirror, count: int, noises: Sequence[float]) -> None:
    """Print the errors for a large mirror with two cycles, for increasing noise."""
    print_head("noise, bound, undetermined patterns")
    for noise in noises:
        simulated = simulation(mirror, (tn.Load("bare"), _ring(mirror)), noise)
        bound = bounds(simulated, 2)
        found = run(by_ml, simulated, 2, count)
        undetermined = found.undetermined.mean() if len(found.undetermined) else np.nan
        name = f"{1e3 * noise:g} mN, {rms(bound[0]):.2e}, {undetermined:.1f}"
        if len(found.known):
            print_line(name, found, bound)
        else:
            print(f"{name}: every campaign failed: {found.failures[0]}")


def main() -> None:
    """Run from the command line."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("--campaigns", type=int, help="1000 on P45, 20 on 336")
    parser.add_argument("--noise", type=float, nargs="+", help="of one reading [N]")
    parser.add_argument("--mirror", choices=("p45", "336"), default="p45")
    options = parser.parse_args()
    if options.mirror == "336":
        print("336 actuators on rings, flat shell, 2 cycles, ml")
        large_mirror(rings336(), options.campaigns or 20, options.noise or (1e-4, 3e-4, 1e-3))
        return
    for noise in options.noise or (1e-3,):
        compare_methods(options.campaigns or 1000, noise)


if __name__ == "__main__":
    main()
