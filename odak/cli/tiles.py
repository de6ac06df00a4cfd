"""Computation of holograms of pictures larger than memory, for `odak hologram --tiles`, in chunks that lie on disk."""

import math
import os
import shutil
import time
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from PIL import Image

from odak.cli import files, hologram, report
from odak.cli.job import COLOUR_WAVELENGTHS, GREY_WAVELENGTH, SMALLEST_SIDE, Job, image_path, pattern_name
from odak.cli.options import InputError, refusing
from odak.cli.target import Target, light_of, on_screen, read_picture
from odak.learn.wave.pictures import fitting_size
from odak.tools.file import file_depth
from odak.wave import hologram_in_chunks, propagate_beam
from odak.wave.methods import find_method

SOLVERS = {"sgd": "gradient descent", "gs": "Gerchberg-Saxton"}
# Up to this number of pixels the results are also written as PNG, for which they are read into memory.
MOST_PIXELS_IN_PNG = 4096**2
# Codes of what is not compressed and of the two names of deflate, which need no further library.
_IN_PARTS = (1, 8, 32946)


@files.claiming
def run(job: Job, notices: files.Notices = files.SILENT, workers: int | None = None) -> dict[str, Any]:
    """Compute, save, read back and verify the holograms of a picture, a chunk at a time.

    The output folder receives the patterns and the intensities that they give as Zarr arrays, the state of the
    computation (``state_<nm>nm``), from which an interrupted run or one with more iterations goes on, and
    ``report.json``; pictures of at most `MOST_PIXELS_IN_PNG` pixels also give the files of a run in memory.

    Parameters
    ----------
    job : Job
        Parameters of the run.
    notices : files.Notices
        What to do about files of earlier runs.
    workers : int, optional
        Number of worker processes, which write to disk what does not fit in memory; by default the threads of this
        process compute.

    Returns
    -------
    dict
        The report, as written to ``report.json``.

    Raises
    ------
    InputError
        If the picture, the propagation type or the output folder cannot be used.
    """
    with report.collected_warnings() as texts:
        start = time.perf_counter()
        job.warn_of_doubtful_lengths()
        folder = files.writable_folder(job.output)
        target = load_target(job)
        in_memory = math.prod(job.resolution) <= MOST_PIXELS_IN_PNG
        stems = [Path(pattern_name(value)).stem for value in target.wavelengths]
        names = [f"{stem}.png" for stem in stems] if in_memory else [f"{stem}.zarr" for stem in stems]
        others = ["reconstruction.png", "comparison.png"] if in_memory else []
        files.announce(folder, [*(names if in_memory else []), *others, files.REPORT], notices)
        with _computed_by(workers, folder), _naming(folder):
            channels = [_channel(job, target, index, folder, stem) for index, stem in enumerate(stems)]
        errors = [channel.pop("mean_squared_error") for channel in channels]
        quality = {"psnr_db": report.decibels(sum(errors) / len(errors)), "ssim": None} | {
            name: sum(channel[name] for channel in channels) / len(channels)
            for name in ("efficiency", "efficiency_lit")
        }
        if in_memory:
            quality["ssim"] = _write_pictures(job, target, folder, stems, channels, quality)
    summary = {
        **quality,
        "channels": channels,
        "seconds_per_iteration": None,
        "warnings": texts,
        "verification": {"propagation_type": [_judge(job, wavelength) for wavelength in target.wavelengths]},
        **report.parameters_of(job, target, names, torch.device("cpu")),
        "seconds_total": time.perf_counter() - start,
    }
    written = [*(f"{stem}.zarr" for stem in stems), *others]
    return files.write_report(folder, summary, files.fingerprint_of(job), written)


@contextmanager
def _naming(folder: Path) -> Iterator[None]:
    """Let errors of the disk name the folder: Zarr's errors name no file."""
    try:
        yield
    except OSError as error:
        if error.errno is None or error.filename is not None:
            raise
        raise type(error)(error.errno, error.strerror, str(folder)) from error


@contextmanager
def _computed_by(workers: int | None, folder: Path) -> Iterator[None]:
    """Let worker processes of this machine compute Dask arrays, which keep on disk what does not fit in memory."""
    if workers is None:
        yield
        return
    from odak.manager.server import Share, require_dask, serve

    with refusing("", ImportError):
        require_dask("--cluster")
    from distributed import Client

    spilled = folder / "spilled"
    spilled.mkdir(exist_ok=True)
    with serve(Share(workers, 1, spill=str(spilled))) as server, Client(server.cluster):
        yield
    shutil.rmtree(folder / "spilled", ignore_errors=True)


def _channel(job: Job, target: Target, index: int, folder: Path, stem: str) -> dict[str, Any]:
    """Compute, quantise, store and evaluate the pattern of one wavelength; return its part of the report."""
    import dask.array as da

    wavelength, intensity = target.wavelengths[index], target.intensity[index]
    state = folder / f"state_{stem.removeprefix('hologram_')}"
    _claim(state, job, index)
    options: dict[str, Any] = {
        "propagation_type": job.propagation_type,
        "method": SOLVERS[str(job.method)],
        "learning_rate": job.learning_rate,
        "progress": not job.quiet,
    }
    with refusing(_in_options, ImportError, ValueError):
        phase = hologram_in_chunks(
            intensity, state, int(job.iterations or 1), job.distance, job.pixel_pitch, wavelength, **options
        )
    pattern = folder / f"{stem}.zarr"
    _write_zarr(phase.map_blocks(_grey, job.bits, dtype=_kind(job.bits)), pattern)
    shown = da.exp(1j * files.phase_of(da.from_zarr(str(pattern)).astype(np.float64), job.bits)).astype(np.complex64)
    geometry = (job.distance, job.pixel_pitch, wavelength, _judge(job, wavelength))
    field = propagate_beam(shown, None, *geometry, zero_padding=[True, False, True])
    light = folder / f"{stem.replace('hologram', 'reconstruction')}.zarr"
    _write_zarr((da.absolute(field) ** 2).astype(np.float32), light)
    image = da.from_zarr(str(light))
    return {
        "wavelength": wavelength,
        "file": f"{stem}.zarr",
        "reconstruction": light.name,
        **_measure(intensity.rechunk(image.chunks).astype(np.float64), image.astype(np.float64), target.window),
    }


def _in_options(text: str) -> str:
    return text.replace("target must", "IMAGE must").replace("propagation_type must", "--propagation-type must")


def _claim(state: Path, job: Job, index: int) -> None:
    """Make a folder the state of this picture's colour; raise InputError if it holds the state of another."""
    if job.again:
        shutil.rmtree(state, ignore_errors=True)
    values = {
        "colour": index,
        "grey": job.grey or len(job.wavelengths) == 1,
        "linear": job.linear,
        "resolution": list(job.resolution),
    }
    mark, about = files.fingerprint(values, [image_path(job.image)]), state / "fingerprint.json"
    state.mkdir(parents=True, exist_ok=True)
    if not about.exists():
        files.write_json(about, {"fingerprint": mark})
    elif mark not in about.read_text(errors="replace"):
        raise InputError(
            f"--output contains the state of a run with another picture, {str(state)!r}; use --again to start over"
        )


def _grey(phase: np.ndarray, bits: int) -> np.ndarray:
    """Return the grey values that represent a phase in a file of so many bits."""
    values = torch.from_numpy(phase)
    levels = files.quantise(torch.polar(torch.ones_like(values), values), bits)
    return (levels * 2 ** (file_depth(bits) - bits)).numpy().astype(_kind(bits))


def _kind(bits: int) -> type[np.unsignedinteger]:
    """Return the type of the grey values in a file."""
    return np.uint8 if file_depth(bits) == 8 else np.uint16


def _write_zarr(array: Any, path: Path) -> None:
    """Write a Dask array; an older one stays as it was until the new one is complete."""
    part = path.with_suffix(".part")
    shutil.rmtree(part, ignore_errors=True)
    array.to_zarr(str(part))
    shutil.rmtree(path, ignore_errors=True)
    os.replace(part, path)


def _judge(job: Job, wavelength: float) -> str:
    """Return the propagation type for the evaluation of the pattern: the one recommended, if it runs in chunks."""
    recommended = hologram.verification_type(job, wavelength)
    method = find_method(recommended)
    return recommended if method is not None and method.chunked else job.propagation_type


def _measure(target: Any, image: Any, window: tuple[slice, slice]) -> dict[str, Any]:
    """Return the quality of one colour, from sums over Dask arrays of the target and of the reconstruction."""
    import dask

    wanted, shown = target[window], image[window]
    sums = {
        "overlap": (wanted * shown).sum(),
        "shown": (shown**2).sum(),
        "wanted": (wanted**2).sum(),
        "light": image.sum(),
        "peak": target.max(),
    }
    (found,) = dask.compute(sums)
    found = {name: float(value) for name, value in found.items()}
    scale = found["overlap"] / found["shown"] if found["shown"] else 0.0
    lit = float(image[target >= report.LIT * found["peak"]].sum().compute())
    # The mean of (s·I − T)² at the best scale s.
    error = max(found["wanted"] - scale * found["overlap"], 0.0) / wanted.size
    return {
        "psnr_db": report.decibels(error),
        "scale": scale,
        "efficiency": found["light"] / image.size,
        "efficiency_lit": lit / image.size,
        "mean_squared_error": error,
    }


def _write_pictures(
    job: Job, target: Target, folder: Path, stems: list[str], channels: list[dict[str, Any]], quality
) -> float:
    """Write patterns, reconstruction and comparison as PNG, and return the structural similarity."""
    import dask.array as da

    def stored(name: str) -> torch.Tensor:
        return torch.from_numpy(da.from_zarr(str(folder / name)).compute())

    greys = [stored(channel["file"]) for channel in channels]
    for stem, grey in zip(stems, greys, strict=True):
        levels = grey.to(torch.int32) // 2 ** (file_depth(job.bits) - job.bits)
        files.save_pattern(folder / f"{stem}.png", levels, job.bits)
    images = torch.stack([channel["scale"] * stored(channel["reconstruction"]) for channel in channels])
    whole = Target(target.path, torch.from_numpy(target.intensity.compute()), target.window, target.wavelengths)
    window = (slice(None), *target.window)
    ssim = report.ssim(images[window], whole.intensity[window])
    files.write_png(folder / "reconstruction.png", report.to_image(on_screen(images, target.wavelengths, job.linear)))
    phases = [files.phase_of(grey.double(), job.bits) for grey in greys]
    names = [f"{stem}.png" for stem in stems]
    sheet = hologram.comparison(job, whole, images, phases, names, {**quality, "ssim": ssim})
    files.write_png(folder / "comparison.png", sheet)
    return ssim


# --- Pictures read in parts


def load_target(job: Job) -> Target:
    """Return the picture of a job on the modulator's frame, its intensity a Dask array that reads it in parts.

    Parameters
    ----------
    job : Job
        Parameters of the run.

    Raises
    ------
    InputError
        If the picture is missing, unreadable, or smaller than the least frame.
    """
    with refusing("--tiles needs Dask and Zarr (pip install 'dask[array]' zarr): ", ImportError):
        import dask.array as da
    path = image_path(job.image)
    source = open_picture(path)
    grey = job.grey or len(job.wavelengths) == 1 or source.shape[2] < 3
    wavelengths = job.wavelengths or ((GREY_WAVELENGTH,) if grey else COLOUR_WAVELENGTHS)
    size = fitting_size(source.shape[:2], job.resolution, job.pitches)
    corner = tuple((frame - side) // 2 for frame, side in zip(job.resolution, size, strict=True))
    fitted = _Fitted(source, str(path), size, job, tuple(wavelengths))
    name = f"picture-{files.digest_of(path)}-{size}-{job.grey}-{job.linear}-{wavelengths}"
    parts = da.from_array(fitted, chunks=(1, "auto", "auto"), name=name, meta=np.empty((0, 0, 0), np.float32))
    around = [(0, 0)] + [(c, f - s - c) for c, f, s in zip(corner, job.resolution, size, strict=True)]
    frame = da.pad(parts, around) if any(map(any, around)) else parts
    window = tuple(slice(c, c + s) for c, s in zip(corner, size, strict=True))
    how = "stored values" if job.linear else f"{path.name} (sRGB)"
    return Target(path, frame, (window[0], window[1]), wavelengths, how)


def picture_size(image: str) -> tuple[int, int]:
    """Return rows and columns of a picture; raise InputError if it cannot be read or is too small."""
    size = open_picture(image_path(image)).shape[:2]
    if min(size) < SMALLEST_SIDE:
        raise InputError(f"IMAGE must have at least {SMALLEST_SIDE} rows and columns, got {size[0]} x {size[1]}")
    return int(size[0]), int(size[1])


def open_picture(path: Path) -> Any:
    """Return a picture as an object with ``shape`` (rows, columns, channels) and ``dtype`` that is read by slices.

    Zarr arrays, ``.npy`` and TIFF files (not compressed or deflated, in strips or tiles) are read where they are
    sliced; other pictures are read whole.

    Parameters
    ----------
    path : Path
        Existing file, or folder of a Zarr array.

    Raises
    ------
    InputError
        If it cannot be read, or does not hold an image.
    """
    suffix = path.suffix.lower()
    found: Any
    with refusing(f"IMAGE {str(path)!r} cannot be read: ", OSError, ValueError, SyntaxError, KeyError):
        if path.is_dir():
            import zarr

            found = zarr.open_array(str(path), mode="r")
        elif suffix == ".npy":
            found = _Numpy(str(path))
            found.dtype  # noqa: B018 (files that cannot be mapped are refused here)
        else:
            found = _tiff(path) if suffix in (".tif", ".tiff") else None
    if found is None:
        found = read_picture(path).movedim(0, -1).numpy()
    shape = tuple(found.shape)
    if (
        len(shape) not in (2, 3)
        or (len(shape) == 3 and not 1 <= shape[2] <= 4)
        or np.dtype(found.dtype).kind not in "buf"
    ):
        raise InputError(
            f"IMAGE must be a real array [rows, columns] or [rows, columns, 1 to 4 channels], "
            f"got {found.dtype} of shape {shape}: {str(path)!r}"
        )
    return _Channels(found) if len(shape) == 2 else found


@dataclass(frozen=True)
class _Numpy:
    """An array in a ``.npy`` file, mapped into memory where it is sliced."""

    path: str

    def __getitem__(self, index):
        return self._mapped()[index]

    def _mapped(self):
        return np.load(self.path, mmap_mode="r", allow_pickle=False)

    shape = property(lambda self: self._mapped().shape)
    dtype = property(lambda self: self._mapped().dtype)


@dataclass(frozen=True)
class _Channels:
    """A picture of one channel with an axis for it."""

    source: Any

    def __getitem__(self, index):
        return np.asarray(self.source[index[0], index[1]])[..., None]

    shape = property(lambda self: (*self.source.shape, 1))
    dtype = property(lambda self: self.source.dtype)


@dataclass(frozen=True)
class _Tiff:
    """A TIFF file of which only the strips or tiles that a slice needs are read.

    Attributes
    ----------
    path : str
        The file.
    shape : tuple of int
        Rows, columns and, of several, samples per pixel.
    dtype : numpy.dtype
        Type of a sample.
    """

    path: str
    shape: tuple[int, ...]
    dtype: np.dtype

    def __getitem__(self, index):
        import tifffile
        import zarr

        damaged = f"IMAGE {self.path!r} cannot be read: a strip or tile is damaged: "
        with (
            refusing(damaged, OSError, ValueError, TypeError, RuntimeError, zlib.error),
            tifffile.TiffFile(self.path) as file,
            file.pages.first.aszarr() as store,
        ):
            return zarr.open_array(store, mode="r")[index]


def _tiff(path: Path) -> _Tiff | None:
    """Return a TIFF file that can be read in parts, None for one that Pillow has to read whole."""
    with refusing("--tiles needs tifffile for a TIFF file (pip install tifffile): ", ImportError):
        import tifffile
    try:
        with tifffile.TiffFile(path) as file:
            page = file.pages.first
            upright = page.tags.valueof(274, 1) == 1
            samples = page.planarconfig == 1 or page.samplesperpixel == 1
            if not (upright and samples and page.photometric in (1, 2) and page.compression in _IN_PARTS):
                return None
            return _Tiff(str(path), page.shape, page.dtype)
    except tifffile.TiffFileError:
        return None


@dataclass(frozen=True)
class _Fitted:
    """The light of a picture, resized (bicubic) to the window that it fills and read where it is sliced.

    Attributes
    ----------
    source : array-like
        From :func:`open_picture`.
    path : str
        Its name in messages.
    size : tuple of int
        Rows and columns after resizing.
    job : Job
        Settings of the run.
    wavelengths : tuple of float
        Of the sources, in metres.
    """

    source: Any
    path: str
    size: tuple[int, int]
    job: Job
    wavelengths: tuple[float, ...]

    dtype = np.dtype(np.float32)
    ndim = 3
    shape = property(lambda self: (len(self.wavelengths), *self.size))

    def __getitem__(self, index):
        if isinstance(index[0], (int, np.integer)):
            whole = (slice(index[0], index[0] + 1), *index[1:])
            return self[whole][0]
        channels, *spans = (range(n)[part] for part, n in zip(index, self.shape, strict=True))
        scales = [side / size for side, size in zip(self.source.shape, self.size, strict=False)]
        # Bicubic interpolation reaches two samples of the coarser grid to either side.
        margins = [math.ceil(2 * max(scale, 1)) + 1 if scale != 1 else 0 for scale in scales]
        exact = [(span.start * scale, span.stop * scale) for span, scale in zip(spans, scales, strict=True)]
        read = [
            slice(max(0, math.floor(low) - margin), min(side, math.ceil(high) + margin))
            for (low, high), margin, side in zip(exact, margins, self.source.shape, strict=False)
        ]
        picture = self._light(np.asarray(self.source[read[0], read[1]]))[..., channels.start : channels.stop]
        if margins == [0, 0]:
            return np.moveaxis(picture, -1, 0)
        (top, bottom), (left, right) = (
            (low - part.start, high - part.start) for (low, high), part in zip(exact, read, strict=True)
        )
        size = (len(spans[1]), len(spans[0]))
        planes = [
            Image.fromarray(np.ascontiguousarray(picture[..., c])).resize(
                size, Image.Resampling.BICUBIC, box=(left, top, right, bottom)
            )
            for c in range(picture.shape[2])
        ]
        return np.clip(np.stack([np.asarray(plane) for plane in planes]), 0, None)

    def _light(self, values: np.ndarray) -> np.ndarray:
        """Return the light of stored values, float32 ``[rows, columns, wavelengths]``; transparent parts are black."""
        if values.dtype.kind == "u":
            values = values.astype(np.float32) / np.iinfo(values.dtype).max
        values = values.astype(np.float32)
        if not np.all((values >= 0) & (values <= 1)):
            raise InputError(f"IMAGE must have values from 0 to 1, but {self.path!r} has values outside this range")
        colours = 1 if values.shape[2] < 3 else 3
        stored = torch.from_numpy(values[..., :colours]).movedim(-1, 0)
        light = light_of(stored, self.wavelengths, self.job.grey, self.job.linear)[0]
        opaque = 1.0 if values.shape[2] in (1, 3) else values[..., -1:]
        return light.movedim(0, -1).numpy() * opaque
