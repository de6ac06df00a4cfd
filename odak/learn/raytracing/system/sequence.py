"""Sequences of surfaces for blocks of rays: their numbers, their frames, and the trace in operations of the core.

A medium of graded index between two surfaces keeps no graph. Forward, rays are integrated to the next surface and only
their ends are kept. Backward, some rays at a time are integrated again, in as many steps of equal length, through which
autograd goes (Chen et al., Advances in Neural Information Processing Systems 31, 2018, compare it with the adjoint
equation).
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import torch

from odak._array import broadcast, is_readable, namespace
from odak._torch_private import is_transformed
from odak.learn.raytracing.system.crystals import UniaxialMedium
from odak.raytracing import components as vec
from odak.raytracing import interfaces
from odak.raytracing.batches import needs_gradient
from odak.raytracing.gradients import Gradient, ray_equation, step, to_surface
from odak.raytracing.intersections import RayStatus
from odak.raytracing.surfaces import Conic, EvenAsphere, Plane, Shape, intersection

# Steps of rays that are held at a time while paths are differentiated.
FLOWING = 1 << 15


def arrive(
    gradient: Gradient,
    base: torch.Tensor,
    frame: "Frame",
    point: vec.Vector,
    direction: vec.Vector,
    shape: Shape,
    sign: int,
    track: bool = False,
) -> tuple[Any, ...]:
    """Return rays at their intersections with the next surface behind a graded-index medium.

    Parameters
    ----------
    gradient : Gradient
        The medium.
    base : torch.Tensor
        Index of its material.
    frame : Frame
        Frame of the surface in the medium's frame.
    point, direction : tuple of torch.Tensor
        Rays in the medium's frame where they enter; unit directions.
    shape : Shape
        Shape of the surface.
    sign : int
        Sign of the direction cosine along z with which rays arrive.
    track : bool
        Compute the rotation of the polarisation and the length of the rays, see :func:`transported`.

    Returns
    -------
    tuple
        Points and unit directions in the frame of the surface, the index there, the optical path, which rays arrived,
        and what :func:`transported` returns, None if it is not asked for.
    """
    dtype = point[0].dtype
    place: Any = broadcast(*(value.double() for value in (*point, *direction)))
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
    carried = transported(gradient, base, start, torch.where(arrived, time, 0.0), found.steps) if track else None
    index = vec.dot(tuple(end[3:6]), tuple(end[3:6]))
    index = torch.where(index > 0, index, 1.0).sqrt()
    point, direction = frame.enter(tuple(end[:3]), tuple(end[i] / index for i in range(3, 6)))
    point, direction = (tuple(value.to(dtype) for value in part) for part in (point, direction))
    return point, direction, index.to(dtype), end[6].to(dtype), arrived, carried


def transported(gradient: Gradient, base: Any, start: Any, time: Any, count: int) -> tuple[torch.Tensor, torch.Tensor]:
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
        # The component of the curvature along the ray does not contribute to the product.
        velocity = torch.linalg.cross(change[:3] / size, change[3:6] / size, dim=0)
        columns = state[7:16].unflatten(0, (3, 3))
        rotated = torch.linalg.cross(velocity[:, None].expand_as(columns), columns, dim=0)
        return torch.cat([change, rotated.flatten(0, 1), size[None]])

    one = torch.eye(3, dtype=start.dtype, device=start.device).reshape(9, *(1,) * (start.ndim - 1))
    state = torch.cat([start, one.expand(9, *start.shape[1:]), torch.zeros_like(start[:1])])
    for _ in range(count):
        state, _ = step(field, state, time / count)
    return state[7:16].unflatten(0, (3, 3)).movedim((0, 1), (-2, -1)), state[16]


def points_within(gradient: Gradient, base: Any, rays: Any, height: Any, count: int) -> torch.Tensor:
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


def _numbers_of(frame) -> list[Any]:
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
    """States after given times: the forward result is given, the backward pass takes as many steps of equal length."""

    @staticmethod
    def forward(ctx, kind, steps, end, time, start, base, *parameters):
        ctx.kind, ctx.steps = kind, steps
        ctx.save_for_backward(time, start, base, *parameters)
        return end.clone()

    @staticmethod
    def backward(ctx, gradient):
        time, start, *numbers = ctx.saved_tensors
        needed, graph = ctx.needs_input_grad[4:], torch.is_grad_enabled()
        size = time.shape[-1] if graph or numbers[0].shape[-1] > 1 else max(64, FLOWING // ctx.steps)
        parts = [
            _flow_gradients(ctx, ends, (first, *numbers), weight, needed, graph)
            for ends, first, weight in zip(*(value.split(size, -1) for value in (time, start, gradient)), strict=True)
        ]
        starts, *others = zip(*parts, strict=True)
        totals = (sum(part) if need else None for part, need in zip(others, needed[1:], strict=True))
        return None, None, None, None, torch.cat(starts, -1) if needed[0] else None, *totals


def _flow_gradients(ctx, time, inputs, gradient, needed, graph: bool) -> list[torch.Tensor | None]:
    """Return the gradients of start, base index and parameters, of some of the rays."""
    with torch.enable_grad():
        inputs = [value.view_as(value) if graph else value.detach().requires_grad_() for value in inputs]
        field, state = ray_equation(ctx.kind(*inputs[2:]), inputs[1]), inputs[0]
        for _ in range(ctx.steps):
            state, _ = step(field, state, time / ctx.steps)
        wanted = [value for value, need in zip(inputs, needed, strict=True) if need]
        found = iter(torch.autograd.grad(state, wanted, gradient, create_graph=graph, materialize_grads=True))
    return [next(found) if need else None for need in needed]


# Shapes with parameters in `curvature`, `conic` and `coefficients`; other shapes list their parameters separately.
STANDARD = (Plane, Conic, EvenAsphere)
HIT = int(RayStatus.HIT)


class Layout(NamedTuple):
    """Properties of a sequence of surfaces that are no differentiable numbers.

    Attributes
    ----------
    kinds : tuple of type
        Class of the shape of each surface.
    actions : tuple of str
        "refract", "reflect", "pass" (the same medium on both sides) or "break" (a change of coordinates).
    signs : tuple of int
        Sign of the direction cosine along z with which rays arrive in the surface's frame.
    limits : tuple
        Apertures: a semi-diameter, an object with a method ``passes(x, y)``, or None.
    phases : tuple
        Class of the diffractive phase of each surface, or None.
    orders : tuple
        Of coordinate breaks: "shift", "tilt", or the number of the surface to whose frame the axis returns.
    media : tuple
        Class of the graded index behind each surface, or None.
    placed : bool
        Surfaces are shifted or tilted, or coordinates change.
    """

    kinds: tuple[type[Shape], ...]
    actions: tuple[str, ...]
    signs: tuple[int, ...]
    limits: tuple[Any, ...]
    phases: tuple[Any, ...] = ()
    orders: tuple[Any, ...] = ()
    media: tuple[Any, ...] = ()
    placed: bool = False

    @property
    def standard(self) -> bool:
        """Whether the fused kernel supports all of the sequence."""
        return (
            not self.placed
            and all(kind in STANDARD for kind in self.kinds)
            and not any(self.phases)
            and not any(self.media)
            and all(limit is None or isinstance(limit, float) for limit in self.limits)
        )

    def first(self, count: int) -> "Layout":
        """Return the layout of the first surfaces, the last of which is intersected but does not act."""
        parts: Any = [value[:count] for value in self[:-1]]
        last = parts[1][-1]
        parts[1] = (*parts[1][:-1], last if last == "break" else "pass")
        return Layout(*(*parts, self.placed))


class Numbers(NamedTuple):
    """Numbers of a batch of B systems of S surfaces, in float64.

    Attributes
    ----------
    curvature, conic, distance : torch.Tensor
        ``[B, S]``; `distance` is that from the vertex before (of the first surface: from the rays' plane z = 0).
    coefficients : torch.Tensor
        ``[B, S, K]`` of r², r⁴, …
    index : torch.Tensor
        ``[B, S + 1]``: before the first surface, and behind each.
    wavelength : torch.Tensor or None
        In vacuum, ``[B]``.
    shift, tilt : torch.Tensor or None
        ``[B, S, 2]`` and ``[B, S, 3]``, tilts in radians.
    others : tuple of torch.Tensor
        Parameters ``[B, …]`` of the shapes that are not standard, of phases and of graded indices, in the order of
        the surfaces.
    """

    curvature: torch.Tensor
    conic: torch.Tensor
    distance: torch.Tensor
    coefficients: torch.Tensor
    index: torch.Tensor  # type: ignore[assignment]  # hides tuple.index
    wavelength: torch.Tensor | None = None
    shift: torch.Tensor | None = None
    tilt: torch.Tensor | None = None
    others: tuple[torch.Tensor, ...] = ()

    def first(self, count: int, layout: Layout) -> "Numbers":
        """Return the numbers of the first surfaces."""
        kinds = [kind for kind in layout.kinds[:count] if kind not in STANDARD]
        kinds += [kind for given in (layout.phases, layout.media) for kind in given[:count] if kind is not None]
        others = sum(len(kind.ranks_of_parameters()) for kind in kinds)
        placed = [None if value is None else value[:, :count] for value in (self.shift, self.tilt)]
        parts: Any = [value[:, :count] for value in self[:4]]
        parts += [self.index[:, : count + 1], self.wavelength, *placed, self.others[:others]]
        return Numbers(*parts)


class State(NamedTuple):
    """Rays between two surfaces, each component a tensor of one shape.

    Attributes
    ----------
    x, y, z : torch.Tensor
        Points, from the vertex of the surface last passed.
    u, v, w : torch.Tensor
        Direction cosines.
    path : torch.Tensor
        Optical path so far.
    status : torch.Tensor
        int8, numbers of :class:`odak.raytracing.RayStatus`.
    """

    x: torch.Tensor
    y: torch.Tensor
    z: torch.Tensor
    u: torch.Tensor
    v: torch.Tensor
    w: torch.Tensor
    path: torch.Tensor
    status: torch.Tensor


def flat_arguments(layout: Layout, numbers: Numbers) -> tuple[list[torch.Tensor], list[int]]:
    """Return the numbers as tensors ``[B, 1, …]`` for :func:`plain_trace`, and how many axes follow the batch's two."""
    tensors: Any = [value[:, None] for value in numbers[:5]]
    ranks = [1, 1, 1, 2, 1]
    if layout.placed or any(layout.phases):
        tensors += [value[:, None] for value in numbers[5:8]]  # type: ignore[index]
        ranks += [0, 2, 2]
    tensors += [value[:, None] for value in numbers.others]
    return tensors, ranks + [value.ndim - 1 for value in numbers.others]


class Passage(NamedTuple):
    """Record of rays at a surface or at a coordinate break; directions are in the frame of the axis.

    Attributes
    ----------
    place : int
        Number of the surface.
    action : str
        As in :class:`Layout`, or "bend".
    incoming, outgoing, normal : tuple of torch.Tensor
        Unit vectors before and behind, and normals; along the axis for rays that are lost.
    before, behind : torch.Tensor
        Indices on both sides.
    length : torch.Tensor
        Distance from the surface before.
    point : tuple of torch.Tensor
        Where the rays meet the surface, in its own frame.
    status : torch.Tensor
        What befell the rays up to and at the surface.
    change : Frame or tuple, optional
        For a break, the change of the frame. For a "bend", the path through a graded medium: the frame of the axis in
        the medium's frame, and rotations of the field ``[..., 3, 3]`` in the latter.
    """

    place: int
    action: str
    incoming: tuple[Any, ...] = ()
    outgoing: tuple[Any, ...] = ()
    normal: tuple[Any, ...] = ()
    before: Any = None
    behind: Any = None
    length: Any = None
    change: Any = None
    point: tuple[Any, ...] = ()
    status: Any = None


def plain_trace(layout: Layout, *tensors: Any, record: Callable[..., Any] | None = None) -> State:
    """Return rays behind the last surface; those that fail lie on the axis.

    Parameters
    ----------
    layout : Layout
        The sequence.
    *tensors : torch.Tensor or numpy.ndarray
        The six components of the rays ``[B, R]``, and what :func:`flat_arguments` returns; all of one library.
    record : callable, optional
        Called with the :class:`Passage` of each surface and coordinate break.

    Notes
    -----
    Every surface takes the same step as a single one: :func:`odak.raytracing.surfaces.intersection`, then
    :func:`odak.raytracing.interfaces.refracted` or a related function. Failed rays continue along the axis, so that no
    NaN enters a gradient.
    """
    walk = _Walk(layout, tensors[:6], tensors[6:], record)
    for i in range(len(layout.kinds)):
        walk.pass_element(i)
    held: Any = (*walk.point, *walk.direction, walk.path, walk.status)
    return State(*held)


class _Walk:
    """Rays on their way through a sequence: where they are, what befell them, and the graded medium they are in.

    One method for each kind of event. Failed rays lie on the axis: :meth:`_fail` keeps the first event of each.
    """

    def __init__(self, layout: Layout, rays, numbers, record):
        self.layout, self.record, self.dtype = layout, record, rays[0].dtype
        xp = self.xp = namespace(rays[0])
        self.curvature, self.conic, self.distance, self.coefficients, self.index, *rest = (
            xp.astype(value, self.dtype, copy=False) for value in numbers
        )
        self.wavelength = self.shift = self.tilt = None
        if layout.placed or any(layout.phases):
            self.wavelength, self.shift, self.tilt, *rest = rest
        self.others = iter(rest)
        total: Any = sum(rays)
        status = xp.where(xp.isfinite(total), HIT, int(RayStatus.MISS))
        # Rays that could not be aimed have infinite direction cosines.
        status = xp.astype(xp.where(xp.isinf(rays[5]), int(RayStatus.NOT_AIMED), status), xp.int8)
        x, y, z, u, v, w = (xp.where(status == HIT, value, float(i == 5)) for i, value in enumerate(rays))
        self.point, self.direction = (x, y, z), (u, v, w)
        self.path = xp.zeros_like(x + self.distance[..., 0])
        self.status = xp.broadcast_to(status, self.path.shape)
        self.frames = Frames() if any(isinstance(order, int) for order in layout.orders) else None
        self.medium: Graded | None = None
        # Wave normals and their indices at the end of a crystal, where rays run in other directions.
        self.wave: tuple[Any, Any] | None = None

    def pass_element(self, i: int) -> None:
        """Take the rays to a surface and past it, or into the frame of a coordinate break."""
        layout, place = self.layout, None
        shape = _shape(
            layout.kinds[i], self.curvature[..., i], self.conic[..., i], self.coefficients[..., i, :], self.others
        )
        phase, gradient = (
            _rebuilt(given[i], self.others) if given else None for given in (layout.phases, layout.media)
        )
        self._advance(self.distance[..., i])
        if layout.placed:
            place = placement(self.shift[..., i, :], self.tilt[..., i, :], layout.orders[i])  # type: ignore[index]
        if layout.actions[i] == "break":
            self._change_frame(i, place)
            return
        if place is not None and self.medium is None:
            self.point, self.direction = place.enter(self.point, self.direction)
        if self.frames is not None:
            self.frames.append()
        before = self.index[..., i] if self.medium is None else self._bend(i, self.medium, shape, place)
        found = self._meet(i, shape, before)
        if self.wave is not None:
            (wave, before), self.wave = self.wave, None
            self.direction = self._on_axis(layout.signs[i], self.point, wave)[1]
        self._limit(layout.limits[i])
        incoming, behind, normal = self.direction, self.index[..., i + 1], None
        if layout.actions[i] != "pass" or phase is not None:
            normal = self._on_axis(1, self.point, found.normal)[1]
            behind = self._turn(i, normal, before, behind, phase, gradient, place)
        if self.record is not None:
            normal = self._on_axis(1, self.point, found.normal)[1] if normal is None else normal
            self._report(i, (incoming, self.direction, normal), before, behind, found.distance, place)
        if place is not None:
            self.point, self.direction = place.leave(self.point, self.direction)
        self._enter_medium(i, gradient)

    def _fail(self, good, event) -> None:
        """Set the statuses after an event: the first event of a ray is kept."""
        event = int(event) if isinstance(event, RayStatus) else event
        failed = (self.status == HIT) & ~good
        self.status = self.xp.astype(self.xp.where(failed, event, self.status), self.xp.int8)

    def _on_axis(self, sign: int, point, direction):
        """Return points and directions; failed rays are put at the vertex, along the axis."""
        kept, where = self.status == HIT, self.xp.where
        x, y, z, u, v = (where(kept, value, 0.0) for value in (*point, *direction[:2]))
        return (x, y, z), (u, v, where(kept, direction[2], float(sign)))

    def _advance(self, distance) -> None:
        """Move the origin along the axis to the next vertex."""
        if self.medium is None:
            x, y, z = self.point
            self.point = (x, y, z - distance)
        else:
            self.medium = self.medium.further(distance)
        if self.frames is not None:
            self.frames.move(distance)

    def _change_frame(self, i: int, place) -> None:
        """Enter the frame of a coordinate break."""
        if self.frames is not None:
            place = self.frames.change(place, self.layout.orders[i])
        if self.record is not None:
            self.record(Passage(i, "break", change=place))
        if self.medium is None:
            self.point, self.direction = place.enter(self.point, self.direction)
        else:
            self.medium = self.medium._replace(frame=self.medium.frame.then(place))

    def _bend(self, i: int, medium: "Graded", shape: Shape, place):
        """Follow the rays through a graded medium to a surface, or turn to the rays of a crystal; return the index."""
        here = medium.frame if place is None else medium.frame.then(place)
        if isinstance(medium.gradient, UniaxialMedium):
            if self.record is not None or self.layout.actions[i] == "reflect":
                what = "reflects within" if self.layout.actions[i] == "reflect" else "is met by polarised rays of"
                raise ValueError(f"surfaces[{i}] {what} a UniaxialMedium, which is not computed")
            ray, slowness, index = medium.gradient.ray(self.direction, medium.base)
            self.wave = here.enter(self.point, self.direction)[1], index
            self.point, self.direction = here.enter(self.point, ray)
            return slowness
        sign, track = self.layout.signs[i], self.record is not None
        curved = arrive(medium.gradient, medium.base, here, self.point, self.direction, shape, sign, track)
        self.point, self.direction, index, length, arrived, carried = curved
        self._fail(arrived, RayStatus.NOT_CONVERGED)
        self.path = self.path + self.xp.where(self.status == HIT, length, 0.0)
        if self.record is not None and carried is not None:
            self.record(Passage(i, "bend", change=(medium.frame, carried[0]), length=carried[1]))
        return index

    def _meet(self, i: int, shape: Shape, index):
        """Intersect the rays with a surface, and return what :func:`intersection` found."""
        sign = self.layout.signs[i]
        # Rays of fields beyond 90 degrees meet the first surface from its front, though they run against the axis.
        first, least = i == 0 and sign > 0, 64 * float(self.xp.finfo(self.dtype).eps)
        if not first:
            # A ray must arrive from the side that its surface is passed from.
            self._fail(self.direction[2] * sign > least, RayStatus.MISS)
        point, self.direction = self._on_axis(sign, self.point, self.direction)
        found, state = intersection(point, self.direction, shape, None, "forward" if first else "through")
        self._fail(found.hit, state)
        if first:
            across = sum(a * b for a, b in zip(found.normal, self.direction, strict=True))
            self._fail(across > least, RayStatus.MISS)
        self.path = self.path + index * self.xp.where(self.status == HIT, found.distance, 0.0)
        self.point, self.direction = self._on_axis(sign, found.point, self.direction)
        return found

    def _limit(self, limit) -> None:
        """Stop the rays outside an aperture."""
        if limit is not None:
            x, y = self.point[:2]
            inside = x * x + y * y <= limit * limit if isinstance(limit, float) else limit.passes(x, y)
            self._fail(inside, RayStatus.VIGNETTED)

    def _turn(self, i: int, normal, before, behind, phase, gradient, place):
        """Refract, reflect or diffract the rays; return the index on the side to which they go."""
        mirror, direction = self.layout.actions[i] == "reflect", self.direction
        behind = before if mirror else behind
        crystal = isinstance(gradient, UniaxialMedium)
        if gradient is not None and not crystal:
            vertex = self.point if place is None else place.leave(self.point, direction)[0]
            squared = gradient.squared(*vertex, behind)[0]
            behind = torch.where(squared > 0, squared, 1.0).sqrt()
        if phase is not None:
            covered = phase.covers(*self.point[:2])
            if covered is not True:
                self._fail(covered, RayStatus.VIGNETTED)
            wave: Any = self.wavelength
            direction, through, extra = phase.deflect(self.point, direction, normal, before, behind, wave, mirror)
            self.path = self.path + self.xp.where(self.status == HIT, extra, 0.0)
        elif mirror:
            direction, through = interfaces.reflected(direction, normal), self.xp.ones_like(self.status == HIT)
        elif crystal:
            ways = (
                (direction, normal) if place is None else (place.leave(self.point, w)[1] for w in (direction, normal))
            )
            direction, through, behind = gradient.refracted(*ways, before, behind)
            direction = direction if place is None else place.enter(self.point, direction)[1]
        else:
            direction, through, _ = interfaces.refracted(direction, normal, before, behind)
        self._fail(through, RayStatus.TOTAL_INTERNAL_REFLECTION)
        sign = self.layout.signs[i]
        self.point, self.direction = self._on_axis(-sign if mirror else sign, self.point, direction)
        return behind

    def _report(self, i: int, ways, before, behind, distance, place) -> None:
        """Record the passage of a surface, directions in the frame of the axis."""
        one, two, normal = ways if place is None else (place.leave(self.point, way)[1] for way in ways)
        length, action = torch.where(self.status == HIT, distance, 0.0), self.layout.actions[i]
        self.record(Passage(i, action, one, two, normal, before, behind, length, None, self.point, self.status))

    def _enter_medium(self, i: int, gradient) -> None:
        """Enter the medium behind a surface, a graded one or not."""
        if gradient is not None:
            self.medium = Graded(gradient, self.index[..., i + 1], IDENTITY)
        elif self.medium is not None and self.layout.actions[i] == "reflect":
            self.point, self.direction = self.medium.frame.leave(self.point, self.direction)
        else:
            self.medium = None


def _shape(kind, curvature, conic, coefficients, others) -> Shape:
    if kind is Plane:
        return Plane()
    if kind is Conic:
        return Conic(curvature, conic)
    if kind is EvenAsphere:
        return EvenAsphere(curvature, conic, coefficients)
    return _rebuilt(kind, others)


def _rebuilt(kind, others):
    return None if kind is None else kind(*(next(others) for _ in kind.ranks_of_parameters()))


class Frame(NamedTuple):
    """A frame: rotation as rows of components, and the position of its origin in the outer frame.

    Attributes
    ----------
    matrix : list of list
        Columns are the axes of the frame: p = matrix·p_local + origin.
    origin : tuple
        Components.
    """

    matrix: Any
    origin: tuple[Any, ...]

    def enter(self, point: Any, direction: Any) -> Any:
        """Return points and directions in this frame."""
        point = vec.minus(point, self.origin)
        return tuple(vec.dot(column, point) for column in _columns(self.matrix)), tuple(
            vec.dot(column, direction) for column in _columns(self.matrix)
        )

    def leave(self, point: Any, direction: Any) -> Any:
        """Return points and directions of this frame in the outer frame."""
        rotated = tuple(vec.dot(row, point) for row in self.matrix)
        point = tuple(a + b for a, b in zip(rotated, self.origin, strict=True))
        return point, tuple(vec.dot(row, direction) for row in self.matrix)

    def then(self, other: "Frame") -> "Frame":
        """Return the frame `other`, which is given in this one, in the outer frame."""
        origin, _ = self.leave(other.origin, other.origin)
        return Frame(_product(self.matrix, other.matrix), origin)

    def inverse(self) -> "Frame":
        """Return the outer frame in the coordinates of this one."""
        origin, _ = self.enter((0.0, 0.0, 0.0), self.origin)
        return Frame(_columns(self.matrix), origin)


IDENTITY = Frame([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], (0.0, 0.0, 0.0))


class Graded(NamedTuple):
    """The graded-index medium that rays are in.

    Attributes
    ----------
    gradient : Gradient
        The medium.
    base : torch.Tensor
        Index of its material.
    frame : Frame
        Frame of the axis, up to the present surface, in the medium's frame, in which the rays are held.
    """

    gradient: Any
    base: torch.Tensor
    frame: Frame

    def further(self, distance: Any) -> "Graded":
        """Return the medium with the frame moved along the axis."""
        return self._replace(frame=self.frame.then(Frame(IDENTITY.matrix, (0.0, 0.0, distance))))


class Frames:
    """Frames of the axis at the surfaces of a sequence, in the frame of the first vertex."""

    def __init__(self):
        self.here: Frame = IDENTITY
        self.found: list[Frame] = []

    def move(self, distance: torch.Tensor) -> None:
        """Move the frame along the axis."""
        self.here = self.here.then(Frame(IDENTITY.matrix, (0.0, 0.0, distance)))

    def append(self) -> None:
        """Append the frame of a surface."""
        self.found.append(self.here)

    def change(self, place: Frame, order: Any) -> Frame:
        """Change to the frame of a coordinate break, or back to the frame of an earlier surface; return the change."""
        if isinstance(order, int):
            place = self.here.inverse().then(self.found[order])
        self.here = self.here.then(place)
        self.found.append(self.here)
        return place


def placement(shift: torch.Tensor, tilt: torch.Tensor, order: int | str | None = None) -> Frame:
    """Return the frame of a surface or of a coordinate break.

    Parameters
    ----------
    shift, tilt : array
        ``[..., 2]`` along x and y, ``[..., 3]`` in radians about x, y, z.
    order : str or None
        None for a surface: rotation about its own z, then about the fixed x, then the fixed y axis; then shifted. For a
        coordinate break "shift": shifted, then rotated about x, the new y and the new z. "tilt": rotated about z, the
        new y and the new x, then shifted along the new axes.
    """
    (ca, cb, cc), (sa, sb, sc) = (_split(value) for value in (tilt.cos(), tilt.sin()))
    rx = [[1.0, 0.0, 0.0], [0.0, ca, -sa], [0.0, sa, ca]]
    ry = [[cb, 0.0, sb], [0.0, 1.0, 0.0], [-sb, 0.0, cb]]
    rz = [[cc, -sc, 0.0], [sc, cc, 0.0], [0.0, 0.0, 1.0]]
    first, second, third = (ry, rx, rz) if order is None else (rz, ry, rx) if order == "tilt" else (rx, ry, rz)
    matrix = _product(_product(first, second), third)
    origin = (*_split(shift), 0.0)
    if order == "tilt":
        origin = tuple(vec.dot(row, origin) for row in matrix)
    return Frame(matrix, origin)


def _split(value) -> tuple[Any, ...]:
    return tuple(value.unbind(-1))


def _columns(matrix) -> list[Any]:
    return [list(column) for column in zip(*matrix, strict=True)]


def _product(a, b) -> list[Any]:
    return [[vec.dot(row, column) for column in _columns(b)] for row in a]


def axis_signs(
    shift: torch.Tensor, tilt: torch.Tensor, actions: Sequence[Any], orders: Sequence[Any], distances: torch.Tensor
) -> list[int] | None:
    """Return the signs with which the axis arrives at the surfaces, followed through mirrors and coordinate breaks.

    Parameters
    ----------
    shift, tilt : torch.Tensor
        ``[S, 2]`` and ``[S, 3]`` of one system; None is returned if they cannot be read.
    actions, orders : sequence
        As in :class:`Layout`.
    distances : torch.Tensor
        ``[S]``.

    Raises
    ------
    ValueError
        If the axis runs along a surface, or a tilted mirror turns it away from the surfaces behind without a
        coordinate break.
    """
    if not all(is_readable(value) for value in (shift, tilt, distances)):
        return None
    shift, tilt = shift.detach().double().cpu(), tilt.detach().double().cpu()
    direction: Any = (torch.tensor(0.0), torch.tensor(0.0), torch.tensor(1.0, dtype=torch.float64))
    frames, signs, parity, broken = Frames(), [], 1, False
    for i, action in enumerate(actions):
        frames.move(distances[i].detach().double().cpu())
        place = placement(shift[i], tilt[i], orders[i])
        if action == "break":
            place, broken = frames.change(place, orders[i]), True
            _, direction = place.enter(direction, direction)
            signs.append(1)
            continue
        frames.append()
        _, local = place.enter(direction, direction)
        along = float(local[2])
        if abs(along) < 1e-3 or (not broken and along * parity < 0):
            raise ValueError(
                f"surfaces[{i}] is not met by the axis, which tilted mirrors in front of it turn by 90 degrees or "
                "more: put a coordinate_break behind each fold, and one in front of it"
            )
        signs.append(1 if along > 0 else -1)
        if action == "reflect":
            parity = -parity
            local = (local[0], local[1], -local[2])
        _, direction = place.leave(local, local)
    return signs
