"""Meshes and point clouds in PLY files."""

import os
from collections.abc import Sequence

import numpy as np

from odak import _validate
from odak.tools._paths import validate_path
from odak.tools._ply import read_mesh, read_points, write_mesh
from odak.tools.transformation import rotate_points

__all__ = ["read_PLY", "read_PLY_point_cloud", "write_PLY", "write_PLY_from_points"]


def read_PLY(
    fn: str | os.PathLike,
    offset: Sequence[float] = (0.0, 0.0, 0.0),
    angles: Sequence[float] = (0.0, 0.0, 0.0),
    mode: str = "XYZ",
) -> np.ndarray:
    """Read the triangles of a mesh, turned about the origin and then shifted.

    Parameters
    ----------
    fn : str or os.PathLike
        A ``.ply`` file, text or binary. Polygons become fans of triangles about their first corner.
    offset : sequence of float
        Shift after the rotation.
    angles : sequence of float
        Degrees about X, Y and Z.
    mode : str
        Order of the rotations, first letter first; one of the six permutations of "XYZ".

    Returns
    -------
    numpy.ndarray
        float32 ``[t, 3, 3]``: triangle, corner, coordinate.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If it is not a PLY file of a mesh, or a face names a vertex that does not exist.

    See Also
    --------
    write_PLY : The inverse.
    """
    vertices, faces = read_mesh(validate_path(fn, [".ply"]))
    vertices = rotate_points(vertices.astype(np.float64), angles, mode, offset=offset)
    return vertices.astype(np.float32)[faces]


def read_PLY_point_cloud(filename: str | os.PathLike) -> np.ndarray:
    """Read the vertices of a PLY file.

    Parameters
    ----------
    filename : str or os.PathLike
        A ``.ply`` file; faces and other properties are passed over.

    Returns
    -------
    numpy.ndarray
        float64 ``[n, 3]``.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If it is not a PLY file with vertices.
    """
    return read_points(validate_path(filename, [".ply"])).astype(np.float64)


def write_PLY(triangles: np.ndarray, savefn: str | os.PathLike = "output.ply") -> None:
    """Write triangles to a PLY file of text, three vertices for each, white.

    Parameters
    ----------
    triangles : array
        ``[t, 3, 3]``: triangle, corner, coordinate. Kept as float32.
    savefn : str or os.PathLike
        A ``.ply`` file; it appears whole or not at all.

    Raises
    ------
    ValueError
        If the shape or the name is wrong.
    """
    corners = np.asarray(_validate.array("triangles", triangles), dtype=np.float32)
    if corners.ndim != 3 or corners.shape[1:] != (3, 3):
        raise ValueError(f"triangles must be [t, 3, 3], got {corners.shape}")
    faces = np.arange(3 * len(corners)).reshape(-1, 3)
    write_mesh(validate_path(savefn, [".ply"]), corners.reshape(-1, 3), faces, text=True)


def write_PLY_from_points(points: np.ndarray, savefn: str | os.PathLike = "output.ply") -> None:
    """Write a surface given by a grid of points to a PLY file of text, two white triangles for each cell.

    Parameters
    ----------
    points : array
        ``[m, n, 3]``, kept as float32. Cell (i, j) gives the triangles (i+1, j), (i, j), (i, j+1) and
        (i+1, j), (i, j+1), (i+1, j+1).
    savefn : str or os.PathLike
        A ``.ply`` file; it appears whole or not at all.

    Raises
    ------
    ValueError
        If the shape or the name is wrong.
    """
    points = np.asarray(_validate.array("points", points), dtype=np.float32)
    if points.ndim != 3 or points.shape[-1] != 3 or min(points.shape[:2]) < 2:
        raise ValueError(f"points must be [m, n, 3] with m and n at least 2, got {points.shape}")
    number = np.arange(points.shape[0] * points.shape[1]).reshape(points.shape[:2])
    here, right, below, across = number[:-1, :-1], number[:-1, 1:], number[1:, :-1], number[1:, 1:]
    faces = np.stack([below, here, right, below, right, across], axis=-1).reshape(-1, 3)
    write_mesh(validate_path(savefn, [".ply"]), points.reshape(-1, 3), faces, text=True)
