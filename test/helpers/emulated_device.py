"""An emulated device: tensors that keep their numbers on the CPU, seem to be elsewhere, and refuse those of the CPU.

It finds what a GPU would: operations that mix devices, results on the wrong device, numbers that are read back, and
numbers of the CPU that are copied there, for which CUDA waits too.
"""

import collections
import traceback
from pathlib import Path
from unittest import mock

import torch
from torch.overrides import TorchFunctionMode
from torch.utils._pytree import tree_leaves, tree_map_only

import odak

# Known to torch without any build for an accelerator, autograd included.
NAME = "meta"
DEVICE = torch.device(NAME)
PACKAGE = str(Path(odak.__file__).parent)
aten = torch.ops.aten
# CUDA takes indices of the CPU, and copies between devices are what they are for.
_MIXING = {aten.copy_, aten._to_copy, aten.index, aten.index_put, aten.index_put_, aten._index_put_impl_}

_NUMBERS = (bool, int, float, complex)
# Functions that make tensors of numbers, or of the values of others; the rest need a shape and fill it on the device.
_FROM_NUMBERS = {"tensor", "asarray", "as_tensor", "from_numpy"}

# How often each line of the package read a number back, and copied numbers of the CPU to the device.
reads: collections.Counter = collections.Counter()
copies: collections.Counter = collections.Counter()


class DeviceMismatch(RuntimeError):
    """Tensors of two devices in one operation."""


class Emulated(torch.Tensor):
    """A tensor that reports `DEVICE`; its numbers are in `held`."""

    held: torch.Tensor
    # As of a GPU: its numbers cannot be read without waiting for it.
    is_cuda = property(lambda self: True)
    is_meta = property(lambda self: False)

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
        if strangers and function.overloadpacket not in _MIXING:
            raise DeviceMismatch(f"{function} of the device with tensors of the CPU, {strangers}")
        if function is aten._local_scalar_dense.default:
            reads[_line()] += 1
        if strangers and isinstance(tensors[0], Emulated):
            copies[_line()] += 1
        if function is aten.copy_.default and _same_memory(*arguments[:2]):
            return arguments[0]
        here = isinstance(tensors[0], Emulated)
        if keywords.get("device") is not None:
            here = is_emulated(keywords["device"])
            keywords["device"] = torch.device("cpu")
        arguments, keywords = tree_map_only(torch.Tensor, _held, (arguments, keywords))
        results = function(*arguments, **keywords)
        if not here:
            return results
        # An operation in place returns the tensor it changed.
        known = {id(tensor.held): tensor for tensor in tensors if isinstance(tensor, Emulated)}
        return tree_map_only(
            torch.Tensor, lambda tensor: known[id(tensor)] if id(tensor) in known else _wrapped(tensor), results
        )


def _wrapped(tensor) -> Emulated:
    """Return a result on the device; what torch keeps as the conjugate or the negative of a tensor becomes numbers.

    The operations that see the mark have been passed by when an operation of the device begins.
    """
    return Emulated(tensor.resolve_conj().resolve_neg())


def _held(tensor):
    # A single number that autograd itself makes on the device has no value there; it is the zero of a gradient.
    if isinstance(tensor, Emulated):
        return tensor.held
    return torch.zeros((), dtype=tensor.dtype) if tensor.device.type == NAME and tensor.ndim == 0 else tensor


def _same_memory(one, other) -> bool:
    """Say whether two tensors are the same view, as in ``x[i] += 1``, which torch knows by its storage."""
    if not (isinstance(one, Emulated) and isinstance(other, Emulated)):
        return False
    one, other = one.held, other.held
    return (one.data_ptr(), one.shape, one.stride()) == (other.data_ptr(), other.shape, other.stride())


def is_emulated(device) -> bool:
    """Say whether a device, its name or its number is a DEVICE device."""
    return torch.device(device).type == NAME


def _line() -> str:
    """Return "module:function: line" of the innermost line of the package on the stack."""
    own = [frame for frame in traceback.extract_stack() if frame.filename.startswith(PACKAGE)]
    if not own:
        return "outside"
    # A generator or a lambda is part of the function around it.
    function = next((frame.name for frame in reversed(own) if not frame.name.startswith("<")), "<module>")
    module = Path(own[-1].filename).relative_to(PACKAGE).with_suffix("").as_posix()
    return f"{module}:{function}: {own[-1].line}"


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


class Lower(torch.autograd.Function):
    """Copy a tensor of the device to the CPU, and its gradient back, which torch itself would make without numbers."""

    @staticmethod
    def forward(ctx, tensor):
        """Copy from there."""
        return tensor.detach().held.clone()

    @staticmethod
    def backward(ctx, gradient):
        """Copy there."""
        return gradient if isinstance(gradient, Emulated) else Emulated(gradient)


def _of_the_cpu(kind: type) -> type:
    """Return a class whose objects are those of `kind` for the CPU, whatever the device asked for."""

    class Meta(type):
        def __call__(cls, device="cpu", **options):
            return kind("cpu", **options)

        def __instancecheck__(cls, value):
            return isinstance(value, kind)

    return Meta(kind.__name__, (), {})


class EmulatedDevice(TorchFunctionMode):
    """Within this context `device="meta"` makes emulated tensors; generators and autocast are those of the CPU."""

    def __enter__(self):
        self._patches = [
            mock.patch.object(torch, "Generator", _of_the_cpu(torch.Generator)),
            mock.patch.object(torch, "autocast", _of_the_cpu(torch.autocast)),
        ]
        for patch in self._patches:
            patch.start()
        return super().__enter__()

    def __exit__(self, *reason):
        for patch in self._patches:
            patch.stop()
        return super().__exit__(*reason)

    def __torch_function__(self, function, types, arguments=(), keywords=None):
        keywords, name = dict(keywords or {}), getattr(function, "__name__", "")
        if name in ("to", "cuda") and isinstance(arguments[0], torch.Tensor):
            return self._moved(function, name, list(arguments), keywords)
        # From numbers torch would create tensors on the device implicitly.
        if name == "__setitem__" and type(arguments[2]) in _NUMBERS:
            arguments = (*arguments[:2], torch.tensor(arguments[2], dtype=arguments[0].dtype))
        if name in ("where", "masked_fill", "masked_fill_"):
            arguments = tuple(torch.tensor(value) if type(value) in _NUMBERS else value for value in arguments)
        if name == "tolist" and isinstance(arguments[0], Emulated):
            reads[_line()] += 1
            return arguments[0].held.tolist()
        if name == "new_tensor" and isinstance(arguments[0], Emulated):
            copies[_line()] += 1
            return Lift.apply(torch.tensor(arguments[1], dtype=keywords.get("dtype", arguments[0].dtype)))
        device = keywords.get("device")
        if device is None or not is_emulated(device):
            return function(*arguments, **keywords)
        requires_grad = keywords.pop("requires_grad", False)
        if any(isinstance(argument, Emulated) for argument in arguments):
            made = function(*arguments, **{**keywords, "device": None})
        else:
            made = function(*arguments, **{**keywords, "device": "cpu"})
        if name in _FROM_NUMBERS and not isinstance(made, Emulated):
            copies[_line()] += 1
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
            if not isinstance(tensor, Emulated):
                # A copy that is not waited for needs pinned memory, which tensors of the package have not.
                copies[_line()] += 1
                tensor = Lift.apply(tensor)
        elif device is not None and isinstance(tensor, Emulated):
            tensor = Lower.apply(tensor)
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
