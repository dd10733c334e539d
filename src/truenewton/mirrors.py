"""The known mirrors: numbers with their standing.

Standing of a number: [paper] Ricci et al. 2008; [conf] published configuration files of the LBT
and Magellan adaptive secondaries; [lit] other publications; [derived] computed; [guess] an
engineering value nobody vouches for.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from truenewton.actuators import Layout, rings, spherical_rings
from truenewton.errors import UnknownName

GRAVITY = 9.80665  # standard acceleration of gravity [m/s^2]


@dataclass(frozen=True)
class Shell:
    """The glass: a thin annulus of even thickness.

    Attributes
    ----------
    inner_radius, outer_radius, thickness
        Dimensions [m].
    young_modulus
        E [Pa]; Zerodur 90.3 GPa [conf].
    poisson_ratio
        nu; Zerodur 0.24 [conf].
    density
        [kg/m3]; Zerodur 2530 [conf].
    """

    inner_radius: float
    outer_radius: float
    thickness: float
    young_modulus: float = 90.3e9
    poisson_ratio: float = 0.24
    density: float = 2530.0

    @property
    def bending_stiffness(self) -> float:
        """D = E t^3 / 12 (1 - nu^2) [N m]."""
        return self.young_modulus * self.thickness**3 / (12 * (1 - self.poisson_ratio**2))

    @property
    def mass(self) -> float:
        """Mass of the glass [kg]."""
        area = np.pi * (self.outer_radius**2 - self.inner_radius**2)
        return float(area * self.thickness * self.density)


@dataclass(frozen=True)
class Mirror:
    """What is known of a mirror before it is measured.

    Attributes
    ----------
    name
        As in INSTRUME.
    layout
        The actuators.
    shell
        The glass.
    weight, weight_error
        P and its standard uncertainty [N]; negative, z points up.
    added_weight, added_weight_error
        Q of the weight tool and its standard uncertainty [N].
    bias_force
        Force of one bias magnet on the shell [N].
    magnet_mass
        Magnet with its puck [kg].
    alpha_range
        Lowest and highest true Newton / commanded Newton that the simulation draws.
    gap
        Nominal distance from the reference plate [m].
    """

    name: str
    layout: Layout
    shell: Shell
    weight: float
    weight_error: float
    added_weight: float
    added_weight_error: float
    bias_force: float
    magnet_mass: float
    alpha_range: tuple[float, float]
    gap: float


def p45() -> Mirror:
    """Return the paper's mirror.

    45 actuators in rings of 9, 15, 21, shell 1.6 mm, P = -2.920 +- 0.005 N, Q = -0.289 +- 0.005 N,
    gap 68 um, alpha 0.70 to 1.10 [paper]; ring radii 43.04, 73.34, 103.62 mm and the shell's
    27.5 to 120.005 mm [conf]; bias 97 mN an actuator, magnets 2.75 g [conf of LBT, same design].
    The statics are the paper's: a flat mirror, nz = 1.
    """
    return Mirror(
        name="P45",
        layout=rings(list(1.955 * np.sin(np.radians([1.2615, 2.1499, 3.0383]))), [9, 15, 21]),
        shell=Shell(inner_radius=27.5e-3, outer_radius=120.005e-3, thickness=1.6e-3),
        weight=-2.920,
        weight_error=0.005,
        added_weight=-0.289,
        added_weight_error=0.005,
        bias_force=0.097,
        magnet_mass=2.75e-3,
        alpha_range=(0.70, 1.10),
        gap=68e-6,
    )


def lbt672() -> Mirror:
    """Return an adaptive secondary of the Large Binocular Telescope.

    672 actuators on 14 rings of 9 + 6k at polar angles 1.2615 + 0.8884 k degrees, radius of
    curvature 1955 mm, shell 27.5 to 455.5 mm, 1.6 mm thick, bias 97 mN [conf]; weight about -44 N
    [derived]; alpha scatters by 2-5 % [derived from measured matrices]; a weight tool of -0.5 N, as
    much as its three wedges may bring to the inner ring, and all uncertainties [guess].
    """
    k = np.arange(14)
    return Mirror(
        name="LBT672",
        layout=spherical_rings(list(np.radians(1.2615 + 0.8884 * k)), list(9 + 6 * k), 1.955),
        shell=Shell(inner_radius=27.5e-3, outer_radius=455.5e-3, thickness=1.6e-3),
        weight=-44.0,
        weight_error=0.02,
        added_weight=-0.5,
        added_weight_error=0.005,
        bias_force=0.097,
        magnet_mass=2.75e-3,
        alpha_range=(0.90, 1.10),
        gap=65e-6,
    )


KNOWN: dict[str, Callable[[], Mirror]] = {"p45": p45, "lbt672": lbt672}


def mirror(name: str) -> Mirror:
    """Return the mirror called ``name``; case does not count.

    Raises
    ------
    UnknownName
        No mirror is called so.
    """
    if name.lower() not in KNOWN:
        raise UnknownName(
            f"no mirror is called '{name}'",
            remedy=f"the known ones are {', '.join(KNOWN)}",
            got=name,
            want=tuple(KNOWN),
        )
    return KNOWN[name.lower()]()
