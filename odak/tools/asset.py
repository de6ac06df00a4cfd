"""Triangle meshes and point clouds in PLY files."""

import os
from collections.abc import Sequence

import numpy as np
import plyfile

from odak import _array, _validate
from odak.tools.paths import regular_file, replacing, validate_path
from odak.tools.transformation import rotate_points


def read_PLY(
    fn: str | os.PathLike[str],
    offset: Sequence[float] = (0.0, 0.0, 0.0),
    angles: Sequence[float] = (0.0, 0.0, 0.0),
    mode: str = "XYZ",
) -> np.ndarray:
    """Read the triangles of a mesh, rotated about the origin and then shifted.

    Parameters
    ----------
    fn : str or os.PathLike
        A ``.ply`` file, text or binary. Convex polygons become fans of triangles about their first corner, others are
        cut by their ears; strips of triangles (``tristrips``) are read too.
    offset : sequence of float
        Shift after the rotation.
    angles : sequence of float
        Degrees about X, Y and Z.
    mode : str
        Order of the rotations, first letter first; one of the six permutations of "XYZ".

    Returns
    -------
    numpy.ndarray
        float32 ``[t, 3, 3]``: triangle, corner, coordinate; float64 where float32 would move vertices by more than a
        hundred-thousandth of the size of the mesh, as it does far from the origin.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If it is not a PLY file of a mesh, or a face names a vertex that does not exist. Files of points are read by
        :func:`read_PLY_point_cloud`.

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
    with np.errstate(over="ignore", invalid="ignore"):
        single = vertices.astype(np.float32)
        if len(vertices) and not np.abs(single - vertices).max() <= _LOST * np.ptp(vertices, axis=0).max():
            return vertices[faces]
    return single[faces]


def read_PLY_point_cloud(filename: str | os.PathLike[str]) -> np.ndarray:
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


def write_PLY(triangles: np.ndarray, savefn: str | os.PathLike[str] = "output.ply") -> None:
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
    _validate.shaped("triangles", corners, "[t, 3, 3]")
    faces = np.arange(3 * len(corners)).reshape(-1, 3)
    write_mesh(validate_path(savefn, [".ply"]), corners.reshape(-1, 3), faces, text=True)


def write_PLY_from_points(points: np.ndarray, savefn: str | os.PathLike[str] = "output.ply") -> None:
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
    _validate.shaped("points", points, "[2 or more, 2 or more, 3]")
    number = np.arange(points.shape[0] * points.shape[1]).reshape(points.shape[:2])
    here, right, below, across = number[:-1, :-1], number[:-1, 1:], number[1:, :-1], number[1:, 1:]
    faces = np.stack([below, here, right, below, right, across], axis=-1).reshape(-1, 3)
    write_mesh(validate_path(savefn, [".ply"]), points.reshape(-1, 3), faces, text=True)


LONGEST_HEADER = 1 << 16
# Share of the size of a mesh by which float32 may move its vertices; corners of a polygon that is not convex.
_LOST, _MOST_CORNERS = 1e-5, 2048
# Times that all corners of a polygon are looked through for ears; one that crosses itself is cut anyhow afterwards.
_MOST_ROUNDS = 8
# Exceptions that plyfile and NumPy raise on broken files.
_BROKEN = (plyfile.PlyParseError, KeyError, ValueError, TypeError, ArithmeticError, IndexError)
_BYTES = {"char": 1, "uchar": 1, "int8": 1, "uint8": 1, "short": 2, "ushort": 2, "int16": 2, "uint16": 2}
_BYTES |= {"int": 4, "uint": 4, "float": 4, "int32": 4, "uint32": 4, "float32": 4, "double": 8, "float64": 8}


def _in_float32(name, value) -> np.ndarray:
    """Return an array, a list or a tensor, which may have a gradient, as a NumPy array of float32."""
    return np.asarray(_array.on_host(_validate.array(name, value)), dtype=np.float32)


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
    sides = np.full(len(faces), 255, dtype=[("vertex_indices", "i4", (3,)), *colours])
    sides["vertex_indices"] = faces
    write_elements(os.path.expanduser(filename), corners, sides, text)


def write_elements(path: str, vertices: np.ndarray, faces: np.ndarray, text: bool) -> None:
    """Write structured arrays of vertices and faces as a PLY file, of text or little-endian binary."""
    elements = [
        plyfile.PlyElement.describe(vertices, "vertex", comments=["Vertex data"]),
        plyfile.PlyElement.describe(faces, "face", comments=["Face data"]),
    ]
    with replacing(path) as stream:
        plyfile.PlyData(elements, text=text, byte_order="<").write(stream)


def read_mesh(filename: str) -> tuple[np.ndarray, np.ndarray]:
    """Return vertices ``[v, 3]`` and the numbers of the three vertices of each triangle, int64 ``[t, 3]``.

    Vertices are float64 if the file's are float64 or integers of four bytes, else float32. Convex polygons become fans
    of triangles about their first corner, others are cut by their ears; strips of triangles are taken apart.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If it is not a PLY file, holds no vertices or faces, or a face names a vertex that does not exist.
    """
    _check_name(filename)
    unreadable = f"{filename!r} cannot be read as a PLY file of a mesh: "
    with _validate.refusing(unreadable, *_BROKEN):
        data = read_elements(os.path.expanduser(filename))
        points = data["vertex"].data
        vertices = np.stack([points[axis] for axis in "xyz"], axis=-1)
        kinds = [element.name for element in data.elements]
        place = next((name for name in ("face", "tristrips") if name in kinds), None)
        if place is None:
            raise ValueError(
                f"it has no faces, but {', '.join(kinds)}; odak.tools.read_PLY_point_cloud reads its vertices"
            )
        sides = data[place].data
        name = next((name for name in ("vertex_indices", "vertex_index") if name in sides.dtype.names), None)
        if name is None:
            raise ValueError(f"its {place} have no list vertex_indices, but {', '.join(sides.dtype.names)}")
    wide = vertices.dtype == np.float64 or (vertices.dtype.kind in "iu" and vertices.dtype.itemsize >= 4)
    vertices = vertices.astype(np.float64 if wide else np.float32)
    if sides[name].ndim == 1 and sides[name].dtype != object:
        raise ValueError(f"{filename!r} has faces of one vertex: {name} is not a list")
    polygons = sides[name] if place == "face" else _triangles_of_strips(sides[name])
    counts, corners = _flattened(polygons)
    # Some programs write these numbers as floats; a NaN is not within any bounds.
    if len(corners) and not (
        corners.min() >= 0 and corners.max() < len(vertices) and np.array_equal(corners, corners // 1)
    ):
        raise ValueError(f"{filename!r} has a face that names a vertex other than 0 to {len(vertices) - 1}")
    with _validate.refusing(unreadable, ValueError):
        return vertices, _cut(vertices, counts, corners.astype(np.int64))


def read_points(filename: str) -> np.ndarray:
    """Return the vertices ``[v, 3]`` of a PLY file, which need not hold faces; raises as :func:`read_mesh` does."""
    _check_name(filename)
    with _validate.refusing(f"{filename!r} cannot be read as a PLY file of points: ", *_BROKEN):
        points = read_elements(os.path.expanduser(filename))["vertex"].data
        return np.stack([points[axis] for axis in "xyz"], axis=-1)


def read_elements(path: str) -> plyfile.PlyData:
    """Return the elements of a PLY file, after checking that the file is as long as its header says."""
    with open(regular_file(path), "rb") as stream:
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


def _flattened(polygons: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the number of corners of each polygon, and the vertices of all corners one after another."""
    if not len(polygons):
        return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
    if polygons.dtype != object:
        return np.full(len(polygons), polygons.shape[1]), polygons.ravel()
    return np.array([len(p) for p in polygons]), np.concatenate([np.ravel(p) for p in polygons])


def _triangles_of_strips(strips: np.ndarray) -> np.ndarray:
    """Return the triangles ``[t, 3]`` of strips, in which −1 begins a new one and each second triangle is turned."""
    found = [np.zeros((0, 3), dtype=np.int64)]
    for strip in strips:
        strip = np.ravel(strip)
        for part in np.split(strip, np.flatnonzero(strip == -1)):
            part = part[part != -1]
            triangles = np.stack([part[:-2], part[1:-1], part[2:]], axis=-1) if len(part) > 2 else found[0]
            triangles[1::2] = triangles[1::2, [1, 0, 2]]
            # Strips are joined by triangles without area, which name a vertex twice.
            a, b, c = triangles.T
            found.append(triangles[(a != b) & (b != c) & (c != a)])
    return np.concatenate(found)


def _cut(vertices: np.ndarray, counts: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Return the triangles of all polygons in order: fans (0, k, k + 1) where they are convex, and ears elsewhere."""
    first, fans = np.cumsum(counts) - counts, np.maximum(counts - 2, 0)
    start = np.repeat(first, fans)
    step = np.arange(fans.sum()) - np.repeat(np.cumsum(fans) - fans, fans)
    triangles = np.stack((corners[start], corners[start + step + 1], corners[start + step + 2]), axis=-1)
    ends = np.cumsum(fans)
    for count in np.unique(counts[counts > 3]):
        chosen = np.flatnonzero(counts == count)
        for part in np.array_split(chosen, -(-chosen.size * int(count) // (1 << 20))):
            for place, flat in _bent(vertices, corners[first[part][:, None] + np.arange(count)]):
                polygon = part[place]
                own = corners[first[polygon] : first[polygon] + count]
                triangles[ends[polygon] - count + 2 : ends[polygon]] = own[_ears(flat)]
    return triangles


def _bent(vertices, polygons):
    """Yield the places and the flat corners ``[n, 2]`` of the polygons among ``[p, n]`` that are not convex."""
    # A difference to the first corner keeps what far coordinates have in common out of the products.
    x = vertices[polygons].astype(np.float64)
    with np.errstate(over="ignore", invalid="ignore"):
        x = x - x[:, :1]
        # Newell's normal, of the plane that fits best.
        normal = np.cross(x, np.roll(x, -1, axis=1)).sum(1)
        before, after = x - np.roll(x, 1, axis=1), np.roll(x, -1, axis=1) - x
        turns = np.einsum("pnc,pc->pn", np.cross(before, after), normal)
        bent = (turns < -1e-9 * np.abs(turns).max(1, keepdims=True)).any(1)
    for place in np.flatnonzero(bent):
        if polygons.shape[1] > _MOST_CORNERS:
            raise ValueError(
                f"a polygon that is not convex has {polygons.shape[1]} corners; at most {_MOST_CORNERS} are cut"
            )
        # Seen along the axis nearest to the normal, counterclockwise.
        axis = int(np.abs(normal[place]).argmax())
        flat = np.delete(x[place], axis, axis=1)
        yield place, flat if (normal[place, axis] > 0) == (axis != 1) else flat[:, ::-1]


def _ears(flat: np.ndarray) -> np.ndarray:
    """Return the triangles ``[n − 2, 3]``, by numbers of corners, of a simple polygon ``[n, 2]``, counterclockwise.

    An ear is a corner that bulges outwards and whose triangle contains no other corner; it is cut off until a triangle
    is left (G. H. Meisters, "Polygons have ears", Amer. Math. Monthly 82, 648, 1975). Where a polygon crosses itself
    and has none, the corner that bulges most is cut.
    """
    left, cut = np.arange(len(flat)), []
    # Corners on the edge of an ear, to the digits of float32, lie within it: what is left without it has no area.
    least = 1e-6 * float(np.ptp(flat, axis=0).max()) ** 2
    # Whether a corner has to be tested: at first, and when a neighbour was cut off.
    untested, slack, place, rounds = np.ones(len(flat), dtype=bool), least, 0, 0
    while len(left) > 3:
        now = flat[left]
        before, after = np.roll(now, 1, axis=0), np.roll(now, -1, axis=0)
        turns = _doubled_area(before, now, after)
        waiting = np.flatnonzero(untested)
        ear = None
        for candidate in np.roll(waiting, -int(np.searchsorted(waiting, place))):
            untested[candidate] = False
            if _is_ear(before, now, after, turns, candidate, slack):
                ear = int(candidate)
                break
        if ear is None:
            if rounds < _MOST_ROUNDS:
                # Corners that turned inwards before may not be in the way any more; thin ears are cut every other time.
                untested[:], slack, rounds = True, 0.0 if slack else least, rounds + 1
                continue
            ear = int(turns.argmax())
        last, following = (ear - 1) % len(left), (ear + 1) % len(left)
        cut.append((left[last], left[ear], left[following]))
        untested[[last, following]] = True
        left, untested, place = np.delete(left, ear), np.delete(untested, ear), ear
    return np.array([*cut, left])


def _is_ear(before, now, after, turns, place, slack):
    """Return whether a corner bulges outwards by more than a slack, and no other lies in its triangle or so near."""
    if turns[place] <= slack:
        return False
    a, b, c = before[place], now[place], after[place]
    # Only corners at which the outline turns inwards can lie within an ear; those at its own corners are no obstacle.
    inward = now[turns <= slack]
    inside = np.ones(len(inward), dtype=bool)
    for one, other in ((a, b), (b, c), (c, a)):
        inside &= (_doubled_area(one, other, inward) >= -slack) & (inward != one).any(-1)
    return not inside.any()


def _doubled_area(a, b, c):
    """Return twice the area of triangles whose corners are counterclockwise."""
    return (b[..., 0] - a[..., 0]) * (c[..., 1] - a[..., 1]) - (b[..., 1] - a[..., 1]) * (c[..., 0] - a[..., 0])


def _check_name(filename: str) -> None:
    if not str(filename).lower().endswith(".ply"):
        raise ValueError(f"filename must end in '.ply', got {filename!r}")
