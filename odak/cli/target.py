"""Targets of a hologram: the intensity of a picture on the modulator's frame, and on planes by a depth map."""

import contextlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import torch
from PIL import Image

from odak._warnings import ArgumentWarning, warn
from odak.cli.files import image_pitches
from odak.cli.job import COLOUR_WAVELENGTHS, GREY_WAVELENGTH, Job, depth_map_path, image_path
from odak.cli.options import InputError, refusing
from odak.learn import wave
from odak.learn.wave import multiplane_loss
from odak.learn.wave.pictures import fitting_size, on_frame

LUMINANCE = (0.2126, 0.7152, 0.0722)
BLUR_RATIO, BLUR_SIZE = 1.0, 5
_ASPECT_TOLERANCE = 0.02


@dataclass(frozen=True)
class Target:
    """A picture on the modulator's frame.

    Attributes
    ----------
    path : Path
        File that the picture came from.
    intensity : torch.Tensor or dask.array.Array
        float32 ``[channels, rows, columns]``, 0 … 1, on the CPU; of a run in tiles a Dask array.
    window : tuple of slice
        Rows and columns that the picture fills; around it the frame is black.
    wavelengths : tuple of float
        One per channel, in metres.
    source : str
        How the values of the picture became light.
    outside : float
        Share of its pixels whose colours no mixture of the sources shows; they are shown less saturated.
    field : LightField, optional
        What eyes are to see from other places than the middle.
    """

    path: Path
    intensity: Any
    window: tuple[slice, slice]
    wavelengths: tuple[float, ...]
    source: str = ""
    outside: float = 0.0
    field: Any = None

    def of(self, colours: Sequence[int]) -> "Target":
        """Return some of the colours of the target."""
        field = self.field
        if field is not None and field.views.shape[1] > 1:
            plane = None if field.plane is None else float(field.plane)
            field = wave.LightField(field.views[:, colours], field.rays, plane)
        wavelengths = tuple(self.wavelengths[c] for c in colours)
        return replace(self, intensity=self.intensity[colours], wavelengths=wavelengths, field=field)


def load_target(job: Job) -> Target:
    """Load the picture and fit it to the modulator.

    Parameters
    ----------
    job : Job
        Parameters of the run.

    Returns
    -------
    Target
        Intensity, its window in the frame, and the wavelengths.

    Raises
    ------
    InputError
        If the picture is missing, unreadable, black, or fewer than 11 rows or columns on the modulator.
    """
    from odak.learn.perception.quality import WINDOW

    path = image_path(job.image)
    wavelengths = job.wavelengths
    if not wavelengths:
        wavelengths = (GREY_WAVELENGTH,) if job.grey or len(read_picture(path)) == 1 else COLOUR_WAVELENGTHS
    picture, source, outside = light_of(path, wavelengths, job.grey, job.linear)
    size = fitting_size(picture.shape[-2:], job.resolution, image_pitches(job))
    intensity, window = on_frame(picture, job.resolution, size)
    if min(part.stop - part.start for part in window) < WINDOW:
        rows, columns = (part.stop - part.start for part in window)
        raise InputError(
            f"IMAGE {str(path)!r} becomes {rows} x {columns} pixels when it is fitted to --resolution "
            f"{job.resolution[0]} {job.resolution[1]}, but SSIM needs {WINDOW} x {WINDOW}: crop the picture"
        )
    if not intensity.any():
        raise InputError(f"IMAGE must have a pixel above 0, but all pixels of {str(path)!r} are black")
    return Target(path, intensity, window, wavelengths, source, outside)


def light_of(picture: Any, wavelengths: Sequence[float], grey: bool, linear: bool) -> tuple[torch.Tensor, str, float]:
    """Return the light ``[wavelengths, rows, columns]`` of a picture, how it was found, and the share beyond the gamut.

    Parameters
    ----------
    picture : Path or torch.Tensor
        File, or values of 0 … 1 ``[channels, rows, columns]``.
    wavelengths : sequence of float
        Of the sources. Light that is not seen, and colours that mix to no white, show the channels of the picture.
    grey, linear : bool
        Whether the luminance alone counts, and whether stored values are the light.

    Raises
    ------
    InputError
        If a file cannot be read.
    """
    stored = read_picture(picture) if isinstance(picture, Path) else picture
    grey = grey or len(wavelengths) == 1
    if linear:
        stored = to_grey(stored) if grey else stored
        return stored.expand(len(wavelengths), -1, -1), "stored values", 0.0
    given = str(picture) if isinstance(picture, Path) else picture
    sources = mixed_sources(wavelengths) or COLOUR_WAVELENGTHS
    found = wave.light_of(given, sources, grey=grey)
    return found.targets[: len(wavelengths)].float(), found.source, found.outside


def mixed_sources(wavelengths: Sequence[float]) -> tuple[float, ...]:
    """Return the sources whose light a picture on a screen stands for; none if they do not mix to white."""
    if len(wavelengths) == 1:
        return (GREY_WAVELENGTH,)
    try:
        wave.light_of(torch.ones(3, 1, 1), wavelengths)
    except ValueError:
        return ()
    return tuple(wavelengths)


def on_screen(images: torch.Tensor, wavelengths: Sequence[float], linear: bool) -> torch.Tensor:
    """Return the picture of light ``[wavelengths, rows, columns]``, in stored values of 0 … 1 as those of the input."""
    if linear or not mixed_sources(wavelengths):
        return images.clamp(0, 1)
    return wave.picture_of(images.float(), mixed_sources(wavelengths))[: len(wavelengths)]


def read_picture(path: Path, name: str = "IMAGE") -> torch.Tensor:
    """Return a picture as ``[1 or 3, rows, columns]``; transparent parts are black, equal channels are one.

    A photograph is rotated according to its EXIF orientation. Of several frames or pages the first one is used, with a
    warning.

    Parameters
    ----------
    path : Path
        Existing file.
    name : str
        Its name in messages.

    Raises
    ------
    InputError
        If it cannot be read or holds values beyond 0 … 1.
    """
    from odak.learn.tools import load_image

    with refusing("", OSError, ValueError, TypeError):
        picture = load_image(str(path), normalizeby=None, color_managed=True).float()
    picture = picture[None] if picture.ndim == 2 else picture.movedim(-1, 0)
    with contextlib.suppress(OSError, ValueError, SyntaxError), Image.open(path) as image:
        if (frames := getattr(image, "n_frames", 1)) > 1:
            warn(f"{str(path)!r} has {frames} frames or pages; the first one is used", ArgumentWarning)
    if len(picture) in (2, 4):
        picture = picture[:-1] * picture[-1:]
    if not bool(((picture >= 0) & (picture <= 1)).all()):
        raise InputError(f"{name} must have values from 0 to 1, but {str(path)!r} has values outside this range")
    return picture[:1] if bool((picture == picture[:1]).all()) else picture


def to_grey(picture: torch.Tensor) -> torch.Tensor:
    """Return the brightness of a picture, ``[1, rows, columns]``."""
    if len(picture) == 1:
        return picture
    weights = torch.tensor(LUMINANCE).reshape(3, 1, 1)
    return (picture * weights).sum(0, keepdim=True).clamp(0, 1)


@dataclass(frozen=True)
class Volume:
    """Images on planes.

    Attributes
    ----------
    distances : list of float
        Distance of each plane from the modulator in metres.
    images : torch.Tensor
        Target intensity of each plane, ``[planes, channels, rows, columns]``.
    masks : torch.Tensor
        1 where the picture belongs to the plane, of the same shape.
    loss : multiplane_loss, optional
        Loss that gives more weight to what is sharp; None for a single plane.
    """

    distances: list[float]
    images: torch.Tensor
    masks: torch.Tensor
    loss: multiplane_loss | None


def load_volume(job: Job, target: Target, device: torch.device) -> Volume:
    """Spread a picture over planes by its depth map.

    Parameters
    ----------
    job : Job
        Parameters of the run.
    target : Target
        The fitted picture.
    device : torch.device
        Where to compute.

    Returns
    -------
    Volume
        Images of the planes.

    Raises
    ------
    InputError
        If the depth map is missing, unreadable, of another aspect ratio, or has one depth only.
    """
    intensity = target.intensity.to(device)
    if job.planes == 1:
        return Volume([job.distance], intensity[None], torch.ones_like(intensity)[None], None)
    depth = _fitted_depth(job, target).to(device)
    loss = multiplane_loss(
        intensity,
        depth,
        blur_ratio=BLUR_RATIO,
        target_blur_size=BLUR_SIZE,
        number_of_planes=job.planes,
        reduction="mean",
        device=device,
    )
    images, _, _ = loss.get_targets()
    places = torch.linspace(-job.volume_depth / 2, job.volume_depth / 2, job.planes, dtype=torch.float64)
    return Volume((places + job.distance).tolist(), images, loss.masks, loss)


def _fitted_depth(job: Job, target: Target) -> torch.Tensor:
    """Return the depth ``[rows, columns]`` on the modulator's frame; around the picture it is the last plane's."""
    path = depth_map_path(str(job.depth_map))
    depth = to_grey(read_picture(path, "--depth-map"))
    if bool((depth == depth.flatten()[0]).all()):
        raise InputError(f"--depth-map must have at least two depths, but {str(path)!r} has one; leave --planes out")
    rows, columns = (part.stop - part.start for part in target.window)
    dy, dx = job.pitches
    if abs(depth.shape[-2] * columns * dx / (depth.shape[-1] * rows * dy) - 1) > _ASPECT_TOLERANCE:
        raise InputError(
            f"--depth-map must have the picture's shape, got {depth.shape[-2]} x {depth.shape[-1]} for a picture of "
            f"{rows} x {columns}"
        )
    # Depths are not averaged across an edge: no surface lies at the mean of a near and a far depth.
    fitted, _ = on_frame(depth - 1, job.resolution, (rows, columns), mode="nearest-exact")
    return fitted[0] + 1
