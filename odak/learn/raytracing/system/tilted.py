"""Surfaces off the axis: rays into a surface's own frame, through it, and back."""

import math

import torch

from odak.learn.raytracing.system.elements import Layout, Numbers, elements
from odak.learn.raytracing.system.prescription import Prescription
from odak.learn.raytracing.system.step import State, advance
from odak.raytracing.status import RayStatus


def rows(prescription: Prescription, shape) -> tuple[torch.Tensor, torch.Tensor]:
    """Return shifts and tilts (in radians) of the surfaces and the image plane, ``[B, S, 2]``."""
    found = []
    for value in (prescription.shift, prescription.tilt):
        if value is None:
            value = torch.zeros_like(prescription.thickness)[..., None].expand(*prescription.thickness.shape, 2)
        value = value.expand(*prescription.batch, *value.shape[-2:])[..., None, :, :]
        value = value.expand(*shape[:-2], *value.shape[-2:]).reshape(math.prod(shape[:-2]), *value.shape[-2:])
        found.append(torch.nn.functional.pad(value, (0, 0, 0, 1)))
    return found[0], torch.deg2rad(found[1])


def trace(layout: Layout, numbers: Numbers, rays, shift, tilt) -> tuple:
    """Return the rays ``[B, R]`` behind the last surface, NaN where lost, in plain torch operations.

    Parameters
    ----------
    layout, numbers
        The systems.
    rays : list of torch.Tensor
        Components ``[B, R]``.
    shift, tilt : torch.Tensor
        ``[B, S, 2]``; tilts in radians about x, then about y.
    """
    finite = torch.isfinite(sum(rays))
    status = torch.where(finite, RayStatus.HIT.value, RayStatus.MISS.value).to(torch.int8)
    rays = [torch.where(finite, value, float(i == 5)) for i, value in enumerate(rays)]
    state = State(*rays, torch.zeros_like(rays[0]), status)
    dtype = rays[0].dtype
    for i, element in enumerate(elements(layout, numbers, dtype)):
        matrix = _matrix(tilt[:, i].to(dtype))
        move = [shift[:, i, axis, None].to(dtype) for axis in range(2)]
        points = (state.x - move[0], state.y - move[1], state.z - element.h)
        points, directions = _turned(matrix, points), _turned(matrix, state[3:6])
        local = advance(State(*points, *directions, *state[6:]), element._replace(h=0.0))
        back = [[matrix[b][a] for b in range(3)] for a in range(3)]
        x, y, z = _turned(back, local[:3])
        state = State(x + move[0], y + move[1], z, *_turned(back, local[3:6]), *local[6:])
    lost = state.status != RayStatus.HIT
    return (*(torch.where(lost, torch.nan, value) for value in state[:7]), state.status)


def _matrix(tilt: torch.Tensor) -> list[list[torch.Tensor]]:
    """Return the rotation into the surface's frame, as rows of ``[B, 1]``: the inverse of R_y·R_x."""
    ca, cb = (tilt[:, axis, None].cos() for axis in range(2))
    sa, sb = (tilt[:, axis, None].sin() for axis in range(2))
    return [[cb, 0 * cb, -sb], [sa * sb, ca, sa * cb], [ca * sb, -sa, ca * cb]]


def _turned(matrix, vector):
    return [sum(a * b for a, b in zip(row, vector, strict=True)) for row in matrix]
