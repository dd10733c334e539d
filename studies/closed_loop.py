"""Where the noise of the closed loop comes from, and how soon it settles.

    python -m studies.closed_loop [--shapes 360] [--figure PNG] [--errors]

P45, recorded from 20 ms after the command. The mirror follows sensor noise, and elastic forces of
the glass balance the forces that move it. Net force and torques of all true forces therefore have
much less noise than those of independent readings.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import matplotlib as mpl
import numpy as np

from truenewton.arrays import Array
from truenewton.bench.simulated.loop import Loop, equilibrium, record, row_noise, samples_of
from truenewton.bench.simulated.static import loop_of, static_bench
from truenewton.figures.style import COLOURS, FAINT, INK, STYLE, new_figure
from truenewton.mirrors.known import Mirror, p45, ring
from truenewton.statics.arms import arms
from truenewton.statics.modes import stiffness_modes

if TYPE_CHECKING:
    from matplotlib.axes import Axes

QUIET_COILS = {"dac_step": 1e-15, "driver_noise": 0.0}
QUIET_SENSORS = {"noise": 0.0, "codes": 2**40}
SOURCES = {
    "sensor noise, 3 nm": ((), ("noise",)),
    "ADC counts, 2.2 nm": ((), ("codes",)),
    "DAC steps, 41.6 uN": (("dac_step",), ()),
    "driver noise, 30 uN": (("driver_noise",), ()),
    "sensor noise, ADC": ((), ("noise", "codes")),
    "sensor noise, ADC, DAC": (("dac_step",), ("noise", "codes")),
    "all": (("dac_step", "driver_noise"), ("noise", "codes")),
}


def only(loop: Loop, of_coils: tuple[str, ...], of_sensors: tuple[str, ...]) -> Loop:
    """Return the loop with these sources of noise only."""
    coils: dict[str, Any] = {k: v for k, v in QUIET_COILS.items() if k not in of_coils}
    sensors: dict[str, Any] = {k: v for k, v in QUIET_SENSORS.items() if k not in of_sensors}
    return replace(
        loop, coils=replace(loop.coils, **coils), sensors=replace(loop.sensors, **sensors)
    )


def rms(values: np.ndarray, axis: int | None = None) -> np.ndarray:
    return np.sqrt(np.mean(values**2, axis=axis))


def print_noise(loop: Loop, shapes: int) -> None:
    """Print the noise by source, from repeated records of the flat mirror without added weight."""
    mirror = p45()
    n = mirror.layout.n
    load = np.full((n, shapes), -mirror.weight / n - mirror.bias_force)
    a = arms(mirror.layout) * loop.coils.alpha
    _, exact = equilibrium(loop, np.zeros((n, shapes)), load)
    print(f"{shapes} records of 2,048 samples, rms about the noiseless force; the sum and a torque")
    print("of all true forces beside what independent readings as noisy would make of them")
    print(f"{'':24}{'mean force, uN':>22}{'sample':>8}{'mean / white':>14}{'sum, uN':>16}"
          f"{'torque, uN m':>17}")  # fmt: skip
    for name, (of_coils, of_sensors) in SOURCES.items():
        rows = [row_noise(1, "bare", 1, k, 1) for k in range(shapes)]
        found = record(only(loop, of_coils, of_sensors), np.zeros((n, shapes)), load, rows)
        error = 1e6 * (found.force - exact)
        each, sample = rms(error, axis=1), 1e6 * rms(found.force_scatter)
        whole, apart = rms(a @ error, axis=1), np.sqrt(a**2 @ each**2)
        mean = f"{rms(each):.2f} ({each.min():.2f} - {each.max():.2f})"
        white = rms(each) / (sample / np.sqrt(2048))
        print(f"{name:24}{mean:>22}{sample:8.0f}{white:14.2f}"
              f"{whole[0]:9.2f} /{apart[0]:5.0f}{whole[1]:10.2f} /{apart[1]:5.1f}")  # fmt: skip


STROKE = 0.1e-6  # largest displacement of the step [m]
DURATION = 8e-3  # [s]
FINER = 1e-6  # DAC and ADC steps relative to the true ones, so that they are negligible
RIGID = 3  # piston and two tilts are the softest modes


@dataclass(frozen=True, eq=False)
class StepResponses:
    """Steps of modes, each commanded alone.

    Attributes
    ----------
    time
        (steps,) time since the command [s].
    stiffness
        (3,) stiffness of the softest, the median and the stiffest elastic mode [N/m].
    position
        (steps, 3) amplitude of the mode in the true displacement, relative to the command.
    """

    time: Array
    stiffness: Array
    position: Array


def step_responses(loop: Loop, stiffness: Array, *, duration: float = DURATION) -> StepResponses:
    """Command noiseless steps of the softest, median and stiffest mode of (n, n) K by `STROKE`."""
    found = stiffness_modes(stiffness)
    n = len(stiffness)
    which = [RIGID, (RIGID + n) // 2, n - 1]
    modes = found.modes[:, which]
    shapes = modes * (STROKE / np.abs(modes).max(axis=0))
    parts = modes / np.sum(modes * shapes, axis=0)
    fine = replace(
        loop,
        coils=replace(loop.coils, dac_step=loop.coils.dac_step * FINER),
        sensors=replace(loop.sensors, codes=round(loop.sensors.codes / FINER)),
    )
    steps = round(duration * loop.control.rate)
    position = [
        np.sum(parts * displacement, axis=0)
        for _, _, displacement in samples_of(fine, shapes, np.zeros_like(shapes), (), steps)
    ]
    time = np.arange(steps, dtype=float) * loop.control.period
    return StepResponses(time, found.stiffness[which], np.array(position))


def settling_time(time: Array, response: Array, band: float) -> Array:
    """Return when (steps, m) responses settle within a band about 1 [s]; otherwise infinity."""
    outside = np.abs(response - 1) > band
    last = len(time) - 1 - np.argmax(outside[::-1], axis=0)
    after = np.append(time, np.inf)[last + 1]
    return np.asarray(np.where(outside.any(axis=0), after, time[0]))


def plot_step_responses(
    time: Array, position: Array, stiffness: Array, ax: Axes | None = None
) -> Axes:
    """Draw the step responses of modes of (m,) stiffness, relative to the command."""
    with mpl.rc_context(STYLE):
        ax = ax or new_figure(0.72).add_subplot()
        ax.axhspan(0.9, 1.1, color=FAINT, alpha=0.25, linewidth=0)
        ax.axhline(1.0, color=FAINT, linewidth=0.5)
        # Equal steps of lightness, and different dashes for black-and-white prints.
        styles = zip(mpl.colormaps[COLOURS](np.linspace(0.0, 0.8, len(stiffness))),
                    ("-", "--", "-.") * len(stiffness), strict=False)  # fmt: skip
        for response, k, (colour, dashes) in zip(position.T, stiffness, styles, strict=True):
            power = int(np.floor(np.log10(k)))
            label = rf"${k / 10.0**power:.1f} \times 10^{power}$ N/m"
            ax.plot(1e3 * time, response, color=colour, linestyle=dashes, label=label)
        ax.set_xlabel("time since the command (ms)")
        ax.set_ylabel("displacement / command")
        ax.set_xlim(0, 1e3 * time[-1])
        ax.legend(title="stiffness of the mode", frameon=False, fontsize=6.5, title_fontsize=6.5)
        ax.set_title("band: ±10 %", loc="right", fontsize=6.5, color=INK)
    return ax


def print_settling(loop: Loop, glass: np.ndarray) -> None:
    """Print the settling times of modes; with longer steps they include the pseudo-integrator."""
    steps = step_responses(loop, glass, duration=5e-3)
    print("\nstep of a mode: settled to 10 %, 5 % after")
    for k, position in zip(steps.stiffness, steps.position.T, strict=True):
        ten, five = (1e3 * settling_time(steps.time, position[:, None], b)[0] for b in (0.1, 0.05))
        print(f"{k:12.4g} N/m {ten:8.2f} ms {five:8.2f} ms; most {position.max():.3f}")


def errors_of_means(mirror: Mirror, readings: int) -> tuple[float, float, float]:
    """Return the rms error of a mean force over actuators, estimated in three ways [N].

    By the scatter of readings, by means of parts of each record, and for independent samples.
    """
    bench = static_bench(mirror, 1)
    shapes = np.tile(bench.shapes[2][:, None], (1, readings))
    noise = [row_noise(1, "bare", k, 1, 1) for k in range(readings)]
    found = record(loop_of(bench), shapes, bench.load_force[0][:, None], noise)
    assert found.force_error is not None
    again = rms(found.force.std(axis=1, ddof=1))
    return float(again), float(rms(found.force_error)), float(rms(found.force_scatter) / 2048**0.5)


def print_errors(readings: int) -> None:
    """Print the error of a mean force, estimated in three ways."""
    print(f"{readings} readings of 2,048 samples: error of a mean force, uN")
    print(f"{'':12}{'taken again':>14}{'four parts':>14}{'independent':>14}")
    for mirror in (p45(), ring(8)):
        errors = "".join(f"{1e6 * each:14.2f}" for each in errors_of_means(mirror, readings))
        print(f"{mirror.name:12}{errors}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--shapes", type=int, default=360)
    parser.add_argument("--errors", action="store_true", help="of means, and nothing else")
    parser.add_argument("--figure", help="write the step responses to this PDF or PNG")
    arguments = parser.parse_args()
    if arguments.errors:
        print_errors(40)
        return
    bench = static_bench(p45(), 1)
    loop, glass = loop_of(bench), bench.glass.stiffness
    print_noise(loop, arguments.shapes)
    print_settling(loop, glass)
    if arguments.figure:
        steps = step_responses(loop, glass)
        axes = plot_step_responses(steps.time, steps.position, steps.stiffness)
        figure = axes.get_figure(root=True)
        assert figure is not None
        figure.savefig(arguments.figure, dpi=300)


if __name__ == "__main__":
    main()
