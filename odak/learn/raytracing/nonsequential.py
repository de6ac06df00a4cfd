"""Non-sequential tracing: at each step the nearest of all surfaces decides where the light of a ray goes.

Surfaces and meshes stand anywhere, with a medium on each side. Light is split at them by Fresnel's equations, by a
coating, by given shares or among the orders of a grating, scattered, absorbed and detected, and all of the power that
was emitted is accounted for.
"""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field, replace
from numbers import Real
from typing import Any, NamedTuple, TypeAlias

import torch

from odak import _validate
from odak._threads import each
from odak._torch_private import in_own_precision
from odak._warnings import AccuracyWarning, warn
from odak.catalog.materials import MICROMETRES, OpticalMaterial, absorption_coefficient, extinction_of, refractive_index
from odak.catalog.materials import material as find_material
from odak.learn._tensors import reals_of, tensor
from odak.learn.raytracing.mesh import triangle_mesh
from odak.learn.raytracing.system.films import PolarizingFilm
from odak.learn.raytracing.system.pupils import launch
from odak.learn.raytracing.system.specification import Values
from odak.learn.raytracing.system.surfaces import (
    Coating,
    checked_system,
    drawn_radii,
    is_break,
    layout_of,
    optical_system,
)
from odak.learn.raytracing.system.tracing import ray_paths
from odak.raytracing import components as vec
from odak.raytracing.apertures import Aperture, CombinedAperture
from odak.raytracing.batches import needs_gradient
from odak.raytracing.geometry import safe_sqrt, unit
from odak.raytracing.interfaces import Phase, fresnel_shares, reflected, refracted
from odak.raytracing.surfaces import Plane, Shape, intersection
from odak.tools.transformation import rotation_matrix

# Rays that are traced together on a CPU: what one step needs of them stays in the cache.
BLOCK = 1 << 15
LIMITS = (Aperture, CombinedAperture)
SOURCES = ("collimated", "lambertian", "point")
# Difference of indices below which they are those of one medium.
SAME_MEDIUM = 1e-5
# Share of the light above which media that do not agree are told.
MIXED = 0.1
# Rounding errors of sources that lie on an element, over those of places that are computed along rays.
STARTING = 1 / 256
# Samples of a radial distribution, between which its sum is inverted linearly in r².
SAMPLES = 4096


@dataclass(frozen=True)
class Scatter:
    """Base class of scattering: which share of the light leaves its direction, and where to.

    Parameters
    ----------
    share : float or torch.Tensor
        Fraction of the reflected and of the transmitted light that is scattered; the rest keeps its direction.

    Notes
    -----
    Directions are drawn as points of the unit disc, the components β of unit vectors along the surface, in which
    distributions of microscopic roughness do not depend on the direction of the light (Harvey, Proc. SPIE 107, 41
    (1977)). What is drawn beyond the disc would not leave the surface: it keeps its direction.
    """

    share: float | torch.Tensor = 1.0

    def __post_init__(self) -> None:
        _checked_share("share", self.share)

    def _draw(self, along: Any, across: Any, first: Any, second: Any) -> tuple[Any, ...]:
        """Return components of scattered directions along the surface.

        Parameters
        ----------
        along, across : torch.Tensor
            Those of the direction without scattering.
        first, second : torch.Tensor
            Random numbers between 0 and 1.
        """
        raise NotImplementedError(f"{type(self).__name__} must define _draw(along, across, first, second)")


@dataclass(frozen=True)
class LambertianScatter(Scatter):
    """Scattering with the same radiance in all directions, whatever the direction of the light.

    Parameters
    ----------
    share : float or torch.Tensor
        Fraction of the light that is scattered.

    Examples
    --------
    >>> from odak.learn.raytracing import Interface, LambertianScatter
    >>> white = Interface(0.98, 0.0, scatter=LambertianScatter())
    >>> white.scatter.share
    1.0
    """

    def _draw(self, along: Any, across: Any, first: Any, second: Any) -> tuple[Any, ...]:
        """Return points of equal density on the unit disc."""
        radius, angle = first.sqrt(), 2 * math.pi * second
        return radius * angle.cos(), radius * angle.sin()


@dataclass(frozen=True)
class GaussianScatter(Scatter):
    """Scattering by a Gaussian distribution about the direction without scattering.

    Parameters
    ----------
    share : float or torch.Tensor
        Fraction of the light that is scattered.
    sigma : float or torch.Tensor
        Standard deviation of each component of the direction along the surface.

    Examples
    --------
    >>> from odak.learn.raytracing import Interface, GaussianScatter
    >>> brushed = Interface(0.9, 0.0, scatter=GaussianScatter(1.0, 0.05))
    >>> brushed.scatter
    GaussianScatter(share=1.0, sigma=0.05)
    """

    sigma: float | torch.Tensor = 0.1

    def _draw(self, along: Any, across: Any, first: Any, second: Any) -> tuple[Any, ...]:
        """Return points about the given ones, by the transform of Box and Muller."""
        radius, angle = self.sigma * (-2 * (1 - first).log()).sqrt(), 2 * math.pi * second
        return along + radius * angle.cos(), across + radius * angle.sin()


@dataclass(frozen=True)
class MeasuredScatter(Scatter):
    """Scattering by a BSDF that depends on the distance of the direction from that without scattering alone.

    Parameters
    ----------
    offsets : sequence of float or torch.Tensor
        Distances |β − β₀| of components along the surface, ascending from 0.
    values : sequence of float or torch.Tensor
        BSDF there in 1/sr: linear in between, 0 beyond the last.

    Raises
    ------
    ValueError
        If the offsets do not ascend from 0, or if more light would be scattered than there is.

    Notes
    -----
    The attribute `share` is the total integrated scatter, the fraction of the light that is scattered.

    Examples
    --------
    The total integrated scatter of A/(B + |β − β₀|²) over a radius of 2 is πA·ln(1 + 4/B):

    >>> from odak.learn.raytracing import MeasuredScatter
    >>> found = MeasuredScatter.abg(1e-3, 1e-4, 2.0)
    >>> round(float(found.share), 5)
    0.03329
    """

    share: Any = field(init=False, default=None)
    offsets: Values = (0.0, 1.0)
    values: Values = (0.0, 0.0)

    def __post_init__(self) -> None:
        offsets, values = _doubles(offsets=self.offsets, values=self.values)
        if offsets.ndim != 1 or offsets.shape != values.shape or len(offsets) < 2:
            shapes = f"{tuple(offsets.shape)} and {tuple(values.shape)}"
            raise ValueError(f"offsets and values must be two or more numbers each, as many, got {shapes}")
        offsets = offsets.detach()
        if bool(offsets[0] != 0) or not bool((offsets.diff() > 0).all()):
            raise ValueError(f"offsets must ascend from 0, got {offsets.tolist()!s:.60}")
        if not bool((values.detach() >= 0).all()):
            raise ValueError(f"values must be at least 0, got {values.tolist()!s:.60}")
        count = -(-SAMPLES // (len(offsets) - 1))
        part = torch.arange(count, dtype=torch.float64, device=offsets.device) / count
        radius = (offsets[:-1, None] + offsets.diff()[:, None] * part).flatten()
        density = (values[:-1, None] + values.diff()[:, None] * part).flatten()
        radius, density = torch.cat((radius, offsets[-1:])), torch.cat((density, values[-1:]))
        weight = radius * density
        ends = 2 * math.pi * torch.cumsum((weight[1:] + weight[:-1]) / 2 * radius.diff(), 0)
        _checked_share("the total integrated scatter of values", ends[-1])
        object.__setattr__(self, "share", ends[-1])
        sums = torch.cat((0 * ends[:1], ends)).detach()
        object.__setattr__(self, "_table", (sums / sums[-1].clamp_min(1e-300), radius * radius))

    @classmethod
    def abg(cls, a: float | torch.Tensor, b: float | torch.Tensor, g: float | torch.Tensor) -> "MeasuredScatter":
        """Return the ABg model, A/(B + |β − β₀|^g).

        Parameters
        ----------
        a : float or torch.Tensor
            A, which the values are proportional to.
        b : float or torch.Tensor
            B, which limits them at the centre.
        g : float or torch.Tensor
            Exponent.
        """
        a, b, g = _doubles(a=a, b=b, g=g)
        offsets = _offsets(a.device)
        return cls(offsets, a / (b + offsets**g))

    @classmethod
    def harvey(
        cls, peak: float | torch.Tensor, shoulder: float | torch.Tensor, slope: float | torch.Tensor
    ) -> "MeasuredScatter":
        """Return Harvey's model, b₀·(1 + (|β − β₀|/l)²)^(s/2).

        Parameters
        ----------
        peak : float or torch.Tensor
            b₀ in 1/sr.
        shoulder : float or torch.Tensor
            l, the distance at which the values begin to fall.
        slope : float or torch.Tensor
            s, negative.
        """
        peak, shoulder, slope = _doubles(peak=peak, shoulder=shoulder, slope=slope)
        offsets = _offsets(peak.device)
        return cls(offsets, peak * (1 + (offsets / shoulder) ** 2) ** (slope / 2))

    def _draw(self, along: Any, across: Any, first: Any, second: Any) -> tuple[Any, ...]:
        """Return points about the given ones, by the inverse of the distribution's sum over the radius."""
        sums, squares = (value.to(first) for value in self._table)  # type: ignore[attr-defined]
        place = torch.searchsorted(sums, first.contiguous()).clamp(1, len(sums) - 1)
        low, high = sums[place - 1], sums[place]
        part = ((first - low) / torch.where(high > low, high - low, 1.0)).clamp(0, 1)
        radius = (squares[place - 1] + part * (squares[place] - squares[place - 1])).sqrt()
        angle = 2 * math.pi * second
        return along + radius * angle.cos(), across + radius * angle.sin()


def _doubles(**values) -> list[torch.Tensor]:
    """Return numbers as float64 on one device."""
    # Python's numbers are not rounded to torch's default precision first.
    return [value.double() for value in reals_of(**{n: tensor(n, v, _precision(v)) for n, v in values.items()})]


def _precision(value) -> torch.dtype | None:
    return None if isinstance(value, torch.Tensor) else torch.float64


def _offsets(device) -> torch.Tensor:
    spaced = torch.logspace(-7, math.log10(2.0), SAMPLES, dtype=torch.float64, device=device)
    return torch.cat((0 * spaced[:1], spaced))


def _plain(name: str, value) -> float:
    """Return a fraction, of at least 0, without its graph."""
    value = _validate.number(name, value, least=0)
    return float(value.detach()) if isinstance(value, torch.Tensor) else float(value)


def _is_open(transmittance) -> bool:
    return isinstance(transmittance, torch.Tensor) or transmittance != 0


def _checked_share(name: str, value) -> None:
    value = _plain(name, value)
    if value > 1 + 1e-9:
        raise ValueError(f"{name} must be at most 1, got {value:g}")


Share: TypeAlias = float | torch.Tensor | Mapping[int, float | Callable[..., torch.Tensor]] | None


@dataclass(frozen=True)
class Interface:
    """Where the light goes at a surface; without any argument as at a bare, smooth interface of two media.

    Parameters
    ----------
    reflectance : float, torch.Tensor or mapping, optional
        Fraction of the power that is reflected, together with `transmittance`; the rest is absorbed. With a `phase`, a
        mapping from the diffraction order to its efficiency: a number, or a function of the points and the directions
        of the incident light, ``[m, 3]`` each in the element's frame, that returns ``[m]``. The share of an order that
        does not propagate is absorbed, and so is light where the phase is not known.
    transmittance : float, torch.Tensor or mapping, optional
        Fraction that is transmitted. (1, 0) is a mirror, (0, 0) a black surface. Where light is totally reflected, this
        share is reflected too.
    coating : Coating, optional
        Thin films, for light that passes the element along its normal, from medium 0 to medium 1. With a `substrate`, a
        mirror from both sides.
    phase : odak.raytracing.interfaces.Phase, optional
        A grating or another phase that has an `order`.
    scatter : Scatter, optional
        Scattering of reflected and transmitted light.

    Raises
    ------
    ValueError, TypeError
        If shares add up to more than 1, or arguments do not go together, naming them.

    Examples
    --------
    >>> from odak.learn.raytracing import Interface
    >>> Interface(0.5, 0.5).reflectance
    0.5
    """

    reflectance: Share = None
    transmittance: Share = None
    coating: Coating | None = None
    phase: Phase | None = None
    scatter: Scatter | None = None

    def __post_init__(self) -> None:
        given: tuple[Any, Any] = (self.reflectance, self.transmittance)
        for name, kind in (("coating", Coating), ("phase", Phase), ("scatter", Scatter)):
            value = getattr(self, name)
            _validate.instance(name, value, (kind, type(None)), f"a {kind.__name__} or None")
        if (given[0] is None) != (given[1] is None):
            raise ValueError(f"reflectance and transmittance must be given both or neither, got {given}")
        if given[0] is not None and self.coating is not None:
            raise ValueError("coating gives reflectance and transmittance, which must be left out then")
        total = 0.0
        if self.phase is not None:
            if not all(isinstance(part, Mapping) for part in given) or not hasattr(self.phase, "order"):
                raise TypeError(
                    "reflectance and transmittance must be mappings from orders to efficiencies where there is a "
                    f"phase, which must have an order; got {given} and {self.phase!r:.60}"
                )
            values = [value for part in given for value in part.values() if not callable(value)]
        else:
            values = [value for value in given if value is not None]
        for value in values:
            total += _plain("reflectance and transmittance", value)
        if total > 1 + 1e-9:
            raise ValueError(f"reflectance and transmittance must add up to at most 1, got {total:g}")


BARE = Interface()


class Element:
    """A surface or a mesh in space: its shape, the media on both sides, and where light goes at it.

    Parameters
    ----------
    shape : Shape or triangle_mesh
        A plane, a conic, any other surface z = sag(x, y), or triangles.
    media : pair of str, float, torch.Tensor or OpticalMaterial
        Medium 0, from which the normal points away (in front of a surface, inside a mesh with outward normals), and
        medium 1, into which it points.
    interface : Interface, optional
        Where light goes; by default a bare interface.
    center : sequence of float or torch.Tensor, optional
        Position of the vertex, ``[3]``.
    angles : sequence of float or torch.Tensor, optional
        Rotation in degrees about X, Y and Z, applied in this order, ``[3]``; or a rotation matrix ``[3, 3]``.
    aperture : float or Aperture, optional
        Limits of a surface: a semi-diameter or any aperture. Rays pass outside without noticing it.
    detects : bool
        Whether the attribute `received` of :class:`SceneLight` lists the rays that arrive.
    name : str, optional
        Name in results; by default its number in the scene.

    Examples
    --------
    >>> from odak.learn.raytracing import Element, Interface, Plane
    >>> screen = Element(Plane(), interface=Interface(0, 0), center=(0, 0, 50), detects=True, name="screen")
    >>> screen.name
    'screen'
    """

    def __init__(
        self,
        shape: Shape | triangle_mesh,
        media: Sequence[Any] = (1.0, 1.0),
        interface: Interface | None = None,
        center: Values | None = None,
        angles: Values | None = None,
        aperture: float | Aperture | None = None,
        detects: bool = False,
        name: str | None = None,
    ) -> None:
        _validate.instance("shape", shape, (Shape, triangle_mesh), "a Shape or a triangle_mesh")
        if isinstance(media, str) or not isinstance(media, Sequence) or len(media) != 2:
            raise ValueError(f"media must be two, one on each side, got {media!r:.80}")
        _validate.instance("interface", interface, (Interface, type(None)), "an Interface")
        self.shape = shape
        self.media: Any = tuple(_checked_medium(value) for value in media)
        self.interface: Interface = BARE if interface is None else interface
        self.center: torch.Tensor | None = None
        self.rotation: torch.Tensor | None = None
        if center is not None:
            (found,) = _doubles(center=center)
            self.center = _validate.shaped("center", found, "[3]")
        if angles is not None:
            (found,) = _doubles(angles=angles)
            if tuple(found.shape) not in ((3,), (3, 3)):
                raise ValueError(f"angles must be three angles or a matrix [3, 3], got {tuple(found.shape)}")
            self.rotation = rotation_matrix(found) if found.ndim == 1 else found
        if aperture is not None and not isinstance(aperture, LIMITS):
            aperture = _validate.constant("aperture", aperture, positive=True)
        if aperture is not None and isinstance(shape, triangle_mesh):
            raise ValueError("aperture belongs to surfaces, not to meshes, which end where their triangles end")
        self.aperture = aperture
        self.detects: bool = _validate.flag("detects", detects)
        self.name: str | None = None if name is None else _validate.text("name", name)

    @property
    def _reach(self) -> float:
        """Largest distance from the origin that is known of it."""
        far = 0.0 if self.center is None else float(self.center.detach().norm())
        if isinstance(self.shape, triangle_mesh):
            return far + float(self.shape.vertices.detach().norm(dim=1).amax()) if len(self.shape.vertices) else far
        return far + (
            0.0
            if self.aperture is None
            else self.aperture.reach()
            if isinstance(self.aperture, LIMITS)
            else self.aperture
        )

    def _enter(self, point: tuple[Any, ...], direction: tuple[Any, ...], place: bool = True) -> tuple[Any, ...]:
        """Return points and directions in the element's frame; of two directions with `place` False."""
        if place and self.center is not None:
            point = vec.minus(point, self.center.to(point[0]).unbind())
        if self.rotation is not None:
            columns = [column.unbind() for column in self.rotation.to(point[0]).unbind(1)]
            point, direction = (tuple(vec.dot(column, v) for column in columns) for v in (point, direction))
        return point, direction

    def _leave(self, vector: tuple[Any, ...], place: bool = False) -> tuple[Any, ...]:
        """Return a direction, or a place, of the element's frame in the scene's frame."""
        if self.rotation is not None:
            vector = tuple(vec.dot(row.unbind(), vector) for row in self.rotation.to(vector[0]).unbind(0))
        if place and self.center is not None:
            vector = tuple(a + b for a, b in zip(vector, self.center.to(vector[0]).unbind(), strict=True))
        return vector

    def _meet(self, point: tuple, direction: tuple[Any, ...], left: Any, face: Any, margin: float) -> tuple[Any, ...]:
        """Return where rays meet the element, in its frame.

        Parameters
        ----------
        point, direction : tuple of torch.Tensor
            Rays in its frame, unit directions.
        left : torch.Tensor or None
            Which rays start on it, ``[m]``.
        face : torch.Tensor or None
            Triangles that they start on, −1 for none.
        margin : float
            Length below which two places are the same.

        Returns
        -------
        tuple
            Distances, infinite for rays that do not meet it, places, normals as tuples, and triangles or None.
        """
        # A source may lie on the element, but for the rounding of its place.
        near = margin * STARTING if left is None else 0.0
        if isinstance(self.shape, triangle_mesh):
            point = vec.along(point, near, direction) if near else point
            rays = torch.stack((torch.stack(point, -1), torch.stack(direction, -1)), -2)
            leaving = None if left is None else torch.where(left, face, -1)
            found: Any = self.shape.intersect(rays, leaving=leaving)
            places = tuple(part.unbind(-1) for part in (found.point, found.normal))
            return torch.where(found.hit, found.distance + near, torch.inf), *places, found.face
        if isinstance(self.shape, Plane):
            # In closed form, since guides and boxes consist of planes.
            steep = direction[2] != 0
            distance = -point[2] / torch.where(steep, direction[2], 1.0)
            hit = steep & (distance > near)
            if left is not None:
                hit = hit & ~left
            place = vec.along(point, distance, direction)
            if self.aperture is not None and not isinstance(self.aperture, LIMITS):
                hit = hit & (place[0] * place[0] + place[1] * place[1] <= self.aperture**2)
            zero, one = (distance.new_full((), value).expand_as(distance) for value in (0.0, 1.0))
            place, normal = (place[0], place[1], zero), (zero, zero, one)
        else:
            limit = None if isinstance(self.aperture, LIMITS) else self.aperture
            # Rays that have left another surface may meet this one as close by as it stands.
            ahead = margin if left is None else margin * left
            start = vec.along(point, ahead, direction)
            found, _ = intersection(start, direction, self.shape, limit, "ahead")
            distance, hit, place, normal = found.distance + ahead, found.hit, found.point, found.normal
        if isinstance(self.aperture, LIMITS):
            hit = hit & self.aperture.passes(place[0], place[1])
        return torch.where(hit, distance, torch.inf), place, normal, None


def system_elements(system: optical_system) -> list[Element]:
    """Return the surfaces of an optical system as elements of a scene, and its image plane as a black detector.

    Parameters
    ----------
    system : optical_system
        The system, without diffractive phases, graded media and polarising films. Coordinate breaks and mirrors
        place what follows. Surfaces end at their apertures; those without at 1.05 times the largest distance of the
        rays of its fields from the vertex, as drawings show them.

    Returns
    -------
    list of Element
        One for each surface, in their order, with media and coatings; the last is named "image". The first vertex is
        the origin, as of :func:`odak.learn.raytracing.system.launch`, whose rays start in its plane: move them back.

    Raises
    ------
    ValueError
        If a surface has a phase, a graded medium or a polarising film.

    Examples
    --------
    >>> from odak.learn.raytracing import system_elements
    >>> from odak.learn.raytracing.system import load_system
    >>> len(system_elements(load_system("cooke_triplet")))
    7
    """
    surfaces: list[Any] = list(checked_system(system).surfaces)
    rotations, origins = system.frames()
    signs = layout_of(system.surfaces, system.prescription(), system.image).signs
    with torch.no_grad():
        points = ray_paths(system, launch(system, "rings", 6))[..., 1:, :]
        reaches = (points - origins).norm(dim=-1).nan_to_num(0.0).flatten(0, -2).amax(0).tolist()
    radii = drawn_radii(surfaces, reaches[:-1])
    before, found = system.object_material, []
    for i, item in enumerate(surfaces):
        if is_break(item):
            continue
        if item.phase is not None or item.gradient is not None:
            raise ValueError(f"system must be without phases and gradients, got one at surfaces[{i}]")
        if isinstance(item.coating, PolarizingFilm):
            raise ValueError(f"system must be without polarising films, got one at surfaces[{i}]")
        behind = before if item.reflects else (item.index if item.material is None else item.material)
        media, films = (before, behind), item.coating
        if signs[i] < 0:
            media, films = (behind, before), films if films is None or films.substrate is not None else films.reversed()
        interface = Interface(1.0, 0.0) if item.reflects and films is None else Interface(coating=films)
        limit = radii[i] if item.limit is None else item.limit
        found.append(Element(item.shape, media, interface, origins[i], rotations[i], limit))
        before = behind
    image = Plane() if system.image is None else system.image.shape
    black = Interface(0.0, 0.0)
    found.append(Element(image, (before, before), black, origins[-1], rotations[-1], None, True, "image"))
    return found


def _checked_medium(value):
    if isinstance(value, str):
        try:
            return 1.0 if value.casefold() == "air" else find_material(value)
        except ValueError as error:
            raise ValueError(f"media: {error}") from None
    if isinstance(value, OpticalMaterial):
        return value
    if isinstance(value, bool) or not isinstance(value, (Real, torch.Tensor)):
        raise TypeError(f"media must be names, indices or Materials, got {type(value).__name__}")
    return _validate.number("media", value, positive=True)


class Light(NamedTuple):
    """Rays with their power, and perhaps their polarisation.

    Attributes
    ----------
    rays : torch.Tensor
        ``[m, 2, 3]``, points and directions of any length; a direction of length 0 marks a missing ray.
    power : torch.Tensor
        ``[m]``.
    field : torch.Tensor or None
        Direction and phase of the electric field, complex unit vectors across the rays, ``[m, 3]``. None for light that
        is taken for unpolarised at every interface.

    Examples
    --------
    >>> from odak.learn.raytracing import light_source
    >>> tuple(light_source("point", 10).rays.shape)
    (10, 2, 3)
    """

    rays: torch.Tensor
    power: torch.Tensor
    field: torch.Tensor | None = None

    def polarized(self, jones: Sequence[complex] | torch.Tensor | None = None) -> "Light":
        """Return the light with its polarisation, which interfaces then change and make use of.

        Parameters
        ----------
        jones : sequence of two numbers, optional
            Jones vector along x and y, carried along from the z axis to each ray; complex perhaps. By default the light
            is unpolarised: each ray becomes two of half the power, polarised across each other, which stays exact
            behind any number of interfaces, where light that is taken for unpolarised at every interface does not.

        Returns
        -------
        Light
            With twice as many rays for unpolarised light: first all of one polarisation, then all of the other.
        """
        rays, power = _checked_light(self)[:2]
        x, y = (torch.stack(axis, -1) for axis in axes_across(rays[:, 1].unbind(-1)))
        dtype = torch.complex64 if rays.dtype == torch.float32 else torch.complex128
        if jones is None:
            return Light(torch.cat((rays, rays)), torch.cat((power, power)) / 2, torch.cat((x, y)).to(dtype))
        (jones,) = _validate.constants(jones=jones)
        state = tensor("jones", jones, torch.complex128).to(rays.device)
        size = state.abs().square().sum().sqrt()
        if state.shape != (2,) or not bool((size > 0) & torch.isfinite(size)):
            raise ValueError(f"jones must be two finite numbers, not both 0, got {jones!r:.80}")
        state = (state / size).to(dtype)
        return Light(rays, power, state[0] * x + state[1] * y)


def axes_across(vector: tuple[Any, ...]) -> tuple[tuple[Any, ...], tuple[Any, ...]]:
    """Return the components of two axes across unit vectors: x and y, carried along from the z axis or from −z.

    Duff et al., J. Comput. Graph. Tech. 6(1), 1 (2017).
    """
    u, v, w = vector
    sign = torch.where(w < 0, -1.0, 1.0).to(w)
    a = -1 / (sign + w)
    b = u * v * a
    return (1 + sign * u * u * a, sign * b, -sign * u), (b, sign + v * v * a, -v)


@in_own_precision
def light_source(
    kind: str,
    count: int,
    size: float | Values = 0.0,
    half_angle: float | None = None,
    center: Values = (0.0, 0.0, 0.0),
    angles: Values = (0.0, 0.0, 0.0),
    power: float | torch.Tensor = 1.0,
    seed: int = 0,
) -> Light:
    """Return rays of a source that shines along z, or along z rotated.

    Parameters
    ----------
    kind : str
        "collimated": parallel rays from an area. "lambertian": from an area with the same radiance in all directions.
        "point": from a point with the same intensity in all directions.
    count : int
        Number of rays, of equal power.
    size : float or pair of float
        Radius of a disc, or the two sides of a rectangle; 0 of a point.
    half_angle : float, optional
        Angle in degrees about the axis within which light is emitted; by default 90 of a Lambertian source, 180 of a
        point. A Lambertian source, within a smaller angle, has the same radiance there.
    center : sequence of float or torch.Tensor
        Its middle, ``[3]``; a tensor gives device and precision of the rays.
    angles : sequence of float or torch.Tensor
        Rotation in degrees about X, Y and Z, applied in this order, ``[3]``.
    power : float or torch.Tensor
        Power of all rays together.
    seed : int
        Seed of the places and directions, which are points of a scrambled Sobol sequence: means over them converge
        faster than over independent ones.

    Returns
    -------
    Light
        float64 unless `center` is of another precision; differentiable in center, angles and power.

    Examples
    --------
    >>> from odak.learn.raytracing import light_source
    >>> light = light_source("lambertian", 4096, size=2.0)
    >>> round(float(light.rays[:, 1, 2].mean()), 3)  # 2/3, since the density follows the cosine
    0.667
    """
    kind = _validate.one_of("kind", kind, SOURCES)
    count = _validate.integer("count", count, minimum=1)
    like = center if isinstance(center, torch.Tensor) and center.is_floating_point() else None
    dtype = torch.float64 if like is None else like.dtype
    place, angles, power = (value.to(dtype) for value in _doubles(center=center, angles=angles, power=power))
    power = _validate.number("power", power, least=0)
    place, angles = _validate.shaped("center", place, "[3]"), _validate.shaped("angles", angles, "[3]")
    most = 90.0 if kind == "lambertian" else 180.0
    half = (
        most
        if half_angle is None
        else _validate.constant("half_angle", half_angle, least=0, most=most, unit=f"degrees of a {kind} source")
    )
    listed = isinstance(size, Sequence) or math.prod(getattr(size, "shape", ())) > 1
    given: Any = size if listed else [size]
    sides = [_validate.constant("size", value, least=0) for value in given]
    if len(sides) not in (1, 2) or (kind == "point" and any(sides)):
        raise ValueError(f"size must be a radius or two sides, and 0 of a point, got {size!r} of a {kind} source")
    engine = torch.quasirandom.SobolEngine(4, scramble=True, seed=_validate.integer("seed", seed))
    a, b, c, d = engine.draw(count, dtype=torch.float64).to(place.device).unbind(1)
    if len(sides) == 2:
        x, y = sides[0] * (a - 0.5), sides[1] * (b - 0.5)
    else:
        x, y = (sides[0] * a.sqrt() * turn for turn in ((2 * math.pi * b).cos(), (2 * math.pi * b).sin()))
    if kind == "collimated":
        u, v, w = 0 * c, 0 * c, 0 * c + 1
    else:
        if kind == "lambertian":
            sine = c.sqrt() * math.sin(math.radians(half))
            w = (1 - sine * sine).sqrt()
        else:
            w = 1 - c * (1 - math.cos(math.radians(half)))
            sine = (1 - w * w).clamp_min(0).sqrt()
        u, v = (sine * turn for turn in ((2 * math.pi * d).cos(), (2 * math.pi * d).sin()))
    matrix = rotation_matrix(angles)
    points, ways = (torch.stack(part, -1).to(dtype) @ matrix.mT for part in ((x, y, 0 * x), (u, v, w)))
    return Light(torch.stack((points + place, ways), 1), (power / count).expand(count))


class Received(NamedTuple):
    """Rays that arrived at an element, in its frame.

    Attributes
    ----------
    point, direction : torch.Tensor
        ``[k, 3]``.
    power : torch.Tensor
        Of each ray when it arrived, ``[k]``.
    path : torch.Tensor
        Optical path from the source, ``[k]``.
    ray : torch.Tensor
        Which of the emitted rays it comes from, int64 ``[k]``.
    field : torch.Tensor or None
        Direction and phase of the electric field, complex unit vectors ``[k, 3]``, of polarised light.

    Examples
    --------
    >>> from odak.learn.raytracing import Element, Interface, Plane, RayScene, light_source
    >>> screen = Element(Plane(), interface=Interface(0, 0), center=(0, 0, 5), detects=True, name="screen")
    >>> found = RayScene([screen]).trace(light_source("collimated", 1000, (2.0, 2.0)), 550e-6)
    >>> pixels = found.received["screen"].irradiance((2.0, 2.0), (4, 4))
    >>> round(float(pixels.mean()), 6)  # a power of 1 on an area of 4
    0.25
    """

    point: torch.Tensor
    direction: torch.Tensor
    power: torch.Tensor
    path: torch.Tensor
    ray: torch.Tensor
    field: torch.Tensor | None = None

    def irradiance(self, size: float | Sequence[float], pixels: Sequence[int] = (64, 64)) -> torch.Tensor:
        """Return the power on each unit of area, ``[rows, columns]``: rows along y, columns along x, both ascending.

        Parameters
        ----------
        size : float or pair of float
            Sides along x and y of the map, which is centred at the element's vertex.
        pixels : pair of int
            Number of rows and columns.

        Notes
        -----
        A ray counts in the four pixels about it in proportion to its distance from their centres, so that the map is
        differentiable in its place; at the edge it counts in the last pixel. The sum of the power is kept.
        """
        return irradiance_of(self.point[:, 0], self.point[:, 1], self.power, size, pixels)

    def intensity(self, pixels: Sequence[int] = (64, 64), reach: float = 1.0) -> torch.Tensor:
        """Return the power in each unit of solid angle over direction cosines along x and y, ``[rows, columns]``.

        Parameters
        ----------
        pixels : pair of int
            Number of rows (along y) and columns (along x).
        reach : float
            Largest direction cosine of the map, at most 1.
        """
        rows, columns = _validate.size("pixels", pixels)
        reach = _validate.constant("reach", reach, positive=True, most=1)
        found = binned(
            self.direction[:, 0] / (2 * reach), self.direction[:, 1] / (2 * reach), self.power, rows, columns
        )
        v, u = (((torch.arange(n, device=found.device) + 0.5) / n - 0.5) * 2 * reach for n in (rows, columns))
        cosine = (1 - u * u - (v * v)[:, None]).clamp_min(0).sqrt().to(found)
        return found * cosine / (4 * reach * reach / (rows * columns))


def irradiance_of(
    x: torch.Tensor, y: torch.Tensor, power: torch.Tensor, size: float | Sequence[float], pixels: Sequence[int]
) -> torch.Tensor:
    """Return the power per area in the pixels of a detector of this size that rays bring to these points."""
    rows, columns = _validate.size("pixels", pixels)
    width, height = _validate.pair("size", size, positive=True)
    return binned(x / width, y / height, power, rows, columns) / (width * height / (rows * columns))


def binned(x: Any, y: Any, power: Any, rows: int, columns: int) -> torch.Tensor:
    """Return the power in pixels of places within ±½, shared out bilinearly."""
    inside = (x.abs() <= 0.5) & (y.abs() <= 0.5)
    total = power.new_zeros(rows * columns)
    weight = torch.where(inside, power, 0.0)
    parts = []
    for value, n in ((x, columns), (y, rows)):
        place = torch.where(inside, (value + 0.5) * n - 0.5, 0.0)
        low = place.detach().floor()
        parts.append([((low + k).long().clamp(0, n - 1), (1 - k) + (2 * k - 1) * (place - low)) for k in (0, 1)])
    for column, share in parts[0]:
        for row, other in parts[1]:
            total = total.index_add(0, row * columns + column, weight * share * other)
    return total.reshape(rows, columns)


class SceneLight(NamedTuple):
    """Where the light of a source went.

    Attributes
    ----------
    emitted : torch.Tensor
        Power of all rays.
    absorbed : torch.Tensor
        Power that each element absorbed, ``[elements]``: what a detector received and did not pass on.
    in_media : torch.Tensor
        Power absorbed on the way through media.
    escaped : torch.Tensor
        Power of rays that met nothing more.
    cut : torch.Tensor
        Power of rays that were not followed further: below the threshold, or after the largest number of bounces.
    received : dict of str to Received
        Rays that arrived at the elements that detect, by name.
    segments : torch.Tensor or None
        Straight pieces of the rays, ``[k, 2, 3]``, where they were asked for.
    segment_rays : torch.Tensor or None
        Which of the emitted rays each piece belongs to, ``[k]``.
    segment_power : torch.Tensor or None
        Power at the start of each piece, ``[k]``.

    Examples
    --------
    >>> from odak.learn.raytracing import Element, Plane, RayScene, light_source
    >>> plate = [Element(Plane(), (1.0, 1.5)), Element(Plane(), (1.5, 1.0), center=(0, 0, 3))]
    >>> found = RayScene(plate).trace(light_source("collimated", 10, center=(0, 0, -1)), 550e-6, split=True)
    >>> total = found.absorbed.sum() + found.in_media + found.escaped + found.cut
    >>> bool(abs(total - found.emitted) < 1e-12)
    True
    """

    emitted: torch.Tensor
    absorbed: torch.Tensor
    in_media: torch.Tensor
    escaped: torch.Tensor
    cut: torch.Tensor
    received: dict[str, Received]
    segments: torch.Tensor | None
    segment_rays: torch.Tensor | None
    segment_power: torch.Tensor | None


class _State(NamedTuple):
    """Rays on their way.

    Points, directions, fields, power, optical path, number, element and triangle they leave, and the index of the
    medium that they are in, NaN where they start.
    """

    point: tuple[Any, ...]
    direction: tuple[Any, ...]
    field: tuple[Any, ...]
    power: torch.Tensor
    path: torch.Tensor
    ray: torch.Tensor
    left: torch.Tensor
    face: torch.Tensor
    medium: torch.Tensor

    def take(self, index) -> "_State":
        vectors: Any = self[:3]
        others: Any = self[3:]
        found = [tuple(v.index_select(0, index) for v in part) for part in vectors]
        return _State._make([*found, *(v.index_select(0, index) for v in others)])


def _joined(states: list[_State]) -> _State:
    if len(states) == 1:
        return states[0]
    found: list[Any] = [tuple(torch.cat(part) for part in zip(*(s[i] for s in states), strict=True)) for i in range(3)]
    rest: list[Any] = list(zip(*(s[3:] for s in states), strict=True))
    return _State(*found, *map(torch.cat, rest))


class RayScene:
    """Surfaces and meshes in space, through which light finds its own way.

    Parameters
    ----------
    elements : sequence of Element
        The elements.
    unit : str
        Unit of lengths, for the dispersion and absorption of materials.

    Raises
    ------
    TypeError, ValueError
        If there is none, something else, or two of one name.

    Notes
    -----
    The media at an intersection are taken from the element that is met, on the side from which the ray comes, so
    that adjoining elements must agree on the medium between them. An element on which a source lies does not stop its
    rays where they start. Light is taken for unpolarised at each interface,
    unless it comes from :meth:`Light.polarized`: then interfaces act on its two polarisations, scattering leaves none
    (each ray is scattered with a linear polarisation that is drawn), and gratings turn the field with the ray.

    Examples
    --------
    A plate of index 1.5 lets (1 − R)/(1 + R) of the light pass, all reflections between its faces included:

    >>> from odak.learn.raytracing import Element, Interface, Plane, RayScene, light_source
    >>> screen = Element(Plane(), interface=Interface(0, 0), center=(0, 0, 9), detects=True, name="screen")
    >>> plate = [Element(Plane(), (1.0, 1.5)), Element(Plane(), (1.5, 1.0), center=(0, 0, 3))]
    >>> light = light_source("collimated", 10, size=1.0, center=(0, 0, -1))
    >>> found = RayScene([*plate, screen]).trace(light, 550e-6, split=True, threshold=1e-12)
    >>> round(float(found.absorbed[2]), 9), round((1 - 0.04) / (1 + 0.04), 9)
    (0.923076923, 0.923076923)
    """

    def __init__(self, elements: Iterable[Element], unit: str = "mm") -> None:
        if isinstance(elements, Element) or not isinstance(elements, Iterable):
            raise TypeError(f"elements must be a sequence of Elements, got {type(elements).__name__}")
        self.elements: tuple[Element, ...] = tuple(elements)
        for item in self.elements:
            _validate.instance("elements", item, Element, "Elements")
        if not self.elements:
            raise ValueError("elements must hold one at least, got none")
        self.names: list[str] = [str(i) if item.name is None else item.name for i, item in enumerate(self.elements)]
        if len(set(self.names)) < len(self.names):
            raise ValueError(f"elements must have different names, got {self.names}")
        self.unit: str = _validate.one_of("unit", unit, MICROMETRES)

    def trace(
        self,
        light: Light,
        wavelength: float,
        split: bool = False,
        threshold: float = 1e-6,
        bounces: int = 1000,
        seed: int = 0,
        paths: bool = False,
    ) -> SceneLight:
        """Follow light until it is absorbed, leaves the scene, or is too weak.

        Parameters
        ----------
        light : Light
            From :func:`light_source`, or rays and powers of your own.
        wavelength : float or torch.Tensor
            In vacuum, in the scene's unit.
        split : bool
            Follow all rays into which a ray is split, whose number grows; otherwise one of them, drawn by its share of
            the power, which carries all that was not absorbed.
        threshold : float
            Rays of less than this fraction of a source's mean ray are cut.
        bounces : int
            Largest number of intersections of a ray.
        seed : int
            Seed of the drawn rays and scattered directions.
        paths : bool
            Keep the pieces of all rays, for drawings.

        Returns
        -------
        SceneLight
            Differentiable in rays, power, wavelength, places, shapes, media and shares, for the choice of path that was
            drawn: gradients do not see that light could have met another element. Gradients of shares are unbiased.

        Raises
        ------
        TypeError, ValueError
            If an argument is of another form, naming it.

        Warns
        -----
        odak.AccuracyWarning
            If more than a tenth of the light meets an element from another medium than the one that it came through.

        Notes
        -----
        All rays of a block take a step together; the elements are sorted by what was met, for which one reading of the
        device suffices in each step (meshes search with their own). On a CPU a block has 32 768 rays.
        """
        light = _checked_light(light)
        split, paths = _validate.flag("split", split), _validate.flag("paths", paths)
        threshold = _validate.constant("threshold", threshold, least=0)
        bounces = _validate.integer("bounces", bounces, minimum=1)
        rays, power, field = light
        wave = _validate.number("wavelength", tensor("wavelength", wavelength, _precision(wavelength)), positive=True)
        wave = wave.to(rays)
        seeds = torch.Generator().manual_seed(_validate.integer("seed", seed))
        size = float(rays.detach()[:, 0].abs().amax()) + max(item._reach for item in self.elements)
        plan = _Walk(self, wave, split, size, paths, threshold * power.detach().sum() / len(power))
        block = len(rays) if rays.is_cuda else BLOCK
        number = torch.arange(len(rays), device=rays.device)
        fields = [None] * -(-len(rays) // block) if field is None else field.split(block)
        parts = zip(rays.split(block), power.split(block), number.split(block), fields, strict=True)
        # Each block draws its own random numbers: what comes out does not depend on the number of threads.
        blocks = [(*part, int(torch.randint(2**62, (), generator=seeds))) for part in parts]

        def follow(*part):
            return plan.begin(*part, bounces)

        if torch.is_grad_enabled() and self._may_need_gradient(rays, power, wave, field):
            walks = [follow(*part) for part in blocks]
        else:
            walks = list(each(follow, blocks, not rays.is_cuda))
        return plan.result(power.sum(), walks)

    def _may_need_gradient(self, *numbers) -> bool:
        """Return whether derivatives may be asked for: functions of the caller's own may hold what is not seen here."""
        found: list[Any] = list(numbers)
        for item in self.elements:
            shape, interface = item.shape, item.interface
            found += [item.center, item.rotation, *item.media, interface.reflectance, interface.transmittance]
            found += [shape.vertices, shape.normals] if isinstance(shape, triangle_mesh) else shape.parameters()
            found += interface.phase.parameters() if interface.phase is not None else ()
            found += vars(interface.scatter).values() if interface.scatter is not None else ()
            found += interface.coating.thicknesses if interface.coating is not None else ()
        flat = [v for one in found for v in (one.values() if isinstance(one, Mapping) else [one])]
        flat = [v for one in flat for v in (one if isinstance(one, (list, tuple)) else [one])]
        return any(callable(v) or (isinstance(v, torch.Tensor) and v.requires_grad) for v in flat)


def _checked_light(light) -> Light:
    _validate.instance("light", light, Light, "a Light, as light_source returns it")
    rays, power = reals_of(rays=light.rays, power=light.power)
    if rays.ndim != 3 or rays.shape[1:] != (2, 3) or len(rays) == 0 or power.shape != rays.shape[:1]:
        raise ValueError(f"light must be rays [m, 2, 3] with powers [m], got {[*rays.shape]} and {[*power.shape]}")
    field = light.field
    if field is not None and (
        not isinstance(field, torch.Tensor) or not field.is_complex() or field.shape != rays[:, 0].shape
    ):
        raise ValueError(f"light must have a complex field [m, 3] or None, got {field!r:.80}")
    return Light(torch.stack((rays[:, 0], unit(rays[:, 1])), 1), power, field)


def perpendicular(way: tuple[Any, ...], normal: tuple[Any, ...], otherwise: tuple[Any, ...]) -> tuple[Any, ...]:
    """Return unit vectors across the plane of incidence; others at normal incidence, where there is none."""
    found = vec.cross(way, normal)
    squared = vec.dot(found, found)
    oblique = squared > 1e-20
    size = torch.where(oblique, squared, 1.0).sqrt()
    return tuple(torch.where(oblique, v / size, o) for v, o in zip(found, otherwise, strict=True))


class _Walk:
    """What a trace has found so far, and the numbers that it needs at every step."""

    random: torch.Generator

    def __init__(self, scene: RayScene, wavelength, split: bool, size: float, paths: bool, least):
        self.scene, self.wavelength, self.split, self.size, self.least = scene, wavelength, split, size, least
        self.margin = 4096 * torch.finfo(wavelength.dtype).eps * size
        kind: dict[str, Any] = {"dtype": wavelength.dtype, "device": wavelength.device}
        self.index = [[torch.as_tensor(self._index(m), **kind) for m in item.media] for item in scene.elements]
        self.loss = [[self._absorption(m) for m in item.media] for item in scene.elements]
        self.films = [self._both_ways(item.interface.coating) for item in scene.elements]
        zero = torch.zeros_like(wavelength)
        self.absorbed = [zero for _ in scene.elements]
        self.media = self.escaped = self.cut = zero
        # Power that meets an element from another medium than the one that it came through.
        self.mixed = [zero for _ in scene.elements]
        self.arrived: dict[int, list[Any]] = {i: [] for i, item in enumerate(scene.elements) if item.detects}
        self.pieces: list[Any] | None = [] if paths else None

    def begin(self, rays, power, number, field, seed: int, bounces: int) -> "_Walk":
        """Return a walk of its own that has followed a block of rays to their ends."""
        walk = copy(self)
        walk.absorbed, walk.mixed, walk.arrived = list(self.absorbed), list(self.mixed), {i: [] for i in self.arrived}
        walk.pieces = None if self.pieces is None else []
        walk.random = torch.Generator(rays.device).manual_seed(seed)
        start, way = rays.unbind(1)
        none = torch.full_like(number, -1)
        held = () if field is None else vec.split(field)
        nowhere = torch.full_like(power, torch.nan)
        path = torch.zeros_like(power)
        state = _State(vec.split(start), vec.split(way), held, power, path, number, none, none, nowhere)
        walk.follow(state, bounces)
        return walk

    def _index(self, medium):
        if isinstance(medium, OpticalMaterial):
            return refractive_index(medium, self.wavelength, self.scene.unit, medium="air")
        return medium

    def _absorption(self, medium):
        if not isinstance(medium, OpticalMaterial) or extinction_of(medium) is None:
            return None
        return absorption_coefficient(medium, self.wavelength, self.scene.unit)

    @staticmethod
    def _both_ways(coating):
        if coating is None:
            return None
        return coating, coating if coating.substrate is not None else coating.reversed()

    def follow(self, state: _State, bounces: int) -> None:
        """Follow rays to their ends."""
        count = len(self.scene.elements)
        for step in range(bounces + 1):
            if len(state.power) == 0:
                return
            which = self._nearest(state, step)
            alive = state.power.detach() > self.least
            which = torch.where(alive if step < bounces else torch.zeros_like(alive), which, count + 1)
            order = which.argsort(stable=True)
            places = torch.arange(count + 2, device=which.device)
            # The one reading of the device in a step.
            counts = (which == places[:, None]).sum(1).tolist()
            groups = order.split(counts)
            self.cut = self.cut + state.power.index_select(0, groups[-1]).sum()
            self._escape(state, groups[-2])
            following = []
            for i, group in enumerate(groups[:-2]):
                if len(group):
                    following += self._act(i, state.take(group), step)
            if not following:
                return
            state = _joined(following)

    def _escape(self, state: _State, group) -> None:
        self.escaped = self.escaped + state.power.index_select(0, group).sum()
        if self.pieces is not None and len(group):
            gone = state.take(group)
            self._keep(gone, vec.along(gone.point, self.size, gone.direction))

    def _keep(self, state: _State, end: tuple[Any, ...]) -> None:
        if self.pieces is not None:
            ends = torch.stack([torch.stack(part, -1) for part in (state.point, end)], 1)
            self.pieces.append((ends.detach(), state.ray, state.power.detach()))

    @torch.no_grad()
    def _nearest(self, state: _State, step: int) -> torch.Tensor:
        """Return the number of the element that each ray meets first, the number of elements for none."""
        best = torch.full_like(state.power, torch.inf)
        which = torch.full_like(state.ray, len(self.scene.elements))
        for i, item in enumerate(self.scene.elements):
            point, direction = item._enter(state.point, state.direction)
            left = state.left == i if step else None
            distance = item._meet(point, direction, left, state.face, self.margin)[0]
            closer = distance < best
            best, which = torch.where(closer, distance, best), torch.where(closer, i, which)
        return which

    def _act(self, i: int, state: _State, step: int) -> list[_State]:
        """Return the rays into which rays split at an element."""
        item, interface = self.scene.elements[i], self.scene.elements[i].interface
        point, way = item._enter(state.point, state.direction)
        field = item._enter(state.field, state.field, False)[1] if state.field else ()
        left = state.left == i if step else None
        distance, place, normal, face = item._meet(point, way, left, state.face, self.margin)
        cosine = vec.dot(way, normal)
        forwards = cosine > 0
        sides = self._spread(i, cosine)
        indices: Any = [torch.where(forwards, *pair) for pair in (sides, sides[::-1])]
        n1, n2 = indices
        power, path = state.power, state.path + n1 * distance
        if interface.transmittance is None or interface.phase is not None or _is_open(interface.transmittance):
            # A number that is not known, that of a start, is no other one.
            other = (n1 - state.medium).abs().detach() > SAME_MEDIUM
            self.mixed[i] = self.mixed[i] + torch.where(other, power.detach(), 0.0).sum()
        if any(value is not None for value in self.loss[i]):
            losses: list[Any] = [(0.0 if value is None else value) + 0 * cosine for value in self.loss[i]]
            rate = torch.where(forwards, losses[0], losses[1])
            passed = power * torch.exp(-rate * distance)
            self.media, power = self.media + (power - passed).sum(), passed
        end = item._leave(place, True)
        self._keep(state, end)
        if item.detects:
            wave = (torch.stack(field, -1),) if field else ()
            self.arrived[i].append((torch.stack(place, -1), torch.stack(way, -1), power, path, state.ray, *wave))
        options = self._options(i, interface, (place, way, normal, field), (n1, n2, cosine), power, path)
        kept = sum((share for _, share, _, _ in options), torch.zeros_like(power))
        self.absorbed[i] = self.absorbed[i] + (power - kept).sum()
        if not self.split and len(options) > 1:
            options = [self._drawn(options)]
        if interface.scatter is not None:
            options = [one for option in options for one in self._scattered(interface.scatter, normal, *option)]
        state = state._replace(
            point=end,
            left=torch.full_like(state.left, i),
            face=state.face if face is None else face,
        )
        following = []
        for out, share, field, far in options:
            medium = torch.where((vec.dot(out, normal) > 0) == forwards, n2, n1).detach()
            wave = item._leave(field) if field else ()
            following.append(
                state._replace(direction=item._leave(out), power=share, field=wave, path=far, medium=medium)
            )
        return following

    def _spread(self, i: int, like) -> tuple[Any, ...]:
        return tuple(value + 0 * like for value in self.index[i])

    def _options(self, i: int, interface: Interface, ray: tuple, numbers, power, path) -> list[tuple[Any, ...]]:
        """Return directions, powers, fields and paths of the rays into which light is divided, before scattering."""
        place, way, normal, field = ray
        n1, n2, cosine = numbers
        axes: tuple[Any, ...] = ()
        if field:
            s = perpendicular(way, normal, axes_across(way)[0])
            p = vec.cross(way, s)
            axes = (s, vec.dot(field, s), vec.dot(field, p))

        def divided(out, exists, share, amplitudes=(1.0, 1.0), path=path):
            """Return one of the rays; `amplitudes` scale the two polarisations, `share` the power of both."""
            out = tuple(torch.where(exists, o, v) for o, v in zip(out, way, strict=True))
            if not field:
                return out, torch.where(exists, share * power, 0.0), (), path
            s, along_s, along_p = axes
            if interface.phase is not None:
                s = perpendicular(out, normal, s)
            along_s, along_p = amplitudes[0] * along_s, amplitudes[1] * along_p
            strength = along_s.abs().square() + along_p.abs().square()
            seen = exists & (strength > 0)
            size = torch.where(seen, strength, 1.0).sqrt()
            turned = vec.along(vec.scaled(s, along_s / size), along_p / size, vec.cross(out, s))
            turned = tuple(torch.where(seen, t, f) for t, f in zip(turned, field, strict=True))
            return out, torch.where(exists, share * strength * power, 0.0), turned, path

        if interface.phase is not None:
            found, covered = [], interface.phase.covers(*place[:2])
            sides: Any = ((True, interface.reflectance), (False, interface.transmittance))
            for reflects, shares in sides:
                for order, share in shares.items():
                    if not callable(share) and not isinstance(share, torch.Tensor) and share == 0:
                        continue
                    behind = n1 if reflects else n2
                    phase = replace(interface.phase, order=order)  # type: ignore[call-arg]
                    wave = self.wavelength.to(cosine)
                    out, through, added = phase.deflect(place, way, normal, n1, behind, wave, reflects)
                    value = share(torch.stack(place, -1), torch.stack(way, -1)) if callable(share) else share
                    found.append(divided(out, through & covered, value, path=path + added))
            return found
        if field and interface.reflectance is None:
            back, behind = self._amplitudes(i, interface, numbers)
            given = [(back and 1.0, back), (behind and 1.0, behind)]
        else:
            back, behind = self._shares(i, interface, numbers)
            given = [(back, (-1.0, 1.0)), (behind, (1.0, 1.0))]
        found = []
        if given[0][0] is not None:
            found.append(divided(reflected(way, normal), torch.ones_like(cosine, dtype=torch.bool), *given[0]))
        if given[1][0] is not None:
            bent, through, _ = refracted(way, normal, n1, n2)
            found.append(divided(bent, through, *given[1]))
        return found

    def _shares(self, i: int, interface: Interface, numbers) -> tuple[Any, ...]:
        """Return the fractions of the power that are reflected and transmitted; None for one that is always 0."""
        n1, n2, cosine = numbers
        incidence = cosine.abs().clamp(max=1.0)
        if interface.coating is not None:
            shares = [p and sum(v.abs().square() for v in p) / 2 for p in self._amplitudes(i, interface, numbers)]
            return tuple(shares)
        if interface.reflectance is None:
            back = fresnel_shares(incidence, n1, n2)
            return back, 1 - back
        given: tuple[Any, Any] = (interface.reflectance, interface.transmittance)
        back, behind = given
        if not isinstance(behind, torch.Tensor) and behind == 0:
            black = not isinstance(back, torch.Tensor) and back == 0
            return (None if black else back), None
        through = 1 - (n1 / n2) ** 2 * (1 - incidence * incidence) > 0
        return torch.where(through, back + 0 * incidence, back + behind), torch.where(through, behind, 0 * cosine)

    def _amplitudes(self, i: int, interface: Interface, numbers) -> tuple[Any, ...]:
        """Return the amplitudes of both polarisations, reflected and transmitted, of bare interfaces and films."""
        n1, n2, cosine = numbers
        incidence = cosine.abs().clamp(max=1.0)
        squared = 1 - (n1 / n2) ** 2 * (1 - incidence * incidence)
        through = squared > 0
        behind = safe_sqrt(torch.where(through, squared, 1.0))
        sides = self.films[i] or (Coating(), Coating())
        both = [films.amplitudes(n1, n2, incidence, behind, self.wavelength, self.scene.unit) for films in sides]
        dtype = torch.complex64 if cosine.dtype == torch.float32 else torch.complex128
        pairs: list[Any] = list(zip(*both, strict=True))
        back_s, back_p, on_s, on_p = (torch.where(cosine > 0, a, b).to(dtype) for a, b in pairs)
        if interface.coating is not None and interface.coating.substrate is not None:
            return (back_s, back_p), None
        return (back_s, back_p), tuple(torch.where(through, value, 0.0) for value in (on_s, on_p))

    def _uniform(self, like) -> torch.Tensor:
        return torch.rand(len(like), generator=self.random, dtype=like.dtype, device=like.device)

    def _drawn(self, options: list[tuple[Any, ...]]) -> tuple[Any, ...]:
        """Return one of several rays, drawn by its share of the power, with the power of all."""
        shares = [share.detach() for _, share, _, _ in options]
        total = sum(shares)
        pick = self._uniform(total) * total
        out, power, field, path = options[0]
        reached = shares[0]
        for other, share, wave, way in options[1:]:
            beyond = (pick >= reached) & (share.detach() > 0)
            out = tuple(torch.where(beyond, a, b) for a, b in zip(other, out, strict=True))
            field = tuple(torch.where(beyond, a, b) for a, b in zip(wave, field, strict=True))
            power = torch.where(beyond, share, power)
            path = path if way is path else torch.where(beyond, way, path)
            reached = reached + share.detach()
        held = power.detach()
        if needs_gradient(power):
            return out, power * torch.where(held > 0, total / torch.where(held > 0, held, 1.0), 0.0), field, path
        return out, torch.where(held > 0, total, 0.0), field, path

    def _scattered(self, scatter: Scatter, normal, out, power, field, path) -> list[tuple[Any, ...]]:
        """Return what is scattered of light that leaves a surface, and what is not."""
        first, second = axes_across(normal)
        along, across = scatter._draw(
            vec.dot(out, first), vec.dot(out, second), self._uniform(power), self._uniform(power)
        )
        squared = 1 - along * along - across * across
        leaves = squared > 0
        height = torch.copysign(safe_sqrt(torch.where(leaves, squared, 1.0)), vec.dot(out, normal))
        turned = vec.along(vec.along(vec.scaled(first, along), across, second), height, normal)
        turned = tuple(torch.where(leaves, t, o) for t, o in zip(turned, out, strict=True))
        wave = ()
        if field:
            angle = 2 * math.pi * self._uniform(power)
            x, y = axes_across(turned)
            drawn = vec.along(vec.scaled(x, angle.cos()), angle.sin(), y)
            wave = tuple(torch.where(leaves, d.to(f.dtype), f) for d, f in zip(drawn, field, strict=True))
        share = scatter.share
        if not isinstance(share, torch.Tensor) and share == 1:
            return [(turned, power, wave, path)]
        weak = torch.where(leaves, share * power, 0.0)
        options = [(out, power - weak, field, path), (turned, weak, wave, path)]
        return options if self.split else [self._drawn(options)]

    def result(self, emitted, walks: list["_Walk"]) -> SceneLight:
        """Return what walks have found together."""
        received = {}
        for i in self.arrived:
            parts = [part for walk in walks for part in walk.arrived[i]]
            if not parts:
                none = emitted.new_zeros(0)
                rays = torch.zeros(0, dtype=torch.int64, device=none.device)
                parts = [(none.reshape(0, 3), none.reshape(0, 3), none, none, rays)]
            received[self.scene.names[i]] = Received(*map(torch.cat, zip(*parts, strict=True)))
        pieces: Any = (None, None, None)
        if self.pieces is not None:
            held = [piece for walk in walks for piece in walk.pieces or ()]
            pieces = (torch.cat(part) for part in zip(*held, strict=True))
        absorbed, mixed = (
            torch.stack([torch.stack(getattr(w, n)) for w in walks]).sum(0) for n in ("absorbed", "mixed")
        )
        # What leaves a lens through its edge, which is no element, and meets the next lens is little.
        shares = (mixed / emitted.detach()).tolist()
        wrong = {name: share for name, share in zip(self.scene.names, shares, strict=True) if share > MIXED}
        if wrong:
            found = ", ".join(f"{name!r} ({100 * share:.0f} % of the light)" for name, share in wrong.items())
            warn(
                f"light meets {found} in another medium than the one in which it left the element before: media of "
                "adjoining elements must agree",
                AccuracyWarning,
            )
        media, escaped, cut = (torch.stack([getattr(w, n) for w in walks]).sum() for n in ("media", "escaped", "cut"))
        return SceneLight(emitted, absorbed, media, escaped, cut, received, *pieces)
