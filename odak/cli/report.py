"""Quality of reconstructions, and the report of a run: parameters, quality, warnings, devices and versions."""

import math
import platform
import sys
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib import metadata
from typing import Any

import torch

from odak._warnings import OdakWarning
from odak.cli.files import file_depth
from odak.cli.job import InputError, Job
from odak.cli.target import Target

LIT = 0.1
DEFINITIONS = {
    "target": "The picture's stored values, 0 to 1, taken as intensity; resized (bicubic) to the largest size that "
    "fits the resolution with its aspect ratio kept, black around it.",
    "reconstruction": "Intensity I = |u|^2 of the light that the saved pattern, quantised and read back from its file, "
    "sends to the distance: unit amplitude on the modulator, padded to twice its size, propagated by the method in "
    "verification.propagation_type.",
    "scale": "s = <I, T>/<I, I> over the picture's window, per channel: the brightness at which I is closest to T. "
    "With the methods multiplane and multi-color: brightness times the sum of the squares of source_amplitudes.",
    "brightness": "Methods multiplane and multi-color: the one factor of the intensities of all colours, as the "
    "sources give them, at which the picture is closest to T over its window; no colour is rescaled by itself.",
    "psnr_area_db": "As psnr_db, for square pixels of verification.pixel.fill_factor (1 if none is given) behind a "
    "stop that passes |f| < 1/(2*pitch) along each axis, with I averaged over the area of each pixel.",
    "psnr_db": "10*log10(1/mean((s*I - T)^2)) over the picture's window, without the black borders; overall, the mean "
    "is over all channels.",
    "psnr_frame_db": "The same over the whole frame, black borders included, with the same s.",
    "psnr_before_quantisation_db": "psnr_db of the hologram before it was quantised, with its own s.",
    "ssim": "Mean structural similarity of s*I and T over the picture's window (Wang et al. 2004: Gaussian window 11 x "
    "11, sigma 1.5, K1 0.01, K2 0.03, peak 1); overall, the mean over channels.",
    "efficiency": "Energy of I over the whole frame, divided by the modulator's energy (unit amplitude, so its number "
    "of pixels).",
    "efficiency_lit": f"Energy of I where T is at least {LIT} of its maximum, divided by the modulator's energy.",
    "planes": "With several planes, I is taken from the plane that each pixel belongs to by the depth map, and "
    "psnr_db, ssim, scale and efficiency above are those of this image. Each plane by itself is held against its own "
    "target, the picture blurred outside the plane: over the picture's window (psnr_db, ssim) and over the pixels that "
    "belong to the plane (psnr_in_focus_db), all with the scale of the colour.",
    "source_amplitudes": "Amplitude of each wavelength's source in each frame. I is the sum over frames, divided by "
    "the sum of their squares: what a source of that light would give, spread evenly.",
    "seconds_per_iteration": "Mean over all iterations but the first, which builds the kernel.",
}


def measure(
    target: torch.Tensor,
    window: tuple,
    image: torch.Tensor,
    unquantised: torch.Tensor,
    scales: tuple[float, float] | None = None,
) -> dict:
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
        Numbers as `DEFINITIONS` has them.
    """
    from odak.learn.wave.holograms import best_scale

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


def overall(target: Target, scaled: torch.Tensor, channels: list[dict]) -> dict:
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


def parameters_of(job: Job, target: Target, names: list[str], device: torch.device) -> dict:
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
            "rows": [rows.start, rows.stop],
            "columns": [columns.start, columns.stop],
        },
        "pattern": {
            "files": names,
            "bits": job.bits,
            "file_depth": file_depth(job.bits),
            "phase_radians": f"grey * 2 * pi / {2 ** file_depth(job.bits)}",
            "grating": "pi on every second column from the first, included in the file" if job.grating else None,
        },
        "device": device_name(device),
        "versions": versions(),
        "definitions": DEFINITIONS,
    }


def versions() -> dict[str, str]:
    """Return the versions of Python, odak and the libraries that it uses."""
    from odak import __version__

    packages = {name: metadata.version(name) for name in ("numpy", "scipy", "torch", "pillow", "plotly")}
    return {"odak": __version__, "python": platform.python_version(), **packages, "torch": torch.__version__}


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
    try:
        device = torch.device(name)
        torch.empty(1, device=device)
    except (RuntimeError, AssertionError, NotImplementedError):
        here = ", ".join(["auto", *map(str, devices())])
        raise InputError(f"--device must be one of those of this machine ({here}); got {name!r}") from None
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
