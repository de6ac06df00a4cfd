"""Triangle meshes and point clouds in PLY files."""

import os
from collections.abc import Sequence

import numpy as np
import plyfile

from odak import _array, _validate
from odak.tools.matrix import convert_to_numpy
from odak.tools.paths import replacing, validate_path
from odak.tools.transformation import rotate_points

__all__ = ["read_PLY", "read_PLY_point_cloud", "write_PLY", "write_PLY_from_points"]


def read_PLY(
    fn: str | os.PathLike,
    offset: Sequence[float] = (0.0, 0.0, 0.0),
    angles: Sequence[float] = (0.0, 0.0, 0.0),
    mode: str = "XYZ",
) -> np.ndarray:
    """Read the triangles of a mesh, rotated about the origin and then shifted.

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

    Examples
    --------
    >>> import os, tempfile
    >>> from odak.tools import read_PLY, write_PLY
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     name = os.path.join(folder, "triangle.ply")
    ...     write_PLY([[[0, 0, 0], [1, 0, 0], [0, 1, 0]]], name)
    ...     triangles = read_PLY(name, offset=(0, 0, 5))
    >>> triangles[0, 1].tolist()
    [1.0, 0.0, 5.0]
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

    Examples
    --------
    >>> import os, tempfile
    >>> from odak.tools import read_PLY_point_cloud, write_PLY
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     name = os.path.join(folder, "triangle.ply")
    ...     write_PLY([[[0, 0, 0], [1, 0, 0], [0, 1, 0]]], name)
    ...     points = read_PLY_point_cloud(name)
    >>> points.shape
    (3, 3)
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

    Examples
    --------
    >>> import os, tempfile
    >>> from odak.tools import read_PLY, write_PLY
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     name = os.path.join(folder, "triangle.ply")
    ...     write_PLY([[[0, 0, 0], [1, 0, 0], [0, 1, 0]]], name)
    ...     read_PLY(name).shape
    (1, 3, 3)
    """
    corners = _in_float32("triangles", triangles)
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

    Examples
    --------
    A grid of 2 by 3 points has two cells, of two triangles each:

    >>> import os, tempfile
    >>> import numpy as np
    >>> from odak.tools import read_PLY, write_PLY_from_points
    >>> y, x = np.meshgrid(np.arange(2.0), np.arange(3.0), indexing="ij")
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     name = os.path.join(folder, "plane.ply")
    ...     write_PLY_from_points(np.stack([x, y, 0 * x], axis=-1), name)
    ...     read_PLY(name).shape
    (4, 3, 3)
    """
    points = _in_float32("points", points)
    if points.ndim != 3 or points.shape[-1] != 3 or min(points.shape[:2]) < 2:
        raise ValueError(f"points must be [m, n, 3] with m and n at least 2, got {points.shape}")
    number = np.arange(points.shape[0] * points.shape[1]).reshape(points.shape[:2])
    here, right, below, across = number[:-1, :-1], number[:-1, 1:], number[1:, :-1], number[1:, 1:]
    faces = np.stack([below, here, right, below, right, across], axis=-1).reshape(-1, 3)
    write_mesh(validate_path(savefn, [".ply"]), points.reshape(-1, 3), faces, text=True)


LONGEST_HEADER = 1 << 16
# Exceptions that plyfile and NumPy raise on broken files.
_BROKEN = (plyfile.PlyParseError, KeyError, ValueError, TypeError, ArithmeticError, IndexError)
_BYTES = {"char": 1, "uchar": 1, "int8": 1, "uint8": 1, "short": 2, "ushort": 2, "int16": 2, "uint16": 2}
_BYTES |= {"int": 4, "uint": 4, "float": 4, "int32": 4, "uint32": 4, "float32": 4, "double": 8, "float64": 8}


def _in_float32(name, value) -> np.ndarray:
    """Return an array, a list or a tensor, which may have a gradient, as a NumPy array of float32."""
    value = _validate.array(name, value)
    return np.asarray(convert_to_numpy(value) if _array.is_torch(value) else value, dtype=np.float32)


def write_mesh(filename: str, vertices: np.ndarray, faces: np.ndarray, text: bool = False) -> None:
    """Write a mesh; float64 vertices stay float64, faces are int32 lists named vertex_indices, white.

    Parameters
    ----------
    filename : str
        Name that ends in ".ply". The file appears whole or not at all.
    vertices : numpy.ndarray
        Coordinates ``[v, 3]``.
    faces : numpy.ndarray
        Numbers of the three vertices of each triangle, ``[t, 3]``.
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
        data = read_elements(os.path.expanduser(filename))
        points, sides = data["vertex"].data, data["face"].data
        vertices = np.stack([points[axis] for axis in "xyz"], axis=-1)
        name = next(name for name in ("vertex_indices", "vertex_index") if name in sides.dtype.names)
    except (*_BROKEN, StopIteration) as error:
        raise ValueError(f"{filename!r} cannot be read as a PLY file of a mesh: {error}") from error
    vertices = vertices.astype(np.float64 if vertices.dtype == np.float64 else np.float32)
    if sides[name].ndim == 1 and sides[name].dtype != object:
        raise ValueError(f"{filename!r} has faces of one vertex: {name} is not a list")
    faces = _fans(sides[name])
    # Some programs write these numbers as floats; a NaN is not within any bounds.
    if len(faces) and not (faces.min() >= 0 and faces.max() < len(vertices) and np.array_equal(faces, faces // 1)):
        raise ValueError(f"{filename!r} has a face that names a vertex other than 0 to {len(vertices) - 1}")
    return vertices, faces.astype(np.int64)


def read_points(filename: str) -> np.ndarray:
    """Return the vertices ``[v, 3]`` of a PLY file, which need not hold faces; raises as :func:`read_mesh` does."""
    _check_name(filename)
    try:
        points = read_elements(os.path.expanduser(filename))["vertex"].data
        return np.stack([points[axis] for axis in "xyz"], axis=-1)
    except _BROKEN as error:
        raise ValueError(f"{filename!r} cannot be read as a PLY file of points: {error}") from error


def read_elements(path: str) -> plyfile.PlyData:
    """Return the elements of a PLY file, after checking that the file is as long as its header says."""
    with open(path, "rb") as stream:
        _check_promise(stream.read(LONGEST_HEADER), os.path.getsize(path))
    return plyfile.PlyData.read(path)


def _check_promise(start: bytes, size: int) -> None:
    """Raise ValueError if a header declares more data than the file can contain, before memory is allocated for it."""
    newline = b"\r\n" if start[3:5] == b"\r\n" else start[3:4]
    if start[:3] != b"ply" or newline not in (b"\n", b"\r", b"\r\n"):
        raise ValueError("it does not begin with 'ply'")
    text = any(line.split()[:2] == [b"format", b"ascii"] for line in start.split(newline)[:100])
    elements, ended = [], False
    for line in start.split(newline):
        words = line.split()
        if line == b"end_header":
            ended = True
            break
        if words[:1] == [b"element"] and len(words) > 2:
            elements.append([int(words[2]), 0])
        elif words[:1] == [b"property"] and len(words) > 2 and elements:
            # A list holds at least its length, and a number in ASCII takes at least a digit and a separator.
            kind = words[2 if words[1] == b"list" else 1].decode("ascii")
            elements[-1][1] += 1 if text else _BYTES.get(kind, 1)
    if not ended:
        raise ValueError(f"its header does not end within {LONGEST_HEADER} bytes")
    promised = sum(count * max(1, least) for count, least in elements)
    if promised > size or any(count < 0 for count, _ in elements):
        raise ValueError(f"its header promises at least {promised} bytes, and the file has {size}")


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
    return np.stack((corners[start], corners[start + step + 1], corners[start + step + 2]), axis=-1)


def _check_name(filename: str) -> None:
    if not str(filename).lower().endswith(".ply"):
        raise ValueError(f"filename must end in '.ply', got {filename!r}")
