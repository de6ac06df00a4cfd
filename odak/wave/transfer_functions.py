"""Transfer functions of free space, the filtering of fields by them, their sampling grid and their cache.

A transfer function takes a :class:`Grid` and returns ``[..., rows, columns]`` in the order of the discrete Fourier
transform (zero frequency at index 0), for NumPy, PyTorch or any other array-API library. Phases are counted in cycles,
in float64, and lose their whole cycles before any cast: 2πz/λ is about 10⁶ rad, which single precision would resolve
to a tenth of a radian only.
"""

import functools
import logging
import math
import os
import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable, Iterable
from contextlib import nullcontext
from contextvars import ContextVar
from dataclasses import dataclass, fields, replace
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import scipy.fft

from odak import _array, _validate
from odak._array import Amount, Array, Device, DType, convolve_plainly, make_complex, numpy_namespace, phasor_of_cycles
from odak._warnings import ArgumentWarning, warn
from odak.tools.matrix import zero_pad

_log = logging.getLogger("odak")

_SLAB = 1 << 17
# Relative error of a wave number that is taken for 2π/wavelength: 3.14 is 0.0005 below π.
_ROUNDED_PI = 1e-3


@dataclass(frozen=True)
class Grid:
    """Grid and options with which a transfer function is sampled.

    All kernels of free space are even in both axes, so that they are evaluated on the quarter of non-negative
    indices (0 … n // 2) and unfolded by :meth:`unfold`.

    Attributes
    ----------
    shape : tuple of int
        Rows and columns of the (padded) grid.
    pitch : tuple of array
        Pixel pitch along rows and columns, float64, shaped ``[..., 1, 1]`` so that it broadcasts against
        ``[rows, columns]``.
    wavelength : array
        Wavelength, in the same form.
    distance : array
        Distance, in the same form.
    xp, device, dtype
        Array namespace, device and complex dtype of the kernel.
    scale : int
        How many samples a pixel takes along each axis (impulse-response methods).
    samples : tuple of int
        Points across the source aperture (rows, columns) and the target aperture (rows, columns).
    evanescent : bool
        False when no frequency of the grid exceeds 1/λ, so that evanescent waves need no arithmetic.
    """

    shape: tuple[int, int]
    pitch: tuple[Any, Any]
    wavelength: Array
    distance: Array
    xp: ModuleType
    device: Device
    dtype: DType
    scale: int = 1
    samples: tuple[int, int, int, int] = (1, 1, 1, 1)
    evanescent: bool = True

    @property
    def pixel_area(self) -> float:
        """Return the area of a pixel."""
        return self.pitch[0] * self.pitch[1]

    def _indices(self, n: int, axis: int):
        indices = self.xp.arange(n // 2 + 1, dtype=self.xp.float64, device=self.device)
        return self.xp.reshape(indices, (-1, 1) if axis == 0 else (1, -1))

    def frequencies(self) -> tuple[Array, ...]:
        """Return the non-negative DFT frequencies (rows as ``[..., r, 1]``, columns as ``[..., 1, c]``) in 1/m."""
        return tuple(self._indices(n, axis) / (n * self.pitch[axis]) for axis, n in enumerate(self.shape))

    def positions(self) -> tuple[np.ndarray, ...]:
        """Return the non-negative sample positions, like :meth:`frequencies`, in metres."""
        return tuple(self._indices(n, axis) * (self.pitch[axis] / self.scale) for axis, n in enumerate(self.shape))

    def evaluate(self, kernel: Callable[..., Any]) -> Any:
        """Return ``kernel(fy, fx)`` on the whole grid, evaluated on its quarter a slab of rows at a time.

        A dozen intermediate results in float64 would otherwise take more memory than the kernel itself.
        """
        fy, fx = self.frequencies()
        step = max(1, _SLAB // fx.shape[-1])
        return self.unfold(in_slabs(lambda part: kernel(fy[..., part, :], fx), fy.shape[-2], step))

    def unfold(self, quarter: Any) -> Any:
        """Return the whole kernel in FFT order from its quarter of non-negative indices."""
        rows, columns = (self._indices_of(axis) for axis in (0, 1))
        if not by_columns(quarter):
            return self.xp.take(self.xp.take(quarter, rows, axis=-2), columns, axis=-1)
        half = quarter.mT.index_select(-2, columns)
        return half.index_select(-1, rows).mT

    def _indices_of(self, axis: int):
        return self._mirror(self.shape[axis])

    def _mirror(self, n: int):
        indices = self.xp.arange(n, device=self.device)
        return self.xp.minimum(indices, n - indices)

    def unfold_axis(self, half: np.ndarray, axis: int) -> np.ndarray:
        """Return a one-dimensional even function along `axis` (-1 or -2) in FFT order from its non-negative half."""
        return self.xp.take(half, self._mirror(self.shape[axis]), axis=axis)


def in_slabs(function: Callable[..., Any], count: int, step: int, total: int | None = None) -> Array:
    """Return the rows ``function(slice)`` of `count` rows, computed `step` at a time.

    With `total` these are the first ones of so many rows, which are an even function of their index.
    """
    parts = [slice(start, min(start + step, count)) for start in range(0, count, step)]
    first, total = function(parts[0]), count if total is None else total
    if len(parts) == 1 and total == count:
        return first
    xp = _array.namespace(first)
    constant = _array.is_torch(first) and not (_array.is_traced(first) or _array.is_wrapped(first))
    if not (constant or isinstance(first, np.ndarray)):
        found = xp.concat([first, *(function(part) for part in parts[1:])], axis=-2)
        return xp.concat([found, xp.flip(found[..., 1 : total - count + 1, :], axis=-2)], axis=-2)
    # Slabs that were all kept to the end would leave gaps in the memory, which the allocator does not return.
    shape = (*first.shape[:-2], total, first.shape[-1])
    result = xp.empty(shape, dtype=first.dtype, device=_array.device_of(first))
    for part in parts:
        rows = function(part) if part.start else first
        result[..., part, :] = rows
        start, stop = max(part.start, 1), min(part.stop, total - count + 1)
        if start < stop:
            mirrored = xp.flip(rows[..., start - part.start : stop - part.start, :], axis=-2)
            result[..., total - stop + 1 : total - start + 1, :] = mirrored
    return result


def by_columns(values: Array) -> bool:
    """Return whether a kernel made of `values` is laid out column by column.

    So is a spectrum on a processor, where torch transforms columns last, whole or in blocks.
    """
    return _array.is_torch(values) and values.device.type == "cpu"


def angular_spectrum(grid: Grid) -> Array:
    """Return exp(i2πz·sqrt(1/λ² − f²)), evanescent waves decaying in both directions (Goodman 2005, eq. 3-70)."""
    return grid.evaluate(lambda fy, fx: plane_wave_transfer(grid, fy, fx))


def plane_wave_transfer(grid: Grid, fy: Array, fx: Array) -> Array:
    """Return the transfer function of free space at the frequencies (fy, fx), travelling or evanescent."""
    xp = grid.xp
    transverse = fx**2 + fy**2
    squared = 1 / grid.wavelength**2 - transverse
    if not grid.evanescent:
        return phasor_of_cycles(_cycles(grid, transverse, xp.sqrt(squared)), grid.dtype)
    travels = squared > 0
    one = xp.ones_like(squared)
    wave = phasor_of_cycles(_cycles(grid, transverse, xp.sqrt(xp.where(travels, squared, one))), grid.dtype)
    exponent = -2 * xp.pi * xp.abs(grid.distance) * xp.sqrt(xp.where(squared < 0, -squared, one))
    decay = xp.where(squared == 0, one, xp.exp(exponent))
    return xp.where(travels, wave, xp.astype(decay, grid.dtype))


def axial_cycles(grid: Grid) -> Array:
    """Return z/λ less its whole cycles, so that no precision is lost in later sums."""
    return fraction_of_cycles(grid.distance, grid.wavelength)


def fraction_of_cycles(distance: Array, wavelength: Array) -> Array:
    """Return distance/wavelength less its whole cycles; the remainder is exact, whatever the number of cycles."""
    return _array.namespace(distance).remainder(distance, wavelength) / wavelength


def _cycles(grid: Grid, transverse, axial):
    # z·(axial − 1/λ) without the cancellation: 1/λ² − axial² is the transverse frequency squared.
    return axial_cycles(grid) - grid.distance * transverse / (axial + 1 / grid.wavelength)


def band_limits(grid: Grid, distance: Amount | None = None, counts: tuple[int, int] | None = None) -> tuple[Array, ...]:
    """Return the frequency (rows, columns) above which a sampled angular-spectrum kernel aliases.

    Matsushima and Shimobaba, Opt. Express 17, 19662 (2009), eq. 13: 1/(λ·sqrt((2z/L)² + 1)), L the grid's width. The
    distance is the grid's own unless another is given, and so are the numbers of samples.
    """
    distance = grid.distance if distance is None else distance
    widths = [n * pitch for n, pitch in zip(counts or grid.shape, grid.pitch, strict=True)]
    return tuple(1 / (grid.wavelength * grid.xp.sqrt((2 * distance / width) ** 2 + 1)) for width in widths)


def band_limited_angular_spectrum(grid: Grid) -> np.ndarray:
    """Return the angular-spectrum kernel inside its alias-free band (Matsushima and Shimobaba 2009).

    A ray of frequency f lands z·tan θ aside. The band ends where that is half the grid's width; there the kernel falls
    off as a normal distribution of the deviation sqrt(λ|z|/2π) in z·tan θ, which balances the light that is cut off
    against the diffraction at the edge: a hard edge costs 5e-3 on a smooth beam. Waves that decay have no phase that
    could alias, and stay.
    """
    xp = grid.xp

    def limited(fy, fx):
        return plane_wave_transfer(grid, fy, fx) * xp.astype(alias_free_weight(grid, grid.shape, fy, fx), grid.dtype)

    return grid.evaluate(limited)


def alias_free_weight(grid: Grid, counts: tuple[int, int], fy: Any, fx: Any) -> Any:
    """Return the weight of each plane wave that keeps a kernel of `counts` frequencies from folding back, 0 … 1."""
    xp = grid.xp
    distance, weight = xp.abs(grid.distance), 1.0
    limits = band_limits(grid, counts=counts)
    for frequency, count, limit, pitch in zip((fy, fx), counts, limits, grid.pitch, strict=True):
        width = count * pitch
        squared = 1 / grid.wavelength**2 - frequency**2
        tangent = frequency / xp.sqrt(xp.where(squared > 0, squared, xp.ones_like(squared)))
        deviation = xp.sqrt(grid.wavelength * distance / (2 * xp.pi) + (1e-3 * grid.wavelength) ** 2)
        # Far away, where that is wider than the grid, the axial wave still passes.
        edge = normal_tail((distance * tangent - width / 2) / xp.minimum(deviation, width / 12))
        # Where the whole band is free of aliasing, nothing is cut; nor are waves that decay.
        weight = weight * xp.where((limit >= 1 / (2 * pitch)) | (squared <= 0), xp.ones_like(edge), edge)
    return weight


def normal_tail(deviations: Array) -> Array:
    """Return the probability that a standard normal variable exceeds `deviations`, to 1e-4, smooth, 0 … 1.

    Page's logistic form (Appl. Stat. 26, 75, 1977) needs no error function.
    """
    xp = _array.namespace(deviations)
    # Beyond ten deviations it is 0 or 1 to any precision.
    deviations = xp.clip(deviations, -10.0, 10.0)
    return 1 / (1 + xp.exp(1.5976 * deviations * (1 + 0.04417 * deviations**2)))


def transfer_function_fresnel(grid: Grid) -> np.ndarray:
    """Return exp(ikz)·exp(−iπλz·f²) (Voelz 2011, eq. 4.20)."""
    axial = axial_cycles(grid)
    bend = grid.distance * grid.wavelength / 2
    return grid.evaluate(lambda fy, fx: phasor_of_cycles(axial - bend * (fx**2 + fy**2), grid.dtype))


def impulse_response_factors(grid: Grid) -> tuple[np.ndarray, ...]:
    """Return the constant and the two one-dimensional factors of the sampled Fresnel impulse response.

    The impulse response exp(ikz)/(iλz)·exp(ik(x² + y²)/(2z)) (Voelz 2011, eq. 4.21), averaged over the source pixel
    and over the target sample, separates: h(x, y) = c·h_y(y)·h_x(x). The average runs over pairs of points
    (w in the source, p in the target), h_x = mean of exp(ik(x + p − w)²/(2z)).

    Returns
    -------
    tuple
        c ``[..., 1, 1]``, h_y ``[..., rows, 1]``, h_x ``[..., 1, columns]``, in FFT order, complex128.
    """
    xp = grid.xp
    double = xp.complex128
    constant = phasor_of_cycles(axial_cycles(grid) - 0.25, double) / xp.astype(grid.wavelength * grid.distance, double)
    factors = []
    for axis, position in zip((-2, -1), grid.positions(), strict=True):
        source, target = (aperture_points(grid, grid.samples[first + axis]) for first in (2, 4))
        target = target / grid.scale
        rank = max(position.ndim, grid.wavelength.ndim, grid.distance.ndim)
        offsets = xp.reshape(target[:, None] - source[None, :], (-1,) + (1,) * rank) * grid.pitch[axis]
        cycles = (position + offsets) ** 2 / (2 * grid.wavelength * grid.distance)
        # Even by symmetry of the two apertures, so that the non-negative half suffices.
        mean = xp.sum(phasor_of_cycles(cycles, double), axis=0) / offsets.shape[0]
        factors.append(grid.unfold_axis(mean, axis))
    return constant, *factors


def aperture_points(grid: Grid, count: int) -> np.ndarray:
    """Return the midpoints of `count` equal parts of an aperture of width one."""
    return (grid.xp.arange(count, dtype=grid.xp.float64, device=grid.device) + 0.5) / count - 0.5


def impulse_response_fresnel(grid: Grid) -> Any:
    """Return the discrete Fourier transform of the sampled Fresnel impulse response times the pixel's area."""
    spectrum_y, spectrum_x = impulse_response_spectra(grid)
    return (spectrum_x.mT * spectrum_y.mT).mT if by_columns(spectrum_x) else spectrum_y * spectrum_x


def impulse_response_spectra(grid: Grid) -> Any:
    """Return the two factors of :func:`impulse_response_fresnel`: ``[..., rows, 1]`` and ``[..., 1, columns]``."""
    xp = grid.xp
    constant, h_y, h_x = impulse_response_factors(grid)
    spectrum_y = xp.fft.fft(h_y, axis=-2) * xp.astype(constant * grid.pixel_area, xp.complex128)
    spectrum_x = xp.fft.fft(h_x, axis=-1)
    return xp.astype(spectrum_y, grid.dtype), xp.astype(spectrum_x, grid.dtype)


def rayleigh_sommerfeld(grid: Grid) -> np.ndarray:
    """Return the transform of the sampled first Rayleigh–Sommerfeld kernel times the pixel's area.

    The kernel is z/(2πr²)·(1/r − ik)·exp(ikr) (Goodman 2005, eq. 3-40; Shen and Wang, Appl. Opt. 45, 1102 (2006)). For
    z < 0 it is the conjugate of the one of |z|; at z = 0 every frequency passes.
    """
    xp = grid.xp
    transfer = xp.fft.fftn(rayleigh_sommerfeld_samples(grid), axes=(-2, -1))
    return xp.astype(xp.where(grid.distance == 0, xp.ones_like(transfer), transfer), grid.dtype, copy=False)


def rayleigh_sommerfeld_samples(grid: Grid) -> np.ndarray:
    """Return the sampled first Rayleigh–Sommerfeld kernel times the pixel's area, in FFT order; complex128."""
    xp = grid.xp
    y, x = grid.positions()
    # At zero distance the kernel is singular, and the value that replaces it is not used.
    distance = xp.where(grid.distance == 0, grid.pitch[0], grid.distance)
    response = rayleigh_sommerfeld_response(distance, x**2 + y**2, grid.wavelength)
    return grid.unfold(response * xp.astype(grid.pixel_area, xp.complex128))


def rayleigh_sommerfeld_response(distance: Array, squared: Array, wavelength: Array) -> Array:
    """Return z/(2πr²)·(1/r − ik)·exp(ikr) at r² = z² + `squared`, its conjugate for z < 0; complex128."""
    xp = _array.namespace(squared)
    z = xp.abs(distance)
    r = xp.sqrt(squared + z**2)
    # r/λ less the whole cycles of z/λ: r − z = (x² + y²)/(r + z) without cancellation.
    cycles = fraction_of_cycles(z, wavelength) + squared / ((r + z) * wavelength)
    weight = z / (wavelength * r**2)
    # −i·(1 + i/(kr)) = 1/(kr) − i
    factor = make_complex(weight * wavelength / (2 * xp.pi * r), -weight)
    wave = phasor_of_cycles(cycles, xp.complex128) * factor
    return xp.where(distance < 0, xp.conj(wave), wave)


def incoherent_angular_spectrum(grid: Grid) -> np.ndarray:
    """Return the optical transfer function of free space: the autocorrelation of the coherent one, 1 at f = 0."""
    return autocorrelation(angular_spectrum(grid))


def autocorrelation(transfer: Any) -> Any:
    """Return the autocorrelation of a coherent transfer function in FFT order, 1 at f = 0: the incoherent one.

    It is the transform of |h|², the intensity impulse response (Goodman 2005, eq. 6-28), which is not negative.
    """
    xp = _array.namespace(transfer)
    response = xp.fft.ifftn(transfer, axes=(-2, -1))
    intensity = xp.real(response) ** 2 + xp.imag(response) ** 2
    total = xp.sum(intensity, axis=(-2, -1), keepdims=True)
    intensity = intensity / xp.where(total > 0, total, xp.ones_like(total))
    return xp.fft.fftn(make_complex(intensity, xp.zeros_like(intensity)), axes=(-2, -1))


# Kernels that were used once take up to the first number of bytes. Those that were used again take a tenth of the free
# memory, from the first to the second number.
ONCE_BYTES, MOST_BYTES = 1 << 27, 1 << 30
# So many kernels that were dropped are known as used before when they are built again.
_REMEMBERED = 1024


class KernelCache:
    """Store of one device, bounded in bytes and safe between threads, which drops the least recently used kernel.

    Those that were used once go before all that were used again: a scan over a thousand distances neither fills the
    memory nor displaces the kernels of an optimisation.

    Parameters
    ----------
    maximum_bytes : int
        Bound on the bytes held. A kernel larger than this is built on each call and never held.
    """

    bytes: int

    def __init__(self, maximum_bytes: int):
        self._once: OrderedDict[Hashable, object] = OrderedDict()
        self._again: OrderedDict[Hashable, object] = OrderedDict()
        self._dropped: OrderedDict[Hashable, None] = OrderedDict()
        self._lock = threading.RLock()
        self.maximum_bytes: int = maximum_bytes
        self.bytes = self._once_bytes = 0

    def get(self, key: Hashable, build: Callable[..., Any]) -> Any:
        """Return the entry of `key`, calling `build` for it when it is not held."""
        with self._lock:
            held = self._again.get(key)
            if held is not None:
                self._again.move_to_end(key)
                return held
            if key in self._once:
                held = self._again[key] = self._once.pop(key)
                self._once_bytes -= _bytes_of(held)
                return held
        kernel = build()
        size = _bytes_of(kernel)
        with self._lock:
            if size <= self.maximum_bytes and key not in self._again and key not in self._once:
                self.bytes += size
                if key in self._dropped:
                    del self._dropped[key]
                    self._again[key] = kernel
                else:
                    self._once[key] = kernel
                    self._once_bytes += size
                self._shrink()
        return kernel

    def _shrink(self):
        while self._once and (
            self.bytes > self.maximum_bytes or (self._once_bytes > ONCE_BYTES and len(self._once) > 1)
        ):
            self._once_bytes -= self._drop(self._once)
        while self.bytes > self.maximum_bytes:
            self._drop(self._again)

    def _drop(self, entries) -> int:
        key, kernel = entries.popitem(last=False)
        self._dropped[key] = None
        if len(self._dropped) > _REMEMBERED:
            self._dropped.popitem(last=False)
        size = _bytes_of(kernel)
        self.bytes -= size
        return size

    def after_fork(self) -> None:
        """Replace the lock: a thread that held it does not exist in this process and would never release it."""
        self._lock = threading.RLock()

    def resize(self, maximum_bytes: int) -> None:
        """Set the bound and drop the entries above it."""
        with self._lock:
            self.maximum_bytes = maximum_bytes
            self._shrink()

    def clear(self) -> None:
        """Drop every entry."""
        with self._lock:
            for entries in (self._once, self._again, self._dropped):
                entries.clear()
            self.bytes = self._once_bytes = 0

    def __len__(self) -> int:
        return len(self._once) + len(self._again)


class KernelCaches:
    """The stores of all devices, each with its own bound."""

    def __init__(self):
        self._caches: dict[str, KernelCache] = {}
        self.maximum_bytes: int | None = None

    def on(self, device: str) -> KernelCache:
        """Return the store of a device."""
        name = str(device)
        if name not in self._caches:
            bound = _default_bound(name) if self.maximum_bytes is None else self.maximum_bytes
            self._caches.setdefault(name, KernelCache(bound))
        return self._caches[name]

    def resize(self, maximum_bytes: int | None) -> None:
        """Set the bound of every store, now and later; None is the default."""
        self.maximum_bytes = maximum_bytes
        for name, cache in list(self._caches.items()):
            cache.resize(_default_bound(name) if maximum_bytes is None else maximum_bytes)

    def clear(self) -> None:
        """Drop every entry."""
        for cache in list(self._caches.values()):
            cache.clear()

    def after_fork(self) -> None:
        """Make the stores usable in a forked process."""
        for cache in self._caches.values():
            cache.after_fork()

    @property
    def bytes(self) -> int:
        """Size of all kernels of all devices in bytes."""
        return sum(cache.bytes for cache in self._caches.values())

    def __len__(self) -> int:
        return sum(map(len, self._caches.values()))


def _default_bound(device: str) -> int:
    """Return a tenth of the free memory of a device, from the least to the greatest bound."""
    return min(max(_free_bytes(device) // 10, ONCE_BYTES), MOST_BYTES)


def _free_bytes(device: str) -> int:
    """Return the free memory of a device, 0 if it is not known."""
    if device.startswith("cuda"):
        import torch

        return torch.cuda.mem_get_info(device)[0]
    try:
        with open("/proc/meminfo", encoding="ascii") as stream:
            free = next(int(line.split()[1]) << 10 for line in stream if line.startswith("MemAvailable:"))
    except (OSError, StopIteration):
        return 0
    try:
        # What a container may still take.
        most, taken = (Path(f"/sys/fs/cgroup/memory.{name}").read_text() for name in ("max", "current"))
        return min(free, int(most) - int(taken))
    except (OSError, ValueError):
        return free


def _bytes_of(kernel) -> int:
    if hasattr(kernel, "held_bytes"):
        return kernel.held_bytes
    # The array API has no `nbytes`; every number held is a double or a pair of floats, unless it says 128.
    return math.prod(kernel.shape) * (16 if "128" in str(kernel.dtype) else 8)


kernels: KernelCaches = KernelCaches()
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=kernels.after_fork)


def clear_kernel_cache() -> None:
    """Drop all stored transfer functions.

    Examples
    --------
    The next propagation computes its transfer function again:

    >>> import numpy as np
    >>> import odak
    >>> before = odak.wave.propagate_beam(np.ones((8, 8)), None, 1e-3, 8e-6, 532e-9, "Angular Spectrum")
    >>> odak.wave.clear_kernel_cache()
    >>> after = odak.wave.propagate_beam(np.ones((8, 8)), None, 1e-3, 8e-6, 532e-9, "Angular Spectrum")
    >>> bool((after == before).all())
    True
    """
    kernels.clear()


def set_kernel_cache_size(maximum_bytes: int | None) -> None:
    """Bound the memory of the store of transfer functions; 0 switches it off.

    Transfer functions of geometries that were used once take at most 128 MiB, or the place of one if that is larger.
    Geometries that were used again take at most a tenth of the memory that is free when the first one is
    stored, but not less than 128 MiB and not more than 1 GiB. The least recently used is dropped first. Each GPU has a
    store of its own, with bounds that follow from its memory.

    Parameters
    ----------
    maximum_bytes : int or None
        Largest sum of kernel sizes to hold on each device, in bytes. None sets the default again.

    Raises
    ------
    ValueError
        If `maximum_bytes` is negative.
    TypeError
        If `maximum_bytes` is not an integer.

    Examples
    --------
    >>> import odak
    >>> odak.wave.set_kernel_cache_size(2**30)
    >>> try:
    ...     odak.wave.set_kernel_cache_size(-1)
    ... except ValueError:
    ...     print("not a size")
    not a size
    """
    kernels.resize(None if maximum_bytes is None else _validate.integer("maximum_bytes", maximum_bytes))


@dataclass(frozen=True)
class Request:
    """Geometry and options of one propagation.

    `distance`, `wavelength` and `dx` are numbers or arrays that broadcast against the field's leading axes; a tuple or
    list `dx` holds the pitches along rows and columns. `window` says that the field is to be filtered on a grid of
    twice its size, of which only its own window is kept; `judged`, that the caller predicts the error for its field.
    """

    dx: Any
    wavelength: Amount
    distance: Amount
    aperture: Any = 1.0
    kernel: Any = None
    scale: int = 1
    samples: tuple[int, int, int, int] = (1, 1, 1, 1)
    window: bool = False
    tolerance: float = 1e-4
    judged: bool = False

    def is_plain(self) -> bool:
        """Return whether the geometry is known as numbers, so that a kernel can be kept."""
        return not any(_array.is_traced(value) for value in self._lengths())

    def size(self, field: Array, linear: bool = False) -> tuple[int, int]:
        """Return rows and columns of a transfer function: twice those of a field on its own window."""
        finer, (rows, columns) = 2 if linear or self.window else 1, field.shape[-2:]
        return finer * rows, finer * columns

    def _lengths(self) -> tuple[Any, ...]:
        return (*pitches(self.dx), self.wavelength, self.distance)

    def grid(self, shape: tuple[int, int], xp: ModuleType, device: Device, dtype: DType) -> Grid:
        """Return the grid of `shape` for this geometry."""
        *pitch, wavelength, distance = (_column(value, xp, device) for value in self._lengths())
        evanescent = self._may_be_evanescent()
        return Grid(shape, tuple(pitch), wavelength, distance, xp, device, dtype, self.scale, self.samples, evanescent)

    def _may_be_evanescent(self) -> bool:
        if not self.is_plain():
            return True
        highest = [self.scale / (2 * np.min(_numbers(value))) for value in pitches(self.dx)]
        return bool(np.max(_numbers(self.wavelength)) * math.hypot(*highest) >= 1)

    @functools.cached_property
    def geometry(self) -> bytes | None:
        """Return the lengths in a form that can be looked up, None if they are not known as numbers."""
        if not self.is_plain():
            return None
        lengths = [_numbers(value) for value in self._lengths()]
        return repr([value.shape for value in lengths]).encode() + b"".join(value.tobytes() for value in lengths)

    def transfer_function(
        self, build: Callable, shape: tuple[int, int], xp: ModuleType, device: str, dtype: DType
    ) -> Array:
        """Return `build(grid)`, kept for the next call when the geometry is known as numbers."""
        if self.geometry is None:
            return build(self.grid(shape, xp, device, dtype))

        def fresh():
            with outside_inference(xp):
                return build(self.grid(shape, xp, device, dtype))

        key = (build, shape, self.geometry, self.scale, self.samples, xp, device, dtype)
        kept = kernels.on(device).get(key, fresh)
        if _array.is_torch(kept):
            from odak import _torch_private

            return _torch_private.kept_constant(kept)
        return kept

    def kernel_for(self, field: Array, build: Callable[..., Any], shape: tuple[int, int]) -> Array:
        """Return the transfer function in the field's library, device and precision, and in chunks as the field is."""
        if _array.is_chunked(field):
            return transfer_function_in_chunks(self, build, shape, field.dtype)
        return self.transfer_function(build, shape, _array.namespace(field), _array.device_of(field), field.dtype)


def _numbers(value) -> np.ndarray:
    if _array.is_array(value) and not isinstance(value, np.ndarray):
        value = value.tolist()
    return np.asarray(value, dtype=np.float64)


def _column(value, xp, device):
    array = value if _array.is_array(value) and _array.namespace(value) is xp else _numbers(value)
    if isinstance(array, np.ndarray) and array.ndim == 0:
        # A GPU fills memory without waiting; it waits for a copy.
        return xp.full((1, 1), float(array), dtype=xp.float64, device=device)
    if isinstance(array, np.ndarray) or not _array.is_torch(array):
        array = xp.asarray(array, dtype=xp.float64, device=device)
    else:
        array = array.to(device=device, dtype=xp.float64)
    return xp.reshape(array, (*array.shape, 1, 1))


def outside_inference(xp: ModuleType) -> Any:
    """Return a context in which a tensor made may later be used by autograd, whatever mode the caller is in."""
    if "torch" not in xp.__name__:
        return nullcontext()
    from odak import _torch_private

    return _torch_private.keeping()


def pitches(dx: Any, name: str = "dx") -> tuple[Any, Any]:
    """Return the pixel pitch along rows and columns.

    A tuple or list of two holds the pitches (rows, columns). A number serves both axes, and so does an array or a
    tensor, which holds one pitch for each field of a batch.
    """
    if not isinstance(dx, (tuple, list)):
        return dx, dx
    if len(dx) != 2:
        raise ValueError(f"{name} must be a number, a pair (rows, columns) or an array, got {len(dx)} values")
    return dx[0], dx[1]


def checked_pitch(name: str, dx: Any) -> float:
    """Return a pitch, one number or a pair (rows, columns), after checking that it is positive."""
    for pitch in pitches(dx, name):
        _validate.real(name, pitch, positive=True)
    return dx


def divided_pitch(dx: Any, samples: int) -> Any:
    """Return the pitch, or the pair of them, of a grid with so many samples per pixel."""
    return tuple(pitch / samples for pitch in dx) if isinstance(dx, (tuple, list)) else dx / samples


def check_geometry(
    k: Amount | None, distance: Amount | None, dx: Any, wavelength: Amount, batch: tuple[int, ...] | None = None
) -> None:
    """Raise ValueError or TypeError unless the geometry is physical, fits a batch of fields, and k the wavelength.

    `batch` holds the leading axes of the field, None where there is no field.
    """
    _validate.real("distance", distance)
    rows, columns = (_validate.real("dx", value, positive=True) for value in pitches(dx))
    _validate.real("wavelength", wavelength, positive=True)
    shapes = {name: _shape(value) for name, value in (("distance", distance), ("dx", rows), ("wavelength", wavelength))}
    shapes["dx[1]"] = _shape(columns)
    for name, shape in shapes.items():
        if 0 in shape:
            raise ValueError(f"{name} must contain at least one number, got the shape {shape}")
    if any(shapes.values()):
        _validate.fitting(field=batch or (), **shapes)
        _warn_of_pixel_axes(batch or (), shapes)
    for shape in (shapes["dx"], shapes["dx[1]"]):
        if batch is not None and not _fits_within(shape, batch):
            raise ValueError(
                "dx must be one number, a pair (rows, columns), or an array with one pitch for each field of the "
                f"batch; got an array of shape {shape} for the leading axes {batch} of field"
            )
    if k is None:
        return
    if not (_array.is_torch(wavelength) and wavelength.requires_grad):
        _validate.constants(k=k)
    _validate.real("k", k)
    if not (_array.is_readable(k) and _array.is_readable(wavelength)):
        return
    numbers, lengths = _validate.numbers(k), _validate.numbers(wavelength)
    if len(numbers) != len(lengths) and 1 not in (len(numbers), len(lengths)):
        raise ValueError(f"k must be one number or one for each of {len(lengths)} wavelengths, got {len(numbers)}")
    count = max(len(numbers), len(lengths))
    for number, length in zip(*(v * count if len(v) == 1 else v for v in (numbers, lengths)), strict=True):
        expected = 2 * math.pi / length
        if not abs(number - expected) <= _ROUNDED_PI * expected:
            raise ValueError(
                f"k must be 2π/wavelength = {expected:.9g} for wavelength {length!r}, or None; got {number!r}"
            )
        if abs(number - expected) > 1e-6 * expected:
            _log.info("k is 2π/wavelength = %.9g for wavelength %r; %r was given", expected, length, number)


def _warn_of_pixel_axes(batch: tuple[int, ...], shapes: dict[str, tuple[int, ...]]) -> None:
    """Warn of lengths that have axes for rows and columns too: fields would multiply in number."""
    for name, shape in shapes.items():
        whole = np.broadcast_shapes(batch, shape)
        if whole != batch and batch and shape[-2:] == (1, 1) and _fits_within(shape[:-2], batch):
            warn(
                f"{name} broadcasts against the leading axes of field without its rows and columns: with the shape "
                f"{shape} fields {batch} become {whole}; give the shape {shape[:-2]} for one for each field",
                ArgumentWarning,
            )


def _fits_within(shape: tuple[int, ...], batch: tuple[int, ...]) -> bool:
    """Return whether `shape` broadcasts to `batch` without enlarging it."""
    own = (1,) * (len(shape) - len(batch)) + batch
    return all(n in (1, m) for n, m in zip(reversed(shape), reversed(own), strict=False))


def _shape(value) -> tuple[int, ...]:
    return (len(value),) if isinstance(value, (list, tuple)) else tuple(getattr(value, "shape", ()))


def sample_counts(samples: Any, name: str = "samples") -> tuple[int, int, int, int]:
    """Return the four sample counts of an impulse response as integers."""
    listed = isinstance(samples, Iterable) and not isinstance(samples, str)
    counts = tuple(samples) if listed else (samples,)
    if len(counts) != 4:
        raise ValueError(f"{name} must be four counts [source rows, columns, target rows, columns], got {samples!r}")
    a, b, c, d = (_validate.whole(name, count, minimum=1) for count in counts)
    return a, b, c, d


def make_grid(
    nu: Any,
    nv: Any,
    dx: Any,
    wavelength: Amount,
    distance: Amount,
    scale: Any = 1,
    samples: Any = (1, 1, 1, 1),
    *,
    xp: ModuleType | None = None,
    device: Device = None,
    dtype: DType = None,
) -> Grid:
    """Return the sampling grid of a kernel after checking its arguments."""
    size = _validate.size("nu, nv", (nu, nv))
    check_geometry(None, distance, dx, wavelength)
    scale = _validate.integer("scale", scale, minimum=1)
    xp, device, _ = _array.placement(*pitches(dx), wavelength, distance, xp=xp, device=device)
    request = Request(dx, wavelength, distance, scale=scale, samples=sample_counts(samples))
    return request.grid((scale * size[0], scale * size[1]), xp, device, _complex_dtype(dtype, xp))


def _complex_dtype(dtype, xp):
    for name in ("complex64", "complex128"):
        if name in str("complex64" if dtype is None else dtype):
            return getattr(xp, name)
    raise TypeError(f"dtype must be complex64 or complex128, got {dtype!r}")


def separable_impulse_response(grid: Grid) -> Any:
    """Return the Fresnel kernel (H, h, h_x, h_y), all centred: transfer function, impulse response and its factors."""
    xp = grid.xp
    constant, h_y, h_x = impulse_response_factors(grid)
    response = xp.astype(constant * h_y * h_x, grid.dtype)
    h_y, h_x = (xp.reshape(xp.astype(factor, grid.dtype), (-1,)) for factor in (h_y, h_x))
    kernel = xp.fft.fftshift(impulse_response_fresnel(grid), axes=(-2, -1))
    return kernel, xp.fft.fftshift(response, axes=(-2, -1)), xp.fft.fftshift(h_x), xp.fft.fftshift(h_y)


def convolve(field: Array, kernel: Any) -> Any:
    """Return the field filtered by `kernel`, on the field's own window.

    The field ``[..., m, n]`` is continued by zeros to the kernel's size ``[..., M, N]`` (M ≥ m, N ≥ n), transformed,
    multiplied by the kernel (FFT order), transformed back and cut to ``[..., m, n]`` again. Cyclic convolution is
    independent of the position of the window, which starts at index 0, so that nothing is shifted; rows that are zero
    are not transformed going in, rows that are cut are not transformed coming out.

    Parameters
    ----------
    field : array
        Complex ``[..., m, n]``.
    kernel : array
        Complex ``[..., M, N]``; leading axes broadcast.

    Returns
    -------
    array
        Complex ``[..., m, n]``, in the field's dtype.
    """
    if _array.is_torch(field):
        import odak.wave.torch_convolution as operator

        return operator.convolve(field, kernel)
    if _array.is_chunked(field):
        return convolve_in_chunks(field, kernel)
    return (_convolve_arrays if type(field) is np.ndarray else convolve_plainly)(field, kernel)


def _convolve_arrays(field, kernel):
    """Return :func:`convolve` of NumPy arrays by the transforms of SciPy, which are quicker in single precision."""
    fft, (rows, columns) = scipy.fft, field.shape[-2:]
    spectrum = fft.fft(field, n=kernel.shape[-1], axis=-1)
    spectrum = fft.fft(spectrum, n=kernel.shape[-2], axis=-2, overwrite_x=True)
    if kernel.dtype == spectrum.dtype and kernel.ndim == 2:
        spectrum *= kernel
    else:
        spectrum = spectrum * kernel
    window = fft.ifft(spectrum, axis=-2, overwrite_x=True)[..., :rows, :]
    window = fft.ifft(window, axis=-1)[..., :columns]
    # A copy: a view would keep the rows of twice the length.
    return window.astype(field.dtype)


# What computes convolutions of Dask arrays in place of the graph below, see odak.wave.propagate_on_disk.
by_way_of: ContextVar[Callable[..., Any] | None] = ContextVar("by_way_of", default=None)


def convolve_in_chunks(field: Array, kernel: Any) -> Any:
    """Return :func:`convolve` of Dask arrays in chunks of any shape, in chunks of whole rows; nothing is computed yet.

    The transform along an axis needs whole lines of that axis: the field is laid out in chunks of whole rows, then of
    whole columns, where it meets the kernel, and of whole rows again.
    """
    from dask.array import fft

    if (way := by_way_of.get()) is not None:
        return way(field, kernel)
    size, (rows, columns) = kernel.shape[-2:], field.shape[-2:]
    spectrum = fft.fft(whole_lines(field, -1, size[1]), n=size[1], axis=-1)
    spectrum = fft.fft(whole_lines(spectrum, -2, size[0]), n=size[0], axis=-2)
    spectrum = spectrum * kernel.rechunk({-1: spectrum.chunks[-1], -2: -1})
    window = fft.ifft(spectrum, axis=-2)[..., :rows, :]
    window = fft.ifft(whole_lines(window, -1, size[1]), axis=-1)
    return window[..., :columns].astype(field.dtype)


def whole_lines(field: Any, axis: int, length: int, dtype: DType = None) -> Any:
    """Return a Dask array in chunks of whole lines along `axis`: as many as fill a chunk at this length and dtype."""
    other = -3 - axis
    lines = lines_per_chunk(length, field.dtype if dtype is None else dtype)
    # Fields of a batch are in chunks of their own.
    layout = dict.fromkeys(range(field.ndim - 2), 1)
    return field.rechunk({**layout, axis: -1, other: min(lines, field.shape[other])})


def lines_per_chunk(length: int, dtype: Any) -> int:
    """Return how many lines of `length` samples fill a chunk of Dask's setting "array.chunk-size"."""
    from dask import config
    from dask.utils import parse_bytes

    return max(1, parse_bytes(config.get("array.chunk-size")) // (length * np.dtype(dtype).itemsize))


def upsample(field: Array) -> Any:
    """Return the band-limited interpolation of a field on twice as many samples (half the pitch), same centre."""
    xp = _array.namespace(field)
    axes = (-2, -1)
    rows, columns = field.shape[-2:]
    spectrum = xp.fft.fftshift(xp.fft.fftn(xp.fft.ifftshift(field, axes=axes), axes=axes), axes=axes)
    spectrum = xp.fft.ifftshift(zero_pad(spectrum, [2 * rows, 2 * columns]), axes=axes)
    return xp.astype(4 * xp.fft.fftshift(xp.fft.ifftn(spectrum, axes=axes), axes=axes), field.dtype, copy=False)


@dataclass(frozen=True)
class ColumnGrid(Grid):
    """A grid of which only the columns from `start` to `stop`, in FFT order, are evaluated."""

    start: int = 0
    stop: int = 0

    def _indices(self, n: int, axis: int):
        if axis == 0:
            return super()._indices(n, axis)
        indices = self.xp.arange(self.start, self.stop, dtype=self.xp.float64, device=self.device)
        return self.xp.reshape(self.xp.minimum(indices, n - indices), (1, -1))

    def unfold(self, quarter: Any) -> Any:
        """Return all rows of the columns evaluated, in FFT order."""
        return self.xp.take(quarter, self._mirror(self.shape[0]), axis=-2)


def transfer_function_in_chunks(
    request: Request, build: Callable[..., Any], shape: tuple[int, int], dtype: np.dtype
) -> Any:
    """Return the transfer function of a method as a Dask array, each chunk of columns computed where it is used.

    Parameters
    ----------
    request : Request
        The geometry, in numbers or NumPy arrays.
    build : callable
        Transfer function of a method, a function of a :class:`Grid`.
    shape : tuple of int
        Rows and columns of the (padded) grid.
    dtype : numpy.dtype
        Complex dtype.
    """
    import dask.array as da

    grid = request.grid(shape, numpy_namespace, None, np.dtype(dtype))
    if build is impulse_response_fresnel:
        along_y, along_x = (da.from_array(factor, chunks=-1) for factor in impulse_response_spectra(grid))
        return along_y * along_x.rechunk({-1: lines_per_chunk(shape[0], dtype)})
    if build is rayleigh_sommerfeld:
        response = _evaluate_in_chunks(replace(grid, dtype=np.dtype(np.complex128)), rayleigh_sommerfeld_samples)
        spectrum = da.fft.fft(response, axis=-2)
        spectrum = da.fft.fft(whole_lines(spectrum, -1, shape[1]), axis=-1)
        # At no distance every frequency passes.
        return da.where(grid.distance == 0, 1.0, spectrum).astype(dtype)
    return _evaluate_in_chunks(grid, build)


def _evaluate_in_chunks(grid: Grid, build: Callable[..., Any]):
    """Return `build` of a grid as a Dask array in chunks of whole columns."""
    import dask.array as da

    values = {field.name: getattr(grid, field.name) for field in fields(grid)}
    batch = np.broadcast_shapes(*(np.shape(v)[:-2] for v in (grid.wavelength, grid.distance, *grid.pitch)))
    columns = da.core.normalize_chunks(lines_per_chunk(grid.shape[0], grid.dtype), (grid.shape[1],))

    def part(block_info):
        start, stop = block_info[None]["array-location"][-1]
        return np.broadcast_to(
            build(ColumnGrid(**values, start=start, stop=stop)), (*batch, grid.shape[0], stop - start)
        )

    chunks = (*((n,) for n in batch), (grid.shape[0],), *columns)
    return da.map_blocks(part, chunks=chunks, dtype=grid.dtype, meta=np.empty((0,) * len(chunks), grid.dtype))
