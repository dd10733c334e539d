"""A mirror in several segments: a part for each segment, or the reason why there is none.

Each segment is a body of its own, and every method for one body is applied to each. `Parts`
contains the results; their file is derived from that of a single body (`ResultKind`).
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from truenewton.arrays import Array
from truenewton.errors import (
    CampaignMismatch,
    Fault,
    FormatError,
    RankDeficient,
    TrueNewtonError,
    UnknownName,
    UnreadableFile,
    naming,
)
from truenewton.files.content import FitsFile
from truenewton.files.format import Attribute, Column, FileFormat, TableFormat, quantities, value_of
from truenewton.progress import progress_to, with_progress
from truenewton.records.result import Result, ResultKind, verdict_of
from truenewton.rounding import counted
from truenewton.statics.layout import Layout

if TYPE_CHECKING:
    from astropy.table import QTable
    from matplotlib.axes import Axes
    from typing_extensions import TypeIs

Part = TypeVar("Part")
Made = TypeVar("Made")
Faults = tuple[Fault, ...]


def require_segment(number: int, numbers: Sequence[int]) -> None:
    """Raise UnknownName if there is no segment of this number."""
    if number not in numbers:
        raise UnknownName(
            f"there is no segment {number}",
            remedy=f"choose {', '.join(map(str, numbers))}",
        )


class Executor(Protocol):
    """The method of a `concurrent.futures.Executor` that is used."""

    def map(self, fn: Callable[..., Any], *iterables: Iterable[Any]) -> Iterable[Any]:
        """Return the results in order."""


@dataclass(frozen=True, eq=False, repr=False)
class InParts(Generic[Part]):
    """A mirror in several segments.

    Attributes
    ----------
    instrument
        The mirror.
    layout
        The n actuators of all segments.
    failed
        Faults of the segments that have no part, by number.
    """

    instrument: str
    layout: Layout
    failed: Mapping[int, Faults] = field(default_factory=dict, kw_only=True)

    @property
    def numbers(self) -> tuple[int, ...]:
        """Numbers of all segments, ascending."""
        return self.layout.segments

    def part(self, number: int) -> Part:
        """Return the part of one segment.

        Raises
        ------
        UnknownName
            There is no such segment.
        RankDeficient
            It has no part; the message says why.
        """
        if number in self.failed:
            fault, remedy = self.failed[number][0]
            raise RankDeficient(f"segment {number} gave no alpha: {fault}", remedy=remedy)
        require_segment(number, self.numbers)
        return self._part(number)

    def _part(self, number: int) -> Part:
        raise NotImplementedError

    def of(self, number: int) -> NDArray[np.bool_]:
        """Return (n,) true for the actuators of a segment."""
        return np.asarray(np.asarray(self.layout.segment) == number)

    def own(self, number: int, ids: Iterable[int]) -> list[int]:
        """Return the IDs of those actuators that are of a segment."""
        return [one for one in ids if one in self.layout.id[self.of(number)]]

    def map(
        self, function: Callable[[Part], Made], executor: Executor | None = None
    ) -> Parts[Made]:
        """Apply a function to each part; a part for which it raises one of `errors` has failed.

        Parameters
        ----------
        function
            Of a part.
        executor
            As a `concurrent.futures.ProcessPoolExecutor`; if None, the parts are processed here.

        Raises
        ------
        RankDeficient
            All parts have failed.
        """
        return self.solved(lambda _: function, "a result", executor)

    def solved(
        self,
        solver: Callable[[int], Callable[[Part], Made]],
        what: str,
        executor: Executor | None = None,
    ) -> Parts[Made]:
        """Apply a function for each number to its part; ``what`` names the result in messages."""
        numbers = [number for number in self.numbers if number not in self.failed]

        def pairs() -> Iterator[tuple[Callable[[Part], Made], Part] | Fault]:
            for number in numbers:
                try:
                    yield solver(number), self.part(number)
                except UnreadableFile:
                    raise
                except TrueNewtonError as error:
                    yield _fault_of(error)

        answers = (map if executor is None else executor.map)(_attempt, pairs())
        found: dict[int, Made] = {}
        failed = dict(self.failed)
        told = with_progress(answers, len(numbers), "segments")
        for number, answer in zip(numbers, told, strict=True):
            if isinstance(answer, Fault):
                failed[number] = (answer,)
            else:
                found[number] = answer
        if not found:
            number, ((fault, remedy), *_) = next(iter(failed.items()))
            raise RankDeficient(
                f"no segment gives {what}; segment {number}: {fault}", remedy=remedy
            )
        return Parts(self.instrument, self.layout, found, failed=failed)


def _fault_of(error: TrueNewtonError) -> Fault:
    return Fault(f"{error.path}: {error.fault}" if error.path else error.fault, error.remedy)


def _attempt(pair: tuple[Callable[[Part], Made], Part] | Fault) -> Made | Fault:
    """Return the result of a function of a part, or why there is none."""
    if isinstance(pair, Fault):
        return pair
    function, part = pair
    # Warnings and progress are those of the mirror as a whole.
    with warnings.catch_warnings(), progress_to(lambda *_: None):
        warnings.simplefilter("ignore")
        warnings.simplefilter("error", RuntimeWarning)  # an overflow gives no result
        try:
            return function(part)
        except UnreadableFile:
            raise
        except TrueNewtonError as error:
            return _fault_of(error)
        except (ArithmeticError, RuntimeWarning, np.linalg.LinAlgError) as error:
            return Fault(
                f"the calculation broke down ({error})",
                "numbers are too large, too small or too much alike; look at each file with `info`",
            )


@dataclass(frozen=True, eq=False, repr=False)
class Parts(InParts[Part], Result):
    """The results of the segments of a mirror, each calculated separately.

    Returned by `calibrate`, `track`, `recalibrate` and `find_modes` for data in several segments.
    Arrays over actuators are in the order of ``layout``, NaN if their segment has no part.

    Attributes
    ----------
    instrument
        The mirror.
    layout
        The n actuators of all segments.
    found
        The result of a segment, as a `Calibration`, by its number.
    failed
        Faults of the segments that have no result, by number.

    Raises
    ------
    FormatError
        The two do not contain each segment once, or a result is of other actuators.

    Examples
    --------
    >>> made = tn.calibrate(tn.SegmentedData(stiffness=both), processes=1)
    >>> {number: one.method for number, one in made.found.items()}, len(made.failed)
    ({1: 'ml', 2: 'ml'}, 0)
    >>> made.column("alpha").shape, made.part(2).alpha.shape
    ((90,), (45,))
    >>> made.map(lambda one: float(np.mean(one.alpha))).found.keys()
    dict_keys([1, 2])
    """

    found: Mapping[int, Part]

    def __post_init__(self) -> None:
        numbers = sorted((*self.found, *self.failed))
        if not self.found or tuple(numbers) != self.numbers:
            raise FormatError(
                "SEGMENTS does not name each segment of the actuators once",
                remedy="make the file again",
            )
        for number, one in self.found.items():
            layout = getattr(one, "layout", None)
            own = self.layout.id[self.of(number)]
            if layout is not None and not np.array_equal(layout.id, own):
                raise FormatError(
                    f"the actuators of segment {number} are not those of the mirror",
                    remedy="make the file again",
                )
        for name in ("found", "failed"):
            ordered = dict(sorted(getattr(self, name).items()))
            object.__setattr__(self, name, MappingProxyType(ordered))

    def __repr__(self) -> str:
        no = f", {len(self.failed)} failed" if self.failed else ""
        kind = type(self._one).__name__
        return f"<Parts of {self.instrument}: {kind} of {counted(self.numbers, 'segment')}{no}>"

    def _part(self, number: int) -> Part:
        return self.found[number]

    @property
    def _one(self) -> Part:
        """The result of the first segment."""
        return next(iter(self.found.values()))

    @property
    def failures(self) -> tuple[tuple[int, str, str], ...]:
        """``failed`` as rows: number, fault and remedy."""
        return tuple((number, *one) for number, faults in self.failed.items() for one in faults)

    def values(
        self, of_one: Callable[[Part], dict[str, Any]], of_none: Callable[[Faults], dict[str, Any]]
    ) -> list[dict[str, Any]]:
        """Return values of each segment for a script, from its result or its faults."""
        return [
            {"segment": number}
            | (of_one(self.found[number]) if number in self.found else of_none(self.failed[number]))
            for number in self.numbers
        ]

    def column(self, attribute: Attribute) -> Array:
        """Return (n,) an attribute of the actuators, as 'alpha' or 'errors.1'."""
        out = np.full(self.layout.n, np.nan)
        for number, one in self.found.items():
            out[self.of(number)] = value_of(one, attribute)
        return out

    @cached_property
    def verdict(self) -> Any:
        """The verdict on all calibrations; each finding names its segments."""
        return verdict_of.dispatch(type(self._one))(self)

    @property
    def table(self) -> QTable:
        """One row per actuator: ID, X, Y, SEGMENT, and the results, with units."""
        table = quantities(self, self._kind.actuators, without=("NZ", "ENABLED"))
        table.meta = {"INSTRUME": self.instrument}
        return table

    def plot(self, *layer: str, **looks: Any) -> Axes:
        """Draw a quantity of all parts on the map of the actuators, as one part does."""
        drawn: Axes = type(self._one).plot(self, *layer, **looks)  # type: ignore[attr-defined]
        return drawn


def fault_values(faults: Faults) -> dict[str, Any]:
    """Return why a segment has no result, for a script."""
    return {"faults": [fault._asdict() for fault in faults]}


def refuse_other_mirror(given: Any, mirror: Any, than: str, path: str, remedy: str) -> None:
    """Raise CampaignMismatch if the data of a path are not of a mirror; ``than`` names its data."""
    fault, apart = "", mirror.layout.other_actuators(given.layout)
    if given.instrument != mirror.instrument:
        fault = f"is of {given.instrument}, {than} of {mirror.instrument}"
    elif apart or given.layout.segments != mirror.layout.segments:
        fault = f"has other actuators than {than}{f': {apart}' if apart else ''}"
    if fault:
        raise CampaignMismatch(fault, remedy=remedy, path=path)


def has_parts(data: object) -> TypeIs[InParts[Any]]:
    """Return whether data or results are of several segments."""
    return isinstance(data, InParts)


def by_number(made: Part | Parts[Part]) -> Mapping[int, Part]:
    """Return the result of each segment by its number; of one body by 0."""
    return made.found if isinstance(made, Parts) else {0: made}


def parts_from(file: FitsFile, kind: ResultKind[Part]) -> Parts[Part]:
    """Return the parts in a file."""
    of_alpha = next(each for each in kind.actuators.columns if each.name == "ALPHA")
    alpha = TableFormat(kind.name, (Column("ALPHA", "alpha"),))
    form = kind.whole
    values = file.values(FileFormat(form.keywords, (*form.extensions, alpha)))
    layout = file.filled(Layout, values["layout"])
    rows = values.get("failures", {"0": np.empty(0, dtype=int), "1": (), "2": ()})
    failed: dict[int, Faults] = {}
    for number, *fault in zip(rows["0"].tolist(), rows["1"], rows["2"], strict=True):
        failed[number] = (*failed.get(number, ()), Fault(*fault))
    found = {}
    for number, version in file.versions.items():
        try:
            found[number] = kind.read(version)
        except TrueNewtonError as error:
            raise error.changed(fault=f"of segment {number}, {error.fault}") from None
    with naming(file.path):
        made = Parts(values["instrument"], layout, found, failed=failed)
    if not np.array_equal(value_of(made, of_alpha.attribute), values["alpha"], equal_nan=True):
        raise FormatError(
            "ALPHA is not that of the segments", remedy="make the file again", path=file.path
        )
    return made


def body_or_parts_from(file: FitsFile, kind: ResultKind[Part]) -> Part | Parts[Part]:
    """Return the result in a file, of one body or of several segments."""
    return parts_from(file, kind) if "SEGMENTS" in file.extensions else kind.read(file)
