"""The plate and the spherical shell against published numbers, closed forms and statics."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import ivp, kvp

from helpers.shells import (
    FLAT,
    LAYOUT,
    SPHERE,
    TILTS,
    X,
    Y,
    circle,
    condense,
    holding_forces,
    influence,
    stiffness,
    uniform_influence,
)
from truenewton.errors import GeometryError
from truenewton.mirrors.glass import Shell
from truenewton.mirrors.known import lbt672, p45
from truenewton.mirrors.shell import round_shell
from truenewton.mirrors.shell.shell_model import rearming, rigid_motions
from truenewton.statics.arms import arms


def shallowness(shell):
    """Lambda^4 = E t b^4 / (D R^2)."""
    membrane = shell.young_modulus * shell.thickness / shell.radius_of_curvature**2
    return (membrane / shell.bending_stiffness) ** 0.25 * shell.outer_radius


def scattered(n, seed):
    random = np.random.default_rng(seed)
    radius, angle = random.uniform(25e-3, 120e-3, n), random.uniform(0, 2 * np.pi, n)
    return radius * np.cos(angle), radius * np.sin(angle)


def bent(displacement, points):
    """Take the best rigid motion away."""
    T = rigid_motions(*points)
    return displacement - np.linalg.pinv(T) @ (T @ displacement)


# --- closed forms ----------------------------------------------------------------------------


def state(W, F, u, n, r, nu):
    """W, W', moment, shear, U, V, N_r, N_rt from W to W''', F to F'' and (U, V)."""
    hoop, twist = W[1] / r - n**2 * W[0] / r**2, W[1] / r - W[0] / r**2
    lap_slope = W[3] + W[2] / r - (1 + n**2) * W[1] / r**2 + 2 * n**2 * W[0] / r**3
    shear = lap_slope - (1 - nu) * n**2 / r * twist
    N_r, N_rt = F[1] / r - n**2 * F[0] / r**2, n * (F[1] / r - F[0] / r**2)
    return np.array([W[0], W[1], W[2] + nu * hoop, shear, u[0], u[1], N_r, N_rt])


def power(p, r, log=False):
    """r^p, or r^p ln r, and its first three derivatives."""
    plain, logarithmic = (0.0, 1.0) if log else (1.0, 0.0)
    values = []
    for _ in range(4):
        values.append((plain + logarithmic * np.log(r)) * r**p)
        plain, logarithmic = p * plain + logarithmic, p * logarithmic
        p -= 1
    return np.array(values)


def plate_solutions(n, r, nu):
    """W to shear of lap lap W(r) cos n theta = 0 (Timoshenko, Plates and Shells, art. 63)."""
    powers = {0: [(0, False), (0, True), (2, False), (2, True)],
              1: [(1, False), (-1, False), (3, False), (1, True)]}  # fmt: skip
    others = [(n, False), (-n, False), (n + 2, False), (2 - n, False)]
    none = np.zeros(4)
    return np.array(
        [state(power(p, r, log), none, none, n, r, nu)[:4] for p, log in powers.get(n, others)]
    ).T


def sphere_solutions(n, r, nu, lam):
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
        forced(zero, power(0, r, log=True))
    if n == 1:
        columns.append(np.array([0, 0, 0, 0, 1.0, -1.0, 0, 0]))  # in-plane translation
    return np.array(columns).T


def ring_loaded(shell, n, loads, radius, pressure=0.0):
    """W(radius) under line loads p cos(n theta) [N/m], {ring radius: p}, and for n = 0 a pressure.

    Lengths in units of b. All but the shear is continuous on a ring; free edges.
    """
    b, D, nu = shell.outer_radius, shell.bending_stiffness, shell.poisson_ratio
    cuts, hole, lam = np.array(sorted(loads)) / b, shell.inner_radius / b, shallowness(shell)
    even = pressure * b**4 / D

    def solutions(r):
        return plate_solutions(n, r, nu) if lam == 0 else sphere_solutions(n, r, nu, lam)

    def under_pressure(r):
        if lam == 0:
            return even / 64 * state(power(4, r), np.zeros(4), np.zeros(2), n, r, nu)[:4]
        # where u = 0 and N_r = -even / 2
        return even * np.array([(1 - nu) / (2 * lam**4), 0, 0, 0, 0, 0, -0.5, 0])

    size, count = solutions(1.0).shape
    free = [2, 3, 6, 7][: size // 2]
    rows, right = [], []
    for first, r in ((0, hole), (cuts.size * count, 1.0)):
        block = np.zeros((len(free), (cuts.size + 1) * count))
        block[:, first : first + count] = solutions(r)[free]
        rows.append(block)
        right.append(-under_pressure(r)[free])
    for i, (cut, ring) in enumerate(zip(cuts, sorted(loads), strict=True)):
        block = np.zeros((size, (cuts.size + 1) * count))
        block[:, i * count : (i + 1) * count] = -solutions(cut)
        block[:, (i + 1) * count : (i + 2) * count] = solutions(cut)
        rows.append(block)
        right.append(loads[ring] * b**3 / D * (np.arange(size) == 3))
    system, right = np.concatenate(rows), np.concatenate(right)
    tall = np.abs(system).max(axis=1)
    system, right = system[tall > 0], right[tall > 0]
    if lam > 0:
        system, right = system / tall[tall > 0, None], right / tall[tall > 0]
    wide = np.abs(system).max(axis=0)
    constants = np.linalg.lstsq(system / wide, right, rcond=1e-14)[0] / wide
    assert np.allclose(system @ constants, right, rtol=0, atol=1e-10 * np.abs(right).max())
    piece = np.searchsorted(cuts, radius / b)
    terms = np.array([solutions(r)[0] for r in radius / b])
    particular = np.array([under_pressure(r)[0] for r in radius / b])
    return particular + (terms * constants.reshape(-1, count)[piece]).sum(axis=1)


OFF_RINGS = np.array([20e-3, 24e-3, 31e-3, 62e-3, 75e-3, 84e-3, 115e-3, 125e-3])
READING = np.array([0.3, 1.7, 2.9, 4.4, 5.3, 0.9, 3.6, 2.2])
AT = (OFF_RINGS * np.cos(READING), OFF_RINGS * np.sin(READING))


@pytest.mark.parametrize(("radius", "worst"), [(np.inf, 1e-11), (6.0, 1e-9), (0.5, 1e-9)])
@pytest.mark.parametrize(
    ("n", "loads"),
    [
        (0, {40e-3: 2.0, 100e-3: -0.8}),
        (1, {40e-3: 5.0, 100e-3: -0.8}),
        (2, {40e-3: 2.0, 100e-3: 1.1}),
        (7, {40e-3: 1.5, 100e-3: 1.0}),
    ],
)
def test_many_forces_on_rings_are_line_loads(n, loads, radius, worst):
    """A ring of 300 forces: its own harmonic against the closed form, edges included."""
    shell = replace(FLAT, radius_of_curvature=radius)
    of = tuple(np.concatenate([c * r for r in loads]) for c in circle(1.0, 300, 0.1))
    angle = np.arctan2(of[1], of[0])
    forces = np.repeat([p * r * 2 * np.pi / 300 for r, p in loads.items()], 300) * np.cos(n * angle)
    want = ring_loaded(shell, n, loads, OFF_RINGS) * np.cos(n * READING)
    got = influence(shell, AT, of) @ forces
    assert np.abs(bent(got - want, AT)).max() < worst * np.abs(bent(want, AT)).max()


@pytest.mark.parametrize(("radius", "worst"), [(np.inf, 1e-10), (2.0, 1e-9), (0.5, 1e-9)])
def test_even_load_on_a_ring_of_supports(radius, worst):
    shell = replace(FLAT, radius_of_curvature=radius)
    area = np.pi * (FLAT.outer_radius**2 - FLAT.inner_radius**2)
    want = ring_loaded(shell, 0, {100e-3: -1 / (2 * np.pi * 100e-3)}, OFF_RINGS, 1 / area)
    ring = influence(shell, AT, circle(100e-3, 300)).mean(axis=1)
    got = uniform_influence(shell, AT) - ring
    assert np.abs(bent(got - want, AT)).max() < worst * np.abs(bent(want, AT)).max()


# --- limits and symmetries -------------------------------------------------------------------


@pytest.mark.parametrize(
    ("mirror", "radius"),
    [(p45(), np.inf), (p45(), -1.2), pytest.param(lbt672(), 1.955, marks=pytest.mark.study)],
    ids=["flat", "curved", "LBT672"],
)
def test_symmetric_rigid_motions_free_and_converged(mirror, radius, monkeypatch):
    """LBT672 has a membrane 5e4 times stiffer than its bending."""
    shell = replace(mirror.shell, radius_of_curvature=radius)
    x, y = shell.along(mirror.layout.x, mirror.layout.y)
    K = stiffness(shell, x, y)
    assert np.abs(K @ rigid_motions(x, y).T).max() < 2e-8
    monkeypatch.setattr(round_shell, "DIGITS", 17)
    finer = np.linalg.eigvalsh(stiffness(shell, x, y))[3:]
    assert np.abs(np.linalg.eigvalsh(K)[3:] / finer - 1).max() < 1e-9


# --- holding forces and arms of the balance --------------------------------------------------


def test_holding_forces_balance_the_load_and_hold_the_shape():
    compliance = influence(FLAT, (X, Y), (X, Y))
    wedges, wedge_load = scattered(3, seed=9), np.array([-0.11, -0.07, -0.13])
    weight = -2.9
    load_influence = influence(FLAT, (X, Y), wedges) @ wedge_load
    load_influence = load_influence + weight * uniform_influence(FLAT, (X, Y))
    resultants = rigid_motions(*wedges) @ wedge_load + np.array([weight, 0, 0])
    assert np.abs(resultants).min() > 1e-3
    shapes = 1e-6 * np.random.default_rng(10).normal(size=(LAYOUT.n, 4))
    forces = holding_forces(
        condense(compliance, TILTS), shapes, load_influence[:, None], resultants[:, None]
    )
    assert TILTS @ forces == pytest.approx(np.tile(-resultants[:, None], 4), abs=1e-11)
    reached = compliance @ forces + load_influence[:, None]
    assert np.abs(bent(reached - shapes, (X, Y))).max() < 1e-9 * np.abs(shapes).max()


def test_three_actuators_bend_nothing():
    x, y = circle(80e-3, 3, 0.4)
    tilts = rigid_motions(x, y)
    assert np.abs(stiffness(FLAT, x, y)).max() == 0
    load = np.array([-3.0, 0.02, -0.01])
    condensed = condense(influence(FLAT, (x, y), (x, y)), tilts)
    forces = holding_forces(condensed, np.zeros(3), np.zeros(3), load)
    assert forces == pytest.approx(-np.linalg.solve(tilts, load), abs=1e-12)


def test_rearmed_forces_balance_over_the_arms():
    """Of a cap of 13 degrees."""
    R, layout = 0.9, lbt672().layout
    shell = Shell(27.5e-3, 0.22, 1.6e-3, radius_of_curvature=R)
    near = np.hypot(layout.x, layout.y) < 0.21
    A = arms(layout)[:, near]
    x, y = shell.along(A[1], A[2])
    A[0] = np.cos(np.hypot(x, y) / R)
    compliance, tilts = influence(shell, (x, y), (x, y)), rigid_motions(x, y)

    J = rearming(tilts, A)
    condensed = condense(J @ compliance @ J.T, A)
    assert np.abs(A @ condensed.stiffness).max() < 1e-7
    assert A @ condensed.reaction == pytest.approx(np.eye(3), abs=1e-10)
    plain = np.linalg.eigvalsh(condense(compliance, tilts).stiffness)[3:]
    assert np.linalg.eigvalsh(condensed.stiffness)[3:] == pytest.approx(plain, rel=1e-4)
    assert pytest.approx(A.T, abs=1e-12) == J @ tilts.T


# --- refusals --------------------------------------------------------------------------------


def test_points_beside_the_sphere_are_refused():
    with pytest.raises(GeometryError, match="beside the sphere of radius 2 m"):
        SPHERE.along(np.array([0.1, 2.1]), np.zeros(2))
    x, y = SPHERE.along(np.array([0.0, 1.2]), np.array([0.0, -1.6]))
    assert np.hypot(x, y) == pytest.approx([0, np.pi])
    assert FLAT.along(X, Y)[0] == pytest.approx(X, rel=1e-15)


@pytest.mark.parametrize(
    ("shell", "x", "y", "fault"),
    [
        (replace(FLAT, inner_radius=130e-3), X, Y, "reaches from 0.13 m to 0.125 m"),
        (replace(FLAT, inner_radius=0.0), X, Y, "0 makes a full disc"),
        (replace(FLAT, outer_radius=np.nan), X, Y, "reaches from"),
        (replace(FLAT, thickness=-1.6e-3), X, Y, "thickness is -0.0016 m"),
        (replace(FLAT, poisson_ratio=0.7), X, Y, "Poisson ratio 0.7"),
        (replace(FLAT, young_modulus=-1.0), X, Y, "Young's modulus -1 Pa"),
        (replace(FLAT, radius_of_curvature=0.0), X, Y, "radius of curvature 0 m"),
        (replace(FLAT, radius_of_curvature=0.12), X, Y, "taken as shallow"),
        (replace(FLAT, outer_radius=100e-3), X, Y, "force 24 .* off the glass"),
        (FLAT, np.append(np.nan, X[1:]), Y, "force 0 at x = nan"),
        (FLAT, *circle(125e-3, 9), "on an edge"),
        (FLAT, *circle(20.01e-3, 9), "on an edge"),
        (FLAT, np.linspace(0.03, 0.1, 9), np.linspace(0.02, 0.06, 9), "on one line"),
        (FLAT, X[:2], Y[:2], "2 actuators are on one line"),
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
        influence(FLAT, beyond, (X, Y))
    with pytest.raises(GeometryError, match=r"point 1 at x = 0\.126 m"):
        uniform_influence(FLAT, beyond)
