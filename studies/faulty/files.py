"""Places, cables and labels that are not those in the files."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

import truenewton as tn
from studies.faulty.bench import Array, Day
from studies.faulty.fault import fault
from studies.faulty.gains import drift


def misplaced(millimetres: float) -> Callable[[Day], None]:
    """Return that every magnet stands off where the files have it, rms along each axis."""

    def happens(day: Day) -> None:
        x, y = 1e-3 * millimetres * day.random.standard_normal((2, day.n))
        true = day.layout
        day.layout = tn.layout(true.x + x, true.y + y, id=true.id, nz=true.nz)

    return happens


fault("coordinates wrong by 0.5 mm rms", cause="position")(misplaced(0.5))
fault("coordinates wrong by 0.1 mm rms", cause="position")(misplaced(0.1))


def neighbours(day: Day) -> list[int]:
    """Draw an actuator and the one nearest to it."""
    at, layout = day.actuator(), day.bench.mirror.layout
    distance = np.hypot(layout.x - layout.x[at], layout.y - layout.y[at])
    return [at, int(np.argsort(distance)[1])]


@fault("two neighbouring cables swapped", cause="exchange|swap")
def swapped(day: Day) -> None:
    pair = neighbours(day)
    day.strike(*pair, judged=False)
    day.readings[:, pair] = day.readings[:, pair[::-1]]


@fault("two far cables swapped", cause="exchange|swap")
def swapped_far(day: Day) -> None:
    pair = day.random.choice(day.n, 2, replace=False)
    day.strike(*pair, judged=False)
    day.readings[:, pair] = day.readings[:, pair[::-1]]


@fault("FORCE in another order than POSITION", cause="order|exchange")
def another_order(day: Day) -> None:
    day.readings[:] = np.roll(day.readings, 1, axis=1)


@fault("a cable with its poles exchanged", cause="sign|negative")
def reversed_poles(day: Day) -> None:
    at = day.actuator()
    day.strike(at, judged=False)
    day.readings[:, at] *= -1


@fault("a dead actuator", cause="dead|no force|stuck")
def dead(day: Day) -> None:
    """Its coil gives nothing and reads nothing; the loop takes what is nearest to the shape."""
    at = day.actuator()
    day.strike(at, judged=False)
    others = day.bench.elastic[at] / day.bench.elastic[at, at]
    given = np.linalg.pinv(day.bench.glass.stiffness) @ others
    day.z = day.z - np.outer(day.true_force[:, at], given)


@fault("a reading that is stuck", cause="dead|no force|stuck")
def stuck(day: Day) -> None:
    at = day.actuator()
    day.strike(at, judged=False)
    day.readings[:, at] = day.readings[0, at]


def relabelled(true: int, said: int) -> Callable[[Day], None]:
    """Return that one file of a load bears the name of another."""

    def happens(day: Day) -> None:
        files = np.flatnonzero(np.array(day.order) == true)
        file = day.random.choice(files)
        day.label[file] = said
        day.where = (f"{day.loads[said].name} {day.number(file)}",)

    return happens


fault("one ring file labelled bare", cause="wrong LOAD of a file")(relabelled(1, 0))
fault("one bare file labelled ring", cause="wrong LOAD of a file")(relabelled(0, 1))


@fault("a file is the copy of another", cause="cop(y|ies)")
def copied(day: Day) -> None:
    day.readings[day.file == 1] = day.readings[day.file == 0]
    day.sensor_noise[day.file == 1] = day.sensor_noise[day.file == 0]


def other_files(cause: str) -> Callable[[Callable[[Array], Array]], None]:
    """Return a decorator that lists a change of the readings of one file."""

    def listed(change: Callable[[Array], Array]) -> None:
        def happens(day: Day) -> None:
            rows = day.file == day.random.integers(len(day.order))
            day.readings[rows] = change(day.readings[rows])

        fault(str(change.__doc__), cause=cause)(happens)

    return listed


@other_files(cause="unit")
def in_millinewtons(force: Array) -> Array:
    """FORCE of a file in mN"""
    return 1e3 * force


@other_files(cause="sign")
def negative(force: Array) -> Array:
    """FORCE of a file of the other sign"""
    return -force


@other_files(cause="order|exchange")
def reversed_order(force: Array) -> Array:
    """FORCE of a file in the reversed order"""
    return force[:, ::-1]


@fault("half of the files are of another mirror", cause="two groups|mirror")
def another_mirror(day: Day) -> None:
    late = day.file >= len(day.order) // 2
    other = 1 + 0.05 * day.random.standard_normal(day.n)
    day.readings[late] *= other


@fault("SIGN reversed in a file", cause="label|SIGN reversed")
def signs_reversed(day: Day) -> None:
    day.sign[day.file == day.random.integers(len(day.order))] *= -1


@fault("SHAPE counted from another one in a file", cause="label|SHAPE ")
def shapes_shifted(day: Day) -> None:
    rows = day.file == day.random.integers(len(day.order))
    day.shape[rows] = np.roll(day.shape[rows], 2)


@fault("drift 0.3 %/h, and coordinates wrong by 0.5 mm", cause="gain|drift|position")
def drift_and_misplaced(day: Day) -> None:
    drift(day)
    misplaced(0.5)(day)
