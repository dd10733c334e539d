"""Units are never lost: what has one is converted, or refused; what is masked does not count."""

import datetime
import inspect
from dataclasses import fields, replace

import astropy.units as u
import numpy as np
import pandas as pd
import pytest
from astropy.table import QTable, Table

import truenewton as tn
from truenewton.acquisition.plan import MirrorLimits, PlannedShapes
from truenewton.arrays import freeze
from truenewton.bench.choice import BenchChoice
from truenewton.errors import FormatError, GeometryError
from truenewton.files.format import FileFormat, ImageFormat, TableFormat
from truenewton.mirrors.glass import Annulus, Shell
from truenewton.mirrors.known import MirrorNumbers, ring
from truenewton.quantities import in_unit
from truenewton.records.file import CYCLE, STIFFNESS
from truenewton.statics.layout import rings, spherical_rings

DATE = datetime.datetime(2026, 1, 2, tzinfo=datetime.UTC)
N, ROWS = 4, 6
LAYOUT = tn.layout(
    [0.1, 0.2, 0.3, 0.4], [0.0, 0.1, 0.0, 0.1], nz=np.full(N, 0.9), x_error=np.full(N, 1e-4),
    y_error=np.full(N, 2e-4), id=[5, 6, 7, 8], segment=np.ones(N, dtype=int),
    number=[2, 1, 4, 3],
)  # fmt: skip
LOAD = tn.Load("ring", -0.3, 0.01, "A", 1.5, 0.2, 1e-6, 5e-7)
RANDOM = np.random.default_rng(1)
ONE = tn.Cycle(
    "T", DATE, 3, LOAD, -3.0, 0.02, LAYOUT, np.arange(float(ROWS)), np.arange(1, ROWS + 1),
    np.ones(ROWS), RANDOM.standard_normal((ROWS, N)), np.ones(ROWS, bool), np.full(ROWS, 21.5),
    1e-6 * RANDOM.standard_normal((ROWS, N)), 600.0, 31.0, 7e-5, 1e-3,
)  # fmt: skip
MATRIX = tn.StiffnessMatrix("T", DATE, LAYOUT, RANDOM.standard_normal((N, N)))
OTHER = {"N": "mN", "m": "mm", "s": "min", "deg": "arcmin", "deg_C": "K", "1/m": "1/um",
         "N/m": "mN/um", "": "percent"}  # fmt: skip


def declared(form: FileFormat):
    """Return attribute and unit of all numbers of a format."""
    for keyword in form.keywords:
        if keyword.kind in ("float", "int", "count"):
            yield keyword.attribute, keyword.unit
    for extension in form.extensions:
        if isinstance(extension, ImageFormat):
            yield extension.attribute, extension.unit
        elif isinstance(extension, TableFormat):
            for column in extension.columns:
                if column.kind in ("float", "int"):
                    yield column.attribute, column.unit or ""


def with_part(record, attribute, change):
    """Return a record with an attribute changed, at any depth."""
    name, _, rest = attribute.partition(".")
    value = getattr(record, name)
    return replace(record, **{name: with_part(value, rest, change) if rest else change(value)})


def part(record, attribute):
    for name in attribute.split("."):
        record = getattr(record, name)
    return record


FORMATS = [(ONE, *each) for each in declared(CYCLE)]
# How an imported file stores a matrix is recorded by import alone.
FORMATS += [(MATRIX, *e) for e in declared(STIFFNESS) if not e[0].startswith("stored.")]


@pytest.mark.parametrize(
    ("record", "attribute", "unit"), FORMATS, ids=[f"{type(f[0]).__name__}.{f[1]}" for f in FORMATS]
)
def test_every_number_that_a_file_declares_is_converted(record, attribute, unit):
    def in_other(value):
        return u.Quantity(value, unit).to(OTHER[unit], equivalencies=u.temperature())

    made = with_part(record, attribute, in_other)
    value = part(made, attribute)
    assert not hasattr(value, "unit")
    np.testing.assert_allclose(value, part(record, attribute), rtol=1e-12)
    with pytest.raises(FormatError, match="is in cd; give "):
        with_part(record, attribute, lambda value: u.Quantity(value) * u.cd)


SHELL = Shell(0.02, 0.12, 1.6e-3, radius_of_curvature=1.9)
PLANNED = {
    PlannedShapes(): {"stroke": "m", "force": "N"},
    MirrorLimits(): {
        "force": "N", "saturation": "N", "displacement": "m", "gap": "m", "temperature": "deg_C",
    },
    tn.CampaignPlan("p45", (tn.Load("bare"), LOAD)): {
        "settling": "s", "pause": "s", "force_noise": "N",
    },
    BenchChoice(): {"force_noise": "N"},
    tn.Atmosphere(0.8): {"seeing": "arcsec", "outer_scale": "m"},
    tn.Budget(0.1, 2.0, 0.5): {"power": "W", "total": "W", "force": "N"},
    Annulus(): {"inner_radius": "m", "outer_radius": "m"},
    SHELL: {
        "inner_radius": "m", "outer_radius": "m", "thickness": "m", "young_modulus": "Pa",
        "poisson_ratio": "", "density": "kg/m3", "radius_of_curvature": "m",
    },
    MirrorNumbers(
        name="T", shell=SHELL, weight=-3.0, weight_error=0.01, added_weight=-0.3,
        added_weight_error=0.01, tool_radius=0.1,
    ): {
        "weight": "N", "weight_error": "N", "added_weight": "N", "added_weight_error": "N",
        "bias_force": "N", "magnet_mass": "kg", "alpha_range": "", "gap": "m", "puck_radius": "m",
        "damping": "N s / m", "tool_radius": "m", "coil_gradient": "1/m", "bias_gradient": "N/m",
    },
}  # fmt: skip


@pytest.mark.parametrize("record", PLANNED, ids=lambda record: type(record).__name__)
def test_every_number_of_plans_and_mirrors_is_converted(record):
    units = PLANNED[record]
    numbers = {f.name for f in fields(record) if "float" in str(f.type)}
    assert numbers == set(units)  # a new field has to say its unit
    for name, unit in units.items():
        value = getattr(record, name)
        other = u.Quantity(value, unit).to(OTHER.get(unit, unit), equivalencies=u.temperature())
        made = getattr(replace(record, **{name: other}), name)
        assert type(made) is type(value)
        np.testing.assert_allclose(made, value, rtol=1e-12)
        with pytest.raises(FormatError, match="is in mol"):
            replace(record, **{name: u.Quantity(value) * u.mol})


def test_millinewtons_give_the_same_alpha():
    """The paper's mirror, forces a thousand times smaller in a unit a thousand times larger."""
    force = ONE.force * 1e3 * u.mN
    np.testing.assert_allclose(replace(ONE, force=force).force, ONE.force, rtol=1e-15)
    columns = QTable({"force": force.to(u.kN), "weight": np.full(ROWS, 21.5) * u.deg_C})
    made = replace(ONE, force=columns["force"], temperature=columns["weight"])
    np.testing.assert_allclose(made.force, ONE.force, rtol=1e-14)
    old = Table({"t": np.arange(ROWS) / 60.0})
    old["t"].unit = "min"
    np.testing.assert_allclose(replace(ONE, time=old["t"]).time, ONE.time, rtol=1e-15)
    np.testing.assert_allclose(replace(ONE, time=list(ONE.time * u.s)).time, ONE.time)


def test_masked_numbers_are_rows_that_are_not_valid():
    off = replace(LAYOUT, enabled=[True, True, True, False])
    one = replace(ONE, layout=off)
    mask = np.zeros((ROWS, N), dtype=bool)
    mask[1, 2] = mask[4, 3] = True  # the last actuator does not count
    masked = np.ma.masked_array(np.where(mask, np.nan, ONE.force), mask)
    assert replace(one, force=masked).valid.tolist() == [True, False, True, True, True, True]
    of_time = np.ma.masked_greater(ONE.time, 3.5)
    both = replace(one, force=masked, time=of_time)
    assert both.valid.tolist() == [True, False, True, True, False, False]
    quantity = ONE.position * u.m
    from astropy.utils.masked import Masked

    with_unit = replace(one, position=Masked(quantity.to(u.nm), mask=mask))
    assert with_unit.valid.tolist() == [True, False, True, True, True, True]
    np.testing.assert_allclose(with_unit.position[0], ONE.position[0], rtol=1e-12)


def test_columns_of_pandas_are_arrays():
    """A Series has a method `mask`, and a DataFrame is a table of forces."""
    actuators = pd.DataFrame({"x": LAYOUT.x, "y": LAYOUT.y, "id": LAYOUT.id}).convert_dtypes()
    one = tn.layout(actuators.x, actuators.y, id=actuators.id)
    assert np.array_equal([one.x, one.y, one.id], [LAYOUT.x, LAYOUT.y, LAYOUT.id])
    rows = pd.DataFrame({"shape": ONE.shape, "sign": ONE.sign, "valid": ONE.valid})
    force = pd.DataFrame(1e3 * ONE.force)
    force.attrs["units"] = "mN"  # as of xarray
    made = replace(ONE, shape=rows["shape"], sign=rows.sign, valid=rows.valid, force=force)
    np.testing.assert_allclose(made.force, ONE.force, rtol=1e-15)
    gap = pd.Series([1.0, None, 2.0, 3.0])
    for values, words in (
        (gap, "X of actuator 2 is not finite"),
        (pd.Series(list("abcd")), "X is not num"),
    ):
        with pytest.raises(ValueError, match=words):
            tn.layout(values.convert_dtypes(), LAYOUT.y)
    with pytest.raises(GeometryError, match="the ID in row 2 is missing; give"):
        tn.layout(LAYOUT.x, LAYOUT.y, id=gap.convert_dtypes())


def test_masked_numbers_without_rows_are_refused():
    mask = np.eye(N, dtype=bool)
    with pytest.raises(FormatError, match="STIFFNESS is masked; give all of it"):
        replace(MATRIX, stiffness=np.ma.masked_array(MATRIX.stiffness, mask))
    with pytest.raises(FormatError, match="X is masked"):
        tn.layout(np.ma.masked_array([1.0, 2.0], [True, False]), [0.0, 0.0])


def test_results_take_no_units_at_all():
    class Record:
        alpha = np.ones(3) * u.N

    with pytest.raises(FormatError, match="ALPHA is in N; give plain numbers"):
        freeze(Record(), "alpha")
    with pytest.raises(FormatError, match="several units"):
        in_unit([1.0 * u.N, 2.0 * u.m], "N", "force")
    plain = [1.0, 2.0]
    assert in_unit(plain, "N", "force") is plain


def test_functions_convert_too():
    made = rings([43.04, 73.3] * u.mm, [9, 15], turned=[3.0, 0.0] * u.deg)
    same = rings([0.04304, 0.0733], [9, 15], turned=[np.radians(3.0), 0.0])
    np.testing.assert_allclose([made.x, made.y], [same.x, same.y], rtol=1e-12)
    made = spherical_rings([1.2615, 2.1499] * u.deg, [9, 15], 1955 * u.mm)
    same = spherical_rings(np.radians([1.2615, 2.1499]), [9, 15], 1.955)
    np.testing.assert_allclose([made.x, made.nz], [same.x, same.nz], rtol=1e-12)
    with pytest.raises(FormatError, match="RADIUS is in N; give it in m"):
        spherical_rings([0.1], [9], 2 * u.N)
    bench = tn.static_bench(ring(8), 3, stroke=1.5 * u.um, force_noise=0.1 * u.mN)
    same = tn.static_bench(ring(8), 3, stroke=1.5e-6, force_noise=1e-4)
    np.testing.assert_allclose(bench.shapes, same.shapes, rtol=1e-12)


def test_attributes_of_public_records_are_plain_numbers_and_only_tables_have_units():
    """The rule of docs/api.md, by the annotations that mypy checks."""
    with_units, seen = set(), 0
    for kind in filter(inspect.isclass, (getattr(tn, name) for name in tn.__all__)):
        getters = {name: getattr(value, "fget", None) or getattr(value, "func", None)
                   for name, value in inspect.getmembers(kind)}  # fmt: skip
        hints = {
            name: get.__annotations__.get("return", "") for name, get in getters.items() if get
        }
        hints |= inspect.get_annotations(kind)
        seen += len(hints)
        united = ("Quantity", "QTable", "Table")
        with_units |= {name for name, hint in hints.items() if str(hint).endswith(united)}
    assert seen > 200
    assert with_units == {"table"}
