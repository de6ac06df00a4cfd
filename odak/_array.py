"""Array namespaces, devices and precisions: formulas written once for NumPy, PyTorch, CuPy and JAX."""

import functools
import sys
from collections.abc import Callable, Iterator, Sequence
from types import ModuleType
from typing import TYPE_CHECKING, Any, Protocol, TypeAlias, TypeGuard, TypeVar

import array_api_compat
import array_api_compat.numpy

if TYPE_CHECKING:
    import numpy as np
    import torch


class Array(Protocol):
    """An array of NumPy, PyTorch or another library of the Python array API: what all of them have in common."""

    @property
    def shape(self) -> Any:
        """Number of entries along each axis."""
        ...

    @property
    def ndim(self) -> int:
        """Number of axes."""
        ...

    @property
    def dtype(self) -> Any:
        """Data type of the entries, one of the array's own library."""
        ...

    @property
    def device(self) -> Any:
        """Device that holds the entries, "cpu" for NumPy."""
        ...

    @property
    def real(self) -> Any:
        """Real part, of the same shape."""
        ...

    @property
    def imag(self) -> Any:
        """Imaginary part, of the same shape."""
        ...

    def __len__(self) -> int: ...
    def __iter__(self) -> Iterator[Any]: ...
    def __getitem__(self, key: Any, /) -> Any: ...
    def __add__(self, other: Any, /) -> Any: ...
    def __radd__(self, other: Any, /) -> Any: ...
    def __sub__(self, other: Any, /) -> Any: ...
    def __rsub__(self, other: Any, /) -> Any: ...
    def __mul__(self, other: Any, /) -> Any: ...
    def __rmul__(self, other: Any, /) -> Any: ...
    def __truediv__(self, other: Any, /) -> Any: ...
    def __rtruediv__(self, other: Any, /) -> Any: ...
    def __pow__(self, other: Any, /) -> Any: ...
    def __matmul__(self, other: Any, /) -> Any: ...
    def __and__(self, other: Any, /) -> Any: ...
    def __or__(self, other: Any, /) -> Any: ...
    def __xor__(self, other: Any, /) -> Any: ...
    def __neg__(self) -> Any: ...
    def __abs__(self) -> Any: ...
    def __invert__(self) -> Any: ...
    def __lt__(self, other: Any, /) -> Any: ...
    def __le__(self, other: Any, /) -> Any: ...
    def __gt__(self, other: Any, /) -> Any: ...
    def __ge__(self, other: Any, /) -> Any: ...


class ChunkedArray(Array, Protocol):
    """An array whose values are computed where they are asked for, such as one of Dask."""

    def compute(self, **options: Any) -> "np.ndarray":
        """Return the values, computed."""
        ...

    def map_blocks(self, function: Callable[..., Any], *arguments: Any, **options: Any) -> "ChunkedArray":
        """Return what a function makes of each chunk."""
        ...


class NumberedDevice(Protocol):
    """A device of CuPy or JAX."""

    @property
    def id(self) -> int:
        """Number of the device among those of its kind."""
        ...


# In signatures: the result is an array of the library of the argument.
ArrayT = TypeVar("ArrayT", bound=Array)
T = TypeVar("T")
# A number, and several numbers such as a place (y, x) or angles about three axes.
Amount: TypeAlias = float | Array
Numbers: TypeAlias = Sequence[Amount] | Array
if TYPE_CHECKING:
    Device: TypeAlias = str | torch.device | NumberedDevice | None
    DType: TypeAlias = str | type | np.dtype | torch.dtype | None
    Seed: TypeAlias = int | np.random.Generator | torch.Generator | None
else:  # torch is not imported before it is used
    Device, DType, Seed = str | NumberedDevice | None, str | type | None, int | None
# It takes over what NumPy has at run time, unseen by a type checker.
numpy_namespace: Any = array_api_compat.numpy
# Where there are no other types, nothing has to be asked about them.
_OF_NUMPY = {numpy_namespace.ndarray, numpy_namespace.float64, float, int}
_PLAIN = (int, float, complex, bool, str, list, tuple, type(None))
_COMPLEX = ("torch.complex64", "torch.complex128", "complex64", "complex128")
_NUMPY_COMPLEX = (numpy_namespace.dtype("complex64"), numpy_namespace.dtype("complex128"))


def is_array(value) -> bool:
    """Return whether `value` is an array of a known library (lists and numbers are not)."""
    # The plain kinds first: torch.compile warns of what array_api_compat looks up in caches.
    if type(value) in _PLAIN:
        return False
    tensor = getattr(sys.modules.get("torch"), "Tensor", ())
    return isinstance(value, tensor) or array_api_compat.is_array_api_obj(value)


def namespace(*values) -> ModuleType:
    """Return the array namespace of the arrays among `values`, NumPy's when there is none."""
    if _OF_NUMPY.issuperset(map(type, values)):
        return numpy_namespace
    tensor = getattr(sys.modules.get("torch"), "Tensor", ())
    one = len(values) == 1 and isinstance(values[0], tensor)
    arrays = values if one else [value for value in values if isinstance(value, tensor) or is_array(value)]
    for value in arrays:
        if not isinstance(value, tensor):
            break
    else:
        if arrays:
            import array_api_compat.torch as torch_namespace

            return torch_namespace
    if not arrays:
        return numpy_namespace
    libraries = sorted({type(value).__module__.partition(".")[0] for value in arrays})
    if {"numpy", "torch"} <= set(libraries):
        raise TypeError(
            f"arrays must be of one library, got arrays of {' and '.join(libraries)}: give the arrays of NumPy by "
            "torch.as_tensor(…), or the tensors by ….numpy()"
        )
    return array_api_compat.array_namespace(*arrays)


def broadcast(*arrays):
    """Return arrays in their common shape.

    Those that have it already are returned as they are: to find that out takes torch half a millisecond.
    """
    if all(array.shape == arrays[0].shape for array in arrays):
        return arrays
    return namespace(*arrays).broadcast_arrays(*arrays)


def placement(
    *values, xp: ModuleType | None = None, device: Any = None, dtype: Any = None
) -> tuple[ModuleType, Any, Any]:
    """Return the namespace, the device and the real dtype of a result that is computed from numbers and arrays.

    Parameters
    ----------
    *values : array, number or sequence
        What the result is computed from.
    xp : module, optional
        Array library of the result; by default the library of the arrays among the values, NumPy if there is none.
    device : optional
        Device of the result; by default the device of the first array of this library, else the library's default.
    dtype : optional
        Real dtype of the result; by default the widest precision of the floating arrays of this library, else the
        library's default.
    """
    arrays = [value for value in values if is_array(value)]
    xp = namespace(*arrays) if xp is None else library("xp", xp)
    arrays = [array for array in arrays if namespace(array) is xp]
    if device is None and arrays:
        device = device_of(arrays[0])
    if dtype is None:
        floating = [a for a in arrays if xp.isdtype(a.dtype, ("real floating", "complex floating"))]
        dtypes = [real_dtype(a) if "complex" in str(a.dtype) else a.dtype for a in floating]
        return xp, device, xp.result_type(*dtypes) if dtypes else default_dtype(xp)
    try:
        real = xp.isdtype(xp.empty(0, dtype=dtype).dtype, "real floating")
    except (TypeError, ValueError):
        real = False
    if not real:
        raise TypeError(f"dtype must be a real floating dtype such as {xp.float64}, got {dtype!r:.80}")
    return xp, device, dtype


def library(name: str, value) -> ModuleType:
    """Return the array API's namespace of a library (numpy, torch, …), NumPy's for None."""
    if value is None:
        return numpy_namespace
    if all(hasattr(value, function) for function in ("asarray", "arange", "empty", "float64")):
        return namespace(value.empty(0))
    raise TypeError(f"{name} must be an array library such as numpy or torch, got {value!r:.100}")


def default_dtype(xp: ModuleType):
    """Return the real dtype that a library gives to numbers: float64 in NumPy, torch's default dtype in PyTorch."""
    torch = sys.modules.get("torch")
    return torch.get_default_dtype() if torch is not None and xp.__name__.endswith("torch") else xp.float64


def device_of(value):
    """Return the device of an array, None for anything else."""
    if is_torch(value):
        return value.device
    return array_api_compat.device(value) if is_array(value) else None


def is_torch(value) -> "TypeGuard[torch.Tensor]":
    """Return whether `value` is a torch tensor, without importing torch."""
    return isinstance(value, getattr(sys.modules.get("torch"), "Tensor", ()))


def is_chunked(value) -> bool:
    """Return whether `value` is a Dask array, without importing Dask."""
    return isinstance(value, getattr(sys.modules.get("dask.array"), "Array", ()))


def is_readable(value) -> bool:
    """Return whether the values can be read without a host synchronisation, outside torch.func and torch.compile."""
    return not is_torch(value) or not (value.is_cuda or value.is_meta or _is_symbolic(value))


def is_wrapped(value) -> bool:
    """Return whether torch.func or forward-mode differentiation transforms a tensor, or torch.compile is running."""
    if not is_torch(value):
        return False
    from odak import _torch_private

    return _torch_private.is_transformed(value)


def has_sparse_matrices(value) -> bool:
    """Return whether products with sparse matrices are available for an array: for NumPy and torch."""
    return is_torch(value) or type(value).__module__ == "numpy"


def added_at(array, indices, values):
    """Return a vector of NumPy or PyTorch with values added at indices, which may repeat."""
    if is_torch(array):
        return array.index_add(0, indices, values)
    array = array.copy()
    numpy_namespace.add.at(array, indices, values)
    return array


def numbers_behind(value) -> list[float] | None:
    """Return the numbers in an array as a flat list without derivatives, None under vmap and torch.compile.

    A GPU is waited for.
    """
    if not is_torch(value):
        return [float(number) for number in namespace(value).reshape(value, (-1,))]
    import torch

    from odak import _torch_private

    value = _torch_private.as_constant(value)
    unknown = torch.compiler.is_dynamo_compiling() or _torch_private.is_recording()
    if value.is_meta or unknown or _torch_private.is_wrapped(value):
        return None
    with _torch_private.outside_functional_transforms():
        return value.detach().reshape(-1).tolist()


def _is_symbolic(tensor) -> bool:
    import torch

    from odak import _torch_private

    return torch.compiler.is_compiling() or _torch_private.is_wrapped(tensor)


def is_traced(value) -> bool:
    """Return whether `value` must remain a tensor: it requires a gradient, or its values cannot be read."""
    return is_torch(value) and (value.requires_grad or not is_readable(value))


def is_compiling() -> bool:
    """Return whether torch.compile is following the call."""
    torch = sys.modules.get("torch")
    return torch is not None and torch.compiler.is_compiling()


def constant_in_graphs(function):
    """Mark a function of numbers: torch.compile calls it once and takes what it returns, tensors too, as constant.

    The decorator of torch that does the same loads the compiler.
    """
    function._dynamo_marked_constant = True
    return function


def outside_graphs(function: Callable[..., T], *arguments: Any) -> T:
    """Return what a function that looks something up returns; torch.compile breaks its graph there."""
    torch = sys.modules.get("torch")
    if torch is not None and torch.compiler.is_compiling():
        return torch.compiler.disable(function)(*arguments)
    if torch is not None:
        from odak import _torch_private

        if _torch_private.has_compiler():
            # A frame that torch.compile gave up on runs as it is, but what it calls would be compiled again.
            return _disabled(function)(*arguments)
    return function(*arguments)


@functools.cache
def _disabled(function):
    return sys.modules["torch"].compiler.disable(function)


def is_double(value) -> bool:
    """Return whether an array holds 64-bit floats or 128-bit complex numbers (integers count by their namespace)."""
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


def is_complex(value) -> bool:
    """Return whether a number or an array is complex."""
    return isinstance(value, complex) or "complex" in str(getattr(value, "dtype", ""))


def to_complex(field):
    """Return `field` as complex64 or complex128, after its own precision."""
    dtype = field.dtype
    # NumPy takes longer to write a dtype down than to compare it.
    if dtype in _NUMPY_COMPLEX if isinstance(dtype, numpy_namespace.dtype) else str(dtype) in _COMPLEX:
        return field
    xp = namespace(field)
    dtype = complex_dtype(field)
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


def converted(value, xp: ModuleType, device=None, dtype=None):
    """Return an array, a number or a list as an array of a library, on a device and of a dtype.

    A torch tensor keeps its place in the autograd graph; the memory of an array of another library is not shared.
    """
    if is_array(value) and namespace(value) is xp:
        if is_torch(value):
            return value.to(device=device, dtype=dtype)
        return xp.asarray(value, dtype=dtype, device=device)
    if is_array(value) and xp is not numpy_namespace:
        value = numpy_namespace.array(value, order="C")
    return xp.asarray(value, dtype=dtype, device=device)


def stacked(values, xp: ModuleType, device=None, dtype=None):
    """Return a list of numbers or arrays of one shape as an array; torch tensors keep their place in the graph."""
    if any(is_array(value) for value in values):
        return xp.stack([converted(value, xp, device, dtype) for value in values])
    return converted(values, xp, device, dtype)


def cast(value, like, dtype=None):
    """Return `value` (an array or a number) in the library, on the device and in the precision of the array `like`.

    A torch tensor keeps its place in the autograd graph.
    """
    xp = namespace(like)
    dtype = like.dtype if dtype is None else dtype
    if is_torch(value) and is_torch(like):
        return value.to(device=like.device, dtype=dtype)
    if isinstance(value, (int, float, complex)):
        # A GPU fills memory without waiting; it waits for a copy.
        return xp.full((), value, dtype=dtype, device=device_of(like))
    return xp.asarray(value, dtype=dtype, device=device_of(like))


def product(first, second):
    """Return the product of two matrices, which keeps the precision of tensors under torch.autocast."""
    if not is_torch(first):
        return first @ second
    from odak import _torch_private

    return _torch_private.product(first, second)


def on_host(value):
    """Return an array of any library, or a tensor, as one of NumPy."""
    if not is_torch(value):
        return numpy_namespace.asarray(value)
    held = value.detach().cpu().resolve_conj().resolve_neg()
    return (held.float() if str(held.dtype) == "torch.bfloat16" else held).numpy()


def convolve_plainly(field, kernel):
    """Return :func:`odak.wave.transfer_functions.convolve` by the array library's own transforms."""
    fft, (rows, columns) = namespace(field).fft, field.shape[-2:]
    # Only rows that are not zero are transformed going in, and only those kept coming out.
    spectrum = fft.fft(fft.fft(field, n=kernel.shape[-1], axis=-1), n=kernel.shape[-2], axis=-2) * kernel
    window = fft.ifft(fft.ifft(spectrum, axis=-2)[..., :rows, :], axis=-1)[..., :columns]
    return namespace(window).astype(window, field.dtype, copy=False)
