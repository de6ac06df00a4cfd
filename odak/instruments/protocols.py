"""Protocols of the instruments of an optical table, and the entry points by which drivers are found."""

from importlib.metadata import entry_points
from typing import Any, Protocol, runtime_checkable

import numpy as np

from odak import _validate

# Group of entry points of packages that hold drivers: name → class or function that opens an instrument.
ENTRY_POINTS = "odak.instruments"


@runtime_checkable
class SLMDriver(Protocol):
    """Spatial light modulator that shows patterns of grey levels.

    Attributes
    ----------
    shape : tuple of int
        Rows and columns.
    pitch : float
        Distance between pixels in metres.
    bits : int
        Bit depth: levels are 0 … 2^bits − 1.
    settling_time : float
        Seconds after which a new pattern is shown completely; :meth:`show` waits for it. May be set.

    Examples
    --------
    Any class with these attributes and methods is one; it needs no base class:

    >>> import numpy as np
    >>> from odak.instruments import SLMDriver
    >>> class Panel:
    ...     shape, pitch, bits, settling_time = (1080, 1920), 8e-6, 8, 0.05
    ...     def show(self, levels):
    ...         self.shown = np.asarray(levels)
    >>> isinstance(Panel(), SLMDriver)
    True
    """

    shape: tuple[int, int]
    pitch: float
    bits: int
    settling_time: float

    def show(self, levels: np.ndarray) -> None:
        """Show a pattern of levels, integers ``[rows, columns]``, and return when it has settled."""
        ...


@runtime_checkable
class Camera(Protocol):
    """Camera that captures intensities.

    Attributes
    ----------
    shape : tuple of int
        Rows and columns of the sensor.
    pitch : float
        Distance between pixels in metres.
    bits : int
        Bit depth: counts are 0 … 2^bits − 1.
    exposure : float
        Exposure time in seconds; may be set.
    region : tuple of int or None
        First row, first column, rows and columns that are read out; None for the whole sensor. May be set.
    exposure_limits : tuple of float, optional
        Shortest and longest exposure time in seconds; measurements keep within them.

    Notes
    -----
    Measurements check what :meth:`capture` returns. They also take one frame ``[rows, columns]`` for each call, whole
    frames where a region was set, and colour frames ``[count, rows, columns, 3]``, whose channel of the largest
    variance is used: light of one wavelength. Floating-point multiples of 1/(2^bits − 1) up to 1 are shares of the
    range, and become counts. Other shapes, other numbers below 1, counts beyond the bit depth, integers of fewer bits,
    and data that are shifted to the upper bits raise a ValueError.

    Examples
    --------
    >>> import numpy as np
    >>> from odak.instruments import Camera
    >>> class Dark:
    ...     shape, pitch, bits, exposure, region = (480, 640), 4e-6, 12, 1e-3, None
    ...     def capture(self, count=1):
    ...         return np.zeros((count, *self.shape), dtype=np.uint16)
    >>> isinstance(Dark(), Camera), Dark().capture(2).shape
    (True, (2, 480, 640))
    """

    shape: tuple[int, int]
    pitch: float
    bits: int
    exposure: float
    region: tuple[int, int, int, int] | None

    def capture(self, count: int = 1) -> np.ndarray:
        """Return captures as integers ``[count, rows, columns]`` of the region."""
        ...


@runtime_checkable
class Laser(Protocol):
    """Laser of one wavelength.

    Attributes
    ----------
    wavelength : float
        Vacuum wavelength in metres; may be set where the laser has several lines.
    power : float
        Power as a fraction of the largest, 0 … 1; may be set.

    Examples
    --------
    >>> from odak.instruments import Laser, SimulatedTable
    >>> laser = SimulatedTable(seed=1, shape=(24, 24), camera_shape=(32, 32)).laser
    >>> isinstance(laser, Laser), laser.wavelength
    (True, 5.32e-07)
    """

    wavelength: float
    power: float


@runtime_checkable
class Stage(Protocol):
    """Linear stage that carries the camera along the optical axis.

    Attributes
    ----------
    position : float
        Position in metres, positive away from the modulator.

    Examples
    --------
    >>> from odak.instruments import SimulatedTable, Stage
    >>> stage = SimulatedTable(seed=1, shape=(24, 24), camera_shape=(32, 32)).stage
    >>> stage.move(1e-3)
    >>> isinstance(stage, Stage), stage.position
    (True, 0.001)
    """

    position: float

    def move(self, position: float) -> None:
        """Move to a position and return when it is reached."""
        ...


@runtime_checkable
class Rotator(Protocol):
    """Rotation mount that carries a polariser or a wave plate.

    Attributes
    ----------
    angle : float
        Angle in degrees.

    Examples
    --------
    >>> from odak.instruments import Rotator, SimulatedTable
    >>> rotator = SimulatedTable(seed=1, shape=(24, 24), camera_shape=(32, 32)).polariser
    >>> rotator.turn(30.0)
    >>> isinstance(rotator, Rotator), rotator.angle
    (True, 30.0)
    """

    angle: float

    def turn(self, angle: float) -> None:
        """Rotate to an angle in degrees and return when it is reached."""
        ...


def check_square_pixels(modulator: Any, camera: Any) -> None:
    """Raise a ValueError if the pitch of a modulator or of a camera is not one positive number.

    Parameters
    ----------
    modulator : SLMDriver
        The modulator.
    camera : Camera
        The camera.
    """
    for name, instrument in (("modulator", modulator), ("camera", camera)):
        if np.size(instrument.pitch) != 1:
            raise ValueError(f"{name}.pitch must be one number in metres, for square pixels, got {instrument.pitch!r}")
        _validate.number(f"{name}.pitch", instrument.pitch, positive=True)


class CheckedCamera:
    """Camera whose captures are checked and brought to one form, whose exposure keeps within its limits.

    Parameters
    ----------
    camera : Camera
        The camera.
    """

    def __init__(self, camera: Any):
        self.camera: Camera = camera
        self.pitch: float = camera.pitch
        rows, columns = _validate.size("camera.shape", camera.shape)
        self.shape: tuple[int, int] = (rows, columns)
        self.bits: int = _validate.integer("camera.bits", camera.bits, minimum=1)
        limits = getattr(camera, "exposure_limits", None)
        if limits is not None:
            limits = _validate.several("camera.exposure_limits", limits, 2, positive=True)
        self.limits: tuple[float, float] = (0.0, np.inf) if limits is None else (float(limits[0]), float(limits[1]))
        self.examined: bool = False
        self.watched: bool = False
        self.taken: int = 0
        # The last capture, its exposure and its region.
        self.last: tuple[np.ndarray, float, tuple[int, int, int, int] | None] | None = None
        self.exposures: dict[str, float] = {}
        self._stuck = np.zeros((0, 2), dtype=int)

    @property
    def exposure(self) -> float:
        """Exposure time in seconds."""
        return self.camera.exposure

    @exposure.setter
    def exposure(self, value: float) -> None:
        self.camera.exposure = float(np.clip(value, *self.limits))

    def expose(self, seconds: float) -> float:
        """Set the exposure time, and return what the camera made of it: it has limits and steps of its own."""
        self.exposure = seconds
        return float(self.exposure)

    @property
    def region(self) -> tuple[int, int, int, int] | None:
        """First row, first column, rows and columns that are read out; None for the whole sensor."""
        return self.camera.region

    @region.setter
    def region(self, value: tuple[int, int, int, int] | None) -> None:
        self.camera.region = value

    @property
    def top(self) -> int:
        """Largest count."""
        return (1 << self.bits) - 1

    def replace(self, stuck: np.ndarray) -> None:
        """Replace pixels, of a mask of the region, in later captures by the median of those around them."""
        row, column, *_ = self.region or (0, 0)
        self._stuck = np.concatenate([self._stuck, np.argwhere(stuck) + np.array([row, column])])

    def capture(self, count: int = 1) -> np.ndarray:
        """Return captures ``[count, rows, columns]`` of the region."""
        frames = checked_frames(self.camera.capture(count), count, self)
        while len(frames) < count:
            more = checked_frames(self.camera.capture(count - len(frames)), count - len(frames), self)
            frames = np.concatenate([frames, more])
        first, size = np.array((self.region or (0, 0))[:2]), np.array(frames.shape[1:])
        places = self._stuck - first
        places = places[((places >= 0) & (places < size)).all(-1)]
        if len(places):
            frames = frames.copy()
            bad = np.zeros(size, dtype=bool)
            bad[tuple(places.T)] = True
            for row, column in places:
                down, across = slice(max(row - 1, 0), row + 2), slice(max(column - 1, 0), column + 2)
                fine = frames[:, down, across][:, ~bad[down, across]]
                frames[:, row, column] = np.median(fine, axis=-1) if fine.size else 0
        self.taken, self.last = self.taken + count, (frames[-1], self.exposure, self.region)
        return frames


def checked_camera(camera: Any) -> CheckedCamera:
    """Return a camera whose captures are checked, the same if they are already."""
    return camera if isinstance(camera, CheckedCamera) else CheckedCamera(camera)


def checked_dark(dark: Any, frames: np.ndarray) -> np.ndarray:
    """Return the counts without light, one number or an image of the size of the camera's frames."""
    found = np.asarray(dark, float)
    if found.ndim and found.shape != frames.shape[-2:]:
        raise ValueError(
            f"dark must be a number or an image {list(frames.shape[-2:])}, as the camera takes them, got the shape "
            f"{list(found.shape)}"
        )
    return found


def checked_frames(frames: Any, count: int, camera: Any) -> np.ndarray:
    """Return captures of a camera ``[at most count, rows, columns]`` of its region after a check.

    Parameters
    ----------
    frames : array
        What the camera returned.
    count : int
        Number of captures asked for.
    camera : Camera
        The camera.

    Returns
    -------
    numpy.ndarray
        The captures.

    Raises
    ------
    TypeError, ValueError
        If they are not captures of this camera; the message names the remedy.
    """
    found = np.asarray(frames)
    if found.dtype.kind not in "uif":
        raise TypeError(f"camera.capture must return integers [count, rows, columns], got an array of {found.dtype}")
    whole = tuple(camera.shape)
    row, column, *size = camera.region or (0, 0, *whole)
    sizes = (tuple(size), whole)
    got = list(found.shape)
    if found.shape[-2:] not in sizes and found.shape[-3:-1] in sizes and found.shape[-1] in (1, 3, 4):
        # Light of one wavelength; the fourth channel is the transparency.
        channels = found[..., :3]
        found = channels[..., int(channels.reshape(-1, channels.shape[-1]).var(0).argmax())]
    if found.ndim == 4 and found.shape[1] == 1:
        found = found[:, 0]
    found = found[None] if found.ndim == 2 else found
    if found.ndim != 3 or found.shape[1:] not in sizes or not 0 < len(found) <= count:
        turned = any(part[::-1] in sizes for part in (tuple(got[-2:]), tuple(got[-3:-1]))) and size[0] != size[1]
        hint = (
            "; these are columns and rows: transpose the frames, or exchange the numbers of camera.shape"
            if turned
            else ""
        )
        raise ValueError(
            f"camera.capture({count}) must return [{count}, {size[0]}, {size[1]}] (count, rows, columns) or colours in "
            f"a last axis of 3, got {got}{hint}"
        )
    if found.shape[1:] != tuple(size):
        found = found[:, row : row + size[0], column : column + size[1]]
    largest, smallest, top = found.max(), found.min(), (1 << camera.bits) - 1
    if not (np.isfinite(largest) and smallest >= 0):
        raise ValueError(
            f"captures must be counts from 0 to {top}, got {smallest} to {largest}"
            + ("; 16 bits were read as signed integers: use .view(numpy.uint16)" if found.dtype == np.int16 else "")
        )
    if found.dtype.kind == "f" and 0 < largest <= 1 < top and (found % 1 != 0).any():
        counts = np.rint(found.astype(float) * top)
        if np.abs(found - counts / top).max() > 1e-2 / top:
            raise ValueError(
                f"captures must be counts from 0 to {top}, camera.bits = {camera.bits}, got numbers from "
                f"{smallest:.3g} to {largest:.3g} that are no multiples of 1/{top}: return the counts of the camera, "
                "not scaled"
            )
        # Shares of the range.
        found, largest = counts, largest * top
    if found.dtype.kind in "ui" and 8 * found.dtype.itemsize < camera.bits:
        raise ValueError(
            f"captures of {8 * found.dtype.itemsize} bits ({found.dtype}) cannot hold counts to {top}: set camera.bits "
            f"to {8 * found.dtype.itemsize}, now {camera.bits}, or let the camera send {camera.bits} bits"
        )
    if found.dtype.kind in "ui" and largest > smallest:
        used = int(np.bitwise_or.reduce(found, axis=None))
        shift = (used & -used).bit_length() - 1
        if shift >= 2 and (largest > top or len(np.unique(found.ravel()[:10_000])) > 16):
            raise ValueError(
                f"all counts are multiples of {1 << shift}, up to {largest}: the camera shifts its data left by "
                f"{shift} bits; return frames >> {shift}, with camera.bits the bits that are left"
            )
    if largest > top:
        raise ValueError(
            f"captures must be counts from 0 to {top}, camera.bits = {camera.bits}, got up to {largest}: set "
            f"camera.bits to {int(largest).bit_length()}, or scale the counts"
        )
    return found


def open_instrument(name: str, **options: Any) -> Any:
    """Open an instrument by the name under which an installed package registered its driver.

    A driver package registers a class or function in the group of entry points ``odak.instruments``; it needs no
    base class, only the attributes and methods of the protocol.

    Parameters
    ----------
    name : str
        Name of the entry point.
    **options
        Arguments of the driver.

    Returns
    -------
    SLMDriver, Camera, Laser, Stage or Rotator
        The instrument.

    Raises
    ------
    ValueError
        If no installed package registers the name; the message lists the names that are.
    TypeError
        If what the driver returns is none of these.

    Examples
    --------
    >>> from odak.instruments import open_instrument
    >>> camera = open_instrument("my_camera", serial_number="0042")  # doctest: +SKIP

    A name that no installed package registers is refused:

    >>> try:
    ...     open_instrument("no_such_camera")
    ... except ValueError as error:
    ...     print(str(error).partition(" (")[0])
    name must be one of the installed drivers
    """
    found = {entry.name: entry for entry in entry_points(group=ENTRY_POINTS)}
    if _validate.text("name", name) not in found:
        known = ", ".join(map(repr, sorted(found))) or "none"
        raise ValueError(f"name must be one of the installed drivers ({known}), got {name!r}")
    instrument = found[name].load()(**options)
    if not isinstance(instrument, (SLMDriver, Camera, Laser, Stage, Rotator)):
        raise TypeError(
            f"driver {name!r} returned {type(instrument).__name__}, which implements none of the instrument protocols"
        )
    return instrument
