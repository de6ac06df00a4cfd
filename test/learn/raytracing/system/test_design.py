"""Lens design: optima with closed forms, solves, pickups and bounds that hold, exact Jacobians, restarts, glasses."""

import math

import pytest
import torch

from odak.catalog import material, model_glass, refractive_index
from odak.learn.raytracing.system import (
    Operand,
    Perturbation,
    Pickup,
    Solve,
    Variable,
    first_order,
    fused,
    launch,
    lens_design,
    load_system,
    optical_system,
    pupil_quadrature,
    rms_spot,
    seidel_sums,
    surface,
    tolerance,
    trace,
    trace_fields,
)
from odak.raytracing import Toroid
from odak.raytracing.interfaces import RadialPhase

F64 = torch.float64


def _singlet(front=80.0, rear=-120.0, index=1.5, aperture=5.0, **options):
    return optical_system(
        [surface(front, thickness=1e-6, material=index), surface(rear, thickness=100.0)], aperture, **options
    )


def _toric():
    front = surface(shape=Toroid(0.01, 0.02), thickness=3.0, material=1.5)
    return optical_system([front, surface(-60.0, thickness=50.0), surface(thickness=1.0)], 5.0)


def test_best_form_of_thin_lens_is_that_of_third_order_theory():
    """Least spherical aberration of a distant point: q = 2(n² − 1)/(n + 2) (Jenkins and White 1976, eq. 9n)."""
    n = 1.6
    lens = _singlet(index=n, aperture=0.5)
    design = lens_design(
        lens,
        [Operand(lambda s, p: seidel_sums(s, 0.0, p).seidel[..., 0, :].sum(-1), weight=1e7)],
        [Variable("curvature", 0)],
        solves=[Solve("focal_length", 1, 100.0)],
    )
    design.optimise(14)
    c1, c2 = (float(item.curvature) for item in lens.surfaces)
    assert (c1 + c2) / (c1 - c2) == pytest.approx(2 * (n * n - 1) / (n + 2), rel=1e-4)


@pytest.mark.parametrize(("index", "conic"), [(1.5, -(1.5**2)), (1.7, -(1.7**2))])
def test_the_rear_of_a_plano_convex_lens_becomes_a_hyperboloid(index, conic):
    """A plane wave in glass is focused by a hyperboloid of conic constant −n² without aberrations (Descartes)."""
    lens = optical_system([surface(thickness=5.0, material=index, stop=True), surface(-40.0, thickness=80.0)], 20.0)
    lens.surfaces[1].thickness.copy_(first_order(lens).image_distance)
    result = lens_design(lens, "spot", Variable("conic", 1)).optimise(30, tolerance=0.0)
    assert float(lens.surfaces[1].conic) == pytest.approx(conic, rel=1e-8)
    assert result.merit < 1e-18


@pytest.mark.parametrize("quadrature", [False, True])
def test_operands_of_weighted_rays_are_means_over_the_pupil(quadrature):
    """A slow sphere: the wavefront of path W·r⁴ has the variance 4W²/45, spots at k·r³ the mean square k²/4."""
    mirror = optical_system([surface(-2000.0, thickness=-1000.0, material="mirror")], 20.0)
    pupil = pupil_quadrature(mirror, 8) if quadrature else "gauss"
    design = lens_design(mirror, ["spot", "wavefront"], [Variable("curvature", 0)], pupil=pupil, count=8)
    spot, lag = (float(values.square().sum()) for _, values, _ in design.report())
    assert spot == pytest.approx((10.0**3 / (2 * 2000.0**2)) ** 2 / 4, rel=1e-3)
    path = 10.0**4 / (4 * 2000.0**3) / mirror.wavelengths[0]
    assert lag == pytest.approx(4 * path**2 / 45, rel=1e-3)


def test_a_mirror_becomes_a_paraboloid_by_its_wavefront():
    mirror = optical_system([surface(-200.0, conic=-0.3, material="mirror", thickness=-100.0)], 40.0)
    lens_design(mirror, "wavefront", Variable("conic", 0)).optimise(30, tolerance=0.0)
    assert float(mirror.surfaces[0].conic) == pytest.approx(-1, abs=1e-9)


def test_an_achromat_takes_its_powers_from_the_abbe_numbers():
    """φ₁ = φ·V₁/(V₁ − V₂) for thin lenses in contact whose foci at F and C agree."""
    f_line, c_line = 486.1327e-6, 656.2725e-6
    crown, flint = material("N-BK7"), material("SF2")
    lens = optical_system(
        [
            surface(60.0, thickness=1e-7, material=crown),
            surface(-60.0, thickness=1e-7, material=flint),
            surface(-300.0, thickness=100.0),
        ],
        1.0,
        wavelengths=[f_line, 587.5618e-6, c_line],
    )

    def colour(system, p):
        ends = [first_order(system, prescription=p._replace(index=p.index[..., i : i + 1, :])) for i in (0, 2)]
        return 1000 * (ends[0].image_distance - ends[1].image_distance)

    variables = [Variable("curvature", 1)]
    lens_design(lens, [Operand(colour)], variables, solves=[Solve("focal_length", 2, 100.0)]).optimise(30)
    c = [float(item.curvature) for item in lens.surfaces]
    v1, v2 = (
        (refractive_index(m, 587.5618e-9) - 1) / (refractive_index(m, 486.1327e-9) - refractive_index(m, 656.2725e-9))
        for m in (crown, flint)
    )
    power = (refractive_index(crown, 587.5618e-9) - 1) * (c[0] - c[1])
    assert power == pytest.approx(v1 / (v1 - v2) / 100, rel=1e-5)


def test_solves_hold_exactly_at_every_value_of_the_variables():
    triplet = load_system("cooke_triplet")
    solves = [
        Solve("edge_thickness", 0, 1.25, height=8.0),
        Solve("focal_length", 5, 47.0),
        Solve("marginal_height", 5, 0.01),
    ]
    design = lens_design(triplet, "spot", [Variable("curvature", [0, 2, 3]), Variable("thickness", 1)], solves=solves)
    values = design.values * torch.tensor([1.02, 0.97, 1.01, 1.1], dtype=F64)
    p = design.prescription(torch.stack([values, design.values]))
    found = first_order(triplet, prescription=p)
    torch.testing.assert_close(found.focal_length, torch.full((2,), 47.0, dtype=F64), rtol=1e-12, atol=0)
    height = (found.image_distance - p.thickness[:, 5]) / (2 * found.working_f_number)
    torch.testing.assert_close(height, torch.full((2,), 0.01, dtype=F64), rtol=1e-9, atol=1e-13)
    sags = [p.shape(i).sag(torch.zeros(1, dtype=F64), torch.full((1,), 8.0, dtype=F64)).height for i in (0, 1)]
    torch.testing.assert_close(p.thickness[:, 0] - sags[0] + sags[1], torch.full((2,), 1.25, dtype=F64))
    design.apply(values)
    assert float(first_order(triplet).focal_length) == pytest.approx(47.0, rel=1e-12)


def test_a_solve_for_the_focal_length_counts_diffractive_power():
    front = surface(50.0, thickness=3.0, material=1.5, phase=RadialPhase([-200.0], 10.0))
    lens = optical_system([front, surface(-60.0, thickness=50.0)], 5.0)
    design = lens_design(lens, "spot", Variable("thickness", 1), solves=[Solve("focal_length", 0, 50.0)])
    design.apply(design.values)
    edge = trace_fields(lens, torch.tensor([[0.0, 1e-4]], dtype=F64))
    assert -2.5e-4 * float(edge.w / edge.v) == pytest.approx(50.0, rel=1e-6)


def test_pickups_hold_and_bounds_are_kept():
    lens = _singlet(index=1.6)
    design = lens_design(
        lens,
        [Operand("focal_length", 30.0)],
        [Variable("curvature", 0, -0.02, 0.02)],
        pickups=[Pickup("curvature", 1, 0, scale=-1.0)],
    )
    design.optimise(20)
    c = [float(item.curvature) for item in lens.surfaces]
    # f = 30 asks for 1/36; the bound stops at 1/50.
    assert c[0] == pytest.approx(0.02, rel=1e-14) and c[1] == -c[0]
    assert abs(c[0]) <= 0.02 * (1 + 1e-14)


def test_rays_past_the_conic_of_an_asphere_are_traced_fused(monkeypatch):
    """A paraboloid minus itself is a plane, which every ray meets; many of these rays do not meet the paraboloid."""

    def plate(**front):
        first = surface(thickness=3.0, material=1.5, stop=True, **front)
        return optical_system([first, surface(thickness=5.0)], 2.0, fields=[0.0, 40.0])

    monkeypatch.setattr(fused, "plain", None)
    bowl = plate(curvature=2.0, conic=-1.0, coefficients=[-1.0, 0.0])
    found, expected = (trace_fields(lens, "rings", 4) for lens in (bowl, plate()))
    assert bool(found.arrived.all())
    torch.testing.assert_close(found.y, expected.y, rtol=0, atol=1e-12)
    torch.testing.assert_close(found.path, expected.path, rtol=0, atol=1e-12)
    design = lens_design(bowl, "spot", [Variable("curvature", 0), Variable("coefficients", 0, terms=[0])])
    # c/2 and the first coefficient are the same number of the surface.
    by_curvature, by_coefficient = design.linearised(design.values)[1].unbind(-1)
    assert float(by_coefficient.abs().max()) > 0.1
    torch.testing.assert_close(2 * by_curvature, by_coefficient, rtol=1e-9, atol=1e-9)


def test_a_run_in_two_parts_that_keeps_the_damping_is_one_run():
    lens = load_system("cooke_triplet")
    design = lens_design(lens, "spot", [Variable("curvature", range(6)), Variable("thickness", 5)], count=2)
    starts = design.values * torch.tensor([[1.0], [1.01]], dtype=F64)
    whole = design._minimised(starts, 4)
    part = design._minimised(starts, 2)
    rest = design._minimised(part.x, 2, part.damping)
    assert torch.equal(rest.x, whole.x) and torch.equal(rest.damping, whole.damping)
    again = design._minimised(part.x, 2)
    assert not torch.equal(again.x, whole.x)


def test_jacobians_with_tilts_and_apertures_that_lose_rays():
    """The trace in plain operations, forwards, agrees with the fused one; lost rays have no derivative."""
    triplet = load_system("cooke_triplet")
    fused = lens_design(triplet, "spot", Variable("curvature", range(6)), count=2).linearised
    plain = lens_design(
        triplet, "spot", [Variable("curvature", range(6)), Variable("tilt", 2), Variable("shift", 3)], count=2
    )
    values = plain.values
    jacobian = plain.linearised(values)[1]
    torch.testing.assert_close(fused(values[:6])[1], jacobian[:, :6], rtol=1e-8, atol=1e-10)
    step = torch.zeros_like(values)
    step[7] = 1e-3
    slope = (plain.residuals(values + step) - plain.residuals(values - step)) / 2e-3
    torch.testing.assert_close(slope, jacobian[:, 7], rtol=1e-5, atol=1e-9)


@pytest.mark.slow
def test_restarts_leave_a_poor_valley_and_repeat():
    ends = []
    for _ in range(2):
        lens = _singlet(front=-300.0, rear=-43.0, aperture=20.0)
        design = lens_design(
            lens,
            ["spot"],
            [Variable("curvature", 0)],
            solves=[Solve("focal_length", 1, 100.0), Solve("marginal_height", 1)],
        )
        start = float(0.5 * design.residuals(design.values).square().sum())
        ends.append(design.restarts(6, spread=1.0, seed=3, iterations=12))
    assert ends[0].merit == ends[1].merit and torch.equal(ends[0].values, ends[1].values)
    assert ends[0].merit < 0.2 * start


@pytest.mark.parametrize("mapped", [(None, 0), (None, 1), (0, 0), (0, None), (1, 2)])
def test_derivatives_are_contracted_with_all_directions_at_once(mapped):
    generator = torch.Generator().manual_seed(1)
    derivative = torch.randn(4, 7, 2, 5, 3, generator=generator, dtype=F64)
    tangent = torch.randn(4, 2, 3, generator=generator, dtype=F64)
    given = [
        value[0] if axis is None else value.movedim(0, axis)
        for value, axis in zip((derivative, tangent), mapped, strict=True)
    ]
    found = torch.func.vmap(fused.Contraction.apply, in_dims=mapped)(*given)
    for k in range(4):
        one = [value[0 if axis is None else k] for value, axis in zip((derivative, tangent), mapped, strict=True)]
        torch.testing.assert_close(found[k], torch.einsum("cbrk,bk->cbr", *one), rtol=1e-13, atol=1e-13)


def test_lenses_of_several_glasses_are_evaluated_side_by_side():
    """Each as the lens of its own glasses would be; a glass of None still varies."""
    lens = load_system("cooke_triplet")
    design = lens_design(lens, "spot", [Variable("curvature", 0), Variable("glass", [0, 2])], count=2)
    rows = [("N-LAK9", "N-SF5"), ("N-LAK33B", "SF10"), (None, "SF10")]
    several = design._with_glasses(rows)
    found = several.residuals(design.values.expand(3, -1))
    again = several.residuals(design.values.expand(3, 2, -1))
    model = model_glass(*design.values[1:3].tolist())
    for k, row in enumerate(rows):
        for place, name in zip((0, 2), row, strict=True):
            lens.surfaces[place].material = model if name is None else material(name)
        own = lens_design(lens, "spot", Variable("curvature", 0), count=2)
        torch.testing.assert_close(found[k], own.residuals(own.values), rtol=1e-9, atol=1e-12)
        torch.testing.assert_close(again[k, 1], found[k], rtol=1e-12, atol=1e-15)


def test_a_model_glass_in_a_design_is_that_of_the_catalogue():
    lens = optical_system([surface(50.0, thickness=3.0, material="N-BK7"), surface(-50.0, thickness=48.0)], 5.0)
    design = lens_design(lens, "spot", Variable("glass", 0))
    given = torch.tensor([1.62, 36.3], dtype=F64)
    index = design.prescription(given).index[0, 1]
    assert float(index) == pytest.approx(model_glass(1.62, 36.3).index(0.5875618), rel=1e-14)


@pytest.mark.parametrize(
    ("what", "message"),
    [
        (lambda s: lens_design(s, "sport", Variable("thickness", 1)), "kind of operands"),
        (lambda s: lens_design(s, [], Variable("thickness", 1)), "at least one"),
        (lambda s: lens_design(s, "spot", []), "variables must contain"),
        (lambda s: lens_design(s, "spot", Variable("thick", 1)), "name of a variable"),
        (lambda s: lens_design(s, "spot", Variable("thickness", 9)), "surfaces of a variable"),
        (lambda s: lens_design(s, "spot", Variable("thickness", [1, 1])), "twice"),
        (lambda s: lens_design(s, "spot", Variable("glass", 1)), "must be a material"),
        (lambda s: lens_design(s, "spot", Variable("conic", 1), pickups=Pickup("conic", 1, 0)), "given twice"),
        (lambda s: lens_design(s, "spot", Variable("thickness", 1), solves=Solve("edge_thickness", 0)), "height"),
        (lambda s: lens_design(s, "spot", Variable("thickness", 1, 2.0, 1.0)), "at most"),
        (lambda s: lens_design(s, Operand("spot", lower=2.0, upper=1.0), Variable("thickness", 1)), "at most"),
        (
            lambda s: lens_design(_toric(), "spot", Variable("thickness", 1), solves=Solve("focal_length", 0, 9.0)),
            "Tor",
        ),
        (lambda s: lens_design(_toric(), "spot", Variable("thickness", 1), pickups=Pickup("conic", 0, 1)), "a Toroid"),
        (
            lambda s: lens_design(_toric(), "spot", Variable("thickness", 1), solves=Solve("focal_length", 2, 9.0)),
            "no p",
        ),
    ],
)
def test_descriptions_that_make_no_sense_are_refused(what, message):
    with pytest.raises(ValueError, match=message):
        what(_singlet())


def test_compensators_bring_a_defocused_lens_back():
    triplet = load_system("cooke_triplet")
    off = [Perturbation("thickness", 5, 0.2), Perturbation("radius", 2, 1e-3, relative=True)]
    blurred = tolerance(triplet, off, samples=3, seed=2)
    focused = tolerance(triplet, off, samples=3, seed=2, compensators=[("thickness", 5)], iterations=5)
    assert bool((focused.merit.square().sum(-1) <= blurred.merit.square().sum(-1)).all())
    capitals = tolerance(triplet, off, samples=3, seed=2, compensators=[("Thickness", 5)], iterations=5)
    assert torch.equal(capitals.merit, focused.merit)
    # By hand: the image distance of least Σ rms² among a fine row of them, for the first lens.
    p = blurred.prescription.select(0)
    row = p.thickness.repeat(101, 1)
    row[:, 5] += torch.linspace(-0.5, 0.5, 101, dtype=F64)
    sums = rms_spot(triplet, prescription=p._replace(thickness=row)).square().sum(-1)
    assert float(focused.merit[0].square().sum()) == pytest.approx(float(sums.min()), rel=1e-3)
    assert float(focused.prescription.thickness[0, 5]) == pytest.approx(float(row[sums.argmin(), 5]), abs=0.01)


def test_a_variable_of_a_solved_number_is_added_to_it():
    lens = _singlet()
    design = lens_design(lens, "spot", Variable("thickness", 1), solves=[Solve("marginal_height", 1)])
    focus = first_order(lens).image_distance
    thickness = design.prescription(torch.tensor([[0.0], [-0.7]], dtype=F64)).thickness[:, 1]
    torch.testing.assert_close(thickness, torch.stack([focus, focus - 0.7]))


def test_units_of_solves_near_objects():
    """The marginal ray of a near object meets the axis at the conjugate of the lens equation."""
    lens = _singlet(aperture=4.0, object_distance=300.0)
    design = lens_design(lens, "spot", Variable("curvature", 0), solves=[Solve("marginal_height", 1)])
    design.apply(design.values)
    f = float(first_order(lens).focal_length)
    assert float(lens.surfaces[1].thickness) == pytest.approx(1 / (1 / f - 1 / 300.0), rel=1e-6)
    assert math.isfinite(f)


def test_rays_outside_the_fused_kernel_have_equal_derivatives(monkeypatch):
    """Where the replay fails, derivatives are computed by autograd through the plain operations."""
    lens = optical_system(
        [
            surface(30.0, coefficients=[0.0, 1e-5], thickness=4.0, material=1.6, stop=True),
            surface(-60.0, coefficients=[0.0, 2e-5], thickness=40.0),
        ],
        8.0,
        fields=[0.0, 5.0],
    )
    design = lens_design(lens, "spot", [Variable("curvature", [0, 1]), Variable("coefficients", [0, 1])], count=1)
    expected = design.linearised(design.values)[1]
    run = fused._run
    monkeypatch.setattr(fused, "_run", lambda block, row, keep=None: None if keep is not None else run(block, row))
    found = design.linearised(design.values)[1]
    torch.testing.assert_close(found, expected, rtol=1e-10, atol=1e-12 * float(expected.abs().amax()))


def test_a_limit_of_edges_holds_at_the_diameters_of_the_design_that_was_found():
    """The report after an optimisation agrees with its merit, and the last edge with rays traced to both sides."""
    triplet = load_system("cooke_triplet")
    operands = [Operand("spot"), Operand("edge_thickness", lower=1.0, options={"surfaces": range(5)})]
    variables = [Variable("curvature", range(1, 6)), Variable("thickness", [0, 2, 4], 1.0, 6.0)]
    solves = [Solve("focal_length", 0, 50.0), Solve("marginal_height", 5)]
    design = lens_design(triplet, operands, variables, solves=solves, count=2)
    result = design.optimise(8)
    report = design.report()
    assert sum(cost for _, _, cost in report) == pytest.approx(result.merit, rel=1e-9)
    turn = torch.arange(12, dtype=F64) * (math.pi / 6)
    rays = launch(triplet, torch.stack([turn.sin(), turn.cos()], -1))
    hits = [trace(triplet, rays, until=i, vignetting=False) for i in (4, 5)]
    height = max(float(torch.hypot(hit.x, hit.y).max()) for hit in hits)
    front, rear = (float(triplet.surfaces[i].shape.sag(0.0, torch.tensor(height, dtype=F64)).height) for i in (4, 5))
    edge = float(triplet.surfaces[4].thickness) - front + rear
    assert float(report[1][1][4]) == pytest.approx(edge, abs=1e-9)
    assert edge > 0.998
