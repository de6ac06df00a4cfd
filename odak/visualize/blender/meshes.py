"""Shapes as triangles: points, faces and, where they are known, exact normals."""

from typing import NamedTuple

import numpy as np

from odak.raytracing.surfaces import even_asphere_sag


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

    def moved(self, distance: float) -> "Mesh":
        """Return the mesh shifted along z."""
        return self._replace(vertices=self.vertices + np.array([0.0, 0.0, distance]))


def grid_faces(rows: int, columns: int) -> np.ndarray:
    """Return two triangles for each cell of a grid of vertices, row by row: int32 ``[2·(rows−1)·(columns−1), 3]``."""
    index = np.arange(rows * columns, dtype=np.int32).reshape(rows, columns)
    near, right, up, far = index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]
    cells = np.stack((np.stack((near, right, far), -1), np.stack((near, far, up), -1)), axis=2)
    return cells.reshape(-1, 3)


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

    With `shaded`, their normals are those of cylinders, for which sides and ends take vertices of their own: 4·sides a
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
    """Return faces over rings of vertices: the lower and the upper one, and those of the caps from a number on."""
    here = np.arange(sides, dtype=np.int32)
    following = (here + 1) % sides
    walls = [(here, following, sides + following), (here, sides + following, sides + here)]
    fan = np.arange(1, sides - 1, dtype=np.int32)
    corner = np.zeros_like(fan)
    caps = [caps_from + np.stack((corner, fan + 1, fan), -1), caps_from + sides + np.stack((corner, fan, fan + 1), -1)]
    return np.concatenate([np.stack(wall, -1) for wall in walls] + caps)


class Profile(NamedTuple):
    """One face of a lens: z = height(r) above its vertex, out to a distance from the axis; see ``even_asphere_sag``."""

    curvature: float
    conic: float
    coefficients: tuple[float, ...]
    semi_diameter: float

    def at(self, x: np.ndarray, y: np.ndarray):
        """Return the sag and its derivatives at x and y."""
        return even_asphere_sag(x, y, self.curvature, self.conic, np.asarray(self.coefficients, dtype=np.float64))


def lens_mesh(front: Profile, back: Profile, thickness: float, segments: int) -> Mesh:
    """Return a lens with its front vertex at the origin and its back vertex at z = thickness.

    Faces and edge share no vertices, so that light sees the exact normals of each up to the rim.
    """
    first = profile_mesh(front, 0.0, segments, facing=-1)
    second = profile_mesh(back, thickness, segments, facing=1)
    around = np.linspace(0.0, 2 * np.pi, segments + 1)
    outwards = np.stack((np.cos(around), np.sin(around), 0 * around), axis=-1)
    rims = []
    for profile, place in ((front, 0.0), (back, thickness)):
        rim = profile.semi_diameter * outwards
        rim[:, 2] = place + profile.at(rim[:, 0], rim[:, 1]).height
        rims.append(rim)
    slant = np.array([0.0, 0.0, (front.semi_diameter - back.semi_diameter) / (rims[1][0, 2] - rims[0][0, 2])])
    normals = outwards + slant
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    edge = Mesh(np.concatenate(rims), grid_faces(2, segments + 1), np.concatenate((normals, normals)))
    return joined([first, second, edge])


def profile_mesh(profile: Profile, place: float, segments: int, facing: int) -> Mesh:
    """Return one face of a lens with its vertex at z = place, its outer side towards ``facing·z``."""
    rings = max(segments // 4, 8)
    distance = np.linspace(0.0, profile.semi_diameter, rings + 1)[:, None]
    around = np.linspace(0.0, 2 * np.pi, segments + 1)[None]
    x, y = distance * np.cos(around), distance * np.sin(around)
    sag = profile.at(x, y)
    points = np.stack((x, y, place + sag.height), axis=-1).reshape(-1, 3)
    normals = np.stack((-sag.slope_x, -sag.slope_y, np.ones_like(x)), axis=-1).reshape(-1, 3)
    normals *= facing / np.linalg.norm(normals, axis=-1, keepdims=True)
    # Along a ring, then outwards: that pair spans −z.
    faces = grid_faces(rings + 1, segments + 1)
    return Mesh(points, faces if facing < 0 else faces[:, ::-1], normals).without_slivers()


def joined(parts: list[Mesh]) -> Mesh:
    """Return meshes that all have normals as one."""
    counts = np.cumsum([0] + [len(part.vertices) for part in parts[:-1]])
    return Mesh(
        np.concatenate([part.vertices for part in parts]),
        np.concatenate([part.faces + count for part, count in zip(parts, counts, strict=True)]).astype(np.int32),
        np.concatenate([part.normals for part in parts]),
    )
