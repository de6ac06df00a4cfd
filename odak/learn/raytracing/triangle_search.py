"""Search for the nearest triangle ahead of rays: a bounding volume hierarchy, Embree, and hits with gradients."""

import importlib.util
from typing import Any, NamedTuple

import torch

from odak.raytracing import arguments, geometry, intersections
from odak.raytracing.geometry import (
    edge_areas,
    encloses,
    frame_order,
    shear_of,
    sheared,
    triangle_normal,
)
from odak.raytracing.intersections import RayStatus

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
    """Return the tree over sorted leaves for vertices as they are now; triangles without area are left out."""
    vertices = vertices.detach()
    low, high = vertices.double().amin(dim=0), vertices.double().amax(dim=0)
    centre = (low + high) / 2
    radius = (vertices.double() - centre).norm(dim=1).amax()
    scale = torch.where(radius > 0, 1 / radius, 1.0)
    corners = to_frame(vertices, centre, scale)[faces[leaves.clamp(min=0)]]
    solid = (leaves >= 0) & triangle_normal(corners).isfinite().all(dim=-1)
    held = torch.where(solid[..., None, None], corners, torch.nan)
    turns = torch.stack([held[..., ((z + 1) % 3, (z + 2) % 3, z)] for z in range(3)])
    # [axis, leaf, slot, corner, component] → [component, corner, slot, axis, leaf]
    table = turns.permute(4, 3, 2, 0, 1).reshape(9 * solid.shape[1], 3 * len(solid))
    return Tree(centre, scale, leaves.t().contiguous(), table, _box_tables(corners, solid))


def to_frame(points: torch.Tensor, centre: torch.Tensor, scale: torch.Tensor) -> torch.Tensor:
    """Return points in units of the mesh's radius about its centre, rounded once to their own precision."""
    return ((points.double() - centre) * scale).to(points.dtype)


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


# Bytes that a pair of ray and node takes on its way: sides of eight boxes twice, entries, indices, and its children.
PAIR_BYTES = 1024
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
    tree: Tree, start: torch.Tensor, direction: torch.Tensor, first: torch.Tensor, leaving, memory_budget: int
) -> torch.Tensor:
    """Return the face that each ray meets first, int64 ``[m]``, −1 for none; of equally near ones the lowest.

    Parameters
    ----------
    tree : Tree
        The triangles.
    start, direction : torch.Tensor
        ``[m, 3]`` in the tree's frame, finite; starts near the tree.
    first : torch.Tensor
        Distance beyond which a hit counts, ``[m]``.
    leaving : torch.Tensor or None
        Faces not to be met, ``[m]``.
    memory_budget : int
        Bytes that the search may take, whatever the number of rays.
    """
    cap = pairs_at_a_time(tree, memory_budget)
    found = torch.full((len(start),), -1, dtype=torch.int64, device=start.device)
    # A ray outside the unit sphere at its nearest point misses all boxes.
    close = ((start * start).sum(dim=1) <= 1 + 1e-5).nonzero().flatten()
    for part in close.split(cap):
        chosen = None if leaving is None else leaving[part]
        beam = _beam(start[part], direction[part], first[part], chosen)
        found[part] = _search(tree, beam, cap)
    return found


def _beam(start, direction, first, leaving) -> Beam:
    axis = direction.abs().argmax(dim=1)
    single = direction.float()
    length = single.norm(dim=1, keepdim=True)
    # No infinite slope: its product with a side at zero would be NaN.
    tiny = torch.where(single < 0, -1e-20, 1e-20) * length
    slope = 1 / torch.where(single.abs() < tiny.abs(), tiny, single)
    octant = ((slope < 0) * torch.tensor([1, 2, 4], device=slope.device)).sum(dim=1)
    slabs = torch.cat((slope, -start.float() * slope, first.float()[:, None]), dim=1).t().contiguous()
    start, direction = (v.gather(1, frame_order(axis)).t().contiguous() for v in (start, direction))
    return Beam(start, torch.stack((*shear_of(direction), direction[2])), axis, octant, slabs, first, leaving)


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
    order = frame_order(axis)
    # A ray that misses far away must not overflow: its gradient would be NaN.
    near = torch.where((face >= 0)[:, None], advanced(frame, start, direction, shift), 0.0)
    near = near.gather(1, order).unbind(1)
    along = direction.gather(1, order).unbind(1)
    chosen = faces.index_select(0, face.clamp(min=0))
    rows = (chosen.t() + axis * (len(turned) // 3)).reshape(-1)
    corners = turned.index_select(0, rows).t().reshape(3, 3, -1)
    seen = [sheared(corners[:, i].unbind(), near, shear_of(along)) for i in range(3)]
    areas = edge_areas(*seen)
    hit = (face >= 0) & (sum(areas) != 0)
    total = torch.where(hit, sum(areas), 1.0)
    weights = [area / total for area in areas]
    reach = sum(weight * corner[2] for weight, corner in zip(weights, seen, strict=True)) / along[2]
    distance = (shift + reach.double() / frame.scale).to(start.dtype)
    place = sum(weight * corners[:, i] for i, weight in enumerate(weights)).t()
    back = frame_order(torch.where(axis == 2, 2, 1 - axis))
    point = (place.gather(1, back).double() / frame.scale + frame.centre).to(start.dtype)
    weights = torch.stack(weights, dim=1)
    if normals is None:
        # From the frame's corners, as in the tree: no face is hit whose normal does not exist.
        normal = geometry.triangle_normal(corners.permute(2, 1, 0)).gather(1, back)
    else:
        known, shares = torch.where(hit[:, None, None], normals[chosen], 1.0), torch.where(hit[:, None], weights, 1.0)
        normal = geometry.unit((shares[..., None] * known).sum(dim=1))
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
    """Return the hits of rays ``[m, 2, 3]`` without an intersection."""
    none = torch.full_like(rays[:, 0], torch.nan)
    face = torch.full((len(rays),), -1, dtype=torch.int64, device=rays.device)
    return MeshHit(none[:, 0], none, none, face, none, intersections.status_array(face >= 0))


EMBREE_HINT = "backend 'embree' needs the package embreex: pip install odak[mesh]"


def has_embree() -> bool:
    """Say whether embreex can be imported."""
    return importlib.util.find_spec("embreex") is not None


def embree_scene(vertices: torch.Tensor, faces: torch.Tensor):
    """Return Embree's scene of triangles; raise ImportError that says what to install when embreex is missing."""
    try:
        from embreex import rtcore_scene
        from embreex.mesh_construction import TriangleMesh
    except ImportError as error:
        raise ImportError(EMBREE_HINT) from error
    scene = rtcore_scene.EmbreeScene()
    TriangleMesh(scene, vertices.detach().float().cpu().numpy(), faces.int().cpu().numpy())
    return scene


def nearest_faces_by_embree(scene, start: torch.Tensor, direction: torch.Tensor, first: torch.Tensor) -> torch.Tensor:
    """Return the face that each ray meets first, int64 ``[m]``, −1 for none; arguments as in the search of the tree."""
    start = start + first[:, None] * direction
    found = scene.run(start.float().cpu().numpy(), direction.float().cpu().numpy())
    return torch.from_numpy(found).to(device=start.device, dtype=torch.int64)
