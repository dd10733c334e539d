"""What changed between two matrices of one mirror, and its file."""

from __future__ import annotations

import datetime
import os
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from truenewton.arrays import Array
from truenewton.comparison.calibrations import TABLES, Change
from truenewton.comparison.fit import RowNoise
from truenewton.comparison.pairing import Matching
from truenewton.estimation.findings.code import Code
from truenewton.estimation.findings.finding import Finding, Verdict, judged
from truenewton.figures.layers import Layer
from truenewton.figures.style import on_screen
from truenewton.files.fits import read_fits
from truenewton.files.format import Column, FileFormat, Keyword, TableFormat, quantities
from truenewton.records.file import ID, INSTRUMENT, NZ, X, Y
from truenewton.records.result import FORMATS, OTHER_FORMATS, Result
from truenewton.statics.layout import Layout
from truenewton.tracking.days import OTHER_UNIT

# Largest singular value of n x n noise over 2 sqrt(n): 0.9 to 1.05 if it is noise.
MAX_PATTERN = 1.15
# Errors of alpha, below which its scatter may be noise: a few patterns can dominate the noise.
MAX_SCATTER = 3.0
MAX_TAILS = 1.5  # excess kurtosis of the residual: at most 0.8 for the right noise law
MAX_RESEMBLANCE = 4.0  # sigmas; at most 3 if alpha and gains changed independently
MAX_EXCESS = 1.2  # rms residual relative to that of a repeat; days differ in noise by less


@dataclass(frozen=True, eq=False, repr=False)
class Comparison(Result):
    """What changed from an old to a new state of one mirror; arrays are NaN if not compared.

    Attributes
    ----------
    instrument, date, date_end
        INSTRUME of the old data, and the dates (UTC) of both.
    layout
        The n actuators of the old data; those that were compared are enabled.
    alpha_ratio, alpha_ratio_error
        (n,) alpha of the new over that of the old data, relative to the mean of the actuators that
        did not change, and its standard uncertainty.
    sensor_ratio, sensor_ratio_error
        (n,) the same of the sensor gains, reading / true displacement.
    alpha_changed, sensor_changed
        (n,) those that deviate from the population of the others (1 % false alarms in all).
    alpha_scatter, sensor_scatter
        Standard deviation of that population beyond the errors.
    common, common_error
        Mean of alpha_ratio times mean of sensor_ratio of those that did not change, which both were
        divided by: the weight, Young's modulus, the gap or a unit cannot be told from it.
    couplings
        IDs of actuator and sensor of the elements that changed by themselves, and by how much,
        relative to the geometric mean of the two diagonal elements.
    noise_law, relative_noise
        'elements', 'modes', 'shapes' or 'elements and shapes'; rms difference that is not
        explained, relative to the rms element.
    pattern
        Largest singular value of the whitened residual over 2 sqrt(n): about 1 if it is noise.
    tails
        Excess kurtosis of the residual: 0 if the noise law is right.
    resemblance
        Sigmas by which the changes of alpha and of the sensor gains are equal: stiffness of the
        glass multiplies both alike.
    excess
        Rms residual over that of two matrices of one day; NaN if no repeat was given.
    matching
        How actuators, rows and columns were matched.
    converged
        Whether the fit converged.

    Examples
    --------
    >>> tn.compare(matrix_2025, matrix_2026)
    <Comparison of P45: 45 actuators, 0 changed>
    """

    instrument: str
    date: datetime.datetime
    date_end: datetime.datetime
    layout: Layout
    alpha_ratio: Array
    alpha_ratio_error: Array
    sensor_ratio: Array
    sensor_ratio_error: Array
    alpha_changed: NDArray[np.bool_]
    sensor_changed: NDArray[np.bool_]
    alpha_scatter: float
    sensor_scatter: float
    common: float
    common_error: float
    couplings: tuple[tuple[int, int, float], ...]
    noise_law: str
    relative_noise: float
    pattern: float
    tails: float
    resemblance: float
    excess: float
    matching: Matching
    converged: bool

    def __repr__(self) -> str:
        n, changed = int(self.layout.enabled.sum()), int(self.changed.sum())
        return f"<Comparison of {self.instrument}: {n} actuators, {changed} changed>"

    @property
    def changed(self) -> NDArray[np.bool_]:
        """(n,) actuators whose alpha or sensor gain changed."""
        return self.alpha_changed | self.sensor_changed

    @property
    def table(self) -> Any:
        """The changes of all actuators."""
        return quantities(self, CHANGES, without=("NZ",))

    def plot(self, layer: str = "alpha", ax: Axes | None = None) -> Axes:
        """Draw the change of 'alpha' or 'sensor' on the map of the actuators; return the axes."""
        layers = {each.key: each for each in change_layers(self)}
        with on_screen():
            return layers[layer].plot(self.layout, ax)

    @property
    def findings(self) -> tuple[Finding, ...]:
        """What limits the errors."""
        found = []
        if self.alpha_scatter > max(OTHER_UNIT, MAX_SCATTER * np.nanmedian(self.alpha_ratio_error)):
            found.append(Finding.of(Code.PAIR_UNITS, scatter=self.alpha_scatter))
        if self.pattern > MAX_PATTERN:
            rows = self.noise_law == RowNoise.name
            code = Code.PAIR_ROWS if rows else Code.PAIR_PATTERN
            found.append(Finding.of(code, pattern=self.pattern))
        if self.tails > MAX_TAILS:
            found.append(Finding.of(Code.PAIR_NOISE, tails=self.tails))
        if self.resemblance > MAX_RESEMBLANCE:
            found.append(Finding.of(Code.PAIR_GLASS, sigmas=self.resemblance))
        if self.excess > MAX_EXCESS:
            found.append(Finding.of(Code.PAIR_EXCESS, excess=self.excess))
        if not self.converged:
            found.append(Finding.of(Code.PAIR_NOT_CONVERGED))
        return tuple(found)

    @property
    def verdict(self) -> Verdict:
        """Whether the stated errors are valid; a change is no fault."""
        return judged(self.findings)


AnyChange = Change | Comparison


def change_layers(c: AnyChange) -> tuple[Layer, ...]:
    """Return what changed of the actuators, for maps and tables."""
    if isinstance(c, Change):
        return c.layers
    layers = []
    for key, name in (("alpha", "alpha"), ("sensor", "sensor gain")):
        change, error = (100 * getattr(c, f"{key}_ratio{of}") for of in ("", "_error"))
        change = change - 100
        # One large change shall not hide the others, and noise shall be pale.
        reach = float(max(np.nanpercentile(np.abs(change), 95.0), 6.0 * np.nanmedian(error))) or 1.0
        meaning = f"New over old {name}, relative to the mean of those that did not change."
        layers.append(
            Layer(key, f"change of {name}", "%", change, meaning, error, centre=0.0, reach=reach)
        )
    return tuple(layers)


CHANGES = TableFormat(
    "CHANGES",
    (
        ID,
        X,
        Y,
        NZ,
        Column("ALPHA", "alpha_ratio"),
        Column("E_ALPHA", "alpha_ratio_error"),
        Column("A_CHANGE", "alpha_changed", kind="bool"),
        Column("GAIN", "sensor_ratio"),
        Column("E_GAIN", "sensor_ratio_error"),
        Column("G_CHANGE", "sensor_changed", kind="bool"),
    ),
)
COMPARISON = FileFormat(
    (
        INSTRUMENT,
        Keyword("DATE-OBS", "date", "UTC, of the old data", kind="date"),
        Keyword("DATE-END", "date_end", "UTC, of the new data", kind="date"),
        Keyword("COMMON", "common", "common factor, new over old"),
        Keyword("E_COMMON", "common_error", "standard uncertainty of COMMON"),
        Keyword("ASCATTER", "alpha_scatter", "scatter of alpha of the others"),
        Keyword("GSCATTER", "sensor_scatter", "scatter of sensor gains of the others"),
        Keyword("NOISELAW", "noise_law", "elements, modes, shapes, or both", kind="str"),
        Keyword("NOISE", "relative_noise", "rms residual over rms element"),
        Keyword("PATTERN", "pattern", "largest pattern of the residual over noise"),
        Keyword("TAILS", "tails", "excess kurtosis of the residual"),
        Keyword("RESEMBLE", "resemblance", "sigmas by which changes of alpha and gain agree"),
        Keyword("EXCESS", "excess", "rms residual over that of the repeat", absent=np.nan),
        Keyword("CONVERGE", "converged", "the fit converged", kind="bool"),
        Keyword("VERDICT", lambda c: str(c.verdict.level), "on the stated errors", kind="str"),
    ),
    (
        CHANGES,
        TableFormat(
            "COUPLINGS",
            (
                Column("ACTUATOR", "0", kind="int"),
                Column("SENSOR", "1", kind="int"),
                Column("CHANGE", "2"),
            ),
            of="couplings",
            optional=True,
        ),
        TableFormat(
            "MATCHING",
            (
                Column("WHAT", "0", kind="str"),
                Column("ACTUATOR", "1", kind="int"),
                Column("PLACE", "2", kind="int"),
            ),
            of="matching.rows",
            optional=True,
        ),
    ),
)


FORMATS[Comparison], OTHER_FORMATS[Comparison] = COMPARISON, TABLES


def read_comparison(path: str | os.PathLike[str]) -> Comparison:
    """Read what `compare -o` wrote as FITS.

    Parameters
    ----------
    path
        The comparison.

    Raises
    ------
    UnreadableFile, FormatError

    Examples
    --------
    >>> tn.compare(matrix_2025, matrix_2026).write("change.fits")
    >>> tn.read_comparison("change.fits")
    <Comparison of P45: 45 actuators, 0 changed>
    """
    file = read_fits(path)
    values = file.values(COMPARISON)
    values["layout"]["enabled"] = file.enabled(values["alpha_ratio"], "compare again")
    rows = values.pop("matching", {"rows": {}})["rows"]
    values["matching"] = Matching.of(zip(*rows.values(), strict=True))
    couplings = values.get("couplings", {}).values()
    values["couplings"] = tuple(
        (int(i), int(j), float(size)) for i, j, size in zip(*couplings, strict=True)
    )
    return file.filled(Comparison, values)
