import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

import odak.tools
from odak.tools.matrix import blur_gaussian, crop_center, generate_2d_gaussian, quantize, smooth_pad, zero_pad

sides = st.integers(1, 9)


@settings(max_examples=30)
@given(st.lists(st.integers(1, 3), max_size=2), sides, sides, st.integers(0, 7), st.integers(0, 7))
def test_cropping_undoes_padding_for_every_parity(batch, rows, columns, more_rows, more_columns):
    field = np.arange(1.0, 1 + np.prod([*batch, rows, columns])).reshape(*batch, rows, columns)
    size = [rows + more_rows, columns + more_columns]
    padded = zero_pad(field, size)
    assert padded.shape == (*batch, *size)
    assert padded.sum() == field.sum()
    assert np.array_equal(padded[..., size[0] // 2, size[1] // 2], field[..., rows // 2, columns // 2])
    assert np.array_equal(crop_center(padded, [rows, columns]), field)
    assert np.array_equal(crop_center(zero_pad(field)), field)


@pytest.mark.parametrize("dtype", [np.float32, np.float64, np.complex64, np.complex128, np.int64])
def test_every_library_gives_the_same(as_array, dtype):
    field = np.arange(30).reshape(2, 3, 5).astype(dtype)
    for method in ("center", "left", "LEFT aligned"):
        padded = zero_pad(as_array(field), (7, 8), method)
        assert type(padded) is type(as_array(field))
        expected = np.zeros((2, 7, 8), dtype)
        top, left = (2, 2) if method == "center" else (0, 0)
        expected[:, top : top + 3, left : left + 5] = field
        assert np.array_equal(np.asarray(padded), expected)
        assert np.asarray(padded).dtype == dtype
    assert np.array_equal(np.asarray(crop_center(as_array(field))), field[:, 1:2, 1:3])


def test_the_crop_is_a_copy():
    field = np.ones((4, 4))
    crop_center(field)[:] = 7
    assert (field == 1).all()


def test_sizes_of_other_kinds():
    assert zero_pad(np.ones((2, 2)), np.array([1, 1, 3, 4])).shape == (3, 4)
    assert crop_center(np.ones((6, 6)), (1, 1, 3, 4)).shape == (3, 4)
    assert crop_center(np.ones((1, 6))).shape == (1, 3)


@pytest.mark.parametrize("function", [zero_pad, crop_center])
def test_refused(function):
    wrong = [2, 9] if function is zero_pad else [5, 4]
    with pytest.raises(ValueError, match=r"size must be at (least|most) the field's, \[4, 4\]"):
        function(np.ones((4, 4)), wrong)
    for size in ([4], 4, [0, 4]):
        with pytest.raises(ValueError, match="size"):
            function(np.ones((4, 4)), size)
    with pytest.raises(ValueError, match="field must have at least 2 axes"):
        function(np.ones(4))
    with pytest.raises(TypeError, match="field must be an array"):
        function([[1, 2], [3, 4]])


def test_levels(as_array):
    levels = quantize(as_array(np.array([0.0, 15.9, 16.0, 100.0, 255.0])), 4)
    assert np.asarray(levels).tolist() == [0, 0, 1, 6, 15]
    assert np.asarray(levels).dtype == np.int64
    assert np.asarray(quantize(as_array(np.arange(256)), 8)).tolist() == list(range(256))


def test_conversions_both_ways(random):
    import torch

    field = random.random((3, 4)) + 1j * random.random((3, 4))
    tensor = odak.tools.convert_to_torch(field)
    assert tensor.requires_grad
    assert tensor.dtype == torch.complex128
    back = odak.tools.convert_to_numpy(tensor.conj())
    assert np.array_equal(back, field.conj())
    with torch.no_grad():
        tensor.zero_()
    assert field.all()
    counts = odak.tools.convert_to_torch(np.arange(3), grad=False)
    assert counts.dtype == torch.int64
    with pytest.raises(TypeError, match=r"torch\.int64"):
        odak.tools.convert_to_torch(np.arange(3))


def test_gaussian_kernel():
    worked = [[0.053537, 0.088267, 0.053537], [0.083497, 0.137664, 0.083497]]
    kernel = generate_2d_gaussian([2, 3], [1, 1])
    np.testing.assert_allclose(kernel, worked + worked[::-1], atol=5e-7)
    # Rows follow the second length, and nsigma counts standard deviations to the edge.
    kernel = generate_2d_gaussian([6, 8], [3, 2])
    y, x = np.linspace(-2, 2, 9)[:, None], np.linspace(-3, 3, 7)
    expected = np.exp(-(x**2 + y**2) / 2)
    np.testing.assert_allclose(kernel, expected / expected.sum(), rtol=1e-13)


def test_gaussian_blur(as_array, random):
    field = random.random((2, 7, 10))
    kernel = generate_2d_gaussian([4, 2], [2, 1])
    expected = np.stack([ndimage.convolve(plane, kernel, mode="wrap") for plane in field])
    blurred = blur_gaussian(as_array(field), [4, 2], [2, 1], normalize=False)
    np.testing.assert_allclose(np.asarray(blurred), expected, rtol=1e-12)
    brightest = np.asarray(blur_gaussian(as_array(field), [4, 2], [2, 1]))
    np.testing.assert_allclose(brightest, expected / expected.max((-2, -1), keepdims=True), rtol=1e-12)
    for dtype, result in ((np.float32, np.float32), (np.uint8, np.float64)):
        blurred = np.asarray(blur_gaussian(as_array((255 * field).astype(dtype)), [4, 2], normalize=False))
        assert blurred.dtype == result
    assert not np.asarray(blur_gaussian(as_array(0 * field), [4, 2])).any()


def test_gaussians_refused():
    for wrong, message in (({"kernel_length": [0, 3]}, "kernel_length"), ({"nsigma": [1, 0]}, "nsigma")):
        with pytest.raises(ValueError, match=message):
            generate_2d_gaussian(**wrong)
    with pytest.raises(ValueError, match="nsigma must be two positive numbers"):
        generate_2d_gaussian(nsigma=[1, 2, 3])
    with pytest.raises(ValueError, match="kernel no larger than the field"):
        blur_gaussian(np.ones((4, 4)), [4, 3])
    with pytest.raises(TypeError, match="field must be a real array"):
        blur_gaussian(np.ones((4, 4), complex), [2, 2])


def test_quantised_levels_stay_within_their_bits():
    """What is not a number became the lowest 64-bit integer."""
    levels = quantize(np.array([np.nan, np.inf, -np.inf, -3.0, 300.0, 255.0]), bits=4)
    assert levels.tolist() == [0, 15, 0, 0, 15, 15]


def test_bfloat16_becomes_float32():
    array = odak.tools.convert_to_numpy(torch.tensor([1.5, -2.0], dtype=torch.bfloat16))
    assert (array.dtype, array.tolist()) == (np.float32, [1.5, -2.0])


def test_steep_windows_are_steps():
    field = np.ones((4, 4))
    assert np.array_equal(
        smooth_pad(field, [8, 8], smooth_factor=[1e3, 1e3]), smooth_pad(field, [8, 8], smooth_factor=[50, 50])
    )


def test_half_precision_is_convolved_in_single():
    field, kernel = np.arange(20, dtype=np.float16).reshape(4, 5), np.ones((3, 3), np.float16)
    expected = odak.tools.convolve2d(field.astype(np.float32), kernel.astype(np.float32))
    for dtype in (torch.float16, torch.bfloat16):
        found = odak.tools.convolve2d(*(torch.from_numpy(one).to(dtype) for one in (field, kernel)))
        np.testing.assert_allclose(found, expected, rtol=1e-5)
