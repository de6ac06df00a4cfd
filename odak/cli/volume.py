"""Holograms of several planes, or of colours that share their frames: computed, saved, read back and measured."""

import math
from dataclasses import dataclass
from pathlib import Path

import torch

from odak.cli import hologram, metrics, pattern, pictures, report
from odak.cli.depth import Volume, load_volume
from odak.cli.files import write_png
from odak.cli.job import Job, pattern_name
from odak.cli.target import Target
from odak.learn import wave
from odak.wave import sampling_report

LIGHT_WEIGHT = 0.1


@dataclass(frozen=True)
class Frames:
    """Patterns shown one after another, and the light they are shown in.

    Attributes
    ----------
    phases : torch.Tensor
        ``[frames, rows, columns]`` in radians.
    powers : torch.Tensor
        Amplitude of each source in each frame, ``[frames, channels]``.
    """

    phases: torch.Tensor
    powers: torch.Tensor


def show(job: Job, target: Target, folder: Path, device: torch.device) -> dict:
    """Compute, save, read back and measure the patterns of a volume.

    Parameters
    ----------
    job : Job
        What was asked for.
    target : Target
        The fitted picture.
    folder : Path
        Where to write patterns and the focal stack.
    device : torch.device
        Where to compute.

    Returns
    -------
    dict
        ``images`` (each pixel from its own plane, at the target's brightness) and ``phases`` as tensors; the parts of
        the report ``channels``, ``planes``, ``frames``, ``files`` and ``seconds_per_iteration``.
    """
    volume = load_volume(job, target, device)
    ideal, seconds = _compute(job, target, volume, device)
    grating = hologram.grating_phase(job.resolution, device) if job.grating else torch.zeros(1, device=device)
    files = frame_files(job, target)
    for name, phase in zip(files, ideal.phases, strict=True):
        shown = wave.generate_complex_field(1.0, phase.double() + grating)
        pattern.save(folder / name, pattern.quantise(shown, job.bits), job.bits)
    stored = torch.stack([pattern.load_phase(folder / name, job.bits) for name in files])
    saved = Frames(stored.to(device) - grating, ideal.powers)
    images = _reconstruct(job, target, volume, saved)
    before = _reconstruct(job, target, volume, ideal)
    channels, scales = _channels(target, volume, images, before)
    planes = _planes(target, volume, images * scales)
    stack = [volume.images.cpu(), (images * scales).cpu()]
    if job.planes > 1:
        write_png(folder / "focal_stack.png", _focal_stack(planes, *stack))
    return {
        "images": (images * scales * volume.masks).sum(0).cpu(),
        "phases": stored,
        "channels": [
            {"wavelength": wavelength, **channel}
            for wavelength, channel in zip(target.wavelengths, channels, strict=True)
        ],
        "planes": planes,
        "frames": [
            {"file": name, "source_amplitudes": power} for name, power in zip(files, ideal.powers.tolist(), strict=True)
        ],
        "files": files,
        "seconds_per_iteration": seconds,
    }


def frame_files(job: Job, target: Target) -> list[str]:
    """Return the name of each frame's pattern file: its wavelength, or its number where frames share colours."""
    if job.method == "multiplane":
        return [pattern_name(wavelength) for wavelength in target.wavelengths]
    return [f"hologram_frame{index + 1}.png" for index in range(job.frames or len(target.wavelengths))]


def _compute(job: Job, target: Target, volume: Volume, device) -> tuple[Frames, float | None]:
    count, shared = len(frame_files(job, target)), job.method == "multi-color"
    method = "multi-color" if shared else "conventional"
    display = wave.propagator(
        job.resolution,
        list(target.wavelengths),
        job.pixel_pitch,
        number_of_frames=count,
        distances=volume.distances,
        propagation_type=job.propagation_type,
        propagator_type="forward",
        aperture=torch.ones(2 * job.resolution[0], 2 * job.resolution[1]),
        method=method,
        device=device,
    )
    start = torch.zeros(count, *job.resolution, device=device)
    with hologram.progress(job, f"{job.planes} planes" if job.planes > 1 else f"{count} frames") as clock:
        optimizer = wave.multi_color_hologram_optimizer(
            list(target.wavelengths),
            list(job.resolution),
            volume.images,
            display,
            count,
            job.planes,
            learning_rate=job.learning_rate,
            min_learning_rate=job.learning_rate / 2,
            method=method,
            loss_function=volume.loss,
            # All sources at full power, when they share the frames.
            peak_amplitude=float(count) if shared and job.scale else 1.0,
            optimize_peak_amplitude=job.scale,
            reduction="mean",
            initial_phase=hologram.starting_phase(job, start, target.wavelengths[0]),
            progress=False,
            seed=job.seed,
            callback=clock.tick,
        )
        weights = {"eyebox": 0.0, "light": LIGHT_WEIGHT}
        _, phases, _, powers, _, _ = optimizer.optimize(job.iterations, weights, bits=None)
        hologram.finish(device)
    return Frames(phases, powers), clock.seconds_per_tick()


def _reconstruct(job: Job, target: Target, volume: Volume, frames: Frames) -> torch.Tensor:
    """Return the light on each plane over the light of each colour's source, ``[planes, channels, rows, columns]``.

    Plane by plane with the method that its distance asks for, and not with the display that the optimizer trusts.
    """
    fields = wave.generate_complex_field(1.0, frames.phases).to(torch.complex64)
    images = []
    for distance in volume.distances:
        for wavelength, power in zip(target.wavelengths, frames.powers.mT, strict=True):
            method = sampling_report(
                job.resolution, job.pixel_pitch, wavelength, distance, zero_padding=True
            ).recommended
            light = wave.propagate_beam(fields, None, distance, job.pixel_pitch, wavelength, method).abs().square()
            images.append((light * power.square()[:, None, None]).sum(0) / power.square().sum().clamp_min(1e-12))
    return torch.stack(images).reshape(volume.images.shape)


def _channels(target: Target, volume: Volume, images, before) -> tuple[list[dict], torch.Tensor]:
    """Return the quality of each colour with each pixel from its own plane, and the brightness ``[channels, 1, 1]``."""
    sharp, ideal = ((part * volume.masks).sum(0) for part in (images, before))
    intensity = target.intensity.to(images.device)
    channels = [
        report.measure(*parts[:1], target.window, *parts[1:]) for parts in zip(intensity, sharp, ideal, strict=True)
    ]
    scales = torch.tensor([channel["scale"] for channel in channels], device=images.device)
    return channels, scales[:, None, None].to(images.dtype)


def _planes(target: Target, volume: Volume, scaled) -> list[dict]:
    planes = []
    for distance, *parts in zip(volume.distances, volume.images, volume.masks, scaled, strict=True):
        colours = [
            {"wavelength": wavelength, **_plane_quality(*(part[target.window].double() for part in three))}
            for wavelength, *three in zip(target.wavelengths, *parts, strict=True)
        ]
        share = float(parts[1][0][target.window].double().mean())
        planes.append({"distance": distance, "share_in_focus": share, "channels": colours})
    return planes


def _plane_quality(wanted, mask, image) -> dict:
    error = (image - wanted).square()
    sharp = float((error * mask).sum() / mask.sum()) if bool(mask.any()) else 0.0
    return {
        "psnr_db": report.finite(metrics.psnr(image, wanted)),
        "psnr_in_focus_db": -10 * math.log10(sharp) if sharp > 0 else None,
        "ssim": metrics.ssim(image, wanted),
    }


def _focal_stack(planes: list[dict], wanted: torch.Tensor, images: torch.Tensor):
    rows: list[list] = [[], []]
    for plane, target, image in zip(planes, wanted, images, strict=True):
        known = [channel["psnr_in_focus_db"] for channel in plane["channels"]]
        quality = "" if None in known else f", in focus {sum(known) / len(known):.1f} dB"
        rows[0].append((f"Target at {plane['distance'] * 1e3:.4g} mm", target))
        rows[1].append((f"Reconstruction{quality}", image))
    return pictures.grid(rows)
