"""The plate model against published numbers, closed forms, and the laws of statics."""

from dataclasses import replace

import numpy as np
import pytest

from helpers.shells import condense, holding_forces, influence, stiffness, uniform_influence
from truenewton.errors import GeometryError
from truenewton.mirrors.glass import Shell
from truenewton.mirrors.known import lbt672, p45
from truenewton.statics.layout import rings

GLASS = Shell(inner_radius=20e-3, outer_radius=125e-3, thickness=1.6e-3)
COUNTS = np.array([9, 15, 21])
LAYOUT = rings(list(COUNTS * 30.5e-3 / (2 * np.pi)), list(COUNTS))
X, Y = LAYOUT.x, LAYOUT.y
TILTS = np.array([np.ones(LAYOUT.n), X, Y])


@pytest.fixture(scope="module")
def K():
    return stiffness(GLASS, X, Y)


def circle(radius, n, first=0.0):
    angle = first + 2 * np.pi * np.arange(n) / n
    return radius * np.cos(angle), radius * np.sin(angle)


def scattered(n, seed):
    random = np.random.default_rng(seed)
    radius, angle = random.uniform(25e-3, 120e-3, n), random.uniform(0, 2 * np.pi, n)
    return radius * np.cos(angle), radius * np.sin(angle)


def arms(points):
    return np.array([np.ones_like(points[0]), *points])


def balanced(forces, points):
    T = arms(points)
    return forces - np.linalg.pinv(T) @ (T @ forces)


def bent(displacement, points):
    """Take the best rigid motion away."""
    return balanced(displacement, points)


# --- numbers of others -----------------------------------------------------------------------


def test_eigenvalues_of_an_earlier_semi_analytic_model(K):
    """Flat: 5273.6, 15117, 32321, ..., 2.3705e6 N/m, each to its last digit."""
    eigenvalues = np.linalg.eigvalsh(K)
    assert eigenvalues[3:5] == pytest.approx([5273.6, 5273.6], abs=0.05)
    assert eigenvalues[5] == pytest.approx(15117, abs=0.5)
    assert eigenvalues[6] == pytest.approx(32321, abs=1)
    assert eigenvalues[-1] == pytest.approx(2.3705e6, abs=50)


def test_eigenvalues_of_finite_elements_lie_just_above(K):
    """Argyris elements, conforming and so too stiff, 5277 to 2.374e6 N/m."""
    eigenvalues = np.linalg.eigvalsh(K)
    excess = np.array([5277, 2.374e6]) / eigenvalues[[3, -1]] - 1
    assert np.all((excess > 0) & (excess < 2e-3)), excess


def test_elastic_energy_of_a_saddle_is_below_rayleigh():
    """k_n = 4 pi D (1 - nu) n^2 (n^2 - 1) / (R^2 N): exact energy of r^n cos n theta."""
    disc = Shell(inner_radius=1e-4, outer_radius=0.12, thickness=1.6e-3)
    many = rings(list(np.linspace(0.008, 0.1185, 10)), list(6 * np.arange(1, 11)))
    K = stiffness(disc, many.x, many.y)
    D, nu, R = disc.bending_stiffness, disc.poisson_ratio, disc.outer_radius
    ratios = []
    for n in (2, 3, 5, 8):
        saddle = np.real(((many.x + 1j * many.y) / R) ** n)
        rayleigh = 2 * np.pi * (1 - nu) * D * n**2 * (n - 1) / R**2
        ratios.append(saddle @ K @ saddle / rayleigh)
    assert max(ratios) < 1
    assert ratios[0] > 0.97
    assert ratios == sorted(ratios, reverse=True)


# --- closed forms ----------------------------------------------------------------------------


def derivatives(power, log, r):
    """Return r^power (ln r)^log and its first three derivatives."""
    plain, logarithmic = (0.0, 1.0) if log else (1.0, 0.0)
    values = []
    for _ in range(4):
        values.append((plain + logarithmic * np.log(r)) * r**power)
        plain, logarithmic = power * plain + logarithmic, power * logarithmic
        power -= 1
    return np.array(values)


SOLUTIONS = {  # of lap lap W(r) cos n theta = 0 (Timoshenko and Woinowsky-Krieger, art. 63)
    0: [(0, 0), (0, 1), (2, 0), (2, 1)],
    1: [(1, 0), (-1, 0), (3, 0), (1, 1)],
}


def edge_tractions(W, n, r, nu):
    moment = W[2] + nu * (W[1] / r - n**2 * W[0] / r**2)
    lap_slope = W[3] + W[2] / r - (1 + n**2) * W[1] / r**2 + 2 * n**2 * W[0] / r**3
    return np.array([moment, lap_slope - (1 - nu) * n**2 / r * (W[1] / r - W[0] / r**2)])


def ring_loaded(shell, n, loads, radius, pressure=0.0):
    """W(radius) under line loads p cos(n theta) [N/m], {ring radius: p}, and for n = 0 a pressure.

    Lengths in units of b. Four constants between any two rings; free edges; W, W', W'' continuous
    on a ring, D W''' jumps by p. The rigid motions are left to the least norm.
    """
    b, D, nu = shell.outer_radius, shell.bending_stiffness, shell.poisson_ratio
    functions = SOLUTIONS.get(n, [(n, 0), (-n, 0), (n + 2, 0), (2 - n, 0)])
    cuts = np.array(sorted(loads)) / b

    def at(r):
        return np.array([derivatives(*function, r) for function in functions]).T

    size = 4 * (cuts.size + 1)
    system, right = np.zeros((size, size)), np.zeros(size)
    particular = pressure * b**4 / (64 * D)
    for row, columns, r in ((0, slice(0, 4), shell.inner_radius / b), (2, slice(-4, None), 1.0)):
        system[row : row + 2, columns] = edge_tractions(at(r), n, r, nu)
        right[row : row + 2] = -particular * edge_tractions(derivatives(4, 0, r), n, r, nu)
    for i, (cut, ring) in enumerate(zip(cuts, sorted(loads), strict=True)):
        rows = slice(4 + 4 * i, 8 + 4 * i)
        system[rows, 4 * i : 4 * i + 4] = -at(cut)
        system[rows, 4 * i + 4 : 4 * i + 8] = at(cut)
        right[7 + 4 * i] = loads[ring] * b**3 / D
    widths = np.abs(system).max(axis=0)  # r^-n is huge at a small hole
    constants = np.linalg.lstsq(system / widths, right, rcond=1e-13)[0] / widths
    assert np.allclose(system @ constants, right, rtol=0, atol=1e-12 * np.abs(right).max())
    r = radius / b
    piece = 4 * np.searchsorted(cuts, r)
    terms = np.array([derivatives(*function, r)[0] for function in functions])
    return particular * r**4 + sum(constants[piece + k] * terms[k] for k in range(4))


OFF_RINGS = np.array([20e-3, 24e-3, 31e-3, 62e-3, 75e-3, 84e-3, 115e-3, 125e-3])


@pytest.mark.parametrize(
    ("n", "loads"),
    [
        (0, {40e-3: 2.0, 100e-3: -0.8}),
        (1, {40e-3: 5.0, 100e-3: -0.8}),
        (2, {40e-3: 2.0, 100e-3: 1.1}),
        (3, {100e-3: 1.5}),
        (7, {40e-3: 1.5, 100e-3: 1.0}),
    ],
)
def test_many_forces_on_rings_are_line_loads(n, loads):
    """A ring of 300 forces: its own harmonic against the closed form, edges included."""
    spokes = [circle(1.0, 300, 0.1) for _ in loads]
    of = tuple(
        np.concatenate([c[i] * r for r, c in zip(loads, spokes, strict=True)]) for i in (0, 1)
    )
    angle = np.arctan2(of[1], of[0])
    forces = np.repeat([p * r * 2 * np.pi / 300 for r, p in loads.items()], 300) * np.cos(n * angle)
    reading = np.array([0.3, 1.7, 2.9, 4.4, 5.3, 0.9, 3.6, 2.2])
    at = (OFF_RINGS * np.cos(reading), OFF_RINGS * np.sin(reading))
    want = ring_loaded(GLASS, n, loads, OFF_RINGS) * np.cos(n * reading)
    got = influence(GLASS, at, of) @ forces
    assert np.abs(bent(got - want, at)).max() < 1e-11 * np.abs(bent(want, at)).max()


def test_even_load_on_a_ring_of_supports():
    at = circle(1.0, OFF_RINGS.size) * OFF_RINGS
    area = np.pi * (GLASS.outer_radius**2 - GLASS.inner_radius**2)
    want = ring_loaded(GLASS, 0, {100e-3: -1 / (2 * np.pi * 100e-3)}, OFF_RINGS, 1 / area)
    ring = influence(GLASS, at, circle(100e-3, 300)).mean(axis=1)
    got = uniform_influence(GLASS, at) - ring
    assert np.abs(bent(got - want, at)).max() < 1e-10 * np.abs(bent(want, at)).max()


# --- symmetries ------------------------------------------------------------------------------


@pytest.mark.parametrize("mirror", [p45(), lbt672()], ids=lambda mirror: mirror.name)
def test_symmetric_rigid_motions_free_and_converged(mirror):
    x, y = mirror.layout.x, mirror.layout.y
    K = stiffness(mirror.shell, x, y)
    T = arms((x, y))
    assert np.array_equal(K, K.T)
    assert np.abs(K @ T.T).max() < 2e-8
    eigenvalues = np.linalg.eigvalsh(K)
    finer = np.linalg.eigvalsh(stiffness(mirror.shell, x, y, digits=26))
    assert np.abs(eigenvalues[:3]).max() < 2e-8
    assert np.abs(eigenvalues[3:] / finer[3:] - 1).max() < 1e-9


def test_digits_tell_the_accuracy(K):
    """Fewer digits are visibly coarser: the knob is connected."""
    want = np.linalg.eigvalsh(K)[3:]
    error = [
        np.abs(np.linalg.eigvalsh(stiffness(GLASS, X, Y, digits=d))[3:] / want - 1).max()
        for d in (2, 4, 8)
    ]
    assert error[0] > 30 * error[1] > 900 * error[2] > 0
    assert error[2] < 1e-7


def test_a_third_of_a_turn_permutes(K):
    turned = np.concatenate(
        [first + np.roll(np.arange(n), n // 3) for first, n in zip([0, 9, 24], COUNTS, strict=True)]
    )
    assert np.hypot(X[turned] - X, Y[turned] - Y).min() > 1e-2
    assert np.abs(K[np.ix_(turned, turned)] - K).max() < 1e-9 * K.max()


def test_turning_and_mirroring_the_layout_change_nothing():
    x, y = scattered(12, seed=3)
    K = stiffness(GLASS, x, y)
    turned = (x + 1j * y) * np.exp(0.7j)
    assert stiffness(GLASS, turned.real, turned.imag) == pytest.approx(K, abs=1e-9 * K.max())
    assert stiffness(GLASS, -x, y) == pytest.approx(K, abs=1e-9 * K.max())


def test_size_and_thickness_scale(K):
    """K goes as D / length^2."""
    twice = replace(GLASS, inner_radius=40e-3, outer_radius=250e-3, thickness=4.8e-3)
    assert stiffness(twice, 2 * X, 2 * Y) == pytest.approx(K * 27 / 4, abs=1e-9 * K.max())


def test_reciprocity():
    one, other = scattered(7, seed=1), scattered(11, seed=2)
    random = np.random.default_rng(4)
    f, g = balanced(random.normal(size=7), one), balanced(random.normal(size=11), other)
    there, back = g @ influence(GLASS, other, one) @ f, f @ influence(GLASS, one, other) @ g
    scale = np.sqrt((f @ influence(GLASS, one, one) @ f) * (g @ influence(GLASS, other, other) @ g))
    assert there == pytest.approx(back, abs=1e-11 * scale)
    assert abs(there) > 1e-3 * scale


def test_many_points_are_read_like_few():
    of, at = scattered(3, seed=5), scattered(5000, seed=6)
    some = np.array([0, 2047, 2048, 4999])
    few = influence(GLASS, (at[0][some], at[1][some]), of)
    many = influence(GLASS, at, of)[some]
    assert many == pytest.approx(few, abs=1e-12 * np.abs(few).max())
    assert influence(GLASS, at, (np.zeros(0), np.zeros(0))).shape == (5000, 0)


# --- loads and holding forces ----------------------------------------------------------------


def test_even_load_is_the_mean_of_point_forces():
    """Gauss in radius, even steps in angle, read at the edges where the integrand is smoothest."""
    a, b = GLASS.inner_radius, GLASS.outer_radius
    xi, gauss = np.polynomial.legendre.leggauss(6)
    radius, spokes = 0.5 * (a + b) + 0.5 * (b - a) * xi, 64
    of = tuple(np.outer(radius, c).ravel() for c in circle(1.0, spokes))
    share = np.repeat(gauss * radius / (gauss @ radius), spokes) / spokes
    at = tuple(np.concatenate(pair) for pair in zip(circle(a, 3), circle(b, 4, 0.2), strict=True))
    supports = scattered(3, seed=8)
    support_forces = -np.linalg.solve(arms(supports), arms(of) @ share)
    held = influence(GLASS, at, supports) @ support_forces
    want = influence(GLASS, at, of) @ share + held
    got = uniform_influence(GLASS, at) + held
    assert np.abs(bent(got - want, at)).max() < 3e-6 * np.abs(bent(want, at)).max()


@pytest.fixture(scope="module")
def condensed():
    return condense(influence(GLASS, (X, Y), (X, Y)), TILTS)


def test_condensed_is_the_inverse_of_the_bordered_system(condensed):
    """Checked without inverting: [[G, T'], [T, 0]] [[K, R], [R', .]] = 1, rigid motions apart."""
    G = influence(GLASS, (X, Y), (X, Y))
    rigid = TILTS.T @ np.linalg.pinv(TILTS.T)
    apart = np.eye(LAYOUT.n) - rigid
    assert apart @ G @ condensed.stiffness == pytest.approx(apart, abs=1e-8)
    assert apart @ G @ condensed.reaction == pytest.approx(0, abs=1e-8 * np.abs(G).max())
    assert TILTS @ condensed.stiffness == pytest.approx(0, abs=2e-8)
    assert TILTS @ condensed.reaction == pytest.approx(np.eye(3), abs=1e-11)


def test_a_force_at_an_actuator_is_borne_by_that_actuator(condensed):
    i, load = 17, -0.3
    force = holding_forces(
        condensed,
        np.zeros(LAYOUT.n),
        load * influence(GLASS, (X, Y), (X[[i]], Y[[i]]))[:, 0],
        load * TILTS[:, i],
    )
    assert force == pytest.approx(0.3 * (np.arange(LAYOUT.n) == i), abs=1e-9)


def test_holding_forces_balance_the_load_and_hold_the_shape(condensed):
    wedges, wedge_load = scattered(3, seed=9), np.array([-0.11, -0.07, -0.13])
    weight = -2.9
    load_influence = influence(GLASS, (X, Y), wedges) @ wedge_load
    load_influence = load_influence + weight * uniform_influence(GLASS, (X, Y))
    resultants = arms(wedges) @ wedge_load + np.array([weight, 0, 0])
    assert np.abs(resultants).min() > 1e-3
    shapes = 1e-6 * np.random.default_rng(10).normal(size=(LAYOUT.n, 4))
    forces = holding_forces(condensed, shapes, load_influence[:, None], resultants[:, None])
    assert TILTS @ forces == pytest.approx(np.tile(-resultants[:, None], 4), abs=1e-11)
    reached = influence(GLASS, (X, Y), (X, Y)) @ forces + load_influence[:, None]
    assert np.abs(bent(reached - shapes, (X, Y))).max() < 1e-9 * np.abs(shapes).max()


def test_three_actuators_bend_nothing():
    x, y = circle(80e-3, 3, 0.4)
    assert np.abs(stiffness(GLASS, x, y)).max() == 0
    condensed = condense(influence(GLASS, (x, y), (x, y)), arms((x, y)))
    load = np.array([-3.0, 0.02, -0.01])
    forces = holding_forces(condensed, np.zeros(3), np.zeros(3), load)
    assert forces == pytest.approx(-np.linalg.solve(arms((x, y)), load), abs=1e-12)


# --- refusals --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("shell", "x", "y", "fault"),
    [
        (replace(GLASS, inner_radius=130e-3), X, Y, "reaches from 0.13 m to 0.125 m"),
        (replace(GLASS, inner_radius=0.0), X, Y, "0 makes a full disc"),
        (replace(GLASS, outer_radius=np.nan), X, Y, "reaches from"),
        (replace(GLASS, thickness=-1.6e-3), X, Y, "thickness is -0.0016 m"),
        (replace(GLASS, poisson_ratio=0.7), X, Y, "Poisson ratio 0.7"),
        (replace(GLASS, outer_radius=100e-3), X, Y, "force 24 .* off the glass"),
        (replace(GLASS, inner_radius=50e-3), X, Y, "force 0 .* off the glass"),
        (GLASS, 1e3 * X, Y, "off the glass"),
        (GLASS, np.append(np.nan, X[1:]), Y, "force 0 at x = nan"),
        (GLASS, *circle(125e-3, 9), "on an edge"),
        (GLASS, *circle(20.01e-3, 9), "on an edge"),
        (GLASS, np.linspace(0.03, 0.1, 9), np.linspace(0.02, 0.06, 9), "on one line"),
        (GLASS, X[:2], Y[:2], "2 actuators stand on one line"),
        (GLASS, np.append(X, X[3]), np.append(Y, Y[3]), "at one place"),
    ],
)
def test_bad_geometry_is_refused(shell, x, y, fault):
    with pytest.raises(GeometryError, match=fault) as refusal:
        stiffness(shell, x, y)
    assert refusal.value.remedy
    assert "\n" not in str(refusal.value)


def test_points_off_the_glass_are_refused():
    beyond = (np.array([0.05, 0.126]), np.zeros(2))
    with pytest.raises(GeometryError, match=r"point 1 at x = 0\.126 m"):
        influence(GLASS, beyond, (X, Y))
    with pytest.raises(GeometryError, match=r"point 1 at x = 0\.126 m"):
        uniform_influence(GLASS, beyond)
