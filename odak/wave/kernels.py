"""Transfer functions as arrays, centred, for those who want to see or edit them."""

from collections.abc import Sequence
from typing import Any

from odak import _validate
from odak._array import Array
from odak.wave import transfer_functions as tf
from odak.wave.grid import Grid
from odak.wave.methods import DISTANCE_NEEDED, METHODS, find_method
from odak.wave.propagation import check_geometry, sample_counts
from odak.wave.request import Request


def get_propagation_kernel(
    nu: int,
    nv: int,
    dx: float = 8e-6,
    wavelength: float = 515e-9,
    distance: float = 0.0,
    propagation_type: str = "Bandlimited Angular Spectrum",
    scale: int = 1,
    samples: Sequence[int] = (1, 1, 1, 1),
    *,
    xp: Any = None,
    device: Any = None,
    dtype: Any = None,
) -> Array:
    """Return the centred transfer function of a method.

    Parameters
    ----------
    nu, nv : int
        Rows and columns.
    dx, wavelength, distance : float
        Pixel pitch, wavelength and distance in metres (distance and wavelength may be arrays: leading axes).
    propagation_type : str
        A method that has a transfer function.
    scale : int
        Samples per pixel, for the impulse-response methods; 1 for the others.
    samples : sequence of int
        Aperture samples of the impulse-response methods, see :func:`odak.wave.propagate_beam`.
    xp, device, dtype : optional
        Array namespace (NumPy), device, and complex dtype (complex64).

    Returns
    -------
    array
        ``[..., nu·scale, nv·scale]``, zero frequency at index n // 2.

    Raises
    ------
    ValueError
        If the method has no transfer function, or an argument is outside its range.
    """
    method = find_method(propagation_type)
    if method is None or method.kernel is None:
        names = ", ".join(repr(m.name) for m in METHODS if m.kernel)
        raise ValueError(
            f"propagation_type must be a method with a transfer function ({names}), got {propagation_type!r}"
        )
    _validate.real("distance", distance)
    if method.name in DISTANCE_NEEDED and 0 in _validate.numbers(distance):
        raise ValueError(f"distance must not be zero for {method.name!r}")
    scale = _validate.integer("scale", scale, minimum=1)
    scale = scale if "Impulse Response" in method.name else 1
    grid = make_grid(nu, nv, dx, wavelength, distance, scale, samples, xp=xp, device=device, dtype=dtype)
    return grid.xp.fft.fftshift(method.kernel(grid), axes=(-2, -1))


def make_grid(
    nu, nv, dx, wavelength, distance, scale=1, samples=(1, 1, 1, 1), *, xp=None, device=None, dtype=None
) -> Grid:
    """Return the sampling grid of a kernel after checking its arguments."""
    size = _validate.size("nu, nv", (nu, nv))
    check_geometry(None, distance, dx, wavelength)
    scale = _validate.integer("scale", scale, minimum=1)
    xp = _validate.library("xp", xp)
    request = Request(dx, wavelength, distance, scale=scale, samples=sample_counts(samples))
    return request.grid((scale * size[0], scale * size[1]), xp, device, _complex_dtype(dtype, xp))


def _complex_dtype(dtype, xp):
    for name in ("complex64", "complex128"):
        if name in str("complex64" if dtype is None else dtype):
            return getattr(xp, name)
    raise TypeError(f"dtype must be complex64 or complex128, got {dtype!r}")


def separable_impulse_response(grid: Grid):
    """Return the Fresnel kernel (H, h, h_x, h_y), all centred: transfer function, impulse response and its factors."""
    xp = grid.xp
    constant, h_y, h_x = tf.impulse_response_factors(grid)
    response = xp.astype(constant * h_y * h_x, grid.dtype)
    h_y, h_x = (xp.reshape(xp.astype(factor, grid.dtype), (-1,)) for factor in (h_y, h_x))
    kernel = xp.fft.fftshift(tf.impulse_response_fresnel(grid), axes=(-2, -1))
    return kernel, xp.fft.fftshift(response, axes=(-2, -1)), xp.fft.fftshift(h_x), xp.fft.fftshift(h_y)
