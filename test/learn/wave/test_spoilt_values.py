"""What is not a number, or has no end, is seen in the result: it is not taken for darkness or left out."""

from argparse import Namespace

import pytest
import torch

from odak.learn.tools import PerspectiveCamera
from odak.learn.wave import (
    Scene,
    StraightThroughEstimator,
    complex_3d_gaussians,
    intensity,
    multi_color_hologram_optimizer,
    propagator,
    simulated_camera,
    speckle_contrast,
    unit_phasor,
)

NAN = float("nan")
SETTINGS = Namespace(
    num_planes=1, wavelengths=[5e-7] * 3, pixel_pitch=8e-6, distances=[1e-3], pad_size=[16, 16], aperture_size=-1
)


def picture_with(value):
    picture = torch.linspace(0.1, 1, 64).reshape(8, 8)
    picture[2, 3] = value
    return picture


def test_speckle_contrast():
    contrast = speckle_contrast(2, (2, 2)).functional_conv2d(picture_with(NAN))
    assert bool(contrast.isnan().any())
    assert speckle_contrast(2)(torch.ones(4, 4)) == 0


def test_choices():
    choices = StraightThroughEstimator()(torch.tensor([[0.1, 0.7], [NAN, 0.2]]))
    assert choices[0].tolist() == [0, 1]
    assert bool(choices[1].isnan().any())


def test_a_sensor_saturates_in_light_without_end():
    camera = simulated_camera(5e-7, 0.0, 8e-6, exposure=0.5, full_well=1000.0, seed=0)
    assert camera.captured(picture_with(float("inf")))[2, 3] == 2
    captured = camera.captured(picture_with(NAN))
    assert bool(captured[2, 3].isnan())
    assert int(captured.isnan().sum()) == 1


def scene():
    return Scene(complex_3d_gaussians("random", "cpu", num_points=4, args_prop=SETTINGS, seed=1), SETTINGS)


def test_gaussians():
    world = scene()
    camera = PerspectiveCamera(torch.eye(3), torch.tensor([0.0, 0.0, 40.0]), [30.0, 30.0], [8.0, 8.0])
    assert bool(world.render(camera)[1].isfinite().all())
    world.gaussians.means[1, 2] = NAN
    assert bool(world.render(camera)[1].isnan().any())


def test_transmittance():
    alphas = torch.tensor([0.5, NAN, 0.5]).reshape(3, 1, 1)
    passed = scene().compute_transmittance(alphas).flatten()
    assert passed[:2].tolist() == [1, 0.5]
    assert bool(passed[2].isnan())


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16])
def test_halves_become_single_precision(dtype):
    phase = torch.tensor([0.0, 0.5, -1.0], dtype=dtype)
    assert unit_phasor(phase).dtype == torch.complex64
    torch.testing.assert_close(unit_phasor(phase), torch.polar(torch.ones(3), phase.float()))


def test_intensity_of_a_real_field_and_of_a_conjugate_view():
    field = torch.complex(torch.tensor([3.0, 1.0]), torch.tensor([4.0, -2.0])).requires_grad_()
    light = intensity(field.conj())
    light.sum().backward()
    assert light.tolist() == [25, 5]
    assert torch.equal(field.grad, 2 * field.detach())
    assert intensity(torch.tensor([3.0, -2.0])).tolist() == [9, 4]


def test_channel_powers_of_another_display_are_refused(tmp_path):
    torch.save(torch.ones(2, 2), tmp_path / "powers.pt")
    display = propagator([16, 16], [5e-7], propagator_type="forward", volume_depth=0, aperture="open")
    with pytest.raises(ValueError, match=r"channel_power_filename .* must contain a tensor \[1, 1\], got \[2, 2\]"):
        multi_color_hologram_optimizer(
            [5e-7], [16, 16], torch.rand(1, 1, 16, 16), display, 1, channel_power_filename=str(tmp_path / "powers.pt")
        )
