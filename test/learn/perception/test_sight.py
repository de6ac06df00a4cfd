"""Viewing and gazes: angles by trigonometry, one answer for numbers and a Viewing, each picture of a batch alone."""

import dataclasses
import math
import sys
import types

import pytest
import torch

import odak
from odak.learn import perception
from odak.learn.perception import (
    CVVDP,
    FLIP,
    FVVDP,
    BlurLoss,
    CSFLoss,
    MetamericLoss,
    MetamerMSELoss,
    RadiallyVaryingBlur,
    Viewing,
    VisibilityLoss,
    eccentricity_report,
    flip,
    foveated_budget,
    make_3d_location_map,
    make_eccentricity_distance_maps,
    make_pooling_size_map_lod,
    make_pooling_size_map_pixels,
    make_radial_map,
    ring_masks,
)

GAZES = torch.tensor([[0.2, 0.3], [0.9, 0.5], [0.4, 1.0]])
SEEN = Viewing(0.5, 0.4, gaze=(0.2, 0.7), peak_luminance=300, black_luminance=0.5)
LENGTHS = {"real_image_width": 0.5, "real_viewing_distance": 0.4}


def noise(*shape, seed=0):
    return torch.rand(shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def test_angles_and_luminances():
    seen = Viewing(2.0, 1.0, (100, 180), black_luminance=0.5, ambient_light=200 * math.pi, reflectivity=0.01)
    assert seen.field_of_view == pytest.approx(90)
    # A pixel in the middle is 2/180 wide, one unit away.
    assert 1 / seen.pixels_per_degree == pytest.approx(2 * math.degrees(math.atan(1 / 180)), rel=1e-4)
    assert (seen.reflected, seen.darkest) == pytest.approx((2.0, 2.5))
    assert seen.luminance(torch.tensor([0.0, 1.0])).tolist() == pytest.approx([2.5, 102.0])
    assert "90° wide, 1.57 pixels per degree, 2.5 to 102 cd/m², gaze (0.5, 0.5)" in repr(seen)
    assert "a track of 3 gazes" in repr(Viewing(gaze=GAZES))
    assert Viewing("50cm", "40 cm") == Viewing(0.5, 0.4) and hash(Viewing()) == hash(Viewing(0.2, 0.7))


def test_a_head_mounted_display():
    wide = Viewing.head_mounted((1000, 1000), 110)
    assert wide.field_of_view == pytest.approx(110)
    by_density = Viewing.head_mounted((1000, 1000), pixels_per_degree=wide.pixels_per_degree)
    assert by_density.field_of_view == pytest.approx(110)
    angle, _ = make_eccentricity_distance_maps((0.5, 0.5), (101, 101), viewing=wide, dtype=torch.float64)
    assert math.degrees(angle[50, 0]) == pytest.approx(55)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Viewing(-1), "real_image_width must be positive"),
        (lambda: Viewing(black_luminance=200), "black_luminance must be less than the peak 100, got 200"),
        (lambda: Viewing(ambient_light=-1), "ambient_light must be at least 0"),
        (lambda: Viewing(reflectivity=2), "reflectivity must be from 0 to 1, got 2"),
        (lambda: Viewing(gaze=(1, 2, 3)), "gaze must be two finite numbers"),
        (lambda: Viewing().pixels_per_degree, "resolution must be given for pixels_per_degree"),
        (lambda: Viewing.head_mounted((10, 10)), "field_of_view or pixels_per_degree must be given, not both"),
        (lambda: Viewing.head_mounted((10, 10), 200), "field_of_view must be below 180 degrees, got 200"),
        (lambda: FVVDP(encoding="Luminance"), "viewing must be given for pictures in luminance"),
        (lambda: make_radial_map((4, 4), [[1, 2], [3]]), "gaze must be two finite numbers"),
    ],
)
@pytest.mark.filterwarnings("ignore::odak.MissingPackageWarning")
def test_what_no_viewing_can_be(make, message):
    with pytest.raises(ValueError, match=message):
        make()
    with pytest.raises(TypeError, match=r"viewing must be an odak\.learn\.perception\.Viewing, got"):
        MetamericLoss(viewing=(0.5, 0.4))


def test_two_units_are_pointed_out():
    with pytest.warns(odak.ArgumentWarning, match="both are lengths in one unit"):
        Viewing(0.5, 600)


FUNCTIONS = {
    "location": lambda **view: make_3d_location_map((9, 12), **view),
    "angle": lambda **view: make_eccentricity_distance_maps((0.2, 0.7), (9, 12), **view)[0],
    "pixels": lambda **view: make_pooling_size_map_pixels((0.2, 0.7), (9, 12), **view),
    "level": lambda **view: make_pooling_size_map_lod((0.2, 0.7), (9, 12), **view),
    "rings": lambda **view: ring_masks((30, 40), (0.2, 0.7), **view),
    "budget": lambda **view: torch.tensor([one.samples for one in foveated_budget((30, 40), (0.2, 0.7), **view)]),
    "blur": lambda **view: RadiallyVaryingBlur().blur(noise(1, 1, 20, 24), centre=(0.2, 0.7), **view),
    "statistics": lambda **view: MetamericLoss(n_pyramid_levels=2).calc_statsmaps(
        noise(1, 1, 32, 32), (0.2, 0.7), 0.2, **view
    )[1],
}


@pytest.mark.parametrize("name", FUNCTIONS)
def test_functions_take_a_viewing_for_the_numbers(name):
    by_numbers, seen = FUNCTIONS[name](**LENGTHS), FUNCTIONS[name](viewing=SEEN)
    assert torch.equal(by_numbers, seen) and not torch.equal(by_numbers, FUNCTIONS[name]())


LOSSES = {
    BlurLoss: {},
    MetamericLoss: {"n_pyramid_levels": 2},
    MetamerMSELoss: {"n_pyramid_levels": 2, "iterations": 0},
    VisibilityLoss: {"n_levels": 3},
}


@pytest.mark.parametrize("kind", LOSSES)
def test_losses_take_a_viewing_for_the_numbers(kind):
    image, target = noise(1, 3, 32, 32), noise(1, 3, 32, 32, seed=1)
    luminances = {"peak_luminance": 300, "black_luminance": 0.5} if kind is VisibilityLoss else {}
    by_numbers = float(kind(**LENGTHS, **luminances, **LOSSES[kind])(image, target, (0.2, 0.7)))
    loss = kind(viewing=SEEN, **LOSSES[kind])
    assert float(loss(image, target)) == by_numbers
    assert loss.real_image_width == 0.5 and float(loss(image, target, (0.9, 0.1))) != by_numbers
    # A changed number is another viewing.
    loss.real_viewing_distance = 0.8
    assert loss.viewing == dataclasses.replace(SEEN, real_viewing_distance=0.8)
    assert float(loss(image, target)) != by_numbers


def test_luminances_of_a_viewing_count():
    image, target = noise(1, 3, 32, 32), noise(1, 3, 32, 32, seed=1)
    by_numbers = CSFLoss(**LENGTHS, peak_luminance=300, black_luminance=0.5)(image, target)
    assert torch.equal(by_numbers, CSFLoss(viewing=SEEN)(image, target))
    # Light that the display reflects lowers contrast.
    lit = dataclasses.replace(SEEN, ambient_light=2e4)
    assert all(
        kind(viewing=lit)(image, target) < kind(viewing=SEEN)(image, target) for kind in (CSFLoss, VisibilityLoss)
    )


@pytest.mark.parametrize("kind", [BlurLoss, VisibilityLoss])
def test_a_gaze_for_each_picture(kind):
    """Of the metameric losses: test_metameric.py."""
    image, target = noise(3, 3, 32, 32).requires_grad_(), noise(3, 3, 32, 32, seed=1)
    loss = kind(**LOSSES[kind])
    each = zip(image.split(1), target.split(1), GAZES, strict=True)
    singly = torch.stack([kind(**LOSSES[kind])(one, two, gaze) for one, two, gaze in each]).mean()
    value = loss(image, target, GAZES)
    torch.testing.assert_close(value, singly, rtol=1e-12, atol=0)
    torch.testing.assert_close(*(torch.autograd.grad(one, image)[0] for one in (value, singly)))
    assert torch.equal(kind(viewing=Viewing(gaze=GAZES), **LOSSES[kind])(image, target), value)
    with pytest.raises(ValueError, match=r"gaze must be \(x, y\) or \[B, 2\] for 3 pictures"):
        loss(image, target, GAZES[:2])


def test_blurs_metamers_and_maps_of_several_gazes(monkeypatch):
    picture, blur = noise(3, 1, 32, 32), RadiallyVaryingBlur()
    blurred = blur.blur(picture, centre=GAZES)
    alone = [RadiallyVaryingBlur().blur(picture[i : i + 1], centre=GAZES[i]) for i in range(3)]
    assert torch.equal(blurred, torch.cat(alone))
    # Maps are kept for all gazes, and made again for those that move.
    made = []
    level_map = perception.foveation.level_map
    monkeypatch.setattr(perception.foveation, "level_map", lambda *a, **k: made.append(a) or level_map(*a, **k))
    blur.blur(picture, centre=GAZES)
    assert not made
    blur.blur(picture, centre=[(0.1, 0.1), *GAZES[1:].tolist()])
    assert len(made) == 1
    maker = MetamerMSELoss(n_pyramid_levels=2, iterations=1, viewing=Viewing(gaze=GAZES))
    metamers = maker.gen_metamer(picture)
    assert torch.equal(metamers[1:2], maker.gen_metamer(picture[1:2], GAZES[1]))
    for maps in (make_eccentricity_distance_maps, make_pooling_size_map_pixels, make_pooling_size_map_lod):
        several, *singly = (maps(gaze, (9, 12)) for gaze in (GAZES, *GAZES))
        if maps is make_eccentricity_distance_maps:
            several, singly = several[0], [one for one, _ in singly]
        torch.testing.assert_close(several, torch.stack(singly))
    torch.testing.assert_close(
        make_radial_map((9, 12), GAZES), torch.stack([make_radial_map((9, 12), gaze) for gaze in GAZES])
    )


def test_reports_of_several_gazes():
    one, two = noise(3, 3, 40, 40), noise(3, 3, 40, 40, seed=1)
    report = eccentricity_report(one, two, GAZES, edges=(0, 2, 5))
    singly = [eccentricity_report(one[i], two[i], GAZES[i], edges=(0, 2, 5)) for i in range(3)]
    for index, ring in enumerate(report.rings):
        parts = [each.rings[index] for each in singly]
        pixels = torch.tensor([part.pixels for part in parts], dtype=torch.float64)
        assert ring.pixels == round(float(pixels.mean()))
        errors = torch.stack([10 ** (-part.psnr / 10) for part in parts])
        mean = (errors * pixels).nansum() / pixels.sum()
        assert float(ring.psnr) == pytest.approx(-10 * math.log10(mean), rel=1e-9)
    assert "gaze (0.2, 0.3) and (0.4, 1)" in report.conditions
    several = foveated_budget((30, 40), GAZES, 1.0, 0.5)
    singly = [foveated_budget((30, 40), gaze, 1.0, 0.5) for gaze in GAZES]
    total = sum(ring.samples for budget in singly for ring in budget) / 3
    assert sum(ring.samples for ring in several) == pytest.approx(total)


def test_flip_by_the_density_of_pixels():
    one, two = noise(1, 3, 24, 32), noise(1, 3, 24, 32, seed=1)
    seen = Viewing(0.1, 0.6)
    density = 32 * 0.6 / 0.1 * math.pi / 180
    assert torch.equal(flip(one, two, viewing=seen), flip(one, two, density))
    assert torch.equal(FLIP(viewing=seen)(one, two), FLIP(density)(one, two))


class Predictor:
    """Stands in for both models of vision, and keeps what it was asked."""

    def __init__(self, **options):
        self.options, self.asked = options, []

    def predict(self, one, two, dim_order, frames_per_second=0, fixation_point=None):
        self.asked.append(fixation_point)
        return 10 - (one - two).abs().mean(), {}


def display(*values, **options):
    return values, options


@pytest.mark.parametrize("measure", [CVVDP, FVVDP])
def test_models_of_vision_are_told_the_display(measure, monkeypatch):
    own = ("vvdp" if measure is CVVDP else "fvvdp") + "_display_"
    parts = {f"{own}photo_eotf": display, f"{own}geometry": display, measure.__name__.lower(): Predictor}
    module = "pycvvdp" if measure is CVVDP else "pyfvvdp"
    monkeypatch.setitem(sys.modules, module, types.SimpleNamespace(**parts))
    seen = Viewing(0.6, 0.5, gaze=(0.25, 0.75), peak_luminance=1000, black_luminance=0.01, ambient_light=30)
    metric, picture = measure(viewing=seen, encoding="luminance"), torch.full((2, 3, 20, 40), 700.0)
    assert metric(picture, picture).item() == 10
    predictor = metric._predictor((20, 40))
    (peak, contrast), light = predictor.options["display_photometry"]
    assert (peak, contrast, light["E_ambient"]) == (1000, pytest.approx(1e5), 30) and light["EOTF"] == "linear"
    (size,), geometry = predictor.options["display_geometry"]
    assert size == (40, 20) and geometry["distance_m"] == 0.5
    assert geometry["fov_horizontal"] == pytest.approx(2 * math.degrees(math.atan(0.6)))
    if measure is CVVDP:
        with pytest.raises(ValueError, match="CVVDP has no fovea, so that gaze must be None"):
            metric(picture, picture, gaze=(0.5, 0.5))
        return
    assert predictor.options["foveated"] is True
    # The middle of the first pixel is 0.
    assert [place.tolist() for place in predictor.asked] == [[9.5, 14.5]] * 2
    metric(picture, picture, gaze=[(0.0, 0.0), (1.0, 1.0)])
    assert [place.tolist() for place in predictor.asked[2:]] == [[-0.5, -0.5], [39.5, 19.5]]
    video = picture[:, :, None].expand(-1, -1, 4, -1, -1)
    metric(video, video, frames_per_second=30, gaze=torch.rand(4, 2))
    assert predictor.asked[-1].shape == (4, 2)
    with pytest.raises(ValueError, match=r"\[B, 2\] for 4 pictures"):
        metric(video, video, frames_per_second=30, gaze=torch.rand(3, 2))
    with pytest.raises(ValueError, match="FVVDP has no fovea"):
        FVVDP()(picture / 1000, picture / 1000, gaze=(0.5, 0.5))


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::odak.MissingPackageWarning")
@pytest.mark.parametrize("gaze", [(0.5, 0.5), (0.9, 0.4)])
def test_foveated_quality_is_that_of_the_package(gaze):
    """Geometry by the diagonal of the display in inches, the package's own way of stating it."""
    metric = FVVDP(viewing=Viewing(0.3, 0.5, peak_luminance=1000, black_luminance=0.05, ambient_light=100))
    if not metric.available:
        pytest.skip("pyfvvdp is not installed")
    import pyfvvdp

    target = noise(1, 3, 128, 128).float() / 2
    picture = target + 0.1 * noise(1, 3, 128, 128, seed=1).float()
    by_package = pyfvvdp.fvvdp(
        display_photometry=pyfvvdp.fvvdp_display_photo_eotf(1000, contrast=2e4, EOTF="sRGB", E_ambient=100),
        display_geometry=pyfvvdp.fvvdp_display_geometry(
            (128, 128), distance_m=0.5, diagonal_size_inches=0.3 * math.sqrt(2) / 0.0254
        ),
        foveated=True,
        heatmap="none",
        quiet=True,
        device=torch.device("cpu"),
    )
    place = 128 * torch.tensor(gaze) - 0.5
    expected = by_package.predict(picture, target, dim_order="BCHW", fixation_point=place)[0].item()
    assert metric(picture, target, gaze=gaze).item() == pytest.approx(expected, abs=1e-5)
