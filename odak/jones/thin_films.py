"""Reflection and transmission of stacks of thin films, for any polarisation, angle and absorption."""

from collections.abc import Sequence
from types import ModuleType
from typing import Any, NamedTuple

from odak import _array, _show, _validate
from odak._array import Amount, Array, is_array, namespace, phasor_of_cycles

_TAU = 2 * _array.numpy_namespace.pi
# Square of the phase of a film up to which series of five terms are exact.
SMALL = 1e-2


@_show.shown
class StackResponse(NamedTuple):
    """Response of a stack of thin films to a plane wave; each item is an array of the broadcast shape.

    Attributes
    ----------
    r : array
        Complex amplitude coefficient of reflection of the electric field; None for unpolarised light, which has none.
    t : array
        Complex amplitude coefficient of transmission of the electric field; None for unpolarised light.
    reflectance : array
        Fraction of the incident power that is reflected.
    transmittance : array
        Fraction of the incident power that is transmitted.
    absorptance : array
        Fraction of the incident power that is absorbed; the three add up to 1.

    Examples
    --------
    A quarter-wave film of index √1.5 on glass does not reflect:

    >>> from odak.jones import thin_film_stack
    >>> film = thin_film_stack(550e-9, [1.0, 1.5**0.5, 1.5], [550e-9 / (4 * 1.5**0.5)])
    >>> round(abs(float(film.reflectance)), 9)
    0.0
    """

    r: Any
    t: Any
    reflectance: Any
    transmittance: Any
    absorptance: Any


@_validate.takes_units(degrees=("angle",))
def thin_film_stack(
    wavelength: float | Array,
    indices: Sequence[Any],
    thicknesses: Sequence[Any],
    angle: float | Array = 0.0,
    polarization: str = "s",
) -> StackResponse:
    """Return the reflection and transmission of a plane wave by a stack of homogeneous thin films.

    Parameters
    ----------
    wavelength : float or array
        Vacuum wavelength, in the unit of `thicknesses`.
    indices : sequence of number or array
        Refractive indices: incident medium, films in the order in which the wave passes them, substrate. Complex for
        absorbing media, n + iκ with κ ≥ 0; tables with the time dependence exp(+iωt) give the conjugate, n − iκ. The
        incident medium must not absorb: a reflected fraction of power is then not defined.
    thicknesses : sequence of float or array
        Thickness of each film, at least 0: two fewer than `indices`.
    angle : float or array
        Angle of incidence in degrees, −90 … 90, in the incident medium.
    polarization : str
        "s" (electric field perpendicular to the plane of incidence), "p" (in it) or "unpolarized": the fractions of
        power are the means of both, and there are no amplitude coefficients.

    Returns
    -------
    StackResponse
        Complex amplitude coefficients and the fractions of power, of the shape that all arguments broadcast to, in
        double precision; differentiable in every argument given as a tensor.

    Raises
    ------
    ValueError, TypeError
        If an argument is outside its range, naming it.

    Notes
    -----
    Fields vary as exp(i(kz − ωt)). The tangential fields in front follow from those at the substrate by the films'
    characteristic matrices (M. Born and E. Wolf, Principles of Optics (1999), section 1.6), each times exp(iβ) of the
    film's phase thickness β = 2π·n·d·cosθ/λ, so that no number grows with the thickness of an absorbing film. The sign
    of r for p-polarised waves follows Born and Wolf: r_p = −r_s at normal incidence.

    Examples
    --------
    A quarter wave of magnesium fluoride on glass:

    >>> from odak.jones import thin_film_stack
    >>> coated = thin_film_stack(550e-9, (1.0, 1.38, 1.52), [550e-9 / 4 / 1.38])
    >>> round(float(coated.reflectance), 7)
    0.0126008
    """
    polarization = _validate.one_of("polarization", polarization, ("s", "p", "unpolarized"))
    _validate.real("angle", angle)
    _validate.inside("angle", angle, least=-90, most=90)
    xp, (wavelength, angle, *rest) = check_stack(wavelength, angle, indices, thicknesses)
    angle = angle * (_TAU / 360)
    sine, cosine = xp.sin(angle), xp.cos(angle)
    indices, thicknesses = rest[: len(indices)], rest[len(indices) :]
    states = ("s", "p") if polarization == "unpolarized" else (polarization,)
    responses = [
        stack_response(xp, wavelength, indices, thicknesses, indices[0] * sine, cosine, state) for state in states
    ]
    shape = _validate.fitting(r=responses[0].r, wavelength=wavelength)
    if len(responses) == 2:
        fractions = [(s + p) / 2 for s, p in zip(*(found[2:] for found in responses), strict=True)]
        return StackResponse(None, None, *(xp.broadcast_to(value, shape) for value in fractions))
    return StackResponse(*(xp.broadcast_to(value, shape) for value in responses[0]))


def stack_response(
    xp: ModuleType,
    wavelength: Array,
    indices: Sequence[Array],
    thicknesses: Sequence[Array],
    transverse: Array,
    cosine: Array,
    polarization: str,
) -> StackResponse:
    """Return the response to a wave of transverse index n·sinθ and cosine of the angle of incidence.

    The arguments are arrays of double precision, as :func:`check_stack` returns them.
    """
    squares = [xp.astype(n, xp.complex128) ** 2 - xp.astype(transverse, xp.complex128) ** 2 for n in indices[1:]]
    # Admittances by n·cosθ: of the tangential electric field for s, of the magnetic field for p, since neither is
    # infinite at a critical angle.
    shares = [1 / xp.astype(n, xp.complex128) ** 2 if polarization == "p" else 1.0 for n in indices]
    first, last = xp.astype(indices[0] * cosine, xp.complex128) * shares[0], _normal_index(xp, squares[-1]) * shares[-1]
    one = field = 1 + 0 * last
    other, t = last, one
    for k in range(len(thicknesses) - 1, -1, -1):
        through, c, s = _film(xp, squares[k], _TAU * thicknesses[k] / wavelength)
        field, other = c * field + s / shares[k + 1] * other, s * shares[k + 1] * squares[k] * field + c * other
        # Only their ratio counts; mirrors of many films would leave the range of numbers.
        size = xp.abs(field) + xp.abs(other)
        field, other, t = field / size, other / size, t * through / size
    total = first * field + other
    r, t = (first * field - other) / total, 2 * first * t / total
    reflectance = xp.abs(r) ** 2
    transmittance = xp.abs(t) ** 2 * (xp.real(last) / xp.real(first))
    if polarization == "p":
        t = t * (indices[0] / indices[-1])
    shape = _validate.fitting(r=r, transmittance=transmittance)
    r, t, reflectance, transmittance = (xp.broadcast_to(value, shape) for value in (r, t, reflectance, transmittance))
    return StackResponse(r, t, reflectance, transmittance, 1 - reflectance - transmittance)


def _film(xp, square, turn):
    """Return by what a film multiplies waves that pass, and cos β and −i·sin β/(n·cosθ), both scaled alike.

    `square` is that of n·cosθ, β = `turn`·n·cosθ. The scale is exp(iβ), so that nothing grows with absorption, and 1
    where β is small: there all three are series in its square, as a root has no derivative at a critical angle.
    """
    small = xp.abs(square) * turn**2 < SMALL
    normal = _normal_index(xp, xp.where(small, xp.ones_like(square), square))
    cycles = normal * turn / _TAU
    through = phasor_of_cycles(xp.real(cycles), xp.complex128) * xp.exp(-_TAU * xp.imag(cycles))
    near = xp.where(small, square * turn**2, xp.zeros_like(cycles))
    cosine = 1 - near / 2 * (1 - near / 12 * (1 - near / 30 * (1 - near / 56)))
    sinc = 1 - near / 6 * (1 - near / 20 * (1 - near / 42 * (1 - near / 72)))
    return (
        xp.where(small, xp.ones_like(through), through),
        xp.where(small, cosine, (1 + through**2) / 2),
        xp.where(small, -1j * (turn * sinc), (1 - through**2) / (2 * normal)),
    )


def _normal_index(xp, square):
    """Return n·cosθ of a medium by its square, of the branch that decays along +z."""
    root = xp.sqrt(square)
    return xp.where(xp.imag(root) < 0, -root, root)


def _check_absorption(xp, name, index) -> None:
    """Refuse an index that amplifies, and an incident medium that absorbs; of a GPU nothing is read."""
    least, most = _validate.ends(xp.imag(index)) or (0.0, 0.0)
    if least < 0:
        raise ValueError(
            f"{name} must be n + iκ with κ ≥ 0, since fields vary as exp(i(kz − ωt)); got κ = {least:.6g}: "
            "give the conjugate of an index n − iκ"
        )
    if most > 0 and name == "indices[0]":
        raise ValueError(f"indices[0], of the incident medium, must not absorb; got κ = {most:.6g}")


def check_stack(
    wavelength: Amount, angle: Amount, indices: Sequence[complex | Array], thicknesses: Sequence[Amount]
) -> tuple[ModuleType, list[Any]]:
    """Return the array namespace and all arguments as arrays of double precision on one device."""
    for name, value in (("indices", indices), ("thicknesses", thicknesses)):
        if isinstance(value, (str, bytes)) or not hasattr(value, "__len__"):
            raise TypeError(f"{name} must be a sequence of numbers or arrays, got {value!r:.100}")
    if len(indices) < 2 or len(thicknesses) != len(indices) - 2:
        raise ValueError(
            f"thicknesses must be two fewer than indices (at least 2), got {len(thicknesses)} and {len(indices)}"
        )
    _validate.real("wavelength", wavelength, positive=True)
    for k, value in enumerate(thicknesses):
        _validate.inside(f"thicknesses[{k}]", _validate.real(f"thicknesses[{k}]", value), least=0)
    values = [wavelength, angle, *indices, *thicknesses]
    names = ["wavelength", "angle", *(f"indices[{k}]" for k in range(len(indices)))]
    names += [f"thicknesses[{k}]" for k in range(len(thicknesses))]
    arrays = [value for value in values if is_array(value)]
    xp = namespace(*arrays)
    device = _array.device_of(arrays[0]) if arrays else None
    wide = []
    for name, value in zip(names, values, strict=True):
        value = _validate.given(name, value)
        is_complex = isinstance(value, complex) or "complex" in str(getattr(value, "dtype", ""))
        dtype = xp.complex128 if is_complex else xp.float64
        wide.append(xp.astype(value, dtype) if is_array(value) else xp.asarray(value, dtype=dtype, device=device))
        if name.startswith("indices"):
            if _array.is_readable(wide[-1]) and bool(xp.any(wide[-1] == 0)):
                raise ValueError(f"{name} must not be 0, got {value!r:.80}")
            if is_complex:
                _check_absorption(xp, name, wide[-1])
    _validate.fitting(**dict(zip(names, wide, strict=True)))
    return xp, wide
