"""Meshes of triangles: intersections with many rays, without gaps, and height maps; differentiable throughout.

The nearest triangle ahead of a ray is found by a bounding volume hierarchy, or by Embree. Its distance, point and
normal are then computed with gradients in the rays and the vertices.
"""

import importlib.util
import itertools
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import torch

from odak import _show, _validate
from odak._attributes import Prepared
from odak._threads import each
from odak.learn._tensors import checked_device, reals_of, tensor, trainable
from odak.learn.raytracing.boundary import reflect
from odak.learn.raytracing.primitives import placed_sheet, sheet_axes
from odak.learn.tools.file import save_torch_tensor
from odak.raytracing import arguments, geometry, intersections
from odak.raytracing.geometry import (
    edge_areas,
    encloses,
    shear_of,
    sheared,
    triangle_normal,
)
from odak.raytracing.intersections import RayStatus
from odak.tools import asset
from odak.tools.asset import write_PLY
from odak.tools.transformation import apply_matrix, rotation_matrix

BRANCHES = 8
LEAF = 4
# Boxes are in single precision in units of the mesh's radius: the rounding errors of rays and boxes stay below this.
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
    """Return the tree over sorted leaves for the current vertices; triangles without area are left out."""
    vertices = vertices.detach()
    low, high = vertices.double().amin(dim=0), vertices.double().amax(dim=0)
    centre = (low + high) / 2
    radius = (vertices.double() - centre).norm(dim=1).amax()
    scale = torch.where(radius > 0, 1 / radius, 1.0)
    corners = to_frame(vertices, centre, scale)[faces[leaves.clamp(min=0)]]
    solid = (leaves >= 0) & triangle_normal(corners).isfinite().all(dim=-1)
    held = torch.where(solid[..., None, None], corners, torch.nan)
    orders = torch.stack([held[..., ((z + 1) % 3, (z + 2) % 3, z)] for z in range(3)])
    # [axis, leaf, slot, corner, component] → [component, corner, slot, axis, leaf]
    table = orders.permute(4, 3, 2, 0, 1).reshape(9 * solid.shape[1], 3 * len(solid))
    return Tree(centre, scale, leaves.t().contiguous(), table, _box_tables(corners, solid))


def to_frame(points: torch.Tensor, centre: torch.Tensor, scale: torch.Tensor) -> torch.Tensor:
    """Return points in units of the mesh's radius about its centre, rounded once to their own precision."""
    return ((points.double() - centre) * scale).to(points.dtype)


def _box_tables(corners: torch.Tensor, solid: torch.Tensor) -> list[torch.Tensor]:
    corners, solid = corners.float(), solid[..., None, None]
    low = torch.where(solid, corners, torch.inf).amin(dim=(1, 2)) - MARGIN
    high = torch.where(solid, corners, -torch.inf).amax(dim=(1, 2)) + MARGIN
    bits = torch.arange(8, device=low.device)[:, None] >> torch.arange(3, device=low.device) & 1
    backwards = bits.bool()[:, None, None]
    tables = []
    while len(low) > 1:
        children = min(BRANCHES, len(low))
        low, high = low.reshape(-1, children, 3), high.reshape(-1, children, 3)
        # The sides that rays of each octant enter and leave by, ``[6·children, 8·nodes]``.
        sides = torch.cat((torch.where(backwards, high, low), torch.where(backwards, low, high)), dim=-1)
        tables.append(sides.permute(3, 2, 0, 1).reshape(6 * children, 8 * len(low)))
        low, high = low.amin(dim=1), high.amax(dim=1)
    return tables[::-1]


# Bytes of a pair of ray and node for each of its children: sides of boxes twice, distances, indices; and for each level
# above, where the other children wait.
PAIR_BYTES = 160
# Pairs at a time on a CPU: their boxes stay in the cache.
CPU_PAIRS = 32768


class Beam(NamedTuple):
    """Rays in the tree's frame, components first.

    Attributes
    ----------
    start : torch.Tensor
        ``[3, m]``, the dominant axis of the direction last.
    shear : torch.Tensor
        Shear and the dominant component of the direction, ``[3, m]``.
    axis, octant : torch.Tensor
        Dominant axis and octant of the direction, ``[m]``.
    slabs : torch.Tensor
        float32 ``[7, m]``: a side at x is reached at slope·x + offset (three each); and the least distance.
    first : torch.Tensor
        Distance, in lengths of the direction and units of the frame, beyond which a hit counts, ``[m]``.
    leaving : torch.Tensor or None
        Face that each ray leaves, ``[m]``; it is not met again.
    """

    start: torch.Tensor
    shear: torch.Tensor
    axis: torch.Tensor
    octant: torch.Tensor
    slabs: torch.Tensor
    first: torch.Tensor
    leaving: torch.Tensor | None


def pairs_at_a_time(tree: Tree, memory_budget: int) -> int:
    """Return how many pairs of rays and nodes to hold at once."""
    pairs = max(memory_budget // (PAIR_BYTES * (BRANCHES + len(tree.boxes))), 64)
    return pairs if tree.centre.is_cuda else min(pairs, CPU_PAIRS)


def nearest_faces(
    tree: Tree,
    start: torch.Tensor,
    direction: torch.Tensor,
    first: torch.Tensor,
    leaving: torch.Tensor | None,
    memory_budget: int,
) -> torch.Tensor:
    """Return the face that each ray meets first, int64 ``[m]``, −1 for none; of equally near ones the lowest.

    Parameters
    ----------
    tree : Tree
        The triangles.
    start, direction : torch.Tensor
        ``[3, m]`` in the tree's frame, finite; starts near the tree.
    first : torch.Tensor
        Distance beyond which a hit counts, ``[m]``.
    leaving : torch.Tensor or None
        Faces not to be met, ``[m]``.
    memory_budget : int
        Bytes that the search may take, whatever the number of rays.
    """
    cap = pairs_at_a_time(tree, memory_budget)
    found = torch.full_like(first, -1, dtype=torch.int64)
    # A ray outside the unit sphere at its nearest point misses all boxes.
    close = ((start * start).sum(dim=0) <= 1 + 1e-5).nonzero().flatten()
    for part in close.split(cap):
        chosen = None if leaving is None else leaving[part]
        beam = _beam(start.index_select(1, part), direction.index_select(1, part), first[part], chosen)
        found[part] = _search(tree, beam, cap)
    return found


def _beam(start, direction, first, leaving) -> Beam:
    axis = dominant_axis(direction)
    single = direction.float()
    # No infinite slope: its product with a side at zero would be NaN.
    slope = 1 / torch.copysign(torch.maximum(single.abs(), 1e-20 * length(single)), single)
    # −0 counts as negative, too: its box is entered by the far side.
    octant = (slope < 0).mul(torch.tensor([[1], [2], [4]], device=slope.device)).sum(dim=0)
    slabs = torch.cat((slope, -start.float() * slope, first.float()[None]))
    order = permutation_of(axis)
    start, direction = permuted(start, order), permuted(direction, order)
    return Beam(start, torch.stack((*shear_of(direction), direction[2])), axis, octant, slabs, first, leaving)


def dominant_axis(direction: torch.Tensor) -> torch.Tensor:
    """Return which component of directions ``[3, m]`` is the largest, int64 ``[m]``; of equal ones the first."""
    x, y, z = direction.detach().abs()
    second, third = y > x, z > torch.maximum(x, y)
    return torch.maximum(second.long(), 2 * third.long())


def permutation_of(axis: torch.Tensor) -> torch.Tensor:
    """Return the places in flat components ``[3·m]`` with the component `axis`, ``[m]``, last, in cyclic order.

    A choice of components by torch.where takes several times as long.
    """
    count = len(axis)
    first = torch.where(axis == 2, 0, axis + 1)
    second = 3 - axis - first
    return (torch.stack((first, second, axis)) * count + torch.arange(count, device=axis.device)).reshape(-1)


def permuted(vectors: torch.Tensor, order: torch.Tensor) -> torch.Tensor:
    """Return vectors ``[3, m]`` with their components in the order of :func:`permutation_of`."""
    return vectors.reshape(-1).index_select(0, order).reshape(3, -1)


def _search(tree: Tree, beam: Beam, cap: int) -> torch.Tensor:
    count = len(beam.first)
    best = torch.full_like(beam.first, torch.inf)
    face = torch.full_like(beam.axis, -1)
    ray = torch.arange(count, device=best.device)
    stack = [(0, ray, torch.zeros_like(ray), beam.slabs[6])]
    while stack:
        level, ray, node, entry = stack.pop()
        if len(ray) == 0:
            continue
        if len(ray) > cap:
            # Depth first keeps the lists short.
            stack += [(level, *piece) for piece in zip(*(v.split(cap) for v in (ray, node, entry)), strict=True)]
        elif level < len(tree.boxes):
            stack.append((level + 1, *_children(tree.boxes[level], beam, best, ray, node)))
        else:
            # The leaf that each ray enters first comes up front: the others are then mostly too far.
            earliest = torch.full_like(best, torch.inf, dtype=entry.dtype).scatter_reduce_(0, ray, entry, "amin")
            up_front = entry <= earliest.index_select(0, ray)
            best, face = _leaves(tree, beam, best, face, ray, node, up_front)
            later = ~up_front & (entry <= best.index_select(0, ray).float())
            best, face = _leaves(tree, beam, best, face, ray, node, later)
    return face


def _children(table: torch.Tensor, beam: Beam, best: torch.Tensor, ray, node):
    """Return the pairs of rays and child boxes that they pierce, with the distances at which they enter."""
    nodes = table.shape[1] // 8
    column = beam.octant.index_select(0, ray).mul_(nodes).add_(node)
    sides = table.index_select(1, column).reshape(2, 3, -1, len(ray))
    slabs = beam.slabs.index_select(1, ray)
    reach = torch.addcmul(slabs[3:6, None], sides, slabs[:3, None])
    enter = torch.maximum(torch.maximum(reach[0, 0], reach[0, 1]), torch.maximum(reach[0, 2], slabs[6]))
    leave = torch.minimum(torch.minimum(reach[1, 0], reach[1, 1]), reach[1, 2])
    leave = torch.minimum(leave, best.index_select(0, ray).float())
    child, pair = (enter <= leave).nonzero(as_tuple=True)
    node = node.index_select(0, pair).mul_(len(enter)).add_(child)
    return ray.index_select(0, pair), node, enter.reshape(-1).index_select(0, child.mul_(len(ray)).add_(pair))


def _leaves(tree: Tree, beam: Beam, best, face, ray, node, chosen):
    """Return the best distances and faces after the chosen pairs of rays and leaves."""
    chosen = chosen.nonzero().flatten()
    ray, node = ray.index_select(0, chosen), node.index_select(0, chosen)
    slots, leaves = tree.faces.shape
    column = beam.axis.index_select(0, ray).mul_(leaves).add_(node)
    table = tree.corners.index_select(1, column).reshape(3, 3, slots, len(ray))
    start, shear = beam.start.index_select(1, ray), beam.shear.index_select(1, ray)
    a, b, c = (sheared(table[:, corner], start, shear) for corner in range(3))
    u, v, w = edge_areas(a, b, c)
    reach = (u * a[2] + v * b[2] + w * c[2]) / ((u + v + w) * shear[2])
    hit = encloses(u, v, w) & (reach > beam.first.index_select(0, ray))
    if beam.leaving is not None:
        hit &= tree.faces.index_select(1, node) != beam.leaving.index_select(0, ray)
    reach = torch.where(hit, reach, torch.inf)
    closer = best.scatter_reduce(0, ray, reach.amin(dim=0), "amin")
    slot, pair = (hit & (reach == closer.index_select(0, ray))).nonzero(as_tuple=True)
    won = tree.faces[slot, node.index_select(0, pair)]
    # The lowest of equally near faces: the answer does not depend on the order of the pairs.
    none = torch.iinfo(torch.int64).max
    face = torch.where((closer < best) | (face < 0), none, face)
    face = face.scatter_reduce_(0, ray.index_select(0, pair), won, "amin")
    return closer, torch.where(face == none, -1, face)


@_show.shown
class MeshHit(NamedTuple):
    """Intersections of rays with a mesh of triangles.

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

    Examples
    --------
    >>> import torch
    >>> from odak.learn.raytracing import triangle_mesh
    >>> vertices = torch.tensor([[0.0, 0, 5], [4, 0, 5], [0, 4, 5]])
    >>> mesh = triangle_mesh(vertices, torch.tensor([[0, 1, 2]]))
    >>> hit = mesh.intersect(torch.tensor([[[1.0, 1, 0], [0, 0, 1]], [[9, 9, 0], [0, 0, 1]]]))
    >>> hit.distance[0].item(), hit.face.tolist()
    (5.0, [0, -1])
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


def components(rays: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Return starts and directions ``[3, m]`` of rays ``[m, 2, 3]``, and which are rays ``[m]``.

    Rays that are not finite or have no direction are replaced, so that they cannot make gradients of other rays NaN.
    """
    parts = torch.stack(rays.reshape(-1, 6).unbind(1)).unflatten(0, (2, 3))
    direction = parts[1]
    x, y, z = parts[0].detach() + direction.detach()
    solid = torch.isfinite(x + y + z) & (_dot(direction, direction).detach() > 0)
    if rays.is_cuda or not bool(solid.all()):
        parts = torch.where(solid, parts, torch.tensor([[[0.0]], [[1.0]]], dtype=rays.dtype, device=rays.device))
    return parts[0], parts[1], solid


def _dot(a: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
    """Return the scalar products of vectors ``[3, m]``."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def length(vectors: torch.Tensor) -> torch.Tensor:
    """Return the lengths of vectors ``[3, m]``; `norm` over the first axis takes many times as long."""
    return _dot(vectors, vectors).sqrt()


def nearest_approach(frame: Frame, start: torch.Tensor, direction: torch.Tensor) -> torch.Tensor:
    """Return where along rays ``[3, m]`` they come nearest to the centre, float64, in lengths of the direction."""
    start, direction = start.double() - frame.centre[:, None], direction.double()
    return -_dot(start, direction) / _dot(direction, direction)


def advanced(frame: Frame, start: torch.Tensor, direction: torch.Tensor, shift: torch.Tensor) -> torch.Tensor:
    """Return the points ``[3, m]`` at `shift` along rays, in the frame and the rays' precision.

    A far start costs no digits: it is moved near the mesh in double precision first.
    """
    moved = start.double() + shift * direction.double()
    return ((moved - frame.centre[:, None]) * frame.scale).to(start.dtype)


def face_table(frame: Frame, vertices: torch.Tensor, faces: torch.Tensor) -> torch.Tensor:
    """Return the corners of all faces in the frame, each with three components, and the unit normals, ``[t, 12]``."""
    corners = to_frame(vertices, *frame)[faces]
    # Normals of the frame's corners, as in the tree: no face is hit whose normal does not exist.
    return torch.cat((corners.flatten(1), triangle_normal(corners)), dim=1)


def evaluate(
    frame: Frame,
    table: torch.Tensor,
    faces: torch.Tensor,
    normals: torch.Tensor | None,
    start: torch.Tensor,
    direction: torch.Tensor,
    face: torch.Tensor,
    shift: torch.Tensor,
) -> MeshHit:
    """Return the hits of rays on faces, by the arithmetic of the search.

    Parameters
    ----------
    frame : Frame
        Frame of the search.
    table : torch.Tensor
        From :func:`face_table`.
    faces : torch.Tensor
        Vertices of the faces, ``[t, 3]``, one face at least.
    normals : torch.Tensor or None
        Normals at the vertices, ``[v, 3]``; the faces' own by default.
    start, direction : torch.Tensor
        From :func:`components`.
    face : torch.Tensor
        Faces met, ``[m]``, −1 for none.
    shift : torch.Tensor
        Where along the rays the search started, float64 ``[m]``; held fixed, which changes no derivative.
    """
    near = advanced(frame, start, direction, shift)
    if near.requires_grad:
        # A ray that misses far away must not overflow: its gradient would be NaN.
        near = torch.where(face >= 0, near, 0.0)
    order = permutation_of(dominant_axis(direction))
    chosen = face.clamp(min=0)
    *corners, normal = torch.stack(table.index_select(0, chosen).unbind(1)).unflatten(0, (4, 3))
    along, near = permuted(direction, order), permuted(near, order)
    seen = [sheared(permuted(corner, order), near, shear_of(along)) for corner in corners]
    areas = edge_areas(*seen)
    total = areas[0] + areas[1] + areas[2]
    hit = (face >= 0) & (total != 0)
    weights = torch.stack(areas) / torch.where(hit, total, 1.0)
    reach = (weights[0] * seen[0][2] + weights[1] * seen[1][2] + weights[2] * seen[2][2]) / along[2]
    distance = (shift + reach.double() / frame.scale).to(near.dtype)
    place = weights[0] * corners[0] + weights[1] * corners[1] + weights[2] * corners[2]
    point = (place.double() / frame.scale + frame.centre[:, None]).to(near.dtype)
    if normals is not None:
        known, weights = torch.where(hit[:, None, None], normals[faces[chosen]], 1.0), torch.where(hit, weights, 1.0)
        normal = geometry.unit((weights.t()[..., None] * known).sum(dim=1)).t()
    void = torch.where(hit, 0.0, torch.nan).to(near.dtype)
    # NaN for rays without a hit, whose gradients are zero.
    distance, point, normal, weights = (
        torch.where(hit, value, torch.nan) if value.requires_grad else value + void
        for value in (distance, point, normal, weights)
    )
    face = torch.where(hit, face, -1)
    return MeshHit(distance, _rows(point), _rows(normal), face, _rows(weights), intersections.status_array(hit))


def _rows(vectors: torch.Tensor) -> torch.Tensor:
    """Return vectors ``[3, m]`` as rows ``[m, 3]``, contiguous."""
    rows = vectors.new_empty(vectors.shape[::-1])
    rows.t().copy_(vectors)
    return rows


def misses(rays: torch.Tensor) -> MeshHit:
    """Return the hits of rays ``[m, 2, 3]`` without an intersection."""
    none = torch.full_like(rays[:, 0], torch.nan)
    face = torch.full((len(rays),), -1, dtype=torch.int64, device=rays.device)
    return MeshHit(none[:, 0], none, none, face, none, intersections.status_array(face >= 0))


EMBREE_HINT = "backend 'embree' needs the package embreex: pip install embreex"


def has_embree() -> bool:
    """Return whether embreex can be imported."""
    return importlib.util.find_spec("embreex") is not None


def embree_scene(vertices: torch.Tensor, faces: torch.Tensor) -> Any:
    """Return Embree's scene of triangles; raise ImportError that says what to install when embreex is missing."""
    try:
        from embreex import rtcore_scene
        from embreex.mesh_construction import TriangleMesh
    except ImportError as error:
        raise ImportError(EMBREE_HINT) from error
    scene = rtcore_scene.EmbreeScene()
    TriangleMesh(scene, vertices.detach().float().cpu().numpy(), faces.int().cpu().numpy())
    return scene


def nearest_faces_by_embree(
    scene: Any, start: torch.Tensor, direction: torch.Tensor, first: torch.Tensor
) -> torch.Tensor:
    """Return the face that each ray meets first, int64 ``[m]``, −1 for none; arguments as in the search of the tree."""
    start = start + first * direction
    found = scene.run(_rows(start.float()).cpu().numpy(), _rows(direction.float()).cpu().numpy())
    return torch.from_numpy(found).to(device=start.device, dtype=torch.int64)


BACKENDS = ("auto", "torch", "embree")
# Rays that are not worth a thread of their own.
SMALL = 1024


class triangle_mesh(_show.Shown):
    """Triangles over shared vertices, for rays to meet.

    Parameters
    ----------
    vertices : torch.Tensor
        ``[v, 3]``. May require a gradient.
    faces : torch.Tensor
        Integers ``[t, 3]``: three vertices each, counter-clockwise seen from where the normal points.
    normals : str or torch.Tensor
        "flat": the triangles' own; "smooth": interpolated from :meth:`vertex_normals`, for surfaces that refract;
        or normals at the vertices, ``[v, 3]``.
    backend : str
        "torch": the search of this library, any device and precision, without gaps. "embree": Embree's, in single
        precision on the CPU; needs the package embreex (``pip install embreex``). "auto": Embree for float32 on the
        CPU when it is installed, else torch.
    memory_budget : int
        Bytes that the search may hold beside its result, whatever the number of rays.

    Raises
    ------
    TypeError
        If faces are not integers.
    ValueError
        If a shape is wrong, a face names a vertex that does not exist, or a vertex is not finite.
    ImportError
        If `backend` is "embree" and embreex is not installed.

    Notes
    -----
    The search: a bounding volume hierarchy of eight branches, which all rays descend together, and the test of Woop,
    Benthin and Wald, J. Comput. Graph. Tech. 2(1), 65 (2013). It keeps the faces alone; distance, point and normal are
    computed again from them, so that gradients cost memory for one triangle per ray. They do not see that a ray may
    move to another face. Triangles without area are not hit. Embree rounds more coarsely and may miss at edges.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.raytracing import triangle_mesh
    >>> square = torch.tensor([[0.0, 0, 5], [1, 0, 5], [1, 1, 5], [0, 1, 5]])
    >>> mesh = triangle_mesh(square, torch.tensor([[0, 1, 2], [0, 2, 3]]))
    >>> hit = mesh.intersect(torch.tensor([[[0.5, 0.25, 0.0], [0.0, 0.0, 1.0]], [[2.0, 2.0, 0.0], [0.0, 0.0, 1.0]]]))
    >>> hit.distance, hit.face
    (tensor([5., nan]), tensor([ 0, -1]))
    """

    def __init__(
        self,
        vertices: torch.Tensor,
        faces: torch.Tensor,
        normals: str | torch.Tensor = "flat",
        backend: str = "auto",
        memory_budget: int = 2**28,
    ) -> None:
        (vertices,) = reals_of(vertices=vertices)
        self.vertices: torch.Tensor = _checked_vertices(vertices)
        self.faces: torch.Tensor = _checked_faces(faces, self.vertices)
        self.backend: str = _validate.one_of("backend", backend, BACKENDS)
        if self.backend == "embree" and not has_embree():
            raise ImportError(EMBREE_HINT)
        self.memory_budget: int = _validate.integer("memory_budget", memory_budget, minimum=2**16)
        self.normals: str | torch.Tensor = _checked_normals(normals, self.vertices)
        self._leaves: torch.Tensor | None = None
        self._trees: dict[Any, Any] = {}
        self._tables: dict[Any, Any] = {}
        self._scene: Any = None

    def moved(self, vertices: torch.Tensor) -> "triangle_mesh":
        """Return the same mesh with its vertices elsewhere; the hierarchy is refitted, not built again.

        Meant for the steps of an optimization. Normals given at vertices are kept.
        """
        (vertices,) = reals_of(vertices=vertices)
        if len(_checked_vertices(vertices)) != len(self.vertices):
            raise ValueError(f"vertices must have as many rows as before, {len(self.vertices)}; got {len(vertices)}")
        mesh = triangle_mesh(vertices, self.faces, self.normals, self.backend, self.memory_budget)
        mesh._leaves = self._sorted()
        return mesh

    def triangles(self) -> torch.Tensor:
        """Return the corners of all faces, ``[t, 3, 3]``."""
        return self.vertices[self.faces]

    def vertex_normals(self) -> torch.Tensor:
        """Return unit normals at the vertices, ``[v, 3]``, differentiable; NaN at vertices without a face.

        The faces around a vertex count by Max's weights, which are exact on a sphere (J. Graphics Tools 4(2), 1, 1999).
        """
        corners = self.triangles()
        total = torch.zeros_like(self.vertices)
        for i in range(3):
            edge1, edge2 = corners[:, (i + 1) % 3] - corners[:, i], corners[:, (i + 2) % 3] - corners[:, i]
            weight = geometry.corner_weights(edge1, edge2)
            total = total.index_add(0, self.faces[:, i], weight[:, None] * geometry.cross(edge1, edge2))
        return geometry.unit(total)

    def intersect(
        self,
        rays: torch.Tensor,
        minimum_distance: float | torch.Tensor | None = None,
        leaving: torch.Tensor | None = None,
    ) -> MeshHit:
        """Return the nearest hit ahead of each ray.

        Parameters
        ----------
        rays : torch.Tensor
            ``[..., 2, 3]``. Directions need not be unit vectors. A ray that is not finite or has no direction misses.
        minimum_distance : float or torch.Tensor, optional
            Hits that are not farther than this, in lengths of the direction, do not count; a number or ``[...]``. By
            default a few roundings of the mesh's size, so that a ray does not meet again the face it starts on.
        leaving : torch.Tensor, optional
            Faces that the rays start on, integers ``[...]``, −1 for none: they are left out, wherever the start has
            been rounded to. Searched by torch whatever the backend.

        Returns
        -------
        MeshHit
            Named tuple of distance ``[...]``, point and normal ``[..., 3]``, face ``[...]``, barycentric ``[..., 3]``
            and status ``[...]``, in the wider precision of rays and mesh, on the mesh's device.

        Raises
        ------
        ValueError
            If a shape is wrong.
        """
        (minimum_distance,) = _validate.constants(minimum_distance=minimum_distance)
        vertices, rays = reals_of(vertices=self.vertices, rays=rays)
        _validate.shaped("rays", rays, "[..., 2, 3]")
        batch, flat = rays.shape[:-2], rays.reshape(-1, 2, 3)
        if len(flat) and len(self.faces):
            limits = _per_ray("minimum_distance", minimum_distance, rays), _per_ray("leaving", leaving, rays)
            hit = self._nearest(vertices, flat, *limits)
        else:
            hit = misses(flat)
        return MeshHit(*(field.reshape(batch + field.shape[1:]) for field in hit))

    def write_PLY(self, filename: str, text: bool = False) -> None:
        """Write vertices and faces as a PLY file, atomically.

        Parameters
        ----------
        filename : str
            Path of the file.
        text : bool
            Whether to write numbers as text; by default False, binary.
        """
        text = _validate.flag("text", text)
        asset.write_mesh(filename, self.vertices.detach().cpu().numpy(), self.faces.cpu().numpy(), text)

    @classmethod
    def read_PLY(cls, filename: str, device: torch.device | str | None = None, **options: Any) -> "triangle_mesh":
        """Return the mesh of a PLY file, with polygons divided into triangles.

        Parameters
        ----------
        filename : str
            Path of the file.
        device : torch.device or str, optional
            Device of the mesh, by default the CPU.
        **options :
            Further arguments of the class.

        Raises
        ------
        FileNotFoundError
            If there is no such file.
        ValueError
            If it is not a PLY file of a mesh.
        """
        vertices, faces = (torch.from_numpy(v).to(device) for v in asset.read_mesh(filename))
        if not bool(torch.isfinite(vertices).all()):
            raise ValueError(f"{filename!r} has vertices that are not finite")
        return cls(vertices, faces, **options)

    def _nearest(self, vertices, rays, minimum, leaving) -> MeshHit:
        with torch.no_grad():
            tree = self._fitted(vertices)
        frame = Frame(tree.centre, tree.scale)
        normals = self.vertex_normals() if isinstance(self.normals, str) and self.normals == "smooth" else self.normals
        normals = normals.to(vertices) if torch.is_tensor(normals) else None
        table = self._table(frame, vertices)
        fits = vertices.dtype == torch.float32 and vertices.device.type == "cpu" and has_embree()
        by_embree = self.backend == "embree" or (self.backend == "auto" and fits)
        embree = self._embree_scene(tree) if leaving is None and by_embree else None
        # Pieces that stay in the cache, shared out among the threads of a CPU.
        threads = 1 if rays.is_cuda else torch.get_num_threads()
        budget = self.memory_budget // threads
        size = min(pairs_at_a_time(tree, budget), max(-(-len(rays) // threads), SMALL))
        size = -(-len(rays) // -(-len(rays) // size))
        pieces = rays.split(size)
        limits = (itertools.repeat(None) if v is None else v.split(size) for v in (minimum, leaving))

        def search(start, direction, solid, minimum, leaving):
            return self._search(tree, embree, budget, start, direction, solid, minimum, leaving)

        def hits(rays, minimum, leaving):
            start, direction, solid = components(rays)
            searched = search(start, direction, solid, minimum, leaving)
            return evaluate(frame, table, self.faces, normals, start, direction, *searched)

        found: Iterable[MeshHit]
        if torch.is_grad_enabled() and any(v is not None and v.requires_grad for v in (rays, table, normals)):
            parts = [components(piece) for piece in pieces]
            items = ((*(v.detach() for v in part), *limit) for part, *limit in zip(parts, *limits, strict=False))
            found = (
                evaluate(frame, table, self.faces, normals, start, direction, *searched)
                for (start, direction, _), searched in zip(parts, each(search, items, threads > 1), strict=True)
            )
        else:
            found = each(hits, zip(pieces, *limits, strict=False), threads > 1)
        return MeshHit(*map(torch.cat, zip(*found, strict=True)))

    def _search(self, tree, embree, budget, start, direction, solid, minimum, leaving):
        """Return the faces met and where along the rays their search started, ``[m]``."""
        frame = Frame(tree.centre, tree.scale)
        shift = nearest_approach(frame, start, direction)
        near = advanced(frame, start, direction, shift)
        if minimum is None:
            reach = 1 + length(start - frame.centre.to(start)[:, None]) * frame.scale.to(start)
            first = 16 * geometry.epsilon(start) * reach / length(direction)
        else:
            first = minimum.double() * frame.scale
        first = (first - shift * frame.scale).to(start.dtype)
        if embree is not None:
            face = nearest_faces_by_embree(embree, near, direction, first)
        else:
            face = nearest_faces(tree, near, direction, first, leaving, budget)
        return torch.where(solid, face, -1), shift

    def _sorted(self) -> torch.Tensor:
        if self._leaves is None:
            self._leaves = sort_faces(self.vertices, self.faces)
        return self._leaves

    def _fitted(self, vertices: torch.Tensor) -> Tree:
        if vertices.dtype not in self._trees:
            self._trees[vertices.dtype] = fit(vertices, self.faces, self._sorted())
        return self._trees[vertices.dtype]

    def _table(self, frame: Frame, vertices: torch.Tensor) -> torch.Tensor:
        """Return corners and normals of all faces, with their graph or kept."""
        if vertices.requires_grad and torch.is_grad_enabled():
            return face_table(frame, vertices, self.faces)
        if vertices.dtype not in self._tables:
            self._tables[vertices.dtype] = face_table(frame, vertices.detach(), self.faces)
        return self._tables[vertices.dtype]

    def _embree_scene(self, tree: Tree):
        if self._scene is None:
            placed = to_frame(self.vertices.detach(), tree.centre, tree.scale)
            self._scene = embree_scene(placed, self.faces)
        return self._scene


def _checked_vertices(vertices: torch.Tensor) -> torch.Tensor:
    _validate.shaped("vertices", vertices, "[v, 3]")
    if not bool(vertices.detach().isfinite().all()):
        raise ValueError("vertices must be finite")
    return vertices


def _checked_faces(faces, vertices: torch.Tensor) -> torch.Tensor:
    faces = tensor("faces", faces, device=vertices.device)
    if faces.dtype.is_floating_point or faces.dtype.is_complex or faces.dtype == torch.bool:
        raise TypeError(f"faces must be integers, got {faces.dtype}")
    _validate.shaped("faces", faces, "[t, 3]")
    if faces.numel() and not (int(faces.min()) >= 0 and int(faces.max()) < len(vertices)):
        span = f"{int(faces.min())} … {int(faces.max())}"
        raise ValueError(f"faces must name vertices 0 … {len(vertices) - 1}, got {span}")
    return faces.long()


def _checked_normals(normals, vertices: torch.Tensor):
    if isinstance(normals, str):
        return _validate.one_of("normals", normals, ("flat", "smooth"))
    (normals,) = reals_of(normals=normals)
    _validate.shaped("normals", normals, f"{list(vertices.shape)} as the vertices")
    return normals


def _per_ray(name: str, value, rays: torch.Tensor) -> torch.Tensor | None:
    """Return a value for each ray ``[m]``, without a graph."""
    if value is None:
        return None
    (value,) = reals_of(**{name: value}) if name == "minimum_distance" else (tensor(name, value),)
    try:
        return value.to(rays.device).detach().expand(rays.shape[:-2]).reshape(-1)
    except RuntimeError as error:
        raise ValueError(f"{name} must be a number or {tuple(rays.shape[:-2])}, one for each of the rays") from error


class planar_mesh(_show.Shown, Prepared):
    """A rectangle of triangles whose vertices can be lifted, to be learned.

    Parameters
    ----------
    size : sequence of float
        Extent along x and y, about the origin.
    number_of_meshes : sequence of int
        Number of vertices n0, n1 along x and y; there are (n0 − 1)·(n1 − 1) squares of two triangles each.
    angles : torch.Tensor
        Degrees about X, Y and Z, applied in this order about the origin.
    offset : torch.Tensor
        Shift after the rotation, ``[3]``.
    device : torch.device, optional
        By default the device of `heights`, else the CPU.
    heights : torch.Tensor, optional
        Heights along the rotated z axis, ``[n0, n1, 1]``; zeros by default.

    Attributes
    ----------
    heights : torch.Tensor
        Leaf ``[n0, n1, 1]`` that requires a gradient; the tensor given, when it was one.
    X : torch.Tensor
        Positions of the vertices along x, ``[n0, n1, 1]``.
    Y : torch.Tensor
        Positions of the vertices along y, ``[n0, n1, 1]``.
    ray_indices : torch.Tensor or None
        After :meth:`mirror`: which ray each of the reflected ones was, ``[k]``.

    Raises
    ------
    ValueError
        If a shape is wrong.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.raytracing import planar_mesh
    >>> mesh = planar_mesh(size=[2.0, 2.0], number_of_meshes=[3, 3])
    >>> rays, normals = mesh.mirror(torch.tensor([[[0.2, -3.0, 5.0], [0.0, 0.6, -0.8]]]))
    >>> rays.detach()
    tensor([[[0.2000, 0.7500, 0.0000],
             [0.0000, 0.6000, 0.8000]]])
    """

    size: torch.Tensor
    angles: torch.Tensor
    offset: torch.Tensor
    number_of_meshes: torch.Tensor

    _fixed = ("size", "number_of_meshes", "device")

    def __init__(
        self,
        size: Sequence[float] = (1.0, 1.0),
        number_of_meshes: Sequence[int] = (10, 10),
        angles: torch.Tensor | None = None,
        offset: torch.Tensor | None = None,
        device: torch.device | str | None = None,
        heights: torch.Tensor | None = None,
    ) -> None:
        device = heights.device if device is None and torch.is_tensor(heights) else checked_device("device", device)
        self.device: torch.device = torch.device("cpu") if device is None else device
        self.number_of_meshes = torch.tensor(_validate.size("number_of_meshes", number_of_meshes), device=self.device)
        self.size, self.angles, self.offset = placed_sheet(self.device, size, angles=angles, offset=offset)
        self.ray_indices: torch.Tensor | None = None
        self._mesh: triangle_mesh | None = None
        self.init_heights(heights)

    def init_heights(self, heights: torch.Tensor | None = None) -> None:
        """Set the heights, ``[n0, n1, 1]``, and the places of the vertices.

        A tensor is taken as it is and made to require a gradient; None gives zeros.
        """
        n0, n1 = self.number_of_meshes.tolist()
        if heights is None:
            heights = torch.zeros(n0, n1, 1, dtype=self.size.dtype, device=self.device)
        if not torch.is_tensor(heights) or not heights.dtype.is_floating_point:
            raise TypeError("heights must be a tensor of real numbers")
        _validate.shaped("heights", heights, f"[{n0}, {n1}, 1]")
        heights = trainable(heights.to(self.device))
        self.heights: Any = heights if heights.requires_grad else heights.requires_grad_()
        dtype = torch.promote_types(heights.dtype, self.size.dtype)
        axes = torch.meshgrid(*sheet_axes(self.size.to(dtype), (n0, n1)), indexing="ij")
        self.X, self.Y = (axis[..., None] for axis in axes)

    def get_squares(self) -> torch.Tensor:
        """Return the vertices before rotation and shift, ``[n0, n1, 3]``: x, y, height."""
        return torch.cat((self.X, self.Y, self.heights.to(self.X.dtype)), dim=-1)

    def get_triangles(self) -> torch.Tensor:
        """Return the triangles in space, ``[2·(n0 − 1)·(n1 − 1), 3, 3]``.

        First (i+1, j), (i+1, j+1), (i, j+1) of all squares, j fast, then (i+1, j), (i, j+1), (i, j). Flat, their
        normals point along the rotated z axis.
        """
        return self._vertices()[self._faces()]

    def get_mesh(self) -> triangle_mesh:
        """Return the mesh for :meth:`triangle_mesh.intersect`, with its graph."""
        vertices = self._vertices()
        if self._mesh is None:
            self._mesh = triangle_mesh(vertices.detach(), self._faces(), backend="torch")
        return self._mesh.moved(vertices)

    def mirror(self, rays: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Reflect rays at their first intersection with the mesh ahead of them, on either side of it.

        Parameters
        ----------
        rays : torch.Tensor
            ``[2, 3]`` or ``[m, 2, 3]``.

        Returns
        -------
        tuple of torch.Tensor
            Reflected rays and normals, ``[k, 2, 3]`` each, which start at the points hit. Rays that miss are left out;
            the others are sorted by triangle, and within a triangle as given: `ray_indices` says which they were.
        """
        rays = rays.to(self.device) if torch.is_tensor(rays) else rays
        rays, _ = reals_of(rays=rays, heights=self.heights)
        rays = arguments.rays("rays", rays).reshape(-1, 2, 3)
        hit = self.get_mesh().intersect(rays)
        struck = hit.hit.nonzero().flatten()
        self.ray_indices = struck[hit.face[struck].argsort(stable=True)]
        normals = hit.normals[self.ray_indices]
        return reflect(rays[self.ray_indices], normals), normals

    def save_heights(self, filename: str = "heights.pt") -> None:
        """Write the heights to a ``.pt`` or ``.pth`` file, without their autograd graph, atomically.

        Parameters
        ----------
        filename : str
            Path of the file, default "heights.pt".
        """
        save_torch_tensor(filename, self.heights.detach().clone())

    def save_heights_as_PLY(self, filename: str = "mesh.ply") -> None:
        """Write the triangles in space as a PLY text file, with three vertices each.

        Parameters
        ----------
        filename : str
            Path of the file, default "mesh.ply".
        """
        write_PLY(self.get_triangles().detach().cpu().numpy(), filename)

    def _vertices(self) -> torch.Tensor:
        points = self.get_squares().reshape(-1, 3)
        angles, offset = self.angles.to(points.dtype), self.offset.to(points.dtype)
        return apply_matrix(rotation_matrix(angles), points) + offset

    def _faces(self) -> torch.Tensor:
        n0, n1 = self.number_of_meshes.tolist()
        index = torch.arange(n0 * n1, device=self.device).reshape(n0, n1)
        near, right, up, far = index[:-1, :-1], index[1:, :-1], index[:-1, 1:], index[1:, 1:]
        halves = ((right, far, up), (right, up, near))
        return torch.cat([torch.stack(corners, dim=-1).reshape(-1, 3) for corners in halves])
