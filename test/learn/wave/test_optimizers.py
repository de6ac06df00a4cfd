"""Hologram optimizers against each other, against plain autograd, and their documented properties."""

import dataclasses
import math

import pytest
import torch

from odak import ArgumentWarning
from odak.learn import wave
from odak.learn.tools import circular_binary_mask
from odak.learn.wave import (
    mixed_color_hologram_optimizer,
    multi_color_hologram_optimizer,
    multiplane_hologram_optimizer,
    propagator,
)

PITCH, SIZE = 8e-6, (32, 40)
COLOURS = [639e-9, 515e-9, 473e-9]


def picture(*shape, seed=0):
    """Return smooth random intensities of 0 … 1."""
    coarse = torch.rand(*shape[:-2], 5, 5, generator=torch.Generator().manual_seed(seed))
    fine = torch.nn.functional.interpolate(coarse.reshape(1, -1, 5, 5), shape[-2:], mode="bicubic")
    return fine.clamp(0, 1).reshape(shape)


def display(colours=COLOURS, frames=3, planes=2, **options):
    settings = {"propagator_type": "forward", "volume_depth": 2e-3, "image_location_offset": 6e-3}
    settings |= {} if "aperture_size" in options else {"aperture": "open"}
    return propagator(
        SIZE, colours, PITCH, number_of_frames=frames, number_of_depth_layers=planes, **(settings | options)
    )


def optimizer(kind=multi_color_hologram_optimizer, colours=COLOURS, frames=3, planes=2, show=None, **options):
    show = display(colours, frames, planes) if show is None else show
    targets = picture(planes, len(colours), *SIZE)
    settings = {"progress": False, "seed": 0, "learning_rate": 0.1}
    return kind(colours, list(SIZE), targets, show, frames, planes, **(settings | options))


def psnr(images, targets):
    scale = (images * targets).sum() / images.square().sum()
    return -10 * math.log10((scale * images - targets).square().mean())


@pytest.mark.parametrize("budget", [None, 1])
@pytest.mark.parametrize("method", ["conventional", "multi-color", "full_complex_conventional"])
def test_gradient_is_that_of_the_whole_loss(method, budget):
    ours = optimizer(method=method, show=display(memory_budget=budget), optimize_peak_amplitude=True)
    ours.weights = {"image": 1.0, "light": 0.5, "eyebox": 0.3, "phase": 0.2}
    ours._eyebox, ours._noise = {"offset": [2, -3], "diameter": 9}, {}
    ours.init_optimizer(1)
    with torch.no_grad():
        ours.channel_power.add_(0.3 * torch.rand(3, 3)) if method == "multi-color" else None
    total = ours._gradient(0)
    mine = {name: tensor.grad.clone() for name, tensor in ours.parameters.items() if tensor.requires_grad}

    for tensor in ours.parameters.values():
        tensor.grad = None
    phases, roughness = ours.double_phase_constrain(ours.phase, ours.phase_offset)
    powers = ours.channel_power.cos().abs() if method == "multi-color" else ours.channel_power
    loss = 0.2 * roughness + 0.3 * ours.eyebox_constrain(phases, [2, -3], 9)
    for plane in range(2):
        for colour in range(3):
            image = sum(
                powers[frame, colour] ** 2
                * ours.propagator(
                    torch.relu(ours.amplitude[colour]) * torch.exp(1j * phases[frame]), colour, plane
                ).abs() ** 2
                for frame in range(3)
            )  # fmt: skip
            loss = loss + (image / ours.peak_amplitude - ours.targets[plane, colour]).square().sum()
    if method == "multi-color":
        light = (powers.sum(0) - ours.targets.amax((0, 2, 3))).square().sum() + (powers.sum() - 3) ** 2
        loss = loss + 0.5 * (light + torch.cos(powers.sum(1).min()))
    loss.backward()
    assert total.item() == pytest.approx(loss.item(), rel=1e-5)
    assert set(mine) >= {"phase", "phase_offset"}
    for name, slope in mine.items():
        expected = ours.parameters[name].grad
        assert torch.linalg.norm(slope - expected) < 2e-5 * torch.linalg.norm(expected), name


def test_colours_one_by_one_are_three_single_runs():
    start = 2 * math.pi * torch.rand(3, *SIZE)
    together = optimizer(method="conventional", initial_phase=start)
    _, phases, images, powers, _, _ = together.optimize(8, {"eyebox": 0})
    torch.testing.assert_close(powers, torch.eye(3))
    for colour in range(3):
        alone = optimizer(
            colours=COLOURS[colour : colour + 1], frames=1, method="conventional",
            initial_phase=start[colour : colour + 1],
        )  # fmt: skip
        alone.targets = together.targets[:, colour : colour + 1]
        _, phase, image, _, _, _ = alone.optimize(8, {"eyebox": 0})
        # Steps of Adam magnify rounding where a slope is next to nothing.
        differing = (torch.remainder(phase[0] - phases[colour] + 1, 2 * math.pi) - 1).abs() > 2 * math.pi / 256 + 1e-6
        assert differing.float().mean() < 0.01
        torch.testing.assert_close(image[0, :, 0], images[colour, :, colour], atol=0.02, rtol=0.05)


def test_one_plane_is_the_single_plane_optimizer():
    target = picture(*SIZE)
    start = torch.rand(SIZE)
    many = multiplane_hologram_optimizer(
        515e-9, 6e-3, 1e-3, PITCH, SIZE, target[None], number_of_planes=1, number_of_iterations=10,
        phase_initial=start, propagator_type="forward", mask_limits=[0, 1, 0, 1], progress=False,
        aperture="open",
    )  # fmt: skip
    many.offset.data.zero_()
    many.parameters = {}
    many.init_optimizer = lambda: setattr(many, "parameters", {"phase": many.phase})
    phase, amplitude, images = many.optimize()
    hologram, field = wave.stochastic_gradient_descent(
        target, 515e-9, 6e-3, PITCH, n_iteration=10, initial_phase=start, learning_rate=0.1, progress=False
    )
    torch.testing.assert_close(images[0], wave.intensity(field), atol=2e-3, rtol=2e-2)
    assert torch.equal(amplitude, torch.ones(SIZE))
    # The multiplane phase has no mean, which no intensity shows.
    turned = hologram * torch.exp(-1j * (torch.angle(hologram) - phase)[0, 0])
    torch.testing.assert_close(torch.exp(1j * phase), turned, atol=2e-2, rtol=0)


def test_multiplane_shows_each_plane():
    targets = picture(2, *SIZE)
    made = multiplane_hologram_optimizer(
        515e-9, 0.0, 5e-3, PITCH, SIZE, targets, number_of_planes=2, number_of_iterations=80, learning_rate=0.05,
        zero_mode_distance=0.01, mask_limits=[0.2, 0.8, 0.2, 0.8], progress=False, seed=0,
        aperture="open",
    )  # fmt: skip
    phase, amplitude, images = made.optimize()
    inside = made.mask.bool()
    own = [psnr(images[plane][inside], targets[plane][inside]) for plane in range(2)]
    other = [psnr(images[plane][inside], targets[1 - plane][inside]) for plane in range(2)]
    assert min(own) > 14
    assert min(own) > max(other) + 3
    torch.testing.assert_close(made.reconstruct(amplitude, phase), images)
    assert not phase.requires_grad


def test_realistic_defocus_as_it_was_published_has_its_stop():
    """Double phase without a stop cannot lose light: the mean of its images stays near 1, and the error above 0.3."""
    depth = (torch.arange(80) >= 40).float().expand(64, 80)
    loss = wave.multiplane_loss(
        0.5 * picture(1, 64, 80), depth, blur_ratio=5, target_blur_size=20, number_of_planes=2, weights=[1, 1, 1, 0]
    )
    targets, errors = loss.get_targets()[0], {}

    def optimized(**options):
        made = multiplane_hologram_optimizer(
            515e-9, 0.0, 1e-3, PITCH, [64, 80], targets, number_of_planes=2, number_of_iterations=30,
            zero_mode_distance=0.3, mask_limits=[0, 1, 0, 1], loss_function=loss, seed=0, progress=False, **options,
        )  # fmt: skip
        images = made.optimize()[2]
        assert made.propagator.stop in repr(made)
        return made, float((images - targets[:, 0]).square().mean())

    with pytest.warns(ArgumentWarning, match="round stop of earlier releases"):
        made, errors["released"] = optimized()
    assert torch.equal(made.propagator.aperture, circular_binary_mask(128, 160, 80)[0, 0])
    _, errors["size"] = optimized(aperture_size=80)
    made, errors["open"] = optimized(aperture="open")
    assert errors["released"] == errors["size"] < 0.02
    assert errors["open"] > 0.3
    made.propagator.set_aperture()
    assert made.propagator.stop == "round, radius 80 samples"


def test_multiplane_takes_a_loss_a_start_and_bad_input():
    calls = []

    def loss(image, target, plane):
        calls.append(plane)
        return (image - target).abs().mean()

    arguments = {"number_of_planes": 3, "number_of_iterations": 2, "progress": False, "aperture": "open"}
    targets = picture(3, *SIZE)
    multiplane_hologram_optimizer(
        515e-9, 0.0, 1e-3, PITCH, SIZE, targets, loss_function=loss, phase_initial=torch.zeros(SIZE), **arguments
    ).optimize()
    assert calls == [0, 1, 2, 0, 1, 2, 0, 1, 2]
    for change, message in (
        ({"targets": targets[:2]}, "targets must be"),
        ({"targets": targets * torch.nan}, "targets must be finite"),
        ({"targets": targets - 1}, "targets must be finite intensities of at least 0"),
        ({"phase_initial": torch.zeros(4, 4)}, "phase_initial"),
        ({"mask_limits": [0.8, 0.2, 0, 1]}, "mask_limits"),
    ):
        with pytest.raises(ValueError, match=message):
            multiplane_hologram_optimizer(
                **({"wavelength": 515e-9, "image_location": 0.0, "image_spacing": 1e-3, "slm_pixel_pitch": PITCH,
                    "slm_resolution": SIZE, "targets": targets} | arguments | change)
            )  # fmt: skip


def test_images_come_out_and_are_those_of_the_pattern_returned():
    made = optimizer(method="multi-color", optimize_peak_amplitude=True, reduction="mean")
    amplitude, phases, images, powers, channel_powers, peak = made.optimize(120, {"eyebox": 0})
    assert images.shape == (3, 2, 3, *SIZE)
    torch.testing.assert_close(powers, channel_powers.cos().abs())
    assert torch.equal(amplitude, torch.ones(3, *SIZE))
    exposed = images.sum(0)
    for plane in range(2):
        for colour in range(3):
            assert psnr(exposed[plane, colour], made.targets[plane, colour]) > 12
    assert 0.1 < peak < 3
    # Someone else, with the pattern on a file and the powers, sees the same.
    levels = phases / (2 * math.pi) * 256
    torch.testing.assert_close(levels, levels.round(), atol=1e-3, rtol=0)
    elsewhere = display(method="conventional", laser_channel_power=powers)
    torch.testing.assert_close(elsewhere.reconstruct(levels.round() * (2 * math.pi / 256)), images)


def test_bits_are_those_asked_for():
    for bits in (1, 3):
        phases = optimizer().optimize(1, bits=bits)[1]
        assert len(phases.unique()) == 2**bits
    assert len(optimizer().optimize(1, bits=None)[1].unique()) > 1000


def test_shared_colours_are_brighter():
    """Kavaklı et al. 2023: with all sources on in all frames the same modulator shows brighter images."""
    peaks = {}
    for method in ("conventional", "multi-color"):
        # Σ of the amplitudes is pulled to 3 · peak: all sources on.
        made = optimizer(method=method, peak_amplitude=3.0, optimize_peak_amplitude=True, reduction="mean")
        *_, powers, _, peaks[method] = made.optimize(45, {"eyebox": 0})
    assert powers.min() > 0.8
    assert peaks["multi-color"] > 1.5 * peaks["conventional"]


def test_free_brightness_is_that_of_the_closest_images():
    made = optimizer(method="conventional", optimize_peak_amplitude=True)
    _, _, images, _, _, peak = made.optimize(30, {"eyebox": 0}, bits=None)
    images = images.sum(0)
    best = (images * images).sum() / (images * made.targets).sum()
    # The last step changed the images once more.
    assert peak == pytest.approx(best.item(), rel=1e-3)
    fixed = optimizer(method="conventional").optimize(30, {"eyebox": 0}, bits=None)[2].sum(0)
    assert psnr(images, made.targets) > psnr(fixed, made.targets) + 0.2


def test_images_are_compared_with_targets_of_given_brightness():
    brightest = []

    def loss(image, target):
        brightest.append(target.max().item())
        return (image - target).square().sum()

    made, plain = optimizer(peak_amplitude=1.8), optimizer(peak_amplitude=1.8, loss_function=loss)
    start = made.propagator.exposures(made.propagator.holograms(made.phase), slice(None), made.channel_power.cos())
    losses = []
    made.options = dataclasses.replace(made.options, callback=lambda _, value: losses.append(value.item()))
    made.gradient_descent(1, {"image": 1.0, "light": 0.0})
    assert losses[0] == pytest.approx((start - 1.8 * made.targets).square().sum().item(), rel=1e-5)
    plain.gradient_descent(1)
    assert max(brightest) == pytest.approx(1.8 * plain.targets.max().item())


def test_full_complex_beats_phase_only():
    def error(method):
        made = optimizer(method=method, frames=3, reduction="mean", optimize_peak_amplitude=True)
        amplitude, _, images, _, _, peak = made.optimize(35, {"eyebox": 0}, bits=None)
        assert (amplitude >= 0).all()
        return (images.sum(0) - peak * made.targets).square().mean() / peak**2

    assert error("full_complex_conventional") < 0.85 * error("conventional")


def test_double_phase_of_a_known_field_shows_it():
    """A field whose amplitude is written into a checkerboard of phases comes back where its band is let through."""
    show = display(colours=[515e-9], frames=1, planes=1, aperture_size=18)
    phase, amplitude = 0.5 * picture(*SIZE, seed=1), 0.3 + 0.6 * picture(*SIZE, seed=2)
    made = optimizer(mixed_color_hologram_optimizer, [515e-9], 1, 1, show)
    pattern, _ = made.double_phase_constrain(phase[None], torch.acos(amplitude)[None])
    field = show(torch.exp(1j * pattern[0]), 0, 0)
    expected = show(amplitude * torch.exp(1j * (phase - phase.mean())), 0, 0)
    inside = (slice(8, -8), slice(8, -8))
    error = torch.linalg.norm((field - expected)[inside]) / torch.linalg.norm(expected[inside])
    assert error < 0.05


def test_constraints():
    made = optimizer()
    phase, offset = torch.rand(3, *SIZE), torch.tensor([0.1, 0.2, 0.3])
    double, _ = made.double_phase_constrain(phase, offset)
    torch.testing.assert_close(double[1, 0, 0], phase[1, 0, 0] - 0.2)
    torch.testing.assert_close(double[1, 1, 1], phase[1, 1, 1] - 0.2)
    torch.testing.assert_close(double[1, 0, 1], phase[1, 0, 1] + 0.2)
    smooth, rough = made.direct_phase_constrain(phase, offset)
    torch.testing.assert_close(smooth.mean((1, 2)), -offset)
    assert made.direct_phase_constrain(0 * phase, offset)[1] < 1e-10 < rough
    # Equal parts: nothing is rough.
    assert made.double_phase_constrain(0 * phase, 0 * offset)[1] < 1e-10


def test_eyebox_wants_an_even_disc_and_nothing_else():
    made = optimizer(frames=1)
    rows, columns = torch.meshgrid(*(torch.arange(n) / n for n in SIZE), indexing="ij")
    inside = 2 * math.pi * (5 * rows + 2 * columns)[None]
    mask_size = sum((r - 5) ** 2 + (c - 2) ** 2 < 16 for r in range(-16, 16) for c in range(-20, 20))
    # One plane wave: its light is all inside, in one of the disc's samples.
    assert made.eyebox_constrain(inside, [5, 2], 8).item() == pytest.approx(mask_size - 1, rel=1e-3)
    # Outside it is all lost.
    assert made.eyebox_constrain(inside, [-5, 2], 1.5).item() > 0.99
    with pytest.raises(ValueError, match="eyebox must contain"):
        made.eyebox_constrain(inside, [100, 0], 4)


def test_eyebox_weight_gathers_light():
    def share(weight):
        made = optimizer(frames=1, colours=COLOURS[:1], planes=1, method="conventional", reduction="mean")
        phases = made.gradient_descent(60, {"eyebox": weight}, eyebox={"offset": [0, 0], "diameter": 14})
        spectrum = torch.fft.fftshift(torch.fft.fft2(torch.exp(1j * phases[0])).abs().square())
        return (spectrum[9:24, 13:28].sum() / spectrum.sum()).item()

    assert share(1.0) > share(0.0) + 0.2


def test_a_loss_is_called_with_what_it_takes():
    seen = []

    def newer(image, target, plane_id=None, noise_ratio=0, inject_noise=False):
        seen.append((plane_id, noise_ratio, inject_noise, tuple(image.shape)))
        return (image - target).square().sum()

    optimizer(loss_function=newer).gradient_descent(1, inject_noise=True, noise_ratio=0.5)
    assert seen == [(plane, 0.5, True, SIZE) for plane in range(2) for _ in range(3)]

    class Older(torch.nn.Module):
        def forward(self, image, target, plane_id):
            seen.append(plane_id)
            return (image - target).square().sum()

    seen.clear()
    optimizer(loss_function=Older()).gradient_descent(1)
    assert seen == [0, 0, 0, 1, 1, 1]
    # A loss that equals the default gives the same hologram.
    ours, given = (
        optimizer(loss_function=loss).gradient_descent(3) for loss in (None, torch.nn.MSELoss(reduction="sum"))
    )
    torch.testing.assert_close(ours, given, atol=1e-4, rtol=1e-4)


def test_noise_shakes_the_targets():
    quiet, loud = (optimizer().gradient_descent(3, inject_noise=noise, noise_ratio=0.5) for noise in (False, True))
    assert (quiet - loud).abs().max() > 1e-3
    torch.testing.assert_close(loud, optimizer().gradient_descent(3, inject_noise=True, noise_ratio=0.5))


@pytest.mark.parametrize("planes_at_once", [None, 1])
def test_camera_decides_the_loss(planes_at_once):
    made = optimizer(
        camera=lambda phases: seen_by_camera, show=display(memory_budget=planes_at_once), method="conventional"
    )
    seen_by_camera = torch.rand(2, 3, *SIZE)
    losses = []
    made.options = type(made.options)(progress=False, callback=lambda i, loss: losses.append(loss.item()))
    made.gradient_descent(2)
    expected = (seen_by_camera - made.targets).square().sum().item()
    assert losses == pytest.approx([expected, expected], rel=1e-5)
    bad = optimizer(camera=lambda phases: phases)
    with pytest.raises(ValueError, match="camera must return an image"):
        bad.gradient_descent(1)


def test_interruption_and_resumption(tmp_path):
    def interrupt(iteration, loss):
        if iteration == 4:
            raise KeyboardInterrupt

    path = tmp_path / "run.pt"
    whole = optimizer().optimize(9)
    stopped = optimizer(callback=interrupt, checkpoint=path, checkpoint_every=2).optimize(9)
    assert stopped[1].shape == whole[1].shape
    resumed = optimizer(checkpoint=path).optimize(9)
    for one, other in zip(whole, resumed, strict=True):
        assert torch.equal(torch.as_tensor(one), torch.as_tensor(other))
    for made, options, told in (
        (optimizer(checkpoint=path, learning_rate=0.2), {}, "learning_rate"),
        (optimizer(checkpoint=path, double_phase=False), {}, "double_phase"),
        (optimizer(checkpoint=path), {"eyebox": {"diameter": 6}}, "eyebox"),
        (optimizer(checkpoint=path), {"inject_noise": True}, "noise_ratio"),
    ):
        with pytest.raises(ValueError, match=f"its {told} differ"):
            made.optimize(9, **options)


def test_powers_of_a_checkpoint_that_are_not_learned_are_those_of_the_run(tmp_path):
    powers, path = tmp_path / "powers.pt", tmp_path / "run.pt"
    options = {"method": "conventional", "channel_power_filename": str(powers), "checkpoint": path}
    torch.save(torch.ones(3, 3), powers)
    optimizer(**options).optimize(2)
    torch.save(torch.eye(3), powers)
    with pytest.raises(ValueError, match="its channel_power differ"):
        optimizer(**options).optimize(2)


def test_older_form():
    made = optimizer(mixed_color_hologram_optimizer, learning_rate_floor=0.01)
    phases, images, powers, channel_powers, peak = made.optimize(30, weights=[1.0, 1.0, 0.1])
    assert images.shape == (3, 2, 3, *SIZE)
    assert powers.shape == channel_powers.shape == (3, 3)
    torch.testing.assert_close(made.reconstruct(phases), images)
    assert peak == 1.0
    base = made.phase.detach() - made.phase.detach().mean((1, 2), keepdim=True)
    torch.testing.assert_close(phases[:, 0, 1], (base + made.offset.detach())[:, 0, 1])
    assert made.gradient_descent(2).shape == (3, *SIZE)


def test_powers_from_a_file(tmp_path):
    path = tmp_path / "powers.pt"
    torch.save(torch.tensor([[2.0, 0.5, -1.0]] * 3), path)
    made = optimizer(channel_power_filename=str(path))
    torch.testing.assert_close(made.channel_power.detach(), torch.tensor([[1.0, 0.5, 0.0]] * 3))
    torch.save(torch.ones(2, 2), path)
    with pytest.raises(ValueError, match=r"channel_power_filename .* must contain"):
        optimizer(channel_power_filename=str(path))


def test_slm_model_is_optimised_through():
    class HalfLit(torch.nn.Module):
        def forward(self, phase, scale=1.0):
            return 0.7 * torch.exp(1j * phase * scale)

    made = optimizer(show=display(slm=HalfLit()), method="conventional")
    _, phases, images, _, _, _ = made.optimize(2, bits=None)
    torch.testing.assert_close(images, 0.49 * display().reconstruct(phases), rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"method": "monochrome"}, "method"),
        ({"reduction": "max"}, "reduction"),
        ({"scale_factor": 2}, "scale_factor must be the propagator's 1, got 2"),
        ({"initial_phase": torch.zeros(2, 4, 4)}, "initial_phase"),
    ],
)
def test_bad_options_are_named(change, message):
    with pytest.raises(ValueError, match=message):
        optimizer(**change)


def test_what_does_not_fit_the_propagator_is_named():
    show = display()
    targets = picture(2, 3, *SIZE)
    good = {"wavelengths": COLOURS, "resolution": list(SIZE), "targets": targets, "propagator": show,
            "number_of_frames": 3, "number_of_depth_layers": 2}  # fmt: skip
    for change, message in (
        ({"wavelengths": COLOURS[:2]}, "wavelengths must be the propagator's"),
        ({"resolution": [40, 32]}, "resolution must be the propagator's"),
        ({"number_of_frames": 2}, "number_of_frames must be the propagator's 3, got 2"),
        ({"number_of_depth_layers": 1}, "number_of_depth_layers must be the propagator's 2, got 1"),
        ({"targets": targets[:1]}, "targets must be"),
        ({"targets": targets[:, :2]}, "targets must be"),
        ({"targets": torch.full_like(targets, torch.inf)}, "targets must be finite"),
        ({"targets": -targets}, "targets must be finite intensities of at least 0"),
    ):
        with pytest.raises(ValueError, match=message):
            multi_color_hologram_optimizer(**(good | change))
    made = optimizer()
    for weights, message in (
        ({"picture": 1.0}, "'picture'"),
        ({"image": -1.0}, "must be at least 0"),
        ([1.0] * 5, "at most 4"),
    ):
        with pytest.raises(ValueError, match=message):
            made.optimize(1, weights)
    with pytest.raises(ValueError, match="bits"):
        made.optimize(1, bits=0)
