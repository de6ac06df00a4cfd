"""Simulated optical table whose faults are drawn by a seed: modulator, camera, laser and stage with the protocols."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import fft
from scipy.ndimage import map_coordinates

from odak import _validate
from odak.tools.zernike import zernike_polynomial
from odak.wave import propagate_beam

__all__ = ["SimulatedTable", "Truth"]

# Zernike polynomials (n, m) of the hidden aberration, without piston, tilt and defocus.
ABERRATIONS = ((2, -2), (2, 2), (3, -3), (3, -1), (3, 1), (3, 3), (4, 0))
FULL_WELL = 20_000.0
# Samples of the simulated intensity for one of the field.
FINER = 3


@dataclass(frozen=True)
class Truth:
    """Hidden properties of a simulated table, which calibrations must find.

    Attributes
    ----------
    phases : numpy.ndarray
        Phase of each level in radians, less that of level 0.
    amplitude : numpy.ndarray
        Amplitude of the illumination at each pixel of the modulator, at most 1.
    wavefront : numpy.ndarray
        Aberration in radians at each pixel of the modulator.
    distance : float
        From the modulator to the plane of the camera at stage position 0, in metres.
    homography : numpy.ndarray
        ``[3, 3]``, from undistorted camera pixels (column, row), from the middle, to metres (x, y) in the plane.
    distortion : float
        Radial distortion: undistorted = distorted·(1 + distortion·r²), r in half diagonals of the sensor.
    """

    phases: np.ndarray
    amplitude: np.ndarray
    wavefront: np.ndarray
    distance: float
    homography: np.ndarray
    distortion: float

    def plane_points(self, pixels: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
        """Return the points x, y of the plane in metres that camera pixels (column, row) ``[..., 2]`` see."""
        return plane_points(pixels, shape, self.homography, self.distortion)


class SimulatedTable:
    """Modulator, camera, laser and stage on a simulated table with hidden faults.

    Light of a Gaussian beam, off centre and aberrated, meets a phase-only modulator with a nonlinear response and a
    reflection at its cover glass, travels to the camera (band-limited angular spectrum), and is captured with
    misalignment, distortion, shot noise, read noise, saturation and quantisation.

    Parameters
    ----------
    seed : int
        Seed of the hidden properties and of the noise.
    shape : sequence of int
        Rows and columns of the modulator.
    pitch : float
        Distance between pixels of the modulator in metres.
    wavelength : float
        Vacuum wavelength in metres.
    distance : float
        Nominal distance from the modulator to the camera in metres.
    camera_shape : sequence of int
        Rows and columns of the camera.
    camera_pitch : float
        Distance between pixels of the camera in metres.
    misalignment : bool
        Rotate, shift, scale and tilt the camera and distort its image.
    aberration : float
        Root mean square of the aberration in wavelengths.
    nonlinearity : bool
        Make the phase response of the modulator nonlinear.
    distance_error : float
        Largest error of the distance as a fraction.
    reflection : float
        Amplitude reflected by the cover glass, as a fraction of the illumination.

    Attributes
    ----------
    modulator : SimulatedModulator
        Follows :class:`odak.instruments.Modulator`.
    camera : SimulatedCamera
        Follows :class:`odak.instruments.Camera`.
    laser : SimulatedLaser
        Follows :class:`odak.instruments.Laser`.
    stage : SimulatedStage
        Follows :class:`odak.instruments.Stage`.
    truth : Truth
        The hidden properties, for tests alone.

    Examples
    --------
    >>> import numpy as np
    >>> from odak.instruments import SimulatedTable
    >>> table = SimulatedTable(seed=1, shape=(32, 32), camera_shape=(40, 48))
    >>> table.modulator.show(np.zeros((32, 32), dtype=np.uint8))
    >>> table.camera.capture(2).shape
    (2, 40, 48)
    """

    def __init__(
        self,
        seed: int,
        *,
        shape: Sequence[int] = (144, 144),
        pitch: float = 8e-6,
        wavelength: float = 532e-9,
        distance: float = 20e-3,
        camera_shape: Sequence[int] = (320, 320),
        camera_pitch: float = 4e-6,
        misalignment: bool = True,
        aberration: float = 0.2,
        nonlinearity: bool = True,
        distance_error: float = 0.02,
        reflection: float = 0.02,
    ):
        draw = np.random.default_rng(_validate.integer("seed", seed))
        rows, columns = _validate.size("shape", shape)
        self.wavelength = float(_validate.number("wavelength", wavelength, positive=True))
        nominal = float(_validate.number("distance", distance, positive=True))
        pitch = float(_validate.number("pitch", pitch, positive=True))
        camera_pitch = float(_validate.number("camera_pitch", camera_pitch, positive=True))
        y, x = ((np.arange(n) - n // 2) * pitch for n in (rows, columns))
        x, y = np.meshgrid(x, y)
        half = np.hypot(rows, columns) * pitch / 2
        centre = draw.uniform(-0.15, 0.15, 2) * half
        radius = draw.uniform(1.0, 1.4) * half
        amplitude = np.exp(-((x - centre[0]) ** 2 + (y - centre[1]) ** 2) / radius**2)
        weights = draw.normal(size=len(ABERRATIONS))
        modes = [zernike_polynomial(n, m, np.hypot(x, y) / half, np.arctan2(y, x)) for n, m in ABERRATIONS]
        wavefront = sum(w * mode for w, mode in zip(weights, modes, strict=True))
        aberration = float(_validate.number("aberration", aberration, least=0))
        # Tilt and defocus cannot be told from a shift and a distance.
        low = np.stack([x + 0 * y, y + 0 * x, x**2 + y**2, np.ones_like(wavefront)], axis=-1).reshape(-1, 4)
        wavefront = wavefront - (low @ np.linalg.lstsq(low, wavefront.ravel(), rcond=None)[0]).reshape(rows, columns)
        wavefront = wavefront * (2 * np.pi * aberration / np.sqrt((wavefront**2).mean()))
        level = np.arange(256) / 255
        if _validate.flag("nonlinearity", nonlinearity):
            gamma, ripple, turn = draw.uniform(0.8, 1.3), draw.uniform(-0.15, 0.15), draw.uniform(0.95, 1.1)
            phases = 2 * np.pi * turn * (level**gamma + ripple * np.sin(2 * np.pi * level) / np.pi)
        else:
            phases = 2 * np.pi * level
        camera_rows, camera_columns = _validate.size("camera_shape", camera_shape)
        homography, distortion = np.diag([camera_pitch, camera_pitch, 1.0]), 0.0
        if _validate.flag("misalignment", misalignment):
            angle, scale = np.radians(draw.uniform(-4, 4)), draw.uniform(0.93, 1.07)
            turned = scale * camera_pitch * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
            shear = np.eye(2) + draw.uniform(-0.02, 0.02, (2, 2))
            homography[:2, :2] = turned @ shear
            homography[:2, 2] = draw.uniform(-12, 12, 2) * camera_pitch
            homography[2, :2] = draw.uniform(-1, 1, 2) * 1e-2 / max(camera_rows, camera_columns)
            distortion = draw.uniform(-0.02, 0.02)
        true_distance = nominal * (1 + draw.uniform(-1, 1) * float(_validate.number("distance_error", distance_error)))
        self.truth = Truth(phases, amplitude, wavefront, true_distance, homography, distortion)
        self._pitch, self._noise = pitch, draw
        self._reflection = float(_validate.number("reflection", reflection, least=0)) * np.exp(
            2j * np.pi * draw.random()
        )
        self._levels = np.zeros((rows, columns), dtype=np.uint8)
        self.modulator = SimulatedModulator(self, (rows, columns), pitch)
        self.camera = SimulatedCamera(self, (camera_rows, camera_columns), camera_pitch, draw)
        self.laser, self.stage = SimulatedLaser(self.wavelength), SimulatedStage()
        # The brightest spot that the modulator can form stays below saturation at an exposure of 1 ms.
        area = amplitude.sum() * pitch**2 / (self.wavelength * nominal)
        self._unit = 0.7 * FULL_WELL / area**2

    def intensity(self) -> tuple[np.ndarray, float]:
        """Return the intensity that pixels of the camera see ``[rows, columns]``, and the pitch of its samples."""
        truth, (rows, columns) = self.truth, self._levels.shape
        phase = truth.phases[self._levels] + truth.wavefront
        field = truth.amplitude * (np.exp(1j * phase) + self._reflection)
        wide = [int(1.4 * n) // 2 * 2 for n in (rows, columns)]
        padded = np.zeros(wide, dtype=complex)
        first = [n // 2 - m // 2 for n, m in zip(wide, (rows, columns), strict=True)]
        padded[first[0] : first[0] + rows, first[1] : first[1] + columns] = field
        there = propagate_beam(
            *(padded, None, truth.distance + self.stage.position, self._pitch, self.wavelength),
            "Bandlimited Angular Spectrum",
            zero_padding=[True, False, True],
        )
        # An intensity has twice the bandwidth of its field, and splines need some more samples.
        spectrum = fft.fftshift(fft.fft2(fft.ifftshift(there).astype(np.complex64)))
        finer = np.zeros([FINER * n for n in wide], dtype=np.complex64)
        first = [(FINER * n - n) // 2 for n in wide]
        finer[first[0] : first[0] + wide[0], first[1] : first[1] + wide[1]] = spectrum
        field = FINER**2 * fft.fftshift(fft.ifft2(fft.ifftshift(finer)))
        light, pitch = field.real**2 + field.imag**2, self._pitch / FINER
        # A pixel of the camera averages over its area.
        frequencies = fft.fftfreq(light.shape[0], pitch)[:, None], fft.rfftfreq(light.shape[1], pitch)[None]
        response = np.prod(np.broadcast_arrays(*(np.sinc(f * self.camera.pitch) for f in frequencies)), axis=0)
        light = fft.irfft2(fft.rfft2(light) * response.astype(np.float32), s=light.shape)
        return self.laser.power * light, pitch


class SimulatedModulator:
    """Twin of a phase-only modulator of 8 bits; see :class:`SimulatedTable`."""

    bits = 8
    settling_time = 0.0

    def __init__(self, table: SimulatedTable, shape: tuple[int, int], pitch: float):
        self._table, self.shape, self.pitch = table, shape, pitch

    def show(self, levels: np.ndarray) -> None:
        """Show a pattern of levels 0 … 255, integers ``[rows, columns]``."""
        found = np.asarray(_validate.array("levels", levels))
        if found.shape != self.shape or found.dtype.kind not in "iu":
            raise ValueError(f"levels must be integers {list(self.shape)}, got {found.dtype} {list(found.shape)}")
        if found.min() < 0 or found.max() > 255:
            raise ValueError(f"levels must be 0 to 255, got {found.min()} to {found.max()}")
        self._table._levels = found.astype(np.uint8)


class SimulatedCamera:
    """Twin of a camera of 12 bits with noise, fixed pattern and saturation; see :class:`SimulatedTable`."""

    bits = 12

    def __init__(self, table: SimulatedTable, shape: tuple[int, int], pitch: float, draw: np.random.Generator):
        self._table, self.shape, self.pitch = table, shape, pitch
        self.exposure = 1e-3
        self.region: tuple[int, int, int, int] | None = None
        self._gain = 1 + 0.003 * draw.normal(size=shape)
        self._offset = 20 + 2 * draw.normal(size=shape)

    def capture(self, count: int = 1) -> np.ndarray:
        """Return captures, uint16 ``[count, rows, columns]`` of the region."""
        table, count = self._table, _validate.integer("count", count, minimum=1)
        row, column, rows, columns = self.region or (0, 0, *self.shape)
        window = np.s_[row : row + rows, column : column + columns]
        v, u = np.meshgrid(np.arange(row, row + rows), np.arange(column, column + columns), indexing="ij")
        points = table.truth.plane_points(np.stack([u, v], axis=-1).astype(float), self.shape)
        light, pitch = table.intensity()
        at = [points[..., i] / pitch + light.shape[axis] // 2 for i, axis in ((1, 0), (0, 1))]
        # Only the part that the region sees, for the interpolation is by splines.
        corner = [max(int(np.floor(part.min())) - 8, 0) for part in at]
        part = light[tuple(slice(c, int(np.ceil(a.max())) + 9) for c, a in zip(corner, at, strict=True))]
        seen = map_coordinates(part, [a - c for a, c in zip(at, corner, strict=True)], order=3, mode="constant")
        electrons = np.clip(seen, 0, None) * table._unit * self.exposure / 1e-3 * self._gain[window]
        noise = table._noise
        read = noise.poisson(np.minimum(electrons, 1e9), (count, *electrons.shape)) + self._offset[window]
        read = read + 3 * noise.normal(size=read.shape)
        counts = np.clip(read, 0, FULL_WELL) * ((1 << self.bits) - 1) / FULL_WELL
        return np.rint(counts).astype(np.uint16)


class SimulatedLaser:
    """Twin of a laser; see :class:`SimulatedTable`."""

    def __init__(self, wavelength: float):
        self.wavelength, self.power = wavelength, 1.0


class SimulatedStage:
    """Twin of a linear stage that carries the camera; see :class:`SimulatedTable`."""

    def __init__(self):
        self.position = 0.0

    def move(self, position: float) -> None:
        """Move to a position in metres."""
        self.position = float(_validate.number("position", position))


def plane_points(pixels: np.ndarray, shape: tuple[int, int], homography: np.ndarray, distortion: float) -> np.ndarray:
    """Return the points of a plane that camera pixels see.

    Parameters
    ----------
    pixels : numpy.ndarray
        Columns and rows ``[..., 2]``.
    shape : tuple of int
        Rows and columns of the camera.
    homography : numpy.ndarray
        ``[3, 3]``, from undistorted pixels from the middle to metres.
    distortion : float
        Radial distortion, of r² in half diagonals.

    Returns
    -------
    numpy.ndarray
        x and y in metres ``[..., 2]``.
    """
    rows, columns = shape
    from_middle = pixels - np.array([columns / 2, rows / 2])
    squared = (from_middle**2).sum(-1, keepdims=True) / ((rows**2 + columns**2) / 4)
    straight = from_middle * (1 + distortion * squared)
    found = straight @ homography[:, :2].T + homography[:, 2]
    return found[..., :2] / found[..., 2:]
