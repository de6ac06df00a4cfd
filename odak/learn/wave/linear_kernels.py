"""Propagation of fields to their own window without wrap-around: transfer functions of linear convolution.

A transfer function sampled on the grid of a field that is padded to twice its size makes a circular convolution: its
impulse response is longer than the grid, and what leaves the grid on one side comes in on the other. At the critical
distance N·dx²/λ this is 2 % of a field of random phase, so that an optimizer claims decibels that no display shows.
Here the transfer function is sampled several times finer, its impulse response cut to the lags that connect two points
of the window, and transformed back to the doubled grid. The propagation itself costs what it did.
"""

import math
from dataclasses import dataclass, fields
from typing import Any

import torch

from odak import _array, _validate
from odak._warnings import SamplingWarning, warn
from odak.learn.wave.convolution import convolve
from odak.learn.wave.propagation import propagate_beam
from odak.wave.methods import METHODS, check_has_kernel, find_method, method_named, warn_outside_range
from odak.wave.sampling import PARAXIAL_TOLERANCE, sampling_report
from odak.wave.transfer_functions import Grid, Request

# The residual wrap-around falls with the square of the fine grid and the root of the window.
_REFINEMENTS = ((256, 8), (1024, 4), (math.inf, 2))
_SLAB = 1 << 21
# Band limitation avoids wrap-around, which linear convolution does not have.
_UNLIMITED = {"Bandlimited Angular Spectrum": "Angular Spectrum"}
WITH_TRANSFER_FUNCTION = tuple(m.name for m in METHODS if m.kernel and m.windowed and not m.of_intensities)


@dataclass(frozen=True)
class LinearGrid(Grid):
    """Grid of twice a window's size, on which transfer functions are those of linear convolution.

    Attributes
    ----------
    cutoff : float, optional
        Radius of a round stop in the Fourier plane in cycles per metre; None for an open one.
    pixel_fill : float, optional
        Share of a square pixel's area that emits; None for fields that are point samples.
    """

    cutoff: Any = None
    pixel_fill: Any = None

    def evaluate(self, kernel):
        """Return the transfer function whose circular convolution on this grid is the linear one on the window."""
        rows, columns = (n // 2 for n in self.shape)
        fine = [next(f for most, f in _REFINEMENTS if n // 2 < most) * n for n in self.shape]
        fy, fx = (self._indices(n, axis) / (n * self.pitch[axis]) for axis, n in enumerate(fine))
        # Frequencies whose kernel is undersampled on the fine grid too leave the window (Matsushima, Shimobaba 2009).
        widths = [n * pitch for n, pitch in zip(fine, self.pitch, strict=True)]
        limit_y, limit_x = (1 / (self.wavelength * ((2 * self.distance / width) ** 2 + 1).sqrt()) for width in widths)
        step = max(1, _SLAB // fx.shape[-1])
        lines = []
        for start in range(0, fy.shape[-2], step):
            part = fy[..., start : start + step, :]
            squared = part**2 + fx**2
            # Evanescent waves have no phase that could alias.
            kept = ((part <= limit_y) & (fx <= limit_x)) | (squared * self.wavelength**2 >= 1)
            if self.cutoff is not None:
                kept = kept & (squared <= self.cutoff**2)
            spectrum = kernel(part, fx)
            if self.pixel_fill is not None:
                height, width = (pitch * math.sqrt(self.pixel_fill) for pitch in self.pitch)
                spectrum = spectrum * (torch.sinc(height * part) * torch.sinc(width * fx)).to(spectrum.real.dtype)
            lines.append(_response(torch.where(kept, spectrum, 0), fine[1], -1, columns))
        response = _response(torch.cat(lines, -2), fine[0], -2, rows)
        return self.unfold(_spectrum(_spectrum(response, columns, -1), rows, -2))


def _response(half, count: int, axis: int, lags: int):
    """Return the first lags of the inverse transform of an even spectrum of `count` samples, given by its half."""
    indices = torch.arange(count, device=half.device)
    return torch.fft.ifft(half.index_select(axis, torch.minimum(indices, count - indices)), dim=axis).narrow(
        axis, 0, lags
    )


def _spectrum(lags, count: int, axis: int):
    """Return the non-negative half of the transform of an even response of lags below `count`, on 2·count samples."""
    whole = torch.cat(
        [lags, torch.zeros_like(lags.narrow(axis, 0, 1)), lags.narrow(axis, 1, count - 1).flip(axis)], axis
    )
    return torch.fft.fft(whole, dim=axis).narrow(axis, 0, count + 1)


def linear_grid(grid: Grid, cutoff: float | None = None, pixel_fill: float | None = None) -> LinearGrid:
    """Return the grid on which transfer functions are those of linear convolution, of the shape of a padded `grid`."""
    own = {field.name: getattr(grid, field.name) for field in fields(Grid)}
    return LinearGrid(**own, cutoff=cutoff, pixel_fill=pixel_fill)


@dataclass(frozen=True)
class linear_kernel:
    """Function of a grid that gives a method's transfer function of linear convolution.

    Methods that sample their impulse response are linear convolutions already; to them neither stop nor pixel applies.
    Functions of equal attributes are equal, so that stored kernels are found by them.

    Attributes
    ----------
    propagation_type : str
        Name of a method with a transfer function.
    cutoff : float, optional
        Radius of a round stop in the Fourier plane in cycles per metre; open by default.
    pixel_fill : float, optional
        Share of a square pixel's area that emits: the spectrum is multiplied by that of the pixel, 1 at zero
        frequency. Fields are point samples by default.
    """

    propagation_type: str
    cutoff: float | None = None
    pixel_fill: float | None = None

    def __call__(self, grid: Grid):
        """Return the transfer function on a padded grid."""
        method = method_named(_UNLIMITED.get(self.propagation_type, self.propagation_type))
        return method.kernel(linear_grid(grid, self.cutoff, self.pixel_fill))  # type: ignore[misc]


def propagate_within_window(
    field, distance, dx, wavelength, propagation_type: str, cutoff: float | None = None, pixel_fill: float | None = None
) -> torch.Tensor:
    """Return a field propagated to its own window, without wrap-around where the method has a transfer function.

    Parameters
    ----------
    field : torch.Tensor
        Complex ``[..., rows, columns]``.
    distance : float or torch.Tensor
        Distance in metres.
    dx : float or torch.Tensor
        Pitch of the field in metres.
    wavelength : float or torch.Tensor
        Wavelength in metres.
    propagation_type : str
        Propagation type, see :func:`odak.learn.wave.propagate_beam`, or "auto".
    cutoff : float, optional
        Radius of a round stop in the Fourier plane in cycles per metre; open by default.
    pixel_fill : float, optional
        Share of a square pixel's area that emits; point samples by default.

    Returns
    -------
    torch.Tensor
        Complex ``[..., rows, columns]``.
    """
    shape = tuple(field.shape[-2:])
    name = linear_method(propagation_type, shape, dx, wavelength, distance)
    if name not in WITH_TRANSFER_FUNCTION:
        if cutoff is not None or pixel_fill is not None:
            raise ValueError(f"propagation_type must have a transfer function for an iris or pixels, got {name!r}")
        return propagate_beam(field, None, distance, dx, wavelength, name)
    build = linear_kernel(name, cutoff, pixel_fill)
    return convolve(field, Request(dx, wavelength, distance).kernel_for(field, build, _doubled(shape)))


def _doubled(shape):
    return tuple(2 * n for n in shape)


def linear_method(propagation_type: str, shape, dx, wavelength, distance, relayed: bool = False) -> str:
    """Return the full name of a propagation type, with a SamplingWarning where it is used outside its range.

    Without wrap-around the angular spectrum is exact at any distance: it is what "auto" stands for, and of the other
    transfer functions the paraxial approximation is all that limits them.

    Parameters
    ----------
    propagation_type : str
        Name, alias or "auto"; not "custom".
    shape : tuple of int
        Rows and columns of the field.
    dx : float
        Its pitch in metres.
    wavelength : float or list of float
        Wavelengths in metres.
    distance : float or list of float
        Distances in metres.
    relayed : bool
        Impulse responses are computed by their transfer function, so that they have no shortest distance.

    Raises
    ------
    ValueError
        If the name is not known, or is "custom".
    """
    check_has_kernel(propagation_type)
    method = find_method(propagation_type) or method_named("Angular Spectrum")
    request = Request(dx, wavelength, distance)
    if method.name == "Transfer Function Fresnel" or (relayed and method.scalable):
        if all(_array.is_readable(value) for value in (dx, wavelength, distance)):
            pitch, longest, furthest = (max(map(abs, _validate.numbers(value))) for value in (dx, wavelength, distance))
            error = sampling_report(shape, pitch, longest, furthest, True).paraxial_error
            if error > PARAXIAL_TOLERANCE:
                warn(f"{method.name}: the paraxial phase is off by up to {error:.2g} wavelengths", SamplingWarning)
    elif method.name not in ("Angular Spectrum", "Bandlimited Angular Spectrum"):
        warn_outside_range(method, shape, request, padded=True)
    return method.name
