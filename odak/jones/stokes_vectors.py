"""Stokes vectors, Mueller matrices and the polarisation ellipse; conventions in :mod:`odak.jones`."""

from typing import Any, NamedTuple

from odak import _array, _validate
from odak._array import Array, ArrayT
from odak.jones.elements import DEGREE, common, jones_vector, square_matrix


class PolarizationEllipse(NamedTuple):
    """The ellipse that the tip of the electric field draws; each item is an array ``[..., k]``.

    Attributes
    ----------
    azimuth : array
        Angle of the major axis in degrees, −90 < azimuth ≤ 90, from x towards y. Undefined for circular polarisation.
    ellipticity : array
        atan(minor/major) in degrees, −45 … 45, positive for right-handed light.
    handedness : array
        1 right, −1 left, 0 linear.
    major : array
        Major semi-axis, ≥ 0; of the polarised part for partly polarised light.
    minor : array
        Minor semi-axis, ≥ 0.
    """

    azimuth: object
    ellipticity: object
    handedness: object
    major: object
    minor: object


def stokes(field: ArrayT) -> ArrayT:
    """Return the Stokes vectors of Jones vectors.

    Parameters
    ----------
    field : array
        ``[..., 2, k]`` or ``[2]``.

    Returns
    -------
    array
        Real ``[..., 4, k]`` or ``[4]``, in the field's precision: S0 intensity, S1 x against y, S2 45° against −45°,
        S3 right against left circular. Sums of them over incoherent parts describe partly polarised light.

    Examples
    --------
    >>> from odak.jones import stokes
    >>> stokes([[3], [2]]).ravel() + 0
    array([13.,  5., 12.,  0.])
    """
    field = jones_vector(field)
    xp = _array.namespace(field)
    axis = -1 if field.ndim == 1 else -2
    x, y = (field[i] for i in (0, 1)) if field.ndim == 1 else (field[..., i, :] for i in (0, 1))
    along, across = (xp.real(u) ** 2 + xp.imag(u) ** 2 for u in (x, y))
    # x·conj(y) by its parts: torch.func.vmap has no rule for a product with a conjugate.
    (a, b), (c, d) = ((xp.real(u), xp.imag(u)) for u in (x, y))
    return xp.stack((along + across, along - across, 2 * (a * c + b * d), 2 * (b * c - a * d)), axis=axis)


def field_from_stokes(vector: ArrayT) -> ArrayT:
    """Return the Jones vectors of the polarised part of Stokes vectors.

    Parameters
    ----------
    vector : array
        Real ``[..., 4, k]`` or ``[4]``.

    Returns
    -------
    array
        Complex ``[..., 2, k]`` or ``[2]``. The common phase is lost: the x amplitude is real and not negative.

    Examples
    --------
    Light polarised linearly at 45°, of intensity 2:

    >>> import numpy as np
    >>> from odak.jones import field_from_stokes
    >>> field_from_stokes(np.asarray([2.0, 0.0, 2.0, 0.0])).real.round(6).tolist()
    [1.0, 1.0]
    """
    vector, axis = stokes_vector(vector)
    xp = _array.namespace(vector)
    _, s1, s2, s3 = _components(vector, axis)
    across = s2**2 + s3**2
    # (P + |S1|)/2 and its partner by their product, so that neither is a difference of equal numbers.
    large = (_root(s1**2 + across) + xp.abs(s1)) / 2
    some = large > 0
    small = xp.where(some, across / (4 * xp.where(some, large, xp.ones_like(large))), 0 * large)
    x = _root(xp.where(s1 < 0, small, large))
    y = _root(xp.where(s1 < 0, large, small))
    lead = _array.phasor(_direction(-s3, s2), _array.complex_dtype(vector))
    return xp.stack((xp.astype(x, lead.dtype), y * lead), axis=axis)


def mueller(matrix: ArrayT) -> ArrayT:
    """Return the Mueller matrices of Jones matrices.

    Parameters
    ----------
    matrix : array
        ``[..., 2, 2]``, e.g. ``mueller(retarder(90, 45))``.

    Returns
    -------
    array
        Real ``[..., 4, 4]`` with mueller(J)·stokes(E) = stokes(J·E), in the matrix' precision:
        A·(J ⊗ J*)·A⁻¹ (Goldstein 2011, section 9.4).

    Examples
    --------
    An ideal polariser transmits half of unpolarised light:

    >>> from odak.jones import mueller, polarizer
    >>> (mueller(polarizer(0)) @ [1.0, 0.0, 0.0, 0.0]).round(6).tolist()
    [0.5, 0.5, 0.0, 0.0]
    """
    matrix = square_matrix("matrix", matrix, 2)
    xp = _array.namespace(matrix)
    basis = ((1, 0, 0, 1), (1, 0, 0, -1), (0, 1, 1, 0), (0, -1j, 1j, 0))
    basis = xp.asarray(basis, dtype=matrix.dtype, device=_array.device_of(matrix))
    product = matrix[..., :, None, :, None] * xp.conj(matrix)[..., None, :, None, :]
    product = xp.reshape(product, (*matrix.shape[:-2], 4, 4))
    return xp.real(xp.matmul(basis, xp.matmul(product, xp.conj(xp.matrix_transpose(basis))))) / 2


def depolarizer(kept: complex | Array = 0.0, *, xp: Any = None, device: Any = None, dtype: Any = None) -> Array:
    """Return the Mueller matrix of an ideal depolariser, which no Jones matrix describes.

    Parameters
    ----------
    kept : number or array
        Share of the degree of polarisation that is left, 0 … 1; ``[...]``.
    xp : module, optional
        Array library of the result where no array is given; NumPy by default.
    device : optional
        Device of the result; by default that of the array given.
    dtype : optional
        float32 or float64; by default that of the array given, else the library's default.

    Returns
    -------
    array
        Real ``[..., 4, 4]``: diag(1, kept, kept, kept).

    Examples
    --------
    >>> from odak.jones import depolarizer
    >>> [float(depolarizer(0.5)[i, i]) for i in range(4)]
    [1.0, 0.5, 0.5, 0.5]
    """
    if not _array.is_array(kept) and not all(0 <= v <= 1 for v in _validate.numbers(_validate.real("kept", kept))):
        raise ValueError(f"kept must be within 0 … 1, got {kept!r}")
    xp, device, real = _array.placement(kept, xp=xp, device=device)
    if dtype is None:
        dtype = xp.float64 if real == xp.float64 else xp.float32
    if dtype not in (xp.float32, xp.float64):
        raise TypeError(f"dtype must be {xp.float32} or {xp.float64}, got {dtype}")
    _, _, (kept,) = common(xp, device, kept=kept)
    diagonal = xp.stack((xp.ones_like(kept), kept, kept, kept), axis=-1)
    return xp.astype(diagonal[..., None] * xp.eye(4, dtype=xp.float64, device=device), dtype)


def degree_of_polarization(vector: ArrayT) -> ArrayT:
    """Return the degree of polarisation, sqrt(S1² + S2² + S3²)/S0.

    Parameters
    ----------
    vector : array
        Stokes vectors, real ``[..., 4, k]`` or ``[4]``.

    Returns
    -------
    array
        Real ``[..., k]``, or one number for ``[4]``: 1 for a pure state, 0 for unpolarised light or none.

    Examples
    --------
    >>> import numpy as np
    >>> from odak.jones import degree_of_polarization
    >>> float(degree_of_polarization(np.asarray([2.0, 0.0, 1.0, 0.0])))
    0.5
    """
    vector, axis = stokes_vector(vector)
    xp = _array.namespace(vector)
    s0, s1, s2, s3 = _components(vector, axis)
    lit = s0 > 0
    return xp.where(lit, _root(s1**2 + s2**2 + s3**2) / xp.where(lit, s0, xp.ones_like(s0)), 0 * s0)


def polarization_ellipse(field: Array) -> PolarizationEllipse:
    """Return the polarisation ellipse of Jones vectors.

    Parameters
    ----------
    field : array
        Jones vectors ``[..., 2, k]`` or ``[2]``.

    Returns
    -------
    PolarizationEllipse
        Azimuth, ellipticity, handedness and semi-axes, each ``[..., k]`` or one number.

    Examples
    --------
    >>> from odak.jones import apply_matrix, electricfield, polarization_ellipse, retarder
    >>> ellipse = polarization_ellipse(apply_matrix(retarder(90, 0), electricfield(2, -1)))
    >>> [float(item[0].round(3)) + 0 for item in ellipse]
    [0.0, 26.565, 1.0, 2.0, 1.0]
    """
    return stokes_ellipse(stokes(field))


def stokes_ellipse(vector: Array) -> PolarizationEllipse:
    """Return the polarisation ellipse of the polarised part of Stokes vectors.

    Parameters
    ----------
    vector : array
        Real Stokes vectors ``[..., 4, k]`` or ``[4]``.

    Returns
    -------
    PolarizationEllipse
        With tan 2ψ = S2/S1 and sin 2χ = S3/P (Born and Wolf 1999, section 1.4.2). Differentiable; where an angle or
        an axis has no derivative (circular light, darkness) the gradient is zero.

    Examples
    --------
    >>> import numpy as np
    >>> from odak.jones import stokes_ellipse
    >>> ellipse = stokes_ellipse(np.asarray([1.0, 0.0, 1.0, 0.0]))
    >>> float(ellipse.azimuth), float(ellipse.ellipticity)
    (45.0, 0.0)
    """
    vector, axis = stokes_vector(vector)
    xp = _array.namespace(vector)
    _, s1, s2, s3 = _components(vector, axis)
    linear = s1**2 + s2**2
    azimuth = _direction(s2, s1) / (2 * DEGREE)
    chi = _direction(s3, _root(linear)) / 2
    radius = _root(_root(linear + s3**2))
    return PolarizationEllipse(azimuth, chi / DEGREE, xp.sign(s3), radius * xp.cos(chi), radius * xp.abs(xp.sin(chi)))


def stokes_vector(vector):
    """Return a Stokes vector as a real array and the axis of its four components."""
    vector = _validate.array("vector", vector)
    axis = -1 if vector.ndim == 1 else -2
    if not vector.ndim or vector.shape[axis] != 4 or "complex" in str(vector.dtype):
        raise ValueError(f"vector must be real, [4] or [..., 4, k]; got {vector.dtype} {tuple(vector.shape)}")
    return _array.namespace(vector).astype(vector, _array.real_dtype(vector), copy=False), axis


def _components(vector, axis):
    return [vector[i] if axis == -1 else vector[..., i, :] for i in range(4)]


def _root(value):
    """Square root, 0 with a gradient of 0 where `value` is not positive; NaN stays NaN."""
    xp = _array.namespace(value)
    some = value > 0
    return xp.where(some, xp.sqrt(xp.where(some, value, xp.ones_like(value))), 0 * value)


def _direction(y, x):
    """Return atan2(y, x), 0 with a gradient of 0 at the origin."""
    xp = _array.namespace(y)
    return xp.atan2(y, xp.where((x == 0) & (y == 0), xp.ones_like(x), x))
