"""What a picture of Gaussians is asked for with: a camera, sizes, and which Gaussians."""

from collections.abc import Iterable

import torch

from odak import _validate
from odak._array import is_readable
from odak.learn._tensors import rows_of, tensor


def checked_camera(camera):
    """Return a camera; raise TypeError for anything that cannot be one."""
    for name in ("R", "focal_length", "principal_point", "transform_world_to_camera_space"):
        if not hasattr(camera, name):
            raise TypeError(f"camera must be a PerspectiveCamera, got {camera!r:.80}, which has no {name}")
    return camera


def two_sizes(size, name="tile_size") -> tuple[int, int]:
    """Return a width and a height, which need not be positive."""
    if isinstance(size, str) or not isinstance(size, Iterable) or len(size := tuple(size)) != 2:
        raise ValueError(f"{name} must be two integers (width, height), got {size!r:.80}")
    width, height = (_validate.whole(name, n, minimum=-_validate.LONGEST_SIDE) for n in size)
    return width, height


def chosen(gaussian_indices, count, device) -> torch.Tensor:
    """Return the numbers, or the choice by truth values, of some of `count` Gaussians."""
    some = tensor("gaussian_indices", gaussian_indices, device=device)
    if some.ndim != 1 or (some.dtype == torch.bool and len(some) != count):
        raise ValueError(f"gaussian_indices must be [n] numbers or {count} truth values, got {list(some.shape)}")
    if some.dtype == torch.bool:
        return some
    some = some.long()
    if is_readable(some) and bool(((some < -count) | (some >= count)).any()):
        raise ValueError(f"gaussian_indices must be below {count}, got {some.min().item()} to {some.max().item()}")
    return some


def gaussians_to_draw(
    name: str, means, z_vals, quats, scales, colours, phase, opacities, plane_probs
) -> list[torch.Tensor]:
    """Return what Gaussians are drawn from, in one precision, after checking that there is a row for each.

    Parameters
    ----------
    name : str
        What the centres are called.
    means, z_vals, quats, scales, colours, phase, opacities, plane_probs : torch.Tensor
        ``[N, 3]``, ``[N]``, ``[N, 4]``, ``[N, 3]``, ``[N, C]``, ``[N, C]``, ``[N]``, ``[N, P]``.
    """
    return rows_of(
        **{name: (means, 3)},
        z_vals=(z_vals,),
        quats=(quats, 4),
        scales=(scales, 3),
        colours=(colours, "C"),
        phase=(phase, "C"),
        opacities=(opacities,),
        plane_probs=(plane_probs, "P"),
    )


def camera_rays(camera, means_3D):
    """Return points in the axes of the camera, its focal lengths fx, fy and its principal point px, py."""
    pairs = []
    for name in ("focal_length", "principal_point"):
        values = getattr(camera, name).reshape(-1)
        if len(values) not in (1, 2):
            raise ValueError(f"camera.{name} must be one number or two, got {tuple(values.shape)}")
        pairs.extend(values.expand(2))
    return camera.transform_world_to_camera_space(means_3D), *pairs
