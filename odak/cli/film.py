"""Computation of the holograms of a film for `odak hologram`: each frame begins with the patterns of the one before.

Each frame has a folder with all results of its picture, so that a run that was cut short goes on where it ended.
"""

import math
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import torch
from PIL import Image

from odak import _validate
from odak.cli import files, hologram
from odak.cli.job import Job
from odak.cli.options import InputError
from odak.cli.target import load_target, on_screen, read_picture
from odak.learn.perception import FlickerLoss, rgb_to_linear_rgb

SUMMARY = "summary.json"
# Frames whose flicker is judged together, and rows of their pictures at most.
_TOGETHER, _ROWS = 32, 270


@files.claiming
def run(
    film: str, values: dict[str, Any], notices: files.Notices, told: Callable[[int, int, dict], None] | None = None
) -> dict[str, Any]:
    """Compute the holograms of the frames of a film, one after another.

    Parameters
    ----------
    film : str
        File of the film.
    values : dict
        Settings of :class:`odak.cli.job.Job` for all frames; the output is the folder of their folders.
    notices : files.Notices
        What to do about files of earlier runs.
    told : callable, optional
        ``told(number, count, report)`` is called after each frame.

    Returns
    -------
    dict
        What ``summary.json`` holds: frames, rate, quality of each frame, and the visible flicker of what is seen beside
        that of the film; "interrupted" if not all frames were computed.

    Raises
    ------
    InputError
        If the film or the output folder cannot be used, or OpenCV is not installed.
    """
    rate, count, pictures = _read(film)
    folder = files.writable_folder(Path(values["output"]))
    files.claim(folder)
    jobs: list[Job] = []
    reports: list[dict[str, Any]] = []
    for number, picture in enumerate(pictures, 1):
        own = files.writable_folder(folder / f"frame_{number:05d}")
        files.write_png(own / "picture.png", picture)
        before = {"start": str(jobs[-1].output)} if jobs else {}
        # Options that say how a picture begins are for the first one.
        given = values["given"] - {"initial_phase", "seed"} if jobs else values["given"]
        others = {name: value for name, value in values.items() if not (jobs and name == "initial_phase")}
        job = Job(**{**others, **before, "given": given, "image": str(own / "picture.png"), "output": own})
        report = files.kept_report(own, files.fingerprint_of(job), notices) or hologram.run(job, notices)
        if told is not None:
            told(number, max(count, number), report)
        jobs.append(job)
        reports.append(report)
        if report.get("interrupted"):
            break
    if not jobs:
        raise InputError(f"IMAGE {film!r} is a film without frames")
    summary: dict[str, Any] = {
        "frames": len(jobs),
        "frames_per_second": rate,
        "interrupted": bool(reports[-1].get("interrupted")),
        "psnr_db": [report["psnr_db"] for report in reports],
        "ssim": [report["ssim"] for report in reports],
        "flicker": _flicker(jobs, rate),
    }
    files.write_json(folder / SUMMARY, summary)
    return summary


def _read(film: str) -> tuple[float, int, Iterator[Image.Image]]:
    """Return the frames per second of a film, how many it says that it has, and the frames."""
    path = Path(os.path.expanduser(film))
    if not path.is_file():
        raise InputError(f"IMAGE must be an existing file, got {film!r}")
    told = f"IMAGE {film!r} is a film, which OpenCV reads: pip install opencv-python-headless"
    cv2 = _validate.optional("cv2", told, InputError)
    stream = cv2.VideoCapture(str(path))
    rate = float(stream.get(cv2.CAP_PROP_FPS)) if stream.isOpened() else 0.0
    if not (math.isfinite(rate) and rate > 0):
        raise InputError(f"IMAGE {film!r} is no film that OpenCV can read")

    def frames() -> Iterator[Image.Image]:
        try:
            while True:
                found, picture = stream.read()
                if not found:
                    return
                yield Image.fromarray(cv2.cvtColor(picture, cv2.COLOR_BGR2RGB))
        finally:
            stream.release()

    return rate, int(stream.get(cv2.CAP_PROP_FRAME_COUNT)), frames()


def _flicker(jobs: list[Job], rate: float) -> float | None:
    """Return the visible flicker of the error of what is seen, in squared multiples of the threshold.

    It is that of :class:`odak.learn.perception.FlickerLoss` of the mean light of the pictures and the difference of the
    light that is seen from them, the mean over parts of the film. None for a single frame.
    """
    loss, found = FlickerLoss(rate, encoding="linear"), []
    for first in range(0, len(jobs), _TOGETHER):
        part = jobs[first : first + _TOGETHER]
        wanted, seen = (torch.stack(each) for each in zip(*map(_lights, part), strict=True))
        if len(part) > 1:
            found.append(float(loss((wanted.mean() + seen - wanted)[None])))
    return sum(found) / len(found) if found else None


def _lights(job: Job) -> tuple[torch.Tensor, torch.Tensor]:
    """Return the light of a picture and of its hologram as saved, ``[1, rows, columns]`` of few rows."""
    target = load_target(job)
    pictures = (
        on_screen(target.intensity, target.wavelengths, job.linear),
        read_picture(job.output / "reconstruction.png"),
    )
    parts = [one if job.linear else rgb_to_linear_rgb(one.float().expand(3, -1, -1)[None])[0] for one in pictures]
    share = min(1.0, _ROWS / parts[0].shape[-2])
    rows, columns = (max(1, round(n * share)) for n in parts[0].shape[-2:])
    lights = [
        torch.nn.functional.adaptive_avg_pool2d(one.float().mean(0, keepdim=True), (rows, columns)) for one in parts
    ]
    return lights[0], lights[1]
