"""Masks in contact with a panel: against sums over the areas of their cells, the light they keep, and étendue."""

import math

import numpy as np
import pytest
import torch

from odak.instruments import Lens
from odak.learn.wave import Display, Expander, Eyes, Iris, Modulator, Run, optimise

WAVELENGTH, PITCH, DISTANCE, SIZE = 532e-9, 8e-6, 0.08, (10, 12)


def display_of(cells, eyes, fill=0.9, size=SIZE, **options):
    expander = Expander.random(size, cells, 5) if cells else None
    return Display(Modulator(size, PITCH, None, fill, expander=expander), WAVELENGTH, eyes, iris=None, **options)


def phases_of(*shape, seed=0):
    return torch.from_numpy(np.random.default_rng(seed).uniform(0, 2 * np.pi, shape))


def relative(found, expected):
    return float((found - expected).norm() / expected.norm())


def summed(light, fill, mask, place, diameter, across=160):
    """Return the retinal intensity by sums over points of the areas of the cells of a mask."""
    within = (np.arange(across) - (across - 1) / 2) / across * diameter
    nodes, weights = np.polynomial.legendre.leggauss(4)
    cells, sides = mask.shape[0] // light.shape[0], []
    there = light.repeat(cells, 0).repeat(cells, 1) * mask
    for n, p in zip(light.shape, place, strict=True):
        rims = np.clip(np.linspace(-0.5, 0.5, cells + 1), -math.sqrt(fill) / 2, math.sqrt(fill) / 2)
        halves = np.tile(np.diff(rims) / 2, n)
        middles = (np.arange(n)[:, None] - n // 2 + (rims[1:] + rims[:-1]) / 2).ravel()
        kernel = 0
        for node, weight in zip(nodes, weights, strict=True):
            x = (middles + node * halves) * PITCH
            way = np.exp(1j * np.pi / (WAVELENGTH * DISTANCE) * ((p + within)[:, None] - x) ** 2)
            kernel = kernel + weight / math.sqrt(fill) * halves * way
        x = (np.arange(n) - n // 2) * PITCH
        sides.append((kernel, np.exp(-1j * np.pi / (WAVELENGTH * DISTANCE) * (x[:, None] - p - within) ** 2)))
    there = sides[0][0] @ there @ sides[1][0].T
    there = there * (within[:, None] ** 2 + within**2 <= (diameter / 2) ** 2)
    scale = (diameter / across / (WAVELENGTH * DISTANCE / PITCH)) ** 2
    return torch.from_numpy(abs(sides[0][1] @ there @ sides[1][1].T * scale) ** 2)


# The second is beyond the light of the panel's pixels, whose order is 5.3 mm wide.
@pytest.mark.parametrize("place", [(0.0, 0.5e-3), (-4.1e-3, 5.5e-3)])
@pytest.mark.parametrize("cells", [2, 3])
def test_retinal_image_equals_sums_over_the_areas_of_cells(cells, place):
    display = display_of(cells, Eyes(DISTANCE, [place], 2e-3), 0.8).double()
    phase = phases_of(*SIZE)
    seen = display.fields(phase)[0, 0, 0].abs().square()
    mask = np.exp(1j * display.modulator.expander.phases.double().numpy())
    # The sums are of a disc with a rim of steps.
    assert relative(seen, summed(np.exp(1j * phase.numpy()), 0.8, mask, place, 2e-3)) < 0.02


@pytest.mark.usefixtures("small_judge")
@pytest.mark.parametrize("ends", [DISTANCE, Lens(0.04, 0.035, 0.025)])
def test_judge_agrees(ends):
    eyes = Eyes(ends, [(0.0, 0.4e-3), (3e-3, -4e-3)], 1.5e-3, 0.075)
    size = 40, 46
    display, phases = display_of(3, eyes, 0.7, size).double(), phases_of(1, *size)
    areas, points = display.judge(phases)
    middles = display.fields(phases)[0].abs().square()
    assert max(relative(display(phases), areas), relative(middles, points)) < 2e-3


def test_a_clear_mask_changes_nothing():
    eyes, phases = Eyes(DISTANCE, [(0.0, 0.5e-3)], 2e-3), phases_of(1, *SIZE)
    clear = Expander(torch.zeros(20, 24))
    without, with_mask = (
        Display(Modulator(SIZE, PITCH, None, expander=one), WAVELENGTH, eyes, iris=None).double()
        for one in (None, clear)
    )
    assert relative(with_mask(phases), without(phases)) < 1e-3


def test_a_mask_of_phases_keeps_all_light_and_spreads_it():
    # By Parseval's theorem, along an axis: the light in a pupil wider than all orders is that of the areas of cells.
    inside = {}
    for cells in (0, 2):
        sight = display_of(cells, Eyes(DISTANCE, diameter=0.4), 0.8).path.sight(0, 0)
        light = np.repeat(np.exp(1j * phases_of(12).numpy()), max(cells, 1))
        light = light * np.exp(1j * phases_of(light.size, seed=1).numpy() * (cells > 0))
        (points, step), emitting = sight.points(1), math.sqrt(0.8)
        seen = abs(sight.to_pupil(1) @ light) ** 2 * step
        assert seen.sum() == pytest.approx(12 * sight.box(1) / emitting, rel=0.01)
        inside[cells] = seen[abs(points) < sight.box(1) / 2].sum() / seen.sum()
    assert inside[2] < 0.75 * inside[0]


def test_amplitudes_pass_their_square():
    eyes, phases = Eyes(DISTANCE, diameter=2e-3), phases_of(1, *SIZE)
    mask = Expander.random(SIZE, 2)
    half = Expander(mask.phases, torch.full_like(mask.phases, 0.5))
    seen = [Display(Modulator(SIZE, PITCH, expander=m), WAVELENGTH, eyes, iris=None)(phases) for m in (mask, half)]
    torch.testing.assert_close(seen[1], seen[0] / 4)


def test_etendue_is_the_product_of_eyebox_and_field_of_view():
    for cells in (1, 2, 4):
        (row,) = display_of(cells, Eyes(DISTANCE)).extents()
        assert row["etendue"] == pytest.approx(math.prod(SIZE) * (cells * WAVELENGTH) ** 2)
        angles = [math.radians(angle) for angle in row["field_of_view"]]
        assert math.prod(row["eyebox"]) * math.prod(angles) == pytest.approx(row["etendue"], rel=1e-4)
    panel = Modulator(SIZE, PITCH)
    open_, stopped = (Display(panel, WAVELENGTH, 1e-3, iris=one).extents()[0] for one in ("order", Iris(1e-3, 0.1)))
    assert stopped["etendue"] / open_["etendue"] == pytest.approx(math.pi * (1e-3 / 0.1 / WAVELENGTH * PITCH) ** 2)


def test_gradients_of_a_mask_and_adjoint():
    eyes = Eyes(DISTANCE, [(0.0, 0.5e-3), (3e-3, -1e-3)], 2e-3)
    phases = phases_of(4, 6)

    def seen(cells, amplitudes):
        panel = Modulator((2, 3), PITCH, None, expander=Expander(cells, amplitudes))
        return Display(panel, WAVELENGTH, eyes, iris=None).double()(phases[:2, :3])

    given = phases_of(4, 6, seed=1).requires_grad_(), torch.full((4, 6), 0.7, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(seen, given, fast_mode=True)
    mask = Expander(phases)
    light, cells = torch.exp(1j * phases[:2, :3]), torch.exp(2j * phases_of(4, 6, seed=2))
    there, back = (mask.behind(light, 2) * cells.conj()).sum(), (light * mask.before(cells, 2).conj()).sum()
    torch.testing.assert_close(there, back)


def test_patterns_are_found_for_pupils_that_the_panel_alone_does_not_light():
    # Pupils at zeros of the light of pixels without a mask.
    order = WAVELENGTH * DISTANCE / PITCH
    eyes = Eyes(DISTANCE, [(0.0, order), (order, 0.0)], 2e-3)
    target = torch.zeros(16, 16)
    target[4:12, 5:11] = 1.0
    run = Run(15, progress=False, seed=0)
    found = {cells: optimise(display_of(cells, eyes, 1.0, (16, 16), frames=2), target, run=run) for cells in (0, 2)}
    assert float(found[2].brightness) < float(found[0].brightness) / 2
    assert float(found[2].psnr.min()) > 11


def test_what_a_mask_cannot_be():
    mask, panel = Expander.random((8, 8), 2), Modulator((8, 8), PITCH)
    with pytest.raises(ValueError, match=r"expander must have k·8 × k·9 cells, got \[16, 16\]"):
        Modulator((8, 9), PITCH, expander=mask)
    masked = Modulator((8, 8), PITCH, expander=mask)
    with pytest.raises(ValueError, match=r"distances must be odak.learn.wave.Eyes for a modulator with an expander"):
        Display(masked, WAVELENGTH, 1e-3)
    with pytest.raises(ValueError, match="iris must be None for a modulator with an expander, got 'order'"):
        Display(masked, WAVELENGTH, Eyes(DISTANCE))
    with pytest.raises(ValueError, match="without an expander or a Source"):
        Display(masked, WAVELENGTH, Eyes(DISTANCE), iris=None).light_beyond(torch.zeros(8, 8))
    with pytest.raises(ValueError, match="amplitudes must be 0 … 1, got 2 to 2"):
        Expander(torch.zeros(4, 4), torch.full((4, 4), 2.0))
    with pytest.raises(ValueError, match="amplitudes must be of the shape of the phases"):
        Expander(torch.zeros(4, 4), torch.zeros(4, 5))
    with pytest.raises(ValueError, match="phases must be real"):
        Expander(torch.zeros(2, 4, 4))
    displays = [Display(one, WAVELENGTH, Eyes(DISTANCE), iris=None) for one in (panel, masked)]
    assert displays[0].fingerprint() != displays[1].fingerprint()
    assert "2 × 2 cells of a mask in each" in repr(displays[1])
    assert "étendue at 532 nm" in displays[1]._repr_html_()
