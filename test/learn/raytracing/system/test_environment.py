"""Systems at other temperatures and in vacuum, against closed forms; gradients by the temperature."""

from dataclasses import replace

import pytest
import torch

from odak import AccuracyWarning
from odak.catalog import material, model_glass, refractive_index
from odak.catalog.materials import thermal_of
from odak.learn.raytracing.system import (
    Operand,
    Variable,
    axial_color,
    configurations,
    coordinate_break,
    first_order,
    in_environment,
    load_system,
    optical_system,
    read_zmx,
    rms_spot,
    standard_design,
    surface,
    system_from_dict,
    system_to_dict,
    trace,
    trace_fields,
    write_zmx,
    zoom_design,
)
from odak.raytracing import OddAsphere, Toroid


def singlet(**last):
    return optical_system([surface(100.0, thickness=0.001, material="N-BK7"), surface(-100.0, **last)], 10.0)


def thermal_coefficient(glass, change=1.0):
    """Return α − dn/dT/(n − 1) of a thin lens in air."""
    low, high = (refractive_index(glass, 587.5618e-9, medium="air", temperature=t) for t in (20.0, 20.0 + change))
    return 7.1e-6 - (high - low) / change / (low - 1)


def test_thermal_focal_length_changes_as_the_coefficient_says():
    lens = singlet()
    cold, warm = (float(first_order(in_environment(lens, t)).focal_length) for t in (20.0, 30.0))
    assert cold == pytest.approx(float(first_order(lens).focal_length), rel=1e-12)
    assert (warm / cold - 1) / 10 == pytest.approx(thermal_coefficient("N-BK7", 10.0), rel=1e-4)


def test_mount_of_coefficient_of_lens_keeps_image_in_place():
    """Passive athermalisation: the mount grows as the focal length does."""
    lens = singlet()
    behind = float(first_order(lens).image_distance)
    for mount, moves in ((thermal_coefficient("N-BK7", 40.0), False), (23.6e-6, True)):
        warm = in_environment(singlet(thickness=behind), 60.0, mount=mount)
        defocus = float(first_order(warm).image_distance - warm.surfaces[-1].thickness)
        expected = behind * (thermal_coefficient("N-BK7", 40.0) - mount) * 40
        assert defocus == pytest.approx(expected, abs=2e-5)
        assert (abs(defocus) > 0.05) == moves


VISIBLE = (486.1327e-9, 587.5618e-9, 656.2725e-9)


def doublet(first, second, lines=VISIBLE):
    """Return a thin achromat of f = 100 whose focus is on its image plane, and what its focus is to do per kelvin.

    T. H. Jamieson, Opt. Eng. 20, 156 (1981): powers φ of a sum 1/f and a sum of φ/V of 0 expand by f·Σφγ.
    """
    indices = [[float(refractive_index(g, line, medium="air")) for line in lines] for g in (first, second)]
    numbers = [(middle - 1) / (blue - red) for blue, middle, red in indices]
    powers = [numbers[0] / (numbers[0] - numbers[1]) / 100, numbers[1] / (numbers[1] - numbers[0]) / 100]
    bends = [power / (n[1] - 1) / 2 for power, n in zip(powers, indices, strict=True)]

    def lens(behind):
        rows = [(bends[0], 1e-6, first), (-bends[0], 1e-6, "air"), (bends[1], 1e-6, second), (-bends[1], behind, "air")]
        items = [surface(curvature=c, thickness=t, material=m) for c, t, m in rows]
        return optical_system(items, 10.0, wavelengths=[1e3 * line for line in lines])

    grows = 0.0
    for power, glass, (_, middle, _) in zip(powers, (first, second), indices, strict=True):
        low, high = (float(refractive_index(glass, lines[1], medium="air", temperature=t)) for t in (10.0, 30.0))
        grows += 100 * power * (thermal_of(material(glass))[1] - (high - low) / 20 / (middle - 1))
    return lens(float(first_order(lens(100.0)).image_distance)), grows


MIDDLE_INFRARED = (3e-6, 4e-6, 5e-6)


@pytest.mark.parametrize(
    ("pair", "lines", "bounds"),
    [
        (("FK5HTi", "SF11"), VISIBLE, (0.0, 2e-4)),
        (("N-BK7", "SF2"), VISIBLE, (5e-3, 1.0)),
        # The usual achromat of the middle infrared moves by a tenth of a millimetre, where 0.02 mm is in focus at f/2.
        (("silicon", "germanium"), MIDDLE_INFRARED, (0.04, 0.06)),
        (("IRG27", "CaF2"), MIDDLE_INFRARED, (0.0, 5e-3)),
    ],
)
def test_an_achromat_of_two_glasses_is_athermal_in_aluminium(pair, lines, bounds):
    lens, grows = doublet(*pair, lines)
    for temperature in (10.0, 30.0):
        warm = in_environment(lens, temperature, mount=23.6e-6)
        defocus = float(first_order(warm).image_distance - warm.surfaces[-1].thickness)
        expected = (temperature - 20) * 100 * (grows - 23.6e-6)
        assert defocus == pytest.approx(expected, rel=5e-3, abs=1e-4)
        assert bounds[0] <= abs(defocus) < bounds[1]
    blue, red = axial_color(lens, [1e3 * lines[0], 1e3 * lines[-1]]).tolist()
    assert blue == pytest.approx(red, abs=1e-3)


def test_a_telescope_of_one_material_only_grows():
    mirrors = [surface(-200.0, thickness=-70.0, material="mirror", semi_diameter=20.0)]
    mirrors += [surface(-80.0, thickness=90.0, material="mirror", semi_diameter=8.0)]
    telescope = optical_system(mirrors, 40.0)
    warm = in_environment(telescope, 70.0, mount=23.6e-6, mirror=23.6e-6)
    scale = 1 + 23.6e-6 * 50
    first, second = first_order(telescope), first_order(warm)
    assert float(second.focal_length / first.focal_length) == pytest.approx(scale, rel=1e-12)
    assert [float(item.thickness) for item in warm.surfaces] == pytest.approx([-70 * scale, 90 * scale], rel=1e-7)


def test_a_lens_in_vacuum_has_the_index_in_vacuum():
    lens = load_system("singlet")
    empty = in_environment(lens, 20.0, 0.0)
    glass = lens.surfaces[0].material
    index = empty.prescription().index[:, 1]
    wanted = [refractive_index(glass, w, "mm", "vacuum", temperature=20.0) for w in lens.wavelengths]
    assert index.tolist() == pytest.approx(wanted, rel=1e-15)
    assert bool((index > lens.prescription().index[:, 1] + 2e-4).all())


def test_coefficients_and_gaps_grow_with_the_lens():
    front = surface(50.0, coefficients=[0.0, 1e-6], thickness=4.0, material="N-BK7", semi_diameter=10.0)
    back = surface(-50.0, thickness=3.0, semi_diameter=10.0)
    third = surface(-80.0, thickness=2.0, material="N-SF6", semi_diameter=10.0)
    lens = optical_system([front, back, third, surface(thickness=50.0)], 10.0)
    warm = in_environment(lens, 120.0, mount=20e-6)
    glass, other = 1 + 7.1e-4, 1 + thermal_of(material("N-SF6"))[1] * 100
    assert float(warm.surfaces[0].coefficients[1]) == pytest.approx(1e-6 / glass**3, rel=1e-12)
    assert float(warm.surfaces[0].radius) == pytest.approx(50 * glass, rel=1e-12)
    assert float(warm.surfaces[0].thickness) == pytest.approx(4 * glass, rel=1e-12)
    assert float(warm.surfaces[2].radius) == pytest.approx(-80 * other)

    def rim(item):
        place = torch.tensor([item.semi_diameter], dtype=torch.float64)
        return float(item.shape.sag(0 * place, place).height)

    edges = [
        float(system.surfaces[1].thickness) + rim(system.surfaces[2]) - rim(system.surfaces[1])
        for system in (lens, warm)
    ]
    assert edges[1] == pytest.approx(edges[0] * (1 + 20e-4), rel=1e-10)


def test_focal_length_has_gradient_by_temperature_and_curvature():
    lens = singlet()
    bend = lens.vary(curvature=0)[0]

    def focal(temperature):
        return first_order(in_environment(lens, temperature, 9e4)).focal_length

    warm = torch.tensor(35.0, dtype=torch.float64, requires_grad=True)
    slope, by_bend = torch.autograd.grad(focal(warm), [warm, bend])
    assert float(slope) == pytest.approx((focal(35.5) - focal(34.5)).item(), rel=1e-4)
    assert float(by_bend) != 0


def test_what_is_not_known_is_said():
    lens = optical_system([surface(50.0, thickness=3.0, material="Optorez 1330"), surface(-50.0)], 5.0)
    with pytest.warns(AccuracyWarning, match="expansion or dn/dT of Optorez 1330 is not known"):
        in_environment(lens, 40.0)
    with pytest.raises(ValueError, match=r"surfaces\[0\] is a Toroid"):
        in_environment(optical_system([surface(shape=Toroid(0.01, 0.02)), coordinate_break()], 5.0), 40.0)


def test_an_immersed_sphere_is_aplanatic():
    """Abbe: an object at R/n from the centre of a sphere has a sharp virtual image at n·R, magnified n² times."""
    n, radius = 1.515, 5.0
    sphere = surface(-radius, thickness=-radius * (1 + n))
    lens = optical_system(
        [sphere], 1.2, "NA", object_distance=radius * (1 + 1 / n), object_material=n, fields=[0.0, 0.01]
    )
    found = first_order(lens)
    assert float(found.magnification) == pytest.approx(n**2, rel=1e-12)
    assert float(found.image_distance) == pytest.approx(-radius * (1 + n), rel=1e-12)
    with torch.no_grad():
        place = trace_fields(lens, "rings", 4)
    assert bool(place.arrived.all())
    # Slopes up to that of the marginal ray, n·sin u = 1.2: sharp on the axis.
    assert float(torch.stack([place.x, place.y])[..., 0, :].abs().max()) < 1e-10
    with pytest.raises(ValueError, match=r"aperture must be below 1\.515"):
        optical_system([sphere], 1.6, "NA", object_distance=5.0, object_material=n)


def test_an_eye_under_water_loses_the_power_of_its_cornea():
    cornea = surface(7.8, thickness=24.0, material=1.336)
    dry, wet = (first_order(optical_system([cornea], 3.0, object_material=m)) for m in ("air", "water"))
    water = float(refractive_index("water", 587.5618e-9, medium="air"))
    assert float(1 / dry.focal_length) == pytest.approx(0.336 / 7.8, rel=1e-12)
    assert float(1 / wet.focal_length) == pytest.approx((1.336 - water) / 7.8, rel=1e-9)


WEATHERS = ((-20.0, 1e5), (20.0, 101325.0), (60.0, 0.0))
SETTINGS = [
    ("temperature", None, [t for t, _ in WEATHERS]),
    ("pressure", None, [p for _, p in WEATHERS]),
    ("mount", None, [23.6e-6] * 3),
]


def same(first, second, within=0.0):
    """Compare the numbers of two prescriptions."""
    pairs = [(a, b) for a, b in zip(first, second, strict=True) if isinstance(a, torch.Tensor)]
    assert len(pairs) >= 5
    assert all(torch.allclose(a, b, rtol=within, atol=0) for a, b in pairs)


def one_by_one(lens):
    return [in_environment(lens, t, p, mount=23.6e-6) for t, p in WEATHERS]


def test_configurations_of_temperatures_are_the_systems_one_by_one():
    lens = load_system("cooke_triplet")
    zoom, alone = configurations(lens, SETTINGS), one_by_one(lens)
    together = zoom.prescription()
    for i, system in enumerate(alone):
        same([v[i] if isinstance(v, torch.Tensor) and v.ndim > 1 else v for v in together], system.prescription())
    with torch.no_grad():
        traced = trace_fields(lens, "rings", 3, prescription=together, vignetting=False)
        parts = [trace_fields(system, "rings", 3, vignetting=False) for system in alone]
        assert torch.allclose(traced.y, torch.stack([part.y for part in parts]), rtol=0, atol=1e-12)
        assert zoom.each(rms_spot).tolist() == torch.stack([rms_spot(system) for system in alone]).tolist()


def test_temperatures_at_once_are_those_of_a_thin_athermal_achromat():
    """Jamieson's sum of φγ, and its slope by the temperature and the mount, of the whole batch."""
    lens, grows = doublet("N-BK7", "SF2")
    temperatures = [10.0, 20.0, 30.0]
    zoom = configurations(lens, [("temperature", None, temperatures), ("mount", None, [23.6e-6] * 3)])
    warm, mount = zoom.vary("temperature"), zoom.vary("mount")
    numbers = zoom.prescription()
    defocus = first_order(lens, prescription=numbers).image_distance - numbers.thickness[:, -1]
    rate = 100 * (grows - 23.6e-6)
    assert defocus.tolist() == pytest.approx([rate * (t - 20) for t in temperatures], rel=5e-3, abs=1e-4)
    slopes = torch.autograd.grad(defocus.sum(), [warm, mount])
    assert slopes[0].tolist() == pytest.approx([rate] * 3, rel=2e-2)
    assert slopes[1].tolist() == pytest.approx([-100 * (t - 20) for t in temperatures], rel=1e-3, abs=1e-9)
    assert zoom.settings[0] == ("temperature", None, tuple(temperatures))


def test_temperatures_travel_in_files(tmp_path):
    lens = load_system("cooke_triplet")
    wanted = configurations(lens, SETTINGS)
    lens.settings = wanted.settings
    assert system_from_dict(system_to_dict(lens)).settings == lens.settings
    write_zmx(lens, tmp_path / "warm.zmx")
    again, report = read_zmx(tmp_path / "warm.zmx")
    assert not [note for note in report.notes if "not used" in note]
    same(configurations(again).prescription(), wanted.prescription())
    # Their glasses are at the temperature there, and stay so in the package's own files.
    third = system_from_dict(system_to_dict(again))
    same(configurations(third).prescription(), wanted.prescription())
    same(system_from_dict(system_to_dict(wanted.view(0))).prescription(), wanted.view(0).prescription(), 1e-15)


def test_operands_of_temperature_and_pressure_change_indices_only(tmp_path):
    lines = "VERS 1\nMODE SEQ\nUNIT MM X\nGCAT SCHOTT\nENPD 10\nFTYP 0 0 1 1 0 0 0\nWAVM 1 0.5875618 1\nPWAV 1\n"
    for i, medium in enumerate((None, "GLAS N-SF6 0 0", None, None)):
        thickness = ("INFINITY", "3", "50", "0")[i]
        lines += f"SURF {i}\n  TYPE STANDARD\n  CURV {0.01 if i == 1 else 0.0}\n  DISZ {thickness}\n"
        lines += f"  {medium}\n" if medium else ""
    lines += "MNUM 2 1\nTEMP 0 1 20 0 0 0 1 1 1 0 0\nTEMP 0 2 80 0 0 0 1 1 1 0 0\nPRES 0 2 0.5 0 0 0 1 1 1 0 0\n"
    (tmp_path / "lens.zmx").write_text(lines)
    found = configurations(read_zmx(tmp_path / "lens.zmx")[0]).prescription()
    expected = [
        refractive_index("N-SF6", 587.5618e-9, medium="air", temperature=t, pressure=101325.0 * p)
        for t, p in ((20.0, 1.0), (80.0, 0.5))
    ]
    assert found.index[:, 0, 1].tolist() == pytest.approx(expected, rel=1e-15)
    assert found.thickness.tolist() == [[3.0, 50.0]] * 2
    assert found.curvature.tolist() == [[0.01, 0.0]] * 2


def test_a_design_of_several_temperatures_varies_the_cold_numbers():
    lens = load_system("cooke_triplet")
    lens.surfaces[0].semi_diameter = lens.surfaces[1].semi_diameter = lens.surfaces[2].semi_diameter = 9.0
    bends = [float(lens.surfaces[i].curvature) for i in (0, 5)]
    zoom = configurations(lens, SETTINGS)
    variables = [Variable("curvature", [0, 5]), Variable("thickness", -1)]
    design = zoom_design(zoom, [Operand("spot")], variables, count=2)
    assert design.values[:2].tolist() == bends
    values = design.values * torch.tensor([1.001, 0.999, 1.0], dtype=torch.float64)
    numbers = design.prescription(values)
    design.apply(values)
    assert [float(lens.surfaces[i].curvature) for i in (0, 5)] == values[:2].tolist()
    for i, system in enumerate(one_by_one(lens)):
        own = system.prescription()
        for name in ("curvature", "thickness", "index"):
            assert torch.allclose(getattr(numbers, name)[i], getattr(own, name), rtol=1e-14, atol=1e-15)


def test_a_standard_design_counts_the_spots_at_each_temperature():
    """The merit is that of lenses in each environment, the focal length is held at 20 °C by a shared curvature."""
    lens, places = load_system("cooke_triplet"), (-20.0, 60.0)
    focal_length = float(first_order(lens).focal_length)
    design = standard_design(lens, temperatures=places, mount=23.6e-6)
    values = design.values.clone()
    values[design.columns["curvature"][0]] *= 1.0005
    design.apply(values)
    assert float(first_order(lens).focal_length) == pytest.approx(focal_length, rel=1e-12)
    spots = [row[1] for row in design.report() if row[0].kind == "spot"]
    assert len(spots) == 2
    for own, degrees in zip(spots, places, strict=True):
        warm = in_environment(lens, degrees, mount=23.6e-6)
        alone = standard_design(warm, float(first_order(warm).focal_length))
        (other,) = (row[1] for row in alone.report() if row[0].kind == "spot")
        assert torch.allclose(own, other, rtol=1e-7, atol=1e-12)
    assert not torch.allclose(spots[0], spots[1], rtol=1e-2)
    with pytest.raises(ValueError, match="variables must not be glasses"):
        standard_design(load_system("cooke_triplet"), makers=["schott"], temperatures=places)


@pytest.mark.slow
def test_a_design_over_temperatures_is_better_over_them():
    """Of a lens in aluminium, whose focus moves to either side, the worst of the spots becomes smaller."""

    def worst(temperatures):
        lens = load_system("cooke_triplet")
        standard_design(lens, temperatures=temperatures, mount=60e-6).optimise(5)
        warm = [in_environment(lens, degrees, mount=60e-6) for degrees in (0.0, 60.0)]
        return max(float(rms_spot(item, "rings", 4, vignetting=False).square().mean().sqrt()) for item in warm)

    # At 20 °C alone the focus is sharp there; between 0 and 60 °C it belongs at 30 °C.
    assert worst([0.0, 60.0]) < 0.95 * worst(None)


def test_settings_of_temperatures_are_checked():
    lens = load_system("cooke_triplet")
    with pytest.raises(ValueError, match=r"temperature in settings must be between -273 and 1000, got -300"):
        configurations(lens, [("temperature", None, [-300.0])])
    with pytest.raises(ValueError, match="place in settings must be None for mount"):
        configurations(lens, [("mount", 1, [0.0])])
    zoom = configurations(lens, SETTINGS)
    with pytest.raises(ValueError, match="name must be among the settings, got mirror; the settings have temperature"):
        zoom.vary("mirror")
    with pytest.raises(ValueError, match="variables must not be glasses"):
        zoom_design(zoom, ["spot"], Variable("glass", 0))
    unknown = optical_system([surface(50.0, thickness=3.0, material="Optorez 1330"), surface(-50.0)], 5.0)
    with pytest.warns(AccuracyWarning, match="expansion or dn/dT of Optorez 1330 is not known") as told:
        configurations(unknown, [("temperature", None, [0.0, 40.0])]).prescription()
    assert len(told) == 1
    bent = optical_system([surface(50.0, coefficients=[1e-6], thickness=3.0, material="N-BK7"), surface()], 5.0)
    bent.settings = (("temperature", None, (0.0, 40.0)),)
    with pytest.raises(ValueError, match=r"settings of temperatures change the coefficients of surfaces\[0\]"):
        write_zmx(bent, "never.zmx")


# US patent 7,535,658 as the documentation of Ray Optics states it: radius, conic constant + 1, coefficients of r³ to
# r¹⁰, distance to the next, and the index and Abbe number behind.
TELEPHONE = (
    (1.962, 2.153, "-1.895e-2 2.426e-2 -5.123e-2 8.371e-4 7.850e-3 4.091e-3 -7.732e-3 -4.265e-3", 1.19, (1.471, 76.6)),
    (33.398, 40.18, "-4.966e-3 -1.434e-2 -6.139e-3 -9.284e-5 6.438e-3 -5.72e-3 -2.385e-2 1.108e-2", 0.93, None),
    (-2.182, 2.105, "-4.388e-2 -2.555e-2 5.16e-2 -4.307e-2 -2.831e-2 3.162e-2 4.63e-2 -4.877e-2", 0.75, (1.603, 27.5)),
    (-6.367, 3.382, "-1.131e-1 -7.863e-2 1.094e-1 6.228e-3 -2.216e-2 -5.89e-3 4.123e-3 1.041e-3", 0.1, None),
    (5.694, -221.1, "-7.876e-2 7.02e-2 1.575e-3 -9.958e-3 -7.322e-3 6.914e-4 2.54e-3 -7.65e-4", 0.89, (1.51, 56.2)),
    (9.192, 0.9331, "9.694e-3 -2.516e-3 -3.606e-3 -2.497e-4 -6.84e-4 -1.414e-4 2.932e-4 -7.284e-5", 0.16, None),
    (1.674, -7.617, "7.429e-2 -6.933e-2 -5.811e-3 2.396e-3 2.1e-3 -3.119e-4 -5.552e-5 7.969e-6", 0.85, (1.51, 56.2)),
    (1.509, -2.707, "1.767e-3 -4.652e-2 1.625e-2 -3.522e-3 -7.106e-4 3.825e-4 6.271e-5 -2.631e-5", 0.7, None),
)
LIKE = {1.471: "N-PK52A", 1.603: "OKP4", 1.51: "Zeonex 480R", 1.516: "N-BK7"}


def telephone_lens(glass=lambda n, v: model_glass(n, v, like=LIKE[n])):
    items = [surface(stop=True)]
    for radius, bend, given, gap, medium in TELEPHONE:
        shape = OddAsphere(1 / radius, bend - 1, [0.0, 0.0, *map(float, given.split())])
        items.append(surface(shape=shape, thickness=gap, material=glass(*medium) if medium else "air"))
    items += [surface(thickness=0.4, material=glass(1.516, 64.1)), surface(thickness=0.64)]
    return optical_system(items, 5.555 / 3.5, wavelengths=[587.5618e-6])


def test_a_published_telephone_lens_has_its_published_focus_and_rays():
    lens = telephone_lens()
    found = first_order(lens)
    assert float(found.focal_length) == pytest.approx(5.555, abs=5e-4)
    assert float(found.image_distance) == pytest.approx(0.5678, abs=5e-5)
    # The marginal ray at y = 1 and the chief ray of 24° in the image, as printed by Ray Optics.
    rays = torch.tensor([[[0.0, 1, 0], [0, 0, 1]], [[0, 0, 0], [0, 0.406953, 0.913449]]], dtype=torch.float64)
    traced = trace(lens, rays)
    assert traced.y.flatten().tolist() == pytest.approx([-0.02573, 2.56912], abs=1e-5)
    assert traced.v.flatten().tolist() == pytest.approx([-0.185004, 0.436135], abs=1e-6)


@pytest.mark.parametrize("warmth", [-40.0, 40.0])
def test_a_plastic_lens_of_odd_aspheres_expands_as_a_paraxial_ray_says(warmth):
    """Against radii, lengths and indices that are warmed here, and a ray traced here."""
    lens, mount = telephone_lens(), 7e-5
    warm = in_environment(lens, 20 + warmth, mount=mount)
    height, slope, index = 1.0, 0.0, 1.0
    for radius, _, _, gap, medium in (*TELEPHONE, (1e99, 1.0, "", 0.4, (1.516, 64.1)), (1e99, 1.0, "", 0.64, None)):
        if medium:
            like = material(LIKE[medium[0]])
            expansion = thermal_of(like)[1]
        n = 1.0
        if medium:
            glass = replace(model_glass(*medium), thermal=thermal_of(like)[0])
            n = float(refractive_index(glass, 587.5618e-9, medium="air", temperature=20 + warmth))
        slope, index = slope - height * (n - index) / (radius * (1 + expansion * warmth)), n
        end = height, slope
        height += slope / n * gap * (1 + (expansion if medium else mount) * warmth)
    found = first_order(warm)
    assert float(found.focal_length) == pytest.approx(-1 / end[1], rel=1e-12)
    assert float(found.image_distance) == pytest.approx(-end[0] / end[1], rel=1e-12)
    # Marginal rays as well: a surface of one material is the cold one, enlarged, to any height.
    cold, hot, scale = lens.surfaces[7].shape, warm.surfaces[7].shape, 1 + 7e-5 * warmth
    x, y = torch.tensor([0.3, 1.1]), torch.tensor([0.4, 0.7])
    expected = scale * cold.sag(x.double(), y.double()).height
    assert hot.sag(scale * x.double(), scale * y.double()).height.tolist() == pytest.approx(
        expected.tolist(), rel=1e-12
    )


def test_the_temperature_of_odd_aspheres_has_a_gradient_and_is_a_setting():
    lens = telephone_lens()
    degrees = torch.tensor(30.0, dtype=torch.float64, requires_grad=True)
    coefficients = lens.surfaces[1].vary("coefficients")

    def height(t):
        rays = torch.tensor([[[0.0, 0.7, 0], [0, 0, 1]]], dtype=torch.float64)
        return trace(in_environment(lens, t, mount=7e-5), rays).y.sum()

    slope, by_shape = torch.autograd.grad(height(degrees), [degrees, coefficients])
    assert float(slope) == pytest.approx((height(31.0) - height(29.0)).item() / 2, rel=1e-3)
    assert bool((by_shape[2:] != 0).all())
    zoom = configurations(telephone_lens(), [("temperature", None, [-20.0, 60.0]), ("mount", None, [7e-5] * 2)])
    focal = first_order(zoom.system, prescription=zoom.prescription()).focal_length
    each = [float(first_order(in_environment(lens, t, mount=7e-5)).focal_length.detach()) for t in (-20.0, 60.0)]
    assert focal.tolist() == pytest.approx(each, rel=1e-12)
    rays = torch.tensor([[0.0, 0.7, 0], [0, 0, 1]], dtype=torch.float64)
    found = trace(zoom.system, rays, prescription=zoom.prescription()).y.flatten()
    each = [trace(in_environment(lens, t, mount=7e-5), rays).y.item() for t in (-20.0, 60.0)]
    assert found.tolist() == pytest.approx(each, abs=1e-12)


def test_media_without_thermal_data_are_named():
    with pytest.warns(
        AccuracyWarning, match=r"dn/dT of model 1.51 56.2, the index 1.6 is not known.*model_glass `like`"
    ):
        in_environment(
            optical_system(
                [surface(9.0, thickness=1.0, material=model_glass(1.51, 56.2)), surface(5.0, material=1.6)], 1.0
            ),
            40.0,
        )
    with pytest.raises(ValueError, match="like must be a material whose expansion and dn/dT are known, got Optorez"):
        model_glass(1.51, 56.2, like="Optorez 1330")
