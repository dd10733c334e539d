"""The catalogue of effects of the bench that the model does not contain, each a derivative.

An effect is a function of a fit that returns its derivative, or None if the data contain no
information on it. To add one, write the function, and list it in `CATALOGUE`.

Noise that the readings of a row share pushes the rows of a file in one direction and looks like
zeros by file. Effects by which rows of one group differ are therefore compared with it. Along the
direction d of an effect that all actuators share, 1 for zeros, the forces at rest for gains,
repeats scatter kappa times as much as independent readings; without what the effect itself explains

    T / k against F(k, M - k),        T -> T (M - k) / max(M kappa - T, M - k),

M the rows less the groups. Parameters of each actuator are as many as are independent,
(tr C)^2 / tr C^2 instead of n, C the correlations of the readings (`moments.structure_of`).
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from truenewton.arrays import Array
from truenewton.chance import OF_EACH_KIND, f_logsf
from truenewton.estimation.effects.derivative import Columns, Derivative, FittedRows, OfEach
from truenewton.estimation.effects.fields import (
    Field,
    columns_of,
    derivative_of,
    from_mean,
    functions_with,
    standing_out,
    without,
)
from truenewton.estimation.effects.score_test import Given, chi2_of, log_chance
from truenewton.estimation.findings.code import Code
from truenewton.estimation.findings.estimate import bias_per_gain
from truenewton.estimation.problem import Problem
from truenewton.estimation.readings.moments import Moments, WithinGroups, independent_readings
from truenewton.statics.load import leaning

# Effects by which rows of one group differ.
WITHIN_GROUPS = {
    Code.GAIN_BY_HOUR,
    Code.GAIN_BY_HOUR_OF_EACH,
    Code.GAIN_BY_FILE,
    Code.GAIN_BY_FILE_OF_SINGLE,
    Code.ZERO_BY_HOUR,
    Code.ZERO_BY_HOUR_OF_EACH,
    Code.ZERO_BY_FILE,
    Code.ZERO_BY_FILE_OF_EACH,
    Code.ZERO_RANDOM_WALK,
    Code.LOAD_REPOSITIONED,
}
POWERS = {"gain": 1, "coil": 1, "quadratic": 2, "cubic": 3}  # of c^ in effects, by their code
MIN_FILES = 3  # files that effects by file need
MAX_AFFECTED_FRACTION = 0.1  # of the actuators: if more stand out, it is no effect of single ones


@dataclass(frozen=True)
class Effect:
    """An effect that the model does not contain."""

    # Of the finding, and of the parameters
    code: Code
    unit: str
    # Of a fit; None if the data contain no information on the effect
    derivative: Callable[[FittedRows], Derivative | None]
    # What the user can do about it, or a function of the fit that returns it
    remedy: str | Callable[[FittedRows], str]
    # What its parameters belong to: '' (all together), 'file', 'load', 'actuator', 'axis'
    of: str = ""
    # Whether it is taken out of the data of a fit if that makes it fit; otherwise it is named
    corrected: Callable[[FittedRows], bool] = lambda _: True


# -- fields that several effects share ------------------------------------------------------------


def _gain(fit: FittedRows) -> Field:
    """Return g = -c^ h, h by file, by hour (both also of each actuator) and by load.

    The h of a load is 1 under it, less its mean over the rows of all loads under which the mirror
    does not lean, so that alpha stays that of these. Under the first of them it is 0.
    """
    of_load, lean = fit.moments.of_load, leaning(fit.moments.loads)
    upright = of_load[:, ~lean].sum(axis=1)
    weight = fit.moments.weight * upright
    mean = upright[:, None] * (weight @ of_load / weight.sum())
    loads = np.delete((of_load - mean).T, int(lean.argmin()), axis=0)
    within = len(fit.moments.within.first)
    functions = functions_with(fit.moments, loads)
    return Field(lambda _, c: -c, functions, within, gain=True)


def _zero(fit: FittedRows) -> Field:
    """Return g = h, h by file and by hour, also of each actuator."""
    groups = len(fit.moments.mean)
    functions = functions_with(fit.moments, np.empty((0, groups)))
    return Field(lambda *_: np.ones((groups, 1)), functions, len(functions))


def _bend(fit: FittedRows, bent: Callable[[Array], Array]) -> Field:
    """Return g = -c^2 or -c^3 in all rows, also of each actuator."""
    return Field(lambda _, c: -bent(c), fit.moments.weight[None])


def _displacement(fit: FittedRows) -> Field:
    """Return g = -c^ z in all rows."""
    z = np.asarray(fit.moments.displacement)
    return Field(lambda some, c: -c * z[:, some], fit.moments.weight[None])


FIELDS: dict[str, Callable[[FittedRows], Field]] = {
    "gain": _gain,
    "zero": _zero,
    "square": partial(_bend, bent=np.square),
    "cube": partial(_bend, bent=lambda c: c * c * c),
    "displacement": _displacement,
}


def columns_at(fit: FittedRows) -> tuple[Columns, dict[str, Field]]:
    """Return the sums of all fields at a fit, taken once."""
    if "columns" not in fit.found:
        displaced = fit.moments.displacement is not None
        fields = {k: of(fit) for k, of in FIELDS.items() if displaced or k != "displacement"}
        columns = columns_of(fit, fields, fit.found.get("before"))
        fit.found["fields"], fit.found["columns"] = fields, columns
    return fit.found["columns"], fit.found["fields"]


def removed(
    fit: FittedRows,
    data: tuple[Problem, Moments],
    effects: Sequence[tuple[Derivative, Array]],
) -> tuple[Problem, Moments]:
    """Return problem and moments without effects, each with its (k,) parameters."""
    problem, moments = data
    size = sum((each.sizes(theta) for each, theta in effects), start=np.zeros(1))
    if np.any(size):
        columns, fields = columns_at(fit)
        size = np.broadcast_to(size, columns.score.shape)
        moments = without(fit, columns, fields, moments, size)
    for each, theta in effects:
        if each.remove is not None:
            problem, moments = each.remove(problem, moments, theta)
    return problem, moments


def _derivative(fit: FittedRows, name: str, *functions: slice, **options: Any) -> Derivative:
    """Return `derivative_of` of a field by its name."""
    columns, fields = columns_at(fit)
    return derivative_of(fit, columns, (name, fields[name]), *functions, **options)


# -- effects on readings --------------------------------------------------------------------------


def _files(within: WithinGroups) -> slice:
    return slice(0, len(within.weight))


def by_hour(fit: FittedRows, field: str, *, each: bool) -> Derivative | None:
    """Return a drift of alpha (field 'gain': g = -c^ h, h the hours) or of the zero (g = h).

    A zero of the readings cannot be distinguished from bias magnets: readings and B move together.
    """
    within = fit.moments.within
    if not np.any(within.square > 0):
        return None
    files = len(within.weight)
    return _derivative(fit, field, slice(files, files + 1), each=each)


def gain_by_file(fit: FittedRows, *, single: bool) -> Derivative | None:
    """Return alpha that differs between files, of all or of those that stand out: g = -c^."""
    within = fit.moments.within
    if len(within.weight) < MIN_FILES:
        return None
    files, mix = _files(within), from_mean(within.weight.sum(axis=1))
    if not single:
        return _derivative(fit, "gain", files, mix=mix)
    affected = fit.affected
    if affected is None:
        affected = standing_out(columns_at(fit)[0], files, mix)
        if not 0 < affected.size <= max(1, MAX_AFFECTED_FRACTION * fit.problem.n):
            return None
    return _derivative(fit, "gain", files, each=True, mix=mix, actuators=affected)


def gain_by_load(fit: FittedRows) -> Derivative | None:
    """Return alpha, or shapes, that differ between loads: only POSITION distinguishes these.

    As the mirror leans, coils move against the reference plate. Those that gain theta have come
    nearer by theta / COILGRAD, and so have the bias magnets, whose forces change with them.
    """
    if len(fit.moments.loads) < 2:
        return None
    lean, field = leaning(fit.moments.loads), columns_at(fit)[1]["gain"]
    readings = _derivative(fit, "gain", slice(field.within, len(field.first)))
    ratio = bias_per_gain(fit.problem.campaign)
    if not lean.any() or ratio is None:
        return readings
    nearer = np.delete(fit.moments.of_load * lean, int(lean.argmin()), axis=1)
    magnets = on_balance(fit, ratio * fit.problem.a.sum(axis=1)[None, :, None] * nearer[:, None])
    jacobian = np.asarray(readings.jacobian) + np.asarray(magnets.jacobian)  # all share each size
    return replace(readings, remove=magnets.remove, jacobian=jacobian)


def zero_by_file(fit: FittedRows, *, each: bool) -> Derivative | None:
    """Return zeros of the readings that differ between files, the same for all or of each.

    Those of each have a spread of their own along the direction that changes the sum of the forces.
    It is large if all share a part of the zeros, and 0 if a load was put on at another place.
    """
    within = fit.moments.within
    if len(within.weight) < MIN_FILES:
        return None
    direction = fit.scaled_arms[0] if each else None
    return _derivative(fit, "zero", _files(within), each=each, direction=direction)


def zero_random_walk(fit: FittedRows) -> Derivative | None:
    """Return a zero, the same for all, that changes from each file to the next, and stays.

    Zeros by file are independent of each other; what has been moved, or drifts, is not.
    """
    within = fit.moments.within
    order = np.argsort(within.hour.sum(axis=1) / within.weight.sum(axis=1))
    if len(order) < MIN_FILES:
        return None
    steps = np.empty((len(order), len(order)))
    steps[order] = np.tri(len(order))
    mix = from_mean(within.weight.sum(axis=1)) @ steps
    return _derivative(fit, "zero", _files(within), mix=mix)


def coil_gradient(fit: FittedRows) -> Derivative | None:
    """Return a gradient of the force of coils besides COILGRAD: g = -c^ z."""
    if fit.moments.displacement is None:
        return None
    return _derivative(fit, "displacement")


def of_field(fit: FittedRows, field: str, *, each: bool) -> Derivative:
    """Return non-linear coils: g = -c^2 (field 'square') or -c^3 ('cube'), of all or of each."""
    return _derivative(fit, field, each=each)


# -- effects on the balance and on the arms -------------------------------------------------------


def bias_gradient(fit: FittedRows) -> Derivative | None:
    """Return a gradient of the force of bias magnets besides BIASGRAD: A z in the balance."""
    z = fit.moments.displacement
    return None if z is None else on_balance(fit, (z @ fit.problem.a.T)[:, :, None])


def weight_of_load(fit: FittedRows) -> Derivative | None:
    """Return a weight of each load that differs from the declared; this needs three loads."""
    of_load = fit.moments.of_load
    if of_load.shape[1] < 3:
        return None
    return on_balance(fit, np.eye(3)[None, :, :1] * of_load[:, None, :])


def contact(fit: FittedRows, *, by_load: bool) -> Derivative | None:
    """Return a contact of the mirror in shapes of one sign: a force and two torques."""
    positive = np.asarray(fit.moments.labels[:, 2] > 0, dtype=np.float64)
    h = fit.moments.of_load * positive[:, None] if by_load else positive[:, None]
    if np.ptp(fit.moments.labels[:, 2]) == 0:
        return None
    units = np.eye(3)[None, :, None, :] * h[:, None, :, None]
    return on_balance(fit, units.reshape(len(h), 3, -1))


def positions(fit: FittedRows, some: slice = slice(None)) -> Derivative:
    """Return errors of the coordinates of some actuators: e_x and e_y times alpha c^ of each."""
    n, alpha, rows = fit.problem.n, fit.alpha[some], fit.fitted_rows[:, some]
    count, b = rows.shape
    arms = np.zeros((3, 2, b))
    arms[1, 0] = arms[2, 1] = alpha
    pulled = np.tensordot(fit.root, arms, axes=1)
    pull = fit.white_rho.reshape(-1, 3).T @ rows

    def spurious() -> tuple[Array, Array]:
        s_inverse, covariance = fit.root.T @ fit.root, fit.noise_covariance(some)
        by_alpha = (s_inverse @ fit.problem.a)[1:]  # e_x, e_y by the arms
        on_alpha = count * alpha[None, :, None] * by_alpha[:, None, :] * covariance
        between = count * np.outer(alpha, alpha) * covariance[:, some]
        own = s_inverse[1:, None, 1:, None] * between[None, :, None, :]
        return on_alpha.reshape(2 * b, n), own.reshape(2 * b, 2 * b)

    def remove(problem: Problem, moments: Moments, theta: Array) -> tuple[Problem, Moments]:
        moved = np.zeros((3, n))
        moved[1:] = theta.reshape(2, n)
        return replace(problem, moved=problem.moved + moved), moments

    return Derivative(
        2 * b,
        remove=remove,
        of_each=OfEach(
            arms=arms.reshape(3, 2 * b),
            rows=lambda: rows,
            score=np.einsum("axi,ai->xi", pulled, pull).ravel(),
            whole=(np.sum(pulled**2, axis=0) * np.einsum("ri,ri->i", rows, rows)).ravel(),
            parts=lambda: parts_of_positions(fit),
        ),
        spurious=spurious,
    )


def parts_of_positions(fit: FittedRows) -> Iterator[Derivative]:
    """Yield the derivatives by the positions of a few actuators at a time."""
    n = fit.problem.n
    for start in range(0, n, 64):  # rows of all are as large as the readings
        yield positions(fit, slice(start, min(start + 64, n)))


def shell_curvature(fit: FittedRows) -> Derivative:
    """Return an error of NZ by 1 / R^2 of the shell: nz less by r^2 / 2 times it, r the radius."""
    a, alpha = fit.problem.a, fit.alpha
    less = np.zeros_like(a)
    less[0] = -0.5 * (a[1] ** 2 + a[2] ** 2)
    jacobian = (fit.fitted_rows @ (less * alpha).T)[:, :, None]

    def spurious() -> tuple[Array, Array]:
        s_inverse, pulled = fit.root.T @ fit.root, alpha * less[0]
        noise = pulled @ fit.noise_covariance(slice(None))
        count = len(fit.fitted_rows)
        on_alpha = count * noise * (s_inverse[0] @ a)
        return on_alpha[None], np.array([[count * s_inverse[0, 0] * (noise @ pulled)]])

    def remove(problem: Problem, moments: Moments, theta: Array) -> tuple[Problem, Moments]:
        return replace(problem, moved=problem.moved + theta[0] * less), moments

    return Derivative(1, remove=remove, jacobian=jacobian, spurious=spurious)


def on_balance(fit: FittedRows, change: Array) -> Derivative:
    """Return an effect that adds (g, 3, k) to the balance of each group."""
    groups, _, k = change.shape
    jacobian = fit.moments.pooling.rows(change.reshape(groups, 3 * k)).reshape(-1, 3, k)

    def remove(problem: Problem, moments: Moments, theta: Array) -> tuple[Problem, Moments]:
        return problem, moments.with_forces(known=moments.known + change @ theta)

    return Derivative(k, remove=remove, jacobian=jacobian)


def on_loads(fit: FittedRows, loads: Sequence[bool] | slice = slice(1, None)) -> Array:
    """(g, 3, K) a force of 1 N in the balance under each of some loads; by default all but one."""
    return np.eye(3)[None, :, :1] * fit.moments.of_load[:, None, loads]


_WARM = "let the electronics warm up, and take bare and loaded cycles in turn"
_ZERO = "take bare and loaded cycles in turn, so that the zeros of both come to the same"
_COIL = "use smaller shapes, at half of which it is {} as large, or have the coil drivers looked at"
_QUADRATIC, _CUBIC = _COIL.format("half"), _COIL.format("a quarter")
_DRIVER = "look at its coil, driver and cable"
_TOUCH = "look for a cable, dust or the ring's edge at the mirror"


def _gradient(fit: FittedRows, keyword: str, declared: str) -> str:
    given = any(getattr(cycle, declared) is not None for cycle in fit.problem.campaign.cycles)
    signed = f"correct {keyword}, or the sign of POSITION, which is along +z"
    return signed if given else f"give {keyword}, which takes it out"


def _by_load(fit: FittedRows) -> str:
    missing = []
    if fit.moments.displacement is None:
        missing.append("POSITION, which tells whether shapes differ between loads")
    if any(cycle.temperature is None for cycle in fit.problem.campaign.cycles):
        missing.append("TEMPERATURE")
    if leaning(fit.moments.loads).any():
        missing.append("COILZ, how far the coils move as the mirror leans")
    what = f"record {', and '.join(missing)}" if missing else "look for what warms the coils"
    return f"{what}: what warms coils changes the bias magnets too, and the scale with them"


ZEROS_OF_EACH = Effect(
    Code.ZERO_BY_FILE_OF_EACH, "N", partial(zero_by_file, each=True), _ZERO, "file"
)
# Zeros of each actuator are this if they do not change the sums of the forces.
LOAD_REPOSITIONED = replace(
    ZEROS_OF_EACH,
    code=Code.LOAD_REPOSITIONED,
    remedy="mount each load at the same place, and apply the same shape at rest",
)
POSITIONS = Effect(Code.POSITIONS, "m", positions, "measure X and Y of the magnets", "actuator")

CATALOGUE: tuple[Effect, ...] = (
    Effect(Code.GAIN_BY_HOUR, "1/h", partial(by_hour, field="gain", each=False), _WARM),
    Effect(Code.GAIN_BY_HOUR_OF_EACH, "1/h", partial(by_hour, field="gain", each=True), _WARM,
           "actuator"),
    Effect(Code.GAIN_BY_FILE, "", partial(gain_by_file, single=False), _WARM, "file"),
    Effect(Code.GAIN_BY_FILE_OF_SINGLE, "", partial(gain_by_file, single=True), _DRIVER,
           "actuator"),
    Effect(Code.GAIN_BY_LOAD, "", gain_by_load, _by_load, "load",
           lambda fit: fit.moments.displacement is not None),
    Effect(Code.WEIGHT_OF_LOAD, "N", weight_of_load, "weigh mirror and loads anew", "load",
           lambda _: False),
    Effect(Code.ZERO_BY_HOUR, "N/h", partial(by_hour, field="zero", each=False), _ZERO),
    Effect(Code.ZERO_BY_HOUR_OF_EACH, "N/h", partial(by_hour, field="zero", each=True), _ZERO,
           "actuator"),
    Effect(Code.ZERO_BY_FILE, "N", partial(zero_by_file, each=False), _ZERO, "file"),
    ZEROS_OF_EACH,
    Effect(Code.ZERO_RANDOM_WALK, "N", zero_random_walk, _ZERO),
    Effect(Code.QUADRATIC_COIL, "1/N", partial(of_field, field="square", each=False), _QUADRATIC),
    Effect(Code.QUADRATIC_COIL_OF_EACH, "1/N", partial(of_field, field="square", each=True),
           _QUADRATIC, "actuator"),
    Effect(Code.CUBIC_COIL, "1/N2", partial(of_field, field="cube", each=False), _CUBIC),
    Effect(Code.CUBIC_COIL_OF_EACH, "1/N2", partial(of_field, field="cube", each=True), _CUBIC,
           "actuator"),
    Effect(Code.COIL_GRADIENT, "1/m", coil_gradient,
           partial(_gradient, keyword="COILGRAD", declared="coil_gradient")),
    Effect(Code.BIAS_GRADIENT, "N/m", bias_gradient,
           partial(_gradient, keyword="BIASGRAD", declared="bias_gradient")),
    Effect(Code.CONTACT_IN_ONE_SIGN, "N, N m", partial(contact, by_load=False), _TOUCH, "axis"),
    Effect(Code.CONTACT_IN_ONE_SIGN_BY_LOAD, "N, N m", partial(contact, by_load=True), _TOUCH,
           "load"),
    POSITIONS,
    Effect(Code.SHELL_CURVATURE, "1/m2", shell_curvature, "correct NZ in ACTUATORS"),
)  # fmt: skip


# -- which effects are significant ----------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class EffectTest:
    """The test of one effect: a chi^2, and the logarithm of the probability of a larger one."""

    effect: Effect
    derivative: Derivative
    statistic: float
    degrees_of_freedom: float
    log_probability: float


def effect_tests(
    fit: FittedRows,
    given: Given | None = None,
    left_out: Collection[Code] = (),
    *,
    bounded: bool = False,
) -> list[EffectTest]:
    """Return the tests of the catalogue at a fit, the likeliest first, but those ``left_out``.

    ``given`` and ``bounded``: as in `chi2_of`.
    """
    made = ((effect, effect.derivative(fit)) for effect in CATALOGUE if effect.code not in left_out)
    effects = [(effect, each) for effect, each in made if each is not None and each.count]
    found = chi2_of(fit, [derivative for _, derivative in effects], given, bounded=bounded)
    each = [tested(fit, *pair, *one) for pair, one in zip(effects, found, strict=True) if one]
    return sorted(each, key=lambda test: test.log_probability)


def tested(
    fit: FittedRows,
    effect: Effect,
    derivative: Derivative,
    chi2: float,
    freedom: float,
    log_probability: float,
) -> EffectTest:
    """Return the test of an effect by its chi^2.

    If the noise grows with the force, it does so along the pattern of the effect, too.
    """
    power = next((p for code, p in POWERS.items() if effect.code.startswith(code)), 0)
    if power and fit.moments.by_force:
        chi2 /= fit.moments.noise_along(power)
        log_probability = float(log_chance(chi2, freedom))
    return EffectTest(effect, derivative, chi2, freedom, log_probability)


def significant_tests(found: Sequence[EffectTest]) -> list[EffectTest]:
    """Return the significant tests, the likeliest first; 1 of 400 sound campaigns has one."""
    limit = np.log(-np.expm1(np.log1p(-OF_EACH_KIND) / max(len(found), 1)))
    chosen = [test for test in found if test.log_probability < limit]
    return sorted(chosen, key=lambda test: test.log_probability)


def beside_shared_noise(
    found: Sequence[EffectTest], fit: FittedRows, samples: Array
) -> list[EffectTest]:
    """Return effects by which rows of one group differ, if significant despite shared noise.

    Their order stays that of independent noise; ``samples`` (m, n) [N] as in `structure_of`.
    """
    some = [test for test in found if test.effect.code in WITHIN_GROUPS]
    judged = [_judged(test, fit, samples) for test in some]
    codes = {test.effect.code for test in significant_tests(judged)}
    return [test for test in some if test.effect.code in codes]


def _judged(test: EffectTest, fit: FittedRows, samples: Array) -> EffectTest:
    n, variance = fit.problem.n, fit.problem.noise.variance
    statistic, freedom = test.statistic, test.degrees_of_freedom
    if test.derivative.count >= n or test.derivative.actuators is not None:
        share = independent_readings(samples, n) / n
        chance = float(log_chance(share * statistic, share * freedom))
        return replace(test, log_probability=chance)
    gain = test.effect.code in (Code.GAIN_BY_HOUR, Code.GAIN_BY_FILE)
    weights = (fit.fitted().mean(axis=0) if gain else np.ones(n)) / variance
    kappa = float(np.mean((samples @ weights) ** 2) / np.sum(weights**2 * variance))
    left = fit.moments.repeats - freedom
    rest = max(kappa * fit.moments.repeats - statistic, left)
    ratio = statistic / freedom * left / rest
    return replace(test, log_probability=float(f_logsf(ratio, freedom, left)))
