"""Optical systems: surfaces, their coatings, coordinate breaks, their sequence, and their numbers as tensors."""

import copy
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from dataclasses import fields as fields_of
from itertools import pairwise
from numbers import Number, Real
from typing import Any, ClassVar, NamedTuple, SupportsComplex, cast

import numpy as np
import torch

from odak import _show, _validate
from odak._array import Amount, Array, complex_dtype, is_array, is_complex, is_readable, namespace
from odak._lengths import film_in, in_unit, light_in
from odak._warnings import ArgumentWarning, warn
from odak.catalog.materials import MICROMETRES, OpticalMaterial, refractive_index
from odak.catalog.materials import material as find_material
from odak.jones.thin_films import stack_response
from odak.learn.raytracing.system.films import PolarizingFilm
from odak.learn.raytracing.system.prescriptions import Prescription, checked_prescription, padded
from odak.learn.raytracing.system.sequence import STANDARD, Frames, Layout, axis_signs, placement
from odak.learn.raytracing.system.specification import (
    AIR,
    MIRROR,
    Conjugates,
    Fields,
    Medium,
    SystemAperture,
    SystemRecord,
    Wavelengths,
    checked_medium,
    checked_settings,
    checked_wavelengths,
    number_or_infinity,
    plain,
)
from odak.raytracing.apertures import Aperture, CircularAperture, CombinedAperture
from odak.raytracing.components import terms
from odak.raytracing.gradients import Gradient
from odak.raytracing.interfaces import IdealLens, Phase
from odak.raytracing.surfaces import Conic, EvenAsphere, Plane, Shape


class Amplitudes(NamedTuple):
    """Amplitude coefficients whose squared moduli are fractions of the power of a ray.

    Attributes
    ----------
    reflected_s, reflected_p, transmitted_s, transmitted_p : array
        Complex ``[...]``. Those of transmission are the coefficients of the electric field times
        √(n₂·cos θ₂/(n₁·cos θ₁)).
    """

    reflected_s: Any
    reflected_p: Any
    transmitted_s: Any
    transmitted_p: Any


@dataclass(frozen=True)
class Coating:
    """A stack of thin films on a surface; without any film, the bare interface.

    Parameters
    ----------
    media : sequence
        Films in the order in which light passes them: names of the catalogue, Materials, or indices valid for all
        wavelengths, complex for absorbing films (n + iκ, κ ≥ 0).
    thicknesses : sequence or array
        Thickness of each film; texts have units of their own, such as "100nm".
    substrate : str, OpticalMaterial or number, optional
        What is behind the films of a mirror: a metal's complex index, or the medium on the other side where light is
        reflected totally or in part. Of refracting surfaces it is the medium behind, and this must be left out.
    unit : str, optional
        Unit of the thicknesses, that of the system by default, of texts "mm".

    Examples
    --------
    >>> from odak.learn.raytracing.system import Coating
    >>> Coating.quarter_waves([1.38], 550e-6).thicknesses[0] > 99e-6
    True
    """

    media: Sequence[Any] = ()
    thicknesses: Sequence[float | Array | str] | Array = ()
    substrate: str | OpticalMaterial | complex | None = None
    unit: str | None = None
    fixed: ClassVar[tuple[str, ...]] = ("media", "substrate", "unit")

    def __post_init__(self) -> None:
        media, thicknesses = self.media, self.thicknesses
        if self.unit is not None or (isinstance(thicknesses, (list, tuple)) and str in map(type, thicknesses)):
            unit = _validate.one_of("unit", self.unit or "mm", MICROMETRES)
            object.__setattr__(self, "unit", unit)
            object.__setattr__(self, "thicknesses", in_unit("thicknesses", thicknesses, unit))
        if isinstance(media, (str, bytes)) or not isinstance(media, Sequence):
            raise TypeError(f"media must be a sequence of names, materials or indices, got {type(media).__name__}")
        substrate = None if self.substrate is None else _coating_medium("substrate", self.substrate)
        object.__setattr__(self, "media", tuple(_coating_medium(f"media[{i}]", value) for i, value in enumerate(media)))
        object.__setattr__(self, "substrate", substrate)
        count = len(terms(self.thicknesses))
        if count != len(self.media):
            raise ValueError(f"thicknesses must have one entry for each of {len(self.media)} media, got {count}")

    @classmethod
    def quarter_waves(cls, media: Sequence[Any], wavelength: float | str, unit: str = "mm") -> "Coating":
        """Return a stack of films a quarter of a wave thick at normal incidence.

        Parameters
        ----------
        media : sequence
            Films in the order in which light passes them: names of the catalogue, Materials or indices.
        wavelength : float or str
            Design wavelength; a text has a unit of its own, "550nm".
        unit : str
            Unit of the system, in which the thicknesses are; of a bare number too.

        Returns
        -------
        Coating
            λ/(4n) thick each, n the real part of the index.
        """
        unit = _validate.one_of("unit", unit, MICROMETRES)
        wavelength = _validate.number("wavelength", light_in("wavelength", wavelength, unit), positive=True)
        found = cls(media, [0.0] * len(media))
        indices = [_index(value, wavelength, unit) for value in found.media]
        return replace(found, thicknesses=[float(wavelength / 4 / complex(index).real) for index in indices])

    def reversed(self) -> "Coating":
        """Return the stack for light from the other side."""
        if self.substrate is not None:
            raise ValueError("substrate is the end of the stack, from which no light is incident")
        values = self.thicknesses
        turned = namespace(values).flip(values) if is_array(values) else list(values)[::-1]
        return replace(self, media=self.media[::-1], thicknesses=turned)

    def amplitudes(
        self,
        n1: Amount,
        n2: Amount,
        cosine: Amount,
        cosine_behind: Amount,
        wavelength: Amount,
        unit: str = "mm",
    ) -> Amplitudes:
        """Return the amplitude coefficients of rays.

        Parameters
        ----------
        n1, n2 : float or array
            Indices in front and behind, `n2` without effect where there is a substrate.
        cosine, cosine_behind : float or array
            Cosines of the angles of incidence and refraction, positive.
        wavelength : float or array
            In vacuum.
        unit : str
            Of the wavelength.

        Returns
        -------
        Amplitudes
            complex128, of the shape of `cosine`.

        Notes
        -----
        :func:`odak.jones.thin_film_stack`, with the signs of Born and Wolf: r_p = −r_s at normal incidence.
        """
        cosine = cosine if is_array(cosine) else np.asarray(cosine, dtype=np.float64)
        xp = namespace(cosine)
        n1, n2, cosine, wavelength = (
            xp.astype(value + 0 * cosine, xp.float64) for value in (n1, n2, cosine, wavelength)
        )
        behind = n2 if self.substrate is None else _index(self.substrate, wavelength, unit)
        films = [_index(value, wavelength, unit) for value in self.media]
        indices = [n1, *(value + 0 * cosine for value in (*films, behind))]
        transverse = n1 * xp.where(cosine < 1, 1 - cosine * cosine, 0.0) ** 0.5
        scale = 1.0
        if self.unit is None:
            film_in("thicknesses of a coating", list(terms(self.thicknesses)), wavelength, unit)
        else:
            scale = MICROMETRES[self.unit] / MICROMETRES[unit]
        thicknesses = [scale * value + 0 * cosine for value in terms(self.thicknesses)]
        found = [stack_response(xp, wavelength, indices, thicknesses, transverse, cosine, p) for p in ("s", "p")]
        dtype = complex_dtype(cosine)
        scale = xp.astype((n2 * cosine_behind / (n1 * cosine)) ** 0.5, dtype)
        return Amplitudes(found[0].r, found[1].r, found[0].t * scale, found[1].t * scale)


def _coating_medium(name: str, value):
    """Return a catalogue's material, or an index as a number."""
    if isinstance(value, OpticalMaterial):
        return value
    if isinstance(value, str):
        return 1.0 if value.casefold() == "air" else find_material(value)
    if isinstance(value, (list, tuple)) and len(value) == 2:
        value = complex(*value)
    if isinstance(value, bool) or not isinstance(value, Number):
        raise TypeError(f"{name} must be a name, an OpticalMaterial or an index, got {type(value).__name__}")
    number = complex(cast(SupportsComplex, value))  # Number itself promises no conversion
    if not (0 < abs(number) < float("inf")) or number.imag < 0 or number.real < 0:
        raise ValueError(f"{name} must be an index n + iκ with n, κ ≥ 0, not 0, got {value}")
    return number if number.imag else number.real


def _index(medium, wavelength: Array | float, unit: str):
    """Return the index of a medium at wavelengths, relative to air."""
    if not isinstance(medium, OpticalMaterial):
        return medium
    return refractive_index(medium, wavelength, _validate.one_of("unit", unit, MICROMETRES), medium="air")


D_LINE = 0.5875618  # micrometres
# Radius of a beam over the radius of a surface above which no ray of it is left; of immersion lenses it may be some.
STEEPEST = 20.0
ORDERS = ("shift", "tilt")
VARIABLES = ("curvature", "radius", "conic", "coefficients", "thickness", "index", "shift", "tilt")


class _Parameters(torch.nn.Module):
    """Parameters of a shape, a phase or a film as buffers, any of which may become a torch.nn.Parameter."""

    def __init__(self, name: str, given: Any):
        super().__init__()
        self.kind: type[Any] = type(given)
        for field in fields_of(given):
            value = getattr(given, field.name)
            if field.name in given.fixed:
                setattr(self, field.name, value)
                continue
            value = list(value) if isinstance(value, tuple) else value
            if not is_complex(value) and not (isinstance(value, list) and not value):
                value = _validate.real(f"{name}.{field.name}", value)
            _hold(self, field.name, value)

    def build(self) -> Any:
        """Return the shape, phase or film with the current parameters."""
        return self.kind(*(getattr(self, field.name) for field in fields_of(self.kind)))


class surface(torch.nn.Module):
    """A surface and the medium behind it; lengths in the system's unit.

    Parameters
    ----------
    radius : float or torch.Tensor
        Radius of curvature, positive with the centre behind the vertex; infinite for a plane.
    curvature : float or torch.Tensor, optional
        1/radius, in its place. The better variable of the two: it passes through the plane smoothly.
    conic : float or torch.Tensor
        Conic constant k: 0 a sphere, −1 a paraboloid.
    coefficients : sequence of float or torch.Tensor
        Of r², r⁴, r⁶, …, added to the conic.
    shape : odak.raytracing.Shape, optional
        Any other shape, in place of the four above: a Toroid, a ZernikeFreeform, a class of one's own.
    thickness : float or torch.Tensor
        Distance to the next vertex, or from the last surface to the image plane. Negative after a mirror.
    material : str, float, torch.Tensor or OpticalMaterial
        Medium behind it: a name of :func:`odak.catalog.material_names`, "air" (index 1), "mirror", or an index that
        holds for all wavelengths.
    semi_diameter : float, optional
        Distance from the axis beyond which rays are vignetted.
    aperture : odak.raytracing.apertures.Aperture or sequence of them, optional
        Further limits: rectangles, ellipses, polygons, rings, obscurations.
    phase : odak.raytracing.interfaces.Phase, optional
        A grating, a hologram, a phase polynomial or an ideal lens on it.
    gradient : odak.raytracing.gradients.Gradient, optional
        Graded index of the medium behind it, of which `material` gives the base index; up to the next surface.
    coating : Coating or PolarizingFilm, optional
        Thin films on it, or a polariser, wave plate or half mirror, which :func:`polarized_trace` takes into account; a
        mirror without is ideal, any other surface without is bare.
    stop : bool
        Whether it is the aperture stop.
    shift : sequence of float or torch.Tensor
        Of this surface alone: position (x, y) of its vertex off the axis.
    tilt : sequence of float or torch.Tensor
        Of this surface alone: rotations in degrees about x, then about y; a third number rotates it about its own z
        first. The axis goes on as if it were not tilted: for folds use :class:`coordinate_break`.

    Raises
    ------
    ValueError
        If a number is out of range, or the material unknown: the message names the nearest known ones.

    Notes
    -----
    A `torch.nn.Parameter` stays one. :meth:`vary` makes parameters of numbers.

    Examples
    --------
    >>> from odak.learn.raytracing.system import surface
    >>> front = surface(radius=51.5, thickness=4.0, material="N-BK7", semi_diameter=12.5)
    >>> float(front.radius)
    51.5
    """

    radius_value: torch.Tensor
    curvature_value: torch.Tensor
    conic: torch.Tensor
    coefficients: torch.Tensor
    thickness: torch.Tensor
    shift: torch.Tensor
    tilt: torch.Tensor
    index: torch.Tensor
    order: str | int | None = None

    own_shape: _Parameters | None
    own_phase: _Parameters | None
    own_gradient: _Parameters | None

    @_validate.takes_units()
    def __init__(
        self,
        radius: float = math.inf,
        *,
        curvature: float | None = None,
        conic: float = 0.0,
        coefficients: Sequence[float] = (),
        shape: Shape | None = None,
        thickness: float = 0.0,
        material: Medium = "air",
        semi_diameter: float | None = None,
        aperture: Aperture | Sequence[Aperture] | None = None,
        phase: Phase | None = None,
        gradient: Gradient | None = None,
        coating: Coating | PolarizingFilm | None = None,
        stop: bool = False,
        shift: Sequence[float] = (0.0, 0.0),
        tilt: Sequence[float] = (0.0, 0.0),
    ):
        super().__init__()
        if shape is not None and type(shape) in STANDARD:
            curvature, conic = shape.base()
            coefficients = getattr(shape, "coefficients", ())
            shape = None
        if isinstance(radius, torch.nn.Parameter):
            _hold(self, "radius_value", radius)
        elif curvature is None:
            (radius,) = _validate.constants(radius=radius)
            value = float(number_or_infinity("radius", radius))
            if value == 0:
                raise ValueError(f"radius must not be 0, got {value}")
            # The number as given, without rounding.
            _hold(self, *(("curvature_value", 0.0) if math.isinf(value) else ("radius_value", value)))
        else:
            _hold(self, "curvature_value", _validate.real("curvature", curvature))
        _hold(self, "conic", _validate.real("conic", conic))
        coefficients = _listed("coefficients", coefficients)
        _hold(self, "coefficients", _validate.real("coefficients", coefficients) if len(coefficients) else coefficients)
        for name, given, kind in (("shape", shape, Shape), ("phase", phase, Phase), ("gradient", gradient, Gradient)):
            setattr(self, f"own_{name}", None if given is None else _Parameters(name, _checked(name, given, kind)))
        _hold(self, "thickness", _validate.real("thickness", thickness))
        _hold(self, "shift", _several("shift", shift, (2,)))
        _hold(self, "tilt", _several("tilt", tilt, (2, 3)))
        self.material: Any = checked_medium(material)
        if isinstance(self.material, (Real, torch.Tensor)):
            _hold(self, "index", _validate.real("material", material, positive=True))
            self.material = None
        if gradient is not None and self.material == MIRROR:
            raise ValueError(
                "gradient belongs to the medium behind a surface that refracts, not to a mirror, got "
                f"{type(gradient).__name__}"
            )
        self.own_coating: _Parameters | None = None
        self.coating = coating
        self.semi_diameter = semi_diameter
        if semi_diameter is not None:
            self.semi_diameter = _validate.constant("semi_diameter", semi_diameter, positive=True)
        parts = [] if aperture is None else aperture if isinstance(aperture, (list, tuple)) else [aperture]
        self.apertures: tuple[Aperture, ...] = tuple(_checked("aperture", part, Aperture) for part in parts)
        self.stop: bool = _validate.flag("stop", stop)

    @property
    def curvature(self) -> torch.Tensor:
        """1/radius; of other shapes, the vertex curvature along y."""
        if self.own_shape is not None:
            return torch.as_tensor(self.own_shape.build().curvatures()[1], dtype=torch.float64)
        return 1 / self.radius_value if _has(self, "radius_value") else self.curvature_value

    @property
    def radius(self) -> torch.Tensor:
        """Radius of curvature, infinite for a plane; for other shapes, the radius at the vertex along y."""
        return self.radius_value if _has(self, "radius_value") else 1 / self.curvature

    @property
    def shape(self) -> Shape:
        """Shape of the surface, with its current parameters."""
        if self.own_shape is not None:
            return self.own_shape.build()
        if self.coefficients.numel():
            return EvenAsphere(self.curvature, self.conic, self.coefficients)
        return Conic(self.curvature, self.conic)

    @property
    def phase(self) -> Phase | None:
        """Diffractive phase on the surface, with its current parameters."""
        return None if self.own_phase is None else self.own_phase.build()

    @property
    def gradient(self) -> Gradient | None:
        """Graded index of the medium behind the surface, with its current parameters."""
        return None if self.own_gradient is None else self.own_gradient.build()

    @property
    def coating(self) -> Coating | PolarizingFilm | None:
        """Films on the surface, with their current parameters; may be assigned."""
        return None if self.own_coating is None else self.own_coating.build()

    @coating.setter
    def coating(self, value: Coating | PolarizingFilm | None) -> None:
        if isinstance(value, PolarizingFilm):
            if self.material == MIRROR and not value.reflects:
                raise ValueError(f"coating of a mirror must reflect light, got {value!r:.120}")
        elif value is not None:
            _validate.instance("coating", value, Coating, "a Coating or a PolarizingFilm")
            if value.substrate is not None and self.material != MIRROR:
                raise ValueError(
                    "substrate of a coating belongs to mirrors: of other surfaces it is the medium behind; got "
                    f"{value.substrate!r:.80}"
                )
        self.own_coating = None if value is None else _Parameters("coating", value)

    @property
    def limit(self) -> Any:
        """Aperture: a semi-diameter, an object with a method ``passes(x, y)``, or None."""
        if not self.apertures:
            return self.semi_diameter
        rim = () if self.semi_diameter is None else (CircularAperture(radius=self.semi_diameter),)
        parts = (*rim, *self.apertures)
        return parts[0] if len(parts) == 1 else CombinedAperture(parts)

    @property
    def reflects(self) -> bool:
        """Whether it is a mirror."""
        return self.material == MIRROR

    @property
    def is_off_axis(self) -> bool:
        """Whether it is shifted or tilted, or has parameters for that."""
        return any(value.requires_grad or bool(value.any()) for value in (self.shift, self.tilt))

    def vary(self, name: str) -> torch.nn.Parameter:
        """Make a parameter of a number, and return it.

        Parameters
        ----------
        name : str
            "curvature", "radius", "conic", "coefficients", "thickness", "index" (of a material given as a number),
            "shift" or "tilt"; or a parameter of the shape, the phase or the gradient ("coefficients" belongs to the
            first of them that has any); "thicknesses" of thin films, or a parameter of a polarising film.
        """
        for held in (self.own_shape, self.own_phase, self.own_gradient, self.own_coating):
            if held is not None and isinstance(name, str) and _has(held, name):
                return _vary(held, name)
        name = _validate.one_of("name", name, VARIABLES)
        if name in ("curvature", "radius") and self.own_shape is None:
            value = getattr(self, name).detach()
            if not bool(torch.isfinite(value)):
                raise ValueError("the radius of a plane cannot be varied; vary its curvature")
            for old in ("curvature_value", "radius_value"):
                if _has(self, old) and old != f"{name}_value":
                    delattr(self, old)
                    self.register_buffer(f"{name}_value", value.clone())
            name = f"{name}_value"
        elif name in ("curvature", "radius", "conic", "coefficients") and self.own_shape is not None:
            known = ", ".join(field.name for field in fields_of(self.own_shape.kind))
            raise ValueError(f"{name} is no parameter of a {self.own_shape.kind.__name__}: it has {known}")
        elif not _has(self, name):
            raise ValueError(
                f"{name} of this surface cannot be varied: its material is {self.material!r}, not a number"
            )
        return _vary(self, name)

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.extra_repr()})"

    def extra_repr(self) -> str:
        """Return the surface in a line."""
        medium = getattr(self.material, "name", self.material)
        medium = f"index {float(self.index.detach()):g}" if medium is None else medium
        shown = {"radius": self.radius, "conic": self.conic, "coefficients": self.coefficients}
        if self.own_shape is not None:
            shown = {"shape": self.own_shape.kind.__name__}
        shown |= {
            "thickness": self.thickness,
            "material": medium,
            "semi_diameter": self.semi_diameter and f"{self.semi_diameter:.6g}",
        }
        held = {"phase": self.own_phase, "gradient": self.own_gradient}
        shown |= {name: part.kind.__name__ for name, part in held.items() if part is not None}
        shown |= {"aperture": ", ".join(type(part).__name__ for part in self.apertures), "coating": self.coating}
        shown |= {"shift": self.shift, "tilt": self.tilt, "stop": self.stop}
        parts = []
        for name, value in shown.items():
            if isinstance(value, torch.Tensor):
                numbers = [f"{number:.6g}" for number in value.detach().reshape(-1).tolist()]
                empty = set(numbers) <= {"0", "-0"} and name not in ("radius", "thickness")
                value = "" if empty else numbers[0] if value.ndim == 0 else f"[{', '.join(numbers)}]"
            if value:
                parts.append(f"{name}={value}")
        return ", ".join(parts)


class coordinate_break(surface):
    """A change of the axis: all following surfaces stand in the new frame.

    Parameters
    ----------
    shift : sequence of float or torch.Tensor
        Of the new origin along x and y.
    tilt : sequence of float or torch.Tensor
        Rotations in degrees about x, y and z, right-handed.
    thickness : float or torch.Tensor
        Distance along the new axis to the next vertex.
    order : str
        "shift": shifted first, then rotated about x, the new y and the new z. "tilt": rotated about z, the new y and
        the new x, then shifted along the new axes: the inverse of the former with the signs of all numbers changed.
    return_to : int, optional
        Number of an earlier surface whose frame is taken again, whatever came between; `shift` and `tilt` must be
        left out then.

    Notes
    -----
    A fold by 90° is a break of 45°, a mirror, and a second break of 45°, with negative thicknesses behind the mirror.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.raytracing.system import coordinate_break, optical_system, surface, trace
    >>> turn = {"tilt": (45.0, 0.0, 0.0)}
    >>> fold = optical_system(
    ...     [
    ...         surface(thickness=10.0),
    ...         coordinate_break(**turn),
    ...         surface(material="mirror"),
    ...         coordinate_break(**turn, thickness=-20.0),
    ...     ],
    ...     aperture=2.0,
    ... )
    >>> ray = torch.tensor([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], dtype=torch.float64)
    >>> float(trace(fold, ray).path)
    30.0
    """

    def __init__(
        self,
        shift: Sequence[float] = (0.0, 0.0),
        tilt: Sequence[float] = (0.0, 0.0, 0.0),
        thickness: float = 0.0,
        *,
        order: str = "shift",
        return_to: int | None = None,
    ):
        tilt = _several("tilt", tilt, (2, 3))
        tilt = [*tilt, 0.0] if len(tilt) == 2 and not isinstance(tilt, torch.Tensor) else tilt
        super().__init__(thickness=thickness, shift=shift, tilt=tilt)
        self.order: str | int = _validate.one_of("order", order, ORDERS)
        if return_to is not None:
            self.order = _validate.integer("return_to", return_to)
            if self.is_off_axis:
                raise ValueError("return_to gives the frame: shift and tilt must be left out")

    def extra_repr(self) -> str:
        """Return the break in a line."""
        shift, tilt = self.shift.tolist(), self.tilt.tolist()
        return f"shift={shift}, tilt={tilt}, thickness={float(self.thickness.detach()):g}, order={self.order!r}"


def is_break(item: Any) -> bool:
    """Return whether an item of a system is a coordinate break."""
    return isinstance(item, coordinate_break)


def is_glass(surfaces: Any, i: int) -> bool:
    """Return whether there is glass behind surface `i`; behind a coordinate break the medium is that in front of it."""
    while i >= 0 and is_break(surfaces[i]):
        i -= 1
    return i >= 0 and not surfaces[i].reflects and surfaces[i].material != "air"


def drawn_radii(surfaces: Any, reaches: Any) -> list[float]:
    """Return the radius to which drawings show each surface.

    It is the semi-diameter or the reach of the smallest aperture, otherwise 1.05 times the largest distance of a ray
    from the vertex; the two faces of a lens without apertures share the larger one.

    Parameters
    ----------
    surfaces : sequence of surface or None
        The surfaces; None is a plane without a rim.
    reaches : sequence of float
        Largest distance of a ray from the vertex of each.
    """
    radii = []
    for item, reach in zip(surfaces, reaches, strict=True):
        rim = None if item is None else item.semi_diameter
        parts = () if item is None else [part.reach() for part in item.apertures if not part.obscures]
        radii.append(float(rim or min(parts, default=0.0) or 1.05 * float(reach) or 1.0))
    for i in range(len(radii) - 1):
        free = all(item.limit is None and not is_break(item) for item in surfaces[i : i + 2])
        if free and is_glass(surfaces, i):
            radii[i] = radii[i + 1] = max(radii[i], radii[i + 1])
    return radii


def _has(module, name: str) -> bool:
    return name in module._parameters or name in module._buffers


def _hold(module, name: str, value) -> None:
    if isinstance(value, torch.nn.Parameter):
        module.register_parameter(name, value)
    elif isinstance(value, torch.Tensor):
        if value.requires_grad:
            raise TypeError(
                f"{name} must be a number, a tensor without gradient or a torch.nn.Parameter, got a tensor of a graph"
            )
        module.register_buffer(name, value.detach().to(torch.complex128 if value.is_complex() else torch.float64))
    else:
        dtype = torch.complex128 if is_complex(value) else torch.float64
        module.register_buffer(name, torch.as_tensor(value, dtype=dtype).clone())


def _vary(module, name: str) -> torch.nn.Parameter:
    if name in module._parameters:
        return getattr(module, name)
    value = getattr(module, name).detach()
    if value.numel() == 0:
        raise ValueError(f"{name} of this surface is empty; give it zeros to vary")
    delattr(module, name)
    module.register_parameter(name, torch.nn.Parameter(value.clone()))
    return getattr(module, name)


def _checked(name: str, value, kind: type[Any]):
    _validate.instance(name, value, kind, f"a {kind.__name__} of odak.raytracing")
    return value


def _listed(name: str, values):
    if isinstance(values, torch.Tensor):
        return values
    _validate.listed(name, values, "a sequence of numbers")
    return [_validate.constant(name, value) for value in values]


def _several(name: str, values, counts: tuple[int, ...]):
    values = _validate.real(name, _listed(name, values))
    if len(values) not in counts:
        accepted = "two numbers (x, y)" + (" or three (x, y, z)" if 3 in counts else "")
        raise ValueError(f"{name} must be {accepted}, got {values!r}")
    return values


def layout_of(
    surfaces: "Sequence[surface]", prescription: Prescription, image: "surface | None" = None, vignetting: bool = True
) -> Layout:
    """Return the layout of a row of surfaces and the image behind it.

    Parameters
    ----------
    surfaces : sequence of surface
        The surfaces.
    prescription : Prescription
        Their numbers: a surface is plane only if no number bends it and none is being varied.
    image : surface, optional
        The image surface; a plane by default.
    vignetting : bool
        Let apertures block rays.

    Raises
    ------
    ValueError
        If the axis does not meet a surface: a fold without coordinate breaks.
    """
    kinds, actions, limits, orders = [], [], [], []
    before = _key_of(getattr(surfaces, "front", AIR))
    p = prescription
    for i, item in enumerate(surfaces):
        shape = None if p.shapes is None else p.shapes[i]
        kinds.append(_kind(p.curvature[..., i], p.coefficients[..., i, :]) if shape is None else type(shape))
        medium = before if item.reflects or is_break(item) else _medium_key(item)
        action = (
            "break" if is_break(item) else "reflect" if item.reflects else "pass" if medium == before else "refract"
        )
        actions.append(action)
        limits.append(item.limit if vignetting else None)
        orders.append(item.order)
        before = medium
    if image is None:
        kinds.append(Plane)
    else:
        kinds.append(_kind(image.curvature, image.coefficients) if image.own_shape is None else image.own_shape.kind)
    limits.append(image.limit if image is not None and vignetting else None)
    actions, orders = [*actions, "pass"], [*orders, None]
    phases, media = (
        tuple(None if held is None else type(held) for held in (*(group or ()), None)) for group in p._groups()[1:]
    )
    slanted = image is not None and image.is_off_axis
    placed = slanted or p.shift is not None or p.tilt is not None or "break" in actions
    signs, sign = [], 1
    for action in actions:
        signs.append(sign)
        sign = -sign if action == "reflect" else sign
    if placed:
        signs = _signs_along_axis(p, image, actions, orders) or signs
    parts = tuple(kinds), tuple(actions), tuple(signs), tuple(limits)
    return Layout(*parts, phases if any(phases) else (), tuple(orders), media if any(media) else (), bool(placed))


def _signs_along_axis(p: Prescription, image, actions, orders) -> list[int] | None:
    """Return the signs with which the axis meets the surfaces of the first system of a batch."""
    if not all(value is None or is_readable(value) for value in (p.shift, p.tilt, p.thickness)):
        return None
    with torch.no_grad():
        numbers = p.numbers(image)
        shift, tilt = numbers.shift, numbers.tilt
        if shift is None or tilt is None or not len(shift):
            return None
        return axis_signs(shift[0], tilt[0], actions, orders, numbers.distance[0])


def _kind(curvature: torch.Tensor, coefficients: torch.Tensor) -> type[Shape]:
    if (coefficients.requires_grad and coefficients.shape[-1]) or _any(coefficients):
        return EvenAsphere
    return Conic if curvature.requires_grad or _any(curvature) else Plane


def _any(value: torch.Tensor) -> bool:
    """Return whether any number is not zero; True where they cannot be read, as on a GPU without waiting for it."""
    if value.numel() == 0 or not is_readable(value):
        return value.numel() > 0
    return bool(value.detach().any())


def _medium_key(item) -> tuple[Any, ...]:
    if item.material is None or item.own_gradient is not None:
        return ("index", id(item))
    return _key_of(item.material)


def _key_of(material) -> tuple[Any, ...]:
    if isinstance(material, (str, Real)):
        return (material,)
    # The numbers of the medium, not its name, which two materials of a user may share.
    return (material.formula, repr(sorted(material.coefficients.items())), material.relative_to)


class optical_system(torch.nn.Module):
    """A sequential optical system: light passes its surfaces one after the other, from −z to the image plane.

    Parameters
    ----------
    surfaces : sequence of surface
        In the order in which light meets them, coordinate breaks among them. The image plane follows, at the last
        one's thickness.
    aperture : float, torch.Tensor or SystemAperture
        Diameter of the entrance pupil; the object states other sizes.
    fields : sequence or Fields
        Field points, numbers y or pairs (x, y); the object has their weights and vignetting factors too. The axis by
        default.
    wavelengths : float, str, sequence of them or Wavelengths
        Vacuum wavelengths in `unit`, or texts with units of their own such as "550nm"; the object has their weights and
        the reference too. The d line by default.
    conjugates : Conjugates
        Distance and medium of the object, and whether the image is at infinity. By default the object is infinitely
        far away, in air.
    image : surface, optional
        Shape of the image surface: a curved sensor, a retina, a tilted plane. It may have a shape, a semi-diameter,
        apertures, a shift and a tilt; a thickness, a material, a phase, a gradient, a coating or a mark as the stop
        raise ValueError. A plane by default.
    unit : str
        Unit of all lengths, wavelengths included: "mm", "m", "um" or "nm".
    name : str or SystemRecord
        Name of the system; the object has its source and its zoom positions too.

    Raises
    ------
    ValueError, TypeError
        If an argument is outside its range, naming it.

    Notes
    -----
    If no surface is marked as the stop, the first one is the stop. Indices come from the catalogue and are
    relative to air. Where the stop lies in the rear focal plane of the surfaces in front of it, the system is
    telecentric in object space: the entrance pupil is at infinity, and the aperture must be given as "NA" or "stop".

    Vignetting factors are defined as in OpticStudio (its help, Conventions and Definitions): a decentre and a
    compression of the pupil, after which the rays of a field fill the part that apertures leave open. They hold
    wherever rays are launched from one of the system's own field points, and move the chief ray, which goes through the
    centre of the vignetted pupil. Other field points have the whole pupil.

    Aperture, fields and distance of the object may be tensors that require gradients: gradients by them pass through
    tracing and analysis. Copies, files and figures have their numbers.

    The system has what the five objects contain as attributes of the same names. All of these are also taken as
    arguments, which is the older form: ``optical_system(surfaces, 8.0, "F-number", object_distance=50.0)``.

    Examples
    --------
    >>> from odak.learn.raytracing.system import first_order, optical_system, surface
    >>> lens = optical_system(
    ...     [surface(51.5, thickness=4.0, material="N-BK7"), surface(thickness=97.0)], aperture=20.0
    ... )
    >>> round(float(first_order(lens).focal_length), 2)
    99.65
    """

    aperture: float | torch.Tensor
    aperture_type: str
    telecentric: bool
    fields: tuple[tuple[Any, Any], ...]
    field_weights: tuple[float, ...] | None
    vignetting_factors: tuple[tuple[float, ...], ...] | None
    wavelengths: tuple[float, ...]
    reference: int
    wavelength_weights: tuple[float, ...] | None
    object_distance: float | torch.Tensor
    object_material: Any
    surfaces: Any  # a Row, whose items a type checker takes for any modules of torch
    afocal: bool
    name: str
    source: str
    settings: tuple[tuple[str, int | None, tuple[Any, ...]], ...]
    stop: int
    unit: str
    image: surface | None

    @_validate.takes_fields(
        "self surfaces aperture aperture_type",
        aperture=SystemAperture,
        fields=Fields,
        wavelengths=Wavelengths,
        conjugates=Conjugates,
        name=SystemRecord,
    )
    def __init__(
        self,
        surfaces: Sequence[surface],
        aperture: float | torch.Tensor | SystemAperture,
        *,
        fields: Iterable[Any] | Fields | None = None,
        wavelengths: float | str | Sequence[float | str] | Wavelengths | None = None,
        conjugates: Conjugates | None = None,
        image: surface | None = None,
        unit: str = "mm",
        name: str | SystemRecord | None = None,
    ):
        super().__init__()
        surfaces, self.stop = _checked_surfaces(surfaces)
        for part in (aperture, fields, wavelengths, conjugates, name):
            vars(self).update(vars(part))
        self.unit, image = _validate.one_of("unit", unit, MICROMETRES), _image(image)
        given = self.wavelengths or (D_LINE / MICROMETRES[self.unit],)
        self.wavelengths = checked_wavelengths(given, self.unit)
        self.reference = len(self.wavelengths) // 2 if self.reference is None else self.reference
        self._check_object(image)
        if self.afocal:
            surfaces.append(_angular_lens(surfaces, MICROMETRES[self.unit]))
        twice = next((i for i, (a, b) in enumerate(pairwise(surfaces)) if a is b), None)
        if surfaces[0].reflects is False and twice is not None:
            raise ValueError(
                f"surfaces[{twice}] and surfaces[{twice + 1}] are the same surface twice in a row; make one for each "
                "place"
            )
        self.surfaces, self.image = Row(surfaces, self.object_material), image
        if self.aperture_type in ("EPD", "stop"):
            _tell_curvatures(surfaces, plain(self.aperture) / 2, self.unit)
        self.settings = checked_settings(self.settings, len(surfaces), self.unit)

    def extra_repr(self) -> str:
        """Return the conditions of use in lines."""
        fields = ", ".join(f"({x:g}, {y:g})" if x else f"{y:g}" for x, y in plain(self.fields))
        lines = [
            f"lengths in {self.unit}",
            f"aperture={self.aperture:g} ({self.aperture_type})",
            f"fields=[{fields}] {'degrees' if self.at_infinity else self.unit}",
            f"wavelengths=[{', '.join(f'{value:.6g}' for value in self.wavelengths)}] {self.unit}",
            "object at infinity" if self.at_infinity else f"object_distance={self.object_distance:g} {self.unit}",
        ]
        return "\n".join([repr(self.name), *lines] if self.name else lines)

    def _repr_html_(self) -> str:
        return _show.page(self, "odak.learn.raytracing.system.drawing:system_view")

    def _check_object(self, image: surface | None) -> None:
        """Raise ValueError where the places of object and image contradict the aperture, the fields or the image."""
        by_image = self.aperture_type == "F-number" or (self.aperture_type == "NA" and self.at_infinity)
        if self.afocal and (image is not None or by_image):
            raise ValueError(
                "afocal needs an aperture of the object's side and no image surface, got aperture_type "
                f"{self.aperture_type!r} and image {image!r:.60}"
            )
        front: Any = 1.0 if self.at_infinity else self._front(self.wavelengths[self.reference])
        if self.aperture_type == "NA" and plain(self.aperture) >= front:
            medium = "air" if front == 1 else "a medium of this index"
            raise ValueError(
                f"aperture must be below {front:g} as a numerical aperture in {medium}, got {self.aperture}"
            )
        if self.at_infinity and any(
            max(map(abs, f)) >= 90 and (min(map(abs, f)) or max(map(abs, f)) >= 180) for f in plain(self.fields)
        ):
            raise ValueError(
                f"fields must be below 90 degrees from the axis, or below 180 along x or y alone, got {self.fields}"
            )
        if self.telecentric and self.at_infinity:
            raise ValueError("telecentric needs a near object, got an object at infinity")

    @property
    def at_infinity(self) -> bool:
        """Whether the object is infinitely far away."""
        return not isinstance(self.object_distance, torch.Tensor) and math.isinf(self.object_distance)

    def prescription(self, wavelengths: Sequence[float | str] | torch.Tensor | None = None) -> Prescription:
        """Return the system's numbers as tensors, differentiable in those that are parameters.

        Parameters
        ----------
        wavelengths : sequence of float or torch.Tensor, optional
            The system's by default; texts have units of their own. The indices are differentiable in a tensor ``[W]``.
        """
        waves: Any = self.wavelengths if wavelengths is None else wavelengths
        if not isinstance(waves, torch.Tensor) or not waves.numel():
            waves = torch.tensor(checked_wavelengths(waves, self.unit), dtype=torch.float64)
        waves = _validate.real("wavelengths", waves, positive=True).double().reshape(-1)
        items = list(self.surfaces)
        longest = max(item.coefficients.numel() for item in items)
        coefficients = [
            torch.nn.functional.pad(item.coefficients.double(), (0, longest - item.coefficients.numel()))
            for item in items
        ]
        curvature, conic, thickness = (
            torch.stack([getattr(item, name).double().reshape(()) for item in items])
            for name in ("curvature", "conic", "thickness")
        )
        index = self._indices(waves)
        waves = waves.to(index.device)
        shapes = tuple(None if item.own_shape is None else item.shape for item in items)
        phases, gradients = (tuple(getattr(item, name) for item in items) for name in ("phase", "gradient"))
        if any(isinstance(phase, IdealLens) for phase in phases):
            phases = self._at_conjugates(phases, thickness, index, waves)
        return Prescription(
            curvature,
            conic,
            thickness,
            torch.stack(coefficients),
            index,
            _optional([item.shift for item in items]),
            _optional([item.tilt for item in items]),
            shapes if any(shapes) else None,
            phases if any(phases) else None,
            waves,
            gradients if any(gradients) else None,
        )

    def _at_conjugates(self, phases: tuple, thickness: torch.Tensor, index: torch.Tensor, waves: torch.Tensor) -> tuple:
        """Return the phases, ideal lenses with the vergence at which a first-order ray from the object meets them."""
        place, found = self.reference if len(waves) == len(self.wavelengths) else 0, list(phases)
        one, sign = index[place, 0], 1
        height, slope = (one, 0 * one) if self.at_infinity else (self.object_distance * one / one, one)
        items = list(self.surfaces)
        for i, item in enumerate(items):
            behind = -sign if item.reflects else sign
            before, after = sign * index[place, i], behind * index[place, i + 1]
            power = (after - before) * item.shape.curvatures()[1]
            phase = phases[i]
            if isinstance(phase, IdealLens):
                given: Any = phase.vergence
                appended = self.afocal and i + 1 == len(phases)
                # Not a lens in an image of the object, and not the one that stands for an image at infinity.
                away = abs(height) > 1e-9 * abs(phase.focal_length * slope)
                own = sign * slope / (before * torch.where(away, height, 1.0))
                if not (appended or given.requires_grad):
                    found[i] = replace(phase, vergence=torch.where((given == 0) & away, own, given))
            if phase is not None:
                power = power + phase.powers(waves[place])[1]
            slope = slope - height * power
            height, sign = height + thickness[i] / after * slope, behind
        return tuple(found)

    def frames(self, prescription: Prescription | None = None, own: bool = True) -> tuple[torch.Tensor, torch.Tensor]:
        """Return the frames of the surfaces and of the image in the frame of the first vertex: global coordinates.

        Parameters
        ----------
        prescription : Prescription, optional
            Numbers in place of the system's own, of one system.
        own : bool
            Include the shift and tilt of each surface; otherwise return the frames of the axis at its vertex, in which
            :func:`trace` returns its points.

        Returns
        -------
        tuple of torch.Tensor
            Rotations ``[S + 1, 3, 3]``, the columns of which are the axes of each frame, and origins ``[S + 1, 3]``.
        """
        given, own = checked_prescription(prescription), _validate.flag("own", own)
        numbers = (self.prescription() if given is None else given).numbers(self.image)
        shift: Any = numbers.shift
        tilt: Any = numbers.tilt
        frames, rotations, origins = Frames(), [], []
        for i in range(len(self.surfaces) + 1):
            item = self.surfaces[i] if i < len(self.surfaces) else None
            frames.move(numbers.distance[0, i])
            place = placement(shift[0, i], tilt[0, i], None if item is None else item.order)
            if item is not None and is_break(item):
                frames.change(place, item.order)
                place = frames.here
            else:
                frames.append()
                place = frames.here.then(place) if own else frames.here
            one = numbers.distance[0, i]
            rotations.append(torch.stack([torch.stack([v + 0 * one for v in row]) for row in place.matrix]))
            origins.append(torch.stack([v + 0 * one for v in place.origin]))
        return torch.stack(rotations), torch.stack(origins)

    def vary(self, **which: int | Iterable[int]) -> list[torch.nn.Parameter]:
        """Make parameters of numbers, for an optimizer, and return them.

        Parameters
        ----------
        **which
            Surfaces (numbers from 0, one or several) by the name of what is varied: ``curvature=[0, 1],
            thickness=-1``.

        Examples
        --------
        >>> from odak.learn.raytracing.system import load_system
        >>> len(load_system("cooke_triplet").vary(curvature=[0, 1], thickness=-1))
        3
        """
        surfaces = self.surfaces
        return [
            surfaces[_validate.place_in(name, place, len(surfaces))].vary(name)
            for name, places in which.items()
            for place in (places if isinstance(places, Iterable) else [places])
        ]

    def _front(self, wavelengths: Any) -> Any:
        """Return the index of the medium in front at wavelengths."""
        medium = self.object_material
        if isinstance(medium, Real) or medium == AIR:
            return (1.0 if medium == AIR else medium) + 0 * wavelengths
        return refractive_index(medium, wavelengths, self.unit, medium="air")

    def _indices(self, values: torch.Tensor) -> torch.Tensor:
        """Return the indices before the first surface and behind each, ``[W, S + 1]``."""
        first = self.surfaces[0]
        one = torch.ones(len(values), dtype=torch.float64, device=first.thickness.device)
        columns = [self._front(values).to(one)]
        for item in self.surfaces:
            if item.reflects or is_break(item):
                columns.append(columns[-1])
            elif item.material is None:
                columns.append(item.index.double() * one)
            elif item.material == "air":
                columns.append(one)
            else:
                index: Any = refractive_index(item.material, values, self.unit, medium="air")
                columns.append(index.to(one))
        return torch.stack(columns, -1)


class Row(torch.nn.ModuleList):
    """Surfaces in the order in which light meets them, and the medium in front of them.

    Parameters
    ----------
    surfaces : sequence of surface
        The surfaces.
    front : str, float or OpticalMaterial
        The medium.
    """

    def __init__(self, surfaces: Iterable[Any] = (), front: Any = AIR):
        super().__init__(surfaces)
        self.front = front


def _checked_surfaces(surfaces) -> tuple[list[surface], int]:
    """Return the surfaces as a list, and the place of the stop: the first surface if none is marked."""
    surfaces = list(surfaces) if isinstance(surfaces, Iterable) else []
    if not surfaces or not all(isinstance(item, surface) for item in surfaces):
        kinds = ", ".join(sorted({type(item).__name__ for item in surfaces})) or "none"
        raise TypeError(
            f"surfaces must be a sequence of at least one odak.learn.raytracing.system.surface, got {kinds}"
        )
    for i, item in enumerate(surfaces):
        if isinstance(item.order, int) and not item.order < i:
            raise ValueError(f"return_to of surfaces[{i}] must be the number of an earlier one, got {item.order}")
    stops = [i for i, item in enumerate(surfaces) if item.stop]
    first = next((i for i, item in enumerate(surfaces) if not is_break(item)), None)
    if first is None:
        raise ValueError(
            f"surfaces must contain a surface beside coordinate breaks, got {len(surfaces)} coordinate breaks"
        )
    if len(stops) > 1:
        raise ValueError(f"only one surface may be the stop, got surfaces {stops}")
    return surfaces, stops[0] if stops else first


def _tell_curvatures(surfaces, beam: float, unit: str) -> None:
    """Warn of a surface whose radius is so small beside the radius of the beam that a radius was meant."""
    for i, item in enumerate(surfaces):
        curvature = item.curvature.detach()
        if is_readable(curvature) and abs(float(curvature)) * beam > STEEPEST:
            bent = float(curvature)
            warn(
                f"surfaces[{i}] has a curvature of {bent:.4g} per {unit}, a radius of {1 / bent:.4g} {unit}, for a "
                f"beam of {2 * beam:g} {unit}: was {bent:.4g} {unit} its radius?",
                ArgumentWarning,
            )
            return


def _angular_lens(surfaces, micrometres: float) -> surface:
    """Return the ideal lens of 1 m behind an afocal system, with its focal plane as the image."""
    length = 1e6 / micrometres
    backwards = sum(item.reflects for item in surfaces) % 2
    return surface(phase=IdealLens(length), thickness=-length if backwards else length)


def checked_system(system: optical_system) -> optical_system:
    """Return a system after checking that it is one."""
    if not isinstance(system, optical_system):
        kinds = f"{type(system).__name__}"
        if isinstance(system, tuple) and system and isinstance(system[0], optical_system):
            kinds = "a tuple with one in front, as readers of files return: unpack it, system, report = read_zmx(path)"
        raise TypeError(f"system must be an optical_system, got {kinds}")
    return system


def numbers_of(system: optical_system, prescription: Prescription | None) -> Prescription:
    """Return the prescription that is given, or the system's own, after checking both."""
    checked_system(system), checked_prescription(prescription)
    return system.prescription() if prescription is None else prescription


def without_derivatives(system: optical_system) -> optical_system:
    """Return a system whose aperture, fields and object distance are plain numbers, with the same surfaces."""
    found = copy.copy(checked_system(system))
    found.aperture, found.object_distance = plain(system.aperture), plain(system.object_distance)
    found.fields = tuple(tuple(point) for point in plain(system.fields))
    return found


def _image(value) -> surface | None:
    if value is not None and (not isinstance(value, surface) or is_break(value)):
        raise TypeError(f"image must be a surface, got {type(value).__name__}")
    inert = ("stop", "phase", "gradient", "coating")
    if value is not None and (
        value.material != "air" or bool(value.thickness != 0) or any(getattr(value, name) for name in inert)
    ):
        raise ValueError(
            "image must be a surface without thickness, material, phase, gradient and coating that is not the stop, "
            f"got {value!r:.80}"
        )
    return value


def wavelengths_of(system: optical_system, numbers: Prescription) -> torch.Tensor:
    """Return the vacuum wavelengths ``[W]`` of a prescription.

    Parameters
    ----------
    system : optical_system
        The system. Numbers without wavelengths belong to the system's own: to all of them, or to its reference
        wavelength.
    numbers : Prescription
        Its numbers.
    """
    count = numbers.index.shape[-2]
    if numbers.wavelengths is not None:
        return numbers.wavelengths.to(numbers.index)
    if count not in (1, len(system.wavelengths)):
        raise ValueError(f"prescription must have wavelengths where they are not the system's, got {count} indices")
    own = system.wavelengths if count == len(system.wavelengths) else [system.wavelengths[system.reference]]
    return torch.tensor(own, dtype=numbers.index.dtype, device=numbers.index.device)


def reference_of(system: Any, prescription: Prescription | None) -> int:
    """Return the place of the reference wavelength in a prescription; 0 if it has a single wavelength."""
    return 0 if prescription is not None and prescription.index.shape[-2] == 1 else system.reference


def field_shares(system: optical_system, like: torch.Tensor) -> torch.Tensor:
    """Return the weights of the system's fields over their mean, ``[F]``."""
    weights, count = system.field_weights, len(system.fields)
    if weights is not None and len(weights) != count:
        raise ValueError(f"field_weights of the system must be given for each of its {count} fields, got {weights}")
    return like.new_ones(count) if weights is None else _over_mean(like.new_tensor(weights))


def wavelength_shares(system: optical_system, prescription: Prescription | None, like: torch.Tensor) -> torch.Tensor:
    """Return the weights of wavelengths over their mean, ``[W]``; ones where not all are the system's own.

    Parameters
    ----------
    system : optical_system
        The system.
    prescription : Prescription or None
        The numbers that were traced; None for the system's own.
    like : torch.Tensor
        Tensor of the dtype and the device.
    """
    own = system.wavelengths
    if system.wavelength_weights is None:
        return like.new_ones(len(own) if prescription is None else prescription.index.shape[-2])
    weights = like.new_tensor(system.wavelength_weights)
    if prescription is None:
        return _over_mean(weights)
    waves = wavelengths_of(system, prescription)
    same = waves[:, None] == torch.tensor(own, dtype=waves.dtype, device=waves.device)
    found = weights[same.to(torch.uint8).argmax(1)]
    known = same.any(1).all() & (found > 0).any()
    return _over_mean(torch.where(known, found, 1.0))


def _over_mean(weights: torch.Tensor) -> torch.Tensor:
    return weights / weights.mean()


def _optional(values):
    """Return shifts or tilts of all surfaces, None where there are none and none are varied."""
    count = max(len(value) for value in values)
    stacked = torch.stack([padded(value.double(), count) for value in values])
    return stacked if stacked.requires_grad or bool(stacked.any()) else None
