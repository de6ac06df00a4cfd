"""Bounds of what no pattern can show, against patterns: random ones, and those optimised to break them."""

import warnings

import pytest
import torch

from odak import AccuracyWarning
from odak.learn.wave import Display, Eyes, Iris, Modulator, Run, optimise
from odak.learn.wave.holograms.bounds import LEAST_SHARE, least_error_of_band, least_error_of_light, tell_bounds

PITCH, WAVELENGTH = 8e-6, 532e-9


def noise(*shape, seed=0):
    return torch.rand(*shape, generator=torch.Generator().manual_seed(seed))


def stripes(n, period):
    return (torch.arange(n) % period < period / 2).float().expand(n, n)


def test_the_mean_bounds_the_error():
    target = noise(32, 32) * 0.7
    for mean in (0.2, 0.97):
        bound = least_error_of_light(target, mean, mean)
        images = [noise(32, 32, seed=k) for k in range(5)] + [target, torch.ones(32, 32)]
        errors = [float((image * (mean / image.mean()) - target).square().mean()) for image in images]
        assert min(errors) >= bound * (1 - 1e-5)
        # It is reached: by the target and a constant.
        offset = float((target + (mean - target.mean()) - target).square().mean())
        assert offset == pytest.approx(bound, rel=1e-4)
    assert least_error_of_light(target, 0.1, 0.9) == 0


def narrow(cutoff, n=48):
    """Return a display whose iris passes frequencies up to some cycles per pixel."""
    iris = Iris(cutoff / PITCH * WAVELENGTH * 0.1, 0.1)
    return Display(Modulator((n, n), PITCH, bits=None), WAVELENGTH, 2e-3, iris=iris)


@pytest.mark.usefixtures("small_judge")
@pytest.mark.parametrize("cutoff", [0.06, 0.12, 0.2])
@pytest.mark.parametrize("kind", ["noise", "stripes", "checks"])
def test_no_pattern_is_better_than_the_band_allows(cutoff, kind):
    n = 48
    checks = ((torch.arange(n)[:, None] + torch.arange(n)) % 2).float()
    target = {"noise": noise(n, n), "stripes": stripes(n, 4), "checks": checks}[kind]
    display = narrow(cutoff)
    light = n * float(target.norm())
    bound = least_error_of_band(target, (2 * cutoff, 2 * cutoff), light / LEAST_SHARE)
    assert display.path.band(0, 0) == pytest.approx((2 * cutoff, 2 * cutoff))
    best = torch.inf
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", AccuracyWarning)
        found = optimise(display, target, run=Run(20, progress=False)).phases
    for phases in (found, *(6.3 * noise(1, n, n, seed=k) for k in range(3))):
        image = display.judge(phases)[0][0, 0]
        image = image * (image * target).sum() / image.square().sum()
        best = min(best, float((image - target).square().mean()))
    assert best > bound
    # And the bound says something where the detail is finer than passes.
    if kind == "checks" or (kind == "noise" and cutoff < 0.1):
        assert bound > best / 12


def test_no_positive_image_of_the_band_is_better():
    """Periodic images of a band, among them the best one, whose light is all in the picture."""
    target, band = noise(64, 64, seed=4), 0.2
    f = torch.fft.fftfreq(64)
    passed = torch.hypot(f[:, None], f) <= band
    image = torch.fft.ifft2(torch.fft.fft2(target) * passed).real
    error = float((image - target).square().mean())
    bound = least_error_of_band(target, (band, band), float(image.sum()))
    assert image.min() > 0 and error / 4 < bound < error
    assert least_error_of_band(target, (0.8, 0.8), 1.0) == 0
    assert least_error_of_band(torch.ones(32, 32), (0.1, 0.1), 1024.0) == 0


def test_what_cannot_be_had_is_said_before_it_is_tried():
    with pytest.warns(
        AccuracyWarning, match=r"finer detail than passes the stop: no pattern that sends 1% .* above \d"
    ):
        optimise(narrow(0.06), stripes(48, 2), run=Run(1, progress=False))
    with warnings.catch_warnings():
        warnings.simplefilter("error", AccuracyWarning)
        tell_bounds(narrow(0.06), torch.full((1, 1, 48, 48), 0.5))
        tell_bounds(Display(Modulator((48, 48), PITCH), WAVELENGTH, 2e-3), stripes(48, 2)[None, None])
    # A pupil of 1 mm at 40 mm, where an order is 2.66 mm wide: frequencies of the image up to 0.38 cycles per pixel.
    eye = Display(Modulator((48, 48), PITCH), WAVELENGTH, Eyes(0.04, diameter=1e-3))
    assert eye.path.band(0, 0) == pytest.approx((1e-3 * PITCH / (WAVELENGTH * 0.04),) * 2)
