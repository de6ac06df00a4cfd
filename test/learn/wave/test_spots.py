"""Spot holograms as tensors: precision, gradients, and the names of both faces."""

import numpy as np
import pytest
import torch

import odak
from odak.learn import wave

WAVELENGTH, DX = 532e-9, 8e-6


def points(dtype=torch.float64):
    places = torch.tensor([-2e-4, 0.5e-4, 2.2e-4], dtype=dtype)
    y, x = torch.meshgrid(places, places, indexing="ij")
    depth = torch.linspace(0.05, 0.07, 9, dtype=dtype).reshape(3, 3)
    return torch.stack([x, y, depth], -1).reshape(9, 3)


def test_faces_are_one():
    for name in ("spot_hologram", "uniformity", "weighted_gerchberg_saxton"):
        assert getattr(wave, name) is getattr(odak.wave, name)


def test_spots_in_depth_are_even_and_precision_follows():
    hologram, spots = wave.spot_hologram(points(), (96, 128), WAVELENGTH, DX, seed=0)
    assert hologram.dtype == spots.dtype == torch.complex128
    assert float(wave.uniformity(spots.abs() ** 2)) > 0.98
    single, _ = wave.spot_hologram(points(torch.float32), (96, 128), WAVELENGTH, DX, seed=0)
    assert single.dtype == torch.complex64
    # Phases are formed in float64 from the points as float32 holds them.
    double, _ = wave.spot_hologram(points(torch.float32).double(), (96, 128), WAVELENGTH, DX, 1, seed=0)
    once, _ = wave.spot_hologram(points(torch.float32), (96, 128), WAVELENGTH, DX, 1, seed=0)
    assert (once - double).abs().max() < 1e-3 and (once - double).abs().mean() < 1e-5


def test_a_batch_is_shown_where_propagation_finds_it():
    frames = torch.stack([points(), points() * torch.tensor([-1.0, 1.0, 1.0])])
    hologram, spots = wave.spot_hologram(frames, (96, 96), WAVELENGTH, DX, 10, seed=0)
    assert hologram.shape == (2, 96, 96) and spots.shape == (2, 9)
    for frame in range(2):
        x, y, z = frames[frame, 4].tolist()
        tilt = wave.propagate_beam(hologram[frame], None, z, DX, WAVELENGTH, "Impulse Response Fresnel", scale=1)
        window = tilt.abs()[48 + round(y / DX) - 3 :, 48 + round(x / DX) - 3 :][:7, :7]
        assert divmod(int(window.argmax()), 7) in [(i, j) for i in (2, 3, 4) for j in (2, 3, 4)]


def test_light_of_a_spot_is_differentiable_in_its_place():
    place = points()[:2].clone().requires_grad_()

    def share(place):
        return wave.spot_hologram(place * 1e-4, (6, 7), WAVELENGTH, DX, 2, seed=0)[1].abs() ** 2

    assert torch.autograd.gradcheck(share, (place.detach().mul(1e4).requires_grad_(),), atol=1e-4)


def test_image_by_both_faces_is_the_same():
    target = np.zeros((24, 30))
    target[6:12, 8:20] = 0.7
    expected = odak.wave.weighted_gerchberg_saxton(target, 5, seed=4)
    result = wave.weighted_gerchberg_saxton(torch.from_numpy(target), 5, seed=4)
    for one, two in zip(result, expected, strict=True):
        np.testing.assert_allclose(one.numpy(), two, atol=1e-9)
    single = wave.weighted_gerchberg_saxton(torch.from_numpy(target).float(), 5, seed=4)
    assert single[0].dtype == torch.complex64


@pytest.mark.slow
def test_a_thousand_spots_in_space_on_a_full_panel():
    """Ten planes of a hundred spots at 1080 × 1920, evaluated by sums in double precision."""
    shape, focal, generator = (1080, 1920), 0.2, torch.Generator().manual_seed(0)
    y, x = torch.meshgrid(torch.arange(10.0) - 4.5, torch.arange(10.0) - 4.5, indexing="ij")
    planes = []
    for depth in torch.linspace(-9e-3, 9e-3, 10):
        places = 4e-4 * torch.stack([x, y], -1).reshape(-1, 2) + 2.5e-4 * (
            torch.rand(100, 2, generator=generator) - 0.5
        )
        planes.append(torch.cat([places, depth.expand(100, 1)], 1))
    spots = torch.cat(planes)
    hologram, claimed = wave.spot_hologram(spots, shape, WAVELENGTH, DX, 10, focal, seed=0)
    field = hologram.to(torch.complex128)
    down, across = (DX * (torch.arange(n, dtype=torch.float64) - n // 2) for n in shape)
    light = []
    for px, py, pz in spots.double().tolist():
        rows, columns = (
            torch.polar(
                torch.ones_like(along),
                -2 * torch.pi * (along * p / (WAVELENGTH * focal) + pz * along**2 / (2 * WAVELENGTH * focal**2)),
            )
            for along, p in ((down, py), (across, px))
        )
        light.append(float((rows @ field @ columns).abs() ** 2))
    light = np.array(light) / (1080 * 1920) ** 2
    np.testing.assert_allclose(light, claimed.abs().square().numpy(), rtol=1e-3)
    assert 1 - (light.max() - light.min()) / (light.max() + light.min()) > 0.995
    assert light.sum() > 0.78
