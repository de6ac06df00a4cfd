"""Numbers and pictures of reports against closed forms: quality, colours, sizes, scales and when a run ends."""

import warnings
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from PIL import Image
from scipy.ndimage import correlate1d

from odak.cli import report as metrics
from odak.cli.options import InputError
from odak.learn.wave.training import best_scale


def test_psnr_of_a_constant_error():
    target = torch.full((16, 16), 0.5)
    assert metrics.psnr(target + 0.1, target) == pytest.approx(20, abs=1e-5)
    assert metrics.psnr(target, target) is None


def test_ssim_of_constant_images_is_the_luminance_term():
    first, second = torch.full((12, 15), 0.2), torch.full((12, 15), 0.7)
    expected = (2 * 0.2 * 0.7 + 1e-4) / (0.2**2 + 0.7**2 + 1e-4)
    assert metrics.ssim(first, second) == pytest.approx(expected, rel=1e-6)


def test_ssim_against_another_implementation():
    rng = np.random.default_rng(1)
    x = rng.random((40, 31))
    y = np.clip(x + 0.2 * rng.standard_normal(x.shape), 0, 1)
    taps = np.exp(-(np.arange(-5, 6) ** 2) / (2 * 1.5**2))
    taps /= taps.sum()

    def mean(a):
        return correlate1d(correlate1d(a, taps, axis=0), taps, axis=1)[5:-5, 5:-5]

    mx, my = mean(x), mean(y)
    vx, vy, cov = mean(x**2) - mx**2, mean(y**2) - my**2, mean(x * y) - mx * my
    c1, c2 = 0.01**2, 0.03**2
    expected = np.mean((2 * mx * my + c1) * (2 * cov + c2) / ((mx**2 + my**2 + c1) * (vx + vy + c2)))
    assert metrics.ssim(torch.tensor(x), torch.tensor(y)) == pytest.approx(expected, rel=1e-12)


def test_ssim_of_an_image_with_itself_and_its_negative():
    image = torch.rand(3, 20, 20, generator=torch.Generator().manual_seed(0))
    assert metrics.ssim(image, image) == pytest.approx(1)
    assert metrics.ssim(image, 1 - image) < 0


def test_ssim_refuses_what_has_no_window():
    with pytest.raises(ValueError, match="11 x 11"):
        metrics.ssim(torch.rand(10, 20), torch.rand(10, 20))
    with pytest.raises(ValueError, match="shape"):
        metrics.ssim(torch.rand(20, 20), torch.rand(20, 21))


def test_best_scale_is_the_minimum_of_the_squared_error():
    generator = torch.Generator().manual_seed(2)
    image, target = (torch.rand(2, 9, 7, dtype=torch.float64, generator=generator) for _ in range(2))
    scale = best_scale(image, target)
    assert scale.shape == (2, 1, 1)
    errors = [((factor * scale * image - target) ** 2).sum((-2, -1)) for factor in (0.99, 1.0, 1.01)]
    assert torch.all(errors[1] < errors[0]) and torch.all(errors[1] < errors[2])
    assert torch.equal(best_scale(torch.zeros(4, 4), torch.ones(4, 4)), torch.zeros(1, 1))


def test_the_quality_of_a_channel():
    """Within the window the image is half of the target: a scale of 2 leaves no error there, and 1 outside."""
    target = torch.zeros(24, 20)
    target[4:16, 4:16] = torch.rand(12, 12, generator=torch.Generator().manual_seed(3)) + 0.2
    # A tenth of the maximum counts as lit, what is darker does not.
    target[0, :2] = target.max() * torch.tensor([0.11, 0.09])
    window = slice(4, 16), slice(4, 16)
    image = target / 2
    image[20:] = 0.25
    found = metrics.measure(target, window, image, 4 * target)
    assert min(found[name] or np.inf for name in ("psnr_db", "psnr_before_quantisation_db")) > 100
    assert found["ssim"] == pytest.approx(1) and found["scale"] == pytest.approx(2)
    assert found["psnr_frame_db"] == pytest.approx(-10 * np.log10(4 * 20 * 0.25 / 480), abs=1e-4)
    assert found["efficiency"] == pytest.approx(float(image.mean()))
    lit = float(image[:20].sum() - image[0, 1])
    assert found["efficiency_lit"] == pytest.approx(lit / 480)
    halved = metrics.measure(target, window, image, 4 * target, scales=(1.0, 0.25))
    assert halved["psnr_db"] == pytest.approx(-10 * np.log10(float((target[window] / 2).square().mean())), abs=1e-4)
    assert halved["psnr_before_quantisation_db"] is None and halved["scale"] == 1


def test_the_quality_of_all_channels():
    intensity = torch.rand(2, 16, 16, dtype=torch.float64)
    target = SimpleNamespace(intensity=intensity, window=(slice(0, 16), slice(0, 8)))
    scaled = intensity.clone()
    scaled[0, :, :8] += 0.2
    scaled[:, :, 8:] = 9
    channels = [
        {"ssim": 0.5, "efficiency": 0.1, "efficiency_lit": 0.2},
        {"ssim": 0.9, "efficiency": 0.5, "efficiency_lit": 0.4},
    ]
    found = metrics.overall(target, scaled, channels)
    assert found["psnr_db"] == pytest.approx(-10 * np.log10(0.02))
    assert [found[name] for name in ("ssim", "efficiency", "efficiency_lit")] == pytest.approx([0.7, 0.3, 0.3])


def test_decibels_of_mean_errors():
    assert metrics.decibels(1e-3) == pytest.approx(30) and metrics.decibels(0) is None
    channels = [{"db": 20.0}, {"db": None}, {"db": 40.0}, {"db": 20.0}]
    assert metrics.mean_decibels(channels, "db") == pytest.approx(-10 * np.log10(0.0201 / 4))
    assert metrics.mean_decibels([{"db": None}], "db") is None
    assert [metrics.finite(value) for value in (1.5, np.inf, -np.inf, np.nan)] == [1.5, None, None, None]


def test_each_warning_is_told_once():
    told = []
    with metrics.collected_warnings(told.append) as texts:
        for text in ("a  light\nis lost", "a light is lost", "another"):
            warnings.warn(text, metrics.OdakWarning, stacklevel=1)
    assert texts == told == ["a light is lost", "another"]


def test_devices_of_this_machine():
    assert metrics.find_device("cpu") == torch.device("cpu") == metrics.devices()[0]
    for name in ("cuda:99", "abacus"):
        with pytest.raises(InputError, match=rf"--device must be .*auto, cpu.*got '{name}'"):
            metrics.find_device(name)
    rows = dict(metrics.describe_machine())
    assert rows["devices"].startswith("cpu") and int(rows["threads"]) == torch.get_num_threads()
    assert {"odak", "python", "numpy", "scipy", "torch", "platform", "fft"} <= set(rows)


def test_pictures_have_256_levels():
    grey = metrics.to_image(torch.tensor([[[-1.0, 0, 0.5, 1, 2, 100 / 255]]]))
    assert grey.mode == "L" and np.array(grey).tolist() == [[0, 0, 128, 255, 255, 100]]
    colours = metrics.to_image(torch.tensor([[[0.2]], [[0.4]], [[1.0]]]))
    assert colours.mode == "RGB" and colours.getpixel((0, 0)) == (51, 102, 255)
    wide = metrics.picture_panel("", torch.full((1, 30, 1920), 0.4)).image
    assert wide.size == (960, 15) and wide.getpixel((480, 7)) == (102, 102, 102)
    assert metrics.picture_panel("", torch.ones(1, 9, 960)).image.size == (960, 9)
    assert metrics.picture_panel("", torch.ones(1, 1, 2000)).image.size == (960, 1)


def test_numbers_of_phases_and_differences():
    """Phases are cyclic; differences are means over channels, on a scale that is alike on both sides of zero."""
    phases = torch.pi * torch.tensor([[0.0, 2 / 9, 8 / 9, -16 / 9, 20 / 9]])
    panel = metrics.phase_panel("phase", phases)
    np.testing.assert_allclose(np.asarray(panel.image)[0], np.pi * np.array([0, 2, 8, 2, 2]) / 9, atol=1e-5)
    assert panel.scale == ("twilight", 0, 2 * np.pi, ("0", "π", "2π rad"))
    difference = torch.tensor([-0.2, -0.1, 0, 0.1, 0.2]).repeat(2, 1, 1) * torch.tensor([0.5, 1.5])[:, None, None]
    panel = metrics.difference_panel("difference", difference)
    np.testing.assert_allclose(np.asarray(panel.image)[0], [-0.2, -0.1, 0, 0.1, 0.2], atol=1e-6)
    name, least, largest, labels = panel.scale
    assert (name, least) == ("RdBu_r", -largest) and largest == pytest.approx(0.2, rel=0.02)
    assert labels == ("-0.2, too dark", "0", "0.2, too bright")
    assert metrics.difference_panel("", torch.zeros(1, 2, 2)).scale[3][2] == "1e-06, too bright"
    # Half a per cent of the samples does not count, also where only a part of them is looked at.
    many = torch.full((1, 1500, 1400), 0.1)
    many[0, 0] = 9.0
    assert metrics.difference_panel("", many).scale[2] == pytest.approx(0.1)
    # Neighbouring phases are not averaged.
    fine = metrics.phase_panel("", torch.tensor([0.1, 6.2]).repeat(4, 1000))
    assert fine.image.size == (960, 2) and set(np.unique(fine.image)) == {np.float32(0.1), np.float32(6.2)}


@pytest.mark.usefixtures("sheets")
def test_sheets_hold_their_panels():
    """Small pictures are enlarged by a whole factor, and stretched where samples are not square."""
    panel = metrics.Panel("a caption", Image.new("RGB", (100, 50), (1, 2, 3)))
    for aspect, size in ((2.0, (300, 300)), (0.5, (600, 150))):
        sheet = np.array(metrics.sheet([[panel, panel], [panel]], aspect=aspect))
        filled = (sheet == (1, 2, 3)).all(-1)
        assert filled.sum() == 3 * size[0] * size[1]
        rows, columns = filled.any(1), filled.any(0)
        assert columns.sum() == 2 * size[0] and rows.sum() == 2 * size[1]
        assert columns.argmax() == metrics.MARGIN and sheet.shape[1] == 2 * (size[0] + metrics.MARGIN) + metrics.MARGIN
        # An outline lies around each picture, and its caption above it, where it begins.
        top, left = rows.argmax(), metrics.MARGIN
        # With a gap of one pixel at two sides.
        for outline in (sheet[top - 1, left + 9], sheet[top + size[1] : top + size[1] + 2, left + 9].min(0)):
            assert (outline > 150).all() and (outline < 250).all()
        for outline in (sheet[top + 9, left - 1], sheet[top + 9, left + size[0] : left + size[0] + 2].min(0)):
            assert (outline > 150).all() and (outline < 250).all()
        ink = np.argwhere((sheet[: top - 2] < 128).all(-1))
        assert 0 <= ink[:, 1].min() - left < 4 and ink[:, 0].max() > top - 12


@pytest.mark.usefixtures("sheets")
def test_captions_are_as_wide_as_their_panels_at_most():
    """A long one is set smaller: it fills the width of its panel, and nothing beyond."""
    sheet = np.array(
        metrics.sheet([[metrics.Panel(" ".join(["many words"] * 6), Image.new("RGB", (300, 20), "white"))]])
    )
    ink = np.flatnonzero((sheet[: metrics.MARGIN + 20] < 200).all(-1).any(0))
    assert ink.min() >= metrics.MARGIN and metrics.MARGIN + 240 < ink.max() <= metrics.MARGIN + 300


@pytest.mark.usefixtures("sheets")
def test_scales_and_lengths_below_panels():
    """A bar as wide as the panel has the colours of its numbers from left to right; ticks are multiples of 5 mm."""
    values = torch.linspace(0, 2 * torch.pi * 0.999, 100).repeat(10, 1)
    grey = metrics.picture_panel("intensity", torch.full((1, 10, 100), 0.5))
    sheet = np.array(metrics.sheet([[grey, metrics.phase_panel("phase", values)]], 0.02)).astype(int)
    left, wide = 2 * metrics.MARGIN + 300, 300
    top = (sheet == 128).all(-1)[:, metrics.MARGIN : metrics.MARGIN + wide].all(-1).argmax()
    picture, bar = (sheet[row, left + 2 : left + wide - 2] for row in (top + 15, top + 30 + metrics.GAP + 5))
    assert np.abs(picture - bar).max() < 20 and np.ptp(bar[:, 2]) > 100
    # The panel is 20 mm wide; its ticks stand at multiples of 5 mm, which are 75 pixels apart.
    ticks = np.flatnonzero((sheet[top + 30 + metrics.GAP // 2 + 3, : metrics.MARGIN + wide + 3] < 128).all(-1))
    np.testing.assert_allclose(ticks[np.append(True, np.diff(ticks) > 1)], metrics.MARGIN + 75 * np.arange(5), atol=1)


def test_a_run_ends_when_nothing_is_gained():
    """Ten iterations must lower the loss by 2.3 % together."""
    for factor, ticks in ((0.999, 11), (0.99, 20)):
        with metrics.progress("", 20, True, settles=True) as clock:
            for iteration in range(20):
                if clock.tick(iteration, torch.tensor(factor**iteration)):
                    break
        assert clock.ticks == ticks and clock.settled == (ticks < 20) and not clock.interrupted
        assert clock.loss == pytest.approx(factor ** (ticks - 1))
        ended = "nothing was gained any more after 11 iterations" if ticks < 20 else "20 iterations"
        assert clock.reached(20) == ended and clock.seconds_per_tick() >= 0


def test_runs_that_are_cut_short():
    with metrics.progress("", 5, True, partial=True) as clock:
        clock.tick(0, torch.zeros(3, 3))
    assert clock.interrupted and clock.loss is None and clock.seconds_per_tick() is None
    assert clock.reached(5) == "interrupted after 1 of 5 iterations"
    with pytest.raises(KeyboardInterrupt), metrics.progress("", 5, True) as clock:
        clock.tick(0, torch.tensor(1.0))
    clock.first, clock.last, clock.ticks = 1.0, 7.0, 4
    assert clock.seconds_per_tick() == 2
