"""Functions of pixels in blocks: the same as on whole pictures, gradients of every order, and under transforms."""

import pytest
import torch

from odak.learn import perception as p
from odak.learn.perception import color
from odak.learn.perception.color import by_pixels, by_values

CONVERSIONS = (
    p.rgb_2_ycrcb, p.ycrcb_2_rgb, p.rgb_to_linear_rgb, p.linear_rgb_to_rgb, p.linear_rgb_to_xyz, p.xyz_to_linear_rgb,
    p.rgb_to_hsv, p.hsv_to_rgb, p.srgb_to_lab, p.lab_to_srgb, p.pq_encode, p.pq_decode, p.hlg_encode, p.hlg_decode,
    p.pu21_encode, p.pu21_decode,
)  # fmt: skip


def noise(*shape, seed=0):
    return 0.05 + 0.9 * torch.rand(*shape, dtype=torch.float64, generator=torch.Generator().manual_seed(seed))


@pytest.mark.parametrize("function", CONVERSIONS, ids=lambda f: f.__name__)
def test_blocks_do_not_show(function, monkeypatch):
    image, outer = noise(2, 3, 5, 7).requires_grad_(), noise(2, 3, 5, 7, seed=1)
    results = []
    for size in (1 << 17, 12):
        monkeypatch.setattr(color, "BLOCK", size)
        value = function(image)
        results.append((value, torch.autograd.grad(value, image, outer)[0]))
        with torch.no_grad():
            torch.testing.assert_close(function(image), value, rtol=0, atol=0)
    # L*a*b* are differences of numbers of up to 500: 4·500·eps.
    for one, two in zip(*results, strict=True):
        torch.testing.assert_close(one, two, rtol=1e-13, atol=5e-13)


@pytest.mark.filterwarnings("ignore:.torch.jit.script. is deprecated:DeprecationWarning")
@pytest.mark.parametrize("function", CONVERSIONS, ids=lambda f: f.__name__)
def test_gradients_of_every_kind(function):
    image = noise(1, 3, 2, 3).requires_grad_()
    assert torch.autograd.gradcheck(function, image, fast_mode=True)
    assert torch.autograd.gradgradcheck(function, image, fast_mode=True)
    picture, direction = image.detach(), noise(1, 3, 2, 3, seed=1)
    _, along = torch.func.jvp(function, (picture,), (direction,))
    _, back = torch.func.vjp(function, picture)
    outer = noise(1, 3, 2, 3, seed=2)
    torch.testing.assert_close((along * outer).sum(), (back(outer)[0] * direction).sum())


def test_written_gradients_beside_the_edges():
    """Gradients computed from results are those that autograd finds, on both sides of every joint."""
    values = torch.tensor([-0.3, -0.055, 0.0, 1e-6, 0.0031307, 0.0031309, 0.0404, 0.0405, 0.2, 1.0, 1.7]).double()
    grid = torch.cartesian_prod(values, values[1:4], values[-3:]).T
    for name in ("decoded", "encoded", "to_lab", "from_lab"):
        function, gradient = (getattr(color, f"_{name}{end}") for end in ("", "_gradient"))
        point = {"from_lab": 100 * grid, "to_lab": grid}.get(name, values).clone().requires_grad_()
        result = function(point)
        outer = noise(*result.shape)
        (found,) = torch.autograd.grad(result, point, outer)
        torch.testing.assert_close(gradient(point.detach(), result.detach(), outer), found)


def ones(values, *_):
    return torch.ones_like(values)


def test_shapes():
    picture = noise(2, 2, 3, 4, 5)
    assert by_pixels(lambda v: v[..., :1, :], picture, ones).shape == (2, 2, 1, 4, 5)
    assert by_values(torch.sqrt, torch.empty(0, 3), ones).shape == (0, 3)
    assert by_values(torch.sqrt, torch.tensor(4.0), ones).item() == 2
    assert by_pixels(torch.neg, torch.empty(0, 3, 4, 4), ones).shape == (0, 3, 4, 4)


@pytest.mark.filterwarnings("ignore:.torch.jit.script. is deprecated:DeprecationWarning")
def test_blocks_have_the_requested_size(monkeypatch):
    seen = []

    def doubled(values):
        seen.append(values.shape[-1])
        return 2 * values

    def sizes(call):
        seen.clear()
        call()
        return list(seen)

    monkeypatch.setattr(torch, "get_num_threads", lambda: 1)
    monkeypatch.setattr(color, "BLOCK", 12)
    assert sizes(lambda: by_pixels(doubled, noise(2, 3, 5, 7), ones)) == 2 * ([4] * 8 + [3])
    assert sizes(lambda: by_values(doubled, noise(5, 6), ones)) == [12, 12, 6]
    monkeypatch.setattr(torch, "get_num_threads", lambda: 2)
    assert sizes(lambda: by_pixels(doubled, noise(1, 3, 5, 7), ones)) == [8] * 4 + [3]
    monkeypatch.setattr(color, "BLOCK", 1)
    assert sizes(lambda: by_pixels(doubled, noise(1, 3, 1, 4), ones)) == [1] * 4
    # Transforms follow one operation on the whole picture, whatever its axes.
    picture, along = noise(2, 2, 3, 5, 7), noise(2, 2, 3, 5, 7, seed=1)
    assert sizes(lambda: torch.func.jvp(lambda v: by_pixels(doubled, v, ones), (picture,), (along,))) == [35]
    value, slope = torch.func.jvp(p.linear_rgb_to_xyz, (picture,), (along,))
    torch.testing.assert_close(value, p.linear_rgb_to_xyz(picture))
    torch.testing.assert_close(slope, p.linear_rgb_to_xyz(along))


@pytest.mark.filterwarnings("ignore:.torch.jit.script. is deprecated:DeprecationWarning")
@pytest.mark.parametrize("function", [p.srgb_to_lab, p.rgb_to_linear_rgb, p.rgb_2_ycrcb], ids=lambda f: f.__name__)
def test_forward_mode_without_transforms(function):
    picture, along = noise(1, 3, 2, 5), noise(1, 3, 2, 5, seed=1)
    _, expected = torch.func.jvp(function, (picture,), (along,))
    with torch.autograd.forward_ad.dual_level():
        dual = function(torch.autograd.forward_ad.make_dual(picture, along))
        found = torch.autograd.forward_ad.unpack_dual(dual).tangent
    torch.testing.assert_close(found, expected)
