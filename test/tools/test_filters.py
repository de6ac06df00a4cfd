import sys

import numpy as np
import pytest
import torch
from scipy import ndimage, signal

from odak.tools import matrix
from odak.tools.matrix import (
    convolve2d,
    correlation_2d,
    create_empty_list,
    generate_bandlimits,
    nufft2,
    nuifft2,
    smooth_pad,
)


@pytest.mark.parametrize("shape, small", [((8, 8), (8, 8)), ((9, 7), (9, 7)), ((6, 9), (3, 4)), ((5, 1), (2, 1))])
def test_convolution_is_scipys(random, shape, small):
    field, kernel = random.random((2, *shape)), random.random(small)
    # SciPy centres an even kernel at n//2 − 1 for origin 0 of a convolution; n//2 is one further back.
    origin = [0 if n % 2 else -1 for n in small]
    expected = [ndimage.convolve(plane, kernel, mode="wrap", origin=origin) for plane in field]
    direct = [_direct(plane, kernel) for plane in field]
    assert np.allclose(convolve2d(field, kernel), direct, rtol=0, atol=1e-12)
    if small == (9, 7):
        assert np.allclose(direct, expected, rtol=0, atol=1e-12)


def _direct(field, kernel):
    centre = [n // 2 for n in kernel.shape]
    result = np.zeros_like(field)
    for place, value in np.ndenumerate(kernel):
        result += value * np.roll(field, [p - c for p, c in zip(place, centre, strict=True)], axis=(0, 1))
    return result


def test_complex_convolution_and_every_library(random, as_array):
    field = random.random((4, 5)) + 1j * random.random((4, 5))
    kernel = random.random((4, 5))
    assert np.allclose(np.asarray(convolve2d(as_array(field), as_array(kernel))), _direct(field, kernel), atol=1e-12)
    result = convolve2d(as_array(field.real.astype(np.float32)), as_array(kernel.astype(np.float32)))
    assert np.asarray(result).dtype == np.float32
    assert np.asarray(convolve2d(as_array(np.eye(3, dtype=np.int64)), as_array(kernel[:3, :3]))).dtype == np.float64


@pytest.mark.parametrize("shape", [(6, 8), (5, 7)])
def test_correlation_finds_a_shift_and_is_scipys(random, shape, as_array):
    first = random.random(shape) + 1j * random.random(shape)
    second = random.random(shape) + 1j * random.random(shape)
    result = np.asarray(correlation_2d(as_array(first), as_array(second)))
    tiled = np.tile(first, (2, 2))
    shifts = signal.correlate2d(tiled, second, mode="valid")[: shape[0], : shape[1]]
    assert np.allclose(result, np.fft.ifftshift(shifts), atol=1e-12)
    moved = np.asarray(correlation_2d(as_array(np.roll(first, (2, -1), (0, 1))), as_array(first)))
    peak = np.unravel_index(np.abs(moved).argmax(), shape)
    assert peak == (((shape[0] + 1) // 2 + 2) % shape[0], (shape[1] + 1) // 2 - 1)


def test_gradients():
    field, kernel = torch.rand(2, 3, 4, dtype=torch.float64, requires_grad=True), torch.rand(2, 3, dtype=torch.float64)
    assert torch.autograd.gradcheck(convolve2d, (field, kernel.requires_grad_()), fast_mode=True)
    assert torch.autograd.gradcheck(
        lambda a, b: correlation_2d(a, b).abs(), (field[0] + 1, field[1] + 1), fast_mode=True
    )


@pytest.mark.parametrize("size", [(9, 12), (10, 11), (6, 5), (4, 5)])
@pytest.mark.parametrize("method", ["center", "left"])
def test_soft_border_is_the_edge_times_a_window(random, size, method, as_array):
    field = random.random((2, 4, 5)) + 1j * random.random((2, 4, 5))
    top, left = (size[0] // 2 - 2, size[1] // 2 - 2) if method == "center" else (0, 0)
    result = np.asarray(smooth_pad(as_array(field), size, method))
    assert np.array_equal(result[:, top : top + 4, left : left + 5], field)
    copies = np.pad(field, ((0, 0), (top, size[0] - 4 - top), (left, size[1] - 5 - left)), mode="edge")
    rows, columns = (_hann(start, n, total) for start, n, total in ((top, 4, size[0]), (left, 5, size[1])))
    assert np.allclose(result, copies * rows[:, None] * columns, atol=1e-12)


def _hann(start, n, total):
    """Halves of SciPy's Hann window around the content."""
    after = total - n - start
    rise = signal.windows.hann(2 * start - 1)[:start] if start > 1 else np.zeros(start)
    fall = signal.windows.hann(2 * after - 1)[after - 1 :] if after > 1 else np.ones(after)
    return np.concatenate([rise, np.ones(n), fall])


def test_soft_border_factors_and_gradient():
    soft, hard = (smooth_pad(np.full((10, 10), 100.0), smooth_factor=[f, f]) for f in (0.0, 0.5))
    assert soft[3, 5] > hard[3, 5] > 0
    assert soft[0, 0] < 1e-12
    line = smooth_pad(np.ones((1, 2)), [1, 10], smooth_factor=[0.5, 0.0])[0]
    assert np.allclose(line[:4], [0, 0.5**10, np.cos(np.pi / 6) ** 10, 1], atol=1e-12)
    field = torch.rand(3, 3, requires_grad=True)
    smooth_pad(field).sum().backward()
    assert torch.equal(field.grad, torch.ones(3, 3))
    with pytest.raises(TypeError, match="field must have a floating-point dtype"):
        smooth_pad(np.ones((2, 2), int))
    with pytest.raises(ValueError, match="smooth_factor must be two numbers"):
        smooth_pad(np.ones((2, 2)), smooth_factor=[1.0])


def test_nonuniform_transforms_at_the_uniform_places_are_ffts(random, monkeypatch):
    monkeypatch.setattr(matrix, "_BLOCK", 64)
    field = random.random((6, 5)) + 1j * random.random((6, 5))
    frequencies = np.meshgrid(2 * np.pi * np.fft.fftfreq(6), 2 * np.pi * np.fft.fftfreq(5), indexing="ij")
    centred = np.roll(field, (3, 2), (0, 1))
    assert np.allclose(nufft2(centred, *frequencies, sign=-1), np.fft.fft2(field), atol=1e-11)
    modes = nuifft2(field, *frequencies) / field.size
    assert np.allclose(modes, np.roll(np.fft.ifft2(field), (3, 2), (0, 1)), atol=1e-12)


def test_nonuniform_transforms_are_adjoint(random):
    field, values = random.random((7, 4)) + 0j, random.random(9) + 1j * random.random(9)
    fx, fy = random.uniform(-np.pi, np.pi, (2, 9))
    there, back = nufft2(field, fx, fy, size=[3, 3]), nuifft2(values, fx, fy, size=[7, 4], sign=-1)
    assert there.shape == (3, 3)
    assert np.vdot(values, there.ravel()) == pytest.approx(np.vdot(back, field), rel=1e-10)


def test_large_transform_asks_for_finufft(monkeypatch):
    monkeypatch.setitem(sys.modules, "finufft", None)
    monkeypatch.setattr(matrix, "_LARGEST_SUM", 10)
    with pytest.raises(ImportError, match="pip install finufft"):
        nufft2(np.ones((2, 3)), np.ones(6), np.ones(6))


def test_finufft_agrees_with_the_sum(random, monkeypatch):
    pytest.importorskip("finufft")
    field, (fx, fy) = random.random((12, 9)) + 0j, random.uniform(-3, 3, (2, 12, 9))
    fast = nufft2(field, fx, fy), nuifft2(field, fx, fy)
    monkeypatch.setitem(sys.modules, "finufft", None)
    assert np.allclose(fast[0], nufft2(field, fx, fy), atol=1e-9)
    assert np.allclose(fast[1], nuifft2(field, fx, fy), atol=1e-9)


@pytest.mark.parametrize(
    "arguments, message",
    [
        ({"sign": 2}, "sign must be 1 or -1"),
        ({"size": [2, 2]}, "size must have as many samples as fx, 6"),
        ({"fy": np.ones(5)}, "fx and fy must have the same size, got 6 and 5"),
        ({"field": np.ones(6)}, "field must be"),
    ],
)
def test_nonuniform_refuses(arguments, message):
    with pytest.raises(ValueError, match=message):
        nufft2(**{"field": np.ones((2, 3)), "fx": np.ones(6), "fy": np.ones(6)} | arguments)


def test_octave_rings_tile_the_band():
    rings = generate_bandlimits([64, 32], 4)
    assert rings.shape == (4, 64, 32)
    # Each frequency but the innermost box belongs to exactly one ring of each size ratio.
    total = rings.sum(0)
    box = np.zeros((64, 32))
    box[32 - 2 : 32 + 2, 16 - 1 : 16 + 1] = 1
    assert np.array_equal(total, 1 - box)
    assert rings[0].sum() == 64 * 32 * 3 / 4


def test_lists_of_their_own():
    lists = create_empty_list([2, 2, 1])
    lists[0][1][0] = 5
    assert lists == [[[0], [5]], [[0], [0]]]
    assert create_empty_list([]) == 0
