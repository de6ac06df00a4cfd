"""Point spread and modulation transfer: rays to waves in the pupil, waves to light in the image."""

import math
from typing import Any, NamedTuple

import torch

from odak import _validate
from odak._array import is_readable, phasor_of_cycles
from odak.learn._tensors import floating
from odak.learn.raytracing.system.wavefronts import wavefront
from odak.log import logger


class Spread(NamedTuple):
    """A diffraction image of a point.

    Attributes
    ----------
    intensity : torch.Tensor
        ``[..., W, F, rows, columns]``, 1 at the peak of the same pupil without aberrations; sample n // 2 of each axis
        is the chief ray's point. Rows are y, columns x.
    pitch : torch.Tensor
        Pixel pitches (y, x) in the system's unit, ``[..., W, F, 2]``.
    strehl : torch.Tensor
        Largest value of the intensity, ``[..., W, F]``.
    """

    intensity: torch.Tensor
    pitch: torch.Tensor
    strehl: torch.Tensor


def point_spread_function(system: Any, samples: int = 64, size: int = 256, **options: Any) -> Spread:
    """Return the image of a point with diffraction, by a Fourier transform of the exit pupil.

    Parameters
    ----------
    system : optical_system
        The system.
    samples : int
        Samples across the pupil.
    size : int
        Pixels along each side of the image, at least `samples`; the more, the finer they are. The modulation transfer
        needs twice `samples`, and a Strehl ratio to a hundredth eight times: the peak may lie between pixels.
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
    that is left out and, where it is more than a fiftieth, logged; :func:`propagated_point_spread_function` has it. The
    number of samples must resolve the phase: less than half a wave from one to the next.
    """
    samples = _validate.integer("samples", samples, minimum=8)
    size = _validate.integer("size", size, minimum=samples)
    step = 2 / samples
    line = (torch.arange(samples, dtype=torch.float64) - samples // 2) * step
    y, x = torch.meshgrid(line, line, indexing="ij")
    radius = (x * x + y * y).sqrt()
    # Pixels on the rim count by the share of them that lies inside.
    share = ((1 - radius) / step + 0.5).clamp(0, 1)
    inside = share > 0
    found = wavefront(system, torch.stack([x[inside], y[inside]], -1), **options)
    weight = torch.where(found.status == 0, share[inside].to(found.path.device), 0.0)
    phase = phasor_of_cycles(torch.where(found.status == 0, found.path, 0.0), torch.complex128) * weight
    pupil = torch.zeros(*phase.shape[:-1], samples, samples, dtype=phase.dtype, device=phase.device)
    pupil[..., inside.to(phase.device)] = phase
    before = size // 2 - samples // 2
    after = size - samples - before
    field = torch.nn.functional.pad(pupil, (before, after, before, after))
    field = torch.fft.fftshift(torch.fft.fft2(torch.fft.ifftshift(field, dim=(-2, -1))), dim=(-2, -1))
    intensity = field.abs().square() / weight.sum(-1).square()[..., None, None]
    slopes = _slopes(found, weight)
    waves = torch.tensor(system.wavelengths, dtype=torch.float64, device=phase.device)[: phase.shape[-3]]
    given = options.get("prescription")
    index = (system.prescription() if given is None else given).index[..., -1].abs()
    pitch = (waves / index)[..., None, None] / (size * step * slopes)
    return Spread(intensity, pitch, intensity.amax((-2, -1)))


def _slopes(found, weight):
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
        logger.warning("fields off both axes: what is along y moves with x in the pupil, which this image leaves out")
    return straight


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
    The modulus of the Fourier transform of the point spread function (Goodman 2005, section 6.3).
    """
    if not isinstance(spread, Spread):
        raise TypeError(f"spread must be a Spread, got {type(spread).__name__}")
    axis = _validate.one_of("axis", axis, ("x", "y"))
    profile = spread.intensity.sum(-1 if axis == "y" else -2)
    size = profile.shape[-1]
    transfer = torch.fft.rfft(profile).abs()
    pitch = spread.pitch[..., 0 if axis == "y" else 1]
    frequencies = torch.fft.rfftfreq(size, dtype=torch.float64, device=pitch.device) / pitch[..., None]
    return frequencies, transfer / transfer[..., :1]


def airy_pattern(radius: torch.Tensor, wavelength: float, numerical_aperture: float) -> Any:
    """Return the diffraction image (2J₁(v)/v)² of a point, v = 2π·NA·r/λ.

    Parameters
    ----------
    radius : torch.Tensor
        Distances from the centre.
    wavelength, numerical_aperture : float
        In the unit of `radius`; of the image side.

    Raises
    ------
    ValueError, TypeError
        If the wavelength or the aperture is not positive.

    Notes
    -----
    Airy, Trans. Camb. Phil. Soc. 5, 283 (1835); Born and Wolf, Principles of Optics (1999), section 8.5.2.
    """
    radius = floating("radius", radius)
    _validate.number("wavelength", wavelength, positive=True)
    _validate.number("numerical_aperture", numerical_aperture, positive=True)
    # Torch has no Bessel functions in half precision.
    wide = radius if radius.dtype in (torch.float32, torch.float64) else radius.float()
    v = wide * (2 * math.pi * numerical_aperture / wavelength)
    centre = v.abs() < 1e-8
    safe = torch.where(centre, 1.0, v)
    return torch.where(centre, 1.0, (2 * torch.special.bessel_j1(safe) / safe).square()).to(radius.dtype)


def propagated_point_spread_function(
    system: Any,
    size: int = 512,
    pitch: float | None = None,
    propagation_type: str = "Bandlimited Angular Spectrum",
    **options: Any,
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
    propagation_type : str
        As in :func:`odak.learn.wave.propagate_beam`.
    **options
        Of :func:`exit_field` (`field`, `wavelength`, `distance`, `aim`, `vignetting`, `apodization`, `prescription`).

    Returns
    -------
    Spread
        Of one field and one wavelength, ``[..., 1, 1, rows, columns]``, in the plane perpendicular to the chief ray
        through its image point. Differentiable.

    Notes
    -----
    Unlike :func:`point_spread_function` this takes neither Abbe's sine condition nor a small aperture for granted: the
    field has the amplitude and the phase of the rays where they are. It costs more: the pitch must hold the phase of
    the whole converging wave. The unit is the peak of a sphere of the same amplitude about the image point, by the
    Rayleigh–Sommerfeld integral (Goodman 2005, section 3.5).
    """
    from odak.learn.raytracing.system.waves import exit_field
    from odak.learn.wave.propagation import propagate_beam

    wave = exit_field(system, size, pitch, plane="chief", **options)
    count = wave.field.shape[-1]
    line = (torch.arange(count, dtype=torch.float64, device=wave.field.device) - count // 2) * wave.pitch
    distance = wave.to_image[..., None, None]
    squared = line[:, None] ** 2 + line**2 + distance * distance
    peak = (wave.field.abs() * distance.abs() / squared).sum((-2, -1)) * (wave.pitch**2 / wave.wavelength)
    image = propagate_beam(wave.field, None, wave.to_image, wave.pitch, wave.wavelength, propagation_type)
    intensity = (image.abs().square() / peak[..., None, None].square())[..., None, None, :, :]
    pitches = torch.full((*intensity.shape[:-2], 2), wave.pitch, dtype=torch.float64, device=intensity.device)
    return Spread(intensity, pitches, intensity.amax((-2, -1)))
