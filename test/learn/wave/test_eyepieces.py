"""Displays behind eyepieces of traced rays: against free space, rays, their judge and differences."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from odak.catalog.materials import refractive_index
from odak.instruments import Lens
from odak.learn.raytracing.system import TracedSystem, optical_system, surface, trace_fields
from odak.learn.wave import Display, Expander, Eyes, Modulator, Run, optimise

pytestmark = pytest.mark.usefixtures("small_judge")

GREEN, PITCH = 532e-9, 8e-6


def eyepiece(curvature=1 / 15.05, **options):
    """Return a lens of 15 mm, before whose focal plane the panel is, and the pupils behind it."""
    parts = [surface(1 / curvature, thickness=3.0, material="N-BK7"), surface(-15.05, thickness=12.0)]
    return TracedSystem(optical_system(parts, 1.2, wavelengths=1e3 * GREEN, object_distance=14.0), **options)


def pattern(*shape, seed=0):
    return 2 * math.pi * torch.rand(shape, dtype=torch.float64, generator=torch.Generator().manual_seed(seed))


def display(shape, eyes, wavelengths=GREEN, pitch=PITCH, **options):
    return Display(Modulator(shape, pitch), wavelengths, eyes, **options).double()


def apart(found, wanted):
    return float((found - wanted).norm() / wanted.norm())


@pytest.mark.parametrize("focus", [None, 0.25, math.inf])
def test_free_space_by_rays_is_free_space(focus):
    """The paraxial integral differs from exact paths by (1 mm)⁴/(8·(0.1 m)³·λ), 2e-4 of a wave, at the rim."""
    shape, places = (24, 32), [(1e-4, -3e-4)]
    space = optical_system([surface(thickness=50.0)], 10.0, wavelengths=1e3 * GREEN, object_distance=50.0)
    phases = pattern(1, *shape)
    found = display(shape, Eyes(TracedSystem(space), places, 1e-3, focus))(phases)
    wanted = display(shape, Eyes(0.1, places, 1e-3, focus))(phases)
    assert apart(found, wanted) < 1e-3


@pytest.mark.parametrize(
    ("shape", "pitch", "colours"),
    [((15, 18), (8e-6, 6.4e-6), [638e-9]), pytest.param((96, 144), PITCH, [GREEN, 638e-9], marks=pytest.mark.slow)],
)
def test_the_judge_agrees(shape, pitch, colours):
    """In one colour and an eye beside the axis, and in several of each."""
    several = len(colours) > 1
    eyes = Eyes(eyepiece(), [(2e-4, -1e-4), (0, 0)][: 1 + several], 7e-4, 0.3)
    shown = display(shape, eyes, colours, pitch)
    assert float(shown.judge(pattern(len(colours), *shape)).error.max()) < 3e-3


def test_a_pixel_is_seen_where_its_rays_come_from():
    """Its place in the image is the mean direction of its rays in the pupil, which differs from that of first order."""
    shape, (row, column), side = (128, 176), (-50, 70), 9
    one = torch.zeros(shape, dtype=torch.float64)
    one[shape[0] // 2 + row, shape[1] // 2 + column] = 1.0
    lens = eyepiece()
    image = display(shape, Eyes(lens, diameter=4e-4), profile=one)(torch.zeros(1, *shape, dtype=torch.float64))[0, 0]
    near = [slice(n // 2 + at - side, n // 2 + at + side + 1) for n, at in zip(shape, (row, column), strict=True)]
    part, beside = image[tuple(near)], torch.arange(-side, side + 1, dtype=torch.float64)
    part = part / part.sum()
    found = row + float((beside * part.sum(1)).sum()), column + float((beside * part.sum(0)).sum())
    # The pupil is the image plane of the system; rays that meet it within its diameter.
    fields = torch.tensor([[1e3 * PITCH * column, 1e3 * PITCH * row]], dtype=torch.float64)
    rays = trace_fields(replace_aperture(lens.system), "rings", 40, fields=fields)
    inside = torch.hypot(rays.x, rays.y) < 0.2
    assert int(inside.sum()) > 20
    b = float(lens.matrix()[0][1])
    wanted = [-float(cosine[inside].mean()) * b / PITCH for cosine in (rays.v, rays.u)]
    assert found == pytest.approx(wanted, abs=0.05)
    assert math.hypot(*wanted) > math.hypot(row, column) + 0.1


def replace_aperture(system):
    """Return the system with a cone of light from each point that fills more than the pupil."""
    options = {"aperture": 0.06, "aperture_type": "NA", "telecentric": True, "wavelengths": 1e3 * GREEN}
    return optical_system(list(system.surfaces), object_distance=14.0, **options)


def test_images_have_the_gradients_of_differences():
    lens, shape = eyepiece(), (12, 16)
    (curvature,) = lens.system.vary(curvature=0)
    weights, phases = pattern(*shape, seed=1), pattern(1, *shape).requires_grad_()
    # Without a gradient, sums end at the tolerance itself.
    coarse, fine = (display(shape, Eyes(replace(lens, tolerance=t), [(1e-4, 0)], 1e-3)) for t in (1e-4, 1e-7))

    def value(shown):
        return (shown(phases)[0, 0] * weights).sum()

    slope, turn = torch.autograd.grad(value(coarse), [curvature, phases])
    with torch.no_grad():
        ends = []
        for step in (1e-5, -2e-5):
            curvature += step
            ends.append(float(value(fine)))
        curvature += 1e-5
    assert float(slope) == pytest.approx((ends[0] - ends[1]) / 2e-5, rel=5e-3)
    way = pattern(1, *shape, seed=2)
    curvature.requires_grad_(False)
    fixed = display(shape, Eyes(lens, [(1e-4, 0)], 1e-3))

    def along(step):
        return (fixed(phases.detach() + step * way)[0, 0] * weights).sum()

    (turn,) = torch.autograd.grad((fixed(phases)[0, 0] * weights).sum(), phases)
    assert float((turn * way).sum()) == pytest.approx(float(along(1e-6) - along(-1e-6)) / 2e-6, rel=1e-5)


def test_a_changed_lens_changes_images_where_it_is_varied():
    """What is kept of a lens is dropped where its numbers are to be varied."""
    lens, shape = eyepiece(), (12, 16)
    (curvature,) = lens.system.vary(curvature=0)
    shown, phases = display(shape, Eyes(lens, diameter=1e-3)), pattern(1, *shape)
    with torch.no_grad():
        before = shown(phases)
        curvature += 2e-3
        assert apart(shown(phases), before) > 0.05


@pytest.mark.slow
def test_patterns_for_the_lens_are_better_than_for_a_thin_one():
    size = (96, 144)
    rows, columns = torch.meshgrid(*(torch.linspace(-1, 1, n) for n in size), indexing="ij")
    target = 0.1 + 0.9 * ((rows**2 + columns**2) < 0.6).float() * (0.5 + 0.5 * torch.cos(9 * columns))
    thin, pupil = Lens(15e-3, before=14e-3, after=12e-3), {"diameter": 1e-3}
    real = Display(Modulator(size, PITCH), GREEN, Eyes(eyepiece(), **pupil))
    ideal = Display(Modulator(size, PITCH), GREEN, Eyes(thin, **pupil))
    own, other = (optimise(one, target, run=Run(20, progress=False, seed=0)) for one in (real, ideal))

    def quality(phases):
        image = real(phases)[0, 0]
        return -10 * math.log10(float((image * (image * target).sum() / image.square().sum() - target).square().mean()))

    assert quality(own.phases) > quality(other.phases) + 1.5
    assert float(own.error.max()) < 5e-3


def test_what_a_traced_eyepiece_cannot_have_is_refused():
    lens, panel = eyepiece(), Modulator((12, 16), PITCH)
    with pytest.raises(ValueError, match="rotation must be 0 behind a traced eyepiece"):
        Eyes(lens, rotation=(5.0, 0.0))
    with pytest.raises(ValueError, match="iris must be 'order' for eyes behind a traced eyepiece, got None"):
        Display(panel, GREEN, Eyes(lens), iris=None)
    with pytest.raises(ValueError, match="iris must be"):
        Display(Modulator((12, 16), PITCH, expander=Expander.random((12, 16), 2)), GREEN, Eyes(lens), iris=None)
    words = {Display(panel, GREEN, Eyes(one)).path.words() for one in (lens, eyepiece(), eyepiece(1 / 16))}
    assert len(words) == 2


def sent(places, slopes, numbers):
    """Return where rays from points of the panel meet the pupil, ``[..., 2]``, and their optical paths.

    Two spheres by vectors alone: of the package it takes only the refractive index.
    """
    curvatures, index, (before, thickness, after) = numbers
    at = np.concatenate([places, np.full((*places.shape[:-1], 1), -before)], -1)
    way = np.concatenate([slopes, np.sqrt(1 - (slopes**2).sum(-1, keepdims=True))], -1)
    path, n = 0.0, 1.0
    for curvature, behind, gap in zip(curvatures, (index, 1.0), (thickness, after), strict=True):
        f, g = curvature * (at**2).sum(-1) - 2 * at[..., 2], way[..., 2] - curvature * (at * way).sum(-1)
        length = f / (g + np.sqrt(g**2 - curvature * f))
        at, path = at + length[..., None] * way, path + n * length
        normal = np.array([0.0, 0.0, 1.0]) - curvature * at
        cosine = (way * normal).sum(-1)
        turned = np.sqrt(1 - (n / behind) ** 2 * (1 - cosine**2))
        way, n = n / behind * way + (turned - n / behind * cosine)[..., None] * normal, behind
        at = at - np.array([0.0, 0.0, gap])
    length = -at[..., 2] / way[..., 2]
    return (at + length[..., None] * way)[..., :2], path + n * length


def seen_by_rays(pixels, light, image, diameter, numbers):
    """Return the intensity of pixels of an image of few lit pixels: a sum over rays to points of the pupil, in mm.

    Waves from each pixel have the optical paths of its rays, and the amplitudes of tubes of rays.
    """
    wave, pitch, (curvatures, index, (before, thickness, after)) = 1e3 * GREEN, 1e3 * PITCH, numbers
    nodes, weights = np.polynomial.legendre.leggauss(32)
    radii, angles = diameter / 4 * (1 + nodes), 2 * np.pi * np.arange(112) / 112
    pupil = np.stack([np.outer(radii, part(angles)).ravel() for part in (np.cos, np.sin)], -1)
    areas = np.repeat(radii * weights * diameter / 4, 112) * 2 * np.pi / 112
    first = np.array([[1.0, before], [0.0, 1.0]])
    for curvature, power, gap in zip(curvatures, (index - 1, 1 - index), (thickness / index, after), strict=True):
        first = np.array([[1.0, gap], [0.0, 1.0]]) @ np.array([[1.0, 0.0], [-power * curvature, 1.0]]) @ first
    (a, b), (_, d) = first
    places = np.broadcast_to(pitch * np.array(pixels)[:, None, :], (len(pixels), len(pupil), 2))
    slopes, steps = (pupil - a * places) / b, 1e-6 * np.eye(2)
    for _ in range(2):
        met, paths = sent(places, slopes, numbers)
        turns = [(sent(places, slopes + step, numbers)[0] - sent(places, slopes - step, numbers)[0]) for step in steps]
        turns = np.stack(turns, -1) / 2e-6
        slopes = slopes + np.linalg.solve(turns, (pupil - met)[..., None])[..., 0]
    # A square pixel, and a tube of rays; the stop passes all of the pupil.
    sizes = np.sinc(math.sqrt(0.9) * pitch * slopes / wave).prod(-1) / np.sqrt(abs(np.linalg.det(turns)))
    cycles = (paths - paths.min() - d / (2 * b) * (pupil**2).sum(-1)) / wave
    waves = light[:, None] * sizes * np.exp(2j * np.pi * cycles)
    # Means over the areas of pixels.
    nodes, weights = np.polynomial.legendre.leggauss(3)
    found = []
    for middle in image:
        points = np.stack(np.meshgrid(*(pitch * (one + nodes / 2) for one in middle), indexing="ij"), -1).reshape(-1, 2)
        field = np.exp(2j * np.pi * points @ pupil.T / (wave * b)) @ (areas * waves.sum(0))
        found.append(np.outer(weights / 2, weights / 2).ravel() @ abs(field) ** 2)
    return np.array(found) * (pitch**2 / (wave**2 * b)) ** 2


def test_images_are_sums_over_rays_of_other_code():
    """Of a few lit pixels, near the axis and far from it; a lens without aberrations has another image.

    The pupil lies in the focal plane of the lens, where it is within the order of each pixel, as the sum takes it.
    """
    shape, diameter, relief = (48, 64), 4e-4, 13.975
    parts = [surface(15.05, thickness=3.0, material="N-BK7"), surface(-15.05, thickness=relief)]
    lens = TracedSystem(optical_system(parts, 1.2, wavelengths=1e3 * GREEN, object_distance=14.0))
    pixels, around = [(-23, 29), (-22, 31), (19, -31), (20, -29), (1, 2)], [(-22, 30), (20, -30), (1, 2)]
    shown = [(y + i, x + j) for y, x in around for i in (-1, 0) for j in (0, 1)]

    def at(values, places):
        return torch.stack([values[shape[0] // 2 + y, shape[1] // 2 + x] for y, x in places])

    panel, phases = torch.zeros(shape, dtype=torch.float64), pattern(1, *shape)
    for y, x in pixels:
        panel[shape[0] // 2 + y, shape[1] // 2 + x] = 1.0
    numbers = (1 / 15.05, -1 / 15.05), float(refractive_index("N-BK7", GREEN)), (14.0, 3.0, relief)
    light = np.exp(1j * at(phases[0], pixels).numpy())
    wanted = torch.from_numpy(seen_by_rays(pixels, light, shown, 1e3 * diameter, numbers))
    real = display(shape, Eyes(lens, diameter=diameter), profile=panel)
    (a, _), (c, d) = ([float(value) for value in row] for row in lens.matrix())
    ideal = Lens(-1 / c, before=(d - 1) / c, after=(a - 1) / c)
    thin = display(shape, Eyes(ideal, diameter=diameter), profile=panel)
    found = (real(phases)[0, 0], real.judge(phases).areas[0, 0], thin(phases)[0, 0])
    own, judged, other = (apart(at(image, shown), wanted) for image in found)
    assert own < 1e-3
    assert judged < 2e-4
    assert other > 5e-3
