"""Rays, lines and points in a scene."""

from typing import Any

import numpy as np

from odak import _validate
from odak.visualize import _arrays
from odak.visualize.blender.items import Item, positive
from odak.visualize.blender.materials import diffuse, emission, linear_light
from odak.visualize.blender.meshes import Mesh, sphere_mesh, tube_mesh

# Share of the extent of what is drawn that a line is thick when nothing else is said.
THIN = 1 / 400


class Lines:
    """The part of a scene that draws rays, lines and points."""

    # What the scene has that this is a part of.
    _add: Any

    def add_rays(
        self, rays, distance=1.0, *, radius: float | None = None, color="red", material=None, name: str = "rays"
    ) -> Item:
        """Draw rays as thin rods that shine, all of them as one object.

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
        if directions.ndim not in (2, 3) or directions.shape[-2:] != (2, 3) or not len(directions):
            raise ValueError(f"rays must be [2, 3] or [m, 2, 3], not empty; got {list(directions.shape)}")
        count = 1 if directions.ndim == 2 else len(directions)
        lengths = _arrays.real_array("distance", distance)
        lengths = np.where(np.isfinite(lengths), lengths, np.nan)
        starts, ends = _arrays.reach(rays, lengths)
        kept = np.isfinite(directions.reshape(count, 6)).all(-1) & np.isfinite(lengths.reshape(-1))
        lines = np.stack((starts, ends), axis=1)
        if not (starts != ends).any():
            raise ValueError(
                "points must hold a path of more than one finite point: rays must be finite and distance not 0"
            )
        return self.add_lines(lines, radius=radius, color=_of_kept(color, kept), material=material, name=name)

    def add_lines(
        self, points, *, radius: float | None = None, color="red", material=None, name: str = "lines"
    ) -> Item:
        """Draw paths from point to point, such as those of rays through a lens.

        Parameters
        ----------
        points : array
            ``[k, 3]`` or ``[m, k, 3]``: m paths of k points. A path ends where a point is not finite.
        radius, color, material, name
            As in :meth:`add_rays`; a colour may be given for each path.

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
        paths = paths[None] if paths.ndim == 2 else paths
        if paths.ndim != 3 or paths.shape[-1] != 3 or paths.shape[1] < 2:
            raise ValueError(f"points must be [k, 3] or [m, k, 3] with k at least 2, got {list(np.shape(points))}")
        reached = np.logical_and.accumulate(np.isfinite(paths).all(-1), axis=1)
        starts, ends = paths[:, :-1], paths[:, 1:]
        drawn = reached[:, 1:] & (np.where(reached[:, 1:, None], ends - starts, 0.0) != 0).any(-1)
        if not drawn.any():
            raise ValueError(f"points must hold a path of more than one finite point, got {len(paths)} without any")
        starts, ends = starts[drawn], ends[drawn]
        if radius is None:
            corners = np.concatenate((starts, ends))
            radius = float(np.linalg.norm(np.ptp(corners, axis=0))) * THIN
        radius, sides = positive("radius", radius), 8
        # What shines looks the same without normals, which are most of the work for many rays.
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
        self, points, *, radius: float | None = None, color="red", material=None, name: str = "points"
    ) -> Item:
        """Draw points as small balls.

        Parameters
        ----------
        points : array
            ``[3]`` or ``[m, 3]``; those that are not finite are left out.
        radius, color, material, name
            As in :meth:`add_rays`; a colour may be given for each point.

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
            raise ValueError(f"points must hold a finite one, got {len(places)} without any")
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
        self, start, end, radius: float, *, color=None, material=None, segments: int = 64, name: str = "cylinder"
    ) -> Item:
        """Draw a closed cylinder between two points.

        Parameters
        ----------
        start, end : sequence of float
            Middles of its two ends.
        radius : float
            Its radius.
        color, material, name
            As in :meth:`add_mesh`.
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
            raise ValueError(f"start and end must be apart, got {starts[0].tolist()} for both")
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
