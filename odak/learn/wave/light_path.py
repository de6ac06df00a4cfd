"""Transfer functions from a modulator to the planes of a volume, for every plane and colour."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import torch

from odak import _array, _validate
from odak.learn._tensors import tensor
from odak.wave import transfer_functions
from odak.wave.methods import METHODS, choose_method, find_method, warn_outside_range
from odak.wave.request import Request

PROPAGATOR_TYPES = ("forward", "back and forth")
_SUITED = tuple(method.name for method in METHODS if method.kernel and method.name != "Incoherent Angular Spectrum")


@dataclass(frozen=True)
class LightPath:
    """How light gets from the modulator to the planes.

    Attributes
    ----------
    pitch : float
        Sample pitch on the modulator in metres.
    propagation_type : str
        Name of a method that has a transfer function.
    relay : float, optional
        Distance in metres to the relay that light goes to and comes back from; None for the straight way.
    scale : int
        Samples per pitch along each axis (impulse-response methods).
    samples : tuple of int
        Points across the source and target apertures of the impulse responses.
    """

    pitch: float
    propagation_type: str
    relay: float | None
    scale: int
    samples: tuple[int, int, int, int]

    def kernel(self, shape: Sequence[int], wavelength, distance, device, dtype) -> torch.Tensor:
        """Return the transfer function of one plane and colour in FFT order.

        Parameters
        ----------
        shape : tuple of int
            Rows and columns of the padded grid.
        wavelength, distance : float or torch.Tensor
            In metres; the result is differentiable in tensors.
        device, dtype
            Of the result.

        Returns
        -------
        torch.Tensor
            Complex ``[rows, columns]``.
        """
        method = find_method(self.propagation_type)
        # The name comes from suited_method: neither "auto" nor a method without a transfer function.
        build: Any = method and method.kernel
        if self.relay is None:
            return build(self._grid(shape, wavelength, distance, device, dtype))
        # One phase in float64 for the way there and back: two of 10⁶ rad each would cancel only after rounding.
        whole = self._grid(shape, wavelength, distance, device, dtype)
        legs = [self._grid(shape, wavelength, z, device, dtype) for z in (self.relay, distance - self.relay)]
        if build is transfer_functions.band_limited_angular_spectrum:
            return build(whole, [leg.distance for leg in legs])
        if build is transfer_functions.impulse_response_fresnel:
            return build(legs[0]) * build(legs[1])
        return build(whole)

    def _grid(self, shape, wavelength, distance, device, dtype):
        request = Request(self.pitch, wavelength, distance, scale=self.scale, samples=self.samples)
        return request.grid(shape, _array.namespace(torch.empty(0)), device, dtype)


def fill(kernels: torch.Tensor, path: LightPath, wavelengths, distances) -> torch.Tensor:
    """Write the transfer function of every plane and colour into ``kernels [planes, colours, rows, columns]``."""
    shape = tuple(kernels.shape[-2:])
    for plane, distance in enumerate(distances):
        for colour, wavelength in enumerate(wavelengths):
            kernels[plane, colour] = path.kernel(shape, wavelength, distance, kernels.device, kernels.dtype)
    return kernels


def stack(path: LightPath, shape, wavelengths, distances, device, dtype) -> torch.Tensor:
    """Return what :func:`fill` writes as a new tensor, differentiable in distances and wavelengths."""
    return torch.stack(
        [
            torch.stack([path.kernel(shape, wavelength, distance, device, dtype) for wavelength in wavelengths])
            for distance in distances
        ]
    )


def suited_method(propagation_type: str, shape, pitch: float, wavelengths, distances) -> str:
    """Return the full name of a propagation type that a volume can be computed with.

    Parameters
    ----------
    propagation_type : str
        Name, alias or "auto".
    shape : tuple of int
        Rows and columns of the field.
    pitch : float
        Its pitch in metres.
    wavelengths, distances : list of float
        In metres.

    Returns
    -------
    str
        Name of the method.

    Raises
    ------
    ValueError
        If the name is not known, or its method has no transfer function.
    """
    method: Any = find_method(propagation_type)
    request = Request(pitch, wavelengths, distances)
    if method is None:
        method = choose_method(shape, request, padded=True)
        method = method if method.name in _SUITED else find_method("Bandlimited Angular Spectrum")
    if method.name not in _SUITED:
        raise ValueError(
            f"propagation_type must be one of {', '.join(map(repr, _SUITED))} or 'auto', got {propagation_type!r}"
        )
    warn_outside_range(method, shape, request, padded=True)
    return method.name


def plane_distances(distances, volume_depth: float, count: int, offset: float) -> torch.Tensor:
    """Return the distances given, or those of `count` planes that divide a volume evenly about its centre.

    Parameters
    ----------
    distances : torch.Tensor or sequence of float, optional
        Distances in metres.
    volume_depth : float
        Distance from the first plane to the last.
    count : int
        Number of planes.
    offset : float
        Distance of the volume's centre, where a single plane lies.

    Returns
    -------
    torch.Tensor
        float64 ``[planes]``.
    """
    if distances is not None:
        given = tensor("distances", distances, torch.float64).reshape(-1)
        _validate.real("distances", given)
        if not len(given):
            raise ValueError("distances must hold at least one distance, got none")
        return given
    _validate.real("volume_depth", volume_depth)
    _validate.real("image_location_offset", offset)
    half = volume_depth / 2 if count > 1 else 0.0
    return torch.linspace(-half, half, count, dtype=torch.float64) + offset
