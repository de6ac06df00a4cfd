"""First-order properties by ABCD matrices, in float64, differentiable and for batches of systems."""

from typing import Any, NamedTuple

import torch

from odak import _array, _validate
from odak.learn.raytracing.system.lens import checked_system
from odak.learn.raytracing.system.prescription import Prescription, checked_prescription


class FirstOrder(NamedTuple):
    """First-order properties of a system at one wavelength; each ``[...]``, the axes those of the batch of systems.

    Attributes
    ----------
    focal_length : torch.Tensor
        1/power; positive if the system converges light.
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


class Matrix(NamedTuple):
    """Elements of an ABCD matrix on (y, n·u), each a tensor of one shape."""

    a: torch.Tensor
    b: torch.Tensor
    c: torch.Tensor
    d: torch.Tensor

    def then_surface(self, power) -> "Matrix":
        """Return the matrix with a surface of this power behind it."""
        return Matrix(self.a, self.b, self.c - power * self.a, self.d - power * self.b)

    def then_gap(self, reduced) -> "Matrix":
        """Return the matrix with a gap of this thickness over index behind it."""
        return Matrix(self.a + reduced * self.c, self.b + reduced * self.d, self.c, self.d)


def first_order(system: Any, wavelength: float | None = None, prescription: Prescription | None = None) -> FirstOrder:
    """Return the first-order properties of a system.

    Parameters
    ----------
    system : optical_system
        The system.
    wavelength : float, optional
        In the system's unit; its reference wavelength by default.
    prescription : Prescription, optional
        Numbers in place of the system's own, a batch of systems perhaps; with indices for one wavelength, or for
        those of the system.

    Returns
    -------
    FirstOrder
        float64, differentiable in the numbers.

    Notes
    -----
    Kingslake and Johnson, Lens Design Fundamentals (2010), chapter 3; after a mirror, index and thickness change sign.
    The r² term of an asphere adds 2a₁ to the curvature. An afocal system has infinite focal length.

    Examples
    --------
    >>> from odak.learn.raytracing.system import first_order, load_system
    >>> round(float(first_order(load_system("cooke_triplet")).focal_length), 1)
    50.0
    """
    checked_system(system), checked_prescription(prescription)
    wavelength = None if wavelength is None else float(_validate.number("wavelength", wavelength, positive=True))
    p = _at_one_wavelength(system, wavelength, prescription)
    index = signed_indices(system, p)
    whole = matrix(p, index, 0, len(system.surfaces))
    after = matrix(p, index, system.stop, len(system.surfaces))
    n, behind = index[..., 0], index[..., -1]
    pupil = entrance_pupil(system, wavelength, prescription)
    # The axial ray is scaled so that it fills the pupil.
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


class EntrancePupil(NamedTuple):
    """Where rays are aimed at, such that a pupil at infinity is no special case; each ``[...]``.

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
    """

    distance: torch.Tensor
    radius: torch.Tensor
    reach: torch.Tensor
    bend: torch.Tensor
    stop_radius: torch.Tensor


def entrance_pupil(system, wavelength: float | None = None, prescription: Prescription | None = None) -> EntrancePupil:
    """Return the entrance pupil of a system.

    Parameters
    ----------
    system, wavelength, prescription
        As in :func:`first_order`.
    """
    p = _at_one_wavelength(system, wavelength, prescription)
    index = signed_indices(system, p)
    whole = matrix(p, index, 0, len(system.surfaces))
    before = matrix(p, index, 0, system.stop, gap=True)
    n = index[..., 0]
    distance = n * before.b / before.a
    if system.at_infinity:
        reach = _far_reach(system, whole, n, before.a)
        return EntrancePupil(distance, reach, reach, 0 * n, (reach * before.a).abs())
    # Height in the stop of the axial ray of slope 1.
    to_stop = before.a * system.object_distance + n * before.b
    bend = before.a / to_stop
    reach = _near_reach(system, whole, n, bend, to_stop)
    return EntrancePupil(distance, (reach / bend).abs(), reach, bend, (reach * to_stop).abs())


def _at_one_wavelength(system, wavelength, prescription):
    if prescription is None:
        chosen = system.wavelengths[system.reference] if wavelength is None else wavelength
        return system.prescription([chosen])
    count = prescription.index.shape[-2]
    if count == 1:
        return prescription
    if wavelength is not None:
        raise ValueError("wavelength must be left out where prescription holds several")
    place = system.reference
    return prescription._replace(index=prescription.index[..., place : place + 1, :])


def signed_indices(system, p: Prescription) -> torch.Tensor:
    """Return the indices at the first wavelength, ``[..., S + 1]``, negative after an odd number of mirrors."""
    signs, sign = [1.0], 1.0
    for item in system.surfaces:
        sign = -sign if item.reflects else sign
        signs.append(sign)
    return p.index[..., 0, :] * torch.tensor(signs, dtype=torch.float64, device=p.index.device)


def matrix(p: Prescription, index: torch.Tensor, start: int, stop: int, gap: bool = False) -> Matrix:
    """Return the matrix of surfaces `start` to `stop` − 1, with the gap behind the last of them if asked for."""
    one = torch.ones(p.batch, dtype=torch.float64, device=index.device)
    found = Matrix(one, 0 * one, 0 * one, one)
    for i in range(start, stop):
        curvature = p.curvature[..., i]
        if p.coefficients.shape[-1]:
            curvature = curvature + 2 * p.coefficients[..., i, 0]
        found = found.then_surface((index[..., i + 1] - index[..., i]) * curvature)
        if i + 1 < stop or gap:
            found = found.then_gap(p.thickness[..., i] / index[..., i + 1])
    return found


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
