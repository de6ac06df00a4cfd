"""The optics of the eye: a schematic eye, its wavefront, retinal images of pictures and fields, accommodation."""

import functools
import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import torch

from odak import _show, _torch_private, _validate
from odak._array import is_readable
from odak.catalog.materials import OpticalMaterial
from odak.learn._tensors import complex_tensor, kind_of, tensor
from odak.learn.raytracing.system.analysis import wavefront
from odak.learn.raytracing.system.specification import Conjugates, SystemRecord
from odak.learn.raytracing.system.surfaces import optical_system, surface
from odak.raytracing import components as vec
from odak.raytracing.geometry import safe_sqrt
from odak.raytracing.gradients import Gradient
from odak.wave.transfer_functions import phasor_of_cycles
from odak.wave.viewing import ROTATION_RADIUS

# Indices of the media at 365.0, 486.1, 656.3 and 1014.0 nm: Navarro et al. (1985), doi 10.1364/JOSAA.2.001273.
NAVARRO_INDICES = {
    "cornea": (1.3975, 1.3807, 1.37405, 1.3668),
    "aqueous": (1.3593, 1.3422, 1.3354, 1.3278),
    "lens": (1.4492, 1.42625, 1.4175, 1.4097),
    "vitreous": (1.3565, 1.3407, 1.3341, 1.3273),
}
# Herzberger's a₁ … a₄, one for each of these wavelengths, over 1, λ², L and L², with L = 1/(λ² − 0.028 µm²), as in
# Atchison and Smith, J. Opt. Soc. Am. A 22, 29 (2005), doi 10.1364/JOSAA.22.000029 (λ² of a₁ is misprinted in 1985).
HERZBERGER = (
    (0.66147196, -0.40352796, -0.28046790, 0.03385979),
    (-4.20146383, 2.73508956, 1.50543784, -0.11593235),
    (6.29834237, -4.69409935, -1.57508650, 0.10293038),
    (-1.75835059, 2.36253794, 0.35011657, -0.02085782),
)
RANGE, LIOU_BRENNAN_RANGE = (0.365, 1.014), (0.38, 0.75)
VITREOUS, RETINA = 16.3203, -12.0
REFERENCE = 589.3e-9
WAVELENGTHS = (630e-9, 532e-9, 450e-9)
# Number of terms of the wavefront in squared radii, and of the rays to which they are fitted.
TERMS, RAYS = 6, 24
# Band of frequencies, in cycles per degree, whose contrast drives accommodation.
DRIVE = (4.0, 8.0)
TRIED = tuple(step / 4 for step in range(25))
# Samples across the pupil, and for each wave of path from its centre to its edge.
LEAST_SAMPLES, MOST_SAMPLES, SAMPLES_PER_WAVE = 256, 2048, 8
# Pixels by which pictures are continued beyond the extent of the blur.
MARGIN = 8


@_validate.takes_units()
def navarro_eye(
    accommodation: float = 0.0,
    pupil_diameter: float = 4.0,
    wavelengths: float | Sequence[float] = REFERENCE,
    fields: Sequence[Any] = (0.0,),
    object_distance: float = math.inf,
) -> optical_system:
    """Return the schematic eye of Navarro as a lens system.

    Parameters
    ----------
    accommodation : float
        Parameter A of the model in dioptres, 0 to 10.
    pupil_diameter : float
        Diameter of the entrance pupil in millimetres.
    wavelengths : float or sequence of float
        In metres, 365 to 1014 nm.
    fields : sequence
        Field points: angles in degrees for an object at infinity, heights in millimetres otherwise.
    object_distance : float
        From the object to the cornea, in millimetres.

    Returns
    -------
    optical_system
        Lengths in millimetres; the image surface is the retina, a sphere of 12 mm radius.

    Raises
    ------
    ValueError, TypeError
        If an argument is out of range.

    Notes
    -----
    Navarro, Santamaría and Bescós, J. Opt. Soc. Am. A 2, 1273 (1985), doi 10.1364/JOSAA.2.001273; the depth of the
    vitreous, 16.3203 mm, and the retina are from Escudero-Sanz and Navarro, J. Opt. Soc. Am. A 16, 1881 (1999), doi
    10.1364/JOSAA.16.001881. Dispersion after Herzberger, as there. Power 60.4 dioptres. The lens has one index; the
    parameter A is not exactly the vergence that is in focus: :func:`eye_refraction` gives that.

    Examples
    --------
    >>> from odak.learn.raytracing.system import navarro_eye
    >>> from odak.learn.raytracing.system import first_order
    >>> round(1000 / float(first_order(navarro_eye()).focal_length), 1)
    60.4
    """
    accommodation = _accommodation(accommodation)
    waves, pupil_diameter = _wavelengths(wavelengths), _pupil_width(pupil_diameter)
    (front, back), (conic, behind), (chamber, width), added = _accommodated(accommodation, math.log(accommodation + 1))
    lens = _medium("lens", added)
    return optical_system(
        [
            surface(7.72, conic=-0.26, thickness=0.55, material=_medium("cornea")),
            surface(6.5, thickness=chamber, material=_medium("aqueous")),
            surface(thickness=0.0, material=_medium("aqueous"), stop=True),
            surface(front, conic=conic, thickness=width, material=lens),
            surface(back, conic=behind, thickness=VITREOUS, material=_medium("vitreous")),
        ],
        aperture=pupil_diameter,
        wavelengths=[wave * 1e3 for wave in waves],
        fields=fields,
        conjugates=Conjugates(object_distance),
        image=surface(RETINA),
        name=SystemRecord(
            "Navarro's eye",
            "Navarro et al., J. Opt. Soc. Am. A 2, 1273 (1985); Escudero-Sanz and Navarro, ibid. 16, 1881 (1999)",
        ),
    )


def _accommodated(accommodation, growth):
    """Return radii and conics of the lens, depths of the chamber and the lens, and what its index has more."""
    radii, conics = (10.2 - 1.75 * growth, -6 + 0.2294 * growth), (-3.1316 - 0.34 * growth, -1 - 0.125 * growth)
    added = 9e-5 * (10 * accommodation + accommodation**2)
    return radii, conics, (3.05 - 0.05 * growth, 4 + 0.1 * growth), added


def _accommodation(value, name="accommodation"):
    return _validate.constant(name, value, least=0, most=10, unit="dioptres")


@dataclass(frozen=True)
class LensGradient(Gradient):
    """The index of a half of Liou and Brennan's lens: n = n₀ + a·z + b·z² + c·r².

    Parameters
    ----------
    axial : sequence or array
        a and b, in 1/mm and 1/mm².
    radial : float or array
        c, in 1/mm².
    """

    ranks: ClassVar[Mapping[str, int]] = {"axial": 1}
    axial: Any = (0.0, 0.0)
    radial: Any = 0.0

    def squared(self, x: Any, y: Any, z: Any, base: Any) -> tuple[Any, ...]:
        """Return the square of the index and its derivatives by x, y and z."""
        a, b = vec.terms(self.axial)
        index = base + (a + b * z) * z + self.radial * (x * x + y * y)
        slope = 4 * self.radial * index
        return index * index, slope * x, slope * y, 2 * index * (a + 2 * b * z)


@_validate.takes_units()
def liou_brennan_eye(
    pupil_diameter: float = 4.0,
    wavelengths: float | Sequence[float] = 555e-9,
    fields: Sequence[Any] = (0.0,),
    object_distance: float = math.inf,
) -> optical_system:
    """Return the schematic eye of Liou and Brennan, whose lens has a graded index, as a lens system.

    Parameters
    ----------
    pupil_diameter : float
        Diameter of the entrance pupil in millimetres.
    wavelengths : float or sequence of float
        In metres, 380 to 750 nm.
    fields : sequence
        Field points: angles in degrees for an object at infinity, heights in millimetres otherwise.
    object_distance : float
        From the object to the cornea, in millimetres.

    Returns
    -------
    optical_system
        Lengths in millimetres; relaxed, all surfaces centred (the publication has the pupil 0.5 mm off the axis).

    Raises
    ------
    ValueError, TypeError
        If an argument is out of range.

    Notes
    -----
    Liou and Brennan, J. Opt. Soc. Am. A 14, 1684 (1997), doi 10.1364/JOSAA.14.001684: power 60.35 dioptres,
    length 23.95 mm. The lens is two media of graded index with a plane between them; rays in it solve the ray
    equation.

    Examples
    --------
    >>> from odak.learn.raytracing.system import liou_brennan_eye
    >>> len(liou_brennan_eye().surfaces)
    6
    """
    waves = _wavelengths(wavelengths)
    if not all(LIOU_BRENNAN_RANGE[0] * 1e-6 <= wave <= LIOU_BRENNAN_RANGE[1] * 1e-6 for wave in waves):
        raise ValueError(f"wavelengths must be 380e-9 to 750e-9 metres, got {waves}")
    front, back = LensGradient((0.049057, -0.015427), -0.001978), LensGradient((0.0, -0.006605), -0.001978)
    return optical_system(
        [
            surface(7.77, conic=-0.18, thickness=0.50, material=_shifted_medium(1.376)),
            surface(6.40, conic=-0.60, thickness=3.16, material=_shifted_medium(1.336)),
            surface(thickness=0.0, material=_shifted_medium(1.336), stop=True),
            surface(12.40, conic=-0.94, thickness=1.59, material=_shifted_medium(1.368), gradient=front),
            surface(thickness=2.43, material=_shifted_medium(1.407), gradient=back),
            surface(-8.10, conic=0.96, thickness=16.27, material=_shifted_medium(1.336)),
        ],
        aperture=_pupil_width(pupil_diameter),
        wavelengths=[wave * 1e3 for wave in waves],
        fields=fields,
        conjugates=Conjugates(object_distance),
        image=surface(RETINA),
        name=SystemRecord("Liou and Brennan's eye", "Liou and Brennan, J. Opt. Soc. Am. A 14, 1684 (1997)"),
    )


@functools.lru_cache(maxsize=64)
def _shifted_medium(index):
    """Return a medium of this index at 555 nm, with the dispersion that Liou and Brennan give all media."""
    formula = {"A": (index + 0.0512, -0.1455, 0.0961), "P": (0.0, 1.0, 2.0)}
    source = "Liou and Brennan (1997)"
    return OpticalMaterial(f"medium of {index} of the eye", "conrady", formula, LIOU_BRENNAN_RANGE, "air", source)


def _pupil_width(value):
    """Return the diameter of a pupil in millimetres as a float."""
    return _validate.constant("pupil_diameter", value, least=0.5, most=9, unit="millimetres")


def _numbers(name, values, positive=False):
    """Return a sequence of numbers as floats."""
    try:
        given = [_validate.constant(name, one, positive=positive) for one in values]
    except TypeError as error:
        raise TypeError(f"{name} must be a number or a sequence of numbers, got {values!r:.80}") from error
    if not given:
        raise ValueError(f"{name} must contain one or more numbers, got none")
    return given


def _wavelengths(values):
    given = _numbers("wavelengths", [values] if isinstance(values, (int, float)) else values, positive=True)
    if any(not RANGE[0] * 1e-6 <= value <= RANGE[1] * 1e-6 for value in given):
        raise ValueError(f"wavelengths must be 365e-9 to 1014e-9 metres, got {given}")
    return given


@functools.lru_cache(maxsize=256)
def _medium(name, added=0.0):
    indices = [index + added for index in NAVARRO_INDICES[name]]
    constant, square, *poles = (
        sum(index * row[term] for index, row in zip(indices, HERZBERGER, strict=True)) for term in range(4)
    )
    formula = {"A": (constant, square), "P": (0.0, 2.0), "B": tuple(poles)}
    return OpticalMaterial(f"{name} of the eye", "herzberger", formula, RANGE, "air", "Navarro et al. (1985)")


@functools.lru_cache(maxsize=512)
def _terms(accommodation, diameter, waves):
    """Return the lag of the wavefront in metres as coefficients of (r/R)², (r/R)⁴, … ``[W, terms]``, R = diameter/2."""
    with _torch_private.keeping(), torch.no_grad():
        return _fitted(navarro_eye(accommodation, diameter, waves), None, waves)


def _traced_terms(accommodation: torch.Tensor, diameter, waves):
    """Return the same, differentiable in the accommodation."""
    system = navarro_eye(float(accommodation.detach()), diameter, waves)
    given = accommodation.double().reshape(())
    radii, conics, (chamber, width), added = _accommodated(given, torch.log(given + 1))
    p = system.prescription()
    # The medium behind the surface before the last is the lens.
    behind = torch.eye(p.index.shape[-1], dtype=torch.float64)[4]
    numbers = p._replace(
        curvature=torch.stack([*p.curvature[:3], *(1 / radius for radius in radii)]),
        conic=torch.stack([*p.conic[:3], *conics]),
        thickness=torch.stack([p.thickness[0], chamber, p.thickness[2], width, p.thickness[4]]),
        index=p.index + behind * (added - added.detach()),
    )
    return _fitted(system, numbers, waves)


def _fitted(system, numbers, waves):
    radius = torch.sqrt((torch.arange(RAYS, dtype=torch.float64) + 0.5) / RAYS)
    places = torch.stack([torch.zeros_like(radius), radius], -1)
    found = wavefront(system, places, vignetting=False, prescription=numbers)
    lag = found.path[:, 0] * torch.tensor(waves, dtype=torch.float64)[:, None]
    return torch.linalg.lstsq(radius[:, None] ** (2 * torch.arange(1, TERMS + 1)), lag.T).solution.T


@_validate.takes_units()
def eye_wavefront(
    radius: torch.Tensor | float,
    wavelengths: float | Sequence[float] = WAVELENGTHS,
    pupil_diameter: float = 4.0,
    accommodation: float = 0.0,
    vergence: float = 0.0,
) -> torch.Tensor:
    """Return the optical path difference of a point on the axis from a sphere about its position on the retina.

    Parameters
    ----------
    radius : torch.Tensor or float
        Distance from the middle of the entrance pupil in metres, any shape; at most half of the pupil's diameter.
    wavelengths : float or sequence of float
        In metres.
    pupil_diameter : float
        Of the entrance pupil, in millimetres.
    accommodation : float
        Of the eye, in dioptres.
    vergence : float
        One over the point's distance from the entrance pupil, in dioptres: 0 for a point at infinity.

    Returns
    -------
    torch.Tensor
        In metres, ``[W, *radius.shape]``, float64; 0 in the middle.

    Raises
    ------
    ValueError, TypeError
        If an argument is out of range.

    Notes
    -----
    Rays through :func:`navarro_eye`, and a polynomial in the squared radius through what they give: the axis is one of
    symmetry. A point at a finite distance adds the difference between its sphere and a plane.

    Examples
    --------
    >>> from odak.learn.raytracing.system import eye_wavefront
    >>> lag = eye_wavefront(0.002, [450e-9, 650e-9])
    >>> bool(lag[0] < 0 < lag[1])  # blue light is focused in front of the retina, and red light behind
    True
    """
    waves, diameter = tuple(_wavelengths(wavelengths)), _pupil_width(pupil_diameter)
    vergence = _validate.constant("vergence", vergence)
    radius = tensor("radius", radius, torch.float64)
    if isinstance(accommodation, torch.Tensor) and accommodation.requires_grad:
        _accommodation(accommodation.detach())
        coefficients = _traced_terms(accommodation, diameter, waves).to(radius.device)
    else:
        coefficients = _terms(_accommodation(accommodation), diameter, waves).to(radius.device)
    squared = (radius / (diameter / 2e3)) ** 2
    total = torch.zeros((len(waves), *radius.shape), dtype=torch.float64, device=radius.device)
    for term in coefficients.T.flip(0):
        total = (total + term.reshape(-1, *[1] * radius.ndim)) * squared
    # √(d² + r²) − d without the difference of large numbers.
    return total + radius**2 * vergence / (1 + (1 + (radius * vergence) ** 2).sqrt())


@_validate.takes_units()
def eye_refraction(
    wavelengths: float | Sequence[float] = WAVELENGTHS, pupil_diameter: float = 4.0, accommodation: float = 0.0
) -> torch.Tensor:
    """Return the vergence of the points that the eye has in focus.

    Parameters
    ----------
    wavelengths : float or sequence of float
        In metres.
    pupil_diameter : float
        Of the entrance pupil, in millimetres: spherical aberration shifts the focus of wide pupils.
    accommodation : float
        Of the eye, in dioptres.

    Returns
    -------
    torch.Tensor
        One over the distance from the entrance pupil, in dioptres, ``[W]``, float64: where the variance of the
        wavefront over the pupil is least. Negative for light that would have to converge.

    Raises
    ------
    ValueError, TypeError
        If an argument is out of range.

    Examples
    --------
    >>> from odak.learn.raytracing.system import eye_refraction
    >>> near_blue, near_red = eye_refraction([450e-9, 650e-9])
    >>> bool(1.1 < near_blue - near_red < 1.5)
    True
    """
    # Uniform in the squared radius: equal areas.
    share = (torch.arange(RAYS, dtype=torch.float64) + 0.5) / RAYS
    radius = share.sqrt() * _pupil_width(pupil_diameter) / 2e3
    lag = eye_wavefront(radius, wavelengths, pupil_diameter, accommodation)
    square = radius**2 - (radius**2).mean()
    return -2 * (lag * square).sum(-1) / (square**2).sum()


@_validate.takes_units()
def eye_transfer_function(
    size: Sequence[int],
    pitch: float,
    wavelengths: float | Sequence[float] = WAVELENGTHS,
    pupil_diameter: float = 4.0,
    accommodation: float = 0.0,
    vergence: float = 0.0,
) -> torch.Tensor:
    """Return the optical transfer function of the eye at the frequencies of a picture.

    Parameters
    ----------
    size : sequence of int
        Rows and columns of the picture.
    pitch : float
        Angle between its pixels, in radians.
    wavelengths : float or sequence of float
        In metres.
    pupil_diameter : float
        Of the entrance pupil, in millimetres.
    accommodation : float
        Of the eye, in dioptres.
    vergence : float
        One over the picture's distance, in dioptres.

    Returns
    -------
    torch.Tensor
        float64 ``[W, rows, columns // 2 + 1]`` in the order of :func:`torch.fft.rfft2`, 1 at zero. Real: the pupil is
        symmetric.

    Raises
    ------
    ValueError, TypeError
        If an argument is out of range.

    Notes
    -----
    Autocorrelation of the pupil function (Goodman, Introduction to Fourier Optics, 2005, section 6.3). The eye is taken
    to be the same over the picture, as it is around its axis.

    Examples
    --------
    It is 1 at frequency zero:

    >>> from odak.learn.raytracing.system import eye_transfer_function
    >>> transfer = eye_transfer_function([32, 32], 2e-4, 532e-9)
    >>> tuple(transfer.shape), round(float(transfer[0, 0, 0]), 6)
    ((1, 32, 17), 1.0)
    """
    rows, columns = _validate.size("size", size)
    pitch = _validate.constant("pitch", pitch, positive=True)
    waves, pupil_diameter = _wavelengths(wavelengths), _pupil_width(pupil_diameter)
    y = torch.fft.fftfreq(rows, pitch, dtype=torch.float64)
    x = torch.fft.rfftfreq(columns, pitch, dtype=torch.float64)
    frequency = torch.hypot(y[:, None], x)
    return torch.stack([_radial_transfer(frequency, wave, pupil_diameter, accommodation, vergence) for wave in waves])


def _radial_transfer(frequency, wave, diameter, accommodation, vergence):
    """Return the transfer at frequencies in cycles per radian, from that along one axis."""
    width = diameter * 1e-3
    rim = torch.linspace(0, width / 2, RAYS, dtype=torch.float64)
    lag = eye_wavefront(rim, wave, diameter, accommodation, vergence)[0]
    # Waves per radius at the largest gradient, which is also the number of oscillations of the transfer function.
    steepest = float(lag.diff().abs().max()) * (RAYS - 1) / wave
    count = min(MOST_SAMPLES, max(LEAST_SAMPLES, 2 * math.ceil(SAMPLES_PER_WAVE * steepest)))
    line = (torch.arange(2 * count, dtype=torch.float64) - count) * (width / count)
    pupil = _pupil(line[:, None], line, width / count, [wave], diameter, accommodation, vergence)[0]
    # The autocorrelation over the pupil's area. At zero the squares of the weights on the edge would make it too small.
    transfer = torch.fft.ifft(torch.fft.fft2(pupil, norm="ortho").abs().square().sum(0)).real[: count + 1]
    transfer = transfer / (pupil.abs().sum() / len(line))
    transfer[0] = 1.0
    place = (frequency * (wave / width * count)).clamp(max=count)
    # Cubic interpolation between four samples; the function is even, and zero beyond the last.
    table = torch.cat([transfer[1:2], transfer, transfer.new_zeros(2)])
    index = place.floor().long().clamp(max=count - 1)
    share = place - index
    before, here, after, beyond = (table[index + step] for step in range(4))
    return (place < count) * (
        here * (share + 1) * (1 - share) * (2 - share) / 2
        + after * (share + 1) * share * (2 - share) / 2
        - before * share * (1 - share) * (2 - share) / 6
        - beyond * (share + 1) * share * (1 - share) / 6
    )


def _pupil(y, x, pitch, waves, diameter, accommodation, vergence, direction=(0.0, 0.0)):
    """Return the pupil function over places y ``[rows, 1]`` and x ``[columns]`` in metres, complex128 ``[W, …]``.

    The eye looks along `direction`, its cosines along y and x; light along it passes through the points.
    """
    along = y * direction[0] + x * direction[1]
    # Distance of such light from the axis.
    radius = safe_sqrt((y**2 + x**2 - along**2).clamp_min(0))
    # Samples on the edge are weighted by the fraction of their area inside.
    edge = torch.as_tensor(diameter / 2e3, dtype=torch.float64, device=radius.device)
    share = ((edge - radius) / pitch + 0.5).clamp(0, 1)
    width = diameter.detach() if isinstance(diameter, torch.Tensor) else diameter
    lag = eye_wavefront(torch.minimum(radius, edge), waves, width, accommodation, vergence)
    cycles = lag / torch.tensor(waves, dtype=torch.float64, device=lag.device)[:, None, None]
    return phasor_of_cycles(cycles, torch.complex128) * share


@_validate.takes_units()
def retinal_image(
    picture: torch.Tensor,
    vergences: float | Sequence[float],
    pitch: float,
    wavelengths: float | Sequence[float] = WAVELENGTHS,
    pupil_diameter: float = 4.0,
    accommodation: float = 0.0,
) -> torch.Tensor:
    """Return the image on the retina of luminous pictures at one or several distances.

    Parameters
    ----------
    picture : torch.Tensor
        Linear light ``[..., W, H, width]``, a channel for each wavelength; with P vergences ``[..., P, W, H, width]``,
        the planes of a transparent stack, which add up.
    vergences : float or sequence of float
        One over the distance of each plane from the eye, in dioptres.
    pitch : float
        Angle between pixels, in radians, the same for all planes.
    wavelengths : float or sequence of float
        Of the channels, in metres.
    pupil_diameter : float
        Of the entrance pupil, in millimetres.
    accommodation : float
        Of the eye, in dioptres.

    Returns
    -------
    torch.Tensor
        ``[..., W, H, width]`` in the precision of the picture, differentiable in it. Beyond its border the picture is
        taken to go on as at the border.

    Raises
    ------
    ValueError, TypeError
        If shapes do not fit or an argument is out of range.

    Notes
    -----
    Each plane and wavelength is convolved with the intensity of the point spread function of :func:`navarro_eye` on its
    axis: depth of focus, chromatic and spherical aberration and diffraction. Occlusion is not part of it.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.raytracing.system import retinal_image
    >>> line = torch.zeros(1, 33, 33)
    >>> line[..., 16] = 1
    >>> sharp, blurred = (retinal_image(line, v, 3e-4, [550e-9])[0, 16, 16].item() for v in (0.0, 3.0))
    >>> bool(blurred < sharp / 3)
    True
    """
    waves, pupil_diameter = _wavelengths(wavelengths), _pupil_width(pupil_diameter)
    stacked = not isinstance(vergences, (int, float))
    planes = _numbers("vergences", vergences if stacked else [vergences])
    if not isinstance(picture, torch.Tensor) or picture.dtype not in (torch.float32, torch.float64):
        raise TypeError(f"picture must be a tensor of float32 or float64, got {kind_of(picture)}")
    _validate.image("picture", picture, axes=4 if stacked else 3)
    if not picture.numel():
        raise ValueError(f"picture must not be empty, got {tuple(picture.shape)}")
    stack = picture if stacked else picture[..., None, :, :, :]
    if stack.shape[-4:-2] != (len(planes), len(waves)):
        raise ValueError(
            f"picture must have {len(planes)} planes of {len(waves)} wavelengths, got {tuple(picture.shape)}"
        )
    pitch, accommodation = _validate.constant("pitch", pitch, positive=True), _accommodation(accommodation)
    rows, columns = picture.shape[-2:]
    total: Any = 0.0
    for index, vergence in enumerate(planes):
        blur = (eye_refraction(waves, pupil_diameter, accommodation) - vergence).abs().max()
        margin = math.ceil(float(blur) * pupil_diameter * 1e-3 / pitch) + MARGIN
        light = stack[..., index, :, :, :]
        padded = torch.nn.functional.pad(light.reshape(1, -1, rows, columns), (margin,) * 4, mode="replicate")
        size = tuple(padded.shape[-2:])
        transfer = _kept_transfer(size, pitch, tuple(waves), pupil_diameter, accommodation, vergence)
        padded = padded.reshape(*light.shape[:-2], *size)
        seen = torch.fft.irfft2(torch.fft.rfft2(padded) * transfer.to(padded), size)
        total = total + seen[..., margin : margin + rows, margin : margin + columns]
    return total


@functools.lru_cache(maxsize=32)
def _kept_transfer(*arguments):
    with _torch_private.keeping(), torch.no_grad():
        return eye_transfer_function(*arguments)


@_show.shown
class RetinalField(NamedTuple):
    """Field on the retina, for a field that enters the eye.

    Attributes
    ----------
    field : torch.Tensor
        Complex ``[..., rows, columns]`` over visual angle, sample n // 2 of each axis on the axis; upright, as seen.
        The sum of its squared modulus is the power that passes the pupil.
    pitch : tuple of float
        Angle between samples along rows and columns, in radians.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.raytracing.system import retinal_field
    >>> plane_wave = torch.ones(64, 64, dtype=torch.complex128)
    >>> found = retinal_field(plane_wave, 5e-5, 550e-9, pupil_diameter=2.0)
    >>> tuple(found.field.shape), len(found.pitch)
    ((64, 64), 2)
    """

    field: torch.Tensor
    pitch: tuple[float, float]


@_validate.takes_units()
def retinal_field(
    field: torch.Tensor,
    pitch: float,
    wavelength: float,
    pupil_diameter: float = 4.0,
    accommodation: float = 0.0,
    pupil_position: Sequence[float] | torch.Tensor = (0.0, 0.0),
    rotation: Sequence[float] | torch.Tensor = (0.0, 0.0),
    center: str = "gaze",
) -> RetinalField:
    """Return the field on the retina of a coherent field in the entrance pupil, such as the light of a hologram.

    Parameters
    ----------
    field : torch.Tensor
        Complex ``[..., rows, columns]`` in the plane of the entrance pupil, travelling towards the eye.
    pitch : float
        Its pixel pitch, in metres.
    wavelength : float
        In metres.
    pupil_diameter : float
        Of the entrance pupil, in millimetres.
    accommodation : float or torch.Tensor
        Of the eye, in dioptres.
    pupil_position : sequence of float or torch.Tensor
        Of the pupil's middle in the field (x to the right, y downwards), in metres: the eye moves in the eyebox, its
        axis parallel to the field's.
    rotation : sequence of float or torch.Tensor
        Angles in degrees (to the right, downwards), within ±60, by which the eye is then turned about its centre of
        rotation, 10.5 mm behind the entrance pupil.
    center : str
        Direction of the middle sample of a turned eye: "gaze", the direction in which it looks, or "field", the axis of
        the field, so that a scene at rest stays on its samples.

    Returns
    -------
    RetinalField
        Differentiable in the field and, if they are tensors, in `pupil_diameter`, `accommodation`, `pupil_position` and
        `rotation`. Of a turned eye samples are equally spaced in the direction cosines of the field, `pitch` being
        their step.

    Raises
    ------
    ValueError, TypeError
        If the field is not complex or an argument is out of range.

    Notes
    -----
    The field times the pupil function, whose phase is :func:`eye_wavefront`, is transformed to angles. A field in a
    plane further away is first brought to the pupil by :func:`odak.learn.wave.propagate_beam`. The
    pitch of the retinal image is the wavelength over the side of the field.

    The pupil of a rotated eye lies to the side and further back: the field is propagated to its centre by the angular
    spectrum, as one period of a periodic field. Light in the direction of the gaze fills the pupil.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.raytracing.system import retinal_field
    >>> plane_wave = torch.ones(128, 128, dtype=torch.complex128)
    >>> seen = retinal_field(plane_wave, 5e-5, 550e-9, pupil_diameter=2.0)
    >>> divmod(int(seen.field.abs().argmax()), 128)
    (64, 64)
    """
    complex_tensor("field", field, "a complex tensor [..., rows, columns]")
    rows, columns = _validate.image("field", field).shape[-2:]
    pitch = _validate.constant("pitch", pitch, positive=True)
    wavelength = _wavelengths(_validate.number("wavelength", wavelength, positive=True))[0]
    center = _validate.one_of("center", center, ("gaze", "field"))
    if not isinstance(pupil_diameter, torch.Tensor):
        pupil_diameter = _pupil_width(pupil_diameter)
    (right, down), angles = (
        [_validate.real(name, value) for value in _validate.several(name, pair, 2)]
        for name, pair in (("pupil_position", pupil_position), ("rotation", rotation))
    )
    turned = any(isinstance(angle, torch.Tensor) or angle != 0 for angle in angles)
    if any(is_readable(angle) and abs(_validate.numbers(angle)[0]) > 60 for angle in angles):
        raise ValueError(f"rotation must be two angles within ±60 degrees, got {tuple(rotation)}")
    across, downwards = (
        torch.as_tensor(angle, dtype=torch.float64, device=field.device) * (math.pi / 180) for angle in angles
    )
    cosines = torch.sin(downwards), torch.sin(across) * torch.cos(downwards)
    ahead = torch.cos(across) * torch.cos(downwards)
    y, x = (
        (torch.arange(n, dtype=torch.float64, device=field.device) - n // 2) * pitch - shift - ROTATION_RADIUS * cosine
        for n, shift, cosine in ((rows, down, cosines[0]), (columns, right, cosines[1]))
    )
    pupil = _pupil(y[:, None], x, pitch, [wavelength], pupil_diameter, accommodation, 0.0, cosines)[0]
    if turned:
        if center == "gaze":
            # A wave from the direction of the gaze has a constant phase in the pupil.
            tilt = (y[:, None] * cosines[0] + x * cosines[1]) / wavelength
            pupil = pupil * phasor_of_cycles(tilt, torch.complex128)
        # Its power is that over the area of the pupil.
        pupil = pupil * ahead.sqrt()
        fy, fx = (torch.fft.fftfreq(n, pitch, dtype=torch.float64, device=field.device) for n in (rows, columns))
        squared = wavelength**-2 - fy[:, None] ** 2 - fx**2
        cycles = ROTATION_RADIUS * (1 - ahead) * squared.clamp_min(0).sqrt()
        transfer = phasor_of_cycles(cycles, torch.complex128) * (squared > 0)
        field = torch.fft.ifft2(torch.fft.fft2(field) * transfer.to(field.dtype))
    pupil = pupil.to(field.dtype)
    axes = (-2, -1)
    # Light that propagates towards positive x comes from negative angles; the transform makes the image upright.
    spectrum = torch.fft.ifft2(torch.fft.ifftshift(field * pupil, axes), norm="ortho")
    return RetinalField(
        torch.fft.fftshift(spectrum, axes), (wavelength / (rows * pitch), wavelength / (columns * pitch))
    )


class AccommodationResponse(NamedTuple):
    """Accommodation of an eye in front of a picture or a focal stack.

    Attributes
    ----------
    vergence : float
        That the eye focuses to, in dioptres, at the mean of the wavelengths' weights.
    accommodation : float
        Parameter of :func:`navarro_eye` at the largest contrast.
    accommodations : torch.Tensor
        Those that were tried ``[A]``.
    contrast : torch.Tensor
        Contrast of the retinal image at each ``[A]``.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.raytracing.system import accommodation_response
    >>> noise = torch.rand(1, 64, 64, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    >>> found = accommodation_response(noise, 2.0, 6e-4, [550e-9], accommodations=(1.0, 2.0, 3.0))
    >>> found.accommodations[found.contrast.argmax()].item()
    2.0
    """

    vergence: float
    accommodation: float
    accommodations: torch.Tensor
    contrast: torch.Tensor


@_validate.takes_units()
def accommodation_response(
    picture: torch.Tensor,
    vergences: float | Sequence[float],
    pitch: float,
    wavelengths: float | Sequence[float] = WAVELENGTHS,
    pupil_diameter: float = 4.0,
    accommodations: Sequence[float] = TRIED,
    weights: Sequence[float] | None = None,
) -> AccommodationResponse:
    """Return the accommodation at which the retinal image of a picture or a focal stack has the most contrast.

    Parameters
    ----------
    picture : torch.Tensor
        Linear light ``[W, H, width]``, or a stack ``[P, W, H, width]``.
    vergences : float or sequence of float
        One over the distance of each plane, in dioptres.
    pitch : float
        Angle between pixels, in radians.
    wavelengths : float or sequence of float
        Of the channels, in metres.
    pupil_diameter : float
        Of the entrance pupil, in millimetres.
    accommodations : sequence of float
        At least three that rise in equal steps, in dioptres.
    weights : sequence of float, optional
        Luminance of each channel's unit; equal by default.

    Returns
    -------
    AccommodationResponse
        The peak of a parabola through the largest contrast and its neighbours.

    Raises
    ------
    ValueError, TypeError
        If shapes do not fit, an argument is out of range, or the accommodations do not rise in equal steps.

    Notes
    -----
    Contrast counts at 4 to 8 cycles per degree, which is what accommodation follows in the stacks of MacKenzie, Hoffman
    and Watt, J. Vis. 10(8), 22 (2010). Of a picture without detail in this band `contrast` is about 0, and the other
    results mean nothing.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.raytracing.system import accommodation_response
    >>> noise = torch.rand(1, 64, 64, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    >>> found = accommodation_response(noise, 2.0, 6e-4, [550e-9], accommodations=(1.0, 1.5, 2.0, 2.5, 3.0))
    >>> bool(abs(found.vergence - 2.0) < 0.2)
    True
    """
    (pitch,) = _validate.constants(pitch=pitch)
    tried = [_accommodation(one, "accommodations") for one in _numbers("accommodations", accommodations)]
    steps = [b - a for a, b in itertools.pairwise(tried)]
    if len(tried) < 3 or min(steps) <= 0 or max(steps) - min(steps) > 1e-6 * max(steps):
        raise ValueError(f"accommodations must be three or more in equal rising steps, got {accommodations!r:.80}")
    waves = _wavelengths(wavelengths)
    counts = (
        [1.0] * len(waves)
        if weights is None
        else [float(one) for one in _validate.several("weights", weights, len(waves))]
    )
    if min(counts) < 0 or not sum(counts) > 0:
        raise ValueError(f"weights must be 0 or more, one of them positive, got {weights!r:.80}")
    shares = torch.tensor(counts, dtype=torch.float64) / sum(counts)
    contrast = []
    with torch.no_grad():
        for one in tried:
            seen = retinal_image(picture, vergences, pitch, waves, pupil_diameter, one).double()
            light = torch.einsum("w,w...->...", shares.to(seen.device), seen.movedim(-3, 0))
            contrast.append(_band_contrast(light, pitch))
    found = torch.stack(contrast)
    best = min(max(int(found.argmax()), 1), len(tried) - 2)
    below, here, above = (float(value) for value in found[best - 1 : best + 2])
    curve = below - 2 * here + above
    shift = 0.0 if curve >= 0 else max(-1.0, min(1.0, 0.5 * (below - above) / curve))
    accommodation = tried[best] + shift * steps[0]
    vergence = float((eye_refraction(waves, pupil_diameter, accommodation) * shares).sum())
    return AccommodationResponse(vergence, accommodation, found.new_tensor(tried), found)


def _band_contrast(light, pitch):
    """Return the root mean square of a picture within the band that drives accommodation, over its mean."""
    rows, columns = light.shape[-2:]
    degrees = math.degrees(pitch)
    y = torch.fft.fftfreq(rows, degrees, dtype=torch.float64, device=light.device)
    x = torch.fft.fftfreq(columns, degrees, dtype=torch.float64, device=light.device)
    frequency = torch.hypot(y[:, None], x)
    inside = (frequency >= DRIVE[0]) & (frequency <= DRIVE[1])
    spectrum = torch.fft.fft2(light, norm="forward")
    power = (spectrum.abs().square() * inside).sum((-2, -1))
    return (power.sqrt() / light.mean((-2, -1)).clamp_min(1e-12)).mean()
