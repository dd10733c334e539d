"""The verdict on whether data fix alpha."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Diagnosis:
    """How well the data fix what was asked of them.

    Attributes
    ----------
    eigenvalues
        Squared imbalance that the data leave in patterns of alpha, ascending; the first belongs to
        alpha itself and is noise, every pattern that the data hold stands above it.
    undetermined
        Number of further patterns that the data cannot tell from noise.
    faults
        What is missing, each with its remedy; empty when alpha can be had.
    warnings
        What looks wrong, each with its remedy, though alpha could be had.
    """

    eigenvalues: tuple[float, ...]
    undetermined: int
    faults: tuple[tuple[str, str], ...]
    warnings: tuple[tuple[str, str], ...] = ()

    @property
    def separation(self) -> float:
        """Ratio of the second singular value to the first: how clearly alpha stands apart."""
        if len(self.eigenvalues) < 2:
            return float("nan")
        rounding = np.finfo(float).eps * self.eigenvalues[-1]
        return float(np.sqrt(self.eigenvalues[1] / max(self.eigenvalues[0], rounding)))
