"""The catalogue of findings: for each code what it is about, its level, sentence and remedy.

Decisions depend only on the code of a finding, so that a sentence can be changed freely.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

from truenewton.estimation.findings.code import Code, Concern, Level


@dataclass(frozen=True)
class Entry:
    """What is the same for all findings of one code."""

    name: str  # its name. The detail of a finding replaces '{}', or follows a colon
    concern: Concern = Concern.BENCH  # what it is about
    # Level of a result with it, unless it was corrected; None for the level of its cause.
    level: Level | None = Level.DOUBTFUL
    # What is printed, with the values of a finding in braces (`finding.Words`); if empty, the
    # name with where it was found and how large it is.
    sentence: str = ""
    remedy: str = ""  # what to do about it, in the same way
    cured: str = "corrected"  # how it was removed from the data


def _fact(level: Level | None, sentence: str, remedy: str = "") -> Entry:
    """Return the entry of a finding that is not an effect of a bench."""
    return Entry("", Concern.RESULT, level, sentence, remedy)


_rejected, _doubtful, _usable = (
    partial(_fact, level) for level in (Level.REJECTED, Level.DOUBTFUL, Level.USABLE)
)


def _of_input(name: str, remedy: str = "") -> Entry:
    """Return the entry of a file, column or matrix that is not what it claims to be."""
    return Entry(name, Concern.FILES, Level.REJECTED, remedy=remedy)


def _of_rows(name: str, remedy: str) -> Entry:
    """Return the entry of rows that are not what they claim to be."""
    return Entry(name, Concern.ROWS, remedy=remedy)


def _of_silent(name: str, remedy: str) -> Entry:
    """Return the entry of an actuator without force, or whose reading does not change."""
    return Entry(name, Concern.SILENT, Level.USABLE, remedy=remedy)


_MORE_SIGNAL = "repeat more often, use larger forces, or add shapes"
_GIVE_MIRROR = "if you did not use --mirror, add it. Check the positions and order of the sensors"
_CHECK_WEIGHT = (
    "check WEIGHT and its unit (N: kilograms times -9.81), and the unit of FORCE. B has the same"
    " error. If a load is tilted, alpha is wrong as well"
)
_DISABLE = "If it exerts no force, set ENABLED to F"
_IN_ORDER = "put the columns of {detail} in that file in the order of ACTUATORS, or leave it out"
ORDER_OF_BOTH = "put the columns of FORCE and POSITION in the order of the ACTUATORS table"
_GRADIENTS = (
    "do not rely on large-scale gradients of alpha. Cycles under known weights constrain them"
)
_LABELS = "correct SHAPE and SIGN of the file, or leave it out"

_NAMED_AS_THEIR_CODE = (
    Code.GAIN_BY_HOUR, Code.GAIN_BY_HOUR_OF_EACH, Code.GAIN_BY_FILE, Code.GAIN_BY_LOAD,
    Code.ZERO_BY_HOUR, Code.ZERO_BY_HOUR_OF_EACH, Code.ZERO_BY_FILE,
    Code.ZERO_BY_FILE_OF_EACH, Code.QUADRATIC_COIL, Code.QUADRATIC_COIL_OF_EACH,
    Code.CUBIC_COIL, Code.CUBIC_COIL_OF_EACH, Code.COIL_GRADIENT, Code.BIAS_GRADIENT,
    Code.CONTACT_IN_ONE_SIGN, Code.CONTACT_IN_ONE_SIGN_BY_LOAD, Code.POSITIONS,
    Code.SHELL_CURVATURE, Code.CORRELATED_NOISE,
)  # fmt: skip
ENTRIES: dict[Code, Entry] = {
    **{code: Entry(code.replace("-", " ")) for code in _NAMED_AS_THEIR_CODE},
    Code.ZERO_RANDOM_WALK: Entry("random walk of the zero"),
    Code.GAIN_BY_FILE_OF_SINGLE: Entry("gain of single actuators by file"),
    Code.WEIGHT_OF_LOAD: Entry("weight of a load"),
    Code.LOAD_REPOSITIONED: Entry("load repositioned between files"),
    Code.UNKNOWN_FORCE: Entry(
        "unknown force",
        remedy="check that FORCE is its own in each row, and look for friction, dust or a cable",
    ),
    Code.UNKNOWN_EFFECT: Entry(
        "unknown effect, most similar to {}",
        remedy="look at the residuals in `truenewton report` for rows, files or actuators that do"
        " not fit. Possible causes, besides {detail}: FORCE of another row or actuator, readings"
        " that end at a limit, shapes or mirrors that differ between files, noise that grows with"
        " the force, a wrong FORCERR or label",
    ),
    Code.NOISE_BY_FORCE: Entry(
        "noise in proportion to the force", level=Level.USABLE, remedy="average more readings"
    ),
    Code.TEMPERATURE_BETWEEN_LOADS: Entry("temperature between the loads", level=Level.USABLE),
    Code.DEAD_NO_FORCE: _of_silent(
        "dead actuator, no force is commanded", f"check its coil, driver and cable. {_DISABLE}"
    ),
    Code.DEAD_ALPHA_ZERO: _of_silent("dead actuator, alpha is 0", "check its coil and magnet"),
    Code.STUCK_READING: _of_silent("stuck reading", f"check its electronics. {_DISABLE}"),
    Code.NEGATIVE_ALPHA: Entry(
        "alpha is negative, the poles are exchanged",
        level=Level.USABLE,
        remedy="exchange the poles of its cable, or reverse the sign of its column of FORCE",
    ),
    Code.FROZEN_SENSOR: Entry(
        "frozen sensor",
        level=Level.USABLE,
        remedy="check its electronics. If you need POSITION, leave these files out",
    ),
    Code.ACTUATOR_OFF: Entry("actuator is off", cured="left out"),
    Code.ACTUATOR_MISFIT: Entry(
        "actuator does not fit",
        sentence="excluded {actuators:names actuator}: {detail}",
        cured="left out",
    ),
    Code.COPIED_FILE: _of_input(
        "copy of another file", "restore the original of the copy, or remove it"
    ),
    Code.OTHER_UNIT: _of_input("{} in another unit", "correct the unit of {detail} in that file"),
    Code.OTHER_SIGN: _of_input(
        "{} of the other sign",
        "reverse the sign of {detail} in that file, or leave the file out. Check the plug, and"
        " the order of SHAPE and SIGN",
    ),
    Code.OTHER_LOAD: _of_input("wrong LOAD of a file", "correct LOAD of the file, or remove it"),
    Code.LOAD_OF_TWO_NAMES: Entry("one load under two names", level=Level.USABLE),
    Code.EXCHANGED_COLUMNS: _of_input("exchanged columns of {}", _IN_ORDER),
    Code.OTHER_ORDER: _of_input("another order of {}", _IN_ORDER),
    Code.OTHER_ROW: _of_input(
        "FORCE lags by a row",
        "move these columns of FORCE by one row, and mark the last row of each file as not VALID."
        " Check when the electronics record FORCE",
    ),
    Code.SAME_READINGS: _of_input("two columns of FORCE are the same", "check their channels"),
    Code.ORDER_OF_POSITION: _of_input("order of FORCE is not that of POSITION", ORDER_OF_BOTH),
    Code.CONSTANT_POSITION: _of_input(
        "POSITION is the same in all rows",
        "if no sensors were read, remove the column. COILGRAD and BIASGRAD are then not used",
    ),
    Code.UNUSABLE_CALIBRATION: _of_input("earlier calibration that was rejected"),
    Code.SIGN_REVERSED: _of_rows("SIGN reversed", _LABELS),
    Code.SHAPE_OFFSET: _of_rows("SHAPE numbered from another start", _LABELS),
    Code.OTHER_LABELS: _of_rows("SHAPE and SIGN label other rows", _LABELS),
    Code.ASYMMETRIC_STIFFNESS: _of_input("asymmetric stiffness"),
    Code.NEGATIVE_STIFFNESS: Entry("stiffness of the other sign", level=Level.USABLE),
    Code.DISORDERED_STIFFNESS: _of_input("coordinates in another order than STIFFNESS"),
    Code.INCOMPLETE_STIFFNESS: _of_input("forces missing in STIFFNESS"),
    Code.FORCES_AT_REST: _of_input(
        "all columns of STIFFNESS contain the same forces, as if those at rest had not been"
        " subtracted"
    ),
    Code.SYMMETRISED_STIFFNESS: _of_input(
        "STIFFNESS is symmetric, as if averaged with its transpose"
    ),
    Code.TRANSPOSED_STIFFNESS: _of_input("transposed stiffness"),
    Code.CLEANED_STIFFNESS: _of_input(
        "STIFFNESS already balances with alpha = 1, so it contains no information on alpha"
        " (rigid-body modes removed?)"
    ),
    Code.TRUE_STIFFNESS: _of_input(
        "STIFFNESS is symmetric and balances with alpha = 1: a true stiffness, or rigid-body modes"
        " were removed"
    ),
    Code.WEAK_PATTERNS: _usable(
        "the data determine {count:count pattern} of alpha poorly; the weakest is {weakest}",
        "repeat more often, use larger forces, or add a stiffness matrix",
    ),
    Code.CONSTRAINED_PATTERNS: _usable(
        "the data do not determine {count:count pattern} of alpha; along each, alpha is assumed to"
        " be uniform, with an rms uncertainty of {error:percent}",
        "use E_ALPHA. For differences along other patterns, use COVARIANCE",
    ),
    Code.WORSE_THAN_UNIFORM: _doubtful(
        "alpha scatters by {spread:percent} over the actuators, and most of that is error:"
        " {error:percent} typically. Loading it is no better than one value for all actuators",
        "{instead}To measure alpha better, repeat more often, use larger forces, or add shapes",
    ),
    Code.NO_LOAD_SEEN: _rejected(
        "the forces are the same under all loads, so they do not contain the added weight",
        "check that each load was on the mirror in the files with its name, and check ADDED,"
        " BIASGRAD and COILGRAD",
    ),
    Code.ONE_LOAD: _fact(
        Level.NONE,
        "there is only one load, '{load}', so the common scale is not determined",
        "add cycles under a load of another known weight",
    ),
    Code.EQUAL_LOADS: _fact(
        Level.NONE,
        "the {count} loads have the same weight, so the common scale is not determined",
        "check ADDED and TILT, or add a load that differs",
    ),
    Code.SIMILAR_LOADS: _usable(
        "only the difference between the loads, {difference:.2g} N of {largest:.3g} N, fixes the"
        " common scale",
        "use a load that differs by a tenth of the mirror's weight. More shapes do not help",
    ),
    Code.NO_OTHER_LOAD: _rejected(
        "all loads have the same weight, so the common scale is not determined",
        "add cycles under a load of another known weight",
    ),
    Code.ERROR_TOO_LARGE: _rejected(
        "the typical error of alpha from readings is {error:percent}: alpha cannot be distinguished"
        " from 0",
        "add shapes and cycles, use larger forces, or loads that differ more in weight",
    ),
    Code.DATES_APART: _usable(
        "DATE-OBS of {files:list} is {days:.0f} days from that of the other files",
        "correct DATE-OBS, which is used to find drifts, or calibrate only files taken together",
    ),
    Code.TEMPERATURE_IMPLAUSIBLE: _usable(
        "the mean TEMPERATURE is {temperature:.3g} deg C",
        "check the unit of TEMPERATURE: 20 deg C is 68 deg F",
    ),
    Code.SIZE_IMPLAUSIBLE: _usable("{fault}", "{advice}"),
    Code.WEIGHT_ABOVE_FORCES: _doubtful(
        "WEIGHT is {weight:.3g} N, {each:.2g} N for each actuator, but no actuator exerted more"
        " than {largest:.2g} N: B is estimated as {bias:.3g} N",
        _CHECK_WEIGHT,
    ),
    Code.WEIGHT_BELOW_BIAS: _doubtful(
        "WEIGHT is {weight:.3g} N, several times less than the force of the bias magnets: B is"
        " estimated as {bias:.3g} N",
        _CHECK_WEIGHT,
    ),
    Code.WEIGHTS_DISAGREE: _doubtful(
        "the weights of the {loads} loads disagree by {sigmas:.1f} sigma",
        "check ADDED, TILT and their errors",
    ),
    Code.WEIGHTS_WITHOUT_ERRORS: _usable(
        "the weights are given without plausible errors{which}, so E_SYST is too small. An error of"
        " 1 % in the added weight changes every alpha by 1 %",
        "write the standard uncertainties of the weighing into the files (E_WEIGHT and E_ADDED in"
        " N, E_TILT in degrees)",
    ),
    Code.SCALE_BY_WEIGHTS: _usable(
        "the uncertainty of the common scale is {error:percent}{share}",
        "weigh the loads more accurately. More cycles do not help",
    ),
    Code.ALPHA_FAR_FROM_ONE: _rejected(
        "alpha is about {alpha}. If all values are in N, alpha is near 1. Possible causes: {looks}"
    ),
    Code.NOISE_ABOVE_DECLARED: _usable(
        "repeated shapes scatter by {noise:.2g} mN, {ratio:.3g} times FORCERR",
        "find what moves the mirror or the readings between repeats, and correct FORCERR",
    ),
    Code.NOISE_BELOW_DECLARED: _usable(
        "repeated shapes scatter by {noise:.2g} mN, {ratio:.3g} times FORCERR", "correct FORCERR"
    ),
    Code.FORCE_STEPS: _usable(
        "FORCE has steps of {step:.3g} mN. They cause most of its noise: E_STAT includes"
        " {noise:.2g} mN, step / sqrt(12)",
        "if you need smaller errors, record FORCE in finer steps or as means of several readings",
    ),
    Code.ZEROS_RESET: _usable(
        "the zeros of {sensors:count sensor} were reset between files. Readings are therefore taken"
        " relative to the mean of each file, and E_STAT does not include motion between files",
        "do not reset the sensors during a campaign",
    ),
    Code.MISFIT: _doubtful(
        "the model does not fit the data: E_STAT was multiplied by {factor:.2g}",
        "find what differs between files: a drift, a label, contact with the glass"
        " (docs/effects.md)",
    ),
    Code.MISFIT_EXPLAINED: _doubtful(
        "the model fits the data only with the effects that were found: E_STAT includes the"
        " resulting change of alpha",
        "find out which of these effects is real (docs/effects.md)",
    ),
    Code.GLASS_NOT_MODELLED: _usable(
        "sensors that average over an area were modelled as points: alpha may be wrong by about"
        " {model:percent}, and E_STAT, typically {error:percent}, does not include this",
        "give --mirror, so that the glass is modelled, or use --method ml",
    ),
    Code.EFFECT_WITHOUT_POSITION: _doubtful(
        "no cycle contains POSITION, so a coil gradient can look like the effects that were found:"
        " alpha and its errors may be wrong",
        "record the sensor readings as POSITION before you look for another cause",
    ),
    Code.MISFIT_OF_SVD: _doubtful(
        "the imbalance of the shapes is {factor:.2g} times its expected noise",
        "use method ml, which looks for effects of the bench",
    ),
    Code.MISFIT_SENSELESS: _rejected(
        "the remaining imbalance is {factor:.2g} times the noise",
        "look for copies among the files, and for a wrong LOAD, SHAPE, SIGN or order of FORCE",
    ),
    Code.FIT_TOO_GOOD: _doubtful(
        "the shapes balance better than the scatter of their repeats predicts",
        "find what differs between files: a label, a drift, zeros that move",
    ),
    Code.ROWS_REJECTED: _usable(
        "{count:count row} did not fit and {was} left out{farthest}",
        "check the residuals, and any actuator that is named repeatedly",
    ),
    Code.MANY_ROWS_REJECTED: _doubtful(
        "{share:percent} of the rows do not fit", "find out what happened during the run"
    ),
    Code.SVD_USES_ALL_ROWS: _doubtful(
        "method svd uses all rows, including {count:count row} that ml leaves out",
        "use ml, or mark these rows as not VALID",
    ),
    Code.SVD_BIAS: _usable(
        "method svd is biased by {bias:percent} (rms over actuators, to first order), which its"
        " errors do not include",
        "use ml",
    ),
    Code.SVD_BIAS_LARGE: _doubtful(
        "method svd is biased by {bias:percent} (rms over actuators, to first order), more than its"
        " stated errors",
        "use ml",
    ),
    Code.MANY_SILENT: _rejected(
        "{count} of {n} actuators are dead or have stuck readings",
        "check their drivers and readout. If actuators exert no force, set their ENABLED to F",
    ),
    Code.MANY_NEGATIVE: _rejected(
        "alpha is negative for {count} of {n} actuators",
        "check the signs and the order of FORCE: z points up",
    ),
    Code.ALL_NEGATIVE: _rejected(
        "alpha is negative for all {n} actuators",
        "check whether LOAD and ADDED of the loads are exchanged; if not, reverse the sign of"
        " FORCE, which is positive upwards",
    ),
    Code.ALPHA_ZERO: _usable(
        "{actuators:names actuator}: dead, alpha is {alpha}",
        f"check its coil and magnet. {_DISABLE}",
    ),
    Code.ALPHA_OUTLIER: _usable(
        "{actuators:names actuator}: outlier, alpha is {alpha}",
        "check its coil, magnet and wiring",
    ),
    Code.STIFFNESS_UNIT: _usable(
        "STIFFNESS seems to be in {unit}: its median diagonal element is {own:.2g}, and mirrors"
        " have about {usual:.0e} N/m",
        "store STIFFNESS in N/m. The unit changes the stiffness of modes, but not relative alpha",
    ),
    Code.LOOKS_TRANSPOSED: _doubtful(
        "STIFFNESS looks transposed: the rigid-body residual is larger than the column imbalance",
        "store the force of actuator i per displacement of sensor j as element [i, j]",
    ),
    Code.COLUMN_NOISE_NOT_INDEPENDENT: _usable(
        "the imbalance of the columns of STIFFNESS is not independent noise of their elements."
        " Alpha was therefore estimated from the elastic modes, each with its own scatter",
        _GRADIENTS,
    ),
    Code.HALVES_INSUFFICIENT: _doubtful(
        "cross-validation is not possible because half of the modes do not constrain alpha: {fault}"
    ),
    Code.HELD_OUT_IMBALANCE: _doubtful(
        "held-out modes are unbalanced by up to {held_out:percent} of their force, fitted modes by"
        " {fitted:percent}",
        _GRADIENTS,
    ),
    Code.HARMFUL_ALPHA: _rejected(
        "held-out modes balance worse with alpha ({after:percent} of their force) than with alpha ="
        " 1 ({before:percent})",
        "measure the stiffness with less noise, or calibrate with cycles under weights",
    ),
    Code.MISFITS_KEPT: _doubtful(
        "{count} of {n} actuators do not fit the others ({actuators:names actuator}), too many to"
        " leave out: the matrix is far from symmetric, or its columns from balance",
        "check X, Y, NZ, the order of rows and columns in STIFFNESS, and gains and positions of the"
        " sensors. Compare the balance of held-out modes",
    ),
    Code.MANY_MISFITS: _doubtful(
        "{count} of {n} actuators do not fit the others: {actuators:names actuator}",
        "check coil, driver, cable, sensor and position of each, and measure again",
    ),
    Code.OFF_BUT_PUSHING: _doubtful(
        "{actuators:names actuator}: row or column of STIFFNESS is zero, but the neighbouring"
        " columns do not balance, as if the actuator had exerted a force",
        "measure the stiffness with it switched off",
    ),
    Code.NEGATIVE_MODES: _doubtful(
        "the matrix has {count:count elastic mode} of negative stiffness, down to {lowest:.3g} N/m",
        "check order, sign and completeness of the matrix, and measure again with less noise",
    ),
    Code.NEGATIVE_MODES_IN_NOISE: _usable(
        "the noise of the matrix exceeds the stiffness of its softest modes: {count:count elastic"
        " mode} of negative stiffness, down to {lowest:.3g} N/m",
        "measure again with less noise before you use soft modes",
    ),
    Code.SYMMETRY_NOT_IMPROVED: _doubtful(
        "alpha does not make the matrix more symmetric: asymmetry {before:percent} before,"
        " {after:percent} after",
        "check positions and order of the sensors. Compare with a second measurement",
    ),
    Code.COHERENT_IMBALANCE: _doubtful(
        "{share:percent} of the imbalance of the columns is not noise: it has the pattern of an"
        " error in {pattern}. If this error is fitted as well, alpha changes by {shift:percent}"
        " rms, {ratio:.2g} times its error from noise. E_ALPHA includes this change"
    ),
    Code.COLUMNS_UNBALANCED: _usable(
        "the columns of {actuators:names actuator} of the matrix balance far worse than the others:"
        " an element in each may be wrong",
        "measure these columns again, or exclude the actuators (--exclude)",
    ),
    Code.GAINS_HAVE_GRADIENT: _doubtful(
        "the sensor gains that symmetry implies have a gradient across the mirror ({sigmas:.2g}"
        " sigma), as if the positions were stretched to one side",
        "check X and Y of the actuators. A campaign with known weights constrains the gradient",
    ),
    Code.GAINS_FOLLOW_ALPHA: _doubtful(
        "the sensor gains that follow from the symmetry of the matrix are correlated with alpha"
        " ({correlation:+.2f}), as if {correlation:sign rigid motions had been partly removed from"
        " the matrix/the matrix had been averaged with its transpose}",
        "find out how the matrix was processed, and use it as it was measured",
    ),
    Code.SEGMENTS_COUPLED: _doubtful(
        "the segment is coupled to others by {size:.2g} N/m rms; its own elements are {own:.2g} N/m"
        " rms",
        "correct SEGMENT, or the order of STIFFNESS. Segments that are joined do not balance"
        " separately",
    ),
    Code.RECIPROCITY_NOT_USED: _fact(
        Level.SOUND,
        "alpha is from the balance alone (ml), not from reciprocity: {cause}",
        "{advice}",
    ),
    Code.RECIPROCITY_DOUBTFUL: _doubtful("reciprocity is doubtful: {cause}", "use ml; {advice}"),
    Code.RECIPROCITY_EXCLUDED: _usable(
        "{actuators:names actuator}: reciprocity is violated, so alpha is that of ml",
        "check their sensors, wiring and positions",
    ),
    Code.RECIPROCITY_INFLATED: _doubtful(
        "the fit of reciprocity is poor: E_STAT was multiplied by {factor:.2g}"
    ),
    Code.BALANCE_CONTRADICTS_SYMMETRY: _doubtful(
        "balance and reciprocity contradict each other: the errors of reciprocity are"
        " {error:percent} typically, those of ml {of_balance:percent}",
        "find out how the matrix was processed, and give it as it was measured",
    ),
    Code.EFFECT_PRESENT: _doubtful("the data show {effect}", "correct this effect first"),
    Code.ESTIMATE_FAILED: _doubtful("{fault}"),
    Code.INTERRUPTED: _usable("the fit was interrupted", "let it finish, or choose --method ml"),
    Code.MISFIT_ACTUATORS: _doubtful(
        "{count:count actuator} or more violate reciprocity", _GIVE_MIRROR
    ),
    Code.TRANSPOSED: _doubtful(
        "STIFFNESS looks transposed, and reciprocity would confuse alpha with sensor gains",
        "store the force of actuator i per displacement of sensor j as element [i, j]",
    ),
    Code.SHARED_NOISE: _doubtful(
        "the readings of many actuators have common noise, but reciprocity assumes independent"
        " noise",
        "find what moves the mirror",
    ),
    Code.UNTESTED_SIZE: _doubtful(
        "the errors of reciprocity were not validated for {count:count actuator}: force noise may"
        " make them too small",
        "compare two campaigns",
    ),
    Code.EQUATIONS_MISFIT: _doubtful(
        "the residual of the reciprocity fit is {factor:.2g} times the noise of {block}",
        _GIVE_MIRROR,
    ),
    Code.HELD_OUT_WORSE: _doubtful(
        "held-out modes are unbalanced by {held_out:percent} of their force with reciprocity, and"
        " by {by_balance:percent} with the balance alone",
        _GIVE_MIRROR,
    ),
    Code.ESTIMATES_APART: _doubtful(
        "alpha by balance and alpha by reciprocity differ by {factor:.2g} times their errors",
        _GIVE_MIRROR,
    ),
    Code.ERRORS_LARGER: _doubtful(
        "the typical error of reciprocity would be {error:percent}, and that of ml is"
        " {of_balance:percent}",
        _GIVE_MIRROR,
    ),
    Code.SENSORS_FAR: _doubtful(
        "the sensors would have to be {offset:.2g} mm from their magnets", _GIVE_MIRROR
    ),
    Code.PLANNED_WEAK_PATTERNS: _usable(
        "{count:count pattern} of alpha will be barely above the noise", _MORE_SIGNAL
    ),
    Code.PLANNED_REFUSAL: _fact(
        Level.NONE,
        "{count:count pattern} of alpha will be barely above the noise, so `calibrate` will refuse"
        " the campaign",
        _MORE_SIGNAL,
    ),
    Code.PLANNED_FORCE_TOO_LARGE: _rejected(
        "an actuator whose alpha is {alpha:g} would exert {force:.3g} N, more than its limit of"
        " {limit:g} N",
        "plan a smaller shapes.force",
    ),
    Code.EARLIER_FINDING: _fact(None, "the earlier calibration: {cause}", "{advice}"),
    Code.RECALIBRATION_LIMIT: _usable("{limit}"),
    Code.LAW_OF_REJECTED_DAY: _rejected(
        "the law uses {day}, whose calibration is rejected", "track the other days"
    ),
    Code.PAIR_UNITS: _fact(
        Level.DOUBTFUL,
        "the changes of alpha scatter by {scatter:percent} over all actuators: the old and the new"
        " data are probably from two mirrors",
        "check that both were measured on the same mirror, not on two of one type",
    ),
    Code.PAIR_PATTERN: _fact(
        Level.DOUBTFUL,
        "the change is more than factors of actuators and sensors: the largest other pattern is"
        " {pattern:.2f} times its expected noise",
        "check whether rigid-body modes or stiff modes were removed from one matrix, and whether"
        " the mirror, its gap or its temperature differed",
    ),
    Code.PAIR_ROWS: _fact(
        Level.DOUBTFUL,
        "between a matrix and a campaign, the residual contains a pattern {pattern:.2f} times as"
        " large as its expected noise, by which the errors were multiplied",
        "compare two matrices, or two campaigns",
    ),
    Code.PAIR_NOISE: _fact(
        Level.DOUBTFUL,
        "the noise has heavier tails than any of the noise laws: excess kurtosis {tails:.1f}",
        "compare two matrices, or two campaigns, that were measured in the same way",
    ),
    Code.PAIR_GLASS: _fact(
        Level.DOUBTFUL,
        "changes of alpha and of sensor gains resemble each other ({sigmas:.1f} sigma), as if the"
        " stiffness of the glass had changed",
        "check that both matrices are of one mirror with the same gap and temperature",
    ),
    Code.PAIR_EXCESS: _fact(
        Level.DOUBTFUL,
        "the change that remains after factors of actuators and sensors is {excess:.1f} times the"
        " scatter of the repeat",
        "check whether the glass changed, and whether temperature and noise were those of the"
        " repeat",
    ),
    Code.PAIR_NOT_CONVERGED: _fact(
        Level.DOUBTFUL,
        "the comparison did not converge",
        "check that both matrices are complete and of one mirror",
    ),
    Code.NO_ALPHA: _fact(Level.NONE, "{fault}"),
    Code.OTHER: Entry("{}"),
}
