"""The customer's walk-through of hologram optimisation runs as printed."""

import numpy as np
import pytest
import torch
from PIL import Image

# The code lines of the customer's document, in its order.
WALK_THROUGH = """
from odak.learn.wave import stochastic_gradient_descent, calculate_amplitude, calculate_phase
import torch

wavelength = 0.000000532

dx = 0.0000064
resolution = [1080, 1920]

distance = 0.15

target = torch.zeros(resolution[0],resolution[1])
target[500:600,400:450] = 1.

iteration_number = 100
learning_rate = 0.1
cuda = True
propagation_type = 'TR Fresnel'

from odak.learn.wave import gerchberg_saxton

hologram, reconstructed = stochastic_gradient_descent(
        target,
        wavelength,
        distance,
        dx,
        resolution,
        'TR Fresnel',
        iteration_number,
        learning_rate=learning_rate,
        cuda=cuda
    )

from odak.learn.tools import save_image,load_image

reconstructed_intensity = calculate_amplitude(reconstructed)**2
save_image('reconstructed_image.png',reconstructed_intensity,cmin=0.,cmax=1.)

slm_range = 2*3.14
dynamic_range = 255
phase_hologram = calculate_phase(hologram)
phase_only_hologram = (phase_hologram%slm_range)/(slm_range)*dynamic_range

save_image('phase_only_hologram.png',phase_only_hologram)

from odak.learn.wave import linear_grating
grating = linear_grating(resolution[0],resolution[1],axis='y').to(phase_hologram.device)
phase_only_hologram_w_grating = phase_hologram+calculate_phase(grating)

phase_only_hologram_w_grating = (phase_only_hologram_w_grating%slm_range)/(slm_range)*dynamic_range
save_image('phase_only_hologram_w_grating.png',phase_only_hologram_w_grating)
"""

SMALL = {
    "resolution = [1080, 1920]": "resolution = [108, 192]",
    "target[500:600,400:450]": "target[50:60,40:45]",
    "distance = 0.15": "distance = 0.015",
}


def _run(text, folder, monkeypatch):
    monkeypatch.chdir(folder)
    namespace = {}
    torch.manual_seed(1)
    exec(text, namespace)
    return namespace


def _pixels(path):
    return np.asarray(Image.open(path)).astype(float)


def _check(names, folder):
    resolution = tuple(names["resolution"])
    assert (names["hologram"].abs() - 1).abs().max() < 1e-5
    assert names["reconstructed"].shape == resolution
    for name in ("phase_only_hologram.png", "phase_only_hologram_w_grating.png"):
        levels = _pixels(folder / name)
        assert levels.shape == resolution
        assert levels.min() == 0 and levels.max() == 255
    image = _pixels(folder / "reconstructed_image.png")
    assert image.shape == resolution and image.std() > 0
    assert np.corrcoef(image.ravel(), names["target"].numpy().ravel())[0, 1] > 0.9


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::odak.DeviceWarning")
def test_as_printed(tmp_path, monkeypatch):
    _check(_run(WALK_THROUGH, tmp_path, monkeypatch), tmp_path)


# It requires CUDA, which may not be available on the machine of the tests.
@pytest.mark.filterwarnings("ignore::odak.DeviceWarning")
def test_at_a_tenth_of_the_size(tmp_path, monkeypatch):
    text = WALK_THROUGH
    for printed, small in SMALL.items():
        assert printed in text
        text = text.replace(printed, small)
    _check(_run(text, tmp_path, monkeypatch), tmp_path)
