"""The spherical shell, its sensors and its mass against published numbers and closed forms."""

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.special import ivp, kvp

from helpers.shells import condense, holding_forces, influence, stiffness, uniform_influence
from truenewton.errors import GeometryError
from truenewton.mirrors.glass import Annulus, Shell
from truenewton.mirrors.known import lbt672
from truenewton.mirrors.shell.condensation import rearming
from truenewton.reading import read_data
from truenewton.statics.arms import arms
from truenewton.statics.layout import rings

FLAT = Shell(inner_radius=20e-3, outer_radius=125e-3, thickness=1.6e-3)
GLASS = replace(FLAT, radius_of_curvature=2.0)
COUNTS = np.array([9, 15, 21])
LAYOUT = rings(list(COUNTS * 30.5e-3 / (2 * np.pi)), list(COUNTS))
X, Y = LAYOUT.x, LAYOUT.y
TILTS = np.array([np.ones(LAYOUT.n), X, Y])
ELECTRODE = Annulus(8e-3, 12.5e-3)
REAL = os.environ.get("TRUENEWTON_REAL_DATA")
needs_real_data = pytest.mark.skipif(
    REAL is None, reason="TRUENEWTON_REAL_DATA, the folder of measured matrices, is not set"
)


@pytest.fixture(scope="module")
def K():
    return stiffness(GLASS, X, Y)


def shallowness(shell):
    """Lambda^4 = E t b^4 / (D R^2)."""
    membrane = shell.young_modulus * shell.thickness / shell.radius_of_curvature**2
    return (membrane / shell.bending_stiffness) ** 0.25 * shell.outer_radius


def bent(displacement, points):
    """Take the best rigid motion away."""
    T = np.array([np.ones_like(points[0]), *points])
    return displacement - np.linalg.pinv(T) @ (T @ displacement)


def circle(radius, n, first=0.0):
    angle = first + 2 * np.pi * np.arange(n) / n
    return radius * np.cos(angle), radius * np.sin(angle)


# --- numbers of others -----------------------------------------------------------------------


def test_eigenvalues_of_an_earlier_semi_analytic_model(K):
    """Of the shells in test_shell.py with a radius of curvature of 2 m."""
    eigenvalues = np.linalg.eigvalsh(K)
    assert eigenvalues[3:5] == pytest.approx([5434, 5434], abs=0.5)
    assert eigenvalues[5] == pytest.approx(33190, abs=0.5)
    assert eigenvalues[-1] == pytest.approx(2.3815e6, abs=50)


@pytest.mark.parametrize("radius", [2.0, -2.0, 1.2])
def test_symmetric_rigid_motions_free_and_converged(radius):
    shell = replace(GLASS, radius_of_curvature=radius)
    K = stiffness(shell, X, Y)
    assert np.array_equal(K, K.T)
    assert np.abs(K @ TILTS.T).max() < 1e-8
    finer = np.linalg.eigvalsh(stiffness(shell, X, Y, digits=22))[3:]
    assert np.abs(np.linalg.eigvalsh(K)[3:] / finer - 1).max() < 1e-11


def test_large_shell_is_free_and_converged():
    """LBT672, whose membrane is 5e4 times stiffer than its bending."""
    mirror = lbt672()
    shell = replace(mirror.shell, radius_of_curvature=1.955)
    x, y = shell.along(mirror.layout.x, mirror.layout.y)
    K = stiffness(shell, x, y)
    assert np.abs(K @ np.array([np.ones_like(x), x, y]).T).max() < 2e-8
    finer = np.linalg.eigvalsh(stiffness(shell, x, y, digits=17))[3:]
    assert np.abs(np.linalg.eigvalsh(K)[3:] / finer - 1).max() < 1e-9


@needs_real_data
def test_eigenvalues_of_a_large_mirror_by_an_earlier_model():
    """650 actuators where a real LBT672 has them, sensors of 8 to 12.5 mm; and what it measured."""
    measured = read_data(Path(REAL) / "lbt672" / "lbt672-feedforward.fits")
    shell = replace(lbt672().shell, radius_of_curvature=1.955)
    x, y = shell.along(measured.layout.x, measured.layout.y)
    _, singular, right = np.linalg.svd(stiffness(shell, x, y, sensor=ELECTRODE))
    singular = singular[::-1]
    assert np.round(singular[5:11]).tolist() == [160, 165, 513, 530, 1246, 1251]
    assert np.round(singular[15:17]).tolist() == [7216, 7416]
    assert np.median(singular) == pytest.approx(1.30e6, rel=5e-3)
    assert singular[-1] == pytest.approx(6.02e6, rel=1e-3)
    softest = right[-25:] @ np.linalg.svd(measured.stiffness)[2][-25:].T
    assert (softest**2).sum() / 25 == pytest.approx(0.9988, abs=1e-3)


def test_dent_of_reissner():
    """w(0) = P R sqrt(12 (1 - nu^2)) / (8 E t^2) under a point force (J. Math. Phys. 25, 1946).

    On the apex, but for a pinhole. An even load holds the force in balance, and its membrane forces
    at the rim are just those that the force leaves there.
    """
    shell = Shell(5e-5, 0.5, 0.5e-3, radius_of_curvature=2.0)
    at = (np.array([3e-4, 0.25]), np.zeros(2))
    two = influence(shell, at, (np.array([3e-4, -3e-4]), np.zeros(2))).mean(axis=1)
    dent = two - uniform_influence(shell, at)
    nu, E, t, R = shell.poisson_ratio, shell.young_modulus, shell.thickness, 2.0
    want = R * np.sqrt(12 * (1 - nu**2)) / (8 * E * t**2)
    assert dent[0] - dent[1] == pytest.approx(want, rel=2e-3)


# --- closed forms ----------------------------------------------------------------------------


def state(W, F, u, n, r, nu):
    """W, W', moment, shear, U, V, N_r, N_rt from W to W''', F to F'' and (U, V)."""
    hoop, twist = W[1] / r - n**2 * W[0] / r**2, W[1] / r - W[0] / r**2
    lap_slope = W[3] + W[2] / r - (1 + n**2) * W[1] / r**2 + 2 * n**2 * W[0] / r**3
    shear = lap_slope - (1 - nu) * n**2 / r * twist
    N_r, N_rt = F[1] / r - n**2 * F[0] / r**2, n * (F[1] / r - F[0] / r**2)
    return np.array([W[0], W[1], W[2] + nu * hoop, shear, u[0], u[1], N_r, N_rt])


def power(p, r):
    """r^p and its first three derivatives."""
    return np.array([r**p, p * r ** (p - 1.0), p * (p - 1) * r ** (p - 2.0),
                     p * (p - 1) * (p - 2) * r ** (p - 3.0)])  # fmt: skip


def solutions(n, r, lam, nu):
    """All states of an unloaded shallow sphere that go with cos(n theta), in columns.

    Four parts with lap w = i lambda^2 w, F = lap w; inextensional bending, w harmonic; membrane
    forces without normal displacement, F harmonic. u = -(1 + nu) grad F / lambda^4, and the
    integral of w = Re z^n in the inextensional ones. Multi-valued u is left away.
    """
    z, zero, columns = np.exp(0.25j * np.pi) * lam, np.zeros(4), []

    def forced(W, F):
        u = -(1 + nu) / lam**4 * np.array([F[1], -n * F[0] / r])
        columns.append(state(W, F, u, n, r, nu))

    for bessel in (ivp, kvp):
        field = np.array([z**k * bessel(n, z * r, k) for k in range(4)])
        for turned in (field, 1j * field):
            forced(turned.real, (1j * lam**2 * turned).real)
    bending, membrane = ((0,), ()) if n == 0 else ((1,), (-1,)) if n == 1 else ((n, -n), (n, -n))
    for p in bending:
        u = r ** (p + 1.0) / (p + 1) * np.array([1.0, np.sign(p)])
        columns.append(state(power(p, r), zero, u, n, r, nu))
    for p in membrane:
        forced(zero, power(p, r))
    if n == 0:
        forced(zero, np.array([np.log(r), 1 / r, -1 / r**2, 2 / r**3]))
    if n == 1:
        columns.append(np.array([0, 0, 0, 0, 1.0, -1.0, 0, 0]))  # in-plane translation
    return np.array(columns).T


def ring_loaded(shell, n, loads, radius, pressure=0.0):
    """W(radius) under line loads p cos(n theta) [N/m], {ring radius: p}, and for n = 0 a pressure.

    Lengths in units of b. All but the shear is continuous on a ring; free edges.
    """
    b, D, nu = shell.outer_radius, shell.bending_stiffness, shell.poisson_ratio
    lam, cuts, hole = shallowness(shell), np.array(sorted(loads)) / b, shell.inner_radius / b
    count = solutions(n, 1.0, lam, nu).shape[1]
    rows, right = [], []
    load = pressure * b**4 / D
    swollen = load * (1 - nu) / (2 * lam**4)  # W under pressure where u = 0 and N_r = -load / 2
    for first, r in ((0, hole), (cuts.size * count, 1.0)):
        block = np.zeros((4, (cuts.size + 1) * count))
        block[:, first : first + count] = solutions(n, r, lam, nu)[[2, 3, 6, 7]]
        rows.append(block)
        right.append([0, 0, load / 2, 0])
    for i, (cut, ring) in enumerate(zip(cuts, sorted(loads), strict=True)):
        block = np.zeros((8, (cuts.size + 1) * count))
        block[:, i * count : (i + 1) * count] = -solutions(n, cut, lam, nu)
        block[:, (i + 1) * count : (i + 2) * count] = solutions(n, cut, lam, nu)
        rows.append(block)
        right.append([0, 0, 0, loads[ring] * b**3 / D, 0, 0, 0, 0])
    system, right = np.concatenate(rows), np.concatenate(right)
    tall = np.abs(system).max(axis=1)
    system, right = system[tall > 0] / tall[tall > 0, None], right[tall > 0] / tall[tall > 0]
    wide = np.abs(system).max(axis=0)
    constants = np.linalg.lstsq(system / wide, right, rcond=1e-14)[0] / wide
    assert np.allclose(system @ constants, right, rtol=0, atol=1e-10 * np.abs(right).max())
    piece = np.searchsorted(cuts, radius / b)
    terms = np.array([solutions(n, r, lam, nu)[0] for r in radius / b])
    return swollen + (terms * constants.reshape(-1, count)[piece]).sum(axis=1)


OFF_RINGS = np.array([20e-3, 24e-3, 31e-3, 62e-3, 75e-3, 84e-3, 115e-3, 125e-3])
READING = np.array([0.3, 1.7, 2.9, 4.4, 5.3, 0.9, 3.6, 2.2])


@pytest.mark.parametrize("radius", [6.0, 2.0, 0.5])
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
def test_many_forces_on_rings_are_line_loads(n, loads, radius):
    """A ring of 300 forces: its own harmonic against the closed form, edges included."""
    shell = replace(GLASS, radius_of_curvature=radius)
    of = tuple(np.concatenate([c * r for r in loads]) for c in circle(1.0, 300, 0.1))
    angle = np.arctan2(of[1], of[0])
    forces = np.repeat([p * r * 2 * np.pi / 300 for r, p in loads.items()], 300) * np.cos(n * angle)
    at = (OFF_RINGS * np.cos(READING), OFF_RINGS * np.sin(READING))
    want = ring_loaded(shell, n, loads, OFF_RINGS) * np.cos(n * READING)
    got = influence(shell, at, of) @ forces
    assert np.abs(bent(got - want, at)).max() < 1e-9 * np.abs(bent(want, at)).max()


@pytest.mark.parametrize("radius", [2.0, 0.5])
def test_even_load_on_a_ring_of_supports(radius):
    shell = replace(GLASS, radius_of_curvature=radius)
    at = (OFF_RINGS * np.cos(READING), OFF_RINGS * np.sin(READING))
    area = np.pi * (GLASS.outer_radius**2 - GLASS.inner_radius**2)
    want = ring_loaded(shell, 0, {100e-3: -1 / (2 * np.pi * 100e-3)}, OFF_RINGS, 1 / area)
    ring = influence(shell, at, circle(100e-3, 300)).mean(axis=1)
    got = uniform_influence(shell, at) - ring
    assert np.abs(bent(got - want, at)).max() < 1e-9 * np.abs(bent(want, at)).max()


def test_saddles_bend_without_stretching():
    """Flat <= curved <= Rayleigh's energy of r^n cos(n theta), which stretches no sphere."""
    disc = Shell(inner_radius=1e-4, outer_radius=0.12, thickness=1.6e-3)
    many = rings(list(np.linspace(0.008, 0.1185, 8)), list(6 * np.arange(1, 9)))
    flat = stiffness(disc, many.x, many.y)
    curved = stiffness(replace(disc, radius_of_curvature=0.8), many.x, many.y)
    D, nu, R = disc.bending_stiffness, disc.poisson_ratio, disc.outer_radius
    for n in (2, 3, 5):
        saddle = np.real(((many.x + 1j * many.y) / R) ** n)
        rayleigh = 2 * np.pi * (1 - nu) * D * n**2 * (n - 1) / R**2
        below, energy = saddle @ flat @ saddle, saddle @ curved @ saddle
        assert below < energy < rayleigh
    defocus = many.x**2 + many.y**2  # stretches
    assert defocus @ curved @ defocus > 10 * (defocus @ flat @ defocus)


# --- limits and symmetries -------------------------------------------------------------------


def test_concave_is_convex(K):
    assert np.array_equal(stiffness(replace(GLASS, radius_of_curvature=-2.0), X, Y), K)


def test_flat_limit_is_reached_as_curvature_squared():
    flat = np.linalg.eigvalsh(stiffness(FLAT, X, Y))[3:]

    def excess(radius):
        curved = stiffness(replace(FLAT, radius_of_curvature=radius), X, Y)
        return np.abs(np.linalg.eigvalsh(curved)[3:] / flat - 1).max()

    assert excess(1e2) == pytest.approx(100 * excess(1e3), rel=2e-3)
    assert excess(1e3) == pytest.approx(100 * excess(1e4), rel=1e-4)
    assert excess(1e8) < 1e-11


def test_flat_displacements_under_a_load_are_reached():
    supports = circle(58e-3, 3)  # beside all sensors
    read = [
        bent(
            uniform_influence(shell, (X, Y), sensor=ELECTRODE)
            - influence(shell, (X, Y), supports, sensor=ELECTRODE).mean(axis=1),
            (X, Y),
        )
        for shell in (FLAT, replace(FLAT, radius_of_curvature=1e7))
    ]
    assert read[1] == pytest.approx(read[0], rel=0, abs=1e-10 * np.abs(read[0]).max())


def test_the_two_forms_of_the_kernel_meet():
    """The series serves below lambda = 2, kei above."""
    radius = shallowness(replace(FLAT, radius_of_curvature=1.0)) ** 2 / 4
    either = [
        stiffness(replace(FLAT, radius_of_curvature=radius * f), X, Y, puck_radius=4e-3)
        for f in (1 - 1e-12, 1 + 1e-12)
    ]
    assert either[0] == pytest.approx(either[1], abs=1e-10 * np.abs(either[0]).max())


def test_size_and_thickness_scale(K):
    """K goes as D / length^2 where R t goes as length^2."""
    twice = replace(
        GLASS, inner_radius=40e-3, outer_radius=250e-3, thickness=4.8e-3,
        radius_of_curvature=2.0 * 4 / 3,
    )  # fmt: skip
    assert stiffness(twice, 2 * X, 2 * Y) == pytest.approx(K * 27 / 4, abs=1e-9 * np.abs(K).max())


# --- arms of the balance ---------------------------------------------------------------------


def sphere():
    """Compliance of a cap of 13 degrees, its rigid motions and the arms of the balance."""
    R, layout = 0.9, lbt672().layout
    shell = Shell(27.5e-3, 0.22, 1.6e-3, radius_of_curvature=R)
    near = np.hypot(layout.x, layout.y) < 0.21
    A = arms(layout)[:, near]
    x, y = shell.along(A[1], A[2])
    A[0] = np.cos(np.hypot(x, y) / R)
    return influence(shell, (x, y), (x, y)), np.array([np.ones_like(x), x, y]), A


def test_rearmed_forces_balance_over_the_arms():
    compliance, tilts, A = sphere()
    J = rearming(tilts, A)
    condensed = condense(J @ compliance @ J.T, A)
    assert np.abs(A @ condensed.stiffness).max() < 1e-7
    assert A @ condensed.reaction == pytest.approx(np.eye(3), abs=1e-10)
    plain = np.linalg.eigvalsh(condense(compliance, tilts).stiffness)[3:]
    assert np.linalg.eigvalsh(condensed.stiffness)[3:] == pytest.approx(plain, rel=1e-4)
    assert rearming(tilts, tilts) == pytest.approx(np.eye(tilts.shape[1]))
    assert pytest.approx(A.T, abs=1e-12) == J @ tilts.T


def test_rearmed_shell_knows_nothing_of_the_springs():
    """Rigid motions in compliance and load, the springs' or any, change nothing."""
    compliance, tilts, A = sphere()
    J = rearming(tilts, A)
    load = np.array([-7.0, 0.02, -0.01])
    bent = np.random.default_rng(0).normal(size=tilts.shape[1])

    def held(spring, exchange):
        G, w = compliance + tilts.T @ spring @ tilts, bent + tilts.T @ spring @ load
        condensed = condense(exchange @ G @ exchange.T, A)
        return holding_forces(condensed, np.zeros_like(w), exchange @ w, load)

    none, some = np.zeros((3, 3)), np.diag([1e-4, 1e-3, 2e-3])
    scale = np.abs(held(none, J)).max()
    assert held(some, J) == pytest.approx(held(none, J), abs=1e-7 * scale)
    plain = np.eye(J.shape[0])
    assert np.abs(held(some, plain) - held(none, plain)).max() > 1e-5 * scale


def test_points_beside_the_sphere_are_refused():
    with pytest.raises(GeometryError, match="beside the sphere of radius 2 m"):
        GLASS.along(np.array([0.1, 2.1]), np.zeros(2))
    x, y = GLASS.along(np.array([0.0, 1.2]), np.array([0.0, -1.6]))
    assert np.hypot(x, y) == pytest.approx([0, np.pi])
    assert FLAT.along(X, Y)[0] == pytest.approx(X, rel=1e-15)
