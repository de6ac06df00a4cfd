"""Frames shown one after another: the settling of a modulator against closed forms, and every optimizer with frames."""

import math

import numpy as np
import physics
import pytest
import torch

from odak import AccuracyWarning
from odak.learn import wave

PITCH, SIZE, COLOURS = 8e-6, (32, 40), [639e-9, 515e-9, 473e-9]
# N·dx²/λ of the shorter side: where kernels sampled on the padded grid wrap around most.
CRITICAL = SIZE[0] * PITCH**2 / COLOURS[1]


def picture(*shape, seed=0):
    coarse = torch.rand(*shape[:-2], 4, 5, generator=torch.Generator().manual_seed(seed))
    fine = torch.nn.functional.interpolate(coarse.reshape(1, -1, 4, 5), shape[-2:], mode="bicubic")
    return fine.clamp(0, 1).reshape(shape)


def decibels(image, target):
    image, target = np.asarray(image, dtype=np.float64), np.asarray(target, dtype=np.float64)
    scale = (image * target).sum() / (image**2).sum()
    return -10 * math.log10(((scale * image - target) ** 2).mean())


def judged(fields, distance, wavelength, cutoff=np.inf):
    """Return the mean intensity of fields shown one after another, by a propagation without wrap-around."""
    fields = np.stack([field.numpy() for field in fields])
    return (abs(physics.unwrapped_propagation(fields, distance, PITCH, wavelength, cutoff, 12)) ** 2).mean(0)


def test_settling_is_exponential_and_periodic():
    modulator = wave.temporal_modulator(1e-3, 4e-4, time_samples=50)
    phases = torch.tensor([0.0, 2.0, 1.0], dtype=torch.float64)[:, None, None]
    shown = modulator.displayed_phase(phases)[:, 0, 0].numpy().reshape(3, 50)
    times = (np.arange(50) + 0.5) / 50 * 1e-3
    # The equation of the cell in small steps of Euler, until it repeats itself.
    state, steps, found = 0.0, 20000, []
    for _ in range(12):
        found = []
        for wanted in (0.0, 2.0, 1.0):
            path = wanted + (state - wanted) * np.cumprod(np.full(steps, 1 - 1e-3 / steps / 4e-4))
            found.append(np.interp(times, (np.arange(steps) + 1) * 1e-3 / steps, path))
            state = path[-1]
    np.testing.assert_allclose(shown, np.stack(found), atol=2e-4)
    np.testing.assert_allclose(modulator.weights(3).sum(1), 1, atol=1e-14)


def test_limits_of_the_response():
    phases = torch.rand(4, 5, 6, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    fast = wave.temporal_modulator(1.0, 0.0, time_samples=2)
    assert torch.equal(fast.displayed_phase(phases), phases.repeat_interleave(2, 0))
    slow = wave.temporal_modulator(1.0, 1e6, time_samples=2).displayed_phase(phases)
    torch.testing.assert_close(slow, phases.mean(0).expand(8, -1, -1), atol=1e-5, rtol=0)
    late = wave.temporal_modulator(1.0, 0.1, lit=(0.9, 1.0), time_samples=1).displayed_phase(phases)
    torch.testing.assert_close(late, phases, atol=math.exp(-9), rtol=0)
    coarse = wave.temporal_modulator(1.0, 0.0, wave.spatial_light_modulator(bits=1), time_samples=1)
    assert set(coarse.displayed_phase(6 * phases).unique().tolist()) <= {0.0, math.pi}
    single = wave.temporal_modulator(1.0, 5.0)(phases[:1].float())
    assert single.dtype == torch.complex64
    torch.testing.assert_close(single, wave.unit_phasor(phases[:1].float()).expand(4, -1, -1))


def test_slopes_of_settling():
    phases = torch.rand(2, 2, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(0), requires_grad=True)
    modulator = wave.temporal_modulator(1.0, 0.5, time_samples=2)
    assert torch.autograd.gradcheck(modulator, (phases,), fast_mode=True)


def shown_light(phases, distance, rate, instants=24):
    """Return the mean intensity of frames that settle, by steps of the closed form and an independent propagation."""
    phases, state, fields = phases.double().numpy(), phases.double().mean(0).numpy(), []
    for _ in range(3):
        fields = []
        for wanted in phases:
            for instant in range(instants):
                left = math.exp(-rate * (instant + 0.5) / instants)
                fields.append(torch.from_numpy(np.exp(1j * (wanted + (state - wanted) * left))))
            state = wanted + (state - wanted) * math.exp(-rate)
    return judged(fields, distance, COLOURS[1])


def test_a_slow_modulator_is_made_up_for():
    """Three frames on a cell that needs a third of the frame time to settle."""
    target, distance, ends = picture(*SIZE), 0.7 * CRITICAL, {}
    modulator = wave.temporal_modulator(1e-3, 3e-4, time_samples=5)
    for name, slm in (("blind", None), ("knowing", modulator)):
        phases = {}
        hologram, image = wave.stochastic_gradient_descent(
            target, COLOURS[1], distance, PITCH, slm=_Keeping(slm, phases), n_iteration=40, scale=True, frames=3,
            initial_phase="quadratic", seed=0, progress=False,
        )  # fmt: skip
        ends[name] = decibels(shown_light(phases["last"], distance, 1e-3 / 3e-4, 10), target)
    assert hologram.shape == (15, *SIZE)
    assert abs(decibels(wave.intensity(image).mean(0), target) - ends["knowing"]) < 1
    assert ends["knowing"] > ends["blind"] + 3


class _Keeping(torch.nn.Module):
    """A modulator that keeps the last phase it was given."""

    def __init__(self, slm, kept):
        super().__init__()
        self.slm, self.kept = slm, kept

    def forward(self, phase):
        self.kept["last"] = phase.detach().clone()
        return wave.unit_phasor(phase) if self.slm is None else self.slm(phase)


@pytest.mark.parametrize("method", ["conventional", "multi-color"])
def test_more_frames_than_colours(method):
    """Two frames for each colour are better than one, and what is claimed is what is shown."""
    target, ends = picture(1, 2, *SIZE), {}
    for frames in (2, 4):
        display = wave.propagator(
            SIZE,
            COLOURS[:2],
            PITCH,
            number_of_frames=frames,
            distances=[0.6 * CRITICAL],
            propagator_type="forward",
            aperture="open",
        )
        made = wave.multi_color_hologram_optimizer(
            COLOURS[:2], SIZE, target, display, frames, 1, learning_rate=0.2, method=method, reduction="mean",
            optimize_peak_amplitude=True, progress=False, seed=0,
        )  # fmt: skip
        _, phases, images, powers, _, _ = made.optimize(25, {"eyebox": 0, "light": 0}, bits=None)
        shown = []
        for colour, wavelength in enumerate(COLOURS[:2]):
            fields = [powers[f, colour] * wave.unit_phasor(phases[f]) for f in range(frames)]
            shown.append(judged([field for field in fields if field.abs().max() > 0], 0.6 * CRITICAL, wavelength))
            claimed = images.sum(0)[0, colour]
            assert abs(decibels(claimed, target[0, colour]) - decibels(shown[-1], target[0, colour])) < 0.3
        if method == "conventional":
            assert powers.tolist() == [[1, 0], [0, 1]] * (frames // 2)
        ends[frames] = np.mean([decibels(light, target[0, c]) for c, light in enumerate(shown)])
    assert ends[4] > ends[2] + 1.5


@pytest.mark.parametrize("frames", [1, 3])
def test_older_optimizer_with_frames(frames):
    target = picture(1, 1, *SIZE)
    display = wave.propagator(
        SIZE,
        COLOURS[1:2],
        PITCH,
        number_of_frames=frames,
        distances=[0.6 * CRITICAL],
        propagator_type="forward",
        aperture="open",
    )
    made = wave.mixed_color_hologram_optimizer(
        COLOURS[1:2], SIZE, target, display, frames, learning_rate=0.2, method="conventional", double_phase=False,
        optimize_peak_amplitude=True, progress=False, seed=0,
    )  # fmt: skip
    phases, images, *_ = made.optimize(30, {"light": 0.0})
    shown = judged([wave.unit_phasor(phase) for phase in phases], 0.6 * CRITICAL, COLOURS[1])
    assert abs(decibels(images.sum(0)[0, 0], target[0, 0]) - decibels(shown, target[0, 0])) < 0.3


def test_double_phase_needs_its_iris():
    target, distance = torch.nn.functional.avg_pool2d(picture(1, 1, *SIZE), 5, 1, 2)[0, 0], 0.5 * CRITICAL
    hologram, image = wave.double_phase_hologram(target, COLOURS[1], distance, PITCH)
    assert (hologram.abs() - 1).abs().max() < 1e-6
    claimed = decibels(wave.intensity(image), target)
    assert abs(claimed - decibels(judged([hologram], distance, COLOURS[1], 0.25 / PITCH), target)) < 0.3
    named, _ = wave.double_phase_hologram(
        target, COLOURS[1], distance, PITCH, iris_radius=0.25 / PITCH * COLOURS[1] * 0.1, iris_focal_length=0.1
    )
    torch.testing.assert_close(named, hologram)
    with pytest.warns(AccuracyWarning, match="there is no iris"):
        bare, image = wave.double_phase_hologram(target, COLOURS[1], distance, PITCH, iris=False)
    without = decibels(judged([bare], distance, COLOURS[1]), target)
    assert abs(decibels(wave.intensity(image), target) - without) < 0.3
    assert claimed > without + 8
    with pytest.warns(AccuracyWarning, match="passes more than that"):
        wave.double_phase_hologram(target, COLOURS[1], distance, PITCH, iris_radius=5e-3, iris_focal_length=0.1)


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        ({"frame_time": 0.0}, ValueError, "frame_time must be positive"),
        ({"response_time": -1.0}, ValueError, "response_time must be at least 0"),
        ({"lit": (0.5, 0.5)}, ValueError, "lit must be the start and the end"),
        ({"time_samples": 0}, ValueError, "time_samples must be at least 1"),
    ],
)
def test_bad_arguments_are_named(change, error, message):
    with pytest.raises(error, match=message):
        wave.temporal_modulator(**{"frame_time": 1.0, "response_time": 0.1, **change})


def test_displays_take_one_field_for_each_frame():
    with pytest.raises(ValueError, match="one field for each frame"):
        wave.propagator([8, 8], slm=wave.temporal_modulator(1.0, 0.1))
