"""Every propagation method against closed forms and conservation laws."""

import numpy as np
import pytest
import torch
from physics import (
    centroid,
    circular_aperture_on_axis,
    coordinates,
    disc,
    gaussian_beam,
    relative_error,
    wrapped_phasor,
)

import odak
import odak.learn.wave

WAVELENGTH, DX = 532e-9, 8e-6
PADDED = (True, False, True)
TRANSFER = ["Angular Spectrum", "Bandlimited Angular Spectrum", "Transfer Function Fresnel"]
STRETCHED = ["Bandextended Angular Spectrum", "Adaptive Sampling Angular Spectrum"]
EVEN, ODD, WAIST = (288, 288), (285, 287), 2.2e-4
RESPONSE = ["Impulse Response Fresnel", "Seperable Impulse Response Fresnel", "Rayleigh-Sommerfeld"]


def beam_cases():
    for distance in (5e-3, 5e-2, 0.2):
        methods = TRANSFER + STRETCHED + (RESPONSE if distance > 0.1 else [])
        for method in methods:
            for shape in {5e-3: [EVEN], 5e-2: [EVEN, ODD], 0.2: [ODD]}[distance]:
                yield pytest.param(method, distance, shape, id=f"{method}-{distance}-{shape[0]}")


@pytest.mark.parametrize(("method", "distance", "shape"), list(beam_cases()))
def test_gaussian_beam_in_amplitude_phase_and_place(method, distance, shape):
    start = gaussian_beam(shape, DX, WAIST, 0.0, WAVELENGTH).astype(np.complex64)
    expected = gaussian_beam(shape, DX, WAIST, distance, WAVELENGTH)
    result = odak.wave.propagate_beam(start, None, distance, DX, WAVELENGTH, method, zero_padding=PADDED)
    assert result.dtype == np.complex64
    assert relative_error(result, expected) < 1e-6
    assert max(map(abs, centroid(np.abs(result.astype(np.complex128)) ** 2, DX))) < 1e-3 * DX


@pytest.mark.parametrize("method", TRANSFER + STRETCHED)
def test_gaussian_beam_in_double_precision(method):
    shape, distance = (384, 387), 0.05
    start = gaussian_beam(shape, DX, 3e-4, 0.0, WAVELENGTH)
    result = odak.wave.propagate_beam(start, None, distance, DX, WAVELENGTH, method, zero_padding=PADDED)
    # What is left is the beam's own paraxial error, λ-order terms of k·z·θ⁴/8.
    assert relative_error(result, gaussian_beam(shape, DX, 3e-4, distance, WAVELENGTH)) < 2e-8


@pytest.mark.parametrize("method", ["Adaptive Sampling Angular Spectrum", "Bandextended Angular Spectrum", "auto"])
def test_gaussian_beam_far_beyond_the_critical_distance(method):
    shape, distance = (336, 336), 0.5625
    start = gaussian_beam(shape, DX, 3e-4, 0.0, WAVELENGTH)
    expected = gaussian_beam(shape, DX, 3e-4, distance, WAVELENGTH)
    result = odak.wave.propagate_beam(start, None, distance, DX, WAVELENGTH, method, zero_padding=PADDED)
    assert relative_error(result, expected) < 1e-6


@pytest.mark.parametrize("method", TRANSFER)
def test_plane_wave_gains_its_phase_over_20_cm(method):
    field = np.ones((64, 65), dtype=np.complex64)
    result = odak.wave.propagate_beam(field, None, 0.2, DX, WAVELENGTH, method)
    assert np.abs(result / wrapped_phasor(0.2, WAVELENGTH) - 1).max() < 1e-6


def test_tilted_plane_wave_gains_phase_of_its_axial_wave_number():
    n, order = 128, 9
    y, x = coordinates((n, n), DX)
    frequency = order / (n * DX)
    field = np.exp(2j * np.pi * frequency * (x + 0 * y))
    axial = np.sqrt(1 / WAVELENGTH**2 - frequency**2)
    result = odak.wave.angular_spectrum(field, None, 0.2, DX, WAVELENGTH)
    np.testing.assert_allclose(result / field, np.exp(2j * np.pi * (0.2 * axial % 1)), atol=1e-9)


@pytest.mark.parametrize("method", ["Angular Spectrum", "Rayleigh-Sommerfeld"])
def test_circular_aperture_on_axis(method):
    shape, dx, radius, distance = (384, 384), 2e-6, 0.15e-3, 0.02
    aperture = disc(shape, dx, radius).astype(np.complex128)
    result = odak.wave.propagate_beam(aperture, None, distance, dx, WAVELENGTH, method, zero_padding=PADDED)
    expected = circular_aperture_on_axis(radius, distance, WAVELENGTH)
    # Each of the two waves, through the hole and from its rim, has an amplitude of about 1.
    assert abs(result[192, 192] - expected) < 0.01


def test_fraunhofer_of_a_rectangle():
    shape, half = (100, 121), (6, 9)
    y, x = (np.arange(n) - n // 2 for n in shape)
    rectangle = ((np.abs(y) <= half[0])[:, None] & (np.abs(x) <= half[1])).astype(np.complex128)
    distance = 10.0
    result = odak.wave.fraunhofer(rectangle, None, distance, DX, WAVELENGTH)
    pattern = np.ones(shape)
    for axis, (n, h, position) in enumerate(zip(shape, half, (y, x), strict=True)):
        angle = np.pi * position / n
        count = 2 * h + 1
        kernel = np.where(position == 0, count, np.sin(count * angle) / np.where(position == 0, 1, np.sin(angle)))
        pattern = pattern * np.expand_dims(kernel, 1 - axis)
    pitch = [WAVELENGTH * distance / (n * DX) for n in shape]
    radius_squared = ((y * pitch[0]) ** 2)[:, None] + (x * pitch[1]) ** 2
    expected = pattern * DX**2 / (1j * WAVELENGTH * distance)
    expected = (
        expected * wrapped_phasor(distance, WAVELENGTH) * wrapped_phasor(radius_squared / (2 * distance), WAVELENGTH)
    )
    assert relative_error(result, expected) < 1e-10


def test_fraunhofer_in_front_and_behind_is_the_sum_written_out(random):
    shape, pitch, distances = (5, 6), (8e-6, 6e-6), np.array([0.2, -0.2, -0.3])
    field = random.normal(size=shape) + 1j * random.normal(size=shape)
    batch = np.broadcast_to(field, (3, *shape))
    pattern = odak.wave.fraunhofer(batch, None, distances, pitch, WAVELENGTH)
    tensors = odak.learn.wave.fraunhofer(torch.tensor(batch), None, torch.tensor(distances), pitch, WAVELENGTH)
    for k, z in enumerate(distances):
        axes = []
        for n, step in zip(shape, pitch, strict=True):
            x = (np.arange(n) - n // 2) * step
            far = (np.arange(n) - n // 2) * WAVELENGTH * abs(z) / (n * step)
            wave = np.exp(1j * np.pi / (WAVELENGTH * z) * (far[:, None] ** 2 - 2 * far[:, None] * x)) * step
            axes.append(wave)
        expected = np.exp(2j * np.pi * (z / WAVELENGTH % 1)) / (1j * WAVELENGTH * z) * axes[0] @ field @ axes[1].T
        np.testing.assert_allclose(pattern[k], expected, rtol=1e-7)
        alone = odak.wave.fraunhofer(field, None, z, pitch, WAVELENGTH)
        np.testing.assert_allclose(alone, expected, rtol=1e-7)
        np.testing.assert_allclose(odak.wave.fraunhofer_inverse(alone, None, z, pitch, WAVELENGTH), field, rtol=1e-12)
    np.testing.assert_allclose(tensors.numpy(), pattern, rtol=1e-12)


def test_fraunhofer_inverse_is_exact_and_equal_size_keeps_width(random):
    field = random.normal(size=(40, 51)) + 1j * random.normal(size=(40, 51))
    pattern = odak.wave.fraunhofer(field, None, 0.1, DX, WAVELENGTH)
    np.testing.assert_allclose(odak.wave.fraunhofer_inverse(pattern, None, 0.1, DX, WAVELENGTH), field, atol=1e-12)
    pattern = odak.wave.fraunhofer(np.ones((512, 400), complex), None, 0.2, DX, WAVELENGTH)
    ratio = [n * DX**2 / (WAVELENGTH * 0.2) for n in (512, 400)]
    cut = odak.wave.fraunhofer_equal_size_adjust(pattern, 0.2, DX, WAVELENGTH)
    assert cut.shape == (int(ratio[0] * 512), int(ratio[1] * 400))
    assert cut[cut.shape[0] // 2, cut.shape[1] // 2] == pattern[256, 200]
    with pytest.raises(ValueError, match="distance"):
        odak.wave.fraunhofer_equal_size_adjust(pattern, 1e-3, DX, WAVELENGTH)


def test_talbot_images():
    n, period = 256, 16
    bars = np.repeat(((np.arange(n) - n // 2) % period < 5).astype(complex)[None], n, axis=0)
    length = period * DX
    carrier = lambda z: wrapped_phasor(z, WAVELENGTH)  # noqa: E731
    talbot = 2 * length**2 / WAVELENGTH
    whole = odak.wave.transfer_function_fresnel(bars, None, talbot, DX, WAVELENGTH) / carrier(talbot)
    half = odak.wave.transfer_function_fresnel(bars, None, talbot / 2, DX, WAVELENGTH) / carrier(talbot / 2)
    np.testing.assert_allclose(whole, bars, atol=1e-8)
    np.testing.assert_allclose(half, np.roll(bars, period // 2, axis=1), atol=1e-8)


@pytest.mark.parametrize("method", TRANSFER)
def test_forth_and_back_is_the_identity(method, random):
    field = random.normal(size=(64, 63)) + 1j * random.normal(size=(64, 63))
    there = odak.wave.propagate_beam(field, None, 2e-3, DX, WAVELENGTH, method)
    back = odak.wave.propagate_beam(there, None, -2e-3, DX, WAVELENGTH, method)
    assert relative_error(back, field) < 1e-10


@pytest.mark.parametrize("method", ["Angular Spectrum", "Transfer Function Fresnel"])
@pytest.mark.parametrize("shape", [(32, 48), (33, 47)])
def test_energy_is_conserved(method, shape, random):
    field = random.normal(size=shape) + 1j * random.normal(size=shape)
    result = odak.wave.propagate_beam(field, None, 0.01, DX, WAVELENGTH, method)
    assert np.sum(np.abs(result) ** 2) == pytest.approx(np.sum(np.abs(field) ** 2), rel=1e-12)


@pytest.mark.parametrize("method", ["Angular Spectrum", "Transfer Function Fresnel"])
def test_two_steps_make_one(method, random):
    field = random.normal(size=(31, 40)) + 1j * random.normal(size=(31, 40))
    step = lambda u, z: odak.wave.propagate_beam(u, None, z, DX, WAVELENGTH, method)  # noqa: E731
    np.testing.assert_allclose(step(step(field, 1e-3), 2.5e-3), step(field, 3.5e-3), atol=1e-9)


def test_evanescent_waves_decay_both_ways():
    n, dx = 64, 0.1e-6
    _, x = coordinates((n, n), dx)
    frequency = 20 / (n * dx)
    field = np.exp(2j * np.pi * frequency * x) * np.ones((n, 1))
    expected = np.exp(-2 * np.pi * 0.1e-6 * np.sqrt(frequency**2 - 1 / WAVELENGTH**2))
    for distance in (0.1e-6, -0.1e-6):
        result = odak.wave.angular_spectrum(field, None, distance, dx, WAVELENGTH)
        np.testing.assert_allclose(np.abs(result), expected, rtol=1e-9)


@pytest.mark.parametrize("distance", [0.02, -0.02])
@pytest.mark.parametrize("shape", [(20, 27), (16, 16)])
def test_rayleigh_sommerfeld_is_the_direct_sum(distance, shape, random):
    field = random.normal(size=shape) + 1j * random.normal(size=shape)
    result = odak.wave.rayleigh_sommerfeld(field, None, distance, DX, WAVELENGTH)
    y, x = coordinates(shape, DX)
    expected = np.zeros(shape, complex)
    for i in range(shape[0]):
        for j in range(shape[1]):
            r = np.sqrt((y - y[i, 0]) ** 2 + (x - x[0, j]) ** 2 + distance**2)
            kernel = (
                abs(distance) / (2 * np.pi * r**2) * (1 / r - 2j * np.pi / WAVELENGTH) * wrapped_phasor(r, WAVELENGTH)
            )
            expected += field[i, j] * (kernel if distance > 0 else kernel.conj()) * DX**2
    assert relative_error(result, expected) < 1e-10
    assert relative_error(odak.wave.rayleigh_sommerfeld_sum(field, None, distance, DX, WAVELENGTH), expected) < 1e-10


@pytest.mark.slow
def test_stretched_methods_agree_with_direct_sum_in_far_range():
    shape, distance = (48, 56), 0.05
    field = gaussian_beam(shape, DX, 6e-5, 0.0, WAVELENGTH) * np.exp(1j * np.pi * 5e3 * coordinates(shape, DX)[1])
    expected = odak.wave.rayleigh_sommerfeld_sum(field, None, distance, DX, WAVELENGTH)
    # The band that the method keeps, ½·sqrt(2N/(λz)), is what limits it.
    result = odak.wave.adaptive_sampling_angular_spectrum(field, None, distance, DX, WAVELENGTH)
    assert relative_error(result, expected) < 1e-4
    wrapped = odak.wave.angular_spectrum(field, None, distance, DX, WAVELENGTH)
    assert relative_error(wrapped, expected) > 0.1


def test_incoherent_light_keeps_its_energy_and_spreads():
    intensity = np.zeros((64, 64))
    intensity[32, 32] = 1.0
    result = odak.wave.incoherent_angular_spectrum(intensity, None, 2e-3, DX, WAVELENGTH)
    assert result.dtype == np.float64
    assert result.sum() == pytest.approx(1.0, rel=1e-10)
    point = odak.wave.angular_spectrum(intensity + 0j, None, 2e-3, DX, WAVELENGTH)
    np.testing.assert_allclose(result, np.abs(point) ** 2, atol=1e-12)


def test_lens_focuses_a_plane_wave_to_the_airy_pattern():
    shape, focal, radius = (512, 512), 0.1, 0.8e-3
    lens = odak.wave.lens_phase(shape, focal, DX, WAVELENGTH)
    field = disc(shape, DX, radius) * np.exp(1j * lens)
    focus = np.abs(odak.wave.propagate_beam(field, None, focal, DX, WAVELENGTH, "AS", zero_padding=PADDED)) ** 2
    # Born and Wolf 1999, section 8.5.2: the peak is (area/(λf))², the first dark ring at 0.61·λ·f/radius.
    assert focus[256, 256] == pytest.approx((np.pi * radius**2 / (WAVELENGTH * focal)) ** 2, rel=0.01)
    dark = 0.61 * WAVELENGTH * focal / radius / DX
    assert np.argmin(focus[256, 256:270]) == round(dark)
    diverging = np.abs(odak.wave.propagate_beam(field.conj(), None, focal, DX, WAVELENGTH, "AS", zero_padding=PADDED))
    assert diverging[256, 256] ** 2 < focus[256, 256] / 100


@pytest.mark.parametrize("shape", [(256, 192), (255, 191)])
def test_band_limit_keeps_what_is_sampled_without_aliasing(shape):
    distance = 0.1
    kernel = odak.wave.get_propagation_kernel(*shape, DX, WAVELENGTH, distance, "BLAS", dtype=np.complex128)
    frequencies = [np.fft.fftshift(np.fft.fftfreq(n, DX)) for n in shape]
    inside = np.ones(shape, bool)
    for axis, (n, frequency) in enumerate(zip(shape, frequencies, strict=True)):
        # The limit is where the kernel's phase turns by π between two samples of a grid of pitch 1/(n·dx):
        # d(2πz·sqrt(1/λ² − f²))/df·Δf = π (Matsushima and Shimobaba 2009, eq. 9).
        slope = 2 * distance * np.abs(frequency) / np.sqrt(1 / WAVELENGTH**2 - frequency**2) / (n * DX)
        inside &= np.expand_dims(slope < 1, 1 - axis)
    assert 0.05 < inside.mean() < 0.5
    # One half at the limit, along each axis by itself: a sample beside it may fall on either side.
    axial = [np.abs(kernel)[:, shape[1] // 2], np.abs(kernel)[shape[0] // 2]]
    for axis, values in enumerate(axial):
        expected = inside[:, shape[1] // 2] if axis == 0 else inside[shape[0] // 2]
        assert np.abs((values > 0.5).sum() - expected.sum()) <= 2
        place = distance * WAVELENGTH * np.abs(frequencies[axis])
        far = np.abs(place - shape[axis] * DX / 2) > 5 * np.sqrt(WAVELENGTH * distance / (2 * np.pi))
        np.testing.assert_allclose(values[far], expected[far], atol=1e-5)


def direct_sum(field, dx, distance, wavelength):
    """Return the first Rayleigh–Sommerfeld sum in extended precision (Goodman 2005, eq. 3-40)."""
    extended = np.longdouble
    rows, columns = field.shape
    y, x = (np.arange(n, dtype=extended) * extended(dx) for n in field.shape)
    result = np.zeros(field.shape, np.clongdouble)
    k = 2 * extended(np.pi) / extended(wavelength)
    for i in range(rows):
        for j in range(columns):
            r = np.sqrt((y[i] - y[:, None]) ** 2 + (x[j] - x) ** 2 + extended(distance) ** 2)
            cycles = r / extended(wavelength)
            phase = 2 * np.arctan2(extended(0), extended(-1)) * (cycles - np.round(cycles))
            kernel = abs(extended(distance)) / (2 * np.pi * r**2) * (1 / r - 1j * k) * np.exp(1j * phase)
            result[i, j] = (field * (kernel if distance > 0 else kernel.conj())).sum() * extended(dx) ** 2
    return result.astype(complex)


@pytest.mark.skipif(np.finfo(np.longdouble).eps > 1e-18, reason="needs an extended precision")
@pytest.mark.parametrize("distance", [3e-7, 3e-6, -3e-6, 1e-3, -0.3, 10.0])
def test_rayleigh_sommerfeld_is_the_first_integral(distance, random):
    field = random.normal(size=(9, 8)) + 1j * random.normal(size=(9, 8))
    expected = direct_sum(field, 2e-7, distance, 532e-9)
    for function in (odak.wave.rayleigh_sommerfeld, odak.wave.rayleigh_sommerfeld_sum):
        assert relative_error(function(field, None, distance, 2e-7, 532e-9), expected) < 1e-9


def test_each_field_of_the_direct_sum_has_its_own_numbers(random):
    """As many fields as columns: numbers of fields must not meet the columns."""
    field = random.normal(size=(4, 3, 4)) + 1j * random.normal(size=(4, 3, 4))
    given = np.array([[1e-4, 2e-4, 3e-4, -4e-4], [1e-6, 2e-6, 3e-6, 4e-6], [4e-7, 5e-7, 6e-7, 7e-7]])
    for varied in range(3):
        numbers = [given[i] if i == varied else given[i, 0] for i in range(3)]
        result = odak.wave.rayleigh_sommerfeld_sum(field, None, *numbers)
        for i, one in enumerate(field):
            own = [number if number.ndim == 0 else number[i] for number in map(np.asarray, numbers)]
            expected = direct_sum(one, *(float(own[j]) for j in (1, 0, 2)))
            assert relative_error(result[i], expected) < 1e-9
    assert odak.wave.rayleigh_sommerfeld_sum(field.astype(np.complex64), None, *given[:, 0]).dtype == np.complex64


def test_first_integral_agrees_with_plane_waves_near_field():
    dx, wavelength, n = 1e-7, 532e-9, 256
    y, x = coordinates((n, n), dx)
    field = np.exp(-(x**2 + y**2) / (1.5e-6) ** 2).astype(complex)
    for distance in (1e-6, 3e-6):
        waves = odak.wave.propagate_beam(field, None, distance, dx, wavelength, "AS", zero_padding=(True, False, True))
        assert relative_error(odak.wave.rayleigh_sommerfeld(field, None, distance, dx, wavelength), waves) < 2e-4


@pytest.mark.parametrize("dx", [8e-6, 0.2e-6, 0.1e-6])
def test_the_band_limit_leaves_a_field_at_distance_zero_alone(dx, random):
    field = random.normal(size=(16, 15)) + 1j * random.normal(size=(16, 15))
    result = odak.wave.propagate_beam(field, None, 0.0, dx, 532e-9, "Bandlimited Angular Spectrum")
    np.testing.assert_allclose(result, field, atol=1e-13)


@pytest.mark.parametrize("distance", [0.1, 0.3])
def test_the_band_limit_is_exact_for_smooth_beams(distance):
    """Up to five critical distances of the padded grid, 0.06 m; the reference has a grid four times as wide."""
    dx, wavelength, padded = 8e-6, 532e-9, (True, False, True)
    beam = gaussian_beam((256, 256), dx, 120e-6, 0.0, wavelength)
    wide = gaussian_beam((1024, 1024), dx, 120e-6, 0.0, wavelength)
    expected = odak.wave.propagate_beam(wide, None, distance, dx, wavelength, "AS", zero_padding=padded)
    found = odak.wave.propagate_beam(beam, None, distance, dx, wavelength, "BLAS", zero_padding=padded)
    assert relative_error(found, expected[384:640, 384:640]) < 1e-7


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("pitch", [8e-6, 0.3e-6, 0.1e-6])
@pytest.mark.parametrize("padded", [True, False])
def test_the_band_limit_is_the_identity_at_no_distance(pitch, padded, random):
    field = np.exp(2j * np.pi * random.random((16, 21)))
    padding = PADDED if padded else [False, False, False]
    for method in ("Bandlimited Angular Spectrum", "auto"):
        result = odak.wave.propagate_beam(field, None, 0.0, pitch, WAVELENGTH, method, zero_padding=padding)
        np.testing.assert_allclose(result, field, atol=1e-13)
