"""Optical path differences on the reference sphere of the exit pupil, and their Zernike polynomials."""

from typing import Any, NamedTuple

import torch

from odak import _validate
from odak.learn.raytracing.system.launching import launch, pupil_of
from odak.learn.raytracing.system.paraxial import first_order
from odak.learn.raytracing.system.prescription import Prescription
from odak.learn.raytracing.system.tracing import trace
from odak.tools.zernike import noll_to_nm, zernike_norm, zernike_polynomial

CENTRE = torch.zeros(1, 2, dtype=torch.float64)
FAR = 1e8


class Wavefront(NamedTuple):
    """Path differences of a bundle of rays.

    Attributes
    ----------
    path : torch.Tensor
        Optical path to the reference sphere less that of the chief ray, in wavelengths, ``[..., W, F, P]``; NaN where
        a ray is lost. Positive where the wave lags.
    rms : torch.Tensor
        Its standard deviation over the rays, ``[..., W, F]``.
    pupil : torch.Tensor
        Pupil coordinates, ``[P, 2]``.
    cosines : torch.Tensor
        Direction cosines u, v of the rays in image space less those of the chief ray, ``[..., W, F, P, 2]``.
    status : torch.Tensor
        As in Traced.
    """

    path: torch.Tensor
    rms: torch.Tensor
    pupil: torch.Tensor
    cosines: torch.Tensor
    status: torch.Tensor


def wavefront(
    system: Any,
    pupil: Any = "rings",
    count: int = 12,
    *,
    prescription: Prescription | None = None,
    fields: Any = None,
    aim: str = "paraxial",
    vignetting: bool = True,
) -> Wavefront:
    """Return the wavefront in the exit pupil, against the sphere about the chief ray's image point.

    Parameters
    ----------
    system, pupil, count, prescription, fields, aim
        As in :func:`launch`.
    vignetting : bool
        Let semi-diameters block rays.

    Returns
    -------
    Wavefront
        float64, differentiable.

    Notes
    -----
    The sphere of each wavelength and field has its centre where the chief ray of that wavelength meets the image
    surface, and passes through the paraxial exit pupil's centre, which may be at infinity. Welford, Aberrations of
    Optical Systems (1986), section 7.2.
    """
    vignetting = _validate.flag("vignetting", vignetting)
    points = pupil_of(pupil, count, system)
    options = {"prescription": prescription, "fields": fields, "aim": aim}
    rays = launch(system, torch.cat([CENTRE.to(points), points]), **options)
    traced = trace(system, rays, prescription=prescription, vignetting=vignetting)
    if vignetting:
        # The chief ray is the reference even where the centre of the pupil is blocked.
        alone = trace(system, launch(system, CENTRE.to(points), **options), prescription=prescription, vignetting=False)
        traced = type(traced)(*(torch.cat([a, b[..., 1:]], -1) for a, b in zip(alone, traced, strict=True)))
    status = traced.status[..., 1:]
    kept = status == 0
    # Lost rays stand where the chief ray is, so that nothing that is no number enters a gradient.
    lost = torch.cat([torch.zeros_like(kept[..., :1]), ~kept], -1)
    held = [torch.where(lost, value[..., :1].detach(), value) for value in traced[:-1]]
    traced = type(traced)._make([*held, traced.status])
    numbers = system.prescription() if prescription is None else prescription
    index = numbers.index[..., -1][..., None, None]
    total = path_at_start(system, rays, numbers) + traced.path + index * _to_sphere(system, traced, prescription)
    lag = total[..., 1:] - total[..., :1]
    waves = torch.tensor(system.wavelengths, dtype=torch.float64, device=lag.device)[: lag.shape[-3]]
    lag = torch.where(kept, lag, 0.0) / waves[:, None, None]
    number = kept.sum(-1)
    mean = lag.sum(-1) / number.clamp_min(1)
    spread = torch.where(kept, lag - mean[..., None], 0.0).square().sum(-1) / number.clamp_min(1)
    rms = torch.where(spread > 0, torch.where(spread > 0, spread, 1.0).sqrt(), 0 * spread)
    rms = torch.where(number > 0, rms, torch.nan)
    cosines = torch.stack([value[..., 1:] - value[..., :1] for value in (traced.u, traced.v)], -1)
    cosines = torch.where(kept[..., None], cosines, torch.nan)
    return Wavefront(torch.where(kept, lag, torch.nan), rms, points, cosines, status)


def path_at_start(system, rays, numbers: Prescription):
    """Return the path that rays have behind them where they start: they left a plane wavefront, or one point."""
    if not system.at_infinity:
        return 0.0
    return numbers.index[..., :1][..., None] * (rays.x * rays.u + rays.y * rays.v)


def _to_sphere(system, traced, prescription):
    """Return the distance from the image surface back along each ray to the sphere, less the sphere's radius."""
    properties = first_order(system, prescription=prescription)
    last = (system.surfaces[-1].thickness if prescription is None else prescription.thickness[..., -1]).double()
    center = [value[..., :1] for value in traced[:3]]
    gap = (last - properties.exit_pupil_distance)[..., None, None, None]
    gap = gap.clamp(-FAR, FAR) + center[2]
    side = torch.sign(gap * traced.w[..., :1]).detach()
    radius = (center[0].square() + center[1].square() + gap * gap).sqrt()
    away = [value - middle for value, middle in zip(traced[:3], center, strict=True)]
    along = sum(cosine * value for cosine, value in zip(traced[3:6], away, strict=True))
    rest = along * along - sum(value * value for value in away)
    # s + R with s = −b ∓ √(b² − q + R²), written so that the large radius does not swallow the difference.
    return -along - side * rest / ((rest + radius * radius).sqrt() + radius)


def zernike_fit(found: Wavefront, terms: int = 15) -> tuple[torch.Tensor, torch.Tensor]:
    """Return the Zernike polynomials of a wavefront, by least squares over its rays.

    Parameters
    ----------
    found : Wavefront
        From :func:`wavefront`.
    terms : int
        Number of polynomials, in Noll's order from j = 1 (piston).

    Returns
    -------
    tuple of torch.Tensor
        Coefficients ``[..., W, F, terms]`` in wavelengths, each polynomial having a root mean square of 1 over the
        disc, and the root mean square of what they leave, ``[..., W, F]``.

    Raises
    ------
    ValueError
        If there are fewer rays than polynomials.
    """
    if not isinstance(found, Wavefront):
        raise TypeError(f"found must be a Wavefront, got {type(found).__name__}")
    terms = _validate.integer("terms", terms, minimum=1)
    radius, angle = found.pupil.square().sum(-1).sqrt(), torch.atan2(found.pupil[:, 1], found.pupil[:, 0])
    radius = radius.clamp(max=1.0)
    if len(radius) < terms:
        raise ValueError(f"terms must be at most the number of rays, {len(radius)}, got {terms}")
    modes = [noll_to_nm(j) for j in range(1, terms + 1)]
    basis = torch.stack([zernike_norm(*mode) * zernike_polynomial(*mode, radius, angle) for mode in modes], -1)
    kept = (found.status == 0)[..., None]
    weighted = torch.where(kept, basis, 0.0)
    values = torch.where(kept, found.path[..., None], 0.0)
    coefficients = torch.linalg.lstsq(weighted, values).solution
    left = torch.where(kept, weighted @ coefficients - values, 0.0).square().sum((-2, -1)) / kept.sum((-2, -1))
    return coefficients[..., 0], torch.where(left > 0, torch.where(left > 0, left, 1.0).sqrt(), 0.0)
