"""Drivers of instruments: a second screen, UVC, GenICam and Micro-Manager cameras, files in a shared folder.

None needs a library of one maker. The drivers of GenICam and Micro-Manager were run with stand-ins and with
Micro-Manager's demonstration camera, not with hardware.
"""

import glob
import os
import re
import time
import weakref
from collections.abc import Sequence
from typing import Any

import numpy as np

from odak import _show, _validate
from odak._warnings import AccuracyWarning, ArgumentWarning, warn
from odak.tools.paths import replacing, validate_path, write_file

# Value of OpenCV's property CAP_PROP_AUTO_EXPOSURE that switches automatic exposure off.
_MANUAL_EXPOSURE = 1.0


class ScreenModulator(_show.Shown):
    """Modulator that is a screen of this computer: a window over the whole of it shows the levels as grey.

    Parameters
    ----------
    pitch : float
        Distance between pixels in metres.
    display : int, optional
        Number of the screen, 0 for the first, see :meth:`identify`. By default the last one, where there are several:
        the only screen, which you work on, is taken if you ask for 0.
    shape : sequence of int, optional
        Rows and columns; the screen's by default. A warning says where they differ from the screen's.
    settling_time : float
        Seconds to wait after a pattern was drawn: settling time of the modulator plus delay of the screen.

    Attributes
    ----------
    bits : int
        8.

    Notes
    -----
    Needs the package pygame-ce (``pip install pygame-ce``). Each object has a window of its own, above all others, so
    that two panels of one table are two objects, each on its screen. Screens must not correct colours or scale: switch
    off night modes, and set a scale of 100 %. Under Windows and X11 :meth:`show` compares the screen with the levels
    every two seconds, and an :class:`odak.AccuracyWarning` says where another window, a cursor or a scale alters them.

    Examples
    --------
    >>> from odak.instruments import ScreenModulator
    >>> ScreenModulator.identify()  # doctest: +SKIP
    >>> modulator = ScreenModulator(pitch=8e-6, display=1, settling_time=0.1)  # doctest: +SKIP
    """

    bits = 8

    @_validate.takes_units("pitch")
    def __init__(
        self,
        pitch: float,
        display: int | None = None,
        shape: Sequence[int] | None = None,
        settling_time: float = 0.05,
    ):
        pygame = _screens()
        self._pygame = pygame
        count = pygame.display.get_num_displays()
        if display is None and count == 1:
            raise ValueError("there is one screen, on which you work: connect the modulator, or give display=0")
        display = (
            count - 1
            if display is None
            else _validate.integer("display", display, below=count, unit="(the number of screens)")
        )
        columns, rows = pygame.display.get_desktop_sizes()[display]
        self.shape: tuple[int, int] = (rows, columns) if shape is None else _validate.size("shape", shape)
        if self.shape != (rows, columns):
            warn(
                f"screen {display} has {rows} × {columns} pixels, the modulator {self.shape[0]} × {self.shape[1]}: set "
                "its resolution to the modulator's and its scale to 100 %, or pixels are interpolated",
                ArgumentWarning,
            )
        self.pitch: float = float(_validate.number("pitch", pitch, positive=True))
        self.settling_time: float = float(_validate.number("settling_time", settling_time, least=0))
        if display in _open:
            raise ValueError(
                f"display must be one that no other ScreenModulator covers, got {display}: close that first"
            )
        self._display = display
        self._window: Any = _window_on(pygame, display, self.shape)
        _open[display], self._looked = self, -_LOOK
        pygame.mouse.set_visible(False)

    def show(self, levels: np.ndarray) -> None:
        """Show levels 0 … 255, integers ``[rows, columns]``, and wait for the settling time."""
        if self._window is None:
            raise RuntimeError(f"the window on display {self._display} is closed: open a ScreenModulator anew")
        grey = checked_levels(levels, self.shape, self.bits).astype(np.uint8)
        colours = np.repeat(grey.T[..., None], 3, axis=-1)
        self._pygame.surfarray.blit_array(self._window.get_surface(), colours)
        self._window.flip()
        # Without this, window systems take the window for one that hangs.
        self._pygame.event.pump()
        time.sleep(self.settling_time)
        if time.monotonic() - self._looked >= _LOOK:
            self._look(grey)
            self._looked = time.monotonic()

    def _look(self, grey: np.ndarray) -> None:
        """Warn if the screen shows something else than levels."""
        for _ in range(_LATE):
            seen = _seen_in(self._pygame, self._window)
            if seen is None or seen.shape[:2] != grey.shape:
                return
            if not (wrong := (seen != grey[..., None]).any(-1)).any():
                return
            # Desktops draw windows some frames later.
            time.sleep(0.1)
        row, column = (int(np.flatnonzero(wrong.any(axis))[0]) for axis in (1, 0))
        warn(
            f"screen {self._display} shows other levels than it should at {wrong.mean():.1%} of the pixels, from row "
            f"{row} and column {column} on: close what covers it, switch off night modes and notifications, and set a "
            "scale of 100 %",
            AccuracyWarning,
        )

    def close(self) -> None:
        """Close the window; windows on other screens stay."""
        if self._window is not None:
            self._window.destroy()
            self._window = None
            _open.pop(self._display, None)

    @staticmethod
    def identify(seconds: float = 2.0) -> list[tuple[int, int]]:
        """Show on each screen, one after another, its number; return their rows and columns.

        Parameters
        ----------
        seconds : float
            How long each number is shown.

        Returns
        -------
        list of tuple of int
            Rows and columns of each screen.
        """
        seconds = float(_validate.number("seconds", seconds, least=0))
        pygame = _screens()
        pygame.font.init()
        sizes = pygame.display.get_desktop_sizes()
        for number, (columns, rows) in enumerate(sizes):
            window = _window_on(pygame, number, (rows, columns))
            surface, text = window.get_surface(), pygame.font.Font(None, rows // 2).render(str(number), True, "white")
            surface.fill("black")
            surface.blit(text, text.get_rect(center=surface.get_rect().center))
            window.flip()
            pygame.event.pump()
            time.sleep(seconds)
            window.destroy()
        return [(rows, columns) for columns, rows in sizes]


# Modulators that are open by the number of their screen: one each.
_open: weakref.WeakValueDictionary[int, ScreenModulator] = weakref.WeakValueDictionary()
# Seconds between two looks at what the screen of a modulator shows, and captures of it that may be late.
_LOOK, _LATE = 2.0, 5
# SDL's position of a window in the middle of a screen, less the number of the screen.
_CENTRED = 0x2FFF0000


def _screens() -> Any:
    """Return pygame with the screens of this computer known, in their own pixels."""
    pygame = _imported("pygame", "pygame-ce")
    # Otherwise Windows scales what is shown on screens whose scale is not 100 %.
    os.environ.setdefault("SDL_WINDOWS_DPI_AWARENESS", "permonitorv2")
    pygame.display.init()
    return pygame


def _window_on(pygame: Any, display: int, shape: Sequence[int]) -> Any:
    """Return a window without a frame in the middle of a screen, above all others."""
    rows, columns = shape
    place = (_CENTRED | display,) * 2
    return pygame.Window("odak", (columns, rows), place, borderless=True, always_on_top=True)


def _seen_in(pygame: Any, window: Any) -> np.ndarray | None:
    """Return what the screen shows in a window ``[rows, columns, 3]``, None where the window system does not tell."""
    from PIL import ImageGrab

    if pygame.display.get_driver() not in ("windows", "x11") or os.environ.get("WAYLAND_DISPLAY"):
        return None
    (left, upper), (columns, rows) = window.position, window.size
    try:
        return np.asarray(ImageGrab.grab((left, upper, left + columns, upper + rows), all_screens=True))[..., :3]
    except OSError:
        return None


class WholeFrames(_show.Shown):
    """Camera whose driver takes whole frames, of which captures are the region."""

    shape: tuple[int, int]
    region: tuple[int, int, int, int] | None = None
    _frame: Any

    def capture(self, count: int = 1) -> np.ndarray:
        """Return captures, unsigned integers ``[count, rows, columns]`` of the region."""
        window = self._window()
        return np.stack([self._frame()[window] for _ in range(_validate.integer("count", count, minimum=1))])

    def _window(self) -> tuple[slice, slice]:
        row, column, rows, columns = self.region or (0, 0, *self.shape)
        return slice(row, row + rows), slice(column, column + columns)


class VideoCamera(WholeFrames):
    """Camera of the USB video class, or anything else that OpenCV opens, such as a file of a video.

    Parameters
    ----------
    source : int or str
        Number of the camera, 0 for the first, or what OpenCV takes as a source: a file, a stream.
    pitch : float
        Distance between pixels in metres.
    exposure : float, optional
        Exposure time in seconds; by default what the camera is set to. Cameras of this class take it in whole units of
        100 µs, or whole powers of two, as `exposure_unit` says; the nearest is set, and :attr:`exposure` is what the
        camera reports.
    exposure_unit : {"100 us", "log2"}
        Unit of the driver: "100 us" on Linux (V4L2), "log2" of seconds on Windows (DirectShow).
    skip : int
        Frames that are thrown away before each capture, for those are older than the pattern.
    bits : int
        Bit depth of the frames, 8 or 16.

    Notes
    -----
    Needs the package opencv-python-headless (``pip install opencv-python-headless``). Coloured frames are converted to
    their green channel, which takes no gamma back: cameras for measurements should send raw frames.

    Examples
    --------
    >>> from odak.instruments import VideoCamera
    >>> camera = VideoCamera(0, pitch=3e-6)  # doctest: +SKIP
    """

    @_validate.takes_units("pitch")
    def __init__(
        self,
        source: int | str = 0,
        *,
        pitch: float,
        exposure: float | None = None,
        exposure_unit: str = "100 us",
        skip: int = 3,
        bits: int = 8,
    ):
        self._cv2 = _imported("cv2", "opencv-python-headless")
        if isinstance(source, bool) or not isinstance(source, (int, str)):
            raise TypeError(f"source must be an integer or a string, got {type(source).__name__}")
        self._unit = _validate.one_of("exposure_unit", exposure_unit, ("100 us", "log2"))
        self.pitch: float = float(_validate.number("pitch", pitch, positive=True))
        self._skip = _validate.integer("skip", skip)
        self.bits: int = _validate.integer("bits", bits, minimum=1)
        self._stream = self._cv2.VideoCapture(source)
        if not self._stream.isOpened():
            raise OSError(f"OpenCV cannot open the camera {source!r}")
        columns, rows = (int(self._stream.get(code)) for code in (3, 4))
        self.shape: tuple[int, int] = (rows, columns)
        # Of a file it is a name alone.
        self._adjustable = isinstance(source, int)
        self._exposure = 1.0
        if self._adjustable:
            self._exposure = self._seconds(self._stream.get(self._cv2.CAP_PROP_EXPOSURE), 1.0)
        if exposure is not None:
            self.exposure = exposure

    @property
    def exposure(self) -> float:
        """Exposure time in seconds."""
        return self._exposure

    @exposure.setter
    def exposure(self, value: float) -> None:
        value = float(_validate.number("exposure", value, positive=True))
        if self._adjustable:
            # Drivers truncate what is not whole.
            given = max(round(value / 1e-4), 1) if self._unit == "100 us" else round(float(np.log2(value)))
            self._stream.set(self._cv2.CAP_PROP_AUTO_EXPOSURE, _MANUAL_EXPOSURE)
            if not self._stream.set(self._cv2.CAP_PROP_EXPOSURE, float(given)):
                raise OSError(
                    f"the camera does not take an exposure of {value:g} s, {given} in units of {self._unit!r}: it may "
                    "lie beyond its limits, or the camera has no manual exposure, or another exposure_unit"
                )
            value = self._seconds(self._stream.get(self._cv2.CAP_PROP_EXPOSURE), self._seconds(given, value))
        self._exposure = value

    def _seconds(self, given: float, otherwise: float) -> float:
        """Return an exposure in units of the driver in seconds, or another number where the driver tells none."""
        if self._unit == "log2":
            return float(2.0**given) if -20 < given < 10 and given != 0 else otherwise
        return 1e-4 * given if given > 0 else otherwise

    def capture(self, count: int = 1) -> np.ndarray:
        """Return captures, uint8 or uint16 ``[count, rows, columns]`` of the region."""
        for _ in range(self._skip):
            self._frame()
        return super().capture(count)

    def _frame(self) -> np.ndarray:
        fine, frame = self._stream.read()
        if not fine:
            raise OSError("the camera sent no frame")
        return frame if frame.ndim == 2 else frame[..., min(1, frame.shape[-1] - 1)]

    def close(self) -> None:
        """Release the camera."""
        self._stream.release()


class GenICamCamera(WholeFrames):
    """Camera with a GenICam interface, as most industrial ones have: GigE Vision, USB3 Vision, CoaXPress, 10 GigE.

    Each capture is triggered by software, so that no frame is older than the pattern.

    Parameters
    ----------
    pitch : float
        Distance between pixels in metres.
    device : int or str
        Number of the camera, or its serial number.
    producer : str or os.PathLike, optional
        The GenTL producer of the maker or of another one, a ``.cti`` file; by default the files in the folders of the
        environment variable ``GENICAM_GENTL64_PATH``, which installers of makers set.
    pixel_format : str
        Name of a monochrome or Bayer format after the Pixel Format Naming Convention, such as "Mono8", "Mono12",
        "Mono12p", "Mono12Packed" or "BayerRG12"; of Bayer formats the mosaic is returned.
    timeout : float
        Seconds to wait for a frame beyond the exposure.
    bits : int, optional
        Bit depth where the format has more, such as 12 of "Mono16"; data in the upper bits are shifted down. That of
        the format by default.

    Notes
    -----
    Needs the package harvesters (``pip install harvesters``). EMVA, GenICam Standard Features Naming Convention 2.7 and
    Pixel Format Naming Convention 2.4; AIA, GigE Vision 2.0. Not run on hardware: tested with a stand-in.

    Examples
    --------
    >>> from odak.instruments import GenICamCamera
    >>> camera = GenICamCamera(3.45e-6, device="40012345", pixel_format="Mono12")  # doctest: +SKIP
    """

    @_validate.takes_units("pitch")
    def __init__(
        self,
        pitch: float,
        device: int | str = 0,
        producer: str | os.PathLike[str] | None = None,
        pixel_format: str = "Mono12",
        timeout: float = 5.0,
        bits: int | None = None,
    ):
        self.pitch: float = float(_validate.number("pitch", pitch, positive=True))
        self._timeout = float(_validate.number("timeout", timeout, positive=True))
        named = re.fullmatch(r"(?:Mono|Bayer(?:RG|GR|GB|BG))(\d+)(p|Packed)?", str(pixel_format))
        if named is None:
            raise ValueError(
                f"pixel_format must be Mono or Bayer and a number of bits, such as Mono12p or BayerRG12, got "
                f"{pixel_format!r}"
            )
        self._depth, self._packing = int(named[1]), named[2] or ""
        self.bits: int = self._depth if bits is None else _validate.integer("bits", bits, minimum=1)
        if self.bits > self._depth:
            raise ValueError(f"bits must be at most {self._depth}, those of {pixel_format}, got {bits}")
        self._harvester = _imported("harvesters.core", "harvesters").Harvester()
        for path in _producers(producer):
            self._harvester.add_file(path)
        self._harvester.update()
        found = self._harvester.device_info_list
        if not found:
            raise OSError("no GenICam camera answers: check its power, cable, address and the producer")
        if isinstance(device, str):
            chosen: Any = {"serial_number": device}
            known = [info.serial_number for info in found]
            if device not in known:
                raise ValueError(f"device must be one of the serial numbers {known}, got {device!r}")
        else:
            chosen = _validate.integer("device", device, below=len(found))
        self._camera = self._harvester.create(chosen)
        self._nodes = self._camera.remote_device.node_map
        for name, value in (
            ("AcquisitionMode", "Continuous"),
            ("PixelFormat", pixel_format),
            ("ExposureMode", "Timed"),
            ("ExposureTimeMode", "Common"),
            ("ExposureAuto", "Off"),
            ("GainAuto", "Off"),
            ("BlackLevelAuto", "Off"),
            ("GammaEnable", False),
            ("LUTEnable", False),
            ("TriggerSelector", "FrameStart"),
            ("TriggerMode", "On"),
            ("TriggerSource", "Software"),
        ):
            # A camera without automatic gain has no node of that name.
            if hasattr(self._nodes, name):
                getattr(self._nodes, name).value = value
        if self._nodes.PixelFormat.value != pixel_format:
            raise ValueError(f"the camera does not take the format {pixel_format!r}")
        self.shape: tuple[int, int] = (int(self._nodes.Height.value), int(self._nodes.Width.value))
        # Cameras of versions 1.x name it in another way.
        self._time = self._nodes.ExposureTime if hasattr(self._nodes, "ExposureTime") else self._nodes.ExposureTimeAbs
        self.exposure_limits: tuple[float, float] = (1e-6 * float(self._time.min), 1e-6 * float(self._time.max))
        self._camera.start()

    @property
    def exposure(self) -> float:
        """Exposure time in seconds."""
        return 1e-6 * float(self._time.value)

    @exposure.setter
    def exposure(self, value: float) -> None:
        self._time.value = 1e6 * float(_validate.number("exposure", value, positive=True))

    def _frame(self) -> np.ndarray:
        # Zero would wait without end.
        while (late := self._camera.try_fetch(timeout=1e-3)) is not None:
            late.queue()
        self._nodes.TriggerSoftware.execute()
        try:
            with self._camera.fetch(timeout=self._timeout + self.exposure) as buffer:
                part = buffer.payload.components[0]
                return self._counts(np.array(part.data, copy=True), part.height, part.width)
        except Exception:
            # The frame may still come, and would be taken for the next one: stopping discards it.
            self._camera.stop()
            self._camera.start()
            raise

    def _counts(self, data: np.ndarray, rows: int, columns: int) -> np.ndarray:
        """Return counts ``[rows, columns]`` from the data of a frame."""
        if self._packing and data.size != rows * columns:
            data = unpacked(data, self._depth, self._packing)[: rows * columns]
        shift = self._depth - self.bits
        if shift and not (np.bitwise_or.reduce(data, axis=None) & ((1 << shift) - 1)):
            data = data >> shift
        return data.reshape(rows, columns)

    def close(self) -> None:
        """Stop the camera and release it."""
        self._camera.stop()
        self._camera.destroy()
        self._harvester.reset()


class MicroManagerCamera(WholeFrames):
    """Camera that Micro-Manager drives: scientific cameras of most makers, through its device adapters.

    Parameters
    ----------
    configuration : str, os.PathLike or CMMCorePlus
        Micro-Manager's configuration file (``.cfg``), or a core of pymmcore-plus whose devices are loaded, which a
        modulator and a camera of one table share.
    pitch : float
        Distance between pixels in metres.
    device : str, optional
        Label of the camera; by default the one that the configuration names.

    Notes
    -----
    Needs the package pymmcore-plus (``pip install pymmcore-plus``) and Micro-Manager's device adapters (``mmcore
    install``). Run with the adapter of the demonstration camera, not with hardware.

    Examples
    --------
    >>> from odak.instruments import MicroManagerCamera
    >>> camera = MicroManagerCamera("table.cfg", pitch=6.5e-6)  # doctest: +SKIP
    """

    @_validate.takes_units("pitch")
    def __init__(self, configuration: Any, pitch: float, device: str | None = None):
        self.pitch: float = float(_validate.number("pitch", pitch, positive=True))
        self._core = _core_of(configuration)
        if device is not None:
            self._core.setCameraDevice(device)
        self._device = self._core.getCameraDevice()
        if not self._device:
            raise ValueError("the configuration names no camera; give device")
        self._core.clearROI()
        self.shape: tuple[int, int] = (int(self._core.getImageHeight()), int(self._core.getImageWidth()))

    @property
    def bits(self) -> int:
        """Bit depth."""
        return int(self._core.getImageBitDepth())

    @property
    def exposure(self) -> float:
        """Exposure time in seconds."""
        return 1e-3 * float(self._core.getExposure())

    @exposure.setter
    def exposure(self, value: float) -> None:
        self._core.setExposure(1e3 * float(_validate.number("exposure", value, positive=True)))

    def _frame(self) -> np.ndarray:
        self._core.setCameraDevice(self._device)
        self._core.snapImage()
        return np.array(self._core.getImage())


class MicroManagerModulator(_show.Shown):
    """Modulator that Micro-Manager drives, by an adapter of its maker or as a screen.

    Parameters
    ----------
    configuration : str, os.PathLike or CMMCorePlus
        Micro-Manager's configuration file (``.cfg``), or a core of pymmcore-plus whose devices are loaded.
    pitch : float
        Distance between pixels in metres.
    device : str, optional
        Label of the modulator; by default the one that the configuration names.
    settling_time : float
        Seconds to wait after a pattern was shown.

    Attributes
    ----------
    bits : int
        8.

    Notes
    -----
    Needs the package pymmcore-plus (``pip install pymmcore-plus``). Not run on hardware: tested with a stand-in.

    Examples
    --------
    >>> from odak.instruments import MicroManagerModulator
    >>> modulator = MicroManagerModulator("table.cfg", pitch=8e-6, settling_time=0.05)  # doctest: +SKIP
    """

    shape: tuple[int, int]

    bits = 8

    @_validate.takes_units("pitch")
    def __init__(self, configuration: Any, pitch: float, device: str | None = None, settling_time: float = 0.05):
        self.pitch: float = float(_validate.number("pitch", pitch, positive=True))
        self.settling_time: float = float(_validate.number("settling_time", settling_time, least=0))
        self._core = _core_of(configuration)
        self._device = self._core.getSLMDevice() if device is None else device
        if not self._device:
            raise ValueError("the configuration names no modulator; give device")
        if (size := self._core.getSLMBytesPerPixel(self._device)) != 1:
            raise ValueError(f"the modulator {self._device!r} must take one byte per pixel, got {size}")
        self.shape = (int(self._core.getSLMHeight(self._device)), int(self._core.getSLMWidth(self._device)))

    def show(self, levels: np.ndarray) -> None:
        """Show levels 0 … 255, integers ``[rows, columns]``, and wait for the settling time."""
        self._core.setSLMImage(self._device, checked_levels(levels, self.shape, self.bits))
        self._core.displaySLMImage(self._device)
        self._core.waitForDevice(self._device)
        time.sleep(self.settling_time)


class FileModulator(_show.Shown):
    """Modulator behind a folder, of another computer for instance: each pattern is a file that appears whole.

    The pattern of number k is written as ``pattern_<k>.npy`` and then named by ``pattern.txt``, which holds k. Whoever
    shows it may answer by a file ``shown.txt`` with the number.

    Parameters
    ----------
    folder : str or os.PathLike
        Folder, for example on a network share.
    shape : sequence of int
        Rows and columns.
    pitch : float
        Distance between pixels in metres.
    bits : int
        Bit depth.
    settling_time : float
        Seconds to wait after a pattern was shown.
    answer : bool
        Wait for ``shown.txt``.
    timeout : float
        Seconds to wait for it.

    Examples
    --------
    >>> import os, tempfile
    >>> import numpy as np
    >>> from odak.instruments import FileModulator
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     modulator = FileModulator(folder, (4, 6), 8e-6, answer=False, settling_time=0)
    ...     modulator.show(np.zeros((4, 6), dtype=np.uint8))
    ...     sorted(os.listdir(folder))
    ['pattern.txt', 'pattern_1.npy']
    """

    @_validate.takes_units("pitch")
    def __init__(
        self,
        folder: str | os.PathLike[str],
        shape: Sequence[int],
        pitch: float,
        bits: int = 8,
        settling_time: float = 0.1,
        answer: bool = True,
        timeout: float = 30.0,
    ):
        self._folder = _folder(folder)
        self.shape: tuple[int, int] = _validate.size("shape", shape)
        self.pitch: float = float(_validate.number("pitch", pitch, positive=True))
        self.bits: int = _validate.integer("bits", bits, minimum=1)
        self.settling_time: float = float(_validate.number("settling_time", settling_time, least=0))
        self._answer = _validate.flag("answer", answer)
        self._timeout = float(_validate.number("timeout", timeout, positive=True))
        self._number = _number_in(os.path.join(self._folder, "pattern.txt")) or 0

    def show(self, levels: np.ndarray) -> None:
        """Write levels, integers ``[rows, columns]``, and wait until they are shown."""
        found = checked_levels(levels, self.shape, self.bits)
        before, self._number = self._number, self._number + 1
        _write_array(os.path.join(self._folder, f"pattern_{self._number}.npy"), found)
        write_file(os.path.join(self._folder, "pattern.txt"), str(self._number).encode())
        if self._answer:
            answer = os.path.join(self._folder, "shown.txt")
            _wait(lambda: _number_in(answer) == self._number, self._timeout, answer)
        time.sleep(self.settling_time)
        old = os.path.join(self._folder, f"pattern_{before}.npy")
        if os.path.exists(old):
            os.remove(old)


class FileCamera(WholeFrames):
    """Camera behind a folder, of another computer for instance: each request and each capture is a file.

    A request of number k is ``request.txt`` with three numbers: k, how many captures, and the exposure in seconds. The
    answer is ``capture_<k>.npy``, integers ``[count, rows, columns]``, which must appear whole: written under another
    name and renamed.

    Parameters
    ----------
    folder : str or os.PathLike
        Folder, for example on a network share.
    shape : sequence of int
        Rows and columns.
    pitch : float
        Distance between pixels in metres.
    bits : int
        Bit depth.
    exposure : float
        Exposure time in seconds.
    timeout : float
        Seconds to wait for a capture.

    Examples
    --------
    The other program writes the captures, here before they are asked for:

    >>> import os, tempfile
    >>> import numpy as np
    >>> from odak.instruments import FileCamera
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     camera = FileCamera(folder, (4, 6), 3.45e-6)
    ...     np.save(os.path.join(folder, "capture_1.npy"), np.zeros((2, 4, 6), dtype=np.uint16))
    ...     camera.capture(2).shape
    (2, 4, 6)
    """

    @_validate.takes_units("pitch")
    def __init__(
        self,
        folder: str | os.PathLike[str],
        shape: Sequence[int],
        pitch: float,
        bits: int = 12,
        exposure: float = 1e-3,
        timeout: float = 30.0,
    ):
        self._folder = _folder(folder)
        self.shape: tuple[int, int] = _validate.size("shape", shape)
        self.pitch: float = float(_validate.number("pitch", pitch, positive=True))
        self.bits: int = _validate.integer("bits", bits, minimum=1)
        self.exposure: float = float(_validate.number("exposure", exposure, positive=True))
        self._timeout = float(_validate.number("timeout", timeout, positive=True))
        self._number = (_text_in(os.path.join(self._folder, "request.txt")) or "0").split()[0]

    def capture(self, count: int = 1) -> np.ndarray:
        """Return captures, integers ``[count, rows, columns]`` of the region."""
        count = _validate.integer("count", count, minimum=1)
        self._number = str(int(self._number) + 1)
        write_file(os.path.join(self._folder, "request.txt"), f"{self._number} {count} {self.exposure!r}".encode())
        path = os.path.join(self._folder, f"capture_{self._number}.npy")
        _wait(lambda: os.path.exists(path), self._timeout, path)
        with _validate.refusing(f"{path!r} cannot be read as captures: ", ValueError, EOFError):
            frames = np.load(path, allow_pickle=False)
        if frames.shape != (count, *self.shape) or frames.dtype.kind not in "iu":
            expected = [count, *self.shape]
            raise ValueError(f"{path!r} must contain integers {expected}, got {frames.dtype} {list(frames.shape)}")
        os.remove(path)
        down, across = self._window()
        return frames[:, down, across]


def unpacked(data: np.ndarray, bits: int, packing: str) -> np.ndarray:
    """Return counts from bytes that hold them packed.

    Parameters
    ----------
    data : numpy.ndarray
        Bytes.
    bits : int
        Bit depth, for "Packed" 10 or 12.
    packing : {"p", "Packed"}
        "p" of the Pixel Format Naming Convention: one after another from the lowest bit on. "Packed" of GigE Vision:
        two in three bytes, of which the first and the last hold the upper bits, and the middle one the lower ones.

    Returns
    -------
    numpy.ndarray
        The counts, uint16.
    """
    if packing == "p":
        single = np.unpackbits(data.view(np.uint8), bitorder="little")
        single = single[: single.size // bits * bits].reshape(-1, bits)
        return (single.astype(np.uint16) << np.arange(bits, dtype=np.uint16)).sum(-1, dtype=np.uint16)
    first, middle, last = data.view(np.uint8).reshape(-1, 3).T.astype(np.uint16)
    low = (1 << (bits - 8)) - 1
    pairs = (first << (bits - 8)) | (middle & low), (last << (bits - 8)) | ((middle >> 4) & low)
    return np.stack(pairs, axis=-1).ravel()


def checked_levels(levels: Any, shape: Sequence[int], bits: int) -> np.ndarray:
    """Return a pattern of levels after checking its shape, type and range.

    Parameters
    ----------
    levels : array
        Integers ``[rows, columns]``.
    shape : sequence of int
        Rows and columns of the modulator.
    bits : int
        Its bit depth.

    Returns
    -------
    numpy.ndarray
        The levels, uint8 or uint16.

    Raises
    ------
    ValueError
        If the levels do not fit the modulator.
    """
    found = np.asarray(_validate.array("levels", levels))
    if found.shape != tuple(shape) or found.dtype.kind not in "iu":
        raise ValueError(f"levels must be integers {list(shape)}, got {found.dtype} {list(found.shape)}")
    top = (1 << bits) - 1
    if found.min() < 0 or found.max() > top:
        raise ValueError(f"levels must be 0 to {top}, got {found.min()} to {found.max()}")
    return found.astype(np.uint8 if bits <= 8 else np.uint16)


def _imported(module: str, package: str, how: str = ": pip install {}") -> Any:
    return _validate.optional(module, f"this driver needs {package}{how.format(package)}")


def existing_file(name: str, path: str | os.PathLike[str]) -> str:
    """Return the path of a file, and raise an error that names the argument if there is none."""
    found = validate_path(path, name=name)
    if not os.path.isfile(found):
        raise ValueError(f"{name} must be a file that exists, got {found!r}")
    return found


def _producers(producer) -> list[str]:
    """Return the GenTL producers to load."""
    if producer is not None:
        return [existing_file("producer", producer)]
    folders = os.environ.get("GENICAM_GENTL64_PATH", "").split(os.pathsep)
    found = [path for folder in folders if folder for path in sorted(glob.glob(os.path.join(folder, "*.cti")))]
    if not found:
        raise ValueError("producer must be given: GENICAM_GENTL64_PATH names no folder with a .cti file")
    return found


def _core_of(configuration) -> Any:
    """Return Micro-Manager's core with the devices of a configuration."""
    if not isinstance(configuration, (str, os.PathLike)):
        return configuration
    path = existing_file("configuration", configuration)
    core = _imported("pymmcore_plus", "pymmcore-plus").CMMCorePlus()
    core.loadSystemConfiguration(path)
    return core


def _folder(folder: str | os.PathLike[str]) -> str:
    path = validate_path(folder, name="folder")
    if not os.path.isdir(path):
        raise ValueError(f"folder must exist, got {path!r}")
    return path


def _text_in(path: str) -> str | None:
    if not os.path.exists(path):
        return None
    with open(path, encoding="utf-8") as stream:
        return stream.read().strip()


def _number_in(path: str) -> int | None:
    text = _text_in(path)
    return int(text) if text and text.isdigit() else None


def _write_array(path: str, values: np.ndarray) -> None:
    with replacing(path) as stream:
        np.save(stream, values, allow_pickle=False)


def _wait(ready, timeout: float, path: str) -> None:
    """Return as soon as a file is ready; raise a TimeoutError that names the missing file."""
    end = time.monotonic() + timeout
    while not ready():
        if time.monotonic() > end:
            raise TimeoutError(f"the file {path!r} did not appear within {timeout:g} s")
        time.sleep(0.01)
