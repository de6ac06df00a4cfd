"""Likely mistakes of first programs: each message names what was given, and what endangers a result warns."""

import numpy as np
import pytest
import torch

import odak
from odak.learn import perception, wave
from odak.learn.tools import load_image, resize, save_image

WAVELENGTH, PITCH, DISTANCE = 532e-9, 8e-6, 1e-3


@pytest.mark.parametrize(
    "call",
    [
        lambda array: perception.MetamericLoss()(array, array),
        lambda array: perception.srgb_to_lab(array),
        lambda array: resize(array),
        lambda array: wave.propagator(resolution=[8, 8]).reconstruct(array),
    ],
)
def test_an_array_in_place_of_a_tensor_is_called_an_array(call):
    with pytest.raises(TypeError, match="got ndarray"):
        call(np.ones((1, 3, 64, 64)))


@pytest.mark.parametrize("count", [5.0, -1.0, 0.0])
def test_iterations_that_are_no_integer_are_named(count):
    with pytest.raises(TypeError, match="n_iterations must be an integer, got float"):
        wave.gerchberg_saxton(torch.ones(8, 8), count, DISTANCE, PITCH, WAVELENGTH)


@pytest.mark.parametrize(
    "call",
    [
        lambda picture: wave.propagate_beam(picture, None, DISTANCE, PITCH, WAVELENGTH),
        lambda picture: wave.stochastic_gradient_descent(picture, WAVELENGTH, DISTANCE, PITCH, n_iteration=1),
        lambda picture: wave.gerchberg_saxton(picture, 1, DISTANCE, PITCH, WAVELENGTH),
    ],
)
@pytest.mark.filterwarnings("ignore::odak.SamplingWarning")
def test_a_picture_with_its_colours_last_is_pointed_out(call):
    picture = torch.rand(16, 20, 3)
    with pytest.warns(odak.ArgumentWarning, match="16 planes of 20 x 3 samples"):
        call(picture)
    call(picture.movedim(-1, 0))


def test_a_gaze_in_pixels_is_pointed_out():
    picture = torch.rand(1, 3, 64, 64)
    loss = perception.BlurLoss()
    with pytest.warns(odak.ArgumentWarning, match="divide pixels"):
        loss(picture, picture, gaze=[32, 24])
    loss(picture, picture, gaze=[-0.5, 1.5])


def test_an_image_slightly_above_one_is_not_saved_black_unnoticed(tmp_path):
    image = torch.tensor([[0.0, 0.5, 1.0001]])
    with pytest.warns(odak.ArgumentWarning, match="give cmax=1.0"):
        save_image(tmp_path / "dark.png", image)
    save_image(tmp_path / "bright.png", image, cmax=1.0)
    assert load_image(tmp_path / "bright.png")[0].tolist() == pytest.approx([0.0, 128 / 255, 1.0])
    save_image(tmp_path / "levels.png", torch.tensor([[0.0, 100.0, 255.0]]))


def test_powers_are_named_with_spaces_underscores_or_hyphens():
    for method in ("multi-color", "multi_color", "Multi color"):
        assert wave.propagator(resolution=[8, 8], method=method).method == "multi-color"
    with pytest.raises(ValueError, match="got 'mixed_color'"):
        wave.propagator(resolution=[8, 8], method="mixed_color")
