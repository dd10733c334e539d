"""Forces in steps, as a converter gives them, and the noise that they add.

A reading rounded to steps q of forces that lie anywhere in them has q^2 / 12 of variance more.
Where noise is as large as a step, repeats show all of it. Where it is less, readings of one shape
tend to the same step: of sigma^2 + q^2 / 12 repeats do not show

    b^2 = q^2 sum over k of exp(-(2 pi k sigma / q)^2) / (2 (pi k)^2),

the mean square of what rounding leaves of the mean (Fourier series of the sawtooth; Widrow and
Kollar, Quantization Noise, 2008), and no number of repeats makes it smaller.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from truenewton.arrays import Array

FINEST_STEP = 1e-6  # of the largest reading: finer steps are rounding of the computer
# Of a step, within which readings are multiples of it, or seem to be.
EXACT_MULTIPLE, NEAR_MULTIPLE = 0.02, 0.1
MIN_STEP_READINGS, MIN_STEP_GAPS = 12, 8  # readings that tell a step; gaps that give it
_SIGMA = np.linspace(0.0, 1.0, 101)  # of a step
_K = np.arange(1, 200)[:, None]
_HIDDEN = np.sum(np.exp(-((2 * np.pi * _K * _SIGMA) ** 2)) / (2 * (np.pi * _K) ** 2), axis=0)


def rounding_steps(readings: Sequence[Array]) -> Array:
    """Return (n,) the step of which the readings of each actuator are multiples [N], or 0.

    Multiples but for an offset. By Euclid's algorithm from the least gaps between readings, in
    which the rounding of stored numbers grows least; larger ones then tell it ever more exactly.

    Parameters
    ----------
    readings
        (n,) of some shapes [N].
    """
    if len(readings) < MIN_STEP_READINGS:
        return np.zeros(len(readings[0]) if readings else 0)
    ordered = np.sort(readings, axis=0)
    apart = ordered[1:] - ordered[0]
    finest = FINEST_STEP * np.maximum(np.abs(readings).max(axis=0), 1e-300)
    gaps = np.diff(ordered, axis=0)
    gaps = np.sort(np.where(gaps > finest, gaps, np.inf), axis=0)
    step = np.where(np.isfinite(gaps[0]), gaps[0], 0.0)
    for gap in gaps[1:MIN_STEP_GAPS]:
        other = np.where(np.isfinite(gap), gap, 0.0)
        while (other > finest).any():
            ended, rest = other <= finest, np.abs(_off(step, other))
            step, other = np.where(ended, step, other), np.where(ended, 0.0, rest)
    for span in np.sort([*gaps, *apart], axis=0):
        count = np.round(np.divide(span, step, out=np.zeros_like(span), where=step > finest))
        known = (count > 0) & np.isfinite(span) & (np.abs(_off(span, step)) <= NEAR_MULTIPLE * step)
        step = np.divide(span, count, out=step.copy(), where=known)
    step = _exact(step, apart, finest)
    if (step > 0.0).any():  # converters are alike as a rule
        step = np.maximum(
            step, _exact(np.where(step > 0.0, 0.0, np.median(step[step > 0.0])), apart, finest)
        )
    return step


def _exact(step: Array, apart: Array, finest: Array) -> Array:
    """Return (n,) steps, 0 where (m, n) distances are no multiples of them."""
    exact = (np.abs([_off(span, step) for span in apart]) <= EXACT_MULTIPLE * step).all(axis=0)
    return np.where(exact & (step > finest), step, 0.0)


def _off(values: Array, steps: Array) -> Array:
    """Return how far (n,) values lie from the nearest multiple of steps."""
    known = (steps > 0.0) & np.isfinite(values)
    whole = np.divide(values, steps, out=np.zeros_like(values), where=known)
    return np.where(known, values, 0.0) - steps * np.round(whole)


def hidden_variance(step: Array, seen: Array) -> Array:
    """Return b^2 [N^2], from (n,) steps [N] and the variance of a reading among its repeats."""
    square = np.maximum(step, 1e-150) ** 2
    of_repeats = _SIGMA**2 + 1 / 12 - _HIDDEN
    ratio = np.divide(seen, square, out=np.full_like(square, np.inf), where=step > 0.0)
    hidden = square * np.interp(ratio, of_repeats, _HIDDEN, right=0.0)
    return np.asarray(np.where(step > 0.0, hidden, 0.0))
