"""Objects, materials, cameras, lights and triangle meshes of a scene, as plain data."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from numbers import Real
from typing import Any, NamedTuple

import numpy as np
from PIL import ImageColor

from odak import _array, _validate
from odak.catalog.materials import OpticalMaterial, refractive_index
from odak.raytracing.surfaces import even_asphere_sag
from odak.tools.transformation import rotation_matrix
from odak.visualize._arrays import grid_faces, linear_light, real_array


class Mesh(NamedTuple):
    """Triangles over shared vertices.

    Attributes
    ----------
    vertices : numpy.ndarray
        ``[v, 3]``.
    faces : numpy.ndarray
        int32 ``[f, 3]``, counter-clockwise seen from outside.
    normals : numpy.ndarray or None
        Of unit length at the vertices, ``[v, 3]``; None where the renderer computes them.
    uv : numpy.ndarray or None
        Texture coordinates of each vertex, ``[v, 2]``: (0, 0) is the lower left corner of a picture, (1, 1) the upper
        right one.
    """

    vertices: np.ndarray
    faces: np.ndarray
    normals: np.ndarray | None = None
    uv: np.ndarray | None = None

    def without_slivers(self) -> "Mesh":
        """Return the mesh less its faces without area, such as those at the poles of a sphere."""
        a, b, c = (self.vertices[self.faces[:, i]] for i in range(3))
        extent = max(np.ptp(self.vertices, axis=0).max(initial=0.0) ** 2, np.finfo(float).tiny)
        kept = np.linalg.norm(np.cross(b - a, c - a), axis=-1) > 1e-12 * extent
        return self._replace(faces=self.faces[kept])


def grid_mesh(points: np.ndarray) -> Mesh:
    """Return a surface over points ``[rows, columns, 3]``; its front is where columns × rows points."""
    rows, columns = points.shape[:2]
    v, u = np.meshgrid(np.linspace(0, 1, rows), np.linspace(0, 1, columns), indexing="ij")
    uv = np.stack((u, v), axis=-1).reshape(-1, 2)
    return Mesh(points.reshape(-1, 3), grid_faces(rows, columns), uv=uv).without_slivers()


def sphere_mesh(radius: float, segments: int) -> Mesh:
    """Return a sphere about the origin, `segments` around it and half as many from pole to pole."""
    polar = np.linspace(np.pi, 0.0, segments // 2 + 1)[:, None]
    around = np.linspace(0.0, 2 * np.pi, segments + 1)[None]
    normals = np.stack(
        np.broadcast_arrays(np.sin(polar) * np.cos(around), np.sin(polar) * np.sin(around), np.cos(polar)), -1
    )
    return grid_mesh(radius * normals)._replace(normals=normals.reshape(-1, 3))


def disc_mesh(radius: float, segments: int) -> Mesh:
    """Return a disc in the plane z = 0 that faces +z."""
    around = np.linspace(0.0, 2 * np.pi, segments, endpoint=False)
    rim = np.stack((radius * np.cos(around), radius * np.sin(around), 0 * around), axis=-1)
    vertices = np.concatenate((np.zeros((1, 3)), rim))
    index = np.arange(segments, dtype=np.int32)
    faces = np.stack((np.zeros_like(index), 1 + index, 1 + (index + 1) % segments), axis=-1)
    return Mesh(vertices, faces, uv=vertices[:, :2] / (2 * radius) + 0.5)


def tube_mesh(starts: np.ndarray, ends: np.ndarray, radius: float, sides: int, shaded: bool = True) -> Mesh:
    """Return closed prisms along lines from starts to ends, both ``[m, 3]``.

    With `shaded`, they have the normals of cylinders, for which sides and ends take vertices of their own: 4·sides a
    prism. Without, 2·sides.
    """
    along = ends - starts
    along = along / np.linalg.norm(along, axis=-1, keepdims=True)
    # The axis that a line runs along least is never parallel to it.
    helper = np.eye(3)[np.argmin(np.abs(along), axis=-1)]
    first = np.cross(along, helper)
    first /= np.linalg.norm(first, axis=-1, keepdims=True)
    second = np.cross(along, first)
    angle = np.arange(sides) * (2 * np.pi / sides)
    outwards = np.cos(angle)[:, None] * first[:, None] + np.sin(angle)[:, None] * second[:, None]
    low, high = starts[:, None] + radius * outwards, ends[:, None] + radius * outwards
    axial = np.broadcast_to(along[:, None], outwards.shape)
    vertices = np.concatenate((low, high) * (2 if shaded else 1), axis=1)
    normals = np.concatenate((outwards, outwards, -axial, axial), axis=1).reshape(-1, 3) if shaded else None
    offsets = np.arange(len(starts), dtype=np.int32)[:, None, None] * vertices.shape[1]
    faces = _prism_faces(sides, 2 * sides if shaded else 0) + offsets
    return Mesh(vertices.reshape(-1, 3), faces.reshape(-1, 3), normals)


def _prism_faces(sides: int, caps_from: int) -> np.ndarray:
    """Return faces over rings of vertices: the lower ring, the upper ring, and the caps' vertices from a number on."""
    here = np.arange(sides, dtype=np.int32)
    following = (here + 1) % sides
    walls = [(here, following, sides + following), (here, sides + following, sides + here)]
    fan = np.arange(1, sides - 1, dtype=np.int32)
    corner = np.zeros_like(fan)
    caps = [caps_from + np.stack((corner, fan + 1, fan), -1), caps_from + sides + np.stack((corner, fan, fan + 1), -1)]
    return np.concatenate([np.stack(wall, -1) for wall in walls] + caps)


def profile_sheet(
    curvature: float,
    conic: float,
    coefficients: Sequence[float] | np.ndarray,
    semi_diameter: float,
    place: float,
    segments: int,
) -> tuple[np.ndarray, np.ndarray]:
    """Return a sheet of a face of a lens with its vertex at z = place, z = height(r) as of ``even_asphere_sag``.

    A sheet is points and unit normals towards +z, each ``[rings + 1, segments + 1, 3]`` from the vertex to the rim, the
    last column being the first again.
    """
    distance = np.linspace(0.0, semi_diameter, max(segments // 4, 8) + 1)[:, None]
    around = np.linspace(0.0, 2 * np.pi, segments + 1)[None]
    x, y = distance * np.cos(around), distance * np.sin(around)
    sag = even_asphere_sag(x, y, curvature, conic, np.asarray(coefficients, dtype=np.float64))
    normals = np.stack((-sag.slope_x, -sag.slope_y, np.ones_like(x)), axis=-1)
    points = np.stack((x, y, place + np.where(sag.defined, sag.height, np.nan)), axis=-1)
    return points, normals / np.linalg.norm(normals, axis=-1, keepdims=True)


def lens_mesh(front: tuple[np.ndarray, np.ndarray], back: tuple[np.ndarray, np.ndarray]) -> Mesh:
    """Return the lens between two sheets, of which the back is on the side that the normals of the front point to.

    Faces and edge share no vertices, so that light sees the exact normals of each up to the rim.
    """
    rims = np.stack((front[0][-1, :-1], back[0][-1, :-1]))
    normals = np.cross(np.roll(rims, -1, axis=1) - np.roll(rims, 1, axis=1), rims[1] - rims[0])
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    rims, normals = (np.concatenate((part, part[:, :1]), axis=1).reshape(-1, 3) for part in (rims, normals))
    edge = Mesh(rims, grid_faces(2, len(rims) // 2), normals)
    return joined([sheet_mesh(*front, facing=-1), sheet_mesh(*back, facing=1), edge])


def sheet_mesh(points: np.ndarray, normals: np.ndarray, facing: int) -> Mesh:
    """Return one face of a lens, its outer side towards its normals (1) or away from them (-1)."""
    # Along a ring, then outwards: that pair spans −z.
    faces = grid_faces(*points.shape[:2])
    faces = faces if facing < 0 else faces[:, ::-1]
    return Mesh(points.reshape(-1, 3), faces, facing * normals.reshape(-1, 3)).without_slivers()


def joined(parts: list[Mesh]) -> Mesh:
    """Return meshes that all have normals as one."""
    counts = np.cumsum([0] + [len(part.vertices) for part in parts[:-1]])
    return Mesh(
        np.concatenate([part.vertices for part in parts]),
        np.concatenate([part.faces + count for part, count in zip(parts, counts, strict=True)]).astype(np.int32),
        np.concatenate([part.normals for part in parts]),
    )


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
        Name that no other object of the scene has.
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
    def of(cls, name: str, mesh: Mesh, material: Material, **options: Any) -> "Item":
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

    def project(self, points: np.ndarray, resolution: tuple[int, int]) -> np.ndarray:
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
        _validate.shaped("points", points, "[..., 3]")
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
) -> Material:
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
    if isinstance(index, (str, OpticalMaterial)):
        given = (D_LINE, "m") if wavelength is None else (wavelength, unit)
        with _validate.refusing("index: ", ValueError):
            index = refractive_index(index, given[0], unit=given[1], medium="air")
    index = _validate.constant("index", index, positive=True)
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


def chosen(material: Material, color: str | Sequence[float], default: Any, wavelength: float, unit: str) -> Material:
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
    elif isinstance(material, (str, Real, OpticalMaterial)) or _array.is_array(material):
        found = glass(material, wavelength, unit)
    else:
        raise TypeError(
            f"material must be a Material, the name of one of the catalogue, 'mirror' or an index, "
            f"got {type(material).__name__}"
        )
    if color is None:
        return found
    return Material(found.kind, linear_color(color), found.strength, found.index, found.roughness, found.name)


def linear_color(color: str | Sequence[float]) -> tuple[float, float, float]:
    """Return a colour name, "#rrggbb" or red, green, blue in sRGB as linear light."""
    if isinstance(color, str):
        told = f"color must be a name or '#rrggbb' as in web pages, got {color!r}"
        with _validate.refusing(lambda _: told, ValueError):
            color = [value / 255 for value in ImageColor.getrgb(color)]
    values = np.asarray(_validate.numbers(_validate.real("color", listed(color))), dtype=np.float64)
    if values.shape not in ((3,), (4,)) or (values < 0).any() or (values > 1).any():
        raise ValueError(f"color must be red, green, blue from 0 to 1, got {listed(color)!r}")
    red, green, blue = (float(value) for value in linear_light(values[:3]))
    return red, green, blue


def listed(value: Any) -> Any:
    """Return a sequence as a list, anything else as it is."""
    return list(value) if isinstance(value, Sequence) and not isinstance(value, str) else value


def _share(name: str, value) -> float:
    return float(_validate.number(name, value, least=0, most=1))


def three(name: str, value: Any) -> list[float]:
    """Return three finite numbers as a list."""
    found = real_array(name, value).astype(np.float64).reshape(-1)
    if found.shape != (3,) or not np.isfinite(found).all():
        raise ValueError(f"{name} must be three finite numbers, got {np.asarray(found).tolist()}")
    return found.tolist()


def aim(location: Any, target: Any, up: Any = None) -> list[list[float]]:
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


def positive(name: str, value: Any) -> float:
    """Return a positive number."""
    return _validate.constant(name, value, positive=True)
