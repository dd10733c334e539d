"""Where the mirror lies in the telescope's pupil, and the turbulence that it sees there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truenewton.arrays import Array, freeze
from truenewton.errors import FormatError
from truenewton.modal.bases import overwritten_by_modes, zernike_modes
from truenewton.modal.turbulence import WAVELENGTH, Atmosphere, counted_from, wavefront_covariance
from truenewton.statics.layout import Layout

WIDEST = 100.0  # telescope; beyond it the unit has slipped [m]
NARROWEST = 1e-3  # [m]
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
            if not NARROWEST <= value < np.inf:
                raise FormatError(
                    f"the {name} of the pupil is {value:g} m", remedy="give it in metres", got=value
                )
        if self.diameter > WIDEST:
            raise FormatError(
                f"the diameter of the pupil is {self.diameter:g} m",
                remedy="give the telescope's, in metres",
                got=self.diameter,
            )


def centred(layout: Layout) -> tuple[Array, Array]:
    """Return (n,) x and y [m], of a segment from its middle: it is a pupil of its own."""
    if layout.segment is None or layout.segments:
        return layout.x, layout.y
    x, y = (each - 0.5 * (each.min() + each.max()) for each in (layout.x, layout.y))
    return x, y


def pupil_of(layout: Layout, diameter: float | None = None, radius: float | None = None) -> Pupil:
    """Return the pupil that a mirror fills.

    The mirror ends half an actuator's spacing outside the last where no radius [m] is given; it is
    magnified as the secondaries of LBT (4.11 m in the pupil for 0.452 m) where no diameter [m] is.

    Raises
    ------
    FormatError
        A diameter or a radius that cannot be.
    """
    if radius is None:
        outermost = float(np.hypot(*centred(layout)).max())
        radius = outermost * (1.0 + 0.5 * np.sqrt(np.pi / layout.n))
    return Pupil(radius, 2.0 * LBT_MAGNIFICATION * radius if diameter is None else diameter)


@dataclass(frozen=True, eq=False, repr=False)
class SeenTurbulence:
    """Turbulence at n actuators of which m are commanded, and two bases that optics have for it.

    Attributes
    ----------
    atmosphere, pupil
        The turbulence, and what of it the mirror sees.
    wavefront
        (n, n) covariance of the wavefront, counted from its mean over the commanded [m^2].
    zernike, karhunen_loeve
        (m, m) modes, orthonormal on these, one a column.
    """

    atmosphere: Atmosphere
    pupil: Pupil
    wavefront: Array
    zernike: Array
    karhunen_loeve: Array

    def __post_init__(self) -> None:
        freeze(self, "wavefront", "zernike", "karhunen_loeve")

    def __repr__(self) -> str:
        return f"<SeenTurbulence at {len(self.wavefront)} actuators, {self.atmosphere}>"

    @property
    def fitting_error(self) -> float:
        """Rms wavefront between the actuators, which no number of modes takes away [m].

        0.28 (d / r0)^(5/3) rad^2 of a continuous face sheet at 500 nm (Hudgin 1977, JOSA 67, 393),
        with d the spacing of the actuators in the pupil, from the area of each. Those that are off
        or slaved count: what they miss is part of the residual.
        """
        spacing = 0.5 * self.pupil.diameter * np.sqrt(np.pi / len(self.wavefront))
        variance = 0.28 * (spacing / self.atmosphere.fried_parameter) ** (5 / 3)
        return float(WAVELENGTH / (2 * np.pi) * np.sqrt(variance))


def seen_turbulence(
    layout: Layout, commanded: NDArray[np.bool_], atmosphere: Atmosphere, pupil: Pupil
) -> SeenTurbulence:
    """Return the turbulence at the n actuators of a mirror, of which (n,) ``commanded`` are true.

    Raises
    ------
    GeometryError
        Actuators so close to each other that Zernikes do not tell them apart.
    """
    x, y = (each / pupil.radius for each in centred(layout))
    half = 0.5 * pupil.diameter
    wavefront = wavefront_covariance(half * x, half * y, atmosphere)
    mean = wavefront @ commanded / np.count_nonzero(commanded)
    counted_from(wavefront, mean, float(mean[commanded].mean()))
    karhunen_loeve = overwritten_by_modes(wavefront[np.ix_(commanded, commanded)])
    zernike = zernike_modes(x[commanded], y[commanded])
    for values in (wavefront, karhunen_loeve, zernike):
        values.setflags(write=False)  # so that the record need not copy them
    return SeenTurbulence(atmosphere, pupil, wavefront, zernike, karhunen_loeve)
