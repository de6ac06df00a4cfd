"""Objects, materials, cameras and lights of a scene, as plain data."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from numbers import Real
from typing import Any

import numpy as np
from PIL import ImageColor

from odak import _array, _validate
from odak.catalog.materials import Material as CatalogMaterial
from odak.catalog.materials import refractive_index
from odak.tools.transformation import rotation_matrix
from odak.visualize._arrays import linear_light, real_array
from odak.visualize.blender.meshes import Mesh

PROJECTIONS = ("perspective", "orthographic")
LIGHTS = ("point", "area", "sun")
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
        Emitted radiance of an emission, as a multiple of its colour.
    index : float
        Refractive index of a glass.
    roughness : float
        0 polished, 1 frosted.
    name : str
        Name of the material.

    Examples
    --------
    >>> from odak.visualize.blender import glass
    >>> material = glass(1.5)
    >>> material.kind, material.index
    ('glass', 1.5)
    """

    kind: str
    color: tuple[float, float, float] = (1.0, 1.0, 1.0)
    strength: float = 1.0
    index: float = 1.0
    roughness: float = 0.0
    name: str = ""


@dataclass
class Item:
    """An object of a scene. Its place and material may be changed after it was added.

    Attributes
    ----------
    name : str
        Name, unlike that of any other object of the scene.
    vertices : numpy.ndarray
        float32 ``[v, 3]`` in the object's own frame, in the scene's unit.
    faces : numpy.ndarray
        int32 ``[f, 3]``.
    material : Material
        Material of the object.
    normals, colors, uv : numpy.ndarray or None
        At the vertices: unit normals ``[v, 3]``, linear colours ``[v, 3]`` that take the place of the material's, and
        places in the picture ``[v, 2]``; float32.
    image : numpy.ndarray or None
        A picture in place of the material's colour, uint8 ``[rows, columns, 3]``.
    rods : numpy.ndarray or None
        Of an object of rods: start, end and radius, float32 ``[m, 2, 4]``. A Blender that has curves draws these in
        place of the triangles, far faster.
    smooth : bool
        True if faces are shaded as curved.
    ground : int
        Number of faces, the last ones, that are matt in place of the material, as the ground edge of a lens.
    shadow : bool
        True if it casts shadows.
    location, rotation, scale : list of float
        Position; degrees about X, then Y, then Z, after scaling along its own axes.
    """

    name: str
    vertices: np.ndarray
    faces: np.ndarray
    material: Material
    normals: np.ndarray | None = None
    colors: np.ndarray | None = None
    uv: np.ndarray | None = None
    image: np.ndarray | None = None
    rods: np.ndarray | None = None
    smooth: bool = False
    ground: int = 0
    shadow: bool = True
    location: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    rotation: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    scale: list[float] = field(default_factory=lambda: [1.0, 1.0, 1.0])

    @classmethod
    def of(cls, name: str, mesh: Mesh, material: Material, **options) -> "Item":
        """Return an object with the shape of a mesh."""
        normals, uv = (None if part is None else np.asarray(part, dtype=np.float32) for part in (mesh.normals, mesh.uv))
        vertices, faces = np.asarray(mesh.vertices, dtype=np.float32), np.asarray(mesh.faces, dtype=np.int32)
        return cls(name, vertices, faces, material, normals, uv=uv, **options)

    def placed_vertices(self) -> np.ndarray:
        """Return the vertices where the object stands, float64 ``[v, 3]``."""
        return self.placed(self.vertices)

    def placed(self, points: np.ndarray) -> np.ndarray:
        """Return points of the object's own frame where it stands, float64 ``[m, 3]``."""
        turn = rotation_matrix(np.asarray(self.rotation, dtype=np.float64))
        return points.astype(np.float64) @ (turn * self.scale).T + np.asarray(self.location)

    def extremes(self) -> np.ndarray:
        """Return points whose bounding box contains the object but for the thickness of rods, float64 ``[m, 3]``."""
        return self.placed(self.vertices if self.rods is None else self.rods[..., :3].reshape(-1, 3))


@dataclass
class Camera:
    """A perspective or an orthographic camera.

    Attributes
    ----------
    location : list of float
        The pinhole, or the middle of the plane that parallel rays start from.
    axes : list of list of float
        Unit vectors to the right, upwards and backwards.
    projection : str
        "perspective" or "orthographic".
    fov : float
        Of a perspective camera: full angle across the picture's width, in degrees.
    width : float
        Of an orthographic camera: what the picture shows across its width, in the scene's unit.
    clip : list of float or None
        Nearest and farthest distance that it sees; None for whatever the objects ask for.
    """

    location: list[float]
    axes: list[list[float]]
    projection: str
    fov: float
    width: float
    clip: list[float] | None

    def project(self, points, resolution: tuple[int, int]) -> np.ndarray:
        """Return where points appear in a picture.

        Parameters
        ----------
        points : array
            ``[..., 3]``.
        resolution : tuple of int
            Rows and columns of the picture.

        Returns
        -------
        numpy.ndarray
            Column and row ``[..., 2]``: (0, 0) is the picture's upper left corner, (0.5, 0.5) the middle of its first
            pixel. NaN for a point behind a perspective camera.
        """
        rows, columns = resolution
        points = real_array("points", points)
        if points.ndim == 0 or points.shape[-1] != 3:
            raise ValueError(f"points must be [..., 3], got {list(points.shape)}")
        seen = (points - np.asarray(self.location)) @ np.asarray(self.axes).T
        half = np.where(seen[..., 2] < 0, -seen[..., 2], np.nan) * math.tan(math.radians(self.fov) / 2)
        if self.projection == "orthographic":
            half = np.full_like(half, self.width / 2)
        across, up = (seen[..., i] / half * columns / 2 for i in (0, 1))
        return np.stack((columns / 2 + across, rows / 2 - up), axis=-1)

    def rays(self, resolution: tuple[int, int]) -> np.ndarray:
        """Return the rays that end at the centres of the pixels of a picture, float64 ``[rows, columns, 2, 3]``.

        Parameters
        ----------
        resolution : tuple of int
            Rows and columns of the picture.
        """
        rows, columns = resolution
        across = (np.arange(columns) + 0.5 - columns / 2) * (2 / columns)
        up = -(np.arange(rows) + 0.5 - rows / 2) * (2 / columns)
        offset = up[:, None, None] * np.asarray(self.axes[1]) + across[None, :, None] * np.asarray(self.axes[0])
        backwards, location = np.asarray(self.axes[2]), np.asarray(self.location)
        if self.projection == "orthographic":
            starts = location + offset * (self.width / 2)
            return np.stack(np.broadcast_arrays(starts, -backwards), axis=-2)
        directions = offset * math.tan(math.radians(self.fov) / 2) - backwards
        directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
        return np.stack(np.broadcast_arrays(location, directions), axis=-2)


@dataclass
class Light:
    """A light.

    Attributes
    ----------
    kind : str
        "point", "area" or "sun".
    location : list of float
        Position; a sun has a direction only.
    axes : list of list of float
        Unit vectors to the right, upwards and backwards, as of a camera; the light is emitted forwards.
    power : float
        Watts; of a sun watts per square metre.
    size : float
        Diameter of a point, edge of an area, in the scene's unit.
    color : list of float
        Linear RGB.
    visible : bool
        True if the camera sees it directly; reflections show it in any case.
    """

    kind: str
    location: list[float]
    axes: list[list[float]]
    power: float
    size: float
    color: list[float]
    visible: bool = True


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
    >>> wall.kind, [round(float(value), 3) for value in wall.color]
    ('diffuse', [0.604, 0.058, 0.058])
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
    >>> lamp.kind, lamp.strength
    ('emission', 5.0)
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
        Colour of the transmitted light, as in :func:`diffuse`.
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
        Colour of the reflected light, as in :func:`diffuse`.
    roughness : float
        0 polished, 1 matt.

    Examples
    --------
    >>> from odak.visualize.blender import metal
    >>> mirror = metal("white", roughness=0.0)
    >>> mirror.kind, mirror.roughness
    ('metal', 0.0)
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


def listed(value):
    """Return a sequence as a list, anything else as it is."""
    return list(value) if isinstance(value, Sequence) and not isinstance(value, str) else value


def _share(name: str, value) -> float:
    value = float(_validate.real(name, value))
    if not 0 <= value <= 1:
        raise ValueError(f"{name} must be from 0 to 1, got {value}")
    return value


def three(name: str, value) -> list[float]:
    """Return three finite numbers as a list."""
    found = real_array(name, value).astype(np.float64).reshape(-1)
    if found.shape != (3,) or not np.isfinite(found).all():
        raise ValueError(f"{name} must be three finite numbers, got {np.asarray(found).tolist()}")
    return found.tolist()


def aim(location, target, up=None) -> list[list[float]]:
    """Return the axes (right, up, backwards) of something at `location` that looks at `target`.

    Without `up`, y points upwards in the picture, or z for a look along y.
    """
    behind = np.subtract(location, target)
    if not np.linalg.norm(behind) > 0:
        raise ValueError(f"location and target must be different points, got {location} for both")
    behind = behind / np.linalg.norm(behind)
    if up is None:
        up = [0.0, 1.0, 0.0] if abs(behind[1]) < 1 - 1e-6 else [0.0, 0.0, 1.0]
    right = np.cross(up, behind)
    if not np.linalg.norm(right) > 1e-9 * np.linalg.norm(up):
        raise ValueError(f"up must not be parallel to the direction from location to target, got {up}")
    right = right / np.linalg.norm(right)
    return [axis.tolist() for axis in (right, np.cross(behind, right), behind)]


def positive(name: str, value) -> float:
    """Return a positive number."""
    found = _validate.numbers(_validate.real(name, value, positive=True))
    if len(found) != 1:
        raise ValueError(f"{name} must be one positive number, got {value!r:.80}")
    return found[0]


def pair(name: str, value) -> list:
    """Return a pair as a list."""
    if isinstance(value, (str, bytes)) or not isinstance(value, Iterable) or len(found := list(value)) != 2:
        raise ValueError(f"{name} must be two numbers, got {value!r:.80}")
    return found
