"""Surfaces off the axis: rays into a surface's own frame, through it, and back.

Plain torch operations, block by block. What is kept for the backward pass is what came in; a block is then traced once
more, with a graph that lives no longer than the block.
"""

import math
from typing import Any

import torch

from odak.learn.raytracing.system.elements import Layout, Numbers, elements
from odak.learn.raytracing.system.prescription import Prescription
from odak.learn.raytracing.system.step import State, advance
from odak.raytracing.status import RayStatus

# Rays of a block: its graph, a few kilobytes per ray, takes some tens of megabytes.
BLOCK = 1 << 14


def rows(prescription: Prescription, shape, image=None) -> tuple[torch.Tensor, torch.Tensor]:
    """Return shifts and tilts (in radians) of the surfaces and of the image, ``[B, S + 1, 2]``."""
    found = []
    for name in ("shift", "tilt"):
        value = getattr(prescription, name)
        if value is None:
            value = torch.zeros_like(prescription.thickness)[..., None].expand(*prescription.thickness.shape, 2)
        value = value.expand(*prescription.batch, *value.shape[-2:])[..., None, :, :]
        value = value.expand(*shape[:-2], *value.shape[-2:]).reshape(math.prod(shape[:-2]), *value.shape[-2:])
        last = torch.zeros_like(value[:, 0]) if image is None else getattr(image, name).double().expand(len(value), 2)
        found.append(torch.cat([value, last[:, None]], 1))
    return found[0], torch.deg2rad(found[1])


def plain_trace(layout: Layout, *tensors: torch.Tensor) -> tuple:
    """Return the rays ``[B, R]`` behind the last surface, NaN where lost, in plain torch operations.

    Parameters
    ----------
    layout : Layout
        The systems.
    *tensors : torch.Tensor
        The six components of the rays ``[B, R]``, Numbers, and shifts and tilts ``[B, S, 2]``; tilts in radians about
        x, then about y.
    """
    rays, numbers, (shift, tilt) = tensors[:6], Numbers(*tensors[6:-2]), tensors[-2:]
    total: Any = sum(rays)
    finite = torch.isfinite(total)
    status = torch.where(finite, RayStatus.HIT.value, RayStatus.MISS.value).to(torch.int8)
    rays = [torch.where(finite, value, float(i == 5)) for i, value in enumerate(rays)]
    state = State(*(*rays, torch.zeros_like(rays[0]), status))
    dtype = rays[0].dtype
    for i, element in enumerate(elements(layout, numbers, dtype)):
        matrix = _matrix(tilt[:, i].to(dtype))
        move = [shift[:, i, axis, None].to(dtype) for axis in range(2)]
        points = (state.x - move[0], state.y - move[1], state.z - element.h)
        points, directions = _turned(matrix, points), _turned(matrix, state[3:6])
        local = advance(State(*(*points, *directions, *state[6:])), element._replace(h=0.0))
        back = [[matrix[b][a] for b in range(3)] for a in range(3)]
        x, y, z = _turned(back, local[:3])
        state = State(*(x + move[0], y + move[1], z, *_turned(back, local[3:6]), *local[6:]))
    lost = state.status != RayStatus.HIT
    return (*(torch.where(lost, torch.nan, value) for value in state[:7]), state.status)


class TiltedTrace(torch.autograd.Function):
    """All surfaces in one node of the graph; see the module."""

    @staticmethod
    def forward(layout, x, y, z, u, v, w, *numbers):
        """Return x, y, z, u, v, w, path and status ``[B, R]``; `numbers` are Numbers, shift and tilt."""
        rays = (x, y, z, u, v, w)
        parts = [plain_trace(layout, *(value[:, block] for value in rays), *numbers) for block in _blocks(x)]
        return tuple(torch.cat(values, 1) for values in zip(*parts, strict=True))

    @staticmethod
    def setup_context(ctx, inputs, output):
        """Keep what came in."""
        layout, *tensors = inputs
        ctx.layout = layout
        ctx.save_for_backward(*tensors)
        ctx.mark_non_differentiable(output[7])

    @staticmethod
    def backward(ctx, *gradients):
        """Return the gradients of rays and numbers."""
        tensors, needed = ctx.saved_tensors, ctx.needs_input_grad[1:]
        if torch.is_grad_enabled():
            # Views, so that the same tensors may be asked for at once as inputs and as part of an outer graph.
            tensors = [value.view_as(value) if need else value for value, need in zip(tensors, needed, strict=True)]
            return (None, *_pull(ctx.layout, tensors, needed, gradients[:7], True))
        rays, numbers = tensors[:6], tensors[6:]
        out = [torch.empty_like(value) if need else None for value, need in zip(rays, needed, strict=False)]
        totals = [torch.zeros_like(value) if need else None for value, need in zip(numbers, needed[6:], strict=True)]
        for block in _blocks(rays[0]):
            here = [*(value[:, block] for value in rays), *numbers]
            here = [value.detach().requires_grad_(need) for value, need in zip(here, needed, strict=True)]
            found = _pull(ctx.layout, here, needed, [value[:, block] for value in gradients[:7]], False)
            for target, value in zip(out, found[:6], strict=True):
                if target is not None:
                    target[:, block] = value
            for target, value in zip(totals, found[6:], strict=True):
                if target is not None:
                    target += value
        return (None, *out, *totals)


def _blocks(x: torch.Tensor) -> list[slice]:
    """Return the blocks of rays ``[B, R]``: one of them all on a GPU."""
    count = x.shape[1]
    step = max(1, BLOCK // max(1, x.shape[0])) if x.device.type == "cpu" else max(1, count)
    return [slice(start, start + step) for start in range(0, count, step)] or [slice(0, 0)]


def _pull(layout, tensors, needed, gradients, create_graph: bool) -> list:
    """Return the gradients of the tensors needed, None for the others."""
    wanted = [value for value, need in zip(tensors, needed, strict=True) if need]
    with torch.enable_grad():
        *values, status = plain_trace(layout, *tensors)
        lost = status != RayStatus.HIT
        weights = [torch.where(lost, 0.0, value) for value in gradients]
        pairs = [(value, weight) for value, weight in zip(values, weights, strict=True) if value.requires_grad]
        values, weights = zip(*pairs, strict=True)
        options = {"create_graph": create_graph, "allow_unused": True, "materialize_grads": True}
        found = iter(torch.autograd.grad(values, wanted, weights, **options))
    return [next(found) if need else None for need in needed]


def _matrix(tilt: torch.Tensor) -> list[list[torch.Tensor]]:
    """Return the rotation into the surface's frame, as rows of ``[B, 1]``: the inverse of R_y·R_x."""
    ca, cb = (tilt[:, axis, None].cos() for axis in range(2))
    sa, sb = (tilt[:, axis, None].sin() for axis in range(2))
    return [[cb, 0 * cb, -sb], [sa * sb, ca, sa * cb], [ca * sb, -sa, ca * cb]]


def _turned(matrix, vector):
    return [sum(a * b for a, b in zip(row, vector, strict=True)) for row in matrix]
