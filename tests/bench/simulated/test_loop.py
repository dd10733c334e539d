"""The closed loop against other solutions: transfer functions, differential equations, statics."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.signal import cont2discrete, lfilter

from helpers.shells import condense, influence
from truenewton.bench.simulated.loop import (
    CREEP_TIMES,
    MAX_DRIFT,
    RAMP_TIME,
    Coils,
    Control,
    Loop,
    Sensors,
    advance,
    draw_sensors,
    equilibrium,
    record,
    row_noise,
    samples_of,
    slowest_creep,
)
from truenewton.errors import BenchFault, LoopUnstable
from truenewton.mirrors.known import GRAVITY, p45
from truenewton.statics.arms import arms
from truenewton.statics.modes import stiffness_modes

PERIOD = 1 / 71.6e3
GAP = 68e-6
COUNT = GAP**2 * 2.0 / (65e-6 * 65536)  # that one count means [m]
SMOOTH = {"dac_step": 1e-15, "driver_noise": 0.0}  # of coils
SHARP = {"noise": 0.0, "codes": 2**40}  # of sensors


def one_mode(k=2e5, mass=6.6e-3, damping=64.0, alpha=0.8, gain=1.05, **changes):
    """Return the loop of one actuator on a spring, linear and without noise."""
    return closed_loop(
        np.array([[k]]),
        np.array([[mass]]),
        np.array([[damping]]),
        Coils(np.array([alpha]), coil_gradient=0.0, **SMOOTH),
        Sensors(np.array([gain]), np.array([2e-7]), GAP, **SHARP),
        Control(np.array([[0.9 * k]]), **changes),
    )


def closed_loop(k, mass, damping, coils, sensors, control):
    """Return the loop around a glass."""
    softer = k - coils.bias_gradient * np.eye(len(k))
    return Loop(softer, mass, damping, coils, sensors, control)


def p45_parts(seed=1):
    """Return K, M, C, coils, sensors and control of something like P45, flat, its mass lumped."""
    mirror, random = p45(), np.random.default_rng(seed)
    n = mirror.layout.n
    at = (mirror.layout.x, mirror.layout.y)
    k = condense(influence(mirror.shell, at, at), arms(mirror.layout)).stiffness
    mass = np.full(n, -mirror.weight / GRAVITY / n)
    coils = Coils(random.uniform(*mirror.alpha_range, n))
    sensors = draw_sensors(n, mirror.gap, random)
    held = k - coils.bias_gradient * np.eye(n)
    control = Control(held / coils.alpha[:, None] * sensors.gain)
    return k, np.diag(mass), 64.0 * np.eye(n), coils, sensors, control


@pytest.fixture(scope="module")
def p45_loop():
    return closed_loop(*p45_parts())


@pytest.fixture(scope="module")
def p45_shapes():
    modes = stiffness_modes(p45_parts()[0]).modes
    force = np.abs(p45_parts()[0] @ modes).max(axis=0)
    return modes * np.minimum(1e-6 / np.abs(modes).max(axis=0), 0.25 / np.maximum(force, 1.0))


LOAD = (2.92 / 45 - 0.097) * np.linspace(0.8, 1.2, 45)[:, None]


def transfer_functions(loop, k, mass, damping):
    """Return numerators and denominators in 1/z of glass (force to z), slow filter, derivative.

    Made by other means than the loop's: scipy's zero-order hold, poles and zeros in the z plane.
    """
    control = loop.control
    b, a, _ = cont2discrete(
        ([1.0], [mass, damping, k - loop.coils.bias_gradient]), PERIOD, method="zoh"
    )
    glass = b[0], a
    p = np.exp(-2 * np.pi * control.derivative_pole * PERIOD)
    derivative = np.array([1.0, -1.0]) * (1 - p) ** 2 / PERIOD, np.array([1.0, -2 * p, p**2])
    q = np.exp(-2 * np.pi * control.slow_corner / control.slow_gain * PERIOD)
    slow = np.array([1.0 + (control.slow_gain - 1) * (1 - q), -q]), np.array([1.0, -q])
    return glass, slow, derivative


def loop_polynomials(loop, k, mass, damping):
    """Return the polynomials of c = F K_c z_c + k_p L (z_c - y) - k_d D y and z = P alpha c / z^d.

    As numerators over one denominator of z: from the feed-forward, from the commanded position.
    """
    (pb, pa), (lb, la), (db, da) = transfer_functions(loop, k, mass, damping)
    forward = loop.coils.alpha[0] * np.append(np.zeros(loop.control.delay), pb)
    back = loop.control.proportional * np.convolve(lb, da)
    rate = loop.control.derivative * np.convolve(db, la)
    filters = np.convolve(la, da)
    answer = np.convolve(forward, added(back, rate)) / loop.sensors.gain[0]
    denominator = added(np.convolve(pa, filters), answer)
    return np.convolve(forward, filters), np.convolve(forward, back), denominator


def added(a, b):
    """Add polynomials in 1/z, constant first."""
    total = np.zeros(max(len(a), len(b)))
    total[: len(a)] += a
    total[: len(b)] += b
    return total


@pytest.mark.parametrize("delay", [0, 1, 3])
def test_one_actuator_answers_a_step_as_its_transfer_functions_say(delay):
    k, mass, damping, size = 2e5, 6.6e-3, 64.0, 1e-6
    loop = one_mode(k, mass, damping, delay=delay)
    steps, time = 1000, np.arange(1000) * PERIOD
    walk = samples_of(loop, np.array([[size]]), np.zeros((1, 1)), (), steps)
    found = np.array([z.item() for _, _, z in walk])
    by_force, by_position, denominator = loop_polynomials(loop, k, mass, damping)
    half_cosine = [(1 - np.cos(np.pi * np.clip(time / t, 0, 1))) / 2 for t in (7.5e-4, 1e-4)]
    expected = lfilter(by_force, denominator, 0.9 * k * size * half_cosine[0])
    expected += lfilter(by_position, denominator, size * half_cosine[1])
    assert np.abs(found - expected).max() < 1e-7 * size
    assert found[-1] > 0.8 * size


def test_the_glass_moves_as_its_differential_equation_says():
    random = np.random.default_rng(1)
    mass, damping, k = (
        scale * (np.eye(3) + 0.2 * (half := random.standard_normal((3, 3))) @ half.T)
        for scale in (6e-3, 64.0, 1e6)
    )
    force, start = random.standard_normal(3), random.standard_normal(6) * 1e-6
    start[3:] *= 1e3

    def rate(_, x):
        return np.append(x[3:], np.linalg.solve(mass, force - damping @ x[3:] - k @ x[:3]))

    exact = solve_ivp(rate, (0, PERIOD), start, rtol=1e-12, atol=1e-18).y[:, -1]
    before = np.concatenate([start[:3], PERIOD * start[3:], force])
    after = advance(k, mass, damping, PERIOD) @ before
    assert after[:3] == pytest.approx(exact[:3], rel=1e-9)
    assert after[3:] == pytest.approx(PERIOD * exact[3:], rel=1e-8)


def test_an_unstable_loop_stops_itself(p45_loop, p45_shapes):
    wild = replace(p45_loop, control=replace(p45_loop.control, derivative=600.0))
    noise = [row_noise(1, "bare", 1, k, 1) for k in range(45)]
    with pytest.raises(BenchFault, match=r"actuator \d+ (is asked for|touches)"):
        record(wild, 0 * p45_shapes, LOAD, noise)


def test_noise_that_grows_stops_the_run():
    loop = one_mode(k=2e5)
    wild = replace(
        loop,
        control=replace(loop.control, derivative=535.0),
        coils=replace(loop.coils, saturation=np.inf),
        sensors=replace(loop.sensors, noise=1e-11),
    )
    zero, noise = np.zeros((1, 1)), [row_noise(1, "bare", 1, 1, 1)]
    with pytest.raises(LoopUnstable, match="the noise of actuator 0 in shape 0 grows"):
        record(wild, zero, zero, noise, settling=0.05)


def test_a_shape_beyond_the_coils_or_through_the_gap_stops_the_run(p45_loop, p45_shapes):
    stiff = p45_shapes[:, -2:] * [1.0, 4.0]
    with pytest.raises(BenchFault, match=r"is asked for .* in shape 1, 0\.\d+ ms after"):
        record(p45_loop, stiff, LOAD)
    strong = replace(p45_loop, coils=replace(p45_loop.coils, saturation=1e3))
    with pytest.raises(BenchFault, match="touches the plate or is too near"):
        record(strong, np.full((45, 1), 40e-6), LOAD)


def test_at_rest_the_true_forces_are_those_of_statics(p45_loop, p45_shapes):
    """f = (K - dB/dz) z + load, all but rounding to steps; and the loop ends where it should."""
    quiet = replace(
        p45_loop,
        coils=replace(p45_loop.coils, **SMOOTH, temperature=np.linspace(15.0, 25.0, 45)),
        sensors=replace(p45_loop.sensors, **SHARP),
    )
    found = record(quiet, p45_shapes, LOAD, samples=512)
    true_position = quiet.sensors.gain[:, None] * (found.position - quiet.sensors.offset[:, None])
    warmer = 1 - 1.1e-3 * np.linspace(-5.0, 5.0, 45)
    true = quiet.coils.alpha[:, None] * found.force * warmer * (1 + 600 * true_position)
    k = p45_parts()[0]
    expected = k @ true_position - 31.0 * true_position + LOAD
    assert np.abs(true - expected).max() < 5e-9  # of 0.3 N
    assert np.abs(expected).max() > 0.2
    z, force = equilibrium(quiet, p45_shapes, LOAD)
    assert true_position == pytest.approx(z, abs=2e-12)
    assert found.force == pytest.approx(force, abs=1e-8)
    assert found.settled.all()
    # Weight and bias balance the record: nothing else holds the mirror up.
    total = arms(p45().layout) @ (true + 31.0 * true_position)
    assert total == pytest.approx(np.tile(arms(p45().layout) @ LOAD, (1, 45)), abs=1e-7)


def test_the_error_of_a_mean_force_is_what_its_autocorrelation_makes_of_sensor_noise():
    """The mean is a sum over all past noise, weighted by the loop's impulse response."""
    k, mass, damping, batch, samples, wait = 6e5, 6.6e-3, 64.0, 500, 2048, 1432
    loop = one_mode(k, mass, damping)
    noisy = replace(loop, sensors=replace(loop.sensors, noise=3e-9))
    noise = [row_noise(1, "bare", 1, j, 1) for j in range(batch)]
    found = record(noisy, np.zeros((1, batch)), np.zeros((1, 1)), noise, settling=wait * PERIOD)
    # c = -(k_p L + k_d D) (y + noise): noise to c is -P^-1 z^d / alpha of noise to z.
    (_, pa), (lb, la), (db, da) = transfer_functions(loop, k, mass, damping)
    answer = added(130e3 * np.convolve(lb, da), 30.0 * np.convolve(db, la))
    denominator = loop_polynomials(loop, k, mass, damping)[2]
    impulse = np.zeros(wait + samples)
    impulse[0] = 1.0
    response = -lfilter(np.convolve(answer, pa), denominator, impulse)
    summed = np.concatenate([[0.0], np.cumsum(response)])
    age = np.arange(wait + samples)  # of each sample of noise, at the end of the record
    weight = (summed[age + 1] - summed[np.maximum(age + 1 - samples, 0)]) / samples
    expected = 3e-9 * np.sqrt(np.sum(weight**2))
    assert found.force.std() == pytest.approx(expected, rel=4.5 / np.sqrt(2 * batch))
    scatter = 3e-9 * np.sqrt(np.sum(response**2))
    assert found.force_scatter.mean() == pytest.approx(scatter, rel=0.01)
    # As if samples were independent would be wrong by a factor of five at least.
    assert expected < 0.2 * scatter / np.sqrt(samples)
    assert 2e-6 < expected < 2e-5


@pytest.mark.parametrize("source", ["sensor", "driver"])
def test_noise_of_sensor_and_driver_enter_where_they_should(source):
    """And each takes its own random numbers of the row."""
    k, mass, damping = 6e5, 6.6e-3, 64.0
    loop = one_mode(k, mass, damping)
    loop = replace(
        loop,
        coils=replace(loop.coils, driver_noise=30e-6 * (source == "driver")),
        sensors=replace(loop.sensors, noise=3e-9 * (source == "sensor")),
    )
    zero = np.zeros((1, 1))
    walk = samples_of(loop, zero, zero, [row_noise(1, "bare", 1, 1, 1)], 400)
    found = np.array([z.item() for _, _, z in walk])
    drawn = row_noise(1, "bare", 1, 1, 1).standard_normal((400, 2))
    (pb, _), (lb, la), (db, da) = transfer_functions(loop, k, mass, damping)
    by_force, _, denominator = loop_polynomials(loop, k, mass, damping)
    if source == "sensor":  # noise of distance: the glass seems lower
        answer = added(130e3 * np.convolve(lb, da), 30.0 * np.convolve(db, la))
        late = loop.coils.alpha[0] * np.append([0.0], pb)
        expected = lfilter(np.convolve(late, answer), denominator, 3e-9 * drawn[:, 0])
    else:  # it does not wait for the computation
        expected = lfilter(by_force[loop.control.delay :], denominator, 30e-6 * drawn[:, 1])
    assert found == pytest.approx(expected, abs=1e-4 * expected.std())


def test_each_shape_needs_its_own_noise(p45_loop, p45_shapes):
    with pytest.raises(ValueError, match="1 generators of noise for 45 shapes"):
        record(p45_loop, p45_shapes, LOAD, [row_noise(1, "bare", 1, 1, 1)])


def test_mean_and_scatter_are_those_of_the_samples(p45_loop, p45_shapes):
    shapes, count = p45_shapes[:, [5, 40]], 301

    def noise():
        return [row_noise(1, "bare", 1, k, 1) for k in (5, 40)]

    found = record(p45_loop, shapes, LOAD, noise(), settling=0.01, samples=count)
    held = round((RAMP_TIME + CREEP_TIMES * slowest_creep(p45_loop)) / PERIOD)
    assert 0 < held < 716
    walk = samples_of(p45_loop, shapes, np.tile(LOAD, 2), noise(), 716 + count, held=held)
    samples = [(c, y) for c, y, _ in walk][716:]
    force, position = np.array(samples).swapaxes(0, 1)
    assert found.force == pytest.approx(force.mean(axis=0), rel=1e-12)
    assert found.force_scatter == pytest.approx(force.std(axis=0), rel=1e-9)
    assert found.position_scatter == pytest.approx(position.std(axis=0), rel=1e-6)
    half = (count + 1) // 2
    drift = position[half:].mean(axis=0) - position[:half].mean(axis=0)
    assert np.array_equal(found.settled, np.abs(drift).max(axis=0) <= MAX_DRIFT)
    steps = force / 41.6e-6
    assert steps == pytest.approx(np.rint(steps), abs=1e-6)  # what the DAC was told
    assert np.ptp(steps) > 10


def test_a_record_taken_too_soon_has_not_settled(p45_loop, p45_shapes):
    soft = p45_shapes[:, 3:4]  # 1 um
    assert not record(p45_loop, soft, LOAD, settling=0.5e-3, samples=512).settled
    assert record(p45_loop, soft, LOAD, samples=512).settled
