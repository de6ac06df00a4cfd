"""Spots, fans, distortion and field curvature, optimisation and tolerances."""

import math

import pytest
import torch

from odak.catalog import material
from odak.learn.raytracing.system import (
    Perturbation,
    axial_color,
    best_focus,
    distortion,
    distortion_grid,
    encircled_energy,
    field_curvature,
    first_order,
    footprint,
    huygens_point_spread_function,
    image_figure,
    lateral_color,
    launch,
    lens_report,
    load_system,
    modulation_at,
    optical_system,
    path_fan,
    point_spread_function,
    pupil_quadrature,
    pupil_samples,
    ray_fan,
    relative_illumination,
    rms_spot,
    seidel_figure,
    seidel_sums,
    spot_diagram,
    surface,
    system_from_dict,
    system_to_dict,
    through_focus,
    through_focus_figure,
    through_focus_modulation,
    tolerance,
    tolerance_figure,
    trace,
    trace_fields,
    wavefront,
    wavefront_figure,
)
from odak.raytracing.interfaces import IdealLens

F64 = torch.float64


def test_the_spot_of_a_perfect_lens_out_of_focus_is_its_pupil():
    """A paraboloid: the point at height h lands h·δ/z off, z = f − h²/4f."""
    f, shift = 100.0, 0.5
    mirror = optical_system([surface(-2 * f, conic=-1.0, thickness=-f - shift, material="mirror")], 20.0)
    pupil = pupil_samples("rings", 4)
    height = 10 * pupil.square().sum(-1).sqrt()
    expected = height * shift / (f - height**2 / (4 * f))
    found = spot_diagram(mirror, pupil)
    torch.testing.assert_close((found.x.square() + found.y.square()).sqrt()[0, 0], expected, atol=1e-12, rtol=0)
    assert float(found.rms[0]) == pytest.approx(float(expected.square().mean().sqrt()), rel=1e-10)
    assert float(found.largest[0]) == pytest.approx(float(expected.max()), rel=1e-12)


def test_lost_rays_do_not_count_in_spots():
    system = load_system("cooke_triplet")
    free = spot_diagram(system, reference="chief")
    system.surfaces[0].semi_diameter = 7.0
    cut = spot_diagram(system, reference="chief")
    assert not bool(free.status.any()) and bool(cut.status.any())
    kept = cut.status == 0
    torch.testing.assert_close(cut.y[kept], free.y[kept], atol=1e-15, rtol=0)
    number = kept.sum((0, 2))
    around = torch.where(kept, free.x.square() + free.y.square(), 0.0).sum((0, 2))
    torch.testing.assert_close(cut.rms, (around / number).sqrt())
    system.surfaces[0].semi_diameter = 1e-9
    assert bool(rms_spot(system)[2].isnan())


def test_numbers_at_one_wavelength_give_results_of_that_one():
    """Without dispersion, so that the pupils of all wavelengths are the same."""
    rows = [surface(50.0, thickness=5.0, material=1.6, stop=True), surface(thickness=80.0)]
    lens = optical_system(rows, 6.0, fields=[2.0], wavelengths=[4e-4, 5e-4, 7e-4])
    for place in range(3):
        numbers = lens.prescription().at(place)
        for function in (wavefront, point_spread_function, huygens_point_spread_function):
            every, one = function(lens), function(lens, prescription=numbers)
            for a, b in zip(every[:2], one[:2], strict=True):
                torch.testing.assert_close(a[place], b[0], rtol=1e-8, atol=1e-8)
        spots = spot_diagram(lens, reference="chief", prescription=numbers)
        torch.testing.assert_close(spots.y[0], spot_diagram(lens, reference="chief").y[place])
        assert float(ray_fan(lens, count=3, prescription=numbers)[1][0, 0, 1]) == pytest.approx(0, abs=1e-12)
        assert float(lateral_color(lens, prescription=numbers).abs().max()) == 0.0
    with pytest.raises(ValueError, match="must have wavelengths"):
        wavefront(lens, prescription=lens.prescription([4e-4, 5e-4])._replace(wavelengths=None))


def test_fans_pass_through_the_chief_ray():
    system = load_system("cooke_triplet")
    place, fan = ray_fan(system, "y", 11)
    spots = spot_diagram(system, torch.stack([0 * place, place], -1), reference="chief")
    torch.testing.assert_close(fan, spots.y, atol=1e-14, rtol=0)
    assert not bool(fan[1, :, 5].any())
    with pytest.raises(ValueError, match="count must be odd"):
        ray_fan(system, count=10)


def test_a_pinhole_has_no_distortion_and_a_ball_of_glass_does():
    pinhole = optical_system([surface(thickness=20.0)], 1.0, fields=[0.0, 10.0, (20.0, 30.0)])
    torch.testing.assert_close(distortion(pinhole), torch.zeros(1, 3, dtype=F64), atol=1e-15, rtol=0)
    system = load_system("double_gauss")
    chief = trace_fields(system, torch.zeros(1, 2), fields=[(0.0, 14.0)])
    found = first_order(system)
    # In the paraxial focal plane, the ideal height is f·tan θ.
    system.surfaces[-1].thickness.copy_(found.image_distance)
    ideal = float(found.focal_length) * math.tan(math.radians(14))
    chief = trace_fields(system, torch.zeros(1, 2), fields=[(0.0, 14.0)])
    expected = float(chief.y[1, 0, 0]) / ideal - 1
    assert float(distortion(system)[1, 2]) == pytest.approx(expected, rel=1e-9)


def test_rays_that_stay_parallel_have_no_foci():
    """Planes alone leave no derivative of the directions."""
    plate = optical_system([surface(thickness=5.0, material=1.5), surface(thickness=50.0)], 10.0, fields=[0.0, 10.0])
    for focus in field_curvature(plate):
        assert bool(torch.isinf(focus).all())


def test_field_curvature_is_coddingtons():
    """A stop at the centre of curvature: both foci on the sphere about it (Schwarzschild)."""
    radius = 100.0
    mirror = optical_system(
        [surface(thickness=radius, stop=True), surface(-radius, thickness=-radius / 2, material="mirror")],
        5.0,
        fields=[(0.0, 0.0), (0.0, 10.0)],
    )
    tangential, sagittal = field_curvature(mirror)
    # Along the chief ray the focus is R/2 from the centre, which is R/2 in front of the image plane.
    expected = radius / 2 * math.cos(math.radians(10)) - radius / 2
    assert float(tangential[0, 1]) == pytest.approx(expected, rel=1e-9)
    assert float(sagittal[0, 1]) == pytest.approx(expected, rel=1e-9)
    lens = load_system("cooke_triplet")
    t, s = field_curvature(lens)
    # Two rays a thousandth of the pupil apart cross there.
    pair = trace_fields(lens, torch.tensor([[0.0, -1e-3], [0.0, 1e-3]]), fields=[(0.0, 14.0)])
    slope = (pair.v / pair.w)[1, 0]
    assert float(-(pair.y[1, 0, 1] - pair.y[1, 0, 0]) / (slope[1] - slope[0])) == pytest.approx(
        float(t[1, 1]), rel=1e-5
    )
    assert float(s[1, 0]) == pytest.approx(float(t[1, 0]), rel=1e-9)


def test_real_aiming_fills_the_stop():
    system = load_system("double_gauss")
    radius = float(first_order(system).stop_diameter) / 2
    pupil = pupil_samples("rings", 2)
    for aim, off in (("paraxial", True), ("real", False)):
        at_stop = trace(system, launch(system, pupil, aim=aim), until=system.stop, vignetting=False)
        missed = (at_stop.y[1] - radius * pupil[:, 1]).abs().max()
        assert (float(missed) > 0.1) == off
        assert off or float(missed) < 1e-9 * radius
    curvature = system.vary(curvature=[0])[0]

    def height(value):
        with torch.no_grad():
            curvature.fill_(value)
        return trace_fields(system, pupil, aim="real", fields=[(0.0, 14.0)], vignetting=False).y[1, 0, 5]

    value = float(curvature.detach())
    (gradient,) = torch.autograd.grad(height(value), curvature)
    numerical = (height(value + 1e-7) - height(value - 1e-7)).detach() / 2e-7
    assert float(gradient) == pytest.approx(float(numerical), rel=1e-5)


def test_path_fan_is_the_wavefront_along_a_diameter():
    lens = load_system("cooke_triplet")
    place, path = path_fan(lens, "y", 5)
    points = torch.stack([0 * place, place], -1)
    torch.testing.assert_close(path, wavefront(lens, points).path, atol=1e-12, rtol=0, equal_nan=True)
    with pytest.raises(ValueError, match="count must be odd"):
        path_fan(lens, "y", 4)


def test_lateral_colour_agrees_with_the_third_order_sum():
    """For a small field: transverse lateral colour between the shortest and the longest wavelength."""
    lens = load_system("double_gauss")
    lens.fields = ((0.0, 0.2),)
    lens.surfaces[-1].thickness += 0.379046  # to the paraxial focus
    found = lateral_color(lens)[:, 0]
    assert float(found[lens.reference]) == 0.0
    expected = float(seidel_sums(lens).transverse["LAT"])
    assert float(found[0] - found[2]) == pytest.approx(expected, rel=0.01)


def test_spots_through_focus_are_spots_in_moved_planes():
    lens = load_system("cooke_triplet")
    sizes = through_focus(lens, [-0.2, 0.0, 0.3])
    torch.testing.assert_close(sizes[:, 1], rms_spot(lens), rtol=1e-10, atol=0)
    with torch.no_grad():
        lens.surfaces[-1].thickness += 0.3
    torch.testing.assert_close(sizes[:, 2], rms_spot(lens), rtol=1e-10, atol=0)


def test_encircled_energy_of_the_airy_pattern_and_of_spots():
    """1 − J₀² − J₁² within a radius (Born and Wolf, section 8.5.2); 83.8 % in the first ring, 91.0 % in the second."""
    lens = optical_system([surface(phase=IdealLens(100.0), thickness=100.0)], 2.0, wavelengths=0.5e-3)
    spread = point_spread_function(lens, 64, 1024)
    ring = 0.5e-3 / (2 * 0.01)
    radii, energy = encircled_energy(spread, [1.2197 * ring, 2.2331 * ring])
    assert energy[0, 0].tolist() == pytest.approx([0.8378, 0.9099], abs=1e-3)
    spots = spot_diagram(load_system("cooke_triplet"), "grid", 15)
    radii, energy = encircled_energy(spots)
    assert energy.shape == (3, 100) and torch.allclose(energy[:, -1], torch.ones(3, dtype=torch.float64))
    assert bool((energy.diff(dim=-1) >= 0).all())
    inside = (spots.x[:, 1].square() + spots.y[:, 1].square()).sqrt() <= radii[1, 50]
    assert float(energy[1, 50]) == pytest.approx(float(inside.sum() / torch.isfinite(spots.x[:, 1]).sum()))
    weights = [1.0, 3.0, 0.5]
    weighted = encircled_energy(spots, radii, weights)[1]
    each, arrived = (value.sum(-1).double() for value in (inside, torch.isfinite(spots.x[:, 1])))
    shares = torch.tensor(weights, dtype=torch.float64)
    assert float(weighted[1, 50]) == pytest.approx(float((shares * each).sum() / (shares * arrived).sum()))


@pytest.mark.slow
def test_reports_hold_all_figures(tmp_path):
    lens = load_system("singlet")
    lens_report(lens, tmp_path / "report.html")
    page = (tmp_path / "report.html").read_text()
    for part in (
        "Layout",
        "First order",
        "Prescription",
        "Spots",
        "Ray fans",
        "Modulation",
        "Field curvature",
        "Seidel",
    ):
        assert part in page
    assert page.count("<svg") == 13


def test_axial_colour_is_that_of_a_thin_lens():
    """A thin lens of Abbe number V has foci of F and C light f/V apart."""
    lines = [486.1327e-6, 587.5618e-6, 656.2725e-6]
    rows = [surface(100.0, material="N-BK7"), surface(-100.0, thickness=96.0)]
    lens = optical_system(rows, 1.0, wavelengths=lines)
    found = axial_color(lens, lines)
    length = float(first_order(lens).focal_length)
    assert float(found[2] - found[0]) == pytest.approx(length / material("N-BK7").vd, rel=0.02)
    # Real rays close to the axis cross it there.
    moved = lens.prescription(lines)
    rays = trace(lens, launch(lens, torch.tensor([[0.0, 1e-3]], dtype=F64), prescription=moved), prescription=moved)
    crossing = (-rays.y * rays.w / rays.v)[:, 0, 0]
    torch.testing.assert_close(found, crossing - crossing[1], atol=1e-5, rtol=1e-5)
    torch.testing.assert_close(axial_color(lens, prescription=moved), found)


def test_a_distorted_grid_has_the_distortion_of_its_radii():
    lens = load_system("cooke_triplet")
    ideal, real = distortion_grid(lens, 5)
    assert tuple(ideal.shape) == (5, 5, 2)
    radius = ideal.square().sum(-1).sqrt()
    stretched = ((real - ideal) * ideal).sum(-1) / radius.clamp_min(1e-9).square()
    corner = distortion(lens)[lens.reference, -1]
    for at in ((0, 0), (0, 4), (4, 0), (4, 4)):
        assert float(stretched[at]) == pytest.approx(float(corner), rel=1e-6)
    # The axes are straight, and the grid of ideal points is regular.
    assert float(real[2, :, 1].abs().max()) < 1e-9
    torch.testing.assert_close(ideal[0, 1:, 0] - ideal[0, :-1, 0], (ideal[0, -1:, 0] - ideal[0, :1, 0]).expand(4) / 4)


def test_footprints_are_in_the_frame_of_the_surface():
    """A tilted plate: rays along z meet it at y/cos of the tilt."""
    rows = [surface(thickness=10.0, stop=True), surface(thickness=20.0, tilt=(60.0, 0.0), material=1.5), surface()]
    found = footprint(optical_system(rows, 4.0), 1, torch.tensor([[0.5, 1.0]], dtype=F64))
    assert (float(found.x), float(found.y)) == pytest.approx((1.0, 2.0 / 0.5))
    with pytest.raises(ValueError, match="place"):
        footprint(optical_system(rows, 4.0), 3)


def test_modulation_through_focus_is_that_in_moved_planes():
    lens = load_system("cooke_triplet")
    found = through_focus_modulation(lens, [-0.05, 0.0], 30.0, "x", 40, fields=[(0.0, 14.0)])
    moved = system_from_dict(system_to_dict(lens))
    with torch.no_grad():
        moved.surfaces[-1].thickness -= 0.05
    for place, system in enumerate((moved, lens)):
        image = huygens_point_spread_function(system, 40, 80, fields=[(0.0, 14.0)])
        torch.testing.assert_close(found[..., place], modulation_at(image, 30.0, "x"), rtol=1e-9, atol=1e-12)


def test_figures_show_the_numbers_of_the_analyses():
    lens = load_system("singlet")
    (lines,) = ([line for line in axes.lines if len(line.get_xdata()) == 3] for axes in image_figure(lens, 3).axes[1:2])
    expected = relative_illumination(lens, 8, fields=[(0.0, 0.0), (0.0, 1.0), (0.0, 2.0)])[lens.reference]
    assert lines[0].get_ydata() == pytest.approx(expected.detach().numpy())
    bars = seidel_figure(lens).axes[0].patches
    waves = seidel_sums(lens).seidel / lens.wavelengths[lens.reference]
    assert [bar.get_height() for bar in bars[:3]] == pytest.approx([*waves[0].tolist(), float(waves[0].sum())])
    result = tolerance(lens, [Perturbation("thickness", 1, 0.2)], 20)
    axes = tolerance_figure(lens, result, 0.1).axes[0]
    assert axes.get_title().startswith(f"yield {100 * float(result.yield_within(0.1)):.0f} %")
    assert axes.lines[0].get_xdata() == pytest.approx(1000 * result.merit[:, 0].detach().sort().values.numpy())
    shown = wavefront_figure(lens, 16).axes[0].images[0].get_array()
    assert float(shown[8, 16]) == pytest.approx(float(wavefront(lens, "x", 3).path[lens.reference, 0, -1]), abs=1e-9)
    places = through_focus_figure(lens, [-1.0, 0.0, 1.0]).axes
    sizes = next(axes for axes in places if axes.get_ylabel().startswith("RMS")).lines[0].get_ydata()
    assert sizes[1] == pytest.approx(1000 * float(rms_spot(lens, "rings", 5)[0]))


@pytest.mark.parametrize("quadrature", [False, True])
def test_foci_and_energies_of_weighted_rays_are_those_of_the_whole_pupil(quadrature):
    """A slow sphere: rays land at k·r³, focus at z = L·r², so that best focus is 2L/3, and r³ holds an energy r²."""
    mirror = optical_system([surface(-2000.0, thickness=-1000.0, material="mirror")], 20.0)
    pupil = pupil_quadrature(mirror, 30) if quadrature else "gauss"
    edge, length = 10.0**3 / (2 * 2000.0**2), 10.0**2 / (4 * 2000.0)
    assert abs(float(through_focus(mirror, [0.0], pupil, 30)) / (edge / 2) - 1) < 1e-4
    assert abs(float(best_focus(mirror, pupil, 30)) / (2 * length / 3) - 1) < 1e-4
    energy = encircled_energy(spot_diagram(mirror, pupil, 30), [0.2 * edge, 0.6 * edge])[1][0]
    assert abs(energy - torch.tensor([0.2, 0.6]) ** (2 / 3)).max() < 0.03


def test_best_focus_is_the_least_of_the_spots():
    from scipy.optimize import minimize_scalar

    lens = load_system("double_gauss")
    found = float(best_focus(lens))

    def size(shift):
        return float(through_focus(lens, [shift]).square().mean())

    assert abs(found - minimize_scalar(size, bounds=(-1, 1), method="bounded", options={"xatol": 1e-9}).x) < 1e-7
    # A thin parabola's focus is its focal plane; a shift of the image by any distance is found.
    for off in (-3.0, 0.4):
        parabola = surface(radius=-200.0, conic=-1.0, thickness=-100.0 - off, material="mirror")
        assert abs(float(best_focus(optical_system([parabola], aperture=20.0))) - off) < 1e-9
