"""The report's figures for papers show what the page shows, one call each."""

import datetime
import re
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from matplotlib.dates import num2date
from matplotlib.figure import Figure

from helpers import report_data
from helpers.report_data import changed_by, with_sensors
from truenewton.comparison.calibrations import compare_calibrations
from truenewton.figures.style import COLUMN
from truenewton.records.campaign import Campaign
from truenewton.report.figures import figures_of, still_figures
from truenewton.report.findings import investigate


def points(ax):
    return [line for line in ax.lines if len(line.get_xdata()) > 2]


def test_every_call_takes_axes_and_returns_them(p45_findings):
    found = compare_calibrations(*changed_by(12.0))
    names = ("budget", "residuals", "balance", "singular-values", "temperatures", "modes",
             "modes-residual", "modes-power", "modes-comparison", "map-leverage", "map-noise"
    )  # fmt: skip
    calls = [partial(p45_findings.plot, name) for name in names]
    for call in (*calls, found.plot, found.plot_actuators):
        ax = Figure().add_subplot()
        assert call(ax) is ax
    assert p45_findings.plot("budget").get_figure().get_figwidth() == pytest.approx(COLUMN)


def test_the_budget_bars_are_the_errors_in_per_cent(p45_findings):
    ax = p45_findings.plot("budget")
    names = [label.get_text() for label in ax.get_yticklabels()]
    assert names == ["statistical σ_stat (E_STAT)", "scale σ_scale (E_SYST)", "total σ (E_ALPHA)"]
    c = p45_findings.calibration
    errors = (c.statistical_error, c.systematic_error, c.error)
    sizes = [100 * np.median(error / c.alpha) for error in errors]
    assert [bar.get_width() for bar in ax.patches] == pytest.approx(sizes)


def test_residuals_stand_at_their_shape_and_cycle():
    found = investigate(report_data.with_outliers())
    residuals, ax = found.evidence.residuals, found.plot("residuals")
    [image] = ax.images
    shown, (left, right, bottom, top) = image.get_array(), image.get_extent()
    assert (left, right, bottom, top) == (-14.5, 14.5, 8.5, 0.5)
    k = 40
    column = residuals.signed_shape[k] + 14
    assert shown[residuals.cycle[k], column] == pytest.approx(residuals.after[k])
    lost = np.flatnonzero(~residuals.kept)
    assert (lost.tolist(), residuals.cycle[lost].tolist()) == ([0, 1, 2], [0, 0, 0])
    assert residuals.after[lost].min() > 50 > 4 > residuals.after[residuals.kept].max()
    assert image.get_clim() == pytest.approx((0.0, residuals.after[residuals.kept].max()))
    legend = [text.get_text() for text in ax.get_legend().get_texts()]
    assert legend == ["bare", "ring", "rejected row"]
    [crosses] = ax.lines
    assert crosses.get_xdata().tolist() == [1, 2, 3]
    assert crosses.get_ydata().tolist() == [1, 1, 1]


def test_the_balance_before_lies_above_that_after(p45_findings):
    before, after = points(p45_findings.plot("balance"))  # beside the level of noise
    assert len(before.get_xdata()) == len(after.get_xdata()) == 90
    assert np.median(before.get_ydata()) > 5 * np.median(after.get_ydata())
    one = np.flatnonzero(np.asarray(after.get_xdata()) == -7)[0]
    residuals = p45_findings.evidence.residuals
    rows = residuals.signed_shape == -7
    rms = np.sqrt(np.mean(residuals.after[rows] ** 2))
    assert after.get_ydata()[one] == pytest.approx(rms)


def test_temperatures_stand_at_their_time(p45_findings):
    ax = p45_findings.plot("temperatures")
    lines = points(ax)
    assert len(lines) == 4
    cycle = p45_findings.data.cycles[0]
    first = num2date(lines[0].get_xdata(orig=False)[0])
    assert abs(first - cycle.date - datetime.timedelta(seconds=cycle.time[0])) < (
        datetime.timedelta(seconds=1)
    )
    assert lines[0].get_ydata()[0] == pytest.approx(cycle.temperature[0])
    legend = [text.get_text() for text in ax.get_legend().get_texts()]
    assert legend == ["bare", "ring"]


def test_a_change_stands_with_its_name_beyond_the_band():
    found = compare_calibrations(*changed_by(12.0))
    ax = found.plot_actuators()
    [dots] = points(ax)
    assert np.max(dots.get_ydata()) == pytest.approx(12.0, rel=1e-6)
    assert [text.get_text() for text in ax.texts] == ["7"]
    shown = found.plot().collections[1]
    assert shown.get_clim() == pytest.approx((-3 * found.limit, 3 * found.limit))


def test_sensors_are_drawn_where_they_are_known(p45_findings):
    found = investigate(with_sensors(p45_findings.calibration))
    maps = {"map-sensor-gain", "map-sensor-dx", "map-sensor-dy"}
    assert maps <= set(still_figures(found))
    assert not maps & set(figures_of(p45_findings))
    text = (Path(__file__).parents[2] / "docs" / "report.md").read_text(encoding="utf-8")
    names = set(re.findall(r"`([a-z-]+)`", text))
    assert maps | set(figures_of(p45_findings)) <= names
    assert set(still_figures(p45_findings)) <= set(figures_of(p45_findings))
    open_circles, dots = found.plot("map-sensor-dx").collections[:2]
    assert len(open_circles.get_paths()) == 1
    np.testing.assert_allclose(
        dots.get_array(), [1e3 * s.x for s in found.calibration.sensors if s.state == "fitted"]
    )
    assert sum(dots.get_clim()) == 0.0
    # What reciprocity was not asked has no error, and no map.
    calibration = found.calibration
    unasked = tuple(replace(s, x_error=0.0, y_error=0.0) for s in calibration.sensors)
    known = maps & set(still_figures(investigate(replace(calibration, sensors=unasked))))
    assert known == {"map-sensor-gain"}


def test_a_calibration_alone_has_no_residuals_to_draw(p45_findings):
    alone = investigate(p45_findings.calibration)
    with pytest.raises(ValueError, match="contains no residuals"):
        alone.plot("residuals")
    with pytest.raises(ValueError, match="only the cycles of a campaign"):
        alone.plot("temperatures")
    with pytest.raises(ValueError, match="has no modes"):
        alone.plot("modes")
    assert not {"residuals", "modes"} & set(still_figures(alone))


def test_names_with_dollars_are_no_formulas():
    cycles = report_data.fine().cycles
    hostile = [replace(c, load=replace(c.load, name=f"{c.load.name} $x_{{$")) for c in cycles]
    found = investigate(Campaign(tuple(hostile)))
    for name in ("temperatures", "budget"):
        found.plot(name).get_figure().canvas.draw()  # matplotlib raises where a formula has no end
