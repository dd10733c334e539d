"""What is shown of a modal base, and in which words: alike on screen, on the page, in figures."""

from __future__ import annotations

import math

import numpy as np

from truenewton.modal.comparison import ModesComparison
from truenewton.modal.dissipation import Dissipation
from truenewton.modal.measured import MeasuredStiffness
from truenewton.modal.modal_base import ModalBase
from truenewton.rounding import percent, significant

NUMBERS = 8  # of modes, in the table
FAINTEST = 1e-5  # of the largest power; below it, a piston that costs nothing takes up all the axis


def chosen_modes(count: int) -> list[int]:
    """Return which modes are drawn: the softest eight, and four more up to the stiffest."""
    more = np.geomspace(8, count, 5)[1:] - 1
    return sorted({*range(min(8, count)), *(round(k) for k in more if count > 8)})


def stiffness_text(value: float) -> str:
    """Return a stiffness [N/m] with two digits: '-22 N/m', '4.6 kN/m', '9.0 MN/m'."""
    for size, unit in ((1e6, "MN/m"), (1e3, "kN/m")):
        if abs(value) >= 0.995 * size:
            return f"{significant(value / size)} {unit}"
    return f"{significant(value)} N/m"


def negative_text(base: ModalBase) -> str:
    """Say how many elastic modes are of negative stiffness, and why; nothing where none is."""
    count = int(np.count_nonzero(base.modes.stiffness[3:] < 0))
    return f"{count} negative: bias magnets, or errors of the measurement" if count else ""


def cost_rows(base: ModalBase) -> list[tuple[str, ...]]:
    """Return what some numbers of modes leave and cost, a row for each.

    The number; the rms wavefront left by so many modes of each of the three bases [nm]; and of the
    stiffness modes the force, rms and of the worst actuator [mN], and the power: mean of all coils,
    of the worst, and of all together [W].
    """
    cost, count = base.costs[0], base.modes.stiffness.size
    powers, rows = cost.power, []
    for number in np.unique(np.linspace(0, count, NUMBERS + 1).round().astype(int))[1:].tolist():
        k = number - 1
        left = (f"{1e9 * each.residual[k]:.4g}" for each in base.costs)
        force, power = 1e3 * cost.force[:, k], powers[:, k]
        rows.append(
            (str(number), *left, f"{np.sqrt(np.mean(force**2)):.3g}", f"{force.max():.3g}",
             f"{power.mean():.2g}", f"{power.max():.2g}", f"{power.sum():.3g}")
        )  # fmt: skip
    return rows


def least_power(base: ModalBase) -> float:
    """Return where a logarithmic axis of the power of a coil begins [W]."""
    means = np.concatenate([cost.power.mean(axis=0) for cost in base.costs])
    most = max(float(cost.power.max()) for cost in base.costs)
    return max(0.8 * float(means.min()), FAINTEST * most)


def measured_text(measured: MeasuredStiffness) -> str:
    """Say of how many shapes and rows a stiffness is, and how well it is known."""
    m = measured
    return (
        f"{m.shapes} shapes, {m.rows} rows"
        + (f"; repeats to {percent(m.relative_error)}" if math.isfinite(m.relative_error) else "")
        + (f", chi2/DOF {m.misfit:.3g}" if math.isfinite(m.misfit) else "")
        + (f"; {len(m.rejected)} rows left out" if m.rejected else "")
    )


def rigid_text(measured: MeasuredStiffness) -> str:
    """Say which rigid motions no shape holds; nothing where they hold all."""
    if not measured.rigid_assumed:
        return ""
    return f"no shape holds {measured.rigid_assumed} of 3 rigid motions: taken to cost nothing"


def apart(comparison: ModesComparison) -> str:
    """Say how far the modes taken with alpha = 1 lie from the calibrated."""
    c = comparison
    if not c.orders.size:
        return "not to be told from the calibrated: all are of nearly the same stiffness"
    worst = int(c.largest_angle.argmax())
    return (
        f"{math.degrees(c.distance):.2g} deg rms from the calibrated; at worst"
        f" {math.degrees(c.largest_angle[worst]):.2g} deg, between the spans of the first"
        f" {c.orders[worst]}"
    )


def turbulence(base: ModalBase) -> str:
    """Say which turbulence meets how large a mirror."""
    a, pupil = base.seen.atmosphere, base.seen.pupil
    return (
        f"seeing {a.seeing:g} arcsec, r0 {100 * a.fried_parameter:.3g} cm, L0"
        f" {a.outer_scale:g} m; pupil {pupil.diameter:.3g} m on a mirror of"
        f" {2e3 * pupil.radius:.0f} mm"
    )


def between_actuators(base: ModalBase) -> str:
    """Say what no number of modes takes away."""
    return (
        f"{1e9 * base.seen.fitting_error:.3g} nm of wavefront more, in quadrature, whatever the"
        " number of modes"
    )


def static_force(cost: Dissipation) -> str:
    """Say between which limits the static forces lie."""
    force = 1e3 * cost.static
    if not force.any():
        return "unknown, taken for 0: a stiffness file alone tells no weight"
    return f"{force.min():.3g} .. {force.max():.3g} mN"
