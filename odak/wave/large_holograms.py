"""Fields and phase-only holograms larger than memory, on arrays stored in chunks on disk."""

import json
import math
import os
import shutil
import tempfile
import zlib
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
from scipy import fft

from odak import _array, _validate
from odak._array import Array, ChunkedArray
from odak._bars import tqdm
from odak._warnings import AccuracyWarning, warn
from odak.tools.paths import validate_path
from odak.wave.methods import find_method
from odak.wave.propagation import propagate_beam
from odak.wave.transfer_functions import by_way_of, pitches, whole_lines

_ON_DISK = (
    "Bandlimited Angular Spectrum",
    "Angular Spectrum",
    "Transfer Function Fresnel",
    "Impulse Response Fresnel",
)
METHODS = ("gradient descent", "Gerchberg-Saxton")
_DECAYS = (0.9, 0.999)
# Damaged chunks that a warning names.
_NAMED = 5


@_validate.takes_units("distance", "dx", "wavelength")
def hologram_in_chunks(
    target: Array,
    folder: str | os.PathLike[str],
    iterations: int,
    distance: float,
    dx: float | tuple[float, float],
    wavelength: float,
    propagation_type: str = "Bandlimited Angular Spectrum",
    method: str = "gradient descent",
    learning_rate: float = 0.1,
    initial_phase: Array | None = None,
    progress: bool = True,
) -> ChunkedArray:
    """Compute a phase-only hologram of an image that may be larger than memory, its state being kept on disk.

    After each iteration the state is stored in `folder`, in Zarr's format; what the one before had stored is removed
    then. A run that was interrupted goes on from the last whole iteration when it is called again, and so does a
    finished one that is called with more iterations. Each chunk is compared with its checksum before; if one is missing
    or was changed, it is named and the iterations that led to it are computed again.

    Parameters
    ----------
    target : dask.array.Array or array
        Intensity of the image ``[rows, columns]``, not negative. It is read once in each iteration.
    folder : path
        Folder of the state, made if it does not exist. It holds one float32 array of the target's size with
        "Gerchberg-Saxton", three with "gradient descent", and twice as much while an iteration is stored.
    iterations : int
        Number of iterations, earlier calls included.
    distance : float
        Distance from the hologram to the image in metres.
    dx : float or pair of float
        Pixel pitch in metres, one number or (rows, columns).
    wavelength : float
        Wavelength in metres.
    propagation_type : str
        A method of :func:`odak.wave.propagate_beam` that takes Dask arrays. Fields are padded to twice their size.
    method : {"gradient descent", "Gerchberg-Saxton"}
        Adam on the phase against the mean square of the difference of amplitudes, or alternating projections.
    learning_rate : float
        Step of gradient descent in radians.
    initial_phase : array, optional
        Phase ``[rows, columns]`` in radians to start from; by default a weak lens, which moves the light by up
        to an eighth of the sampling frequency at the edges.
    progress : bool
        Show a progress bar with the loss.

    Returns
    -------
    dask.array.Array
        Phase of the hologram ``[rows, columns]`` in radians, float32, read from `folder` where it is used.

    Raises
    ------
    ValueError
        If an argument is outside its range, or `folder` holds the state of another problem: other lengths or another
        image, as far as some of its rows tell.
    TypeError
        If an argument is of a wrong kind.
    ImportError
        If Dask or Zarr is not installed.

    Warns
    -----
    SamplingWarning
        If the propagation is outside the method's range.
    AccuracyWarning
        If the state in `folder` is damaged, naming its chunks.

    Notes
    -----
    With the propagation A, the field u = A·exp(iφ) and the target amplitude a, both methods take the correction
    g = Aᴴ[(|u| − s·a)·u/|u|], two propagations: Gerchberg–Saxton goes to the phase of exp(iφ) − g, gradient descent
    along 2·Im(g·exp(−iφ)), the gradient of the loss Σ(|u| − s·a)² in φ. Aᴴ is the propagation over −z. The scale s is
    the one that fits the image of the iteration before best; the first one gives the image the hologram's energy.

    Examples
    --------
    >>> import tempfile
    >>> import dask.array
    >>> from odak.wave import hologram_in_chunks, propagate_beam
    >>> target = dask.array.zeros((64, 64), chunks=32)
    >>> target[16:48, 16:48] = 1.0
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     phase = hologram_in_chunks(target, folder, 10, 2e-3, 8e-6, 532e-9, progress=False).compute()
    >>> phase.shape, str(phase.dtype)
    ((64, 64), 'float32')
    """
    da = _require_dask()
    folder, progress = Path(validate_path(folder, name="folder")), _validate.flag("progress", progress)
    target = da.asarray(_validate.image("target", target))
    if target.ndim != 2 or np.issubdtype(target.dtype, np.complexfloating):
        raise ValueError(
            f"target must be a real image [rows, columns], got {target.dtype} of shape {tuple(target.shape)}"
        )
    count = _validate.integer("iterations", iterations, minimum=1)
    method = _validate.one_of("method", method, METHODS)
    step = _validate.constant("learning_rate", learning_rate, positive=True)
    # In the layout of the propagated field, so that all arrays are stored in the same chunks.
    amplitude = whole_lines(da.sqrt(da.maximum(target.astype(np.float32), 0)), -1, 2 * target.shape[1], np.complex64)
    problem = {
        "shape": list(target.shape),
        "target": _fingerprint(target),
        "distance": _validate.constant("distance", distance),
        "dx": [_validate.constant("dx", value, positive=True) for value in pitches(dx)],
        "wavelength": _validate.constant("wavelength", wavelength, positive=True),
        "propagation_type": propagation_type,
        "method": method,
        "learning_rate": step,
    }
    state = _State(folder, problem)

    def propagate(field, sign):
        z, pitch = sign * problem["distance"], tuple(problem["dx"])
        return propagate_beam(field, None, z, pitch, wavelength, propagation_type, zero_padding=(True, False, True))

    bar = tqdm(total=count, initial=min(state.done, count), desc="hologram", unit="iteration", disable=not progress)
    with bar:
        if state.done == 0:
            energy = float(da.sum(amplitude.astype(np.float64) ** 2).compute())
            if not energy > 0 or not math.isfinite(energy):
                raise ValueError("target must be finite and not all zero, got an image whose sum is 0 or not finite")
            state.scale, state.energy = math.sqrt(math.prod(target.shape) / energy), energy
        while state.done < count:
            phase = state.read("phase") if state.done else _starting_phase(da, amplitude, initial_phase)
            hologram = _array.phasor(phase)
            field = propagate(hologram, +1)
            magnitude = da.absolute(field)
            error = magnitude - state.scale * amplitude
            unit = da.where(magnitude > 0, field / da.where(magnitude > 0, magnitude, 1), 1)
            correction = propagate((error * unit).astype(np.complex64), -1)
            sums = {
                "loss": da.sum(error.astype(np.float64) ** 2) / target.size,
                "overlap": da.sum((magnitude * amplitude).astype(np.float64)),
            }
            if method == "Gerchberg-Saxton":
                arrays = {"phase": da.angle(hologram - correction)}
            else:
                gradient = 2 * da.imag(correction * da.conj(hologram))
                arrays = _adam_step(da, state, phase, gradient, step)
            sums = state.store(arrays, sums)
            if not math.isfinite(sums["loss"]):
                raise ValueError("target and initial_phase must be finite, the loss is not")
            state.scale = sums["overlap"] / state.energy
            state.finish(sums["loss"])
            bar.set_postfix(loss=f"{sums['loss']:.3g}", refresh=False)
            bar.update()
    return state.read("phase")


def _fingerprint(target) -> int:
    """Return a number that another picture hardly has, from about 16 of its rows: a picture may be long to read."""
    step = -(-target.shape[0] // 16)
    rows = np.asarray(target[step // 2 :: step], dtype=np.float32)
    return zlib.crc32(np.ascontiguousarray(rows).tobytes())


def _adam_step(da, state, phase, gradient, step: float) -> dict[str, Any]:
    """Return phase, first and second moments after a step of Adam (Kingma and Ba, arXiv:1412.6980, algorithm 1)."""
    first, second = (state.read(name) if state.done else 0 * gradient for name in ("first", "second"))
    first = _DECAYS[0] * first + (1 - _DECAYS[0]) * gradient
    second = _DECAYS[1] * second + (1 - _DECAYS[1]) * gradient**2
    corrections = [1 - decay ** (state.done + 1) for decay in _DECAYS]
    moved = phase - step * (first / corrections[0]) / (da.sqrt(second / corrections[1]) + 1e-8)
    return {"phase": moved, "first": first, "second": second}


def _starting_phase(da, amplitude, initial_phase):
    if initial_phase is not None:
        initial_phase = _validate.image("initial_phase", initial_phase)
        _validate.shaped("initial_phase", initial_phase, f"{list(amplitude.shape)} as target")
        return da.asarray(initial_phase).astype(np.float32).rechunk(amplitude.chunks)
    bends = []
    for n, chunks in zip(amplitude.shape, amplitude.chunks, strict=True):
        place = da.arange(n, chunks=(chunks,), dtype=np.float64) - n // 2
        # The whole cycles go before the cast: at the edge of a large image they are thousands.
        bends.append(place**2 / (8 * n))
    cycles = bends[0][:, None] + bends[1]
    return (2 * math.pi * (cycles - da.round(cycles))).astype(np.float32)


@_validate.takes_units("distance", "dx", "wavelength")
def propagate_on_disk(
    field: Array,
    path: str | os.PathLike[str],
    distance: float,
    dx: float | tuple[float, float],
    wavelength: float,
    propagation_type: str = "Bandlimited Angular Spectrum",
    memory: int = 1 << 30,
    progress: bool = True,
) -> Array:
    """Propagate a field that is larger than memory, through files, in memory that is bounded.

    Use it where :func:`propagate_beam` of a Dask array would need a cluster that moves its chunks to disk: here the two
    rearrangements of rows and columns go through one stored array of twice the field's size, and each pass reads and
    writes it once. A field that fits into memory twice is faster without.

    Parameters
    ----------
    field : dask.array.Array or array
        Complex field ``[rows, columns]``, complex64 or complex128; of a Dask array, such as ``dask.array.from_zarr``
        returns it, the chunks are computed where they are needed.
    path : str or os.PathLike
        Zarr array to write the result to; it appears whole, and replaces an earlier one.
    distance : float
        Distance in metres.
    dx : float or pair of float
        Pixel pitch in metres, one number or a pair (rows, columns).
    wavelength : float
        Wavelength in metres.
    propagation_type : str
        "Bandlimited Angular Spectrum", "Angular Spectrum", "Transfer Function Fresnel" or "Impulse Response Fresnel".
    memory : int
        Bytes that the blocks of all threads may take together.
    progress : bool
        Whether to show a bar.

    Returns
    -------
    dask.array.Array
        The result ``[rows, columns]``, padded by zeros while it was computed, as it is stored.

    Raises
    ------
    ValueError, TypeError
        If an argument is outside its range, naming it.
    ImportError
        If Dask or Zarr is not installed.

    Examples
    --------
    >>> import tempfile
    >>> import numpy as np
    >>> from odak.wave import propagate_beam, propagate_on_disk
    >>> field = np.exp(1j * np.linspace(0, 9, 48 * 64)).reshape(48, 64)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     stored = propagate_on_disk(field, folder + "/far.zarr", 2e-3, 8e-6, 532e-9, progress=False).compute()
    >>> options = {"propagation_type": "Bandlimited Angular Spectrum", "zero_padding": (True, False, True)}
    >>> bool(abs(stored - propagate_beam(field, None, 2e-3, 8e-6, 532e-9, **options)).max() < 1e-12)
    True
    """
    da = _require_dask()
    import dask

    method = find_method(propagation_type)
    propagation_type = _validate.one_of("propagation_type", method.name if method else "auto", _ON_DISK)
    path, memory = Path(validate_path(path, name="path")), _validate.integer("memory", memory, minimum=1 << 16)
    progress = _validate.flag("progress", progress)
    field = da.asarray(_array.to_complex(_validate.image("field", field)))
    if field.ndim != 2:
        raise ValueError(f"field must be [rows, columns], got the shape {tuple(field.shape)}")
    _validate.number("distance", distance)
    _validate.number("wavelength", wavelength, positive=True)
    if path.exists() and not any((path / name).is_file() for name in ("zarr.json", ".zarray")):
        raise ValueError(f"path must be new or a Zarr array, which is replaced; {str(path)!r} is something else")
    path.parent.mkdir(parents=True, exist_ok=True)
    threads = os.cpu_count() or 1
    # A block is there as it is read, as its spectrum, and as the transfer function or the result.
    block = max(1, memory // (4 * threads))
    with tempfile.TemporaryDirectory(prefix=f".{path.name}.", suffix=".part", dir=path.parent) as folder:

        def through_files(field, kernel):
            _filtered_on_disk(field, kernel, Path(folder), block, threads, progress)
            return field

        token = by_way_of.set(through_files)
        try:
            with dask.config.set({"array.chunk-size": block}):
                padded = (True, False, True)
                propagate_beam(field, None, distance, dx, wavelength, propagation_type, zero_padding=padded)
        finally:
            by_way_of.reset(token)
        if path.exists():
            os.replace(path, Path(folder) / "former")
        os.replace(Path(folder) / "result", path)
    return da.from_zarr(str(path))


def _filtered_on_disk(field, kernel, folder: Path, block: int, threads: int, progress: bool) -> None:
    """Write the field filtered by a transfer function as a Zarr array ``result`` in a folder."""
    import zarr

    (rows, columns), (height, width), dtype = field.shape, kernel.shape, field.dtype
    lines = max(1, min(rows, block // (width * dtype.itemsize)))
    stops = [int(stop) for stop in np.cumsum(kernel.chunks[1])]
    spans = list(zip([0, *stops[:-1]], stops, strict=True))
    result = zarr.open_array(
        str(folder / "result"), mode="w", shape=(rows, columns), chunks=(lines, columns), dtype=dtype
    )
    # The spectra of rows lie on disk span by span of columns, so that both passes read and write long runs.
    path = folder / "spectrum"
    path.touch()

    def write(start, stop, first, values):
        with open(path, "r+b") as stream:
            stream.seek((start * rows + first * (stop - start)) * dtype.itemsize)
            stream.write(np.ascontiguousarray(values).data)

    def read(start, stop, first, count):
        with open(path, "rb") as stream:
            stream.seek((start * rows + first * (stop - start)) * dtype.itemsize)
            return np.fromfile(stream, dtype, count * (stop - start)).reshape(count, stop - start)

    def along_rows(first):
        given = np.asarray(field[first : first + lines].compute(scheduler="synchronous"))
        spectrum = fft.fft(given, n=width, axis=1)
        for start, stop in spans:
            write(start, stop, first, spectrum[:, start:stop])

    def along_columns(number):
        start, stop = spans[number]
        spectrum = fft.fft(read(start, stop, 0, rows), n=height, axis=0)
        spectrum *= kernel.blocks[0, number].compute(scheduler="synchronous")
        write(start, stop, 0, fft.ifft(spectrum, axis=0, overwrite_x=True)[:rows])

    def back(first):
        count = min(lines, rows - first)
        spectrum = np.concatenate([read(start, stop, first, count) for start, stop in spans], 1)
        result[first : first + count] = fft.ifft(spectrum, axis=1, overwrite_x=True)[:, :columns]

    starts = range(0, rows, lines)
    passes = ((along_rows, starts), (along_columns, range(len(spans))), (back, starts))
    with (
        tqdm(total=sum(len(items) for _, items in passes), unit="block", disable=not progress) as bar,
        ThreadPoolExecutor(threads) as pool,
    ):
        for work, items in passes:
            for _ in pool.map(work, items):
                bar.update()


def _require_dask():
    told = "Holograms in chunks need Dask and Zarr: pip install 'dask[array]' zarr"
    _validate.optional("zarr", told)
    return _validate.optional("dask.array", told)


class _State:
    """The arrays and numbers of the last whole iteration, in a folder.

    An iteration is written under another name and renamed when it is whole; the one before is removed after that.
    """

    def __init__(self, folder: Path, problem: dict[str, Any]):
        self.folder = folder
        self.problem = problem
        self.done, self.scale, self.energy = 0, 1.0, 0.0
        self.checksums: dict[str, np.ndarray] = {}
        folder.mkdir(parents=True, exist_ok=True)
        stored = [path for path in folder.glob("iteration_*") if path.suffix != ".part"]
        for place in sorted(stored, reverse=True):
            about, bad = self._examined(place)
            if not bad:
                self.done, self.scale, self.energy = about["done"], about["scale"], about["energy"]
                return
            named = ", ".join(bad[:_NAMED]) + (f" and {len(bad) - _NAMED} more" if len(bad) > _NAMED else "")
            warn(
                f"folder {str(place)!r} is damaged, missing or changed: {named}; the iterations up to this one are "
                "computed again",
                AccuracyWarning,
            )
            shutil.rmtree(place)

    def _examined(self, place: Path) -> tuple[dict[Any, Any], list[str]]:
        """Return the numbers stored with an iteration, and the names of what is missing or not as it was written."""
        import dask

        try:
            about = json.loads((place / "about.json").read_text(encoding="utf-8"))
            other = [key for key, value in self.problem.items() if about["problem"].get(key) != value]
            tables = {name: np.array(table, np.uint32) for name, table in about.get("checksums", {}).items()}
            about = {name: about[name] for name in ("done", "scale", "energy")}
        except (OSError, ValueError, KeyError, TypeError, AttributeError):
            return {}, ["about.json"]
        if other:
            raise ValueError(
                f"folder {str(self.folder)!r} contains the state of another problem: other {', '.join(other)}"
            )
        checks = [
            dask.delayed(_damage)(str(place / f"{name}.zarr"), at, int(table[at]))
            for name, table in tables.items()
            for at in np.ndindex(table.shape)
        ]
        return about, [found for found in dask.compute(*checks) if found]

    def _place(self, number: int) -> Path:
        return self.folder / f"iteration_{number:06d}"

    def read(self, name: str):
        import dask.array as da

        return da.from_zarr(str(self._place(self.done) / f"{name}.zarr"))

    def store(self, arrays: dict[str, Any], sums: dict[str, Any]) -> dict[str, float]:
        """Compute arrays and sums in one pass and write the arrays of the next iteration; return the sums."""
        import dask

        part = self._part()
        shutil.rmtree(part, ignore_errors=True)
        part.mkdir()
        writing = {name: _stored(array.astype(np.float32), part / f"{name}.zarr") for name, array in arrays.items()}
        self.checksums, computed = dask.compute(writing, sums)
        return {name: float(value) for name, value in computed.items()}

    def _part(self) -> Path:
        return self._place(self.done + 1).with_suffix(".part")

    def finish(self, loss: float) -> None:
        """Make what was stored the state, and remove the one before."""
        part, former = self._part(), self._place(self.done)
        self.done += 1
        about = {
            "problem": self.problem,
            "done": self.done,
            "scale": self.scale,
            "energy": self.energy,
            "loss": loss,
            "checksums": {name: table.tolist() for name, table in self.checksums.items()},
        }
        (part / "about.json").write_text(json.dumps(about, indent=1) + "\n", encoding="utf-8")
        os.replace(part, self._place(self.done))
        shutil.rmtree(former, ignore_errors=True)


def _stored(array: Any, path: Path) -> Any:
    """Return a Dask array of the checksums of an array's chunks; computing it writes them."""
    import zarr

    array = array.rechunk(array.chunksize)
    target = zarr.open_array(str(path), mode="w", shape=array.shape, chunks=array.chunksize, dtype=array.dtype)

    def write(values, block_info=None):
        target[tuple(slice(*span) for span in block_info[0]["array-location"])] = values
        return np.full((1,) * values.ndim, _checksum(values), np.uint32)

    ones = tuple((1,) * count for count in array.numblocks)
    return array.map_blocks(write, dtype=np.uint32, chunks=ones, meta=np.empty((0,) * array.ndim, np.uint32))


def _damage(path: str, at: tuple[int, ...], checksum: int) -> str:
    """Return the name of a chunk if it cannot be read or has another checksum, an empty text if it is whole."""
    import zarr

    try:
        stored = zarr.open_array(path, mode="r")
        values = stored[tuple(slice(i * n, (i + 1) * n) for i, n in zip(at, stored.chunks, strict=True))]
        whole = _checksum(np.asarray(values)) == checksum
    except Exception:  # The decoders of Zarr raise errors of many types.
        whole = False
    return "" if whole else f"chunk {'.'.join(map(str, at))} of {os.path.basename(path)}"


def _checksum(values: np.ndarray) -> int:
    """Return the CRC-32 of values; -0 counts as 0, since Zarr does not store chunks that equal their fill value."""
    return zlib.crc32((values + values.dtype.type(0)).tobytes())
