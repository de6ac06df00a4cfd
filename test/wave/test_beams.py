"""Beams against their propagation, their power, their orthogonality and published formulas."""

import math
import re
import warnings

import numpy as np
import physics
import pytest
import torch

import odak
from odak import SamplingWarning
from odak.wave import (
    airy_beam,
    beam_quality,
    beam_width,
    bessel_beam,
    circular_aperture,
    fibre_coupling,
    flat_top_beam,
    gaussian_beam,
    hermite_gaussian_beam,
    laguerre_gaussian_beam,
    mode_overlap,
    power_in_bucket,
    propagate_beam,
)

SHAPE, PITCH, WAVELENGTH, WAIST = (256, 240), 4e-6, 532e-9, 80e-6


def test_gaussian_beam_equals_the_closed_form():
    for distance in (0.0, 0.03, -0.02):
        expected = physics.gaussian_beam(SHAPE, PITCH, WAIST, distance, WAVELENGTH) * np.sqrt(2 / np.pi) / WAIST
        found = gaussian_beam(SHAPE, PITCH, WAVELENGTH, WAIST, distance)
        assert physics.relative_error(found, expected) < 1e-9


@pytest.mark.parametrize(
    ("mode", "pitches"),
    [
        (lambda z, dx: hermite_gaussian_beam(SHAPE, dx, WAVELENGTH, WAIST, (2, 3), z), (PITCH, PITCH)),
        (lambda z, dx: hermite_gaussian_beam(SHAPE, dx, WAVELENGTH, (60e-6, WAIST), (1, 0), z), (PITCH, 5e-6)),
        (lambda z, dx: laguerre_gaussian_beam(SHAPE, dx, WAVELENGTH, WAIST, 2, -3, z), (5e-6, PITCH)),
        (lambda z, dx: laguerre_gaussian_beam(SHAPE, dx, WAVELENGTH, WAIST, 1, 2, z, 1.0, (4e-5, -2e-5)), (PITCH,) * 2),
    ],
    ids=["Hermite", "elliptic", "Laguerre", "shifted"],
)
def test_modes_propagate_into_themselves(mode, pitches):
    """The paraxial modes against Fresnel's transfer function, on rectangular pixels too."""
    start, end = mode(0.0, pitches), mode(6e-3, pitches)
    fy, fx = np.fft.fftfreq(SHAPE[0], pitches[0])[:, None], np.fft.fftfreq(SHAPE[1], pitches[1])
    transfer = np.exp(2j * np.pi * 6e-3 / WAVELENGTH - 1j * np.pi * WAVELENGTH * 6e-3 * (fy**2 + fx**2))
    assert physics.relative_error(np.fft.ifft2(np.fft.fft2(start) * transfer), end) < 1e-7
    assert (abs(start) ** 2).sum() * pitches[0] * pitches[1] == pytest.approx(1, abs=1e-9)


def test_modes_are_orthonormal_and_of_the_power_asked_for():
    modes = [hermite_gaussian_beam(SHAPE, PITCH, WAVELENGTH, WAIST, (m, n), 5e-3) for m in range(3) for n in range(3)]
    gram = np.einsum("irc,jrc->ij", np.conj(modes), modes) * PITCH**2
    np.testing.assert_allclose(gram, np.eye(9), atol=1e-12)
    modes = [
        laguerre_gaussian_beam(SHAPE, PITCH, WAVELENGTH, WAIST, p, charge, 5e-3)
        for p in (0, 1)
        for charge in (-2, 0, 2)
    ]
    gram = np.einsum("irc,jrc->ij", np.conj(modes), modes) * PITCH**2
    np.testing.assert_allclose(gram, np.eye(6), atol=1e-12)
    bright = hermite_gaussian_beam(SHAPE, PITCH, WAVELENGTH, WAIST, (20, 0), power=3.0)
    assert (abs(bright) ** 2).sum() * PITCH**2 == pytest.approx(3.0)


def test_laguerre_modes_are_sums_of_hermite_modes():
    """LG(0, ±1) = (HG along x ± i·HG along y)/√2."""
    along_x, along_y = (
        hermite_gaussian_beam(SHAPE, PITCH, WAVELENGTH, WAIST, order, 4e-3) for order in ((0, 1), (1, 0))
    )
    for charge in (1, -1):
        found = laguerre_gaussian_beam(SHAPE, PITCH, WAVELENGTH, WAIST, 0, charge, 4e-3)
        assert physics.relative_error(found, (along_x + charge * 1j * along_y) / 2**0.5) < 1e-12


def test_a_bessel_beam_keeps_its_profile():
    """On a window that a whole number of cone waves would fit, the spectrum lies on one ring: k_z is one number."""
    beam = bessel_beam((512, 512), PITCH, WAVELENGTH, 0.6, 2, waist=400e-6)
    after = propagate_beam(beam, None, 4e-3, PITCH, WAVELENGTH, "Angular Spectrum")
    phase = np.exp(2j * np.pi / WAVELENGTH * np.cos(np.deg2rad(0.6)) * 4e-3)
    centre = (slice(246, 267), slice(246, 267))
    assert physics.relative_error(after[centre], beam[centre] * phase) < 0.02
    spectrum = np.abs(np.fft.fft2(bessel_beam((512, 512), PITCH, WAVELENGTH, 0.6)))
    f = np.hypot(*np.meshgrid(np.fft.fftfreq(512, PITCH), np.fft.fftfreq(512, PITCH)))
    peak = f.flat[spectrum.argmax()]
    assert peak == pytest.approx(np.sin(np.deg2rad(0.6)) / WAVELENGTH, abs=1 / (512 * PITCH))


def test_an_airy_beam_follows_its_parabola():
    scale, distance = 40e-6, 0.05
    start = airy_beam((512, 512), PITCH, scale, 0.1)
    after = propagate_beam(start, None, distance, PITCH, WAVELENGTH, "Bandlimited Angular Spectrum")
    k = 2 * np.pi / WAVELENGTH
    expected = distance**2 / (4 * k**2 * scale**3) / PITCH
    peaks = [np.unravel_index(np.abs(u).argmax(), u.shape) for u in (start, after)]
    assert np.subtract(peaks[1], peaks[0]) == pytest.approx([expected, expected], abs=1.0)


@pytest.mark.parametrize("order", [1, 3.5, 20])
def test_a_flat_top_has_its_power(order):
    beam = flat_top_beam((400, 400), PITCH, 300e-6, order, power=2.0)
    assert (abs(beam) ** 2).sum() * PITCH**2 == pytest.approx(2.0, rel=1e-4)


def test_gradients_and_faces():
    numbers = [torch.tensor(v, dtype=torch.float64, requires_grad=True) for v in (0.5, 3.0, 2.0, 1.5)]
    makers = (
        lambda wavelength, waist, z, power: hermite_gaussian_beam((6, 5), 1.0, wavelength, waist, (1, 2), z, power),
        lambda wavelength, waist, z, power: laguerre_gaussian_beam((6, 5), 1.0, wavelength, waist, 1, -2, z, power),
        lambda order, waist, z, power: flat_top_beam((6, 5), 1.0, waist, order + 2, power),
        lambda wavelength, waist, z, angle: bessel_beam((5, 4), z / 2, wavelength, angle, 0, waist),
        lambda wavelength, waist, z, angle: bessel_beam((5, 4), z / 2, wavelength, angle * 9, -2, waist, (z, 0.3)),
        lambda scale, other, z, decay: airy_beam((5, 4), 1.0, (scale + 1, -other), decay, (z, 0.3)),
    )
    for make in makers:
        assert torch.autograd.gradcheck(make, numbers, fast_mode=True)
        expected = make(*(v.item() for v in numbers))
        np.testing.assert_allclose(make(*numbers).detach().numpy(), expected, atol=1e-13)


def test_lengths_of_bessel_and_airy_beams_may_be_tensors():
    lengths = [torch.tensor(value, dtype=torch.float64) for value in (2.0, 1.5, 0.5)]
    expected = airy_beam((6, 5), (1.0, 1.5), 2.0, 0.1, (0.5, 0.0))
    np.testing.assert_allclose(airy_beam((6, 5), (1.0, lengths[1]), lengths[0], 0.1, (lengths[2], 0.0)), expected)
    expected = bessel_beam((6, 5), (1.0, 1.5), 0.5, 2.0, 1, offset=(0.5, 0.0))
    found = bessel_beam((6, 5), (1.0, lengths[1]), lengths[2], lengths[0], 1, offset=(lengths[2], 0.0))
    np.testing.assert_allclose(found, expected)


BEAMS = {
    "gaussian_beam": lambda waist, **more: gaussian_beam((96, 97), 8e-6, WAVELENGTH, waist, **more),
    "hermite_gaussian_beam": lambda waist: hermite_gaussian_beam((96, 97), 8e-6, WAVELENGTH, waist, (1, 4)),
    "laguerre_gaussian_beam": lambda waist: laguerre_gaussian_beam((96, 96), 8e-6, WAVELENGTH, waist, 1, 2),
    "flat_top_beam": lambda waist: flat_top_beam((96, 97), 8e-6, waist),
}


@pytest.mark.parametrize("name", BEAMS)
def test_wide_beams_state_the_power_on_the_grid(name):
    """The share stated is the sum over the samples; in the window that is said to do 99 % are found."""
    waist = {"gaussian_beam": 5e-4, "flat_top_beam": 4.5e-4}.get(name, 2.5e-4)
    with pytest.warns(SamplingWarning, match=f"{name}: the grid holds") as caught:
        beam = BEAMS[name](waist)
    (text,) = [str(one.message) for one in caught]
    power = (abs(beam) ** 2).sum() * 64e-12
    assert float(text.split()[4]) == pytest.approx(power, rel=0.02)
    side = float(text.split()[-4])
    smaller = BEAMS[name](waist * 96 * 8e-6 / side)
    assert (abs(smaller) ** 2).sum() * 64e-12 > 0.99


@pytest.mark.parametrize("name", BEAMS)
def test_narrow_beams_are_beyond_nyquist(name):
    with pytest.warns(SamplingWarning, match=f"{name} is .* times beyond Nyquist") as caught:
        BEAMS[name](2e-6)
    text = str(caught[0].message)
    assert float(text.split()[2]) > 3
    with warnings.catch_warnings():
        warnings.simplefilter("error", SamplingWarning)
        BEAMS[name](float(re.search(r"waist of at least (\S+)", text).group(1)))


def test_a_spherical_wave_is_sampled_by_its_part_on_the_grid():
    """Far from a waist of 1 µm, the window holds a little of the power, with frequencies below Nyquist's."""
    with pytest.warns(SamplingWarning) as caught:
        gaussian_beam((96, 97), 8e-6, WAVELENGTH, 1e-6, distance=0.05)
    assert ["the grid holds" in str(one.message) for one in caught] == [True]


def test_cones_and_tails_beyond_nyquist_are_named():
    with pytest.warns(SamplingWarning, match="bessel_beam is 1.57 times beyond Nyquist"):
        bessel_beam((64, 64), 8e-6, WAVELENGTH, 3.0)
    with pytest.warns(SamplingWarning, match="airy_beam is .* times beyond Nyquist"):
        airy_beam((64, 64), 8e-6, 6e-6)
    with warnings.catch_warnings():
        warnings.simplefilter("error", SamplingWarning)
        airy_beam((64, 64), 8e-6, 40e-6)
        bessel_beam((64, 64), 8e-6, WAVELENGTH, 1.8)


def test_widths_and_quality_of_modes():
    """Widths 2w·√(2n + 1) and M² = 2n + 1 of Hermite–Gauss modes at any distance; Siegman, Lasers (1986), 17.5."""
    distance, waist = 0.03, 6e-5
    width = waist * np.hypot(1, distance * WAVELENGTH / (np.pi * waist**2))
    beam = hermite_gaussian_beam(SHAPE, PITCH, WAVELENGTH, waist, (1, 3), distance, offset=(2e-5, -4e-5))
    np.testing.assert_allclose(beam_width(beam, PITCH), 2 * width * np.sqrt([3, 7]), rtol=1e-6)
    np.testing.assert_allclose(beam_quality(beam, PITCH), [3, 7], rtol=1e-6)
    # Incoherent with itself at another place: the beam is wider, its band is not.
    both = np.stack([beam, gaussian_beam(SHAPE, PITCH, WAVELENGTH, waist, distance)])
    np.testing.assert_allclose(beam_width(both, PITCH)[1], [2 * width] * 2, rtol=1e-6)
    np.testing.assert_allclose(beam_width(both[1], PITCH, "knife-edge"), [2 * width] * 2, rtol=3e-3)
    tensor = torch.as_tensor(both)
    np.testing.assert_allclose(odak.learn.wave.beam_quality(tensor, PITCH), beam_quality(both, PITCH), rtol=1e-9)
    round_light = flat_top_beam(SHAPE, PITCH, 3e-4, 60.0)
    mean = 2 ** (-1 / 60) * math.gamma(2 / 60) / math.gamma(1 / 60)
    np.testing.assert_allclose(beam_width(round_light, PITCH), [4 * 3e-4 * np.sqrt(mean / 2)] * 2, rtol=1e-3)


def test_power_and_overlap_in_closed_forms():
    """1 − exp(−2r²/w²) within a circle; overlaps of Gaussian beams; 81.45 % of a disc into a Gaussian mode."""
    beam = gaussian_beam(SHAPE, PITCH, WAVELENGTH, WAIST, 0.0, 3.0, (4e-5, -2e-5))
    assert power_in_bucket(beam, PITCH, 1e-4, (4e-5, -2e-5)) == pytest.approx(
        1 - np.exp(-2 * (1e-4 / WAIST) ** 2), 1e-3
    )
    assert fibre_coupling(beam, PITCH, WAIST, (4e-5, -2e-5)) == pytest.approx(1, rel=1e-9)
    # Shifted by s and tilted by a: exp(−s²/w²)·exp(−(πaw/λ)²).
    tilt = 2 * np.pi / WAVELENGTH * 1e-3 * (np.arange(SHAPE[1]) - SHAPE[1] // 2) * PITCH
    expected = np.exp(-((3e-5 / WAIST) ** 2) - (np.pi * 1e-3 * WAIST / WAVELENGTH) ** 2)
    found = fibre_coupling(beam * np.exp(1j * tilt), PITCH, WAIST, (7e-5, -2e-5))
    assert found == pytest.approx(expected, rel=1e-9)
    mode = gaussian_beam(SHAPE, PITCH, WAVELENGTH, WAIST, 0.0, 1.0, (7e-5, -2e-5))
    assert mode_overlap(beam * np.exp(1j * tilt), mode) == pytest.approx(expected, rel=1e-9)
    vortex = laguerre_gaussian_beam(SHAPE, PITCH, WAVELENGTH, WAIST, 0, 1, offset=(4e-5, -2e-5))
    assert mode_overlap(np.stack([beam, vortex]), vortex).tolist() == pytest.approx([0, 1], abs=1e-9)
    disc = (circular_aperture((256, 256), 1.0, 60.0) > 0.5) + 0j
    assert fibre_coupling(disc, 1.0, 60 / 1.1209) == pytest.approx(0.8145, abs=1e-3)


def test_measures_have_gradients():
    field = torch.as_tensor(gaussian_beam((24, 20), PITCH, WAVELENGTH, 1.5e-5)).requires_grad_()
    radius = torch.tensor(1.4e-5, dtype=torch.float64, requires_grad=True)

    def measures(field, radius):
        bucket = power_in_bucket(field, PITCH, radius)[None] * 1e-5
        into = fibre_coupling(field, PITCH, radius)[None] * 1e-5
        widths = (beam_width(field, PITCH), beam_width(field, PITCH, "knife-edge"), beam_quality(field, PITCH) * 1e-5)
        return torch.cat([bucket, into, *widths]) * 1e5

    value = measures(field, radius).sum()
    slopes = torch.autograd.grad(value, (field, radius))
    step = torch.randn(24, 20, dtype=torch.complex128, generator=torch.manual_seed(1)) * 1e-3
    with torch.no_grad():
        change = measures(field + step, radius).sum() - measures(field - step, radius).sum()
        moved = measures(field, radius + 1e-10).sum() - measures(field, radius - 1e-10).sum()
    assert float(change) == pytest.approx(2 * float((slopes[0].conj() * step).sum().real), rel=1e-4)
    assert float(moved) == pytest.approx(2e-10 * float(slopes[1]), rel=3e-3)
