"""An emulated device: tensors that are not on the CPU as far as the package can see, hold their numbers on the CPU, and refuse tensors of the CPU.

It finds what a GPU would: operations that mix devices, results on the wrong device, and numbers that are read back.
"""

import collections
import traceback
from pathlib import Path

import torch
from torch.overrides import TorchFunctionMode
from torch.utils._pytree import tree_leaves, tree_map_only

import odak

# Known to torch without any build for an accelerator, autograd included.
NAME = "meta"
DEVICE = torch.device(NAME)
PACKAGE = str(Path(odak.__file__).parent)
aten = torch.ops.aten
# Copies between devices, and numbers as indices, are allowed.
_MIXING = {aten.copy_.default, aten._to_copy.default}
_FACTORIES = ("device", "dtype", "requires_grad")

# How often each line of the package read a number back.
reads: collections.Counter = collections.Counter()


class DeviceMismatch(RuntimeError):
    """Tensors of two devices in one operation."""


class Emulated(torch.Tensor):
    """A tensor that reports `DEVICE`; its numbers are in `held`."""

    held: torch.Tensor
    # As of a GPU: its numbers cannot be read without waiting for it.
    is_cuda = property(lambda self: True)

    @staticmethod
    def __new__(cls, held):
        tensor = torch.Tensor._make_wrapper_subclass(
            cls,
            held.size(),
            strides=held.stride(),
            storage_offset=held.storage_offset(),
            dtype=held.dtype,
            device=DEVICE,
        )
        tensor.held = held
        return tensor

    def __repr__(self, **_):
        return f"Emulated({self.held!r})"

    @classmethod
    def __torch_dispatch__(cls, function, types, arguments=(), keywords=None):
        keywords = dict(keywords or {})
        tensors = [leaf for leaf in tree_leaves((arguments, keywords)) if isinstance(leaf, torch.Tensor)]
        strangers = [tuple(t.shape) for t in tensors if not isinstance(t, Emulated) and t.ndim > 0]
        if strangers and function not in _MIXING:
            raise DeviceMismatch(f"{function} of the device with tensors of the CPU, {strangers}")
        if function is aten._local_scalar_dense.default:
            reads[_line()] += 1
        here = isinstance(tensors[0], Emulated)
        if keywords.get("device") is not None:
            here = is_emulated(keywords["device"])
            keywords["device"] = torch.device("cpu")
        results = function(*tree_map_only(Emulated, _held, arguments), **tree_map_only(Emulated, _held, keywords))
        if not here:
            return results
        # An operation in place returns the tensor it changed.
        known = {id(tensor.held): tensor for tensor in tensors if isinstance(tensor, Emulated)}
        return tree_map_only(torch.Tensor, lambda tensor: known[id(tensor)] if id(tensor) in known else Emulated(tensor), results)


def _held(tensor):
    return tensor.held


def is_emulated(device) -> bool:
    """Say whether a device, its name or its number is a DEVICE device."""
    return torch.device(device).type == NAME


def _line() -> str:
    """Return the innermost line of the package on the stack."""
    own = [frame for frame in traceback.extract_stack() if frame.filename.startswith(PACKAGE)]
    return f"{own[-1].filename[len(PACKAGE) + 1 :]}: {own[-1].name}: {own[-1].line}" if own else "outside"


class Lift(torch.autograd.Function):
    """Copy a tensor of the CPU to the device, and its gradient back."""

    @staticmethod
    def forward(ctx, tensor):
        """Copy there."""
        return Emulated(tensor.detach().clone())

    @staticmethod
    def backward(ctx, gradient):
        """Copy back."""
        return gradient.held if isinstance(gradient, Emulated) else gradient


class EmulatedDevice(TorchFunctionMode):
    """Within this context `device="meta"` makes emulated tensors."""

    def __torch_function__(self, function, types, arguments=(), keywords=None):
        keywords, name = dict(keywords or {}), getattr(function, "__name__", "")
        if name in ("to", "cuda") and isinstance(arguments[0], torch.Tensor):
            return self._moved(function, name, list(arguments), keywords)
        if name in ("__setitem__", "where", "masked_fill", "masked_fill_"):
            # Of numbers torch would make tensors of the device without asking.
            arguments = tuple(
                torch.tensor(value) if type(value) in (bool, int, float, complex) else value for value in arguments
            )
        device = keywords.get("device")
        if device is None or not is_emulated(device):
            return function(*arguments, **keywords)
        requires_grad = keywords.pop("requires_grad", False)
        if any(isinstance(argument, Emulated) for argument in arguments):
            made = function(*arguments, **{**keywords, "device": None})
        else:
            made = function(*arguments, **{**keywords, "device": "cpu"})
        made = made if isinstance(made, Emulated) else Lift.apply(made)
        return made.requires_grad_() if requires_grad else made

    @staticmethod
    def _moved(function, name, arguments, keywords):
        """Return what `Tensor.to` and `Tensor.cuda` do, whatever the form of their arguments."""
        tensor, *rest = arguments
        given = [*rest, *keywords.values()]
        like = [value for value in given if isinstance(value, torch.Tensor)]
        device = next((value for value in given if isinstance(value, (str, torch.device))), None)
        dtype = next((value for value in given if isinstance(value, torch.dtype)), None)
        if like:
            device, dtype = like[0].device, like[0].dtype
        if name == "cuda" or (device is not None and is_emulated(device)):
            tensor = tensor if isinstance(tensor, Emulated) else Lift.apply(tensor)
        elif device is not None and isinstance(tensor, Emulated):
            tensor = torch.Tensor.to(tensor, device="cpu")
        tensor = tensor if dtype is None else torch.Tensor.to(tensor, dtype=dtype)
        return tensor.clone() if keywords.get("copy") else tensor


def on_device(value):
    """Return a tensor of the CPU, or those in lists, tuples and dictionaries, on the emulated device."""

    def move(tensor):
        if isinstance(tensor, Emulated):
            return tensor
        moved = Emulated(tensor.detach().clone())
        return moved.requires_grad_() if tensor.requires_grad else moved

    return tree_map_only(torch.Tensor, move, value)
