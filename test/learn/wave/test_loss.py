"""Losses of holograms against closed forms, and the targets of planes out of focus."""

import math
import sys

import numpy as np
import pytest
import torch
from scipy import ndimage

from odak import AccuracyWarning
from odak.learn.perception import SSIM
from odak.learn.tools import generate_2d_gaussian
from odak.learn.wave import (
    multi_color_hologram_optimizer,
    multiplane_hologram_optimizer,
    multiplane_loss,
    perceptual_multiplane_loss,
    phase_gradient,
    propagator,
    speckle_contrast,
)

pytestmark = pytest.mark.filterwarnings("ignore:blur_ratio:odak.AccuracyWarning")


def uniform(*shape, seed=0):
    return torch.rand(shape, dtype=torch.float64, generator=torch.Generator().manual_seed(seed))


PICTURE, DEPTH = uniform(3, 9, 8), uniform(9, 8, seed=1)
NO_MEASURES = {"additional_loss_weights": {}}


def steps(columns=12, planes=4):
    """Return a depth that rises from 0 to 1 by whole planes from left to right."""
    return (torch.arange(columns) * planes // columns).double().expand(9, -1) / (planes - 1)


@pytest.mark.parametrize("shape", [(6, 7), (2, 1, 6, 7)])
def test_phase_gradient_by_its_definition(shape):
    phase = uniform(*shape) * 6
    laplacian = np.full((3, 3), -1.0)
    laplacian[1, 1] = 8
    planes = phase.reshape(-1, 6, 7).numpy()
    edges = np.stack([ndimage.correlate(plane, laplacian / 8, mode="constant") for plane in planes])
    assert phase_gradient()(phase).item() == pytest.approx((edges**2).mean(), rel=1e-12)
    summed = phase_gradient(loss=torch.nn.L1Loss(reduction="sum"))
    assert summed(phase).item() == pytest.approx(np.abs(edges).sum(), rel=1e-12)
    # A constant or sloping phase is smooth, but for the zeros around it.
    y, x = torch.meshgrid(torch.arange(9.0), torch.arange(8.0), indexing="ij")
    inside = phase_gradient().functional_conv2d(2 + 3 * x - y)[0, 0, 1:-1, 1:-1]
    torch.testing.assert_close(inside, torch.zeros(7, 6))


def test_phase_gradient_of_another_kernel():
    kernel = torch.tensor([[0.0, 0, 0], [0, -1, 1], [0, 0, 0]])
    phase = uniform(5, 6)
    for given in (kernel, kernel[None, None]):
        expected = torch.nn.functional.pad(phase, (0, 1))[:, 1:] - phase
        torch.testing.assert_close(phase_gradient(given).functional_conv2d(phase)[0, 0], expected)
    wide = phase_gradient(torch.ones(1, 3))
    assert wide.functional_conv2d(phase).shape == (1, 1, 5, 6)
    assert not wide.state_dict()
    assert torch.autograd.gradcheck(phase_gradient(), uniform(4, 5).requires_grad_(), fast_mode=True)


def test_speckle_contrast_by_its_definition():
    intensity = uniform(9, 11)
    windows = np.lib.stride_tricks.sliding_window_view(intensity.numpy(), (4, 4))[::2, ::3]
    expected = windows.std((-2, -1)) / windows.mean((-2, -1))
    loss = speckle_contrast(4, (2, 3))
    np.testing.assert_allclose(loss.functional_conv2d(intensity)[0, 0].numpy(), expected, rtol=1e-10)
    assert loss(intensity).item() == pytest.approx((expected**2).mean(), rel=1e-10)
    assert loss(torch.stack([intensity, 7 * intensity])[:, None]).item() == pytest.approx((expected**2).mean())
    assert torch.autograd.gradcheck(loss, intensity.requires_grad_(), fast_mode=True)


def test_speckle_contrast_of_fully_developed_speckle():
    parts = torch.randn(2, 300, 300, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    contrast = speckle_contrast(100, 100).functional_conv2d((parts**2).sum(0)).mean()
    assert contrast.item() == pytest.approx(1.0, abs=0.02)


@pytest.mark.parametrize("level", [0.0, 1.0, 1e4])
def test_even_light_has_no_contrast(level):
    light = torch.full((13, 13), level, requires_grad=True)
    loss = speckle_contrast()(light)
    loss.backward()
    assert loss.item() == 0
    assert light.grad.isfinite().all()
    # Faint grain on bright light is not lost in single precision.
    if level > 1:
        grain = torch.tensor([1.0, -1.0]).repeat(13, 6)
        contrast = speckle_contrast(2, 2).functional_conv2d(level + grain)
        torch.testing.assert_close(contrast, torch.full_like(contrast, 1 / level), rtol=1e-3, atol=0)


def targets_by_definition(picture, depth, planes, ratio, size, multiplier):
    index = np.round(depth.numpy() * (planes - 1))
    side = size + 1 - size % 2
    result = np.zeros((planes, *picture.shape))
    for i in range(planes):
        for j in range(planes):
            sigma = abs(i - j) * ratio
            blurred = picture.numpy()
            if sigma:
                kernel = generate_2d_gaussian([side, side], [sigma, sigma], dtype=torch.float64).numpy()
                kernel = kernel / kernel.sum()
                share = ndimage.convolve(np.ones(blurred.shape[1:]), kernel, mode="constant")
                blurred = np.stack([ndimage.convolve(plane, kernel, mode="constant") / share for plane in blurred])
            result[i] += (index == j) * blurred
    return multiplier * result


@pytest.mark.parametrize(
    ("planes", "ratio", "size", "multiplier"), [(4, 0.7, 4, 1.5), (3, 2.5, 7, 1.0), (2, 0.25, 10, 1)]
)
def test_targets_by_their_definition(planes, ratio, size, multiplier):
    loss = multiplane_loss(PICTURE, DEPTH, ratio, size, planes, multiplier=multiplier)
    targets, focus, depth = loss.get_targets()
    np.testing.assert_allclose(
        targets.numpy(), targets_by_definition(PICTURE, DEPTH, planes, ratio, size, multiplier), rtol=1e-12
    )
    assert torch.equal(focus, PICTURE)
    torch.testing.assert_close(depth, torch.round(DEPTH * (planes - 1)) / (planes - 1))


def test_what_is_in_focus_is_sharp():
    loss = multiplane_loss(PICTURE, DEPTH, blur_ratio=1.0)
    assert torch.equal(loss.masks.sum(0), torch.ones_like(PICTURE))
    assert torch.equal((loss.masks * loss.targets).sum(0), PICTURE)
    # An even picture stays even out of focus, up to its rim.
    geometry = {"distances": [0.0, 1e-3, 2e-3, 3e-3], "wavelengths": [532e-9], "pixel_pitch": 8e-6}
    for blur in ({"blur_ratio": 1.0, "target_blur_size": 3}, geometry):
        even = multiplane_loss(torch.ones(1, 9, 12), steps().float(), **blur).targets
        torch.testing.assert_close(even, torch.ones(4, 1, 9, 12))


def test_one_plane_and_no_blur():
    for loss in (multiplane_loss(PICTURE, DEPTH, number_of_planes=1), multiplane_loss(PICTURE, DEPTH, blur_ratio=0)):
        for target in loss.targets:
            assert torch.equal(target, PICTURE)
        assert loss.get_targets()[2].isfinite().all()
    grey = multiplane_loss(PICTURE[0], DEPTH[None])
    assert grey.targets.shape == (4, 1, 9, 8)


def test_naive_targets_are_dark_beyond_their_plane():
    loss = multiplane_loss(PICTURE, DEPTH, scheme="naive", multiplier=2.0)
    assert torch.equal(loss.targets.sum(0), 2 * PICTURE)
    assert torch.equal(loss.targets, 2 * PICTURE * loss.masks)
    loss.add_defocus_blur()
    assert torch.equal(loss.targets, multiplane_loss(PICTURE, DEPTH, multiplier=2.0).targets)


@pytest.mark.parametrize("reduction", ["mean", "sum"])
@pytest.mark.parametrize("weights", [[1.0, 2.1, 0.6], [0.5, 0.25, 3.0, 7.0]])
def test_three_terms(reduction, weights):
    loss = multiplane_loss(PICTURE, DEPTH, weights=weights, reduction=reduction)
    image, target, mask = uniform(3, 9, 8, seed=5), loss.targets[2], loss.masks[2]
    reduce = getattr(torch, reduction)
    terms = [(image - target) ** 2, mask * (image - target) ** 2, ((image - target) * target) ** 2]
    expected = sum(w * reduce(term) for w, term in zip(weights, terms, strict=False))
    torch.testing.assert_close(loss(image, target, 2), expected)
    torch.testing.assert_close(loss(image[None, None], target[None, None], plane_id=2), expected)
    # Colours one by one are all colours at once.
    each = sum(loss(one, two, plane_id=2) for one, two in zip(image, target, strict=True))
    torch.testing.assert_close(each, expected if reduction == "sum" else 3 * expected)
    assert loss(target, target, 2).item() == 0
    assert torch.autograd.gradcheck(lambda v: loss(v, target, 2), image.requires_grad_(), fast_mode=True)


def test_all_planes_at_once():
    loss = multiplane_loss(PICTURE, DEPTH, reduction="sum")
    images = uniform(4, 3, 9, 8, seed=5)
    each = sum(loss(images[p], loss.targets[p], p) for p in range(4))
    torch.testing.assert_close(loss(images, loss.targets), each)
    # One image against the masks of all planes: each pixel is in one of them.
    weights = multiplane_loss(PICTURE, DEPTH, weights=[0, 1, 0], reduction="sum")
    torch.testing.assert_close(weights(images[0], PICTURE), ((images[0] - PICTURE) ** 2).sum())


def test_noise_spares_the_first_term():
    generator = torch.Generator().manual_seed(7)
    loss = multiplane_loss(PICTURE, DEPTH, weights=[1.0, 0.0, 0.0])
    image, target = uniform(3, 9, 8, seed=5), loss.targets[0]
    assert loss(image, target, 0, inject_noise=True, noise_ratio=0.5).item() == loss(image, target, 0).item()
    # With MSE(T·M, N·M) = ratio²·spread²·mean(normal²) over the plane.
    loss = multiplane_loss(PICTURE, DEPTH, weights=[0, 1, 0], number_of_planes=1, generator=generator)
    normal = torch.randn(3, 9, 8, dtype=torch.float64, generator=torch.Generator().manual_seed(7))
    expected = 0.01 * (PICTURE.max() - PICTURE.min()) ** 2 * (normal**2).mean()
    torch.testing.assert_close(loss(PICTURE, PICTURE, 0, inject_noise=True, noise_ratio=0.1), expected)
    # The third term compares I·N with N·N.
    loss = multiplane_loss(PICTURE, DEPTH, weights=[0, 0, 1], number_of_planes=1, generator=generator.manual_seed(7))
    noise = 0.1 * (PICTURE.max() - PICTURE.min()) * normal
    expected = (noise * (PICTURE + noise)).square().mean()
    torch.testing.assert_close(loss(PICTURE, PICTURE, 0, inject_noise=True, noise_ratio=0.1), expected)


def test_nothing_is_saved_and_everything_moves():
    loss = multiplane_loss(PICTURE.float(), DEPTH.float(), device="cpu")
    assert not loss.state_dict()
    assert {name for name, _ in loss.named_buffers()} == {"masks", "targets", "target_image", "target_depth"}
    assert loss.double().targets.dtype == torch.float64
    assert loss.to("meta").masks.is_meta


def test_perceptual_terms_add_up():
    plain = multiplane_loss(PICTURE, DEPTH, weights=[1, 1, 1])
    image, target, mask = uniform(3, 9, 8, seed=5), plain.targets[1], plain.masks[1]
    loss = perceptual_multiplane_loss(PICTURE, DEPTH, return_components=True, **NO_MEASURES)
    total, parts = loss(image, target, 1)
    difference = (image - target).abs()
    expected = {
        "base_l1_loss": difference.mean(),
        "loss_l1_mask": (mask * difference).mean(),
        "loss_l1_cor": (target * difference).mean(),
    }
    for name, value in expected.items():
        torch.testing.assert_close(parts[name], value)
    squared = sum(parts[name] for name in ("base_l2_loss", "loss_l2_mask", "loss_l2_cor"))
    torch.testing.assert_close(squared, plain(image, target, 1))
    torch.testing.assert_close(total, squared + sum(expected.values()))
    only = perceptual_multiplane_loss(PICTURE, DEPTH, base_loss_weights={"loss_l1_mask": 3.0}, **NO_MEASURES)
    torch.testing.assert_close(only(image, target, 1), 3 * expected["loss_l1_mask"])


@pytest.mark.parametrize("shape", [(16, 15), (3, 16, 15), (4, 3, 16, 15)])
def test_perceptual_measures(shape):
    picture = uniform(3, 16, 15)
    weights = {"ssim": 0.5, "psnr": 0.25}
    loss = perceptual_multiplane_loss(
        picture, uniform(16, 15, seed=1), base_loss_weights={}, additional_loss_weights=weights, return_components=True
    )
    image, target = uniform(*shape, seed=2), uniform(*shape, seed=3)
    total, parts = loss(image, target, None if len(shape) == 4 else 1, inject_noise=True)
    torch.testing.assert_close(parts["ssim"], 0.5 * (1 - SSIM()(image, target)))
    torch.testing.assert_close(parts["psnr"], 0.25 * 10 * torch.log10(((image - target) ** 2).mean()))
    torch.testing.assert_close(total, parts["ssim"] + parts["psnr"])


def test_predictors_count_down_from_ten(monkeypatch):
    class Predictor:
        def __init__(self, **_):
            pass

        def predict(self, one, two, dim_order):
            return 10 - (one - two).abs().mean(), {}

    monkeypatch.setitem(sys.modules, "pycvvdp", type("pycvvdp", (), {"cvvdp": Predictor}))
    loss = perceptual_multiplane_loss(PICTURE, DEPTH, base_loss_weights={})
    assert loss(PICTURE, PICTURE, 0).item() == 0
    assert loss(PICTURE, PICTURE + 0.5, 0).item() == pytest.approx(0.5, rel=1e-5)


def test_a_missing_package_is_an_error(monkeypatch):
    for module in ("pycvvdp", "pyfvvdp", "lpips"):
        monkeypatch.setitem(sys.modules, module, None)
    for name, package in (("cvvdp", "cvvdp"), ("fvvdp", "pyfvvdp"), ("lpips", "lpips")):
        with pytest.raises(ImportError, match=f"pip install {package}"):
            perceptual_multiplane_loss(PICTURE, DEPTH, additional_loss_weights={name: 0.1})
    # A weight of zero asks for nothing.
    perceptual_multiplane_loss(PICTURE, DEPTH, additional_loss_weights={"cvvdp": 0.0})


@pytest.mark.parametrize("loss_type", [multiplane_loss, perceptual_multiplane_loss])
def test_hologram_optimizers_take_the_losses(loss_type):
    options = NO_MEASURES if loss_type is perceptual_multiplane_loss else {}
    picture, depth = uniform(3, 16, 16).float(), uniform(16, 16, seed=1).float()
    loss = loss_type(picture, depth, number_of_planes=2, reduction="sum", **options)
    colours = [639e-9, 515e-9, 473e-9]
    display = propagator(
        [16, 16], colours, 8e-6, number_of_frames=2, number_of_depth_layers=2, volume_depth=1e-3, aperture="open"
    )
    optimizer = multi_color_hologram_optimizer(
        colours, [16, 16], loss.get_targets()[0], display, 2, 2, loss_function=loss, seed=0, progress=False
    )
    start = optimizer.evaluate(picture, loss.targets[1], 1, inject_noise=True)
    assert start.item() > 0
    _, phases, *_ = optimizer.optimize(2)
    assert phases.isfinite().all()
    one = loss_type(picture[0], depth, number_of_planes=2, **options)
    planes = multiplane_hologram_optimizer(
        515e-9, 0.0, 1e-3, 8e-6, [16, 16], one.targets[:, 0], number_of_iterations=2, number_of_planes=2,
        loss_function=one, aperture="open",
    )  # fmt: skip
    assert planes.optimize()[0].isfinite().all()


@pytest.mark.parametrize(
    ("call", "kind", "message"),
    [
        (lambda: phase_gradient(torch.ones(3)), ValueError, r"kernel must be \[h, w\]"),
        (lambda: phase_gradient(torch.ones(2, 1, 3, 3)), ValueError, "kernel must be"),
        (lambda: phase_gradient(loss=3), TypeError, "loss must be a function, got 3"),
        (lambda: phase_gradient()(torch.ones(3, 4, 4)), ValueError, r"phase must be \[m, n\]"),
        (lambda: speckle_contrast(0), ValueError, "kernel_size must be at least 1"),
        (lambda: speckle_contrast(3, (1, 0)), ValueError, "step_size"),
        (lambda: speckle_contrast(5)(torch.ones(4, 9)), ValueError, "intensity must be at least kernel_size = 5"),
        (lambda: multiplane_loss(PICTURE, DEPTH[:5]), ValueError, r"target_depth must be \[9, 8\]"),
        (lambda: multiplane_loss(PICTURE, DEPTH + 1), ValueError, "target_depth must be between 0 and 1"),
        (lambda: multiplane_loss(PICTURE, DEPTH * math.nan), ValueError, "target_depth must be between 0 and 1"),
        (lambda: multiplane_loss(PICTURE.int(), DEPTH), TypeError, "target_image must be a real floating tensor"),
        (lambda: multiplane_loss(PICTURE, DEPTH, -1.0), ValueError, "blur_ratio must be at least 0"),
        (lambda: multiplane_loss(PICTURE, DEPTH, 1.0, 0), ValueError, "target_blur_size must be at least 1"),
        (lambda: multiplane_loss(PICTURE, DEPTH, number_of_planes=0), ValueError, "number_of_planes must be at least"),
        (lambda: multiplane_loss(PICTURE, DEPTH, weights=[1.0]), ValueError, "weights must be three"),
        (lambda: multiplane_loss(PICTURE, DEPTH)(PICTURE, PICTURE[:1], 0), ValueError, "same shape"),
        (lambda: multiplane_loss(PICTURE, DEPTH)(PICTURE, PICTURE, 4), ValueError, "plane_id must be -4 to 3, got 4"),
        (lambda: multiplane_loss(PICTURE, DEPTH)(PICTURE[:2], PICTURE[:2], 0), ValueError, "image must be"),
        (
            lambda: perceptual_multiplane_loss(PICTURE, DEPTH, base_loss_weights={"l2": 1.0}, **NO_MEASURES),
            ValueError,
            "base_loss_weights must be of base_l2_loss, .*; got 'l2'",
        ),
        (
            lambda: perceptual_multiplane_loss(PICTURE, DEPTH, additional_loss_weights={"vmaf": 1.0}),
            ValueError,
            "additional_loss_weights must be of cvvdp, .*; got 'vmaf'",
        ),
    ],
)
def test_refused(call, kind, message):
    with pytest.raises(kind, match=message):
        call()


def test_contrast_of_what_is_dark_beside_bright_light():
    light = torch.ones(32, 32)
    light[16:] = 1e-4 * torch.rand(16, 32, generator=torch.Generator().manual_seed(0))
    torch.testing.assert_close(speckle_contrast(5)(light), speckle_contrast(5)(light.double()).float())


def test_default_blur_grows_by_parts_of_a_pixel():
    point = torch.zeros(1, 21, 21, dtype=torch.float64)
    point[0, 10, 10] = 1
    for number, depth in ((1, 1 / 3), (3, 1.0)):
        seen = multiplane_loss(point, torch.full((21, 21), depth, dtype=torch.float64), target_blur_size=21).targets[0]
        rows = (torch.arange(21, dtype=torch.float64) - 10) * 21 / 20
        kernel = torch.exp(-(rows**2) / (2 * (0.25 * number) ** 2))
        torch.testing.assert_close(seen[0], kernel[:, None] * kernel / kernel.sum() ** 2)
    with pytest.warns(AccuracyWarning, match=r"blur_ratio 0\.1 blurs by a σ of at most 0\.3 pixels on 4 planes"):
        multiplane_loss(PICTURE, DEPTH, blur_ratio=0.1)


@pytest.mark.parametrize("aperture", [None, 0.1])
def test_geometric_blur_disc_grows_with_distance_and_wavelength(aperture):
    colours, pitch, step = [639e-9, 473e-9], 8e-6, 2e-3 if aperture is None else 1e-3
    size, places = 161, [0.0, step, 3 * step]
    depth = torch.zeros(size, size, dtype=torch.float64)
    point = torch.zeros(2, size, size, dtype=torch.float64)
    point[:, 80, 80] = 1
    loss = multiplane_loss(
        point, depth, number_of_planes=3, distances=places, wavelengths=colours, pixel_pitch=pitch,
        numerical_aperture=aperture,
    )  # fmt: skip
    torch.testing.assert_close(loss.targets[0], point)
    rows = torch.arange(size, dtype=torch.float64) - 80
    squared = rows[:, None] ** 2 + rows**2
    for plane, place in ((1, step), (2, 3 * step)):
        for colour, wavelength in enumerate(colours):
            sine = aperture or wavelength / (2 * pitch)
            radius = place * math.tan(math.asin(sine)) / pitch
            image = loss.targets[plane, colour]
            # A uniform disc has the second moment r²/2; its spectrum rings a little beyond the edge.
            assert image.sum().item() == pytest.approx(1, abs=0.1)
            inside = squared <= (0.8 * radius) ** 2
            assert image[inside].mean().item() == pytest.approx(1 / (math.pi * radius**2), rel=0.1)
            assert image[squared > (1.3 * radius + 2) ** 2].sum() < 0.1


def test_a_volume_within_the_depth_of_focus_says_so():
    options = {"number_of_planes": 2, "wavelengths": [532e-9] * 3, "pixel_pitch": 8e-6}
    with pytest.warns(AccuracyWarning, match="the depth of focus, 0.00048"):
        multiplane_loss(PICTURE, DEPTH, distances=[0.0, 1e-4], **options)
    with pytest.raises(ValueError, match="distances must be one for each of 2 planes, got 3"):
        multiplane_loss(PICTURE, DEPTH, distances=[0.0, 1e-4, 1.0], **options)
    with pytest.raises(ValueError, match="must be given together; missing distances"):
        multiplane_loss(PICTURE, DEPTH, **options)
