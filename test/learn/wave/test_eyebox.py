"""The eye's image against direct sums of Fresnel's integral and closed forms, and holograms for an eyebox."""

import math

import numpy as np
import pytest
import torch

import odak
from odak import SamplingWarning
from odak.learn import wave
from odak.wave import eye_image

WAVELENGTH, PITCH, N, DISTANCE = 532e-9, 8e-6, 48, 0.08
BOX = WAVELENGTH * DISTANCE / PITCH


def kernel(to, start, distance):
    """Return the one-dimensional kernel of Fresnel's integral between points."""
    return np.exp(1j * np.pi / (WAVELENGTH * distance) * (to[:, None] - start) ** 2) / np.sqrt(
        1j * WAVELENGTH * distance
    )


def judged(field, place, diameter, focus=DISTANCE, away=DISTANCE, squeeze=(1.0, 1.0)):
    """Return the retinal intensity by direct sums: to a finely sampled pupil, and back to the focus."""
    x = (np.arange(N) - N // 2) * PITCH
    fine = np.arange(-200, 201) / 400 * 1.02 * diameter
    py, px = (p + s * fine for p, s in zip(place, squeeze, strict=True))
    there = kernel(py, x, away) @ field @ kernel(px, x, away).T * PITCH**2
    there = there * (fine[:, None] ** 2 + fine**2 <= (diameter / 2) ** 2)
    # What lies on the line from the middle of the pupil through a sample of the field.
    qy, qx = (p + (x - p) * focus / away for p in place)
    step = (fine[1] - fine[0]) ** 2 * squeeze[0] * squeeze[1]
    back = kernel(qy, py, -focus) @ there @ kernel(qx, px, -focus).T * step
    return abs(back * focus / away) ** 2


def random_field(seed=0):
    return np.exp(1j * np.random.default_rng(seed).uniform(0, 2 * np.pi, (N, N)))


def picture(seed=0, n=N):
    coarse = torch.rand(1, 1, 5, 5, generator=torch.Generator().manual_seed(seed))
    return torch.nn.functional.interpolate(coarse, (n, n), mode="bicubic")[0, 0].clamp(0, 1)


@pytest.mark.parametrize("focus", [None, 0.07, 0.095])
@pytest.mark.parametrize("place", [(0.0, 0.0), (0.4e-3, -0.9e-3)])
def test_image_equals_direct_sums(place, focus):
    field = random_field()
    seen = abs(eye_image(field, PITCH, WAVELENGTH, DISTANCE, place, 1.5e-3, focus)) ** 2
    expected = judged(field, place, 1.5e-3, DISTANCE if focus is None else focus)
    # The rim of the pupil is sampled by some hundred points here and by 27 there.
    assert np.linalg.norm(seen - expected) < 0.02 * np.linalg.norm(expected)
    wrong = judged(field, (place[0] + 3e-4, place[1]), 1.5e-3, DISTANCE if focus is None else focus)
    assert np.linalg.norm(seen - wrong) > 0.2 * np.linalg.norm(expected)


def test_a_turned_eye_sees_through_a_narrower_pupil_elsewhere():
    field, angle = random_field(), math.radians(5)
    seen = abs(eye_image(field, PITCH, WAVELENGTH, DISTANCE, (2e-4, 0.0), 1.5e-3, rotation=(0.0, 5.0))) ** 2
    away = DISTANCE + 10.5e-3 * (1 - math.cos(angle))
    expected = judged(field, (2e-4, 10.5e-3 * math.sin(angle)), 1.5e-3, away, away, (1.0, math.cos(angle)))
    assert np.linalg.norm(seen - expected) < 0.02 * np.linalg.norm(expected)


def test_open_pupil_and_power():
    field = random_field()
    np.testing.assert_allclose(eye_image(field, PITCH, WAVELENGTH, DISTANCE, pupil_diameter=1.0), field, atol=1e-12)
    # Light of random phase fills the box evenly: the pupil takes its share of the area.
    wide = np.exp(1j * np.random.default_rng(1).uniform(0, 2 * np.pi, (128, 128)))
    seen = eye_image(wide, PITCH, WAVELENGTH, 0.2, (5e-4, 5e-4), 3e-3)
    share = np.pi * 1.5e-3**2 / (WAVELENGTH * 0.2 / PITCH) ** 2
    assert (abs(seen) ** 2).mean() == pytest.approx(share, rel=0.1)


def test_point_out_of_focus_is_a_disc_of_the_geometric_size():
    n, distance, focus, diameter = 192, 0.4, 0.25, 2e-3
    point = np.zeros((n, n), dtype=complex)
    point[n // 2, n // 2] = 1
    light = abs(eye_image(point, PITCH, WAVELENGTH, distance, pupil_diameter=diameter, focus=focus)) ** 2
    y, x = np.mgrid[0:n, 0:n] - n // 2
    radius = diameter / 2 * distance * abs(1 / distance - 1 / focus) / PITCH
    inside = light[y**2 + x**2 <= radius**2].sum()
    assert 0.9 < inside / light.sum() < 1 and light[y**2 + x**2 > (1.3 * radius) ** 2].sum() < 0.03 * light.sum()


def test_aberrations_are_those_of_the_pupil():
    field = random_field()
    # Defocus of Zernike, c·√3·(2ρ² − 1), is a change of vergence.
    change = 2.0
    focus = 1 / (1 / DISTANCE - change)
    radians = math.pi / WAVELENGTH * change * 0.75e-3**2 / (2 * math.sqrt(3))
    by_focus = eye_image(field, PITCH, WAVELENGTH, DISTANCE, (1e-4, 2e-4), 1.5e-3, focus)
    by_mode = eye_image(field, PITCH, WAVELENGTH, DISTANCE, (1e-4, 2e-4), 1.5e-3, aberrations={(2, 0): radians})
    np.testing.assert_allclose(abs(by_mode), abs(by_focus), atol=0.02)
    with pytest.raises(TypeError, match="aberrations must be a mapping"):
        eye_image(field, PITCH, WAVELENGTH, DISTANCE, aberrations=[(2, 0)])


def test_faces_batches_and_precision():
    field = random_field()
    places = np.array([[0.0, 0.0], [5e-4, -3e-4], [0.0, 9e-4]])
    foci = np.array([0.08, 0.07, 0.09])
    seen = eye_image(field, PITCH, WAVELENGTH, DISTANCE, places, 1e-3, foci)
    for one, place, focus in zip(seen, places, foci, strict=True):
        np.testing.assert_allclose(one, eye_image(field, PITCH, WAVELENGTH, DISTANCE, place, 1e-3, focus), atol=1e-12)
    tensors = torch.from_numpy(field), torch.from_numpy(places), torch.from_numpy(foci)
    twin = wave.eye_image(tensors[0], PITCH, WAVELENGTH, DISTANCE, tensors[1], 1e-3, tensors[2])
    np.testing.assert_allclose(twin.numpy(), seen, atol=1e-12)
    single = wave.eye_image(tensors[0].to(torch.complex64).expand(2, N, N), PITCH, WAVELENGTH, DISTANCE, places)
    assert single.dtype == torch.complex64 and single.shape == (2, 3, N, N)
    assert wave.eye_image is odak.wave.eye_image


def test_slopes():
    field = torch.from_numpy(random_field()[:6, :5]).requires_grad_()
    others = [torch.tensor(v, dtype=torch.float64, requires_grad=True) for v in (0.08, [0.3, -0.5], 1.7, 0.075)]

    def seen(field, distance, place, diameter, focus):
        return wave.eye_image(field, PITCH, WAVELENGTH, distance, place * 1e-3, diameter * 1e-3, focus)

    assert torch.autograd.gradcheck(seen, (field, *others), fast_mode=True, atol=1e-4)
    turns = torch.tensor([3.0, -5.0], dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(
        lambda turns: wave.eye_image(field.detach(), PITCH, WAVELENGTH, 0.08, rotation=turns),
        turns,
        fast_mode=True,
        atol=1e-4,
    )
    lists = ((others[1][0] * 1e-3, -5e-4), [others[1] * 1e-3, torch.zeros(2, dtype=torch.float64)])
    for place, expected in zip(lists, (others[1] * 1e-3, torch.stack(lists[1])), strict=True):
        listed, stacked = (wave.eye_image(field, PITCH, WAVELENGTH, 0.08, p, 1.7e-3) for p in (place, expected))
        assert torch.equal(listed, stacked) and torch.autograd.grad(listed.abs().sum(), others[1])[0].norm() > 0


def test_improbable_geometries_are_warned_of():
    with pytest.warns(SamplingWarning, match="pupil should be at least"):
        eye_image(random_field(), PITCH, WAVELENGTH, 2e-3)
    with pytest.warns(SamplingWarning, match="blur of the focus"):
        eye_image(random_field(), PITCH, WAVELENGTH, DISTANCE, focus=0.01)


def decibels(light, target):
    light, target = np.asarray(light, dtype=float), np.asarray(target, dtype=float)
    scale = (light * target).sum() / (light**2).sum()
    return -10 * math.log10(((scale * light - target) ** 2).mean())


def test_each_place_of_the_eyebox_sees_its_own_image():
    """Two views, evaluated by direct sums, also at an intermediate position without a target."""
    places = torch.tensor([[0.0, -1.2e-3], [0.0, 1.2e-3]])
    targets = torch.stack([picture(0), picture(1)])
    hologram, seen = wave.eyebox_hologram(
        targets, WAVELENGTH, DISTANCE, PITCH, places, 2e-3, iterations=120, frames=3, seed=0, progress=False
    )
    assert hologram.shape == (3, N, N) and seen.shape == (2, N, N)
    lights = np.stack(
        [np.mean([judged(field.numpy(), place, 2e-3) for field in hologram], 0) for place in places.tolist()]
    )
    assert abs(decibels(seen, targets) - decibels(lights, targets)) < 0.3
    assert decibels(lights, targets) > 20
    assert decibels(lights[::-1], targets) < 12
    # A hologram for its own plane alone sends these places next to no light of its image.
    plain, _ = wave.stochastic_gradient_descent(
        targets[1], WAVELENGTH, 1e-6, PITCH, n_iteration=2, initial_phase="flat", progress=False
    )
    assert decibels(judged(plain.numpy(), (0.0, 1.2e-3), 2e-3), targets[1]) < 12


def test_each_direction_of_gaze_sees_its_own_image():
    """An eye rotated to either side, evaluated by direct sums at the position, width and distance of its pupil."""
    angles, targets = (6.0, -4.0), torch.stack([picture(0), picture(1)])
    hologram, seen = wave.eyebox_hologram(
        targets, WAVELENGTH, DISTANCE, PITCH, [[2e-4, 0.0]] * 2, 1.6e-3,
        rotation=[[0.0, angle] for angle in angles], iterations=50, frames=3, seed=0, progress=False,
    )  # fmt: skip
    lights = []
    for angle in map(math.radians, angles):
        away = DISTANCE + 10.5e-3 * (1 - math.cos(angle))
        view = ((2e-4, 10.5e-3 * math.sin(angle)), 1.6e-3, away, away, (1.0, math.cos(angle)))
        lights.append(np.mean([judged(field.numpy(), *view) for field in hologram], 0))
    assert np.linalg.norm(seen.numpy() - lights) < 0.03 * np.linalg.norm(lights)
    assert decibels(lights, targets) > 20
    assert decibels(lights[::-1], targets) < 12
    for light, angle in zip(seen, angles, strict=True):
        alone = wave.eye_image(hologram, PITCH, WAVELENGTH, DISTANCE, (2e-4, 0.0), 1.6e-3, rotation=(0.0, angle))
        torch.testing.assert_close(light, wave.intensity(alone).mean(0), rtol=1e-4, atol=1e-5)


def test_places_drawn_by_step_and_checkpoints(tmp_path):
    places = torch.tensor([[0.0, -1e-3], [0.0, 0.0], [0.0, 1e-3]])
    options = {"pupil_positions": places, "pupils_per_step": 2, "seed": 3, "progress": False}
    lengths = (WAVELENGTH, DISTANCE, PITCH)
    whole = wave.eyebox_hologram(picture(n=24), *lengths, iterations=6, **options)[0]

    def stop(iteration, loss):
        if iteration == 2:
            raise KeyboardInterrupt

    kept = {"checkpoint": tmp_path / "run.pt", "checkpoint_every": 1}
    wave.eyebox_hologram(picture(n=24), *lengths, iterations=6, callback=stop, **kept, **options)
    assert torch.equal(wave.eyebox_hologram(picture(n=24), *lengths, iterations=6, **kept, **options)[0], whole)
    known = {"wavelength": WAVELENGTH, "distance": DISTANCE, "pitch": PITCH, "iterations": 6} | kept | options
    for name, other in (
        ("wavelength", 450e-9), ("distance", 0.9 * DISTANCE), ("pitch", (PITCH, 0.9 * PITCH)), ("pupil_diameter", 1e-3),
        ("focus", DISTANCE),
    ):  # fmt: skip
        with pytest.raises(ValueError, match=f"is of another run: its {name} differ"):
            wave.eyebox_hologram(picture(n=24), **(known | {name: other}))


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        ({"targets": torch.zeros(3, 8, 8)}, ValueError, "targets must be"),
        ({"targets": -torch.ones(8, 8)}, ValueError, "targets must be finite intensities of at least 0"),
        ({"pupil_positions": [0.0, 0.0]}, ValueError, "pupil_positions must be"),
        ({"pupil_diameter": [1e-3] * 3}, ValueError, "pupil_diameter must be one number or"),
        ({"focus": [-1.0, 1.0]}, ValueError, "focus must be positive"),
        ({"rotation": [[0.0, 1.0]] * 3}, ValueError, r"rotation must be \[2\] or \[2, 2\]"),
        ({"pupils_per_step": 1, "optimizer": "lbfgs"}, ValueError, "pupils_per_step must be left out"),
        ({"initial_phase": torch.zeros(4, 4)}, ValueError, "initial_phase must be"),
        ({"slm": wave.spatial_light_modulator(samples_per_pixel=2)}, ValueError, "slm must have one sample per pixel"),
    ],
)
def test_bad_arguments_are_named(change, error, message):
    arguments = {
        "targets": torch.zeros(8, 8), "wavelength": WAVELENGTH, "distance": DISTANCE, "pitch": PITCH,
        "pupil_positions": [[0.0, 0.0], [1e-3, 0.0]], "iterations": 1, "progress": False,
    }  # fmt: skip
    with pytest.raises(error, match=message):
        wave.eyebox_hologram(**(arguments | change))
