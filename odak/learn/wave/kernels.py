"""Transfer functions as tensors, centred."""

from collections.abc import Sequence

import torch
from array_api_compat import torch as torch_namespace

from odak import _validate
from odak.learn._tensors import checked_device
from odak.wave import kernels
from odak.wave.propagation import sample_counts

_CPU = torch.device("cpu")


def _on_torch(*arguments, device, dtype):
    device = checked_device("device", device)
    return kernels.get_propagation_kernel(*arguments, xp=torch_namespace, device=device, dtype=dtype)


def get_propagation_kernel(
    nu: int,
    nv: int,
    dx: float | torch.Tensor = 8e-6,
    wavelength: float | torch.Tensor = 515e-9,
    distance: float | torch.Tensor = 0.0,
    device: torch.device = _CPU,
    propagation_type: str = "Bandlimited Angular Spectrum",
    scale: int = 1,
    samples: Sequence[int] = (20, 20, 5, 5),
    dtype: torch.dtype = torch.complex64,
) -> torch.Tensor:
    """Return the centred transfer function of a method, ``[nu·scale, nv·scale]``.

    Parameters
    ----------
    nu, nv : int
        Rows and columns.
    dx, wavelength, distance : float
        Pixel pitch, wavelength and distance in metres.
    device : torch.device
        Where the kernel is computed.
    propagation_type : str
        A method that has a transfer function.
    scale : int
        Samples per pixel, for the impulse-response methods.
    samples : sequence of int
        Points across the source pixel (rows, columns) and the target sample (rows, columns).
    dtype : torch.dtype
        complex64 or complex128.

    Returns
    -------
    torch.Tensor
        Zero frequency at index n // 2.

    Raises
    ------
    ValueError
        If the method has no transfer function, or an argument is outside its range.
    """
    return _on_torch(nu, nv, dx, wavelength, distance, propagation_type, scale, samples, device=device, dtype=dtype)


def get_angular_spectrum_kernel(
    nu: int,
    nv: int,
    dx: float | torch.Tensor = 8e-6,
    wavelength: float | torch.Tensor = 515e-9,
    distance: float | torch.Tensor = 0.0,
    device: torch.device | str = _CPU,
    dtype: torch.dtype = torch.complex64,
) -> torch.Tensor:
    """Return the centred angular-spectrum kernel; see :func:`get_propagation_kernel`."""
    return _on_torch(nu, nv, dx, wavelength, distance, "Angular Spectrum", device=device, dtype=dtype)


def get_band_limited_angular_spectrum_kernel(
    nu: int,
    nv: int,
    dx: float | torch.Tensor = 8e-6,
    wavelength: float | torch.Tensor = 515e-9,
    distance: float | torch.Tensor = 0.0,
    device: torch.device | str = _CPU,
    dtype: torch.dtype = torch.complex64,
) -> torch.Tensor:
    """Return the centred band-limited angular-spectrum kernel; see :func:`get_propagation_kernel`."""
    return _on_torch(nu, nv, dx, wavelength, distance, "Bandlimited Angular Spectrum", device=device, dtype=dtype)


def get_incoherent_angular_spectrum_kernel(
    nu: int,
    nv: int,
    dx: float | torch.Tensor = 8e-6,
    wavelength: float | torch.Tensor = 515e-9,
    distance: float | torch.Tensor = 0.0,
    device: torch.device | str = _CPU,
    dtype: torch.dtype = torch.complex64,
) -> torch.Tensor:
    """Return the centred optical transfer function of free space; see :func:`get_propagation_kernel`."""
    return _on_torch(nu, nv, dx, wavelength, distance, "Incoherent Angular Spectrum", device=device, dtype=dtype)


def get_transfer_function_fresnel_kernel(
    nu: int,
    nv: int,
    dx: float | torch.Tensor = 8e-6,
    wavelength: float | torch.Tensor = 515e-9,
    distance: float | torch.Tensor = 0.0,
    device: torch.device | str = _CPU,
    dtype: torch.dtype = torch.complex64,
) -> torch.Tensor:
    """Return the centred Fresnel transfer function; see :func:`get_propagation_kernel`."""
    return _on_torch(nu, nv, dx, wavelength, distance, "Transfer Function Fresnel", device=device, dtype=dtype)


def get_impulse_response_fresnel_kernel(
    nu: int,
    nv: int,
    dx: float | torch.Tensor = 8e-6,
    wavelength: float | torch.Tensor = 515e-9,
    distance: float | torch.Tensor = 0.0,
    device: torch.device | str = _CPU,
    scale: int = 1,
    aperture_samples: Sequence[int] = (20, 20, 5, 5),
    dtype: torch.dtype = torch.complex64,
) -> torch.Tensor:
    """Return the centred transform of the Fresnel impulse response; see :func:`get_propagation_kernel`."""
    return _on_torch(
        nu,
        nv,
        dx,
        wavelength,
        distance,
        "Impulse Response Fresnel",
        scale,
        sample_counts(aperture_samples, "aperture_samples"),
        device=device,
        dtype=dtype,
    )


def get_seperable_impulse_response_fresnel_kernel(
    nu: int,
    nv: int,
    dx: float | torch.Tensor = 3.74e-6,
    wavelength: float | torch.Tensor = 515e-9,
    distance: float | torch.Tensor = 0.0,
    scale: int = 1,
    aperture_samples: Sequence[int] = (50, 50, 5, 5),
    device: torch.device | str = _CPU,
    dtype: torch.dtype = torch.complex64,
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
    """Return the Fresnel kernel and its parts.

    Parameters are those of :func:`get_propagation_kernel`.

    Returns
    -------
    tuple of torch.Tensor
        Transfer function H and impulse response h, ``[nu·scale, nv·scale]``, and the factors h_x ``[nv·scale]`` and
        h_y ``[nu·scale]``, all centred; h = exp(ikz)/(iλz)·h_y·h_x.
    """
    for name, value in (("dx", dx), ("wavelength", wavelength), ("distance", distance)):
        if getattr(value, "ndim", 0) or isinstance(value, (list, tuple)):
            raise ValueError(f"{name} must be one number, got {value!r:.80}")
    if 0 in _validate.numbers(_validate.real("distance", distance)):
        raise ValueError("distance must not be zero for 'Seperable Impulse Response Fresnel'")
    samples, device = sample_counts(aperture_samples, "aperture_samples"), checked_device("device", device)
    grid = kernels.make_grid(
        nu, nv, dx, wavelength, distance, scale, samples, xp=torch_namespace, device=device, dtype=dtype
    )
    return kernels.separable_impulse_response(grid)
