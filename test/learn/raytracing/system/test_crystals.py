"""Extraordinary waves in uniaxial crystals against closed forms, Malus's theorem and finite differences."""

import math

import pytest
import torch

from odak.catalog import refractive_index
from odak.learn.raytracing.system import (
    Rays,
    UniaxialMedium,
    coordinate_break,
    first_order,
    launch,
    layout_figure,
    load_system,
    optical_system,
    polarized_trace,
    save_system,
    surface,
    trace,
)
from odak.raytracing import RayStatus

# Calcite at 589.3 nm.
ORDINARY, OTHER = 1.65835, 1.48641
F64 = torch.float64


def plate(axis, thickness=10.0, fields=(0.0,), **kinds):
    crystal = UniaxialMedium(axis, [OTHER])
    return optical_system(
        [surface(thickness=thickness, material=ORDINARY, gradient=crystal, **kinds), surface(thickness=5.0)],
        1.0,
        fields=list(fields),
    )


def bundle(directions, points):
    """Return rays [1, 1, P] from points in the plane z = 0."""
    x, y = points.unbind(-1)
    u, v, w = (directions / directions.norm(dim=-1, keepdim=True)).unbind(-1)
    return Rays(*(value.reshape(1, 1, -1) for value in (x, y, 0 * x, u, v, w)))


@pytest.mark.parametrize("angle", [15.0, 45.0, 70.0])
def test_walk_off_and_path_at_normal_incidence(angle):
    """A. Yariv and P. Yeh, Optical Waves in Crystals (1984), section 4.2: tan of the walk-off, and the index."""
    tilt = math.radians(angle)
    lens = plate((0.0, math.sin(tilt), math.cos(tilt)))
    found = trace(lens, launch(lens, "y", 1), until=1)
    sine, cosine = math.sin(tilt), math.cos(tilt)
    index = ORDINARY * OTHER / math.hypot(ORDINARY * sine, OTHER * cosine)
    # Calcite is negative: the ray turns away from the optic axis.
    shift = 10 * index**2 * sine * cosine * (ORDINARY**-2 - OTHER**-2)
    assert float(found.y) == pytest.approx(shift, abs=1e-13) and shift < -0.5
    assert float(found.path) == pytest.approx(10 * index, rel=1e-14)
    assert float(found.v) == 0.0
    behind = trace(lens, launch(lens, "y", 1))
    assert float(behind.y) == pytest.approx(shift, abs=1e-13) and float(behind.v) == pytest.approx(0, abs=1e-15)


def test_double_refraction_angles_of_the_principal_cuts():
    """Angles of rays for axes along the normal, across the plane of incidence, and in the surface and that plane."""
    sine = math.sin(math.radians(40.0))
    expected = {
        (0.0, 0.0, 1.0): ORDINARY * sine / (OTHER * math.sqrt(OTHER**2 - sine**2)),
        (1.0, 0.0, 0.0): sine / math.sqrt(OTHER**2 - sine**2),
        (0.0, 1.0, 0.0): OTHER * sine / (ORDINARY * math.sqrt(ORDINARY**2 - sine**2)),
    }
    for axis, tangent in expected.items():
        lens = plate(axis, fields=[40.0])
        points = [trace(lens, launch(lens, "y", 1), until=i) for i in (0, 1)]
        assert float(points[1].y - points[0].y) / 10 == pytest.approx(tangent, rel=1e-13), axis
        assert float(trace(lens, launch(lens, "y", 1)).v) == pytest.approx(sine, rel=1e-13)
    # The ordinary wave of the same plate is that of its material.
    glass = optical_system([surface(thickness=10.0, material=ORDINARY), surface(thickness=5.0)], 1.0, fields=[40.0])
    found = trace(glass, launch(glass, "y", 1), until=1)
    start = trace(glass, launch(glass, "y", 1), until=0)
    assert float(found.y - start.y) / 10 == pytest.approx(sine / math.sqrt(ORDINARY**2 - sine**2), rel=1e-13)


@pytest.mark.parametrize("place", [{}, {"tilt": (11.0, -7.0, 20.0), "shift": (0.4, -0.3)}])
def test_rays_stay_normal_to_their_waves_behind_curved_and_tilted_faces(place):
    """Malus and Dupin: the slope of the optical path over a plane behind is the direction of the rays."""
    crystal = UniaxialMedium((0.3, -0.5, 0.8), [OTHER])
    rows = [surface(30.0, thickness=8.0, material=ORDINARY, gradient=crystal, **place), surface(-40.0, thickness=6.0)]
    lens = optical_system(rows, 1.0)
    points = torch.tensor([[0.7, -1.1], [-1.5, 0.4], [0.2, 2.0]], dtype=F64, requires_grad=True)
    tilted = torch.tensor([0.1, 0.05, 1.0], dtype=F64)
    found = trace(lens, bundle(tilted.expand(3, 3), points))
    assert bool((found.status == RayStatus.HIT).all())
    # A plane wave in front: its phase over z = 0 is the tilt times the place.
    phase = found.path + (points @ (tilted / tilted.norm())[:2])
    slopes = torch.autograd.grad(phase.sum(), points, retain_graph=True)[0]
    moved = [torch.autograd.grad(value.sum(), points, retain_graph=True)[0] for value in (found.x, found.y)]
    way = torch.stack([found.u, found.v], -1).reshape(3, 2)
    assert torch.allclose(slopes, moved[0] * way[:, :1] + moved[1] * way[:, 1:], rtol=0, atol=1e-12)


def test_first_order_is_that_of_real_rays_near_the_axis():
    for axis in ((0.0, 0.0, 1.0), (0.0, 1.0, 0.0), (1.0, 0.0, 0.0)):
        crystal = UniaxialMedium(axis, [OTHER])
        rows = [surface(30.0, thickness=8.0, material=ORDINARY, gradient=crystal), surface(-40.0, thickness=6.0)]
        lens = optical_system(rows, 1.0)
        for section, name in ((0, "u"), (1, "v")):
            points = torch.zeros(1, 2, dtype=F64)
            points[0, section] = 1e-5
            found = trace(lens, bundle(torch.tensor([[0.0, 0.0, 1.0]], dtype=F64), points))
            focal = -1e-5 / float(getattr(found, name))
            computed = float(first_order(lens, axis="xy"[section]).focal_length)
            assert computed == pytest.approx(focal, rel=1e-8), (axis, name)


@pytest.mark.parametrize("angle", [0.0, 0.4])
def test_gradients_are_finite_along_the_optic_axis_and_right_elsewhere(angle):
    """By the axis, the extraordinary and the ordinary index, against central differences."""

    def end(values, parameter=lambda value: value):
        held = [parameter(torch.tensor(value, dtype=F64)) for value in (values[:3], values[3:4], values[4])]
        crystal = UniaxialMedium(*held[:2])
        lens = optical_system(
            [surface(20.0, thickness=5.0, material=held[2], gradient=crystal), surface(thickness=3.0)], 2.0
        )
        found = trace(lens, launch(lens, "rings", 2))
        return found.x.sum() + found.y.square().sum() + found.path.sum(), held

    start = [0.6 * math.sin(angle), 0.8 * math.sin(angle), math.cos(angle), OTHER, ORDINARY]
    value, held = end(start, torch.nn.Parameter)
    slopes = torch.cat([slope.reshape(-1) for slope in torch.autograd.grad(value, held)])
    for i, slope in enumerate(slopes.tolist()):
        ends = [float(end([v + side * 1e-5 * (k == i) for k, v in enumerate(start)])[0]) for side in (1, -1)]
        assert slope == pytest.approx((ends[0] - ends[1]) / 2e-5, rel=1e-5, abs=1e-6), i
    crystal, along = UniaxialMedium((0.0, 0.0, 1.0), [OTHER]), (0.0, 0.0, 1.0)
    assert crystal.retardance(along, ORDINARY) == pytest.approx(0, abs=1e-15)
    assert crystal.retardance((1.0, 0.0, 0.0), ORDINARY) == pytest.approx(OTHER - ORDINARY, abs=1e-14)


def test_two_crystals_part_the_waves_of_a_wollaston_prism():
    """The wave that is extraordinary first and ordinary then leaves at n_e·sin of the wedge's refraction."""
    wedge = math.radians(20.0)
    first = surface(thickness=6.0, material=ORDINARY, gradient=UniaxialMedium((0.0, 1.0, 0.0), [OTHER]))
    # Behind the tilted cut the same wave is ordinary, along x lies the other optic axis.
    cut = surface(thickness=6.0, material=ORDINARY, tilt=(20.0, 0.0, 0.0))
    prism = optical_system([first, cut, surface(thickness=5.0)], 1.0)
    found = trace(prism, launch(prism, "y", 1))
    inside = wedge - math.asin(OTHER * math.sin(wedge) / ORDINARY)
    assert abs(float(found.v)) == pytest.approx(ORDINARY * math.sin(inside), rel=1e-12)
    assert float(found.path) > 0


def test_crystals_of_the_catalogue_travel_in_files_and_are_drawn(tmp_path):
    crystal = UniaxialMedium.of("calcite", (0.0, 1.0, 1.0))
    material = "calcite (ordinary)"
    waves = [450e-6, 550e-6, 650e-6]
    lens = optical_system(
        [surface(thickness=10.0, material=material, gradient=crystal), surface(thickness=5.0)], 1.0, wavelengths=waves
    )
    for wave in waves:
        names = ("calcite (ordinary)", "calcite (extraordinary)")
        base, expected = (float(refractive_index(name, wave * 1e-3)) for name in names)
        assert crystal.ray((1.0, 0.0, 0.0), base)[2] == pytest.approx(expected, abs=3e-6)
    save_system(lens, tmp_path / "plate.json")
    again = load_system(tmp_path / "plate.json")
    assert trace(again, launch(again, "y", 3)).y.tolist() == trace(lens, launch(lens, "y", 3)).y.tolist()
    layout_figure(lens)


def test_what_is_not_computed_is_refused():
    lens = plate((0.0, 1.0, 1.0))
    with pytest.raises(ValueError, match=r"surfaces\[1\] is met by polarised rays of a UniaxialMedium"):
        polarized_trace(lens, launch(lens, "y", 3))
    crystal = UniaxialMedium((0.0, 1.0, 1.0), [OTHER])
    rows = [surface(thickness=5.0, material=ORDINARY, gradient=crystal), surface(thickness=-5.0, material="mirror")]
    with pytest.raises(ValueError, match="reflects within a UniaxialMedium"):
        folded = optical_system([*rows, surface()], 1.0)
        trace(folded, launch(folded, "y", 3))


def test_the_optic_axis_turns_with_a_coordinate_break():
    lens = plate((0.0, 1.0, 1.0))
    turned = optical_system([coordinate_break(tilt=(0.0, 0.0, 90.0)), *plate((0.0, 1.0, 1.0)).surfaces], 1.0)
    straight, bent = (trace(item, launch(item, "y", 1), until=len(item.surfaces) - 1) for item in (lens, turned))
    # The frame of the last surface is turned with it: there the walk-off is the same.
    assert float(bent.y) == pytest.approx(float(straight.y), abs=1e-13)
