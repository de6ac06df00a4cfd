"""Sums of Gaussians on pixels against the plain double sum, with and without occlusion, and their gradients."""

import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from odak.learn.wave import gaussian_tiles
from odak.learn.wave.gaussians.splatting import TiledGaussians, Tiling, composite_gaussians, sum_of_gaussians


def gaussians(number, height, width, seed=0, channels=2, dtype=torch.float64):
    """Return centres (some off the picture), inverse covariances, opacities and complex weights."""
    draw = torch.Generator().manual_seed(seed)
    means = (torch.rand(number, 2, generator=draw, dtype=dtype) * 1.4 - 0.2) * torch.tensor([width, height])
    axes = torch.randn(number, 2, 2, generator=draw, dtype=dtype) * 2
    conics = torch.linalg.inv(axes @ axes.mT + 0.3 * torch.eye(2, dtype=dtype))[:, [0, 0, 1], [0, 1, 1]]
    opacities = torch.rand(number, generator=draw, dtype=dtype)
    weights = torch.randn(number, channels, generator=draw, dtype=torch.complex128).to(dtype.to_complex())
    return means, conics, opacities, weights


def values(means, conics, height, width):
    """Return exp(−½ dᵀAd) ``[n, height, width]`` by the formula."""
    y, x = torch.meshgrid(*(torch.arange(n, dtype=means.dtype) for n in (height, width)), indexing="ij")
    dx, dy = x - means[:, 0, None, None], y - means[:, 1, None, None]
    a, b, c = (conic[:, None, None] for conic in conics.unbind(-1))
    return torch.exp(-0.5 * (a * dx * dx + 2 * b * dx * dy + c * dy * dy))


def composite(means, conics, opacities, weights, layers, count, height, width):
    """Return the composite by the formula, one picture at a time."""
    pictures = []
    for layer in range(count):
        mine = layers == layer
        alpha = opacities[mine, None, None] * values(means[mine], conics[mine], height, width)
        passed = torch.cat([torch.ones_like(alpha[:1]), 1 - alpha]).cumprod(0)[:-1]
        passed = passed.where(passed >= 1e-4, 0.0)
        pictures.append(torch.einsum("nc,nyx->cyx", weights[mine], (alpha * passed).to(weights.dtype)))
    return torch.stack(pictures)


@settings(max_examples=25)
@given(st.integers(1, 90), st.integers(1, 50), st.integers(1, 50), st.integers(0, 1000))
def test_the_sum_is_the_double_sum(number, height, width, seed):
    means, conics, _, weights = gaussians(number, height, width, seed)
    expected = torch.einsum("nc,nyx->cyx", weights, values(means, conics, height, width).to(weights.dtype))
    result = sum_of_gaussians(means, conics, weights, height, width)
    assert result.dtype == torch.complex128
    torch.testing.assert_close(result, expected, rtol=0, atol=1e-12)
    torch.testing.assert_close(sum_of_gaussians(means, conics, weights.real, height, width), expected.real)


@settings(max_examples=25)
@given(st.integers(0, 150), st.integers(1, 40), st.integers(1, 40), st.integers(1, 17), st.integers(0, 1000))
def test_the_composite_is_the_ordered_sum(number, height, width, tile, seed):
    means, conics, opacities, weights = gaussians(number, height, width, seed)
    layers = torch.arange(number) % 3
    # Opaque ones too, behind which nothing is seen.
    opacities = opacities.where(torch.arange(number) % 7 != 3, 1.0)
    expected = composite(means, conics, opacities, weights, layers, 3, height, width)
    tiling = Tiling(height, width, tile, 2 * tile, 3)
    result = composite_gaussians(means, conics, opacities, weights, layers, tiling)
    assert result.shape == (3, 2, height, width)
    torch.testing.assert_close(result, expected, rtol=0, atol=1e-12)


@pytest.mark.parametrize("number", [1, 5, 70])
def test_gradients_of_the_sum(number):
    means, conics, _, weights = (x.requires_grad_() for x in gaussians(number, 9, 12, channels=1))

    def picture(*inputs):
        return torch.view_as_real(sum_of_gaussians(*inputs, 9, 12)[:, 2::3, 1::3])

    torch.autograd.gradcheck(picture, (means, conics, weights), fast_mode=number > 1)


@pytest.mark.parametrize("number", [1, 6, 110])
@pytest.mark.parametrize("tile", [5, 12])
def test_gradients_of_the_composite(number, tile):
    means, conics, opacities, weights = gaussians(number, 9, 12, channels=1)
    layers = torch.arange(number) % 2
    inputs = tuple(x.requires_grad_() for x in (means, conics, opacities * 0.6, weights))

    def picture(*inputs):
        picture = composite_gaussians(*inputs, layers, Tiling(9, 12, tile, tile, 2))
        return torch.view_as_real(picture[..., 2::3, 1::3])

    torch.autograd.gradcheck(picture, inputs, fast_mode=number > 1)


@pytest.mark.parametrize("draw", ["sum", "composite"])
def test_a_gradient_refuses_to_be_differentiated(draw):
    """It must not be a constant, with which a penalty on gradients would have no effect."""
    means, conics, opacities, weights = gaussians(5, 9, 12, channels=1)
    means.requires_grad_()
    if draw == "sum":
        picture = sum_of_gaussians(means, conics, weights, 9, 12)
    else:
        picture = composite_gaussians(means, conics, opacities, weights, torch.arange(5) % 2, Tiling(9, 12, 5, 5, 2))
    (slope,) = torch.autograd.grad(picture.real.sum(), means, create_graph=True, retain_graph=True)
    torch.testing.assert_close(slope.detach(), torch.autograd.grad(picture.real.sum(), means)[0])
    with pytest.raises(RuntimeError, match="first derivatives only"):
        slope.square().sum().backward()


def test_gradients_of_the_composite_are_those_of_the_formula():
    means, conics, opacities, weights = gaussians(400, 20, 31)
    opacities = opacities.where(torch.arange(400) % 5 != 0, 1.0)
    layers = torch.arange(400) % 2
    slope = torch.randn(2, 2, 20, 31, dtype=torch.complex128)

    def slopes(draw):
        inputs = [x.detach().clone().requires_grad_() for x in (means, conics, opacities, weights)]
        (draw(*inputs) * slope.conj()).real.sum().backward()
        return [x.grad for x in inputs]

    ours = slopes(lambda *inputs: composite_gaussians(*inputs, layers, Tiling(20, 31, 8, 8, 2)))
    expected = slopes(lambda *inputs: composite(*inputs, layers, 2, 20, 31))
    for mine, theirs in zip(ours, expected, strict=True):
        torch.testing.assert_close(mine, theirs, rtol=1e-9, atol=1e-9)


def test_only_some_gradients():
    means, conics, _, weights = gaussians(20, 9, 12)
    weights.requires_grad_()
    sum_of_gaussians(means, conics, weights, 9, 12).abs().sum().backward()
    assert means.grad is None
    assert bool(weights.grad.abs().sum() > 0)


@pytest.mark.parametrize("side", [3, 8, 64])
def test_tiles_do_not_change_the_picture(side, monkeypatch):
    means, conics, opacities, weights = gaussians(300, 50, 70, dtype=torch.float32)
    layers = torch.zeros(300, dtype=torch.long)
    whole = composite_gaussians(means, conics, opacities, weights, layers, Tiling(50, 70, 50, 70))
    tiled = composite_gaussians(means, conics, opacities, weights, layers, Tiling(50, 70, side, side + 1))
    assert tiled.dtype == torch.complex64
    # A few tens of Gaussians overlap in a pixel, each of which rounds.
    assert float((tiled - whole).abs().max()) < 30 * torch.finfo(torch.float32).eps
    total = sum_of_gaussians(means, conics, weights, 50, 70)
    monkeypatch.setattr(gaussian_tiles, "_SIDES", (side,))
    assert float((sum_of_gaussians(means, conics, weights, 50, 70) - total).abs().max()) < 1e-5
    expected = torch.einsum("nc,nyx->cyx", weights, values(means, conics, 50, 70).to(weights.dtype))
    assert float((total - expected).abs().max()) < 2e-5


def test_long_thin_gaussians_keep_their_precision():
    # Standard deviations of 40 and 0.4 pixels at 30°, drawn in single precision.
    angle = torch.tensor(math.pi / 6, dtype=torch.float64)
    turn = torch.stack([angle.cos(), -angle.sin(), angle.sin(), angle.cos()]).view(2, 2)
    matrix = turn @ torch.diag(torch.tensor([40.0, 0.4], dtype=torch.float64) ** -2) @ turn.T
    conics = matrix[[0, 0, 1], [0, 1, 1]][None].float()
    means, weights = torch.tensor([[300.25, 200.5]]), torch.ones(1, 1)
    result = sum_of_gaussians(means, conics, weights, 400, 600)
    exact = values(means.double(), conics.double(), 400, 600)
    assert float((result - exact).abs().max()) < 2e-6


def test_lists_hold_who_touches_whom():
    means, conics, _, _ = gaussians(60, 33, 47)
    conics = 20 * conics
    tiled = TiledGaussians(means, conics, 33, 47, Tiling(33, 47, 8, 8))
    shares = values(means, conics, 33, 47)
    listed = torch.zeros(len(tiled.lists.counts), 61, dtype=torch.bool)
    listed[tiled.lists.tiles[:, None], tiled.lists.slots] = True
    tops = Tiling(33, 47, 8, 8).split(shares[None]).amax(-1)
    assert bool((listed[:, :60] | (tops <= torch.finfo(torch.float64).eps)).all())
    assert int(listed[:, :60].sum()) < 0.5 * listed[:, :60].numel()


def test_tiles_suit_the_gaussians(monkeypatch):
    draw = torch.Generator().manual_seed(0)
    means = torch.rand(4000, 2, generator=draw, dtype=torch.float64) * 300
    sides = [
        gaussian_tiles.choose_tiling(means, torch.full((4000, 2), half, dtype=torch.float64), 300, 300).tile_width
        for half in (1.0, 15.0, 500.0)
    ]
    assert sides == sorted(sides) and sides[0] < 32 and sides[2] >= 64
    assert gaussian_tiles.choose_tiling(means[:1], torch.ones(1, 2).double(), 5, 7).tile_width == 8
    conics = torch.tensor([[0.5, 0.1, 0.5]], dtype=torch.float64).expand(4000, 3)
    finer = gaussian_tiles.finer_tiling(Tiling(300, 300, 64, 4, 2), means, conics)
    assert (finer.tile_height, finer.tile_width, finer.layers) == (sides[1] if sides[1] == 16 else 8, 4, 2)
    # Lists of too many pairs are not made.
    monkeypatch.setattr(gaussian_tiles, "_MANY_PAIRS", 10_000)
    assert gaussian_tiles.choose_tiling(means, torch.ones(4000, 2).double(), 300, 300).tile_width <= 16
    half = torch.full((4000, 2), 15.0, dtype=torch.float64)
    spans = gaussian_tiles.tile_spans(means, half, gaussian_tiles.choose_tiling(means, half, 300, 300))
    assert int(gaussian_tiles._counts(spans).sum()) < 20_000


def test_tiles_and_pictures_there_and_back():
    pictures = torch.randn(2, 3, 21, 34)
    tiling = Tiling(21, 34, 8, 5, 2)
    assert torch.equal(tiling.join(tiling.split(pictures)), pictures)


def test_nan_is_seen_and_infinity_is_far():
    means, conics, _, weights = gaussians(3, 20, 20)
    means[1, 0] = math.nan
    assert bool(sum_of_gaussians(means, conics, weights, 20, 20).isnan().all())
    means[1, 0] = math.inf
    without = sum_of_gaussians(means[[0, 2]], conics[[0, 2]], weights[[0, 2]], 20, 20)
    torch.testing.assert_close(sum_of_gaussians(means, conics, weights, 20, 20), without)


def test_no_array_of_all_gaussians_and_pixels_is_kept():
    means, conics, opacities, weights = (x.requires_grad_() for x in gaussians(500, 64, 64))
    kept = []

    def pack(tensor):
        kept.append(tensor.numel())
        return tensor

    with torch.autograd.graph.saved_tensors_hooks(pack, lambda tensor: tensor):
        sum_of_gaussians(means, conics, weights, 64, 64)
        composite_gaussians(
            means, conics, opacities, weights, torch.zeros(500, dtype=torch.long), Tiling(64, 64, 16, 16)
        )
    assert max(kept) <= 2 * 2 * 64 * 64


@pytest.mark.cuda
def test_the_gpu_gives_the_same():
    inputs = [x.requires_grad_() for x in gaussians(2000, 100, 130, dtype=torch.float32)]
    there = [x.detach().cuda().requires_grad_() for x in inputs]
    for draw in (
        lambda m, c, o, w: sum_of_gaussians(m, c, w, 100, 130),
        lambda m, c, o, w: composite_gaussians(
            m, c, 0.3 * o, w, torch.arange(2000, device=m.device) % 2, Tiling(100, 130, 16, 32, 2)
        ),
    ):
        here, gpu = draw(*inputs), draw(*there)
        assert gpu.device.type == "cuda"
        torch.testing.assert_close(gpu.cpu(), here, rtol=1e-4, atol=1e-4)
        for picture in (here, gpu):
            picture.abs().square().sum().backward()
        for mine, theirs in zip(there, inputs, strict=True):
            if theirs.grad is not None:
                scale = float(theirs.grad.abs().max())
                torch.testing.assert_close(mine.grad.cpu(), theirs.grad, rtol=1e-3, atol=1e-4 * scale)
                mine.grad = theirs.grad = None
