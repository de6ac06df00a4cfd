"""How good a picture is where the viewer looks, and how good further out: PSNR and SSIM by rings of eccentricity."""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch

from odak import _validate
from odak.learn.perception.foveation import make_eccentricity_distance_maps
from odak.learn.perception.image_quality_losses import WINDOW, _checked, _planes, _similarities
from odak.learn.tools.loss import psnr

DEFAULT_EDGES = (0.0, 2.5, 5.0, 10.0, 20.0, 40.0)


@dataclass(frozen=True)
class Ring:
    """Quality between two eccentricities.

    Attributes
    ----------
    inner, outer : float
        Limits in degrees; the inner one belongs to the ring.
    pixels : int
        Pixels of a picture in the ring.
    psnr, ssim : torch.Tensor
        Without axes, over all pictures and channels; not a number where the ring holds no pixel, or for the SSIM no
        place where the window fits. The window reaches 5 pixels beyond the ring.
    """

    inner: float
    outer: float
    pixels: int
    psnr: torch.Tensor
    ssim: torch.Tensor


@dataclass(frozen=True)
class EccentricityReport:
    """Rings from the inside out, and how the picture was seen; ``str`` gives a table.

    Attributes
    ----------
    rings : tuple of Ring
        The rings.
    conditions : str
        Size, gaze and geometry in words.
    """

    rings: tuple[Ring, ...]
    conditions: str

    def __str__(self) -> str:
        lines = [self.conditions, "degrees        pixels  PSNR [dB]    SSIM"]
        lines += [
            f"{ring.inner:5.1f} … {ring.outer:5.1f} {ring.pixels:8d} {float(ring.psnr.detach()):10.2f} "
            f"{float(ring.ssim.detach()):7.4f}"
            for ring in self.rings
        ]
        return "\n".join(lines)


def eccentricity_report(
    predictions: torch.Tensor,
    targets: torch.Tensor,
    gaze: Sequence[float] = (0.5, 0.5),
    edges: Sequence[float] = DEFAULT_EDGES,
    real_image_width: float = 0.2,
    real_viewing_distance: float = 0.7,
    data_range: float = 1.0,
) -> EccentricityReport:
    """Return PSNR and SSIM of pictures by rings around the gaze.

    Parameters
    ----------
    predictions, targets : torch.Tensor
        ``[..., H, W]`` of one shape, each side at least 11.
    gaze : sequence of float
        Where the viewer looks, (x, y) from the top left corner (0, 0) to the bottom right one (1, 1); may lie off the
        picture.
    edges : sequence of float
        Rising eccentricities in degrees; ring i lies between edge i and the next.
    real_image_width, real_viewing_distance : float
        Width of the flat picture and distance of the eye in front of its middle, in one unit.
    data_range : float
        Largest value that a picture could have, less the smallest.

    Returns
    -------
    EccentricityReport
        One ring for each pair of edges. PSNR and SSIM are differentiable in the pictures.

    Raises
    ------
    ValueError, TypeError
        If the shapes differ, a picture is smaller than SSIM's window, or an argument is outside its range.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.perception import eccentricity_report
    >>> target = torch.zeros(1, 64, 64)
    >>> worse_outside = target + 0.1 * (torch.linspace(-1, 1, 64).abs() > 0.5)
    >>> report = eccentricity_report(worse_outside, target, edges=(0, 2, 12))
    >>> [round(ring.psnr.item(), 1) for ring in report.rings]
    [inf, 22.8]
    """
    predictions, targets = _checked(predictions, targets, WINDOW, data_range)
    size = tuple(predictions.shape[-2:])
    masks = ring_masks(size, gaze, edges, real_image_width, real_viewing_distance, device=predictions.device)
    luminance, structure = _similarities(_planes(predictions), _planes(targets), data_range)
    similarity = luminance * structure
    border = WINDOW // 2
    rings = []
    for mask, inner, outer in zip(masks, edges[:-1], edges[1:], strict=True):
        inside = mask[border:-border, border:-border]
        values = psnr(predictions[..., mask], targets[..., mask], data_range)
        rings.append(Ring(float(inner), float(outer), int(mask.sum()), values, similarity[..., inside].mean()))
    x, y = (float(value) for value in gaze)
    conditions = (
        f"{size[0]} x {size[1]} pixels, gaze ({x:g}, {y:g}), width {real_image_width:g} at {real_viewing_distance:g}"
    )
    return EccentricityReport(tuple(rings), conditions)


def ring_masks(
    size: Sequence[int],
    gaze: Sequence[float] = (0.5, 0.5),
    edges: Sequence[float] = DEFAULT_EDGES,
    real_image_width: float = 0.2,
    real_viewing_distance: float = 0.7,
    *,
    device: torch.device | str | None = None,
) -> torch.Tensor:
    """Return which pixels lie between eccentricities.

    Parameters
    ----------
    size : sequence of int
        Rows and columns.
    gaze, edges, real_image_width, real_viewing_distance
        As in :func:`eccentricity_report`.
    device : torch.device or str, optional
        Where the result lives; the CPU by default.

    Returns
    -------
    torch.Tensor
        Booleans ``[len(edges) − 1, H, W]``; no pixel is in two rings.

    Raises
    ------
    ValueError, TypeError
        If an argument is outside its range, naming it.
    """
    size = _validate.size("size", size)
    limits = _validate.numbers(_validate.real("edges", edges))
    if len(limits) < 2 or limits[0] < 0 or any(low >= high for low, high in itertools.pairwise(limits)):
        raise ValueError(f"edges must be two or more rising numbers of at least 0, got {edges!r}")
    eccentricity, _ = make_eccentricity_distance_maps(
        gaze, size, real_image_width, real_viewing_distance, dtype=torch.float64, device=device
    )
    device = eccentricity.device
    bounds = torch.tensor([math.radians(limit) for limit in limits], dtype=torch.float64, device=device)
    places = torch.bucketize(eccentricity, bounds, right=True) - 1
    return torch.stack([places == index for index in range(len(limits) - 1)])
