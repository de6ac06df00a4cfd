"""What the tracing kernels take: one element per surface, its numbers read out for a block of rays."""

from typing import Any, NamedTuple

import torch


class Layout(NamedTuple):
    """What about a sequence of surfaces is no number: it does not change while the numbers do.

    Attributes
    ----------
    kinds : tuple of str
        "plane", "conic" or "asphere" of each surface.
    actions : tuple of str
        "refract", "reflect" or "pass" (the same medium on both sides).
    signs : tuple of int
        +1 where light arrives along +z, −1 after an odd number of mirrors.
    limits : tuple of float or None
        Semi-diameters beyond which rays are vignetted.
    """

    kinds: tuple[str, ...]
    actions: tuple[str, ...]
    signs: tuple[int, ...]
    limits: tuple[float | None, ...]


class Numbers(NamedTuple):
    """The numbers of a batch of B systems of S surfaces, in float64.

    Attributes
    ----------
    curvature, conic, distance : torch.Tensor
        ``[B, S]``; `distance` is that from the vertex before (of the first surface: from the rays' plane z = 0).
    coefficients : torch.Tensor
        ``[B, S, K]`` of r², r⁴, …
    index : torch.Tensor
        ``[B, S + 1]``: before the first surface, and behind each.
    """

    curvature: torch.Tensor
    conic: torch.Tensor
    distance: torch.Tensor
    coefficients: torch.Tensor
    index: torch.Tensor  # type: ignore[assignment]  # hides tuple.index


class Element(NamedTuple):
    """One surface for a block of rays: numbers are floats, or tensors ``[rows, 1]`` that broadcast against the block.

    Attributes
    ----------
    kind, action, sign, limit
        From :class:`Layout`.
    c, k, h, a, n1, n2
        Curvature, conic constant, distance from the vertex before, tuple of coefficients, indices on both sides.
    """

    kind: str
    action: str
    sign: int
    limit: float | None
    c: Any
    k: Any
    h: Any
    a: tuple
    n1: Any
    n2: Any


def elements(layout: Layout, numbers: Numbers, dtype: torch.dtype) -> list[Element]:
    """Return the elements of a batch as tensors ``[B, 1]`` of `dtype`, for broadcasting against rays ``[B, R]``."""
    narrow = [value.to(dtype) for value in numbers]
    return _build(layout, *[_columns(value) for value in narrow])


def plain_elements(layout: Layout, lists: tuple, row: int) -> list[Element]:
    """Return the elements of one system as floats, from :func:`as_lists`."""
    curvature, conic, distance, coefficients, index = (value[row] for value in lists)
    return _build(layout, curvature, conic, distance, coefficients, index)


def as_lists(numbers: Numbers) -> tuple:
    """Return the numbers as nested lists: arithmetic with Python floats needs no broadcasting."""
    return tuple(value.detach().tolist() for value in numbers)


def _columns(value):
    """Return ``[B, S]`` as S tensors ``[B, 1]``, and ``[B, S, K]`` as S tuples of K of them."""
    if value.ndim == 3:
        return [tuple(v[:, i : i + 1] for i in range(v.shape[1])) for v in value.unbind(1)]
    return [value[:, i : i + 1] for i in range(value.shape[1])]


def _build(layout: Layout, curvature, conic, distance, coefficients, index) -> list[Element]:
    parts = zip(layout.kinds, layout.actions, layout.signs, layout.limits, strict=True)
    return [
        Element(*part, curvature[i], conic[i], distance[i], tuple(coefficients[i]), index[i], index[i + 1])
        for i, part in enumerate(parts)
    ]
