"""Campaigns that several test files share."""

import datetime
import os
import sys
from pathlib import Path
from typing import NamedTuple

# Of small matrices threads make everything slower, and workers share the cores already.
os.environ["OPENBLAS_NUM_THREADS"] = os.environ["OMP_NUM_THREADS"] = "1"

import numpy as np
import pytest
import scipy.linalg
from hypothesis import settings

from helpers.balanced import p45_campaign
from truenewton.bench.simulated.static import run_cycles, static_bench
from truenewton.calibration.methods import calibrate
from truenewton.cli import terminal
from truenewton.cli.main import main
from truenewton.mirrors.known import p45
from truenewton.reading import read
from truenewton.records.cycle import Cycle
from truenewton.records.file import write_campaign
from truenewton.report.findings import investigate
from truenewton.statics.layout import Layout, rings
from truenewton.statics.load import Load

settings.register_profile("thorough", max_examples=20_000)
settings.register_profile("usual", max_examples=250)
settings.load_profile("usual")


class Tiny(NamedTuple):
    """Two cycles of a mirror of 12 actuators, balanced exactly by known alpha, B and torques."""

    layout: Layout
    cycles: tuple[Cycle, Cycle]
    alpha: np.ndarray
    bias_force: float
    torques: np.ndarray  # (2, 2): M_y, M_x of the bare and the ring load


@pytest.fixture(scope="session")
def tiny() -> Tiny:
    random = np.random.default_rng(7)
    layout = rings([0.03, 0.07], [4, 8])
    alpha = random.uniform(0.8, 1.2, 12)
    bias_force, torques = 0.4, np.array([[0.003, -0.002], [0.005, 0.001]])
    arms = np.stack([layout.nz, layout.x, layout.y])
    elastic = 0.3 * scipy.linalg.null_space(arms) @ random.standard_normal((9, 12))
    shape, sign = np.repeat(np.arange(1, 13), 2), np.tile([1, -1], 12)
    cycles = []
    for place, load in enumerate((Load("bare"), Load("ring", -0.5, 0.005, tool="ring A"))):
        torque_y, torque_x = torques[place]
        k = np.array([-3.0 + load.added + bias_force, torque_y, -torque_x])
        true_force = sign[:, None] * elastic.T[shape - 1] - np.linalg.pinv(arms) @ k
        cycles.append(
            Cycle(
                instrument="TINY",
                date=datetime.datetime(2026, 5, 4, 9 + place, 30, tzinfo=datetime.UTC),
                number=1,
                load=load,
                weight=-3.0,
                weight_error=0.005,
                layout=layout,
                time=0.5 * np.arange(1, 25),
                shape=shape,
                sign=sign,
                force=true_force / alpha,
                valid=np.ones(24, dtype=bool),
                temperature=20.0 + 0.01 * np.arange(24),
                position=1e-6 * random.standard_normal((24, 12)),
            )
        )
    return Tiny(layout, tuple(cycles), alpha, bias_force, torques)


@pytest.fixture(scope="session")
def p45_folder(tmp_path_factory):
    """P45 without and with the ring, two cycles a load, noise 0.1 mN."""
    folder = tmp_path_factory.mktemp("p45") / "campaign"
    write_campaign(run_cycles(static_bench(p45(), 1, force_noise=1e-4), 2), folder)
    return folder


@pytest.fixture(scope="session")
def p45_calibration():
    """P45 in four cycles at 1 mN (helpers.balanced.p45_campaign), calibrated; never changed."""
    return calibrate(p45_campaign())


@pytest.fixture(scope="session")
def lbt672_folder():
    """The folder of the only measured mirror, which is not part of the repository."""
    if "TRUENEWTON_REAL_DATA" not in os.environ:
        pytest.skip("TRUENEWTON_REAL_DATA, the folder of measured matrices, is not set")
    return Path(os.environ["TRUENEWTON_REAL_DATA"]) / "lbt672"


@pytest.fixture(scope="session")
def real_matrix(lbt672_folder):
    return read(lbt672_folder / "lbt672-feedforward.fits")


@pytest.fixture(scope="session")
def p45_findings():
    """What a report shows of P45 in two cycles at 1 mN; never changed."""
    return investigate(p45_campaign(2), diameter=2.13, efficiency=0.51)


class Inside:
    """The command line in process; lines are not wrapped, so that a test finds its words on one."""

    def __init__(self, capsys, monkeypatch):
        self.capsys, self.monkeypatch = capsys, monkeypatch
        monkeypatch.setattr(terminal, "WIDTH", 10_000)

    def __call__(self, *arguments):
        """Return exit code, stdout and stderr."""
        self.monkeypatch.setattr(sys, "argv", ["truenewton", *map(str, arguments)])
        with pytest.raises(SystemExit) as stop:
            main()
        return stop.value.code, *self.capsys.readouterr()

    def prints(self, *arguments):
        """Return what is printed by a command that succeeds."""
        code, out, error = self(*arguments)
        assert (code, error) == (0, "")
        return out

    def refuses(self, *arguments):
        """Return the one line of a refusal."""
        code, out, error = self(*arguments)
        assert (code, out, error.count("\n")) == (2, "", 1), error
        assert error.startswith("truenewton: ")
        return error


@pytest.fixture
def inside(capsys, monkeypatch):
    return Inside(capsys, monkeypatch)


@pytest.fixture(autouse=True)
def no_open_figures():
    """Close what a test drew as a user would: pyplot keeps figures open, and warns of many."""
    yield
    if "matplotlib.pyplot" in sys.modules:
        sys.modules["matplotlib.pyplot"].close("all")
