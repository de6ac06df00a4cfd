"""Computation of holograms for `odak eyebox`: what an eye sees from several places of its pupil, optimised together.

Each picture is judged from the saved patterns by :meth:`odak.learn.wave.Display.judge`, not by the model that the
optimizer uses.
"""

from pathlib import Path
from typing import Any

import torch

from odak.cli import files
from odak.cli.job import image_path, pitch_pair
from odak.cli.options import InputError
from odak.cli.report import about, find_device, picture_panel, progress, psnr, sheet
from odak.cli.settings import EyeboxSettings
from odak.cli.target import light_of, on_screen
from odak.learn import wave
from odak.learn.wave.pictures import fitting_size, on_frame
from odak.learn.wave.training import best_scale


@files.claiming
def run(job: EyeboxSettings, notices: files.Notices = files.SILENT) -> dict[str, Any]:
    """Compute, save, read back and judge the hologram; write patterns, pictures and report.json.

    Parameters
    ----------
    job : EyeboxSettings
        Settings of the run.
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
    given = job.values("images")
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
    solver = "auto" if job.learning_rate is None else wave.Descent("adam", job.learning_rate)
    with progress("eyebox", job.iterations, job.quiet) as clock:
        steps = wave.Run(job.iterations, False, clock.tick, seed=job.seed)
        hologram = wave.optimise(display, wanted[:, None], solver=solver, run=steps)
    for name, levels in zip(names, hologram.levels(), strict=True):
        files.save_pattern(folder / name, levels, job.bits)
    stored = torch.stack([files.load_pattern(folder / name, job.bits) for name in names]).to(device)
    seen = display.double().judge(stored)[0][:, 0]
    views = seen * best_scale(seen, wanted.double(), None)
    quality = [psnr(view, target) for view, target in zip(views, wanted.double(), strict=True)]

    def shown_as(light: torch.Tensor) -> torch.Tensor:
        return on_screen(light[None].cpu(), (job.wavelength,), job.linear)

    panels = [[picture_panel("Picture", shown_as(target)) for target in targets]]
    captions = [
        f"Pupil at {1e3 * y:.3g}, {1e3 * x:.3g} mm: {value:.1f} dB"
        for (y, x), value in zip(places, quality, strict=True)
    ]
    shown = [picture_panel(caption, shown_as(view)) for caption, view in zip(captions, views, strict=True)]
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
        **about("eyebox"),
    }
    return files.write_report(folder, report, mark, written)


def _target(path: Path, job: EyeboxSettings) -> torch.Tensor:
    picture = light_of(path, (job.wavelength,), True, job.linear)[0]
    frame, _ = on_frame(
        picture, job.resolution, fitting_size(picture.shape[-2:], job.resolution, pitch_pair(job.pixel_pitch))
    )
    if not frame.any():
        raise InputError(f"IMAGE must have a pixel above 0, but all pixels of {str(path)!r} are black")
    return frame[0]
