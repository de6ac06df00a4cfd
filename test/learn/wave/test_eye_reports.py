"""What an eye has of a display: against closed forms of blur, noise, speckle and angles, and against its parts."""

import math
import xml.etree.ElementTree as Xml

import pytest
import torch

from odak._drawn import svg
from odak.instruments import Lens
from odak.learn.wave import DepthScene, Display, Eyes, Modulator, Run, eye_report, eyebox_map, optimise
from odak.learn.wave.holograms import eye_reports as reports

pytestmark = pytest.mark.usefixtures("small_judge")

GREEN, PITCH, AWAY = 532e-9, 8e-6, 0.1
SIZE, FAST = (32, 48), Run(5, progress=False, seed=0)


def drawn(seed, size=(256, 320)):
    return torch.rand(size, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def filtered(picture, degrees, passed):
    axes = [torch.fft.fftfreq(n, a, dtype=torch.float64) for n, a in zip(picture.shape, degrees, strict=True)]
    return torch.fft.ifft2(torch.fft.fft2(picture) * passed(torch.hypot(axes[0][:, None], axes[1]))).real


@pytest.mark.parametrize("degrees", [(0.01, 0.01), (0.01, 0.008)])
def test_resolution_ends_where_a_tenth_of_the_contrast_is_left(degrees):
    # A blur with the transfer exp(−(f/f0)²), which is 0.1 at f0·√ln 10.
    wide = 16.0
    blurred = filtered(drawn(0), degrees, lambda f: torch.exp(-((f / wide) ** 2)))
    found = reports.resolved_frequency(3 * blurred, drawn(0), degrees)
    assert found == pytest.approx(wide * math.sqrt(math.log(10)), rel=0.02)


def test_resolution_ends_where_noise_is_as_strong_as_the_picture():
    # Noise whose power over that of the chart is (f/f0)², which is 1 at f0.
    degrees, equal = (0.01, 0.01), 30.0
    noise = filtered(drawn(1), degrees, lambda f: f / equal)
    assert reports.resolved_frequency(drawn(0) + noise, drawn(0), degrees) == pytest.approx(equal, rel=0.06)
    # Noise alone resolves nothing, and the chart itself all that pixels can show.
    assert reports.resolved_frequency(drawn(1), drawn(0), degrees) < 2
    assert reports.resolved_frequency(drawn(0), drawn(0), (0.01, 0.02)) == 0.5 / 0.02


@pytest.mark.parametrize("frames", [1, 4])
def test_speckle_of_random_phases_has_the_contrast_of_the_mean_of_frames(frames):
    # The pupil is small, so that a pixel is much less than a grain of speckle and does not average it.
    display = Display(Modulator((160, 160), PITCH, None), GREEN, Eyes(AWAY, diameter=1.5e-3), frames)
    phases = 2 * math.pi * torch.rand(frames, 160, 160, generator=torch.Generator().manual_seed(3))
    seen = display.judge(phases)[0]
    assert float(reports.contrast_without_rim(seen)) == pytest.approx(frames**-0.5, rel=0.1)


def test_angles_of_pixels_add_up_to_the_field_of_view():
    eyes = Eyes(Lens(0.03, before=0.028, after=0.02), [(0.0, 0.0)], 3e-3)
    display = Display(Modulator((8, 1001), 20e-6), GREEN, eyes)
    (wide,) = display.extents()
    sight = display.path.sight(0, 0)
    across = [reports._degrees(sight, 1, (0.0, (k - 500) * 20e-6)) for k in range(1001)]
    assert sum(across) == pytest.approx(wide["field_of_view"][1], rel=1e-6)
    assert across[0] < 0.95 * across[500]
    # Off the axis, an angle along rows is that between two directions.
    low, high = (torch.tensor([y, 500 * 20e-6, -sight.ray_matrix()[1]], dtype=torch.float64) for y in (-1e-5, 1e-5))
    between = math.degrees(float(torch.linalg.cross(low, high).norm() / low.norm() / high.norm()))
    assert reports._degrees(sight, 0, (0.0, 500 * 20e-6)) == pytest.approx(between, rel=1e-6)


@pytest.fixture(scope="module")
def reported():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("odak.learn.wave.displays.judge._LEAST", 128)
        patch.setattr("odak.learn.wave.displays.judge._AIRY", 16)
        display = Display(Modulator(SIZE, PITCH), [GREEN, 639e-9], Eyes(AWAY, diameter=1.2e-3), frames=3)
        target = DepthScene(drawn(5, SIZE), torch.full(SIZE, AWAY))
        return display, target, eye_report(display, target, (0.0, 2e-4), (1, 2), 1.2e-3, [0.09], 2, FAST)


def test_report_is_made_of_maps_of_three_holograms(reported):
    display, target, found = reported
    alone = eyebox_map(optimise(display, target, run=FAST), target, (0.0, 2e-4), (1, 2), 1.2e-3, foci=[0.09])
    torch.testing.assert_close(found.scene.psnr, alone.psnr)
    torch.testing.assert_close(found.scene.psnr_of_focus, alone.psnr_of_focus)
    assert found.speckle.shape == found.flat.brightness.shape == (1, 2) and found.resolution.shape == (2, 2)
    # Of two colours the worse one, without an eighth of the image at each rim.
    inner = found.flat.images[..., 4:28, 6:42].double()
    torch.testing.assert_close(found.speckle, (inner.std((-2, -1), correction=0) / inner.mean((-2, -1))).amax(-1))
    assert float(found.speckle[0, 0]) < 0.5
    # Diffraction at the pupil, which is in the way, and not the pixels.
    assert found.pupil_limit == pytest.approx(math.radians(1.2e-3 / 639e-9))
    assert found.pixel_limit == pytest.approx(0.5 / math.degrees(PITCH / AWAY), rel=1e-6)
    assert bool((found.resolution > 0.3 * found.pupil_limit).all() and (found.resolution < found.pupil_limit).all())


def test_report_draws_itself(reported):
    _, _, found = reported
    drawing = svg(found.figure())
    texts = [text.text for text in Xml.fromstring(drawing).iter("{http://www.w3.org/2000/svg}text")]
    for written in (
        f"{float(found.scene.psnr[0, 0]):.0f}",
        f"{float(found.flat.brightness[0, 1]):.2f}",
        f"{float(found.speckle[0, 0]):.2f}",
        f"{float(found.resolution[1, 0]):.0f}",
        "PSNR over focus (dB)",
    ):
        assert written in texts
    assert "cycles per degree" in repr(found) and "<img" in found._repr_html_()


def test_what_does_not_fit_a_report_is_refused(reported, tmp_path):
    display, target, _ = reported
    for wrong, words in (
        ({"display": Display(Modulator(SIZE, PITCH), GREEN, 2e-3)}, "display must be one that"),
        ({"parts": (3, 2)}, "parts must be of 16 × 16 pixels or more"),
        ({"run": Run(2, checkpoint=tmp_path / "state.pt")}, "run must be without a checkpoint"),
    ):
        with pytest.raises(ValueError, match=words):
            eye_report(**({"display": display, "target": target, "box": 1e-3, "parts": 2} | wrong))
    with pytest.raises(TypeError, match="display must be"):
        eye_report(target, target, 1e-3)
