"""Times that only grow, whatever somebody does to the clock of the bench."""

from __future__ import annotations

import datetime
import time

EPOCH = datetime.datetime(1970, 1, 1, tzinfo=datetime.UTC)
MICROSECOND = datetime.timedelta(microseconds=1)
LONGEST_PAUSE = 10**13  # us; a clock that leaps four months between two readings was set


class SteadyClock:
    """Turns times of readings into instants, each later than the one before.

    Parameters
    ----------
    last
        The last instant of the campaign so far [us since 1970, UTC]; None where there is none.

    Attributes
    ----------
    leap
        By how much the bench's clock was found to have been set at the last reading [s], or 0.
    stands
        Whether the bench's clock was found to stand still at the last reading, for the first time;
        while it does, ours counts on.
    """

    def __init__(self, last: int | None = None) -> None:
        self._last, self._offset = last, 0
        self._seen: float | None = None  # when, by our own clock that nobody sets
        self._raw: int | None = None  # what the bench's clock showed last
        self._stood = False
        self.leap, self.stands = 0.0, False

    def go_on_after(self, instant: int) -> None:
        """Let what follows be later than an instant [us since 1970, UTC] too."""
        self._last = instant if self._last is None else max(self._last, instant)

    def instant(self, when: datetime.datetime | None) -> int:
        """Return the instant of a reading [us since 1970, UTC].

        A time without zone is UTC; None, where a reading has no time to be trusted, is now by our
        own clock.
        """
        now = time.monotonic()
        passed = 1000 if self._seen is None else max(1, round((now - self._seen) * 1e6))
        last, self.leap, self.stands = self._last, 0.0, False
        if when is None:
            instant = (
                instant_of(datetime.datetime.now(datetime.UTC)) if last is None else last + passed
            )
        else:
            raw = instant_of(when)
            instant = raw + self._offset
            standing, self._raw = raw == self._raw, raw
            self.stands, self._stood = standing and not self._stood, standing or self._stood
            if last is not None and standing:
                instant = last + passed
            elif last is not None and not 0 < instant - last <= LONGEST_PAUSE:
                # From here the bench's clock counts on from where it was, by our own.
                self.leap = (instant - last - passed) * 1e-6
                instant = last + passed
                self._offset = instant - raw
        self._last, self._seen = instant, now
        return instant


def moment(instant: int) -> datetime.datetime:
    """Return an instant as a date, UTC."""
    return EPOCH + instant * MICROSECOND


def instant_of(date: datetime.datetime) -> int:
    """Return a date as an instant [us since 1970, UTC]; one without zone is UTC."""
    return ((date if date.tzinfo else date.replace(tzinfo=datetime.UTC)) - EPOCH) // MICROSECOND
