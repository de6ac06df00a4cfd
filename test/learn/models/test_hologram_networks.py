"""The hologram network: its steps written out in NumPy, symmetries, gradients, and the quality of its weights."""

from importlib.resources import files

import numpy as np
import pytest
import torch
from physics import relative_error, unwrapped_propagation

import odak
from odak.learn.models import hologram_network, train
from odak.learn.tools import load_image
from odak.learn.wave import double_phase_hologram, propagate_beam

WAVELENGTH, PITCH, DISTANCE = 532e-9, 8e-6, 5e-3
GEOMETRY = (WAVELENGTH, PITCH, DISTANCE)


@pytest.fixture(scope="module")
def pretrained():
    return hologram_network(pretrained=True)


def untrained(refinements=1, channels=2, lively=False):
    """Return a small network in float64, which corrects nothing unless it is lively."""
    torch.manual_seed(0)
    network = hologram_network(channels, refinements).double()
    if lively:
        for parameter in network.parameters():
            torch.nn.init.normal_(parameter, std=0.2)
    return network


def picture(rows=64, columns=64):
    """Return the middle of the photograph, which no weight has seen, as intensities."""
    photo = load_image(str(files("odak") / "assets" / "photo.png")).mean(-1).double()[None, None, :, 100:500]
    return torch.nn.functional.interpolate(photo, (rows, columns), mode="area")[0, 0]


def quality(phase, target, distance=DISTANCE, wavelength=WAVELENGTH, pitch=PITCH):
    """Return the PSNR in dB of the intensity, at the brightness that fits best."""
    field, target = np.exp(1j * phase.detach().double().numpy()), target.double().numpy()
    image = abs(unwrapped_propagation(field, distance, pitch, wavelength, padding=8)) ** 2
    image *= (image * target).sum() / (image**2).sum()
    return -10 * np.log10(((image - target) ** 2).mean())


def test_without_corrections_it_is_an_alternating_projection():
    target = torch.rand(20, 24, dtype=torch.float64) + 0.1
    amplitude = np.sqrt(target.numpy())

    def propagated(field, distance):
        return unwrapped_propagation(field, distance, PITCH, WAVELENGTH)

    first = propagated(amplitude, -DISTANCE)
    first /= abs(first)
    image = propagated(first, DISTANCE)
    scale = (abs(image) * amplitude).sum() / (amplitude**2).sum()
    second = first + propagated((scale * amplitude / abs(image) - 1) * image, -DISTANCE)
    for phase, wanted in zip(untrained().stages(target, *GEOMETRY), (first, second), strict=True):
        # The carrier exp(ikz), a constant phase, is left out; 32 times the width leave the reference exact to 1e-4.
        found = np.exp(1j * phase.detach().numpy()) * abs(wanted)
        found *= np.vdot(found, wanted) / np.vdot(found, found)
        assert relative_error(found, wanted) < 5e-4


def test_sizes_batches_and_precision(pretrained):
    target, network = torch.rand(2, 1, 38, 41, dtype=torch.float64), hologram_network(pretrained=True).double()
    with torch.no_grad():
        phases = network(target, *GEOMETRY)
        single = network(target[1, 0], *GEOMETRY)
        brighter = network(7 * target, *GEOMETRY)
        smaller = pretrained(target.float(), *GEOMETRY)
        kept = pretrained(target, *GEOMETRY)
    assert phases.shape == target.shape and single.shape == (38, 41)
    assert smaller.dtype == torch.float32 and phases.dtype == kept.dtype == torch.float64
    assert untrained(lively=True)(torch.ones(1, 1), *GEOMETRY).isfinite().all()
    # Rounding, magnified where the light nearly vanishes.
    for other, mine in ((single, phases[1, 0]), (brighter, phases)):
        assert (torch.exp(1j * other) - torch.exp(1j * mine)).abs().max() < 1e-11
    assert (torch.exp(1j * smaller) - torch.exp(1j * phases)).abs().median() < 1e-5


def test_a_dark_picture_gives_numbers(pretrained):
    assert pretrained(torch.zeros(40, 40), *GEOMETRY).isfinite().all()


def test_light_that_leaves_the_picture(pretrained):
    with pytest.warns(odak.AccuracyWarning, match="21 pixels to each side"):
        pretrained(torch.ones(16, 40), *GEOMETRY)


def test_an_image_before_the_hologram(pretrained):
    target = picture(36, 40)
    with torch.no_grad():
        before, behind = (pretrained(target, WAVELENGTH, PITCH, sign * DISTANCE) for sign in (-1, 1))
    assert abs(quality(before, target, -DISTANCE) - quality(behind, target)) < 1e-6


def test_pixels_are_in_focus_on_the_planes_of_their_depth():
    target, depth = torch.rand(20, 24, dtype=torch.float64) + 0.1, torch.linspace(0, 1, 24).expand(20, 24)
    distances, amplitude = (4e-3, 5.5e-3, 7e-3), np.sqrt(target.numpy())
    # The nearest of planes at depths of 0, ½ and 1.
    columns = np.arange(24) / 23
    masks = np.stack([columns < 0.25, (columns >= 0.25) & (columns < 0.75), columns >= 0.75])[:, None]
    carriers = np.exp(2j * np.pi * np.array(distances) / WAVELENGTH)[:, None, None]

    def sent_back(fields):
        """Return the sum of the fields of the planes at the hologram, each without its carrier exp(ikz)."""
        return sum(
            unwrapped_propagation(field, -distance, PITCH, WAVELENGTH)
            for field, distance in zip(carriers * fields, distances, strict=True)
        )

    first = sent_back(masks * amplitude)
    first /= abs(first)
    images = np.stack([unwrapped_propagation(first, z, PITCH, WAVELENGTH) for z in distances]) / carriers
    sharp = (masks * abs(images)).sum(0)
    scale = (sharp * amplitude).sum() / (amplitude**2).sum()
    second = first + sent_back(masks * (scale * amplitude / abs(images) - 1) * images)
    stages = untrained().stages(target, WAVELENGTH, PITCH, distances, depth)
    for phase, wanted in zip(stages, (first, second), strict=True):
        found = np.exp(1j * phase.detach().numpy()) * abs(wanted)
        assert relative_error(found, wanted) < 1e-3


def test_depths_of_batches_and_colours():
    network, target = untrained(lively=True), torch.rand(2, 3, 12, 16, dtype=torch.float64) + 0.1
    depth, wavelengths, distances = torch.rand(2, 12, 16, dtype=torch.float64), (639e-9, 515e-9, 473e-9), (-4e-3, -6e-3)
    together = network(target, wavelengths, PITCH, distances, depth)
    behind = network(target, wavelengths, PITCH, (4e-3, 6e-3), depth)
    for index in range(2):
        alone = network(target[index, 1], wavelengths[1], PITCH, distances, depth[index])
        assert (torch.exp(1j * together[index, 1]) - torch.exp(1j * alone)).abs().max() < 1e-10
    assert (torch.exp(1j * together) - torch.exp(-1j * behind)).abs().max() < 1e-10
    single = network(target[0], 515e-9, PITCH, 5e-3)
    assert torch.equal(network(target[0], 515e-9, PITCH, [5e-3], depth[0]), single)


def test_a_wavelength_for_each_colour():
    network, target = untrained(lively=True), torch.rand(2, 3, 12, 16, dtype=torch.float64)
    wavelengths = (639e-9, 515e-9, 473e-9)
    colours = network(target, wavelengths, PITCH, DISTANCE)
    for k, wavelength in enumerate(wavelengths):
        assert torch.equal(colours[:, k], network(target[:, k], wavelength, PITCH, DISTANCE))
    assert torch.equal(network(target, np.array(wavelengths), PITCH, DISTANCE), colours)


@pytest.mark.parametrize("planes", [(DISTANCE,), ((4e-3, 6e-3), torch.eye(6, 7, dtype=torch.float64))])
def test_gradients(planes):
    network, target = untrained(lively=True), torch.rand(6, 7, dtype=torch.float64) + 0.2
    weight = network.refinement.leave.weight

    def hologram(image, parameter):
        replaced = {"refinement.leave.weight": parameter}
        phase = torch.func.functional_call(network, replaced, (image, WAVELENGTH, PITCH, *planes))
        return phase.cos(), phase.sin()

    inputs = (target.requires_grad_(), weight.detach().clone().requires_grad_())
    assert torch.autograd.gradcheck(hologram, inputs, fast_mode=True)


def test_it_learns_through_the_propagation():
    target, network = picture(24, 24), untrained(refinements=1, channels=4)

    def loss(network, batch):
        hologram = torch.polar(torch.ones_like(batch), network(batch, *GEOMETRY))
        there = propagate_beam(hologram, None, DISTANCE, PITCH, WAVELENGTH, "Linear Angular Spectrum").abs()
        amplitude = batch.sqrt()
        scale = (there * amplitude).sum() / (there * there).sum()
        return (scale * there - amplitude).square().mean()

    start = quality(network(target, *GEOMETRY), target)
    train(network, loss, [target], 15, learning_rate=1e-2, seed=0, progress=False)
    assert quality(network(target, *GEOMETRY), target) > start + 1


def test_a_periodic_picture_has_no_edges():
    network, target = untrained(), torch.rand(16, 24, dtype=torch.float64) + 0.1

    def difference():
        with torch.no_grad():
            phase, moved = (network(image, *GEOMETRY) for image in (target, target.roll((5, -3), (0, 1))))
        return (torch.exp(1j * phase.roll((5, -3), (0, 1))) - torch.exp(1j * moved)).abs().max()

    assert difference() > 0.1
    network.periodic = True
    assert difference() < 1e-9


def test_corrections_of_a_periodic_picture_see_its_other_side():
    network, target = untrained(lively=True), torch.rand(32, 40, dtype=torch.float64) + 0.1
    network.periodic = True
    with torch.no_grad():
        phase, moved = (network(image, *GEOMETRY) for image in (target, target.roll((8, 12), (0, 1))))
        network.periodic = False
        apart = network(target, *GEOMETRY)
    # The convolutions see 22 pixels to each side, and 8 beyond the edges: the middle is the same but for the rest.
    moved, phase, apart = (torch.exp(1j * one) for one in (moved.roll((-8, -12), (0, 1)), phase, apart))
    error, other = (moved - phase).abs(), (apart - phase).abs()
    assert error[8:24, 8:28].mean() < 0.3 * other[8:24, 8:28].mean()


# PSNR in dB by the propagation above, of the photograph at 96 × 96 pixels, in float64.
STATED = {(532e-9, 8e-6, 5e-3): 26.05, (638e-9, 3.74e-6, 2e-3): 23.03}


@pytest.mark.parametrize("geometry", STATED)
def test_quality_of_the_weights(geometry):
    network, target = hologram_network(pretrained=True), picture(96, 96)
    wavelength, dx, distance = geometry
    with torch.no_grad():
        single = network(target.float(), *geometry)
        phase = network.double()(target, *geometry)
    found = quality(phase, target, distance, wavelength, dx)
    # The weights are exact in float64, whose rounding is far below two decimals on any processor.
    assert abs(found - STATED[geometry]) < 0.01
    assert abs(quality(single, target, distance, wavelength, dx) - found) < 0.01
    with pytest.warns(odak.AccuracyWarning, match="iris"):
        double = double_phase_hologram(target, wavelength, distance, dx, iris=False)[0].angle()
    assert found > quality(double, target, distance, wavelength, dx) + 6


def test_the_weights_are_small():
    assert (files("odak") / "assets" / "hologram_network.pt").stat().st_size < 400_000


@pytest.mark.parametrize(
    "call, error, message",
    [
        (lambda n, t: n(t.long(), *GEOMETRY), TypeError, "target"),
        (lambda n, t: n(t + 0j, *GEOMETRY), TypeError, "target"),
        (lambda n, t: n(t[0], *GEOMETRY), ValueError, "target"),
        (lambda n, t: n(t, (WAVELENGTH, WAVELENGTH), PITCH, DISTANCE), ValueError, "2 numbers"),
        (lambda n, t: n(t, -WAVELENGTH, PITCH, DISTANCE), ValueError, "wavelength"),
        (lambda n, t: n(t, WAVELENGTH, 0.0, DISTANCE), ValueError, "dx"),
        (lambda n, t: n(t, WAVELENGTH, PITCH, 0.0), ValueError, "distance"),
        (lambda n, t: n(t, WAVELENGTH, PITCH, [4e-3, 6e-3]), TypeError, "distance"),
        (lambda n, t: n(t, WAVELENGTH, PITCH, [4e-3, -6e-3], t), ValueError, "distance must be positive or neg"),
        (lambda n, t: n(t, WAVELENGTH, PITCH, [4e-3, 6e-3], t[:4]), ValueError, "depth must be .* got .4, 8."),
        (lambda n, t: n(t, WAVELENGTH, PITCH, [4e-3, 6e-3], t + 1), ValueError, "depth must be from 0 to 1"),
        (lambda n, t: n(t, WAVELENGTH, PITCH, [4e-3, 6e-3], t.long()), TypeError, "depth"),
        (lambda n, t: hologram_network(channels=0), ValueError, "channels"),
        (lambda n, t: hologram_network(refinements=-1), ValueError, "refinements"),
        (lambda n, t: hologram_network(8, pretrained=True), ValueError, "hologram_network"),
    ],
)
def test_errors(call, error, message):
    with pytest.raises(error, match=message):
        call(untrained(), torch.rand(8, 8, dtype=torch.float64))


@pytest.mark.slow
def test_exported(tmp_path):
    class Fixed(torch.nn.Module):
        def __init__(self):
            super().__init__()
            self.network = hologram_network(refinements=1, pretrained=True)

        def forward(self, target):
            return self.network(target, 532e-9, 8e-6, 5e-3)

    target = torch.rand(64, 96, generator=torch.Generator().manual_seed(0)) + 0.2
    with torch.no_grad():
        program = torch.export.export(Fixed().eval(), (target,))
        torch.export.save(program, tmp_path / "network.pt2")
        found = torch.export.load(tmp_path / "network.pt2").module()(target)
        difference = torch.exp(1j * found) - torch.exp(1j * Fixed()(target))
    assert difference.abs().square().mean().sqrt() < 1e-4
