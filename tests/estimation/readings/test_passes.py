"""Rows of a campaign are read twice: once for screening, and once for all results."""

import pytest

from helpers.balanced import campaign_of, changed, with_spike
from truenewton.bench.simulated.static import run_cycles, static_bench
from truenewton.calibration.methods import calibrate
from truenewton.estimation.readings import rows as rows_of_groups
from truenewton.estimation.readings.rows import BalancedRows
from truenewton.mirrors.known import p45
from truenewton.modal.findings import find_modes
from truenewton.recalibration.fit import recalibrate
from truenewton.records.campaign import Campaign
from truenewton.records.cycle import Cycle
from truenewton.report.findings import investigate


@pytest.fixture
def passes(monkeypatch):
    """Return a function that counts rows of FORCE read by a step, per row of the campaign."""

    def counted(campaign, step):
        forces, taken = {id(c.force) for c in campaign.cycles}, []

        def counting(used):
            def counted(reader, values, rows):
                chosen = used(reader, values, rows)
                taken.append(len(chosen) if id(values) in forces else 0)
                return chosen

            return counted

        with monkeypatch.context() as patch:
            for reader in (Cycle, BalancedRows):
                patch.setattr(reader, "used", counting(reader.used))
            step(campaign)
        return sum(taken) / sum(int(c.valid.sum()) for c in campaign.cycles)

    return counted


@pytest.fixture(scope="module")
def campaign():
    return Campaign(tuple(run_cycles(static_bench(p45(), 1), 4)))


def test_every_command_reads_the_rows_of_a_sound_campaign_twice(campaign, passes):
    calibration = calibrate(campaign)
    assert passes(campaign, calibrate) == 2.0
    assert passes(campaign, investigate) == 2.0
    assert passes(changed(campaign, position=None), investigate) == 2.0
    assert passes(campaign, find_modes) == 2.0
    assert passes(campaign, lambda data: find_modes(data, calibration)) == 2.0
    assert passes(campaign, lambda data: recalibrate(data, calibration, [17])) == 2.0


def test_only_blocks_with_rejected_rows_are_read_again(passes, monkeypatch):
    monkeypatch.setattr(rows_of_groups, "ROWS_AT_ONCE", 4)  # of 56 groups
    sound, _ = campaign_of(seed=3, noise=1e-4, cycles=4)
    campaign = with_spike(sound, 2, 9, 5, 0.05)
    [row] = calibrate(campaign).rejected_rows
    assert (row.cycle, row.row, row.against) == (2, 9, "repeats")
    assert passes(campaign, calibrate) < 2.0 + 2 * 4 / 56
    assert passes(campaign, investigate) < 2.0 + 2 * 4 / 56
