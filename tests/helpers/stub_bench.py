"""A bench that answers at once, for tests of acquisition: linear, noisy, and spoilt as told."""

import dataclasses
import datetime
import zlib

import numpy as np

from helpers.shells import stiffness
from truenewton.bench.protocol import Reading, Status
from truenewton.errors import BenchFault
from truenewton.mirrors.known import ring

START = datetime.datetime(2026, 5, 4, 9, 30, tzinfo=datetime.UTC)
SMALL = ring(8)
MODEL = stiffness(SMALL.shell, SMALL.layout.x, SMALL.layout.y)


class StubBench:
    """8 actuators; c = (z K + f_load) / alpha + noise, which load, cycle, shape and sign decide.

    ``spoil(shape, reading)`` may change any reading or raise; ``put(load)`` says which load is
    really on after someone was asked for one.
    """

    instrument, layout, gap = SMALL.name, SMALL.layout, SMALL.gap

    def __init__(self, *, stiffer=1.0, rest=0.02, noise=1e-4, spoil=None, put=None):
        random = np.random.default_rng(11)
        self.alpha = random.uniform(0.9, 1.1, 8)
        self.stiffness, self.rest_force, self.noise = stiffer * MODEL, rest, noise
        self.spoil = spoil or (lambda shape, reading: reading)
        self.put = put or (lambda load: load)
        self.load, self.shape, self.counter, self.resting = None, None, 0, 0
        self.commanded, self.read_of, self.asked = [], [], []

    def put_on(self, load):
        self.asked.append(load.name)
        self.load = self.put(load)

    def wait(self, seconds):
        pass

    def exact(self, shape):
        """Return the commanded forces that a shape takes, without noise."""
        true = shape.position @ self.stiffness + self.rest_force - self.load.added / 8
        return true / self.alpha

    def command(self, shape):
        self.commanded.append(shape)
        self.shape = shape

    def read(self, samples):
        shape = self.shape
        place = [zlib.crc32(shape.load.key.encode()), shape.cycle, shape.number, shape.sign + 1]
        noise = np.random.default_rng(place).standard_normal(16)
        self.counter += 1
        self.read_of.append((shape.load.key, shape.cycle, shape.number, shape.sign))
        reading = Reading(
            time=START + datetime.timedelta(seconds=0.5 * self.counter),
            force=self.exact(shape) + self.noise * noise[:8],
            position=shape.position + 1e-10 * noise[8:],
            force_scatter=np.full(8, self.noise * np.sqrt(samples)),
            position_scatter=np.full(8, 1e-10 * np.sqrt(samples)),
            temperature=20.0,
            counter=self.counter,
            settled=True,
        )
        return self.spoil(shape, reading)

    def status(self):
        return Status(True, "well", self.counter)

    def rest(self):
        self.resting += 1
        self.shape = None


def at(place, change):
    """Return a spoiler that changes the readings of one (load, cycle, shape, sign)."""

    def spoil(shape, reading):
        here = (shape.load.name, shape.cycle, shape.number, shape.sign)
        return change(reading) if here == place else reading

    return spoil


def altered(**values):
    return lambda reading: dataclasses.replace(reading, **values)


class Looker:
    """An onlooker who remembers what was told."""

    def __init__(self):
        self.told, self.lines = [], []

    def progress(self, now):
        self.told.append(now)

    def say(self, line):
        self.lines.append(line)


class Hands(StubBench):
    """A bench on which somebody must put the loads."""

    put_on = None


class GoneBench(StubBench):
    """A server that goes away at a reading, and comes back after so many looks at it."""

    def __init__(self, looks, at=5, **keywords):
        super().__init__(**keywords)
        self.looks, self.at = looks, at

    def read(self, samples):
        if self.counter == self.at and self.looks:
            raise BenchFault("connection lost")
        return super().read(samples)

    def status(self):
        if self.counter == self.at and self.looks:
            self.looks -= 1
            raise BenchFault("connection refused")
        return super().status()
