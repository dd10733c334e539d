"""The report tells of the modal basis wherever the data do, and why where they do not."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from helpers.balanced import p45_campaign, p45_matrix
from truenewton.modal import summary as words
from truenewton.modal.findings import compare_modes, find_modes
from truenewton.records.campaign import Campaign
from truenewton.report import findings as module
from truenewton.report.figures import still_figures
from truenewton.report.findings import ModeResiduals, investigate
from truenewton.report.page.page import modal_sections, page

PUPIL = {"diameter": 2.13, "efficiency": 0.51}


@pytest.fixture(scope="module")
def matrix():
    return p45_matrix(0.0)[0]


@pytest.fixture(scope="module")
def by_matrix(matrix):
    return investigate(matrix, "svd", **PUPIL)


def sections(findings):
    return {part.key: part for part in modal_sections(findings)}


def told(campaign, change):
    """Return the sections of a campaign whose cycles were changed."""
    found = investigate(Campaign(tuple(map(change, campaign.cycles))))
    assert found.calibration is not None
    assert found.modes is None
    assert "modes" not in still_figures(found)
    return sections(found)


def check_table(table, cost, others):
    """Compare the table with forces and powers of the modes themselves."""
    numbers = [int(row[0]) for row in table.rows]
    assert numbers[-1] == cost.residual.size
    assert numbers == sorted(set(numbers))
    for number, row in zip(numbers, table.rows, strict=True):
        k = number - 1
        left = [1e9 * each.residual[k] for each in (cost, *others)]
        force, power = 1e3 * cost.force[:, k], cost.power[:, k]
        assert [float(cell) for cell in row[1:4]] == pytest.approx(left, rel=1e-3)
        forces = [np.sqrt(np.mean(force**2)), force.max()]
        assert [float(cell) for cell in row[4:6]] == pytest.approx(forces, rel=6e-3)
        powers = [power.mean(), power.max(), power.sum()]
        assert [float(cell) for cell in row[6:9]] == pytest.approx(powers, rel=6e-2)
    assert len(table.head) == len(table.rows[0])


def test_cycles_with_positions_tell_their_modes(p45_findings):
    found = find_modes(p45_campaign(2), p45_findings.calibration, **PUPIL)
    parts = sections(p45_findings)
    assert list(parts) == ["modes", "turbulence", "dissipation"]
    check_table(parts["dissipation"].tables[0], found.after.costs[0], found.after.costs[1:])
    words = " ".join(parts["modes"].words)
    stiffness = found.after.modes.stiffness
    ends = f"{stiffness[3] / 1e3:.1f} kN/m to {stiffness[-1] / 1e6:.1f} MN/m"
    assert f"45 modes. Elastic modes: {ends}" in words
    assert f"{np.degrees(found.comparison.distance):.2g} deg rms" in words
    assert "Measured stiffness: 90 shapes (counted for each load), 360 rows; uncertainty" in words
    [faults] = parts["modes"].tables
    for row, name in zip(faults.rows, ("asymmetry", "imbalance"), strict=True):
        for cell, base in zip(row[1:], (found.before, found.after), strict=True):
            value = getattr(base.stiffness, name)
            assert float(cell.removesuffix(" %")) == pytest.approx(100 * value, rel=0.05)
    assert "seeing 0.8 arcsec" in parts["turbulence"].words[0]
    assert "Static forces of the actuators: -" in parts["dissipation"].words[0]


def test_a_stiffness_file_has_modes_for_rows_but_no_weight(matrix, by_matrix):
    residuals = by_matrix.evidence.residuals
    assert isinstance(residuals, ModeResiduals)
    assert len(residuals.stiffness) == 42
    assert residuals.after.max() < 1e-6 < residuals.before.min()
    assert by_matrix.evidence.balance[0].what == "all modes, fitted"
    parts = sections(by_matrix)
    base = find_modes(matrix, by_matrix.calibration, **PUPIL).after
    check_table(parts["dissipation"].tables[0], base.costs[0], base.costs[1:])
    assert not any("Measured stiffness" in words for words in parts["modes"].words)
    assert "assumed 0" in parts["dissipation"].words[0]
    text = page(by_matrix)
    for title in ("Residuals by mode", "Stiffness modes", "Turbulence", "Dissipation"):
        assert title in text
    assert "modes-power" in still_figures(by_matrix)
    before, _ = (line for line in by_matrix.plot("residuals").lines if len(line.get_xdata()) > 2)
    assert np.asarray(before.get_xdata()).min() > 1
    assert before.axes.get_xscale() == before.axes.get_yscale() == "log"


def test_the_maps_hold_each_chosen_mode_at_its_place(p45_findings):
    ax, layout = p45_findings.plot("modes"), p45_findings.calibration.layout
    [dots] = ax.collections
    part, (x, y) = np.asarray(dots.get_array()), np.asarray(dots.get_offsets()).T
    chosen = [0, 1, 2, 3, 4, 5, 6, 7, 11, 18, 28, 44]
    *titles, colours, view = [text.get_text() for text in ax.texts]
    assert view == "seen along -z"
    assert "purple -1, brown +1" in colours
    assert [int(title.split(":")[0]) for title in titles] == [k + 1 for k in chosen]
    assert len(part) == 45 * len(chosen)
    for place, k in enumerate(chosen):
        mode = p45_findings.modes.after.modes.modes[:, k]
        some = slice(45 * place, 45 * (place + 1))
        assert part[some] == pytest.approx(mode / np.abs(mode).max(), abs=1e-6)
        for drawn, own in ((x, layout.x), (y, layout.y)):
            apart = drawn[some] - 1e3 * own
            assert np.ptp(apart) < 1e-3  # moved as a whole [mm]
    softest = p45_findings.modes.after.modes.stiffness[3] / 1e3
    assert titles[3] == f"4: {softest:.1f} kN/m"


def test_the_curves_are_those_of_the_three_bases(p45_findings):
    costs = p45_findings.modes.after.costs
    drawn = {
        "modes-residual": [1e9 * cost.residual[:-1] for cost in costs],
        "modes-power": [f(cost.power, axis=0) for cost in costs for f in (np.max, np.mean)],
    }
    for name, wanted in drawn.items():
        ax = p45_findings.plot(name)
        curves = [line for line in ax.lines if len(line.get_xdata())]
        for line, values in zip(curves, wanted, strict=True):
            assert line.get_ydata() == pytest.approx(values, rel=1e-6)
            assert line.get_xdata().tolist() == list(range(1, len(values) + 1))
        legend = [text.get_text() for text in ax.get_legend().get_texts()]
        assert legend[:3] == [cost.base for cost in costs]


def test_what_the_data_lack_for_modes_is_said(p45_findings, monkeypatch):
    parts = told(p45_campaign(2), lambda cycle: replace(cycle, position=None))
    assert list(parts) == ["modes"]
    assert parts["modes"].figure == ""
    [words] = parts["modes"].words
    assert words.startswith("Stiffness modes are not shown. No cycle contains POSITION, so")
    assert words.endswith(", or give a measured stiffness file.")
    motion = p45_findings.modes.after.modes.modes[:, 6]

    def without_it(cycle):
        position = np.asarray(cycle.position)
        return replace(cycle, position=position - np.outer(position @ motion, motion))

    parts = told(p45_campaign(2), without_it)
    assert "1 of 42 elastic motions are missing" in parts["modes"].words[0]
    monkeypatch.setattr(module, "MAX_MODES", 44)
    parts = told(p45_campaign(2), lambda cycle: cycle)
    (words,) = parts["modes"].words
    assert words.startswith("Stiffness modes are not shown. Those of 45 actuators take minutes.")


@pytest.mark.parametrize(
    ("value", "text"),
    [(-21.9, "-22 N/m"), (999.4, "1.0 kN/m"), (4632.0, "4.6 kN/m"), (110e3, "110 kN/m"),
     (8.99e6, "9.0 MN/m"), (0.0, "0 N/m")],
)  # fmt: skip
def test_a_stiffness_reads_in_its_unit(value, text):
    assert words.stiffness_text(value) == text


def test_equal_modes_are_not_told_apart():
    compared = compare_modes(np.eye(4), np.eye(4)[:, ::-1], np.ones(4))
    alike = SimpleNamespace(compares=True, comparison=compared)
    assert words.comparison_text(alike).startswith("the same subspace: all")
