"""Rays between two surfaces through a medium of graded index, with an adjoint of constant memory.

Forward, rays are integrated to the next surface and only their ends are kept. Backward, the ray is integrated from its
end to its start together with the derivatives of the result by its state, da/dt = −(∂f/∂y)ᵀa; the derivatives by the
medium's numbers are the integrals of aᵀ∂f/∂θ (Chen et al., Advances in Neural Information Processing Systems 31, 2018).
"""

from typing import Any

import torch

from odak._torch_private import is_transformed
from odak.raytracing import components as vec
from odak.raytracing.batches import needs_gradient
from odak.raytracing.gradients import Gradient, integrate, ray_equation, stage, step, tableau, to_surface
from odak.raytracing.surfaces import Shape


def arrive(gradient: Gradient, base, frame, point, direction, shape: Shape, sign: int, turns: bool = False) -> tuple:
    """Return rays at their intersections with the next surface behind a graded-index medium.

    Parameters
    ----------
    gradient : Gradient
        The medium.
    base : torch.Tensor
        Index of its material.
    frame : Frame
        Frame of the surface in that of the medium.
    point, direction : tuple of torch.Tensor
        Rays in the medium's frame where they enter; unit directions.
    shape : Shape
        Shape of the surface.
    sign : int
        Sign of the direction cosine along z with which rays arrive.
    turns : bool
        Find out how polarisation turns and how far rays go, see :func:`transported`.

    Returns
    -------
    tuple
        Points and unit directions in the frame of the surface, the index there, the optical path, which rays arrived,
        and what :func:`transported` returns, None if it is not asked for.
    """
    dtype = point[0].dtype
    place: Any = torch.broadcast_tensors(*(value.double() for value in (*point, *direction)))
    base = base.double()
    x, y, z = place[:3]
    value = gradient.squared(x, y, z, base)[0]
    exists = value.detach() > 0
    index = torch.where(exists, value, 1.0).sqrt()
    start = torch.stack([x, y, z, *(index * part for part in place[3:]), torch.zeros_like(index)])

    def level(at, way):
        x, y, z = at
        (x, y, z), (u, v, w) = frame.enter((x, y, z), way)
        here = shape.sag(x, y)
        size = x.abs() + y.abs() + z.abs() + here.height.abs() + at[2].abs()
        return z - here.height, w - here.slope_x * u - here.slope_y * v, size

    numbers = (base, *gradient.parameters())
    if is_transformed(start, *numbers):
        found = to_surface(gradient, base, start, level, sign)
        end, arrived, time = found.state, found.arrived, found.time
    else:
        with torch.no_grad():
            fixed = type(gradient)(*(value.detach() for value in gradient.parameters()))
            found = to_surface(fixed, base.detach(), start.detach(), level, sign)
        arrived = found.arrived
        end = torch.where(arrived, found.state, start.detach())
        time = torch.where(arrived, found.time, 0.0)
        if needs_gradient(start, *numbers):
            end = _Flow.apply(type(gradient), found.steps, end, time, start, *numbers)
    if needs_gradient(start, *numbers, *shape.parameters(), *_numbers_of(frame)):
        # The time of arrival moves with the ray and the surface: two steps of Newton's method that gradients follow.
        field = ray_equation(gradient, base)
        for _ in range(2):
            error, slope, _ = level(tuple(end[:3]), tuple(end[3:6]))
            usable = arrived & (slope != 0)
            late = torch.where(usable, -error, 0.0) / torch.where(usable, slope, 1.0)
            end, time = _short_step(field, end, late), time + late
    arrived = arrived & exists
    carried = transported(gradient, base, start, torch.where(arrived, time, 0.0), found.steps) if turns else None
    index = vec.dot(tuple(end[3:6]), tuple(end[3:6]))
    index = torch.where(index > 0, index, 1.0).sqrt()
    point, direction = frame.enter(tuple(end[:3]), tuple(end[i] / index for i in range(3, 6)))
    point, direction = (tuple(value.to(dtype) for value in part) for part in (point, direction))
    return point, direction, index.to(dtype), end[6].to(dtype), arrived, carried


def transported(gradient: Gradient, base, start, time, count: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Return the rotation of the field of a wave along curved rays, and the length of the rays.

    Parameters
    ----------
    gradient : Gradient
        The medium.
    base : torch.Tensor
        Index of its material.
    start : torch.Tensor
        States of :func:`ray_equation` where the rays begin, ``[7, ...]``.
    time : torch.Tensor
        Parameter t at their ends.
    count : int
        Steps of equal length.

    Returns
    -------
    tuple of torch.Tensor
        Rotations ``[..., 3, 3]`` in the coordinates of the medium, and lengths ``[...]``.

    Notes
    -----
    Rytov's law: the field stays perpendicular to the ray and does not rotate about it, dE/ds = −(E·dk/ds)·k (Born and
    Wolf, Principles of Optics, 7th edition (1999), section 3.1.3). The rotation has the angular velocity k × dk/ds.
    """
    rays = ray_equation(gradient, base)

    def field(state):
        change = rays(state[:7])
        size = change[6].clamp_min(1e-300).sqrt()
        # The component of the bend along the ray drops out of the product.
        velocity = torch.linalg.cross(change[:3] / size, change[3:6] / size, dim=0)
        columns = state[7:16].unflatten(0, (3, 3))
        turned = torch.linalg.cross(velocity[:, None].expand_as(columns), columns, dim=0)
        return torch.cat([change, turned.flatten(0, 1), size[None]])

    one = torch.eye(3, dtype=start.dtype, device=start.device).reshape(9, *(1,) * (start.ndim - 1))
    state = torch.cat([start, one.expand(9, *start.shape[1:]), torch.zeros_like(start[:1])])
    for _ in range(count):
        state, _ = step(field, state, time / count)
    return state[7:16].unflatten(0, (3, 3)).movedim((0, 1), (-2, -1)), state[16]


def points_within(gradient: Gradient, base, rays, height, count: int) -> torch.Tensor:
    """Return points of curved rays at equal steps of t up to where z is `height`, ``[count + 1, 3, ...]``."""
    x, y, z = rays[:3]
    index = gradient.squared(x, y, z, base)[0].sqrt()
    state = torch.stack([x, y, z, *(index * part for part in rays[3:]), torch.zeros_like(index)])

    def level(point, way):
        return point[2] - height, way[2], point[2].abs() + height.abs() + 1e-300

    time = to_surface(gradient, base, state, level, 1).time
    found = [state[:3]]
    for _ in range(count):
        state, _ = step(ray_equation(gradient, base), state, time / count)
        found.append(state[:3])
    return torch.stack(found)


def _numbers_of(frame) -> list:
    held = [value for row in frame.matrix for value in row] + list(frame.origin)
    return [value for value in held if isinstance(value, torch.Tensor)]


def _short_step(field, state, length):
    """Return states after a step of Runge and Kutta's method of order 4."""
    first = field(state)
    second = field(state + length / 2 * first)
    third = field(state + length / 2 * second)
    fourth = field(state + length * third)
    return state + length / 6 * (first + 2 * (second + third) + fourth)


class _Flow(torch.autograd.Function):
    """States after given times: the forward result is given, the backward pass integrates the adjoint equation."""

    @staticmethod
    def forward(ctx, kind, steps, end, time, start, base, *parameters):
        ctx.kind, ctx.steps = kind, steps
        ctx.save_for_backward(end, time, start, base, *parameters)
        return end.clone()

    @staticmethod
    def backward(ctx, gradient):
        end, time, start, base, *parameters = ctx.saved_tensors
        needed = ctx.needs_input_grad[4:]
        if torch.is_grad_enabled():
            found = _differentiable_gradients(ctx, time, start, base, parameters, gradient, needed)
        else:
            found = _adjoint(ctx.kind, end, time, base, parameters, gradient, needed)
        return None, None, None, None, *found


def _differentiable_gradients(ctx, time, start, base, parameters, gradient, needed) -> list:
    """Return the gradients as differentiable tensors: by autograd through as many steps of equal length."""
    inputs = [value.view_as(value) for value in (start, base, *parameters)]
    field, state = ray_equation(ctx.kind(*inputs[2:]), inputs[1]), inputs[0]
    for _ in range(ctx.steps):
        state, _ = step(field, state, time / ctx.steps)
    wanted = [value for value, need in zip(inputs, needed, strict=True) if need]
    found = iter(torch.autograd.grad(state, wanted, gradient, create_graph=True, allow_unused=True))
    return [next(found) if need else None for need in needed]


def _adjoint(kind, end, time, base, parameters, gradient, needed) -> list:
    """Return the gradients of start, base index and parameters."""
    numbers = [value.detach() for value in (base, *parameters)]
    totals = [torch.zeros_like(value) for value in numbers]
    weight = gradient[6]

    def product(state, place, given):
        """Return aᵀf but for the part that depends on the direction alone, and the derivatives of n²."""
        value, *slopes = kind(*given[1:]).squared(*place, given[0])
        return weight * value + sum(state[i + 9] * slope / 2 for i, slope in enumerate(slopes)), slopes

    def field(state):
        with torch.enable_grad():
            place = [value.detach().requires_grad_() for value in state[:3]]
            total, slopes = product(state, place, numbers)
            found = torch.autograd.grad(total.sum(), place, allow_unused=True)
        change = [torch.zeros_like(p) if f is None else f for p, f in zip(place, found, strict=True)]
        # Backwards in t: the ray retraces its path.
        back = [-value for value in state[3:6]] + [-slope.detach() / 2 for slope in slopes]
        return torch.stack([*torch.broadcast_tensors(*back, *change, *state[6:9])])

    def collect(state, stages, lengths):
        """Add the contribution of a step to the derivatives by the numbers."""
        for row, share in enumerate(tableau().B):
            if share:
                here = stage(state, lengths, stages, row)
                with torch.enable_grad():
                    given = [value.requires_grad_() for value in map(torch.Tensor.detach, numbers)]
                    total, _ = product(here, list(here[:3]), given)
                    found = torch.autograd.grad(total, given, lengths * float(share), allow_unused=True)
                for whole, change in zip(totals, found, strict=True):
                    if change is not None:
                        whole += change

    def remaining(state, now):
        rest = time - now
        return rest, rest.abs() <= 4 * torch.finfo(rest.dtype).eps * time.abs()

    state = torch.cat([end[:6], gradient[:6]])
    size = [state[i : i + 3].abs().amax(0) for i in range(0, 12, 3)]
    largest = float(torch.stack(size[2:]).max()) if size[2].numel() else 0.0
    size[2:] = [value.clamp(min=1e-6 * largest) for value in size[2:]]
    scale = torch.stack([value + 1e-300 for value in size for _ in range(3)])
    found = integrate(field, state, scale, remaining, collect if any(needed[1:]) else None)
    start = torch.cat([found.state[6:12], gradient[6:7]])
    return [value if need else None for value, need in zip((start, *totals), needed, strict=True)]
