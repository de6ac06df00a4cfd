"""Drivers by libraries of makers, with stand-ins that have exactly the calls that the makers document."""

import ctypes
import sys
import types

import numpy as np
import pytest

from odak import instruments
from odak.instruments import makers

INT, UINT, BYTES, TEXT = ctypes.c_int, ctypes.c_uint, ctypes.POINTER(ctypes.c_ubyte), ctypes.c_char_p
# Types of results and arguments as the headers Blink_C_wrapper.h of the three SDKs and their examples have them.
BOARD = {f"Get_image_{name}": (INT, INT) for name in ("height", "width", "depth")}
BOARD |= {"Delete_SDK": (None,), "Get_last_error_message": (TEXT,)}
BOARD |= {"Load_LUT_file": (INT, INT, TEXT), "ImageWriteComplete": (INT, INT, UINT)}
HEADERS = {
    "overdrive-plus": BOARD
    | {
        "Create_SDK": (None, UINT, ctypes.POINTER(UINT), ctypes.POINTER(INT), INT, INT, INT, INT, TEXT),
        "Write_image": (INT, INT, BYTES, UINT, INT, INT, INT, INT, UINT),
    },
    "plus": BOARD
    | {
        "Create_SDK": (None, ctypes.POINTER(UINT), ctypes.POINTER(INT)),
        "Write_image": (INT, INT, BYTES, UINT),
    },
    "hdmi": {
        "Create_SDK": (None, UINT),
        "Delete_SDK": (None,),
        "Write_image": (INT, BYTES, UINT),
        "Load_lut": (INT, TEXT),
        "Get_Height": (INT,),
        "Get_Width": (INT,),
    },
}


class Blink:
    """Stand-in for a library: functions of C types, which refuse other numbers and kinds of arguments."""

    def __init__(self, sdk, boards=1, depth=8):
        self.sdk, self.boards, self.depth, self.seen, self.image, self.result = sdk, boards, depth, [], None, 1
        for name, (result, *arguments) in HEADERS[sdk].items():
            call = ctypes.CFUNCTYPE(result, *arguments)(lambda *given, name=name: self.called(name, given))
            setattr(self, name, call)

    def called(self, name, given):
        self.seen.append(name)
        if name == "Create_SDK" and self.sdk != "hdmi":
            found, fine = given[:2] if self.sdk == "plus" else given[1:3]
            found[0], fine[0] = self.boards, int(self.boards > 0)
        elif name == "Write_image":
            image = given[0] if self.sdk == "hdmi" else given[1]
            self.image = np.ctypeslib.as_array(image, (6, 8)).copy()
            if self.sdk == "hdmi":
                assert given[1] == 1
            elif self.sdk == "overdrive-plus":
                assert given[2:] == (48, 0, 0, 0, 0, 5000)
            else:
                assert given[2] == 5000
            return self.result
        elif name in ("Load_LUT_file", "Load_lut"):
            self.lut = given[-1]
        elif name == "Get_last_error_message":
            return ctypes.cast(ctypes.c_char_p(b"no card"), ctypes.c_void_p).value
        sizes = {"height": 6, "width": 8, "depth": self.depth}
        return sizes.get(name.lower().rpartition("_")[2], 1) if HEADERS[self.sdk][name][0] else None


@pytest.mark.parametrize("sdk", HEADERS)
def test_meadowlark_gets_levels_by_functions_of_its_library(sdk, monkeypatch, tmp_path):
    library, lut = tmp_path / "Blink_C_wrapper.dll", tmp_path / "linear.lut"
    library.write_bytes(b"")
    lut.write_bytes(b"")
    blink = Blink(sdk)
    monkeypatch.setattr(makers.ctypes, "CDLL", lambda path: {str(library): blink}[path])
    modulator = instruments.MeadowlarkModulator(library, 9.2e-6, lut, sdk, settling_time=0)
    assert isinstance(modulator, instruments.SLMDriver) and modulator.shape == (6, 8)
    assert blink.lut == str(lut).encode()
    # Rows that are not contiguous arrive in order, too.
    levels = np.arange(48).reshape(8, 6).T
    modulator.show(levels)
    assert (blink.image == levels).all()
    with pytest.raises(ValueError, match="levels must be 0 to 255"):
        modulator.show(levels + 255)
    blink.result = -1 if sdk == "overdrive-plus" else 0
    with pytest.raises(OSError, match=r"Write_image of .* failed"):
        modulator.show(levels)
    modulator.close()
    assert blink.seen[-1] == "Delete_SDK"


@pytest.mark.parametrize(
    ("sdk", "write", "expected"),
    [
        ("hdmi", "int board, unsigned char* image_data, int is_8_bit", (1, "image", 1)),
        ("hdmi", "unsigned char* image_data, int is_8_bit", ("image", 1)),
        (
            "overdrive-plus",
            "int board,\n unsigned char* image, // first\n unsigned int image_size, int wait_for_trigger,"
            " int external_pulse, unsigned int trigger_timeout_ms",
            (1, "image", 48, 0, 0, 5000),
        ),
        (
            "overdrive-plus",
            "int board, unsigned char* image, unsigned int image_size, int wait_for_trigger, int flip_immediate,"
            " int output_pulse_image_flip, int output_pulse_image_refresh, unsigned int trigger_timeout_ms",
            (1, "image", 48, 0, 0, 0, 0, 5000),
        ),
        (
            "plus",
            "int board, unsigned char* image, int wait_for_trigger, int flip_immediate, int output_pulse,"
            " unsigned int trigger_timeout_ms",
            (1, "image", 0, 0, 0, 5000),
        ),
    ],
)
def test_meadowlark_follows_the_header_beside_its_library(sdk, write, expected, monkeypatch, tmp_path):
    """Declarations of four versions of the SDK; another number of arguments ends in a crash."""
    library = tmp_path / "Blink_C_wrapper.dll"
    library.write_bytes(b"")
    (tmp_path / "Blink_C_wrapper.h").write_text(f"extern int Write_image({write}); /* int Write_image(int other); */\n")
    blink, seen = Blink(sdk), []
    blink.Write_image = lambda *given: seen.append(given) or 1
    monkeypatch.setattr(makers.ctypes, "CDLL", lambda path: blink)
    modulator = instruments.MeadowlarkModulator(library, 9.2e-6, sdk=sdk, settling_time=0)
    modulator.show(np.arange(48).reshape(6, 8))
    plain = [getattr(one, "value", one) for one in seen[0]]
    place = expected.index("image")
    assert (np.ctypeslib.as_array(plain.pop(place), (6, 8)).ravel() == np.arange(48)).all()
    assert tuple(plain) == expected[:place] + expected[place + 1 :]
    (tmp_path / "Blink_C_wrapper.h").write_text("int Write_image(int board, unsigned char* image, int colour);")
    with pytest.raises(OSError, match="has a parameter 'colour' that this driver does not know"):
        instruments.MeadowlarkModulator(library, 9.2e-6, sdk=sdk, settling_time=0).show(np.zeros((6, 8), int))


def test_meadowlark_without_a_card(monkeypatch, tmp_path):
    library = tmp_path / "Blink_C_wrapper.dll"
    with pytest.raises(ValueError, match="library must be a file that exists"):
        instruments.MeadowlarkModulator(library, 9.2e-6)
    library.write_bytes(b"")
    for boards, depth, kind, message in ((0, 8, OSError, "found 0 cards"), (1, 16, ValueError, "must take 8 bits")):
        blink = Blink("plus", boards, depth)
        blink.Get_last_error_message = lambda: b"no card"
        monkeypatch.setattr(makers.ctypes, "CDLL", lambda path, blink=blink: blink)
        with pytest.raises(kind, match=message):
            instruments.MeadowlarkModulator(library, 9.2e-6, sdk="plus")
        assert blink.seen[-1] == "Delete_SDK"


def test_holoeye_shows_levels_as_image_data(monkeypatch):
    shown, codes = [], {"SDK": 0, "show": 0}
    device = types.SimpleNamespace(
        errorCode=lambda: 0, height_px=lambda: 6, width_px=lambda: 8, pixelsize_um=lambda: 3.74,
        showImageData=lambda data, flags=None: shown.append(data) or codes["show"],
        window=lambda: types.SimpleNamespace(close=lambda: shown.append("closed") or 0),
    )  # fmt: skip
    sdk = types.ModuleType("HEDS")
    sdk.SDK = types.SimpleNamespace(Init=lambda major, minor: codes["SDK"], ErrorString=lambda code: f"error {code}")
    sdk.SLM = types.SimpleNamespace(
        Init=lambda preselect="", openPreview=True, previewScale=1.0: shown.append((preselect, openPreview)) or device
    )
    with pytest.raises(ImportError, match="needs Holoeye's SLM Display SDK"):
        instruments.HoloeyeModulator()
    monkeypatch.setitem(sys.modules, "HEDS", sdk)
    modulator = instruments.HoloeyeModulator("index:1", settling_time=0)
    assert shown == [("index:1", False)] and modulator.shape == (6, 8) and np.isclose(modulator.pitch, 3.74e-6)
    assert isinstance(modulator, instruments.SLMDriver)
    levels = np.arange(48).reshape(6, 8)
    modulator.show(levels)
    assert shown[-1].dtype == np.uint8 and (shown[-1] == levels).all()
    codes["show"] = 3
    with pytest.raises(OSError, match="reports: error 3"):
        modulator.show(levels)
    modulator.close()
    assert shown[-1] == "closed"
    codes["SDK"] = 7
    with pytest.raises(OSError, match="reports: error 7"):
        instruments.HoloeyeModulator()


class Picamera2:
    """Stand-in for picamera2: raw lines end with unused bytes, and what a running camera is told holds later."""

    opened = 0

    def __init__(self, number, filters, depth, stored):
        assert number == 1
        name = f"S{filters}" if filters else "R"
        self.sensor_modes = [
            {"size": (4, 2), "bit_depth": depth, "unpacked": f"{name}{depth}"},
            {"size": (8, 6), "bit_depth": depth, "unpacked": f"{name}{depth}"},
            {"size": (8, 6), "bit_depth": depth - 2, "unpacked": f"{name}{depth - 2}"},
        ]
        self.stored, self.depth, self.name, self.running, self.controls = stored, depth, name, False, {}
        self.camera_properties = {"PixelArraySize": (16, 12), "UnitCellSize": (1500, 1500)}
        self.camera_controls = {"ExposureTime": (100, 200_000, 20_000)}
        self.time = self.camera_controls["ExposureTime"][2]
        self.frames = 0

    def create_still_configuration(self, raw, controls, queue):
        assert raw == {"size": (8, 6), "format": f"{self.name}{self.depth}"} and queue is False
        return {"raw": raw, "controls": controls}

    def configure(self, configuration):
        self.controls = dict(configuration["controls"])
        assert self.controls == {"AeEnable": False, "AwbEnable": False, "AnalogueGain": 1.0}

    def camera_configuration(self):
        return {"raw": {"size": (8, 6), "format": f"{self.name}{self.stored}"}}

    def set_controls(self, controls):
        assert not self.running, "controls of a running camera hold after several frames only"
        self.controls |= controls

    def start(self):
        self.running, self.time = True, self.controls.get("ExposureTime", self.time) // 10 * 10

    def stop(self):
        self.running = False

    def close(self):
        self.name = "closed"

    def capture_request(self, flush=None):
        assert self.running and flush, "frames may be older than the pattern"
        self.opened += 1
        counts = np.arange(48).reshape(6, 8) * (self.time // 1000)
        lines = np.full((6, 12), 77, dtype=np.uint16 if self.stored > 8 else np.uint8)
        lines[:, :8] = np.minimum(counts, (1 << self.depth) - 1) << (self.stored - self.depth)

        def release():
            self.opened -= 1

        return types.SimpleNamespace(
            make_array=lambda name: {"raw": lines.view(np.uint8)}[name],
            get_metadata=lambda: {"ExposureTime": self.time},
            release=release,
        )


@pytest.mark.parametrize(("filters", "depth", "stored"), [("BGGR", 12, 12), ("RGGB", 10, 16), ("", 8, 8)])
def test_camera_of_raspberry_pi_reads_raw_pixels_of_one_colour(filters, depth, stored, monkeypatch):
    made = []
    module = types.ModuleType("picamera2")
    module.Picamera2 = lambda number: made.append(Picamera2(number, filters, depth, stored)) or made[-1]
    monkeypatch.setitem(sys.modules, "picamera2", module)
    camera = instruments.RaspberryPiCamera(1, "blue")
    first, step = {"BGGR": ((0, 0), 2), "RGGB": ((1, 1), 2), "": ((0, 0), 1)}[filters]
    assert isinstance(camera, instruments.Camera) and camera.bits == depth
    assert camera.shape == (6 // step, 8 // step)
    # The mode bins two pixels along each axis.
    assert np.isclose(camera.pitch, step * 2 * 1.5e-6)
    assert np.allclose(camera.exposure_limits, (1e-4, 0.2)) and np.isclose(camera.exposure, 0.02)
    camera.exposure = 5.004e-3
    assert np.isclose(camera.exposure, 5e-3)
    whole = np.minimum(np.arange(48).reshape(6, 8) * 5, (1 << depth) - 1)[first[0] :: step, first[1] :: step]
    seen = camera.capture(2)
    assert seen.shape == (2, *camera.shape) and (seen == whole).all()
    camera.region = (1, 2, 2, 1)
    assert (camera.capture()[0] == whole[1:3, 2:3]).all()
    camera.close()
    assert not made[0].running and made[0].name == "closed" and made[0].opened == 0


def test_a_camera_of_a_raspberry_pi_without_raw_frames(monkeypatch):
    module = types.ModuleType("picamera2")

    class Compressed(Picamera2):
        def camera_configuration(self):
            return {"raw": {"size": (8, 6), "format": "MONO_PISP_COMP1"}}

    module.Picamera2 = lambda number: Compressed(number, "", 8, 8)
    monkeypatch.setitem(sys.modules, "picamera2", module)
    with pytest.raises(OSError, match="gives no unpacked raw frames, but MONO_PISP_COMP1"):
        instruments.RaspberryPiCamera(1)
    with pytest.raises(ValueError, match="channel must be"):
        instruments.RaspberryPiCamera(1, "infrared")


class ThorlabsStandIn:
    """Stand-in for a TLCamera: properties and calls by the names of thorlabs_tsi_sdk, and no others."""

    Range = types.SimpleNamespace
    bit_depth, image_height_pixels, image_width_pixels, sensor_pixel_width_um = 10, 6, 8, 3.45
    gain_range, exposure_time_range_us = Range(min=0, max=480), Range(min=40, max=26_000_000)

    def __init__(self):
        self.gain, self.exposure_time_us, self.operation_mode, self.image_poll_timeout_ms = 100, 1000, 1, 0
        self.frames_per_trigger_zero_for_unlimited, self.armed, self.waiting, self.taken = 0, 0, 0, 0
        # One buffer for all frames, as the SDK has it.
        self.buffer, self.dead, self.disposed = np.zeros((6, 8), np.uint16), False, False

    def arm(self, frames_to_buffer):
        assert self.operation_mode == 0 and self.frames_per_trigger_zero_for_unlimited == 1
        self.armed = frames_to_buffer

    def disarm(self):
        self.armed = 0

    def dispose(self):
        assert not self.armed
        self.disposed = True

    def issue_software_trigger(self):
        assert self.armed
        self.waiting += 1

    def get_pending_frame_or_null(self):
        if self.dead or not self.waiting:
            return None
        self.waiting, self.taken = self.waiting - 1, self.taken + 1
        self.buffer[:] = np.arange(48).reshape(6, 8) + 100 * self.taken
        return types.SimpleNamespace(image_buffer=self.buffer, frame_count=self.taken)


def test_thorlabs_triggers_each_frame(monkeypatch):
    camera, disposed = ThorlabsStandIn(), []

    class SDK:
        def discover_available_cameras(self):
            return ["04711", "04712"]

        def open_camera(self, serial):
            assert serial == "04712"
            return camera

        def dispose(self):
            disposed.append(True)

    module = types.ModuleType("thorlabs_tsi_sdk.tl_camera")
    module.TLCameraSDK = SDK
    monkeypatch.setitem(sys.modules, "thorlabs_tsi_sdk", types.ModuleType("thorlabs_tsi_sdk"))
    monkeypatch.setitem(sys.modules, "thorlabs_tsi_sdk.tl_camera", module)
    for device, text in (
        ("04713", "device must be one of the serial numbers"),
        (2, "device must be below 2"),
    ):
        with pytest.raises(ValueError, match=text):
            instruments.ThorlabsCamera(device)
    assert len(disposed) == 2
    found = instruments.ThorlabsCamera(1)
    assert isinstance(found, instruments.Camera) and camera.gain == 0
    assert (found.shape, found.bits) == ((6, 8), 10)
    assert (*found.exposure_limits, found.pitch) == pytest.approx((40e-6, 26.0, 3.45e-6))
    found.exposure = 2.5e-3
    assert camera.exposure_time_us == 2500 and found.exposure == pytest.approx(2.5e-3)
    frames = found.capture(2)
    assert (frames == np.arange(48).reshape(6, 8) + np.array([100, 200])[:, None, None]).all()
    assert camera.image_poll_timeout_ms == 5002
    found.region = (1, 2, 3, 4)
    assert (found.capture() == np.arange(48).reshape(6, 8)[1:4, 2:6] + 300).all()
    camera.dead = True
    with pytest.raises(OSError, match="sent no frame within 5 s"):
        found.capture()
    camera.dead = False
    # The frame that was waited for, and another one, which a trigger of someone else has made.
    camera.waiting += 2
    found.capture()
    assert camera.taken == 3 + 3 + 1 and not camera.waiting and camera.armed == 2
    found.close()
    assert camera.disposed and len(disposed) == 3
    assert instruments.ThorlabsCamera("04712").pitch == found.pitch
