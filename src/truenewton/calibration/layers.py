"""The quantities of each actuator, one layer each, for maps and tables."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes

from truenewton.arrays import Array, spread
from truenewton.errors import UnknownName
from truenewton.estimation.findings.estimate import Scale
from truenewton.estimation.paper.identifiability import leverage
from truenewton.figures.layers import Layer
from truenewton.figures.style import MILLIMETRE, SIGMA, SIGMA_SCALE, SIGMA_STAT, on_screen
from truenewton.statics.arms import arms_in_units_of_rms


def layers_of(c: Any, evidence: Any = None) -> tuple[Layer, ...]:
    """Return the layers of a calibration that have values; of its residuals if there is evidence.

    Both are results of modules that need this one: `Calibration` and `Evidence`.
    """
    scale_error = np.full(c.layout.n, np.nan) if c.scale == Scale.MEAN_ONE else c.systematic_error
    layers = [
        alpha_layer(c, "alpha", "alpha"),
        Layer("e_alpha", SIGMA, "N/N", c.error, "Total standard uncertainty of alpha (E_ALPHA)."),
        Layer("e_stat", SIGMA_STAT, "N/N", c.statistical_error,
              "Standard uncertainty from the noise of the readings (E_STAT): use it to compare"
              " actuators of one calibration."),
        Layer("e_syst", SIGMA_SCALE, "N/N", scale_error,
              "Standard uncertainty from the weights (E_SYST), common to all actuators."),
        Layer("e_cycle", "scatter of cycles, 3σ (E_CYCLE)", "N/N", c.cycle_error,
              "Scatter of the cycles, 3 sigma, as in Ricci 2008 (E_CYCLE)."),
        Layer("leverage", "leverage", "", _leverage(c),
              "Share of the actuator in the noise of the balance; the sum is 3. If the share is"
              " small, a fault of the actuator is hard to detect."),
    ]  # fmt: skip
    if evidence is not None:
        layers += [
            Layer("residual", "residual / noise", "", evidence.actuator_residual,
                  "Rms correction of the actuator's readings that would restore the balance,"
                  " divided by the correction that noise alone would cause."),
            Layer("noise", "noise of one reading", "mN", 1e3 * evidence.actuator_noise,
                  "Standard deviation of one reading among repeats of its shape."),
        ]  # fmt: skip
    layers += _sensor_layers(c)
    if c.halves is not None:
        layers.append(
            Layer("halves", "even minus odd modes", "", c.halves,
                  "Cross-validation of a matrix: relative alpha from the even elastic modes minus"
                  " alpha from the odd modes.", centre=0.0)
        )  # fmt: skip
    if c.layout.has_channels:
        meaning = "Number of the actuator on the mirror; its ID is the channel of the electronics."
        layers.append(
            Layer("mirror_number", "number on the mirror", "", 1.0 * c.layout.number, meaning)
        )
    ids = c.layout.id.tolist()
    named = np.array([sum(i in each.actuators for each in c.findings) for i in ids], dtype=float)
    if named.any():
        meaning = "Number of findings of the verdict that name the actuator."
        layers.append(Layer("findings", "named in findings", "", named, meaning))
    return tuple(layer for layer in layers if np.isfinite(layer.values).any())


def plot_layer(c: Any, key: str, ax: Axes | None, **looks: Any) -> Axes:
    """Draw a layer of a calibration on the screen, see `Calibration.plot`."""
    layers = {each.key: each for each in layers_of(c)}
    if key not in layers:
        remedy = f"choose {', '.join(layers)}"
        raise UnknownName(f"the calibration has no quantity '{key}'", remedy=remedy)
    with on_screen():
        return layers[key].plot(c.layout, ax, **looks)


def alpha_layer(calibration: Any, key: str, name: str) -> Layer:
    """Return alpha, rounded to its total error."""
    alpha = calibration.alpha
    return Layer(key, name, "true N / commanded N", alpha,
                 "True Newton per commanded Newton, with its total error (E_ALPHA).",
                 calibration.error, float(np.nanmean(alpha)),
                 calibration.statistical_error)  # fmt: skip


def _sensor_layers(c: Any) -> list[Layer]:
    """Return gains and positions of the sensors; NaN without reciprocity."""

    def known(name: str, unit: float = 1.0) -> tuple[Array, Array]:
        value, error = c.of_sensors(name) / unit, c.of_sensors(f"{name}_error") / unit
        return np.where(error > 0.0, value, np.nan), error

    gain, gain_error = known("gain")
    layers = [
        Layer("sensor_gain", "sensor gain", "true / reading", gain,
              "True displacement per reading of the actuator's sensor (GAIN).", gain_error, 1.0),
    ]  # fmt: skip
    for axis in ("x", "y"):
        offset, error = known(axis, MILLIMETRE)
        meaning = f"{axis} of the actuator minus {axis} of its sensor (D{axis.upper()})."
        name = f"actuator minus sensor, {axis}"
        layers.append(Layer(f"sensor_d{axis}", name, "mm", offset, meaning, error, centre=0.0))
    return layers


def _leverage(c: Any) -> Array:
    """Return (n,) leverage of the diagnosis, or for uniform noise; NaN if disabled."""
    if c.diagnosis and c.diagnosis.leverage:
        return spread(np.array(c.diagnosis.leverage), c.layout.enabled)
    scaled_arms = arms_in_units_of_rms(c.layout) * c.alpha[c.layout.enabled]
    return spread(leverage(scaled_arms, np.ones(scaled_arms.shape[1])), c.layout.enabled)
