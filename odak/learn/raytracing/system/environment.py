"""Systems at other temperatures and pressures: expansion of glasses and mounts, change of the indices."""

import copy
from collections.abc import Iterable
from dataclasses import fields
from typing import Any, NamedTuple

import torch

from odak import _validate
from odak._lengths import expansion_in
from odak._warnings import AccuracyWarning, warn
from odak.catalog.materials import OpticalMaterial, check_weather, refractive_index, thermal_of
from odak.learn.raytracing.system.prescriptions import Prescription
from odak.learn.raytracing.system.surfaces import Row, checked_system, is_break, optical_system, wavelengths_of


def in_environment(
    system: optical_system,
    temperature: float | torch.Tensor = 20.0,
    pressure: float | torch.Tensor = 101325.0,
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
        If a surface has a shape of its own without a method ``scaled``, or a graded medium.

    Warns
    -----
    odak.AccuracyWarning
        If the expansion or dn/dT of a glass is not known, or a medium is given by its index alone: both are set to 0.

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
    expansion_in("mount", mount), expansion_in("mirror", mirror)
    temperature = _validate.number("temperature", temperature)
    pressure = _validate.number("pressure", pressure)
    check_weather(temperature, pressure)
    tell_unknown([system])
    return expanded_system(system, Environment(temperature, pressure, mount, mirror, nominal))


class Environment(NamedTuple):
    """What :func:`in_environment` takes."""

    temperature: float | torch.Tensor = 20.0
    pressure: float | torch.Tensor = 101325.0
    mount: Any = 0.0
    mirror: Any = 0.0
    nominal: float = 20.0


def tell_unknown(systems: Iterable[Any]) -> None:
    """Warn once of glasses whose expansion or dn/dT is not known; raise ValueError for what has no known change.

    Parameters
    ----------
    systems : iterable of optical_system
        The systems.
    """
    unknown: list[str] = []
    for system in systems:
        for i, item in enumerate(system.surfaces):
            if item.own_gradient is not None:
                raise ValueError(
                    f"surfaces[{i}] has a graded medium behind it, whose change with temperature is not known"
                )
            if item.own_shape is not None and not hasattr(item.own_shape.kind, "scaled"):
                raise ValueError(f"surfaces[{i}] is a {item.own_shape.kind.__name__}, whose expansion is not known")
            if item.material is None and float(item.index.detach()) != 1:
                unknown.append(f"the index {float(item.index.detach()):g}")
            elif isinstance(item.material, OpticalMaterial) and None in thermal_of(item.material)[:2]:
                unknown.append(item.material.name)
    if unknown:
        names = ", ".join(dict.fromkeys(unknown))
        warn(
            f"the expansion or dn/dT of {names} is not known and counts as 0; give an OpticalMaterial with `thermal` "
            "and `expansion`, a model_glass `like` a material with both, or load a maker's catalogue (AGF)",
            AccuracyWarning,
        )


def expanded_system(system: optical_system, given: Environment) -> optical_system:
    """Return a system in an environment, linked to the system.

    Parameters
    ----------
    system : optical_system
        The system.
    given : Environment
        The environment.
    """
    p = expanded(system, system.prescription([system.wavelengths[0]]), given)
    found = shared_copy(system)
    items: list[Any] = list(system.surfaces)
    copies = [shared_copy(item) for item in items]
    growth = _growth(items, given, p.curvature.device)[0]
    for i, (item, other) in enumerate(zip(items, copies, strict=True)):
        if item.own_shape is not None:
            other.own_shape = shared_copy(item.own_shape)
            for field, value in zip(fields(p.shape(i)), p.shape(i).parameters(), strict=True):
                put(other.own_shape, (field.name,), field.name, value)
        elif not _is_fixed(item):
            replaced(other, "curvature", p.curvature[i])
            replaced(other, "coefficients", p.coefficients[i, : item.coefficients.numel()])
        if item.semi_diameter is not None:
            other.semi_diameter = float((item.semi_diameter * growth[i]).detach())
        replaced(other, "thickness", p.thickness[i])
        if isinstance(item.material, OpticalMaterial):
            other.material = item.material.at(given.temperature, given.pressure)
    if isinstance(system.object_material, OpticalMaterial):
        found.object_material = system.object_material.at(given.temperature, given.pressure)
    found.surfaces = Row(copies, found.object_material)
    return found


def expanded(system: optical_system, p: Prescription, given: Environment) -> Prescription:
    """Return numbers that hold at the nominal temperature as they are in an environment.

    Parameters
    ----------
    system : optical_system
        The system, whose glasses and semi-diameters count.
    p : Prescription
        Its numbers, of one system or of a batch.
    given : Environment
        The environment.
    """
    items: list[Any] = list(system.surfaces)
    growth, rates, change = _growth(items, given, p.curvature.device)
    powers = torch.arange(1, p.coefficients.shape[-1] + 1).to(p.coefficients)
    curvature, coefficients = p.curvature / growth, p.coefficients * growth[:, None] ** (1 - 2 * powers)
    shapes = p.shapes and tuple(
        None if shape is None else shape.scaled(factor) for shape, factor in zip(p.shapes, growth, strict=True)
    )
    grown = p._replace(curvature=curvature, coefficients=coefficients, shapes=shapes)
    thickness: list[Any] = []
    for i, (value, rate) in enumerate(zip(p.thickness.unbind(-1), rates, strict=True)):
        if rate is None:
            (a, b), (c, d) = _heights(items, p, torch.ones_like(growth), i), _heights(items, grown, growth, i)
            # The distance at the rims grows by the mount; that on the axis loses what the rims bend towards each other.
            thickness.append(value + given.mount * change * (value + b - a) - (d - c - b + a))
        else:
            thickness.append(value * (1 + rate * change))
    waves = wavelengths_of(system, p)
    none = torch.zeros_like(waves)
    columns = [_index_change(system.object_material, waves, system.unit, given, none)]
    for item in items:
        goes_on = item.reflects or is_break(item)
        columns.append(columns[-1] if goes_on else _index_change(item.material, waves, system.unit, given, none))
    return grown._replace(
        thickness=torch.stack(torch.broadcast_tensors(*thickness), -1), index=p.index + torch.stack(columns, -1)
    )


def _growth(items, given: Environment, device: torch.device) -> tuple[torch.Tensor, list[Any], torch.Tensor]:
    """Return the factors by which surfaces grow, ``[S]``, the coefficients of the glasses behind, and the warming."""
    change = torch.as_tensor(given.temperature, dtype=torch.float64, device=device).reshape(()) - given.nominal
    rates: list[float | None] = []
    for item in items:
        rate = None
        if isinstance(item.material, OpticalMaterial):
            rate = thermal_of(item.material)[1] or 0.0
        elif (item.reflects or is_break(item)) and rates:
            # Behind a mirror or a break in glass, that glass goes on.
            rate = rates[-1]
        rates.append(rate)
    grown = []
    for i, item in enumerate(items):
        around = [rate for rate in (rates[i - 1] if i else None, rates[i]) if rate is not None]
        rate = given.mirror if item.reflects else sum(around) / len(around) if around else 0.0
        grown.append(1 + (0.0 if _is_fixed(item) else rate) * change)
    return torch.stack(grown), rates, change


def _is_fixed(item) -> bool:
    """Return whether a surface has a phase: its shape stays as it is."""
    return item.own_phase is not None and not is_break(item)


def _index_change(medium, waves: torch.Tensor, unit: str, given: Environment, none: torch.Tensor) -> torch.Tensor:
    if not isinstance(medium, OpticalMaterial):
        return none
    there: Any = refractive_index(medium.at(given.temperature, given.pressure), waves, unit, medium="air")
    return there - refractive_index(medium, waves, unit, medium="air")


def _heights(items, p: Prescription, growth, i: int) -> tuple[Any, ...]:
    """Return the heights of two neighbouring surfaces at their rims, zeros where a rim is not known."""
    pair: list[Any] = [items[i], items[i + 1] if i + 1 < len(items) else None]
    if any(item is None or is_break(item) or item.semi_diameter is None for item in pair):
        return 0.0, 0.0
    return tuple(_height(p, j, growth[j] * items[j].semi_diameter) for j in (i, i + 1))


def _height(p: Prescription, i: int, radius: torch.Tensor):
    shape = p.shape(i)
    return shape.sag(0 * radius, radius).height


def shared_copy(module: Any) -> Any:
    """Return a module that shares its parts with another until they are replaced."""
    found = copy.copy(module)
    for name in ("_parameters", "_buffers", "_modules"):
        found.__dict__[name] = dict(module.__dict__[name])
    return found


def replaced(item: Any, name: str, value: torch.Tensor) -> None:
    """Replace a number of a surface by a tensor of any graph."""
    if name == "curvature":
        put(item, ("curvature_value", "radius_value"), "curvature_value", value)
    else:
        put(item, (name,), name, value)


def put(item: Any, old: Iterable[str], name: str, value: torch.Tensor) -> None:
    """Put a tensor of any graph in the place of parameters or buffers."""
    for held in old:
        item._parameters.pop(held, None)
        item._buffers.pop(held, None)
    item._buffers[name] = value
