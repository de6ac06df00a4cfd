"""Light fields of `odak hologram`: views from files, or of a mesh or splats, and what pupils are to see of them."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import torch

from odak.cli import files
from odak.cli.job import COLOUR_WAVELENGTHS, GREY_WAVELENGTH, Job
from odak.cli.options import InputError, refusing
from odak.cli.report import picture_panel, sheet
from odak.cli.target import Target, Volume, light_of, mixed_sources, on_screen, read_picture
from odak.learn import wave
from odak.learn.raytracing import triangle_mesh
from odak.learn.wave.gaussians.sets import is_antialiased
from odak.learn.wave.holograms.scenery import listed_views
from odak.learn.wave.pictures import fitting_size, on_frame

# Times the sides of the eyebox in which pupils are drawn, and pupils along its sides at which the hologram is judged.
_BEYOND, _JUDGED = 1.3, 3
# Pixels of a mesh's view up to which each is the mean of several points.
_FEW = 2**18


def eyes_of(job: Job) -> wave.Eyes:
    """Return the eyes that a hologram is optimised for, the first of them in the middle of the eyebox."""
    drawn = wave.Eyes.within(job.distance, _wide(job), job.pupils, job.pupil, job.focus, job.seed)
    # In place of the one that is nearest to it.
    nearest, *others = sorted(range(job.pupils), key=lambda k: math.hypot(*drawn.positions[k]))
    foci: Any = drawn.focus
    focus = None if foci is None else [foci[k] for k in (nearest, *others)]
    return wave.Eyes(job.distance, [(0.0, 0.0), *(drawn.positions[k] for k in others)], job.pupil, focus)


def load_light_field(job: Job) -> Target:
    """Return what an eye in the middle of the eyebox is to see, with the light field of the scene.

    Parameters
    ----------
    job : Job
        Parameters of the run.

    Raises
    ------
    InputError
        If a file cannot be read, or all is black.
    """
    path = job.scene_path
    with refusing(f"--{job.scene} ", OSError, ValueError, TypeError):
        field, window, wavelengths, source, outside = _views(job, path) if job.views else _rendered(job, path)
        eyes = eyes_of(job)
        focus: Any = eyes.focus
        middle = wave.Eyes(job.distance, eyes.positions[:1], job.pupil, None if focus is None else focus[:1])
        intensity = field.images(_display(job, wavelengths, middle))[0].float()
    if not intensity.any():
        raise InputError(f"--{job.scene} must show something, but {str(path)!r} is black")
    return Target(path, intensity, window, wavelengths, source, outside, field)


def load_pupils(job: Job, target: Target, device: torch.device) -> Volume:
    """Return what each of the pupils that a hologram is optimised for is to see; the picture is that of the first."""
    images = target.field.images(_display(job, target.wavelengths, eyes_of(job))).float().to(device)
    masks = torch.zeros_like(images)
    masks[0] = 1.0
    return Volume([job.distance] * len(images), images, masks, None)


def judged(job: Job, target: Target, found: wave.DisplayedHologram) -> tuple[dict[str, Any], wave.EyeboxMap]:
    """Return the quality of a hologram at pupils of the eyebox, for which it was optimised or not, and what is seen."""
    seen = wave.eyebox_map(found, target.field, job.eyebox, _JUDGED, job.pupil)
    eyes: Any = found.display.eyes
    own = [
        {"place": list(place), "focus": None if eyes.focus is None else eyes.focus[k], "psnr_db": ratio.tolist()}
        for k, (place, ratio) in enumerate(zip(eyes.positions, found.psnr, strict=True))
    ]
    others = [
        {"place": [float(y), float(x)], "psnr_db": float(seen.psnr[r, q]), "brightness": float(seen.brightness[r, q])}
        for r, y in enumerate(seen.rows)
        for q, x in enumerate(seen.columns)
    ]
    return {"optimised": own, "judged": others}, seen


def write_views(path: Path, job: Job, target: Target, maps: Sequence[wave.EyeboxMap]) -> None:
    """Write what is to be seen and what is seen from places all over the eyebox, of the maps of all colours."""
    rows = []
    for r, y in enumerate(maps[0].rows):
        for kind in ("wanted", "images"):
            panels = []
            for q, x in enumerate(maps[0].columns):
                light = torch.cat([getattr(one, kind)[r, q] for one in maps])
                ratio = min(float(one.psnr[r, q]) for one in maps)
                place = f"at {1e3 * float(y):.3g}, {1e3 * float(x):.3g} mm"
                caption = f"Scene {place}" if kind == "wanted" else f"Pupil {place}: {ratio:.1f} dB"
                panels.append(picture_panel(caption, on_screen(light, target.wavelengths, job.linear)))
            rows.append(panels)
    files.write_png(path, sheet(rows, job.resolution[1] * job.pitches[1], job.pitches[0] / job.pitches[1]))


def _wide(job: Job) -> tuple[float, float]:
    down, across = job.eyebox if isinstance(job.eyebox, tuple) else (job.eyebox, job.eyebox)
    return _BEYOND * down, _BEYOND * across


def _display(job: Job, wavelengths: Sequence[float], eyes: wave.Eyes) -> wave.Display:
    return wave.Display(wave.Modulator(job.resolution, job.pixel_pitch), wavelengths, eyes)


def _views(job: Job, path: Path) -> tuple[wave.LightField, tuple, tuple[float, ...], str, float]:
    """Return the light field of pictures, the window that they fill, wavelengths, and how they became light."""
    pictures, places = listed_views(path)
    first = read_picture(pictures[0], "--views")
    wavelengths = job.wavelengths
    if not wavelengths:
        wavelengths = (GREY_WAVELENGTH,) if job.grey or len(first) == 1 else COLOUR_WAVELENGTHS
    views, outside = [], 0.0
    size = fitting_size(first.shape[-2:], job.resolution, job.pitches)
    for picture in pictures:
        light, source, beyond = light_of(picture, wavelengths, job.grey, job.linear)
        if light.shape[-2:] != first.shape[-2:]:
            raise InputError(f"--views must be pictures of one size, but {str(picture)!r} has another")
        frame, window = on_frame(light, job.resolution, size)
        views.append(frame)
        outside += beyond / len(pictures)
    return wave.LightField(torch.stack(views), places, job.plane), window, wavelengths, source, outside


def _rendered(job: Job, path: Path) -> tuple[wave.LightField, tuple, tuple[float, ...], str, float]:
    """Return the light field of a mesh or of splats, as :func:`_views` does."""
    grey = job.grey or job.scene == "mesh"
    wavelengths = job.wavelengths or ((GREY_WAVELENGTH,) if grey else COLOUR_WAVELENGTHS)
    sides = [torch.linspace(-1, 1, job.sides, dtype=torch.float64) * (side + job.pupil) / 2 for side in _wide(job)]
    places = torch.cartesian_prod(*sides) if job.sides > 1 else torch.zeros(1, 2, dtype=torch.float64)
    display = _display(job, wavelengths, wave.Eyes(job.distance))
    if job.scene == "mesh":
        mesh = triangle_mesh.read_PLY(str(path))
        stands = wave.Placement.fitting(mesh.vertices, display, job.plane, job.turned)
        # Of many pixels, the mean over the views smooths edges.
        samples = 2 if math.prod(job.resolution) <= _FEW else 1
        field = wave.views_of_mesh(mesh, display, places, stands, samples=samples)
        source = "light of a lamp beside the eye"
    else:
        if mixed_sources(wavelengths) == ():
            raise InputError("--wavelength must be given once, or be three that mix to white, for colours of --splats")
        splats = wave.load_splats(str(path))
        stands = wave.Placement.fitting(splats.means, display, job.plane, job.turned, 0.96)
        trained = is_antialiased(str(path))
        field, source = wave.views_of_splats(splats, display, places, stands, antialiased=trained), "sRGB"
    return field, (slice(0, job.resolution[0]), slice(0, job.resolution[1])), wavelengths, source, 0.0
