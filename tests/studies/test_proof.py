"""The proof code of the paper, section 4."""

from dataclasses import replace

import numpy as np
import pytest

from truenewton.errors import GeometryError
from truenewton.estimation.paper import equations
from truenewton.mirrors.known import p45
from truenewton.statics.arms import enabled_arms
from truenewton.statics.layout import layout
from truenewton.studies import proof
from truenewton.studies.proof import balanced_forces, prove


@pytest.mark.parametrize("seed", range(5))
def test_p45_proves_within_twenty_eps_cond(seed):
    proofs = prove(p45(), seed)
    assert [(p.system, p.matrix, p.loaded) for p in proofs] == [
        (system, matrix, loaded)
        for loaded in (False, True)
        for matrix in ("identity", "random")
        for system in ("C", "E")
    ]
    for p in proofs:
        assert p.rank == p.unknowns == (45 if p.system == "C" else 50)
        assert p.ratio <= 20
        assert p.passed


def test_the_first_columns_are_as_given_and_the_last_three_balance():
    a = enabled_arms(p45().layout)
    k = np.array([-2.9, 0.3, 0.2])
    force = balanced_forces(np.eye(42), a, k)
    assert np.array_equal(force[:, :42], np.eye(42))
    assert force @ a.T == pytest.approx(np.tile(-k, (42, 1)), abs=1e-11)


def test_a_wrong_sign_of_a_torque_fails_the_proof(monkeypatch):
    """With B = M = N = 0 the mistake stays hidden: only the loaded half of the proof sees it."""
    right = equations.external_load

    def wrong(weight, bias, torque_y, torque_x):
        return right(weight, bias, torque_y, np.negative(torque_x))

    monkeypatch.setattr(proof, "external_load", wrong)
    proofs = prove(p45(), seed=0)
    assert all(p.passed for p in proofs if not p.loaded)
    assert not any(p.passed for p in proofs if p.loaded)


@pytest.mark.parametrize("count", [7, 20])
def test_a_line_and_one_beside_it_have_a_system_of_short_rank_and_fail(count):
    """The one beside may have any alpha: v = x is 0 on the line, so alpha + v balances as well."""
    x, y = np.zeros(count), np.linspace(-0.1, 0.1, count)
    x[-1], y[-1] = 0.1, 0.05
    proofs = prove(replace(p45(), layout=layout(x, y)), seed=0)
    for p in proofs:
        # A known torque that is not 0 fixes the lone one, which alone bears it; E knows none.
        short = p.system == "E" or not p.loaded
        assert p.rank == p.unknowns - short
        assert p.passed != short
    x[0] = -0.03  # off the conic
    for p in prove(replace(p45(), layout=layout(x, y)), seed=0):
        assert p.rank == p.unknowns
        assert p.passed


LAST_THREE = np.array([0.0, 1, 0, -1, 0.5, 0.6, 0.7]), np.array([1.0, 0, -1, 0, 0.1, 0.1, 0.1])


@pytest.mark.parametrize(
    ("places", "said"),
    [
        (([0.0, 1, 0, 1], [0.0, 0, 1, 1]), "only 4 actuators enabled; enable at least five"),
        (LAST_THREE, "last three actuators are collinear"),
    ],
)
def test_layouts_without_a_proof_are_refused(places, said):
    with pytest.raises(GeometryError, match=said):
        prove(replace(p45(), layout=layout(*places)), seed=0)
