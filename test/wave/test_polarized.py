"""Polarised fields: Jones elements per pixel, films, div E = 0, and focusing after Richards and Wolf."""

import warnings

import numpy as np
import pytest
import torch
from scipy.integrate import quad
from scipy.special import jv

import odak
from odak import SamplingWarning
from odak.jones import circular_polarizer, polarizer, retarder, thin_film_stack
from odak.wave import (
    apply_jones,
    birefringent_plate,
    filter_polarized,
    focus_polarized,
    laguerre_gaussian_beam,
    longitudinal_field,
    phase_modulator,
    propagate_beam,
    q_plate,
    stokes_parameters,
    thin_film_transfer,
)

WAVELENGTH, PITCH = 532e-9, 4e-7


@pytest.fixture
def field():
    generator = np.random.default_rng(0)
    return generator.normal(size=(2, 12, 10)) + 1j * generator.normal(size=(2, 12, 10))


def test_one_matrix_and_a_matrix_for_each_pixel(field):
    angles = np.linspace(0, 180, 120).reshape(12, 10)
    found = apply_jones(retarder(70.0, angles), field)
    for row, column in ((0, 0), (3, 7), (11, 9)):
        expected = retarder(70.0, angles[row, column]) @ field[:, row, column]
        np.testing.assert_allclose(found[:, row, column], expected, atol=1e-14)
    np.testing.assert_allclose(apply_jones(polarizer(0.0), field)[1], 0, atol=1e-16)
    with pytest.raises(ValueError, match="matrix must be"):
        apply_jones(np.ones((5, 2, 2)), field)


def test_a_modulator_delays_its_own_axis_only(field):
    phase = np.linspace(0, 6, 120).reshape(12, 10)
    modulated = apply_jones(phase_modulator(phase, 90.0), field)
    np.testing.assert_allclose(modulated[0], field[0], atol=1e-14)
    np.testing.assert_allclose(modulated[1], field[1] * np.exp(1j * phase), atol=1e-14)


def test_a_birefringent_plate_is_a_retarder_with_a_common_phase():
    plate = birefringent_plate(WAVELENGTH, 20e-6, 1.5443, 1.5534, 30.0)
    # The fast axis of a positive crystal is across the optic axis.
    retardance = 360 * (1.5534 - 1.5443) * 20e-6 / WAVELENGTH
    common = np.exp(1j * np.pi * (1.5534 + 1.5443) * 20e-6 / WAVELENGTH)
    np.testing.assert_allclose(plate, common * retarder(retardance, 120.0), atol=1e-10)


@pytest.mark.parametrize("charge", [0.5, 1, -1.5])
def test_a_q_plate_turns_circular_polarization_into_a_vortex(charge):
    right = np.ones((2, 32, 32), dtype=complex) * np.array([1, -1j]).reshape(2, 1, 1) / 2**0.5
    found = apply_jones(q_plate((32, 32), charge), right)
    left = np.array([1, 1j]) / 2**0.5
    amplitude = np.einsum("i,irc->rc", left.conj(), found)
    y, x = np.mgrid[-16:16, -16:16]
    azimuth = np.arctan2(y, x)
    ring = np.hypot(x, y) > 0
    expected = np.exp(-2j * charge * azimuth)
    ratio = amplitude[ring] / expected[ring]
    np.testing.assert_allclose(np.abs(amplitude), 1, atol=1e-12)
    np.testing.assert_allclose(ratio, ratio[0], atol=1e-12)


def test_all_methods_propagate_both_components_alike(field):
    found = propagate_beam(field, None, 1e-5, PITCH, WAVELENGTH, "Angular Spectrum")
    for component in (0, 1):
        alone = propagate_beam(field[component], None, 1e-5, PITCH, WAVELENGTH, "Angular Spectrum")
        np.testing.assert_allclose(found[component], alone, atol=1e-14)


def test_stokes_parameters_of_each_pixel(field):
    found = stokes_parameters(field)
    assert found.shape == (4, 12, 10)
    np.testing.assert_allclose(found[0], (np.abs(field) ** 2).sum(axis=0), atol=1e-14)
    np.testing.assert_allclose(found[:, 4, 5], odak.jones.stokes(field[:, 4, 5]), atol=1e-14)
    right = apply_jones(circular_polarizer("right"), field)
    np.testing.assert_allclose(stokes_parameters(right)[3], stokes_parameters(right)[0], atol=1e-13)


@pytest.mark.parametrize(("row", "column"), [(0, 0), (0, 3), (2, 0), (3, -2), (-4, 1)])
@pytest.mark.parametrize("reflect", [False, True])
def test_films_act_on_each_plane_wave_at_its_own_angle(row, column, reflect):
    shape, indices, thicknesses = (12, 10), [1.0, 2.0, 1.45], [90e-9]
    transfer = thin_film_transfer(shape, PITCH, WAVELENGTH, indices, thicknesses, reflect=reflect)
    fy, fx = row / (12 * PITCH), column / (10 * PITCH)
    sine = np.hypot(fy, fx) * WAVELENGTH
    angle = np.rad2deg(np.arcsin(sine))
    s, p = (thin_film_stack(WAVELENGTH, indices, thicknesses, angle, which) for which in "sp")
    along = np.array([fx, fy]) / np.hypot(fx, fy) if sine else np.array([1.0, 0.0])
    across = np.array([-along[1], along[0]])
    # The transverse part of a p-polarised wave of amplitude 1 is cosθ along the radius, in either medium.
    cosine, behind = np.sqrt(1 - sine**2), np.sqrt(1 - (sine / 1.45) ** 2)
    if reflect:
        expected = s.r * np.outer(across, across) - p.r * np.outer(along, along)
    else:
        expected = s.t * np.outer(across, across) + p.t * behind / cosine * np.outer(along, along)
    np.testing.assert_allclose(transfer[:, :, row, column], expected, atol=1e-14)
    wave = np.exp(2j * np.pi * (np.arange(12)[:, None] * row / 12 + np.arange(10) * column / 10))
    incident = np.array([0.3, 0.8j])
    found = filter_polarized(incident[:, None, None] * wave, transfer)
    np.testing.assert_allclose(found, (expected @ incident)[:, None, None] * wave, atol=1e-13)


def test_films_keep_the_energy_of_a_field(field):
    transfer, echo = (
        thin_film_transfer((12, 10), 2e-6, WAVELENGTH, [1.0, 2.0, 1.0], [90e-9], reflect=which)
        for which in (False, True)
    )
    through, back = filter_polarized(field, transfer), filter_polarized(field, echo)

    def power(u):
        # Of each plane wave: |E|²·cosθ with E_z from div E = 0.
        fy, fx = np.fft.fftfreq(12, 2e-6)[:, None] * WAVELENGTH, np.fft.fftfreq(10, 2e-6) * WAVELENGTH
        cosine = np.sqrt(1 - fy**2 - fx**2)
        a, b = np.fft.fft2(u)
        return ((abs(a) ** 2 + abs(b) ** 2 + abs((fx * a + fy * b) / cosine) ** 2) * cosine).sum()

    assert power(through) + power(back) == pytest.approx(power(field), rel=1e-12)


def test_the_longitudinal_component_makes_the_divergence_vanish():
    y, x = (np.arange(64)[:, None] - 32) * 1e-7, (np.arange(64) - 32) * 1e-7
    transverse = np.stack([np.exp(-(x**2 + y**2) / 8e-7**2), 0.4j * np.exp(-(x**2 + y**2) / 9e-7**2)])
    below, here, above = (
        propagate_beam(transverse, None, z, 1e-7, WAVELENGTH, "Angular Spectrum") for z in (-1e-10, 0.0, 1e-10)
    )
    e_z = [longitudinal_field(u, 1e-7, WAVELENGTH) for u in (below, above)]
    frequency = 2j * np.pi * np.fft.fftfreq(64, 1e-7)
    divergence = (
        np.fft.ifft(np.fft.fft(here[0], axis=1) * frequency, axis=1)
        + np.fft.ifft(np.fft.fft(here[1], axis=0) * frequency[:, None], axis=0)
        + (e_z[1] - e_z[0]) / 2e-10
    )
    assert np.abs(divergence).max() < 1e-5 * np.abs(frequency).max()


def test_window_that_cuts_the_focus_is_told():
    pupil = np.zeros((2, 200, 200), dtype=complex)
    pupil[0] = 1
    for side, largest in ((81, 0.14), (161, 0.07)):
        whole = focus_polarized(pupil, 8.2e-6, WAVELENGTH, 1e-3, 0.8, (side, side), 40e-9)
        with warnings.catch_warnings(record=True) as told:
            warnings.simplefilter("always")
            found = longitudinal_field(whole[:2], 40e-9, WAVELENGTH)
        error = np.linalg.norm(found - whole[2]) / np.linalg.norm(whole[2])
        assert error < largest
        assert [warning.category for warning in told] == ([SamplingWarning] if error > 0.1 else [])
        if told:
            expected = float(str(told[0].message).partition("error of about ")[2].partition(" %")[0])
            assert expected == pytest.approx(100 * error, rel=0.2)


def diffraction_integrals(aperture, index, radius, z):
    """Return I0, I1, I2 of B. Richards and E. Wolf, Proc. R. Soc. Lond. A 253, 358 (1959), for λ = 1."""
    k, limit = 2 * np.pi * index, np.arcsin(aperture / index)
    kernels = (
        lambda t: np.sin(t) * (1 + np.cos(t)) * jv(0, k * radius * np.sin(t)),
        lambda t: np.sin(t) ** 2 * jv(1, k * radius * np.sin(t)),
        lambda t: np.sin(t) * (1 - np.cos(t)) * jv(2, k * radius * np.sin(t)),
    )
    return [
        quad(lambda t, f=f: np.sqrt(np.cos(t)) * f(t) * np.cos(k * z * np.cos(t)), 0, limit, epsabs=1e-12)[0]
        + 1j * quad(lambda t, f=f: np.sqrt(np.cos(t)) * f(t) * np.sin(k * z * np.cos(t)), 0, limit, epsabs=1e-12)[0]
        for f in kernels
    ]


def x_polarized_pupil(aperture, count=256, focal=1000.0):
    pupil = np.zeros((2, count, count), dtype=complex)
    pupil[0] = 1
    return pupil, {
        "dx": 2 * aperture * focal / (count - 2),
        "wavelength": 1.0,
        "focal": focal,
        "numerical_aperture": aperture,
    }


@pytest.mark.parametrize(("aperture", "index"), [(0.95, 1.0), (1.4, 1.518), (0.5, 1.0)])
@pytest.mark.parametrize("z", [0.0, 0.4])
def test_focus_equals_the_diffraction_integrals(aperture, index, z):
    pupil, geometry = x_polarized_pupil(aperture)
    found = focus_polarized(pupil, shape=(9, 9), target_dx=0.11, distance=z, index=index, **geometry)
    constant = np.pi * index * geometry["focal"] / np.sqrt(index)
    for row, column in ((4, 4), (4, 7), (0, 4), (1, 6)):
        y, x = (row - 4) * 0.11, (column - 4) * 0.11
        radius, azimuth = np.hypot(x, y), np.arctan2(y, x)
        i0, i1, i2 = diffraction_integrals(aperture, index, radius, z)
        expected = constant * np.array(
            [-1j * (i0 + i2 * np.cos(2 * azimuth)), -1j * i2 * np.sin(2 * azimuth), -2 * i1 * np.cos(azimuth)]
        )
        np.testing.assert_allclose(found[:, row, column], expected, atol=3e-4 * abs(constant))


def full_width(profile, step):
    """Return the full width at half maximum of a profile with one main lobe, by linear interpolation."""
    peak = int(np.argmax(profile))
    half = profile[peak] / 2
    right = next(j for j in range(peak, len(profile)) if profile[j] < half)
    left = next(j for j in range(peak, -1, -1) if profile[j] < half)
    right = right - (half - profile[right]) / (profile[right - 1] - profile[right])
    left = left + (half - profile[left]) / (profile[left + 1] - profile[left])
    return (right - left) * step


@pytest.mark.parametrize(
    ("aperture", "index", "expected"),
    [
        (0.95, 1.0, (0.73044, 0.50263, 1.34183, 0.18383)),
        (1.4, 1.518, (0.48026, 0.34432, 0.97990, 0.16485)),
    ],
)
def test_focal_spot_of_high_numerical_apertures(aperture, index, expected):
    pupil, geometry = x_polarized_pupil(aperture)
    geometry["index"] = index
    step = 0.01
    parts = np.abs(focus_polarized(pupil, shape=(151, 151), target_dx=step, **geometry)) ** 2
    plane, e_z = parts.sum(axis=0), parts[2]
    depths = (np.arange(65) - 32) * 0.025
    axis = focus_polarized(pupil, shape=(1, 1), target_dx=step, distance=depths, **geometry)
    along = (np.abs(axis[:, :, 0, 0]) ** 2).sum(axis=1)
    found = (full_width(plane[75], step), full_width(plane[:, 75], step), full_width(along, 0.025))
    np.testing.assert_allclose((*found, e_z.max() / plane.max()), expected, rtol=1e-3)


def test_focus_follows_the_lens_equation_at_low_apertures():
    """A weakly focused x-polarised field has the scalar field of a lens: Fraunhofer's formula."""
    pupil, geometry = x_polarized_pupil(0.01)
    found = focus_polarized(pupil, shape=(33, 33), target_dx=3.0, **geometry)
    radius = np.hypot(*np.mgrid[-16:17, -16:17]) * 3.0 * 2 * np.pi * 0.01
    with np.errstate(invalid="ignore"):
        airy = np.where(radius > 0, 2 * jv(1, radius) / np.where(radius > 0, radius, 1), 1)
    expected = -1j * np.pi * (0.01 * 1000) ** 2 / 1000 * airy
    np.testing.assert_allclose(found[0], expected, atol=2e-4 * np.abs(expected).max())
    assert np.abs(found[1:]).max() < 6e-3 * np.abs(found[0]).max()


def test_gradients_of_the_focus():
    generator = np.random.default_rng(1)
    pupil = torch.tensor(generator.normal(size=(2, 8, 8)) + 1j, dtype=torch.complex128, requires_grad=True)
    numbers = [torch.tensor(v, dtype=torch.float64, requires_grad=True) for v in (1.1, 3.02, 0.71, 0.3, 1.2)]

    def focus(pupil, wavelength, focal, aperture, distance, index):
        return focus_polarized(pupil, 0.7, wavelength, focal, aperture, (3, 4), 0.2, distance, index)

    assert torch.autograd.gradcheck(focus, (pupil, *numbers), fast_mode=True)
    found = focus(pupil, *numbers).detach().numpy()
    expected = focus(pupil.detach().numpy(), *(v.item() for v in numbers))
    np.testing.assert_allclose(found, expected, atol=1e-12)


def test_a_pupil_that_is_cut_or_repeats_warns():
    pupil, geometry = x_polarized_pupil(0.5, count=16)
    with pytest.warns(odak.SamplingWarning, match="half the period"):
        focus_polarized(pupil, shape=(64, 64), target_dx=1.0, **geometry)
    geometry["dx"] /= 2
    with pytest.warns(odak.SamplingWarning, match="not illuminated"):
        focus_polarized(pupil, shape=(4, 4), target_dx=0.1, **geometry)
    with pytest.raises(ValueError, match="below the index"):
        focus_polarized(pupil, 1.0, 1.0, 10.0, 1.0, (4, 4), 0.1)


def test_a_vortex_with_right_polarization_keeps_a_bright_centre():
    """Spin and orbital momentum of opposite sign cancel: E_z of a focused vortex is bright on the axis."""
    beam = laguerre_gaussian_beam((128, 128), 1.0, 1.0, 30.0, 0, 1)
    y_part = {"right": -1j, "left": 1j}
    bright = {}
    for handedness, factor in y_part.items():
        pupil = np.stack([beam, factor * beam]) / 2**0.5
        focus = focus_polarized(pupil, 1.0, 1.0, 64.0, 0.9, (33, 33), 0.05)
        bright[handedness] = abs(focus[2, 16, 16]) ** 2 / (abs(focus[2]) ** 2).max()
    assert bright["right"] > 0.99 and bright["left"] < 1e-20


def test_response_of_films_is_differentiable_in_the_pitch():
    index = torch.tensor(1.0, dtype=torch.float64)

    def response(pitch):
        return thin_film_transfer((4, 5), pitch, 532e-9, [index, 1.5], [])

    # In micrometres: the steps of gradcheck are absolute.
    micrometres = torch.tensor(0.6, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda pitch: response(pitch * 1e-6), micrometres, fast_mode=True)
