"""Files of an experiment that asks whether observers tell metamers apart: stimuli, masks, trials, script and page."""

import csv
import io
import json
import os
from pathlib import Path

import torch

from odak import _validate
from odak.learn.perception.discrimination import Metamer
from odak.learn.perception.sight import Viewing, angle_of, checked_viewing
from odak.learn.tools.file import save_image
from odak.tools.paths import validate_path, write_file

_SCRIPT, _PAGE = (Path(__file__).with_name("data") / f"abx_experiment{part}.txt" for part in ("", "_page"))


def export_experiment(
    metamer: Metamer,
    folder: str | os.PathLike[str],
    viewing: Viewing,
    *,
    original: bool = False,
    repeats: int = 4,
    seconds: float = 0.2,
    masks: int = 2,
    seed: int = 0,
) -> list[dict[str, str]]:
    """Write the stimuli of an ABX experiment, and what shows them: a PsychoPy script and a jsPsych page.

    An observer fixates, sees A, B and then X, which is A or B, and says which.

    Parameters
    ----------
    metamer : Metamer
        Samples of one picture ``[1, C, H, W]`` of one or three channels, values 0 to 1 as a display takes them.
    folder : str or os.PathLike
        Where the files go; it must exist.
    viewing : Viewing
        For which the samples were made: angles, gaze and luminances are written down.
    original : bool
        Compare each sample with the picture, instead of two samples.
    repeats : int
        How often each pair is shown; A and B change places, and X, so that each case comes equally often in four.
    seconds : float
        Time for which each picture is shown.
    masks : int
        Pictures with the spectrum of the picture and random phases, of which one follows each stimulus; 0 for none.
    seed : int
        Of the order of trials and of the masks.

    Returns
    -------
    list of dict
        The trials as written to trials.csv: "a", "b", "x" (names of files) and "answer" ("a" or "b").

    Raises
    ------
    ValueError, TypeError
        If the picture has other axes, there are too few samples for a pair, or an argument is out of range.

    Notes
    -----
    Files: picture.png, sample_1.png and so on, mask_1.png and so on, trials.csv, settings.json, experiment.py and
    experiment.html.
    settings.json has the size of the pictures in degrees, the gaze, the luminances and the distances of the samples.
    Width, distance and pixels of the screen are filled in there by whoever runs the experiment, and the script starts
    only with them. It reads these files and holds no text of the caller. The page holds trials and settings, asks
    for the width and the distance of the screen, and saves the same table of answers. It loads jsPsych (7 or later) and
    its plugin html-keyboard-response from the two addresses at its head: put the files there, or change them.
    ABX: Freeman and Simoncelli, Nat. Neurosci. 14, 1195 (2011).

    Examples
    --------
    >>> import tempfile
    >>> import torch
    >>> from odak.learn.perception import Metamer, Viewing, export_experiment
    >>> picture = torch.rand(1, 1, 16, 16, generator=torch.Generator().manual_seed(1))
    >>> samples = Metamer(torch.nn.AvgPool2d(4), picture, samples=2).run(150)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     trials = export_experiment(samples, folder, Viewing(0.4, 0.7), repeats=4)
    >>> len(trials), sorted(trial["answer"] for trial in trials)
    (4, ['a', 'a', 'b', 'b'])
    """
    _validate.instance("metamer", metamer, Metamer, "an odak.learn.perception.Metamer")
    viewing, shape = checked_viewing(viewing), tuple(metamer.picture.shape)
    if len(shape) != 4 or shape[0] != 1 or shape[1] not in (1, 3):
        raise ValueError(f"metamer must be of a picture [1, C, H, W] of one or three channels, got {shape}")
    repeats = _validate.integer("repeats", repeats, minimum=1)
    seconds = _validate.constant("seconds", seconds, positive=True)
    masks, original = _validate.integer("masks", masks), _validate.flag("original", original)
    generator = torch.Generator().manual_seed(_validate.integer("seed", seed))
    samples = [f"sample_{number}.png" for number in range(1, len(metamer.pictures) + 1)]
    if original:
        pairs = [("picture.png", one) for one in samples]
    else:
        pairs = [(one, two) for place, one in enumerate(samples) for two in samples[place + 1 :]]
    if not pairs:
        raise ValueError("metamer must have two samples for a pair, got one: take samples=2 or original=True")
    place = Path(validate_path(folder, name="folder"))
    if not place.is_dir():
        raise ValueError(f"folder must be a folder that exists, got {str(place)!r}")
    shown = {"picture.png": metamer.picture[0], **dict(zip(samples, metamer.pictures[:, 0], strict=True))}
    for number in range(1, masks + 1):
        shown[f"mask_{number}.png"] = _scrambled(metamer.picture[0], generator)
    for name, picture in shown.items():
        save_image(str(place / name), picture, cmin=0.0, cmax=1.0)
    trials = []
    for pair in pairs:
        for number in range(repeats):
            a, b = pair if number % 2 else pair[::-1]
            answer = "ab"[number // 2 % 2]
            trials.append({"a": a, "b": b, "x": a if answer == "a" else b, "answer": answer})
    trials = [trials[index] for index in torch.randperm(len(trials), generator=generator).tolist()]
    table = io.StringIO()
    writer = csv.DictWriter(table, ("a", "b", "x", "answer"), lineterminator="\n")
    writer.writeheader()
    writer.writerows(trials)
    height = viewing.real_image_width * shape[-2] / shape[-1]
    settings = {
        "width_degrees": viewing.field_of_view,
        "height_degrees": angle_of(height, viewing.real_viewing_distance),
        "width_over_distance": viewing.real_image_width / viewing.real_viewing_distance,
        "gaze": list(viewing.gaze),
        "peak_luminance": viewing.peak_luminance,
        "black_luminance": viewing.black_luminance,
        "encoding": "values of a display with the response of sRGB, which is to be calibrated",
        "seconds": seconds,
        "pause_seconds": 0.5,
        "masks": masks,
        "distances": metamer.distances,
        "model": repr(metamer.model),
        "screen_width_cm": None,
        "screen_distance_cm": None,
        "screen_pixels": None,
    }
    write_file(place / "trials.csv", table.getvalue().encode())
    write_file(place / "settings.json", (json.dumps(settings, indent=2, allow_nan=False) + "\n").encode())
    write_file(place / "experiment.py", _SCRIPT.read_bytes())
    # No text of the caller can end the element: JSON has "<" in strings alone, where it may be written as a number.
    data = json.dumps({"settings": settings, "trials": trials}, allow_nan=False).replace("<", "\\u003c")
    page = _PAGE.read_text(encoding="utf-8").replace("DATA", data, 1)
    write_file(place / "experiment.html", page.encode())
    return trials


def _scrambled(picture, generator):
    """Return a picture with its spectrum's amplitudes and random phases, the same for all channels."""
    noise = torch.randn(picture.shape[-2:], dtype=torch.float64, generator=generator).to(picture)
    turned = torch.fft.rfft2(noise)
    mean = picture.mean((-2, -1), keepdim=True)
    spectrum = torch.fft.rfft2(picture - mean) * turned / turned.abs().clamp_min(1e-12)
    return (torch.fft.irfft2(spectrum, picture.shape[-2:]) + mean).clamp(0, 1)
