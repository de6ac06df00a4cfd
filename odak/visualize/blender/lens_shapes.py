"""Lenses and whole optical systems in a scene."""

import math
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from odak import _validate
from odak.catalog.materials import MICROMETRES
from odak.visualize._arrays import coded_light
from odak.visualize.blender.items import Item, glass, linear_color, metal, positive, three
from odak.visualize.blender.meshes import Mesh, Profile, lens_mesh, profile_mesh

ORIGIN = (0.0, 0.0, 0.0)
COLORS = ("#2166ac", "#1b7837", "#b2182b", "#762a83", "#b35806", "#016665")
# Gap drawn between cemented faces, as a fraction of the thickness of the glass behind them: a renderer cannot determine
# which of two coincident faces comes first. A gap between parallel faces does not change the directions of rays.
GAP = 1e-4


class Lenses:
    """The part of a scene that draws lenses."""

    # Attributes of the scene that this class is a part of.
    metres: float
    _add: Any
    add_lines: Any

    def add_lens(
        self,
        radii,
        thickness: float | None = None,
        diameter: float | None = None,
        material="N-BK7",
        *,
        conics: Sequence[float] = (0.0, 0.0),
        coefficients: Sequence[Sequence[float]] = ((), ()),
        location: Sequence[float] = ORIGIN,
        rotation: Sequence[float] = ORIGIN,
        color=None,
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
        front, back = (Profile(*face, semi) for face in zip(curvatures, conics, terms, strict=True))
        _check(front, back, thickness)
        segments, ground = _validate.integer("segments", segments, minimum=8), _validate.flag("ground", ground)
        mesh = lens_mesh(front, back, thickness, segments).moved(start)
        item = self._add(name, mesh, material, color, glass(), smooth=True, ground=2 * segments if ground else 0)
        item.location, item.rotation = three("location", location), three("rotation", rotation)
        return item

    def add_system(
        self,
        system,
        pupil="y",
        count: int = 7,
        *,
        radius: float | None = None,
        colors: Sequence = COLORS,
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

        Raises
        ------
        ValueError
            If surfaces are shifted or tilted against each other, which this cannot draw.

        Notes
        -----
        Rays are those of the reference wavelength; glasses have their index at it. Surfaces without a semi-diameter are
        drawn as far as rays reach. Cemented lenses stand 1/10 000 of a thickness apart.
        """
        from odak.learn.raytracing.system.surfaces import drawn_radii, is_glass

        if not isinstance(getattr(system, "surfaces", None), Iterable):
            raise TypeError(
                f"system must be an odak.learn.raytracing.system.optical_system, got {type(system).__name__}"
            )
        segments = _validate.integer("segments", segments, minimum=8)
        if not isinstance(name, str):
            raise TypeError(f"name must be a string, got {type(name).__name__}")
        if isinstance(colors, str) or not isinstance(colors, Iterable) or not (colors := list(colors)):
            raise TypeError(f"colors must be a sequence of colours, got {colors!r:.80}")
        surfaces = list(system.surfaces)
        if any(bool(item.shift.any()) or bool(item.tilt.any()) for item in surfaces):
            raise ValueError("system must not have shifted or tilted surfaces; draw its lenses one by one")
        if any(item.own_shape is not None for item in surfaces):
            raise ValueError("system must consist of planes, conics and even aspheres; other shapes cannot be drawn")
        unit = MICROMETRES[system.unit] * 1e-6 / self.metres
        places = np.cumsum([0.0] + [float(item.thickness) for item in surfaces])
        paths, fields = _traced(system, pupil, max(_validate.integer("count", count), 2), places)
        reaches = np.nanmax(np.hypot(paths[:, 1:-1, 0], paths[:, 1:-1, 1]), axis=0, initial=0.0)
        profiles = [
            Profile(float(item.curvature), float(item.conic), tuple(item.coefficients.tolist()), radius)
            for item, radius in zip(surfaces, drawn_radii(surfaces, reaches), strict=True)
        ]
        drawn = []

        def keep(mesh: Mesh, material, part: str, ground: int = 0) -> None:
            scaled = mesh._replace(vertices=mesh.vertices * unit)
            item = self._add(f"{name} {part}", scaled, material, None, None, smooth=True, ground=ground)
            item.location, item.rotation = three("location", location), three("rotation", rotation)
            drawn.append(item)

        wavelength = system.wavelengths[system.reference]
        for i, item in enumerate(surfaces):
            if item.reflects:
                keep(profile_mesh(profiles[i], places[i], segments, facing=1), metal(), f"mirror {i}")
            elif item.material != "air" and i + 1 < len(surfaces):
                behind = item.material if item.material is not None else float(item.index)
                mesh = _element(profiles[i : i + 2], places[i : i + 2], is_glass(surfaces, i - 1), segments)
                keep(mesh, glass(behind, wavelength, system.unit), f"lens {i}", 2 * segments)
        if count:
            coded = [coded_light(linear_color(color)) for color in colors]
            color = [coded[field % len(coded)] for field in fields]
            item = self.add_lines(paths * unit, radius=radius, color=color, name=f"{name} rays")
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


def _pair(name: str, value) -> list:
    if isinstance(value, str) or not isinstance(value, Iterable):
        raise TypeError(f"{name} must be a pair, one for the front and one for the back, got {value!r:.80}")
    pair = list(value)
    if len(pair) != 2:
        raise ValueError(f"{name} must be a pair, one for the front and one for the back, got {len(pair)}")
    return pair


def _check(front: Profile, back: Profile, thickness: float) -> None:
    heights = []
    for which, face in (("front", front), ("back", back)):
        rim = face.at(np.array([face.semi_diameter]), np.array([0.0]))
        if not rim.defined[0]:
            raise ValueError(
                f"diameter must be smaller than the largest diameter of the {which}, got {2 * face.semi_diameter:g}"
            )
        heights.append(float(rim.height[0]))
    edge = thickness + heights[1] - heights[0]
    if edge <= 0:
        raise ValueError(
            f"thickness must leave a positive thickness at the edge, got {thickness:g}, which leaves {edge:.4g}"
        )


def _traced(system, pupil, count: int, places) -> tuple[np.ndarray, list[int]]:
    """Return the paths of rays ``[rays, stations, 3]`` in the system's unit, and the field of each."""
    import torch

    from odak.learn.raytracing.system import launch, trace

    with torch.no_grad():
        rays = launch(system, pupil, count)
        shape = torch.broadcast_shapes(*(value.shape for value in rays))
        x, y, z, u, v, w = (value.expand(shape)[:1] for value in rays)
        back = 0.25 * float(np.ptp(places)) + z if system.at_infinity else torch.zeros_like(z)
        stations = [torch.stack((x - back * u / w, y - back * v / w, z - back), -1)]
        row = slice(system.reference, system.reference + 1)
        for i in [*range(len(system.surfaces)), None]:
            found = trace(system, rays, until=i)
            last = places[len(system.surfaces) if i is None else i]
            stations.append(torch.stack((found.x[row], found.y[row], found.z[row] + last), -1))
        paths = torch.stack(stations, dim=-2)[0]
    fields = np.repeat(np.arange(paths.shape[0]), paths.shape[1]).tolist()
    return paths.reshape(-1, len(stations), 3).cpu().numpy(), fields


def _element(faces: list[Profile], places, cemented: bool, segments: int) -> Mesh:
    """Return one lens of a system; rays may propagate through it towards −z."""
    start, stop = float(places[0]), float(places[1])
    start += GAP * (stop - start) if cemented else 0.0
    if start > stop:
        start, stop, faces = stop, start, faces[::-1]
    mesh = lens_mesh(faces[0], faces[1], stop - start, segments)
    return mesh.moved(start)
