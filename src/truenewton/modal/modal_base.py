"""The modal base of a mirror: stiffness modes, and what turbulence costs on three bases."""

from __future__ import annotations

import datetime
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truenewton.actuators import Array, Layout
from truenewton.calibration import Calibration
from truenewton.errors import FormatError
from truenewton.measurements import StiffnessMatrix
from truenewton.modal.bases import karhunen_loeve_modes, zernike_modes
from truenewton.modal.dissipation import EFFICIENCY, Dissipation, dissipation
from truenewton.modal.stiffness import TrueStiffness, true_stiffness
from truenewton.modal.turbulence import WAVELENGTH, Atmosphere, wavefront_covariance
from truenewton.modes import StiffnessModes
from truenewton.statics import arms, effective_weight, external_load

LBT_MAGNIFICATION = 4.11 / 0.452  # pupil over mirror, of LBT's secondaries


@dataclass(frozen=True)
class Pupil:
    """How the mirror lies in the telescope's entrance pupil.

    Attributes
    ----------
    radius
        Of the mirror's optical surface, on the plane of the actuators' x and y [m].
    diameter
        Of the entrance pupil that it fills [m].
    """

    radius: float
    diameter: float

    def __post_init__(self) -> None:
        for name in ("radius", "diameter"):
            value = getattr(self, name)
            if not 0.0 < value < np.inf:
                raise FormatError(
                    f"the {name} of the pupil is {value:g} m", remedy="give it in metres", got=value
                )


def pupil_of(layout: Layout, diameter: float | None = None) -> Pupil:
    """Return the pupil that a mirror fills, its edge half an actuator's spacing outside the last.

    Magnified as the secondaries of LBT (4.11 m in the pupil for 0.452 m) where no diameter [m] is
    given.
    """
    outermost = float(np.hypot(layout.x, layout.y).max())
    radius = outermost * (1.0 + 0.5 * np.sqrt(np.pi / layout.n))
    return Pupil(radius, 2.0 * LBT_MAGNIFICATION * radius if diameter is None else diameter)


@dataclass(frozen=True, eq=False, repr=False)
class ModalBase:
    """Stiffness modes of a mirror, and what it costs to correct turbulence.

    Attributes
    ----------
    instrument, date
        The mirror; when its stiffness was measured (UTC).
    layout
        All N actuators that the stiffness was given for, disabled ones and those off included.
    acting
        IDs of those that apply force.
    stiffness
        The true stiffness, or what was measured where nothing is calibrated.
    modes
        Its eigenmodes, softest first.
    atmosphere, pupil
        The turbulence, and what of it the mirror sees.
    costs
        Of the stiffness modes, Zernike's and those of Karhunen and Loeve.
    """

    instrument: str
    date: datetime.datetime
    layout: Layout
    acting: NDArray[np.int64]
    stiffness: TrueStiffness
    modes: StiffnessModes
    atmosphere: Atmosphere
    pupil: Pupil
    costs: tuple[Dissipation, Dissipation, Dissipation]

    def __repr__(self) -> str:
        return f"<ModalBase of {self.instrument}: {self.modes.stiffness.size} modes>"

    @property
    def fitting_error(self) -> float:
        """Rms wavefront between the actuators, which no number of modes takes away [m].

        0.28 (d / r0)^(5/3) rad^2 of a continuous face sheet at 500 nm (Hudgin 1977, JOSA 67, 393),
        with d the spacing of the actuators in the pupil, from the area of each.
        """
        spacing = 0.5 * self.pupil.diameter * np.sqrt(np.pi / self.stiffness.layout.n)
        variance = 0.28 * (spacing / self.atmosphere.fried_parameter) ** (5 / 3)
        return float(WAVELENGTH / (2 * np.pi) * np.sqrt(variance))

    def on_all_actuators(self, values: Array) -> Array:
        """Return (N, k) values over all actuators from (n, k) over the enabled; 0 elsewhere."""
        whole = np.zeros((self.layout.n, values.shape[1]))
        whole[np.isin(self.layout.id, self.stiffness.enabled.id)] = values
        return whole


def modal_base(
    matrix: StiffnessMatrix,
    calibration: Calibration | None,
    atmosphere: Atmosphere,
    *,
    pupil: Pupil | None = None,
    at_rest: Array | None = None,
    efficiency: float = EFFICIENCY,
    sensor_gain: Array | None = None,
    off: Sequence[int] = (),
    slaved: Sequence[int] = (),
) -> ModalBase:
    """Return the modal base of a measured stiffness, with alpha or as if it were 1.

    Parameters
    ----------
    matrix
        The measured stiffness; see `measured_stiffness`.
    calibration
        Gives alpha; None takes it for 1, as before a calibration.
    atmosphere, pupil
        The turbulence; where it meets the mirror, see `pupil_of`.
    at_rest
        (n,) commanded force of all the matrix's actuators at rest [N], see `force_at_rest`; the
        least that carries the calibration's weight and bias where None, or none.
    efficiency
        Commanded force per root of power [N/W^1/2].
    sensor_gain, off, slaved
        As in `true_stiffness`.

    Raises
    ------
    FormatError, CampaignMismatch, UnknownName
    """
    if not 0.0 < efficiency < np.inf:
        raise FormatError(
            f"an efficiency of {efficiency:g} N/W^1/2",
            remedy="give the commanded force per root of power, as 0.51",
            got=efficiency,
        )
    stiffness = true_stiffness(matrix, calibration, sensor_gain=sensor_gain, off=off, slaved=slaved)
    layout, modes = stiffness.layout, stiffness.modes
    pupil = pupil or pupil_of(stiffness.enabled)
    x, y = layout.x / pupil.radius, layout.y / pupil.radius
    half = 0.5 * pupil.diameter
    wavefront = wavefront_covariance(half * x, half * y, atmosphere)
    static = _static_force(stiffness, matrix, calibration, at_rest, off)
    bases = (
        ("stiffness", modes.modes),
        ("Zernike", zernike_modes(x, y)),
        ("Karhunen-Loeve", karhunen_loeve_modes(wavefront)),
    )
    costs = tuple(
        dissipation(
            name,
            vectors,
            stiffness.forces,
            wavefront,
            alpha=stiffness.enabled_alpha,
            static=static,
            efficiency=efficiency,
        )
        for name, vectors in bases
    )
    return ModalBase(
        matrix.instrument,
        matrix.date,
        matrix.layout,
        np.setdiff1d(stiffness.enabled.id, off),
        stiffness,
        modes,
        atmosphere,
        pupil,
        (costs[0], costs[1], costs[2]),
    )


def _static_force(
    stiffness: TrueStiffness,
    matrix: StiffnessMatrix,
    calibration: Calibration | None,
    at_rest: Array | None,
    off: Sequence[int],
) -> Array:
    """Return (n,) true static force of the enabled actuators; those that are off have none.

    What the actuators that are off no longer bear, the least forces of the others do.
    """
    layout = stiffness.enabled
    A = arms(layout)
    if at_rest is not None:
        force = stiffness.enabled_alpha * at_rest[matrix.layout.enabled]
    elif calibration is not None and calibration.loads and np.isfinite(calibration.bias_force):
        c, first = calibration, calibration.loads[0]
        weight = effective_weight(c.weight, first.added, first.tilt)
        k = external_load(weight, c.bias_force, c.torque_y[0], c.torque_x[0])
        force = -np.linalg.pinv(A) @ k
    else:
        return np.zeros(layout.n)
    on = ~np.isin(layout.id, off)
    borne = np.where(on, force, 0.0)
    borne[on] += np.linalg.pinv(A[:, on]) @ (A @ (force - borne))
    return np.asarray(borne)
