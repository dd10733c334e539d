"""What a fault is, and the list of all."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from studies.faulty.bench import Day

# The load of each file, in time, of so many cycles a load.
ORDERS: dict[str, Callable[[int], list[int]]] = {
    "in a row": lambda cycles: [0] * cycles + [1] * cycles,
    "in turn": lambda cycles: [0, 1] * cycles,
    "unbalanced": lambda cycles: [0] * (cycles + 1) + [1] * (cycles // 2),
    "one cycle": lambda _: [0, 1],
    "three loads": lambda cycles: [0] * cycles + [1] * cycles + [2] * cycles,
}


@dataclass(frozen=True)
class Fault:
    """Something that a bench or a file does.

    Attributes
    ----------
    name, happens
        What; and the function that makes it happen.
    cause
        Regular expression of the names that are right for it, with what `Day.where` asks for;
        empty where nothing is wrong, and a word is false.
    blind
        Whether nobody can see it in such data: it stands in the budget only.
    noise
        Of one reading [N]; that of the command line where None.
    order
        In which the files are taken (`ORDERS`).
    """

    name: str
    happens: Callable[[Day], None]
    cause: str = ""
    blind: bool = False
    noise: float | None = None
    order: str = "in a row"


FAULTS: list[Fault] = []


def fault(
    *names: str,
    cause: str = "",
    blind: bool = False,
    noise: float | None = None,
    order: str = "in a row",
) -> Callable[[Callable[[Day], None]], Callable[[Day], None]]:
    """List a function under its names."""

    def listed(happens: Callable[[Day], None]) -> Callable[[Day], None]:
        FAULTS.extend(Fault(name, happens, cause, blind, noise, order) for name in names)
        return happens

    return listed
