"""Drivers of instruments that need no library of a maker: a second screen, a UVC camera, files in a shared folder."""

import os
import time
from collections.abc import Sequence
from typing import Any

import numpy as np

from odak import _show, _validate
from odak.tools.paths import replacing, validate_path

__all__ = ["FileCamera", "FileModulator", "ScreenModulator", "VideoCamera"]

# Value of OpenCV's property CAP_PROP_AUTO_EXPOSURE that switches automatic exposure off.
_MANUAL_EXPOSURE = 1.0


class ScreenModulator:
    """Modulator that is a screen of this computer: a window over the whole of it shows the levels as grey.

    Parameters
    ----------
    pitch : float
        Distance between pixels in metres.
    display : int
        Number of the screen, 0 for the first.
    shape : sequence of int, optional
        Rows and columns; those of the screen by default.
    settling_time : float
        Seconds to wait after a pattern was drawn: that of the modulator and the delay of the screen.

    Attributes
    ----------
    bits : int
        8.

    Notes
    -----
    Needs the package pygame-ce (``pip install pygame-ce``). Screens must not correct colours or scale: switch
    off night modes, and set a scale of 100 %.

    Examples
    --------
    >>> from odak.instruments import ScreenModulator
    >>> modulator = ScreenModulator(pitch=8e-6, display=1, settling_time=0.1)  # doctest: +SKIP
    """

    bits = 8

    __repr__ = _show.one_line

    @_validate.takes_units("pitch")
    def __init__(self, pitch: float, display: int = 0, shape: Sequence[int] | None = None, settling_time: float = 0.05):
        pygame = _imported("pygame", "pygame-ce")
        self._pygame = pygame
        pygame.display.init()
        display, count = _validate.integer("display", display), pygame.display.get_num_displays()
        if display >= count:
            raise ValueError(f"display must be below {count}, the number of screens, got {display}")
        columns, rows = pygame.display.get_desktop_sizes()[display]
        self.shape = (rows, columns) if shape is None else _validate.size("shape", shape)
        self.pitch = float(_validate.number("pitch", pitch, positive=True))
        self.settling_time = float(_validate.number("settling_time", settling_time, least=0))
        self._window = pygame.display.set_mode(self.shape[::-1], pygame.NOFRAME, display=display)
        pygame.mouse.set_visible(False)

    def show(self, levels: np.ndarray) -> None:
        """Show levels 0 … 255, integers ``[rows, columns]``, and wait for the settling time."""
        grey = checked_levels(levels, self.shape, self.bits).astype(np.uint8)
        colours = np.repeat(grey.T[..., None], 3, axis=-1)
        self._pygame.surfarray.blit_array(self._window, colours)
        self._pygame.display.flip()
        # Without this, window systems take the window for one that hangs.
        self._pygame.event.pump()
        time.sleep(self.settling_time)

    def close(self) -> None:
        """Close the window."""
        self._pygame.display.quit()


class VideoCamera:
    """Camera of the USB video class, or anything else that OpenCV opens, such as a file of a video.

    Parameters
    ----------
    source : int or str
        Number of the camera, 0 for the first, or what OpenCV takes as a source: a file, a stream.
    pitch : float
        Distance between pixels in metres.
    exposure : float, optional
        Exposure time in seconds; by default what the camera is set to. Cameras of this class take it in units of
        100 µs, or in powers of two, as `exposure_unit` says.
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

    __repr__ = _show.one_line

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
        self.pitch = float(_validate.number("pitch", pitch, positive=True))
        self._skip, self.bits = _validate.integer("skip", skip), _validate.integer("bits", bits, minimum=1)
        self._stream = self._cv2.VideoCapture(source)
        if not self._stream.isOpened():
            raise OSError(f"OpenCV cannot open the camera {source!r}")
        self.region: tuple[int, int, int, int] | None = None
        columns, rows = (int(self._stream.get(code)) for code in (3, 4))
        self.shape = (rows, columns)
        self._exposure = 1.0
        if exposure is not None:
            self.exposure = exposure

    @property
    def exposure(self) -> float:
        """Exposure time in seconds."""
        return self._exposure

    @exposure.setter
    def exposure(self, value: float) -> None:
        value = float(_validate.number("exposure", value, positive=True))
        given = value / 1e-4 if self._unit == "100 us" else float(np.log2(value))
        self._stream.set(self._cv2.CAP_PROP_AUTO_EXPOSURE, _MANUAL_EXPOSURE)
        self._stream.set(self._cv2.CAP_PROP_EXPOSURE, given)
        self._exposure = value

    def capture(self, count: int = 1) -> np.ndarray:
        """Return captures, uint8 or uint16 ``[count, rows, columns]`` of the region."""
        row, column, rows, columns = self.region or (0, 0, *self.shape)
        frames = []
        for number in range(self._skip + _validate.integer("count", count, minimum=1)):
            fine, frame = self._stream.read()
            if not fine:
                raise OSError(f"the camera sent no frame {number + 1} of {self._skip + count}")
            if number >= self._skip:
                frame = frame if frame.ndim == 2 else frame[..., min(1, frame.shape[-1] - 1)]
                frames.append(frame[row : row + rows, column : column + columns])
        return np.stack(frames)

    def close(self) -> None:
        """Release the camera."""
        self._stream.release()


class FileModulator:
    """Modulator behind a folder, of another computer for instance: each pattern is a file that appears whole.

    The pattern of number k is written as ``pattern_<k>.npy`` and then named by ``pattern.txt``, which holds k. Whoever
    shows it may answer by a file ``shown.txt`` with the number.

    Parameters
    ----------
    folder : str or os.PathLike
        Folder, such as that of a network share.
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

    __repr__ = _show.one_line

    @_validate.takes_units("pitch")
    def __init__(
        self,
        folder: str | os.PathLike,
        shape: Sequence[int],
        pitch: float,
        bits: int = 8,
        settling_time: float = 0.1,
        answer: bool = True,
        timeout: float = 30.0,
    ):
        self._folder = _folder(folder)
        self.shape = _validate.size("shape", shape)
        self.pitch = float(_validate.number("pitch", pitch, positive=True))
        self.bits = _validate.integer("bits", bits, minimum=1)
        self.settling_time = float(_validate.number("settling_time", settling_time, least=0))
        self._answer = _validate.flag("answer", answer)
        self._timeout = float(_validate.number("timeout", timeout, positive=True))
        self._number = _number_in(os.path.join(self._folder, "pattern.txt")) or 0

    def show(self, levels: np.ndarray) -> None:
        """Write levels, integers ``[rows, columns]``, and wait until they are shown."""
        found = checked_levels(levels, self.shape, self.bits)
        before, self._number = self._number, self._number + 1
        _write_array(os.path.join(self._folder, f"pattern_{self._number}.npy"), found)
        with replacing(os.path.join(self._folder, "pattern.txt")) as stream:
            stream.write(str(self._number).encode())
        if self._answer:
            answer = os.path.join(self._folder, "shown.txt")
            _wait(lambda: _number_in(answer) == self._number, self._timeout, answer)
        time.sleep(self.settling_time)
        old = os.path.join(self._folder, f"pattern_{before}.npy")
        if os.path.exists(old):
            os.remove(old)


class FileCamera:
    """Camera behind a folder, of another computer for instance: each request and each capture is a file.

    A request of number k is ``request.txt`` with three numbers: k, how many captures, and the exposure in seconds. The
    answer is ``capture_<k>.npy``, integers ``[count, rows, columns]``, which must appear whole: written under another
    name and renamed.

    Parameters
    ----------
    folder : str or os.PathLike
        Folder, such as that of a network share.
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

    __repr__ = _show.one_line

    @_validate.takes_units("pitch")
    def __init__(
        self,
        folder: str | os.PathLike,
        shape: Sequence[int],
        pitch: float,
        bits: int = 12,
        exposure: float = 1e-3,
        timeout: float = 30.0,
    ):
        self._folder = _folder(folder)
        self.shape = _validate.size("shape", shape)
        self.pitch = float(_validate.number("pitch", pitch, positive=True))
        self.bits = _validate.integer("bits", bits, minimum=1)
        self.exposure = float(_validate.number("exposure", exposure, positive=True))
        self.region: tuple[int, int, int, int] | None = None
        self._timeout = float(_validate.number("timeout", timeout, positive=True))
        self._number = (_text_in(os.path.join(self._folder, "request.txt")) or "0").split()[0]

    def capture(self, count: int = 1) -> np.ndarray:
        """Return captures, integers ``[count, rows, columns]`` of the region."""
        count = _validate.integer("count", count, minimum=1)
        self._number = str(int(self._number) + 1)
        with replacing(os.path.join(self._folder, "request.txt")) as stream:
            stream.write(f"{self._number} {count} {self.exposure!r}".encode())
        path = os.path.join(self._folder, f"capture_{self._number}.npy")
        _wait(lambda: os.path.exists(path), self._timeout, path)
        try:
            frames = np.load(path, allow_pickle=False)
        except (ValueError, EOFError) as error:
            raise ValueError(f"{path!r} cannot be read as captures: {error}") from error
        if frames.shape != (count, *self.shape) or frames.dtype.kind not in "iu":
            expected = [count, *self.shape]
            raise ValueError(f"{path!r} must contain integers {expected}, got {frames.dtype} {list(frames.shape)}")
        os.remove(path)
        row, column, rows, columns = self.region or (0, 0, *self.shape)
        return frames[:, row : row + rows, column : column + columns]


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


def _imported(module: str, package: str) -> Any:
    import importlib

    try:
        return importlib.import_module(module)
    except ImportError:
        raise ImportError(f"this driver needs {package}: pip install {package}") from None


def _folder(folder: str | os.PathLike) -> str:
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
