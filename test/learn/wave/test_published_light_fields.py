"""Published gains of holographic displays, with the comparisons of their articles, at sizes of a few minutes.

The guide of light fields states the numbers beside those of the articles.
"""

import math
from importlib.resources import files

import numpy as np
import pytest
import torch

from odak.learn.tools import load_image
from odak.learn.wave import AmplitudePanel, Display, Modulator, Run, Source, light_of, optimise, propagate_beam

GREEN, SIZE = 532e-9, (32, 48)
pytestmark = pytest.mark.slow


def with_depth(size):
    assets = files("odak") / "assets"
    parts = light_of(assets / "scene.png", GREEN).targets[0], load_image(str(assets / "scene_depth.png")).float()
    picture, depth = (torch.nn.functional.adaptive_avg_pool2d(part[None], size)[0] for part in parts)
    return (picture - picture.min()) / (picture.max() - picture.min()), depth


def quality(count, panels=2):
    """Return decibels over a focal stack of random phase, of count × count sources at once."""
    side = torch.linspace(-5e-3, 5e-3, count) if count > 1 else torch.zeros(1)
    first = AmplitudePanel(3e-3, bits=None, fill=1.0) if panels == 2 else None
    panel = Modulator(SIZE, 8e-6, None, 1.0, lit_through=first)
    lamp = Source(torch.cartesian_prod(side, side))
    display = Display(panel, GREEN, [8e-3, 10e-3, 12e-3], 1, profile=lamp)
    run = Run(40, progress=False, seed=0)
    found = optimise(display, with_depth(SIZE), start="random", run=run)
    # The mean squared error over the stack.
    return float(-10 * (10 ** (-found.psnr.double() / 10)).mean().log10())


def test_sources_through_two_panels_suppress_speckle_by_the_gain_of_their_number():
    # Kuo et al., ACM Trans. Graph. 42, 203 (2023), doi:10.1145/3618380: up to 10 dB above one source. The mean of N
    # independent patterns has 1/N of the squared error: 6 dB for four, 12 dB for sixteen.
    one, four, alone = quality(1), quality(2), quality(2, panels=1)
    assert 4.5 < four - one < 10 * math.log10(4) + 1
    # One panel shows all sources the same pattern: shifted copies of one image.
    assert four > alone + 1


def spread(count, cells):
    """Return matrices of the far field's directions by direct sums, of cells on one axis."""
    places = np.arange(count * cells) - count * cells // 2
    return np.exp(-2j * np.pi * np.outer(places, places) / (count * cells)) / math.sqrt(count * cells)


def test_a_mask_of_64_cells_in_a_pixel_shows_what_it_was_learned_from():
    # Tseng et al., Nat. Commun. 15, 2907 (2024), doi:10.1038/s41467-024-46915-3: more than 29 dB at 64 times the
    # étendue, of images at the resolution of the retina, by a mask that is learned from a set of natural images.
    cells, count, red = 8, 16, 660e-9

    def seen(mask, phases):
        light = mask + phases.repeat_interleave(cells, -2).repeat_interleave(cells, -1)
        light = torch.polar(torch.ones_like(light), light)
        far = propagate_beam(light, None, 1.0, 8e-6 / cells, red, "Fraunhofer", zero_padding=[False] * 3)
        return torch.nn.functional.avg_pool2d(far.abs().square(), cells)

    def error(images, wanted):
        over = (images * wanted).sum((-2, -1), keepdim=True) / images.square().sum((-2, -1), keepdim=True)
        return (over.detach() * images - wanted).square().mean((-2, -1))

    def descended(mask, wanted, steps, learned=False):
        phases = 2 * math.pi * torch.rand(wanted.shape, generator=torch.Generator().manual_seed(1))
        phases, mask = phases.requires_grad_(), mask.clone().requires_grad_(learned)
        descent = torch.optim.Adam([phases, mask] if learned else [phases], 0.1)
        for _ in range(steps):
            descent.zero_grad()
            error(seen(mask, phases), wanted).mean().backward()
            descent.step()
        return mask.detach(), phases.detach()

    def judged(mask, phases, wanted):
        light = np.exp(1j * (mask.numpy() + np.kron(phases.numpy(), np.ones((1, cells, cells)))))
        far = abs(spread(count, cells) @ light @ spread(count, cells)) ** 2
        images = torch.as_tensor(far.reshape(-1, count, cells, count, cells).mean((2, 4)))
        return float(-10 * error(images, wanted.double()).mean().log10())

    def small(part):
        part = torch.nn.functional.adaptive_avg_pool2d(part, (count, count))[0]
        return 0.05 + 0.95 * (part - part.min()) / (part.max() - part.min())

    assets = files("odak") / "assets"
    scene, photo = (light_of(assets / name, red).targets for name in ("scene.png", "photo.png"))
    pictures = torch.stack([small(part) for third in scene.chunk(3, 1) for part in third.chunk(3, 2)])
    other = small(photo)[None]
    random = 2 * math.pi * torch.rand(count * cells, count * cells, generator=torch.Generator().manual_seed(0))
    learned, patterns = descended(random, pictures, 250, learned=True)
    found = {"learned": judged(learned, patterns, pictures)}
    found["random"] = judged(*descended(random, pictures, 250), pictures)
    found |= {
        f"{name}, other": judged(*descended(mask, other, 250), other)
        for name, mask in (("learned", learned), ("random", random))
    }
    # Pictures that it was learned from reach the published quality, which a random mask is far from.
    assert found["learned"] > 28 and found["learned"] > found["random"] + 8
    # Nine pictures do not determine the cells: others gain little.
    assert found["learned, other"] > found["random, other"] - 1
