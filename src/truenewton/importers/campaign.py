"""A campaign in files of other software, which a short TOML file describes (campaign.toml)."""

from __future__ import annotations

import datetime
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
from scipy.special import bdtr, bdtrc

from truenewton.arrays import Array
from truenewton.chance import normal_isf
from truenewton.errors import FormatError, naming
from truenewton.estimation.findings.code import LIMITS
from truenewton.files.tables import Item
from truenewton.files.toml import filled, read_toml
from truenewton.importers.inputs import written_date
from truenewton.importers.selection import (
    Surface,
    in_metres,
    read_positions,
    there_is,
)
from truenewton.importers.stored import Stored, read_stored
from truenewton.quantities import in_unit, in_units
from truenewton.records.campaign import Campaign
from truenewton.records.cycle import ASSUMED, Cycle
from truenewton.records.tables import (
    MATRICES,
    check_size,
    columns_by_id,
    refuse_other_order,
    wide_rows,
)
from truenewton.rounding import listed
from truenewton.statics.layout import Layout
from truenewton.statics.load import MIRROR_WEIGHT, Load

MIN_CHANCE = 1e-3  # of numbers that look like others
SIGMAS = normal_isf(MIN_CHANCE / 2)
BY_LINE = "numbered from 1, as there is no ID"
OPTIONAL = ("gap", "force_error", "coil_gradient", "bias_gradient")


@dataclass(frozen=True, kw_only=True)
class PositionsFile(Surface):
    """The file of the positions."""

    file: str


@dataclass(frozen=True)
class Columns:
    """Names of columns, or their numbers from 1; '' if there is no such column."""

    shape: str | int = "shape"
    sign: str | int = "sign"
    force: str | int = "force"
    position: str | int = ""
    time: str | int = ""
    temperature: str | int = ""
    valid: str | int = ""
    actuator: str | int = ""
    row: str | int = ""


@dataclass(frozen=True)
class Units:
    """Units of columns, if the files do not declare them."""

    force: str = "N"
    position: str = "m"
    time: str = "s"
    temperature: str = "deg_C"


@dataclass(frozen=True)
class LoadFiles:
    """A load, with weights as `Load` or as texts with a unit, and the file of each cycle."""

    name: str
    files: tuple[str, ...]
    added: float | str = 0.0
    added_error: float | str | None = None
    tool: str | None = None
    tilt: float = 0.0
    tilt_error: float = 0.0


@dataclass(frozen=True)
class CampaignFiles:
    """The files of a campaign, and what they do not contain."""

    instrument: str
    weight: float | str
    weight_error: float | str
    positions: PositionsFile
    loads: tuple[LoadFiles, ...]
    columns: Columns = Columns()
    units: Units = Units()
    date: datetime.datetime | None = None
    gap: float | None = None
    force_error: float | None = None
    coil_gradient: float | None = None
    bias_gradient: float | None = None


def example() -> str:
    """Return a description with comments, to start from."""
    return resources.files("truenewton.importers").joinpath("campaign.toml").read_text("utf-8")


def campaign_from(path: str | os.PathLike[str]) -> tuple[Campaign, tuple[str, ...]]:
    """Return the campaign that a TOML file describes, and a line on each of its files.

    Raises
    ------
    UnreadableFile, FormatError, GeometryError, CampaignMismatch
    """
    described = filled(CampaignFiles, read_toml(path), path)
    folder = Path(path).parent
    actuators, notes = _layout_from(folder, described.positions)
    with naming(path):
        loads = [_load_of(one) for one in described.loads]
        weight, error = in_units(vars(described), MIRROR_WEIGHT).values()
        more: dict[str, Any] = {name: getattr(described, name) for name in OPTIONAL}
    runs: dict[Load, list[dict[str, Any]]] = {}
    lines = [
        f"{described.instrument}: {actuators.n} actuators, weight {weight:.4g} ± {error:.2g} N",
        f"  positions {', '.join(notes)}: {described.positions.file}",
    ]
    lines += [*_unlikely_error("the weight", weight, error), *_load_lines(loads, weight)]
    for load, files in zip(loads, described.loads, strict=True):
        cycles = runs.setdefault(load, [])
        for name in files.files:
            with naming(folder / name):
                arrays, doubted = _arrays_from(
                    read_stored(folder / name), described, actuators, by_line=BY_LINE in notes
                )
            cycles.append(arrays)
            largest = np.nanmax(np.abs(arrays["force"]))
            rows = len(arrays["force"])
            lines.append(
                f"  {load.name} {len(cycles):<4}{rows} rows, forces up to {largest:.3g} N: {name}"
            )
            lines += [
                f"  UNLIKELY  {what} has numbers from 1 to 999 with three decimals or none: if a"
                " point separates thousands, write 1234 for 1.234"
                for what in doubted
            ]
    more["date"], source = _date_of(folder, described)
    lines.append(f"  date {more['date']:%Y-%m-%d %H:%M:%S} UTC ({source})")
    first = "" if described.columns.time else "one row a second, as there is no column of time; "
    lines.append(f"  times assumed: {first}each cycle begins 1 s after the end of the one before")
    with naming(path):
        made = Campaign.from_arrays(described.instrument, actuators, weight, error, runs, **more)
        if described.date is None:
            made = Campaign(tuple(replace(each, times=ASSUMED) for each in made))
        if doubt := check_size(actuators, made.weight):
            lines.insert(2, f"  UNLIKELY  {doubt}")
        lines += _unlikely_forces(made)
    return made, tuple(lines)


def _layout_from(folder: Path, given: PositionsFile) -> tuple[Layout, tuple[str, ...]]:
    """Return the layout in a file of positions, and texts on what was found."""
    path = folder / given.file
    with naming(path):
        at = in_metres(read_positions(path), given)
        notes = at.notes if at.ids is not None else (*at.notes, BY_LINE)
        made = at.layout()
        if made.has_texts:
            notes = (*notes, "IDs are texts (NUMBER): numbered from 1 in this order")
        if made.segments:
            raise FormatError(
                f"has actuators of {len(made.segments)} segments, which balance separately",
                remedy="describe each segment in a TOML file, with its positions and weights, and"
                " calibrate the folders together",
            )
        return made, notes


def _load_of(given: LoadFiles) -> Load:
    """Return the load of some files."""
    if not given.files:
        raise FormatError(f"load '{given.name}' has no files", remedy="give a file for each cycle")
    if given.added_error is None and given.added:
        raise FormatError(f"load '{given.name}' lacks 'added_error'", remedy="add it")
    values = {name: value for name, value in vars(given).items() if name != "files"}
    return Load(**values | {"added_error": given.added_error or 0.0})


MAX_RELATIVE_ERROR = 0.1  # of a weight: beyond, its unit is probably another than that of its error


def _unlikely_error(what: str, weight: float, error: float) -> Iterator[str]:
    """Yield a remark if an error is too large for its weight: N may have been read for grams."""
    if weight and error > MAX_RELATIVE_ERROR * abs(weight):
        share = f"the error of {what} is {100 * error / abs(weight):.0f} % of it"
        yield f"  UNLIKELY  {share}: check its unit (N, if it has none)"


def _load_lines(loads: Sequence[Load], weight: float) -> Iterator[str]:
    """Yield lines on the added weights, and on what is unlikely of them or missing."""
    for load in loads:
        if load.added:
            yield f"  load {load.name}: {load.added:.4g} ± {load.added_error:.2g} N added"
            yield from _unlikely_error(f"load {load.name}", load.added, load.added_error)
        if load.added < weight:
            times = f"{load.added / weight:.3g} times the weight of the mirror"
            yield f"  UNLIKELY  load {load.name} is {times}: check the unit of added"
    if len(loads) == 1:
        yield f"  only one load, {loads[0].name}: alpha also needs a load of another known weight"


def _unlikely_forces(made: Campaign) -> Iterator[str]:
    """Yield a remark if the sum of forces does not change as the weight: their unit may differ."""
    of_load, sums = np.array(made.load_index), [_sums_of_forces(cycle) for cycle in made]
    light, heavy = np.argmax(made.effective_weights), np.argmin(made.effective_weights)
    one, other = (np.concatenate([sums[k] for k in np.flatnonzero(of_load == load)])
                  for load in (light, heavy))  # fmt: skip
    change = float(other.mean() - one.mean())
    error = float(np.hypot(other.std() / np.sqrt(other.size), one.std() / np.sqrt(one.size)))
    weight = float(made.effective_weights[light] - made.effective_weights[heavy])
    least, most = weight / LIMITS.highest_alpha, weight / LIMITS.lowest_alpha
    if weight and not least - SIGMAS * error < change < most + SIGMAS * error:
        names = f"{made.loads[light].name} to {made.loads[heavy].name}"
        yield (
            f"  UNLIKELY  from {names}, the sum of forces changes by {change:.3g} N and the weight"
            f" by {-weight:.3g} N: check the unit of force"
        )


def _sums_of_forces(cycle: Cycle) -> Array:
    """Return the sum of forces along z in each valid row [N]."""
    used = cycle.layout.enabled
    return cycle.force[cycle.valid][:, used] @ cycle.layout.nz[used]


def _thousands(values: Array) -> bool:
    """Return whether numbers look like integers of which a point separated thousands.

    Those without digits after the point are then below 1000, and the others have three.
    """
    some = np.abs(values[np.isfinite(values) & (values != 0.0)])
    whole = some == np.round(some)
    if whole.all() or some.max() >= 1e3 or some[~whole].min() < 1.0:
        return False
    steps = 1e3 * some[~whole]
    if not np.allclose(steps, np.round(steps), rtol=0.0, atol=1e-6):
        return False
    # Decimals: 1 in 1000 has none by chance. Thousands: 1 in 10 has a last digit of 0.
    by_chance = bdtrc(np.count_nonzero(whole) - 1, some.size, 1e-3)
    last = bdtr(np.count_nonzero(np.round(steps) % 10), steps.size, 0.9)
    return bool(by_chance < MIN_CHANCE < last)


def _date_of(folder: Path, described: CampaignFiles) -> tuple[datetime.datetime, str]:
    """Return the date of the first cycle (UTC), and where it is from."""
    if described.date is None:
        first = described.loads[0].files[0]
        how = f"assumed, that of the file {first}; to change it, specify date"
        return written_date(folder / first), how
    date = described.date
    return date.replace(tzinfo=date.tzinfo or datetime.UTC).astimezone(datetime.UTC), "as specified"


def _arrays_from(
    stored: Stored, described: CampaignFiles, actuators: Layout, *, by_line: bool
) -> tuple[dict[str, Any], list[str]]:
    """Return the arrays of the cycle in a file, and which may have points between thousands.

    ``by_line`` is as of `_matrix_in`.
    """
    columns, values, doubted = described.columns, dict[str, Any](), list[str]()
    for name in (field.name for field in fields(Columns)):
        wanted = getattr(columns, name)
        if not wanted:
            continue
        if name in MATRICES and not columns.actuator:
            item = _matrix_in(stored, wanted, actuators, by_line)
        else:
            item = _column_in(stored, wanted)
        values[name] = item.values if name == "actuator" else item.numbers(str(wanted))
        if name in MATRICES and _thousands(values[name]):
            doubted.append(name)
        if unit := item.unit or getattr(described.units, name, ""):
            values[name] = in_unit(item.values, Cycle.QUANTITIES[name].unit, name, has=unit)
    if "valid" in values:
        values["valid"] = values["valid"] != 0.0
    for name in ("shape", "sign"):
        if not np.array_equal(values[name], np.round(values[name])):
            raise FormatError(f"{name.upper()} is not an integer in each row", remedy="check it")
    return wide_rows(values, actuators) if columns.actuator else values, doubted


def _column_in(stored: Stored, wanted: str | int) -> Item:
    """Return a column by its name or number."""
    if isinstance(wanted, int):
        return Item(_table(stored, wanted)[:, wanted - 1])
    known = stored.names.get(wanted) or stored.names.get(wanted.casefold())
    if known is None:
        raise FormatError(
            f"there is no column '{wanted}'",
            remedy="name the columns of the file in the table [columns] of the description;"
            f" the file has {listed(filter(None, stored.every), 12)}",
        )
    name, unit = known
    item = stored.every[name]
    values = np.atleast_1d(np.squeeze(item.values))  # there may be one row
    return item._replace(values=values, unit=item.unit or unit)


def _matrix_in(stored: Stored, wanted: str | int, actuators: Layout, by_line: bool) -> Item:
    """Return (rows, n) values: columns from a number on, columns of each actuator, or an array.

    If actuators are numbered by their line, their positions may be in the order of the columns.
    """
    n = actuators.n
    if isinstance(wanted, int):
        table = _table(stored, wanted + n - 1)
        if len(stored.columns) == table.shape[1]:
            refuse_other_order([*stored.columns][wanted - 1 : wanted - 1 + n], actuators)
        return Item(table[:, wanted - 1 : wanted - 1 + n])
    if "{id}" in wanted:
        names = columns_by_id(wanted, actuators, stored.names)
        if by_line:
            refuse_other_order([name for name in stored.columns if name in names], actuators)
        items = [_column_in(stored, name) for name in names]
        values = [item.numbers(name) for name, item in zip(names, items, strict=True)]
        return Item(np.stack(values, axis=1), items[0].unit)
    item = _column_in(stored, wanted)
    if item.values.ndim != 2 or item.values.shape[1] != n:
        raise FormatError(
            f"'{wanted}' has shape {item.values.shape}",
            remedy=f"give an array of rows by {n} actuators, or the name of columns, as 'F{{id}}'",
        )
    return item


def _table(stored: Stored, last: int) -> Any:
    """Return the numbers of a text file or array that has at least so many columns."""
    tables = [item.values for item in stored.arrays.values() if item.values.ndim == 2]
    if len(tables) != 1 or tables[0].shape[1] < last:
        has = f"has {tables[0].shape[1]} columns" if len(tables) == 1 else "is not one table"
        raise FormatError(f"{has}, and column {last} is needed", remedy=there_is(stored))
    return tables[0]
