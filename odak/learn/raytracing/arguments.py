"""Checks of rays, points and surfaces given to public functions, and their conversion to tensors."""

import functools
from numbers import Real

import torch


def tensors(**named) -> list[torch.Tensor]:
    """Return the arguments as floating tensors on the first one's device, in the widest precision among them.

    Numbers, lists and tensors of integers take the default precision or that of the floating tensors beside them.

    Raises
    ------
    ValueError, TypeError
        If an argument cannot be read as real numbers, or is a plain number or list without or not of numbers.
    """
    given = {name: _tensor(name, value) for name, value in named.items()}
    device = next((v.device for v in named.values() if isinstance(v, torch.Tensor)), torch.device("cpu"))
    # Lists and integers have no precision of their own and must not widen a float16 or float32 ray.
    floating = [dtype for value in named.values() for dtype in _precisions(value)]
    dtype = functools.reduce(torch.promote_types, floating) if floating else torch.get_default_dtype()
    return [value.to(device=device, dtype=dtype) for value in given.values()]


def shaped(name: str, value: torch.Tensor, last: tuple[int, ...], accepted: str) -> torch.Tensor:
    """Return `value` with a batch axis in front of its last axes, after checking these."""
    if value.shape[value.ndim - len(last) :] != last:
        raise ValueError(f"{name} must be {accepted}, got {tuple(value.shape)}")
    return value if value.ndim > len(last) else value[None]


def listed(name: str, value: torch.Tensor, last: tuple[int, ...], accepted: str) -> torch.Tensor:
    """Return `value` with one batch axis in front of its last axes, after checking that it has no more."""
    value = shaped(name, value, last, accepted)
    if value.ndim > 1 + len(last):
        raise ValueError(f"{name} must be {accepted}, got {tuple(value.shape)}")
    return value


def vector(name: str, value: torch.Tensor, count: int = 3) -> torch.Tensor:
    """Return `count` numbers as ``[count]``."""
    if value.numel() != count:
        raise ValueError(f"{name} must be {count} numbers, got {tuple(value.shape)}")
    return value.reshape(count)


def points(name: str, value: torch.Tensor) -> torch.Tensor:
    """Return points ``[m, 3]``."""
    return shaped(name, value, (3,), "[3] or [m, 3]")


def rays(name: str, value: torch.Tensor) -> torch.Tensor:
    """Return rays ``[m, 2, 3]``."""
    return shaped(name, value, (2, 3), "[2, 3] or [m, 2, 3]")


def triangles(name: str, value: torch.Tensor) -> torch.Tensor:
    """Return triangles ``[m, 3, 3]``."""
    return shaped(name, value, (3, 3), "[3, 3] or [m, 3, 3]")


def as_rays(start: torch.Tensor, direction: torch.Tensor) -> torch.Tensor:
    """Return rays ``[..., 2, 3]`` of starts and directions, broadcast against each other."""
    return torch.stack(torch.broadcast_tensors(start, direction), dim=-2)


def _precisions(value) -> list[torch.dtype]:
    """Return the floating dtypes of the tensors in an argument."""
    values = _items(value)
    return [v.dtype for v in values if isinstance(v, torch.Tensor) and v.dtype.is_floating_point]


def _items(value):
    return value if isinstance(value, (list, tuple)) else (value,)


def _tensor(name: str, value) -> torch.Tensor:
    items = _items(value)
    if not len(items):
        raise ValueError(f"{name} must hold at least one number, got an empty {type(value).__name__}")
    # In plain Python, which torch.compile can follow. Arrays may hold NaN: rays that missed something.
    if any(isinstance(item, Real) and item != item for item in items):
        raise ValueError(f"{name} must not be NaN, got {value!r}")
    if isinstance(value, (list, tuple)) and any(isinstance(v, torch.Tensor) for v in value):
        value = torch.stack([v if isinstance(v, torch.Tensor) else torch.tensor(v, dtype=torch.float64) for v in value])
    try:
        # Plain numbers are read in double precision, lest a float64 ray meet a surface rounded to float32.
        value = value if hasattr(value, "dtype") else torch.tensor(value, dtype=torch.float64)
        value = torch.as_tensor(value)
    except (TypeError, ValueError, RuntimeError) as error:
        raise TypeError(f"{name} must be a tensor or numbers, got {type(value).__name__}") from error
    if value.is_complex() or value.dtype == torch.bool:
        raise TypeError(f"{name} must be real numbers, got {value.dtype}")
    return value
