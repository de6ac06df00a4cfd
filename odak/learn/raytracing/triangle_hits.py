"""What a ray finds on a known face, computed again with a graph: distance, point, normal, barycentric coordinates."""

from typing import Any, NamedTuple

import torch

from odak.learn.raytracing import arguments
from odak.learn.raytracing.triangle_tree import to_frame
from odak.raytracing import geometry, intersections, watertight
from odak.raytracing.status import RayStatus


class MeshHit(NamedTuple):
    """Where rays meet a mesh.

    Attributes
    ----------
    distance : torch.Tensor
        ``[...]``, in lengths of the direction; NaN unless hit.
    point : torch.Tensor
        ``[..., 3]``; NaN unless hit.
    normal : torch.Tensor
        Unit normal ``[..., 3]``, right-handed about the corners; NaN unless hit.
    face : torch.Tensor
        int64 ``[...]``; −1 unless hit.
    barycentric : torch.Tensor
        Weights of the three corners, ``[..., 3]``, sum 1; NaN unless hit.
    status : torch.Tensor
        :class:`odak.raytracing.RayStatus` as int8, ``[...]``.
    """

    distance: Any
    point: Any
    normal: Any
    face: Any
    barycentric: Any
    status: Any

    @property
    def hit(self) -> torch.Tensor:
        """Which rays hit, bool ``[...]``."""
        return self.status == int(RayStatus.HIT)

    @property
    def normals(self) -> torch.Tensor:
        """The normals as rays from the points hit, ``[..., 2, 3]``, as reflect and refract take them."""
        return arguments.as_rays(self.point, self.normal)


class Frame(NamedTuple):
    """Units of a mesh's radius about its centre, float64 ``[3]`` and ``[]``."""

    centre: torch.Tensor
    scale: torch.Tensor


def nearest_approach(frame: Frame, start: torch.Tensor, direction: torch.Tensor) -> torch.Tensor:
    """Return where along rays ``[m, 3]`` they come nearest to the centre, float64, in lengths of the direction."""
    start, direction = start.double() - frame.centre, direction.double()
    return -geometry.dot(start, direction) / geometry.dot(direction, direction)


def advanced(frame: Frame, start: torch.Tensor, direction: torch.Tensor, shift: torch.Tensor) -> torch.Tensor:
    """Return the points `shift` along rays, in the frame and the rays' precision.

    A far start costs no digits: it is moved near the mesh in double precision first.
    """
    moved = start.double() + shift[:, None] * direction.double()
    return ((moved - frame.centre) * frame.scale).to(start.dtype)


def turned_vertices(frame: Frame, vertices: torch.Tensor) -> torch.Tensor:
    """Return vertices in the frame, once with each axis as their last component: ``[3·v, 3]``."""
    placed = to_frame(vertices, *frame)
    return torch.cat([placed[:, ((z + 1) % 3, (z + 2) % 3, z)] for z in range(3)])


def evaluate(
    frame: Frame, turned: torch.Tensor, faces: torch.Tensor, normals, start, direction, face, shift
) -> MeshHit:
    """Return the hits of rays ``[m, 3]`` on faces ``[m]``, by the arithmetic of the search.

    Parameters
    ----------
    frame : Frame
        Frame of the search.
    turned : torch.Tensor
        From :func:`turned_vertices`.
    faces : torch.Tensor
        Vertices of the faces, ``[t, 3]``, one face at least.
    normals : torch.Tensor or None
        Normals at the vertices, ``[v, 3]``; the faces' own by default.
    start, direction : torch.Tensor
        Finite rays ``[m, 3]``, no direction zero.
    face : torch.Tensor
        Faces met, −1 for none.
    shift : torch.Tensor
        Where along the rays the search started, float64 ``[m]``; held fixed, which changes no derivative.
    """
    axis = direction.detach().abs().argmax(dim=1)
    order = watertight.frame_order(axis)
    # A ray that misses far away must not overflow: its gradient would be NaN.
    near = torch.where((face >= 0)[:, None], advanced(frame, start, direction, shift), 0.0)
    near = near.gather(1, order).unbind(1)
    along = direction.gather(1, order).unbind(1)
    chosen = faces.index_select(0, face.clamp(min=0))
    rows = (chosen.t() + axis * (len(turned) // 3)).reshape(-1)
    corners = turned.index_select(0, rows).t().reshape(3, 3, -1)
    seen = [watertight.sheared(corners[:, i].unbind(), near, watertight.shear_of(along)) for i in range(3)]
    areas = watertight.edge_areas(*seen)
    hit = (face >= 0) & (sum(areas) != 0)
    total = torch.where(hit, sum(areas), 1.0)
    weights = [area / total for area in areas]
    reach = sum(weight * corner[2] for weight, corner in zip(weights, seen, strict=True)) / along[2]
    distance = (shift + reach.double() / frame.scale).to(start.dtype)
    place = sum(weight * corners[:, i] for i, weight in enumerate(weights)).t()
    back = watertight.frame_order(torch.where(axis == 2, 2, 1 - axis))
    point = (place.gather(1, back).double() / frame.scale + frame.centre).to(start.dtype)
    weights = torch.stack(weights, dim=1)
    if normals is None:
        # From the frame's corners, as in the tree: no face is hit whose normal does not exist.
        normal = geometry.triangle_normal(corners.permute(2, 1, 0)).gather(1, back)
    else:
        normal = _interpolated(weights, normals[chosen], hit)
    distance, point, normal = (geometry.masked(value, hit) for value in (distance, point, normal))
    return MeshHit(
        distance,
        point,
        normal,
        torch.where(hit, face, -1),
        geometry.masked(weights, hit),
        intersections.status_array(hit),
    )


def misses(rays: torch.Tensor) -> MeshHit:
    """Return the hits of rays ``[m, 2, 3]`` that meet nothing."""
    none = torch.full_like(rays[:, 0], torch.nan)
    face = torch.full((len(rays),), -1, dtype=torch.int64, device=rays.device)
    return MeshHit(none[:, 0], none, none, face, none, intersections.status_array(face >= 0))


def _interpolated(weights: torch.Tensor, normals: torch.Tensor, hit: torch.Tensor) -> torch.Tensor:
    normals = torch.where(hit[:, None, None], normals, 1.0)
    weights = torch.where(hit[:, None], weights, 1.0)
    return geometry.unit((weights[..., None] * normals).sum(dim=1))
