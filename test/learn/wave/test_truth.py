"""Claims of displays and optimizers against an independent propagation in double precision without wrap-around."""

import math

import numpy as np
import physics
import pytest
import torch

from odak import AccuracyWarning, ConvergenceWarning, SamplingWarning
from odak.learn import wave
from odak.learn.wave.holograms.starts import STARTS
from odak.wave.methods import PROPAGATION_TYPES

PITCH, SIZE = 8e-6, (64, 80)
COLOURS = [639e-9, 515e-9, 473e-9]
pytestmark = pytest.mark.usefixtures("small_judge")
# N·dx²/λ of the shorter side: where kernels sampled on the padded grid wrap around most.
CRITICAL = SIZE[0] * PITCH**2 / COLOURS[1]
IRIS = {"iris_radius": 2.5e-3, "iris_focal_length": 0.1}


def picture(*shape, seed=0):
    coarse = torch.rand(*shape[:-2], 6, 7, generator=torch.Generator().manual_seed(seed))
    fine = torch.nn.functional.interpolate(coarse.reshape(1, -1, 6, 7), shape[-2:], mode="bicubic")
    return fine.clamp(0, 1).reshape(shape)


def decibels(image, target):
    image, target = np.asarray(image, dtype=np.float64), np.asarray(target, dtype=np.float64)
    scale = (image * target).sum() / (image**2).sum()
    return -10 * math.log10(((scale * image - target) ** 2).mean())


def excess(image, field, target, distance, **options):
    """Return by how many decibels what is claimed is above what an independent propagation of the hologram gives."""
    return decibels(image, target) - decibels(judged([field], distance, COLOURS[1], **options), target)


# All that can propagate a hologram of one colour to an image of the same pitch; "auto" for the names of exact methods.
KINDS = [name for name in PROPAGATION_TYPES if name != "custom" and not name.startswith(("Fraunhofer", "Incoherent"))]


# The kernels of alternating projections are sampled ones, which say where they are out of range.
@pytest.mark.filterwarnings("ignore:.*outside its range:odak.SamplingWarning")
@pytest.mark.parametrize("share", [pytest.param(0.4, marks=pytest.mark.slow), 3.0])
@pytest.mark.parametrize("method", KINDS)
def test_no_propagation_type_claims_more_than_exact_propagation(method, share):
    """For each optimizer and encoding, nearer and further than the critical distance."""
    size, colour = (24, 32), COLOURS[1]
    target, distance = picture(*size), share * size[0] * PITCH**2 / colour
    hologram, image = wave.stochastic_gradient_descent(
        target, colour, distance, PITCH, method, n_iteration=40, scale=True, initial_phase="quadratic", progress=False
    )
    assert decibels(wave.intensity(image), target) > 15
    assert abs(excess(wave.intensity(image), hologram, target, distance)) < 0.1
    field = wave.generate_complex_field(target.sqrt(), torch.zeros(size))
    hologram, image = wave.gerchberg_saxton(field, 5, distance, PITCH, colour, 2 * math.pi, method, seed=0)
    assert abs(excess(wave.intensity(image), hologram, target, distance)) < 0.1
    hologram, image = wave.double_phase_hologram(target, colour, distance, PITCH, method)
    assert abs(excess(wave.intensity(image), hologram, target, distance, cutoff=0.25 / PITCH)) < 0.1
    display = wave.propagator(
        size, [colour], PITCH, distances=[distance], propagation_type=method, propagator_type="forward",
        aperture_samples=(1, 1, 1, 1), aperture="open",
    )  # fmt: skip
    made = wave.multi_color_hologram_optimizer(
        [colour], size, target[None, None], display, 1, 1, learning_rate=0.2, optimize_peak_amplitude=True,
        progress=False, seed=0,
    )  # fmt: skip
    phase, images = made.optimize(15, {"eyebox": 0, "light": 0})[1:3]
    assert abs(excess(images[0, 0, 0], torch.polar(torch.ones(size), phase[0]), target, distance)) < 0.1


def test_averages_over_pixels_are_real_and_over_images_warned_of():
    # Near enough for the paraxial phase.
    distance, colour = CRITICAL / 4, COLOURS[1]
    options = {"distances": [distance], "propagation_type": "IR Fresnel", "propagator_type": "forward"}
    options |= {"aperture": "open"}
    with pytest.warns(AccuracyWarning, match="averages the field, .* have 42% of their amplitude"):
        wave.propagator(SIZE, [colour], PITCH, **options)
    display = wave.propagator(SIZE, [colour], PITCH, aperture_samples=(40, 40, 1, 1), **options)
    phase = 2 * math.pi * torch.rand(SIZE, generator=torch.Generator().manual_seed(3))
    shown = display.reconstruct(phase, get_complex=True)[0, 0, 0].numpy()
    # The field of square pixels, up to the edge of the band.
    pad = [(7 * n // 2, 8 * n - n - 7 * n // 2) for n in SIZE]
    spectrum = np.fft.fft2(np.pad(np.exp(1j * phase.numpy()), pad))
    for axis, n in enumerate(spectrum.shape):
        spectrum = spectrum * np.expand_dims(np.sinc(np.fft.fftfreq(n)), 1 - axis)
    expected = physics.unwrapped_propagation(np.fft.ifft2(spectrum), distance, PITCH, colour, padding=2)
    expected = expected[pad[0][0] : pad[0][0] + SIZE[0], pad[1][0] : pad[1][0] + SIZE[1]]
    assert physics.relative_error(shown, expected) < 3e-3


@pytest.mark.parametrize("method", ["Fraunhofer", "Incoherent Angular Spectrum"])
def test_methods_of_other_light_say_so(method):
    """They show an image on samples of another pitch, or of intensities, which a phase does not shape."""
    with pytest.warns((AccuracyWarning, SamplingWarning), match="far field is not reached|propagates intensities"):
        wave.stochastic_gradient_descent(
            picture(*SIZE), COLOURS[1], CRITICAL, PITCH, method, n_iteration=1, scale=True, progress=False
        )


def judged(fields, distance, wavelength, cutoff=np.inf, mask=None):
    """Return the mean intensity of fields shown one after another."""

    def light(field):
        if mask is not None:
            return abs(physics.behind_mask(field, distance, PITCH, wavelength, mask.numpy())) ** 2
        return abs(physics.unwrapped_propagation(field, distance, PITCH, wavelength, cutoff, padding=12)) ** 2

    return sum(light(field.numpy()) for field in fields) / len(fields)


@pytest.mark.parametrize("share", [0.5, 1.0, 2.0])
@pytest.mark.parametrize("method", ["Bandlimited Angular Spectrum", "auto"])
def test_gradient_descent(share, method):
    target, distance = picture(*SIZE), share * CRITICAL
    hologram, image = wave.stochastic_gradient_descent(
        target, COLOURS[1], distance, PITCH, method, n_iteration=80, scale=True, initial_phase="quadratic",
        progress=False,
    )  # fmt: skip
    claimed = decibels(wave.intensity(image), target)
    assert claimed > 20
    assert abs(claimed - decibels(judged([hologram], distance, COLOURS[1]), target)) < 0.3


@pytest.mark.parametrize("method", ["Bandlimited Angular Spectrum", "Transfer Function Fresnel", "auto"])
def test_alternating_projections(method):
    """Two critical distances away the light that wraps around on a padded grid is worth a decibel."""
    target, distance = picture(*SIZE), 2 * CRITICAL
    field = wave.generate_complex_field(target.sqrt(), torch.zeros(SIZE))
    hologram, image = wave.gerchberg_saxton(field, 20, distance, PITCH, COLOURS[1], 2 * math.pi, method, seed=0)
    claimed = decibels(wave.intensity(image), target)
    assert abs(claimed - decibels(judged([hologram], distance, COLOURS[1]), target)) < 0.1


@pytest.mark.parametrize("start", STARTS)
def test_starts_by_name(start):
    target, distance = picture(*SIZE), CRITICAL
    options = {"n_iteration": 30, "scale": True, "seed": 0, "progress": False, "optimizer": "lbfgs"}
    hologram, image = wave.stochastic_gradient_descent(
        target, COLOURS[1], distance, PITCH, initial_phase=start, **options
    )
    claimed = decibels(wave.intensity(image), target)
    assert abs(claimed - decibels(judged([hologram], distance, COLOURS[1]), target)) < 0.3
    if start != "random":
        random, _ = wave.stochastic_gradient_descent(
            target, COLOURS[1], distance, PITCH, initial_phase="random", **options
        )
        assert claimed > decibels(judged([random], distance, COLOURS[1]), target) + 1
    again = wave.stochastic_gradient_descent(target, COLOURS[1], distance, PITCH, initial_phase=start, **options)[0]
    assert torch.equal(again, hologram)


def test_several_frames_average():
    target, distance = picture(*SIZE), 0.7 * CRITICAL
    results = {}
    for frames, bits in ((1, None), (4, None), (1, 1), (8, 1)):
        slm = None if bits is None else wave.spatial_light_modulator(bits=bits)
        hologram, image = wave.stochastic_gradient_descent(
            target, COLOURS[1], distance, PITCH, n_iteration=30, scale=True, initial_phase="random", frames=frames,
            slm=slm, seed=0, progress=False,
        )  # fmt: skip
        assert hologram.shape == image.shape == ((frames, *SIZE) if frames > 1 else SIZE)
        shown = hologram.reshape(-1, *SIZE)
        if bits:
            assert len(shown.angle().mul(10).round().unique()) <= 3  # 0, π and −π.
        claimed = decibels(wave.intensity(image).reshape(-1, *SIZE).mean(0), target)
        results[frames, bits] = decibels(judged(shown, distance, COLOURS[1]), target)
        assert abs(claimed - results[frames, bits]) < 0.3
    assert results[4, None] > results[1, None] + 5
    assert results[8, 1] > results[1, 1] + 2


def test_an_iris_of_the_optimizer():
    target, distance, radius, focal = picture(*SIZE), 0.5 * CRITICAL, 2e-3, 0.1
    hologram, image = wave.stochastic_gradient_descent(
        target, COLOURS[1], distance, PITCH, n_iteration=60, scale=True, initial_phase="flat", progress=False,
        iris_radius=radius, iris_focal_length=focal,
    )  # fmt: skip
    claimed = decibels(wave.intensity(image), target)
    behind = decibels(judged([hologram], distance, COLOURS[1], radius / (COLOURS[1] * focal)), target)
    assert abs(claimed - behind) < 0.3
    assert behind > decibels(judged([hologram], distance, COLOURS[1]), target) + 2


@pytest.mark.parametrize(
    ("kind", "options"),
    [
        ("back and forth", IRIS),
        ("forward", {"aperture": "open"}),
        ("back and forth", {"aperture_size": SIZE[1]}),
        pytest.param("forward", {"aperture_size": SIZE[0] / 2}, marks=pytest.mark.slow),
        pytest.param("back and forth", {"aperture": "open"}, marks=pytest.mark.slow),
        pytest.param("forward", IRIS, marks=pytest.mark.slow),
    ],
)
def test_colours_and_planes(kind, options):
    offset = 0.6 * CRITICAL
    display = wave.propagator(
        SIZE, COLOURS, PITCH, number_of_frames=3, number_of_depth_layers=2, volume_depth=1e-2,
        image_location_offset=offset, propagator_type=kind, **options,
    )  # fmt: skip
    targets = picture(2, 3, *SIZE)
    made = wave.multi_color_hologram_optimizer(
        COLOURS, SIZE, targets, display, 3, 2, learning_rate=0.2, optimize_peak_amplitude=True, progress=False, seed=0
    )
    _, phases, images, powers, _, _ = made.optimize(15, {"eyebox": 0, "light": 0})
    for plane, distance in enumerate(display.distances.tolist()):
        for colour, wavelength in enumerate(COLOURS):
            fields = [powers[frame, colour] * torch.polar(torch.ones(SIZE), phases[frame]) for frame in range(3)]
            cutoff = options["iris_radius"] / (wavelength * 0.1) if "iris_radius" in options else np.inf
            net = distance - offset if kind == "back and forth" else distance
            shown = judged(fields, net, wavelength, cutoff, display.aperture if "aperture_size" in options else None)
            target = targets[plane, colour]
            assert abs(decibels(images.sum(0)[plane, colour], target) - decibels(shown, target)) < 0.3
            # The brightness is one for all colours, and the intensities are those of the light.
            assert float(images.sum(0)[plane, colour].mean()) == pytest.approx(3 * shown.mean(), rel=0.02)


@pytest.mark.parametrize("stop", [{"aperture": "open"}, {"aperture_size": 40}])
def test_multiplane(stop):
    """What one pattern or several in turn show on each plane is what is claimed; several have less speckle."""
    targets, bright, results = picture(2, *SIZE), picture(2, *SIZE).numpy() > 0.5, {}
    for frames in (1, 4):
        made = wave.multiplane_hologram_optimizer(
            COLOURS[1], 0.0, 4e-3, PITCH, SIZE, targets, number_of_planes=2, number_of_iterations=8,
            learning_rate=0.15, mask_limits=[0, 1, 0, 1], frames=frames, progress=False, seed=0,
            **stop,
        )  # fmt: skip
        phase, amplitude, images = made.optimize()
        assert phase.shape == ((frames, *SIZE) if frames > 1 else SIZE)
        assert images.shape == (2, *SIZE)
        torch.testing.assert_close(made.reconstruct(amplitude, phase), images)
        speckle = []
        for plane, distance in enumerate(made.propagator.distances.tolist()):
            fields = torch.polar(torch.ones(frames, *SIZE), phase.reshape(frames, *SIZE))
            mask = made.propagator.aperture if "aperture_size" in stop else None
            shown = judged(fields, distance, COLOURS[1], mask=mask)
            assert abs(decibels(images[plane], targets[plane]) - decibels(shown, targets[plane])) < 0.3
            assert float(images[plane].mean()) == pytest.approx(shown.mean(), rel=0.02)
            ratio = shown[bright[plane]] / targets[plane].numpy()[bright[plane]]
            speckle.append(ratio.std() / ratio.mean())
        results[frames] = np.mean(speckle)
    # A stop smooths speckle too.
    assert results[4] < (0.6 if "aperture" in stop else 0.7) * results[1]


def test_display_without_relay():
    display = wave.holographic_display([COLOURS[1]], PITCH, SIZE, 0.0, 1, CRITICAL)
    hologram, _ = wave.stochastic_gradient_descent(
        picture(*SIZE), COLOURS[1], CRITICAL, PITCH, n_iteration=60, scale=True, initial_phase="flat", progress=False
    )
    shown = display.reconstruct(hologram.angle()[None], torch.ones(1, 1))[0, 0, 0]
    expected = judged([hologram], CRITICAL, COLOURS[1])
    assert abs(decibels(shown, picture(*SIZE)) - decibels(expected, picture(*SIZE))) < 0.3


def test_camera_loop_that_gets_worse_warns_and_returns_its_best():
    target, distance = picture(*SIZE), 0.3 * CRITICAL
    start = torch.zeros(SIZE)
    options = {"n_iteration": 60, "scale": True, "initial_phase": start, "learning_rate": 0.2, "progress": False}
    losses = []

    def camera(phase):
        # A display rotated by 90°, which the model does not include.
        image = wave.simulated_camera(COLOURS[1], distance, PITCH, full_well=None, exposure=0.01)(phase)
        return image.roll((5, 7), (-2, -1)).flip(-1)

    def keep(iteration, loss):
        losses.append(float(loss))

    with pytest.warns(ConvergenceWarning, match="the loss rose from"):
        hologram, _ = wave.stochastic_gradient_descent(
            target, COLOURS[1], distance, PITCH, camera=camera, callback=keep, **options
        )
    image = camera(hologram.angle())
    scale = (image * target).sum() / image.square().sum()
    assert float((scale * image - target).square().mean()) == pytest.approx(min(losses), rel=1e-3)
    assert losses[-1] > 1.1 * min(losses)


def test_a_camera_behind_the_iris_of_the_model_with_real_pixels():
    """What the loop ends with is what a panel of square pixels shows behind the iris."""
    size, distance, wavelength, fill = (32, 40), 1e-3, COLOURS[1], 9 / 16
    target = picture(*size)
    iris = {"iris_radius": 2.8e-3, "iris_focal_length": 0.1}
    panel = wave.spatial_light_modulator(bits=None, fill_factor=fill, dead_area_amplitude=0.0)
    camera = wave.simulated_camera(wavelength, distance, PITCH, slm=panel, full_well=None, exposure=0.1, **iris)
    hologram, _ = wave.stochastic_gradient_descent(
        target, wavelength, distance, PITCH, slm=panel, camera=camera, n_iteration=40, scale=True,
        initial_phase="flat", learning_rate=0.2, progress=False, **iris,
    )  # fmt: skip
    phase, cutoff = hologram.angle(), 2.8e-3 / (wavelength * 0.1)
    # Eight samples along a pixel, six of them lit, and the light at the middles of pixels.
    line = np.tile([0, 1, 1, 1, 1, 1, 1, 0], max(size))
    drawn = np.kron(np.exp(1j * phase.numpy()), np.ones((8, 8))) * line[: 8 * size[0], None] * line[: 8 * size[1]]
    light = abs(physics.unwrapped_propagation(drawn, distance, PITCH / 8, wavelength, cutoff, padding=8)) ** 2
    middles = light.reshape(size[0], 8, size[1], 8)[:, 3:5, :, 3:5].mean((1, 3))
    end = decibels(camera(phase), target)
    assert abs(decibels(middles, target) - end) < 0.3
    # A camera model without iris and pixels gives another picture.
    blind = wave.simulated_camera(wavelength, distance, PITCH, full_well=None, exposure=0.1)
    assert abs(decibels(blind(phase), target) - decibels(middles, target)) > 0.5
