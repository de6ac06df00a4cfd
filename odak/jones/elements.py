"""Jones vectors, and the matrices of the elements that light passes; conventions in :mod:`odak.jones`."""

from odak import _array, _validate
from odak._array import Array

DEGREE = _array.numpy_namespace.pi / 180


def electricfield(px: complex | Array, py: complex | Array) -> Array:
    """Return the Jones vector of the amplitudes `px` and `py`.

    Parameters
    ----------
    px, py : number or array
        Amplitudes along x and y, real or complex, of shapes that broadcast to ``[..., k]``; numbers count as ``[1]``.

    Returns
    -------
    array
        Complex ``[..., 2, k]``: ``2 x 1`` for two numbers (J. Goodman, Introduction to Fourier Optics).

    Examples
    --------
    >>> from odak.jones import electricfield
    >>> electricfield(1, 1j)
    array([[1.+0.j],
           [0.+1.j]])
    """
    xp, dtype, (px, py) = common(px=px, py=py)
    px, py = xp.broadcast_arrays(xp.astype(px, dtype), xp.astype(py, dtype))
    field = xp.stack((px, py), axis=-2 if px.ndim else 0)
    return field if px.ndim else xp.reshape(field, (2, 1))


def linearpolarizer(field: Array, rotation: complex | Array = 0) -> Array:
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


def apply_matrix(matrix: Array, field: Array) -> Array:
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
    """
    field = jones_vector(field)
    matrix = _array.cast(square_matrix("matrix", matrix, 2), field)
    xp = _array.namespace(field)
    columns = field if field.ndim > 1 else field[:, None]
    _validate.fitting(matrix=matrix[..., :1], field=columns[..., :1, :])
    return xp.matmul(matrix, columns) if field.ndim > 1 else xp.matmul(matrix, columns)[..., 0]


def cascade(*matrices: Array) -> Array:
    """Return the matrix of elements that light passes one after another, the first given first.

    Parameters
    ----------
    *matrices : array
        Jones matrices ``[..., 2, 2]`` (or Mueller matrices ``[..., 4, 4]``), at least one, of one dtype.

    Returns
    -------
    array
        The last · … · the first.
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


def polarizer(angle: complex | Array = 0.0) -> Array:
    """Return the Jones matrix of an ideal linear polariser.

    Parameters
    ----------
    angle : number or array
        Angle of its transmission axis in degrees, of shape ``[...]``.

    Returns
    -------
    array
        Complex ``[..., 2, 2]``: [[c², cs], [cs, s²]].
    """
    return diattenuator(1.0, 0.0, angle)


def diattenuator(first: complex | Array = 1.0, second: complex | Array = 0.0, angle: complex | Array = 0.0) -> Array:
    """Return the Jones matrix of a partial polariser.

    Parameters
    ----------
    first, second : number or array
        Amplitude transmission along the axis at `angle`, and across it; real or complex. Its square is the
        transmittance.
    angle : number or array
        Degrees.

    Returns
    -------
    array
        Complex ``[..., 2, 2]``; all arguments broadcast.
    """
    check_angle("angle", angle)
    xp, dtype, (first, second, angle) = common(first=first, second=second, angle=angle)
    return matrix_on_axes(xp, first, second, angle, dtype)


def retarder(retardance: complex | Array, angle: complex | Array = 0.0) -> Array:
    """Return the Jones matrix of a wave plate of any retardance.

    Parameters
    ----------
    retardance : number or array
        Phase by which the slow axis lags behind the fast one, in degrees: 360·(n_slow − n_fast)·thickness/wavelength.
    angle : number or array
        Angle of the *fast* axis in degrees.

    Returns
    -------
    array
        Complex ``[..., 2, 2]``, unitary, of determinant 1: half of the retardance on either axis.

    Examples
    --------
    >>> from odak.jones import apply_matrix, electricfield, retarder
    >>> right = apply_matrix(retarder(90, 45), electricfield(1, 0))
    >>> (right / right[0]).round(12) + 0
    array([[1.+0.j],
           [0.-1.j]])
    """
    check_angle("retardance", retardance)
    check_angle("angle", angle)
    xp, dtype, (retardance, angle) = common(retardance=retardance, angle=angle)
    slow = _array.phasor_of_cycles(retardance / 720, xp.complex128)
    return matrix_on_axes(xp, xp.conj(slow), slow, angle, dtype)


def quarter_wave_plate(angle: float | Array = 0.0) -> Array:
    """Return the Jones matrix of a quarter-wave plate, fast axis at `angle` degrees: :func:`retarder` of 90°."""
    return retarder(90.0, angle)


def half_wave_plate(angle: float | Array = 0.0) -> Array:
    """Return the Jones matrix of a half-wave plate, fast axis at `angle` degrees: :func:`retarder` of 180°."""
    return retarder(180.0, angle)


def rotator(angle: complex | Array) -> Array:
    """Return the Jones matrix that turns the polarisation, as an optically active crystal or a Faraday cell does.

    Parameters
    ----------
    angle : number or array
        Degrees, from x towards y.

    Returns
    -------
    array
        Complex ``[..., 2, 2]``: [[c, −s], [s, c]].
    """
    check_angle("angle", angle)
    xp, dtype, (angle,) = common(angle=angle)
    c, s = xp.cos(DEGREE * angle), xp.sin(DEGREE * angle)
    return stack_matrix(xp, ((c, -s), (s, c)), dtype)


def circular_polarizer(handedness: str = "right") -> Array:
    """Return the Jones matrix of an ideal (homogeneous) circular polariser.

    Parameters
    ----------
    handedness : str
        "right" or "left": the circular light that passes unchanged. The other is blocked.

    Returns
    -------
    array
        Complex128 ``2 x 2``.

    Raises
    ------
    ValueError
        If the handedness is neither.
    """
    sign = {"right": 1, "left": -1}[_validate.one_of("handedness", handedness, ("right", "left"))]
    return _array.numpy_namespace.asarray([[0.5, 0.5j * sign], [-0.5j * sign, 0.5]])


def mirror(rx: complex | Array = 1.0, ry: complex | Array = 1.0) -> Array:
    """Return the Jones matrix of a mirror: diag(rx, −ry), which swaps right and left.

    Parameters
    ----------
    rx, ry : number or array
        Amplitude reflection coefficients of the field's components along x and y, real or complex. 1 and 1 is ideal
        but for a common phase. At oblique incidence put x along s: then rx = r_s, and ry = −r_p where r_p follows the
        convention that it equals −r_s at normal incidence.

    Returns
    -------
    array
        Complex ``[..., 2, 2]``.

    Notes
    -----
    The light comes back along a new +z. Its frame is the old one turned about x by 180°, so y changes sign, and what
    lay at an angle now lies at minus that angle: see :func:`reverse`.
    """
    xp, dtype, (rx, ry) = common(rx=rx, ry=ry)
    rx, ry = xp.broadcast_arrays(xp.astype(rx, dtype), xp.astype(ry, dtype))
    zero = xp.zeros_like(rx)
    return stack_matrix(xp, ((rx, zero), (zero, -ry)), dtype)


def reverse(matrix: Array) -> Array:
    """Return the Jones matrix of a reciprocal element that light passes the other way, in the frame of :func:`mirror`.

    Parameters
    ----------
    matrix : array
        Jones matrices ``[..., 2, 2]``. Wave plates, polarisers and optically active crystals are reciprocal; a Faraday
        cell is not.

    Returns
    -------
    array
        diag(1, −1) · matrixᵀ · diag(1, −1) (R. C. Jones, J. Opt. Soc. Am. 31, 500 (1941)).
    """
    matrix = square_matrix("matrix", matrix, 2)
    xp = _array.namespace(matrix)
    a, b, c, d = (matrix[..., i, j] for i in (0, 1) for j in (0, 1))
    return stack_matrix(xp, ((a, -c), (-b, d)), matrix.dtype)


def matrix_on_axes(xp, first, second, angle, dtype):
    """Return R(angle)·diag(first, second)·R(−angle), where R turns from x towards y by degrees."""
    c, s = xp.cos(DEGREE * angle), xp.sin(DEGREE * angle)
    cross = (first - second) * (c * s)
    return stack_matrix(xp, ((first * c**2 + second * s**2, cross), (cross, first * s**2 + second * c**2)), dtype)


def stack_matrix(xp, rows, dtype):
    """Return ``[..., n, n]`` from rows of arrays ``[...]`` that broadcast."""
    flat = xp.broadcast_arrays(*(xp.astype(entry, dtype) for row in rows for entry in row))
    size = len(rows)
    return xp.reshape(xp.stack(flat, axis=-1), (*flat[0].shape, size, size))


def common(**values):
    """Return the namespace, the complex dtype of the result, and the values in double precision on one device."""
    arrays = [value for value in values.values() if _array.is_array(value)]
    xp = _array.namespace(*arrays)
    double = not arrays or any(_array.is_double(array) for array in arrays)
    device = _array.device_of(arrays[0]) if arrays else None
    wide = {}
    for name, value in values.items():
        array = _validate.given(name, value)
        value = array if _array.is_array(value) else xp.asarray(array, device=device)
        wide[name] = xp.astype(value, xp.complex128 if "complex" in str(value.dtype) else xp.float64)
    _validate.fitting(**wide)
    return xp, xp.complex128 if double else xp.complex64, list(wide.values())


def jones_vector(field):
    """Return `field` as a complex array after checking that it is ``[2]`` or ``[..., 2, k]``."""
    field = _validate.array("field", field)
    axis = -1 if field.ndim == 1 else -2
    if not field.ndim or field.shape[axis] != 2:
        raise ValueError(f"field must be [2] or [..., 2, k], got {tuple(field.shape)}")
    return _array.to_complex(field)


def square_matrix(name: str, matrix, size: int):
    """Return `matrix` as a complex array after checking that it is ``[..., size, size]``."""
    matrix = _validate.array(name, matrix)
    square_shape(name, matrix, size)
    return _array.to_complex(matrix)


def square_shape(name: str, matrix, size: int) -> None:
    """Raise ValueError unless `matrix` is ``[..., size, size]``."""
    if tuple(matrix.shape[-2:]) != (size, size):
        raise ValueError(f"{name} must be [..., {size}, {size}], got {tuple(matrix.shape)}")


def check_angle(name: str, value):
    """Return angles after checking that they are real; arrays are checked for their type alone."""
    value = _validate.given(name, value)
    if isinstance(value, complex) or "complex" in str(getattr(value, "dtype", "")):
        raise TypeError(f"{name} must be real, got {value!r:.100}")
    return value
