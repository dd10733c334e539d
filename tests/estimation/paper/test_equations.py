"""The systems C, D and E compared with eqs. 3 and 4 of the paper, element by element."""

import dataclasses
import importlib
import pkgutil
import re
from pathlib import Path

import numpy as np
import pytest
import scipy.linalg

from helpers.balanced import arms_of, campaign_of, three_loads
from truenewton import arrays, estimation
from truenewton.estimation.paper.equations import Unknowns, load_force, system_c, system_d, system_e
from truenewton.estimation.paper.svd import from_rows
from truenewton.statics.arms import enabled_arms


def paper_e(campaign):
    """Return eq. 4 of the paper, computed element by element."""
    x, y, nz = campaign.layout.x, campaign.layout.y, campaign.layout.nz
    on = np.flatnonzero(campaign.layout.enabled)
    loads = list(campaign.loads)
    unknowns = len(on) + 1 + 2 * len(loads)
    rows, right = [], []
    for place, load in enumerate(loads):
        shapes = [
            c.force[j]
            for c in campaign.cycles
            if c.load.key == load.key
            for j in range(len(c.time))
            if c.valid[j]
        ]
        weight = (campaign.weight + load.added) * np.cos(np.radians(load.tilt))
        for block in range(3):
            for force in shapes:
                row = np.zeros(unknowns)
                for column, i in enumerate(on):
                    row[column] = force[i] * (nz[i], x[i], y[i])[block]
                if block == 0:
                    row[len(on)] = 1.0
                else:
                    row[len(on) + 2 * place + block] = (None, 1.0, -1.0)[block]
                rows.append(-row)
                right.append(weight if block == 0 else 0.0)
    return np.array(rows), np.array(right)


def test_e_equals_that_of_the_paper_in_each_element():
    campaign = three_loads(seed=1, noise=1e-3, disabled=(3,), invalid=(2, 5))
    e, r = system_e(campaign, enabled_arms(campaign.layout))
    by_hand, right = paper_e(campaign)
    assert np.array_equal(e, by_hand)
    assert r == pytest.approx(right, rel=1e-15)


def test_c_is_a_block_of_e_with_the_known_terms_on_the_right():
    campaign, truth = campaign_of(seed=3, noise=1e-3, cycles=1)
    a = enabled_arms(campaign.layout)
    n = a.shape[1]
    e, r = system_e(campaign, a)
    force = campaign.cycles[0].used_force
    weight = campaign.effective_weights[0]
    c, p = system_c(force, a, weight, *truth[n : n + 3])
    rows = 3 * len(force)
    assert np.array_equal(c, e[:rows, :n])
    assert p == pytest.approx(r[:rows] - e[:rows, n:] @ truth[n:], abs=1e-15)


def test_true_alpha_solves_d_under_every_load():
    """D alpha = q: -sum x_i d_i alpha_i = N_y and so on, with P + Q + B for the weight force."""
    campaign, truth = campaign_of(seed=4, noise=0.0)
    a = enabled_arms(campaign.layout)
    n = a.shape[1]
    alpha, bias_force = truth[:n], truth[n]
    assert campaign.loads[1].added < 0.0
    for load_index, load in enumerate(campaign.loads):
        torque_y, torque_x = truth[n + 1 + 2 * load_index : n + 3 + 2 * load_index]
        force = load_force(campaign, load_index)
        d, q = system_d(force, a, campaign.weight, load, bias_force, torque_y, torque_x)
        assert d @ alpha == pytest.approx(q, abs=1e-13)
        assert np.array_equal(d, system_c(force, a, 0.0, 0.0, 0.0, 0.0)[0])
        shapes, weight = len(force), campaign.weight + load.added
        assert q[:shapes] == pytest.approx(np.full(shapes, weight + bias_force), rel=1e-15)
        assert q[shapes : 2 * shapes] == pytest.approx(np.full(shapes, torque_y), rel=1e-15)
        assert q[2 * shapes :] == pytest.approx(np.full(shapes, -torque_x), rel=1e-15)


def test_unknowns_of_p45_have_the_order_of_the_paper():
    unknowns = Unknowns(45, 2, weight_errors=3)
    assert (unknowns.count, unknowns.total) == (50, 53)  # paper, section 3: 50 elements
    order = np.arange(unknowns.total)
    assert order[unknowns.alpha].tolist() == list(range(45))
    assert order[unknowns.bias] == 45
    assert order[unknowns.torques].tolist() == [46, 47, 48, 49]  # M_y, M_x, N_y, N_x
    assert order[unknowns.weights].tolist() == [50, 51, 52]
    assert Unknowns(45, 2).weights == slice(50, 50)


def test_every_name_in_the_table_of_the_papers_equations_exists():
    table = [line for line in estimation.__doc__.splitlines() if line.startswith("    ")]
    equations = [line for line in table if line.split()[0] in ("eq.", "sec.")]
    assert len(equations) == 8
    for line in equations:
        names = re.findall(r"`([\w.]+)`(:?)", line)
        assert names[0][1] == ":"
        for name, is_module in names:
            if is_module:
                inside = (Path(estimation.__file__).parent / name.split(".")[0]).is_dir()
                home = f"truenewton.estimation.{name}" if inside else name
                module = importlib.import_module(home)
            else:
                assert hasattr(module, name), line


def test_every_module_of_the_method_is_listed():
    listed = set(re.findall(r"^    (\w+)  ", estimation.__doc__, flags=re.MULTILINE))
    files = {info.name for info in pkgutil.iter_modules(estimation.__path__)}
    assert listed == files


def test_a_cycle_near_rank_deficiency_is_solved_from_its_rows(monkeypatch):
    """A block after the other is solved as all rows at once."""
    monkeypatch.setattr(arrays, "BLOCK_BYTES", 800)
    campaign, truth = campaign_of(seed=14, noise=1e-3, cycles=1)
    cycle, a = campaign.cycles[0], arms_of(campaign.layout)
    force = cycle.force.copy()
    force[:, 0] *= 1e-7
    cycle = dataclasses.replace(cycle, force=force)
    external = (-2.9, *truth[14:17].tolist())
    matrix, right = system_c(force, a, *external)
    values = scipy.linalg.svdvals(matrix)
    assert 1e5 < values[0] / values[-1] < 1e9
    found = from_rows(cycle, a, external)
    assert found == pytest.approx(scipy.linalg.lstsq(matrix, right)[0], rel=1e-6)
