"""Nothing, and coils whose gain is not what it was: time, warmth, displacement, their own force."""

from __future__ import annotations

import numpy as np

from studies.faulty.bench import Day
from studies.faulty.fault import fault

DRIFT = 3e-3  # of alpha, relative [1/h]
WARMER = 2.0  # [K]; NdFeB loses 0.11 %/K
COIL_GRADIENT, BIAS_GRADIENT = 600.0, 31.0  # [1/m], [N/m]
FULL_SCALE = 0.4  # of a coil's force [N], where a law is off by what it is said to be


@fault("clean")
def clean(_: Day) -> None:
    pass


fault("clean, loads in turn", order="in turn")(clean)
fault("clean, one cycle", order="one cycle")(clean)
fault("clean, three loads", order="three loads")(clean)


fault("clean, 5 cycles against 2", order="unbalanced")(clean)


@fault("clean, no POSITION, TEMPERATURE, FORCERR")
def clean_bare(day: Day) -> None:
    day.has_position = day.has_temperature = False
    day.declared["force_error"] = None


@fault("clean, a tenth of the rows not valid")
def clean_with_gaps(day: Day) -> None:
    day.valid = day.random.random(len(day.z)) > 0.1
    day.readings[~day.valid] = 1e9


@fault("shapes 2 % larger under the ring")
def larger_shapes(day: Day) -> None:
    day.z = day.z * np.where(day.under(), 1.02, 1.0)


@fault("shapes 2 % larger under the ring, no POSITION", cause="gain by load")
def larger_shapes_unseen(day: Day) -> None:
    """No fault; but without POSITION nobody can tell it from coils that changed."""
    larger_shapes(day)
    day.has_position = False


def gradients(day: Day) -> None:
    day.gain = day.gain * (1 + COIL_GRADIENT * day.z)
    day.bias = day.bias + BIAS_GRADIENT * day.z


@fault("gradients, declared")
def gradients_declared(day: Day) -> None:
    gradients(day)
    day.declared |= {"coil_gradient": COIL_GRADIENT, "bias_gradient": BIAS_GRADIENT}


def gradients_unseen(day: Day) -> None:
    gradients(day)
    day.has_position = False


for micro in (5, 10, 20):
    fault(f"gradients not declared, {micro} uN", cause="gradient", noise=1e-6 * micro)(gradients)
    fault(f"gradients, no POSITION, {micro} uN", cause="gradient|quadratic", noise=1e-6 * micro)(
        gradients_unseen
    )


@fault("gradients declared, COILGRAD half of the true", cause="gradient", noise=1e-5)
def gradients_misdeclared(day: Day) -> None:
    gradients_declared(day)
    day.declared["coil_gradient"] = COIL_GRADIENT / 2


@fault("all alphas drift 0.3 %/h", cause="gain|drift")
def drift(day: Day) -> None:
    day.gain = day.gain * (1 + DRIFT * day.hours[:, None])


fault("all alphas drift, loads in turn", cause="gain|drift", order="in turn")(drift)


@fault("all alphas drift, no bias magnets", cause="gain|drift")
def drift_without_bias(day: Day) -> None:
    day.bias = np.zeros_like(day.bias)
    drift(day)


@fault("each alpha drifts 0.3 %/h rms", cause="(gain|drift).*each")
def drift_of_each(day: Day) -> None:
    day.gain = day.gain * (1 + DRIFT * day.hours[:, None] * day.random.standard_normal(day.n))


@fault("coils warm up by 0.4 % in half an hour", cause="gain|drift")
def warming_up(day: Day) -> None:
    day.gain = day.gain * (1 + 4e-3 * np.exp(-day.hours[:, None] / 0.5))


@fault("one coil loses 2 % halfway", cause="gain.*(each|single)")
def weaker_coil(day: Day) -> None:
    at = day.actuator()
    day.strike(at)
    lost = np.outer(day.hours > np.median(day.hours), np.arange(day.n) == at)
    day.gain = day.gain * (1 - 0.02 * lost)


@fault("gain by file, 0.1 % rms", cause="gain")
def gain_by_file(day: Day) -> None:
    day.gain = day.gain * (1 + 1e-3 * day.random.standard_normal(len(day.order))[day.file, None])


@fault("coils lose 0.22 % between the loads", cause="gain")
def weaker_coils(day: Day) -> None:
    day.gain = day.gain * np.where(day.under(), 1 - 1.1e-3 * WARMER, 1.0)


@fault("2 K between the loads, TEMPERATURE recorded", cause="temperature")
def warmer(day: Day) -> None:
    """Coil forces go with the magnets on the glass, bias forces with both magnets."""
    weaker_coils(day)
    day.bias = day.bias * np.where(day.under(), 1 - 2.2e-3 * WARMER, 1.0)
    day.warmth = day.warmth + np.where(day.load == 1, WARMER, 0.0)


@fault("2 K between the loads, not recorded", cause="gain|temperature")
def warmer_unseen(day: Day) -> None:
    warmer(day)
    day.has_temperature = False


@fault("coils 1 % quadratic at 0.4 N", cause="quadratic")
def quadratic(day: Day) -> None:
    day.law = lambda c: 1 + 0.01 * c / FULL_SCALE


@fault("coils 1 % cubic at 0.4 N", cause="cubic")
def cubic(day: Day) -> None:
    day.law = lambda c: 1 + 0.01 * (c / FULL_SCALE) ** 2


@fault("each coil 1 % rms quadratic", cause="quadratic")
def quadratic_of_each(day: Day) -> None:
    each = 0.01 * day.random.standard_normal(day.n)
    day.law = lambda c: 1 + each * c / FULL_SCALE


@fault("each coil 1 % rms cubic", cause="cubic")
def cubic_of_each(day: Day) -> None:
    each = 0.01 * day.random.standard_normal(day.n)
    day.law = lambda c: 1 + each * (c / FULL_SCALE) ** 2


@fault("elastic and static gain differ by 1 %", blind=True)
def two_gains(day: Day) -> None:
    day.elastic_gain = 1 + 0.01 * day.random.standard_normal((1, day.n))
