"""Curved and tilted image surfaces, pupils at infinity: closed forms and symmetries."""

import json
import math

import numpy as np
import pytest
import torch

from odak._torch_private import forward_derivative
from odak.learn.raytracing.system import (
    distortion,
    distortion_grid,
    draw_layout,
    field_curvature,
    field_figure,
    first_order,
    image_figure,
    launch,
    load_system,
    optical_system,
    paraxial_rays,
    pupil_aberration,
    pupil_figure,
    pupil_quadrature,
    pupil_samples,
    pupils,
    read_zmx,
    relative_illumination,
    rms_spot,
    spot_diagram,
    surface,
    system_from_dict,
    system_to_dict,
    trace,
    trace_fields,
    wavefront,
    write_zmx,
)
from odak.raytracing import OddAsphere, RayStatus, surfaces

F64 = torch.float64
RADIUS, INDEX, FOCAL = 20.0, 1.5, 30.0


def ball(image=None, fields=((0.0, 0.0), (0.0, 25.0)), aperture=2.0):
    """Return a ball lens with the stop in its centre: f = nR/2(n − 1) from there for every direction."""
    return optical_system(
        [
            surface(RADIUS, thickness=RADIUS, material=INDEX),
            surface(thickness=RADIUS, material=INDEX, stop=True),
            surface(-RADIUS, thickness=FOCAL - RADIUS),
        ],
        aperture=aperture,
        fields=fields,
        wavelengths=500e-6,
        image=image,
    )


def turned(points, directions, angle):
    """Turn rays about x and the centre of the ball."""
    c, s = math.cos(angle), math.sin(angle)
    matrix = torch.tensor([[1, 0, 0], [0, c, s], [0, -s, c]], dtype=F64)
    centre = torch.tensor([0.0, 0.0, RADIUS], dtype=F64)
    return torch.stack([(points - centre) @ matrix.T + centre, directions @ matrix.T], -2)


def test_a_ball_images_every_direction_alike_onto_a_ball():
    system = ball(surface(-FOCAL))
    rays = launch(system, "rings", 3, fields=[(0.0, 0.0)]).to_tensor()[0, 0]
    angle = math.radians(25)
    straight = trace(system, rays).to_tensor().reshape(-1, 2, 3)
    aslant = trace(system, turned(*rays.unbind(-2), angle)).to_tensor().reshape(-1, 2, 3)
    vertex = torch.tensor([[0.0, 0.0, RADIUS + FOCAL], [0.0, 0.0, 0.0]], dtype=F64)
    expected = turned(*(straight + vertex).unbind(-2), angle) - vertex
    assert float(straight[:, 0, 2].min()) < -1e-9
    torch.testing.assert_close(aslant, expected, atol=1e-12, rtol=0)


def test_field_curvature_of_a_ball_on_the_sphere_and_on_a_plane():
    tangential, sagittal = field_curvature(ball(surface(-FOCAL)))
    torch.testing.assert_close(tangential, torch.zeros(1, 2, dtype=F64), atol=1e-9, rtol=0)
    torch.testing.assert_close(sagittal, torch.zeros(1, 2, dtype=F64), atol=1e-9, rtol=0)
    behind = ball(surface(-FOCAL - 1))
    behind.surfaces[-1].thickness.add_(1.0)
    for found in field_curvature(behind):
        assert float(found[0, 1]) == pytest.approx(-math.cos(math.radians(25)), rel=1e-9)
    flat = field_curvature(ball())[1]
    assert float(flat[0, 1]) == pytest.approx(FOCAL * math.cos(math.radians(25)) - FOCAL, rel=1e-9)


def test_wavefront_to_point_of_curved_image_is_that_of_axis():
    """Turned about the centre, the same wave: the stop, an ellipse from there, is filled by the same round bundle."""
    system = ball(surface(-FOCAL), fields=[(0.0, 0.0)], aperture=8.0)
    pupil = torch.tensor([[0.0, 0.5], [0.9, 0.0], [-0.3, -0.6]], dtype=F64)
    axis = wavefront(system, pupil)
    c = math.cos(math.radians(25))
    squeezed = pupil / torch.tensor([1.0, c], dtype=F64)
    # Off the axis the paraxial pupil is left at the angle's cosine; the reference sphere is about the same centre.
    aslant = wavefront(system, squeezed, fields=[(0.0, 25.0)])
    assert float(axis.path.abs().max()) > 0.5
    torch.testing.assert_close(aslant.path, axis.path, atol=1e-6, rtol=0)
    assert float(wavefront(ball(), squeezed, fields=[(0.0, 25.0)]).path.abs().max()) > 2


def test_gradients_of_the_image_surface():
    lens = ball()

    def heights(curvature, conic, coefficients, tilt):
        image = surface(curvature=-1 / FOCAL)
        for name, value in (("curvature_value", curvature), ("conic", conic), ("tilt", tilt)):
            image._buffers[name] = value
        image._buffers["coefficients"] = coefficients
        lens.image = image
        traced = trace_fields(lens, "rings", 1)
        return traced.y, traced.z, traced.path

    values = [-1 / FOCAL, 0.3, [1e-4, 1e-6], [1.0, -2.0]]
    inputs = [torch.tensor(value, dtype=F64, requires_grad=True) for value in values]
    assert torch.autograd.gradcheck(heights, inputs, fast_mode=True)
    lens = ball(surface(-FOCAL))
    curvature = lens.image.vary("curvature")
    (found,) = torch.autograd.grad(rms_spot(lens)[1], curvature)
    assert bool(found.isfinite()) and float(found.abs()) > 0
    assert any(parameter is curvature for parameter in lens.parameters())


def test_a_tilted_image_plane_follows_scheimpflug():
    """Object points of a plane tilted by θ lie sharp on one tilted by θ′, tan θ′ = m·tan θ."""
    thin = [surface(50.0, thickness=1e-9, material=1.5), surface(-50.0, thickness=75.0)]
    tilt, magnification = math.radians(20), -0.5
    lens = optical_system(thin, aperture=1.0, object_distance=150.0)
    slope = math.tan(tilt)
    angle = math.degrees(math.atan(magnification * slope))
    lens.image = surface(tilt=(angle, 0.0))
    flat = optical_system(thin, aperture=1.0, object_distance=150.0)
    # So near to the axis that aberrations are small beside the tilt.
    height = 0.05
    start = torch.tensor([0.0, height, -150.0 + height * slope], dtype=F64)
    aim = torch.tensor([[0.0, p, 0.0] for p in (-0.01, 0.0, 0.01)], dtype=F64)
    rays = torch.stack([start.expand(3, 3), aim - start], -2)
    sharp, blurred = (trace(system, rays).y.flatten() for system in (lens, flat))
    assert float((sharp[2] - sharp[0]).abs()) < 0.02 * float((blurred[2] - blurred[0]).abs())
    z = trace(lens, rays).z.flatten()
    torch.testing.assert_close(z, sharp * math.tan(math.radians(angle)), atol=1e-12, rtol=0)


def test_curved_images_are_written_read_and_drawn(tmp_path):
    system = load_system("cooke_triplet")
    plain = draw_layout(system)
    system.image = surface(-60.0, conic=-0.4, coefficients=[0.0, 1e-6], semi_diameter=20.0)
    copy = system_from_dict(json.loads(json.dumps(system_to_dict(system))))
    assert torch.equal(trace_fields(copy).z, trace_fields(system).z) and float(trace_fields(copy).z.min()) < -1
    write_zmx(system, tmp_path / "a.zmx")
    again, report = read_zmx(tmp_path / "a.zmx")
    torch.testing.assert_close(trace_fields(again).z, trace_fields(system).z, atol=1e-12, rtol=0)
    assert again.image.semi_diameter == 20.0 and not [line for line in report.ignored if "CURV" in line]
    assert draw_layout(system).tobytes() != plain.tobytes()
    with pytest.raises(TypeError, match="image must be a surface"):
        optical_system([surface()], 1.0, image=3.0)
    with pytest.raises(ValueError, match="image must be a surface without thickness"):
        optical_system([surface()], 1.0, image=surface(material="N-BK7"))


def test_memory_kept_for_gradients_of_tilted_surfaces():
    """At most 300 bytes a ray in float32, as for centred surfaces."""
    system = load_system("cooke_triplet")
    system.vary(curvature=range(6), tilt=[1])
    kept = {}

    def note(value):
        # Held, so that no address is given out twice.
        kept[value.untyped_storage().data_ptr()] = (value.untyped_storage().nbytes(), value)
        return value

    with torch.autograd.graph.saved_tensors_hooks(note, lambda value: value):
        traced = trace_fields(system, "random", 9000, fields=[(0.0, 10.0)], dtype=torch.float32)
    assert sum(size for size, _ in kept.values()) / traced.x.numel() < 100


def test_blocks_of_tilted_surfaces_change_nothing(monkeypatch):
    from odak.learn.raytracing.system import tracing

    system = load_system("cooke_triplet")
    parameters = system.vary(tilt=[2], shift=[0], curvature=[3])

    def run():
        rays = launch(system, "rings", 4)
        rays = type(rays)(*(value.detach().requires_grad_() for value in rays))
        traced = trace(system, rays)
        loss = torch.where(traced.arrived, traced.y, 0.0).square().sum() + traced.path.nansum()
        return torch.autograd.grad(loss, (*parameters, rays.x, rays.v))

    whole = run()
    monkeypatch.setattr(tracing, "BLOCK", 90)
    for a, b in zip(run(), whole, strict=True):
        torch.testing.assert_close(a, b, rtol=1e-11, atol=1e-11)


def test_second_derivatives_through_tilted_surfaces():
    system = load_system("singlet")
    numbers = system.prescription()
    rays = launch(system, "rings", 1)

    def values(curvature, tilt):
        changed = numbers._replace(curvature=curvature, tilt=tilt, shift=None)
        return trace(system, rays, prescription=changed, vignetting=False).y

    inputs = [numbers.curvature.clone(), torch.tensor([[0.5, -0.2], [0.0, 0.3]], dtype=F64)]
    inputs = [value.requires_grad_() for value in inputs]
    assert torch.autograd.gradcheck(values, inputs, fast_mode=True)
    assert torch.autograd.gradgradcheck(values, inputs, fast_mode=True)


def relay(image_gap=120.0, **options):
    """Return two thin lenses of 80 and 120 mm about a stop in their common focus."""
    lenses = [
        surface(80.0, thickness=1e-12, material=1.5),
        surface(-80.0, thickness=80.0),
        surface(thickness=120.0, stop=True),
        surface(120.0, thickness=1e-12, material=1.5),
        surface(-120.0, thickness=image_gap),
    ]
    settings = {"aperture": 0.02, "aperture_type": "NA", "object_distance": 80.0, "fields": [0.0, 0.5]}
    return optical_system(lenses, **{**settings, **options})


def test_a_telecentric_relay():
    """Chief rays parallel to the axis on both sides; m = −f₂/f₁ whatever the focus; NA′ = NA·f₁/f₂."""
    system = relay()
    found = first_order(system)
    assert float(found.entrance_pupil_distance.abs()) > 1e12 and float(found.exit_pupil_distance.abs()) > 1e12
    assert float(found.magnification) == pytest.approx(-1.5, rel=1e-9)
    assert float(found.image_distance) == pytest.approx(120.0, rel=1e-9)
    assert float(found.numerical_aperture) == pytest.approx(0.02 / 1.5, rel=1e-3)
    assert float(found.stop_diameter) == pytest.approx(2 * 80 * math.tan(math.asin(0.02)), rel=1e-9)
    for aim in ("paraxial", "real"):
        chief = launch(system, torch.zeros(1, 2), aim=aim)
        assert float(chief.w.min()) > 1 - 1e-9
    for gap, distance in ((120.0, 80.0), (90.0, 80.0), (120.0, 60.0)):
        chief = trace_fields(relay(gap, object_distance=distance), torch.zeros(1, 2))
        assert float(chief.y[0, 1, 0]) == pytest.approx(-0.75, rel=2e-4)
        assert float(chief.v[0, 1, 0].abs()) < 1e-5
    at_stop = trace(system, launch(system, "rings", 2, aim="real"), until=2)
    radius = float(found.stop_diameter) / 2
    assert float((at_stop.x.square() + at_stop.y.square()).max()) == pytest.approx(radius**2, rel=1e-9)
    assert float(distortion(system)[0, 1].abs()) < 1e-3
    same = relay(aperture=2 * radius, aperture_type="stop")
    torch.testing.assert_close(launch(same).v, launch(system).v, rtol=1e-9, atol=1e-12)


def test_a_pupil_exactly_at_infinity():
    """a = 1 − 100·0.01 is zero to the last bit; rays leave each point within the same cone."""
    system = optical_system(
        [surface(curvature=0.02, thickness=150.0, material=1.5), surface(thickness=100.0, stop=True)],
        aperture=0.05,
        aperture_type="NA",
        object_distance=100.0,
        fields=[0.0, (3.0, -2.0)],
    )
    found = first_order(system)
    assert math.isinf(float(found.entrance_pupil_distance)) and math.isinf(float(found.entrance_pupil_diameter))
    assert not any(bool(value.isnan()) for value in found)
    rays = launch(system, "y", 3)
    torch.testing.assert_close(rays.v[0, 1], torch.tensor([-0.05, 0.0, 0.05], dtype=F64), rtol=1e-12, atol=1e-15)
    torch.testing.assert_close(rays.v[0, 0], rays.v[0, 1], rtol=1e-12, atol=1e-15)
    assert bool(spot_diagram(system).rms.isfinite().all()) and bool(
        spot_diagram(system, aim="real").rms.isfinite().all()
    )
    system.aperture_type, system.aperture = "EPD", 5.0
    with pytest.raises(ValueError, match=r'aperture_type must be "NA" or "stop".*at infinity'):
        launch(system)


def test_wavefront_of_exit_pupil_at_infinity_is_the_far_limit():
    system = optical_system(
        [
            surface(thickness=100.0, stop=True),
            surface(50.0, thickness=1e-9, material=1.5),
            surface(-1e9, thickness=101),
        ],
        aperture=4.0,
        wavelengths=500e-6,
        fields=[(0.0, 1.0)],
    )
    assert float(first_order(system).exit_pupil_distance.abs()) > 1e4
    pupil = torch.tensor([[0.0, 0.7], [0.5, -0.3]], dtype=F64)
    found = wavefront(system, pupil)
    assert bool(found.path.isfinite().all())
    system.surfaces[0].thickness.fill_(99.999)
    torch.testing.assert_close(wavefront(system, pupil).path, found.path, rtol=1e-3, atol=1e-4)


# M. Laikin, Lens Design, 4th ed. (2007), pages 110, 112 and 114: radius, thickness, glass; 0 marks the stop.
WIDE = {
    "120": (
        [
            28.2482,
            2.2027,
            2.7819,
            -10.4886,
            1.2417,
            -2.8768,
            -2.0989,
            -4.2448,
            8.4162,
            -1.6294,
            -4.5056,
            0,
            math.inf,
            -3.8691,
            -6.6827,
            -2.2167,
            -1.6444,
            -3.3466,
            -36.4599,
            5.3765,
            6.4204,
            -2.7537,
            5.1876,
            math.inf,
        ],
        [
            0.5,
            1.4379,
            1.1174,
            0.3022,
            0.7247,
            0.5088,
            0.4998,
            0.015,
            1.1279,
            0.2486,
            0.5412,
            0.02,
            0.1689,
            0.1065,
            0.2007,
            0.2822,
            0.1827,
            0.0149,
            0.5235,
            0.0373,
            0.6243,
            0.015,
            0.8475,
            2.0,
        ],
        "N-SK4 air SF1 N-SK4 air SF1 N-SK4 air N-SK4 SF1 air air N-SK4 air N-SK4 air SF1 air SF1 air N-SK4 air N-SK4 "
        "air",
        2.8,
        (0.0, 42.0, 60.0),
    ),
    "160": (
        [
            38.915,
            3.6152,
            math.inf,
            5.2515,
            -5.2515,
            math.inf,
            5.1075,
            -10.8385,
            2.3897,
            2.2789,
            0,
            -2.3536,
            2.7829,
            -2.8287,
            13.1578,
            -1.4944,
            -4.8082,
            4.3447,
            72.8673,
        ],
        [
            0.5459,
            1.6595,
            0.6927,
            1.4576,
            0.6927,
            4.1494,
            0.7,
            0.0162,
            0.7443,
            0.1136,
            0.104,
            0.7038,
            0.5423,
            0.2506,
            0.635,
            0.2922,
            0.0668,
            0.5059,
            2.2376,
        ],
        "N-BK7 air N-BK7 air N-BK7 air SF4 air SF4 air air SF1 N-LAK7 air N-LAK7 SF4 air N-LAK21 air",
        2.0,
        (0.0, 56.0, 80.0),
    ),
    "170": (
        [
            6.0515,
            1.2087,
            -9.4697,
            1.0053,
            1.6634,
            -1.6712,
            1.1206,
            1.3895,
            0.5522,
            -0.8844,
            -0.8804,
            -2.1545,
            0,
            1.0354,
            -0.8443,
            -0.7386,
            -1.5285,
        ],
        [
            0.1796,
            0.9182,
            0.1939,
            0.6402,
            0.4518,
            0.1825,
            2.5272,
            0.25,
            0.6047,
            0.0196,
            0.08,
            0.12,
            0.12,
            0.483,
            0.0546,
            0.1076,
            0.8308,
        ],
        "N-BK7 air N-SK5 air SF1 N-LAK9 air N-LAK9 N-PSK3 air SF1 air air N-PSK3 air SF1 air",
        1.8,
        (0.0, 60.0, 85.0),
    ),
}


def wide(name):
    radii, gaps, glasses, number, fields = WIDE[name]
    faces = [
        surface(radius or math.inf, thickness=gap, material=glass, stop=radius == 0)
        for radius, gap, glass in zip(radii, gaps, glasses.split(), strict=True)
    ]
    return optical_system(faces, number, "F-number", fields=fields, wavelengths=587.6e-6)


@pytest.mark.parametrize("name", ["120", pytest.param("160", marks=pytest.mark.slow), "170"])
@pytest.mark.slow
def test_every_field_of_wide_lenses_is_aimed(name):
    """Fields of 120, 160 and 170 degrees: all 61 rays meet the stop where they should."""
    lens = wide(name)
    points = pupil_samples("rings", 4)
    rays = launch(lens, points, aim="real")
    found = trace(lens, rays, until=lens.stop)
    assert points.shape == (61, 2) and int(found.arrived.sum()) == found.arrived.numel()
    radius = first_order(lens).stop_diameter / 2
    torch.testing.assert_close(found.x, (radius * points[:, 0]).expand_as(found.x), atol=1e-8, rtol=0)
    torch.testing.assert_close(found.y, (radius * points[:, 1]).expand_as(found.y), atol=1e-8, rtol=0)


@pytest.mark.slow
def test_rays_that_cannot_be_aimed_say_so():
    """No ray at 60 degrees gets through two holes in line."""
    lens = optical_system([surface(1.0, thickness=30.0, material=1.5), surface(thickness=5.0, stop=True)], 1.9)
    lens.fields = ((0.0, 0.0), (0.0, 75.0))
    found = trace(lens, launch(lens, "y", 5, aim="real"))
    assert bool((found.status[..., 1, :] == RayStatus.NOT_AIMED).any())
    assert bool(found.y[..., 1, :][found.status[..., 1, :] == RayStatus.NOT_AIMED].isnan().all())


def test_a_field_without_rays_beside_a_clear_one_has_no_weight():
    lens = optical_system([surface(1.0, thickness=30.0, material=1.5), surface(thickness=5.0, stop=True)], 1.9)
    lens.fields = ((0.0, 0.0), (0.0, 75.0))
    weights = pupil_quadrature(lens, 2, aim="real").weights.sum(-1)
    assert weights.tolist() == pytest.approx([1.0, 0.0], abs=1e-12)


@pytest.mark.parametrize("aim", ["paraxial", "real"])
def test_pupils_follow_a_shifted_stop(aim):
    shift = (0.4, -0.7)
    lens = optical_system(
        [
            surface(50.0, thickness=4.0, material="N-BK7"),
            surface(-80.0, thickness=5.0),
            surface(thickness=30.0, stop=True, shift=shift, semi_diameter=4.05),
        ],
        aperture=8.0,
        aperture_type="stop",
        fields=[0.0, 2.0],
    )
    points = pupil_samples("rings", 3)
    rays = launch(lens, points, aim=aim)
    found = trace(lens, rays, until=2)
    assert found.arrived.float().mean() > (0.99 if aim == "real" else 0.7)
    if aim == "real":
        torch.testing.assert_close(found.x, (shift[0] + 4 * points[:, 0]).expand_as(found.x), atol=1e-9, rtol=0)
        torch.testing.assert_close(found.y, (shift[1] + 4 * points[:, 1]).expand_as(found.y), atol=1e-9, rtol=0)


def test_each_field_may_have_points_of_its_own_in_the_pupil():
    """Rays, spots and wavefronts of all fields in one call are those of each field alone."""
    lens = load_system("cooke_triplet")
    turn = torch.tensor([[0.8, -0.6], [0.6, 0.8]], dtype=F64)
    points = torch.stack([pupil_samples("rings", 2), 0.5 * pupil_samples("rings", 2), pupil_samples("rings", 2) @ turn])
    rays, spots, waves = launch(lens, points), rms_spot(lens, points), wavefront(lens, points).path
    for i, field in enumerate(lens.fields):
        alone = launch(lens, points[i], fields=[field])
        for found, expected in zip(rays, alone, strict=True):
            assert torch.equal(found[..., i : i + 1, :], expected)
        torch.testing.assert_close(spots[i : i + 1], rms_spot(lens, points[i], fields=[field]), rtol=1e-12, atol=0)
        expected = wavefront(lens, points[i], fields=[field]).path
        torch.testing.assert_close(waves[..., i : i + 1, :], expected, rtol=1e-9, atol=1e-9)
    with pytest.raises(ValueError, match="pupil has points for 3 fields, got 1"):
        launch(lens, points, fields=[(0.0, 0.0)])


def traced_back(slope):
    """Return the angle in the object space, in degrees, of a ray from the centre of the stop of :func:`dome`."""
    _, way = ray_back(slope)
    return math.degrees(math.atan2(way[0], way[1]))


def ray_back(slope):
    """Return point (y, z) and direction in the object space of a ray from the centre of the stop of :func:`dome`."""
    point, way = [0.0, 12.0], [-math.sin(slope), -math.cos(slope)]
    for vertex, radius, ratio in ((2.0, 8.0, 1 / 1.8), (0.0, 30.0, 1.8)):
        off = [point[0], point[1] - vertex - radius]
        along = off[0] * way[0] + off[1] * way[1]
        reach = -along + math.sqrt(along**2 - off[0] ** 2 - off[1] ** 2 + radius**2)
        point = [p + reach * w for p, w in zip(point, way, strict=True)]
        normal = [point[0] / radius, (point[1] - vertex - radius) / radius]
        cosine = normal[0] * way[0] + normal[1] * way[1]
        bend = math.sqrt(1 - ratio**2 * (1 - cosine**2)) - ratio * cosine
        way = [ratio * w + bend * n for w, n in zip(way, normal, strict=True)]
    return point, [-w for w in way]


def dome(fields):
    """Return the front of a fisheye lens: a strong meniscus of index 1.8 and a stop behind it."""
    faces = [surface(30.0, thickness=2.0, material=1.8), surface(8.0, thickness=10.0)]
    return optical_system([*faces, surface(stop=True, thickness=10.0)], 0.2, fields=fields)


@pytest.mark.parametrize("slope", [30.0, 48.0, 50.0, 51.0])
def test_fields_beyond_90_degrees_are_those_of_rays_traced_back(slope):
    angle = traced_back(math.radians(slope))
    assert (angle > 90) == (slope >= 50)
    for sign in (1, -1):
        lens = dome([(0.0, sign * angle), (sign * angle, 0.0)])
        found = trace_fields(lens, torch.zeros(1, 2, dtype=torch.float64), aim="real")
        run = 10 * math.tan(math.radians(sign * slope))
        assert found.y[lens.reference].flatten().tolist() == pytest.approx([run, 0.0], abs=1e-9)
        assert found.x[lens.reference].flatten().tolist() == pytest.approx([0.0, run], abs=1e-9)


@pytest.mark.slow
def test_rays_and_paths_are_smooth_across_90_degrees():
    chief = torch.zeros(1, 2, dtype=torch.float64)
    heights = [
        float(trace_fields(dome([0.0]), chief, fields=[(0.0, angle)], aim="real").y[0, 0, 0])
        for angle in (89.99, 90.0, 90.01)
    ]
    assert heights[2] - heights[1] == pytest.approx(heights[1] - heights[0], rel=2e-3)
    # Both ways to launch, by heights in the pupil plane and across the ray, give the same wavefront.
    alone, beside = (wavefront(dome(fields), aim="real").rms[:, 1] for fields in ([0.0, 60.0], [0.0, 60.0, 91.0]))
    assert beside.tolist() == pytest.approx(alone.tolist(), rel=1e-6)
    lens = dome([(0.0, 92.0)])
    bend = lens.vary(curvature=1)[0]
    height = trace_fields(lens, chief, aim="real").y.sum()
    (slope,) = torch.autograd.grad(height, bend)
    with torch.no_grad():
        ends = [float((bend.add_(step), trace_fields(lens, chief, aim="real").y.sum())[1]) for step in (1e-6, -2e-6)]
    assert float(slope) == pytest.approx((ends[0] - ends[1]) / 2e-6, rel=1e-5)


def test_fields_beyond_90_degrees_need_real_rays_and_an_axis():
    with pytest.raises(ValueError, match='fields must be below 90 degrees from the axis, or aim "real", got 95'):
        trace_fields(dome([0.0, 95.0]), "rings", 1)
    for field in ((10.0, 95.0), (0.0, 180.0)):
        with pytest.raises(ValueError, match="below 180 along x or y alone"):
            dome([field])


def test_wide_fields_are_aimed_in_few_traces(monkeypatch):
    """Chief rays that are kept start what follows, and belong to the numbers they were found for."""
    traced = []
    monkeypatch.setattr(pupils, "trace", lambda *a, **b: (traced.append(1), trace(*a, **b))[1])
    pupils._CHIEF_RAYS.clear()
    lens, points = wide("160"), pupil_samples("rings", 2)
    first = launch(lens, points, aim="real")
    counted = len(traced)
    again = launch(lens, points, aim="real")
    # A march of the continuation takes no trace for its tangent: with them there were 62.
    assert counted < 56 and len(traced) - counted < 20
    assert all(torch.equal(a, b) for a, b in zip(first, again, strict=True))
    with torch.no_grad():
        lens.surfaces[0].radius_value.mul_(1.001)
    bent = launch(lens, points, aim="real")
    pupils._CHIEF_RAYS.clear()
    assert all(torch.equal(a, b) for a, b in zip(bent, launch(lens, points, aim="real"), strict=True))
    assert not torch.equal(bent.y, first.y)


def test_rays_of_a_chart_are_traced_until_they_meet_their_points_or_are_lost():
    """Of rays that miss by x³/10, some are met at once, some in a few steps; one does not exist."""
    traced = []

    def errors(x, y, goals, where):
        traced.append(x.numel())
        return x + 0.1 * x**3 - goals[..., 0], y - goals[..., 1], x < 0.5

    chart = torch.zeros(1, 1, len(pupils.POWERS), 6, dtype=F64)
    for column, powers in enumerate([(1, 0), (0, 1), (0, 0), None, None, (0, 0)]):
        if powers is not None:
            chart[..., pupils.POWERS.index(powers), column] = 1.0
    points = torch.tensor([[0.0, 0.2], [0.01, 0.0], [0.3, -0.1], [0.6, 0.0]], dtype=F64)
    one, fields = torch.ones((), dtype=F64), torch.zeros(1, 1, 2, dtype=F64)
    x, y, found = pupils._by_chart(errors, chart, points, 1e-4 * one, one, points[None, None], fields)
    assert traced == [4, 2, 1, 1]
    assert found.tolist() == [[[True, True, True, False]]]
    assert float((x + 0.1 * x**3 - points[:, 0])[found].abs().max()) < 1e-8
    assert torch.equal(y, points[None, None, :, 1]) and float(x[0, 0, 3]) == 0.6


def shaped():
    """Return the wide lens with a surface that is a shape."""
    lens = wide("120")
    item, odd = lens.surfaces[0], torch.tensor([0.0, 0.0, 1e-6], dtype=F64)
    shape = OddAsphere(float(item.curvature), 0.0, odd)
    own = surface(shape=shape, thickness=float(item.thickness), material=item.material)
    return optical_system([own, *list(lens.surfaces)[1:]], 2.8, "F-number", fields=[0.0, 30.0])


def test_lenses_of_shapes_keep_their_chief_rays_and_charts(monkeypatch):
    """A parameter that changes in place, another class of shape and another aperture are another lens."""
    traced = []
    monkeypatch.setattr(pupils, "trace", lambda *a, **b: (traced.append(1), trace(*a, **b))[1])
    lens, points = shaped(), pupil_samples("rings", 8)
    pupils._CHIEF_RAYS.clear()
    first = launch(lens, points, aim="real")
    counted = len(traced)
    again = launch(lens, points, aim="real")
    assert len(pupils._CHIEF_RAYS) == 1 and next(iter(pupils._CHIEF_RAYS.values())).chart is not None
    assert len(traced) - counted < 0.6 * counted
    torch.testing.assert_close(torch.stack(first), torch.stack(again), rtol=0, atol=1e-10)
    for change in (
        lambda: lens.surfaces[0].shape.coefficients.data.mul_(30),
        lambda: setattr(lens, "aperture", lens.aperture / 2),
    ):
        change()
        changed = launch(lens, points, aim="real")
        pupils._CHIEF_RAYS.clear()
        alone = launch(lens, points, aim="real")
        torch.testing.assert_close(torch.stack(changed), torch.stack(alone), rtol=0, atol=1e-10)
        assert float((changed.y - again.y).abs().max()) > 1e-6
        again = changed


@pytest.mark.parametrize("forward", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_charts_of_lenses_of_shapes_keep_gradients_in_the_shapes(forward):
    points, odd, lens = pupil_samples("rings", 8), torch.tensor([0.0, 0.0, 1e-6], dtype=F64), shaped()
    numbers = lens.prescription()

    def moved(bend):
        own = OddAsphere(lens.surfaces[0].shape.curvature, lens.surfaces[0].shape.conic, bend)
        given = numbers._replace(shapes=(own, *numbers.shapes[1:]))
        return launch(lens, points, aim="real", prescription=given).y.square().sum()

    moved(odd)
    step = torch.tensor([0.0, 0.0, 1e-6], dtype=F64)
    if forward:
        _, slope = forward_derivative(moved, odd, step / 1e-6)
    else:
        slope = torch.autograd.grad(moved(bend := odd.clone().requires_grad_()), bend)[0][2]
    assert float(slope) == pytest.approx(float(moved(odd + step) - moved(odd - step)) / 2e-6, rel=1e-5)


def test_rays_that_cannot_be_aimed_are_not_looked_for_again(monkeypatch):
    """A few traces tell where the spokes end: inside rays are found by themselves, and outside there are none."""
    traced = []
    monkeypatch.setattr(pupils, "trace", lambda *a, **b: (traced.append(1), trace(*a, **b))[1])
    lens, points = wide("160"), pupil_samples("y", 5) * 40
    lens.fields = ((0.0, 0.0),)
    pupils._CHIEF_RAYS.clear()
    first = launch(lens, points, aim="real")
    counted = len(traced)
    ends = next(iter(pupils._CHIEF_RAYS.values())).ends
    assert len(ends) == 2 and bool((ends[:, 3] < 40).all()) and counted < 250
    assert bool(torch.isinf(first.v).any()) and bool(torch.isfinite(first.v).any())
    again = launch(lens, points, aim="real")
    assert len(traced) - counted < counted / 3
    # Points of other distances on the same spokes are aimed as by themselves.
    other = launch(lens, points * 0.93, aim="real")
    pupils._CHIEF_RAYS.clear()
    alone = launch(lens, points * 0.93, aim="real")
    for one, two in ((first, again), (other, alone)):
        torch.testing.assert_close(torch.stack(one), torch.stack(two), rtol=1e-9, atol=1e-12)
    for share, reached in ((1 - 1e-4, True), (1 + 3e-6, False)):
        pupils._CHIEF_RAYS.clear()
        rays = launch(lens, ends[:, 1:3] * (share * ends[:, 3:]), aim="real")
        assert bool((torch.isfinite(rays.v) == reached).all())


@pytest.mark.slow
def test_illumination_aims_at_shapes_without_derivatives(monkeypatch):
    """The searches of rays and of intersections are done once, in NumPy, although derivatives are taken of both."""
    kinds, newton = [], surfaces.newton
    monkeypatch.setattr(surfaces, "newton", lambda *a: (kinds.append(type(a[3])), newton(*a))[1])
    lens = shaped()
    pupils._CHIEF_RAYS.clear()
    found = relative_illumination(lens, 3, aim="real")[0]
    assert set(kinds) == {np.ndarray} and len(pupils._CHIEF_RAYS) == 2
    # As much as the cone of rays in the image is larger, from directions by differences.
    points, weights = pupil_quadrature(lens, 3, vignetting=False)
    moved = [points + 1e-4 * torch.tensor(unit, dtype=F64) for unit in ((1, 0), (-1, 0), (0, 1), (0, -1))]
    ends = [trace_fields(lens, place, aim="real") for place in moved]
    (ux, vx), (uy, vy) = ((a.u - b.u, a.v - b.v) for a, b in (ends[:2], ends[2:]))
    area = ((ux * vy - uy * vx) * weights).sum(-1)[lens.reference]
    torch.testing.assert_close(found, area / area[0], rtol=1e-5, atol=0)


def test_many_rays_start_from_a_chart_and_end_where_few_do(monkeypatch):
    """Rays of a batch of lenses, with their derivatives in both modes, in a third of the traces."""
    traced, points = [], pupil_samples("rings", 6)
    monkeypatch.setattr(pupils, "trace", lambda *a, **b: (traced.append(a[1].x.shape[-1]), trace(*a, **b))[1])
    lens = wide("120")
    lens.fields = ((0.0, 0.0), (0.0, 60.0))
    numbers = lens.prescription()
    bends = (torch.tensor([[1.0], [1.001]], dtype=F64) * numbers.curvature).requires_grad_()

    def found(place, bent=bends):
        rays = launch(lens, place, aim="real", prescription=numbers._replace(curvature=bent))
        return torch.stack(rays[:2])

    results, costs = [], []
    for least in (len(points) + 1, 1):
        monkeypatch.setattr(pupils, "CHARTED", least)
        pupils._CHIEF_RAYS.clear()
        with torch.no_grad():
            found(points)
            traced.clear()
            plain = found(points)
        costs.append(sum(traced))
        (slopes,) = torch.autograd.grad(found(points).square().sum(), bends)
        _, change = forward_derivative(lambda place: found(place, bends.detach()), points, points.flip(-1))
        results.append((plain, slopes, change))
    assert 3 * costs[1] < costs[0] and results[0][0].shape == (2, 2, 1, 2, 127)
    for a, b in zip(*results, strict=True):
        torch.testing.assert_close(a, b, rtol=1e-9, atol=1e-10)


@pytest.mark.parametrize("slope", [30.0, 51.0])
def test_distortion_beyond_90_degrees_is_that_from_the_angle(slope):
    angle = traced_back(math.radians(slope))
    # A narrow field of the same lens gives the length f of f·θ.
    near = traced_back(1e-5)
    length = 10 * math.tan(1e-5) / math.radians(near)
    expected = 10 * math.tan(math.radians(slope)) / (length * math.radians(angle)) - 1
    for fields in ([0.0, angle], [(angle, 0.0), (-angle, 0.0)]):
        found = distortion(dome(fields), projection="angle", aim="real")
        assert found[0, -1].item() == pytest.approx(expected, abs=1e-8)
    if angle > 90:
        for function in (distortion, distortion_grid):
            with pytest.raises(ValueError, match=r"fields .*below 90 degrees for"):
                function(dome([0.0, angle]), aim="real")


def test_distortion_of_a_pinhole_and_of_a_sphere_around_it():
    """Heights of 40·tan θ on a plane and of 40·sin θ on a sphere around the pinhole, from f·θ and f·tan θ."""
    fields = [(0.0, 20.0), (0.0, 60.0), (-45.0, 45.0)]
    plane = optical_system([surface(stop=True, thickness=40.0)], 1e-3, fields=fields)
    ball = optical_system([surface(stop=True, thickness=40.0)], 1e-3, fields=fields, image=surface(-40.0))
    theta = torch.tensor([math.radians(20.0), math.radians(60.0), math.atan(math.sqrt(2))], dtype=F64)
    for lens, heights in ((plane, theta.tan()), (ball, theta.sin())):
        assert torch.allclose(distortion(lens, projection="angle")[0], heights / theta - 1, atol=1e-12)
        assert torch.allclose(distortion(lens)[0], heights / theta.tan() - 1, atol=1e-12)
    with pytest.raises(ValueError, match='projection must be "tangent" for an object at 100, got "angle"'):
        distortion(optical_system([surface(thickness=40.0)], 1.0, object_distance=100.0), projection="angle")


@pytest.mark.parametrize("slope", [30.0, 51.0])
def test_aberration_of_the_pupil_beyond_90_degrees(slope):
    """How far the ray traced back passes the paraxial pupil's centre, across it, or in its plane for small fields."""
    (y, z), (v, w) = ray_back(math.radians(slope))
    angle = traced_back(math.radians(slope))
    for lens, shift, axis in ((dome([0.0, angle]), 0, "y"), (dome([(-angle, 0.0)]), 1, "x")):
        found = first_order(lens)
        off = z - float(found.entrance_pupil_distance)
        passed = y * w - off * v if angle > 80 else y - off * v / w
        expected = passed / (float(found.entrance_pupil_diameter) / 2) * (-1 if shift else 1)
        error = pupil_aberration(lens, axis, 3, aim="real")[1]
        assert float(error[-1, 1]) == pytest.approx(expected, rel=1e-6) and abs(expected) > 0.3
        assert len(lens.fields) == 1 or abs(float(error[0, 1])) < 1e-9
    panel = pupil_figure(dome([0.0, angle]), aim="real").axes[1]
    assert panel.lines[1].get_ydata()[10] == pytest.approx(100 * abs(expected) * math.copysign(1, passed), rel=1e-6)
    # A paraxial chief ray of the slope θ where there is no tangent of it.
    rays, tangent = paraxial_rays(dome([0.0, angle])), paraxial_rays(dome([0.0, 45.0]))
    size = math.tan(math.radians(angle)) if angle < 90 else math.radians(angle)
    torch.testing.assert_close(rays.chief_height, size * tangent.chief_height, rtol=1e-12, atol=1e-12)


def test_figures_of_a_lens_beyond_90_degrees():
    lens = dome([0.0, traced_back(math.radians(51.0))])
    titles = [axes.get_xlabel() for axes in field_figure(lens, 5, aim="real").axes]
    assert titles[1] == "distortion from f·θ (%)"
    height, ideal = (line.get_ydata() for line in image_figure(lens, 5, aim="real").axes[0].lines[::-1])
    assert height[-1] == pytest.approx(10 * math.tan(math.radians(51.0)), abs=1e-8)
    bent = distortion(lens, projection="angle", aim="real")[0, 1].item()
    assert height[-1] / ideal[-1] - 1 == pytest.approx(bent, abs=1e-9) and bent > 0.1


@pytest.mark.parametrize("slope", [30.0, 51.0])
def test_waves_from_beyond_90_degrees_start_plane(slope):
    """Paths of a plane wave d·r, on to a sphere about the image point through the stop's centre, by hand."""
    lens = dome([(0.0, traced_back(math.radians(slope)))])
    points = pupil_samples("rings", 2)
    rays = launch(lens, points, aim="real")
    found = trace(lens, rays)
    (start, way), (end, out) = (
        (torch.stack(part[:3], -1)[0, 0], torch.stack(part[3:6], -1)[0, 0]) for part in (rays, found)
    )
    off = end - end[0]
    along, radius = (out * off).sum(-1), math.hypot(10.0, float(end[0, 1]))
    back = along + (along.square() - off.square().sum(-1) + radius**2).sqrt()
    path = (start * way).sum(-1) + found.path[0, 0] - back
    expected = (path - path[0]) / lens.wavelengths[0]
    assert float(expected.abs().max()) > 1
    assert torch.allclose(wavefront(lens, points, aim="real").path[0, 0], expected, rtol=0, atol=1e-9)
