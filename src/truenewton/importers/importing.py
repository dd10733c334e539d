"""From a matrix and positions in files of other software to a checked stiffness matrix."""

from __future__ import annotations

import datetime
import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse.csgraph
from numpy.typing import ArrayLike, NDArray

from truenewton.arrays import Array
from truenewton.errors import FormatError, GeometryError, TrueNewtonError, located, naming
from truenewton.estimation.findings.code import Code
from truenewton.estimation.matrix.facts import MatrixFacts
from truenewton.estimation.matrix.order import (
    MIN_EXPLAINED_COUPLING,
    balance_effects,
    refuse_compliance,
    share_by_distance,
)
from truenewton.estimation.matrix.screen import released, screen_matrix
from truenewton.importers.inputs import (
    NAME,
    Given,
    NoPositions,
    Rings,
    date_of,
    numbers_of,
    read_given,
)
from truenewton.importers.selection import MAX_NAMED, Surface, in_newton_per_metre
from truenewton.importers.stored import read_stored
from truenewton.quantities import taking_units
from truenewton.records.stiffness_matrix import StiffnessMatrix, StoredAs
from truenewton.records.tables import Positions, numbers_of_labels
from truenewton.rounding import listed, named, percent
from truenewton.statics.arms import comparable_arms
from truenewton.statics.layout import Layout, integers_or_texts

PathLike = str | os.PathLike[str]
MIN_ORDER_SHARE = 0.2  # of the couplings, explained by distance


@dataclass(frozen=True, repr=False)
class Imported:
    """A stiffness matrix from files of other software.

    Attributes
    ----------
    matrix
        The matrix, for `calibrate` and `write_stiffness`.
    lines
        What was found and done: a headline, and one line for each check.
    transposed, balanced
        It looks transposed; commanded forces balance, so that alpha cannot be determined.
    folder
        The supervisor's folder, which `export_matrix` takes; '' of other files.
    """

    matrix: StiffnessMatrix
    lines: tuple[str, ...]
    transposed: bool = False
    balanced: bool = False
    folder: str = ""

    def __repr__(self) -> str:
        return "\n".join(self.lines)


@taking_units(curvature="m")
def stiffness_from(
    matrix: PathLike | ArrayLike,
    coordinates: PathLike | ArrayLike | Layout | None = None,
    *,
    unit: str | None = None,
    lengths: str | None = None,
    curvature: float | None = None,
    arc: bool = False,
    mirror: Any = None,
    ids: PathLike | Sequence[int | str] | None = None,
    dataset: str | None = None,
    shell: int | None = None,
    transpose: bool = False,
    date: datetime.datetime | None = None,
    instrument: str | None = None,
) -> Imported:
    """Make a checked stiffness matrix from a matrix and positions in files of other software.

    Parameters
    ----------
    matrix
        (n, n) forces of actuators, in rows, per displacement of sensors: an array, Quantity, file
        (FITS, .npy, .npz, CSV, text, HDF5, .mat, .sav), supervisor's or opticalib's folder.
    coordinates
        (n, 2) or (2, n) positions: an array, Quantity, layout, file, or folder of a supervisor's
        configuration; None if they are beside the matrix.
    unit, lengths
        Units of matrix and positions, if no file declares them; 'unknown' for steps.
    curvature, arc
        Radius of curvature R [m], if actuators push along the normals, negative if convex; whether
        radii are measured along the surface.
    mirror
        A known mirror or its layout, if positions are not given. The matrix may be of some of its
        actuators: rows are matched by ID or channel.
    ids, dataset
        (n,) IDs of rows, or a file of them; name of the matrix in a file with several.
    shell, transpose
        Number of one of several shells, from 1; whether the file contains the transposed matrix.
    date, instrument
        When it was measured (UTC), and the mirror's name.

    Raises
    ------
    UnreadableFile, FormatError, GeometryError, RankDeficient

    Examples
    --------
    >>> k, positions = -matrix.stiffness, 1e3 * np.stack([layout.x, layout.y])
    >>> tn.stiffness_from(k, positions, lengths="mm", instrument="P45").matrix
    <StiffnessMatrix of P45: 45 actuators>
    """
    rings = None if mirror is None else Rings.of(mirror)
    given = read_given(matrix, coordinates, rings, dataset, Surface(lengths or "", curvature, arc))
    with naming(given.path or None):
        k, rows, part = _one_shell(given.item.values, shell)
        in_newtons, unit_line = in_newton_per_metre(k, unit, given.item.unit)
        stored = partial(_stored_as, k, unit or given.item.unit or "N/m", transposed=transpose)
        k, sign = turned_sign(in_newtons.T if transpose else in_newtons)
        ways = list(_ways(given, rows, _names(ids, given.channels)))
        when, how = date_of(given, date)
    name = instrument or given.name
    check = partial(_checked, k, name=name, when=when, stored=stored(k), transposed=transpose)
    check = partial(check, mirror=given.mirror and given.mirror.name)
    record, judged, positions, noted = _numbered(_first_that_fits(given, ways, check), given, ids)
    of = f"{given.which}{part}, {unit_line}{', transposed as specified' if transpose else ''}"
    lines = [("found", ", ".join(given.found))] if given.found else []
    if name == NAME and not instrument:
        lines.append(("mirror", f"called {NAME}; to name it, use --instrument (instrument=)"))
    lines += [
        ("matrix", f"{len(k)} x {len(k)}{of}"),
        ("sign", sign),
        ("positions", f"{Path(given.where).name or 'given'}: {', '.join(positions.notes)}"),
        *noted,
        *judged.lines,
        ("date", f"{when:%Y-%m-%d %H:%M:%S} ({how})"),
    ]
    said = [f"{name}: {record.layout.n} actuators, from {given.path or 'arrays'}{given.kind}"]
    said += [f"  {what:<13}{how}" for what, how in lines]
    folder = given.path if given.channels is not None and given.kind else ""
    return Imported(record, tuple(said), judged.transposed, judged.balanced, folder)


def _stored_as(read: Array, unit: str, k: Array, *, transposed: bool) -> StoredAs:
    """Return how an (n, n) matrix is stored, from what was read and what was made of it [N/m]."""
    unit = "" if unit == "unknown" else unit
    of = read.T if transposed else read
    largest = np.unravel_index(np.argmax(np.where(np.isfinite(of), np.abs(of), 0.0)), of.shape)
    factor = float(k[largest] / of[largest])  # unit and sign
    return StoredAs(factor, unit, transposed, np.arange(len(k)), len(k))


def _numbered(found: Checked, given: Given, ids: object) -> Checked:
    """Add how rows are numbered, and the numbers on the mirror if IDs are channels of a table."""
    record, judged, positions, noted = found
    n = given.item.values[..., 0].size
    if ids is not None:
        how = "IDs as specified"
    elif given.channels is not None and given.numbers is not None:
        number = numbers_of(record.layout.id, given.numbers)
        record = replace(record, layout=replace(record.layout, number=number))
        how = "ID: channel; NUMBER: on the mirror, by act2mir_act.txt"
    elif given.channels is not None:
        how = f"IDs: {given.numbering}"
    elif positions.ids is not None:
        how = "IDs of the positions"
    else:
        how = f"rows from 1, as there is no ID; if they count from 0, --ids 0-{n - 1} (ids=)"
    return record, judged, positions, [*noted, ("numbering", how)]


def _checked(
    k: Array,
    positions: Positions,
    name: str,
    when: datetime.datetime,
    mirror: str | None,
    *,
    stored: StoredAs,
    transposed: bool,
) -> Checked:
    """Return an (n, n) matrix [N/m] with its positions, checked; lines on what was left out."""
    noted: list[tuple[str, str]] = []
    empty = ~(np.isfinite(k) & (k != 0.0))
    silent = empty.all(axis=0) & empty.all(axis=1)  # row and column contain only zeros or NaN
    lost = silent & _nowhere(positions, silent)
    k = np.where(silent[:, None] | silent, 0.0, k)[np.ix_(~lost, ~lost)]
    positions = positions.part(np.flatnonzero(~lost))
    if lost.any():
        noted.append(("left out", f"{np.count_nonzero(lost)} that are off and have no position"))
    if not np.isfinite(k).all():
        k, said = _without_nan(k, positions)
        noted.append(("unread", said))
    of = replace(positions, segment=None).layout()
    stored = replace(stored, rows=np.flatnonzero(~lost))
    record = StiffnessMatrix(name, when, of, k, mirror=mirror or None, stored=stored)
    share = MIN_ORDER_SHARE if mirror is None else MIN_EXPLAINED_COUPLING
    judged = judge(record, share, transposed=transposed)
    record = replace(record, layout=replace(of, enabled=of.enabled & ~judged.off))
    return record, judged, positions, noted


def _first_that_fits(
    given: Given, ways: list[Positions], check: Callable[[Positions], Checked]
) -> Checked:
    """Return the first order of positions in which couplings follow the distance."""
    first: TrueNewtonError | None = None
    for way in ways:
        try:
            return check(way)
        except (OtherOrder, GeometryError) as error:
            first = first or error
        except TrueNewtonError as error:
            raise located(error, given.path or None) from None
    assert first is not None  # as there is at least one
    raise located(_mended(first, given), given.where or given.path or None)


def _mended(error: TrueNewtonError, given: Given) -> TrueNewtonError:
    """Return an error of the order with the remedy for a mirror, or for positions without IDs."""
    positions = given.positions
    if not isinstance(error, OtherOrder) or positions is None:
        return error
    if given.mirror is not None:
        name = given.mirror.name or "the mirror"
        fault = f"the positions of {name} do not fit: {error.fault.partition(': ')[2]}"
        remedy = "give the mirror that it is, its actuators by --ids (ids=), or their positions"
        return error.changed(fault=fault, remedy=remedy)
    if positions.ids is not None:
        return error
    there = f"; there is {', '.join(positions.columns[:MAX_NAMED])}" if positions.columns else ""
    remedy = "put them in the order of the matrix, or give their numbers in a column named ID"
    return error.changed(remedy=remedy + there)


def _one_shell(values: Array, shell: int | None) -> tuple[Array, NDArray[np.int64] | None, str]:
    """Return the matrix of one shell, its rows and a text that names it.

    Shells are not coupled; each balances separately.
    """
    if values.ndim == 3:
        shells = [np.arange(values.shape[1]) + s * values.shape[1] for s in range(len(values))]
        matrices = list(values)
    else:
        coupled = np.isfinite(values) & (values != 0.0)
        _, label = scipy.sparse.csgraph.connected_components(coupled, directed=False)
        members = [np.flatnonzero(label == one) for one in dict.fromkeys(label.tolist())]
        shells = [rows for rows in members if len(rows) > 1]
        if len(shells) < 2:
            if shell not in (None, 1):
                raise FormatError(f"there is no shell {shell}", remedy="there is one")
            return values, None, ""
        matrices = [values[np.ix_(rows, rows)] for rows in shells]
    if shell is None or not 1 <= shell <= len(shells):
        sizes = ", ".join(str(len(rows)) for rows in shells)
        raise FormatError(
            f"contains {len(shells)} separate shells, of {sizes} actuators",
            remedy=f"choose one by --shell 1 .. {len(shells)} (shell=)",
        )
    return matrices[shell - 1], shells[shell - 1], f", shell {shell} of {len(shells)}"


def _names(
    ids: PathLike | Sequence[int | str] | None, channels: NDArray[np.int64] | None
) -> NDArray[Any] | None:
    """Return the IDs of the rows, or None."""
    if ids is None:
        return channels
    if not isinstance(ids, str | os.PathLike):
        return integers_or_texts(ids)
    path = Path(ids)
    if path.suffix.lower() in (".csv", ".txt") and path.is_file():
        words = path.read_text(encoding="utf-8-sig", errors="replace").replace(",", " ").split()
        if words and not any(word[0].isdigit() for word in words):  # texts, and perhaps a header
            return integers_or_texts(words[words[0].lower() in ("id", "ids") :])
    every = [item.values.ravel() for item in read_stored(ids).every.values()]
    return integers_or_texts(every[0] if every else [])


def _ways(
    given: Given, rows: NDArray[np.int64] | None, names: NDArray[Any] | None
) -> Iterator[Positions]:
    """Yield the positions of the rows: as given, then in other possible orders."""
    if given.mirror is not None and given.positions is not None and names is not None:
        yield from _by_number(given, given.positions, rows, names)
        return
    first = _positions_of(given, given.positions, rows, names)
    yield first
    if given.by_ring is not None:
        yield _positions_of(given, given.by_ring, rows, names)
    if names is None and first.ids is not None:
        texts = first.ids.dtype.kind == "U"
        numbers = numbers_of_labels(first.ids) if texts else first.ids
        if numbers is None:
            return
        order = np.argsort(numbers, kind="stable")
        ordered = numbers[order]
        if ordered[0] in (0, 1) and np.array_equal(ordered, ordered[0] + np.arange(order.size)):
            yield replace(first.part(order), notes=(*first.notes, "put in the order of their IDs"))


def _by_number(
    given: Given,
    positions: Positions,
    rows: NDArray[np.int64] | None,
    names: NDArray[Any],
) -> Iterator[Positions]:
    """Yield the positions of a mirror for (m,) names that are its IDs, or channels from 0."""
    fits = 0
    for ids, how in ((positions.ids, "ID"), (np.arange(positions.x.size), "channel")):
        if ids is not None and np.isin(names, ids).all():
            notes = (*positions.notes, f"{names.size} of {positions.x.size} matched by {how}")
            fits += 1
            yield _positions_of(given, replace(positions, ids=ids, notes=notes), rows, names)
    if not fits:
        raise FormatError(
            f"the mirror has {positions.x.size} actuators, and there is a row of {max(names)}",
            remedy="give the mirror that it is",
        )


def _positions_of(
    given: Given,
    positions: Positions | None,
    rows: NDArray[np.int64] | None,
    names: NDArray[Any] | None,
) -> Positions:
    """Return the positions of the rows of a matrix, or of those of one shell."""
    if positions is None:
        remedy = "give positions: columns X and Y, an (n, 2) array, or --mirror (mirror=)"
        n = given.item.values.shape[-1]
        raise NoPositions("has no positions", remedy=remedy, actuators=n)
    n_all = given.item.values[..., 0].size
    if names is not None and len(names) != n_all:
        raise FormatError(
            f"there are {len(names)} IDs for {n_all} rows", remedy="give one for each row"
        )
    if names is not None and positions.ids is not None:
        at = {name: k for k, name in enumerate(positions.ids.tolist())}
        missing = [name for name in names.tolist() if name not in at]
        if missing:
            raise FormatError(
                f"there is no position of actuator {missing[0]}", remedy="give one for every row"
            )
        positions = positions.part(np.array([at[name] for name in names.tolist()]))
    if positions.x.size != n_all:
        raise FormatError(
            f"there are {positions.x.size} positions for {n_all} rows and columns",
            remedy="name the rows by --ids (ids=)"
            if given.mirror is not None
            else "give one for each row; if both are numbered, name the rows by --ids (ids=)",
        )
    positions = replace(positions, ids=names) if names is not None else positions
    if rows is None:
        return positions
    positions = positions.part(rows)
    middle = float(np.mean(positions.x)), float(np.mean(positions.y))
    note = f"counted from the shell's middle, {middle[0]:.4g}, {middle[1]:.4g} m"
    return replace(
        positions,
        x=positions.x - middle[0],
        y=positions.y - middle[1],
        notes=(*positions.notes, note),
    )


def _nowhere(positions: Positions, silent: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return (n,) true for positions that are unknown, or those of another actuator and silent."""
    places = np.round([positions.x / 1e-9, positions.y / 1e-9])
    unknown = ~np.isfinite(places).all(axis=0)
    _, first, count = np.unique(
        np.where(unknown, np.arange(unknown.size), places),
        axis=1, return_inverse=True, return_counts=True,
    )  # fmt: skip
    return np.asarray(unknown | ((count[first] > 1) & silent))


def _without_nan(k: Array, positions: Positions) -> tuple[Array, str]:
    """Return an (n, n) matrix without the one sensor or actuator that has NaN, and a text."""
    wrong = ~np.isfinite(k)
    ids = positions.ids if positions.ids is not None else np.arange(1, len(k) + 1)
    sensors, actuators = wrong.any(axis=0), wrong.any(axis=1)
    one = sensors if np.count_nonzero(sensors) == 1 else actuators
    if np.count_nonzero(one) != 1:
        i, j = np.argwhere(wrong)[0]
        raise FormatError(
            f"{np.count_nonzero(wrong)} elements are NaN or infinite, the first of actuator"
            f" {ids[i]} and sensor {ids[j]}",
            remedy="measure them, or set row and column of such actuators to zero",
        )
    of = f"{'sensor' if one is sensors else 'actuator'} {ids[one][0]}"
    count = np.count_nonzero(wrong)
    half = "column" if one is sensors else "row"
    said = f"{count} elements of {of} are not numbers: its {half} is set to zero"
    k = k.copy()
    (k.T if one is sensors else k)[one] = 0.0
    return k, said


class OtherOrder(FormatError):
    """Positions are in another order than rows and columns."""


class Judged(NamedTuple):
    """The checks of a matrix.

    ``lines`` are pairs of name and text, ``off`` (n,) true for actuators that are off; for
    ``transposed`` and ``balanced`` see `Imported`.
    """

    lines: tuple[tuple[str, str], ...]
    off: NDArray[np.bool_]
    transposed: bool
    balanced: bool


Checked = tuple[StiffnessMatrix, Judged, Positions, list[tuple[str, str]]]


def turned_sign(k: Array) -> tuple[Array, str]:
    """Return an (n, n) stiffness with a positive diagonal, and a text on its sign."""
    own = np.diag(k)
    against = np.count_nonzero(own < 0.0)
    if against <= np.count_nonzero(own > 0.0):
        return k, "positive (correct)"
    return (
        -k,
        "negative: sign changed (forces on the mirror, positive upward, maintain a displacement)",
    )


def judge(
    matrix: StiffnessMatrix, min_share: float = MIN_ORDER_SHARE, *, transposed: bool = False
) -> Judged:
    """Check orientation, order and single actuators of a matrix, which may be transposed already.

    Positions are refused if distance explains less than ``min_share`` of the couplings.
    """
    refuse_compliance(MatrixFacts.of(matrix), matrix.layout)
    matrix = released(matrix)
    measured = matrix.used_stiffness.any(axis=0) | matrix.used_stiffness.any(axis=1)
    k = matrix.used_stiffness[np.ix_(measured, measured)]
    facts = MatrixFacts(k, comparable_arms(matrix.layout)[:, measured])
    balanced = tuple(balance_effects(MatrixFacts.of(matrix)))
    lines = [("orientation", _orientation(facts, transposed=transposed))]
    lines += [("balance", f"{each.name}; {each.remedy}") for each in balanced]
    share = share_by_distance(k, facts.arms)
    if share < min_share and len(k) >= 20:
        raise OtherOrder(
            f"positions are in another order than rows and columns: {100 * max(share, 0.0):.0f} %"
            " of the couplings follow the distance (usual: 80 %)",
            remedy="put them in the order of the matrix, or match them by ID (--ids)",
        )
    if np.isfinite(share):
        doubt = "" if share > MIN_EXPLAINED_COUPLING else ": LOW, check numbering and positions"
        lines.append(("order", f"{100 * share:.0f} % of the couplings follow the distance{doubt}"))
    screened = screen_matrix(matrix)
    gone = np.zeros(matrix.layout.n, dtype=np.bool_)
    gone[matrix.layout.enabled] = ~measured
    pushing = any(each.code is Code.OFF_BUT_PUSHING for each in screened.warnings)
    off = gone if not pushing else np.zeros_like(gone)
    if gone.any():
        what = "disabled, because row and column are zero"
        if pushing:  # one actuator: the screening refuses several
            what = "left enabled although row and column are zero, because the columns around it"
            what += " do not balance, as if it had exerted a force"
        off_ids = listed(matrix.layout.id[gone], MAX_NAMED)
        lines.append(("off", f"{np.count_nonzero(gone)} {what}: {off_ids}"))
    kept = [each for each in screened.warnings if each.code is Code.MISFITS_KEPT]
    lines += [("do not fit", each.fault) for each in kept]
    left_out = [each for each in screened.effects if each.code == Code.ACTUATOR_MISFIT]
    for reason in dict.fromkeys(each.detail for each in left_out):
        ids = [i for each in left_out if each.detail == reason for i in each.actuators]
        which = named("actuator", ids, MAX_NAMED)
        lines.append(("do not fit", f"{which}: {reason} (excluded by calibrate)"))
    return Judged(tuple(lines), off, facts.looks_transposed, bool(balanced))


def _orientation(facts: MatrixFacts, *, transposed: bool) -> str:
    figures = f"rigid-body residual {percent(facts.rigid_cost)}, column imbalance"
    figures += f" {percent(facts.imbalance)} of the diagonal"
    if facts.looks_transposed:
        advice = "omit" if transposed else "if it is not, add"
        return (
            f"LOOKS TRANSPOSED: {figures}; element [i, j] must be the force of actuator i per"
            f" displacement of sensor j; {advice} --transpose"
        )
    return f"{'correct as transposed' if transposed else 'not transposed'} ({figures})"
