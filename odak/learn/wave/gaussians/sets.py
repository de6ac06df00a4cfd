"""Sets of complex-valued Gaussians, in a picture and in space: parameters, files, and their assignment to planes."""

import math
import os
import re
import struct
from argparse import Namespace
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import plyfile
import torch
from torch import nn
from torch.nn import functional

from odak import _array, _show, _validate
from odak._torch_private import in_own_precision
from odak._warnings import ArgumentWarning, warn
from odak.learn._tensors import floating, get_device, rows_of, shaped, tensor, trainable
from odak.learn.tools.file import first_line, save_torch_tensor, torch_load
from odak.learn.tools.transformation import PerspectiveCamera, quaternion_to_rotation_matrix
from odak.learn.wave.gaussians.splatting import sum_of_gaussians
from odak.learn.wave.training import generator_from
from odak.log import logger
from odak.tools.asset import read_elements
from odak.tools.matrix import zero_pad
from odak.tools.paths import regular_file, replacing, validate_path

# Errors that plyfile and NumPy raise on broken files.
_BROKEN = (plyfile.PlyParseError, KeyError, ValueError, TypeError, ArithmeticError, IndexError)
_MOST = 50_000_000
# Amplitude of the constant harmonic, and the grey level that it is added to in files of splatting.
_CONSTANT, _MIDDLE = 0.5 / math.sqrt(math.pi), 0.5
# Camera models of COLMAP by their number in binary files: name and parameters. The first five have fx, fy, cx, cy at
# the places listed, followed by coefficients of distortion.
_MODELS = (
    *(("SIMPLE_PINHOLE", 3), ("PINHOLE", 4), ("SIMPLE_RADIAL", 4), ("RADIAL", 5), ("OPENCV", 8), ("OPENCV_FISHEYE", 8)),
    *(("FULL_OPENCV", 12), ("FOV", 5), ("SIMPLE_RADIAL_FISHEYE", 4), ("RADIAL_FISHEYE", 5), ("THIN_PRISM_FISHEYE", 12)),
)
_ONE_LENGTH, _TWO_LENGTHS = (0, 0, 1, 2), (0, 1, 2, 3)
_PLACES = {
    "SIMPLE_PINHOLE": _ONE_LENGTH,
    "PINHOLE": _TWO_LENGTHS,
    "SIMPLE_RADIAL": _ONE_LENGTH,
    "RADIAL": _ONE_LENGTH,
    "OPENCV": _TWO_LENGTHS,
}


@_show.shown
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


@_show.shown
class ColmapView(NamedTuple):
    """One image of a reconstruction by COLMAP.

    Attributes
    ----------
    name : str
        Name of the image file.
    camera : PerspectiveCamera
        Camera with the axes of odak, in which both axes of the image are inverted, and with odak's pixels at whole
        coordinates, half a pixel before COLMAP's.
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


def load_splats(path: str | os.PathLike[str]) -> Splats:
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
    with _validate.refusing(f"{path!r} cannot be read as Gaussians: ", *_BROKEN):
        vertices = read_elements(path)["vertex"].data
        names = set(vertices.dtype.names)
        rest = sum(name.startswith("f_rest_") for name in names)
        degree = math.isqrt(rest // 3 + 1) - 1
        if rest != 3 * ((degree + 1) ** 2 - 1):
            raise ValueError(f"{rest} properties f_rest_… fit no degree of spherical harmonics")

        def columns(*wanted: str) -> torch.Tensor:
            return torch.from_numpy(np.stack([vertices[name].astype(np.float32) for name in wanted], axis=-1))

        constant = columns("f_dc_0", "f_dc_1", "f_dc_2")[:, None]
        # The file holds all coefficients of red, then of green, then of blue.
        above = [columns(*(f"f_rest_{i}" for i in range(rest))).unflatten(1, (3, -1)).mT] if rest else []
        return Splats(
            columns("x", "y", "z"),
            columns("rot_0", "rot_1", "rot_2", "rot_3"),
            columns("scale_0", "scale_1", "scale_2"),
            columns("opacity")[:, 0],
            torch.cat([constant, *above], dim=1),
        )


def is_antialiased(path: str) -> bool:
    """Return whether the last comment on it in the header of a PLY file names antialiased training.

    Brush writes "SplatRenderMode: mip", Postshot "antialiased 1".
    """
    with open(regular_file(path), "rb") as stream:
        header = stream.read(_HEADER).partition(b"end_header")[0]
    said = _RENDER_MODE.findall(header)
    return bool(said) and (said[-1][0].lower() == b"mip" or said[-1][1] == b"1")


def save_splats(path: str | os.PathLike[str], splats: Splats) -> None:
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
    harmonics = shaped("splats.harmonics", splats.harmonics, "[N, K, 3]").detach().cpu()
    _degree(harmonics.shape[1])
    count = len(harmonics)
    parts = {
        **dict(zip("xyz", shaped("splats.means", splats.means, f"[{count}, 3]").T, strict=True)),
        **dict.fromkeys(("nx", "ny", "nz"), torch.zeros(count)),
        **{f"f_dc_{i}": harmonics[:, 0, i] for i in range(3)},
        **{f"f_rest_{i}": column for i, column in enumerate(harmonics[:, 1:].mT.flatten(1).T)},
        "opacity": shaped("splats.opacities", splats.opacities, f"[{count}]"),
        **{f"scale_{i}": column for i, column in enumerate(shaped("splats.scales", splats.scales, f"[{count}, 3]").T)},
        **{f"rot_{i}": column for i, column in enumerate(shaped("splats.quats", splats.quats, f"[{count}, 4]").T)},
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
    _validate.integer("degree", degree, most=3)
    directions = floating("directions", directions)
    _validate.shaped("directions", directions, "[..., 3]")
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
    harmonics, directions = rows_of(harmonics=(harmonics, "[N, K, 3]"), directions=(directions, "[N, 3]"))
    basis = spherical_harmonics(_degree(harmonics.shape[1]), directions)
    return (_MIDDLE + (basis[..., None] * harmonics).sum(1)).clamp_min(0)


def load_colmap(folder: str | os.PathLike[str], device: torch.device | str = "cpu") -> list[ColmapView]:
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
        If a file is broken, or a camera has distortion, as COLMAP's default SIMPLE_RADIAL may: COLMAP's
        ``image_undistorter`` makes images and cameras without, and the message gives its command.

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
    >>> views[0].name, views[0].size, views[0].camera.principal_point.tolist()
    ('first.png', (640, 480), [319.5, 239.5])
    """
    place = Path(validate_path(folder, name="folder"))
    for extension, read_cameras, read_images in (
        (".bin", _cameras_of_binary, _images_of_binary),
        (".txt", _cameras_of_text, _images_of_text),
    ):
        files = [place / f"{name}{extension}" for name in ("cameras", "images")]
        if all(file.is_file() for file in files):
            cameras, images = (
                _read_tables(file, read) for file, read in zip(files, (read_cameras, read_images), strict=True)
            )
            break
    else:
        raise FileNotFoundError(f"{str(place)!r} has neither cameras.bin and images.bin nor cameras.txt and images.txt")
    views = []
    for quaternion, shift, number, name in images:
        if number not in cameras:
            raise ValueError(f"{str(place)!r}: image {name!r} names camera {number}, which there is not")
        size, (fx, fy, cx, cy) = cameras[number]
        # The middle of COLMAP's first pixel is at (0.5, 0.5), that of odak's pictures at (0, 0).
        middle = torch.tensor([cx - 0.5, cy - 0.5])
        camera = PerspectiveCamera(*_pose(quaternion, shift), torch.tensor([fx, fy]), middle, device)
        views.append(ColmapView(name, camera, size))
    return sorted(views, key=lambda view: view.name)


def _degree(count: int) -> int:
    degree = math.isqrt(count) - 1
    if (degree + 1) ** 2 != count or not 0 <= degree <= 3:
        raise ValueError(f"harmonics must be 1, 4, 9 or 16 for each colour, got {count}")
    return degree


def _pose(quaternion, shift) -> tuple[torch.Tensor, torch.Tensor]:
    """Return R and T of points as rows, with x and y reversed: odak's images are inverted along both axes."""
    quaternion, shift, reversed_axes = (
        torch.tensor(values, dtype=torch.float64) for values in (quaternion, shift, (-1.0, -1.0, 1.0))
    )
    rotation = quaternion_to_rotation_matrix(quaternion)
    return (rotation.T * reversed_axes).float(), (shift * reversed_axes).float()


def _read_tables(file: Path, read: Callable[..., Any]):
    told = f"{str(file)!r} cannot be read as a file of COLMAP: "
    with _validate.refusing(told, ValueError, IndexError, struct.error, UnicodeDecodeError):
        return read(file.read_bytes())


def _intrinsics(model: str, width: int, height: int, parameters):
    count, order = dict(_MODELS).get(model, len(parameters)), _PLACES.get(model)
    if len(parameters) != count or not all(math.isfinite(value) for value in parameters):
        raise ValueError(f"camera model {model} must have {count} finite parameters, got {len(parameters)}")
    if order is None or any(parameters[max(order) + 1 :]):
        raise ValueError(
            f"camera model {model} has distortion, or is not known; images and cameras without are what `colmap "
            "image_undistorter --image_path IMAGES --input_path MODEL --output_path OUT` writes: read OUT/sparse"
        )
    return (_validate.side("width", width), _validate.side("height", height)), tuple(parameters[i] for i in order)


def _cameras_of_text(content: bytes) -> dict[Any, Any]:
    lines = [line.split() for line in content.decode().splitlines() if line.strip() and not line.startswith("#")]
    return {int(n): _intrinsics(model, int(w), int(h), [float(v) for v in rest]) for n, model, w, h, *rest in lines}


def _images_of_text(content: bytes) -> list[Any]:
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


def _cameras_of_binary(content: bytes) -> dict[Any, Any]:
    (count,) = struct.unpack_from("<Q", content)
    at, cameras = 8, {}
    for _ in range(min(count, _MOST)):
        number, model, width, height = struct.unpack_from("<iiQQ", content, at)
        name, length = _MODELS[model] if 0 <= model < len(_MODELS) else (f"number {model}", 0)
        parameters = struct.unpack_from(f"<{length}d", content, at + 24)
        cameras[number] = _intrinsics(name, width, height, parameters)
        at += 24 + 8 * len(parameters)
    return cameras


def _images_of_binary(content: bytes) -> list[Any]:
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


EXTENSIONS = (".pth", ".pt")


def save(path: str | os.PathLike[str], contents: dict[str, Any], name: str = "path") -> None:
    """Write tensors by name to a ``.pth`` or ``.pt`` file, whole or not at all.

    Raises
    ------
    ValueError
        If the path is not acceptable or its folder does not exist.
    """
    save_torch_tensor(validate_path(path, EXTENSIONS, name=name), contents)


def load(
    path: str | os.PathLike[str], names: Iterable[str], device: torch.device, name: str = "path"
) -> dict[str, Any]:
    """Read what :func:`save` wrote.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If the path is not acceptable, or the file is broken, would run code, or lacks one of the tensors.
    """
    path = validate_path(path, EXTENSIONS, name=name)
    try:
        contents = torch_load(path, map_location=device)
    except FileNotFoundError:
        raise
    except Exception as error:
        raise ValueError(f"{path!r} cannot be read as Gaussians: {first_line(error)}") from error
    if not isinstance(contents, dict):
        raise ValueError(f"{path!r} contains no Gaussians but a {type(contents).__name__}")
    if missing := [name for name in names if not isinstance(contents.get(name), torch.Tensor)]:
        raise ValueError(f"{path!r} contains no Gaussians: missing {', '.join(missing)}")
    return contents


def wrapped(phase: torch.Tensor) -> torch.Tensor:
    """Return a phase modulo 2π, from 0 up to but not 2π."""
    turned = torch.remainder(phase, 2 * math.pi)
    # A tiny negative phase is rounded up to 2π.
    return turned.where(turned < 2 * math.pi, turned - turned.detach())


def picture_size(name: str, size: Any) -> tuple[int, int]:
    """Return the width and height of a picture as integers; raise ValueError for anything but two positive ones."""
    told = f"{name} must be two positive integers (width, height), got {size!r}"
    with _validate.refusing(lambda _: told, TypeError, ValueError):
        width, height = size
        return _validate.side(name, width), _validate.side(name, height)


def lengths(values: Any) -> torch.Tensor:
    """Return lengths in metres as a flat float64 tensor: phases of 10⁵ rad depend on them."""
    return torch.as_tensor(values, dtype=torch.float64).reshape(-1)


def settings(args_prop: object, names: Iterable[str]) -> list[Any]:
    """Return attributes of the settings in their order.

    Raises
    ------
    ValueError
        If there are no settings or an attribute is missing.
    """
    names = list(names)
    if missing := [name for name in names if not hasattr(args_prop, name)]:
        raise ValueError(f"args_prop must have {', '.join(names)}; missing {', '.join(missing)} in {args_prop!r}")
    return [getattr(args_prop, name) for name in names]


# Square pixels added to each axis of a covariance, so that no Gaussian falls between pixels.
_PLANAR_SOFTNESS = 0.1


class complex_2d_gaussians(nn.Module):
    """Gaussians in a plane, each with a size, a rotation, and an amplitude and a phase for each colour.

    Parameters
    ----------
    num_points : int
        Number N of Gaussians.
    img_size : tuple of int
        Width and height of the picture in pixels.
    device : torch.device or str
        Device of the parameters.
    merge_opacity : bool
        Set the opacities to one, so that the colours alone give the amplitudes.
    seed : int, optional
        Makes the first parameters reproducible.
    channels : int
        Number C of colours, one for each wavelength of :class:`Scene2D`.

    Attributes
    ----------
    means_2d : torch.nn.Parameter
        Centres ``[N, 2]``, see :meth:`apply_activations`.
    pre_act_scales : torch.nn.Parameter
        Sizes before their activation, ``[N, 2]``.
    pre_act_rotation : torch.nn.Parameter
        Rotations before their activation, ``[N]``.
    pre_act_opacities : torch.nn.Parameter
        Opacities before their activation, ``[N]``.
    colours : torch.nn.Parameter
        Amplitudes ``[N, C]``.
    pre_act_phase : torch.nn.Parameter
        Phases before their activation, ``[N, C]``.

    Raises
    ------
    ValueError
        If the number or the size is not positive.

    Notes
    -----
    Zhan et al., complex-valued Gaussians for holograms (2026).

    Examples
    --------
    >>> from odak.learn.wave import complex_2d_gaussians
    >>> len(complex_2d_gaussians(5, (32, 24), "cpu"))
    5
    """

    means_2d: nn.Parameter
    pre_act_scales: nn.Parameter
    pre_act_rotation: nn.Parameter
    colours: nn.Parameter
    pre_act_phase: nn.Parameter
    pre_act_opacities: nn.Parameter

    def __init__(
        self,
        num_points: int,
        img_size: tuple[int, int],
        device: torch.device | str,
        merge_opacity: bool = False,
        *,
        seed: int | None = None,
        channels: int = 3,
    ):
        super().__init__()
        channels = _validate.integer("channels", channels, minimum=1)
        number = _validate.integer("num_points", num_points, minimum=1)
        self.img_size: tuple[int, int] = picture_size("img_size", img_size)
        self.device: torch.device = get_device(device)
        self.merge_opacity: bool = _validate.flag("merge_opacity", merge_opacity)
        draw = generator_from(seed)

        def even(low, high, *shape):
            return torch.rand(number, *shape, generator=draw) * (high - low) + low

        first = {
            "means_2d": even(-1, 1, 2).clamp(-0.999, 0.999).atanh(),
            "pre_act_scales": even(1.5, 5, 2).log(),
            "pre_act_rotation": even(-math.pi, math.pi),
            "colours": even(0, 1, channels),
            "pre_act_phase": torch.zeros(number, channels),
            "pre_act_opacities": torch.full((number,), -0.5),
        }
        for name, value in first.items():
            self.register_parameter(name, nn.Parameter(value.to(self.device), requires_grad=False))
        logger.debug("%d complex Gaussians on %d x %d pixels", number, *self.img_size)

    def __len__(self) -> int:
        return len(self.means_2d)

    def apply_activations(self) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
        """Return the parameters after their activations.

        Returns
        -------
        tuple of torch.Tensor
            Standard deviations exp(·) + 0.1 in pixels ``[N, 2]``, rotations in radians ``[N]``, phases from 0 to 2π
            ``[N, C]``, opacities from 0 to 1 ``[N]`` (ones when merged), and centres [x, y] in pixels ``[N, 2]``,
            (tanh(·) + 1)/2 times the size of the picture.
        """
        size = self.means_2d.new_tensor(self.img_size)
        opacities = self.pre_act_opacities
        return (
            self.pre_act_scales.exp() + 0.1,
            self.pre_act_rotation,
            wrapped(self.pre_act_phase),
            torch.ones_like(opacities) if self.merge_opacity else opacities.sigmoid(),
            (self.means_2d.tanh() + 1) / 2 * size,
        )

    @staticmethod
    def compute_cov_2D(scales: torch.Tensor, rotation: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Return the entries Σ₀₀, Σ₀₁ and Σ₁₁ of covariances in square pixels ``[N]``, variances 0.1 larger than given.

        Parameters
        ----------
        scales : torch.Tensor
            Standard deviations ``[N, 2]``.
        rotation : torch.Tensor
            Radians ``[N]``.
        """
        scales, rotation = floating("scales", scales), floating("rotation", rotation)
        _validate.shaped("scales", scales, "[N, 2]")
        _validate.fitting(scales=scales[..., 0], rotation=rotation)
        cosine, sine = rotation.cos(), rotation.sin()
        first, second = scales.square().unbind(-1)
        return (
            first * cosine.square() + second * sine.square() + _PLANAR_SOFTNESS,
            (first - second) * cosine * sine,
            first * sine.square() + second * cosine.square() + _PLANAR_SOFTNESS,
        )

    @staticmethod
    def invert_cov_2D(
        cov_00: torch.Tensor, cov_01: torch.Tensor, cov_11: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Return the entries 00, 01 and 11 of the inverses of symmetric 2×2 covariance matrices.

        Determinants below 1e-10 are replaced by 1e-10.

        Parameters
        ----------
        cov_00 : torch.Tensor
            Entries 00 of the matrices, ``[N]``.
        cov_01 : torch.Tensor
            Entries 01 of the matrices, ``[N]``.
        cov_11 : torch.Tensor
            Entries 11 of the matrices, ``[N]``.
        """
        given = {"cov_00": cov_00, "cov_01": cov_01, "cov_11": cov_11}
        given = {name: floating(name, value) for name, value in given.items()}
        _validate.fitting(**given)
        cov_00, cov_01, cov_11 = given.values()
        determinant = (cov_00 * cov_11 - cov_01.square()).clamp_min(1e-10)
        return cov_11 / determinant, -cov_01 / determinant, cov_00 / determinant

    def make_trainable(self) -> None:
        """Let all parameters require gradients, the opacities only where they are not merged."""
        for name, parameter in self.named_parameters():
            parameter.requires_grad_(not (self.merge_opacity and name == "pre_act_opacities"))

    def save_gaussians(self, save_path: str | os.PathLike[str]) -> None:
        """Write the parameters, the size and `merge_opacity` to a ``.pth`` or ``.pt`` file, atomically.

        Parameters
        ----------
        save_path : str or path-like
            Path of the file.

        Raises
        ------
        ValueError
            If the path is not acceptable or its folder does not exist.
        """
        tensors = {name: parameter.detach() for name, parameter in self.named_parameters()}
        save(save_path, {**tensors, "img_size": self.img_size, "merge_opacity": self.merge_opacity}, "save_path")
        logger.info("%d complex Gaussians saved to %s", len(self), save_path)

    def load_gaussians(self, load_path: str | os.PathLike[str]) -> None:
        """Set the parameters and `merge_opacity` to those in a file of :meth:`save_gaussians`, in place.

        Parameters
        ----------
        load_path : str or path-like
            Path of the file.

        Raises
        ------
        FileNotFoundError
            If there is no such file.
        ValueError
            If the path is not acceptable; if the file is broken or would run code; or if it holds another number of
            Gaussians or belongs to a picture of another size. The Gaussians then stay as they were.
        """
        held = dict(self.named_parameters())
        found = load(load_path, held, self.means_2d.device, "load_path")
        size = found.get("img_size", self.img_size)
        if tuple(size) != self.img_size:
            raise ValueError(f"{load_path!r} contains Gaussians of a picture of {tuple(size)}, not of {self.img_size}")
        for name, parameter in held.items():
            if found[name].shape != parameter.shape:
                raise ValueError(
                    f"{load_path!r} holds {name} of shape {tuple(found[name].shape)}, not {tuple(parameter.shape)}"
                )
        with torch.no_grad():
            for name, parameter in held.items():
                parameter.copy_(found[name])
        self.merge_opacity = bool(found.get("merge_opacity", self.merge_opacity))
        logger.info("%d complex Gaussians loaded from %s", len(self), load_path)


class Scene2D:
    """The complex field of a sum of Gaussians in a plane.

    Parameters
    ----------
    gaussians : complex_2d_gaussians
        The Gaussians.
    args_prop : object
        With the attributes `wavelengths` (metres, one for each colour) and `pad_size` (rows and columns of the field).
        Fewer wavelengths than colours belong to the first colours; an :class:`~odak.ArgumentWarning` says so.

    Attributes
    ----------
    wavelengths : torch.Tensor
        In metres.
    pad_size : tuple of int
        Rows and columns of the field.

    Raises
    ------
    ValueError
        If an attribute is missing or not positive, or there are more wavelengths than colours.

    Examples
    --------
    >>> from argparse import Namespace
    >>> from odak.learn.wave import Scene2D, complex_2d_gaussians
    >>> settings = Namespace(wavelengths=[639e-9, 532e-9, 473e-9], pad_size=[48, 64])
    >>> Scene2D(complex_2d_gaussians(5, (32, 24), "cpu"), settings).render((32, 24)).shape
    torch.Size([3, 48, 64])
    """

    def __init__(self, gaussians: complex_2d_gaussians, args_prop: object):
        _validate.instance("gaussians", gaussians, complex_2d_gaussians, "complex_2d_gaussians")
        wavelengths, pad_size = settings(args_prop, ("wavelengths", "pad_size"))
        self.gaussians: complex_2d_gaussians = gaussians
        self.args_prop: object = args_prop
        self.wavelengths: torch.Tensor = _validate.real("wavelengths", lengths(wavelengths), positive=True)
        self.pad_size: tuple[int, int] = _validate.size("pad_size", pad_size)
        colours, count = gaussians.colours.shape[1], len(self.wavelengths)
        if count > colours:
            raise ValueError(
                f"args_prop.wavelengths must be one for each of the {colours} colours of the Gaussians, got {count}"
            )
        if count < colours:
            used = "colour 0 is" if count == 1 else f"colours 0 to {count - 1} are"
            warn(
                f"args_prop.wavelengths are {count} for {colours} colours of the Gaussians: {used} used, in this "
                f"order; make the Gaussians with channels={count}, or give a wavelength for each colour",
                ArgumentWarning,
            )
        self._grids: dict[Any, Any] = {}

    def __repr__(self) -> str:
        return f"<Scene2D with {len(self.gaussians)} Gaussians>"

    def get_pixel_grid(self, img_size: tuple[int, int]) -> torch.Tensor:
        """Return the coordinates [x, y] of all pixels, row by row, ``[1, H·W, 2]``; kept for the next call.

        Parameters
        ----------
        img_size : tuple of int
            Width and height.
        """
        width, height = picture_size("img_size", img_size)
        like = self.gaussians.means_2d
        key = (width, height, like.dtype, like.device)
        if key not in self._grids:
            axes = (torch.arange(n, dtype=like.dtype, device=like.device) for n in (height, width))
            y, x = torch.meshgrid(*axes, indexing="ij")
            self._grids = {key: torch.stack([x.flatten(), y.flatten()], dim=-1)[None]}
        return self._grids[key]

    def render(self, img_size: tuple[int, int]) -> torch.Tensor:
        """Return the field Σ colour·opacity·exp(−½ dᵀΣ⁻¹d)·exp(iφ), surrounded by zeros.

        Σ in the exponent is the covariance of :meth:`complex_2d_gaussians.compute_cov_2D`.

        Parameters
        ----------
        img_size : tuple of int
            Width and height of the picture; pixels are at whole coordinates.

        Returns
        -------
        torch.Tensor
            A field for each wavelength, complex64 ``[C, *pad_size]`` (complex128 for parameters in double precision),
            differentiable in the parameters. Memory does not grow with N·H·W: see
            :func:`odak.learn.wave.gaussians.splatting.sum_of_gaussians`.

        Raises
        ------
        ValueError
            If the picture is larger than `pad_size`.
        """
        width, height = picture_size("img_size", img_size)
        if height > self.pad_size[0] or width > self.pad_size[1]:
            raise ValueError(f"img_size must fit into pad_size {list(self.pad_size)}, got (width, height) {img_size}")
        scales, rotation, phase, opacities, means = self.gaussians.apply_activations()
        covariance = self.gaussians.compute_cov_2D(scales, rotation)
        conics = torch.stack(self.gaussians.invert_cov_2D(*covariance), dim=-1)
        colours, phase = (values[:, : len(self.wavelengths)] for values in (self.gaussians.colours, phase))
        weights = torch.polar(torch.ones_like(phase), phase) * (colours * opacities[:, None])
        return zero_pad(sum_of_gaussians(means, conics, weights, height, width), self.pad_size)


_INIT_TYPES = {"gaussians": "load_path", "random": "num_points", "point": "pointcloud_data"}
# Square pixels added to each axis of a projected covariance, so that no Gaussian falls between pixels.
_SOFTNESS = 0.3
# Comments of PLY files on antialiased training, and the largest header that is searched for them.
_RENDER_MODE = re.compile(rb"(?mi)^comment\s+(?:SplatRenderMode:\s*(\w+)|antialiased\s+([01]))\s*?$")
_HEADER = 1 << 16
_MARGIN = 1.3
_AWAY = 1e6
# By how much the halves of a split Gaussian are smaller.
_SPLIT = 1.6


class complex_3d_gaussians(nn.Module):
    """Gaussians in space, each with an amplitude and a phase in three colours, an opacity and one plane of several.

    Parameters
    ----------
    init_type : {"gaussians", "random", "point"}
        Source of the initial parameters: a file, a random cloud, or the points of a point cloud.
    device : torch.device or str
        Device of the parameters.
    load_path : str or os.PathLike, optional
        ``.pth`` or ``.pt`` file of :meth:`save_gaussians`, or a ``.ply`` file of 3-D Gaussian splatting, whose colours
        are those without dependence on the direction; phases and planes are then random.
    num_points : int, optional
        Number of random Gaussians.
    args_prop : argparse.Namespace
        With the attribute `num_planes`, P; for a point cloud `is_outdoor` too.
    pointcloud_data : dict, optional
        "positions" and "colors", ``[M, 3]``.
    generate_dense_point : bool or int
        Copies of the point cloud to add, scattered about it.
    densepoint_scatter : float
        Standard deviation of that scatter.
    img_size : tuple of int, optional
        Kept as an attribute.
    seed : int, optional
        Makes random parameters reproducible.
    antialiased : bool, optional
        The Gaussians were trained with opacities that go down as the 0.3 square pixels of each projection make it
        larger ("antialiased" or "mip" training); without it small ones come out too bright. By default as a comment in
        the ``.ply`` file says, else False.

    Attributes
    ----------
    pre_act_quats : torch.nn.Parameter
        Quaternions of the rotations before normalization, ``[N, 4]``.
    means : torch.nn.Parameter
        Centres ``[N, 3]``.
    pre_act_scales : torch.nn.Parameter
        Sizes before their activation, ``[N, 3]``.
    colours : torch.nn.Parameter
        Amplitudes ``[N, 3]``.
    pre_act_phase : torch.nn.Parameter
        Phases before their activation, ``[N, 3]``.
    pre_act_opacities : torch.nn.Parameter
        Opacities before their activation, ``[N]``.
    pre_act_plane_assignment : torch.nn.Parameter
        Weights of the planes before the choice of one, ``[N, P]``.

    Raises
    ------
    ValueError
        If `init_type` is unknown, or what it needs is missing or of a wrong shape.

    Notes
    -----
    Kerbl et al., ACM Trans. Graph. 42, 139 (2023); complex-valued: Zhan et al., ACM Trans. Graph. (2025).

    Examples
    --------
    >>> from argparse import Namespace
    >>> from odak.learn.wave import complex_3d_gaussians
    >>> len(complex_3d_gaussians("random", "cpu", num_points=64, args_prop=Namespace(num_planes=2)))
    64
    """

    means: nn.Parameter
    pre_act_quats: nn.Parameter
    pre_act_scales: nn.Parameter
    colours: nn.Parameter
    pre_act_phase: nn.Parameter
    pre_act_opacities: nn.Parameter
    pre_act_plane_assignment: nn.Parameter

    NEAR_PLANE = 1.0
    FAR_PLANE = 1000.0

    def __init__(
        self,
        init_type: str,
        device: torch.device | str,
        load_path: str | os.PathLike[str] | None = None,
        num_points: int | None = None,
        args_prop: Namespace | None = None,
        pointcloud_data: Mapping[str, torch.Tensor] | None = None,
        generate_dense_point: bool | int = False,
        densepoint_scatter: float = 0.01,
        img_size: tuple[int, int] | None = None,
        *,
        seed: int | None = None,
        antialiased: bool | None = None,
    ):
        (densepoint_scatter,) = _validate.constants(densepoint_scatter=densepoint_scatter)
        super().__init__()
        if not isinstance(init_type, str) or init_type not in _INIT_TYPES:
            raise ValueError(f"init_type must be one of {', '.join(map(repr, _INIT_TYPES))}; got {init_type!r}")
        source = {"load_path": load_path, "num_points": num_points, "pointcloud_data": pointcloud_data}
        if source[_INIT_TYPES[init_type]] is None:
            raise ValueError(f"{_INIT_TYPES[init_type]} is needed for init_type {init_type!r}, got None")
        (planes,) = settings(args_prop, ("num_planes",))
        planes = _validate.integer("args_prop.num_planes", planes, minimum=1)
        if load_path is not None:
            load_path = validate_path(load_path, (*EXTENSIONS, ".ply"), name="load_path")
        if img_size is not None:
            picture_size("img_size", img_size)
        if isinstance(generate_dense_point, bool):
            generate_dense_point = int(generate_dense_point)
        copies = _validate.integer("generate_dense_point", generate_dense_point)
        scatter = _validate.real("densepoint_scatter", densepoint_scatter)
        _validate.instance("pointcloud_data", pointcloud_data, (Mapping, type(None)), "a dictionary of tensors")
        self.device: torch.device = get_device(device)
        self.img_size: tuple[int, int] | None = img_size
        if antialiased is None:
            antialiased = str(load_path).endswith(".ply") and is_antialiased(str(load_path))
        self.antialiased: bool = _validate.flag("antialiased", antialiased)
        draw = generator_from(seed)
        if init_type == "gaussians":
            read = _read_splats if str(load_path).endswith(".ply") else _read
            first = read(load_path, planes, self.device, draw)
        elif init_type == "random":
            first = random_cloud(_validate.integer("num_points", num_points, minimum=1), planes, draw)
        else:
            (outdoor,) = settings(args_prop, ("is_outdoor",))
            positions, colors = _points(pointcloud_data)
            first = point_cloud(positions, colors, planes, copies, scatter, bool(outdoor), draw)
        for name in NAMES:
            self.register_parameter(name, nn.Parameter(first[name].to(self.device), requires_grad=False))
        logger.debug("%d complex Gaussians on %d planes, from %s", len(self), planes, init_type)

    def __len__(self) -> int:
        return len(self.means)

    def make_trainable(self) -> None:
        """Let all parameters require gradients."""
        self.requires_grad_(True)

    @in_own_precision
    def densify(
        self, gradients: torch.Tensor, threshold: float, split_scale: float, *, seed: int | None = None
    ) -> torch.Tensor:
        """Double the Gaussians whose places are still in dispute: small ones are cloned, large ones split.

        Parameters
        ----------
        gradients : torch.Tensor
            Norms of the gradients of the loss with respect to `means`, averaged over steps, ``[N]``.
        threshold : float
            Gaussians of larger gradients are doubled.
        split_scale : float
            Gaussians with a larger standard deviation along any axis are split in two, drawn from the Gaussian, of
            1/1.6 of its size; others are cloned in place.
        seed : int, optional
            Makes the places of split Gaussians reproducible.

        Returns
        -------
        torch.Tensor
            The number of the former Gaussian that each one now comes from ``[M]``: kept ones first, then the new ones.
            Of an optimizer's state the same rows can be taken.

        Raises
        ------
        ValueError, TypeError
            If the gradients are not one for each Gaussian, or a number is out of range.

        Notes
        -----
        Kerbl et al., ACM Trans. Graph. 42, 139 (2023), section 5.2. The two halves of one Gaussian of opacity o have
        the opacity 1 − √(1 − o), so that together they let through as much as it did (Rota Bulò et al., ECCV 2024).
        The parameters become new tensors: make the optimizer anew.

        Examples
        --------
        >>> import torch
        >>> from argparse import Namespace
        >>> from odak.learn.wave import complex_3d_gaussians
        >>> gaussians = complex_3d_gaussians("random", "cpu", num_points=4, args_prop=Namespace(num_planes=2))
        >>> gaussians.densify(torch.tensor([0.0, 2.0, 0.0, 0.0]), 1.0, split_scale=1.0).tolist()
        [0, 1, 2, 3, 1]
        """
        gradients = shaped("gradients", gradients, "[N]")
        if len(gradients) != len(self):
            raise ValueError(f"gradients must be {len(self)} numbers, one for each Gaussian, got {len(gradients)}")
        _validate.real("gradients", gradients)
        threshold = _validate.constant("threshold", threshold)
        split_scale = _validate.constant("split_scale", split_scale, positive=True)
        draw = generator_from(seed)
        with torch.no_grad():
            doubled = gradients.to(self.means.device) > threshold
            large = doubled & (self.pre_act_scales.exp().amax(1) > split_scale)
            origin = torch.cat([torch.arange(len(self), device=doubled.device), doubled.nonzero()[:, 0]])
            values = {name: getattr(self, name)[origin] for name in NAMES}
            # logit(1 − √(1 − o)), o = σ(a), for both halves.
            through = torch.sigmoid(-values["pre_act_opacities"]).sqrt()
            halved = torch.log1p(-through) - through.log()
            values["pre_act_opacities"] = torch.where(doubled[origin], halved, values["pre_act_opacities"])
            split = large[origin]
            quats, scales = functional.normalize(values["pre_act_quats"], dim=-1), values["pre_act_scales"].exp()
            steps = torch.randn(len(origin), 3, generator=draw).to(scales) * scales
            moved = (quaternion_to_rotation_matrix(quats) @ steps[..., None])[..., 0]
            values["means"] = values["means"] + torch.where(split[:, None], moved, 0.0)
            smaller = values["pre_act_scales"] - math.log(_SPLIT)
            values["pre_act_scales"] = torch.where(split[:, None], smaller, values["pre_act_scales"])
            self._become(values)
        return origin

    def prune(self, least_opacity: float = 0.005, largest_scale: float | None = None) -> torch.Tensor:
        """Remove Gaussians that can hardly be seen, or are too large.

        Parameters
        ----------
        least_opacity : float
            Gaussians of less opacity go, 0 to 1.
        largest_scale : float, optional
            Gaussians with a larger standard deviation along any axis go too; none by default.

        Returns
        -------
        torch.Tensor
            The numbers of those that are left ``[M]``.

        Raises
        ------
        ValueError, TypeError
            If a number is out of range, or nothing would be left.

        Examples
        --------
        >>> from argparse import Namespace
        >>> from odak.learn.wave import complex_3d_gaussians
        >>> gaussians = complex_3d_gaussians("random", "cpu", num_points=9, args_prop=Namespace(num_planes=2))
        >>> len(gaussians.prune())
        9
        """
        (largest_scale,) = _validate.constants(largest_scale=largest_scale)
        least_opacity = _validate.constant("least_opacity", least_opacity, least=0, most=1)
        with torch.no_grad():
            kept = self.pre_act_opacities.sigmoid() >= least_opacity
            if largest_scale is not None:
                largest_scale = _validate.constant("largest_scale", largest_scale, positive=True)
                kept = kept & (self.pre_act_scales.exp().amax(1) <= largest_scale)
            if not kept.any():
                raise ValueError(f"least_opacity {least_opacity} and largest_scale {largest_scale} leave no Gaussian")
            rows = kept.nonzero()[:, 0]
            self._become({name: getattr(self, name)[rows] for name in NAMES})
        return rows

    def _become(self, values) -> None:
        """Replace the parameters by others, trainable as they were."""
        for name, value in values.items():
            trainable = getattr(self, name).requires_grad
            setattr(self, name, nn.Parameter(value.detach().clone(), requires_grad=trainable))

    def check_if_trainable(self) -> None:
        """Raise RuntimeError unless all parameters require gradients."""
        if fixed := [name for name, parameter in self.named_parameters() if not parameter.requires_grad]:
            raise RuntimeError(f"{', '.join(fixed)} require no gradients: call make_trainable() first")

    @in_own_precision
    def compute_cov_3D(self, quats: torch.Tensor, scales: torch.Tensor) -> torch.Tensor:
        """Return covariances R·S·Sᵀ·Rᵀ in space ``[N, 3, 3]``.

        Parameters
        ----------
        quats : torch.Tensor
            Quaternions w, x, y, z of any length but 0, ``[N, 4]``.
        scales : torch.Tensor
            Standard deviations along the Gaussians' axes ``[N, 3]``.
        """
        quats, scales = rows_of(quats=(quats, "[N, 4]"), scales=(scales, "[N, 3]"))
        axes = quaternion_to_rotation_matrix(quats) * scales[:, None]
        return axes @ axes.mT

    @in_own_precision
    def compute_cov_2D(
        self,
        cam_means_3D: torch.Tensor,
        quats: torch.Tensor,
        scales: torch.Tensor,
        fx: float | torch.Tensor,
        fy: float | torch.Tensor,
        R: torch.Tensor,
        img_size: tuple[int, int],
    ) -> torch.Tensor:
        """Return covariances on the picture, J·R·Σ·Rᵀ·Jᵀ + 0.3 (Zwicker et al. 2001, affine approximation).

        J is the Jacobian of the projection at the centre, which is limited to 1.3 times the view for it, and zero
        before NEAR_PLANE and beyond FAR_PLANE. Here R acts on columns, whereas a camera moves points as rows, x·R + T:
        give Rᵀ of a camera for the covariances that go with its points, see :class:`Scene`.

        Parameters
        ----------
        cam_means_3D : torch.Tensor
            Centres in the axes of the camera ``[N, 3]``.
        quats : torch.Tensor
            Quaternions w, x, y, z of any length but 0, ``[N, 4]``.
        scales : torch.Tensor
            Standard deviations along the Gaussians' axes ``[N, 3]``.
        fx, fy : float or torch.Tensor
            Focal lengths in pixels.
        R : torch.Tensor
            ``[3, 3]`` or ``[1, 3, 3]``.
        img_size : tuple of int
            Width and height of the picture.

        Returns
        -------
        torch.Tensor
            Square pixels ``[N, 2, 2]``.
        """
        cam_means_3D, quats, scales = rows_of(
            cam_means_3D=(cam_means_3D, "[N, 3]"), quats=(quats, "[N, 4]"), scales=(scales, "[N, 3]")
        )
        for name, length in (("fx", fx), ("fy", fy)):
            _validate.real(name, length, nonzero=True)
        R, (width, height) = _rotation(R), picture_size("img_size", img_size)
        x, y, z = cam_means_3D.unbind(-1)
        inside = self._in_range(z)
        z = z.where(inside, 1.0)
        side, up = _clipped(x / z, _MARGIN * 0.5 * width / fx), _clipped(y / z, _MARGIN * 0.5 * height / fy)
        nothing = torch.zeros_like(z)
        rows = torch.stack([fx / z, nothing, -fx * side / z, nothing, fy / z, -fy * up / z], dim=-1)
        slope = rows.where(inside[:, None], 0.0).unflatten(-1, (2, 3))
        axes = slope @ R.to(slope) @ (quaternion_to_rotation_matrix(quats) * scales[:, None])
        return softened(axes)

    def compute_means_2D(
        self,
        cam_means_3D: torch.Tensor,
        fx: float | torch.Tensor,
        fy: float | torch.Tensor,
        px: float | torch.Tensor,
        py: float | torch.Tensor,
    ) -> torch.Tensor:
        """Return centres on the picture, (px − fx·x/z, py − fy·y/z): both axes of the picture are inverted.

        Parameters
        ----------
        cam_means_3D : torch.Tensor
            Centres in the axes of the camera ``[N, 3]``.
        fx, fy, px, py : float or torch.Tensor
            Focal lengths and principal point in pixels.

        Returns
        -------
        torch.Tensor
            Pixels [x, y], ``[N, 2]``; 10⁶ before NEAR_PLANE and beyond FAR_PLANE.
        """
        (cam_means_3D,) = rows_of(cam_means_3D=(cam_means_3D, "[N, 3]"))
        for name, number in (("fx", fx), ("fy", fy), ("px", px), ("py", py)):
            _validate.real(name, number)
        x, y, z = cam_means_3D.unbind(-1)
        inside = self._in_range(z)
        z = z.where(inside, 1.0)
        fx, fy, px, py = (_array.cast(number, x) for number in (fx, fy, px, py))
        return torch.stack([px - fx * x / z, py - fy * y / z], dim=-1).where(inside[:, None], _AWAY)

    def _in_range(self, z):
        # NaN is not left out, so that it shows in the result.
        return ~((z <= self.NEAR_PLANE) | (z >= self.FAR_PLANE))

    @staticmethod
    def invert_cov_2D(cov_2D: torch.Tensor) -> torch.Tensor:
        """Return the inverses of 2×2 covariance matrices, ``[N, 2, 2]``.

        Determinants below 1e-10 are replaced by 1e-10.

        Parameters
        ----------
        cov_2D : torch.Tensor
            Covariance matrices ``[N, 2, 2]``.
        """
        (cov_2D,) = rows_of(cov_2D=(cov_2D, "[N, 2, 2]"))
        a, b, c, d = cov_2D.flatten(-2).unbind(-1)
        determinant = (a * d - b * c).clamp_min(1e-10)[..., None]
        return (torch.stack([d, -b, -c, a], dim=-1) / determinant).unflatten(-1, (2, 2))

    @staticmethod
    def calculate_gaussian_bounds(
        means_2D: torch.Tensor, cov_2D: torch.Tensor, img_size: tuple[int, int], confidence: float = 3.0
    ) -> torch.Tensor:
        """Return boxes around Gaussians, `confidence` standard deviations to each side.

        Parameters
        ----------
        means_2D : torch.Tensor
            ``[N, 2]``.
        cov_2D : torch.Tensor
            ``[N, 2, 2]``.
        img_size : tuple of int
            Width and height of the picture, into which the boxes are drawn: one outside becomes a piece of its rim.
        confidence : float
            Standard deviations.

        Returns
        -------
        torch.Tensor
            Least x and y, and largest x and y, ``[N, 4]``.
        """
        means_2D, cov_2D = rows_of(means_2D=(means_2D, "[N, 2]"), cov_2D=(cov_2D, "[N, 2, 2]"))
        width, height = picture_size("img_size", img_size)
        _validate.real("confidence", confidence)
        reach = confidence * cov_2D.diagonal(dim1=-2, dim2=-1).clamp_min(0).sqrt()
        last = means_2D.new_tensor([width - 1, height - 1])
        corners = [(means_2D + sign * reach).clamp_min(0).minimum(last) for sign in (-1, 1)]
        return torch.cat(corners, dim=-1)

    @staticmethod
    def apply_activations(
        pre_act_quats: torch.Tensor,
        pre_act_scales: torch.Tensor,
        pre_act_phase: torch.Tensor | None = None,
        pre_act_opacities: torch.Tensor | None = None,
        pre_act_plane_assignment: torch.Tensor | None = None,
        step: int | None = None,
        max_step: int | None = None,
    ) -> tuple[torch.Tensor | None, ...]:
        """Return parameters after their activations; None for those that are None.

        Parameters
        ----------
        pre_act_quats, pre_act_scales, pre_act_phase, pre_act_opacities, pre_act_plane_assignment : torch.Tensor
            The parameters; the last three are optional.
        step, max_step : int, optional
            Without effect; kept for callers that pass them.

        Returns
        -------
        tuple of torch.Tensor
            Unit quaternions, standard deviations exp(·), phases from 0 to 2π, opacities from 0 to 1, and planes as
            one-hot rows (see :class:`StraightThroughEstimator`).
        """
        quats, scales = floating("pre_act_quats", pre_act_quats), floating("pre_act_scales", pre_act_scales)
        phase, opacities, planes = pre_act_phase, pre_act_opacities, pre_act_plane_assignment
        phase = None if phase is None else floating("pre_act_phase", phase)
        opacities = None if opacities is None else floating("pre_act_opacities", opacities)
        if planes is not None and not (planes := shaped("pre_act_plane_assignment", planes, "[N, P]")).shape[1]:
            raise ValueError(f"pre_act_plane_assignment must have a plane at least, got {list(planes.shape)}")
        return (
            functional.normalize(quats, dim=-1),
            scales.exp(),
            None if phase is None else wrapped(phase),
            None if opacities is None else opacities.sigmoid(),
            None if planes is None else StraightThroughEstimator()(planes),
        )

    def save_gaussians(self, save_path: str | os.PathLike[str]) -> None:
        """Write the seven parameters to a ``.pth`` or ``.pt`` file, atomically.

        Parameters
        ----------
        save_path : str or path-like
            Path of the file.

        Raises
        ------
        ValueError
            If the path is not acceptable or its folder does not exist.
        """
        save(save_path, {name: getattr(self, name).detach() for name in NAMES}, "save_path")
        logger.info("%d complex Gaussians saved to %s", len(self), save_path)


def _rotation(R) -> torch.Tensor:
    R = floating("R", R)
    _validate.shaped("R", R, "[3, 3] or [1, 3, 3]")
    return R.reshape(3, 3)


def softened(axes: torch.Tensor) -> torch.Tensor:
    """Return covariances ``[N, 2, 2]`` in square pixels of axes on the picture ``[N, 2, 3]``, wider as in training."""
    return axes @ axes.mT + _SOFTNESS * torch.eye(2, dtype=axes.dtype, device=axes.device)


def shown_opacities(opacities: torch.Tensor, covariance: torch.Tensor, antialiased: bool) -> torch.Tensor:
    """Return opacities as they count in a picture: less by the root of the ratio of areas, if antialiased.

    Parameters
    ----------
    opacities : torch.Tensor
        ``[N]``.
    covariance : torch.Tensor
        Square pixels ``[N, 2, 2]``, as :func:`softened` returns them.
    antialiased : bool
        Whether the Gaussians were trained so.

    Notes
    -----
    Yu et al., *Mip-Splatting*, CVPR (2024): √(|Σ|/|Σ + 0.3|), so that a Gaussian keeps the sum of its opacity.
    """
    if not antialiased:
        return opacities
    a, b, c = covariance[:, 0, 0], covariance[:, 0, 1], covariance[:, 1, 1]
    own = (a - _SOFTNESS) * (c - _SOFTNESS) - b * b
    ratio = own / (a * c - b * b)
    # The slope of the root is infinite where a Gaussian has no area.
    return opacities * ratio.clamp_min(1e-12).sqrt()


def _clipped(slope, bound):
    """Return a slope clipped to −bound … bound, numbers or tensors."""
    bound = torch.as_tensor(bound, dtype=slope.dtype, device=slope.device)
    return slope.maximum(-bound).minimum(bound)


def _read_splats(path, planes, device, draw) -> dict[str, torch.Tensor]:
    """Return the parameters of Gaussians in a file of 3-D Gaussian splatting."""
    splats = load_splats(path)
    number = len(splats.means)
    ahead = torch.tensor([0.0, 0.0, 1.0]).expand(number, 3)
    return {
        "pre_act_quats": splats.quats,
        "means": splats.means,
        "pre_act_scales": splats.scales,
        "colours": view_colours(splats.harmonics[:, :1], ahead),
        "pre_act_phase": torch.randn(number, 3, generator=draw),
        "pre_act_opacities": splats.opacities,
        "pre_act_plane_assignment": 10 * torch.randn(number, planes, generator=draw),
    }


def _read(path, planes, device, draw) -> dict[str, torch.Tensor]:
    """Return the parameters in a file, floating-point numbers of matching shapes."""
    found = load(path, NAMES, device, "load_path")
    number = len(found["means"]) if found["means"].ndim else 0
    shapes = dict(zip(NAMES, ((number, 4), *[(number, 3)] * 4, (number,), (number, planes)), strict=True))
    for name, shape in shapes.items():
        if tuple(found[name].shape) != shape or not found[name].is_floating_point():
            raise ValueError(
                f"{path!r} holds {name} as {found[name].dtype} {list(found[name].shape)}, not {list(shape)}"
            )
    return found


def _points(pointcloud_data) -> Sequence[torch.Tensor]:
    """Return the positions and colours of a point cloud as float32 tensors."""
    if missing := [name for name in ("positions", "colors") if name not in pointcloud_data]:
        raise ValueError(f"pointcloud_data must have 'positions' and 'colors', missing {', '.join(missing)}")
    points = [
        tensor(f"pointcloud_data[{name!r}]", pointcloud_data[name]).detach().cpu().float()
        for name in ("positions", "colors")
    ]
    for name, value in zip(("positions", "colors"), points, strict=True):
        if value.ndim != 2 or value.shape[-1] != 3 or not len(value) or len(value) != len(points[0]):
            raise ValueError(f"pointcloud_data[{name!r}] must be [M, 3], got {list(value.shape)}")
    return points


NAMES = (
    "pre_act_quats",
    "means",
    "pre_act_scales",
    "colours",
    "pre_act_phase",
    "pre_act_opacities",
    "pre_act_plane_assignment",
)
_EXTENT = 15.7
_KEPT, _BACKGROUND, _SHELL, _BAND = 0.98, 0.8, (0.5, 0.8), 0.35


def random_cloud(number: int, planes: int, draw: torch.Generator) -> dict[str, torch.Tensor]:
    """Return parameters of Gaussians drawn in a cube of half width 15.7."""
    means = _EXTENT * (2 * torch.rand(number, 3, generator=draw) - 1)
    return _default_parameters(means, torch.rand(number, 3, generator=draw), planes, draw)


def point_cloud(
    positions: torch.Tensor,
    colors: torch.Tensor,
    planes: int,
    copies: int,
    scatter: float,
    outdoor: bool,
    draw: torch.Generator,
) -> dict[str, torch.Tensor]:
    """Return parameters of Gaussians at points.

    Parameters
    ----------
    positions, colors : torch.Tensor
        ``[M, 3]``.
    planes : int
        Number of planes.
    copies : int
        Copies of all points to add, each point moved by a normal distribution.
    scatter : float
        Its standard deviation.
    outdoor : bool
        Leave out the 2 % of points farthest from their mean, and add 0.8 times as many as are left in the background:
        on a shell from 0.5 to 0.8 times the largest distance left, no more than 0.35 of a unit vector along the axis
        of least extent. They take the colours of points drawn from the cloud.
    draw : torch.Generator
        Source of randomness.
    """
    moved = [positions + scatter * torch.randn(positions.shape, generator=draw) for _ in range(copies)]
    positions, colors = torch.cat([positions, *moved]), colors.repeat(copies + 1, 1)
    if outdoor:
        positions, colors = _extended_by_background(positions, colors, draw)
    return _default_parameters(positions, colors, planes, draw)


def _default_parameters(means, colours, planes, draw):
    number = len(means)
    quats = torch.tensor([1.0, 0.0, 0.0, 0.0]) + 0.01 * torch.randn(number, 4, generator=draw)
    scales = (0.01 * (torch.rand(number, 1, generator=draw) + 1e-6)).log().repeat(1, 3)
    values = (
        *(quats, means, scales, colours, torch.randn(number, 3, generator=draw)),
        *(torch.ones(number), 10 * torch.randn(number, planes, generator=draw)),
    )
    return dict(zip(NAMES, values, strict=True))


def _extended_by_background(positions, colors, draw):
    centre = positions.mean(0)
    distance = (positions - centre).norm(dim=1)
    kept = distance.argsort()[: max(1, math.ceil(_KEPT * len(positions)))].sort().values
    positions, colors, farthest = positions[kept], colors[kept], distance[kept].max()
    number = int(_BACKGROUND * len(positions))
    axes = torch.linalg.svd(positions - positions.mean(0), full_matrices=True).Vh
    height = _BAND * (2 * torch.rand(number, 1, generator=draw) - 1)
    angle = 2 * math.pi * torch.rand(number, 1, generator=draw)
    around = (1 - height.square()).sqrt()
    directions = torch.cat([around * angle.cos(), around * angle.sin(), height], dim=1) @ axes
    low, high = _SHELL
    radius = farthest * (low + (high - low) * torch.rand(number, 1, generator=draw))
    borrowed = torch.randint(len(colors), (number,), generator=draw)
    return torch.cat([positions, centre + radius * directions]), torch.cat([colors, colors[borrowed]])


class STEFunction(torch.autograd.Function):
    """One-hot choice of the largest entry of each row; backward, the gradient times the softmax of the row.

    Straight-through estimator (Bengio, Léonard and Courville 2013). The softmax multiplies the gradient entry by entry,
    without its Jacobian.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.wave import STEFunction
    >>> STEFunction.apply(torch.tensor([[0.1, 0.7, 0.2]]))
    tensor([[0., 1., 0.]])
    """

    @staticmethod
    def forward(ctx: Any, input: torch.Tensor, temperature: float = 0.001) -> torch.Tensor:
        """Return 1 at the largest entry of each row, the first of equal ones, and 0 elsewhere, ``[n, c]``.

        Parameters
        ----------
        ctx : context
            Context of the autograd function.
        input : torch.Tensor
            Scores ``[n, c]``.
        temperature : float
            Temperature of the softmax of the backward pass, default 0.001.
        """
        ctx.save_for_backward(input)
        ctx.temperature = temperature
        choice = torch.zeros_like(input).scatter_(1, input.argmax(dim=1, keepdim=True), 1.0)
        # NaN gives no choice; −∞ excludes an entry.
        return choice.masked_fill_(input.isnan() | input.isposinf(), torch.nan)

    @staticmethod
    def backward(ctx: Any, grad_output: torch.Tensor) -> tuple[torch.Tensor, None]:
        """Return the gradient times softmax(input/temperature).

        Parameters
        ----------
        ctx : context
            Context of the autograd function.
        grad_output : torch.Tensor
            Gradient of the result ``[n, c]``.
        """
        (values,) = ctx.saved_tensors
        return grad_output * torch.softmax(values / ctx.temperature, dim=1), None


class StraightThroughEstimator(nn.Module):
    """One-hot choice of the largest entry of each row, with the gradient of :class:`STEFunction`.

    Parameters
    ----------
    temperature : float
        Temperature of the softmax used for the gradient.

    Raises
    ------
    ValueError
        If the temperature is not positive.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.wave import StraightThroughEstimator
    >>> StraightThroughEstimator()(torch.tensor([[0.1, 0.7, 0.2]])).tolist()
    [[0.0, 1.0, 0.0]]
    """

    def __init__(self, temperature: float = 0.001):
        super().__init__()
        self.temperature: float = _validate.real("temperature", temperature, positive=True)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Return the choices of the rows of ``x [n, c]``, of its dtype."""
        x = floating("x", x)
        _validate.shaped("x", x, "[n, 1 or more], a choice at least")
        return STEFunction.apply(trainable(x), self.temperature)
