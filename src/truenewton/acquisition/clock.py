"""Times that only grow, whatever somebody does to the clock of the bench."""

from __future__ import annotations

import datetime

EPOCH = datetime.datetime(1970, 1, 1, tzinfo=datetime.UTC)
MICROSECOND = datetime.timedelta(microseconds=1)
SHORTEST_STEP = 1000  # us, between two readings whose times cannot both be right
LONGEST_PAUSE = 10**13  # us; a clock that leaves four months between two readings was set


class SteadyClock:
    """Turns times of readings into instants, each later than the one before.

    A clock that was set, or begins anew with each run as that of a simulated bench does, counts on
    from the last instant.

    Parameters
    ----------
    last
        The last instant of the campaign so far [us since 1970, UTC]; None where there is none.
    """

    def __init__(self, last: int | None = None) -> None:
        self._last, self._offset = last, 0

    def go_on_after(self, instant: int) -> None:
        """Let what follows be later than an instant [us since 1970, UTC] too."""
        self._last = instant if self._last is None else max(self._last, instant)

    def instant(self, when: datetime.datetime | None) -> int:
        """Return the instant of a reading [us since 1970, UTC].

        A time without zone is UTC; None, where a reading has no time to be trusted, is just after
        the last instant.
        """
        last = self._last
        if when is not None:
            instant = instant_of(when) + self._offset
            if last is not None and not 0 < instant - last <= LONGEST_PAUSE:
                self._offset += last + SHORTEST_STEP - instant
                instant = last + SHORTEST_STEP
        elif last is not None:
            instant = last + SHORTEST_STEP
        else:
            instant = instant_of(datetime.datetime.now(datetime.UTC))
        self._last = instant
        return instant


def moment(instant: int) -> datetime.datetime:
    """Return an instant as a date, UTC."""
    return EPOCH + instant * MICROSECOND


def instant_of(date: datetime.datetime) -> int:
    """Return a date as an instant [us since 1970, UTC]; one without zone is UTC."""
    return ((date if date.tzinfo else date.replace(tzinfo=datetime.UTC)) - EPOCH) // MICROSECOND
