"""The blur that grows away from the gaze, against a pixel-by-pixel MIP pyramid; the loss made of it."""

import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from odak.learn.perception import BlurLoss, RadiallyVaryingBlur, make_equi_pooling_size_map_lod

STRONG = {"alpha": 2.0, "real_image_width": 0.5, "real_viewing_distance": 0.4, "centre": [0.3, 0.6]}


def noise(*shape, seed=0):
    return torch.rand(*shape, dtype=torch.float64, generator=torch.Generator().manual_seed(seed))


def trilinear(picture, lod):
    """Blur with plain loops: a chain of 2 × 2 means, bilinear within a level, linear between levels."""
    chain = [picture]
    while chain[-1].shape != (1, 1):
        chain.append(chain[-1].reshape(chain[-1].shape[0] // 2, 2, chain[-1].shape[1] // 2, 2).mean((1, 3)))

    def sample(level, i, j):
        level = chain[min(level, len(chain) - 1)]
        result = 0.0
        (rows, columns), (height, width) = level.shape, picture.shape
        y = max((i + 0.5) * rows / height - 0.5, 0)
        x = max((j + 0.5) * columns / width - 0.5, 0)
        for row, share_y in ((math.floor(y), 1 - y % 1), (math.floor(y) + 1, y % 1)):
            for column, share_x in ((math.floor(x), 1 - x % 1), (math.floor(x) + 1, x % 1)):
                result += share_y * share_x * level[min(row, rows - 1), min(column, columns - 1)]
        return result

    result = np.empty_like(picture)
    for i, j in np.ndindex(*picture.shape):
        floor = math.floor(lod[i, j])
        part = lod[i, j] - floor
        result[i, j] = (1 - part) * sample(floor, i, j) + part * sample(floor + 1, i, j)
    return result


def test_against_loops_over_pixels():
    picture = noise(1, 1, 16, 16)
    blur = RadiallyVaryingBlur()
    result = blur.blur(picture, **STRONG)
    assert blur.lod_map.max() > 2
    torch.testing.assert_close(blur.lod_fraction, blur.lod_map % 1)
    expected = trilinear(picture[0, 0].numpy(), blur.lod_map.numpy())
    torch.testing.assert_close(result[0, 0], torch.from_numpy(expected), rtol=0, atol=1e-12)
    sharp = blur.lod_map == 0
    assert sharp.any()
    assert torch.equal(result[0, 0][sharp], picture[0, 0][sharp])


@settings(max_examples=25)
@given(st.integers(1, 40), st.integers(1, 40), st.floats(0, 5), st.booleans())
def test_a_constant_stays_and_the_blur_is_linear(rows, columns, alpha, equi):
    blur = RadiallyVaryingBlur()
    options = {"alpha": alpha, "centre": [0.2, 0.7], "equi": equi, "mode": "linear"}
    constant = torch.full((1, 2, rows, columns), 0.7, dtype=torch.float64)
    torch.testing.assert_close(blur.blur(constant, **options), constant)
    one, two = noise(1, 2, rows, columns), noise(1, 2, rows, columns, seed=1)
    torch.testing.assert_close(
        blur.blur(2 * one - two, **options), 2 * blur.blur(one, **options) - blur.blur(two, **options)
    )


def test_the_map_follows_the_gaze_the_size_and_the_precision():
    blur, gaze = RadiallyVaryingBlur(), [0.1, 0.1]
    picture = noise(2, 3, 32, 32)
    first = blur.blur(picture, 2.0, 0.5, 0.4, gaze)
    kept = blur.lod_map
    blur.blur(picture, 2.0, 0.5, 0.4, gaze)
    assert blur.lod_map is kept
    gaze[0] = 0.9
    moved = blur.blur(picture, 2.0, 0.5, 0.4, gaze)
    assert not torch.equal(first, moved)
    place = torch.tensor([0.9, 0.1], dtype=torch.float64)
    torch.testing.assert_close(moved, RadiallyVaryingBlur().blur(picture, 2.0, 0.5, 0.4, place))
    assert blur.blur(picture.float(), 2.0, 0.5, 0.4, gaze).dtype == torch.float32
    assert blur.blur(picture, 2.0, 0.5, 0.4, gaze).dtype == torch.float64
    assert blur.blur(picture[..., :20, :], 2.0, 0.5, 0.4, gaze).shape == (2, 3, 20, 32)
    assert blur.size == (20, 32)
    assert torch.equal(blur.blur(picture), blur.blur(picture, centre=[0.5, 0.5]))


def test_a_batch_is_its_items():
    picture, blur = noise(3, 2, 20, 30), RadiallyVaryingBlur()
    whole = blur.blur(picture, **STRONG)
    torch.testing.assert_close(whole, torch.cat([blur.blur(item[None], **STRONG) for item in picture]))


def test_equirectangular():
    blur = RadiallyVaryingBlur()
    blur.blur(noise(1, 1, 16, 32), alpha=0.3, centre=[1.0, 0.2], equi=True)
    expected = make_equi_pooling_size_map_lod([1.0, 0.2], (16, 32), 0.3, dtype=torch.float64)
    torch.testing.assert_close(blur.lod_map, expected)


def test_gradient():
    blur, picture = RadiallyVaryingBlur(), noise(1, 2, 7, 10).requires_grad_()
    with torch.inference_mode():
        blur.blur(picture, **STRONG)
    assert torch.autograd.gradcheck(lambda image: blur.blur(image, **STRONG), picture, fast_mode=True)


def test_blur_loss():
    image, target = noise(1, 3, 24, 32), noise(1, 3, 24, 32, seed=1)
    loss = BlurLoss(alpha=2.0, real_image_width=0.5, real_viewing_distance=0.4)
    blurred = RadiallyVaryingBlur().blur(target, **STRONG)
    assert float(loss(image, target, [0.3, 0.6])) == pytest.approx(float(((image - blurred) ** 2).mean()))
    assert float(loss(blurred, target, gaze=[0.3, 0.6])) == 0
    assert float(loss(target, target)) > 0
    both = BlurLoss(alpha=2.0, real_image_width=0.5, real_viewing_distance=0.4, blur_source=True)
    assert float(both(target, target)) == 0
    assert float(both(image, target)) < float(loss(image, target))
    assert loss.to("cpu") is loss
    assert loss.device == torch.device("cpu")
    image = image[..., :8, :8].requires_grad_()
    assert torch.autograd.gradcheck(lambda picture: both(picture, target[..., :8, :8]), image, fast_mode=True)


def test_refused():
    with pytest.raises(ValueError, match=r"BlurLoss ERROR: .*one size"):
        BlurLoss()(noise(1, 3, 8, 8), noise(1, 3, 8, 9))
    for bad in (noise(1, 3, 8, 8) * math.nan, 255 * noise(1, 3, 8, 8)):
        with pytest.raises(ValueError, match="BlurLoss ERROR: image must hold finite values of about 0 to 1"):
            BlurLoss()(bad, noise(1, 3, 8, 8))
    with pytest.raises(ValueError, match="mode must be one of"):
        BlurLoss(mode="cubic")(noise(1, 3, 8, 8), noise(1, 3, 8, 8))
    with pytest.raises(ValueError, match=r"image must be a tensor of .*, got \(8, 8\) of torch.float64"):
        RadiallyVaryingBlur().blur(noise(8, 8))
