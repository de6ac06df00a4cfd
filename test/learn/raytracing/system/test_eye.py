"""The schematic eye: published values, explicit ray traces, wave and ray paths, retinal images, accommodation."""

import math

import numpy as np
import pytest
import torch

from odak.learn.perception import unified_pupil_diameter
from odak.learn.raytracing.system import (
    accommodation_response,
    eye_refraction,
    eye_transfer_function,
    eye_wavefront,
    first_order,
    liou_brennan_eye,
    navarro_eye,
    point_spread_function,
    retinal_field,
    retinal_image,
)
from odak.learn.raytracing.system.eye import NAVARRO_INDICES, REFERENCE, _medium

GREEN = 550e-9


def test_published_indices_power_and_length():
    # Navarro et al. (1985): indices at 589.3 nm; power and axial length in the text.
    published = {"cornea": 1.376, "aqueous": 1.3374, "lens": 1.42, "vitreous": 1.336}
    for name, index in published.items():
        assert float(_medium(name).index(0.5893)) == pytest.approx(index, abs=1.1e-4)
        for wave, given in zip((0.365, 0.4861, 0.6563, 1.014), NAVARRO_INDICES[name], strict=True):
            assert float(_medium(name).index(wave)) == pytest.approx(given, abs=2e-4)
    eye = navarro_eye()
    found = first_order(eye)
    assert 1000 / float(found.focal_length) == pytest.approx(60.4, abs=0.05)
    # The vitreous of 1985, 16.404 mm, ends at the paraxial focus: an axial length of 24.00 mm.
    length = 0.55 + 3.05 + 4.0 + float(found.back_focal_distance)
    assert length == pytest.approx(24.0, abs=0.02)
    accommodated = first_order(navarro_eye(8.0))
    assert 1000 / float(accommodated.focal_length) > 66


def test_liou_and_brennan():
    # Their abstract: equivalent power 60.35 dioptres, axial length 23.95 mm; the relaxed eye is in focus at 555 nm.
    eye = liou_brennan_eye()
    found = first_order(eye)
    assert 1000 / float(found.focal_length) == pytest.approx(60.35, abs=0.005)
    assert float(sum(one.thickness for one in eye.surfaces)) == pytest.approx(23.95, abs=1e-9)
    assert float(found.back_focal_distance) == pytest.approx(float(eye.surfaces[-1].thickness), abs=0.005)
    # The halves of the lens meet with one index, and the second ends with that with which the first begins.
    assert [float(eye.surfaces[at].material.index(0.555)) for at in (3, 4)] == pytest.approx([1.368, 1.407], abs=1e-4)
    axis = [
        float(eye.surfaces[at].gradient.squared(0.0, 0.0, z, base)[0]) ** 0.5
        for at, z, base in ((3, 1.59, 1.368), (4, 0.0, 1.407), (4, 2.43, 1.407))
    ]
    assert axis == pytest.approx([1.407, 1.407, 1.368], abs=5e-5)


def test_chromatic_difference_of_refraction():
    # Thibos et al., Appl. Opt. 31, 3594 (1992), doi 10.1364/AO.31.003594: R = 1.68524 - 633.46/(nm - 214.102).
    waves = [450e-9, 486e-9, 550e-9, 589e-9, 656e-9, 700e-9]
    found = eye_refraction(waves, 1.0)
    thibos = torch.tensor([633.46 / (wave * 1e9 - 214.102) - 1.68524 for wave in waves])
    assert float(((found - found[3]) - (thibos - thibos[3])).abs().max()) < 0.12


def path_by_hand(height, wavelength):
    """Return the path in mm of a ray at a height through the eye to the retina's apex plane, and its place there."""
    micro = wavelength * 1e6
    index = [1.0] + [float(_medium(name).index(micro)) for name in ("cornea", "aqueous", "lens", "vitreous")]
    surfaces = [(7.72, -0.26, 0.0), (6.5, 0.0, 0.55), (10.2, -3.1316, 3.6), (-6.0, -1.0, 7.6)]
    y, z, direction, path = height, -1.0, np.array([0.0, 1.0]), 0.0
    for number, (radius, conic, vertex) in enumerate(surfaces):
        # y² + (1 + k)s² − 2Rs = 0 with s the height over the vertex, solved for the step along the ray.
        s, (dy, dz) = z - vertex, direction
        a = dy * dy + (1 + conic) * dz * dz
        b = y * dy + (1 + conic) * s * dz - radius * dz
        c = y * y + (1 + conic) * s * s - 2 * radius * s
        steps = (
            [-c / (2 * b)]
            if abs(a) < 1e-14
            else [(-b - q) / a for q in (1, -1) for q in [q * math.sqrt(b * b - a * c)]]
        )
        step = min(steps, key=lambda one: abs(z + one * dz - vertex))
        y, z, path = y + step * dy, z + step * dz, path + index[number] * step
        normal = np.array([y, (1 + conic) * (z - vertex) - radius])
        normal /= np.linalg.norm(normal)
        if normal @ direction > 0:
            normal = -normal
        ratio = index[number] / index[number + 1]
        cosine = -normal @ direction
        direction = ratio * direction + (ratio * cosine - math.sqrt(1 - ratio**2 * (1 - cosine**2))) * normal
    return y, z, direction, path, index[-1]


def test_wavefront_is_that_of_rays_by_hand():
    retina = 7.6 + 16.3203
    pupil_plane = float(first_order(navarro_eye()).exit_pupil_distance) + 7.6
    radius = retina - pupil_plane

    def lag(height):
        y, z, (dy, dz), path, index = path_by_hand(height, GREEN)
        # Forward or back along the ray to the sphere about the retina's apex through the exit pupil.
        b = y * dy + (z - retina) * dz
        c = y * y + (z - retina) ** 2 - radius**2
        step = -b - math.sqrt(b * b - c)
        return path + index * step

    heights = [0.5, 1.0, 1.5, 2.0]
    expected = torch.tensor([lag(height) - lag(0.0) for height in heights], dtype=torch.float64) * 1e-3
    found = eye_wavefront(torch.tensor(heights) * 1e-3, GREEN, 4.0)[0]
    assert float((found - expected).abs().max()) < 2e-9
    assert float(expected.abs().max()) > 2e-7


def test_wave_path_has_the_strehl_ratio_of_the_ray_path():
    for diameter in (2.0, 4.0):
        by_rays = float(point_spread_function(navarro_eye(0.0, diameter, GREEN), 64, 512).strehl)
        size, pitch = (256, 256), 2e-5
        transfer = eye_transfer_function(size, pitch, GREEN, diameter)[0]
        ideal = perfect_transfer(size, pitch, diameter)
        weight = torch.full_like(transfer, 2.0)
        weight[:, 0] = weight[:, -1] = 1.0
        assert float((transfer * weight).sum() / (ideal * weight).sum()) == pytest.approx(by_rays, rel=0.03)


def perfect_transfer(size, pitch, diameter):
    y, x = (
        torch.fft.fftfreq(size[0], pitch, dtype=torch.float64),
        torch.fft.rfftfreq(size[1], pitch, dtype=torch.float64),
    )
    share = (torch.hypot(y[:, None], x) * GREEN / (diameter * 1e-3)).clamp(max=1)
    return 2 / math.pi * (torch.acos(share) - share * (1 - share**2).sqrt())


def test_transfer_function_without_aberrations_is_closed_form():
    # A pupil of half a millimetre has no aberrations worth the name.
    size, pitch = (64, 48), 2e-4
    found = eye_transfer_function(size, pitch, GREEN, 0.5, vergence=float(eye_refraction(GREEN, 0.5)))[0]
    assert float((found - perfect_transfer(size, pitch, 0.5)).abs().max()) < 2e-4


def test_defocus_blurs_to_the_disc_of_geometry():
    # Pupil times defocus: 4 mm at 3 dioptres is a disc of 12 mrad.
    point = torch.zeros(1, 161, 161, dtype=torch.float64)
    point[..., 80, 80] = 1
    near = 3.0 + float(eye_refraction(GREEN))
    seen = retinal_image(point, near, 2e-4, [GREEN])[0]
    line = (torch.arange(161, dtype=torch.float64) - 80) * 2e-4
    radius = torch.hypot(line[:, None], line)
    assert float(seen.sum()) == pytest.approx(1, abs=0.02)
    # Second moment of a disc of radius a: a²/2.
    moment = float((seen * radius**2 * (radius < 0.015)).sum() / seen[radius < 0.015].sum())
    assert math.sqrt(2 * moment) == pytest.approx(0.006, rel=0.08)


def test_a_coherent_point_is_seen_as_the_incoherent_one():
    n, pitch, distance = 256, 3e-5, 0.4
    line = (torch.arange(n, dtype=torch.float64) - n // 2) * pitch
    squared = line[:, None] ** 2 + line**2
    spherical = torch.exp(2j * math.pi / GREEN * squared / 2 / distance)
    for accommodation in (0.0, 2.3):
        seen = retinal_field(spherical, pitch, GREEN, 3.0, accommodation)
        intensity = seen.field.abs().square()
        point = torch.zeros(1, n, n, dtype=torch.float64)
        point[0, n // 2, n // 2] = 1
        expected = retinal_image(point, 1 / distance, seen.pitch[0], [GREEN], 3.0, accommodation)[0]
        assert float((intensity / intensity.sum() - expected).abs().max()) < 0.04 * float(expected.max())
    assert seen.pitch == (GREEN / (n * pitch),) * 2


def test_light_from_right_is_seen_at_right_and_power_is_kept():
    n, pitch, cycles = 128, 5e-5, 9
    # Light from a point at the right propagates to the left.
    wave = torch.exp(-2j * math.pi * cycles / n * torch.arange(n, dtype=torch.float64)).expand(n, n)
    seen = retinal_field(wave, pitch, GREEN, 2.0)
    assert divmod(int(seen.field.abs().argmax()), n) == (n // 2, n // 2 + cycles)
    assert float(seen.field.abs().square().sum()) == pytest.approx(math.pi * 1e-3**2 / pitch**2, rel=0.02)
    moved = retinal_field(wave, pitch, GREEN, 2.0, pupil_position=(1e-3, 0.0))
    assert float(moved.field.abs().square().sum()) == pytest.approx(float(seen.field.abs().square().sum()), rel=0.02)


def test_a_turned_eye_sees_in_the_middle_what_it_looks_at():
    # Along its gaze an eye sees as an eye at rest does along the axis: a point of the same shape and power.
    n, pitch = 512, 8e-6
    rest = retinal_field(torch.ones(n, n, dtype=torch.complex128), pitch, GREEN, 2.0).field.abs().square()
    for right, down in ((1.5, 0.0), (-1.0, 1.2)):
        a, b = math.radians(right), math.radians(down)
        line = (torch.arange(n, dtype=torch.float64) - n // 2) * pitch
        # Light from the right propagates to the left.
        path = line * math.sin(a) * math.cos(b) + line[:, None] * math.sin(b)
        wave = torch.exp(-2j * math.pi / GREEN * path)
        seen = retinal_field(wave, pitch, GREEN, 2.0, rotation=(right, down)).field.abs().square()
        assert float((seen - rest).abs().max()) < 2e-3 * float(rest.max())
        assert float(seen.sum()) == pytest.approx(float(rest.sum()), rel=2e-3)


def test_the_centre_of_rotation_is_behind_the_pupil():
    # A point 5 mm to the right at 100 mm: the gaze is on it where the centre, 10.5 mm behind the pupil, points at it;
    # turned by the angle at which the pupil at rest sees it, the gaze has gone past it.
    n, pitch, side, ahead, radius = 900, 4e-6, 5e-3, 0.1, 10.5e-3
    line = (torch.arange(n, dtype=torch.float64) - n // 2) * pitch
    distance = ((line - side) ** 2 + line[:, None] ** 2 + ahead**2).sqrt()
    wave = torch.exp(2j * math.pi / GREEN * (distance - ahead))
    toward = math.atan(side / (ahead + radius))
    focus = 1 / (math.hypot(side, ahead + radius) - radius) - float(eye_refraction(GREEN, 2.0))
    for angle in (toward, math.atan(side / ahead)):
        seen = retinal_field(wave, pitch, GREEN, 2.0, focus, rotation=(math.degrees(angle), 0.0))
        row, column = divmod(int(seen.field.abs().argmax()), n)
        # From the middle of the turned pupil, in direction cosines of the field.
        pupil = radius * math.sin(angle), radius * (math.cos(angle) - 1)
        away = side - pupil[0], ahead - pupil[1]
        expected = away[0] / math.hypot(*away) - math.sin(angle)
        assert row == n // 2
        assert (column - n // 2) * seen.pitch[1] == pytest.approx(expected, abs=1.5 * seen.pitch[1])
    assert expected < -20 * seen.pitch[1]


def test_accommodation_follows_a_plane_and_lands_between_two():
    noise = torch.rand(1, 64, 64, dtype=torch.float64, generator=torch.Generator().manual_seed(3))
    tried = [0.5, 1.0, 1.5, 2.0, 2.5, 3.0]
    options = {"pitch": 6e-4, "wavelengths": [GREEN], "accommodations": tried}
    single = [accommodation_response(noise, vergence, **options).vergence for vergence in (1.2, 2.4)]
    assert single == pytest.approx([1.2, 2.4], abs=0.2)
    halves = torch.stack([0.5 * noise, 0.5 * noise])
    # Depth-filtered light of two planes 0.6 dioptres apart: MacKenzie et al. (2010).
    between = accommodation_response(halves, [1.5, 2.1], **options).vergence
    assert between == pytest.approx(1.8, abs=0.15)


def test_gradients_reach_the_picture_and_the_field():
    picture = torch.rand(1, 8, 8, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda one: retinal_image(one, 1.0, 1e-3, [GREEN]), picture, fast_mode=True)
    field = torch.rand(8, 8, dtype=torch.complex128, requires_grad=True)
    for turned in ((0.0, 0.0), (4.0, -3.0)):
        assert torch.autograd.gradcheck(
            lambda one, turned=turned: retinal_field(one, 5e-4, GREEN, rotation=turned).field, field, fast_mode=True
        )


@pytest.mark.parametrize("shape", [(1, 65), (65, 1)])
def test_rim_of_pupil_is_one_sample_wide_in_fields_of_one_row(shape):
    seen = retinal_field(torch.ones(shape, dtype=torch.complex128), 1e-4, GREEN, pupil_diameter=4.0)
    place = np.abs(np.arange(65) - 32) * 1e-4
    expected = (np.clip((2e-3 - place) / 1e-4 + 0.5, 0, 1) ** 2).sum()
    assert float(seen.field.abs().square().sum()) == pytest.approx(expected, rel=1e-12)


def test_a_turned_eye_may_be_seen_on_the_samples_of_the_field():
    n, pitch = 128, 4e-5
    x = (torch.arange(n, dtype=torch.float64) - n // 2) * pitch
    field = torch.exp(-2j * math.pi * x * 6 / (n * pitch)).expand(n, n)
    found = [retinal_field(field, pitch, GREEN, 2.0, 0.0, (0, 0), (0.4, 0.0), centre) for centre in ("field", "gaze")]
    columns = [int(seen.field.abs().square().sum(0).argmax()) for seen in found]
    shift = math.sin(math.radians(0.4)) / found[0].pitch[1]
    assert columns == [n // 2 + 6, round(n // 2 + 6 - shift)]
    assert float(found[0].field.abs().square().sum()) == pytest.approx(float(found[1].field.abs().square().sum()))


def test_gradients_reach_pupil_gaze_and_accommodation():
    random = torch.Generator().manual_seed(0)
    field = torch.randn(24, 24, dtype=torch.complex128, generator=random)
    weight = torch.rand(24, 24, dtype=torch.float64, generator=random)

    def light(diameter, accommodation, place, gaze):
        seen = retinal_field(field, 1e-4, GREEN, diameter, accommodation, place * 1e-3, gaze).field
        return (weight * seen.abs().square()).sum()

    start = [torch.tensor(value, dtype=torch.float64) for value in (1.9, 1.3, [0.1, -0.2], [0.7, -1.1])]
    given = [value.clone().requires_grad_() for value in start]
    for i, slope in enumerate(torch.autograd.grad(light(*given), given)):
        ahead, behind = (
            light(*(value + sign * 1e-5 if j == i else value for j, value in enumerate(start))) for sign in (1, -1)
        )
        assert float(slope.sum()) == pytest.approx(float(ahead - behind) / 2e-5, rel=1e-4)


def test_pupil_sizes():
    # Limits of the formula at the reference age, and equation 21 by hand.
    assert float(unified_pupil_diameter(1e-12)) == pytest.approx(7.75, abs=1e-3)
    assert float(unified_pupil_diameter(1e12)) == pytest.approx(2.0, abs=1e-2)
    flux = (50.0 * 400 / 846) ** 0.41
    young = 7.75 - 5.75 * flux / (flux + 2)
    expected = young + (60 - 28.58) * (0.02132 - 0.009562 * young)
    assert float(unified_pupil_diameter(50.0, 400.0, 60.0)) == pytest.approx(expected)
    assert float(unified_pupil_diameter(500.0, 400.0, 60.0, eyes=1)) == pytest.approx(expected)
    light = torch.tensor(50.0, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(unified_pupil_diameter, light, fast_mode=True)


def test_wrong_arguments():
    with pytest.raises(ValueError, match="accommodation"):
        navarro_eye(11.0)
    with pytest.raises(ValueError, match="wavelengths"):
        eye_wavefront(0.001, 550.0)
    with pytest.raises(ValueError, match="pupil_diameter"):
        eye_wavefront(0.001, GREEN, 0.0)
    with pytest.raises(ValueError, match="planes"):
        retinal_image(torch.rand(2, 1, 8, 8), 1.0, 1e-3)
    with pytest.raises(TypeError, match="complex"):
        retinal_field(torch.rand(8, 8), 1e-4, GREEN)
    with pytest.raises(ValueError, match="rotation"):
        retinal_field(torch.ones(8, 8, dtype=torch.complex64), 1e-4, GREEN, rotation=(70.0, 0.0))
    with pytest.raises(ValueError, match="eyes"):
        unified_pupil_diameter(10.0, eyes=3)
    with pytest.raises(ValueError, match="age must be from 20 to 83 years, got 5"):
        unified_pupil_diameter(10.0, age=5.0)
    with pytest.raises(ValueError, match="age must be from 20 to 83"):
        unified_pupil_diameter(10.0, age=torch.tensor([30.0, 90.0]))
    with pytest.raises(ValueError, match="picture must not be empty"):
        retinal_image(torch.rand(0, 3, 8, 8), 1.0, 1e-3)
    for weights in ((0.0, 0.0, 0.0), (-1.0, 1.0, 1.0)):
        with pytest.raises(ValueError, match="weights"):
            accommodation_response(torch.rand(3, 8, 8), 1.0, 1e-3, accommodations=(1.0, 2.0, 3.0), weights=weights)
    assert REFERENCE == 589.3e-9
