"""Systems at other temperatures and pressures: expansion of glasses and mounts, change of the indices."""

from typing import Any

import torch

from odak import _validate
from odak._warnings import AccuracyWarning, warn
from odak.catalog.materials import Material, thermal_of
from odak.learn.raytracing.system.surfaces import Row, checked_system, is_break, optical_system
from odak.learn.raytracing.system.zooms import replaced, shared_copy
from odak.raytracing.surfaces import Shape


def in_environment(
    system: optical_system,
    temperature: Any = 20.0,
    pressure: Any = 101325.0,
    *,
    mount: float = 0.0,
    mirror: float = 0.0,
    nominal: float = 20.0,
) -> optical_system:
    """Return a system at a temperature and a pressure, every number of it expanded.

    Use it for thermal defocus, athermalisation and lenses in vacuum. The result is linked to the system: gradients by
    what is varied there, and by the temperature, pass through it.

    Parameters
    ----------
    system : optical_system
        The system, whose numbers hold at `nominal`.
    temperature : float or torch.Tensor
        In degrees Celsius.
    pressure : float or torch.Tensor
        Of the air, in pascal; 0 is vacuum.
    mount : float
        Coefficient of expansion of the mounts, per kelvin, by which the distances between lenses grow: 23.6e-6 of
        aluminium 6061.
    mirror : float
        Coefficient of expansion of mirrors, per kelvin.
    nominal : float
        Temperature at which lengths are given, in degrees Celsius.

    Returns
    -------
    optical_system
        With its surfaces and glasses at the temperature.

    Raises
    ------
    ValueError
        If a surface has a shape of its own, which does not expand by a formula, or a graded medium.

    Warns
    -----
    odak.AccuracyWarning
        If the expansion or dn/dT of a glass is not known: it is set to 0.

    Notes
    -----
    Radii and thicknesses of a glass grow by its coefficient of expansion, a surface between two glasses by the mean of
    both. The distance of two lenses grows by the coefficient of the mount at their rims, where both have a
    semi-diameter, otherwise on the axis. Indices are relative to the air around: :func:`odak.catalog.refractive_index`.
    Wavelengths are those in vacuum. An object at a finite distance stays where it is.

    Examples
    --------
    The focal length of a thin lens grows by α − dn/dT/(n − 1), of N-BK7 in air 1.7 parts per million and kelvin:

    >>> from odak.learn.raytracing.system import first_order, in_environment, optical_system, surface
    >>> lens = optical_system([surface(100.0, thickness=2.0, material="N-BK7"), surface(-100.0)], 10.0)
    >>> warm = first_order(in_environment(lens, 21.0)).focal_length / first_order(in_environment(lens)).focal_length - 1
    >>> round(1e6 * float(warm), 1)
    1.7
    """
    checked_system(system)
    for name, value in (("mount", mount), ("mirror", mirror), ("nominal", nominal)):
        _validate.constant(name, value)
    temperature = _validate.number("temperature", temperature, least=-273.15)
    pressure = _validate.number("pressure", pressure, least=0)
    change = torch.as_tensor(temperature, dtype=torch.float64).reshape(()) - nominal
    found = shared_copy(system)
    items: list[Any] = list(system.surfaces)
    rates: list[Any] = []
    unknown: list[str] = []
    inside = False
    for i, item in enumerate(items):
        if item.own_gradient is not None:
            raise ValueError(f"surfaces[{i}] has a graded medium behind it, whose change with temperature is not known")
        rate = None
        if isinstance(item.material, Material):
            constants, rate, _ = thermal_of(item.material)
            unknown += [item.material.name] if rate is None or constants is None else []
            rate = rate or 0.0
        elif (item.reflects or is_break(item)) and inside:
            # Behind a mirror or a break in glass, that glass goes on.
            rate = rates[-1]
        inside = rate is not None
        rates.append(rate)
    if unknown:
        names = ", ".join(dict.fromkeys(unknown))
        warn(
            f"the expansion or dn/dT of {names} is not known and counts as 0; give a Material with `thermal` and "
            "`expansion`, or load a maker's catalogue (AGF)",
            AccuracyWarning,
        )
    grown = []
    for i, item in enumerate(items):
        around = [rate for rate in (rates[i - 1] if i else None, rates[i]) if rate is not None]
        rate = mirror if item.reflects else sum(around) / len(around) if around else 0.0
        grown.append(1 + rate * change)
    copies = [shared_copy(item) for item in items]
    for i, (item, other) in enumerate(zip(items, copies, strict=True)):
        _expand(i, item, other, grown[i])
        if isinstance(item.material, Material):
            other.material = item.material.at(temperature, pressure)
    for i, (item, other) in enumerate(zip(items, copies, strict=True)):
        if rates[i] is not None:
            thickness = item.thickness * (1 + rates[i] * change)
        else:
            thickness = item.thickness + mount * change * _rim_distance(items, i)
            thickness = thickness - _rim_growth(items, copies, i)
        replaced(other, "thickness", thickness)
    if isinstance(system.object_material, Material):
        found.object_material = system.object_material.at(temperature, pressure)
    found.surfaces = Row(copies, found.object_material)
    return found


def _expand(i: int, item, other, scale) -> None:
    """Scale the shape of a surface."""
    if item.own_shape is not None:
        raise ValueError(f"surfaces[{i}] is a {item.own_shape.kind.__name__}, whose expansion is not known")
    if item.own_phase is not None and not is_break(item):
        return
    replaced(other, "curvature", item.curvature / scale)
    powers = torch.ones_like(item.coefficients).cumsum(0)
    replaced(other, "coefficients", item.coefficients * torch.as_tensor(scale).to(powers) ** (1 - 2 * powers))
    if item.semi_diameter is not None:
        other.semi_diameter = float(torch.as_tensor(item.semi_diameter * scale).detach())


def _heights(items, i: int) -> tuple:
    """Return the heights of two neighbouring surfaces at their rims, zeros where a rim is not known."""
    pair: list[Any] = [items[i], items[i + 1] if i + 1 < len(items) else None]
    if any(item is None or is_break(item) or item.semi_diameter is None for item in pair):
        return 0.0, 0.0
    return tuple(_height(item.shape, item.semi_diameter) for item in pair)


def _height(shape: Shape, radius: float):
    place = torch.tensor([radius], dtype=torch.float64)
    return shape.sag(0 * place, place).height[0]


def _rim_distance(items, i: int):
    """Return the distance of two surfaces at their rims, or on the axis."""
    first, second = _heights(items, i)
    return items[i].thickness + second - first


def _rim_growth(items, copies, i: int):
    """Return by how much the heights of the rims of two surfaces shorten the distance on the axis."""
    (a, b), (c, d) = _heights(items, i), _heights(copies, i)
    return (d - b) - (c - a)
