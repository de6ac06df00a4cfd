"""Surfaces in a row, with wavelengths, fields and an aperture: an optical system."""

import math
from collections.abc import Iterable, Sequence
from itertools import pairwise
from typing import Any

import torch

from odak import _validate
from odak.catalog.materials import MICROMETRES, refractive_index
from odak.learn.raytracing.system.prescription import Prescription
from odak.learn.raytracing.system.surfaces import number_or_infinity, surface

APERTURES = ("EPD", "F-number", "NA", "stop")
D_LINE = 0.5875618  # micrometres


class optical_system(torch.nn.Module):
    """A sequential optical system: light passes its surfaces one after the other, from −z to the image plane.

    Parameters
    ----------
    surfaces : sequence of surface
        In the order in which light meets them. The image plane follows, at the last one's thickness.
    aperture : float
        Size of the aperture, as `aperture_type` has it.
    aperture_type : str
        "EPD": diameter of the entrance pupil. "F-number": focal length over that diameter. "NA": n·sin of the marginal
        ray's angle, on the object's side if the object is near, on the image's (paraxially) if not. "stop": diameter
        of the stop.
    wavelengths : float or sequence of float
        Vacuum wavelengths in `unit`; the d line, 587.5618 nm, by default.
    reference : int, optional
        Which of them first-order properties, pupils and reference spheres are computed at; the middle one by default.
    fields : sequence
        Field points: numbers y or pairs (x, y). Angles in degrees for an object at infinity, heights otherwise.
    object_distance : float
        From the object to the first vertex.
    image : surface, optional
        Shape of the image surface: a curved sensor, a retina, a tilted plane. Of what a surface may be, its radius,
        conic constant, coefficients, semi-diameter, shift and tilt count. A plane by default.
    unit : str
        Unit of all lengths, wavelengths included: "mm", "m", "um" or "nm".
    name, source : str
        What it is called and where it comes from.

    Raises
    ------
    ValueError, TypeError
        If an argument is outside its range, naming it.

    Notes
    -----
    Space in front is air. Without a stop among the surfaces, the first one is it. Indices are those of the catalogue,
    relative to air. Where the stop lies in the rear focal plane of what is in front of it, a near object is seen
    telecentrically: the entrance pupil is at infinity, and the aperture must be given as "NA" or "stop".

    Examples
    --------
    >>> from odak.learn.raytracing.system import first_order, optical_system, surface
    >>> lens = optical_system(
    ...     [surface(51.5, thickness=4.0, material="N-BK7"), surface(thickness=97.0)], aperture=20.0
    ... )
    >>> round(float(first_order(lens).focal_length), 2)
    99.65
    """

    def __init__(
        self,
        surfaces: Sequence[surface],
        aperture: float,
        aperture_type: str = "EPD",
        *,
        wavelengths: float | Sequence[float] | None = None,
        reference: int | None = None,
        fields: Iterable = (0.0,),
        object_distance: float = math.inf,
        image: surface | None = None,
        unit: str = "mm",
        name: str = "",
        source: str = "",
    ):
        super().__init__()
        surfaces = list(surfaces) if isinstance(surfaces, Iterable) else []
        if not surfaces or not all(isinstance(item, surface) for item in surfaces):
            raise TypeError("surfaces must be a sequence of at least one odak.learn.raytracing.system.surface")
        stops = [i for i, item in enumerate(surfaces) if item.stop]
        if len(stops) > 1:
            raise ValueError(f"only one surface may be the stop, got {stops}")
        if surfaces[0].reflects is False and any(a is b for a, b in pairwise(surfaces)):
            raise ValueError("a surface occurs twice in a row; make one for each place")
        self.surfaces = torch.nn.ModuleList(surfaces)
        self.stop = stops[0] if stops else 0
        self.aperture = float(_validate.number("aperture", aperture, positive=True))
        self.aperture_type = _validate.one_of("aperture_type", aperture_type, APERTURES)
        if self.aperture_type == "NA" and self.aperture >= 1:
            raise ValueError(f"aperture must be below 1 as a numerical aperture in air, got {aperture}")
        self.unit = _validate.one_of("unit", unit, MICROMETRES)
        default = D_LINE / MICROMETRES[self.unit]
        self.wavelengths = _wavelengths(default if wavelengths is None else wavelengths)
        count = len(self.wavelengths)
        self.reference = count // 2 if reference is None else _validate.integer("reference", reference)
        if self.reference >= count:
            raise ValueError(f"reference must be below the number of wavelengths, {count}, got {self.reference}")
        self.fields = _fields(fields)
        self.object_distance = float(number_or_infinity("object_distance", object_distance))
        if not self.object_distance > 0:
            raise ValueError(f"object_distance must be positive or infinite, got {object_distance}")
        if self.at_infinity and any(abs(angle) >= 90 for field in self.fields for angle in field):
            raise ValueError(f"fields must be below 90 degrees from the axis, got {self.fields}")
        self.image = _image(image)
        self.name, self.source = _validate.text("name", name), _validate.text("source", source)

    @property
    def at_infinity(self) -> bool:
        """Whether the object is infinitely far away."""
        return math.isinf(self.object_distance)

    def prescription(self, wavelengths: Sequence[float] | None = None) -> Prescription:
        """Return the system's numbers as tensors, differentiable in those that are parameters.

        Parameters
        ----------
        wavelengths : sequence of float, optional
            The system's by default.
        """
        wavelengths = self.wavelengths if wavelengths is None else _wavelengths(wavelengths)
        items: list[Any] = list(self.surfaces)
        longest = max(item.coefficients.numel() for item in items)
        coefficients = [
            torch.nn.functional.pad(item.coefficients.double(), (0, longest - item.coefficients.numel()))
            for item in items
        ]
        curvature, conic, thickness = (
            torch.stack([getattr(item, name).double().reshape(()) for item in items])
            for name in ("curvature", "conic", "thickness")
        )
        return Prescription(
            curvature,
            conic,
            thickness,
            torch.stack(coefficients),
            self._indices(wavelengths),
            _optional([item.shift for item in items]),
            _optional([item.tilt for item in items]),
        )

    def vary(self, **which: Any) -> list[torch.nn.Parameter]:
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
        surfaces: Any = self.surfaces
        return [
            surfaces[_validate.place_in(name, place, len(surfaces))].vary(name)
            for name, places in which.items()
            for place in (places if isinstance(places, Iterable) else [places])
        ]

    def _indices(self, wavelengths) -> torch.Tensor:
        """Return the indices before the first surface and behind each, ``[W, S + 1]``."""
        first: Any = self.surfaces[0]
        one = torch.ones(len(wavelengths), dtype=torch.float64, device=first.thickness.device)
        values = torch.tensor(wavelengths, dtype=torch.float64)
        columns = [one]
        for item in self.surfaces:
            if item.reflects:
                columns.append(columns[-1])
            elif item.material is None:
                columns.append(item.index.double() * one)
            elif item.material == "air":
                columns.append(one)
            else:
                index: Any = refractive_index(item.material, values, self.unit, medium="air")
                columns.append(index.to(one))
        return torch.stack(columns, -1)


def checked_system(system) -> optical_system:
    """Return a system after checking that it is one."""
    if not isinstance(system, optical_system):
        raise TypeError(f"system must be an optical_system, got {type(system).__name__}")
    return system


def _image(value) -> surface | None:
    if value is not None and not isinstance(value, surface):
        raise TypeError(f"image must be a surface, got {type(value).__name__}")
    if value is not None and (value.stop or value.material != "air" or bool(value.thickness != 0)):
        raise ValueError("image is where light ends: it has no thickness, no material and is no stop")
    return value


def _wavelengths(values) -> tuple[float, ...]:
    found = tuple(
        _validate.numbers(
            _validate.real("wavelengths", values if not isinstance(values, tuple) else list(values), positive=True)
        )
    )
    if not found:
        raise ValueError("wavelengths must hold at least one")
    return found


def _fields(values) -> tuple[tuple[float, float], ...]:
    if not isinstance(values, Iterable) or isinstance(values, str):
        raise TypeError(f"fields must be a sequence of numbers y or pairs (x, y), got {type(values).__name__}")
    values = values.tolist() if hasattr(values, "tolist") else values
    points = [tuple(value) if isinstance(value, Iterable) else (0.0, value) for value in values]
    if not points or any(len(point) != 2 for point in points):
        raise ValueError(f"fields must be numbers y or pairs (x, y), at least one, got {values!r}")
    return tuple((float(_validate.real("fields", x)), float(_validate.real("fields", y))) for x, y in points)


def _optional(values):
    """Return shifts or tilts of all surfaces, None where there are none and none are varied."""
    stacked = torch.stack([value.double() for value in values])
    return stacked if stacked.requires_grad or bool(stacked.any()) else None
