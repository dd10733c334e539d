"""Undetermined patterns of alpha, which noise decides: which they are, and their error.

Where noise alone makes as much imbalance as a pattern of alpha would, the data say nothing of that
pattern (docs/likelihood.md). It is held at zero, so that alpha stays even over the mirror, and its
error is taken to be, root mean square over the actuators, all that alpha is seen to vary by.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import scipy.linalg

from truenewton.arrays import Array
from truenewton.estimation.diagnosis import Diagnosis
from truenewton.estimation.identifiability import balance_patterns, centred_means
from truenewton.estimation.minimum import Minimum
from truenewton.estimation.moments import Moments
from truenewton.estimation.problem import Problem

HELD = 1e10  # information on a pattern held at zero: it is known to 1e-5, for the time being


def undetermined_patterns(problem: Problem, moments: Moments, count: int) -> Array:
    """Return (n, count) patterns of alpha, orthonormal and of mean 0, that the data hold least.

    One pattern more than ``count`` cannot be told from alpha; of all that these make up together,
    those without a mean leave alpha as even as can be.
    """
    centred = centred_means(moments)
    _, patterns = balance_patterns(centred, problem.a, problem.noise.variance, count + 1)
    without_mean = scipy.linalg.null_space(patterns.mean(axis=0, keepdims=True))
    return np.asarray(np.linalg.qr(patterns @ without_mean)[0])


def with_patterns_held(problem: Problem, patterns: Array) -> Problem:
    """Return the problem with (n, k) orthonormal patterns of alpha held at zero."""
    return replace(problem, prior=problem.prior.with_more(HELD * patterns @ patterns.T))


def with_undetermined_patterns(minimum: Minimum, patterns: Array) -> Minimum:
    """Return the minimum with the error of (n, k) patterns held at zero in its covariance."""
    n, t = len(patterns), len(minimum.reading_covariance)
    pulled = np.zeros((t, patterns.shape[1]))
    pulled[:n] = HELD * patterns
    spread = float(minimum.values[:n].std())
    answer = scipy.linalg.solve(minimum.information[:t, :t], pulled, assume_a="pos")
    answer *= spread * np.sqrt(n)  # of length 1: RMS over actuators 1 / root n
    return replace(minimum, reading_covariance=minimum.reading_covariance + answer @ answer.T)


def tolerable(judged: Diagnosis, n: int) -> bool:
    """Tell whether an answer is worth having though some patterns are undetermined.

    Not where the shapes would be too few even without noise, nor where a tenth of the patterns go.
    """
    return 3 * judged.span >= n - 1 and 10 * judged.undetermined <= n
