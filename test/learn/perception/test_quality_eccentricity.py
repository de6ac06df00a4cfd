"""Quality by rings of eccentricity."""

import itertools
import math

import pytest
import torch

from odak.learn import perception as p


def pictures(*shape, seed=0):
    generator = torch.Generator().manual_seed(seed)
    target = torch.rand(shape, dtype=torch.float64, generator=generator)
    return target + 0.1 * torch.randn(shape, dtype=torch.float64, generator=generator), target


def test_rings_lie_at_their_angles():
    size, width, distance = (41, 61), 0.3, 0.5
    gaze = (0.25, 0.7)
    edges = (0, 3, 8, 20)
    masks = p.ring_masks(size, gaze, edges, width, distance)
    assert masks.shape == (3, *size)
    assert masks.dtype == torch.bool
    height = width * size[0] / size[1]

    def place(x, y):
        return torch.tensor([(x - 0.5) * width, (y - 0.5) * height, distance], dtype=torch.float64)

    look = place(*gaze)
    for row in range(0, 41, 5):
        for column in range(0, 61, 6):
            point = place(column / 60, row / 40)
            angle = math.degrees(torch.acos((point @ look / point.norm() / look.norm()).clamp(-1, 1)))
            inside = [low <= angle < high for low, high in itertools.pairwise(edges)]
            assert masks[:, row, column].tolist() == inside


def test_one_ring_around_everything_is_the_whole_picture():
    image, target = pictures(2, 3, 24, 30)
    (ring,) = p.eccentricity_report(image, target, edges=(0, 90)).rings
    assert ring.pixels == 24 * 30
    assert ring.psnr.item() == pytest.approx(p.PSNR()(image, target).item(), rel=1e-12)
    assert ring.ssim.item() == pytest.approx(p.structural_similarity(image, target).item(), rel=1e-12)


def test_rings_add_up_to_the_whole():
    image, target = pictures(3, 40, 40)
    report = p.eccentricity_report(image, target, gaze=(0.3, 0.6), edges=(0, 2, 5, 30))
    assert sum(ring.pixels for ring in report.rings) == 1600
    errors = sum(ring.pixels * 10 ** (-ring.psnr / 10) for ring in report.rings) / 1600
    assert (10 ** (-p.PSNR()(image, target) / 10)).item() == pytest.approx(errors.item(), rel=1e-12)
    # The window fits 30 x 30 times.
    inner = p.ring_masks((40, 40), (0.3, 0.6), (0, 2, 5, 30))[:, 5:-5, 5:-5]
    counts = inner.sum((-2, -1))
    mean = sum(count * ring.ssim for count, ring in zip(counts, report.rings, strict=True)) / 900
    assert mean.item() == pytest.approx(p.structural_similarity(image, target).item(), rel=1e-12)


def test_blurred_surround_shows_in_the_outer_rings_alone():
    _, target = pictures(1, 64, 64)
    masks = p.ring_masks((64, 64), edges=(0, 4, 90))
    image = torch.where(masks[1], 0.5, target)
    inner, outer = p.eccentricity_report(image, target, edges=(0, 3, 20)).rings
    assert math.isinf(inner.psnr)
    assert outer.psnr < 20
    assert inner.ssim > 0.95 > 0.5 > outer.ssim


def test_empty_rings_and_their_table():
    image, target = pictures(1, 16, 16)
    report = p.eccentricity_report(image, target, gaze=(5.0, 0.5), edges=(0, 1, 80))
    assert report.rings[0].pixels == 0
    assert math.isnan(report.rings[0].psnr)
    assert math.isnan(report.rings[0].ssim)
    text = str(report)
    assert text.startswith("16 x 16 pixels, gaze (5, 0.5), width 0.2 at 0.7\n")
    assert len(text.splitlines()) == 4
    assert f"{float(report.rings[1].psnr):10.2f}" in text


def test_quality_of_a_ring_is_differentiable():
    image, target = pictures(1, 12, 13)
    image.requires_grad_()
    ring = p.eccentricity_report(image, target, edges=(0, 3, 90)).rings[0]
    (gradient,) = torch.autograd.grad(ring.psnr, image)
    mask = p.ring_masks((12, 13), edges=(0, 3, 90))[0]
    assert (gradient[0][mask] != 0).all()
    assert (gradient[0][~mask] == 0).all()
    assert torch.autograd.gradcheck(
        lambda picture: p.eccentricity_report(picture, target, edges=(0, 5, 90)).rings[0].ssim, image, fast_mode=True
    )


def test_refused():
    image, target = pictures(1, 16, 16)
    for keywords, message in (
        ({"edges": (0,)}, "edges must be two or more rising"),
        ({"edges": (3, 2)}, "edges must be two or more rising"),
        ({"edges": (-1, 2)}, "edges must be at least 0"),
        ({"real_viewing_distance": 0.0}, "real_viewing_distance must be positive"),
        ({"data_range": 0.0}, "data_range must be positive"),
    ):
        with pytest.raises(ValueError, match=message):
            p.eccentricity_report(image, target, **keywords)
    with pytest.raises(ValueError, match="at least 11"):
        p.eccentricity_report(image[..., :9], target[..., :9])
