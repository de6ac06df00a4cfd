"""Fields through lens systems: against the integral of free space, fields of points, rays, films and differences."""

import math

import numpy as np
import pytest
import torch

from odak import AccuracyWarning
from odak.jones import thin_film_stack
from odak.learn.raytracing.system import (
    Coating,
    TracedSystem,
    coordinate_break,
    exit_field,
    first_order,
    lens_fields,
    optical_system,
    retinal_field,
    surface,
    trace_fields,
)
from odak.learn.wave import Display, Modulator, optical_bench

WAVE = 550e-9


def line(n, step):
    return (torch.arange(n, dtype=torch.float64) - n // 2) * step


def spots(n, step, *places, width=2.2):
    """Return a field of Gaussian spots at pixels (row, column)."""
    y, x = line(n, step)[:, None], line(n, step)
    found = sum(
        torch.exp(-((y - step * row) ** 2 + (x - step * column) ** 2) / (width * step) ** 2) for row, column in places
    )
    return found + 0j


def eyepiece(*folded, relief=12.0):
    """Return a thick lens with its focal plane on the panel, and what follows; chief rays are parallel to the axis."""
    front = surface(14.0, thickness=3.0, material="N-BK7")
    back = surface(-30.0, thickness=relief)
    options = {"aperture": 0.012, "aperture_type": "NA", "telecentric": True, "wavelengths": 1e3 * WAVE}
    return optical_system([front, back, *folded], object_distance=17.0, **options)


def power(field, pitch):
    down, across = pitch if isinstance(pitch, tuple) else (pitch, pitch)
    return float(field.abs().square().sum()) * down * across


def test_free_space_is_the_integral_of_rayleigh_sommerfeld():
    space, n, step, out = 4e-3, 32, 4e-6, 8e-6
    field = spots(n, step, (0, 0), (-5, 6), (4, -7))
    system = optical_system([surface(thickness=2.0)], 1.0, wavelengths=1e3 * WAVE, object_distance=2.0)
    found, _ = TracedSystem(system, (out, 1.5 * out), (24, 16), tolerance=1e-6).apply(field, step, WAVE)
    y, x, q, p = line(n, step)[:, None], line(n, step), line(24, out), line(16, 1.5 * out)
    away = ((q[:, None, None, None] - y) ** 2 + (p[:, None, None] - x) ** 2 + space**2).sqrt()
    kernel = torch.exp(2j * math.pi * away / WAVE) * space / away**2 / (1j * WAVE)
    wanted = (kernel * field).sum((-2, -1)) * step**2
    assert (found - wanted).norm() < 1e-3 * wanted.norm()


def test_field_of_a_point_is_that_of_exit_field():
    lens, size, pitch = eyepiece(), 128, 6e-6
    place = 40 * 8e-6, -30 * 8e-6
    found, _ = TracedSystem(lens, pitch, (size, size)).apply(spots(128, 8e-6, (-30, 40), width=1.0), 8e-6, WAVE)
    at = torch.tensor([1e3 * value for value in place], dtype=torch.float64)
    # Its middle lies on the chief ray, from which its phase counts: a shift by less than a sample is a slow phase.
    wave = exit_field(lens, 128, 1e3 * pitch, distance=12.0, field=at)
    chief = trace_fields(lens, torch.zeros(1, 2), fields=at[None])
    down, across = (round(float(value) / (1e3 * pitch)) for value in (chief.y, chief.x))
    both = found[64 + down - 24 : 64 + down + 24, 64 + across - 24 : 64 + across + 24] * wave.field[40:88, 40:88].conj()
    ratio = both / both.abs()
    assert max(ratio.diff(dim=axis).abs().max() for axis in (0, 1)) < 0.1


def test_light_of_a_field_arrives():
    lens = eyepiece(relief=15.0)
    field = spots(128, 8e-6, (0, 0), (20, -35), (-40, 12), (30, 40))
    found, pitch = TracedSystem(lens).apply(field, 8e-6, WAVE)
    assert power(found, pitch) == pytest.approx(power(field, 8e-6), rel=2e-3)


def test_points_are_seen_where_rays_come_from():
    lens = eyepiece()
    focal = float(first_order(lens).focal_length)
    for row, column in ((0, 40), (-45, 30)):
        field = spots(128, 8e-6, (row, column))
        pupil, pitch = TracedSystem(lens, 5e-6, (256, 256)).apply(field, 8e-6, WAVE)
        seen = retinal_field(pupil, pitch, WAVE, 3.0)
        light = seen.field.abs().square()
        centre = [
            float((light * place).sum() / light.sum())
            for place in (line(256, seen.pitch[0])[:, None], line(256, seen.pitch[1]))
        ]
        fields = torch.tensor([[8e-3 * column, 8e-3 * row]], dtype=torch.float64)
        rays = trace_fields(lens, "gauss", 4, fields=fields)
        wanted = -float(rays.v.mean()), -float(rays.u.mean())
        assert centre == pytest.approx(wanted, abs=1e-4)
        assert centre[1] == pytest.approx(8e-3 * column / focal, rel=0.02)


def test_folds_and_films_take_their_share():
    films = Coating((1.46, 2.3), (110e-6, 70e-6), 1.5)
    turn = {"tilt": (45.0, 0.0, 0.0)}
    fold = (
        coordinate_break(**turn),
        surface(material="mirror", coating=films),
        coordinate_break(thickness=-6.0, **turn),
    )
    field = spots(48, 8e-6, (0, 0))
    cases = (eyepiece(), (1, 0)), *((eyepiece(*fold, relief=6.0), vector) for vector in ((1, 0), (0, 1)))
    bare, *found = (
        power(*TracedSystem(lens, None, None, (3, 3), 5, one).apply(field, 8e-6, WAVE)) for lens, one in cases
    )
    assert bare == pytest.approx(power(field, 8e-6) * 0.917, rel=2e-3)
    # Across the fold the x axis is s.
    for seen, polarization in zip(found, "sp", strict=True):
        stack = thin_film_stack(WAVE, [1.0, 1.46, 2.3, 1.5], [110e-9, 70e-9], 45.0, polarization)
        assert seen / bare == pytest.approx(float(stack.reflectance), rel=0.02)


def test_whole_chain_has_the_gradient_of_differences():
    display = Display(Modulator((24, 32), 8e-6, fill=0.9), WAVE, 2e-3).double()
    random = torch.Generator().manual_seed(0)
    pattern = torch.rand(24, 32, generator=random, dtype=torch.float64) * 6
    weight = torch.rand(48, 64, generator=random, dtype=torch.float64)
    start = (pattern, *(torch.tensor(v, dtype=torch.float64) for v in (1 / 14, 17.0, 1.2, 0.4)))

    def loss(phases, curvature, gap, gaze, accommodation, tolerance=1e-3):
        lens = eyepiece()
        lens = optical_system(
            [surface(thickness=torch.nn.Parameter(gap)), *lens.surfaces],
            4.0,
            wavelengths=1e3 * WAVE,
            object_distance=1.0,
        )
        numbers = (curvature, gap)
        lens.surfaces[1].vary("curvature")
        for item, name, value in zip(lens.surfaces[1::-1], ("curvature_value", "thickness"), numbers, strict=True):
            del item._parameters[name]
            setattr(item, name, value)
        light = display.fields(phases)[0, 0, 0]
        bench = optical_bench([TracedSystem(lens, 18e-6, (48, 64), (3, 3), 7, tolerance=tolerance)], WAVE)
        pupil, pitch = bench.propagate(light, 8e-6)
        seen = retinal_field(pupil, pitch, WAVE, 2.0, accommodation, rotation=(gaze, 0.0), center="field")
        return (weight * seen.field.abs().square()).sum()

    given = [value.clone().requires_grad_() for value in start]
    slopes = torch.autograd.grad(loss(*given), given)
    way = torch.rand(24, 32, generator=random, dtype=torch.float64) - 0.5
    for i, (slope, step) in enumerate(zip(slopes, (1e-5, 1e-6, 1e-5, 1e-5, 1e-5), strict=True)):
        move = way if i == 0 else torch.ones((), dtype=torch.float64)
        ahead, behind = (
            loss(*(value + sign * step * move if j == i else value for j, value in enumerate(start)), 1e-7)
            for sign in (1, -1)
        )
        difference = float((ahead - behind) / (2 * step))
        assert float((slope * move).sum()) == pytest.approx(difference, rel=1e-3), i


def test_what_rays_cannot_tell_is_refused_or_warned_of():
    far = optical_system([surface(14.0, thickness=3.0, material="N-BK7"), surface(thickness=20.0)], 2.0)
    with pytest.raises(ValueError, match="object_distance"):
        TracedSystem(far)
    curved = optical_system([surface(14.0)], 2.0, object_distance=17.0, image=surface(-20.0))
    with pytest.raises(ValueError, match="plane as its image"):
        TracedSystem(curved)
    with pytest.raises(ValueError, match="at least 3"):
        TracedSystem(eyepiece(), grid=(2, 3))
    with pytest.raises(ValueError, match="two finite numbers"):
        TracedSystem(eyepiece(), polarization=(1.0, 0.0, 0.0))
    field = spots(64, 8e-6, (0, 0))
    image = optical_system(
        [surface(14.0, thickness=3.0, material=1.5), surface(thickness=54.0)], 2.0, object_distance=56.0
    )
    with pytest.raises(ValueError, match="image of the object"):
        TracedSystem(image).apply(field, 8e-6, WAVE)
    thick = [surface(25.0, thickness=5.0, material="N-BK7"), surface(-25.0, thickness=23.4)]
    wide = TracedSystem(optical_system(thick, 2.0, object_distance=23.4))
    with pytest.raises(ValueError, match="crossing rays"):
        wide.apply(spots(256, 60e-6, (0, 0)), 60e-6, WAVE)
    with pytest.raises(TypeError, match="complex"):
        TracedSystem(eyepiece()).apply(field.real, 8e-6, WAVE)
    with pytest.warns(AccuracyWarning, match="paths between"):
        TracedSystem(eyepiece(), grid=(3, 3), points=3).apply(spots(256, 8e-6, (0, 0)), 8e-6, WAVE)
    small = optical_system(
        [surface(14.0, thickness=3.0, material="N-BK7", semi_diameter=0.5), surface(-30.0, thickness=12.0)],
        1.0,
        object_distance=17.0,
    )
    with pytest.warns(AccuracyWarning, match="aperture"):
        TracedSystem(small).apply(field, 8e-6, WAVE)


@pytest.mark.slow
def test_products_add_up_to_phases_of_many_waves():
    """What couples field and pupil varies by many waves over a large field, which few points do not hold."""
    parts = [surface(30.0, thickness=3.0, material="N-BK7"), surface(-30.0, thickness=24.0)]
    lens = optical_system(parts, 1.2, wavelengths=1e3 * WAVE, object_distance=27.9)
    passage = TracedSystem(lens, 4e-6, (720, 720)).passage((668, 1088), 4e-6, WAVE)
    path, random = passage._path, np.random.default_rng(0)
    assert len(passage._blocks) == 2

    def at(values, places):
        """Return the polynomials through values at the places along each axis."""
        for axis, place in enumerate(places):
            matrix = lens_fields._interpolation(place, values.shape[axis]).to(values.dtype)
            values = torch.tensordot(matrix, values, dims=([1], [axis])).movedim(0, axis)
        return values

    for block, side in zip(passage._blocks, (-0.5, 0.5), strict=True):
        places = [random.uniform(-1, 1, 9) for _ in range(4)]
        whole = [places[0], side + places[1] / 2, *places[2:]]
        rest = at(path.path, whole) - at(block.first, places[:2])[:, :, None, None] - at(block.second, places[2:])
        assert float(rest.max() - rest.min()) > 0.5
        wanted = torch.polar(at(path.amplitude, whole), 2 * math.pi * rest)
        products = (
            (at(one, places[:2]), at(other, places[2:])) for one, other in zip(block.before, block.behind, strict=True)
        )
        found = sum(torch.tensordot(before, behind, dims=0) for before, behind in products)
        assert float((found - wanted).norm() / wanted.norm()) < 5e-3


def test_blocks_of_a_field_add_up_to_it(monkeypatch):
    """Cut into blocks, and with other samples of their light, a field of points is what it is as a whole."""
    field = spots(45, 8e-6, (0, 0), (-19, 15), (16, -20))
    element = TracedSystem(eyepiece(), 4e-6, (90, 135), tolerance=1e-5, output_center=(1e-4, -5e-5))
    whole, _ = element.apply(field, 8e-6, WAVE)
    monkeypatch.setattr(lens_fields, "_BLOCK", 15)
    monkeypatch.setattr(lens_fields, "_TURNS", 8)
    axes = element.passage(field.shape, 8e-6, WAVE)._axes
    assert [axis.blocks for axis in axes] == [3, 3]
    assert min(axis.between for axis in axes) > 1
    parts, _ = element.apply(field, 8e-6, WAVE)
    assert (parts - whole).norm() < 1e-3 * whole.norm()
