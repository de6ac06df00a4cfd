"""Pictures through a lens: a map of point spread functions, distortion, illumination, and the sensor with its noise."""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import torch

from odak import _show, _validate
from odak._array import Array, is_readable
from odak._torch_private import in_own_precision
from odak._warnings import AccuracyWarning, warn
from odak.learn._tensors import floating
from odak.learn.raytracing.system.analysis import CENTRE, paraxial_points
from odak.learn.raytracing.system.polarisation import polarized_trace
from odak.learn.raytracing.system.prescriptions import Prescription, checked_prescription
from odak.learn.raytracing.system.pupils import field_points, launch, pupil_factors, trace_fields
from odak.learn.raytracing.system.surfaces import checked_system, optical_system, wavelength_shares
from odak.learn.raytracing.system.tracing import trace
from odak.learn.raytracing.system.waves import more_samples, pupil_image

KINDS = ("rays", "waves")
PATTERNS = ("RGGB", "BGGR", "GRBG", "GBRG")
# Chief rays along each side of the sensor, and the degree of the polynomials through them.
LINE, DEGREE = 13, 7
# Share of the light of a point that its kernel should hold.
HELD = 0.9


@_show.shown
class PointSpreadMap(NamedTuple):
    """Point spread functions of a lens over a sensor; C counts channels, rows are along y and columns along x.

    Attributes
    ----------
    kernels : torch.Tensor
        Fractions of the power of a point in the pixels about its image, ``[C, rows, columns, K, K]``. The middle pixel,
        K // 2, lies on the chief ray of the reference wavelength. Each adds up to the illumination, less what falls
        beside the K × K pixels.
    illumination : torch.Tensor
        Irradiance of an even object relative to the axis, ``[C, rows, columns]``.
    ideal, real : torch.Tensor
        Points (x, y) of the grid, ``[rows, columns, 2]``, of paraxial chief rays, evenly spaced over the sensor, and
        of real ones.
    undistort : torch.Tensor
        Coefficients of the polynomials that give the ideal point of a real one, ``[2, terms]``.
    pitch : float
        Of the pixels.
    shape : tuple of int
        Rows and columns of the sensor.

    Examples
    --------
    >>> from odak.learn.raytracing.system import load_system, point_spread_map
    >>> found = point_spread_map(load_system("cooke_triplet"), (64, 96), 0.3, grid=(3, 3), count=4)
    >>> found.shape, found.pitch, tuple(found.illumination.shape)
    ((64, 96), 0.3, (3, 3, 3))

    The illumination falls off towards the corners:

    >>> bool(found.illumination[1, 0, 0] < found.illumination[1, 1, 1])
    True
    """

    kernels: torch.Tensor
    illumination: torch.Tensor
    ideal: torch.Tensor
    real: torch.Tensor
    undistort: torch.Tensor
    pitch: float
    shape: tuple[int, int]


@in_own_precision
def point_spread_map(
    system: optical_system,
    shape: Sequence[int],
    pitch: float,
    *,
    grid: Sequence[int] = (5, 5),
    kernel: int = 25,
    kind: str = "rays",
    count: int = 10,
    response: Sequence[Sequence[float]] | Array | None = None,
    losses: bool = False,
    prescription: Prescription | None = None,
) -> PointSpreadMap:
    """Return the point spread functions of a lens over a sensor, with distortion and relative illumination.

    Parameters
    ----------
    system : optical_system
        The system.
    shape : sequence of int
        Rows and columns of the sensor, whose middle is on the axis.
    pitch : float
        Of its pixels, in the system's unit.
    grid : sequence of int
        Points along y and x at which the functions are computed, from edge to edge.
    kernel : int
        Pixels along each side of a function, odd.
    kind : str
        "rays": where the rays land. "waves": :func:`point_spread_function`, with diffraction.
    count : int
        Rings of rays in the pupil; of "waves", the samples across the pupil are eight times as many, and up to 256
        where the wavefront needs more.
    response : array, optional
        Weights of the system's wavelengths in each channel, ``[C, W]``, of any scale. By default three channels, red,
        green and blue, for a system of three wavelengths, otherwise a single one of even weights.
    losses : bool
        Let the surfaces and glasses take their share, as in :func:`polarized_trace`.
    prescription : Prescription, optional
        Numbers in place of the system's own, of one system.

    Returns
    -------
    PointSpreadMap
        float64, differentiable in the system's numbers.

    Raises
    ------
    ValueError, TypeError
        If an argument is outside its range, naming it, or no ray arrives at a point of the grid.

    Warns
    -----
    odak.AccuracyWarning
        If more than a tenth of the light of a point of the grid falls beside its kernel.

    Notes
    -----
    A bundle of rays evenly spread over the entrance pupil holds the power ∝ cos⁴θ of a Lambertian object per area of
    the ideal image, θ being the angle of the ray in front; distortion changes the area, vignetting the number of rays.
    Each ray, or sample of a diffraction image, is shared among four pixels by bilinear weights, which is what makes the
    functions differentiable.

    Examples
    --------
    >>> from odak.learn.raytracing.system import load_system, point_spread_map
    >>> found = point_spread_map(load_system("cooke_triplet"), (64, 96), 0.3, grid=(3, 3), count=4)
    >>> tuple(found.kernels.shape)
    (3, 3, 3, 25, 25)
    """
    checked_system(system), checked_prescription(prescription)
    rows, columns = _validate.size("shape", shape)
    pitch = _validate.constant("pitch", pitch, positive=True)
    grid = _validate.size("grid", grid)
    kernel = _validate.integer("kernel", kernel, minimum=3)
    if kernel % 2 == 0:
        raise ValueError(f"kernel must be odd, got {kernel}")
    if min(grid) < 2:
        raise ValueError(f"grid must have at least 2 points along each side, got {tuple(grid)}")
    kind, losses = _validate.one_of("kind", kind, KINDS), _validate.flag("losses", losses)
    count = _validate.integer("count", count, minimum=2)
    weights = _response(system, response)
    half = [(n - 1) / 2 * pitch for n in (rows, columns)]
    ideal = _lattice(half, grid).to(weights)
    options = {"prescription": prescription, "fields": _fields_of(system, ideal.reshape(-1, 2), prescription)}
    real = _chief(system, options)[system.reference]
    undistort = _inverse_map(system, prescription, half, pitch)
    power = _power(system, count, options, losses) * _area(undistort, real)[:, None, :]
    axis = {**options, "fields": torch.zeros(1, 2, dtype=torch.float64)}
    middle = _power(system, count, axis, losses) * _area(undistort, torch.zeros_like(real[:1]))[:, None, :]
    # Each channel is normalised to white, independently of the losses of its wavelengths on the axis.
    lit = torch.einsum("cw,wf->cf", weights, power[0]) / torch.einsum("cw,wf->cf", weights, middle[0])
    collect = _ray_images if kind == "rays" else _diffraction_images
    images, total = collect(system, count, options, real, pitch, kernel)
    if is_readable(total) and bool((total == 0).any()):
        raise ValueError("shape and pitch must give a sensor within the image of the lens, got points without any ray")
    images = images / total[..., None, None]
    spread = weights[:, :, None] * power[0] / torch.einsum("cw,wf->cf", weights, middle[0])[:, None, :]
    kernels = torch.einsum("cwf,wfij->cfij", spread, images)
    held = (kernels.sum((-2, -1)) / lit).detach().nan_to_num(1.0)
    if is_readable(held) and float(held.min()) < HELD:
        warn(
            f"kernels of {kernel} x {kernel} pixels hold {100 * float(held.min()):.2g} % of the light of a point, and "
            "pictures lose the rest: take a larger kernel",
            AccuracyWarning,
        )
    parts = (kernels.reshape(-1, *grid, kernel, kernel), lit.reshape(-1, *grid), ideal, real.reshape(*grid, 2))
    return PointSpreadMap(*parts, undistort, pitch, (rows, columns))


def _response(system, response) -> torch.Tensor:
    """Return the weights of the wavelengths in each channel, ``[C, W]``, each adding up to 1."""
    number = len(system.wavelengths)
    device = system.surfaces[0].thickness.device
    if response is None:
        if number == 3:
            order = torch.tensor(system.wavelengths).argsort(descending=True)
            return torch.eye(3, dtype=torch.float64, device=device)[order]
        like = torch.empty(0, dtype=torch.float64, device=device)
        return wavelength_shares(system, None, like)[None] / number
    given = response if isinstance(response, torch.Tensor) else _validate.array("response", response)
    found = torch.as_tensor(_validate.real("response", given), dtype=torch.float64, device=device)
    if found.ndim != 2 or found.shape[1] != number or bool((found < 0).any()) or bool((found.sum(-1) <= 0).any()):
        raise ValueError(
            f"response must be weights [channels, {number}], none negative and no row of zeros; "
            f"got an array of shape {tuple(found.shape)}" + (f", {found.tolist()}" if found.numel() <= 9 else "")
        )
    return found / found.sum(-1, keepdim=True)


def _lattice(half, grid) -> torch.Tensor:
    lines = [torch.linspace(-size, size, n, dtype=torch.float64) for size, n in zip(half, grid, strict=True)]
    y, x = torch.meshgrid(*lines, indexing="ij")
    return torch.stack([x, y], -1)


def _fields_of(system, ideal: torch.Tensor, prescription) -> torch.Tensor:
    """Return the field points ``[F, 2]`` of ideal image points."""
    unit = torch.eye(2, dtype=torch.float64)
    place = paraxial_points(system, prescription, unit).diagonal(dim1=-2, dim2=-1)
    if not system.at_infinity:
        return ideal / place
    return torch.rad2deg(torch.atan(ideal / (place / math.tan(math.radians(1.0)))))


def _chief(system, options) -> torch.Tensor:
    """Return the intersections of chief rays with the sensor, ``[W, F, 2]``."""
    found = trace_fields(system, CENTRE, **options, vignetting=False)
    if is_readable(found.status) and not bool(found.arrived.all()):
        raise ValueError(
            "shape and pitch must give a sensor within the image of the lens, got points without chief ray"
        )
    return torch.stack([found.x[..., 0], found.y[..., 0]], -1)


def _inverse_map(system, prescription, half, pitch: float) -> torch.Tensor:
    """Return polynomials through chief rays that give the ideal point of a real one, in half sides of the sensor."""
    ideal = (
        _lattice([1.02 * size for size in half], (LINE, LINE)).reshape(-1, 2).to(system.surfaces[0].thickness.device)
    )
    options = {"prescription": prescription, "fields": _fields_of(system, ideal, prescription)}
    real, size = _chief(system, options)[system.reference], max(half)
    basis = _terms(real / size)
    found = torch.linalg.lstsq(basis, ideal / size).solution
    left = (basis @ found - ideal / size).detach().abs().max() * size / pitch
    if is_readable(left) and float(left) > 0.1:
        warn(f"the distortion over the sensor is fitted to {float(left):.2g} pixels only", AccuracyWarning)
    # The scale is part of the coefficients: powers of the length.
    powers = torch.tensor([i + j for i, j in _POWERS], dtype=torch.float64, device=found.device)
    return (found * size / size ** powers[:, None]).mT


_POWERS = [(i, j) for i in range(DEGREE + 1) for j in range(DEGREE + 1 - i)]


def _terms(points: torch.Tensor) -> torch.Tensor:
    """Return all products xⁱyʲ up to the degree, ``[..., terms]``."""
    x, y = points.unbind(-1)
    return torch.stack([x**i * y**j for i, j in _POWERS], -1)


@in_own_precision
def _area(undistort: torch.Tensor, real: torch.Tensor) -> torch.Tensor:
    """Return the area of the ideal image per area of the real one at points ``[F, 2]``, as ``[1, F]``."""
    x, y = real.unbind(-1)
    along_x = torch.stack([i * x ** max(i - 1, 0) * y**j for i, j in _POWERS], -1) @ undistort.mT
    along_y = torch.stack([j * x**i * y ** max(j - 1, 0) for i, j in _POWERS], -1) @ undistort.mT
    return (along_x[..., 0] * along_y[..., 1] - along_x[..., 1] * along_y[..., 0]).abs()[None]


@in_own_precision
def ideal_points(undistort: torch.Tensor, real: torch.Tensor) -> torch.Tensor:
    """Return the ideal points ``[..., 2]`` of real ones."""
    return _terms(real) @ undistort.mT.to(real)


def _ray_images(system, count: int, options, origin, pitch: float, kernel: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Return what the pixels about points ``[F, 2]`` receive ``[W, F, K, K]``, and the power in all ``[W, F]``."""
    rays = launch(system, "rings", count, **options)
    found = trace(system, rays, prescription=options["prescription"])
    place = torch.stack([torch.where(found.arrived, value, 0.0) for value in (found.x, found.y)], -1)
    share = torch.where(found.arrived, (rays.w**4).expand_as(found.x), 0.0) * _ring_weights(count).to(found.x)
    return _splat((place - origin[:, None, :]) / pitch, share, kernel), share.sum(-1)


def _ring_weights(count: int) -> torch.Tensor:
    """Return the areas of the pupil represented by points of rings; points at the edge are weighted by one half."""
    weights = torch.ones(1 + 3 * count * (count + 1), dtype=torch.float64)
    weights[-6 * count :] = 0.5 - 0.125 / count
    weights[0] = 0.75
    return weights


def _diffraction_images(
    system, count: int, options, origin, pitch: float, kernel: int
) -> tuple[torch.Tensor, torch.Tensor]:
    """Return the same of diffraction images."""
    spread = pupil_image(system, more_samples(8 * count), None, options, fineness=2)
    n = spread.intensity.shape[-1]
    line = torch.arange(n, dtype=torch.float64, device=spread.pitch.device) - n // 2
    chief = (_chief(system, options) - origin) / pitch + kernel // 2
    x, y = (line * spread.pitch[..., 1 - i, None] / pitch + chief[..., i, None] for i in (0, 1))
    # The samples are a lattice: their shares of pixels are products of those of rows and of columns.
    return _linear_shares(y, kernel).mT @ spread.intensity @ _linear_shares(x, kernel), spread.intensity.sum((-2, -1))


def _linear_shares(place: torch.Tensor, kernel: int) -> torch.Tensor:
    """Return the shares of places ``[..., n]`` in the two pixels next to each, ``[..., n, K]``."""
    away = place[..., None] - torch.arange(kernel, dtype=place.dtype, device=place.device)
    return torch.where((away >= -1) & (away < 1), torch.where(away >= 0, 1 - away, 1 + away), 0.0)


def _power(system, count: int, options, losses: bool) -> torch.Tensor:
    """Return the power that arrives from each field point, not divided by the area of its image, ``[1, W, F]``."""
    rays = launch(system, "rings", count, **options)
    if losses:
        through = polarized_trace(system, rays, prescription=options["prescription"]).transmittance
    else:
        through = trace(system, rays, prescription=options["prescription"]).arrived.to(torch.float64)
    weights = _ring_weights(count).to(through)
    power = ((rays.w**4) * through * weights).sum(-1)[None] / weights.sum()
    factors = pupil_factors(system, field_points(system, options.get("fields")).to(power))
    return power if factors is None else power * (1 - factors[:, 2:]).prod(-1)


def _splat(offsets: torch.Tensor, shares: torch.Tensor, kernel: int) -> torch.Tensor:
    """Return images ``[W, F, K, K]`` of points ``[W, F, P, 2]``, each shared among four pixels."""
    place = offsets + kernel // 2
    cell = torch.floor(place.detach())
    part = place - cell
    image = torch.zeros(*shares.shape[:-1], kernel * kernel, dtype=shares.dtype, device=shares.device)
    for i in range(2):
        for j in range(2):
            column, row = cell[..., 0] + j, cell[..., 1] + i
            weight = (part[..., 0] if j else 1 - part[..., 0]) * (part[..., 1] if i else 1 - part[..., 1])
            inside = (column >= 0) & (column < kernel) & (row >= 0) & (row < kernel)
            index = torch.where(inside, row * kernel + column, 0).long()
            image = image.scatter_add(-1, index, torch.where(inside, weight * shares, 0.0))
    return image.reshape(*image.shape[:-1], kernel, kernel)


def simulate_image(picture: torch.Tensor, spread: PointSpreadMap) -> torch.Tensor:
    """Return the irradiance on a sensor: a picture, with the distortion, blur and relative illumination of the lens.

    Parameters
    ----------
    picture : torch.Tensor
        Radiance, ``[..., C, rows, columns]``, as an ideal lens would put it on the sensor.
    spread : PointSpreadMap
        From :func:`point_spread_map`, of as many channels, or of one.

    Returns
    -------
    torch.Tensor
        Of the shape and dtype of the picture; differentiable in both.

    Raises
    ------
    ValueError
        If picture and sensor differ in size.

    Notes
    -----
    Between the points of the grid the functions are interpolated bilinearly at the source: the picture times each
    point's weights is convolved with its function, in Fourier space. Beyond its edge the picture is continued with the
    values there.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.raytracing.system import load_system, point_spread_map, simulate_image
    >>> found = point_spread_map(load_system("cooke_triplet"), (48, 64), 0.4, grid=(3, 3), count=3)
    >>> tuple(simulate_image(torch.rand(3, 48, 64), found).shape)
    (3, 48, 64)
    """
    picture = floating("picture", picture)
    _validate.instance("spread", spread, PointSpreadMap, "a PointSpreadMap")
    channels = spread.kernels.shape[0]
    if picture.ndim < 3 or tuple(picture.shape[-2:]) != spread.shape or picture.shape[-3] not in (channels, 1):
        raise ValueError(
            f"picture must be [..., {channels}, {spread.shape[0]}, {spread.shape[1]}], "
            f"{_validate.in_order('picture', picture.shape, spread.shape)}"
        )
    rows, columns = spread.shape
    kernel = spread.kernels.shape[-1]
    margin = kernel // 2
    real = _lattice(
        [((n - 1) / 2 + margin) * spread.pitch for n in spread.shape], (rows + 2 * margin, columns + 2 * margin)
    )
    inside = [(n - 1) / 2 * spread.pitch for n in (columns, rows)]
    limits = torch.tensor(inside, dtype=torch.float64, device=real.device)
    real = real.clamp(-limits, limits).to(spread.kernels.device)
    ideal = ideal_points(spread.undistort, real) / limits.to(spread.kernels.device)
    distorted = torch.nn.functional.grid_sample(
        picture.reshape(1, -1, rows, columns).double(), ideal[None], "bilinear", "border", align_corners=True
    ).reshape(*picture.shape[:-2], *real.shape[:2])
    size = [n + 2 * (kernel - 1) for n in (rows, columns)]
    total: Any = 0.0
    weights = [_linear_weights(ideal[..., axis], spread.kernels.shape[2 - axis]) for axis in (1, 0)]
    for i, up in enumerate(weights[0]):
        for j, along in enumerate(weights[1]):
            part = torch.fft.rfft2(distorted * (up * along), s=size)
            total = total + part * torch.fft.rfft2(spread.kernels[:, i, j], s=size)
    found = torch.fft.irfft2(total, s=size)
    return found[..., kernel - 1 : kernel - 1 + rows, kernel - 1 : kernel - 1 + columns].to(picture.dtype)


def _linear_weights(place: torch.Tensor, count: int) -> list[torch.Tensor]:
    """Return the weights of points at −1 … 1 by linear interpolation."""
    scaled = (place.clamp(-1, 1) + 1) / 2 * (count - 1)
    return [(1 - (scaled - i).abs()).clamp(min=0) for i in range(count)]


def expose_sensor(
    irradiance: torch.Tensor,
    *,
    full_well: float = 10000.0,
    read_noise: float = 3.0,
    bits: int | None = 10,
    pattern: str | None = None,
    seed: int | None = 0,
) -> torch.Tensor:
    """Return the counts of a sensor, with photon and read noise, saturation, quantisation and a colour mosaic.

    Parameters
    ----------
    irradiance : torch.Tensor
        ``[..., C, rows, columns]``, 1 for a full well.
    full_well : float
        Electrons of a full pixel.
    read_noise : float
        Its standard deviation in electrons.
    bits : int, optional
        Of the converter; none by None.
    pattern : str, optional
        "RGGB", "BGGR", "GRBG" or "GBRG": each pixel reads one of three channels. By default each reads all.
    seed : int, optional
        Of the noise; None for a sensor without noise.

    Returns
    -------
    torch.Tensor
        Values from 0 to 1, ``[..., C, rows, columns]``, with a pattern ``[..., 1, rows, columns]``. Differentiable:
        noise moves with the signal, and rounding passes gradients on as they are.

    Notes
    -----
    The noise of N electrons is normal, of variance N + read_noise²; for fewer than ten electrons Poisson's law differs.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.raytracing.system import expose_sensor
    >>> tuple(expose_sensor(torch.full((3, 4, 6), 0.5), pattern="RGGB").shape)
    (1, 4, 6)
    """
    irradiance = floating("irradiance", irradiance)
    full_well = _validate.constant("full_well", full_well, positive=True)
    read_noise = _validate.constant("read_noise", read_noise, least=0)
    if pattern is not None:
        _validate.shaped("irradiance", irradiance, "[..., 3, rows, columns] for a pattern")
        masks = _masks(irradiance, pattern)
        irradiance = (irradiance * masks).sum(-3, keepdim=True)
    electrons = irradiance * full_well
    if seed is not None:
        generator = torch.Generator(irradiance.device).manual_seed(_validate.integer("seed", seed))
        normal = torch.randn(irradiance.shape, generator=generator, dtype=torch.float64, device=irradiance.device)
        electrons = electrons + normal.to(irradiance) * (electrons.clamp(min=0) + read_noise**2 + 1e-12).sqrt()
    found = (electrons / full_well).clamp(0, 1)
    if bits is None:
        return found
    steps = 2 ** _validate.integer("bits", bits, minimum=1) - 1
    return found + (torch.round(found.detach() * steps) / steps - found.detach())


def _masks(image: torch.Tensor, pattern: str) -> torch.Tensor:
    """Return which channel each pixel of a mosaic reads, ``[3, rows, columns]``."""
    pattern = _validate.one_of("pattern", pattern, PATTERNS)
    rows, columns = image.shape[-2:]
    y, x = torch.meshgrid(torch.arange(rows), torch.arange(columns), indexing="ij")
    channel = torch.tensor(["RGB".index(letter) for letter in pattern])[(y % 2) * 2 + x % 2]
    return torch.stack([channel == i for i in range(3)]).to(image)


@in_own_precision
def demosaic(raw: torch.Tensor, pattern: str = "RGGB") -> torch.Tensor:
    """Return the colours of a mosaic by bilinear interpolation.

    Parameters
    ----------
    raw : torch.Tensor
        ``[..., 1, rows, columns]``, at least 2 × 2 pixels.
    pattern : str
        "RGGB", "BGGR", "GRBG" or "GBRG".

    Returns
    -------
    torch.Tensor
        ``[..., 3, rows, columns]``; differentiable.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.raytracing.system import demosaic
    >>> demosaic(torch.full((1, 4, 4), 0.25)).unique()
    tensor([0.2500])
    """
    raw = floating("raw", raw)
    _validate.shaped("raw", raw, "[..., 1, 2 or more, 2 or more]")
    masks = _masks(raw, pattern)
    weights = torch.tensor([[1.0, 2.0, 1.0], [2.0, 4.0, 2.0], [1.0, 2.0, 1.0]]).to(raw)[None, None].expand(3, 1, 3, 3)
    values = (raw * masks).reshape(-1, 3, *raw.shape[-2:])
    found = torch.nn.functional.conv2d(values, weights, padding=1, groups=3)
    share = torch.nn.functional.conv2d(masks[None], weights, padding=1, groups=3)
    return (found / share).reshape(*raw.shape[:-3], 3, *raw.shape[-2:])
