"""Images and tensors in files, for PyTorch."""

import os
from typing import Any

import numpy as np
import torch

from odak import _validate
from odak.learn._tensors import checked_device
from odak.learn.tools.checkpoints import read_torch_file
from odak.tools import images
from odak.tools.paths import replacing, validate_path

_MODES = ("nearest", "bilinear", "bicubic", "area")
_TENSOR_EXTENSIONS = (".pt", ".pth", ".pkl")


def resize(image: torch.Tensor, multiplier: float = 0.5, mode: str = "nearest") -> torch.Tensor:
    """Scale an image.

    Parameters
    ----------
    image : torch.Tensor
        ``[H, W]``, ``[C, H, W]``, ``[N, C, H, W]``, or with the channels last when there are 3 or 4 of them and the
        channel axis of the other layout has another length than 1, 3 or 4.
    multiplier : float
        Factor for the height and the width.
    mode : {"nearest", "bilinear", "bicubic", "area"}
        Interpolation.

    Returns
    -------
    torch.Tensor
        The same layout and dtype, ``int(H·multiplier)`` by ``int(W·multiplier)``; a batch of one loses its batch axis.

    Raises
    ------
    TypeError
        If the image is not a real tensor.
    ValueError
        If the mode, the multiplier or the number of axes is not acceptable, or nothing would be left of the image.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.tools import resize
    >>> resize(torch.tensor([[0.0, 1.0], [2.0, 5.0]]), 0.5, "area").tolist()
    [[2.0]]
    """
    mode = _validate.one_of("mode", mode, _MODES)
    multiplier = _validate.constant("multiplier", multiplier, positive=True)
    if not isinstance(image, torch.Tensor) or image.is_complex():
        raise TypeError(f"image must be a real tensor, got {getattr(image, 'dtype', type(image).__name__)}")
    if image.ndim not in (2, 3, 4) or 0 in image.shape:
        raise ValueError(f"image must have 2, 3 or 4 axes, none empty; got {tuple(image.shape)}")
    last = image.ndim > 2 and image.shape[-1] in (3, 4) and image.shape[-3] not in (1, 3, 4)
    batch = image.movedim(-1, -3) if last else image
    batch = batch.reshape((1,) * (4 - batch.ndim) + batch.shape)
    if min(int(n * multiplier) for n in batch.shape[-2:]) < 1:
        raise ValueError(f"multiplier leaves nothing of an image of {tuple(batch.shape[-2:])}, got {multiplier}")
    result = _interpolate(batch, multiplier, mode)
    result = result[0, 0] if image.ndim == 2 else result[0] if len(result) == 1 else result
    return result.movedim(-3, -1) if last else result


def load_image(fn: str | os.PathLike, normalizeby: float | None = None, torch_style: bool = False) -> torch.Tensor:
    """Read an image from a file; see :func:`odak.tools.file.load_image` for the formats.

    Parameters
    ----------
    fn : str or os.PathLike
        File to read.
    normalizeby : float, optional
        Divide by this unless it is zero. By default the file's own white level, 255 or 65535, so that white is 1.
    torch_style : bool
        Put the channels first.

    Returns
    -------
    torch.Tensor
        float32 ``[H, W]`` for grey, ``[H, W, C]`` or ``[C, H, W]`` for colour.

    Raises
    ------
    ValueError
        If the path is not acceptable, or the file is missing, broken, not an image, or has more than 89 megapixels.

    Examples
    --------
    >>> import os, tempfile
    >>> import torch
    >>> from odak.learn.tools import load_image, save_image
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     name = os.path.join(folder, "grey.png")
    ...     saved = save_image(name, torch.tensor([[0.0, 0.2, 1.0]]))
    ...     image = load_image(name)
    >>> [round(value, 6) for value in image[0].tolist()]
    [0.0, 0.2, 1.0]
    """
    levels = images.read_levels(fn, torch_style)
    divisor = images.white_level(levels) if normalizeby is None else _validate.constant("normalizeby", normalizeby)
    image = torch.from_numpy(levels.astype("float32"))
    return image if divisor in (0, 1) else image.div_(divisor)


def save_image(
    fn: str | os.PathLike,
    img: torch.Tensor,
    cmin: float = 0.0,
    cmax: float | None = None,
    color_depth: int = 8,
) -> bool:
    """Write a tensor to an image file, `cmin` as black and `cmax` as white.

    Parameters
    ----------
    fn : str or os.PathLike
        File to write; see :func:`odak.tools.file.save_image`.
    img : torch.Tensor
        ``[H, W]``, ``[H, W, C]``, or ``[C, H, W]`` when the first axis is 1, 3 or 4 long and the last is not; a batch
        of one of these. ``[H]`` is a single column.
    cmin : float
        Value of black.
    cmax : float, optional
        Value of white. By default 1, or 255 when the image holds integers or exceeds 1, or 65535 when it exceeds 255
        as well and is saved with 16 bits.
    color_depth : {8, 16}
        Bits per channel.

    Returns
    -------
    bool
        True.

    Raises
    ------
    TypeError
        If the image does not hold real numbers.
    ValueError
        If the shape, the limits, the depth or the path is not acceptable, or the file cannot be written.

    Examples
    --------
    >>> import os, tempfile
    >>> import torch
    >>> from odak.learn.tools import load_image, save_image
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     name = os.path.join(folder, "grey.png")
    ...     saved = save_image(name, torch.tensor([[0.0, 0.2, 1.0]]))
    ...     image = load_image(name)
    >>> [round(value, 6) for value in image[0].tolist()]
    [0.0, 0.2, 1.0]
    """
    image = _as_array(img)
    if image.ndim == 4:
        if len(image) != 1:
            raise ValueError(f"img must be one image, got a batch of {len(image)}; save them one by one")
        image = image[0]
    if image.ndim == 3 and image.shape[0] in (1, 3, 4) and image.shape[-1] not in (1, 3, 4):
        image = np.moveaxis(image, 0, -1)
    white = _white_of(image, color_depth) if cmax is None else cmax
    return images.save_image(fn, image, cmin, white, color_depth)


def save_torch_tensor(fn: str | os.PathLike, tensor: Any) -> None:
    """Write a tensor, or whatever :func:`torch.save` takes, to a file.

    Parameters
    ----------
    fn : str or os.PathLike
        A ``.pt``, ``.pth`` or ``.pkl`` file; an older one stays as it was until the new one is complete.
    tensor : torch.Tensor
        What to write.

    Raises
    ------
    ValueError
        If the path is not acceptable or its folder does not exist.

    Examples
    --------
    >>> import os, tempfile
    >>> import torch
    >>> from odak.learn.tools import save_torch_tensor, torch_load
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     name = os.path.join(folder, "tensor.pt")
    ...     save_torch_tensor(name, torch.tensor([1.0, 2.0]))
    ...     torch_load(name).tolist()
    [1.0, 2.0]
    """
    path = validate_path(fn, _TENSOR_EXTENSIONS)
    with replacing(path) as stream:
        torch.save(tensor, stream)


def torch_load(fn: str | os.PathLike, weights_only: bool = True, map_location: torch.device | str | None = None) -> Any:
    """Read what :func:`save_torch_tensor` wrote.

    Parameters
    ----------
    fn : str or os.PathLike
        A ``.pt``, ``.pth`` or ``.pkl`` file.
    weights_only : bool
        Refuse a file that would run code. Pass False only for files that you trust.
    map_location : torch.device or str, optional
        Device to put tensors on.

    Returns
    -------
    torch.Tensor
        What the file holds.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If the path is not acceptable, or the file would run code, is broken, not one of torch's, or would take far more
        memory than its size; the message names the file. What is wrong with the file is a pickle.UnpicklingError too.

    Examples
    --------
    >>> import os, tempfile
    >>> import torch
    >>> from odak.learn.tools import save_torch_tensor, torch_load
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     name = os.path.join(folder, "tensor.pt")
    ...     save_torch_tensor(name, torch.tensor([1.0, 2.0]))
    ...     torch_load(name).tolist()
    [1.0, 2.0]
    """
    path = validate_path(fn, _TENSOR_EXTENSIONS)
    if isinstance(map_location, (str, int)):
        map_location = checked_device("map_location", map_location)
    elif map_location is not None and not isinstance(map_location, (torch.device, dict)) and not callable(map_location):
        raise TypeError(f"map_location must be a torch.device or its name, got {type(map_location).__name__}")
    if _validate.flag("weights_only", weights_only):
        return read_torch_file(path, map_location)
    try:
        return torch.load(path, weights_only=False, map_location=map_location)
    except (EOFError, RuntimeError) as error:
        raise ValueError(f"Failed to load {path!r}: {error}") from error


def _interpolate(batch, multiplier, mode):
    working = batch if batch.is_floating_point() else batch.to(torch.float32)
    result = torch.nn.functional.interpolate(working, scale_factor=multiplier, mode=mode)
    if batch.is_floating_point():
        return result
    if batch.dtype == torch.bool:
        return result > 0.5
    limits = torch.iinfo(batch.dtype)
    return result.round().clamp(limits.min, limits.max).to(batch.dtype)


def _as_array(img):
    if isinstance(img, torch.Tensor):
        img = img.detach().cpu().resolve_neg()
        img = img.float() if img.dtype == torch.bfloat16 else img
    image = np.asarray(img)
    if image.dtype.kind == "c":
        raise TypeError(f"img must be real, got {image.dtype}; save its magnitude or its phase")
    return image


def _white_of(image, color_depth):
    """Guess the value of white where the caller names none."""
    if color_depth == 16 and (image > 255).any():
        return 65535.0
    return 255.0 if image.dtype.kind in "iu" or (image > 1).any() else 1.0
