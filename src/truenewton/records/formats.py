"""What stands in cycle and stiffness files (docs/files.md), and columns that other files share."""

from __future__ import annotations

from truenewton.files.format import Column, FileFormat, ImageFormat, Keyword, TableFormat
from truenewton.files.hdf5 import STREAM

INSTRUMENT = Keyword("INSTRUME", "instrument", "mirror", kind="str")
ID = Column("ID", "layout.id", kind="int")
X, Y = (Column(name, f"layout.{name.lower()}", "m") for name in "XY")
NZ = Column("NZ", "layout.nz", absent=1.0)
ENABLED = Column("ENABLED", "layout.enabled", kind="bool", absent=True)
E_X, E_Y = (Column(f"E_{name}", f"layout.{name.lower()}_error", "m", absent=None) for name in "XY")
SEGMENT = Column("SEGMENT", "layout.segment", kind="int", absent=None)
ACTUATORS = TableFormat("ACTUATORS", (ID, X, Y, NZ, ENABLED, E_X, E_Y, SEGMENT))

MEASUREMENTS = TableFormat(
    "MEASUREMENTS",
    (
        Column("TIME", "time", "s"),
        Column("SHAPE", "shape", kind="int"),
        Column("SIGN", "sign", kind="int"),
        Column("TEMPERATURE", "temperature", "deg_C", absent=None),
        Column("FORCE", "force", "N", each="ACTUATORS"),
        Column("POSITION", "position", "m", absent=None, each="ACTUATORS"),
        Column("VALID", "valid", kind="bool", absent=True),
    ),
)
CYCLE = FileFormat(
    (
        INSTRUMENT,
        Keyword("DATE-OBS", "date", "UTC, start of the cycle", kind="date"),
        Keyword("LOAD", "load.name", "name of the load", kind="str"),
        Keyword("CYCLE", "number", "number of the cycle under this load", kind="int"),
        Keyword("WEIGHT", "weight", "weight of the mirror along z at TILT 0, P", "N"),
        Keyword("E_WEIGHT", "weight_error", "standard uncertainty of WEIGHT", "N"),
        Keyword("ADDED", "load.added", "added weight, Q", "N"),
        Keyword("E_ADDED", "load.added_error", "standard uncertainty of ADDED", "N"),
        Keyword("TOOL", "load.tool", "name of the added weight", kind="str", absent=None),
        Keyword("TILT", "load.tilt", "angle between axis and vertical", "deg", absent=0.0),
        Keyword("E_TILT", "load.tilt_error", "standard uncertainty of TILT", "deg", absent=0.0),
        Keyword(
            "COILGRAD", "coil_gradient", "relative change of force along +z", "1/m", absent=None
        ),
        Keyword("BIASGRAD", "bias_gradient", "change of a bias force along +z", "N/m", absent=None),
        Keyword("GAP", "gap", "nominal distance from the reference plate", "m", absent=None),
        Keyword(
            "FORCERR", "force_error", "standard deviation of one force reading", "N", absent=None
        ),
    ),
    (
        ACTUATORS,
        MEASUREMENTS,
    ),
)
SEGMENTS = TableFormat(
    "SEGMENTS",
    (
        Column("SEGMENT", "number", kind="int"),
        Column("WEIGHT", "weight", "N"),
        Column("E_WEIGHT", "weight_error", "N"),
        Column("ADDED", "added", "N"),
        Column("E_ADDED", "added_error", "N"),
    ),
    of="segments",
)
OF_SEGMENTS = tuple(column.name for column in SEGMENTS.columns[1:])
# Of a mirror in several segments: weights stand there, and not in the header.
SEGMENTED_CYCLE = FileFormat(
    tuple(keyword for keyword in CYCLE.keywords if keyword.name not in OF_SEGMENTS),
    (*CYCLE.extensions, SEGMENTS),
)
SAMPLES = TableFormat(STREAM, MEASUREMENTS.columns)
RAW = FileFormat(CYCLE.keywords, (ACTUATORS, SAMPLES))
SEGMENTED_RAW = FileFormat(SEGMENTED_CYCLE.keywords, (ACTUATORS, SAMPLES, SEGMENTS))
STIFFNESS = FileFormat(
    (
        INSTRUMENT,
        Keyword("DATE-OBS", "date", "UTC", kind="date"),
        Keyword("DISPLACE", "displaced", "displacements: read or true", kind="str", absent="read"),
    ),
    (ACTUATORS, ImageFormat("STIFFNESS", "stiffness", "N/m")),
)
SOURCES = TableFormat(
    "SOURCES",
    (
        Column("FILE", "file", kind="str"),
        Column("SHA256", "sha256", kind="str", width=64),
        Column("ROWS", "rows", kind="int"),
        Column("REJECTED", "rejected", kind="int"),
    ),
    of="sources",
)
