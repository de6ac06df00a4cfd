"""Protocols of the instruments of an optical table, and the entry points by which drivers are found."""

from importlib.metadata import entry_points
from typing import Any, Protocol, runtime_checkable

import numpy as np

from odak import _validate

__all__ = ["Camera", "Laser", "Modulator", "Rotator", "Stage", "open_instrument"]

# Group of entry points of packages that hold drivers: name → class or function that opens an instrument.
ENTRY_POINTS = "odak.instruments"


@runtime_checkable
class Modulator(Protocol):
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
    >>> from odak.instruments import Modulator
    >>> class Panel:
    ...     shape, pitch, bits, settling_time = (1080, 1920), 8e-6, 8, 0.05
    ...     def show(self, levels):
    ...         self.shown = np.asarray(levels)
    >>> isinstance(Panel(), Modulator)
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
    modulator : Modulator
        The modulator.
    camera : Camera
        The camera.
    """
    for name, instrument in (("modulator", modulator), ("camera", camera)):
        if np.size(instrument.pitch) != 1:
            raise ValueError(
                f"{name}.pitch must be one number in metres, that of square pixels, got {instrument.pitch!r}"
            )
        _validate.number(f"{name}.pitch", instrument.pitch, positive=True)


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
    Modulator, Camera, Laser, Stage or Rotator
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
    name must be that of an installed driver
    """
    found = {entry.name: entry for entry in entry_points(group=ENTRY_POINTS)}
    if _validate.text("name", name) not in found:
        known = ", ".join(map(repr, sorted(found))) or "none"
        raise ValueError(f"name must be that of an installed driver ({known}), got {name!r}")
    instrument = found[name].load()(**options)
    if not isinstance(instrument, (Modulator, Camera, Laser, Stage, Rotator)):
        raise TypeError(
            f"driver {name!r} returned {type(instrument).__name__}, which implements none of the instrument protocols"
        )
    return instrument
