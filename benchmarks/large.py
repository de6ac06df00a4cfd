"""Benchmarks of fields in chunks: a propagation against the bare transforms in chunks, without a transfer function."""

from collections.abc import Iterator

import dask
import dask.array as da
import numpy as np
from measure import interleave
from wave_optics import row

from odak.wave import propagate_beam

SIDE = 4096
CHUNKS = "16 MiB"


def bare(field, size: tuple[int, int]):
    """Return the field transformed to the padded size and back, by Dask's transforms and its `rechunk` alone."""
    rows, columns = field.shape
    spectrum = da.fft.fft(field.rechunk({0: "auto", 1: -1}), n=size[1], axis=1)
    spectrum = da.fft.fft(spectrum.rechunk({0: -1, 1: "auto"}), n=size[0], axis=0)
    back = da.fft.ifft(spectrum, axis=0)[:rows].rechunk({0: "auto", 1: -1})
    return da.fft.ifft(back, axis=1)[:, :columns]


def propagation(device: str) -> Iterator[dict]:
    """Yield a padded propagation of a field in chunks; on the CPU only."""
    if device != "cpu":
        return
    chunk = 512
    field = da.random.default_rng(0).normal(size=(SIDE, SIDE), chunks=chunk).astype(np.complex64).persist()
    with dask.config.set({"array.chunk-size": CHUNKS}):
        ours = propagate_beam(field, None, 0.05, 4e-6, 532e-9, "Angular Spectrum", None, (True, False, True))
        floor = bare(field, (2 * SIDE, 2 * SIDE))
        # A sum replaces the result, which need not fit in memory.
        tasks = {"ours": lambda: abs(ours).sum().compute(), "floor": lambda: abs(floor).sum().compute()}
        timings = interleave(tasks, runs=3)
    yield row(
        f"propagation in chunks, {SIDE}²", timings["ours"].best, timings["floor"].best, "transforms in chunks", 3.0
    )


ALL = (propagation,)
