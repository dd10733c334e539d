"""The calibration file (docs/files.md), read back."""

from __future__ import annotations

import numpy as np

from truenewton.calibration.result import Calibration
from truenewton.errors import FormatError, TrueNewtonError, located
from truenewton.estimation.unknowns import Unknowns
from truenewton.files.content import FitsFile
from truenewton.records.source import UsedSource
from truenewton.statics.layout import Layout
from truenewton.statics.load import Load


def is_calibration_file(file: FitsFile) -> bool:
    """Tell a calibration file from the others by its CALIBRATION."""
    return file.holds("CALIBRATION")


def calibration_from(file: FitsFile) -> Calibration:
    """Return the calibration that a file holds."""
    table, lines, sources = file.table("CALIBRATION"), file.table("LOADS"), file.table("SOURCES")

    def number(key: str) -> float:
        value = file.optional_number(key)
        return float("nan") if value is None else value

    alpha = table.column("ALPHA")
    count = Unknowns(alpha.size, lines.rows).count
    images = {name: file.image(name).values() for name in ("COVARIANCE", "SYSTEMATIC")}
    for name, image in images.items():
        if image.shape != (count, count):
            raise FormatError(
                f"{name} has the shape {image.shape}",
                remedy=f"it is square, of {count}: n + 1 + 2 L",
                path=file.path,
                got=image.shape,
                want=(count, count),
            )
    freedom = file.optional_number("DOF")
    tools = lines.column("TOOL", "str") if lines.has("TOOL") else np.full(lines.rows, "")
    try:
        return Calibration(
            instrument=file.text("INSTRUME"),
            date=file.date("DATE-OBS"),
            date_end=file.date("DATE-END"),
            method=file.text("METHOD"),
            scale=file.text("SCALE"),
            layout=Layout(
                id=table.column("ID", "int"),
                x=table.column("X", unit="m"),
                y=table.column("Y", unit="m"),
                nz=table.column("NZ") if table.has("NZ") else np.ones(table.rows),
                enabled=np.isfinite(alpha),
            ),
            loads=tuple(
                Load(str(name).strip(), added, added_error, str(tool).strip() or None, tilt)
                for name, added, added_error, tilt, tool in zip(
                    lines.column("LOAD", "str"),
                    lines.column("ADDED", unit="N").tolist(),
                    lines.column("E_ADDED", unit="N").tolist(),
                    lines.column("TILT", unit="deg").tolist(),
                    tools.tolist(),
                    strict=True,
                )
            ),
            alpha=alpha,
            reading_error=table.column("E_STAT"),
            systematic_error=table.column("E_SYST"),
            cycle_error=table.column("E_CYCLE"),
            covariance=images["COVARIANCE"],
            systematic_covariance=images["SYSTEMATIC"],
            bias_force=number("BIAS"),
            torque_y=lines.column("MY", unit="N m"),
            torque_x=lines.column("MX", unit="N m"),
            weight=number("WEIGHT"),
            weight_error=number("E_WEIGHT"),
            temperature=number("TEMPERAT"),
            shapes_used=file.integer("NSHAPES"),
            rejected=file.integer("NREJECT"),
            invalid=file.integer("NINVALID"),
            condition=number("CONDITIO"),
            rank=file.integer("RANK"),
            noise=number("NOISE"),
            degrees_of_freedom=None if freedom is None else int(freedom),
            chi2=number("CHI2"),
            sources=tuple(
                UsedSource(str(name).strip(), str(digest).strip(), int(rows), int(rejected))
                for name, digest, rows, rejected in zip(
                    sources.column("FILE", "str"),
                    sources.column("SHA256", "str"),
                    sources.column("ROWS", "int"),
                    sources.column("REJECTED", "int"),
                    strict=True,
                )
            ),
        )
    except TrueNewtonError as error:
        raise located(error, file.path) from None
