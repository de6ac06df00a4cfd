"""What each plane of a volume is to show: the picture, sharp where it belongs to the plane and blurred elsewhere."""

from dataclasses import dataclass

import torch

from odak.cli.errors import InputError
from odak.cli.job import Job, depth_map_path
from odak.cli.target import Target, fit, read_picture, to_grey
from odak.learn.wave import multiplane_loss

BLUR_RATIO, BLUR_SIZE = 1.0, 5
_ASPECT_TOLERANCE = 0.02


@dataclass(frozen=True)
class Volume:
    """Planes and their images.

    Attributes
    ----------
    distances : list of float
        Distance of each plane from the modulator in metres.
    images : torch.Tensor
        Intensity that each plane is to show, ``[planes, channels, rows, columns]``.
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
        What was asked for.
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
    """Return the depth ``[rows, columns]`` on the modulator's frame, that of the last plane around the picture."""
    path = depth_map_path(str(job.depth_map))
    depth = to_grey(read_picture(path, "--depth-map"))
    if bool((depth == depth.flatten()[0]).all()):
        raise InputError(f"--depth-map has one depth only: {str(path)!r}; leave --planes out")
    rows, columns = (part.stop - part.start for part in target.window)
    if abs(depth.shape[-2] * columns / (depth.shape[-1] * rows) - 1) > _ASPECT_TOLERANCE:
        raise InputError(
            f"--depth-map must have the picture's shape, got {depth.shape[-2]} x {depth.shape[-1]} for a picture of "
            f"{rows} x {columns}"
        )
    # Depths are not mixed across an edge: half-way between near and far there is nothing.
    fitted, _ = fit(depth - 1, job.resolution, mode="nearest-exact", size=(rows, columns))
    return fitted[0] + 1
