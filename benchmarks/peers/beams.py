"""Gaussian beams that every library propagates. NumPy only: each library runs in a separate environment."""

from dataclasses import dataclass

import numpy

WAVELENGTH = 532e-9


@dataclass(frozen=True)
class Beam:
    """A Gaussian beam from its waist to a distance, on a square grid whose sample `size // 2` lies on the axis."""

    size: int
    pitch: float
    waist: float
    distance: float

    def squared_radius(self) -> numpy.ndarray:
        """Return x² + y² of the samples."""
        axis = (numpy.arange(self.size) - self.size // 2) * self.pitch
        return axis[:, None] ** 2 + axis[None] ** 2

    def start(self) -> numpy.ndarray:
        """Return the field at the waist."""
        return numpy.exp(-self.squared_radius() / self.waist**2).astype(complex)

    def on_axis_slope(self) -> float:
        """Return d(intensity on the axis)/d(distance) of the paraxial closed form, 1 / (1 + (z / zR)²)."""
        rayleigh = numpy.pi * self.waist**2 / WAVELENGTH
        return -2 * self.distance / rayleigh**2 / (1 + (self.distance / rayleigh) ** 2) ** 2


# One of the size at which libraries are timed, and one that distinguishes exact from paraxial propagation.
TIMED = Beam(1024, 8e-6, 0.4e-3, 0.2)
TIGHT = Beam(256, 1e-6, 3e-6, 4e-4)


def truth(beam: Beam) -> numpy.ndarray:
    """Return the field of a beam at its distance: its plane waves, summed by a quadrature over the radial frequency κ.

    E(r, z) = (w² / 2) ∫ exp(-w²κ² / 4) J₀(κr) exp(iz√(k² - κ²)) κ dκ, with nothing paraxial in it.
    """
    from scipy.special import j0

    k = 2 * numpy.pi / WAVELENGTH
    largest = min(k, 13 / beam.waist)
    nodes, weights = numpy.polynomial.legendre.leggauss(2000)
    kappa, weights = largest * (nodes + 1) / 2, weights * largest / 2
    spectrum = beam.waist**2 / 2 * numpy.exp(-((beam.waist * kappa) ** 2) / 4) * kappa * weights
    spectrum = spectrum * numpy.exp(1j * beam.distance * numpy.sqrt(k**2 - kappa**2))
    radii, place = numpy.unique(beam.squared_radius(), return_inverse=True)
    rows = numpy.array_split(numpy.sqrt(radii)[:, None], 64)
    return numpy.concatenate([j0(kappa * row) @ spectrum for row in rows])[place.reshape(beam.size, beam.size)]


def error(field, expected: numpy.ndarray) -> float:
    """Return the relative error of a field; a constant phase and the sign of time are the library's own choice."""
    field = numpy.asarray(field).astype(complex)
    return min(_distance(one, expected) for one in (field, numpy.conj(field)))


def _distance(field, expected):
    overlap = numpy.vdot(field, expected)
    return float(numpy.linalg.norm(field * overlap / abs(overlap) - expected) / numpy.linalg.norm(expected))
