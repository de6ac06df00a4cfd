"""Results that differ from Odak 0.2: each row of the page's table is checked against what functions return."""

import re
from pathlib import Path

import pytest
import torch

from odak import ArgumentWarning
from odak.learn import perception, tools, wave

PAGE = Path(__file__).resolve().parents[2] / "docs/coming_from_odak_02.md"
CHECKS = {}


def row(words):
    """Enter the check of the row whose first cell is `words`."""

    def enter(function):
        CHECKS[words] = function
        return function

    return enter


def full(orientations=6):
    return perception.get_steerable_pyramid_filters(9, orientations, "full")


@row("`make_radial_map(size, gaze)`, and the radial weight of `MetamericLoss`")
def gaze(tmp_path):
    nearest = perception.make_radial_map((20, 40), (0.25, 0.5)).argmin()
    assert int(nearest) % 40 in (9, 10) and int(nearest) // 40 in (9, 10)


@row("`get_steerable_pyramid_filters`, `SpatialSteerablePyramid` with six orientations")
def sizes(tmp_path):
    found = full()
    assert [tuple(found[name].shape[-2:]) for name in ("l", "l0")] == [(17, 17), (9, 9)]
    assert {tuple(band.shape[-2:]) for band in found["b"]} == {(9, 9)}


@row('the same, "cropped" with six orientations')
def cropped(tmp_path):
    assert perception.get_steerable_pyramid_filters(9, 6, "cropped")["l"].shape[-2:] == (13, 13)


@row('the same, "full" and "cropped"')
def signs(tmp_path):
    y, x = torch.meshgrid(torch.arange(9.0) - 4, torch.arange(9.0) - 4, indexing="ij")
    for count, kind in ((4, "full"), (6, "full"), (6, "cropped")):
        bands = perception.get_steerable_pyramid_filters(9, count, kind)["b"]
        for k, band in enumerate(bands):
            angle = torch.tensor(torch.pi * k / count)
            # Rows count downwards: counter-clockwise is towards smaller ones.
            ramp = x * angle.cos() - y * angle.sin()
            assert float((band[0, 0] * ramp).sum()) < 0


@row('the same, "trained"')
def trained(tmp_path):
    one, two = perception.get_steerable_pyramid_filters(5, 2, "trained")["b"]
    assert torch.equal(two, one.mT)


@row("`crop_steerable_pyramid_filters`")
def crop(tmp_path):
    given = full()
    before = [band.clone() for band in given["b"]]
    found = perception.crop_steerable_pyramid_filters(given, 5)
    assert all(torch.equal(a, b) for a, b in zip(given["b"], before, strict=True))
    middle = before[0][..., 2:7, 2:7]
    torch.testing.assert_close(found["b"][0], middle - middle.mean())


@row("`reconstruct_from_pyramid`")
def reconstruction(tmp_path):
    picture = torch.rand(1, 1, 32, 32, generator=torch.Generator().manual_seed(0))
    for options in ({"filter_type": "cropped"}, {"filter_size": 5, "n_orientations": 2, "filter_type": "trained"}):
        maker = perception.SpatialSteerablePyramid(**options)
        back = maker.reconstruct_from_pyramid(maker.construct_pyramid(picture, 2))
        assert (back - picture).abs().max() < 3e-5


@row("`pad_image_for_pyramid`")
def padding(tmp_path):
    picture = torch.rand(1, 1, 30, 33)
    padded = perception.pad_image_for_pyramid(picture, 3)
    assert padded.shape[-2:] == (32, 40) and torch.equal(padded[..., :30, :33], picture)


def focal(**options):
    picture = torch.zeros(3, 32, 32)
    picture[:, 24, 16] = 1
    depth = torch.zeros(32, 32)
    depth[:, :16] = 1
    return picture, wave.multiplane_loss(picture, depth, number_of_planes=2, **options).get_targets()


@row("`multiplane_loss`, `blur_ratio`")
def blur(tmp_path):
    _, (planes, _, _) = focal(blur_ratio=0.8, target_blur_size=13)
    # A normal distribution along each axis, sampled at 13 places from -6.5 to 6.5: its share in the middle pixel. The
    # whole number below 0.8 would blur nothing.
    along = torch.exp(-(torch.linspace(-6.5, 6.5, 13) ** 2) / (2 * 0.8**2))
    assert float(planes[1, 0, 24, 16]) == pytest.approx(float((1 / along.sum()) ** 2), rel=0.01)


@row("`multiplane_loss(…).get_targets()`")
def focus_target(tmp_path):
    picture, (_, sharp, _) = focal(multiplier=0.5)
    assert torch.equal(sharp.reshape(-1)[sharp.reshape(-1) > 0].unique(), torch.tensor([1.0]))
    assert sharp.shape[-2:] == picture.shape[-2:]


def display(**options):
    known = {"aperture": "open", "propagator_type": "forward", "number_of_frames": 1}
    return wave.propagator([16, 24], [532e-9], 8e-6, **(known | options))


@row("`propagator` and the hologram optimizers without `aperture`")
def stop(tmp_path):
    with pytest.warns(ArgumentWarning, match='aperture="open" is a display without a stop'):
        released = display(aperture=None)
    assert released.stop == "round, radius 24 samples" and display().stop == "open"
    torch.testing.assert_close(released.aperture, tools.circular_binary_mask(32, 48, 24)[0, 0].to(released.aperture))


@row("`propagator` with one plane")
def one_plane(tmp_path):
    found = display(number_of_depth_layers=1, volume_depth=4e-3, image_location_offset=7e-3)
    assert found.distances.tolist() == pytest.approx([7e-3])


@row("`propagator(vaccination=True)`")
def vaccination(tmp_path):
    shaken = display(vaccination=True, vaccination_scale=1e-3, seed=0)
    phase = torch.rand(16, 24, generator=torch.Generator().manual_seed(0))
    assert not torch.equal(shaken.reconstruct(phase), shaken.reconstruct(phase))


@row("flags")
def flags(tmp_path):
    assert torch.equal(
        wave.propagator([16, 24], [532e-9], 8e-6, aperture="open", vaccination=0.0, seed=0).distances,
        wave.propagator([16, 24], [532e-9], 8e-6, aperture="open", vaccination=False, seed=0).distances,
    )


@row("`load_dictionary`, `save_dictionary`")
def dictionaries(tmp_path):
    from odak.tools import load_dictionary, save_dictionary

    save_dictionary({"a": 1}, str(tmp_path / "settings.txt"))
    assert load_dictionary(str(tmp_path / "settings.txt")) == {"a": 1}


def rows():
    """Return the first cells of the table under "Results"."""
    text = PAGE.read_text(encoding="utf-8").split("## Results")[1].split("## ")[0]
    return [re.split(r" \| ", line[2:])[0] for line in text.splitlines() if line.startswith("| ")][1:]


def test_each_row_has_its_check():
    assert rows() == list(CHECKS)


@pytest.mark.filterwarnings("ignore:.*:odak.OdakWarning")
@pytest.mark.parametrize("words", CHECKS)
def test_a_row_is_what_functions_return(words, tmp_path):
    CHECKS[words](tmp_path)
