"""Bounds on the errors that docs/notes/accuracy.md shows: single precision, and double precision against a beam."""

import math

import numpy as np
import pytest
import torch
from physics import coordinates, gaussian_beam, relative_error, wrapped_phasor

import odak
from odak.learn import wave

WAVELENGTH, DX = 532e-9, 8e-6
METHODS = [name for name in odak.wave.PROPAGATION_TYPES if name != "auto"]
SINGLE, SINGLE_FACTOR = 3e-7, 1e-6
STRETCHED = ("Bandextended Angular Spectrum", "Adaptive Sampling Angular Spectrum")
RESPONSES = ("Impulse Response Fresnel", "Seperable Impulse Response Fresnel", "Rayleigh-Sommerfeld")
FRESNEL = ("Transfer Function Fresnel", "Impulse Response Fresnel", "Seperable Impulse Response Fresnel")
SIDE, PITCH, WAIST = 128, 32e-6, 0.3e-3


def speckle(n, method, dtype):
    random = np.random.default_rng(n)
    if method == "Incoherent Angular Spectrum":
        return random.random((n, n)).astype(dtype)
    return np.exp(2j * np.pi * random.random((n, n))).astype(dtype)


def propagated(face, method, n, z, dtype):
    kernel = odak.wave.get_propagation_kernel(2 * n, 2 * n, DX, WAVELENGTH, z) if method == "custom" else None
    field = speckle(n, method, dtype)
    if face == "numpy":
        return odak.wave.propagate_beam(field, None, z, DX, WAVELENGTH, method, kernel, [True, False, True])
    kernel = None if kernel is None else torch.from_numpy(kernel)
    return wave.propagate_beam(torch.from_numpy(field), None, z, DX, WAVELENGTH, method, kernel).numpy()


def lost(face, method, n, z):
    single, double = (propagated(face, method, n, z, dtype) for dtype in (np.complex64, np.complex128))
    assert single.dtype in (np.complex64, np.float32) and double.dtype in (np.complex128, np.float64)
    return relative_error(single, double)


@pytest.mark.parametrize("face", ["numpy", "torch"])
@pytest.mark.parametrize("method", METHODS)
def test_single_precision_loses_no_more_than_its_transforms_do(face, method):
    bound = SINGLE_FACTOR if method in STRETCHED else SINGLE
    assert all(lost(face, method, n, z) < bound for n, z in ((32, 1e-3), (60, 1e-2), (32, 1e-1), (32, 1.0)))


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS)
def test_single_precision_on_a_large_grid(method):
    assert lost("torch", method, 512 if method in STRETCHED else 1024, 0.1) < 10 ** (-125 / 20)


def beam(z):
    return gaussian_beam((SIDE, SIDE), PITCH, WAIST, z, WAVELENGTH)


def far_field(z):
    """Return the Fraunhofer pattern of the beam's waist, the Fourier transform of a Gaussian (Goodman 2005, 2.1)."""
    y, x = coordinates((SIDE, SIDE), WAVELENGTH * z / (SIDE * PITCH))
    squared = x**2 + y**2
    transform = np.pi * WAIST**2 * np.exp(-((np.pi * WAIST / (WAVELENGTH * z)) ** 2) * squared)
    quadratic = np.exp(1j * np.pi / (WAVELENGTH * z) * squared)
    return wrapped_phasor(z, WAVELENGTH) / (1j * WAVELENGTH * z) * quadratic * transform


def start_and_end(method, z):
    if method == "Fraunhofer":
        return beam(0.0), far_field(z)
    return (far_field(z), beam(0.0)) if method == "Fraunhofer Inverse" else (beam(0.0), beam(z))


def cases():
    """Return methods and distances at which they are sampled finely enough."""
    for method in METHODS:
        for z in (1e-3, 1e-2, 1e-1, 1.0):
            aliases = method in RESPONSES and z < 2 * SIDE * PITCH**2 / WAVELENGTH
            if method not in ("custom", "Incoherent Angular Spectrum") and not aliases:
                yield method, z


def paraxial_error(z):
    """Return the error of a paraxial beam: a phase of πzλ³f⁴/4, root mean square over the beam's spectrum."""
    return math.pi / 4 * z * WAVELENGTH**3 * math.sqrt(1.5) / (math.pi * WAIST) ** 4


@pytest.mark.parametrize(("method", "z"), list(cases()))
def test_error_against_the_closed_form(method, z):
    start, end = start_and_end(method, z)
    padded = not method.startswith("Fraunhofer")
    for dtype, rounding in ((np.complex64, 4e-7), (np.complex128, 1e-14)):
        result = odak.wave.propagate_beam(
            start.astype(dtype), None, z, PITCH, WAVELENGTH, method, zero_padding=[padded, False, padded]
        )
        paraxial = 0.0 if method in FRESNEL or not padded else paraxial_error(z)
        assert relative_error(result, end) < rounding + 1.3 * paraxial


@pytest.mark.parametrize("z", [1e-2, 1.0])
def test_angular_spectrum_differs_from_paraxial_as_theory_says(z):
    result = odak.wave.propagate_beam(
        beam(0.0), None, z, PITCH, WAVELENGTH, "Angular Spectrum", zero_padding=[True, False, True]
    )
    assert relative_error(result, beam(z)) == pytest.approx(paraxial_error(z), rel=0.01)
