"""Export of rays and surfaces as meshes in PLY, OBJ and glTF files."""

import os
from collections.abc import Sequence
from typing import Any

import numpy as np

from odak import _validate
from odak._array import Array
from odak.tools.asset import write_elements
from odak.tools.paths import replacing, validate_path, write_file
from odak.visualize import _arrays
from odak.visualize._arrays import linear_light

VERTEX = np.dtype([(axis, "f4") for axis in "xyz"])
FACE = np.dtype([("vertex_indices", "i4", (3,)), *((name, "u1") for name in ("red", "green", "blue"))])
# A square prism: its corners p0, p0 + (k, 0, 0), p0 + (k, k, 0), p0 + (0, k, 0), then the same at p1.
SQUARE = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
PRISM = np.array(
    [
        [0, 3, 1],
        [1, 3, 2],
        [0, 4, 7],
        [0, 7, 3],
        [4, 5, 6],
        [4, 6, 7],
        [5, 1, 2],
        [5, 2, 6],
        [2, 3, 6],
        [3, 7, 6],
        [0, 1, 5],
        [0, 5, 4],
    ]
)
WHITE = (255, 255, 255)
# An attribute of the user's own for trimesh, until it is named as glTF does.
_COLOR = "_COLOR"


class PLY_object:
    """A mesh of rays and surfaces, each with its colour, to be saved.

    Attributes
    ----------
    pnts : numpy.ndarray or None
        Vertices: x, y, z in float32. None as long as nothing is drawn.
    tris : numpy.ndarray or None
        Triangles: ``vertex_indices``, and ``red``, ``green``, ``blue`` in 8 bits.

    Notes
    -----
    PLY and OBJ have no unit: the numbers are written as they are. glTF's is the metre; see :meth:`save_glTF`.

    Examples
    --------
    >>> from odak.visualize import PLY_object
    >>> mesh = PLY_object()
    >>> mesh.draw_a_ray([0.0, 0.0, 0.0], [0.0, 0.0, 50.0], color=[255, 0, 0])
    >>> len(mesh.pnts), len(mesh.tris)
    (8, 12)
    """

    def __init__(self):
        self._vertices: list[np.ndarray] = []
        self._faces: list[np.ndarray] = []
        # Whether the triangles approximate a curved surface, which is shaded as one.
        self._smooth: list[np.ndarray] = []

    @property
    def pnts(self) -> np.ndarray | None:
        """Vertices, a structured array, or None."""
        return _joined(self._vertices)

    @property
    def tris(self) -> np.ndarray | None:
        """Triangles with their colours, a structured array, or None."""
        return _joined(self._faces)

    def draw_a_ray(
        self, point0: Array, point1: Array, k: float = 0.02, color: Sequence[int] = WHITE, perpendicular: bool = False
    ) -> None:
        """Add a ray as a square prism.

        Parameters
        ----------
        point0 : array
            Start ``[3]``.
        point1 : array
            End ``[3]``.
        k : float
            Side of the square.
        color : sequence of int
            Red, green, blue from 0 to 255.
        perpendicular : bool
            Make the square perpendicular to the ray and centred on it. Otherwise it lies in the x–y plane, with the
            ray along one corner, and a ray that runs in that plane is flat.

        Raises
        ------
        ValueError, TypeError
            If an argument is not of the form described.
        """
        starts, ends = _arrays.pairs(("point0", "point1"), point0, point1)
        if len(starts) != 1:
            raise ValueError(f"point0 and point1 must be one point each, got {len(starts)}; use draw_rays")
        for name, ends_ in (("point0", starts), ("point1", ends)):
            if not np.isfinite(ends_).all():
                raise ValueError(f"{name} must be finite")
        self._draw_prisms(starts, ends, k, color, perpendicular)

    def draw_rays(
        self,
        rays: Array,
        distance: float | Array = 1.0,
        k: float = 0.02,
        color: Sequence[int] = WHITE,
        perpendicular: bool = True,
    ) -> None:
        """Add rays as square prisms; those that are NaN are left out.

        Parameters
        ----------
        rays : array
            ``[2, 3]`` or ``[m, 2, 3]``: starts and directions.
        distance : float or array
            Length that is drawn: one number, or m.
        k : float
            Side of the square.
        color : sequence of int
            Red, green, blue from 0 to 255.
        perpendicular : bool
            Make the square perpendicular to the ray and centred on it; otherwise it lies in the x–y plane, with the ray
            along one corner.
        """
        starts, ends = _arrays.reach(rays, distance)
        self._draw_prisms(starts, ends, k, color, perpendicular)

    def draw_triangles(self, triangles: Array, color: Sequence[int] = WHITE) -> None:
        """Add triangles.

        Parameters
        ----------
        triangles : array
            Corners ``[3, 3]`` or ``[m, 3, 3]``.
        color : sequence of int
            Red, green, blue from 0 to 255.
        """
        corners = _arrays.triangles("triangles", triangles)
        if not np.isfinite(corners).all():
            raise ValueError("triangles must have finite vertices")
        self._append(corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3), color)

    def draw_surface(self, data_x: Array, data_y: Array, data_z: Array, color: Sequence[int] = WHITE) -> None:
        """Add a surface, two triangles for each cell of a grid.

        Parameters
        ----------
        data_x : array
            Abscissae ``[m, n]``, or ``[n]`` of the columns.
        data_y : array
            Ordinates ``[m, n]``, or ``[m]`` of the rows.
        data_z : array
            Heights ``[m, n]``. Triangles at a point that is NaN are left out.
        color : sequence of int
            Red, green, blue from 0 to 255.
        """
        x, y, z = _arrays.heights(data_x, data_y, data_z, least=2)
        points = np.stack(
            [np.broadcast_to(x, z.shape), np.broadcast_to(y[:, None] if y.ndim == 1 else y, z.shape), z], axis=-1
        )
        faces, points = _arrays.grid_faces(*z.shape), points.reshape(-1, 3)
        good = np.isfinite(points).all(-1)
        renumbered = np.cumsum(good) - 1
        self._append(points[good], renumbered[faces[good[faces].all(-1)]], color, smooth=True)

    def save_PLY(self, savefn: str | os.PathLike[str] = "out.ply", text: bool = True) -> None:
        """Write a PLY file.

        Parameters
        ----------
        savefn : str or os.PathLike
            A ``.ply`` file, written atomically.
        text : bool
            ASCII; little-endian binary otherwise, a third of the size.

        Raises
        ------
        ValueError
            If nothing is drawn, or the path is not acceptable.
        """
        write_elements(validate_path(savefn, [".ply"]), *self._content(), _validate.flag("text", text))

    def save_OBJ(self, savefn: str | os.PathLike[str] = "out.obj") -> None:
        """Write an OBJ file of text, colours as red, green, blue from 0 to 1 behind the coordinates of each vertex.

        Parameters
        ----------
        savefn : str or os.PathLike
            A ``.obj`` file, written atomically.

        Raises
        ------
        ValueError
            If nothing is drawn, or the path is not acceptable.
        """
        vertices, faces = self._content()
        places = np.stack([vertices[axis] for axis in "xyz"], axis=-1).tolist()
        colours = (_vertex_colors(vertices, faces)[:, :3] / 255).tolist()
        lines = [
            "v {:.9g} {:.9g} {:.9g} {:.6g} {:.6g} {:.6g}".format(*p, *c) for p, c in zip(places, colours, strict=True)
        ]
        lines += ["f {} {} {}".format(*corner) for corner in (faces["vertex_indices"] + 1).tolist()]
        write_file(validate_path(savefn, [".obj"]), ("\n".join(lines) + "\n").encode())

    def save_glTF(self, savefn: str | os.PathLike[str] = "out.glb", unit: str = "mm") -> None:
        """Write a binary glTF file by the package trimesh, with normals, colours and double-sided matt materials.

        There is one mesh for each colour. The colours are attributes of the vertices, ``COLOR_0``: linear red, green,
        blue and an opacity of 1, in float32. They multiply the colour of the material, which is white.

        Parameters
        ----------
        savefn : str or os.PathLike
            A ``.glb`` file, written atomically.
        unit : str
            Unit of the coordinates, "m", "mm", "um" or "nm"; glTF is in metres.

        Raises
        ------
        ValueError
            If nothing is drawn, or the path is not acceptable.
        ImportError
            If trimesh is missing.
        """
        vertices, faces = self._content()
        path = validate_path(savefn, [".glb"])
        scale = {"m": 1.0, "mm": 1e-3, "um": 1e-6, "nm": 1e-9}[_validate.one_of("unit", unit, ("m", "mm", "um", "nm"))]
        trimesh = _validate.optional("trimesh", "glTF needs the package trimesh: pip install trimesh")
        from trimesh.visual.material import PBRMaterial

        places = np.stack([vertices[axis] for axis in "xyz"], axis=-1).astype(np.float64) * scale
        shades = np.stack([faces[name] for name in ("red", "green", "blue")], axis=-1)
        smooth = np.concatenate(self._smooth)
        parts = trimesh.Scene()
        kinds = np.unique(np.column_stack([shades, smooth]), axis=0).tolist()
        for *shade, curved in kinds:
            chosen = faces["vertex_indices"][(shades == shade).all(-1) & (smooth == curved)]
            name = "#{:02x}{:02x}{:02x}".format(*shade)
            mesh = trimesh.Trimesh(*_with_normals(places, chosen, curved), process=False)  # type: ignore[misc]
            light = np.append(linear_light(np.array(shade) / 255), 1.0).astype(np.float32)
            # Trimesh would write colours in 8 bits, of which the dark linear ones need more.
            mesh.vertex_attributes[_COLOR] = np.tile(light, (len(mesh.vertices), 1))
            mesh.visual = trimesh.visual.TextureVisuals(material=PBRMaterial(name=name))
            parts.add_geometry(mesh)

        def finish(tree):
            for material in tree["materials"]:
                surface = {"baseColorFactor": [1.0] * 4, "metallicFactor": 0.0, "roughnessFactor": 1.0}
                material |= {"doubleSided": True, "pbrMetallicRoughness": surface}
            for part in (part for mesh in tree["meshes"] for part in mesh["primitives"]):
                part["attributes"]["COLOR_0"] = part["attributes"].pop(_COLOR)

        with replacing(path) as stream:
            content: Any = trimesh.exchange.gltf.export_glb(parts, include_normals=True, tree_postprocessor=finish)
            stream.write(content)

    def _draw_prisms(self, starts, ends, k, color, perpendicular) -> None:
        side = float(_validate.real("k", k, positive=True))
        if _validate.flag("perpendicular", perpendicular):
            across, up = _frame(ends - starts)
            square = SQUARE - 0.5
            corners = side * (square[:, :1] * across[:, None] + square[:, 1:] * up[:, None])
        else:
            corners = np.zeros((1, 4, 3))
            corners[0, :, :2] = side * SQUARE
        places = np.concatenate([starts[:, None] + corners, ends[:, None] + corners], axis=1)
        faces = PRISM + 8 * np.arange(len(places))[:, None, None]
        self._append(places.reshape(-1, 3), faces.reshape(-1, 3), color)

    def _append(self, places: np.ndarray, corners: np.ndarray, color, *, smooth: bool = False) -> None:
        """Add vertices and faces whose indices count from the first of these vertices."""
        shade = _arrays.real_array("color", color).reshape(-1)
        if shade.shape != (3,) or not ((shade >= 0) & (shade <= 255) & (shade == np.round(shade))).all():
            raise ValueError(f"color must be three integers from 0 to 255, got {color!r}")
        if not np.isfinite(places).all():
            raise ValueError("vertices must be finite")
        if not len(corners):
            return
        vertices, faces = np.empty(len(places), VERTEX), np.empty(len(corners), FACE)
        for axis, values in zip("xyz", places.T, strict=True):
            vertices[axis] = values
        faces["vertex_indices"] = corners + sum(map(len, self._vertices))
        for name, value in zip(("red", "green", "blue"), shade, strict=True):
            faces[name] = value
        self._vertices.append(vertices)
        self._faces.append(faces)
        self._smooth.append(np.full(len(corners), smooth))

    def _content(self) -> tuple[np.ndarray, np.ndarray]:
        vertices, faces = self.pnts, self.tris
        if vertices is None or faces is None:
            raise ValueError("the scene is empty: draw rays, triangles or surfaces before saving it")
        return vertices, faces


def _joined(pieces: list[np.ndarray]) -> np.ndarray | None:
    """Return all pieces as one array, which takes their place in the list."""
    if len(pieces) > 1:
        pieces[:] = [np.concatenate(pieces)]
    return pieces[0] if pieces else None


def _frame(along: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return two unit vectors perpendicular to each of ``[m, 3]`` directions and to each other."""
    along = along.astype(np.float64)
    length = np.linalg.norm(along, axis=-1, keepdims=True)
    if not (length > 0).all():
        raise ValueError(
            "a ray must have a length above 0 to be drawn as a tube: distance must not be 0, points must be different"
        )
    along = along / length
    # The axis least along the ray is never parallel to it.
    helper = np.eye(3)[np.abs(along).argmin(-1)]
    across = np.cross(helper, along)
    across /= np.linalg.norm(across, axis=-1, keepdims=True)
    return across, np.cross(along, across)


def _with_normals(places: np.ndarray, faces: np.ndarray, smooth: bool) -> tuple[Any, ...]:
    """Return vertices, faces, None for normals of faces, and unit normals at the vertices.

    Flat triangles have vertices of their own; over a smooth surface normals are means weighted by area.
    """
    corners = places[faces]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    if smooth:
        used, faces = np.unique(faces, return_inverse=True)
        places, faces = places[used], faces.reshape(-1, 3)
        normals = np.zeros_like(places)
        np.add.at(normals, faces.ravel(), np.repeat(across, 3, axis=0))
    else:
        places, faces = corners.reshape(-1, 3), np.arange(corners.size // 3).reshape(-1, 3)
        normals = np.repeat(across, 3, axis=0)
    length = np.linalg.norm(normals, axis=-1, keepdims=True)
    normals = np.where(length > 0, normals / np.where(length > 0, length, 1.0), [0.0, 0.0, 1.0])
    return places, faces, None, normals


def _vertex_colors(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Return the colour of each vertex, taken from its triangles, as 8-bit red, green, blue, opacity."""
    found = np.full((len(vertices), 4), 255, np.uint8)
    shades = np.stack([faces[name] for name in ("red", "green", "blue")], axis=-1)
    found[faces["vertex_indices"].reshape(-1), :3] = np.repeat(shades, 3, axis=0)
    return found
