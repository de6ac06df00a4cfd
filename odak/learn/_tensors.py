"""Conversion of arguments to tensors; checks of their devices, dtypes and generators; precision under autocast."""

import functools
from collections.abc import Callable
from contextlib import ExitStack
from typing import ParamSpec, TypeVar, overload

import numpy as np
import torch

from odak import _array, _validate


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
        By argument. The device is that of the first tensor among them, the precision the widest of the floating tensors
        among them; torch's defaults where there is none. Complex values stay complex. Numbers must be finite;
        arrays and nested lists may hold NaN: rays that missed something.
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
    """Return a device after checking its name; None stays None."""
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
    """Return a generator of random numbers of torch; None means the default one."""
    if value is None or isinstance(value, torch.Generator):
        return value
    raise TypeError(f"{name} must be a torch.Generator or None, got {value!r:.80}")


def shaped(name: str, value, *shape: int | str) -> torch.Tensor:
    """Return `value` as a real floating tensor after checking its shape, in which a letter stands for any length.

    A length that several arguments share has to be checked by the caller.
    """
    return _validate.shaped(name, floating(name, value), *shape)


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
        raise ValueError(f"these must have the same number of rows: {told}")
    _validate.one_device(**dict(zip(given, values, strict=True)))
    dtype = functools.reduce(torch.promote_types, (value.dtype for value in values), torch.float32)
    return [value.resolve_neg().to(dtype) for value in values]


P = ParamSpec("P")
R = TypeVar("R")


def in_own_precision(function: Callable[P, R]) -> Callable[P, R]:
    """Return the function, run with torch.autocast off.

    Differences of nearly equal means, colours and coordinates need the digits that bfloat16 does not have; networks
    are what it is for.
    """

    @functools.wraps(function)
    def careful(*args: P.args, **options: P.kwargs) -> R:
        on = [kind for kind in ("cpu", "cuda") if torch.is_autocast_enabled(kind)]
        if not on:
            return function(*args, **options)
        with ExitStack() as stack:
            for kind in on:
                stack.enter_context(torch.autocast(kind, enabled=False))
            return function(*args, **options)

    return careful
