"""Argument checks that need torch: each names the argument, what came and what is accepted."""

import functools
from typing import overload

import torch

from odak import _validate


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
        Where the result lives.
    """
    if isinstance(value, torch.Tensor):
        if value.is_complex() and dtype is not None and not dtype.is_complex:
            raise TypeError(f"{name} must be real, got a tensor of {value.dtype}")
        return value if dtype is device is None else value.to(device=device, dtype=dtype)
    try:
        return torch.as_tensor(value, dtype=dtype, device=device)
    except (TypeError, ValueError, RuntimeError) as error:
        raise TypeError(f"{name} must be a tensor or numbers, got {value!r:.80}") from error


def floating(name: str, value, dtype: torch.dtype | None = None) -> torch.Tensor:
    """Return `value` as a real floating tensor; of torch's default precision, or `dtype`, if it is not one yet."""
    if isinstance(value, torch.Tensor) and value.is_floating_point():
        return value
    return tensor(name, value, torch.get_default_dtype() if dtype is None else dtype)


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
    """Return a device after checking that torch knows its name; None stays None."""
    if value is None or isinstance(value, torch.device):
        return value
    try:
        return torch.device(value)
    except (TypeError, RuntimeError) as error:
        raise ValueError(
            f"{name} must be a torch.device or its name, such as 'cpu' or 'cuda:0'; got {value!r}"
        ) from error


def checked_dtype(name: str, value) -> torch.dtype:
    """Return a real floating dtype."""
    if not isinstance(value, torch.dtype) or not value.is_floating_point:
        raise TypeError(f"{name} must be a real floating torch.dtype such as torch.float32, got {value!r:.80}")
    return value


def checked_generator(name: str, value) -> torch.Generator | None:
    """Return torch's generator of random numbers; None stands for torch's own."""
    if value is None or isinstance(value, torch.Generator):
        return value
    raise TypeError(f"{name} must be a torch.Generator or None, got {value!r:.80}")


def shaped(name: str, value, *shape: int | str) -> torch.Tensor:
    """Return `value` as a real floating tensor after checking its shape, in which a letter stands for any length.

    A length that several arguments share has to be checked by the caller.
    """
    value = floating(name, value)
    fits = value.ndim == len(shape) and all(
        isinstance(wanted, str) or have == wanted for have, wanted in zip(value.shape, shape, strict=True)
    )
    if not fits:
        raise ValueError(f"{name} must be [{', '.join(map(str, shape))}], got {list(value.shape)}")
    return value


def rows_of(**given: tuple) -> list[torch.Tensor]:
    """Return real tensors that have a row for each of the same things, in their widest precision, float32 at least.

    Parameters
    ----------
    **given : tuple
        By name, a tensor and the shape of a row, in which a letter stands for any length.
    """
    values = [shaped(name, value, "N", *row) for name, (value, *row) in given.items()]
    if len({len(value) for value in values}) > 1:
        told = ", ".join(f"{name} {len(value)}" for name, value in zip(given, values, strict=True))
        raise ValueError(f"these must have as many rows as each other: {told}")
    _validate.one_device(**dict(zip(given, values, strict=True)))
    dtype = functools.reduce(torch.promote_types, (value.dtype for value in values), torch.float32)
    return [value.resolve_neg().to(dtype) for value in values]
