"""Each constant that decides about data: a case just below, and a case just above."""

from types import SimpleNamespace

import numpy as np

import truenewton as tn
from helpers.balanced import START
from helpers.thresholds import between, outcome
from truenewton.modal.bases import zernike_modes
from truenewton.modal.findings import ModalFindings, compare_modes
from truenewton.modal.measured_stiffness import Products, _along_rigid, stiffness_of
from truenewton.modal.modal_base import Budget, dissipation
from truenewton.modal.true_stiffness import off_and_slaved
from truenewton.modal.turbulence import Atmosphere, Pupil
from truenewton.statics.arms import arms_in_units_of_rms
from truenewton.statics.layout import rings


def zernike_of_second_mode(half):
    """Of two points at -half and half: Z2 adds 2 half, Z8 with the other sign, 5.7 half, ..."""
    modes = zernike_modes(np.array([-half, half]), np.zeros(2))
    return "Z2" if modes[1, 1] > 0 else "Z8"


def two_points(half):
    """With 16 Zernikes for 2 points, the largest part along x is that of Z16, 10.4 half."""
    return outcome(lambda: zernike_modes(np.array([-half, half]), np.zeros(2)))


def cuts_pair(*stiffness):
    return bool(compare_modes(np.eye(3), np.eye(3), np.array(stiffness)).cuts[0])


def modal_warnings(misfit):
    measured = SimpleNamespace(warnings=(), misfit=misfit)
    found = SimpleNamespace(
        measured=measured, calibration=SimpleNamespace(effects=()),
        asymmetry=(1.0, 0.1), imbalance=(1.0, 0.1), doubts=(),
    )  # fmt: skip
    return len(ModalFindings.warnings.fget(found))


def compares(n):
    after = SimpleNamespace(layout=SimpleNamespace(n=n))
    return ModalFindings.compares.fget(SimpleNamespace(after=after))


def modes_within_force(limit):
    """Unit displacements of variance 1 (surface 1/4), mode N needs N newtons: N <= 2/3 limit."""
    commanded = np.ones(5, dtype=bool)
    stiffness = SimpleNamespace(
        commanded=commanded, displaced=lambda v: v, enabled_alpha=np.ones(5),
        acting_stiffness=np.diag([1.0, 2.0, 3.0, 4.0, 5.0]),
    )  # fmt: skip
    seen = SimpleNamespace(wavefront=np.eye(5))
    cost = dissipation("any", np.eye(5), stiffness, seen, np.zeros(5), None)
    return cost.modes_within(Budget(force=limit))


LAYOUT = rings([0.03, 0.07], [4, 8])
RIGID = np.linalg.qr(arms_in_units_of_rms(LAYOUT).T, mode="complete")[0]  # the first three


def measured(amplitude, reading):
    """Outcome for 60 shapes, one elastic motion of an amplitude relative to the largest."""
    random = np.random.default_rng(1)
    cycle = tn.Cycle(
        instrument="TINY", date=START, number=1, load=tn.Load("bare"), weight=-3.0,
        weight_error=0.0, layout=LAYOUT, time=np.arange(24.0), shape=np.repeat(np.arange(1, 13), 2),
        sign=np.tile([1, -1], 12), force=random.standard_normal((24, 12)),
        valid=np.ones(24, dtype=bool), position=1e-6 * random.standard_normal((24, 12)),
    )  # fmt: skip
    sums = Products(12)
    size = np.ones(12)
    size[-1] = amplitude
    sums.zz = RIGID @ np.diag(size**2) @ RIGID.T
    sums.cz = 2e6 * sums.zz
    reader = SimpleNamespace(
        positioned=(cycle,), sound=tn.Campaign((cycle,)), rejected=(), within=Products(12),
        between=lambda: (sums, 60, reading), spare=0, rows=60, weight=np.ones(60),
    )  # fmt: skip
    return outcome(lambda: stiffness_of(reader))


def without_repeats(amplitude):
    return measured(amplitude, np.nan)


def without_noise(amplitude):
    return measured(amplitude, 0.0)


def with_noise(signal_to_noise):
    return measured(signal_to_noise * 0.01, (0.01 / (60**0.5 + 12**0.5)) ** 2)


def missing_direction(cosine):
    direction = cosine * RIGID[:, :1] + np.sqrt(1 - cosine**2) * RIGID[:, 5:6]
    return outcome(lambda: _along_rigid(direction, LAYOUT, True))


def left_to_command(count):
    return outcome(lambda: off_and_slaved(LAYOUT, LAYOUT.id[count:].tolist(), ()))


def seeing(value):
    return outcome(lambda: Atmosphere(seeing=value))


def outer_scale(value):
    return outcome(lambda: Atmosphere(outer_scale=value))


def diameter(value):
    return outcome(lambda: Pupil(1.0, value))


CASES = [
    ("MIN_NEW_RMS", zernike_of_second_mode, 0.049, "Z8", 0.051, "Z2"),
    ("MAX_TRIED", two_points, 0.0090, "refused", 0.0105, "accepted"),
    ("MAX_PAIR_DIFFERENCE", lambda x: cuts_pair(1.0, x, 9.0), 1.009, True, 1.011, False),
    ("MAX_MISFIT", modal_warnings, 1.99, 0, 2.01, 1),
    ("MAX_COMPARED", compares, 1000, True, 1001, False),
    ("FORCE_SIGMAS", modes_within_force, 4.49, 2, 4.51, 3),
    ("MIN_AMPLITUDE_WITHOUT_REPEATS", without_repeats, 2.9e-3, "refused", 3.1e-3, "accepted"),
    ("MIN_AMPLITUDE", without_noise, 0.9e-5, "refused", 1.1e-5, "accepted"),
    ("MIN_SIGNAL_TO_NOISE", with_noise, 2.9, "refused", 3.1, "accepted"),
    ("MIN_COSINE", missing_direction, 0.09, "refused", 0.11, "accepted"),
    ("MIN_ACTUATORS", left_to_command, 3, "refused", 4, "accepted"),
    ("MIN_SEEING", seeing, 0.9e-3, "refused", 1.1e-3, "accepted"),
    ("MAX_SEEING", seeing, 29.9, "accepted", 30.1, "refused"),
    ("MIN_OUTER_SCALE", outer_scale, 0.9e-2, "refused", 1.1e-2, "accepted"),
    ("MIN_DIAMETER", diameter, 0.9e-3, "refused", 1.1e-3, "accepted"),
    ("MAX_DIAMETER", diameter, 99.0, "accepted", 101.0, "refused"),
]

test_a_threshold_is_between = between(CASES)
