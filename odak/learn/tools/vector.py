"""Products, sides and distances of points and rays as differentiable tensors."""

import functools

import torch

from odak import _validate
from odak.learn._tensors import tensor
from odak.tools.vector import cross, on_same_side


def cross_product(vector1: torch.Tensor, vector2: torch.Tensor) -> torch.Tensor:
    """Return the vector product of two rays' directions as a ray that starts where the first does.

    Parameters
    ----------
    vector1, vector2 : torch.Tensor
        Rays ``[2, 3]`` or ``[m, 2, 3]``.

    Returns
    -------
    torch.Tensor
        ``[2, 3]`` or ``[m, 2, 3]``: the first start and ``vector1[1] × vector2[1]``.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.tools import cross_product
    >>> cross_product(torch.tensor([[1.0, 2, 3], [1, 0, 0]]), torch.tensor([[0.0, 0, 0], [0, 1, 0]]))
    tensor([[1., 2., 3.],
            [0., 0., 1.]])
    """
    first, second = _floats(vector1=vector1, vector2=vector2)
    for name, ray in (("vector1", first), ("vector2", second)):
        if ray.shape[-2:] != (2, 3):
            raise ValueError(f"{name} must be [2, 3] or [m, 2, 3], got {tuple(ray.shape)}")
    _validate.fitting(vector1=first, vector2=second)
    first, second = torch.broadcast_tensors(first, second)
    return torch.stack((first[..., 0, :], cross(first[..., 1, :], second[..., 1, :])), dim=-2)


def same_side(p1: torch.Tensor, p2: torch.Tensor, a: torch.Tensor, b: torch.Tensor) -> bool | torch.Tensor:
    """Say whether p1 and p2 lie on the same side of the line through a and b.

    Parameters
    ----------
    p1, p2, a, b : torch.Tensor
        Points ``[3]``; `p1` may be ``[n, 3]``.

    Returns
    -------
    bool or torch.Tensor
        One bool, or ``[n]`` of them. A point on the line is on both sides.

    Examples
    --------
    >>> from odak.learn.tools import same_side
    >>> same_side([0.0, 1, 0], [5.0, 2, 0], [0.0, 0, 0], [1.0, 0, 0])
    True
    """
    result = on_same_side(*_points(p1=p1, p2=p2, a=a, b=b))
    return bool(result) if result.ndim == 0 else result


def distance_between_two_points(point1: torch.Tensor, point2: torch.Tensor) -> torch.Tensor:
    """Return the distance between points.

    Parameters
    ----------
    point1, point2 : torch.Tensor
        ``[3]`` or ``[n, 3]`` each; lists are converted.

    Returns
    -------
    torch.Tensor
        0-d for two points ``[3]``, else ``[n]``. Where the points coincide its gradient is 0.

    Examples
    --------
    >>> from odak.learn.tools import distance_between_two_points
    >>> distance_between_two_points([0, 0, 0], [3, 4, 12])
    tensor(13.)
    """
    point1, point2 = _points(point1=point1, point2=point2)
    return torch.linalg.vector_norm(point1 - point2, dim=-1)


def _points(**values) -> list[torch.Tensor]:
    """Return tensors ``[..., 3]`` that fit each other, as :func:`_floats` does."""
    points = dict(zip(values, _floats(**values), strict=True))
    for name, point in points.items():
        if point.ndim == 0 or point.shape[-1] != 3:
            raise ValueError(f"{name} must be [3] or [n, 3], got {list(point.shape)}")
    _validate.fitting(**points)
    return list(points.values())


def _floats(**values) -> list[torch.Tensor]:
    """Return tensors of the widest precision among the floating ones, on the first one's device."""
    floating = [value.dtype for value in values.values() if torch.is_tensor(value) and value.is_floating_point()]
    dtype = functools.reduce(torch.promote_types, floating) if floating else torch.get_default_dtype()
    device = next((value.device for value in values.values() if torch.is_tensor(value)), torch.device("cpu"))
    return [tensor(name, value, dtype, device) for name, value in values.items()]
