"""The test kit finds each fault of a driver, and only it; what conforms passes."""

import gc
import mmap
import time

import numpy as np
import pytest
from laboratory import Altered

from odak import instruments


def table_of(**options):
    """Return a small table whose camera is not square and sees the light of the panel."""
    return instruments.SimulatedTable(1, shape=(32, 32), distance=4e-3, camera_shape=(48, 60), **options)


def failed(found):
    return [finding.check for finding in found if finding.passed is False]


def late(count):
    """Return a change of frames that lets each come as many frames late."""
    queue = []

    def change(frames, camera):
        queue.extend(frames)
        out = [queue[max(len(queue) - len(frames) + n - count, 0)] for n in range(len(frames))]
        return np.stack(out)

    return change


def frozen(frames, camera, last=[]):  # noqa: B006
    """Return frames of which every third repeats the one before."""
    out = []
    for frame in frames:
        last.append(frame)
        out.append(last[-2] if len(last) % 3 == 0 else frame)
    return np.stack(out)


def curved(frames, camera):
    return np.rint(4095 * (frames / 4095) ** 0.6).astype(np.uint16)


class Whole(Altered):
    """Camera whose region is cut from the whole frame, at another place or with its axes exchanged."""

    def __init__(self, camera, order):
        super().__init__(camera, None)
        self.__dict__.update(region=None, order=order)

    def __setattr__(self, name, value):
        self.__dict__.update({name: value}) if name == "region" else super().__setattr__(name, value)

    def capture(self, count=1):
        frames = self.camera.capture(count)
        if self.region is None:
            return frames
        row, column, rows, columns = np.array(self.region)[list(self.order)]
        return frames[:, row : row + rows, column : column + columns]


class Exposed(Altered):
    """Camera that takes another exposure than it reports."""

    def __init__(self, camera, taken):
        super().__init__(camera, None)
        self.__dict__.update(asked=camera.exposure, taken=taken)

    @property
    def exposure(self):
        return self.asked

    def __setattr__(self, name, value):
        if name == "exposure":
            self.__dict__["asked"] = value
            value = self.taken(value)
        setattr(self.camera, name, value)

    def capture(self, count=1):
        return self.camera.capture(count)


def leaking(keep):
    """Return a change of frames that takes a megabyte with each, and how often it was called."""
    kept = []

    def change(frames, camera):
        kept.append(keep())
        return frames

    return change, kept


def mapped():
    """Return memory that the process takes from the system, and of which Python does not know."""
    block = mmap.mmap(-1, 1 << 20, **({"flags": mmap.MAP_PRIVATE} if hasattr(mmap, "MAP_PRIVATE") else {}))
    block[:] = b"1" * (1 << 20)
    return block


class Ring:
    """What is only freed when garbage is collected."""

    def __init__(self, size):
        self.data, self.ring = np.ones(size), self


FAULTS = {
    "late frames": ("late frames", lambda camera: Altered(camera, late(2))),
    "frozen frames": ("captures", lambda camera: Altered(camera, frozen)),
    "gamma": ("gamma", lambda camera: Altered(camera, curved)),
    "data shifted to the upper bits": ("frames", lambda camera: Altered(camera, lambda f, _: f << 4)),
    "data shifted within the bits": ("frames", lambda camera: Altered(camera, lambda f, _: f << 4, bits=16)),
    "more bits stated": ("bit depth", lambda camera: Altered(camera, lambda f, _: f, bits=14)),
    "fewer bits stated": ("bit depth", lambda camera: Altered(camera, lambda f, _: f, bits=10)),
    "rows and columns exchanged": ("orientation", lambda camera: Altered(camera, lambda f, _: f.swapaxes(1, 2))),
    "region exchanged": ("region", lambda camera: Whole(camera, (1, 0, 2, 3))),
    "size of region exchanged": ("region", lambda camera: Whole(camera, (0, 1, 3, 2))),
    "exposure ignored": ("exposure", lambda camera: Exposed(camera, lambda seconds: 0.2)),
    "exposure in steps": ("exposure", lambda camera: Exposed(camera, lambda s: max(0.1 * int(s / 0.1), 0.1))),
    "limit in silence": ("exposure", lambda camera: Exposed(camera, lambda s: max(s, 0.15))),
    "memory": ("captures", lambda camera: Altered(camera, leaking(lambda: np.ones(1 << 17))[0])),
    "memory of a library": ("captures", lambda camera: Altered(camera, leaking(mapped)[0])),
    "dark": ("frames", lambda camera: Altered(camera, lambda f, _: np.full_like(f, 20))),
    "one frame for several": ("frames", lambda camera: Altered(camera, lambda f, _: f[:1])),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_each_fault_of_a_camera_is_found_and_only_it(fault):
    check, altered = FAULTS[fault]
    table = table_of()
    found = instruments.check_instruments(altered(table.camera), captures=40)
    assert failed(found) == [check], found
    (finding,) = (one for one in found if one.passed is False)
    assert finding.found and finding.remedy


@pytest.mark.parametrize("fault", [True, False])
def test_other_work_of_the_process_does_not_change_what_is_found_of_its_memory(fault, monkeypatch):
    """Garbage that is freed hides no loss, and memory that is taken once, or is garbage, is none."""
    change, kept = leaking(lambda: np.ones(1 << 17) if fault else Ring(1 << 17))
    once, many = [], instruments.conformance._many

    def work(frames, camera):
        if len(kept) == 35:
            gc.collect()
            once.append(np.ones(0 if fault else 1 << 23))
        out = change(frames, camera)
        if not fault:
            kept[-1] = None
        return out

    def begin(bench):
        kept.clear()
        for _ in range(8 * fault):
            Ring(1 << 20)
        return many(bench)

    monkeypatch.setitem(instruments.conformance.CAMERA, "captures", (begin, "frames"))
    found = instruments.check_instruments(Altered(table_of().camera, work), captures=40)
    assert once
    assert failed(found) == ["captures"] * fault, found


class Slow:
    """Modulator whose pattern is seen some captures after it was shown, unless it waits."""

    def __init__(self, table, **members):
        self.table, self.settling_time = table, 0.0
        self.shape, self.pitch, self.bits = table.modulator.shape, table.modulator.pitch, 8
        self.__dict__.update(members)

    def show(self, levels):
        self.table.modulator.show(levels)


@pytest.mark.parametrize(
    ("fault", "check"), [("settling", "patterns"), ("wraps", "levels"), ("blind", "patterns"), ("members", "levels")]
)
def test_each_fault_of_a_modulator_is_found_and_only_it(fault, check):
    table = table_of(time_constant=0.3 if fault == "settling" else 0.0)
    modulator = table.modulator
    if fault == "settling":
        modulator.settling_time = 0.0
    elif fault != "settling":
        modulator = Slow(table)
    if fault == "wraps":
        modulator.show = lambda levels: table.modulator.show(np.resize(levels, (32, 32)) % 256)
    if fault == "blind":
        shown = np.random.default_rng(3).integers(256, size=(32, 32))
        real = modulator.show
        modulator.show = lambda levels: (real(levels), table.modulator.show(shown))[0]
    if fault == "members":
        del modulator.settling_time
    found = instruments.check_instruments(table.camera, modulator, captures=20)
    assert failed(found) == [check], found


def test_what_conforms_passes_and_is_restored():
    table = table_of()
    table.camera.region, before = (3, 4, 20, 21), table.camera.exposure
    # The time of this process, not of a machine that does other things too.
    start = time.process_time()
    found = instruments.check_instruments(table.camera, table.modulator, captures=50)
    assert all(finding.passed for finding in found), found
    assert {finding.check for finding in found} >= {"levels", "frames", "gamma", "region", "patterns", "captures"}
    assert table.camera.region == (3, 4, 20, 21) and table.camera.exposure == before
    assert time.process_time() - start < 60
    with pytest.raises(ValueError, match="camera or modulator must be given"):
        instruments.check_instruments()
