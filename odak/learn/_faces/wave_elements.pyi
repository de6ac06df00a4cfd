"""Signatures of the functions made by torch_face, written by scripts/make_face_stubs.py: do not edit."""

import collections.abc
import typing

import numpy
import torch


def airy_beam(
    shape: collections.abc.Sequence[int],
    dx: float | collections.abc.Sequence[float],
    scale: float | torch.Tensor | collections.abc.Sequence[float | torch.Tensor],
    decay: float | torch.Tensor = 0.05,
    offset: collections.abc.Sequence[float] = (0.0, 0.0),
    *,
    device: torch.device | str | None = None,
) -> torch.Tensor:
    """Return a finite-energy Airy beam, whose peak follows a parabola."""
    ...

def aspheric_lens_phase(
    shape: collections.abc.Sequence[int],
    dx: float | collections.abc.Sequence[float],
    wavelength: float | torch.Tensor,
    radius: float | torch.Tensor,
    index: float | torch.Tensor = 1.5,
    conic: float | torch.Tensor = 0.0,
    coefficients: collections.abc.Sequence[typing.Any] = (),
    offset: collections.abc.Sequence[float] = (0.0, 0.0),
    *,
    device: torch.device | str | None = None,
) -> torch.Tensor:
    """Return the phase of a thin plano-aspheric lens, −k(n − 1)·sag(r)."""
    ...

def axicon_phase(
    shape: collections.abc.Sequence[int],
    dx: float | collections.abc.Sequence[float],
    wavelength: float | torch.Tensor,
    angle: float | torch.Tensor,
    index: float | torch.Tensor = 1.5,
    offset: collections.abc.Sequence[float] = (0.0, 0.0),
    *,
    device: torch.device | str | None = None,
) -> torch.Tensor:
    """Return the phase of a thin axicon, −k(n − 1)·tan(angle)·r."""
    ...

def beam_quality(
    field: torch.Tensor,
    dx: float | collections.abc.Sequence[float],
) -> torch.Tensor:
    """Return the beam quality factor M² along rows and columns."""
    ...

def beam_width(
    field: torch.Tensor,
    dx: float | collections.abc.Sequence[float],
    method: str = 'D4sigma',
) -> torch.Tensor:
    """Return the widths of a beam along rows and columns."""
    ...

def bessel_beam(
    shape: collections.abc.Sequence[int],
    dx: float | collections.abc.Sequence[float],
    wavelength: float | torch.Tensor,
    angle: float | torch.Tensor,
    order: int = 0,
    waist: float | torch.Tensor | None = None,
    offset: collections.abc.Sequence[float] = (0.0, 0.0),
    *,
    device: torch.device | str | None = None,
) -> torch.Tensor:
    """Return a Bessel beam: plane waves on a cone, which keep their transverse profile."""
    ...

def blazed_grating(
    nx: int,
    ny: int,
    levels: int = 2,
    axis: str = 'x',
) -> torch.Tensor:
    """Return a blazed grating of a period of `levels` samples."""
    ...

def circular_aperture(
    shape: collections.abc.Sequence[int],
    dx: float | collections.abc.Sequence[float],
    radius: float | torch.Tensor,
    offset: collections.abc.Sequence[float] = (0.0, 0.0),
    inner_radius: float | torch.Tensor = 0.0,
    *,
    device: torch.device | str | None = None,
) -> torch.Tensor:
    """Return the transmission of a disc or a ring, with the pixels of its edges weighted by the area inside."""
    ...

def cylindrical_lens_phase(
    shape: collections.abc.Sequence[int],
    focal: float | torch.Tensor,
    dx: float | collections.abc.Sequence[float],
    wavelength: float | torch.Tensor,
    angle: float | torch.Tensor = 0.0,
    offset: collections.abc.Sequence[float] = (0.0, 0.0),
    *,
    device: torch.device | str | None = None,
) -> torch.Tensor:
    """Return the phase of a thin cylindrical lens, −π·s²/(λf), s being the distance from its axis line."""
    ...

def dammann_grating(
    shape: collections.abc.Sequence[int],
    period: float | collections.abc.Sequence[float],
    dx: float | collections.abc.Sequence[float],
    orders: int | collections.abc.Sequence[int] = 5,
    offset: collections.abc.Sequence[float] = (0.0, 0.0),
    *,
    device: torch.device | str | None = None,
) -> torch.Tensor:
    """Return the binary phase of a Dammann grating, which splits a beam into equal ones."""
    ...

def double_convergence(
    nx: int,
    ny: int,
    k: float,
    r: float,
    dx: float | collections.abc.Sequence[float],
) -> torch.Tensor:
    """Return the phase factor exp(ik·r²/R) of a doubly converging beam (Engström et al., Opt. Express 15, 2007)."""
    ...

def fibre_coupling(
    field: torch.Tensor,
    dx: float | collections.abc.Sequence[float],
    radius: float | torch.Tensor,
    offset: collections.abc.Sequence[float] = (0.0, 0.0),
) -> torch.Tensor:
    """Return the share of the power of a field that couples into a single-mode fibre."""
    ...

def flat_top_beam(
    shape: collections.abc.Sequence[int],
    dx: float | collections.abc.Sequence[float],
    waist: float | torch.Tensor,
    order: float | torch.Tensor = 10.0,
    power: float | torch.Tensor = 1.0,
    offset: collections.abc.Sequence[float] = (0.0, 0.0),
    *,
    device: torch.device | str | None = None,
) -> torch.Tensor:
    """Return the amplitude of a flat-top beam, a super-Gaussian."""
    ...

def fresnel_zone_plate(
    shape: collections.abc.Sequence[int],
    focal: float | torch.Tensor,
    dx: float | collections.abc.Sequence[float],
    wavelength: float | torch.Tensor,
    kind: str = 'amplitude',
    offset: collections.abc.Sequence[float] = (0.0, 0.0),
    *,
    device: torch.device | str | None = None,
) -> torch.Tensor:
    """Return the transmission of a binary Fresnel zone plate."""
    ...

def gaussian_beam(
    shape: collections.abc.Sequence[int],
    dx: float | collections.abc.Sequence[float],
    wavelength: float | torch.Tensor,
    waist: float | torch.Tensor | collections.abc.Sequence[float],
    distance: float | torch.Tensor = 0.0,
    power: float | torch.Tensor = 1.0,
    offset: collections.abc.Sequence[float] = (0.0, 0.0),
    *,
    device: torch.device | str | None = None,
) -> torch.Tensor:
    """Return a Gaussian beam at a distance from its waist."""
    ...

def hermite_gaussian_beam(
    shape: collections.abc.Sequence[int],
    dx: float | collections.abc.Sequence[float],
    wavelength: float | torch.Tensor,
    waist: float | torch.Tensor | collections.abc.Sequence[float],
    order: collections.abc.Sequence[int] = (0, 0),
    distance: float | torch.Tensor = 0.0,
    power: float | torch.Tensor = 1.0,
    offset: collections.abc.Sequence[float] = (0.0, 0.0),
    *,
    device: torch.device | str | None = None,
) -> torch.Tensor:
    """Return a Hermite–Gauss mode at a distance from its waist."""
    ...

def laguerre_gaussian_beam(
    shape: collections.abc.Sequence[int],
    dx: float | collections.abc.Sequence[float],
    wavelength: float | torch.Tensor,
    waist: float | torch.Tensor,
    radial: int = 0,
    azimuthal: int = 0,
    distance: float | torch.Tensor = 0.0,
    power: float | torch.Tensor = 1.0,
    offset: collections.abc.Sequence[float] = (0.0, 0.0),
    *,
    device: torch.device | str | None = None,
) -> torch.Tensor:
    """Return a Laguerre–Gauss mode, which carries an optical vortex, at a distance from its waist."""
    ...

def lens_phase(
    shape: collections.abc.Sequence[int],
    focal: float | torch.Tensor,
    dx: float | collections.abc.Sequence[float],
    wavelength: float | torch.Tensor,
    offset: collections.abc.Sequence[float] = (0.0, 0.0),
    *,
    device: torch.device | str | None = None,
) -> torch.Tensor:
    """Return the phase of a thin lens, −π·r²/(λf), on the field's own grid (optical axis at index n // 2)."""
    ...

def linear_grating(
    nx: int,
    ny: int,
    every: int = 2,
    add: float | None = None,
    axis: str = 'x',
) -> torch.Tensor:
    """Return a binary grating, of lines or as a checkerboard."""
    ...

def metalens_phase(
    shape: collections.abc.Sequence[int],
    focal: float | torch.Tensor,
    dx: float | collections.abc.Sequence[float],
    wavelength: float | torch.Tensor,
    offset: collections.abc.Sequence[float] = (0.0, 0.0),
    *,
    device: torch.device | str | None = None,
) -> torch.Tensor:
    """Return the phase that focuses a plane wave without spherical aberration, −k(√(r² + f²) − |f|), f > 0."""
    ...

def mode_overlap(
    field: torch.Tensor,
    mode: torch.Tensor,
) -> torch.Tensor:
    """Return the share of the power of a field that is in a mode, |∑ mode*·field|²/(∑|mode|²·∑|field|²)."""
    ...

def power_in_bucket(
    field: torch.Tensor,
    dx: float | collections.abc.Sequence[float],
    radius: float | torch.Tensor,
    offset: collections.abc.Sequence[float] = (0.0, 0.0),
) -> torch.Tensor:
    """Return the share of the power of a field that lies within a circle."""
    ...

def prism_grating(
    nx: int,
    ny: int,
    k: float,
    angle: float,
    dx: float | collections.abc.Sequence[float] = 0.001,
    axis: str = 'x',
    phase_offset: float = 0.0,
) -> torch.Tensor:
    """Return a blazed prism exp(−i(k·sin(angle)·x + offset)), counted from the first sample."""
    ...

def prism_phase_function(
    nx: int,
    ny: int,
    k: float,
    angle: float,
    dx: float | collections.abc.Sequence[float] = 0.001,
    axis: str = 'x',
) -> torch.Tensor:
    """Return the transmission of a thin prism, exp(−ik·sin(angle)·x)."""
    ...

def pupil_function(
    shape: collections.abc.Sequence[int],
    dx: float | collections.abc.Sequence[float],
    wavelength: float,
    numerical_aperture: float | torch.Tensor,
    aberrations: collections.abc.Mapping[typing.Any, typing.Any] | None = None,
    obscuration: float | torch.Tensor = 0.0,
    *,
    device: torch.device | str | None = None,
    dtype: torch.dtype | None = None,
) -> torch.Tensor:
    """Return the pupil of a lens, on the frequencies of the image that it forms."""
    ...

def q_plate(
    shape: collections.abc.Sequence[int],
    charge: float,
    retardance: float | torch.Tensor = 180.0,
    angle: float = 0.0,
    *,
    device: torch.device | str | None = None,
) -> torch.Tensor:
    """Return the Jones matrices of a q-plate: a retarder whose fast axis rotates with the azimuth."""
    ...

def quadratic_phase_function(
    nx: int,
    ny: int,
    k: float,
    focal: float = 0.4,
    dx: float | collections.abc.Sequence[float] = 0.001,
    offset: collections.abc.Sequence[float] = (0, 0),
) -> torch.Tensor:
    """Return the transmission of a thin lens, exp(−ik·r²/(2f)), converging for a positive focal length."""
    ...

def rectangular_aperture(
    shape: collections.abc.Sequence[int],
    dx: float | collections.abc.Sequence[float],
    size: collections.abc.Sequence[typing.Any],
    offset: collections.abc.Sequence[float] = (0.0, 0.0),
    *,
    device: torch.device | str | None = None,
) -> torch.Tensor:
    """Return the transmission of a rectangle, with the pixels of its edges weighted by the area inside."""
    ...

def reference_wave(
    shape: collections.abc.Sequence[int],
    dx: float | collections.abc.Sequence[float],
    wavelength: float | torch.Tensor,
    angles: collections.abc.Sequence[float] | torch.Tensor = (0.0, 0.0),
    amplitude: float | torch.Tensor = 1.0,
    *,
    device: torch.device | str | None = None,
    dtype: torch.dtype | None = None,
) -> torch.Tensor:
    """Return a plane wave on a camera, the reference of a recorded hologram."""
    ...

def spiral_phase(
    shape: collections.abc.Sequence[int],
    charge: float | torch.Tensor,
    dx: float | collections.abc.Sequence[float] = 1.0,
    offset: collections.abc.Sequence[float] = (0.0, 0.0),
    *,
    device: torch.device | str | None = None,
) -> torch.Tensor:
    """Return the phase of a spiral plate, charge times the azimuth."""
    ...

def thin_film_transfer(
    shape: collections.abc.Sequence[int],
    dx: float | collections.abc.Sequence[float],
    wavelength: float,
    indices: collections.abc.Sequence[typing.Any],
    thicknesses: collections.abc.Sequence[typing.Any],
    *,
    reflect: bool = False,
    device: torch.device | str | None = None,
) -> torch.Tensor:
    """Return the transfer function of a stack of thin films for the transverse components of a polarised field."""
    ...

def zernike_basis(
    nx: int,
    ny: int,
    modes: collections.abc.Iterable[typing.Any],
    radius: float | torch.Tensor | None = None,
    dx: float | torch.Tensor = 1.0,
    offset: collections.abc.Sequence[float] = (0.0, 0.0),
    *,
    device: torch.device | str | None = None,
) -> torch.Tensor:
    """Return Zernike polynomials of root mean square 1, for sums that are taken again and again."""
    ...

def zernike_phase(
    nx: int,
    ny: int,
    coefficients: collections.abc.Mapping[typing.Any, typing.Any],
    radius: float | torch.Tensor | None = None,
    dx: float | collections.abc.Sequence[float] | torch.Tensor = 1.0,
    offset: collections.abc.Sequence[float] = (0.0, 0.0),
    *,
    device: torch.device | str | None = None,
) -> torch.Tensor:
    """Return the aberration Σ c·Z as a phase, each Z a Zernike polynomial of root mean square 1 over the disc."""
    ...
