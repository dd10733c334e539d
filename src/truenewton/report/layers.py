"""What is known of each actuator, one layer a quantity: for maps and tables."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from matplotlib.axes import Axes

from truenewton.arrays import Array, spread
from truenewton.calibration.result import AnyCalibration, Calibration
from truenewton.estimation.findings.estimate import Scale
from truenewton.estimation.paper.identifiability import leverage
from truenewton.figures.maps import plot_map
from truenewton.figures.style import MILLIMETRE, SIGNED_COLOURS
from truenewton.records.parts import Parts
from truenewton.report.evidence import Evidence
from truenewton.rounding import significant, with_error
from truenewton.statics.arms import arms_in_units_of_rms
from truenewton.statics.layout import Layout


@dataclass(frozen=True, eq=False)
class Layer:
    """One quantity of all actuators.

    Attributes
    ----------
    key, name, unit
        For programs; for people; '' where there is none.
    values
        (n,), NaN where unknown.
    meaning
        One sentence.
    errors
        (n,) how far the values are to be read; None for two digits of each.
    signed
        Whether zero is the middle of its colours.
    reach
        How far the colours reach from zero, if signed; NaN to let the values decide.
    """

    key: str
    name: str
    unit: str
    values: Array
    meaning: str
    errors: Array | None = None
    signed: bool = False
    reach: float = float("nan")

    @property
    def title(self) -> str:
        """Name and unit."""
        return f"{self.name} ({self.unit})" if self.unit else self.name

    @property
    def texts(self) -> tuple[str, ...]:
        """(n,) as people read them."""
        if self.errors is not None:
            return tuple(map(with_error, self.values.tolist(), self.errors.tolist()))
        sign = "+" if self.signed else ""
        values = self.values.tolist()
        return tuple((sign if value > 0 else "") + significant(value) for value in values)

    @property
    def limits(self) -> tuple[float, float]:
        """Ends of the colours; among many actuators the few farthest out shall not take them up."""
        if np.isfinite(self.reach):
            return -self.reach, self.reach
        known = self.values[np.isfinite(self.values)]
        low, high = np.percentile(known, [1.0, 99.0] if known.size > 100 else [0.0, 100.0])
        if self.signed:
            high = max(abs(low), abs(high))
            low = -high
        if high > low:
            return float(low), float(high)
        aside = 0.1 * abs(float(low)) or 1.0
        return float(low) - aside, float(low) + aside

    def plot(self, layout: Layout, ax: Axes | None = None) -> Axes:
        """Draw it on the map of the actuators; return the axes."""
        if not self.signed:
            return plot_map(layout, self.values, ax, label=self.title)
        return plot_map(
            layout, self.values, ax, label=self.title, colours=SIGNED_COLOURS, limits=self.limits
        )


def calibration_layers(c: Calibration, evidence: Evidence | None) -> tuple[Layer, ...]:
    """Return what is known of the actuators of one calibration."""
    layers = [
        alpha_layer(c, "alpha", "alpha"),
        Layer("e_alpha", "error of alpha", "", c.error,
              "E_ALPHA: readings and weights together, one sigma."),
        Layer("e_stat", "from the readings", "", c.reading_error,
              "E_STAT: the error that the noise of the readings gives alpha, one sigma; it is what"
              " counts between actuators of one calibration."),
    ]  # fmt: skip
    if c.scale != Scale.MEAN_ONE:
        layers.append(
            Layer("e_syst", "from the weights", "", c.systematic_error,
                  "E_SYST: the errors of the weights, which move all alphas together.")
        )  # fmt: skip
    layers += [
        Layer("e_cycle", "error of the paper", "", c.cycle_error,
              "E_CYCLE: from the scatter of the cycles, three sigma."),
        Layer("leverage", "leverage", "", _leverage(c),
              "Share of the actuator in the noise of the balance; all together make 3. Where it"
              " is small, a fault of the actuator is hard to see."),
    ]  # fmt: skip
    if evidence is not None:
        layers += [
            Layer("residual", "residual", "", evidence.actuator_residual,
                  "How far the imbalance pulls the actuator's reading, rms over rows, in terms"
                  " of its noise; noise alone gives 1."),
            Layer("noise", "noise of one reading", "mN", 1e3 * evidence.actuator_noise,
                  "Standard deviation of one reading among repeats of its shape."),
        ]  # fmt: skip
    layers += _sensor_layers(c)
    if c.halves is not None:
        layers.append(
            Layer("halves", "half of the modes against the other", "", c.halves,
                  "Relative alpha fitted on the even elastic modes less that fitted on the odd:"
                  " cross-validation of a matrix.", signed=True)
        )  # fmt: skip
    if (named := _named(c)).any():
        layers.append(
            Layer("findings", "named in findings", "", named,
                  "In how many findings of the verdict the actuator is named.")
        )  # fmt: skip
    return tuple(layer for layer in layers if np.isfinite(layer.values).any())


def segment_layers(c: Parts[Calibration]) -> tuple[Layer, ...]:
    """Return what is known of the actuators of all segments; NaN where a segment does not tell."""
    of_segments: dict[str, dict[int, Layer]] = {}
    for number, one in c.found.items():
        for layer in calibration_layers(one, None):
            of_segments.setdefault(layer.key, {})[number] = layer
    made = []
    for parts in of_segments.values():
        values, errors = np.full((2, c.layout.n), np.nan)
        for number, layer in parts.items():
            own = c.layout.segment == number
            values[own] = layer.values
            if layer.errors is not None:
                errors[own] = layer.errors
        first = next(iter(parts.values()))
        known = None if first.errors is None else errors
        made.append(replace(first, values=values, errors=known))
    return tuple(made)


def alpha_layer(calibration: AnyCalibration, key: str, name: str) -> Layer:
    """Return alpha, as far as its error goes, all included."""
    return Layer(key, name, "true N / commanded N", calibration.column("alpha"),
                 "True Newton per commanded Newton, with its error, all included (E_ALPHA).",
                 calibration.column("error"))  # fmt: skip


def _sensor_layers(c: Calibration) -> list[Layer]:
    """Return what reciprocity finds of the sensors; without values what it was not asked."""

    def known(name: str, unit: float = 1.0) -> tuple[Array, Array]:
        value, error = c.of_sensors(name) / unit, c.of_sensors(f"{name}_error") / unit
        return np.where(error > 0.0, value, np.nan), error

    gain, gain_error = known("gain")
    layers = [
        Layer("sensor_gain", "sensor gain", "true / reading", gain,
              "True displacement per reading of the actuator's sensor (GAIN): above 1 the mirror"
              " moves by more than the sensor says.", gain_error),
    ]  # fmt: skip
    for axis in ("x", "y"):
        offset, error = known(axis, MILLIMETRE)
        layers.append(
            Layer(f"sensor_d{axis}", f"actuator less sensor, {axis}", "mm", offset,
                  f"Place of the actuator less that of its sensor (D{axis.upper()}): positive where"
                  f" the actuator stands at the larger {axis}.", error, signed=True)
        )  # fmt: skip
    return layers


def _named(c: Calibration) -> Array:
    """Return (n,) in how many findings each actuator is named."""
    ids = c.layout.id.tolist()
    return np.array([sum(i in each.actuators for each in c.findings) for i in ids], dtype=float)


def _leverage(c: Calibration) -> Array:
    """Return (n,) leverage: as diagnosed, else with even noise; NaN where disabled."""
    if c.diagnosis and c.diagnosis.leverage:
        return spread(np.array(c.diagnosis.leverage), c.layout.enabled)
    scaled_arms = arms_in_units_of_rms(c.layout) * c.alpha[c.layout.enabled]
    return spread(leverage(scaled_arms, np.ones(scaled_arms.shape[1])), c.layout.enabled)
