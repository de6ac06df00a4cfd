"""The nearest triangle ahead of each ray: all rays go down the tree together, and only what they pierce goes on."""

from typing import NamedTuple

import torch

from odak.learn.raytracing.triangle_tree import BRANCHES, Tree
from odak.raytracing.watertight import edge_areas, encloses, frame_order, shear_of, sheared

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
    # A ray outside the unit sphere at its nearest point meets nothing.
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
            best, face = _nearest_leaf_first(tree, beam, best, face, ray, node, entry)
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


def _nearest_leaf_first(tree: Tree, beam: Beam, best, face, ray, node, entry):
    """Return the best distances and faces after the leaves of a list, the leaf that each ray enters first up front."""
    earliest = torch.full_like(best, torch.inf, dtype=entry.dtype).scatter_reduce_(0, ray, entry, "amin")
    up_front = entry <= earliest.index_select(0, ray)
    best, face = _leaves(tree, beam, best, face, ray, node, up_front)
    return _leaves(tree, beam, best, face, ray, node, ~up_front & (entry <= best.index_select(0, ray).float()))


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
