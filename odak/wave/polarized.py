"""Polarised fields ``[..., 2, rows, columns]``: elements per pixel, films, longitudinal component, tight focusing.

The components along x (columns) and y (rows) are one more axis of the field, so that all methods of propagation, which
treat leading axes as a batch, propagate them. Fields vary as exp(i(kz − ωt)); Jones matrices follow the conventions of
:mod:`odak.jones`.
"""

import math
from collections.abc import Sequence
from types import ModuleType
from typing import Any

from odak import _array, _validate
from odak._array import Array, Device, cast, is_array, namespace, phasor_of_cycles
from odak._warnings import SamplingWarning, warn
from odak.jones.calculus import check_angle, matrix_on_axes, retarder, stack_matrix, stokes
from odak.jones.thin_films import check_stack, stack_response
from odak.wave.elements import grid_positions, spiral_phase
from odak.wave.transfer_functions import pitches

# Waves beyond this share of the largest transverse frequency graze the plane, and the share of power that is told.
_GRAZING, _MOST_GRAZING = 0.97, 0.01


def apply_jones(matrix: Array, field: Array) -> Array:
    """Return a polarised field behind an element.

    Parameters
    ----------
    matrix : array
        Jones matrices: one ``[2, 2]`` for the whole field, or ``[..., rows, columns, 2, 2]`` with one for each pixel
        (rows and columns may be 1), as the functions of :mod:`odak.jones` return them for arrays of angles.
    field : array
        Complex ``[..., 2, rows, columns]``.

    Returns
    -------
    array
        Complex ``[..., 2, rows, columns]``, in the field's precision and on its device.

    Raises
    ------
    ValueError
        If a shape is not as above.

    Examples
    --------
    >>> import numpy as np
    >>> from odak.jones import polarizer
    >>> from odak.wave import apply_jones
    >>> field = np.ones((2, 4, 4), dtype=np.complex128)
    >>> apply_jones(polarizer(45), field)[:, 0, 0].real
    array([1., 1.])
    """
    field = polarized_field("field", field)
    matrix = _validate.array("matrix", matrix)
    _validate.shaped("matrix", matrix, "[2, 2] or [..., rows, columns, 2, 2]")
    matrix = cast(matrix, field)
    if matrix.ndim == 2:
        matrix = matrix[None, None, ...]
    x, y = field[..., 0, :, :], field[..., 1, :, :]
    _validate.fitting(matrix=tuple(matrix.shape[:-2]), field=x)
    xp = namespace(field)
    return xp.stack(
        (matrix[..., 0, 0] * x + matrix[..., 0, 1] * y, matrix[..., 1, 0] * x + matrix[..., 1, 1] * y), axis=-3
    )


@_validate.takes_units(degrees=("angle",))
def phase_modulator(phase: Array, angle: float | Array = 0.0) -> Array:
    """Return the Jones matrices of a modulator that delays one linear polarisation, such as a liquid-crystal panel.

    Parameters
    ----------
    phase : array
        Phase in radians ``[..., rows, columns]`` that is added to the component along the modulator's axis.
    angle : float or array
        Angle of that axis in degrees, from x towards y.

    Returns
    -------
    array
        Complex ``[..., rows, columns, 2, 2]`` for :func:`apply_jones`. The component across the axis is unchanged.

    Examples
    --------
    The component across the modulator's axis is unchanged:

    >>> import numpy as np
    >>> from odak.wave import phase_modulator
    >>> matrix = phase_modulator(np.full((1, 1), np.pi / 2))[0, 0]
    >>> round(float(matrix[0, 0].imag), 6), round(float(matrix[1, 1].real), 6), round(abs(complex(matrix[0, 1])), 6)
    (1.0, 1.0, 0.0)
    """
    phase = _validate.array("phase", phase)
    angle = check_angle("angle", angle)
    xp = namespace(phase)
    dtype = _array.complex_dtype(phase)
    along = _array.phasor(xp.astype(phase, xp.float64), xp.complex128)
    angle = cast(angle, phase, xp.float64)
    return matrix_on_axes(xp, along, xp.ones_like(along), angle, dtype)


@_validate.takes_units("wavelength", "thickness", degrees=("angle",))
def birefringent_plate(
    wavelength: float | Array,
    thickness: float | Array,
    ordinary: float | Array,
    extraordinary: float | Array,
    angle: float | Array = 0.0,
) -> Array:
    """Return the Jones matrix of a uniaxial plate at normal incidence, with its optical path.

    Parameters
    ----------
    wavelength : float or array
        Vacuum wavelength in metres.
    thickness : float or array
        Thickness in metres.
    ordinary : float or array
        Refractive index across the optic axis.
    extraordinary : float or array
        Refractive index along the optic axis, which lies in the plane of the plate.
    angle : float or array
        Angle of the optic axis in degrees, from x towards y.

    Returns
    -------
    array
        Complex ``[..., 2, 2]`` of the shape that the arguments broadcast to: exp(i2π·n_e·d/λ) along the optic axis and
        exp(i2π·n_o·d/λ) across it. :func:`odak.jones.retarder` is the same matrix without the common phase.

    Examples
    --------
    A plate of thickness λ/(2·(n_e − n_o)) delays the extraordinary wave by half a wavelength:

    >>> import numpy as np
    >>> from odak.wave import birefringent_plate
    >>> matrix = birefringent_plate(500e-9, 500e-9 / (2 * 0.01), 1.5, 1.51)
    >>> round(abs(float(np.angle(matrix[0, 0] / matrix[1, 1]))) / np.pi, 6)
    1.0
    """
    given = {
        "wavelength": _validate.real("wavelength", wavelength, positive=True),
        "thickness": _validate.real("thickness", thickness),
        "ordinary": _validate.real("ordinary", ordinary),
        "extraordinary": _validate.real("extraordinary", extraordinary),
        "angle": check_angle("angle", angle),
    }
    arrays = [value for value in given.values() if is_array(value)]
    xp = namespace(*arrays)
    like = arrays[0] if arrays else xp.asarray(0.0)
    double = not arrays or any(_array.is_double(value) for value in arrays)
    wavelength, thickness, ordinary, extraordinary, angle = (cast(v, like, xp.float64) for v in given.values())
    cycles = thickness / wavelength
    along, across = (phasor_of_cycles(index * cycles, xp.complex128) for index in (extraordinary, ordinary))
    return matrix_on_axes(xp, along, across, angle, xp.complex128 if double else xp.complex64)


@_validate.takes_units(degrees=("retardance", "angle"))
def q_plate(
    shape: Sequence[int],
    charge: float,
    retardance: float | Array = 180.0,
    angle: float = 0.0,
    *,
    xp: ModuleType | None = None,
    device: Device = None,
) -> Array:
    """Return the Jones matrices of a q-plate: a retarder whose fast axis rotates with the azimuth.

    Parameters
    ----------
    shape : sequence of int
        Rows and columns; the singularity is at sample n // 2 of each axis.
    charge : float
        Rotations of the fast axis in a circle around the centre, a multiple of 1/2. A half-wave q-plate changes right
        circular polarisation into left circular with a vortex of charge 2·q, and the reverse with −2·q.
    retardance : float or array
        Retardance in degrees.
    angle : float
        Angle of the fast axis at azimuth 0, in degrees.
    xp : optional
        Array namespace, NumPy by default.
    device : optional
        Device of the result.

    Returns
    -------
    array
        Complex128 ``[rows, columns, 2, 2]`` for :func:`apply_jones` (L. Marrucci, C. Manzo and D. Paparo, Phys. Rev.
        Lett. 96, 163905 (2006)).

    Examples
    --------
    A q-plate of charge 1/2 is a half-wave plate whose axis is at 45° above the centre:

    >>> import numpy as np
    >>> from odak.wave import q_plate
    >>> matrix = q_plate((3, 3), 0.5)[2, 1]
    >>> np.round(abs(matrix), decimals=6).tolist()
    [[0.0, 1.0], [1.0, 0.0]]
    """
    charge = _validate.number("charge", charge)
    if not is_array(charge) and (2 * charge) % 1:
        raise ValueError(f"charge must be a multiple of 1/2, got {charge!r}")
    _validate.number("angle", angle)
    return retarder(retardance, spiral_phase(shape, charge, xp=xp, device=device) * (180 / math.pi) + angle)


def stokes_parameters(field: Array) -> Array:
    """Return the Stokes parameters of a polarised field.

    Parameters
    ----------
    field : array
        Complex ``[..., 2, rows, columns]``.

    Returns
    -------
    array
        Real ``[..., 4, rows, columns]``, in the convention of :func:`odak.jones.stokes`.

    Examples
    --------
    Light polarised linearly at 45°:

    >>> import numpy as np
    >>> from odak.wave import stokes_parameters
    >>> stokes_parameters(np.ones((2, 1, 1), dtype=np.complex128))[:, 0, 0].tolist()
    [2.0, 0.0, 2.0, 0.0]
    """
    field = polarized_field("field", field)
    xp = namespace(field)
    *batch, _, rows, columns = field.shape
    return xp.reshape(stokes(xp.reshape(field, (*batch, 2, rows * columns))), (*batch, 4, rows, columns))


def filter_polarized(field: Array, transfer: Array) -> Array:
    """Return a polarised field whose spectrum is multiplied by a matrix for each frequency.

    Parameters
    ----------
    field : array
        Complex ``[..., 2, rows, columns]``.
    transfer : array
        Complex ``[..., 2, 2, M, N]`` in the order of the discrete Fourier transform, M ≥ rows and N ≥ columns: the
        field is continued by zeros to this size and cut to its own again.

    Returns
    -------
    array
        Complex ``[..., 2, rows, columns]``, in the field's precision.

    Examples
    --------
    A matrix that is the same at all frequencies is an element of the whole field:

    >>> import numpy as np
    >>> from odak.jones import half_wave_plate
    >>> from odak.wave import apply_jones, filter_polarized
    >>> field = np.ones((2, 4, 4), dtype=np.complex128)
    >>> field[1] = 0
    >>> transfer = half_wave_plate(30)[:, :, None, None] * np.ones((4, 4))
    >>> bool(np.allclose(filter_polarized(field, transfer), apply_jones(half_wave_plate(30), field)))
    True
    """
    field = polarized_field("field", field)
    xp = namespace(field)
    rows, columns = field.shape[-2:]
    transfer = cast(_validate.array("transfer", transfer), field)
    _validate.shaped("transfer", transfer, "[..., 2, 2, M, N]")
    if transfer.shape[-2] < rows or transfer.shape[-1] < columns:
        raise ValueError(
            f"transfer must be at least as large as the field, {(rows, columns)}, got {transfer.shape[-2:]}"
        )
    spectrum = xp.fft.fftn(field, s=tuple(transfer.shape[-2:]), axes=(-2, -1))
    filtered = xp.sum(transfer * spectrum[..., None, :, :, :], axis=-3)
    return xp.astype(xp.fft.ifftn(filtered, axes=(-2, -1))[..., :rows, :columns], field.dtype, copy=False)


@_validate.takes_units("dx", "wavelength")
def thin_film_transfer(
    shape: Sequence[int],
    dx: float | Sequence[float],
    wavelength: float,
    indices: Sequence[Any],
    thicknesses: Sequence[Any],
    *,
    reflect: bool = False,
    xp: ModuleType | None = None,
    device: Device = None,
) -> Array:
    """Return the transfer function of a stack of thin films for the transverse components of a polarised field.

    Each plane wave of the field's spectrum has its own angle of incidence. Multiply the spectrum of a field
    ``[..., 2, rows, columns]`` by it with :func:`odak.wave.filter_polarized`.

    Parameters
    ----------
    shape : sequence of int
        Rows and columns of the (padded) field.
    dx : float or sequence of float
        Pitch in metres, one number or (rows, columns).
    wavelength : float
        Vacuum wavelength in metres.
    indices : sequence of number or array
        As many as there are media, in the order of :func:`thin_film_stack`.
    thicknesses : sequence of float or array
        Thickness of each film in metres.
    reflect : bool
        Return the transfer function of reflection instead of transmission. The reflected field is given in the
        coordinates x, y of the incident one.
    xp : optional
        Array namespace, by default the library of the arrays given, else NumPy.
    device : optional
        Device of the result where no array is given; otherwise the device of the arrays.

    Returns
    -------
    array
        Complex128 ``[2, 2, rows, columns]``, in the order of the discrete Fourier transform. Frequencies that are
        evanescent in the incident medium are 0.

    Notes
    -----
    With the transverse unit vectors p along (f_x, f_y) and s across it, the electric field of a p-polarised wave has
    the transverse part E·cosθ. The matrix is t_s·ss' + t_p·(cosθ_t/cosθ_i)·pp', and for reflection r_s·ss' − r_p·pp'.

    Examples
    --------
    At normal incidence an uncoated glass transmits the amplitude 2/(1 + n):

    >>> from odak.wave import thin_film_transfer
    >>> transfer = thin_film_transfer((8, 8), 8e-6, 532e-9, [1.0, 1.5], [])
    >>> round(abs(complex(transfer[0, 0, 0, 0])), 6)
    0.8
    """
    rows, columns = _validate.size("shape", shape)
    _validate.number("wavelength", wavelength, positive=True)
    reflect = _validate.flag("reflect", reflect)
    given, values = check_stack(wavelength, 0.0, indices, thicknesses)
    if not any(is_array(value) for value in (*indices, *thicknesses, wavelength)):
        given = given if xp is None else _validate.library("xp", xp)
        values = [
            given.asarray(value.item(), dtype=getattr(given, str(value.dtype)), device=device) for value in values
        ]
    xp = given
    wavelength, _, *rest = values
    device = _array.device_of(wavelength)
    indices, thicknesses = rest[: len(indices)], rest[len(indices) :]
    fy, fx = _frequencies(xp, (rows, columns), dx, device)
    squared = fy**2 + fx**2
    oblique = squared > 0
    norm = xp.sqrt(xp.where(oblique, squared, xp.ones_like(squared)))
    kx = wavelength * norm * oblique
    travels = kx < xp.real(indices[0])
    kx = xp.where(travels, kx, xp.zeros_like(kx))
    cosine = xp.sqrt(1 - (kx / indices[0]) ** 2)
    responses = [stack_response(xp, wavelength, indices, thicknesses, kx, cosine, which) for which in ("s", "p")]
    if reflect:
        along, across = -responses[1].r, responses[0].r
    else:
        last = xp.sqrt(xp.astype(1 - (kx / indices[-1]) ** 2, xp.complex128))
        along, across = responses[1].t * last / cosine, responses[0].t
    # At normal incidence the directions of p and s are arbitrary: p is taken along x.
    px = xp.where(oblique, fx / norm, xp.ones_like(squared))
    py = fy / norm
    blocked = xp.astype(travels, xp.float64)
    along, across = along * blocked, across * blocked
    cross = (along - across) * px * py
    rows_of_matrix = ((along * px**2 + across * py**2, cross), (cross, along * py**2 + across * px**2))
    return xp.permute_dims(stack_matrix(xp, rows_of_matrix, xp.complex128), (2, 3, 0, 1))


@_validate.takes_units("dx", "wavelength")
def longitudinal_field(
    field: Array, dx: float | Sequence[float], wavelength: float | Array, index: float | Array = 1.0
) -> Array:
    """Return the longitudinal component of a field that propagates along +z, from its transverse components.

    Parameters
    ----------
    field : array
        Complex ``[..., 2, rows, columns]``.
    dx : float or sequence of float
        Pitch in metres, one number or (rows, columns).
    wavelength : float or array
        Vacuum wavelength in metres; one number.
    index : float or array
        Refractive index of the medium; one number.

    Returns
    -------
    array
        Complex ``[..., rows, columns]``: E_z = −F⁻¹{(f_x·F{E_x} + f_y·F{E_y})/f_z}, from div E = 0, for each plane wave
        of the spectrum. Evanescent waves, whose f_z is imaginary, are included; about those that graze the plane, where
        1/f_z is infinite, its mean over a frequency's share of the spectrum is taken.

    Warns
    -----
    SamplingWarning
        If more than 1 % of the component's power is in waves within 3 % of grazing, or evanescent: a window that cuts
        the field makes such waves. The square root of this share is about the relative error. On a GPU the spectrum is
        not read.

    Notes
    -----
    Near a focus :func:`focus_polarized` gives this component of the whole field, whatever the window.

    Examples
    --------
    A wave that propagates at 30° to the axis and is polarised in the plane of incidence has |E_z/E_x| = tan 30°:

    >>> import numpy as np
    >>> from odak.wave import longitudinal_field
    >>> field = np.zeros((2, 1, 8), dtype=np.complex128)
    >>> field[0, 0] = np.exp(2j * np.pi * np.arange(8) / 8)
    >>> axial = longitudinal_field(field, 125e-9, 500e-9)
    >>> round(abs(complex(axial[0, 0])), 6), round(float(np.tan(np.pi / 6)), 6)
    (0.57735, 0.57735)
    """
    field = polarized_field("field", field)
    xp = namespace(field)
    _validate.number("wavelength", wavelength, positive=True)
    _validate.number("index", index, positive=True)
    fy, fx = _frequencies(xp, field.shape[-2:], dx, _array.device_of(field))
    limit = cast(index, field, xp.float64) / cast(wavelength, field, xp.float64)
    inverse, across = _inverse_axial_frequency(
        xp, fy, fx, [n * d for n, d in zip(field.shape[-2:], _steps("dx", dx), strict=True)], limit
    )
    spectrum = xp.fft.fftn(field, axes=(-2, -1))
    weight_x, weight_y = (cast(-f * inverse, field) for f in (fx, fy))
    result = weight_x * spectrum[..., 0, :, :] + weight_y * spectrum[..., 1, :, :]
    if _array.is_readable(result):
        power = xp.real(result) ** 2 + xp.imag(result) ** 2
        grazes = xp.astype(across > _GRAZING * limit, power.dtype)
        (grazing,), (whole,) = (_validate.numbers(xp.sum(part)) for part in (power * grazes, power))
        if grazing > _MOST_GRAZING * whole:
            warn(
                f"{100 * grazing / whole:.2g} % of the power of the longitudinal component is in waves that graze the "
                f"plane or are evanescent, as a window that cuts the field makes them: expect an error of about "
                f"{100 * math.sqrt(grazing / whole):.2g} %; take a wider window, or focus_polarized, which returns it",
                SamplingWarning,
            )
    return xp.astype(xp.fft.ifftn(result, axes=(-2, -1)), field.dtype, copy=False)


def _inverse_axial_frequency(xp, fy, fx, widths, limit):
    """Return 1/f_z, its mean along the radius over cells of a frequency that hold f_z = 0, and the radial frequency."""
    across = xp.sqrt(fy**2 + fx**2)
    axis = across == 0
    divisor = xp.where(axis, xp.ones_like(across), across)
    half = (xp.abs(fy) / widths[0] + xp.abs(fx) / widths[1]) / (2 * divisor)
    near = ~axis & (xp.abs(across - limit) < half)
    # Where it is not needed: any values whose functions are finite.
    inner, outer = xp.where(near, (across - half) / limit, 0.5), xp.where(near, (across + half) / limit, 2.0)
    # The integral of 1/√(1 − t²) is arcsin t up to 1, and from there −i·arcosh t.
    mean = _array.make_complex(math.pi / 2 - xp.asin(inner), -xp.acosh(outer)) / ((outer - inner) * limit)
    squared = xp.astype(limit**2 - across**2, xp.complex128)
    return xp.where(near, mean, 1 / xp.sqrt(xp.where(near, xp.ones_like(squared), squared))), across


@_validate.takes_units("dx", "wavelength", "focal", "target_dx", "distance", "offset")
def focus_polarized(
    field: Array,
    dx: float | Sequence[float],
    wavelength: float | Array,
    focal: float | Array,
    numerical_aperture: float | Array,
    shape: Sequence[int],
    target_dx: float | Sequence[float],
    distance: float | Array = 0.0,
    index: float | Array = 1.0,
    offset: Sequence[float] = (0.0, 0.0),
) -> Array:
    """Return the vector field near the focus of an aplanatic lens of any numerical aperture (Richards and Wolf).

    Parameters
    ----------
    field : array
        Complex ``[..., 2, rows, columns]``: the transverse components in the lens's pupil, where a ray at height h
        leaves at n·sinθ = h/focal.
    dx : float or sequence of float
        Pitch of `field` in metres, one number or (rows, columns).
    wavelength : float or array
        Vacuum wavelength in metres; one number.
    focal : float or array
        Focal length in metres; one number.
    numerical_aperture : float or array
        n·sinθ of the marginal ray, below `index`; the pupil is a disc of radius focal·numerical_aperture, with edges
        weighted by the part of a pixel that lies inside.
    shape : sequence of int
        Rows and columns of the window in the focal region.
    target_dx : float or sequence of float
        Its pitch in metres, one number or (rows, columns).
    distance : float or array
        Distance of the window behind the focus in metres. An array ``[...]`` gives the window at each of its distances,
        as leading axes that broadcast against the leading axes of the field.
    index : float or array
        Refractive index of the medium behind the lens; one number.
    offset : sequence of float
        Position (rows, columns) of the window's sample n // 2 from the focus, in metres.

    Returns
    -------
    array
        Complex ``[..., 3, *shape]``: E_x, E_y and E_z, relative to the phase of the path through the lens's centre.
        Differentiable in everything given as a tensor.

    Raises
    ------
    ValueError, TypeError
        If an argument is outside its range, naming it.

    Warns
    -----
    SamplingWarning
        If the pupil is wider than the field, or the spacing of the field's samples makes the window wider than its
        period λ·focal/dx.

    Notes
    -----
    B. Richards and E. Wolf, Proc. R. Soc. Lond. A 253, 358 (1959): the component along the radius turns with its ray,
    the one across it does not, amplitudes scale with cosθ to the power 1/2 (the sine condition at equal power), and
    the plane waves of the cone add up. The sum over the pupil is a matrix product for each axis. Its relative error is
    about 5/N² of the intensity for N samples across a pupil of high numerical aperture, 1e-3 for 70 samples.

    Examples
    --------
    >>> import numpy as np
    >>> from odak.wave import focus_polarized
    >>> pupil = np.zeros((2, 64, 64), dtype=np.complex128)
    >>> pupil[0] = 1
    >>> focus = focus_polarized(pupil, 1e-4, 532e-9, 3e-3, 0.9, (65, 65), 20e-9)
    >>> intensity = (abs(focus) ** 2).sum(axis=0)
    >>> [int(i) for i in np.unravel_index(intensity.argmax(), intensity.shape)]
    [32, 32]
    """
    field = polarized_field("field", field)
    xp, device = namespace(field), _array.device_of(field)
    for name, value in (("wavelength", wavelength), ("focal", focal), ("numerical_aperture", numerical_aperture)):
        _validate.number(name, value, positive=True)
    _validate.number("index", index, positive=True)
    _validate.real("distance", distance)
    readable = all(_array.is_readable(value) for value in (numerical_aperture, index))
    if readable and not numerical_aperture < index:
        raise ValueError(f"numerical_aperture must be below the index {index!r}, got {numerical_aperture!r}")
    targets = _validate.size("shape", shape)
    offset = _validate.several("offset", offset, 2)
    wavelength, focal, aperture, index, distance = (
        cast(value, field, xp.float64) for value in (wavelength, focal, numerical_aperture, index, distance)
    )
    steps = _steps("dx", dx)
    _, (y, x) = grid_positions(field.shape[-2:], steps, (0.0, 0.0), xp, device)
    _check_focus_sampling(field.shape[-2:], steps, focal, aperture, wavelength, targets, target_dx, offset)
    squared = x**2 + y**2
    axis = squared == 0
    radius = xp.sqrt(xp.where(axis, xp.ones_like(squared), squared))
    rim = focal * aperture
    # Half of a pixel along the radius: the coverage falls from 1 to 0 across the rim.
    half = (xp.abs(x) * steps[1] + xp.abs(y) * steps[0]) / (2 * radius)
    half = xp.where(axis, xp.full_like(half, min(steps) / 2), half)
    coverage = xp.clip((rim - xp.where(axis, xp.zeros_like(radius), radius)) / (2 * half) + 0.5, 0.0, 1.0)
    sine = xp.where(axis, xp.zeros_like(radius), xp.minimum(radius, rim)) / (focal * index)
    cosine = xp.sqrt(1 - sine**2)
    along_x, along_y = xp.where(axis, xp.ones_like(squared), x / radius), xp.where(axis, 0 * radius, y / radius)
    scale = coverage * (steps[0] * steps[1]) / (wavelength * focal * index**1.5 * xp.sqrt(cosine))
    # The field's components along and across the radius, then the three components behind the lens.
    real = _array.real_dtype(field)
    along_x, along_y, scale, lens_cosine, lens_sine = (
        xp.astype(value, real) for value in (along_x, along_y, scale, cosine, sine)
    )
    e_x, e_y = field[..., 0, :, :] * scale, field[..., 1, :, :] * scale
    radial = e_x * along_x + e_y * along_y
    across = e_y * along_x - e_x * along_y
    waves = xp.stack(
        (
            radial * lens_cosine * along_x - across * along_y,
            radial * lens_cosine * along_y + across * along_x,
            radial * lens_sine,
        ),
        axis=-3,
    )
    defocus = phasor_of_cycles(distance[..., None, None] * cosine * (index / wavelength), field.dtype)
    waves = waves * (defocus[..., None, :, :] if distance.ndim else defocus)
    to_y, to_x = (
        _plane_waves(xp, positions, count, pitch, shift, wavelength * focal, field.dtype, device)
        for positions, count, pitch, shift in zip(
            (y[:, 0], x[0, :]), targets, _steps("target_dx", target_dx), offset, strict=True
        )
    )
    return -1j * xp.matmul(xp.matmul(to_y, waves), to_x.mT)


def _plane_waves(xp, positions, count, pitch, shift, scale, dtype, device):
    """Return exp(−i2π·x·X/(λf)), ``[targets, pupil]``."""
    targets = (xp.arange(count, dtype=xp.float64, device=device) - count // 2) * pitch + shift
    return phasor_of_cycles(-targets[:, None] * positions[None, :] / scale, dtype)


def _check_focus_sampling(size, steps, focal, aperture, wavelength, targets, target_dx, offset) -> None:
    if not all(_array.is_readable(value) for value in (focal, aperture, wavelength)):
        return
    focal, aperture, wavelength = (_validate.numbers(value)[0] for value in (focal, aperture, wavelength))
    rim, period = focal * aperture, wavelength * focal
    for n, pitch, count, step, shift in zip(size, steps, targets, _steps("target_dx", target_dx), offset, strict=True):
        if rim > (n // 2) * pitch * (1 + 1e-9):
            warn(
                f"the pupil's radius focal·numerical_aperture = {rim:.4g} m exceeds the half width "
                f"{n // 2 * pitch:.4g} m of the field: a part of the pupil is not illuminated",
                SamplingWarning,
            )
        reach = count / 2 * step + abs(shift)
        if reach > period / pitch / 2 * (1 + 1e-9):
            warn(
                f"the window reaches {reach:.4g} m from the focus, beyond half the period "
                f"wavelength·focal/dx = {period / pitch:.4g} m at which the sampled pupil repeats the focus",
                SamplingWarning,
            )


def _steps(name: str, dx) -> list[Any]:
    """Return the pitches (rows, columns), each one number."""
    return [_validate.number(name, step, positive=True) for step in pitches(dx, name)]


def polarized_field(name: str, value: Any) -> Any:
    """Return a complex field after checking that it is ``[..., 2, rows, columns]``."""
    value = _array.to_complex(_validate.image(name, value, axes=3))
    _validate.shaped(name, value, "[..., 2, rows, columns]")
    return value


def _frequencies(xp, shape, dx, device):
    """Return the frequencies of the discrete Fourier transform in 1/m: rows ``[r, 1]`` and columns ``[1, c]``."""
    fy, fx = (
        xp.fft.ifftshift(xp.arange(n, dtype=xp.float64, device=device) - n // 2) / (n * pitch)
        for n, pitch in zip(shape, _steps("dx", dx), strict=True)
    )
    return fy[:, None], fx[None, :]
