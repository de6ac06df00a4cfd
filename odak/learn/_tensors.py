"""Conversion of arguments to tensors; devices, dtypes, generators and pictures; precision under autocast."""

import difflib
import functools
import inspect
from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import Any, ParamSpec, TypeVar, overload

import numpy as np
import torch

from odak import _array, _validate
from odak._torch_private import count_of_writes, is_wrapped
from odak._warnings import DeviceWarning, warn

# Values should lie in 0 … 1; optimizers and speckle may exceed it slightly, 8-bit values are an error.
FARTHEST = 100.0


def tensor(name: str, value, dtype: torch.dtype | None = None, device: torch.device | None = None) -> torch.Tensor:
    """Return `value` as a tensor; numbers, lists of them and NumPy's arrays are converted.

    Parameters
    ----------
    name : str
        The argument's name.
    value : torch.Tensor, array, number or nested sequence of numbers
        What came.
    dtype : torch.dtype, optional
        Precision of the result; complex numbers are refused where it is a real one.
    device : torch.device, optional
        Device of the result.
    """
    if isinstance(value, torch.Tensor):
        if value.is_complex() and dtype is not None and not dtype.is_complex:
            raise TypeError(f"{name} must be real, got a tensor of {value.dtype}")
        return value if dtype is device is None else value.to(device=device, dtype=dtype)
    if isinstance(value, np.ndarray) and (not value.flags.writeable or any(step < 0 for step in value.strides)):
        value = value.copy()  # torch takes the memory of neither
    try:
        return torch.as_tensor(value, dtype=dtype, device=device)
    except (TypeError, ValueError, RuntimeError) as error:
        raise TypeError(f"{name} must be a tensor or numbers, got {value!r:.80}") from error


def floating(name: str, value, dtype: torch.dtype | None = None) -> torch.Tensor:
    """Return `value` as a real floating tensor; of torch's default precision, or `dtype`, if it is not one yet."""
    if isinstance(value, torch.Tensor) and value.is_floating_point():
        return value
    return tensor(name, value, torch.get_default_dtype() if dtype is None else dtype)


def tensors_of(**values) -> list[torch.Tensor]:
    """Return tensors of one device and one precision; numbers, lists and NumPy's arrays are converted.

    Parameters
    ----------
    **values : torch.Tensor, array, number or nested sequence of numbers
        By argument. The first tensor among them sets the device, the widest floating tensor the precision; torch's
        defaults are used where there is none. Complex values stay complex. Numbers must be finite; arrays and nested
        lists may hold NaN: rays that missed something.
    """
    values = {name: _stacked(value) for name, value in values.items()}
    given = [value for value in values.values() if isinstance(value, torch.Tensor)]
    kinds = [value.dtype.to_real() for value in given if value.is_floating_point() or value.is_complex()]
    dtype = functools.reduce(torch.promote_types, kinds) if kinds else torch.get_default_dtype()
    device = given[0].device if given else None
    made = [_read(name, value) for name, value in values.items()]
    return [value.to(device=device, dtype=dtype.to_complex() if value.is_complex() else dtype) for value in made]


def reals_of(**values) -> list[torch.Tensor]:
    """Return the tensors of :func:`tensors_of`, after checking that they are real."""
    made = tensors_of(**values)
    for name, value in zip(values, made, strict=True):
        if value.is_complex():
            raise TypeError(f"{name} must be real numbers, got {value.dtype}")
    return made


def _stacked(value):
    """Return a list in which there are tensors as one tensor."""
    if not isinstance(value, (list, tuple)) or not any(isinstance(v, torch.Tensor) for v in value):
        return value
    return torch.stack([v if isinstance(v, torch.Tensor) else torch.tensor(v, dtype=torch.float64) for v in value])


def _read(name: str, value) -> torch.Tensor:
    if _array.is_array(value):
        made = tensor(name, value)
        if made.dtype == torch.bool:
            raise TypeError(f"{name} must be real numbers, got {made.dtype}")
        return made
    value = _validate.given(name, value, rows=True)
    if _array.is_array(value):
        return tensor(name, value)
    # In double precision, which holds all digits of a number.
    return torch.tensor(value, dtype=torch.complex128 if isinstance(value, complex) else torch.float64)


def trainable(value: torch.Tensor) -> torch.Tensor:
    """Return a tensor that autograd may save: a copy of one that was made in inference mode."""
    if torch.compiler.is_compiling():
        return value
    copied = torch.is_grad_enabled() and not torch.is_inference_mode_enabled() and value.is_inference()
    return value.clone() if copied else value


@overload
def checked_device(name: str, value: torch.device | str | int) -> torch.device: ...


@overload
def checked_device(name: str, value: None) -> None: ...


def checked_device(name: str, value) -> torch.device | None:
    """Return a device after checking its name, and that there is one of its number; None stays None."""
    if value is None:
        return value
    try:
        device = torch.device(value)
    except (TypeError, RuntimeError) as error:
        raise ValueError(
            f"{name} must be a torch.device or its name, such as 'cpu' or 'cuda:0'; got {value!r}"
        ) from error
    # Torch says so where memory is asked for, which is elsewhere.
    if device.type == "cuda" and (device.index or 0) >= (there := torch.cuda.device_count()):
        raise ValueError(f"{name} must be on this machine, where torch finds {there} of CUDA; got {value!r}")
    return device


def kind_of(value) -> str:
    """Return what was given in place of a tensor of a wanted dtype: the dtype of a tensor, or the name of a type."""
    return str(value.dtype) if isinstance(value, torch.Tensor) else type(value).__name__


def floating_tensor(name: str, value, accepted: str = "a tensor of real floats") -> torch.Tensor:
    """Return a tensor after checking that it is one of real floats."""
    if not isinstance(value, torch.Tensor) or not value.is_floating_point():
        raise TypeError(f"{name} must be {accepted}, got {kind_of(value)}")
    return value


def real_tensor(name: str, value, accepted: str = "a real tensor") -> torch.Tensor:
    """Return a tensor after checking that it is one and not complex."""
    if not isinstance(value, torch.Tensor) or value.is_complex():
        raise TypeError(f"{name} must be {accepted}, got {kind_of(value)}")
    return value


def complex_tensor(name: str, value, accepted: str = "a complex tensor") -> torch.Tensor:
    """Return a tensor after checking that it is a complex one."""
    if not isinstance(value, torch.Tensor) or not value.is_complex():
        raise TypeError(f"{name} must be {accepted}, got {kind_of(value)}")
    return value


def checked_dtype(name: str, value) -> torch.dtype:
    """Return a real floating dtype."""
    if not isinstance(value, torch.dtype) or not value.is_floating_point:
        raise TypeError(f"{name} must be a real floating torch.dtype such as torch.float32, got {value!r:.80}")
    return value


def checked_generator(name: str, value) -> torch.Generator | None:
    """Return a generator of random numbers of torch; None means the default one."""
    if value is None or isinstance(value, torch.Generator):
        return value
    raise TypeError(f"{name} must be a torch.Generator or None, got {value!r:.80}")


def shaped(name: str, value, accepted: str) -> torch.Tensor:
    """Return `value` as a real floating tensor after checking its shape against the words of the message."""
    return _validate.shaped(name, floating(name, value), accepted)


def rows_of(**given: tuple[Any, str]) -> list[torch.Tensor]:
    """Return real tensors that have a row for each of the same things, in their widest precision, float32 at least.

    Parameters
    ----------
    **given : tuple
        By name, a tensor and its shape in words, such as ``"[N, 3]"``.
    """
    values = [shaped(name, value, accepted) for name, (value, accepted) in given.items()]
    if len({len(value) for value in values}) > 1:
        told = ", ".join(f"{name} {len(value)}" for name, value in zip(given, values, strict=True))
        raise ValueError(f"these must have the same number of rows: {told}")
    _validate.one_device(**dict(zip(given, values, strict=True)))
    dtype = functools.reduce(torch.promote_types, (value.dtype for value in values), torch.float32)
    return [value.resolve_neg().to(dtype) for value in values]


def check_loss_inputs(loss_name: str, image: torch.Tensor, target: torch.Tensor) -> None:
    """Raise ValueError unless two images can be compared.

    Parameters
    ----------
    loss_name : str
        Name of the loss, with which the message begins.
    image : torch.Tensor
        ``[B, C, H, W]``, one or three channels.
    target : torch.Tensor
        Image of the same shape.

    Raises
    ------
    ValueError, TypeError
        If the sizes differ, there are not four axes, not one or three channels, or no pixels.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.perception import check_loss_inputs
    >>> check_loss_inputs("loss", torch.zeros(1, 3, 8, 8), torch.zeros(1, 3, 8, 8))
    >>> try:
    ...     check_loss_inputs("loss", torch.zeros(1, 3, 8, 8), torch.zeros(1, 3, 8, 9))
    ... except ValueError:
    ...     print("of two sizes")
    of two sizes
    """
    if not isinstance(loss_name, str):
        raise TypeError(f"loss_name must be a string, got {type(loss_name).__name__}")
    for name, picture in (("image", image), ("target", target)):
        if not isinstance(picture, torch.Tensor):
            raise TypeError(f"{loss_name} ERROR: {name} must be a tensor, got {type(picture).__name__}")
    alike = image.shape == target.shape and image.device == target.device
    if alike and image.ndim == 4 and image.shape[1] in (1, 3) and 0 not in image.shape:
        return
    shapes = f"got {tuple(image.shape)} and {tuple(target.shape)}"
    order = _validate.in_order("image", image.shape)
    if image.shape != target.shape:
        raise ValueError(f"{loss_name} ERROR: image and target must have one size, {shapes}")
    if image.ndim != 4:
        raise ValueError(f"{loss_name} ERROR: image and target must have four axes [B, C, H, W], {shapes}")
    if image.shape[1] not in (1, 3):
        raise ValueError(f"{loss_name} ERROR: image and target must have one or three channels, {order}")
    if not image.numel():
        raise ValueError(f"{loss_name} ERROR: image and target must not be empty, {shapes}")
    _validate.one_device(image=image, target=target)


def check_values(peak: float = 1.0, **pictures: torch.Tensor) -> None:
    """Raise ValueError if a picture holds NaN, infinities or values far outside 0 … peak.

    Parameters
    ----------
    peak : float
        Largest value that a picture should have.
    **pictures : torch.Tensor
        Pictures by the names that a message gives them. Values on a GPU, or held by a transform, are not read.

    Raises
    ------
    ValueError, TypeError
        If a value is not finite, or beyond ±100 times the peak; or the peak is not positive.
    """
    _validate.number("peak", peak, positive=True)
    for name, picture in pictures.items():
        check_range(name, picture, peak)


def check_range(name: str, picture: torch.Tensor, peak: float = 1.0, remedy: str | None = None) -> None:
    """Raise as :func:`check_values` does for one picture; with a remedy, warn of one of 0 … 255 too."""
    if picture.is_complex():
        raise TypeError(f"{name} must be real, got {picture.dtype}")
    if not picture.numel() or not _array.is_readable(picture):
        return
    least, most = torch.aminmax(picture.detach())
    low, high = float(least), float(most)
    if not (low >= -FARTHEST * peak and high <= FARTHEST * peak):
        raise ValueError(f"{name} must hold finite values of about 0 to {peak:g}, got {low:.4g} to {high:.4g}")
    if remedy is not None:
        _validate.check_white(name, max(high, -low), peak, remedy)


def checked_pair(
    predictions: torch.Tensor, targets: torch.Tensor, peak: float = 1.0
) -> tuple[torch.Tensor, torch.Tensor]:
    """Return two pictures in one precision after checking that they are real floats of one shape, about 0 … peak.

    Parameters
    ----------
    predictions, targets : torch.Tensor
        Pictures of any shape.
    peak : float
        Largest value that a picture should have.

    Returns
    -------
    tuple of torch.Tensor
        The pictures, both in the finer of the two precisions, float32 for half precision.

    Raises
    ------
    ValueError, TypeError
        If the shapes differ or are empty, either is not a tensor of real floats, or holds NaN or values far outside
        the range.
    """
    for name, value in (("predictions", predictions), ("targets", targets)):
        floating_tensor(name, value)
    _validate.alike(predictions=predictions, targets=targets)
    if not predictions.numel():
        raise ValueError(f"predictions and targets must not be empty, got {tuple(predictions.shape)}")
    check_values(peak, predictions=predictions, targets=targets)
    dtype = torch.promote_types(predictions.dtype, targets.dtype)
    return in_float32(predictions.to(dtype)), in_float32(targets.to(dtype))


def above_zero(value: torch.Tensor) -> torch.Tensor:
    """Return values of which negative ones are 0; the gradient is that of the values."""
    return value - value.detach().clamp_max(0)


def as_pictures(name: str, image: torch.Tensor, channels: int | None = 3) -> torch.Tensor:
    """Return real pictures ``[..., C, H, W]`` with at least four axes after checking them."""
    floating_tensor(name, image)
    if image.ndim < 3 or (channels is not None and image.shape[-3] != channels):
        wanted = "C" if channels is None else channels
        raise ValueError(f"{name} must be pictures [..., {wanted}, H, W], {_validate.in_order(name, image.shape)}")
    return image if image.ndim > 3 else image[None]


def tell_scale(name: str, values: torch.Tensor, remedy: str, white: float = 1.0) -> None:
    """Warn of NaN, and of values far above white, such as 0 … 255 where 1 is white; a GPU is not waited for."""
    if _array.is_readable(values) and values.numel():
        _validate.check_values(name, values, remedy, refuse=False, white=white)


def places_between(knots: torch.Tensor, values: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Return the rising knots below values, by index, and how far on to the next one the values lie, at most there."""
    values = values.clamp(knots[0], knots[-1])
    below = (torch.searchsorted(knots, values.detach().contiguous(), right=True) - 1).clamp(0, len(knots) - 2)
    return below, (values - knots[below]) / (knots[below + 1] - knots[below])


def weighted_channels(picture: torch.Tensor, weights: tuple[float, ...]) -> torch.Tensor:
    """Return the weighted sum of the channels of ``[..., C, H, W]``, ``[..., 1, H, W]``."""
    return sum(weight * one for weight, one in zip(weights, picture.split(1, -3), strict=True))


def in_float64(values: torch.Tensor) -> torch.Tensor:
    """Return values in float64 where the device has it."""
    return values if values.device.type == "mps" else values.double()


def in_float32(values: torch.Tensor) -> torch.Tensor:
    """Return values of half precision in float32, others as they are."""
    if values.dtype in (torch.float32, torch.float64):
        return values
    return values.to(torch.promote_types(values.dtype, torch.float32))


P = ParamSpec("P")
R = TypeVar("R")


def get_device(device: torch.device | str | None = "auto") -> torch.device:
    """Return a device to compute on.

    Parameters
    ----------
    device : torch.device or str, optional
        ``"auto"`` or None takes the GPU when CUDA finds one and the CPU otherwise. CUDA requested by name on a machine
        without it gives the CPU, with a warning.

    Returns
    -------
    torch.device
        The device.

    Warns
    -----
    DeviceWarning
        If CUDA is requested by name and is not available.

    Raises
    ------
    TypeError
        If `device` is neither a device nor a string.
    ValueError
        If there is no device of that name.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.tools import get_device
    >>> get_device("cpu")
    device(type='cpu')
    """
    if device is None or (isinstance(device, str) and device.strip().lower() == "auto"):
        return torch.device("cuda" if torch.cuda.is_available() else "cpu")
    _validate.instance("device", device, (torch.device, str), "a torch.device or a string")
    chosen = _parse(device)
    if chosen.type == "cuda" and not torch.cuda.is_available():
        warn(f"{chosen} was requested and there is no CUDA device: the CPU is used instead", DeviceWarning)
        return torch.device("cpu")
    return chosen


def _parse(device):
    try:
        return torch.device(device)
    except RuntimeError:
        near = difflib.get_close_matches(device.lower(), ("auto", "cpu", "cuda", "mps"), n=1)
        hint = f" Did you mean {near[0]!r}?" if near else ""
        raise ValueError(
            f"device must be 'auto', 'cpu', 'cuda', 'cuda:0' or another device of torch; got {device!r}.{hint}"
        ) from None


def advising_on_memory(advice: str) -> AbstractContextManager[None]:
    """Add a sentence of advice to the error that torch raises when a GPU has no memory left.

    Parameters
    ----------
    advice : str
        What takes less memory, such as "use fewer planes".

    Raises
    ------
    torch.OutOfMemoryError
        The same kind of error, torch's own text after the advice.
    """
    kind, told = torch.cuda.OutOfMemoryError, f"The memory of the GPU is not sufficient; {advice}. Message of torch: "
    return _validate.refusing(told, kind, raised=kind)


def takes_constants(*names: str) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Return a decorator by which named arguments carry no derivative, and report one that is required.

    It stands in front of decorators that change whether gradients are recorded.
    """

    def decorated(function: Callable[P, R]) -> Callable[P, R]:
        signature = inspect.signature(function)

        @functools.wraps(function)
        def run(*args: P.args, **options: P.kwargs) -> R:
            try:
                given = signature.bind(*args, **options)
            except TypeError:
                # The function's own error names what is missing.
                return function(*args, **options)
            numbers = {name: given.arguments[name] for name in names if name in given.arguments}
            given.arguments.update(zip(numbers, _validate.constants(**numbers), strict=True))
            return function(*given.args, **given.kwargs)

        return run

    return decorated


class ValuesRead:
    """What follows from the values of a tensor, read again only where it is another tensor or was written to.

    Parameters
    ----------
    read : callable
        ``read(tensor)``, which waits for the device.
    """

    def __init__(self, read: Callable[[torch.Tensor], Any]):
        self.read, self.result = read, None
        self.version: int | None = None
        self.tensor: torch.Tensor | None = None

    def __call__(self, tensor: torch.Tensor) -> Any:
        """Return what follows from a tensor; where it has no values to read, what was read last."""
        if torch.compiler.is_compiling() or is_wrapped(tensor):
            return self.result
        version = count_of_writes(tensor)
        if tensor is not self.tensor or version is None or version != self.version:
            self.tensor, self.version, self.result = tensor, version, self.read(tensor)
        return self.result

    def moved(self, tensor: torch.Tensor) -> None:
        """Take the same tensor on another device for read."""
        self.tensor, self.version = tensor, count_of_writes(tensor)
