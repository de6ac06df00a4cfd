"""Differentiable model of a modulator, the light path and a camera, fitted to captures, and holograms through it."""

import itertools
import math
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import torch
from scipy.fft import next_fast_len
from scipy.interpolate import CubicSpline
from scipy.ndimage import map_coordinates

from odak import _array, _show, _validate
from odak._array import Array
from odak._attributes import Prepared
from odak._torch_private import forward_derivative, in_own_precision
from odak._warnings import ConvergenceWarning, warn
from odak.instruments import Calibration, Camera, Captures, Registration, SLMDriver, load_calibration
from odak.instruments.mapping import Lens, plane_points, ray_matrix
from odak.instruments.protocols import checked_camera
from odak.learn._tensors import tensor, trainable
from odak.learn.models.training import train
from odak.learn.tools.iterations import Run, minimise
from odak.learn.wave.slm import nearest_levels_by_factors, smooth, turns_of
from odak.learn.wave.training import best_scale
from odak.wave.elements import zernike_modes
from odak.wave.linear_kernels import orders_reaching, pixels_spectrum, taper

__all__ = ["DisplayFit", "display_camera", "display_hologram", "display_model", "fit_display"]

# Prior standard deviation of each parameter, in its own unit. It matters only for combinations of
# parameters that the captures do not determine.
PRIORS = {
    "brightness": 10.0,
    "lut": 0.5,
    "response": 0.1,
    "source": 1.0,
    "aberration": 3.0,
    "distance": 30.0,
    "fringing": 0.3,
    "fill": 0.1,
    "gap": 0.3,
    "reflection": 0.1,
    "iris": 0.1,
    "alignment": 30.0,
    "aperture": 0.1,
    "offset": 20.0,
}
# Standard deviation of the phases of a calibration that is taken at least, in radians.
LEAST_DOUBT = 1e-4
# Samples of the intensity along a pixel of the modulator, at least, and parts of a pixel along each side in which
# fringing fields vary its phase.
FINER = 3
# Pixels whose captures give the matrix of the first steps, at least, and captures that give the last and the
# uncertainties.
CURVED, CERTAIN = 8000, 2
# Shares of a pixel without gaps, and light of the gaps, that are tried.
FILLS, GAPS = (0.97, 0.94, 0.9, 0.85, 0.8), ((0.0, 0.0), (1.0, 0.0), (0.5, 0.0), (-0.5, 0.0), (0.0, 0.5), (0.0, -0.5))
# Samples of the intensity for the cycle of its highest frequency.
OVER = 3.0
# Pixels of the camera by which its image may move while a model is fitted, and samples beside the image on which the
# samples of its rim depend.
MARGIN, REACH = 16, 16
# Diffraction orders along each axis that are computed, at most.
ORDERS = 3


class display_model(Prepared, torch.nn.Module):
    r"""Differentiable model of a display and a camera: source, modulator, light path and sensor.

    The phase of a level is read from a look-up table and multiplied by a factor that varies over the panel. Fringing
    fields smooth it, gaps between the pixels and a reflection add light, and the amplitude and the aberration of the
    source multiply it. Pixels are squares, whose light falls off with the angle, in the orders of diffraction that
    reach the camera, up to three along each axis. The light passes an iris and propagates to the camera by the angular
    spectrum method. Each pixel of the camera averages over its area at a place that a homography and a radial
    distortion give. What is left may be learned by maps of amplitude and phase of free form, and by a small network
    that adds to the image.

    All parameters are deviations from what the model starts with; :func:`fit_display` fits them to captures.

    Parameters
    ----------
    shape : sequence of int
        Rows and columns of the modulator.
    pitch : float or sequence of float
        Distance between pixels of the modulator in metres, one number or (rows, columns).
    wavelength : float
        Vacuum wavelength in metres.
    distance : float or odak.instruments.Lens
        Distance from the modulator to the camera in metres, at stage position 0, or the lens between them.
    camera_shape : sequence of int
        Rows and columns of the camera.
    camera_pitch : float or sequence of float
        Distance between pixels of the camera in metres, one number or (rows, columns).
    phases : array, optional
        Phase of each level in radians, ``[levels]``; by default 256 levels evenly over 2π.
    amplitude : array, optional
        Amplitude of the light on the modulator, ``[rows, columns]``; one by default.
    wavefront : array, optional
        Aberration at the modulator in radians, ``[rows, columns]``; none by default.
    registration : odak.instruments.Registration, optional
        Mapping of the camera; by default the camera is aligned with the modulator.
    samples_per_pixel : int, optional
        None, the default, for pixels that are squares, with gaps that send light of their own. A number makes each
        pixel a set of points, that many along each side, as earlier versions did by default with one; gaps are drawn
        with two or more.
    iris : float, optional
        Radius of a round iris in the Fourier plane of a relay, in units of 1/(2·pitch), the larger pitch where they
        differ; none by default. Behind a lens, it is in the plane of the camera, in units of the farthest point that a
        pixel reaches.
    zernike_order : int
        Highest radial order of the Zernike polynomials of the aberration.
    source_order : int
        Order of the polynomial of the logarithm of the amplitude.
    nodes : int
        Points of the look-up table that are fitted; a cubic spline connects them.
    free_form : int
        Rows and columns of three maps of free form, of phase, logarithm of the amplitude and response; 0 for none. As
        many as the modulator has let each pixel differ, and dust be found.
    residual : int
        Channels of the residual network, 0 for none.
    dtype : torch.dtype
        float32 or float64.

    Attributes
    ----------
    aberration : torch.nn.Parameter
        Coefficients of :attr:`modes` in radians (root mean square about 1 over the panel).
    modes : list of tuple
        Pairs (n, m) of the Zernike polynomials over the circle around the panel, made orthogonal to piston, tilts and
        defocus, which belong to the alignment and the distance.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.wave import display_model
    >>> model = display_model([16, 16], 8e-6, 532e-9, 2e-3, [20, 24], 4e-6)
    >>> model(torch.zeros(3, 16, 16, dtype=torch.uint8)).shape
    torch.Size([3, 20, 24])
    """

    modes: list[tuple[int, int]]

    _fixed = (
        *("shape", "pitch", "camera_shape", "camera_pitch", "wavelength", "lens", "nominal_distance"),
        *("physical", "modes"),
    )
    brightness: torch.nn.Parameter
    lut: torch.nn.Parameter
    response: torch.nn.Parameter
    source: torch.nn.Parameter
    aberration: torch.nn.Parameter
    distance: torch.nn.Parameter
    fringing: torch.nn.Parameter
    fill: torch.nn.Parameter
    gap: torch.nn.Parameter
    reflection: torch.nn.Parameter
    iris: torch.nn.Parameter
    alignment: torch.nn.Parameter
    aperture: torch.nn.Parameter
    offset: torch.nn.Parameter
    free_maps: torch.nn.Parameter | None
    residual: torch.nn.Module | None
    _phases: torch.Tensor
    _spline: torch.Tensor
    _amplitude: torch.Tensor
    _wavefront: torch.Tensor
    _modes: torch.Tensor
    _powers: torch.Tensor
    _smooth: torch.Tensor
    _slope: torch.Tensor
    _radius: torch.Tensor
    _unblocked: torch.Tensor
    _pixels: torch.Tensor
    _homography: torch.Tensor

    extra_repr: Callable[..., str] = _show.numbers_of

    @_validate.takes_units("pitch", "wavelength", "distance", "camera_pitch")
    def __init__(
        self,
        shape: Sequence[int],
        pitch: float | Sequence[float],
        wavelength: float,
        distance: float | Lens,
        camera_shape: Sequence[int],
        camera_pitch: float | Sequence[float],
        *,
        phases: Array | Sequence[float] | None = None,
        amplitude: Array | None = None,
        wavefront: Array | None = None,
        registration: Registration | None = None,
        samples_per_pixel: int | None = None,
        iris: float | None = None,
        zernike_order: int = 4,
        source_order: int = 4,
        nodes: int = 17,
        free_form: int = 0,
        residual: int = 0,
        dtype: torch.dtype = torch.float32,
    ):
        super().__init__()
        if dtype not in (torch.float32, torch.float64):
            raise ValueError(f"dtype must be torch.float32 or torch.float64, got {dtype}")
        self.shape: tuple[int, int] = _validate.size("shape", shape)
        self.camera_shape: tuple[int, int] = _validate.size("camera_shape", camera_shape)
        self.pitch: float | Sequence[float] = pitch
        self.camera_pitch: float | Sequence[float] = camera_pitch
        self._pitches, self._camera_pitches = (
            tuple(map(float, _validate.pair(name, value, positive=True)))
            for name, value in (("pitch", pitch), ("camera_pitch", camera_pitch))
        )
        self.wavelength: float = _validate.constant("wavelength", wavelength, positive=True)
        self.lens: Lens | None = distance if isinstance(distance, Lens) else None
        _, reach = ray_matrix(distance)
        self.nominal_distance: float = float((self.lens.after or 0.0) if self.lens else reach)
        self.samples_per_pixel, s = samples_per_pixel, 1
        if samples_per_pixel is not None:
            self.samples_per_pixel = s = _validate.integer("samples_per_pixel", samples_per_pixel, minimum=1)
        # Points or parts of a pixel along each side.
        self._parts = FINER if samples_per_pixel is None else s
        self._dtype = dtype
        # Unit of the distance: the depth of focus of the whole panel.
        longest = max(n * pitch for n, pitch in zip(self.shape, self._pitches, strict=True))
        self._depth = self.wavelength * (reach / longest) ** 2
        if registration is None:
            registration = Registration(np.diag([*self._camera_pitches[::-1], 1.0]), 0.0, self.camera_shape)
        elif not isinstance(registration, Registration):
            raise TypeError(f"registration must be a Registration, got {type(registration).__name__}")
        elif tuple(registration.shape) != self.camera_shape:
            raise ValueError(f"registration must be of a camera {self.camera_shape}, got {tuple(registration.shape)}")
        iris = None if iris is None else _validate.constant("iris", iris, positive=True)
        self._start = registration
        self._buffers_of_panel(phases, amplitude, wavefront, zernike_order, source_order, nodes)
        if self.lens is None:
            self._grid(registration, iris)
        else:
            self._focal_grid(registration, reach)
        sizes = dict.fromkeys(PRIORS, 1) | {
            "lut": nodes - 1,
            "response": len(self._smooth),
            "source": len(self._powers),
            "aberration": len(self.modes),
            "gap": 2,
            "reflection": 2,
            "alignment": 9,
        }
        there = {"fill": self._parts > 1, "gap": samples_per_pixel is None, "iris": iris is not None}
        self.physical: list[str] = [name for name in PRIORS if there.get(name, True)]
        self._priors = dict(PRIORS)
        # Gaps reflect with phase 0. Fringing fields act within square pixels too: a model that nothing is known of has
        # next to none.
        fill, fringing = (1.0, 0.1) if samples_per_pixel is None else (0.95, 0.4)
        starts = {"fringing": fringing, "fill": fill, "iris": iris, "aperture": 1.0, "gap": (1.0, 0.0)}
        for name in self.physical:
            value = torch.zeros(sizes[name], dtype=dtype) + torch.tensor(starts.get(name) or 0.0, dtype=dtype)
            self.register_parameter(name, torch.nn.Parameter(value))
        count = _validate.integer("free_form", free_form)
        self.free_maps = torch.nn.Parameter(torch.zeros(3, count, count, dtype=dtype)) if count else None
        self.residual = _residual(width, dtype) if (width := _validate.integer("residual", residual)) else None

    @classmethod
    def from_calibration(
        cls,
        calibration: Calibration | str | os.PathLike[str],
        camera_pitch: float | Sequence[float],
        *,
        wavelength: float | None = None,
        **options: Any,
    ) -> "display_model":
        """Return a model that starts with the results of a calibration.

        Parameters
        ----------
        calibration : odak.instruments.Calibration, str or os.PathLike
            From :func:`odak.instruments.calibrate_table`, or the file of one, as `odak calibrate` writes it. A fit to
            captures keeps its phases within their uncertainty where it states one.
        camera_pitch : float or sequence of float
            Distance between pixels of the camera in metres, one number or (rows, columns).
        wavelength : float, optional
            Wavelength in metres, if it differs from the calibrated one; phases and aberration scale with its inverse.
        **options
            Parameters of :class:`display_model`.

        Returns
        -------
        display_model
            The model.
        """
        if isinstance(calibration, (str, os.PathLike)):
            calibration = load_calibration(calibration)
        wavelength = calibration.wavelength if wavelength is None else wavelength
        scale = calibration.wavelength / wavelength
        known: dict[str, Any] = {
            "phases": scale * calibration.phases,
            "amplitude": calibration.amplitude,
            "wavefront": scale * calibration.wavefront,
            "registration": calibration.registration,
        }
        shape, camera_shape = calibration.amplitude.shape, calibration.registration.shape
        there = (shape, calibration.pitch, wavelength, calibration.distance, camera_shape, camera_pitch)
        model = cls(*there, **(known | options))
        # Captures of patterns with few pixels of the lowest levels determine all phases less well than a calibration.
        doubt = calibration.uncertainty.get("phases")
        if doubt is not None and "phases" not in options:
            model._priors["lut"] = max(scale * doubt, LEAST_DOUBT)
        return model

    def forward(self, levels: torch.Tensor, position: float = 0.0, pixels: torch.Tensor | None = None) -> torch.Tensor:
        """Return the counts of the camera, without dark counts and noise.

        Parameters
        ----------
        levels : torch.Tensor
            Patterns, integers ``[..., rows, columns]``.
        position : float
            Position of the stage in metres, which adds to the distance.
        pixels : torch.Tensor, optional
            Numbers of the pixels of the camera, row by row, that are computed; all by default. The network, which
            needs a whole image, is then left out.

        Returns
        -------
        torch.Tensor
            ``[..., camera rows, camera columns]``, or ``[..., pixels]``; differentiable in all parameters.
        """
        levels = trainable(tensor("levels", levels))
        pixels = None if pixels is None else tensor("pixels", pixels)
        if pixels is not None and (pixels.dtype is not torch.int64 or pixels.ndim != 1):
            raise ValueError(f"pixels must be int64 [pixels], got {pixels.dtype} {list(pixels.shape)}")
        if levels.is_complex() or levels.is_floating_point() or tuple(levels.shape[-2:]) != self.shape:
            raise ValueError(f"levels must be integers {_ending(self.shape)}, got {levels.dtype} {list(levels.shape)}")
        if _array.is_readable(levels) and levels.numel():
            low, high = (int(value) for value in levels.aminmax())
            if low < 0 or high >= len(self._phases):
                raise ValueError(f"levels must be 0 to {len(self._phases) - 1}, got {low} to {high}")
        phase = self.table()[levels.long()] * self.response_map()
        counts = self.offset + torch.exp(self.brightness) * self._seen(self.field(phase), position, pixels)
        if pixels is not None:
            return counts
        image = counts.unflatten(-1, self.camera_shape)
        if self.residual is None:
            return image
        scale = torch.exp(self.brightness)
        flat = image.reshape(-1, 1, *self.camera_shape) / scale
        return image + scale * self.residual(flat).reshape(image.shape)

    def table(self) -> torch.Tensor:
        """Return the phase of each level in radians relative to level 0, ``[levels]``."""
        return self._phases + self._spline @ self.lut

    def response_map(self) -> torch.Tensor:
        """Return the factor of the phase at each pixel, ``[rows, columns]``."""
        return 1 + torch.tensordot(self.response, self._smooth, dims=1) + self._free(2)

    def source_amplitude(self) -> torch.Tensor:
        """Return the amplitude of the light on the modulator, ``[rows, columns]``."""
        logarithm = torch.tensordot(self.source, self._powers, dims=1) + self._free(1)
        return self._amplitude * torch.exp(logarithm)

    def wavefront(self) -> torch.Tensor:
        """Return the aberration at the modulator in radians, ``[rows, columns]``."""
        return self._wavefront + torch.tensordot(self.aberration, self._modes, dims=1) + self._free(0)

    def propagation_distance(self) -> torch.Tensor:
        """Return the distance from the modulator, or from the lens, to the camera at stage position 0, in metres."""
        return self.nominal_distance + self._depth * self.distance[0].double()

    def registration(self) -> Registration:
        """Return the mapping of the camera."""
        homography, distortion = (value.detach().double().cpu().numpy() for value in self._mapping())
        return Registration(homography, float(distortion), self.camera_shape)

    def field(self, phase: torch.Tensor) -> torch.Tensor:
        """Return the field behind the modulator for the phase of each pixel.

        Parameters
        ----------
        phase : torch.Tensor
            Phase in radians ``[..., rows, columns]``.

        Returns
        -------
        torch.Tensor
            Complex ``[..., rows·s, columns·s]`` with s samples per pixel; of the three parts along each side of the
            inner squares that modulate, without the gaps, where pixels are squares.
        """
        s = self._parts
        phase = _repeated(self._checked(phase), s)
        at = torch.arange(-2 * s, 2 * s + 1, dtype=phase.dtype, device=phase.device) / s
        # A fringing field has the same width along both axes, in units of the smaller pitch.
        widths = (self.fringing.abs().clamp_min(0.05) * min(self._pitches) / pitch for pitch in self._pitches)
        down, across = (torch.exp(-0.5 * (at / width) ** 2) for width in widths)
        phase = smooth(phase, down if self._pitches[0] == self._pitches[1] else torch.outer(down, across))
        light = torch.complex(torch.cos(phase), torch.sin(phase))
        if s > 1 and self.samples_per_pixel is not None:
            side = self.fill.clamp(1e-3, 1).sqrt() * s / 2
            edges = torch.arange(s + 1, dtype=phase.dtype, device=phase.device) - s / 2
            line = torch.minimum(torch.maximum(edges, -side), side).diff()
            active = torch.outer(line.repeat(self.shape[0]), line.repeat(self.shape[1]))
            light = active * light + (1 - active)
        aberration = _repeated(self.wavefront(), s)
        light = torch.complex(torch.cos(aberration), torch.sin(aberration)) * light
        light = light + torch.complex(self.reflection[0], self.reflection[1])
        return _repeated(self.source_amplitude(), s) * light

    @in_own_precision
    def image(self, phase: torch.Tensor, position: float = 0.0) -> torch.Tensor:
        """Return the intensity in the plane of the camera at points that lie as the pixels of the modulator do.

        Parameters
        ----------
        phase : torch.Tensor
            Phase that the pixels show in radians ``[..., rows, columns]``.
        position : float
            Position of the stage in metres.

        Returns
        -------
        torch.Tensor
            Intensity, averaged over the area of a pixel, ``[..., rows, columns]``; differentiable. Behind a lens the
            points are λ·focal_length/(rows·pitch) and λ·focal_length/(columns·pitch) apart, those that pixels reach.
        """
        s, (rows, columns) = self.samples_per_pixel, self.shape
        if s is None or self.lens is not None:
            # A whole number of samples lies between pixels.
            finer, wide = FINER, self._fine
            if self.lens is None:
                finer = max(-(-fine // size) for fine, size in zip(self._fine, self._sizes, strict=True))
                wide = [finer * size for size in self._sizes]
            light = _averaged(self._intensity_on_grid(self.field(phase), position, wide), wide, finer)
            light = torch.roll(light[..., ::finer, ::finer], (rows // 2, columns // 2), (-2, -1))
            return light[..., :rows, :columns]
        light = torch.fft.ifft2(self._spectrum(self.field(phase), position))
        light = light.real**2 + light.imag**2
        reach = s // 2
        shift = [(n // 2) * s + reach for n in (rows, columns)]
        light = torch.roll(light, shift, (-2, -1))[..., : rows * s + 2 * reach, : columns * s + 2 * reach]
        if s == 1:
            return light
        line = torch.ones(2 * reach + 1, dtype=light.dtype, device=light.device)
        if s % 2 == 0:
            line[0] = line[-1] = 0.5
        window = torch.outer(line, line) / s**2
        flat = light.reshape(-1, 1, *light.shape[-2:])
        found = torch.nn.functional.conv2d(flat, window[None, None], stride=s)[..., :rows, :columns]
        return found.reshape(*light.shape[:-2], rows, columns)

    @torch.no_grad()
    def levels(self, phase: torch.Tensor) -> torch.Tensor:
        """Return the levels whose phases are nearest to a phase at each pixel, modulo 2π.

        Parameters
        ----------
        phase : torch.Tensor
            Phase in radians ``[..., rows, columns]``.

        Returns
        -------
        torch.Tensor
            int64 ``[..., rows, columns]``.
        """
        phase = self._checked(phase)
        # Integers cannot represent NaN.
        _validate.real("phase", phase)
        table = self.table()
        return nearest_levels_by_factors(phase, table, self.response_map(), turns_of(table))

    def shown(self, phase: torch.Tensor) -> torch.Tensor:
        """Return the phase that the nearest levels show, with the gradient of `phase` itself.

        Parameters
        ----------
        phase : torch.Tensor
            Phase in radians ``[..., rows, columns]``.

        Returns
        -------
        torch.Tensor
            Phase in radians; the levels pass the gradient straight through.
        """
        phase = self._checked(phase)
        _validate.real("phase", phase)
        return self._quantised(phase, turns_of(self.table().detach()))

    def _quantised(self, phase: torch.Tensor, turns: int) -> torch.Tensor:
        table, factors = self.table().detach(), self.response_map().detach()
        levels = nearest_levels_by_factors(phase.detach(), table, factors, turns)
        return table[levels] * factors + (phase - phase.detach())

    def _buffers_of_panel(self, phases, amplitude, wavefront, zernike_order, source_order, nodes) -> None:
        rows, columns = self.shape
        levels = np.arange(256) * (2 * np.pi / 256) if phases is None else _numbers("phases", phases)
        if levels.ndim != 1 or len(levels) < 2:
            raise ValueError(f"phases must contain the phase of each level, got an array {list(levels.shape)}")
        at = np.linspace(0, len(levels) - 1, _validate.integer("nodes", nodes, minimum=4))
        spline = CubicSpline(at, np.eye(nodes)[:, 1:])(np.arange(len(levels)))
        y, x = (torch.as_tensor(places) for places in self._places())
        half = math.hypot(*(n * pitch for n, pitch in zip(self.shape, self._pitches, strict=True))) / 2
        y, x = y[:, None] / half, x[None] / half
        order = _validate.integer("zernike_order", zernike_order, minimum=2)
        self.modes = [(n, m) for n in range(2, order + 1) for m in range(-n, n + 1, 2) if (n, m) != (2, 0)]
        modes = torch.stack([mode.expand(rows, columns) for mode in zernike_modes(y + 0 * x, x + 0 * y, self.modes)])
        low = torch.stack([part.expand(rows, columns) for part in (y * 0 + 1, y, x, x**2 + y**2)])
        order = _validate.integer("source_order", source_order, minimum=2)
        powers = [(i, j) for i in range(order + 1) for j in range(order + 1 - i) if i + j > 0]
        surfaces = torch.stack([(x**i * y**j).expand(rows, columns) for i, j in powers])
        buffers = {
            "_phases": levels - levels[0],
            "_spline": spline,
            "_amplitude": np.ones(self.shape) if amplitude is None else _numbers("amplitude", amplitude),
            "_wavefront": np.zeros(self.shape) if wavefront is None else _numbers("wavefront", wavefront),
            "_modes": _without(modes, low),
            "_powers": _without(surfaces, low[:1]),
            "_smooth": _without(surfaces[[i + j <= 3 for i, j in powers]], low[:1]),
        }
        for name in ("_amplitude", "_wavefront"):
            if buffers[name].shape != self.shape:
                raise ValueError(f"{name[1:]} must be {list(self.shape)}, got {list(buffers[name].shape)}")
        for name, value in buffers.items():
            self.register_buffer(name, torch.as_tensor(value).to(self._dtype), persistent=False)

    def _grid(self, registration: Registration, iris: float | None) -> None:
        """Choose the grid of the spectrum, such that no light wraps around into the field of the camera."""
        s = self.samples_per_pixel or 1
        rows, columns = self.camera_shape
        corners = np.array([[0, 0], [columns, 0], [0, rows], [columns, rows]], float)
        seen = np.abs(registration.plane_points(corners)).max(0)[::-1]
        unit, sizes, bands = 1 / (2 * max(self._pitches)), [], [(1.0 * s, 1.0 * s)] * 2
        if self.samples_per_pixel is None:
            bands = [
                orders_reaching(
                    n * pitch / 2 + far, self.nominal_distance, pitch, self.wavelength, min(iris or ORDERS, ORDERS)
                )
                for n, pitch, far in zip(self.shape, self._pitches, seen, strict=True)
            ]
        for n, pitch, far, band in zip(self.shape, self._pitches, seen, bands, strict=True):
            sine = min(band[1] / (2 * pitch), (iris or math.inf) * unit) * self.wavelength
            spread = 1.2 * self.nominal_distance * math.tan(math.asin(min(sine, 0.9)))
            width = max(n * pitch / 2 + spread + far, 2 * spread)
            if self.samples_per_pixel is None:
                width = n * pitch / 2 + spread + max(far, n * pitch / 2)
            sizes.append(_fast(s * (max(math.ceil(width / pitch), n) + 16)))
        # An intensity has twice the frequencies of its field. Frequencies of three orders are weak, and none is above
        # the width of the panel as seen from the camera.
        self._sizes = self._counts = sizes
        self._fine = [-(-FINER // s) * size for size in sizes]
        if self.samples_per_pixel is None:
            self._fine, self._counts = [], []
            blur = math.sqrt(self.wavelength * self.nominal_distance)
            for n, pitch, size, (_, end) in zip(self.shape, self._pitches, sizes, bands, strict=True):
                angle = (n * pitch + blur) / self.nominal_distance
                samples = max(end, min(OVER * angle * pitch / self.wavelength, max(FINER, 1.5 * end)))
                self._fine.append(_fast(math.ceil(size * samples)))
                # No light of higher frequencies reaches the camera.
                self._counts.append(min(self._fine[-1], 2 * math.ceil(size * end / 2) + 2))
        lengths = [pitch * size / s for pitch, size in zip(self._pitches, sizes, strict=True)]
        fy, fx = (
            torch.fft.fftfreq(count, length / count, dtype=torch.float64)
            for count, length in zip(self._counts, lengths, strict=True)
        )
        squared = fy[:, None] ** 2 + fx**2
        axial = torch.sqrt((1 / self.wavelength**2 - squared).clamp_min(0))
        # What is deflected farther does not reach the camera, but would wrap around.
        self._passes = torch.outer(
            *(taper(2 * p * f.abs(), band) for f, band, p in zip((fy, fx), bands, self._pitches, strict=True))
        )
        # The axis passes through the middle of pixel n // 2; the panel starts at the first sample of the grid.
        centre = [(n // 2) * s + (s - 1) / 2 for n in self.shape]
        shift = sum(f * p / s * at for f, p, at in zip((fy[:, None], fx), self._pitches, centre, strict=True))
        self._axial, self._shift = axial, shift
        self.register_buffer("_slope", (2 * math.pi * (axial - 1 / self.wavelength)).to(self._dtype), persistent=False)
        self.register_buffer("_radius", (squared.sqrt() / unit).to(self._dtype), persistent=False)
        self._soft = 1 / (unit * max(lengths))
        self._steps = [length / fine for length, fine in zip(lengths, self._fine, strict=True)]
        self._sensor(registration)

    def _focal_grid(self, registration: Registration, reach: float) -> None:
        """Choose the grid of the focal plane of a lens, whose samples are frequencies, and the parts of pixels."""
        rows, columns = self.camera_shape
        corners = np.array([[0, 0], [columns, 0], [0, rows], [columns, rows]], float)
        seen = np.abs(registration.plane_points(corners)).max(0)[::-1]
        needed = [2 * far * p / abs(self.wavelength * reach) + 0.1 for far, p in zip(seen, self._pitches, strict=True)]
        orders = self.samples_per_pixel or min(max(math.ceil(max(needed)), 1), ORDERS)
        self._sizes = [FINER * n for n in self.shape]
        self._fine = self._counts = [orders * n for n in self._sizes]
        s, unit = self._parts, 1 / (2 * max(self._pitches))
        inner = (torch.arange(s, dtype=torch.float64) - (s - 1) / 2) / s
        y, x = (
            (p * (torch.arange(n, dtype=torch.float64)[:, None] - n // 2 + inner)).flatten()
            for n, p in zip(self.shape, self._pitches, strict=True)
        )
        self._squared = y[:, None] ** 2 + x**2
        lengths = [size * pitch for size, pitch in zip(self._sizes, self._pitches, strict=True)]
        fy, fx = (
            torch.fft.fftfreq(n, length / n, dtype=torch.float64)
            for n, length in zip(self._counts, lengths, strict=True)
        )
        radius = torch.hypot(fy[:, None], fx)
        lens: Any = self.lens
        slope = -math.pi / (self.wavelength * reach * lens.focal_length) * self._squared
        self.register_buffer("_slope", slope.to(self._dtype), persistent=False)
        self.register_buffer("_radius", (radius / unit).to(self._dtype), persistent=False)
        passes = self.wavelength * abs(reach) * radius >= lens.block
        self.register_buffer("_unblocked", passes.to(self._dtype), persistent=False)
        self._soft = 1 / (unit * max(n * p for n, p in zip(self.shape, self._pitches, strict=True)))
        self._sensor(registration)

    def _focal_steps(self, reach: float) -> list[float]:
        """Return the distance of samples in the focal plane of a lens along rows and columns, in metres."""
        return [self.wavelength * reach / (n * p) for n, p in zip(self._sizes, self._pitches, strict=True)]

    def _sensor(self, registration: Registration) -> None:
        """Prepare the pixels of the camera."""
        v, u = torch.meshgrid(*(torch.arange(n, dtype=torch.float64) for n in self.camera_shape), indexing="ij")
        self.register_buffer("_pixels", torch.stack([u, v], -1).reshape(-1, 2).to(self._dtype), persistent=False)
        start = torch.as_tensor(registration.homography / registration.homography[2, 2])
        self.register_buffer("_homography", start, persistent=False)
        self._kernels: dict[float, torch.Tensor] = {}
        # First sample and number of samples of the rows and columns around the camera's image; None for all.
        self._window: list[tuple[int, int]] | None = None

    def _kernel(self, position: float) -> torch.Tensor:
        """Return the transfer function to a position of the stage, formed in double precision.

        Behind a lens, it is the curvature that the lens leaves, at the parts of the pixels.
        """
        position = _validate.constant("position", position)
        if position not in self._kernels:
            if len(self._kernels) > 16:
                self._kernels.clear()
            if self.lens is None:
                cycles = (self.nominal_distance + position) * (self._axial - 1 / self.wavelength) + self._shift
                passes = self._passes
            else:
                a, b = self.lens.moved(position).ray_matrix
                cycles = a / (2 * self.wavelength * b) * self._squared
                passes = torch.ones_like(cycles)
            kernel = passes.to(cycles) * _array.phasor_of_cycles(cycles)
            self._kernels[position] = kernel.to(self._slope.device, self._dtype.to_complex())
        return self._kernels[position]

    def _apply(self, fn, recurse=True):
        """Follow ``.double()``, ``.to(…)`` and the like."""
        super()._apply(fn, recurse)
        self._dtype = self.fringing.dtype
        self._kernels.clear()
        return self

    def _spectrum(self, light: torch.Tensor, position: float) -> torch.Tensor:
        """Return the spectrum of the light in the plane of the camera, the axis at its first sample."""
        turn = self._depth * self.distance * self._slope
        points, there = self.samples_per_pixel is not None, self._kernel(position)
        there = there * torch.complex(torch.cos(turn), torch.sin(turn))
        if self.lens is not None:
            light = torch.fft.fft2(light * there, s=self._counts) if points else self._of_squares(light, there)
            spectrum = light * self._unblocked
        else:
            spectrum = (torch.fft.fft2(light, s=self._sizes) if points else self._of_squares(light)) * there
        if "iris" in self.physical:
            spectrum = spectrum * torch.sigmoid((self.iris - self._radius) / (0.5 * self._soft))
        return spectrum

    def _of_squares(self, light: torch.Tensor, curved: torch.Tensor | None = None) -> torch.Tensor:
        """Return the spectrum of the field of the squares that modulate, and of the gaps around them.

        A factor at the parts of the pixels may be given.
        """
        aberration = self.wavefront()
        gaps = torch.complex(*self.gap) * torch.complex(torch.cos(aberration), torch.sin(aberration))
        gaps = self.source_amplitude() * (gaps + torch.complex(*self.reflection))
        # A fit may step beyond 1.
        fill, still, parts = self.fill.clamp_min(1e-3), _repeated(gaps, self._parts), 1
        modulated = light - still
        if curved is not None:
            modulated, gaps, parts = modulated * curved, still * curved, self._parts
        modulated = pixels_spectrum(modulated, self._sizes, fill=fill, cells=self._parts, counts=self._counts)
        return modulated + pixels_spectrum(gaps, self._sizes, cells=parts, counts=self._counts)

    def _intensity_on_grid(self, light: torch.Tensor, position: float, fine: list[int] | None = None) -> torch.Tensor:
        """Return the intensity in the plane of the camera on a grid, the axis at its first sample, or in the window."""
        spectrum = self._spectrum(light, position)
        if self.lens is not None:
            return (spectrum.real**2 + spectrum.imag**2) / math.prod(self.shape)
        window, fine = self._window if fine is None else None, fine or self._fine
        for axis in (-1, -2):
            spectrum = torch.fft.ifft(_zero_padded(spectrum, fine[axis], axis), dim=axis)
            if window is not None:
                spectrum = _cut(spectrum, *window[axis], axis)
        there = math.prod(fine) / math.prod(self._sizes) * spectrum
        return there.real**2 + there.imag**2

    def _seen(self, light: torch.Tensor, position: float, pixels: torch.Tensor | None) -> torch.Tensor:
        """Return the intensity on pixels of the camera ``[..., pixels]``."""
        intensity = self._intensity_on_grid(light, position)
        if self.lens is None:
            steps = self._steps
        else:
            steps = self._focal_steps(self.lens.moved(_validate.constant("position", position)).ray_matrix[1])
        sizes, filters = list(intensity.shape[-2:]), []
        for frequencies, n, step, width in zip(
            (torch.fft.fftfreq, torch.fft.rfftfreq), sizes, steps, self._camera_pitches, strict=True
        ):
            f = frequencies(n, dtype=light.real.dtype, device=light.device)
            # Cubic B-splines pass through the samples of what the second factor makes of them.
            filters.append(torch.sinc(self.aperture * (width / step) * f) * (6 / (4 + 2 * torch.cos(2 * math.pi * f))))
        coefficients = torch.fft.irfft2(torch.fft.rfft2(intensity) * torch.outer(*filters), s=sizes)
        homography, distortion = self._mapping()
        places = self._pixels if pixels is None else self._pixels[pixels]
        points = plane_points(places, self.camera_shape, homography, distortion)
        (above, _), (before, _) = self._window or [(0, 0), (0, 0)]
        return _spline_values(coefficients, points[:, 1] / steps[0] - above, points[:, 0] / steps[1] - before)

    def _around_camera(self) -> list[tuple[int, int]] | None:
        """Return the window of the grid around the image of the camera, where all samples are not needed."""
        if self.lens is not None:
            return None
        rows, columns = self.camera_shape
        border = np.stack(np.meshgrid(np.linspace(0, columns - 1, 9), np.linspace(0, rows - 1, 9)), axis=-1)
        points, window = self.registration().plane_points(border).reshape(-1, 2)[:, ::-1], []
        for places, n, step, width in zip(points.T, self._fine, self._steps, self._camera_pitches, strict=True):
            spare = math.ceil(MARGIN * width / step) + REACH
            first = math.floor(places.min() / step) - spare
            count = _fast(math.ceil(places.max() / step) + spare - first)
            window.append((first, count) if count < n else (0, n))
        return window

    def _mapping(self) -> tuple[torch.Tensor, torch.Tensor]:
        """Return the homography from camera pixels to metres and the distortion.

        The parameters are, in pixels of the camera at the rim of its image, what each entry moves.
        """
        rim = max(self.camera_shape) / 2
        units = self._homography.new_tensor(
            [[1 / rim, 1 / rim, 1.0], [1 / rim, 1 / rim, 1.0], [1 / rim**2, 1 / rim**2, 0]]
        )
        units[:2] *= units.new_tensor(self._camera_pitches[::-1])[:, None]
        entries = torch.cat([self.alignment[:8].double(), self.alignment.new_zeros(1).double()]).reshape(3, 3)
        homography = self._homography + units * entries
        return homography.to(self._dtype), self._start.distortion + self.alignment[8] / rim

    def _places(self, of_image: bool = False) -> list[np.ndarray]:
        """Return the places in metres of the rows and columns of the modulator, or of images."""
        steps: Sequence[float] = self._pitches
        if of_image and self.lens is not None:
            steps = [FINER * step for step in self._focal_steps(self.lens.ray_matrix[1])]
        return [(np.arange(n) - n // 2) * step for n, step in zip(self.shape, steps, strict=True)]

    def _checked(self, phase: torch.Tensor) -> torch.Tensor:
        """Return a phase in the precision of the model, after checking that it is one of its modulator."""
        phase = tensor("phase", phase)
        if phase.is_complex() or not phase.is_floating_point():
            raise TypeError(f"phase must be a real tensor, got {phase.dtype}")
        if tuple(phase.shape[-2:]) != self.shape or not phase.numel():
            raise ValueError(f"phase must be {_ending(self.shape)}, got {list(phase.shape)}")
        return phase.to(self._dtype)

    def _free(self, which: int) -> torch.Tensor | float:
        """Return a map of free form at the pixels: of the phase, the logarithm of the amplitude, or the response."""
        if self.free_maps is None:
            return 0.0
        values = self.free_maps[None, which : which + 1]
        if tuple(values.shape[-2:]) == self.shape:
            return values[0, 0]
        return torch.nn.functional.interpolate(values, self.shape, mode="bicubic", align_corners=False)[0, 0]


@dataclass(frozen=True, repr=False)
class DisplayFit(_show.Shown):
    """Outcome of fitting a model to captures.

    Attributes
    ----------
    chi_squared : float
        Mean of the squared residuals over the variance of their noise: 1 for a model without errors.
    uncertainties : dict
        Standard deviation of each physical parameter by its name, of the parameter's shape and unit, from the inverse
        of the Gauss–Newton matrix of a few captures, scaled to the number of all; multiplied by the root of
        `chi_squared` where that is above 1.
    history : list of float
        `chi_squared` after each step: first of the fit of the physical parameters, over the captures that the step
        uses, then of the fit of the free forms.
    noise : tuple of float
        Slope and offset of the variance of a capture in counts.

    Examples
    --------
    >>> import numpy as np
    >>> from odak.instruments import SimulatedTable, record_captures
    >>> from odak.learn.wave import display_model, fit_display
    >>> table = SimulatedTable(
    ...     seed=1, shape=(16, 16), distance=2e-3, camera_shape=(24, 24), misalignment=False, distance_error=0.0
    ... )
    >>> table.camera.exposure = 0.1
    >>> levels = np.random.default_rng(0).integers(256, size=(3, 16, 16))
    >>> captures = record_captures(table.modulator, table.camera, levels, 532e-9, captures=4)
    >>> fit = fit_display(display_model([16, 16], 8e-6, 532e-9, 2e-3, [24, 24], 4e-6), captures, iterations=2)
    >>> fit.history[-1] < fit.history[0], len(fit.noise)
    (True, 2)
    """

    chi_squared: float
    uncertainties: dict[str, torch.Tensor]
    history: list[float] = field(repr=False)
    noise: tuple[float, float]


def fit_display(
    model: display_model,
    captures: Captures,
    *,
    iterations: int = 16,
    refinements: int = 0,
    pixels: int = 8192,
    learning_rate: float = 5e-3,
    noise: tuple[float, float] | None = None,
    seed: int = 0,
    chunk: int = 16,
) -> DisplayFit:
    """Fit a model of a display to captures of any patterns.

    The physical parameters are found by Levenberg and Marquardt's method, with the priors of each parameter, on pixels
    of the camera that are drawn at random: first on some thousands of them, then on the pixels of all captures, with
    the matrix of a few captures, which is corrected by the changes of the gradient. Then, where the model has them, the
    maps of free form and the network are fitted by Adam on all pixels. Residuals are divided by the standard deviation
    of their noise.

    Parameters
    ----------
    model : display_model
        The model, changed in place. Its alignment should be correct within half a speckle, as from a calibration.
    captures : odak.instruments.Captures
        Patterns and captures, all with one exposure, see :func:`odak.instruments.record_captures`.
    iterations : int
        Number of steps for the physical parameters in each of three stages, at most: without the light of the gaps
        between square pixels, which is not determined before the other parameters are nearly correct, with it, and
        with all captures.
    refinements : int
        Number of passes through all captures for free forms and network; needs a model that has them.
    pixels : int
        Number of pixels of each capture that the physical parameters are fitted to.
    learning_rate : float
        Adam's step size.
    noise : tuple of float, optional
        Slope and offset of the variance of a capture in counts; from the captures themselves by default.
    seed : int
        Seed of the pixels that are drawn and of the order of the captures.
    chunk : int
        Number of derivatives that are computed at a time.

    Returns
    -------
    DisplayFit
        Quality of the fit and uncertainties of the parameters.

    Raises
    ------
    ValueError, TypeError
        If the captures do not fit the model.

    Warns
    -----
    ConvergenceWarning
        If the image has moved by more than 16 pixels of the camera, beyond which the fit computes no light; or if the
        loss of the free forms has risen since its best.

    Examples
    --------
    >>> import numpy as np
    >>> from odak.instruments import SimulatedTable, record_captures
    >>> from odak.learn.wave import display_model, fit_display
    >>> table = SimulatedTable(
    ...     seed=1, shape=(16, 16), distance=2e-3, camera_shape=(24, 24), misalignment=False, distance_error=0.0
    ... )
    >>> table.camera.exposure = 0.1
    >>> levels = np.random.default_rng(0).integers(256, size=(3, 16, 16))
    >>> captures = record_captures(table.modulator, table.camera, levels, 532e-9, captures=4)
    >>> model = display_model([16, 16], 8e-6, 532e-9, 2e-3, [24, 24], 4e-6)
    >>> fit = fit_display(model, captures, iterations=1)
    >>> fit.uncertainties["distance"].shape
    torch.Size([1])
    """
    (learning_rate,) = _validate.constants(learning_rate=learning_rate)
    _validate.instance("model", model, display_model, "a display_model")
    _validate.instance("captures", captures, Captures, "Captures")
    if captures.levels.shape[1:] != model.shape or captures.frames.shape[2:] != model.camera_shape:
        raise ValueError(
            f"captures must be of patterns {list(model.shape)} and images {list(model.camera_shape)}, got "
            f"{list(captures.levels.shape[1:])} and {list(captures.frames.shape[2:])}"
        )
    if refinements and model.free_maps is None and model.residual is None:
        raise ValueError(f"refinements need a model with free_form or residual, got {refinements}")
    data = _Data.of(model, captures, captures.noise() if noise is None else noise)
    random = torch.Generator().manual_seed(_validate.integer("seed", seed))
    count = min(_validate.integer("pixels", pixels, minimum=100), math.prod(model.camera_shape))
    chosen = [torch.randperm(math.prod(model.camera_shape), generator=random)[:count] for _ in range(len(captures))]
    iterations = _validate.integer("iterations", iterations)
    model._window = window = model._around_camera()
    try:
        if bool((model.brightness == 0).all()):
            _match_brightness(model, data, chosen)
        history, uncertainties = _fit_physical(model, data, chosen, iterations, chunk, random)
        if refinements:
            history += _refine(model, data, _validate.integer("refinements", refinements), learning_rate, random)
    finally:
        model._window = None
    if window is not None:
        places = (np.array(window), np.array(model._around_camera()))
        moved = np.abs(places[1] - places[0])[:, 0] * model._steps / model._camera_pitches
        if moved.max() > MARGIN:
            warn(f"the alignment has changed by {moved.max():.0f} pixels of the camera: fit again", ConvergenceWarning)
    with torch.no_grad():
        squares = [data.residual(model, k).square().sum() for k in range(len(captures))]
    quality = float(sum(squares)) / max(data.count(), 1)
    scale = max(quality, 1.0) ** 0.5
    return DisplayFit(quality, {name: scale * value for name, value in uncertainties.items()}, history, data.noise)


def display_hologram(
    model: display_model,
    target: torch.Tensor,
    positions: Sequence[float] = (0.0,),
    *,
    iterations: int = 150,
    learning_rate: float = 0.1,
    phase: torch.Tensor | None = None,
    seed: int = 0,
    callback: Callable[[int, torch.Tensor], bool | None] | None = None,
) -> torch.Tensor:
    """Return the levels with which a display shows images, by gradient descent through its model.

    Parameters
    ----------
    model : display_model
        Model of the display.
    target : torch.Tensor
        Intensity at the pixels of the modulator, ``[rows, columns]`` for all positions or ``[positions, rows,
        columns]``.
    positions : sequence of float
        Positions of the stage in metres at which the images appear.
    iterations : int
        Number of Adam's steps.
    learning_rate : float
        Adam's step size in radians.
    phase : torch.Tensor, optional
        Phase to start from, ``[rows, columns]``; slowly varying noise by default.
    seed : int
        Seed of that noise.
    callback : callable, optional
        ``callback(iteration, loss)`` after each step, the loss being a tensor; returning True stops.

    Returns
    -------
    torch.Tensor
        uint8 or int32 levels ``[rows, columns]``. The squared error of s·image is minimised, where s is the best
        brightness, the same for all positions.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.wave import display_hologram, display_model
    >>> model = display_model([16, 16], 8e-6, 532e-9, 2e-3, [20, 24], 4e-6)
    >>> target = torch.zeros(16, 16)
    >>> target[4:12, 6:10] = 1
    >>> levels = display_hologram(model, target, iterations=20)
    >>> tuple(levels.shape), levels.dtype
    ((16, 16), torch.uint8)
    """
    (positions,) = _validate.constants(positions=positions)
    _validate.instance("model", model, display_model, "a display_model")
    places = [float(place) for place in _validate.several("positions", positions)]
    if not places:
        raise ValueError("positions must contain at least one position, got none")
    callback, seed = _validate.function_or_none("callback", callback), _validate.integer("seed", seed)
    target = torch.as_tensor(_numbers("target", target)).to(model._slope)
    if tuple(target.shape[-2:]) != model.shape or target.ndim > 3 or (target.ndim == 3 and len(target) != len(places)):
        raise ValueError(
            f"target must be {list(model.shape)}, or that for each of {len(places)} positions, got {list(target.shape)}"
        )
    target = target.expand(len(places), *model.shape)
    if phase is None:
        random = torch.Generator().manual_seed(seed)
        coarse = torch.randn((1, 1, *(max(n // 8, 2) for n in model.shape)), generator=random)
        phase = torch.nn.functional.interpolate(coarse, model.shape, mode="bicubic")[0, 0]
    phase = model._checked(tensor("phase", phase).to(model._slope.device)).detach().clone().requires_grad_()
    _validate.check_values("phase", phase)
    run = Run(iterations, False, callback)
    rate = _validate.constant("learning_rate", learning_rate, positive=True)
    turns = turns_of(model.table().detach())

    def loss(iteration):
        shown = model._quantised(phase, turns)
        images = torch.stack([model.image(shown, place) for place in places])
        return (best_scale(images.detach(), target, None) * images - target).square().mean()

    minimise({"phase": phase}, loss, rate, run, rising="")
    levels = model.levels(phase)
    return levels.to(torch.uint8 if len(model.table()) <= 256 else torch.int32)


def display_camera(
    model: display_model,
    modulator: SLMDriver,
    camera: Camera,
    *,
    captures: int = 1,
    dark: np.ndarray | float = 0.0,
) -> Callable[[torch.Tensor], torch.Tensor]:
    """Return a display with a camera as a function of the phase, for camera-in-the-loop optimisation.

    The function shows the levels that are nearest to a phase, captures, and brings the image onto the pixels of the
    modulator by the registration of the model. Give it as ``camera=`` to
    :func:`odak.learn.wave.stochastic_gradient_descent` or another optimizer.

    Parameters
    ----------
    model : display_model
        Model of the display.
    modulator : odak.instruments.SLMDriver
        The modulator.
    camera : odak.instruments.Camera
        The camera; its exposure is taken as it is.
    captures : int
        Number of captures that are averaged.
    dark : numpy.ndarray or float
        Counts without light.

    Returns
    -------
    callable
        ``function(phase)`` with a phase ``[rows, columns]`` returns the intensity ``[rows, columns]`` on the scale of
        :meth:`display_model.image`.

    Examples
    --------
    >>> import torch
    >>> from odak.instruments import SimulatedTable
    >>> from odak.learn.wave import display_camera, display_model
    >>> table = SimulatedTable(seed=1, shape=(16, 16), distance=2e-3, camera_shape=(24, 24))
    >>> model = display_model([16, 16], 8e-6, 532e-9, 2e-3, [24, 24], 4e-6)
    >>> capture = display_camera(model, table.modulator, table.camera)
    >>> tuple(capture(torch.zeros(16, 16)).shape)
    (16, 16)
    """
    (dark,) = _validate.constants(dark=dark)
    rows, columns = model.shape
    y, x = model._places(of_image=True)
    points = np.stack(np.meshgrid(x, y), axis=-1)
    places = model.registration().camera_pixels(points)
    scale = math.exp(-float(model.brightness.detach()))
    count = _validate.integer("captures", captures, minimum=1)
    checked = checked_camera(camera)

    def capture(phase: torch.Tensor) -> torch.Tensor:
        if tuple(phase.shape[-2:]) != model.shape or phase.numel() != rows * columns:
            raise ValueError(f"phase must be {list(model.shape)}, got {list(phase.shape)}")
        modulator.show(model.levels(phase.reshape(rows, columns)).cpu().numpy())
        counts = checked.capture(count).mean(0) - dark - float(model.offset.detach())
        image = map_coordinates(counts, [places[..., 1], places[..., 0]], order=3, mode="nearest")
        return torch.as_tensor(scale * image).to(phase).reshape(phase.shape)

    return capture


@dataclass(frozen=True)
class _Data:
    """Captures as tensors: patterns, means, standard deviations of the means (infinite where saturated)."""

    levels: torch.Tensor
    counts: torch.Tensor
    deviations: torch.Tensor
    positions: list[float]
    noise: tuple[float, float]

    @classmethod
    def of(cls, model: display_model, captures: Captures, noise: tuple[float, float]) -> "_Data":
        means = captures.means()
        # Expected rather than captured counts, by which pixels that are darker by chance would have larger weights.
        variance = (noise[0] * np.clip(means, 0, None) + noise[1]) / captures.frames.shape[1]
        saturated = captures.frames.max(1) >= 0.98 * ((1 << captures.camera_bits) - 1)
        deviations = np.where(saturated, np.inf, np.sqrt(variance))
        counts, spread = (torch.as_tensor(part).to(model._dtype).flatten(1) for part in (means, deviations))
        levels = torch.as_tensor(captures.levels.astype(np.int64))
        return cls(levels, counts, spread, captures.positions.tolist(), noise)

    def residual(self, model: Callable[..., Any], k: int, pixels: torch.Tensor | None = None) -> torch.Tensor:
        """Return the difference of the model from the mean of capture k, in standard deviations of its noise."""
        seen = model(self.levels[k], self.positions[k], pixels).flatten()
        chosen = slice(None) if pixels is None else pixels
        return (seen - self.counts[k, chosen]) / self.deviations[k, chosen]

    def count(self) -> int:
        return int(torch.isfinite(self.deviations).sum())


@torch.no_grad()
def _match_brightness(model: display_model, data: _Data, chosen: list[torch.Tensor]) -> None:
    """Set the overall scale of a model so that it fits the captures."""
    sums = []
    for k, pixels in enumerate(chosen):
        seen, weight = model(data.levels[k], data.positions[k], pixels), data.deviations[k, pixels] ** -2
        sums.append(torch.stack([(seen * data.counts[k, pixels] * weight).sum(), (seen.square() * weight).sum()]))
    above, below = torch.stack(sums).double().sum(0).tolist()
    if above > 0 and below > 0:
        model.brightness.add_(math.log(above / below))


def _fit_physical(model, data, chosen, iterations, chunk, random) -> tuple[list[float], dict[str, torch.Tensor]]:
    """Fit the physical parameters, and return chi squared after each step and the standard deviations.

    Derivatives by each parameter, which the Gauss-Newton matrix consists of, cost as many forward passes as there are
    parameters. The noise of pixels is independent, so that some thousands of them determine the matrix to some per
    cent: it comes from a few captures, and so do the squares and their gradient until they are nearly at their minimum.
    Then all captures give the gradient, in reverse mode.
    """
    fit = _PhysicalFit(model, data, chosen, chunk)
    names = fit.names
    order = torch.randperm(len(chosen), generator=random).tolist()
    few, several = order[: -(-CURVED // len(chosen[0]))], order[: max(CERTAIN, -(-CURVED // len(chosen[0])))]
    stages = [(names, 1e-3, few, few)] if len(few) < len(order) else []
    # The light of gaps is not determined before the other parameters are nearly correct.
    stages = [([name for name in names if name != "gap"], 0.03, few, few), *stages] if "gap" in names else stages
    for turn, (active, least, used, curved) in enumerate([*stages, (names, 1e-4, order, several)]):
        if "gap" in names and iterations and turn < 2:
            fit.match_gaps(few[0])
        certain = fit.descend(active, least, used, curved, iterations)
    with torch.no_grad():
        for name, part in zip(names, fit.vector.to(model._dtype).split(fit.sizes), strict=True):
            getattr(model, name).copy_(part)
    if not iterations:
        certain = fit.curvature(several, len(order) / len(several), names)
    deviations = torch.linalg.inv(certain).diagonal().clamp_min(0).sqrt().split(fit.sizes)
    return fit.history, dict(zip(names, deviations, strict=True))


class _PhysicalFit:
    """State of the fit of the physical parameters: their values `vector`, and chi squared after each step."""

    def __init__(self, model: display_model, data: _Data, chosen: list[torch.Tensor], chunk: int):
        self.model, self.data, self.chosen, self.chunk = model, data, chosen, chunk
        self.names: Sequence[str] = model.physical
        self.sizes = [getattr(model, name).numel() for name in self.names]
        self.begin = torch.cat([getattr(model, name).detach().flatten() for name in self.names]).double()
        weights = zip(self.names, self.sizes, strict=True)
        self.precision = torch.cat([torch.full((n,), model._priors[name] ** -2.0) for name, n in weights]).double()
        self.vector = self.begin.clone()
        self.history: list[float] = []

    def residuals(self, parts: Sequence[torch.Tensor], k: int) -> torch.Tensor:
        """Return the residuals of a capture for values of each parameter."""
        values = dict(zip(self.names, parts, strict=True))

        def seen(levels, position, pixels):
            return torch.func.functional_call(self.model, values, (levels, position, pixels))

        return self.data.residual(seen, k, self.chosen[k])

    def misfit(self, vector: torch.Tensor, used: Sequence[int]) -> tuple[float, torch.Tensor]:
        """Return the squares of residuals of some captures and of priors, and half their gradient."""
        apart = self.precision * (vector - self.begin)
        value, gradient = float((apart * (vector - self.begin)).sum()), apart
        for k in used:
            narrow = vector.to(self.model._dtype).requires_grad_()
            squares = self.residuals(narrow.split(self.sizes), k).double().square().sum()
            value += float(squares.detach())
            gradient = gradient + torch.autograd.grad(squares, narrow)[0].double() / 2
        return value, gradient

    def curvature(self, of: Sequence[int], scale: float, active: Sequence[str]) -> torch.Tensor:
        """Return the Gauss-Newton matrix of active parameters that some captures have, times a scale."""
        parts = self.vector.to(self.model._dtype).split(self.sizes)
        matrix = torch.zeros(len(self.vector), len(self.vector), dtype=torch.float64)
        with torch.no_grad():
            for k in of:
                slopes = torch.cat([self._columns(parts, k, which, active) for which in range(len(parts))])
                matrix += (slopes @ slopes.mT).double()
        return scale * matrix + self.precision.diag()

    def _columns(self, parts: Sequence[torch.Tensor], k: int, which: int, active: Sequence[str]) -> torch.Tensor:
        """Return derivatives by one parameter: what does not depend on it is not differentiated."""

        def seen(part):
            return self.residuals([*parts[:which], part, *parts[which + 1 :]], k)

        def along(direction):
            return forward_derivative(seen, parts[which], direction)[1]

        directions = torch.eye(self.sizes[which], dtype=self.model._dtype)
        if self.names[which] not in active:
            return directions.new_zeros(self.sizes[which], len(self.chosen[k]))
        return torch.cat([torch.func.vmap(along)(some) for some in directions.split(self.chunk)])

    @torch.no_grad()
    def match_gaps(self, k: int) -> None:
        """Set the width and the light of the gaps, among a few, that fit a capture best."""
        width, light = (sum(self.sizes[: self.names.index(name)]) for name in ("fill", "gap"))
        chosen = self.chosen[k]
        least, found, seen_there = math.inf, self.vector, self.data.counts[k, chosen] / self.data.deviations[k, chosen]
        for fill, gap in [(None, None), *itertools.product(FILLS, GAPS)]:
            tried = self.vector.clone()
            if fill is not None:
                tried[width], tried[light : light + 2] = fill, torch.tensor(gap)
            seen = self.residuals(tried.to(self.model._dtype).split(self.sizes), k) + seen_there
            scale = float((seen @ seen_there) / (seen @ seen))
            # Brightness is the first parameter.
            tried[0] += math.log(max(scale, 1e-3))
            if (square := float((scale * seen - seen_there).square().sum())) < least:
                least, found = square, tried
        self.vector = found

    def descend(self, active: Sequence[str], least: float, used, curved, iterations: int) -> torch.Tensor | None:
        """Take steps until they gain less than a share of the squares, and return the last Gauss-Newton matrix.

        Parameters
        ----------
        active : sequence of str
            Parameters that vary.
        least : float
            Smallest gain of a step as a share of the squares.
        used, curved : sequence of int
            Captures that give the squares and their gradient, and captures that give the matrix.
        iterations : int
            Largest number of steps.
        """
        sizes = zip(self.names, self.sizes, strict=True)
        moved = torch.cat([torch.full((n,), float(name in active)) for name, n in sizes])
        value, gradient = self.misfit(self.vector, used)
        number = sum(len(self.chosen[k]) for k in used)
        matrix, certain, damping, fresh, failures, steps = None, None, 1e-3, False, 0, 0
        self.history = self.history or [value / number]
        while steps < iterations and failures < 8:
            if matrix is None:
                matrix, fresh = self.curvature(curved, len(used) / len(curved), active), True
                certain = matrix
            step = torch.linalg.solve(matrix + damping * matrix.diagonal().diag(), moved * gradient)
            tried, slope = self.misfit(self.vector - step, used)
            if tried < value:
                promised, gain = float(gradient @ step), value - tried
                # A step that promises less than a tenth moves no parameter by its standard deviation.
                done = promised < 0.1 * max(value / number, 1.0) or gain < least * value
                updated = _updated(matrix, step, moved * (gradient - slope)) if gain > 0.8 * promised else None
                # Near the minimum the matrix hardly changes.
                matrix = matrix if updated is None and gain < 0.03 * value else updated
                damping = max(damping / 10, 1e-9) if gain > 0.7 * promised else damping
                self.vector, value, gradient = self.vector - step, tried, slope
                fresh, failures, steps = False, 0, steps + 1
                self.history.append(value / number)
                if done:
                    break
            elif fresh:
                # Short steps along slopes of this place lower the squares.
                damping, failures = 10 * damping, failures + 1
            else:
                matrix = None
        return certain


def _updated(matrix: torch.Tensor, step: torch.Tensor, change: torch.Tensor) -> torch.Tensor | None:
    """Return the matrix that maps a step to a change of the gradient (BFGS); None where it would not be positive."""
    along = matrix @ step
    if not float(change @ step) > 0.1 * float(along @ step):
        return None
    matrix = matrix - torch.outer(along, along) / (along @ step)
    return matrix + torch.outer(change, change) / (change @ step)


def _refine(model, data, passes, learning_rate, random) -> list[float]:
    """Fit the maps of free form and the network by Adam, and keep the best state."""
    maps = [] if model.free_maps is None else [model.free_maps]
    network = [] if model.residual is None else list(model.residual.parameters())
    groups = [{"params": part} for part in (maps, network) if part]

    def loss(model, k):
        return data.residual(model, k).square().mean()

    rest = [part for name in model.physical if (part := getattr(model, name)).requires_grad]
    for part in rest:
        part.requires_grad_(False)
    history = train(
        model,
        loss,
        torch.utils.data.RandomSampler(range(len(data.levels)), generator=random),
        passes,
        optimizer=lambda _: torch.optim.Adam(groups, learning_rate),
        scheduler=lambda optimizer: torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, passes),
        patience=passes,
        seed=random.initial_seed(),
        progress=False,
    ).training
    for part in rest:
        part.requires_grad_()
    if history[-1] > 2 * min(history):
        warn("the loss has risen since its best: give a smaller learning_rate", ConvergenceWarning)
    return history


class _residual(torch.nn.Sequential):
    """Small convolutional network whose output is zero at first."""

    def __init__(self, channels: int, dtype: torch.dtype):
        options: dict[str, Any] = {"padding": 1, "padding_mode": "replicate", "dtype": dtype}
        last = torch.nn.Conv2d(channels, 1, 3, **options)
        torch.nn.init.zeros_(last.weight)
        torch.nn.init.zeros_(last.bias)  # type: ignore[arg-type]
        super().__init__(
            torch.nn.Conv2d(1, channels, 3, **options),
            torch.nn.LeakyReLU(0.1),
            torch.nn.Conv2d(channels, channels, 3, **options),
            torch.nn.LeakyReLU(0.1),
            last,
        )


def _without(surfaces: torch.Tensor, low: torch.Tensor) -> torch.Tensor:
    """Return surfaces ``[n, rows, columns]`` without their components along others, of root mean square as before."""
    basis, _ = torch.linalg.qr(low.flatten(1).mT)
    flat = surfaces.flatten(1)
    return (flat - (flat @ basis) @ basis.mT).reshape(surfaces.shape)


def _numbers(name: str, values: Any) -> np.ndarray:
    """Return finite real numbers as a float64 array of NumPy."""
    values = tensor(name, values)
    if values.is_complex():
        raise TypeError(f"{name} must be real, got {values.dtype}")
    _validate.real(name, values)
    return values.detach().resolve_neg().cpu().double().numpy()


def _ending(shape: Sequence[int]) -> str:
    return f"[..., {shape[0]}, {shape[1]}]"


def _repeated(values: torch.Tensor, samples: int) -> torch.Tensor:
    """Return values of pixels on the samples of the pixels."""
    return values if samples == 1 else values.repeat_interleave(samples, -2).repeat_interleave(samples, -1)


def _averaged(light: torch.Tensor, sizes: Sequence[int], width: int) -> torch.Tensor:
    """Return an intensity averaged over squares of some samples' width, by the product of its spectrum."""
    over_rows = torch.sinc(width * torch.fft.fftfreq(sizes[0], dtype=light.dtype, device=light.device))
    over_columns = torch.sinc(width * torch.fft.rfftfreq(sizes[1], dtype=light.dtype, device=light.device))
    return torch.fft.irfft2(torch.fft.rfft2(light) * (over_rows[:, None] * over_columns), s=list(sizes))


def _fast(count: int) -> int:
    """Return the next number whose transform is fast: even, of factors 2, 3 and 5."""
    return 2 * int(next_fast_len(-(-count // 2), real=True))


def _zero_padded(spectrum: torch.Tensor, wanted: int, axis: int) -> torch.Tensor:
    """Return a spectrum with zeros at the frequencies that a finer grid has beyond its own along an axis."""
    have = spectrum.shape[axis]
    if have == wanted:
        return spectrum
    low, high = spectrum.narrow(axis, 0, have // 2), spectrum.narrow(axis, have // 2, have - have // 2)
    between = list(spectrum.shape)
    between[axis] = wanted - have
    return torch.cat([low, spectrum.new_zeros(between), high], axis)


def _cut(values: torch.Tensor, first: int, count: int, axis: int) -> torch.Tensor:
    """Return some periodic samples along an axis."""
    first %= values.shape[axis]
    beyond = first + count - values.shape[axis]
    if beyond <= 0:
        return values.narrow(axis, first, count)
    return torch.cat([values.narrow(axis, first, count - beyond), values.narrow(axis, 0, beyond)], axis)


def _spline_values(coefficients: torch.Tensor, y: torch.Tensor, x: torch.Tensor) -> torch.Tensor:
    """Return the values ``[..., points]`` of a periodic cubic spline whose coefficient [i, j] lies at y = i, x = j."""
    rows, columns = coefficients.shape[-2:]
    weights, indices = [], []
    for at, count in ((y, rows), (x, columns)):
        first = torch.floor(at.detach())
        t = at - first
        weights.append(torch.stack([(1 - t) ** 3, 3 * t**3 - 6 * t**2 + 4, -3 * t**3 + 3 * t**2 + 3 * t + 1, t**3]) / 6)
        indices.append(torch.stack([torch.remainder(first.long() + i, count) for i in range(-1, 3)]))
    place = indices[0][:, None] * columns + indices[1][None]
    return (coefficients.flatten(-2)[..., place] * (weights[0][:, None] * weights[1][None])).sum((-3, -2))
