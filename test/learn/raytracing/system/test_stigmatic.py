"""Surfaces that image a point exactly, and the light around it: Descartes' ovals, Airy's disc, modulation."""

import math

import numpy as np
import pytest
import torch

from odak.learn.raytracing.system import (
    Fields,
    airy_pattern,
    field_modulation,
    first_order,
    footprint,
    incidence_angles,
    load_system,
    modulation_transfer_function,
    optical_system,
    paraxial_rays,
    point_spread_function,
    pupil_aberration,
    pupil_quadrature,
    relative_illumination,
    rms_spot,
    strehl_ratio,
    surface,
    trace_fields,
    vignetting_factors,
    wavefront,
    zernike_fit,
)
from odak.learn.wave import propagate_beam
from odak.raytracing.apertures import CircularAperture
from odak.raytracing.interfaces import IdealLens

F64 = torch.float64
N = 1.5


def paraboloid(f=100.0, aperture=60.0):
    return optical_system([surface(-2 * f, conic=-1.0, thickness=-f, material="mirror")], aperture)


def hyperboloid(f=100.0, aperture=60.0, thickness=10.0, **options):
    """Return a lens that is flat in front and a hyperboloid behind, k = −n²: Descartes, La Géométrie (1637)."""
    radius = -(N - 1) * f
    rear = surface(radius, conic=-(N**2), thickness=f, stop=True)
    return optical_system([surface(thickness=thickness, material=N), rear], aperture, **options)


def ellipsoid(f=100.0, aperture=40.0):
    """Return one surface, k = −1/n², with the focus inside the glass at n·R/(n − 1)."""
    return optical_system([surface(f * (N - 1) / N, conic=-1 / N**2, thickness=f, material=N)], aperture)


@pytest.mark.parametrize(
    "system", [paraboloid(), hyperboloid(), ellipsoid()], ids=["paraboloid", "hyperboloid", "ellipsoid"]
)
def test_a_point_is_imaged_to_a_point(system):
    focal = abs(float(system.surfaces[-1].thickness))
    assert float(rms_spot(system)[0]) < 1e-9 * focal * 1e-3
    found = wavefront(system)
    assert float(found.path.abs().max()) < 1e-7
    # It takes the conic constant to do so.
    system.surfaces[-1].conic.mul_(0.99)
    assert float(rms_spot(system)[0]) > 1e-6 * focal


@pytest.mark.parametrize("name", ["sphere", "aspheric terms"])
def test_an_asphere_may_say_the_same_in_other_words(name):
    """The paraboloid as a2·r² on a plane."""
    mirror = optical_system([surface(coefficients=[-1 / 400.0, 0.0], thickness=-100.0, material="mirror")], 60.0)
    if name == "sphere":
        mirror = optical_system(
            [surface(-200.0, coefficients=[0.0], conic=-1.0, thickness=-100.0, material="mirror")], 60.0
        )
    a, b = trace_fields(mirror, fields=[(0.0, 1.0)]), trace_fields(paraboloid(), fields=[(0.0, 1.0)])
    torch.testing.assert_close(a.y, b.y, atol=1e-12, rtol=0)
    torch.testing.assert_close(a.path, b.path, atol=1e-12, rtol=0)


def test_light_around_the_focus_is_airys():
    wavelength, f, aperture = 500e-6, 100.0, 10.0
    system = hyperboloid(f, aperture, wavelengths=wavelength)
    spread = point_spread_function(system, samples=128, size=512)
    assert float(spread.strehl[0, 0]) == pytest.approx(1, abs=1e-9)
    place = (torch.arange(512) - 256) * spread.pitch[0, 0, 0]
    aperture_number = math.sin(math.atan(aperture / 2 / f))
    near = place.abs() < 4 * wavelength / aperture_number
    profile = spread.intensity[0, 0, 256][near]
    assert float((profile - airy_pattern(place[near], wavelength, aperture_number)).abs().max()) < 2e-3
    # The first dark ring is at 0.61 λ/NA.
    ring = 0.6098 * wavelength / aperture_number
    dark = torch.argmin(torch.where((place > 0) & (place < 1.5 * ring), spread.intensity[0, 0, 256], 1.0))
    assert float(place[dark]) == pytest.approx(ring, abs=0.5 * float(spread.pitch[0, 0, 0]))


def test_rays_and_waves_give_the_same_image():
    """The lens' pupil by rays, against the angular spectrum of the converging wave itself."""
    wavelength, f, aperture = 500e-9, 10e-3, 0.5e-3
    system = hyperboloid(f, aperture, thickness=1e-3, wavelengths=wavelength, unit="m")
    spread = point_spread_function(system, samples=64, size=512)
    n, dx = 512, 2e-6
    line = (torch.arange(n, dtype=F64) - n // 2) * dx
    squared = line[:, None] ** 2 + line**2
    phase = -2 * math.pi / wavelength * ((squared + f * f).sqrt() - f)
    share = ((aperture / 2 - squared.sqrt()) / dx + 0.5).clamp(0, 1)
    field = share * torch.exp(1j * phase)
    image = propagate_beam(field, None, f, dx, wavelength, "Angular Spectrum").abs().square()
    profile = (image[n // 2] / image.max()).numpy()
    place = (torch.arange(512) - 256) * spread.pitch[0, 0, 1]
    expected = np.interp(line.numpy(), place.numpy(), spread.intensity[0, 0, 256].numpy())
    near = line.abs().numpy() < 30e-6
    assert np.abs(profile - expected)[near].max() < 0.01


def test_modulation_transfer_of_a_perfect_lens():
    """Goodman, Introduction to Fourier Optics (2005), eq. 6-32."""
    wavelength, f, aperture = 500e-6, 100.0, 10.0
    spread = point_spread_function(hyperboloid(f, aperture, wavelengths=wavelength), samples=128, size=512)
    for axis in ("x", "y"):
        frequency, transfer = modulation_transfer_function(spread, axis)
        cut = 2 * math.sin(math.atan(aperture / 2 / f)) / wavelength
        s = (frequency[0, 0] / cut).clamp(max=1)
        perfect = 2 / math.pi * (torch.arccos(s) - s * (1 - s * s).sqrt())
        assert float((transfer[0, 0] - perfect).abs().max()) < 5e-3


def test_defocus_is_the_zernike_polynomial_of_defocus():
    """W = δ·NA²/2λ of peak to valley for a small defocus δ: c₄ = W/(2√3), rest near nothing."""
    wavelength, shift = 500e-6, 0.02
    system = hyperboloid(100.0, 4.0, wavelengths=wavelength)
    system.surfaces[-1].thickness.add_(shift)
    coefficients, left = zernike_fit(wavefront(system), 11)
    expected = shift * 0.02**2 / 2 / wavelength
    assert float(coefficients[0, 0, 3].abs()) == pytest.approx(expected / (2 * math.sqrt(3)), rel=2e-3)
    # A focus before the plane: the rim's light is late there by less than the centre's, W < 0 at the rim.
    assert float(coefficients[0, 0, 3]) < 0
    assert float(coefficients[0, 0, [1, 2, 4, 5, 6, 7, 8, 9]].abs().max()) < 1e-9
    assert float(left[0, 0]) < 1e-6


def test_the_wavefront_of_a_perfect_point_out_of_focus():
    """Paths from the focus F to the sphere of radius R about C, δ behind F, by the law of cosines."""
    wavelength, shift = 500e-6, 0.5
    system = hyperboloid(100.0, 60.0, wavelengths=wavelength)
    system.surfaces[-1].thickness.add_(shift)
    pupil = torch.tensor([[0.0, 0.3], [0.5, 0.5], [0.0, -1.0]], dtype=F64)
    found = wavefront(system, pupil)
    cosine = (1 - found.cosines[0, 0].square().sum(-1)).sqrt()
    radius = 100.0 + shift
    path = -shift * cosine + ((shift * cosine) ** 2 - shift**2 + radius**2).sqrt()
    expected = (radius - shift - path) / wavelength
    torch.testing.assert_close(found.path[0, 0], expected, atol=1e-7, rtol=0)


@pytest.mark.parametrize("axis", [0, 1])
def test_ray_aberrations_are_the_slopes_of_the_wavefront(axis):
    """W = −∫ε·dd + ε⊥²/2R along a fan off the axis, by Malus and Dupin: paths to a plane change by d·dε."""
    system = optical_system(
        [surface(60.0, thickness=4.0, material=1.5), surface(-80.0, thickness=66.0)],
        aperture=6.0,
        wavelengths=500e-6,
        fields=[(1.0, 3.0)],
    )
    pupil = torch.zeros(401, 2, dtype=F64)
    pupil[:, axis] = torch.linspace(-1, 1, 401, dtype=F64)
    found, landed = wavefront(system, pupil), trace_fields(system, pupil)
    across = torch.stack([landed.x[0, 0] - landed.x[0, 0, 200], landed.y[0, 0] - landed.y[0, 0, 200]], -1)
    slope = -0.5 * ((across[1:] + across[:-1]) * found.cosines[0, 0].diff(dim=0)).sum(-1)
    summed = torch.cat([torch.zeros(1, dtype=F64), slope.cumsum(0)]) / 500e-6
    properties = first_order(system)
    gap = 66.0 - float(properties.exit_pupil_distance)
    radius = math.hypot(gap, float(landed.x[0, 0, 200]), float(landed.y[0, 0, 200]))
    along = (across * torch.stack([landed.u[0, 0], landed.v[0, 0]], -1)).sum(-1)
    expected = summed - summed[200] + (across.square().sum(-1) - along.square()) / (2 * radius * 500e-6)
    assert float(expected.abs().max()) > 0.5
    assert float((found.path[0, 0] - expected).abs().max()) < 1e-4 * float(expected.abs().max())


def test_spherical_aberration_of_a_sphere_mirror():
    """W = y⁴/(4R³) of a sphere of radius R at its paraxial focus; Schroeder, Astronomical Optics (2000), 5.1."""
    radius, aperture, wavelength = 200.0, 10.0, 500e-6
    mirror = optical_system(
        [surface(-radius, thickness=-radius / 2, material="mirror")], aperture, wavelengths=wavelength
    )
    coefficients, _ = zernike_fit(wavefront(mirror), 11)
    expected = (aperture / 2) ** 4 / (4 * radius**3) / wavelength
    assert float(coefficients[0, 0, 10].abs() * 6 * math.sqrt(5)) == pytest.approx(expected, rel=2e-3)


def test_strehl_ratio_out_of_focus_is_a_sinc():
    """(sin πw/πw)² for w waves at the rim, while the peak is on the axis; Born and Wolf (1999), 8.8.2, eq. 26."""
    system = hyperboloid(1000.0, 4.0, wavelengths=500e-6)
    for waves in (0.0, 0.25, 0.4, 0.6):
        with torch.no_grad():
            system.surfaces[-1].thickness.fill_(1 / (1 / 1000.0 - waves * 2 * 500e-6 / 2.0**2))
        expected = float(np.sinc(waves) ** 2)
        for count in (6, 9):
            assert float(strehl_ratio(system, count=count)) == pytest.approx(expected, abs=1e-4)


def test_gaussian_quadrature_of_the_pupil_is_exact():
    """Means of x²ⁱy²ʲ over the unit disc are (2i)!(2j)!/(4ⁱ⁺ʲ i! j! (i + j + 1)!)."""
    for count in (2, 4):
        points, weights = pupil_quadrature(hyperboloid(), count)
        for i in range(2 * count):
            for j in range(2 * count - i):
                f = math.factorial
                exact = f(2 * i) * f(2 * j) / (4 ** (i + j) * f(i) * f(j) * f(i + j + 1))
                mean = float((weights * points[:, 0] ** (2 * i) * points[:, 1] ** (2 * j)).sum())
                assert mean == pytest.approx(exact, rel=1e-12), (count, i, j)


def test_vignetted_pupils_are_weighted_by_area():
    """A pupil of radius 1 cut by a circle of radius 0.8 at a distance of 0.6, with a hole of radius 0.3 about it."""
    size, far, hole = 0.8, 0.6, 0.3
    ring = surface(thickness=1.0, aperture=CircularAperture(radius=10 * size, inner=10 * hole), shift=(0.0, 10 * far))
    lens = surface(phase=IdealLens(100.0), thickness=100.0)
    system = optical_system([surface(thickness=1.0, stop=True), ring, lens], 20.0)
    a, b = (1 + far**2 - size**2) / (2 * far), (size**2 + far**2 - 1) / (2 * far)
    area = math.acos(a) + size**2 * math.acos(b / size) - far * math.sqrt(1 - a * a)
    points, weights = pupil_quadrature(system, 32)
    assert float(weights.sum()) == pytest.approx(area / math.pi - hole**2, abs=5e-4)
    # The centroid along y of what is left, by cells of a fine grid.
    line = (torch.arange(2000, dtype=F64) + 0.5) / 1000 - 1
    x, y = torch.meshgrid(line, line, indexing="xy")
    away = (x * x + (y - far) ** 2).sqrt()
    kept = (x * x + y * y < 1) & (away < size) & (away > hole)
    mean = float((weights[0] * points[0, :, 1]).sum() / weights[0].sum())
    assert mean == pytest.approx(float(y[kept].mean()), abs=1e-3)
    assert float((weights[0] * points[0, :, 0]).sum()) == pytest.approx(0, abs=1e-6)


def test_vignetting_factors_of_a_decentred_aperture():
    """Clear from −0.2 to 1 along y, and at its middle to √(0.8² − 0.2²) along x."""
    ring = surface(thickness=1.0, aperture=CircularAperture(radius=8.0), shift=(0.0, 6.0))
    lens = surface(phase=IdealLens(100.0), thickness=100.0)
    system = optical_system([surface(thickness=1.0, stop=True), ring, lens], 20.0, fields=[0.0, 40.0])
    found = vignetting_factors(system, [0.0])
    expected = torch.tensor([[0.0, 0.4, 1 - math.sqrt(0.6), 0.4]], dtype=F64)
    torch.testing.assert_close(found, expected, atol=1e-6, rtol=0)
    # At 40° the aperture is 0.84 below the middle of the beam's footprint; rays launched with the factors arrive.
    factors = vignetting_factors(system)
    held = optical_system(list(system.surfaces), 20.0, fields=[0.0, 40.0], vignetting_factors=factors.tolist())
    rim = 0.999 * torch.tensor([[0.0, 1.0], [0.0, -1.0], [1.0, 0.0], [-1.0, 0.0]], dtype=F64)
    assert bool(trace_fields(held, rim).arrived.all()) and not bool(
        trace_fields(held, 1.01 * rim).arrived[..., 1:].any()
    )


def test_angles_of_incidence_by_hand():
    """sin i = h/R for rays along the axis; a mirror turned by 10° is met at the angle that it is turned by."""
    lens = optical_system([surface(40.0, thickness=5.0, material=1.5), surface(thickness=70.0)], 20.0)
    found = incidence_angles(lens, "y", 5)
    heights = torch.linspace(-10, 10, 5, dtype=F64)
    torch.testing.assert_close(found.y[0, 0, 0], heights, atol=1e-12, rtol=0)
    expected = torch.rad2deg(torch.arcsin(heights.abs() / 40))
    torch.testing.assert_close(found.angle[0, 0, 0], expected, atol=1e-10, rtol=0)
    # Behind the front the ray is turned by i − i', the plane is met at that angle, the image where it leaves it.
    inner = (torch.arcsin(heights.abs() / 40) - torch.arcsin(heights.abs() / 60)).rad2deg()
    torch.testing.assert_close(found.angle[1, 0, 0], inner, atol=1e-10, rtol=0)
    outer = torch.rad2deg(torch.arcsin(1.5 * torch.sin(torch.deg2rad(inner))))
    torch.testing.assert_close(found.angle[2, 0, 0], outer, atol=1e-10, rtol=0)
    mirror = optical_system([surface(material="mirror", tilt=(10.0, 0.0), thickness=-20.0)], 2.0)
    assert float(incidence_angles(mirror, "y", 3).angle[0, 0, 0, 1]) == pytest.approx(10.0, abs=1e-10)


def test_first_order_rays_keep_their_invariant():
    lens = load_system("double_gauss_f28")
    rays, properties = paraxial_rays(lens), first_order(lens)
    index = lens.prescription().at(lens.reference).index[0]
    invariant = index * (rays.chief_slope * rays.marginal_height - rays.marginal_slope * rays.chief_height)
    torch.testing.assert_close(invariant, invariant[:1].expand_as(invariant), rtol=1e-12, atol=0)
    assert float(rays.marginal_height[0]) == pytest.approx(float(properties.entrance_pupil_diameter) / 2, rel=1e-12)
    gap = lens.surfaces[-1].thickness - properties.image_distance
    image = float(rays.marginal_height[-1] - rays.marginal_slope[-1] * gap)
    assert image == pytest.approx(0, abs=1e-12)


def test_aberration_of_pupil_is_that_of_footprint_at_stop():
    lens = load_system("double_gauss_f28")
    pupil, error = pupil_aberration(lens, count=5)
    found = footprint(lens, lens.stop, "y", 5, vignetting=False).y[lens.reference]
    radius = float(first_order(lens).stop_diameter) / 2
    torch.testing.assert_close(error, found / radius - pupil, atol=1e-12, rtol=0)
    # Aimed at the real pupil there is none.
    real = footprint(lens, lens.stop, "y", 5, vignetting=False, aim="real").y[lens.reference]
    assert float(error.abs().max()) > 0.02 and float((real / radius - pupil).abs().max()) < 1e-9


def test_modulation_over_the_field_is_that_of_each_image():
    """Of a perfect lens Goodman's 2/π(arccos s − s√(1 − s²)), Statistical Optics (2005), eq. 6-32."""
    lens = optical_system([surface(phase=IdealLens(1000.0), thickness=1000.0, stop=True)], 20.0, wavelengths=500e-6)
    cutoff = 0.02 / 500e-6
    found = field_modulation(lens, [0.25 * cutoff, 0.5 * cutoff], samples=128)
    for row, share in enumerate((0.25, 0.5)):
        expected = 2 / math.pi * (math.acos(share) - share * math.sqrt(1 - share**2))
        assert found[:, row, 0].tolist() == pytest.approx([expected] * 2, abs=5e-3)


def test_a_pinhole_has_the_fourth_power_of_the_cosine():
    pinhole = optical_system([surface(thickness=30.0, stop=True)], 0.5, fields=[0.0, 10.0, (20.0, 30.0)])
    tangents = torch.tan(torch.deg2rad(torch.tensor([[0.0, 0.0], [0.0, 10.0], [20.0, 30.0]], dtype=F64)))
    expected = (1 + tangents.square().sum(-1)) ** -2
    torch.testing.assert_close(relative_illumination(pinhole)[0], expected, rtol=1e-12, atol=0)


def test_fields_are_numbers_or_pairs():
    lens = load_system("cooke_triplet")
    pairs = rms_spot(lens, fields=[(0.0, 0.0), (0.0, 14.0)])
    zero, angle = torch.tensor(0.0), torch.tensor(14.0)
    for fields in ([0.0, 14.0], torch.tensor([0.0, 14.0]), [(0.0, 0.0), 14.0], [zero, angle], [(0.0, zero), angle]):
        torch.testing.assert_close(rms_spot(lens, fields=fields), pairs, rtol=0, atol=0)
    lens.fields = Fields([zero, angle]).fields
    torch.testing.assert_close(rms_spot(lens), pairs, rtol=0, atol=0)
    with pytest.raises(ValueError, match="number y or pair"):
        rms_spot(lens, fields=[])
