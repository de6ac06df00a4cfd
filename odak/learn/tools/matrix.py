"""Padding, cropping, quantisation, blur, kernels, masks and depth slices of images as tensors."""

import math
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

import torch

from odak import _array, _validate
from odak._torch_private import in_own_precision
from odak.learn._face import torch_face
from odak.learn._tensors import checked_device, checked_dtype, floating_tensor, real_tensor, tensor
from odak.tools import matrix
from odak.tools.matrix import convolve2d as convolve2d
from odak.tools.matrix import correlation_2d as correlation_2d

if TYPE_CHECKING:
    from odak.learn._faces.tools_matrix import *  # noqa: F403

_MOST_BITS = 30
_SMALLEST_SIGMA = 1e-5


def _on_images(core, field, **options):
    """Apply a function of the last two axes to a field, which may have the layout of a colour image."""
    _validate.instance("field", field, torch.Tensor, "a tensor")
    if field.ndim in (3, 4) and field.shape[-1] == 3:
        return core(field.movedim(-1, -3), **options).movedim(-3, -1)
    result = core(field, **options)
    return result[0] if result.ndim == 4 and len(result) == 1 else result


def _copy_of_images(core, field, **options):
    return _on_images(core, field, **options).clone(memory_format=torch.contiguous_format)


_FIELD = """torch.Tensor
``[..., H, W]``. Three and four axes of which the last is exactly 3 long are read as colour, ``[..., H, W, 3]``."""
_RESULT = """torch.Tensor
    The same layout, dtype and device; ``[1, C, H, W]`` loses its batch axis."""

if not TYPE_CHECKING:
    zero_pad = torch_face(
        matrix.zero_pad, through=_on_images, describe={"field": _FIELD, "Returns": f"{_RESULT} Differentiable."}
    )
    crop_center = torch_face(
        matrix.crop_center, through=_copy_of_images, describe={"field": _FIELD, "Returns": f"{_RESULT} A copy."}
    )
    smooth_pad = torch_face(
        matrix.smooth_pad,
        through=_on_images,
        describe={
            "field": f"{_FIELD} Real or complex.",
            "Returns": f"{_RESULT} Gradients pass through the content, not through its copies in the border.",
        },
    )


def quantize(image_field: torch.Tensor, bits: int = 8, limits: Sequence[float] = (0.0, 1.0)) -> torch.Tensor:
    """Return the levels of an image: the interval between the limits cut into 2^bits equal steps.

    Parameters
    ----------
    image_field : torch.Tensor
        Values; those outside the limits take the nearest level, not-a-number takes 0. An
        :class:`~odak.ArgumentWarning` names a picture of 0 … 255 where the upper limit is 1, and one of 0 … 1 where
        it is 255 or 256.
    bits : int
        Bits, 1 to 30.
    limits : sequence of float
        Values where the first level begins and the last one ends.

    Returns
    -------
    torch.Tensor
        int32, 0 … 2^bits − 1.

    Raises
    ------
    TypeError
        If `image_field` is not a real tensor.
    ValueError
        If `bits` or `limits` is not acceptable.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.tools import quantize
    >>> quantize(torch.tensor([0.0, 0.3, 0.5, 1.0]), bits=2).tolist()
    [0, 1, 2, 3]
    """
    real_tensor("image_field", image_field)
    bits = _validate.integer("bits", bits, minimum=1, most=_MOST_BITS)
    low, high = _validate.few("limits", limits, 2, rising=True)
    if image_field.numel() and _array.is_readable(image_field):
        brightest = float(image_field.detach().nan_to_num(nan=0.0, posinf=math.inf).max())
        _validate.check_white("image_field", brightest, high, "give the limits of its values, such as limits=(0, 255)")
    levels = (image_field - low) / (high - low) * 2**bits
    return levels.nan_to_num(nan=0.0).clamp(0, 2**bits).to(torch.int32).clamp(max=2**bits - 1)


def generate_2d_gaussian(
    kernel_length: Sequence[int] = (21, 21),
    nsigma: Sequence[float] = (3.0, 3.0),
    mu: Sequence[float] = (0.0, 0.0),
    normalize: bool = False,
    *,
    dtype: torch.dtype = torch.float32,
    device: torch.device | str | None = None,
) -> torch.Tensor:
    """Return a Gaussian: the density exp(−(x − μ)²/(2σ²))/(2πσ₀σ₁), or the one whose largest sample is 1.

    An axis of L samples runs from −L/2 to L/2, so that they are L/(L − 1) apart; a single one sits at 0.

    Parameters
    ----------
    kernel_length : sequence of int
        Rows and columns.
    nsigma : sequence of float
        Standard deviations σ along rows and columns, in units of the axes; 0 is replaced by 1e-5.
    mu : sequence of float
        Centre along rows and columns, in units of the axes.
    normalize : bool
        Scale the largest sample to 1.
    dtype : torch.dtype
        Precision of the result.
    device : torch.device or str, optional
        Device of the result; the CPU by default.

    Returns
    -------
    torch.Tensor
        ``[kernel_length[0], kernel_length[1]]``.

    Raises
    ------
    ValueError, TypeError
        If an argument is outside its range, naming it.

    See Also
    --------
    odak.tools.generate_2d_gaussian : Takes its size in intervals and sums to one.

    Examples
    --------
    The samples lie at −1.5, 0 and 1.5, where exp(−x²/2) is 0.3247, 1 and 0.3247:

    >>> import torch
    >>> from odak.learn.tools import generate_2d_gaussian
    >>> kernel = generate_2d_gaussian((3, 3), (1.0, 1.0), normalize=True)
    >>> [round(value, 4) for value in kernel[1].tolist()]
    [0.3247, 1.0, 0.3247]
    """
    lengths = _validate.size("kernel_length", kernel_length)
    scale = "peak" if _validate.flag("normalize", normalize) else "density"
    dtype, device = checked_dtype("dtype", dtype), checked_device("device", device)
    rows, columns = _gaussian_lines(lengths, nsigma, mu, scale, device)
    return (rows[:, None] * columns).to(dtype)


@in_own_precision
def blur_gaussian(
    field: torch.Tensor,
    kernel_length: Sequence[int] = (21, 21),
    nsigma: Sequence[float] = (3.0, 3.0),
    padding: str | int | Sequence[int] = "same",
    *,
    keep_sum: bool = False,
) -> torch.Tensor:
    """Blur pictures, zeros around them, by :func:`generate_2d_gaussian`.

    Parameters
    ----------
    field : torch.Tensor
        Real ``[..., H, W]``; every picture is blurred by itself.
    kernel_length : sequence of int
        Rows and columns of the kernel.
    nsigma : sequence of float
        Standard deviations σ along rows and columns, in units of the axes of the kernel.
    padding : {"same", "valid"}, int or sequence of int
        Keep the size, keep only what no border touches, or surround the picture with so many zeros (rows, columns).
    keep_sum : bool
        Divide the kernel by its sum. As sampled it does not sum to one, which makes pictures darker or brighter.

    Returns
    -------
    torch.Tensor
        The input's leading axes, precision and device, but ``[1, 1, H, W]`` loses its leading axes. Differentiable.

    Raises
    ------
    ValueError, TypeError
        If an argument is outside its range, naming it.

    Examples
    --------
    With `keep_sum` the sum of a picture is kept:

    >>> import torch
    >>> from odak.learn.tools import blur_gaussian
    >>> image = torch.zeros(16, 16)
    >>> image[8, 8] = 3
    >>> round(blur_gaussian(image, (5, 5), (1, 1), keep_sum=True).sum().item(), 4)
    3.0
    """
    floating_tensor("field", field, "a real floating tensor")
    _validate.image("field", field)
    lengths = _validate.size("kernel_length", kernel_length)
    scale = "sum" if _validate.flag("keep_sum", keep_sum) else "density"
    rows, columns = (line.to(field.dtype) for line in _gaussian_lines(lengths, nsigma, (0, 0), scale, field.device))
    planes = torch.nn.functional.pad(field.reshape(-1, 1, *field.shape[-2:]), _borders(padding, lengths))
    if any(length > side for length, side in zip(lengths, planes.shape[-2:], strict=True)):
        raise ValueError(
            f"kernel_length must be at most the padded field's {tuple(planes.shape[-2:])}, got {kernel_length!r}"
        )
    planes = torch.nn.functional.conv2d(planes, rows.reshape(1, 1, -1, 1))
    planes = torch.nn.functional.conv2d(planes, columns.reshape(1, 1, 1, -1))
    batch = () if field.ndim == 4 and field.shape[:2] == (1, 1) else field.shape[:-2]
    return planes.reshape(*batch, *planes.shape[-2:])


def _gaussian_lines(lengths, nsigma, mu, scale, device):
    """Return the two factors of a Gaussian in float64: its density, its largest sample 1, or its sum 1."""
    sigmas, centres = (
        torch.as_tensor(_validate.real(name, value), dtype=torch.float64).reshape(-1)
        for name, value in (("nsigma", nsigma), ("mu", mu))
    )
    if len(sigmas) != 2 or (_array.is_readable(sigmas) and bool((sigmas < 0).any())):
        raise ValueError(f"nsigma must be two numbers of at least 0, got {nsigma!r}")
    if len(centres) != 2:
        raise ValueError(f"mu must be two numbers, got {mu!r}")
    lines = []
    for length, sigma, centre in zip(
        lengths, sigmas.where(sigmas != 0, _SMALLEST_SIGMA).to(device), centres.to(device), strict=True
    ):
        edge = length / 2 if length > 1 else 0.0
        axis = torch.linspace(-edge, edge, length, dtype=torch.float64, device=device)
        exponent = -(((axis - centre) / sigma) ** 2) / 2
        if scale == "density":
            lines.append(torch.exp(exponent) / (math.sqrt(2 * math.pi) * sigma))
            continue
        # Relative to the largest, so that a narrow Gaussian between two samples is not 0/0.
        line = torch.exp(exponent - exponent.max())
        lines.append(line / line.sum() if scale == "sum" else line)
    return lines


def _borders(padding, lengths):
    """Return the zeros to put left, right, above and below; "same" puts the odd one of an even kernel at the end."""
    if isinstance(padding, str):
        if _validate.one_of("padding", padding, ("same", "valid")) == "valid":
            return (0, 0, 0, 0)
        (above, below), (left, right) = (((length - 1) // 2, length // 2) for length in lengths)
        return (left, right, above, below)
    pair = tuple(padding) if isinstance(padding, Iterable) else (padding, padding)
    if len(pair) != 2:
        raise ValueError(f"padding must be 'same', 'valid', an integer or two, got {padding!r}")
    rows, columns = (_validate.integer("padding", count) for count in pair)
    return (columns, columns, rows, rows)


def generate_2d_dirac_delta(
    kernel_length: Sequence[int] = (21, 21),
    a: Sequence[float] = (3.0, 3.0),
    mu: Sequence[float] = (0.0, 0.0),
    theta: float = 0.0,
    normalize: bool = False,
    *,
    dtype: torch.dtype = torch.float32,
    device: torch.device | str | None = None,
) -> torch.Tensor:
    """Return a rotated, narrow peak exp(−(x'/a₀)² − (y'/a₁)²)/(π|a₀a₁|), which tends to Dirac's delta with a → 0.

    An axis of L samples runs from −L/2 to L/2, so that they are L/(L − 1) apart; a single one sits at 0. With x and y
    along rows and columns from `mu`, x' = x·cos θ − y·sin θ and y' = x·sin θ + y·cos θ.

    Parameters
    ----------
    kernel_length : sequence of int
        Rows and columns.
    a : sequence of float or torch.Tensor
        Widths along x' and y', in units of the axes, not zero.
    mu : sequence of float or torch.Tensor
        Centre along rows and columns, in units of the axes.
    theta : float or torch.Tensor
        Angle in radians.
    normalize : bool
        Scale the largest sample to 1.
    dtype : torch.dtype
        Precision of the result.
    device : torch.device or str, optional
        Device of the result; the CPU by default.

    Returns
    -------
    torch.Tensor
        ``[kernel_length[0], kernel_length[1]]``, differentiable in `a`, `mu` and `theta`.

    Raises
    ------
    ValueError, TypeError
        If an argument is outside its range, naming it.

    Examples
    --------
    >>> from odak.learn.tools import generate_2d_dirac_delta
    >>> generate_2d_dirac_delta([3, 3], [1, 2], normalize=True)[1].round(decimals=3)
    tensor([0.5700, 1.0000, 0.5700])
    """
    lengths = _validate.size("kernel_length", kernel_length)
    normalize = _validate.flag("normalize", normalize)
    dtype, device = checked_dtype("dtype", dtype), checked_device("device", device)
    widths = _pair("a", _validate.real("a", a, nonzero=True), device)
    centre = _pair("mu", _validate.real("mu", mu), device)
    angle = torch.as_tensor(_validate.real("theta", theta), dtype=torch.float64, device=device)
    x, y = (
        torch.linspace(-n / 2, n / 2, n, dtype=torch.float64, device=device) if n > 1 else centre.new_zeros(1)
        for n in lengths
    )
    x, y = (x - centre[0])[:, None], (y - centre[1])[None, :]
    across, along = x * angle.cos() - y * angle.sin(), x * angle.sin() + y * angle.cos()
    exponent = -((across / widths[0]) ** 2) - (along / widths[1]) ** 2
    if normalize:
        # Relative to the largest, so that a narrow peak between two samples is not 0/0.
        return torch.exp(exponent - exponent.max()).to(dtype)
    return (torch.exp(exponent) / (math.pi * widths.prod().abs())).to(dtype)


def _pair(name, value, device):
    pair = torch.as_tensor(value, dtype=torch.float64, device=device).reshape(-1)
    if pair.numel() != 2:
        raise ValueError(f"{name} must be two numbers, got {value!r}")
    return pair


def circular_binary_mask(
    px: int,
    py: int,
    r: float,
    offset_x: float = 0.0,
    offset_y: float = 0.0,
    *,
    device: torch.device | str | None = None,
) -> torch.Tensor:
    """Return a disc of ones: samples nearer than `r` to its centre.

    The axis of n samples runs from −n/2 to n/2, so that samples are n/(n − 1) apart and symmetric about 0.

    Parameters
    ----------
    px : int
        Number of rows.
    py : int
        Number of columns.
    r : float
        Radius in units of the axes; nothing is inside a radius of 0.
    offset_x : float
        Centre along the index of the rows, in units of the axes.
    offset_y : float
        Centre along the index of the columns, in units of the axes.
    device : torch.device or str, optional
        Device of the result; the CPU by default.

    Returns
    -------
    torch.Tensor
        float32 ``[1, 1, px, py]`` of 0 and 1.

    Raises
    ------
    ValueError, TypeError
        If an argument is outside its range, naming it.

    Examples
    --------
    >>> from odak.learn.tools import circular_binary_mask
    >>> circular_binary_mask(5, 5, 2.0).sum().item()
    9.0
    """
    r, offset_x, offset_y = (
        _validate.constant(name, value) for name, value in (("r", r), ("offset_x", offset_x), ("offset_y", offset_y))
    )
    device = checked_device("device", device)
    rows, columns = (_axis(name, n, device) for name, n in (("px", px), ("py", py)))
    squared = (rows[:, None] - offset_x) ** 2 + (columns - offset_y) ** 2
    return (torch.sqrt(squared) < r).to(torch.float32)[None, None]


def _axis(name, length, device):
    length = _validate.side(name, _validate.integer(name, length, minimum=1))
    edge = length / 2 if length > 1 else 0.0
    return torch.linspace(-edge, edge, length, dtype=torch.float64, device=device)


def plane_indices(depth: torch.Tensor, number_of_planes: int) -> torch.Tensor:
    """Return the plane nearest to each pixel, round(depth·(P − 1)).

    Parameters
    ----------
    depth : torch.Tensor
        Depths, 0 … 1.
    number_of_planes : int
        Number of planes P.

    Returns
    -------
    torch.Tensor
        int64, 0 … P − 1; the even one of two planes that are equally near.
    """
    return torch.round(depth * (number_of_planes - 1)).long()


def plane_masks(indices: torch.Tensor, number_of_planes: int) -> torch.Tensor:
    """Return ones where a pixel belongs to a plane.

    Parameters
    ----------
    indices : torch.Tensor
        Plane of each pixel, ``[..., m, n]``.
    number_of_planes : int
        Number of planes P.

    Returns
    -------
    torch.Tensor
        Boolean ``[..., P, m, n]``; each pixel belongs to one plane.
    """
    planes = torch.arange(number_of_planes, device=indices.device)
    return indices.unsqueeze(-3) == planes[:, None, None]


def slice_rgbd_targets(
    target: torch.Tensor, depth: torch.Tensor, depth_plane_positions: Sequence[float] | torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor]:
    """Cut a picture into slices of depth.

    Parameters
    ----------
    target : torch.Tensor
        Picture ``[C, H, W]``.
    depth : torch.Tensor
        Depth of each pixel ``[H, W]``.
    depth_plane_positions : sequence of float or torch.Tensor
        N + 1 rising boundaries; whether those on a GPU rise is not looked at. Slice i holds boundary[i] ≤ depth <
        boundary[i + 1]; the last one its upper boundary too. Pixels beyond the outermost boundaries, and those whose
        depth is not a number, are in no slice.

    Returns
    -------
    tuple of torch.Tensor
        Slices in the precision of `target` (float32 of integers), zero outside their depth, and masks of 0 and 1 in
        int32, each ``[N, C, H, W]``. The slices are differentiable in `target`.

    Raises
    ------
    ValueError, TypeError
        If the shapes do not fit or the boundaries do not rise.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.perception import slice_rgbd_targets
    >>> slices, masks = slice_rgbd_targets(torch.ones(3, 1, 3), torch.tensor([[0.0, 0.5, 1.0]]), [0.0, 0.5, 1.0])
    >>> masks[:, 0, 0].tolist()
    [[1, 0, 0], [0, 1, 1]]
    """
    (depth_plane_positions,) = _validate.constants(depth_plane_positions=depth_plane_positions)
    for name, value in (("target", target), ("depth", depth)):
        _validate.instance(name, value, torch.Tensor, "a tensor")
    rows, columns = _validate.shaped("target", target, "[C, H, W]").shape[-2:]
    _validate.shaped("depth", depth, f"[{rows}, {columns}], the rows and columns of target")
    _validate.one_device(target=target, depth=depth)
    target, depth = (value if value.is_floating_point() else value.float() for value in (target, depth))
    edges = tensor("depth_plane_positions", depth_plane_positions, depth.dtype)
    # A GPU is not waited for.
    if edges.ndim != 1 or len(edges) < 2 or (_array.is_readable(edges) and not (edges[1:] > edges[:-1]).all()):
        raise ValueError(f"depth_plane_positions must be two or more rising numbers, got {depth_plane_positions!r}")
    edges = edges.to(depth.device)[:, None, None]
    inside = (depth >= edges[:-1]) & (depth < edges[1:])
    inside[-1] |= depth == edges[-1]
    masks = inside[:, None].expand(-1, target.shape[0], -1, -1)
    return target * masks, masks.to(torch.int32)
