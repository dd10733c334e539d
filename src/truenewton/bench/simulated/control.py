"""What runs in the electronics of each actuator.

They see their own sensor (y, a displacement along +z) and the command of the whole mirror (z_c, its
shape; K_c, the feed-forward):

    c = r_f(t) K_c z_c + k_p L(r_p(t) z_c - y) - k_d D y

r_p and r_f are the ramps of position and force; L = g (1 + s/w) / (1 + s g/w) is the
pseudo-integrator, of gain g far below w and 1 above; D = s / (1 + s/p)^2 the derivative. Poles are
mapped to samples exactly (z = exp(s period)); the derivative is a backward difference.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from truenewton.arrays import Array


@dataclass(frozen=True, eq=False)
class Control:
    """What runs in the electronics.

    Attributes
    ----------
    feed_forward
        (n, n) K_c, commanded force per measured displacement [N/m].
    proportional
        k_p, commanded force per displacement [N/m]; 0.13e6 [conf].
    derivative
        k_d [N s/m]; 30 [conf]; of the measured displacement alone [guess].
    derivative_pole
        Both poles [Hz]; 15 kHz [conf].
    slow_gain, slow_corner
        g and w / 2 pi [Hz] of the pseudo-integrator; 5, 10 Hz [conf]; that its gain is back
        at 1 above w, its pole so at w / g = 2 Hz, is how we read that [guess].
    position_ramp, force_ramp
        Half a cosine wave [guess] long [s]; 0.1 and 0.75 ms [conf].
    rate
        Samples a second; 71.6 kHz [conf].
    delay
        Whole samples between a reading and the force that answers it [guess].
    """

    feed_forward: Array
    proportional: float = 0.13e6
    derivative: float = 30.0
    derivative_pole: float = 15e3
    slow_gain: float = 5.0
    slow_corner: float = 10.0
    position_ramp: float = 0.1e-3
    force_ramp: float = 0.75e-3
    rate: float = 71.6e3
    delay: int = 1

    @property
    def period(self) -> float:
        """Between samples [s]."""
        return 1 / self.rate

    @property
    def swift(self) -> float:
        """How much of a step each derivative pole follows in one sample."""
        return float(1 - np.exp(-2 * np.pi * self.derivative_pole / self.rate))

    @property
    def slow(self) -> float:
        """The same of the pseudo-integrator's pole, w / g."""
        return float(1 - np.exp(-2 * np.pi * self.slow_corner / self.slow_gain / self.rate))


def ramp(time: float, duration: float) -> float:
    """Return how much of a step has been commanded: half a cosine wave from 0 to 1."""
    return float(0.5 - 0.5 * np.cos(np.pi * min(time / duration, 1.0)))
