"""Turbulence and modal bases, against closed forms, published figures and Fourier space."""

import math
from fractions import Fraction

import numpy as np
import pytest
from scipy.special import j0

from studies import turbulence as published
from truenewton.errors import FormatError, GeometryError
from truenewton.mirrors.known import mirror
from truenewton.modal.bases import karhunen_loeve_modes, noll_orders, zernike, zernike_modes
from truenewton.modal.turbulence import (
    FRIED,
    SPECTRUM,
    WAVELENGTH,
    Atmosphere,
    structure_function,
    wavefront_covariance,
)


@pytest.fixture(scope="module")
def grid():
    """Return points of the disc and their weights."""
    return published.disc(24, 64)


@pytest.fixture(scope="module")
def covariance(grid):
    """Return covariances over the disc [(D / r0)^(5/3) rad^2] by D / L0."""
    return {ratio: published.on_grid(ratio, *grid) for ratio in (0.0, 0.4)}


@pytest.fixture(scope="module")
def radial():
    """Return places 0 to 2000 and weights; J0 is resolved and so is a vast outer scale."""
    edges = np.concatenate([[0.0], np.geomspace(1e-30, 1, 100), np.arange(2.0, 2001.0)])
    t, w = np.polynomial.legendre.leggauss(20)
    low, high = edges[:-1, None], edges[1:, None]
    return ((high - low) / 2 * t + (high + low) / 2).ravel(), ((high - low) / 2 * w).ravel()


def points(name, radius=1.0):
    """Return the actuators of a mirror, its edge at `radius`."""
    known = mirror(name)
    scale = radius / known.shell.outer_radius
    return known.layout.x * scale, known.layout.y * scale


# --- atmosphere and structure function -----------------------------------------------------------


def test_the_fried_parameter_of_a_median_night():
    assert Atmosphere(0.8).fried_parameter == pytest.approx(0.12634, rel=1e-4)
    assert Atmosphere(1.6).fried_parameter == pytest.approx(0.06317, rel=1e-4)


@pytest.mark.parametrize("value", [0.0, -1.0, np.nan])
def test_an_atmosphere_that_cannot_be_is_refused(value):
    with pytest.raises(FormatError, match="a seeing of"):
        Atmosphere(value)
    with pytest.raises(FormatError, match="an outer scale of"):
        Atmosphere(0.8, value)


def test_constants_are_those_of_the_books():
    assert pytest.approx(6.88, abs=0.005) == FRIED
    assert pytest.approx(0.0229, abs=5e-5) == SPECTRUM


@pytest.mark.parametrize("outer_scale", [np.inf, 1e6, 100.0, 25.0, 3.0])
def test_structure_function_is_the_hankel_transform_of_the_spectrum(outer_scale, radial):
    atmosphere = Atmosphere(0.8, outer_scale)
    assert structure_function(np.zeros(1), atmosphere)[0] == 0.0
    x, w = radial
    rise = np.where(x < 0.01, x**2 / 4 - x**4 / 64, 1 - j0(x))
    for r in (0.01, 1.0, 8.0, 39.0):
        z = 2 * np.pi * r / outer_scale
        # 2 times the integral over f of (1 - J0) times the spectrum, x = 2 pi f r; without J0
        # beyond the last x, where it adds 1e-10.
        integral = w @ (x * rise * (x**2 + z**2) ** (-11 / 6))
        integral += 0.6 * (2000.0**2 + z**2) ** (-5 / 6)
        scale = 4 * np.pi * SPECTRUM * (2 * np.pi * r / atmosphere.fried_parameter) ** (5 / 3)
        D = structure_function(np.array([r]), atmosphere)[0] / (WAVELENGTH / (2 * np.pi)) ** 2
        assert scale * integral == pytest.approx(D, rel=1e-7)


# --- covariance over the pupil -------------------------------------------------------------------


@pytest.mark.parametrize("ratio", [0.0, 0.4])
def test_covariance_of_zernikes(ratio, covariance, grid):
    """Noll's matrix for Kolmogorov; Winker's and Takato and Yamaguchi's with outer scale."""
    x, y, weight = grid
    Z = weight[:, None] * zernike(36, x, y)[:, 1:]
    ours = Z.T @ covariance[ratio] @ Z
    n, m = (orders[1:] for orders in noll_orders(36))
    sine = np.where(m == 0, 0, np.arange(2, 37) % 2)
    same = (m[:, None] == m) & (sine[:, None] == sine)
    theirs = np.zeros((35, 35))
    for i, j in np.argwhere(same):
        theirs[i, j] = published.zernike_covariance(int(n[i]), int(n[j]), int(m[i]), ratio)
    assert ours == pytest.approx(theirs, abs=1e-5)
    assert np.diag(ours) == pytest.approx(np.diag(theirs), rel=5e-3)


# --- Zernikes ------------------------------------------------------------------------------------


def test_first_zernikes_are_those_noll_prints():
    x, y = np.random.default_rng(5).uniform(-0.7, 0.7, (2, 50))
    r, a = np.hypot(x, y), np.arctan2(y, x)
    cos, sin, root = np.cos, np.sin, np.sqrt
    printed = [
        np.ones(50),
        2 * r * cos(a),
        2 * r * sin(a),
        root(3) * (2 * r**2 - 1),
        root(6) * r**2 * sin(2 * a),
        root(6) * r**2 * cos(2 * a),
        root(8) * (3 * r**3 - 2 * r) * sin(a),
        root(8) * (3 * r**3 - 2 * r) * cos(a),
        root(8) * r**3 * sin(3 * a),
        root(8) * r**3 * cos(3 * a),
        root(5) * (6 * r**4 - 6 * r**2 + 1),
    ]
    assert zernike(11, x, y) == pytest.approx(np.transpose(printed), abs=1e-14)


@pytest.mark.parametrize(("n", "m"), [(60, 0), (60, 10), (99, 41), (120, 120)])
def test_high_orders_keep_their_digits(n, m):
    """Against the radial polynomial in exact fractions."""
    rho, half = Fraction(19, 20), (n - m) // 2
    exact = sum(
        Fraction((-1) ** s * math.factorial(n - s), math.factorial(s))
        / (math.factorial((n + m) // 2 - s) * math.factorial(half - s)) * rho ** (n - 2 * s)
        for s in range(half + 1)
    )  # fmt: skip
    count = (n + 1) * (n + 2) // 2
    orders = np.transpose(noll_orders(count))
    cosine = [j for j in np.flatnonzero((orders == (n, m)).all(axis=1)) if m == 0 or j % 2]
    ours = zernike(count, np.array([0.95]), np.zeros(1))[0, cosine[0]]
    assert ours == pytest.approx(float(exact) * math.sqrt((n + 1) * (2 if m else 1)), rel=1e-11)


# --- bases ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["p45", pytest.param("lbt672", marks=pytest.mark.study)])
def test_zernike_modes_span_the_actuators_in_order_whatever_rounding(name):
    x, y = points(name)
    n, modes = len(x), zernike_modes(x, y)
    assert modes.T @ modes == pytest.approx(np.eye(n), abs=1e-12)
    assert modes[:, 0] == pytest.approx(n**-0.5)
    Q, R = np.linalg.qr(zernike(21, x, y))  # no mirror here lacks one of these
    assert modes[:, :21] == pytest.approx(Q * np.sign(np.diag(R)), abs=1e-12)
    random = np.random.default_rng(7)
    shaken = [c * (1 + 3e-16 * random.choice([-1, 1], n)) for c in (x, y)]
    assert zernike_modes(*shaken) == pytest.approx(modes, abs=1e-8)


def test_a_zernike_that_adds_nothing_is_passed_over():
    """On a ring of six and its centre: sin 3 theta is zero there, and cos 6 theta a constant."""
    angle = np.pi / 3 * np.arange(6)
    x, y = np.append(0.8 * np.cos(angle), 0.0), np.append(0.8 * np.sin(angle), 0.0)
    modes = zernike_modes(x, y)
    assert modes.T @ modes == pytest.approx(np.eye(7), abs=1e-14)
    # Piston, tilts, focus, astigmatisms; coma is tilt, sin 3 theta nothing: then cos 3 theta.
    assert modes[:6, 6] == pytest.approx((-1.0) ** np.arange(6) / np.sqrt(6))
    assert modes[6, 6] == pytest.approx(0.0, abs=1e-14)


def test_actuators_in_one_place_are_refused():
    with pytest.raises(GeometryError, match="span only 2 of 3 actuators"):
        zernike_modes(np.array([0.1, 0.5, 0.5]), np.array([0.0, 0.2, 0.2]))


@pytest.mark.parametrize("outer_scale", [25.0, np.inf])
def test_karhunen_loeve_modes_are_independent_and_in_order(outer_scale):
    x, y = points("ring120", 4.0)
    C = wavefront_covariance(x, y, Atmosphere(0.8, outer_scale))
    modes = karhunen_loeve_modes(C)
    assert modes.T @ modes == pytest.approx(np.eye(120), abs=1e-12)
    assert np.all(modes[:, 0] == 120**-0.5)
    seen = modes.T @ C @ modes
    variance = np.diag(seen)
    assert seen == pytest.approx(np.diag(variance), abs=1e-9 * variance[1])
    assert np.all(np.diff(variance[1:]) < 2e-6 * variance[2:])
    # The first two are tilts, nearly; and no other modes hold as much variance in as few.
    zernikes = zernike_modes(x / 4, y / 4)
    assert np.linalg.svd(zernikes[:, 1:3].T @ modes[:, 1:3])[1].min() > 0.98
    held = np.cumsum(np.einsum("ij,ij->j", zernikes, C @ zernikes))
    assert np.all(np.cumsum(variance) > held - 1e-9 * held[-1])
    assert np.cumsum(variance)[30] > 1.0001 * held[30]


def test_karhunen_loeve_modes_do_not_hang_on_rounding():
    x, y = points("p45", 4.0)
    C = wavefront_covariance(x, y, Atmosphere(0.8))
    noise = np.random.default_rng(9).standard_normal(C.shape)
    shaken = karhunen_loeve_modes(C * (1 + 1e-15 * (noise + noise.T)))
    assert karhunen_loeve_modes(C) == pytest.approx(shaken, abs=1e-7)
