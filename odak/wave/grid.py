"""The sampling grid of a propagation: frequencies and positions in FFT order, and the even symmetry of kernels."""

from collections.abc import Callable
from dataclasses import dataclass
from types import ModuleType
from typing import Any

from odak import _array

_SLAB = 1 << 17


@dataclass(frozen=True)
class Grid:
    """Where and with what a transfer function is sampled.

    All kernels of free space are even in both axes, so that they are evaluated on the quarter of non-negative
    indices (0 … n // 2) and unfolded by :meth:`unfold`.

    Attributes
    ----------
    shape : tuple of int
        Rows and columns of the (padded) grid.
    dx, wavelength, distance : array
        float64, shaped ``[..., 1, 1]`` so that they broadcast against ``[rows, columns]``.
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
    dx: Any
    wavelength: Any
    distance: Any
    xp: ModuleType
    device: Any
    dtype: Any
    scale: int = 1
    samples: tuple[int, int, int, int] = (1, 1, 1, 1)
    evanescent: bool = True

    def _indices(self, n: int, axis: int):
        indices = self.xp.arange(n // 2 + 1, dtype=self.xp.float64, device=self.device)
        return self.xp.reshape(indices, (-1, 1) if axis == 0 else (1, -1))

    def frequencies(self):
        """Return the non-negative DFT frequencies (rows as ``[..., r, 1]``, columns as ``[..., 1, c]``) in 1/m."""
        return tuple(self._indices(n, axis) / (n * self.dx) for axis, n in enumerate(self.shape))

    def positions(self):
        """Return the non-negative sample positions, like :meth:`frequencies`, in metres."""
        return tuple(self._indices(n, axis) * (self.dx / self.scale) for axis, n in enumerate(self.shape))

    def evaluate(self, kernel: Callable):
        """Return ``kernel(fy, fx)`` on the whole grid, evaluated on its quarter a slab of rows at a time.

        A dozen intermediate results in float64 would otherwise take more memory than the kernel itself.
        """
        fy, fx = self.frequencies()
        step = max(1, _SLAB // fx.shape[-1])
        rows = fy.shape[-2]
        slabs = [kernel(fy[..., start : min(start + step, rows), :], fx) for start in range(0, rows, step)]
        return self.unfold(slabs[0] if len(slabs) == 1 else self.xp.concat(slabs, axis=-2))

    def unfold(self, quarter):
        """Return the whole kernel in FFT order from its quarter of non-negative indices.

        A torch kernel is laid out column by column, which is the order the blocked propagation reads it in.
        """
        rows, columns = (self._mirror(n) for n in self.shape)
        if not _array.is_torch(quarter):
            return self.xp.take(self.xp.take(quarter, rows, axis=-2), columns, axis=-1)
        half = quarter.mT.index_select(-2, columns)
        return half.index_select(-1, rows).mT

    def _mirror(self, n: int):
        indices = self.xp.arange(n, device=self.device)
        return self.xp.minimum(indices, n - indices)

    def unfold_axis(self, half, axis: int):
        """Return a one-dimensional even function along `axis` (-1 or -2) in FFT order from its non-negative half."""
        return self.xp.take(half, self._mirror(self.shape[axis]), axis=axis)
