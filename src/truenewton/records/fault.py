"""What is wrong with data or a result, and what mends it."""

from __future__ import annotations

from typing import NamedTuple


class Fault(NamedTuple):
    """A fault and its remedy, each a clause without a full stop.

    Attributes
    ----------
    fault
        What is wrong.
    remedy
        What to do about it; empty where there is nothing to be done.
    """

    fault: str
    remedy: str
