"""Diffraction images by Fourier transform, by propagation and by Huygens' sum over rays, and fields on grids."""

import math
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from typing import TYPE_CHECKING, Any, NamedTuple, TypedDict

import numpy as np
import torch

from odak import _show, _validate
from odak._array import is_readable, phasor_of_cycles
from odak._torch_private import forward_derivative
from odak._warnings import AccuracyWarning, warn
from odak.learn._tensors import floating, takes_constants
from odak.learn.raytracing.system.analysis import Spread, path_at_start, spot_diagram, wavefront, wavefront_with_rays
from odak.learn.raytracing.system.paraxial import EntrancePupil, check_image_space, entrance_pupil, first_order
from odak.learn.raytracing.system.prescriptions import Prescription, checked_prescription
from odak.learn.raytracing.system.pupils import (
    AIMS,
    SPOKES,
    FieldOptions,
    Pupil,
    PupilQuadrature,
    WaveOptions,
    aimed,
    at_stop,
    field_points,
    launch,
    places_of,
    pupil_factors,
    pupil_quadrature,
    pupil_samples,
    solve_pairs,
    through_places,
    trace_fields,
)
from odak.learn.raytracing.system.specification import FieldPoints, Values
from odak.learn.raytracing.system.surfaces import (
    checked_system,
    numbers_of,
    optical_system,
    reference_of,
    wavelength_shares,
    wavelengths_of,
)
from odak.learn.raytracing.system.tracing import trace
from odak.raytracing.geometry import safe_sqrt
from odak.raytracing.intersections import RayStatus

PLANES = ("axis", "chief")
# Extent of the grid over the extent of the field.
MARGIN = 1.1
# Samples computed at a time, with some ten rays each.
PIECE = 1 << 18
# Rays of the first estimate of the map, and the degree of its polynomials.
RINGS, DEGREE = 10, 7
# Step of differences in radii of the pupil: their error grows with its square, rounding with its inverse.
STEP = 3e-4
# Places of the search for the peak of an image: their distance in wavelengths over the aperture, their largest number
# along each axis, and how often the neighbourhood of the best one is searched again.
CLOSE, MOST, ZOOMS = 0.25, 301, 6
if TYPE_CHECKING:
    from typing_extensions import Unpack

# Rings of the quadratures among which the first converged one is taken, and the change that is small enough.
RING_COUNTS, SMALL = (8, 16, 32, 64), 1e-3
# Root mean square of wavefronts in waves above which transfer functions are computed from rays.
LARGE = 2.0
# Counts of rays among which Strehl ratios take the first that resolves the wavefront: with neighbours more than half a
# wave from each other over at most this part of the pupil.
COUNTS, COARSE = (16, 32, 64, 128), 0.1
# Samples across the pupil among which images take the first that resolves the wavefront: with neighbours more than half
# a wave from each other, whose light would come out at a wrong place, for at most this part of the light.
SAMPLES, ASTRAY = (64, 128, 256), 0.01
# The same of sums over rays, which cost more the more there are.
RAYS = (64, 96, 128, 192, 256, 384, 512)
# Cells of a grid over which a ray is spread along each axis, the exponent of the kernel, and the rays at a time.
WIDTH, BELL, SPREAD_AT_A_TIME = 14, 2.3 * 14, 1 << 14


class PlaneRays(NamedTuple):
    """Rays at their intersections with the plane, each ``[..., P]``.

    Attributes
    ----------
    x, y : torch.Tensor
        Along the plane's axes, from the chief ray.
    u, v, cosine : torch.Tensor
        Direction cosines along the plane's axes and its normal.
    path : torch.Tensor
        Optical path minus the chief ray's.
    status : torch.Tensor
        int8, numbers of :class:`odak.raytracing.RayStatus`: what befell the ray first.
    """

    x: torch.Tensor
    y: torch.Tensor
    u: torch.Tensor
    v: torch.Tensor
    cosine: torch.Tensor
    path: torch.Tensor
    status: torch.Tensor


class RayMap:
    """Rays of one field point at one wavelength, from pupil coordinates to a plane behind the system.

    Parameters
    ----------
    system : optical_system
        The system.
    prescription : Prescription or None
        Its numbers, of all wavelengths; None for its own.
    place : int
        Which of the wavelengths.
    field : torch.Tensor
        Field point ``[2]``.
    distance : float or torch.Tensor
        From the last vertex to where the plane crosses the chief ray, along z.
    across : bool
        Turn the plane's normal to the chief ray rather than to the axis.
    """

    def __init__(
        self,
        system: optical_system,
        prescription: Prescription | None,
        place: int,
        field: torch.Tensor,
        distance: float | torch.Tensor,
        across: bool,
    ):
        numbers = numbers_of(system, prescription)
        self.system: optical_system = system
        self.numbers: Prescription = numbers.at(place)
        self.reference: Prescription = numbers.at(system.reference)
        self.pupil: EntrancePupil = entrance_pupil(system, prescription=self.reference)
        self.field: torch.Tensor = field.reshape(1, 1, 2)
        # Decentre and size of the vignetted pupil, on whose unit disc the coordinates are given.
        factors = pupil_factors(system, self.field[0])
        self.shift: Any = 0.0 if factors is None else factors[0, :2]
        self.size: Any = 1.0 if factors is None else 1 - factors[0, 2:]
        self.origin: Any = None
        self.axes: Any = None
        self.chief: Any = 0.0
        chief = self._traced(torch.zeros(1, 2, dtype=torch.float64, device=field.device), False)
        height = distance - numbers.thickness[..., -1]
        self._place(chief, height, across)

    def _place(self, chief, height, across: bool) -> None:
        """Set the plane: its origin on the chief ray, its axes nearest to x and y."""
        point, direction = torch.stack(chief[:3], -1), torch.stack(chief[3:6], -1)
        along = (height[..., None] - point[..., 2]) / direction[..., 2]
        self.origin = point + along[..., None] * direction
        ways = torch.eye(3, dtype=point.dtype, device=point.device).expand(*direction.shape[:-1], 3, 3)
        normal = direction if across else ways[..., 2] * torch.sign(direction[..., 2:]).detach()
        x = _unit(ways[..., 0] - ways[..., 0].mul(normal).sum(-1, keepdim=True) * normal)
        y = ways[..., 1] - ways[..., 1].mul(normal).sum(-1, keepdim=True) * normal
        y = _unit(y - y.mul(x).sum(-1, keepdim=True) * x)
        self.axes = x, y, normal
        self.to_image: Any = ((point - self.origin) * normal).sum(-1)[..., 0]
        # Zero where the map's path is measured from.
        self.chief = self(torch.zeros(1, 2, dtype=point.dtype, device=point.device)).path

    def _traced(self, places: torch.Tensor, vignetting: bool):
        rays = self._rays(places)
        found = trace(self.system, rays, prescription=self.numbers, vignetting=vignetting)
        total = found.path + path_at_start(self.system, rays, self.numbers)
        return type(found)(*(value[..., 0, 0, :] for value in found._replace(path=total)))

    def _rays(self, places: torch.Tensor):
        coordinates = places_of(self.pupil, (self.shift + self.size * places)[..., None, None, :, :])
        return through_places(self.system, self.field, self.pupil, *coordinates)

    def __call__(self, places: torch.Tensor, vignetting: bool = False) -> PlaneRays:
        """Return the intersections of rays with the plane.

        Parameters
        ----------
        places : torch.Tensor
            Pupil coordinates ``[..., P, 2]``: 1 at the rim of the paraxial entrance pupil.
        vignetting : bool
            Let semi-diameters block rays.
        """
        found = self._traced(places, vignetting)
        # Lost rays are computed as if they were on the axis, so that no NaN enters a gradient.
        lost = found.status != RayStatus.HIT
        alike = (0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0)
        held = [torch.where(lost, dummy, value) for dummy, value in zip(alike, found, strict=False)]
        found = type(found)._make([*held, found.status])
        point, direction = torch.stack(found[:3], -1) - self.origin, torch.stack(found[3:6], -1)
        u, v, cosine = ((direction * axis).sum(-1) for axis in self.axes)
        distance = -(point * self.axes[2]).sum(-1) / cosine
        x, y = ((point * axis).sum(-1) + distance * slope for axis, slope in zip(self.axes, (u, v), strict=False))
        path = found.path + self.numbers.index[..., 0, -1:] * distance - self.chief
        met = [torch.where(lost, torch.nan, value) for value in (x, y, u, v, cosine, path)]
        return PlaneRays._make([*met, found.status])

    def samples(self, aim: str) -> torch.Tensor:
        """Return places ``[..., P, 2]`` all over the pupil, its edge included."""
        points = pupil_samples("rings", RINGS, device=self.pupil.reach.device)
        return points if aim == "paraxial" else self._aimed(points)

    def _aimed(self, points: torch.Tensor) -> torch.Tensor:
        """Return pupil coordinates of rays through points of the stop; rays not found are left out."""
        found = aimed(self.system, self.reference, self.pupil, self.shift + self.size * points, self.field)
        centers = places_of(self.pupil, torch.zeros(1, 2, dtype=points.dtype, device=points.device))
        reach = self.pupil.reach[..., None, None, None]
        parts = [((a - b) / reach)[..., 0, 0, :] for a, b in zip(found, centers, strict=True)]
        return ((torch.stack(parts, -1) - self.shift) / self.size).nan_to_num(posinf=0.0, neginf=0.0)

    def in_stop(self, places: torch.Tensor, aim: str) -> torch.Tensor:
        """Return the coordinates whose radius is 1 at the edge of the pupil: the paraxial pupil or the stop."""
        if aim == "paraxial":
            return places
        radius = self.pupil.stop_radius[..., None, None, None]
        x, y, _ = at_stop(self.system, self.reference, self._rays(places))
        return ((torch.stack([x, y], -1) / radius[..., None])[..., 0, 0, :, :] - self.shift) / self.size

    def derivatives(self, places: torch.Tensor) -> Any:
        """Return the derivatives of (x, y) by the two pupil coordinates, and the mean place they were taken about."""
        met = self(_around(places))
        x, y = (value.reshape(*value.shape[:-1], 4, -1) for value in met[:2])
        by = [[(value[..., i, :] - value[..., i + 1, :]) / (2 * STEP) for value in (x, y)] for i in (0, 2)]
        return *by, [(value[..., 0, :] + value[..., 1, :]) / 2 for value in (x, y)]

    def radius(self, places: torch.Tensor, aim: str) -> Any:
        """Return the radius that is 1 at the edge of the pupil, and its derivatives by the two pupil coordinates."""
        radius = self._length(places, aim)
        if aim == "paraxial":
            return radius, *(value / radius for value in places.unbind(-1))
        there = self._length(_around(places), aim)
        there = there.reshape(*there.shape[:-1], 4, -1)
        return radius, *((there[..., i, :] - there[..., i + 1, :]) / (2 * STEP) for i in (0, 2))

    def _length(self, places: torch.Tensor, aim: str) -> torch.Tensor:
        # At the centre the root has no gradient; nothing depends on it there.
        return self.in_stop(places, aim).square().sum(-1).clamp(min=1e-12).sqrt()

    def solve(self, target: torch.Tensor, guess: torch.Tensor) -> torch.Tensor:
        """Return the pupil coordinates of the rays through the points `target`, ``[P, 2]``, of the plane."""

        def missed(x, y, goals, _):
            met = self(torch.stack([x, y], -1).flatten(-3, -2))
            kept = met.status == RayStatus.HIT
            errors = (torch.where(kept, met[i] - goals[..., i].flatten(-2), 0.0) for i in range(2))
            return [value.reshape(x.shape) for value in (*errors, kept)]

        x, y = (value[..., None, :] for value in guess.unbind(-1))
        goals = target.expand(*x.shape, 2)
        return torch.stack(solve_pairs(missed, x, y, torch.full((), STEP).to(x), goals, goals), -1)[..., 0, :, :]

    def guess(self, places: torch.Tensor, met: PlaneRays, target: torch.Tensor) -> torch.Tensor:
        """Return estimated starts of the rays through `target`, by polynomials through the samples."""
        size = torch.maximum(met.x.abs(), met.y.abs()).nan_to_num().amax(-1, keepdim=True)
        kept = (met.status == RayStatus.HIT)[..., None]
        basis = torch.where(kept, _powers(met.x / size, met.y / size), 0.0)
        found = torch.linalg.lstsq(basis, torch.where(kept, places, 0.0).expand(*basis.shape[:-1], 2)).solution
        here = target / size[..., None]
        return _powers(here[..., 0].clamp(-1.3, 1.3), here[..., 1].clamp(-1.3, 1.3)) @ found


def _around(places: torch.Tensor) -> torch.Tensor:
    """Return the neighbours of places ``[..., P, 2]`` on both sides along both axes, ``[..., 4P, 2]``."""
    steps = STEP * torch.tensor([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]], dtype=places.dtype).to(places)
    return (places[..., None, :, :] + steps[:, None, :]).reshape(*places.shape[:-2], -1, 2)


def _unit(vector: torch.Tensor) -> torch.Tensor:
    return vector / vector.square().sum(-1, keepdim=True).sqrt()


def _powers(x: torch.Tensor, y: torch.Tensor) -> torch.Tensor:
    """Return all products xⁱyʲ up to the degree."""
    terms = [x.nan_to_num() ** i * y.nan_to_num() ** j for i in range(DEGREE + 1) for j in range(DEGREE + 1 - i)]
    return torch.stack(terms, -1)


def point_spread_function(
    system: optical_system, samples: int | None = None, size: int | None = None, **options: "Unpack[WaveOptions]"
) -> Spread:
    """Return the image of a point with diffraction, by a Fourier transform of the exit pupil.

    Parameters
    ----------
    system : optical_system
        The system.
    samples : int, optional
        Samples across the pupil; the first of 64, 128 and 256 that resolves the wavefront by default.
    size : int, optional
        Pixels along each side of the image, at least `samples` and four times as many by default; the more, the finer
        they are. The modulation transfer needs twice `samples`, and a Strehl ratio to a hundredth eight times: the peak
        may lie between pixels.
    **options
        Of :func:`wavefront` (`prescription`, `fields`, `aim`, `vignetting`).

    Returns
    -------
    Spread
        Differentiable.

    Notes
    -----
    Scalar diffraction, Goodman, Introduction to Fourier Optics (2005), section 6.1. The pupil is uniformly filled; the
    direction cosines of its rays are taken to be linear in the pupil coordinates (Abbe's sine condition), of the slopes
    that fit the traced rays best. Numerical apertures up to 0.5 or so. Fields off both axes mix the two coordinates:
    that is left out, with an AccuracyWarning where it is more than 2 %; :func:`propagated_point_spread_function` has
    it. The number of samples must resolve the phase, less than half a wave from one to the next: other light comes out
    at a wrong place. An AccuracyWarning gives the number that would do where it is more than 1 % of the light.

    Examples
    --------
    A parabolic mirror images a distant point on its axis without aberration:

    >>> from odak.learn.raytracing.system import optical_system, point_spread_function, surface
    >>> parabola = surface(radius=-200.0, conic=-1.0, thickness=-100.0, material="mirror")
    >>> mirror = optical_system([parabola], aperture=20.0)
    >>> round(float(point_spread_function(mirror, 32, 128).strehl.max()), 2)
    1.0
    """
    return pupil_image(system, chosen_samples(samples), size, options)


def chosen_samples(samples: int | None, usual: tuple[int, ...] = SAMPLES) -> tuple[int, ...]:
    """Return the numbers of samples to choose from."""
    return usual if samples is None else (_validate.integer("samples", samples, minimum=8),)


def more_samples(samples: int) -> tuple[int, ...]:
    """Return a number of samples and larger ones to choose from."""
    return (samples, *(count for count in SAMPLES if count > samples))


def pupil_image(
    system: optical_system,
    counts: Sequence[int],
    size: int | None,
    options: Mapping[str, Any],
    amplitudes: Callable[..., Any] | None = None,
    fineness: int = 4,
) -> Spread:
    """Return the image of a point by Fourier transforms of the fields in the pupil.

    Parameters
    ----------
    system : optical_system
        The system.
    counts : sequence of int
        Samples across the pupil, of which the first number that resolves the wavefront is taken.
    size, options
        As of :func:`point_spread_function`.
    amplitudes : callable, optional
        Takes pupil points ``[P, 2]`` and returns the complex amplitudes ``[..., W, F, P]`` of one or several fields,
        whose intensities add up; 1 of a single one by default.
    fineness : int
        Pixels over samples, without a size.
    """
    if size is not None:
        size = _validate.integer("size", size, minimum=counts[0])
        counts = [count for count in counts if count <= size]

    def sampled(samples: int):
        points, inside, share = _disc(samples)
        found = wavefront(system, points, **options)
        weight = torch.where(found.status == 0, share.to(found.path.device), 0.0)
        # An image of the transform is as wide as the distance at which it repeats itself.
        return (samples, points, inside, found, weight), _Sampling(found.path, inside, weight, 0.5)

    samples, points, inside, found, weight = resolved(counts, sampled)
    size = fineness * samples if size is None else size
    phase = phasor_of_cycles(torch.where(found.status == 0, found.path, 0.0), torch.complex128) * weight
    intensity: Any = 0.0
    energy: Any = 0.0
    for amplitude in [1.0] if amplitudes is None else amplitudes(points):
        pupil = torch.zeros(*phase.shape[:-1], samples, samples, dtype=phase.dtype, device=phase.device)
        pupil[..., inside.to(phase.device)] = amplitude * phase
        # Where the pupil lies on the grid does not change the modulus.
        field = torch.fft.fft2(pupil / weight.sum(-1)[..., None, None], s=(size, size))
        intensity = intensity + torch.fft.fftshift(field.real.square() + field.imag.square(), dim=(-2, -1))
        # A sample on the edge has the amplitude of the part inside, and the energy of its square: too little.
        energy = energy + (abs(amplitude) ** 2 * weight).sum(-1) * (size / weight.sum(-1)).square()
    slopes = _derivatives(found, weight)
    numbers = numbers_of(system, options.get("prescription"))
    waves = (wavelengths_of(system, numbers) / numbers.index[..., -1].abs())[..., None, None]
    pitch = waves / (size * (2 / samples) * slopes)
    return Spread(intensity, pitch, intensity.amax((-2, -1)), energy)


class _Sampling(NamedTuple):
    """A wavefront on a grid in the pupil.

    Attributes
    ----------
    path : torch.Tensor
        In waves, ``[..., P]``, NaN or without weight where no ray arrives.
    inside : torch.Tensor
        Which of the grid they are, ``[n, n]``.
    weight : torch.Tensor
        Light of each, ``[..., P]``.
    width : float or torch.Tensor
        Half the width of the image over the distance at which it repeats itself, ``[..., 1]``.
    fixed : bool
        The width of the image does not depend on the number of samples.
    """

    path: torch.Tensor
    inside: torch.Tensor
    weight: torch.Tensor
    width: Any
    fixed: bool = False


def resolved(counts: Sequence[int], sampled: Callable[[int], tuple[Any, _Sampling]]) -> Any:
    """Return what a function gives for the first number of samples that resolves the wavefront.

    Parameters
    ----------
    counts : sequence of int
        Samples across the pupil. Where none of them resolves the wavefront, the last one is taken with a warning.
    sampled : callable
        Takes a number of samples and returns what is wanted and the wavefront it is made of.
    """
    needed = 0
    for samples in counts:
        # A count that an earlier one has shown to be too small.
        if samples < min(needed, counts[-1]):
            continue
        found, sampling = sampled(samples)
        step, part = _steps(sampling)
        if not is_readable(step) and not (step.is_cuda and len(counts) > 1):
            return found
        more = step + sampling.width if sampling.fixed else step / (1 - sampling.width)
        largest = float(more.max())
        if largest <= 1:
            return found
        needed = 8 * math.ceil(largest * samples / 8)
    warn(
        f"{samples} samples across the pupil do not resolve the wavefront: {100 * float(part.max()):.0f} % of the "
        f"light falls beside the image and comes out at a wrong place in it; take {needed} samples",
        AccuracyWarning,
    )
    return found


def _disc(samples: int, centre: float | None = None) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Return points of a grid in the pupil ``[P, 2]``, which of the grid they are, and how much of each is inside."""
    step = 2 / samples
    line = (torch.arange(samples, dtype=torch.float64) - (samples // 2 if centre is None else centre)) * step
    y, x = torch.meshgrid(line, line, indexing="ij")
    # Pixels on the edge are weighted by the fraction of their area inside.
    share = ((1 - (x * x + y * y).sqrt()) / step + 0.5).clamp(0, 1)
    inside = share > 0
    return torch.stack([x[inside], y[inside]], -1), inside, share[inside]


@torch.no_grad()
def _steps(sampling: _Sampling) -> tuple[torch.Tensor, torch.Tensor]:
    """Return by how many waves neighbours on a grid in the pupil differ, ``[..., 1]`` and ``[...]``.

    Returns
    -------
    tuple of torch.Tensor
        The difference that all but the part ASTRAY of the light keep to, and the part that differs by so much that it
        comes out in the image at a wrong place.

    Notes
    -----
    Light whose path changes by s waves from a sample to the next belongs at s times the distance at which the image
    repeats itself, and comes out again at s − 1, s − 2 and so on: within the image if s > 1 − w, w half the width of
    the image over that distance.
    """
    path, inside, weight, width, _ = sampling
    inside = inside.to(path.device)
    grid = torch.full((*path.shape[:-1], *inside.shape), torch.nan, dtype=path.dtype, device=path.device)
    grid[..., inside] = torch.where(weight > 0, path, torch.nan)
    along, down = (grid.diff(dim=axis).abs().nan_to_num() for axis in (-1, -2))
    pad = torch.nn.functional.pad
    steps = torch.maximum(pad(along, (0, 1)), pad(down, (0, 0, 0, 1)))[..., inside]
    light = weight / weight.sum(-1, keepdim=True)
    part = (light * (steps > 1 - width)).sum(-1)
    steps, order = steps.sort(-1, descending=True)
    beyond = (light.gather(-1, order).cumsum(-1) <= ASTRAY).sum(-1, keepdim=True).clamp(max=steps.shape[-1] - 1)
    return steps.gather(-1, beyond), part.nan_to_num()


def _derivatives(found, weight):
    """Return |∂v/∂p_y| and |∂u/∂p_x| by weighted least squares over the rays, ``[..., W, F, 2]``."""
    slopes, mixed = [], []
    for axis in (1, 0):
        place = found.pupil[:, axis]
        mean = (weight * place).sum(-1, keepdim=True) / weight.sum(-1, keepdim=True)
        along, across = (
            (weight * (place - mean) * torch.where(weight > 0, found.cosines[..., of], 0.0)).sum(-1)
            / (weight * (place - mean).square()).sum(-1)
            for of in (axis, 1 - axis)
        )
        slopes.append(along)
        mixed.append(across)
    straight, skew = torch.stack(slopes, -1).abs(), torch.stack(mixed, -1).detach().abs()
    if is_readable(skew) and bool((skew > 0.02 * straight.detach()).any()):
        warn(
            "point_spread_function leaves out that direction cosines along y change with x in the pupil, as they do by "
            "more than 2 % for fields off both axes: use propagated_point_spread_function",
            AccuracyWarning,
        )
    return straight


def strehl_ratio(
    system: optical_system, pupil: Pupil = "gauss", count: int | None = None, **options: "Unpack[WaveOptions]"
) -> torch.Tensor:
    """Return the peak of the diffraction image of a point relative to the same pupil without aberrations.

    Parameters
    ----------
    system : optical_system
        The system.
    pupil : str, PupilQuadrature or torch.Tensor
        Pattern of :func:`pupil_samples`, points of :func:`pupil_quadrature`, or points ``[P, 2]``.
    count : int, optional
        Count of :func:`pupil_samples`; the first of 16, 32, 64 and 128 that resolves the wavefront by default.
    **options
        Of :func:`wavefront` (`prescription`, `fields`, `aim`, `vignetting`).

    Returns
    -------
    torch.Tensor
        ``[..., W, F]``, differentiable.

    Notes
    -----
    The largest modulus of the sum of the plane waves of all rays in the image plane, not on a grid but at the maximum
    itself, whose distance from the chief ray does not matter. The pupil is uniformly filled, and light is scalar (Born
    and Wolf, Principles of Optics, 1999, section 9.1.3). An AccuracyWarning says where the rays are too few to resolve
    the wavefront, whose sum then comes out too large: more than half a wave from a ray to the next.

    Examples
    --------
    For small aberrations it is exp(−(2π·RMS)²):

    >>> import math
    >>> from odak.learn.raytracing.system import optical_system, strehl_ratio, surface, wavefront
    >>> sphere = surface(radius=-400.0, thickness=-199.99, material="mirror")
    >>> mirror = optical_system([sphere], aperture=20.0)
    >>> round(float(strehl_ratio(mirror)), 3), round(math.exp(-float((2 * math.pi * wavefront(mirror).rms) ** 2)), 3)
    (0.992, 0.992)
    """
    named = isinstance(pupil, str)
    counts = COUNTS if count is None and named else COUNTS[:1] if count is None else (count,)
    for own in counts:
        found, coarse, *_ = _strehl(system, pupil, own, options)
        # NaN where no ray of a field arrives.
        share = float(coarse.nan_to_num().max())
        if share <= COARSE:
            break
    else:
        warn(
            f"rays do not resolve the wavefront over {100 * share:.0f} % of the pupil, and Strehl ratios come out too "
            "large: take a larger count",
            AccuracyWarning,
        )
    return found


def _strehl(system, pupil, count: int, options: Mapping[str, Any]) -> tuple[torch.Tensor, torch.Tensor, Any, Any]:
    """Return Strehl ratios, the part of the pupil whose wavefront the rays do not resolve, its RMS, and the rays."""
    found, traced = wavefront_with_rays(system, pupil, count, **options)
    numbers = numbers_of(system, options.get("prescription"))
    waves = wavelengths_of(system, numbers)[:, None] / numbers.index[..., -1].abs()[..., None]
    kept = found.status == RayStatus.HIT
    weight = kept.to(found.path) if found.weights is None else kept * found.weights
    weight = weight / weight.sum(-1, keepdim=True)
    wave = phasor_of_cycles(torch.where(kept, found.path, 0.0), torch.complex128) * weight
    slopes = torch.where(kept[..., None], found.cosines, 0.0) / waves[..., None, None]
    with torch.no_grad():
        # From the chief ray of the reference wavelength.
        place = reference_of(system, options.get("prescription"))
        spots = [torch.where(kept, v[..., 1:] - v[..., place : place + 1, :, :1], 0.0) for v in traced[:2]]
        x, y = _peak(wave, slopes, spots, kept)
        # The wavefront about the peak changes by as many waves per radius of the pupil as rays miss it in units of
        # λ/NA; a ray stands for a part of the area of the pupil, whose root is its distance from the next.
        missed = torch.where(kept, ((spots[0] - x).square() + (spots[1] - y).square()).sqrt(), 0.0)
        step = missed * slopes.square().sum(-1).amax(-1, keepdim=True).sqrt() * (math.pi * weight).sqrt()
        coarse = (weight * (step > 0.5)).sum(-1)
    return _sum_of_waves(wave, slopes, x, y)[..., 0, 0], coarse, found.rms, traced


def _sum_of_waves(wave: torch.Tensor, slopes: torch.Tensor, x: torch.Tensor, y: torch.Tensor) -> torch.Tensor:
    """Return the intensity at x ``[..., m]`` and y ``[..., n]``, ``[..., m, n]``, of the waves of rays ``[..., P]``."""
    along_x, along_y = (
        phasor_of_cycles(slopes[..., i, None] * place[..., None, :], torch.complex128) for i, place in enumerate((x, y))
    )
    field = (along_x * wave[..., None]).mT @ along_y
    return field.real.square() + field.imag.square()


def _peak(
    wave: torch.Tensor, slopes: torch.Tensor, spots: list[torch.Tensor], kept: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor]:
    """Return where the sum of the waves is largest, from the chief ray, ``[..., 1]`` each."""
    scale = slopes.square().sum(-1).amax(-1, keepdim=True).sqrt().clamp_min(1e-300)
    number = kept.sum(-1, keepdim=True).clamp_min(1)
    centres, spreads = [], []
    for value in spots:
        centres.append(value.sum(-1, keepdim=True) / number)
        spreads.append((value.square().sum(-1, keepdim=True) / number - centres[-1].square()).clamp_min(0))
    # Beyond a distance the rays are too few to tell the image from its repetitions.
    farthest = math.sqrt(wave.shape[-1] / SPOKES) / math.pi
    reach = torch.minimum(2 * (spreads[0] + spreads[1]).sqrt() + 2 / scale, max(farthest, 2.0) / scale)
    count = min(2 * math.ceil(float((reach * scale).amax()) / CLOSE) + 1, MOST)
    for zoom in range(ZOOMS + 1):
        line = torch.linspace(-1, 1, count, dtype=torch.float64, device=reach.device)
        x, y = (centre + reach * line for centre in centres)
        best = _sum_of_waves(wave, slopes, x, y).flatten(-2).argmax(-1, keepdim=True)
        centres = [x.gather(-1, best // count), y.gather(-1, best % count)]
        reach, count = reach * (2.0 / (count - 1)) if zoom == 0 else reach / 3, 9
    return centres[0], centres[1]


@_show.shown
class FieldQuality(NamedTuple):
    """Converged numbers of the image of each field point.

    Attributes
    ----------
    rms_spot : torch.Tensor
        Root mean square distance of the rays from their centroid over the area of the pupil, all wavelengths together,
        ``[F]``.
    wavefront_rms : torch.Tensor
        Standard deviation of the path to the reference sphere over the area of the pupil, in wavelengths, at the
        reference wavelength, ``[F]``.
    strehl : torch.Tensor
        :func:`strehl_ratio` at the reference wavelength, ``[F]``.
    passed : torch.Tensor
        Fraction of the area of the pupil that no aperture blocks, ``[F]``.
    count : int
        Rings of the quadrature.
    change : float
        Largest change from half as many rings: relative for spots and wavefronts, absolute for the other two.

    Examples
    --------
    >>> from odak.learn.raytracing.system import FieldQuality, field_quality, load_system
    >>> isinstance(field_quality(load_system("singlet")), FieldQuality)
    True
    """

    rms_spot: torch.Tensor
    wavefront_rms: torch.Tensor
    strehl: torch.Tensor
    passed: torch.Tensor
    count: int  # type: ignore[assignment]  # hides tuple.count
    change: float

    def _repr_html_(self) -> str:
        return _show.page(self, FieldQuality._view)

    def _view(self) -> _show.View:
        """Return what notebooks show of it: a row for each field."""
        columns = [v.detach().cpu() for v in (self.rms_spot, self.wavefront_rms, self.strehl, 100 * self.passed)]
        head = ("field", "RMS spot (unit of the lens)", "wavefront RMS (λ)", "Strehl ratio", "passed (%)")
        rows = [(str(i), *map(float, row)) for i, row in enumerate(zip(*columns, strict=True))]
        title = f"Quality over the field, {self.count} rings; with half as many it differs by {self.change:.1g}"
        return _show.View(title, (), [head, *rows])


@torch.no_grad()
def field_quality(system: optical_system, aim: str = "paraxial", *, fields: FieldPoints | None = None) -> FieldQuality:
    """Return spots, wavefronts, Strehl ratios and vignetting of each field by quadratures that have converged.

    Parameters
    ----------
    system : optical_system
        The system.
    aim : str
        "paraxial" or "real", how :func:`launch` aims.
    fields : sequence of pairs or torch.Tensor, optional
        Field points in place of the system's.

    Returns
    -------
    FieldQuality
        Of the first of the quadratures of 16, 32 and 64 rings whose `change` is at most 1e-3; of the last one,
        whatever its change, where none is.

    Examples
    --------
    >>> from odak.learn.raytracing.system import field_quality, load_system
    >>> found = field_quality(load_system("cooke_triplet"))
    >>> found.change < 1e-3, bool((found.passed > 0.5).all())
    (True, True)
    """
    checked_system(system)
    numbers = system.prescription().at(system.reference)
    before: list[torch.Tensor] = []
    for count in RING_COUNTS:
        options: dict[str, Any] = {"fields": fields, "aim": aim}
        points = pupil_quadrature(system, count, **options)
        passed, options["prescription"] = points.weights.sum(-1), numbers
        strehl, _, waves, traced = _strehl(system, points, count, options)
        spots = _converged_spots(system, count, points, fields, aim, traced)
        values = [spots, waves[0], strehl[0], passed.expand(spots.shape)]
        changes = [(a - b).abs() for a, b in zip(values, before, strict=False)]
        scales = [values[0].clamp_min(1e-12), values[1].clamp_min(1e-2), *map(torch.ones_like, values[2:])]
        change = max(
            (float((c / s).nan_to_num().max()) for c, s in zip(changes, scales, strict=False)), default=math.inf
        )
        if change <= SMALL:
            break
        before = values
    spots, waves, strehl, passed = values
    return FieldQuality(spots, waves, strehl, passed, count, change)


def _converged_spots(system, count: int, points: PupilQuadrature, fields, aim: str, traced) -> torch.Tensor:
    """Return the root mean square of spots, ``[F]``, of wavelengths whose vignetted pupils may differ.

    The rays of the reference wavelength, behind the chief ray, are known.
    """
    numbers, whole = system.prescription(), points.points.ndim == 2
    shares = wavelength_shares(system, None, points.weights)
    parts, origin = [], None
    for place in range(len(shares)):
        own = numbers.at(place)
        options: dict[str, Any] = {"fields": fields, "aim": aim, "prescription": own}
        known = place == system.reference
        own_points = points if whole or known else pupil_quadrature(system, count, **options)
        found = type(traced)(*(v[..., 1:] for v in traced)) if known else trace_fields(system, own_points, **options)
        weight = torch.where(found.arrived, shares[place] * own_points.weights, 0.0)[0]
        x, y = (torch.where(found.arrived, value, 0.0)[0] for value in (found.x, found.y))
        origin = (x[:, :1], y[:, :1]) if origin is None else origin
        x, y = x - origin[0], y - origin[1]
        parts.append(torch.stack([(weight * value).sum(-1) for value in (torch.ones_like(x), x, y, x * x + y * y)]))
    number, x, y, squares = sum(parts)  # type: ignore[misc]
    return safe_sqrt((squares - (x * x + y * y) / number) / number)


def modulation_transfer_function(spread: Spread, axis: str = "y") -> tuple[torch.Tensor, torch.Tensor]:
    """Return the modulation transfer along an axis.

    Parameters
    ----------
    spread : Spread
        From :func:`point_spread_function`.
    axis : str
        "y": of gratings whose lines are along x (tangential for fields along y). "x": the other.

    Returns
    -------
    tuple of torch.Tensor
        Frequencies in cycles per unit of length, ``[..., W, F, n]``, from 0, and the modulation, 1 at frequency 0.

    Notes
    -----
    The modulus of the Fourier transform of the point spread function (Goodman 2005, section 6.3), over the energy of an
    image of any width.

    Examples
    --------
    It is 1 at frequency 0:

    >>> from odak.learn.raytracing.system import modulation_transfer_function, optical_system
    >>> from odak.learn.raytracing.system import point_spread_function, surface
    >>> parabola = surface(radius=-200.0, conic=-1.0, thickness=-100.0, material="mirror")
    >>> mirror = optical_system([parabola], aperture=20.0)
    >>> frequencies, modulation = modulation_transfer_function(point_spread_function(mirror, 32, 128))
    >>> float(frequencies[0, 0, 0]), round(float(modulation[0, 0, 0]), 6)
    (0.0, 1.0)
    """
    _validate.instance("spread", spread, Spread, "a Spread")
    axis = _validate.one_of("axis", axis, ("x", "y"))
    profile = spread.intensity.sum(-1 if axis == "y" else -2)
    size = profile.shape[-1]
    transfer = torch.fft.rfft(profile).abs()
    pitch = spread.pitch[..., 0 if axis == "y" else 1]
    frequencies = torch.fft.rfftfreq(size, dtype=torch.float64, device=pitch.device) / pitch[..., None]
    first = transfer[..., :1]
    total = first if spread.energy is None else spread.energy[..., None]
    return frequencies, torch.cat([first / first, transfer[..., 1:] / total], -1)


@_validate.takes_units()
def airy_pattern(radius: torch.Tensor, wavelength: float, numerical_aperture: float) -> torch.Tensor:
    """Return the diffraction image (2J₁(v)/v)² of a point, v = 2π·NA·r/λ.

    Parameters
    ----------
    radius : torch.Tensor
        Distances from the centre.
    wavelength : float
        Wavelength in the unit of `radius`.
    numerical_aperture : float
        Numerical aperture on the side of the image.

    Returns
    -------
    torch.Tensor
        Intensity, 1 in the centre, of the shape of `radius`.

    Raises
    ------
    ValueError, TypeError
        If the wavelength or the aperture is not positive.

    Notes
    -----
    Airy, Trans. Camb. Phil. Soc. 5, 283 (1835); Born and Wolf, Principles of Optics (1999), section 8.5.2.

    Examples
    --------
    The first dark ring has the radius 0.61·λ/NA:

    >>> import torch
    >>> from odak.learn.raytracing.system import airy_pattern
    >>> radius = torch.tensor([0.0, 0.61 * 0.5e-3 / 0.1])
    >>> bool(airy_pattern(radius, 0.5e-3, 0.1)[1] < 1e-4)
    True
    """
    radius = floating("radius", radius)
    _validate.number("wavelength", wavelength, positive=True)
    _validate.number("numerical_aperture", numerical_aperture, positive=True)
    # Torch has no Bessel functions in half precision.
    wide = radius if radius.dtype in (torch.float32, torch.float64) else radius.float()
    v = wide * (2 * math.pi * numerical_aperture / wavelength)
    centre = v.abs() < 1e-8
    safe = torch.where(centre, 1.0, v)
    return torch.where(centre, 1.0, (2 * _Bessel.apply(1, safe) / safe).square()).to(radius.dtype)


class _Bessel(torch.autograd.Function):
    """The Bessel functions J₀ and J₁ with their derivatives, which torch.special does not have."""

    generate_vmap_rule = True

    @staticmethod
    def forward(order, x):
        return torch.special.bessel_j1(x) if order else torch.special.bessel_j0(x)

    @staticmethod
    def setup_context(ctx, inputs, output):
        ctx.order, x = inputs
        ctx.save_for_backward(x)
        ctx.save_for_forward(x)

    @staticmethod
    def backward(ctx, gradient):
        return None, gradient * _Bessel._slope(ctx)

    @staticmethod
    def jvp(ctx, _, tangent):
        return tangent * _Bessel._slope(ctx)

    @staticmethod
    def _slope(ctx):
        (x,) = ctx.saved_tensors
        return _Bessel.apply(0, x) - _Bessel.apply(1, x) / x if ctx.order else -_Bessel.apply(1, x)


class ExitOptions(TypedDict, total=False):
    """Of :func:`exit_field`, for images of its fields."""

    field: int | torch.Tensor | Sequence[float]
    wavelength: int | None
    distance: float | None
    aim: str
    vignetting: bool
    apodization: Callable[[torch.Tensor], torch.Tensor] | None
    prescription: Prescription | None


def propagated_point_spread_function(
    system: optical_system,
    size: int = 512,
    pitch: float | None = None,
    propagation_type: str = "Bandlimited Angular Spectrum",
    *,
    fields: FieldPoints | None = None,
    **options: "Unpack[ExitOptions]",
) -> Spread:
    """Return the image of a point with diffraction by propagating the field of the exit pupil to the image.

    Parameters
    ----------
    system : optical_system
        The system.
    size : int
        Samples along each side of the field and of the image.
    pitch : float, optional
        Their pitch, by default such that the light fills most of the field.
    propagation_type : str, default: "Bandlimited Angular Spectrum"
        Method of :func:`odak.learn.wave.propagate_beam` by which the field is propagated to the image.
    fields : sequence of pairs or torch.Tensor, optional
        Field points (x, y), or ``[F, 2]``, in place of `field`, all on grids of one pitch.
    **options
        Of :func:`exit_field` (`field`, `wavelength`, `distance`, `aim`, `vignetting`, `apodization`, `prescription`).

    Returns
    -------
    Spread
        Of one wavelength, ``[..., 1, F, rows, columns]``, in the plane perpendicular to the chief ray through its image
        point; F is 1 unless `fields` are given. Differentiable.

    Notes
    -----
    Unlike :func:`point_spread_function` this takes neither Abbe's sine condition nor a small aperture for granted: the
    field has the amplitude and the phase of the rays where they are. It costs more: the pitch must resolve the phase of
    the whole converging wave. The unit is the peak of a sphere of the same amplitude about the image point, by the
    Rayleigh–Sommerfeld integral (Goodman 2005, section 3.5).

    Examples
    --------
    >>> from odak.learn.raytracing.system import optical_system, propagated_point_spread_function, surface
    >>> lens = optical_system([surface(5.0, material=1.5, thickness=0.2), surface(thickness=9.8)], aperture=0.2)
    >>> spread = propagated_point_spread_function(lens, 128)
    >>> 0.9 < spread.strehl.max().item() < 1.01
    True
    """
    from odak.learn.wave.propagation import propagate_beam

    if fields is not None:
        points = field_points(system, fields)
        if pitch is None:
            with torch.no_grad():
                pitch = max(exit_field(system, size, plane="chief", **{**options, "field": f}).pitch for f in points)
        parts: list[Any] = [
            propagated_point_spread_function(system, size, pitch, propagation_type, **{**options, "field": point})
            for point in points
        ]
        return Spread(*(torch.cat([part[i] for part in parts], axis) for i, axis in enumerate((-3, -2, -1, -1))))
    wave = exit_field(system, size, pitch, plane="chief", **options)
    count = wave.field.shape[-1]
    line = (torch.arange(count, dtype=torch.float64, device=wave.field.device) - count // 2) * wave.pitch
    distance = wave.to_image[..., None, None]
    squared = line[:, None] ** 2 + line**2 + distance * distance
    peak = (wave.field.abs() * distance.abs() / squared).sum((-2, -1)) * (wave.pitch**2 / wave.wavelength)
    image = propagate_beam(wave.field, None, wave.to_image, wave.pitch, wave.wavelength, propagation_type)
    intensity = (image.abs().square() / peak[..., None, None].square())[..., None, None, :, :]
    pitches = torch.full((*intensity.shape[:-2], 2), wave.pitch, dtype=torch.float64, device=intensity.device)
    energy = (wave.field.abs().square().sum((-2, -1)) / peak.square())[..., None, None]
    return Spread(intensity, pitches, intensity.amax((-2, -1)), energy)


@_show.shown
class ExitField(NamedTuple):
    """A field behind a system; lengths in the system's unit.

    Attributes
    ----------
    field : torch.Tensor
        Complex ``[..., rows, columns]``, rows along y and columns along x; the chief ray is at sample n // 2 of each
        axis, where the phase is 0. Light of power 1 falls on the paraxial entrance pupil: Σ|U|²·cos θ·pitch² is what
        comes out of it.
    pitch : float
        Pixel pitch.
    wavelength : float
        In the medium behind the system.
    to_image : torch.Tensor
        Distance along the plane's normal to the chief ray's point in the image, ``[...]``.
    status : torch.Tensor
        What befell the ray of each sample, numbers of :class:`odak.raytracing.RayStatus`, int8
        ``[..., rows, columns]``; MISS outside the pupil.

    Examples
    --------
    >>> from odak.learn.raytracing.system import ExitField, exit_field, optical_system, surface
    >>> lens = optical_system([surface(5.0, material=1.5, thickness=0.2), surface(thickness=9.8)], aperture=0.2)
    >>> wave = exit_field(lens, 128)
    >>> tuple(wave.field.shape[-2:]), wave.wavelength == lens.wavelengths[0]
    ((128, 128), True)
    """

    field: torch.Tensor
    pitch: float
    wavelength: float
    to_image: torch.Tensor
    status: torch.Tensor


@_validate.takes_units()
def exit_field(
    system: optical_system,
    size: int | Sequence[int] = 512,
    pitch: float | None = None,
    *,
    distance: float | None = None,
    plane: str = "axis",
    field: int | torch.Tensor | Sequence[float] = 0,
    wavelength: int | None = None,
    aim: str = "paraxial",
    vignetting: bool = True,
    apodization: Callable[[torch.Tensor], torch.Tensor] | None = None,
    prescription: Prescription | None = None,
    dtype: torch.dtype = torch.complex128,
) -> ExitField:
    """Return the field of a point behind a system on a regular grid: amplitude and optical path by rays.

    Parameters
    ----------
    system : optical_system
        The system.
    size : int or sequence of int
        Samples [rows, columns].
    pitch : float, optional
        Pixel pitch; by default such that the light fills ten elevenths of the grid.
    distance : float, optional
        From the last vertex to the plane, where the chief ray crosses it; the paraxial exit pupil's by default. Where
        the pupil is virtual, so is the field: the medium behind the system is continued to it.
    plane : str
        "axis": perpendicular to the axis. "chief": perpendicular to the chief ray, for fields off the axis, whose phase
        otherwise asks for a much smaller pitch.
    field : int or pair of float
        Number of one of the system's fields, or a field point (x, y).
    wavelength : int
        Number of one of the system's wavelengths; the reference one by default.
    aim : str
        "paraxial": the light fills the paraxial entrance pupil. "real": it fills the stop.
    vignetting : bool
        Let semi-diameters block rays.
    apodization : callable, optional
        Amplitude over coordinates of the entrance pupil: takes ``[..., 2]``, 1 at the rim, returns ``[...]``.
    prescription : Prescription, optional
        Numbers in place of the system's own, a batch of systems perhaps.
    dtype : torch.dtype
        complex128 or complex64; phases are formed in float64.

    Returns
    -------
    ExitField
        Differentiable in the system's numbers.

    Raises
    ------
    ValueError
        If the exit pupil is at infinity and no distance is given, if the pitch cannot resolve the phase, if the field
        does not fit on the grid, or if rays cross in the plane.

    Notes
    -----
    For each sample the ray that meets it is found by Newton's method. The amplitude follows a tube of rays, which
    keeps the power: with q the place in the plane and p the place in the pupil, |U|² = |A(p)|²/(|∂q/∂p|·cos θ) (Born
    and Wolf, Principles of Optics, 1999, section 3.1.2). Geometric optics knows no diffraction before the plane.
    Therefore the plane belongs into the exit pupil, whose rim cuts the wave; close to the focus, fringes of that rim
    are missing.

    Examples
    --------
    >>> from odak.learn.raytracing.system import exit_field, optical_system, surface
    >>> from odak.learn.wave import propagate_beam
    >>> lens = optical_system([surface(5.0, material=1.5, thickness=0.2), surface(thickness=9.8)], aperture=0.2)
    >>> wave = exit_field(lens, 128)
    >>> image = propagate_beam(wave.field, None, wave.to_image, wave.pitch, wave.wavelength)
    >>> divmod(image.abs().argmax().item(), 128)
    (64, 64)
    """
    rows, columns = _validate.size("size", [size, size] if isinstance(size, int) else size)
    plane, aim = _validate.one_of("plane", plane, PLANES), _validate.one_of("aim", aim, AIMS)
    checked_system(system), checked_prescription(prescription)
    vignetting = _validate.flag("vignetting", vignetting)
    _validate.function_or_none("apodization", apodization)
    if dtype not in (torch.complex64, torch.complex128):
        raise TypeError(f"dtype must be torch.complex64 or torch.complex128, got {dtype}")
    place = _place("wavelength", wavelength, len(system.wavelengths), system.reference)
    if isinstance(field, (list, tuple)):
        _validate.several("field", field, 2)
    if isinstance(field, (torch.Tensor, list, tuple)):
        point = field_points(system, [field] if not isinstance(field, torch.Tensor) else field[None])[0]
    else:
        point = field_points(system)[_place("field", field, len(system.fields), 0)]
    point = point.to(system.surfaces[0].thickness.device)
    distance = _exit_pupil(system, prescription) if distance is None else _validate.number("distance", distance)
    rays = RayMap(system, prescription, place, point, distance, plane == "chief")
    check_image_space(system, rays.numbers)
    vacuum, index = system.wavelengths[place], rays.numbers.index[..., 0, -1].detach()
    grid = _grid(rays, aim, (rows, columns), pitch, vacuum / float(index.abs().max()))
    pieces = zip(grid.chosen.split(PIECE), grid.guess.split(PIECE, -2), strict=True)
    parts = [_samples(rays, grid, *piece, aim, vignetting, apodization) for piece in pieces]
    amplitude, path, status = (torch.cat(values, -1) for values in zip(*parts, strict=True))
    wave = phasor_of_cycles(path / vacuum, dtype)
    wave = wave * amplitude.to(torch.float64 if dtype == torch.complex128 else torch.float32)
    shape = (*wave.shape[:-1], rows * columns)
    whole = torch.zeros(shape, dtype=dtype, device=wave.device).index_copy(-1, grid.chosen, wave)
    marks = torch.full(shape, RayStatus.MISS.value, dtype=torch.int8, device=wave.device)
    marks = marks.index_copy(-1, grid.chosen, status)
    shape = (*shape[:-1], rows, columns)
    medium = vacuum / float(index.reshape(-1)[0])
    return ExitField(whole.reshape(shape), grid.pitch, medium, rays.to_image, marks.reshape(shape))


class _Grid(NamedTuple):
    """Samples that rays may reach: their numbers ``[P]``, places ``[P, 2]`` and guessed pupil places ``[..., P, 2]``.

    `sign` is the sign of the map's Jacobian, ``[..., 1]``.
    """

    pitch: float
    chosen: torch.Tensor
    target: torch.Tensor
    guess: torch.Tensor
    sign: torch.Tensor


def _place(name: str, value: Any, count: int, default: int) -> int:
    value = default if value is None else value
    if isinstance(value, bool) or not isinstance(value, int) or not -count <= value < count:
        raise ValueError(f"{name} must be the number of one of the system's {count}, got {value!r}")
    return value % count


def _exit_pupil(system, prescription):
    """Return the position of the paraxial exit pupil."""
    found = first_order(system, prescription=prescription).exit_pupil_distance
    if not bool(torch.isfinite(found).all()) or float(found.detach().abs().max()) > 1e6 * _length(system):
        raise ValueError("distance must be given: the exit pupil is at infinity")
    return found


def _length(system) -> float:
    return sum(abs(float(item.thickness.detach())) for item in system.surfaces) or 1.0


@torch.no_grad()
def _grid(rays: RayMap, aim: str, shape, pitch, wavelength: float) -> _Grid:
    """Return the samples that rays may reach, and estimates of their coordinates in the pupil."""
    places = rays.samples(aim)
    met = rays(places)
    lost = met.status != RayStatus.HIT
    if bool(lost.all()):
        raise ValueError("field must have rays that reach the image, got one whose rays are all lost")
    sign = _sign(rays, places)
    largest = torch.stack([torch.where(lost, 0.0, value).abs().max() for value in (met.y, met.x, met.u, met.v)])
    *extent, u, v = largest.tolist()
    steep = max(u, v)
    if pitch is None:
        pitch = max(2 * MARGIN * size / count for size, count in zip(extent, shape, strict=True))
    pitch = _validate.constant("pitch", pitch, positive=True)
    if pitch * steep > wavelength / 2:
        most = wavelength / 2 / steep
        count = math.ceil(2 * MARGIN * max(extent) / most)
        raise ValueError(
            f"pitch must be at most {most:.4g} for the phase of these rays, got {pitch:.4g}: take a size of {count} or "
            "more, a plane nearer to the focus (distance), or one perpendicular to the chief ray (plane)"
        )
    if any(size > pitch * ((count - 1) // 2) for size, count in zip(extent, shape, strict=True)):
        least = max(size / max((count - 1) // 2, 0.5) for size, count in zip(extent, shape, strict=True))
        raise ValueError(f"pitch must be at least {least:.4g} for the field to fit into {shape}, got {pitch:.4g}")
    lines = [(torch.arange(n, dtype=torch.float64, device=places.device) - n // 2) * pitch for n in shape]
    y, x = torch.meshgrid(*lines, indexing="ij")
    target = torch.stack([x, y], -1).reshape(-1, 2)
    near = (target[:, 0].abs() <= extent[1] + 2 * pitch) & (target[:, 1].abs() <= extent[0] + 2 * pitch)
    chosen = torch.nonzero(near)[:, 0]
    guess = rays.guess(places, met, target[chosen])
    size = places.square().sum(-1).sqrt().amax()
    within = guess.square().sum(-1).sqrt() <= 1.2 * size + 3 * pitch / max(*extent, pitch)
    within = within.reshape(-1, within.shape[-1]).any(0)
    return _Grid(pitch, chosen[within], target, guess[..., within, :], sign)


def _sign(rays: RayMap, places: torch.Tensor) -> torch.Tensor:
    """Return the sign of the map's Jacobian, ``[..., 1]``; raise if rays cross, so that several reach one point."""
    (xa, ya), (xb, yb), _ = rays.derivatives(places)
    signs = torch.sign(xa * yb - xb * ya).nan_to_num()
    if bool(((signs > 0).any(-1) & (signs < 0).any(-1)).any()):
        raise ValueError("distance must put the plane where rays do not cross: this one is within their caustic")
    return signs.sum(-1, keepdim=True)


def _samples(rays: RayMap, grid: _Grid, chosen, guess, aim: str, vignetting: bool, apodization):
    """Return amplitude, optical path and status of some samples, ``[..., P]``."""
    target = grid.target[chosen]
    places = rays.solve(target, guess)
    met = rays(places, vignetting)
    share, area = _tube_area(rays, places, target, aim, grid)
    kept = (met.status == RayStatus.HIT) & (share > 0)
    amplitude = share if apodization is None else share * apodization(places)
    scale = torch.where(kept, math.pi * area * torch.where(kept, met.cosine, 1.0).abs(), 1.0).sqrt()
    status = torch.where(share > 0, met.status, RayStatus.MISS.value).to(torch.int8)
    return torch.where(kept, amplitude, 0.0) / scale, torch.where(kept, met.path, 0.0), status


def _tube_area(rays: RayMap, places: torch.Tensor, target: torch.Tensor, aim: str, grid: _Grid):
    """Return the fraction of each sample inside the pupil, and the area of the plane per area of the pupil."""
    (xa, ya), (xb, yb), middle = rays.derivatives(places)
    # The area is undefined without the ray itself and its neighbours; a placeholder keeps NaN out of the gradients.
    near = (torch.stack(middle, -1).detach() - target).abs().amax(-1) < 1e-3 * grid.pitch
    whole = near & torch.isfinite(xa + ya + xb + yb)
    xa, yb, ya, xb = (torch.where(whole, v, d) for v, d in ((xa, 1.0), (yb, 1.0), (ya, 0.0), (xb, 0.0)))
    area = xa * yb - xb * ya
    radius, ra, rb = rays.radius(places, aim)
    # Gradient of that radius in the plane: its derivatives by the pupil's coordinates, times the Jacobian of the map.
    growth = safe_sqrt((ra * yb - rb * ya).square() + (rb * xa - ra * xb).square())
    growth = growth / torch.where(area == 0, 1.0, area).abs()
    share = ((1 - radius) / (growth * grid.pitch).clamp(min=1e-12) + 0.5).clamp(0, 1)
    # Beyond the edge the map may fold over; samples there do not belong to the pupil.
    return torch.where(whole & (area * grid.sign > 0), share, 0.0), area.abs()


def huygens_point_spread_function(
    system: optical_system,
    samples: int | None = None,
    size: int | None = None,
    pitch: float | None = None,
    *,
    prescription: Prescription | None = None,
    fields: FieldPoints | None = None,
    aim: str = "paraxial",
    vignetting: bool = True,
) -> Spread:
    """Return the image of a point with diffraction as the sum of the plane waves of all rays.

    Parameters
    ----------
    system : optical_system
        The system.
    samples : int, optional
        Rays across the pupil; as many as resolve the wavefront by default, 64 to 512.
    size : int, optional
        Pixels along each side of the image; by default twice as many as rays across the pupil, or 128 of a given pitch.
    pitch : float, optional
        Pitch of the pixels in the system's unit; by default the wavelength over four times the paraxial numerical
        aperture, which no detail of the image is finer than.
    prescription : Prescription, optional
        Numbers in place of the system's own, a batch of systems perhaps.
    fields : sequence of pairs or torch.Tensor, optional
        Field points in place of the system's.
    aim : str
        "paraxial" or "real", how :func:`launch` aims.
    vignetting : bool
        Let apertures block rays.

    Returns
    -------
    Spread
        Centred on the image point of each wavelength's chief ray, in the plane across the axis. Differentiable.

    Notes
    -----
    Every ray is a plane wave of its direction, phase and equal amplitude, scalar; no reference sphere and no sine
    condition enter. The rays are a regular grid in the pupil: the sum repeats itself at a distance of `samples` times
    the wavelength over the image's full angle. An AccuracyWarning gives the number of samples that would do where more
    than 1 % of the light comes out at a wrong place in the image for that reason.

    The sum over the rays, whose directions are not on a grid, is a transform after spreading them over a grid of twice
    the width (Barnett et al., SIAM J. Sci. Comput. 41, C479 (2019)); it differs from the sum by about 1e-13 of the
    peak without aberrations.

    Examples
    --------
    >>> from odak.learn.raytracing.system import huygens_point_spread_function, load_system
    >>> tuple(huygens_point_spread_function(load_system("cooke_triplet"), 40, 32).intensity.shape)
    (3, 3, 32, 32)
    """
    checked_system(system), checked_prescription(prescription)
    if system.afocal:
        raise ValueError(
            "system is afocal: the sum of plane waves holds for pupils far from the image in Fresnel zones; use "
            "point_spread_function"
        )
    counts = chosen_samples(samples, RAYS)
    size = 128 if size is None and pitch is not None else size
    options = {"prescription": prescription, "fields": fields, "aim": aim, "vignetting": vignetting}

    def sampled(count: int):
        waves = _plane_waves(system, count, size, pitch, options)
        return waves, waves.sampling(size is not None)

    return resolved(counts, sampled).image()


class _PlaneWaves(NamedTuple):
    """Plane waves of the rays of a grid in the pupil, ``[..., P]``.

    `path`, in waves, is their phase at the chief ray's point in the image plane, `ways` are their direction cosines
    over the wavelength, `spacing` is the pitch of the image ``[..., 1]`` and `chief` the slopes of the chief ray.
    """

    path: torch.Tensor
    ways: tuple[torch.Tensor, ...]
    weight: torch.Tensor
    points: torch.Tensor
    inside: torch.Tensor
    spacing: torch.Tensor
    size: int
    chief: tuple[torch.Tensor, ...]

    def moved(self, shift: torch.Tensor) -> "_PlaneWaves":
        """Return the same waves about the chief ray's point in another plane."""
        along = [shift * slope for slope in self.chief[:3]]
        path = sum(way * gap for way, gap in zip(self.ways, along, strict=True)) - shift * self.chief[3]
        return self._replace(path=self.path + torch.where(self.weight > 0, path, 0.0))

    def _moments(self) -> tuple[torch.Tensor, torch.Tensor]:
        """Return matrices whose quotient are the slopes of `ways` over the pupil that fit the rays best."""
        pupil, share = self.points.to(self.path), self.weight[..., None]
        moved = share * (pupil - (share * pupil).sum(-2, keepdim=True) / share.sum(-2, keepdim=True))
        return moved.mT @ pupil, moved.mT @ torch.stack(self.ways[:2], -1)

    @torch.no_grad()
    def sampling(self, fixed: bool) -> _Sampling:
        """Return the wavefront on the grid."""
        slopes, _ = torch.linalg.solve_ex(*self._moments())
        steps = slopes.abs().sum(-2).amax(-1, keepdim=True) * (2 / self.inside.shape[-1])
        width = (self.size * self.spacing / 2 * steps).nan_to_num()
        return _Sampling(self.path, self.inside, self.weight, width, fixed)

    def image(self) -> Spread:
        """Return the intensity of the sum of the waves."""
        amplitude = phasor_of_cycles(self.path, torch.complex128) * self.weight
        x, y = (way * self.spacing for way in self.ways[:2])
        field = _nonuniform_transform(amplitude, x, y, self.size)
        total = self.weight.sum(-1)
        intensity = (field.real.square() + field.imag.square()) / total.square()[..., None, None]
        # The area of direction cosines per area of the pupil: the determinant of the slopes that fit the rays best.
        squares, slopes = (torch.linalg.det(value) for value in self._moments())
        spacing = self.spacing[..., 0]
        energy = (self.inside.shape[-1] / 2 / spacing).square() * squares / (slopes.abs() * total)
        return Spread(intensity, torch.stack([spacing, spacing], -1), intensity.amax((-2, -1)), energy)


def _plane_waves(system, samples: int, size: int | None, pitch: float | None, options: dict[Any, Any]) -> _PlaneWaves:
    prescription, vignetting = options["prescription"], options["vignetting"]
    size = 2 * samples if size is None else _validate.integer("size", size, minimum=2)
    points, inside, share = _disc(samples, (samples - 1) / 2)
    origin = torch.zeros(1, 2, dtype=torch.float64)
    own = {name: options[name] for name in ("prescription", "fields", "aim")}
    rays = launch(system, torch.cat([origin, points]), **own)
    found = trace(system, rays, prescription=prescription, vignetting=vignetting)
    centre = trace(system, rays, prescription=prescription, vignetting=False) if vignetting else found
    numbers = numbers_of(system, prescription)
    check_image_space(system, numbers)
    kept = found.arrived[..., 1:]
    weight = torch.where(kept, share.to(found.x), 0.0)
    index = numbers.index[..., -1][..., None, None].abs()
    waves = wavelengths_of(system, numbers)[:, None, None]
    start = path_at_start(system, rays, numbers)
    chief = [value[..., :1] for value in centre[:3]]
    path = (found.path + start)[..., 1:] - (centre.path + start)[..., :1]
    ways = [torch.where(kept, value[..., 1:], 0.0) * index for value in found[3:6]]
    away = [middle - value[..., 1:] for value, middle in zip(found[:3], chief, strict=True)]
    path = path + sum(way * torch.where(kept, gap, 0.0) for way, gap in zip(ways, away, strict=True))
    if pitch is None:
        aperture = first_order(system, prescription=prescription).numerical_aperture
        spacing = waves / (4 * aperture[..., None, None, None])
    else:
        spacing = torch.full_like(waves, _validate.constant("pitch", pitch, positive=True))
    spacing = spacing.expand(*path.shape[:-1], 1)
    u, v, w = (value[..., :1] for value in centre[3:6])
    slopes = (u / w, v / w, torch.ones_like(w), index / (w * waves))
    path = torch.where(kept, path, 0.0) / waves
    return _PlaneWaves(path, tuple(way / waves for way in ways), weight, points, inside, spacing, size, slopes)


def _nonuniform_transform(values: torch.Tensor, x: torch.Tensor, y: torch.Tensor, size: int) -> torch.Tensor:
    """Return the sums of values·exp(2πi(k·x + l·y)) over the last axis for ``size`` whole k and l about 0.

    Parameters
    ----------
    values, x, y : torch.Tensor
        Complex values and cycles per pixel along both axes, ``[..., P]``.
    size : int
        Pixels along each side.

    Returns
    -------
    torch.Tensor
        ``[..., l, k]``; 0 is at size // 2 of both axes.
    """
    fine = 2 * size
    lead = np.broadcast_shapes(values.shape[:-1], x.shape[:-1], y.shape[:-1])
    parts = [value.expand(*lead, value.shape[-1]).reshape(-1, value.shape[-1]) for value in (values, x, y)]
    # Only the middle half is wanted, where the transform of the kernel is far from zero.
    number = torch.arange(size, device=values.device) - size // 2
    wanted = number % fine
    images = []
    for image in zip(*parts, strict=True):
        grid = torch.zeros(fine * fine, dtype=values.dtype, device=values.device)
        for value, *place in zip(*(part.split(SPREAD_AT_A_TIME) for part in image), strict=True):
            (column, along), (row, down) = (_kernel(cycles * fine) for cycles in place)
            cells = (row % fine * fine)[:, :, None] + (column % fine)[:, None, :]
            spread = (value[:, None] * down)[:, :, None] * along[:, None, :]
            grid = grid.index_add(0, cells.reshape(-1), spread.reshape(-1))
        columns = torch.fft.ifft(grid.reshape(fine, fine), dim=-2, norm="forward")[wanted]
        images.append(torch.fft.ifft(columns, norm="forward")[:, wanted])
    nodes, weights = (torch.from_numpy(part).to(x) for part in np.polynomial.legendre.leggauss(4 * WIDTH))
    waves = (number[:, None] * (math.pi * WIDTH / fine * nodes)).cos()
    level = (waves * weights * _bell(nodes)).sum(-1) * (WIDTH / 2)
    return (torch.stack(images) / (level[:, None] * level)).reshape(*lead, size, size)


def _kernel(place: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Return the numbers of the cells near to places ``[P]`` and the share of each, ``[P, WIDTH]``."""
    first = (place.detach() - WIDTH / 2).ceil()
    cells = first[:, None] + torch.arange(WIDTH, dtype=place.dtype, device=place.device)
    return cells.long(), _bell((cells - place[:, None]) * (2 / WIDTH))


def _bell(place: torch.Tensor) -> torch.Tensor:
    # The bound keeps the slope finite at the ends, where the value is 1e-14 of the largest.
    return (BELL * ((1 - place * place).clamp_min(1e-12).sqrt() - 1)).exp()


def modulation_at(spread: Spread, frequency: float, axis: str = "y") -> torch.Tensor:
    """Return the modulation transfer at one frequency.

    Parameters
    ----------
    spread : Spread
        From :func:`huygens_point_spread_function` or :func:`point_spread_function`.
    frequency : float
        Cycles per unit of length.
    axis : str
        "y": of gratings whose lines are along x. "x": the other.

    Returns
    -------
    torch.Tensor
        ``[..., W, F]``. For all frequencies that the image resolves see :func:`modulation_transfer_function`.

    Examples
    --------
    Contrast falls with frequency:

    >>> from odak.learn.raytracing.system import modulation_at, optical_system, point_spread_function, surface
    >>> parabola = surface(radius=-200.0, conic=-1.0, thickness=-100.0, material="mirror")
    >>> spread = point_spread_function(optical_system([parabola], aperture=20.0), 32, 128)
    >>> low, high = (float(modulation_at(spread, frequency)[0, 0]) for frequency in (50.0, 150.0))
    >>> bool(low > high > 0)
    True
    """
    _validate.instance("spread", spread, Spread, "a Spread")
    axis = _validate.one_of("axis", axis, ("x", "y"))
    frequency = _validate.constant("frequency", frequency, least=0)
    profile = spread.intensity.sum(-1 if axis == "y" else -2)
    count = profile.shape[-1]
    place = torch.arange(count, dtype=torch.float64, device=profile.device) - count // 2
    cycles = place * spread.pitch[..., 0 if axis == "y" else 1, None] * frequency
    wave = phasor_of_cycles(cycles, torch.complex128)
    real, imaginary = ((profile * part).sum(-1) for part in (wave.real, wave.imag))
    total = profile.sum(-1) if spread.energy is None or not frequency else spread.energy
    return (real.square() + imaginary.square()).clamp_min(1e-300).sqrt() / total


def through_focus_modulation(
    system: optical_system,
    shifts: Values,
    frequency: float,
    axis: str = "y",
    samples: int | None = None,
    **options: "Unpack[WaveOptions]",
) -> torch.Tensor:
    """Return the modulation transfer at one frequency in planes before and behind the image plane.

    Parameters
    ----------
    system : optical_system
        The system.
    shifts : sequence of float or torch.Tensor
        Distances of the planes from the image plane along z, ``[n]``.
    frequency : float
        Cycles per unit of length.
    axis : str
        "y": of gratings whose lines are along x. "x": the other.
    samples : int, optional
        Rays across the pupil; for each plane as many as resolve the wavefront by default, 32 to 512.
    **options : Any
        Of :func:`huygens_point_spread_function` (`fields`, `aim`, `vignetting`).

    Returns
    -------
    torch.Tensor
        ``[W, F, n]``.

    Examples
    --------
    >>> from odak.learn.raytracing.system import optical_system, surface, through_focus_modulation
    >>> parabola = surface(radius=-200.0, conic=-1.0, thickness=-100.0, material="mirror")
    >>> mirror = optical_system([parabola], aperture=20.0)
    >>> found = through_focus_modulation(mirror, [-0.02, 0.0, 0.02], 50.0)
    >>> int(found[0, 0].argmax())
    1
    """
    checked_system(system)
    shifts = torch.as_tensor(_validate.real("shifts", shifts), dtype=torch.float64)
    if shifts.ndim != 1 or not len(shifts):
        raise ValueError(f"shifts must be a sequence of distances, got {tuple(shifts.shape)}")
    axis = _validate.one_of("axis", axis, ("x", "y"))
    counts = chosen_samples(samples, (32, 48, *RAYS))
    if "prescription" in options:
        raise ValueError("prescription must be left out: the planes are a batch of prescriptions of the system")
    return modulation_in_planes(system, shifts, frequency, counts, (axis,), **options)[0]


def modulation_in_planes(
    system: optical_system,
    shifts: torch.Tensor,
    frequency: float,
    counts: Sequence[int],
    axes: Sequence[str],
    **options: Any,
) -> torch.Tensor:
    """Return the modulation transfer along some axes at one frequency in some planes, ``[axes, ..., W, F, n]``."""
    options = {"prescription": None, "fields": None, "aim": "paraxial", "vignetting": True} | options

    @cache
    def waves(count: int) -> _PlaneWaves:
        return _plane_waves(system, count, None, None, options)

    def image(shift: torch.Tensor) -> Spread:
        def sampled(count: int):
            there = waves(count).moved(shift)
            return there, there.sampling(False)

        return resolved(counts, sampled).image()

    found = []
    for shift in shifts.to(system.surfaces[0].thickness.device):
        spread = image(shift)
        found.append(torch.stack([modulation_at(spread, frequency, axis) for axis in axes]))
    return torch.stack(found, -1)


@takes_constants("frequencies")
@torch.no_grad()
def field_modulation(
    system: optical_system,
    frequencies: Values,
    fields: FieldPoints | None = None,
    *,
    aim: str = "paraxial",
    samples: int | None = None,
) -> torch.Tensor:
    """Return the modulation transfer at some frequencies over the field, at the reference wavelength.

    Parameters
    ----------
    system : optical_system
        The system.
    frequencies : sequence of float
        In cycles per unit of length, ``[n]``.
    fields : sequence or torch.Tensor, optional
        Field points in place of the system's.
    aim : str
        "paraxial" or "real", how :func:`launch` aims.
    samples : int, optional
        Samples across the pupil, as of :func:`point_spread_function`.

    Returns
    -------
    torch.Tensor
        ``[2, n, F]``: of gratings whose lines are along x (tangential for fields along y), and of the others. With
        diffraction, but for fields with more than two waves RMS of aberration, which the samples would not resolve, by
        rays.

    Examples
    --------
    >>> from odak.learn.raytracing.system import field_modulation, load_system
    >>> found = field_modulation(load_system("cooke_triplet"), [20.0, 50.0])
    >>> tuple(found.shape), bool((found[:, 0] > found[:, 1]).all())
    ((2, 2, 3), True)
    """
    given = torch.as_tensor(_validate.real("frequencies", frequencies), dtype=torch.float64)
    if given.ndim != 1 or not len(given) or bool((given < 0).any()):
        raise ValueError(f"frequencies must be a sequence of numbers of at least 0, got {tuple(given.shape)}")
    frequencies, counts = given.tolist(), chosen_samples(samples)
    numbers = checked_system(system).prescription().at(system.reference)
    options: dict[str, Any] = {"fields": fields, "aim": aim, "prescription": numbers}
    points = pupil_quadrature(system, 16, fields=fields, aim=aim)
    large = ~(wavefront(system, points, **options).rms[0] <= LARGE)
    spots = spot_diagram(system, points, **options)
    kept = torch.isfinite(spots.x[0])
    weight = torch.where(kept, points.weights, 0.0)
    weight = weight / weight.sum(-1, keepdim=True)
    if not bool(large.all()):
        options["fields"] = field_points(system, fields).to(large.device)[~large]
        spread = pupil_image(system, counts, None, options, fineness=2)
    found = []
    for axis, value in (("y", spots.y[0]), ("x", spots.x[0])):
        place = torch.where(kept, value, 0.0)
        for frequency in frequencies:
            wave = phasor_of_cycles(frequency * place, torch.complex128)
            found.append((weight * wave).sum(-1).abs())
            if not bool(large.all()):
                found[-1][~large] = modulation_at(spread, frequency, axis)[0]
    return torch.stack(found).unflatten(0, (2, len(frequencies)))


def relative_illumination(
    system: optical_system,
    count: int = 24,
    *,
    prescription: Prescription | None = None,
    **options: "Unpack[FieldOptions]",
) -> torch.Tensor:
    """Return the illuminance of the image of a uniform Lambertian object, relative to the axis.

    Parameters
    ----------
    system : optical_system
        The system.
    count : int
        Rings of rays in the pupil, each of four times as many rays; vignetting is resolved by their number.
    prescription : Prescription, optional
        Numbers in place of the system's own, a batch of systems perhaps.
    **options : Any
        Of :func:`launch` (`fields`, `aim`) and :func:`trace` (`vignetting`). Aim "real" includes the aberrations of
        the pupil.

    Returns
    -------
    torch.Tensor
        ``[..., W, F]``. Losses by reflection and absorption are left out.

    Notes
    -----
    The illuminance is the radiance times the area that the cone of rays covers in direction cosines (u, v) of image
    space (Rimmer, Proc. SPIE 655, 99 (1986)): the integral over the pupil of the Jacobian of (u, v), Gaussian along the
    radius and in equal steps around, each ray's Jacobian being exact; where the pupil is folded, its directions count
    once. The rays of a distant point stay parallel in a
    system without power, such as a pinhole; there the same illuminance is the integral over the pupil of the solid
    angle in front that each ray's neighbours bring to an area of the image.

    Examples
    --------
    >>> from odak.learn.raytracing.system import load_system, relative_illumination
    >>> relative_illumination(load_system("cooke_triplet"))[1].shape
    torch.Size([3])
    """
    checked_system(system), checked_prescription(prescription)
    count = _validate.integer("count", count, minimum=2)
    points, weight = pupil_quadrature(system, count, vignetting=False)
    own = {name: options.pop(name) for name in ("fields", "aim") if name in options}

    def covered(fields):
        def directions(place):
            rays = launch(system, place, prescription=prescription, aim=own.get("aim", "paraxial"), fields=fields)
            found = trace(system, rays, prescription=prescription, **options)
            return (found.u, found.v), found.arrived

        (ux, vx), (uy, vy), kept = _along_axes(directions, points)
        area = torch.where(kept, ux * vy - uy * vx, 0.0) * weight
        # Where the pupil is folded over itself the Jacobian has the other sign: directions that are covered already.
        return (area * area.detach().sum(-1, keepdim=True).sign()).clamp_min(0.0).sum(-1)

    def brought(fields):
        places = field_points(system, fields).to(points.device)

        def landed(angles):
            rays = launch(system, points, prescription=prescription, aim=own.get("aim", "paraxial"), fields=angles)
            found = trace(system, rays, prescription=prescription, **options)
            return (rays.u, rays.v, found.x, found.y), found.arrived

        first, second, kept = _along_axes(landed, places)
        sky, image = ((first[i] * second[i + 1] - first[i + 1] * second[i]).abs() for i in (0, 2))
        return (torch.where(kept, sky / torch.where(kept, image, 1.0), 0.0) * weight).sum(-1)

    aperture = first_order(system, prescription=prescription).numerical_aperture
    light = brought if system.at_infinity and not bool((aperture > 0).any()) else covered
    return light(own.get("fields")) / light([(0.0, 0.0)])


def _along_axes(function, points: torch.Tensor):
    """Return the derivatives of a function of points ``[n, 2]`` along either axis, and what else it returns."""
    x, y = (unit.expand_as(points).clone() for unit in torch.eye(2, dtype=points.dtype, device=points.device))
    _, along_x, kept = forward_derivative(function, points, x, has_aux=True)
    return along_x, forward_derivative(function, points, y, has_aux=True)[1], kept
