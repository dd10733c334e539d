"""One finding: what a bench, a file or an actuator did beside the model."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

from truenewton.estimation.findings.catalogue import ENTRIES, Code, Concern


@dataclass(frozen=True, kw_only=True)
class Finding:
    """What was found in data beside the model (docs/effects.md).

    What only the user can settle has no probability, and is never corrected.

    Attributes
    ----------
    code
        What it is.
    detail
        What its name leaves open: which column, which reason.
    where
        In which file, of which actuator or load it is largest, '' if that says nothing.
    actuators
        IDs of those that it is about, if it is about single ones.
    probability
        Of data like these without it.
    size, unit
        Of its largest parameter.
    corrected
        Whether it was taken out of the data.
    remedy
        What to do about it.
    """

    code: Code
    detail: str = ""
    where: str = ""
    actuators: tuple[int, ...] = ()
    probability: float = 0.0
    size: float = 0.0
    unit: str = ""
    corrected: bool = False
    remedy: str

    @property
    def name(self) -> str:
        """How it reads, without where it is."""
        name = ENTRIES[self.code].name
        if "{}" in name:
            return name.format(self.detail)
        return f"{name}: {self.detail}" if self.detail else name

    @property
    def ids(self) -> str:
        """The actuators as a file has them."""
        return " ".join(map(str, self.actuators))

    @property
    def values(self) -> dict[str, Any]:
        """The same for a script."""
        return {"code": self.code, "name": self.name} | asdict(self)

    @property
    def concern(self) -> Concern:
        """What it is about, and so what it means for the result."""
        return ENTRIES[self.code].concern
