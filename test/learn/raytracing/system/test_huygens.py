"""Huygens' sum against closed forms and the Fourier transform, and the illumination of the image."""

import math

import numpy as np
import pytest
import torch
from scipy.special import j0

from odak._warnings import AccuracyWarning
from odak.learn.raytracing.system import (
    Operand,
    first_order,
    huygens_point_spread_function,
    load_system,
    modulation_at,
    optical_system,
    point_spread_function,
    relative_illumination,
    surface,
    through_focus_modulation,
)
from odak.learn.raytracing.system.operands import View, values_of
from odak.learn.raytracing.system.waves import _nonuniform_transform
from odak.raytracing.apertures import CircularAperture
from odak.raytracing.interfaces import IdealLens, RadialPhase

F64 = torch.float64


def test_a_perfect_lens_has_the_modulation_of_a_circular_pupil():
    """(2/π)(acos ν − ν√(1 − ν²)), ν the frequency over 2·NA/λ (Goodman 2005, eq. 6-31)."""
    mirror = optical_system(
        [surface(-200.0, conic=-1.0, material="mirror", thickness=-100.0)], 10.0, wavelengths=500e-6
    )
    spread = huygens_point_spread_function(mirror, 64, 128)
    assert float(spread.strehl) == pytest.approx(1, abs=1e-6)
    cutoff = 2 * float(first_order(mirror).numerical_aperture) / 500e-6
    for share in (0.1, 0.35, 0.6, 0.85):
        expected = 2 / math.pi * (math.acos(share) - share * math.sqrt(1 - share**2))
        for axis in ("x", "y"):
            assert float(modulation_at(spread, share * cutoff, axis)) == pytest.approx(expected, abs=1e-3)


def test_an_obscured_pupil_without_aberration_has_a_peak_of_one():
    hole = CircularAperture(radius=3.0, obscures=True)
    items = [surface(-200.0, conic=-1.0, material="mirror", thickness=-100.0, aperture=hole)]
    mirror = optical_system(items, 10.0, wavelengths=500e-6)
    for spread in (huygens_point_spread_function(mirror, 64, 32), point_spread_function(mirror, 64, 128)):
        assert float(spread.strehl) == pytest.approx(1, abs=1e-6)
        # Of the light of a ring, in an image of any width, the peak is λ²/area of the direction cosines.
        area = math.pi * (first_order(mirror).numerical_aperture ** 2) * (1 - 0.6**2)
        assert float(spread.energy * spread.pitch.prod(-1)) == pytest.approx(500e-6**2 / float(area), rel=0.01)


def test_it_agrees_with_the_fourier_transform_where_both_hold():
    triplet = load_system("cooke_triplet")
    triplet.aperture, triplet.fields = 4.0, ((0.0, 0.0), (0.0, 8.0))
    ours, theirs = huygens_point_spread_function(triplet, 48, 96), point_spread_function(triplet, 48, 192)
    torch.testing.assert_close(ours.strehl, theirs.strehl, rtol=0.02, atol=0.0)
    for frequency in (40.0, 90.0):
        both = (modulation_at(spread, frequency) for spread in (ours, theirs))
        torch.testing.assert_close(*both, rtol=0.02, atol=5e-3)


def test_an_ideal_lens_lights_its_image_as_a_disc_does():
    """E ∝ 1 − (d² + h² − a²)/√((d² + h² + a²)² − 4a²h²) of a Lambertian disc at a distance (Walsh 1958)."""
    a, d = 8.0, 30.0
    lens = optical_system([surface(phase=IdealLens(d), thickness=d, stop=True)], 2 * a, fields=[0.0, 15.0, 35.0])
    found = relative_illumination(lens)[0]
    heights = [d * math.tan(math.radians(angle)) for angle in (0.0, 15.0, 35.0)]
    disc = [1 - (d * d + h * h - a * a) / math.sqrt((d * d + h * h + a * a) ** 2 - 4 * a * a * h * h) for h in heights]
    assert found.tolist() == pytest.approx([value / disc[0] for value in disc], rel=1e-9)


def test_a_pupil_that_is_folded_over_itself_counts_once():
    """A phase plate sends rays at the distance r from the axis to the sine g(r) = r/f − r³/q, folded beyond √(q/3f).

    Of an oblique beam from a stop in front, which contains the axis, the covered area is ∮½·g(min(r₂, √(q/3f)))²dφ,
    where r₂(φ) is the rim of the displaced beam; the beam on the axis is not folded.
    """
    wave, radius, far, f, q = 500e-6, 8.0, 10.0, 60.0, 16000.0
    # Radians of r² and r⁴ over a radius of 1: dφ/dr·λ/2π = −g(r).
    cycles = [-math.pi / (wave * f), math.pi / (2 * wave * q)]
    rows = [surface(thickness=far, stop=True), surface(phase=RadialPhase(cycles, 1.0), thickness=f)]
    lens = optical_system(rows, 2 * radius, fields=[0.0, 30.0], wavelengths=wave)
    shift, fold = far * math.tan(math.radians(30.0)), math.sqrt(q / (3 * f))
    turn = torch.linspace(0, 2 * math.pi, 4001, dtype=torch.float64)[:-1]
    rim = shift * turn.cos() + (radius**2 - (shift * turn.sin()) ** 2).sqrt()

    def area(reach):
        return float((reach / f - reach**3 / q).square().mean())

    assert radius < fold < float(rim.max())
    expected = area(rim.clamp(max=fold)) / area(torch.full_like(rim, radius))
    assert float(relative_illumination(lens, 40)[0, 1]) == pytest.approx(expected, rel=4e-3)
    twice = 2 * expected - area(rim) / area(torch.full_like(rim, radius))
    assert twice > 1.02 * expected


def test_vignetting_darkens_and_gradients_pass():
    triplet = load_system("cooke_triplet")
    whole = relative_illumination(triplet, 8, vignetting=False)[1]
    triplet.surfaces[0].semi_diameter = 6.5
    cut = relative_illumination(triplet, 8)[1]
    assert float(whole[0]) == pytest.approx(1, abs=1e-12)
    assert bool((cut[1:] < 0.9 * whole[1:]).all())


def modulation_by_rings(lens, shift, frequency, rays=4000, reach=0.3, places=1200):
    """The modulation on the axis: spheres traced here, plane waves of rings of rays summed by J₀."""
    numbers = lens.prescription().at(lens.reference)
    wanted = (numbers.curvature, numbers.thickness, numbers.index)
    curvature, thickness, index = (value.reshape(-1).tolist() for value in wanted)
    wavelength, thickness[-1] = lens.wavelengths[lens.reference], thickness[-1] + shift
    weight = y = float(first_order(lens).entrance_pupil_diameter) / 2 * (np.arange(rays) + 0.5) / rays
    z = sine = path = np.zeros(rays)
    cosine = np.ones(rays)
    for c, gap, before, behind in zip(curvature, thickness, index, index[1:], strict=False):
        along = cosine - c * (z * cosine + y * sine)
        missing = c * (y * y + z * z) - 2 * z
        step = missing / (along + np.sqrt(along**2 - c * missing))
        y, z, path = y + step * sine, z + step * cosine, path + before * step
        into = cosine * (1 - c * z) - sine * c * y
        ratio = before / behind
        bend = np.sqrt(1 - ratio**2 * (1 - into**2)) - ratio * into
        sine, cosine, z = ratio * sine - bend * c * y, ratio * cosine + bend * (1 - c * z), z - gap
    path, y = path - index[-1] * z / cosine, y - z / cosine * sine
    slope = index[-1] * sine / wavelength
    wave = weight * np.exp(2j * np.pi * (path / wavelength - slope * y))
    radius = np.linspace(0, reach, places)
    light = np.array([abs((wave * j0(2 * np.pi * slope * r)).sum()) ** 2 for r in radius])
    energy = (weight**2 / np.abs(slope * np.gradient(slope))).sum() / (2 * np.pi)
    return np.trapezoid(2 * np.pi * radius * light * j0(2 * np.pi * frequency * radius), radius) / energy


def test_modulation_takes_as_many_rays_as_the_wavefront_needs():
    """At the end of the range of focus and in the image: 32 rays across give 0.42 and 0.29 of 0.133 and 0.131."""
    lens = load_system("double_gauss")
    lens.fields = ((0.0, 0.0),)
    lens.surfaces[-1].thickness += 0.379046  # to the paraxial focus, in which the wavefront is steep
    shifts = [-0.3, 0.0]
    expected = [modulation_by_rings(lens, shift, 20.0) for shift in shifts]
    found = through_focus_modulation(lens, shifts, 20.0)[lens.reference, 0].tolist()
    assert found == pytest.approx(expected, abs=2e-3)
    numbers = lens.prescription().at(lens.reference)
    with pytest.warns(AccuracyWarning, match="64 samples across the pupil do not .* take 184 samples"):
        few = huygens_point_spread_function(lens, 64, prescription=numbers)
    assert float(modulation_at(few, 20.0)[0, 0]) < 0.7 * expected[1]
    enough = huygens_point_spread_function(lens, prescription=numbers)
    assert enough.intensity.shape[-1] == 384
    assert float(modulation_at(enough, 20.0)[0, 0]) == pytest.approx(expected[1], abs=2e-3)
    # A small image is free of the light beside it with fewer rays: it comes out within 1 - w periods only.
    small = huygens_point_spread_function(lens, 104, 32, prescription=numbers)
    middle = enough.intensity[..., 192 - 16 : 192 + 16, 192 - 16 : 192 + 16]
    torch.testing.assert_close(small.intensity, middle, rtol=0.0, atol=1e-3)
    with pytest.warns(AccuracyWarning, match="take 1.. samples"):
        huygens_point_spread_function(lens, 48, 32, prescription=numbers)


def test_the_operand_of_modulation_resolves_the_wavefront():
    lens = load_system("double_gauss")
    lens.fields, operand = ((0.0, 0.0),), Operand("modulation", options={"frequency": 20.0})
    found = values_of(operand, View(lens, lens.prescription()))
    assert float(found[lens.reference]) == pytest.approx(modulation_by_rings(lens, 0.0, 20.0), abs=2e-3)


def test_the_sum_over_rays_is_the_sum():
    """Within 1e-11 of every ray's wave in every pixel, and differentiable."""
    generator = torch.Generator().manual_seed(0)
    values = torch.randn(2, 300, dtype=torch.complex128, generator=generator)
    x, y = torch.rand(2, 2, 300, dtype=F64, generator=generator) * 3 - 1.5
    for size in (2, 9, 40):
        whole = torch.arange(size) - size // 2
        along, down = (torch.exp(2j * math.pi * place[..., None] * whole) for place in (x, y))
        expected = (down * values[..., None]).mT @ along
        found = _nonuniform_transform(values, x, y, size)
        assert float((found - expected).abs().max()) < 1e-11 * float(values.abs().sum(-1).max())
    few = [value[:, :3].clone().requires_grad_() for value in (values, x, y)]
    assert torch.autograd.gradcheck(lambda *given: _nonuniform_transform(*given, 3), few, check_forward_ad=True)
