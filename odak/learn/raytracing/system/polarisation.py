"""Polarised rays: their 3 × 3 matrices through a system, losses, diattenuation, retardance, and images of points."""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import torch

from odak import _show, _validate
from odak.catalog.materials import OpticalMaterial, absorption_coefficient
from odak.learn.raytracing.nonsequential import axes_across, irradiance_of, perpendicular
from odak.learn.raytracing.system.films import PolarizingFilm
from odak.learn.raytracing.system.paraxial import first_order, ghost_system
from odak.learn.raytracing.system.prescriptions import Prescription
from odak.learn.raytracing.system.pupils import launch
from odak.learn.raytracing.system.sequence import IDENTITY, Passage, flat_arguments, placement, plain_trace
from odak.learn.raytracing.system.specification import FieldPoints
from odak.learn.raytracing.system.surfaces import Coating, checked_system, layout_of, numbers_of, optical_system
from odak.learn.raytracing.system.tracing import RaysLike, Traced, checked_rays, finished, spread_rays
from odak.learn.raytracing.system.waves import Spread, chosen_samples, pupil_image
from odak.raytracing.geometry import safe_sqrt

BARE = Coating()


@_show.shown
class PolarizedRays(NamedTuple):
    """Rays at the end of a polarised trace; the axes ``[...]`` are ``[..., wavelengths, fields, pupil points]``.

    Attributes
    ----------
    traced : Traced
        The rays.
    matrix : torch.Tensor
        Polarisation ray tracing matrices P, complex ``[..., 3, 3]``: the electric field behind the system is P times
        the field in front, in units in which its square is the power. P also maps the direction of the ray in front to
        the direction behind.
    rotation : torch.Tensor
        The same matrices Q of a system whose surfaces change directions alone, ``[..., 3, 3]``, of determinant −1 for
        an odd number of mirrors.
    incoming, outgoing : torch.Tensor
        Unit directions in front and behind, ``[..., 3]``.
    absorption : torch.Tensor
        Fraction of the power that the media let pass, ``[...]``; not part of the matrices.

    Examples
    --------
    >>> from odak.learn.raytracing.system import launch, load_system, polarized_trace
    >>> lens = load_system("singlet")
    >>> rays = polarized_trace(lens, launch(lens, "rings", 1))
    >>> tuple(rays.matrix.shape[-2:])
    (3, 3)
    """

    traced: Traced
    matrix: torch.Tensor
    rotation: torch.Tensor
    incoming: torch.Tensor
    outgoing: torch.Tensor
    absorption: torch.Tensor

    @property
    def jones(self) -> torch.Tensor:
        """Jones matrices ``[..., 2, 2]`` of QᵀP in the axes of :func:`transverse_axes` across the ray in front."""
        axes = transverse_axes(self.incoming).to(self.matrix.dtype)
        inner = self.rotation.mT.to(self.matrix.dtype) @ self.matrix
        return axes.mT @ inner @ axes

    @property
    def transmittance(self) -> torch.Tensor:
        """Fraction of the power of unpolarised light that arrives, ``[...]``; 0 for rays that are lost."""
        return self.throughput()

    def throughput(self, polarization: Sequence[complex] | None = None) -> torch.Tensor:
        """Return the fraction of the power of light of a state of polarisation that arrives, ``[...]``.

        Parameters
        ----------
        polarization : sequence of two numbers, optional
            Jones vector along x and y in front of the system, complex perhaps; unpolarised by default.

        Returns
        -------
        torch.Tensor
            0 for rays that are lost.
        """
        if polarization is None:
            power = self.jones.abs().square().sum((-2, -1)) / 2
        else:
            state = torch.tensor(jones_vector(polarization), dtype=self.matrix.dtype, device=self.matrix.device)
            power = (self.jones @ state).abs().square().sum(-1) / state.abs().square().sum()
        return torch.where(self.traced.arrived, power * self.absorption, 0.0)

    @property
    def diattenuation(self) -> torch.Tensor:
        """(T_max − T_min)/(T_max + T_min) over all states of polarisation, ``[...]``; NaN for rays that are lost."""
        total, both = self.jones.abs().square().sum((-2, -1)), torch.linalg.det(self.jones).abs()
        found = safe_sqrt(total * total - 4 * both * both) / torch.where(total > 0, total, 1.0)
        return torch.where(self.traced.arrived, found, torch.nan)

    @property
    def retardance(self) -> torch.Tensor:
        """Phase in radians between the two eigenstates, 0 … π, ``[...]``; NaN for rays that are lost.

        It is computed from the unitary part of QᵀP, which excludes rotations by folded paths (Yun, McClain and Chipman,
        Appl. Opt. 50, 2866 (2011)). A perfect mirror has none; one total reflection of Fresnel's phase difference δ has
        π − δ, two in one plane have 2δ.
        """
        unitary = _unitary(self.jones)
        half = (unitary[..., 0, 0] + unitary[..., 1, 1]) / 2
        rest = unitary - half[..., None, None] * torch.eye(2, dtype=unitary.dtype, device=unitary.device)
        sine = safe_sqrt(rest.abs().square().sum((-2, -1)) / 2)
        return torch.where(self.traced.arrived, 2 * torch.atan2(sine, half.abs()), torch.nan)


def _unitary(jones: torch.Tensor) -> torch.Tensor:
    """Return the unitary factor of 2 × 2 matrices: J + det J/|det J|·adj(J)ᴴ, normalised."""
    a, b, c, d = jones[..., 0, 0], jones[..., 0, 1], jones[..., 1, 0], jones[..., 1, 1]
    determinant = a * d - b * c
    size = determinant.abs()
    phase = torch.where(size > 0, determinant, 1.0) / torch.where(size > 0, size, 1.0)
    adjoint = torch.stack([torch.stack([d, -c], -1), torch.stack([-b, a], -1)], -2).conj()
    total = jones + phase[..., None, None] * adjoint
    scale = safe_sqrt(jones.abs().square().sum((-2, -1)) + 2 * size)
    return total / torch.where(scale > 0, scale, 1.0)[..., None, None]


def transverse_axes(direction: torch.Tensor) -> torch.Tensor:
    """Return the axes x and y carried along from the z axis to unit directions, as columns ``[..., 3, 2]``.

    Parameters
    ----------
    direction : torch.Tensor
        ``[..., 3]``, of positive component along z.
    """
    return torch.stack([torch.stack(axis, -1) for axis in axes_across(direction.unbind(-1))], -1)


def polarized_trace(
    system: optical_system, rays: RaysLike, *, prescription: Prescription | None = None, vignetting: bool = True
) -> PolarizedRays:
    """Trace polarised rays through a system, with the losses at its surfaces and within its glasses.

    Parameters
    ----------
    system : optical_system
        The system. Surfaces without a coating are bare interfaces, mirrors without one ideal; diffractive phases turn
        the field with the ray, without loss. Polarising films (:class:`PolarizingFilm`) act on the
        side of each surface that is met: as mirrors by what they reflect, otherwise by what they transmit.
    rays : Rays or torch.Tensor
        From :func:`launch`, or ``[..., 2, 3]``, points from the first vertex.
    prescription : Prescription, optional
        Numbers in place of the system's own.
    vignetting : bool
        Let apertures block rays.

    Returns
    -------
    PolarizedRays
        complex128, differentiable in rays, numbers and the parameters of the films.

    Notes
    -----
    Yun, Crabtree and Chipman, Appl. Opt. 50, 2855 (2011): P is the product of the matrices of the surfaces, each made
    of the coefficients along s, p and the ray. Here the coefficients of transmission are multiplied by
    √(n₂·cos θ₂/(n₁·cos θ₁)), so that squares are powers. In media of graded index the field turns with the ray without
    turning about it (Rytov's law), and is absorbed as in their material.

    Examples
    --------
    >>> from odak.learn.raytracing.system import launch, load_system, polarized_trace
    >>> lens = load_system("singlet")
    >>> round(float(polarized_trace(lens, launch(lens, "rings", 1)).transmittance[0, 0, 0]), 2)
    0.92
    """
    numbers = numbers_of(system, prescription)
    vignetting = _validate.flag("vignetting", vignetting)
    rays = checked_rays(rays)
    layout = layout_of(system.surfaces, numbers, system.image, vignetting)
    flat, shape = spread_rays(rays, numbers)
    flat = [value.double() for value in flat]
    held = numbers.numbers(system.image)
    record = _Record(system, held, flat)
    state = plain_trace(layout, *flat, *flat_arguments(layout, held)[0], record=record)
    incoming, outgoing = (torch.stack(parts, -1) for parts in (flat[3:6], state[3:6]))
    parts = (record.matrix, record.rotation, incoming, outgoing, record.absorption)
    tails = (2, 2, 1, 1, 0)
    parts = [value.reshape(*shape, *value.shape[value.ndim - n :]) for value, n in zip(parts, tails, strict=True)]
    return PolarizedRays(finished(state, shape), *parts)


class _Record:
    """Product of the matrices of the surfaces, in the frame of the axis at the present surface."""

    def __init__(self, system, numbers, rays):
        self.system, self.wavelength = system, numbers.wavelength[:, None]
        self.shift, self.tilt = numbers.shift, numbers.tilt
        one = torch.eye(3, dtype=torch.float64, device=rays[0].device)
        self.rotation = one.expand(*rays[0].shape, 3, 3)
        self.matrix = self.rotation.to(torch.complex128)
        self.absorption = torch.ones_like(rays[0])
        self.medium: Any = "air"

    def __call__(self, passage: Passage) -> None:
        """Multiply by the matrix of a surface, or change the frame."""
        if passage.action == "break":
            rotation = self._axes(passage.change).mT
            self._multiply(rotation.to(self.matrix.dtype), rotation)
            return
        if passage.action == "bend":
            frame, rotation = passage.change
            axes = self._axes(frame)
            rotation = axes.mT @ rotation @ axes
            self._multiply(rotation.to(self.matrix.dtype), rotation)
            self.absorption = self.absorption * self._passed(passage.length)
            return
        item = self.system.surfaces[passage.place] if passage.place < len(self.system.surfaces) else None
        self.absorption = self.absorption * self._passed(passage.length)
        if item is not None and not item.reflects:
            self.medium = item.material
        film = None if item is None else item.coating
        if item is None or (passage.action == "pass" and item.own_phase is None and film is None):
            return
        k, out, normal = (torch.stack(torch.broadcast_tensors(*way), -1) for way in passage[2:5])
        along = out[..., :, None] * k[..., None, :]
        if isinstance(film, PolarizingFilm):
            self._pass_film(film, item, passage, k, out, normal, along)
            return
        if item.own_phase is not None:
            rotation = _rotation_between(k, out, item.reflects)
            self._multiply(rotation.to(self.matrix.dtype), rotation)
            return
        s = _across(k, normal)
        p, p_out = torch.linalg.cross(k, s), torch.linalg.cross(out, s)
        a, b = (s[..., :, None] * s[..., None, :], p_out[..., :, None] * p[..., None, :])
        side = -1.0 if item.reflects else 1.0
        coefficients = self._coefficients(item, film, passage, k, out, normal)
        matrix = sum(c[..., None, None] * part for c, part in zip(coefficients, (a, b), strict=True)) + along
        self._multiply(matrix, a + side * b + along)

    def _pass_film(self, film, item, passage, k, out, normal, along) -> None:
        """Multiply by the matrix of a polarising film."""
        place = IDENTITY
        if self.tilt is not None:
            place = placement(self.shift[:, None, passage.place], self.tilt[:, None, passage.place])
        axes = self._axes(place)
        normal = (axes.mT @ normal[..., None])[..., 0]
        normal = torch.where(normal[..., 2:] < 0, -normal, normal)
        frame = axes @ torch.cat([transverse_axes(normal), normal[..., None]], -1)
        ways = [(frame.mT @ way[..., None])[..., 0] for way in (k, out)]
        before, behind = (frame @ _carried_axes(way) for way in ways)
        index = passage.before
        found = film.matrices(index * ways[0][..., 0], index * ways[0][..., 1], self.wavelength, self.system.unit)
        # An ideal mirror turns the field over.
        jones = -found.reflection if item.reflects else found.transmission
        jones = jones.to(self.matrix.dtype)
        if not item.reflects:
            jones = torch.where((ways[0][..., 2] < 0)[..., None, None], jones.mT, jones)
        matrix = behind.to(jones.dtype) @ jones @ before.mT.to(jones.dtype)
        self._multiply(matrix + along, behind @ before.mT + along)

    def _multiply(self, matrix, rotation) -> None:
        self.matrix, self.rotation = matrix @ self.matrix, rotation @ self.rotation

    def _axes(self, frame) -> torch.Tensor:
        """Return the axes of a frame as columns, ``[..., 3, 3]``."""
        zero = torch.zeros_like(self.absorption)
        return torch.stack([torch.stack([value + zero for value in row], -1) for row in frame.matrix], -2)

    def _coefficients(self, item, film, passage, k, out, normal) -> tuple[Any, ...]:
        """Return the complex amplitude coefficients along s and p."""
        if item.reflects and film is None:
            one = torch.ones_like(self.absorption, dtype=self.matrix.dtype)
            return -one, one
        cosine, cosine_behind = ((way * normal).sum(-1).abs() for way in (k, out))
        films = BARE if film is None else film
        n1, n2, unit = passage.before, passage.behind, self.system.unit
        found = films.amplitudes(n1, n2, cosine, cosine_behind, self.wavelength, unit)
        return found[:2] if item.reflects else found[2:]

    def _passed(self, length):
        """Return the fraction of the power that the medium in front of a surface lets pass."""
        if not isinstance(self.medium, OpticalMaterial):
            return 1.0
        return torch.exp(-absorption_coefficient(self.medium, self.wavelength, self.system.unit) * length.abs())


def _carried_axes(direction):
    """Return the axes x and y carried along from the z axis or from −z, as columns ``[..., 3, 2]``."""
    axes = transverse_axes(direction)
    # Those from −z are right-handed about the ray, with y turned over.
    return torch.where(direction[..., 2, None, None] < 0, axes * axes.new_tensor([1.0, -1.0]), axes)


def _across(k, normal):
    """Return unit vectors across the plane of incidence; any across the ray at normal incidence."""
    way = k.unbind(-1)
    return torch.stack(perpendicular(way, normal.unbind(-1), axes_across(way)[0]), -1)


def _rotation_between(k, out, reflects: bool):
    """Return the matrices that map directions to others: rotations in their plane, or reflections."""
    one = torch.eye(3, dtype=k.dtype, device=k.device)
    if reflects:
        apart = out - k
        return one - 2 * apart[..., :, None] * apart[..., None, :] / apart.square().sum(-1)[..., None, None]
    both = k + out
    mirrored = both[..., :, None] * both[..., None, :] / (1 + (k * out).sum(-1))[..., None, None]
    return one - mirrored + 2 * out[..., :, None] * k[..., None, :]


class Ghost(NamedTuple):
    """Light that is reflected at one surface, back at an earlier one, perhaps again, and arrives at the image.

    Attributes
    ----------
    first : int
        Number of the surface at which it is reflected forwards again.
    second : int
        Number of the later surface, at which it is reflected backwards before.
    power : torch.Tensor
        Fraction of the light through the entrance pupil that arrives in this way, ``[fields]``.
    focus : torch.Tensor
        Distance of its paraxial focus behind the image plane, negative in front.
    radius : torch.Tensor
        Root mean square distance of its power in the image plane from the centroid, ``[fields]``.
    x : torch.Tensor
        Points of its rays in the image plane, ``[fields, rays]``.
    y : torch.Tensor
        The same along y.
    share : torch.Tensor
        Fraction of the light that each ray brings, ``[fields, rays]``; 0 for rays that are lost.
    further : tuple of int
        Surfaces of further reflections, as of :func:`ghost_system`.

    Examples
    --------
    >>> from odak.learn.raytracing.system import ghosts, load_system
    >>> brightest = ghosts(load_system("singlet"), samples=5).paths[0]
    >>> brightest.first, brightest.second
    (0, 1)
    """

    first: int
    second: int
    power: torch.Tensor
    focus: torch.Tensor
    radius: torch.Tensor
    x: torch.Tensor
    y: torch.Tensor
    share: torch.Tensor
    further: tuple[int, ...] = ()


class Ghosts(NamedTuple):
    """The ghosts of a system.

    Attributes
    ----------
    paths : tuple of Ghost
        The brightest first.
    direct : torch.Tensor
        Fraction of the light through the entrance pupil that makes the image, ``[fields]``.

    Examples
    --------
    Two uncoated surfaces of reflectance R send R²(1 − R)² of the light to their ghost:

    >>> from odak.learn.raytracing.system import ghosts, optical_system, surface
    >>> lens = optical_system([surface(60.0, thickness=4.0, material=1.5), surface(-60.0, thickness=58.0)], 1.0)
    >>> found = ghosts(lens, samples=5)
    >>> round(float(found.paths[0].power / (0.04**2 * 0.96**2)), 4)
    1.0
    """

    paths: tuple[Ghost, ...]
    direct: torch.Tensor

    @property
    def ratio(self) -> torch.Tensor:
        """Power of all ghosts relative to the power of the image, both in the whole image plane, ``[fields]``."""
        return sum((ghost.power for ghost in self.paths), torch.zeros_like(self.direct)) / self.direct

    def irradiance(
        self, size: float | Sequence[float], pixels: Sequence[int] = (64, 64), field: int = 0
    ) -> torch.Tensor:
        """Return the power of all ghosts on each unit of area of the image, ``[rows, columns]``, y and x ascending.

        Parameters
        ----------
        size : float or pair of float
            Sides along x and y of the map, which is centred on the axis.
        pixels : pair of int
            Number of rows and columns.
        field : int
            Number of the field point.

        Notes
        -----
        The light through the entrance pupil has a power of 1. Take more `samples` than pixels across a ghost.
        """
        field = _validate.place_in("field", field, len(self.direct))
        none = self.direct.new_zeros(0)
        parts = [(none, none, none), *((ghost.x[field], ghost.y[field], ghost.share[field]) for ghost in self.paths)]
        x, y, share = map(torch.cat, zip(*parts, strict=True))
        return irradiance_of(x, y, share, size, pixels)


@_validate.takes_units()
def ghosts(
    system: optical_system,
    samples: int = 15,
    *,
    fields: FieldPoints | None = None,
    wavelength: float | None = None,
    least: float = 1e-9,
    polarization: Sequence[complex] | None = None,
    reflections: int = 2,
) -> Ghosts:
    """Return all ghosts of two reflections in a system, or of more, with their power and place.

    Parameters
    ----------
    system : optical_system
        The system, of refracting surfaces without coordinate breaks, phases and gradients. Surfaces without a coating
        are bare. Apertures and semi-diameters that it states block rays; others do not.
    samples : int, default: 15
        Rays across the pupil.
    fields : sequence of pairs or torch.Tensor, optional
        Field points (x, y), or ``[F, 2]``, in place of the system's.
    wavelength : float, optional
        In the system's unit; by default its reference wavelength.
    least : float, default: 1e-9
        Ghosts whose ray through the middle of the pupil brings less than this fraction of the light, on the first
        field, are left out.
    polarization : sequence of two numbers, optional
        Jones vector of the light along x and y in front of the system; unpolarised by default.
    reflections : int, default: 2
        Largest number of reflections, even.

    Returns
    -------
    Ghosts
        The brightest first.

    Raises
    ------
    ValueError
        If the system cannot be traced backwards, or the number of reflections is odd.

    Notes
    -----
    Of n surfaces there are n(n − 1)/2 ghosts of two reflections; each is the sequence of :func:`ghost_system`, traced
    by :func:`polarized_trace`. Ghosts of four reflections are weaker by a reflectance squared, but not in folded
    (pancake) systems, whose image itself is one of two reflections. Light that is reflected by the image plane itself,
    by a sensor, is not among them.

    Examples
    --------
    >>> from odak.learn.raytracing.system import ghosts, load_system
    >>> found = ghosts(load_system("cooke_triplet"), samples=5, fields=[0.0])
    >>> len(found.paths)
    15
    """
    checked_system(system)
    samples = _validate.integer("samples", samples, minimum=2)
    reflections = _validate.integer("reflections", reflections, minimum=2)
    least = _validate.constant("least", least, least=0)
    if wavelength is None:
        wavelength = system.wavelengths[system.reference]
    wavelength = _validate.constant("wavelength", wavelength, positive=True)
    state = None if polarization is None else jones_vector(polarization)
    if reflections % 2:
        raise ValueError(f"reflections must be an even number, got {reflections}")
    # Wave plates, and surfaces between equal media without a film, reflect nothing.
    films = [item.coating for item in system.surfaces]
    actions = layout_of(system.surfaces, system.prescription([wavelength]), system.image).actions
    mirrors = [
        i
        for i, (film, action) in enumerate(zip(films, actions, strict=False))
        if (film.reflects if isinstance(film, PolarizingFilm) else film is not None or action != "pass")
    ]
    found = []
    ways: list[tuple[int, ...]] = [()]
    for step in range(reflections):
        # Forwards light meets the surfaces behind the last one that reflected it, backwards those in front of it.
        ways = [(*way, i) for way in ways for i in mirrors if not way or (i < way[-1] if step % 2 else i > way[-1])]
        found += [_ghost(system, way, samples, fields, wavelength, (least, state)) for way in ways if step % 2]
    numbers = system.prescription([wavelength])
    rays = launch(system, "grid", samples, fields=fields, prescription=numbers)
    direct = polarized_trace(system, rays, prescription=numbers).throughput(state)[0].mean(-1)
    kept = [ghost for ghost in found if ghost is not None]
    return Ghosts(tuple(sorted(kept, key=lambda ghost: -float(ghost.power.mean()))), direct)


def _ghost(system, places: tuple[int, ...], samples: int, fields, wavelength: float, options) -> Ghost | None:
    """Return a ghost of surfaces in the order of its reflections; None if there is next to nothing to see."""
    (second, first, *further), (least, state) = places, options
    device = system.surfaces[0].thickness.device
    way = ghost_system(system, first, second, *further).to(device)
    numbers = way.prescription([wavelength])
    # One ray tells whether there is anything to see.
    middle = launch(way, torch.zeros(1, 2, dtype=torch.float64, device=device), fields=fields, prescription=numbers)
    if float(polarized_trace(way, middle, prescription=numbers).throughput(state).flatten()[0]) <= least:
        return None
    traced = polarized_trace(
        way, launch(way, "grid", samples, fields=fields, prescription=numbers), prescription=numbers
    )
    share = traced.throughput(state)[0]
    arrived = traced.traced.arrived[0]
    x, y = (torch.where(arrived, value[0], 0.0) for value in (traced.traced.x, traced.traced.y))
    share = share / share.shape[-1]
    power = share.sum(-1)
    weight = share / torch.where(power > 0, power, 1.0)[:, None]
    squared = sum((weight * (v - (weight * v).sum(-1, keepdim=True)) ** 2).sum(-1) for v in (x, y))
    focus = first_order(way, prescription=numbers).image_distance - way.surfaces[-1].thickness
    return Ghost(first, second, power, focus, torch.as_tensor(squared).sqrt(), x, y, share, tuple(further))


def jones_vector(values: Any) -> tuple[complex, complex]:
    """Return a Jones vector as two complex numbers."""
    try:
        found = torch.as_tensor(values, dtype=torch.complex128).reshape(-1).tolist()
    except (TypeError, ValueError) as error:
        raise TypeError(f"polarization must be two numbers, got {values!r:.80}") from error
    if len(found) != 2 or not 0 < abs(found[0]) + abs(found[1]) < math.inf:
        raise ValueError(f"polarization must be two finite numbers, not both 0, got {values!r}")
    return found[0], found[1]


def polarized_point_spread_function(
    system: optical_system,
    polarization: Sequence[complex] | torch.Tensor | None = None,
    samples: int | None = None,
    size: int | None = None,
    *,
    fields: FieldPoints | None = None,
    aim: str = "paraxial",
    vignetting: bool = True,
    prescription: Prescription | None = None,
) -> Spread:
    """Return the image of a point in polarised light, by Fourier transforms of the three components of the field.

    Parameters
    ----------
    system : optical_system
        The system.
    polarization : sequence of two numbers, optional
        Jones vector of the light along x and y in front of the system, complex perhaps; unpolarised by default.
    samples : int, optional
        Samples across the pupil; the first of 64, 128 and 256 that resolves the wavefront by default.
    size : int, optional
        Pixels along each side of the image, at least `samples` and four times as many by default.
    fields : sequence of pairs or torch.Tensor, optional
        Field points (x, y), or ``[F, 2]``, in place of the system's.
    aim : str, default: "paraxial"
        "paraxial" or "real", how :func:`launch` aims.
    vignetting : bool, default: True
        Let apertures block rays.
    prescription : Prescription, optional
        Numbers in place of the system's own.

    Returns
    -------
    Spread
        Its unit is the peak of the same pupil without aberrations, losses and polarisation, so that the sum tells the
        losses too. Differentiable.

    Notes
    -----
    Each ray carries the field P·E; images of the components along x, y and z add up as intensities (Richards and Wolf,
    Proc. R. Soc. Lond. A 253, 358 (1959), for the vector nature of the focus).

    Examples
    --------
    >>> from odak.learn.raytracing.system import load_system, polarized_point_spread_function
    >>> image = polarized_point_spread_function(load_system("cooke_triplet"), (1.0, 0.0), 48, 64)
    >>> tuple(image.intensity.shape)
    (3, 3, 64, 64)
    """
    (polarization,) = _validate.constants(polarization=polarization)
    states = [(1.0, 0.0), (0.0, 1.0)] if polarization is None else [jones_vector(polarization)]
    options = {"prescription": prescription, "fields": fields, "aim": aim}

    def amplitudes(points):
        rays = launch(system, points, **options)
        found = polarized_trace(system, rays, prescription=prescription, vignetting=vignetting)
        axes = transverse_axes(found.incoming).to(found.matrix.dtype)
        scale = torch.where(found.traced.arrived, found.absorption, 0.0).sqrt()[..., None]
        parts = []
        for state in states:
            given = torch.tensor(state, dtype=found.matrix.dtype, device=axes.device)
            given = given / (given.abs().square().sum().sqrt() * math.sqrt(len(states)))
            field = (found.matrix @ (axes @ given)[..., None])[..., 0] * scale
            parts += list(torch.where(found.traced.arrived[..., None], field, 0.0).unbind(-1))
        return parts

    return pupil_image(system, chosen_samples(samples), size, {**options, "vignetting": vignetting}, amplitudes)
