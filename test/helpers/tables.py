"""Simulated tables of which calibrations see the protocols only, and errors of what they find."""

import numpy as np

from odak.instruments import spots


class Blind:
    """Instrument with the members of its protocol only, so that calibrations cannot read the true parameters."""

    def __init__(self, instrument, names):
        object.__setattr__(self, "_parts", (instrument, names))

    def __getattr__(self, name):
        instrument, names = object.__getattribute__(self, "_parts")
        if name not in names:
            raise AttributeError(name)
        return getattr(instrument, name)

    def __setattr__(self, name, value):
        instrument, names = self._parts
        assert name in names
        setattr(instrument, name, value)


def instruments_of(table):
    modulator = Blind(table.modulator, ("shape", "pitch", "bits", "settling_time", "show"))
    camera = Blind(table.camera, ("shape", "pitch", "bits", "exposure", "region", "capture"))
    return modulator, camera


class Counting:
    """Camera that counts its captures."""

    def __init__(self, camera):
        object.__setattr__(self, "camera", camera)
        object.__setattr__(self, "taken", 0)

    def __getattr__(self, name):
        return getattr(self.camera, name)

    def __setattr__(self, name, value):
        setattr(self.camera, name, value)

    def capture(self, count=1):
        object.__setattr__(self, "taken", self.taken + count)
        return self.camera.capture(count)


def fresh_seed(number):
    return int(np.random.default_rng(number).integers(10_000))


def low_modes(modulator):
    return spots.aberration_modes(modulator, 2)[[0, 1, spots.DEFOCUS]]


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


def distance_in_pixels(registration, table):
    points = np.random.default_rng(0).uniform(-0.35, 0.35, (200, 2)) * min(table.modulator.shape) * 8e-6
    seen = registration.camera_pixels(points)
    missed = (table.truth.plane_points(seen, table.camera.shape) - points) / table.camera.pitch
    return np.linalg.norm(missed, axis=-1)


SMALLER = {"shape": (108, 108), "camera_shape": (240, 240), "distance": 15e-3}
