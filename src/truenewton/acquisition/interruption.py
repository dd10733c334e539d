"""Ctrl-C: once, and the shape under way is finished; twice, and everything stops at once."""

from __future__ import annotations

import contextlib
import signal
import threading
import time
from collections.abc import Iterator
from types import FrameType
from typing import Any

from truenewton.errors import Interrupted

SIGNALS = (signal.SIGINT, signal.SIGTERM)
NAP = 0.05  # [s], after which a sleeper looks whether it shall stop


class Interruption:
    """Notes the first signal, and raises KeyboardInterrupt at the second.

    Signals reach the main thread only; elsewhere nothing is noted.
    """

    def __init__(self) -> None:
        self.asked = False
        self._at_once = False
        self._before: dict[signal.Signals, Any] = {}

    def __enter__(self) -> Interruption:
        if threading.current_thread() is threading.main_thread():
            self._before = {each: signal.signal(each, self._note) for each in SIGNALS}
        return self

    def __exit__(self, *_: object) -> None:
        for each, handler in self._before.items():
            signal.signal(each, handler)

    def _note(self, _number: int, _frame: FrameType | None) -> None:
        if self.asked or self._at_once:
            raise KeyboardInterrupt
        self.asked = True

    def check(self) -> None:
        """Stop here if someone asked.

        Raises
        ------
        Interrupted
        """
        if self.asked:
            raise Interrupted("stopped as asked")

    @contextlib.contextmanager
    def at_once(self) -> Iterator[None]:
        """Let one signal do, where no shape is under way but somebody is waited for."""
        self._at_once = True
        try:
            yield
        except (KeyboardInterrupt, EOFError):
            raise Interrupted("stopped as asked") from None
        finally:
            self._at_once = False

    def sleep(self, seconds: float) -> None:
        """Sleep, but no longer than until someone asks to stop.

        Raises
        ------
        Interrupted
        """
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0:
            self.check()
            time.sleep(min(left, NAP))
        self.check()
