"""Arguments that the layers share: their checks, and the older call form, which had the activation earlier."""

from torch import nn

from odak import _validate


def channels(name: str, value) -> int:
    """Return a number of channels or features after checking that it is a positive integer."""
    return _validate.integer(name, value, minimum=1)


def kernel(value, *, odd: bool = False) -> int:
    """Return a kernel size; `odd` where an even one, which grows the picture by one, could not be added to it."""
    size = _validate.integer("kernel_size", value, minimum=1)
    if odd and size % 2 == 0:
        raise ValueError(f"kernel_size must be odd, so that the picture keeps its size; got {size}")
    return size


def activation_module(activation) -> nn.Module | None:
    """Return an activation after checking that it is a module, or None for no activation."""
    if activation is not None and not isinstance(activation, nn.Module):
        raise TypeError(f"activation must be a torch.nn.Module or None, got {type(activation).__name__}")
    return activation


def with_older_form(
    normalization: bool | nn.Module, activation: nn.Module | None, default: bool = False
) -> tuple[bool, nn.Module | None]:
    """Return normalization and activation of a call whose activation may stand where normalization does now.

    Parameters
    ----------
    normalization : bool or torch.nn.Module
        What came in the place of ``normalization``; a module there is the activation of the older call form.
    activation : torch.nn.Module or None
        What came as the activation.
    default : bool
        Normalization of the layer when the call does not say.

    Returns
    -------
    tuple of (bool, torch.nn.Module or None)
        Both of them.
    """
    if isinstance(normalization, nn.Module):
        return default, normalization
    if not isinstance(normalization, bool):
        raise TypeError(f"normalization must be a bool, got {type(normalization).__name__}")
    return normalization, activation_module(activation)
