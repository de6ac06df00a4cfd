"""Meshes in PLY files, through plyfile."""

import os

import numpy as np
import plyfile

from odak.tools._atomic import replacing


def write_mesh(filename: str, vertices: np.ndarray, faces: np.ndarray, text: bool = False) -> None:
    """Write a mesh; float64 vertices stay float64, faces are int32 lists named vertex_indices, white.

    Parameters
    ----------
    filename : str
        Name that ends in ".ply". The file appears whole or not at all.
    vertices, faces : numpy.ndarray
        ``[v, 3]`` and ``[t, 3]``.
    text : bool
        ASCII instead of little-endian binary.
    """
    _check_name(filename)
    kind = "f8" if vertices.dtype == np.float64 else "f4"
    corners = np.empty(len(vertices), dtype=[(axis, kind) for axis in "xyz"])
    for i, axis in enumerate("xyz"):
        corners[axis] = vertices[:, i]
    colours = [(name, "u1") for name in ("red", "green", "blue")]
    sides = np.empty(len(faces), dtype=[("vertex_indices", "i4", (3,)), *colours])
    sides["vertex_indices"] = faces
    for name, _ in colours:
        sides[name] = 255
    elements = [
        plyfile.PlyElement.describe(corners, "vertex", comments=["Vertex data"]),
        plyfile.PlyElement.describe(sides, "face", comments=["Face data"]),
    ]
    with replacing(os.path.expanduser(filename)) as stream:
        plyfile.PlyData(elements, text=text, byte_order="<").write(stream)


def read_mesh(filename: str) -> tuple[np.ndarray, np.ndarray]:
    """Return vertices ``[v, 3]``, float64 if the file's are, else float32, and faces int64 ``[t, 3]``.

    Polygons become fans of triangles about their first corner.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If it is not a PLY file, holds no vertices or faces, or a face names a vertex that does not exist.
    """
    _check_name(filename)
    try:
        data = plyfile.PlyData.read(os.path.expanduser(filename))
        points, sides = data["vertex"].data, data["face"].data
        vertices = np.stack([points[axis] for axis in "xyz"], axis=-1)
        name = next(name for name in ("vertex_indices", "vertex_index") if name in sides.dtype.names)
    except (plyfile.PlyParseError, KeyError, ValueError, StopIteration, UnicodeDecodeError) as error:
        raise ValueError(f"{filename!r} cannot be read as a PLY file of a mesh: {error}") from error
    vertices = vertices.astype(np.float64 if vertices.dtype == np.float64 else np.float32)
    faces = _fans(sides[name])
    if len(faces) and not 0 <= faces.min() <= faces.max() < len(vertices):
        raise ValueError(f"{filename!r} has a face that names a vertex beyond its {len(vertices)}")
    return vertices, faces


def read_points(filename: str) -> np.ndarray:
    """Return the vertices ``[v, 3]`` of a PLY file, which need not hold faces; raises as :func:`read_mesh` does."""
    _check_name(filename)
    try:
        points = plyfile.PlyData.read(os.path.expanduser(filename))["vertex"].data
        return np.stack([points[axis] for axis in "xyz"], axis=-1)
    except (plyfile.PlyParseError, KeyError, ValueError, UnicodeDecodeError) as error:
        raise ValueError(f"{filename!r} cannot be read as a PLY file of points: {error}") from error


def _fans(polygons: np.ndarray) -> np.ndarray:
    """Return triangles (0, k, k + 1) of all polygons, in order."""
    if not len(polygons):
        return np.zeros((0, 3), dtype=np.int64)
    counts = (
        np.array([len(p) for p in polygons]) if polygons.dtype == object else np.full(len(polygons), polygons.shape[1])
    )
    corners = np.concatenate([np.ravel(p) for p in polygons]) if polygons.dtype == object else polygons.ravel()
    first, fans = np.cumsum(counts) - counts, np.maximum(counts - 2, 0)
    start = np.repeat(first, fans)
    step = np.arange(fans.sum()) - np.repeat(np.cumsum(fans) - fans, fans)
    return np.stack((corners[start], corners[start + step + 1], corners[start + step + 2]), axis=-1).astype(np.int64)


def _check_name(filename: str) -> None:
    if not str(filename).lower().endswith(".ply"):
        raise ValueError(f"filename must end in '.ply', got {filename!r}")
