"""Slanted edges of a known transfer function: Gaussian blur, square pixels, every pixel integrated in closed form."""

import numpy as np
import pytest
import torch
from scipy.special import ndtr

from odak.measurement import slanted_edge_mtf


def twice_integrated(x, sigma):
    """Second antiderivative of the Gaussian-blurred step."""
    tail = x * sigma * np.exp(-((x / sigma) ** 2) / 2) / np.sqrt(2 * np.pi)
    return ((x * x + sigma * sigma) * ndtr(x / sigma) + tail) / 2


def edge_picture(angle, sigma, shape=(100, 80), offset=0.3, low=0.1, high=0.9):
    """Picture of an edge `angle` degrees off the columns, seen by square pixels without gaps."""
    c, s = np.cos(np.radians(angle)), np.sin(np.radians(angle))
    row, column = np.indices(shape)
    distance = (column - shape[1] // 2 - offset) * c - (row - shape[0] // 2) * s
    step = sum(a * b * twice_integrated(distance + (a * c + b * s) / 2, sigma) for a in (1, -1) for b in (1, -1))
    return low + (high - low) * step / (c * s)


def transfer(frequency, angle, sigma):
    c, s = np.cos(np.radians(angle)), np.sin(np.radians(angle))
    return np.exp(-2 * (np.pi * sigma * frequency) ** 2) * np.sinc(frequency * c) * np.sinc(frequency * s)


@pytest.mark.parametrize("window", ["hamming", "tukey"])
@pytest.mark.parametrize("sigma", [0.2, 0.5, 1.0])
@pytest.mark.parametrize("angle", [2, 5, -5, 8, -12, 15])
def test_transfer_of_a_known_edge(angle, sigma, window):
    result = slanted_edge_mtf(edge_picture(angle, sigma), window=window)
    assert result.angle == pytest.approx(angle, abs=1e-3)
    # Hamming's wide shoulders cost more where the edge is soft.
    limit = 0.0035 if window == "hamming" else 0.0015
    assert np.abs(result.mtf - transfer(result.frequency, angle, sigma)).max() < limit
    assert result.frequency.max() == pytest.approx(1, abs=0.03)


def test_standard_without_correction_stays_within_its_own_error():
    result = slanted_edge_mtf(edge_picture(5, 0.5), correct_bins=False)
    below = result.frequency <= 0.5
    error = result.mtf - transfer(result.frequency, 5, 0.5)
    assert 0.002 < np.abs(error[below]).max() < 0.03


@pytest.mark.parametrize("turn", ["flipped", "negative", "transposed"])
def test_edge_of_either_direction_and_polarity(turn):
    picture = edge_picture(5, 0.4)
    picture = {"flipped": picture[:, ::-1], "negative": 1 - picture, "transposed": picture.T}[turn]
    result = slanted_edge_mtf(picture)
    assert abs(result.angle) == pytest.approx(5, abs=1e-3)
    assert np.abs(result.mtf - transfer(result.frequency, 5, 0.4)).max() < 0.003


def test_pitch_scales_frequencies_and_positions():
    picture = edge_picture(6, 0.5)
    one, scaled = slanted_edge_mtf(picture), slanted_edge_mtf(picture, pixel_pitch=0.004)
    np.testing.assert_allclose(scaled.frequency, one.frequency / 0.004, rtol=1e-12)
    np.testing.assert_allclose(scaled.position, one.position * 0.004, rtol=1e-12)
    assert scaled.frequency_at(0.5) == pytest.approx(one.frequency_at(0.5) / 0.004)
    # The edge spread runs from dark to bright through the middle at the edge itself.
    assert np.interp(0, one.position, one.edge_spread) == pytest.approx(0.5, abs=2e-3)
    assert one.edge_spread[0] == pytest.approx(0.1, abs=1e-3)


def test_mtf50_of_a_known_edge():
    result = slanted_edge_mtf(edge_picture(5, 0.8))
    fine = np.linspace(0, 1, 20001)
    expected = fine[np.argmax(transfer(fine, 5, 0.8) <= 0.5)]
    assert result.frequency_at() == pytest.approx(expected, rel=0.01)
    assert np.isnan(slanted_edge_mtf(edge_picture(5, 0.1)).frequency_at(1e-9))


@pytest.mark.parametrize("angle", [18.43, 26.5651, 30, 40, 44.9, 45, 50, 63.4, 85, -26.5, -45])
@pytest.mark.parametrize("shape", [(100, 80), (64, 64)])
def test_mtf50_at_any_angle(angle, shape):
    result = slanted_edge_mtf(edge_picture(angle, 0.5, shape))
    fine = np.linspace(0, 1, 20001)
    expected = fine[np.argmax(transfer(fine, angle, 0.5) <= 0.5)]
    assert result.frequency_at() == pytest.approx(expected, rel=0.008)
    below = result.frequency <= 0.5
    assert np.abs(result.mtf - transfer(result.frequency, angle, 0.5))[below].max() < 0.008


def test_noise_is_averaged(random):
    picture = edge_picture(5, 0.5, shape=(200, 60))
    result = slanted_edge_mtf(picture + 0.005 * random.normal(size=picture.shape), window="tukey")
    assert result.angle == pytest.approx(5, abs=0.02)
    below = result.frequency <= 0.5
    assert np.abs(result.mtf - transfer(result.frequency, 5, 0.5))[below].max() < 0.03


def test_curved_edges_need_a_curved_fit():
    row, column = np.indices((120, 80))
    bent = column - 40 - 0.09 * (row - 60) - 6e-4 * (row - 60) ** 2
    picture = ndtr(bent / 0.6)
    straight, curved = slanted_edge_mtf(picture), slanted_edge_mtf(picture, edge_degree=2)
    expected = np.exp(-2 * (np.pi * 0.6 * curved.frequency) ** 2)
    assert np.abs(curved.mtf - expected).max() < 0.02 < np.abs(straight.mtf[:20] - expected[:20]).max()


def test_torch_gives_the_same_and_a_gradient():
    picture = edge_picture(7, 0.5, shape=(24, 20))
    tensor = torch.from_numpy(picture).requires_grad_()
    ours, theirs = slanted_edge_mtf(picture), slanted_edge_mtf(tensor)
    for name in ("frequency", "mtf", "position", "edge_spread", "line_spread"):
        value = getattr(theirs, name)
        np.testing.assert_allclose(getattr(ours, name), value.detach().numpy(), atol=1e-10)
    # The place of the edge is held, so a numerical gradient over single pixels would differ. Scaling does not move it.
    scale = torch.tensor([0.7, 0.1], dtype=torch.float64, requires_grad=True)
    through = lambda p: slanted_edge_mtf(p[0] * tensor.detach() ** 2 + p[1]).edge_spread  # noqa: E731
    assert torch.autograd.gradcheck(through, (scale,), fast_mode=True)
    (slope,) = torch.autograd.grad(theirs.mtf[5], tensor)
    assert torch.isfinite(slope).all() and slope.abs().max() > 0


@pytest.mark.parametrize(
    ("picture", "message"),
    [
        (np.zeros((30, 30)), "must show one edge"),
        (np.ones((4, 30)).cumsum(1), "must show one edge"),
        (edge_picture(0.2, 0.5, shape=(40, 40)), "tilt it"),
        (np.zeros((3, 30, 30)), r"must be real, \[rows, columns\]"),
        (np.full((30, 30), np.nan), "finite"),
        (edge_picture(5, 0.5, shape=(60, 8)), "at least 5 pixels on either side"),
    ],
)
def test_pictures_without_a_usable_edge(picture, message):
    with pytest.raises(ValueError, match=message):
        slanted_edge_mtf(picture)
