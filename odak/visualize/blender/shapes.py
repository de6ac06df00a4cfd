"""Rays, lines, points, meshes, surfaces, images, lenses and optical systems of a scene."""

import math
import os
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np

from odak import _validate
from odak._show import COLOURS
from odak.catalog.materials import MICROMETRES
from odak.tools.asset import read_mesh
from odak.tools.file import read_levels, validate_path
from odak.visualize import _arrays
from odak.visualize._arrays import coded_light, linear_light
from odak.visualize.blender.items import (
    Item,
    Mesh,
    diffuse,
    disc_mesh,
    emission,
    glass,
    grid_mesh,
    lens_mesh,
    linear_color,
    metal,
    positive,
    profile_sheet,
    sheet_mesh,
    sphere_mesh,
    three,
    tube_mesh,
)

# Default thickness of a line as a fraction of the extent of the drawing.
THIN = 1 / 400
ORIGIN = (0.0, 0.0, 0.0)
# Gap drawn between cemented faces, as a fraction of the thickness of the glass behind them: a renderer cannot determine
# which of two coincident faces comes first. A gap between parallel faces does not change the directions of rays.
GAP = 1e-4


class Lines:
    """The part of a scene that draws rays, lines and points."""

    # Attributes of the scene that this class is a part of.
    _add: Any

    def add_rays(
        self,
        rays: Any,
        distance: float = 1.0,
        *,
        radius: float | None = None,
        color: str = "red",
        material: Any = None,
        name: str = "rays",
    ) -> Item:
        """Draw rays as thin emitting rods, all of them as one object.

        Parameters
        ----------
        rays : array
            ``[2, 3]`` or ``[m, 2, 3]``: starts and directions. Rays that are not finite, as those that missed, are
            left out.
        distance : float or array
            How far they go, one number or ``[m]``, in units of the direction's length.
        radius : float, optional
            Of a rod; by default 1/400 of the extent of all rays.
        color : str or array
            A name or "#rrggbb", or sRGB from 0 to 1: ``[3]``, or a colour for each ray ``[m, 3]``.
        material : optional
            What the rods are made of, in place of something that shines; see :meth:`add_mesh`.
        name : str
            Name of the object.

        Returns
        -------
        Item
            The object.

        Raises
        ------
        ValueError
            If a shape is wrong, or no ray is left.

        Examples
        --------
        >>> from odak.visualize import blender
        >>> picture = blender.scene(unit="mm")
        >>> picture.add_rays([[[0, 0, 0], [0, 0, 1]], [[0, 5, 0], [0, 0.6, 0.8]]], distance=10).name
        'rays'
        """
        directions = _arrays.real_array("rays", rays)
        _validate.shaped("rays", directions, "[2, 3] or [m, 2, 3], not empty")
        count = 1 if directions.ndim == 2 else len(directions)
        lengths = _arrays.real_array("distance", distance)
        lengths = np.where(np.isfinite(lengths), lengths, np.nan)
        starts, ends = _arrays.reach(rays, lengths)
        kept = np.isfinite(directions.reshape(count, 6)).all(-1) & np.isfinite(lengths.reshape(-1))
        lines = np.stack((starts, ends), axis=1)
        if not (starts != ends).any():
            raise ValueError("rays must be finite and distance must not be 0, so that a ray has a start and an end")
        return self.add_lines(lines, radius=radius, color=_of_kept(color, kept), material=material, name=name)

    def add_lines(
        self, points: Any, *, radius: float | None = None, color: str = "red", material: Any = None, name: str = "lines"
    ) -> Item:
        """Draw paths from point to point, such as rays through a lens.

        Parameters
        ----------
        points : array
            ``[k, 3]`` or ``[m, k, 3]``: m paths of k points. A path ends where a point is not finite.
        radius : float, optional
            Of a rod; by default 1/400 of the extent of all paths.
        color : str or array
            A name or "#rrggbb", or sRGB from 0 to 1: ``[3]``, or a colour for each path ``[m, 3]``.
        material : optional
            What they are made of, in place of something that shines; see :meth:`add_mesh`.
        name : str
            Name of the object.

        Returns
        -------
        Item
            The object.

        Raises
        ------
        ValueError
            If a shape is wrong, or nothing is left to draw.
        """
        paths = _arrays.real_array("points", points).astype(np.float64)
        _validate.shaped("points", paths, "[2 or more, 3] or [m, 2 or more, 3]")
        paths = paths.reshape(-1, *paths.shape[-2:])
        reached = np.logical_and.accumulate(np.isfinite(paths).all(-1), axis=1)
        starts, ends = paths[:, :-1], paths[:, 1:]
        drawn = reached[:, 1:] & (np.where(reached[:, 1:, None], ends - starts, 0.0) != 0).any(-1)
        if not drawn.any():
            raise ValueError(f"points must have a path with at least two finite points, got {len(paths)} paths without")
        starts, ends = starts[drawn], ends[drawn]
        if radius is None:
            corners = np.concatenate((starts, ends))
            radius = float(np.linalg.norm(np.ptp(corners, axis=0))) * THIN
        radius, sides = positive("radius", radius), 8
        # Emitting surfaces need no normals, which take most of the time for many rays.
        mesh = tube_mesh(starts, ends, radius, sides, shaded=material is not None)
        one, many = _colors(color, len(paths))
        item = self._add(name, mesh, material, one, emission(), smooth=material is not None)
        if item.material.kind == "emission":
            thick = np.full((len(starts), 1), radius)
            item.rods = np.stack([np.hstack((place, thick)) for place in (starts, ends)], 1).astype(np.float32)
        if many is not None:
            path = np.broadcast_to(np.arange(len(paths))[:, None], drawn.shape)[drawn]
            item.colors = np.repeat(many[path], len(mesh.vertices) // len(path), axis=0).astype(np.float32)
        return item

    def add_points(
        self,
        points: Any,
        *,
        radius: float | None = None,
        color: str = "red",
        material: Any = None,
        name: str = "points",
    ) -> Item:
        """Draw points as small spheres.

        Parameters
        ----------
        points : array
            ``[3]`` or ``[m, 3]``; those that are not finite are left out.
        radius : float, optional
            Of a ball; by default 3/400 of the extent of all points.
        color : str or array
            A name or "#rrggbb", or sRGB from 0 to 1: ``[3]``, or a colour for each point ``[m, 3]``.
        material : optional
            What they are made of, in place of something that shines; see :meth:`add_mesh`.
        name : str
            Name of the object.

        Returns
        -------
        Item
            The object.

        Raises
        ------
        ValueError
            If a shape is wrong, or no point is left.
        """
        places = _arrays.points("points", points).astype(np.float64)
        kept = np.isfinite(places).all(-1)
        if not kept.any():
            raise ValueError(f"points must have at least one finite point, got {len(places)} that are not finite")
        one, many = _colors(color, len(places))
        places = places[kept]
        if radius is None:
            radius = 3 * THIN * float(np.linalg.norm(np.ptp(places, axis=0))) or 1.0
        ball = sphere_mesh(positive("radius", radius), 16)
        count = len(ball.vertices)
        offsets = np.arange(len(places), dtype=np.int32)[:, None, None] * count
        normals: Any = ball.normals
        mesh = Mesh(
            (places[:, None] + ball.vertices).reshape(-1, 3),
            (ball.faces + offsets).reshape(-1, 3),
            np.tile(normals, (len(places), 1)),
        )
        item = self._add(name, mesh, material, one, emission(), smooth=True)
        if many is not None:
            item.colors = np.repeat(many[kept], count, axis=0).astype(np.float32)
        return item

    def add_cylinder(
        self,
        start: Any,
        end: Any,
        radius: float,
        *,
        color: Any = None,
        material: Any = None,
        segments: int = 64,
        name: str = "cylinder",
    ) -> Item:
        """Draw a closed cylinder between two points.

        Parameters
        ----------
        start, end : sequence of float
            Middles of its two ends.
        radius : float
            Its radius.
        color : str or array, optional
            A name or "#rrggbb", or sRGB from 0 to 1 ``[3]``.
        material : Material, str, float or catalogue material, optional
            From :func:`diffuse` (the default), :func:`emission`, :func:`glass` or :func:`metal`; or a glass by its name
            or index, or "mirror".
        name : str, optional
            Name of the object.
        segments : int
            How many flat sides it is cut into.

        Returns
        -------
        Item
            The object.
        """
        starts, ends = (_arrays.points(n, v).astype(np.float64) for n, v in (("start", start), ("end", end)))
        if len(starts) != 1 or len(ends) != 1 or not np.isfinite([starts, ends]).all():
            raise ValueError(f"start and end must be finite points [3], got {starts.tolist()} and {ends.tolist()}")
        if (starts == ends).all():
            raise ValueError(f"start and end must be different points, got {starts[0].tolist()} for both")
        segments = _validate.integer("segments", segments, minimum=3)
        mesh = tube_mesh(starts, ends, positive("radius", radius), segments)
        return self._add(name, mesh, material, color, diffuse(), smooth=True)


def _of_kept(color, kept: np.ndarray):
    """Return the colours of the rays kept."""
    if isinstance(color, str) or color is None:
        return color
    found = _arrays.real_array("color", color)
    if found.ndim == 2 and len(found) not in (1, len(kept)):
        raise ValueError(f"color must be one, or one for each of {len(kept)}, got {list(found.shape)}")
    return found[kept] if found.ndim == 2 and len(found) == len(kept) else found


def _colors(color, count: int):
    """Return one colour for all (as given), or linear colours ``[count, 3]``; the other is None."""
    if isinstance(color, str) or color is None:
        return color, None
    found = _arrays.real_array("color", color)
    if found.ndim == 1:
        return found, None
    if found.shape not in ((count, 3), (1, 3)):
        raise ValueError(f"color must be [3], or one for each of {count}: [{count}, 3]; got {list(found.shape)}")
    if not (found >= 0).all() or not (found <= 1).all():
        raise ValueError("color must be red, green, blue from 0 to 1")
    return None, np.broadcast_to(linear_light(found.astype(np.float64)), (count, 3))


class Shapes:
    """The part of a scene that draws meshes, surfaces and balls."""

    # Attributes of the scene that this class is a part of.
    _add: Any

    def add_mesh(
        self,
        mesh: Any,
        faces: Any = None,
        *,
        color: Any = None,
        material: Any = None,
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
            Position; degrees about X, then Y, then Z, after scaling.
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
        color, many = _colors(color, len(found.vertices))
        item = self._add(default if name is None else name, found, material, color, diffuse(), smooth=smooth)
        item.location, item.rotation = three("location", location), three("rotation", rotation)
        item.scale, item.colors = three("scale", scale), None if many is None else many.astype(np.float32)
        return item

    def add_surface(
        self,
        surface: Callable[..., Any],
        y: Any = None,
        z: Any = None,
        *,
        u: Sequence[float] = (0.0, 1.0),
        v: Sequence[float] = (0.0, 1.0),
        resolution: Sequence[int] = (65, 65),
        size: Sequence[float] | None = None,
        smooth: bool = True,
        name: str = "surface",
        **options: Any,
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
            (left, right), (low, high) = (_validate.few(name, span, 2) for name, span in (("u", u), ("v", v)))
            across, along = np.meshgrid(np.linspace(left, right, columns), np.linspace(low, high, rows))
            points = _grid(surface(across, along), (rows, columns))
        elif y is None and z is None:
            heights = _arrays.image("surface", surface)
            if size is None:
                raise ValueError("size must be the extent of the heights along x and y, got None")
            width, height = _validate.few("size", size, 2, positive=True)
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
        color: Any = None,
        material: Any = None,
        segments: int = 128,
        name: str = "sphere",
    ) -> Item:
        """Draw a sphere.

        Parameters
        ----------
        center : array
            Its centre ``[3]``, or a sphere of odak ``[4]``: centre and radius, in place of `radius`.
        radius : float
            Its radius.
        color : str or array, optional
            A name or "#rrggbb", or sRGB from 0 to 1 ``[3]``.
        material : Material, str, float or catalogue material, optional
            From :func:`diffuse` (the default), :func:`emission`, :func:`glass` or :func:`metal`; or a glass by its name
            or index, or "mirror".
        name : str, optional
            Name of the object.
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
        return self._add(name, mesh, material, color, diffuse(), smooth=True, location=three("center", given))

    def add_plane(
        self,
        size: Sequence[float] = (1.0, 1.0),
        *,
        location: Sequence[float] = ORIGIN,
        rotation: Sequence[float] = ORIGIN,
        color: Any = None,
        material: Any = None,
        name: str = "plane",
    ) -> Item:
        """Draw a rectangle, before its rotation in the plane z = 0 and facing +z.

        Parameters
        ----------
        size : sequence of float
            Extent along x and y.
        location : sequence of float
            Where its middle stands.
        rotation : sequence of float
            Degrees about X, then Y, then Z.
        color : str or array, optional
            A name or "#rrggbb", or sRGB from 0 to 1 ``[3]``.
        material : Material, str, float or catalogue material, optional
            From :func:`diffuse` (the default), :func:`emission`, :func:`glass` or :func:`metal`; or a glass by its name
            or index, or "mirror".
        name : str, optional
            Name of the object.

        Returns
        -------
        Item
            The object.
        """
        width, height = (side / 2 for side in _validate.few("size", size, 2, positive=True))
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
        color: Any = None,
        material: Any = None,
        segments: int = 128,
        name: str = "disc",
    ) -> Item:
        """Draw a disc, before its rotation in the plane z = 0 and facing +z; arguments as in :meth:`add_plane`."""
        mesh = disc_mesh(positive("radius", radius), _validate.integer("segments", segments, minimum=3))
        return self.add_mesh(mesh, color=color, material=material, location=location, rotation=rotation, name=name)

    def add_image(
        self,
        image: Any,
        size: Sequence[float],
        *,
        location: Sequence[float] = ORIGIN,
        rotation: Sequence[float] = ORIGIN,
        shines: bool = True,
        name: str = "image",
    ) -> Item:
        """Add a picture, before its rotation in the plane z = 0, upright (y) and seen from +z.

        Parameters
        ----------
        image : str or array
            Name of an image file, or sRGB values: ``[rows, columns]`` or ``[rows, columns, 3]``, integers from 0 to 255
            or floats from 0 to 1. From behind it is mirrored.
        size : sequence of float
            Width and height.
        location : sequence of float
            Where its middle stands.
        rotation : sequence of float
            Degrees about X, then Y, then Z.
        name : str, optional
            Name of the object.
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


def pixels(name: str, image: Any) -> np.ndarray:
    """Return a picture, given as a file or as numbers, as uint8 ``[rows, columns, 3]``."""
    if isinstance(image, (str, os.PathLike)):
        with _validate.refusing(f"{name} cannot be read: ", ValueError):
            image = read_levels(image)
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
    """Return the name and the mesh of a file, an object or arrays."""
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
    vertices = _arrays.points("mesh", mesh)
    return "mesh", Mesh(vertices, _arrays.faces("faces", faces, len(vertices), "mesh"))


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


class Lenses:
    """The part of a scene that draws lenses."""

    # Attributes of the scene that this class is a part of.
    metres: float
    _add: Any
    add_lines: Any

    def add_lens(
        self,
        radii: Any,
        thickness: float | None = None,
        diameter: float | None = None,
        material: str = "N-BK7",
        *,
        conics: Sequence[float] = (0.0, 0.0),
        coefficients: Sequence[Sequence[float]] = ((), ()),
        location: Sequence[float] = ORIGIN,
        rotation: Sequence[float] = ORIGIN,
        color: Any = None,
        segments: int = 128,
        ground: bool = True,
        name: str = "lens",
    ) -> Item:
        """Draw a lens of glass.

        Parameters
        ----------
        radii : sequence of float or plano_convex_lens
            Radii of curvature of its front and back, positive with the centre behind the vertex (towards +z), infinite
            for a plane. Or a lens of ``odak.catalog``, whose shape, glass and place are taken.
        thickness : float
            Distance between the vertices.
        diameter : float
            Diameter of the edge.
        material : str, float or Material
            A material of ``odak.catalog`` by name or by itself, taken at the scene's wavelength, an index, or what
            :func:`glass` returns.
        conics : sequence of float
            Conic constants of front and back.
        coefficients : sequence of sequence of float
            Of r², r⁴, r⁶, …, added to the conics.
        location, rotation : sequence of float
            Where its front vertex stands; degrees about X, then Y, then Z about that vertex. Unrotated, its axis is z.
        color : str or sequence of float, optional
            A name or "#rrggbb", or sRGB from 0 to 1 ``[3]``.
        name : str, optional
            Name of the object.
        segments : int
            Number of facets around its edge; the normals are exact for any number.
        ground : bool
            Make the edge matt, as edges of lenses are ground; otherwise it is polished as the faces.

        Returns
        -------
        Item
            The object.

        Raises
        ------
        ValueError
            If a number is out of range, a face does not reach the edge, or the faces meet within it.

        Examples
        --------
        >>> from odak.visualize import blender
        >>> picture = blender.scene(unit="mm")
        >>> lens = picture.add_lens([51.5, float("inf")], thickness=4.0, diameter=25.0)
        >>> round(lens.material.index, 4)
        1.5168
        """
        start = 0.0
        if hasattr(radii, "convex_surface"):
            lens, start = radii, -radii.thickness
            location, rotation, material = lens.location, lens.rotation, glass(lens.index())
            radii, thickness, diameter = (lens.radius, math.inf), lens.thickness, lens.diameter
        if thickness is None or diameter is None:
            raise TypeError("thickness and diameter must be given for a lens that is not of the catalogue")
        thickness, semi = positive("thickness", thickness), positive("diameter", diameter) / 2
        curvatures = [_curvature(radius) for radius in _pair("radii", radii)]
        conics = [float(_validate.real("conics", value)) for value in _pair("conics", conics)]
        terms = [tuple(_validate.numbers(value)) for value in _pair("coefficients", coefficients)]
        segments, ground = _validate.integer("segments", segments, minimum=8), _validate.flag("ground", ground)
        front, back = (
            profile_sheet(curvature, conic, series, semi, place, segments)
            for curvature, conic, series, place in zip(
                curvatures, conics, terms, (start, start + thickness), strict=True
            )
        )
        _check(front[0], back[0], thickness)
        mesh = lens_mesh(front, back)
        place = {"location": three("location", location), "rotation": three("rotation", rotation)}
        rim = 2 * segments if ground else 0
        return self._add(name, mesh, material, color, glass(), smooth=True, ground=rim, **place)

    def add_system(
        self,
        system: Any,
        pupil: str = "y",
        count: int = 7,
        *,
        radius: float | None = None,
        colors: Sequence[Any] = COLOURS,
        location: Sequence[float] = ORIGIN,
        rotation: Sequence[float] = ORIGIN,
        segments: int = 128,
        name: str = "system",
    ) -> list[Item]:
        """Draw an optical system of ``odak.learn.raytracing.system``, and rays traced through it.

        Parameters
        ----------
        system : optical_system
            The system. Its unit is converted to the scene's.
        pupil, count
            Which rays of each field to draw, as in ``odak.learn.raytracing.system.launch``; a `count` of 0 draws none.
        radius : float, optional
            Of a ray, in the scene's unit; by default 1/400 of the extent of all.
        colors : sequence
            Of the rays, one for each field in turn.
        location, rotation : sequence of float
            Where its first vertex stands; degrees about X, then Y, then Z about it.
        segments : int
            How many pieces an edge is cut into.
        name : str
            What the names of the objects begin with.

        Returns
        -------
        list of Item
            Lenses, mirrors and rays.

        Notes
        -----
        Rays and indices of glasses are for the reference wavelength. Surfaces without a semi-diameter are
        drawn as far as rays reach, shifts and tilts are drawn. Cemented lenses stand 1/10 000 of a thickness apart.
        """
        from odak.learn.raytracing.system import launch
        from odak.learn.raytracing.system.sketches import system_scene
        from odak.learn.raytracing.system.surfaces import is_break, is_glass

        if not isinstance(getattr(system, "surfaces", None), Iterable):
            raise TypeError(
                f"system must be an odak.learn.raytracing.system.optical_system, got {type(system).__name__}"
            )
        segments = _validate.integer("segments", segments, minimum=8)
        _validate.instance("name", name, str, "a string")
        if isinstance(colors, str) or not isinstance(colors, Iterable) or not (colors := list(colors)):
            raise TypeError(f"colors must be a sequence of colours, got {colors!r:.80}")
        unit = MICROMETRES[system.unit] * 1e-6 / self.metres
        scene = system_scene(system, launch(system, pupil, max(_validate.integer("count", count), 2)))
        surfaces, in_front_of_glass = scene.items[:-1], dict(scene.elements())
        sheets = [scene.sheet(i, max(segments // 4, 8), segments) for i in range(len(surfaces))]
        drawn = []

        def keep(mesh: Mesh, material, part: str, ground: int = 0) -> None:
            scaled = mesh._replace(vertices=mesh.vertices * unit)
            item = self._add(f"{name} {part}", scaled, material, None, None, smooth=True, ground=ground)
            item.location, item.rotation = three("location", location), three("rotation", rotation)
            drawn.append(item)

        wavelength = system.wavelengths[system.reference]
        for i, item in enumerate(surfaces):
            if item.reflects and not is_break(item):
                keep(sheet_mesh(*sheets[i], facing=1), metal(), f"mirror {i}")
            elif i in in_front_of_glass:
                behind = item.material if item.material is not None else float(item.index)
                mesh = _element(sheets[i], sheets[in_front_of_glass[i]], is_glass(surfaces, i - 1))
                keep(mesh, glass(behind, wavelength, system.unit), f"lens {i}", 2 * segments)
        if count:
            fields, rays = scene.paths.shape[:2]
            coded = [coded_light(linear_color(color)) for color in colors]
            color = [coded[field % len(coded)] for field in range(fields) for _ in range(rays)]
            lines = scene.paths.reshape(fields * rays, -1, 3) * unit
            item = self.add_lines(lines, radius=radius, color=color, name=f"{name} rays")
            item.location, item.rotation = three("location", location), three("rotation", rotation)
            drawn.append(item)
        return drawn


def _curvature(radius) -> float:
    if isinstance(radius, str) or np.ndim(radius):
        raise TypeError(f"radii must be numbers, got {radius!r:.80}")
    radius = float(radius)
    if radius == 0 or math.isnan(radius):
        raise ValueError(f"radii must not be 0 or NaN, got {radius}")
    return 0.0 if math.isinf(radius) else 1 / radius


def _pair(name: str, value) -> list[Any]:
    _validate.listed(name, value, "a pair, one for the front and one for the back")
    pair = list(value)
    if len(pair) != 2:
        raise ValueError(f"{name} must be a pair, one for the front and one for the back, got {len(pair)}")
    return pair


def _check(front: np.ndarray, back: np.ndarray, thickness: float) -> None:
    """Raise ValueError unless the points of two faces reach the edge and leave a thickness there."""
    for which, points in (("front", front), ("back", back)):
        if np.isnan(points[-1]).any():
            raise ValueError(
                f"diameter must be smaller than the largest diameter of the {which}, got {2 * points[-1, 0, 0]:g}"
            )
    edge = back[-1, 0, 2] - front[-1, 0, 2]
    if edge <= 0:
        raise ValueError(
            f"thickness must leave a positive thickness at the edge, got {thickness:g}, which leaves {edge:.4g}"
        )


def _element(front, back, cemented: bool) -> Mesh:
    """Return one lens of a system, between sheets that rays meet in this order; they may propagate towards −z."""
    across = back[0][0, 0] - front[0][0, 0]
    if cemented:
        front = front[0] + GAP * across, front[1]
    return lens_mesh(front, back) if across @ front[1][0, 0] > 0 else lens_mesh(back, front)
