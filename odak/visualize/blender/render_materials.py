"""Materials of the objects of a scene, as plain data."""

from collections.abc import Sequence
from dataclasses import dataclass
from numbers import Real
from typing import Any

import numpy as np
from PIL import ImageColor

from odak import _array, _validate
from odak.catalog.dispersion import Material as CatalogMaterial
from odak.catalog.materials import refractive_index
from odak.visualize._arrays import linear_light

__all__ = ["Material", "diffuse", "emission", "glass", "metal"]

KINDS = ("diffuse", "emission", "glass", "metal")
D_LINE = 587.5618e-9


@dataclass(frozen=True)
class Material:
    """A material; made by :func:`diffuse`, :func:`emission`, :func:`glass` and :func:`metal`.

    Attributes
    ----------
    kind : str
        "diffuse", "emission", "glass" or "metal".
    color : tuple of float
        Linear light: red, green, blue.
    strength : float
        Of an emission: how often its colour it emits.
    index : float
        Refractive index of a glass.
    roughness : float
        0 polished, 1 frosted.
    name : str
        What it is called.
    """

    kind: str
    color: tuple[float, float, float] = (1.0, 1.0, 1.0)
    strength: float = 1.0
    index: float = 1.0
    roughness: float = 0.0
    name: str = ""


def diffuse(color: str | Sequence[float] = "white") -> Material:
    """Return a matt surface that scatters light by Lambert's law.

    Parameters
    ----------
    color : str or sequence of float
        A name or "#rrggbb" as in web pages, or red, green, blue from 0 to 1 as in a picture (sRGB).

    Examples
    --------
    >>> from odak.visualize.blender import diffuse
    >>> wall = diffuse("#cc4444")
    """
    return Material("diffuse", linear_color(color))


def emission(color: str | Sequence[float] = "white", strength: float = 1.0) -> Material:
    """Return a surface that emits light.

    Parameters
    ----------
    color : str or sequence of float
        A name or "#rrggbb" as in web pages, or red, green, blue from 0 to 1 as in a picture (sRGB). At strength 1 a
        picture shows this very colour.
    strength : float
        Factor of the emitted radiance.

    Examples
    --------
    >>> from odak.visualize.blender import emission
    >>> lamp = emission("white", strength=5.0)
    """
    return Material("emission", linear_color(color), strength=float(_validate.number("strength", strength, least=0)))


def glass(
    index: Any = "N-BK7",
    wavelength: float | None = None,
    unit: str = "m",
    color: str | Sequence[float] = "white",
    roughness: float = 0.0,
) -> Any:
    """Return a transparent material.

    Parameters
    ----------
    index : float, str or odak.catalog material
        Refractive index in air, or the name of a material of :func:`odak.catalog.material_names`.
    wavelength : float, optional
        Vacuum wavelength at which the index of a named material is taken; the d line, 587.5618 nm, by default.
    unit : str
        Unit of `wavelength`: "m", "mm", "um" or "nm".
    color : str or sequence of float
        What it lets through, as in :func:`diffuse`.
    roughness : float
        0 polished, 1 frosted.

    Returns
    -------
    Material
        The glass.

    Raises
    ------
    ValueError
        If no material has this name; the message names the nearest known ones.

    Examples
    --------
    >>> from odak.visualize import blender
    >>> round(blender.glass("N-BK7").index, 4)
    1.5168
    """
    unit = _validate.one_of("unit", unit, ("m", "mm", "um", "nm"))
    if wavelength is not None:
        wavelength = _validate.real("wavelength", wavelength, positive=True)
    name = index if isinstance(index, str) else getattr(index, "name", "glass")
    if isinstance(index, (str, CatalogMaterial)):
        given = (D_LINE, "m") if wavelength is None else (wavelength, unit)
        try:
            index = refractive_index(index, given[0], unit=given[1], medium="air")
        except ValueError as error:
            raise ValueError(f"index: {error}") from error
    index = float(_validate.real("index", index, positive=True))
    return Material("glass", linear_color(color), index=index, roughness=_share("roughness", roughness), name=name)


def metal(color: str | Sequence[float] = "white", roughness: float = 0.0) -> Material:
    """Return a mirror.

    Parameters
    ----------
    color : str or sequence of float
        What it reflects, as in :func:`diffuse`.
    roughness : float
        0 polished, 1 matt.

    Examples
    --------
    >>> from odak.visualize.blender import metal
    >>> mirror = metal("white", roughness=0.0)
    """
    return Material("metal", linear_color(color), roughness=_share("roughness", roughness))


def chosen(material, color, default: Any, wavelength: float, unit: str) -> Material:
    """Return the material that a drawing call asks for by its arguments `material` and `color`.

    Parameters
    ----------
    material : Material, str, float, catalogue material or None
        A name of the catalogue or a number is a glass, "mirror" a mirror.
    color : str, sequence of float or None
        Takes the place of the material's own colour.
    default : Material
        What to take when there is no `material`.
    wavelength, unit
        Where the index of a named glass is taken.
    """
    if material is None:
        found = default
    elif isinstance(material, Material):
        found = material
    elif isinstance(material, str) and material.casefold() == "mirror":
        found = metal()
    elif isinstance(material, (str, Real, CatalogMaterial)) or _array.is_array(material):
        found = glass(material, wavelength, unit)
    else:
        raise TypeError(
            f"material must be a Material, the name of one of the catalogue, 'mirror' or an index, "
            f"got {type(material).__name__}"
        )
    if color is None:
        return found
    return Material(found.kind, linear_color(color), found.strength, found.index, found.roughness, found.name)


def linear_color(color) -> tuple[float, float, float]:
    """Return a colour name, "#rrggbb" or red, green, blue in sRGB as linear light."""
    if isinstance(color, str):
        try:
            color = [value / 255 for value in ImageColor.getrgb(color)]
        except ValueError:
            raise ValueError(f"color must be a name or '#rrggbb' as in web pages, got {color!r}") from None
    values = np.asarray(_validate.numbers(_validate.real("color", listed(color))), dtype=np.float64)
    if values.shape not in ((3,), (4,)) or (values < 0).any() or (values > 1).any():
        raise ValueError(f"color must be red, green, blue from 0 to 1, got {listed(color)!r}")
    red, green, blue = (float(value) for value in linear_light(values[:3]))
    return red, green, blue


def coded_light(linear) -> list[float]:
    """Return the sRGB values of linear light, cut to 0 to 1."""
    linear = np.clip(np.asarray(linear, dtype=np.float64), 0.0, 1.0)
    coded = np.where(linear <= 0.0031308, linear * 12.92, 1.055 * linear ** (1 / 2.4) - 0.055)
    return [float(value) for value in coded]


def listed(value):
    """Return a sequence as a list, anything else as it is."""
    return list(value) if isinstance(value, Sequence) and not isinstance(value, str) else value


def _share(name: str, value) -> float:
    value = float(_validate.real(name, value))
    if not 0 <= value <= 1:
        raise ValueError(f"{name} must be from 0 to 1, got {value}")
    return value
