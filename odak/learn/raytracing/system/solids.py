"""Lenses of a system as solids: closed meshes with rims, files of them in STL, PLY, glTF and STEP."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch

from odak import _validate
from odak.catalog.materials import MICROMETRES
from odak.learn.raytracing.system.pupils import launch
from odak.learn.raytracing.system.sketches import SystemScene, system_scene
from odak.learn.raytracing.system.surfaces import checked_system, optical_system
from odak.tools.asset import write_mesh
from odak.tools.paths import replacing, temporary_name, validate_path

SUFFIXES = (".stl", ".ply", ".glb", ".step", ".stp")
# Light blue glass through which what is behind it is seen: red, green, blue, opacity.
GLASS = [0.6, 0.8, 0.95, 0.35]
# Points along the profile of an aspheric face of a STEP file, through which a cubic spline passes.
PROFILE = 65


class LensSolid(NamedTuple):
    """The closed mesh of one piece of glass.

    Attributes
    ----------
    surfaces : tuple of int
        Numbers of the surfaces in front of it and behind it.
    diameter : float
        Of its edge.
    vertices : numpy.ndarray
        Global coordinates, the vertex of the first surface being the origin, ``[v, 3]`` in float64.
    faces : numpy.ndarray
        Numbers of the vertices of each triangle, counter-clockwise seen from outside, int32 ``[f, 3]``.

    Examples
    --------
    >>> from odak.learn.raytracing.system import LensSolid, lens_solids, load_system
    >>> isinstance(lens_solids(load_system("singlet"))[0], LensSolid)
    True
    """

    surfaces: tuple[int, int]
    diameter: float
    vertices: np.ndarray
    faces: np.ndarray

    @property
    def volume(self) -> float:
        """Enclosed volume, by the divergence theorem: the sum of the tetrahedra from the origin to each triangle."""
        return float(np.linalg.det(self.vertices[self.faces]).sum() / 6)


@torch.no_grad()
def lens_solids(
    system: optical_system, segments: int = 96, *, diameters: float | Mapping[int, float] | None = None
) -> list[LensSolid]:
    """Return each piece of glass of a system as a closed mesh with a cylindrical edge.

    Parameters
    ----------
    system : optical_system
        The system. Mirrors without glass in front of them are no solids.
    segments : int
        Number of pieces that a circle is cut into, at least 8; a quarter of them go from the vertex to the rim.
    diameters : float or mapping of int to float, optional
        Diameters of the edges in the unit of the system, for all elements or by the number of the surface in front.
        By default the larger clear diameter of both faces: of the semi-diameter, the smallest aperture, or else 1.05
        times the distance of the outermost ray from the axis.

    Returns
    -------
    list of LensSolid
        In the order of the surfaces; both sides of a cemented face are there, each with its own element.

    Raises
    ------
    ValueError
        If the faces of an element cross, or leave no thickness at the edge, naming it.

    Notes
    -----
    From its clear semi-diameter to the edge a face continues as a plane annulus, as lenses are made. The volume of the
    mesh is below that of the lens by about 7 over the square of `segments`, 8e-4 for 96.

    Examples
    --------
    A plano-convex lens of radius 50 mm, diameter 20 mm and 2 mm at its edge is a cylinder under a spherical cap:

    >>> import math
    >>> from odak.learn.raytracing.system import lens_solids, optical_system, surface
    >>> height = 50 - math.sqrt(50**2 - 10**2)
    >>> front = surface(50.0, thickness=2 + height, material="N-BK7", semi_diameter=10.0)
    >>> (solid,) = lens_solids(optical_system([front, surface(thickness=90.0, semi_diameter=10.0)], aperture=10.0), 512)
    >>> exact = math.pi * (10**2 * 2 + height**2 * (3 * 50 - height) / 3)
    >>> abs(solid.volume / exact - 1) < 1e-4
    True
    """
    scene, pairs = _scene(system)
    segments = _validate.integer("segments", segments, minimum=8)
    found = []
    for (front, behind), radius in zip(pairs, _edges(scene, pairs, diameters), strict=True):
        clear = [min(scene.radii[i], radius) for i in (front, behind)]
        radii = np.unique([*np.linspace(0, radius, segments // 4 + 1), *clear])
        sheets = [_sheet(scene, i, radii, segments) for i in (front, behind)]
        _check_faces(front, behind, *sheets)
        found.append(_closed((front, behind), 2 * radius, *sheets))
    return found


def save_solids(
    system: optical_system,
    path: str | Path,
    segments: int = 96,
    *,
    diameters: float | Mapping[int, float] | None = None,
) -> None:
    """Write the lenses of a system as solids.

    Parameters
    ----------
    system : optical_system
        The system.
    path : str or pathlib.Path
        File that ends in .stl (binary), .ply, .glb (glTF, by the package trimesh), .step or .stp (by an OpenCascade
        binding, the package cadquery-ocp). It appears whole or not at all.
    segments : int
        Number of pieces that a circle is cut into, as in :func:`lens_solids`. STEP files have none: their faces are
        exact spheres, planes, cylinders, and surfaces of revolution of cubic splines through 65 points of an aspheric
        profile.
    diameters : float or mapping of int to float, optional
        Diameters of the edges, as in :func:`lens_solids`.

    Raises
    ------
    ValueError
        If the faces of an element cross; for STEP also if one is not a surface of revolution about a common axis.
    ImportError
        If the package that writes the format is missing.

    Notes
    -----
    STL and PLY have no unit: numbers are those of the system. glTF is in metres, STEP in millimetres.

    Examples
    --------
    >>> import os, tempfile
    >>> from odak.learn.raytracing.system import load_system, save_solids
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     save_solids(load_system("cooke_triplet"), os.path.join(folder, "triplet.stl"))
    ...     os.listdir(folder)
    ['triplet.stl']
    """
    name = validate_path(path, SUFFIXES)
    kind = Path(name).suffix.lower()
    if kind in (".step", ".stp"):
        _write_step(system, name, diameters)
        return
    solids = lens_solids(system, segments, diameters=diameters)
    if kind == ".glb":
        _write_glb(solids, name, MICROMETRES[system.unit] * 1e-6)
        return
    counts = np.cumsum([0] + [len(solid.vertices) for solid in solids[:-1]])
    vertices = np.concatenate([solid.vertices for solid in solids])
    faces = np.concatenate([solid.faces + count for solid, count in zip(solids, counts, strict=True)])
    if kind == ".ply":
        write_mesh(name, vertices, faces)
        return
    record = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    triangles = np.zeros(len(faces), record)
    triangles["corners"] = corners = vertices[faces]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    triangles["normal"] = across / np.linalg.norm(across, axis=-1, keepdims=True)
    with replacing(name) as stream:
        stream.write(f"lenses, unit {system.unit}".encode().ljust(80))
        stream.write(np.uint32(len(triangles)).astype("<u4").tobytes() + triangles.tobytes())


def _scene(system: optical_system) -> tuple[SystemScene, list[tuple[int, int]]]:
    """Return the surfaces in space and the numbers of those in front of each piece of glass and behind it."""
    scene = system_scene(checked_system(system), launch(system, "rings", 3))
    if not (pairs := scene.elements()):
        raise ValueError("system must have a lens: there is no glass between two of its surfaces")
    return scene, pairs


def _edges(scene: SystemScene, pairs: list[tuple[int, int]], diameters: Any) -> list[float]:
    """Return the radius of the edge of each element."""
    own = {front: max(scene.radii[front], scene.radii[behind]) for front, behind in pairs}
    if isinstance(diameters, Mapping):
        if unknown := set(diameters) - set(own):
            known = ", ".join(map(str, own))
            raise ValueError(f"diameters must be of elements behind the surfaces {known}, got {min(unknown)}")
        given = {i: _validate.constant("diameters", value, positive=True) / 2 for i, value in diameters.items()}
        return list((own | given).values())
    if diameters is not None:
        return [_validate.constant("diameters", diameters, positive=True) / 2] * len(own)
    return list(own.values())


def _sheet(scene: SystemScene, i: int, radii: np.ndarray, segments: int) -> np.ndarray:
    """Return points ``[rings, segments, 3]`` of a face at distances from its vertex, the first of which is 0.

    Beyond the clear semi-diameter the face is a plane annulus.
    """
    around = np.arange(segments) * (2 * np.pi / segments)
    circle = np.stack([np.cos(around), np.sin(around)], -1)
    clear = np.minimum(radii, scene.radii[i])[:, None]
    points = scene.points(i, *np.moveaxis(clear[..., None] * circle, -1, 0))[0]
    if np.isnan(points).any():
        raise ValueError(
            f"surfaces[{i}] must exist up to its semi-diameter to be a face of a solid, got {scene.radii[i]:g}"
        )
    return points + (radii[:, None] - clear)[..., None] * (circle @ scene.frames[i][0].T[:2])


def _check_faces(front: int, behind: int, first: np.ndarray, second: np.ndarray) -> None:
    """Raise ValueError if two faces touch or cross, compared along the axis at equal distances from it."""
    axis = second[0, 0] - first[0, 0]
    room = float(((second - first) @ axis).min()) / max(float(np.linalg.norm(axis)), 1e-300)
    if not room > 0:
        raise ValueError(
            f"the faces of the element between surfaces[{front}] and surfaces[{behind}] must not cross, got a "
            f"thickness of {room:.3g} within its edge; give a smaller diameter or a larger thickness"
        )


def _closed(surfaces: tuple[int, int], diameter: float, first: np.ndarray, second: np.ndarray) -> LensSolid:
    """Return the closed mesh between two sheets; each vertex is there once, so that no edge is open."""
    segments = first.shape[1]
    # From the vertex in front outwards, across the edge, and inwards to the vertex behind.
    rings = np.concatenate([first[1:], second[:0:-1]]).reshape(-1, 3)
    vertices = np.concatenate([first[0, :1], rings, second[0, :1]])
    here = np.arange(len(rings) - segments).reshape(-1, segments) + 1
    following = np.roll(here, -1, axis=1)
    bands = [(here, here + segments, following), (following, here + segments, following + segments)]
    ring, last = np.arange(segments), len(vertices) - 1
    ahead = np.roll(ring, -1)
    ends = [(0 * ring, 1 + ring, 1 + ahead), (0 * ring + last, last - segments + ahead, last - segments + ring)]
    faces = np.concatenate([np.stack(part, -1).reshape(-1, 3) for part in bands + ends]).astype(np.int32)
    solid = LensSolid(surfaces, diameter, vertices, faces)
    # Light that runs towards −z meets the faces in the other order.
    return solid if solid.volume > 0 else solid._replace(faces=faces[:, ::-1])


def _write_glb(solids: list[LensSolid], name: str, metres: float) -> None:
    """Write a binary glTF file of transparent lenses, one mesh for each, in metres."""
    try:
        import trimesh
    except ImportError as error:
        raise ImportError("glTF needs the package trimesh: pip install trimesh") from error
    material = trimesh.visual.material.PBRMaterial(
        name="glass", baseColorFactor=GLASS, metallicFactor=0.0, roughnessFactor=0.05, alphaMode="BLEND"
    )
    parts = trimesh.Scene()
    for solid in solids:
        mesh = trimesh.Trimesh(solid.vertices * metres, solid.faces, process=False)
        mesh.visual = trimesh.visual.TextureVisuals(material=material)
        label = f"lens {solid.surfaces[0]}"
        parts.add_geometry(mesh, node_name=label, geom_name=label)
    with replacing(name) as stream:
        content: Any = trimesh.exchange.gltf.export_glb(parts)
        stream.write(content)


def _write_step(system: optical_system, name: str, diameters: Any) -> None:
    """Write solids of revolution by OpenCascade, each in its place, in millimetres."""
    try:
        from OCP.BRepBuilderAPI import BRepBuilderAPI_MakeFace, BRepBuilderAPI_MakeWire
        from OCP.BRepPrimAPI import BRepPrimAPI_MakeRevol
        from OCP.gp import gp_Ax1, gp_Dir, gp_Pnt
        from OCP.IFSelect import IFSelect_RetDone
        from OCP.Message import Message, Message_Gravity
        from OCP.STEPControl import STEPControl_AsIs, STEPControl_Writer
    except ImportError as error:
        raise ImportError("STEP needs the package cadquery-ocp: pip install cadquery-ocp") from error
    # The meshes are made for their checks.
    lens_solids(system, 16, diameters=diameters)
    scene, pairs = _scene(system)
    for printer in Message.DefaultMessenger_s().Printers():
        # Otherwise it tells what it writes on the standard output.
        printer.SetTraceLevel(Message_Gravity.Message_Fail)
    scale, writer = MICROMETRES[system.unit] * 1e-3, STEPControl_Writer()
    for (front, behind), edge in zip(pairs, _edges(scene, pairs, diameters), strict=True):
        matrix, origin = scene.frames[front]
        across, axis = matrix[:, 0], matrix[:, 2]
        _check_axis(scene, front, behind)
        outline, corners = BRepBuilderAPI_MakeWire(), []
        for i in (front, behind):
            clear = min(scene.radii[i], edge)
            radii, heights, slopes = _profile(scene, i, clear, origin, axis)
            places = scale * (origin + radii[:, None] * across + heights[:, None] * axis)
            parts = [_curve(places, across + slopes[[0, -1], None] * axis, scene.items[i].shape)]
            corners.append((places[0], places[-1] + scale * (edge - clear) * across))
            parts += [_line(places[-1], corners[-1][1])] if clear < edge else []
            # The outline goes around: outwards in front, inwards behind.
            if i == behind:
                parts = [_line(corners[0][1], corners[1][1]), *parts[::-1]]
            for part in parts:
                outline.Add(part)
        outline.Add(_line(corners[1][0], corners[0][0]))
        turned = gp_Ax1(gp_Pnt(*map(float, scale * origin)), gp_Dir(*map(float, axis)))
        solid = BRepPrimAPI_MakeRevol(BRepBuilderAPI_MakeFace(outline.Wire()).Face(), turned).Shape()
        writer.Transfer(solid, STEPControl_AsIs)
    with temporary_name(name) as partial:
        if writer.Write(partial) != IFSelect_RetDone:
            raise OSError(f"{name!r} cannot be written")


def _check_axis(scene: SystemScene, front: int, behind: int) -> None:
    """Raise ValueError unless both faces of an element are surfaces of revolution about one axis."""
    (matrix, origin), (other, place) = scene.frames[front], scene.frames[behind]
    axis, gap = matrix[:, 2], place - origin
    size = max(scene.radii[front], scene.radii[behind])
    alike = np.abs(np.cross(axis, other[:, 2])).max() < 1e-12 and np.abs(np.cross(axis, gap)).max() < 1e-12 * size
    for i in (front, behind):
        circle = scene.radii[i] * np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0], [0.6, 0.8]])
        heights = (scene.points(i, *circle.T)[0] - origin) @ axis
        alike = alike and float(np.ptp(heights)) < 1e-9 * size
    if not alike:
        raise ValueError(
            f"the element between surfaces[{front}] and surfaces[{behind}] is not a solid of revolution, as STEP files "
            "are written: save it as .stl, .ply or .glb"
        )


def _profile(scene: SystemScene, i: int, clear: float, origin: np.ndarray, axis: np.ndarray) -> tuple[Any, ...]:
    """Return radii, heights from a point along an axis, and slopes of a face of revolution, ``[points]`` each."""
    radii = np.linspace(0, clear, PROFILE)
    points, normals = scene.points(i, radii, np.zeros(PROFILE))
    # The first of its axes is across, the radius.
    across = scene.frames[i][0][:, 0]
    return radii, (points - origin) @ axis, -(normals @ across) / (normals @ axis)


def _line(start: np.ndarray, end: np.ndarray) -> Any:
    from OCP.BRepBuilderAPI import BRepBuilderAPI_MakeEdge
    from OCP.gp import gp_Pnt

    return BRepBuilderAPI_MakeEdge(gp_Pnt(*start.tolist()), gp_Pnt(*end.tolist())).Edge()


def _curve(places: np.ndarray, tangents: np.ndarray, shape: Any) -> Any:
    """Return the edge of a profile: a line, an arc, or a cubic spline with given slopes at its ends."""
    from OCP.BRepBuilderAPI import BRepBuilderAPI_MakeEdge
    from OCP.collections import HArray1_gp_Pnt
    from OCP.GC import GC_MakeArcOfCircle
    from OCP.GeomAPI import GeomAPI_Interpolate
    from OCP.gp import gp_Pnt, gp_Vec

    curvature, conic = (float(value) for value in shape.base())
    if shape.closed_form and curvature == 0:
        return _line(places[0], places[-1])
    points = [gp_Pnt(*place.tolist()) for place in places]
    if shape.closed_form and conic == 0:
        return BRepBuilderAPI_MakeEdge(GC_MakeArcOfCircle(points[0], points[PROFILE // 2], points[-1]).Value()).Edge()
    array = HArray1_gp_Pnt(1, PROFILE)
    for number, point in enumerate(points, 1):
        array.SetValue(number, point)
    spline = GeomAPI_Interpolate(array, False, 1e-9)
    spline.Load(*(gp_Vec(*tangent.tolist()) for tangent in tangents))
    spline.Perform()
    return BRepBuilderAPI_MakeEdge(spline.Curve()).Edge()
