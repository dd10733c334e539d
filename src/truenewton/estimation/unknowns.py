"""The order of the unknowns: alpha, B, M_y and M_x of each load, errors of the weights."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from truenewton.arrays import Array
from truenewton.statics.arms import external_load


@dataclass(frozen=True)
class Unknowns:
    """Where every unknown stands: of E alpha' = r (paper, eq. 4), of the likelihood, of results.

    Attributes
    ----------
    actuators, loads
        n, those that are enabled; L.
    weight_errors
        How many errors of the weights are unknowns as well; none in E.
    """

    actuators: int
    loads: int
    weight_errors: int = 0

    @property
    def alpha(self) -> slice:
        """The n alphas."""
        return slice(0, self.actuators)

    @property
    def bias(self) -> int:
        """B."""
        return self.actuators

    @property
    def torques(self) -> slice:
        """M_y and M_x of the first load, then of the next."""
        return slice(self.actuators + 1, self.count)

    @property
    def weights(self) -> slice:
        """The errors of the weights, in units of their standard uncertainties."""
        return slice(self.count, self.total)

    @property
    def count(self) -> int:
        """Number without the errors of the weights: 50 for P45 without and with the ring."""
        return self.actuators + 1 + 2 * self.loads

    @property
    def total(self) -> int:
        """Number of all."""
        return self.count + self.weight_errors

    def external_load_derivative(self, weight_changes: Sequence[Array] = ()) -> Array:
        """Return (L, 3, total - n): k of each load (eq. 1) by the unknowns beside alpha.

        Parameters
        ----------
        weight_changes
            For each error of the weights, (L,) change of W by its standard uncertainty [N].
        """
        derivative = np.zeros((self.loads, 3, self.total - self.actuators))
        by_bias, *by_torques = external_load(0.0, *np.eye(3))
        derivative[:, :, 0] = by_bias
        for load_index in range(self.loads):
            first = 1 + 2 * load_index
            derivative[load_index, :, first : first + 2] = np.transpose(by_torques)
        for column, change in enumerate(weight_changes, self.count - self.actuators):
            derivative[:, :, column] = external_load(change, 0.0, 0.0, 0.0)
        return derivative
