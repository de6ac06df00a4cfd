"""First parameters of complex Gaussians in space: random ones, and those of a point cloud."""

import math

import torch

NAMES = (
    "pre_act_quats",
    "means",
    "pre_act_scales",
    "colours",
    "pre_act_phase",
    "pre_act_opacities",
    "pre_act_plane_assignment",
)
_EXTENT = 15.7
_KEPT, _BACKGROUND, _SHELL, _BAND = 0.98, 0.8, (0.5, 0.8), 0.35


def random_cloud(number: int, planes: int, draw: torch.Generator) -> dict[str, torch.Tensor]:
    """Return parameters of Gaussians drawn in a cube of half width 15.7."""
    means = _EXTENT * (2 * torch.rand(number, 3, generator=draw) - 1)
    return _dressed(means, torch.rand(number, 3, generator=draw), planes, draw)


def point_cloud(
    positions: torch.Tensor,
    colors: torch.Tensor,
    planes: int,
    copies: int,
    scatter: float,
    outdoor: bool,
    draw: torch.Generator,
) -> dict[str, torch.Tensor]:
    """Return parameters of Gaussians at points.

    Parameters
    ----------
    positions, colors : torch.Tensor
        ``[M, 3]``.
    planes : int
        Number of planes.
    copies : int
        Copies of all points to add, each point moved by a normal distribution.
    scatter : float
        Its standard deviation.
    outdoor : bool
        Leave out the 2 % of points farthest from their mean, and add 0.8 times as many as are left in the background:
        on a shell from 0.5 to 0.8 times the largest distance left, no more than 0.35 of a unit vector along the axis
        of least extent. They take the colours of points drawn from the cloud.
    draw : torch.Generator
        Source of randomness.
    """
    moved = [positions + scatter * torch.randn(positions.shape, generator=draw) for _ in range(copies)]
    positions, colors = torch.cat([positions, *moved]), colors.repeat(copies + 1, 1)
    if outdoor:
        positions, colors = _with_background(positions, colors, draw)
    return _dressed(positions, colors, planes, draw)


def _dressed(means, colours, planes, draw):
    number = len(means)
    quats = torch.tensor([1.0, 0.0, 0.0, 0.0]) + 0.01 * torch.randn(number, 4, generator=draw)
    scales = (0.01 * (torch.rand(number, 1, generator=draw) + 1e-6)).log().repeat(1, 3)
    values = (
        *(quats, means, scales, colours, torch.randn(number, 3, generator=draw)),
        *(torch.ones(number), 10 * torch.randn(number, planes, generator=draw)),
    )
    return dict(zip(NAMES, values, strict=True))


def _with_background(positions, colors, draw):
    centre = positions.mean(0)
    distance = (positions - centre).norm(dim=1)
    kept = distance.argsort()[: max(1, math.ceil(_KEPT * len(positions)))].sort().values
    positions, colors, farthest = positions[kept], colors[kept], distance[kept].max()
    number = int(_BACKGROUND * len(positions))
    axes = torch.linalg.svd(positions - positions.mean(0), full_matrices=True).Vh
    height = _BAND * (2 * torch.rand(number, 1, generator=draw) - 1)
    angle = 2 * math.pi * torch.rand(number, 1, generator=draw)
    around = (1 - height.square()).sqrt()
    directions = torch.cat([around * angle.cos(), around * angle.sin(), height], dim=1) @ axes
    low, high = _SHELL
    radius = farthest * (low + (high - low) * torch.rand(number, 1, generator=draw))
    borrowed = torch.randint(len(colors), (number,), generator=draw)
    return torch.cat([positions, centre + radius * directions]), torch.cat([colors, colors[borrowed]])
