"""The optimizers of older scripts give the numbers that were recorded before they shared one loop."""

import pytest
import torch

from odak.learn import wave

COLOURS, PITCH = [639e-9, 515e-9], 8e-6


def random_numbers(*shape):
    return torch.rand(shape, generator=torch.Generator().manual_seed(5), dtype=torch.float64)


def descent(**options):
    target = 0.4 * random_numbers(16, 20)
    hologram, shown = wave.stochastic_gradient_descent(
        target, 532e-9, 2e-3, PITCH, n_iteration=6, seed=3, progress=False, **options
    )
    return hologram.real, hologram.imag, shown.abs()


def projections():
    field = random_numbers(16, 20) + 0j
    hologram, shown = wave.gerchberg_saxton(field, 6, 2e-3, PITCH, 532e-9, seed=3, progress=False)
    return hologram.real, hologram.imag, shown.abs()


def several_planes(**options):
    optimizer = wave.multiplane_hologram_optimizer(
        515e-9, 2e-3, 1e-3, PITCH, [16, 20], 0.4 * random_numbers(2, 16, 20), number_of_planes=2,
        number_of_iterations=4, propagator_type="forward", seed=3, progress=False, **options,
    )  # fmt: skip
    return optimizer.optimize()


def several_colours(kind=wave.multi_color_hologram_optimizer, weights=None, **options):
    display = wave.propagator(
        [16, 20], COLOURS, PITCH, number_of_frames=2, number_of_depth_layers=2, volume_depth=1e-3,
        image_location_offset=2e-3, propagator_type="forward",
    )  # fmt: skip
    optimizer = kind(
        COLOURS, [16, 20], 0.4 * random_numbers(2, 2, 16, 20), display, 2, 2, seed=3, progress=False, **options
    )
    found = optimizer.optimize(4, weights or {"eyebox": 0.2, "light": 0.1, "phase": 0.1})
    return [part for part in found if isinstance(part, torch.Tensor)]


def places_of_the_eye(**options):
    places = [[0.0, -1e-3], [0.0, 1e-3]]
    hologram, seen = wave.eyebox_hologram(
        random_numbers(2, 16, 20), 532e-9, 0.1, PITCH, places, iterations=4, seed=3, progress=False, **options
    )
    return hologram.real, hologram.imag, seen


def noisy(image, target, generator=None):
    noise = torch.randn(target.shape, dtype=target.dtype, generator=generator)
    return (image - target - 0.1 * noise).square().mean()


CASES = {
    "descent": (descent, {}),
    "descent by lbfgs": (descent, {"optimizer": "lbfgs", "scale": True, "initial_phase": "gs", "pixel_fill": 0.9}),
    "descent of frames": (descent, {"frames": 2, "initial_phase": "random", "loss_function": noisy}),
    "projections": (projections, {}),
    "planes": (several_planes, {}),
    "planes and frames": (several_planes, {"frames": 2, "pixel_fill": 0.9, "loss_function": wave.multiplane_loss(
        random_numbers(16, 20), random_numbers(16, 20), number_of_planes=2, blur_ratio=1.0)}),
    "colours": (several_colours, {}),
    "one colour in each frame": (several_colours, {"method": "conventional", "optimize_peak_amplitude": True}),
    "mixed colours": (
        several_colours, {"kind": wave.mixed_color_hologram_optimizer, "weights": {"light": 0.1, "phase": 0.1}}
    ),
    "places of the eye": (places_of_the_eye, {}),
    "places by lbfgs": (places_of_the_eye, {"optimizer": "lbfgs", "frames": 2, "loss_function": noisy}),
}  # fmt: skip


def summary(parts):
    """Return weighted sums of tensors, which change if any sample does."""
    sums = []
    for part in parts:
        values = part.detach().double().flatten()
        sums.append(float(values @ torch.cos(torch.arange(len(values), dtype=torch.float64))))
    return sums


RECORDED = {
    "descent": [-4.80894922, -4.86215625, -3.16167474],
    "descent by lbfgs": [2.102179, 8.31195601, -0.930624287],
    "descent of frames": [0.718303574, 6.29515938, 9.05017614],
    "projections": [5.36457278, 3.74772252, 2.48626402],
    "planes": [-1.70457248, -0.343719183, -16.0106877],
    "planes and frames": [-1.134912, -0.343719183, 1.66846972],
    "colours": [-0.524946678, -38.9375671, -6.06649342, 0.0668289382, 0.140786581],
    "one colour in each frame": [-0.524946678, -18.859184, -5.42571488, 0.0100075034, 0.0100075034],
    "mixed colours": [0.0486072832, 5.90439411, 0.0660140502, 0.141724481],
    "places of the eye": [6.59595985, 0.269891318, -2.06599552],
    "places by lbfgs": [4.7142711, 10.6053263, 0.0801435404],
}


@pytest.mark.parametrize("case", CASES)
def test_recorded_numbers(case):
    compute, options = CASES[case]
    assert summary(compute(**options)) == pytest.approx(RECORDED[case], rel=1e-6, abs=1e-6)
