"""What touches the glass, and what is heavier than it is said to be."""

from __future__ import annotations

import numpy as np

from studies.faulty.bench import CENTRING, Day
from studies.faulty.fault import fault


@fault("contact of 20 mN in one sign", cause="contact")
def contact_in_one_sign(day: Day) -> None:
    day.push(np.where(day.sign > 0, 20e-3, 0.0), day.somewhere())


@fault("contact of 20 mN in one sign under the ring", cause="contact")
def contact_in_one_sign_under_ring(day: Day) -> None:
    pushed = (day.sign > 0) & (day.load == 1)
    day.push(np.where(pushed, 20e-3, 0.0), day.somewhere())


@fault("dust: 20 mN where a gap is narrow", cause=r"force\b")
def dust(day: Day) -> None:
    at = day.actuator()
    day.strike(at)
    day.push_at(at, np.where(day.z[:, at] > 0.2e-6, -20e-3, 0.0))


@fault("friction of 2 mN at an actuator", cause=r"force\b|friction")
def friction(day: Day) -> None:
    at = day.actuator()
    day.strike(at)
    day.push_at(at, -2e-3 * np.tanh(day.z[:, at] / 5e-9))


@fault("a wire of 1e4 N/m at an actuator", cause=r"force\b|gradient")
def wire(day: Day) -> None:
    at = day.actuator()
    day.strike(at)
    day.push_at(at, -1e4 * day.z[:, at])


@fault("a force of 20 mN in one file", cause=r"contact|force\b|zero by file")
def contact_in_a_file(day: Day) -> None:
    file = day.random.integers(len(day.order))
    day.push(np.where(day.file == file, 20e-3, 0.0), day.somewhere())


@fault("bias magnets drift, all alike, 5 mN/h", cause="drift|hour|zero|gain")
def drift_of_bias(day: Day) -> None:
    day.bias = day.bias + 5e-3 / day.n * day.hours[:, None]


@fault("contact of 20 mN at the rim under the ring", blind=True)
def contact_under_ring(day: Day) -> None:
    day.push(np.where(day.load == 1, 20e-3, 0.0), day.rim())


@fault("5 mN held up at the rim under the ring", blind=True)
def held_up(day: Day) -> None:
    day.push(np.where(day.load == 1, 5e-3, 0.0), day.rim())


@fault("the ring put on anew for each file", cause="load repositioned")
def put_on_anew(day: Day) -> None:
    """It stands off by its centring each time: forces at rest move, their sum does not."""
    (x, y), added = day.wedges[1], day.bench.mirror.added_weight
    for file in np.unique(day.file[day.load == 1]):
        dx, dy = day.random.normal(0.0, CENTRING, 2)
        day.push(np.where(day.file == file, added, 0.0), (x + dx, y + dy))
        day.push(np.where(day.file == file, -added, 0.0), (x, y))


@fault("the ring 1 % heavier than declared", blind=True)
def heavier(day: Day) -> None:
    day.push(0.01 * day.bench.mirror.added_weight * (day.load == 1), day.wedges[1])


@fault("the ring 10 % heavier, a third load", cause="weight", order="three loads")
def much_heavier(day: Day) -> None:
    day.push(0.10 * day.bench.mirror.added_weight * (day.load == 1), day.wedges[1])


@fault("bias magnets change by 15.8 mN between the loads", blind=True)
def other_bias(day: Day) -> None:
    day.bias = day.bias - np.where(day.under(), 15.8e-3 / day.n, 0.0)


@fault("a tilt of 3 deg under the ring", blind=True)
def tilted(day: Day) -> None:
    lost = 1 - np.cos(np.radians(3.0))
    held, external = day.bench.weight
    day.carry(-lost * (day.load == 1), held, external)
    day.push(-lost * day.bench.mirror.added_weight * (day.load == 1), day.wedges[1])
