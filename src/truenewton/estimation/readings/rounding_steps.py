"""Steps of the readings, as of a converter, and the noise that they add.

Rounding to steps q adds a variance of q^2 / 12. If the noise is as large as a step, the scatter of
repeats contains all of it. If it is smaller, readings of one shape tend to the same step, and of
sigma^2 + q^2 / 12 the scatter does not contain

    b^2 = q^2 sum over k of exp(-(2 pi k sigma / q)^2) / (2 (pi k)^2),

the mean square error of the mean by rounding (Fourier series of the sawtooth; Widrow and Kollar,
Quantization Noise, 2008), which does not decrease with the number of repeats.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from truenewton.arrays import Array

_SIGMA = np.linspace(0.0, 1.0, 101)  # of a step
_K = np.arange(1, 200)[:, None]
_HIDDEN = np.sum(np.exp(-((2 * np.pi * _K * _SIGMA) ** 2)) / (2 * (np.pi * _K) ** 2), axis=0)


def rounding_steps(readings: Sequence[Array]) -> Array:
    """Return (n,) the step of which the readings of each actuator are multiples [N], or 0.

    They may have an offset. By Euclid's algorithm from the smallest gaps between readings, in which
    rounding of stored numbers grows least; larger gaps then refine it.

    Parameters
    ----------
    readings
        (n,) of some shapes [N].
    """
    if len(readings) < 12:  # too few gaps to recognise a step
        return np.zeros(len(readings[0]) if readings else 0)
    ordered = np.sort(readings, axis=0)
    apart = ordered[1:] - ordered[0]
    # Finer steps are rounding of the computer.
    finest = 1e-6 * np.maximum(np.abs(readings).max(axis=0), 1e-300)
    gaps = np.diff(ordered, axis=0)
    gaps = np.sort(np.where(gaps > finest, gaps, np.inf), axis=0)
    step = np.where(np.isfinite(gaps[0]), gaps[0], 0.0)
    for gap in gaps[1:8]:
        other = np.where(np.isfinite(gap), gap, 0.0)
        while (other > finest).any():
            ended, rest = other <= finest, np.abs(_off(step, other))
            step, other = np.where(ended, step, other), np.where(ended, 0.0, rest)
    for span in np.sort([*gaps, *apart], axis=0):
        count = np.round(np.divide(span, step, out=np.zeros_like(span), where=step > finest))
        multiple = (count > 0) & np.isfinite(span) & (np.abs(_off(span, step)) <= 0.1 * step)
        step = np.divide(span, count, out=step.copy(), where=multiple)
    step = _exact(step, apart, finest)
    if (step > 0.0).any():  # converters are usually of one type
        step = np.maximum(
            step, _exact(np.where(step > 0.0, 0.0, np.median(step[step > 0.0])), apart, finest)
        )
    return step


def _exact(step: Array, apart: Array, finest: Array) -> Array:
    """Return (n,) steps, 0 if (m, n) distances are no multiples of them."""
    exact = (np.abs([_off(span, step) for span in apart]) <= 0.02 * step).all(axis=0)
    return np.where(exact & (step > finest), step, 0.0)


def _off(values: Array, steps: Array) -> Array:
    """Return (n,) differences of values from the nearest multiple of steps."""
    finite = (steps > 0.0) & np.isfinite(values)
    whole = np.divide(values, steps, out=np.zeros_like(values), where=finite)
    return np.where(finite, values, 0.0) - steps * np.round(whole)


def hidden_variance(step: Array, seen: Array) -> Array:
    """Return b^2 [N^2], from (n,) steps [N] and the variance of a reading among its repeats."""
    square = np.maximum(step, 1e-150) ** 2
    of_repeats = _SIGMA**2 + 1 / 12 - _HIDDEN
    ratio = np.divide(seen, square, out=np.full_like(square, np.inf), where=step > 0.0)
    hidden = square * np.interp(ratio, of_repeats, _HIDDEN, right=0.0)
    return np.asarray(np.where(step > 0.0, hidden, 0.0))
