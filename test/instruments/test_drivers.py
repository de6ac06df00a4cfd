"""Drivers that need no library of a maker: a screen, a video camera, files in a shared folder."""

import contextlib
import os
import re
import shutil
import subprocess
import sys
import types
from pathlib import Path

import numpy as np
import pytest
from shared_folder import served

import odak
from odak import instruments


def test_a_pattern_fills_the_screen(monkeypatch):
    pygame = pytest.importorskip("pygame", reason="pygame-ce is not installed")
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    with pytest.raises(ValueError, match="there is one screen, on which you work"):
        instruments.ScreenModulator(8e-6)
    (size,) = instruments.ScreenModulator.identify(0.0)
    with pytest.warns(odak.ArgumentWarning, match=f"screen 0 has {size[0]} × {size[1]} pixels, the modulator 20 × 30"):
        instruments.ScreenModulator(8e-6, 0, (20, 30)).close()
    modulator = instruments.ScreenModulator(8e-6, 0, settling_time=0.0)
    try:
        assert isinstance(modulator, instruments.SLMDriver)
        columns, rows = pygame.display.get_desktop_sizes()[0]
        assert modulator.shape == (rows, columns)
        levels = np.random.default_rng(0).integers(256, size=modulator.shape)
        modulator.show(levels)
        shown = pygame.surfarray.array3d(modulator._window.get_surface())
        assert np.array_equal(shown, np.repeat(levels.T[..., None], 3, axis=-1))
        with pytest.raises(ValueError, match="levels must be 0 to 255"):
            modulator.show(levels + 1)
        with pytest.raises(ValueError, match="display must be at least 0 and below 1"):
            instruments.ScreenModulator(8e-6, display=1)
    finally:
        modulator.close()


# What ended the interpreter: a second object, identify(), and show() after either or after close().
OPENED_AND_CLOSED = """
import sys, numpy as np
from odak.instruments import ScreenModulator
modulator = ScreenModulator(8e-6, 0, settling_time=0.2)
levels = np.random.default_rng(0).integers(256, size=modulator.shape)
ScreenModulator.identify(0.0)
modulator.show(levels)
try:
    ScreenModulator(8e-6, 0)
except ValueError as error:
    print(error)
if len(sys.argv) > 1:
    # A file in the format XWD: 32-bit numbers, the first the size of the header, and colours; then the pixels.
    data = open(sys.argv[1], "rb").read()
    header = np.frombuffer(data[:100], ">u4")
    body = np.frombuffer(data[header[0] + 12 * header[19] :], np.uint8).reshape(header[5], header[12])
    seen = body[:, : 4 * header[4]].reshape(header[5], header[4], 4)[..., :3]
    print("exact", bool((seen == levels[..., None]).all()))
    import warnings, pygame
    from odak.instruments import drivers
    drivers._LOOK = 0.0
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        modulator.show(levels)
    print("warnings of a window that nothing covers:", len(caught))
    cover = pygame.Window("cover", (64, 50), (16, 10), borderless=True, always_on_top=True)
    cover.get_surface()
    cover.flip()
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        modulator.show(levels)
    print(*(warning.message for warning in caught))
modulator.close()
modulator.close()
try:
    modulator.show(levels)
except RuntimeError as error:
    print(error)
ScreenModulator(8e-6, 0).close()
"""


def test_screens_are_opened_and_closed_in_any_order():
    pytest.importorskip("pygame", reason="pygame-ce is not installed")
    found = subprocess.run(
        [sys.executable, "-c", OPENED_AND_CLOSED], env={**os.environ, "SDL_VIDEODRIVER": "dummy"}, capture_output=True,
        text=True, timeout=100,
    )  # fmt: skip
    assert found.returncode == 0, found.stderr
    assert "display must be one that no other ScreenModulator covers, got 0" in found.stdout
    assert "the window on display 0 is closed" in found.stdout


@pytest.mark.skipif(shutil.which("Xvfb") is None, reason="the virtual display Xvfb is not installed")
def test_a_virtual_display_shows_the_levels_exactly(tmp_path):
    pytest.importorskip("pygame", reason="pygame-ce is not installed")
    read, write = os.pipe()
    # The server takes a free number, and writes it when it is ready.
    command = ["Xvfb", "-displayfd", str(write), "-screen", "0", "320x200x24", "-fbdir", str(tmp_path)]
    with subprocess.Popen(command, pass_fds=[write], stderr=subprocess.DEVNULL) as server:
        os.close(write)
        try:
            with os.fdopen(read) as pipe:
                number = pipe.readline().strip()
            found = subprocess.run(
                [sys.executable, "-c", OPENED_AND_CLOSED, str(tmp_path / "Xvfb_screen0")], capture_output=True,
                env={**os.environ, "SDL_VIDEODRIVER": "x11", "DISPLAY": f":{number}"}, text=True, timeout=100,
            )  # fmt: skip
        finally:
            server.terminate()
    assert found.returncode == 0 and "exact True" in found.stdout, found.stdout + found.stderr
    assert "warnings of a window that nothing covers: 0" in found.stdout
    # Of 200 x 320 pixels, 50 x 64 are 5 %, of which one in 256 is as dark as the window.
    assert (
        "screen 0 shows other levels than it should at 5.0% of the pixels, from row 10 and column 16 on" in found.stdout
    )


def test_frames_of_a_video_are_captured(tmp_path):
    cv2 = pytest.importorskip("cv2", reason="opencv-python-headless is not installed")
    path = str(tmp_path / "video.avi")
    writer = cv2.VideoWriter(path, cv2.VideoWriter_fourcc(*"FFV1"), 10, (48, 32))
    frames = np.random.default_rng(0).integers(256, size=(8, 32, 48, 3), dtype=np.uint8)
    for frame in frames:
        writer.write(frame)
    writer.release()
    camera = instruments.VideoCamera(path, pitch=3e-6, skip=2)
    try:
        assert isinstance(camera, instruments.Camera) and camera.shape == (32, 48)
        # FFV1 keeps each value, but a conversion of colours may round.
        first = camera.capture(2)
        assert np.abs(first.astype(int) - frames[2:4, ..., 1]).max() <= 2
        camera.region = (4, 6, 10, 12)
        assert np.abs(camera.capture(1).astype(int) - frames[6:7, 4:14, 6:18, 1]).max() <= 2
        camera.exposure = 0.02
        assert camera.exposure == 0.02
        with pytest.raises(OSError, match="sent no frame"):
            camera.capture(1)
    finally:
        camera.close()
    with pytest.raises(OSError, match="cannot open the camera"):
        instruments.VideoCamera(str(tmp_path / "none.avi"), pitch=3e-6)


class Stream:
    """What OpenCV's captures have: properties by number, of which the exposure is truncated and limited as V4L2's is.

    Video for Linux, V4L2_CID_EXPOSURE_ABSOLUTE: whole units of 100 µs.
    """

    def __init__(self, least=3, most=2047, manual=True):
        self.exposure, self.least, self.most, self.manual, self.given = 157.0, least, most, manual, []

    isOpened = staticmethod(lambda: True)

    def get(self, code):
        return {3: 48.0, 4: 32.0, 15: self.exposure}[code]

    def set(self, code, value):
        if code == 15:
            self.given.append(value)
            if not self.manual:
                return False
            self.exposure = float(np.clip(int(value), self.least, self.most))
        return True


@pytest.mark.parametrize(
    ("unit", "asked", "given", "reported"),
    [
        ("100 us", 0.16e-3, 2.0, 3e-4),
        ("100 us", 0.02, 200.0, 0.02),
        ("100 us", 10.0, 1e5, 0.2047),
        ("log2", 0.01, -7.0, 2**-7),
    ],
)
def test_a_uvc_camera_reports_the_exposure_that_it_takes(monkeypatch, unit, asked, given, reported):
    stream = Stream(*((-13, -1) if unit == "log2" else (3, 2047)))
    stream.exposure = -6.0 if unit == "log2" else 157.0
    cv2 = types.SimpleNamespace(VideoCapture=lambda _: stream, CAP_PROP_AUTO_EXPOSURE=21, CAP_PROP_EXPOSURE=15)
    monkeypatch.setitem(sys.modules, "cv2", cv2)
    camera = instruments.VideoCamera(0, pitch=3e-6, exposure_unit=unit)
    assert camera.exposure == pytest.approx(2**-6 if unit == "log2" else 0.0157)
    camera.exposure = asked
    assert stream.given == [given] and camera.exposure == pytest.approx(reported)
    stream.manual = False
    with pytest.raises(OSError, match="does not take an exposure of"):
        camera.exposure = asked
    assert camera.exposure == pytest.approx(reported)


def test_a_table_behind_a_folder(tmp_path):
    table, twin = (instruments.SimulatedTable(3, shape=(24, 24), camera_shape=(32, 40)) for _ in range(2))
    with served(tmp_path, table):
        modulator = instruments.FileModulator(tmp_path, (24, 24), 8e-6, settling_time=0)
        camera = instruments.FileCamera(tmp_path, (32, 40), 4e-6, exposure=0.02)
        assert isinstance(modulator, instruments.SLMDriver) and isinstance(camera, instruments.Camera)
        levels = np.random.default_rng(0).integers(256, size=(2, 24, 24))
        for pattern in levels:
            modulator.show(pattern)
            twin.modulator.show(pattern)
            twin.camera.exposure = 0.02
            assert np.array_equal(camera.capture(2), twin.camera.capture(2))
        camera.region = (1, 2, 3, 4)
        assert camera.capture().shape == (1, 3, 4)
    # Patterns that were shown are removed, and captures that were read.
    assert sorted(path.name for path in tmp_path.glob("*.npy")) == ["pattern_2.npy"]


def test_a_folder_that_does_not_answer(tmp_path):
    modulator = instruments.FileModulator(tmp_path, (4, 4), 8e-6, timeout=0.05)
    with pytest.raises(TimeoutError, match=r"shown\.txt' did not appear within 0\.05 s"):
        modulator.show(np.zeros((4, 4), int))
    camera = instruments.FileCamera(tmp_path, (4, 4), 8e-6, timeout=0.05)
    with pytest.raises(TimeoutError, match="capture_1"):
        camera.capture()
    np.save(tmp_path / "capture_2.npy", np.array([{}], dtype=object), allow_pickle=True)
    with pytest.raises(ValueError, match="cannot be read as captures"):
        camera.capture()
    np.save(tmp_path / "capture_3.npy", np.zeros((1, 4, 5), int))
    with pytest.raises(ValueError, match=r"must contain integers \[1, 4, 4\]"):
        camera.capture()


def test_drivers_of_the_package_are_registered():
    known = ("file-modulator", "genicam", "micro-manager-modulator", "raspberry-pi", "remote", "screen", "thorlabs")
    with pytest.raises(ValueError, match=".*".join(f"'{name}'" for name in known)):
        instruments.open_instrument("none")


class StandIn(types.SimpleNamespace):
    """What harvesters' camera has of the GenICam interface: nodes with values, a trigger, frames in flat buffers."""

    def __init__(self, depth):
        super().__init__(seen=[], waiting=[], depth=depth, late=False, discards=True)
        node = types.SimpleNamespace
        names = ("PixelFormat", "ExposureAuto", "TriggerSelector", "TriggerMode", "TriggerSource")
        self.nodes = node(**{name: node(value="") for name in names})
        self.nodes.Height, self.nodes.Width = node(value=12), node(value=16)
        self.nodes.ExposureTime = self.time = node(value=5000.0, min=20.0, max=1e6)
        self.nodes.TriggerSoftware = node(execute=self.expose)
        self.remote_device = node(node_map=self.nodes)

    def expose(self):
        assert self.nodes.TriggerMode.value == "On" and self.nodes.TriggerSource.value == "Software"
        level = min(self.time.value / 10, (1 << self.depth) - 1)
        ramp = np.arange(12 * 16) * level / (12 * 16)
        self.waiting.append(ramp.astype(np.uint16 if self.depth > 8 else np.uint8))

    def try_fetch(self, *, timeout):
        assert timeout > 0
        return types.SimpleNamespace(queue=lambda: self.waiting.pop(0)) if self.waiting else None

    @contextlib.contextmanager
    def fetch(self, timeout):
        assert timeout > 1e-6 * self.time.value
        if self.late:
            self.late = False
            raise TimeoutError("no frame in time")
        data = self.waiting.pop(0)
        part = types.SimpleNamespace(data=data, height=12, width=16)
        yield types.SimpleNamespace(payload=types.SimpleNamespace(components=[part]))
        # The buffer belongs to the camera again and is written to.
        data[:] = 0

    def start(self):
        self.seen.append("start")

    def stop(self):
        self.seen.append("stop")
        if self.discards:
            self.waiting.clear()

    def destroy(self):
        self.seen.append("destroy")


def test_a_genicam_camera_is_triggered_for_each_frame(monkeypatch, tmp_path):
    camera, made = StandIn(12), []

    class Harvester:
        device_info_list = (types.SimpleNamespace(serial_number="40012345"),)

        def __init__(self):
            self.files = []
            self.reset = lambda: made.append("reset")
            self.update = lambda: None

        def add_file(self, path):
            self.files.append(path)

        def create(self, key):
            made.append((self.files, key))
            return camera

    monkeypatch.setitem(sys.modules, "harvesters", types.ModuleType("harvesters"))
    monkeypatch.setitem(sys.modules, "harvesters.core", types.SimpleNamespace(Harvester=Harvester))
    monkeypatch.delenv("GENICAM_GENTL64_PATH", raising=False)
    with pytest.raises(ValueError, match="producer must be given"):
        instruments.GenICamCamera(3.45e-6)
    (tmp_path / "maker.cti").write_bytes(b"")
    monkeypatch.setenv("GENICAM_GENTL64_PATH", str(tmp_path))
    with pytest.raises(ValueError, match=r"one of the serial numbers \['40012345'\]"):
        instruments.GenICamCamera(3.45e-6, "7")
    found = instruments.GenICamCamera(3.45e-6, "40012345")
    assert made == [([str(tmp_path / "maker.cti")], {"serial_number": "40012345"})]
    assert isinstance(found, instruments.Camera) and (found.shape, found.bits) == ((12, 16), 12)
    assert found.exposure == 5e-3 and np.allclose(found.exposure_limits, (2e-5, 1.0), rtol=1e-12)
    found.exposure = 20e-3
    whole = found.capture(2)
    assert whole.shape == (2, 12, 16) and whole.dtype == np.uint16
    assert (whole[1].ravel() == np.floor(np.arange(192) * 2000 / 192)).all() and not camera.waiting
    found.region = (2, 3, 4, 5)
    assert (found.capture(1)[0] == whole[0, 2:6, 3:8]).all()
    # A frame that comes too late is not taken for the next one, in the queue or after the restart.
    for discards in (True, False):
        camera.late, camera.discards = True, discards
        with pytest.raises(TimeoutError):
            found.capture(1)
        found.exposure *= 0.5
        level = 10 * found.exposure * 1e4
        assert found.capture(1).max() == np.floor(np.arange(192) * level / 192).reshape(12, 16)[2:6, 3:8].max()
    found.close()
    assert camera.seen == ["start", *2 * ["stop", "start"], "stop", "destroy"] and made[-1] == "reset"


@pytest.mark.parametrize(
    ("name", "bits"),
    [
        *((name, None) for name in ("Mono12p", "Mono10p", "Mono12Packed", "Mono10Packed", "BayerRG12p", "BayerGB8")),
        ("Mono16", 12),
    ],
)
def test_a_genicam_camera_unpacks_and_shifts_its_data(monkeypatch, tmp_path, name, bits):
    depth = bits or int(re.search(r"\d+", name)[0])
    values = np.random.default_rng(0).integers(1 << depth, size=12 * 16)
    camera = StandIn(depth)
    for node in ("AcquisitionMode", "ExposureMode", "GammaEnable", "LUTEnable", "BlackLevelAuto"):
        setattr(camera.nodes, node, types.SimpleNamespace(value="unset"))

    def packed():
        """Return the bytes of the values, written one bit or one nibble at a time after the conventions."""
        if name.endswith("p"):
            text = "".join(format(value, f"0{depth}b")[::-1] for value in values)
            return np.array([int(text[k : k + 8][::-1], 2) for k in range(0, len(text), 8)], np.uint8)
        if name.endswith("Packed"):
            low, found = depth - 8, []
            for a, b in values.reshape(-1, 2).tolist():
                found += [a >> low, a % (1 << low) + (b % (1 << low) << 4), b >> low]
            return np.array(found, np.uint8)
        return values.astype(np.uint8) if depth == 8 else (values << (16 - depth)).astype(np.uint16)

    camera.nodes.TriggerSoftware.execute = lambda: camera.waiting.append(packed())
    if name == "Mono16":
        # As in versions 1.x of the convention.
        camera.nodes.ExposureTimeAbs = camera.nodes.__dict__.pop("ExposureTime")
    made = types.SimpleNamespace(
        device_info_list=[types.SimpleNamespace(serial_number="1")],
        **dict.fromkeys(("add_file", "reset", "update"), lambda *_: None),
        create=lambda _: camera,
    )
    monkeypatch.setitem(sys.modules, "harvesters", types.ModuleType("harvesters"))
    monkeypatch.setitem(sys.modules, "harvesters.core", types.SimpleNamespace(Harvester=lambda: made))
    (tmp_path / "maker.cti").write_bytes(b"")
    found = instruments.GenICamCamera(3.45e-6, producer=tmp_path / "maker.cti", pixel_format=name, bits=bits)
    assert found.bits == depth and (found.capture(1)[0].ravel() == values).all()
    nodes = camera.nodes
    assert (nodes.AcquisitionMode.value, nodes.ExposureMode.value) == ("Continuous", "Timed")
    assert nodes.GammaEnable.value is nodes.LUTEnable.value is False and nodes.BlackLevelAuto.value == "Off"
    found.exposure = 2e-3
    assert camera.time.value == 2000.0 and found.exposure == 2e-3
    with pytest.raises(ValueError, match="pixel_format must be Mono or Bayer"):
        instruments.GenICamCamera(3.45e-6, producer=tmp_path / "maker.cti", pixel_format="RGB8")


def test_micro_manager_shows_and_captures(tmp_path):
    shown, core = [], types.SimpleNamespace()
    core.setCameraDevice = core.waitForDevice = core.displaySLMImage = lambda name: shown.append(name)
    core.getCameraDevice, core.getSLMDevice = lambda: "Camera", lambda: "Panel"
    core.getImageHeight, core.getImageWidth, core.getImageBitDepth = lambda: 6, lambda: 8, lambda: 16
    core.getSLMHeight, core.getSLMWidth, core.getSLMBytesPerPixel = (lambda _, n=n: n for n in (6, 8, 1))
    core.clearROI = core.snapImage = lambda: None
    core.setSLMImage = lambda name, levels: shown.append(levels)
    core.getImage = lambda: 100 * next(part for part in reversed(shown) if not isinstance(part, str)).astype(np.uint16)
    core.exposure = 10.0
    core.getExposure, core.setExposure = lambda: core.exposure, lambda value: setattr(core, "exposure", value)
    modulator = instruments.MicroManagerModulator(core, 8e-6, settling_time=0)
    camera = instruments.MicroManagerCamera(core, 6.5e-6)
    assert isinstance(modulator, instruments.SLMDriver) and isinstance(camera, instruments.Camera)
    levels = np.arange(48, dtype=np.uint8).reshape(6, 8)
    modulator.show(levels)
    assert shown[-2:] == ["Panel", "Panel"] and (shown[-3] == levels).all()
    camera.exposure = 0.02
    assert core.exposure == 20.0 and camera.exposure == 0.02 and camera.bits == 16
    assert (camera.capture(3) == 100 * levels.astype(int)).all()
    with pytest.raises(ValueError, match="configuration must be a file that exists"):
        instruments.MicroManagerCamera(tmp_path / "none.cfg", 6.5e-6)


def test_micro_manager_demonstration_camera():
    core = pytest.importorskip("pymmcore_plus", reason="pymmcore-plus is not installed").CMMCorePlus()
    adapters = pytest.importorskip("mm_test_adapters", reason="mm-test-adapters is not installed")
    core.setDeviceAdapterSearchPaths([adapters.device_adapter_path()])
    core.loadSystemConfiguration(Path(adapters.device_adapter_path()) / "MMConfig_demo.cfg")
    camera = instruments.MicroManagerCamera(core, 6.5e-6)
    camera.exposure = 2e-3
    assert camera.exposure == 2e-3 and isinstance(camera, instruments.Camera)
    whole = camera.capture(2)
    assert whole.shape == (2, *camera.shape) and whole.dtype.kind == "u" and whole.max() < 2**camera.bits
    assert whole.std() > 0
    camera.region = (10, 20, 30, 40)
    assert camera.capture(1).shape == (1, 30, 40)
