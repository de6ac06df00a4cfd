"""Quality of reconstructions, and the report of a run: parameters, quality, warnings, devices and versions.

Its pictures are reconstructions, and captioned panels with scales for comparison.
"""

import functools
import json
import math
import platform
import sys
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from importlib import metadata, resources
from typing import Any, NamedTuple, NoReturn

import numpy as np
import torch
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import EngFormatter, MaxNLocator
from PIL import Image
from tqdm import tqdm

from odak._warnings import OdakWarning
from odak.cli.files import response_of
from odak.cli.job import Job
from odak.cli.options import refusing
from odak.cli.target import Target
from odak.tools.file import file_depth

LIT = 0.1
# Nothing is gained any more where the loss falls by less than this share (0.1 dB) over so many iterations.
LEAST_GAIN, GAINED_OVER = 0.023, 10


def measure(
    target: torch.Tensor,
    window: tuple[slice, slice],
    image: torch.Tensor,
    unquantised: torch.Tensor,
    scales: tuple[float, float] | None = None,
) -> dict[str, Any]:
    """Return the quality of one channel's reconstruction.

    Parameters
    ----------
    target : torch.Tensor
        Intensity ``[rows, columns]`` of the whole frame.
    window : tuple of slice
        Rows and columns of the picture in it.
    image : torch.Tensor
        Intensity from the saved pattern.
    unquantised : torch.Tensor
        Intensity from the hologram as computed.
    scales : tuple of float, optional
        Brightness of the two images; by default those that are closest to the target.

    Returns
    -------
    dict
        Numbers as :func:`definitions` has them.
    """
    from odak.learn.wave.training import best_scale

    target, image, unquantised = (value.double() for value in (target, image, unquantised))
    images = (image, unquantised)
    scale, ideal = scales or (float(best_scale(part[window], target[window])) for part in images)
    lit = (target >= LIT * target.max()) & (target > 0)
    return {
        "psnr_db": psnr(scale * image[window], target[window]),
        "ssim": ssim(scale * image[window], target[window]),
        "psnr_frame_db": psnr(scale * image, target),
        "psnr_before_quantisation_db": psnr(ideal * unquantised[window], target[window]),
        "scale": float(scale),
        "efficiency": float(image.sum()) / image.numel(),
        "efficiency_lit": float(image[lit].sum()) / image.numel(),
    }


def overall(target: Target, scaled: torch.Tensor, channels: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the quality of all channels together.

    Parameters
    ----------
    target : Target
        The fitted picture.
    scaled : torch.Tensor
        s·I of every channel, ``[channels, rows, columns]``.
    channels : list of dict
        From :func:`measure`.

    Returns
    -------
    dict
        ``psnr_db``, ``ssim``, ``efficiency`` and ``efficiency_lit``.
    """
    window = (slice(None), *target.window)
    return {
        "psnr_db": psnr(scaled[window], target.intensity[window]),
        **{
            name: sum(channel[name] for channel in channels) / len(channels)
            for name in ("ssim", "efficiency", "efficiency_lit")
        },
    }


def parameters_of(job: Job, target: Target, names: list[str], device: torch.device) -> dict[str, Any]:
    """Return the part of the report that is known before the computation.

    Parameters
    ----------
    job : Job
        Parameters of the run.
    target : Target
        The fitted picture.
    names : list of str
        Files of the patterns.
    device : torch.device
        Where the work is done.

    Returns
    -------
    dict
        Parameters, picture, pattern encoding, versions and definitions.
    """
    rows, columns = target.window
    return {
        "parameters": {**job.to_dict(), "wavelengths": list(target.wavelengths), "resolution": list(job.resolution)},
        "picture": {
            "file": str(target.path),
            "light": target.source,
            "outside_gamut": target.outside,
            "rows": [rows.start, rows.stop],
            "columns": [columns.start, columns.stop],
        },
        "pattern": {
            "files": names,
            "bits": job.bits,
            "file_depth": file_depth(job.bits),
            "phase_radians": f"grey * 2 * pi / {2 ** file_depth(job.bits)}"
            if response_of(job) is None
            else f"of level grey / {2 ** (file_depth(job.bits) - job.bits)}, see verification.modulator",
            "grating": "pi on every second column from the first, included in the file" if job.grating else None,
        },
        "device": device_name(device),
        **about("hologram", efficiency_lit=f"As efficiency, where T is at least {LIT} of its maximum."),
    }


def about(command: str, **defined: str) -> dict[str, dict[str, str]]:
    """Return versions, and what the numbers in the report of a command mean, from `odak/assets/definitions.json`."""
    text = resources.files("odak").joinpath("assets/definitions.json").read_text(encoding="utf-8")
    return {"versions": versions(), "definitions": json.loads(text)[command] | defined}


def versions() -> dict[str, str]:
    """Return the versions of Python, odak and the libraries that it uses."""
    from odak import __version__

    return {"odak": __version__, "python": platform.python_version(), **_installed(), "torch": torch.__version__}


@functools.cache
def _installed() -> dict[str, str]:
    packages = {}
    for name in ("numpy", "scipy", "torch", "pillow", "plotly"):
        with suppress(metadata.PackageNotFoundError):
            packages[name] = metadata.version(name)
    return packages


def device_name(device: torch.device) -> str:
    """Return a device in words: its torch name, and the model of a GPU."""
    return f"{device} ({torch.cuda.get_device_name(device)})" if device.type == "cuda" else str(device)


def finite(value: Any) -> float | None:
    """Return a number, None for infinity and NaN, which JSON cannot represent."""
    number = float(value)
    return number if math.isfinite(number) else None


@contextmanager
def collected_warnings(show: Callable[[str], None] | None = None) -> Iterator[list[str]]:
    """Collect the texts of warnings, each once, and pass each on as soon as it is issued.

    Parameters
    ----------
    show : callable, optional
        Called with each text; by default warnings are passed to the function that displayed them before.
    """
    texts: list[str] = []
    with warnings.catch_warnings():
        before = warnings.showwarning
        # Warnings that the user turned into errors (python -W error) remain errors.
        if not any(option.startswith("error") for option in sys.warnoptions):
            warnings.simplefilter("always", OdakWarning)

        def collect(message, category, *place, **more) -> None:
            text = " ".join(str(message).split())
            if text not in texts:
                texts.append(text)
                if show is None:
                    before(message, category, *place, **more)
                else:
                    show(text)

        warnings.showwarning = collect
        yield texts


def find_device(name: str) -> torch.device:
    """Return the requested device.

    Parameters
    ----------
    name : str
        "auto" (the GPU where there is one), "cpu", "cuda", "cuda:1", …

    Raises
    ------
    InputError
        If this machine does not have it.
    """
    from odak.learn.tools import get_device

    if name == "auto":
        return torch.device(get_device("auto"))
    told = f"--device must be a device of this machine ({', '.join(['auto', *map(str, devices())])}); got {name!r}"
    with refusing(lambda _: told, RuntimeError, AssertionError):
        device = torch.device(name)
        torch.empty(1, device=device)
        return device


def describe_machine() -> list[tuple[str, str]]:
    """Return versions, devices, threads and FFT libraries as pairs of name and value."""
    rows = list(versions().items())
    rows.append(("platform", platform.platform()))
    rows.append(("devices", ", ".join(device_name(device) for device in devices())))
    rows.append(("threads", str(torch.get_num_threads())))
    cpu = "MKL" if torch.backends.mkl.is_available() else "PocketFFT"
    gpu = f", torch on CUDA: cuFFT (CUDA {torch.version.cuda})" if torch.cuda.is_available() else ""
    rows.append(("fft", f"torch on CPU: {cpu}{gpu}, NumPy: PocketFFT"))
    return rows


def devices() -> list[torch.device]:
    """Return the devices that torch can compute on here."""
    found = [torch.device("cpu")]
    found += [torch.device("cuda", index) for index in range(torch.cuda.device_count())]
    if torch.backends.mps.is_available():
        found.append(torch.device("mps"))
    return found


def decibels(error: float) -> float | None:
    """Return the PSNR in dB of a mean squared error at a peak of 1, None without error: JSON has no infinity."""
    return -10 * math.log10(error) if error > 0 else None


def mean_decibels(channels: list[dict[str, Any]], name: str) -> float | None:
    """Return the PSNR in dB of the mean of the squared errors of channels, from the PSNR of each."""
    errors = [0.0 if channel[name] is None else 10 ** (-channel[name] / 10) for channel in channels]
    return decibels(sum(errors) / len(errors))


def psnr(image: torch.Tensor, target: torch.Tensor) -> float | None:
    """Return the PSNR in dB of two images, over all elements."""
    return decibels(float((image.double() - target.double()).square().mean()))


def ssim(image: torch.Tensor, target: torch.Tensor) -> float:
    """Return the mean structural similarity of images ``[..., rows, columns]``, which may be far brighter than 1."""
    from odak.learn.perception.quality import WINDOW, similarity_terms

    if image.shape != target.shape or min(image.shape[-2:]) < WINDOW:
        raise ValueError(
            f"image and target must have the same shape, at least {WINDOW} x {WINDOW}, "
            f"got {tuple(image.shape)} and {tuple(target.shape)}"
        )
    one, two = (value.double().reshape(-1, 1, *value.shape[-2:]) for value in (image, target))
    luminance, structure = similarity_terms(one, two, 1.0)
    return float((luminance * structure).mean())


PANEL_WIDTH, NARROWEST = 960, 300
MARGIN, GAP, BAR_HEIGHT = 16, 8, 12
# Pixels of a sheet per inch. Fonts are given in points, 72 of them.
DPI = 100


class Panel(NamedTuple):
    """A picture with its caption and the scale below it.

    Attributes
    ----------
    caption : str
        Text above it.
    image : PIL.Image.Image
        RGB, or numbers in the mode "F".
    scale : tuple, optional
        Of numbers: name of Matplotlib's colour map, least and largest number, and labels of these and of their middle.
    """

    caption: str
    image: Image.Image
    scale: tuple[str, float, float, tuple[str, str, str]] | None = None


def to_image(values: torch.Tensor) -> Image.Image:
    """Return intensities as an 8-bit picture.

    Parameters
    ----------
    values : torch.Tensor
        ``[1 or 3, rows, columns]``; 0 is black, 1 and above white.

    Returns
    -------
    PIL.Image.Image
        Grey or RGB.
    """
    levels = torch.round(values.detach().cpu().clamp(0, 1) * 255).to(torch.uint8).numpy()
    return Image.fromarray(levels[0] if len(levels) == 1 else np.ascontiguousarray(np.moveaxis(levels, 0, -1)))


def picture_panel(caption: str, values: torch.Tensor) -> Panel:
    """Return a panel of intensities ``[1 or 3, rows, columns]``."""
    return Panel(caption, _shrunk(to_image(values).convert("RGB"), Image.Resampling.LANCZOS))


def phase_panel(caption: str, phase: torch.Tensor) -> Panel:
    """Return a panel of phases ``[rows, columns]`` in radians, in a cyclic scale."""
    image = Image.fromarray(torch.remainder(phase.detach().cpu().double(), 2 * math.pi).float().numpy())
    # Neighbouring phases are not averaged: the mean of 0 and 2π would be π.
    image = _shrunk(image, Image.Resampling.NEAREST)
    return Panel(caption, image, ("twilight", 0, 2 * math.pi, ("0", "π", "2π rad")))


def difference_panel(caption: str, difference: torch.Tensor) -> Panel:
    """Return a panel of signed differences ``[channels, rows, columns]``, averaged over channels."""
    values = difference.detach().cpu().double().mean(0)
    limit = max(float(torch.quantile(values.abs().flatten()[:: max(1, values.numel() // 10**6)], 0.995)), 1e-6)
    image = _shrunk(Image.fromarray(values.float().numpy()), Image.Resampling.LANCZOS)
    labels = (f"{-limit:.2g}, too dark", "0", f"{limit:.2g}, too bright")
    return Panel(caption, image, ("RdBu_r", -limit, limit, labels))


def _shrunk(image: Image.Image, resampling) -> Image.Image:
    if image.width <= PANEL_WIDTH:
        return image
    height = max(1, round(image.height * PANEL_WIDTH / image.width))
    return image.resize((PANEL_WIDTH, height), resampling)


def sheet(rows: list[list[Panel]], width_in_metres: float | None = None, aspect: float = 1.0) -> Image.Image:
    """Return captioned panels in rows.

    Parameters
    ----------
    rows : list of list of Panel
        All pictures of one size.
    width_in_metres : float, optional
        Physical width of the pictures, for an axis of lengths below the first one.
    aspect : float
        Height of a sample over its width.

    Returns
    -------
    PIL.Image.Image
        RGB. A caption that is wider than its panel is set smaller.
    """
    # Small pictures are enlarged by a whole factor, such that all samples are of one size.
    factor = max(1, NARROWEST // rows[0][0].image.width)
    width, height = (
        round(factor * side * max(1.0, stretch))
        for side, stretch in zip(rows[0][0].image.size, (1 / aspect, aspect), strict=True)
    )
    cell = max(width, NARROWEST)
    text = min(max(cell // 45, 11), 22)
    across, down = cell + MARGIN, 4 * text + height + GAP + BAR_HEIGHT
    size = max(map(len, rows)) * across + MARGIN, len(rows) * down + MARGIN
    figure = Figure(figsize=(size[0] / DPI, size[1] / DPI), dpi=DPI)
    canvas = FigureCanvasAgg(figure)

    def axes_at(left: int, top: int, width: int, height: int) -> Axes:
        # Older versions of Matplotlib resample pictures to a pixel more where rounding makes axes longer than they are.
        bottom, within = size[1] - top - height, 1e-6
        sides = (width - within) / size[0], (height - within) / size[1]
        return figure.add_axes((left / size[0], bottom / size[1], *sides))

    for i, row in enumerate(rows):
        for j, panel in enumerate(row):
            left, top = MARGIN + j * across, MARGIN + i * down + 2 * text
            axes = axes_at(left, top, width, height)
            drawn = axes.imshow(np.asarray(panel.image), aspect="auto", interpolation="nearest")
            axes.spines[:].set(color="0.8", linewidth=0.72, position=("outward", 0.72))
            axes.set(xticks=[], yticks=[])
            points = text * 72 / DPI
            title = axes.set_title(panel.caption, loc="left", fontsize=points)
            while title.get_window_extent().width > cell:
                points *= 0.97
                title.set_fontsize(points)
            if panel.scale is not None:
                colours, least, largest, labels = panel.scale
                drawn.set(cmap=colours, clim=(least, largest))
                below = axes_at(left, top + height + GAP, cell, BAR_HEIGHT)
                figure.colorbar(drawn, below, orientation="horizontal")
                below.set_xticks([least, (least + largest) / 2, largest], labels)
                below.get_xticklabels()[-1].set_horizontalalignment("right")
            elif width_in_metres is not None and panel is rows[0][0]:
                below = axes_at(left, top + height + GAP // 2, width, 1)
                ticks = [tick for tick in MaxNLocator(4).tick_values(0, width_in_metres) if tick <= width_in_metres]
                below.set(xlim=(0, width_in_metres), yticks=[])
                below.set_xticks(ticks, [EngFormatter(unit="m")(tick) if tick else "0" for tick in ticks])
            else:
                continue
            below.get_xticklabels()[0].set_horizontalalignment("left")
            below.tick_params(labelsize=0.85 * text * 72 / DPI, length=3)
    canvas.draw()
    return Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3].copy())


class Clock:
    """Moves the progress bar, times the iterations, the first one (which builds the kernel) left out, and ends them.

    Attributes
    ----------
    ticks : int
        Number of iterations so far.
    loss : float, optional
        Loss after the last one.
    interrupted : bool
        Whether Ctrl-C ended the iterations.
    """

    settled: bool
    interrupted: bool

    def __init__(self, bar: "tqdm[NoReturn]", settles: bool = False) -> None:
        self.bar: tqdm[NoReturn] = bar
        self.settles: bool = settles
        self.ticks: int = 0
        self.first: float = time.perf_counter()
        self.last: float = 0.0
        self.loss: float | None = None
        self.settled = self.interrupted = False
        self._value: torch.Tensor | None = None
        self._losses: list[float] = []

    def tick(self, _: int, value: torch.Tensor) -> bool:
        """Count an iteration, keep its loss, show the quality so far, and return whether nothing is gained any more."""
        self.bar.update()
        self.ticks += 1
        # The loss, or with Gerchberg-Saxton the phase. On a GPU it is read now and then, as reading it waits for it.
        self._value = value.detach() if value.ndim == 0 else None
        if self.ticks == 1:
            self.first = time.perf_counter()
        if self._value is not None and (self._value.is_cpu or self.ticks % GAINED_OVER == 0):
            self._losses.append(self._show(self._value))
        if self.settles and len(self._losses) > GAINED_OVER:
            self.settled = self._losses[-1] > (1 - LEAST_GAIN) * self._losses[-1 - GAINED_OVER]
        return self.settled

    def end(self) -> None:
        """Store the time of the last iteration and its loss."""
        self.last = time.perf_counter()
        if self._value is not None:
            self._show(self._value)

    def _show(self, value: torch.Tensor) -> float:
        self.loss = float(value)
        self.bar.set_postfix_str(f"{-10 * math.log10(max(self.loss, 1e-30)):.1f} dB, loss {self.loss:.4g}")
        return self.loss

    def reached(self, iterations: int) -> str:
        """Return in words where the iterations ended."""
        if self.settled:
            return f"nothing was gained any more after {self.ticks} iterations"
        return (
            f"interrupted after {self.ticks} of {iterations} iterations"
            if self.interrupted
            else f"{self.ticks} iterations"
        )

    def seconds_per_tick(self) -> float | None:
        """Return the mean time of an iteration after the first in seconds, None if there was only one."""
        return (self.last - self.first) / (self.ticks - 1) if self.ticks > 1 else None


@contextmanager
def progress(description: str, iterations: int, quiet: bool, settles: bool = False, partial: bool = False):
    """Show a progress bar, and yield the clock whose `tick` moves it.

    Parameters
    ----------
    description : str
        What is computed.
    iterations : int
        Number of iterations.
    quiet : bool
        Show no bar.
    settles : bool
        End when nothing is gained any more.
    partial : bool
        Whether a result that Ctrl-C cut short is of use; it is the best one so far. Otherwise the interruption goes on.
    """
    with tqdm(total=iterations, desc=description, unit="it", disable=quiet) as bar:
        clock = Clock(bar, settles)
        yield clock
        clock.end()
    clock.interrupted = clock.ticks < iterations and not clock.settled
    if clock.interrupted and not partial:
        raise KeyboardInterrupt
