"""From a picture file to the intensity that the hologram is to show."""

from dataclasses import dataclass
from pathlib import Path

import torch

from odak.cli.errors import InputError
from odak.cli.job import COLOUR_WAVELENGTHS, GREY_WAVELENGTH, Job, image_path

LUMINANCE = (0.2126, 0.7152, 0.0722)


@dataclass(frozen=True)
class Target:
    """The picture as the modulator's frame shows it.

    Attributes
    ----------
    path : Path
        File that the picture came from.
    intensity : torch.Tensor
        float32 ``[channels, rows, columns]``, 0 … 1, on the CPU.
    window : tuple of slice
        Rows and columns that the picture fills; around it the frame is black.
    wavelengths : tuple of float
        One per channel, in metres.
    """

    path: Path
    intensity: torch.Tensor
    window: tuple[slice, slice]
    wavelengths: tuple[float, ...]


def load_target(job: Job) -> Target:
    """Load the picture and fit it to the modulator.

    Parameters
    ----------
    job : Job
        What was asked for.

    Returns
    -------
    Target
        Intensity, its window in the frame, and the wavelengths.

    Raises
    ------
    InputError
        If the picture is missing, unreadable or black.
    """
    path = image_path(job.image)
    picture = read_picture(path)
    if job.grey or len(job.wavelengths) == 1:
        picture = to_grey(picture)
    wavelengths = job.wavelengths or (COLOUR_WAVELENGTHS if len(picture) == 3 else (GREY_WAVELENGTH,))
    picture = picture.expand(len(wavelengths), -1, -1)
    intensity, window = fit(picture, job.resolution)
    if not intensity.any():
        raise InputError(f"IMAGE is black, there is nothing to show: {str(path)!r}")
    return Target(path, intensity, window, wavelengths)


def fit(
    picture: torch.Tensor,
    resolution: tuple[int, int],
    mode: str = "bicubic",
    size: tuple[int, int] | None = None,
) -> tuple[torch.Tensor, tuple[slice, slice]]:
    """Resize a picture to the largest size that fits the frame with its aspect ratio kept, black around it.

    Parameters
    ----------
    picture : torch.Tensor
        ``[channels, rows, columns]``, 0 … 1.
    resolution : tuple of int
        Rows and columns of the frame.
    mode : str
        "bicubic", or "nearest-exact" for values that must not be mixed.
    size : tuple of int, optional
        Rows and columns to resize to instead.

    Returns
    -------
    tuple
        Frame ``[channels, *resolution]``, and the rows and columns (slices) of the picture in it.
    """
    ratio = min(frame / side for frame, side in zip(resolution, picture.shape[-2:], strict=True))
    fitting = (
        min(frame, max(1, round(side * ratio))) for frame, side in zip(resolution, picture.shape[-2:], strict=True)
    )
    size = tuple(fitting) if size is None else size
    if size != tuple(picture.shape[-2:]) and mode == "bicubic":
        picture = torch.nn.functional.interpolate(picture[None], size, mode=mode, antialias=True)[0].clamp(0, 1)
    elif size != tuple(picture.shape[-2:]):
        picture = torch.nn.functional.interpolate(picture[None], size, mode=mode)[0]
    rows, columns = (slice((f - s) // 2, (f - s) // 2 + s) for f, s in zip(resolution, size, strict=True))
    frame = torch.zeros(len(picture), *resolution)
    frame[:, rows, columns] = picture
    return frame, (rows, columns)


def read_picture(path: Path, name: str = "IMAGE") -> torch.Tensor:
    """Return a picture as ``[1 or 3, rows, columns]``; transparent parts are black, equal channels are one.

    Parameters
    ----------
    path : Path
        Existing file.
    name : str
        What to call it in messages.

    Raises
    ------
    InputError
        If it cannot be read or holds values beyond 0 … 1.
    """
    from odak.learn.tools import load_image

    try:
        picture = load_image(str(path), normalizeby=None).float()
    except (OSError, ValueError, TypeError) as error:
        raise InputError(" ".join(str(error).split())) from None
    picture = picture[None] if picture.ndim == 2 else picture.movedim(-1, 0)
    if len(picture) in (2, 4):
        picture = picture[:-1] * picture[-1:]
    if not bool(((picture >= 0) & (picture <= 1)).all()):
        raise InputError(f"{name} must hold values from 0 to 1, those of {str(path)!r} go beyond")
    return picture[:1] if bool((picture == picture[:1]).all()) else picture


def to_grey(picture: torch.Tensor) -> torch.Tensor:
    """Return the brightness of a picture, ``[1, rows, columns]``."""
    if len(picture) == 1:
        return picture
    weights = torch.tensor(LUMINANCE).reshape(3, 1, 1)
    return (picture * weights).sum(0, keepdim=True).clamp(0, 1)
