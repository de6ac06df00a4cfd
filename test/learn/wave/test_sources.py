"""Sources of displays: against the theorem of van Cittert and Zernike, shifted images, and sums of fields."""

import math

import numpy as np
import pytest
import torch
from scipy import special

from odak import AccuracyWarning
from odak.instruments import Lens
from odak.learn.wave import (
    AmplitudePanel,
    Display,
    Eyes,
    Modulator,
    Run,
    Source,
    disk_source,
    optimise,
    propagate_partially_coherent,
)

WAVELENGTH, PITCH, SIZE = 532e-9, 8e-6, (24, 32)


def display_of(source=None, distance=3e-3, size=SIZE, **options):
    return Display(
        Modulator(size, PITCH, None), options.pop("wavelengths", WAVELENGTH), distance, profile=source, **options
    )


def smooth(*shape, seed=0):
    """Return phases without the fine detail that a stop takes away from light at an angle."""
    noise = np.random.default_rng(seed).normal(size=shape)
    for axis in (-2, -1):
        f = np.fft.fftfreq(shape[axis])
        filtered = np.exp(-((f / 0.08) ** 2))
        noise = np.fft.ifft(np.fft.fft(noise, axis=axis) * (filtered[:, None] if axis == -2 else filtered), axis=axis)
    return torch.from_numpy(noise.real / noise.real.std())


def relative(found, expected):
    return float((found - expected).norm() / expected.norm())


def contrast(source, apart=10, size=(8, 96)):
    """Return the light of fringes of two pixels over that of a point source, at the middles of a row."""
    phases, middle = torch.zeros(size), size[1] // 2
    seen = {}
    for name, lit in (("both", (0, apart)), ("one", (0,)), ("other", (apart,))):
        amplitude = torch.zeros(size)
        for place in lit:
            amplitude[size[0] // 2, middle - apart // 2 + place] = 1.0
        given = Source(source.directions, source.weights, source.width, source.lines, amplitude=amplitude)
        seen[name] = [display_of(one, 0.02, size).double()(phases)[0, 0, 4] for one in (given, amplitude)]
    (both, one, other), point = ([seen[name][k] for name in ("both", "one", "other")] for k in (0, 1))
    return both - one - other, point[0] - point[1] - point[2]


@pytest.mark.parametrize("phase", [1.0, 2.5, 3.8317, 5.5])
def test_fringes_of_a_disc_fade_as_its_transform(phase):
    # ρ = 2π·radius·d/λ; beyond the first zero, 3.8317, bright and dark fringes change places.
    radius = phase * WAVELENGTH / (2 * math.pi * 10 * PITCH)
    found, point = contrast(Source(*disk_source(radius, 4, 12)))
    visibility = float((found * point).sum() / point.square().sum())
    assert visibility == pytest.approx(2 * special.j1(phase) / phase, abs=0.01)


def test_fringes_of_a_line_fade_with_the_difference_of_paths():
    width, apart = 40e-9, 30
    found, point = contrast(Source(width=width, lines=5), apart)
    places = (torch.arange(96) - 48).double() * PITCH
    length = ((places + apart / 2 * PITCH) ** 2 + 0.02**2).sqrt() - ((places - apart / 2 * PITCH) ** 2 + 0.02**2).sqrt()
    faded = torch.exp(-((math.pi * width / WAVELENGTH**2 * length) ** 2) / (4 * math.log(2)))
    assert float(faded.min()) < 0.75
    assert relative(found, point * faded) < 0.06 < relative(found, point) / 2


def test_image_of_a_source_is_the_mean_of_shifted_images():
    # Angles at which the image 3 mm away moves by one and two pixels.
    shifts = [(-2, 0), (0, 1), (1, 2), (2, -1)]
    tangents = torch.tensor(shifts, dtype=torch.float64) * PITCH / 3e-3
    directions = tangents / (1 + tangents.square().sum(1, keepdim=True)).sqrt()
    weights, phases = [0.1, 0.4, 0.3, 0.2], smooth(1, 64, 64)
    seen, alone = (display_of(s, size=(64, 64)).double()(phases)[0, 0] for s in (Source(directions, weights), None))
    inside = slice(16, -16), slice(16, -16)
    moved = sum(w * alone.roll(shift, (0, 1)) for w, shift in zip(weights, shifts, strict=True))
    back = sum(w * alone.roll((-y, -x), (0, 1)) for w, (y, x) in zip(weights, shifts, strict=True))
    assert relative(seen[inside], moved[inside]) < 0.03
    assert min(relative(one[inside], moved[inside]) for one in (alone, back)) > 0.1


def test_image_equals_partially_coherent_propagation():
    directions, weights = disk_source(2e-3, 1, 4)
    phases = smooth(1, 32, 32)
    seen = display_of(Source(directions, weights), size=(32, 32)).double()(phases)[0, 0]
    field = torch.exp(1j * phases[0])
    expected = propagate_partially_coherent(field, WAVELENGTH, (directions, weights), 3e-3, PITCH)
    inside = slice(8, -8), slice(8, -8)
    factor = float(seen[inside].mean() / expected[inside].mean())
    # Means over pixels of finite size, and points.
    assert relative(seen[inside], factor * expected[inside]) < 0.05


ENDS = {
    "plane": {"distance": 3e-3},
    "lens": {"distance": Lens(0.05)},
    "eyes": {"distance": Eyes(0.08, [(0.0, 0.4e-3)], 1.5e-3, 0.075), "iris": None},
}


@pytest.mark.usefixtures("small_judge")
@pytest.mark.parametrize("kind", ENDS)
def test_judge_agrees(kind):
    # Of several wavelengths where that takes little time.
    wavelengths, width = ([WAVELENGTH, 639e-9], 15e-9) if kind == "eyes" else (WAVELENGTH, 0.0)
    source = Source([(1e-3, -2e-3), (-1.5e-3, 0.5e-3)], [0.3, 0.7], width, 2)
    display = display_of(source, wavelengths=wavelengths, size=(40, 48), **ENDS[kind]).double()
    assert float(display.judge(smooth(display.frames, 40, 48)).error.max()) < 3e-3


@pytest.mark.slow
def test_judge_agrees_behind_two_panels():
    panel = Modulator((40, 48), PITCH, lit_through=AmplitudePanel(1e-3))
    display = Display(panel, WAVELENGTH, 3e-3, profile=Source([(1e-3, -2e-3), (-1e-3, 0.0)])).double()
    assert float(display.judge(smooth(1, 40, 48)).error.max()) < 3e-3


def test_points_one_after_another_and_at_once():
    directions, phases = [(1e-3, 0.0), (0.0, -2e-3)], smooth(2, *SIZE)
    apart = [display_of(Source([one])).double() for one in directions]
    shown = display_of(Source(directions, torch.eye(2)), frames=2, powers=torch.ones(2, 1)).double()(phases)
    each = [one(phase) for one, phase in zip(apart, phases, strict=True)]
    torch.testing.assert_close(shown, (each[0] + each[1]) / 2)
    both = display_of(Source(directions)).double()(phases[0])
    torch.testing.assert_close(both, (apart[0](phases[0]) + apart[1](phases[0])) / 2)
    # Of coherent points, fields: those of their sum on the panel.
    coherent = display_of(Source(directions, [0.25, 0.75], coherent=True)).double()
    x = [(torch.arange(n, dtype=torch.float64) - n // 2) * 2 * math.pi * PITCH / WAVELENGTH for n in SIZE]
    turns = (1e-3 * x[0][:, None], -2e-3 * x[1])
    fields = [display_of().double().fields(phases[0] + turn) for turn in turns]
    torch.testing.assert_close(coherent.fields(phases[0]), 0.5 * fields[0] + 0.75**0.5 * fields[1])


def test_gradients_batches_and_parts():
    display = display_of(Source([(1e-3, 0.0), (0.0, -2e-3)], width=10e-9, lines=2), size=(5, 6), frames=2).double()
    phases = smooth(2, 5, 6).requires_grad_()
    assert torch.autograd.gradcheck(display, phases, fast_mode=True)
    torch.testing.assert_close(display(torch.stack([phases, 2 * phases]))[1], display(2 * phases))
    target = torch.zeros(SIZE)
    target[8:16, 10:20] = 1.0
    small = Run(6, progress=False, seed=0)
    found = [
        optimise(display_of(Source(*disk_source(1e-3, 2, 3))), target, run=run)
        for run in (small, Run(6, progress=False, seed=0, memory_budget=1))
    ]
    torch.testing.assert_close(found[0].psnr, found[1].psnr, rtol=1e-3, atol=0)
    assert found[0].losses[-1] < 0.7 * found[0].losses[0]


def test_displays_of_the_same_light():
    source = Source([(1e-3, 0.0), (0.0, -2e-3)], [0.3, 0.7])
    display, phases = display_of(source), torch.zeros(1, *SIZE)
    assert "Source of 2 points within 2 mrad" in repr(display)
    assert display.fingerprint() != display_of().fingerprint() != display_of(Source([(1e-3, 0.0)])).fingerprint()
    lit = display.lit_by(torch.ones(1, 1))
    torch.testing.assert_close(lit(phases), display(phases))
    eyes = Eyes(0.08, diameter=1.5e-3)
    torch.testing.assert_close(display.looked_at(eyes)(phases), display_of(source, eyes)(phases))


def test_lines_of_a_source():
    """A laser is one line at its wavelength; a width is stated, and its lines share the same light about the middle."""
    assert Source().spectrum(532e-9) == ([532e-9], [1.0]) and repr(Source()) == "Source of 1 point within 0 mrad"
    wide = Source(width=20e-9, lines=5)
    wavelengths, weights = wide.spectrum(532e-9)
    assert repr(wide).endswith("mrad, lines of 20 nm") and len(wavelengths) == 5
    assert sum(weights) == pytest.approx(1)
    assert sum(w * one for w, one in zip(weights, wavelengths, strict=True)) == pytest.approx(532e-9, rel=1e-3)


def test_what_sources_cannot_be():
    for words, given in (
        ("directions must be sines within ±1", {"directions": [(1.0, 0.0)]}),
        ("directions must be sines within ±1, got up to 1.2", {"directions": [(0.0, -1.2)]}),
        ("weights must be at least 0", {"weights": [-1.0]}),
        ("weights must be at least 0", {"weights": [-1.0, 3.0], "directions": [(0.0, 0.0), (0.0, 0.1)]}),
        ("some light in each frame", {"weights": [[1.0, 1.0], [0.0, 0.0]], "directions": [(0.0, 0.0), (0.0, 0.1)]}),
        ("weights", {"weights": [1.0, 2.0, 3.0], "directions": [(0.0, 0.0), (0.0, 0.1)]}),
        ("width must be", {"width": -1e-9}),
        ("coherent must be False with a width", {"width": 1e-9, "coherent": True}),
    ):
        with pytest.raises(ValueError, match=words):
            Source(**given)
    with pytest.raises(ValueError, match="weights of 1 frames, got 2"):
        display_of(Source([(0.0, 0.0), (0.0, 1e-3)], torch.eye(2)))
    with pytest.raises(ValueError, match="without a width behind a lens"):
        display_of(Source(width=1e-9), Lens(0.05))
    with pytest.raises(ValueError, match="no field"):
        display_of(Source([(0.0, 0.0), (0.0, 1e-3)])).fields(torch.zeros(SIZE))
    with pytest.warns(AccuracyWarning, match="turns by 0.15 waves over a pixel"):
        display_of(Source([(0.0, 1e-2)]))


def test_infinite_weights_are_refused():
    with pytest.raises(ValueError, match="weights must be at least 0 and finite"):
        Source([[0, 0], [0.1, 0]], [math.inf, 1])
