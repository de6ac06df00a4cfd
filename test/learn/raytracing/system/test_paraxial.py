"""First-order properties: closed forms, published focal lengths, invariants, rays close to the axis."""

import math

import pytest
import torch

from odak.catalog import refractive_index
from odak.learn.raytracing.system import (
    best_focus,
    distortion,
    distortion_grid,
    first_order,
    load_system,
    optical_system,
    rms_spot,
    sample_systems,
    seidel_sums,
    surface,
    trace_fields,
)
from odak.raytracing import Toroid
from odak.raytracing.surfaces import Biconic

F64 = torch.float64


@pytest.mark.parametrize("thickness", [1e-9, 4.0])
def test_focal_length_is_the_lensmakers(thickness):
    front, rear, name = 60.0, -45.0, "N-BK7"
    n = refractive_index(name, 0.0005875618, unit="mm", medium="air")
    lens = optical_system(
        [surface(front, thickness=thickness, material=name), surface(rear, thickness=50)], aperture=10.0
    )
    power = (n - 1) * (1 / front - 1 / rear + (n - 1) * thickness / (n * front * rear))
    found = first_order(lens)
    assert float(found.focal_length) == pytest.approx(1 / power, rel=1e-12)
    assert float(found.back_focal_distance) == pytest.approx((1 - (n - 1) * thickness / (n * front)) / power, rel=1e-12)
    assert float(found.rear_principal_plane) == pytest.approx(-(n - 1) * thickness / (n * front * power), abs=1e-12)
    assert float(found.f_number) == pytest.approx(0.1 / power, rel=1e-12)


@pytest.mark.parametrize(
    ("name", "focal_length", "f_number"), [("cooke_triplet", 50.0, 4.0), ("double_gauss", 100.0, 2.0)]
)
def test_published_lenses_have_their_focal_length_and_f_number(name, focal_length, f_number):
    found = first_order(load_system(name))
    assert float(found.focal_length) == pytest.approx(focal_length, rel=5e-4)
    assert float(found.f_number) == pytest.approx(f_number, rel=5e-4)


@pytest.mark.parametrize("name", sample_systems())
def test_rays_close_to_the_axis_agree(name):
    """Real rays through a pupil a millionth as wide pass the paraxial focus and pupils."""
    system = load_system(name)
    system.aperture *= 1e-6
    found = first_order(system)
    system.surfaces[-1].thickness.copy_(found.image_distance)
    system.wavelengths, system.reference = (system.wavelengths[system.reference],), 0
    traced = trace_fields(system, "y", 3, fields=[(0.0, 0.0), (0.0, 1e-5)])
    radius = float(found.entrance_pupil_diameter) / 2
    assert float((traced.y[0, 0, 2] / radius).abs()) < 1e-8
    assert float(traced.y[0, 1, 1]) == pytest.approx(float(found.focal_length) * math.radians(1e-5), rel=1e-8)
    slope = (traced.v / traced.w)[0]
    assert float(slope[0, 2].abs() * 2 * found.working_f_number) == pytest.approx(1, rel=1e-8)
    # The chief ray comes from the exit pupil's centre.
    back = traced.y[0, 1, 1] / slope[1, 1]
    assert float(found.image_distance - back) == pytest.approx(float(found.exit_pupil_distance), rel=1e-7, abs=1e-6)


def test_a_near_object_and_its_image():
    lens = optical_system(
        [surface(curvature=0.02, thickness=1e-9, material=1.5), surface(curvature=-0.02, thickness=100.0)],
        aperture=0.05,
        aperture_type="NA",
        object_distance=100.0,
        fields=[1.0],
    )
    found = first_order(lens)
    assert float(found.focal_length) == pytest.approx(50, rel=1e-9)
    assert float(found.image_distance) == pytest.approx(100, rel=1e-8)
    assert float(found.magnification) == pytest.approx(-1, rel=1e-8)
    assert float(found.numerical_aperture) == pytest.approx(0.05, rel=1e-7)
    assert float(found.entrance_pupil_diameter) == pytest.approx(200 * math.tan(math.asin(0.05)), rel=1e-9)


def test_mirrors_converge_light_backwards():
    mirror = optical_system([surface(-100.0, thickness=-50.0, material="mirror")], aperture=10.0)
    found = first_order(mirror)
    assert (float(found.focal_length), float(found.back_focal_distance)) == (50.0, -50.0)
    # A Ritchey-Chrétien: f = f1·f2/(f1 + f2 − d), Schroeder, Astronomical Optics (2000), table 2.1.
    f1, f2, gap = 5520.0, -679.0, 4906.071
    pair = optical_system(
        [surface(-2 * f1, thickness=-gap, material="mirror"), surface(2 * f2, thickness=6000.0, material="mirror")],
        aperture=2400.0,
    )
    assert float(first_order(pair).focal_length) == pytest.approx(f1 * f2 / (f1 + f2 - gap), rel=1e-12)


def test_the_first_aspheric_term_has_power():
    """z = a₁r² on a plane is a paraboloid of radius 1/(2a₁)."""
    mirror = optical_system([surface(coefficients=[-1 / 400.0], thickness=-100.0, material="mirror")], 10.0)
    assert float(first_order(mirror).focal_length) == pytest.approx(100, rel=1e-14)


def test_the_four_ways_to_give_an_aperture_agree():
    system = load_system("cooke_triplet")
    found = first_order(system)
    sizes = {
        "F-number": found.f_number,
        "NA": found.entrance_pupil_diameter / 2 / found.focal_length,
        "stop": found.stop_diameter,
    }
    for kind, size in sizes.items():
        system.aperture, system.aperture_type = float(size), kind
        assert float(first_order(system).entrance_pupil_diameter) == pytest.approx(12.5, rel=1e-12)


def test_properties_are_differentiable_and_batched():
    system = load_system("cooke_triplet")
    numbers = system.prescription([system.wavelengths[1]])

    def values(curvature, thickness):
        found = first_order(system, prescription=numbers._replace(curvature=curvature, thickness=thickness))
        return tuple(value for name, value in found._asdict().items() if name not in fixed)

    fixed = ("entrance_pupil_diameter", "magnification")
    inputs = [value.clone().requires_grad_() for value in (numbers.curvature, numbers.thickness)]
    assert torch.autograd.gradcheck(values, inputs, fast_mode=True)
    two = torch.stack([numbers.curvature, 1.1 * numbers.curvature])
    assert values(two, numbers.thickness)[0].shape == (2,)


def test_dispersion_moves_the_focus():
    lens = load_system("singlet")
    lengths = [float(first_order(lens, wavelength).focal_length) for wavelength in lens.wavelengths]
    assert lengths == sorted(lengths)
    # Abbe: f_C − f_F = f/V for a thin lens.
    assert lengths[2] - lengths[0] == pytest.approx(lengths[1] / 64.17, rel=0.02)


def test_third_order_sums_of_the_double_gauss():
    """CODE V's values for this published lens; glass data differ in the sixth digit."""
    expected = {
        "SA": -0.306954,
        "TCO": 0.037071,
        "TAS": -0.074910,
        "SAS": -0.160505,
        "PTB": -0.203302,
        "DST": -0.232420,
        "AX": -0.035003,
        "LAT": 0.012274,
    }
    lens = load_system("double_gauss")
    found = seidel_sums(lens)
    for name, value in expected.items():
        assert float(found.transverse[name]) == pytest.approx(value, abs=1e-5)
    properties = first_order(lens)
    assert float(properties.focal_length) == pytest.approx(100.0038, abs=1e-4)
    assert float(properties.back_focal_distance) == pytest.approx(61.4875, abs=1e-4)
    assert float(properties.front_focal_distance) == pytest.approx(-29.3208, abs=2e-4)
    # The image plane of the file lies at the least spots, before the paraxial focus.
    assert abs(float(properties.image_distance - lens.surfaces[-1].thickness) - 0.379) < 1e-4
    assert abs(float(best_focus(lens))) < 1e-5 and float(rms_spot(lens).max()) < 0.024


@pytest.mark.parametrize("conic", [0.0, -2.0])
@pytest.mark.parametrize("distance", [math.inf, 150.0])
def test_third_order_sums_are_the_limit_of_real_rays(conic, distance):
    """Transverse aberrations of narrow beams: spherical aberration with aspheres, coma, distortion."""
    faces = [
        surface(40.0, conic=conic, coefficients=[1e-4, 2e-7], thickness=4.0, material=1.6),
        surface(thickness=6.0),
        surface(thickness=3.0, stop=True),
        surface(-30.0, thickness=3.0, material=1.7, conic=0.5),
        surface(-25.0, thickness=80.0),
    ]
    settings = {"object_distance": distance, "fields": [0.2]} if distance < math.inf else {"fields": [0.1]}
    form = {"aperture": 0.4, "aperture_type": "stop"}
    lens = optical_system(faces, **form, **settings)
    focus = float(first_order(lens).image_distance)
    faces[-1] = surface(-25.0, thickness=focus)
    lens = optical_system(faces, **form, **settings)
    sums = {name: float(value) for name, value in seidel_sums(lens).transverse.items()}
    points = torch.tensor([[0.0, 0.0], [0.0, 1.0], [0.0, -1.0]], dtype=torch.float64)
    axis = trace_fields(lens, points, fields=[(0.0, 0.0)], vignetting=False).y[0, 0]
    assert float(axis[1]) == pytest.approx(sums["SA"], rel=2e-3)
    y = trace_fields(lens, points, vignetting=False).y[0, 0]
    assert float(y[1] + y[2]) / 2 - float(y[0]) == pytest.approx(sums["TCO"], rel=0.02)


def test_third_order_sums_are_differentiable_and_name_limits():
    lens = load_system("cooke_triplet")
    numbers = lens.prescription()

    def sums(curvature, thickness):
        found = seidel_sums(lens, prescription=numbers._replace(curvature=curvature, thickness=thickness))
        return found.seidel, found.chromatic

    assert torch.autograd.gradcheck(
        sums, [numbers.curvature.requires_grad_(), numbers.thickness.requires_grad_()], fast_mode=True
    )
    with pytest.raises(ValueError, match="planes, conics and even aspheres"):
        seidel_sums(optical_system([surface(shape=Toroid(0.1, 0.2))], 1.0))
    with pytest.raises(ValueError, match=r"surfaces\[0\] is shifted or tilted"):
        seidel_sums(optical_system([surface(9.0, material=1.5, tilt=(1.0, 0.0))], 1.0))


def squeezing(image: float = 47.0) -> optical_system:
    """Return an anamorphic lens: two cylinders with power along x in front of a rotationally symmetric lens."""
    items = [
        surface(shape=Biconic(1 / 60), thickness=4.0, material=1.5),
        surface(thickness=50.0),
        surface(shape=Biconic(-1 / 30), thickness=2.0, material=1.5),
        surface(thickness=5.0),
        surface(60.0, thickness=5.0, material=1.6, stop=True),
        surface(-60.0, thickness=image),
    ]
    return optical_system(items, 4.0, fields=[(0.0, 5.0), (5.0, 0.0), (4.0, 3.0)])


def test_first_order_of_an_anamorphic_system_per_axis():
    """The focal lengths are those of real rays near the axis, and differ by the squeeze; the axis y is the default."""
    lens = squeezing()
    found = {axis: first_order(lens, axis=axis) for axis in "xy"}
    for axis, components in (("x", "xu"), ("y", "yv")):
        ray = trace_fields(lens, 1e-4 * torch.eye(2, dtype=torch.float64), fields=[0.0])
        height, slope = (getattr(ray, name)[0, 0, "xy".index(axis)] for name in components)
        assert float(found[axis].focal_length) == pytest.approx(-2e-4 / float(slope), rel=1e-7)
        assert float(found[axis].image_distance) == pytest.approx(47.0 - float(height / slope), rel=1e-7)
    assert float(found["x"].focal_length / found["y"].focal_length) == pytest.approx(1.93, abs=0.01)
    assert first_order(lens) == found["y"]
    with pytest.raises(ValueError, match="axis must be one of"):
        first_order(lens, axis="z")


def test_a_squeeze_is_no_distortion():
    """Distortion is the deviation from the paraxial point of both axes: it falls with the square of the field."""
    lens = squeezing()
    assert float(distortion(lens).abs().max()) < 4e-3
    small = torch.tensor([(0.0, 0.5), (0.5, 0.0), (0.4, 0.3)], dtype=torch.float64)
    assert torch.allclose(distortion(lens, fields=small) * 4, distortion(lens, fields=2 * small), rtol=0.02)
    ideal, real = distortion_grid(lens, 3)
    assert float((ideal - real).abs().max()) < 4e-3 * float(ideal.abs().max())
    assert float(ideal[2, 2, 0] / ideal[2, 2, 1]) == pytest.approx(1.845, abs=0.01)
