"""Readings with zeros of their own, and noise of another kind than is declared."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import scipy.signal
import scipy.stats

from studies.faulty.bench import Day
from studies.faulty.fault import fault
from studies.faulty.gains import gradients


def common_mode(sigmas: float) -> Callable[[Day], None]:
    """Return that all readings of a row share some noise."""

    def happens(day: Day) -> None:
        day.error = day.error + sigmas * day.noise * day.random.standard_normal((len(day.z), 1))

    return happens


for sigmas in (0.3, 0.5):
    fault(f"noise of the rows in common, {sigmas} sigma", cause="in common")(common_mode(sigmas))


@fault("zeros move at remounting, each 0.5 sigma", cause="zero", blind=True)
def zeros_at_remounting(day: Day) -> None:
    day.zero = 0.5 * day.noise * day.random.standard_normal((len(day.order), day.n))[day.mounting]


fault("zeros move at remounting, loads in turn", cause="zero", order="in turn")(zeros_at_remounting)


@fault("zeros by file, common 0.2 sigma", cause="zero")
def common_zero_by_file(day: Day) -> None:
    day.zero = 0.2 * day.noise * day.random.standard_normal(len(day.order))[day.file, None]


@fault("zeros by file, each 0.5 sigma", cause="zero")
def zeros_by_file(day: Day) -> None:
    day.zero = 0.5 * day.noise * day.random.standard_normal((len(day.order), day.n))[day.file]


@fault("zeros drift, each 0.2 sigma/h rms", cause="zero")
def drift_of_zeros(day: Day) -> None:
    day.zero = 0.2 * day.noise * np.outer(day.hours, day.random.standard_normal(day.n))


@fault("zero 0.1 mN common under the ring", blind=True)
def zero_under_ring(day: Day) -> None:
    day.zero = np.where(day.under(), 0.1e-3, 0.0)


@fault("noise correlated over rows, 0.95", cause="correlat|zero")
def correlated(day: Day) -> None:
    """A first-order autoregression in each file, of the declared variance."""
    memory = 0.95
    for file in range(len(day.order)):
        fresh = np.sqrt(1 - memory**2) * day.error[day.file == file]
        fresh[0] /= np.sqrt(1 - memory**2)
        day.error[day.file == file] = scipy.signal.lfilter([1.0], [1.0, -memory], fresh, axis=0)


@fault("readings scatter four times what FORCERR says", cause="FORCERR|scatter")
def louder(day: Day) -> None:
    day.error = 4.0 * day.error


@fault("readings scatter a quarter of FORCERR", cause="FORCERR|scatter")
def quieter(day: Day) -> None:
    day.error = 0.25 * day.error


@fault("noise of the actuators differs, 0.5 to 2 sigma")
def unlike_noise(day: Day) -> None:
    """No fault: repeats tell the noise of each."""
    day.error = day.error * np.geomspace(0.5, 2.0, day.n)[day.random.permutation(day.n)]
    day.declared["force_error"] = None


@fault("noise of heavy tails, Student 3", cause="tail|left out|rows")
def heavy_tails(day: Day) -> None:
    drawn = scipy.stats.t.rvs(3, size=day.z.shape, random_state=day.random)
    day.error = day.noise * drawn / np.sqrt(3)


@fault("spikes of 20 mN in 5 % of the rows", cause="spike|left out|rows|outlier")
def spikes(day: Day) -> None:
    hit = np.flatnonzero(day.random.random(len(day.z)) < 0.05)
    at = day.random.integers(day.n, size=len(hit))
    day.readings[hit, at] += 20e-3 * day.random.choice([-1, 1], len(hit))


fault("spikes, one cycle", cause="spike|left out|rows|outlier", order="one cycle")(spikes)


@fault("spikes and gradients, one cycle, 10 uN", cause="gradient", noise=1e-5, order="one cycle")
def spikes_and_gradients(day: Day) -> None:
    gradients(day)
    spikes(day)


@fault("a reading that freezes in the middle of a file", cause="frozen|stuck")
def freezes(day: Day) -> None:
    at, rows = day.actuator(), np.flatnonzero(day.file == day.random.integers(len(day.order)))
    day.strike(at, judged=False)
    late = rows[len(rows) // 2 :]
    day.readings[late, at] = day.readings[late[0], at]


@fault("readings cut off at 0.2 N", cause="cut off|limit")
def cut_off(day: Day) -> None:
    day.readings[:] = np.clip(day.readings, -0.2, 0.2)
