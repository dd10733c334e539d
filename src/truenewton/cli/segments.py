"""Data of several segments: a command runs for one after the other, each with its own outputs."""

from __future__ import annotations

import contextlib
import functools
import io
import json
import re
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from truenewton.cli import options
from truenewton.cli.terminal import print_result, refuse, tell, told
from truenewton.errors import Interrupted, SeveralSegments, TrueNewtonError

if TYPE_CHECKING:
    from truenewton.statics.layout import Layout

OUTPUTS = "output", "figure", "figures"
IDS = "exclude", "actuators", "off", "slaved"  # of actuators of the whole mirror
ENDING = re.compile(r"(?P<stem>.+?)(?P<ending>\.[a-z]\w*(\.gz)?)?", re.IGNORECASE)


def each_segment(command: Callable[..., Any]) -> Callable[..., Any]:
    """Return a command that takes each segment in turn, if its data are of several.

    A segment that is refused does not stop the others; the exit code is the worst.
    """

    @functools.wraps(command)
    def run(**given: Any) -> Any:
        try:
            return command(**given)
        except SeveralSegments as several:
            if given["segment"] is not None:
                raise
            segments = several.segments
        return _in_turn(command, given, segments)

    return run


def _in_turn(
    command: Callable[..., Any], given: Mapping[str, Any], segments: Mapping[int, Layout]
) -> int:
    """Run a command for each segment; with ``json`` print one object with the results of all."""
    from numpy.linalg import LinAlgError

    code, results = 0, list[dict[str, Any]]()
    for number in segments:
        own = {name: _own(name, value, number, segments) for name, value in given.items()}
        if not (given.get("json") or given["quiet"]):
            tell([f"segment {number}"])
        out = io.StringIO() if given.get("json") else sys.stdout
        try:
            with contextlib.redirect_stdout(out):
                command(**own | {"segment": number})
            if isinstance(out, io.StringIO):
                results.append({"segment": number, "result": json.loads(out.getvalue())})
        except Interrupted:
            raise
        except (TrueNewtonError, ArithmeticError, RuntimeWarning, LinAlgError) as error:
            results.append({"segment": number, "error": told(error)})
            code = refuse(f"segment {number}: {told(error)}")
    if given.get("json"):
        print_result((), values={"segments": results}, schema="segments", json=True)
    return code


def _own(name: str, value: Any, number: int, segments: Mapping[int, Layout]) -> Any:
    """Return the value of an option for one segment: its files and its actuators."""
    if isinstance(value, list):
        return [_own(name, each, number, segments) for each in value]
    if isinstance(value, Path):
        return value if name not in OUTPUTS and value.exists() else numbered_path(value, number)
    if name in IDS and value:
        names = {k: {*each.id.tolist(), *each.names.tolist()} for k, each in segments.items()}
        others = set().union(*names.values()) - names[number]
        return ",".join(str(one) for one in options.ids(value, name) if one not in others)
    return value


def numbered_path(path: Path, number: int) -> Path:
    """Return the name of a file or folder of one segment, as alpha-3.fits of alpha.fits."""
    parts = ENDING.fullmatch(path.name)
    assert parts is not None
    return path.with_name(f"{parts['stem']}-{number}{parts['ending'] or ''}")
