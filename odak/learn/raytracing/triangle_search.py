"""Search for the nearest triangle ahead of rays: a bounding volume hierarchy, Embree, and hits with gradients."""

import importlib.util
from typing import Any, NamedTuple

import torch

from odak.raytracing import arguments, geometry, intersections
from odak.raytracing.geometry import (
    edge_areas,
    encloses,
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
    tree: Tree, start: torch.Tensor, direction: torch.Tensor, first: torch.Tensor, leaving, memory_budget: int
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
    # Of −0, too: its box is entered by the far side.
    octant = (slope < 0).mul(torch.tensor([[1], [2], [4]], device=slope.device)).sum(dim=0)
    slabs = torch.cat((slope, -start.float() * slope, first.float()[None]))
    turn = turn_of(axis)
    start, direction = turned(start, turn), turned(direction, turn)
    return Beam(start, torch.stack((*shear_of(direction), direction[2])), axis, octant, slabs, first, leaving)


def dominant_axis(direction: torch.Tensor) -> torch.Tensor:
    """Return which component of directions ``[3, m]`` is the largest, int64 ``[m]``; of equal ones the first."""
    x, y, z = direction.detach().abs()
    second, third = y > x, z > torch.maximum(x, y)
    return torch.maximum(second.long(), 2 * third.long())


def turn_of(axis: torch.Tensor) -> torch.Tensor:
    """Return the places in flat components ``[3·m]`` with the component `axis`, ``[m]``, last, in cyclic order.

    A choice of components by torch.where takes several times as long.
    """
    count = len(axis)
    first = torch.where(axis == 2, 0, axis + 1)
    second = 3 - axis - first
    return (torch.stack((first, second, axis)) * count + torch.arange(count, device=axis.device)).reshape(-1)


def turned(vectors: torch.Tensor, turn: torch.Tensor) -> torch.Tensor:
    """Return vectors ``[3, m]`` with their components in the order of :func:`turn_of`."""
    return vectors.reshape(-1).index_select(0, turn).reshape(3, -1)


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


def components(rays: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Return starts and directions ``[3, m]`` of rays ``[m, 2, 3]``, and which are rays ``[m]``.

    What is not finite or has no direction is replaced: no gradient of other rays turns NaN by it.
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


def evaluate(frame: Frame, table: torch.Tensor, faces: torch.Tensor, normals, start, direction, face, shift) -> MeshHit:
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
    turn = turn_of(dominant_axis(direction))
    chosen = face.clamp(min=0)
    *corners, normal = torch.stack(table.index_select(0, chosen).unbind(1)).unflatten(0, (4, 3))
    along, near = turned(direction, turn), turned(near, turn)
    seen = [sheared(turned(corner, turn), near, shear_of(along)) for corner in corners]
    areas = edge_areas(*seen)
    total = areas[0] + areas[1] + areas[2]
    hit = (face >= 0) & (total != 0)
    weights = torch.stack(areas) / torch.where(hit, total, 1.0)
    reach = (weights[0] * seen[0][2] + weights[1] * seen[1][2] + weights[2] * seen[2][2]) / along[2]
    distance = (shift + reach.double() / frame.scale).to(near.dtype)
    place = weights[0] * corners[0] + weights[1] * corners[1] + weights[2] * corners[2]
    point = (place.double() / frame.scale + frame.centre[:, None]).to(near.dtype)
    if normals is not None:
        known, shares = torch.where(hit[:, None, None], normals[faces[chosen]], 1.0), torch.where(hit, weights, 1.0)
        normal = geometry.unit((shares.t()[..., None] * known).sum(dim=1)).t()
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


EMBREE_HINT = "backend 'embree' needs the package embreex: pip install odak[mesh]"


def has_embree() -> bool:
    """Return whether embreex can be imported."""
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
    start = start + first * direction
    found = scene.run(_rows(start.float()).cpu().numpy(), _rows(direction.float()).cpu().numpy())
    return torch.from_numpy(found).to(device=start.device, dtype=torch.int64)
