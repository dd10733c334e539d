"""Whether a stiffness is plausible: by its symmetry, its negative modes and a model of the mirror.

A wrong gain of a sensor scales one column of the stiffness, so that column and row of the actuator
differ by that factor (`TrueStiffness.column_factor`). A common factor of all sensors leaves the
stiffness symmetric; only a model shows it.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from truenewton.arrays import Array
from truenewton.chance import FALSE_ALARM, t_isf
from truenewton.errors import Fault
from truenewton.estimation.matrix.misfits import condensed
from truenewton.importers.selection import LIKELY_STIFFNESS
from truenewton.modal.true_stiffness import TrueStiffness
from truenewton.rounding import listed, percent, significant
from truenewton.statics.modes import StiffnessModes

SIGMA = 1.4826  # standard deviation of a normal distribution in units of its median deviation
EFFICIENCY = 0.37  # of that estimate: degrees of freedom for each number
ROUNDING = 1e-9  # of factors
# Diagonal relative to the model: 1.35 on the measured LBT672, since its sensors are not modelled
# without --mirror, and glass is ground to some per cent of its thickness.
MAX_MODEL_RATIO = 2.0


def unlike_others(factor: Array) -> tuple[NDArray[np.bool_], float]:
    """Return (n,) true for factors that are negative or outliers, and the scatter of the others."""
    with np.errstate(divide="ignore", invalid="ignore"):
        size = np.log(np.abs(factor))
    known = np.isfinite(size)
    if not known.any():
        return known, np.nan
    away = np.abs(size - np.median(size[known]))
    scatter = max(SIGMA * float(np.median(away[known])), ROUNDING)
    count = np.count_nonzero(known)
    limit = t_isf(FALSE_ALARM / (2 * count), EFFICIENCY * count)
    return ~np.isnan(factor) & ((factor < 0.0) | ~(away < limit * scatter)), scatter


def wrong_sensors(stiffness: TrueStiffness) -> Iterator[tuple[Fault, bool]]:
    """Yield what is wrong with sensors, by name, and whether the modes are then useless."""
    factor, ids = stiffness.column_factor, stiffness.enabled.id
    wrong, scatter = unlike_others(factor)
    if (turned := wrong & (factor < 0.0)).any():
        which = listed(ids[turned])
        yield (
            Fault(
                f"sensors with reversed sign: {which}. By symmetry, their columns of the stiffness"
                " have the wrong sign",
                "reverse the sign of their displacements",
            ),
            True,
        )
    if (others := wrong & ~turned).any():
        which = listed(f"{i} ({f:.3g})" for i, f in zip(ids[others], factor[others], strict=True))
        yield (
            Fault(
                f"sensors with a wrong gain: {which}. The number is their column of the stiffness"
                f" relative to what symmetry requires; the others scatter by {percent(scatter)}",
                "check the gain of these sensors, and alpha of these actuators",
            ),
            False,
        )


def implausible(
    stiffness: TrueStiffness, modes: StiffnessModes, model: Array | None
) -> Iterator[tuple[Fault, bool]]:
    """Yield what is implausible of a stiffness, and whether the modes are then useless.

    The (n, n) ``model`` is the stiffness of the enabled actuators by a model of the mirror [N/m].
    """
    own = np.diag(stiffness.acting_stiffness)[stiffness.acts]
    if model is not None:
        ratio = float(np.median(own / np.diag(model)[stiffness.acts]))
        if not 1.0 / MAX_MODEL_RATIO < ratio < MAX_MODEL_RATIO:
            yield (
                Fault(
                    f"the stiffness is {significant(ratio)} times that of the mirror model"
                    " (median of the diagonal)",
                    "check the units of displacements and forces, and that it is this mirror",
                ),
                True,
            )
    elif not LIKELY_STIFFNESS[0] <= (size := float(np.median(own))) < LIKELY_STIFFNESS[1]:
        yield (
            Fault(
                f"a median diagonal element of {size:.3g} N/m is implausible",
                "check the units of displacements and forces; with --mirror, the stiffness is"
                " compared to a model",
            ),
            False,
        )
    sensors = tuple(wrong_sensors(stiffness))
    yield from sensors
    # Of a free shell, bias magnets shift all modes alike, rigid ones included. Noise shifts the
    # softest by at most about the largest eigenvalue of a random symmetric matrix, here estimated
    # from K - K'.
    noise = 2 * stiffness.asymmetry * np.linalg.norm(stiffness.acting_stiffness) / np.sqrt(len(own))
    magnets = float(np.abs(modes.stiffness[:3]).max())
    softest = float(modes.stiffness[3:].min(initial=0.0))
    if not sensors and softest < -(magnets + noise):
        yield (
            Fault(
                f"the softest elastic mode has {softest:.3g} N/m; bias magnets explain at most"
                f" {-magnets:.2g} N/m, and the asymmetry of the stiffness {-noise:.2g} N/m",
                "look for wrong sensors and positions, and for other alpha",
            ),
            False,
        )


def enabled_model(model: Array | None, enabled: NDArray[np.bool_]) -> Array | None:
    """Return the (n_enabled, n_enabled) stiffness of a model in which the others exert no force."""
    return None if model is None else condensed(model, enabled)[0]
