"""Computation of holograms for `odak eyebox`: what an eye sees from several places of its pupil, optimised together.

Each picture is judged from the saved patterns by :meth:`odak.learn.wave.Display.judge`, not by the model that the
optimizer uses.
"""

from dataclasses import asdict, dataclass
from pathlib import Path

import torch

from odak import _validate
from odak.cli import files
from odak.cli.job import GREY_WAVELENGTH, SMALLEST_SIDE, InputError, image_path, warn_of_samples
from odak.cli.report import find_device, picture_panel, progress, psnr, sheet, versions
from odak.cli.target import fit, fitting_size, read_picture, to_grey
from odak.learn import wave
from odak.learn.wave.holograms import best_scale
from odak.wave.transfer_functions import pitches

DEFINITIONS = {
    "views": "For each place of the pupil, in reading order: its middle (y, x) in metres, the picture, and the peak "
    "signal-to-noise ratio in decibels of what an eye there sees of the saved patterns, over the whole frame, at one "
    "brightness for all places: of means over the areas of pixels, whose light is computed by transforms to the plane "
    "of the pupil and back.",
    "psnr_db": "That of all views together.",
    "share": "Share of the light of the pixels that enters the pupil.",
    "light_box": "Height and width in metres of the area that the light of the pixels reaches at the pupil.",
}


@dataclass(frozen=True)
class EyeboxJob:
    """Parameters of one run of `odak eyebox`; lengths in metres.

    Attributes
    ----------
    images : tuple of str
        Paths of pictures, or names of shipped ones: one for all places, or one for each in reading order.
    output : Path
        Folder to write to.
    wavelength : float
        Wavelength.
    pixel_pitch : float or tuple of float
        Pixel pitch of the modulator, or of its image by an eyepiece: one number or (rows, columns).
    distance : float
        Distance from it to the pupil.
    resolution : tuple of int
        Rows and columns of the modulator.
    places : tuple of int
        Rows and columns of the places of the pupil.
    spacing : float
        Distance of neighbouring places.
    pupil : float
        Diameter of the pupil.
    frames : int
        Patterns shown one after another.
    iterations : int
        Number of iterations.
    learning_rate : float, optional
        Step size in radians of Adam; L-BFGS is used without it.
    seed : int
        Seed of the random initial phases.
    bits : int
        Bits per pixel of the modulator, 1 to 16.
    device : str
        "auto", "cpu", "cuda", "cuda:1", …
    quiet : bool
        Show no progress and no summary.
    """

    images: tuple[str, ...] = ("photo",)
    output: Path = Path("eyebox")
    wavelength: float = GREY_WAVELENGTH
    pixel_pitch: float | tuple[float, float] = 8e-6
    distance: float = 0.1
    resolution: tuple[int, int] = (512, 512)
    places: tuple[int, int] = (1, 3)
    spacing: float = 2e-3
    pupil: float = 2e-3
    frames: int = 2
    iterations: int = 60
    learning_rate: float | None = None
    seed: int = 0
    bits: int = 8
    device: str = "auto"
    quiet: bool = False

    def __post_init__(self) -> None:
        """Check every parameter; the messages name the option of the command line."""
        try:
            for name in ("wavelength", "distance", "spacing", "pupil"):
                _validate.real(f"--{name}", getattr(self, name), positive=True)
            for pitch in pitches(self.pixel_pitch):
                _validate.real("--pixel-pitch", pitch, positive=True)
            if self.learning_rate is not None:
                _validate.real("--learning-rate", self.learning_rate, positive=True)
            for side in self.resolution:
                _validate.integer("--resolution", side, minimum=SMALLEST_SIDE)
            for count in self.places:
                _validate.integer("--places", count, minimum=1)
            for name in ("frames", "iterations"):
                _validate.integer(f"--{name}", getattr(self, name), minimum=1)
            _validate.integer("--seed", self.seed)
            if not 1 <= _validate.integer("--bits", self.bits) <= 16:
                raise ValueError(f"--bits must be from 1 to 16, got {self.bits}")
        except (TypeError, ValueError) as error:
            raise InputError(str(error)) from None
        count = self.places[0] * self.places[1]
        if len(self.images) not in (1, count):
            raise InputError(
                f"IMAGE must be given once, or {count} times for --places {self.places[0]} {self.places[1]}, got "
                f"{len(self.images)} pictures"
            )
        for pitch in pitches(self.pixel_pitch):
            warn_of_samples("--wavelength", self.wavelength, "--pixel-pitch", pitch, self.wavelength / 2)
        if any(
            (count - 1) * self.spacing + self.pupil > side
            for count, side in zip(self.places, self.light_box, strict=True)
        ):
            raise InputError(
                f"--places {self.places[0]} {self.places[1]} with --spacing {self.spacing:g} and --pupil "
                f"{self.pupil:g} reach beyond the light of the pixels, {1e3 * self.light_box[0]:.3g} x "
                f"{1e3 * self.light_box[1]:.3g} mm at --distance {self.distance:g}"
            )

    @property
    def light_box(self) -> tuple[float, float]:
        """Height and width in metres of what the light of the pixels reaches at the pupil."""
        down, across = (self.wavelength * self.distance / float(pitch) for pitch in pitches(self.pixel_pitch))
        return down, across

    def middles(self) -> list[tuple[float, float]]:
        """Return the middles of the pupil (y, x) in metres, in reading order."""
        rows, columns = ([self.spacing * (k - (count - 1) / 2) for k in range(count)] for count in self.places)
        return [(y, x) for y in rows for x in columns]


@files.claiming
def run(job: EyeboxJob, notices: files.Notices = files.SILENT) -> dict:
    """Compute, save, read back and judge the hologram; write patterns, pictures and report.json.

    Parameters
    ----------
    job : EyeboxJob
        Parameters of the run.
    notices : files.Notices
        What to do about results of earlier runs.

    Returns
    -------
    dict
        The report: "psnr_db", and "views", a list of the quality at each place.

    Raises
    ------
    InputError
        If a picture, the device or the output folder cannot be used.
    """
    device = find_device(job.device)
    paths = [image_path(image) for image in job.images]
    targets = torch.stack([_target(path, job) for path in paths]).to(device)
    folder = files.writable_folder(job.output)
    given = {name: value for name, value in asdict(job).items() if name not in ("images", "output", "quiet")}
    mark = files.fingerprint({"command": "eyebox", **given, "device": None}, paths)
    if (kept := files.kept_report(folder, mark, notices)) is not None:
        return kept
    names = [f"hologram_frame{k + 1}.png" for k in range(job.frames)]
    written = [*names, "views.png"]
    files.announce(folder, [*written, files.REPORT], notices)
    places = job.middles()
    panel = wave.Modulator(job.resolution, job.pixel_pitch, job.bits)
    display = wave.Display(panel, job.wavelength, wave.Eyes(job.distance, places, job.pupil), job.frames).to(device)
    wanted = targets.expand(len(places), *job.resolution)
    solver = "lbfgs" if job.learning_rate is None else wave.Descent("adam", job.learning_rate)
    with progress(job, "eyebox") as clock:
        steps = wave.Run(job.iterations, False, clock.tick, seed=job.seed)
        hologram = wave.optimise(display, wanted[:, None], solver=solver, run=steps)
    for name, phase in zip(names, hologram.phases, strict=True):
        files.save_pattern(folder / name, files.quantise(wave.unit_phasor(phase.double()), job.bits), job.bits)
    stored = torch.stack([files.load_pattern(folder / name, job.bits) for name in names]).to(device)
    seen = display.double().judge(stored)[0][:, 0]
    views = seen * best_scale(seen, wanted.double(), None)
    quality = [psnr(view, target) for view, target in zip(views, wanted.double(), strict=True)]
    panels = [[picture_panel("Picture", target[None].cpu()) for target in targets]]
    captions = [
        f"Pupil at {1e3 * y:.3g}, {1e3 * x:.3g} mm: {value:.1f} dB"
        for (y, x), value in zip(places, quality, strict=True)
    ]
    shown = [picture_panel(caption, view[None].cpu()) for caption, view in zip(captions, views, strict=True)]
    panels += [shown[k : k + job.places[1]] for k in range(0, len(shown), job.places[1])]
    files.write_png(folder / "views.png", sheet(panels))
    report = {
        "command": "eyebox",
        "psnr_db": psnr(views, wanted.double()),
        "views": [
            {
                "place": place,
                "picture": str(paths[k if len(paths) > 1 else 0]),
                "psnr_db": value,
                # A panel without gaps would send all its light into the order in the middle.
                "share": float(seen[k].mean()) * panel.fill,
            }
            for k, (place, value) in enumerate(zip(places, quality, strict=True))
        ],
        "light_box": job.light_box,
        "files": names,
        "parameters": given,
        "versions": versions(),
        "definitions": DEFINITIONS,
    }
    return files.write_report(folder, report, mark, written)


def _target(path: Path, job: EyeboxJob) -> torch.Tensor:
    picture = to_grey(read_picture(path))
    down, across = (float(pitch) for pitch in pitches(job.pixel_pitch))
    frame, _ = fit(picture, job.resolution, fitting_size(picture.shape[-2:], job.resolution, (down, across)))
    if not frame.any():
        raise InputError(f"IMAGE must have a pixel above 0, but all pixels of {str(path)!r} are black")
    return frame[0]
