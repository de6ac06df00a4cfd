"""Images and tensors in files for PyTorch, and checks of untrusted files of torch.save."""

import mmap
import os
import pickle
import re
import zipfile
from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
import torch

from odak import _torch_private, _validate
from odak.learn._tensors import checked_device, real_tensor
from odak.tools import file
from odak.tools.paths import regular_file, replacing, validate_path

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
    real_tensor("image", image)
    _validate.shaped("image", image, "[H, W], [C, H, W] or [B, C, H, W], none empty")
    last = image.ndim > 2 and image.shape[-1] in (3, 4) and image.shape[-3] not in (1, 3, 4)
    batch = image.movedim(-1, -3) if last else image
    batch = batch.reshape((1,) * (4 - batch.ndim) + batch.shape)
    if min(int(n * multiplier) for n in batch.shape[-2:]) < 1:
        raise ValueError(f"multiplier leaves nothing of an image of {tuple(batch.shape[-2:])}, got {multiplier}")
    result = _interpolate(batch, multiplier, mode)
    result = result[0, 0] if image.ndim == 2 else result[0] if len(result) == 1 else result
    return result.movedim(-3, -1) if last else result


def load_image(
    fn: str | os.PathLike[str],
    normalizeby: float | None = None,
    torch_style: bool = False,
    *,
    color_managed: bool = False,
    pages: int | Sequence[int] | Literal["all"] | None = None,
) -> torch.Tensor:
    """Read an image from a file; see :func:`odak.tools.file.load_image` for the formats.

    Parameters
    ----------
    fn : str or os.PathLike
        File to read.
    normalizeby : float, optional
        Divide by this unless it is zero. By default the file's own white level, 255 or 65535, so that white is 1.
    torch_style : bool
        Put the channels first.
    color_managed : bool
        Convert colours by the file's ICC profile to sRGB, as :func:`odak.tools.load_image` does.
    pages : int, sequence of int or "all", optional
        Pages or frames, as :func:`odak.tools.load_image` takes them; by default the first, with a warning of others.

    Returns
    -------
    torch.Tensor
        float32 ``[H, W]`` for grey, ``[H, W, C]`` or ``[C, H, W]`` for colour; a first axis for several pages.

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
    levels = file.read_levels(fn, torch_style, color_managed, pages)
    divisor = file.white_level(levels) if normalizeby is None else _validate.constant("normalizeby", normalizeby)
    image = torch.from_numpy(levels.astype("float32"))
    return image if divisor in (0, 1) else image.div_(divisor)


def save_image(
    fn: str | os.PathLike[str],
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
        as well and is saved with 16 bits. An :class:`~odak.ArgumentWarning` says where 255 leaves it nearly black,
        or nearly white.
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
    cmin, cmax = _validate.constants(cmin=cmin, cmax=cmax)
    image = _as_array(img)
    if image.ndim == 4:
        if len(image) != 1:
            raise ValueError(f"img must be one image, got a batch of {len(image)}; save them one by one")
        image = image[0]
    if image.ndim == 3 and image.shape[0] in (1, 3, 4) and image.shape[-1] not in (1, 3, 4):
        image = np.moveaxis(image, 0, -1)
    white = _white_of(image, color_depth) if cmax is None else cmax
    return file.save_image(fn, image, cmin, white, color_depth)


def save_torch_tensor(fn: str | os.PathLike[str], tensor: object) -> None:
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


def torch_load(
    fn: str | os.PathLike[str], weights_only: bool = True, map_location: torch.device | str | None = None
) -> Any:
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
    with _validate.refusing(f"Failed to load {path!r}: ", EOFError, RuntimeError):
        return torch.load(path, weights_only=False, map_location=map_location)


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
    if image.dtype.kind not in "iu" and not (image > 1).any():
        return 1.0
    file.check_levels(image, 255.0)
    return 255.0


# Called with a number, as a file can request, it allocates so many bytes, independently of the size of the file.
_INFLATES = b"bytearray\n"
# Entries of lists and dictionaries, shared ones counted each time, allowed in any file; more only one for each byte.
_LEAST_LIMIT = 1_000_000


class UnsafeFileError(pickle.UnpicklingError, ValueError):
    """The file would run code, takes far more memory than its size, or is not one of torch."""


def read_torch_file(path: str | os.PathLike[str], device: torch.device | str | None = None) -> Any:
    """Return the content of a file of :func:`torch.save`, without running code.

    The length of a tensor comes from the file's pickle and its bytes from another record, which not every release of
    torch compares. So the file is first mapped into memory, and its tensors laid over that.

    Parameters
    ----------
    path : str or os.PathLike
        The file.
    device : torch.device or str, optional
        Where tensors go; by default where they were.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    UnsafeFileError
        If the file would run code, is broken, or would take far more memory than its size; a ValueError too.
    """
    name = os.fspath(path)
    try:
        if _check(name):
            # Mapped memory cannot grow: a tensor that claims more than there is, is refused before anything is read.
            torch.load(name, map_location=lambda storage, _: storage, weights_only=True, mmap=True)
        # Indices beyond a sparse tensor's size would be followed into other memory when it is used.
        with torch.sparse.check_sparse_tensor_invariants():
            found = torch.load(name, map_location=device, weights_only=True)
        limit = max(_LEAST_LIMIT, os.path.getsize(name))
        _refuse_odd_content(found, limit, meta=device is not None and torch.device(device).type == "meta")
        return found
    except (FileNotFoundError, IsADirectoryError, PermissionError):
        raise
    except Exception as error:
        # The unpickler and the archive reader raise what they stumble on: IndexError, KeyError, struct.error …
        raise UnsafeFileError(f"Failed to load {name!r}: {_reason(error)}") from error


def _reason(error: Exception) -> str:
    """Return one line; torch's own begins with how to run the code in the file."""
    found = re.search(r"GLOBAL (\S+\.\S+)", str(error))
    if found:
        return f"it calls for {found[1]}, and no code of a file is run"
    if isinstance(error, pickle.UnpicklingError):
        return "it is not one of torch's, or its pickle is broken"
    return first_line(error)


def _refuse_odd_content(value, limit: int, meta: bool) -> None:
    """Raise ValueError for what no walk would finish and for tensors that are not plain ones, each looked at once.

    Parameters
    ----------
    value : object
        Content of the file.
    limit : int
        Largest number of entries that whoever walks the lists and dictionaries may meet: shared ones count each time.
    meta : bool
        Accept tensors without data, because the caller requested the device "meta".
    """
    entries: dict[int, int] = {}  # of each list met so far; 0 while its own entries are looked at
    waiting = [value]
    while waiting:
        value = waiting[-1]
        if isinstance(value, torch.Tensor):
            _refuse_odd_tensor(value, meta)
        inner = [*value.keys(), *value.values()] if isinstance(value, dict) else value
        if not isinstance(inner, (list, tuple, set, frozenset)):
            waiting.pop()
            continue
        lists = [item for item in inner if isinstance(item, (dict, list, tuple, set, frozenset))]
        if id(value) not in entries:
            entries[id(value)] = 0
            waiting += [item for item in inner if id(item) not in entries]
            if any(entries.get(id(item)) == 0 for item in lists):
                raise ValueError("it contains a list that contains itself")
            continue
        waiting.pop()
        if entries[id(value)] == 0:
            entries[id(value)] = 1 + len(inner) + sum(entries[id(item)] for item in lists)
            if entries[id(value)] > limit:
                raise ValueError("its lists share one another, so that walking through them would take for ever")


def _refuse_odd_tensor(tensor: torch.Tensor, meta: bool) -> None:
    """Raise ValueError for a tensor with code to call with its gradient, or more elements than it has memory."""
    if _torch_private.has_hooks(tensor):
        raise ValueError("it contains a tensor with hooks")
    if tensor.is_nested or tensor.is_quantized:
        raise ValueError("it contains a nested or a quantized tensor; store plain ones")
    if any(n < 0 for n in tensor.shape):
        raise ValueError(f"it contains a tensor of shape {list(tensor.shape)}")
    if tensor.is_meta and not meta:
        raise ValueError("it contains a tensor without data (of the device 'meta')")
    if tensor.layout == torch.sparse_coo:
        parts = _torch_private.entries_of_sparse(tensor)
    elif tensor.layout in (torch.sparse_csr, torch.sparse_bsr):
        parts = [tensor.crow_indices(), tensor.col_indices(), tensor.values()]
    elif tensor.layout in (torch.sparse_csc, torch.sparse_bsc):
        parts = [tensor.ccol_indices(), tensor.row_indices(), tensor.values()]
    else:
        parts = [tensor]
    for part in parts:
        if part.numel() * part.element_size() > part.untyped_storage().nbytes():
            raise ValueError(
                f"it contains a tensor of shape {list(part.shape)}, longer than its data; store a copy of it"
            )


def _check(name: str) -> bool:
    """Return whether a file is an archive; raise an error if loading it would take far more memory than its size."""
    with open(regular_file(name), "rb") as stream:
        if stream.read(4) != b"PK\x03\x04":
            if os.path.getsize(name):
                with mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as content:
                    _refuse_inflation(content)
            return False
    with zipfile.ZipFile(name) as archive:
        records = archive.infolist()
        if any(record.compress_type != zipfile.ZIP_STORED for record in records):
            raise ValueError("its records are compressed, and torch writes none that are")
        if sum(record.file_size for record in records) > os.path.getsize(name):
            raise ValueError("its records claim more bytes than the file has")
        for record in records:
            if record.filename.endswith("data.pkl"):
                _refuse_inflation(archive.read(record))
    return True


def _refuse_inflation(content) -> None:
    if content.find(_INFLATES) >= 0:
        raise ValueError("it contains a bytearray; store bytes as a tensor of torch.uint8")


def first_line(error: Exception) -> str:
    """Return the first line of an error, or its type if the message is empty."""
    return (str(error) or type(error).__name__).splitlines()[0]
