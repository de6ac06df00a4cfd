"""A propagation larger than the memory given to it, beside the bare transforms in chunks, and its rows checked.

    python benchmarks/larger_than_memory.py [SIDE] [--memory 3GiB] [--folder FOLDER]

A field of SIDE × SIDE samples in complex64, padded to twice its size, is computed by two worker processes of so much
memory each, which write to disk what exceeds it, and stored as a Zarr array. The field is a sum of three products of
random vectors along y and x, so that single rows of the exact result follow from sums in double precision. Prints wall
and processor time, the peak of the processes' own memory and of the folder on disk, and the deviation of four rows.
"""

import argparse
import shutil
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path

import dask
import dask.array as da
import numpy as np
import psutil
from distributed import Client, LocalCluster
from large import bare

from odak.wave import propagate_beam

DISTANCE, PITCH, WAVELENGTH = 0.05, 4e-6, 532e-9
GIBIBYTE = 2**30


def factors(side: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the vectors along y and x, complex64 ``[3, side]`` each."""
    generator = np.random.default_rng(0)
    parts = generator.normal(size=(2, 2, 3, side)).astype(np.float32)
    along_y, along_x = parts[0] + 1j * parts[1]
    return along_y, along_x


def field_of(side: int):
    """Return the field in chunks, which are computed where they are used."""
    along_y, along_x = factors(side)

    def part(block_info):
        (top, bottom), (left, right) = block_info[None]["array-location"]
        return along_y[:, top:bottom].T @ along_x[:, left:right]

    chunks = da.core.normalize_chunks(2048, (side, side))
    return da.map_blocks(part, chunks=chunks, dtype=np.complex64, meta=np.empty((0, 0), np.complex64))


def rows_of_result(side: int, rows: np.ndarray, step: int = 64) -> np.ndarray:
    """Return some rows of the propagated field, by sums over frequencies in double precision."""
    size = 2 * side
    spectra_y, spectra_x = (np.fft.fft(vectors.astype(np.complex128), size) for vectors in factors(side))
    squared = np.fft.fftfreq(size, PITCH) ** 2
    waves = np.exp(2j * np.pi * np.outer(rows, np.arange(size)) / size) / size
    weights = (waves[:, None] * spectra_y).reshape(-1, size)
    result = np.zeros((len(rows), size), complex)
    for start in range(0, side + 1, step):
        columns = np.arange(start, min(start + step, side + 1))
        transfer = np.exp(2j * np.pi * DISTANCE * np.sqrt(1 / WAVELENGTH**2 - squared[:, None] - squared[columns] + 0j))
        sums = (weights @ transfer).reshape(len(rows), 3, -1)
        # The transfer function is even.
        for places in (columns, -columns % size):
            result[:, places] = (sums * spectra_x[:, places]).sum(1)
    return np.fft.ifft(result)[:, :side]


def measured(task: Callable, folder: Path) -> dict[str, float]:
    """Return seconds of wall and processor and the peaks of memory and disk in bytes while a task runs."""
    workers = psutil.Process().children(recursive=True)
    done, memory, disk = threading.Event(), [0], [0]

    def watch():
        while not done.wait(0.5):
            memory.append(sum(worker.memory_full_info().uss for worker in workers if worker.is_running()))
            disk.append(_size_of(folder))

    def seconds() -> float:
        return sum(sum(worker.cpu_times()[:2]) for worker in workers if worker.is_running())

    watching = threading.Thread(target=watch)
    before, start = seconds(), time.perf_counter()
    watching.start()
    task()
    wall, processor = time.perf_counter() - start, seconds() - before
    done.set()
    watching.join()
    return {"wall": wall, "processor": processor, "memory": max(memory), "disk": max(disk)}


def _size_of(folder: Path) -> int:
    total = 0
    for path in folder.rglob("*"):
        try:
            total += path.stat().st_blocks * 512
        except FileNotFoundError:  # removed in the meantime
            continue
    return total


def main() -> None:
    """Print a line for each of the two, and the deviation of the rows."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("side", nargs="?", type=int, default=8192)
    parser.add_argument("--memory", default="3GiB", help="of each of the two workers")
    parser.add_argument("--folder", help="where to write, that of temporary files by default")
    arguments = parser.parse_args()
    side, field = arguments.side, field_of(arguments.side)
    geometry = (None, DISTANCE, PITCH, WAVELENGTH, "Angular Spectrum")
    tasks = {
        "propagation": lambda: propagate_beam(field, *geometry, zero_padding=(True, False, True)),
        "bare transforms": lambda: bare(field, (2 * side, 2 * side)),
    }
    rows = np.array([0, side // 3, side // 2 + 1, side - 1])
    figures = {}
    print(f"{side}², field {field.nbytes / GIBIBYTE:.1f} GiB, padded {4 * field.nbytes / GIBIBYTE:.1f} GiB", flush=True)
    with tempfile.TemporaryDirectory(dir=arguments.folder, ignore_cleanup_errors=True) as name:
        folder = Path(name)
        options = {"n_workers": 2, "threads_per_worker": 1, "memory_limit": arguments.memory, "host": "127.0.0.1"}
        with (
            dask.config.set({"temporary-directory": name}),
            LocalCluster(**options, dashboard_address=None, local_directory=name) as cluster,
            Client(cluster),
        ):
            for task, build in tasks.items():
                # Dask chooses how chunks are laid out anew by whether there is a cluster.
                array, path = build(), folder / "result.zarr"
                found = figures[task] = measured(lambda array=array, path=path: array.to_zarr(str(path)), folder)
                print(
                    f"{task}: {found['wall']:.0f} s, {found['processor']:.0f} s of the processor, at the peak "
                    f"{found['memory'] / GIBIBYTE:.1f} GiB of memory and {found['disk'] / GIBIBYTE:.1f} GiB on disk",
                    flush=True,
                )
                if task == "propagation":
                    stored = da.from_zarr(str(path))
                    result = np.stack([stored[row].compute(scheduler="synchronous") for row in rows])
                shutil.rmtree(path)
    ratios = [figures["propagation"][key] / figures["bare transforms"][key] for key in ("wall", "processor")]
    print(f"ratio {ratios[0]:.2f}, of processor time {ratios[1]:.2f}", flush=True)
    expected = rows_of_result(side, rows)
    print(f"greatest deviation of rows {', '.join(map(str, rows))}, over the greatest modulus: "
          f"{np.abs(result - expected).max() / np.abs(expected).max():.1e}")  # fmt: skip


if __name__ == "__main__":
    main()
