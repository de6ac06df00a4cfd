"""Diffraction images and modulation transfer as Huygens' sum over the rays that leave a system, and illumination."""

import math
from typing import Any

import numpy as np
import torch

from odak import _validate
from odak._array import phasor_of_cycles
from odak._torch_private import load_forward_rules
from odak.learn.raytracing.system.analysis import path_at_start
from odak.learn.raytracing.system.paraxial import check_image_space, first_order
from odak.learn.raytracing.system.pupils import launch
from odak.learn.raytracing.system.surfaces import Prescription, checked_prescription, checked_system, wavelengths_of
from odak.learn.raytracing.system.tracing import trace
from odak.learn.raytracing.system.waves import Spread


def huygens_point_spread_function(
    system: Any,
    samples: int = 64,
    size: int = 128,
    pitch: float | None = None,
    *,
    prescription: Prescription | None = None,
    fields: Any = None,
    aim: str = "paraxial",
    vignetting: bool = True,
) -> Spread:
    """Return the image of a point with diffraction as the sum of the plane waves of all rays.

    Parameters
    ----------
    system : optical_system
        The system.
    samples : int
        Rays across the pupil.
    size : int
        Pixels along each side of the image.
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
    Every ray is a plane wave of its direction, phase and equal amplitude, scalar; no reference sphere, no transform and
    no sine condition enter. The rays are a regular grid in the pupil: the sum repeats itself at a distance of
    `samples` times the wavelength over the image's full angle, within which the image must fit.

    Examples
    --------
    >>> from odak.learn.raytracing.system import huygens_point_spread_function, load_system
    >>> tuple(huygens_point_spread_function(load_system("cooke_triplet"), 16, 32).intensity.shape)
    (3, 3, 32, 32)
    """
    checked_system(system), checked_prescription(prescription)
    if system.afocal:
        raise ValueError(
            "system is afocal: the sum of plane waves holds for pupils far from the image in Fresnel zones; use "
            "point_spread_function"
        )
    samples = _validate.integer("samples", samples, minimum=8)
    size = _validate.integer("size", size, minimum=2)
    step = 2 / samples
    line = (torch.arange(samples, dtype=torch.float64) - (samples - 1) / 2) * step
    y, x = torch.meshgrid(line, line, indexing="ij")
    # Cells on the rim count by the share of them that lies inside.
    share = ((1 - (x * x + y * y).sqrt()) / step + 0.5).clamp(0, 1)
    inside = share > 0
    points = torch.cat([torch.zeros(1, 2, dtype=torch.float64), torch.stack([x[inside], y[inside]], -1)])
    rays = launch(system, points, prescription=prescription, fields=fields, aim=aim)
    found = trace(system, rays, prescription=prescription, vignetting=vignetting)
    centre = trace(system, rays, prescription=prescription, vignetting=False) if vignetting else found
    numbers = system.prescription() if prescription is None else prescription
    check_image_space(system, numbers)
    kept = found.arrived[..., 1:]
    weight = torch.where(kept, share[inside].to(found.x), 0.0)
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
        spacing = waves[..., 0] / (4 * aperture[..., None, None])
    else:
        spacing = torch.full_like(waves[..., 0], _validate.constant("pitch", pitch, positive=True))
    spacing = spacing.expand(*path.shape[:-1])
    place = (torch.arange(size, dtype=torch.float64, device=path.device) - size // 2) * spacing[..., None]
    cycles = (ways[0] / waves)[..., None] * place[..., None, :], (ways[1] / waves)[..., None] * place[..., None, :]
    along_x, along_y = (phasor_of_cycles(value, torch.complex128) for value in cycles)
    amplitude = phasor_of_cycles(torch.where(kept, path, 0.0) / waves, torch.complex128) * weight
    field = (along_y * amplitude[..., None]).mT @ along_x
    total = share.sum().to(path)
    intensity = (field.real.square() + field.imag.square()) / total.square()
    return Spread(intensity, torch.stack([spacing, spacing], -1), intensity.amax((-2, -1)))


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
        ``[..., W, F]``. All frequencies that the image resolves are those of :func:`modulation_transfer_function`.

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
    if not isinstance(spread, Spread):
        raise TypeError(f"spread must be a Spread, got {type(spread).__name__}")
    axis = _validate.one_of("axis", axis, ("x", "y"))
    frequency = _validate.constant("frequency", frequency, least=0)
    profile = spread.intensity.sum(-1 if axis == "y" else -2)
    count = profile.shape[-1]
    place = torch.arange(count, dtype=torch.float64, device=profile.device) - count // 2
    cycles = place * spread.pitch[..., 0 if axis == "y" else 1, None] * frequency
    wave = phasor_of_cycles(cycles, torch.complex128)
    real, imaginary = ((profile * part).sum(-1) for part in (wave.real, wave.imag))
    return (real.square() + imaginary.square()).clamp_min(1e-300).sqrt() / profile.sum(-1)


def through_focus_modulation(
    system: Any, shifts: Any, frequency: float, axis: str = "y", samples: int = 32, **options: Any
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
    samples : int
        Rays across the pupil.
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
    samples = _validate.integer("samples", samples, minimum=8)
    if "prescription" in options:
        raise ValueError("prescription must be left out: the planes are a batch of prescriptions of the system")
    numbers = system.prescription()
    moved = torch.zeros(len(shifts), numbers.thickness.shape[-1], dtype=torch.float64, device=numbers.thickness.device)
    moved[:, -1] = shifts.to(moved)
    # The image is sampled as finely as the frequency and the limit of diffraction require, and holds the blur.
    spread = huygens_point_spread_function(
        system, samples, 2 * samples, prescription=numbers._replace(thickness=numbers.thickness + moved), **options
    )
    return modulation_at(spread, frequency, axis).movedim(0, -1)


def relative_illumination(
    system: Any, count: int = 24, *, prescription: Prescription | None = None, **options: Any
) -> torch.Tensor:
    """Return the illuminance of the image of a uniform Lambertian object, over that on the axis.

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
    radius and in equal steps around, each ray's Jacobian being exact.

    Examples
    --------
    >>> from odak.learn.raytracing.system import load_system, relative_illumination
    >>> relative_illumination(load_system("cooke_triplet"))[1].shape
    torch.Size([3])
    """
    checked_system(system), checked_prescription(prescription)
    count = _validate.integer("count", count, minimum=2)
    nodes, weights = np.polynomial.legendre.leggauss(count)
    radius = torch.as_tensor((nodes + 1) / 2).sqrt()
    angle = torch.arange(4 * count, dtype=torch.float64) * (2 * math.pi / (4 * count))
    points = torch.stack([radius[:, None] * angle.sin(), radius[:, None] * angle.cos()], -1).reshape(-1, 2)
    weight = torch.as_tensor(weights).repeat_interleave(4 * count)
    own = {name: options.pop(name) for name in ("fields", "aim") if name in options}

    load_forward_rules()

    def covered(fields):
        def directions(place):
            rays = launch(system, place, prescription=prescription, aim=own.get("aim", "paraxial"), fields=fields)
            found = trace(system, rays, prescription=prescription, **options)
            return (found.u, found.v), found.arrived

        changes, kept = [], None
        for axis in (0, 1):
            way = torch.zeros_like(points)
            way[:, axis] = 1.0
            _, change, kept = torch.func.jvp(directions, (points,), (way,), has_aux=True)
            changes.append(change)
        (ux, vx), (uy, vy) = changes
        area = torch.where(kept, ux * vy - uy * vx, 0.0).abs()
        return (area * weight).sum(-1)

    return covered(own.get("fields")) / covered([(0.0, 0.0)])
