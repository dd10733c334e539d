"""The thresholds between the grades of a result, in one table (docs/verdict.md prints it)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, fields
from typing import Any

from truenewton.estimation.findings.code import Level


def _at(value: float, level: Level, quantity: str) -> Any:
    """Return a field with its default, the level beyond it, and what is compared."""
    return field(default=value, metadata={"level": level, "quantity": quantity})


@dataclass(frozen=True)
class Thresholds:
    """Beyond which a result has a grade; `rows` tells what each is compared with."""

    fit_probability: float = _at(
        1e-3, Level.DOUBTFUL, "probability of a misfit as large by chance: less"
    )
    rejected_fraction: float = _at(0.1, Level.DOUBTFUL, "rows that do not fit: a larger share")
    # E_STAT grows with the root of chi2/DOF, as if what is left were noise. A hundred times the
    # noise is none: with a mN of noise, 0.1 N per reading.
    reduced_chi2: float = _at(1e4, Level.REJECTED, "chi2/DOF: more")
    relative_error: float = _at(1 / 3, Level.REJECTED, "typical E_STAT in terms of alpha: more")
    bad_fraction: float = _at(
        0.03, Level.REJECTED, "actuators that are silent or negative: a larger share, and over two"
    )
    lowest_alpha: float = _at(0.5, Level.REJECTED, "median alpha under known weights: less")
    highest_alpha: float = _at(2.0, Level.REJECTED, "median alpha under known weights: more")
    load_gain: float = _at(
        2.0, Level.DOUBTFUL, "half of a gain that differs between loads in terms of E_ALPHA: more"
    )
    svd_bias: float = _at(1.0, Level.DOUBTFUL, "bias of svd in terms of its E_STAT: more")
    held_out_ratio: float = _at(
        2.5, Level.DOUBTFUL, "imbalance of held-out modes in terms of fitted ones: more"
    )
    misfit_fraction: float = _at(
        0.1, Level.DOUBTFUL, "actuators of a matrix that do not fit: a larger share, over three"
    )
    asymmetry_ratio: float = _at(
        0.95, Level.DOUBTFUL, "asymmetry with alpha in terms of that without, beyond 0.5 %: more"
    )
    negative_edges: float = _at(
        1.5, Level.DOUBTFUL, "negative elastic mode in terms of the largest that noise makes: more"
    )
    pattern_share: float = _at(
        0.4, Level.DOUBTFUL, "imbalance of columns that has the pattern of one mistake: more, and"
    )
    pattern_shift: float = _at(0.9, Level.DOUBTFUL, "alpha moves by it in terms of its error: more")
    gain_correlation: float = _at(
        0.3, Level.DOUBTFUL, "correlation of sensor gains with alpha: more, and"
    )
    gain_sigmas: float = _at(3.5, Level.DOUBTFUL, "the same in sigma: more")
    gradient_sigmas: float = _at(
        7.0, Level.DOUBTFUL, "gradient of the sensor gains across the mirror in sigma: more"
    )
    column_noise: float = _at(
        60.0, Level.USABLE, "imbalance of a column, squared, in terms of the median: more"
    )
    outlier_spreads: float = _at(
        5.0, Level.USABLE, "alpha of an actuator from the others in robust sigma: more"
    )
    scale_share: float = _at(2.0, Level.USABLE, "E_SYST in terms of E_STAT: more")


LIMITS = Thresholds()


def rows() -> Iterator[tuple[str, str, str]]:
    """Yield grade, quantity and value of each threshold, the worst grade first."""
    for each in sorted(fields(LIMITS), key=lambda each: each.metadata["level"]):
        yield (
            str(each.metadata["level"]),
            each.metadata["quantity"],
            f"{getattr(LIMITS, each.name):.3g}",
        )
