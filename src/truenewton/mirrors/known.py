"""The known mirrors: numbers with their standing.

Standing of a number: [paper] Ricci et al. 2008; [conf] published configuration files of the LBT
and Magellan adaptive secondaries; [lit] other publications; [derived] computed; [guess] an
engineering value without a source.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import numpy as np

from truenewton.errors import UnknownName
from truenewton.mirrors.glass import Annulus, Shell
from truenewton.quantities import Quantity, convert_quantities
from truenewton.statics.layout import Layout, spherical_rings

GRAVITY = 9.80665  # standard acceleration of gravity [m/s^2]
MAX_RING_ACTUATORS = 5352
MIN_ALPHA = 1e-3  # below and above its inverse the unit of force is wrong
WEIGHT = Quantity("N", high=0.0, why="weights are negative (z points up)")
NOT_NEGATIVE = {unit: Quantity(unit, 0.0) for unit in ("N", "m", "kg", "N s/m")}


@dataclass(frozen=True, kw_only=True)
class MirrorNumbers:
    """The numbers of a mirror before it is measured, without its layout.

    Attributes
    ----------
    name
        The keyword INSTRUME.
    shell
        The glass.
    weight, weight_error
        P and its standard uncertainty [N]; negative, since z points up.
    added_weight, added_weight_error
        Q of the weight tool and its standard uncertainty [N].
    bias_force
        Force of one bias magnet on the shell [N].
    magnet_mass
        Of a magnet with its puck [kg].
    alpha_range
        Range of true Newton / commanded Newton in the simulation.
    gap
        Nominal distance from the reference plate [m].
    puck_radius
        Of the circle on which a magnet's puck pushes the glass [m].
    damping
        Force of the air on the glass at one actuator per velocity there [N s/m]; for the closed
        loop only.
    sensor
        A reading is the mean displacement over it.
    tool_radius
        Of the circle of the three wedges of the weight tool [m]; by default just outside the inner
        radius of the shell, or half the outer one if the inner one is 0.
    coil_gradient
        COILGRAD, relative change of a coil's force per displacement along +z [1/m].
    bias_gradient
        BIASGRAD, change of one bias force per displacement along +z [N/m].
    """

    QUANTITIES: ClassVar = {
        "weight": WEIGHT, "weight_error": NOT_NEGATIVE["N"], "added_weight": WEIGHT,
        "added_weight_error": NOT_NEGATIVE["N"], "bias_force": Quantity("N"),
        "magnet_mass": NOT_NEGATIVE["kg"], "gap": NOT_NEGATIVE["m"],
        "puck_radius": NOT_NEGATIVE["m"], "damping": NOT_NEGATIVE["N s/m"],
        "tool_radius": NOT_NEGATIVE["m"],
        "coil_gradient": Quantity("1/m"), "bias_gradient": Quantity("N/m"),
        "alpha_range": Quantity(
            "", MIN_ALPHA, 1.0 / MIN_ALPHA,
            "give the lowest and highest alpha, positive and near 1",
        ),
    }  # fmt: skip

    name: str
    shell: Shell
    weight: float
    weight_error: float
    added_weight: float
    added_weight_error: float
    bias_force: float = 0.0
    magnet_mass: float = 2.75e-3
    alpha_range: tuple[float, float] = (0.9, 1.1)
    gap: float = 65e-6
    puck_radius: float = 5e-3  # [guess]
    damping: float = 60.0  # of the softest modes, 68 um, plates with bores of 3.5 mm [guess]
    sensor: Annulus = field(default_factory=Annulus)
    tool_radius: float | None = None
    coil_gradient: float = 0.0
    bias_gradient: float = 0.0

    def __post_init__(self) -> None:
        convert_quantities(self)


@dataclass(frozen=True, kw_only=True)
class Mirror(MirrorNumbers):
    """A mirror before it is measured: its numbers and its actuators.

    Attributes
    ----------
    layout
        The actuators; for other attributes see `MirrorNumbers`.

    Examples
    --------
    >>> half = dataclasses.replace(tn.mirrors.p45(), name="HALF", alpha_range=(0.45, 0.55))
    >>> half.name, half.layout.n
    ('HALF', 45)
    """

    layout: Layout


# Common numbers: magnets and coils of the LBT [conf], weights [guess].
SHARED: dict[str, Any] = {
    "weight_error": 0.02,
    "added_weight": -0.5,
    "added_weight_error": 0.005,
    "bias_force": 0.097,
    "coil_gradient": 600.0,
    "bias_gradient": 31.0,
}


def standard_mirror(name: str, layout: Layout, shell: Shell, **own: Any) -> Mirror:
    """Return a mirror with the common numbers, its own, and the weight of shell and magnets."""
    magnets = MirrorNumbers.magnet_mass * layout.n
    weight = -round((shell.mass + magnets) * GRAVITY, 2)
    return Mirror(name=name, layout=layout, shell=shell, **{"weight": weight, **SHARED, **own})


def _lbt_rings(name: str, count: int, outer_radius: float, **own: Any) -> Mirror:
    """Return a mirror of the first rings of LBT672, 9 + 6k at 1.2615 + 0.8884 k degrees."""
    k = np.arange(count)
    layout = spherical_rings(list(np.radians(1.2615 + 0.8884 * k)), list(9 + 6 * k), 1.955)
    shell = Shell(27.5e-3, outer_radius, 1.6e-3, radius_of_curvature=1.955)
    return standard_mirror(name, layout, shell, **own)


def p45() -> Mirror:
    """Return the paper's mirror.

    - [paper] 45 actuators in rings of 9, 15 and 21; thickness 1.6 mm; gap 68 um; alpha 0.70 to
      1.10; P = -2.920 +- 0.005 N; Q = -0.289 +- 0.005 N
    - [conf] ring radii 43.04, 73.34 and 103.62 mm; shell from 27.5 to 120.005 mm; radius of
      curvature 1955 mm
    - [conf of LBT, same design] bias force 97 mN per actuator; magnets 2.75 g
    - [guess] damping 115 N s/m, the mean over the elastic modes if air leaves the gap only at the
      edges of the glass: 235 N s/m for the softest, 58 N s/m for the stiffest (Reynolds' equation)

    The paper treats the mirror as flat (nz = 1). Here, nz is 0.9998 to 0.9986.

    Examples
    --------
    >>> mirror = tn.mirrors.p45()
    >>> mirror.weight, mirror.added_weight, mirror.added_weight_error
    (-2.92, -0.289, 0.005)
    """
    return _lbt_rings(
        "P45",
        3,
        120.005e-3,
        weight=-2.920,
        weight_error=0.005,
        added_weight=-0.289,
        added_weight_error=0.005,
        alpha_range=(0.70, 1.10),
        gap=68e-6,
        damping=115.0,
    )


def lbt672() -> Mirror:
    """Return an adaptive secondary of the Large Binocular Telescope.

    - [conf] 672 actuators on 14 rings of 9 + 6k at polar angles 1.2615 + 0.8884 k degrees; radius
      of curvature 1955 mm; shell from 27.5 to 455.5 mm, 1.6 mm thick; bias force 97 mN
    - [derived] weight about -44 N; scatter of alpha 2 to 5 %, from measured matrices
    - [guess] added weight -0.5 N, the largest load of three wedges on the inner ring; all
      uncertainties

    Examples
    --------
    >>> tn.mirrors.lbt672().layout
    <Layout of 672 actuators>
    """
    return _lbt_rings("LBT672", 14, 455.5e-3, weight=-44.0)


def mag585() -> Mirror:
    """Return the adaptive secondary of the Magellan telescope.

    - [conf] the first 13 rings of LBT672, 585 actuators; shell from 27.5 to 425.35 mm, 1.6 mm
      thick; bias force 97 mN; gap 60 um
    - [derived] scatter of alpha 3 %; weight of shell and magnets
    - [guess] added weight; all uncertainties

    Examples
    --------
    >>> tn.mirrors.mag585().gap
    6e-05
    """
    return _lbt_rings("MAG585", 13, 425.35e-3, alpha_range=(0.95, 1.05), gap=60e-6)


def mmt336() -> Mirror:
    """Return the adaptive secondary of the MMT.

    - [conf] 336 actuators on rings of 6, 12, ... 48, 60, 60 from 42.1 to 313.1 mm, the ninth ring
      turned by 3 degrees
    - [lit] thickness 2.0 mm, +-10 %
    - [paper] no bias magnets, which were new on P45
    - [derived] weight of shell and magnets
    - [guess] shell from 27.5 to 321 mm, convex with radius 1700 mm; gap 40 um; alpha within 5 %;
      added weight -0.5 N; sensors from 3.5 to 6 mm; pucks of 3 mm; all uncertainties

    Examples
    --------
    >>> tn.mirrors.mmt336().bias_force
    0.0
    """
    radii = [42.1, 73.4, 104.8, 136.1, 167.5, 198.8, 230.1, 261.5, 290.8, 313.1]
    curvature, counts = 1.7, [6, 12, 18, 24, 30, 36, 42, 48, 60, 60]
    turned = [0.0] * 8 + [np.radians(3.0), 0.0]
    angles = np.arcsin(1e-3 * np.array(radii) / curvature)
    return standard_mirror(
        "MMT336",
        spherical_rings(list(angles), counts, curvature, turned=turned),
        Shell(27.5e-3, 321e-3, 2.0e-3, radius_of_curvature=-curvature),
        bias_force=0.0,
        bias_gradient=0.0,
        alpha_range=(0.915, 1.085),
        gap=40e-6,
        puck_radius=3e-3,
        sensor=Annulus(3.5e-3, 6e-3),
    )


def ring(actuators: int) -> Mirror:
    """Return one of the mirrors ring4 ... ring5352: rings of 9 + 6k actuators, 30.3 mm apart.

    Rings, glass and magnets are those of LBT672, for any number of actuators. The outermost ring
    may have fewer. Above 672 actuators, the radius of curvature increases with the mirror, so that
    the slope at the edge is that of LBT672. The added weight is a tenth of the weight of the
    mirror, at most 0.5 N. All numbers except those of LBT672 are a [guess].

    Parameters
    ----------
    actuators
        4 to 5,352.

    Raises
    ------
    UnknownName
        There is no such mirror.

    Examples
    --------
    >>> tn.mirrors.ring(1170).name
    'RING1170'
    """
    if not 4 <= actuators <= MAX_RING_ACTUATORS:
        raise UnknownName(
            f"there is no mirror of {actuators} rings of actuators",
            remedy=f"give ring4 to ring{MAX_RING_ACTUATORS}",
        )
    counts: list[int] = []
    while sum(counts) < actuators:
        counts.append(min(9 + 6 * len(counts), actuators - sum(counts)))
    spacing = 1.955 * np.radians(0.8884)
    arc = 1.42 * spacing + spacing * np.arange(len(counts))
    edge = float(arc[-1] + 18.4e-3)
    curvature = max(1.955, edge * 1.955 / 0.4555)
    made = standard_mirror(
        f"RING{actuators}",
        spherical_rings(list(arc / curvature), counts, curvature),
        Shell(27.5e-3, edge, 1.6e-3, radius_of_curvature=curvature),
    )
    return replace(
        made,
        weight_error=round(-made.weight * 5e-4, 4),
        added_weight=round(max(-0.5, 0.1 * made.weight), 4),
    )


KNOWN = {make.__name__: make for make in (p45, mmt336, mag585, lbt672)}


def mirror(name: str) -> Mirror:
    """Return the mirror with this name, in any case.

    Parameters
    ----------
    name
        'p45', 'mmt336', 'mag585', 'lbt672' or 'ring4' to 'ring5352'.

    Raises
    ------
    UnknownName
        There is no such mirror.

    Examples
    --------
    >>> tn.mirrors.mirror("LBT672").layout.n
    672
    """
    known = name.lower()
    if known in KNOWN:
        return KNOWN[known]()
    if re.fullmatch(r"ring\d{1,9}", known):
        return ring(int(known[4:]))
    raise UnknownName(
        f"no mirror is called '{name}'",
        remedy=f"the known ones are {', '.join(KNOWN)}, ring4 to ring{MAX_RING_ACTUATORS},"
        " in segments m4 and gmt;"
        " or give a file",
    )
