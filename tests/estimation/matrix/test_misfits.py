"""Actuators of a stiffness matrix that are off or do not fit are reported and excluded."""

from dataclasses import replace

import numpy as np
import pytest

from helpers.balanced import START, p45_bench, p45_matrix
from studies.simulated_matrices import by_glass, by_plate, drawn, hexagon, springs
from studies.simulated_matrices import measured as with_noise
from truenewton.bench.simulated.static import static_bench
from truenewton.calibration.methods import calibrate
from truenewton.calibration.summary import summary_rows
from truenewton.errors import RankDeficient, TrueNewtonWarning
from truenewton.estimation.matrix import modes as matrix_modes
from truenewton.estimation.matrix.couplings import pair_ratios, relative_couplings
from truenewton.estimation.matrix.facts import MatrixFacts
from truenewton.estimation.matrix.misfits import condensed
from truenewton.estimation.matrix.modes import column_fit, columns_of, likeliest
from truenewton.estimation.matrix.order import row_order
from truenewton.estimation.matrix.screen import screen_matrix
from truenewton.estimation.reciprocity import matrix as reciprocity_of_matrix
from truenewton.estimation.reciprocity.regression import odd_actuators
from truenewton.mirrors.known import mmt336, ring
from truenewton.records.stiffness_matrix import StiffnessMatrix
from truenewton.statics.arms import comparable_arms

BAD = 20


def measured(change):
    """Return the matrix of P45 with a relative noise of 1e-4 and one change, and its alpha."""
    matrix, alpha = p45_matrix()
    x, y, k = matrix.layout.x, matrix.layout.y, np.array(matrix.stiffness)
    change(k, np.argsort(np.hypot(x - x[BAD], y - y[BAD]))[1])
    return replace(matrix, stiffness=k), alpha


def times(factor, *at):
    """Return what multiplies elements of a matrix: a row, a column, an element."""

    def change(k, _):
        k[at] *= factor

    return change


def sensor_noise(k, _):
    """Give a sensor a quarter of its gain, and 30 % noise: its column is useless."""
    k[:, BAD] *= 4.0 * (1.0 + 0.3 * np.random.default_rng(8).standard_normal(len(k)))


def exchanged(k, other):
    k[[BAD, other]] = k[[other, BAD]]


def off(k, _):
    """Switch an actuator off while the others are measured."""
    good = np.arange(len(k)) != BAD
    k[np.ix_(good, good)] = condensed(k, good)[0]
    k[BAD] = k[:, BAD] = 0.0


def large_element(k, other):
    """Make one element so large that rows seem exchanged."""
    k[BAD, other] *= 100.0


def identity_row(k, _):
    """Put a row of the identity in the place of one that was not measured."""
    k[BAD] = np.eye(len(k))[BAD]


def copied_row(k, other):
    k[BAD] = k[other]


@pytest.mark.parametrize("method", ["svd", pytest.param("ml", marks=pytest.mark.study)])
@pytest.mark.parametrize(
    ("change", "said", "where"),
    [
        (times(-1.0, BAD), "wrong sign", [BAD]),
        (times(-1.0, slice(None), BAD), "its sensor has the other sign", [BAD]),
        (times(10.0, BAD), "its row 9.1 times as large as those of others", [BAD]),
        (times(1.2, BAD, BAD), "an element of its row is wrong", [BAD]),
        (large_element, "an element of its row is wrong", [BAD]),
        (times(2.0, slice(None), BAD), "its sensor gain is an outlier", [BAD]),
        (sensor_noise, "its sensor reads something else", [BAD]),
        (exchanged, "its row or column exchanged with another", [BAD - 1, BAD]),
        (off, "actuator is off", [BAD]),
        (times(0.0, [3, 9, BAD]), "its row is empty or a copy, though it pushed", [3, 9, BAD]),
        (times(0.0, BAD, BAD), "an element of its row is wrong", [BAD]),
        (identity_row, "its row is empty or a copy, though it pushed", [BAD]),
        (copied_row, "its row is empty or a copy, though it pushed", [BAD]),
        (times(-1.0, slice(30, 34)), "wrong sign", [30, 31, 32, 33]),
    ],
)
def test_misfits_are_excluded_and_the_others_calibrated(method, change, said, where):
    matrix, alpha = measured(change)
    calibration = calibrate(matrix, method)
    out = ~calibration.layout.enabled
    assert np.flatnonzero(out).tolist() == where
    assert np.isnan(calibration.alpha[out]).all()
    assert all(said in effect.name and effect.corrected for effect in calibration.effects)
    named = sorted(i for effect in calibration.effects for i in effect.actuators)
    assert named == matrix.layout.id[where].tolist()
    check_errors(calibration, alpha, out)


def test_copies_of_a_neighbour_that_hide_both_actuators_are_refused_by_name():
    """Rows and columns are equal, so neither of the two was measured."""

    def copied(k, other):
        k[BAD] = k[other]
        k[:, BAD] = k[:, other]

    matrix, _ = measured(copied)
    with pytest.raises(RankDeficient, match=r"actuators 20 and 21 .* empty or copies, but pushed"):
        calibrate(matrix, "svd")


def check_errors(calibration, alpha, out):
    """Check alpha of the other actuators against its errors."""
    z = (calibration.alpha - alpha / alpha[~out].mean())[~out] / calibration.error[~out]
    assert np.sqrt(np.mean(z**2)) < 1.6


@pytest.mark.parametrize(
    ("at", "off"),
    [
        (0, (1.0, 0.0)),
        pytest.param(12, (0.0, 0.02), marks=pytest.mark.study),
        pytest.param(23, (-0.03, 0.1), marks=pytest.mark.study),
    ],
)
def test_a_misplaced_actuator_is_excluded_and_the_others_calibrated(at, off):
    """Declared X and Y are wrong, for the innermost of 24 actuators, a middle one and the last."""
    truth, random = static_bench(ring(24), 3).truth, np.random.default_rng(at)
    k = truth.stiffness / truth.alpha[:, None]
    k = k * (1.0 + 1e-3 * random.standard_normal(k.shape))
    here = np.arange(24) == at
    declared = replace(
        truth.layout, x=truth.layout.x + here * off[0], y=truth.layout.y + here * off[1]
    )
    found = calibrate(StiffnessMatrix("R24", START, declared, k), "ml")
    assert np.flatnonzero(np.isnan(found.alpha)).tolist() == [at]
    fault, remedy = found.verdict.faults[0].fault, found.verdict.faults[0].remedy
    assert (
        f"excluded actuator {at + 1}: not at its X and Y, up to {np.hypot(*off):.2g} m off" in fault
    )
    assert remedy.startswith("correct X and Y")
    check_errors(found, truth.alpha, here)


def test_a_symmetrised_matrix_is_rejected():
    """It does not separate alpha from sensor gains: the error is 7 %, and 3 % would be stated."""
    matrix, _ = p45_matrix()
    made = replace(matrix, stiffness=0.5 * (matrix.stiffness + matrix.stiffness.T))
    with pytest.warns(TrueNewtonWarning, match="STIFFNESS is symmetric"):
        calibration = calibrate(made, "auto")
    assert (calibration.verdict.level, calibration.method) == ("rejected", "ml")
    [note] = calibration.verdict.notes
    assert "STIFFNESS is symmetric" in note.cause.fault
    assert "use ml" not in str(note)
    assert calibration.sensors == ()
    assert ("sensors", "not estimated") in [row[:2] for row in summary_rows(calibration)]
    for method, remedy in (("svd", "as it was measured"), ("reciprocity", "measured; or use ml")):
        with pytest.raises(RankDeficient, match=f"STIFFNESS is symmetric.*; .*{remedy}"):
            calibrate(made, method)


@pytest.mark.study
def test_noise_alone_does_not_make_alpha_worse_than_no_calibration():
    """With a noise of 600 N/m, soft modes contain only noise: no alpha balances them."""
    truth = p45_bench().truth
    clean = truth.stiffness / truth.alpha[:, None]
    for seed in (1, 2, 6, 8):
        noise = 600 * np.random.default_rng([7, seed]).standard_normal(clean.shape)
        calibration = calibrate(StiffnessMatrix("P45", START, truth.layout, clean + noise))
        error = calibration.alpha - truth.alpha / truth.alpha.mean()
        assert np.std(error) < 0.6 * np.std(truth.alpha / truth.alpha.mean())
        assert calibration.verdict.level != "rejected"


@pytest.mark.parametrize("rows", [1, -1, 2, 7, 22])
def test_a_matrix_with_rows_in_the_wrong_order_is_refused(rows):
    """A shift by 1 or 2 rows is one cycle of all 45."""
    matrix, _ = p45_matrix()
    turned = np.roll(matrix.stiffness, rows, axis=0)
    assert row_order(turned).tolist() == np.roll(np.arange(45), -rows).tolist()
    with pytest.raises(RankDeficient, match="45 of 45 rows of STIFFNESS are not in the order of"):
        screen_matrix(replace(matrix, stiffness=turned))


@pytest.mark.parametrize(
    ("sizes", "said"),
    [
        (lambda k: np.linalg.norm(k, axis=1), "norms of the rows"),
        (lambda k: np.abs(k).sum(axis=1), "absolute sums of the rows"),
        (np.diag, "own elements"),
    ],
)
@pytest.mark.parametrize("kind", [float, np.float32])
def test_a_matrix_of_rows_divided_by_their_size_is_refused(kind, sizes, said):
    """Alpha of each row is lost, and the balance gives another one."""
    matrix, _ = p45_matrix()
    k = (matrix.stiffness / sizes(matrix.stiffness)[:, None]).astype(kind).astype(float)
    with pytest.raises(RankDeficient, match=f"4[0-5] of 45 {said} of STIFFNESS are the same"):
        screen_matrix(replace(matrix, stiffness=k))


@pytest.mark.parametrize("stroke", [1e-6, 1e-5])
def test_forces_at_rest_in_all_columns_are_the_cause(stroke):
    """They leave the balance as it is; a rigid motion costs much, as in a transposed matrix."""
    layout, random = hexagon(3), np.random.default_rng(16)
    k = springs(layout, lambda square: square * np.log(square) / 1500.0)
    k /= 1.0 + 0.02 * random.standard_normal((37, 1))
    rest = 0.02 + 0.05 * random.standard_normal((37, 1))
    [effect] = screen_matrix(StiffnessMatrix("H", START, layout, k + rest / stroke)).effects
    assert effect.code == "forces-at-rest"
    assert effect.remedy.startswith("subtract the forces at rest")
    centre = np.argmin(np.hypot(layout.x, layout.y))
    wrong = k * np.where(np.arange(37) == centre, 3.0, 1.0)
    [effect] = screen_matrix(StiffnessMatrix("H", START, layout, wrong)).effects
    assert effect.actuators == (layout.id[centre],)


def displaced(order):
    """Return a sound matrix with the coordinates of other actuators."""
    matrix, _ = p45_matrix()
    x, y = matrix.layout.x[order], matrix.layout.y[order]
    return replace(matrix, layout=replace(matrix.layout, x=x, y=y))


EVERY = np.arange(45)
RINGS = np.split(EVERY, [9, 24])


@pytest.mark.parametrize(
    ("order", "said"),
    [
        (np.roll(EVERY, 1), ": shifted by 1 row"),
        (np.roll(EVERY, -1), ": shifted by -1 row"),
        (EVERY[::-1], ": reversed"),
        (EVERY.reshape(9, 5).T.ravel(), ": a table of 5 rows, transposed"),
        (np.concatenate(RINGS[::-1]), ": rings from the rim inward"),
        (np.concatenate([ring[::-1] for ring in RINGS]), ": rings "),
        (np.random.default_rng(1).permutation(45), "STIFFNESS"),
    ],
)
def test_the_wrong_order_of_coordinates_is_identified(order, said):
    effect = screen_matrix(displaced(order)).effects[-1]
    assert effect.name.startswith("coordinates in another order than STIFFNESS")
    assert said in effect.name
    assert not effect.corrected


def test_coordinates_in_the_wrong_order_are_rejected():
    with pytest.warns(TrueNewtonWarning, match="rejected"):
        calibration = calibrate(displaced(np.roll(EVERY, 1)), "svd")
    assert calibration.verdict.level == "rejected"
    assert "coordinates in another order" in calibration.verdict.faults[0].fault
    with pytest.raises(RankDeficient, match="another order than STIFFNESS: reversed"):
        calibrate(displaced(EVERY[::-1]))


def test_gains_and_mirrored_coordinates_are_not_a_wrong_order():
    """Sensor gains scatter by 5 %; coordinates are seen from the other side."""
    matrix, _ = p45_matrix()
    gains = 1.0 + 0.05 * np.random.default_rng(2).standard_normal(45)
    assert screen_matrix(replace(matrix, stiffness=matrix.stiffness * gains)).effects == ()
    mirrored = replace(matrix, layout=replace(matrix.layout, x=-matrix.layout.x))
    assert screen_matrix(mirrored).effects == ()
    assert calibrate(mirrored, "svd").alpha == pytest.approx(
        calibrate(matrix, "svd").alpha, rel=1e-9
    )


def test_an_actuator_with_zero_elements_that_exerted_force_is_excluded():
    def zero(k, _):
        k[BAD] = k[:, BAD] = 0.0

    matrix, alpha = measured(zero)
    calibration = calibrate(matrix, "ml")
    out = ~calibration.layout.enabled
    assert np.flatnonzero(out).tolist() == [BAD]
    warning = calibration.diagnosis.warnings[0]
    assert (warning.code, warning.actuators) == ("off-but-pushing", (matrix.layout.id[BAD],))
    check_errors(calibration, alpha, out)


def test_alpha_is_estimated_without_the_columns_of_dead_sensors():
    matrix, alpha = measured(times(0.0, slice(None), [3, 9, BAD]))
    screened = screen_matrix(matrix)
    on = screened.matrix.layout.enabled
    assert np.flatnonzero(~on).tolist() == [3, 9, BAD]
    reasons = {effect.name.partition(": ")[2] for effect in screened.effects}
    assert reasons == {"its sensor reads nothing"}
    found = column_fit(columns_of(screened))
    z = (found.alpha - alpha[on] / alpha[on].mean()) / np.sqrt(np.diag(found.covariance))
    assert np.sqrt(np.mean(z**2)) < 1.6


def test_a_sector_of_wrong_sensor_gains_is_found_without_false_positives():
    layout, stiffness = mmt336().layout, static_bench(mmt336(), 1).truth.stiffness
    random, n = np.random.default_rng(1), layout.n
    k = 0.5 * (stiffness + stiffness.T) / random.normal(1.0, 0.05, n)[:, None]
    k += 2e-4 * np.sqrt(np.mean(k**2)) * random.standard_normal((n, n))
    sector = np.argsort(np.hypot(layout.x - layout.x[150], layout.y - layout.y[150]))[:15]
    k[:, sector] *= 1.5
    screened = screen_matrix(StiffnessMatrix("MMT336", START, layout, k))
    [effect] = screened.effects
    assert sorted(effect.actuators) == sorted(layout.id[sector])
    assert "its sensor gain is an outlier" in effect.name


def test_actuators_that_fit_no_symmetry_are_named():
    """Every sensor among ten reads a mixture of all ten: too many to be left out."""
    matrix, _ = p45_matrix()
    k, random = np.array(matrix.stiffness), np.random.default_rng(18)
    some = slice(10, 20)
    k[:, some] = k[:, some] @ (np.eye(10) + 0.2 * random.standard_normal((10, 10)))
    [kept] = screen_matrix(replace(matrix, stiffness=k)).warnings
    assert kept.code == "misfits-kept"
    assert set(kept.actuators) <= set(matrix.layout.id[some].tolist())
    assert len(kept.actuators) == kept.values["count"] > 4
    assert ", ".join(map(str, kept.actuators[:-1])) in kept.fault


def test_negative_alpha_of_the_balance_does_not_break_reciprocity():
    matrix, _ = p45_matrix()
    screened = screen_matrix(matrix)
    base = matrix_modes.fit_balance(screened, column_fit)
    values = np.where(np.arange(len(base.values)) == BAD, -0.02, base.values)
    found = reciprocity_of_matrix.fit_matrix(screened, replace(base, values=values))[0]
    assert np.isfinite(found.values).all()


def test_a_row_of_rounding_errors_determines_no_alpha():
    k, layout = p45_bench().truth.stiffness.copy(), p45_bench().truth.layout
    k[BAD] *= 1e-9
    modes = MatrixFacts(k, comparable_arms(layout)).elastic_modes.forces.T
    with pytest.raises(RankDeficient, match="of a few actuators alone"):
        likeliest(modes, comparable_arms(layout))


def test_most_diagonal_elements_may_be_zero():
    """Nothing divides by zero; a sensor without diagonal element is not a free sensor."""
    k = p45_bench().truth.stiffness.copy()
    lost = np.arange(33)
    k[lost, lost] = 0.0
    assert np.isfinite(relative_couplings(k)).all()
    for alone in (k, np.diag(k.diagonal() + 1.0)):  # without couplings, too
        assert np.isfinite(pair_ratios(alone)[0]).all()
    assert not np.isin(odd_actuators(k), lost).any()


def test_a_wrong_gain_is_found_among_sensors_off_their_magnets():
    """At 0.5 mm from its magnet, the first sensor reads slopes as a gain error of 10 %."""
    bench, random = p45_bench(), np.random.default_rng([0, 11])
    values = drawn(random, bench.mirror.layout.n, offset=5e-4)
    k = with_noise(random, by_glass(bench.glass, values), values).stiffness
    matrix = StiffnessMatrix("P45", START, bench.mirror.layout, k)
    assert screen_matrix(matrix).effects == ()
    gains = np.where(np.arange(len(k)) == BAD, 1.5, 1.0)
    [effect] = screen_matrix(replace(matrix, stiffness=k * gains)).effects
    assert effect.where == f"actuator {matrix.layout.id[BAD]}"


@pytest.mark.parametrize("n", [6, 18])
def test_small_mirrors_give_an_answer_or_a_clear_refusal(n):
    """With six actuators, the sensors fit all pairs; and a diagonal may be missing altogether."""
    truth, random = static_bench(ring(n), 3).truth, np.random.default_rng(n)
    k = truth.stiffness / truth.alpha[:, None]
    k *= 1.0 + 1e-4 * random.standard_normal(k.shape)
    if n == 6:
        assert np.isfinite(calibrate(StiffnessMatrix("R", START, truth.layout, k)).alpha).all()
    hollow = k - np.diag(np.diag(k))
    for method in ("svd", "ml"):
        with pytest.raises(RankDeficient, match=f"{n} of {n} own elements .* are the same"):
            calibrate(StiffnessMatrix("R", START, truth.layout, hollow), method)


@pytest.mark.parametrize("first", [10, 20])
def test_sound_actuators_are_kept_if_sensors_are_off_their_magnets(first):
    """At 0.5 mm, elements of distant pairs differ from their transposes, also in sign."""
    bench, out = p45_bench(), list[int]()
    for seed in range(first, first + 10):
        random = np.random.default_rng([seed, 11])
        values = drawn(random, 45, offset=5e-4)
        k = by_plate(bench.mirror.layout, bench.truth.stiffness, values)
        k += 2e-4 * np.sqrt(np.mean(k**2)) * random.standard_normal(k.shape)
        matrix = StiffnessMatrix("P45", START, bench.mirror.layout, k)
        out += [seed] * bool(screen_matrix(matrix).effects)
    assert out == []
