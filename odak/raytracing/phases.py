"""Diffractive phases of surfaces: gratings, phase polynomials and ideal lenses."""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any, ClassVar

from odak._array import Array
from odak.raytracing import components as vec
from odak.raytracing import interfaces
from odak.raytracing.surfaces import polynomial_in, xy_polynomial, zernike_sag


@dataclass(frozen=True)
class Phase:
    """Base class of phases that a surface adds to a wave.

    A phase is a frozen dataclass whose fields are its parameters. It must define :meth:`cycles`.

    Attributes
    ----------
    ranks : mapping
        Number of axes of a parameter that belong to one surface, 0 unless given.
    """

    ranks: ClassVar[Mapping[str, int]] = {"coefficients": 1}

    @classmethod
    def ranks_of_parameters(cls) -> tuple[int, ...]:
        """Return how many axes of each parameter do not belong to a batch."""
        return tuple(cls.ranks.get(field.name, 0) for field in fields(cls))

    def parameters(self) -> tuple:
        """Return the parameters in the order of the constructor."""
        return tuple(getattr(self, field.name) for field in fields(self))

    def cycles(self, x: Array, y: Array) -> tuple:
        """Return the phase over 2π at x, y of the vertex plane, and its derivatives by x and by y."""
        raise NotImplementedError(f"{type(self).__name__} must define cycles(x, y)")

    def curvatures(self) -> tuple:
        """Return the second derivatives of the phase over 2π at the vertex by x and by y."""
        return 0.0, 0.0

    def powers(self, wavelength) -> tuple:
        """Return the optical powers in the x–z and the y–z plane at a vacuum wavelength."""
        along_x, along_y = self.curvatures()
        return -wavelength * along_x, -wavelength * along_y

    def deflect(self, point, direction, normal, n1, n2, wavelength, reflects: bool) -> tuple:
        """Return directions behind the surface, which rays exist there, and the optical path added.

        Parameters
        ----------
        point, direction, normal : tuple of array
            Components.
        n1, n2, wavelength : array
            Indices on both sides and the vacuum wavelength.
        reflects : bool
            Whether the surface is a mirror.
        """
        value, along_x, along_y = self.cycles(point[0], point[1])
        gradient = (wavelength * along_x, wavelength * along_y, 0 * along_x)
        direction, through = interfaces.diffracted(direction, normal, n1, n2, gradient, reflects)
        return direction, through, wavelength * value


@dataclass(frozen=True)
class LinearGrating(Phase):
    """A grating of straight lines, equally spaced in the vertex plane.

    Parameters
    ----------
    frequency_x, frequency_y : float or array
        Lines per unit of length along x and y.
    order : float or array
        Diffraction order.

    Notes
    -----
    n₂ sin θ₂ = n₁ sin θ₁ + m·λ·f along the grating vector. On a curved surface the lines are those of the vertex plane
    projected along z (Welford, Aberrations of Optical Systems, 1986, section 5.6).
    """

    frequency_x: Any = 0.0
    frequency_y: Any = 0.0
    order: Any = 1.0

    def cycles(self, x: Array, y: Array) -> tuple:
        """Return the phase over 2π and its derivatives."""
        fx, fy = self.order * self.frequency_x, self.order * self.frequency_y
        return fx * x + fy * y, fx + 0 * x, fy + 0 * y


@dataclass(frozen=True)
class RadialPhase(Phase):
    """A phase of rotational symmetry, Σ a_i·(r/R)^(2i): a kinoform, a diffractive or a flat lens.

    Parameters
    ----------
    coefficients : sequence or array
        a1, a2, … in radians, of r², r⁴, …
    radius : float or array
        R.
    order : float or array
        Diffraction order.
    """

    coefficients: Any = ()
    radius: Any = 1.0
    order: Any = 1.0

    def cycles(self, x: Array, y: Array) -> tuple:
        """Return the phase over 2π and its derivatives."""
        scale, squared = self.order / (2 * vec.PI), (x * x + y * y) / (self.radius * self.radius)
        value, slope = polynomial_in(squared, self.coefficients)
        slope = 2 * scale * slope / (self.radius * self.radius)
        return scale * value, slope * x, slope * y

    def curvatures(self) -> tuple:
        """Return the second derivatives at the vertex."""
        first = vec.terms(self.coefficients)
        value = self.order / vec.PI * first[0] / (self.radius * self.radius) if first else 0.0
        return value, value


@dataclass(frozen=True)
class PolynomialPhase(Phase):
    """A phase polynomial in x and y, Σ a_j·(x/R)^p·(y/R)^q.

    Parameters
    ----------
    coefficients : sequence or array
        In radians, in the order x, y, x², xy, y², x³, …
    radius : float or array
        R.
    order : float or array
        Diffraction order.
    """

    coefficients: Any = ()
    radius: Any = 1.0
    order: Any = 1.0

    def cycles(self, x: Array, y: Array) -> tuple:
        """Return the phase over 2π and its derivatives."""
        scale = self.order / (2 * vec.PI)
        value, along_x, along_y = xy_polynomial(x / self.radius, y / self.radius, self.coefficients)
        return scale * value, scale * along_x / self.radius, scale * along_y / self.radius

    def curvatures(self) -> tuple:
        """Return the second derivatives at the vertex."""
        found = vec.terms(self.coefficients)
        scale = self.order / vec.PI / (self.radius * self.radius)
        return (scale * found[2] if len(found) > 2 else 0.0), (scale * found[4] if len(found) > 4 else 0.0)


@dataclass(frozen=True)
class ZernikePhase(Phase):
    """A phase of Zernike polynomials in Noll's order from j = 1, each of RMS 1 over the disc.

    Parameters
    ----------
    coefficients : sequence or array
        In radians.
    radius : float or array
        Radius of the disc.
    order : float or array
        Diffraction order.
    """

    coefficients: Any = ()
    radius: Any = 1.0
    order: Any = 1.0

    def cycles(self, x: Array, y: Array) -> tuple:
        """Return the phase over 2π and its derivatives."""
        scale = self.order / (2 * vec.PI)
        found = zernike_sag(x, y, 0.0, 0.0, self.coefficients, self.radius)
        return scale * found.height, scale * found.slope_x, scale * found.slope_y


@dataclass(frozen=True)
class IdealLens(Phase):
    """A thin lens without aberrations for distant objects, at all wavelengths: a first-order stand-in for a real one.

    Parameters
    ----------
    focal_length : float or array
        Positive if the lens converges.

    Notes
    -----
    Rays of slopes (p, q) in front go through (f·p, f·q) in the rear focal plane. The optical path makes all rays of a
    parallel bundle arrive there in phase. A mirror reverses the direction along z. The lens is flat, in air.
    """

    focal_length: Any = 1.0

    def powers(self, wavelength) -> tuple:
        """Return 1/f twice."""
        return 1 / self.focal_length + 0 * wavelength, 1 / self.focal_length + 0 * wavelength

    def deflect(self, point, direction, normal, n1, n2, wavelength, reflects: bool) -> tuple:
        """Return directions behind the lens, which rays exist there, and the optical path added."""
        (x, y, _), (u, v, w), f = point, direction, self.focal_length
        # Distances along the light's own way: positive in front of it.
        side = 1 - 2 * (w < 0)
        p, q = u * side / w, v * side / w
        a, b = p - x / f, q - y / f
        length = (1 + a * a + b * b) ** 0.5
        forward = -side if reflects else side
        # From the lens to the focus of the bundle, along this ray and along the one through the centre.
        whole, chief = f * length, f * (1 + p * p + q * q) ** 0.5
        path = n2 * (chief - whole) - n1 * (x * u + y * v)
        return (a / length, b / length, forward / length), w != 0, path
