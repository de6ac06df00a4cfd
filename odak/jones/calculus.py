"""Jones vectors and matrices, Stokes vectors, Mueller matrices and the polarisation ellipse.

The conventions are stated in :mod:`odak.jones`.
"""

from types import ModuleType
from typing import Any, NamedTuple

from odak import _array, _validate
from odak._array import Amount, Array, ArrayT, Device, DType

DEGREE = _array.numpy_namespace.pi / 180


def electricfield(
    px: complex | Array,
    py: complex | Array,
    *,
    xp: ModuleType | None = None,
    device: Device = None,
    dtype: DType = None,
) -> Array:
    """Return the Jones vector of the amplitudes `px` and `py`.

    Parameters
    ----------
    px : number or array
        Amplitude along x, real or complex, ``[..., k]``; a number is taken as ``[1]``.
    py : number or array
        Amplitude along y, of a shape that broadcasts with `px`.
    xp : module, optional
        Array library of the result where no array is given; NumPy by default.
    device : optional
        Device of the result; by default the device of the arrays given.
    dtype : optional
        complex64 or complex128; by default in the widest precision of the arrays given, else in the library's default.

    Returns
    -------
    array
        Complex ``[..., 2, k]``: ``2 x 1`` for two numbers (J. Goodman, Introduction to Fourier Optics).

    Examples
    --------
    >>> from odak.jones import electricfield
    >>> electricfield(1, 1j)[:, 0].tolist()
    [(1+0j), 1j]
    """
    xp, dtype, (px, py) = common(xp, device, dtype, px=px, py=py)
    px, py = xp.broadcast_arrays(xp.astype(px, dtype), xp.astype(py, dtype))
    field = xp.stack((px, py), axis=-2 if px.ndim else 0)
    return field if px.ndim else xp.reshape(field, (2, 1))


@_validate.takes_units(degrees=("rotation",))
def linearpolarizer(field: ArrayT, rotation: complex | Array = 0) -> ArrayT:
    """Return a field after an ideal linear polariser.

    Parameters
    ----------
    field : array
        Jones vectors ``[..., 2, k]`` or ``[2]``.
    rotation : number or array
        Angle of the transmission axis in degrees, from x towards y; arrays are batches.

    Returns
    -------
    array
        Complex, in the field's precision.

    Examples
    --------
    >>> from odak.jones import electricfield, linearpolarizer
    >>> linearpolarizer(electricfield(1, 1), 30).real.round(5)
    array([[1.18301],
           [0.68301]])
    """
    field = jones_vector(field)
    rotation = check_angle("rotation", rotation)
    _validate.fitting(rotation=rotation, field=tuple(field.shape[:-2]))
    return apply_matrix(polarizer(_array.cast(rotation, field, _array.real_dtype(field))), field)


def apply_matrix(matrix: Array, field: ArrayT) -> ArrayT:
    """Return the field behind an element.

    Parameters
    ----------
    matrix : array
        Jones matrices ``[..., 2, 2]``.
    field : array
        Jones vectors ``[..., 2, k]``, or one ``[2]``.

    Returns
    -------
    array
        matrix · field, complex, in the field's precision and on its device.

    Raises
    ------
    ValueError
        If a shape is not as above.

    Examples
    --------
    >>> from odak.jones import apply_matrix, electricfield, half_wave_plate
    >>> field = apply_matrix(half_wave_plate(45), electricfield(1, 0))
    >>> abs(field[:, 0]).round(6).tolist()
    [0.0, 1.0]
    """
    field = jones_vector(field)
    matrix = _array.cast(square_matrix("matrix", matrix, 2), field)
    xp = _array.namespace(field)
    columns = field if field.ndim > 1 else field[:, None]
    _validate.fitting(matrix=matrix[..., :1], field=columns[..., :1, :])
    return xp.matmul(matrix, columns) if field.ndim > 1 else xp.matmul(matrix, columns)[..., 0]


def cascade(*matrices: Array) -> Array:
    """Return the matrix of a sequence of elements, given in the order in which they are passed.

    Parameters
    ----------
    *matrices : array
        Jones matrices ``[..., 2, 2]`` (or Mueller matrices ``[..., 4, 4]``), at least one, of one dtype.

    Returns
    -------
    array
        The last · … · the first.

    Examples
    --------
    Two quarter-wave plates on the same axis are a half-wave plate:

    >>> import numpy as np
    >>> from odak.jones import cascade, half_wave_plate, quarter_wave_plate
    >>> bool(np.allclose(cascade(quarter_wave_plate(20), quarter_wave_plate(20)), half_wave_plate(20)))
    True
    """
    if not matrices:
        raise ValueError("matrices must be at least one, got none")
    matrices = [_validate.array("matrices", matrix) for matrix in matrices]
    size = matrices[0].shape[-1] if matrices[0].ndim else 0
    for matrix in matrices:
        square_shape("matrices", matrix, size)
    xp = _array.namespace(*matrices)
    result = matrices[0]
    for matrix in matrices[1:]:
        result = xp.matmul(matrix, result)
    return result


@_validate.takes_units(degrees=("angle",))
def polarizer(
    angle: complex | Array = 0.0, *, xp: ModuleType | None = None, device: Device = None, dtype: DType = None
) -> Array:
    """Return the Jones matrix of an ideal linear polariser.

    Parameters
    ----------
    angle : number or array
        Angle of its transmission axis in degrees, of shape ``[...]``.
    xp : module, optional
        Array library of the result where no array is given; NumPy by default.
    device : optional
        Device of the result; by default the device of the arrays given.
    dtype : optional
        complex64 or complex128; by default in the widest precision of the arrays given, else in the library's default.

    Returns
    -------
    array
        Complex ``[..., 2, 2]``: [[c², cs], [cs, s²]].

    Examples
    --------
    The transmittance for light polarised along x is cos²(angle), Malus's law:

    >>> from odak.jones import electricfield, polarizer
    >>> transmitted = polarizer(60.0) @ electricfield(1.0, 0.0)
    >>> round(float((abs(transmitted) ** 2).sum()), 6)
    0.25
    """
    return diattenuator(1.0, 0.0, angle, xp=xp, device=device, dtype=dtype)


@_validate.takes_units(degrees=("angle",))
def diattenuator(
    first: complex | Array = 1.0,
    second: complex | Array = 0.0,
    angle: complex | Array = 0.0,
    *,
    xp: ModuleType | None = None,
    device: Device = None,
    dtype: DType = None,
) -> Array:
    """Return the Jones matrix of a partial polariser.

    Parameters
    ----------
    first : number or array
        Amplitude transmission along the axis at `angle`, real or complex; its squared modulus is the transmittance.
    second : number or array
        Amplitude transmission across that axis.
    angle : number or array
        Angle of the axis in degrees.
    xp : module, optional
        Array library of the result where no array is given; NumPy by default.
    device : optional
        Device of the result; by default the device of the arrays given.
    dtype : optional
        complex64 or complex128; by default in the widest precision of the arrays given, else in the library's default.

    Returns
    -------
    array
        Complex ``[..., 2, 2]``; all arguments broadcast.

    Examples
    --------
    >>> from odak.jones import diattenuator
    >>> diattenuator(0.5, 0.25).real.tolist()
    [[0.5, 0.0], [0.0, 0.25]]
    """
    check_angle("angle", angle)
    xp, dtype, (first, second, angle) = common(xp, device, dtype, first=first, second=second, angle=angle)
    return matrix_on_axes(xp, first, second, angle, dtype)


@_validate.takes_units(degrees=("retardance", "angle"))
def retarder(
    retardance: complex | Array,
    angle: complex | Array = 0.0,
    *,
    xp: ModuleType | None = None,
    device: Device = None,
    dtype: DType = None,
) -> Array:
    """Return the Jones matrix of a wave plate of any retardance.

    Parameters
    ----------
    retardance : number or array
        Phase by which the slow axis lags behind the fast one, in degrees: 360·(n_slow − n_fast)·thickness/wavelength.
    angle : number or array
        Angle of the *fast* axis in degrees.
    xp : module, optional
        Array library of the result where no array is given; NumPy by default.
    device : optional
        Device of the result; by default the device of the arrays given.
    dtype : optional
        complex64 or complex128; by default in the widest precision of the arrays given, else in the library's default.

    Returns
    -------
    array
        Complex ``[..., 2, 2]``, unitary, of determinant 1: half of the retardance on either axis.

    Examples
    --------
    A quarter-wave plate at 45° makes right circular light, E_y/E_x = −i, of light polarised along x:

    >>> from odak.jones import electricfield, retarder
    >>> field = (retarder(90.0, 45.0) @ electricfield(1.0, 0.0))[:, 0]
    >>> round(float((field[1] / field[0]).imag), 6)
    -1.0
    """
    check_angle("retardance", retardance)
    check_angle("angle", angle)
    xp, dtype, (retardance, angle) = common(xp, device, dtype, retardance=retardance, angle=angle)
    slow = _array.phasor_of_cycles(retardance / 720, xp.complex128)
    return matrix_on_axes(xp, xp.conj(slow), slow, angle, dtype)


@_validate.takes_units(degrees=("angle",))
def quarter_wave_plate(
    angle: float | Array = 0.0, *, xp: ModuleType | None = None, device: Device = None, dtype: DType = None
) -> Array:
    """Return the Jones matrix of a quarter-wave plate: :func:`retarder` of 90°.

    Parameters
    ----------
    angle : number or array
        Angle of the fast axis in degrees.
    xp : module, optional
        Array library of the result where no array is given; NumPy by default.
    device : optional
        Device of the result; by default the device of the arrays given.
    dtype : optional
        complex64 or complex128; by default in the widest precision of the arrays given, else in the library's default.

    Returns
    -------
    array
        Complex ``[..., 2, 2]``.

    Examples
    --------
    At 45° it makes circular light of light polarised along x: both components have the same intensity.

    >>> from odak.jones import electricfield, quarter_wave_plate
    >>> intensity = abs(quarter_wave_plate(45.0) @ electricfield(1.0, 0.0)) ** 2
    >>> [round(float(value), 6) for value in intensity[:, 0]]
    [0.5, 0.5]
    """
    return retarder(90.0, angle, xp=xp, device=device, dtype=dtype)


@_validate.takes_units(degrees=("angle",))
def half_wave_plate(
    angle: float | Array = 0.0, *, xp: ModuleType | None = None, device: Device = None, dtype: DType = None
) -> Array:
    """Return the Jones matrix of a half-wave plate: :func:`retarder` of 180°.

    Parameters
    ----------
    angle : number or array
        Angle of the fast axis in degrees.
    xp : module, optional
        Array library of the result where no array is given; NumPy by default.
    device : optional
        Device of the result; by default the device of the arrays given.
    dtype : optional
        complex64 or complex128; by default in the widest precision of the arrays given, else in the library's default.

    Returns
    -------
    array
        Complex ``[..., 2, 2]``.

    Examples
    --------
    It rotates a linear polarisation by twice the angle of its axis, here from x to y:

    >>> from odak.jones import electricfield, half_wave_plate
    >>> intensity = abs(half_wave_plate(45.0) @ electricfield(1.0, 0.0)) ** 2
    >>> [round(float(value), 6) for value in intensity[:, 0]]
    [0.0, 1.0]
    """
    return retarder(180.0, angle, xp=xp, device=device, dtype=dtype)


@_validate.takes_units(degrees=("angle",))
def rotator(
    angle: complex | Array, *, xp: ModuleType | None = None, device: Device = None, dtype: DType = None
) -> Array:
    """Return the Jones matrix of a rotation of the polarisation, as an optically active crystal or a Faraday cell does.

    Parameters
    ----------
    angle : number or array
        Degrees, from x towards y.
    xp : module, optional
        Array library of the result where no array is given; NumPy by default.
    device : optional
        Device of the result; by default the device of the arrays given.
    dtype : optional
        complex64 or complex128; by default in the widest precision of the arrays given, else in the library's default.

    Returns
    -------
    array
        Complex ``[..., 2, 2]``: [[c, −s], [s, c]].

    Examples
    --------
    >>> from odak.jones import rotator
    >>> [round(float(value), 6) for value in rotator(30.0)[:, 0].real]
    [0.866025, 0.5]
    """
    check_angle("angle", angle)
    xp, dtype, (angle,) = common(xp, device, dtype, angle=angle)
    c, s = xp.cos(DEGREE * angle), xp.sin(DEGREE * angle)
    return stack_matrix(xp, ((c, -s), (s, c)), dtype)


def circular_polarizer(
    handedness: str = "right", *, xp: ModuleType | None = None, device: Device = None, dtype: DType = None
) -> Array:
    """Return the Jones matrix of an ideal (homogeneous) circular polariser.

    Parameters
    ----------
    handedness : str
        "right" or "left": the circular polarisation that passes unchanged. The other is blocked.
    xp : module, optional
        Array library of the result where no array is given; NumPy by default.
    device : optional
        Device of the result; by default the device of the arrays given.
    dtype : optional
        complex64 or complex128; by default in the widest precision of the arrays given, else in the library's default.

    Returns
    -------
    array
        Complex ``2 x 2``.

    Raises
    ------
    ValueError
        If the handedness is neither.

    Examples
    --------
    Right circular light passes, left circular light does not:

    >>> from odak.jones import circular_polarizer, electricfield
    >>> passed = [circular_polarizer("right") @ electricfield(1.0, ey) for ey in (-1j, 1j)]
    >>> [round(float((abs(field) ** 2).sum()), 6) for field in passed]
    [2.0, 0.0]
    """
    sign = {"right": 1, "left": -1}[_validate.one_of("handedness", handedness, ("right", "left"))]
    xp, dtype, _ = common(xp, device, dtype)
    return xp.asarray([[0.5, 0.5j * sign], [-0.5j * sign, 0.5]], dtype=dtype, device=device)


def mirror(
    rx: complex | Array = 1.0,
    ry: complex | Array = 1.0,
    *,
    xp: ModuleType | None = None,
    device: Device = None,
    dtype: DType = None,
) -> Array:
    """Return the Jones matrix of a mirror: diag(rx, −ry), which swaps right and left.

    Parameters
    ----------
    rx : number or array
        Amplitude reflection coefficient of the component along x, real or complex.
    ry : number or array
        Amplitude reflection coefficient of the component along y.
    xp : module, optional
        Array library of the result where no array is given; NumPy by default.
    device : optional
        Device of the result; by default the device of the arrays given.
    dtype : optional
        complex64 or complex128; by default in the widest precision of the arrays given, else in the library's default.

    Returns
    -------
    array
        Complex ``[..., 2, 2]``.

    Notes
    -----
    Coefficients of 1 describe an ideal mirror up to a common phase. At oblique incidence, with x along s,
    rx = r_s and ry = −r_p where r_p follows the convention that it equals −r_s at normal incidence.

    The reflected field propagates along a new +z. Its frame is the old one rotated about x by 180°: y changes sign, and
    an angle becomes its negative; see :func:`reverse`.

    Examples
    --------
    >>> from odak.jones import mirror
    >>> mirror().real.tolist()
    [[1.0, 0.0], [0.0, -1.0]]
    """
    xp, dtype, (rx, ry) = common(xp, device, dtype, rx=rx, ry=ry)
    rx, ry = xp.broadcast_arrays(xp.astype(rx, dtype), xp.astype(ry, dtype))
    zero = xp.zeros_like(rx)
    return stack_matrix(xp, ((rx, zero), (zero, -ry)), dtype)


def reverse(matrix: ArrayT) -> ArrayT:
    """Return the Jones matrix of a reciprocal element passed in the opposite direction, in the frame of :func:`mirror`.

    Parameters
    ----------
    matrix : array
        Jones matrices ``[..., 2, 2]``. Wave plates, polarisers and optically active crystals are reciprocal; a Faraday
        cell is not.

    Returns
    -------
    array
        diag(1, −1) · matrixᵀ · diag(1, −1) (R. C. Jones, J. Opt. Soc. Am. 31, 500 (1941)).

    Examples
    --------
    A reciprocal rotator rotates by the same angle for an observer who looks towards the source:

    >>> import numpy as np
    >>> from odak.jones import reverse, rotator
    >>> bool(np.allclose(reverse(rotator(30)), rotator(30)))
    True
    """
    matrix = square_matrix("matrix", matrix, 2)
    xp = _array.namespace(matrix)
    a, b, c, d = (matrix[..., i, j] for i in (0, 1) for j in (0, 1))
    return stack_matrix(xp, ((a, -c), (-b, d)), matrix.dtype)


def matrix_on_axes(xp: ModuleType, first: Any, second: Any, angle: Amount, dtype: DType) -> Any:
    """Return R(angle)·diag(first, second)·R(−angle), where R rotates from x towards y by degrees."""
    c, s = xp.cos(DEGREE * angle), xp.sin(DEGREE * angle)
    cross = (first - second) * (c * s)
    return stack_matrix(xp, ((first * c**2 + second * s**2, cross), (cross, first * s**2 + second * c**2)), dtype)


def stack_matrix(xp: ModuleType, rows: Any, dtype: DType) -> Any:
    """Return ``[..., n, n]`` from rows of arrays ``[...]`` that broadcast."""
    flat = xp.broadcast_arrays(*(xp.astype(entry, dtype) for row in rows for entry in row))
    size = len(rows)
    return xp.reshape(xp.stack(flat, axis=-1), (*flat[0].shape, size, size))


def common(xp: ModuleType | None = None, device: Device = None, dtype: DType = None, **values: Any) -> Any:
    """Return the namespace, the complex dtype of the result, and the values in double precision on one device."""
    given = {name: _validate.given(name, value) for name, value in values.items()}
    xp, device, real = _array.placement(*values.values(), xp=xp, device=device)
    if dtype is None:
        dtype = xp.complex128 if real == xp.float64 else xp.complex64
    elif dtype not in (xp.complex64, xp.complex128):
        raise TypeError(f"dtype must be {xp.complex64} or {xp.complex128}, got {dtype}")
    wide = {
        name: _array.converted(value, xp, device, xp.complex128 if _array.is_complex(value) else xp.float64)
        for name, value in given.items()
    }
    _validate.fitting(**wide)
    return xp, dtype, list(wide.values())


def jones_vector(field: ArrayT) -> Any:
    """Return `field` as a complex array after checking that it is ``[2]`` or ``[..., 2, k]``."""
    return _array.to_complex(_validate.shaped("field", _validate.array("field", field), "[2] or [..., 2, k]"))


def square_matrix(name: str, matrix: ArrayT, size: int) -> Any:
    """Return `matrix` as a complex array after checking that it is ``[..., size, size]``."""
    matrix = _validate.array(name, matrix)
    square_shape(name, matrix, size)
    return _array.to_complex(matrix)


def square_shape(name: str, matrix: ArrayT, size: int) -> None:
    """Raise ValueError unless `matrix` is ``[..., size, size]``."""
    _validate.shaped(name, matrix, f"[..., {size}, {size}]")


def check_angle(name: str, value: Any) -> Any:
    """Return angles after checking that they are real; arrays are checked for their type alone."""
    value = _validate.given(name, value)
    if _array.is_complex(value):
        raise TypeError(f"{name} must be real, got {value!r:.100}")
    return value


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

    Raises
    ------
    ValueError
        If the vectors are not real, of another shape, or have a negative intensity S0.

    Examples
    --------
    Light polarised linearly at 45°, of intensity 2:

    >>> import numpy as np
    >>> from odak.jones import field_from_stokes
    >>> field_from_stokes(np.asarray([2.0, 0.0, 2.0, 0.0])).real.round(6).tolist()
    [1.0, 1.0]
    """
    s0, s1, s2, s3 = _components(vector)
    xp = _array.namespace(s0)
    if _array.is_readable(s0) and bool(xp.any(s0 < 0)):
        raise ValueError(f"vector must have intensities S0 of at least 0, got {float(xp.min(s0)):.6g}")
    across = s2**2 + s3**2
    # (P + |S1|)/2 and its partner by their product, so that neither is a difference of equal numbers.
    large = (_root(s1**2 + across) + xp.abs(s1)) / 2
    some = large > 0
    small = xp.where(some, across / (4 * xp.where(some, large, xp.ones_like(large))), 0 * large)
    x = _root(xp.where(s1 < 0, small, large))
    y = _root(xp.where(s1 < 0, large, small))
    lead = _array.phasor(_direction(-s3, s2), _array.complex_dtype(s0))
    return xp.stack((xp.astype(x, lead.dtype), y * lead), axis=-1 if x.ndim == 0 else -2)


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


def depolarizer(
    kept: complex | Array = 0.0, *, xp: ModuleType | None = None, device: Device = None, dtype: DType = None
) -> Array:
    """Return the Mueller matrix of an ideal depolariser, which no Jones matrix describes.

    Parameters
    ----------
    kept : number or array
        Share of the degree of polarisation that is left, 0 … 1; ``[...]``.
    xp : module, optional
        Array library of the result where no array is given; NumPy by default.
    device : optional
        Device of the result; by default the device of the array given.
    dtype : optional
        float32 or float64; by default the precision of the array given, else the library's default.

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
    _validate.inside("kept", _validate.real("kept", kept), least=0, most=1)
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
    s0, s1, s2, s3 = _components(vector)
    xp = _array.namespace(s0)
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
    _, s1, s2, s3 = _components(vector)
    xp = _array.namespace(s1)
    linear = s1**2 + s2**2
    azimuth = _direction(s2, s1) / (2 * DEGREE)
    chi = _direction(s3, _root(linear)) / 2
    radius = _root(_root(linear + s3**2))
    return PolarizationEllipse(azimuth, chi / DEGREE, xp.sign(s3), radius * xp.cos(chi), radius * xp.abs(xp.sin(chi)))


def _components(vector: ArrayT) -> list[ArrayT]:
    """Return the four components of a Stokes vector, real arrays."""
    vector = _validate.array("vector", vector)
    axis = -1 if vector.ndim == 1 else -2
    if not vector.ndim or vector.shape[axis] != 4 or "complex" in str(vector.dtype):
        raise ValueError(f"vector must be real, [4] or [..., 4, k]; got {vector.dtype} {tuple(vector.shape)}")
    vector = _array.namespace(vector).astype(vector, _array.real_dtype(vector), copy=False)
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
