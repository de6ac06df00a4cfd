"""`odak hologram` from the picture to the report."""

import time

import torch

from odak.cli import files, hologram, pattern, pictures, report, volume
from odak.cli.errors import InputError
from odak.cli.job import VOLUME_METHODS, Job, pattern_name
from odak.cli.target import Target, load_target
from odak.learn.wave import generate_complex_field
from odak.wave import sampling_report
from odak.wave.methods import METHODS, PROPAGATION_TYPES, find_method

UNFIT = ("Incoherent Angular Spectrum", "Fraunhofer", "Fraunhofer Inverse", "custom")


def run(job: Job) -> dict:
    """Compute, save, read back and verify the holograms of a picture.

    Parameters
    ----------
    job : Job
        What was asked for.

    Returns
    -------
    dict
        The report, as written to ``report.json``.

    Raises
    ------
    InputError
        If the picture, the device, the propagation type or the output folder will not do.
    """
    start = time.perf_counter()
    check_propagation_type(job.propagation_type)
    device = find_device(job.device)
    target = load_target(job)
    folder = files.writable_folder(job.output)
    work = volume.show if job.method in VOLUME_METHODS else _show
    shown = work(job, target, folder, device)
    images, phases = shown.pop("images"), shown.pop("phases")
    quality = report.overall(target, images, shown["channels"])
    files.write_png(folder / "reconstruction.png", pictures.to_image(images))
    files.write_png(folder / "comparison.png", _comparison(job, target, images, phases, quality))
    names = shown.pop("files")
    summary = {
        **quality,
        **shown,
        "verification": _verification(job, target),
        **report.describe(job, target, names, device),
        "seconds_total": time.perf_counter() - start,
    }
    files.write_json(folder / "report.json", summary)
    return summary


def _show(job: Job, target: Target, folder, device) -> dict:
    """Compute, save, read back and measure one hologram for each wavelength, all on one plane."""
    results = [
        _channel(job, target, channel, wavelength, folder, device)
        for channel, wavelength in enumerate(target.wavelengths)
    ]
    return {
        "images": torch.stack([result.pop("image") for result in results]),
        "phases": torch.stack([result.pop("phase") for result in results]),
        "channels": results,
        "files": [pattern_name(wavelength) for wavelength in target.wavelengths],
        "seconds_per_iteration": _mean(result["seconds_per_iteration"] for result in results),
    }


def _channel(job: Job, target: Target, channel: int, wavelength: float, folder, device) -> dict:
    """Return one channel's part of the report, with its brightness-matched image and its phase as tensors."""
    intensity = target.intensity[channel].to(device)
    ideal, seconds = hologram.compute(job, intensity, wavelength)
    method = verification_type(job, wavelength)
    unquantised = hologram.reconstruct(job, ideal, wavelength, method).abs() ** 2
    grating = hologram.grating_phase(job.resolution, device) if job.grating else 0.0
    path = folder / pattern_name(wavelength)
    shown = ideal * generate_complex_field(1.0, grating).to(ideal) if job.grating else ideal
    pattern.save(path, pattern.quantise(shown, job.bits), job.bits)
    phase = pattern.load_phase(path, job.bits)
    saved = generate_complex_field(1.0, phase.to(device) - grating).to(ideal.dtype)
    image = hologram.reconstruct(job, saved, wavelength, method).abs() ** 2
    numbers = report.measure(intensity, target.window, image, unquantised)
    return {
        "wavelength": wavelength,
        "file": path.name,
        **numbers,
        "seconds_per_iteration": seconds,
        "image": (image * numbers["scale"]).cpu(),
        "phase": phase,
    }


def verification_type(job: Job, wavelength: float) -> str:
    """Return the propagation type whose sampling criteria hold, so that the report does not trust the optimizer's."""
    return sampling_report(job.resolution, job.pixel_pitch, wavelength, job.distance, zero_padding=True).recommended


def _verification(job: Job, target: Target) -> dict:
    filtered = "Fourier filter passing |f| <= 1/(4*pitch) along each axis, as double phase needs (a 4f relay)"
    return {
        "propagation_type": [verification_type(job, wavelength) for wavelength in target.wavelengths],
        "grating": "its phase was subtracted from the pattern read back" if job.grating else None,
        "aperture": filtered if job.method == "double-phase" else None,
    }


def _comparison(job: Job, target: Target, images, phases, quality: dict):
    psnr = "" if quality["psnr_db"] is None else f", PSNR {quality['psnr_db']:.1f} dB"
    shared = job.method == "multi-color"
    parts = "three frames" if shared else "red, green, blue"
    colours = f" ({parts})" if len(phases) >= 3 else " (first frame)" if shared and len(phases) == 2 else ""
    where = "in focus" if job.planes > 1 else f"at {job.distance * 1e3:.4g} mm"
    return pictures.side_by_side(
        [
            ("Target", target.intensity),
            (f"Reconstruction {where}{psnr}, SSIM {quality['ssim']:.3f}", images),
            (f"SLM phase{colours}, {job.bits} bit", (phases[:3] if len(phases) >= 3 else phases[:1]) / (2 * torch.pi)),
        ]
    )


def check_propagation_type(name: str) -> None:
    """Raise InputError unless the name or alias is of a method that takes a hologram to an image of the same pitch."""
    fit = [method.name for method in METHODS if method.name not in UNFIT]
    try:
        method = find_method(name)
    except ValueError:
        method = METHODS[-1]
    if method is not None and method.name in UNFIT:
        accepted = ", ".join(repr(kind) for kind in PROPAGATION_TYPES if kind in (*fit, "auto"))
        raise InputError(f"--propagation-type must be one of {accepted}; got {name!r}")


def find_device(name: str) -> torch.device:
    """Return the device asked for.

    Parameters
    ----------
    name : str
        "auto" (the GPU where there is one), "cpu", "cuda", "cuda:1", …

    Returns
    -------
    torch.device
        The device.

    Raises
    ------
    InputError
        If torch does not know it or the machine does not have it.
    """
    from odak.learn.tools import get_device

    if name == "auto":
        return torch.device(get_device("auto"))
    try:
        device = torch.device(name)
        torch.empty(1, device=device)
    except (RuntimeError, AssertionError) as error:
        reason = (str(error).splitlines() or [""])[0]
        raise InputError(f"--device must be auto, cpu, or a device that torch finds; got {name!r} ({reason})") from None
    return device


def _mean(values) -> float | None:
    known = [value for value in values if value is not None]
    return sum(known) / len(known) if known else None
