"""Centred transfer functions as tensors, light kernels for learned models, and the Fresnel field of free points."""

import math
from collections.abc import Sequence
from numbers import Real

import torch
from array_api_compat import torch as torch_namespace

from odak import _validate
from odak._array import phasor
from odak.learn._tensors import checked_device, checked_generator, floating, tensor
from odak.wave import propagation, transfer_functions
from odak.wave.methods import find_method
from odak.wave.propagation import sample_counts

_CPU = torch.device("cpu")
_CHUNK_BYTES = 1 << 27


def _on_torch(*arguments, device, dtype):
    device = checked_device("device", device)
    return propagation.get_propagation_kernel(*arguments, xp=torch_namespace, device=device, dtype=dtype)


@_validate.takes_units("dx", "wavelength", "distance")
def get_propagation_kernel(
    nu: int,
    nv: int,
    dx: float | Sequence[float] | torch.Tensor = 8e-6,
    wavelength: float | torch.Tensor = 515e-9,
    distance: float | torch.Tensor = 0.0,
    device: torch.device = _CPU,
    propagation_type: str = "Bandlimited Angular Spectrum",
    scale: int = 1,
    samples: Sequence[int] = (20, 20, 5, 5),
    dtype: torch.dtype = torch.complex64,
) -> torch.Tensor:
    """Return the centred transfer function of a method.

    Parameters
    ----------
    nu : int
        Rows.
    nv : int
        Columns.
    dx : float, pair of float or torch.Tensor, default: 8e-6
        Pixel pitch in metres, one number or a pair (rows, columns).
    wavelength : float or torch.Tensor, default: 515e-9
        Wavelength in metres.
    distance : float or torch.Tensor, default: 0.0
        Propagation distance in metres.
    device : torch.device or str, default: "cpu"
        Where the kernel is computed.
    propagation_type : str, default: "Bandlimited Angular Spectrum"
        A method that has a transfer function.
    scale : int, default: 1
        Samples per pixel, for the impulse-response methods; 1 for the others.
    samples : sequence of int, default: (20, 20, 5, 5)
        Points across the source pixel (rows, columns) and the target sample (rows, columns).
    dtype : torch.dtype, default: torch.complex64
        complex64 or complex128.

    Returns
    -------
    torch.Tensor
        Complex ``[nu·scale, nv·scale]``, zero frequency at index n // 2; differentiable in lengths that are tensors.

    Raises
    ------
    ValueError
        If the method has no transfer function, or an argument is outside its range.

    See Also
    --------
    odak.learn.wave.propagate_beam : The successor: propagates a field by a method of that name, or by the best one.

    Examples
    --------
    Free space delays a plane wave along the axis by 2πz/λ, here by a quarter of a cycle:

    >>> import torch
    >>> from odak.learn.wave import get_propagation_kernel
    >>> kernel = get_propagation_kernel(8, 8, 8e-6, 500e-9, 1.25e-7, propagation_type="Angular Spectrum")
    >>> round(kernel[4, 4].imag.item(), 6)
    1.0
    """
    return _on_torch(nu, nv, dx, wavelength, distance, propagation_type, scale, samples, device=device, dtype=dtype)


@_validate.takes_units("dx", "wavelength", "distance")
def get_angular_spectrum_kernel(
    nu: int,
    nv: int,
    dx: float | Sequence[float] | torch.Tensor = 8e-6,
    wavelength: float | torch.Tensor = 515e-9,
    distance: float | torch.Tensor = 0.0,
    device: torch.device | str = _CPU,
    dtype: torch.dtype = torch.complex64,
) -> torch.Tensor:
    """Return the centred transfer function of the angular spectrum.

    Parameters
    ----------
    nu : int
        Rows.
    nv : int
        Columns.
    dx : float, pair of float or torch.Tensor, default: 8e-6
        Pixel pitch in metres, one number or a pair (rows, columns).
    wavelength : float or torch.Tensor, default: 515e-9
        Wavelength in metres.
    distance : float or torch.Tensor, default: 0.0
        Propagation distance in metres.
    device : torch.device or str, default: "cpu"
        Where the kernel is computed.
    dtype : torch.dtype, default: torch.complex64
        complex64 or complex128.

    Returns
    -------
    torch.Tensor
        Complex ``[nu, nv]``, zero frequency at index n // 2; differentiable in lengths that are tensors.

    See Also
    --------
    odak.learn.wave.propagate_beam : The successor: propagates a field by a method of that name, or by the best one.

    Examples
    --------
    On the axis its phase is 2πz/λ, here a quarter of a cycle:

    >>> import torch
    >>> from odak.learn.wave import get_angular_spectrum_kernel
    >>> kernel = get_angular_spectrum_kernel(8, 8, 8e-6, 500e-9, 1.25e-7)
    >>> round(kernel[4, 4].imag.item(), 6)
    1.0
    """
    return _on_torch(nu, nv, dx, wavelength, distance, "Angular Spectrum", device=device, dtype=dtype)


@_validate.takes_units("dx", "wavelength", "distance")
def get_band_limited_angular_spectrum_kernel(
    nu: int,
    nv: int,
    dx: float | Sequence[float] | torch.Tensor = 8e-6,
    wavelength: float | torch.Tensor = 515e-9,
    distance: float | torch.Tensor = 0.0,
    device: torch.device | str = _CPU,
    dtype: torch.dtype = torch.complex64,
) -> torch.Tensor:
    """Return the centred transfer function of the band-limited angular spectrum.

    Parameters
    ----------
    nu : int
        Rows.
    nv : int
        Columns.
    dx : float, pair of float or torch.Tensor, default: 8e-6
        Pixel pitch in metres, one number or a pair (rows, columns).
    wavelength : float or torch.Tensor, default: 515e-9
        Wavelength in metres.
    distance : float or torch.Tensor, default: 0.0
        Propagation distance in metres.
    device : torch.device or str, default: "cpu"
        Where the kernel is computed.
    dtype : torch.dtype, default: torch.complex64
        complex64 or complex128.

    Returns
    -------
    torch.Tensor
        Complex ``[nu, nv]``, zero frequency at index n // 2; differentiable in lengths that are tensors.

    See Also
    --------
    odak.learn.wave.propagate_beam : The successor: propagates a field by a method of that name, or by the best one.

    Examples
    --------
    On the axis its phase is 2πz/λ, here a quarter of a cycle:

    >>> import torch
    >>> from odak.learn.wave import get_band_limited_angular_spectrum_kernel
    >>> kernel = get_band_limited_angular_spectrum_kernel(8, 8, 8e-6, 500e-9, 1.25e-7)
    >>> round(kernel[4, 4].imag.item(), 6)
    1.0
    """
    return _on_torch(nu, nv, dx, wavelength, distance, "Bandlimited Angular Spectrum", device=device, dtype=dtype)


@_validate.takes_units("dx", "wavelength", "distance")
def get_incoherent_angular_spectrum_kernel(
    nu: int,
    nv: int,
    dx: float | Sequence[float] | torch.Tensor = 8e-6,
    wavelength: float | torch.Tensor = 515e-9,
    distance: float | torch.Tensor = 0.0,
    device: torch.device | str = _CPU,
    dtype: torch.dtype = torch.complex64,
) -> torch.Tensor:
    """Return the centred optical transfer function of free space.

    Parameters
    ----------
    nu : int
        Rows.
    nv : int
        Columns.
    dx : float, pair of float or torch.Tensor, default: 8e-6
        Pixel pitch in metres, one number or a pair (rows, columns).
    wavelength : float or torch.Tensor, default: 515e-9
        Wavelength in metres.
    distance : float or torch.Tensor, default: 0.0
        Propagation distance in metres.
    device : torch.device or str, default: "cpu"
        Where the kernel is computed.
    dtype : torch.dtype, default: torch.complex64
        complex64 or complex128.

    Returns
    -------
    torch.Tensor
        Complex ``[nu, nv]``, zero frequency at index n // 2; differentiable in lengths that are tensors.

    See Also
    --------
    odak.learn.wave.propagate_beam : The successor: propagates a field by a method of that name, or by the best one.

    Examples
    --------
    It is 1 at zero frequency, so that the sum of an intensity is kept:

    >>> import torch
    >>> from odak.learn.wave import get_incoherent_angular_spectrum_kernel
    >>> kernel = get_incoherent_angular_spectrum_kernel(8, 8, 8e-6, 500e-9, 1e-3)
    >>> round(kernel[4, 4].real.item(), 6)
    1.0
    """
    return _on_torch(nu, nv, dx, wavelength, distance, "Incoherent Angular Spectrum", device=device, dtype=dtype)


@_validate.takes_units("dx", "wavelength", "distance")
def get_transfer_function_fresnel_kernel(
    nu: int,
    nv: int,
    dx: float | Sequence[float] | torch.Tensor = 8e-6,
    wavelength: float | torch.Tensor = 515e-9,
    distance: float | torch.Tensor = 0.0,
    device: torch.device | str = _CPU,
    dtype: torch.dtype = torch.complex64,
) -> torch.Tensor:
    """Return the centred Fresnel transfer function.

    Parameters
    ----------
    nu : int
        Rows.
    nv : int
        Columns.
    dx : float, pair of float or torch.Tensor, default: 8e-6
        Pixel pitch in metres, one number or a pair (rows, columns).
    wavelength : float or torch.Tensor, default: 515e-9
        Wavelength in metres.
    distance : float or torch.Tensor, default: 0.0
        Propagation distance in metres.
    device : torch.device or str, default: "cpu"
        Where the kernel is computed.
    dtype : torch.dtype, default: torch.complex64
        complex64 or complex128.

    Returns
    -------
    torch.Tensor
        Complex ``[nu, nv]``, zero frequency at index n // 2; differentiable in lengths that are tensors.

    See Also
    --------
    odak.learn.wave.propagate_beam : The successor: propagates a field by a method of that name, or by the best one.

    Examples
    --------
    On the axis its phase is 2πz/λ, here a quarter of a cycle:

    >>> import torch
    >>> from odak.learn.wave import get_transfer_function_fresnel_kernel
    >>> kernel = get_transfer_function_fresnel_kernel(8, 8, 8e-6, 500e-9, 1.25e-7)
    >>> round(kernel[4, 4].imag.item(), 6)
    1.0
    """
    return _on_torch(nu, nv, dx, wavelength, distance, "Transfer Function Fresnel", device=device, dtype=dtype)


@_validate.takes_units("dx", "wavelength", "distance")
def get_impulse_response_fresnel_kernel(
    nu: int,
    nv: int,
    dx: float | Sequence[float] | torch.Tensor = 8e-6,
    wavelength: float | torch.Tensor = 515e-9,
    distance: float | torch.Tensor = 0.0,
    device: torch.device | str = _CPU,
    scale: int = 1,
    aperture_samples: Sequence[int] = (20, 20, 5, 5),
    dtype: torch.dtype = torch.complex64,
) -> torch.Tensor:
    """Return the centred transform of the sampled Fresnel impulse response.

    Parameters
    ----------
    nu : int
        Rows.
    nv : int
        Columns.
    dx : float, pair of float or torch.Tensor, default: 8e-6
        Pixel pitch in metres, one number or a pair (rows, columns).
    wavelength : float or torch.Tensor, default: 515e-9
        Wavelength in metres.
    distance : float or torch.Tensor, default: 0.0
        Propagation distance in metres.
    device : torch.device or str, default: "cpu"
        Where the kernel is computed.
    scale : int, default: 1
        Samples per pixel and axis.
    aperture_samples : sequence of int, default: (20, 20, 5, 5)
        Points across the source pixel (rows, columns) and the target sample (rows, columns).
    dtype : torch.dtype, default: torch.complex64
        complex64 or complex128.

    Returns
    -------
    torch.Tensor
        Complex ``[nu·scale, nv·scale]``, zero frequency at index n // 2; differentiable in lengths that are tensors.

    See Also
    --------
    odak.learn.wave.propagate_beam : The successor: propagates a field by a method of that name, or by the best one.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.wave import get_impulse_response_fresnel_kernel
    >>> tuple(get_impulse_response_fresnel_kernel(8, 6, 8e-6, 500e-9, 0.01, scale=2).shape)
    (16, 12)
    """
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


@_validate.takes_units("dx", "wavelength", "distance")
def get_seperable_impulse_response_fresnel_kernel(
    nu: int,
    nv: int,
    dx: float | Sequence[float] | torch.Tensor = 3.74e-6,
    wavelength: float | torch.Tensor = 515e-9,
    distance: float | torch.Tensor = 0.0,
    scale: int = 1,
    aperture_samples: Sequence[int] = (50, 50, 5, 5),
    device: torch.device | str = _CPU,
    dtype: torch.dtype = torch.complex64,
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
    """Return the Fresnel kernel and its separable factors.

    Parameters
    ----------
    nu : int
        Rows.
    nv : int
        Columns.
    dx : float, pair of float or torch.Tensor, default: 3.74e-6
        Pixel pitch in metres, one number or a pair (rows, columns).
    wavelength : float or torch.Tensor, default: 515e-9
        Wavelength in metres.
    distance : float or torch.Tensor, default: 0.0
        Propagation distance in metres.
    scale : int, default: 1
        Samples per pixel and axis.
    aperture_samples : sequence of int, default: (50, 50, 5, 5)
        Points across the source pixel (rows, columns) and the target sample (rows, columns).
    device : torch.device or str, default: "cpu"
        Where the kernel is computed.
    dtype : torch.dtype, default: torch.complex64
        complex64 or complex128.

    Returns
    -------
    tuple of torch.Tensor
        Transfer function H and impulse response h, ``[nu·scale, nv·scale]``, and the factors h_x ``[nv·scale]`` and
        h_y ``[nu·scale]``, all centred; h = exp(ikz)/(iλz)·h_y·h_x.

    See Also
    --------
    odak.learn.wave.propagate_beam : The successor: propagates a field by a method of that name, or by the best one.

    Examples
    --------
    The impulse response is the product of its factors, times a constant:

    >>> import torch
    >>> from odak.learn.wave import get_seperable_impulse_response_fresnel_kernel
    >>> H, h, h_x, h_y = get_seperable_impulse_response_fresnel_kernel(8, 8, 8e-6, 500e-9, 0.01)
    >>> ratio = h / (h_y[:, None] * h_x)
    >>> bool((ratio / ratio[0, 0] - 1).abs().max() < 1e-4)
    True
    """
    down, across = transfer_functions.pitches(dx)
    for name, value in (("dx", down), ("dx", across), ("wavelength", wavelength), ("distance", distance)):
        if getattr(value, "ndim", 0) or isinstance(value, (list, tuple)):
            raise ValueError(f"{name} must be one number, got {value!r:.80}")
    _validate.real("distance", distance, nonzero=True)
    samples, device = sample_counts(aperture_samples, "aperture_samples"), checked_device("device", device)
    grid = transfer_functions.make_grid(
        nu, nv, dx, wavelength, distance, scale, samples, xp=torch_namespace, device=device, dtype=dtype
    )
    return transfer_functions.separable_impulse_response(grid)


@_validate.takes_units("wavelengths", "distances", "pixel_pitches")
def get_light_kernels(
    wavelengths: Sequence[float],
    distances: Sequence[float],
    pixel_pitches: Sequence[float],
    resolution: Sequence[int] = (1080, 1920),
    resolution_factor: int = 1,
    samples: Sequence[int] = (50, 50, 5, 5),
    propagation_type: str = "Bandlimited Angular Spectrum",
    kernel_type: str = "spatial",
    device: torch.device = _CPU,
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
    """Return the kernels of every combination of wavelengths, distances and pixel pitches.

    Parameters
    ----------
    wavelengths : sequence of float
        W wavelengths in metres.
    distances : sequence of float
        D distances in metres.
    pixel_pitches : sequence of float
        P pitches of square pixels in metres.
    resolution : sequence of int
        Rows m and columns n.
    resolution_factor : int
        Samples per pixel s; 1 except for the impulse-response methods.
    samples : sequence of int
        Points across the source pixel (rows, columns) and the target sample (rows, columns).
    propagation_type : str
        A method that has a transfer function.
    kernel_type : str
        "spatial" (impulse response) or "fourier" (transfer function), both centred.
    device : torch.device
        Where the kernels are computed.

    Returns
    -------
    tuple of torch.Tensor
        Amplitude, phase (0 … 2π) and complex kernel ``[W, D, P, m·s, n·s]``, and parameters ``[W, D, P, m·s, n·s, 5]``
        (wavelength, distance, pitch, X, Y). All are differentiable in lengths that are tensors.

    See Also
    --------
    odak.learn.wave.fit_display : The successor: a model of a display, fitted to what a camera captures.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.wave import get_light_kernels
    >>> amplitude, phase, kernel, parameters = get_light_kernels([532e-9], [1e-3, 2e-3], [8e-6], [8, 6])
    >>> tuple(kernel.shape), tuple(parameters.shape)
    ((1, 2, 1, 8, 6), (1, 2, 1, 8, 6, 5))
    """
    kernel_type = _validate.one_of("kernel_type", kernel_type, ("spatial", "fourier"))
    rows, columns = _validate.size("resolution", resolution)
    method = find_method(propagation_type)
    factor = _validate.integer("resolution_factor", resolution_factor, minimum=1)
    factor = factor if method and method.scalable else 1
    device = checked_device("device", device)
    wavelengths = _lengths("wavelengths", wavelengths, True, device)
    distances = _lengths("distances", distances, False, device)
    pitches = _lengths("pixel_pitches", pixel_pitches, True, device)
    geometry = wavelengths[:, None], distances, device, propagation_type, factor, samples
    kernels = torch.stack([get_propagation_kernel(rows, columns, pitch, *geometry) for pitch in pitches], 2)
    if kernel_type == "spatial":
        axes = (-2, -1)
        spectrum = torch.fft.ifftshift(kernels, dim=axes)
        kernels = torch.fft.fftshift(torch.fft.ifft2(spectrum, dim=axes), dim=axes)
    x, y = (
        pitches[:, None] * torch.linspace(-(n // 2), n // 2, factor * n, dtype=torch.float64, device=device)
        for n in (rows, columns)
    )
    axes = wavelengths.reshape(-1, 1, 1, 1, 1), distances.reshape(-1, 1, 1, 1), pitches.reshape(-1, 1, 1)
    parameters = torch.stack(torch.broadcast_tensors(*axes, x[:, :, None], y[:, None]), -1)
    parameters = parameters.to(torch.get_default_dtype())
    return kernels.abs(), kernels.angle() % (2 * math.pi), kernels, parameters


def _lengths(name, values, positive, device) -> torch.Tensor:
    """Return lengths, float64 ``[n]``, with the graph of those that are tensors."""
    alone = isinstance(values, Real) or getattr(values, "ndim", 1) == 0
    lengths = [
        _validate.number(name, length, positive=positive) if isinstance(length, (tuple, list)) else length
        for length in _validate.several(name, [values] if alone else values, positive=positive)
    ]
    if not lengths:
        raise ValueError(f"{name} must contain at least one length, got none")
    return torch.stack([tensor(name, length, torch.float64, device).reshape(()) for length in lengths])


@_validate.takes_units("wavelength", "distance")
def get_point_wise_impulse_response_fresnel_kernel(
    aperture_points: torch.Tensor,
    aperture_field: torch.Tensor,
    target_points: torch.Tensor,
    resolution: Sequence[int],
    resolution_factor: int = 1,
    wavelength: float = 515e-9,
    distance: float = 0.0,
    randomization: bool = False,
    device: torch.device = _CPU,
    generator: torch.Generator | None = None,
) -> torch.Tensor:
    """Return the Fresnel field of aperture points at target points, 1/(iλz)·Σ_p u_p·exp(ik·r²/(2z)).

    Parameters
    ----------
    aperture_points : torch.Tensor
        ``[P, ≥2]`` positions in metres.
    aperture_field : torch.Tensor
        Field ``[P]`` at them.
    target_points : torch.Tensor
        ``[T, ≥2]`` positions in metres, T = resolution[0]·resolution[1]·resolution_factor². Never modified.
    resolution : sequence of int
        Rows and columns of the result, before the factor.
    resolution_factor : int
        Samples per pixel and axis.
    wavelength : float, default: 515e-9
        Wavelength in metres.
    distance : float
        Distance from the aperture to the targets in metres, not zero.
    randomization : bool
        Jitter the targets by normal noise times the aperture's extent.
    device : torch.device
        Where to compute.
    generator : torch.Generator, optional
        Source of the jitter.

    Returns
    -------
    torch.Tensor
        ``[resolution[0]·factor, resolution[1]·factor]``, complex.

    Raises
    ------
    ValueError
        If the number of targets does not match the resolution, or the distance is zero.

    See Also
    --------
    odak.learn.wave.rayleigh_sommerfeld_sum : The successor: the light of free points, without the approximation.

    Examples
    --------
    A single point of amplitude 1 has the field 1/(λz) at every target near the axis:

    >>> import torch
    >>> from odak.learn.wave import get_point_wise_impulse_response_fresnel_kernel
    >>> field = get_point_wise_impulse_response_fresnel_kernel(
    ...     torch.zeros(1, 2), torch.ones(1), torch.zeros(1, 2), [1, 1], wavelength=500e-9, distance=0.1
    ... )
    >>> round(field.abs().item() * 500e-9 * 0.1, 6)
    1.0
    """
    factor = _validate.integer("resolution_factor", resolution_factor, minimum=1)
    rows, columns = (factor * n for n in _validate.size("resolution", resolution))
    _validate.real("wavelength", wavelength, positive=True)
    _validate.real("distance", distance, nonzero=True)
    device = checked_device("device", device)
    sources, targets = (
        _positions(name, points).to(device=device, dtype=torch.float64)
        for name, points in (("aperture_points", aperture_points), ("target_points", target_points))
    )
    if len(targets) != rows * columns:
        raise ValueError(f"target_points must contain {rows * columns} points for the resolution, got {len(targets)}")
    aperture_field = tensor("aperture_field", aperture_field)
    if aperture_field.numel() != len(sources):
        raise ValueError(
            f"aperture_field must contain a value for each of {len(sources)} aperture_points, "
            f"got {list(aperture_field.shape)}"
        )
    generator = checked_generator("generator", generator)
    if _validate.flag("randomization", randomization):
        extent = sources.amax(0) - sources.amin(0)
        targets = targets + extent * torch.randn(targets.shape, generator=generator, dtype=torch.float64).to(device)
    dtype = torch.complex128 if aperture_field.dtype in (torch.complex128, torch.float64) else torch.complex64
    field = aperture_field.to(device=device, dtype=dtype).reshape(-1)
    chunk = max(1, _CHUNK_BYTES // (16 * sources.shape[0]))
    parts = [_fresnel_sum(sources, field, part, wavelength, distance) for part in targets.split(chunk)]
    constant = phasor(torch.tensor(-math.pi / 2, dtype=torch.float64), dtype).to(device) / (wavelength * distance)
    return (torch.cat(parts) * constant).reshape(rows, columns)


def _positions(name, points) -> torch.Tensor:
    points = floating(name, points, torch.float64)
    _validate.shaped(name, points, "[points, 2 or more], not empty")
    return points[:, :2]


def _fresnel_sum(sources, field, targets, wavelength, distance):
    squared = ((targets[:, None, :] - sources[None, :, :]) ** 2).sum(-1)
    return phasor(math.pi / (wavelength * distance) * squared, field.dtype) @ field
