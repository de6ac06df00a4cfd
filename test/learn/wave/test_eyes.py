"""Displays that eyes look at: against sums over the areas of pixels, ray matrices, the eye's image, and their judge."""

import contextlib
import copy
import math

import numpy as np
import pytest
import torch

from odak import AccuracyWarning, SamplingWarning
from odak.instruments import Lens
from odak.learn.wave import AmplitudePanel, Display, Eyes, Iris, Modulator, Run, optimise
from odak.wave import eye_image

WAVELENGTH, PITCH, N, DISTANCE = 532e-9, 8e-6, 40, 0.08
PLACES = [(0.0, 0.4e-3), (0.8e-3, -1.6e-3)]


def random_phase(*shape, seed=0):
    return torch.from_numpy(np.random.default_rng(seed).uniform(0, 2 * np.pi, shape))


def eyed(eyes, fill=0.9, iris=None, n=N, wavelengths=WAVELENGTH, **options):
    return Display(Modulator((n, n + 6), PITCH, None, fill), wavelengths, eyes, iris=iris, **options).double()


def relative(found, expected):
    return float((found - expected).norm() / expected.norm())


def kernel(to, start, length):
    """Return Fresnel's integral in one dimension between points, but for a constant."""
    return np.exp(1j * np.pi / (WAVELENGTH * length) * (to[:, None] - start) ** 2)


def summed(field, place, diameter, focus, fill, spread, across=160):
    """Return the retinal intensity by sums over points of the areas of pixels and of a pupil.

    `spread(u, x)` is the kernel from points of the panel to points of the pupil, whose phase the eye sees in full.
    """
    nodes, weights = np.polynomial.legendre.leggauss(6)
    fine = (np.arange(across) - (across - 1) / 2) / across * diameter
    sides = []
    for n, p in zip(field.shape, place, strict=True):
        x = (np.arange(n) - n // 2) * PITCH
        parts = [
            w / 2 * spread(p + fine, x + math.sqrt(fill) * PITCH / 2 * s) for s, w in zip(nodes, weights, strict=True)
        ]
        sides.append((sum(parts), p + fine, x))
    there = sides[0][0] @ field @ sides[1][0].T
    there = there * (fine[:, None] ** 2 + fine**2 <= (diameter / 2) ** 2)
    back = [kernel(p + (x - p) * focus / DISTANCE, u, -focus) for (_, u, x), p in zip(sides, place, strict=True)]
    scale = (diameter / across / (WAVELENGTH * DISTANCE / PITCH)) ** 2
    return torch.from_numpy(abs(back[0] @ there @ back[1].T * scale) ** 2)


@pytest.mark.parametrize("focus", [None, 0.07])
@pytest.mark.parametrize("place", PLACES)
def test_retinal_image_equals_sums_over_the_areas_of_pixels(place, focus):
    phase = random_phase(N, N + 6)
    display = eyed(Eyes(DISTANCE, [place], 1.5e-3, focus))
    seen = display.fields(phase)[0, 0, 0].abs().square()
    field = np.exp(1j * phase.numpy())
    # The sums are of a disc with a rim of steps, of 160 in its diameter.
    given = place, 1.5e-3, focus or DISTANCE
    right, wrong = (summed(field, *given, fill, lambda u, x: kernel(u, x, DISTANCE)) for fill in (0.9, 0.3))
    assert relative(seen, right) < min(0.01, relative(seen, wrong) / 2)


def test_pixels_without_extent_are_those_of_the_image_of_an_eye():
    phase, turn = random_phase(N, N + 6), (3.0, 2.0)
    display = eyed(Eyes(DISTANCE, PLACES, [1.2e-3, 1.8e-3], [0.07, 0.1], turn), 1e-9)
    seen = display.fields(phase)[0, :, 0].abs().square()
    alone = [
        eye_image(torch.exp(1j * phase), PITCH, WAVELENGTH, DISTANCE, *eye, turn)
        for eye in zip(PLACES, (1.2e-3, 1.8e-3), (0.07, 0.1), strict=True)
    ]
    assert relative(seen, torch.stack(alone).abs().square()) < 0.01


def test_light_of_a_pixel_falls_off_across_the_pupils():
    # A single pixel lights all places by sinc²; with a stop of one order a quarter of it is left at the order's edge.
    shares, panel = np.array([0.0, 0.2, 0.5, 0.8, 1.1]), Modulator((1, 1), PITCH, None, 0.64)
    places = [(0.0, share * WAVELENGTH * DISTANCE / PITCH) for share in shares]
    for iris, passed, atol in ((None, [1, 1, 1, 1, 1], 2e-4), ("order", [1, 1, 0.25, 0, 0], 0.07)):
        with pytest.warns(SamplingWarning, match="passes by") if iris else contextlib.nullcontext():
            display = Display(panel, WAVELENGTH, Eyes(DISTANCE, places, 0.1e-3), iris=iris)
        light = display.fields(torch.zeros(1, 1))[0, :, 0, 0, 0].abs().square()
        np.testing.assert_allclose(light / light[0], np.sinc(0.8 * shares) ** 2 * passed, atol=atol)


@pytest.mark.parametrize("lens", [Lens(0.04, after=0.025), Lens(0.05, 0.03, 0.04), Lens(0.03)])
def test_eyepiece_spreads_light_as_two_stretches_and_a_thin_lens_do(lens):
    # Along one axis: the sum over the plane of the lens, whose edge is far outside.
    u, x = np.linspace(-1e-3, 1e-3, 7), np.array([-0.4e-3, 0.1e-3, 0.5e-3])
    plane = np.linspace(-12e-3, 12e-3, 60001)
    soft = np.exp(-((plane / 5e-3) ** 8))
    glass = np.exp(-1j * np.pi / (WAVELENGTH * lens.focal_length) * plane**2) * soft
    chain = kernel(u, plane, lens.after) @ (glass[:, None] * kernel(plane, x, lens.before))
    a, b = lens.ray_matrix
    d = 1 - lens.before / lens.focal_length
    whole = np.exp(1j * np.pi / (WAVELENGTH * b) * (a * x**2 - 2 * np.outer(u, x) + d * u[:, None] ** 2))
    np.testing.assert_allclose(chain / chain[3, 1], whole / whole[3, 1], atol=0.02)
    np.testing.assert_allclose(eyed(Eyes(lens)).path.sight(0, 0).ray_matrix(), (a, b, d))


def test_eyepiece_shows_the_panel_at_its_image():
    # The panel 30 mm before a lens of 40 mm is seen 120 mm behind it; an eye 25 mm behind the lens focuses there.
    phase = random_phase(N, N + 6)
    lens = Lens(0.04, 0.03, 0.025)
    seen, at_image, nearer = (
        eyed(Eyes(lens, PLACES[1:], 1.5e-3, focus)).fields(phase) for focus in (None, 0.145, 0.12)
    )
    assert relative(at_image.abs(), seen.abs()) < 1e-9 < 0.1 < relative(nearer.abs(), seen.abs())


@pytest.mark.parametrize(
    "eyes",
    [
        Eyes(DISTANCE, PLACES, 1.5e-3, 0.075),
        Eyes(Lens(0.04, 0.035, 0.025), PLACES, 2e-3),
        Eyes(Lens(0.04, 0.1, 0.1), PLACES, 1.5e-3, rotation=(0.0, 4.0)),
    ],
)
@pytest.mark.parametrize(("iris", "n", "bound"), [(None, N, 2e-3), ("order", 120, 4e-3)])
@pytest.mark.usefixtures("small_judge")
def test_judge_agrees(eyes, iris, n, bound):
    display = eyed(eyes, 0.7, iris, n, wavelengths=[WAVELENGTH, 639e-9])
    phases = random_phase(2, n, n + 6)
    areas, points = display.judge(phases)
    assert areas.shape == (2, 2, n, n + 6)
    seen = display(phases)
    assert relative(seen, areas) < bound
    middles = display.fields(phases).abs().square()
    middles = torch.stack([middles[c, :, c] for c in range(2)], 1)
    assert relative(middles, points) < bound


def test_gradients_batches_and_precision():
    display = eyed(Eyes(DISTANCE, PLACES, 1e-3, 0.075), iris="order", n=6)
    phases = random_phase(1, 6, 12).requires_grad_()
    assert torch.autograd.gradcheck(display, (phases,), fast_mode=True)
    many = random_phase(3, 1, 6, 12, seed=1)
    torch.testing.assert_close(display(many), torch.stack([display(one) for one in many]))
    single = Display(Modulator((6, 12), PITCH, None), WAVELENGTH, Eyes(DISTANCE, PLACES, 1e-3, 0.075))
    assert single(many.float()).dtype == torch.float32
    torch.testing.assert_close(single(many.float()), display(many).float(), rtol=1e-4, atol=1e-6)


@pytest.mark.usefixtures("small_judge")
def test_hologram_for_several_eyes_in_two_colours():
    picture = torch.zeros(48, 54)
    picture[10:38, 12:40], picture[20:30, 20:30] = 1.0, 0.2
    panel, colours = Modulator((48, 54), PITCH), [WAVELENGTH, 639e-9]
    eyes = Eyes(DISTANCE, [(0.0, -1e-3), (0.0, 1e-3)], 2e-3)
    run = Run(iterations=25, progress=False, seed=0)
    display = Display(panel, colours, eyes, frames=4)
    hologram = optimise(display, picture.expand(2, 48, 54), run=run)
    assert hologram.phases.shape == (4, 48, 54) and hologram.psnr.min() > 20
    alone = optimise(
        Display(panel, colours, Eyes(DISTANCE, [(0.0, -1e-3)], 2e-3), frames=4), picture.expand(2, 48, 54), run=run
    )
    judged = display.judge(alone.phases)[0]
    lit = judged / judged.mean((-2, -1), keepdim=True) * picture.mean()
    # A hologram for one eye shows another little of the picture.
    assert (lit[1] - picture).square().mean() > 4 * (lit[0] - picture).square().mean()
    assert [row["pupil"] for row in hologram.table()[::2]] == [(0.0, -1e-3), (0.0, 1e-3)]
    assert "2 eyes at 80 mm, pupils of 2 mm" in repr(hologram) and "pupil" in hologram._repr_html_()
    shared = optimise(display, picture.expand(2, 48, 54), run=Run(2, False, seed=0), devices=["cpu", "cpu"])
    whole = optimise(display, picture.expand(2, 48, 54), run=Run(2, False, seed=0))
    assert shared.losses == pytest.approx(whole.losses, rel=1e-4)
    for start in ("random", "flat"):
        assert optimise(display, picture.expand(2, 2, 48, 54), start=start, run=Run(1, False)).phases.shape == (
            4,
            48,
            54,
        )


def test_a_display_keeps_its_eyes():
    display, phases = eyed(Eyes(Lens(0.04), PLACES, 1e-3, [math.inf, 0.3]), n=8), random_phase(1, 8, 14)
    twice = display.lit_by(2 * display.powers)
    assert twice.eyes == display.eyes and torch.equal(twice.double()(phases), display(phases))
    with pytest.raises(AttributeError, match="eyes cannot be set"):
        display.eyes = Eyes(0.1)
    moved = copy.deepcopy(display).float()
    assert moved(phases.float()).dtype == torch.float32


def test_what_eyes_cannot_be_asked_for():
    panel, eyes = Modulator((8, 8), PITCH), Eyes(DISTANCE)
    with pytest.raises(ValueError, match="iris must be 'order' or None"):
        Display(panel, WAVELENGTH, eyes, iris=Iris(1e-3, 0.1))
    with pytest.raises(ValueError, match="medium must be 1"):
        Display(panel, WAVELENGTH, eyes, medium=1.3)
    with pytest.raises(ValueError, match="lit_through must be None"):
        Display(Modulator((8, 8), PITCH, lit_through=AmplitudePanel()), WAVELENGTH, eyes)
    display = Display(panel, WAVELENGTH, eyes)
    for options, message in (
        ({"solver": "gs"}, "without a lens or eyes"),
        ({"start": "network"}, "where eyes look on"),
    ):
        with pytest.raises(ValueError, match=message):
            optimise(display, torch.ones(8, 8), **options)
    with pytest.raises(ValueError, match="one with depth"):
        optimise(display, (torch.ones(1, 8, 8), torch.ones(8, 8)))
    for given, message in (
        ((-0.1,), "distance"),
        ((0.1, [0.0, 1.0]), r"positions must be \[K, 2\]"),
        ((0.1, PLACES, [1e-3] * 3), r"diameter must be one number or \[2\]"),
        ((0.1, PLACES, 1e-3, -1.0), "focus must be positive"),
        ((0.1, PLACES, 1e-3, None, (0.0, 90.0)), "within ±90"),
        ((Lens(0.1, block=1e-4),), "without a block"),
    ):
        with pytest.raises(ValueError, match=message):
            Eyes(*given)
    with pytest.warns(SamplingWarning, match="passes by the pupil"):
        Display(Modulator((64, 8), PITCH), WAVELENGTH, Eyes(2e-3, diameter=1e-5))
    # 1 mm of pupil, seen at 80 mm with a focus of 40 mm, is a disc of 1 mm on the panel.
    wide = Modulator((64, 140), PITCH)
    with pytest.warns(SamplingWarning, match=r"blur of the focus is 0\.001 m wide, more than the field of 0\.000512 m"):
        Display(wide, WAVELENGTH, Eyes(DISTANCE, diameter=1e-3, focus=0.04))


@pytest.mark.parametrize("place", range(5))
def test_gradients_of_eyes_are_lost_with_a_word(place):
    given = [torch.tensor(value) for value in (0.1, [[0.0, 1e-4]], 1e-3, 0.2, [0.0, 1.0])]
    given[place].requires_grad_()
    with pytest.warns(AccuracyWarning, match="requires a gradient, which is lost here"):
        eyes = Eyes(*given)
    assert eyes.positions[0] == pytest.approx((0.0, 1e-4))


@pytest.mark.slow
def test_judge_agrees_on_a_whole_panel():
    eyes = Eyes(0.3, [(1e-3, -3e-3)], 3e-3, 0.32)
    display = Display(Modulator((1080, 1920), 8e-6), WAVELENGTH, eyes)
    phases = random_phase(1, 1080, 1920).float()
    inner = slice(None), slice(None), slice(4, -4), slice(4, -4)
    assert relative(display(phases)[inner], display.judge(phases)[0][inner]) < 0.01
