"""A matrix that balances with alpha = 1: rigid-body modes were removed, or it is a true one."""

from dataclasses import replace

import numpy as np
import pytest

from helpers.balanced import START, p45_bench, p45_matrix
from truenewton.errors import TrueNewtonWarning
from truenewton.estimation.findings.code import Code
from truenewton.estimation.matrix.facts import MatrixFacts
from truenewton.estimation.matrix.order import balance_effects
from truenewton.estimation.matrix.screen import screen_matrix
from truenewton.estimation.reciprocity.acceptance import Evidence, instead, refusals
from truenewton.importers.importing import stiffness_from
from truenewton.modal.findings import find_modes
from truenewton.records.stiffness_matrix import StiffnessMatrix
from truenewton.statics.arms import comparable_arms


def cleaned(k, rigid):
    """Return (n, n) k without (n, 3) rigid-body modes on both sides, and of forces only."""
    rigid = np.linalg.qr(rigid)[0]
    forces = k - rigid @ (rigid.T @ k)
    return forces - (forces @ rigid) @ rigid.T, forces


def written(k, digits):
    """Return (n, n) k rounded to significant digits."""
    return np.array([[float(f"{each:.{digits}g}") for each in row] for row in k])


CLEANED_WAYS = {
    "both": lambda k, rigid: cleaned(k, rigid)[0],
    "forces": lambda k, rigid: cleaned(k, rigid)[1],
    "single precision": lambda k, rigid: cleaned(k, rigid)[0].astype(np.float32).astype(float),
    "four decimals": lambda k, rigid: 1e2 * np.round(cleaned(k, rigid)[0] / 1e2),
    "three decimals": lambda k, rigid: 1e3 * np.round(cleaned(k, rigid)[1] / 1e3),
    "three digits": lambda k, rigid: written(cleaned(k, rigid)[0], 3),
    "four digits": lambda k, rigid: 1e6 * written(1e-6 * cleaned(k, rigid)[1], 4),
    "six digits": lambda k, rigid: written(cleaned(k, rigid)[1], 6),
    "symmetric": lambda k, rigid: cleaned(0.5 * (k + k.T), rigid)[0],
    "symmetric, three": lambda k, rigid: 1e3 * np.round(cleaned(0.5 * (k + k.T), rigid)[0] / 1e3),
    "symmetric, digits": lambda k, rigid: written(cleaned(0.5 * (k + k.T), rigid)[0], 3),
}


def rigid_motions(of):
    return np.stack([of.nz, of.x, of.y], axis=1)[of.enabled]


@pytest.mark.parametrize("way", CLEANED_WAYS)
def test_a_matrix_without_rigid_body_modes_is_recognised(way):
    """It balances with alpha = 1 (truth: 0.7 .. 1.1). The remedy is not to transpose it."""
    matrix, _ = p45_matrix()
    k = CLEANED_WAYS[way](matrix.stiffness, rigid_motions(matrix.layout))
    balanced = replace(matrix, stiffness=k)
    [effect] = screen_matrix(balanced).effects
    assert effect.code == (Code.TRUE_STIFFNESS if "symmetric" in way else Code.CLEANED_STIFFNESS)
    assert effect.remedy == "give the matrix as it was measured"
    made = stiffness_from(k, matrix.layout, unit="N/m")
    assert (made.balanced, made.transposed) == (True, False)
    assert "rigid-body modes" in repr(made)
    assert "TRANSPOSED" not in repr(made)


@pytest.mark.parametrize("digits", [None, 3e4, 3, 5])
@pytest.mark.parametrize("noise", [1e-6, 1e-3])
def test_calibrated_forces_are_not_mistaken_for_cleaned_forces(noise, digits):
    """Alpha has been loaded into the electronics. The remaining imbalance is that of noise."""
    truth, random = p45_bench().truth, np.random.default_rng(3)
    right = 1.0 + 3e-4 * random.standard_normal(45)
    k = truth.stiffness * (1.0 + noise * random.standard_normal((45, 45))) / right[:, None]
    if digits is not None:
        k = written(k, digits) if digits < 10 else digits * np.round(k / digits)
    assert not [*balance_effects(MatrixFacts(k, comparable_arms(truth.layout)))]


def test_a_matrix_with_cleaned_displacements_still_determines_alpha():
    """Removing rigid-body motions from readings does not change forces. Transposed, it is found."""
    matrix, _ = p45_matrix()
    k = cleaned(matrix.stiffness.T, rigid_motions(matrix.layout))[1].T
    assert screen_matrix(replace(matrix, stiffness=k)).effects == ()
    [effect] = screen_matrix(replace(matrix, stiffness=k.T)).effects
    assert effect.code == Code.TRANSPOSED_STIFFNESS


def test_modes_of_a_true_stiffness_use_alpha_1():
    """Alpha scatters by 1.5 % in a symmetrised matrix, so that the balance alone gives others."""
    truth = p45_bench().truth
    k = truth.stiffness / (1.0 + 0.015 * np.random.default_rng(6).standard_normal(45))[:, None]
    k = 0.5 * (k + k.T)
    with pytest.warns(
        TrueNewtonWarning, match="symmetric and balances with alpha = 1: a true stiffness"
    ):
        found = find_modes(StiffnessMatrix("P45", START, truth.layout, k))
    assert (found.calibration.alpha[truth.layout.enabled] == 1.0).all()
    [warning] = found.warnings
    assert "treated as a true one" in warning.fault
    assert "alpha is 1" in warning.fault
    assert found.imbalance[0] == found.imbalance[1]


def test_every_command_reports_a_cleaned_matrix(inside, tmp_path):
    matrix, _ = p45_matrix()
    rigid, svd = rigid_motions(matrix.layout), ("--method", "svd")
    k = cleaned(matrix.stiffness, rigid)[1]
    np.save(tmp_path / "k.npy", k)
    np.savetxt(tmp_path / "xy.csv", rigid[:, 1:], delimiter=",", header="X,Y", comments="")
    code, out, _ = inside(
        "import", tmp_path / "k.npy", tmp_path / "xy.csv", "--unit", "N/m", "--lengths", "m",
        "-o", tmp_path / "k.fits",
    )  # fmt: skip
    assert code == 0
    assert "  balance      " in out
    assert "next" not in out
    assert "LOOKS TRANSPOSED" not in out
    err = inside.refuses("calibrate", tmp_path / "k.fits", *svd, "-o", tmp_path / "alpha.fits")
    said = "STIFFNESS already balances with alpha = 1, so it contains no information on alpha"
    assert said in err
    assert not (tmp_path / "alpha.fits").exists()
    out = inside.prints("info", tmp_path / "k.fits", *svd)
    assert said in out
    assert "rejected" in out


@pytest.mark.parametrize(("error", "gross"), [(0.34, True), (0.004, False)])
def test_implausible_errors_of_reciprocity_indicate_a_cleaned_matrix(error, gross):
    """34 %, and 2e-6 % by balance: a cleaned matrix. 0.4 % is normal for unmodelled annuli."""
    evidence = Evidence(as_stated=1e6, error=error, error_by_balance=2e-8)
    [said] = instead(tuple(refusals(evidence)))
    assert (said.code == "reciprocity-not-used") is not gross
    assert ("give it as it was measured" in said.remedy) is gross
    [apart] = instead(tuple(refusals(Evidence(apart=1e3))))
    assert apart.cause.code == "estimates-apart"
