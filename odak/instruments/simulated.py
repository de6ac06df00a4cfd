"""Simulated optical table whose faults are drawn by a seed: modulator, camera, laser and stage with the protocols."""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import fft
from scipy.ndimage import gaussian_filter, map_coordinates

from odak import _show, _validate
from odak.instruments.drivers import checked_levels
from odak.instruments.mapping import Lens, plane_points, ray_matrix
from odak.tools.zernike import zernike_polynomial
from odak.wave.linear_kernels import orders_reaching, pixels_spectrum, taper

# Zernike polynomials (n, m) of the hidden aberration, without piston, tilt and defocus.
ABERRATIONS = ((2, -2), (2, 2), (3, -3), (3, -1), (3, 1), (3, 3), (4, 0))
FULL_WELL = 20_000.0
# Samples of the simulated intensity along a pixel of the modulator, at least, and parts of a pixel along each side
# where fringing fields vary its phase.
FINER = 3
# Diffraction orders along each axis that are simulated, at most.
ORDERS = 3
# Periods of the flicker per second.
FLICKER_RATE = 360.0
# Typical errors of a laboratory table, for SimulatedTable.realistic.
REALISTIC: dict[str, Any] = {
    "regional": 0.05,
    "flicker": 0.01,
    "fringing": 0.3,
    "fill_factor": 0.92,
    "iris": 1.0,
    "dust": 3,
}


@dataclass(frozen=True)
class Truth:
    """Hidden properties of a simulated table, which calibrations must find.

    Attributes
    ----------
    phases : numpy.ndarray
        Phase of each level in radians, relative to level 0.
    amplitude : numpy.ndarray
        Amplitude of the illumination at each pixel of the modulator, at most 1.
    wavefront : numpy.ndarray
        Aberration in radians at each pixel of the modulator.
    distance : float or Lens
        From the modulator to the plane of the camera at stage position 0, in metres, or the lens between them.
    homography : numpy.ndarray
        ``[3, 3]``, from undistorted camera pixels (column, row), from the middle, to metres (x, y) in the plane.
    distortion : float
        Radial distortion: undistorted = distorted·(1 + distortion·r²), r in half diagonals of the sensor.
    reflection : complex
        Amplitude reflected by the cover glass, as a fraction of the illumination.
    response : numpy.ndarray
        Factor of the phase at each pixel of the modulator.
    flicker : float
        Relative amplitude of the flicker of the phase.
    fringing : float
        Standard deviation in pixels of the Gaussian by which fringing fields smooth the phase.
    fill_factor : float
        Share of the area of a pixel that modulates.
    time_constant : float
        Time constant in seconds in which the distance to a new phase falls by a factor e.
    polarisation : float
        Angle of the polariser in degrees at which all light is modulated.
    """

    phases: np.ndarray
    amplitude: np.ndarray
    wavefront: np.ndarray
    distance: float | Lens
    homography: np.ndarray
    distortion: float
    reflection: complex
    response: np.ndarray
    flicker: float
    fringing: float
    fill_factor: float
    time_constant: float
    polarisation: float

    def plane_points(self, pixels: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
        """Return the points x, y in metres that are imaged onto camera pixels (column, row) ``[..., 2]``."""
        return plane_points(pixels, shape, self.homography, self.distortion)


class SimulatedTable(_show.Shown):
    """Modulator, camera, laser, stage and polariser on a simulated table with hidden faults.

    Light of a Gaussian beam, off centre and aberrated, meets a phase-only modulator with a nonlinear response and a
    reflection at its cover glass, propagates to the camera (angular spectrum), or passes a lens, and is captured with
    misalignment, distortion, shot noise, read noise, saturation and quantisation. The modulator may flicker, smooth the
    phase by fringing fields, respond differently from pixel to pixel, have gaps between its pixels, carry dust and take
    time to settle. The laser can be tuned: phases and the aberration, which are those at `wavelength`, change as its
    inverse.

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
    distance : float or Lens
        Nominal distance from the modulator to the camera in metres, or the lens between them, behind which light is
        paraxial.
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
        Largest error of the distance as a fraction, of that from the lens to the camera where there is a lens.
    reflection : float
        Amplitude reflected by the cover glass, as a fraction of the illumination.
    regional : float
        Relative deviation of the phase response over the modulator (root mean square), smooth; a tenth as much again
        from pixel to pixel.
    flicker : float
        Relative amplitude of the flicker of the phase, 360 times a second.
    fringing : float
        Standard deviation in pixels of the Gaussian by which fringing fields smooth the phase.
    fill_factor : float
        Share of the area of a pixel that modulates; the gaps reflect with phase 0.
    samples_per_pixel : int, optional
        None, the default, for pixels that are squares: their light falls off with the angle as for a square, gaps send
        light of their own, and up to three orders of diffraction along each axis reach the camera. A number makes each
        pixel a set of points, that many along each side, as earlier versions did by default with one.
    iris : float, optional
        Radius of a round iris in the Fourier plane of a relay, in units of 1/(2·pitch); none by default. Behind a
        lens, it is in the plane of the camera, in units of the farthest point that a pixel reaches.
    dust : int
        Number of specks that absorb light in front of the modulator.
    time_constant : float
        Nominal time constant of the phase in seconds, to a factor e; the true one is within 30 %.
    polarisation : bool
        Turn the axis of the modulator by a hidden angle up to 30 degrees from the axis of the polariser.

    Attributes
    ----------
    modulator : SimulatedModulator
        Follows :class:`odak.instruments.SLMDriver`.
    camera : SimulatedCamera
        Follows :class:`odak.instruments.Camera`.
    laser : SimulatedLaser
        Follows :class:`odak.instruments.Laser`.
    stage : SimulatedStage
        Follows :class:`odak.instruments.Stage`.
    polariser : SimulatedRotator
        Follows :class:`odak.instruments.Rotator`.
    clock : float
        Seconds that have passed on the table: exposures and settling times.
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

    @_validate.takes_units("pitch", "wavelength", "distance", "camera_pitch")
    def __init__(
        self,
        seed: int,
        *,
        shape: Sequence[int] = (144, 144),
        pitch: float = 8e-6,
        wavelength: float = 532e-9,
        distance: float | Lens = 20e-3,
        camera_shape: Sequence[int] = (320, 320),
        camera_pitch: float = 4e-6,
        misalignment: bool = True,
        aberration: float = 0.2,
        nonlinearity: bool = True,
        distance_error: float = 0.02,
        reflection: float = 0.02,
        regional: float = 0.0,
        flicker: float = 0.0,
        fringing: float = 0.0,
        fill_factor: float = 1.0,
        samples_per_pixel: int | None = None,
        iris: float | None = None,
        dust: int = 0,
        time_constant: float = 0.0,
        polarisation: bool = False,
    ):
        draw = np.random.default_rng(_validate.integer("seed", seed))
        rows, columns = _validate.size("shape", shape)
        self.wavelength: float = float(_validate.number("wavelength", wavelength, positive=True))
        _, nominal = ray_matrix(distance)
        pitch = float(_validate.number("pitch", pitch, positive=True))
        camera_pitch = float(_validate.number("camera_pitch", camera_pitch, positive=True))
        y, x = ((np.arange(n) - n // 2) * pitch for n in (rows, columns))
        x, y = np.meshgrid(x, y)
        half = np.hypot(rows, columns) * pitch / 2
        centre = draw.uniform(-0.15, 0.15, 2) * half
        radius = draw.uniform(1.0, 1.4) * half
        amplitude = np.exp(-((x - centre[0]) ** 2 + (y - centre[1]) ** 2) / radius**2)
        weights = draw.normal(size=len(ABERRATIONS))
        rho, theta = np.minimum(np.hypot(x, y) / half, 1), np.arctan2(y, x)
        modes = [zernike_polynomial(n, m, rho, theta) for n, m in ABERRATIONS]
        wavefront = sum(w * mode for w, mode in zip(weights, modes, strict=True))
        aberration = float(_validate.number("aberration", aberration, least=0))
        # Tilt and defocus are equivalent to a shift and a change of distance.
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
        wrong = draw.uniform(-1, 1) * float(_validate.number("distance_error", distance_error))
        path = distance.moved(wrong * (distance.after or 0.0)) if isinstance(distance, Lens) else nominal * (1 + wrong)
        if isinstance(path, Lens):
            a, b = path.ray_matrix
            turns = abs(a / (self.wavelength * b)) * pitch**2 * max(rows, columns) / 2
            if turns > 0.5:
                raise ValueError(
                    f"distance must be a lens near whose back focal plane the camera is: at {path.after:g} m the phase "
                    f"of its light turns by {turns:.2g} cycles over a pixel at the edge, more than 0.5"
                )
        self._pitch, self._noise = pitch, draw
        reflected = float(_validate.number("reflection", reflection, least=0)) * np.exp(2j * np.pi * draw.random())
        # Faults that were added later do not change what the seed draws for the others.
        more = np.random.default_rng([seed, 1])
        low = np.stack([(x / half) ** i * (y / half) ** j for i, j in ((1, 0), (0, 1), (2, 0), (1, 1), (0, 2), (3, 0))])
        gain = np.tensordot(more.normal(size=len(low)), low, axes=1)
        gain = (gain - gain.mean()) / gain.std() + 0.1 * more.normal(size=gain.shape)
        gain = (gain - gain.mean()) / gain.std()
        for row, column, radius, depth in zip(
            *(more.uniform(0.05, 0.95, (2, _validate.integer("dust", dust))) * [[rows], [columns]]),
            more.uniform(1.0, 0.02 * max(rows, columns) + 1, dust),
            more.uniform(0.5, 0.9, dust),
            strict=True,
        ):
            away = np.hypot(np.arange(rows)[:, None] - row, np.arange(columns) - column)
            amplitude = amplitude * (1 - depth * np.clip(radius + 0.5 - away, 0, 1))
        self.truth: Truth = Truth(
            *(phases, amplitude, wavefront, path, homography, distortion, reflected),
            response=1 + float(_validate.number("regional", regional, least=0)) * gain,
            flicker=float(_validate.number("flicker", flicker, least=0)),
            fringing=float(_validate.number("fringing", fringing, least=0)),
            fill_factor=float(_validate.number("fill_factor", fill_factor, positive=True)),
            time_constant=float(_validate.number("time_constant", time_constant, least=0)) * more.uniform(0.7, 1.3),
            polarisation=more.uniform(-30, 30) * _validate.flag("polarisation", polarisation),
        )
        if self.truth.fill_factor > 1:
            raise ValueError(f"fill_factor must be at most 1, got {fill_factor!r}")
        self._samples = None
        if samples_per_pixel is not None:
            self._samples = _validate.integer("samples_per_pixel", samples_per_pixel, minimum=1)
        self._iris = None if iris is None else float(_validate.number("iris", iris, positive=True))
        # Transfer function of the last distance and wavelength.
        self._transfer: tuple[Any, np.ndarray] = (None, np.zeros(0))
        # Light of the pattern that is shown, by what else it depends on.
        self._seen: dict[tuple[float, ...], tuple[np.ndarray, float]] = {}
        self.clock: float = 0.0
        self._levels = np.zeros((rows, columns), dtype=np.uint8)
        self._before, self._shown = np.zeros((rows, columns)), -np.inf
        self.modulator: SimulatedModulator = SimulatedModulator(self, (rows, columns), pitch, 10 * float(time_constant))
        self.camera: SimulatedCamera = SimulatedCamera(self, (camera_rows, camera_columns), camera_pitch, draw)
        self.laser: SimulatedLaser = SimulatedLaser(self.wavelength)
        self.stage: SimulatedStage = SimulatedStage()
        self.polariser: SimulatedRotator = SimulatedRotator()
        # The brightest spot that the modulator can form stays below saturation at an exposure of 1 ms.
        area = amplitude.sum() * pitch**2 / (self.wavelength * abs(nominal))
        self._unit = 0.7 * FULL_WELL / area**2

    @classmethod
    def realistic(cls, seed: int, **options: Any) -> "SimulatedTable":
        """Return a table that has all faults of the modulator too, as large as they are in laboratories.

        Parameters
        ----------
        seed : int
            Seed of the hidden properties and of the noise.
        **options
            Parameters of :class:`SimulatedTable`, which replace the parameters of this table.

        Returns
        -------
        SimulatedTable
            The table.
        """
        return cls(seed, **{**REALISTIC, **options})

    def phase(self, after: float = 0.0) -> np.ndarray:
        """Return the phase of each pixel some seconds after now, in radians at the nominal wavelength."""
        wanted = self.truth.phases[self._levels] * self.truth.response
        if self.truth.time_constant == 0:
            return wanted
        return wanted + (self._before - wanted) * np.exp(-(self.clock + after - self._shown) / self.truth.time_constant)

    def settled(self) -> bool:
        """Return whether the modulator shows its pattern to 1e-5 of the change."""
        return self.clock - self._shown >= 12 * self.truth.time_constant

    def intensity(self, flicker: float = 0.0, after: float = 0.0) -> tuple[np.ndarray, float]:
        """Return the intensity in the plane of the camera, averaged over its pixels, and the pitch of its samples.

        Parameters
        ----------
        flicker : float
            Relative deviation of the phases at this moment.
        after : float
            Seconds from now.

        Returns
        -------
        tuple of numpy.ndarray and float
            Intensity ``[rows, columns]``, the sample at index n // 2 on the axis, and pitch in metres.
        """
        if not self.settled():
            return self._light(flicker, after)
        laser = self.laser
        key = (laser.wavelength, laser.power, self.stage.position, self.polariser.angle, flicker, id(self.truth))
        if key not in self._seen:
            self._seen[key] = self._light(flicker, after)
        return self._seen[key]

    def _light(self, flicker: float, after: float) -> tuple[np.ndarray, float]:
        truth = self.truth
        s = self._samples or (FINER if truth.fringing else 1)
        scale = self.wavelength / self.laser.wavelength
        finely = np.ones((s, s))
        phase = np.kron(self.phase(after) * (1 + flicker), finely)
        if truth.fringing:
            phase = gaussian_filter(phase, truth.fringing * s, mode="nearest")
        # Light that is not modulated, of the gaps and the cover glass, and what the phase adds to it.
        incident = truth.amplitude * np.exp(1j * scale * truth.wavefront)
        still = incident + truth.amplitude * truth.reflection
        modulated = np.kron(incident, finely) * (np.exp(1j * scale * phase) - 1)
        axis = np.radians(self.polariser.angle - truth.polarisation)
        light, pitch = self._travelled(modulated, still)
        if truth.polarisation or self.polariser.angle:
            light = np.cos(axis) ** 2 * light + np.sin(axis) ** 2 * self._travelled(0 * modulated, still)[0]
        return self.laser.power * light, pitch

    def _travelled(self, modulated: np.ndarray, still: np.ndarray) -> tuple[np.ndarray, float]:
        """Return the intensity in the plane of the camera, and the pitch of its samples.

        The field of the modulator is the sum of the light that is not modulated and the light of modulated parts of
        pixels.
        """
        s, fill = self._samples or 1, self.truth.fill_factor
        pitch, shape = self._pitch / s, [n * s for n in still.shape]
        path, wavelength = self.truth.distance, self.laser.wavelength
        corners = np.array([[u, v] for u in (0, self.camera.shape[1]) for v in (0, self.camera.shape[0])], float)
        seen = np.abs(self.truth.plane_points(corners, self.camera.shape)).max(0)[::-1]
        if isinstance(path, Lens):
            return self._focused(modulated, still, path.moved(self.stage.position), float(seen.max()))
        distance = path + self.stage.position
        band = (1.0 * s, 1.0 * s)
        if self._samples is None:
            farthest = max(n * pitch / 2 + far for n, far in zip(shape, seen, strict=True))
            band = orders_reaching(farthest, distance, pitch, wavelength, min(self._iris or ORDERS, ORDERS))
        orders = 1 if self._samples else math.ceil(band[1])
        # Light that leaves the grid wraps around to the opposite side, but does not reach the field of the camera.
        sine = min(band[1], self._iris or math.inf) * wavelength / (2 * self._pitch)
        spread = abs(distance) * np.tan(np.arcsin(min(sine, 0.9)))
        width = [max(n * pitch / 2 + spread + far, 2 * spread) / pitch for n, far in zip(shape, seen, strict=True)]
        wide = [2 * fft.next_fast_len(int(max(w, n) / 2) + 8 * s) for w, n in zip(width, shape, strict=True)]
        if self._samples is None:
            spectrum = pixels_spectrum(still.astype(np.complex64), wide, orders)
            cells = modulated.shape[0] // still.shape[0]
            spectrum += pixels_spectrum(modulated.astype(np.complex64), wide, orders, fill, cells)
        else:
            spectrum = fft.fft2(self._points(modulated, still).astype(np.complex64), wide)
        # The axis passes through the middle of pixel n // 2, and is brought to the middle of the grid.
        middle = [n // 2 * s + (s - 1) / 2 - m // 2 for n, m in zip(still.shape, wide, strict=True)]
        spectrum *= self._transferred(spectrum.shape, pitch, orders, band, distance, middle)
        # An intensity has twice the bandwidth of its field, and splines need some more samples; of several orders, the
        # highest frequencies are weak.
        finer = max(FINER, math.ceil(1.5 * band[1])) if s == 1 else 2
        wider = np.zeros([finer * n for n in wide], dtype=np.complex64)
        halves = [(slice(0, n // 2), slice(-(n // 2), None)) for n in spectrum.shape]
        for part in itertools.product(*halves):
            wider[part] = spectrum[part]
        field = fft.ifft2(wider, overwrite_x=True)
        return self._averaged((field.real**2 + field.imag**2) * finer**4, pitch / finer)

    def _focused(self, modulated, still, path: Lens, seen: float) -> tuple[np.ndarray, float]:
        """Return the intensity behind a lens as far as `seen` from the axis, and the pitch of its samples.

        Collins' integral of squares is their spectrum, with the part of its curvature that the lens leaves.
        """
        (a, b), wavelength, fill = path.ray_matrix, self.laser.wavelength, self.truth.fill_factor
        size = 2 * fft.next_fast_len(math.ceil(FINER / 2 * max(still.shape)))
        curvature = a / (2 * wavelength * b)

        def curved(field: np.ndarray, cells: int, width: float = 1.0) -> np.ndarray:
            inner = ((np.arange(cells) + 0.5) / cells - 0.5) * width
            y, x = (self._pitch * np.add.outer(np.arange(n) - n // 2, inner).ravel() for n in still.shape)
            cycles = np.remainder(curvature * np.add.outer(y**2, x**2), 1)
            return (field * np.exp(2j * np.pi * cycles)).astype(np.complex64)

        if self._samples is None:
            orders = int(np.clip(math.ceil(2 * seen * self._pitch / abs(wavelength * b) + 0.1), 1, ORDERS))
            cells = modulated.shape[0] // still.shape[0]
            parts = FINER if curvature and cells == 1 else cells
            modulated, unmodulated = (
                np.kron(f, np.ones((n, n))) for f, n in ((modulated, parts // cells), (still, parts))
            )
            spectrum = pixels_spectrum(curved(unmodulated, parts), (size, size), orders, 1.0, parts)
            spectrum += pixels_spectrum(curved(modulated, parts, fill**0.5), (size, size), orders, fill, parts)
        else:
            orders = self._samples
            field = self._points(modulated, still)
            spectrum = fft.fft2(curved(field, orders), (orders * size, orders * size)) / orders**2
        pitch = wavelength * b / (size * self._pitch)
        light = fft.fftshift(spectrum.real**2 + spectrum.imag**2) * (self._pitch**2 / (wavelength * b)) ** 2
        y, x = ((np.arange(n) - n // 2) * pitch for n in light.shape)
        radius = np.hypot(y[:, None], x)
        light *= radius >= path.block
        if self._iris is not None:
            light *= radius <= self._iris * abs(wavelength * b) / (2 * self._pitch)
        return self._averaged(light, pitch)

    def _points(self, modulated: np.ndarray, still: np.ndarray) -> np.ndarray:
        """Return the field of pixels that are sets of points, with gaps between them."""
        s = self._samples or 1
        edges = np.clip(np.arange(s + 1) - s / 2, *(np.array([-0.5, 0.5]) * s * np.sqrt(self.truth.fill_factor)))
        down, across = (np.tile(np.diff(edges), n) for n in still.shape)
        return np.kron(still, np.ones((s, s))) + np.outer(down, across) * modulated

    def _averaged(self, light: np.ndarray, pitch: float) -> tuple[np.ndarray, float]:
        """Return an intensity averaged over the pixels of the camera, and the pitch of its samples."""
        frequencies = fft.fftfreq(light.shape[0], pitch)[:, None], fft.rfftfreq(light.shape[1], pitch)[None]
        response = np.prod(np.broadcast_arrays(*(np.sinc(f * self.camera.pitch) for f in frequencies)), axis=0)
        return fft.irfft2(fft.rfft2(light) * response.astype(np.float32), s=light.shape), pitch

    def _transferred(self, shape, pitch, orders, band, distance, middle) -> np.ndarray:
        """Return the transfer function to the camera of a band of orders, which brings a place in samples to 0."""
        key = (shape, orders, distance, self.laser.wavelength)
        if self._transfer[0] != key:
            fy, fx = (fft.fftfreq(n, pitch / orders) for n in shape)
            axial = 1 / self.laser.wavelength**2 - fy[:, None] ** 2 - fx**2
            cycles = distance * (np.sqrt(np.clip(axial, 0, None)) - 1 / self.laser.wavelength)
            cycles += pitch * (fy[:, None] * middle[0] + fx * middle[1])
            down, across = (taper(2 * self._pitch * abs(f), band) for f in (fy, fx))
            passes = (axial > 0) * down[:, None] * across
            if self._iris is not None:
                passes *= np.hypot(fy[:, None], fx) <= self._iris / (2 * self._pitch)
            self._transfer = key, (passes * np.exp(2j * np.pi * cycles)).astype(np.complex64)
        return self._transfer[1]


class SimulatedModulator(_show.Shown):
    """Simulated phase-only modulator of 8 bits; see :class:`SimulatedTable`."""

    bits = 8

    def __init__(self, table: SimulatedTable, shape: tuple[int, int], pitch: float, settling_time: float = 0.0):
        self._table = table
        self.shape: tuple[int, int] = shape
        self.pitch: float = pitch
        self.settling_time: float = settling_time

    def show(self, levels: np.ndarray) -> None:
        """Show a pattern of levels 0 … 255, integers ``[rows, columns]``."""
        found, table = checked_levels(levels, self.shape, self.bits), self._table
        table._before, table._shown = table.phase(), table.clock
        table._levels = found
        table._seen.clear()
        table.clock += self.settling_time


class SimulatedCamera(_show.Shown):
    """Simulated camera of 12 bits with noise, fixed pattern and saturation; see :class:`SimulatedTable`."""

    bits = 12

    def __init__(self, table: SimulatedTable, shape: tuple[int, int], pitch: float, draw: np.random.Generator):
        self._table = table
        self.shape: tuple[int, int] = shape
        self.pitch: float = pitch
        self.exposure: float = 1e-3
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
        flicker = table.truth.flicker
        # Gauss's points of the exposure, where the pattern changes meanwhile.
        moments, shares = np.polynomial.legendre.leggauss(1 if table.settled() else 4)
        moments = (moments + 1) * self.exposure / 2
        seen = np.stack(
            [
                sum(
                    share / 2 * self._sampled(points, *table.intensity(part, moment))
                    for moment, share in zip(moments, shares, strict=True)
                )
                for part in ([-flicker, 0, flicker] if flicker else [0])
            ]
        )
        table.clock += count * self.exposure
        noise = table._noise
        if flicker:
            # Mean and mean square of a sine over the exposure, from a random moment on; the intensity is a parabola.
            start, turn = 2 * np.pi * noise.random(count), 2 * np.pi * FLICKER_RATE * self.exposure
            mean = (np.cos(start) - np.cos(start + turn)) / turn
            square = 0.5 - (np.sin(2 * (start + turn)) - np.sin(2 * start)) / (4 * turn)
            share = np.stack([(square - mean) / 2, 1 - square, (square + mean) / 2], axis=-1)
            seen = np.tensordot(share, seen, axes=1)
        electrons = np.clip(seen, 0, None) * table._unit * self.exposure / 1e-3 * self._gain[window]
        read = noise.poisson(np.minimum(electrons, 1e9), (count, *electrons.shape[1:])) + self._offset[window]
        read = read + 3 * noise.normal(size=read.shape)
        counts = np.clip(read, 0, FULL_WELL) * ((1 << self.bits) - 1) / FULL_WELL
        return np.rint(counts).astype(np.uint16)

    @staticmethod
    def _sampled(points: np.ndarray, light: np.ndarray, pitch: float) -> np.ndarray:
        """Return an intensity, whose samples have a pitch, at points x, y in metres."""
        at = [points[..., i] / pitch + light.shape[axis] // 2 for i, axis in ((1, 0), (0, 1))]
        # Only the part imaged onto the region, because spline interpolation is slow.
        corner = [max(int(np.floor(part.min())) - 8, 0) for part in at]
        part = light[tuple(slice(c, int(np.ceil(a.max())) + 9) for c, a in zip(corner, at, strict=True))]
        return map_coordinates(part, [a - c for a, c in zip(at, corner, strict=True)], order=3, mode="constant")


class SimulatedLaser(_show.Shown):
    """Simulated laser; see :class:`SimulatedTable`."""

    def __init__(self, wavelength: float):
        self.wavelength: float = wavelength
        self.power: float = 1.0


class SimulatedRotator(_show.Shown):
    """Simulated rotation mount with a polariser; see :class:`SimulatedTable`."""

    def __init__(self):
        self.angle: float = 0.0

    def turn(self, angle: float) -> None:
        """Rotate to an angle in degrees."""
        self.angle = float(_validate.number("angle", angle))


class SimulatedStage(_show.Shown):
    """Simulated linear stage on which the camera is mounted; see :class:`SimulatedTable`."""

    def __init__(self):
        self.position: float = 0.0

    def move(self, position: float) -> None:
        """Move to a position in metres."""
        self.position = float(_validate.number("position", position))
