"""The unit of a matrix: as told, as declared, or by the size of its own elements."""

from __future__ import annotations

import numpy as np

from truenewton.arrays import Array
from truenewton.errors import FormatError
from truenewton.estimation.matrix.order import refuse_no_stiffness
from truenewton.foreign.positions import in_unit

LIKELY = (2e4, 1e9)  # median own stiffness of a mirror [N/m]
LARGEST = 1e30  # element in any unit
NOMINAL = 1e6  # that given to a matrix whose unit is unknown [N/m]


def in_newton_per_metre(k: Array, unit: str | None, declared: str) -> tuple[Array, str]:
    """Return an (n, n) matrix in N/m, and what was taken for its unit.

    Parameters
    ----------
    k
        (n, n), NaN where nothing was measured.
    unit, declared
        As told, or None; as its file declares, or ''.

    Raises
    ------
    FormatError
    """
    most = float(np.max(np.abs(k), where=np.isfinite(k), initial=0.0))
    if most > LARGEST:
        raise FormatError(f"holds an element of {most:.3g}", remedy="measure it again", got=most)
    if not np.isfinite(k).any():
        raise FormatError("holds no finite number", remedy="measure it again")
    refuse_no_stiffness(np.nan_to_num(k, posinf=0.0, neginf=0.0))
    own = np.abs(np.diag(k))
    own = own[np.isfinite(own) & (own > 0.0)]
    typical = float(np.median(own)) if own.size else 0.0
    if not typical:
        raise FormatError(
            "is zero on its diagonal", remedy="give a stiffness or feed-forward matrix"
        )
    if unit == "unknown":
        said = f"unit unknown: its median own stiffness is called {NOMINAL:g} N/m; alpha does not"
        return k * (NOMINAL / typical), f"{said} mind, forces and modes are in that unit"
    said = unit or declared
    if said:
        factor = in_unit(1.0, said, "N/m", "the matrix", None)
        how = f"as {'told' if unit else 'declared'}: a median own stiffness of"
        how += f" {abs(factor) * typical:.3g} N/m"
        doubt = "" if _is_likely(abs(factor) * typical) else ", UNLIKELY of a mirror: check it"
        return k * factor, f"{said} {how}{doubt}"
    if not _is_likely(typical):
        per = {"N/um": 1e6, "N/mm": 1e3, "mN/um": 1e3, "N/nm": 1e9, "uN/nm": 1e3}
        fitting = [name for name, f in per.items() if _is_likely(typical * f)]
        raise FormatError(
            f"declares no unit, and a median own stiffness of {typical:.3g} N/m is no mirror's",
            remedy=f"say which by --unit (unit=), as {', '.join((*fitting, 'unknown'))}; of"
            " displacement per force give the inverse",
            got=typical,
        )
    return k, f"N/m, as the median own stiffness is {typical:.3g}"


def _is_likely(stiffness: float) -> bool:
    """Tell whether a median own stiffness [N/m] may be a mirror's."""
    return LIKELY[0] <= stiffness < LIKELY[1]
