import numpy as np
import physics
import pytest

import odak

GEOMETRY = (0.02, 8e-6, 532e-9)


@pytest.fixture
def target():
    image = np.zeros((64, 64))
    image[20:44, 24:40] = 1.0
    return image


def correlation(field, target):
    return np.corrcoef(np.abs(field).ravel(), target.ravel())[0, 1]


@pytest.mark.parametrize("method", ["IR Fresnel", "Bandlimited Angular Spectrum"])
def test_hologram_is_phase_only_and_makes_the_image(target, method):
    hologram, image = odak.wave.gerchberg_saxton(target, 30, *GEOMETRY, propagation_type=method, seed=1)
    assert hologram.shape == image.shape == target.shape
    np.testing.assert_allclose(np.abs(hologram), 1, atol=1e-12)
    assert correlation(image, target) > 0.88
    # What is returned is what the hologram does, not what the algorithm wished for.
    again = physics.unwrapped_propagation(hologram, *GEOMETRY)
    # The paraxial phase is off by a fiftieth of a wave at the corners of the band.
    assert physics.relative_error(image, again) < (0.02 if method == "IR Fresnel" else 2e-3)


def test_the_default_method_makes_the_better_image(target):
    def deviation(**method):
        geometry = (6e-3, *GEOMETRY[1:])
        hologram, _ = odak.wave.gerchberg_saxton(target, 20, *geometry, seed=1, **method)
        return np.linalg.norm(np.abs(physics.unwrapped_propagation(hologram, *geometry)) - target)

    assert deviation() < 0.3 * deviation(propagation_type="IR Fresnel")


def test_iterations_help_and_seeds_reproduce(target):
    method = {"propagation_type": "AS", "seed": 2}
    few, many = (correlation(odak.wave.gerchberg_saxton(target, n, *GEOMETRY, **method)[1], target) for n in (1, 20))
    assert many > few + 0.02
    one, two = (odak.wave.gerchberg_saxton(target, 2, *GEOMETRY, **method)[0] for _ in range(2))
    np.testing.assert_array_equal(one, two)


def test_phase_stays_inside_the_modulators_range(target):
    hologram, _ = odak.wave.gerchberg_saxton(target, 3, *GEOMETRY, slm_range=np.pi, propagation_type="AS", seed=0)
    phase = np.angle(hologram)
    assert phase.min() >= -1e-9
    assert phase.max() <= np.pi + 1e-9


@pytest.mark.slow
def test_acceleration_saves_half_of_the_iterations():
    axis = np.arange(64) - 32
    smooth = 0.5 + 0.3 * np.sin(9 * axis[:, None] / 64) * np.cos(7 * axis / 64)
    weak_lens = np.pi / 4 / 64 * (axis[:, None] ** 2 + axis**2)
    settings = {"propagation_type": "Bandlimited Angular Spectrum", "initial_phase": weak_lens}

    def deviation(count, **options):
        hologram, _ = odak.wave.gerchberg_saxton(smooth, count, *GEOMETRY, 2 * np.pi, **settings, **options)
        np.testing.assert_allclose(np.abs(hologram), 1, atol=1e-12)
        image = np.abs(physics.unwrapped_propagation(hologram, *GEOMETRY))
        return np.linalg.norm(image - smooth) / np.linalg.norm(smooth)

    assert deviation(30, accelerated=True) < deviation(60)
    assert deviation(1, accelerated=True) == deviation(1)


def test_start_can_be_given(target):
    flat = odak.wave.gerchberg_saxton(target, 1, *GEOMETRY, propagation_type="AS", initial_phase=np.zeros((64, 64)))[0]
    same = odak.wave.gerchberg_saxton(target, 1, *GEOMETRY, propagation_type="AS", initial_phase=np.zeros((64, 64)))[0]
    np.testing.assert_array_equal(flat, same)
    with pytest.raises(ValueError, match=r"initial_phase must be .* as field"):
        odak.wave.gerchberg_saxton(target, 1, *GEOMETRY, initial_phase=np.zeros((4, 4)))
    with pytest.raises(ValueError, match="n_iterations must be at least 1"):
        odak.wave.gerchberg_saxton(target, 0, *GEOMETRY)


@pytest.mark.parametrize("kind", ["no constraint", "double constraint"])
def test_three_dimensional_hologram_shows_each_plane(target, kind):
    other = np.zeros((64, 64))
    other[8:16, 8:56] = 1.0
    planes, distances = np.stack([target, other]), [0.01, 0.02]
    hologram = odak.wave.gerchberg_saxton_3d(
        planes,
        15,
        distances,
        8e-6,
        532e-9,
        propagation_type="AS",
        target_type=kind,
        coefficients=[0.6, 0.2, 1.0],
        seed=0,
    )
    assert hologram.shape == (64, 64)
    np.testing.assert_allclose(np.abs(hologram), 1, atol=1e-12)
    for index, distance in enumerate(distances):
        image = odak.wave.propagate_beam(hologram, None, distance, 8e-6, 532e-9, "AS", zero_padding=(True, False, True))
        assert correlation(image, planes[index]) > correlation(image, planes[1 - index]) + 0.1


def test_planes_are_coupled(target):
    other = np.zeros((64, 64))
    other[8:16, 8:56] = 1.0
    planes, distances = np.stack([target, other]), [5e-3, 15e-3]
    options = {"dx": 8e-6, "wavelength": 532e-9, "propagation_type": "AS", "initial_phase": np.zeros((64, 64))}
    coupled = odak.wave.gerchberg_saxton_3d(planes, 60, distances, slm_range=2 * np.pi, **options)
    layers = [
        odak.wave.gerchberg_saxton(plane, 60, distance, slm_range=2 * np.pi, **options)[0]
        for plane, distance in zip(planes, distances, strict=True)
    ]
    summed = np.exp(1j * np.angle(sum(layers)))

    def error(hologram):
        total = 0.0
        for plane, distance in zip(planes, distances, strict=True):
            light = np.abs(physics.unwrapped_propagation(hologram, distance, 8e-6, 532e-9, padding=8)) ** 2
            total += ((light * (light * plane).sum() / (light**2).sum() - plane) ** 2).mean()
        return total

    # Against one hologram per plane, summed: more than 2 dB.
    assert error(coupled) < 0.6 * error(summed)
    single = odak.wave.gerchberg_saxton_3d(planes[:1], 5, distances[:1], **options)
    np.testing.assert_allclose(single, odak.wave.gerchberg_saxton(target, 5, distances[0], **options)[0], atol=1e-12)


def test_three_dimensional_arguments_are_checked(target):
    planes = np.stack([target, target])
    with pytest.raises(ValueError, match="distances must contain one distance for each of 2"):
        odak.wave.gerchberg_saxton_3d(planes, 1, [0.1], 8e-6, 532e-9)
    with pytest.raises(ValueError, match="coefficients must be"):
        odak.wave.gerchberg_saxton_3d(planes, 1, [0.1, 0.2], 8e-6, 532e-9, target_type="double constraint")
    with pytest.raises(ValueError, match="Did you mean 'double constraint'"):
        odak.wave.gerchberg_saxton_3d(planes, 1, [0.1, 0.2], 8e-6, 532e-9, target_type="double constrain")
