"""Files of 3-D Gaussian splatting: PLY files of Gaussians with spherical harmonics, and the cameras of COLMAP."""

import math
import os
import struct
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import plyfile
import torch

from odak import _validate
from odak.learn._tensors import floating, rows_of, shaped
from odak.learn.tools.transformation import PerspectiveCamera
from odak.tools.asset import read_elements
from odak.tools.paths import replacing, validate_path

__all__ = [
    "ColmapView",
    "Splats",
    "load_colmap",
    "load_splats",
    "save_splats",
    "spherical_harmonics",
    "view_colours",
]

# Errors that plyfile and NumPy raise on broken files.
_BROKEN = (plyfile.PlyParseError, KeyError, ValueError, TypeError, ArithmeticError, IndexError)
_MOST = 50_000_000
# Amplitude of the constant harmonic, and the grey level that it is added to in files of splatting.
_CONSTANT, _MIDDLE = 0.5 / math.sqrt(math.pi), 0.5
# Camera models of COLMAP without distortion: number in binary files, parameters, and (fx, fy, cx, cy) among them.
_MODELS = {"SIMPLE_PINHOLE": (0, 3, (0, 0, 1, 2)), "PINHOLE": (1, 4, (0, 1, 2, 3))}
_PARAMETERS = {0: 3, 1: 4, 2: 4, 3: 5, 4: 8, 5: 8, 6: 12, 7: 5, 8: 4, 9: 5, 10: 12}


class Splats(NamedTuple):
    """Gaussians in the form of files of 3-D Gaussian splatting (Kerbl et al. 2023).

    Attributes
    ----------
    means : torch.Tensor
        Centres ``[N, 3]``.
    quats : torch.Tensor
        Quaternions w, x, y, z ``[N, 4]``, not normalized.
    scales : torch.Tensor
        Logarithms of the standard deviations ``[N, 3]``.
    opacities : torch.Tensor
        Logits of the opacities ``[N]``.
    harmonics : torch.Tensor
        Coefficients of the spherical harmonics of the colour ``[N, (degree + 1)², 3]``.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.wave import Splats
    >>> splats = Splats(torch.zeros(2, 3), torch.ones(2, 4), torch.zeros(2, 3), torch.zeros(2), torch.zeros(2, 1, 3))
    >>> len(splats.means), torch.sigmoid(splats.opacities).tolist()
    (2, [0.5, 0.5])
    """

    means: torch.Tensor
    quats: torch.Tensor
    scales: torch.Tensor
    opacities: torch.Tensor
    harmonics: torch.Tensor


class ColmapView(NamedTuple):
    """One image of a reconstruction by COLMAP.

    Attributes
    ----------
    name : str
        Name of the image file.
    camera : PerspectiveCamera
        Camera with the axes of odak, in which both axes of the image are inverted.
    size : tuple of int
        Width and height of the image in pixels.

    Examples
    --------
    >>> import os, tempfile
    >>> from odak.learn.wave import load_colmap
    >>> from odak.tools import write_to_text_file
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     files = [os.path.join(folder, name) for name in ("cameras.txt", "images.txt")]
    ...     written = write_to_text_file(["1 PINHOLE 640 480 500 500 320 240"], files[0])
    ...     written = write_to_text_file(["1 1 0 0 0 0 0 0 1 first.png", ""], files[1])
    ...     views = load_colmap(folder)
    >>> views[0].name, views[0].size
    ('first.png', (640, 480))
    """

    name: str
    camera: PerspectiveCamera
    size: tuple[int, int]


def load_splats(path: str | os.PathLike) -> Splats:
    """Read a PLY file of 3-D Gaussian splatting.

    Parameters
    ----------
    path : str or os.PathLike
        ``.ply`` file with the properties x, y, z, f_dc_0 …, opacity, scale_0 …, rot_0 …, and f_rest_0 … for harmonics
        above degree 0.

    Returns
    -------
    Splats
        The Gaussians, float32.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If the path is not acceptable, or the file is broken or lacks a property.

    Examples
    --------
    >>> import os, tempfile
    >>> import torch
    >>> from odak.learn.wave import Splats, load_splats, save_splats
    >>> splats = Splats(torch.zeros(2, 3), torch.ones(2, 4), torch.zeros(2, 3), torch.zeros(2), torch.zeros(2, 1, 3))
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     name = os.path.join(folder, "scene.ply")
    ...     save_splats(name, splats)
    ...     again = load_splats(name)
    >>> torch.equal(again.quats, splats.quats)
    True
    """
    path = validate_path(path, [".ply"])
    if not os.path.exists(path):
        raise FileNotFoundError(f"there is no file {path!r}")
    try:
        vertices = read_elements(path)["vertex"].data
        names = set(vertices.dtype.names)
        rest = sum(name.startswith("f_rest_") for name in names)
        degree = math.isqrt(rest // 3 + 1) - 1
        if rest != 3 * ((degree + 1) ** 2 - 1):
            raise ValueError(f"{rest} properties f_rest_… are not those of a degree")

        def columns(*wanted: str) -> torch.Tensor:
            return torch.from_numpy(np.stack([vertices[name].astype(np.float32) for name in wanted], axis=-1))

        constant = columns("f_dc_0", "f_dc_1", "f_dc_2")[:, None]
        # The file holds all coefficients of red, then those of green and of blue.
        above = [columns(*(f"f_rest_{i}" for i in range(rest))).unflatten(1, (3, -1)).mT] if rest else []
        return Splats(
            columns("x", "y", "z"),
            columns("rot_0", "rot_1", "rot_2", "rot_3"),
            columns("scale_0", "scale_1", "scale_2"),
            columns("opacity")[:, 0],
            torch.cat([constant, *above], dim=1),
        )
    except _BROKEN as error:
        raise ValueError(f"{path!r} cannot be read as Gaussians: {error}") from error


def save_splats(path: str | os.PathLike, splats: Splats) -> None:
    """Write a PLY file of 3-D Gaussian splatting, atomically.

    Parameters
    ----------
    path : str or os.PathLike
        ``.ply`` file to write.
    splats : Splats
        The Gaussians.

    Raises
    ------
    ValueError
        If the path is not acceptable, or a shape is wrong.

    Examples
    --------
    >>> import os, tempfile
    >>> import torch
    >>> from odak.learn.wave import Splats, load_splats, save_splats
    >>> splats = Splats(torch.zeros(2, 3), torch.ones(2, 4), torch.zeros(2, 3), torch.zeros(2), torch.zeros(2, 1, 3))
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     name = os.path.join(folder, "scene.ply")
    ...     save_splats(name, splats)
    ...     again = load_splats(name)
    >>> torch.equal(again.quats, splats.quats)
    True
    """
    path = validate_path(path, [".ply"])
    splats = Splats(*splats)
    harmonics = shaped("splats.harmonics", splats.harmonics, "N", "K", 3).detach().cpu()
    _degree(harmonics.shape[1])
    count = len(harmonics)
    parts = {
        **dict(zip("xyz", shaped("splats.means", splats.means, count, 3).T, strict=True)),
        **dict.fromkeys(("nx", "ny", "nz"), torch.zeros(count)),
        **{f"f_dc_{i}": harmonics[:, 0, i] for i in range(3)},
        **{f"f_rest_{i}": column for i, column in enumerate(harmonics[:, 1:].mT.flatten(1).T)},
        "opacity": shaped("splats.opacities", splats.opacities, count),
        **{f"scale_{i}": column for i, column in enumerate(shaped("splats.scales", splats.scales, count, 3).T)},
        **{f"rot_{i}": column for i, column in enumerate(shaped("splats.quats", splats.quats, count, 4).T)},
    }
    vertices = np.empty(count, dtype=[(name, "f4") for name in parts])
    for name, column in parts.items():
        vertices[name] = column.detach().cpu().float().numpy()
    with replacing(path) as stream:
        plyfile.PlyData([plyfile.PlyElement.describe(vertices, "vertex")], byte_order="<").write(stream)


def spherical_harmonics(degree: int, directions: torch.Tensor) -> torch.Tensor:
    """Return the real spherical harmonics up to a degree, with the signs used by 3-D Gaussian splatting.

    They are orthonormal on the sphere: Y₀ = 1/(2√π); of degree 1: √(3/4π)·(−y, z, −x); and so on.

    Parameters
    ----------
    degree : int
        Highest degree, from 0 to 3.
    directions : torch.Tensor
        Unit vectors ``[..., 3]``.

    Returns
    -------
    torch.Tensor
        ``[..., (degree + 1)²]``.

    Examples
    --------
    >>> import torch
    >>> spherical_harmonics(1, torch.tensor([0.0, 0.0, 1.0]))
    tensor([0.2821, -0.0000, 0.4886, -0.0000])
    """
    if _validate.integer("degree", degree) > 3:
        raise ValueError(f"degree must be 0 to 3, got {degree}")
    directions = floating("directions", directions)
    if directions.ndim == 0 or directions.shape[-1] != 3:
        raise ValueError(f"directions must be [..., 3], got {list(directions.shape)}")
    x, y, z = directions.unbind(-1)
    xx, yy, zz = x * x, y * y, z * z
    root = [
        math.sqrt(n / math.pi) for n in (3 / 4, 15 / 4, 5 / 16, 15 / 16, 35 / 32, 105 / 4, 21 / 32, 7 / 16, 105 / 16)
    ]
    values: list[torch.Tensor] = [torch.full_like(x, _CONSTANT)]
    if degree > 0:
        values += [-root[0] * y, root[0] * z, -root[0] * x]
    if degree > 1:
        values += [root[1] * x * y, -root[1] * y * z, root[2] * (2 * zz - xx - yy), -root[1] * x * z]
        values += [root[3] * (xx - yy)]
    if degree > 2:
        values += [
            -root[4] * y * (3 * xx - yy),
            root[5] * x * y * z,
            -root[6] * y * (4 * zz - xx - yy),
            root[7] * z * (2 * zz - 3 * xx - 3 * yy),
            -root[6] * x * (4 * zz - xx - yy),
            root[8] * z * (xx - yy),
            -root[4] * x * (xx - 3 * yy),
        ]
    return torch.stack(values, dim=-1)


def view_colours(harmonics: torch.Tensor, directions: torch.Tensor) -> torch.Tensor:
    """Return the colours of Gaussians seen along directions: ½ plus the sum of the harmonics, at least 0.

    Parameters
    ----------
    harmonics : torch.Tensor
        Coefficients ``[N, (degree + 1)², 3]``.
    directions : torch.Tensor
        Unit vectors from the camera to the Gaussians ``[N, 3]``.

    Returns
    -------
    torch.Tensor
        Red, green, blue ``[N, 3]``.

    Examples
    --------
    Gaussians without harmonics are grey from all directions:

    >>> import torch
    >>> from odak.learn.wave import view_colours
    >>> view_colours(torch.zeros(1, 1, 3), torch.tensor([[0.0, 0.0, 1.0]])).tolist()
    [[0.5, 0.5, 0.5]]
    """
    harmonics, directions = rows_of(harmonics=(harmonics, "K", 3), directions=(directions, 3))
    basis = spherical_harmonics(_degree(harmonics.shape[1]), directions)
    return (_MIDDLE + (basis[..., None] * harmonics).sum(1)).clamp_min(0)


def load_colmap(folder: str | os.PathLike, device: torch.device | str = "cpu") -> list[ColmapView]:
    """Read the cameras of a sparse reconstruction by COLMAP.

    Parameters
    ----------
    folder : str or os.PathLike
        Folder with ``cameras.bin`` and ``images.bin``, or ``cameras.txt`` and ``images.txt``.
    device : torch.device or str
        Device of the cameras.

    Returns
    -------
    list of ColmapView
        The images, sorted by name.

    Raises
    ------
    FileNotFoundError
        If the folder has no such files.
    ValueError
        If a file is broken, or a camera has distortion: undistort the images with COLMAP first.

    Examples
    --------
    >>> import os, tempfile
    >>> from odak.learn.wave import load_colmap
    >>> from odak.tools import write_to_text_file
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     files = [os.path.join(folder, name) for name in ("cameras.txt", "images.txt")]
    ...     written = write_to_text_file(["1 PINHOLE 640 480 500 500 320 240"], files[0])
    ...     written = write_to_text_file(["1 1 0 0 0 0 0 0 1 first.png", ""], files[1])
    ...     views = load_colmap(folder)
    >>> views[0].name, views[0].size
    ('first.png', (640, 480))
    """
    place = Path(validate_path(folder, name="folder"))
    for extension, read_cameras, read_images in (
        (".bin", _cameras_of_binary, _images_of_binary),
        (".txt", _cameras_of_text, _images_of_text),
    ):
        files = [place / f"{name}{extension}" for name in ("cameras", "images")]
        if all(file.is_file() for file in files):
            cameras, images = (_read(file, read) for file, read in zip(files, (read_cameras, read_images), strict=True))
            break
    else:
        raise FileNotFoundError(f"{str(place)!r} has neither cameras.bin and images.bin nor cameras.txt and images.txt")
    views = []
    for quaternion, shift, number, name in images:
        if number not in cameras:
            raise ValueError(f"{str(place)!r}: image {name!r} names camera {number}, which there is not")
        size, (fx, fy, cx, cy) = cameras[number]
        camera = PerspectiveCamera(*_pose(quaternion, shift), torch.tensor([fx, fy]), torch.tensor([cx, cy]), device)
        views.append(ColmapView(name, camera, size))
    return sorted(views, key=lambda view: view.name)


def _degree(count: int) -> int:
    degree = math.isqrt(count) - 1
    if (degree + 1) ** 2 != count or not 0 <= degree <= 3:
        raise ValueError(f"harmonics must be 1, 4, 9 or 16 for each colour, got {count}")
    return degree


def _pose(quaternion, shift) -> tuple[torch.Tensor, torch.Tensor]:
    """Return R and T of points as rows, with x and y reversed: odak's images are inverted along both axes."""
    w, x, y, z = np.asarray(quaternion) / np.linalg.norm(quaternion)
    rotation = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
    reversed_axes = np.array([-1.0, -1.0, 1.0])
    return torch.from_numpy((rotation.T * reversed_axes).astype(np.float32)), torch.from_numpy(
        (np.asarray(shift) * reversed_axes).astype(np.float32)
    )


def _read(file: Path, read: Callable):
    try:
        return read(file.read_bytes())
    except (ValueError, IndexError, struct.error, UnicodeDecodeError) as error:
        raise ValueError(f"{str(file)!r} cannot be read as a file of COLMAP: {error}") from error


def _intrinsics(model: str, width: int, height: int, parameters):
    if model not in _MODELS:
        raise ValueError(f"camera model {model} has distortion; known are {', '.join(_MODELS)}")
    _, count, order = _MODELS[model]
    if len(parameters) != count or not all(math.isfinite(value) for value in parameters):
        raise ValueError(f"camera model {model} must have {count} finite parameters, got {len(parameters)}")
    return (_validate.side("width", width), _validate.side("height", height)), tuple(parameters[i] for i in order)


def _cameras_of_text(content: bytes) -> dict:
    lines = [line.split() for line in content.decode().splitlines() if line.strip() and not line.startswith("#")]
    return {int(n): _intrinsics(model, int(w), int(h), [float(v) for v in rest]) for n, model, w, h, *rest in lines}


def _images_of_text(content: bytes) -> list:
    lines = [line for line in content.decode().splitlines() if not line.startswith("#")]
    while lines and not lines[0].strip():
        lines.pop(0)
    images = []
    # Every second line holds the points of an image and may be empty.
    for line in lines[::2]:
        if line.strip():
            _, *pose, number, name = line.split(maxsplit=9)
            values = [float(value) for value in pose]
            images.append((values[:4], values[4:], int(number), name))
    return images


def _cameras_of_binary(content: bytes) -> dict:
    (count,) = struct.unpack_from("<Q", content)
    names, at, cameras = {number: name for name, (number, _, _) in _MODELS.items()}, 8, {}
    for _ in range(min(count, _MOST)):
        number, model, width, height = struct.unpack_from("<iiQQ", content, at)
        parameters = struct.unpack_from(f"<{_PARAMETERS.get(model, 0)}d", content, at + 24)
        cameras[number] = _intrinsics(names.get(model, f"number {model}"), width, height, parameters)
        at += 24 + 8 * len(parameters)
    return cameras


def _images_of_binary(content: bytes) -> list:
    (count,) = struct.unpack_from("<Q", content)
    at, images = 8, []
    for _ in range(min(count, _MOST)):
        _, *pose, number = struct.unpack_from("<i7di", content, at)
        end = content.index(b"\0", at + 64)
        name = content[at + 64 : end].decode()
        (points,) = struct.unpack_from("<Q", content, end + 1)
        at = end + 9 + 24 * points
        images.append((pose[:4], pose[4:], number, name))
    return images
