"""Apertures of surfaces: circles, ellipses, rectangles and polygons that pass or obscure rays."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any, ClassVar

from odak import _validate
from odak._array import Array

_ORIGIN = (0.0, 0.0)


@dataclass(frozen=True)
class Aperture:
    """Base class of apertures: a region of the x–y plane that transmits rays, or obscures them.

    Parameters
    ----------
    center : sequence of float
        Its centre (x, y).
    obscures : bool
        Block the rays inside instead of those outside.
    """

    center: Sequence[float] = _ORIGIN
    obscures: bool = False
    sizes: ClassVar[tuple[str, ...]] = ()

    def __post_init__(self) -> None:
        for name in self.sizes:
            object.__setattr__(self, name, _validate.constant(name, getattr(self, name), positive=True))
        center = tuple(float(value) for value in _validate.several("center", self.center, 2))
        object.__setattr__(self, "center", center)
        object.__setattr__(self, "obscures", _validate.flag("obscures", self.obscures))

    def passes(self, x: Array, y: Array) -> Array:
        """Return whether rays at points x, y pass, bool."""
        inside = self.contains(x - self.center[0], y - self.center[1])
        return ~inside if self.obscures else inside

    def contains(self, x: Array, y: Array) -> Array:
        """Return whether points x, y, relative to the centre, lie in the region, bool."""
        raise NotImplementedError(f"{type(self).__name__} must define contains(x, y)")

    def reach(self) -> float:
        """Return the largest distance of the region from the origin; 0 for an obscuration, which limits nothing."""
        return 0.0 if self.obscures else math.hypot(*self.center) + max(math.hypot(*point) for point in self.outline())

    def outline(self, count: int = 64) -> list[tuple[float, float]]:
        """Return points of the edge, relative to the centre."""
        raise NotImplementedError(f"{type(self).__name__} must define outline(count)")

    def scaled(self, factor: float) -> "Aperture":
        """Return the aperture with all lengths multiplied by a factor."""
        values = {field.name: _scaled(getattr(self, field.name), factor) for field in fields(self)}
        return type(self)(**values)


def _scaled(value, factor: float):
    if isinstance(value, bool):
        return value
    return tuple(_scaled(item, factor) for item in value) if isinstance(value, (tuple, list)) else value * factor


@dataclass(frozen=True)
class EllipticAperture(Aperture):
    """An ellipse with its axes along x and y.

    Parameters
    ----------
    center : sequence of float
        Its centre (x, y).
    obscures : bool
        Block the rays inside instead of those outside.
    half_width, half_height : float
        Half axes along x and y.
    """

    half_width: float = 1.0
    half_height: float = 1.0
    sizes: ClassVar[tuple[str, ...]] = ("half_width", "half_height")

    def contains(self, x: Array, y: Array) -> Array:
        """Return whether points lie in the ellipse."""
        return (x / self.half_width) ** 2 + (y / self.half_height) ** 2 <= 1

    def outline(self, count: int = 64) -> list[tuple[float, float]]:
        """Return points of the ellipse."""
        angles = (2 * math.pi * i / count for i in range(count))
        return [(self.half_width * math.cos(angle), self.half_height * math.sin(angle)) for angle in angles]


@dataclass(frozen=True)
class RectangularAperture(EllipticAperture):
    """A rectangle with its sides along x and y.

    Parameters
    ----------
    center : sequence of float
        Its centre (x, y).
    obscures : bool
        Block the rays inside instead of those outside.
    half_width, half_height : float
        Half sides along x and y.
    """

    def contains(self, x: Array, y: Array) -> Array:
        """Return whether points lie in the rectangle."""
        return (abs(x) <= self.half_width) & (abs(y) <= self.half_height)

    def outline(self, count: int = 64) -> list[tuple[float, float]]:
        """Return the corners."""
        return [(a * self.half_width, b * self.half_height) for a, b in ((1, 1), (-1, 1), (-1, -1), (1, -1))]


@dataclass(frozen=True)
class CircularAperture(Aperture):
    """A circle, or a ring.

    Parameters
    ----------
    center : sequence of float
        Its centre (x, y).
    obscures : bool
        Block the rays inside instead of those outside.
    radius : float
        Outer radius.
    inner : float
        Inner radius of a ring, 0 for a full circle.
    """

    radius: float = 1.0
    inner: float = 0.0
    sizes: ClassVar[tuple[str, ...]] = ("radius",)

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "inner", _validate.constant("inner", self.inner, least=0, below=self.radius))

    def contains(self, x: Array, y: Array) -> Array:
        """Return whether points lie in the ring."""
        squared = x * x + y * y
        return (squared <= self.radius**2) & (squared >= self.inner**2)

    def outline(self, count: int = 64) -> list[tuple[float, float]]:
        """Return points of the outer circle."""
        angles = (2 * math.pi * i / count for i in range(count))
        return [(self.radius * math.cos(angle), self.radius * math.sin(angle)) for angle in angles]


@dataclass(frozen=True)
class PolygonAperture(Aperture):
    """A polygon.

    Parameters
    ----------
    center : sequence of float
        Origin of the corners (x, y).
    obscures : bool
        Block the rays inside instead of those outside.
    corners : sequence of pairs
        (x, y) of three corners or more, in order.
    """

    corners: Sequence[Sequence[float]] = ((0.0, 1.0), (-1.0, -1.0), (1.0, -1.0))

    def __post_init__(self) -> None:
        super().__post_init__()
        corners = tuple(tuple(float(v) for v in _validate.several("corners", pair, 2)) for pair in self.corners)
        if len(corners) < 3:
            raise ValueError(f"corners must contain three pairs (x, y) or more, got {len(corners)}")
        object.__setattr__(self, "corners", corners)

    def contains(self, x: Array, y: Array) -> Array:
        """Return whether points lie in the polygon: a line along x crosses its edges an odd number of times."""
        inside: Any = (x != x) & (y != y)
        for (xa, ya), (xb, yb) in zip(self.corners, (*self.corners[1:], self.corners[0]), strict=True):
            if ya != yb:
                inside = inside ^ (((y < ya) != (y < yb)) & (x < xa + (y - ya) * ((xb - xa) / (yb - ya))))
        return inside

    def outline(self, count: int = 64) -> list[tuple[float, float]]:
        """Return the corners."""
        return [(x, y) for x, y in self.corners]


@dataclass(frozen=True)
class CombinedAperture:
    """Several apertures, all of which a ray must pass, such as the edge of a mirror, its hole and the vanes before it.

    Parameters
    ----------
    parts : sequence of Aperture
        The apertures.
    """

    parts: Sequence[Aperture]

    def passes(self, x: Array, y: Array) -> Array:
        """Return whether rays at points x, y pass all apertures, bool."""
        passed = self.parts[0].passes(x, y)
        for part in self.parts[1:]:
            passed = passed & part.passes(x, y)
        return passed

    def reach(self) -> float:
        """Return the smallest reach of the parts that limit rays."""
        return min((part.reach() for part in self.parts if not part.obscures), default=0.0)
