"""Conversion of arrays between NumPy and PyTorch."""

from typing import TYPE_CHECKING

import numpy as np

from odak import _array, _validate

if TYPE_CHECKING:
    import torch


def convert_to_torch(a: np.ndarray, grad: bool = True) -> "torch.Tensor":
    """Copy an array into a tensor.

    Parameters
    ----------
    a : numpy.ndarray
        Array.
    grad : bool
        Whether autograd follows the tensor.

    Returns
    -------
    torch.Tensor
        Tensor of the same dtype that shares no memory with `a`.

    Raises
    ------
    TypeError
        If a gradient is asked for and the array holds integers.

    Examples
    --------
    >>> import numpy as np
    >>> from odak.tools import convert_to_torch
    >>> convert_to_torch(np.asarray([1.0, 2.0])).requires_grad
    True
    """
    import torch

    grad = _validate.flag("grad", grad)
    tensor = a.detach().clone() if isinstance(a, torch.Tensor) else torch.from_numpy(np.array(_validate.array("a", a)))
    if grad and not (tensor.is_floating_point() or tensor.is_complex()):
        raise TypeError(f"a must have a floating-point dtype to have a gradient, got {tensor.dtype}; pass grad=False")
    return tensor.requires_grad_(grad)


def convert_to_numpy(a: "torch.Tensor") -> np.ndarray:
    """Return a tensor as an array on the CPU, detached.

    Parameters
    ----------
    a : torch.Tensor
        Tensor on any device.

    Returns
    -------
    numpy.ndarray
        Array of the same dtype; it shares its memory with a tensor on the CPU.

    Examples
    --------
    >>> import torch
    >>> from odak.tools import convert_to_numpy
    >>> convert_to_numpy(torch.ones(2, requires_grad=True)).tolist()
    [1.0, 1.0]
    """
    if not _array.is_torch(a):
        raise TypeError(f"a must be a tensor, got {type(a).__name__}")
    return a.detach().cpu().resolve_conj().resolve_neg().numpy()
