"""Functions of position as tensors: cubic B-splines, Gaussians in space, Zernike polynomials."""

import math
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np
import torch

from odak import _array, _validate
from odak._array import ArrayT
from odak._torch_private import in_own_precision
from odak.learn._tensors import checked_device, checked_dtype, floating_tensor
from odak.tools.transformation import apply_matrix, rotation_matrix
from odak.tools.zernike import fringe_to_nm as fringe_to_nm
from odak.tools.zernike import noll_to_nm as noll_to_nm
from odak.tools.zernike import osa_to_nm as osa_to_nm
from odak.tools.zernike import zernike_norm as zernike_norm
from odak.tools.zernike import zernike_polynomial as zernike_polynomial

_ZERO, _ONE, _OPAQUE = torch.zeros(1, 3), torch.ones(1, 3), torch.ones(1, 1)


def evaluate_3d_gaussians(
    points: torch.Tensor,
    centers: torch.Tensor = _ZERO,
    scales: torch.Tensor = _ONE,
    angles: torch.Tensor = _ZERO,
    opacity: torch.Tensor = _OPAQUE,
) -> torch.Tensor:
    """Return the values of Gaussians at points: opacity·exp(−q²/2)/((2π)^(3/2)·s_x·s_y·s_z).

    For each Gaussian a point is rotated about its centre by its angles; q is the vector from the centre, each
    coordinate divided by the standard deviation along that axis.

    Parameters
    ----------
    points : torch.Tensor
        ``[n, 3]``.
    centers : torch.Tensor
        ``[m, 3]``.
    scales : torch.Tensor
        Standard deviations ``[m, 3]``.
    angles : torch.Tensor
        Degrees about X, Y and Z, in this order, ``[m, 3]``.
    opacity : torch.Tensor
        ``[m, 1]`` or ``[m]``.

    Returns
    -------
    torch.Tensor
        ``[n, m]``, in the precision and on the device of `points`, differentiable in all. A single row of centres,
        scales, angles or opacities belongs to all Gaussians.

    Raises
    ------
    ValueError
        If a shape is wrong.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.tools import evaluate_3d_gaussians
    >>> evaluate_3d_gaussians(torch.zeros(1, 3), torch.tensor([[1.0, 0.0, 0.0], [0.0, 0.0, 0.0]])).round(decimals=4)
    tensor([[0.0385, 0.0635]])
    """
    given = {"points": points, "centers": centers, "scales": scales, "angles": angles}
    for name, value in given.items():
        if not isinstance(value, torch.Tensor) or value.ndim != 2 or value.shape[-1] != 3:
            raise ValueError(f"{name} must be a tensor [n, 3], got {tuple(getattr(value, 'shape', ()))}")
    _validate.instance("opacity", opacity, torch.Tensor, "a tensor [n, 1] or [n]")
    opacity = opacity.reshape(-1)
    counts = {len(centers), len(scales), len(angles), len(opacity)} - {1}
    if len(counts) > 1:
        raise ValueError(f"centers, scales, angles and opacity must have as many rows, or one; got {sorted(counts)}")
    points = points if points.is_floating_point() else points.to(torch.get_default_dtype())
    rest = (value.to(points) for value in (centers, scales, angles, opacity))
    return gaussians(points, *rest)


class SeparableBasis:
    """Basis of products of splines, stored as two small factors instead of the matrix.

    Any function of torch and any attribute of a tensor is applied to the matrix ``[c_x·c_y, H·W]``.

    Parameters
    ----------
    rows : torch.Tensor
        Splines along the index of the rows, ``[c_y, H]``.
    columns : torch.Tensor
        Splines along the index of the columns, ``[c_x, W]``.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.tools import SeparableBasis
    >>> basis = SeparableBasis(torch.ones(2, 16), torch.ones(3, 12))
    >>> tuple(basis.shape)
    (6, 192)
    """

    def __init__(self, rows: torch.Tensor, columns: torch.Tensor):
        for name, factor in (("rows", rows), ("columns", columns)):
            if not isinstance(factor, torch.Tensor) or factor.ndim != 2:
                raise TypeError(f"{name} must be a tensor [splines, samples], got {type(factor).__name__}")
        self.rows: torch.Tensor = rows
        self.columns: torch.Tensor = columns
        self._matrix: torch.Tensor | None = None

    @property
    def shape(self) -> torch.Size:
        """Shape of the matrix."""
        return torch.Size([len(self.rows) * len(self.columns), self.rows.shape[1] * self.columns.shape[1]])

    def to_dense(self) -> torch.Tensor:
        """Return the matrix ``[c_x·c_y, H·W]``, kept from then on."""
        if self._matrix is None:
            self._matrix = torch.kron(self.rows, self.columns)
        return self._matrix

    def __getattr__(self, name: str) -> Callable[..., Any] | torch.Tensor | None:
        if name.startswith("__"):
            raise AttributeError(name)
        return getattr(self.to_dense(), name)

    def __getitem__(self, index: int) -> torch.Tensor:
        return self.to_dense()[index]

    def __len__(self) -> int:
        return self.shape[0]

    def __matmul__(self, other: torch.Tensor) -> torch.Tensor:
        return self.to_dense() @ other

    def __rmatmul__(self, other: Any) -> Any:
        return other @ self.to_dense()

    def __array__(self, dtype: Any = None, copy: Any = None) -> np.ndarray:
        return self.to_dense().numpy().astype(dtype) if dtype else self.to_dense().numpy()

    @classmethod
    def __torch_function__(
        cls, function: Callable[..., Any], types: Any, args: Iterable[Any] = (), kwargs: dict[str, Any] | None = None
    ) -> Any:
        args = [arg.to_dense() if isinstance(arg, cls) else arg for arg in args]
        return function(*args, **(kwargs or {}))


def generate_bspline_basis_2d(
    num_control_points: Sequence[int],
    resolution: Sequence[int],
    device: torch.device | str = "cpu",
    *,
    dtype: torch.dtype = torch.float32,
) -> tuple[torch.Tensor, torch.Tensor]:
    """Return products of cubic B-splines along rows and columns, as a matrix.

    Parameters
    ----------
    num_control_points : sequence of int
        Splines along x (the columns' index) and along y (the rows' index), their centres from edge to edge.
    resolution : sequence of int
        Rows and columns of the picture.
    device : torch.device or str
        Device of the result.
    dtype : torch.dtype
        Its precision.

    Returns
    -------
    tuple of torch.Tensor
        Matrix ``[c_x·c_y, H·W]``, whose row i_y·c_x + i_x is the product of the splines i_y and i_x, and the centres
        ``[c_x, c_y, 2]`` from −1 to 1, x first: transpose its first two axes for the order of the matrix' rows.

    Raises
    ------
    ValueError, TypeError
        If an argument is not two positive integers.

    Notes
    -----
    Inside, the splines sum to 1; at each edge the sum is 5/6, since none has its centre outside.

    Examples
    --------
    >>> from odak.learn.tools import generate_bspline_basis_2d
    >>> generate_bspline_basis_2d([4, 1], [1, 7])[0][1].round(decimals=3)
    tensor([0.1670, 0.4790, 0.6670, 0.4790, 0.1670, 0.0210, 0.0000])
    """
    dtype, device = checked_dtype("dtype", dtype), checked_device("device", device)
    factors, grid = _factors(num_control_points, resolution, dtype, device)
    return torch.kron(*factors), grid


def decompose_bspline_2d(
    image: torch.Tensor, num_control_points: Sequence[int], regularization: float = 1e-6
) -> tuple[torch.Tensor, SeparableBasis, torch.Tensor]:
    """Fit a sum of cubic B-splines to a picture: the coefficients c that solve (B·Bᵀ + λ)·c = B·image.

    Parameters
    ----------
    image : torch.Tensor
        Real ``[H, W]`` or ``[1, H, W]``.
    num_control_points : sequence of int
        Splines along x (the columns' index) and along y (the rows' index).
    regularization : float
        λ ≥ 0.

    Returns
    -------
    tuple
        Coefficients ``[c_x·c_y]``, row by row, of the picture's precision and differentiable; the basis for
        :func:`compose_bspline_2d`, which represents the matrix B without its memory; and the centres
        ``[c_x, c_y, 2]``.

    Raises
    ------
    ValueError, TypeError
        If an argument is not acceptable, naming it.

    Notes
    -----
    B·Bᵀ is the Kronecker product of two small matrices, so the eigenvectors of each solve the system: the cost is that
    of four small products, and B is never formed.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.tools import compose_bspline_2d, decompose_bspline_2d
    >>> image = torch.linspace(0, 1, 32)[:, None].expand(32, 24)
    >>> coefficients, basis, _ = decompose_bspline_2d(image, [4, 6])
    >>> bool((compose_bspline_2d(coefficients, basis, [32, 24]) - image).abs().max() < 0.2)
    True
    """
    image = _picture(image)
    _validate.number("regularization", regularization, least=0)
    # Solved in float64: the normal equations square the condition number.
    (rows, columns), grid = _factors(num_control_points, image.shape, torch.float64, image.device)
    coefficients = _solve(image.to(torch.float64), rows, columns, regularization).to(image.dtype)
    basis = SeparableBasis(rows.to(image.dtype), columns.to(image.dtype))
    return coefficients.reshape(-1), basis, grid.to(image.dtype)


@in_own_precision
def compose_bspline_2d(
    control_coefficients: torch.Tensor, basis_matrix: torch.Tensor | SeparableBasis, resolution: Sequence[int]
) -> torch.Tensor:
    """Return the picture of given coefficients of B-splines.

    Parameters
    ----------
    control_coefficients : torch.Tensor
        ``[c_x·c_y]``.
    basis_matrix : torch.Tensor or SeparableBasis
        From :func:`generate_bspline_basis_2d` or :func:`decompose_bspline_2d`.
    resolution : sequence of int
        Rows and columns.

    Returns
    -------
    torch.Tensor
        ``[H, W]``, in the wider precision of the two, differentiable.

    Raises
    ------
    TypeError
        If one of them is not a tensor.
    ValueError
        If the shapes do not fit each other.

    Examples
    --------
    Equal coefficients give a constant away from the edges, for B-splines add up to 1:

    >>> import torch
    >>> from odak.learn.tools import compose_bspline_2d, generate_bspline_basis_2d
    >>> basis, centers = generate_bspline_basis_2d([5, 4], [16, 12])
    >>> image = compose_bspline_2d(torch.full((20,), 2.0), basis, [16, 12])
    >>> tuple(image.shape), round(image[8, 6].item(), 4)
    ((16, 12), 2.0)
    """
    rows, columns = _validate.size("resolution", resolution)
    separable = isinstance(basis_matrix, SeparableBasis)
    for name, value in (("control_coefficients", control_coefficients), ("basis_matrix", basis_matrix)):
        if not (separable and value is basis_matrix):
            _validate.instance(name, value, torch.Tensor, "a tensor")
    accepted = f"[{control_coefficients.numel()}, {rows * columns}] for these control_coefficients and this resolution"
    _validate.shaped("basis_matrix", basis_matrix, accepted)
    held = basis_matrix
    factors: Sequence[Any] = (held.rows, held.columns) if isinstance(held, SeparableBasis) else (held,)
    dtype = torch.promote_types(control_coefficients.dtype, factors[0].dtype)
    coefficients, *factors = (value.to(dtype) for value in (control_coefficients.reshape(-1), *factors))
    if separable:
        grid = coefficients.reshape(len(factors[0]), len(factors[1]))
        return factors[0].T @ grid @ factors[1]
    return (coefficients @ factors[0]).reshape(rows, columns)


def decompose_wavelet_like(
    image: torch.Tensor, n_scales: int = 4
) -> tuple[list[torch.Tensor], list[torch.Tensor], torch.Tensor]:
    """Split a picture into a smooth base and the residuals of its fits on successively coarser grids of B-splines.

    Parameters
    ----------
    image : torch.Tensor
        Real ``[H, W]`` or ``[1, H, W]``, at least two samples along each axis.
    n_scales : int
        Number of grids. Grid s has max(4, ⌊⌊n/2^s⌋/8⌋) splines along each axis, n the shorter side, at most ⌊n/2⌋.

    Returns
    -------
    tuple
        Coefficients ``[c²]`` and residuals ``[H, W]`` of each grid, from fine to coarse, and the base ``[H, W]``.

    Raises
    ------
    ValueError, TypeError
        If an argument is not acceptable, naming it.

    See Also
    --------
    reconstruct_wavelet_like : The inverse, exact to rounding.

    Examples
    --------
    The decomposition is exact to rounding:

    >>> import torch
    >>> from odak.learn.tools import decompose_wavelet_like, reconstruct_wavelet_like
    >>> image = torch.linspace(0, 1, 256).reshape(16, 16) ** 2
    >>> coefficients, residuals, base = decompose_wavelet_like(image, n_scales=2)
    >>> again = reconstruct_wavelet_like(coefficients, residuals, base)
    >>> bool((again - image).abs().max() < 1e-5)
    True
    """
    current = _picture(image)
    shortest = min(current.shape)
    if shortest < 2:
        raise ValueError(f"image must have at least two samples along each axis, got {tuple(current.shape)}")
    coefficients, residuals = [], []
    for scale in range(_validate.integer("n_scales", n_scales)):
        count = min(max(4, shortest // 2**scale // 8), shortest // 2)
        found, basis, _ = decompose_bspline_2d(current, [count, count], 1e-8)
        smooth = compose_bspline_2d(found, basis, current.shape)
        coefficients.append(found)
        residuals.append(current - smooth)
        current = smooth
    return coefficients, residuals, current


def reconstruct_wavelet_like(
    coefficients: Sequence[torch.Tensor], residuals: Sequence[torch.Tensor], base: torch.Tensor
) -> torch.Tensor:
    """Return the picture that :func:`decompose_wavelet_like` has split.

    Parameters
    ----------
    coefficients : sequence of torch.Tensor
        Not needed: base and residuals hold the picture.
    residuals : sequence of torch.Tensor
        ``[H, W]`` each, from fine to coarse.
    base : torch.Tensor
        ``[H, W]``.

    Returns
    -------
    torch.Tensor
        ``[H, W]``.

    Examples
    --------
    The decomposition is exact to rounding:

    >>> import torch
    >>> from odak.learn.tools import decompose_wavelet_like, reconstruct_wavelet_like
    >>> image = torch.linspace(0, 1, 256).reshape(16, 16) ** 2
    >>> coefficients, residuals, base = decompose_wavelet_like(image, n_scales=2)
    >>> again = reconstruct_wavelet_like(coefficients, residuals, base)
    >>> bool((again - image).abs().max() < 1e-5)
    True
    """
    for name, layers in (("coefficients", coefficients), ("residuals", residuals), ("base", [base])):
        listed = isinstance(layers, Sequence) and not isinstance(layers, str)
        if not listed or not all(isinstance(layer, torch.Tensor) for layer in layers):
            raise TypeError(f"{name} must contain tensors, got {layers!r:.80}")
    for residual in residuals:
        _validate.fitting(base=base, residuals=residual)
    # Backwards, as each sum then is the picture that the finer residual was taken from.
    for residual in reversed(residuals):
        base = base + residual
    return base


def _factors(num_control_points, resolution, dtype, device):
    counts = _validate.size("num_control_points", num_control_points)
    shape = _validate.size("resolution", resolution)
    factors = [
        torch.from_numpy(bspline_factor(count, n)).to(device=device, dtype=dtype)
        for count, n in zip(reversed(counts), shape, strict=True)
    ]
    lines = (torch.linspace(-1, 1, count, dtype=dtype, device=device) for count in counts)
    return factors, torch.stack(torch.meshgrid(*lines, indexing="ij"), dim=-1)


@in_own_precision
def _solve(image, rows, columns, regularization) -> torch.Tensor:
    (row_values, row_vectors), (values, vectors) = (torch.linalg.eigh(f @ f.T) for f in (rows, columns))
    rotated = (row_vectors.T @ rows) @ image @ (vectors.T @ columns).T
    # More splines than samples leave directions without any weight; rounding must not fill them.
    scale = row_values[:, None].clamp(min=0) * values.clamp(min=0) + regularization
    floor = torch.finfo(scale.dtype).eps * scale.amax() * max(scale.shape)
    rotated = torch.where(scale > floor, rotated / scale.clamp(min=floor), 0.0)
    return row_vectors @ rotated @ vectors.T


def _picture(image) -> torch.Tensor:
    floating_tensor("image", image, "a real floating tensor")
    if image.ndim == 3 and len(image) == 1:
        image = image[0]
    _validate.shaped("image", image, "[H, W] or [1, H, W], not empty")
    return image


def bspline_factor(count: int, samples: int) -> np.ndarray:
    """Return the values of cubic B-splines along one axis.

    Parameters
    ----------
    count : int
        Number of splines, their centres equally far apart from 0 to 1; a single one is constant.
    samples : int
        Number of samples from 0 to 1.

    Returns
    -------
    numpy.ndarray
        float64 ``[count, samples]``. The sum over the splines is 1 but within one interval of the ends, where it falls
        to 5/6: no splines have their centres outside.

    Notes
    -----
    de Boor, A Practical Guide to Splines (2001), chapter IX: 2/3 − u² + |u|³/2 for |u| ≤ 1, (2 − |u|)³/6 for |u| ≤ 2.
    """
    if count == 1:
        return np.ones((1, samples))
    place = np.linspace(0, 1, samples) * (count - 1)
    u = np.abs(place - np.arange(count)[:, None])
    return np.where(u <= 1, 2 / 3 - u**2 + u**3 / 2, np.maximum(2 - u, 0) ** 3 / 6)


def gaussians(points: ArrayT, centers: ArrayT, scales: ArrayT, angles: ArrayT, opacity: ArrayT) -> ArrayT:
    """Return the densities of rotated Gaussians at points, ``[n, m]``.

    Parameters
    ----------
    points : array
        ``[n, 3]``.
    centers : array
        Centres ``[m, 3]``.
    scales : array
        Standard deviations ``[m, 3]``.
    angles : array
        Degrees about X, Y and Z by which the points are rotated, ``[m, 3]``.
    opacity : array
        ``[m]``.
    """
    xp = _array.namespace(points)
    arm = apply_matrix(rotation_matrix(angles), points[:, None, :] - centers) / scales
    norm = opacity / ((2 * math.pi) ** 1.5 * xp.prod(scales, axis=-1))
    return norm * xp.exp(-xp.sum(arm**2, axis=-1) / 2)
