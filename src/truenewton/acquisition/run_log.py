"""One log for each run, JSON lines: what was commanded, by which version, on which bench."""

from __future__ import annotations

import contextlib
import datetime
import json
import os
import re
import time
from pathlib import Path
from typing import Any

from truenewton.arrays import jsonable
from truenewton.errors import OutputFailed
from truenewton.files.outputs import in_one_line


class RunLog:
    """Writes events to a new file run-001.jsonl, run-002.jsonl, ... of a campaign's folder.

    Raises
    ------
    OutputFailed
    """

    def __init__(self, folder: Path) -> None:
        with in_one_line(folder):
            numbers = [
                int(name[1])
                for path in folder.iterdir()
                if (name := re.fullmatch(r"run-(\d+)\.jsonl", path.name))
            ]
            self.path = folder / f"run-{max(numbers, default=0) + 1:03d}.jsonl"
            flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_APPEND
            self._handle = os.open(self.path, flags, 0o666)
        self._start = time.monotonic()

    def note(self, event: str, **values: Any) -> None:
        """Write one line.

        Raises
        ------
        OutputFailed
        """
        now = datetime.datetime.now(datetime.UTC).isoformat(timespec="milliseconds")
        elapsed = round(time.monotonic() - self._start, 4)
        line = {"time": now, "elapsed": elapsed, "event": event, **values}
        text = json.dumps(jsonable(line))
        with in_one_line(self.path):
            os.write(self._handle, text.encode() + b"\n")

    def last_words(self, event: str, **values: Any) -> None:
        """Write one line if that can be done: on the way out nothing may stand in the way."""
        with contextlib.suppress(OutputFailed):
            self.note(event, **values)

    def close(self) -> None:
        """Close the file."""
        os.close(self._handle)
