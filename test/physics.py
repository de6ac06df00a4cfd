"""Closed forms that the tests hold the library against, with their sources."""

import numpy as np


def coordinates(shape, dx):
    """Return y (column vector) and x (row vector), the optical axis at index n // 2."""
    return tuple(
        (np.arange(n) - n // 2).reshape((-1, 1) if axis == 0 else (1, -1)) * dx for axis, n in enumerate(shape)
    )


def wrapped_phasor(length, wavelength):
    """Return exp(ik·length), whole waves taken off first."""
    cycles = np.asarray(length, dtype=np.float64) / wavelength
    return np.exp(2j * np.pi * (cycles - np.round(cycles)))


def gaussian_beam(shape, dx, waist, distance, wavelength):
    """Return the paraxial Gaussian beam of Siegman, Lasers (1986), eq. 16.7: amplitude 1 at the waist's centre."""
    y, x = coordinates(shape, dx)
    rayleigh = np.pi * waist**2 / wavelength
    q = distance - 1j * rayleigh
    carrier = wrapped_phasor(distance, wavelength)
    return -1j * rayleigh / q * carrier * np.exp(1j * np.pi / wavelength * (x**2 + y**2) / q)


def circular_aperture_on_axis(radius, distance, wavelength):
    """Return the first Rayleigh–Sommerfeld field behind a circular hole on its axis, exp(ikz) − (z/R)·exp(ikR).

    Osterberg and Smith, J. Opt. Soc. Am. 51, 1050 (1961).
    """
    edge = np.hypot(distance, radius)
    return wrapped_phasor(distance, wavelength) - distance / edge * wrapped_phasor(edge, wavelength)


def disc(shape, dx, radius, oversampling=16):
    """Return a disc whose rim pixels hold the share of their area that is covered."""
    offsets = (np.arange(oversampling) + 0.5) / oversampling - 0.5
    y, x = coordinates(shape, dx)
    covered = np.zeros(shape)
    for dy in offsets:
        for dx_ in offsets:
            covered += (y + dy * dx) ** 2 + (x + dx_ * dx) ** 2 <= radius**2
    return covered / oversampling**2


def relative_error(result, expected):
    """Return the root-mean-square difference over the root-mean-square of what is expected."""
    result, expected = np.asarray(result), np.asarray(expected)
    return float(np.linalg.norm(result - expected) / np.linalg.norm(expected))


def centroid(intensity, dx):
    """Return the centre of mass of an intensity in metres from the optical axis."""
    y, x = coordinates(intensity.shape, dx)
    return float((y * intensity).sum() / intensity.sum()), float((x * intensity).sum() / intensity.sum())
