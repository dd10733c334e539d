"""The codes of findings, what each is about, and the levels of a result with their thresholds."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, fields
from enum import Enum, StrEnum
from typing import Any


class Code(StrEnum):
    """The kind of a finding; the value is written to files, and never changes.

    Examples
    --------
    >>> tn.Code("gain-by-hour").name
    'GAIN_BY_HOUR'
    """

    # What a bench does beside the model.
    GAIN_BY_HOUR = "gain-by-hour"
    GAIN_BY_HOUR_OF_EACH = "gain-by-hour-of-each"
    GAIN_BY_FILE = "gain-by-file"
    GAIN_BY_FILE_OF_SINGLE = "gain-by-file-of-single"
    GAIN_BY_LOAD = "gain-by-load"
    WEIGHT_OF_LOAD = "weight-of-load"
    ZERO_BY_HOUR = "zero-by-hour"
    ZERO_BY_HOUR_OF_EACH = "zero-by-hour-of-each"
    ZERO_BY_FILE = "zero-by-file"
    ZERO_BY_FILE_OF_EACH = "zero-by-file-of-each"
    ZERO_RANDOM_WALK = "zero-random-walk"
    LOAD_REPOSITIONED = "load-repositioned"
    QUADRATIC_COIL = "quadratic-coil"
    QUADRATIC_COIL_OF_EACH = "quadratic-coil-of-each"
    CUBIC_COIL = "cubic-coil"
    CUBIC_COIL_OF_EACH = "cubic-coil-of-each"
    COIL_GRADIENT = "coil-gradient"
    BIAS_GRADIENT = "bias-gradient"
    CONTACT_IN_ONE_SIGN = "contact-in-one-sign"
    CONTACT_IN_ONE_SIGN_BY_LOAD = "contact-in-one-sign-by-load"
    POSITIONS = "positions"
    SHELL_CURVATURE = "shell-curvature"
    UNKNOWN_FORCE = "unknown-force"
    UNKNOWN_EFFECT = "unknown-effect"
    CORRELATED_NOISE = "correlated-noise"
    NOISE_BY_FORCE = "noise-by-force"
    TEMPERATURE_BETWEEN_LOADS = "temperature-between-loads"
    # Single actuators and sensors.
    DEAD_NO_FORCE = "dead-no-force"
    DEAD_ALPHA_ZERO = "dead-alpha-zero"
    STUCK_READING = "stuck-reading"
    NEGATIVE_ALPHA = "negative-alpha"
    FROZEN_SENSOR = "frozen-sensor"
    ACTUATOR_OFF = "actuator-off"
    ACTUATOR_MISFIT = "actuator-misfit"
    # Files that are not what they say.
    COPIED_FILE = "copied-file"
    OTHER_UNIT = "other-unit"
    OTHER_SIGN = "other-sign"
    OTHER_LOAD = "other-load"
    LOAD_OF_TWO_NAMES = "load-of-two-names"
    EXCHANGED_COLUMNS = "exchanged-columns"
    OTHER_ORDER = "other-order"
    OTHER_ROW = "other-row"
    SAME_READINGS = "same-readings"
    ORDER_OF_POSITION = "order-of-position"
    CONSTANT_POSITION = "constant-position"
    UNUSABLE_CALIBRATION = "unusable-calibration"
    # Rows that are not what their labels say.
    SIGN_REVERSED = "sign-reversed"
    SHAPE_OFFSET = "shape-offset"
    OTHER_LABELS = "other-labels"
    # A stiffness matrix as a whole.
    ASYMMETRIC_STIFFNESS = "asymmetric-stiffness"
    NEGATIVE_STIFFNESS = "negative-stiffness"
    DISORDERED_STIFFNESS = "disordered-stiffness"
    INCOMPLETE_STIFFNESS = "incomplete-stiffness"
    FORCES_AT_REST = "forces-at-rest"
    SYMMETRISED_STIFFNESS = "symmetrised-stiffness"
    TRANSPOSED_STIFFNESS = "transposed-stiffness"
    CLEANED_STIFFNESS = "cleaned-stiffness"
    TRUE_STIFFNESS = "true-stiffness"
    # What the data of a campaign constrain.
    WEAK_PATTERNS = "weak-patterns"
    CONSTRAINED_PATTERNS = "constrained-patterns"
    WORSE_THAN_UNIFORM = "worse-than-uniform"
    NO_LOAD_SEEN = "no-load-seen"
    ONE_LOAD = "one-load"
    EQUAL_LOADS = "equal-loads"
    SIMILAR_LOADS = "similar-loads"
    NO_OTHER_LOAD = "no-other-load"
    ERROR_TOO_LARGE = "error-too-large"
    # Numbers beside the readings.
    DATES_APART = "dates-apart"
    TEMPERATURE_IMPLAUSIBLE = "temperature-implausible"
    SIZE_IMPLAUSIBLE = "size-implausible"
    WEIGHT_ABOVE_FORCES = "weight-above-forces"
    WEIGHT_BELOW_BIAS = "weight-below-bias"
    WEIGHTS_DISAGREE = "weights-disagree"
    WEIGHTS_WITHOUT_ERRORS = "weights-without-errors"
    SCALE_BY_WEIGHTS = "scale-by-weights"
    ALPHA_FAR_FROM_ONE = "alpha-far-from-one"
    # The noise, and how well the model fits.
    NOISE_ABOVE_DECLARED = "noise-above-declared"
    NOISE_BELOW_DECLARED = "noise-below-declared"
    FORCE_STEPS = "force-steps"
    ZEROS_RESET = "zeros-reset"
    MISFIT = "misfit"
    MISFIT_EXPLAINED = "misfit-explained"
    GLASS_NOT_MODELLED = "glass-not-modelled"
    EFFECT_WITHOUT_POSITION = "effect-without-position"
    MISFIT_OF_SVD = "misfit-of-svd"
    MISFIT_SENSELESS = "misfit-senseless"
    FIT_TOO_GOOD = "fit-too-good"
    ROWS_REJECTED = "rows-rejected"
    MANY_ROWS_REJECTED = "many-rows-rejected"
    SVD_USES_ALL_ROWS = "svd-uses-all-rows"
    SVD_BIAS = "svd-bias"
    SVD_BIAS_LARGE = "svd-bias-large"
    # Single values of alpha.
    MANY_SILENT = "many-silent"
    MANY_NEGATIVE = "many-negative"
    ALL_NEGATIVE = "all-negative"
    ALPHA_ZERO = "alpha-zero"
    ALPHA_OUTLIER = "alpha-outlier"
    # A stiffness matrix and its elastic modes.
    STIFFNESS_UNIT = "stiffness-unit"
    LOOKS_TRANSPOSED = "looks-transposed"
    COLUMN_NOISE_NOT_INDEPENDENT = "column-noise-not-independent"
    HALVES_INSUFFICIENT = "halves-insufficient"
    HELD_OUT_IMBALANCE = "held-out-imbalance"
    HARMFUL_ALPHA = "harmful-alpha"
    MISFITS_KEPT = "misfits-kept"
    MANY_MISFITS = "many-misfits"
    OFF_BUT_PUSHING = "off-but-pushing"
    NEGATIVE_MODES = "negative-modes"
    NEGATIVE_MODES_IN_NOISE = "negative-modes-in-noise"
    SYMMETRY_NOT_IMPROVED = "symmetry-not-improved"
    COHERENT_IMBALANCE = "coherent-imbalance"
    COLUMNS_UNBALANCED = "columns-unbalanced"
    GAINS_FOLLOW_ALPHA = "gains-follow-alpha"
    GAINS_HAVE_GRADIENT = "gains-have-gradient"
    SEGMENTS_COUPLED = "segments-coupled"
    # Reciprocity: used, or why it was not.
    RECIPROCITY_NOT_USED = "reciprocity-not-used"
    RECIPROCITY_DOUBTFUL = "reciprocity-doubtful"
    RECIPROCITY_EXCLUDED = "reciprocity-excluded"
    RECIPROCITY_INFLATED = "reciprocity-inflated"
    BALANCE_CONTRADICTS_SYMMETRY = "balance-contradicts-symmetry"
    EFFECT_PRESENT = "effect-present"
    ESTIMATE_FAILED = "estimate-failed"
    INTERRUPTED = "interrupted"
    MISFIT_ACTUATORS = "misfit-actuators"
    TRANSPOSED = "transposed"
    SHARED_NOISE = "shared-noise"
    UNTESTED_SIZE = "untested-size"
    EQUATIONS_MISFIT = "equations-misfit"
    HELD_OUT_WORSE = "held-out-worse"
    ESTIMATES_APART = "estimates-apart"
    ERRORS_LARGER = "errors-larger"
    SENSORS_FAR = "sensors-far"
    # A plan.
    PLANNED_WEAK_PATTERNS = "planned-weak-patterns"
    PLANNED_REFUSAL = "planned-refusal"
    PLANNED_FORCE_TOO_LARGE = "planned-force-too-large"
    # An earlier calibration.
    EARLIER_FINDING = "earlier-finding"
    RECALIBRATION_LIMIT = "recalibration-limit"
    LAW_OF_REJECTED_DAY = "law-of-rejected-day"
    # Two matrices compared.
    PAIR_UNITS = "pair-units"
    PAIR_PATTERN = "pair-pattern"
    PAIR_ROWS = "pair-rows"
    PAIR_NOISE = "pair-noise"
    PAIR_GLASS = "pair-glass"
    PAIR_EXCESS = "pair-excess"
    PAIR_NOT_CONVERGED = "pair-not-converged"
    # No alpha at all.
    NO_ALPHA = "no-alpha"
    # Found by another version, and kept as it was written.
    OTHER = "other"


class Level(StrEnum):
    """Whether the stated errors of a result are valid, ordered from the worst.

    Examples
    --------
    >>> tn.Level.DOUBTFUL < tn.Level.USABLE <= tn.Level.SOUND
    True
    """

    NONE = "no alpha"
    REJECTED = "rejected"
    DOUBTFUL = "doubtful"
    USABLE = "usable"
    SOUND = "sound"

    @property
    def rank(self) -> int:
        """Its index from the worst, 0."""
        return list(Level).index(self)

    def __lt__(self, other: str) -> bool:
        return self.rank < Level(other).rank

    def __le__(self, other: str) -> bool:
        return self.rank <= Level(other).rank

    def __gt__(self, other: str) -> bool:
        return self.rank > Level(other).rank

    def __ge__(self, other: str) -> bool:
        return self.rank >= Level(other).rank


class Concern(Enum):
    """What a finding is about, and so its consequence for the result."""

    BENCH = "bench"
    FILES = "files"  # files that are not what they claim: only the user can decide
    ROWS = "rows"  # labels of rows: if the rest fits, the rows that disagreed were left out
    SILENT = "silent"  # an actuator that does not respond
    RESULT = "result"  # what the data determine, and how well they fit


def _at(value: float, level: Level, quantity: str) -> Any:
    """Return a field with its default, the level beyond it, and what is compared."""
    return field(default=value, metadata={"level": level, "quantity": quantity})


@dataclass(frozen=True)
class Thresholds:
    """Thresholds of the levels of a result (docs/verdict.md prints them)."""

    fit_probability: float = _at(
        1e-3, Level.DOUBTFUL, "probability that chance alone gives a misfit this large, below"
    )
    rejected_fraction: float = _at(0.1, Level.DOUBTFUL, "fraction of rows that do not fit, above")
    # E_STAT grows with the root of chi2/DOF, as if what is left were noise. A hundred times the
    # noise is none: with a mN of noise, 0.1 N per reading.
    reduced_chi2: float = _at(1e4, Level.REJECTED, "chi2/DOF, above")
    relative_error: float = _at(1 / 3, Level.REJECTED, "typical E_STAT / alpha, above")
    bad_fraction: float = _at(
        0.03,
        Level.REJECTED,
        "fraction of actuators that are dead or have negative alpha (if more than two), above",
    )
    lowest_alpha: float = _at(0.5, Level.REJECTED, "median alpha under known weights, below")
    highest_alpha: float = _at(2.0, Level.REJECTED, "median alpha under known weights, above")
    load_gain: float = _at(
        2.0, Level.DOUBTFUL, "half of the gain difference between loads / E_ALPHA, above"
    )
    svd_bias: float = _at(1.0, Level.DOUBTFUL, "bias of method svd / E_STAT, above")
    error_share: float = _at(
        0.5, Level.DOUBTFUL, "share of error in the variance of alpha over the actuators, above"
    )
    held_out_ratio: float = _at(
        2.5, Level.DOUBTFUL, "imbalance of held-out modes / that of fitted modes, above"
    )
    misfit_fraction: float = _at(
        0.1,
        Level.DOUBTFUL,
        "fraction of actuators that do not fit a matrix (if more than three), above",
    )
    asymmetry_ratio: float = _at(
        0.95,
        Level.DOUBTFUL,
        "asymmetry of a matrix with alpha / without alpha (if the latter is over 0.5 %), above",
    )
    negative_edges: float = _at(
        1.5,
        Level.DOUBTFUL,
        "most negative elastic stiffness / largest value that noise alone produces, above",
    )
    pattern_share: float = _at(
        0.4,
        Level.DOUBTFUL,
        "share of the column imbalance that one mistake explains, above (with next row)",
    )
    pattern_shift: float = _at(
        0.9, Level.DOUBTFUL, "change of alpha caused by this mistake / error of alpha, above"
    )
    gain_correlation: float = _at(
        0.3, Level.DOUBTFUL, "correlation of sensor gains with alpha, above (with next row)"
    )
    gain_sigmas: float = _at(3.5, Level.DOUBTFUL, "this correlation in sigma, above")
    gradient_sigmas: float = _at(
        7.0,
        Level.DOUBTFUL,
        "gradient of the sensor gains across the mirror in sigma (noise, scatter of gains), above",
    )
    column_noise: float = _at(
        60.0, Level.USABLE, "squared imbalance of a column / median of all columns, above"
    )
    outlier_spreads: float = _at(
        5.0, Level.USABLE, "deviation of alpha from the other actuators in robust sigma, above"
    )
    scale_share: float = _at(2.0, Level.USABLE, "E_SYST / E_STAT, above")


LIMITS = Thresholds()


def rows() -> Iterator[tuple[str, str, str]]:
    """Yield level, quantity and value of each threshold, the worst level first."""
    for each in sorted(fields(LIMITS), key=lambda each: each.metadata["level"]):
        yield (
            str(each.metadata["level"]),
            each.metadata["quantity"],
            f"{getattr(LIMITS, each.name):.3g}",
        )
