"""An optical table as far as it is known: what the measurements of its properties share."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from odak import _show, _validate
from odak.instruments.mapping import Lens, Registration, ray_matrix
from odak.instruments.protocols import Camera, SLMDriver, check_square_pixels, checked_camera


@_validate.takes_units("wavelength", "distance")
@dataclass(frozen=True, repr=False)
class OpticalTable(_show.Shown):
    """A modulator, a camera, the light path between them, and what has been measured of them.

    Each measurement takes a table and returns what it found; ``dataclasses.replace`` returns the table with it, for the
    measurements that follow. They take the attributes as arguments of their own too, which is the older form:
    ``register_camera(modulator, camera, wavelength, distance, phases)``. Beside a table, an attribute replaces its own:
    ``register_camera(table, wavefront=0.0)``.

    Attributes
    ----------
    modulator : SLMDriver
        The modulator.
    camera : Camera
        The camera, roughly at `distance`.
    wavelength : float
        Vacuum wavelength in metres.
    distance : float or Lens
        Distance from the modulator to the camera in metres, nominal until it is measured, or the lens between them.
    phases : numpy.ndarray, optional
        Phase of each level in radians, from :func:`measure_phase_response` or :func:`measure_regional_response`.
    registration : Registration, optional
        Mapping of the camera, from :func:`register_camera`.
    wavefront : numpy.ndarray or float
        Aberration in radians at each pixel of the modulator, which patterns correct, from :func:`measure_wavefront`.
    amplitude : numpy.ndarray or float, optional
        Amplitude of the illumination, from :func:`measure_illumination`.

    Raises
    ------
    ValueError, TypeError
        If a length is not positive, or pixels are not square.

    Examples
    --------
    >>> from dataclasses import replace
    >>> from odak.instruments import OpticalTable, SimulatedTable, measure_phase_response
    >>> hidden = SimulatedTable(seed=1, shape=(32, 32), distance=4e-3, camera_shape=(48, 48), aberration=0.05)
    >>> table = OpticalTable(hidden.modulator, hidden.camera, "532nm", "4mm")
    >>> table = replace(table, phases=measure_phase_response(table, samples=9))
    >>> table.phases.shape
    (256,)
    """

    modulator: SLMDriver
    camera: Camera
    wavelength: float
    distance: float | Lens
    phases: np.ndarray | None = None
    registration: Registration | None = None
    wavefront: np.ndarray | float = 0.0
    amplitude: np.ndarray | float | None = None

    def __post_init__(self) -> None:
        check_square_pixels(self.modulator, self.camera)
        wavelength = float(_validate.number("wavelength", self.wavelength, positive=True))
        object.__setattr__(self, "wavelength", wavelength)
        if not isinstance(self.distance, Lens):
            object.__setattr__(self, "distance", ray_matrix(self.distance)[1])


def parts_of(table: OpticalTable, *measured: str) -> tuple[Any, ...]:
    """Return modulator, camera with checked captures, wavelength, distance, and results of measurements by name."""
    missing = [name for name in measured if getattr(table, name) is None]
    if missing:
        raise ValueError(
            f"table must have {' and '.join(missing)}: measure first, and add what was found by "
            f"dataclasses.replace(table, {missing[0]}=...)"
        )
    found = (getattr(table, name) for name in measured)
    return (table.modulator, checked_camera(table.camera), table.wavelength, table.distance, *found)
