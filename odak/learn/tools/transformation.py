"""Rotations, distances, voxels and projection of points as differentiable tensors; angles in degrees."""

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import torch

from odak import _array, _show, _validate
from odak._torch_private import in_own_precision
from odak._warnings import AccuracyWarning, warn
from odak.learn._face import torch_face
from odak.learn._tensors import checked_device, floating, tensor, tensors_of
from odak.tools import transformation
from odak.tools.asset import read_PLY
from odak.tools.paths import validate_path
from odak.tools.transformation import ROTATION_MODES, apply_matrix, axis_rotation, rotation_matrix
from odak.tools.transformation import tilt_towards as tilt_towards

if TYPE_CHECKING:
    from odak.learn._faces.tools_transformation import *  # noqa: F403

_NONE = torch.zeros(1, 3)
# Cells of a cloud of points, whose centres take 3 GB.
_MOST_CELLS = 1 << 28


def quaternion_to_rotation_matrix(quaternions: torch.Tensor) -> torch.Tensor:
    """Return the rotation matrices of quaternions.

    Parameters
    ----------
    quaternions : torch.Tensor
        ``[..., 4]`` in the order w, x, y, z, of any length.

    Returns
    -------
    torch.Tensor
        ``[..., 3, 3]``, for column vectors: quaternions of zeros are taken as (1, 0, 0, 0), and an
        :class:`~odak.AccuracyWarning` states their number (not of values on a GPU, which would have to be read).

    Examples
    --------
    >>> import torch
    >>> from odak.learn.tools import quaternion_to_rotation_matrix
    >>> quaternion_to_rotation_matrix(torch.tensor([0.0, 0.0, 0.0, 2.0])).diagonal()
    tensor([-1., -1.,  1.])
    """
    quaternions = floating("quaternions", quaternions)
    _validate.shaped("quaternions", quaternions, "[..., 4]")
    squared = quaternions.square().sum(-1, keepdim=True)
    none = squared == 0
    if _array.is_readable(none) and bool(none.any()):
        warn(
            f"{int(none.sum())} of {none.numel()} quaternions are zero and count as no rotation; give (1, 0, 0, 0)",
            AccuracyWarning,
        )
    w, x, y, z = (quaternions / squared.where(~none, 1).sqrt()).unbind(-1)
    w = w + none[..., 0].to(w.dtype)
    rows = (
        *(1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        *(2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        *(2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    return torch.stack(rows, dim=-1).reshape(*quaternions.shape[:-1], 3, 3)


def _one_matrix(core, angle):
    matrices = core(angle)
    return matrices[0] if matrices.ndim == 3 and len(matrices) == 1 else matrices


_MATRICES = {"Returns": "torch.Tensor\n    ``[n, 3, 3]``, for column vectors; ``[3, 3]`` for one angle."}
if not TYPE_CHECKING:
    rotmatx = torch_face(transformation.rotmatx, tensors=("angle",), through=_one_matrix, describe=_MATRICES)
    rotmaty = torch_face(transformation.rotmaty, tensors=("angle",), through=_one_matrix, describe=_MATRICES)
    rotmatz = torch_face(transformation.rotmatz, tensors=("angle",), through=_one_matrix, describe=_MATRICES)


def get_rotation_matrix(tilt_angles: Sequence[float] = (0.0, 0.0, 0.0), tilt_order: str = "XYZ") -> torch.Tensor:
    """Return the matrix of three rotations about the axes.

    Parameters
    ----------
    tilt_angles : sequence or torch.Tensor
        Degrees about X, Y and Z: numbers, one-element tensors or a tensor ``[3]``.
    tilt_order : str
        Order of the rotations, first letter first; one of the six permutations of "XYZ".

    Returns
    -------
    torch.Tensor
        ``[3, 3]``, for column vectors: "XYZ" is Rz·Ry·Rx.

    Raises
    ------
    ValueError
        If there are not three angles or the order is unknown.

    Examples
    --------
    >>> from odak.learn.tools import get_rotation_matrix
    >>> get_rotation_matrix([0.0, 0.0, 180.0]).diagonal()
    tensor([-1., -1.,  1.])
    """
    if isinstance(tilt_angles, (list, tuple)):
        if len(tilt_angles) != 3:
            raise ValueError(f"tilt_angles must be three angles, got {len(tilt_angles)}")
        # Tensors are not read: NaN spreads to the matrix.
        angles = (v if isinstance(v, torch.Tensor) else _validate.real("tilt_angles", v) for v in tilt_angles)
        tilt_angles = torch.stack([floating("tilt_angles", angle).reshape(()) for angle in angles])
    angles = floating("tilt_angles", tilt_angles)
    if angles.numel() != 3:
        raise ValueError(f"tilt_angles must be three angles, got {tuple(angles.shape)}")
    return rotation_matrix(angles.reshape(3), _validate.one_of("tilt_order", tilt_order, ROTATION_MODES))


@in_own_precision
def rotate_points(
    point: torch.Tensor,
    angles: torch.Tensor = _NONE,
    mode: str = "XYZ",
    origin: torch.Tensor = _NONE,
    offset: torch.Tensor = _NONE,
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
    """Rotate points by one or several sets of angles: R·(point − origin) + origin + offset.

    Parameters
    ----------
    point : torch.Tensor
        ``[n, 3]`` or ``[3]``.
    angles : torch.Tensor
        Degrees about X, Y and Z, ``[3]`` or ``[m, 3]``.
    mode : str
        Order of the rotations, first letter first; one of the six permutations of "XYZ".
    origin : torch.Tensor
        Centre of the rotation, ``[3]`` or ``[m, 3]``.
    offset : torch.Tensor
        Shift after the rotation, ``[3]`` or ``[m, 3]``; ``[n, 3]`` shifts each point by its own when there is one
        set of angles.

    Returns
    -------
    tuple of torch.Tensor
        Points ``[n, 3]``, or ``[n, m, 3]`` for m > 1 sets, and the matrices about X, Y and Z, ``[1, 3, 3]`` or
        ``[1, m, 3, 3]``. On the device of `point`, in the widest precision given, differentiable in all four.

    Raises
    ------
    ValueError
        If a shape or the mode is wrong.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.tools import rotate_points
    >>> rotate_points(torch.tensor([[1.0, 0.0, 0.0]]), torch.tensor([0.0, 0.0, 180.0]))[0].round(decimals=4)
    tensor([[-1., -0.,  0.]])
    """
    given = {"point": point, "angles": angles, "origin": origin, "offset": offset}
    given = {name: value for name, value in given.items() if value is not _NONE}
    rows = dict(zip(given, tensors_of(**given), strict=True))
    for name, value in rows.items():
        rows[name] = _validate.shaped(name, value, "[3] or [n, 3]").reshape(-1, 3)
    point = rows["point"]
    angles, origin, offset = (rows.get(name, _NONE.to(point)) for name in ("angles", "origin", "offset"))
    sets = {"angles": len(angles), "origin": len(origin)}
    if len({1, *sets.values()}) > 2:
        raise ValueError(f"angles and origin must have as many rows, or one; got {sets}")
    matrix = rotation_matrix(angles, mode)
    # R·(p − o) + o + s = R·p + (o + s − R·o): all sets in one product. Product and sum are apart, as addmm takes five
    # times as long as the product of three columns on some processors.
    if len(angles) == len(origin) == 1 and len(offset) in (1, len(point)):
        turn, shift = matrix[0].mT, offset + (origin - origin @ matrix[0].mT)
    else:
        shift = (offset + origin - apply_matrix(matrix, origin)).reshape(-1)
        turn = matrix.expand(len(shift) // 3, 3, 3).reshape(-1, 3).mT
    rotated = point @ turn
    if "origin" in rows or "offset" in rows:
        rotated = rotated + shift
    if turn.shape[1] > 3:
        rotated = rotated.reshape(len(point), -1, 3)
    matrices = tuple(axis_rotation(axis, angles[:, i]) for i, axis in enumerate("XYZ"))
    return (rotated, *(matrix[None] if len(angles) > 1 else matrix for matrix in matrices))


def point_cloud_to_voxel(
    points: torch.Tensor, voxel_size: Sequence[float] = (0.1, 0.1, 0.1)
) -> tuple[torch.Tensor, torch.Tensor]:
    """Mark the cells of a regular grid that hold a point of a cloud.

    Parameters
    ----------
    points : torch.Tensor
        ``[n, 3]``, at least one.
    voxel_size : sequence of float
        Size of a cell along x, y and z.

    Returns
    -------
    tuple of torch.Tensor
        Centres of the cells ``[g_x, g_y, g_z, 3]``, and 1 where a cell holds a point, else 0, float32
        ``[g_x, g_y, g_z]``. The grid starts at the smallest coordinates; a point on its upper face is in the last cell.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.tools import point_cloud_to_voxel
    >>> point_cloud_to_voxel(torch.tensor([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]), [0.5, 0.5, 0.5])[1].flatten()
    tensor([1., 1.])
    """
    points = floating("points", points)
    _validate.shaped("points", points, "[n, 3], not empty")
    size = _validate.real("voxel_size", voxel_size, positive=True)
    size = torch.as_tensor(size, dtype=points.dtype, device=points.device).reshape(-1)
    if len(size) not in (1, 3):
        raise ValueError(f"voxel_size must be three numbers or one, got {len(size)}")
    size = size.expand(3)
    low, high = points.aminmax(dim=0)
    if not bool(torch.isfinite(high - low).all()):
        raise ValueError("points must be finite, got coordinates that are not")
    # An extent that is a whole number of cells but for rounding needs no further cell.
    extent = (high - low) / size
    cells = (extent - 1e-6 * extent.clamp(min=1)).ceil().clamp(min=1).long()
    index = torch.minimum(((points - low) / size).floor().long(), cells - 1)
    counts = cells.tolist()
    if math.prod(counts) > _MOST_CELLS:
        raise ValueError(
            f"voxel_size must divide the cloud into at most {_MOST_CELLS} cells, got {size.tolist()}, which makes "
            f"{' x '.join(map(str, counts))}: points and sizes are in one unit"
        )
    grid = torch.zeros(counts, device=points.device)
    grid[index[:, 0], index[:, 1], index[:, 2]] = 1
    steps = (torch.arange(n, dtype=points.dtype, device=points.device) + 0.5 for n in counts)
    locations = low + torch.stack(torch.meshgrid(*steps, indexing="ij"), dim=-1) * size
    return locations, grid


def load_voxelized_PLY(
    ply_filename: str, voxel_size: Sequence[float] = (0.05, 0.05, 0.05), device: torch.device | str = "cpu"
) -> tuple[torch.Tensor, torch.Tensor]:
    """Mark the cells of a regular grid that hold the centre of a triangle of a mesh.

    Parameters
    ----------
    ply_filename : str
        A ``.ply`` file.
    voxel_size : sequence of float
        Size of a cell along x, y and z, after the mesh is scaled: the mean of all its numbers is taken off each of
        them, and the largest of the rest becomes 1.
    device : torch.device or str
        Device of the result.

    Returns
    -------
    tuple of torch.Tensor
        float32 centres of the cells ``[g, 3]``, and 1 where a cell holds a triangle's centre, else 0, ``[g]``.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If it is not a PLY file of a mesh, or the mesh is a single point.

    Examples
    --------
    >>> import os, tempfile
    >>> from odak.learn.tools import load_voxelized_PLY
    >>> from odak.tools import write_PLY
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     name = os.path.join(folder, "triangle.ply")
    ...     write_PLY([[[0, 0, 0], [1, 0, 0], [0, 1, 0]]], name)
    ...     centers, filled = load_voxelized_PLY(name, voxel_size=[0.5, 0.5, 0.5])
    >>> int(filled.sum())
    1
    """
    validate_path(ply_filename, [".ply"], name="ply_filename")
    centres = torch.from_numpy(read_PLY(ply_filename).mean(axis=1)).to(checked_device("device", device))
    if len(centres) == 0:
        raise ValueError(f"{ply_filename!r} contains no triangles")
    centres = centres - centres.mean()
    largest = centres.amax()
    if not largest > 0:
        raise ValueError(f"{ply_filename!r} must contain more than a single point")
    locations, grid = point_cloud_to_voxel(centres / largest, voxel_size)
    return locations.reshape(-1, 3), grid.reshape(-1)


if not TYPE_CHECKING:
    cross_product = torch_face(transformation.cross_product, tensors=("vector1", "vector2"))
    same_side = torch_face(transformation.same_side, tensors=("p1", "p2", "a", "b"))
    distance_between_two_points = torch_face(transformation.distance_between_two_points, tensors=("point1", "point2"))


class PerspectiveCamera(_show.Shown):
    """A pinhole camera whose axes and place are given as x' = x·R + T for points as rows.

    Parameters
    ----------
    R : torch.Tensor
        Rotation ``[3, 3]`` or ``[1, 3, 3]``, for row vectors.
    T : torch.Tensor
        Shift ``[3]`` or ``[1, 3]``, after the rotation.
    focal_length : torch.Tensor
        Focal length along x and y, in pixels.
    principal_point : torch.Tensor
        Intersection of the optical axis with the picture, in pixels.
    device : torch.device or str
        Device of the tensors. Numbers and sequences become float32 tensors.

    Raises
    ------
    ValueError
        If the shape of `R` or `T` is wrong.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.tools import PerspectiveCamera
    >>> camera = PerspectiveCamera(torch.eye(3), torch.tensor([0.0, 0.0, 5.0]), [100.0, 100.0], [32.0, 32.0])
    >>> camera.transform_world_to_camera_space(torch.zeros(1, 3))
    tensor([[0., 0., 5.]])
    """

    def __init__(
        self,
        R: torch.Tensor,
        T: torch.Tensor,
        focal_length: Sequence[float] | torch.Tensor,
        principal_point: Sequence[float] | torch.Tensor,
        device: torch.device | str = "cpu",
    ):
        self.device: torch.device = torch.device("cpu") if device is None else checked_device("device", device)
        self.R, self.T = self._tensor("R", R), self._tensor("T", T)
        self.focal_length: torch.Tensor = self._tensor("focal_length", focal_length)
        self.principal_point: torch.Tensor = self._tensor("principal_point", principal_point)
        for name, value, shape in (("R", self.R, (3, 3)), ("T", self.T, (3,))):
            if tuple(value.shape) not in (shape, (1, *shape)):
                raise ValueError(f"{name} must be {list(shape)} or {[1, *shape]}, got {list(value.shape)}")

    @in_own_precision
    def transform_world_to_camera_space(self, points: torch.Tensor) -> torch.Tensor:
        """Return points in the axes of the camera.

        Parameters
        ----------
        points : torch.Tensor
            ``[n, 3]``.

        Returns
        -------
        torch.Tensor
            points·R + T, ``[n, 3]``, in the widest precision of the three. Differentiable.
        """
        points = floating("points", points).to(self.device)
        _validate.shaped("points", points, "[..., 3]")
        dtype = torch.promote_types(torch.promote_types(points.dtype, self.R.dtype), self.T.dtype)
        return points.to(dtype) @ self.R.to(dtype).reshape(3, 3) + self.T.reshape(1, 3)

    @in_own_precision
    def get_camera_center(self) -> torch.Tensor:
        """Return the camera's place in the world, −T·Rᵀ, ``[1, 3]``."""
        return -self.T.reshape(1, 3) @ self.R.reshape(3, 3).T

    def _tensor(self, name: str, value) -> torch.Tensor:
        return tensor(name, value, None if isinstance(value, torch.Tensor) else torch.float32, self.device)
