"""Patterns of lenses and spots on a modulator, the light they give, and where spots lie on a frame."""

import math
from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.ndimage import map_coordinates, uniform_filter

from odak import _validate
from odak.instruments.exposures import SATURATED
from odak.instruments.mapping import Lens, Registration
from odak.instruments.protocols import Camera, SLMDriver
from odak.tools.zernike import zernike_polynomial
from odak.wave import propagate_beam
from odak.wave.linear_kernels import pixels_spectrum

# Pixels of a modulator from which the hologram of spots is computed by iterations, at most.
SAMPLED = 1 << 17
# Width of a lenslet in units of the square root of wavelength and distance.
SMALLEST_LENSLET = 1.6


def lenslets(shape: Sequence[int] | np.ndarray, wavelength: float, distance: float, pitch: float) -> np.ndarray:
    """Return the number of lenslets along rows and columns: diffraction spreads the light of smaller ones."""
    smallest = SMALLEST_LENSLET * math.sqrt(wavelength * distance) / pitch
    return np.clip((np.array(shape) / smallest).astype(int), 4, 6)


def unsaturated(camera: Camera) -> np.ndarray:
    """Return a capture whose exposure was reduced until no pixel is saturated."""
    for _ in range(20):
        frame = averaged(camera, 1)
        if frame.max() < SATURATED * ((1 << camera.bits) - 1):
            break
        camera.exposure /= 3
    return frame


class Part(NamedTuple):
    """Middle part of a modulator."""

    shape: tuple[int, int]
    pitch: float


def lens_phase(
    modulator: SLMDriver | Part, wavelength: float, distance: float | Lens, point: Sequence[float] | np.ndarray = (0, 0)
) -> np.ndarray:
    """Return the phase in radians ``[rows, columns]`` of a lens that focuses at a point x, y of a plane.

    Parameters
    ----------
    modulator : SLMDriver
        The modulator.
    wavelength : float
        Vacuum wavelength in metres.
    distance : float or Lens
        Focal length in metres, or the lens between the modulator and the plane.
    point : sequence of float or numpy.ndarray
        x and y in metres.
    """
    wavelength = float(_validate.number("wavelength", wavelength, positive=True))
    y, x = pixel_axes(modulator)
    if isinstance(distance, Lens):
        a, b = distance.ray_matrix
        return 2 * np.pi / (wavelength * b) * (x * point[0] + y * point[1] - a / 2 * (x**2 + y**2))
    distance = float(_validate.number("distance", distance, positive=True))
    squared = (x - point[0]) ** 2 + (y - point[1]) ** 2
    return -2 * np.pi / wavelength * squared / (np.sqrt(squared + distance**2) + distance)


def spots_phase(
    modulator: SLMDriver | Part,
    wavelength: float,
    distance: float | Lens,
    points: np.ndarray,
    iterations: int = 12,
    seed: int = 0,
) -> np.ndarray:
    """Return the phase ``[rows, columns]`` that forms spots of equal intensity at points x, y ``[n, 2]`` of a plane.

    The phases of the spots begin at random, by the seed.
    """
    draw = np.random.default_rng(seed)
    angles = 2 * np.pi * draw.random(len(points))
    weights = np.ones(len(points))
    size = math.prod(modulator.shape)
    # Weights and phases of the spots follow from a part of the pixels (Pozzi et al., Appl. Opt. 57, 6664 (2018)).
    chosen = np.sort(draw.choice(size, SAMPLED, replace=False)) if size > SAMPLED else np.arange(size)
    lenses = (lens_phase(modulator, wavelength, distance, point).ravel()[chosen] for point in points)
    waves = np.stack([np.exp(1j * lens) for lens in lenses])
    for _ in range(iterations if len(points) > 1 else 1):
        factors = weights * np.exp(1j * angles)
        hologram = factors @ waves
        hologram /= np.abs(hologram)
        spots = (waves @ hologram.conj()).conj()
        angles, weights = np.angle(spots), weights * np.abs(spots).mean() / np.abs(spots)
    if size > SAMPLED:
        hologram = np.zeros(modulator.shape, dtype=np.complex64)
        for factor, point in zip(factors, points, strict=True):
            phase = np.remainder(lens_phase(modulator, wavelength, distance, point) + np.angle(factor), 2 * np.pi)
            hologram += np.abs(factor) * np.exp(1j * phase.astype(np.float32))
    return np.angle(hologram).reshape(modulator.shape)


def without(surface: np.ndarray, modes: np.ndarray) -> np.ndarray:
    """Return a surface ``[rows, columns]`` without its mean and its components along modes ``[n, rows, columns]``."""
    system = np.column_stack([np.ones(surface.size), modes.reshape(len(modes), -1).T])
    coefficients, *_ = np.linalg.lstsq(system, surface.ravel(), rcond=None)
    return surface - (system @ coefficients).reshape(surface.shape)


# Place of defocus among the modes below: two tilts, then radial order 2 with m = −2, 0, 2.
DEFOCUS = 3


def aberration_modes(modulator: SLMDriver, order: int) -> np.ndarray:
    """Return the Zernike polynomials of orders 1 to `order` over the circle around the modulator."""
    y, x = pixel_axes(modulator)
    half = math.hypot(*modulator.shape) * modulator.pitch / 2
    rho, theta = np.hypot(x, y) / half, np.arctan2(y, x)
    pairs = [(n, m) for n in range(1, order + 1) for m in range(-n, n + 1, 2)]
    return np.stack([zernike_polynomial(n, m, np.minimum(rho, 1), theta) for n, m in pairs])


def pixel_axes(modulator: SLMDriver | Part) -> tuple[np.ndarray, np.ndarray]:
    """Return the coordinates y ``[rows, 1]`` and x ``[1, columns]`` of the pixels in metres."""
    rows, columns = modulator.shape
    y, x = ((np.arange(n) - n // 2) * modulator.pitch for n in (rows, columns))
    return y[:, None], x[None]


def divided(shape: Iterable[int], parts: np.ndarray) -> tuple[np.ndarray, Callable[[np.ndarray], np.ndarray]]:
    """Return the number of the lenslet of each pixel, for so many along rows and columns, and what averages over each.

    Lenslets are rectangles of pixels, as equal as they can be.
    """
    row, column = (np.minimum(np.arange(n) * k // n, k - 1) for n, k in zip(shape, parts, strict=True))
    cell = row[:, None] * parts[1] + column
    pixels = np.bincount(cell.ravel())

    def mean(values: np.ndarray) -> np.ndarray:
        return np.bincount(cell.ravel(), np.broadcast_to(values, cell.shape).ravel()) / pixels

    return cell, mean


def averaged(camera: Camera, count: int) -> np.ndarray:
    """Return the mean of as many captures."""
    return camera.capture(count).astype(np.float64).mean(0)


def brightest(frame: np.ndarray) -> np.ndarray:
    """Return the column and row of the brightest spot."""
    row, column = np.unravel_index(uniform_filter(frame, 3).argmax(), frame.shape)
    return np.array([column, row])


def brightest_near(frame: np.ndarray, place: np.ndarray, reach: int) -> np.ndarray:
    """Return the column and row of the brightest spot in a window about a place."""
    first = np.maximum(np.rint(place).astype(int) - reach, 0)
    last = np.rint(place).astype(int) + reach + 1
    return brightest(frame[first[1] : last[1], first[0] : last[0]]) + first


def deflected(modulator: SLMDriver) -> np.ndarray:
    """Return the phase 0 and π of a chequerboard, which deflects light by the largest angle."""
    rows, columns = np.indices(modulator.shape)
    return np.pi * ((rows + columns) % 2)


def centroid(frame: np.ndarray, place: np.ndarray, reach: int) -> np.ndarray:
    """Return the column and row of the centroid of a spot, within a window about a place that follows the spot."""
    for _ in range(5):
        column, row = np.rint(place).astype(int)
        first = max(row - reach, 0), max(column - reach, 0)
        window = frame[first[0] : row + reach + 1, first[1] : column + reach + 1]
        if not window.size:
            raise RuntimeError(f"a spot was expected at column {column}, row {row}, outside the image of the camera")
        floor = np.quantile(window, 0.3)
        light = np.clip(window - floor - 0.1 * (window.max() - floor), 0, None)
        total = light.sum() or 1.0
        down, across = (np.arange(n) for n in window.shape)
        found = np.array([first[1] + (light.sum(0) @ across) / total, first[0] + (light.sum(1) @ down) / total])
        if np.abs(np.rint(found) - np.rint(place)).max() == 0:
            break
        place = found
    return found


def read_around(camera: Camera, place: np.ndarray, reach: int) -> None:
    """Set the region of a camera to a window about a place (column, row)."""
    column, row = (
        int(np.clip(p - reach, 0, n - 2 * reach - 1)) for p, n in zip(place, camera.shape[::-1], strict=True)
    )
    camera.region = (row, column, 2 * reach + 1, 2 * reach + 1)


def ideal_capture(
    modulator: SLMDriver | Part,
    phase: np.ndarray,
    amplitude: np.ndarray | float,
    wavelength: float,
    distance: float | Lens,
    registration: Registration,
) -> np.ndarray:
    """Return the simulated capture of a pattern on an ideal table."""
    rows, columns = modulator.shape
    v, u = np.indices(registration.shape)
    points = registration.plane_points(np.stack([u, v], axis=-1))
    if isinstance(distance, Lens):
        return _ideal_focus(modulator, amplitude * np.exp(1j * phase), wavelength, distance, points)
    points = points / modulator.pitch
    wide = [2 * n for n in (rows, columns)]
    field = np.zeros(wide, dtype=complex)
    first = [n // 2 - m // 2 for n, m in zip(wide, (rows, columns), strict=True)]
    field[first[0] : first[0] + rows, first[1] : first[1] + columns] = amplitude * np.exp(1j * phase)
    # Pixels are squares: the share that emits is not measured, and scales the light more than it widens the envelope.
    field = np.fft.ifft2(pixels_spectrum(field, wide))
    kind = "Bandlimited Angular Spectrum"
    there: Any = propagate_beam(
        field, None, distance, modulator.pitch, wavelength, kind, zero_padding=[False, False, False]
    )
    return map_coordinates(
        np.abs(np.asarray(there)) ** 2, [points[..., 1] + wide[0] // 2, points[..., 0] + wide[1] // 2], order=3
    )


def _ideal_focus(modulator, field, wavelength: float, lens: Lens, points: np.ndarray) -> np.ndarray:
    """Return the intensity behind a lens at points x, y in metres: the spectrum of square pixels."""
    a, b = lens.ray_matrix
    y, x = pixel_axes(modulator)
    field = field * np.exp(1j * np.pi * a / (wavelength * b) * (x**2 + y**2))
    wide = [3 * n for n in modulator.shape]
    reach = wavelength * abs(b) / modulator.pitch
    orders = min(3, math.ceil(2 * float(np.abs(points).max()) / reach + 0.1))
    light = np.fft.fftshift(np.abs(pixels_spectrum(field, wide, orders)) ** 2)
    places = [points[..., 1 - k] * n * modulator.pitch / (wavelength * b) + orders * n // 2 for k, n in enumerate(wide)]
    return map_coordinates(light, places, order=3) * (np.hypot(points[..., 0], points[..., 1]) >= lens.block)
