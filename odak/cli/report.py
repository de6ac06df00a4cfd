"""What a run reports: parameters, quality of the saved patterns, light, time and versions."""

import math
import platform
from importlib import metadata

import torch

from odak.cli import metrics, pattern
from odak.cli.job import Job
from odak.cli.target import Target

LIT = 0.1
DEFINITIONS = {
    "target": "The picture's stored values, 0 to 1, taken as intensity; resized (bicubic) to the largest size that "
    "fits the resolution with its aspect ratio kept, black around it.",
    "reconstruction": "Intensity I = |u|^2 of the light that the saved pattern, quantised and read back from its file, "
    "sends to the distance: unit amplitude on the modulator, padded to twice its size, propagated by the method in "
    "verification.propagation_type.",
    "scale": "s = <I, T>/<I, I> over the picture's window, per channel: the brightness at which I is closest to T.",
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


def measure(target: torch.Tensor, window: tuple, image: torch.Tensor, unquantised: torch.Tensor) -> dict:
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

    Returns
    -------
    dict
        Numbers as `DEFINITIONS` has them.
    """
    target, image, unquantised = (value.double() for value in (target, image, unquantised))
    scale = metrics.best_scale(image[window], target[window])
    ideal = metrics.best_scale(unquantised[window], target[window])
    lit = (target >= LIT * target.max()) & (target > 0)
    return {
        "psnr_db": finite(metrics.psnr(scale * image[window], target[window])),
        "ssim": metrics.ssim(scale * image[window], target[window]),
        "psnr_frame_db": finite(metrics.psnr(scale * image, target)),
        "psnr_before_quantisation_db": finite(metrics.psnr(ideal * unquantised[window], target[window])),
        "scale": float(scale),
        "efficiency": float(image.sum()) / image.numel(),
        "efficiency_lit": float(image[lit].sum()) / image.numel(),
    }


def overall(target: Target, scaled: torch.Tensor, channels: list[dict]) -> dict:
    """Return the quality of all channels together.

    Parameters
    ----------
    target : Target
        What was to be shown.
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
        "psnr_db": finite(metrics.psnr(scaled[window], target.intensity[window])),
        **{
            name: sum(channel[name] for channel in channels) / len(channels)
            for name in ("ssim", "efficiency", "efficiency_lit")
        },
    }


def describe(job: Job, target: Target, names: list[str], device: torch.device) -> dict:
    """Return the part of the report that is known before the computation.

    Parameters
    ----------
    job : Job
        What was asked for.
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
            "file_depth": pattern.depth(job.bits),
            "phase_radians": f"grey * 2 * pi / {2 ** pattern.depth(job.bits)}",
            "grating": "pi on every second column from the first, included in the file" if job.grating else None,
        },
        "device": device_name(device),
        "versions": versions(),
        "definitions": DEFINITIONS,
    }


def versions() -> dict[str, str]:
    """Return the versions of Python, odak and what it computes with."""
    from odak import __version__

    packages = {name: metadata.version(name) for name in ("numpy", "scipy", "torch", "pillow", "plotly")}
    return {"odak": __version__, "python": platform.python_version(), **packages, "torch": torch.__version__}


def device_name(device: torch.device) -> str:
    """Return a device in words: its torch name, and the model of a GPU."""
    return f"{device} ({torch.cuda.get_device_name(device)})" if device.type == "cuda" else str(device)


def finite(value: float) -> float | None:
    """Return a number, None where it is infinite: JSON has no word for it."""
    return value if math.isfinite(value) else None
