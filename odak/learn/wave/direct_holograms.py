"""Holograms without iteration: point by point, and by double phase."""

import math

import torch

from odak import _validate
from odak._array import phasor
from odak.learn._precision import in_own_precision
from odak.learn._tensors import checked_device, floating, tensor
from odak.learn.wave.propagation import propagate_beam
from odak.learn.wave.util import generate_complex_field
from odak.wave.spectral import convolve


@torch.no_grad()
def point_wise(
    target: torch.Tensor, wavelength: float, distance: float, dx: float, device: torch.device, lens_size: int = 401
) -> torch.Tensor:
    """Return the hologram that focuses a lens on each lit pixel (Maimone, Georgiou and Kollin, ACM TOG 36, 85 (2017)).

    Parameters
    ----------
    target : torch.Tensor
        Intensity ``[..., rows, columns]``.
    wavelength : float
        Wavelength in metres.
    distance : float
        Distance from hologram to image in metres; each lens has this focal length.
    dx : float
        Pixel pitch in metres.
    device : torch.device
        Where to compute.
    lens_size : int
        Radius of each lens in pixels.

    Returns
    -------
    torch.Tensor
        Complex hologram ``[..., rows, columns]``.

    Raises
    ------
    ValueError, TypeError
        If an argument is outside its range, naming it.
    """
    target = _validate.image("target", tensor("target", target)).to(checked_device("device", device))
    device = target.device
    _validate.real("wavelength", wavelength, positive=True)
    _validate.real("distance", distance, nonzero=True)
    _validate.real("dx", dx, positive=True)
    radius = _validate.side("lens_size", lens_size)
    dtype = torch.complex128 if target.dtype == torch.float64 else torch.complex64
    y, x = (torch.fft.fftfreq(2 * n, 1 / (2 * n), dtype=torch.float64, device=device) for n in target.shape[-2:])
    squared = y[:, None] ** 2 + x[None, :] ** 2
    lens = phasor(-math.pi * dx**2 / (wavelength * distance) * squared, dtype) * (squared <= radius**2)
    return convolve(target.sqrt().to(dtype), torch.fft.fft2(lens))


def shift_w_double_phase(
    phase: torch.Tensor,
    depth_shift: float,
    pixel_pitch: float,
    wavelength: float,
    propagation_type: str = "Transfer Function Fresnel",
    kernel_length: int = 4,
    sigma: float = 0.5,
    amplitude: torch.Tensor | None = None,
) -> torch.Tensor:
    """Return a phase-only hologram shifted in depth, its amplitude encoded by double phase.

    Parameters
    ----------
    phase : torch.Tensor
        Phase ``[rows, columns]`` in radians.
    depth_shift : float
        Distance to move by, in metres.
    pixel_pitch, wavelength : float
        In metres.
    propagation_type : str
        Propagation type, see :func:`odak.learn.wave.propagate_beam`.
    kernel_length : int
        Length in pixels of the Gaussian that smooths the field before encoding, taken to the next odd number; 0 for
        none.
    sigma : float
        Its standard deviation in pixels.
    amplitude : torch.Tensor, optional
        Amplitude of the field; ones by default.

    Returns
    -------
    torch.Tensor
        Phase ``[rows, columns]``: φ − arccos(a) where row and column are both even or both odd, φ + arccos(a)
        elsewhere.

    Notes
    -----
    Shi, Li, Kim, Kellnhofer and Matusik, Nature 591, 234 (2021); Hsueh and Sawchuk, Appl. Opt. 17, 3874 (1978).
    """
    phase = _validate.image("phase", floating("phase", phase))
    _validate.real("depth_shift", depth_shift)
    _validate.real("pixel_pitch", pixel_pitch, positive=True)
    kernel_length, sigma = _validate.whole("kernel_length", kernel_length), _validate.real("sigma", sigma)
    field = generate_complex_field(torch.ones_like(phase) if amplitude is None else amplitude, phase)
    field = propagate_beam(field, None, depth_shift, pixel_pitch, wavelength, propagation_type)
    carrier = torch.tensor(-2 * math.pi * (depth_shift / wavelength % 1), dtype=torch.float64, device=phase.device)
    field = field * phasor(carrier, field.dtype)
    if kernel_length > 0 and sigma > 0:
        field = _blur(field, kernel_length, sigma)
    return encode_double_phase(field)


def encode_double_phase(field: torch.Tensor) -> torch.Tensor:
    """Return the checkerboard phase whose neighbours average to a field (Hsueh and Sawchuk 1978).

    Parameters
    ----------
    field : torch.Tensor
        Complex ``[..., rows, columns]``; the amplitude is divided by its maximum.

    Returns
    -------
    torch.Tensor
        Phase in radians, of zero mean before the ± arccos(amplitude) is added.
    """
    amplitude = field.abs()
    amplitude = amplitude / amplitude.amax(dim=(-2, -1), keepdim=True).clamp_min(torch.finfo(amplitude.dtype).tiny)
    phase = field.angle()
    phase = phase - phase.mean(dim=(-2, -1), keepdim=True)
    # The slope of arccos is infinite at one, where the brightest pixel is: it takes none, and spoils no other's.
    dimmer = amplitude < 1
    offset = torch.where(dimmer, torch.arccos(torch.where(dimmer, amplitude, 0)), 0)
    rows, columns = (torch.arange(n, device=field.device) for n in field.shape[-2:])
    sign = 1 - 2 * ((rows[:, None] + columns[None, :] + 1) % 2)
    return phase + sign * offset


@in_own_precision
def _blur(field, length, sigma):
    """Return the field smoothed by a Gaussian of unit sum, real and imaginary parts alike."""
    half = length // 2
    line = torch.exp(-0.5 * (torch.arange(-half, half + 1, device=field.device) / sigma) ** 2)
    kernel = (line[:, None] * line[None, :] / line.sum() ** 2).to(field.real.dtype)[None, None]
    parts = torch.view_as_real(field).movedim(-1, 0)
    smooth = torch.nn.functional.conv2d(parts.reshape(-1, 1, *field.shape[-2:]), kernel, padding="same")
    return torch.view_as_complex(smooth.reshape(parts.shape).movedim(0, -1).contiguous())
