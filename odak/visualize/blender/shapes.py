"""Meshes, surfaces, balls and pictures in a scene."""

import os
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from odak import _validate
from odak.tools._images import read_levels
from odak.tools._ply import read_mesh
from odak.tools.file import validate_path
from odak.visualize import _arrays
from odak.visualize.blender.items import Item, pair, positive, three
from odak.visualize.blender.materials import diffuse, emission, linear_light
from odak.visualize.blender.meshes import Mesh, disc_mesh, grid_mesh, sphere_mesh

ORIGIN = (0.0, 0.0, 0.0)


class Shapes:
    """The part of a scene that draws meshes, surfaces and balls."""

    # What the scene has that this is a part of.
    _add: Any

    def add_mesh(
        self,
        mesh,
        faces=None,
        *,
        color=None,
        material=None,
        smooth: bool = False,
        location: Sequence[float] = ORIGIN,
        rotation: Sequence[float] = ORIGIN,
        scale: Sequence[float] = (1.0, 1.0, 1.0),
        name: str | None = None,
    ) -> Item:
        """Draw triangles.

        Parameters
        ----------
        mesh : array, str or object
            Triangles ``[3, 3]`` or ``[m, 3, 3]``; vertices ``[v, 3]`` together with `faces`; the name of a PLY file;
            or a mesh of odak such as ``odak.learn.raytracing.planar_mesh`` or ``triangle_mesh``.
        faces : array, optional
            Integers ``[f, 3]``: three vertices each.
        color : str or array, optional
            A name or "#rrggbb", or sRGB from 0 to 1: ``[3]``, or a colour for each vertex ``[v, 3]``.
        material : Material, str, float or catalogue material, optional
            From :func:`diffuse` (the default), :func:`emission`, :func:`glass` or :func:`metal`. The name of a
            material of ``odak.catalog`` or an index is a glass, "mirror" a mirror. A closed mesh of glass must be
            counter-clockwise seen from outside.
        smooth : bool
            Let it look curved across the edges of its faces.
        location, rotation, scale : sequence of float
            Where it stands: degrees about X, then Y, then Z, after scaling.
        name : str, optional
            Name of the object.

        Returns
        -------
        Item
            The object.

        Raises
        ------
        ValueError
            If a shape is wrong, a number not finite, or a face names a vertex that does not exist.
        """
        default, found = _mesh(mesh, faces)
        smooth = _validate.flag("smooth", smooth)
        if not np.isfinite(found.vertices).all():
            raise ValueError("mesh must be finite")
        many = None
        if not (isinstance(color, str) or color is None) and np.ndim(color) == 2:
            color, many = None, _vertex_colors(color, len(found.vertices))
        item = self._add(default if name is None else name, found, material, color, diffuse(), smooth=smooth)
        item.location, item.rotation = three("location", location), three("rotation", rotation)
        item.scale, item.colors = three("scale", scale), many
        return item

    def add_surface(
        self,
        surface: Callable,
        y=None,
        z=None,
        *,
        u: Sequence[float] = (0.0, 1.0),
        v: Sequence[float] = (0.0, 1.0),
        resolution: Sequence[int] = (65, 65),
        size: Sequence[float] | None = None,
        smooth: bool = True,
        name: str = "surface",
        **options,
    ) -> Item:
        """Draw a parametric surface, heights over a rectangle, or a grid of points.

        Parameters
        ----------
        surface : callable or array
            A function of arrays u and v, ``[rows, columns]``, that returns x, y, z (three arrays, or one
            ``[rows, columns, 3]``); heights ``[rows, columns]``, together with `size`; or x, together with `y`, `z`.
        y, z : array, optional
            ``[rows, columns]``, as x.
        u, v : sequence of float
            First and last value of the parameters; u runs along columns, v along rows.
        resolution : sequence of int
            Rows and columns that a function is sampled at.
        size : sequence of float, optional
            Extent of heights along x (columns) and y (rows), about the origin; outermost samples lie on its rim.
        smooth : bool
            Let it look curved across the edges of its faces.
        name : str
            Name of the object.
        **options
            Of :meth:`add_mesh`; `color` may be ``[rows·columns, 3]``.

        Returns
        -------
        Item
            The object.

        Raises
        ------
        ValueError
            If a shape is wrong or a number not finite.

        Examples
        --------
        A bowl:

        >>> from odak.visualize import blender
        >>> picture = blender.scene(unit="mm")
        >>> bowl = picture.add_surface(lambda u, v: (u, v, (u**2 + v**2) / 20), u=(-5, 5), v=(-5, 5))
        >>> float(bowl.vertices[:, 2].max())
        2.5
        """
        if callable(surface):
            rows, columns = _validate.size("resolution", resolution)
            if not (y is z is size is None):
                raise ValueError("y, z and size must be left out where surface is a function")
            spans = [_validate.numbers(_validate.several(name, span, 2)) for name, span in (("u", u), ("v", v))]
            (left, right), (low, high) = spans
            across, along = np.meshgrid(np.linspace(left, right, columns), np.linspace(low, high, rows))
            points = _grid(surface(across, along), (rows, columns))
        elif y is None and z is None:
            heights = _arrays.image("surface", surface)
            if size is None:
                raise ValueError("size must be the extent of the heights along x and y, got None")
            width, height = (positive("size", value) for value in pair("size", size))
            lines = np.linspace(-width / 2, width / 2, heights.shape[1]), np.linspace(-0.5, 0.5, heights.shape[0])
            points = _grid((*np.meshgrid(lines[0], lines[1] * height), heights), heights.shape)
        else:
            points = _grid((surface, y, z), np.shape(surface))
        found = grid_mesh(points)
        return self.add_mesh(found, smooth=smooth, name=name, **options)

    def add_sphere(
        self,
        center: Sequence[float] = ORIGIN,
        radius: float = 1.0,
        *,
        color=None,
        material=None,
        segments: int = 128,
        name: str = "sphere",
    ) -> Item:
        """Draw a ball.

        Parameters
        ----------
        center : array
            Its centre ``[3]``, or a sphere of odak ``[4]``: centre and radius, in place of `radius`.
        radius : float
            Its radius.
        color, material, name
            As in :meth:`add_mesh`.
        segments : int
            How many pieces its equator is cut into.

        Returns
        -------
        Item
            The object.
        """
        given = _arrays.real_array("center", center).astype(np.float64).reshape(-1)
        if given.shape == (4,):
            given, radius = given[:3], given[3]
        segments = _validate.integer("segments", segments, minimum=8)
        mesh = sphere_mesh(positive("radius", radius), segments)
        item = self._add(name, mesh, material, color, diffuse(), smooth=True)
        item.location = three("center", given)
        return item

    def add_plane(
        self,
        size: Sequence[float] = (1.0, 1.0),
        *,
        location: Sequence[float] = ORIGIN,
        rotation: Sequence[float] = ORIGIN,
        color=None,
        material=None,
        name: str = "plane",
    ) -> Item:
        """Draw a rectangle, before its rotation in the plane z = 0 and facing +z.

        Parameters
        ----------
        size : sequence of float
            Extent along x and y.
        location, rotation, color, material, name
            As in :meth:`add_mesh`.

        Returns
        -------
        Item
            The object.
        """
        width, height = (positive("size", value) / 2 for value in pair("size", size))
        corners = np.array(
            [[[-width, -height, 0.0], [width, -height, 0.0]], [[-width, height, 0.0], [width, height, 0.0]]]
        )
        mesh = grid_mesh(corners)
        return self.add_mesh(mesh, color=color, material=material, location=location, rotation=rotation, name=name)

    def add_disc(
        self,
        radius: float = 1.0,
        *,
        location: Sequence[float] = ORIGIN,
        rotation: Sequence[float] = ORIGIN,
        color=None,
        material=None,
        segments: int = 128,
        name: str = "disc",
    ) -> Item:
        """Draw a disc, before its rotation in the plane z = 0 and facing +z; arguments as in :meth:`add_plane`."""
        mesh = disc_mesh(positive("radius", radius), _validate.integer("segments", segments, minimum=3))
        return self.add_mesh(mesh, color=color, material=material, location=location, rotation=rotation, name=name)

    def add_image(
        self,
        image,
        size: Sequence[float],
        *,
        location: Sequence[float] = ORIGIN,
        rotation: Sequence[float] = ORIGIN,
        shines: bool = True,
        name: str = "image",
    ) -> Item:
        """Hang a picture into the scene, before its rotation in the plane z = 0, upright (y) and seen from +z.

        Parameters
        ----------
        image : str or array
            Name of an image file, or sRGB values: ``[rows, columns]`` or ``[rows, columns, 3]``, integers from 0 to 255
            or floats from 0 to 1. From behind it is mirrored.
        size : sequence of float
            Width and height.
        location, rotation, name
            As in :meth:`add_mesh`.
        shines : bool
            Show it like a screen; else like a print, in the light of the scene.

        Returns
        -------
        Item
            The object.
        """
        shown = pixels("image", image)
        material = emission() if _validate.flag("shines", shines) else diffuse()
        item = self.add_plane(size, location=location, rotation=rotation, material=material, name=name)
        item.image = shown
        return item


def pixels(name: str, image) -> np.ndarray:
    """Return a picture, given as a file or as numbers, as uint8 ``[rows, columns, 3]``."""
    if isinstance(image, (str, os.PathLike)):
        try:
            image = read_levels(image)
        except ValueError as error:
            raise ValueError(f"{name} cannot be read: {error}") from error
        image = image // 257 if image.dtype == np.uint16 else image
    found = _arrays.real_array(name, image)
    if found.ndim == 2:
        found = np.repeat(found[..., None], 3, axis=-1)
    if found.ndim != 3 or found.shape[-1] not in (3, 4) or 0 in found.shape:
        raise ValueError(f"{name} must be [rows, columns] or [rows, columns, 3], got {list(found.shape)}")
    found = found[..., :3]
    if found.dtype.kind == "f":
        if not (found >= 0).all() or not (found <= 1).all():
            raise ValueError(f"{name} of floats must be from 0 to 1")
        found = np.rint(found * 255)
    elif found.min() < 0 or found.max() > 255:
        raise ValueError(f"{name} of integers must be from 0 to 255, got {found.min()} … {found.max()}")
    return np.ascontiguousarray(found.astype(np.uint8))


def _mesh(mesh, faces) -> tuple[str, Mesh]:
    """Return a name and a mesh of whatever a user calls a mesh."""
    if isinstance(mesh, Mesh):
        return "mesh", mesh
    if isinstance(mesh, (str, os.PathLike)):
        path = validate_path(mesh, [".ply"], name="mesh")
        return os.path.splitext(os.path.basename(path))[0], Mesh(*read_mesh(path))
    if hasattr(mesh, "get_triangles"):
        mesh = mesh.get_triangles()
    elif hasattr(mesh, "vertices") and hasattr(mesh, "faces"):
        mesh, faces = mesh.vertices, mesh.faces
    if faces is None:
        corners = _arrays.triangles("mesh", mesh)
        return "mesh", Mesh(corners.reshape(-1, 3), np.arange(3 * len(corners), dtype=np.int32).reshape(-1, 3))
    vertices, faces = _arrays.points("mesh", mesh), _arrays.real_array("faces", faces)
    if faces.dtype.kind not in "iu" or faces.ndim != 2 or faces.shape[1] != 3:
        raise ValueError(f"faces must be integers [f, 3], got {faces.dtype} {list(faces.shape)}")
    if len(faces) and not 0 <= faces.min() <= faces.max() < len(vertices):
        raise ValueError(
            f"faces must name vertices from 0 to {len(vertices) - 1} of mesh, got {faces.min()} … {faces.max()}"
        )
    return "mesh", Mesh(vertices, faces)


def _grid(parts, shape) -> np.ndarray:
    """Return x, y, z, or points with three coordinates last, as float64 ``[rows, columns, 3]``."""
    if isinstance(parts, (tuple, list)) and len(parts) == 3:
        parts = np.stack(
            np.broadcast_arrays(*(_arrays.real_array(n, p) for n, p in zip("xyz", parts, strict=True))), -1
        )
    points = _arrays.real_array("surface", parts).astype(np.float64)
    if points.shape != (*shape, 3) or len(shape) != 2 or min(shape) < 2:
        raise ValueError(
            f"surface must give x, y, z as [rows, columns] of at least 2 × 2, got {list(points.shape)} for {shape}"
        )
    if not np.isfinite(points).all():
        raise ValueError("surface must be finite everywhere")
    return points


def _vertex_colors(color, count: int) -> np.ndarray:
    found = _arrays.real_array("color", color)
    if found.shape != (count, 3):
        raise ValueError(f"color must be [3], or one for each vertex: [{count}, 3]; got {list(found.shape)}")
    if not (found >= 0).all() or not (found <= 1).all():
        raise ValueError("color must be red, green, blue from 0 to 1")
    return linear_light(found.astype(np.float64)).astype(np.float32)
