"""SSIM, MS-SSIM and PSNR against NumPy and SciPy; the wrappers of other packages with stand-ins for them."""

import sys
import types

import numpy as np
import pytest
import torch
from scipy import ndimage

import odak
from odak.learn import perception
from odak.learn.perception import (
    CVVDP,
    FLIP,
    FVVDP,
    LPIPS,
    MSSSIM,
    PSNR,
    PU21PSNR,
    PU21SSIM,
    SSIM,
    ImageQuality,
    flip,
    pu21_encode,
)
from odak.learn.perception.quality import SCALE_WEIGHTS


def pictures(*shape, noise=0.1, seed=0):
    generator = torch.Generator().manual_seed(seed)
    one = torch.rand(shape, dtype=torch.float64, generator=generator)
    return one, (one + noise * torch.randn(shape, dtype=torch.float64, generator=generator)).clamp(0, 1)


def terms_by_definition(one, two, data_range=1.0):
    """Luminance and contrast–structure of Wang et al. 2004, window by window."""

    def mean(values):
        # σ = 1.5, truncated at 5 samples; the border where the window does not fit is dropped.
        return ndimage.gaussian_filter(values, 1.5, mode="constant", radius=5)[5:-5, 5:-5]

    c1, c2 = (0.01 * data_range) ** 2, (0.03 * data_range) ** 2
    m1, m2 = mean(one), mean(two)
    v1, v2, covariance = mean(one**2) - m1**2, mean(two**2) - m2**2, mean(one * two) - m1 * m2
    return (2 * m1 * m2 + c1) / (m1**2 + m2**2 + c1), (2 * covariance + c2) / (v1 + v2 + c2)


@pytest.mark.parametrize("shape", [(24, 31), (3, 24, 31), (2, 3, 24, 31)])
@pytest.mark.parametrize("data_range", [1.0, 255.0])
def test_ssim_by_its_definition(shape, data_range):
    one, two = (data_range * picture for picture in pictures(*shape))
    planes = zip(one.reshape(-1, *shape[-2:]).numpy(), two.reshape(-1, *shape[-2:]).numpy(), strict=True)
    expected = np.mean([np.prod(terms_by_definition(*pair, data_range), axis=0) for pair in planes])
    result = SSIM()(one, two, data_range)
    assert result.ndim == 0
    assert result.item() == pytest.approx(expected, rel=1e-10)
    assert SSIM()(one.float(), two.float(), data_range).item() == pytest.approx(expected, abs=1e-5)


def ms_ssim_by_definition(one, two):
    """MS-SSIM of each channel, and their mean, as piq and pytorch-msssim have it."""
    result = np.ones(3)
    for scale, weight in enumerate(SCALE_WEIGHTS):
        luminance, structure = (
            np.stack(terms)
            for terms in zip(*(terms_by_definition(*pair) for pair in zip(one, two, strict=True)), strict=True)
        )
        last = scale == len(SCALE_WEIGHTS) - 1
        result *= np.maximum((luminance * structure if last else structure).mean((1, 2)), 0.0) ** weight
        one, two = (
            (v[:, : v.shape[1] // 2 * 2, : v.shape[2] // 2 * 2].reshape(3, v.shape[1] // 2, 2, -1, 2)).mean((2, 4))
            for v in (one, two)
        )
    return result.mean()


def test_ms_ssim_by_its_definition():
    one, two = pictures(2, 3, 177, 190, noise=0.3)
    expected = [ms_ssim_by_definition(*pair) for pair in zip(one.numpy(), two.numpy(), strict=True)]
    result = MSSSIM()(one, two)
    assert result.ndim == 0
    assert result.item() == pytest.approx(np.mean(expected), rel=1e-10)
    assert sum(SCALE_WEIGHTS) == pytest.approx(1, abs=1e-3)


def test_equal_and_opposite_pictures():
    one, _ = pictures(1, 3, 180, 180)
    assert SSIM()(one, one).item() == MSSSIM()(one, one).item() == 1.0
    assert PSNR()(one, one).item() == np.inf
    opposite = (1 - one).requires_grad_()
    assert SSIM()(one, opposite).item() < 0
    score = MSSSIM()(one, opposite)
    assert score.item() == 0.0
    (gradient,) = torch.autograd.grad(score, opposite)
    assert gradient.isfinite().all()


def test_flat_pictures():
    """Without structure what is left is the luminance term (2ab + c₁)/(a² + b² + c₁)."""
    a, b = 0.3, 0.6
    flat = torch.full((1, 12, 12), a, dtype=torch.float64), torch.full((1, 12, 12), b, dtype=torch.float64)
    assert SSIM()(*flat).item() == pytest.approx((2 * a * b + 1e-4) / (a * a + b * b + 1e-4), rel=1e-12)


def test_gradients():
    one, two = pictures(1, 13, 12)
    assert torch.autograd.gradcheck(SSIM(), (one.requires_grad_(), two.requires_grad_()), fast_mode=True)
    assert torch.autograd.gradcheck(PSNR(), (one, two), fast_mode=True)
    one, two = (picture.requires_grad_() for picture in pictures(176, 176))
    (gradient,) = torch.autograd.grad(MSSSIM()(one, two), one)
    direction = torch.randn(176, 176, dtype=torch.float64, generator=torch.Generator().manual_seed(1))
    with torch.no_grad():
        ahead, behind = (MSSSIM()(one + step * direction, two) for step in (1e-6, -1e-6))
    assert ((ahead - behind) / 2e-6).item() == pytest.approx((gradient * direction).sum().item(), rel=1e-6)


def test_psnr():
    one, two = pictures(1, 3, 8, 9)
    expected = -10 * torch.log10(((one - two) ** 2).mean())
    assert PSNR()(one, two).item() == pytest.approx(expected.item(), rel=1e-12)
    assert PSNR()(one, two, peak_value=10.0).item() == pytest.approx(expected.item() + 20, rel=1e-12)
    batch, other = pictures(4, 3, 8, 9)
    each = torch.stack([PSNR()(*pair) for pair in zip(batch, other, strict=True)])
    torch.testing.assert_close(PSNR()(batch, other, reduction="none"), each)
    torch.testing.assert_close(PSNR()(batch, other, reduction="mean"), each.mean())
    torch.testing.assert_close(PSNR()(batch, other), -10 * torch.log10((10 ** (-each / 10)).mean()))
    assert PSNR()(batch[0, 0], other[0, 0], reduction="none").shape == ()
    assert PSNR()(batch[:1], batch[:1], reduction="none").tolist() == [float("inf")]
    same = one.clone().requires_grad_()
    (gradient,) = torch.autograd.grad(PSNR()(same, one), same)
    assert not gradient.any()


@pytest.mark.filterwarnings("ignore::odak.MissingPackageWarning")
@pytest.mark.parametrize("measure", [PSNR, SSIM, MSSSIM, CVVDP, LPIPS])
def test_refused(measure):
    picture = torch.ones(3, 180, 180)
    with pytest.raises(ValueError, match="predictions and targets must have the same shape"):
        measure()(picture, picture[:1])
    with pytest.raises(TypeError, match=r"targets must be a tensor of real floats, got torch\.int32"):
        measure()(picture, picture.int())


@pytest.mark.parametrize(("measure", "side"), [(SSIM(), 11), (MSSSIM(), 176)])
def test_too_small(measure, side):
    measure(*pictures(side, side))
    with pytest.raises(ValueError, match=rf"at least {side} x {side}, got \[{side - 1}, {side}\]"):
        measure(*pictures(side - 1, side))
    with pytest.raises(ValueError, match="data_range must be positive"):
        measure(*pictures(side, side), data_range=0)


PACKAGES = [(CVVDP, "pycvvdp", "cvvdp"), (FVVDP, "pyfvvdp", "pyfvvdp"), (LPIPS, "lpips", "lpips")]


@pytest.fixture
def without_packages(monkeypatch):
    for _, module, _ in PACKAGES:
        monkeypatch.setitem(sys.modules, module, None)


@pytest.mark.parametrize(("measure", "module", "package"), PACKAGES)
def test_without_the_package(measure, module, package, without_packages):
    with pytest.raises(ImportError, match=rf"{measure.__name__} needs the package {package} .*: pip install {package}"):
        measure(required=True)
    with pytest.warns(odak.MissingPackageWarning, match=f"pip install {package}"):
        metric = measure()
    assert not metric.available
    with pytest.raises(ImportError, match=f"pip install {package}"):
        metric(torch.rand(1, 3, 16, 16), torch.rand(1, 3, 16, 16))


class Predictor:
    """Stands in for the two predictors: ten less the mean difference, of one picture or video at a time.

    The difference of frame k of a video counts k times over the rate of the frames.
    """

    def __init__(self, **options):
        self.options = options

    def predict(self, one, two, dim_order, frames_per_second=0):
        assert one.shape[0] == 1
        assert dim_order == ("BCFHW" if frames_per_second else "BCHW")
        assert one.dtype == torch.float32
        difference = (one - two).abs()
        if frames_per_second:
            time = torch.arange(one.shape[2]) / frames_per_second
            difference = difference * time[:, None, None]
        return 10 - difference.mean(), {}


@pytest.mark.parametrize(("measure", "module"), [(CVVDP, "pycvvdp"), (FVVDP, "pyfvvdp")])
def test_difference_predictors(measure, module, monkeypatch):
    monkeypatch.setitem(sys.modules, module, types.SimpleNamespace(cvvdp=Predictor, fvvdp=Predictor))
    metric = measure()
    assert metric.available
    assert getattr(metric, measure.__name__.lower()).options["display_name"] == "standard_4k"
    one, two = (picture.requires_grad_() for picture in pictures(2, 3, 6, 7))
    expected = 10 - (one - two).abs().mean().item()
    score = metric(one, two)
    assert score.item() == pytest.approx(expected, rel=1e-6)
    score.backward()
    assert one.grad.any()
    last = [picture.movedim(1, -1) for picture in (one, two)]
    assert metric(*last, dim_order="BHWC").item() == pytest.approx(expected, rel=1e-6)
    assert metric(one[0], one[0]).item() == 10
    for wrong, message in (
        ((one[0, 0], one[0, 0]), "three or four axes"),
        ((one[:, :2], one[:, :2]), "one or three channels, got "),
        ((one, two, "BCFW"), "dim_order must name"),
    ):
        with pytest.raises(ValueError, match=message):
            metric(*wrong)


@pytest.mark.parametrize(("measure", "module"), [(CVVDP, "pycvvdp"), (FVVDP, "pyfvvdp")])
def test_difference_predictors_of_videos(measure, module, monkeypatch):
    monkeypatch.setitem(sys.modules, module, types.SimpleNamespace(cvvdp=Predictor, fvvdp=Predictor))
    metric, (one, two) = measure(), pictures(2, 3, 4, 6, 7)
    expected = 10 - ((one - two).abs().mean((0, 1, 3, 4)) * torch.arange(4)).mean().item() / 60
    assert metric(one, two, frames_per_second=60).item() == pytest.approx(expected, rel=1e-6)
    last = [video.movedim(1, -1) for video in (one, two)]
    assert metric(*last, dim_order="BFHWC", frames_per_second=60.0).item() == pytest.approx(expected, rel=1e-6)
    for arguments, message in (
        ({}, "frames_per_second must be given for videos"),
        ({"frames_per_second": 0}, "frames_per_second must be positive"),
        ({"frames_per_second": 30, "dim_order": "BCHWX"}, "dim_order must name the axes B, C, F, H, W"),
    ):
        with pytest.raises(ValueError, match=message):
            metric(one, two, **arguments)
    with pytest.raises(ValueError, match="frames_per_second is for videos"):
        metric(one[:, :, 0], two[:, :, 0], frames_per_second=30)


def test_lpips(monkeypatch):
    class Network(torch.nn.Module):
        def __init__(self, net, verbose):
            super().__init__()
            self.weight = torch.nn.Parameter(torch.ones(()))
            self.net = net

        def forward(self, one, two):
            assert one.shape[1] == 3
            assert one.amin() >= -1
            assert one.amax() <= 1
            return self.weight * ((one - two) ** 2).mean((1, 2, 3), keepdim=True)

    monkeypatch.setitem(sys.modules, "lpips", types.SimpleNamespace(LPIPS=Network))
    metric = LPIPS()
    assert metric.lpips is None
    one, two = pictures(2, 1, 6, 7)
    one = (one * 1.5).requires_grad_()
    expected = 4 * ((one.clamp(0, 1) - two) ** 2).mean().item()
    distance = metric(one, two)
    assert distance.item() == pytest.approx(expected, rel=1e-5)
    assert metric.lpips.net == "squeeze"
    assert not metric.lpips.weight.requires_grad
    distance.backward()
    assert one.grad.any()
    assert metric(two, two).item() == 0


class Measures:
    """Stands in for pyiqa: the squared error, which compares, and the mean, which does not."""

    class Measure(torch.nn.Module):
        def __init__(self, name):
            super().__init__()
            self.lower_better, self.metric_mode = (True, "FR") if name == "error" else (False, "NR")
            self.weight = torch.nn.Parameter(torch.tensor(2.0))

        def forward(self, one, two=None):
            assert one.dtype == torch.float32
            assert one.ndim == 4
            value = one if two is None else (one - two) ** 2
            return self.weight * value.mean((1, 2, 3))[:, None]

    def list_models(self):
        return ["error", "brightness", "fid", "sfid", "inception_score"]

    def create_metric(self, name, as_loss, loss_reduction, device):
        assert (as_loss, loss_reduction) == (True, "none")
        return self.Measure(name)


def test_image_quality(monkeypatch):
    monkeypatch.setitem(sys.modules, "pyiqa", Measures())
    one, two = pictures(2, 3, 6, 7)
    error = ImageQuality("error")
    assert (error.lower_is_better, error.takes_reference) == (True, True)
    free = one.clone().requires_grad_()
    each = error(free, two, "none")
    expected = 2 * ((one - two) ** 2).mean((1, 2, 3))
    torch.testing.assert_close(each, expected.float())
    torch.testing.assert_close(error(one, two), expected.mean().float())
    each.sum().backward()
    torch.testing.assert_close(free.grad, 4 * (one - two) / one[0].numel(), rtol=1e-5, atol=1e-8)
    assert not error.measure.weight.requires_grad
    brightness = ImageQuality("brightness")
    torch.testing.assert_close(brightness(one[0]), 2 * one[0].mean().float())
    with pytest.raises(ValueError, match="targets must be given for the measure 'error'"):
        error(one)
    with pytest.raises(ValueError, match="targets are not taken by the measure 'brightness'"):
        brightness(one, two)
    with pytest.raises(
        ValueError, match=r"name must be one of 'error', 'brightness'; got 'eror'\. Did you mean 'error'"
    ):
        ImageQuality("eror")
    with pytest.raises(ValueError, match="name must be one of"):
        ImageQuality("fid")
    with pytest.raises(ValueError, match="reduction must be one of"):
        error(one, two, "sum")


def test_image_quality_without_the_package(monkeypatch):
    monkeypatch.setitem(sys.modules, "pyiqa", None)
    with pytest.raises(ImportError, match=r"ImageQuality needs the package pyiqa .*: pip install pyiqa"):
        ImageQuality("dists", required=True)
    with pytest.warns(odak.MissingPackageWarning, match="pip install pyiqa"):
        measure = ImageQuality("dists")
    with pytest.raises(ImportError, match="pip install pyiqa"):
        measure(*pictures(1, 3, 16, 16))


@pytest.mark.slow
def test_image_quality_against_our_own():
    pytest.importorskip("pyiqa", exc_type=(ImportError, RuntimeError))
    one, two = ((255 * picture).round() / 255 for picture in pictures(2, 3, 200, 210))
    torch.testing.assert_close(ImageQuality("psnr")(two, one), PSNR()(two, one, 1.0, "mean").float(), atol=1e-4, rtol=0)
    torch.testing.assert_close(ImageQuality("ssimc")(two, one), SSIM()(two, one).float(), atol=1e-4, rtol=0)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::odak.MissingPackageWarning")
@pytest.mark.parametrize("measure", [CVVDP, FVVDP])
def test_with_the_package(measure):
    metric = measure()
    if not metric.available:
        pytest.skip(f"{measure.__name__}'s package is not installed")
    one, two = (picture.float() for picture in pictures(1, 3, 64, 64))
    two.requires_grad_()
    score = metric(two, one)
    assert 5 < score.item() < 9.9
    score.backward()
    assert two.grad.isfinite().all()
    assert two.grad.any()
    assert metric(one, one).item() == pytest.approx(10, abs=1e-3)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::odak.MissingPackageWarning")
@pytest.mark.parametrize("measure", [CVVDP, FVVDP])
def test_videos_with_the_package(measure):
    """Scores of a grating that reverses are the package's own, depend on the rate, and are averaged over a batch."""
    metric = measure()
    if not metric.available:
        pytest.skip(f"{measure.__name__}'s package is not installed")
    still = torch.full((1, 3, 24, 64, 64), 0.5)
    grating = 0.05 * (torch.arange(64) * (2 * torch.pi / 16)).sin()
    flicker = still + grating * (1 - 2 * (torch.arange(24) % 2))[:, None, None]
    slow, fast = (metric(flicker, still, frames_per_second=rate).item() for rate in (10, 120))
    assert abs(slow - fast) > 0.2 and max(slow, fast) < 9.9
    pair = [torch.cat([flicker, still]), torch.cat([still, still])]
    assert metric(*pair, frames_per_second=10).item() == pytest.approx((slow + 10) / 2, abs=1e-3)
    predictor = getattr(metric, measure.__name__.lower())
    alone, _ = predictor.predict(flicker, still, dim_order="BCFHW", frames_per_second=10)
    assert slow == pytest.approx(alone.item(), abs=1e-5)
    flicker.requires_grad_()
    metric(flicker, still, frames_per_second=10).backward()
    assert flicker.grad.isfinite().all() and flicker.grad.any()


def test_names():
    assert perception.SSIM is SSIM
    assert perception.structural_similarity(*pictures(11, 11)) == SSIM()(*pictures(11, 11))


@pytest.mark.parametrize("metric", [PSNR(), SSIM(), MSSSIM()])
def test_values_that_cannot_be_meant(metric):
    """MS-SSIM of NaN would be 0, the worst score, and PSNR of 8-bit values for a peak of 1 a negative one."""
    one, two = pictures(1, 3, 176, 176)
    for bad in (one * np.nan, one * np.inf, 255 * one):
        with pytest.raises(ValueError, match="predictions must hold finite values of about 0 to 1"):
            metric(bad, two)
        with pytest.raises(ValueError, match="targets must hold finite values of about 0 to 1"):
            metric(two, bad)
    assert metric(255 * one, 255 * two, 255.0).item() == pytest.approx(metric(one, two).item())


def test_values_that_a_transform_hides_are_not_scored():
    """Such values are not read; MS-SSIM of NaN was 0."""
    one, two = pictures(2, 1, 176, 176)
    one[0] = np.nan
    assert torch.func.vmap(MSSSIM())(one, two).isnan().tolist() == [True, False]


def coloured(size=64):
    """Two pictures that formulas give, so that other programs can be handed the same."""
    y, x = torch.meshgrid(*[torch.arange(size, dtype=torch.float64) / size] * 2, indexing="ij")
    one = torch.stack([0.5 + 0.4 * torch.sin(9 * x + 4 * y), 0.5 + 0.4 * torch.cos(7 * y - 3 * x), 0.3 + 0.3 * x * y])
    two = one + 0.1 * torch.stack([torch.sin(40 * x), torch.cos(31 * y), torch.sin(50 * x * y)])
    return one, two.clamp(0, 1)


@pytest.mark.parametrize(
    ("density", "mean", "one_pixel", "another"),
    [(67.02, 0.3468068, 0.2251332, 0.3516156), (30.0, 0.3851879, 0.2852173, 0.4193922)],
)
def test_flip_as_its_authors_compute_it(density, mean, one_pixel, another):
    """Values of flip-evaluator 1.7, which computes in float32 with rounded matrices."""
    target, shown = coloured()
    found = flip(shown, target, density)
    assert found.shape == (1, 1, 64, 64)
    assert FLIP(density)(shown, target).item() == pytest.approx(mean, abs=2e-5)
    assert [found[0, 0, 10, 20].item(), found[0, 0, 40, 50].item()] == pytest.approx([one_pixel, another], abs=1e-4)
    assert flip(target, target).abs().max() == 0
    assert torch.equal(flip(torch.stack([shown, target]), torch.stack([target, target]), density)[:1], found)


def test_gradient_of_flip():
    target, shown = coloured(20)
    picture = shown.clamp(0.05, 0.95).requires_grad_()
    assert torch.autograd.gradcheck(lambda image: FLIP(20)(image, target), picture, fast_mode=True)
    equal = target.clone().requires_grad_()
    FLIP()(equal, target).backward()
    assert equal.grad.isfinite().all()
    with pytest.raises(ValueError, match="pixels_per_degree"):
        FLIP(0)


def test_metrics_of_absolute_luminance():
    """White of 100 cd/m² is 256 on the uniform scale: metrics of the encoded values with that peak."""
    one, two = pictures(1, 1, 20, 24)
    one, two = 1000 * one**2, 1000 * two**2
    encoded = [pu21_encode(luminance) for luminance in (one, two)]
    error = float(((encoded[0] - encoded[1]) ** 2).mean())
    assert PU21PSNR()(one, two).item() == pytest.approx(10 * np.log10(256**2 / error))
    assert PU21SSIM()(one, two).item() == pytest.approx(SSIM()(*encoded, 256.0).item())
    assert PU21SSIM("banding")(one, one).item() == 1
    picture = two.clone().requires_grad_()
    PU21PSNR()(picture, one).backward()
    assert picture.grad.isfinite().all()
    with pytest.raises(ValueError, match="variant"):
        PU21PSNR("pq")
