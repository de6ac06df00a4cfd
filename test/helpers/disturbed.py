"""Disturbed rounding: other last digits, as other processors, numbers of threads and versions of libraries give.

With ``pytest --disturb SEED`` the results of elementary functions, transforms and decompositions move by up to two
units in the last place, and sums and products of matrices are added in another order. How far a number moves depends on
its bits and the seed alone, so that equal numbers stay equal. Numbers whose last digits are zeros (0, 1, whole numbers,
1/2) do not move, and neither do copies and what IEEE 754 rounds in one way (+, −, ×, ÷ and the root of real numbers):
tests of equality to the bit hold.

PyTorch is disturbed in all of its operations, NumPy and SciPy where they are called by the names of modules: the
operators and methods of their arrays (``a @ b``, ``a.sum()``) and other processes remain as they are.
"""

import contextlib
import functools
import sys
import threading

import numpy as np
import torch
from torch.utils._python_dispatch import TorchDispatchMode

# Unsigned and signed integers of the size of a real number, its bits of sign and exponent, and the last digits that are
# zeros in numbers that stay.
_LAYOUT = {
    np.dtype(np.float32): (np.uint32, np.int32, 0x7FFFFFFF, 0x7F800000, 0x7F, 15),
    np.dtype(np.float64): (np.uint64, np.int64, 0x7FFFFFFFFFFFFFFF, 0x7FF0000000000000, 0xFFFFF, 40),
}


# As many numbers as a processor keeps at hand.
_BLOCK = 1 << 14


def steps_of(values, seed: int):
    """Return by how many units in the last place each of real numbers moves: −2, −1, 1, 2, or 0 for those that stay."""
    unsigned, signed, magnitude, exponent, tail, shift = _LAYOUT[values.dtype]
    everything = 2 * magnitude + 1
    bits = values.view(unsigned) & unsigned(magnitude)
    mixed = bits >> unsigned(shift - 8)
    mixed ^= bits
    mixed *= unsigned(0x9E3779B97F4A7C15 & everything)
    mixed ^= unsigned(seed * 0xD6E8FEB86659FD93 & everything)
    mixed *= unsigned(0xC2B2AE3D27D4EB4F & everything)
    mixed >>= unsigned(shift)
    mixed &= unsigned(3)
    steps = mixed.astype(signed)
    steps += (steps >> 1) - 2
    steps *= ((bits & unsigned(tail)) != 0) & (bits < unsigned(exponent))
    return steps


def disturb(values, seed: int) -> None:
    """Move the real numbers of an array in place, and the real and imaginary parts of complex ones."""
    if values.dtype.kind == "c":
        if not values.flags.c_contiguous:
            disturb(values.real, seed)
            disturb(values.imag, seed)
            return
        values = values.reshape(-1).view(values.real.dtype)
    if values.dtype not in _LAYOUT or not values.size:
        return
    values = values.reshape(-1) if values.flags.c_contiguous else np.atleast_1d(values)
    block = max(1, _BLOCK * len(values) // values.size)
    for begin in range(0, len(values), block):
        part = values[begin : begin + block]
        bits = part.view(_LAYOUT[values.dtype][1])
        bits += steps_of(part, seed)


def moved(value, seed: int):
    """Return a NumPy array or number, or several, with other last digits."""
    if isinstance(value, tuple):
        kind = type(value)
        items = [moved(item, seed) for item in value]
        return kind(*items) if hasattr(value, "_fields") else kind(items)
    if not isinstance(value, (np.ndarray, np.generic)) or value.dtype.kind not in "fc":
        return value
    result = np.array(value)
    disturb(result, seed)
    return result[()] if isinstance(value, np.generic) else result


# PyTorch --------------------------------------------------------------------------------------------------------------

_ELEMENTARY = {
    "sin", "cos", "tan", "asin", "acos", "atan", "atan2", "sinh", "cosh", "tanh", "asinh", "acosh", "atanh", "exp",
    "exp2", "expm1", "log", "log2", "log10", "log1p", "pow", "sigmoid", "erf", "erfc", "erfinv", "lgamma",
    "digamma", "hypot", "angle", "rsqrt", "polar", "sinc", "softplus", "gelu", "logaddexp", "_softmax",
    "_log_softmax", "xlogy", "special_bessel_j0", "special_bessel_j1", "special_i0e", "special_i1", "special_erfcx",
    "cumsum", "cumprod", "prod",
}  # fmt: skip
_TRANSFORMS = {
    "_fft_c2c", "_fft_r2c", "_fft_c2r", "linalg_inv_ex", "_linalg_solve_ex", "linalg_cholesky_ex", "_linalg_eigh",
    "_linalg_svd", "linalg_qr", "linalg_lu_factor_ex", "linalg_lu_solve", "linalg_solve_triangular", "_linalg_det",
    "linalg_eig", "linalg_lstsq",
}  # fmt: skip
_SUMS = {"sum", "mean", "var", "std", "linalg_vector_norm", "norm"}
# The place of the dimensions among the arguments behind the tensor, where it is not the first.
_PLACE = {"linalg_vector_norm": 1, "norm": 1}
# The dimensions of both factors over which a product sums.
_PRODUCTS = {"mm": (1, 0), "bmm": (2, 1), "dot": (0, 0), "vdot": (0, 0), "mv": (1, 0)}
_BIASED = {"addmm": (1, 0), "baddbmm": (2, 1), "addmv": (1, 0)}


def _plain(tensor) -> bool:
    """Say whether numbers of a tensor can be changed here: those of subclasses and of other devices cannot."""
    kind = type(tensor) in (torch.Tensor, torch.nn.Parameter)
    return kind and tensor.device.type == "cpu" and tensor.layout == torch.strided


def _disturbed(tensor, seed: int):
    if _plain(tensor) and tensor.dtype in (torch.float32, torch.float64, torch.complex64, torch.complex128):
        disturb(tensor.detach().resolve_conj().resolve_neg().numpy(), seed)
    return tensor


def _all_disturbed(result, seed: int):
    if isinstance(result, torch.Tensor):
        return _disturbed(result, seed)
    for item in result if isinstance(result, (tuple, list)) else ():
        _disturbed(item, seed)
    return result


def _exact_power(exponent) -> bool:
    return isinstance(exponent, (int, float)) and exponent in (0, 0.5, 1, 2, -0.5, -1, -2, 3)


def _mixed(value) -> torch.Tensor:
    """Say where numbers have a real and an imaginary part: products with others are rounded in one way."""
    value = torch.as_tensor(value)
    return (value.real != 0) & (value.imag != 0) if value.is_complex() else torch.zeros((), dtype=torch.bool)


class Disturbed(TorchDispatchMode):
    """A mode in which the operations of PyTorch give other last digits."""

    def __init__(self, seed: int):
        super().__init__()
        self.seed = seed

    def __torch_dispatch__(self, function, types, arguments=(), keywords=None):
        """Compute an operation, and change its result or the order in which it adds."""
        keywords = keywords or {}
        name = function.overloadpacket.__name__.rstrip("_")
        if not arguments or not isinstance(arguments[0], torch.Tensor) or not _plain(arguments[0]):
            return function(*arguments, **keywords)
        if name in _SUMS:
            return function(_turned(name, *arguments, **keywords), *arguments[1:], **keywords)
        if name in _PRODUCTS or name in _BIASED:
            return function(*_reordered(name, arguments), **keywords)
        if name in _TRANSFORMS:
            arguments = [_disturbed(a.clone(), self.seed) if torch.is_tensor(a) else a for a in arguments]
            return _all_disturbed(function(*arguments, **keywords), self.seed)
        if name in ("mul", "div") and len(arguments) > 1 and arguments[0].is_complex():
            return self._product(function, arguments, keywords)
        result = function(*arguments, **keywords)
        exact = name == "pow" and len(arguments) > 1 and _exact_power(arguments[1])
        modulus = name == "abs" and arguments[0].is_complex()
        return _all_disturbed(result, self.seed) if (name in _ELEMENTARY and not exact) or modulus else result

    def _product(self, function, arguments, keywords):
        """Compute a product of complex numbers, whose parts are sums that some processors round once and some twice."""
        both = _mixed(arguments[0]) & _mixed(arguments[1])
        result = function(*arguments, **keywords)
        if _plain(result) and bool(both.any()):
            other = _disturbed(result.detach().clone(), self.seed)
            result.copy_(torch.where(both, other, result))
        return result


def _turned(name: str, tensor, *others, dim=None, **_):
    """Return the tensor of a sum, its terms in the other order."""
    dims = others[_PLACE.get(name, 0)] if dim is None and len(others) > _PLACE.get(name, 0) else dim
    dims = [dims] if isinstance(dims, int) else dims
    if not isinstance(dims, (list, tuple)) or not dims:
        dims = range(tensor.ndim)
    return _flipped(tensor, list(dims))


def _flipped(tensor, dims):
    """Return a tensor flipped; torch.flip forgets that a tensor is kept as its conjugate here."""
    return tensor.resolve_conj().resolve_neg().flip(dims)


def _reordered(name: str, arguments):
    """Return the arguments of a product of matrices, the terms of its sums in the other order."""
    first = 1 if name in _BIASED else 0
    dims = (_BIASED if first else _PRODUCTS)[name]
    pair = [_flipped(factor, dim) for factor, dim in zip(arguments[first : first + 2], dims, strict=True)]
    return [*arguments[:first], *pair, *arguments[first + 2 :]]


# NumPy and SciPy ------------------------------------------------------------------------------------------------------

_UFUNCS = {
    "sin", "cos", "tan", "arcsin", "arccos", "arctan", "arctan2", "sinh", "cosh", "tanh", "arcsinh", "arccosh",
    "arctanh", "exp", "exp2", "expm1", "log", "log2", "log10", "log1p", "hypot", "angle", "logaddexp", "sinc",
    "cumsum",
}  # fmt: skip
_FFTS = {
    "fft", "ifft", "fft2", "ifft2", "fftn", "ifftn", "rfft", "irfft", "rfft2", "irfft2", "rfftn", "irfftn", "dct",
    "idct", "dctn", "idctn", "dst", "idst",
}  # fmt: skip
_LINALG = {
    "inv", "solve", "cholesky", "eigh", "svd", "qr", "det", "eig", "lstsq", "eigvalsh", "pinv",
}  # fmt: skip
_NUMPY_SUMS = ("sum", "mean")


class _Function:
    """A function of NumPy or SciPy whose results are disturbed; its attributes are those of the function."""

    def __init__(self, function, after):
        functools.update_wrapper(self, function, ("__name__", "__qualname__", "__module__", "__doc__"), ())
        self._function, self._after = function, after

    def __call__(self, *arguments, **keywords):
        return self._after(self._function, arguments, keywords)

    def __getattr__(self, name):
        return getattr(self._function, name)


def _numpy_calls(seed: int) -> dict:
    """Return, for each kind of function, how it is called."""

    def results(function, arguments, keywords):
        return function(*arguments, **keywords) if "out" in keywords else moved(function(*arguments, **keywords), seed)

    def both(function, arguments, keywords):
        return results(function, [moved(a, seed) for a in arguments], keywords)

    def sums(function, arguments, keywords):
        axis = keywords.get("axis", arguments[1] if len(arguments) > 1 else None)
        if arguments and isinstance(arguments[0], np.ndarray) and arguments[0].dtype.kind in "fc":
            # A copy: NumPy adds numbers in the order of the memory.
            arguments = (np.flip(arguments[0], axis).copy(), *arguments[1:])
        return function(*arguments, **keywords)

    return {"results": results, "both": both, "sums": sums}


@functools.cache
def disturb_numpy(seed: int) -> None:
    """Put disturbed functions in place of those of NumPy and SciPy, for the rest of the process."""
    import scipy.fft
    import scipy.linalg

    # What looks at the kind of NumPy's functions is imported before.
    with contextlib.suppress(ImportError):
        import dask.array  # noqa: F401

    calls, replaced = _numpy_calls(seed), {}
    for module, names, kind in (
        (np, _UFUNCS, "results"),
        (np, _NUMPY_SUMS, "sums"),
        (np.fft, _FFTS, "both"),
        (scipy.fft, _FFTS, "both"),
        (np.linalg, _LINALG, "both"),
        (scipy.linalg, _LINALG, "both"),
    ):
        for name in names:
            if hasattr(module, name) and not isinstance(getattr(module, name), _Function):
                original = getattr(module, name)
                replaced[id(original)] = _Function(original, calls[kind])
                setattr(module, name, replaced[id(original)])
    # Namespaces that took the functions when they were imported.
    for key, module in list(sys.modules.items()):
        if key.split(".")[0] in ("array_api_compat", "odak") and module is not None:
            for name, value in list(vars(module).items()):
                if id(value) in replaced and not name.startswith("__"):
                    setattr(module, name, replaced[id(value)])


def begin(seed: int):
    """Disturb NumPy and SciPy, enter PyTorch's mode, in this thread and in those to come, and return the mode."""
    disturb_numpy(seed)
    run = threading.Thread.run

    def disturbed_run(thread):
        with Disturbed(seed):
            run(thread)

    threading.Thread.run = disturbed_run
    mode = Disturbed(seed)
    mode.__enter__()
    return mode
