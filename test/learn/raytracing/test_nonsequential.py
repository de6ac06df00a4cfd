"""Non-sequential tracing: energy, closed forms of plates, spheres, guides, discs and corner cubes, gradients."""

import math

import numpy as np
import pytest
import torch

from odak import AccuracyWarning
from odak.catalog import internal_transmittance, refractive_index
from odak.learn.raytracing import (
    Conic,
    Element,
    EvenAsphere,
    GaussianScatter,
    Interface,
    LambertianScatter,
    Light,
    MeasuredScatter,
    Plane,
    RayScene,
    light_source,
    triangle_mesh,
)
from odak.learn.raytracing.system import Coating
from odak.raytracing.apertures import CircularAperture, RectangularAperture
from odak.raytracing.interfaces import HologramPhase, LinearGrating, fresnel, fresnel_shares

WAVE = 550e-6
BLACK, MIRROR = Interface(0, 0), Interface(1, 0)


def tensor(values):
    return torch.tensor(values, dtype=torch.float64)


def balance(found):
    return float(found.absorbed.sum() + found.in_media + found.escaped + found.cut - found.emitted)


def screen(z, interface=BLACK, **options):
    return Element(Plane(), interface=interface, center=(0, 0, z), detects=True, name="screen", **options)


def plate(index=1.5, thickness=3.0, **options):
    media = (1.0, index), (index, 1.0)
    return [Element(Plane(), pair, center=(0, 0, i * thickness), **options) for i, pair in enumerate(media)]


def test_shares_are_the_means_of_fresnels_equations():
    cosine = torch.linspace(0.02, 1, 40, dtype=torch.float64)
    ways = torch.stack([0 * cosine, (1 - cosine**2).sqrt(), cosine], -1)
    for n1, n2 in ((1.0, 1.6), (1.6, 1.0)):
        found = fresnel(ways, tensor([0.0, 0.0, 1.0]).expand(40, 3), n1, n2)
        mean = (found.reflectance_s + found.reflectance_p) / 2
        assert (fresnel_shares(cosine, n1, n2) - mean).abs().max() < 1e-12


@pytest.mark.parametrize("split", [True, False])
def test_a_plate_passes_the_incoherent_sum_of_its_reflections(split):
    light = light_source("collimated", 40 if split else 40_000, size=1.0, center=(0, 0, -1))
    found = RayScene([*plate(), screen(9)]).trace(light, WAVE, split=split, threshold=1e-12)
    one = 0.04
    assert float(found.absorbed[2]) == pytest.approx((1 - one) / (1 + one), abs=1e-9 if split else 6e-3)
    assert float(found.escaped) == pytest.approx(2 * one / (1 + one), abs=1e-9 if split else 6e-3)
    assert abs(balance(found)) < 1e-12


def test_a_coated_plate_reflects_as_its_films_from_both_sides():
    films = Coating((1.38, 2.1), [60e-6, 90e-6])
    front = Element(Plane(), (1.0, 1.5), Interface(coating=films))
    for angle, side in ((0.0, 1), (40.0, 1), (25.0, -1)):
        light = light_source("collimated", 5, center=(0, 0, -side), angles=(angle + 90 - 90 * side, 0, 0))
        found = RayScene([front, screen(side * 9)]).trace(light, WAVE, split=True, threshold=0)
        n1, n2 = (1.0, 1.5)[::side]
        cosine = tensor(math.cos(math.radians(angle)))
        behind = (1 - (n1 / n2) ** 2 * (1 - cosine**2)).sqrt()
        held = (films if side > 0 else films.reversed()).amplitudes(n1, n2, cosine, behind, tensor(WAVE))
        share = (held.transmitted_s.abs() ** 2 + held.transmitted_p.abs() ** 2) / 2
        assert float(found.absorbed[1]) == pytest.approx(float(share), abs=1e-12)
        assert abs(balance(found)) < 1e-12


def test_glass_absorbs_along_the_way():
    glass = "SF6"
    light = light_source("collimated", 5, center=(0, 0, -1))
    found = RayScene([*plate(glass, 25.0), screen(99)]).trace(light, 400e-6, split=True, threshold=0, bounces=3)
    index = refractive_index(glass, 400e-6, "mm", medium="air")
    surface = 1 - ((index - 1) / (index + 1)) ** 2
    assert float(found.absorbed[2]) == pytest.approx(
        surface**2 * internal_transmittance(glass, 400e-9, 0.025), rel=1e-9
    )
    assert float(found.in_media) > 0.1
    assert abs(balance(found)) < 1e-12


def test_polarised_light_through_a_tilted_plate():
    """The incoherent sum holds for each polarisation; the mean of both reflectances at each face is not the same."""
    angle, index = 60.0, 1.5
    found = fresnel(tensor([0.0, math.sin(math.pi / 3), 0.5]), tensor([0.0, 0.0, 1.0]), 1.0, index)
    shares = [(1 - r) / (1 + r) for r in (float(found.reflectance_s), float(found.reflectance_p))]
    light = light_source("collimated", 3, center=(0, 0, -1), angles=(-angle, 0, 0))
    scene = RayScene([*plate(index), screen(9)])
    states = {None: sum(shares) / 2, (1, 0): shares[0], (0, 1): shares[1], (1, 1j): sum(shares) / 2}
    for jones, expected in states.items():
        held = scene.trace(light.polarized(jones), WAVE, split=True, threshold=1e-13)
        assert float(held.absorbed[2]) == pytest.approx(expected, abs=1e-10)
        assert abs(balance(held)) < 1e-12
    drawn = scene.trace(light_source("collimated", 5_000, center=(0, 0, -1), angles=(-60, 0, 0)).polarized(), WAVE)
    assert float(drawn.absorbed[2]) == pytest.approx(sum(shares) / 2, abs=0.02)


def test_a_fresnel_rhomb_makes_circular_light():
    """Two total reflections; tan(δ/2) = cos θ·√(sin²θ − 1/n²)/sin²θ, Born and Wolf (1999), section 1.5.4."""
    index, angle = 1.51, math.radians(54.6167)
    faces = [Element(Plane(), pair, center=(0, 0, z)) for z, pair in ((5, (index, 1.0)), (0, (1.0, index)))]
    way = tensor([0.0, math.sin(angle), math.cos(angle)])
    start = tensor([0.0, 0.0, 2.0])
    end = Element(Plane(), interface=BLACK, center=(0, 12, 2), angles=(90, 0, 0), detects=True, name="end")
    light = Light(torch.stack((start, way))[None], torch.ones(1, dtype=torch.float64)).polarized((1, 1))
    held = RayScene([*faces, end]).trace(light, WAVE, split=True).received["end"]
    sine = math.sin(angle) ** 2
    delta = 2 * math.atan(math.cos(angle) * math.sqrt(sine - 1 / index**2) / sine)
    # Of equal parts s and p with a phase of 2δ between them, |E·E| is |cos 2δ|.
    assert float(held.field.square().sum().abs()) == pytest.approx(abs(math.cos(2 * delta)), abs=1e-12)
    assert float(held.field.square().sum().abs()) < 1e-3
    assert float(held.field.abs().square().sum()) == pytest.approx(1, abs=1e-12)
    assert float((held.field * held.direction).sum().abs()) < 1e-12


def test_polarised_light_has_its_gradients():
    light = light_source("point", 1, half_angle=25, center=(0.1, 0.2, -4.0)).polarized((1, 0.5j))
    films = Coating((1.38,), [100e-6])

    def measured(index, place):
        scatter = Interface(0.3, 0.6, scatter=GaussianScatter(0.5, 0.01))
        parts = [
            Element(Plane(), (1.0, index), Interface(coating=films), angles=(20.0, 10.0, 0.0)),
            Element(Conic(-0.02), (index, 1.0), scatter, center=place),
            screen(9.0),
        ]
        found = RayScene(parts).trace(light, WAVE, split=True, threshold=1e-2, bounces=3)
        return found.absorbed, found.received["screen"].field.abs()

    given = [tensor(1.5), tensor([0.1, 0.0, 3.0])]
    assert torch.autograd.gradcheck(measured, [value.requires_grad_() for value in given], fast_mode=True)


def sphere(radius, interface, port=None):
    hole = None if port is None else CircularAperture(obscures=True, radius=port)
    return [
        Element(Conic(1 / radius), interface=interface, name="half"),
        Element(Conic(-1 / radius), interface=interface, center=(0, 0, 2 * radius), aperture=hole, name="other half"),
    ]


def test_an_integrating_sphere_multiplies_the_irradiance():
    # Labsphere, A guide to integrating sphere theory: M = rho/(1 - rho(1 - f)), f the share of the ports.
    radius, port, white = 10.0, 5.0, 0.9
    height = radius - math.sqrt(radius**2 - port**2)
    exit_plane = Element(
        Plane(), interface=BLACK, center=(0, 0, 2 * radius - height), aperture=port + 1e-9, detects=True, name="port"
    )
    wall = Interface(white, 0.0, scatter=LambertianScatter())
    scene = RayScene([*sphere(radius, wall, port), exit_plane])
    light = light_source("point", 2_000, half_angle=20, center=(0, 0, 6.0), angles=(90, 0, 0))
    found = scene.trace(light, WAVE, threshold=1e-9)
    share = height / (2 * radius)
    expected = white * share / (1 - white * (1 - share))
    assert float(found.absorbed[2]) == pytest.approx(expected, rel=0.08)
    assert abs(balance(found)) < 1e-9
    assert float(found.escaped) < 1e-12


def test_a_lambertian_disc_illuminates_its_axis():
    # E = power/area * sin^2 of the half angle that the disc subtends.
    light = light_source("lambertian", 200_000, size=5.0)
    target = screen(5.0, aperture=0.5)
    found = RayScene([target]).trace(light, WAVE)
    expected = 1 / (math.pi * 25) * 0.5 * math.pi * 0.25
    assert float(found.absorbed[0]) == pytest.approx(expected, rel=0.02)


def guide(core, cladding, side, length):
    half = side / 2
    wall = RectangularAperture(half_width=half, half_height=length / 2)
    middle = length / 2
    places = [((0, half, middle), (-90, 0, 0)), ((0, -half, middle), (90, 0, 0))]
    walls = [Element(Plane(), (core, cladding), center=c, angles=a, aperture=wall) for c, a in places]
    places = [((half, 0, middle), (0, 90, 0)), ((-half, 0, middle), (0, -90, 0))]
    wall = RectangularAperture(half_width=length / 2, half_height=half)
    walls += [Element(Plane(), (core, cladding), center=c, angles=a, aperture=wall) for c, a in places]
    end = RectangularAperture(half_width=half, half_height=half)
    faces = [Element(Plane(), (1.0, core), aperture=end)]
    return [*walls, *faces, Element(Plane(), (core, 1.0), center=(0, 0, length), aperture=end)]


def test_a_light_guide_accepts_its_numerical_aperture():
    core, cladding = 1.5, 1.45
    aperture = math.sqrt(core**2 - cladding**2)
    scene = RayScene(
        [
            *guide(core, cladding, 1.0, 60.0),
            screen(60.001, aperture=RectangularAperture(half_width=0.5, half_height=0.5)),
        ]
    )
    passed = []
    for sine in (0.97 * aperture, 1.03 * aperture):
        angle = math.degrees(math.asin(sine))
        light = light_source("collimated", 60, (0.8, 0.3), center=(0, -0.1, -0.2), angles=(-angle, 0, 0))
        # The first passage alone: each way out is reached after two faces and the reflections at the walls.
        found = scene.trace(light, WAVE, split=True, threshold=1e-3)
        assert abs(balance(found)) < 1e-12
        passed.append(float(found.absorbed[-1]))
    assert passed[0] > 0.9
    assert passed[1] < 0.01


def corner(size=10.0):
    points = tensor([[0.0, 0, 0], [size, 0, 0], [0, size, 0], [0, 0, size]])
    return triangle_mesh(points, torch.tensor([[0, 1, 2], [0, 2, 3], [0, 3, 1]]), backend="torch")


def test_a_corner_cube_returns_rays_the_way_they_came():
    way = tensor([-0.5, -0.65, -0.6])
    way = way / way.norm()
    start = tensor([2.0, 2.0, 2.0]) - 20 * way + 0.3 * torch.rand(50, 3, dtype=torch.float64)
    light = Light(torch.stack((start, way.expand(50, 3)), 1), torch.ones(50, dtype=torch.float64))
    found = RayScene([Element(corner(), interface=MIRROR)]).trace(light, WAVE, paths=True)
    last = found.segments[found.segment_rays.argsort(stable=True)].reshape(50, 4, 2, 3)[:, 3]
    ways = last[:, 1] - last[:, 0]
    assert (ways / ways.norm(dim=1, keepdim=True) + way).abs().max() < 1e-12
    assert float(found.escaped) == pytest.approx(50)


def test_a_mesh_and_planes_make_the_same_cube_of_glass():
    corners = tensor([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (0.0, 6.0)])
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = torch.tensor([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))])
    mesh = triangle_mesh(corners, faces, backend="torch")
    light = light_source("lambertian", 50, (0.8, 0.8), half_angle=30, center=(0.02, 0.01, -0.1))
    both = []
    for parts in ([Element(mesh, (1.6, 1.0))], guide(1.6, 1.0, 1.0, 6.0)):
        scene = RayScene([*parts, screen(6.2, aperture=1.0)])
        both.append(scene.trace(light, WAVE, split=True, threshold=1e-2))
    assert float(both[0].absorbed[-1]) == pytest.approx(float(both[1].absorbed[-1]), abs=1e-10)
    assert 0.7 < float(both[0].absorbed[-1]) < 1
    assert all(abs(balance(found)) < 1e-12 for found in both)


def test_etendue_is_kept_by_a_lens():
    # The map of (x, y, p, q), direction cosines times the index, has the determinant 1: Liouville's theorem.
    lens = [
        Element(EvenAsphere(0.05, 0.0, (1e-5,)), (1.0, 1.7), aperture=8.0),
        Element(Conic(-0.02), (1.7, 1.0), center=(0, 0, 4), angles=(3.0, -2.0, 0.0), aperture=8.0),
    ]
    scene = RayScene([Element(Plane(), interface=Interface(0, 1), center=(0, 0, -4)), *lens, screen(30)])

    def through(state):
        x, y, p, q = state
        way = torch.stack((p, q, (1 - p * p - q * q).sqrt()))
        start = torch.stack((x, y, 0 * x - 5)) - way / way[2]
        light = Light(torch.stack((start, way))[None], torch.ones(1, dtype=torch.float64))
        found = scene.trace(light, WAVE, split=True, threshold=0.5).received["screen"]
        return torch.cat((found.point[0, :2], found.direction[0, :2]))

    matrix = torch.autograd.functional.jacobian(through, tensor([1.5, -2.0, 0.1, 0.05]))
    assert float(torch.linalg.det(matrix)) == pytest.approx(1, abs=1e-10)


def test_gradients_are_those_of_finite_differences():
    light = light_source("point", 6, half_angle=8, center=(0.2, 0.1, -10.0))

    def measured(index, curvature, place, share):
        wall = Interface(share, 0.5, scatter=GaussianScatter(0.5, 0.01 * share))
        parts = [
            Element(Conic(curvature), (1.0, index), aperture=4.0),
            Element(Plane(), (index, 1.0), wall, center=place, angles=(2.0, 1.0, 0.0)),
            screen(15.0),
        ]
        found = RayScene(parts).trace(light, WAVE, split=True, threshold=1e-3, bounces=4)
        held = found.received["screen"]
        return found.absorbed, (held.power * held.point[:, 0] * held.path).sum(), held.irradiance((4.0, 4.0), (3, 3))

    given = [tensor(1.5), tensor(0.05), tensor([0.1, 0.0, 3.0]), tensor(0.3)]
    assert torch.autograd.gradcheck(measured, [value.requires_grad_() for value in given], fast_mode=True)


def test_the_gradient_of_the_wavelength_goes_through_glass():
    """At normal incidence a surface passes 4n/(n + 1)² of the light; a micrometre of glass absorbs none."""
    wave = tensor(WAVE).requires_grad_()
    light = light_source("collimated", 4, center=(0, 0, -1))
    scene = RayScene([Element(Plane(), (1.0, "N-BK7")), screen(1e-3, media=("N-BK7", "N-BK7"))])
    power = scene.trace(light, wave, split=True, threshold=1e-12).received["screen"].power.sum()
    index = refractive_index("N-BK7", wave, "mm")
    (found,), (wanted,) = (
        torch.autograd.grad(v, wave, retain_graph=True) for v in (power, 4 * index / (index + 1) ** 2)
    )
    assert float(found) == pytest.approx(float(wanted), rel=1e-3)
    assert abs(float(wanted)) > 1


def test_drawn_ways_have_the_gradient_of_their_mean():
    share = tensor(0.3).requires_grad_()
    mirror = Element(Plane(), interface=Interface(share, 1 - share))
    light = light_source("collimated", 40_000, center=(0, 0, -1))
    found = RayScene([mirror, screen(5)]).trace(light, WAVE, seed=3)
    (slope,) = torch.autograd.grad(found.absorbed[1], share)
    assert float(found.absorbed[1].detach()) == pytest.approx(0.7, abs=0.01)
    assert float(slope) == pytest.approx(-1, abs=0.01)


def scattered(scatter, angle=0.0, count=100_000, interface=None):
    light = light_source("collimated", count, center=(0, 0, -1), angles=(-angle, 0, 0))
    wall = Element(Plane(), interface=interface or Interface(1, 0, scatter=scatter))
    dome = Element(Plane(), interface=BLACK, center=(0, 0, -1e-3), detects=True, name="dome")
    way = light.rays[:, 1]
    start = way * (-5e-4)
    return RayScene([wall, dome]).trace(Light(torch.stack((start, way), 1), light.power), WAVE, split=True)


def test_lambertian_walls_send_out_the_cosine():
    held = scattered(LambertianScatter(), 50.0).received["dome"]
    cosine = held.direction[:, 2].abs()
    assert float((held.power * cosine).sum()) == pytest.approx(2 / 3, abs=3e-3)
    found = held.intensity((20, 20))
    # 1/pi on the axis.
    assert float(found[9:11, 9:11].mean()) == pytest.approx(1 / math.pi, rel=0.05)


def test_gaussian_scattering_has_its_width_and_share():
    held = scattered(GaussianScatter(0.4, 0.05), 30.0).received["dome"]
    aside = held.direction[:, :2] - tensor([0.0, 0.5])
    moved = aside.abs().amax(1) > 1e-9
    assert float(held.power[moved].sum()) == pytest.approx(0.4, abs=5e-3)
    assert float(aside[moved].std()) == pytest.approx(0.05, rel=0.02)


def test_abg_scattering_sends_its_share_into_a_cone():
    a, b = 2e-3, 1e-3
    model = MeasuredScatter.abg(a, b, 2.0)
    held = scattered(model, 0.0).received["dome"]
    radius = held.direction[:, :2].norm(dim=1)
    for inner, outer in ((1e-6, 0.03), (0.03, 0.2), (0.2, 1.0)):
        expected = math.pi * a * math.log((b + outer**2) / (b + inner**2))
        chosen = (radius > inner) & (radius <= outer)
        assert float(held.power[chosen].sum()) == pytest.approx(expected, rel=0.03)
    # What would fall below the horizon keeps its direction.
    assert abs(float(held.power.sum()) - 1) < 1e-9


def test_harveys_model_is_abg_with_a_square():
    one, two = MeasuredScatter.harvey(2.0, 0.03, -2.0), MeasuredScatter.abg(2.0 * 0.03**2, 0.03**2, 2.0)
    assert float(one.share) == pytest.approx(float(two.share), rel=1e-9)
    assert float(two.share) == pytest.approx(math.pi * 0.0018 * math.log(1 + 4 / 0.0009), rel=1e-5)


def test_a_grating_divides_light_among_its_orders():
    lines, index, angle = 900.0, 1.6, 10.0
    efficiencies = {0: 0.3, 1: 0.4, -1: lambda place, way: 0.1 * way[:, 2] + place[:, 2]}
    # The first reflected order of 2000 lines does not exist at this angle: its share is absorbed.
    grating = Interface({0: 0.05}, efficiencies, phase=LinearGrating(0.0, lines))
    light = light_source("collimated", 3, center=(0, 0, -1), angles=(-angle, 0, 0))
    found = RayScene([Element(Plane(), (1.0, index), grating), screen(3)]).trace(light, WAVE, split=True)
    held = found.received["screen"]
    sines = held.direction[:, 1].reshape(3, 3)[:, 0] * index
    start = math.sin(math.radians(angle))
    expected = [start, start + WAVE * lines, start - WAVE * lines]
    assert sines.tolist() == pytest.approx(expected, abs=1e-12)
    shares = held.power.reshape(3, 3).sum(1).tolist()
    assert shares == pytest.approx([0.3, 0.4, 0.1 * math.cos(math.radians(angle))], abs=1e-12)
    assert abs(balance(found)) < 1e-12


LINES, INDEX, THICKNESS = 1 / 400e-6, 1.8, 0.8


def expander(coupling, length=30.0):
    """A plate with an in-coupler at y = 0 and an out-coupler of the same lines behind it, and the eye's plane."""
    lines = LinearGrating(0.0, LINES)
    inner = RectangularAperture(half_width=1.0, half_height=0.5)
    outer = RectangularAperture(center=(0.0, 0.5 + length / 2), half_width=9.0, half_height=length / 2)
    back = lambda place, way: 1 - coupling(place)  # noqa: E731
    out = lambda place, way: coupling(place)  # noqa: E731
    edge = RectangularAperture(half_width=9.0, half_height=THICKNESS)
    end = {"center": (0, 0.5 + length, THICKNESS / 2), "angles": (-90, 0, 0), "aperture": edge}
    return RayScene(
        [
            Element(Plane(), interface=BLACK, name="end", **end),
            Element(Plane(), (1.0, INDEX), Interface({}, {1: 1.0}, phase=lines), aperture=inner, name="in"),
            Element(Plane(), (1.0, INDEX), Interface({0: back}, {-1: out}, phase=lines), aperture=outer, name="out"),
            Element(Plane(), (INDEX, 1.0), center=(0, 0, THICKNESS), name="rear"),
            screen(-5.0),
        ]
    )


def test_an_expander_sends_light_out_as_it_came_in():
    steep = 0.0
    for angle in (-6.0, 0.0, 4.0):
        light = light_source("collimated", 20, (0.4, 0.4), center=(0, 0, -0.1), angles=(-angle, 5.0, 0.0))
        found = expander(lambda place: 0.1 + 0 * place[:, 0]).trace(light, WAVE, split=True, threshold=1e-4, paths=True)
        held = found.received["screen"]
        assert len(held.power) > 250
        way = light.rays[0, 1] * tensor([1.0, 1.0, -1.0])
        assert (held.direction - way).abs().max() < 1e-12
        # Places of exit are apart by twice the thickness times the tangent of the guided angle.
        inside = (light.rays[0, 1, :2] + tensor([0.0, WAVE * LINES])) / INDEX
        hop = 2 * THICKNESS * inside / (1 - inside.square().sum()).sqrt()
        one = held.point[held.ray == 3]
        steps = one[one[:, 1].argsort()].diff(dim=0)
        assert (steps[:, :2] - hop).abs().max() < 1e-9
        # Total reflections at the rear face of a ray that stays to the end: in the middle of each hop.
        rear = (found.segments[found.segment_rays == 3][:, 1, 2] - THICKNESS).abs() < 1e-9
        start = light.rays[3, 0, 1] - light.rays[3, 0, 2] * light.rays[3, 1, 1] / light.rays[3, 1, 2]
        assert int(rear.sum()) == math.floor((30.5 - float(start)) / float(hop[1]) + 0.5)
        assert abs(balance(found)) < 1e-12 and hop[1] > steep
        steep = hop[1]


def test_a_graded_out_coupler_fills_the_eye_evenly():
    sine = WAVE * LINES / INDEX
    hop = 2 * THICKNESS * sine / math.sqrt(1 - sine**2)
    count = 8
    light = light_source("collimated", 50, (0.2, 0.2), center=(0, 0, -1))
    graded = lambda place: 1 / (count + 1 - (place[:, 1] / hop).round()).clamp(min=1.0)  # noqa: E731
    held = expander(graded, 8 * hop).trace(light, WAVE, split=True).received["screen"]
    shares = torch.zeros(count, dtype=torch.float64)
    shares = shares.index_add(0, (held.point[:, 1] / hop).round().long() - 1, held.power)
    assert shares.tolist() == pytest.approx([1 / count] * count, abs=1e-9)


def test_an_expander_in_two_directions_fills_a_lattice():
    """Periods of 473.12 nm to couple in and out and of 332.43 nm to turn, Sci. Rep. 14 (2024),
    doi:10.1038/s41598-024-75766-7, figure 7: the three grating vectors close a triangle, which turns light by 90.73
    degrees. Every exit is a whole number of hops along both ways, with the product of the shares of its hops.
    """
    outer, inner, index, thickness, fold, share = 473.12e-6, 332.43e-6, 1.9, 0.5, 0.3, 0.25
    turn = 2 * math.asin(outer / inner / 2)
    assert math.degrees(turn) == pytest.approx(90.73, abs=0.005)
    first = tensor([0.0, 1 / outer])
    second = tensor([math.sin(turn), math.cos(turn)]) / outer
    couple, bend = LinearGrating(*first.tolist()), LinearGrating(*(second - first).tolist())
    assert float((second - first).norm()) == pytest.approx(1 / inner, rel=1e-12)
    gratings = [
        (Interface({}, {1: 1.0}, phase=couple), (0.0, 0.0), (0.3, 0.3)),
        (Interface({0: 1 - fold, 1: fold}, {}, phase=bend), (0.0, 5.35), (0.35, 5.0)),
        (
            Interface({0: 1 - share}, {-1: share}, phase=LinearGrating(*second.tolist())),
            (8.35, 5.35),
            (8.0, 6.0),
        ),
    ]
    parts = [
        Element(Plane(), (1.0, index), what, aperture=RectangularAperture(center=place, half_width=w, half_height=h))
        for what, place, (w, h) in gratings
    ]
    rear = Element(Plane(), (index, 1.0), center=(0, 0, thickness))
    light = light_source("collimated", 10, (0.2, 0.2), center=(0, 0, -0.01), angles=(-1.0, 2.0, 0.0))
    # Light that is guided to the ends of the gratings passes the screen by.
    eye = screen(-5.0, aperture=RectangularAperture(center=(8.35, 5.35), half_width=8.6, half_height=7.5))
    found = RayScene([*parts, rear, eye]).trace(light, WAVE, split=True, threshold=1e-9)
    held, way = found.received["screen"], light.rays[0, 1]
    assert len(held.power) > 500 and (held.direction - way * tensor([1.0, 1.0, -1.0])).abs().max() < 1e-12
    hops = []
    for lines in (first, second):
        inside = (way[:2] + WAVE * lines) / index
        hops.append(2 * thickness * inside / (1 - inside.square().sum()).sqrt())
    # Back from the screen to the plate, and from there to the point where the ray came in.
    out = held.point[:, :2] - 5.0 * way[:2] / way[2]
    start = light.rays[:, 0, :2] - light.rays[:, 0, 2:] * way[:2] / way[2]
    counts = torch.linalg.solve(torch.stack(hops, -1), (out - start[held.ray]).T)
    whole = counts.round()
    assert (counts - whole).abs().max() < 1e-9 and float(whole.min()) == 1 and float(whole[1].max()) > 10
    a, b = whole
    expected = fold * (1 - fold) ** (a - 1) * share * (1 - share) ** (b - 1) / 10
    torch.testing.assert_close(held.power, expected, rtol=1e-12, atol=0)
    assert abs(balance(found)) < 1e-12


def test_a_hologram_couples_light_as_its_lines_do():
    n, pitch = 64, 2e-3
    ramp = 2 * math.pi * 100.0 * pitch * (torch.arange(n, dtype=torch.float64) - n // 2)
    shares = {1: 0.8}
    light = light_source("collimated", 20, 0.02, center=(0, 0, -1))
    ways = []
    for phase in (HologramPhase(ramp.expand(n, n), pitch), LinearGrating(100.0)):
        parts = [Element(Plane(), interface=Interface({}, shares, phase=phase)), screen(2)]
        ways.append(RayScene(parts).trace(light, WAVE, split=True).received["screen"].direction)
    assert (ways[0] - ways[1]).abs().max() < 1e-9


def test_orders_that_do_not_propagate_are_absorbed():
    grating = Interface({}, {0: 0.5, 1: 0.5}, phase=LinearGrating(2500.0))
    light = light_source("collimated", 3, center=(0, 0, -1))
    found = RayScene([Element(Plane(), interface=grating), screen(3)]).trace(light, WAVE)
    assert float(found.absorbed[0]) == pytest.approx(0.5)


@pytest.mark.parametrize("split", [True, False])
def test_a_plane_wave_behind_a_grating_is_plane(split):
    frequency, distance = 600.0, 20.0
    grating = Interface({}, {0: 0.3, 1: 0.7}, phase=LinearGrating(0.0, frequency))
    light = light_source("collimated", 64, size=2.0, center=(0, 0, -1))
    for order in (0, 1):
        sine = order * WAVE * frequency
        center = (0, distance * sine, distance * math.sqrt(1 - sine * sine))
        across = Element(Plane(), interface=BLACK, center=center, angles=(-math.degrees(math.asin(sine)), 0, 0))
        across.detects, across.name, across.aperture = True, "across", 3.0
        found = RayScene([Element(Plane(), interface=grating), across]).trace(light, WAVE, split=split)
        assert (found.received["across"].path - (1 + distance)).abs().max() < 1e-12


def test_light_beside_a_hologram_is_absorbed():
    phase = HologramPhase(torch.zeros(16, 16, dtype=torch.float64), 0.1)
    parts = [Element(Plane(), interface=Interface({}, {0: 1.0}, phase=phase)), screen(2)]
    rays = tensor([[[0, 0.3, -1], [0, 0, 1]], [[0, 5.0, -1], [0, 0, 1]]])
    found = RayScene(parts).trace(Light(rays, tensor([1.0, 1.0])), WAVE)
    assert found.received["screen"].ray.tolist() == [0] and found.absorbed.tolist() == [1, 1]


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_a_tilted_board_does_not_stop_the_light_of_its_own_source(dtype):
    center, angles = torch.tensor([1.3, 2.7, -3.1], dtype=dtype), (33.0, 21.0, 7.0)
    light = light_source("lambertian", 5_000, size=(1.0, 1.0), center=center, angles=angles)
    corners = torch.tensor([[-3, -3, 0], [3, -3, 0], [-3, 3, 0], [3, 3, 0]], dtype=dtype)
    for board in (Plane(), triangle_mesh(corners, torch.tensor([[0, 1, 2], [1, 3, 2]]))):
        found = RayScene([Element(board, interface=BLACK, center=center, angles=angles)]).trace(light, WAVE)
        assert float(found.absorbed[0]) == 0


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_thin_films_of_glass_end_at_their_second_face(dtype):
    faces = [Element(Conic(0.02), (1.0, 1.5), aperture=9.0)]
    faces.append(Element(Conic(0.02), (1.5, 1.0), BLACK, center=(0, 0, 0.01), aperture=9.0))
    light = light_source("collimated", 50, size=5.0, center=tensor([0, 0, -100.0]).to(dtype))
    found = RayScene(faces).trace(light, WAVE, split=True)
    assert float(found.absorbed[1]) == pytest.approx(0.96, abs=1e-3)


@pytest.mark.parametrize("split", [True, False])
def test_media_that_do_not_agree_are_told(split, recwarn):
    light = light_source("collimated", 100, size=1.0, center=(0, 0, -1))
    parts = [Element(Plane(), (1.0, 1.5)), Element(Plane(), (1.0, 1.5), center=(0, 0, 3), name="rear"), screen(9)]
    with pytest.warns(AccuracyWarning, match=r"meets 'rear' \(9\d % of the light\)"):
        RayScene(parts).trace(light, WAVE, split=split, seed=5)
    recwarn.clear()
    RayScene([*plate(), screen(9)]).trace(light, WAVE, split=split)
    assert not recwarn.list


def test_directions_may_be_of_any_length():
    light = light_source("point", 50, half_angle=20.0, center=(0, 0, -1))
    longer = light.rays * tensor([1.0, 3.0])[:, None]
    parts = [*plate(angles=(30.0, 0.0, 0.0)), screen(9)]
    given, found = (
        RayScene(parts).trace(Light(rays, light.power), WAVE, split=True).received["screen"]
        for rays in (light.rays, longer)
    )
    for name in ("point", "direction", "power", "path"):
        assert (getattr(found, name) - getattr(given, name)).abs().max() < 1e-12


def test_a_seed_repeats_a_trace():
    light = light_source("point", 500, center=(0, 0, 8.0))
    scene = RayScene(sphere(10.0, Interface(0.5, 0.3, scatter=LambertianScatter(0.7))))
    one, two, other = (scene.trace(light, WAVE, seed=seed) for seed in (1, 1, 2))
    assert torch.equal(one.absorbed, two.absorbed) and not torch.equal(one.absorbed, other.absorbed)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Interface(0.7, 0.7), "at most 1, got 1.4"),
        (lambda: Interface(0.7), "both or neither"),
        (lambda: Interface(0.5, 0.5, coating=Coating()), "coating gives"),
        (lambda: Element(Plane(), media=(1.0,)), "media must be two"),
        (lambda: Element(Plane(), media=(1.0, -1.0)), "media must be"),
        (lambda: Element(corner(), aperture=1.0), "aperture belongs"),
        (lambda: RayScene([]), "one at least"),
        (lambda: light_source("point", 5).polarized((0, 0)), "jones must be"),
        (lambda: RayScene([Element(Plane(), name="a"), Element(Plane(), name="a")]), "different names"),
        (lambda: light_source("point", 5, size=1.0), "size must be"),
        (lambda: light_source("lambertian", 5, half_angle=120), "from 0 to 90"),
        (lambda: MeasuredScatter([0.0, 1.0], [1.0, 1.0]), "at most 1"),
        (lambda: MeasuredScatter([0.1, 1.0], [0.1, 0.1]), "ascend from 0"),
        (lambda: GaussianScatter(1.5), "at most 1"),
    ],
)
def test_bad_arguments_are_named(make, message):
    with pytest.raises(ValueError, match=message):
        make()


def test_the_edge_of_a_cone_behind_a_lens_is_that_of_snells_law():
    """The lens of `benchmarks/nonsequential.py`: a ray of 10° in its plane, spheres of 50 mm about z = 100 and 8."""
    angle = math.radians(10.0)
    y, z, way, power = 0.0, 0.0, angle, 1.0
    for middle, side, n1, n2 in ((100.0, -1, 1.0, 1.6), (8.0, 1, 1.6, 1.0)):
        along = y * math.sin(way) + (z - middle) * math.cos(way)
        distance = -along + side * math.sqrt(along**2 - y**2 - (z - middle) ** 2 + 50.0**2)
        y, z = y + distance * math.sin(way), z + distance * math.cos(way)
        normal = math.asin(side * y / 50.0)
        incident = way - normal
        refracted = math.asin(n1 / n2 * math.sin(incident))
        s = math.sin(incident - refracted) / math.sin(incident + refracted)
        p = math.tan(incident - refracted) / math.tan(incident + refracted)
        way, power = normal + refracted, power * (1 - (s * s + p * p) / 2)
    faces = [
        Element(Conic(1 / 50.0), (1.0, 1.6), center=(0, 0, 50.0), aperture=15.0),
        Element(Conic(-1 / 50.0), (1.6, 1.0), center=(0, 0, 58.0), aperture=15.0),
        Element(Plane(), interface=Interface(0, 0), center=(0, 0, 120.0), detects=True, name="screen"),
    ]
    ray = torch.tensor([[[0, 0, 0], [0, math.sin(angle), math.cos(angle)]]], dtype=torch.float64)
    found = RayScene(faces).trace(Light(ray, torch.ones(1, dtype=torch.float64)), 550e-6, split=True).received["screen"]
    assert float(found.point[0, 1]) == pytest.approx(y + (120 - z) * math.tan(way), rel=1e-13)
    assert float(found.point[0, 1]) == pytest.approx(6.02189, abs=5e-6)
    assert float(found.power[0]) == pytest.approx(power, rel=1e-12)


@pytest.mark.parametrize("as_sides", [list, np.asarray, torch.tensor])
def test_two_sides_may_be_an_array(as_sides):
    screen = Element(Plane(), interface=Interface(0.0, 0.0), center=(0, 0, 5), detects=True, name="screen")
    # Of two rays, which an array of two numbers would broadcast with.
    light = light_source("collimated", 2, as_sides([2.0, 3.0]))
    assert torch.equal(light.rays, light_source("collimated", 2, (2.0, 3.0)).rays)
    received = RayScene([screen]).trace(light, 550e-6).received["screen"]
    found = received.irradiance(as_sides([2.0, 3.0]), (3, 2))
    assert torch.equal(found, received.irradiance((2.0, 3.0), (3, 2)))
    assert float(found.sum()) == pytest.approx(1.0)  # a power of 1 in pixels of an area of 1
    with pytest.raises(ValueError, match=r"size must be one number or two, got an array of shape \(3,\)"):
        received.irradiance(torch.ones(3))
