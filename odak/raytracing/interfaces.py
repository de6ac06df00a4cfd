"""Reflection, refraction, diffraction and Fresnel coefficients of rays at surfaces; phases of diffractive surfaces."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np

from odak._array import Amount, Array, Numbers, complex_dtype, namespace
from odak.raytracing import components as vec
from odak.raytracing.batches import in_pieces
from odak.raytracing.geometry import dot, finite_rays, safe_divide, safe_sqrt
from odak.raytracing.intersections import RayStatus, status_array
from odak.raytracing.surfaces import Parametric, ZernikeFreeform, grid_reader, polynomial_in, xy_polynomial, zernike_sag


class Fresnel(NamedTuple):
    """Fresnel coefficients of an interface for both polarisations.

    Attributes
    ----------
    reflected_s, reflected_p, transmitted_s, transmitted_p : array
        Amplitude coefficients, complex ``[...]``.
    reflectance_s, reflectance_p, transmittance_s, transmittance_p : array
        Fractions of the power, real ``[...]``. Each pair adds up to 1.
    """

    reflected_s: Any
    reflected_p: Any
    transmitted_s: Any
    transmitted_p: Any
    reflectance_s: Any
    reflectance_p: Any
    transmittance_s: Any
    transmittance_p: Any


def reflect_directions(direction: Array, normal: Array) -> Array:
    """Return d − 2(d·n)/(n·n)·n; NaN where the normal is zero or not finite. Neither need be a unit vector."""
    return in_pieces(lambda *a: vec.join(reflected(*a)), (1, 1), direction, normal)


def reflected(direction: Any, normal: Any) -> vec.Vector:
    """Return the components of :func:`reflect_directions`."""
    xp, direction, normal, kept, differentiable = vec.lines(direction, normal)
    squared = vec.dot(normal, normal)
    exists = kept & (squared > 0) & (squared < xp.inf)
    factor = vec.quotient(2 * vec.dot(direction, normal), squared, exists, differentiable)
    factor = vec.placeholder(factor, exists & (abs(factor) < xp.inf), differentiable)
    return vec.nan_outside(vec.along(direction, -factor, normal), exists, differentiable)


def refract_directions(direction: Array, normal: Array, n1: Array | float, n2: Array | float) -> tuple[Array, ...]:
    """Return the refracted directions and their statuses, by Snell's law in vector form.

    Parameters
    ----------
    direction, normal : array
        ``[..., 3]``. The normal may have any length and either sign; the direction's length is kept.
    n1, n2 : array or float
        Indices before and behind the surface, ``[...]``.

    Returns
    -------
    tuple
        Directions ``[..., 3]``, NaN for total internal reflection and for rays that do not exist, and int8 statuses.

    Notes
    -----
    d' = μd + τn with μ = n1/n2 and the root τ of τ² + 2aτ + b = 0 of the transmitted ray: Spencer and
    Murty, J. Opt. Soc. Am. 52, 672 (1962), eqs. 18–21. A ray at grazing incidence is refracted to the critical
    angle for n1 < n2 and totally reflected otherwise.
    """

    def refract_with_status(*arrays):
        out, through, exists = refracted(*arrays)
        status = status_array(through, RayStatus.TOTAL_INTERNAL_REFLECTION)
        return vec.join(out), status - namespace(exists).astype(~exists, status.dtype)

    return in_pieces(refract_with_status, (1, 1, 0, 0), direction, normal, n1, n2)


def refracted(
    direction: Array | vec.Vector, normal: Array | vec.Vector, n1: Amount, n2: Amount
) -> tuple[vec.Vector, Array, Array]:
    """Return the components of :func:`refract_directions`, which rays are transmitted, and which exist."""
    # NaN must be avoided if the indices require gradients, as if the rays do.
    xp, direction, normal, kept, differentiable = vec.lines(direction, normal, n1, n2)
    squared, length = vec.dot(normal, normal), vec.dot(direction, direction)
    exists = kept & (squared > 0) & (length > 0) & (squared + length < xp.inf)
    normal = vec.unit(normal, differentiable)
    ratio = n1 / n2
    cosine = vec.dot(direction, normal)
    tangential = vec.along(direction, -cosine, normal)
    # |d|² − μ²|d_t|², from the tangential part itself, because 1 − cos² would lose precision by cancellation.
    inside = length - (ratio * ratio) * vec.dot(tangential, tangential)
    through = exists & (inside >= 0) & ((cosine != 0) | (ratio < 1))
    root = vec.square_root(xp.where(exists, inside, 1.0) if differentiable else inside, differentiable)
    root = xp.copysign(vec.placeholder(root, through, differentiable), cosine + 0.0)
    out = vec.along(vec.scaled(tangential, ratio), root, normal)
    return vec.nan_outside(out, through, differentiable), through, exists


def diffracted(
    direction: Array | vec.Vector,
    normal: Array | vec.Vector,
    n1: Amount,
    n2: Amount,
    gradient: vec.Vector,
    reflects: bool = False,
) -> tuple[vec.Vector, Array]:
    """Return the components of diffracted directions, and which rays exist.

    Parameters
    ----------
    direction, normal : array or tuple
        Unit directions and normals, ``[..., 3]`` or tuples of components.
    n1, n2 : array or float
        Indices before and behind the surface.
    gradient : tuple of array
        Components of λ·∇φ/2π, the vacuum wavelength times the gradient of the phase in cycles.
    reflects : bool
        Take the reflected ray.

    Notes
    -----
    The tangential part of the wave vector changes by the tangential part of the phase's gradient: n₂d'_t = n₁d_t +
    λ(∇φ)_t/2π. Without a phase this is Snell's law (Spencer and Murty, J. Opt. Soc. Am. 52, 672 (1962), section on
    gratings).
    """
    xp, direction, normal, kept, differentiable = vec.lines(direction, normal, n1, n2, *gradient)
    cosine = vec.dot(direction, normal)
    tangential = vec.along(vec.scaled(vec.without(direction, normal), n1), 1.0, vec.without(gradient, normal))
    inside = n2 * n2 - vec.dot(tangential, tangential)
    through = kept & (inside > 0)
    root = vec.square_root(xp.where(through, inside, 1.0), differentiable)
    root = xp.copysign(root, -cosine if reflects else cosine)
    out = vec.along(tangential, root, normal)
    return vec.nan_outside(vec.scaled(out, 1 / n2), through, True), through


def fresnel(direction: Array, normal: Array, n1: Array | float, n2: Array | complex | float) -> Fresnel:
    """Return the Fresnel coefficients of an interface between indices n1 (real) and n2 (real or complex).

    Parameters
    ----------
    direction, normal : array
        ``[..., 3]``; lengths and signs do not matter.
    n1, n2 : array or number
        Indices before and behind. Absorption is a positive imaginary part of `n2`: exp(+ikz) is a wave going forward.

    Notes
    -----
    Born and Wolf, Principles of Optics (1999), section 1.5.2, eqs. 20 and 21; r_p follows their sign, so that
    r_p = −r_s at normal incidence. Where the ray does not exist, all are NaN.
    """
    xp = namespace(direction, normal)
    direction, normal, kept = finite_rays(direction, normal)
    scale = dot(direction, direction) * dot(normal, normal)
    exists = kept & (scale > 0)
    cosine = abs(safe_divide(dot(direction, normal), safe_sqrt(xp.where(exists, scale, 1.0)), exists))
    dtype = complex_dtype(cosine)
    cos1, n1, n2 = (xp.astype(v + 0 * cosine, dtype) for v in (cosine, n1, n2))
    tangential = n1 / n2
    cos2 = xp.sqrt(1 - tangential * tangential * (1 - cos1 * cos1))
    a, b, c, d = n1 * cos1, n2 * cos2, n2 * cos1, n1 * cos2
    s, p = a + b, c + d
    amplitudes = ((a - b) / s, (c - d) / p, 2 * a / s, 2 * a / p)
    # Powers are compared, since cross-section and index change too. There is no 0/0 at grazing incidence.
    through_s = 4 * xp.real(a) * xp.real(b) / _square(s)
    through_p = 4 * xp.real(a) * xp.real(n2 * xp.conj(cos2)) / _square(p)
    powers = (_square(amplitudes[0]), _square(amplitudes[1]), through_s, through_p)
    return Fresnel(*(xp.where(exists, value, float("nan")) for value in (*amplitudes, *powers)))


def fresnel_shares(cosine: Any, n1: Any, n2: Any) -> Any:
    """Return the fraction of the power of unpolarised light that an interface of two real indices reflects.

    Parameters
    ----------
    cosine : array
        Of the angle of incidence, 0 … 1.
    n1, n2 : array
        Indices before and behind.

    Notes
    -----
    The mean of the reflectances by :func:`fresnel` for s and p, in a fifth of its time; 1 for total reflection.
    """
    xp = namespace(cosine)
    squared = 1 - (n1 / n2) ** 2 * (1 - cosine * cosine)
    through = squared > 0
    behind = safe_sqrt(xp.where(through, squared, 1.0))
    a, b, c, d = n1 * cosine, n2 * behind, n2 * cosine, n1 * behind
    s, p = (a - b) / (a + b), (c - d) / (c + d)
    return xp.where(through, (s * s + p * p) / 2, 1.0)


def _square(value):
    xp = namespace(value)
    return xp.real(value) ** 2 + xp.imag(value) ** 2


@dataclass(frozen=True)
class Phase(Parametric):
    """Base class of phases that a surface adds to a wave.

    A phase is a frozen dataclass whose fields are its parameters. It must define :meth:`cycles`. The class variable
    ``ranks`` has the meaning of ``ranks`` in :class:`odak.raytracing.Shape`.
    """

    def cycles(self, x: Array, y: Array) -> tuple[Any, ...]:
        """Return the phase over 2π at x, y of the vertex plane, and its derivatives by x and by y."""
        raise NotImplementedError(f"{type(self).__name__} must define cycles(x, y)")

    def covers(self, x: Array, y: Array) -> bool | Array:
        """Return where the phase is known, bool; True for everywhere. Rays elsewhere are vignetted."""
        return True

    def curvatures(self) -> tuple[Any, ...]:
        """Return the second derivatives of the phase over 2π at the vertex by x and by y: its optical power.

        They are 0 here, and must be defined by a phase that has power, for first-order properties.
        """
        return 0.0, 0.0

    def powers(self, wavelength: Any) -> tuple[Any, ...]:
        """Return the optical powers in the x–z and the y–z plane at a vacuum wavelength."""
        along_x, along_y = self.curvatures()
        return -wavelength * along_x, -wavelength * along_y

    def deflect(
        self, point: Any, direction: Any, normal: Any, n1: Any, n2: Any, wavelength: Any, reflects: bool
    ) -> tuple[Any, ...]:
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
        direction, through = diffracted(direction, normal, n1, n2, gradient, reflects)
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
    n₂ sin θ₂ = n₁ sin θ₁ + m·λ·f along the grating vector. On a curved surface the lines of the vertex plane are
    projected along z (Welford, Aberrations of Optical Systems, 1986, section 5.6).
    """

    frequency_x: float | Array = 0.0
    frequency_y: float | Array = 0.0
    order: float | Array = 1.0

    def cycles(self, x: Array, y: Array) -> tuple[Any, ...]:
        """Return the phase over 2π and its derivatives."""
        fx, fy = self.order * self.frequency_x, self.order * self.frequency_y
        return fx * x + fy * y, fx + 0 * x, fy + 0 * y


@dataclass(frozen=True)
class RadialGrating(Phase):
    """A grating of concentric circles, equally spaced in the vertex plane: an axicon.

    Parameters
    ----------
    frequency : float or array
        Lines per unit of length along the radius.
    order : float or array
        Diffraction order; a negative product of both bends rays of a plane wave towards the axis.

    Notes
    -----
    The phase is 2π·m·f·r. Its gradient has no direction at the centre, where rays are not deflected.
    """

    frequency: float | Array = 0.0
    order: float | Array = 1.0

    def cycles(self, x: Array, y: Array) -> tuple[Any, ...]:
        """Return the phase over 2π and its derivatives."""
        xp, squared = namespace(x, y), x * x + y * y
        safe = xp.where(squared > 0, squared, 1.0) ** 0.5
        along = xp.where(squared > 0, self.order * self.frequency / safe, 0.0)
        return along * squared, along * x, along * y


@dataclass(frozen=True)
class HologramPhase(Phase):
    """The phase of a hologram on a grid of samples, wrapped or not.

    Parameters
    ----------
    phase : array
        In radians, ``[rows, columns]``: rows along y, columns along x, sample n // 2 of each axis at the vertex.
    pitch : float or array
        Distance of the samples.
    order : float or array
        Diffraction order.

    Notes
    -----
    Between samples the phase is interpolated by cubic convolution (Keys, IEEE Trans. ASSP 29, 1153 (1981)), which is
    exact for polynomials of second degree and has continuous derivatives. The 16 samples around a ray are unwrapped
    from the nearest one: differences of adjacent samples are taken within ±π, which holds for a phase without aliasing.
    The optical path is thus known up to a multiple of the wavelength if the phase is wrapped; :meth:`unwrapped` gives
    the continuous one, for wavefronts. Rays exist up to the last sample but one; those beyond are vignetted.
    """

    phase: Any = ((0.0,) * 4,) * 4
    pitch: float | Array = 1.0
    order: float | Array = 1.0
    ranks: ClassVar[Mapping[str, int]] = {"phase": 2}

    @classmethod
    def unwrapped(cls, phase: Array, pitch: float, order: float = 1.0) -> "HologramPhase":
        """Return the hologram with its phase made continuous from the middle, along the middle row and all columns.

        Parameters
        ----------
        phase : array
            In radians, ``[rows, columns]``, without vortices.
        pitch : float
            Distance of the samples.
        order : float
            Diffraction order.

        Returns
        -------
        HologramPhase
            Differentiable in the phase: multiples of 2π are added to it.
        """
        xp = namespace(phase)
        rows, columns = phase.shape
        middle = xp.stack([phase[rows // 2, :]])
        line = middle + _unwrapping(middle, 1, columns // 2)
        start = phase + (line - middle)
        return cls(start + _unwrapping(start, 0, rows // 2), pitch, order)

    def cycles(self, x: Array, y: Array) -> tuple[Any, ...]:
        """Return the phase over 2π and its derivatives."""
        rows, columns = self.phase.shape[-2:]
        (i, weight_x, derivative_x), (j, weight_y, derivative_y) = (
            _keys_weights(value / self.pitch + n // 2, n) for value, n in ((x, columns), (y, rows))
        )
        samples = self._samples(i, j, x, y)
        value = along_x = along_y = 0.0 * (x + y)
        for a in range(4):
            for b in range(4):
                value = value + samples[b][a] * weight_x[a] * weight_y[b]
                along_x = along_x + samples[b][a] * derivative_x[a] * weight_y[b]
                along_y = along_y + samples[b][a] * weight_x[a] * derivative_y[b]
        scale = self.order / (2 * vec.PI)
        return scale * value, scale * along_x / self.pitch, scale * along_y / self.pitch

    def _samples(self, i, j, x, y) -> list[Any]:
        """Return the 4 × 4 samples about cells (i, j), unwrapped from the sample (i, j)."""
        columns = self.phase.shape[-1]
        take = grid_reader(self.phase, x + y)
        place = [[(j + b) * columns + i + a for a in range(-1, 3)] for b in range(-1, 3)]
        found = [[take(index) for index in line] for line in place]
        # From the sample (0, 0) along its row, then along each column.
        for line, order in ((found[1], (2, 3)), (found[1], (0,))):
            for a in order:
                line[a] = _nearest_branch(line[a], line[a - 1 if a > 1 else a + 1])
        for a in range(4):
            for b in (2, 3, 0):
                found[b][a] = _nearest_branch(found[b][a], found[b - 1 if b > 1 else b + 1][a])
        return found

    def covers(self, x: Array, y: Array) -> bool | Array:
        """Return whether x, y lie within the samples that have neighbours."""
        inside = True
        for value, n in ((x, self.phase.shape[-1]), (y, self.phase.shape[-2])):
            place = value / self.pitch + n // 2
            inside = inside & (place >= 1) & (place <= n - 2)
        return inside

    def curvatures(self) -> tuple[Any, ...]:
        """Return the second differences at the vertex."""
        rows, columns = (n // 2 for n in self.phase.shape[-2:])
        middle, scale = self.phase[..., rows, columns], self.order / (2 * vec.PI) / (self.pitch * self.pitch)
        pairs = (
            (self.phase[..., rows, columns - 1], self.phase[..., rows, columns + 1]),
            (self.phase[..., rows - 1, columns], self.phase[..., rows + 1, columns]),
        )
        first, second = (sum(_nearest_branch(value, middle) - middle for value in pair) * scale for pair in pairs)
        return first, second


def _nearest_branch(value, neighbour):
    """Return a phase with a multiple of 2π added that brings it within π of its neighbour."""
    xp = namespace(value, neighbour)
    return value - 2 * vec.PI * xp.round((value - neighbour) / (2 * vec.PI))


def _unwrapping(phase, axis: int, middle: int):
    """Return the multiples of 2π that make a phase continuous along an axis, 0 in the middle."""
    xp = namespace(phase)
    n = phase.shape[axis]
    after, before = (xp.take(phase, xp.asarray(np.arange(n - 1) + k), axis=axis) for k in (1, 0))
    steps = -xp.round((after - before) / (2 * vec.PI))
    first = 0 * xp.take(phase, xp.asarray([0]), axis=axis)
    found = xp.concat([first, xp.cumulative_sum(steps, axis=axis)], axis=axis)
    return 2 * vec.PI * (found - xp.take(found, xp.asarray([middle]), axis=axis))


def _keys_weights(place, count: int):
    """Return the cell of each place and the four weights of cubic convolution, with their derivatives."""
    xp = namespace(place)
    cell = xp.clip(xp.floor(place), 1, count - 3)
    u = place - cell
    weights = (
        -u * (u - 1) ** 2 / 2,
        1 + u * u * (3 * u - 5) / 2,
        u * (1 + u * (4 - 3 * u)) / 2,
        u * u * (u - 1) / 2,
    )
    derivatives = (
        -(u - 1) * (3 * u - 1) / 2,
        u * (9 * u - 10) / 2,
        (1 + u * (8 - 9 * u)) / 2,
        u * (3 * u - 2) / 2,
    )
    return xp.astype(cell, xp.int64), weights, derivatives


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

    coefficients: Numbers = ()
    radius: float | Array = 1.0
    order: float | Array = 1.0

    def cycles(self, x: Array, y: Array) -> tuple[Any, ...]:
        """Return the phase over 2π and its derivatives."""
        scale, squared = self.order / (2 * vec.PI), (x * x + y * y) / (self.radius * self.radius)
        value, derivative = polynomial_in(squared, self.coefficients)
        factor = 2 * scale * derivative / (self.radius * self.radius)
        return scale * value, factor * x, factor * y

    def curvatures(self) -> tuple[Any, ...]:
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

    coefficients: Numbers = ()
    radius: float | Array = 1.0
    order: float | Array = 1.0

    def cycles(self, x: Array, y: Array) -> tuple[Any, ...]:
        """Return the phase over 2π and its derivatives."""
        scale = self.order / (2 * vec.PI)
        value, along_x, along_y = xy_polynomial(x / self.radius, y / self.radius, self.coefficients)
        return scale * value, scale * along_x / self.radius, scale * along_y / self.radius

    def curvatures(self) -> tuple[Any, ...]:
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

    coefficients: Numbers = ()
    radius: float | Array = 1.0
    order: float | Array = 1.0

    def cycles(self, x: Array, y: Array) -> tuple[Any, ...]:
        """Return the phase over 2π and its derivatives."""
        scale = self.order / (2 * vec.PI)
        found = zernike_sag(x, y, 0.0, 0.0, self.coefficients, self.radius)
        return scale * found.height, scale * found.slope_x, scale * found.slope_y

    def curvatures(self) -> tuple[Any, ...]:
        """Return the second derivatives at the vertex."""
        along_x, along_y = ZernikeFreeform(coefficients=self.coefficients, radius=self.radius).curvatures()
        scale = self.order / (2 * vec.PI)
        return scale * along_x, scale * along_y


@dataclass(frozen=True)
class IdealLens(Phase):
    """A thin lens without aberrations at one pair of conjugates and all wavelengths: a model of a real lens.

    Parameters
    ----------
    focal_length : float or array
        Positive if the lens converges.
    vergence : float or array
        One over the distance from the object to the lens, negative for a virtual object behind it; 0 for a distant
        one. Where it is 0, an optical system takes the vergence of its own object at the lens, by first-order optics.

    Notes
    -----
    Rays of slopes (p, q) in front go through (f·p, f·q) in the rear focal plane, so that each point is imaged to a
    point. The optical path makes all rays of a point in the object plane arrive at its image in phase. A point in
    another plane is imaged with spherical aberration: a lens for distant objects adds h⁴/(4f³) to lowest order to a ray
    of height h from the front focal point. A mirror reverses the direction along z. The lens is flat, in air.
    """

    focal_length: float | Array = 1.0
    vergence: float | Array = 0.0

    def powers(self, wavelength: Any) -> tuple[Any, ...]:
        """Return 1/f twice."""
        return 1 / self.focal_length + 0 * wavelength, 1 / self.focal_length + 0 * wavelength

    def deflect(
        self, point: Any, direction: Any, normal: Any, n1: Any, n2: Any, wavelength: Any, reflects: bool
    ) -> tuple[Any, ...]:
        """Return directions behind the lens, which rays exist there, and the optical path added."""
        (x, y, _), (u, v, w), f = point, direction, self.focal_length
        # Distances along the direction of propagation: positive ahead.
        side = 1 - 2 * (w < 0)
        p, q = u * side / w, v * side / w
        a, b = p - x / f, q - y / f
        length = (1 + a * a + b * b) ** 0.5
        forward = -side if reflects else side
        # Slopes of the ray of the same point through the centre; distances s and s' of object and image along both
        # rays, whose differences s(√A − √B) are s(A − B)/(√A + √B), finite for s = ∞ too.
        near, far, square = self.vergence, 1 / f - self.vergence, x * x + y * y
        pc, qc = p - x * near, q - y * near
        chief = (1 + pc * pc + qc * qc) ** 0.5
        before = (near * square - 2 * (x * p + y * q)) / (chief + (1 + p * p + q * q) ** 0.5)
        path = n1 * before + n2 * (2 * (x * pc + y * qc) - far * square) / (chief + length)
        return (a / length, b / length, forward / length), w != 0, path
