"""Spots of even or given brightness on an optical table, by feedback of a camera."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.ndimage import map_coordinates

from odak import _validate
from odak._warnings import ConvergenceWarning, warn
from odak.instruments.exposures import set_exposure
from odak.instruments.mapping import Registration
from odak.instruments.phase_response import nearest_levels, without_lens
from odak.instruments.protocols import Camera
from odak.instruments.tables import OpticalTable, parts_of
from odak.wave import spot_hologram, uniformity

# Samples of the camera's image for one of its pixels, by which the disc around a spot is filled.
_FINER = 4
_TURNS = 30


@dataclass(frozen=True)
class SpotFeedback:
    """Result of :func:`equalise_spots`.

    Attributes
    ----------
    levels : numpy.ndarray
        Pattern ``[rows, columns]`` of the best iteration; it is displayed on the modulator.
    intensities : numpy.ndarray
        Ratio of the measured to the requested power of each spot, ``[N]``, of mean 1.
    uniformity : float
        1 − (max − min)/(max + min) of these.
    history : tuple of float
        Uniformity in each iteration, the first without feedback.

    Examples
    --------
    >>> import numpy as np
    >>> from odak.instruments import SpotFeedback
    >>> levels = np.zeros((32, 32), dtype=np.int64)
    >>> found = SpotFeedback(levels, np.array([0.99, 1.01]), 0.99, (0.8, 0.95, 0.99))
    >>> f"uniformity {found.uniformity} after {len(found.history)} iterations"
    'uniformity 0.99 after 3 iterations'
    """

    levels: np.ndarray
    intensities: np.ndarray
    uniformity: float
    history: tuple[float, ...]


@_validate.takes_fields("modulator camera wavelength distance points phases registration", table=OpticalTable)
@_validate.takes_units("radius")
def equalise_spots(
    table: OpticalTable,
    points: np.ndarray,
    *,
    intensities: np.ndarray | None = None,
    turns: int = 10,
    captures: int = 16,
    radius: float | None = None,
) -> SpotFeedback:
    """Display spots of equal power, with the targets of the hologram corrected by measurements of the camera.

    A hologram that is even in simulation is not so on a table with an aberration, an uneven beam or a wrong phase
    response. Each turn computes the hologram of the spots, shows it, measures the light within a disc around each of
    them, and asks for more light where there was too little.

    Parameters
    ----------
    table : OpticalTable
        The table without a lens, with phases, a registration and the aberration that is corrected, if it is known.
    points : numpy.ndarray
        Spots x, y in metres ``[N, 2]`` in the plane of the camera, two or more.
    intensities : numpy.ndarray, optional
        Light wanted in each spot ``[N]``, up to a common factor; equal by default.
    turns : int
        Number of iterations.
    captures : int
        Number of captures that are averaged in each.
    radius : float, optional
        Radius in metres of the disc around a spot; by default the radius of four Airy discs, or 0.4 of the smallest
        distance between spots if that is less. The discs follow the centroids of the spots, which an aberration moves.

    Returns
    -------
    SpotFeedback
        The pattern of the best iteration, which is displayed at the end, and the uniformity of its spots.

    Raises
    ------
    ValueError
        If an argument is outside its range, or the camera does not detect all spots.

    Warns
    -----
    ConvergenceWarning
        If no iteration was better than the first.

    Notes
    -----
    Brightness is light per area of the plane: 1 % of the scale of the registration is 2 % of it. An aberration shifts
    the spots of :func:`register_camera`; give it a table with the aberration, or register before that comes in.

    Weighted Gerchberg–Saxton with the weights of Di Leonardo, Ianni and Ruocco, Opt. Express 15, 1913 (2007); feedback
    of a camera: Nogrette et al., Phys. Rev. X 4, 021034 (2014), appendix A.

    Examples
    --------
    >>> import numpy as np
    >>> from odak.instruments import OpticalTable, Registration, SimulatedTable, equalise_spots
    >>> hidden = SimulatedTable(1, shape=(32, 32), camera_shape=(96, 96), misalignment=False, nonlinearity=False)
    >>> points = np.array([[-6e-5, -6e-5], [0.0, 5e-5], [8e-5, -2e-5]])
    >>> registration = Registration(np.diag([4e-6, 4e-6, 1.0]), 0.0, (96, 96))
    >>> phases = 2 * np.pi * np.arange(256) / 255
    >>> table = OpticalTable(hidden.modulator, hidden.camera, 532e-9, 20e-3, phases, registration)
    >>> found = equalise_spots(table, points, turns=3, captures=2)
    >>> found.history[0] < 0.95 < 0.99 < found.history[-1]
    True
    """
    points = np.asarray(_validate.real("points", _validate.array("points", points)), dtype=float)
    _validate.shaped("points", points, "[2 or more, 2]")
    distance = without_lens(table.distance, "every pixel sends light to all places")
    modulator, camera, wavelength, _, phases, registration = parts_of(table, "phases", "registration")
    turns, captures = (
        _validate.integer(name, count, minimum=1) for name, count in (("turns", turns), ("captures", captures))
    )
    asked = np.ones(len(points))
    if intensities is not None:
        asked = np.asarray(_validate.real("intensities", _validate.array("intensities", intensities), positive=True))
        _validate.shaped("intensities", asked, f"[{len(points)}], one for each of the points")
    apart = np.linalg.norm(points[:, None] - points, axis=-1) + np.diag(np.full(len(points), np.inf))
    if radius is None:
        airy = 1.22 * wavelength * distance / (min(modulator.shape) * modulator.pitch)
        radius = min(4 * airy, 0.4 * float(apart.min()))
    meter = _Meter(camera, registration, points, float(_validate.number("radius", radius, positive=True)))
    places = np.column_stack([points, np.full(len(points), distance)])
    wanted, history, best = asked.copy(), [], (-1.0, np.empty(0), np.empty(0))
    light: Any
    for turn in range(turns):
        hologram, _ = spot_hologram(
            places, modulator.shape, wavelength, modulator.pitch, _TURNS, intensities=wanted, seed=0
        )
        levels = nearest_levels(np.angle(hologram) - table.wavefront, phases)
        modulator.show(levels)
        if turn == 0:
            set_exposure(camera)
        light = meter.light(captures) / asked
        if light.min() <= 0:
            raise ValueError("points must be bright enough for the camera, but the intensity of a spot is zero")
        light = light / light.mean()
        even: Any = uniformity(light)
        history.append(float(even))
        if history[-1] > best[0]:
            best = (history[-1], levels, light)
        wanted = wanted / light
        wanted = wanted / wanted.mean()
    if turns > 1 and best[0] == history[0]:
        warn(
            f"no iteration improved on the first, whose uniformity is {best[0]:.3f}: check registration and radius",
            ConvergenceWarning,
        )
    modulator.show(best[1])
    return SpotFeedback(best[1], best[2], best[0], tuple(history))


class _Meter:
    """Measures the power within discs of the plane imaged by a camera, about the centroids of spots."""

    def __init__(self, camera: Camera, registration: Registration, points: np.ndarray, radius: float):
        self.camera, self.registration, self.middles = camera, registration, points
        angle = np.arange(16) / 16 * 2 * np.pi
        rim = registration.camera_pixels(points[:, None] + radius * np.stack([np.cos(angle), np.sin(angle)], -1))
        if not ((rim >= 0) & (rim <= np.array(camera.shape[::-1]) - 1)).all():
            raise ValueError(
                f"points must be such that their discs lie inside the image of the camera, {list(camera.shape)} pixels"
            )
        place = registration.camera_pixels(points[:1])
        pixel = float(np.linalg.norm(registration.plane_points(place + np.array([1.0, 0.0])) - points[:1]))
        steps = max(4, int(np.ceil(_FINER * radius / pixel)))
        line = np.arange(-steps, steps + 1) / steps * radius
        disc = np.stack(np.meshgrid(line, line), -1).reshape(-1, 2)
        self.disc = disc[(disc**2).sum(-1) <= radius**2]

    def light(self, captures: int) -> np.ndarray:
        """Return the mean over each disc, in the plane rather than on the camera, whose magnification varies."""
        frame = self.camera.capture(captures).astype(np.float64).mean(0)
        # Speckle is dark in places: what is left there is the offset of the camera.
        frame = frame - np.quantile(frame, 0.02)
        for _ in range(3):
            pixels = self.registration.camera_pixels(self.middles[:, None] + self.disc)
            light = map_coordinates(frame, [pixels[..., 1], pixels[..., 0]], order=3, mode="nearest")
            bright = np.clip(light - 0.05 * light.max(-1, keepdims=True), 0, None)
            moved = (bright @ self.disc) / np.maximum(bright.sum(-1, keepdims=True), 1e-12)
            self.middles = self.middles + moved
        return light.mean(-1)
