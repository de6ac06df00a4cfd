"""What the optimizers of holograms share: checkpoints of their problems, brightness, seeded losses, schedules."""

import contextlib
import functools
import math

import pytest
import torch

from odak import ArgumentWarning
from odak.learn import wave
from odak.learn.wave import training


def interrupt_at(iteration):
    def callback(done, loss):
        if done == iteration:
            raise KeyboardInterrupt

    return callback


def test_schedules():
    rates = [training.cosine(0.4, 0.1, 8)(i) for i in range(9)]
    assert rates[0] == pytest.approx(0.4)
    assert rates[4] == pytest.approx(0.25)
    assert rates[8] == pytest.approx(0.1)
    assert rates[2] == pytest.approx(0.1 + 0.15 * (1 + math.cos(math.pi / 4)))
    assert [training.linear(0.4, 0.1, 3)(i) for i in range(4)] == pytest.approx([0.4, 0.3, 0.2, 0.1])


def test_a_checkpoint_of_another_problem_is_refused(tmp_path):
    path, target = tmp_path / "run.pt", torch.rand(12, 16, generator=torch.Generator().manual_seed(0))

    def run(target, wavelength=515e-9, distance=1e-3, pitch=8e-6, **others):
        return wave.stochastic_gradient_descent(
            target, wavelength, distance, pitch, n_iteration=2, seed=3, checkpoint=path, progress=False, **others
        )

    first = run(target)[0]
    torch.testing.assert_close(run(target)[0], first, rtol=0, atol=0)
    for other, told in (
        ({"target": 1 - target}, "its target differ"),
        ({"target": target, "wavelength": 633e-9}, "its wavelength differ"),
        ({"target": target, "distance": 2e-3, "pitch": 4e-6}, "its distance, pixel_pitch differ"),
        ({"target": target, "scale": True}, "its scale differ"),
        ({"target": target, "pixel_fill": 0.8}, "its pixel_fill differ"),
        ({"target": target, "propagation_type": "AS"}, "its propagation_type differ"),
    ):
        with pytest.raises(ValueError, match=told):
            run(**other)


def test_checkpoints_of_displays_know_their_planes(tmp_path):
    targets = torch.rand(2, 12, 16, generator=torch.Generator().manual_seed(0))

    def run(targets, wavelength=515e-9, stop=None):
        def interrupt(step, loss):
            assert loss.isfinite()
            if step == stop:
                raise KeyboardInterrupt

        return wave.multiplane_hologram_optimizer(
            wavelength, 0.0, 1e-3, 8e-6, [12, 16], targets, number_of_planes=2, number_of_iterations=4,
            checkpoint=tmp_path / "run.pt", progress=False, seed=5, callback=interrupt,
            aperture="open",
        ).optimize()[0]  # fmt: skip

    run(targets, stop=6)
    resumed = run(targets)
    for other in ((1 - targets,), (targets, 633e-9)):
        with pytest.raises(ValueError, match=r"is of another run: its (targets|display)"):
            run(*other)
    (tmp_path / "run.pt").unlink()
    torch.testing.assert_close(resumed, run(targets), rtol=0, atol=0)


def test_a_callback_stops_at_the_first_plane():
    made = wave.multiplane_hologram_optimizer(
        515e-9, 0.0, 1e-3, 8e-6, [12, 16], torch.rand(3, 12, 16), number_of_planes=3, number_of_iterations=4,
        progress=False, callback=lambda step, loss: True, aperture="open",
    )  # fmt: skip
    assert made.optimize()[0].isfinite().all()


class TestBrightness:
    """Targets brighter than the light there is issue a warning; those that are just reachable do not."""

    @staticmethod
    def expected(warns, message):
        return pytest.warns(ArgumentWarning, match=message) if warns else contextlib.nullcontext()

    @pytest.mark.parametrize("brightness", [1.0, 1.1, 200.0])
    def test_of_gradient_descent(self, brightness):
        def descend(**options):
            target = torch.full((16, 16), brightness)
            wave.stochastic_gradient_descent(target, 532e-9, 1e-3, 8e-6, n_iteration=1, progress=False, **options)

        message = "target must have a mean intensity of at most 1, .* got .* or scale=True"
        with self.expected(brightness > 1, message):
            descend()
        with self.expected(brightness == 200, "target reaches 200 where 1 is white"):
            descend(scale=True)

    def test_no_hologram_has_a_lower_error_than_is_stated(self):
        target = 2.4 * torch.rand(16, 16, generator=torch.Generator().manual_seed(0))
        with pytest.warns(ArgumentWarning, match="no hologram has a mean squared error below") as told:
            _, image = wave.stochastic_gradient_descent(
                target, 532e-9, 1e-4, 8e-6, n_iteration=60, optimizer="lbfgs", seed=0, progress=False
            )
        stated = float(str(told[0].message).partition(" error below ")[2].partition(":")[0])
        assert stated == pytest.approx((float(target.mean()) - 1) ** 2, rel=1e-2)
        assert stated < float((image.abs().square() - target).square().mean())

    @pytest.mark.parametrize("method", ["conventional", "multi-color"])
    @pytest.mark.parametrize("excess", [0.99, 1.01])
    def test_of_colours(self, method, excess):
        colours, size = [600e-9, 500e-9], [16, 16]
        display = wave.propagator(
            size, colours, 8e-6, number_of_frames=2, number_of_depth_layers=1, method=method, aperture="open"
        )
        # Each colour is shown in one frame, or in both.
        reachable = 1 if method == "conventional" else 2
        targets = torch.full((1, 2, *size), excess * reachable)
        with self.expected(excess > 1, f"targets must have a mean intensity of at most {reachable}"):
            wave.multi_color_hologram_optimizer(colours, size, targets, display, 2, method=method, progress=False)

    @pytest.mark.parametrize("brightness", [1.9, 2.1])
    def test_of_planes(self, brightness):
        targets = torch.full((1, 16, 16), brightness)
        half = (0, 0.5, 0, 1)
        with self.expected(brightness > 2, "targets must have a mean intensity of at most 1"):
            wave.multiplane_hologram_optimizer(
                532e-9,
                1e-3,
                1e-3,
                8e-6,
                [16, 16],
                targets,
                number_of_planes=1,
                mask_limits=half,
                progress=False,
                aperture="open",
            )


def noisy_loss(image, target, *plane, generator):
    return torch.nn.functional.mse_loss(image, target + 0.3 * torch.rand(target.shape, generator=generator))


def with_eyebox(loss, seed, **options):
    places = [[0.0, -1e-3], [0.0, 1e-3]]
    target = torch.rand(16, 16, generator=torch.Generator().manual_seed(0))
    return wave.eyebox_hologram(
        target, 532e-9, 0.1, 8e-6, places, iterations=4, loss_function=loss, seed=seed, progress=False, **options
    )[0]


def with_descent(loss, seed, **options):
    target = torch.rand(16, 16, generator=torch.Generator().manual_seed(0))
    return wave.stochastic_gradient_descent(
        target, 532e-9, 1e-3, 8e-6, n_iteration=4, loss_function=loss, seed=seed, progress=False, **options
    )[0]


def with_planes(loss, seed, **options):
    targets = torch.rand(2, 16, 16, generator=torch.Generator().manual_seed(0))
    optimizer = wave.multiplane_hologram_optimizer(
        532e-9, 0.0, 1e-3, 8e-6, [16, 16], targets, number_of_iterations=4, loss_function=loss, number_of_planes=2,
        mask_limits=[0, 1, 0, 1], seed=seed, progress=False, aperture="open", **options,
    )  # fmt: skip
    return optimizer.optimize()[0]


@pytest.mark.parametrize("optimized", [with_descent, with_eyebox, with_planes])
def test_a_seed_reaches_the_random_numbers_of_a_loss(optimized, tmp_path):
    torch.manual_seed(1)
    first, state = optimized(noisy_loss, 3), torch.get_rng_state()
    torch.manual_seed(2)
    assert torch.equal(optimized(noisy_loss, 3), first) and not torch.equal(optimized(noisy_loss, 4), first)
    torch.manual_seed(1)
    assert torch.equal(torch.get_rng_state(), state)
    # A run that is interrupted and taken up draws what it would have drawn.
    stop = {"callback": interrupt_at(1), "checkpoint": tmp_path / "run.pt"}
    optimized(noisy_loss, 3, **stop)
    assert torch.equal(optimized(noisy_loss, 3, checkpoint=tmp_path / "run.pt"), first)


def test_losses_that_bring_their_numbers_are_left_alone():
    own = torch.Generator().manual_seed(5)
    bound = functools.partial(noisy_loss, generator=own)
    cpu = torch.device("cpu")
    assert training.seeded_loss(bound, 3, cpu) == (bound, []) and training.seeded_loss(torch.dist, 3, cpu)[1] == []
    assert training.seeded_loss(None, 3, cpu) == (torch.nn.functional.mse_loss, [])
    target, before = torch.rand(1, 8, 8), own.get_state()
    module = wave.multiplane_loss(target, torch.zeros(8, 8), blur_ratio=3.0, number_of_planes=2, generator=own)
    loss, kept = training.seeded_loss(module, 3, cpu)
    assert kept == [loss.keywords["generator"], own] and torch.equal(own.get_state(), before)
