"""Discrete Fourier transforms of samples at arbitrary positions and frequencies."""

import math
from collections.abc import Iterable, Sequence

import numpy as np

from odak import _validate

# Products of modes and points up to which the plain sum is taken without finufft: some seconds.
_LARGEST_SUM = 2**32
_BLOCK = 2**22


def nufft2(
    field: np.ndarray,
    fx: np.ndarray,
    fy: np.ndarray,
    size: Sequence[int] | None = None,
    sign: int = 1,
    eps: float = 1e-12,
) -> np.ndarray:
    """Return Σ field[k, l]·exp(±i(k·fx + l·fy)) at arbitrary positions (a transform of type 2).

    Mode numbers k, l run from −(n // 2) over n integers, so that sample ``n // 2`` is number 0.

    Parameters
    ----------
    field : numpy.ndarray
        ``[H, W]``, the coefficients of the modes.
    fx : numpy.ndarray
        Radians per mode along the index of the rows, of any shape.
    fy : numpy.ndarray
        Radians per mode along the index of the columns, of the size of `fx`.
    size : sequence of int, optional
        Shape of the result; by default that of the field.
    sign : {1, -1}
        Sign of the exponent.
    eps : float
        Relative accuracy asked of finufft. The plain sum has rounding alone.

    Returns
    -------
    numpy.ndarray
        complex128.

    Raises
    ------
    ImportError
        If the transform is large and finufft is not installed (``pip install finufft``).
    ValueError, TypeError
        If an argument is not acceptable, naming it.

    Notes
    -----
    Barnett, Magland and af Klinteberg, SIAM J. Sci. Comput. 41, C479 (2019), eq. 1.3.

    Examples
    --------
    The mode of number 1 at a phase of π/2 per mode:

    >>> import numpy as np
    >>> from odak.tools import nufft2
    >>> modes = np.zeros((1, 4))
    >>> modes[0, 3] = 2
    >>> complex(nufft2(modes, np.zeros((1, 1)), np.full((1, 1), np.pi / 2), [1, 1])[0, 0].round(9))
    2j
    """
    field, fx, fy = _checked(field, fx, fy, sign, eps)
    shape = field.shape if size is None else _counts("size", size)
    if math.prod(shape) != fx.size:
        raise ValueError(f"size must hold as many samples as fx, {fx.size}; got {shape}")
    finufft = _finufft(field.size * fx.size)
    if finufft is not None:
        return finufft.nufft2d2(fx, fy, field, eps=eps, isign=sign).reshape(shape)
    result = np.empty(fx.size, dtype=np.complex128)
    for part, rows, columns in _waves(field.shape, fx, fy, sign):
        result[part] = np.einsum("jl,jl->j", rows @ field, columns)
    return result.reshape(shape)


def nuifft2(
    field: np.ndarray,
    fx: np.ndarray,
    fy: np.ndarray,
    size: Sequence[int] | None = None,
    sign: int = 1,
    eps: float = 1e-12,
) -> np.ndarray:
    """Return the modes Σ_j field_j·exp(±i(k·fx_j + l·fy_j)), the adjoint of :func:`nufft2` (a transform of type 1).

    Parameters
    ----------
    field : numpy.ndarray
        Values at the points, of the size of `fx`; two axes unless `size` is given.
    fx : numpy.ndarray
        Radians per mode along the index of the rows.
    fy : numpy.ndarray
        Radians per mode along the index of the columns.
    size : sequence of int, optional
        Rows and columns of modes; by default the field's.
    sign : {1, -1}
        Sign of the exponent. The adjoint of :func:`nufft2` with ``sign=1`` has ``sign=-1``.
    eps : float
        Relative accuracy asked of finufft. The plain sum has rounding alone.

    Returns
    -------
    numpy.ndarray
        complex128 ``[size[0], size[1]]``, number 0 at sample ``n // 2``.

    Raises
    ------
    ImportError
        If the transform is large and finufft is not installed (``pip install finufft``).
    ValueError, TypeError
        If an argument is not acceptable, naming it.

    Examples
    --------
    It is the adjoint of :func:`nufft2`, ⟨A·u, v⟩ = ⟨u, Aᴴ·v⟩:

    >>> import numpy as np
    >>> from odak.tools import nufft2, nuifft2
    >>> random = np.random.default_rng(0)
    >>> fx, fy = random.uniform(-3, 3, (2, 1, 5))
    >>> u, v = random.normal(size=(4, 6)), random.normal(size=(1, 5))
    >>> forward, back = nufft2(u, fx, fy, [1, 5]), nuifft2(v, fx, fy, [4, 6], sign=-1)
    >>> bool(np.allclose((forward * v).sum(), (u * back.conj()).sum()))
    True
    """
    field, fx, fy = _checked(field, fx, fy, sign, eps, modes=False)
    shape = _validate.size("size", field.shape if size is None else size)
    if field.size != fx.size:
        raise ValueError(f"field must hold as many values as fx, {fx.size}; got {field.size}")
    finufft = _finufft(shape[0] * shape[1] * fx.size)
    if finufft is not None:
        return finufft.nufft2d1(fx, fy, field.ravel(), shape, eps=eps, isign=sign)
    result = np.zeros(shape, dtype=np.complex128)
    for part, rows, columns in _waves(shape, fx, fy, sign):
        result += (rows * field.ravel()[part, None]).T @ columns
    return result


def _counts(name, value):
    if isinstance(value, str) or not isinstance(value, Iterable):
        raise TypeError(f"{name} must be a sequence of integers, got {value!r:.80}")
    return tuple(_validate.whole(name, count) for count in value)


def _checked(field, fx, fy, sign, eps, modes: bool = True):
    _validate.real("eps", eps, positive=True)
    field = _validate.array("field", field)
    if sign not in (1, -1):
        raise ValueError(f"sign must be 1 or -1, got {sign!r}")
    field = np.ascontiguousarray(field, dtype=np.complex128)
    if modes and (field.ndim != 2 or field.size == 0):
        raise ValueError(f"field must be [rows, columns], not empty; got {field.shape}")
    fx, fy = (
        np.ascontiguousarray(_validate.real(name, _validate.array(name, value)), dtype=np.float64).ravel()
        for name, value in (("fx", fx), ("fy", fy))
    )
    if fx.size != fy.size:
        raise ValueError(f"fx and fy must be of one size, got {fx.size} and {fy.size}")
    return field, fx, fy


def _finufft(terms: int):
    """Return the finufft package, None where it is missing and the sum is short enough to be written out."""
    try:
        import finufft
    except ImportError as error:
        if terms > _LARGEST_SUM:
            raise ImportError(
                f"A non-uniform transform of {terms:.1e} terms needs the optional package finufft: pip install finufft"
            ) from error
        return None
    return finufft


def _waves(shape, fx, fy, sign):
    """Yield blocks of points with exp(±ik·fx) ``[j, H]`` and exp(±il·fy) ``[j, W]``."""
    k, l = (np.arange(n) - n // 2 for n in shape)  # noqa: E741
    step = max(1, _BLOCK // max(shape))
    for start in range(0, fx.size, step):
        part = slice(start, start + step)
        yield part, np.exp(sign * 1j * fx[part, None] * k), np.exp(sign * 1j * fy[part, None] * l)
