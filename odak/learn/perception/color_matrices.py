"""Matrices between colour spaces, derived from primaries and a white, and their application to pictures."""

import functools
from collections.abc import Callable, Iterable, Sequence

import numpy as np
import torch

from odak import _torch_private, _validate
from odak.learn._precision import in_own_precision

BT709_PRIMARIES = ((0.640, 0.330), (0.300, 0.600), (0.150, 0.060))
BT2020_PRIMARIES = ((0.708, 0.292), (0.170, 0.797), (0.131, 0.046))
P3_PRIMARIES = ((0.680, 0.320), (0.265, 0.690), (0.150, 0.060))
PRIMARIES = {"BT.709": BT709_PRIMARIES, "BT.2020": BT2020_PRIMARIES, "Display P3": P3_PRIMARIES}

# D65 is written down in several roundings. The first two are those of the library's earlier releases.
XYZ_WHITE = (0.950456, 1.0, 1.088754)
LAB_WHITE = (0.31271 / 0.32902, 1.0, (1 - 0.31271 - 0.32902) / 0.32902)
IEC_WHITE = (0.3127 / 0.3290, 1.0, (1 - 0.3127 - 0.3290) / 0.3290)


@functools.lru_cache(maxsize=64)
def _rgb_to_xyz_rows(primaries, white):
    columns = np.array([(x / y, 1.0, (1 - x - y) / y) for x, y in primaries]).T
    return columns * np.linalg.solve(columns, np.array(white))


def rgb_to_xyz_matrix(
    primaries: Sequence[Sequence[float]] = BT709_PRIMARIES, white: Sequence[float] = IEC_WHITE
) -> torch.Tensor:
    """Return the matrix from linear RGB to CIE XYZ of a display.

    Parameters
    ----------
    primaries : sequence
        Chromaticities (x, y) of red, green and blue.
    white : sequence of float
        XYZ of R = G = B = 1.

    Returns
    -------
    torch.Tensor
        ``[3, 3]``, float64.

    Raises
    ------
    ValueError, TypeError
        If the primaries are not three pairs or the white not three numbers.

    Notes
    -----
    SMPTE RP 177:1993. The defaults are IEC 61966-2-1's primaries and D65 = (0.3127, 0.3290).

    Examples
    --------
    >>> from odak.learn.perception import rgb_to_xyz_matrix
    >>> [round(value, 4) for value in rgb_to_xyz_matrix()[1].tolist()]
    [0.2126, 0.7152, 0.0722]
    """
    return torch.from_numpy(_rgb_to_xyz_rows(*_checked_space(primaries, white)).copy())


def change_primaries(image: torch.Tensor, source: str = "BT.709", target: str = "BT.2020") -> torch.Tensor:
    """Return linear RGB of one set of primaries as linear RGB of another; both have the white D65.

    Parameters
    ----------
    image : torch.Tensor
        Linear RGB ``[..., 3, H, W]``.
    source : {"BT.709", "BT.2020", "Display P3"}
        Primaries of the picture.
    target : {"BT.709", "BT.2020", "Display P3"}
        Primaries of the result.

    Returns
    -------
    torch.Tensor
        ``[..., 3, H, W]``, four axes for three; colours that the target cannot show have values below 0 or above 1.
        Differentiable.

    Raises
    ------
    ValueError, TypeError
        If the picture has other axes, or the primaries are not known.

    Notes
    -----
    ITU-R BT.2087-0 gives the matrix from BT.709 to BT.2020.

    Examples
    --------
    Both have the white D65, so that greys stay:

    >>> import torch
    >>> from odak.learn.perception import change_primaries
    >>> result = change_primaries(torch.tensor([1.0, 1.0, 1.0]).reshape(1, 3, 1, 1))
    >>> [round(value, 4) for value in result.flatten().tolist()]
    [1.0, 1.0, 1.0]
    """
    source, target = (
        _validate.one_of(name, value, PRIMARIES) for name, value in (("source", source), ("target", target))
    )
    to_xyz, to_target = (_rgb_to_xyz_rows(PRIMARIES[space], IEC_WHITE) for space in (source, target))
    return mix(rows(np.linalg.solve(to_target, to_xyz)), as_pictures("image", image))


def as_pictures(name: str, image: torch.Tensor, channels: int | None = 3) -> torch.Tensor:
    """Return real pictures ``[..., C, H, W]`` with at least four axes after checking them."""
    if not isinstance(image, torch.Tensor) or not image.is_floating_point():
        kind = getattr(image, "dtype", type(image).__name__)
        raise TypeError(f"{name} must be a tensor of real floats, got {kind}")
    if image.ndim < 3 or (channels is not None and image.shape[-3] != channels):
        wanted = "C" if channels is None else channels
        raise ValueError(f"{name} must be pictures [..., {wanted}, H, W], got {tuple(image.shape)}")
    return image if image.ndim > 3 else image[None]


def rows(matrix: np.ndarray) -> tuple[tuple[float, ...], ...]:
    """Return a matrix as nested tuples, which can be looked up."""
    return tuple(map(tuple, matrix.tolist()))


@in_own_precision
def mix(matrix, image: torch.Tensor, *, offset: tuple[float, ...] | None = None) -> torch.Tensor:
    """Return the matrix (a tensor, or :func:`rows` of an array) times the channels of pictures, in their precision.

    An offset is added to each channel.
    """
    flat = image.flatten(-2)
    if isinstance(matrix, torch.Tensor):
        mixed = matrix.to(image) @ flat
    else:
        mixed = constant(matrix, image.dtype, image.device) @ flat
    if offset is not None:
        mixed = mixed.add_(constant(offset, image.dtype, image.device)[:, None])
    return mixed.unflatten(-1, image.shape[-2:])


def constant(entries: tuple, dtype: torch.dtype, device: torch.device) -> torch.Tensor:
    """Return nested tuples as a tensor, made once for each precision and device."""
    build = _constant.__wrapped__ if torch.compiler.is_compiling() else _constant
    return build(entries, dtype, device)


def in_float64(values: torch.Tensor) -> torch.Tensor:
    """Return values in float64 where the device has it."""
    return values if values.device.type == "mps" else values.double()


@functools.lru_cache(maxsize=256)
def _constant(matrix, dtype, device):
    # A tensor born in inference mode could not be used for gradients later.
    with torch.inference_mode(False):
        return torch.tensor(matrix, dtype=dtype, device=device)


def _checked_space(primaries, white):
    if not isinstance(primaries, Iterable) or isinstance(primaries, str):
        raise TypeError(f"primaries must be three pairs (x, y), got {type(primaries).__name__}")
    pairs = tuple(tuple(_validate.numbers(_validate.real("primaries", pair))) for pair in primaries)
    if len(pairs) != 3 or any(len(pair) != 2 or pair[1] <= 0 for pair in pairs):
        raise ValueError(f"primaries must be three pairs (x, y) with y > 0, got {primaries!r}")
    levels = tuple(_validate.numbers(_validate.real("white", white, positive=True)))
    if len(levels) != 3:
        raise ValueError(f"white must be three numbers X, Y, Z, got {white!r}")
    return pairs, levels


# Values that one thread takes at a time: a few such blocks fit a core's cache, and a call costs little beside them.
BLOCK = 1 << 17

Gradient = Callable[[torch.Tensor, torch.Tensor, torch.Tensor], torch.Tensor]


def by_pixels(
    function: Callable[[torch.Tensor], torch.Tensor], image: torch.Tensor, gradient: Gradient
) -> torch.Tensor:
    """Apply a function of single pixels to pictures, in blocks whose intermediate results stay in the cache of a CPU.

    Parameters
    ----------
    function : callable
        Maps pixels ``[..., C, n]`` to ``[..., C', n]``. It must not depend on other tensors that require a gradient.
    image : torch.Tensor
        ``[..., C, H, W]``.
    gradient : callable
        Maps pixels, the values of the function and the gradient with respect to these to the gradient with respect to
        the pixels.

    Returns
    -------
    torch.Tensor
        ``[..., C', H, W]``; differentiable as often as the function is.
    """
    size = image.shape[-2:]
    if not image.numel() or not is_plain(image):
        return function(image.flatten(-2)).unflatten(-1, size)
    result = _Blocks.apply(image.reshape(-1, image.shape[-3], size.numel()), function, gradient)
    return result.reshape(*image.shape[:-3], -1, *size)


def by_values(
    function: Callable[[torch.Tensor], torch.Tensor], values: torch.Tensor, gradient: Gradient
) -> torch.Tensor:
    """Apply a function of single numbers to a tensor of any shape; otherwise as :func:`by_pixels`."""
    if not values.numel() or not is_plain(values):
        return function(values)
    return by_pixels(function, values.reshape(1, 1, -1), gradient).reshape(values.shape)


def is_plain(image: torch.Tensor) -> bool:
    """Return whether a tensor is on a CPU, without a transform, forward-mode derivative or compiler."""
    if image.device.type != "cpu" or _torch_private.is_transformed():
        return False
    # Not the image alone: tensors beside one that is vmapped take part in the same operations.
    return not _torch_private.in_functional_transform()


class _Blocks(torch.autograd.Function):
    @staticmethod
    def forward(context, flat, function, gradient):
        context.function, context.gradient = function, gradient
        saved, flat, result = flat, flat.detach(), None
        for index, place in _places(flat):
            block = function(flat[index, :, place])
            if result is None:
                result = block.new_empty(len(flat), len(block), flat.shape[-1])
            result[index, :, place] = block
        context.save_for_backward(saved, result)
        return result

    @staticmethod
    def backward(context, outer):
        flat, value = context.saved_tensors
        if torch.is_grad_enabled():
            # Derivatives of the gradient are wanted.
            return torch.autograd.grad(context.function(flat), flat, outer, create_graph=True)[0], None, None
        result = torch.empty_like(flat)
        for index, place in _places(flat):
            block = context.gradient(flat[index, :, place], value[index, :, place], outer[index, :, place])
            result[index, :, place] = block
        return result, None, None


def _places(flat):
    """Return the index and the slice of pixels of each block."""
    count, step = flat.shape[-1], max(1, BLOCK * torch.get_num_threads() // flat.shape[1])
    return [(index, slice(start, start + step)) for index in range(len(flat)) for start in range(0, count, step)]
