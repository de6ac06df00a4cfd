"""Slices of depth and the checks of images that losses share."""

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from odak.learn.perception import (
    FLIP,
    PSNR,
    PU21PSNR,
    SSIM,
    BlurLoss,
    CSFLoss,
    CVDLoss,
    MetamericLoss,
    MetamericLossUniform,
    VisibilityLoss,
    blur_gaussian,
    check_loss_inputs,
    slice_rgbd_targets,
    util,
)
from odak.learn.tools import blur_gaussian as blur_of_the_tools


@settings(max_examples=30)
@given(st.integers(1, 6), st.integers(1, 3), st.integers(0, 1000))
def test_slices_put_the_picture_together_again(count, channels, seed):
    generator = torch.Generator().manual_seed(seed)
    target = torch.rand(channels, 5, 4, dtype=torch.float64, generator=generator)
    depth = torch.randint(0, 9, (5, 4), generator=generator) / 8
    slices, masks = slice_rgbd_targets(target, depth, torch.linspace(0, 1, count + 1))
    assert slices.shape == masks.shape == (count, channels, 5, 4)
    assert masks.dtype == torch.int32
    assert (masks.sum(0) == 1).all()
    assert torch.equal(slices.sum(0), target)
    assert torch.equal(slices, target * masks)


def test_boundaries():
    depth = torch.tensor([[-0.1, 0.0, 0.4, 0.5, 1.0, 1.1, torch.nan]])
    slices, masks = slice_rgbd_targets(torch.ones(1, 1, 7), depth, [0.0, 0.5, 1.0])
    assert masks[:, 0, 0].tolist() == [[0, 1, 1, 0, 0, 0, 0], [0, 0, 0, 1, 1, 0, 0]]
    assert slices.dtype == torch.float32
    # Whole numbers are compared with boundaries between them.
    slices, masks = slice_rgbd_targets(torch.full((1, 1, 3), 7), torch.tensor([[0, 1, 2]]), [-0.5, 0.5, 2.5])
    assert masks[:, 0, 0].tolist() == [[1, 0, 0], [0, 1, 1]]
    assert slices.tolist() == [[[[7.0, 0.0, 0.0]]], [[[0.0, 7.0, 7.0]]]]


def test_gradient_reaches_the_picture():
    target = torch.rand(2, 3, 3, dtype=torch.float64, requires_grad=True)
    depth = torch.linspace(0, 1, 9, dtype=torch.float64).reshape(3, 3)
    assert torch.autograd.gradcheck(lambda t: slice_rgbd_targets(t, depth, [0, 0.3, 1])[0], target, fast_mode=True)


@pytest.mark.parametrize(
    ("target", "depth", "positions", "kind", "message"),
    [
        (torch.ones(4, 4), torch.ones(4, 4), [0, 1], ValueError, r"target must be \[C, H, W\]"),
        (torch.ones(3, 4, 4), torch.ones(4, 5), [0, 1], ValueError, "depth must be"),
        (torch.ones(3, 4, 4), torch.ones(4, 4), [0], ValueError, "depth_plane_positions must be two or more rising"),
        (torch.ones(3, 4, 4), torch.ones(4, 4), [0, 1, 1], ValueError, "rising numbers"),
        ([[1.0]], torch.ones(4, 4), [0, 1], TypeError, "target must be a tensor, got list"),
    ],
)
def test_refused(target, depth, positions, kind, message):
    with pytest.raises(kind, match=message):
        slice_rgbd_targets(target, depth, positions)


def test_check_loss_inputs():
    picture = torch.ones(1, 3, 4, 4)
    check_loss_inputs("BlurLoss", picture, picture)
    check_loss_inputs("BlurLoss", picture[:, :1], picture[:, :1])
    for one, two, message in (
        (picture, picture[:, :1], "one size"),
        (picture[0], picture[0], "four axes"),
        (picture[:, :2], picture[:, :2], "one or three channels"),
        # The size is looked at first.
        (picture[0], picture[0, :2], "one size"),
    ):
        with pytest.raises(ValueError, match=rf"^BlurLoss ERROR: .*{message}"):
            check_loss_inputs("BlurLoss", one, two)


@pytest.mark.parametrize(
    "kind",
    [PSNR, SSIM, FLIP, PU21PSNR, BlurLoss, CSFLoss, CVDLoss, VisibilityLoss, MetamericLoss, MetamericLossUniform],
)
@pytest.mark.parametrize("shape", [(0, 3, 32, 32), (1, 3, 0, 32)])
def test_empty_pictures_are_refused(kind, shape):
    with pytest.raises(ValueError, match=rf"not be empty.*{shape[0]}, 3, {shape[2]}, 32"):
        kind()(torch.rand(shape), torch.rand(shape))


def test_names():
    assert blur_gaussian is blur_of_the_tools
    assert util.slice_rgbd_targets is slice_rgbd_targets
