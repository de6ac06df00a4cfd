"""Thin elements against geometric optics, closed forms and their propagation."""

import math
import re
import warnings
from functools import partial

import numpy as np
import pytest
import torch

import odak
from odak.wave import (
    aspheric_lens_phase,
    axicon_phase,
    beam_width,
    bessel_beam,
    circular_aperture,
    cylindrical_lens_phase,
    dammann_grating,
    fresnel_zone_plate,
    gaussian_beam,
    lens_phase,
    metalens_phase,
    propagate_beam,
    rectangular_aperture,
    spiral_phase,
    zernike_phase,
)

SHAPE, PITCH, WAVELENGTH, FOCAL = (128, 120), 4e-6, 532e-9, 0.05


@pytest.mark.parametrize("offset", [(0.0, 0.0), (1.3, -2.6)])
@pytest.mark.parametrize("radius", [7.3, 20.0])
def test_apertures_have_the_area_of_their_shape(radius, offset):
    assert circular_aperture((64, 60), 1.0, radius, offset).sum() == pytest.approx(math.pi * radius**2, rel=1e-8)
    ring = circular_aperture((64, 60), (0.9, 1.1), radius, offset, radius / 3)
    assert ring.sum() * 0.99 == pytest.approx(math.pi * radius**2 * 8 / 9, rel=1e-8)
    rectangle = rectangular_aperture((64, 60), (0.9, 1.1), (radius, 2 * radius), offset)
    assert rectangle.sum() * 0.99 == pytest.approx(2 * radius**2, rel=1e-12)
    y, x = (np.arange(64) - 32)[:, None] * 0.9, (np.arange(60) - 30) * 1.1
    assert (rectangle * y).sum() * 0.99 == pytest.approx(2 * radius**2 * offset[0], rel=5e-3, abs=1e-9)
    assert (rectangle * x).sum() * 0.99 == pytest.approx(2 * radius**2 * offset[1], rel=5e-3, abs=1e-9)


@pytest.mark.parametrize(("shape", "radius"), [((5, 6), 1.7), ((5, 6), 0.4), ((1, 7), 2.0), ((4, 4), 9.0)])
def test_each_pixel_of_a_disc_counts_by_the_area_inside(shape, radius):
    offset, finer = (0.3, -0.7), 400
    found = circular_aperture(shape, (0.9, 1.2), radius, offset)
    y, x = (
        ((np.arange(n * finer) + 0.5) / finer - 0.5 - n // 2) * step - middle
        for n, step, middle in zip(shape, (0.9, 1.2), offset, strict=True)
    )
    inside = y[:, None] ** 2 + x**2 < radius**2
    expected = inside.reshape(shape[0], finer, shape[1], finer).mean((1, 3))
    np.testing.assert_allclose(found, expected, atol=5e-4)


def test_elements_take_one_number():
    several = np.array([4e-7, 5e-7, 6e-7])
    for call in (
        lambda v: lens_phase((4, 3), 0.1, 8e-6, v),
        lambda v: lens_phase((4, 3), v, 8e-6, 5e-7),
        lambda v: odak.wave.prism_grating(4, 3, v, 1.0, axis="y"),
        lambda v: odak.wave.prism_phase_function(4, 3, 1e7, v),
        lambda v: odak.wave.double_convergence(4, 3, 1e7, v, 8e-6),
        lambda v: odak.wave.quadratic_phase_function(3, 4, v),
    ):
        with pytest.raises(ValueError, match=r"must be one number, got an array of shape \(3,\)"):
            call(several)
        call(several[:1])


def peak(field):
    """Return the indices of the largest amplitude."""
    return tuple(int(i) for i in np.unravel_index(np.abs(field).argmax(), field.shape))


@pytest.mark.parametrize("lens", [lens_phase, metalens_phase])
def test_lenses_focus_where_their_axis_is(lens):
    aperture = circular_aperture(SHAPE, PITCH, 2e-4)
    field = aperture * np.exp(1j * lens(SHAPE, 0.01, PITCH, WAVELENGTH, (8e-6, -20e-6)))
    focus = propagate_beam(field, None, 0.01, PITCH, WAVELENGTH, "Angular Spectrum")
    assert peak(focus) == (66, 55)
    # The focus of an unaberrated disc: the area over λf.
    assert np.abs(focus).max() == pytest.approx(aperture.sum() * PITCH**2 / (WAVELENGTH * 0.01), rel=0.02)


def test_lens_phases_agree_where_they_should():
    paraxial = lens_phase(SHAPE, FOCAL, PITCH, WAVELENGTH)
    np.testing.assert_allclose(metalens_phase(SHAPE, FOCAL, PITCH, WAVELENGTH), paraxial, rtol=1e-4, atol=1e-9)
    np.testing.assert_allclose(metalens_phase(SHAPE, -FOCAL, PITCH, WAVELENGTH), -paraxial, rtol=1e-4, atol=1e-9)
    crossed = sum(cylindrical_lens_phase(SHAPE, FOCAL, PITCH, WAVELENGTH, angle) for angle in (25.0, 115.0))
    np.testing.assert_allclose(crossed, paraxial, atol=1e-9)
    parabola = aspheric_lens_phase(SHAPE, PITCH, WAVELENGTH, FOCAL / 2, 1.5, -1.0)
    np.testing.assert_allclose(parabola, paraxial, rtol=1e-12, atol=1e-9)
    y, x = (np.arange(n)[:, None] - n // 2 if axis == 0 else np.arange(n) - n // 2 for axis, n in enumerate(SHAPE))
    r = np.hypot(y, x) * PITCH
    sphere = -2 * np.pi / WAVELENGTH * 0.5 * (1e-2 - np.sqrt(1e-4 - r**2) + 3e4 * r**4 - 2e9 * r**6)
    found = aspheric_lens_phase(SHAPE, PITCH, WAVELENGTH, 1e-2, 1.5, 0.0, (3e4, -2e9))
    np.testing.assert_allclose(found, sphere, atol=1e-6)
    assert np.isnan(aspheric_lens_phase(SHAPE, PITCH, WAVELENGTH, 2e-4)[0, 0])


def test_an_axicon_makes_a_bessel_beam():
    """The central lobe behind an axicon has the first zero of J0 at the radius that the cone's angle gives."""
    shape, pitch = (512, 512), 2e-6
    sine = 0.5 * math.tan(math.radians(1.0))
    illumination = np.exp(-((np.hypot(*np.mgrid[-256:256, -256:256]) * pitch / 3e-4) ** 2))
    field = illumination * np.exp(1j * axicon_phase(shape, pitch, WAVELENGTH, 1.0))
    after = propagate_beam(field, None, 0.015, pitch, WAVELENGTH, "Bandlimited Angular Spectrum")
    profile = np.abs(after[256, 256:]) ** 2
    zero = 2.404826 / (2 * math.pi / WAVELENGTH * sine) / pitch
    assert peak(after) == (256, 256)
    assert int(profile[: int(1.5 * zero)].argmin()) == pytest.approx(zero, abs=1)


@pytest.mark.parametrize("charge", [1, -3])
def test_a_spiral_plate_has_its_charge(charge):
    phase = spiral_phase((64, 64), charge)
    turn = np.linspace(0, 6.28, 90)
    ring = phase[32 + np.rint(20 * np.sin(turn)).astype(int), 32 + np.rint(20 * np.cos(turn)).astype(int)]
    assert np.unwrap(ring)[-1] - ring[0] == pytest.approx(2 * math.pi * charge, rel=0.05)


@pytest.mark.parametrize(("kind", "efficiency"), [("amplitude", 1 / math.pi**2), ("phase", 4 / math.pi**2)])
def test_a_zone_plate_has_its_efficiency(kind, efficiency):
    shape, pitch, focal = (512, 512), 1e-6, 2e-3
    aperture = circular_aperture(shape, pitch, 240e-6)
    plate = fresnel_zone_plate(shape, focal, pitch, WAVELENGTH, kind)
    focus = propagate_beam(aperture * plate, None, focal, pitch, WAVELENGTH, "Bandlimited Angular Spectrum")
    ideal = aperture * np.exp(1j * metalens_phase(shape, focal, pitch, WAVELENGTH))
    reference = propagate_beam(ideal, None, focal, pitch, WAVELENGTH, "Bandlimited Angular Spectrum")
    assert peak(focus) == (256, 256)
    found = np.abs(focus[256, 256]) ** 2 / np.abs(reference[256, 256]) ** 2
    assert found == pytest.approx(efficiency, rel=0.03)
    with pytest.warns(odak.SamplingWarning, match="narrower than a pixel"):
        fresnel_zone_plate(shape, 1e-4, pitch, WAVELENGTH, kind)


@pytest.mark.parametrize(
    ("orders", "efficiency"), [(3, 0.664), (5, 0.774), (7, 0.786), (9, 0.725), (11, 0.740), (15, 0.816)]
)
def test_dammann_gratings_split_equally(orders, efficiency):
    count = 16384
    phase = dammann_grating((1, count), count * 1.0, 1.0, (1, orders))
    power = np.abs(np.fft.fft(np.exp(1j * phase[0])) / count) ** 2
    wanted = np.take(power, range(-(orders // 2), orders // 2 + 1), mode="wrap")
    assert wanted.max() / wanted.min() < 1.01
    assert wanted.sum() == pytest.approx(efficiency, abs=2e-3)
    with pytest.raises(ValueError, match="orders must be 1, 3, 5"):
        dammann_grating((1, 64), 64.0, 1.0, (1, 4))


def test_gradients_and_faces():
    numbers = [torch.tensor(v, dtype=torch.float64, requires_grad=True) for v in (0.5, 7.0, 12.0)]
    makers = (
        lambda w, f, a: cylindrical_lens_phase((5, 6), f, 1.0, w, a, (0.2, 0.1)),
        lambda w, f, a: metalens_phase((5, 6), f, 1.0, w),
        lambda w, f, a: axicon_phase((5, 6), 1.0, w, a, f / 5),
        lambda w, f, a: aspheric_lens_phase((5, 6), 1.0, w, f, 1.4, a / 100, (a / 1e4,)),
        lambda w, f, a: circular_aperture((5, 6), 1.0, f / 3.1, (0.1, 0.2), w),
        lambda w, f, a: rectangular_aperture((5, 6), 1.0, (f / 3.1, a / 5)),
        lambda w, f, a: spiral_phase((5, 6), f),
    )
    for make in makers:
        assert torch.autograd.gradcheck(make, numbers, fast_mode=True)
        expected = make(*(v.item() for v in numbers))
        np.testing.assert_allclose(make(*numbers).detach().numpy(), expected, atol=1e-12)


@pytest.mark.parametrize("pixels", [2.5, 3.5, 5.5])
def test_slope_of_a_disc_is_its_circumference_at_pixel_edges(pixels):
    # The next number above: the slopes of the parts of the area next to the rim are almost infinite.
    radius = torch.tensor(math.nextafter(pixels * 1.1, 10.0), dtype=torch.float64, requires_grad=True)
    (slope,) = torch.autograd.grad(circular_aperture((13, 12), 1.1, radius).sum() * 1.1**2, radius)
    assert float(slope) == pytest.approx(2 * math.pi * pixels * 1.1, rel=1e-7)


N, DX = 128, 8e-6
STEEP = {
    "lens_phase": (lambda f: lens_phase((N, N), f, DX, WAVELENGTH, (1e-4, 0.0)), 5e-3),
    "metalens_phase": (lambda f: metalens_phase((N, N), f, DX, WAVELENGTH), -2e-3),
    "cylindrical_lens_phase": (lambda f: cylindrical_lens_phase((N, N + 1), f, (DX, 9e-6), WAVELENGTH, 30.0), 5e-3),
    "aspheric_lens_phase": (lambda r: aspheric_lens_phase((N, N), DX, WAVELENGTH, r, 1.5, -0.6), 2e-3),
    "axicon_phase": (lambda a: axicon_phase((N, N), DX, WAVELENGTH, a), 8.0),
    "zernike_phase": (lambda c: odak.wave.zernike_phase(N, N, {(4, 0): 60 * c, (3, -1): 2 * c}, 60.0), 1.0),
}


def warned(call, *arguments):
    """Return the result of a call and the texts of its SamplingWarnings."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        result = call(*arguments)
    return result, [str(one.message) for one in caught if one.category is odak.SamplingWarning]


@pytest.mark.parametrize("name", STEEP)
def test_steep_elements_name_the_factor_beyond_nyquist(name):
    """The factor is the largest difference of neighbouring samples over π; what is said to do does."""
    element, number = STEEP[name]
    phase, texts = warned(element, number)
    phase = np.where(phase == 0, np.nan, phase) if name == "zernike_phase" else phase
    steepest = max(np.nanmax(np.abs(np.diff(phase, axis=axis))) for axis in (0, 1)) / math.pi
    (text,) = texts
    assert text.startswith(f"{name} is ")
    assert float(text.split()[2]) == pytest.approx(steepest, rel=0.03)
    least = re.search(r"(?:length|curvature|angle|coefficients) of at (?:least|most) (\S+)", text)
    better = math.copysign(float(least.group(1)), number)
    assert not warned(element, better)[1]
    assert warned(element, better * (0.98 if "at least" in least.group(0) else 1.05))[1]


@pytest.mark.parametrize(
    "call",
    [
        lambda of: of.prism_phase_function(64, 64, of.wavenumber(WAVELENGTH), 3.0, DX),
        lambda of: of.prism_grating(64, 64, of.wavenumber(WAVELENGTH), 3.0, DX),
        lambda of: of.quadratic_phase_function(N, N, of.wavenumber(WAVELENGTH), 5e-3, DX),
        lambda of: of.double_convergence(N, N, of.wavenumber(WAVELENGTH), 5e-3, DX),
        lambda of: of.lens_phase((N, N), 5e-3, DX, WAVELENGTH),
        lambda of: of.ThinLens(5e-3).apply(np.ones((N, N), complex), DX, WAVELENGTH),
        lambda of: of.spot_hologram(np.array([[2e-3, 0.0, 0.05]]), (64, 64), WAVELENGTH, DX, 1),
    ],
)
def test_both_faces_say_the_same_of_undersampling(call):
    (first,), (second,) = (warned(call, face)[1] for face in (odak.wave, odak.learn.wave))
    assert first == second
    assert "times beyond Nyquist" in first


def test_numbers_that_require_gradients_are_not_read():
    focal = torch.tensor(5e-3, dtype=torch.float64, requires_grad=True)
    phase, texts = warned(odak.learn.wave.lens_phase, (N, N), focal, DX, WAVELENGTH)
    assert phase.requires_grad
    assert not texts


def test_ring_without_an_area_is_named(as_array):
    with pytest.raises(ValueError, match="inner_radius must be at most the radius 1e-05, got 2e-05"):
        circular_aperture((8, 8), 8e-6, as_array(np.asarray(1e-5)), inner_radius=2e-5)
    assert abs(circular_aperture((8, 8), 8e-6, 1e-5, inner_radius=1e-5)).max() < 1e-12


@pytest.mark.parametrize("element", [odak.wave.lens_phase, odak.wave.fresnel_zone_plate])
@pytest.mark.parametrize("place", [1, 3])
def test_lengths_of_a_lens_may_be_arrays(element, place, as_array):
    lengths = [(16, 20), 0.5, 8e-6, WAVELENGTH]
    expected = element(*lengths)
    lengths[place] = as_array(np.asarray(lengths[place]))
    found = element(*lengths)
    assert type(found) is type(lengths[place])
    np.testing.assert_allclose(np.asarray(found), expected, rtol=1e-12)


@pytest.mark.parametrize("library", [np.asarray, partial(torch.tensor, dtype=torch.float64)])
def test_pitch_and_position_may_be_arrays_of_any_library(library):
    """A pitch that a measurement holds is a number to an element of another library."""
    shape, pitch, place = (6, 7), 8e-6, (1e-6, 2e-6)
    calls = {
        "lens": lambda dx, at: lens_phase(shape, 0.1, dx, 532e-9, at),
        "disc": lambda dx, at: circular_aperture(shape, dx, 2e-5, at),
        "Bessel": lambda dx, at: bessel_beam(shape, dx, 532e-9, 0.1, offset=at),
        "Zernike": lambda dx, at: zernike_phase(*shape, {(1, 1): 0.5}, 3e-5, dx, at),
        "width": lambda dx, _: beam_width(gaussian_beam((64, 64), 8e-6, 532e-9, 6e-5), dx),
    }
    for name, call in calls.items():
        found, expected = call(library(pitch), library(place)), call(pitch, place)
        assert isinstance(found, np.ndarray), name
        np.testing.assert_allclose(found, expected, rtol=1e-12, err_msg=name)
    # A gradient that another library could not hold is said to be lost.
    with pytest.warns(odak.AccuracyWarning, match="dx requires a gradient, which is lost here"):
        lens_phase(shape, 0.1, torch.tensor(pitch, dtype=torch.float64, requires_grad=True), 532e-9)
