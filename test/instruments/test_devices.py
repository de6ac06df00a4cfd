"""What the protocols promise, of the simulated instruments and of real ones that environment variables name.

ODAK_TEST_SLM and ODAK_TEST_CAMERA hold the name of a driver and, after a space, its arguments as JSON. A real camera
must see light; with both, that of the modulator.
"""

import json
import os
import time

import numpy as np
import pytest

from odak import instruments
from odak.instruments.protocols import checked_frames


def opened(variable):
    """Return the instrument that an environment variable names; skip the test if there is none."""
    name, _, options = os.environ.get(variable, "").strip().partition(" ")
    if not name:
        pytest.skip(f"{variable} names no driver")
    return instruments.open_instrument(name, **json.loads(options or "{}"))


@pytest.fixture(params=["simulated", "real"])
def modulator(request):
    if request.param == "simulated":
        yield instruments.SimulatedTable(1, shape=(24, 32), camera_shape=(32, 40)).modulator
        return
    found = opened("ODAK_TEST_SLM")
    yield found
    getattr(found, "close", lambda: None)()


@pytest.fixture(params=["simulated", "real"])
def camera(request):
    if request.param == "simulated":
        yield instruments.SimulatedTable(1, shape=(24, 32), camera_shape=(32, 40)).camera
        return
    found = opened("ODAK_TEST_CAMERA")
    yield found
    getattr(found, "close", lambda: None)()


def test_a_modulator_shows_its_levels_and_waits(modulator):
    assert isinstance(modulator, instruments.Modulator)
    rows, columns = modulator.shape
    assert modulator.pitch > 0 and modulator.settling_time >= 0
    top = (1 << modulator.bits) - 1
    checks = np.add.outer(np.arange(rows), np.arange(columns)) % 2 * top
    ramp = np.broadcast_to(np.arange(columns) % (top + 1), (rows, columns))
    for levels in (np.zeros((rows, columns), int), checks, ramp):
        start = time.monotonic()
        modulator.show(levels.astype(np.uint8 if modulator.bits <= 8 else np.uint16))
        assert time.monotonic() - start >= modulator.settling_time


def test_a_modulator_refuses_what_it_cannot_show(modulator):
    rows, columns = modulator.shape
    with pytest.raises(ValueError, match="levels"):
        modulator.show(np.zeros((rows + 1, columns), int))
    with pytest.raises(ValueError, match="levels"):
        modulator.show(np.full((rows, columns), 1 << modulator.bits))


def test_captures_are_counts_of_the_sensor_and_of_its_region(camera):
    assert isinstance(camera, instruments.Camera) and camera.pitch > 0
    rows, columns = camera.shape
    camera.region = None
    whole = camera.capture(3)
    assert whole.shape == (3, rows, columns) and whole.dtype.kind == "u"
    assert np.array_equal(checked_frames(whole, 3, camera), whole)
    camera.region = (rows // 4, columns // 3, rows // 2, columns // 4)
    assert camera.capture(2).shape == (2, rows // 2, columns // 4)
    camera.region = None


@pytest.mark.filterwarnings("ignore::odak.AccuracyWarning")
def test_counts_are_proportional_to_the_exposure(camera):
    # Frames that are older, gamma curves and automatic gains are errors.
    instruments.set_exposure(camera)
    exposure = camera.exposure
    bright = camera.capture(8).mean(0)
    camera.exposure = exposure / 4
    quarter, share = camera.capture(8).mean(0), camera.exposure / exposure
    camera.exposure = exposure
    floor = np.quantile(bright, 0.01)
    lit = bright > floor + 0.3 * (bright.max() - floor)
    camera.exposure = exposure / 2
    half, middle = camera.capture(8).mean(0), camera.exposure / exposure
    camera.exposure = exposure
    # Slopes of both parts, in which the offset without light cancels.
    upper = (bright - half)[lit].mean() / (1 - middle)
    lower = (half - quarter)[lit].mean() / (middle - share)
    assert abs(upper / lower - 1) < 0.1


@pytest.mark.parametrize("kind", ["simulated", "real"])
def test_captures_follow_the_pattern(kind):
    if kind == "simulated":
        table = instruments.SimulatedTable(1, shape=(24, 32), camera_shape=(32, 40))
        modulator, camera = table.modulator, table.camera
    else:
        modulator = opened("ODAK_TEST_SLM")
        try:
            camera = opened("ODAK_TEST_CAMERA")
        except BaseException:
            getattr(modulator, "close", lambda: None)()
            raise
    try:
        draw = np.random.default_rng(0)
        patterns = draw.integers(1 << modulator.bits, size=(2, *modulator.shape))
        modulator.show(patterns[0])
        instruments.set_exposure(camera)
        seen = []
        for pattern in patterns[[0, 1, 0, 1, 0]]:
            modulator.show(pattern)
            seen.append(camera.capture(2).astype(float).mean(0))
        first, second, again, other, last = (frame - frame.mean() for frame in seen)
        same = min((first * again).sum() / (first**2).sum(), (again * last).sum() / (again**2).sum())
        assert same > 0.7 and (first * second).sum() / (first**2).sum() < same - 0.1
        assert (second * other).sum() / (second**2).sum() > 0.7
    finally:
        for instrument in (camera, modulator):
            getattr(instrument, "close", lambda: None)()
