"""Rays to waves: the field that a system leaves on a regular grid, ready to be propagated on."""

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import torch

from odak import _validate
from odak._array import phasor_of_cycles
from odak.learn.raytracing.system.launching import AIMS
from odak.learn.raytracing.system.lens import checked_system
from odak.learn.raytracing.system.paraxial import first_order
from odak.learn.raytracing.system.prescription import Prescription, checked_prescription
from odak.learn.raytracing.system.ray_map import RayMap
from odak.raytracing.geometry import safe_sqrt
from odak.raytracing.status import RayStatus

PLANES = ("axis", "chief")
# How much wider than the light the grid is.
ROOM = 1.1
# Samples at a time: some ten rays each.
PIECE = 1 << 18


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
    """

    field: torch.Tensor
    pitch: float
    wavelength: float
    to_image: torch.Tensor
    status: torch.Tensor


def exit_field(
    system: Any,
    size: int | Sequence[int] = 512,
    pitch: float | None = None,
    *,
    distance: float | None = None,
    plane: str = "axis",
    field: int = 0,
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
        the pupil is virtual, so is the field: that of the medium behind the system, continued.
    plane : str
        "axis": perpendicular to the axis. "chief": perpendicular to the chief ray, for fields off the axis, whose phase
        otherwise asks for a much smaller pitch.
    field, wavelength : int
        Which of the system's; the first field and the reference wavelength by default.
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
        If the exit pupil is at infinity and no distance is given, if the pitch cannot hold the phase, if the light does
        not fit on the grid, or if rays cross in the plane.

    Notes
    -----
    For each sample the ray that meets it is found by Newton's method. The amplitude is that of a tube of rays, which
    keeps the power: with q the place in the plane and p that in the pupil, |U|² = |A(p)|²/(|∂q/∂p|·cos θ) (Born and
    Wolf, Principles of Optics, 1999, section 3.1.2). Geometric optics knows no diffraction before the plane. Therefore
    the plane belongs into the exit pupil, whose rim cuts the wave; close to the focus, fringes of that rim are missing.

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
    point = torch.tensor(
        system.fields[_place("field", field, len(system.fields), 0)],
        dtype=torch.float64,
        device=system.surfaces[0].thickness.device,
    )
    distance = _exit_pupil(system, prescription) if distance is None else _validate.number("distance", distance)
    rays = RayMap(system, prescription, place, point, distance, plane == "chief")
    vacuum, index = system.wavelengths[place], rays.numbers.index[..., 0, -1].detach()
    grid = _grid(rays, aim, (rows, columns), pitch, vacuum / float(index.abs().max()))
    pieces = zip(grid.chosen.split(PIECE), grid.guess.split(PIECE, -2), strict=True)
    parts = [_light(rays, grid, *piece, aim, vignetting, apodization) for piece in pieces]
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
    """Samples that light may reach: their numbers ``[P]``, places ``[P, 2]`` and guessed pupil places ``[..., P, 2]``.

    `sign` is that of the map's Jacobian, ``[..., 1]``.
    """

    pitch: float
    chosen: torch.Tensor
    target: torch.Tensor
    guess: torch.Tensor
    sign: torch.Tensor


def _place(name: str, value: int | None, count: int, default: int) -> int:
    value = default if value is None else value
    if isinstance(value, bool) or not isinstance(value, int) or not -count <= value < count:
        raise ValueError(f"{name} must be the number of one of the system's {count}, got {value!r}")
    return value % count


def _exit_pupil(system, prescription):
    """Return where the paraxial exit pupil stands."""
    found = first_order(system, prescription=prescription).exit_pupil_distance
    if not bool(torch.isfinite(found).all()) or float(found.detach().abs().max()) > 1e6 * _length(system):
        raise ValueError("distance must be given: the exit pupil is at infinity")
    return found


def _length(system) -> float:
    return sum(abs(float(item.thickness.detach())) for item in system.surfaces) or 1.0


@torch.no_grad()
def _grid(rays: RayMap, aim: str, shape, pitch, wavelength: float) -> _Grid:
    """Return the samples that light may reach, and about where in the pupil it starts."""
    places = rays.samples(aim)
    met = rays(places)
    lost = met.status != RayStatus.HIT
    if bool(lost.all()):
        raise ValueError("no ray of this field gets through the system")
    sign = _sign(rays, places)
    extent = [float(torch.where(lost, 0.0, value).abs().max()) for value in (met.y, met.x)]
    steep = max(float(torch.where(lost, 0.0, value).abs().max()) for value in (met.u, met.v))
    if pitch is None:
        pitch = max(2 * ROOM * size / count for size, count in zip(extent, shape, strict=True))
    pitch = float(_validate.number("pitch", pitch, positive=True))
    if pitch * steep > wavelength / 2:
        most = wavelength / 2 / steep
        count = math.ceil(2 * ROOM * max(extent) / most)
        raise ValueError(
            f"pitch must be at most {most:.4g} for the phase of these rays, got {pitch:.4g}: take a size of {count} or "
            "more, a plane nearer to the focus (distance), or one perpendicular to the chief ray (plane)"
        )
    if any(size > pitch * ((count - 1) // 2) for size, count in zip(extent, shape, strict=True)):
        least = max(size / max((count - 1) // 2, 0.5) for size, count in zip(extent, shape, strict=True))
        raise ValueError(f"pitch must be at least {least:.4g} for the light to fit into {shape}, got {pitch:.4g}")
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
    """Return the sign of the map's Jacobian, ``[..., 1]``; raise if rays cross: then a place has several of them."""
    (xa, ya), (xb, yb), _ = rays.slopes(places)
    signs = torch.sign(xa * yb - xb * ya).nan_to_num()
    if bool(((signs > 0).any(-1) & (signs < 0).any(-1)).any()):
        raise ValueError("distance must put the plane where rays do not cross: this one is within their caustic")
    return signs.sum(-1, keepdim=True)


def _light(rays: RayMap, grid: _Grid, chosen, guess, aim: str, vignetting: bool, apodization):
    """Return amplitude, optical path and status of some samples, ``[..., P]``."""
    target = grid.target[chosen]
    places = rays.solve(target, guess)
    met = rays(places, vignetting)
    share, area = _tube(rays, places, target, aim, grid)
    kept = (met.status == RayStatus.HIT) & (share > 0)
    amplitude = share if apodization is None else share * apodization(places)
    scale = torch.where(kept, math.pi * area * torch.where(kept, met.cosine, 1.0).abs(), 1.0).sqrt()
    status = torch.where(share > 0, met.status, RayStatus.MISS.value).to(torch.int8)
    return torch.where(kept, amplitude, 0.0) / scale, torch.where(kept, met.path, 0.0), status


def _tube(rays: RayMap, places: torch.Tensor, target: torch.Tensor, aim: str, grid: _Grid):
    """Return the share of each sample that lies inside the pupil, and the area of the plane per area of the pupil."""
    (xa, ya), (xb, yb), middle = rays.slopes(places)
    # No tube without the ray itself and its neighbours; a dummy keeps NaN out of the gradients.
    near = (torch.stack(middle, -1).detach() - target).abs().amax(-1) < 1e-3 * grid.pitch
    whole = near & torch.isfinite(xa + ya + xb + yb)
    xa, yb, ya, xb = (torch.where(whole, v, d) for v, d in ((xa, 1.0), (yb, 1.0), (ya, 0.0), (xb, 0.0)))
    area = xa * yb - xb * ya
    radius, ra, rb = rays.radius(places, aim)
    # How fast that radius grows across the plane: its derivatives by the pupil's coordinates, turned by the map.
    growth = safe_sqrt((ra * yb - rb * ya).square() + (rb * xa - ra * xb).square())
    growth = growth / torch.where(area == 0, 1.0, area).abs()
    share = ((1 - radius) / (growth * grid.pitch).clamp(min=1e-12) + 0.5).clamp(0, 1)
    # Beyond the rim the map may fold over; what lies there is no light of this pupil.
    return torch.where(whole & (area * grid.sign > 0), share, 0.0), area.abs()
