"""Rays, points and surfaces as the public doors accept them, turned into tensors of one precision and device."""

import functools

import torch


def tensors(**named) -> list[torch.Tensor]:
    """Return the arguments as floating tensors on the first one's device, in the widest precision among them.

    Numbers, lists and tensors of integers take the default precision or that of the floating tensors beside them.

    Raises
    ------
    TypeError
        If an argument cannot be read as real numbers.
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
    values = value if isinstance(value, (list, tuple)) else (value,)
    return [v.dtype for v in values if isinstance(v, torch.Tensor) and v.dtype.is_floating_point]


def _tensor(name: str, value) -> torch.Tensor:
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
