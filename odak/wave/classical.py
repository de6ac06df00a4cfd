"""Propagation of scalar fields over any distance, by any method, for any array library.

All functions take a complex field ``[..., rows, columns]`` sampled with pitch `dx`, the optical axis at index
``n // 2``, and return the field after `distance`. They follow the input: NumPy arrays in, NumPy arrays out; torch
tensors in, differentiable torch tensors out; complex64 in, complex64 out.
"""

from collections.abc import Sequence
from typing import Any

from odak import _array, _validate
from odak._array import Array
from odak.tools.matrix import crop_center
from odak.wave.phase_retrieval import gerchberg_saxton, gerchberg_saxton_3d
from odak.wave.propagation import check_geometry, propagate

__all__ = [
    "adaptive_sampling_angular_spectrum",
    "angular_spectrum",
    "band_extended_angular_spectrum",
    "band_limited_angular_spectrum",
    "custom",
    "fraunhofer",
    "fraunhofer_equal_size_adjust",
    "fraunhofer_inverse",
    "gerchberg_saxton",
    "gerchberg_saxton_3d",
    "impulse_response_fresnel",
    "incoherent_angular_spectrum",
    "propagate_beam",
    "rayleigh_sommerfeld",
    "rayleigh_sommerfeld_sum",
    "seperable_impulse_response_fresnel",
    "transfer_function_fresnel",
]


def propagate_beam(
    field: Array,
    k: float | Array | None,
    distance: float | Array,
    dx: float | Array,
    wavelength: float | Array,
    propagation_type: str = "IR Fresnel",
    kernel: Array = None,
    zero_padding: Sequence[bool] = (False, False, False),
    aperture: float | Array = 1.0,
    scale: int = 1,
    samples: Sequence[int] = (1, 1, 1, 1),
) -> Array:
    """Propagate a field by the method named.

    Parameters
    ----------
    field : array
        Complex field ``[..., rows, columns]`` (a real one is taken as a field of phase zero).
    k : float or None
        Wave number 2π/wavelength; kept for older callers, it must agree with `wavelength` to 1e-6.
    distance : float or array
        Propagation distance in metres, negative to propagate back. An array broadcasts against the field's leading
        axes; a torch tensor that requires grad makes the result differentiable in it, like `dx` and `wavelength`.
    dx : float
        Pixel pitch in metres.
    wavelength : float or array
        Wavelength in metres; an array holds one per channel (leading axes of the field).
    propagation_type : str
        A name or alias of the table of methods ("Bandlimited Angular Spectrum", "IR Fresnel", …), in any case, or
        "auto", which takes the method whose sampling criteria hold (see :func:`odak.wave.sampling_report`).
    kernel : array, optional
        Transfer function for "custom", centred (zero frequency at index n // 2).
    zero_padding : sequence of bool
        Pad the field to twice its size; pad the spectrum to twice its size (half the output pitch; no effect with
        Fraunhofer); crop the centre half at the end.
    aperture : float or array
        Centred mask that multiplies the spectrum, of the propagated (padded) size.
    scale : int
        Samples per pixel and axis, for the impulse-response methods: the result is `scale` times as large.
    samples : sequence of int
        Points across the source pixel (rows, columns) and the target sample (rows, columns) over which the
        impulse-response methods average.

    Returns
    -------
    array
        Propagated field, complex64 from 32-bit input and complex128 from 64-bit input; real for
        "Incoherent Angular Spectrum".

    Raises
    ------
    ValueError, TypeError
        If an argument is outside its range, naming it; an unknown `propagation_type` lists the known ones.

    Examples
    --------
    >>> import numpy as np
    >>> import odak
    >>> field = np.ones((8, 8), dtype=np.complex128)
    >>> result = odak.wave.propagate_beam(field, None, 1e-3, 8e-6, 532e-9, "Angular Spectrum")
    >>> bool(np.allclose(result, np.exp(2j * np.pi * 1e-3 / 532e-9)))
    True
    """
    return propagate(
        field,
        k,
        distance,
        dx,
        wavelength,
        propagation_type,
        kernel=kernel,
        zero_padding=zero_padding,
        aperture=aperture,
        scale=scale,
        samples=samples,
    )


def angular_spectrum(
    field: Array,
    k: Array,
    distance: Array,
    dx: Array,
    wavelength: Array,
    zero_padding: bool = False,
    aperture: float | Array = 1.0,
) -> Array:
    """Propagate by the angular spectrum of plane waves, exact for scalar fields (Goodman 2005, section 3.10).

    Parameters
    ----------
    field, k, distance, dx, wavelength, aperture
        As in :func:`propagate_beam`.
    zero_padding : bool
        Pad the spectrum, for half the output pitch.

    Returns
    -------
    array
        Propagated field.
    """
    return propagate(
        field, k, distance, dx, wavelength, "Angular Spectrum", zero_padding=zero_padding, aperture=aperture
    )


def band_limited_angular_spectrum(
    field: Array,
    k: Array,
    distance: Array,
    dx: Array,
    wavelength: Array,
    zero_padding: bool = False,
    aperture: float | Array = 1.0,
) -> Array:
    """Propagate by the angular spectrum inside its alias-free band (Matsushima and Shimobaba 2009).

    Parameters and result are those of :func:`angular_spectrum`.
    """
    return propagate(
        field, k, distance, dx, wavelength, "Bandlimited Angular Spectrum", zero_padding=zero_padding, aperture=aperture
    )


def incoherent_angular_spectrum(
    field: Array,
    k: Array,
    distance: Array,
    dx: Array,
    wavelength: Array,
    zero_padding: bool = False,
    aperture: float | Array = 1.0,
) -> Array:
    """Propagate an intensity by the incoherent transfer function, the autocorrelation of the coherent one.

    Parameters are those of :func:`angular_spectrum`, `field` being an intensity; the result is real and keeps its sum.
    """
    return propagate(
        field, k, distance, dx, wavelength, "Incoherent Angular Spectrum", zero_padding=zero_padding, aperture=aperture
    )


def transfer_function_fresnel(
    field: Array,
    k: Array,
    distance: Array,
    dx: Array,
    wavelength: Array,
    zero_padding: bool = False,
    aperture: float | Array = 1.0,
) -> Array:
    """Propagate by the Fresnel transfer function exp(ikz)·exp(−iπλz·f²) (Voelz 2011, eq. 4.20).

    Parameters and result are those of :func:`angular_spectrum`.
    """
    return propagate(
        field, k, distance, dx, wavelength, "Transfer Function Fresnel", zero_padding=zero_padding, aperture=aperture
    )


def impulse_response_fresnel(
    field: Array,
    k: Array,
    distance: Array,
    dx: Array,
    wavelength: Array,
    zero_padding: bool = False,
    aperture: float | Array = 1.0,
    scale: int = 1,
    samples: Any = (1, 1, 1, 1),
) -> Array:
    """Propagate by the sampled Fresnel impulse response (Voelz 2011, eq. 4.21).

    Parameters are those of :func:`angular_spectrum`; `scale` and `samples` are those of :func:`propagate_beam`.
    """
    return propagate(
        field,
        k,
        distance,
        dx,
        wavelength,
        "Impulse Response Fresnel",
        zero_padding=zero_padding,
        aperture=aperture,
        scale=scale,
        samples=samples,
    )


# The impulse response of free space separates into x and y, and is always computed that way.
seperable_impulse_response_fresnel = impulse_response_fresnel


def custom(field: Array, kernel: Array | None, zero_padding: bool = False, aperture: float | Array = 1.0) -> Array:
    """Filter a field by a centred transfer function of its own size.

    Parameters
    ----------
    field : array
        Complex field ``[..., rows, columns]``.
    kernel : array or None
        Transfer function ``[..., rows, columns]``, zero frequency at index n // 2; None stands for ones.
    zero_padding : bool
        Pad the spectrum, for half the output pitch.
    aperture : float or array
        Centred mask that multiplies the spectrum (once).

    Returns
    -------
    array
        Filtered field.
    """
    return propagate(field, None, 0.0, 1.0, 1.0, "custom", kernel=kernel, zero_padding=zero_padding, aperture=aperture)


def band_extended_angular_spectrum(field: Array, k: Array, distance: Array, dx: Array, wavelength: Array) -> Array:
    """Propagate by the angular spectrum on a frequency grid stretched to the alias-free band (Zhang et al. 2020).

    Parameters and result are those of :func:`angular_spectrum`. Opt. Lett. 45, 1543; computed by chirp-z transforms.
    """
    return propagate(field, k, distance, dx, wavelength, "Bandextended Angular Spectrum")


def adaptive_sampling_angular_spectrum(field: Array, k: Array, distance: Array, dx: Array, wavelength: Array) -> Array:
    """Propagate by the angular spectrum with frequencies doubled, and stretched beyond twice the critical distance.

    Parameters and result are those of :func:`angular_spectrum`. Zhang, Zhang and Jin, Opt. Lett. 45, 4416 (2020).
    """
    return propagate(field, k, distance, dx, wavelength, "Adaptive Sampling Angular Spectrum")


def rayleigh_sommerfeld(field: Array, k: Array, distance: Array, dx: Array, wavelength: Array) -> Array:
    """Propagate by the first Rayleigh–Sommerfeld integral, as a linear convolution with its sampled kernel.

    Parameters and result are those of :func:`angular_spectrum`. The kernel is z·exp(ikr)/(iλr²) (Goodman 2005,
    eq. 3-41, r ≫ λ), on twice the grid (Shen and Wang 2006), so that nothing wraps around.
    """
    return propagate(field, k, distance, dx, wavelength, "Rayleigh-Sommerfeld")


def rayleigh_sommerfeld_sum(field: Array, k: Array, distance: Array, dx: Array, wavelength: Array) -> Array:
    """Return :func:`rayleigh_sommerfeld` by the direct double sum, in double precision: an oracle for small fields.

    Memory grows with the square of the number of pixels; 64 × 64 takes 270 MB.
    """
    field = _validate.image("field", field)
    check_geometry(k, distance, dx, wavelength)
    xp = _array.namespace(field)
    rows, columns = field.shape[-2:]
    device = _array.device_of(field)
    y = xp.arange(rows, dtype=xp.float64, device=device) * dx
    x = xp.arange(columns, dtype=xp.float64, device=device) * dx
    squared_y, squared_x = (y[:, None] - y[None, :]) ** 2, (x[:, None] - x[None, :]) ** 2
    r_squared = squared_y[:, None, :, None] + squared_x[None, :, None, :] + distance**2
    sign = 1 if distance > 0 else -1
    kernel = _array.phasor_of_cycles(sign * (xp.sqrt(r_squared) / wavelength - 0.25))
    kernel = kernel * (abs(distance) * dx**2 / (wavelength * r_squared))
    kernel = xp.reshape(kernel, (rows * columns, rows * columns))
    source = xp.reshape(xp.astype(field, xp.complex128), (*field.shape[:-2], rows * columns, 1))
    return xp.reshape(xp.matmul(kernel, source), field.shape)


def fraunhofer(field: Array, k: Array, distance: Array, dx: Array, wavelength: Array) -> Array:
    """Propagate to the far field: exp(ikz)/(iλz)·exp(ikr²/(2z))·F{u}·dx² (Goodman 2005, eq. 4-25).

    Parameters and result are those of :func:`angular_spectrum`; the output pitch is λ·z/(N·dx) along an axis of N.
    """
    return propagate(field, k, distance, dx, wavelength, "Fraunhofer")


def fraunhofer_inverse(field: Array, k: Array, distance: Array, dx: Array, wavelength: Array) -> Array:
    """Return the field whose :func:`fraunhofer` pattern is given; `dx` is the pitch of the plane returned.

    Parameters and result are those of :func:`angular_spectrum`.
    """
    return propagate(field, k, distance, dx, wavelength, "Fraunhofer Inverse")


def fraunhofer_equal_size_adjust(field: Array, distance: float, dx: float, wavelength: float) -> Array:
    """Return the centre of a Fraunhofer pattern that spans the same width as the field it came from.

    Parameters
    ----------
    field : array
        Fraunhofer pattern ``[..., rows, columns]``.
    distance, dx, wavelength : float
        As given to :func:`fraunhofer`, in metres.

    Returns
    -------
    array
        The centre int(m·N) samples of each axis, m = N·dx²/(λ·z) being the ratio of the two widths.

    Raises
    ------
    ValueError
        If the pattern spans less than the field (m > 1), so that there is nothing to cut.
    """
    field = _validate.image("field", field)
    check_geometry(None, distance, dx, wavelength)
    _validate.real("distance", distance, nonzero=True)
    sizes = [int(n * dx**2 / (wavelength * abs(distance)) * n) for n in field.shape[-2:]]
    for n, size in zip(field.shape[-2:], sizes, strict=True):
        if not 1 <= size <= n:
            raise ValueError(
                f"distance must let the field's width span 1 to {n} samples of the pattern, {distance!r} gives {size}"
            )
    return crop_center(field, sizes)
