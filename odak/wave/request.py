"""One propagation as asked for: geometry, options, and the cached way to its kernel."""

from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import dataclass
from typing import Any

import numpy as np

from odak import _array
from odak.wave.grid import Grid
from odak.wave.kernel_cache import kernels


@dataclass(frozen=True)
class Request:
    """Geometry and options of one propagation.

    `distance`, `wavelength` and `dx` are numbers or arrays; arrays of distances and wavelengths broadcast against the
    field's leading axes. `window` says that the field is to be filtered on a grid of twice its size, of which only
    its own window is kept.
    """

    dx: Any
    wavelength: Any
    distance: Any
    aperture: Any = 1.0
    kernel: Any = None
    scale: int = 1
    samples: tuple[int, int, int, int] = (1, 1, 1, 1)
    window: bool = False

    def is_plain(self) -> bool:
        """Say whether the geometry is known as numbers, so that a kernel can be kept."""
        return not any(_array.is_traced(value) for value in (self.dx, self.wavelength, self.distance))

    def grid(self, shape: tuple[int, int], xp, device, dtype) -> Grid:
        """Return the grid of `shape` for this geometry."""
        dx, wavelength, distance = (_column(value, xp, device) for value in (self.dx, self.wavelength, self.distance))
        return Grid(
            shape, dx, wavelength, distance, xp, device, dtype, self.scale, self.samples, self._may_be_evanescent()
        )

    def _may_be_evanescent(self) -> bool:
        if not self.is_plain():
            return True
        return bool(np.max(_numbers(self.wavelength)) >= np.sqrt(2) * np.min(_numbers(self.dx)) / self.scale)

    def transfer_function(self, build: Callable, shape: tuple[int, int], xp, device, dtype):
        """Return `build(grid)`, kept for the next call when the geometry is known as numbers."""
        if not self.is_plain():
            return build(self.grid(shape, xp, device, dtype))
        geometry = tuple((_numbers(v).shape, _numbers(v).tobytes()) for v in (self.dx, self.wavelength, self.distance))
        key = (build, shape, geometry, self.scale, self.samples, xp.__name__, str(device), str(dtype))

        def fresh():
            with _outside_inference(xp):
                return build(self.grid(shape, xp, device, dtype))

        return kernels.get(key, fresh)

    def kernel_for(self, field, build: Callable, shape: tuple[int, int]):
        """Return the transfer function in the field's library, device and precision."""
        xp = _array.namespace(field)
        return self.transfer_function(build, shape, xp, _array.device_of(field), field.dtype)


def _numbers(value) -> np.ndarray:
    if _array.is_array(value) and not isinstance(value, np.ndarray):
        value = value.tolist()
    return np.asarray(value, dtype=np.float64)


def _column(value, xp, device):
    array = value if _array.is_array(value) and _array.namespace(value) is xp else _numbers(value)
    if isinstance(array, np.ndarray) or not _array.is_torch(array):
        array = xp.asarray(array, dtype=xp.float64, device=device)
    else:
        array = array.to(device=device, dtype=xp.float64)
    return xp.reshape(array, (*array.shape, 1, 1))


def _outside_inference(xp):
    """Return a context in which a tensor made may later be used by autograd, whatever mode the caller is in."""
    if "torch" not in xp.__name__:
        return nullcontext()
    import torch

    return torch.inference_mode(False)
