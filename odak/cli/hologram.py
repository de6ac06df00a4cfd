"""Computation of holograms for `odak hologram`: from the picture to the files and the report.

Each pattern is evaluated as saved: quantised, written, read back, and propagated with the method recommended for its
distance.
"""

import dataclasses
import math
import os
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import torch
from PIL import Image

from odak._lengths import UNITS
from odak._warnings import AccuracyWarning, warn
from odak.cli import files, report
from odak.cli.job import (
    GREY_WAVELENGTH,
    LEARNING_RATE,
    NOISE,
    VOLUME_METHODS,
    Job,
    pattern_name,
)
from odak.cli.light_field import eyes_of, judged, load_light_field, load_pupils, write_views
from odak.cli.options import InputError, refusing
from odak.cli.target import Target, Volume, load_target, load_volume, on_screen
from odak.instruments import Lens
from odak.learn import wave
from odak.learn.models.hologram_networks import FARTHEST, RATIOS, SPREADS, hologram_network
from odak.learn.wave.displays.observers import PLACES
from odak.learn.wave.holograms.starts import starting_phases
from odak.learn.wave.training import best_scale
from odak.wave import sampling_report
from odak.wave.methods import METHODS, PROPAGATION_TYPES, find_method

# Share of the area of a pixel that emits which stands for points.
_POINT = 1e-9
# Standard deviation in radians of the noise that distinguishes frames with the same starting phase.
FRAME_NOISE = 0.5
UNFIT = tuple(
    method.name for method in METHODS if method.of_intensities or method.sets_own_pitch or method.takes_kernel
)


@files.claiming
def run(job: Job, notices: files.Notices = files.SILENT) -> dict[str, Any]:
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
        target = load_target(job) if job.scene is None else load_light_field(job)
        if job.method == "network":
            check_training_range(job, target.wavelengths)
        folder = files.writable_folder(job.output)
        names = [name for _, group in _groups(job, target) for name in group]
        others = ["reconstruction.png", "comparison.png", files.REPORT, *["focal_stack.png"] * (job.planes > 1)]
        others += ["views.png"] * (job.scene is not None)
        files.announce(folder, [*names, *others], notices)
        result = _compute(job, target, folder, device)
        images, phases, maps = (result.pop(name) for name in ("images", "phases", "maps"))
        quality = report.overall(target, images, result["channels"])
        figures = ["psnr_area_db", "psnr_points_db", *([] if _shares_frames(job) else ["psnr_db"])]
        quality |= {name: report.mean_decibels(result["channels"], name) for name in figures}
        shown, wanted = (on_screen(light, target.wavelengths, job.linear) for light in (images, target.intensity))
        window = (slice(None), *target.window)
        quality["psnr_encoded_db"] = report.psnr(shown[window], wanted[window])
        files.write_png(folder / "reconstruction.png", report.to_image(shown))
        files.write_png(folder / "comparison.png", comparison(job, target, images, phases, names, quality))
        if maps:
            write_views(folder / "views.png", job, target, maps)
            quality["psnr_unseen_db"] = min(float(one.psnr.min()) for one in maps)
    summary = {
        **quality,
        **result,
        "warnings": texts,
        "verification": _verification(job, target),
        **report.parameters_of(job, target, names, device),
        "seconds_total": time.perf_counter() - start,
    }
    written = [*names, "reconstruction.png", "comparison.png", *["views.png"] * (job.scene is not None)]
    # What was cut short is not the result that a second run looks for.
    mark = "" if result["interrupted"] else files.fingerprint_of(job)
    return files.write_report(folder, summary, mark, written)


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
        "--fill-factor 0": not job.fill_factor,
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


def comparison(
    job: Job,
    target: Target,
    images: torch.Tensor,
    phases: Iterable[torch.Tensor],
    names: list[str],
    quality: dict[str, Any],
) -> Image.Image:
    """Return target, reconstruction, their difference and the patterns side by side."""
    psnr = "" if quality["psnr_db"] is None else f", PSNR {quality['psnr_db']:.1f} dB"
    where = "in focus" if job.planes > 1 else f"at {job.distance * 1e3:.4g} mm"
    where = where if job.scene is None else "from the middle of the eyebox"
    if (lens := lens_of(job)) is not None:
        where = f"behind a lens of {lens.focal_length * 1e3:.4g} mm"
    first = [
        report.picture_panel("Target", on_screen(target.intensity, target.wavelengths, job.linear)),
        report.picture_panel(
            f"Reconstruction {where}{psnr}, SSIM {quality['ssim']:.3f}",
            on_screen(images, target.wavelengths, job.linear),
        ),
    ]
    difference = report.difference_panel("Reconstruction minus target", images - target.intensity)
    patterns = [
        report.phase_panel(f"Hologram: phase on the modulator, {name}, {job.bits} bit", phase)
        for name, phase in list(zip(names, phases, strict=True))[:3]
    ]
    rows = [first, [difference, *patterns]] if len(patterns) == 1 else [[*first, difference], patterns]
    return _sheet(job, rows)


def _sheet(job: Job, rows: list[list[report.Panel]]) -> Image.Image:
    """Return panels of images and patterns in rows, with the shape and size that they have on the modulator."""
    dy, dx = files.image_pitches(job)
    return report.sheet(rows, job.resolution[1] * dx, dy / dx)


def _verification(job: Job, target: Target) -> dict[str, Any]:
    filtered = "round stop passing |f| <= sqrt(2)/(4*pitch), as double phase needs (a 4f relay)"
    points = "points: intensities at the middles of pixels that emit as points"
    squares = "squares: means over the areas of pixels, which emit as squares of the fill factor; their gaps are dark"
    behind, observer = {}, observer_of(job, target)
    if (lens := lens_of(job)) is None:
        kinds = [verification_type(job, wavelength) for wavelength in target.wavelengths]
        if job.scene is not None:
            kinds = ["Fresnel's integral to points of each pupil, and from these to the retina"]
    else:
        kinds = ["Fourier sums over all pixels, at twice as many points along each axis as the picture has"]
        behind = {"lens": dataclasses.asdict(lens), "picture_pitch": list(files.image_pitches(job))}
    return {
        "propagation_type": kinds,
        **behind,
        "grating": "its phase was subtracted from the pattern read back" if job.grating else None,
        "modulator": _described(job),
        "observer": replace(observer, registered=True).in_words() if _shares_frames(job) else observer.in_words(),
        "aperture": filtered if job.method == "double-phase" else None,
        "pixel": {"fill_factor": job.fill_factor, "model": squares if job.fill_factor else points},
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


# --- Computation


class By(NamedTuple):
    """A solver that is a function of the problem."""

    solve: Callable[[wave.Problem], Any]


def _groups(job: Job, target: Target) -> list[tuple[list[int], list[str]]]:
    """Return the colours that are computed together, and the names of their pattern files."""
    if not _shares_frames(job):
        frames = [None] if job.frames in (None, 1) else [index + 1 for index in range(int(job.frames or 1))]
        return [([c], [pattern_name(value, frame) for frame in frames]) for c, value in enumerate(target.wavelengths)]
    names = [pattern_name(wavelength) for wavelength in target.wavelengths]
    if job.method == "multi-color":
        names = [f"hologram_frame{index + 1}.png" for index in range(job.frames or len(names))]
    return [(list(range(len(target.wavelengths))), names)]


def _shares_frames(job: Job) -> bool:
    """Return whether all colours are one problem, with planes or sources that they share."""
    return job.method in VOLUME_METHODS or job.planes > 1


def _compute(job: Job, target: Target, folder: Path, device: torch.device) -> dict[str, Any]:
    """Compute, save, read back and measure the patterns of a picture; return their part of the report."""
    results: list[dict[str, Any]] = []
    for colours, names in _groups(job, target):
        # After Ctrl-C the colours that are left get the least.
        count = 1 if any(result["interrupted"] for result in results) else int(job.iterations or 1)
        results.append(_group(job, target, colours, names, folder, device, count))
    seconds = [result["seconds_per_iteration"] for result in results if result["seconds_per_iteration"] is not None]
    return {
        **results[0],
        "images": torch.cat([result["images"] for result in results]),
        "phases": torch.cat([result["phases"] for result in results]),
        "maps": [one for result in results for one in result["maps"]],
        "channels": [channel for result in results for channel in result["channels"]],
        "interrupted": any(result["interrupted"] for result in results),
        "reached": next((result["reached"] for result in results if result["interrupted"]), results[0]["reached"]),
        "seconds_per_iteration": sum(seconds) / len(seconds) if seconds else None,
    }


def _group(
    job: Job, target: Target, colours: list[int], names: list[str], folder: Path, device: torch.device, count: int
) -> dict[str, Any]:
    """Compute, save, read back and measure the patterns of colours that are one problem."""
    part = target.of(colours)
    volume = load_volume(job, part, device) if part.field is None else load_pupils(job, part, device)
    ends = volume.distances if part.field is None else eyes_of(job)
    display = display_of(job, part.wavelengths, ends, len(names), device)
    observer, saving = observer_of(job, part), Saving(job, part, volume, [folder / name for name in names], count)
    found = wave.optimise(
        display,
        volume.images if volume.loss is None else volume.loss,
        solver=saving,
        start="flat",
        run=wave.Run(max(1, count), False, saving.tick, seed=job.seed),
        observer=observer,
    )
    clock, display = saving.clock, found.display
    areas = found.images / found.brightness[:, None, None]
    images = areas if job.fill_factor else display.judge(found.phases)[1]
    fill = 1.0 if job.fill_factor else 0.0
    before = display.recorded_by(wave.Observer(fill=fill, registered=True), saving.ideal)[0].detach()
    channels, scales, brightness, powers = _channels(job, part, volume, display.powers, images, before)
    _add_observed(job, found, channels)
    result: dict[str, Any] = {
        "images": (images * scales * volume.masks).sum(0).cpu(),
        "phases": saving.stored,
        "maps": [],
        "channels": [
            {"wavelength": wavelength, **channel}
            for wavelength, channel in zip(part.wavelengths, channels, strict=True)
        ],
        "seconds_per_iteration": clock.seconds_per_tick() if job.iterates else None,
        "reached": clock.reached(count) if job.iterates else f"all that the method {job.method} does",
        "interrupted": clock.interrupted,
    }
    searched = found.gain_over_rounding
    gain = {} if searched is None else {"gain_over_rounding_db": float(searched)}
    if not _shares_frames(job):
        (channel,) = result["channels"]
        if part.field is not None:
            channel["pupils"], seen = judged(job, part, found)
            result["maps"] = [seen]
        channel |= {"file": names[0], **({"files": names} if len(names) > 1 else {})}
        channel |= {"seconds_per_iteration": result["seconds_per_iteration"], "final_loss": clock.loss}
        channel |= gain
        return result
    planes = _planes(part, volume, images * scales, found.psnr)
    if job.planes > 1:
        files.write_png(
            folder / "focal_stack.png", _focal_stack(job, planes, volume.images.cpu(), (images * scales).cpu())
        )
    amplitudes = powers.sqrt().tolist()
    frames = [{"file": name, "source_amplitudes": each} for name, each in zip(names, amplitudes, strict=True)]
    result |= gain
    return {**result, "brightness": brightness, "planes": planes, "frames": frames, "final_loss": clock.loss}


def display_of(
    job: Job, wavelengths: Sequence[float], ends: Sequence[float] | wave.Eyes, frames: int, device: torch.device
) -> wave.Display:
    """Return the display that a job describes, without the levels of its modulator.

    Parameters
    ----------
    job : Job
        Settings of the run.
    wavelengths : sequence of float
        Wavelengths in metres.
    ends : sequence of float or Eyes
        Distances of the planes in metres, or the eyes; behind a lens, that of the calibration counts.
    frames : int
        Number of patterns. One wavelength lights all of them; of several, each lights its own, and with the method
        "multi-color" all.
    device : torch.device
        Where to compute.
    """
    alone = len(wavelengths) == 1 or job.method == "multi-color"
    powers = torch.ones(frames, len(wavelengths)) if alone else torch.eye(frames)
    response = files.response_of(job)
    profile = None if response is None or response.amplitude is None else torch.as_tensor(response.amplitude).float()
    iris: Any = "order"
    if job.method == "double-phase":
        # The circle around the band of the picture, which passes no other order of the checkerboard.
        iris = wave.Iris(max(wavelengths) * math.sqrt(2) / (4 * max(job.pitches)), 1.0)
    bits = job.bits if job.optimizer == "levels" else None
    panel = wave.Modulator(job.resolution, job.pixel_pitch, bits, job.fill_factor or _POINT)
    space: Any = ends
    if not isinstance(ends, wave.Eyes) and job.method != "double-phase":
        space = wave.Free(ends, method=job.propagation_type)
    return wave.Display(panel, wavelengths, lens_of(job) or space, frames, powers, profile, iris).to(device)


@dataclass(frozen=True, repr=False)
class Framed(wave.Observer):
    """An observer who looks at the window of a picture, and not at the black around it.

    Attributes
    ----------
    window : tuple of slice
        Rows and columns of the picture.
    """

    window: tuple[slice, ...] = ()

    def places(self, shape: Sequence[int], pitches: Sequence[float]) -> list[list[slice]]:
        """Return along rows and along columns which quarters of a pixel each place of the observer takes."""
        found = super().places([part.stop - part.start for part in self.window], pitches)
        ahead = [PLACES * part.start for part in self.window]
        return [
            [slice(one.start + by, one.stop + by, one.step) for one in along]
            for along, by in zip(found, ahead, strict=True)
        ]


def observer_of(job: Job, target: Target) -> Framed:
    """Return who looks at the picture."""
    points = job.observer == "points"
    return Framed(fill=0.0 if points else 1.0, registered=job.observer != "camera", window=target.window)


class Saving:
    """A solver that saves the patterns of a job's own, and returns them as they are read back.

    Attributes
    ----------
    clock : Clock
        Of the iterations.
    ideal, stored : torch.Tensor
        Phases as computed, and as the files hold them, ``[frames, rows, columns]``.
    """

    clock: report.Clock
    ideal: torch.Tensor
    stored: torch.Tensor

    def __init__(self, job: Job, target: Target, volume: Volume, paths: list[Path], count: int) -> None:
        self.job: Job = job
        self.paths: list[Path] = paths
        self.count: int = count if job.iterates else 0
        self.target: Target = target
        self.volume: Volume = volume
        self.solver = _solver(job, target, volume)
        self.name: str = f"{job.planes} planes" if job.planes > 1 else f"{target.wavelengths[0] * 1e9:.6g} nm"
        if _shares_frames(job) and job.planes == 1:
            self.name = f"{len(paths)} frames"

    def tick(self, iteration: int, value: torch.Tensor) -> bool:
        """Count an iteration."""
        return self.clock.tick(iteration, value)

    def solve(self, problem: wave.Problem) -> Any:
        """Return the phases of the saved patterns, and what else was found."""
        job, display = self.job, problem.display
        begun = problem.start.clone()
        with report.progress(self.name, self.count, job.quiet, job.settles, partial=True) as self.clock:
            try:
                begun = starting_phases(
                    display,
                    problem.target,
                    _start(job, display, [path.name for path in self.paths]),
                    problem.run.seed,
                    into=begun,
                )
                problem = replace(problem, start=begun)
                if self.count > 1 and job.method != "gs":
                    self._show_start(problem)
                solved = self.solver.solve(problem)
            except KeyboardInterrupt:
                # Before the first iteration; those handle it themselves.
                if not job.iterates:
                    raise
                solved = begun
            if problem.target.is_cuda:
                torch.cuda.synchronize(problem.target.device)
        self.ideal, *others = solved if isinstance(solved, tuple) else (solved,)
        shown = self._saved(display.modulator, self.ideal)
        return (shown, *others) if others else shown

    def _saved(self, panel: wave.Modulator, phases: torch.Tensor) -> torch.Tensor:
        """Write the files of phases, and return the phases that these hold, without the grating."""
        job, response = self.job, files.response_of(self.job)
        grating = grating_phase(job.resolution, phases.device) if job.grating else 0.0
        for path, phase in zip(self.paths, phases.double() + grating, strict=True):
            # A phase of a level is the lower end of what is rounded down to it.
            searched = job.optimizer == "levels"
            levels = panel.levels(phase) if searched else files.quantise(wave.unit_phasor(phase), job.bits, response)
            files.save_pattern(path, levels, job.bits)
        self.stored = torch.stack([files.load_pattern(path, job.bits, response) for path in self.paths])
        return (self.stored.to(phases.device) - grating).to(phases)

    @torch.no_grad()
    def _show_start(self, problem: wave.Problem) -> None:
        """Write the patterns of the start and their image, which the iterations improve, and say how good it is."""
        window, wanted = (slice(None), *self.target.window), self.target.intensity.to(problem.target)
        shown = self._saved(problem.display.modulator, problem.start)
        camera = wave.Observer(fill=problem.observer.fill, registered=True)
        image = (problem.display.recorded_by(camera, shown)[0] * self.volume.masks).sum(0)
        image = image * best_scale(image[window], wanted[window])
        file = self.paths[0].with_name("reconstruction.png")
        files.write_png(file, report.to_image(on_screen(image.cpu(), self.target.wavelengths, self.job.linear)))
        self.clock.bar.set_postfix_str(f"{report.psnr(image[window], wanted[window]):.1f} dB in {file.name}")


def _solver(job: Job, target: Target, volume: Volume) -> Any:
    """Return the solver of a job."""
    if job.method == "network":
        return By(lambda problem: _by_network(job, target, volume, problem))
    if job.method == "double-phase":
        return By(lambda problem: _double_phase(job, problem))
    if job.method == "gs":
        return wave.AlternatingProjections()
    solver: Any = wave.LevelSearch()
    if job.optimizer != "levels":
        solver = wave.Descent(str(job.optimizer), job.learning_rate or LEARNING_RATE, job.method == "multi-color")
    return solver if job.scale else By(lambda problem: solver.solve(replace(problem, free=False)))


def _start(job: Job, display: wave.Display, names: Sequence[str] = ()) -> Any:
    """Return the start of a job: the library's name of one, or phases ``[frames, rows, columns]``.

    `names` are those of the pattern files, of which the folder of an earlier result may hold some to begin with.
    """
    if job.start is not None:
        known = [Path(os.path.expanduser(job.start)) / name for name in names]
        wanted = f"--start must hold {', '.join(names)} of {job.resolution[0]} x {job.resolution[1]} pixels: "
        with refusing(wanted, OSError, ValueError, RuntimeError):
            phases = [files.load_pattern(path, job.bits, files.response_of(job)) for path in known]
            found = torch.stack([phase.reshape(job.resolution) for phase in phases])
        found = found - grating_phase(job.resolution, found.device) if job.grating else found
        return found.to(display.powers)
    known = {"gs": "gs", "double-phase": "double phase", "flat": "flat", "uniform": "random", None: "flat"}
    if job.initial_phase in known and job.method != "double-phase":
        return known[job.initial_phase]
    return _drawn(job, (display.frames, *job.resolution))


def _drawn(job: Job, shape: tuple[int, ...]) -> torch.Tensor:
    """Return the phases ``[frames, rows, columns]`` of a start that is not computed from the picture."""
    generator = torch.Generator().manual_seed(job.seed)
    if job.initial_phase in NOISE:
        return NOISE[job.initial_phase] * torch.randn(shape, generator=generator)
    if job.initial_phase == "uniform":
        return 2 * math.pi * torch.rand(shape, generator=generator)
    phase = torch.zeros(shape)
    if job.initial_phase == "quadratic":
        wavelength = (job.wavelengths or (GREY_WAVELENGTH,))[0]
        phase = phase + wave.lens_phase(shape[-2:], 2 * job.distance, job.pixel_pitch, wavelength)
    return phase + FRAME_NOISE * torch.randn(shape, generator=generator) if shape[0] > 1 else phase


def _double_phase(job: Job, problem: wave.Problem) -> torch.Tensor:
    """Return the double-phase encoding of a picture, whose phase is the start of the problem."""
    intensity, display = problem.target[0, 0], problem.display
    return wave.shift_w_double_phase(
        problem.start[0].to(intensity),
        -job.distance,
        job.pixel_pitch,
        display.wavelengths[0],
        job.propagation_type,
        kernel_length=0,
        amplitude=intensity.sqrt(),
        pixel_fill=job.fill_factor or None,
    )[None]


@torch.no_grad()
def _by_network(job: Job, target: Target, volume: Volume, problem: wave.Problem) -> torch.Tensor:
    """Return the patterns that the network makes of a picture, with its depth if there are several planes."""
    intensity = target.intensity.to(problem.target.device)
    network = hologram_network(pretrained=True).to(intensity.device)
    if job.planes == 1:
        return network(intensity[0], target.wavelengths[0], job.pixel_pitch, job.distance)[None]
    planes = torch.arange(job.planes, device=intensity.device)[:, None, None]
    depth = (volume.masks[:, 0] * planes).sum(0) / (job.planes - 1)
    return network(intensity, target.wavelengths, job.pixel_pitch, volume.distances, depth)


# --- Judgement


def _add_observed(job: Job, found: wave.DisplayedHologram, channels: list[dict[str, Any]]) -> None:
    """Add to the quality of colours what is seen of areas and at points and, on one plane, by the observer."""
    registered, seen = [channel["psnr_db"] for channel in channels], found.psnr.amin(0).tolist()
    if not job.fill_factor:
        display = found.display
        panel, given = replace(display.modulator, fill=1.0), (display.frames, display.powers, display.profile)
        whole = wave.Display(panel, display.wavelengths, display.distances, *given).to(found.phases.device)
        alone = By(lambda problem: found.phases)
        areas = wave.optimise(whole, found.target, None, alone, "flat", observer=wave.Observer.camera(registered=True))
        others = {"psnr_area_db": areas.psnr.amin(0).tolist(), "psnr_points_db": registered}
    else:
        others = {"psnr_area_db": registered, "psnr_points_db": found.psnr_at_points.amin(0).tolist()}
    for c, channel in enumerate(channels):
        channel |= {name: values[c] for name, values in others.items()}
        if found.error is not None and bool((known := found.error[:, c].max()).isfinite()):
            channel["image_error"] = float(known)
        if job.fill_factor and not _shares_frames(job):
            channel["psnr_db"] = seen[c]


def _channels(
    job: Job, target: Target, volume: Volume, powers: torch.Tensor, *stacks: torch.Tensor
) -> tuple[list[dict[str, Any]], torch.Tensor, float, torch.Tensor]:
    """Return the quality of each colour with each pixel from its own plane, their scales, and brightness and powers.

    Parameters
    ----------
    job, target, volume : Job, Target, Volume
        The run, and the picture, whole and by planes.
    powers : torch.Tensor
        Powers of the sources ``[frames, colours]``.
    *stacks : torch.Tensor
        Images of the saved patterns, and of the patterns as computed.
    """
    wanted = target.intensity.to(powers.device).double()
    window = (slice(None), *target.window)
    sharp = [(part * volume.masks).sum(0).double() for part in stacks]
    best = [best_scale(part[window], wanted[window]) for part in sharp]
    if job.scale or not job.iterates:
        # The sources of each colour are dimmed to the picture, the brightest one being at full power.
        powers = powers / powers.sum(0) * best[0].flatten().to(powers).clamp_min(1e-6)
        powers = powers / powers.max()
    light = powers.double().sum(0)[:, None, None]
    # One brightness for all colours: the powers of the sources are part of the hologram.
    whole = wanted[window].reshape(1, -1)
    bright = [float(best_scale((light * part)[window].reshape(1, -1), whole)) for part in sharp]
    scales = [brightness * light for brightness in bright] if _shares_frames(job) else best
    channels = [
        report.measure(wanted[c], target.window, sharp[0][c], sharp[1][c], (float(scales[0][c]), float(scales[1][c])))
        for c in range(len(wanted))
    ]
    return channels, scales[0].to(stacks[0].dtype), bright[0], powers


def grating_phase(shape: tuple[int, int], device: torch.device) -> torch.Tensor:
    """Return the phase of the binary grating that `--grating` adds: π on every second column, from the first."""
    return (
        torch.as_tensor(wave.calculate_phase(wave.linear_grating(*shape, every=2, axis="y"))).abs().double().to(device)
    )


def _planes(target: Target, volume: Volume, scaled: torch.Tensor, seen: torch.Tensor) -> list[dict[str, Any]]:
    planes = []
    for distance, *parts, camera in zip(volume.distances, volume.images, volume.masks, scaled, seen, strict=True):
        colours = [
            {
                "wavelength": wavelength,
                **_plane_quality(*(part[target.window].double() for part in three)),
                "psnr_camera_db": value,
            }
            for wavelength, *three, value in zip(target.wavelengths, *parts, camera.tolist(), strict=True)
        ]
        share = float(parts[1][0][target.window].double().mean())
        planes.append({"distance": distance, "share_in_focus": share, "channels": colours})
    return planes


def _plane_quality(wanted, mask, image) -> dict[str, Any]:
    error = (image - wanted).square()
    sharp = float((error * mask).sum() / mask.sum()) if bool(mask.any()) else 0.0
    return {
        "psnr_db": report.psnr(image, wanted),
        "psnr_in_focus_db": report.decibels(sharp),
        "ssim": report.ssim(image, wanted),
    }


def _focal_stack(job: Job, planes: list[dict[str, Any]], wanted: torch.Tensor, images: torch.Tensor):
    rows: list[list] = [[], []]
    for plane, target, image in zip(planes, wanted, images, strict=True):
        known = [channel["psnr_in_focus_db"] for channel in plane["channels"]]
        quality = "" if None in known else f", in focus {sum(known) / len(known):.1f} dB"
        wavelengths = [channel["wavelength"] for channel in plane["channels"]]
        target, image = (on_screen(light, wavelengths, job.linear) for light in (target, image))
        rows[0].append(report.picture_panel(f"Target at {plane['distance'] * 1e3:.4g} mm", target))
        rows[1].append(report.picture_panel(f"Reconstruction{quality}", image))
    return _sheet(job, rows)
