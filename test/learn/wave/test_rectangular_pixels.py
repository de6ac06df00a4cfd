"""Displays, cameras, optimizers and losses of pixels whose pitches along rows and columns differ."""

import math

import numpy as np
import pytest
import torch
from helpers import physics

from odak import wave
from odak.learn import wave as learn

SHAPE, PITCH, WAVELENGTH, DISTANCE = (14, 18), (8e-6, 6e-6), 532e-9, 1e-3


def random_phase(frames=None):
    shape = SHAPE if frames is None else (frames, *SHAPE)
    return 6 * torch.rand(shape, generator=torch.Generator().manual_seed(2), dtype=torch.float64)


def intensity(phase, distance=DISTANCE, pitch=PITCH, cutoff=np.inf):
    field = np.exp(1j * np.asarray(phase))
    return abs(physics.unwrapped_propagation(field, distance, pitch, WAVELENGTH, cutoff, padding=24)) ** 2


def display(**options):
    options = {"propagator_type": "forward", "distances": [DISTANCE], **options}
    options |= {} if {"iris_radius"} & options.keys() else {"aperture": "open"}
    return learn.propagator(SHAPE, [WAVELENGTH], PITCH, **options)


@pytest.mark.parametrize("options", [{}, {"propagator_type": "back and forth", "image_location_offset": -1e-4}])
def test_a_display_shows_what_an_independent_propagation_gives(options):
    net = DISTANCE - options.get("image_location_offset", 0.0)
    phase = random_phase()
    shown = display(**options).reconstruct(phase)[0, 0, 0]
    assert physics.relative_error(shown.numpy(), intensity(phase, net)) < 1e-3
    # The pitches are not interchangeable.
    assert physics.relative_error(shown.numpy(), intensity(phase, net, PITCH[::-1])) > 0.1


def test_a_display_says_its_pitches_as_rows_and_columns():
    display = learn.Display(learn.Modulator((12, 16), (8e-6, 6.4e-6)), 532e-9, 2e-3)
    assert "12 × 16 pixels of 8 × 6.4 µm" in repr(display)


def test_a_round_iris_is_round_in_cycles_per_metre():
    phase, cutoff = random_phase(), 4e4
    options = {"iris_radius": cutoff * WAVELENGTH * 0.1, "iris_focal_length": 0.1}
    shown = display(**options)
    assert physics.relative_error(shown.reconstruct(phase)[0, 0, 0].numpy(), intensity(phase, cutoff=cutoff)) < 0.02
    radii = np.count_nonzero(shown.aperture[2 * SHAPE[0] // 2, :]), np.count_nonzero(shown.aperture[:, SHAPE[1]])
    expected = [2 * cutoff * 2 * n * pitch for n, pitch in zip(SHAPE[::-1], PITCH[::-1], strict=True)]
    assert radii == pytest.approx(expected, abs=1)


@pytest.mark.filterwarnings("ignore:.*averages the field:odak.AccuracyWarning")
def test_several_samples_per_pixel_of_impulse_responses():
    method = {"propagation_type": "Impulse Response Fresnel", "aperture_samples": (3, 2, 2, 3), "distances": [1e-2]}
    phase = random_phase()
    shown = display(resolution_factor=2, **method).reconstruct(phase, get_complex=True)[0, 0, 0]
    alone = learn.propagate_beam(
        *(torch.exp(1j * phase), None, 1e-2, PITCH, WAVELENGTH, "Impulse Response Fresnel"),
        zero_padding=(True, False, True),
        scale=2,
        samples=(3, 2, 2, 3),
    )
    # The sampled response is that of points whose light has no limit of the band.
    assert physics.relative_error(shown, alone) < 0.03
    # The averages over source and target are factors of the transfer function.
    relayed = {"propagator_type": "back and forth", "resolution_factor": 2, "image_location_offset": 0.0, **method}
    ratio = (display(**relayed).kernels / display(**relayed | {"aperture_samples": (1, 1, 1, 1)}).kernels)[0, 0]
    expected = 1.0
    for axis, (n, pitch, source, sensed) in enumerate(zip(SHAPE, PITCH, (3, 2), (2, 3), strict=True)):
        frequency = (np.arange(4 * n) - 2 * n) / (4 * n * pitch / 2)
        # Midpoints of equal parts of the two apertures.
        factor = [
            np.mean([np.cos(2 * np.pi * frequency * width * ((k + 0.5) / count - 0.5)) for k in range(count)], axis=0)
            for count, width in ((source, pitch), (sensed, pitch / 2))
        ]
        expected = expected * np.expand_dims(factor[0] * factor[1], 1 - axis)
    assert np.allclose(ratio, expected, atol=1e-5)


@pytest.mark.parametrize("samples", [1, 2])
def test_a_camera_sees_what_an_independent_propagation_gives(samples):
    slm = learn.spatial_light_modulator(bits=None, fill_factor=0.8, samples_per_pixel=samples) if samples > 1 else None
    phase = random_phase()
    seen = learn.simulated_camera(WAVELENGTH, DISTANCE, PITCH, slm=slm).light(phase)
    field = torch.exp(1j * phase) if slm is None else slm(phase)
    fine = [pitch / samples for pitch in PITCH]
    light = abs(physics.unwrapped_propagation(field.numpy(), DISTANCE, fine, WAVELENGTH, padding=24)) ** 2
    expected = light.reshape(SHAPE[0], samples, SHAPE[1], samples).mean((1, 3))
    assert physics.relative_error(seen.numpy(), expected) < 1e-3


def target():
    ramp = np.add.outer(np.linspace(0.1, 0.5, SHAPE[0]), np.linspace(0, 0.4, SHAPE[1]))
    return torch.as_tensor(ramp * (np.hypot(*np.mgrid[-7:7, -9:9]) < 6))


def test_optimizers_claim_what_an_independent_propagation_gives():
    hologram, claimed = learn.stochastic_gradient_descent(
        *(target(), WAVELENGTH, DISTANCE, PITCH), n_iteration=15, initial_phase="quadratic", scale=True, progress=False
    )
    assert physics.relative_error(claimed.abs().numpy() ** 2, intensity(hologram.angle())) < 1e-3
    optimizer = learn.multiplane_hologram_optimizer(
        *(WAVELENGTH, DISTANCE, 1e-4, PITCH, SHAPE, torch.stack([target(), target()])),
        number_of_planes=2,
        number_of_iterations=4,
        progress=False,
        aperture="open",
    )
    phase, _, claimed = optimizer.optimize()
    net = (optimizer.propagator.distances - DISTANCE).tolist()
    for plane, distance in zip(claimed, net, strict=True):
        assert physics.relative_error(plane.numpy(), intensity(phase, distance)) < 1e-3


def test_double_phase_iris_stops_the_orders_along_both_axes():
    hologram, shown = learn.double_phase_hologram(target(), WAVELENGTH, DISTANCE, PITCH)
    expected = intensity(hologram.angle(), cutoff=0.25 / max(PITCH))
    assert physics.relative_error(shown.abs().numpy() ** 2, expected) < 0.05
    # Closer to the orders at (1/(2·8 µm), 1/(2·6 µm)) than to the axis.
    with pytest.warns(UserWarning, match="passes more than that"):
        radius = 1.01 * math.hypot(*(0.25 / pitch for pitch in PITCH)) * WAVELENGTH * 0.1
        learn.double_phase_hologram(*(target(), WAVELENGTH, DISTANCE, PITCH), iris_radius=radius, iris_focal_length=0.1)


def test_lenses_of_single_points_focus_along_both_axes():
    image = torch.zeros(32, 32, dtype=torch.float64)
    image[20, 12] = 1
    hologram = learn.point_wise(image, WAVELENGTH, 2e-3, PITCH, torch.device("cpu"), lens_size=15)
    y, x = np.mgrid[:32, :32]
    squared = ((y - 20) * PITCH[0]) ** 2 + ((x - 12) * PITCH[1]) ** 2
    inside = np.hypot(y - 20, x - 12) <= 15
    assert np.allclose(hologram.numpy(), inside * np.exp(-1j * np.pi / (WAVELENGTH * 2e-3) * squared), atol=1e-9)


def test_targets_are_blurred_by_the_cone_of_each_axis():
    picture, depth = torch.zeros(1, 41, 41, dtype=torch.float64), torch.zeros(41, 41)
    picture[0, 20, 20] = 1
    geometry = {"number_of_planes": 2, "wavelengths": [WAVELENGTH], "distances": [0.0, 2e-3]}
    loss = learn.multiplane_loss(picture, depth, pixel_pitch=PITCH, **geometry)
    blurred = loss.get_targets()[0][1, 0].numpy()
    at = np.arange(41) - 20
    variances = [(blurred.sum(axis) * at**2).sum() / blurred.sum() for axis in (1, 0)]
    # An ellipse of half axes a has the variance a²/4 along each.
    for variance, pitch in zip(variances, PITCH, strict=True):
        half = 2e-3 * math.tan(math.asin(WAVELENGTH / (2 * pitch))) / pitch
        assert variance == pytest.approx(half**2 / 4, rel=0.1)


def test_gradients_of_both_pitches():
    pitch = [torch.tensor(value, dtype=torch.float64, requires_grad=True) for value in (1.0, 1.0)]

    def shown(down, across):
        pitches = (8e-6 * down, 6e-6 * across)
        screen = learn.propagator(
            (4, 5), [WAVELENGTH], pitches, distances=[2e-4], propagator_type="forward", aperture="open"
        )
        return screen.reconstruct(random_phase()[:4, :5], no_grad=False)

    assert torch.autograd.gradcheck(shown, pitch, fast_mode=True)


def test_older_elements_have_a_pitch_for_each_axis():
    k, (down, across) = 2 * np.pi / WAVELENGTH, PITCH
    y, x = (np.linspace(-n * pitch / 2, n * pitch / 2, n) for n, pitch in zip(SHAPE, PITCH, strict=True))
    lens = np.exp(-1j * k * (y[:, None] ** 2 + x**2) / 0.2)
    assert np.allclose(wave.quadratic_phase_function(*SHAPE[::-1], k, 0.1, PITCH), lens)
    assert np.allclose(learn.quadratic_phase_function(*SHAPE, k, 0.1, PITCH), lens, atol=1e-5)
    assert np.allclose(wave.double_convergence(*SHAPE, k, -0.2, PITCH), lens)
    for axis, line in (("x", x + 0 * y[:, None]), ("y", y[:, None] + 0 * x)):
        expected = np.exp(-1j * k * np.sin(np.radians(2.0)) * line)
        assert np.allclose(wave.prism_phase_function(*SHAPE, k, 2.0, PITCH, axis), expected)
    rows, columns = np.indices(SHAPE)
    for axis, line in (("x", rows * down), ("y", columns * across)):
        expected = np.exp(-1j * k * np.sin(np.radians(2.0)) * line)
        assert np.allclose(wave.prism_grating(*SHAPE, k, 2.0, PITCH, axis), expected)
