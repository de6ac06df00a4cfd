"""First-order properties by ABCD matrices, in float64, differentiable and for batches of systems."""

import math
from itertools import pairwise
from typing import Any, NamedTuple

import torch

from odak import _array, _show, _validate
from odak._array import is_readable
from odak.learn.raytracing.system.crystals import UniaxialMedium
from odak.learn.raytracing.system.films import PolarizingFilm
from odak.learn.raytracing.system.prescriptions import Prescription, checked_prescription
from odak.learn.raytracing.system.specification import (
    Conjugates,
    SystemAperture,
    SystemRecord,
    Wavelengths,
    condition,
    largest_of,
)
from odak.learn.raytracing.system.surfaces import Coating, checked_system, is_break, numbers_of, optical_system, surface
from odak.raytracing.gradients import AxialGradient, RadialGradient, step

SEIDEL_STEPS = 20


@_show.shown
class FirstOrder(NamedTuple):
    """First-order properties of a system at one wavelength; each ``[...]``, with the axes of the batch of systems.

    Attributes
    ----------
    focal_length : torch.Tensor
        1/power; positive if the system converges light, mirrors included. Programs that state f′ = n′·(1/power) with
        n′ = −1 after an odd number of mirrors have a negative one for a concave mirror.
    back_focal_distance, front_focal_distance : torch.Tensor
        From the last vertex to the rear focal point, from the first vertex to the front one (negative in front).
    rear_principal_plane, front_principal_plane : torch.Tensor
        From the last and the first vertex.
    entrance_pupil_distance, entrance_pupil_diameter : torch.Tensor
        Distance from the first vertex.
    exit_pupil_distance, exit_pupil_diameter : torch.Tensor
        Distance from the last vertex.
    stop_diameter : torch.Tensor
        Diameter of the beam in the stop.
    image_distance : torch.Tensor
        From the last vertex to the paraxial image.
    magnification : torch.Tensor
        Lateral; 0 for an object at infinity.
    f_number, working_f_number : torch.Tensor
        Focal length over entrance pupil; 1/(2·n′u′) of the marginal ray.
    numerical_aperture : torch.Tensor
        n′·sin u′ of the marginal ray, tan u′ being its paraxial slope.

    Examples
    --------
    The f-number is the focal length over the diameter of the entrance pupil:

    >>> from odak.learn.raytracing.system import FirstOrder, first_order, load_system
    >>> lens = load_system("cooke_triplet")
    >>> found = first_order(lens)
    >>> round(float(found.focal_length / found.entrance_pupil_diameter - found.f_number), 9)
    0.0
    """

    focal_length: torch.Tensor
    back_focal_distance: torch.Tensor
    front_focal_distance: torch.Tensor
    rear_principal_plane: torch.Tensor
    front_principal_plane: torch.Tensor
    entrance_pupil_distance: torch.Tensor
    entrance_pupil_diameter: torch.Tensor
    exit_pupil_distance: torch.Tensor
    exit_pupil_diameter: torch.Tensor
    stop_diameter: torch.Tensor
    image_distance: torch.Tensor
    magnification: torch.Tensor
    f_number: torch.Tensor
    working_f_number: torch.Tensor
    numerical_aperture: torch.Tensor

    def _repr_html_(self) -> str:
        return _show.fields_html(self, "First order, lengths in the unit of the system")


class Matrix(NamedTuple):
    """Elements of an ABCD matrix on (y, n·u), each a tensor of one shape."""

    a: torch.Tensor
    b: torch.Tensor
    c: torch.Tensor
    d: torch.Tensor

    def then_surface(self, power: torch.Tensor) -> "Matrix":
        """Return the matrix with a surface of this power behind it."""
        return Matrix(self.a, self.b, self.c - power * self.a, self.d - power * self.b)

    def then(self, a: Any, b: Any, c: Any, d: Any) -> "Matrix":
        """Return the matrix with another one behind it."""
        first, second = self.a * a + self.c * b, self.b * a + self.d * b
        return Matrix(first, second, self.a * c + self.c * d, self.b * c + self.d * d)

    def then_gap(self, reduced: torch.Tensor) -> "Matrix":
        """Return the matrix with a gap of this thickness over index behind it."""
        return Matrix(self.a + reduced * self.c, self.b + reduced * self.d, self.c, self.d)


@_validate.takes_units()
def first_order(
    system: optical_system,
    wavelength: float | None = None,
    prescription: Prescription | None = None,
    *,
    axis: str = "y",
) -> FirstOrder:
    """Return the first-order properties of a system.

    Parameters
    ----------
    system : optical_system
        The system.
    wavelength : float, optional
        In the system's unit; its reference wavelength by default.
    prescription : Prescription, optional
        Numbers in place of the system's own, a batch of systems perhaps; with indices for one wavelength, or for
        the wavelengths of the system.
    axis : str
        "y" or "x": the section in which the curvatures of cylinders, toroids and other surfaces without rotational
        symmetry are taken.

    Returns
    -------
    FirstOrder
        float64, differentiable in the numbers.

    Raises
    ------
    ValueError
        If a graded medium continues behind a mirror or a coordinate break, or reaches the image.

    Notes
    -----
    Kingslake and Johnson, Lens Design Fundamentals (2010), chapter 3; after a mirror, index and thickness change sign.
    The r² term of an asphere adds 2a₁ to the curvature. Shifts, tilts and coordinate breaks are ignored. The focal
    length of an afocal system is infinite.

    Examples
    --------
    >>> from odak.learn.raytracing.system import first_order, load_system
    >>> round(float(first_order(load_system("cooke_triplet")).focal_length), 1)
    50.0
    """
    checked_system(system), checked_prescription(prescription)
    section = "xy".index(_validate.one_of("axis", axis, ("x", "y")))
    wavelength = None if wavelength is None else _validate.constant("wavelength", wavelength, positive=True)
    p = _at_one_wavelength(system, wavelength, prescription)
    check_media(system, p)
    check_image_space(system, p)
    index = signed_indices(system, p)
    whole = matrix(p, index, 0, len(system.surfaces), axis=section)
    after = matrix(p, index, system.stop, len(system.surfaces), axis=section)
    n, behind = index[..., 0], index[..., -1]
    pupil = entrance_pupil(system, wavelength, prescription, section)
    # The axial ray is scaled to the radius of the pupil.
    axial, slope = _axial_ray(system, whole, n)
    scale = pupil.reach
    slope = slope * scale
    numerical = behind.abs() * torch.sin(torch.atan((slope / behind).abs()))
    return FirstOrder(
        focal_length=-1 / whole.c,
        back_focal_distance=-behind * whole.a / whole.c,
        front_focal_distance=n * whole.d / whole.c,
        rear_principal_plane=behind * (1 - whole.a) / whole.c,
        front_principal_plane=n * (whole.d - 1) / whole.c,
        entrance_pupil_distance=pupil.distance,
        entrance_pupil_diameter=2 * pupil.radius,
        exit_pupil_distance=-behind * after.b / after.d,
        exit_pupil_diameter=2 * (pupil.stop_radius / after.d).abs(),
        stop_diameter=2 * pupil.stop_radius,
        image_distance=-behind * axial * scale / slope,
        magnification=torch.zeros_like(n) if system.at_infinity else n * scale / slope,
        f_number=(-1 / whole.c).abs() / (2 * pupil.radius),
        working_f_number=1 / (2 * slope.abs()),
        numerical_aperture=numerical,
    )


def image_distances(system: optical_system, p: Prescription) -> torch.Tensor:
    """Return the paraxial distance of the image from the last surface at each wavelength, ``[..., W]``."""
    check_media(system, p)
    check_image_space(system, p)

    def distance(one: Prescription) -> torch.Tensor:
        index = signed_indices(system, one)
        height, slope = _axial_ray(system, matrix(one, index, 0, len(system.surfaces)), index[..., 0])
        return -index[..., -1] * height / slope

    if any(group is not None for group in (p.shapes, p.phases, p.gradients)):
        return torch.stack([distance(p.at(i)) for i in range(p.index.shape[-2])], -1)
    # The wavelengths as further systems of the batch.
    rows = {name: getattr(p, name).unsqueeze(-2) for name in ("curvature", "conic", "thickness", "index")}
    return distance(p._replace(coefficients=p.coefficients.unsqueeze(-3), **rows))


@_show.shown
class ParaxialRays(NamedTuple):
    """Marginal and chief ray of first-order optics; the axis S + 1 counts surfaces, the image last.

    Attributes
    ----------
    marginal_height, chief_height : torch.Tensor
        At the surfaces, ``[..., S + 1]``.
    marginal_slope, chief_slope : torch.Tensor
        In front of them, dy/dz.

    Examples
    --------
    >>> from odak.learn.raytracing.system import ParaxialRays, load_system, paraxial_rays
    >>> isinstance(paraxial_rays(load_system("singlet")), ParaxialRays)
    True
    """

    marginal_height: torch.Tensor
    marginal_slope: torch.Tensor
    chief_height: torch.Tensor
    chief_slope: torch.Tensor


def paraxial_rays(
    system: optical_system, field: float | torch.Tensor | None = None, prescription: Prescription | None = None
) -> ParaxialRays:
    """Return the paraxial marginal and chief ray at the reference wavelength: the axes of a y–ȳ diagram.

    Parameters
    ----------
    system : optical_system
        The system.
    field : float, optional
        Field angle in degrees, or object height for a near object; by default the largest of the system's. At 90
        degrees and beyond the slope of the chief ray is the angle, as for an image of height f·θ.
    prescription : Prescription, optional
        Numbers in place of the system's own, a batch of systems perhaps.

    Returns
    -------
    ParaxialRays
        float64, differentiable. The chief ray vanishes at the stop, the marginal ray at the paraxial image.

    Notes
    -----
    E. Delano, Appl. Opt. 2, 1251 (1963). n(ȳ′y − y′ȳ) is the same in all spaces.

    Examples
    --------
    >>> from odak.learn.raytracing.system import load_system, paraxial_rays
    >>> lens = load_system("cooke_triplet")
    >>> abs(float(paraxial_rays(lens).chief_height[lens.stop])) < 1e-9
    True
    """
    checked_system(system), checked_prescription(prescription)
    p = _at_one_wavelength(system, None, prescription)
    check_media(system, p)
    index = signed_indices(system, p)
    starts = _starts(system, entrance_pupil(system, prescription=p), field)
    found: list[list[torch.Tensor]] = [[], [], [], []]
    for i in range(len(system.surfaces) + 1):
        whole = matrix(p, index, 0, i, gap=True)
        for k, (y, u) in enumerate(starts):
            found[2 * k].append(whole.a * y + whole.b * index[..., 0] * u)
            found[2 * k + 1].append((whole.c * y + whole.d * index[..., 0] * u) / index[..., i])
    return ParaxialRays(*(torch.stack(torch.broadcast_tensors(*values), -1) for values in found))


def _starts(system: optical_system, pupil: "EntrancePupil", field: float | torch.Tensor | None) -> tuple[Any, Any]:
    """Return height and slope in front of the first surface, of the marginal ray and of the chief ray of a field."""
    size = largest_of(system.fields) if field is None else condition("field", field)
    if system.at_infinity:
        slope = _field_slope(size) + 0 * pupil.distance
        return (pupil.radius, 0 * pupil.radius), (-pupil.distance * slope, slope)
    slope = -size * pupil.bend
    return (system.object_distance * pupil.reach, pupil.reach), (size + system.object_distance * slope, slope)


def _field_slope(angle: Any) -> Any:
    """Return the slope of the paraxial chief ray of a field angle in degrees; where it has no tangent, the angle."""
    if isinstance(angle, torch.Tensor):
        return torch.where(angle.abs() < 90, torch.tan(torch.deg2rad(angle)), torch.deg2rad(angle))
    return math.tan(math.radians(angle)) if abs(angle) < 90 else math.radians(angle)


class EntrancePupil(NamedTuple):
    """Entrance pupil in a form that holds for a pupil at infinity as well; each ``[...]``.

    Attributes
    ----------
    distance, radius : torch.Tensor
        Of the pupil, from the first vertex.
    reach : torch.Tensor
        Of the marginal ray: its height in the pupil for an object at infinity, its slope for a near one.
    bend : torch.Tensor
        One over the distance from a near object to the pupil.
    stop_radius : torch.Tensor
        Radius of the beam in the stop.
    middle : tuple of torch.Tensor
        Its centre (x, y) where the stop is shifted, in the coordinates of `reach`.
    """

    distance: torch.Tensor
    radius: torch.Tensor
    reach: torch.Tensor
    bend: torch.Tensor
    stop_radius: torch.Tensor
    middle: tuple[torch.Tensor, torch.Tensor]


def entrance_pupil(
    system: optical_system, wavelength: float | None = None, prescription: Prescription | None = None, axis: int = 1
) -> EntrancePupil:
    """Return the entrance pupil of a system.

    Parameters
    ----------
    system : optical_system
        The system.
    wavelength : float, optional
        In the system's unit; its reference wavelength by default.
    prescription : Prescription, optional
        Numbers in place of the system's own.
    axis : int
        Of :func:`matrix`.
    """
    p = _at_one_wavelength(system, wavelength, prescription)
    by_image = system.aperture_type == "F-number" or (system.aperture_type == "NA" and system.at_infinity)
    check_media(system, p, None if by_image else system.stop)
    index = signed_indices(system, p)
    before = matrix(p, index, 0, system.stop, gap=True, axis=axis)
    # An aperture in object space, of an object at infinity, does not depend on the surfaces behind the stop.
    whole = matrix(p, index, 0, len(system.surfaces), axis=axis) if by_image or not system.at_infinity else before
    n = index[..., 0]
    distance = n * before.b / before.a
    if system.at_infinity:
        reach = _far_reach(system, whole, n, before.a)
        middle = _middle(system, p, before.a)
        return EntrancePupil(distance, reach, reach, 0 * n, (reach * before.a).abs(), middle)
    # Height in the stop of the axial ray of slope 1.
    to_stop = before.a * system.object_distance + n * before.b
    bend = 0 * to_stop if system.telecentric else before.a / to_stop
    reach = _near_reach(system, whole, n, bend, to_stop)
    middle = _middle(system, p, to_stop)
    return EntrancePupil(distance, (reach / bend).abs(), reach, bend, (reach * to_stop).abs(), middle)


def _middle(system, p: Prescription, scale) -> tuple[torch.Tensor, torch.Tensor]:
    """Return the centre of the entrance pupil for a shifted stop, `scale` heights in the stop per coordinate."""
    shift = p.shift[..., system.stop, :] if p.shift is not None else torch.zeros(2, dtype=scale.dtype).to(scale)
    return shift[..., 0] / scale, shift[..., 1] / scale


def _at_one_wavelength(system, wavelength, prescription):
    if prescription is None:
        chosen = system.wavelengths[system.reference] if wavelength is None else wavelength
        return system.prescription([chosen])
    if wavelength is not None and prescription.index.shape[-2] > 1:
        raise ValueError("wavelength must be left out where prescription holds several")
    return prescription.at(system.reference)


def check_media(system: optical_system, p: Prescription, last: int | None = None) -> None:
    """Raise ValueError for a graded medium in front of surface `last` that continues behind a mirror or a break."""
    for i, gradient in enumerate((p.gradients or ())[:last]):
        following = system.surfaces[i + 1] if gradient is not None and i + 1 < len(system.surfaces) else None
        if following is not None and (is_break(following) or following.reflects):
            kind = "coordinate break" if is_break(following) else "mirror"
            raise ValueError(
                f"surfaces[{i}] has a graded medium behind it that continues behind a {kind}, surfaces[{i + 1}]: no "
                "paraxial properties"
            )


def check_image_space(system: optical_system, p: Prescription) -> None:
    """Raise ValueError if the image lies in a graded medium, where the rays are curved."""
    i = len(system.surfaces) - 1
    while i > 0 and (is_break(system.surfaces[i]) or system.surfaces[i].reflects):
        i -= 1
    if p.gradients is not None and p.gradients[i] is not None:
        raise ValueError(
            f"surfaces[{i}] has a graded medium behind it that reaches the image: end it by a plane surface in front "
            "of the image"
        )


def signed_indices(system: optical_system, p: Prescription) -> torch.Tensor:
    """Return the indices at the first wavelength, ``[..., S + 1]``, negative after an odd number of mirrors."""
    signs, sign = [1.0], 1.0
    for item in system.surfaces:
        sign = -sign if item.reflects else sign
        signs.append(sign)
    return p.index[..., 0, :] * torch.tensor(signs, dtype=torch.float64, device=p.index.device)


def matrix(p: Prescription, index: torch.Tensor, start: int, stop: int, gap: bool = False, axis: int = 1) -> Matrix:
    """Return the matrix of surfaces `start` to `stop` − 1, optionally with the gap behind the last of them.

    In the section along x (`axis` 0) or along y (1).
    """
    one = torch.ones(p.batch, dtype=torch.float64, device=index.device)
    found = Matrix(one, 0 * one, 0 * one, one)
    # Indices at the vertices: a graded medium has others than its material, and different ones at its two ends.
    graded = None if start == 0 or p.gradients is None else _graded_gap(p, index, start - 1, axis)
    for i in range(start, stop):
        before = index[..., i] if graded is None else graded[4][1]
        graded = None if p.gradients is None else _graded_gap(p, index, i, axis)
        behind = index[..., i + 1] if graded is None else graded[4][0]
        power = (behind - before) * p.shape(i).curvatures()[axis]
        if p.phases is not None and p.phases[i] is not None and p.wavelengths is not None:
            power = power + p.phases[i].powers(p.wavelengths[0])[axis]
        found = found.then_surface(power)
        if i + 1 < stop or gap:
            if graded is None:
                found = found.then_gap(p.thickness[..., i] / index[..., i + 1])
            else:
                found = found.then(*graded[:4])
    return found


def _graded_gap(p: Prescription, index: torch.Tensor, i: int, axis: int):
    """Return the matrix elements and the end indices of a graded medium behind surface `i`, None for a plain one."""
    gradient = p.gradients[i]  # type: ignore[index]
    if gradient is None:
        return None
    _check_forward(index, i)
    if axis == 0 and isinstance(gradient, UniaxialMedium):
        gradient = gradient.turned()
    return gradient.paraxial(index[..., i + 1], p.thickness[..., i])


def _check_forward(index: torch.Tensor, i: int) -> None:
    if is_readable(index) and bool((index[..., i + 1] < 0).any()):
        raise ValueError(
            f"surfaces[{i}] has a graded medium behind an odd number of mirrors: no first-order properties"
        )


def _axial_ray(system, whole: Matrix, n):
    """Return height and n′u′ behind the last surface of the axial ray: of height 1 in front, or of slope 1."""
    if system.at_infinity:
        return whole.a, whole.c
    height, slope = system.object_distance, n
    return whole.a * height + whole.b * slope, whole.c * height + whole.d * slope


def _near_reach(system, whole: Matrix, n, bend, to_stop):
    """Return the slope of the marginal ray of a near object."""
    size = system.aperture
    if system.aperture_type == "NA":
        return torch.tan(torch.asin(size / n))
    if system.aperture_type == "stop":
        return (size / 2 / to_stop).abs()
    if _array.is_readable(bend) and bool((bend == 0).any()):
        kind = system.aperture_type
        raise ValueError(f'aperture_type must be "NA" or "stop", got {kind!r}: the entrance pupil is at infinity')
    return (size / 2 if system.aperture_type == "EPD" else (1 / whole.c).abs() / (2 * size)) * bend


def _far_reach(system, whole: Matrix, n, place):
    """Return the radius of the entrance pupil of an object at infinity."""
    size = system.aperture
    if system.aperture_type == "EPD":
        return size / 2 + 0 * n
    if system.aperture_type == "stop":
        return (size / 2 / place).abs()
    return (1 / whole.c).abs() * (1 / (2 * size) if system.aperture_type == "F-number" else size)


@_show.shown
class ThirdOrder(NamedTuple):
    """Third-order and chromatic aberrations; the axis S counts surfaces.

    Attributes
    ----------
    seidel : torch.Tensor
        Seidel coefficients of the wavefront of each surface, ``[..., 5, S]``: spherical aberration, coma, astigmatism,
        Petzval curvature, distortion.
    chromatic : torch.Tensor
        Axial and lateral colour of each surface, ``[..., 2, S]``, between the shortest and the longest wavelength.
    transverse : dict
        Sums over all surfaces as transverse aberrations in the image: "SA" (spherical aberration), "TCO" (tangential
        coma), "TAS" and "SAS" (tangential and sagittal astigmatism), "PTB" (Petzval blur), "DST" (distortion), "AX" and
        "LAT" (axial and lateral colour).

    Examples
    --------
    >>> from odak.learn.raytracing.system import ThirdOrder, load_system, seidel_sums
    >>> lens = load_system("cooke_triplet")
    >>> tuple(seidel_sums(lens).seidel.shape)
    (5, 6)
    """

    seidel: torch.Tensor
    chromatic: torch.Tensor
    transverse: dict[Any, Any]


def seidel_sums(
    system: optical_system, field: float | torch.Tensor | None = None, prescription: Prescription | None = None
) -> ThirdOrder:
    """Return the Seidel coefficients of a system by surface, and the corresponding transverse aberrations.

    Parameters
    ----------
    system : optical_system
        A system of rotationally symmetric surfaces.
    field : float, optional
        Field angle in degrees, or object height for a near object; by default the largest of the system's. At 90
        degrees and beyond the slope of the chief ray is the angle, as for an image of height f·θ.
    prescription : Prescription, optional
        Numbers in place of the system's own, with the indices of all wavelengths.

    Returns
    -------
    ThirdOrder
        float64, differentiable in the numbers.

    Raises
    ------
    ValueError
        If a surface is not a plane, a conic or an even asphere, is shifted or tilted, or has a phase; if a graded
        medium is neither radial nor axial, continues behind a mirror or a coordinate break, or extends to the image.

    Notes
    -----
    The coefficients follow from the paraxial marginal and chief rays (Welford, Aberrations of Optical Systems (1986),
    chapter 8 and section 10.2). Of aspheres the terms r² and r⁴ contribute, with the stop shift of section 8.5.
    Lateral colour "LAT" and distortion are heights in the image plane. Coordinate breaks are ignored: the
    sums describe the unfolded system.

    The contribution of a graded medium (P. J. Sands, J. Opt. Soc. Am. 60, 1436 (1970)) is included in the contribution
    of the surface in front of it. It is the integral of the fourth-order part of the optical Hamiltonian along both
    rays, less its value in a homogeneous medium, and a surface term due to the variation of the index over the sag.

    Examples
    --------
    >>> from odak.learn.raytracing.system import load_system, seidel_sums
    >>> tuple(seidel_sums(load_system("cooke_triplet")).seidel.shape)
    (5, 6)
    """
    p = numbers_of(system, prescription)
    if any(group is not None and any(group) for group in (p.shapes, p.phases)):
        raise ValueError("system must consist of planes, conics and even aspheres without diffractive phases")
    media = p.gradients or (None,) * len(system.surfaces)
    for i, gradient in enumerate(media):
        if gradient is not None and not isinstance(gradient, (RadialGradient, AxialGradient)):
            raise ValueError(f"surfaces[{i}] must have a radial or an axial gradient, got {type(gradient).__name__}")
    check_media(system, p)
    check_image_space(system, p)
    for i, item in enumerate(system.surfaces):
        if item.is_off_axis and not is_break(item):
            raise ValueError(f"surfaces[{i}] is shifted or tilted: Seidel sums are defined for centred systems")
    one = p.at(system.reference)
    n = signed_indices(system, one)
    waves = list(system.wavelengths) if p.wavelengths is None else p.wavelengths.tolist()
    waves = waves if len(waves) == p.index.shape[-2] else [0.0]
    ends = [p.index[..., waves.index(wave), :] for wave in (min(waves), max(waves))]
    spread = (ends[0] - ends[1]) * n / one.index[..., 0, :]
    (y, u), (yb, ub) = _starts(system, entrance_pupil(system, prescription=one), field)
    sums, colours = [], []
    invariant = n[..., 0] * (ub * y - u * yb)
    # Index on the axis in front of a surface; derivatives by r² and by z of the index there.
    before, radial, axial = n[..., 0], 0.0, 0.0
    for i in range(len(system.surfaces)):
        behind, radial_behind, axial_behind = n[..., i + 1], 0.0, 0.0
        if media[i] is not None:
            _check_forward(n, i)
            behind, radial_behind, axial_behind = _index_at(media[i], n[..., i + 1], 0 * one.thickness[..., i])
        c = one.shape(i).curvatures()[1]
        a, ab = before * (u + y * c), before * (ub + yb * c)
        power = (behind - before) * c
        un, ubn = (before * u - y * power) / behind, (before * ub - yb * power) / behind
        change = un / behind - u / before
        curl = 1 / behind - 1 / before
        s1, s2, s3 = -a * a * y * change, -a * ab * y * change, -ab * ab * y * change
        s4 = -invariant * invariant * c * curl
        squares = 1 / (behind * behind) - 1 / (before * before)
        s5 = -ab * (ab * ab * squares * y - (invariant + ab * y) * yb * c * curl)
        # Terms of r⁴ beyond the sphere of the same vertex curvature.
        k, base = one.conic[..., i], one.curvature[..., i]
        fourth = one.coefficients[..., i, 1] if one.coefficients.shape[-1] > 1 else 0 * base
        extra = 8 * ((1 + k) * base**3 / 8 + fourth - c**3 / 8) * (behind - before)
        # The index changes over the sag.
        extra = extra + 4 * c * (radial_behind - radial) + c * c * (axial_behind - axial)
        s1, s2 = s1 + extra * y**4, s2 + extra * y**3 * yb
        s3, s5 = s3 + extra * y * y * yb * yb, s5 + extra * y * yb**3
        sums.append(torch.stack(torch.broadcast_tensors(s1, s2, s3, s4, s5), -1))
        dispersion = spread[..., i + 1] / behind - spread[..., i] / before
        colours.append(torch.stack(torch.broadcast_tensors(a * y * dispersion, ab * y * dispersion), -1))
        gap = one.thickness[..., i]
        before, radial, axial = behind, radial_behind, axial_behind
        if media[i] is None:
            y, yb, u, ub = y + gap * un, yb + gap * ubn, un, ubn
            continue
        rays = torch.broadcast_tensors(y, behind * un, yb, behind * ubn)
        (y, u, yb, ub), added, dispersed = _graded_sums(media[i], n[..., i + 1], spread[..., i + 1], gap, rays)
        sums[-1], colours[-1] = sums[-1] + added, colours[-1] + dispersed
        before, radial, axial = _index_at(media[i], n[..., i + 1], gap)
        u, ub = u / before, ub / before
    seidel, chromatic = torch.stack(sums, -1), torch.stack(colours, -1)
    scale = 1 / (before * u)
    s = [scale * value for value in seidel.sum(-1).unbind(-1)]
    axial, lateral = (scale * value for value in chromatic.sum(-1).unbind(-1))
    transverse = {
        "SA": s[0] / 2,
        "TCO": 3 * s[1] / 2,
        "TAS": (3 * s[2] + s[3]) / 2,
        "SAS": (s[2] + s[3]) / 2,
        "PTB": s[3] / 2,
        "DST": s[4] / 2,
        "AX": axial,
        "LAT": lateral,
    }
    return ThirdOrder(seidel, chromatic, transverse)


def _index_at(gradient, base, z) -> tuple[Any, ...]:
    """Return the index on the axis at a depth in a graded medium, and its derivatives by r² and by z."""
    squared, second, _, along = gradient.expansion(z, base)
    index = squared.sqrt()
    return index, second / (2 * index), along / (2 * index)


def _graded_sums(gradient, base, spread, thickness, rays) -> tuple[Any, ...]:
    """Return the two paraxial rays behind a graded medium, and its Seidel and chromatic sums.

    Parameters
    ----------
    gradient : Gradient
        The medium, n² = N + A·r² + B·r⁴.
    base, spread, thickness : torch.Tensor
        Index of the material, its difference between the outer wavelengths, and length along the axis.
    rays : sequence of torch.Tensor
        Heights y and optical direction cosines p of the marginal ray, then of the chief ray.

    Notes
    -----
    The Hamiltonian −√(n² − p²) has the fourth-order part (A·r² − p²)²/(8n³) − B·r⁴/(2n), n on the axis. In a
    homogeneous medium its integral is the change of (r·p)·p²/(8n²), which the sums of the surfaces contain, beside
    multiples of the invariant times the products of slopes: H·u²/4, H·u·ū/2 and 3H·ū²/4 in coma, astigmatism and
    distortion.
    """
    zero = 0 * (base + thickness + rays[0])

    def forms(y, p, yb, pb, second):
        """Return A·r² − p² and r·p as coefficients of ρ², ρ·h and h²."""
        first = second * y * y - p * p, 2 * (second * y * yb - p * pb), second * yb * yb - pb * pb
        return first, (y * p, y * pb + yb * p, yb * pb)

    def seidel(first, other):
        """Return the five sums of a product of two such forms."""
        (a, b, c), (d, e, f) = first, other
        astigmatism = 2 * b * e
        field = 4 * (a * f + c * d) - astigmatism
        return torch.stack([8 * a * d, 2 * (a * e + b * d), astigmatism, field, 2 * (b * f + c * e)], -1)

    def ends(y, p, yb, pb, z):
        index = gradient.expansion(z + zero, base)[0].sqrt()
        squares, product = p * p, (y * p, y * pb + yb * p, yb * pb)
        inside = seidel(product, (squares, 2 * p * pb, pb * pb)) / (8 * index * index)[..., None]
        invariant = pb * y - p * yb
        slopes = torch.stack([zero, squares / 4, p * pb / 2, zero, 3 * pb * pb / 4], -1)
        inside = inside + slopes * (invariant / (index * index))[..., None]
        # The share of the surfaces in the lateral colour is 𝓗·δn/(2n) beyond half of the sum over both rays.
        colour = torch.stack([2 * product[0], product[1] + invariant], -1) * (spread / (2 * index))[..., None]
        return inside, colour

    def field(state):
        y, p, yb, pb, z = state[:5]
        squared, second, fourth, _ = gradient.expansion(z, base)
        index = squared.sqrt()
        bent, _ = forms(y, p, yb, pb, second)
        heights = (y * y, 2 * y * yb, yb * yb)
        rate = (
            seidel(bent, bent) / (8 * index**3)[..., None]
            - seidel(heights, heights) * (fourth / (2 * index))[..., None]
        )
        pull = spread / (2 * squared)
        colour = -2 * pull * (p * p + second * y * y), -2 * pull * (p * pb + second * y * yb)
        moved = p / index, second * y / index, pb / index, second * yb / index, 1 + 0 * z
        return torch.stack([*moved, *rate.unbind(-1), *colour])

    state = torch.stack([*(value + zero for value in rays), *(zero for _ in range(8))])
    start = ends(*state[:5])
    # Steps of order 8: relative errors below 1e-9 for a medium of one pitch.
    for _ in range(SEIDEL_STEPS):
        state, _ = step(field, state, thickness / SEIDEL_STEPS)
    stop = ends(*state[:5])
    added = torch.stack(list(state[5:10]), -1) - (stop[0] - start[0])
    dispersed = torch.stack(list(state[10:12]), -1) + (stop[1] - start[1])
    return tuple(state[:4]), added, dispersed


def ghost_system(system: optical_system, first: int, second: int, *further: int) -> optical_system:
    """Return the sequence of a ghost: light reflected at one surface, back at an earlier one, and on to the image.

    It is also the path of a folded (pancake) system, described by its surfaces without a fold.

    Parameters
    ----------
    system : optical_system
        The system, without coordinate breaks and diffractive phases.
    first : int
        Number of the surface at which light is reflected forwards again.
    second : int
        Number of the later surface at which it is reflected backwards before.
    *further : int
        Surfaces of further reflections in the order of the light: backwards, forwards, …

    Returns
    -------
    optical_system
        With the same entrance beam, fields and wavelengths; the surfaces between the two are passed three times.
        :func:`polarized_trace` computes the brightness of the ghost: coatings and the media on both sides are kept.
        Polarising films keep their parameters, so that gradients reach those of the system.

    Raises
    ------
    ValueError
        If the surfaces are not in this order, or the system contains surfaces that cannot be traced backwards.

    Examples
    --------
    >>> from odak.learn.raytracing.system import ghost_system, load_system
    >>> len(ghost_system(load_system("cooke_triplet"), 2, 4).surfaces)
    10
    """
    items: list[Any] = list(checked_system(system).surfaces)
    first, second = (_validate.place_in(n, v, len(items)) for n, v in (("first", first), ("second", second)))
    turns = [second, first, *(_validate.place_in("further", value, len(items)) for value in further)]
    if not first < second:
        raise ValueError(f"first must be below second, got {first} and {second}")
    # Backwards at the surfaces of even places: each must lie ahead of the one before.
    if len(turns) % 2 or any(b <= a if i % 2 else b >= a for i, (a, b) in enumerate(pairwise(turns))):
        raise ValueError(f"further must be pairs of later and earlier surfaces, got {further} behind {(second, first)}")
    if any(is_break(item) or item.phase is not None or item.gradient is not None or item.reflects for item in items):
        raise ValueError("system must be made of refracting surfaces without coordinate breaks, phases and gradients")

    def medium(i: int):
        if i < 0:
            return system.object_material
        return float(items[i].index.detach()) if items[i].material is None else items[i].material

    def films(i: int, way: int, behind):
        held = items[i].coating
        if isinstance(held, PolarizingFilm):
            return held
        if held is None:
            return None if behind is None else Coating(substrate=behind)
        held = held if way > 0 else held.reversed()
        values = [float(value) for value in held.thicknesses]
        return Coating(held.media, values, behind, held.unit)

    def met(i: int, way: int, folds: bool = False) -> surface:
        """Return a surface that light meets forwards (way 1) or backwards (−1), and passes or is reflected at."""
        item = items[i]
        # On it goes to the next vertex: behind the surface, or in front of it.
        ahead = i if (way > 0) != folds else i - 1
        far = medium(i if way > 0 else i - 1)
        return surface(
            coating=films(i, way, far if folds else None),
            shape=item.shape,
            thickness=float(items[ahead].thickness.detach()) * (-way if folds else way),
            material="mirror" if folds else far,
            semi_diameter=item.semi_diameter,
            aperture=item.apertures or None,
            shift=item.shift.detach(),
            tilt=item.tilt.detach(),
        )

    with torch.no_grad():
        sequence, place, way = [], 0, 1
        for turn in turns:
            sequence += [met(i, way) for i in range(place, turn, way)]
            # The reflecting interfaces lie between the same media, and have their coatings.
            sequence.append(met(turn, way, True))
            way = -way
            place = turn + way
        sequence += [met(i, 1) for i in range(place, len(items))]
        stop = system.stop if system.stop < second else len(sequence) - len(items) + system.stop
        sequence[stop].stop = True
        pupil = entrance_pupil(system)
        size = float(2 * pupil.reach if system.at_infinity else torch.sin(torch.atan(pupil.reach)))
    return optical_system(
        sequence,
        SystemAperture(size, "EPD" if system.at_infinity else "NA", system.telecentric),
        wavelengths=Wavelengths(system.wavelengths, system.reference),
        fields=system.fields,
        conjugates=Conjugates(system.object_distance, system.object_material),
        image=system.image,
        unit=system.unit,
        name=SystemRecord(f"{system.name}, ghost of surfaces {' and '.join(map(str, turns))}", system.source),
    )
