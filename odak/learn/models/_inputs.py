"""Checks of the arguments and inputs of layers, and the older call form, in which the activation came earlier."""

from collections.abc import Sequence

import torch
from torch import nn

from odak import _validate
from odak.learn._tensors import kind_of, trainable


def channels(name: str, value) -> int:
    """Return a number of channels or features after checking that it is a positive integer."""
    return _validate.integer(name, value, minimum=1)


def kernel(value, *, odd: bool = False) -> int:
    """Return a kernel size; `odd` where an even one, which grows the image by one, could not be added to it."""
    size = _validate.integer("kernel_size", value, minimum=1)
    if odd and size % 2 == 0:
        raise ValueError(f"kernel_size must be odd, so that the size of the image does not change; got {size}")
    return size


def activation_module(activation) -> nn.Module | None:
    """Return an activation after checking that it is a module, or None for no activation."""
    if activation is not None and not isinstance(activation, nn.Module):
        raise TypeError(f"activation must be a torch.nn.Module or None, got {type(activation).__name__}")
    return activation


def with_older_form(
    normalization: bool | nn.Module, activation: nn.Module | None, default: bool = False
) -> tuple[bool, nn.Module | None]:
    """Return normalization and activation of a call that may give the activation in place of the normalization.

    Parameters
    ----------
    normalization : bool or torch.nn.Module
        Value given for ``normalization``; a module is the activation of the older call form.
    activation : torch.nn.Module or None
        Value given for ``activation``.
    default : bool
        Normalization of the layer where the older call form is used.

    Returns
    -------
    tuple of (bool, torch.nn.Module or None)
        Normalization and activation.
    """
    if isinstance(normalization, nn.Module):
        return default, normalization
    if not isinstance(normalization, bool):
        raise TypeError(f"normalization must be a bool, got {type(normalization).__name__}")
    return normalization, activation_module(activation)


def features(
    name: str, value: torch.Tensor, count: int | None = None, parameter: torch.Tensor | None = None
) -> torch.Tensor:
    """Return a real tensor after checking that a layer accepts it and autograd can save it.

    Parameters
    ----------
    name : str
        The argument's name.
    value : torch.Tensor
        Value given.
    count : int, optional
        Length of its last axis.
    parameter : torch.Tensor, optional
        Parameter of the layer whose dtype and device it must have; under autocast the dtype is free.
    """
    if isinstance(value, torch.fx.Proxy):
        return value
    if not isinstance(value, torch.Tensor) or not value.is_floating_point():
        raise TypeError(f"{name} must be a real floating tensor, got {kind_of(value)}")
    wanted = getattr(parameter, "dtype", value.dtype)
    if value.dtype != wanted and not torch.is_autocast_enabled(value.device.type):
        raise TypeError(f"{name} must have the dtype of the layer, {wanted}; got {value.dtype}")
    place = getattr(parameter, "device", value.device)
    if value.device != place:
        raise ValueError(f"{name} must be on the layer's device, {place}; got {value.device}")
    if count is not None and (value.ndim == 0 or value.shape[-1] != count):
        raise ValueError(f"{name} must be [..., {count}], got {list(value.shape)}")
    return trainable(value)


def images(
    name: str,
    value: torch.Tensor,
    count: int | None = None,
    parameter: torch.Tensor | None = None,
    *,
    axes: Sequence[int] = (4,),
    smallest: int = 1,
) -> torch.Tensor:
    """Return images ``[B, C, H, W]`` after checking that a layer accepts them and autograd can save them.

    Parameters
    ----------
    name : str
        The argument's name.
    value : torch.Tensor
        Value given.
    count : int, optional
        Number C of channels.
    parameter : torch.Tensor, optional
        Parameter of the layer whose dtype and device they must have; under autocast the dtype is free.
    axes : sequence of int
        Accepted numbers of axes; three axes are one image without a batch.
    smallest : int
        Least height and width.
    """
    value = features(name, value, None, parameter)
    if isinstance(value, torch.fx.Proxy):
        return value
    shape = list(value.shape)
    fits = value.ndim in axes and min(shape[-2:]) >= smallest and 0 not in shape[1:]
    if not fits or (count is not None and shape[-3] != count):
        wanted = f"[B, {'C' if count is None else count}, H, W]"
        raise ValueError(f"{name} must be {wanted} with H and W of at least {smallest}, got {shape}")
    return value
