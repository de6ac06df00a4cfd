"""Older call forms of displays, optimizers and losses, and random numbers that do not depend on who else draws."""

import math
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
import torch

from odak import ArgumentWarning, MissingPackageWarning
from odak.learn import wave

COLOURS = [639e-9, 515e-9, 473e-9]
PITCH, SIZE = 8e-6, (16, 24)

pytestmark = pytest.mark.filterwarnings("ignore:blur_ratio:odak.AccuracyWarning")


def draw(*shape, seed=0):
    return torch.rand(*shape, generator=torch.Generator().manual_seed(seed))


def test_custom_without_a_kernel_is_refused():
    target = draw(8, 8)
    for call in (
        lambda: wave.stochastic_gradient_descent(target, 515e-9, 1e-3, PITCH, "custom", 1, progress=False),
        lambda: wave.gerchberg_saxton(target, 1, 1e-3, PITCH, 515e-9, propagation_type="custom"),
        lambda: wave.gerchberg_saxton_3d(target[None], 1, [1e-3], PITCH, 515e-9, propagation_type="Custom"),
        lambda: wave.shift_w_double_phase(target, 1e-3, PITCH, 515e-9, "custom"),
        lambda: wave.simulated_camera(515e-9, 1e-3, PITCH, "custom"),
        lambda: wave.propagator(SIZE, propagation_type="custom"),
    ):
        with pytest.raises(ValueError, match="'custom' needs a kernel"):
            call()


@pytest.mark.parametrize("kind", [float, np.float32, np.int64, bool])
def test_numbers_equal_to_zero_or_one_are_flags(kind):
    for number in (0, 1):
        display = wave.propagator(SIZE, vaccination=kind(number), aperture="open")
        assert display.vaccination is bool(number)
    for other in (0.5, 2.0, math.nan, "1.0", 1j):
        with pytest.raises(TypeError, match="vaccination must be True or False"):
            wave.propagator(SIZE, vaccination=other)


def colour_phases(seed, loss=None):
    display = wave.propagator(
        SIZE, COLOURS, PITCH, number_of_frames=3, number_of_depth_layers=2, propagator_type="forward", aperture="open",
        volume_depth=1e-3, vaccination=True, seed=seed,
    )  # fmt: skip
    made = wave.multi_color_hologram_optimizer(
        COLOURS, SIZE, draw(2, 3, *SIZE), display, number_of_depth_layers=2, progress=False, seed=seed,
        loss_function=loss,
    )  # fmt: skip
    return made.optimize(3, inject_noise=True, noise_ratio=0.1)[1]


def loss_of_planes():
    return wave.multiplane_loss(draw(3, *SIZE, seed=1), draw(*SIZE, seed=2), number_of_planes=2)


def single_phase(seed):
    hologram, _ = wave.stochastic_gradient_descent(
        draw(*SIZE), 515e-9, 1e-3, PITCH, n_iteration=3, seed=seed, progress=False
    )
    return hologram.angle()


def plane_phase(seed):
    return wave.multiplane_hologram_optimizer(
        515e-9, 0.0, 1e-3, PITCH, SIZE, draw(2, *SIZE), number_of_planes=2, number_of_iterations=2, progress=False,
        seed=seed, aperture="open",
    ).optimize()[0]  # fmt: skip


@pytest.mark.parametrize(
    "made",
    [
        single_phase,
        plane_phase,
        pytest.param(colour_phases, marks=pytest.mark.slow),
        pytest.param(lambda seed: colour_phases(seed, loss_of_planes()), marks=pytest.mark.slow),
    ],
)
def test_seeded_results_in_threads_are_the_serial_ones(made):
    seeds = [0, 1, 2, 3] * 4
    serial = [made(seed) for seed in seeds[:4]] * 4
    torch.manual_seed(7)
    before = torch.get_rng_state()
    with ThreadPoolExecutor(8) as threads:
        parallel = list(threads.map(made, seeds))
    assert torch.equal(before, torch.get_rng_state())
    for one, other in zip(serial, parallel, strict=True):
        assert torch.equal(one, other)
    assert not torch.equal(serial[0], serial[1])


def test_noise_of_a_resumed_run_is_that_of_an_uninterrupted_one(tmp_path):
    def run(stop=None, checkpoint=None):
        def callback(iteration, loss):
            if iteration == stop:
                raise KeyboardInterrupt

        display = wave.propagator(SIZE, COLOURS, PITCH, number_of_frames=3, vaccination=True, seed=4, aperture="open")
        made = wave.multi_color_hologram_optimizer(
            COLOURS, SIZE, draw(1, 3, *SIZE), display, progress=False, seed=3, checkpoint=checkpoint,
            callback=callback, loss_function=loss_of_planes(),
        )  # fmt: skip
        made.optimize(6, inject_noise=True, noise_ratio=0.1)
        return made.phase.detach()

    run(stop=2, checkpoint=tmp_path / "run.pt")
    assert torch.equal(run(checkpoint=tmp_path / "run.pt"), run())


def multi_colour(**options):
    display = wave.propagator(SIZE, COLOURS[:1], PITCH, aperture="open")
    targets = 0.5 * draw(1, 1, *SIZE)
    return wave.multi_color_hologram_optimizer(
        COLOURS[:1], SIZE, targets, display, 1, 1, seed=2, progress=False, **options
    )


def test_forms_of_the_multi_colour_optimizer_of_odak_0_2_7():
    made = multi_colour(learning_rate_floor=3e-3)
    assert made.min_learning_rate == 3e-3
    with pytest.raises(TypeError, match="learning_rate_floor are one argument"):
        multi_colour(learning_rate_floor=3e-3, min_learning_rate=1e-3)
    with pytest.warns(ArgumentWarning, match="scheduler_power has no effect"):
        assert torch.equal(multi_colour(scheduler_power=2).optimize(2)[1], multi_colour().optimize(2)[1])
    weights = [1.0, 1.0, 0.0]
    # An integer in third place is the bits, a number in fourth place of gradient_descent the ratio of the noise.
    older, newer = multi_colour().optimize(3, weights, 2), multi_colour().optimize(3, weights, bits=2)
    assert torch.equal(older[1], newer[1]) and len(older[1].unique()) <= 4
    older = multi_colour().optimize(3, weights, 2, True, 0.3)
    assert torch.equal(older[1], multi_colour().optimize(3, weights, None, 2, True, 0.3)[1])
    assert not torch.equal(older[1], newer[1])
    older = multi_colour().gradient_descent(3, weights, True, 0.3)
    assert torch.equal(older, multi_colour().gradient_descent(3, weights, True, noise_ratio=0.3))
    eyebox = {"offset": 0.0, "diameter": 5}
    assert torch.equal(
        multi_colour().optimize(3, [1, 0, 0, 1], eyebox, 8)[1], multi_colour().optimize(3, [1, 0, 0, 1], eyebox)[1]
    )


def test_a_phase_as_the_share_of_a_period():
    phase = torch.tensor([-1.0, 0.0, 2 * math.pi + 1.0], dtype=torch.float64)
    turn = 2 * math.pi
    expected = torch.tensor([255 * (1 - 1 / turn), 0.0, 255 / turn], dtype=torch.float64)
    torch.testing.assert_close(wave.normalize_phase(phase, period=turn, multiplier=255), expected)
    torch.testing.assert_close(wave.normalize_phase(phase, period=4.0), torch.remainder(phase, 4.0) / 4.0)
    with pytest.raises(ValueError, match="range_min and range_max exclude period"):
        wave.normalize_phase(phase, 0.0, 1.0, period=turn)


def test_gaussians_have_their_name_of_odak_0_2_7():
    with pytest.warns(DeprecationWarning, match="import it as odak.learn.wave.complex_3d_gaussians"):
        from odak.learn.wave.complex_gaussians import Gaussians
    assert Gaussians is wave.complex_3d_gaussians


def test_the_bar_stays_with_the_final_loss(capsys):
    losses = []
    wave.stochastic_gradient_descent(
        draw(*SIZE), 515e-9, 1e-3, PITCH, n_iteration=7, callback=lambda step, loss: losses.append(float(loss))
    )
    last = capsys.readouterr().err.rstrip("\n").split("\r")[-1]
    assert "7/7" in last
    assert f"loss={losses[-1]:.3g}" in last


def test_targets_of_multiplane_loss_go_to_multiplane_optimizer():
    loss = wave.multiplane_loss(draw(1, *SIZE), draw(*SIZE, seed=1), number_of_planes=8)
    targets = loss.get_targets()[0]
    assert targets.shape == (8, 1, *SIZE)

    def optimized(targets, planes):
        return wave.multiplane_hologram_optimizer(
            515e-9, 0.0, 1e-3, PITCH, SIZE, targets, number_of_planes=planes, number_of_iterations=2, progress=False,
            seed=0, loss_function=loss, aperture="open",
        ).optimize()[0]  # fmt: skip

    with pytest.warns(ArgumentWarning, match="targets hold 8 planes, of which the first 2 are used"):
        first_two = optimized(targets, 2)
    assert torch.equal(first_two, optimized(targets[:2, 0], 2))
    with pytest.raises(ValueError, match="targets must be"):
        optimized(targets, 9)


def test_perceptual_loss_by_default_takes_what_is_installed(monkeypatch):
    from odak.learn import perception

    def missing(*arguments, **options):
        raise ImportError("CVVDP needs pycvvdp: pip install cvvdp")

    monkeypatch.setattr(perception, "CVVDP", missing)
    picture, depth = draw(3, 16, 16), draw(16, 16, seed=1)
    with pytest.warns(MissingPackageWarning, match="leaves out 'cvvdp': CVVDP needs pycvvdp") as told:
        loss = wave.perceptual_multiplane_loss(picture, depth)
    assert len([one for one in told if one.category is MissingPackageWarning]) == 1
    assert loss(picture + 0.1, picture, 0).item() > 0
    with pytest.raises(ImportError, match="pip install cvvdp"):
        wave.perceptual_multiplane_loss(picture, depth, additional_loss_weights={"cvvdp": 1.0})


def test_one_target_channel_stands_for_all_colours():
    display = wave.propagator(SIZE, COLOURS, PITCH, number_of_frames=3, propagator_type="forward", aperture="open")

    def optimized(targets):
        made = wave.multi_color_hologram_optimizer(COLOURS, SIZE, targets, display, progress=False, seed=0)
        return made.optimize(2)[1]

    single = draw(1, 1, *SIZE)
    assert torch.equal(optimized(single), optimized(single.repeat(1, 3, 1, 1)))


# Without wrap-around all exact methods are one; the others are as propagate_beam has them.
METHODS = {
    "Rayleigh-Sommerfeld": "auto",
    "Bandextended Angular Spectrum": "auto",
    "Adaptive Sampling Angular Spectrum": "auto",
    "Fraunhofer": "Fraunhofer",
    "Fraunhofer Inverse": "Fraunhofer Inverse",
}


@pytest.mark.filterwarnings("ignore::odak.SamplingWarning")
@pytest.mark.parametrize("powers", [None, draw(3, 3)])
@pytest.mark.parametrize("method", METHODS)
def test_a_display_by_any_method_is_a_propagation(method, powers):
    phases = 2 * math.pi * draw(3, *SIZE)
    display = wave.propagator(
        SIZE, COLOURS, PITCH, number_of_frames=3, number_of_depth_layers=2, propagator_type="forward", aperture="open",
        propagation_type=method, laser_channel_power=powers, volume_depth=2e-3, image_location_offset=8e-3,
    )  # fmt: skip
    fields = display.reconstruct(phases, get_complex=True)
    for frame, plane, colour in ((0, 1, 0), (2, 0, 2), (1, 1, 1)):
        field, distance = wave.unit_phasor(phases[frame]), display.distances[plane].item()
        expected = wave.propagate_beam(field, None, distance, PITCH, COLOURS[colour], METHODS[method])
        own, bound = display.channel_power[frame, colour] * expected, 1e-4 * expected.abs().max().item()
        torch.testing.assert_close(fields[frame, plane, colour], own, rtol=1e-4, atol=bound)
        torch.testing.assert_close(display(field, colour, plane), expected, rtol=1e-4, atol=bound)
    if METHODS[method] == method:
        with pytest.raises(ValueError, match="has no transfer function"):
            display.get_kernels()


@pytest.mark.filterwarnings("ignore::odak.SamplingWarning", "ignore:.*propagates intensities:odak.AccuracyWarning")
def test_incoherent_displays_spread_intensity():
    display = wave.propagator(
        SIZE, COLOURS, PITCH, number_of_frames=3, propagator_type="forward", image_location_offset=1e-4,
        aperture="open",
        propagation_type="Incoherent Angular Spectrum",
    )  # fmt: skip
    picture = draw(*SIZE)
    expected = wave.propagate_beam(picture + 0j, None, 1e-4, PITCH, COLOURS[1], "Incoherent Angular Spectrum")
    torch.testing.assert_close(display(picture, 1, 0).real, expected.abs(), rtol=1e-4, atol=1e-5)
    shown = display.reconstruct(torch.zeros(3, *SIZE), picture.sqrt())[1, 0, 1]
    torch.testing.assert_close(shown, expected.abs(), rtol=1e-4, atol=1e-5)
