"""The array namespace: one set of formulas for NumPy, PyTorch, CuPy and JAX through the Python array API."""

import sys
from types import ModuleType
from typing import Any

import array_api_compat
import array_api_compat.numpy

# In signatures: an array of any library, or what becomes one. Which it is shows at run time alone.
Array = Any
# It takes over what NumPy has at run time, unseen by a type checker.
numpy_namespace: Any = array_api_compat.numpy
_PLAIN = (int, float, complex, bool, str, list, tuple, type(None))


def is_array(value) -> bool:
    """Say whether `value` is an array of a known library (lists and numbers are not)."""
    # The plain kinds first: torch.compile warns of what array_api_compat looks up in caches.
    if type(value) in _PLAIN:
        return False
    return is_torch(value) or array_api_compat.is_array_api_obj(value)


def namespace(*values) -> ModuleType:
    """Return the array namespace of the arrays among `values`, NumPy's when there is none."""
    arrays = [value for value in values if is_array(value)]
    if arrays and all(is_torch(value) for value in arrays):
        import array_api_compat.torch as torch_namespace

        return torch_namespace
    return array_api_compat.array_namespace(*arrays) if arrays else numpy_namespace


def device_of(value):
    """Return the device of an array, None for anything else."""
    if is_torch(value):
        return value.device
    return array_api_compat.device(value) if is_array(value) else None


def is_torch(value) -> bool:
    """Say whether `value` is a torch tensor, without importing torch."""
    return isinstance(value, getattr(sys.modules.get("torch"), "Tensor", ()))


def is_readable(value) -> bool:
    """Say whether the numbers in `value` are there to be read: without a host sync, torch.func and torch.compile."""
    return not is_torch(value) or not (value.is_cuda or value.is_meta or _is_transformed(value))


def is_traced(value) -> bool:
    """Say whether `value` is a tensor that must stay one: autograd follows it, or its numbers cannot be read."""
    return is_torch(value) and (value.requires_grad or not is_readable(value))


def _is_transformed(tensor) -> bool:
    import torch

    return torch.compiler.is_compiling() or torch._C._functorch.is_functorch_wrapped_tensor(tensor)


def outside_graphs(function, *arguments):
    """Return what a function that looks something up returns; torch.compile breaks its graph there."""
    torch = sys.modules.get("torch")
    if torch is not None and torch.compiler.is_compiling():
        return torch.compiler.disable(function)(*arguments)
    return function(*arguments)


def is_double(value) -> bool:
    """Say whether an array holds 64-bit floats or 128-bit complex numbers (integers count by their namespace)."""
    name = str(value.dtype)
    return "complex128" in name or ("64" in name and "complex64" not in name)


def complex_dtype(value):
    """Return the complex dtype that a field computed from `value` has: half the memory in, half out."""
    xp = namespace(value)
    return xp.complex128 if is_double(value) else xp.complex64


def real_dtype(value):
    """Return the real dtype that belongs to :func:`complex_dtype`."""
    xp = namespace(value)
    return xp.float64 if is_double(value) else xp.float32


def to_complex(field):
    """Return `field` as complex64 or complex128, after its own precision."""
    xp = namespace(field)
    dtype = complex_dtype(field)
    if field.dtype == dtype:
        return field
    if "complex" not in str(field.dtype) and not xp.isdtype(field.dtype, "real floating"):
        field = xp.astype(field, real_dtype(field))
    return xp.astype(field, dtype)


def phasor(phase, dtype=None):
    """Return exp(i·phase) for phases in radians, held in float64 and wrapped to ±π before any cast.

    Parameters
    ----------
    phase : array
        Phase in radians.
    dtype : optional
        Complex dtype of the result; by default the one that belongs to the phase's precision.
    """
    xp = namespace(phase)
    dtype = complex_dtype(phase) if dtype is None else dtype
    return _unit_phasor(xp, phase / (2 * numpy_namespace.pi), dtype)


def phasor_of_cycles(cycles, dtype=None):
    """Return exp(i·2π·cycles): whole cycles are dropped in the precision given, before the cast to `dtype`."""
    xp = namespace(cycles)
    return _unit_phasor(xp, cycles, complex_dtype(cycles) if dtype is None else dtype)


def _unit_phasor(xp, cycles, dtype):
    angle = 2 * numpy_namespace.pi * (cycles - xp.round(cycles))
    angle = xp.astype(angle, xp.float64 if dtype == xp.complex128 else xp.float32)
    return make_complex(xp.cos(angle), xp.sin(angle))


def make_complex(real, imag):
    """Return real + i·imag without an intermediate complex product."""
    xp = namespace(real, imag)
    if is_torch(real):
        import torch

        return torch.complex(real, imag)
    dtype = complex_dtype(real)
    return xp.astype(real, dtype) + 1j * xp.astype(imag, dtype)


def cast(value, like, dtype=None):
    """Return `value` (an array or a number) in the library, on the device and in the precision of the array `like`.

    A torch tensor keeps its place in the autograd graph.
    """
    xp = namespace(like)
    dtype = like.dtype if dtype is None else dtype
    if is_torch(value) and is_torch(like):
        return value.to(device=like.device, dtype=dtype)
    return xp.asarray(value, dtype=dtype, device=device_of(like))
