"""Transfer functions computed a chunk of columns at a time, for fields larger than memory held as Dask arrays."""

from collections.abc import Callable
from dataclasses import dataclass, fields, replace

import numpy as np

from odak._array import numpy_namespace
from odak.wave import transfer_functions as tf
from odak.wave.convolution import lines_per_chunk, whole_lines


@dataclass(frozen=True)
class ColumnGrid(tf.Grid):
    """A grid of which only the columns from `start` to `stop`, in FFT order, are evaluated."""

    start: int = 0
    stop: int = 0

    def _indices(self, n: int, axis: int):
        if axis == 0:
            return super()._indices(n, axis)
        indices = self.xp.arange(self.start, self.stop, dtype=self.xp.float64, device=self.device)
        return self.xp.reshape(self.xp.minimum(indices, n - indices), (1, -1))

    def unfold(self, quarter):
        """Return all rows of the columns evaluated, in FFT order."""
        return self.xp.take(quarter, self._mirror(self.shape[0]), axis=-2)


def transfer_function(request: tf.Request, build: Callable, shape: tuple[int, int], dtype):
    """Return the transfer function of a method as a Dask array, each chunk of columns computed where it is used.

    Parameters
    ----------
    request : Request
        The geometry, in numbers or NumPy arrays.
    build : callable
        Transfer function of a method, a function of a :class:`odak.wave.transfer_functions.Grid`.
    shape : tuple of int
        Rows and columns of the (padded) grid.
    dtype : numpy.dtype
        Complex dtype.
    """
    import dask.array as da

    grid = request.grid(shape, numpy_namespace, None, np.dtype(dtype))
    if build is tf.impulse_response_fresnel:
        along_y, along_x = (da.from_array(factor, chunks=-1) for factor in tf.impulse_response_spectra(grid))
        return along_y * along_x.rechunk({-1: lines_per_chunk(shape[0], dtype)})
    if build is tf.rayleigh_sommerfeld:
        response = _evaluate(replace(grid, dtype=np.dtype(np.complex128)), tf.rayleigh_sommerfeld_samples)
        spectrum = da.fft.fft(response, axis=-2)
        spectrum = da.fft.fft(whole_lines(spectrum, -1, shape[1]), axis=-1)
        # At no distance every frequency passes.
        return da.where(grid.distance == 0, 1.0, spectrum).astype(dtype)
    return _evaluate(grid, build)


def _evaluate(grid: tf.Grid, build: Callable):
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
