"""Computation of holograms for `odak hologram`: from the picture to the files and the report.

Each pattern is evaluated as saved: quantised, written, read back, and propagated with the method recommended for its
distance.
"""

import dataclasses
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

from odak._validate import UNITS
from odak._warnings import AccuracyWarning, warn
from odak.cli import files, report
from odak.cli.job import (
    COMPUTED_PHASES,
    EXACT,
    LEARNING_RATE,
    NOISE,
    SOLVERS,
    VOLUME_METHODS,
    Job,
    pattern_name,
)
from odak.cli.options import InputError
from odak.cli.target import Target, Volume, load_target, load_volume
from odak.instruments import Lens
from odak.learn import wave
from odak.learn.models.hologram_networks import FARTHEST, RATIOS, SPREADS, hologram_network
from odak.learn.tools import zero_pad
from odak.learn.wave.displays.judge import mean_over_areas
from odak.learn.wave.holograms import starts
from odak.learn.wave.training import best_scale, brightness_of
from odak.wave import sampling_report
from odak.wave.methods import METHODS, PROPAGATION_TYPES, find_method, method_named

FILTER = 0.5
# Standard deviation in radians of the noise that distinguishes frames with the same starting phase.
FRAME_NOISE = 0.5
UNFIT = tuple(
    method.name for method in METHODS if method.of_intensities or method.sets_own_pitch or method.takes_kernel
)


@files.claiming
def run(job: Job, notices: files.Notices = files.SILENT) -> dict:
    """Compute, save, read back and verify the holograms of a picture.

    Parameters
    ----------
    job : Job
        Parameters of the run.
    notices : files.Notices
        What to do about files of earlier runs.

    Returns
    -------
    dict
        The report, as written to ``report.json``.

    Raises
    ------
    InputError
        If the picture, the device, the propagation type or the output folder cannot be used, or the network was not
        trained for the lengths.
    """
    with report.collected_warnings() as texts:
        start = time.perf_counter()
        # Read, and refused if need be, before anything is computed.
        if (lens := lens_of(job)) is None:
            job.warn_of_doubtful_lengths()
        else:
            check_behind_lens(job, lens)
        check_propagation_type(job.propagation_type)
        device = report.find_device(job.device)
        target = load_target(job)
        if job.method == "network":
            check_training_range(job, target.wavelengths)
        folder = files.writable_folder(job.output)
        volume = job.method in VOLUME_METHODS or job.planes > 1
        names = _frame_files(job, target) if volume else [name for own in _channel_files(job, target) for name in own]
        others = ["reconstruction.png", "comparison.png", files.REPORT, *["focal_stack.png"] * (job.planes > 1)]
        files.announce(folder, [*names, *others], notices)
        result = (_compute_volume if volume else _compute_plane)(job, target, folder, names, device)
        images, phases = result.pop("images"), result.pop("phases")
        quality = report.overall(target, images, result["channels"])
        files.write_png(folder / "reconstruction.png", report.to_image(images))
        files.write_png(folder / "comparison.png", comparison(job, target, images, phases, names, quality))
    summary = {
        **quality,
        **result,
        "warnings": texts,
        "verification": _verification(job, target),
        **report.parameters_of(job, target, names, device),
        "seconds_total": time.perf_counter() - start,
    }
    written = [*names, "reconstruction.png", "comparison.png"]
    return files.write_report(folder, summary, files.fingerprint_of(job), written)


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


def lens_of(job: Job) -> Lens | None:
    """Return the lens of the calibrated table of a job, None if it has none."""
    response = files.response_of(job)
    return None if response is None else response.lens


def check_behind_lens(job: Job, lens: Lens) -> None:
    """Raise InputError for options that pictures behind a lens do not take, and warn of a zero order in the picture."""
    without = {
        f"--method {job.method}": job.method != "sgd",
        "--planes": job.planes > 1,
        f"--propagation-type {job.propagation_type}": job.propagation_type != Job.propagation_type,
        "--grating": job.grating,
        "--fill-factor 0": job.fill_factor is None,
        "--initial-phase double-phase": job.initial_phase == "double-phase",
    }
    for name, used in without.items():
        if used:
            raise InputError(
                f"{name} cannot be used with --calibration of a table with a lens, for which the method sgd computes "
                "pictures on one plane, of pixels of finite size"
            )
    if lens.block == 0:
        warn(
            "--calibration is of a table with a lens and no block: light that the modulator does not modulate forms a "
            "bright spot in the middle of the picture, which the report does not contain",
            AccuracyWarning,
        )


def check_training_range(job: Job, wavelengths: Sequence[float]) -> None:
    """Raise InputError unless the network weights included in odak were trained for the lengths of a job.

    Parameters
    ----------
    job : Job
        Parameters of the run.
    wavelengths : sequence of float
        Wavelengths of the target in metres.
    """
    if isinstance(job.pixel_pitch, tuple):
        dy, dx = (value / UNITS["um"] for value in job.pixel_pitch)
        raise InputError(
            "--pixel-pitch must be one length with --method network, which was trained for square pixels; got "
            f"{dy:.4g}um,{dx:.4g}um"
        )
    pitch, colours = job.pixel_pitch, ", ".join(f"{value * 1e9:.6g}nm" for value in wavelengths)
    size = f"{job.resolution[0]} x {job.resolution[1]} pixels"
    widest = 2 * FARTHEST * min(job.resolution) * pitch**2 / max(wavelengths)
    if job.planes > 1:
        size += f" and a volume depth of {job.volume_depth / UNITS['mm']:.4g}mm"
        widest -= job.volume_depth / 2
    if job.planes > 1 and job.volume_depth > job.distance:
        raise InputError(
            "--volume-depth must be at most --distance, which the weights of --method network were trained for; got "
            f"{job.volume_depth / UNITS['mm']:.4g}mm at {job.distance / UNITS['mm']:.4g}mm"
        )
    for name, value, least, most, unit, given in (
        ("--pixel-pitch", pitch, max(wavelengths) / RATIOS[1], min(wavelengths) / RATIOS[0], "um", colours),
        (
            "--distance",
            job.distance,
            SPREADS[0] * pitch**2 / min(wavelengths),
            min(SPREADS[1] * pitch**2 / max(wavelengths), widest),
            "mm",
            f"{colours}, a pixel pitch of {pitch * 1e6:.4g}um{', ' if job.planes > 1 else ' and '}{size}",
        ),
    ):
        if least > most:
            raise InputError(f"--method network takes no {name} for wavelengths as different as {colours}")
        # The slack allows for the rounded ends in the message.
        if not 0.995 * least <= value <= 1.005 * most:
            least, most, value = (length / UNITS[unit] for length in (least, most, value))
            raise InputError(
                f"{name} must be from {least:.3g}{unit} to {most:.3g}{unit}, which the weights of --method network "
                f"were trained for with {given}; got {value:.4g}{unit}"
            )


def comparison(job: Job, target: Target, images, phases, names: list[str], quality: dict):
    """Return target, reconstruction, their difference and the patterns side by side."""
    psnr = "" if quality["psnr_db"] is None else f", PSNR {quality['psnr_db']:.1f} dB"
    where = "in focus" if job.planes > 1 else f"at {job.distance * 1e3:.4g} mm"
    if (lens := lens_of(job)) is not None:
        where = f"behind a lens of {lens.focal_length * 1e3:.4g} mm"
    first = [
        report.picture_panel("Target", target.intensity),
        report.picture_panel(f"Reconstruction {where}{psnr}, SSIM {quality['ssim']:.3f}", images),
    ]
    difference = report.difference_panel("Reconstruction minus target", images - target.intensity)
    patterns = [
        report.phase_panel(f"Hologram: phase on the modulator, {name}, {job.bits} bit", phase)
        for name, phase in list(zip(names, phases, strict=True))[:3]
    ]
    rows = [first, [difference, *patterns]] if len(patterns) == 1 else [[*first, difference], patterns]
    return _sheet(job, rows)


def _sheet(job: Job, rows: list[list[report.Panel]]):
    """Return panels of images and patterns in rows, with the shape and size that they have on the modulator."""
    dy, dx = files.image_pitches(job)
    return report.sheet(rows, job.resolution[1] * dx, dy / dx)


def _verification(job: Job, target: Target) -> dict:
    filtered = "Fourier filter passing |f| <= 1/(4*pitch) along each axis, as double phase needs (a 4f relay)"
    points = "points: intensities at the middles of pixels that emit as points"
    squares = "squares: means over the areas of pixels, which emit as squares of the fill factor; their gaps are dark"
    behind = {}
    if (lens := lens_of(job)) is None:
        kinds = [verification_type(job, wavelength) for wavelength in target.wavelengths]
    else:
        kinds = ["Fourier sums over all pixels, at twice as many points along each axis as the picture has"]
        behind = {"lens": dataclasses.asdict(lens), "picture_pitch": list(files.image_pitches(job))}
    return {
        "propagation_type": kinds,
        **behind,
        "grating": "its phase was subtracted from the pattern read back" if job.grating else None,
        "modulator": _described(job),
        "aperture": filtered if job.method == "double-phase" else None,
        "pixel": {"fill_factor": job.fill_factor, "model": points if job.fill_factor is None else squares},
    }


def _described(job: Job) -> str:
    """Return in words what the modulator is taken to do to light."""
    if job.calibration is not None:
        return f"phases, aberration and illumination (mean square 1) of {job.calibration}"
    if job.lut is not None:
        return f"phases of {job.lut}"
    return f"phases spread evenly over {'2 pi' if job.slm_range is None else f'{job.slm_range:g}'} rad"


def verification_type(job: Job, wavelength: float) -> str:
    """Return the propagation type whose sampling criteria are met, whatever the optimizer uses."""
    return sampling_report(job.resolution, job.pixel_pitch, wavelength, job.distance, zero_padding=True).recommended


# --- One plane, one hologram for each wavelength


def _compute_plane(job: Job, target: Target, folder: Path, names: list[str], device: torch.device) -> dict:
    """Compute, save, read back and measure one hologram for each wavelength, all on one plane."""
    results = [
        _channel(job, target, channel, [folder / name for name in own], device)
        for channel, own in enumerate(_channel_files(job, target))
    ]
    seconds = [result["seconds_per_iteration"] for result in results if result["seconds_per_iteration"] is not None]
    return {
        "images": torch.stack([result.pop("image") for result in results]),
        "phases": torch.cat([result.pop("phases") for result in results]),
        "channels": results,
        "seconds_per_iteration": sum(seconds) / len(seconds) if seconds else None,
    }


def _channel_files(job: Job, target: Target) -> list[list[str]]:
    """Return the names of the pattern files of each channel, one for each of its frames."""
    frames = [None] if job.frames in (None, 1) else [index + 1 for index in range(job.frames)]
    return [[pattern_name(value, frame) for frame in frames] for value in target.wavelengths]


def _channel(job: Job, target: Target, channel: int, paths: list[Path], device: torch.device) -> dict:
    """Return one channel's part of the report, with its brightness-matched image and its phases as tensors."""
    intensity, wavelength = target.intensity[channel].to(device), target.wavelengths[channel]
    ideal, seconds, loss = _hologram(job, intensity, wavelength)
    ideal, response = ideal.reshape(-1, *job.resolution), files.response_of(job)
    grating = grating_phase(job.resolution, device) if job.grating else 0.0
    modulated = ideal * wave.generate_complex_field(1.0, grating).to(ideal) if job.grating else ideal
    for path, pattern in zip(paths, modulated, strict=True):
        files.save_pattern(path, files.quantise(pattern, job.bits, response), job.bits)
    phases = torch.stack([files.load_pattern(path, job.bits, response) for path in paths])
    seen = _seen if response is None or response.lens is None else _seen_behind_lens
    unquantised, image, other = seen(job, wave.calculate_phase(ideal), phases.to(device) - grating, wavelength)
    numbers, wanted = report.measure(intensity, target.window, image, unquantised), intensity[target.window]
    shown = [best_scale(light, wanted) * light for light in (image[target.window], other[target.window])]
    return {
        "wavelength": wavelength,
        "file": paths[0].name,
        **({"files": [path.name for path in paths]} if len(paths) > 1 else {}),
        **numbers,
        **_areas_and_points(job, *(report.psnr(light, wanted) for light in shown)),
        "seconds_per_iteration": seconds,
        "final_loss": loss,
        "image": (image * numbers["scale"]).cpu(),
        "phases": phases,
    }


def _seen(job: Job, ideal: torch.Tensor, saved: torch.Tensor, wavelength: float) -> tuple[torch.Tensor, ...]:
    """Return what is seen of phases ``[frames, rows, columns]``, as the report states it and by the other figure.

    The first image is seen of the phases as computed, the other two of the phases as saved.
    """
    response = files.response_of(job)
    light = 1.0 if response is None else response.light(ideal)
    kind = torch.complex64 if ideal.dtype == torch.float32 else torch.complex128
    fields = [light * wave.generate_complex_field(1.0, phases).to(kind) for phases in (ideal, saved)]
    method = verification_type(job, wavelength)
    # As computed and as saved, frame beside frame.
    both = torch.stack(fields, 1).flatten(0, 1)
    lights = _intensity_at(job, both, wavelength, job.distance, method, job.fill_factor)
    other = _intensity_at(job, fields[1], wavelength, job.distance, method, _other_fill(job)).mean(0)
    return lights[::2].mean(0), lights[1::2].mean(0), other


def _seen_behind_lens(job: Job, ideal: torch.Tensor, saved: torch.Tensor, wavelength: float):
    """Return what :func:`_seen` returns, behind the lens of a calibrated table."""
    display = _display(job, [wavelength], lens_of(job) or [job.distance], torch.ones(len(ideal), 1), ideal.device)
    areas, points = display.judge(saved.to(ideal))
    return display.judge(ideal)[0][0, 0], areas[0, 0], points[0, 0]


def _other_fill(job: Job) -> float | None:
    """Return the fill factor of the figure that stands beside the one that is stated: points, or whole pixels."""
    return None if job.fill_factor is not None else 1.0


def _areas_and_points(job: Job, stated: float | None, other: float | None) -> dict:
    """Return the quality over areas and at points, of which the job states one."""
    areas, points = (stated, other) if job.fill_factor is not None else (other, stated)
    return {"psnr_area_db": areas, "psnr_points_db": points}


def _hologram(job: Job, intensity: torch.Tensor, wavelength: float) -> tuple[torch.Tensor, float | None, float | None]:
    """Return the hologram of one channel.

    Parameters
    ----------
    job : Job
        Parameters of the run.
    intensity : torch.Tensor
        Target ``[rows, columns]`` on the device to compute on.
    wavelength : float
        Wavelength in metres.

    Returns
    -------
    tuple
        Complex hologram ``[rows, columns]`` of unit amplitude, the seconds per iteration, and the last loss; None
        for what the method does not have.
    """
    if job.method == "double-phase":
        return _double_phase(job, intensity, wavelength), None, None
    if job.method == "network":
        network = hologram_network(pretrained=True).to(intensity.device)
        with torch.no_grad():
            phase = network(intensity, wavelength, job.pixel_pitch, job.distance)
        return wave.generate_complex_field(1.0, phase), None, None
    with report.progress(job, f"{wavelength * 1e9:.6g} nm") as clock:
        hologram = (_descend if job.method == "sgd" else _retrieve)(job, intensity, wavelength, clock.tick)
        _finish(intensity.device)
    return hologram, clock.seconds_per_tick(), clock.loss


def _intensity_at(
    job: Job, fields: torch.Tensor, wavelength: float, distance: float, propagation_type: str, fill: float | None
) -> torch.Tensor:
    """Return the intensity at a distance over the modulator's window.

    Parameters
    ----------
    job : Job
        Parameters of the run. Double-phase holograms pass the Fourier filter that they need.
    fields : torch.Tensor
        Fields of the modulator, complex ``[frames, rows, columns]``.
    wavelength, distance : float
        In metres.
    propagation_type : str
        How to propagate.
    fill : float, optional
        Share of the area of square pixels that emits. With one the intensity is the mean over the areas of pixels,
        without it is that at their middles.

    Returns
    -------
    torch.Tensor
        Real ``[frames, rows, columns]``.
    """
    if fill is not None:
        # The means over areas need the field around the window too.
        fields = zero_pad(fields)
    aperture = half_band(fields.shape, fields.device) if job.method == "double-phase" else 1.0
    lights = []
    # Two at a time: what they share, the transfer function, takes as long as both, and more would take more memory.
    for pair in fields.split(2):
        shown = wave.propagate_beam(
            pair,
            None,
            distance,
            job.pixel_pitch,
            wavelength,
            propagation_type,
            zero_padding=[True, False, True],
            aperture=aperture,
        )
        lights += [
            wave.intensity(field) if fill is None else _mean_over_areas(field, job.resolution, fill) for field in shown
        ]
    return torch.stack(lights)


def _mean_over_areas(field: torch.Tensor, shape: Sequence[int], fill: float) -> torch.Tensor:
    """Return the mean intensity over the area of each pixel of the window, for a modulator with square pixels.

    Square pixels multiply the spectrum of the field by a product of sinc functions.

    Parameters
    ----------
    field : torch.Tensor
        Field of pixels that emit as points, complex ``[2·rows, 2·columns]``, on the padded grid.
    shape : sequence of int
        Rows and columns of the window.
    fill : float
        Share of the area of a pixel that emits.
    """
    down, across = (torch.sinc(math.sqrt(fill) * torch.fft.fftfreq(n, device=field.device)) for n in field.shape)
    spectrum = torch.fft.fft2(torch.fft.ifftshift(field)) * (down[:, None] * across)
    # The stop ends below 1/(2·pitch), where a frequency and its alias are one.
    spectrum[field.shape[0] // 2], spectrum[:, field.shape[1] // 2] = 0, 0
    return mean_over_areas(torch.fft.fftshift(torch.fft.ifft2(spectrum)), shape)


def half_band(shape: Sequence[int], device: torch.device) -> torch.Tensor:
    """Return the centred Fourier filter of a 4f relay that passes the inner half of the band along each axis.

    Parameters
    ----------
    shape : tuple of int
        Rows and columns of the hologram; the filter is for the grid of twice that size.
    device : torch.device
        Where to make it.

    Returns
    -------
    torch.Tensor
        Ones where both frequencies are within ±1/(4·pitch), zeros elsewhere; at the edge, the share of the frequency's
        interval that lies within.
    """
    rows, columns = (
        (FILTER * n + 0.5 - (torch.arange(2 * n, device=device) - n).abs()).clamp(0, 1) for n in shape[-2:]
    )
    return rows[:, None] * columns[None, :]


def grating_phase(shape: tuple[int, int], device: torch.device) -> torch.Tensor:
    """Return the phase of the binary grating that `--grating` adds: π on every second column, from the first."""
    return (
        torch.as_tensor(wave.calculate_phase(wave.linear_grating(*shape, every=2, axis="y"))).abs().double().to(device)
    )


def _descend(job: Job, intensity: torch.Tensor, wavelength: float, callback: Callable) -> torch.Tensor:
    if job.fill_factor is not None and method_named(job.propagation_type).name in EXACT:
        frames = job.frames or 1
        lens = lens_of(job)
        display = _display(job, [wavelength], lens or [job.distance], torch.ones(frames, 1), intensity.device)
        if lens is None or job.initial_phase != "gs":
            start = _phases_of_frames(job, intensity, wavelength).reshape(frames, *job.resolution)
        else:
            start = starts.starting_phases(display, intensity[None, None], "gs", job.seed)
        mean_error = torch.nn.functional.mse_loss
        problem = wave.Problem(display, intensity[None, None], mean_error, start, _run(job, callback), job.scale)
        phases = _descend_over_areas(job, problem)
        return wave.generate_complex_field(1.0, phases.reshape(*([frames] if frames > 1 else []), *job.resolution))
    hologram, _ = wave.stochastic_gradient_descent(
        intensity,
        wavelength,
        job.distance,
        job.pixel_pitch,
        job.propagation_type,
        job.iterations,
        learning_rate=job.learning_rate or LEARNING_RATE,
        optimizer=job.optimizer or SOLVERS[0],
        initial_phase=_phases_of_frames(job, intensity, wavelength),
        scale=job.scale,
        frames=job.frames or 1,
        pixel_fill=job.fill_factor,
        slm=_modulator(job, intensity),
        progress=False,
        callback=callback,
    )
    return hologram


def _modulator(job: Job, like: torch.Tensor) -> Callable | None:
    """Return the function that takes a phase to the modulator's field in the measured light; None in even light."""
    response = files.response_of(job)
    if response is None or response.amplitude is None:
        return None
    light = response.light(like)
    return lambda phase: wave.generate_complex_field(light, phase)


def _display(job: Job, wavelengths: Sequence[float], distances: Sequence[float] | Lens, powers, device) -> wave.Display:
    """Return the display of real pixels that a job describes, with sources of some powers ``[frames, colours]``."""
    modulator = _modulator(job, torch.zeros(job.resolution, device=device))
    panel = wave.Modulator(job.resolution, job.pixel_pitch, None, job.fill_factor or 1.0, modulator)
    return wave.Display(panel, wavelengths, distances, len(powers), powers).to(device)


def _descend_over_areas(job: Job, problem: wave.Problem, powers: bool = False) -> Any:
    """Return what solves a problem of means over the areas of pixels, which are what the report states."""
    return wave.Descent(job.optimizer or SOLVERS[0], job.learning_rate or LEARNING_RATE, powers).solve(problem)


def _run(job: Job, callback: Callable) -> wave.Run:
    return wave.Run(job.iterations, False, callback, seed=job.seed)


def _phases_of_frames(job: Job, intensity: torch.Tensor, wavelength: float) -> torch.Tensor:
    """Return the phase that gradient descent starts from, ``[frames, rows, columns]`` with several frames."""
    frames, computed = job.frames or 1, COMPUTED_PHASES.get(str(job.initial_phase))
    if computed is not None:
        return starts.starting_phase(
            computed, intensity, wavelength, job.distance, job.pixel_pitch, job.propagation_type, job.seed, frames
        )
    if frames == 1:
        return starting_phase(job, intensity, wavelength)
    phases = starting_phase(job, intensity.expand(frames, -1, -1), wavelength)
    if job.initial_phase in (*NOISE, "uniform"):
        return phases
    noise = torch.randn(phases.shape, generator=torch.Generator().manual_seed(job.seed))
    return phases + FRAME_NOISE * noise.to(phases)


def _retrieve(job: Job, intensity: torch.Tensor, wavelength: float, callback: Callable) -> torch.Tensor:
    hologram, _ = wave.gerchberg_saxton(
        wave.generate_complex_field(intensity.sqrt(), torch.zeros_like(intensity)),
        job.iterations,
        job.distance,
        job.pixel_pitch,
        wavelength,
        2 * math.pi,
        job.propagation_type,
        initial_phase=starting_phase(job, intensity, wavelength),
        progress=False,
        callback=callback,
        pixel_fill=job.fill_factor,
    )
    return hologram


def _double_phase(job: Job, intensity: torch.Tensor, wavelength: float) -> torch.Tensor:
    phase = wave.shift_w_double_phase(
        starting_phase(job, intensity, wavelength),
        -job.distance,
        job.pixel_pitch,
        wavelength,
        job.propagation_type,
        kernel_length=0,
        amplitude=intensity.sqrt(),
        pixel_fill=job.fill_factor,
    )
    return wave.generate_complex_field(1.0, phase)


def starting_phase(job: Job, like: torch.Tensor, wavelength: float) -> torch.Tensor:
    """Return the phase to start from: of the hologram, or of the picture for double phase.

    Parameters
    ----------
    job : Job
        Parameters of the run.
    like : torch.Tensor
        Real ``[..., rows, columns]``, whose shape, precision and device the phase takes.
    wavelength : float
        Wavelength in metres.

    Returns
    -------
    torch.Tensor
        Zeros; a lens of focal length 2·distance; normal noise of deviation 0.3 or 1 rad; or noise uniform over 2π.
    """
    generator = torch.Generator().manual_seed(job.seed)
    if job.initial_phase == "quadratic":
        phase = wave.lens_phase(tuple(like.shape[-2:]), 2 * job.distance, job.pixel_pitch, wavelength)
    elif job.initial_phase in NOISE:
        phase = NOISE[job.initial_phase] * torch.randn(like.shape, generator=generator)
    elif job.initial_phase == "uniform":
        phase = 2 * math.pi * torch.rand(like.shape, generator=generator)
    else:
        phase = torch.zeros(like.shape)
    return phase.to(like).expand(like.shape).clone()


def _finish(device: torch.device) -> None:
    """Wait for the device, which works asynchronously, so that times are correct."""
    if device.type == "cuda":
        torch.cuda.synchronize(device)


# --- Several planes, or colours that share their frames


@dataclass(frozen=True)
class Frames:
    """Patterns shown one after another, and the amplitudes of their sources.

    Attributes
    ----------
    phases : torch.Tensor
        ``[frames, rows, columns]`` in radians.
    powers : torch.Tensor
        Amplitude of each source in each frame, ``[frames, channels]``.
    """

    phases: torch.Tensor
    powers: torch.Tensor


def _compute_volume(job: Job, target: Target, folder: Path, names: list[str], device: torch.device) -> dict:
    """Compute, save, read back and measure the patterns of a volume, or of colours that share their frames."""
    volume = load_volume(job, target, device)
    if job.method == "network":
        ideal, seconds, loss = _network_frames(job, target, volume), None, None
    else:
        ideal, seconds, loss = _optimise(job, target, volume, device)
    grating = grating_phase(job.resolution, device) if job.grating else torch.zeros(1, device=device)
    response = files.response_of(job)
    for name, phase in zip(names, ideal.phases, strict=True):
        modulated = wave.generate_complex_field(1.0, phase.double() + grating)
        files.save_pattern(folder / name, files.quantise(modulated, job.bits, response), job.bits)
    stored = torch.stack([files.load_pattern(folder / name, job.bits, response) for name in names])
    saved = Frames(stored.to(device) - grating, ideal.powers)
    images, before, other = (
        _reconstruct_volume(job, target, volume, frames, fill)
        for frames, fill in ((saved, job.fill_factor), (ideal, job.fill_factor), (saved, _other_fill(job)))
    )
    channels, scales, brightness = _channels(job, target, volume, ideal.powers, images, before, other)
    planes = _planes(target, volume, images * scales)
    if job.planes > 1:
        stack = _focal_stack(job, planes, volume.images.cpu(), (images * scales).cpu())
        files.write_png(folder / "focal_stack.png", stack)
    return {
        "images": (images * scales * volume.masks).sum(0).cpu(),
        "phases": stored,
        "channels": [
            {"wavelength": wavelength, **channel}
            for wavelength, channel in zip(target.wavelengths, channels, strict=True)
        ],
        "brightness": brightness,
        "planes": planes,
        "frames": [
            {"file": name, "source_amplitudes": power} for name, power in zip(names, ideal.powers.tolist(), strict=True)
        ],
        "seconds_per_iteration": seconds,
        "final_loss": loss,
    }


def _frame_files(job: Job, target: Target) -> list[str]:
    """Return the name of each frame's pattern file: its wavelength, or its number where frames share colours."""
    if job.method in ("multiplane", "network"):
        return [pattern_name(wavelength) for wavelength in target.wavelengths]
    return [f"hologram_frame{index + 1}.png" for index in range(job.frames or len(target.wavelengths))]


def _optimise(job: Job, target: Target, volume: Volume, device) -> tuple[Frames, float | None, float | None]:
    with report.progress(
        job, f"{job.planes} planes" if job.planes > 1 else f"{len(_frame_files(job, target))} frames"
    ) as clock:
        frames = (_frames_over_areas if job.over_areas else _frames_at_points)(job, target, volume, device, clock.tick)
        _finish(device)
    return frames, clock.seconds_per_tick(), clock.loss


def _frames_over_areas(job: Job, target: Target, volume: Volume, device, callback: Callable) -> Frames:
    """Return the patterns whose means over the areas of pixels are the images of all planes, and their sources."""
    count, colours, shared = len(_frame_files(job, target)), len(target.wavelengths), job.method == "multi-color"
    powers = torch.ones(count, colours) if shared else torch.eye(count)
    display = _display(job, target.wavelengths, volume.distances, powers, device)
    start: Any = job.initial_phase
    if start in COMPUTED_PHASES:
        start = starts.starting_phases(display, volume.images, COMPUTED_PHASES[start], job.seed)
    else:
        start = starting_phase(job, torch.zeros(count, *job.resolution, device=device), target.wavelengths[0])
    loss = torch.nn.functional.mse_loss if volume.loss is None else volume.loss
    problem = wave.Problem(display, volume.images, loss, start, _run(job, callback), job.scale)
    solved = _descend_over_areas(job, problem, shared)
    phases, powers = solved if shared else (solved, display.powers)
    powers = powers / powers.sum(0)
    if job.scale:
        with torch.no_grad():
            powers = powers * _brightness(target, volume, display(phases, powers))
        powers = powers / powers.max()
    return Frames(phases, powers.sqrt())


def _brightness(target: Target, volume: Volume, images: torch.Tensor) -> torch.Tensor:
    """Return the brightness of each colour at which images ``[planes, colours, …]`` fit the picture best."""
    sharp, window = (images * volume.masks).sum(0), (..., *target.window)
    wanted = target.intensity.to(images.device)
    return brightness_of(sharp[window][None].double(), wanted[window][None].double()).flatten().clamp_min(1e-6)


def _frames_at_points(job: Job, target: Target, volume: Volume, device, callback: Callable) -> Frames:
    count, shared = len(_frame_files(job, target)), job.method == "multi-color"
    method = "multi-color" if shared else "conventional"
    display = wave.propagator(
        job.resolution,
        list(target.wavelengths),
        job.pixel_pitch,
        number_of_frames=count,
        distances=volume.distances,
        propagation_type=job.propagation_type,
        propagator_type="forward",
        method=method,
        device=device,
        pixel_fill=job.fill_factor,
        aperture="open",
    )
    start, rate = torch.zeros(count, *job.resolution, device=device), job.learning_rate or LEARNING_RATE
    optimizer = wave.multi_color_hologram_optimizer(
        list(target.wavelengths),
        list(job.resolution),
        volume.images,
        display,
        count,
        job.planes,
        learning_rate=rate,
        min_learning_rate=rate / 2,
        method=method,
        loss_function=volume.loss,
        # All sources at full power where they share the frames.
        peak_amplitude=float(count) if shared and job.scale else 1.0,
        optimize_peak_amplitude=job.scale,
        reduction="mean",
        initial_phase=starting_phase(job, start, target.wavelengths[0]),
        progress=False,
        seed=job.seed,
        callback=callback,
    )
    # The light loss would drive all sources to full power, and with them colours that the picture does not have.
    _, phases, _, powers, _, _ = optimizer.optimize(job.iterations, {"eyebox": 0.0, "light": 0.0}, bits=None)
    if job.scale:
        # The scale is free: the brightest source is at full power.
        powers = powers / powers.amax().clamp_min(1e-6)
    return Frames(phases, powers)


def _network_frames(job: Job, target: Target, volume: Volume) -> Frames:
    """Return one pattern for each colour, with sources at the brightness that fits the picture best."""
    device = volume.images.device
    network, intensity = hologram_network(pretrained=True).to(device), target.intensity.to(device)
    planes = torch.arange(job.planes, device=device)[:, None, None]
    depth = (volume.masks[:, 0] * planes).sum(0) / (job.planes - 1)
    with torch.no_grad():
        phases = network(intensity, target.wavelengths, job.pixel_pitch, volume.distances, depth)
    count = len(target.wavelengths)
    frames = Frames(phases, torch.eye(count, device=device))
    scales = _brightness(target, volume, _reconstruct_volume(job, target, volume, frames, job.fill_factor))
    return Frames(phases, frames.powers * (scales / scales.amax()).sqrt().to(frames.powers))


def _reconstruct_volume(job: Job, target: Target, volume: Volume, frames: Frames, fill: float | None) -> torch.Tensor:
    """Return the intensity on each plane over each colour's source intensity, ``[planes, channels, rows, columns]``.

    Plane by plane with the method that its distance asks for, and not with the display of the optimizer.
    """
    response = files.response_of(job)
    light = 1.0 if response is None else response.light(frames.phases)
    fields = wave.generate_complex_field(light, frames.phases).to(torch.complex64)
    images = []
    for distance in volume.distances:
        for wavelength, power in zip(target.wavelengths, frames.powers.mT, strict=True):
            method = sampling_report(
                job.resolution, job.pixel_pitch, wavelength, distance, zero_padding=True
            ).recommended
            lit = power > 0
            light = (
                _intensity_at(job, fields[lit], wavelength, distance, method, fill)
                if bool(lit.any())
                else fields.real * 0
            )
            share = power[lit].square() if bool(lit.any()) else torch.ones_like(power)
            images.append((light * share[:, None, None]).sum(0) / share.sum())
    return torch.stack(images).reshape(volume.images.shape)


def _channels(job: Job, target: Target, volume: Volume, powers, *stacks) -> tuple[list[dict], torch.Tensor, float]:
    """Return the quality of each colour with each pixel from its own plane, their scales, and the common brightness.

    Parameters
    ----------
    job, target, volume : Job, Target, Volume
        The run, and the picture, whole and by planes.
    powers : torch.Tensor
        Amplitudes of the sources ``[frames, channels]``.
    *stacks : torch.Tensor
        Intensities of the saved patterns, of the patterns as computed, and of the saved patterns by the other figure.
    """
    light = powers.double().square().sum(0)[:, None, None]
    wanted = target.intensity.to(light.device).double()
    window = (slice(None), *target.window)
    sharp = [(part * volume.masks).sum(0).double() for part in stacks]
    # One brightness for all colours: the powers of the sources are part of the hologram.
    whole = wanted[window].reshape(1, -1)
    bright = [float(best_scale((light * part)[window].reshape(1, -1), whole)) for part in sharp]
    scales = [brightness * light for brightness in bright]
    channels = [
        {
            **report.measure(
                wanted[c], target.window, sharp[0][c], sharp[1][c], (float(scales[0][c]), float(scales[1][c]))
            ),
            **_areas_and_points(
                job,
                *(report.psnr((scales[k] * sharp[k])[c][target.window], wanted[c][target.window]) for k in (0, 2)),
            ),
        }
        for c in range(len(wanted))
    ]
    return channels, scales[0].to(stacks[0].dtype), bright[0]


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
        "psnr_db": report.psnr(image, wanted),
        "psnr_in_focus_db": report.decibels(sharp),
        "ssim": report.ssim(image, wanted),
    }


def _focal_stack(job: Job, planes: list[dict], wanted: torch.Tensor, images: torch.Tensor):
    rows: list[list] = [[], []]
    for plane, target, image in zip(planes, wanted, images, strict=True):
        known = [channel["psnr_in_focus_db"] for channel in plane["channels"]]
        quality = "" if None in known else f", in focus {sum(known) / len(known):.1f} dB"
        rows[0].append(report.picture_panel(f"Target at {plane['distance'] * 1e3:.4g} mm", target))
        rows[1].append(report.picture_panel(f"Reconstruction{quality}", image))
    return _sheet(job, rows)
