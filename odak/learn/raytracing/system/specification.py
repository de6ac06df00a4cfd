"""Conditions of use of a lens system: aperture, fields, wavelengths, and the places of object and image."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from numbers import Real
from typing import Any, TypeAlias

import torch

from odak import _array, _torch_private, _validate
from odak._lengths import expansion_in, in_metres, light_in
from odak.catalog.materials import OpticalMaterial, check_weather
from odak.catalog.materials import material as find_material
from odak.raytracing.geometry import safe_sqrt

# In signatures: a medium by its name, its record or its index; numbers; field points y or (x, y), or ``[F, 2]``.
Medium: TypeAlias = str | OpticalMaterial | float | torch.Tensor
Values: TypeAlias = Sequence[float] | torch.Tensor
FieldPoints: TypeAlias = Sequence[float | Sequence[float]] | torch.Tensor
MIRROR, AIR = "mirror", "air"
APERTURES = ("EPD", "F-number", "NA", "stop")


@dataclass(frozen=True)
class SystemAperture:
    """The size of the beam on the axis.

    Parameters
    ----------
    aperture : float or torch.Tensor
        Size, in the sense of `aperture_type`; differentiable.
    aperture_type : str
        "EPD": diameter of the entrance pupil. "F-number": focal length over that diameter. "NA": n·sin of the marginal
        ray's angle, in object space for a near object, in image space (paraxially) for an object at infinity. "stop":
        diameter of the stop.
    telecentric : bool
        Take the entrance pupil to be at infinity, so that chief rays of a near object are parallel to the axis; the
        type must be "NA" or "stop".

    Raises
    ------
    ValueError, TypeError
        If an argument is out of range.

    Examples
    --------
    >>> from odak.learn.raytracing.system import SystemAperture
    >>> SystemAperture(0.1, "NA", telecentric=True)
    SystemAperture(aperture=0.1, aperture_type='NA', telecentric=True)
    """

    aperture: float | torch.Tensor
    aperture_type: str = "EPD"
    telecentric: bool = False

    def __post_init__(self) -> None:
        set_(self, aperture=condition("aperture", self.aperture, positive=True))
        set_(self, aperture_type=_validate.one_of("aperture_type", self.aperture_type, APERTURES))
        if _validate.flag("telecentric", self.telecentric) and self.aperture_type not in ("NA", "stop"):
            raise ValueError(
                f'telecentric needs a near object, and an aperture given as "NA" or "stop"; got {self.aperture_type!r}'
            )


@dataclass(frozen=True)
class Fields:
    """Points of the object from which a system is traced.

    Parameters
    ----------
    fields : sequence
        Numbers y or pairs (x, y), or a tensor of them; differentiable. Angles in degrees for an object at infinity,
        heights otherwise. Angles of 90 and more are along x or y alone and need rays that are aimed, ``aim="real"``.
    field_weights : sequence of float, optional
        Weight of each point in the merit function of :class:`lens_design`; equal by default.
    vignetting_factors : sequence of sequence of float, optional
        For each point (VDX, VDY, VCX, VCY): its rays go through the pupil points (VDX + (1 − VCX)·x,
        VDY + (1 − VCY)·y) in place of (x, y). None by default.

    Raises
    ------
    ValueError, TypeError
        If an argument is out of range.

    Examples
    --------
    >>> from odak.learn.raytracing.system import Fields
    >>> Fields([0.0, 14.0], field_weights=[1, 2]).fields
    ((0.0, 0.0), (0.0, 14.0))
    """

    fields: Iterable[Any] = (0.0,)
    field_weights: Iterable[Any] | None = None
    vignetting_factors: Iterable[Any] | None = None

    def __post_init__(self) -> None:
        points = checked_fields(self.fields)
        weights = checked_weights("field_weights", self.field_weights, len(points))
        factors = _factors(self.vignetting_factors, len(points))
        set_(self, fields=points, field_weights=weights, vignetting_factors=factors)


@dataclass(frozen=True)
class Wavelengths:
    """Wavelengths with which a system is traced.

    Parameters
    ----------
    wavelengths : float, str or sequence of them, optional
        Wavelengths in the unit of the system, or texts with units of their own such as "550nm"; the d line, 587.5618
        nm, by default. They are those in the air around the lens, to which the formulas of glasses are fitted.
    reference : int, optional
        Index of the wavelength at which first-order properties, pupils and reference spheres are computed; the middle
        one by default.
    wavelength_weights : sequence of float, optional
        Weight of each wavelength in spots, in merit functions and in the monochrome picture of
        :func:`image_simulation`; equal by default.

    Raises
    ------
    ValueError, TypeError
        If an argument is out of range.

    Examples
    --------
    >>> from odak.learn.raytracing.system import Wavelengths
    >>> Wavelengths([486e-6, 588e-6, 656e-6], wavelength_weights=[1, 2, 1]).wavelength_weights
    (1.0, 2.0, 1.0)
    """

    wavelengths: float | str | Iterable[float | str] | None = None
    reference: int | None = None
    wavelength_weights: Iterable[Any] | None = None

    def __post_init__(self) -> None:
        waves = None if self.wavelengths is None else checked_wavelengths(self.wavelengths)
        count = 1 if waves is None else len(waves)
        if self.reference is not None:
            _validate.integer("reference", self.reference, below=count, unit="(the number of wavelengths)")
        weights = checked_weights("wavelength_weights", self.wavelength_weights, count)
        set_(self, wavelengths=waves, wavelength_weights=weights)


@dataclass(frozen=True)
class Conjugates:
    """Where the object and the image of a system are.

    Parameters
    ----------
    object_distance : float or torch.Tensor
        From the object to the first vertex; differentiable.
    object_material : str, float or OpticalMaterial
        Medium in front of the first surface, from the object on: the oil of an immersion objective, the water in front
        of an eye. Angles and numerical apertures in object space are measured in it. The image lies in the medium
        behind the last surface.
    afocal : bool
        Take the image to be at infinity, as in a telescope: an ideal lens with a focal length of 1 m is appended
        in the image plane, and its focal plane is the image. Its coordinates are tangents of angles times 1 m: in
        analyses and figures a micrometre then means a microradian, and a cycle per millimetre a cycle per milliradian.
        The aperture must be given as "EPD", "stop" or, for a near object, "NA".

    Raises
    ------
    ValueError, TypeError
        If an argument is out of range.

    Examples
    --------
    >>> from odak.learn.raytracing.system import Conjugates
    >>> Conjugates(25.0, 1.33)
    Conjugates(object_distance=25.0, object_material=1.33, afocal=False)
    """

    object_distance: float | torch.Tensor = math.inf
    object_material: Medium = AIR
    afocal: bool = False

    def __post_init__(self) -> None:
        distance = number_or_infinity("object_distance", self.object_distance)
        if _array.is_readable(distance) and not distance > 0:
            raise ValueError(f"object_distance must be positive or infinite, got {plain(distance)}")
        set_(self, object_distance=_kept(distance))
        try:
            medium = checked_medium(self.object_material)
        except (TypeError, ValueError) as error:
            raise type(error)(f"object_material: {error}") from None
        if medium == MIRROR or isinstance(medium, torch.Tensor):
            raise ValueError(f"object_material must be a name, an OpticalMaterial or an index, got {medium!r:.80}")
        set_(self, object_material=medium, afocal=_validate.flag("afocal", self.afocal))


@dataclass(frozen=True)
class SystemRecord:
    """What a system carries along and no ray depends on.

    Parameters
    ----------
    name : str
        Name of the system.
    source : str
        Where the system comes from: a book, a patent, a file.
    settings : sequence of tuple
        Numbers that differ between configurations, such as zoom positions: (name, place, values), see
        :class:`configurations`. They do not change the system itself.

    Raises
    ------
    TypeError
        If the name or the source is no string.

    Examples
    --------
    >>> from odak.learn.raytracing.system import SystemRecord
    >>> SystemRecord("relay", source="a sketch")
    SystemRecord(name='relay', source='a sketch', settings=())
    """

    name: str = ""
    source: str = ""
    settings: Sequence[tuple[Any, ...]] = ()

    def __post_init__(self) -> None:
        _validate.text("name", self.name), _validate.text("source", self.source)


PARTS = (SystemAperture, Fields, Wavelengths, Conjugates, SystemRecord)


def set_(held: Any, **values: Any) -> None:
    """Set fields of a frozen value class in its ``__post_init__``."""
    for name, value in values.items():
        object.__setattr__(held, name, value)


def condition(name: str, value: float | torch.Tensor, *, positive: bool = False) -> float | torch.Tensor:
    """Return one number as a float; as a float64 tensor without axes where it has derivatives."""
    return _kept(_validate.number(name, value, positive=positive))


def _kept(value) -> float | torch.Tensor:
    if isinstance(value, torch.Tensor) and (value.requires_grad or _torch_private.is_transformed(value)):
        return value.double().reshape(())
    return float(value)


def plain(value: Any) -> Any:
    """Return a number, or nested lists of numbers, of tensors and tuples; names of materials."""
    if isinstance(value, torch.Tensor):
        held = _torch_private.as_constant(value).detach()
        return (torch.view_as_real(held) if held.is_complex() else held).tolist()
    if isinstance(value, OpticalMaterial):
        return value.name
    return [plain(entry) for entry in value] if isinstance(value, (tuple, list)) else value


def number_or_infinity(name: str, value: float | torch.Tensor) -> float | torch.Tensor:
    """Return a real number that may be infinite; an infinite one as a float."""
    if isinstance(value, Real) and not isinstance(value, bool) and math.isinf(value):
        return value
    single = isinstance(value, torch.Tensor) and value.numel() == 1 and not _torch_private.is_wrapped(value)
    if single and bool(torch.isinf(torch.as_tensor(value).detach()).all()):
        return float(_validate.constants(**{name: value})[0])
    return _validate.number(name, value)


def checked_medium(value: Any) -> str | Real | torch.Tensor | OpticalMaterial:
    """Return "air", "mirror", a material of the catalogue, or the number or tensor that came."""
    if isinstance(value, bool) or not isinstance(value, (str, Real, torch.Tensor, OpticalMaterial)):
        raise TypeError(f"material must be a name, an index or an OpticalMaterial, got {type(value).__name__}")
    if isinstance(value, str):
        return value.casefold() if value.casefold() in (MIRROR, AIR) else find_material(value)
    return value


def checked_wavelengths(values: Any, unit: str | None = None) -> tuple[float, ...]:
    """Return vacuum wavelengths, at least one, as a tuple; texts remain until the unit of their system is known."""
    if isinstance(values, (str, list, tuple)):
        values = [values] if isinstance(values, str) else values
        if unit is None and any(isinstance(value, str) for value in values):
            in_metres("wavelengths", values)
            return tuple(values)
    values = values if unit is None else light_in("wavelengths", values, unit)
    (values,) = _validate.constants(wavelengths=values)
    found = tuple(
        _validate.numbers(
            _validate.real("wavelengths", values if not isinstance(values, tuple) else list(values), positive=True)
        )
    )
    if not found:
        raise ValueError("wavelengths must contain at least one, got none")
    return found


def checked_fields(values: Iterable[Any]) -> tuple[tuple[Any, Any], ...]:
    """Return field points, numbers y or pairs (x, y), as pairs."""
    _validate.listed("fields", values, "a sequence of numbers y or pairs (x, y)")
    if hasattr(values, "tolist"):
        values = values.unbind() if isinstance(values, torch.Tensor) else values.tolist()
    points = [(0.0, value) if is_number(value) else tuple(value) for value in values]
    if not points or any(len(point) != 2 for point in points):
        raise ValueError(f"fields must be numbers y or pairs (x, y), at least one, got {values!r}")
    return tuple((condition("fields", x), condition("fields", y)) for x, y in points)


def stacked(points: Sequence[Sequence[float | torch.Tensor]]) -> torch.Tensor:
    """Return pairs (x, y) of numbers and tensors as one float64 tensor ``[F, 2]``, on the device of the tensors."""
    held = [value for point in points for value in point if isinstance(value, torch.Tensor)]
    if not held:
        return torch.tensor([tuple(point) for point in points], dtype=torch.float64)
    like = held[0]
    return torch.stack(
        [torch.stack([torch.as_tensor(v, device=like.device).double().reshape(()) for v in point]) for point in points]
    )


def largest_of(points: Sequence[Sequence[float | torch.Tensor]]) -> float | torch.Tensor:
    """Return the largest distance of field points from the axis, with its derivatives if they have any."""
    sizes = [math.hypot(*plain(point)) for point in points]
    chosen = points[sizes.index(max(sizes))]
    if any(isinstance(value, torch.Tensor) for value in chosen):
        return safe_sqrt(stacked([chosen]).square().sum())
    return max(sizes)


def is_number(value: object) -> bool:
    """Return whether a field point is a number y, an array without axes too, rather than a pair."""
    return not isinstance(value, Iterable) or getattr(value, "ndim", 1) == 0


def _factors(values, count: int) -> tuple[tuple[float, ...], ...] | None:
    if values is None:
        return None
    _validate.listed("vignetting_factors", values, "a sequence of four numbers for each field")
    found = tuple(tuple(float(v) for v in _validate.several("vignetting_factors", row, 4)) for row in values)
    if len(found) != count:
        raise ValueError(f"vignetting_factors must be given for each of {count} fields, got {len(found)}")
    if any(row[2] >= 1 or row[3] >= 1 for row in found):
        raise ValueError(f"vignetting_factors must have VCX and VCY below 1, which close the pupil, got {found}")
    return found


SETTINGS = {
    "surfaces": ("thickness", "curvature", "conic", "index", "semi_diameter", "material"),
    "system": ("aperture", "object_distance", "fields", "wavelengths", "image_heights", "real_image_heights"),
    "environment": ("temperature", "pressure", "mount", "mirror"),
}


def checked_settings(
    settings: Iterable[Sequence[Any]], count: int, unit: str
) -> tuple[tuple[str, int | None, tuple[Any, ...]], ...]:
    """Return settings (name, place, values) of configurations after checking that they are.

    Parameters
    ----------
    settings : sequence of tuple
        The settings.
    count : int
        Number of surfaces of the system.
    unit : str
        Its unit.
    """
    if isinstance(settings, (str, Mapping)) or not isinstance(settings, Iterable):
        raise TypeError(f"settings must be a sequence of (name, place, values), got {type(settings).__name__}")
    found: list[tuple[str, int | None, tuple]] = []
    for entry in settings:
        if not isinstance(entry, (tuple, list)) or len(entry) != 3:
            raise ValueError(f"settings must be (name, place, values), got {entry!r:.80}")
        name = _validate.one_of("name in settings", entry[0], [one for names in SETTINGS.values() for one in names])
        whole = name not in SETTINGS["surfaces"]
        if whole and entry[1] is not None:
            raise ValueError(
                f"place in settings must be None for {name}, which belongs to the system, got {entry[1]!r}"
            )
        place = None if whole else _validate.place_in("place in settings", entry[1], count)
        values = entry[2].tolist() if hasattr(entry[2], "tolist") else entry[2]
        if isinstance(values, str) or not isinstance(values, Iterable):
            raise TypeError(f"values in settings must be a sequence, got {type(values).__name__}")
        found.append((name, place, tuple(_setting(name, value, unit) for value in values)))
    if len({len(values) for _, _, values in found}) > 1 or any(not values for _, _, values in found):
        counts = ", ".join(f"{len(values)} of {name}" for name, _, values in found)
        raise ValueError(f"settings must have one value for each configuration, got {counts}")
    return tuple(found)


def _setting(name: str, value, unit: str):
    """Return the value of a setting after checking it."""
    if name == "material":
        return checked_medium(value)
    if name in ("fields", "image_heights", "real_image_heights"):
        return checked_fields(value)
    if name == "wavelengths":
        return checked_wavelengths(value, unit)
    if name == "object_distance":
        return float(number_or_infinity(f"{name} in settings", value))
    found = _validate.constant(f"{name} in settings", value, positive=name in ("aperture", "semi_diameter", "index"))
    if name in ("temperature", "pressure"):
        check_weather(**{name: found}, where=" in settings")
    return expansion_in(f"{name} in settings", found) if name in ("mount", "mirror") else found


def checked_weights(name: str, values: Iterable[Any] | None, count: int) -> tuple[float, ...] | None:
    """Return weights as numbers of at least 0, one of them above it; None where there are none.

    Parameters
    ----------
    name : str
        Argument that the errors name.
    values : sequence of float or None
        The weights.
    count : int
        Their number.
    """
    if values is None:
        return None
    found = tuple(_validate.constant(name, v, least=0) for v in _validate.several(name, values, count))
    if not any(found):
        raise ValueError(f"{name} must have one above 0, got {found}")
    return found
