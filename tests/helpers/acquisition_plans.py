"""Small plans and what their campaigns hold, for tests of acquisition."""

import truenewton as tn
from truenewton.acquisition.plan import CampaignPlan, PlannedShapes
from truenewton.files.fits import read_fits, write_fits
from truenewton.files.format import FileFormat, ImageFormat
from truenewton.records.file import fits_paths

LOADS = (tn.Load("bare"), tn.Load("ring", -0.05, 0.001, tool="ring"))


def small_plan(*, cycles=2, count=3, loads=LOADS, shapes=None, **changes):
    """Return a plan for the stub bench: 2 loads x 2 cycles x 3 shapes, both signs."""
    shapes = shapes or PlannedShapes(count=count)
    return CampaignPlan("ring8", loads, cycles=cycles, shapes=shapes, **changes)


def write_shapes(path, shapes):
    """Write a file of shapes [m], for a plan to name."""
    form = FileFormat(extensions=(ImageFormat("SHAPES", "", "m"),))
    write_fits(path, form, shapes, overwrite=True)


def contents(folder):
    """Return all that the cycle files of a folder hold but for times, checksums and paths."""
    held = {}
    for path in fits_paths([folder]):
        file = read_fits(path)
        header = {
            key: value
            for key, value in file.header.items()
            if key not in ("DATE-OBS", "CHECKSUM", "DATASUM")
        }
        tables = {
            f"{name}.{column}": (values.tobytes(), unit)
            for name, table in file.extensions.items()
            for column, (values, unit) in table.columns.items()
            if column != "TIME"
        }
        held[path.name] = (header, tables)
    return held
