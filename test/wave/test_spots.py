"""Spot holograms against propagation to the spots, closed forms and the uniformity of the weighted algorithm."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import odak
from odak.wave import spot_hologram, uniformity, weighted_gerchberg_saxton

WAVELENGTH, DX, FOCAL = 532e-9, 8e-6, 0.1


def far_grid(side, spacing, n, dtype=np.float64):
    """Return the points of a square array whose spots lie `spacing` samples of the far field apart."""
    places = (np.arange(side) - side // 2) * spacing * WAVELENGTH * FOCAL / (n * DX)
    y, x = np.meshgrid(places, places, indexing="ij")
    return np.stack([x.ravel(), y.ravel(), np.zeros(side * side)], -1).astype(dtype)


@pytest.mark.parametrize("spacing", [8, 11])
def test_ten_by_ten_spots_are_even_after_thirty_iterations(spacing):
    hologram, spots = spot_hologram(
        far_grid(10, spacing, 256, np.float32), (256, 256), WAVELENGTH, DX, 30, FOCAL, seed=0
    )
    assert hologram.dtype == spots.dtype == np.complex64
    np.testing.assert_allclose(np.abs(hologram), 1, atol=1e-6)
    share = np.abs(spots) ** 2
    # Measured: 0.996 … 0.998 and 0.91 … 0.92 over six seeds; Di Leonardo et al. (2007) report 0.99 and 0.93.
    assert uniformity(share) > 0.98
    assert 0.88 < share.sum() < 1


def test_weights_are_what_makes_them_even():
    points = far_grid(6, 9, 128)
    plain = spot_hologram(points, (128, 128), WAVELENGTH, DX, 1, FOCAL, seed=0)[1]
    weighted = spot_hologram(points, (128, 128), WAVELENGTH, DX, 30, FOCAL, seed=0)[1]
    free = spot_hologram(points, (128, 128), WAVELENGTH, DX, 30, FOCAL, fixed_phase_after=30, seed=0)[1]
    even = [float(uniformity(np.abs(spots) ** 2)) for spots in (plain, free, weighted)]
    assert even[0] < 0.8 < even[1] < even[2] and even[2] > 0.99


def test_fields_of_the_spots_are_samples_of_the_far_field():
    n = 96
    points = far_grid(3, 7, n)
    hologram, spots = spot_hologram(points, (n, n), WAVELENGTH, DX, 5, FOCAL, seed=1)
    far = np.fft.fftshift(np.fft.fft2(np.fft.ifftshift(hologram))) / n**2
    places = n // 2 + 7 * (np.arange(3) - 1)
    np.testing.assert_allclose(far[np.ix_(places, places)].ravel(), spots, atol=1e-12)


def test_depth_behind_a_lens_is_measured_from_its_focal_plane():
    n, pitch = 128, WAVELENGTH * FOCAL / (128 * DX)
    points = np.asarray([[9 * pitch, -14 * pitch, 6e-3], [-20 * pitch, 5 * pitch, -4e-3]])
    hologram, spots = spot_hologram(points, (n, n), WAVELENGTH, DX, 10, FOCAL, seed=0)
    focal_plane = np.fft.fftshift(np.fft.fft2(np.fft.ifftshift(hologram))) / n**2
    for (x, y, z), spot in zip(points, spots, strict=True):
        plane = odak.wave.propagate_beam(focal_plane, None, z, pitch, WAVELENGTH, "Transfer Function Fresnel")
        place = (n // 2 + round(y / pitch), n // 2 + round(x / pitch))
        # The spectrum of the focal plane is the hologram itself, so that the cyclic transform is exact.
        assert abs(plane[place]) == pytest.approx(abs(spot), rel=1e-9)
        assert np.unravel_index(np.abs(plane).argmax(), plane.shape) == place


def test_spots_in_free_space_are_where_propagation_finds_them():
    n = 96
    points = np.asarray([[10 * DX, -20 * DX, 0.030], [-25 * DX, 8 * DX, 0.036], [0.0, 30 * DX, 0.042]])
    hologram, spots = spot_hologram(points, (n, n), WAVELENGTH, DX, 20, seed=0)
    for (x, y, z), spot in zip(points, spots, strict=True):
        plane = odak.wave.propagate_beam(
            hologram, None, z, DX, WAVELENGTH, "Impulse Response Fresnel", zero_padding=(True, False, True)
        )
        place = (n // 2 + round(y / DX), n // 2 + round(x / DX))
        # |u| = |Σ u·exp(iπr²/λz)|·dx²/(λz), and |spot| = |Σ …|/n².
        assert abs(plane[place]) == pytest.approx(abs(spot) * (n * DX) ** 2 / (WAVELENGTH * z), rel=1e-9)
        assert np.unravel_index(np.abs(plane).argmax(), plane.shape) == place


def test_one_spot_takes_all_the_light_and_is_a_lens():
    hologram, spots = spot_hologram(np.asarray([[3e-5, -5e-5, 0.05]]), (40, 50), WAVELENGTH, DX, 1)
    assert abs(spots[0]) == pytest.approx(1, abs=1e-12)
    lens = np.exp(1j * odak.wave.lens_phase((40, 50), 0.05, DX, WAVELENGTH, offset=(-5e-5, 3e-5)))
    np.testing.assert_allclose(hologram / lens, hologram[0, 0] / lens[0, 0], atol=1e-9)


def test_intensities_asked_for_come_out():
    wanted = np.linspace(1, 4, 9)
    _, spots = spot_hologram(far_grid(3, 9, 64), (64, 64), WAVELENGTH, DX, 40, FOCAL, intensities=wanted, seed=0)
    share = np.abs(spots) ** 2
    np.testing.assert_allclose(share / share.sum(), wanted / wanted.sum(), rtol=5e-3)


def test_uneven_illumination_is_taken_into_account():
    n = 64
    y = (np.arange(n) - n // 2) / 20
    light = np.exp(-(y[:, None] ** 2 + y**2))
    hologram, spots = spot_hologram(far_grid(4, 9, n), (n, n), WAVELENGTH, DX, 40, FOCAL, illumination=light, seed=0)
    far = np.fft.fftshift(np.fft.fft2(np.fft.ifftshift(hologram * light))) / np.sqrt(n**2 * (light**2).sum())
    places = n // 2 + 9 * (np.arange(4) - 2)
    np.testing.assert_allclose(far[np.ix_(places, places)].ravel(), spots, atol=1e-12)
    assert uniformity(np.abs(spots) ** 2) > 0.98


def test_batches_are_what_each_would_be():
    random = np.random.default_rng(0)
    points = random.uniform(-2e-4, 2e-4, (2, 5, 3)) + np.asarray([0, 0, 0.03])
    light = random.uniform(0.5, 1, (2, 20, 24))
    # One iteration of Di Leonardo's loop from known phases, written down spot by spot.
    hologram, spots = spot_hologram(points, (20, 24), WAVELENGTH, DX, 1, illumination=light, seed=3)
    assert hologram.shape == (2, 20, 24) and spots.shape == (2, 5)
    start = 2 * np.pi * np.random.default_rng(3).random((2, 5))
    y, x = (np.arange(20) - 10)[:, None] * DX, (np.arange(24) - 12) * DX
    for frame in range(2):
        lenses = [
            np.exp(-1j * np.pi * ((x - p[0]) ** 2 + (y - p[1]) ** 2) / (WAVELENGTH * p[2]))
            * np.exp(1j * np.pi * (p[0] ** 2 + p[1] ** 2) / (WAVELENGTH * p[2]))
            for p in points[frame]
        ]
        field = sum(np.exp(1j * a) * lens for a, lens in zip(start[frame], lenses, strict=True))
        seen = [(np.conj(lens) * light[frame] * field / abs(field)).sum() for lens in lenses]
        mean = np.mean(np.abs(seen))
        field = sum(mean / abs(v) * v / abs(v) * lens for v, lens in zip(seen, lenses, strict=True))
        np.testing.assert_allclose(hologram[frame], field / abs(field), atol=1e-9)
        share = [(np.conj(lens) * light[frame] * hologram[frame]).sum() for lens in lenses]
        norm = np.sqrt(20 * 24 * (light[frame] ** 2).sum())
        np.testing.assert_allclose(spots[frame], np.asarray(share) / norm, atol=1e-12)


@given(seed=st.integers(0, 10**6), count=st.integers(1, 6))
@settings(max_examples=20)
def test_no_spot_holds_more_light_than_there_is(seed, count):
    points = np.random.default_rng(seed).uniform(-3e-4, 3e-4, (count, 3)) + np.asarray([0, 0, 0.05])
    _, spots = spot_hologram(points, (12, 17), WAVELENGTH, DX, 3, seed=seed)
    assert (np.abs(spots) <= 1 + 1e-12).all()


def test_libraries_agree(as_array, random):
    points = far_grid(3, 5, 32) + np.asarray([0, 0, 1e-3])
    wanted, light = np.linspace(1, 2, 9), random.uniform(0.5, 1, (32, 32))
    options = {"intensities": wanted, "illumination": light}
    expected = spot_hologram(points, (32, 32), WAVELENGTH, DX, 4, FOCAL, seed=0, **options)
    options = {name: as_array(value) for name, value in options.items()}
    result = spot_hologram(as_array(points), (32, 32), WAVELENGTH, DX, 4, FOCAL, seed=0, **options)
    for one, two in zip(result, expected, strict=True):
        np.testing.assert_allclose(np.asarray(one), two, atol=1e-10)
    target, phase = light.copy(), 2 * np.pi * light
    target[10:, :] = 0
    expected = weighted_gerchberg_saxton(target, 4, illumination=light, initial_phase=phase)
    result = weighted_gerchberg_saxton(as_array(target), 4, illumination=as_array(light), initial_phase=as_array(phase))
    for one, two in zip(result, expected, strict=True):
        np.testing.assert_allclose(np.asarray(one), two, atol=1e-10)


def test_far_field_returned_is_the_transform_of_the_hologram(random):
    target, light = random.random((2, 21, 24)), random.random((21, 24))
    hologram, image = weighted_gerchberg_saxton(target, 3, illumination=light, seed=0)
    np.testing.assert_allclose(np.abs(hologram), 1)
    shifted = np.fft.ifftshift(hologram * light, axes=(-2, -1))
    far = np.fft.fftshift(np.fft.fft2(shifted), axes=(-2, -1)) / np.sqrt(21 * 24 * (light**2).sum())
    np.testing.assert_allclose(image, far, atol=1e-12)
    np.testing.assert_allclose((np.abs(image) ** 2).sum((-2, -1)), 1)


def test_an_image_comes_out_with_its_brightness(random):
    target = np.zeros((96, 96))
    target[24:72, 20:76] = random.uniform(0.3, 1.0, (6, 7)).repeat(8, 0).repeat(8, 1)
    inside = target > 0

    def error(hologram_and_image):
        light = np.abs(hologram_and_image[1]) ** 2
        light, wanted = light[inside], target[inside] ** 2
        return np.sqrt(np.mean((light * (light @ wanted) / (light @ light) - wanted) ** 2))

    few, many = (weighted_gerchberg_saxton(target, count, seed=0) for count in (1, 40))
    assert error(many) < 0.05 * error(few)
    assert (np.abs(many[1])[inside] ** 2).sum() > 0.8


def test_spots_on_the_grid_are_even_too():
    target = np.zeros((256, 256))
    target[64:192:16, 64:192:16] = 1
    _, image = weighted_gerchberg_saxton(target, 30, seed=0)
    share = np.abs(image[target > 0]) ** 2
    assert uniformity(share) > 0.98 and share.sum() > 0.88


def test_uniformity():
    assert uniformity(np.asarray([3.0, 1.0, 2.0])) == pytest.approx(1 - 2 / 4)
    assert uniformity(np.asarray([[1.0, 1.0], [0.0, 4.0]])).tolist() == [1.0, 0.0]
    assert uniformity(np.asarray([[1.0, 1.0], [1.0, 3.0]]), axis=0).tolist() == [1.0, 0.5]


@pytest.mark.parametrize(
    ("arguments", "options", "error", "message"),
    [
        ((np.ones((3, 2)), (8, 8), WAVELENGTH, DX), {}, ValueError, r"points must be \[..., N, 3\]"),
        ((np.zeros((3, 3)), (8, 8), WAVELENGTH, DX), {}, ValueError, "z other than 0"),
        ((np.ones((3, 3)), (8, 0), WAVELENGTH, DX), {}, ValueError, r"resolution\[1\] must be at least 1"),
        ((np.ones((3, 3)), (8, 8), WAVELENGTH, DX, 1, 0.0), {}, ValueError, "focal must be finite and not zero"),
        ((np.ones((3, 3)), (8, 8), WAVELENGTH, DX), {"intensities": np.ones(2)}, ValueError, "one for each of 3"),
        ((np.ones((3, 3)), (8, 8), WAVELENGTH, DX), {"intensities": np.zeros(3)}, ValueError, "must be positive"),
        ((np.ones((3, 3)), (8, 8), WAVELENGTH, DX), {"illumination": np.ones(8)}, ValueError, "illumination must be"),
    ],
)
def test_bad_arguments_are_named(arguments, options, error, message):
    with pytest.raises(error, match=message):
        spot_hologram(*arguments, **options)


def test_bad_targets_are_named():
    with pytest.raises(TypeError, match="field must be an array"):
        weighted_gerchberg_saxton([[1.0]], 1)
    with pytest.raises(ValueError, match=r"initial_phase must be .* as field"):
        weighted_gerchberg_saxton(np.ones((4, 4)), 1, initial_phase=np.ones((4, 5)))
    for bad in (0.0, math.nan, math.inf):
        with pytest.raises(ValueError, match="field must be finite and not zero everywhere"):
            weighted_gerchberg_saxton(np.full((4, 4), bad), 1)
    with pytest.raises(TypeError, match="intensities must be an array"):
        uniformity([1.0, 2.0])


def test_a_dark_start_is_left():
    # From a flat phase the far field of a grid of spots is itself a grid: most samples are exactly dark.
    target = np.zeros((32, 32))
    target[8, 8] = target[16, 20] = target[24, 4] = 1.0
    hologram, image = weighted_gerchberg_saxton(target, 20, initial_phase=np.zeros((32, 32)))
    assert np.isfinite(hologram).all() and uniformity(np.abs(image[target > 0]) ** 2) > 0.98


def test_a_start_that_is_not_finite_is_refused(random):
    start = random.random((4, 4))
    start[1, 2] = np.nan
    with pytest.raises(ValueError, match="initial_phase must be finite"):
        weighted_gerchberg_saxton(np.ones((4, 4)), 2, initial_phase=start)


def test_rectangular_pixels():
    """Columns of twice the pitch: the fields of the spots' lenses are every second column of those on square pixels."""
    points = np.array([[-2e-4, 1e-4, 0.05], [1e-4, 2e-4, 0.06]])
    fine, _ = spot_hologram(points[:1], (32, 64), 532e-9, 8e-6, 1, seed=1)
    coarse, spots = spot_hologram(points[:1], (32, 32), 532e-9, (8e-6, 16e-6), 1, seed=1)
    np.testing.assert_allclose(coarse, fine[:, ::2], atol=1e-9)
    assert abs(spots[0]) ** 2 == pytest.approx(1)


@pytest.mark.parametrize("n_iterations", [30, 60])
def test_two_spots_are_made_even(n_iterations):
    """Undamped weights carry the light from one spot to the other and back: a uniformity of 0.2."""
    points = np.array([[[-1.2e-4, 0.0, 1e-2], [1.2e-4, 0.0, 1e-2]], [[0.0, -1e-4, 1e-2], [3e-5, 1e-4, 1e-2]]])
    _, spots = spot_hologram(points, (80, 80), 532e-9, 8e-6, n_iterations, seed=0)
    assert (uniformity(abs(spots) ** 2) > 0.99).all()
    target = np.zeros((32, 32))
    target[16, [10, 21]] = 1
    _, image = weighted_gerchberg_saxton(target, n_iterations, seed=0)
    assert uniformity(abs(image[target > 0]) ** 2) > 0.99


def test_spots_take_the_phases_asked_for(random):
    points, phases = far_grid(4, 9, 128), random.uniform(0, 2 * np.pi, 16)
    hologram, spots = spot_hologram(points, (128, 128), WAVELENGTH, DX, 30, FOCAL, phases=phases)
    assert np.abs(np.angle(spots * np.exp(-1j * phases))).max() < 0.02 and uniformity(abs(spots) ** 2) > 0.97
    focus, pitch = odak.wave.lens_fourier_transform(hologram, FOCAL, DX, WAVELENGTH)
    rows, columns = (np.round(points[:, k] / pitch).astype(int) + 64 for k in (1, 0))
    common = np.exp(4j * np.pi * FOCAL / WAVELENGTH) / 1j
    assert np.abs(np.angle(focus[rows, columns] / common * np.exp(-1j * phases))).max() < 0.02


def test_phases_of_spots_in_free_space_are_those_of_propagation():
    points = np.asarray([[-1e-4, 5e-5, 0.05], [1e-4, -2e-4, 0.05], [5e-5, 1.5e-4, 0.05]])
    phases = np.asarray([0.5, -2.0, 1.0])
    hologram, _ = spot_hologram(points, (96, 96), WAVELENGTH, DX, 20, phases=phases)
    for (x, y, z), phase in zip(points, phases, strict=True):
        found = odak.wave.propagate_to_window(hologram, WAVELENGTH, z, DX, (1, 1), DX, (y, x))[0, 0]
        sphere = z / WAVELENGTH + (x**2 + y**2) / (2 * WAVELENGTH * z)
        assert abs(np.angle(found * 1j * np.exp(-2j * np.pi * sphere - 1j * phase))) < 0.05


def test_phases_and_intensities_under_uneven_light_in_a_batch(random):
    import torch

    points = np.stack([random.uniform(-1e-3, 1e-3, (6, 3)) * [1, 1, 2] for _ in range(2)])
    phases, wanted = random.uniform(-3, 3, (2, 6)), np.asarray([1.0, 1, 2, 1, 3, 1])
    light = np.exp(-(((np.arange(96) - 40) / 50) ** 2)) * np.ones((80, 96))
    options = {"intensities": wanted, "illumination": light, "phases": phases}
    _, spots = spot_hologram(points, (80, 96), WAVELENGTH, DX, 80, FOCAL, **options)
    target = np.sqrt(wanted) * np.exp(1j * phases)
    error = spots / target
    assert np.abs(error / error.real.mean(-1, keepdims=True) - 1).max() < 0.02
    tensors = {name: torch.as_tensor(value) for name, value in options.items()}
    same = odak.learn.wave.spot_hologram(torch.as_tensor(points), (80, 96), WAVELENGTH, DX, 80, FOCAL, **tensors)[1]
    np.testing.assert_allclose(same.numpy(), spots, atol=1e-10)
    with pytest.raises(ValueError, match="phases"):
        spot_hologram(points, (80, 96), WAVELENGTH, DX, 1, FOCAL, phases=phases[:, :5])


def test_uniformity_of_the_levels_of_a_camera(as_array):
    levels = np.asarray([200, 150, 100], np.uint8)
    assert float(uniformity(as_array(levels))) == pytest.approx(2 / 3, rel=1e-6)


def test_spots_of_half_precision_are_computed_in_single():
    target = np.zeros((16, 16), np.float32)
    target[[3, 8, 12], [4, 11, 5]] = 250
    half, single = (weighted_gerchberg_saxton(target.astype(t), 5, seed=1)[1] for t in (np.float16, np.float32))
    np.testing.assert_array_equal(half, single)
