"""A bounding volume hierarchy over triangles, built and refitted level by level without a loop over triangles."""

from typing import NamedTuple

import torch

from odak.raytracing.geometry import triangle_normal

BRANCHES = 8
LEAF = 4
# Boxes are single precision in units of the mesh's radius: what a ray and a box lose to rounding stays below this.
MARGIN = 8 * torch.finfo(torch.float32).eps


class Tree(NamedTuple):
    """Triangles in leaves of equal size under boxes of up to eight children.

    Attributes
    ----------
    centre, scale : torch.Tensor
        float64 ``[3]`` and ``[]``: (vertex − centre)·scale lies within the unit sphere.
    faces : torch.Tensor
        int64 ``[slots, leaves]``: which face is where, −1 for none.
    corners : torch.Tensor
        ``[9·slots, 3·leaves]``: the corners (component, corner, slot) in units of the mesh's radius, once for every
        dominant axis; NaN where there is nothing to hit.
    boxes : list of torch.Tensor
        For every level float32 ``[6·children, 8·nodes]``: near and far sides for each of the eight octants of ray
        directions.
    """

    centre: torch.Tensor
    scale: torch.Tensor
    faces: torch.Tensor
    corners: torch.Tensor
    boxes: list[torch.Tensor]


def sort_faces(vertices: torch.Tensor, faces: torch.Tensor) -> torch.Tensor:
    """Return the faces of all leaves, int64 ``[leaves, slots]`` with −1 for empty slots.

    All nodes of a level are halved at once at the median of their longest axis. `leaves` is a power of two.
    """
    depth = max(-(-len(faces) // LEAF) - 1, 0).bit_length()
    slots = max(-(-len(faces) // 2**depth), 1)
    empty = slots * 2**depth - len(faces)
    middle = vertices.detach()[faces].mean(dim=1)
    # Empty slots sort behind everything, whatever the axis.
    middle = torch.nn.functional.pad(middle, (0, 0, 0, empty), value=torch.inf)
    order = torch.arange(len(middle), device=faces.device)
    for level in range(depth):
        order = order.reshape(2**level, -1)
        place = middle[order]
        there = place.isfinite()
        extent = torch.where(there, place, -torch.inf).amax(dim=1) - torch.where(there, place, torch.inf).amin(dim=1)
        axis = extent.argmax(dim=1)[:, None, None].expand(-1, place.shape[1], 1)
        order = order.gather(1, place.gather(2, axis)[..., 0].argsort(dim=1))
    return torch.where(order < len(faces), order, -1).reshape(2**depth, slots)


def fit(vertices: torch.Tensor, faces: torch.Tensor, leaves: torch.Tensor) -> Tree:
    """Return the tree over sorted leaves for vertices as they are now; triangles without area are left out."""
    vertices = vertices.detach()
    low, high = vertices.double().amin(dim=0), vertices.double().amax(dim=0)
    centre = (low + high) / 2
    radius = (vertices.double() - centre).norm(dim=1).amax()
    scale = torch.where(radius > 0, 1 / radius, 1.0)
    corners = to_frame(vertices, centre, scale)[faces[leaves.clamp(min=0)]]
    solid = (leaves >= 0) & triangle_normal(corners).isfinite().all(dim=-1)
    return Tree(centre, scale, leaves.t().contiguous(), _corner_table(corners, solid), _box_tables(corners, solid))


def to_frame(points: torch.Tensor, centre: torch.Tensor, scale: torch.Tensor) -> torch.Tensor:
    """Return points in units of the mesh's radius about its centre, rounded once to their own precision."""
    return ((points.double() - centre) * scale).to(points.dtype)


def _corner_table(corners: torch.Tensor, solid: torch.Tensor) -> torch.Tensor:
    count, slots = solid.shape
    corners = torch.where(solid[..., None, None], corners, torch.nan)
    turns = [corners[..., ((z + 1) % 3, (z + 2) % 3, z)] for z in range(3)]
    # [axis, leaf, slot, corner, component] → [component, corner, slot, axis, leaf]
    return torch.stack(turns).permute(4, 3, 2, 0, 1).reshape(9 * slots, 3 * count)


def _box_tables(corners: torch.Tensor, solid: torch.Tensor) -> list[torch.Tensor]:
    corners, solid = corners.float(), solid[..., None, None]
    low = torch.where(solid, corners, torch.inf).amin(dim=(1, 2)) - MARGIN
    high = torch.where(solid, corners, -torch.inf).amax(dim=(1, 2)) + MARGIN
    tables = []
    while len(low) > 1:
        children = min(BRANCHES, len(low))
        low, high = low.reshape(-1, children, 3), high.reshape(-1, children, 3)
        tables.append(_octants(low, high))
        low, high = low.amin(dim=1), high.amax(dim=1)
    return tables[::-1]


def _octants(low: torch.Tensor, high: torch.Tensor) -> torch.Tensor:
    """Return the sides that rays enter and leave by, ``[6·children, 8·nodes]``, from ``[nodes, children, 3]``."""
    bits = torch.arange(8, device=low.device)[:, None] >> torch.arange(3, device=low.device) & 1
    backwards = bits.bool()[:, None, None]
    sides = torch.cat((torch.where(backwards, high, low), torch.where(backwards, low, high)), dim=-1)
    return sides.permute(3, 2, 0, 1).reshape(6 * low.shape[1], 8 * len(low))
