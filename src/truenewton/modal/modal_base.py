"""The modal base of a mirror: stiffness modes, and what turbulence costs on three bases."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from truenewton.arrays import Array
from truenewton.modal.dissipation import Dissipation, dissipation
from truenewton.modal.pupil import SeenTurbulence
from truenewton.modal.true_stiffness import TrueStiffness
from truenewton.records.stiffness_matrix import StiffnessMatrix
from truenewton.statics.layout import Layout
from truenewton.statics.modes import StiffnessModes


@dataclass(frozen=True, eq=False, repr=False)
class ModalBase:
    """Stiffness modes of a mirror, and what it costs to correct turbulence.

    Attributes
    ----------
    matrix
        The stiffness as measured, of all N actuators, disabled ones and those off included.
    stiffness
        What `true_stiffness` made of it, with alpha or as if it were 1.
    modes
        Its eigenmodes, softest first.
    seen
        The turbulence that it meets.
    costs
        Of the stiffness modes, Zernike's and those of Karhunen and Loeve.
    """

    matrix: StiffnessMatrix
    stiffness: TrueStiffness
    modes: StiffnessModes
    seen: SeenTurbulence
    costs: tuple[Dissipation, ...]

    def __repr__(self) -> str:
        return f"<ModalBase of {self.matrix.instrument}: {self.modes.stiffness.size} modes>"

    @property
    def layout(self) -> Layout:
        """All N actuators that the stiffness was given for."""
        return self.matrix.layout

    def on_all_actuators(self, values: Array) -> Array:
        """Return (N, k) values over all actuators from (n, k) over the enabled; 0 elsewhere."""
        on = self.layout.enabled
        if on.all():
            return values
        everywhere = np.zeros((on.size, values.shape[1]))
        everywhere[on] = values
        return everywhere


def modal_base(
    matrix: StiffnessMatrix,
    stiffness: TrueStiffness,
    modes: StiffnessModes,
    seen: SeenTurbulence,
    static: Array,
    efficiency: float,
) -> ModalBase:
    """Return the modal base of a stiffness and its modes.

    With (n,) `static_force` [N] and efficiency [N/W^1/2].

    Raises
    ------
    FormatError
        An efficiency that cannot be.
    """
    costs = (
        dissipation(name, vectors, stiffness, seen, static, efficiency)
        for name, vectors in (
            ("stiffness", modes.modes),
            ("Zernike", seen.zernike),
            ("Karhunen-Loeve", seen.karhunen_loeve),
        )
    )
    return ModalBase(matrix, stiffness, modes, seen, tuple(costs))
