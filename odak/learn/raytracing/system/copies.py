"""Copies of systems: multiplied by a factor, and with some of their surfaces turned around."""

import copy
from dataclasses import fields
from typing import Any

import torch

from odak import _validate
from odak.learn.raytracing.system.surfaces import Row, is_break, optical_system, without_derivatives

# Powers of the factor by which settings of configurations grow; angles, glasses and temperatures stay.
_SETTINGS = {"thickness": 1, "curvature": -1, "semi_diameter": 1, "object_distance": 1}
_HEIGHTS = ("image_heights", "real_image_heights")


def scaled_system(system: optical_system, factor: float) -> optical_system:
    """Return a copy of a system with all its lengths multiplied by a factor.

    Parameters
    ----------
    system : optical_system
        The system.
    factor : float
        Positive factor. Wavelengths, coatings, angles, f-numbers and numerical apertures stay.

    Returns
    -------
    optical_system
        Its focal length, its diameters and its geometric aberrations are `factor` times as large.

    Raises
    ------
    ValueError
        If a surface has a phase, a graded medium, or a shape of its own without a method ``scaled``, naming it, or the
        factor is not positive.

    Examples
    --------
    >>> from odak.learn.raytracing.system import first_order, load_system, scaled_system
    >>> triplet = load_system("cooke_triplet")
    >>> twice = scaled_system(triplet, 2.0)
    >>> round(float(first_order(twice).focal_length / first_order(triplet).focal_length), 9)
    2.0
    """
    factor = _validate.constant("factor", factor, positive=True)
    found = copy.deepcopy(without_derivatives(system))
    items: list[Any] = [*found.surfaces, *([] if found.image is None else [found.image])]
    with torch.no_grad():
        for i, item in enumerate(items):
            held = item.own_shape if item.own_shape is not None and hasattr(item.own_shape.kind, "scaled") else None
            where = "the image" if i == len(found.surfaces) else f"surfaces[{i}]"
            _check_plain(item, where, "scaled", None if held is None else held.kind)
            if held is not None:
                shape: Any = held.build().scaled(factor)
                for name in (field.name for field in fields(shape)):
                    getattr(held, name).copy_(torch.as_tensor(getattr(shape, name)))
            for name, power in (("radius_value", 1), ("curvature_value", -1), ("thickness", 1), ("shift", 1)):
                if hasattr(item, name):
                    getattr(item, name).mul_(factor**power)
            powers = torch.arange(item.coefficients.numel(), dtype=torch.float64, device=item.coefficients.device)
            item.coefficients.mul_(factor ** (-1 - 2 * powers))
            item.apertures = tuple(part.scaled(factor) for part in item.apertures)
            if item.semi_diameter is not None:
                item.semi_diameter *= factor
    powers_of = dict(_SETTINGS) | dict.fromkeys(_HEIGHTS, 1)
    if found.aperture_type in ("EPD", "stop"):
        found.aperture *= factor
        powers_of["aperture"] = 1
    if not found.at_infinity:
        found.object_distance *= factor
        found.fields = _times(found.fields, factor)
        powers_of["fields"] = 1
    found.settings = tuple(
        (name, place, _times(values, factor ** powers_of[name]) if name in powers_of else values)
        for name, place, values in found.settings
    )
    return found


def _times(values: Any, factor: float) -> Any:
    """Return numbers in tuples of any depth multiplied by a factor."""
    return tuple(_times(value, factor) for value in values) if isinstance(values, tuple) else values * factor


def flipped_system(system: optical_system, first: int = 0, last: int = -1) -> optical_system:
    """Return a copy of a system in which some surfaces, and what is between them, are turned around.

    Parameters
    ----------
    system : optical_system
        The system.
    first : int
        Number of the first surface of the element or group.
    last : int
        Number of its last surface; the last of the system by default.

    Returns
    -------
    optical_system
        The distances and the media in front of the group and behind it stay. A stop in the group turns with it.

    Raises
    ------
    ValueError
        If the group holds a mirror, a coordinate break, a phase, a graded medium, a shape of its own, or a number that
        differs between configurations.

    Examples
    --------
    The focal length of a lens in air is the same from both sides, and its focal distances are exchanged:

    >>> from odak.learn.raytracing.system import first_order, flipped_system, load_system
    >>> triplet = load_system("cooke_triplet")
    >>> here, there = first_order(triplet), first_order(flipped_system(triplet))
    >>> round(float(there.focal_length - here.focal_length), 9)
    0.0
    >>> round(float(there.back_focal_distance + here.front_focal_distance), 9)
    0.0
    """
    found = copy.deepcopy(without_derivatives(system))
    items: list[Any] = list(found.surfaces)
    first, last = (_validate.place_in(n, v, len(items)) for n, v in (("first", first), ("last", last)))
    if not first <= last:
        raise ValueError(f"first must be at most last, got {first} and {last}")
    group = items[first : last + 1]
    for i, item in enumerate(group, start=first):
        _check_plain(item, f"surfaces[{i}]", "flipped")
        if item.reflects or is_break(item) or item.is_off_axis or item.apertures:
            raise ValueError(f"surfaces[{i}] is a mirror, a break, off axis or has an aperture: it cannot be flipped")
    if any(place is not None and first <= place <= last for _, place, _ in found.settings):
        raise ValueError(f"surfaces {first} to {last} have settings of configurations: they cannot be flipped")
    behind = [(item.thickness, item.material, getattr(item, "index", None)) for item in group]
    turned = [*behind[-2::-1], behind[-1]] if len(group) > 1 else behind
    with torch.no_grad():
        for item, (thickness, material, index) in zip(reversed(group), turned, strict=True):
            for name in ("radius_value", "curvature_value", "coefficients"):
                if hasattr(item, name):
                    getattr(item, name).neg_()
            for held in (item._buffers, item._parameters):
                held.pop("thickness", None), held.pop("index", None)
            item.material = material
            for name, value in (("thickness", thickness), ("index", index)):
                if value is not None:
                    kind = item.register_parameter if isinstance(value, torch.nn.Parameter) else item.register_buffer
                    kind(name, value)
            if item.coating is not None:
                item.coating = item.coating.reversed()
    items[first : last + 1] = reversed(group)
    found.surfaces = Row(items, found.object_material)
    if first <= found.stop <= last:
        found.stop = first + last - found.stop
    return found


def _check_plain(item: Any, where: str, what: str, known: type[Any] | None = None) -> None:
    """Raise ValueError for a surface whose shape, phase or medium has numbers of its own, other than a known kind."""
    held = [part for part in (item.own_shape, item.own_phase, item.own_gradient) if part and part.kind is not known]
    if held:
        raise ValueError(f"{where} has a {held[0].kind.__name__}, which cannot be {what}")
