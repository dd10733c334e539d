"""The catalogue of findings: for each code what it is about, and how it reads.

Everything that depends on a finding depends on its code. Sentences are made here alone, so that one
can be reworded and nothing else changes.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum, StrEnum


class Code(StrEnum):
    """What was found; the value is written to files, and never changes."""

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
    UNKNOWN_FORCE = "unknown-force"
    CORRELATED_NOISE = "correlated-noise"
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
    ORDER_OF_POSITION = "order-of-position"
    MISPLACED_ACTUATOR = "misplaced-actuator"
    TWO_MIRRORS = "two-mirrors"
    CONSTANT_POSITION = "constant-position"
    UNUSABLE_CALIBRATION = "unusable-calibration"
    # Rows that are not what their labels say.
    SIGN_REVERSED = "sign-reversed"
    SHAPE_OFFSET = "shape-offset"
    OTHER_LABELS = "other-labels"
    FROZEN_READING = "frozen-reading"
    FROZEN_READINGS = "frozen-readings"
    CLIPPED_READINGS = "clipped-readings"
    # A stiffness matrix as a whole.
    ASYMMETRIC_STIFFNESS = "asymmetric-stiffness"
    NEGATIVE_STIFFNESS = "negative-stiffness"
    DISORDERED_STIFFNESS = "disordered-stiffness"
    INCOMPLETE_STIFFNESS = "incomplete-stiffness"
    SYMMETRISED_STIFFNESS = "symmetrised-stiffness"
    TRANSPOSED_STIFFNESS = "transposed-stiffness"
    CLEANED_STIFFNESS = "cleaned-stiffness"
    TRUE_STIFFNESS = "true-stiffness"
    # Found by another version, and kept as it was written.
    OTHER = "other"


class Concern(Enum):
    """What a finding is about, and so what it means for the result.

    Attributes
    ----------
    BENCH
        The bench, beside the model.
    FILES
        Files that are not what they say: the user alone can settle them.
    ROWS
        Labels of rows: if the rest fits, the rows that disagreed were left out.
    SILENT
        An actuator that does not respond.
    """

    BENCH = "bench"
    FILES = "files"
    ROWS = "rows"
    SILENT = "silent"


@dataclass(frozen=True)
class Entry:
    """What is the same for all findings of one code.

    Attributes
    ----------
    name
        How it reads. The detail of a finding takes the place of '{}', or follows a colon.
    concern
        What it is about.
    """

    name: str
    concern: Concern = Concern.BENCH


ENTRIES: dict[Code, Entry] = {
    Code.GAIN_BY_HOUR: Entry("gain by hour"),
    Code.GAIN_BY_HOUR_OF_EACH: Entry("gain by hour of each"),
    Code.GAIN_BY_FILE: Entry("gain by file"),
    Code.GAIN_BY_FILE_OF_SINGLE: Entry("gain of single actuators by file"),
    Code.GAIN_BY_LOAD: Entry("gain by load"),
    Code.WEIGHT_OF_LOAD: Entry("weight of a load"),
    Code.ZERO_BY_HOUR: Entry("zero by hour"),
    Code.ZERO_BY_HOUR_OF_EACH: Entry("zero by hour of each"),
    Code.ZERO_BY_FILE: Entry("zero by file"),
    Code.ZERO_BY_FILE_OF_EACH: Entry("zero by file of each"),
    Code.LOAD_REPOSITIONED: Entry("load put on anew by file"),
    Code.QUADRATIC_COIL: Entry("quadratic coil"),
    Code.QUADRATIC_COIL_OF_EACH: Entry("quadratic coil of each"),
    Code.CUBIC_COIL: Entry("cubic coil"),
    Code.CUBIC_COIL_OF_EACH: Entry("cubic coil of each"),
    Code.COIL_GRADIENT: Entry("coil gradient"),
    Code.BIAS_GRADIENT: Entry("bias gradient"),
    Code.CONTACT_IN_ONE_SIGN: Entry("contact in one sign"),
    Code.CONTACT_IN_ONE_SIGN_BY_LOAD: Entry("contact in one sign by load"),
    Code.POSITIONS: Entry("positions"),
    Code.UNKNOWN_FORCE: Entry("unknown force"),
    Code.CORRELATED_NOISE: Entry("correlated noise"),
    Code.TEMPERATURE_BETWEEN_LOADS: Entry("temperature between the loads"),
    Code.DEAD_NO_FORCE: Entry("dead actuator, no force is commanded", Concern.SILENT),
    Code.DEAD_ALPHA_ZERO: Entry("dead actuator, alpha is 0", Concern.SILENT),
    Code.STUCK_READING: Entry("stuck reading", Concern.SILENT),
    Code.NEGATIVE_ALPHA: Entry("alpha is negative, the poles are exchanged"),
    Code.FROZEN_SENSOR: Entry("frozen sensor"),
    Code.ACTUATOR_OFF: Entry("actuator is off"),
    Code.ACTUATOR_MISFIT: Entry("actuator does not fit"),
    Code.COPIED_FILE: Entry("copy of another file", Concern.FILES),
    Code.OTHER_UNIT: Entry("{} in another unit", Concern.FILES),
    Code.OTHER_SIGN: Entry("{} of the other sign", Concern.FILES),
    Code.OTHER_LOAD: Entry("the file's load is another", Concern.FILES),
    Code.LOAD_OF_TWO_NAMES: Entry("one load under two names"),
    Code.EXCHANGED_COLUMNS: Entry("exchanged columns of {}", Concern.FILES),
    Code.OTHER_ORDER: Entry("another order of {}", Concern.FILES),
    Code.ORDER_OF_POSITION: Entry("order of FORCE is not that of POSITION", Concern.FILES),
    Code.MISPLACED_ACTUATOR: Entry("actuator stands elsewhere than at its X and Y", Concern.FILES),
    Code.TWO_MIRRORS: Entry("files of two mirrors, campaigns or lists of shapes", Concern.FILES),
    Code.CONSTANT_POSITION: Entry("POSITION is the same in all rows", Concern.FILES),
    Code.UNUSABLE_CALIBRATION: Entry("earlier calibration that is not to be used", Concern.FILES),
    Code.SIGN_REVERSED: Entry("SIGN reversed", Concern.ROWS),
    Code.SHAPE_OFFSET: Entry("SHAPE counted from another one", Concern.ROWS),
    Code.OTHER_LABELS: Entry("SHAPE and SIGN label other rows", Concern.ROWS),
    Code.FROZEN_READING: Entry("frozen reading", Concern.ROWS),
    Code.FROZEN_READINGS: Entry("frozen readings", Concern.ROWS),
    Code.CLIPPED_READINGS: Entry("readings cut off at a limit", Concern.ROWS),
    Code.ASYMMETRIC_STIFFNESS: Entry("asymmetric stiffness", Concern.FILES),
    Code.NEGATIVE_STIFFNESS: Entry("stiffness of the other sign"),
    Code.DISORDERED_STIFFNESS: Entry("coordinates in another order than STIFFNESS", Concern.FILES),
    Code.INCOMPLETE_STIFFNESS: Entry("forces missing in STIFFNESS", Concern.FILES),
    Code.SYMMETRISED_STIFFNESS: Entry("STIFFNESS made symmetric", Concern.FILES),
    Code.TRANSPOSED_STIFFNESS: Entry("transposed stiffness", Concern.FILES),
    Code.CLEANED_STIFFNESS: Entry(
        "STIFFNESS already balanced as commanded: alpha is gone (cleaned of rigid motions?)",
        Concern.FILES,
    ),
    Code.TRUE_STIFFNESS: Entry(
        "STIFFNESS symmetric and balanced as commanded: a true one, or alpha is gone (cleaned of"
        " rigid motions?)",
        Concern.FILES,
    ),
    Code.OTHER: Entry("{}"),
}


_PLAIN = {entry.name: code for code, entry in ENTRIES.items() if "{}" not in entry.name}
_EARLIER = {"exchanged columns": (Code.EXCHANGED_COLUMNS, "FORCE")}


def read_name(name: str) -> tuple[Code, str]:
    """Return the code and the detail of a name in a file that was written without codes."""
    if name in _EARLIER:
        return _EARLIER[name]
    for plain, detail in ((name, ""), name.partition(": ")[::2]):
        if plain in _PLAIN:
            return _PLAIN[plain], detail
    for code, entry in ENTRIES.items():
        before, detailed, after = entry.name.partition("{}")
        if detailed and name.startswith(before) and name.endswith(after):
            return code, name[len(before) : len(name) - len(after)]
    return Code.OTHER, name
