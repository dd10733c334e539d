"""Small stiffness matrices, each with a finding or two: 24 actuators on rings, as of a plate."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np

import truenewton as tn
from reference.cases import DATE, Result, finding_line, small
from reference.small_campaigns import simulated
from studies.comparison import pair, with_glass
from studies.matrix_grades import mistakes
from studies.simulated_matrices import springs
from truenewton.estimation.matrix.screen import screen_matrix
from truenewton.estimation.reciprocity.acceptance import Evidence, refusals
from truenewton.linalg import symmetrised
from truenewton.progress import progress_to
from truenewton.statics.layout import rings

Array = np.ndarray
LAYOUT = rings([0.03, 0.06, 0.1], [4, 8, 12])
N = LAYOUT.n
SOME = [1, 9, 20, 22]
EXACT = symmetrised(springs(LAYOUT, lambda square: square * np.log(square) / (480.0 * np.pi)))


def matrix(
    change: Callable[[Array], Array] = lambda k: k, noise: float = 2e-4, exact: Array = EXACT
) -> tn.StiffnessMatrix:
    """Return a measured matrix, changed."""
    random = np.random.default_rng(5)
    alpha, gain = np.exp(random.normal(0.0, 0.05, N)), np.exp(random.normal(0.0, 0.004, N))
    k = exact * gain / alpha[:, None] * (1.0 + noise * random.standard_normal((N, N)))
    return tn.StiffnessMatrix("SMALL", DATE, LAYOUT, change(k))


def by(method: str, *given: Any, **options: Any) -> Callable[[], tn.Calibration]:
    return lambda: tn.calibrate(matrix(*given, **options), method)


def times(factor: float, *at: Any) -> Callable[[Array], Array]:
    """Return what multiplies some elements of a matrix."""

    def change(k: Array) -> Array:
        k = k.copy()
        k[at] *= factor
        return k

    return change


def without_far(k: Array) -> Array:
    far = np.hypot(LAYOUT.x[:, None] - LAYOUT.x, LAYOUT.y[:, None] - LAYOUT.y) > 0.05
    return np.where(far, 0.0, k)


def softened() -> Array:
    """Return the exact matrix with one elastic mode of negative stiffness."""
    values, modes = np.linalg.eigh(EXACT)
    return EXACT - 2.0 * values[10] * np.outer(modes[:, 10], modes[:, 10])


def interrupted() -> tn.Calibration:
    """Return what `auto` has found when it is interrupted."""
    kept: list[Any] = []

    def stop(_what: str, _done: float, keep: Callable[[], Any] | None) -> None:
        if keep is not None:
            kept.append(keep())
            raise KeyboardInterrupt

    with progress_to(stop), suppress(KeyboardInterrupt):
        tn.calibrate(matrix(), "auto")
    return kept[0]


def mistaken(name: str, method: str) -> Callable[[], tn.Calibration]:
    return lambda: tn.calibrate(dict(mistakes(matrix(noise=5e-5)))[name], method)


def screened(change: Callable[[Array], Array]) -> Result:
    """Return what is found of a matrix before alpha is."""
    found = screen_matrix(matrix(change))
    return Result(tuple(map(finding_line, (*found.effects, *found.warnings))))


def rows_shifted() -> tn.Calibration:
    """Return the result of 15 actuators, too few to judge their order, with rows shifted by one."""
    layout, random = rings([0.05, 0.1], [5, 10]), np.random.default_rng(1)
    k = symmetrised(springs(layout, lambda square: square * np.log(square) / (480.0 * np.pi)))
    k = k / random.uniform(0.9, 1.1, 15)[:, None] * (1 + 2e-4 * random.standard_normal(k.shape))
    return tn.calibrate(tn.StiffnessMatrix("15", DATE, layout, np.roll(k, 1, axis=0)), "ml")


def rested(k: Array) -> Array:
    """Return a matrix whose columns contain the forces at rest."""
    return k + 0.05 * np.abs(np.diag(k)).mean() * np.ones((N, 1))


def coupled() -> Result:
    """Return what is said of two segments that are joined."""
    random, layout = np.random.default_rng(3), rings([0.05, 0.1], [6, 12])
    block = springs(layout, lambda square: square * np.log(square) / (480.0 * np.pi))
    block = block / random.uniform(0.8, 1.2, 18)[:, None]
    block *= 1.0 + 2e-4 * random.standard_normal(block.shape)
    stiffness = np.kron(np.eye(2), block)
    link = 1e-3 * np.abs(stiffness).max() * random.standard_normal((18, 18))
    stiffness[:18, 18:], stiffness[18:, :18] = link, link.T
    both = tn.layout(
        np.concatenate([layout.x, layout.x + 0.5]), np.tile(layout.y, 2),
        segment=np.repeat([1, 2], 18),
    )  # fmt: skip
    matrix = tn.StiffnessMatrix("TWO", DATE, both, stiffness)
    made = tn.calibrate(matrix.of_segment(1), "svd")
    return Result(tuple(map(finding_line, made.findings)))


small("matrices", {
    "svd": by("svd"),
    "transposed": by("svd", np.transpose),
    "symmetrised": by("svd", symmetrised),
    "coordinates in another order": by("svd", lambda k: np.roll(k, -1, axis=(0, 1))),
    "couplings of far actuators missing": lambda: screened(without_far),
    "diagonal elements wrong": by("svd", times(1.5, SOME, SOME)),
    "rows that are zero": by("svd", times(0.0, SOME)),
    "rows ten times too large": by("svd", times(10.0, SOME)),
    "elements wrong": by("svd", lambda k: times(0.7, 21, 5)(times(1.3, 13, 4)(k))),
    "a mode of negative stiffness": by("svd", exact=softened()),
    "the diagonal too large": mistaken("diagonal 1 % too large", "svd"),
    "rigid motions partly removed": mistaken("50 % of rigid motions removed", "svd"),
    "5 % of asymmetry": by("svd", noise=0.05),
    "gains with a gradient": by("ml", lambda k: k * (1.0 + 0.5 * LAYOUT.x)),
    "rows shifted": rows_shifted,
    "forces at rest not subtracted": lambda: screened(rested),
    "interrupted": interrupted,
    "segments that are joined": coupled,
})  # fmt: skip


def of_evidence(**values: Any) -> Result:
    return Result(tuple(map(finding_line, refusals(Evidence(**values)))))


# An iteration that ends within that of its errors.
small("matrices by reciprocity", {
    "middle ring 2 mm wider": mistaken("middle ring 2 mm wider", "reciprocity"),
    "the diagonal too large": mistaken("diagonal 1 % too large", "reciprocity"),
    "couplings zeroed": mistaken("couplings below 0.1 % zeroed", "reciprocity"),
    "elements wrong": by("reciprocity", lambda k: times(0.7, 21, 5)(times(1.3, 13, 4)(k))),
    "what no small matrix shows": lambda: of_evidence(
        as_stated=1e6, error=0.34, error_by_balance=2e-8, untried=336
    ),
}, tolerance=0.05)  # fmt: skip


def compared(old: Any, new: Any, repeat: Any = None, **changes: Any) -> Result:
    """Return what changed from one matrix to another, and what is said of it."""
    found = replace(tn.compare(old, new, repeat=repeat), **changes)
    columns = {"ALPHA": found.alpha_ratio, "E_STAT": found.alpha_ratio_error}
    sentences = (f"noise: {found.noise_law}", *map(finding_line, found.findings))
    return Result(sentences, tuple(found.layout.id.tolist()), columns)


def two(seed: int = 2, law: str = "equal", later: Array | None = None) -> list[tn.StiffnessMatrix]:
    return pair(matrix(), EXACT, seed, law, changed=False, later=later)[:2]


def drawn(seed: int) -> Array:
    return np.random.default_rng(seed).standard_normal((N, N))


def proportional(exact: Array, seed: int) -> tn.StiffnessMatrix:
    return replace(matrix(), stiffness=exact * (1.0 + 5e-4 * drawn(seed)))


def heavy_tails() -> Result:
    [old, _] = two()
    noise = np.random.default_rng(6).standard_t(2.5, (N, N))
    return compared(old, replace(old, stiffness=old.stiffness + 2e-4 * EXACT.std() * noise))


def matrix_and_campaign() -> Result:
    campaign = simulated(12)
    old = tn.measured_stiffness(campaign).matrix
    one, other = np.random.default_rng(1).standard_normal((2, 12))
    pattern = 1e-2 * old.stiffness.std() * np.outer(one, other)
    return compared(replace(old, stiffness=old.stiffness + pattern), campaign)


small("pairs", {
    "nothing changed": lambda: compared(*two()),
    "glass of another thickness": lambda: compared(
        *two(later=with_glass(EXACT, 0.02 * LAYOUT.x / LAYOUT.x.max()))
    ),
    "another unit": lambda: compared(
        *two(later=EXACT * np.random.default_rng(7).uniform(0.93, 1.07, N)[:, None])
    ),
    "with a repeat": lambda: compared(
        proportional(EXACT, 1),
        proportional(EXACT * np.exp(1e-3 * symmetrised(drawn(4))), 2),
        proportional(EXACT, 3),
    ),
    "heavy tails": heavy_tails,
    "a matrix and a campaign": matrix_and_campaign,
    "no convergence": lambda: compared(*two(), converged=False),
})  # fmt: skip
