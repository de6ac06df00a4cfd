"""Drivers by the libraries of makers, which are installed apart: Raspberry Pi, Holoeye, Meadowlark, Thorlabs.

None was run on hardware: each was tested with a stand-in for the documented calls that it uses.
"""

import ctypes
import os
import re
import time
from typing import Any

import numpy as np

from odak import _show, _validate
from odak.instruments.drivers import WholeFrames, _imported, checked_levels, existing_file


class RaspberryPiCamera(WholeFrames):
    """Camera of a Raspberry Pi, whose raw frames are read by picamera2.

    Automatic exposure is off and the gain is 1. Each frame begins after it was asked for, so that none is older than
    the pattern. A new exposure restarts the camera, for otherwise it holds only some frames later.

    Parameters
    ----------
    device : int
        Number of the camera.
    channel : {"green", "red", "blue"}
        Colour filter whose pixels are read, every second one along rows and columns. Cameras without filters ignore it.
    pitch : float, optional
        Distance in metres between the pixels that are read; from the pixel size that the camera states by default.

    Notes
    -----
    Needs the package picamera2, which Raspberry Pi OS brings (``apt install python3-picamera2``); its calls are
    documented in Raspberry Pi Ltd, The Picamera2 Library. Models with 16 bits per pixel (Raspberry Pi 5) shift the
    counts to the upper bits, which is taken back. Not run on hardware: tested with a stand-in for picamera2.

    Examples
    --------
    >>> from odak.instruments import RaspberryPiCamera
    >>> camera = RaspberryPiCamera(channel="green")  # doctest: +SKIP
    """

    @_validate.takes_units("pitch")
    def __init__(self, device: int = 0, channel: str = "green", pitch: float | None = None):
        device = _validate.integer("device", device)
        channel = _validate.one_of("channel", channel, ("green", "red", "blue"))
        if pitch is not None:
            pitch = float(_validate.number("pitch", pitch, positive=True))
        self._camera = _imported("picamera2", "picamera2").Picamera2(device)
        mode = max(self._camera.sensor_modes, key=lambda mode: (mode["size"], mode["bit_depth"]))
        controls = {"AeEnable": False, "AwbEnable": False, "AnalogueGain": 1.0}
        wanted = {"size": mode["size"], "format": str(mode["unpacked"])}
        self._camera.configure(self._camera.create_still_configuration(raw=wanted, controls=controls, queue=False))
        given = self._camera.camera_configuration()
        found = re.fullmatch(r"(?:S(?P<filters>[RGB]{4})|R)(?P<bits>\d+)", given["raw"]["format"])
        if found is None:
            self._camera.close()
            raise OSError(f"the camera gives no unpacked raw frames, but {given['raw']['format']}")
        stored = int(found["bits"])
        self.bits: int = int(mode["bit_depth"])
        # Frames of 16 bits from a sensor of fewer are shifted.
        self._shift, self._wide = stored - self.bits, stored > 8
        first = 0 if found["filters"] is None else found["filters"].index(channel[0].upper())
        self._step, self._first = (1 if found["filters"] is None else 2), divmod(first, 2)
        columns, rows = given["raw"]["size"]
        self._size = (rows, columns)
        self.shape: tuple[int, int] = (rows // self._step, columns // self._step)
        # The property is in nanometres and for pixels that are not binned.
        whole, _ = self._camera.camera_properties["PixelArraySize"]
        binned = max(round(whole / columns), 1)
        stated = self._step * binned * 1e-9 * float(self._camera.camera_properties["UnitCellSize"][0])
        self.pitch: float = stated if pitch is None else pitch
        shortest, longest, _ = self._camera.camera_controls["ExposureTime"]
        self.exposure_limits: tuple[float, float] = (1e-6 * shortest, 1e-6 * longest)
        self._start()

    @property
    def exposure(self) -> float:
        """Exposure time in seconds, as the frames report it."""
        return self._exposure

    @exposure.setter
    def exposure(self, value: float) -> None:
        value = float(_validate.number("exposure", value, positive=True))
        self._camera.stop()
        self._camera.set_controls({"ExposureTime": round(1e6 * value)})
        self._start()

    def _start(self) -> None:
        self._camera.start()
        self._exposure = 1e-6 * self._raw()[1]["ExposureTime"]

    def _raw(self) -> tuple[np.ndarray, dict[str, Any]]:
        request = self._camera.capture_request(flush=True)
        try:
            return np.array(request.make_array("raw")), request.get_metadata()
        finally:
            request.release()

    def _frame(self) -> np.ndarray:
        frame = self._raw()[0]
        # Lines are arrays of bytes that end with unused ones.
        frame = (frame.view(np.uint16) if self._wide else frame)[: self._size[0], : self._size[1]]
        return frame[self._first[0] :: self._step, self._first[1] :: self._step] >> self._shift

    def close(self) -> None:
        """Stop the camera and release it."""
        self._camera.stop()
        self._camera.close()


class HoloeyeModulator(_show.Shown):
    """Modulator of Holoeye, driven by version 4 of its SLM Display SDK.

    Parameters
    ----------
    preselect : str
        Which modulator, such as "index:0" or "name:pluto"; by default the SDK asks where several are connected.
    settling_time : float
        Seconds to wait after a pattern was shown.

    Attributes
    ----------
    bits : int
        8.
    pitch : float
        Distance between pixels in metres, as the SDK states it.

    Notes
    -----
    Needs the SDK's Python packages ``HEDS`` and ``hedslib`` on the path of modules; both come with the SDK (its folders
    ``examples`` and ``api/python``). Levels are shown as image data, which the SDK does not change. Not run on
    hardware: tested with a stand-in for the calls ``HEDS.SDK.Init``, ``HEDS.SLM.Init``, ``showImageData`` and the calls
    for the size in the SDK's documentation.

    Examples
    --------
    >>> from odak.instruments import HoloeyeModulator
    >>> modulator = HoloeyeModulator("index:0", settling_time=0.1)  # doctest: +SKIP
    """

    bits = 8

    def __init__(self, preselect: str = "", settling_time: float = 0.1):
        _validate.instance("preselect", preselect, str, "a string")
        self.settling_time: float = float(_validate.number("settling_time", settling_time, least=0))
        self._sdk = _imported("HEDS", "Holoeye's SLM Display SDK (with its folder of Python modules on the path)", "")
        self._check(self._sdk.SDK.Init(4, 0))
        self._device = self._sdk.SLM.Init(preselect, False)
        self._check(self._device.errorCode())
        self.shape: tuple[int, int] = (int(self._device.height_px()), int(self._device.width_px()))
        self.pitch: float = 1e-6 * float(self._device.pixelsize_um())

    def _check(self, code: int) -> None:
        if code:
            raise OSError(f"the SDK of Holoeye reports: {self._sdk.SDK.ErrorString(code)}")

    def show(self, levels: np.ndarray) -> None:
        """Show levels 0 … 255, integers ``[rows, columns]``, and wait for the settling time."""
        found = np.ascontiguousarray(checked_levels(levels, self.shape, self.bits))
        self._check(self._device.showImageData(found))
        time.sleep(self.settling_time)

    def close(self) -> None:
        """Close the window on the modulator."""
        self._check(self._device.window().close())


def _declarations(path: str) -> dict[str, list[str]]:
    """Return the names of the parameters, in lower case, of each function that a header file in C declares."""
    if not os.path.exists(path):
        return {}
    with open(path, encoding="latin-1") as stream:
        text = re.sub(r"//[^\n]*|/\*.*?\*/", "", stream.read(), flags=re.DOTALL)
    found = {}
    for name, given in re.findall(r"(\w+)\s*\(([^()]*)\)\s*;", text):
        parameters = [] if given.strip() in ("", "void") else given.split(",")
        found[name] = [re.findall(r"\w+", part.partition("=")[0])[-1].lower() for part in parameters]
    return found


class MeadowlarkModulator(_show.Shown):
    """Modulator of Meadowlark, driven by the C functions of one of its Blink SDKs.

    Parameters
    ----------
    library : str or os.PathLike
        The SDK's library ``Blink_C_wrapper.dll``, for example in ``C:/Program Files/Meadowlark Optics/Blink
        OverDrive Plus/SDK``.
    pitch : float
        Distance between pixels in metres.
    lut : str or os.PathLike, optional
        File of the voltages of the levels, which is loaded to the modulator; by default those that it holds are used.
    sdk : {"overdrive-plus", "plus", "hdmi"}
        Which SDK: "overdrive-plus" and "plus" of cards of 8 bits in the computer (1920 × 1152 and 1024 × 1024 pixels
        as a rule), "hdmi" of modulators that are connected as a screen (1920 × 1200 pixels).
    board : int
        Number of the card, from 1; not for "hdmi".
    settling_time : float
        Seconds to wait after a pattern was written.
    timeout : float
        Seconds to wait for the card; not for "hdmi".

    Attributes
    ----------
    bits : int
        8.

    Notes
    -----
    The functions have different arguments in the SDKs and in their versions, which a library does not tell. Where the
    SDK's file ``Blink_C_wrapper.h`` lies beside the library, as it is installed, its declarations are followed; without
    it, the arguments are those of ``Write_image`` with eight ("overdrive-plus"), three ("plus") and two ("hdmi"). Not
    run on hardware: tested with stand-ins for the functions.

    Examples
    --------
    >>> from odak.instruments import MeadowlarkModulator
    >>> folder = "C:/Program Files/Meadowlark Optics/Blink Plus"
    >>> modulator = MeadowlarkModulator(
    ...     f"{folder}/SDK/Blink_C_wrapper.dll", pitch=17e-6, lut=f"{folder}/LUT Files/linear.lut", sdk="plus"
    ... )  # doctest: +SKIP
    """

    bits = 8

    @_validate.takes_units("pitch")
    def __init__(
        self,
        library: str | os.PathLike[str],
        pitch: float,
        lut: str | os.PathLike[str] | None = None,
        sdk: str = "overdrive-plus",
        board: int = 1,
        settling_time: float = 0.02,
        timeout: float = 5.0,
    ):
        self._path = existing_file("library", library)
        self.pitch: float = float(_validate.number("pitch", pitch, positive=True))
        voltages = None if lut is None else os.fsencode(existing_file("lut", lut))
        self._sdk = _validate.one_of("sdk", sdk, ("overdrive-plus", "plus", "hdmi"))
        self._board = _validate.integer("board", board, minimum=1)
        self.settling_time: float = float(_validate.number("settling_time", settling_time, least=0))
        self._timeout = ctypes.c_uint(round(1e3 * float(_validate.number("timeout", timeout, positive=True))))
        self._library = ctypes.CDLL(self._path)
        self._declared = _declarations(os.path.join(os.path.dirname(self._path), "Blink_C_wrapper.h"))
        try:
            rows, columns, depth = self._open()
            if depth != 8:
                raise ValueError(f"the modulator must take 8 bits for each pixel, got {depth}")
            self.shape: tuple[int, int] = (rows, columns)
            if voltages is not None and self._sdk == "hdmi":
                self._check("Load_lut", self._library.Load_lut(voltages))
            elif voltages is not None:
                self._check("Load_LUT_file", self._library.Load_LUT_file(self._board, voltages))
        except Exception:
            self.close()
            raise

    def _open(self) -> tuple[int, int, int]:
        """Start the SDK and return rows, columns and bits."""
        library = self._library
        if self._sdk == "hdmi":
            # Newer versions take a flag, 1 for Python; older ones have no argument and ignore it.
            library.Create_SDK(*([1] * len(self._declared.get("Create_SDK", [""]))))
            return library.Get_Height(), library.Get_Width(), 8
        boards, fine = ctypes.c_uint(0), ctypes.c_int(0)
        # 12 bits of voltages, nematic, writing to the memory of the card, without overdrive and its tables.
        options = {"bit_depth": 12, "boards": ctypes.byref(boards), "construct": ctypes.byref(fine), "nematic": 1}
        options |= {"write_enable": 1, "gpu": 0, "transients": 10, "lut": None}
        usual = ["boards", "construct"] if self._sdk == "plus" else list(options)
        library.Create_SDK(*self._arguments("Create_SDK", options, usual))
        if not fine.value or boards.value < self._board:
            message = library.Get_last_error_message
            message.restype = ctypes.c_char_p
            text = (message() or b"").decode(errors="replace")
            raise OSError(f"the Blink SDK found {boards.value} cards, number {self._board} is asked for: {text}")
        board = self._board
        return library.Get_image_height(board), library.Get_image_width(board), library.Get_image_depth(board)

    def _arguments(self, name: str, options: dict[str, Any], usual: list[str]) -> list[Any]:
        """Return the arguments of a function: each the first option whose key is in the name of the parameter."""
        found = []
        for parameter in self._declared.get(name, usual):
            keys = [key for key in options if key in parameter]
            if not keys:
                raise OSError(f"{name} of {self._path!r} has a parameter {parameter!r} that this driver does not know")
            found.append(options[keys[0]])
        return found

    def _check(self, name: str, result: int) -> None:
        # −1 is a failure of "overdrive-plus", anything but 1 one of "plus"; "hdmi" returns a number above 0.
        if result == -1 or (self._sdk == "plus" and result != 1) or (self._sdk == "hdmi" and result < 1):
            raise OSError(f"{name} of {self._path!r} failed and returned {result}")

    def show(self, levels: np.ndarray) -> None:
        """Show levels 0 … 255, integers ``[rows, columns]``, and wait for the settling time."""
        found = np.ascontiguousarray(checked_levels(levels, self.shape, self.bits))
        image = found.ctypes.data_as(ctypes.POINTER(ctypes.c_ubyte))
        # Neither triggers nor pulses. Names of several of the parameters contain "image" or "trigger".
        options = {"board": self._board, "timeout": self._timeout, "trigger": 0, "flip": 0, "pulse": 0}
        options |= {"8_bit": 1, "eight_bit": 1, "size": found.size, "image": image}
        usual = {"hdmi": ["image", "8_bit"], "plus": ["board", "image", "timeout"]}.get(
            self._sdk, ["board", "image", "size", "trigger", "flip", "pulse", "pulse", "timeout"]
        )
        self._check("Write_image", self._library.Write_image(*self._arguments("Write_image", options, usual)))
        if self._sdk != "hdmi":
            self._check("ImageWriteComplete", self._library.ImageWriteComplete(self._board, self._timeout))
        time.sleep(self.settling_time)

    def close(self) -> None:
        """End the SDK, which releases the modulator."""
        self._library.Delete_SDK()


class ThorlabsCamera(WholeFrames):
    """Scientific camera of Thorlabs (Zelux, Kiralux, Quantalux and others), driven by its own Python package.

    Each frame is triggered by software, so that none is older than the pattern. The gain is the smallest, and the black
    level stays as the camera has it.

    Parameters
    ----------
    device : int or str
        Number of the camera, or its serial number.
    pitch : float, optional
        Distance between pixels in metres; as the camera states it by default.
    timeout : float
        Seconds to wait for a frame beyond the exposure.

    Notes
    -----
    Needs the package ``thorlabs_tsi_sdk`` and the libraries beside it, both of the Scientific Camera SDK of ThorCam; on
    Windows, the folder of the libraries must be on the path, as its file ``Python_README.txt`` says. The
    modulators of Thorlabs (EXULUS) are screens: use the driver `screen`. Not run on hardware: tested with a stand-in
    for the classes ``TLCameraSDK`` and ``TLCamera`` of that package.

    Examples
    --------
    >>> from odak.instruments import ThorlabsCamera
    >>> camera = ThorlabsCamera("12345")  # doctest: +SKIP
    """

    @_validate.takes_units("pitch")
    def __init__(self, device: int | str = 0, pitch: float | None = None, timeout: float = 5.0):
        if pitch is not None:
            pitch = float(_validate.number("pitch", pitch, positive=True))
        self._timeout = float(_validate.number("timeout", timeout, positive=True))
        place = device if isinstance(device, str) else _validate.integer("device", device)
        package = _imported("thorlabs_tsi_sdk.tl_camera", "Thorlabs' Scientific Camera SDK (its Python package)", "")
        self._sdk = package.TLCameraSDK()
        self._camera: Any = None
        try:
            known = list(self._sdk.discover_available_cameras())
            if isinstance(place, str) and place not in known:
                raise ValueError(f"device must be one of the serial numbers {known}, got {place!r}")
            if not isinstance(place, str) and place >= len(known):
                raise ValueError(f"device must be below {len(known)}, the number of cameras, got {place}")
            camera = self._camera = self._sdk.open_camera(place if isinstance(place, str) else known[place])
            if camera.gain_range.max > 0:
                camera.gain = camera.gain_range.min
            # Software triggers are operation mode 0, of one frame each.
            camera.operation_mode, camera.frames_per_trigger_zero_for_unlimited = 0, 1
            self.bits: int = int(camera.bit_depth)
            self.shape: tuple[int, int] = (int(camera.image_height_pixels), int(camera.image_width_pixels))
            self.pitch: float = 1e-6 * float(camera.sensor_pixel_width_um) if pitch is None else pitch
            limits = camera.exposure_time_range_us
            self.exposure_limits: tuple[float, float] = (1e-6 * limits.min, 1e-6 * limits.max)
            camera.arm(2)
        except Exception:
            self.close()
            raise

    @property
    def exposure(self) -> float:
        """Exposure time in seconds."""
        return 1e-6 * self._camera.exposure_time_us

    @exposure.setter
    def exposure(self, value: float) -> None:
        self._camera.exposure_time_us = round(1e6 * float(_validate.number("exposure", value, positive=True)))

    def _frame(self) -> np.ndarray:
        self._camera.image_poll_timeout_ms = 0
        while self._camera.get_pending_frame_or_null() is not None:
            continue
        self._camera.image_poll_timeout_ms = round(1e3 * (self._timeout + self.exposure))
        self._camera.issue_software_trigger()
        frame = self._camera.get_pending_frame_or_null()
        if frame is None:
            # The frame may still come, and would be taken for the next one: disarming discards it.
            self._camera.disarm()
            self._camera.arm(2)
            raise OSError(f"the camera sent no frame within {self._timeout:g} s after the exposure")
        # The buffer is the camera's own, and is used again.
        return np.array(frame.image_buffer).reshape(self.shape)

    def close(self) -> None:
        """Stop the camera and release it."""
        if self._camera is not None:
            self._camera.disarm()
            self._camera.dispose()
        self._sdk.dispose()
