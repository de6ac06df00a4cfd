"""Operands of designs: angles, colour, slopes, distances from glasses."""

import math

import pytest
import torch
from scipy.optimize import nnls

from odak.catalog import material, material_names, model_glass
from odak.learn.raytracing.system import (
    Operand,
    Solve,
    Variable,
    first_order,
    lens_design,
    load_system,
    optical_system,
    surface,
    trace_fields,
)
from odak.learn.raytracing.system.operands import OPERANDS, View, values_of

F64 = torch.float64


@pytest.mark.parametrize(
    "operand",
    [
        *(Operand(kind) for kind in sorted(set(OPERANDS) - {"glass", "modulation", "edge_thickness"})),
        Operand("modulation", 1.0, options={"frequency": 20.0, "samples": 16}),
        Operand("edge_thickness", lower=20.0, options={"heights": 9.0}),
        Operand("glass", options={"surfaces": [2]}),
        Operand("f_number", 3.0),
    ],
    ids=lambda operand: operand.kind,
)
def test_jacobians_are_exact(operand):
    """Against central differences, for one system and for a batch."""
    triplet = load_system("cooke_triplet")
    triplet.fields, triplet.aperture = ((0.0, 12.0), (5.0, 15.0)), 8.0
    variables = [Variable("curvature", [0, 3]), Variable("thickness", 1), Variable("glass", 2)]
    design = lens_design(triplet, operand, variables, count=2)
    value, jacobian = design.linearised(design.values)
    for j, size in enumerate((1e-2, 1e-2, 5.0, 1.0, 30.0)):
        step = torch.zeros_like(design.values)
        step[j] = 2e-5 * size
        near, far = (
            design.residuals(design.values + k * step) - design.residuals(design.values - k * step) for k in (1, 2)
        )
        slope = (8 * near - far) / (24e-5 * size)
        scale = float(slope.abs().amax()) + float(value.abs().amax()) / size
        assert float((slope - jacobian[:, j]).abs().amax()) <= 3e-6 * scale
    both = torch.stack([1.001 * design.values, design.values])
    again = design.linearised(both)
    torch.testing.assert_close(again[1][1], jacobian, rtol=1e-8, atol=1e-8 * float(jacobian.abs().amax()))


def test_angles_of_incidence_are_those_of_a_sphere_and_a_plate():
    """Parallel rays meet a sphere at height y with the sine y/R; at both sides of a plate the sine is the field's."""
    ball = optical_system([surface(40.0, thickness=3.0, material=1.5, stop=True), surface(thickness=60.0)], 20.0)
    front = values_of(Operand("incidence", options={"surfaces": [0], "count": 2}), View(ball, ball.prescription()))
    torch.testing.assert_close(front, torch.tensor([0.0, 0.25, 0.25], dtype=F64), rtol=1e-12, atol=1e-12)
    plate = optical_system([surface(thickness=3.0, material=1.5), surface(thickness=10.0)], 2.0, fields=[30.0, 60.0])
    sines = values_of(Operand("incidence"), View(plate, plate.prescription())).reshape(2, 2, 5)
    expected = torch.tensor([0.5, 3**0.5 / 2], dtype=F64)[:, None].expand(2, 2, 5)
    torch.testing.assert_close(sines, expected, rtol=1e-12, atol=0)
    # Rays that are reflected totally behind a prism-like steep sphere count as 1.
    steep = optical_system([surface(thickness=9.0, material=2.0), surface(-10.0, thickness=10.0)], 12.0)
    lost = values_of(Operand("incidence", options={"surfaces": [1], "count": 2}), View(steep, steep.prescription()))
    assert lost.tolist()[1:] == [1.0, 1.0]
    mirror = optical_system([surface(-100.0, material="mirror", thickness=-50.0)], 10.0)
    with pytest.raises(ValueError, match="incidence"):
        values_of(Operand("incidence"), View(mirror, mirror.prescription()))


def test_lost_rays_count_in_spots_as_if_they_were_at_a_distance():
    """Without that distance the residuals are NaN; the Jacobian is that of the rays that arrive."""
    lens = optical_system([surface(10.0, thickness=5.0, material=1.5), surface(thickness=12.0)], 24.0)
    variable = Variable("thickness", 1)
    design = lens_design(lens, Operand("spot", options={"lost": 2.0}), variable, count=6)
    value, jacobian = design.linearised(design.values)
    traced = trace_fields(lens, "rings", 6, vignetting=False)
    good = traced.arrived
    assert 0 < int(good.sum()) < good.numel()
    ends = torch.stack([traced.x[good], traced.y[good]], -1).detach()
    own = float((ends - ends.mean(0)).square().sum() + 4.0 * (~good).sum()) / good.numel()
    assert float(value.square().sum()) == pytest.approx(own, rel=1e-12)
    ahead, behind = (design.residuals(design.values + side) for side in (1e-5, -1e-5))
    torch.testing.assert_close(jacobian[:, 0], (ahead - behind) / 2e-5, rtol=1e-6, atol=1e-8)
    assert bool(lens_design(lens, "spot", variable, count=6).residuals(design.values).isnan().any())


def test_an_operand_of_glass_ends_with_the_variables_of_glass():
    """Real glasses stand in the lens afterwards; of the operands, those of glass are gone and the others remain."""
    lens = optical_system(
        [
            surface(60.0, thickness=4.0, material=model_glass(1.60, 60.0)),
            surface(-45.0, thickness=2.0, material=model_glass(1.65, 34.0)),
            surface(-200.0, thickness=96.0),
        ],
        10.0,
    )
    operands = ["spot", Operand("glass", weight=1e-3, options={"surfaces": [0, -2], "makers": ["schott"]})]
    solves = [Solve("focal_length", 2, 100.0), Solve("marginal_height", 2)]
    variables = [Variable("curvature", 0), Variable("glass", [0, 1])]
    design = lens_design(lens, operands, variables, solves=solves, count=1)
    names = design.substitute_glasses(["schott"], candidates=1, iterations=1)
    assert [item.kind for item in design.operands] == ["spot"] and "glass" not in design.places
    assert [item.material for item in lens.surfaces[:2]] == [material(name) for name in names]
    assert float(first_order(lens).focal_length) == pytest.approx(100.0, rel=1e-9)


def test_distances_from_the_hull_of_a_catalogue():
    """Against the nearest mixture of glasses; those of the catalogue are all within."""
    lens = optical_system([surface(50.0, thickness=3.0, material="N-BK7"), surface(thickness=90.0)], 5.0)
    inside = Operand("glass", options={"surfaces": [0], "makers": ["schott"], "hull": True})
    design = lens_design(lens, ["spot", inside], Variable("glass", 0, (1.3, 10.0), (2.3, 120.0)))
    pool = [material(name) for name in material_names("schott")]
    known = torch.tensor([[item.nd, item.vd] for item in pool if item.nd and item.vd], dtype=F64)
    for wanted in [*known[:5], torch.tensor([1.9, 60.0], dtype=F64), torch.tensor([1.5, 30.0], dtype=F64)]:
        found = float(values_of(inside, design.view(wanted)).max())
        points = torch.stack([100 * known[:, 0], 1000 / known[:, 1]])
        point = torch.stack([100 * wanted[0], 1000 / wanted[1]])
        heavy = torch.full((1, len(known)), 1e4, dtype=F64)
        _, distance = nnls(torch.cat([points, heavy]).numpy(), torch.cat([point, heavy[0, :1]]).numpy())
        assert max(found, 0.0) == pytest.approx(distance, rel=1e-4, abs=1e-5)


def test_axial_colour_of_thin_lenses_is_sum_of_powers_over_abbe():
    """f²·Σ φ/V between the F and C lines, for two lenses in contact."""
    crown, flint = model_glass(1.6, 60.0), model_glass(1.65, 34.0)
    rows = [(60.0, 1e-9, crown), (-60.0, 1e-9, "air"), (-90.0, 1e-9, flint), (400.0, 100.0, "air")]
    lines = [486.1327e-6, 587.5618e-6, 656.2725e-6]
    lens = optical_system([surface(r, thickness=t, material=m) for r, t, m in rows], 10.0, wavelengths=lines)
    design = lens_design(lens, "axial_color", Variable("thickness", 3))
    (_, found, _), *_ = design.report()
    powers = 0.6 * (1 / 60 + 1 / 60), 0.65 * (-1 / 90 - 1 / 400)
    expected = (powers[0] / 60 + powers[1] / 34) / sum(powers) ** 2
    assert float(found) == pytest.approx(expected, rel=0.02)


def test_slopes_of_a_sphere_and_of_an_asphere():
    """y·c/√(1 − c²y²), and 4·a·y³ for a plate with a term of the fourth order, at two shares of two heights."""
    lens = optical_system(
        [
            surface(20.0, thickness=5.0, material=1.5),
            surface(curvature=0.0, coefficients=[0.0, 1e-4], thickness=50.0),
        ],
        4.0,
    )
    slope = Operand("slope", options={"heights": [8.0, 6.0], "shares": (0.5, 1.0)})
    (_, found, _), *_ = lens_design(lens, slope, Variable("thickness", 0)).report()
    expected = [4 / math.sqrt(400 - 16), 8 / math.sqrt(400 - 64), 4e-4 * 3**3, 4e-4 * 6**3]
    torch.testing.assert_close(found, torch.tensor(expected, dtype=F64), rtol=1e-12, atol=0)


def test_edges_of_surfaces_planes_beyond_their_own_beams():
    """Two spheres of different semi-diameters: the smaller one keeps the height of its rim."""
    lens = optical_system(
        [
            surface(20.0, thickness=5.0, material=1.5, semi_diameter=4.0),
            surface(-30.0, thickness=50.0, semi_diameter=8.0),
        ],
        4.0,
    )

    def sag(radius, y):
        return radius - math.copysign(math.sqrt(radius**2 - y**2), radius)

    for flanges, rim in ((False, 8.0), (True, 4.0)):
        edge = Operand("edge_thickness", options={"surfaces": [0, 1], "shares": (0.5, 1.0), "flanges": flanges})
        (_, found, _), *_ = lens_design(lens, edge, Variable("thickness", 0)).report()
        front = [5 - sag(20.0, 4.0) + sag(-30.0, 4.0), 5 - sag(20.0, rim) + sag(-30.0, 8.0)]
        behind = [50 - sag(-30.0, 4.0), 50 - sag(-30.0, 8.0)]
        torch.testing.assert_close(found, torch.tensor([*front, *behind], dtype=F64), rtol=1e-12, atol=0)
